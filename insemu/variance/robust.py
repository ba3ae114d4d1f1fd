"""Wavelet variance that outliers cannot move: a biweight M-estimator of scale with chosen efficiency.

How it works
------------
Each octave's variance solves ``sum omega(w / s) (w^2 / s^2 - k) = 0`` with Tukey's biweight ``omega(r) = (1 - (r/c)^2)^2`` for
``|r| < c`` and 0 beyond. A rejected coefficient drops out of both terms, so many outliers do not pull the estimate down as they do where
the sum is compared with a constant times the number of coefficients. ``c`` gives the efficiency asked for with Gaussian data, ``k`` makes
it consistent there.

An estimator tuned to Gaussian data is biased by *any* other shape, also a harmless one: with uniform rounding errors the shortest scales
have light tails, and the estimate would be some 10-15 % high (this is why known programs overestimate a clean quantized signal). Weights
are there to protect from heavy tails only. So weights are used where the record shows tails heavier than Gaussian, in the manner of
Gervini and Yohai's adaptive cut-off (Annals of Statistics 2002); a record without any keeps full efficiency and the plain estimate.
Where a contaminated record is light-tailed underneath (a quantized signal with outliers), the variance of what lies within the step limit
comes out below the weighted one by more than chance explains, and replaces it.

A bad sample touches ``2^j`` coefficients of octave j. Steps from sample to sample that stand out in the first octave are therefore
remembered, and coefficients of longer scales that contain one are left out. Where fewer than half remain, the octave is flagged as not
protected.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance import _kernel
from insemu.variance.edof import (
    Intervals,
    Scatter,
    edof_of_noise,
    eta3,
    noise_type,
    scatter_of_noise,
)
from insemu.variance.wavelet import Asked, WaveletVariance, check_levels, check_signal, max_levels

Array = NDArray[np.float64]

#: Steps beyond this many robust standard deviations in the first octave are remembered as bad.
STEP_LIMIT = 3.5
#: Positions per scale at which coefficients are taken: more would add nothing, they are nearly equal.
POSITIONS = 32


@dataclass(frozen=True)
class RobustWaveletVariance(WaveletVariance):
    """A robust wavelet variance curve.

    Parameters
    ----------
    efficiency : float
        Efficiency with Gaussian data of the weights that were used; 1 where the record has no heavy tails and no weights were needed.
    contaminated : bool
        Whether the record has tails heavier than Gaussian.
    protected : (J,) bool array
        Whether at least half of an octave's coefficients contain no bad step.
    """

    efficiency: float = 0.6
    contaminated: bool = False
    protected: NDArray[np.bool_] = None  # type: ignore[assignment]


@lru_cache(maxsize=32)
def biweight_constants(efficiency: float) -> tuple[float, float]:
    """Return ``(c, k)`` of the biweight whose variance estimate has the given efficiency with independent Gaussian data.

    Raises
    ------
    InputError
        An efficiency outside 0.4 to 0.99.

    Examples
    --------
    >>> c, k = biweight_constants(0.6)
    >>> round(c, 2), round(k, 3)
    (3.18, 0.663)
    """
    if not 0.4 <= efficiency <= 0.99:
        raise InputError(f"efficiency is {efficiency}, expected 0.4 to 0.99")
    z = np.linspace(-9.0, 9.0, 6001)
    density = np.exp(-0.5 * z * z)
    density /= density.sum()

    def weight(r: Array, c: float) -> Array:
        return np.maximum(1.0 - (r / c) ** 2, 0.0) ** 2

    def k_of(c: float) -> float:
        w = weight(z, c) * density
        return float((w * z * z).sum() / w.sum())

    def excess(c: float) -> float:
        k = k_of(c)
        psi = weight(z, c) * (z * z - k)
        slope = weight(z, c) * z * z * 2.0 - 4.0 * np.maximum(1.0 - (z / c) ** 2, 0.0) * (z / c) ** 2 * (z * z - k)
        return float(0.5 * (slope * density).sum() ** 2 / (psi**2 * density).sum() - efficiency)

    c = float(scipy.optimize.brentq(excess, 2.0, 30.0))
    return c, k_of(c)


def _scale(w: Array, c: float, k: float) -> float:
    """The variance that solves the biweight equation, from the median of the absolute values."""
    start = np.abs(w[:: max(1, w.size // 20000)])
    s2 = float(np.median(start) / 0.6744897501960817) ** 2
    if s2 == 0.0:
        # more than half of the values are equal (coarse counts): the weights have no scale to refer to
        return float(np.mean(w * w))
    for _ in range(60):
        weights, squares = _kernel.biweight_sums(w, 1.0 / (c * c * s2))
        new = squares / (k * weights)
        if abs(new - s2) <= 1e-7 * s2:
            return float(new)
        s2 = new
    return float(s2)


def _core(w: Array, s2: float) -> float:
    """The variance of what is within the step limit, for Gaussian values cut there."""
    inside = w[np.abs(w) <= STEP_LIMIT * np.sqrt(s2)]
    density = np.exp(-0.5 * STEP_LIMIT**2) / np.sqrt(2.0 * np.pi)
    cut = 1.0 - 2.0 * STEP_LIMIT * density / (2.0 * scipy.special.ndtr(STEP_LIMIT) - 1.0)
    return float(np.dot(inside, inside) / max(inside.size, 1) / cut)


def _heavy(w: Array, variance: float, scale: int) -> bool:
    """Whether more coefficients are far out than Gaussian ones would be (about one false alarm in a thousand clean records)."""
    count = w.size
    if count < 50 * scale or variance <= 0.0:
        return False
    r = np.abs(w) / np.sqrt(variance)
    if r.max() > np.sqrt(2.0 * np.log(count) + 2.0 * np.log(1e4)):
        return True
    for limit in (3.0, 3.5, 4.0):
        expected = 2.0 * scipy.special.ndtr(-limit) * count
        # neighbours share samples, so that exceedances come in groups
        spread = np.sqrt(max(expected, 1.0) * scale)
        if (r > limit).sum() > 1.05 * expected + 5.0 * spread + 4.0 * scale:
            return True
    return False


@dataclass(frozen=True)
class _Seen:
    """Octaves of a record: the plain variance, coefficients that no jump touches and their share, and whether the tails are heavy."""

    plain: Array
    picked: list[Array]
    share: Array
    contaminated: bool


def _see(values: Array, count: int, c: float, k: float, *, contaminated: bool) -> _Seen:
    """Go through the octaves; ``c`` and ``k`` are the biweight's constants, ``contaminated`` takes the tails for heavy unseen."""
    n = values.size
    plain, share = np.empty(count), np.ones(count)
    picked: list[Array] = []
    strides = [max(1, (2 << j) // POSITIONS) for j in range(count)]
    v = values - values[0]
    seen = np.zeros(n, dtype=np.int64)
    for j in range(count):
        m = 1 << j
        w, smooth = np.empty(v.size - m), np.empty(v.size - m)
        _kernel.haar_coefficients_level(v, m, w, smooth)
        v = smooth
        plain[j] = float(np.dot(w, w)) / w.size
        every = w[:: strides[j]] if strides[j] > 1 else w
        if j == 0:
            first = _scale(w, c, k)
            bad = np.abs(w) > STEP_LIMIT * np.sqrt(first)
            np.cumsum(bad, out=seen[1:])
            contaminated = contaminated or _heavy(w, first, 2)
            picked.append(w)
            continue
        if j < 6 and not contaminated:
            contaminated = _heavy(every, _scale(every, c, k), (2 << j) // strides[j])
        clean = np.empty(every.size)
        kept = _kernel.untouched(w, seen, 2 << j, strides[j], clean)
        share[j] = kept / every.size
        picked.append(clean[:kept] if share[j] >= 0.1 else np.ascontiguousarray(every))
    return _Seen(plain, picked, share, contaminated)


def robust_wavelet_variance(
    x: ArrayLike,
    rate_hz: float = 1.0,
    *,
    efficiency: float = 0.6,
    adaptive: bool = True,
    confidence: float = 0.95,
    intervals: Intervals = "edof",
    levels: int | None = None,
) -> RobustWaveletVariance:
    """Return the Haar MODWT wavelet variance of a signal, protected from outliers.

    Parameters
    ----------
    x : (n,) array
        Signal.
    rate_hz : float
        Sampling rate.
    efficiency : float
        Efficiency of the weights with Gaussian data, 0.4 (most robust) to 0.99.
    adaptive : bool
        Use weights only where the record has heavy tails (see the module's text); False uses them always.
    confidence, intervals, levels
        As in :func:`~insemu.variance.wavelet.wavelet_variance`.

    Raises
    ------
    InputError
        As :func:`~insemu.variance.wavelet.wavelet_variance`; an efficiency outside 0.4 to 0.99.
    """
    c, k = biweight_constants(float(efficiency))
    asked = Asked(rate_hz, "haar", intervals, confidence)
    values = check_signal(x)
    n = values.size
    count = check_levels(levels, max_levels(n), n)

    seen = _see(values, count, c, k, contaminated=not adaptive)
    scale = 2 ** np.arange(1, count + 1, dtype=np.int64)
    value, loss = seen.plain, np.ones(count)
    used_efficiency, protected = 1.0, np.ones(count, dtype=bool)
    if seen.contaminated:
        used_efficiency, protected = float(efficiency), seen.share >= 0.5
        value = np.array([_scale(w, c, k) for w in seen.picked])
        loss = np.where(seen.share >= 0.1, seen.share, 1.0)
        light = np.zeros(count, dtype=bool)
        if adaptive:
            core = np.array([_core(w, s2) for w, s2 in zip(seen.picked, value, strict=True)])
            freedom = edof_of_noise(noise_type(scale, value, n), scale, n) * loss
            # what two estimates of efficiencies 1 and e differ by (Hausman)
            apart = np.sqrt(2.0 / np.maximum(freedom, 1.0) * (1.0 / used_efficiency - 1.0))
            light = protected & (core < value * (1.0 - 3.3 * apart))
            value[light] = core[light]
        loss = np.where(light, loss, loss * used_efficiency)
    scatter: Scatter | None = None
    if intervals == "eta3":
        edof = eta3(scale.astype(float), n)
    else:
        scatter = scatter_of_noise(noise_type(scale, value, n), scale, n)
        edof = scatter.edof
    edof = np.maximum(edof * loss, 1.0)
    curve = asked.curve(value, n - scale + 1, n, edof, scatter)
    return RobustWaveletVariance(
        **vars(curve), efficiency=used_efficiency, contaminated=seen.contaminated, protected=protected
    )


@dataclass(frozen=True)
class Contamination:
    """Plain against robust wavelet variance, octave by octave.

    Parameters
    ----------
    ratio : (J,) array
        Plain over robust value.
    significant : (J,) bool array
        The ratio is further from 1 than 3.3 standard deviations of two estimates of one clean record (1 in 1000).
    contaminated : bool
        The record has heavy tails and they matter: at least one protected octave is significantly and by 5 % higher.
    """

    ratio: Array
    significant: NDArray[np.bool_]
    contaminated: bool


def compare_with_robust(plain: WaveletVariance, robust: RobustWaveletVariance) -> Contamination:
    """Say whether a log is contaminated, from its plain and robust wavelet variances.

    Raises
    ------
    InputError
        Curves of different scales.
    """
    if not np.array_equal(plain.scale_samples, robust.scale_samples):
        raise InputError("the plain and the robust curve have different scales")
    ratio = plain.value / np.where(robust.value > 0, robust.value, np.nan)
    # the efficient estimate is uncorrelated with its difference from a less efficient one (Hausman)
    variance = 2.0 / robust.edof - 2.0 * robust.efficiency / robust.edof
    significant = np.abs(np.log(ratio)) > 3.3 * np.sqrt(np.maximum(variance, 0.0)) + 1e-9
    matters = significant & robust.protected & (ratio > 1.05)
    return Contamination(ratio, significant, bool(robust.contaminated and matters.any()))
