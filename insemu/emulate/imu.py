"""Trajectory to ideal IMU, in two ways that say what they are.

``exact``
    Attitude and velocity nodes are given; the increments are what the mechanization turns back into them, and the
    position nodes are re-integrated by the mechanization's own rule. The triple is the reference: navigation without
    sensor errors has no errors at all. The distance from the requested path (micrometres to millimetres) is reported.
``continuous``
    True angular rate and specific force of the smooth path, integrated over each interval by Gauss-Legendre
    quadrature. The reference is the path; the mechanization's own error is visible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation, strapdown
from insemu.emulate.kernel import invert
from insemu.emulate.path import Mounting, SmoothPath, sensor_motion
from insemu.emulate.sampled import sampled
from insemu.emulate.table import SAMPLE_BYTES, check_size
from insemu.emulate.trajectory import Flight
from insemu.errors import InputError, nearest
from insemu.records import ImuKind, ImuRecord, Sampling, Trajectory

Array = NDArray[np.float64]
Mode = Literal["exact", "continuous"]


@dataclass(frozen=True)
class IdealImu:
    """An error-free IMU record with the reference that belongs to it.

    Parameters
    ----------
    imu : ImuRecord
        Increments, means or samples.
    reference : Trajectory
        Position, velocity and attitude of the IMU at the times of the record.
    mode : {"exact", "continuous"}
        How it was made.
    gravity : str
        Gravity model that was used; navigate with the same.
    path_distance_m : float
        Largest distance between the reference and the requested path (zero for ``continuous``).
    """

    imu: ImuRecord
    reference: Trajectory
    mode: Mode
    gravity: str
    path_distance_m: float


def sample_times(start: float, end: float, rate_hz: float) -> Array:
    """Times from ``start`` to at most ``end`` at a constant rate, each rounded only once.

    Parameters
    ----------
    start, end : float
        s.
    rate_hz : float
        Hz.
    """
    count = _intervals(start, end, rate_hz)
    check_size(count, SAMPLE_BYTES, f"{end - start:.6g} s at {rate_hz:g} Hz")
    return _times(start, end, rate_hz, range(count + 1))


def _intervals(start: float, end: float, rate_hz: float) -> int:
    """Whole intervals of a constant rate from ``start`` to ``end`` s."""
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"the rate is {rate_hz} Hz, expected a positive number")
    count = int(np.floor((end - start) * rate_hz + 1e-6))
    if count < 1:
        raise InputError(f"{end - start:.6g} s at {rate_hz:g} Hz is less than one interval")
    return count


def _times(start: float, end: float, rate_hz: float, rows: range) -> Array:
    return np.minimum(start + np.arange(rows.start, rows.stop) / rate_hz, end)


def ideal_imu(
    trajectory: Flight | SmoothPath | Trajectory,
    rate_hz: float | None = None,
    *,
    mode: Mode = "exact",
    kind: ImuKind = "increment",
    mounting: Mounting | None = None,
    gravity: str = "normal",
    span: tuple[float, float] | None = None,
    sampling: Sampling | None = None,
) -> IdealImu:
    """Make the record of a perfect IMU.

    Parameters
    ----------
    trajectory : Flight, SmoothPath or Trajectory
        A path, or nodes of the IMU (then ``exact`` only, at the nodes' own times).
    rate_hz : float, optional
        IMU rate; not needed for nodes. 100 Hz where not given.
    mode : {"exact", "continuous"}
        See the module.
    kind : {"increment", "mean", "sample"}
        What the record holds. ``exact`` makes increments or means of them; instantaneous values exist only on a
        continuous path.
    mounting : Mounting, optional
        Lever arm and mounting angles of the IMU in its vehicle.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.
    span : (start_s, end_s), optional
        Part of the path.
    sampling : Sampling, optional
        How the sensor really samples (``continuous`` only), whatever the record's ``kind`` says of its values.

    Raises
    ------
    InputError
        Options that exclude each other, a span outside the path, a rate that is not positive.
    """
    if mode not in get_args(Mode):
        raise InputError(f"unknown mode '{mode}'" + nearest(mode, get_args(Mode)))
    if kind not in get_args(ImuKind):
        raise InputError(f"unknown imu kind '{kind}'" + nearest(kind, get_args(ImuKind)))
    if isinstance(trajectory, Flight):
        trajectory = trajectory.path
    mount = mounting or Mounting()
    if isinstance(trajectory, Trajectory):
        if mode != "exact":
            raise InputError(
                "mode 'continuous' needs a smooth path; nodes alone say nothing between them: smooth them first"
            )
        if not mount.is_identity:
            raise InputError("nodes are taken as those of the IMU itself; a mounting needs a smooth path")
        if rate_hz is not None:
            raise InputError("nodes carry their own times; give a rate only with a smooth path")
        nodes = trajectory
    else:
        start, end = span if span is not None else (trajectory.start, trajectory.end)
        t = sample_times(start, end, 100.0 if rate_hz is None else rate_hz)
        if mode == "continuous":
            return _continuous(trajectory, t, kind, mount, gravity, sampling)
        nodes = _imu_nodes(trajectory, t, mount)
    if sampling is not None:
        raise InputError("a sensor's own sampling needs mode 'continuous': nodes say nothing between them")
    if kind == "sample":
        raise InputError("mode 'exact' makes increments or means; instantaneous samples need mode 'continuous'")
    return _exact(nodes, kind, gravity)[0]


def ideal_stretches(
    path: SmoothPath,
    rate_hz: float,
    size: int,
    *,
    end_s: float,
    mode: Mode = "exact",
    kind: ImuKind = "increment",
    mounting: Mounting | None = None,
    gravity: str = "normal",
    sampling: Sampling | None = None,
) -> Iterator[IdealImu]:
    """What :func:`ideal_imu` makes from the start of a path in stretches, up to rounding: the last row of one is the first of the next.

    Parameters
    ----------
    path : SmoothPath
    rate_hz : float
    size : int
        Intervals of a stretch, at most; two or more.
    end_s : float
        Where it ends, s.
    mode, kind, mounting, gravity, sampling
        As of :func:`ideal_imu`.

    Raises
    ------
    InputError
        As :func:`ideal_imu`.
    """
    mount, count = mounting or Mounting(), _intervals(path.start, end_s, rate_hz)
    known: _Known | None = None
    for first in range(0, count, size):
        # a row more in front: what an interval needs of the one before
        begin, last = max(first - 1, 0), min(first + size, count)
        t = _times(path.start, end_s, rate_hz, range(begin, last + 1))
        if mode == "continuous":
            ideal = _continuous(path, t, kind, mount, gravity, sampling)
        else:
            ideal, known = _exact(_imu_nodes(path, t, mount), kind, gravity, known)
        own = slice(first - begin, None)
        yield replace(ideal, imu=ideal.imu.rows(own), reference=ideal.reference.rows(own))


def _imu_nodes(path: SmoothPath, t: Array, mount: Mounting) -> Trajectory:
    if mount.is_identity:
        return path.sample(t)
    motion = sensor_motion(path, t, mount)
    return Trajectory(t, motion.llh, motion.vel_ned, motion.rpy, path.name)


#: Increments and navigation states of the last two rows.
_Known = tuple[Array, Array, Array]


def _exact(nodes: Trajectory, kind: ImuKind, gravity: str, known: _Known | None = None) -> tuple[IdealImu, _Known]:
    """The inversion of nodes; ``known``: of their first two rows, which it goes on from."""
    n = len(nodes)
    if n < 2:
        raise InputError(f"the trajectory has {n} node(s), expected at least two")
    target = np.concatenate([nodes.llh, nodes.vel_ned, rotation.quaternion_from_rpy(nodes.rpy)], axis=1)
    gyro, accel, nav = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, strapdown.NAV_SIZE))
    if known is not None:
        gyro[:2], accel[:2], nav[:2] = known
    invert(nodes.t, target, earth.gravity_code(gravity), 1, gyro, accel, nav, 1 if known is None else 2)
    if not np.isfinite(nav[-1]).all():
        raise InputError(
            "the trajectory cannot be inverted: its states are not finite (more than half a revolution per sample?)"
        )
    rpy = rotation.rpy_from_quaternion(nav[:, 6:10])
    if known is None:
        rpy[0] = nodes.rpy[0]  # so that a start from the reference is the very same start
    reference = Trajectory(nodes.t, nav[:, 0:3], nav[:, 3:6], rpy, nodes.name)
    missed = np.abs(nav[:, 3:6] - nodes.vel_ned).max()
    if missed > 1e-6:
        raise InputError(f"the trajectory cannot be inverted: the velocity nodes are missed by {missed:.3g} m/s")
    known = gyro[-2:].copy(), accel[-2:].copy(), nav[-2:].copy()
    distance = float(np.linalg.norm(earth.position_difference(reference.llh, nodes.llh), axis=1).max())
    if kind == "mean":
        step = np.diff(nodes.t, prepend=2 * nodes.t[0] - nodes.t[1])[:, None]
        gyro, accel = gyro / step, accel / step
    return IdealImu(ImuRecord(nodes.t, gyro, accel, kind), reference, "exact", gravity, distance), known


def _continuous(
    path: SmoothPath, t: Array, kind: ImuKind, mount: Mounting, gravity: str, sampling: Sampling | None = None
) -> IdealImu:
    motion = sensor_motion(path, t, mount, gravity)
    reference = Trajectory(t, motion.llh, motion.vel_ned, motion.rpy, path.name)
    if kind == "sample" and sampling is None:
        values = np.hstack([motion.w_ib_b, motion.f_ib_b])
    else:

        def signal(at: Array) -> Array:
            inner = sensor_motion(path, np.clip(at, path.start, path.end), mount, gravity)
            return np.hstack([inner.w_ib_b, inner.f_ib_b])

        values = sampled(sampling or Sampling(), t, signal, path.highest)
        if sampling is None:
            values[0] = values[1]
    if kind == "increment":
        values = values * np.diff(t, prepend=2.0 * t[0] - t[1])[:, None]
    imu = ImuRecord(t, values[:, :3], values[:, 3:], kind, sampling=sampling)
    return IdealImu(imu, reference, "continuous", gravity, 0.0)


def navigation_error(ideal: IdealImu, imu: ImuRecord | None = None) -> Array:
    """Errors (n, 9) of the mechanization of an IMU record (the ideal one where not given) against the reference.

    Position in metres north, east, down; velocity m/s; attitude rad (estimate minus truth).
    """
    nav = strapdown.mechanize_array(imu or ideal.imu, ideal.reference, gravity=ideal.gravity)
    truth = np.concatenate(
        [ideal.reference.llh, ideal.reference.vel_ned, rotation.quaternion_from_rpy(ideal.reference.rpy)], axis=1
    )
    return strapdown.navigation_errors(nav, truth)
