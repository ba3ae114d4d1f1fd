"""Pose from outside (cameras, lidar, motion capture): position from an origin and roll, pitch, heading of a body fixed to the IMU.

The position is in metres north, east and down by the radii of curvature at the origin. The body sits at the IMU; ``mounting`` turns IMU axes into
its axes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.earth import radii, scalar_radii
from insemu.filters.aid import Aid, TrueMotion
from insemu.filters.rows import Moment, Rows
from insemu.lanes import zeros
from insemu.rotation import dcm_from_rpy, rpy_from_dcm, scalar_dcm, scalar_dcm_from_rpy, scalar_wrapped

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _attitude(nav: Array, settings: Array, T: Array, out: Array) -> None:
    """Body to NED ``T`` (3, 3), and roll, pitch, heading ``out`` (3,), both overwritten."""
    C, M = zeros(nav, (3, 3)), np.empty((3, 3))
    scalar_dcm(nav[6:10], C)
    scalar_dcm_from_rpy(settings[3:6], M)
    for i in range(3):
        for j in range(3):
            T[i, j] = C[i, 0] * M[j, 0] + C[i, 1] * M[j, 1] + C[i, 2] * M[j, 2]
    out[0] = math.atan2(T[2, 1], T[2, 2])
    out[1] = math.atan2(-T[2, 0], math.sqrt(T[2, 1] * T[2, 1] + T[2, 2] * T[2, 2]))
    out[2] = math.atan2(T[1, 0], T[0, 0])


@njit(cache=True, nogil=True)
def _fill(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Pose, taken back by velocity and turn of the last step; see :mod:`insemu.filters.rows`."""
    nav, share = moment.nav, moment.tau / moment.dt
    nu, H = rows.nu, rows.H
    rm, rn = scalar_radii(math.sin(settings[0]))
    north, east = rm + settings[2], (rn + settings[2]) * math.cos(settings[0])
    here, earlier = scalar_radii(math.sin(nav[0])), 0.5 * moment.tau * moment.tau / moment.dt
    nu[0] = z[0] - north * (nav[0] - settings[0] + nav[10])
    nu[1] = z[1] - east * scalar_wrapped(nav[1] - settings[1] + nav[11])
    nu[2] = z[2] - (settings[2] - nav[2] - nav[12])
    H[0, 0] = north / (here[0] + nav[2])
    H[1, 1] = east / ((here[1] + nav[2]) * math.cos(nav[0]))
    H[2, 2] = 1.0
    for i in range(3):
        by = H[i, i]
        nu[i] += by * (moment.tau * nav[3 + i] - earlier * (nav[3 + i] - moment.nav_before[3 + i]))
        H[i, 3 + i] = -moment.tau * by
    T, now, before = zeros(nav, (3, 3)), zeros(nav, 3), zeros(nav, 3)
    _attitude(moment.nav_before, settings, T, before)
    _attitude(nav, settings, T, now)
    for i in range(3):
        nu[3 + i] = scalar_wrapped(z[3 + i] - now[i] + share * scalar_wrapped(now[i] - before[i]))
    level, upright = T[0, 0] * T[0, 0] + T[1, 0] * T[1, 0], T[2, 1] * T[2, 1] + T[2, 2] * T[2, 2]
    H[3, 6] = (T[2, 2] * T[1, 1] - T[2, 1] * T[1, 2]) / upright
    H[3, 7] = (T[2, 1] * T[0, 2] - T[2, 2] * T[0, 1]) / upright
    H[4, 6], H[4, 7] = -T[1, 0] / math.sqrt(upright), T[0, 0] / math.sqrt(upright)
    H[5, 6], H[5, 7], H[5, 8] = -T[0, 0] * T[2, 0] / level, -T[1, 0] * T[2, 0] / level, 1.0


def truth(motion: TrueMotion, settings: Array) -> Array:
    """Position from the origin, m, and roll, pitch, heading, rad."""
    lat, _, h = settings[0:3]
    rm, rn = radii(lat)
    scale = np.array([rm + h, (rn + h) * math.cos(lat), -1.0])
    away = motion.llh - settings[0:3]
    away[:, 1] = np.mod(away[:, 1] + np.pi, 2.0 * np.pi) - np.pi
    return np.hstack([away * scale, rpy_from_dcm(motion.C @ dcm_from_rpy(settings[3:6]).T)])


AID = Aid(
    "pose",
    {"north": "m", "east": "m", "down": "m", "roll": "rad", "pitch": "rad", "heading": "rad"},
    _fill,
    truth,
    {"latitude": ("rad", 1), "longitude": ("rad", 1), "height": ("m", 1), "mounting": ("rad", 3)},
)
