"""Alignment without knowing how the IMU is mounted.

* At rest, gravity gives the level, and the Earth's rate the heading where the gyroscopes are good enough for it (gyro-compassing).
* In motion, integrated specific force and the velocity of the fixes are the same vectors in two frames (Wu and Pan 2013, in the form of Wahba's
  problem): heading comes from speeding up, braking and turning, and the mounting plays no part.

:mod:`insemu.filters.alignment` is the simpler way for an IMU that is turned into vehicle axes first: heading is the course.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, level
from insemu.filters.ekf import InitialSigma
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]


def cut(imu: ImuRecord, start: Alignment) -> ImuRecord:
    """The record from an alignment on, as increments, with the gyroscope bias at rest taken off."""
    r = imu.as_increments()
    step = np.diff(r.t, prepend=2 * r.t[0] - r.t[1])[start.row :, None]
    temperature = None if r.temperature is None else r.temperature[start.row :]
    gyro = r.gyro[start.row :] - np.nan_to_num(start.gyro_bias) * step
    return ImuRecord(r.t[start.row :], gyro, r.accel[start.row :], "increment", temperature)


def rests(
    imu: ImuRecord, gnss: GnssRecord | None = None, *, shortest: float = 2.0, speed: float = 0.3, factor: float = 3.0
) -> list[tuple[float, float]]:
    """Find when the vehicle stands still.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord, optional
        Where it has velocities, faster fixes rule rest out.
    shortest : float
        Shortest rest, s.
    speed : float
        Largest horizontal speed of a fix at rest, m/s.
    factor : float
        Half-second spreads of the rate and the specific force up to this multiple of the quietest tenth of the record count as rest.

    Returns
    -------
    list of (start, end) in s
    """
    r = imu.as_increments()
    n = max(2, round(0.5 / r.dt))
    count = len(r) // n
    if count < 4:
        return []
    step = np.diff(r.t, prepend=2 * r.t[0] - r.t[1])[: count * n, None]
    rate = np.hstack([r.gyro, r.accel])[: count * n] / step
    spread = rate.reshape(count, n, 6).std(axis=1)
    size = np.stack([np.linalg.norm(spread[:, :3], axis=1), np.linalg.norm(spread[:, 3:], axis=1)], axis=1)
    start, end = r.t[: count * n : n], r.t[n - 1 : count * n : n]
    fast = np.zeros(count, dtype=bool)
    if gnss is not None and gnss.vel_ned is not None:
        known = np.isfinite(gnss.vel_ned).all(axis=1)
        if known.any():
            v = np.interp(0.5 * (start + end), gnss.t[known], np.linalg.norm(gnss.vel_ned[known, :2], axis=1))
            fast = v > speed
    slow = size[~fast] if (~fast).sum() >= 4 else size
    still = (size <= factor * np.quantile(slow, 0.1, axis=0)).all(axis=1) & ~fast
    out = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]]))).reshape(-1, 2)
    for a, b in edges:
        if end[b - 1] - start[a] >= shortest:
            out.append((float(start[a]), float(end[b - 1])))
    return out


def align_at_rest(
    imu: ImuRecord, llh: Array, rest: tuple[float, float], *, heading: float | None = None, heading_sigma: float = np.pi
) -> Alignment:
    """Coarse alignment over a rest: level from gravity, heading given or from the Earth's rate.

    Parameters
    ----------
    imu : ImuRecord
    llh : (3,) array
        Position, rad, rad, m.
    rest : (start, end)
        s; the start of the filter is its end.
    heading, heading_sigma : float, optional
        rad; without a heading it is found by gyro-compassing, with a sigma from the scatter of the rates.

    Raises
    ------
    InputError
        Fewer than ten samples in the rest.
    """
    r = imu.as_increments()
    inside = (r.t > rest[0]) & (r.t <= rest[1])
    inside[0] = False
    if inside.sum() < 10:
        raise InputError(
            f"{int(inside.sum())} samples between {rest[0]:g} and {rest[1]:g} s, expected at least 10 at rest"
        )
    step = np.diff(r.t, prepend=2 * r.t[0] - r.t[1])[inside, None]
    force, rate = (v[inside] / step for v in (r.accel, r.gyro))
    roll, pitch = level(force.mean(axis=0))
    wander = rate.reshape(-1, 3)[: len(rate) // 10 * 10].reshape(10, -1, 3).mean(axis=1).std(axis=0, ddof=1) / np.sqrt(
        10
    )
    tilt_noise = force[: len(force) // 10 * 10].reshape(10, -1, 3).mean(axis=1).std(axis=0, ddof=1) / np.sqrt(10)
    if heading is None:
        leveled = rotation.dcm_from_rpy(np.array([roll, pitch, 0.0])) @ rate.mean(axis=0)
        heading = float(np.arctan2(-leveled[1], leveled[0]))
        heading_sigma = float(min(np.pi, np.linalg.norm(wander) / (earth.RATE * np.cos(llh[0]))))
    rpy = np.array([roll, pitch, heading])
    C = rotation.dcm_from_rpy(rpy)
    bias = rate.mean(axis=0) - C.T @ earth.earth_rate(float(llh[0]))
    tilt = max(float(np.linalg.norm(tilt_noise)) / 9.8, np.deg2rad(0.2))
    row = int(np.flatnonzero(inside)[-1])
    state = NavState(np.asarray(llh, dtype=np.float64), np.zeros(3), rpy)
    sigma = InitialSigma(1.0, 0.05, (tilt, tilt, max(heading_sigma, np.deg2rad(0.2))))
    return Alignment(float(r.t[row]), row, state, sigma, bias, (rest,))


def align_in_motion(
    imu: ImuRecord, gnss: GnssRecord, *, gravity: str = "normal", least_change: float = 12.0, longest: float = 180.0
) -> Alignment:
    """Align a drive that starts from nothing: level and heading from the fixes' velocity, gyroscope bias from the first rest.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
        With velocities.
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
    state = NavState(llh[stop], v[stop], rotation.rpy_from_dcm(C))
    spread = 1.0 if gnss.pos_std_ned is None else np.maximum(3.0 * gnss.pos_std_ned[good][stop], 0.1)
    return Alignment(float(r.t[last]), last, state, InitialSigma(spread, 0.3, sigma), bias, tuple(found))
