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

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

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


@njit(cache=True, nogil=True)
def _running(x: Array, origin: float, sums: Array, there: Ints) -> None:  # pragma: no cover - compiled
    """Running sums and numbers of the samples that are finite."""
    total, number = 0.0, 0
    sums[0] = 0.0
    there[0] = 0
    for i in range(x.size):
        d = x[i] - origin
        if np.isfinite(d):
            total += d
            number += 1
        sums[i + 1] = total
        there[i + 1] = number


@njit(cache=True, nogil=True)
def _squares(
    sums: Array, there: Ints, half: int, step: int, least: float
) -> tuple[float, int]:  # pragma: no cover - compiled
    """Sum of squared differences of the means of adjoining halves, and their number."""
    total, number = 0.0, 0
    inverse = np.empty(half + 1)
    inverse[0] = 0.0
    for i in range(1, half + 1):
        inverse[i] = 1.0 / i
    for i in range(0, there.size - 2 * half, step):
        one = there[i + half] - there[i]
        two = there[i + 2 * half] - there[i + half]
        # without a branch: where samples are missing at random, it would be guessed wrong every second time
        there_too = int(one >= least) & int(two >= least)
        d = (sums[i + 2 * half] - sums[i + half]) * inverse[two] - (sums[i + half] - sums[i]) * inverse[one]
        total += there_too * (d * d)
        number += there_too
    return total, number


@njit(cache=True, nogil=True)
def _is_there(there: Ints, i: int, half: int, least: float) -> bool:  # pragma: no cover - compiled
    return bool(there[i + half] - there[i] >= least and there[i + 2 * half] - there[i + half] >= least)


@njit(cache=True, nogil=True)
def _pairs(
    there: Ints, half: int, step: int, least: float, lags: Ints, share: Array
) -> None:  # pragma: no cover - compiled
    """Pairs of coefficients that far apart over the number of coefficients, from positions ``step`` apart."""
    last = there.size - 1 - 2 * half
    number = 0
    share[:] = 0.0
    for i in range(0, last + 1, step):
        if not _is_there(there, i, half, least):
            continue
        number += 1
        for k in range(lags.size):
            if i + lags[k] > last:
                break
            if _is_there(there, i + lags[k], half, least):
                share[k] += 1.0
    share /= max(number, 1)


@njit(cache=True, nogil=True)
def _mean_weights(there: Ints, i: int, half: int, weight: Array) -> None:  # pragma: no cover - compiled
    """Weights of the samples from ``i`` on in the coefficient that begins there."""
    one = there[i + half] - there[i]
    two = there[i + 2 * half] - there[i + half]
    for k in range(2 * half):
        sign = -0.5 / one if k < half else 0.5 / two
        weight[k] = sign * (there[i + k + 1] - there[i + k])


