"""A start from both sides: what the minutes after an alignment say of the first second of a recording.

An alignment in motion ends where the heading is known, a minute or two after the first fix, and knows the biases coarsely. The filter goes on from
there and is smoothed back (Rauch, Tung and Striebel 1965), which tells attitude and biases from both sides; less these biases the gyroscopes
carry the attitude back through the first turns and the standstill, and the first fixes give place and velocity in it, by least squares.

The fixes behind this start are those that a filter uses again. So it is stated :data:`CAUTION` times as uncertain as it is: it then adds a
ninth to what they say.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.alignment import LARGEST_HEADING_SIGMA, Alignment, sigma_of_fixes
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.integrals import attitudes
from insemu.filters.motion import ACCEL_BIAS, LEAST_HEADING, LEAST_TILT, LEAST_VELOCITY, white_noise
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.rest import BIAS_SIGMA, rests
from insemu.filters.smoother import smooth
from insemu.noise import RW, WN
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState, mechanize_array

Array = NDArray[np.float64]

#: Seconds after an alignment that are asked.
AFTER_S = 300.0
#: Walk of the biases over these seconds, rad/s and m/s^2 (in-run changes of consumer MEMS).
WALK = (np.deg2rad(0.05), 0.05)
#: Factor on standard deviations for fixes that are used twice; where the innovations are larger than stated by more than that, this factor.
CAUTION = 3.0
#: The covariance moves every so many seconds.
STEP_S = 0.05
#: Place and velocity come from the fixes of so many seconds, s, of this many positions at least, within the longest.
FIRST_S, FEWEST, LONGEST_S = 5.0, 4, 20.0
#: A fix this many standard deviations from the others of these seconds is left out, as the last of so many turns of weighted least squares says.
FAR, TURNS = 5.0, 20
#: Share of good fixes that are rejected on the way, so that outliers pull nothing.
GATE = 1e-4
#: A step of the IMU longer than this is not crossed, s.
BRIDGED_S = 1.0


def from_both_sides(
    imu: ImuRecord, gnss: GnssRecord, later: Alignment, *, lever_arm: Array, gravity: str = "normal"
) -> Alignment:
    """A start at the first fix, or as near to it as the attitude can be carried back.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
        With positions; standard deviations that it does not state are taken from its scatter.
    later : Alignment
        Of this record.
    lever_arm : (3,) array
        IMU to antenna in the axes of the IMU record, m.
    gravity : str
        See :mod:`insemu.earth`.

    Returns
    -------
    Alignment
        ``later`` itself where the filter does not run after it, or no fixes tell place and velocity before it.
    """
    r, known = imu.as_increments(), sigma_of_fixes(gnss)
    fixes = known.rows(np.isfinite(known.llh).all(axis=1) & (known.t > r.t[0]) & (known.t <= r.t[-1]))
    noise = white_noise(r)
    try:
        C, bias, P, scale = _after(r, fixes, later, noise, lever_arm, gravity)
    except InputError:
        return later
    caution = max(CAUTION, float(np.sqrt(scale)))
    gaps = np.flatnonzero(np.diff(r.t[: later.row + 1]) > BRIDGED_S)
    first = int(np.searchsorted(fixes.t, r.t[gaps[-1] + 1] if gaps.size else r.t[0]))
    step = np.diff(r.t, prepend=2.0 * r.t[0] - r.t[1])[:, None]
    clean = replace(r, gyro=r.gyro - bias[:3] * step, accel=r.accel - bias[3:] * step)
    while first < len(fixes) and fixes.t[first] < later.t - FIRST_S:
        row = int(np.searchsorted(r.t, fixes.t[first] - 1e-9))
        start, attitude = _carried(
            clean.rows(slice(row, later.row + 1)), C, P[:6, :6], noise[0], float(fixes.llh[first, 0])
        )
        if caution * np.sqrt(np.diag(attitude).max()) <= LARGEST_HEADING_SIGMA:
            break
        first = (first + int(np.searchsorted(fixes.t, later.t)) + 1) // 2  # less far back
    else:
        return later
    rpy = rotation.rpy_from_dcm(start)
    g = float(earth.gravity(fixes.llh[first, 0], fixes.llh[first, 2], gravity))
    tilt, unknown = np.sqrt(np.diag(attitude)), np.sqrt(float(np.diag(P)[6:].max()))
    push = np.array([np.hypot(g * tilt[1], unknown), np.hypot(g * tilt[0], unknown), unknown])
    found = _place_and_velocity(clean, fixes, row, rpy, push, lever_arm, gravity)
    if found is None:
        return later
    state, place, velocity = found
    least = np.array([LEAST_TILT, LEAST_TILT, LEAST_HEADING])
    sigma = InitialSigma(
        np.maximum(CAUTION * place, _of_fix(fixes.pos_std_ned, first)),
        np.maximum(np.maximum(CAUTION * velocity, LEAST_VELOCITY), _of_fix(fixes.vel_std_ned, first)),
        np.maximum(caution * np.sqrt(np.diag(attitude)), least),
    )
    out = Alignment(float(r.t[row]), row, state, sigma, bias, np.sqrt(scale * np.diag(P)[3:]), ())
    return replace(out, standstill=tuple(rests(imu, gnss, bias=out.known_bias)))


def _carried(part: ImuRecord, C: Array, P: Array, noise: float, latitude: float) -> tuple[Array, Array]:
    """Attitude at the start of a record of increments and its covariance, (3, 3) each, from those at its end.

    Parameters
    ----------
    part : ImuRecord
        Less its biases.
    C : (3, 3) array
        Attitude at its end.
    P : (6, 6) array
        Covariance of that attitude and of the biases of the gyroscopes.
    noise : float
        White noise of the gyroscopes, rad/s/sqrt(Hz).
    latitude : float
        rad.
    """
    step, rate, start = np.diff(part.t, prepend=part.t[0]), earth.earth_rate(latitude), C
    for _ in range(3):
        Q = attitudes(part.gyro, start.T @ rate, step)
        start = C @ Q[-1].T
    spent = start @ (0.5 * (Q[1:] + Q[:-1]) * step[1:, None, None]).sum(axis=0)
    A = np.hstack([np.eye(3), spent])
    return start, A @ P @ A.T + noise**2 * (part.t[-1] - part.t[0]) * np.eye(3)


def _of_fix(sigma: Array | None, fix: int) -> Array:
    """Standard deviations (3,) of the fix at a start, zero where it has none: errors of fixes that last are the start's, too."""
    return np.zeros(3) if sigma is None else np.nan_to_num(sigma[fix])


