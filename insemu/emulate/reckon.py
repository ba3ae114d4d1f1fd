"""Dead reckoning of a recording against its own reference, or its fixes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation, strapdown
from insemu.emulate.gnss import state_at
from insemu.errors import InputError
from insemu.records import GnssRecord, ImuRecord, Recording, Trajectory
from insemu.strapdown import NavState

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DeadReckoning:
    """Figures of a dead reckoning, SI; errors are norms of the three components, over the epochs of the reference.

    ``t`` (n,) and ``errors`` (n, 3) are these errors over time: position (m), velocity (m/s), attitude (rad). Fixes tell no attitude and
    may tell no velocity: NaN. ``against`` is what it is held against, ``said`` what was assumed and done before, in words.
    """

    max_position_error_m: float
    final_position_error_m: float
    max_velocity_error_m_s: float
    max_attitude_error_rad: float
    epochs_per_second: float
    epochs: int
    start_s: float
    end_s: float
    kind: str
    gravity: str
    source: str
    t: Array = field(repr=False, compare=False)
    errors: Array = field(repr=False, compare=False)
    against: str = "reference"
    said: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The figures that are known, for JSON."""
        figures = {key: value for key, value in vars(self).items() if key not in ("t", "errors")}
        return {key: value for key, value in figures.items() if value == value}  # not NaN


def dead_reckon(recording: Recording, *, gravity: str = "normal", start: NavState | None = None) -> DeadReckoning:
    """Navigate the IMU of a recording alone, from its reference at the first IMU epoch.

    Parameters
    ----------
    recording : Recording
        With a reference, which may be at another rate. Where it starts later than the IMU, so does the dead reckoning.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.
    start : NavState, optional
        At the first epoch of the IMU, for a recording without a reference: it is held against its fixes (an antenna at the IMU).

    Raises
    ------
    InputError
        Neither reference nor start and fixes; a reference that does not overlap with the IMU.
    """
    reference, imu, gnss = recording.reference, recording.imu, recording.gnss
    if reference is None and start is not None and gnss is not None:
        known = gnss.rows(np.isfinite(gnss.llh).all(axis=1) & (gnss.t >= imu.t[0]) & (gnss.t <= imu.t[-1]))
        return _flown(imu.as_increments(), start.to_array(), known, gravity, recording)
    if reference is None:
        raise InputError(
            "has no reference (ref_t, ref_llh, ref_vel_ned, ref_rpy_deg) to start from", where=recording.source
        )
    if len(reference) < 2:
        raise InputError("has a reference of one epoch, expected at least two", where=recording.source)
    inside = (imu.t >= reference.t[0] - 1e-9) & (imu.t <= reference.t[-1] + 1e-9)
    if inside.sum() < 2:
        raise InputError(
            f"the IMU ({imu.t[0]:g} to {imu.t[-1]:g} s) and the reference ({reference.t[0]:g} to {reference.t[-1]:g} s) "
            "do not overlap",
            where=recording.source,
        )
    increments = imu.as_increments().rows(slice(int(np.argmax(inside)), None))
    first_t = np.clip(increments.t[:1], reference.t[0], reference.t[-1])
    llh, vel, q, _ = state_at(reference, first_t)
    initial = np.concatenate([llh[0], vel[0], q[0]])
    if first_t[0] == reference.t[0]:  # exactly the same start as the one that made the reference
        initial[6:] = rotation.quaternion_from_rpy(reference.rpy[0])
    return _flown(increments, initial, reference, gravity, recording)


def _flown(
    increments: ImuRecord, initial: Array, reference: Trajectory | GnssRecord, gravity: str, recording: Recording
) -> DeadReckoning:
    """The figures of increments navigated from a state (10,), against a reference or fixes."""
    strapdown.mechanize_array(replace(increments, **_head(increments)), initial, gravity=gravity)  # compile first
    begin = time.perf_counter()
    nav = strapdown.mechanize_array(increments, initial, gravity=gravity)
    seconds = time.perf_counter() - begin
    flown = strapdown.trajectory_of(increments.t, nav)
    rows = (reference.t >= increments.t[0] - 1e-9) & (reference.t <= increments.t[-1] + 1e-9)
    t = reference.t[rows]
    if t.shape == flown.t.shape and np.array_equal(t, flown.t):
        at, v, attitude = flown.llh, flown.vel_ned, nav[:, 6:10]
    else:
        at, v, attitude, _ = state_at(flown, t)
    errors = np.full((t.size, 3), np.nan)
    errors[:, 0] = np.linalg.norm(earth.position_difference(at, reference.llh[rows]), axis=1)
    if reference.vel_ned is not None:
        errors[:, 1] = np.linalg.norm(v - reference.vel_ned[rows], axis=1)
    if isinstance(reference, Trajectory):
        true = rotation.quaternion_conjugate(rotation.quaternion_from_rpy(reference.rpy[rows]))
        errors[:, 2] = np.linalg.norm(
            rotation.vector_from_quaternion(rotation.quaternion_product(attitude, true)), axis=1
        )
    return DeadReckoning(
        max_position_error_m=float(errors[:, 0].max()),
        final_position_error_m=float(errors[-1, 0]),
        max_velocity_error_m_s=float(np.fmax.reduce(errors[:, 1])),
        max_attitude_error_rad=float(np.fmax.reduce(errors[:, 2])),
        epochs_per_second=float((len(increments) - 1) / seconds),
        epochs=len(increments) - 1,
        start_s=float(increments.t[0]),
        end_s=float(increments.t[-1]),
        kind=recording.imu.kind,
        gravity=gravity,
        source=recording.source,
        t=t,
        errors=errors,
        against="reference" if isinstance(reference, Trajectory) else "fixes",
    )


def _head(imu: ImuRecord) -> dict[str, Any]:
    return {"t": imu.t[:2], "gyro": imu.gyro[:2], "accel": imu.accel[:2], "temperature": None}
