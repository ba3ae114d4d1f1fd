"""Alignment in motion, from whatever the fixes are and however the IMU is mounted.

The gyroscopes carry the attitude relative to the start, and in those axes the accelerometers integrate to velocity and place; what is unknown
is the attitude at the start (three angles), place and velocity there, and the biases. Fixes of positions, velocities or both are linear in all of
them but the angles, so least squares with priors on the biases (Gauss-Newton from several headings) gives the start, its covariance, and
whether another heading would do as well. The velocity-vector form of it is Wu and Pan (2013); here the fixes are used as they come, with
their own noise, so that the noise of a slow vehicle's fixes never counts as motion.

That holds over the seconds in which the noise of the gyroscopes does not matter. The stretch is grown until the heading is known coarsely; from
there on the filter itself does the rest, on the fixes that follow. Where the first motion does not tell it, later motion may; a record that
never tells the heading is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, level, sigma_of_fixes
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.integrals import Integrals
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.rest import BIAS_SIGMA, Quiet, quiet_stretches
from insemu.noise import RC, WN
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Lengths of the stretch that are tried one after another, s.
STRETCHES = (5.0, 10.0, 20.0, 40.0, 80.0)
#: Where the first motion does not tell the heading, later ones so many seconds apart may.
AGAIN_S = 40.0
#: A stretch is long enough when the heading's standard deviation is below this, rad; the filter goes on to the second, or ends at the third
#: (`python -m tests.start_cases 24`).
COARSE, FINE, WORST = np.deg2rad([10.0, 2.0, 5.0])
#: Normalised residuals or innovations squared per degree of freedom from which least squares or the filter is on a wrong solution.
LOST = 9.0
#: Standard deviation of a bias of the accelerometers, m/s^2 (consumer MEMS, 30 mg).
ACCEL_BIAS = 0.3
#: A solution with a bias of more than this many of those standard deviations is a wrong one.
IMPLAUSIBLE = 10.0
#: Errors of positions that last (ionosphere, multipath) move by their standard deviation in so many seconds.
DRIFT_S = 30.0
#: Unknowns: place, velocity, attitude at the start, biases of gyroscopes and accelerometers, drift of the fixes.
SIZE = 18
#: Numbers of one axis that a residual is linear in: place, velocity, drift, and a row of the attitude times 1 and each bias.
LINEAR = 24
#: Factor on what least squares says, for what it does not know: noise of the IMU, scale factors, errors of fixes that last for seconds.
CAUTION = 1.5
#: Least standard deviations at the start: tilt, heading (rad), velocity (m/s).
LEAST_TILT, LEAST_HEADING, LEAST_VELOCITY = np.deg2rad(0.3), np.deg2rad(1.0), 0.05
#: Headings that the search starts from, and by what another one has to be worse (chi-square, 1 degree of freedom, 1e-4).
HEADINGS, WORSE = 8, 15.1
#: Least squares turn by no more than this at once, rad, and end where a turn promises less of chi-square than the second.
LONGEST_TURN, GAIN = 0.7, 1e-6
#: Rounds of least squares at most between two renewals of what is linear in the biases, and how many times it is renewed for a stretch.
ROUNDS, RENEWED = 8, 3
#: Attitudes that are further apart than this are two solutions, rad.
APART = 0.3
#: Fixes kept of a stretch at most, and the step that the IMU is summed to, s.
MOST_FIXES, STEP_S = 400, 0.02


@dataclass(frozen=True)
class _Fit:
    """Least squares over one stretch: attitude at its start, the unknowns (:data:`SIZE`) with their covariance, and chi-square."""

    C: Array
    x: Array
    covariance: Array
    chi2: float
    dof: int
    integrals: Integrals
    span: float

    @property
    def heading_sigma(self) -> float:
        """Standard deviation of the heading at the end, rad, as scaled by the residuals."""
        return float(np.sqrt(self.end_covariance()[8, 8]))

    @property
    def plausible(self) -> bool:
        """Whether residuals and biases are of a size that a right solution has."""
        biases = np.abs(self.x[9:15]) / np.repeat([BIAS_SIGMA, ACCEL_BIAS], 3)
        return bool(self.chi2 <= LOST * max(self.dof, 1) and biases.max() <= IMPLAUSIBLE)

    def scale(self) -> float:
        """Factor on variances: residuals larger than stated, and :data:`CAUTION`."""
        return CAUTION**2 * max(1.0, self.chi2 / max(self.dof, 1))

    def end_covariance(self) -> Array:
        """Of place, velocity, attitude at the last fix, and of the biases, (15, 15)."""
        i, C, t = self.integrals, self.C, self.span
        J = np.eye(15)
        J[0:3, 3:6] = t * np.eye(3)
        J[0:3, 6:9] = -rotation.skew(C @ i.place[-1])
        J[3:6, 6:9] = -rotation.skew(C @ i.velocity[-1])
        J[0:3, 9:12], J[0:3, 12:15] = C @ i.p_bg[-1], C @ i.p_ba[-1]
        J[3:6, 9:12], J[3:6, 12:15] = C @ i.v_bg[-1], C @ i.v_ba[-1]
        J[6:9, 9:12] = -C @ i.T[-1]
        return np.asarray(self.scale() * J @ self.covariance[:15, :15] @ J.T)


class _Flight(NamedTuple):
    """Increments of an IMU, all usable fixes, the lever arm (3,), the gravity model, and densities of white noise (gyroscopes, accelerometers)."""

    imu: ImuRecord
    fixes: GnssRecord
    lever_arm: Array
    gravity: str
    noise: tuple[float, float]


@dataclass(frozen=True)
class _Stretch:
    """Fixes of a stretch in metres from the first, times from the start, and the IMU over it."""

    imu: ImuRecord
    t: Array
    place: Array
    velocity: Array
    place_sigma: Array
    velocity_sigma: Array
    gravity: float
    earth_rate: Array
    lever_arm: Array

    def integrals(self, C: Array, bias: Array) -> Integrals:
        """The IMU over the stretch less ``bias`` (6,), started in the attitude ``C``."""
        return Integrals.of(self.imu, self.t + self.imu.t[0], bias, C.T @ self.earth_rate, self.lever_arm)

    def _compressed(self, i: Integrals) -> Array:
        """The fixes as at most :data:`LINEAR` + 1 rows for each axis, (3, k, LINEAR + 1), which any start has the same residuals of.

        A residual is linear in place, velocity and drift of its axis, in the attitude's row of that axis, and in that row times each bias: an
        orthogonal transformation of the weighted fixes (QR) leaves their squares as they are.
        """
        t, none, one = self.t[:, None], np.zeros((self.t.size, 1)), np.ones((self.t.size, 1))
        down = np.array([0.0, 0.0, self.gravity])
        # the attitude at the fix moves with the gyroscope's bias, and the antenna with it
        parts = (
            ([one, t, t], i.place, i.p_bg, i.p_ba, i.arm, self.place - 0.5 * down * t**2, self.place_sigma),
            ([none, one, none], i.velocity, i.v_bg, i.v_ba, i.swing, self.velocity - down * t, self.velocity_sigma),
        )
        rows = []
        for start, moved, by_gyro, by_accel, antenna, left, sigma in parts:
            by = np.concatenate(
                [(moved + antenna)[:, :, None], by_gyro + rotation.skew(antenna) @ i.T, by_accel], axis=2
            ).reshape(-1, 21)
            weight = np.where(np.isfinite(left) & np.isfinite(sigma), 1.0 / sigma, 0.0)
            linear = np.broadcast_to(np.hstack([*start, by]), (3, self.t.size, LINEAR))
            rows.append(np.concatenate([linear, np.nan_to_num(left).T[:, :, None]], axis=2) * weight.T[:, :, None])
        return np.asarray(np.linalg.qr(np.concatenate(rows, axis=1), mode="r"))

    def solve(self, C: Array, x: Array, prior: tuple[Array, Array], integrals: list[Integrals]) -> list[_Fit]:
        """Gauss-Newton from several attitudes ``C`` (h, 3, 3) and the rest of each estimate ``x`` (h, 18), side by side.

        ``prior`` is the mean (6,) and covariance (6, 6) of the biases; the ``integrals``, of each or one for all, are linear in the biases about
        those they were made with.
        """
        information, mean = np.zeros((SIZE, SIZE)), np.concatenate([np.zeros(9), prior[0], np.zeros(3)])
        information[6:9, 6:9] = np.eye(3) / np.pi**2  # no angle is less certain than half a turn
        information[9:15, 9:15] = np.linalg.inv(prior[1])
        information[15:, 15:] = np.diag((DRIFT_S / np.nanmin(self.place_sigma, axis=0)) ** 2)
        rows, bias = np.stack([self._compressed(i) for i in integrals]), np.stack([i.bias for i in integrals])
        dof = (
            int(
                np.isfinite(self.place * self.place_sigma).sum()
                + np.isfinite(self.velocity * self.velocity_sigma).sum()
            )
            - 9
        )
        least, best, going = (
            np.full(len(C), np.inf),
            [(C[0], x[0], information)] * len(C),
            np.ones((len(C), 1), dtype=bool),
        )
        for _ in range(ROUNDS):
            left, H = _residuals(rows, C, x, bias)
            away = np.where(np.arange(SIZE) < 9, 0.0, x - mean)
            total = information + H.swapaxes(1, 2) @ H
            cost = (left**2).sum(axis=1) + ((away @ information) * away).sum(axis=1)
            right = (left[:, None] @ H)[:, 0] - away @ information
            scale = 1.0 / np.sqrt(np.diagonal(total, axis1=1, axis2=2))
            both = scale[:, :, None] * scale[:, None]
            covariance = np.linalg.inv(total * both) * both
            for k in np.flatnonzero(cost < least):
                least[k], best[k] = cost[k], (C[k], x[k], covariance[k])
            move = np.where(going, (covariance @ right[:, :, None])[:, :, 0], 0.0)
            size = np.linalg.norm(move[:, 6:9], axis=1, keepdims=True)
            move *= np.minimum(1.0, LONGEST_TURN / np.maximum(size, LONGEST_TURN))
            C = rotation.dcm_from_vector(move[:, 6:9]) @ C
            x = (x + move) * ((np.arange(SIZE) < 6) | (np.arange(SIZE) >= 9))
            going &= ((right[:, None] @ move[:, :, None])[:, 0] >= GAIN) | (size > LONGEST_TURN)
            if not going.any():
                break
        of = integrals if len(integrals) > 1 else integrals * len(C)
        return [_Fit(*b, float(c), dof, i, float(self.t[-1])) for b, c, i in zip(best, least, of, strict=True)]

    def best(self, prior: tuple[Array, Array], near: list[_Fit]) -> tuple[list[_Fit], float]:
        """Different fits, the best first, and by how much the second is worse.

        They begin at those of a shorter stretch, ``near``, and where there are none at several headings. What is linear in the biases is renewed
        after each turn, so that a long stretch does not lose what a short one has found.
        """
        fits = near
        if not fits:
            again = [self.integrals(np.zeros((3, 3)), prior[0])]
            # over the stretch the specific force points up but for the change of velocity
            roll, pitch = level(again[0].velocity[-1])
            headings = np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS - np.pi
            x = np.tile(np.concatenate([np.zeros(9), prior[0], np.zeros(3)]), (HEADINGS, 1))
            C = rotation.dcm_from_rpy(np.stack(np.broadcast_arrays(roll, pitch, headings), axis=1))
        for _ in range(RENEWED):
            if fits:
                again = [self.integrals(f.C, f.x[9:15]) for f in fits]
                C, x = np.stack([f.C for f in fits]), np.stack([f.x for f in fits])
            fits = []
            for fit in sorted(self.solve(C, x, prior, again), key=lambda f: f.chi2):
                if all(_two_solutions(fit, f) for f in fits):
                    fits.append(fit)
        return fits, (fits[1].chi2 - fits[0].chi2) / fits[0].scale() if len(fits) > 1 else np.inf


def _two_solutions(one: _Fit, other: _Fit) -> bool:
    """Whether the attitudes of two fits are two solutions."""
    return bool(np.linalg.norm(rotation.vector_from_dcm(one.C @ other.C.T)) >= APART)


def _residuals(rows: Array, C: Array, x: Array, bias: Array) -> tuple[Array, Array]:
    """Residuals (h, 3 k) at estimates of the rows (h or 1, 3, k, :data:`LINEAR` + 1) that :meth:`_Stretch._compressed` gives, and their derivatives
    (h, 3 k, 18) by what the estimates are off; ``bias`` (h or 1, 6) is that of the integrals.
    """
    h = len(C)
    by = np.concatenate([np.ones((h, 1)), x[:, 9:15] - bias], axis=1)
    linear = np.empty((h, 3, LINEAR))
    linear[:, :, :3] = np.stack([x[:, :3], x[:, 3:6], x[:, 15:]], axis=2)
    linear[:, :, 3:] = (C[..., None] * by[:, None, None]).reshape(h, 3, 21)
    moved = np.zeros((h, 3, LINEAR, SIZE))
    axis, k = np.arange(3), np.arange(6)
    for row, first in enumerate((0, 3, 15)):
        moved[:, axis, row, first + axis] = 1.0
    turned = moved[:, :, 3:].reshape(h, 3, 3, 7, SIZE)
    turned[..., 6:9] = (
        np.moveaxis(rotation.skew(np.eye(3)) @ C[:, None], 1, -1)[..., None, :] * by[:, None, None, :, None]
    )
    turned[:, :, :, 1 + k, 9 + k] = C[..., None]
    moved[:, :, 3:] = turned.reshape(h, 3, 21, SIZE)
    left = rows[..., LINEAR] - (rows[..., :LINEAR] @ linear[..., None])[..., 0]
    return left.reshape(h, -1), (rows[..., :LINEAR] @ moved).reshape(h, -1, SIZE)


def _thinned(r: ImuRecord) -> ImuRecord:
    """Increments of about :data:`STEP_S`, so that the work does not grow with the rate."""
    n = max(1, int(STEP_S / r.dt))
    if n == 1:
        return r
    starts = np.arange(1, len(r), n)
    last = np.minimum(starts + n - 1, len(r) - 1)
    gyro, accel = (np.add.reduceat(v[1:], starts - 1, axis=0) for v in (r.gyro, r.accel))
    return ImuRecord(
        np.concatenate([r.t[:1], r.t[last]]),
        np.concatenate([gyro[:1], gyro]),
        np.concatenate([accel[:1], accel]),
        "increment",
    )


def _stretch(flight: _Flight, start: int, stop: int) -> _Stretch:
    """Fixes ``start`` to ``stop`` (included) and the IMU from the first to the last."""
    r, gnss, lever_arm, gravity, noise = flight
    every = max(1, (stop - start) // MOST_FIXES)
    rows = np.unique(np.append(np.arange(start, stop + 1, every), stop))
    fixes = gnss.rows(np.isin(np.arange(len(gnss)), rows))
    assert fixes.pos_std_ned is not None
    k = int(np.searchsorted(r.t, fixes.t[0] + 1e-9)) - 1
    last = int(np.searchsorted(r.t, fixes.t[-1])) + 1
    nothing = np.full((len(fixes), 3), np.nan)
    g = float(earth.gravity(fixes.llh[0, 0], fixes.llh[0, 2], gravity))
    t = np.maximum(fixes.t - r.t[max(k, 0)], 0.0)[:, None]
    # what white noise of the gyroscopes (as tilt) and of the accelerometers has become since the start
    v_noise = np.hypot(g * noise[0] * t**1.5 / np.sqrt(3.0), noise[1] * t**0.5)
    p_noise = np.hypot(g * noise[0] * t**2.5 / np.sqrt(20.0), noise[1] * t**1.5 / np.sqrt(3.0))
    return _Stretch(
        imu=r.rows(slice(max(k, 0), last + 1)),
        t=t[:, 0],
        place=earth.position_difference(fixes.llh, fixes.llh[0]),
        velocity=nothing if fixes.vel_ned is None else np.asarray(fixes.vel_ned),
        place_sigma=np.hypot(fixes.pos_std_ned, p_noise),
        velocity_sigma=nothing if fixes.vel_std_ned is None else np.hypot(fixes.vel_std_ned, v_noise),
        gravity=g,
        earth_rate=earth.earth_rate(float(fixes.llh[0, 0])),
        lever_arm=lever_arm,
    )


def _moves_from(gnss: GnssRecord) -> list[int]:
    """Fixes from which on places change by more than their noise within ten seconds: the first, and further ones :data:`AGAIN_S` apart."""
    assert gnss.pos_std_ned is not None
    ahead = np.minimum(np.searchsorted(gnss.t, gnss.t + 10.0), len(gnss) - 1)
    moved = np.linalg.norm(earth.position_difference(gnss.llh[ahead], gnss.llh)[:, :2], axis=1)
    limit = np.maximum(3.0, 6.0 * np.linalg.norm(gnss.pos_std_ned[:, :2], axis=1))
    out: list[int] = []
    for k in np.flatnonzero(moved > limit):
        if not out or gnss.t[k] - gnss.t[out[-1]] >= AGAIN_S:
            out.append(int(k))
    return out or [0]


def align_in_motion(
    imu: ImuRecord,
    gnss: GnssRecord,
    *,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    gravity: str = "normal",
    longest: float = 160.0,
) -> Alignment:
    """Align a drive that starts from nothing: level, heading, velocity and the gyroscopes' bias from the fixes.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
        With positions, velocities or both; standard deviations that it does not state are taken from the data
        (:func:`~insemu.filters.alignment.sigma_of_fixes`).
    lever_arm : (3,)
        From IMU to antenna in the axes of the IMU record, m.
    gravity : str
        See :mod:`insemu.earth`.
    longest : float
        Longest stretch to use, s.

    Returns
    -------
    Alignment
        At the last fix of the stretch that was used.

    Raises
    ------
    InputError
        Too few fixes, or a vehicle that does not move enough to tell its heading.
    """
    r = imu.as_increments()
    known = sigma_of_fixes(gnss)
    good = np.isfinite(known.llh).all(axis=1) & (known.t >= r.t[0]) & (known.t <= r.t[-1])
    if good.sum() < 5:
        raise InputError(f"{int(good.sum())} fixes with positions during the IMU record, expected at least 5")
    fixes = known.rows(good)
    quiet = quiet_stretches(imu, gnss)
    prior = _bias_prior(quiet)
    flight = _Flight(r, fixes, np.asarray(lever_arm, dtype=np.float64), gravity, white_noise(r))
    coarse = flight._replace(imu=_thinned(r))
    said = "fewer than five fixes after the first motion"
    for start in _moves_from(fixes):
        near: list[_Fit] = []
        for span in STRETCHES:
            stop = int(np.searchsorted(fixes.t, fixes.t[start] + min(span, longest) + 1e-6)) - 1
            if stop - start < 4:
                continue
            stretch = _stretch(coarse, start, stop)
            near, margin = stretch.best(prior, near)
            fit = near[0]
            said = f"its standard deviation after {stretch.t[-1]:.0f} s is {np.rad2deg(min(fit.heading_sigma, np.pi)):.1f} deg"
            if fit.heading_sigma <= COARSE and margin > WORSE and fit.plausible:
                found = _refined(fit, stretch, flight, longest)
                if found is not None:
                    return replace(found, standstill=tuple((q.start, q.end) for q in quiet if q.still))
                said = "the filter does not settle on it"
            if span >= longest or stop == len(fixes) - 1:
                break
    raise InputError(f"the vehicle does not move enough to tell the heading ({said}); give a start, or a longer record")


def _bias_prior(quiet: list[Quiet]) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of the biases, from the longest quiet stretch where there is one."""
    mean, covariance = np.zeros(6), np.diag(np.repeat([BIAS_SIGMA, ACCEL_BIAS], 3) ** 2)
    if quiet:
        mean[:3], covariance[:3, :3] = max(quiet, key=lambda q: (q.still, q.end - q.start)).bias()
    return mean, covariance


