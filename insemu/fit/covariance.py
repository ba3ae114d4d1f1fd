"""Covariance of Haar wavelet variances under a model: exact for a finite record, in time that does not grow with its length.

The large-record limit is equation (15) of Stebler et al. 2014; here the sum over the lags of the record is kept, which matters at the longest scales.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.fit import _covariance_kernel
from insemu.noise import NoiseModel
from insemu.variance import WaveletVariance, level1_autocovariance
from insemu.variance import filter_covariance as covariance_of_filter
from insemu.variance import model_covariance as covariance_over_lags

Array = NDArray[np.float64]


def model_covariance(model: NoiseModel, n_samples: int, scale_samples: ArrayLike, dt: float) -> Array:
    """Covariance of the Haar MODWT wavelet variances of a Gaussian signal of this model.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    n_samples : int
        Length of the record.
    scale_samples : (J,) array
        Scales 2^j in samples, ascending, at most ``n_samples``.
    dt : float
        Sampling interval, s.

    Returns
    -------
    (J, J) array
        unit^4. A sinusoid's phase is taken as one unknown draw: it has no variance of its own, but scatters with the noise in its band.

    Notes
    -----
    Processes that are no sum of first-order ones (:meth:`insemu.noise.Process.markov_parts`) take a slower way over all lags.
    """
    scale = np.asarray(scale_samples, dtype=np.float64)
    m = scale / 2.0
    parts = [p.markov_parts(dt) for p in model]
    known = [part for part in parts if part is not None]
    drift = math.sqrt(sum(part.drift**2 for part in known))
    out = np.empty((m.size, m.size))
    if len(known) < len(parts):
        increments = model.difference_covariance(1, dt, n_samples)
        level1 = level1_autocovariance(n_samples, increments=lambda lag: increments[lag])
        full = covariance_over_lags(level1, levels=round(math.log2(scale[-1])), drift_per_sample=drift)
        keep = np.round(np.log2(scale)).astype(int) - 1
        out = full[np.ix_(keep, keep)]
    else:
        poly = np.array([[part.white, part.quantized, part.walk, part.flicker] for part in known]).sum(axis=0)
        decay = np.array([a for part in known for a in part.decay])
        variance = np.array([c for part in known for c in part.variance])
        _covariance_kernel.covariances(m, n_samples, poly, decay, variance, drift, out)
    for p, part in zip(model, parts, strict=True):
        if part is not None and part.line:
            f, amplitude = part.line
            density = sum(float(q.psd(np.array([f]), dt)[0]) / dt for q in model if not q.single_draw)
            gain = 2.0 * p.wavelet_variance(scale, dt) / amplitude**2  # squared gain of the scales at the line
            out += 2.0 * density * amplitude**2 * np.outer(gain, gain) / n_samples
    return out


def covariance_of_curve(model: NoiseModel, curve: WaveletVariance, scale_samples: ArrayLike | None = None) -> Array:
    """Covariance of a curve under a model, of any filter, with the gaps of the record.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    curve : WaveletVariance
    scale_samples : (J,) array, optional
        The scales of the curve that are asked for; all by default.

    Returns
    -------
    (J, J) array
        unit^4.
    """
    scale = curve.scale_samples if scale_samples is None else np.asarray(scale_samples)
    n, dt = curve.n_samples, 1.0 / curve.rate_hz
    if curve.filter == "haar":
        out = model_covariance(model, n, scale, dt)
    else:
        out = covariance_of_filter(model, curve.filter, scale, n, dt)
    if curve.inflation is not None:
        larger = np.sqrt(curve.inflation[np.searchsorted(curve.scale_samples, scale)])
        out = out * np.outer(larger, larger)
    if curve.white_scatter > 0:
        share = 1.0 / scale.astype(float)  # wavelet variance of white noise of unit variance (Haar)
        out = out + curve.white_scatter * np.outer(share, share)
    return out
