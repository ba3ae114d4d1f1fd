"""Robust wavelet variance: unbiased where the log is clean, unmoved where it is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise import AR1, QN, WN
from insemu.variance import compare_with_robust, robust_wavelet_variance, wavelet_variance
from insemu.variance.robust import biweight_constants

Array = NDArray[np.float64]
N = 10_000


def _uniform_quantization(rng: np.random.Generator) -> Array:
    """Rounding errors as the reference programs draw them: differences of uniform numbers, plus white noise."""
    return np.diff(rng.uniform(0.0, 1.0, N + 1)) * np.sqrt(12 * 0.5) + rng.standard_normal(N) * np.sqrt(0.02)


CLEAN: dict[str, tuple[Any, Any]] = {
    "WN": (WN(N=1.2), lambda rng: WN(N=1.2).simulate(N, 1.0, rng)),
    "AR1": (
        AR1(phi=0.95, sigma2=0.1, rate_hz=1.0),
        lambda rng: AR1(phi=0.95, sigma2=0.1, rate_hz=1.0).simulate(N, 1.0, rng),
    ),
    "QN + WN": (QN(Q=np.sqrt(0.5)) + WN(N=np.sqrt(0.02)), _uniform_quantization),
    "Gaussian QN + WN": (
        QN(Q=np.sqrt(0.5)) + WN(N=np.sqrt(0.02)),
        lambda rng: (QN(Q=np.sqrt(0.5)) + WN(N=np.sqrt(0.02))).simulate(N, 1.0, rng),
    ),
}


def _mean_ratio(name: str, runs: int, **options: Any) -> tuple[Array, Array, Array]:
    """Mean of robust estimates over the truth and over plain ones, and degrees of freedom."""
    model, draw = CLEAN[name]
    rng = np.random.default_rng(20)
    series = [draw(rng) for _ in range(runs)]
    curves = [robust_wavelet_variance(x, levels=9, **options) for x in series]
    value = np.mean([c.value for c in curves], axis=0)
    plain = np.mean([wavelet_variance(x, levels=9, intervals="eta3").value for x in series], axis=0)
    return (
        value / model.wavelet_variance(2 ** np.arange(1, 10), 1.0),
        value / plain,
        np.mean([c.edof for c in curves], axis=0),
    )


@pytest.mark.parametrize("name", CLEAN)
def test_a_clean_log_is_read_without_bias(name: str) -> None:
    ratio, _, edof = _mean_ratio(name, 30)
    # 2 % plus four standard deviations of a mean of 30
    assert (np.abs(ratio - 1.0) < 0.02 + 4.0 * np.sqrt(2.0 / edof / 30)).all()


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("name", CLEAN)
def test_a_clean_log_is_read_within_two_percent_in_200_series(name: str) -> None:
    ratio, over_plain, edof = _mean_ratio(name, 200)
    spread = np.sqrt(2.0 / edof / 200)
    print(name, np.round(100 * (ratio - 1.0), 2), "% (standard deviation of the mean", np.round(100 * spread, 2), "%)")
    known = 3.3 * spread < 0.02  # where an unbiased estimator misses 2 % less than once in a thousand
    assert known[:6].all()
    assert (np.abs(ratio - 1.0)[known] < 0.02).all()
    # at every octave: the plain estimator is unbiased, and seen against it nothing is lost in scatter
    assert (np.abs(over_plain - 1.0) < 0.005).all()


def test_weights_tuned_to_gaussian_data_are_biased_by_uniform_rounding() -> None:
    # why the weights act only where tails are heavy
    ratio, _, _ = _mean_ratio("QN + WN", 5, adaptive=False)
    assert ratio[0] > 1.10


@pytest.mark.parametrize(("share", "octaves"), [(0.05, 2), (0.01, 3)])
def test_a_quantized_log_with_outliers_is_read_as_one(share: float, octaves: int) -> None:
    model, draw = CLEAN["QN + WN"]
    rng, values = np.random.default_rng(25), []
    for _ in range(10):
        x = draw(rng)
        x[rng.random(N) < share] += 10.0 * x.std()
        values.append(robust_wavelet_variance(x, levels=5).value)
    ratio = np.mean(values, axis=0) / model.wavelet_variance(2 ** np.arange(1, 6), 1.0)
    assert (np.abs(ratio - 1.0)[:octaves] < 0.05).all()


@pytest.mark.parametrize(
    "efficiency",
    [
        pytest.param(0.5, marks=pytest.mark.slow(reason="another case of a quick test")),
        0.6,
        pytest.param(0.9, marks=pytest.mark.slow(reason="another case of a quick test")),
    ],
)
def test_the_efficiency_is_the_one_asked_for(efficiency: float) -> None:
    c, k = biweight_constants(efficiency)
    rng = np.random.default_rng(21)
    z = rng.standard_normal((4000, 300))
    s2 = np.ones(4000)
    for _ in range(60):
        w = np.maximum(1.0 - z**2 / (c * c * s2[:, None]), 0.0) ** 2
        s2 = (w * z * z).sum(axis=1) / (k * w.sum(axis=1))
    plain = np.mean(z * z, axis=1)
    # a ratio of variances of 4000 draws: 4.5 standard deviations are 10 %; records of 300 add a few per cent
    assert abs(plain.var() / s2.var() / efficiency - 1.0) < 0.13


def _dirty(share: float, how: str, rng: np.random.Generator) -> Array:
    x = rng.standard_normal(N)
    bad = rng.random(N) < share
    if how == "replaced":
        x[bad] = 10.0 * rng.standard_normal(bad.sum())
    else:
        x[bad] += 10.0 * (rng.choice([-1.0, 1.0], bad.sum()) if how == "both signs" else 1.0)
    return x


@pytest.mark.parametrize("how", ["one sign", "both signs", "replaced"])
@pytest.mark.parametrize(("share", "octaves"), [(0.05, 2), (0.01, 3)])
def test_ten_sigma_outliers_move_the_first_octaves_by_less_than_ten_percent(
    how: str, share: float, octaves: int
) -> None:
    rng = np.random.default_rng(22)
    truth = 2.0 ** -np.arange(1, 10)
    records = [_dirty(share, how, rng) for _ in range(20)]
    robust = [robust_wavelet_variance(x, levels=9) for x in records]
    bias = np.mean([r.value for r in robust], axis=0) / truth - 1.0
    plain = np.mean([wavelet_variance(x, levels=9).value for x in records], axis=0) / truth - 1.0
    assert (np.abs(bias[:octaves]) < 0.10).all()
    assert (plain[:octaves] > 0.8).all()
    assert all(r.contaminated and not r.protected[-1] for r in robust)  # the longest octaves are said to be unprotected
    assert compare_with_robust(wavelet_variance(records[0], levels=9), robust[0]).contaminated


def test_one_wild_value_has_bounded_influence() -> None:
    x = np.random.default_rng(23).standard_normal(5000)
    clean = robust_wavelet_variance(x, levels=5)
    x[2500] = 1e9
    dirty = robust_wavelet_variance(x, levels=5)
    np.testing.assert_allclose(dirty.value, clean.value, rtol=0.15)
    assert wavelet_variance(x, levels=5).value[0] > 1e10


def test_a_clean_log_is_not_called_contaminated() -> None:
    rng = np.random.default_rng(24)
    verdicts = [
        compare_with_robust(wavelet_variance(x), robust_wavelet_variance(x)).contaminated
        for x in (rng.standard_normal(4000) for _ in range(50))
    ]
    assert not any(verdicts)


def test_bad_efficiency_is_refused() -> None:
    with pytest.raises(InputError, match=r"efficiency is 1\.2"):
        robust_wavelet_variance(np.arange(50.0) % 3, efficiency=1.2)
