"""Weighted least squares of moments that are any function of their coordinates: the minimum, its slopes and its bias."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

Array = NDArray[np.float64]
Moments = Callable[[Array], Array]

#: Relative step of numerical derivatives.
STEP = 1e-4


def slopes(expected: Moments, x: Array) -> Array:
    """Derivatives (moments, coordinates) of the moments by the coordinates."""
    columns = [(expected(x + h) - expected(x - h)) / (2.0 * STEP) for h in STEP * np.eye(x.size)]
    return np.column_stack(columns)


def minimised(
    expected: Moments, value: Array, W: Array, start: Array, bounds: tuple[Array, Array]
) -> tuple[Array, float]:
    """The coordinates whose moments are nearest to ``value`` in the metric ``W``, and the squared distance.

    Parameters
    ----------
    expected : callable
        Moments (k,) of coordinates (p,).
    value : (k,) array
    W : (rows, k) array
        Root of the weights.
    start : (p,) array
    bounds : tuple of (p,) arrays
        Least and largest coordinates.
    """
    low, high = bounds
    found = scipy.optimize.least_squares(
        lambda x: W @ (expected(x) - value),
        np.clip(start, low + 1e-9, high - 1e-9),
        jac=lambda x: W @ slopes(expected, x),
        bounds=bounds,
        max_nfev=60,
    )
    return found.x, float(2.0 * found.cost)


def bias(expected: Moments, x: Array, D: Array, W: Array, C: Array) -> Array:
    """Mean error of the coordinates from the curvature of the moments (Box 1971, equation (2.26)), at most half a standard error.

    Parameters
    ----------
    expected : callable
        Moments (k,) of coordinates (p,).
    x : (p,) array
        Where the minimum is.
    D : (k, p) array
        Slopes there.
    W : (rows, k) array
        Root of the weights.
    C : (p, p) array
        Covariance of the coordinates.
    """
    known = np.flatnonzero(np.isfinite(np.diag(C)) & (np.diag(C) < 1.0))
    if known.size < x.size:
        return np.zeros(x.size)  # a parameter that is hardly known has no second order
    size, directions = np.linalg.eigh(C)
    here, curved = expected(x), np.zeros(D.shape[0])
    for step in (directions * np.sqrt(np.maximum(size, 0.0))).T:
        curved += expected(x + step) + expected(x - step) - 2.0 * here
    limit = 0.5 * np.sqrt(np.diag(C))
    return np.asarray(np.clip(-0.5 * np.linalg.pinv(W @ D) @ (W @ curved), -limit, limit))
