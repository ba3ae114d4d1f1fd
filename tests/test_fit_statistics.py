"""Long statistics behind the estimators' claims, on fixed seeds; ``python -m tests.fit_experiments`` prints the same tables.

The seeds are fixed, so a run repeats; false alarms are those of ``tests/budget.py``.
"""

import numpy as np
import pytest

from insemu.fit.gmwm import fit_curve
from insemu.noise import NoiseModel
from insemu.variance import wavelet_variance
from tests import fit_experiments as experiments
from tests.budget import binomial, binomial_power, statistical

pytestmark = pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")


@pytest.mark.parametrize("name", experiments.COVERAGE)
@statistical(
    2e-5, 6, power=binomial_power(500, 0.95, 2e-5, 6, 0.85)
)  # standard errors three quarters of the right ones
def test_bias_coverage_and_size_over_500_series(name):
    got = experiments.coverage(name)
    assert np.abs(got["bias"]).max() < 1.0 / 3.0
    low, high = np.array(binomial(500, 0.95, 2e-5, 6)) / 500
    assert (got["coverage"] >= low).all() and (got["coverage"] <= high).all()
    low, high = np.array(binomial(500, 0.05, 2e-5, 6)) / 500
    assert low <= got["rejections"] <= high


def test_the_test_of_fit_rejects_a_wrong_model():
    truth, rejected = experiments.COVERAGE["WN + RW"], 0
    for rng in np.random.default_rng(1).spawn(30):
        curve = wavelet_variance(truth.simulate(100_000, 0.01, rng), 100.0, intervals="eta3")
        result = fit_curve(curve, NoiseModel.parse("WN()"), weighting="asymptotic")
        assert result.test is not None
        rejected += result.test.p_value < 0.05
    assert rejected == 30


def test_coverage_fails_where_the_covariance_is_wrong():
    # the negative twin: standard errors halved must not cover
    truth = experiments.COVERAGE["WN + RW"]
    inside = 0
    for rng in np.random.default_rng(2).spawn(200):
        curve = wavelet_variance(truth.simulate(100_000, 0.01, rng), 100.0, intervals="eta3")
        e = fit_curve(curve, NoiseModel.parse("WN() + RW()"), weighting="asymptotic")["RW1.K"]
        inside += abs(e.value - 0.01) < 0.5 * 1.96 * e.standard_error
    assert inside / 200 < 0.85


@pytest.mark.parametrize("name", experiments.SELECTION)
def test_selection_names_the_true_structure(name):
    got = experiments.selection(name, series=50)
    assert got["right"] >= 0.8
    assert got["worst"] <= 2.0


def test_constrained_em_reproduces_the_published_figures():
    good, early = (experiments.em_runs(name, 60) for name in ("Fig. 2, good start", "Fig. 2, bad start"))
    # Fig. 2: unbiased from the good start; stopped early from the bad one the random walk is far off, and every run says so
    assert good["converged"] == 60
    sd = good["em"].std(axis=0)
    assert (np.abs(good["em"].mean(axis=0) - good["truth"]) < 4.5 * sd / np.sqrt(60) + 0.1 * sd).all()
    assert early["converged"] == 0
    assert abs(np.median(early["em"][:, 1]) / 0.02 - 1.0) > 0.2
    # Fig. 3: removing the ramp first helps
    removed, inside = (experiments.em_runs(name, 40) for name in ("Fig. 3, ramp removed", "Fig. 3, ramp inside"))
    error = [np.abs(np.log(np.median(r["em"][:, 1]) / 0.008)) for r in (removed, inside)]
    assert error[0] < 0.25 and error[1] > 1.0
    # Fig. 5: the weak random walk beside a Gauss-Markov noise is seriously biased
    third = experiments.em_runs("Fig. 5", 20)
    assert np.median(third["em"][:, 2]) > 5e-4


def test_integrated_likelihood_reproduces_the_published_simulation():
    rows, _ = experiments.integrated(100, 10.0)
    assert np.abs(rows[:, 0] - 1).max() < 0.01
    assert np.abs(np.median(rows[:, 1:], axis=0) - 1).max() < 0.1
    assert np.log(rows[:, 2]).std(ddof=1) < 1.5 * experiments.BOUND


def test_a_navchip_like_signal_with_outliers():
    truth, _, _ = experiments.navchip()
    white = next(p.parameters["N"] for p in truth if p.symbol == "WN")
    rows = dict(experiments.navchip_fits())
    for title in ("clean, plain", "clean, robust"):
        assert rows[title]["WN1.N"] == pytest.approx(white, rel=0.02)
    assert rows["1 % outliers, plain"]["WN1.N"] > 2 * white
    assert rows["1 % outliers, robust"]["WN1.N"] == pytest.approx(white, rel=0.1)
    assert rows["1 % outliers, robust"]["worst"] < 0.3 < rows["1 % outliers, plain"]["worst"]
