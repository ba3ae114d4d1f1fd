"""Where a static log and a model disagree: calibrated p-values per axis, time scale and kind of departure.

Every statistic is built to be standard under the model (chi-square or normal); the caller corrects for how many were looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from insemu.gap import kernel
from insemu.gap.candidates import AxisState
from insemu.gap.evidence import Explanation
from insemu.gap.reduced import BINS_PER_OCTAVE, Reduced
from insemu.gap.singular import lattice, whitened
from insemu.gap.verdict import Where

Array = NDArray[np.float64]

#: Simulated draws of the slow scales; segments of the test of stationarity.
DRAWS, SEGMENTS = 1000, 16
#: Statistic, sensor, axis, scale in s, p-value.
Entry = tuple[str, str, str, float | None, float]
#: Half the width of a bin of the spectrum over its frequency.
BIN_HALF = 0.5 * (2.0 ** (1.0 / BINS_PER_OCTAVE) - 1.0)


def block_innovations(data: Reduced, explanation: Explanation, extra: Array | None = None) -> Array:
    """Whitened block differences: standard normal and independent where the explanation is right."""
    y = data.differences if extra is None else data.differences - extra
    out = np.empty((y.size, 1))
    kernel.toeplitz_whiten(explanation.covariance(data.block, data.dt, y.size), np.ascontiguousarray(y[:, None]), out)
    return out[:, 0]


def wavelet_p_values(
    data: Reduced, explanation: Explanation, rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    """Haar wavelet variance of the log against the model's, scale by scale.

    Returns
    -------
    list of (scale s, measured, expected, two-sided p-value)
    """
    return [
        (scale, measured, expected, _chi_square_p(measured, expected, variance))
        for scale, measured, expected, variance in wavelet_moments(data, explanation, rng)
    ]


def wavelet_moments(
    data: Reduced, explanation: Explanation, rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    """Haar wavelet variance of the log, and its mean and variance under the model, scale by scale.

    Scales below a block by the sampling variance that the spectrum implies; above, against 1,000 simulated logs (block means drawn with
    the model's covariance).

    Returns
    -------
    list of (scale s, measured, expected, variance of the estimate)
    """
    out = []
    y, dt = data.values, data.dt
    total = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    m = 1
    f = (np.arange(8192) + 0.5) / 8192 * 0.5 / dt
    known = level_variance(data, explanation)
    while m < data.block:
        half = total[m:] - total[:-m]
        w = (half[m:] - half[:-m]) / (2.0 * m)
        measured = float(np.mean(w * w))
        # finer at low frequency: integrate in log f
        lf = np.concatenate([np.geomspace(1e-4 / (m * dt), f[0], 400)[:-1], f]) if m > 16 else f
        S = explanation.psd(lf, dt)
        x = np.pi * lf * dt
        gain = np.sin(m * x) ** 4 / (m * np.sin(x)) ** 2
        expected = 2.0 * float(np.trapezoid(S * gain, lf))
        spread = 2.0 * float(np.trapezoid((S * gain) ** 2, lf)) * 2.0 / (w.size * dt)
        # the level was fitted to the same samples, and what all scales share of it is spent
        spread -= min(known * expected**2, 0.9 * spread)
        out.append((2.0 * m * dt, measured, expected, spread))
        m *= 2
    gamma = explanation.covariance(data.block, dt, data.differences.size)
    draws = _draw(gamma, DRAWS, rng)
    paths = np.concatenate([np.zeros((DRAWS, 1)), np.cumsum(draws, axis=1)], axis=1)
    own = np.concatenate([[0.0], np.cumsum(data.differences)])
    span = 1
    while 2 * span <= own.size // 4:
        measured = float(_haar(own[None, :], span)[0])
        simulated = _haar(paths, span)
        out.append((2.0 * span * data.block_s, measured, float(simulated.mean()), float(simulated.var())))
        span *= 2
    return out


def level_variance(data: Reduced, explanation: Explanation) -> float:
    """Sampling variance of the common level of the spectrum, relative, where the explanation follows it; 0 where its tolerance holds it back."""
    total = float(np.sum(data.dof))
    if not total or explanation.rolloff is not None:
        return 0.0
    level = float(data.dof @ (data.power / explanation.psd(data.f, data.dt))) / total
    return 2.0 / total if abs(level - 1.0) < 2.0 * math.sqrt(2.0 / total) else 0.0


def _haar(paths: Array, span: int) -> Array:
    total = np.concatenate([np.zeros((paths.shape[0], 1)), np.cumsum(paths, axis=1)], axis=1)
    half = total[:, span:] - total[:, :-span]
    w = (half[:, span:] - half[:, :-span]) / (2.0 * span)
    return np.asarray(np.mean(w * w, axis=1))


def _draw(gamma: Array, count: int, rng: np.random.Generator) -> Array:
    from scipy.linalg import cholesky, toeplitz

    lower = cholesky(toeplitz(gamma) + np.eye(gamma.size) * (1e-12 * gamma[0]), lower=True)
    return np.asarray((lower @ rng.standard_normal((gamma.size, count))).T)


def _chi_square_p(value: float, mean: float, variance: float) -> float:
    dof = 2.0 * mean**2 / variance
    x = value / mean * dof
    return float(min(1.0, 2.0 * min(stats.chi2.cdf(x, dof), stats.chi2.sf(x, dof))))


def axis_tests(state: AxisState) -> list[tuple[str, float | None, float]]:
    """Tests of one axis against its current explanation: ``(statistic, scale s, p-value)``."""
    data, explanation = state.data, state.explanation
    extra = None
    if explanation.regressors:
        mean, _ = state.likelihood.coefficients(explanation)
        extra = np.hstack([r.columns for r in explanation.regressors]) @ mean
    e = block_innovations(data, explanation, extra)
    n = e.size
    out: list[tuple[str, float | None, float]] = []
    lags = np.arange(1, min(20, n // 5) + 1)
    rho = np.array([float(np.mean(e[k:] * e[:-k])) for k in lags]) / float(np.mean(e * e))
    out.append(("whiteness", data.block_s, float(stats.chi2.sf(np.sum(rho**2 * (n - lags)), lags.size))))
    out.append(("variance", data.block_s, two_sided(float(np.sum(e * e)), n)))
    out.append(("distribution", data.block_s, float(stats.kurtosistest(e).pvalue)))
    size = np.abs(e) - np.mean(np.abs(e))
    out.append(("volatility", data.block_s, correlation_p(size[1:], size[:-1])))
    if data.f.size:
        # a bin is held against the density at its centre: only where that is nearly even over the bin
        slope = explanation.psd(data.f * (1.0 - BIN_HALF), data.dt) / explanation.psd(
            np.minimum(data.f * (1.0 + BIN_HALF), 0.499 / data.dt), data.dt
        )
        even = np.flatnonzero(np.abs(np.log(slope)) < 0.2)
        ratio = explanation.seen(data) / explanation.psd(data.f, data.dt)
        groups = [g for g in np.array_split(even, min(32, max(even.size, 1))) if g.size]
        z = np.array(
            [
                (np.sum(data.dof[g] * ratio[g]) / np.sum(data.dof[g]) - 1.0) * math.sqrt(np.sum(data.dof[g]) / 2.0)
                for g in groups
            ]
        )
        out.append(("spectrum", None, float(stats.chi2.sf(float(z @ z), z.size))))
        r = whitened(state)
        out += _stationarity(r, data)
        if lattice(data.values) == 0.0:
            kurtosis = float(np.mean(r**4) / np.mean(r * r) ** 2 - 3.0)
            out.append(("tails", data.dt, float(2.0 * stats.norm.sf(abs(kurtosis) / math.sqrt(24.0 / r.size)))))
    if state.temperature is not None:
        steps = np.diff(state.temperature[: (n + 1) * data.block].reshape(n + 1, data.block).mean(axis=1))
        if np.std(steps) > 0:
            out.append(("temperature", data.block_s, correlation_p(steps, e)))
    t = np.linspace(-1.0, 1.0, n)
    out.append(
        (
            "time",
            data.duration_s,
            float(
                2.0 * stats.norm.sf(abs(float(np.sum(t * (e * e - np.mean(e * e))))) / math.sqrt(2.0 * np.sum(t * t)))
            ),
        )
    )
    return out


def two_sided(x: float, dof: float) -> float:
    """Two-sided p-value of a chi-square."""
    return float(min(1.0, 2.0 * min(stats.chi2.cdf(x, dof), stats.chi2.sf(x, dof))))


def correlation_p(a: Array, b: Array) -> float:
    """p-value of the correlation of two signals (Fisher's transform); 1 where one does not vary."""
    if np.std(a) == 0 or np.std(b) == 0:
        return 1.0
    r = float(np.corrcoef(a, b)[0, 1])
    return float(2.0 * stats.norm.sf(abs(math.atanh(min(abs(r), 0.999999))) * math.sqrt(a.size - 3)))


def _stationarity(r: Array, data: Reduced) -> list[tuple[str, float | None, float]]:
    """Power of the whitened samples by segment and band: the same in every segment where the noise is stationary.

    Bands are eighths of an octave-like grid in frequency, so that a line that sweeps shows although its mean spectrum is smooth.
    """
    length = r.size // SEGMENTS
    spectra = (
        np.abs(np.fft.rfft(r[: SEGMENTS * length].reshape(SEGMENTS, length), axis=1)[:, 1 : length // 2]) ** 2 / length
    )
    f = np.arange(1, length // 2) / (length * data.dt)
    keep = f >= 2.0 * data.f[0]
    spectra, f = spectra[:, keep], f[keep]
    if f.size < 64:
        return []
    edges = np.unique(np.round(np.geomspace(8, f.size, 25)).astype(int))
    edges = np.concatenate([[0], edges])
    z2, count, loud = 0.0, 0, 0.0
    for a, b in pairwise(edges):
        power = spectra[:, a:b].mean(axis=1)
        # the cube root of a chi-square is nearly normal (Wilson and Hilferty)
        dof = 2.0 * (b - a)
        x = (power / power.mean()) ** (1.0 / 3.0)
        z = (x - (1.0 - 2.0 / (9.0 * dof))) / math.sqrt(2.0 / (9.0 * dof))
        z -= z.mean()
        z2 += float(z @ z)
        count += SEGMENTS - 1
        loud = max(loud, float(np.max(np.abs(z))))
    total = spectra.sum(axis=1)
    dof = 2.0 * spectra.shape[1]
    zt = (total / total.mean() - 1.0) * math.sqrt(dof / 2.0)
    return [
        ("stationarity", length * data.dt, float(stats.chi2.sf(z2, count))),
        ("noise level over time", length * data.dt, float(stats.chi2.sf(float(zt @ zt), SEGMENTS - 1))),
    ]


def drifting_spectrum(state: AxisState) -> float:
    """p-value of the whitened samples having the same spectrum in every sixteenth of the log."""
    return next((p for name, _, p in _stationarity(whitened(state), state.data) if name == "stationarity"), 1.0)


def cross_axis_tests(states: Mapping[str, AxisState]) -> list[tuple[str, str, float]]:
    """Correlation of the whitened samples of every pair of axes: ``(first axis, second axis, p-value)``."""
    names = list(states)
    out = []
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            one, two = whitened(states[a]), whitened(states[b])
            if one.size == two.size:
                out.append((a, b, correlation_p(one, two)))
    return out


def corrected(entries: list[Entry]) -> tuple[Where, ...]:
    """Holm's correction over everything that was looked at; most significant first."""
    order = sorted(range(len(entries)), key=lambda k: entries[k][4])
    out, worst = [], 0.0
    for rank, k in enumerate(order):
        statistic, sensor, axis, scale, p = entries[k]
        worst = min(1.0, max(worst, p * (len(entries) - rank)))
        out.append(Where(statistic, sensor, axis, scale, worst))
    return tuple(out)
