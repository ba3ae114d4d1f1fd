"""Columns that are no effects: filled-in stretches, and what the vehicle's shaking rectifies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from insemu.effects import Column, Motion
from insemu.lost import Filled

Array = NDArray[np.float64]


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
