"""Covariance of a wavelet variance curve: from the data, and from a model's autocovariance or spectrum.

The whole matrix is what the GMWM weighs its scales with, and what its standard errors and test of fit stand on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance import _covariance_kernel
from insemu.variance.wavelet import check_levels, check_rate, check_signal, max_levels, wavelet_coefficients

Array = NDArray[np.float64]
Spectrum = Callable[[Array], ArrayLike]
Autocovariance = Callable[[NDArray[np.int64]], ArrayLike]


def wv_covariance(x: ArrayLike, *, filter: str = "haar", levels: int | None = None) -> Array:
    """Return the covariance matrix of the MODWT wavelet variances, estimated from the record itself.

    Parameters
    ----------
    x : (n,) array
        Signal.
    filter, levels
        As in :func:`~insemu.variance.wavelet.wavelet_variance`.

    Returns
    -------
    (J, J) array
        Covariance (already divided by the number of coefficients), in unit^4.

    Notes
    -----
    Equations (11) and (17) of Stebler et al. 2014. By Parseval the sum over all lags of squared sample cross-covariances is the sum over
    frequency of the product of two periodograms, so the whole matrix costs one transform per octave.
    The longest scales rest on few coefficients and are rough; a model's covariance (:func:`model_covariance`) is better once there is one.
    """
    coefficients = wavelet_coefficients(x, filter=filter, levels=levels)
    size = scipy.fft.next_fast_len(2 * coefficients[0].size, real=True)
    spectra = np.empty((len(coefficients), size // 2 + 1))
    for row, w in zip(spectra, coefficients, strict=True):
        row[:] = np.abs(scipy.fft.rfft(w, size)) ** 2 / w.size
    # both signs of frequency count
    weight = np.full(spectra.shape[1], 2.0)
    weight[0] = 1.0
    if size % 2 == 0:
        weight[-1] = 1.0
    counts = np.array([w.size for w in coefficients], dtype=float)
    return np.asarray((spectra * weight) @ spectra.T / size / np.maximum.outer(counts, counts))


def level1_autocovariance(
    n_samples: int,
    *,
    psd: Spectrum | None = None,
    autocovariance: Autocovariance | None = None,
    increments: Autocovariance | None = None,
    rate_hz: float = 1.0,
) -> Array:
    """Return the autocovariance at lags 0..n-1 of the first octave's Haar coefficients, from any of three descriptions of a process.

    The first octave halves the first difference of the signal, so it is stationary for random walks too, and every longer octave follows
    from it. Contributions of independent processes add.

    Parameters
    ----------
    n_samples : int
        Length of the record.
    psd : callable, optional
        Two-sided PSD of the sampled sequence in unit^2/Hz at frequencies in Hz (never asked at 0); for a random walk the pseudo-spectrum
        ``K^2 dt^2 / (2 sin(pi f dt))^2``.
    autocovariance : callable, optional
        Autocovariance at integer lags of a stationary process.
    increments : callable, optional
        Autocovariance at integer lags of the first differences.
    rate_hz : float
        Sampling rate; matters for ``psd`` only.

    Raises
    ------
    InputError
        Not exactly one description given.
    """
    given = [d for d in (psd, autocovariance, increments) if d is not None]
    if len(given) != 1:
        raise InputError(
            f"{len(given)} descriptions of the process given, expected one of psd, autocovariance, increments"
        )
    if psd is not None:
        # midpoints in frequency, so that a pole at 0 is never touched; the sum is exact up to lags folded at twice this length
        size = scipy.fft.next_fast_len(2 * n_samples, real=True)
        f = (np.arange(size) + 0.5) / (2 * size)
        rate_hz = check_rate(rate_hz)
        spectrum = np.asarray(psd(f * rate_hz), dtype=float) * rate_hz * np.sin(np.pi * f) ** 2
        # cosines at half-integer frequencies: the third kind of cosine transform, transposed
        return np.asarray(scipy.fft.dct(spectrum, type=2)[:n_samples] / (2.0 * size))
    lags = np.arange(n_samples + 1)
    if increments is not None:
        return np.asarray(increments(lags[:-1]), dtype=float) / 4.0
    assert autocovariance is not None
    gamma = np.asarray(autocovariance(lags), dtype=float)
    s = np.empty(n_samples)
    s[1:] = 2.0 * gamma[1:-1] - gamma[:-2] - gamma[2:]
    s[0] = 2.0 * (gamma[0] - gamma[1])
    return s / 4.0


def model_covariance(
    level1: ArrayLike, *, levels: int | None = None, n_samples: int | None = None, drift_per_sample: float = 0.0
) -> Array:
    """Return the exact covariance matrix of Haar MODWT wavelet variances of a Gaussian process over a finite record.

    Parameters
    ----------
    level1 : (n,) array
        From :func:`level1_autocovariance` (sums of independent processes add).
    levels : int, optional
        Number of octaves; all by default.
    n_samples : int, optional
        Length of the record; the length of ``level1`` by default.
    drift_per_sample : float
        Deterministic slope, which gives the coefficients a mean.

    Returns
    -------
    (J, J) array
        In unit^4. Entry (m, l) is ``sum of 2 cov^2 / (M_m M_l)`` over all pairs of coefficients, of which equations (10), (15) of
        Stebler et al. 2014 are the limit.
    """
    s1 = check_signal(level1, "level-1 autocovariance")
    n = s1.size if n_samples is None else n_samples
    if n > s1.size:
        raise InputError(f"level-1 autocovariance has {s1.size} lags, expected at least the record's {n} samples")
    count = check_levels(levels, max_levels(n), n)
    means = 0.5 * drift_per_sample * 2.0 ** np.arange(count, dtype=np.float64)
    out = np.empty((count, count))
    _covariance_kernel.haar_covariances(np.ascontiguousarray(s1[:n]), n, count, means, out)
    return out


def model_edof(level1: ArrayLike, value: ArrayLike, *, drift_per_sample: float = 0.0) -> Array:
    """Return the equivalent degrees of freedom ``2 v^2 / var(v_hat)`` of a model's Haar wavelet variances (its shape is what matters).

    Parameters
    ----------
    level1 : (n,) array
        From :func:`level1_autocovariance`, n the length of the record.
    value : (J,) array
        The model's wavelet variance at scales 2, 4, ..., 2^J.
    drift_per_sample : float
        As in :func:`model_covariance`.
    """
    v = np.asarray(value, dtype=float)
    return 2.0 * v**2 / np.diag(model_covariance(level1, levels=v.size, drift_per_sample=drift_per_sample))
