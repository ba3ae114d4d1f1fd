"""Wavelet variance: reference outputs, closed forms, exact covariance, coverage of the intervals."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise import GM, QN, RW, WN
from insemu.variance import (
    filters,
    level1_autocovariance,
    model_covariance,
    model_edof,
    stream_wavelet_variance,
    wavelet_coefficients,
    wavelet_variance,
    wv_covariance,
)
from insemu.variance.edof import (
    OCTAVES_TOGETHER,
    Scatter,
    chi_square_interval,
    edof_of_noise,
    noise_type,
    scatter_of_noise,
)
from insemu.variance.filters import FILTERS, fejer_korovkin, modwt_filters
from tests.budget import binomial, binomial_power, statistical
from tests.shared_data import shared
from tests.wavelet_oracles import model_covariance_of_filter

Array = NDArray[np.float64]
NAMES = ("wn_pow2", "wn", "ar1", "wn_rw", "gm2_wn_100hz", "ar1x2_wn", "qn_wn", "wn_dr", "ar2")


def fixture(name: str, kind: str) -> tuple[Array, Array]:
    """Series and (scale, value, low, high) rows of a reference output."""
    folder = shared("fixtures/wavelet_variance")
    series = np.loadtxt(gzip.open(folder / f"{name}_series.csv.gz", "rt"), skiprows=1)
    with gzip.open(folder / f"{name}_wv.csv.gz", "rt") as file:
        rows = [r for r in csv.DictReader(file) if r["kind"] == kind]
    return series, np.array([[float(r[c] or "nan") for c in ("scale", "value", "ci_low", "ci_high")] for r in rows])


@pytest.mark.parametrize("name", NAMES)
def test_haar_modwt_and_its_eta3_intervals_equal_the_reference(name: str) -> None:
    x, rows = fixture(name, "wv_haar_modwt")
    curve = wavelet_variance(x, intervals="eta3", levels=len(rows))
    np.testing.assert_array_equal(curve.scale_samples, rows[:, 0])
    for mine, theirs in ((curve.value, rows[:, 1]), (curve.low, rows[:, 2]), (curve.high, rows[:, 3])):
        np.testing.assert_allclose(mine, theirs, rtol=1e-10)


def test_a_large_offset_costs_no_digits() -> None:
    x = np.random.default_rng(1).standard_normal(4000)
    # the offset itself rounds the samples to 1e-10, no more than that may be seen
    np.testing.assert_allclose(wavelet_variance(x + 1e6).value, wavelet_variance(x).value, rtol=1e-8)


@pytest.mark.parametrize("n", [3, 4, 5, 7, 2048, 2049, 5000])
def test_the_chunked_kernel_equals_plain_differences_of_averages(n: int) -> None:
    x = np.random.default_rng(n).standard_normal(n).cumsum() + 9.8
    curve = wavelet_variance(x)
    s = np.concatenate([[0.0], np.cumsum(x - x.mean())])
    for scale, value, count in zip(curve.scale_samples, curve.value, curve.n_coefficients, strict=True):
        m = scale // 2
        w = (s[2 * m :] - 2 * s[m:-m] + s[: -2 * m]) / (2 * m)
        assert count == w.size == n - scale + 1
        np.testing.assert_allclose(value, np.mean(w * w), rtol=1e-9)


def test_a_stream_in_any_pieces_equals_the_record_in_memory() -> None:
    x = np.random.default_rng(3).standard_normal(30_011).cumsum()
    rng = np.random.default_rng(4)
    cuts = np.sort(rng.integers(0, x.size, 25))
    streamed = stream_wavelet_variance(np.split(x, cuts), 10.0)
    direct = wavelet_variance(x, 10.0)
    np.testing.assert_allclose(streamed.value, direct.value, rtol=1e-12)
    np.testing.assert_array_equal(streamed.n_coefficients, direct.n_coefficients)


def test_long_scales_of_a_stream_on_a_grid_stay_within_their_scatter() -> None:
    x = np.random.default_rng(5).standard_normal(200_000)
    streamed = stream_wavelet_variance(np.array_split(x, 9), full_overlap=4096)
    direct = wavelet_variance(x)
    exact = direct.scale_samples <= 4096
    np.testing.assert_allclose(streamed.value[exact], direct.value[exact], rtol=1e-12)
    np.testing.assert_allclose(streamed.value, direct.value, rtol=2e-3)
    assert not np.array_equal(streamed.value, direct.value)  # the grid was used


def test_a_million_samples_from_a_memory_map(tmp_path: Path) -> None:
    path = tmp_path / "x.npy"
    np.save(path, np.random.default_rng(6).standard_normal(1_000_000).astype(np.float32))
    x = np.load(path, mmap_mode="r")
    streamed = stream_wavelet_variance(x[k : k + 77_777] for k in range(0, x.size, 77_777))
    np.testing.assert_allclose(streamed.value, wavelet_variance(x).value, rtol=1e-12)


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_satisfies_equation_3(name: str) -> None:
    h, g = modwt_filters(name)
    assert abs(h.sum()) < 1e-14
    assert abs(np.sum(h * h) - 0.5) < 1e-14
    for m in range(1, h.size // 2):
        assert abs(np.dot(h[2 * m :], h[: -2 * m])) < (2.5e-5 if name.startswith("battle") else 1e-14)
    assert abs(g.sum() - 1.0) < 1e-14


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("battle2", [0.817645956, 0.397296430, -0.069101020, -0.051945337]),
        ("battle4", [0.766130398, 0.433923147, -0.050201753, -0.110036987]),
    ],
)
def test_a_cut_spline_stays_that_of_the_tables(name: str, printed: list[float]) -> None:
    """Made orthonormal to rounding they moved by 0.14 and 0.04, and to other numbers on another processor."""
    g = np.sqrt(2.0) * modwt_filters(name)[1][:-1]
    middle = g.size // 2
    np.testing.assert_allclose(g[middle : middle + 4], printed, atol=1e-5)
    np.testing.assert_allclose(g, g[::-1], atol=3e-6)


@pytest.mark.parametrize("name", filters._TABLES)
def test_a_printed_filter_moves_by_no_more_than_its_last_digits(name: str) -> None:
    """A wrong digit of a table would be mended to another orthonormal filter."""
    printed = np.array(filters._TABLES[name])
    np.testing.assert_allclose(np.sqrt(2.0) * modwt_filters(name)[1], printed, rtol=0, atol=6e-7)


@pytest.mark.parametrize("length", [6, 8, 14, 22])
def test_the_fejer_korovkin_construction_gives_the_published_filters(length: int) -> None:
    _, g = modwt_filters(f"fk{length}")
    # the tables' last digits move the double zero at half the rate apart, which costs the filter half of its digits
    np.testing.assert_allclose(fejer_korovkin(length) / np.sqrt(2.0), g, atol=5e-5)
    power = [np.convolve(f, f[::-1]) for f in (fejer_korovkin(length) / np.sqrt(2.0), g)]
    np.testing.assert_allclose(power[0], power[1], atol=6e-8)


@pytest.mark.parametrize("name", ["haar", "d6", "la8", "fk8", "fk18", "bl14", "battle4", "mb16"])
def test_every_family_keeps_the_variance_of_white_noise(name: str) -> None:
    x = np.random.default_rng(7).standard_normal(20_000)
    curve = wavelet_variance(x, filter=name, levels=5)
    # 4.5 standard deviations of an estimate with M / 2^j degrees of freedom
    bound = 4.5 * np.sqrt(2.0 * curve.scale_samples / curve.n_coefficients)
    assert (np.abs(curve.value * curve.scale_samples - 1.0) < bound).all()


def _gamma(model: Any) -> Any:
    return lambda k: model.autocovariance(k, 1.0)


def _dense(model: Any, n: int, name: str = "haar") -> Array:
    """Covariance of wavelet variances from the full covariance matrix of the record."""
    gram = _gamma(model)(np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
    unit = [wavelet_coefficients(row, filter=name) for row in np.eye(n)]
    maps = [np.array([u[j] for u in unit]).T for j in range(len(unit[0]))]
    return np.array([[2.0 * np.sum((a @ gram @ b.T) ** 2) / len(a) / len(b) for b in maps] for a in maps])


@pytest.mark.parametrize("model", [WN(N=1.3), GM(sigma=1.0, beta=0.05), QN(Q=1.0)], ids=str)
def test_model_covariance_equals_the_dense_double_sum(model: Any) -> None:
    n = 150
    dense = _dense(model, n)
    level1 = level1_autocovariance(n, autocovariance=_gamma(model))
    np.testing.assert_allclose(model_covariance(level1), dense, rtol=1e-10, atol=1e-14 * dense.max())
    np.testing.assert_allclose(model_covariance_of_filter(_gamma(model), n), dense, rtol=1e-8, atol=1e-12 * dense.max())
    from_psd = level1_autocovariance(n, psd=lambda f: model.psd(f, 1.0))
    np.testing.assert_allclose(model_covariance(from_psd), dense, rtol=1e-6, atol=1e-10 * dense.max())
    scale = 2 ** np.arange(1, len(dense) + 1)
    v = model.wavelet_variance(scale, 1.0)
    np.testing.assert_allclose(model_edof(level1, v), 2.0 * v**2 / np.diag(dense), rtol=1e-9)


def test_covariance_of_another_filter_equals_the_dense_double_sum() -> None:
    model = GM(sigma=1.0, beta=0.2)
    dense = _dense(model, 120, "d6")
    np.testing.assert_allclose(model_covariance_of_filter(_gamma(model), 120, filter="d6"), dense, rtol=1e-8)


def test_random_walk_has_a_covariance_too_from_increments_or_spectrum() -> None:
    n = 500
    one = model_covariance(level1_autocovariance(n, increments=lambda k: np.where(k == 0, 1.0, 0.0)))
    two = model_covariance(level1_autocovariance(n, psd=lambda f: RW(K=1.0).psd(f, 1.0)))
    np.testing.assert_allclose(one, two, rtol=1e-9)
    rng = np.random.default_rng(8)
    draws = np.array([wavelet_variance(rng.standard_normal(n).cumsum(), intervals="eta3").value for _ in range(4000)])
    # a variance of 4000 draws scatters by about sqrt(kurtosis / 4000): 6 % of it for the skewest scale
    np.testing.assert_allclose(np.diag(one)[:6], draws.var(axis=0)[:6], rtol=0.2)


def test_data_covariance_estimates_the_models() -> None:
    n, rng = 4096, np.random.default_rng(9)
    model = model_covariance(level1_autocovariance(n, autocovariance=_gamma(WN(N=1.0))), levels=6)
    mean = np.mean([wv_covariance(rng.standard_normal(n), levels=6) for _ in range(60)], axis=0)
    np.testing.assert_allclose(np.diag(mean), np.diag(model), rtol=0.15)
    assert np.linalg.eigvalsh(mean).min() > 0


@pytest.mark.parametrize(
    "model", [WN(N=1.0), GM(sigma=1.0, beta=0.01), WN(N=1.0) + RW(K=0.01), QN(Q=1.0) + WN(N=0.1)], ids=str
)
def test_degrees_of_freedom_of_the_noise_type_are_those_of_the_model(model: Any) -> None:
    n = 20_000
    scale = 2.0 ** np.arange(1, 14)
    v = model.wavelet_variance(scale.astype(int), 1.0)
    exact = model_edof(level1_autocovariance(n, psd=lambda f: model.psd(f, 1.0)), v)
    np.testing.assert_allclose(edof_of_noise(noise_type(scale, v, n), scale, n), exact, rtol=0.03)


def _coverage(model: Any, n: int, runs: int, rng: np.random.Generator, shrink: float = 1.0) -> tuple[Array, Array]:
    scale = 2 ** np.arange(1, int(np.log2(n)))
    truth = model.wavelet_variance(scale, 1.0)
    hits, freedom = np.zeros(len(scale)), np.zeros(len(scale))
    for _ in range(runs):
        c = wavelet_variance(model.simulate(n, 1.0, rng), levels=len(scale))
        hits += (c.value - shrink * (c.value - c.low) <= truth) & (truth <= c.value + shrink * (c.high - c.value))
        freedom += c.edof / runs
    return hits / runs, freedom


MODELS = {"WN": WN(N=1.0), "GM": GM(sigma=1.0, beta=0.02), "RW + WN": WN(N=1.0) + RW(K=0.02)}


@pytest.mark.parametrize("name", MODELS)
@statistical(2e-5, 10, power=binomial_power(120, 0.95, 2e-5, 10, 0.67))  # intervals half as wide
def test_default_intervals_cover_the_truth_on_a_few_series(name: str) -> None:
    hits, freedom = _coverage(MODELS[name], 2048, 120, np.random.default_rng(10))
    low = binomial(120, 0.95, 2e-5, 10)[0] / 120
    assert (hits[freedom > 8] >= low).all()
    narrow, freedom = _coverage(MODELS[name], 2048, 120, np.random.default_rng(10), shrink=0.5)
    assert (narrow[freedom > 8] < low).all()


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("seed", [21, 22])
@pytest.mark.parametrize("name", MODELS)
@statistical(2e-5, 12, power=binomial_power(1000, 0.95, 2e-5, 12, 0.67))  # intervals half as wide
def test_default_intervals_cover_the_truth(name: str, seed: int) -> None:
    hits, freedom = _coverage(MODELS[name], 8192, 1000, np.random.default_rng(seed))
    print(name, np.round(100 * hits, 1), np.round(freedom, 1))
    low, high = (
        np.array(binomial(1000, 0.95, 2e-5, 12)) / 1000
    )  # benchmarks/variance_coverage.py counts over many seeds
    assert ((low <= hits[freedom > 8]) & (hits[freedom > 8] <= high)).all()
    narrow, freedom = _coverage(MODELS[name], 8192, 300, np.random.default_rng(seed), shrink=0.5)
    assert (narrow[freedom > 8] < low).all()


@pytest.mark.parametrize("model", [WN(N=1.0), GM(sigma=1.0, beta=0.02)], ids=str)
@pytest.mark.parametrize("level", [7, 8])
def test_ends_of_intervals_are_quantiles_of_the_weighted_sum_of_chi_squares(model: Any, level: int) -> None:
    n = 1000
    scale = 2 ** np.arange(1, level + 1)
    gram = _gamma(model)(np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
    terms = np.array([wavelet_coefficients(row, levels=level)[-1] for row in np.eye(n)]).T
    weights = np.linalg.eigvalsh(terms @ gram @ terms.T)
    large = weights[-80:]  # the rest scatters too little to be seen
    draws = (np.random.default_rng(16).chisquare(1, (40_000, 80)) @ large + weights[:-80].sum()) / weights.sum()
    right = scatter_of_noise(noise_type(scale, model.wavelet_variance(scale, 1.0), n), scale, n)
    still = Scatter(right.edof, right.skew, np.zeros(level))
    low, high = chi_square_interval(np.ones(level), right.edof, 0.95, scatter=still)
    below, above = np.mean(draws < 1.0 / high[-1]), np.mean(draws > 1.0 / low[-1])
    # 2.5 % +- 5 standard deviations of 40,000 draws
    assert abs(below - 0.025) < 0.004 and abs(above - 0.025) < 0.004
    # a chi-square of the same two moments misses the lower tail
    low, high = chi_square_interval(np.ones(level), right.edof, 0.95)
    assert np.mean(draws < 1.0 / high[-1]) < 0.0225


def test_octaves_go_together_as_the_exact_covariance_says() -> None:
    n = 1 << 13
    impulse = lambda k: np.where(k == 0, 1.0, 0.0)  # noqa: E731
    quantized = lambda k: np.where(k == 0, 2.0, np.where(k == 1, -1.0, 0.0))  # noqa: E731
    processes: list[dict[str, Any]] = [
        {"autocovariance": quantized},
        {"autocovariance": impulse},
        {"increments": impulse},
    ]
    for table, process in zip(OCTAVES_TOGETHER, processes, strict=True):
        c = model_covariance(level1_autocovariance(n, **process), levels=8)
        r = c / np.sqrt(np.outer(np.diag(c), np.diag(c)))
        np.testing.assert_allclose(table[:6], r[2, 2:8], atol=0.02)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_asymptotic_covariance_against_draws() -> None:
    n, draws, rng = 1000, 100_000, np.random.default_rng(13)
    theory = model_covariance(level1_autocovariance(n, autocovariance=_gamma(WN(N=1.0))))
    values = np.array([wavelet_variance(rng.standard_normal(n), intervals="eta3").value for _ in range(draws)])
    scale = 2 ** np.arange(1, len(theory) + 1)
    use = (n - scale + 1) / scale >= 8
    drawn = np.cov(values.T)
    np.testing.assert_allclose(np.diag(drawn)[use], np.diag(theory)[use], rtol=0.10)
    a, b = (c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (theory, drawn))
    np.testing.assert_allclose(a[np.ix_(use, use)], b[np.ix_(use, use)], atol=0.05)


def test_normal_intervals_are_offered_only_where_they_hold() -> None:
    curve = wavelet_variance(np.random.default_rng(14).standard_normal(5000), intervals="normal")
    assert np.isnan(curve.low[curve.edof <= 100]).all() and np.isfinite(curve.low[curve.edof > 100]).all()
    low, high = chi_square_interval(np.ones(1), np.array([400.0]), 0.95)
    assert abs(float(low[0]) - 0.876) < 0.002 and abs(float(high[0]) - 1.153) < 0.002


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"x": [1.0, 2.0]}, "has 2 samples"),
        ({"x": [[1.0, 2.0, 3.0]]}, "expected (n,)"),
        ({"x": [1.0, np.nan, 3.0, 4.0]}, "not finite at sample 1"),
        ({"x": ["a", "b", "c"]}, "expected real numbers"),
        ({"x": np.ones(50), "filter": "d7"}, "unknown wavelet filter 'd7'"),
        ({"x": np.ones(50), "filter": "d8", "levels": 9}, "levels is 9"),
        ({"x": np.ones(50), "intervals": "eta1"}, "expected one of: edof, eta3, normal"),
        ({"x": np.ones(50), "confidence": 95.0}, "between 0 and 1"),
        ({"x": np.ones(50), "rate_hz": 0.0}, "expected a positive number"),
        ({"x": np.ones(5), "filter": "d8"}, "too short"),
        ({"x": np.ones(50), "edof": [1.0]}, "one per scale"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        wavelet_variance(**arguments)
    assert said in str(caught.value)


def test_a_stream_says_where_a_value_is_not_finite() -> None:
    with pytest.raises(InputError, match="not finite at sample 1002"):
        stream_wavelet_variance([np.ones(1000), np.array([1.0, 1.0, np.inf])])


def test_curves_of_real_sensors_are_followed_by_the_noise_type() -> None:
    content = json.loads(shared("real/wv_tactical_curves.json").read_text())
    curve = content["ln200"]["wvar"]["Gyro. X"]
    v = np.array(curve["variance"])
    scale = 2.0 ** np.arange(1, len(v) + 1)
    freedom = edof_of_noise(noise_type(scale, v, 8_640_000), scale, 8_640_000)
    assert (np.diff(freedom[3:]) < 0).all() and freedom[-1] >= 1.0


@pytest.mark.parametrize(("kind", "axis", "column"), [("Gyroscope", "X", 0), ("Accelerometer", "Z", 5)])
def test_a_real_record_has_its_published_wavelet_variance(kind: str, axis: str, column: int) -> None:
    text = shared("fixtures/wavelet_variance/adis_wv.csv").read_text().splitlines()
    rows = [
        r
        for r in csv.DictReader(line for line in text if not line.startswith("#"))
        if (r["type"], r["axis"]) == (kind, axis)
    ]
    with np.load(shared("real/adis16405_static_run1.npz")) as file:
        x = file["counts"][:, column] * file["scale"][column]
    curve = wavelet_variance(x, 100.0, intervals="eta3", levels=len(rows))
    for mine, key in ((curve.tau_s, "scale"), (curve.value, "wv"), (curve.low, "ci_low"), (curve.high, "ci_high")):
        np.testing.assert_allclose(mine, [float(r[key]) for r in rows], rtol=1e-9)
