"""Test of whether two signals have one noise model, by their wavelet variances; no model is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.variance.cross import LEAST_DOF
from insemu.variance.edof import noise_type, octave_correlation
from insemu.variance.wavelet import WaveletVariance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SameModel:
    """What two curves say of having one expectation.

    Parameters
    ----------
    tau_s : (J,) array
        Scales that entered, s.
    ratio, low, high : (J,) arrays
        First over second variance there, with its 95 % interval scale by scale.
    statistic : float
        Squared distance of the logarithms in their covariance, chi-square with J degrees of freedom where both have one model.
    p_value : float
    """

    tau_s: Array
    ratio: Array
    low: Array
    high: Array
    statistic: float
    p_value: float


def same_model(first: WaveletVariance, second: WaveletVariance) -> SameModel:
    """Test whether two independent signals have the same wavelet variance at every scale that both know.

    Parameters
    ----------
    first, second : WaveletVariance
        Of one rate and filter; lengths may differ, and samples may be missing.

    Returns
    -------
    SameModel

    Raises
    ------
    InputError
        Another rate or filter; no scale that both know.

    Notes
    -----
    The logarithm of a chi-square of ``eta`` degrees of freedom has mean ``psi(eta/2) - log(eta/2)`` and variance ``psi'(eta/2)``; estimates of
    neighbouring octaves go together as in the test of independence of two signals.
    """
    if first.rate_hz != second.rate_hz or first.filter != second.filter:
        raise InputError(
            f"the curves are of {first.rate_hz:g} Hz with the filter '{first.filter}' and of {second.rate_hz:g} Hz with '{second.filter}', "
            "expected one rate and one filter"
        )
    count = min(len(first), len(second))
    curves = (first, second)
    use = np.all([(c.edof[:count] >= LEAST_DOF) & (c.value[:count] > 0) for c in curves], axis=0)
    if not use.any():
        raise InputError(f"no scale has {LEAST_DOF:g} degrees of freedom in both signals, expected longer signals")
    value = [c.value[:count][use] for c in curves]
    half = [0.5 * c.edof[:count][use] for c in curves]
    mean = [scipy.special.digamma(h) - np.log(h) for h in half]
    spread = np.sqrt(scipy.special.polygamma(1, half[0]) + scipy.special.polygamma(1, half[1]))
    apart = np.log(value[0] / value[1]) - mean[0] + mean[1]
    m = first.scale_samples[:count][use] / 2.0
    noise = noise_type(2.0 * m, np.sqrt(value[0] * value[1]), min(c.n_samples for c in curves))
    together = octave_correlation(noise, m) * np.outer(spread, spread)
    statistic = float(apart @ np.linalg.solve(together, apart))
    ratio = value[0] / value[1]
    ends = [scipy.special.fdtri(2.0 * half[0], 2.0 * half[1], p) for p in (0.975, 0.025)]
    return SameModel(
        first.tau_s[:count][use],
        ratio,
        ratio / ends[0],
        ratio / ends[1],
        statistic,
        float(scipy.special.chdtrc(int(use.sum()), statistic)),
    )
