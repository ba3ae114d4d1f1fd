"""Alignment in motion, without knowing how the IMU is mounted.

Integrated specific force and the velocity of the fixes are the same vectors in two frames (Wu and Pan 2013, in the form of Wahba's problem):
heading comes from speeding up, braking and turning, and the mounting plays no part.

:mod:`insemu.filters.alignment` is the way at rest, and the simpler one for an IMU that is turned into vehicle axes first: heading is the course.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, align_at_rest, rests
from insemu.filters.options import InitialSigma
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]


def align_in_motion(
    imu: ImuRecord,
    gnss: GnssRecord,
    *,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    gravity: str = "normal",
    least_change: float = 12.0,
    longest: float = 180.0,
) -> Alignment:
    """Align a drive that starts from nothing: level and heading from the fixes' velocity, gyroscope bias from the first rest.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
        With velocities.
    lever_arm : (3,)
        IMU to antenna in the axes of the IMU record, m; its swing is left to the velocity's uncertainty.
    gravity : str
        See :mod:`insemu.earth`.
    least_change : float
        Velocity that has to have changed horizontally, summed over seconds, before the heading is trusted, m/s.
    longest : float
        Longest stretch to use, s.

    Returns
    -------
    Alignment
        At the last fix of the stretch that was used.

    Raises
    ------
    InputError
        No velocities, or a vehicle that does not move enough.
    """
    if gnss.vel_ned is None:
        raise InputError("the fixes carry no velocity; alignment in motion needs it (or give heading and level)")
    r = imu.as_increments()
    good = (
        np.isfinite(gnss.vel_ned).all(axis=1)
        & np.isfinite(gnss.llh).all(axis=1)
        & (gnss.t >= r.t[0])
        & (gnss.t <= r.t[-1])
    )
    t, v, llh = gnss.t[good], gnss.vel_ned[good], gnss.llh[good]
    if t.size < 5:
        raise InputError(f"{t.size} fixes with velocity during the IMU record, expected at least 5")
    found = rests(imu, gnss)
    rest = found[0] if found else None
    bias = np.full(3, np.nan)
    if rest is not None:
        bias = align_at_rest(imu, llh[0], rest, heading=0.0).gyro_bias
    # the stretch: up to the fix at which the velocity has changed enough, seconds apart so that noise does not add up
    apart = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], 1.0)))
    changed = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(v[apart, :2], axis=0), axis=1))])
    moving = apart[max(int(np.argmax(changed > 1.0)) - 5, 0)]
    start = int(moving)
    from_start = changed - np.interp(start, apart, changed)
    enough = np.flatnonzero(from_start >= least_change)
    if enough.size == 0 or t[apart[enough[0]]] - t[start] > longest:
        raise InputError(
            f"the velocity changes by {float(changed[-1]):.1f} m/s over the record, expected {least_change:g} m/s within {longest:g} s to align"
        )
    stop = int(apart[enough[0]])
    rows = np.searchsorted(r.t, t[start : stop + 1] - 1e-9).clip(1, len(r) - 1)
    first, last = int(rows[0]), int(rows[-1])
    # attitude of the body relative to the body at the first fix, and specific force integrated there
    step = np.diff(r.t)[:, None]
    gyro = r.gyro[1:] - np.nan_to_num(bias) * step
    q = np.array([1.0, 0.0, 0.0, 0.0])
    total = np.zeros(3)
    sums, attitudes = [total.copy()], [q]
    at = 1
    for k in range(first + 1, last + 1):
        half = rotation.quaternion_product(q, rotation.quaternion_from_vector(0.5 * gyro[k - 1]))
        total = total + rotation.dcm_from_quaternion(half) @ r.accel[k]
        q = rotation.quaternion_product(q, rotation.quaternion_from_vector(gyro[k - 1]))
        if at < rows.size and k == rows[at]:
            sums.append(total.copy())
            attitudes.append(q)
            at += 1
    alpha = np.diff(np.array(sums), axis=0)
    g = np.array([0.0, 0.0, float(earth.gravity(llh[start, 0], llh[start, 2], gravity))])
    w_ie = earth.earth_rate(float(llh[start, 0]))
    used = slice(start, stop + 1)
    dt = np.diff(r.t[rows])[:, None]
    middle = 0.5 * (v[used][1:] + v[used][:-1])
    beta = np.diff(v[used], axis=0) + (np.cross(2 * w_ie, middle) - g) * dt
    # Wahba by singular values, over sums of a second so that the noise of single fixes does not dominate
    group = np.searchsorted(t[used][1:], np.arange(t[start] + 1.0, t[stop] + 1e-6, 1.0) + 1e-6)
    edges = np.unique(np.concatenate([[0], group]))
    a = np.add.reduceat(alpha, edges[:-1], axis=0) if edges.size > 1 else alpha
    b = np.add.reduceat(beta, edges[:-1], axis=0) if edges.size > 1 else beta
    left, _, right = np.linalg.svd(b.T @ a)
    C0 = left @ np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right
    residual = b - a @ C0.T
    variance = float((residual**2).sum() / max(2 * len(b) - 3, 1))
    information = sum((x @ x) * np.eye(3) - np.outer(x, x) for x in b) / variance
    scatter = np.sqrt(np.diag(np.linalg.inv(information)))
    drift = 0.0 if rest is not None else np.deg2rad(0.02) * (t[stop] - t[start])
    floor = np.deg2rad([0.5, 0.5, 2.0])
    sigma = np.maximum(3.0 * scatter, floor) + drift
    C = C0 @ rotation.dcm_from_quaternion(attitudes[-1])
    place = earth.move(llh[stop], -C @ np.asarray(lever_arm, dtype=np.float64))
    state = NavState(place, v[stop], rotation.rpy_from_dcm(C))
    spread = 1.0 if gnss.pos_std_ned is None else np.maximum(3.0 * gnss.pos_std_ned[good][stop], 0.1)
    return Alignment(float(r.t[last]), last, state, InitialSigma(spread, 0.3, sigma), bias, tuple(found))
