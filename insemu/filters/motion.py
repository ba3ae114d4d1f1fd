"""Alignment in motion, from whatever the fixes are and however the IMU is mounted.

The gyroscopes carry the attitude relative to the start, and in those axes the accelerometers integrate to velocity and place; what is unknown
is the attitude at the start (three angles), place and velocity there, and the biases. Fixes of positions, velocities or both are linear in all of
them but the angles, so least squares with priors on the biases (Gauss-Newton from several headings) gives the start, its covariance, and
whether another heading would do as well. The velocity-vector form of it is Wu and Pan (2013); here the fixes are used as they come, with
their own noise, so that the noise of a slow vehicle's fixes never counts as motion.

That holds over the seconds in which the noise of the gyroscopes does not matter. The stretch is grown until the heading is told coarsely; from
there on the filter itself does the rest, on the fixes that follow. Where the first motion does not tell it, later motion may; a record that
never tells the heading is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.compiled import njit
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, level, sigma_of_fixes
from insemu.filters.ekf import LooselyCoupledEKF
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
#: A stretch is long enough when the heading's standard deviation is below this, rad; the filter goes on to the second, or ends at the third.
COARSE, FINE, WORST = np.deg2rad([8.0, 2.0, 5.0])
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
#: Factor on what least squares says, for what it does not know: noise of the IMU, scale factors, errors of fixes that last for seconds.
CAUTION = 1.5
#: Least standard deviations at the start: tilt, heading (rad), velocity (m/s).
LEAST_TILT, LEAST_HEADING, LEAST_VELOCITY = np.deg2rad(0.3), np.deg2rad(1.0), 0.05
#: Headings that the search starts from, and by what another one has to be worse (chi-square, 1 degree of freedom, 1e-4).
HEADINGS, WORSE = 8, 15.1
#: Attitudes that are further apart than this are two solutions, rad.
APART = 0.3
#: Fixes kept of a stretch at most, and the step that the IMU is summed to, s.
MOST_FIXES, STEP_S = 400, 0.02


@njit(cache=True, nogil=True)
def _chain(angles: Array, turn: Array, dt: Array, out: Array) -> None:
    """Attitudes (n, 3, 3) relative to the first, from angle increments (n, 3) and the rate of the local frame in the first axes (rad/s)."""
    Q = np.eye(3)
    out[0] = Q
    w = np.empty(3)
    for k in range(1, angles.shape[0]):
        for i in range(3):
            w[i] = angles[k, i] - (Q[0, i] * turn[0] + Q[1, i] * turn[1] + Q[2, i] * turn[2]) * dt[k]
        W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        size2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        if size2 > 1e-12:
            size = math.sqrt(size2)
            Q = Q + Q @ ((math.sin(size) / size) * W + ((1.0 - math.cos(size)) / size2) * (W @ W))
        else:
            Q = Q + Q @ (W + 0.5 * (W @ W))
        out[k] = Q


def attitudes(angles: Array, turn: Array, dt: Array) -> Array:
    """Attitudes (n, 3, 3) relative to the first.

    Parameters
    ----------
    angles : (n, 3) array
        Angle increments, rad.
    turn : (3,) array
        Rate of the local frame in the first axes, rad/s.
    dt : (n,) array
        Steps, s.
    """
    out = np.empty((len(angles), 3, 3))
    _chain(np.ascontiguousarray(angles), turn, np.ascontiguousarray(dt), out)
    return out


def _skew(v: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


@dataclass(frozen=True)
class _Integrals:
    """What the IMU says between the start of a stretch and each fix (f fixes), in the body axes at the start.

    ``Q`` (f, 3, 3) attitude, ``T`` its integral; ``velocity``, ``place`` (f, 3) integrals of the specific force; ``v_bg``, ``v_ba``, ``p_bg``,
    ``p_ba`` (f, 3, 3) their derivatives by the biases of gyroscopes and accelerometers; ``arm``, ``swing`` (f, 3) of the antenna; ``bias`` (6,)
    what was taken off.
    """

    Q: Array
    T: Array
    velocity: Array
    place: Array
    v_bg: Array
    p_bg: Array
    p_ba: Array
    arm: Array
    swing: Array
    bias: Array

    @property
    def v_ba(self) -> Array:
        """Derivative of the velocity by the accelerometers' biases."""
        return -self.T

    @classmethod
    def of(cls, r: ImuRecord, at: Array, bias: Array, turn: Array, lever_arm: Array) -> _Integrals:
        """Integrate a record of increments, less ``bias`` (6,), to the times ``at`` (f,); ``turn`` (3,) as in :func:`_chain`."""
        step = np.diff(r.t, prepend=r.t[0])
        width = step[:, None]
        angles, force = r.gyro - bias[:3] * width, r.accel - bias[3:] * width
        Q = attitudes(angles, turn, step)
        mid = Q + 0.5 * Q @ _skew(angles)
        mid = np.concatenate([Q[:1], Q[:-1] + (mid[1:] - Q[1:])]) if len(r) > 1 else Q
        dv = np.einsum("kij,kj->ki", mid, force)
        dv[0] = 0.0
        square = step[:, None, None]

        def summed(x: Array) -> Array:
            return np.cumsum(x, axis=0)

        def before(x: Array) -> Array:
            return np.concatenate([np.zeros_like(x[:1]), x[:-1]])

        T = summed(mid * square)
        velocity = summed(dv)
        v_bg = summed(_skew(dv) @ before(T))
        place = summed(before(velocity) * width + 0.5 * dv * width)
        p_bg = summed((before(v_bg) + 0.5 * np.diff(v_bg, axis=0, prepend=0.0)) * square)
        p_ba = -summed((before(T) + 0.5 * mid * square) * square)
        k = np.searchsorted(r.t, at).clip(1, len(r) - 1)
        share = (at - r.t[k - 1]) / step[k]

        def there(x: Array) -> Array:
            h = share.reshape(-1, *([1] * (x.ndim - 1)))
            return np.asarray((1.0 - h) * x[k - 1] + h * x[k])

        attitude = there(Q)
        near = angles[np.stack([k, np.minimum(k + 1, len(r) - 1)])].mean(axis=0) / step[k][:, None]
        arm = attitude @ lever_arm
        swing = np.einsum("kij,kj->ki", attitude, np.cross(near - np.einsum("kji,j->ki", attitude, turn), lever_arm))
        return cls(
            attitude, there(T), there(velocity), there(place), there(v_bg), there(p_bg), there(p_ba), arm, swing, bias
        )