def white_noise(r: ImuRecord) -> tuple[float, float]:
    """Densities of the white noise of gyroscopes and accelerometers (vibration included), from what is fastest in a record."""
    second = np.diff(r.rates()[1:], n=2, axis=0)
    sigma = 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0)
    density = sigma * np.sqrt(r.dt)
    return max(float(density[:3].max()), 1e-6), max(float(density[3:].max()), 1e-5)


def _refined(fit: _Fit, stretch: _Stretch, flight: _Flight, longest: float) -> Alignment | None:
    """The filter from the end of a stretch on; None where it finds itself on a wrong solution or the heading stays unknown.

    Parameters
    ----------
    fit, stretch
        Least squares, and what it was made of.
    flight : _Flight
        With all fixes; those of the stretch are in the fit already.
    longest : float
        Seconds from the start of the stretch to go on for at most.
    """
    r, fixes, lever_arm, gravity, noise = flight
    begin = float(stretch.imu.t[0])
    here = begin + float(stretch.t[-1])
    first = int(np.searchsorted(r.t, here - 1e-9))
    last = max(int(np.searchsorted(r.t, begin + longest)), first + 2)
    span = r.rows(slice(first, last + 1))
    if len(span) < 2:
        return None
    state, covariance = _end_of(fit, stretch, fixes, float(r.t[first]) - here)
    belief = {"gyro": WN(N=noise[0]) + RC(sigma=float(BIAS_SIGMA)), "accel": WN(N=noise[1]) + RC(sigma=ACCEL_BIAS)}
    options = FilterOptions(output_every=max(1, round(1.0 / r.dt)))
    ekf = LooselyCoupledEKF(belief, r.dt, lever_arm=lever_arm, gravity=gravity, options=options)
    try:
        run = ekf.run(span, fixes, state, covariance, initial_states=fit.x[9:15])
    except InputError:
        return None
    dof = np.maximum(np.cumsum(run.fixes.dof), 1)
    size = np.maximum(1.0, np.concatenate([[0.0], np.cumsum(np.nan_to_num(run.fixes.nis)) / dof]))
    before = np.searchsorted(run.fixes.t, run.t, side="right")
    # the covariance at the start is cautious already
    scale = np.sqrt(size[before])
    fine = np.flatnonzero(run.sigma[:, 8] * scale <= FINE)
    k = int(fine[0]) if fine.size else len(run.t) - 1
    sd = run.sigma[k] * scale[k]
    if not sd[8] <= WORST or size[before[k]] > LOST:
        return None
    row = int(np.searchsorted(r.t, run.t[k] - 1e-9))
    nav = run.nav[k]
    return Alignment(
        t=float(r.t[row]),
        row=row,
        state=NavState(nav[:3], nav[3:6], rotation.rpy_from_quaternion(nav[6:10])),
        sigma=InitialSigma(
            sd[:3], np.maximum(sd[3:6], LEAST_VELOCITY), np.maximum(sd[6:9], [LEAST_TILT, LEAST_TILT, LEAST_HEADING])
        ),
        bias=run.imu_states[k],
        bias_sigma=sd[9:15],
        standstill=(),
    )


