"""Wavelet filters by name, in MODWT scaling (equation (3) of paper 000)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

#: Scaling filters in unit-energy (DWT) scaling.
FILTERS: dict[str, tuple[float, ...]] = {"haar": (0.5**0.5, 0.5**0.5)}


def modwt_filters(name: str) -> tuple[Array, Array]:
    """Return the first-octave MODWT wavelet and scaling filters ``(h, g)`` of a family member.

    Raises
    ------
    InputError
        An unknown name; the message gives the nearest.
    """
    if name not in FILTERS:
        raise InputError(f"unknown wavelet filter '{name}'" + nearest(name, FILTERS))
    g = np.array(FILTERS[name]) / np.sqrt(2.0)
    # quadrature mirror: h_l = (-1)^l g_(L-1-l)
    h = g[::-1] * (-1.0) ** np.arange(g.size)
    return h, g