def _after(
    r: ImuRecord, fixes: GnssRecord, later: Alignment, noise: tuple[float, float], lever_arm: Array, gravity: str
) -> tuple[Array, Array, Array, float]:
    """Attitude (3, 3) and biases (6,) at an alignment as the fixes after it tell them, too, the covariance of both (9, 9), and by what factor the
    innovations exceed theirs (variances, at least 1); arguments as in :func:`from_both_sides`.
    """
    span = r.rows((r.t >= later.t - 1e-9) & (r.t <= later.t + AFTER_S))
    unknown = np.repeat([BIAS_SIGMA, ACCEL_BIAS], 3)
    told = np.isfinite(later.bias)
    bias = np.where(told, later.bias, 0.0)
    sd = np.where(told, np.minimum(np.repeat([1.0, CAUTION], 3) * later.bias_sigma, unknown), unknown)
    walks = [size / np.sqrt(AFTER_S) for size in WALK]
    belief = {
        sensor: WN(N=white) + RW(K=float(walk), sigma0=float(sigma))
        for sensor, white, walk, sigma in zip(("gyro", "accel"), noise, walks, unknown[[0, 3]], strict=True)
    }
    every = max(1, round(STEP_S / r.dt))
    options = FilterOptions(store="fixes", covariance_every=every, output_every=100 * every, gate=GATE)
    ekf = LooselyCoupledEKF(belief, r.dt, lever_arm=lever_arm, gravity=gravity, options=options)
    # errors of tilt and of the accelerometers go together, of which an alignment tells the standard deviations only
    nine = later.sigma.to_array() * np.array([*np.ones(6), CAUTION, CAUTION, 1.0])
    P = np.diag(np.concatenate([nine, sd]) ** 2)
    run = ekf.run(span, fixes.rows(fixes.t > later.t), later.state, P, initial_states=bias)
    s, used = smooth(run), run.fixes.accepted
    scale = max(1.0, float(run.fixes.nis[used].sum() / max(run.fixes.dof[used].sum(), 1)))
    C = rotation.dcm_from_quaternion(s.nav[0, 6:10])
    return C, s.imu_states[0, :6], s.covariance[0][6:15, 6:15], scale


