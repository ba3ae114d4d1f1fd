"""Compiled sums over covariance sequences: how the variance estimates of this room scatter.

Scalar code over plain arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def haar_covariances(s1: Array, n: int, levels: int, means: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Fill ``out[j, l]`` with the covariance of the Haar wavelet variances of levels j+1 and l+1 of ``n`` samples.

    ``s1`` is the autocovariance of the level-1 coefficients at lags 0..n-1. A coefficient of the next octave is
    (1 + B^m)^2 / 2 of this one's, so every covariance sequence follows from ``s1`` by positive weights: nothing cancels, also for
    integrated processes. ``means`` are the means of the coefficients (drift).

    Parameters
    ----------
    s1 : (n,) array
        unit^2.
    n : int
        Length of the record.
    levels : int
        Number of octaves.
    means : (levels,) array
        In the unit of the signal.
    out : (levels, levels) array
        Overwritten, unit^4.
    """
    lags = n - 1
    own = s1.copy()
    cross = np.zeros(2 * lags + 1)  # cross[lags + i] = cov(W_j[k + i], W_l[k])
    for j in range(levels):
        mj = 1 << j
        lowest = 2 * mj - n  # W_j exists at samples 2 mj - 1 .. n - 1
        for i in range(lowest, -lowest + 1):
            cross[lags + i] = own[abs(i)]
        for level in range(j, levels):
            ml = 1 << level
            highest = n - 2 * ml
            total = 0.0
            for i in range(lowest, highest + 1):
                pairs = min(n - 1, n - 1 - i) - max(2 * ml - 1, 2 * mj - 1 - i) + 1
                c = cross[lags + i]
                total += pairs * (2.0 * c * c + 4.0 * means[j] * means[level] * c)
            out[j, level] = total / (float(n - 2 * mj + 1) * float(highest + 1))
            out[level, j] = out[j, level]
            if level + 1 < levels:
                # W_(l+1)[k] = (W_l[k] + 2 W_l[k - ml] + W_l[k - 2 ml]) / 2: lag i takes lags i, i + ml, i + 2 ml (in place, upwards)
                for i in range(lags + lowest, lags + n - 4 * ml + 1):
                    cross[i] = 0.5 * (cross[i] + 2.0 * cross[i + ml] + cross[i + 2 * ml])
        if j + 1 < levels:
            new = np.zeros(lags + 1)
            for i in range(n - 4 * mj + 1):
                new[i] = 0.25 * (
                    6.0 * own[i] + 4.0 * (own[i + mj] + own[abs(i - mj)]) + own[i + 2 * mj] + own[abs(i - 2 * mj)]
                )
            own = new


@njit(cache=True, nogil=True)
def _kappa(
    kind: int, tc: float, c1: float, c2: float, c3: float, h: float, averaged: bool
) -> float:  # pragma: no cover - compiled
    """Generalized covariance at lag ``h >= 0`` of the running sum of a unit component (of its sum once more where ``averaged``).

    Second differences of it give minus the covariance one summation lower: -h/2 for white noise, (h^3 - h)/12 for random walk, and so
    on. Kinds: 0 quantization, 1 white, 2 Markov of time constant ``tc`` samples (constants of :func:`unit_covariances`), 3 random walk.
    """
    if kind == 0:
        return -0.5 * h if averaged else 0.0
    if kind == 1:
        return (h * h * h - h) / 12.0 if averaged else -0.5 * h
    if kind == 3:
        return -(h**5 / 240.0 - h * h * h / 48.0 + h / 60.0) if averaged else (h * h * h - h) / 12.0
    if not averaged:
        return -(c1 * h + c2 * math.expm1(-h / tc))
    return c1 * (h * h * h - h) / 6.0 + c2 * c3 * math.exp(-h / tc) + c2 * (0.5 + c3 * -math.expm1(-1.0 / tc)) * h


class Differences(NamedTuple):
    """Differences of the running sum of a record at several steps, and the lags that their autocovariances are evaluated at.

    ``lags[ends[2 j]:ends[2 j + 1]]`` are nodes of step j between which autocovariances are linear, ``lags[ends[2 j + 1]:ends[2 j + 2]]`` an
    even grid for the third cumulant (or none).

    Parameters
    ----------
    steps, strides : (J,) arrays of int
        Steps m of the differences and of successive terms, samples.
    n : int
        Length of the record.
    filter : (order + 1,) array
        Autocorrelation of the difference filter from lag 0; order 2 or 3.
    lags : (L,) array
        Samples.
    ends : (2 J + 1,) array of int
        Places in ``lags``.
    """

    steps: NDArray[np.int64]
    strides: NDArray[np.int64]
    n: int
    filter: Array
    lags: Array
    ends: NDArray[np.int64]


