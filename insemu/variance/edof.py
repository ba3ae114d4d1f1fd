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


def _markov_kappa(h: Array, tc: float) -> Array:
    """Generalized covariance of the running sum of a unit-variance AR(1) with time constant ``tc`` samples (linear part included)."""
    phi = np.exp(-1.0 / tc)
    one_minus = -np.expm1(-1.0 / tc)
    return -(0.5 * (1.0 + phi) / one_minus * h + phi / one_minus**2 * np.expm1(-h / tc))


def _fourth_difference(kappa: Array, m: float) -> Array:
    """Covariance of coefficients from ``kappa`` at (tau - 2m, tau - m, tau, tau + m, tau + 2m) along the first axis."""
    return (6.0 * kappa[2] - 4.0 * (kappa[1] + kappa[3]) + kappa[0] + kappa[4]) / (4.0 * m * m)


def _component_covariance(kind: str, tc: float, tau: Array, m: float) -> Array:
    """Autocovariance at lags ``tau`` of the Haar coefficients of a unit component, averages of ``m`` samples (without the QN deltas)."""
    if kind == "QN":
        return np.zeros_like(tau)
    h = np.abs(tau[None, :] + m * np.arange(-2.0, 3.0)[:, None])
    if kind == "WN":
        return np.where(tau < 2 * m, _fourth_difference(-0.5 * h, m), 0.0)
    if kind == "RW" or m < 1e-3 * tc:
        scale = 1.0 if kind == "RW" else -np.expm1(-2.0 / tc)
        return np.where(tau < 2 * m, scale * _fourth_difference((h**3 - h) / 12.0, m), 0.0)
    return _fourth_difference(_markov_kappa(h, tc), m)


_QN_DELTAS = (6.0, -4.0, 1.0)


def _components(n_samples: int) -> list[tuple[str, float]]:
    markov = [("GM", float(2.0**k)) for k in np.arange(0.0, np.log2(max(n_samples, 4)) - 0.5)]
    return [("QN", 0.0), ("WN", 0.0), *markov, ("RW", 0.0)]


def _component_variance(kind: str, tc: float, m: Array) -> Array:
    """Haar wavelet variance of a unit component at averages of ``m`` samples."""
    zero = np.zeros(1)
    if kind == "QN":
        return 1.5 / m**2
    return np.array([_component_covariance(kind, tc, zero, float(k))[0] for k in m])


def noise_type(scale_samples: Array, value: Array, n_samples: int) -> list[tuple[str, float, float]]:
    """Return ``(kind, time constant in samples, weight)`` of the non-negative sum of noises that follows the curve.

    The weights are of unit components per sample (variances); it is a description of the shape, not a fitted sensor model.
    """
    m = np.asarray(scale_samples, dtype=float) / 2.0
    use = value > 0
    if not use.any():
        return []
    names = _components(n_samples)
    basis = np.column_stack([_component_variance(kind, tc, m[use]) for kind, tc in names])
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


def _nodes(m: int, last: int, longest: float) -> Array:
    """Lags at which a coefficient's autocovariance is evaluated: dense at its corners 0, m, 2m, geometric towards and beyond them."""
    end = min(last, int(2 * m + 12 * longest))
    if end <= 256:
        return np.arange(end + 1, dtype=float)
    reach = np.unique(np.round(np.concatenate([[0, 1, 2], 1.35 ** np.arange(4.0, np.log(end) / np.log(1.35) + 1)])))
    body = np.linspace(0, 2 * m, 97).round()
    nodes = np.concatenate([c + s * reach for c in (0, m, 2 * m) for s in (-1, 1)] + [body, [end]])
    return np.unique(nodes[(nodes >= 0) & (nodes <= end)])


def edof_of_noise(parts: list[tuple[str, float, float]], scale_samples: Array, n_samples: int) -> Array:
    """Equivalent degrees of freedom of the Haar MODWT wavelet variance of a sum of unit components (:func:`noise_type`)."""
    out = np.empty(len(scale_samples))
    for index, scale in enumerate(np.asarray(scale_samples, dtype=np.int64)):
        m = int(scale) // 2
        count = n_samples - int(scale) + 1
        longest = max((tc for kind, tc, _ in parts if kind == "GM"), default=0.0)
        tau = _nodes(m, count - 1, longest)
        smooth = np.zeros_like(tau)
        for kind, tc, weight in parts:
            smooth += weight * _component_covariance(kind, tc, tau, float(m))
        quantization = sum(weight for kind, _, weight in parts if kind == "QN") / (4.0 * m * m)
        share = 1.0 - tau / count
        terms = share * smooth**2
        # sum over integers of a function that is linear between nodes, both signs of the lag
        gaps = np.diff(tau)
        total = 2.0 * (np.sum(0.5 * gaps * (terms[1:] + terms[:-1])) + 0.5 * (terms[0] + terms[-1])) - terms[0]
        variance = smooth[0]
        if quantization > 0:
            for k, delta in enumerate(_QN_DELTAS):
                if k * m > count - 1:
                    break
                at = np.searchsorted(tau, k * m)
                d = delta * quantization
                total += (1.0 if k == 0 else 2.0) * share[at] * ((smooth[at] + d) ** 2 - smooth[at] ** 2)
            variance += _QN_DELTAS[0] * quantization
        out[index] = variance**2 * count / total if total > 0 else 1.0
    return np.maximum(out, 1.0)
