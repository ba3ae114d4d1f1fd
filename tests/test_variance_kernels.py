"""Compiled sums of this room against the same sums written out: matrices of all pairs, plain differences. Short enough to run uncompiled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from insemu import variance as v
from insemu.noise import AR1, GM, QN, RW, WN
from insemu.variance import _covariance_kernel, _gaps_kernel, _kernel, allan, edof, filtered, gaps
from tests.pins import numbers

Array = NDArray[np.float64]


def _second(s: Array, m: int, every: int = 1) -> Array:
    """Second differences of step m of a running sum."""
    return np.asarray(s[2 * m :] - 2.0 * s[m:-m] + s[: -2 * m])[::every]


# --------------------------------------------------------------------------------------------------------------- the pyramid


@pytest.mark.parametrize(
    ("n", "full"),
    [
        (5, 1 << 20),
        (2047, 1 << 20),
        (2048, 1 << 20),
        (9000, 1 << 20),
        (36_000, 1 << 20),
        (21_000, 4096),
        (17_000, 8192),
    ],
)
def test_the_pyramid_sums_squares_of_plain_differences(n: int, full: int) -> None:
    """Of running sums; where a scale is longer than ``full``, of those on a grid of half a window to a scale."""
    x = numbers(n, 5) + 1e6
    levels = min(int(np.log2(n - 1)), 16)
    found = v.HaarAccumulator(levels, full)
    for piece in np.split(x, [n // 3, n // 3 + 1, n // 2]):
        found.push(piece)
    value, counts = found.result()
    np.testing.assert_array_equal(found.result()[0], value)
    s = np.cumsum(np.concatenate([[0.0], x - 1e6]))
    for j in range(levels):
        m = 1 << j
        every = 1 if 2 * m <= full else 2 * m // (full // 2)
        d = _second(s, m, every) / (2 * m)
        assert counts[j] == d.size
        np.testing.assert_allclose(value[j], np.mean(d**2), rtol=1e-9)
    assert value.size == levels
    assert v.HaarAccumulator(3, full)._most == 3


def test_differences_of_running_sums() -> None:
    x = numbers(60, 3)
    s = np.cumsum(np.concatenate([[0.0], x - x.mean()]))

    def found(kind: allan.Kind, m: int) -> float:
        return float(allan._values(x, np.array([m]), kind)[0])

    for m in (1, 2, 7, 19):
        d = s[3 * m :] - 3.0 * s[2 * m : -m] + 3.0 * s[m : -2 * m] - s[: -3 * m]
        for hadamard, plain, every in (("overlapping-hadamard", "overlapping", 1), ("hadamard", "non-overlapping", m)):
            np.testing.assert_allclose(found(hadamard, m), np.mean(d[::every] ** 2) / (6 * m**2))  # type: ignore[arg-type]
            np.testing.assert_allclose(found(plain, m), np.mean(_second(s, m, every) ** 2) / (2 * m**2))  # type: ignore[arg-type]
        averaged = np.convolve(_second(s, m), np.ones(m), "valid")
        np.testing.assert_allclose(found("modified", m), np.mean(averaged**2) / (2 * m**4))
    for m in (1, 2, 7, 19, 40, 58):
        ends = np.concatenate([2 * s[0] - s[60:0:-1], s, 2 * s[-1] - s[59::-1]])
        inner = ends[61 - m : 120 - m] - 2.0 * ends[61:120] + ends[61 + m : 120 + m]
        np.testing.assert_allclose(found("total", m), np.mean(inner**2) / (2 * m**2))


def test_small_sums() -> None:
    w, scale = np.array([0.5, -1.0, 3.0, 1.9, -2.0]), 0.25
    near = np.maximum(1.0 - w**2 * scale, 0.0) ** 2
    np.testing.assert_allclose(_kernel.biweight_sums(w, scale), [near.sum(), (near * w**2).sum()])
    a = numbers(20, 4)
    one, mean = np.empty(17), np.empty(17)
    _kernel.haar_coefficients_level(a, 3, one, mean)
    np.testing.assert_allclose(one, (a[3:] - a[:-3]) / 2.0)
    np.testing.assert_allclose(mean, (a[3:] + a[:-3]) / 2.0)
    # a flagged step between samples 5 and 6 touches every coefficient that reaches over it
    seen = (np.arange(20) > 5).astype(np.int64)
    for every in (1, 2):
        out = np.empty(17)
        kept = _kernel.untouched(one, seen, 4, every, out)
        whole = [k for k in range(0, 17, every) if not k <= 5 < k + 3]
        np.testing.assert_array_equal(out[:kept], one[whole])
    np.testing.assert_array_equal(_kernel.haar_counts(100, 6, 8), [99, 97, 93, 22, 9, 3])


# ------------------------------------------------------------------------------------------------------- covariances of curves


def test_the_covariance_of_haar_variances_is_the_sum_over_all_pairs() -> None:
    """Of Gaussian coefficients with a mean: 2 c^2 + 4 mean mean c over every pair."""
    n, slope = 21, 0.3
    s1 = 0.5 ** np.arange(n) - 0.2 * (np.arange(n) == 1)
    first = toeplitz(s1)
    maps = [np.eye(n)[1:]]  # coefficients of the first octave exist from sample 1 on
    for m in (1, 2, 4):
        a = maps[-1]
        maps.append(0.5 * (a[2 * m :] + 2.0 * a[m:-m] + a[: -2 * m]))
    means = 0.5 * slope * 2.0 ** np.arange(4)
    wanted = np.empty((4, 4))
    for j in range(4):
        for k in range(4):
            c = maps[j] @ first @ maps[k].T
            wanted[j, k] = np.mean(2.0 * c**2 + 4.0 * means[j] * means[k] * c)
    np.testing.assert_allclose(v.model_covariance(s1, drift_per_sample=slope), wanted, rtol=1e-12)
    np.testing.assert_allclose(v.model_covariance(s1, levels=2, n_samples=n, drift_per_sample=slope), wanted[:2, :2])
    value = np.array([3.0, 2.0, 1.0, 4.0])
    np.testing.assert_allclose(
        v.model_edof(s1, value, drift_per_sample=slope), 2.0 * value**2 / np.diag(wanted), rtol=1e-12
    )
    shorter = v.model_covariance(s1, n_samples=20)
    np.testing.assert_allclose(shorter[0, 0], np.mean(2.0 * toeplitz(s1[:19]) ** 2))


def test_the_covariance_of_a_signal_is_the_sum_over_all_lags() -> None:
    """Equation (17) of Stebler et al. 2014: products of sample cross-covariances of the coefficients."""
    x = numbers(50, 9)
    for name in ("haar", "d4"):
        w = v.wavelet_coefficients(x, filter=name, levels=3)
        found = v.wv_covariance(x, filter=name, levels=3)
        for j in range(3):
            for k in range(3):
                own = [np.correlate(c, c, "full") / c.size for c in (w[j], w[k])]
                half = min(own[0].size, own[1].size) // 2
                one, two = (a[a.size // 2 - half : a.size // 2 + half + 1] for a in own)
                np.testing.assert_allclose(found[j, k], np.sum(one * two) / max(w[j].size, w[k].size), rtol=1e-10)


def test_the_first_octave_of_white_noise_and_of_a_walk() -> None:
    white = np.array([0.5, -0.25, 0.0, 0.0, 0.0])
    delta = lambda k: (np.asarray(k) == 0).astype(float)  # noqa: E731
    np.testing.assert_allclose(v.level1_autocovariance(5, autocovariance=delta), white)
    np.testing.assert_allclose(v.level1_autocovariance(5, increments=delta), [0.25, 0, 0, 0, 0])
    # per Hz at 4 Hz: variance over the rate
    flat = v.level1_autocovariance(5, psd=lambda f: 0.0 * f + 0.25, rate_hz=4.0)
    np.testing.assert_allclose(flat, white, atol=1e-15)
    asked: list[Array] = []
    v.level1_autocovariance(5, psd=lambda f: (asked.append(f), 0.0 * f)[1], rate_hz=4.0)
    assert asked[0].min() > 0.0 and asked[0].max() < 2.0


# ------------------------------------------------------------------------------------------------- scatter of means of squares

PARTS = [("QN", 0.0, 0.3), ("WN", 0.0, 1.0), ("GM", 3.0, 0.7), ("RW", 0.0, 0.02)]


def _sequence(kind: str, tc: float, weights: Array, reach: int) -> Array:
    """Autocovariance at lags 0 .. reach of sums of a unit component with weights that add to zero."""
    lags = np.arange(reach + 1)
    if kind == "RW":  # steps of variance 1: each is seen by all samples behind it
        weights = np.cumsum(weights[::-1])[::-1]
    if kind == "QN":  # differences of white noise of variance 1
        weights = np.diff(np.concatenate([[0.0], weights, [0.0]]))
    if kind == "GM":
        a = np.arange(weights.size)
        inner = np.abs(lags[:, None, None] + a[:, None] - a)
        return np.asarray(np.einsum("a,b,kab->k", weights, weights, np.exp(-inner / tc)))
    both = np.correlate(weights, weights, "full")
    out = np.zeros(reach + 1)
    own = both[weights.size - 1 :][: reach + 1]
    out[: own.size] = own
    return out


def _weights(order: int, m: int, averaged: bool) -> Array:
    """Weights of samples in a difference of their running sum (of its sum once more), over 2 m."""
    taps = {2: [1.0, -2.0, 1.0], 3: [-1.0, 3.0, -3.0, 1.0]}[order]
    spread = np.zeros(order * m + 1)
    spread[::m] = taps
    w = np.cumsum(spread)[:-1]
    return (np.cumsum(w) if averaged else w) / (2.0 * m)


@pytest.mark.parametrize("kind", ["WN", "QN", "GM", "RW"])
def test_unit_components_have_the_variance_that_their_curve_says(kind: str) -> None:
    for m in (1, 2, 5):
        own = _sequence(kind, 3.0, _weights(2, m, False), 0)[0]
        np.testing.assert_allclose(edof.component_variance(kind, 3.0, np.array([float(m)])), own, rtol=1e-12)


@pytest.mark.parametrize(("order", "averaged"), [(2, False), (3, False), (3, True)])
@pytest.mark.parametrize("kind", ["WN", "QN", "GM", "RW", "slow GM"])
def test_autocovariances_of_differences_are_sums_over_samples(kind: str, order: int, averaged: bool) -> None:
    steps, n = [1, 2, 6], 24
    tc = 20_000.0 if kind == "slow GM" else 3.0
    lags = np.concatenate([np.arange(0.0, n)] * 3)
    out = np.empty(lags.size)
    number = {"QN": 0, "WN": 1, "GM": 2, "slow GM": 2, "RW": 3}[kind]
    taps = {2: [6.0, -4.0, 1.0], 3: [20.0, -15.0, 6.0, -1.0]}[order]
    ends = np.repeat([0, n, 2 * n, 3 * n], [1, 2, 2, 2])  # no grids for the third cumulant
    of = _covariance_kernel.Differences(np.array(steps), np.ones(3, np.int64), n, np.array(taps), lags, ends)
    _covariance_kernel.unit_covariances(number, tc, of, averaged, out)
    for j, m in enumerate(steps):
        wanted = _sequence(kind[-2:], tc, _weights(order, m, averaged), n - 1)
        if kind == "QN" and not averaged:
            wanted = np.zeros(n)  # single lags, which the sum over lags adds by itself
        atol = 1e-3 * abs(wanted[0]) if kind == "slow GM" else 1e-9 * max(wanted[0], 1.0)
        np.testing.assert_allclose(out[j * n : (j + 1) * n], wanted, atol=atol)


def _exact(parts: Any, order: int, averaged: bool, every: int, m: int, weights: list[float]) -> Array:
    """Covariance matrix of the terms of a mean of squares."""
    lags = every * ((N - order * m) // every)
    own = sum(
        w * _sequence(kind, tc, _weights(order, m, averaged), lags)
        for w, (kind, tc, _) in zip(weights, parts, strict=True)
    )
    return np.asarray(toeplitz(np.asarray(own)[::every]))


def _freedom(c: Array) -> float:
    return float(c.shape[0] ** 2 * c[0, 0] ** 2 / np.sum(c**2))


N, STEPS = 40, np.array([1, 2, 4])


@pytest.mark.parametrize("parts", [PARTS, PARTS[1:2], PARTS[:2], PARTS[2:]])
@pytest.mark.parametrize(
    ("order", "averaged", "apart"), [(2, False, False), (2, False, True), (3, False, False), (3, True, False)]
)
def test_scatter_is_that_of_the_quadratic_form(parts: Any, order: int, averaged: bool, apart: bool) -> None:
    """Variance and third cumulant of a mean of squares of Gaussian terms are traces of powers of their covariance matrix."""
    noise = edof.NoiseType(parts, np.zeros((len(parts), 0)))
    found = edof.scatter_of_noise(noise, 2 * STEPS, N, order=order, averaged=averaged, stride=STEPS if apart else None)
    lonely = "QN" in [p[0] for p in parts] and not averaged  # its single lags enter the variance alone
    for j, m in enumerate(STEPS):
        c = _exact(parts, order, averaged, int(m) if apart else 1, m, [w for _, _, w in parts])
        np.testing.assert_allclose(found.edof[j], max(_freedom(c), 1.0), rtol=1e-9)
        one, two, three = (float(np.trace(np.linalg.matrix_power(c, p))) for p in (1, 2, 3))
        if not lonely:
            np.testing.assert_allclose(found.skew[j], np.clip((three * one / two**2) ** 2, 1.0, 4.0), rtol=1e-9)
    np.testing.assert_array_equal(found.follows, 0.0)


@pytest.mark.parametrize("parts", [PARTS, PARTS[1:3]])
@pytest.mark.parametrize(("order", "averaged"), [(2, False), (3, True)])
def test_degrees_of_freedom_follow_the_curve_by_the_slopes_of_the_weights(
    parts: Any, order: int, averaged: bool
) -> None:
    """Moved curves move the weights; what that does to log(edof) is taken by differences of the exact sums."""
    weights = [w for _, _, w in parts]
    noise = edof.NoiseType(parts, 0.1 * np.array(weights)[:, None] * (1.0 + np.arange(3)) ** 2)
    found = edof.scatter_of_noise(noise, 2 * STEPS, N, order=order, averaged=averaged)
    slopes = np.empty((3, len(parts)))
    for j, m in enumerate(STEPS):
        for k in range(len(parts)):
            step = 1e-4 * weights[k]
            ends = [
                _exact(parts, order, averaged, 1, m, [*weights[:k], weights[k] + sign * step, *weights[k + 1 :]])
                for sign in (1, -1)
            ]
            slopes[j, k] = (np.log(_freedom(ends[0])) - np.log(_freedom(ends[1]))) / (2.0 * step)
    spread = np.sqrt(2.0 / found.edof)
    together = edof.octave_correlation(noise, STEPS.astype(float))
    wanted = np.sum((slopes @ noise.moves) * together * spread, axis=1) / spread
    assert np.abs(wanted).max() < 1.0
    np.testing.assert_allclose(found.follows, wanted, atol=1e-6)


# ------------------------------------------------------------------------------------------------------------- other filters


@pytest.mark.parametrize("name", ["haar", "d4", "la8"])
def test_an_octave_passes_the_energy_of_its_filter(name: str) -> None:
    """Sum of the squared taps of level j is 2^-j, of white noise's autocovariance that of the taps; the weights span all frequencies."""
    for j in (1, 2, 3):
        at = filtered.octave(name, j)
        np.testing.assert_allclose(np.sum(at.weight * at.gain), 2.0**-j, rtol=1e-5)
        np.testing.assert_allclose(np.sum(at.weight), 1.0 / at.stride, rtol=1e-12)
        taps = v.wavelet_coefficients((np.arange(201) == 100).astype(float), filter=name, levels=j)[j - 1]
        own = np.correlate(taps, taps, "full")[taps.size - 1 :]
        s = at.lags(np.ones(at.f.size))
        assert at.stride == 1.0
        np.testing.assert_allclose(s[:40], own[:40], atol=2e-6)
        assert at.reach == np.flatnonzero(np.abs(taps) > 1e-15).size
    long = filtered.octave(name, 7)
    assert long.stride == 4.0 and long.j == 7
    np.testing.assert_allclose(long.f[-1], 0.125)