def _place_and_velocity(
    r: ImuRecord, fixes: GnssRecord, row: int, rpy: Array, push: Array, lever_arm: Array, gravity: str
) -> tuple[NavState, Array, Array] | None:
    """The state at a row of a record less its biases, by least squares on the fixes after it, and standard deviations of place and velocity.

    Parameters
    ----------
    r, fixes
        Increments, and fixes with standard deviations of their positions.
    row : int
        Where the filter starts.
    rpy : (3,) array
        Attitude there, rad.
    push : (3,) array
        Standard deviation of the acceleration that an error of the attitude or of a bias makes, m/s^2.
    lever_arm, gravity
        As in :func:`from_both_sides`.

    Returns
    -------
    NavState, (3,) array, (3,) array
        None where too few fixes are within :data:`LONGEST_S`.
    """
    assert fixes.pos_std_ned is not None
    first = int(np.searchsorted(fixes.t, r.t[row] - 1e-9))
    ends = max(fixes.t[first] + FIRST_S, fixes.t[min(first + FEWEST - 1, len(fixes) - 1)])
    rows = np.flatnonzero((fixes.t >= fixes.t[first]) & (fixes.t <= ends))
    if rows.size < FEWEST or ends - fixes.t[first] > LONGEST_S:
        return None
    last = int(np.searchsorted(r.t, ends)) + 1
    part = r.rows(slice(row, last + 1))
    at = np.clip(np.searchsorted(part.t, fixes.t[rows] - 1e-9), 0, len(part) - 1)
    since = (fixes.t[rows] - part.t[0])[:, None]
    place, velocity, nothing = fixes.llh[first], np.zeros(3), np.zeros_like(since)
    design, sigma = np.hstack([nothing + 1.0, since, 0.5 * since**2]), fixes.pos_std_ned[rows]
    if fixes.vel_ned is not None:
        assert fixes.vel_std_ned is not None  # as stated or taken from the scatter
        design = np.concatenate([design, np.hstack([nothing, nothing + 1.0, since])])
        sigma = np.concatenate([sigma, fixes.vel_std_ned[rows]])
    for _ in range(3):
        nav = mechanize_array(part, NavState(place, velocity, rpy), gravity=gravity)[at]
        C = rotation.dcm_from_quaternion(nav[:, 6:10])
        late = fixes.t[rows] - part.t[at]
        antenna = earth.move(nav[:, :3], nav[:, 3:6] * late[:, None] + C @ lever_arm)
        left = earth.position_difference(fixes.llh[rows], antenna)
        if fixes.vel_ned is not None:
            turn = np.cross(part.rates()[at, :3], lever_arm)
            left = np.concatenate([left, fixes.vel_ned[rows] - nav[:, 3:6] - np.einsum("kij,kj->ki", C, turn)])
        fitted = [_fitted(design, left[:, i], sigma[:, i], float(push[i])) for i in range(3)]
        place = earth.move(place, np.array([f[0][0] for f in fitted]))
        velocity = velocity + np.array([f[0][1] for f in fitted])
    sd = np.array([f[1] for f in fitted])
    return NavState(place, velocity, rpy), sd[:, 0], sd[:, 1]


def _fitted(design: Array, left: Array, sigma: Array, push: float) -> tuple[Array, Array]:
    """Place, velocity and acceleration (3,) of one axis with their standard deviations, from residuals (k,) less those far from the others; the
    acceleration is zero but for ``push``, m/s^2.
    """
    use = np.isfinite(left) & np.isfinite(sigma)
    stated = np.where(use, 1.0 / np.where(use, sigma, 1.0), 0.0)
    y, prior, weight, scale = np.where(use, left, 0.0), np.diag([0.0, 0.0, push**-2.0]), stated, 1.0
    for turn in range(TURNS):
        H = design * weight[:, None]
        spread = np.linalg.inv(H.T @ H / scale**2 + prior)
        x = spread @ H.T @ (weight * y) / scale**2
        size = np.abs(y - design @ x) * stated
        scale = max(1.0, 1.4826 * float(np.median(size[use])))
        # the nearer to least absolute residuals, the less a far one pulls; at the end it is left out
        least = np.sqrt(np.minimum(1.0, scale / np.maximum(size, 1e-12)))
        weight = stated * (least if turn < TURNS - 2 else size <= FAR * scale)
    return x, np.sqrt(np.diag(spread))
