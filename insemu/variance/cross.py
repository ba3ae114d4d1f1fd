"""Wavelet cross-covariance of two signals: what they have in common, octave by octave, and the test that they have nothing in common.

The estimator and its octaves are those of the wavelet variance (Whitcher, Guttorp and Percival 2000, equations (5)-(8)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance.edof import chi_square_interval, noise_type, octave_correlation
from insemu.variance.wavelet import WaveletVariance, check_signal, wavelet_variance

Array = NDArray[np.float64]

#: A scale enters a test of two signals where its estimates have at least this many degrees of freedom.
LEAST_DOF = 8.0


@dataclass(frozen=True)
class WaveletCovariance:
    """A wavelet cross-covariance curve; arrays have one entry per scale, shortest first.

    Parameters
    ----------
    first, second : WaveletVariance
        Curves of the two signals.
    value, low, high : (J,) arrays
        Covariance of the coefficients and its confidence interval, product of the units.
    correlation, correlation_low, correlation_high : (J,) arrays
        The same over the root of the two variances, with its interval; -1 to 1 where there are too few degrees of freedom.
    edof : (J,) array
        Equivalent degrees of freedom.
    p_value : float
        Of the signals being independent, all scales with at least :data:`LEAST_DOF` degrees of freedom together.
    """

    first: WaveletVariance
    second: WaveletVariance
    value: Array
    low: Array
    high: Array
    correlation: Array
    correlation_low: Array
    correlation_high: Array
    edof: Array
    p_value: float

    @property
    def tau_s(self) -> Array:
        """Scales, s."""
        return self.first.tau_s


def wavelet_covariance(
    x: ArrayLike,
    y: ArrayLike,
    rate_hz: float = 1.0,
    *,
    confidence: float = 0.95,
    filter: str = "haar",
    levels: int | None = None,
) -> WaveletCovariance:
    """Return the wavelet cross-covariance of two signals sampled together.

    Parameters
    ----------
    x, y : (n,) arrays
        Signals of any units; offsets are harmless.
    rate_hz : float
        Sampling rate.
    confidence : float
        Level of the intervals.
    filter : str
        As :func:`~insemu.variance.wavelet.wavelet_variance`.
    levels : int, optional
        Octaves; all by default.

    Returns
    -------
    WaveletCovariance

    Raises
    ------
    InputError
        As :func:`~insemu.variance.wavelet.wavelet_variance`; signals of different lengths, or one that is constant.

    Notes
    -----
    Degrees of freedom are the geometric mean of those of the two curves, which by the Cauchy-Schwarz inequality are at most the true ones of
    independent signals. The interval of the covariance is that of half the difference of two independent variances, those of the sum and of the
    difference of the standardised signals (Zou and Donner 2008); that of the correlation is Fisher's.
    """
    one, two = check_signal(x, "first signal"), check_signal(y, "second signal")
    if one.size != two.size:
        raise InputError(f"the signals have {one.size} and {two.size} samples, expected as many")
    options = {"rate_hz": rate_hz, "confidence": confidence, "filter": filter, "levels": levels}
    curves = [wavelet_variance(v, **options) for v in (one, two)]  # type: ignore[arg-type]
    if not all((c.value > 0).all() for c in curves):
        raise InputError("a signal does not vary at some scale; expected signals with noise")
    # of the same size, so that neither is lost in the other
    size = [math.sqrt(float(np.exp(np.mean(np.log(c.value))))) for c in curves]
    given = {"rate_hz": rate_hz, "filter": filter, "levels": levels, "intervals": "eta3"}
    both = [wavelet_variance(one / size[0] + s * two / size[1], **given).value for s in (1.0, -1.0)]  # type: ignore[arg-type]
    value = 0.25 * (both[0] - both[1]) * size[0] * size[1]
    root = np.sqrt(curves[0].value * curves[1].value)
    edof = np.sqrt(curves[0].edof * curves[1].edof)
    r = np.clip(value / root, -1.0, 1.0)
    parts = [0.5 * (1.0 + r), 0.5 * (1.0 - r)]
    (l1, h1), (l2, h2) = (chi_square_interval(p, edof, confidence) for p in parts)
    low = value - root * np.hypot(parts[0] - l1, h2 - parts[1])
    high = value + root * np.hypot(h1 - parts[0], parts[1] - l2)
    z = float(scipy.special.ndtri(0.5 + 0.5 * confidence))
    half = np.where(edof > 3.0, z / np.sqrt(np.maximum(edof - 2.0, 1.0)), np.inf)
    bounded = np.arctanh(np.clip(r, -1 + 1e-12, 1 - 1e-12))
    return WaveletCovariance(
        curves[0],
        curves[1],
        value,
        low,
        high,
        r,
        np.tanh(bounded - half),
        np.tanh(bounded + half),
        edof,
        _independence(curves, bounded, edof),
    )


def _independence(curves: list[WaveletVariance], z: Array, edof: Array) -> float:
    """p-value of Fisher's transforms ``z`` of all scales being zero; estimates of neighbouring octaves go together."""
    use = edof >= LEAST_DOF
    if not use.any():
        return 1.0
    m = curves[0].scale_samples[use] / 2.0
    together = np.mean(
        [octave_correlation(noise_type(c.scale_samples, c.value, c.n_samples), m) for c in curves], axis=0
    )
    standard = z[use] * np.sqrt(edof[use] - 2.0)
    statistic = float(standard @ np.linalg.solve(together, standard))
    return float(scipy.special.chdtrc(int(use.sum()), statistic))
