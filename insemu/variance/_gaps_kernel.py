"""Compiled loops over records with missing samples: Haar coefficients from the samples that are there, and pairs of them.

``sums`` and ``there`` are the sum and the number of the samples known before each place, (n + 1,) arrays. A coefficient that begins at a
place compares the means of two halves of ``half`` samples, and counts where ``least`` samples of each are there. Where samples are missing at
random a branch would be guessed wrong every second time: loops that see every sample have none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Coefficients worked on at a time, so that means stay in the first-level cache.
BLOCK = 1024


@njit(cache=True, nogil=True)
def _known(x: Array, origin: float, value: Array, known: Array) -> None:  # pragma: no cover - compiled
    """Fill samples less ``origin``, 0 where they are not finite, and 1 where they are, 0 elsewhere."""
    for i in range(x.size):
        d = x[i] - origin
        finite = abs(d) < np.inf
        value[i] = d if finite else 0.0
        known[i] = 1.0 if finite else 0.0


@njit(cache=True, nogil=True)
def every_second(values: Array) -> Array:  # pragma: no cover - compiled
    """Move every second number from the first on to the front, and return those.

    Parameters
    ----------
    values : (n,) array
        Overwritten.
    """
    size = (values.size + 1) // 2
    for i in range(size):
        values[i] = values[2 * i]
    return values[:size]


@njit(cache=True, nogil=True)
def running(x: Array, origin: float, sums: Array, there: Array) -> None:  # pragma: no cover - compiled
    """Fill running sums, with ``origin`` subtracted, and numbers of the samples that are finite.

    Parameters
    ----------
    x : (n,) array
        Signal; missing samples are not finite.
    origin : float
        Subtracted beforehand.
    sums : (n + 1,) array
        Running sums of the samples.
    there : (n + 1,) array
        Running numbers of the samples that are there.
    """
    total, number = 0.0, 0.0
    sums[0] = there[0] = 0.0
    value, known = np.empty(BLOCK), np.empty(BLOCK)
    for begin in range(0, x.size, BLOCK):
        size = min(BLOCK, x.size - begin)
        _known(x[begin : begin + size], origin, value, known)
        sums_here, there_here = sums[begin + 1 : begin + 1 + size], there[begin + 1 : begin + 1 + size]
        for i in range(size):
            total += value[i]
            number += known[i]
            sums_here[i] = total
            there_here[i] = number


@njit(cache=True, nogil=True)
def _means(
    sums: Array, sums_on: Array, there: Array, there_on: Array, least: float, mean: Array, good: Array
) -> None:  # pragma: no cover - compiled
    """Fill means of halves from running sums at their begin and end, and 1 where enough is there, 0 elsewhere."""
    for i in range(mean.size):
        number = there_on[i] - there[i]
        mean[i] = (sums_on[i] - sums[i]) / max(number, 1.0)
        good[i] = 1.0 if number >= least else 0.0


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _differences(
    one: Array, two: Array, good_one: Array, good_two: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Sum of squared differences of means that are both good, and their number."""
    total, number = 0.0, 0.0
    for i in range(one.size):
        both = good_one[i] * good_two[i]
        d = two[i] - one[i]
        total += both * (d * d)
        number += both
    return total, number


@njit(cache=True, nogil=True)
def squares(sums: Array, there: Array, half: int, least: float) -> tuple[float, int]:  # pragma: no cover - compiled
    """Sum of squared differences of the means of adjoining halves, and their number.

    Of running sums at every second place, or fewer, it is those of the coefficients that begin there, with ``half`` in such steps.

    Parameters
    ----------
    sums : (n + 1,) array
        Running sums of the samples.
    there : (n + 1,) array
        Running numbers of the samples that are there.
    half : int
        Samples of half a coefficient.
    least : float
        Samples of a half that must be there.
    """
    total, number = 0.0, 0.0
    mean, good = np.empty(BLOCK + half), np.empty(BLOCK + half)
    count = sums.size - 2 * half
    for begin in range(0, count, BLOCK):
        size = min(BLOCK, count - begin)
        end = begin + size + half
        _means(
            sums[begin:end],
            sums[begin + half : end + half],
            there[begin:end],
            there[begin + half : end + half],
            least,
            mean[: size + half],
            good[: size + half],
        )
        more, pairs = _differences(mean[:size], mean[half : size + half], good[:size], good[half : size + half])
        total += more
        number += pairs
    return total, int(number)


@njit(cache=True, nogil=True)
def is_there(there: Array, i: int, half: int, least: float) -> bool:  # pragma: no cover - compiled
    """Whether the coefficient that begins at ``i`` counts.

    Parameters
    ----------
    there : (n + 1,) array
        Running numbers of the samples that are there.
    i : int
        Where the coefficient begins.
    half : int
        Samples of half a coefficient.
    least : float
        Samples of a half that must be there.
    """
    middle = there[i + half]
    return bool((middle - there[i] >= least) & (there[i + 2 * half] - middle >= least))