def _end_of(fit: _Fit, stretch: _Stretch, fixes: GnssRecord, late: float) -> tuple[NavState, Array]:
    """State at the end of a stretch, ``late`` seconds after its last fix, and the covariance (15, 15) of it and of the biases."""
    i, x, t = fit.integrals, fit.x, float(stretch.t[-1])
    bg, ba = x[9:12] - i.bias[:3], x[12:15] - i.bias[3:]
    down = np.array([0.0, 0.0, stretch.gravity])
    velocity = x[3:6] + down * t + fit.C @ (i.velocity[-1] + i.v_bg[-1] @ bg + i.v_ba[-1] @ ba)
    place = x[:3] + x[3:6] * t + 0.5 * down * t**2 + fit.C @ (i.place[-1] + i.p_bg[-1] @ bg + i.p_ba[-1] @ ba)
    C = rotation.dcm_from_quaternion(rotation.quaternion_from_vector(-fit.C @ i.T[-1] @ bg)) @ fit.C @ i.Q[-1]
    first = int(np.searchsorted(fixes.t, stretch.imu.t[0] + stretch.t[0] - 1e-9))
    llh = earth.move(fixes.llh[first], place + velocity * late)
    covariance = fit.end_covariance()
    assert fixes.pos_std_ned is not None
    # fixes that are wrong together are as wrong as each of them
    covariance[:3, :3] += np.diag(fixes.pos_std_ned[first] ** 2)
    return NavState(llh, velocity, rotation.rpy_from_dcm(C)), covariance
