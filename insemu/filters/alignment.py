"""Starting from nothing: rests found, level from gravity, heading from the Earth's rate or from the course of the first motion.

At rest gravity gives the level, and the Earth's rate the heading where the gyroscopes are good enough for it (gyro-compassing). A MEMS gyroscope
does not feel the Earth's rotation: its heading comes from GNSS velocity once the vehicle moves forward, and the gyroscopes carry it back
to the start of the record (Groves 2013, sections 5.6 and 16.2); for that the IMU is turned into vehicle axes by its mounting first.

This is the coarse alignment. The fine one is the filter itself, run through the rest with zero-velocity and zero-rate updates
(:class:`~insemu.filters.ekf.Standstill`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.options import InitialSigma
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Standard deviation of roll and pitch of a vehicle that was never seen at rest, rad.
LEVEL_SIGMA = np.deg2rad(3.0)


@dataclass(frozen=True)
class Alignment:
    """Where and how a filter starts.

    Parameters
    ----------
    t : float
        Time of the start, s; row ``row`` of the IMU record.
    row : int
    state : NavState
    sigma : InitialSigma
    gyro_bias : (3,) array
        Mean angular rate at rest less the Earth's, rad/s; NaN where there was no rest.
    standstill : tuple of (start, end)
        Intervals at rest, s.
    """

    t: float
    row: int
    state: NavState
    sigma: InitialSigma
    gyro_bias: Array
    standstill: tuple[tuple[float, float], ...]


def level(f_b: ArrayLike) -> tuple[float, float]:
    """Roll and pitch (rad) of a body at rest from its mean specific force (m/s^2) in body axes."""
    fx, fy, fz = np.asarray(f_b, dtype=np.float64)
    return float(np.arctan2(-fy, -fz)), float(np.arctan2(fx, np.hypot(fy, fz)))


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


def align(
    imu: ImuRecord, gnss: GnssRecord, *, lever_arm: ArrayLike = (0.0, 0.0, 0.0), min_speed: float = 3.0
) -> Alignment:
    """Find a start for a filter from raw data.

    With a rest at the start of the record it is the start of that rest: level and gyroscope bias from :func:`align_at_rest`, heading from the
    first course above ``min_speed`` carried back by the gyroscopes. Otherwise it is the first fix above ``min_speed``, level assumed.

    Parameters
    ----------
    imu : ImuRecord
        In vehicle axes.
    gnss : GnssRecord
        With velocity.
    lever_arm : (3,)
        IMU to antenna in vehicle axes, m.
    min_speed : float
        Speed from which the course is taken for the heading, m/s. The vehicle must drive forward then.

    Raises
    ------
    InputError
        No velocity, or never as fast as that.
    """
    if gnss.vel_ned is None:
        raise InputError("alignment needs GNSS velocity for the heading; the record has positions only")
    inside = (
        (gnss.t >= imu.t[0])
        & (gnss.t <= imu.t[-1])
        & np.isfinite(gnss.vel_ned).all(axis=1)
        & np.isfinite(gnss.llh).all(axis=1)
    )
    speed = np.hypot(gnss.vel_ned[:, 0], gnss.vel_ned[:, 1])
    fast = np.flatnonzero(inside & (speed > min_speed))
    if not fast.size:
        raise InputError(
            f"alignment needs a fix faster than {min_speed:g} m/s; the fastest has {np.max(speed[inside], initial=0.0):.3g} m/s"
        )
    first = int(fast[0])
    course = float(np.arctan2(gnss.vel_ned[first, 1], gnss.vel_ned[first, 0]))
    sigma_v = 0.1 if gnss.vel_std_ned is None else float(np.max(gnss.vel_std_ned[first, :2]))
    heading_sigma = float(np.hypot(sigma_v / speed[first], np.deg2rad(1.0)))
    still = rests(imu, gnss)
    increments = imu.as_increments()
    bias = np.full(3, np.nan)
    if still and still[0][0] < gnss.t[first]:
        coarse = align_at_rest(imu, gnss.llh[first], still[0], heading=0.0)
        roll, pitch, _ = coarse.state.rpy
        row = int(np.searchsorted(imu.t, max(still[0][0], float(gnss.t[inside][0]))))
        end = int(np.searchsorted(imu.t, gnss.t[first]))
        rate = earth.earth_rate(float(gnss.llh[first, 0]))
        mean = coarse.gyro_bias + rotation.dcm_from_rpy(coarse.state.rpy).T @ rate
        turned = increments.gyro[row + 1 : end + 1].sum(axis=0) - mean * (imu.t[end] - imu.t[row])
        # rate of the heading of a nearly level vehicle: (q sin(roll) + r cos(roll)) / cos(pitch)
        heading = course - float((turned[1] * np.sin(roll) + turned[2] * np.cos(roll)) / np.cos(pitch))
        bias = mean - rotation.dcm_from_rpy([roll, pitch, heading]).T @ rate
        tilt = np.deg2rad(0.5)
        fix = int(np.flatnonzero(inside & (gnss.t >= imu.t[row] - 1e-9))[0])
        velocity, velocity_sigma = np.zeros(3), 0.05
    else:
        row = int(np.searchsorted(imu.t, gnss.t[first]))
        roll = pitch = 0.0
        heading, tilt, fix = course, LEVEL_SIGMA, first
        velocity, velocity_sigma = np.array(gnss.vel_ned[first]), max(0.1, sigma_v)
    rpy = np.array([roll, pitch, (heading + np.pi) % (2.0 * np.pi) - np.pi])
    arm = rotation.dcm_from_rpy(rpy) @ np.asarray(lever_arm, dtype=np.float64)
    llh = earth.move(gnss.llh[fix], velocity * (imu.t[row] - gnss.t[fix]) - arm)
    position_sigma = np.full(3, 3.0) if gnss.pos_std_ned is None else np.maximum(gnss.pos_std_ned[fix], 0.05)
    return Alignment(
        float(imu.t[row]),
        row,
        NavState(llh, velocity, rpy),
        InitialSigma(position=position_sigma, velocity=velocity_sigma, attitude=(tilt, tilt, heading_sigma)),
        bias,
        tuple(still),
    )