@njit(cache=True, nogil=True)
def unit_covariances(
    kind: int, tc: float, of: Differences, averaged: bool, out: Array
) -> None:  # pragma: no cover - compiled
    """Autocovariances of differences of the running sum, over 4 m^2, of a unit component, for the steps m one after the other.

    Without the single lags at which quantization noise (not averaged) contributes.

    Parameters
    ----------
    kind : int
        0 quantization noise, 1 white noise, 2 first-order Gauss-Markov, 3 random walk.
    tc : float
        Time constant of kind 2, samples.
    of : Differences
    averaged : bool
        Whether the running sum is averaged over m samples before (modified Allan variance).
    out : (L,) array
        Overwritten.
    """
    steps, filter, lags, ends = of.steps, of.filter, of.lags, of.ends
    order = filter.size - 1
    out[:] = 0.0
    if kind == 0 and not averaged:
        return
    for j in range(steps.size):
        m = float(steps[j])
        weight = 1.0 / (4.0 * m * m)
        if averaged and order == 2:
            weight = -weight
        like = kind
        if kind == 2 and m < 1e-3 * tc:
            # within its correlation time a Markov noise is a random walk; the closed form would cancel
            weight *= -np.expm1(-2.0 / tc)
            like = 3
        one_minus = -np.expm1(-1.0 / tc) if like == 2 else 1.0
        phi = 1.0 - one_minus
        c1 = 0.5 * (1.0 + phi) / one_minus
        c2, c3 = phi / one_minus**2, phi / one_minus**2
        for i in range(ends[2 * j], ends[2 * j + 2]):
            if like != 2 and lags[i] >= order * m:
                continue  # exactly zero
            total = filter[0] * _kappa(like, tc, c1, c2, c3, lags[i], averaged)
            for k in range(1, order + 1):
                total += filter[k] * (
                    _kappa(like, tc, c1, c2, c3, lags[i] + k * m, averaged)
                    + _kappa(like, tc, c1, c2, c3, abs(lags[i] - k * m), averaged)
                )
            out[i] = weight * total


@njit(cache=True, nogil=True)
def scatter_of_means(
    units: Array, weights: Array, quantized: int, of: Differences, counts: Array, share: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """Degrees of freedom (J,), squared skewness over a chi-square's (J,), d log(edof) / d weight (J, components) of means of squared differences.

    Component ``quantized`` contributes at single lags.

    Parameters
    ----------
    units : (components, L) array
        Autocovariances of the differences of each unit component, of :func:`unit_covariances`.
    weights : (J, components) array
        Variances per sample of the components, unit^2.
    quantized : int
        Place of quantization noise; -1 where there is none.
    of : Differences
    counts : (J,) array
        Terms that enter each mean.
    share : (L,) array
        Pairs of terms that far apart over the number of terms.
    """
    steps, strides, n, filter, lags, ends = of
    order = filter.size - 1
    parts = weights.shape[1]
    edof, skew, slopes = np.empty(steps.size), np.empty(steps.size), np.empty(weights.shape)
    smooth = np.zeros(lags.size)
    part = np.empty(lags.size)
    for j in range(steps.size):
        m, stride = steps[j], strides[j]
        begin, end = ends[2 * j], ends[2 * j + 1]
        for p in range(parts):
            for i in range(begin, ends[2 * j + 2]):
                smooth[i] += weights[j, p] * units[p, i]
        reach = n - order * m  # longest lag between two terms
        count = counts[j]
        delta = weights[j, quantized] / (4.0 * m * m) if quantized >= 0 else 0.0
        # sum over lags of a function that is linear between nodes, both signs of the lag
        total = 0.0
        for i in range(begin, end):
            gap = lags[min(i + 1, end - 1)] - lags[max(i - 1, begin)]
            part[i] = (gap / stride + (1.0 if i == end - 1 else 0.0)) * share[i] * smooth[i]
            total += part[i] * smooth[i]
        variance = smooth[begin] + filter[0] * delta
        for p in range(parts):
            mixed = 0.0
            for i in range(begin, end):
                mixed += part[i] * units[p, i]
            slopes[j, p] = -2.0 * mixed
        for k in range(order + 1):
            if delta == 0.0 or k * m > reach // stride * stride:
                break
            at = begin + np.searchsorted(lags[begin:end], float(k * m))
            often = (1.0 if k == 0 else 2.0) * share[at]
            d = filter[k] * delta
            total += often * (2.0 * smooth[at] * d + d * d)
            for p in range(parts):
                slopes[j, p] -= 2.0 * often * d * units[p, at]
            slopes[j, quantized] -= 2.0 * often * (smooth[at] + d) * filter[k] / (4.0 * m * m)
        if total <= 0.0:
            edof[j], skew[j] = 1.0, 1.0
            slopes[j] = 0.0
            continue
        edof[j] = variance * variance * count / total
        for p in range(parts):
            slopes[j, p] = slopes[j, p] / total + 2.0 * units[p, begin] / variance
        if delta > 0.0:
            slopes[j, quantized] += 2.0 * filter[0] / (4.0 * m * m) / variance
        # third cumulant: sum over triples of positions of r(i) r(k) r(i + k)
        skew[j] = 1.0
        r = smooth[end : ends[2 * j + 2]]
        if r.size < 2 or r[0] <= 0.0:
            continue
        positions = reach // int(lags[end + 1]) + 1
        second, third = 0.0, 0.0
        for i in range(r.size):
            second += (1.0 if i == 0 else 2.0) * (positions - i) * r[i] * r[i]
            for k in range(r.size - i):
                triples = 6.0
                if i == 0 or k == 0:
                    triples = 3.0
                if i == 0 and k == 0:
                    triples = 1.0
                third += triples * (positions - i - k) * r[i] * r[k] * r[i + k]
        first = positions * r[0] * variance / smooth[begin]
        skew[j] = (third * first / (second * second)) ** 2
    return edof, skew, slopes
