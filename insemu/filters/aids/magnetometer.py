"""Magnetometer: the direction of the Earth's field in the axes of the sensor, which gives the heading where the filter knows its tilt.

Hard and soft iron are taken off beforehand. The field is a unit vector, so its strength need not be known.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.rotation import dcm_from_rpy, scalar_dcm, scalar_dcm_from_rpy

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _field(settings: Array, out: Array) -> None:
    """Direction of the field north, east, down (3,) from declination and inclination."""
    level = math.cos(settings[1])
    out[0], out[1], out[2] = level * math.cos(settings[0]), level * math.sin(settings[0]), math.sin(settings[1])


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Field in sensor axes, taken back by the turn of the last step; see :mod:`insemu.filters.rows`."""
    C, B, M, m = zeros(moment.nav, (3, 3)), zeros(moment.nav, (3, 3)), np.empty((3, 3)), np.empty(3)
    _field(settings, m)
    scalar_dcm_from_rpy(settings[2:5], M)
    scalar_dcm(moment.nav[6:10], C)
    scalar_dcm(moment.nav_before[6:10], B)
    axis = zeros(moment.nav, 3)  # a sensor axis north, east, down
    for i in range(3):
        now, change = 0.0 * C[0, 0], 0.0 * C[0, 0]
        for k in range(3):
            axis[k] = M[i, 0] * C[k, 0] + M[i, 1] * C[k, 1] + M[i, 2] * C[k, 2]
            now += axis[k] * m[k]
            for j in range(3):
                change += M[i, j] * (C[k, j] - B[k, j]) * m[k]
        rows.nu[i] = z[i] - now + moment.tau / moment.dt * change
        rows.H[i, 6] = axis[1] * m[2] - axis[2] * m[1]
        rows.H[i, 7] = axis[2] * m[0] - axis[0] * m[2]
        rows.H[i, 8] = axis[0] * m[1] - axis[1] * m[0]


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Direction of the field in sensor axes."""
    field = np.empty(3)
    _field(settings, field)
    return np.asarray(np.einsum("nji,j->ni", motion.C, field) @ dcm_from_rpy(settings[2:5]).T)


AID = Aid(
    "magnetometer",
    {"x": "1", "y": "1", "z": "1"},
    _fill,
    truth,
    {"declination": ("rad", 1), "inclination": ("rad", 1), "mounting": ("rad", 3)},
)
