"""Equivalent degrees of freedom of Haar wavelet variances, from a model or from the curve's own shape, and the intervals they give.

``M`` overlapping coefficients are correlated, so their mean square scatters like a chi-square with fewer than ``M`` degrees of freedom:
``eta = 2 v^2 / var(v_hat)`` (Percival & Walden 2000, section 8.4; equation (10) of paper 000 is the large-sample limit of the same
variance). Here ``var(v_hat)`` is the exact finite-record double sum.

Without a model, the noise type is read from the whole curve at once: a sum of quantization noise, white noise, first-order Markov noises
(one correlation time per octave) and random walk with non-negative weights. This is far steadier than the local slope where a scale has few
degrees of freedom, and only the shape matters.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import chdtri, ndtri

from insemu.errors import InputError

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


def _kappa(kind: str, tc: float, h: Array, m: float, averaged: bool) -> Array:
    """Generalized covariance at lags ``h >= 0`` of the running sum of a unit component (of its sum once more where ``averaged``).

    Second differences of it give minus the covariance one summation lower: -h/2 for white noise, (h^3 - h)/12 for random walk, and so on.
    """
    if (
        kind == "GM" and m < 1e-3 * tc
    ):  # within its correlation time a Markov noise is a random walk; the closed form would cancel
        return -np.expm1(-2.0 / tc) * _kappa("RW", 0.0, h, m, averaged)
    if kind == "QN":
        return -0.5 * h if averaged else np.zeros_like(h)
    if kind == "WN":
        return (h**3 - h) / 12.0 if averaged else -0.5 * h
    if kind == "RW":
        return -(h**5 / 240.0 - h**3 / 48.0 + h / 60.0) if averaged else (h**3 - h) / 12.0
    phi = np.exp(-1.0 / tc)
    one_minus = -np.expm1(-1.0 / tc)
    c1, c2 = 0.5 * (1.0 + phi) / one_minus, phi / one_minus**2
    if not averaged:
        return -(c1 * h + c2 * np.expm1(-h / tc))
    tail = c2 * phi / one_minus**2 * np.exp(-h / tc)
    return c1 * (h**3 - h) / 6.0 + tail + c2 * (0.5 + phi / one_minus) * h


#: Autocorrelations of the difference filters (1, -2, 1) and (1, -3, 3, -1), from lag 0.
_DIFFERENCE = {2: (6.0, -4.0, 1.0), 3: (20.0, -15.0, 6.0, -1.0)}


def _component_covariance(kind: str, tc: float, tau: Array, m: float, order: int = 2, averaged: bool = False) -> Array:
    """Autocovariance at lags ``tau`` of ``order``-th differences of step ``m`` of the running sum, over 4 m^2.

    Without the single lags at which quantization noise (not averaged) contributes; :data:`_DIFFERENCE` holds those.
    """
    if kind == "QN" and not averaged:
        return np.zeros_like(tau)
    weights = _DIFFERENCE[order]
    total = weights[0] * _kappa(kind, tc, tau, m, averaged)
    for k, weight in enumerate(weights[1:], start=1):
        total = total + weight * (
            _kappa(kind, tc, tau + k * m, m, averaged) + _kappa(kind, tc, np.abs(tau - k * m), m, averaged)
        )
    if kind != "GM" or m < 1e-3 * tc:
        total = np.where(tau < order * m, total, 0.0)  # exactly zero there: remove what rounding leaves
    sign = -1.0 if averaged else 1.0
    return (sign if order == 2 or not averaged else -sign) * total / (4.0 * m * m)


def _components(n_samples: int) -> list[tuple[str, float]]:
    markov = [("GM", float(2.0**k)) for k in np.arange(0.0, np.log2(max(n_samples, 4)) - 0.5)]
    return [("QN", 0.0), ("WN", 0.0), *markov, ("RW", 0.0)]


def component_variance(kind: str, tc: float, m: Array) -> Array:
    """Haar wavelet variance of a unit component at averages of ``m`` samples."""
    if kind == "QN":
        return 1.5 / m**2
    if kind == "DR":
        return 0.25 * m**2
    zero = np.zeros(1)
    return np.array([_component_covariance(kind, tc, zero, float(k))[0] for k in m])


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
    basis = np.column_stack([component_variance(kind, tc, m[use]) for kind, tc in names])
    spread = np.sqrt(2.0 / eta3(2.0 * m[use], n_samples))
    target = value[use]
    level = target.copy()
    weights = np.zeros(len(names))
    for _ in range(4):  # re-weighting by the fitted level keeps a low estimate at a long scale from ruling the fit
        scale = 1.0 / (spread * level)
        norm = np.linalg.norm(basis * scale[:, None], axis=0)
        solution, _ = nnls(basis * scale[:, None] / norm, target * scale)
        weights = solution / norm
        level = np.maximum(basis @ weights, 1e-3 * target)
    return [(kind, tc, float(w)) for (kind, tc), w in zip(names, weights, strict=True) if w > 0]


def _nodes(m: int, last: int, longest: float, order: int, stride: int) -> Array:
    """Lags at which a coefficient's autocovariance is evaluated: dense at its corners 0, m, 2m.., geometric towards and beyond them."""
    end = min(last, int(order * m + 12 * longest))
    if end // stride <= 256:
        return np.arange(0, end + 1, stride, dtype=float)
    reach = np.unique(np.round(np.concatenate([[0, 1, 2], 1.35 ** np.arange(4.0, np.log(end) / np.log(1.35) + 1)])))
    body = np.linspace(0, order * m, 48 * order + 1).round()
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
    for index, scale in enumerate(np.asarray(scale_samples, dtype=np.int64)):
        m = int(scale) // 2
        step = 1 if stride is None else int(stride[index])
        span = n_samples + 1 - order * m
        count = max((span - 1) // step + 1, 1)
        longest = max((tc for kind, tc, _ in parts if kind == "GM"), default=0.0)
        tau = _nodes(m, (count - 1) * step, longest, order, step)
        smooth = np.zeros_like(tau)
        for kind, tc, weight in parts:
            smooth += weight * _component_covariance(kind, tc, tau, float(m), order, averaged)
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
