"""Covariance of wavelet variances by the exact sum, for any filter."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from insemu.variance import modwt_filters
from insemu.variance.covariance import Autocovariance
from insemu.variance.wavelet import check_levels, max_levels

Array = NDArray[np.float64]


def model_covariance_of_filter(
    autocovariance: Autocovariance, n_samples: int, *, filter: str = "haar", levels: int | None = None
) -> Array:
    """Return the covariance matrix of MODWT wavelet variances of a stationary Gaussian process, any filter.

    The same exact sum as :func:`model_covariance`, with the filters' cross-correlations by fast convolution: for records up to some
    100,000 samples.

    Parameters
    ----------
    autocovariance : callable
        Of whole lags in samples, unit^2.
    n_samples : int
        Length of the record.
    filter : str
        Name of the filter.
    levels : int, optional
        Octaves; all by default.
    """
    h, g = modwt_filters(filter)
    count = check_levels(levels, max_levels(n_samples, h.size), n_samples)
    filters = _equivalent_filters(h, g, count)
    gamma = np.asarray(autocovariance(np.arange(2 * n_samples)), dtype=float)
    both = np.concatenate([gamma[:0:-1], gamma])
    out = np.empty((count, count))
    for j, hj in enumerate(filters):
        # cov(W_j[t + lag], W_k[t]) = sum_a sum_b hj[a] hk[b] gamma(lag - a + b)
        seen = scipy.signal.fftconvolve(both, hj)
        for k in range(j, count):
            hk = filters[k]
            cross = scipy.signal.fftconvolve(seen, hk[::-1])
            lags = np.arange(hj.size - n_samples, n_samples - hk.size + 1)
            pairs = np.minimum(n_samples - 1, n_samples - 1 - lags) - np.maximum(hk.size - 1, hj.size - 1 - lags) + 1
            squares = cross[lags + gamma.size - 1 + hk.size - 1] ** 2
            out[j, k] = (
                2.0 * np.sum(pairs * squares) / (float(n_samples - hj.size + 1) * float(n_samples - hk.size + 1))
            )
            out[k, j] = out[j, k]
    return out


def _equivalent_filters(h: Array, g: Array, levels: int) -> list[Array]:
    """MODWT wavelet filters of every level as seen by the signal (equation (5) of Stebler et al. 2014)."""
    out, smooth = [], np.ones(1)
    for j in range(levels):
        step = 1 << j
        up_h, up_g = np.zeros((h.size - 1) * step + 1), np.zeros((h.size - 1) * step + 1)
        up_h[::step], up_g[::step] = h, g
        out.append(np.convolve(smooth, up_h))
        smooth = np.convolve(smooth, up_g)
    return out
