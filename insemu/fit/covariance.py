"""Covariance of Haar wavelet variances under a model: exact for a finite record, in time that does not grow with its length.

The large-record limit is equation (15) of Stebler et al. 2014; here the sum over the lags of the record is kept, which matters at the longest scales.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.fit import _covariance_kernel
from insemu.noise import AR1, ARMA, BI, DR, GM, QN, RW, SIN, WN, NoiseModel, Process
from insemu.variance.covariance import level1_autocovariance
from insemu.variance.covariance import model_covariance as covariance_over_lags

Array = NDArray[np.float64]

_POLY = {WN: 0, QN: 1, RW: 2, BI: 3}


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
    Moving averages and first-order processes with a negative coefficient take a slower way over all lags.
    """
    scale = np.asarray(scale_samples, dtype=np.float64)
    m = scale / 2.0
    drift = math.sqrt(sum((p.parameters["R"] * dt) ** 2 for p in model if isinstance(p, DR)))
    out = np.empty((m.size, m.size))
    noise = [p for p in model if not isinstance(p, DR | SIN)]
    if any(_needs_lags(p) for p in noise):
        level1 = sum((_level1(p, n_samples, dt) for p in noise), start=np.zeros(n_samples))
        full = covariance_over_lags(level1, levels=round(math.log2(scale[-1])), drift_per_sample=drift)
        keep = np.round(np.log2(scale)).astype(int) - 1
        out = full[np.ix_(keep, keep)]
    else:
        poly = np.zeros(4)
        a, c = [], []
        for p in noise:
            value = p.parameters
            if isinstance(p, GM):
                a.append(value["beta"] * dt)
                c.append(value["sigma"] ** 2)
            elif isinstance(p, AR1):
                a.append(-math.log(value["phi"]))
                c.append(p.variance)
            else:
                poly[_POLY[type(p)]] += _sample_variance(p, dt)
        _covariance_kernel.covariances(m, n_samples, poly, np.array(a), np.array(c), drift, out)
    for p in model:
        if isinstance(p, SIN):
            value = p.parameters
            line = np.sqrt(p.wavelet_variance(scale, dt))  # amplitude / sqrt(2) times the gain at the line
            density = sum(float(q.psd(np.array([value["f"]]), dt)[0]) / dt for q in noise)
            x = math.pi * value["f"] * dt
            gain = np.abs(np.sin(m * x) ** 2 / (m * math.sin(x)))
            out += 4.0 * density * np.outer(line * gain, line * gain) / n_samples
    return out


def _needs_lags(p: Process) -> bool:
    return isinstance(p, ARMA) or (isinstance(p, AR1) and p.parameters["phi"] <= 0.0)


def _sample_variance(p: Process, dt: float) -> float:
    value = p.parameters
    if isinstance(p, WN):
        return value["N"] ** 2 / dt
    if isinstance(p, QN):
        return (value["Q"] / dt) ** 2
    if isinstance(p, RW):
        return value["K"] ** 2 * dt
    return value["B"] ** 2


def _level1(p: Process, n: int, dt: float) -> Array:
    """Autocovariance at lags 0..n-1 of the first octave's coefficients."""
    if isinstance(p, RW):
        return level1_autocovariance(n, increments=lambda lag: np.where(lag == 0, _sample_variance(p, dt), 0.0))
    if isinstance(p, BI):
        return level1_autocovariance(n, increments=lambda lag: _flicker_increments(lag) * _sample_variance(p, dt))
    return level1_autocovariance(n, autocovariance=lambda lag: p.autocovariance(lag, dt))


def _flicker_increments(lag: NDArray[np.int64]) -> Array:
    n = lag.size
    wide = np.arange(-2.0, n + 2.0)
    g = wide**2 * np.log(np.maximum(np.abs(wide), 1.0))
    out = np.convolve(g, [1.0, -4.0, 6.0, -4.0, 1.0], mode="valid")
    far = np.arange(n) > 1000  # the fourth difference cancels there; its leading term does not
    out[far] = -2.0 / np.arange(n)[far] ** 2
    return np.asarray(out / (2.0 * math.pi))