@pytest.mark.parametrize("model", [WN(0.5), GM(1.0, 0.3) + WN(0.2), QN(0.1) + RW(0.3), AR1(0.6, 1.0, 4.0) + WN(1e-3)])
def test_degrees_of_freedom_are_those_of_all_pairs(model: Any) -> None:
    """Of a stationary sum: variance of a mean of squares over all pairs of coefficients."""
    n, dt = 64, 0.25
    model = WN(0.0) + model
    covariance = v.filter_covariance(model, "d4", 2.0 ** np.arange(1, 3), n, dt)
    h = [np.zeros(0)] * 2
    impulse = (np.arange(101) == 50).astype(float)
    for j, w in enumerate(v.wavelet_coefficients(impulse, filter="d4", levels=2)):
        h[j] = w[np.flatnonzero(np.abs(w) > 1e-15)]
    reach = 200
    for j in range(2):
        f = (np.arange(1 << 14) + 0.5) / (1 << 15)
        gain = np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(h[j].size))) @ h[j]) ** 2
        spectrum = gain * model.psd(f / dt, dt) / dt
        lags = np.arange(reach)
        s = np.array([np.mean(spectrum * np.cos(2 * np.pi * f * k)) for k in lags])
        count = n - h[j].size + 1
        weight = np.maximum(1 - lags / count, 0.0) * np.where(lags == 0, 1.0, 2.0)
        np.testing.assert_allclose(covariance[j, j], 2.0 / count * np.sum(weight * s**2), rtol=2e-3)
        np.testing.assert_allclose(v.expected_variance(model, "d4", [2.0 ** (j + 1)], dt), s[0], rtol=1e-3)


