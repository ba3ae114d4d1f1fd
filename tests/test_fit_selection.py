"""Choice among models: what is tried, what is chosen, and what the command says."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from insemu import units
from insemu.cli import app
from insemu.errors import InputError
from insemu.fit import likelihood
from insemu.fit.covariance import model_covariance
from insemu.fit.selection import nested, prediction_distance, rank_models, select
from insemu.formats import read_static
from insemu.noise import AR, GM, RW, WN, NoiseModel, load
from insemu.variance import chi_square_interval, eta3, wavelet_variance
from tests.shared_data import shared

GENERAL = NoiseModel.parse("2*GM() + WN() + RW()")


def curve_of(model, n=100_000, rate=100.0, seed=1):
    return wavelet_variance(model.simulate(n, 1.0 / rate, np.random.default_rng(seed)), rate)


def test_nested_models_are_all_and_once():
    found = {str(m) for m in nested(NoiseModel.parse("2*GM() + WN()"))}
    assert found == {"GM()", "2*GM()", "WN()", "GM() + WN()", "2*GM() + WN()"}
    assert len(nested(NoiseModel.parse("4*GM() + WN() + RW() + QN()"))) == 39


@pytest.mark.parametrize("truth", [NoiseModel((WN(0.1),)), WN(0.1) + RW(0.02), GM(0.2, 0.5) + WN(0.05)], ids=str)
def test_the_true_structure_is_chosen(truth):
    ranking = select(curve_of(truth), GENERAL, name="x")
    assert sorted(p.symbol for p in ranking.chosen.structure) == sorted(p.symbol for p in truth)
    assert ranking.discrepancy == 0.0
    assert str(ranking.chosen.structure) in ranking.verdict
    assert ranking.fit.criterion is not None and ranking.fit.converged
    values = [c.criterion.value for c in ranking.candidates]
    assert values == sorted(values)


def test_weak_structure_no_candidate_has_does_not_hide_the_slow_part():
    # a filter in the sensor colours the shortest scales by per cents; the slow part must survive it
    rng = np.random.default_rng(2)
    n, rate = 400_000, 100.0
    fast = AR((0.25, -0.12, 0.05), sigma2=1.0, rate_hz=rate).simulate(n, 1 / rate, rng)
    x = fast + GM(0.1, 0.02).simulate(n, 1 / rate, rng)
    ranking = select(wavelet_variance(x, rate), GENERAL)
    assert ranking.discrepancy > 0.003
    slow = [p for p in ranking.fit.model if isinstance(p, GM) and p.parameters["beta"] < 1.0] + [
        p for p in ranking.fit.model if isinstance(p, RW)
    ]
    assert slow
    assert "error of every candidate" in ranking.verdict


def test_the_chosen_model_has_one_test_of_fit():
    """Where the record has structure that no candidate has, the table allowed for it and the fit below it did not: p = 0.63 and p = 0."""
    rng = np.random.default_rng(2)
    n, rate = 400_000, 100.0
    fast = AR((0.25, -0.12, 0.05), sigma2=1.0, rate_hz=rate).simulate(n, 1 / rate, rng)
    curve = wavelet_variance(fast + GM(0.1, 0.02).simulate(n, 1 / rate, rng), rate)
    ranking = select(curve, WN() + GM() + RW())
    assert ranking.discrepancy > 0.003
    assert ranking.fit.test is not None
    in_table, below = ranking.chosen.p_value, ranking.fit.test.p_value
    assert in_table > 0.05 and below > 0.05
    assert ranking.fit.test.statistic == pytest.approx(ranking.chosen.objective, rel=0.5, abs=2.0)


def test_a_walk_that_fills_the_last_scales_alone_is_kept():
    """In weights of the model with the walk its scales are uncertain: white noise was chosen whose own test of fit had p = 1e-28."""
    for seed in range(10):
        ranking = select(curve_of(WN(0.1) + RW(0.04), n=16_384, seed=seed), GENERAL)
        assert any(isinstance(p, RW) or (isinstance(p, GM) and p.parameters["beta"] < 0.1) for p in ranking.fit.model)
        assert ranking.fit.test.p_value > 1e-4


def test_given_candidates_are_ranked():
    ranking = rank_models(curve_of(WN(0.1) + RW(0.02)), [NoiseModel((WN(),)), NoiseModel((WN(), RW()))])
    assert ranking.chosen.structure == NoiseModel((WN(), RW()))
    assert len(ranking.candidates) == 2
    with pytest.raises(InputError, match="no candidate"):
        rank_models(curve_of(NoiseModel((WN(0.1),))), [])


def test_prediction_distance_is_one_for_the_truth_and_large_for_another():
    truth = WN(0.1) + RW(0.02)
    found = [prediction_distance(truth, curve_of(truth, n=20_000, seed=k))[0] for k in range(40)]
    error = prediction_distance(truth, curve_of(truth, n=20_000))[1]
    assert abs(np.mean(found) - 1.0) < 4.5 * error / np.sqrt(40)
    assert np.std(found) < 2.0 * error
    assert prediction_distance(WN(0.12) + RW(0.02), curve_of(truth))[0] > 20


def test_prediction_error_grows_with_the_scatter_of_the_fit():
    truth = WN(0.1) + RW(0.02)
    curve = curve_of(truth, n=20_000)
    V = model_covariance(truth, curve.n_samples, curve.scale_samples, 0.01)
    one, both = (prediction_distance(truth, curve, fit_covariance=C) for C in (None, V))
    assert one[0] == pytest.approx(both[0], rel=1e-12)
    assert both[1] == pytest.approx(2.0 * one[1], rel=1e-12)


def test_a_long_log_is_fitted_in_pieces_by_integrated_likelihood(tmp_path, monkeypatch):
    x = (WN(0.1) + GM(0.1, 0.5)).simulate(30_000, 0.01, np.random.default_rng(4))
    np.save(tmp_path / "log.npy", x)
    arguments = ["fit", str(tmp_path / "log.npy"), "--rate", "100 Hz", "--method", "mli", "--model", "WN() + GM()"]
    held = CliRunner().invoke(app, [*arguments, "--skip", "10 s", "--json"])
    monkeypatch.setattr(likelihood, "LARGE", 10_000)
    streamed = CliRunner().invoke(app, [*arguments, "--skip", "10 s", "--json"])
    assert held.exit_code == streamed.exit_code == 0, streamed.output
    one, other = (json.loads(r.stdout)["axes"]["log"] for r in (held, streamed))
    assert one["n_samples"] == other["n_samples"] == 29_000
    # both searches end within 1e-5 of the log-likelihood, sqrt(2e-5) = 0.0045 standard errors of the top
    for a, b in zip(one["parameters"], other["parameters"], strict=True):
        assert b["value"] == pytest.approx(a["value"], abs=0.02 * a["standard_error"])
    bad = x.copy()
    bad[20_000] = np.nan
    np.save(tmp_path / "log.npy", bad)
    ran = CliRunner().invoke(app, arguments)
    assert isinstance(ran.exception, InputError) and "1 of 30000 samples are missing" in str(ran.exception)


def a_log(tmp_path, model, columns=("gx", "az"), n=20_000):
    rng = np.random.default_rng(3)
    data = np.stack([model.simulate(n, 0.01, rng) for _ in columns], axis=1)
    path = tmp_path / "log.npz"
    units = ["rad/s" if c.startswith("g") else "m/s^2" for c in columns]
    np.savez(path, data=data, fs=100.0, columns=np.array(columns), units=np.array(units))
    return path


def test_fit_command_prints_the_stable_json(tmp_path):
    path = a_log(tmp_path, WN(0.1) + GM(0.1, 0.5))
    ran = CliRunner().invoke(
        app,
        [
            "fit",
            str(path),
            "--model",
            "GM() + WN()",
            "--json",
            "--output",
            str(tmp_path / "m.yaml"),
        ],
    )
    assert ran.exit_code == 0, ran.output
    axes = json.loads(ran.stdout)["axes"]
    assert list(axes) == ["gyro_x", "accel_z"]
    for axis in axes.values():
        assert {"model", "parameters", "objective", "converged", "warnings", "fitted_wavelet_variance"} <= set(axis)
        assert axis["model"] == "GM() + WN()"
        assert set(axis["parameters"][0]) >= {"process", "index", "name", "value", "unit", "standard_error"}
    assert set(load(tmp_path / "m.yaml")) == {"gyro_x", "accel_z"}


@pytest.mark.parametrize(
    "arguments",
    [
        ["--model", "GM() + WN()"],
        ["--model", "GM() + WN()", "--pooled"],
        ["--model", "GM() + WN()", "--robust"],
        ["--model", "WN()", "--bootstrap", "20"],
        ["--model", "GM() + WN()", "--method", "em"],
        ["--model", "GM() + WN()", "--method", "mli"],
        ["--model", "WN() + RW()", "--method", "slopes"],
        ["--model", "AR(2)", "--method", "burg"],
    ],
    ids=lambda a: " ".join(a[2:]),
)
def test_fit_command_shows_tables(tmp_path, arguments):
    path = a_log(tmp_path, WN(0.1) + GM(0.1, 0.5), n=6000)
    ran = CliRunner().invoke(app, ["fit", str(path), *arguments])
    assert ran.exit_code == 0, ran.output
    assert "estimate" in ran.output


def test_scales_of_the_command_are_seconds_of_the_curve(tmp_path):
    """From 1.28 s and to 20.48 s at 100 Hz: five scales, weighed alone. A structure of one level has its estimate in closed form."""
    path = a_log(tmp_path, WN(0.1), n=6000)
    ran = CliRunner().invoke(
        app, ["fit", str(path), "--model", "WN()", "--tau-from", "1280 ms", "--tau-to", "0.3414 min", "--weighting", "intervals", "--json"]
    )  # fmt: skip
    assert ran.exit_code == 0, ran.output
    for series in read_static(path):
        curve = wavelet_variance(series.values, 100.0)
        use = (curve.scale_samples >= 128) & (curve.scale_samples <= 2048)
        assert use.sum() == 5
        freedom = eta3(curve.scale_samples.astype(float), curve.n_samples)
        low, high = chi_square_interval(curve.value, freedom, 0.95)
        weight, unit = ((high - low) ** -2)[use], 1.0 / curve.tau_s[use]
        level = np.sqrt((weight * unit) @ curve.value[use] / (weight @ unit**2))
        (found,) = json.loads(ran.stdout)["axes"][series.name]["parameters"]
        assert units.parse(f"{found['value']} {found['unit']}", f"{series.unit}/sqrt(Hz)") == pytest.approx(
            level, rel=1e-6
        )


def test_denoising_says_its_rule_and_differs_by_axis(tmp_path):
    path = a_log(tmp_path, WN(0.1) + GM(0.1, 0.5), n=6000)
    given = ["fit", str(path), "--model", "AR(1)", "--method", "burg"]
    ran = CliRunner().invoke(app, [*given, "--denoise", "approximation:5,accel_z=3", "--json"])
    assert ran.exit_code == 0, ran.output
    axes = json.loads(ran.stdout)["axes"]
    said = {name: axis["warnings"][-1] for name, axis in axes.items()}
    assert {name: text.split(" first")[0] for name, text in said.items()} == {
        name: f"{3 if name == 'accel_z' else 5} octaves were left out" for name in axes
    }
    for wrong, message in (
        ("6", "one of: sure:6, universal:6, approximation:6"),
        ("approximation:5,gyro_w=3", "unknown axis 'gyro_w'"),
        ("sure:five", "expected a whole number"),
    ):
        ran = CliRunner().invoke(app, [*given, "--denoise", wrong])
        assert isinstance(ran.exception, InputError) and message in str(ran.exception)
    ran = CliRunner().invoke(app, ["fit", str(path), "--model", "WN()", "--denoise", "sure:6"])
    assert isinstance(ran.exception, InputError) and "belongs to burg" in str(ran.exception)


def test_select_command_and_its_page(tmp_path):
    path = a_log(tmp_path, WN(0.1) + RW(0.1), columns=("gx",))
    page = tmp_path / "page.html"
    ran = CliRunner().invoke(
        app,
        [
            "select",
            str(path),
            "--general",
            "GM() + WN() + RW()",
            "--held-out",
            str(path),
            "--page",
            str(page),
            "--json",
        ],
    )
    assert ran.exit_code == 0, ran.output
    axis = json.loads(ran.stdout[: ran.stdout.rindex("}") + 1])["axes"]["gyro_x"]
    assert axis["model"] == "WN() + RW()"
    assert sum(c["chosen"] for c in axis["candidates"]) == 1
    assert len(axis["held_out"][str(path)]["tau_s"]) == len(axis["held_out"][str(path)]["measured"])
    text = page.read_text()
    assert "WN() + RW()" in text and 'class="chart' in text


def test_bad_input_of_the_command_is_named(tmp_path):
    path = a_log(tmp_path, NoiseModel((WN(0.1),)), n=500)
    ran = CliRunner().invoke(app, ["fit", str(path), "--model", "WM()"])
    assert isinstance(ran.exception, InputError) and "WN" in str(ran.exception)
    ran = CliRunner().invoke(app, ["fit", str(path), "--model", "WN()", "--method", "em", "--pooled"])
    assert isinstance(ran.exception, InputError)


@pytest.mark.slow(reason="real recordings of hours")
def test_real_static_logs_choose_models_that_predict_the_next_run():
    """Scale by scale: from 0.02 s to 40 s the prediction of run 2 holds within a quarter (deviation)."""
    folder = shared("real")
    from insemu.formats import read

    one = {s.name: s for s in read(folder / "adis16405_static_run1.npz")}
    two = {s.name: s for s in read(folder / "adis16405_static_run2.npz")}
    for axis in ("gyro_x", "gyro_y", "accel_x", "accel_z"):
        # the first 40 minutes are warm-up
        ranking = select(
            wavelet_variance(one[axis].values[240_000:], 100.0), NoiseModel.parse("4*GM() + WN() + RW() + QN()")
        )
        other = wavelet_variance(two[axis].values[240_000:], 100.0)
        ratio = np.sqrt(other.value / ranking.fit.model.wavelet_variance(other.scale_samples, 0.01))
        assert np.abs(np.log(ratio[other.tau_s < 41])).max() < np.log(1.25), axis
