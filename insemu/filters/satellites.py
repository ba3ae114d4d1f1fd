"""Raw observations of a GNSS receiver, compiled: pseudorange and range rate to one satellite.

Both are the rows of a fix (:func:`~insemu.filters.measurements.fill_fix`) along the line of sight, plus the bias and the drift of the receiver's
clock: lever arm, age and the gyroscope's noise act as they do there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.earth import E2, scalar_radii
from insemu.filters.measurements import fill_fix
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _to_ned(nav: Array, x: float, y: float, z: float, out: Array) -> None:
    """A vector of Earth axes in north, east, down at a state, written to ``out`` (3,)."""
    s, c, sl, cl = math.sin(nav[0]), math.cos(nav[0]), math.sin(nav[1]), math.cos(nav[1])
    out[0] = -s * (cl * x + sl * y) + c * z
    out[1] = cl * y - sl * x
    out[2] = -c * (cl * x + sl * y) - s * z


@njit(cache=True, nogil=True)
def fill_satellite(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Rows of a satellite (:mod:`insemu.filters.rows`): pseudorange, m, and range rate, m/s.

    Parameters
    ----------
    moment : Moment
    z : (2,) array
        Pseudorange and range rate, less the satellite's clock.
    settings : (6,) array
        Position and velocity of the satellite as in :class:`~insemu.records.RawRecord`.
    rows : Rows
        Overwritten, two of them.
    """
    nav, n = moment.nav, rows.H.shape[1]
    fix = Rows(zeros(nav, 6), zeros(nav, (6, n)), zeros(nav, (6, 6)))
    here = zeros(nav, 6)
    for i in range(6):
        here[i] = nav[i]
    fill_fix(moment, here, settings, fix)  # position and velocity of the IMU less those of the antenna then
    _, rn = scalar_radii(math.sin(nav[0]))
    s, c = math.sin(nav[0]), math.cos(nav[0])
    across = (rn + nav[2]) * c
    polar = (rn * (1.0 - E2) + nav[2]) * s
    away, speed = zeros(nav, 3), zeros(nav, 3)
    x, y = settings[0] - across * math.cos(nav[1]), settings[1] - across * math.sin(nav[1])
    _to_ned(nav, x, y, settings[2] - polar, away)
    _to_ned(nav, settings[3], settings[4], settings[5], speed)
    square = 0.0 * nav[0]
    for i in range(3):
        away[i] += fix.nu[i]
        speed[i] += fix.nu[3 + i] - nav[3 + i]
        square += away[i] * away[i]
    distance, rate = math.sqrt(square), 0.0 * nav[0]
    for i in range(3):
        away[i] /= distance
        rate += away[i] * speed[i]
    bias, drift = moment.clock[0] - moment.tau * moment.clock[1], moment.clock[1]
    rows.nu[0], rows.nu[1] = z[0] - distance - bias, z[1] - rate - drift
    for i in range(3):
        turns = (speed[i] - rate * away[i]) / distance  # the line of sight turns with the place of the antenna
        for j in range(n):
            rows.H[0, j] -= away[i] * fix.H[i, j]
            rows.H[1, j] -= away[i] * fix.H[3 + i, j] + turns * fix.H[i, j]
        for j in range(3):
            rows.R[1, 1] += away[i] * away[j] * fix.R[3 + i, 3 + j]
    if moment.clock_at >= 0:
        rows.H[0, moment.clock_at], rows.H[0, moment.clock_at + 1] = 1.0, -moment.tau
        rows.H[1, moment.clock_at + 1] = 1.0
