"""Where a static log and a model disagree: calibrated p-values per axis, time scale and kind of departure.

Every statistic is built to be standard under the model (chi-square or normal); the caller corrects for how many were looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.candidates.axis import AxisState, whitened
from insemu.gap.data.counts import lattice
from insemu.gap.data.log import BINS_PER_OCTAVE, Reduced, overlap
from insemu.gap.evidence import kernels
from insemu.gap.evidence.model import Explanation
from insemu.gap.policy import rules
from insemu.gap.verdict import Where

Array = NDArray[np.float64]

#: Simulated draws of the slow scales; segments of the test of stationarity.
DRAWS, SEGMENTS = 1000, 16
#: Statistic, sensor, axis, scale in s, p-value.
Entry = tuple[str, str, str, float | None, float]
#: Half the width of a bin of the spectrum over its frequency.
BIN_HALF = 0.5 * (2.0 ** (1.0 / BINS_PER_OCTAVE) - 1.0)


def block_innovations(data: Reduced, explanation: Explanation, extra: Array | None = None) -> Array:
    """Whitened block differences: standard normal and independent where the explanation is right.

    Parameters
    ----------
    data : Reduced
        The axis.
    explanation : Explanation
        Its processes give the covariance of the differences.
    extra : (blocks - 1,) array, optional
        Taken off the differences first, unit of the axis.

    Returns
    -------
    (blocks - 1,) array
    """
    y = data.differences if extra is None else data.differences - extra
    out = np.empty((y.size, 1))
    kernels.toeplitz_whiten(explanation.covariance(data.block, data.dt, y.size), np.ascontiguousarray(y[:, None]), out)
    return out[:, 0]


def innovations_of(state: AxisState) -> Array:
    """:func:`block_innovations` of an axis under its current explanation, known shapes taken off."""
    extra = None
    if state.explanation.regressors:
        mean, _ = state.likelihood.coefficients(state.explanation)
        extra = np.hstack([r.columns for r in state.explanation.regressors]) @ mean
    return block_innovations(state.data, state.explanation, extra)


def wavelet_p_values(
    data: Reduced, explanation: Explanation, rng: np.random.Generator, spent: Array | None = None
) -> list[tuple[float, float, float, float]]:
    """Haar wavelet variance of the log against the model's, scale by scale; see :func:`wavelet_moments`.

    Parameters
    ----------
    data : Reduced
        The axis.
    explanation : Explanation
        The model.
    rng : Generator
        For simulated logs, at scales above a block.
    spent : (k, k) array, optional
        Covariance of the logarithms of the free parameters where they were fitted to the same log.

    Returns
    -------
    list of (scale s, measured, expected, two-sided p-value)
    """
    return [
        (scale, measured, expected, chi_square_p(measured, expected, variance))
        for scale, measured, expected, variance in wavelet_moments(data, explanation, rng, spent)
    ]


def wavelet_moments(
    data: Reduced, explanation: Explanation, rng: np.random.Generator, spent: Array | None = None
) -> list[tuple[float, float, float, float]]:
    """Haar wavelet variance of the log, and its mean and variance under the model, scale by scale.

    Scales below a block by the sampling variance that the spectrum implies; above, against 1,000 simulated logs (block means drawn with
    the model's covariance).

    Parameters
    ----------
    spent : (k, k) array, optional
        Covariance of the logarithms of the free parameters where they were fitted to the same log: what the fit follows of the log's own
        fluctuations no statistic shows any more. ``None``: the model comes from elsewhere.

    Returns
    -------
    list of (scale s, measured, expected, variance of the estimate)
    """
    out = []
    y, dt = data.values, data.dt
    total = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    m = 1
    # even at high frequency, finer in log f below
    f = (np.arange(8192) + 0.5) / 8192 * 0.5 / dt
    f = np.concatenate([np.geomspace(1e-4 / (data.block * dt), f[0], 800)[:-1], f])
    S, slopes = _with_slopes(explanation, lambda e: e.psd(f, dt), spent)
    # a spectrum by tapers is less precise than the samples: of the fit's own error only a part goes with the statistic's
    share = 2.0 / overlap(y.size) - 1.0
    x = np.pi * f * dt
    while m < data.block:
        half = total[m:] - total[:-m]
        w = (half[m:] - half[:-m]) / (2.0 * m)
        gain = np.sin(m * x) ** 4 / (m * np.sin(x)) ** 2
        expected = 2.0 * float(np.trapezoid(S * gain, f))
        spread = 2.0 * float(np.trapezoid((S * gain) ** 2, f)) * 2.0 / (w.size * dt)
        g = 2.0 * np.trapezoid(slopes * gain, f, axis=1)
        out.append((2.0 * m * dt, float(np.mean(w * w)), expected, residual_variance(spread, share, g, spent)))
        m *= 2
    gamma, slopes = _with_slopes(explanation, lambda e: e.covariance(data.block, dt, data.differences.size), spent)
    draws = _draw(gamma, DRAWS, rng)
    paths = np.concatenate([np.zeros((DRAWS, 1)), np.cumsum(draws, axis=1)], axis=1)
    own = np.concatenate([[0.0], np.cumsum(data.differences)])
    span = 1
    while 2 * span <= own.size // 4:
        measured = float(_haar(own[None, :], span)[0])
        # a coefficient is a triangular mean of differences
        triangle = np.convolve(np.ones(span), np.ones(span)) / (2.0 * span)
        lags = np.correlate(triangle, triangle, "full")[triangle.size - 1 :]
        lags[1:] *= 2.0
        expected, g = float(gamma[: lags.size] @ lags), slopes[:, : lags.size] @ lags
        variance = float(_haar(paths, span).var())
        out.append((2.0 * span * data.block_s, measured, expected, residual_variance(variance, 1.0, g, spent)))
        span *= 2
    return out


def spent_on(state: AxisState) -> Array:
    """Covariance (k, k) of the logarithms of the free parameters, as far as they follow the log's own fluctuations.

    That of the likelihood alone, less what the borders of the tolerance cut off: a level that is held back there leaves the rest of the
    fluctuation to the statistics (truth anywhere inside the tolerance).
    """
    data, explanation = state.data, state.explanation
    free, everything = explanation.free, np.eye(len(explanation.free))
    if not free:
        return everything
    # expected and not observed curvature: one that goes with the estimate itself would make small variances where the statistic is far off
    information = np.zeros_like(everything)
    if data.f.size:
        S, slopes = _with_slopes(explanation, lambda e: e.psd(data.f, data.dt), everything)
        information += 0.5 * (slopes / S * data.counted) @ (slopes / S).T
    n = data.differences.size
    gamma, slopes = _with_slopes(explanation, lambda e: e.covariance(data.block, data.dt, n), everything)
    factor = scipy.linalg.cho_factor(scipy.linalg.toeplitz(gamma))
    parts = [scipy.linalg.cho_solve(factor, scipy.linalg.toeplitz(g)) for g in slopes]
    information += 0.5 * np.array([[float(np.sum(a * b.T)) for b in parts] for a in parts])
    values, vectors = np.linalg.eigh(information)
    covariance = (vectors / np.maximum(values, 1.0)) @ vectors.T
    kept = np.sqrt(
        [followed(float(v), 0.5 * math.log(f.high / f.low)) for v, f in zip(np.diag(covariance), free, strict=True)]
    )
    return np.asarray(kept[:, None] * covariance * kept[None, :])


def followed(variance: float, half: float) -> float:
    """Share of an estimate's variance that is left where it is clipped to ``half`` either way of the nominal value, truth uniform inside."""
    sd = math.sqrt(variance)
    x = np.linspace(half, half + 6.0 * sd, 400)
    density = (scipy.stats.norm.cdf((x + half) / sd) - scipy.stats.norm.cdf((x - half) / sd)) / (2.0 * half)
    return max(1.0 - 2.0 * float(np.trapezoid((x - half) ** 2 * density, x)) / variance, 0.0)


#: Finding of a derivative by the logarithm of a parameter.
STEP = 1e-3


def _with_slopes(
    explanation: Explanation, of: Callable[[Explanation], Array], spent: Array | None
) -> tuple[Array, Array]:
    """A curve (n,) of an explanation and its derivatives (k, n) by the logarithms of the free parameters; none where none was fitted."""
    value = of(explanation)
    if spent is None or not spent.size:
        return value, np.zeros((0, value.size))
    x = explanation.start()
    steps = np.eye(x.size) * STEP
    return value, np.stack([(of(explanation.at(x + h)) - of(explanation.at(x - h))) / (2.0 * STEP) for h in steps])


def residual_variance(variance: float, share: float, slope: Array, spent: Array | None) -> float:
    """Variance of a statistic about its value under a model that was fitted to the same data.

    An efficient estimate's error is uncorrelated with what is left, so the statistic's own variance falls by what the parameters'
    uncertainty makes of it (``share`` of it where the estimate is less than efficient).

    Parameters
    ----------
    variance : float
        Of the statistic under a model that was not fitted to these data.
    share : float
        Efficiency of the estimate, 1 at most.
    slope : (k,) array
        Derivatives of the expected statistic by the logarithms of the free parameters.
    spent : (k, k) array, optional
        Covariance of these logarithms; without it the variance is returned as it is.
    """
    if spent is None or not slope.size:
        return variance
    return max(variance - share * float(slope @ spent @ slope), rules().statistic_left * variance)


def _haar(paths: Array, span: int) -> Array:
    total = np.concatenate([np.zeros((paths.shape[0], 1)), np.cumsum(paths, axis=1)], axis=1)
    half = total[:, span:] - total[:, :-span]
    w = (half[:, span:] - half[:, :-span]) / (2.0 * span)
    return np.asarray(np.mean(w * w, axis=1))


def _draw(gamma: Array, count: int, rng: np.random.Generator) -> Array:
    lower = scipy.linalg.cholesky(scipy.linalg.toeplitz(gamma) + np.eye(gamma.size) * (1e-12 * gamma[0]), lower=True)
    return np.asarray((lower @ rng.standard_normal((gamma.size, count))).T)


def chi_square_p(value: float, mean: float, variance: float) -> float:
    """Two-sided p-value of a statistic that is a chi-square of this mean and variance but for a factor.

    Parameters
    ----------
    value : float
        The statistic.
    mean, variance : float
        Of the statistic under the model, in its own unit.
    """
    dof = 2.0 * mean**2 / variance
    x = value / mean * dof
    return float(min(1.0, 2.0 * min(scipy.stats.chi2.cdf(x, dof), scipy.stats.chi2.sf(x, dof))))


def axis_tests(state: AxisState, spent: Array | None = None) -> list[tuple[str, float | None, float]]:
    """Tests of one axis against its current explanation: ``(statistic, scale s, p-value)``; ``spent`` as :func:`spent_on` says."""
    spent = spent_on(state) if spent is None else spent
    data, explanation = state.data, state.explanation
    e = innovations_of(state)
    n = e.size
    out: list[tuple[str, float | None, float]] = []
    lags = np.arange(1, min(20, n // 5) + 1)
    rho = np.array([float(np.mean(e[k:] * e[:-k])) for k in lags]) / float(np.mean(e * e))
    out.append(("whiteness", data.block_s, float(scipy.stats.chi2.sf(np.sum(rho**2 * (n - lags)), lags.size))))
    out.append(("variance", data.block_s, chi_square_p(float(np.sum(e * e)), n, _residual_volume(state, n, spent))))
    out.append(("distribution", data.block_s, float(scipy.stats.kurtosistest(e).pvalue)))
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
        out.append(("spectrum", None, _spectrum_p(state, groups, z, spent)))
        r = whitened(state)
        out += _stationarity(r, data)
        if lattice(data.values) == 0.0:
            kurtosis = float(np.mean(r**4) / np.mean(r * r) ** 2 - 3.0)
            out.append(("tails", data.dt, float(2.0 * scipy.stats.norm.sf(abs(kurtosis) / math.sqrt(24.0 / r.size)))))
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
                2.0
                * scipy.stats.norm.sf(abs(float(np.sum(t * (e * e - np.mean(e * e))))) / math.sqrt(2.0 * np.sum(t * t)))
            ),
        )
    )
    return out


