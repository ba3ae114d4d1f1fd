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
from insemu.filters.alignment import Alignment, sigma_of_fixes
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.motion import ACCEL_BIAS, LEAST_HEADING, LEAST_TILT, LEAST_VELOCITY, WORST, attitudes, white_noise
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
#: Factor on standard deviations for fixes that are used twice.
CAUTION = 3.0
#: The covariance moves every so many seconds.
STEP_S = 0.05
#: Place and velocity come from the fixes of so many seconds, s, of this many positions at least, within the longest.
FIRST_S, FEWEST, LONGEST_S = 5.0, 4, 20.0
#: A fix this many standard deviations from the others of these seconds is left out.
FAR = 5.0
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
        C, bias, P = _after(r, fixes, later, noise, lever_arm, gravity)
    except InputError:
        return later
    # no further back than the biases let the attitude be known, nor over a gap
    reach = float(WORST / max(np.sqrt(np.diag(P)[3:6].max()), 1e-9))
    gaps = np.flatnonzero(np.diff(r.t[: later.row + 1]) > BRIDGED_S)
    earliest = max(later.t - reach, float(r.t[gaps[-1] + 1]) if gaps.size else -np.inf)
    first = int(np.searchsorted(fixes.t, earliest))
    if first >= len(fixes) or fixes.t[first] >= later.t:
        return later
    row = int(np.searchsorted(r.t, fixes.t[first] - 1e-9))
    step = np.diff(r.t, prepend=2.0 * r.t[0] - r.t[1])[:, None]
    clean = replace(r, gyro=r.gyro - bias[:3] * step, accel=r.accel - bias[3:] * step)
    back = slice(row, later.row + 1)
    rate, start = earth.earth_rate(float(fixes.llh[first, 0])), C
    for _ in range(3):
        Q = attitudes(clean.gyro[back], start.T @ rate, step[back, 0])
        start = C @ Q[-1].T
    spent = start @ (0.5 * (Q[1:] + Q[:-1]) * step[back][1:, :, None]).sum(axis=0)
    A = np.hstack([np.eye(3), spent])
    attitude = A @ P[:6, :6] @ A.T + noise[0] ** 2 * (later.t - r.t[row]) * np.eye(3)
    rpy = rotation.rpy_from_dcm(start)
    found = _place_and_velocity(clean, fixes, row, rpy, lever_arm, gravity)
    if found is None:
        return later
    state, place, velocity = found
    least = np.array([LEAST_TILT, LEAST_TILT, LEAST_HEADING])
    sigma = InitialSigma(
        np.maximum(CAUTION * place, _of_fix(fixes.pos_std_ned, first)),
        np.maximum(np.maximum(CAUTION * velocity, LEAST_VELOCITY), _of_fix(fixes.vel_std_ned, first)),
        np.maximum(CAUTION * np.sqrt(np.diag(attitude)), least),
    )
    out = Alignment(float(r.t[row]), row, state, sigma, bias, np.sqrt(np.diag(P)[3:]), ())
    return replace(out, standstill=tuple(rests(imu, gnss, bias=out.known_bias)))


def _of_fix(sigma: Array | None, fix: int) -> Array:
    """Standard deviations (3,) of the fix at a start, zero where it has none: errors of fixes that last are the start's, too."""
    return np.zeros(3) if sigma is None else np.nan_to_num(sigma[fix])


