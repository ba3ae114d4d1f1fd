"""A wheel or log: velocity forward, sideways and down in vehicle axes, of a place beside the IMU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.measurements import against_earth
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.rotation import dcm_from_rpy, scalar_dcm, scalar_dcm_from_rpy

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def fill_velocity(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Velocity of the wheel in vehicle axes (:mod:`insemu.filters.rows`).

    Parameters
    ----------
    moment : Moment
    z : (3,) array
        Forward, sideways, down, m/s.
    settings : (6,) array
        Lever arm from the IMU, m, and mounting, rad.
    rows : Rows
        Overwritten, three of them.
    """
    nav, axis, c_of = moment.nav, moment.axis, moment.c_of
    nu, H, R = rows.nu, rows.H, rows.R
    C, M, T = zeros(nav, (3, 3)), np.empty((3, 3)), zeros(nav, (3, 3))
    before, now, omega = zeros(nav, 3), zeros(nav, 3), zeros(nav, 3)
    scalar_dcm_from_rpy(settings[3:6], M)
    _in_vehicle(moment.nav_before, M, C, T, before)
    _in_vehicle(nav, M, C, T, now)
    against_earth(nav, C, moment.mean_rate, omega)
    by_rate = np.empty((3, 3))  # velocity of the wheel in vehicle axes by each rate, through the lever arm
    for i in range(3):
        by_rate[i, 0] = M[i, 2] * settings[1] - M[i, 1] * settings[2]
        by_rate[i, 1] = M[i, 0] * settings[2] - M[i, 2] * settings[0]
        by_rate[i, 2] = M[i, 1] * settings[0] - M[i, 0] * settings[1]
    for i in range(3):
        # as it was tau seconds ago: velocity and axes change by what the last step changed
        nu[i] = z[i] - now[i] - moment.tau / moment.dt * (before[i] - now[i])
        for k in range(3):
            nu[i] -= by_rate[i, k] * omega[k]
            H[i, 3 + k] = T[i, k]
            for j in range(3):
                R[i, j] += by_rate[i, k] * by_rate[j, k] * moment.white[k] / moment.samples
        H[i, 6] = T[i, 1] * nav[5] - T[i, 2] * nav[4]
        H[i, 7] = T[i, 2] * nav[3] - T[i, 0] * nav[5]
        H[i, 8] = T[i, 0] * nav[4] - T[i, 1] * nav[3]
        for s in range(axis.size):
            if 0 <= axis[s] < 3:
                H[i, 9 + s] = -c_of[s] * by_rate[i, axis[s]]


@njit(cache=True, nogil=True)
def _in_vehicle(nav: Array, M: Array, C: Array, T: Array, v: Array) -> None:
    """Body to NED ``C``, NED to vehicle ``T`` (both (3, 3)) and the velocity ``v`` (3,) of the IMU in vehicle axes, overwritten."""
    scalar_dcm(nav[6:10], C)
    for i in range(3):
        v[i] = 0.0
        for j in range(3):
            T[i, j] = M[i, 0] * C[j, 0] + M[i, 1] * C[j, 1] + M[i, 2] * C[j, 2]
            v[i] += T[i, j] * nav[3 + j]


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Velocity of the wheel in vehicle axes, m/s."""
    in_body = np.einsum("nji,nj->ni", motion.C, motion.velocity) + np.cross(motion.rate, settings[0:3])
    return np.asarray(in_body @ dcm_from_rpy(settings[3:6]).T)


AID = Aid(
    "odometer",
    {"forward": "m/s", "sideways": "m/s", "down": "m/s"},
    fill_velocity,
    truth,
    {"lever_arm": ("m", 3), "mounting": ("rad", 3)},
)
