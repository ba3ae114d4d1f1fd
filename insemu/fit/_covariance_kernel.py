"""Compiled sums for the covariance of Haar wavelet variances under a model.

A coefficient of level j is a second difference of the running sum S of the signal: ``(S[k] - 2 S[k-m] + S[k-2m]) / (2 m)``, m = 2^(j-1).
So the covariance of two coefficients is nine values of the generalized covariance of S, which every process of this house has in closed
form: no pass over lags is needed, only a quadrature between the nine corners where the function is not smooth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]

_X = np.array([-0.9061798459386640, -0.5384693101056831, 0.0, 0.5384693101056831, 0.9061798459386640])
_W = np.array([0.2369268850561891, 0.4786286704993665, 0.5688888888888889, 0.4786286704993665, 0.2369268850561891])


class _Parts(NamedTuple):
    """What a sum of processes is made of, for two averages.

    ``poly``: variances of the WN, QN, RW and BI parts; ``a``: decay per sample of first-order parts; ``squeeze``: their factor beyond the
    corners; ``linear``, ``curved``: factors of |h| and of the exponential within, ``linear`` negative where the exponential's even
    polynomial is left out (correlation times longer than the coefficients, where it would cancel digits).
    """

    poly: Array
    a: Array
    squeeze: Array
    linear: Array
    curved: Array


@njit(cache=True, nogil=True)
def _coefficient_covariance(i: float, mj: float, ml: float, of: _Parts) -> float:  # pragma: no cover - compiled
    """Covariance of coefficients of averages ``mj`` (at k + i) and ``ml`` (at k)."""
    poly, a, squeeze, linear, curved = of
    total = 0.0
    # nearest distance to a corner, when all nine lie on one side
    highest, lowest = 2.0 * mj, -2.0 * ml
    outside = i >= highest or i <= lowest
    near = i - highest if i >= highest else lowest - i
    if outside:
        for g in range(a.size):
            x = a[g] * near
            if x < 60.0:
                total += squeeze[g] * math.exp(-x)
        if near > 0.0 and poly[3] == 0.0:
            return total
    flicker_far = outside and near > 300.0 * math.sqrt(mj * ml) and near > 4.0 * (mj + ml)
    if flicker_far:
        middle = near + mj + ml
        total -= float(poly[3]) / (2.0 * math.pi) * 2.0 * mj * ml / (4.0 * middle * middle)
        return total
    scale = 1.0 / (4.0 * mj * ml)
    for p in range(3):
        wp = -2.0 if p == 1 else 1.0
        for q in range(3):
            w = wp * (-2.0 if q == 1 else 1.0) * scale
            h = abs(i - p * mj + q * ml)
            k = -0.5 * poly[0] * h
            if h == 0.0:
                k += poly[1]
            if poly[2] > 0.0:
                k += poly[2] * (h * h * h - h) / 12.0
            if poly[3] > 0.0 and h > 0.0:
                k += poly[3] / (2.0 * math.pi) * h * h * math.log(h)
            if not outside:
                for g in range(a.size):
                    x = a[g] * h
                    if linear[g] < 0.0:
                        if x < 0.4:
                            rest = -x * x * x / 6.0
                            term = rest
                            for o in range(4, 13):
                                term *= -x / o
                                rest += term
                        else:
                            rest = math.exp(-x) - 1.0 + x - 0.5 * x * x
                        k += linear[g] * h - curved[g] * rest
                    else:
                        k -= linear[g] * h
                        if x < 60.0:
                            k -= curved[g] * math.exp(-x)
            total += w * k
    return total


@njit(cache=True, nogil=True)
def covariances(
    m: Array, n: int, poly: Array, a: Array, c: Array, drift: float, out: Array
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` with the covariance matrix of the wavelet variances at averages ``m`` (ascending) of ``n`` samples.

    ``drift`` is the slope per sample: coefficients then have the mean ``drift * m / 2``.

    Parameters
    ----------
    m : (J,) array
        Samples per average, half the scales, ascending.
    n : int
        Length of the record.
    poly : (4,) array
        Variances per sample of the white, quantized, walking and flicker parts, unit^2.
    a, c : (g,) arrays
        Decay per sample and variance (unit^2) of each first-order part.
    drift : float
        Slope per sample.
    out : (J, J) array
        Overwritten, unit^4.
    """
    levels = m.size
    corners = np.empty(9)
    of = _Parts(poly, a, np.empty(a.size), np.empty(a.size), np.empty(a.size))
    squeeze, linear, curved = of.squeeze, of.linear, of.curved
    for j in range(levels):
        for other in range(j, levels):
            mj, ml = m[j], m[other]
            count_j, count_l = n - 2.0 * mj + 1.0, n - 2.0 * ml + 1.0
            means = drift * drift * mj * ml / 4.0
            reach = 2.0 * (mj + ml)
            for g in range(a.size):
                ag = min(a[g], 60.0)  # beyond, white to every digit
                sh = math.sinh(0.5 * ag)
                ej, el = math.expm1(-ag * mj), math.expm1(-ag * ml)
                curved[g] = c[g] / (4.0 * sh * sh)
                squeeze[g] = -curved[g] * ej * ej * el * el / (4.0 * mj * ml)
                if ag * reach < 1.0:
                    excess = ag * ag * ag * (1.0 / 6.0 + ag * ag * (1.0 / 120.0 + ag * ag / 5040.0))
                    if ag >= 0.02:
                        excess = math.sinh(ag) - ag
                    linear[g] = -curved[g] * excess
                else:
                    linear[g] = c[g] * 0.5 * math.cosh(0.5 * ag) / sh
            at = 0
            for p in range(3):
                for q in range(3):
                    corners[at] = p * mj - q * ml
                    at += 1
            corners.sort()
            first, last = 2.0 * mj - n, n - 2.0 * ml  # lags at which pairs exist
            total = 0.0
            previous = first - 1.0
            for k in range(10):
                end = corners[k] if k < 9 else last + 1.0
                if end < first:
                    continue
                end = min(end, last + 1.0)
                # integers strictly between previous and end
                inner = end - previous - 1.0
                if inner > 0.0:
                    if inner <= 40.0:
                        for step in range(int(inner)):
                            i = previous + 1.0 + step
                            total += _term(i, mj, ml, n, of, means)
                    else:
                        # four at each end one by one, panels that double towards the middle
                        for step in range(4):
                            total += _term(previous + 1.0 + step, mj, ml, n, of, means)
                            total += _term(end - 1.0 - step, mj, ml, n, of, means)
                        lo, hi = previous + 4.5, end - 4.5
                        middle = 0.5 * (lo + hi)
                        width, start = 6.0, lo
                        while start < middle:
                            stop = min(start + width, middle)
                            if middle - stop < 0.3 * width:
                                stop = middle
                            half, centre = 0.5 * (stop - start), 0.5 * (start + stop)
                            mirror = lo + hi - centre
                            for x in range(5):
                                total += half * _W[x] * _term(centre + half * _X[x], mj, ml, n, of, means)
                                total += half * _W[x] * _term(mirror + half * _X[x], mj, ml, n, of, means)
                            start = stop
                            width *= 2.0
                if k < 9 and end == corners[k] and end > previous and end <= last:
                    total += _term(end, mj, ml, n, of, means)
                previous = max(previous, end)
                if previous > last:
                    break
            out[j, other] = total / (count_j * count_l)
            out[other, j] = out[j, other]


@njit(cache=True, nogil=True)
def _term(i: float, mj: float, ml: float, n: int, of: _Parts, means: float) -> float:  # pragma: no cover - compiled
    """One lag of the double sum: number of pairs times the covariance of squares (Isserlis)."""
    pairs = min(n - 1.0, n - 1.0 - i) - max(2.0 * ml - 1.0, 2.0 * mj - 1.0 - i) + 1.0
    v = _coefficient_covariance(i, mj, ml, of)
    return pairs * (2.0 * v * v + 4.0 * means * v)