def _residual_volume(state: AxisState, n: int, spent: Array) -> float:
    """Variance of the sum of ``n`` squared block innovations about ``n``, less what the fitted parameters follow of it.

    Its covariance with the score of a parameter is the derivative of the covariance's log determinant.
    """
    data, h = state.data, STEP
    white, zero = np.empty((n, 1)), np.zeros((n, 1))
    x = state.explanation.start()
    if not x.size:
        return 2.0 * n

    def volume(at: Array) -> float:
        return float(kernels.toeplitz_whiten(state.explanation.at(at).covariance(data.block, data.dt, n), zero, white))

    slope = np.array([(volume(x + e) - volume(x - e)) / (2.0 * h) for e in np.eye(x.size) * h])
    return residual_variance(2.0 * n, 1.0, slope, spent)


def _spectrum_p(state: AxisState, groups: list[NDArray[np.intp]], z: Array, spent: Array) -> float:
    """p-value of standardised mean ratios of measured to fitted density in groups of bins, less what the fit follows of them."""
    data = state.data
    S, slopes = _with_slopes(state.explanation, lambda e: e.psd(data.f, data.dt), spent)
    cov = np.eye(z.size)
    if slopes.size and data.weight is None:
        J = np.stack(
            [
                (slopes / S)[:, g] @ data.dof[g] / np.sum(data.dof[g]) * math.sqrt(float(np.sum(data.dof[g])) / 2.0)
                for g in groups
            ]
        )
        cov -= J @ spent @ J.T
    values, vectors = np.linalg.eigh(cov)
    kept = values > rules().statistic_left
    return float(scipy.stats.chi2.sf(float(np.sum((vectors[:, kept].T @ z) ** 2 / values[kept])), int(kept.sum())))


def correlation_p(a: Array, b: Array) -> float:
    """p-value of the correlation of two signals (Fisher's transform); 1 where one does not vary."""
    if np.std(a) == 0 or np.std(b) == 0:
        return 1.0
    r = float(np.corrcoef(a, b)[0, 1])
    return float(2.0 * scipy.stats.norm.sf(abs(math.atanh(min(abs(r), 0.999999))) * math.sqrt(a.size - 3)))


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
        ("stationarity", length * data.dt, float(scipy.stats.chi2.sf(z2, count))),
        ("noise level over time", length * data.dt, float(scipy.stats.chi2.sf(float(zt @ zt), SEGMENTS - 1))),
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
