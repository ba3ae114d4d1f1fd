"""Barometric height: above the ellipsoid, at a pressure port that may sit beside the IMU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.rotation import scalar_dcm

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Height of the port, taken back by the vertical velocity; see :mod:`insemu.filters.rows`."""
    nav, H = moment.nav, rows.H
    C = zeros(nav, (3, 3))
    scalar_dcm(nav[6:10], C)
    north, east, down = 0.0, 0.0, 0.0
    for k in range(3):
        north += C[0, k] * settings[k]
        east += C[1, k] * settings[k]
        down += C[2, k] * settings[k]
    rows.nu[0] = z[0] - (nav[2] - down + moment.tau * nav[5])
    H[0, 2] = -1.0
    H[0, 5] = moment.tau
    H[0, 6] = -east
    H[0, 7] = north


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Height of the port, m."""
    return motion.llh[:, 2:3] - motion.C[:, 2:3, :] @ settings[0:3]


AID = Aid("barometer", {"height": "m"}, _fill, truth, {"lever_arm": ("m", 3)})