@dataclass(frozen=True)
class _Fit:
    """Least squares over one stretch: attitude at its start, the unknowns (:data:`SIZE`) with their covariance, and chi-square."""

    C: Array
    x: Array
    covariance: Array
    chi2: float
    dof: int
    integrals: _Integrals
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
        J[0:3, 6:9] = -_skew(C @ i.place[-1])
        J[3:6, 6:9] = -_skew(C @ i.velocity[-1])
        J[0:3, 9:12], J[0:3, 12:15] = C @ i.p_bg[-1], C @ i.p_ba[-1]
        J[3:6, 9:12], J[3:6, 12:15] = C @ i.v_bg[-1], C @ i.v_ba[-1]
        J[6:9, 9:12] = -C @ i.T[-1]
        return np.asarray(self.scale() * J @ self.covariance[:15, :15] @ J.T)


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

    def integrals(self, C: Array, bias: Array) -> _Integrals:
        """The IMU over the stretch less ``bias`` (6,), started in the attitude ``C``."""
        return _Integrals.of(self.imu, self.t + self.imu.t[0], bias, C.T @ self.earth_rate, self.lever_arm)

    def solve(self, C: Array, x: Array, prior: tuple[Array, Array], i: _Integrals, rounds: int = 15) -> _Fit:
        """Gauss-Newton from the attitude ``C`` and the rest of the estimate ``x`` (18,).

        ``prior`` is the mean (6,) and covariance (6, 6) of the biases; the integrals are linear in the biases about those they were made with.
        """
        information = np.zeros((SIZE, SIZE))
        information[6:9, 6:9] = np.eye(3) / np.pi**2  # no angle is less certain than half a turn
        information[9:15, 9:15] = np.linalg.inv(prior[1])
        information[15:, 15:] = np.diag((DRIFT_S / np.nanmin(self.place_sigma, axis=0)) ** 2)
        best: _Fit | None = None
        for _ in range(rounds):
            normal, right, cost, count = self._normal(C, x, i)
            away = x - np.concatenate([x[:9], prior[0], np.zeros(3)])
            total = information + normal
            cost += float(away @ information @ away)
            right -= information @ away
            scale = 1.0 / np.sqrt(np.diag(total))
            covariance = scale[:, None] * np.linalg.pinv(total * np.outer(scale, scale), rcond=1e-13) * scale
            if best is None or cost < best.chi2:
                best = _Fit(C, x.copy(), covariance, cost, count - 9, i, float(self.t[-1]))
            move = covariance @ right
            size = float(np.linalg.norm(move[6:9]))
            if size > 0.7:
                move = move * (0.7 / size)
            C = rotation.dcm_from_quaternion(rotation.quaternion_from_vector(move[6:9])) @ C
            x = x + move
            x[6:9] = 0.0
            if size < 1e-5:
                break
        assert best is not None
        return best

    def _normal(self, C: Array, x: Array, i: _Integrals) -> tuple[Array, Array, float, int]:
        """Normal matrix, right-hand side, weighted sum of squares and number of the residuals at an estimate."""
        t = self.t[:, None]
        down = np.array([0.0, 0.0, self.gravity])
        bg, ba = x[9:12] - i.bias[:3], x[12:15] - i.bias[3:]
        moved = i.place + i.arm + i.p_bg @ bg + i.p_ba @ ba + _skew(i.arm) @ i.T @ bg
        gained = i.velocity + i.swing + i.v_bg @ bg + i.v_ba @ ba + _skew(i.swing) @ i.T @ bg
        place = x[:3] + (x[3:6] + x[15:]) * t + 0.5 * down * t**2 + moved @ C.T
        velocity = x[3:6] + down * t + gained @ C.T
        normal, right, cost, count = np.zeros((SIZE, SIZE)), np.zeros(SIZE), 0.0, 0
        eye = np.broadcast_to(np.eye(3), (t.size, 3, 3))
        none = np.zeros_like(eye)
        parts = (
            (
                self.place - place,
                self.place_sigma,
                eye,
                eye * t[:, :, None],
                moved,
                i.p_bg,
                i.p_ba,
                i.arm,
                eye * t[:, :, None],
            ),
            (self.velocity - velocity, self.velocity_sigma, none, eye, gained, i.v_bg, i.v_ba, i.swing, none),
        )
        for residual, sigma, dp, dv, turned, by_gyro, by_accel, antenna, drift in parts:
            # the attitude at the fix moves with the gyroscope's bias, and the antenna with it
            first = C @ (by_gyro + _skew(antenna) @ i.T)
            H = np.concatenate([dp, dv, -_skew(turned @ C.T), first, C @ by_accel, drift], axis=2).reshape(-1, SIZE)
            r, s = residual.ravel(), sigma.ravel()
            use = np.isfinite(r) & np.isfinite(s)
            H, r, w = H[use], r[use], 1.0 / s[use] ** 2
            normal += H.T @ (w[:, None] * H)
            right += H.T @ (w * r)
            cost += float(w @ r**2)
            count += int(use.sum())
        return normal, right, cost, count

    def best(self, prior: tuple[Array, Array]) -> tuple[_Fit, float]:
        """The best of several headings, and by how much a fit with another heading is worse."""
        i = self.integrals(np.zeros((3, 3)), prior[0])
        # over the stretch the specific force points up but for the change of velocity
        roll, pitch = level(i.velocity[-1])
        x = np.zeros(SIZE)
        x[9:15] = prior[0]
        fits: list[_Fit] = []
        for heading in np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS - np.pi:
            fit = self.solve(rotation.dcm_from_rpy(np.array([roll, pitch, heading])), x, prior, i)
            if not any(np.linalg.norm(rotation.vector_from_dcm(fit.C @ f.C.T)) < APART for f in fits):
                fits.append(fit)
        fits = sorted(fits, key=lambda f: f.chi2)[:3]
        for _ in range(3):
            fits = [self.solve(f.C, f.x, prior, self.integrals(f.C, f.x[9:15])) for f in fits]
        fits.sort(key=lambda f: f.chi2)
        others = [f.chi2 for f in fits[1:] if np.linalg.norm(rotation.vector_from_dcm(f.C @ fits[0].C.T)) >= APART]
        return fits[0], (min(others, default=np.inf) - fits[0].chi2) / fits[0].scale()


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


