"""The curve that a robust fit uses: outliers rejected where they can be, counted and taken off where they cannot.

At short scales the biweight estimate of :mod:`insemu.variance.robust` drops the coefficients that an outlier touches. At scale 2^j an
outlier touches 2^j of them, so that with one bad sample in a hundred every coefficient of 128 samples is touched and nothing can be
dropped. But isolated outliers are white: what they add to the plain curve is a constant over the scale, and that constant is the difference
between the plain and the robust estimate at the shortest scales. Longer scales are therefore the plain estimate less that part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.variance import RobustWaveletVariance, chi_square_interval, eta3, robust_wavelet_variance, wavelet_variance

Array = NDArray[np.float64]

#: Octaves whose robust estimate is taken as it is, and from which the outliers' white part is read.
SHORT = 2
#: Efficiency of the robust estimate where none is asked for.
EFFICIENCY = 0.6
#: What remains of a scale after the outliers' part is taken off counts at least this share of it.
LEAST = 0.02


@dataclass(frozen=True)
class CleanedCurve:
    """A curve for fitting.

    Parameters
    ----------
    curve : RobustWaveletVariance
        Robust at short scales, plain less the outliers' part at longer ones.
    outlier_variance : float
        Variance per sample that the outliers add; 0 where the record has no heavy tails.
    """

    curve: RobustWaveletVariance
    outlier_variance: float


def cleaned_curve(x: ArrayLike, rate_hz: float, efficiency: float = EFFICIENCY) -> CleanedCurve:
    """Return the wavelet variance of what remains without isolated outliers.

    Parameters
    ----------
    x : (n,) array
    rate_hz : float
    efficiency : float
        Of the robust estimate with Gaussian data, where the record has outliers; one without keeps full efficiency.

    Raises
    ------
    InputError
        As :func:`insemu.variance.robust_wavelet_variance`.
    """
    robust = robust_wavelet_variance(x, rate_hz, efficiency=efficiency)
    if not robust.contaminated or len(robust) <= SHORT:
        return CleanedCurve(robust, 0.0)
    plain = wavelet_variance(x, rate_hz, intervals="eta3", levels=len(robust))
    scale = robust.scale_samples.astype(float)
    # 2^j times the surplus is the same at every scale; the shortest know it best
    added = float(np.mean((scale * (plain.value - robust.value))[:SHORT]))
    if added <= 0.0:
        return CleanedCurve(robust, 0.0)
    surplus = added / scale
    value = np.where(
        np.arange(scale.size) < SHORT, robust.value, np.maximum(plain.value - surplus, LEAST * plain.value)
    )
    # the part taken off has the scatter of the plain curve, which is that much wider relative to what is left
    freedom = eta3(scale, robust.n_samples)
    long = np.arange(scale.size) >= SHORT
    freedom[long] = np.maximum(freedom[long] * (value[long] / plain.value[long]) ** 2, 1.0)
    low, high = chi_square_interval(value, freedom, robust.confidence)
    return CleanedCurve(replace(robust, value=value, low=low, high=high, edof=freedom), added)
