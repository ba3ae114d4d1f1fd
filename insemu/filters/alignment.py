"""Starting from nothing: standstill found, level from gravity, heading from the course of the first motion.

A MEMS gyroscope does not feel the Earth's rotation, so heading comes from GNSS velocity once the vehicle moves forward; the gyroscopes carry
it back to the start of the record (Groves 2013, sections 5.6 and 16.2). All in vehicle axes: turn the IMU by its mounting first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.ekf import InitialSigma
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
        Mean angular rate at rest, rad/s; NaN where there was no rest.
    standstill : tuple of (start, end)
        Intervals at rest, s.
    """

    t: float
    row: int
    state: NavState
    sigma: InitialSigma
    gyro_bias: Array
    standstill: tuple[tuple[float, float], ...]


def find_standstill(gnss: GnssRecord, *, speed: float = 0.1, shortest: float = 4.0) -> tuple[tuple[float, float], ...]:
    """Intervals in which every fix is slower than ``speed`` (m/s), at least ``shortest`` seconds, a second kept off both ends."""
    if gnss.vel_ned is None:
        return ()
    slow = np.linalg.norm(gnss.vel_ned, axis=1) < speed
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(np.int8), [0]]))).reshape(-1, 2)
    spans = [(float(gnss.t[a]) + 1.0, float(gnss.t[b - 1]) - 1.0) for a, b in edges]
    return tuple((a, b) for a, b in spans if b - a >= shortest - 2.0)


def level(f_b: ArrayLike) -> tuple[float, float]:
    """Roll and pitch (rad) of a body at rest from its mean specific force (m/s^2) in body axes."""
    fx, fy, fz = np.asarray(f_b, dtype=np.float64)
    return float(np.arctan2(-fy, -fz)), float(np.arctan2(fx, np.hypot(fy, fz)))


def align(
    imu: ImuRecord, gnss: GnssRecord, *, lever_arm: ArrayLike = (0.0, 0.0, 0.0), min_speed: float = 3.0
) -> Alignment:
    """Find a start for a filter from raw data.

    With a rest at the start of the record it is the start of that rest: level from gravity, gyroscope bias from the mean rate, heading from the
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
    still = find_standstill(gnss)
    increments = imu.as_increments()
    bias = np.full(3, np.nan)
    at_rest = still and still[0][0] < gnss.t[first]
    if at_rest:
        a, b = np.searchsorted(imu.t, still[0])
        span = imu.t[b] - imu.t[a]
        bias = increments.gyro[a + 1 : b + 1].sum(axis=0) / span
        roll, pitch = level(increments.accel[a + 1 : b + 1].sum(axis=0) / span)
        row = int(np.searchsorted(imu.t, max(still[0][0], float(gnss.t[inside][0]))))
        end = int(np.searchsorted(imu.t, gnss.t[first]))
        turned = increments.gyro[row + 1 : end + 1].sum(axis=0) - bias * (imu.t[end] - imu.t[row])
        # rate of the heading of a nearly level vehicle: (q sin(roll) + r cos(roll)) / cos(pitch)
        heading = course - float((turned[1] * np.sin(roll) + turned[2] * np.cos(roll)) / np.cos(pitch))
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
        still,
    )
