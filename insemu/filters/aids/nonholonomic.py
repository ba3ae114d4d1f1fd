"""Non-holonomic constraint: a vehicle on wheels goes neither sideways nor up at one place of its body (Dissanayake et al. 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.aids import odometer
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """The lower two rows of an odometer; see :mod:`insemu.filters.rows`."""
    n = rows.H.shape[1]
    three = Rows(zeros(moment.nav, 3), zeros(moment.nav, (3, n)), zeros(moment.nav, (3, 3)))
    measured = zeros(moment.nav, 3)
    measured[1], measured[2] = z[0], z[1]
    odometer.fill_velocity(moment, measured, settings, three)
    for i in range(2):
        rows.nu[i] = three.nu[1 + i]
        for j in range(n):
            rows.H[i, j] = three.H[1 + i, j]
        for j in range(2):
            rows.R[i, j] = three.R[1 + i, 1 + j]


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Velocity of the place sideways and down in vehicle axes, m/s."""
    return odometer.truth(motion, settings)[:, 1:]


AID = Aid(
    "nonholonomic",
    {"sideways": "m/s", "down": "m/s"},
    _fill,
    truth,
    {"lever_arm": ("m", 3), "mounting": ("rad", 3)},
    constraint=True,
)
