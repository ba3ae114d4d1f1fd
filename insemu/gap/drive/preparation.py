"""From a recording to the nominal filter's innovations: a starting state, noise levels trimmed inside their tolerance, the stored run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import Motion
from insemu.errors import InputError
from insemu.filters import (
    FilterOptions,
    FilterResult,
    FixTable,
    InitialSigma,
    on_reference,
    run_filter,
)
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.data.log import Reduced, moving_spectra
from insemu.gap.data.samples import Repaired, louder, without_motion
from insemu.gap.drive.shaking import rectified, steadied, without_shaking
from insemu.gap.drive.signatures import Loop, whitening
from insemu.gap.evidence.fixes import LEVEL_GROUPS, level_scores
from insemu.gap.evidence.model import Explanation, Likelihood, fit
from insemu.gap.evidence.surrogate import PLAIN, FixNoise, Surrogate
from insemu.gap.policy import rules
from insemu.noise import BI, WN, NoiseModel, Process
from insemu.prepared import Drive
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.rotation import dcm_from_rpy, rpy_from_dcm
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Standard deviations of the fixes over the stated ones where it is asked what shaking does to velocities: position, then velocity.
LOOSE = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])
#: Times that levels are moved at the most, and by how much each, in the logarithm; the change of it at which they hold.
MOST_TRIMS, MOST_MOVED, LEAST_MOVED = 8, 0.3, 0.02
#: Knots of slow processes are this many seconds apart.
NODE_S = 10.0
#: Longest step of the filter's covariance, s: whitened innovations of three real drives move by 1e-5 to 1e-3, rms, and a run takes 0.4 of the time.
COVARIANCE_S = 0.05


@dataclass(frozen=True)
class Prepared:
    """The nominal filter on a recording.

    Parameters
    ----------
    imu, gnss : records, cut to where the filter could start; the fixes with the nominal standard deviations
    result : FilterResult
        With every epoch and every fix stored.
    beliefs : mapping of axis to NoiseModel
        Levels trimmed inside their tolerance.
    fast : mapping of axis to Reduced
        The part of each axis above the motion.
    lever_arm : (3,) array
    factors : (6,) array
        By what the standard deviations of the fixes were trimmed: position, then velocity, north, east, down.
    start : tuple
        Initial state and its standard deviations.
    nominal : Nominal
        What is believed.
    repaired : Repaired, optional
        The IMU record as its samples were repaired, where they were.
    levels : (6,) array
        Levels of the fixes that were named, as ratios; the trimming stays within its tolerance of them.
    rectified : (n, 2) array, optional
        See :func:`insemu.gap.drive.shaking.rectified`.
    unresolved : (6,) array
        White noise among the beliefs that stands for what shaking leaves between the samples, squared densities.
    swings : bool
        Whether the antenna swings on its lever arm as the vehicle shakes: velocities hold what fixes sample of that at their own rate.
    steadied : bool
        Whether the velocities were moved by what a filter with these stamps misses of the motion between two samples.
    raised : (6,) array
        By what standard deviations were raised for that: other errors may have had a part in it, so that they may come back.
    first : (6,) array
        Standard deviations of the fix that the start stands on, whose errors are those of the start: position and velocity, m and m/s; zero of
        another start.
    began : float, optional
        First stamp of the recording, s: what the filter needs begins later.
    recorded : GnssRecord, optional
        The fixes before velocities were moved and standard deviations raised for the swing of the antenna.
    """

    imu: ImuRecord
    gnss: GnssRecord
    result: FilterResult
    beliefs: dict[str, NoiseModel]
    fast: dict[str, Reduced]
    lever_arm: Array
    factors: Array
    start: tuple[NavState, InitialSigma]
    nominal: Nominal
    repaired: Repaired | None = None
    levels: Array = field(default_factory=lambda: np.ones(6))
    rectified: Array | None = None
    unresolved: Array = field(default_factory=lambda: np.zeros(6))
    swings: bool = False
    steadied: bool = False
    raised: Array = field(default_factory=lambda: np.ones(6))
    first: Array = field(default_factory=lambda: np.zeros(6))
    began: float | None = None
    recorded: GnssRecord | None = None

    def again(
        self,
        *,
        imu: ImuRecord | None = None,
        gnss: GnssRecord | None = None,
        factors: Array | None = None,
        beliefs: dict[str, NoiseModel] | None = None,
    ) -> Prepared:
        """The same filter on other data, with other standard deviations of the fixes or another belief.

        Parameters
        ----------
        imu, gnss : ImuRecord, GnssRecord, optional
            Other data.
        factors : (6,) array, optional
            Ratios of the standard deviations of the fixes to the nominal ones: position, then velocity, NED.
        beliefs : mapping of axis to NoiseModel, optional
            Other noise of the IMU.
        """
        imu = self.imu if imu is None else imu
        gnss = self.gnss if gnss is None else gnss
        factors = self.factors if factors is None else factors
        beliefs = self.beliefs if beliefs is None else beliefs
        start = _levelled(self.start, self.first, factors)
        result = _run(imu, scaled_fixes(gnss, factors), start, beliefs, self.lever_arm)
        return replace(self, imu=imu, gnss=gnss, factors=factors, beliefs=beliefs, result=result)

    def on(self, recording: Recording) -> Prepared:
        """The same filter on another recording of the same motion, started as that recording lets it."""
        imu, gnss, initial, sigma = starting_state(recording, self.nominal)
        gnss = with_sigma(gnss, self.nominal)
        return replace(
            self, start=(initial, sigma), rectified=None, steadied=False, raised=np.ones(6), recorded=None,
            first=_first_fix_sigma(recording, imu, gnss), began=float(recording.imu.t[0]),
        ).again(imu=imu, gnss=gnss)  # fmt: skip

    def shifted(self, recording: Recording) -> Prepared:
        """The same filter on the same rows with other stamps: where the fixes are at the new time of the start, its attitude as it was.

        An alignment of its own for every offset that is tried would cost seconds each and move the attitude by less than it is uncertain.
        """
        new = recording.gnss
        if recording.reference is not None or recording.initial is not None or new is None:
            return self.on(recording)
        imu = recording.imu.rows(slice(len(recording.imu) - len(self.imu), None))
        state, sigma = self.start
        there, before = (_on_track(g, float(t)) for g, t in ((new, imu.t[0]), (self.gnss, self.imu.t[0])))
        moved = earth.position_difference(there[0], before[0])
        start = NavState(earth.move(state.llh, moved), state.vel_ned + there[1] - before[1], state.rpy)
        return replace(
            self, start=(start, sigma), rectified=None, steadied=False, raised=np.ones(6), recorded=None,
            first=_first_fix_sigma(recording, imu, new), began=float(recording.imu.t[0]),
        ).again(imu=imu, gnss=with_sigma(new, self.nominal))  # fmt: skip

    def on_arm(self, corrected: Prepared, arm: Array) -> Prepared:
        """The same with velocities of an antenna that swings on another lever arm.

        Parameters
        ----------
        corrected : Prepared
            The filter on data less what was found, that arm included.
        arm : (3,) array
            m, body axes.
        """
        recorded, used, gnss = self.recorded, self.gnss, corrected.gnss
        if recorded is None or recorded.vel_ned is None or used.vel_ned is None or gnss.vel_ned is None:
            return self
        bare = replace(gnss, vel_ned=recorded.vel_ned + gnss.vel_ned - used.vel_ned, vel_std_ned=recorded.vel_std_ned)
        steady = _on_arm(corrected.imu, bare, corrected.start, self.beliefs, self.lever_arm, arm)
        assert bare.vel_ned is not None and steady.vel_ned is not None
        gnss = replace(used, vel_ned=recorded.vel_ned + steady.vel_ned - bare.vel_ned, vel_std_ned=steady.vel_std_ned)
        return replace(
            self, gnss=gnss, swings=self.rectified is not None and bool(np.any(arm)),
            steadied=_moved(bare, steady), raised=_raised(bare, steady),
        )  # fmt: skip

    def densely(self, node_every: float) -> FilterResult:
        """The same run with nodes at least every so many seconds."""
        fixes = scaled_fixes(self.gnss, self.factors)
        start = _levelled(self.start, self.first, self.factors)
        return _run(self.imu, fixes, start, self.beliefs, self.lever_arm, node_every)

    @property
    def motion(self) -> Motion:
        """The motion that the filter estimated, less the noise that is believed."""
        imu, nodes = self.imu, self.result.nodes
        assert nodes is not None
        noise = np.sqrt([float(self.beliefs[name].allan_variance([1], imu.dt)[0]) for name in AXES])
        return Motion.of(imu, self.result.nav, nodes.epoch, noise, self.began)

    @property
    def surrogate(self) -> Surrogate:
        """The filter seen from outside."""
        return replace(
            Surrogate.of(self.result),
            settled=self.nominal.known_levels,
            first=(self.first * self.factors) ** 2,
        )

    def trimmed(self) -> Prepared:
        """The same filter with the levels of its fixes moved to their most likely values inside the tolerance."""
        out = self
        for _ in range(2):
            moved = fitted_levels(out, Loop.of(out.result).white, out.surrogate)
            if moved is out:
                break
            out = moved.again()
        return out


def _run(
    imu: ImuRecord,
    gnss: GnssRecord,
    start: tuple[NavState, InitialSigma],
    beliefs: dict[str, NoiseModel],
    lever_arm: Array,
    node_every: float = NODE_S,
) -> FilterResult:
    span = float(imu.t[-1] - imu.t[0])
    usable = {name: for_filter(model, imu.dt, span) for name, model in beliefs.items()}
    every = max(1, int(COVARIANCE_S / imu.dt + 1e-9))
    options = FilterOptions(store="fixes", node_every=node_every, covariance_every=every)
    return run_filter(imu, gnss, *start, usable, lever_arm=lever_arm, options=options)


def for_filter(model: NoiseModel, dt: float, span: float) -> NoiseModel:
    """A model that a filter can carry: flicker as a sum of Gauss-Markov processes over the times that the recording shows.

    Parameters
    ----------
    model : NoiseModel
        Noise of an axis.
    dt : float
        Sampling interval, s.
    span : float
        Duration of the recording, s.
    """
    parts: list[Process] = []
    for p in model:
        if isinstance(p, BI):
            parts += list(p.approximation(4, 10.0 * dt, span)[0])
        else:
            parts.append(p)
    return NoiseModel(tuple(parts))


def fast_parts(recording: Recording, nominal: Nominal) -> dict[str, Reduced]:
    """What each axis shows above the motion, less what the vehicle does there."""
    parts = {name: _fast_part(recording.imu, k, name) for k, name in enumerate(AXES)}
    return without_shaking(parts, nominal.beliefs)


def flown_once(recording: Recording, nominal: Nominal) -> FilterResult:
    """The nominal filter on a recording as it is, for the motion that it estimates.

    Raises
    ------
    InputError
        No way to start.
    """
    imu, gnss, initial, sigma = starting_state(recording, nominal)
    beliefs = {name: nominal.beliefs[name] for name in AXES}
    return _run(imu, with_sigma(gnss, nominal), (initial, sigma), beliefs, np.array(nominal.gnss.lever_arm))


def prepare(
    recording: Recording,
    nominal: Nominal,
    fast: dict[str, Reduced],
    levels: dict[str, float],
    repaired: Repaired | None = None,
) -> Prepared:
    """Run the nominal filter, its white noise and GNSS levels trimmed by at most the tolerance of a nominal level.

    Parameters
    ----------
    fast : mapping of axis to Reduced
        From :func:`fast_parts`.
    levels : mapping of axis to float
        White-noise densities that were named as an effect and are used as they are.
    repaired : Repaired, optional
        The IMU record as its samples were repaired, where they were.

    Raises
    ------
    InputError
        No fixes, a missing belief, too short a recording, or no way to start.
    """
    assert recording.gnss is not None
    imu, gnss, initial, sigma = starting_state(recording, nominal)
    if imu.t[-1] - imu.t[0] < 60.0:
        raise InputError(
            f"the recording has {imu.t[-1] - imu.t[0]:.0f} s that can be used, expected at least 60 s",
            where=recording.source,
        )
    gnss = with_sigma(gnss, nominal)
    beliefs = {name: _trimmed(nominal.beliefs[name], fast[name], levels.get(name)) for name in AXES}
    if repaired is not None:  # what is wrong over a gap is seen in no spectrum
        beliefs = {name: louder(beliefs[name], float(more)) for name, more in zip(AXES, repaired.loss, strict=True)}
    start = (initial, sigma)
    lever, recorded = np.array(nominal.gnss.lever_arm), gnss
    gnss = _on_arm(imu, recorded, start, beliefs, lever, lever)
    result = _run(imu, gnss, start, beliefs, lever)
    left = rectified(imu, fast)
    prepared = Prepared(
        imu, gnss, result, beliefs, fast, lever, np.ones(6), start, nominal, repaired,
        rectified=left, swings=left is not None and bool(np.any(lever)), steadied=_moved(recorded, gnss), raised=_raised(recorded, gnss),
        first=_first_fix_sigma(recording, imu, recorded), began=float(recording.imu.t[0]), recorded=recorded,
    )  # fmt: skip
    return prepared.trimmed()


@dataclass(frozen=True)
class Flown:
    """A recording with the nominal filter's run on it before anything is named: what several looks at the same recording share.

    Parameters
    ----------
    recording : Recording
    nominal : Nominal
        What is believed of it.
    fast : mapping of axis to Reduced
    prepared : Prepared
    """

    recording: Recording
    nominal: Nominal
    fast: dict[str, Reduced]
    prepared: Prepared

    @classmethod
    def of(cls, recording: Recording, nominal: Nominal) -> Flown:
        """Run the nominal filter; see :func:`prepare`."""
        fast = fast_parts(recording, nominal)
        return cls(recording, nominal, fast, prepare(recording, nominal, fast, {}))


def fixes_score(fixes: FixTable) -> float:
    """Log score of the innovations of the accepted fixes."""
    return float(fixes.log_densities[fixes.accepted].sum())


def fitted_levels(prepared: Prepared, white: Array, s: Surrogate, *, back: bool = False) -> Prepared:
    """A filter with the levels of its fixes moved, inside the tolerance, to where their score is zero, before it runs with them.

    The score leaves out how a level changes the covariance of the filter's errors, so that they are near their most likely values.

    Parameters
    ----------
    prepared : Prepared
        With the levels at which the filter ran.
    white : (f, 6, 6) array
        Inverse Cholesky factors of the innovation covariances.
    s : Surrogate
        That filter, with the innovations of the first fixes less what is explained.
    back : bool
        Whether a level that was raised before the search may come back: it is none that a finding names.
    """
    groups = [list(g) for g in LEVEL_GROUPS if s.use[:, list(g)].any()]
    if back:  # components that were raised by other shares come back by themselves
        apart = [float(np.ptp(np.log(prepared.raised[g]))) > np.log1p(rules().tolerance) for g in groups]
        groups = [part for g, other in zip(groups, apart, strict=True) for part in ([[k] for k in g] if other else [g])]
    out, v, white = prepared, s.nu, white[: s.t.size]
    edge = np.log(1.0 + rules().tolerance)
    passed: tuple[Array, Array] | None = None
    for _ in range(MOST_TRIMS if groups else 0):
        ratio = out.factors / prepared.factors
        if out is not prepared:
            v, S = s.ahead(s.nu, FixNoise(ratio, PLAIN), np.zeros_like(s.nu))
            try:
                white = whitening(S, s.use == 1)[1]
            except np.linalg.LinAlgError:  # rounding left no covariance: the filter runs at what was reached
                break
        y = np.einsum("kij,kj->ki", white, v)
        score, information = level_scores(replace(s, R=s.R * ratio**2), white, y, groups)
        place = np.array([np.log(out.factors[g[0]]) for g in groups])
        # a weak pull towards the nominal level keeps a level that the innovations do not show
        move = np.linalg.solve(information + np.eye(len(groups)), score)
        # how far the filter follows its fixes at a level is in no information, so that a step may be too long: between two scores of other sign
        # the next is where the line through both is zero
        if passed is not None:
            before, there = passed
            over = (score * before < 0.0) & (place != there)
            move[over] = ((there - place) * score / (score - before))[over]
        passed = score, place
        factors = out.factors.copy()
        for g, m in zip(groups, move, strict=True):
            middle = np.log(out.levels[g])
            factors[g] = np.exp(
                np.clip(np.log(factors[g]) + np.clip(m, -MOST_MOVED, MOST_MOVED), middle - edge, middle + edge)
            )
        if not np.max(np.abs(np.log(factors / out.factors))) > LEAST_MOVED:
            break
        ours = (out.levels <= 1.0) & (out.levels >= 1.0 / out.raised) & (out.raised > 1.0) & back
        out = replace(out, factors=factors, levels=np.where(ours, np.clip(factors, 1.0 / out.raised, 1.0), out.levels))
    return out


def starting_state(recording: Recording, nominal: Nominal) -> tuple[ImuRecord, GnssRecord, NavState, InitialSigma]:
    """Where the filter starts: on the reference where there is one, else as every filter on recorded data does (:mod:`insemu.prepared`).

    A start on a reference is as uncertain as the nominal model says, any other at least so.

    Raises
    ------
    InputError
        No way to start, or an IMU upside down in the attitudes of the reference.
    """
    imu, gnss, own = recording.imu, recording.gnss, nominal.initial.sigma
    assert gnss is not None
    if recording.reference is not None:
        imu, state = on_reference(imu, recording.reference)
        _check_upright(imu, recording.reference, recording.source)
        return imu, gnss, state, own
    found = Drive.of(recording, nominal.stated()).started().aligned
    state = replace(
        found.state, rpy=rpy_from_dcm(dcm_from_rpy(found.state.rpy) @ dcm_from_rpy(np.array(nominal.mounting)))
    )
    sigma = found.sigma.to_array()
    sigma[:6], sigma[6:] = np.hypot(sigma[:6], own.to_array()[:6]), np.maximum(sigma[6:], own.to_array()[6:])
    return imu.rows(slice(found.row, None)), gnss, state, InitialSigma(sigma[:3], sigma[3:6], sigma[6:])


def _on_track(gnss: GnssRecord, t: float) -> tuple[Array, Array]:
    """Place (rad, rad, m) and velocity (m/s, NED) of the positions at a time, on the line through the two that are nearest before and after."""
    use = np.isfinite(gnss.llh).all(axis=1)
    times, llh = gnss.t[use], gnss.llh[use]
    k = int(np.clip(np.searchsorted(times, t) - 1, 0, times.size - 2))
    velocity = earth.position_difference(llh[k + 1], llh[k]) / (times[k + 1] - times[k])
    return earth.move(llh[k], velocity * (t - times[k])), velocity


def _check_upright(imu: ImuRecord, reference: Trajectory, source: str) -> None:
    """Raise ``InputError`` where the specific force points down in the attitudes of the reference: on the mean it carries the vehicle."""
    rows = max(1, round(1.0 / imu.dt))
    count = len(imu) // rows
    t, force = (x[: count * rows].reshape(count, rows, -1).mean(axis=1) for x in (imu.t[:, None], imu.accel))
    inside = (t[:, 0] >= reference.t[0]) & (t[:, 0] <= reference.t[-1])
    if not inside.any():
        return
    angles = np.unwrap(reference.rpy, axis=0)
    rpy = np.stack([np.interp(t[inside, 0], reference.t, column) for column in angles.T], axis=1)
    up = -np.mean([dcm_from_rpy(a)[2] @ f for a, f in zip(rpy, force[inside], strict=True)])
    if up < 0.0:
        raise InputError(
            "on the mean the specific force points down in the attitudes of the reference, expected up: the IMU is not in the axes of the "
            "reference (forward, right, down); axes=FLU in --map of insemu open turns forward, left, up into these, a mounting in the "
            "effects of the belief any other",
            where=source,
        )


def _first_fix_sigma(recording: Recording, imu: ImuRecord, gnss: GnssRecord) -> Array:
    """Standard deviations (6,) of the fix at which an IMU was cut to begin; zero of what did not come from it, or of a start on a reference."""
    out = np.zeros(6)
    # velocities may have stamps of their own, at which no filter starts
    before = np.flatnonzero(np.isfinite(gnss.llh).all(axis=1) & (gnss.t <= imu.t[0]))
    if recording.reference is None and before.size and gnss.pos_std_ned is not None:
        k = before[-1]
        out[:3] = gnss.pos_std_ned[k]
        if gnss.vel_ned is not None and gnss.vel_std_ned is not None:
            out[3:] = np.where(np.isfinite(gnss.vel_ned[k]), gnss.vel_std_ned[k], 0.0)
    return out


def _levelled(start: tuple[NavState, InitialSigma], first: Array, factors: Array) -> tuple[NavState, InitialSigma]:
    """A start that is as uncertain as the fix (6,) that it stands on is at other levels (6,)."""
    own = start[1].to_array()
    own[:6] = np.sqrt(own[:6] ** 2 + first**2 * (factors**2 - 1.0))
    return start[0], InitialSigma(own[:3], own[3:6], own[6:])


def _on_arm(
    imu: ImuRecord,
    recorded: GnssRecord,
    start: tuple[NavState, InitialSigma],
    beliefs: dict[str, NoiseModel],
    lever: Array,
    arm: Array,
) -> GnssRecord:
    """The fixes with velocities as :func:`steadied` moves them, of an antenna on an arm that the filter takes back by ``lever``; both (3,) in m."""
    gnss = recorded
    # a filter that trusted shaken velocities has larger innovations than they alone would give it
    for _ in range(3 if gnss.vel_std_ned is not None else 0):
        # nor may it follow positions that are off for other reasons
        loose = _run(imu, scaled_fixes(gnss, LOOSE), start, beliefs, lever)
        steady = steadied(imu, recorded, gnss, loose, lever, arm)
        if steady is gnss or (gnss is not recorded and _as_sure(steady, gnss)):
            break
        gnss = steady
    return gnss


def _raised(recorded: GnssRecord, steady: GnssRecord) -> Array:
    """Median ratio of the standard deviations of the fixes that were raised to those that were recorded, (6,): position, then velocity.

    A vehicle that stands half of the time shakes in the other half.
    """
    out, a, b = np.ones(6), steady.vel_std_ned, recorded.vel_std_ned
    if a is not None and b is not None and a is not b:
        for k, ratio in enumerate((a / b).T):
            if (more := ratio > 1.0).any():
                out[3 + k] = np.median(ratio[more])
    return out


def _moved(recorded: GnssRecord, steady: GnssRecord) -> bool:
    """Whether the velocities of fixes are not those that were recorded."""
    a, b = recorded.vel_ned, steady.vel_ned
    return a is not None and b is not None and not np.array_equal(a, b, equal_nan=True)


def _as_sure(one: GnssRecord, other: GnssRecord) -> bool:
    """Whether two sets of fixes state nearly the same standard deviations of the velocity."""
    a, b = one.vel_std_ned, other.vel_std_ned
    return a is not None and b is not None and bool(np.nanmax(np.abs(np.log(a / b))) < 0.05)


def with_sigma(gnss: GnssRecord, nominal: Nominal) -> GnssRecord:
    """The fixes with the believed standard deviations where they state none; velocities that are not believed are left out."""
    out = gnss.without_velocity() if nominal.gnss.velocity_sigma is None else gnss
    return out.with_sigma(nominal.gnss.position_sigma, nominal.gnss.velocity_sigma)


def scaled_fixes(gnss: GnssRecord, factors: Array) -> GnssRecord:
    """Fixes with other standard deviations: position, then velocity, north, east, down."""
    assert gnss.pos_std_ned is not None
    out = replace(gnss, pos_std_ned=gnss.pos_std_ned * factors[:3])
    return replace(out, vel_std_ned=out.vel_std_ned * factors[3:]) if out.vel_std_ned is not None else out


def _fast_part(imu: ImuRecord, k: int, name: str) -> Reduced:
    values, dt = imu.rates()[:, k], imu.dt
    lowest = min(rules().motion_hz, 0.5 * 0.5 / dt)
    values = without_motion(values[1:], dt, 0.6 * lowest)
    f, power, dof, quiet = moving_spectra(values, dt, lowest)
    return Reduced(name, "rad/s" if k < 3 else "m/s^2", dt, values, 1, np.zeros(0), f, power, dof, quiet=quiet)


def _trimmed(model: NoiseModel, fast: Reduced, named: float | None) -> NoiseModel:
    """White noise at the level of the fast part, inside the tolerance."""
    whites = [p for p in model if isinstance(p, WN)]
    if not whites or not fast.f.size:
        return model
    if named is not None:
        return NoiseModel(tuple(WN(named) if p is whites[0] else p for p in model))
    fitted = fit(Likelihood(fast), Explanation.nominal(model)).explanation.model
    seen = next(p for p in fitted if isinstance(p, WN)).parameters["N"]
    n0 = whites[0].parameters["N"]
    level = float(np.clip(seen, n0 / (1.0 + rules().tolerance), n0 * (1.0 + rules().tolerance)))
    return NoiseModel(tuple(WN(level) if p is whites[0] else p for p in model))
