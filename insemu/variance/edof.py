"""Equivalent degrees of freedom of Haar wavelet variances, from a model or from the curve's own shape, and the intervals they give.

``M`` overlapping coefficients are correlated, so their mean square scatters like a chi-square with fewer than ``M`` degrees of freedom:
``eta = 2 v^2 / var(v_hat)`` (Percival & Walden 2000, section 8.4; equation (10) of paper 000 is the large-sample limit of the same
variance). Here ``var(v_hat)`` is the exact finite-record double sum.

Without a model, the noise type is read from the whole curve at once: a sum of quantization noise, white noise, first-order Markov noises
(one correlation time per octave) and random walk with non-negative weights. This is far steadier than the local slope where a scale has few
degrees of freedom, and only the shape matters.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import chdtri, ndtri

from insemu.errors import InputError
from insemu.variance import _kernel

Array = NDArray[np.float64]

Intervals = Literal["edof", "eta3", "normal"]

#: Below this many degrees of freedom the normal interval is not offered: it would miss the chi-square one by more than a tenth.
NORMAL_ABOVE = 100.0


def check_confidence(confidence: float) -> float:
    """Return the confidence level, or raise :class:`~insemu.errors.InputError` where it is not strictly between 0 and 1."""
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence is {confidence}, expected a number between 0 and 1 such as 0.95")
    return confidence


def interval(value: Array, edof: Array, confidence: float, kind: Intervals = "edof") -> tuple[Array, Array]:
    """Return the confidence interval of variances with ``edof`` equivalent degrees of freedom.

    ``kind="normal"`` gives the asymptotic normal interval where ``edof`` exceeds 100 and NaN elsewhere; the other kinds are chi-square.
    """
    if kind not in get_args(Intervals):
        raise InputError(f"intervals is '{kind}', expected one of: {', '.join(get_args(Intervals))}")
    tail = 0.5 * (1.0 - check_confidence(confidence))
    if kind == "normal":
        half = ndtri(1.0 - tail) * value * np.sqrt(2.0 / edof)
        half = np.where(edof > NORMAL_ABOVE, half, np.nan)
        return value - half, value + half
    # chdtri inverts the upper tail
    return edof * value / chdtri(edof, tail), edof * value / chdtri(edof, 1.0 - tail)


def eta3(scale_samples: Array, n_samples: int, filter_length: int = 2) -> Array:
    """Degrees of freedom of an ideal band-pass: ``max(M_j / 2^j, 1)`` (Percival & Walden's third choice, the peer's)."""
    length = (scale_samples - 1.0) * (filter_length - 1.0) + 1.0
    return np.maximum((n_samples - length + 1.0) / scale_samples, 1.0)


# --- the curve's own noise type ------------------------------------------------------------------------------------------------------


#: Autocorrelations of the difference filters (1, -2, 1) and (1, -3, 3, -1), from lag 0.
_DIFFERENCE = {2: (6.0, -4.0, 1.0), 3: (20.0, -15.0, 6.0, -1.0)}


_KINDS = {"QN": 0, "WN": 1, "GM": 2, "RW": 3}


def _components(n_samples: int) -> list[tuple[str, float]]:
    markov = [("GM", float(2.0**k)) for k in np.arange(0.0, np.log2(max(n_samples, 4)) - 0.5)]
    return [("QN", 0.0), ("WN", 0.0), *markov, ("RW", 0.0)]


def component_variance(kind: str, tc: float, m: Array) -> Array:
    """Haar wavelet variance of a unit component at averages of ``m`` samples."""
    if kind == "QN":
        return 1.5 / m**2
    if kind == "DR":
        return 0.25 * m**2
    if kind == "WN":
        return 0.5 / m
    walk = (2.0 * m * m + 1.0) / (12.0 * m)
    if kind == "RW":
        return walk
    phi, one_minus = np.exp(-1.0 / tc), -np.expm1(-1.0 / tc)
    closed = 4.0 * (0.5 * (1.0 + phi) / one_minus) * m + phi / one_minus**2 * (
        8.0 * np.expm1(-m / tc) - 2.0 * np.expm1(-2.0 * m / tc)
    )
    return np.asarray(np.where(m < 1e-3 * tc, -np.expm1(-2.0 / tc) * walk, closed / (4.0 * m * m)))


@lru_cache(maxsize=64)
def _basis(m: tuple[float, ...], n_samples: int, drift: bool) -> Array:
    """Wavelet variances of all unit components, one column each."""
    names = _components(n_samples) + ([("DR", 0.0)] if drift else [])
    return np.column_stack([component_variance(kind, tc, np.array(m)) for kind, tc in names])


def noise_type(
    scale_samples: Array, value: Array, n_samples: int, *, drift: bool = False
) -> list[tuple[str, float, float]]:
    """Return ``(kind, time constant in samples, weight)`` of the non-negative sum of noises that follows the curve.

    The weights are of unit components per sample (variances); it is a description of the shape, not a fitted sensor model. ``drift``
    allows a deterministic slope too (without it, degrees of freedom stay on the safe side).
    """
    m = np.asarray(scale_samples, dtype=float) / 2.0
    use = value > 0
    if not use.any():
        return []
    names = _components(n_samples) + ([("DR", 0.0)] if drift else [])
    basis = _basis(tuple(m[use].tolist()), n_samples, drift)
    spread = np.sqrt(2.0 / eta3(2.0 * m[use], n_samples))
    target = value[use]
    level = target.copy()
    weights = np.zeros(len(names))
    for _ in range(3):  # re-weighting by the fitted level keeps a low estimate at a long scale from ruling the fit
        scale = 1.0 / (spread * level)
        norm = np.linalg.norm(basis * scale[:, None], axis=0)
        solution, _ = nnls(basis * scale[:, None] / norm, target * scale)
        weights = solution / norm
        level = np.maximum(basis @ weights, 1e-3 * target)
    return [(kind, tc, float(w)) for (kind, tc), w in zip(names, weights, strict=True) if w > 0]


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


def edof_of_noise(
    parts: list[tuple[str, float, float]],
    scale_samples: Array,
    n_samples: int,
    *,
    order: int = 2,
    averaged: bool = False,
    stride: Array | None = None,
) -> Array:
    """Equivalent degrees of freedom of a mean of squared differences for a sum of unit components (:func:`noise_type`).

    Parameters
    ----------
    parts : list
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
    """
    out = np.empty(len(scale_samples))
    random = [part for part in parts if part[0] in _KINDS]
    kinds = np.array([_KINDS[kind] for kind, _, _ in random], dtype=np.int64)
    tcs, weights = np.array([tc for _, tc, _ in random]), np.array([weight for _, _, weight in random])
    filter = np.array(_DIFFERENCE[order])
    longest = max((tc for kind, tc, _ in parts if kind == "GM"), default=0.0)
    for index, scale in enumerate(np.asarray(scale_samples, dtype=np.int64)):
        m = int(scale) // 2
        step = 1 if stride is None else int(stride[index])
        span = n_samples + 1 - order * m
        count = max((span - 1) // step + 1, 1)
        tau = _nodes(m, (count - 1) * step, longest, order, step)
        smooth = _kernel.noise_covariance(kinds, tcs, weights, tau, float(m), filter, averaged)
        quantization = 0.0 if averaged else sum(weight for kind, _, weight in parts if kind == "QN") / (4.0 * m * m)
        share = 1.0 - tau / (count * step)
        terms = share * smooth**2
        # sum over lags of a function that is linear between nodes, both signs of the lag
        gaps = np.diff(tau) / step
        total = 2.0 * (np.sum(0.5 * gaps * (terms[1:] + terms[:-1])) + 0.5 * (terms[0] + terms[-1])) - terms[0]
        variance = smooth[0]
        if quantization > 0:
            deltas = _DIFFERENCE[order]
            for k, delta in enumerate(deltas):
                if k * m > (count - 1) * step:
                    break
                at = np.searchsorted(tau, k * m)
                d = delta * quantization
                total += (1.0 if k == 0 else 2.0) * share[at] * ((smooth[at] + d) ** 2 - smooth[at] ** 2)
            variance += deltas[0] * quantization
        out[index] = variance**2 * count / total if total > 0 else 1.0
    return np.maximum(out, 1.0)
