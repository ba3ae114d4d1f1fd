"""The generalized method of wavelet moments against other programs' estimates, truths and its own formulas."""

import csv
import gzip
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from insemu.errors import InputError
from insemu.fit import FitResult, fit, save
from insemu.fit.covariance import model_covariance
from insemu.fit.gmwm import Weights, finite_record_bias, fit_curve
from insemu.fit.minimum import Problem, Solution
from insemu.fit.structure import Structure, natural_jacobian
from insemu.noise import AR, AR1, BI, DR, GM, MA, QN, RW, SIN, WN, NoiseModel, load
from insemu.records import Series
from insemu.variance import wavelet_variance
from insemu.variance.covariance import level1_autocovariance
from insemu.variance.covariance import model_covariance as covariance_over_lags
from tests.shared_data import shared

NAMES = ("wn_pow2", "wn", "ar1", "wn_rw", "gm2_wn_100hz", "ar1x2_wn", "qn_wn", "wn_dr", "ar2")


def fixture(name):
    folder = shared("fixtures/wavelet_variance")
    entry = next(f for f in json.loads((folder / "fixtures.json").read_text())["fixtures"] if f["name"] == name)
    with gzip.open(folder / entry["series"], "rt") as file:
        x = np.array([float(row[-1]) for row in list(csv.reader(file))[1:]])
    curves: dict[str, list[list[float]]] = {}
    with gzip.open(folder / entry["wv"], "rt") as file:
        for row in csv.DictReader(file):
            values = [float(row[k]) if row[k] else np.nan for k in ("scale", "value", "ci_low", "ci_high")]
            curves.setdefault(row["kind"], []).append(values)
    return entry, x, {k: np.array(v) for k, v in curves.items()}


@pytest.mark.parametrize("name", NAMES)
def test_from_automatic_starts_the_objective_is_no_worse_than_the_peer_started_at_the_truth(name):
    entry, x, curves = fixture(name)
    theirs = curves["wv_haar_modwt"]
    result = fit(x, entry["fit_model"], rate_hz=entry["freq_hz"])
    assert result.curve is not None
    count = len(theirs)  # one octave fewer than ours: the last has one degree of freedom
    assert_allclose(result.curve.value[:count], theirs[:, 1], rtol=1e-10)
    peer = next(g for g in entry["gmwm"] if "at the true" in g["method"])
    prediction = np.array(peer.get("theo_wv") or curves["wv_haar_theoretical_true_params"][:, 1])[:count]
    width = theirs[:, 3] - theirs[:, 2]
    best = np.sum(((theirs[:, 1] - prediction) / width) ** 2)
    ours = np.sum(((theirs[:, 1] - result.fitted[:count]) / width) ** 2)
    assert ours <= best * (1.0 + 1e-7)
    assert result.converged
    curve = wavelet_variance(x, entry["freq_hz"], levels=count)
    again = fit_curve(curve, result.structure, weighting=Weights(widths=width))
    assert again.objective <= ours * (1.0 + 1e-9)
    assert_allclose(fit_curve(curve, result.structure).objective, again.objective, rtol=1e-6)


TRUTHS = {
    "three GM and more": (
        NoiseModel((WN(1e-3), GM(2e-3, 0.02), GM(4e-3, 0.8), GM(8e-3, 25.0), RW(5e-5))),
        "WN() + 3*GM() + RW()",
        100.0,
    ),
    "three AR1": (
        NoiseModel((AR1(0.999, 1e-6, 1.0), AR1(0.97, 1e-4, 1.0), AR1(0.5, 1e-2, 1.0))),
        "3*AR1()",
        1.0,
    ),
    "negative AR1": (NoiseModel((AR1(-0.7, 2.0, 1.0), RW(0.01))), "AR1() + RW()", 1.0),
    "sinusoid": (NoiseModel((WN(0.1), SIN(0.3, 0.7))), "WN() + SIN()", 50.0),
    "flicker": (NoiseModel((WN(0.1), BI(0.02))), "WN() + BI()", 50.0),
    "moving average": (NoiseModel((MA(ma=(0.6,), sigma2=2.0, rate_hz=1.0), RW(0.02))), "MA(1) + RW()", 1.0),
    "all the simple ones": (NoiseModel((QN(3e-4), WN(1e-2), RW(4e-3), DR(3e-3))), "QN() + WN() + RW() + DR()", 10.0),
}


