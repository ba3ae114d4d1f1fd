"""Compiled loops of this room: the Haar pyramid over chunks, and sums over covariance sequences.

Scalar code over plain arrays. ``reassoc`` lets the compiler vectorise sums; NaN still propagate.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Samples worked on at a time: fits the first-level caches, so that the small octaves cost no memory traffic.
CHUNK = 2048
#: Scales up to this many samples are computed at every sample; above it, coefficients are taken on a grid of at least this many
#: positions per scale, so that memory does not grow with the record.
FULL_OVERLAP = 1 << 20


def haar_buffers(levels: int, full: int = FULL_OVERLAP) -> tuple[NDArray[np.int64], Array]:
    """Return the offsets and the zeroed delay lines that :func:`haar_push` keeps between chunks.

    Level j compares averages that are 2^(j-1) samples apart, so it needs that many earlier averages, or ``full / 2`` where its scale is
    longer than ``full`` samples (decimated).
    """
    sizes = [min(1 << (j - 1), full // 2) for j in range(1, levels + 1)]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    return offsets, np.zeros(int(offsets[-1]))


# Plain loops over slices that start at 0: an index such as ``i - m`` could be negative, and the check for that would keep the compiler
# from vectorising. Averages are kept as sums: powers of two are divided out at the end, exactly.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _octave(new: Array, old: Array, out: Array) -> float:  # pragma: no cover - compiled
    """Sums to ``out``; returns the sum of squared differences."""
    total = 0.0
    for i in range(new.size):
        d = new[i] - old[i]
        out[i] = new[i] + old[i]
        total += d * d
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _octave_of_line(new: Array, line: Array, out: Array) -> float:  # pragma: no cover - compiled
    """As :func:`_octave` with the delay line's part, which then takes the new values."""
    total = 0.0
    for i in range(new.size):
        n = new[i]
        o = line[i]
        d = n - o
        out[i] = n + o
        line[i] = n
        total += d * d
    return total


@njit(cache=True, nogil=True)
def _octave_from(first: int, new: Array, old: Array, out: Array) -> float:  # pragma: no cover - compiled
    """As :func:`_octave`, but differences count from index ``first`` on."""
    if first <= 0:
        return _octave(new, old, out)
    if first >= new.size:
        _octave(new, old, out)
        return 0.0
    _octave(new[:first], old[:first], out[:first])
    return _octave(new[first:], old[first:], out[first:])


@njit(cache=True, nogil=True)
def haar_push(
    x: Array,
    origin: float,
    start: int,
    offsets: NDArray[np.int64],
    delay: Array,
    sums: Array,
    counts: NDArray[np.int64],
    full: int,
) -> None:  # pragma: no cover - compiled
    """Add samples ``x`` (at global index ``start``, a multiple of the chunk) to the sums of squares of Haar MODWT coefficients.

    ``sums[j - 1]`` is of (4 times) the squared level-j coefficients, ``counts`` how many. Every call but the last must bring a multiple of
    ``CHUNK`` samples. ``origin`` is subtracted, so that an offset such as gravity costs no digits.
    """
    levels = sums.size
    a = np.empty(CHUNK)
    b = np.empty(CHUNK)
    done = 0
    while done < x.size:
        n = min(CHUNK, x.size - done)
        for i in range(n):
            a[i] = x[done + i] - origin
        g = start + done  # global index of a[0], in units of the stride
        stride = 1
        for level in range(levels):
            m = 1 << level
            if 2 * m > full:
                # keep every other average: this level's scale is 2 m samples, its grid stays full/2 positions wide
                kept = 0
                for i in range(g % 2, n, 2):
                    a[kept] = a[i]
                    kept += 1
                g = (g + 1) // 2
                n = kept
                stride *= 2
                m = full // 2
            if n == 0:
                break
            old = delay[offsets[level] : offsets[level + 1]]
            # the first coefficient that sees no sample before the record is at sample 2 * 2^level - 1
            warm = (2 << level) - 1
            first_g = (warm + stride - 1) // stride
            first = min(max(first_g - g, 0), n)
            if m >= n:
                at = g % m
                line = old[at : at + n]
                if first == 0:
                    total = _octave_of_line(a[:n], line, b[:n])
                else:
                    total = _octave_from(first, a[:n], line, b[:n])
                    line[:] = a[:n]
            else:
                total = _octave_from(first, a[:m], old, b[:m])
                total += _octave_from(first - m, a[m:n], a[: n - m], b[m:n])
                old[:] = a[n - m : n]
            sums[level] += total * 0.25**level
            counts[level] += n - first
            a, b = b, a
        done += CHUNK


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def haar_coefficients_level(a: Array, m: int, w: Array, v: Array) -> None:  # pragma: no cover - compiled
    """One octave of a whole record without boundary: differences to ``w`` and averages to ``v``, both ``a.size - m`` long."""
    for i in range(a.size - m):
        w[i] = 0.5 * (a[i + m] - a[i])
        v[i] = 0.5 * (a[i + m] + a[i])


