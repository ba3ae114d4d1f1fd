"""Haar wavelet variance of a record with missing samples: nothing is filled in.

A coefficient compares the means of two adjoining halves; here each mean is over the samples that are there. A coefficient counts where
:data:`LEAST_SHARE` of each half is there, and is left out elsewhere. Missing samples change its variance: white noise is averaged less,
and the samples that are there lie nearer to each other or farther. By how much follows from which samples are missing and from the noise, whose
type is read off the whole curve in these terms; the curve is divided by it. Degrees of freedom count the pairs of coefficients that
are there, with their autocovariance (:class:`insemu.variance.edof.Kept`).

Mondal and Percival (2010) weigh every pair of samples by the autocovariance of the mask instead; that estimate has the same expectation,
but may be negative at long scales, where a curve to be fitted must not be. Other filters than Haar, which have no two halves, take it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.variance import _gaps_kernel
from insemu.variance.edof import (
    Kept,
    NoiseType,
    Scatter,
    component_variance,
    noise_type,
    octave_correlation,
    scatter_of_noise,
)
from insemu.variance.filtered import scatter_of_filter, unit_curves
from insemu.variance.filters import modwt_filters

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Share of each half of a coefficient that must be there.
LEAST_SHARE = 0.5
#: Positions per half of a long scale at which coefficients are taken: more add nothing, they are nearly equal.
POSITIONS = 8
#: Coefficients per scale at which the effect of missing samples is looked at, and parts of a half in which they are counted.
LOOKED_AT = 512
PARTS = 8
#: Positions per scale at which pairs of coefficients are counted.
PAIRS = 1024
#: Golden ratio less 1: the fractional parts of its multiples lie evenly between 0 and 1 and never repeat.
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
#: Halves up to this many samples: coefficients with few samples differ much from each other, and each pair is taken as it is.
SHORT = 8


@dataclass(frozen=True)
class GapCurve:
    """A curve of a record with gaps.

    Parameters
    ----------
    value : (J,) array
        Wavelet variance, unit^2.
    terms : (J,) int array
        Coefficients that entered, as if taken at every sample.
    scatter : Scatter
        Of ``value``.
    inflation : (J,) array
        Variance of the estimate over that of a record without gaps.
    """

    value: Array
    terms: Ints
    scatter: Scatter
    inflation: Array


def _differs(there: Array, scales: int, white: Array, noise: NoiseType) -> Array:
    """By how much the coefficients of short scales scatter more because each has other samples; 1 for long scales."""
    out = np.ones(scales)
    lags = np.arange(8 * SHORT)
    variogram = np.zeros(lags.size)
    for kind, tc, weight in noise.parts:
        unit = _variogram(kind, tc, 1, lags.size).copy()
        unit[0] = 0.0
        # a component's weight is that of its own unit, whose first octave is known
        first = component_variance(kind, tc, np.array([1.0]))[0]
        variogram += weight * unit * (2.0 * first / unit[1])
    half = 2
    while half <= min(SHORT, 1 << (scales - 1)):
        j = half.bit_length() - 1
        places = _places(there.size - 1 - 2 * half, PAIRS // 4)
        exact, same = _gaps_kernel.short_pairs(there, half, places, LEAST_SHARE * half, variogram, float(white[j]))
        out[j] = exact / same if same > 0 else 1.0
        half *= 2
    return out


def haar_with_gaps(x: Array, origin: float, levels: int) -> GapCurve | None:
    """Return the curve of a signal whose missing samples are NaN; None where not even the first octave has two coefficients.

    Parameters
    ----------
    x : (n,) array
        Signal in any unit.
    origin : float
        Subtracted beforehand, so that an offset costs no digits.
    levels : int
        The most octaves.
    """
    n = x.size
    sums, there = np.empty(n + 1), np.empty(n + 1)
    _gaps_kernel.running(x, origin, sums, there)
    on_grid, step = there, 1
    value, terms, weights = [], [], []
    lags: list[Array] = []
    share: list[Array] = []
    for j in range(levels):
        half = 1 << j
        least = LEAST_SHARE * half
        if half > POSITIONS:
            # the numbers at every sample are needed on, the sums are not
            sums = _gaps_kernel.every_second(sums)
            on_grid = there[::2].copy() if step == 1 else _gaps_kernel.every_second(on_grid)
            step *= 2
        total, number = _gaps_kernel.squares(sums, on_grid, half // step, least)
        if number < 2 or total <= 0.0:
            break
        value.append(0.25 * total / number)
        terms.append(number * step)
        weights.append(_pair_weights(there, half, least))
        apart = _lags_of_pairs(half, n)
        seen = np.empty(apart.size)
        _gaps_kernel.pairs(there, half, _places(n - 2 * half, PAIRS), least, apart, seen)
        lags.append(apart.astype(np.float64))
        share.append(seen)
    if not value:
        return None
    return _calibrated(np.array(value), np.array(terms), weights, lags, share, there)


@lru_cache(maxsize=64)
def _places(last: int, number: int) -> Ints:
    """At least ``number`` of the samples 0 to ``last``, one of each stretch of equal length, all where there are fewer.

    Their distances are irregular: samples that are lost in a rhythm are not met in step with it.
    """
    step = max(last // number, 1)
    k = np.arange(last // step + 1)
    places = k * step + (step * (k * GOLDEN % 1.0)).astype(np.int64)
    return np.asarray(places[places <= last])


@lru_cache(maxsize=64)
def _lags_of_pairs(half: int, n: int) -> Ints:
    """Lags (samples) at which pairs of coefficients are counted, ascending."""
    geometric = 1.6 ** np.arange(3.0, np.log(n) / np.log(1.6))
    apart = np.unique(np.concatenate([[0, 1, 2, 3, half, 2 * half], geometric]).astype(np.int64))
    return np.asarray(apart[apart <= n])


def _pair_weights(there: Array, half: int, least: float) -> Array:
    """How much the mean of coefficients weighs the variogram at each distance, by number of parts of a half (0: within a part)."""
    parts = min(half, PARTS)
    out = np.empty(2 * parts)
    if _gaps_kernel.pair_weights(there, half, _places(there.size - 1 - 2 * half, LOOKED_AT), least, out):
        return out
    # the few that there are lie between those that were looked at
    return _whole_weights(parts, half // parts)


@lru_cache(maxsize=128)
def _whole_weights(parts: int, size: int) -> Array:
    """The same of coefficients without missing samples."""
    half, out = parts * size, np.empty(2 * parts)
    _gaps_kernel.pair_weights(np.arange(2.0 * half + 1.0), half, np.zeros(1, dtype=np.int64), float(half), out)
    return out


def _variogram(kind: str, tc: float, size: int, reach: int) -> Array:
    """Mean variogram of a unit component between samples of parts of ``size`` samples 0, 1, 2.. parts apart."""
    apart = np.arange(reach, dtype=np.float64)
    if kind == "WN":
        return np.ones(reach)
    if kind == "QN":
        # differences of successive rounding errors: three at a distance of one sample, two beyond
        near = np.where(apart == 1, 1.0 / size**2, 0.0)
        near[0] = 2.0 / size if size > 1 else 0.0
        return 2.0 + near
    if kind == "RW":
        out = 0.5 * apart * size
        out[0] = (size + 1.0) / 6.0
        return out
    # Markov noise: unit variance, or unit innovation, whatever the coordinates of the process are
    decay = np.exp(-1.0 / tc)
    mean = -np.expm1(-size / tc) / -np.expm1(-1.0 / tc) / size
    out = np.empty(reach)
    out[1:] = 1.0 - mean**2 * decay ** ((apart[1:] - 1.0) * size + 1.0)
    k = np.arange(1.0, size) if size <= 64 else np.linspace(1.0, size - 1.0, 64)
    weight = size - k
    out[0] = float(np.sum(weight * -np.expm1(-k / tc)) / np.sum(weight)) if size > 1 else 0.0
    return out


@lru_cache(maxsize=16)
def _unit_table(scales: int, kinds: tuple[tuple[str, float], ...]) -> tuple[Array, Array]:
    """Of unit components: wavelet variances of whole coefficients (J, K), and mean variograms over the whole coefficient's own
    sum, (J, K, 2 parts), which pair weights make the ratio to it.
    """
    half = np.exp2(np.arange(scales, dtype=np.float64))
    whole = np.column_stack([component_variance(kind, tc, half) for kind, tc in kinds])
    near = np.zeros((scales, len(kinds), 2 * PARTS))
    for j in range(scales):
        parts = min(1 << j, PARTS)
        size = (1 << j) // parts
        own = np.array([_variogram(kind, tc, size, 2 * parts) for kind, tc in kinds])
        near[j, :, : 2 * parts] = own / (own @ _whole_weights(parts, size))[:, None]
    return whole, near


def _calibrated(
    mean_square: Array, terms: Ints, weights: list[Array], lags: list[Array], share: list[Array], there: Array
) -> GapCurve:
    """The curve from the mean squares of the coefficients that are there."""
    n = there.size - 1
    scale = 2 ** np.arange(1, mean_square.size + 1, dtype=np.int64)
    m = scale / 2.0
    weighed = np.zeros((m.size, 2 * PARTS))
    for own, weight in zip(weighed, weights, strict=True):
        own[: weight.size] = weight

    def curves(kinds: tuple[tuple[str, float], ...]) -> tuple[Array, Array]:
        whole, near = _unit_table(m.size, kinds)
        return whole, whole * np.einsum("jkd,jd->jk", near, weighed)

    noise = noise_type(scale, mean_square, n, unit_curves=lambda kinds: curves(kinds)[1])
    if all(kind != "WN" for kind, _, _ in noise.parts):
        noise = NoiseType([*noise.parts, ("WN", 0.0, 0.0)], np.vstack([noise.moves, np.zeros(m.size)]))
    whole, seen = curves(tuple((kind, tc) for kind, tc, _ in noise.parts))
    size = np.array([weight for _, _, weight in noise.parts])
    expected, changed = whole @ size, seen @ size
    value = mean_square * expected / changed
    # what missing samples add is white from coefficient to coefficient: the halves average independent errors
    white = np.maximum(changed - expected, 0.0) / component_variance("WN", 0.0, m)
    scatter = scatter_of_noise(noise, scale, n, kept=Kept(terms.astype(np.float64), lags, share, white))
    moved = np.eye(m.size) + (whole @ noise.moves) / expected[:, None] - (seen @ noise.moves) / changed[:, None]
    spread = np.sqrt(2.0 / scatter.edof * _differs(there, m.size, white, noise))
    together = octave_correlation(noise, m) * np.outer(spread, spread)
    complete = scatter_of_noise(noise, scale, n).edof
    edof = np.clip(2.0 / np.einsum("ij,jk,ik->i", moved, together, moved), 1.0, complete)
    return GapCurve(value, terms, replace(scatter, edof=edof), complete / edof)


def filter_with_gaps(x: Array, origin: float, filter: str, haar: GapCurve) -> GapCurve | None:
    """Return the curve of another filter (equation (9) of Mondal and Percival 2010); None where no octave can be had.

    Each distance of two samples counts as often as the filter has it, whatever the number of pairs that are there. The variances of the estimates
    are taken as larger than those of a complete record as the Haar filter's are.

    Parameters
    ----------
    x : (n,) array
        Signal whose missing samples are NaN.
    origin : float
        Subtracted beforehand.
    filter : str
        Name of the filter.
    haar : GapCurve
        Of :func:`haar_with_gaps`.
    """
    h, g = modwt_filters(filter)
    n = x.size
    there = np.isfinite(x)
    d = np.where(there, x - origin, 0.0)
    size = scipy.fft.next_fast_len(2 * n, real=True)
    mask, first, second = (scipy.fft.rfft(v, size) for v in (there.astype(np.float64), d, d * d))
    pairs = np.round(scipy.fft.irfft(np.abs(mask) ** 2, size)[:n])
    squares = scipy.fft.irfft((np.conj(mask) * second).real - np.abs(first) ** 2, size)[:n]
    # as a spectrum: a filter's gain weighs it, and that of a longer octave is that of the first at a multiple of the frequency
    both = np.zeros(size)
    both[:n] = squares / np.maximum(pairs, 1.0)
    both[0] = 0.0
    both[size - n + 1 :] = both[n - 1 : 0 : -1]
    spectrum = -scipy.fft.rfft(both).real / size
    spectrum[1 : (size + 1) // 2] *= 2.0
    at = np.arange(size // 2 + 1)
    wavelet, smooth = (np.abs(scipy.fft.fft(taps, size)) ** 2 for taps in (h, g))
    without = int(np.argmin(np.append(pairs[1:], 0.0))) + 1  # the shortest distance that no two samples have
    value: list[float] = []
    for _ in range(haar.value.size):
        reach = ((2 << len(value)) - 1) * (h.size - 1) + 1
        v = float(spectrum @ wavelet[at]) if reach <= without else 0.0
        if v <= 0.0:
            break
        value.append(v)
        spectrum *= smooth[at]
        at = (2 * at) % size
    if not value:
        return None
    out = np.array(value)
    octaves = tuple(range(1, out.size + 1))
    noise = noise_type(
        2 ** np.array(octaves), out, n, unit_curves=lambda components: unit_curves(filter, octaves, components)
    )
    scatter = scatter_of_filter(noise, filter, out.size, n)
    inflation = haar.inflation[: out.size]
    return GapCurve(
        out, haar.terms[: out.size], replace(scatter, edof=np.maximum(scatter.edof / inflation, 1.0)), inflation
    )
