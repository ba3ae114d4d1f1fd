"""Columns beside those of the catalogue: structure outside of it, filled-in stretches, and what the vehicle's shaking rectifies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects import Column, Motion
from insemu.lost import Filled

Array = NDArray[np.float64]


def library_columns(motion: Motion, t_fix: Array, mounting: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Column]:
    """Structure outside the catalogue: squares and products of specific force and rate; GNSS error against heading and speed.

    Parameters
    ----------
    motion : Motion
        Of the IMU, n epochs.
    t_fix : (f,) array
        Times of the fixes, s.
    mounting : (3,) sequence
        Roll, pitch and yaw of the IMU in the vehicle, rad: heading is that of the vehicle.
    """
    out: list[Column] = []
    axes = "xyz"

    def add(sensor: str, label: str, axis: int, scale: float, signal: Array) -> None:
        first = 3 if sensor == "accel" else 0
        out.append(Column("library", sensor, label, (axes[axis],), scale, "", ((first + axis, signal),)))

    for i in range(3):
        add("accel", f"f_{axes[i]}^2", i, 1e-4, motion.force[:, i] ** 2)
        add("gyro", f"w_{axes[i]}^2", i, 1e-3, motion.rate[:, i] ** 2)
        for j in range(3):
            if j != i:
                add("accel", f"w_{axes[j]} f_{axes[i]}", i, 1e-3, motion.rate[:, j] * motion.force[:, i])
    rpy = rotation.rpy_from_dcm(motion.C @ rotation.dcm_from_rpy(np.array(mounting)).T)
    k = np.clip(np.searchsorted(motion.t, t_fix), 0, motion.t.size - 1)
    heading, speed = rpy[k, 2], np.linalg.norm(motion.vel[k], axis=1)
    signals: tuple[tuple[str, Array], ...] = (
        ("cos heading", np.cos(heading)),
        ("sin heading", np.sin(heading)),
        ("speed", speed / 10.0),
    )
    for name, signal in signals:
        for c, direction in enumerate(("north", "east", "down")):
            M = np.zeros((t_fix.size, 6))
            M[:, c] = signal
            out.append(Column("library", "gnss", f"{name}, {direction}", (direction,), 0.05, "m", (), M))
    return out


def filled_columns(motion: Motion, filled: Sequence[Filled]) -> list[Column]:
    """What filling in each clipped or lost stretch may have got wrong: an unknown integral over it."""
    out = []
    for c in filled:
        inside = (motion.t > c.start) & (motion.t <= c.end)
        if inside.any():
            signal = inside / (motion.t[1] - motion.t[0]) / float(inside.sum())
            sensor, unit = ("gyro", "rad") if c.axis < 3 else ("accel", "m/s")
            out.append(Column("filled", sensor, "integral", ("xyz"[c.axis % 3],), c.sigma, unit, ((c.axis, signal),)))
    return out


def rectified_columns(scales: Array | None) -> list[Column]:
    """What shaking may leave on each axis, its size (n, 2) of gyroscopes and accelerometers given."""
    if scales is None:
        return []
    kinds = (("gyro", 0), ("accel", 3))
    return [
        Column("rectified", sensor, a, (a,), 1.0, "1", ((first + k, u),))
        for (sensor, first), u in zip(kinds, np.ascontiguousarray(scales.T), strict=True)
        for k, a in enumerate("xyz")
    ]