@njit(cache=True, nogil=True)
def _short_pairs(
    there: Ints, half: int, step: int, least: float, variogram: Array, white: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Squared covariances of neighbouring coefficients summed: each pair with the samples that it has, and as if all had the same.

    ``variogram`` is that of the noise from lag 0, and ``white`` what missing samples add on average (unit^2 per sample).
    """
    last = there.size - 1 - 2 * half
    reach = 6 * half
    mine, other = np.empty(2 * half), np.empty(2 * half)
    # covariance of two whole coefficients that far apart
    whole = np.zeros(reach)
    for lag in range(reach):
        for a in range(2 * half):
            for b in range(2 * half):
                sign = 1.0 if (a < half) == (b < half) else -1.0
                distance = abs(lag + b - a)
                level = variogram[distance] + (white if distance > 0 else 0.0)
                whole[lag] -= sign * level / (4.0 * half * half)
    exact, same = 0.0, 0.0
    for i in range(0, last + 1, step):
        if not _is_there(there, i, half, least):
            continue
        _mean_weights(there, i, half, mine)
        for lag in range(min(reach, last - i + 1)):
            if not _is_there(there, i + lag, half, least):
                continue
            _mean_weights(there, i + lag, half, other)
            total = 0.0
            for a in range(2 * half):
                if mine[a] != 0.0:
                    for b in range(2 * half):
                        total -= mine[a] * other[b] * variogram[abs(lag + b - a)]
            often = 1.0 if lag == 0 else 2.0
            exact += often * total * total
            same += often * whole[lag] * whole[lag]
    return exact, same


def _differs(there: Ints, scales: int, white: Array, noise: NoiseType) -> Array:
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
        step = max((there.size - 2 * half) // (PAIRS // 4), 1)
        exact, same = _short_pairs(there, half, step, LEAST_SHARE * half, variogram, float(white[j]))
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
    sums, there = np.empty(n + 1), np.empty(n + 1, dtype=np.int64)
    _running(x, origin, sums, there)
    value, terms, weights = [], [], []
    lags: list[Array] = []
    share: list[Array] = []
    for j in range(levels):
        half = 1 << j
        step, least = max(half // POSITIONS, 1), LEAST_SHARE * half
        total, number = _squares(sums, there, half, step, least)
        if number < 2 or total <= 0.0:
            break
        value.append(0.25 * total / number)
        terms.append(number * step)
        weights.append(_pair_weights(there, half, least))
        apart = np.unique(
            np.concatenate([[0, 1, 2, 3, half, 2 * half], 1.6 ** np.arange(3.0, np.log(n) / np.log(1.6))]).astype(
                np.int64
            )
        )
        apart = apart[apart <= n]
        seen = np.empty(apart.size)
        _pairs(there, half, max((n - 2 * half) // PAIRS, 1), least, apart, seen)
        lags.append(apart.astype(np.float64))
        share.append(seen)
    if not value:
        return None
    return _calibrated(np.array(value), np.array(terms), weights, lags, share, there)


def _pair_weights(there: Ints, half: int, least: float) -> Array:
    """How much the mean of coefficients weighs the variogram at each distance, by number of parts of a half (0: within a part)."""
    parts = min(half, PARTS)
    first = np.arange(0, there.size - 2 * half, max((there.size - 2 * half) // LOOKED_AT, 1))
    bounds = first[:, None] + np.arange(0, 2 * half + 1, half // parts)
    counts = np.diff(there[bounds], axis=1).astype(np.float64)
    one, two = counts[:, :parts], counts[:, parts:]
    n1, n2 = one.sum(axis=1), two.sum(axis=1)
    good = (n1 >= least) & (n2 >= least)
    if not good.any():  # the few that there are lie between those that were looked at
        return _whole_weights(parts, half // parts)
    return _weights_of(one[good], two[good], n1[good], n2[good])


@lru_cache(maxsize=128)
def _whole_weights(parts: int, size: int) -> Array:
    """The same of coefficients without missing samples."""
    full, number = np.full((1, parts), float(size)), np.full(1, float(parts * size))
    return _weights_of(full, full, number, number)


def _weights_of(one: Array, two: Array, n1: Array, n2: Array) -> Array:
    parts = one.shape[1]
    out = np.zeros(2 * parts)
    apart = np.subtract.outer(np.arange(parts), np.arange(parts))
    cross = np.einsum("ti,tj->ij", two / n2[:, None], one / n1[:, None]) / n1.size
    np.add.at(out, parts + apart, 2.0 * cross)
    for counted, number in ((one, n1), (two, n2)):
        within = np.einsum("ti,tj->ij", counted / number[:, None], counted / number[:, None]) / number.size
        # a sample has no distance from itself
        within[np.diag_indices(parts)] = np.mean(counted * (counted - 1.0) / number[:, None] ** 2, axis=0)
        np.add.at(out, np.abs(apart), -within)
    return 0.25 * out


@lru_cache(maxsize=2048)
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


def _ratios(weights: list[Array], kinds: tuple[tuple[str, float], ...]) -> Array:
    """Variance of the coefficients that are there over that of whole ones, for scales and unit components."""
    out = np.empty((len(weights), len(kinds)))
    for j, weight in enumerate(weights):
        half = 1 << j
        parts = min(half, PARTS)
        whole = _whole_weights(parts, half // parts)
        for k, (kind, tc) in enumerate(kinds):
            seen = _variogram(kind, tc, half // parts, 2 * parts)
            out[j, k] = (weight @ seen) / (whole @ seen)
    return out


def _calibrated(
    mean_square: Array, terms: Ints, weights: list[Array], lags: list[Array], share: list[Array], there: Ints
) -> GapCurve:
    """The curve from the mean squares of the coefficients that are there."""
    n = there.size - 1
    scale = 2 ** np.arange(1, mean_square.size + 1, dtype=np.int64)
    m = scale / 2.0
    known: dict[tuple[tuple[str, float], ...], tuple[Array, Array]] = {}

    def curves(kinds: tuple[tuple[str, float], ...]) -> tuple[Array, Array]:
        if kinds not in known:
            whole = np.column_stack([component_variance(kind, tc, m) for kind, tc in kinds])
            known[kinds] = whole, whole * _ratios(weights, kinds)
        return known[kinds]

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
    size = fft.next_fast_len(2 * n, real=True)
    mask, first, second = (fft.rfft(v, size) for v in (there.astype(np.float64), d, d * d))
    pairs = np.round(fft.irfft(np.abs(mask) ** 2, size)[:n])
    squares = fft.irfft((np.conj(mask) * second).real - np.abs(first) ** 2, size)[:n]
    # as a spectrum: a filter's gain weighs it, and that of a longer octave is that of the first at a multiple of the frequency
    both = np.zeros(size)
    both[:n] = squares / np.maximum(pairs, 1.0)
    both[0] = 0.0
    both[size - n + 1 :] = both[n - 1 : 0 : -1]
    spectrum = -fft.rfft(both).real / size
    spectrum[1 : (size + 1) // 2] *= 2.0
    at = np.arange(size // 2 + 1)
    wavelet, smooth = (np.abs(fft.fft(taps, size)) ** 2 for taps in (h, g))
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
