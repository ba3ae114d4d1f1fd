"""Equivalent degrees of freedom of Haar wavelet variances, from a model or from the curve's own shape, and the intervals they give.

``M`` overlapping coefficients are correlated, so their mean square scatters like a chi-square with fewer than ``M`` degrees of freedom:
``eta = 2 v^2 / var(v_hat)`` (Percival & Walden 2000, section 8.4; equation (10) of Stebler et al. 2014 is the large-sample limit of the same
variance). Here ``var(v_hat)`` is the exact finite-record double sum.

Without a model, the noise type is read from the whole curve at once: a sum of quantization noise, white noise, first-order Markov noises
(one correlation time per octave) and random walk with non-negative weights. This is far steadier than the local slope where a scale has few
degrees of freedom, and only the shape matters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.noise import PROCESSES
from insemu.variance import _covariance_kernel

Array = NDArray[np.float64]
Scales = NDArray[np.float64] | NDArray[np.int64]

Intervals = Literal["edof", "eta3", "normal"]

#: Below this many degrees of freedom the normal interval is not offered: it would miss the chi-square one by more than a tenth.
NORMAL_ABOVE = 100.0


def check_confidence(confidence: float) -> float:
    """Return the confidence level, or raise :class:`~insemu.errors.InputError` where it is not strictly between 0 and 1."""
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence is {confidence}, expected a number between 0 and 1 such as 0.95")
    return confidence


@dataclass(frozen=True)
class Scatter:
    """How the estimates of a curve scatter; arrays have one entry per scale.

    Parameters
    ----------
    edof : (J,) array
        Equivalent degrees of freedom.
    skew : (J,) array
        Squared skewness over that of a chi-square of so many degrees of freedom, 1 or more.
    follows : (J,) array
        d log(edof) / d log(value): how the degrees of freedom, being read off the curve, follow an estimate that is high or low.
    """

    edof: Array
    skew: Array
    follows: Array


def chi_square_interval(
    value: Array, edof: Array, confidence: float, kind: Intervals = "edof", *, scatter: Scatter | None = None
) -> tuple[Array, Array]:
    """Return the confidence interval of variances with ``edof`` equivalent degrees of freedom.

    ``kind="normal"`` gives the asymptotic normal interval where ``edof`` exceeds 100 and NaN elsewhere; the other kinds are chi-square.
    With ``scatter``, the third cumulant and the dependence of the degrees of freedom on the estimate enter too.

    Parameters
    ----------
    value, edof : (J,) arrays
        Variances in unit^2 and their degrees of freedom.
    confidence : float
    kind : {"edof", "eta3", "normal"}
    scatter : Scatter, optional
        Skewness of the estimates, and how the degrees of freedom follow them.

    Notes
    -----
    A mean of squares of correlated Gaussian terms is a weighted sum of chi-squares, more skewed than the one chi-square that has its
    first two moments. Of two distributions with its first three, the shifted chi-square (Pearson 1959) is short in the lower tail and
    the power of a Gaussian (Jensen and Solomon 1972) long; the mean of their quantiles is taken. Where the truth is at an end of the interval, the
    estimate is low or high, and so are the degrees of freedom that were read off the curve with it: each end uses those that the curve
    would have shown.
    """
    if kind not in get_args(Intervals):
        raise InputError(f"intervals is '{kind}', expected one of: {', '.join(get_args(Intervals))}")
    tail = 0.5 * (1.0 - check_confidence(confidence))
    if kind == "normal":
        half = scipy.special.ndtri(1.0 - tail) * value * np.sqrt(2.0 / edof)
        half = np.where(edof > NORMAL_ABOVE, half, np.nan)
        return value - half, value + half
    if scatter is None or kind == "eta3":
        # chdtri inverts the upper tail
        return edof * value / scipy.special.chdtri(edof, tail), edof * value / scipy.special.chdtri(edof, 1.0 - tail)
    ends = []
    for upper in (tail, 1.0 - tail):
        there = 1.0 / _power(edof, scatter.skew, upper)
        freedom = np.maximum(edof * np.clip(there, 0.2, 5.0) ** scatter.follows, 1.0)
        own = freedom / scatter.skew
        # a plain chi-square where the skewness is that of one
        shifted = 1.0 + (scipy.special.chdtri(own, upper) / own - 1.0) / np.sqrt(scatter.skew)
        ends.append(
            value / np.where(scatter.skew > 1.0, 0.5 * (shifted + _power(freedom, scatter.skew, upper)), shifted)
        )
    return ends[0], ends[1]


def _power(edof: Array, skew: Array, upper: float) -> Array:
    """Quantile, for the probability ``upper`` above it, of an estimate over its expectation, a power of which is Gaussian."""
    h = 1.0 - 2.0 / 3.0 * np.sqrt(skew)
    h = np.where(np.abs(h) < 1e-3, 1e-3, h)
    return np.asarray(
        np.maximum(1.0 + h * (h - 1.0) / edof + scipy.special.ndtri(1.0 - upper) * h * np.sqrt(2.0 / edof), 1e-12)
        ** (1.0 / h)
    )


def eta3(scale_samples: Array, n_samples: int, filter_length: int = 2) -> Array:
    """Degrees of freedom of an ideal band-pass: ``max(M_j / 2^j, 1)`` (Percival & Walden's third choice, the peer's).

    Parameters
    ----------
    scale_samples : (J,) array
        Scales in samples.
    n_samples : int
        Length of the record.
    filter_length : int
        Taps of the filter.
    """
    length = (scale_samples - 1.0) * (filter_length - 1.0) + 1.0
    return np.maximum((n_samples - length + 1.0) / scale_samples, 1.0)


# --- the curve's own noise type ------------------------------------------------------------------------------------------------------


#: Autocorrelations of the difference filters (1, -2, 1) and (1, -3, 3, -1), from lag 0.
_DIFFERENCE = {2: (6.0, -4.0, 1.0), 3: (20.0, -15.0, 6.0, -1.0)}


#: Numbers of the random components in the kernel of their autocovariances.
_KINDS = {"QN": 0, "WN": 1, "GM": 2, "RW": 3}


def _components(n_samples: int) -> list[tuple[str, float]]:
    markov = [("GM", float(2.0**k)) for k in np.arange(0.0, np.log2(max(n_samples, 4)) - 0.5)]
    return [("QN", 0.0), ("WN", 0.0), *markov, ("RW", 0.0)]


def component_variance(kind: str, tc: float, m: Array) -> Array:
    """Haar wavelet variance of a unit component at averages of ``m`` samples; ``tc`` is the time constant of a GM in samples.

    Parameters
    ----------
    kind : {"QN", "WN", "GM", "RW", "DR"}
    tc : float
        Time constant of a GM in samples.
    m : (J,) array
        Samples per average, not necessarily whole.
    """
    return PROCESSES[kind]().unit_wavelet_variance(m, (-np.log(tc),) if kind == "GM" else ())


@lru_cache(maxsize=64)
def _basis(m: tuple[float, ...], n_samples: int, drift: bool) -> Array:
    """Wavelet variances of all unit components, one column each."""
    names = _components(n_samples) + ([("DR", 0.0)] if drift else [])
    return np.column_stack([component_variance(kind, tc, np.array(m)) for kind, tc in names])


@dataclass(frozen=True)
class NoiseType:
    """A sum of noises that follows a curve: the shape only, not a fitted sensor model.

    Parameters
    ----------
    parts : list
        ``(kind, time constant in samples, weight)``, weights being of unit components per sample (variances).
    moves : (P, J) array
        How much each weight moves per relative change of the curve's J values.
    """

    parts: list[tuple[str, float, float]]
    moves: Array

    def variance(self, m: Array) -> Array:
        """Haar wavelet variance of the sum at averages of ``m`` samples."""
        return np.asarray(sum(weight * component_variance(kind, tc, m) for kind, tc, weight in self.parts))


WHITE = NoiseType([("WN", 0.0, 1.0)], np.zeros((1, 0)))


def noise_type(
    scale_samples: Scales,
    value: Array,
    n_samples: int,
    *,
    drift: bool = False,
    unit_curves: Callable[[tuple[tuple[str, float], ...]], Array] | None = None,
) -> NoiseType:
    """Return the non-negative sum of noises that follows a wavelet variance curve.

    Parameters
    ----------
    scale_samples, value : (J,) arrays
        The curve.
    n_samples : int
        Length of the record.
    drift : bool
        Allow a deterministic slope too (without it, degrees of freedom stay on the safe side).
    unit_curves : callable, optional
        Curves (J, components) of unit components, where they are not those of the Haar filter.
    """
    m = np.asarray(scale_samples, dtype=float) / 2.0
    use = value > 0
    if not use.any():
        return NoiseType([], np.zeros((0, value.size)))
    names = _components(n_samples) + ([("DR", 0.0)] if drift else [])
    if unit_curves is None:
        basis = _basis(tuple(m[use].tolist()), n_samples, drift)
    else:
        basis = unit_curves(tuple(names))[use]
    spread = np.sqrt(2.0 / eta3(2.0 * m[use], n_samples))
    target = value[use]
    level = target.copy()
    for _ in range(3):  # re-weighting by the fitted level keeps a low estimate at a long scale from ruling the fit
        scale = 1.0 / (spread * level)
        norm = np.linalg.norm(basis * scale[:, None], axis=0)
        solution, _ = scipy.optimize.nnls(basis * scale[:, None] / norm, target * scale)
        weights = solution / norm
        level = np.maximum(basis @ weights, 1e-3 * target)
    found = np.flatnonzero(weights > 0)
    moves = np.zeros((found.size, value.size))
    moves[:, use] = (np.linalg.pinv(basis[:, found] * scale[:, None] / norm[found]) * scale * target) / norm[
        found, None
    ]
    return NoiseType([(*names[k], float(weights[k])) for k in found], moves)


#: Correlation of the estimates of octaves 0, 1, 2.. apart for quantization noise, white noise and random walk (exact, long records).
OCTAVES_TOGETHER = np.array(
    [
        [1.0, 0.400, 0.513, 0.513, 0.513, 0.513, 0.513, 0.513],
        [1.0, 0.528, 0.186, 0.066, 0.023, 0.008, 0.003, 0.001],
        [1.0, 0.885, 0.671, 0.483, 0.342, 0.242, 0.170, 0.119],
    ]
)
#: What it falls by per octave beyond the table.
_BEYOND = np.array([1.0, 0.5, np.sqrt(0.5)])


def octave_correlation(noise: NoiseType, m: Array) -> Array:
    """Correlation matrix of the estimates of successive octaves, between those of the three straight slopes by the local slope."""
    slope = 0.5 * np.log2(noise.variance(2.0 * m) / noise.variance(0.5 * m))
    quantized, walk = np.clip(-1.0 - slope, 0.0, 1.0), np.clip(0.5 + 0.5 * slope, 0.0, 1.0)
    shares = np.sqrt(np.array([quantized, 1.0 - quantized - walk, walk]))
    apart = np.abs(np.subtract.outer(np.arange(m.size), np.arange(m.size)))
    last = OCTAVES_TOGETHER.shape[1] - 1
    each = OCTAVES_TOGETHER[:, np.minimum(apart, last)] * _BEYOND[:, None, None] ** np.maximum(apart - last, 0)
    # sums of independent parts: a correlation matrix again
    return np.asarray(np.einsum("ki,kij,kj->ij", shares, each, shares))


def correlated_octaves(m: ArrayLike, value: ArrayLike, n_samples: int) -> Array:
    """Correlation matrix of the values of an Allan-type curve at successive octaves, for the noise that the curve itself shows.

    Parameters
    ----------
    m : (J,) array
        Samples averaged, each twice the one before.
    value : (J,) array
        Variance, unit^2.
    n_samples : int
        Length of the record.
    """
    steps = np.asarray(m)
    noise = noise_type(2 * steps, np.asarray(value) / 2.0, n_samples, drift=True)
    return octave_correlation(noise, steps.astype(float))


@lru_cache(maxsize=512)
def _nodes(m: int, last: int, longest: float, order: int, stride: int) -> Array:
    """Lags at which a coefficient's autocovariance is evaluated: dense at its corners 0, m, 2m.., geometric towards and beyond them."""
    end = min(last, int(order * m + 12 * longest))
    if end // stride <= 256:
        return np.arange(0, end + 1, stride, dtype=float)
    reach = np.unique(np.round(np.concatenate([[0, 1, 2], 1.5 ** np.arange(3.0, np.log(end) / np.log(1.5) + 1)])))
    body = np.linspace(0, order * m, 32 * order + 1).round()
    nodes = np.concatenate([c * m + s * reach for c in range(order + 1) for s in (-1, 1)] + [body, [end]])
    nodes = np.unique((nodes[(nodes >= 0) & (nodes <= end)] // stride) * stride)
    return nodes


class _Grid(NamedTuple):
    """Differences of the running sum of a record: steps, distances of successive terms, longest correlation time (samples), and order."""

    steps: tuple[int, ...]
    strides: tuple[int, ...]
    n_samples: int
    longest: float
    order: int


@lru_cache(maxsize=64)
def _differences(grid: _Grid) -> _covariance_kernel.Differences:
    """For every step :func:`_nodes`, then an even grid of 8 positions per step (none for the shortest), and where each begins."""
    order, each = grid.order, []
    for m, stride in zip(grid.steps, grid.strides, strict=True):
        reach = max(grid.n_samples - order * m, 0)
        nodes = _nodes(m, reach // stride * stride, grid.longest, order, stride)
        each.append(nodes)
        spacing = max(m // 8, stride)
        size = min(reach // spacing + 1, int(nodes[-1]) // spacing + 2, 129) if reach <= 512 * m else 0
        each.append(spacing * np.arange(size, dtype=float))
    ends = np.concatenate([[0], np.cumsum([e.size for e in each])]).astype(np.int64)
    steps, strides = np.array(grid.steps, dtype=np.int64), np.array(grid.strides, dtype=np.int64)
    return _covariance_kernel.Differences(
        steps, strides, grid.n_samples, np.array(_DIFFERENCE[order]), np.concatenate(each), ends
    )


@lru_cache(maxsize=256)
def _unit_covariances(kind: str, tc: float, grid: _Grid, averaged: bool) -> Array:
    """Autocovariances of one unit component at the lags of :func:`_differences`."""
    of = _differences(grid)
    out = np.empty(of.lags.size)
    _covariance_kernel.unit_covariances(_KINDS[kind], tc, of, averaged, out)
    return out


@dataclass(frozen=True)
class Kept:
    """Which terms of a mean of squares a record with gaps has; one entry per scale.

    Parameters
    ----------
    terms : (J,) array
        Their number.
    lags, share : J arrays
        Pairs of terms a lag (samples) apart over the number of terms.
    white : (J,) array
        White noise that the terms have beyond the noise of the signal, because samples are missing in them; unit^2 per sample.
    """

    terms: Array
    lags: list[Array]
    share: list[Array]
    white: Array


def scatter_of_noise(
    noise: NoiseType,
    scale_samples: Scales,
    n_samples: int,
    *,
    order: int = 2,
    averaged: bool = False,
    stride: Scales | None = None,
    kept: Kept | None = None,
) -> Scatter:
    """Return how a mean of squared differences of a noise scatters.

    Parameters
    ----------
    noise : NoiseType
        From :func:`noise_type`.
    scale_samples : (J,) array
        Twice the step ``m`` of the differences (the Haar scale).
    n_samples : int
        Length of the record.
    order : {2, 3}
        Second differences of the running sum (Haar, Allan) or third (Hadamard).
    averaged : bool
        Of the running sum averaged over m samples (modified Allan; third differences of its sum).
    stride : (J,) array, optional
        Step between successive terms; 1 by default (overlapping).
    kept : Kept, optional
        Terms of a record with gaps.
    """
    steps = np.asarray(scale_samples, dtype=np.int64) // 2
    strides = np.ones_like(steps) if stride is None else np.asarray(stride, dtype=np.int64)
    count = steps.size
    random = [k for k, part in enumerate(noise.parts) if part[0] in _KINDS]
    if not random:
        return Scatter(np.ones(count), np.ones(count), np.zeros(count))
    chosen = [noise.parts[k] for k in random]
    weights = np.tile([weight for _, _, weight in chosen], (count, 1))
    longest = max((tc for kind, tc, _ in chosen if kind == "GM"), default=0.0)
    grid = _Grid(tuple(steps.tolist()), tuple(strides.tolist()), n_samples, longest, order)
    of = _differences(grid)
    lags, ends = of.lags, of.ends
    units = np.array([_unit_covariances(kind, tc, grid, averaged) for kind, tc, _ in chosen])
    quantized = next((k for k, part in enumerate(chosen) if part[0] == "QN" and not averaged), -1)
    terms = np.maximum((n_samples - order * steps) // strides + 1, 1).astype(np.float64)
    at = np.repeat(np.arange(count), ends[2::2] - ends[:-1:2])
    share = 1.0 - lags / (terms * strides)[at]
    if kept is not None:
        white = next((k for k, part in enumerate(chosen) if part[0] == "WN"), None)
        if white is not None:
            weights[:, white] += kept.white
        terms = kept.terms
        for j in range(count):
            own = slice(ends[2 * j], ends[2 * j + 1])
            share[own] = np.interp(lags[own], kept.lags[j], kept.share[j])
    edof, skew, slopes = _covariance_kernel.scatter_of_means(units, weights, quantized, of, terms, share)
    follows = np.zeros(count)
    if noise.moves.shape[1] == count:
        # the estimates of neighbouring octaves go together
        each = slopes @ noise.moves[random]
        spread = np.sqrt(2.0 / np.maximum(edof, 1.0))
        together = octave_correlation(noise, steps.astype(float))
        follows = np.sum(each * together * spread, axis=1) / spread
    return Scatter(np.maximum(edof, 1.0), np.clip(skew, 1.0, 4.0), np.clip(follows, -1.0, 1.0))


def edof_of_noise(
    noise: NoiseType,
    scale_samples: Scales,
    n_samples: int,
    *,
    order: int = 2,
    averaged: bool = False,
    stride: Scales | None = None,
) -> Array:
    """Equivalent degrees of freedom alone of :func:`scatter_of_noise`.

    Parameters
    ----------
    noise, scale_samples, n_samples, order, averaged, stride
        As there.
    """
    return scatter_of_noise(noise, scale_samples, n_samples, order=order, averaged=averaged, stride=stride).edof