@njit(cache=True, nogil=True)
def haar_covariances(s1: Array, n: int, levels: int, means: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Fill ``out[j, l]`` with the covariance of the Haar wavelet variances of levels j+1 and l+1 of ``n`` samples.

    ``s1`` is the autocovariance of the level-1 coefficients at lags 0..n-1. A coefficient of the next octave is
    (1 + B^m)^2 / 2 of this one's, so every covariance sequence follows from ``s1`` by positive weights: nothing cancels, also for
    integrated processes. ``means`` are the means of the coefficients (drift).
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
def haar_variances_of_variances(
    s1: Array, n: int, levels: int, means: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """The diagonal of :func:`haar_covariances` alone, in time proportional to ``n * levels``."""
    own = s1.copy()
    for j in range(levels):
        mj = 1 << j
        last = n - 2 * mj  # the longest lag at which two coefficients exist
        count = float(last + 1)
        total = 0.0
        for i in range(last + 1):
            weight = 1.0 if i == 0 else 2.0
            total += weight * (count - i) * (2.0 * own[i] * own[i] + 4.0 * means[j] * means[j] * own[i])
        out[j] = total / (count * count)
        if j + 1 < levels:
            new = np.zeros(n)
            for i in range(n - 4 * mj + 1):
                new[i] = 0.25 * (
                    6.0 * own[i] + 4.0 * (own[i + mj] + own[abs(i - mj)]) + own[i + 2 * mj] + own[abs(i - 2 * mj)]
                )
            own = new


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def biweight_sums(w: Array, inverse_square: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """Sums of the biweight and of the biweight times the square, cut at ``w^2 = 1 / inverse_square``."""
    weights = 0.0
    squares = 0.0
    for i in range(w.size):
        s = w[i] * w[i]
        d = max(1.0 - s * inverse_square, 0.0)
        d *= d
        weights += d
        squares += d * s
    return weights, squares


@njit(cache=True, nogil=True)
def untouched(
    w: Array, seen: NDArray[np.int64], scale: int, stride: int, out: Array
) -> int:  # pragma: no cover - compiled
    """Copy every ``stride``-th coefficient whose ``scale`` samples hold no flagged step; returns how many.

    ``seen[k]`` counts flagged steps before sample k (a step k joins samples k and k + 1).
    """
    kept = 0
    for i in range(0, w.size, stride):
        if seen[i + scale - 1] == seen[i]:
            out[kept] = w[i]
            kept += 1
    return kept


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def second_differences(s: Array, m: int, stride: int) -> float:  # pragma: no cover - compiled
    """Sum of squares of s[k + 2m] - 2 s[k + m] + s[k]."""
    total = 0.0
    for k in range(0, s.size - 2 * m, stride):
        d = s[k + 2 * m] - 2.0 * s[k + m] + s[k]
        total += d * d
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def third_differences(s: Array, m: int, stride: int) -> float:  # pragma: no cover - compiled
    """Sum of squares of s[k + 3m] - 3 s[k + 2m] + 3 s[k + m] - s[k]."""
    total = 0.0
    for k in range(0, s.size - 3 * m, stride):
        d = s[k + 3 * m] - 3.0 * (s[k + 2 * m] - s[k + m]) - s[k]
        total += d * d
    return total


@njit(cache=True, nogil=True)
def averaged_second_differences(s: Array, m: int) -> float:  # pragma: no cover - compiled
    """Sum of squares of second differences of step m, each averaged over m neighbours (times m)."""
    window = 0.0
    for k in range(m):
        window += s[k + 2 * m] - 2.0 * s[k + m] + s[k]
    total = window * window
    for k in range(s.size - 3 * m):
        window += (s[k + 3 * m] - s[k]) - 3.0 * (s[k + 2 * m] - s[k + m])
        total += window * window
    return total


@njit(cache=True, nogil=True)
def reflected_second_differences(s: Array, m: int) -> float:  # pragma: no cover - compiled
    """Sum of squares of s*[i - m] - 2 s*[i] + s*[i + m] over inner i, where s* continues s by odd reflection at both ends."""
    last = s.size - 1
    total = 0.0
    for i in range(1, last):
        a = s[i - m] if i >= m else 2.0 * s[0] - s[m - i]
        b = s[i + m] if i + m <= last else 2.0 * s[last] - s[2 * last - i - m]
        d = a - 2.0 * s[i] + b
        total += d * d
    return total


@njit(cache=True, nogil=True)
def _kappa(
    kind: int, tc: float, c1: float, c2: float, c3: float, h: float, averaged: bool
) -> float:  # pragma: no cover - compiled
    """Generalized covariance at lag ``h >= 0`` of the running sum of a unit component (of its sum once more where ``averaged``).

    Second differences of it give minus the covariance one summation lower: -h/2 for white noise, (h^3 - h)/12 for random walk, and so
    on. Kinds: 0 quantization, 1 white, 2 Markov of time constant ``tc`` samples (constants of :func:`noise_covariance`), 3 random walk.
    """
    if kind == 0:
        return -0.5 * h if averaged else 0.0
    if kind == 1:
        return (h * h * h - h) / 12.0 if averaged else -0.5 * h
    if kind == 3:
        return -(h**5 / 240.0 - h * h * h / 48.0 + h / 60.0) if averaged else (h * h * h - h) / 12.0
    if not averaged:
        return -(c1 * h + c2 * np.expm1(-h / tc))
    return c1 * (h * h * h - h) / 6.0 + c2 * c3 * np.exp(-h / tc) + c2 * (0.5 + c3 * -np.expm1(-1.0 / tc)) * h


@njit(cache=True, nogil=True)
def noise_covariance(
    kinds: NDArray[np.int64], tcs: Array, weights: Array, tau: Array, m: float, filter: Array, averaged: bool
) -> Array:  # pragma: no cover - compiled
    """Autocovariance at lags ``tau`` of differences of step ``m`` of the running sum, over 4 m^2, of a sum of unit components.

    ``filter`` is the autocorrelation of the difference filter from lag 0. Without the single lags at which quantization noise (not
    averaged) contributes.
    """
    order = filter.size - 1
    out = np.zeros(tau.size)
    sign = 1.0
    if averaged and order == 2:
        sign = -1.0
    for p in range(kinds.size):
        kind, tc, weight = kinds[p], tcs[p], weights[p]
        if kind == 0 and not averaged:
            continue
        if (
            kind == 2 and m < 1e-3 * tc
        ):  # within its correlation time a Markov noise is a random walk; the closed form would cancel
            weight = weight * -np.expm1(-2.0 / tc)
            kind = 3
        one_minus = -np.expm1(-1.0 / tc) if kind == 2 else 1.0
        phi = 1.0 - one_minus
        c1 = 0.5 * (1.0 + phi) / one_minus
        c2, c3 = phi / one_minus**2, phi / one_minus**2
        for i in range(tau.size):
            if kind != 2 and tau[i] >= order * m:
                break  # exactly zero from here on
            total = filter[0] * _kappa(kind, tc, c1, c2, c3, tau[i], averaged)
            for k in range(1, order + 1):
                total += filter[k] * (
                    _kappa(kind, tc, c1, c2, c3, tau[i] + k * m, averaged)
                    + _kappa(kind, tc, c1, c2, c3, abs(tau[i] - k * m), averaged)
                )
            out[i] += sign * weight * total / (4.0 * m * m)
    return out