@pytest.mark.parametrize("truth", TRUTHS)
def test_a_curve_without_scatter_gives_its_model_back(truth):
    model, structure, rate = TRUTHS[truth]
    n = 1 << 18
    x = wavelet_variance(np.random.default_rng(1).standard_normal(n), rate)
    curve = replace(x, value=model.wavelet_variance(x.scale_samples, 1.0 / rate))
    # the minimum itself: estimates in the model's own weights are corrected for a bias that such a curve does not have
    result = fit_curve(curve, NoiseModel.parse(structure), weighting="intervals")
    assert result.objective < 1e-10
    assert_allclose(result.fitted, curve.value, rtol=1e-4)
    ordered = sorted(model, key=lambda p: (p.symbol, -p.parameters.get("phi", 0), p.parameters.get("beta", 0)))
    found = sorted(result.model, key=lambda p: (p.symbol, -p.parameters.get("phi", 0), p.parameters.get("beta", 0)))
    for one, two in zip(ordered, found, strict=True):
        for name, value in one.parameters.items():
            assert_allclose(two.parameters[name], value, rtol=2e-3, err_msg=f"{one} {name}")


COVARIANCE = [
    NoiseModel((WN(0.1),)),
    NoiseModel((QN(0.01),)),
    NoiseModel((RW(0.3),)),
    NoiseModel((GM(1.0, 1e-3),)),
    NoiseModel((GM(1.0, 200.0),)),
    WN(0.1) + GM(1.0, 0.5) + GM(0.3, 20.0) + RW(0.1) + QN(0.001),
    WN(0.1) + DR(0.01),
    NoiseModel((BI(0.2),)),
]


def level1(p, n, dt):
    """From the spectrum: another way than the room's own."""
    if isinstance(p, DR):
        return np.zeros(n)
    if isinstance(p, RW | BI):
        return level1_autocovariance(n, psd=lambda f: p.psd(f, dt), rate_hz=1.0 / dt)
    return level1_autocovariance(n, autocovariance=lambda lag: p.autocovariance(lag, dt))


@pytest.mark.parametrize("model", COVARIANCE, ids=str)
def test_covariance_of_the_curve_by_corners_equals_the_sum_over_all_lags(model):
    n, dt, levels = 3000, 0.01, 10
    drift = sum(p.parameters["R"] * dt for p in model if isinstance(p, DR))
    slow = covariance_over_lags(sum(level1(p, n, dt) for p in model), levels=levels, drift_per_sample=drift)
    fast = model_covariance(model, n, 2 ** np.arange(1, levels + 1), dt)
    scale = np.sqrt(np.outer(np.diag(slow), np.diag(slow)))
    tolerance = (
        3e-3 if any(isinstance(p, BI) for p in model) else 3e-4
    )  # the spectrum of flicker is folded at twice the record
    assert np.abs(fast - slow).max() <= tolerance * scale.max() or (np.abs(fast - slow) <= tolerance * scale).all()


def test_covariance_of_processes_without_corners_takes_the_sum_over_lags():
    n, dt = 2000, 1.0
    scale = 2 ** np.arange(1, 9)
    as_ar = model_covariance(NoiseModel((AR((0.8,), sigma2=2.0, rate_hz=1.0),)), n, scale, dt)
    as_one = model_covariance(NoiseModel((AR1(0.8, 2.0, rate_hz=1.0),)), n, scale, dt)
    assert_allclose(as_ar, as_one, rtol=2e-3)