# ----------------------------------------------------------------------------------------------------------- missing samples


def _lost(n: int = 40) -> tuple[Array, Array, Array]:
    """A signal with missing samples, its running sums and counts."""
    x = numbers(n, 6) + 3.0
    x[[4, 5, 6, 11, 13, 20, 21, 22, 23, 24, 33]] = np.nan
    sums, there = np.empty(n + 1), np.empty(n + 1)
    _gaps_kernel.running(x, 3.0, sums, there)
    return x, sums, there


def _coefficients(x: Array, half: int) -> tuple[Array, NDArray[np.int64]]:
    """Weights of the samples in every coefficient of which at least half of each half is there, and where it begins."""
    good = np.isfinite(x)
    rows, first = [], []
    for k in range(x.size - 2 * half + 1):
        one, two = good[k : k + half], good[k + half : k + 2 * half]
        if min(one.sum(), two.sum()) >= 0.5 * half:
            w = np.zeros(x.size)
            w[k : k + half], w[k + half : k + 2 * half] = -0.5 * one / one.sum(), 0.5 * two / two.sum()
            rows.append(w)
            first.append(k)
    return np.array(rows), np.array(first)


@pytest.mark.parametrize("half", [1, 2, 4, 8])
def test_coefficients_with_gaps_are_differences_of_the_means_that_are_there(half: int) -> None:
    x, sums, there = _lost()
    known = np.where(np.isfinite(x), x - 3.0, 0.0)
    np.testing.assert_allclose(sums, np.concatenate([[0], np.cumsum(known)]))
    np.testing.assert_array_equal(there, np.concatenate([[0], np.cumsum(np.isfinite(x))]))
    w, first = _coefficients(x, half)
    for step in (1, 2, 3):
        chosen, places = first % step == 0, np.arange(0, x.size - 2 * half + 1, step)
        if half % step == 0:
            total, number = _gaps_kernel.squares(sums[::step].copy(), there[::step].copy(), half // step, 0.5 * half)
            assert number == chosen.sum()
            np.testing.assert_allclose(0.25 * total, np.sum((w[chosen] @ known) ** 2))
        lags, share = np.array([0, 1, 2, 5, 37]), np.empty(5)
        _gaps_kernel.pairs(there, half, places, 0.5 * half, lags, share)
        np.testing.assert_allclose(share, [np.isin(first[chosen] + lag, first).sum() / chosen.sum() for lag in lags])
    np.testing.assert_array_equal(_gaps_kernel.every_second(sums.copy()), sums[::2])
    own = np.empty(2 * half)
    _gaps_kernel.mean_weights(there, int(first[3]), half, own)
    np.testing.assert_allclose(own, w[3][first[3] : first[3] + 2 * half])


@pytest.mark.parametrize("half", [1, 2, 4])
def test_variances_and_covariances_of_coefficients_with_gaps_are_sums_over_samples(half: int) -> None:
    x, _, there = _lost()
    w, first = _coefficients(x, half)
    variogram = np.array([0.0, *np.log1p(np.arange(1.0, 80.0))])
    lag = np.abs(np.subtract.outer(np.arange(x.size), np.arange(x.size)))
    exact = -w @ variogram[lag] @ w.T
    weights = np.empty(2 * half)
    assert _gaps_kernel.pair_weights(there, half, np.arange(x.size - 2 * half + 1), 0.5 * half, weights) == first.size
    np.testing.assert_allclose(weights @ variogram[: weights.size], np.mean(np.diag(exact)))
    for step in (1, 2):
        near = [
            (i, j)
            for i in range(first.size)
            for j in range(i, first.size)
            if first[i] % step == 0 and first[j] < first[i] + 6 * half
        ]
        often = np.array([1.0 if i == j else 2.0 for i, j in near])
        whole = np.zeros(x.size)
        one = np.repeat([-0.5 / half, 0.5 / half], half)
        level = variogram + 0.3 * (np.arange(variogram.size) > 0)
        for k in range(6 * half):
            apart = np.abs(k + np.subtract.outer(np.arange(2 * half), np.arange(2 * half)))
            whole[k] = -one @ level[apart] @ one
        places = np.arange(0, x.size - 2 * half + 1, step)
        found = _gaps_kernel.short_pairs(there, half, places, 0.5 * half, variogram, 0.3)
        same = [whole[first[j] - first[i]] for i, j in near]
        np.testing.assert_allclose(found, [often @ [exact[i, j] ** 2 for i, j in near], often @ np.square(same)])


@pytest.mark.parametrize("kind", ["WN", "QN", "RW", "GM"])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_mean_variograms_of_parts_are_means_over_pairs(kind: str, size: int) -> None:
    h = np.arange(60.0)
    own = {"WN": (h > 0) * 1.0, "QN": np.where(h == 1, 3.0, 2.0) * (h > 0), "RW": 0.5 * h, "GM": -np.expm1(-h / 7.0)}[
        kind
    ]
    found = gaps._variogram(kind, 7.0, size, 4)
    inside = np.arange(size)
    for parts in range(4):
        apart = np.abs(parts * size + np.subtract.outer(inside, inside))
        pairs = own[apart[apart > 0]] if parts == 0 else own[apart]
        if pairs.size:
            np.testing.assert_allclose(found[parts], pairs.mean())


@pytest.mark.parametrize("name", ["haar", "d4"])
def test_another_filter_weighs_every_pair_that_is_there(name: str) -> None:
    """Equation (9) of Mondal and Percival (2010): squared differences by the autocorrelation of the filter."""
    x, _, _ = _lost()
    haar = gaps.haar_with_gaps(x, 3.0, 5)
    assert haar is not None
    found = gaps.filter_with_gaps(x, 3.0, name, haar)
    assert found is not None
    impulse = (np.arange(201) == 100).astype(float)
    for j in range(found.value.size):
        taps = v.wavelet_coefficients(impulse, filter=name, levels=j + 1)[j]
        own = np.correlate(taps, taps, "full")[taps.size - 1 :]
        squares = [np.nanmean((x[k:] - x[:-k]) ** 2) if k < x.size - 2 else 0.0 for k in range(1, x.size)]
        wanted = -np.sum(own[1 : x.size][: len(squares)] * squares[: own.size - 1])
        np.testing.assert_allclose(found.value[j], wanted, rtol=1e-9)


def test_whole_records_have_the_same_curve_with_and_without_the_door_for_gaps() -> None:
    x = numbers(600, 8)
    found, whole = gaps.haar_with_gaps(x, 0.0, 5), v.wavelet_variance(x, levels=5)
    assert found is not None
    np.testing.assert_allclose(found.value[:4], whole.value[:4], rtol=1e-9)
    np.testing.assert_array_equal(found.terms[:4], 600 - 2 ** np.arange(1, 5) + 1)
    np.testing.assert_allclose(found.inflation, 1.0)
    np.testing.assert_allclose(found.scatter.edof, whole.edof, rtol=0.02)
