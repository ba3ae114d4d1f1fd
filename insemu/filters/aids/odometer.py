"""A wheel or log: velocity forward, sideways and down in vehicle axes, of a place beside the IMU."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from insemu.earth import RATE
from insemu.filters.aid import Aid, TrueMotion
from insemu.rotation import dcm_from_rpy, scalar_dcm

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def _fill(
    nav: Array,
    nav_before: Array,
    dt: float,
    tau: float,
    mean_rate: Array,
    count: int,
    white: Array,
    c_of: Array,
    axis: Ints,
    z: Array,
    settings: Array,
    nu: Array,
    H: Array,
    R: Array,
) -> None:
    """Velocity of the wheel in vehicle axes; see :func:`insemu.filters.aids.fill_aid`."""
    C, T = np.empty((3, 3)), np.empty((3, 3))
    before, now = np.empty(3), np.empty(3)
    _in_vehicle(nav_before, settings, C, T, before)
    _in_vehicle(nav, settings, C, T, now)
    omega = np.empty(3)  # against the Earth
    for i in range(3):
        omega[i] = mean_rate[i] - C[0, i] * RATE * math.cos(nav[0]) + C[2, i] * RATE * math.sin(nav[0])
    for i in range(3):
        # row i of the vehicle's axes, in IMU axes, and what a rate does there through the lever arm
        m0, m1, m2 = 0.0, 0.0, 0.0
        for j in range(3):
            m0 += T[i, j] * C[j, 0]
            m1 += T[i, j] * C[j, 1]
            m2 += T[i, j] * C[j, 2]
        by_rate = (
            m2 * settings[1] - m1 * settings[2],
            m0 * settings[2] - m2 * settings[0],
            m1 * settings[0] - m0 * settings[1],
        )
        turn = by_rate[0] * omega[0] + by_rate[1] * omega[1] + by_rate[2] * omega[2]
        # as it was tau seconds ago: velocity and axes change by what the last step changed
        nu[i] = z[i] - (now[i] + tau / dt * (before[i] - now[i]) + turn)
        for j in range(3):
            H[i, 3 + j] = T[i, j]
        H[i, 6] = T[i, 1] * nav[5] - T[i, 2] * nav[4]
        H[i, 7] = T[i, 2] * nav[3] - T[i, 0] * nav[5]
        H[i, 8] = T[i, 0] * nav[4] - T[i, 1] * nav[3]
        for s in range(axis.size):
            for k in range(3):
                if axis[s] == k:
                    H[i, 9 + s] = -c_of[s] * by_rate[k]
        for j in range(3):
            n0, n1, n2 = 0.0, 0.0, 0.0
            for k in range(3):
                n0 += T[j, k] * C[k, 0]
                n1 += T[j, k] * C[k, 1]
                n2 += T[j, k] * C[k, 2]
            R[i, j] = (
                by_rate[0] * (n2 * settings[1] - n1 * settings[2]) * white[0]
                + by_rate[1] * (n0 * settings[2] - n2 * settings[0]) * white[1]
                + by_rate[2] * (n1 * settings[0] - n0 * settings[1]) * white[2]
            ) / count


@njit(cache=True, nogil=True)
def _in_vehicle(nav: Array, settings: Array, C: Array, T: Array, v: Array) -> None:
    """Body to NED ``C``, NED to vehicle ``T`` (both (3, 3)) and the velocity ``v`` (3,) of the IMU in vehicle axes, overwritten."""
    scalar_dcm(nav[6:10], C)
    cr, cp, cy = math.cos(settings[3]), math.cos(settings[4]), math.cos(settings[5])
    sr, sp, sy = math.sin(settings[3]), math.sin(settings[4]), math.sin(settings[5])
    for j in range(3):
        T[0, j] = cp * cy * C[j, 0] + (sr * sp * cy - cr * sy) * C[j, 1] + (cr * sp * cy + sr * sy) * C[j, 2]
        T[1, j] = cp * sy * C[j, 0] + (sr * sp * sy + cr * cy) * C[j, 1] + (cr * sp * sy - sr * cy) * C[j, 2]
        T[2, j] = -sp * C[j, 0] + sr * cp * C[j, 1] + cr * cp * C[j, 2]
    for i in range(3):
        v[i] = T[i, 0] * nav[3] + T[i, 1] * nav[4] + T[i, 2] * nav[5]


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Velocity of the wheel in vehicle axes, m/s."""
    in_body = np.einsum("nji,nj->ni", motion.C, motion.velocity) + np.cross(motion.rate, settings[0:3])
    return np.asarray(in_body @ dcm_from_rpy(settings[3:6]).T)


AID = Aid(
    "odometer",
    {"forward": "m/s", "sideways": "m/s", "down": "m/s"},
    _fill,
    truth,
    {"lever_arm": ("m", 3), "mounting": ("rad", 3)},
)
