"""Two antennas of one receiver: the way from the first to the second, north, east and down, which holds heading and pitch."""

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
    """The baseline, taken back by the turn of the last step; see :mod:`insemu.filters.rows`."""
    C, B, way = zeros(moment.nav, (3, 3)), zeros(moment.nav, (3, 3)), zeros(moment.nav, 3)
    scalar_dcm(moment.nav[6:10], C)
    scalar_dcm(moment.nav_before[6:10], B)
    for i in range(3):
        change = 0.0 * C[0, 0]
        for k in range(3):
            way[i] += C[i, k] * settings[k]
            change += (C[i, k] - B[i, k]) * settings[k]
        rows.nu[i] = z[i] - way[i] + moment.tau / moment.dt * change
    rows.H[0, 7], rows.H[0, 8] = way[2], -way[1]
    rows.H[1, 6], rows.H[1, 8] = -way[2], way[0]
    rows.H[2, 6], rows.H[2, 7] = way[1], -way[0]


def truth(motion: TrueMotion, settings: Array) -> Array:
    """The baseline north, east, down, m."""
    return np.asarray(motion.C @ settings[0:3])


AID = Aid("dual_antenna", {"north": "m", "east": "m", "down": "m"}, _fill, truth, {"baseline": ("m", 3)})