def _stretch(
    r: ImuRecord, gnss: GnssRecord, start: int, stop: int, lever_arm: Array, gravity: str, noise: tuple[float, float]
) -> _Stretch:
    """Fixes ``start`` to ``stop`` (included) and the IMU from the first to the last."""
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
    noise = white_noise(r)
    arm = np.asarray(lever_arm, dtype=np.float64)
    said = "fewer than five fixes after the first motion"
    for start in _moves_from(fixes):
        for span in STRETCHES:
            stop = int(np.searchsorted(fixes.t, fixes.t[start] + min(span, longest) + 1e-6)) - 1
            if stop - start < 4:
                continue
            stretch = _stretch(_thinned(r), fixes, start, stop, arm, gravity, noise)
            fit, margin = stretch.best(prior)
            said = f"its standard deviation after {stretch.t[-1]:.0f} s is {np.rad2deg(min(fit.heading_sigma, np.pi)):.1f} deg"
            if fit.heading_sigma <= COARSE and margin > WORSE and fit.plausible:
                found = _refined(fit, stretch, r, fixes, arm, gravity, noise, longest)
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


def _refined(
    fit: _Fit,
    stretch: _Stretch,
    r: ImuRecord,
    fixes: GnssRecord,
    lever_arm: Array,
    gravity: str,
    noise: tuple[float, float],
    longest: float,
) -> Alignment | None:
    """The filter from the end of a stretch on; None where it finds itself on a wrong solution or the heading stays unknown.

    Parameters
    ----------
    fit, stretch
        Least squares, and what it was made of.
    r : ImuRecord
        Increments.
    fixes : GnssRecord
        All of them; those of the stretch are in the fit already.
    lever_arm : (3,) array
    gravity : str
    noise : (gyroscopes, accelerometers)
        Densities of white noise.
    longest : float
        Seconds from the start of the stretch to go on for at most.
    """
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