def test_covariance_with_a_sinusoid_is_what_draws_scatter():
    model, n, rate = NoiseModel((WN(0.1), SIN(0.3, 0.7))), 2048, 50.0
    rng = np.random.default_rng(5)
    scale = 2 ** np.arange(1, 8)
    draws = np.array([wavelet_variance(model.simulate(n, 1 / rate, r), rate, levels=7).value for r in rng.spawn(600)])
    spread = np.var(draws, axis=0)
    # 600 draws: relative standard error sqrt(2/600) = 6 %; bound at 4.5 of them for 7 scales
    assert_allclose(np.diag(model_covariance(model, n, scale, 1 / rate)), spread, rtol=0.26)


JACOBIAN = WN(0.1) + QN(0.02) + RW(0.3) + DR(0.2) + GM(1.0, 0.5) + BI(0.1) + SIN(0.3, 0.7)


@pytest.mark.parametrize(
    "model",
    [
        JACOBIAN,
        NoiseModel((AR1(0.99, 0.3, 10.0), AR1(-0.4, 0.2, 10.0), AR1(0.2, 0.1, 10.0))),
        NoiseModel((AR((0.5, 0.2), sigma2=2.0, rate_hz=10.0),)),
    ],
    ids=("simple", "AR1", "AR"),
)
def test_jacobian_equals_finite_differences(model):
    rate = 10.0
    empty = NoiseModel(
        tuple(type(p)() if not isinstance(p, AR) else AR(2) for p in model)  # the structure with everything free
    )
    structure = Structure.of(empty, rate)
    m = 2.0 ** np.arange(0, 12)
    D, names = natural_jacobian(model.at_rate(rate), structure, m)
    for column, (k, name) in zip(D.T, names, strict=True):
        p = model.processes[k]
        value = p.parameters[name]
        h = 1e-6 * max(abs(value), 1e-3) if name != "phi" else 1e-6 * (1 - abs(value))
        up = p.with_parameters({name: value + h}).wavelet_variance(2 * m, 1 / rate)
        down = p.with_parameters({name: value - h}).wavelet_variance(2 * m, 1 / rate)
        assert_allclose(column, (up - down) / (2 * h), rtol=2e-5, atol=1e-7 * np.abs(column).max())


def test_weights_follow_the_length_of_the_record_and_whether_the_model_holds():
    rng = np.random.default_rng(6)
    x = (WN(0.1) + RW(0.02)).simulate(100_000, 0.01, rng)
    used = {
        label: fit(signal, model, rate_hz=100.0).details["weighting"]
        for label, signal, model in (
            ("long", x, "WN() + RW()"),
            ("short", x[:60_000], "WN() + RW()"),
            ("wrong", x, "WN()"),
        )
    }
    assert used == {"long": "asymptotic", "short": "intervals", "wrong": "intervals"}
    long = fit(x, "WN() + RW()", rate_hz=100.0)
    assert long.to_json()["weighting"] == "asymptotic"
    same = fit(x, "WN() + RW()", rate_hz=100.0, weighting="asymptotic")
    # sums of a fit depend in their last bits on where its arrays lie in memory
    assert [e.value for e in long.parameters] == pytest.approx([e.value for e in same.parameters], rel=1e-9)


def test_curvature_bias_of_a_root_is_the_closed_form():
    # N is the root of a linear estimate of N^2, so to second order its mean is low by half of its relative variance
    rng = np.random.default_rng(7)
    result = fit(WN(0.1).simulate(3000, 1.0, rng), "WN()", rate_hz=1.0, weighting="asymptotic")
    structure = Structure.of(result.structure, 1.0)
    d = result.details
    coefficients, shapes = structure.internal(result.model)
    at = Solution(coefficients, shapes, 0.0, True)
    problem = Problem(structure, d["scales"], result.curve.value, result.n_samples)
    bias = finite_record_bias(problem, at, d["free"], result.covariance, d["W"], d["curve_covariance"])
    relative = result["WN1.N"].standard_error / result["WN1.N"].value
    assert_allclose(bias[0] / result["WN1.N"].value, -0.5 * relative**2, rtol=0.02)