def _after(
    r: ImuRecord, fixes: GnssRecord, later: Alignment, noise: tuple[float, float], lever_arm: Array, gravity: str
) -> tuple[Array, Array, Array]:
    """Attitude (3, 3) and biases (6,) at an alignment as the fixes after it tell them, too, and the covariance of both (9, 9); arguments as in
    :func:`from_both_sides`.
    """
    span = r.rows((r.t >= later.t - 1e-9) & (r.t <= later.t + AFTER_S))
    unknown = np.repeat([BIAS_SIGMA, ACCEL_BIAS], 3)
    told = np.isfinite(later.bias)
    bias = np.where(told, later.bias, 0.0)
    sd = np.where(told, np.minimum(later.bias_sigma, unknown), unknown)
    walks = [size / np.sqrt(AFTER_S) for size in WALK]
    belief = {
        sensor: WN(N=white) + RW(K=float(walk), sigma0=float(sigma))
        for sensor, white, walk, sigma in zip(("gyro", "accel"), noise, walks, unknown[[0, 3]], strict=True)
    }
    every = max(1, round(STEP_S / r.dt))
    options = FilterOptions(store="fixes", covariance_every=every, output_every=100 * every)
    ekf = LooselyCoupledEKF(belief, r.dt, lever_arm=lever_arm, gravity=gravity, options=options)
    P = np.diag(np.concatenate([later.sigma.to_array(), sd]) ** 2)
    run = ekf.run(span, fixes.rows(fixes.t > later.t), later.state, P, initial_states=bias)
    s, used = smooth(run), run.fixes.accepted
    scale = max(1.0, float(run.fixes.nis[used].sum() / max(run.fixes.dof[used].sum(), 1)))
    C = rotation.dcm_from_quaternion(s.nav[0, 6:10])
    return C, s.imu_states[0, :6], scale * s.covariance[0][6:15, 6:15]


def _place_and_velocity(
    r: ImuRecord, fixes: GnssRecord, row: int, rpy: Array, lever_arm: Array, gravity: str
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
    place, velocity = fixes.llh[first], np.zeros(3)
    design, sigma = np.stack([np.ones_like(since), since], axis=1), fixes.pos_std_ned[rows]
    if fixes.vel_ned is not None:
        design = np.concatenate([design, np.stack([np.zeros_like(since), np.ones_like(since)], axis=1)])
        assert fixes.vel_std_ned is not None  # as stated or taken from the scatter
        sigma = np.concatenate([sigma, fixes.vel_std_ned[rows]])
    for _ in range(3):
        nav = mechanize_array(part, NavState(place, velocity, rpy), gravity=gravity)[at]
        C = rotation.dcm_from_quaternion(nav[:, 6:10])
        late = fixes.t[rows] - part.t[at]
        antenna = earth.move(nav[:, :3], nav[:, 3:6] * late[:, None] + C @ lever_arm)
        left = earth.position_difference(fixes.llh[rows], antenna)
        if fixes.vel_ned is not None:
            turn = np.cross(r.rates()[row + at, :3], lever_arm)
            left = np.concatenate([left, fixes.vel_ned[rows] - nav[:, 3:6] - np.einsum("kij,kj->ki", C, turn)])
        fitted = [_line(design[:, :, 0], left[:, i], sigma[:, i]) for i in range(3)]
        place = earth.move(place, np.array([f[0][0] for f in fitted]))
        velocity = velocity + np.array([f[0][1] for f in fitted])
    sd = np.array([f[1] for f in fitted])
    return NavState(place, velocity, rpy), sd[:, 0], sd[:, 1]


def _line(design: Array, left: Array, sigma: Array) -> tuple[Array, Array]:
    """Place and velocity (2,) of one axis with their standard deviations, from residuals (k,) less those far from the others."""
    use = np.isfinite(left) & np.isfinite(sigma)
    weight = np.where(use, 1.0 / np.where(use, sigma, 1.0), 0.0)
    x, scale = np.zeros(2), 1.0
    for _ in range(3):
        H, y = design * weight[:, None], np.where(use, left, 0.0) * weight
        spread = np.linalg.pinv(H.T @ H)
        x = spread @ H.T @ y
        size = np.abs(y - H @ x)
        scale = max(1.0, 1.4826 * float(np.median(size[weight > 0.0])))
        weight = np.where(size > FAR * scale, 0.0, weight)
    return x, scale * np.sqrt(np.diag(spread))
