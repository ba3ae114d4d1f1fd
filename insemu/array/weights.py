"""Weights of the units of an array: equal, by variance, scale-wise, and what is known of the units besides their estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from insemu.records import Series
from insemu.variance import wavelet_covariance, wavelet_variance

Array = NDArray[np.float64]

#: Standard deviation of the logarithm of what units of one type are worth: more than a factor of 10 would be another type.
WIDEST_SPREAD = math.log(10.0)
#: Steps of its grid.
SPREADS = 61


def equal(units: int) -> Array:
    """One over the number of units, for each."""
    return np.full(units, 1.0 / units)


def inverse_variance(signals: Sequence[Series]) -> Array:
    """Weights in inverse proportion to the variance of the signals, (units,)."""
    inverse = np.array([1.0 / float(np.var(s.values)) for s in signals])
    return np.asarray(inverse / inverse.sum())


def wavelet_matrices(signals: Sequence[Series]) -> tuple[Array, Array]:
    """Wavelet variances and cross-covariances of units that are sampled together.

    Returns
    -------
    matrices : (J, units, units) array
        One per scale.
    p_values : (units, units) array
        Of each pair being independent; one on the diagonal.
    """
    n, rate = len(signals), signals[0].rate_hz
    own = [wavelet_variance(s.values, rate).value for s in signals]
    out, p = np.zeros((own[0].size, n, n)), np.ones((n, n))
    for i in range(n):
        out[:, i, i] = own[i]
        for k in range(i):
            pair = wavelet_covariance(signals[i].values, signals[k].values, rate)
            out[:, i, k] = out[:, k, i] = pair.value
            p[i, k] = p[k, i] = pair.p_value
    return out, p


def scale_wise(matrices: Array) -> Array:
    """Weights of least mean wavelet variance over all scales (Zhang et al. 2022, equal weights of the scales).

    Parameters
    ----------
    matrices : (J, units, units) array
        Of :func:`wavelet_matrices`.

    Returns
    -------
    (units,) array
        ``A^-1 1 / (1' A^-1 1)`` with the mean matrix A.
    """
    w = np.linalg.solve(matrices.mean(axis=0), np.ones(matrices.shape[1]))
    return np.asarray(w / w.sum())


def regressed(groups: Sequence[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    """Logarithms of what units are worth, drawn towards their common mean as far as their estimates are uncertain.

    Normal units around a mean that is not known, with a spread that is common to the groups and not known either: flat up to
    :data:`WIDEST_SPREAD` (Gelman 2006), integrated out.

    Parameters
    ----------
    groups : sequence of ((units,), (units,)) arrays
        Estimates and their variances, per axis of one sensor.

    Returns
    -------
    list of ((units,), (units,)) arrays
        Posterior means and variances.
    """
    tau = np.linspace(0.0, WIDEST_SPREAD, SPREADS)
    logs, moments = np.zeros(tau.size), []
    for y, v in groups:
        total = np.maximum(v, 1e-12)[None, :] + tau[:, None] ** 2
        precision = (1.0 / total).sum(axis=1)
        centre = (y / total).sum(axis=1) / precision
        logs -= 0.5 * (np.log(total).sum(axis=1) + np.log(precision) + ((y - centre[:, None]) ** 2 / total).sum(axis=1))
        kept = v / total
        mean = y + kept * (centre[:, None] - y)
        moments.append((mean, v * tau[:, None] ** 2 / total + kept**2 / precision[:, None]))
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    out = []
    for mean, variance in moments:
        m = weight @ mean
        out.append((m, weight @ (variance + (mean - m) ** 2)))
    return out