def test_given_values_are_held():
    rng = np.random.default_rng(3)
    truth = WN(0.1) + GM(0.2, 0.5)
    x = truth.simulate(20000, 0.02, rng)
    result = fit(x, "WN(N=0.1) + GM(beta=0.5)", rate_hz=50.0)
    assert result["WN1.N"].value == 0.1 and not result["WN1.N"].free
    assert result["GM1.beta"].value == pytest.approx(0.5, rel=1e-12)
    assert result["GM1.sigma"].free
    assert abs(result["GM1.sigma"].value - 0.2) < 4 * result["GM1.sigma"].standard_error
    assert result.covariance.shape == (1, 1)


def test_warnings_say_what_the_record_cannot_tell():
    rng = np.random.default_rng(4)
    white = fit(WN(0.1).simulate(20000, 0.01, rng), "WN() + RW()", rate_hz=100.0)
    if white["RW1.K"].value == 0:
        assert any("RW1" in w and "WN()" in w for w in white.warnings)
    assert white.curve is not None
    exact = replace(white.curve, value=(WN(0.01) + RW(0.1)).wavelet_variance(white.curve.scale_samples, 0.01))
    walk = fit(exact, "WN() + GM()")
    assert any("random walk" in w and "RW()" in w for w in walk.warnings)
    two = fit((GM(1.0, 0.5) + WN(0.1)).simulate(50000, 0.05, rng), "3*GM() + WN()", rate_hz=20.0)
    assert any("coincide" in w or "identifiable" in w or "hardly" in w or "not determined" in w for w in two.warnings)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fit(np.ones(100), "WN()", rate_hz=1.0), "zero"),
        (lambda: fit(np.arange(5.0), "3*GM() + WN()", rate_hz=1.0), "scale"),
        (lambda: fit(np.arange(50.0), "WN() + RC()", rate_hz=1.0), "RC"),
        (lambda: fit(np.arange(50.0), "WN()"), "rate"),
        (lambda: fit(np.arange(50.0), "WN()", "gmvm", rate_hz=1.0), "gmwm"),
        (lambda: fit(np.arange(50.0), "AR1(phi=0.5, sigma2=1, rate_hz=3)", rate_hz=1.0), "3 Hz"),
        (lambda: fit(np.random.default_rng(0).normal(size=64), "WN()", rate_hz=1.0, weighting="bootstrap"), "rng"),
        (lambda: fit(np.random.default_rng(0).normal(size=64), "WN()", rate_hz=1.0, weighting="all"), "weighting"),
    ],
)
def test_bad_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()


def a_fit() -> FitResult:
    rng = np.random.default_rng(8)
    x = (WN(1e-4) + GM(3e-4, 0.05)).simulate(30000, 0.01, rng)
    return fit(Series(x, 100.0, "rad/s", "gyro_x"), "GM() + WN()")


def test_json_has_the_stable_keys_and_is_json():
    out = json.loads(json.dumps(a_fit().to_json(), allow_nan=False))
    assert {"model", "parameters", "objective", "converged", "warnings", "fitted_wavelet_variance"} <= set(out)
    assert [(p["process"], p["index"], p["name"], p["unit"]) for p in out["parameters"]] == [
        ("GM", 1, "sigma", "rad/s"),
        ("GM", 1, "beta", "1/s"),
        ("WN", 1, "N", "rad/s/sqrt(Hz)"),
    ]
    assert_allclose(out["fitted_wavelet_variance"]["tau_s"][:3], [0.02, 0.04, 0.08])


def test_saved_fits_are_models_that_load(tmp_path):
    result = a_fit()
    save({"gyro_x": result}, tmp_path / "fit.yaml")
    (loaded,) = load(tmp_path / "fit.yaml").values()
    for one, two in zip(loaded, result.model, strict=True):
        assert one.parameters == two.parameters