@njit(cache=True, nogil=True)
def pairs(
    there: Array, half: int, places: Ints, least: float, lags: Ints, share: Array
) -> None:  # pragma: no cover - compiled
    """Fill the pairs of coefficients that far apart over the number of coefficients; lags ascend.

    Parameters
    ----------
    there : (n + 1,) array
        Running numbers of the samples that are there.
    half : int
        Samples of half a coefficient.
    places : (p,) array of int
        Where the coefficients that are looked at begin.
    least : float
        Samples of a half that must be there.
    lags : (k,) array of int
        Ascending.
    share : (k,) array
        Filled.
    """
    last = there.size - 1 - 2 * half
    number = 0
    share[:] = 0.0
    for i in places:
        if not is_there(there, i, half, least):
            continue
        number += 1
        for k in range(np.searchsorted(lags, last - i, side="right")):
            share[k] += 1.0 if is_there(there, i + lags[k], half, least) else 0.0
    share /= max(number, 1)


@njit(cache=True, nogil=True)
def pair_weights(there: Array, half: int, places: Ints, least: float, out: Array) -> int:  # pragma: no cover - compiled
    """Fill how much the mean of coefficients weighs the variogram at each distance, and return their number.

    Each half is counted in parts; ``out[d]`` is of samples in parts ``d`` apart, (2 parts,).

    Parameters
    ----------
    there : (n + 1,) array
        Running numbers of the samples that are there.
    half : int
        Samples of half a coefficient.
    places : (p,) array of int
        Where the coefficients that are looked at begin.
    least : float
        Samples of a half that must be there.
    out : (2 parts,) array
        Filled.
    """
    parts = out.size // 2
    size = half // parts
    weight = np.empty(2 * parts)
    out[:] = 0.0
    number = 0
    for i in places:
        if not is_there(there, i, half, least):
            continue
        number += 1
        middle = there[i + half]
        before, after = -0.5 / (middle - there[i]), 0.5 / (there[i + 2 * half] - middle)
        for k in range(2 * parts):
            known = there[i + (k + 1) * size] - there[i + k * size]
            by = before if k < parts else after
            weight[k] = by * known
            # a sample has no distance from itself
            out[0] -= by * by * known * (known - 1.0)
        for d in range(1, 2 * parts):
            for k in range(2 * parts - d):
                out[d] -= 2.0 * weight[k] * weight[k + d]
    out /= max(number, 1)
    return number


@njit(cache=True, nogil=True)
def mean_weights(there: Array, i: int, half: int, weight: Array) -> None:  # pragma: no cover - compiled
    """Fill the weights of the samples from ``i`` on in the coefficient that begins there.

    Parameters
    ----------
    there : (n + 1,) array
        Running numbers of the samples that are there.
    i : int
        Where the coefficient begins.
    half : int
        Samples of half a coefficient.
    weight : (2 half,) array
        Filled.
    """
    middle = there[i + half]
    before, after = -0.5 / (middle - there[i]), 0.5 / (there[i + 2 * half] - middle)
    for k in range(2 * half):
        weight[k] = (before if k < half else after) * (there[i + k + 1] - there[i + k])


@njit(cache=True, nogil=True)
def short_pairs(
    there: Array, half: int, places: Ints, least: float, variogram: Array, white: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Squared covariances of neighbouring coefficients summed: each pair with the samples that it has, and as if all had the same.

    Parameters
    ----------
    there : (n + 1,) array
        Running numbers of the samples that are there.
    half : int
        Samples of half a coefficient.
    places : (p,) array of int
        Where the coefficients that are looked at begin.
    least : float
        Samples of a half that must be there.
    variogram : (m,) array
        Of the noise from lag 0, unit^2, m at least 8 half.
    white : float
        What missing samples add on average, unit^2 per sample.
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
    # covariance of a coefficient with each sample from its first on
    sample = np.empty(reach + 2 * half)
    exact, same = 0.0, 0.0
    for i in places:
        if not is_there(there, i, half, least):
            continue
        mean_weights(there, i, half, mine)
        for c in range(sample.size):
            sample[c] = 0.0
            for a in range(2 * half):
                sample[c] -= mine[a] * variogram[abs(c - a)]
        for lag in range(min(reach, last - i + 1)):
            if not is_there(there, i + lag, half, least):
                continue
            mean_weights(there, i + lag, half, other)
            total = 0.0
            for b in range(2 * half):
                total += other[b] * sample[lag + b]
            often = 1.0 if lag == 0 else 2.0
            exact += often * total * total
            same += often * whole[lag] * whole[lag]
    return exact, same
