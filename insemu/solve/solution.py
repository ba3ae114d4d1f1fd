"""Solve a recording: clock, designs, the score of each by automatic outages, the smoothed trajectory of the one to take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.errors import InputError
from insemu.evaluate import Verdict, lag_products, nis_test, whiteness_verdicts
from insemu.filters import FilterResult, LooselyCoupledEKF, SmootherResult, sigma_at, smooth, smoothed_at
from insemu.intake import Card
from insemu.noise import WN
from insemu.prepared import Drive, Stated, prepared
from insemu.records import AXES, Recording
from insemu.shown import Shown, few
from insemu.solve.beliefs import (
    AWAY,
    GRADES,
    Candidate,
    adapted,
    clock_offset,
    likelihood_of,
)
from insemu.solve.outages import HORIZONS, SETTLED_S, Gap, Outages, cut_everywhere, gaps_of, settled_at
from insemu.solve.outliers_of_fixes import outlying

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Say = Callable[[str], None]

#: Designs are compared by outages this far apart, s; the one that is taken is scored every second.
COARSE_S = 5.0
#: A clock offset is corrected where it exceeds this, s, and this many standard deviations.
OFFSET_S, OFFSET_SIGMAS = 0.005, 5.0
#: An offset moves the start, which moves the offset: so many rounds at most.
CLOCK_ROUNDS = 2
#: Outliers of the fixes raise the noise that hides others: so many rounds at most.
OUTLIER_ROUNDS = 4
#: Fixes that scatter by less than this of what they state are tried at what they scatter.
OVERSTATED = 0.8
#: Calibration states are tried on so many of the best designs.
BEST = 2
#: Speed from which the direction of the velocity in the body counts, m/s; scatter above which it tells no mounting, rad.
FORWARD_SPEED, FORWARD_SPREAD = 4.0, np.deg2rad(8.0)
#: Normalised squares per degree of freedom, of the innovations and of the errors after outages, of a design that knows its error well enough.
KNOWS = (0.3, 3.0)
#: A sensor that errs by so many times its own scatter from sample to sample is the suspect, whatever the verdict: up to 12 times on real drives
#: (samples that a filter in the sensor smoothed), without limit on an axis that is dead or holds something slow.
SUSPECT = 30.0


@dataclass(frozen=True)
class Scored:
    """One design on the drive.

    Parameters
    ----------
    candidate : Candidate
    run : FilterResult
    outages : Outages
    """

    candidate: Candidate
    run: FilterResult
    outages: Outages

    @property
    def nis(self) -> float:
        """Normalised innovation squared per degree of freedom."""
        used = self.run.fixes.accepted
        return float(self.run.fixes.nis[used].sum() / max(self.run.fixes.dof[used].sum(), 1))

    @property
    def factor(self) -> float:
        """By how much errors exceed what is stated: the root of the normalised square that is worst, of the innovations or after any outage.

        1 where all are inside :data:`KNOWS`, NaN without an outage.
        """
        after = [v for k in range(self.outages.horizons.size) if np.isfinite(v := self.outages.nees(k))]
        worst = max((self.nis, *after), key=lambda v: abs(np.log(max(v, 1e-300))))
        return np.nan if not after else 1.0 if KNOWS[0] <= worst <= KNOWS[1] else float(np.sqrt(worst))

    def figures(self) -> dict[str, Any]:
        """The score as plain data."""
        c = self.candidate
        return {
            "design": c.name,
            "states": self.run.layout.n,
            "about": c.about,
            "position_sigma_factor": c.position,
            "velocity_sigma_factor": c.velocity,
            "nis_per_dof": self.nis,
            "log_score": self.score,
            "outages": self.outages.figures(),
        }

    @property
    def score(self) -> float:
        """Mean logarithmic score of the horizontal errors over the horizons that the recording has room for; less is better.

        Half of ``e' S^-1 e + log det S`` (Good 1952): it is least for the right error with the right standard deviation, so that a design that
        drifts a little less but states a tenth of its error does not win.
        """
        known = [v for k in range(self.outages.horizons.size) if np.isfinite(v := self.outages.log_score(k))]
        return float(np.mean(known)) if known else np.inf


@dataclass(frozen=True)
class Mounting:
    """How the IMU sits in the vehicle, from the direction of the velocity in its axes and the mean vertical.

    Parameters
    ----------
    rpy : (3,) array
        Roll, pitch, heading of the rotation from IMU to vehicle axes, rad.
    sigma : (3,) array
        Standard deviations from the scatter of minutes, rad.
    spread : float
        Standard deviation of the direction of the velocity in the body, rad.
    """

    rpy: Array
    sigma: Array
    spread: float


@dataclass(frozen=True)
class Track:
    """A smoothed trajectory at epochs of the IMU.

    Parameters
    ----------
    t : (m,) array
        s.
    nav : (m, 10) array
        Latitude, longitude, height, velocity, quaternion.
    sigma : (m, n) array
        Standard deviations of all states.
    """

    t: Array
    nav: Array
    sigma: Array

    @classmethod
    def of(cls, candidate: Candidate, drive: Drive, rate: float) -> Track:
        """The way of a candidate at about so many epochs per second, the nearest that divides the rate of the IMU.

        Raises
        ------
        InputError
            A rate that is not positive, or beyond the IMU's.
        """
        if not 0.0 < rate <= 1.01 / drive.imu.dt:
            raise InputError(
                f"is {rate:g} Hz, expected a rate up to the {1.0 / drive.imu.dt:.6g} Hz of the IMU", where="rate"
            )
        every = max(1, round(1.0 / (rate * drive.imu.dt)))
        run = flown(candidate.filter(drive, store="fixes", node_every=1.0, output_every=every), drive, candidate)
        smoothed = smooth(run)
        rows = np.flatnonzero((run.t >= smoothed.t[0]) & (run.t <= smoothed.t[-1]))
        t = run.t[rows]
        return cls(t, smoothed_at(run, smoothed, rows), sigma_at(smoothed, t))


@dataclass(frozen=True, repr=False)
class Solution(Shown):
    """A solved recording.

    Parameters
    ----------
    drive : Drive
    card : Card
    tried : tuple of Scored
        Every design, the best first, by outages :data:`COARSE_S` apart.
    taken : Scored
        The best, by outages every second.
    smoothed : SmootherResult
    verdicts : tuple of Verdict
        NIS and whiteness of the innovations.
    mounting : Mounting or None
    clock : (float, float)
        By how much the stamps of the IMU are late against those of the fixes, and its standard deviation, s.
    gaps : tuple of Gap
        Times without fixes in the recording itself.
    track : Track, optional
        The smoothed trajectory at another rate than that of the nodes, where it was asked for.
    """

    drive: Drive
    card: Card
    tried: tuple[Scored, ...]
    taken: Scored
    smoothed: SmootherResult
    verdicts: tuple[Verdict, ...]
    mounting: Mounting | None
    clock: tuple[float, float]
    gaps: tuple[Gap, ...] = ()
    track: Track | None = None

    def __str__(self) -> str:
        d, late = self.drive, self.clock
        head = f"{d.source}: {self.taken.candidate.name} taken of {len(self.tried)} designs"
        lines = [
            f"  {o['seconds']:g} s without GNSS: rms {o['rms_m']:.3g} m, half below {o['median_m']:.3g} m, stated {o['stated_m']:.3g} m "
            f"({o['count']} outages)"
            for o in self.taken.outages.figures()
            if o["count"]
        ]
        span = f"  {d.aligned.t:.6g} to {d.imu.t[-1]:.6g} s, {len(d.gnss)} fixes; NIS per degree of freedom {self.taken.nis:.3g}"
        return few([head, span, *lines, f"  the stamps of the IMU are {late[0]:+.4f} s late (sigma {late[1]:.4f} s)"])

    def to_dataframe(self) -> pd.DataFrame:
        """One row per design that was tried and length of outage, the best first."""
        import pandas as pd

        rows = []
        for figures in (s.figures() for s in self.tried):
            outages = figures.pop("outages")
            for outage in (o for o in outages if o["count"]):
                low, high = outage.pop("rms_ci95_m")
                rows.append({**figures, **outage, "rms_low_m": low, "rms_high_m": high})
        return pd.DataFrame(rows).drop(columns="about").set_index(["design", "seconds"])

    @property
    def suspects(self) -> dict[str, float]:
        """Axes whose white noise, as the innovations ask for it, exceeds by :data:`SUSPECT` times what their samples scatter, and by how much.

        Noise from sample to sample is white noise at least; an axis that errs by far more is dead, holds another quantity, is scaled or turned
        wrongly.
        """
        d, imu = self.drive, self.drive.imu.as_increments()
        out: dict[str, float] = {}
        adapted = [s.candidate for s in self.tried if s.candidate.name.startswith("adapted by axis")]
        steps: Array = np.std(np.diff(np.hstack([imu.gyro, imu.accel])[1:], axis=0), axis=0)
        for a, own in zip(AXES, (steps / np.sqrt(2.0 * d.imu.dt)).tolist(), strict=True):
            asked = max((p.parameters["N"] for c in adapted for p in c.belief[a] if isinstance(p, WN)), default=0.0)
            if asked > SUSPECT * own:
                out[a] = asked / own if own > 0.0 else np.inf
        return out

    @property
    def biases(self) -> dict[str, tuple[float, float, float]]:
        """See :func:`biases_of`."""
        return biases_of(self.drive, self.taken.candidate, self.smoothed)

    @property
    def estimated(self) -> list[tuple[str, float, float, float]]:
        """States beside navigation at the end: name, smoothed estimate, its standard deviation, and that at the start (SI)."""
        names = self.smoothed.layout.names[9:]
        last, sigma = self.smoothed.imu_states[-1], self.smoothed.sigma[-1, 9:]
        nodes = self.taken.run.nodes
        assert nodes is not None
        before = np.sqrt(np.maximum(np.diag(nodes.P_before[0])[9:], 0.0))
        return [(n, float(v), float(s), float(b)) for n, v, s, b in zip(names, last, sigma, before, strict=True)]


def solve(
    recording: Recording,
    card: Card,
    beliefs: Sequence[Candidate],
    *,
    lever_arm: Sequence[float] | None = None,
    rate: float | None = None,
    workers: int = 1,
    say: Say = lambda text: None,
) -> Solution:
    """Solve a recording.

    Parameters
    ----------
    recording : Recording
    card : Card
        Its intake card.
    beliefs : sequence of Candidate
        What is tried; see :func:`insemu.solve.beliefs.candidates`.
    lever_arm : (3,) sequence of float, optional
        IMU to antenna in the axes of the recording, m.
    rate : float, optional
        Of the trajectory, Hz; that of the nodes, one a second, where it is not given.
    workers : int
        Threads for the outages.
    say : callable
        Told what is being done.

    Raises
    ------
    InputError
        No fixes, no way to start, too little data after it, or no design with which the filter runs.
    """
    drive = prepared(recording.as_measured(), Stated() if lever_arm is None else Stated(lever_arm))
    say("start")
    drive = drive.started(card)
    begins, ends, needed = drive.aligned.t, float(drive.imu.t[-1]), SETTLED_S + HORIZONS[0]
    if ends - begins < needed:
        raise InputError(
            f"the filter can start at {begins:.6g} s and the data end at {ends:.6g} s, expected at least {needed:g} s between",
            where=recording.source,
        )
    say("clock and noise of the innovations")
    base = likeliest_grade(beliefs, drive)
    own = adapted(base, drive)
    for _ in range(CLOCK_ROUNDS):
        late, sigma = clock_offset(own, drive)
        if not abs(late) > max(OFFSET_S, OFFSET_SIGMAS * sigma):
            break
        drive = drive.shifted(late).started(card)
        own = adapted(base, drive)
    own = max((own, adapted(base, drive, away=AWAY)), key=likelihood_of(drive))
    say("outliers of the fixes")
    drive, own = without_outliers(drive, base, own)
    scattering = adapted(own, drive, overstated=True)
    settled = settled_at(flown(own.filter(drive, store="fixes"), drive, own))
    drive = replace(drive, scatter=(scattering.position, scattering.velocity), settled=settled)
    tried: list[Scored] = []
    refused: list[str] = []

    def attempt(candidate: Candidate) -> None:
        try:
            tried.append(scored(candidate, drive, COARSE_S, workers))
        except InputError as error:
            refused.append(error.message)

    say(f"design {own.name}")
    attempt(own)
    if min(scattering.position / own.position, scattering.velocity / own.velocity) < OVERSTATED:
        attempt(scattering)
    # the noise of the fixes is theirs, not the design's
    fixes = min(tried, key=lambda s: s.score).candidate if tried else own
    say("noise of each axis")
    for one in (adapted(fixes, drive, by_axis=True, overstated=fixes is scattering), *beliefs):
        say(f"design {one.name}")
        attempt(replace(one, position=fixes.position, velocity=fixes.velocity))
    tried.sort(key=lambda s: s.score)
    if not tried:
        raise InputError(f"no design runs on this recording: {refused[0]}", where=recording.source)
    for best in tuple(tried[:BEST]):
        say(f"design {best.candidate.name} with calibration states")
        attempt(best.candidate.calibrating())
    tried.sort(key=lambda s: s.score)
    say("outages every second, smoother")
    taken = scored(tried[0].candidate, drive, 1.0, workers)
    smoothed = smooth(taken.run)
    late, sigma = clock_offset(taken.candidate, drive)
    clock = (drive.clock + late, sigma)
    verdicts, gaps = verdicts_of(taken.run), tuple(gaps_of(taken.run))
    track = None if rate is None else Track.of(taken.candidate, drive, rate)
    return Solution(drive, card, tuple(tried), taken, smoothed, verdicts, mounting_of(smoothed), clock, gaps, track)


def without_outliers(drive: Drive, base: Candidate, own: Candidate) -> tuple[Drive, Candidate]:
    """Leave out the fixes that all others contradict, and adapt the belief anew.

    Parameters
    ----------
    drive : Drive
        With a start.
    base, own : Candidate
        The grade, and what was adapted from it on all fixes.

    Returns
    -------
    Drive, Candidate
        The same where there is no outlier.
    """
    all_fixes, gone, velocities, largest = drive.gnss, np.zeros(0), np.zeros(0), 0.0
    for _ in range(OUTLIER_ROUNDS):
        found = outlying(flown(own.filter(drive, store="fixes"), drive, own))
        if not found.positions.size and not found.velocities.size:
            break
        gone, velocities = np.union1d(gone, found.positions), np.union1d(velocities, found.velocities)
        largest = max(largest, found.largest)
        drive = replace(drive, gnss=all_fixes.without_positions(gone).without_velocities(velocities))
        own = adapted(base, drive)
    parts = [
        f"{times.size} of {len(all_fixes)} {name}{farthest}"
        for times, name, farthest in (
            (gone, "positions", f" (up to {largest:.3g} m away)"),
            (velocities, "velocities", ""),
        )
        if times.size
    ]
    if parts:
        said = f"{' and '.join(parts)} of the fixes are outliers, which all others contradict: they are left out"
        drive = replace(drive, said=(*drive.said, said))
    return drive, own


def likeliest_grade(beliefs: Sequence[Candidate], drive: Drive) -> Candidate:
    """The generic grade under which the innovations are likeliest."""
    value = likelihood_of(drive)
    grades = [c for c in beliefs if c.name in GRADES]
    return max(grades, key=value)


def scored(candidate: Candidate, drive: Drive, every: float, workers: int) -> Scored:
    """Fly a candidate over the whole drive and cut outages every so many seconds.

    Parameters
    ----------
    candidate : Candidate
    drive : Drive
        With a start.
    every : float
        s.
    workers : int
        Threads.

    Raises
    ------
    InputError
        Navigation diverges, or the run is too short for an outage.
    """
    ekf = candidate.filter(drive, store="fixes", node_every=1.0, output_every=max(1, round(1.0 / drive.imu.dt)))
    run = flown(ekf, drive, candidate)
    imu, _ = drive.flown(ekf)
    return Scored(
        candidate,
        run,
        cut_everywhere(ekf, run, imu, drive.scattered(), settled=drive.settled, every=every, workers=workers),
    )


def flown(ekf: LooselyCoupledEKF, drive: Drive, candidate: Candidate) -> FilterResult:
    """One run over the whole drive.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    drive : Drive
        With a start.
    candidate : Candidate
        Whose standard deviations of the fixes are used.
    """
    imu, gnss = drive.flown(ekf)
    return ekf.run(imu, candidate.fixes(gnss), drive.aligned.state, candidate.start_sigma(drive), aids=drive.aids)


def biases_of(drive: Drive, candidate: Candidate, smoothed: SmootherResult) -> dict[str, tuple[float, float, float]]:
    """Of every axis the bias at the end, its standard deviation, and the part that was taken off before the filter began, rad/s or m/s^2.

    Parameters
    ----------
    drive : Drive
        With a start.
    candidate : Candidate
        Whose filter was smoothed.
    smoothed : SmootherResult
    """
    aug = candidate.filter(drive).augmentation
    before = drive.aligned.bias_beyond(aug.turn_on_sigma())
    x, P = smoothed.imu_states[-1], smoothed.covariance[-1, 9:, 9:]
    out: dict[str, tuple[float, float, float]] = {}
    for k, a in enumerate(AXES):
        c, off = np.where((aug.axis == k) & (aug.driver < 0), aug.c, 0.0), float(before[k])
        out[a] = (off + float(c @ x), float(np.sqrt(max(float(c @ P @ c), 0.0))), off)
    return out


def verdicts_of(run: FilterResult) -> tuple[Verdict, ...]:
    """NIS and the whiteness of the innovations."""
    return (nis_test(run.fixes), *whiteness_verdicts(*lag_products(run.fixes)))


def mounting_of(smoothed: SmootherResult) -> Mounting | None:
    """Mounting of a vehicle that moves along its own forward axis; None where the velocity keeps no direction in the body."""
    nav = smoothed.nav
    fast = np.hypot(nav[:, 3], nav[:, 4]) > FORWARD_SPEED
    if fast.sum() < 60:
        return None
    C = rotation.dcm_from_quaternion(nav[fast, 6:10])
    along = np.einsum("kji,kj->ki", C, nav[fast, 3:6])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    down, t = C[:, 2], smoothed.t[fast]
    spread = float(np.sqrt(np.mean(np.sum((along - along.mean(axis=0)) ** 2, axis=1)) / 2.0))
    if spread > FORWARD_SPREAD:
        return None
    whole = _axes(along.mean(axis=0), down.mean(axis=0))
    minute = ((t - t[0]) // 60.0).astype(int)
    parts = [
        rotation.vector_from_dcm(_axes(along[minute == m].mean(axis=0), down[minute == m].mean(axis=0)) @ whole.T)
        for m in np.unique(minute)
        if (minute == m).sum() >= 20
    ]
    sigma = np.std(parts, axis=0, ddof=1) / np.sqrt(len(parts)) if len(parts) > 2 else np.full(3, np.nan)
    return Mounting(rotation.rpy_from_dcm(whole), np.asarray(sigma), spread)


def _axes(forward: Array, down: Array) -> Array:
    """The rotation to axes of which x is ``forward`` and z as near to ``down`` as can be, (3, 3)."""
    x = forward / np.linalg.norm(forward)
    z = down - (down @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])
