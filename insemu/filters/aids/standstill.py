"""A vehicle that is known to stand still: zero velocity, zero angular rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.earth import RATE
from insemu.filters.aid import Aid
from insemu.filters.measurements import against_earth
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.records import AidRecord
from insemu.rotation import scalar_dcm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Standstill:
    """Intervals in which the vehicle is known to stand still: zero velocity and zero angular rate are fed as measurements.

    Parameters
    ----------
    intervals : sequence of (start, end)
        s, on the IMU's clock.
    every : float
        Seconds between updates.
    velocity_sigma, rate_sigma : float
        m/s and rad/s; infinite leaves that part out.
    """

    intervals: Sequence[tuple[float, float]]
    every: float = 1.0
    velocity_sigma: float = 0.01
    rate_sigma: float = 1e-4

    def record(self, t: ArrayLike) -> AidRecord | None:
        """As an aid on the times ``t`` (n,) of an IMU; None where no update falls inside them."""
        stamps = np.asarray(t, dtype=np.float64)
        parts = [np.arange(a + self.every, b, self.every) for a, b in self.intervals]
        times = np.unique(np.concatenate([*parts, np.zeros(0)]))
        times = times[(times > stamps[0]) & (times <= stamps[-1])]
        if not times.size:
            return None
        # a known state has no time of its own: it holds at the sample after
        at = stamps[np.searchsorted(stamps, times - 1e-6 * self.every)]
        first = np.concatenate([[True], np.diff(at) > 0.0])
        at, since = at[first], times[first] - self.every
        std = np.tile(np.repeat([self.velocity_sigma, self.rate_sigma], 3), (at.size, 1))
        return AidRecord("standstill", at, np.zeros_like(std), std, since=since)


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Zero velocity (rows 0..2) and zero mean angular rate (rows 3..5); see :mod:`insemu.filters.rows`."""
    nav, axis = moment.nav, moment.axis
    nu, H, R = rows.nu, rows.H, rows.R
    C = zeros(nav, (3, 3))
    scalar_dcm(nav[6:10], C)
    omega = zeros(nav, 3)
    against_earth(nav, C, moment.mean_rate, omega)
    we_n, we_d = RATE * math.cos(nav[0]), -RATE * math.sin(nav[0])
    for i in range(3):
        nu[i] = -nav[3 + i]
        H[i, 3 + i] = 1.0
        nu[3 + i] = -omega[i]
        R[3 + i, 3 + i] = moment.white[i] / moment.samples
        # the Earth's rate in body axes moves with the attitude error: -C' (w_ie x phi) ... = -[C' w_ie] as seen by phi
        H[3 + i, 6] = -(C[1, i] * we_d)
        H[3 + i, 7] = C[0, i] * we_d - C[2, i] * we_n
        H[3 + i, 8] = C[1, i] * we_n
    for s in range(axis.size):
        if 0 <= axis[s] < 3:
            H[3 + axis[s], 9 + s] = -moment.c_of[s]


AID = Aid(
    "standstill",
    {"vel_n": "m/s", "vel_e": "m/s", "vel_d": "m/s", "rate_x": "rad/s", "rate_y": "rad/s", "rate_z": "rad/s"},
    _fill,
)
