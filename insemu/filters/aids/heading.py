"""Heading of an axis in the plane of the IMU's x and y, of two antennas or a compass whose errors are taken off."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.rotation import scalar_dcm

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _half_turn(angle: float) -> float:
    """An angle between minus and plus half a turn."""
    return math.atan2(math.sin(angle), math.cos(angle))


@njit(cache=True, nogil=True)
def _along(nav: Array, yaw: float, C: Array) -> tuple[float, float, float]:
    """The axis north, east, down; ``C`` (3, 3) is overwritten."""
    scalar_dcm(nav[6:10], C)
    c, s = math.cos(yaw), math.sin(yaw)
    return C[0, 0] * c + C[0, 1] * s, C[1, 0] * c + C[1, 1] * s, C[2, 0] * c + C[2, 1] * s


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Heading of the axis, taken back by the turn of the last step; see :mod:`insemu.filters.rows`."""
    H = rows.H
    C = zeros(moment.nav, (3, 3))
    x, y, _ = _along(moment.nav_before, settings[0], C)
    before = math.atan2(y, x)
    x, y, down = _along(moment.nav, settings[0], C)
    now = math.atan2(y, x)
    rows.nu[0] = _half_turn(z[0] - now + moment.tau / moment.dt * _half_turn(now - before))
    H[0, 6] = -x * down / (x * x + y * y)
    H[0, 7] = -y * down / (x * x + y * y)
    H[0, 8] = 1.0


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Heading of the axis, rad."""
    u = motion.C @ np.array([math.cos(settings[0]), math.sin(settings[0]), 0.0])
    return np.asarray(np.arctan2(u[:, 1:2], u[:, 0:1]))


AID = Aid("heading", {"heading": "rad"}, _fill, truth, {"yaw": ("rad", 1)})
