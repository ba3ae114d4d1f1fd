"""Arrays of IMUs: the quadratic form is the covariance analysis, its minimum is one, units are told apart only as far as their logs do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from insemu.array import EQUAL, METRES, Flight, by_unit, gathered, quadratic
from insemu.array.session import _summed
from insemu.array.weights import equal, inverse_variance, regressed, scale_wise, wavelet_matrices
from insemu.cli import app
from insemu.errors import InputError
from insemu.evaluate import Experiment, analyse_designs
from insemu.formats import read_static, write
from insemu.noise import GM, WN, NoiseModel, axis_unit, load, shared_processes
from insemu.records import AXES, Series
from insemu.scenario import load as load_scenario

SCENARIO = """
title: A minute without fixes
seed: 3
trajectory: {builtin: urban_drive_1, rate: 10 Hz, duration: 200 s}
truth:
  gyro: WN(N=0.01 deg/s/sqrt(Hz)) + GM(sigma=0.02 deg/s, Tc=100 s)
  accel: WN(N=2e-3 m/s^2/sqrt(Hz))
gnss: {position_sigma: 1 m, velocity_sigma: 0.1 m/s, lever_arm: [1 m, 0 m, 0 m], outages: [{start: 150 s, duration: 30 s}]}
initial: {heading_sigma: 2 deg}
designs: {white: {gyro: WN(N=0.03 deg/s/sqrt(Hz)), accel: WN(N=3e-3 m/s^2/sqrt(Hz))}}
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("array") / "scenario.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def flight(scenario: Path) -> Flight:
    return Flight(load_scenario(scenario), scenario)


def _believed(scenario: Path) -> dict[str, NoiseModel]:
    sources = load_scenario(scenario).designs["white"].sources()
    return {a: m for a, m in sources.items() if isinstance(m, NoiseModel)}


def test_the_quadratic_form_is_the_covariance_analysis(scenario: Path, flight: Flight) -> None:
    s = load_scenario(scenario)
    s = s.model_copy(update={"gnss": s.gnss.model_copy(update={"lever_arm": (0.0, 0.0, 0.0)})})
    analysis = analyse_designs(Experiment(s, scenario))["white"]
    end = int(np.searchsorted(analysis.t, 180.0 - 1e-6))
    response = Flight(s, scenario).response(_believed(scenario))
    parts = sum(response.of_model(flight.own[a], a) for a in AXES)
    assert response.rest + parts == pytest.approx(float(np.sum(analysis.rms[end, :2] ** 2)), rel=1e-9)


def test_a_weighted_sum_is_worth_what_the_form_says(scenario: Path, flight: Flight) -> None:
    rng = np.random.default_rng(4)
    response = flight.response(_believed(scenario))
    models = {
        "gyro_x": [WN(N=n) + GM(sigma=s, Tc=50.0, shared=name) for n, s, name in ((1e-4, 2e-4, "a"), (3e-4, 1e-4, "-a"))],
        "gyro_y": [WN(N=n) + GM(sigma=2e-4, Tc=t) for n, t in ((1e-4, 20.0), (2e-4, 200.0))],
    }  # fmt: skip
    shared = shared_processes({f"gyro_x@{k}": m for k, m in enumerate(models["gyro_x"])})
    form = quadratic(response, models, shared, flight.own)
    for _ in range(3):
        w = {a: (lambda x: np.array([x, 1.0 - x]))(rng.uniform(-0.5, 1.5)) for a in models}
        whole = {a: NoiseModel(tuple(_summed(models[a], w[a]))) for a in models}
        expected = response.rest + sum(response.of_model(whole.get(a, flight.own[a]), a) for a in AXES)
        assert form.mean_square(w) == pytest.approx(expected, rel=1e-9)
    best = form.best()
    assert all(v.sum() == pytest.approx(1.0) for v in best.values())
    least = form.mean_square(best)
    for axis in models:
        for step in (-0.02, 0.02):
            assert form.mean_square({**best, axis: best[axis] + [step, -step]}) > least * (1 + 1e-9)
    # two units that see one process with opposite signs: their mean has less of it than either
    assert least < min(form.mean_square({**best, "gyro_x": np.array(w)}) for w in ([1.0, 0.0], [0.0, 1.0]))


def test_units_are_told_apart_only_as_far_as_their_logs_do() -> None:
    apart = np.log([1.0, 1.2, 0.8, 1.1, 0.9, 1.0])
    (alike, _), (told, sharp) = (
        regressed([(apart, np.full(6, 0.05))])[0],
        regressed([(3.0 * apart, np.full(6, 1e-4))])[0],
    )
    assert np.ptp(alike) < 0.3 * np.ptp(apart)
    assert np.ptp(told) > 0.98 * np.ptp(3.0 * apart)
    assert (sharp < 1.1e-4).all()
    # an estimate that says nothing becomes the mean of the others
    mean, variance = regressed([(np.array([0.0, 0.0, 0.0, 0.0, 8.0]), np.array([1e-3] * 4 + [1e4]))])[0]
    assert abs(mean[4]) < 0.3
    assert variance[4] > variance[0]


def test_scale_wise_weights_make_the_least_mean_wavelet_variance() -> None:
    rng = np.random.default_rng(2)
    common = 0.3 * rng.standard_normal(4096)
    signals = [Series(common + s * rng.standard_normal(4096), 10.0, "rad/s", "gyro_x") for s in (1.0, 0.5, 2.0)]
    matrices, p = wavelet_matrices(signals)
    w = scale_wise(matrices)
    assert w.sum() == pytest.approx(1.0)
    mean = matrices.mean(axis=0)
    assert np.ptp(mean @ w) < 1e-12 * mean.max() * 10
    assert p[1, 0] < 1e-6  # the common part is seen
    assert inverse_variance(signals)[1] == pytest.approx(
        1 / np.var(signals[1].values) / sum(1 / np.var(s.values) for s in signals)
    )


def test_columns_name_the_imu() -> None:
    def columns(*names: str) -> list[Series]:
        return [Series(np.arange(5.0), 10.0, "", n) for n in names]

    found = by_unit(columns("gx_1", "gy_1", "gx_2", "gy_2", "temperature"), "f")
    assert {u: sorted(axes) for u, axes in found.items()} == {"1": ["gyro_x", "gyro_y"], "2": ["gyro_x", "gyro_y"]}
    assert list(by_unit(columns("imu1_gyro_x", "gyro_x@left", "accel_z"), "f")) == ["imu1", "left", "imu"]
    with pytest.raises(InputError, match="twice"):
        by_unit(columns("gx_1", "1_gx"), "f")
    with pytest.raises(InputError, match="no column of an IMU"):
        by_unit(columns("temperature", "magx"), "f")
    one = by_unit(columns("gx_1", "gx_2"), "f")
    with pytest.raises(InputError, match="expected gyro_x as 1"):
        gathered({"1": one["1"], "2": by_unit(columns("gy"), "f")["imu"]})
    with pytest.raises(InputError, match="two or more"):
        gathered({"1": one["1"]})


def test_lost_samples_of_a_unit_are_filled_in_and_said() -> None:
    """The other samples stay in step with those of the other unit, and the noise is as white as it was."""
    rng = np.random.default_rng(4)
    values = rng.standard_normal((2, 20_000))
    lost = rng.random(20_000) < 0.03
    logs = {
        name: {"gyro_x": Series(np.where(lost & (name == "two"), np.nan, x), 100.0, "rad/s", "gyro_x", gaps=True)}
        for name, x in zip(("one", "two"), values, strict=True)
    }
    said: list[str] = []
    signals, units = gathered(logs, said.append)
    found = signals["gyro_x"][units.index("two")].values
    assert np.array_equal(found[~lost], values[1, ~lost])
    assert 0.9 < found[lost].std() < 1.1 and abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 0.03
    assert said == [f"{lost.sum()} samples of gyro_x of two are lost: they are filled in by the samples around them"]
    logs["two"]["gyro_x"] = Series(
        np.where(rng.random(20_000) < 0.2, np.nan, values[1]), 100.0, "rad/s", "gyro_x", gaps=True
    )
    with pytest.raises(InputError, match="an array needs all of them"):
        gathered(logs)


def _logs(folder: Path) -> list[str]:
    """Two IMUs of one axis: the second has far less noise."""
    rng = np.random.default_rng(8)
    out = []
    for name, factor in (("one", 1.0), ("two", 0.25)):
        values = factor * 1e-3 * np.sqrt(10.0) * rng.standard_normal(6000)
        series = [Series(values, 10.0, axis_unit("gyro_x"), "gyro_x")]
        out.append(str(folder / f"{name}.npz"))
        write(out[-1], series)
    return out


def test_the_command_writes_a_virtual_sensor(tmp_path: Path, scenario: Path) -> None:
    logs, out, log = _logs(tmp_path), tmp_path / "models.yaml", tmp_path / "virtual.npz"
    written = ["-o", out, "--log", log, "--page", tmp_path / "p.html"]
    line = [*map(str, ["array", *logs, "-m", "WN()", "--scenario", scenario, *written]), "--json"]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    by = {w["name"]: w for w in told["weightings"]}
    w = np.array(by[METRES]["weights"]["gyro_x"])
    np.testing.assert_allclose(w, [1 / 17, 16 / 17], atol=0.01)
    assert by[METRES]["rms_m"] < by[EQUAL]["rms_m"]
    assert by[METRES]["interval"][1] < 1.0
    parts = [{s.name: s.values for s in read_static(f)}["gyro_x"] for f in logs]
    virtual = {s.name: s.values for s in read_static(log)}["gyro_x"]
    np.testing.assert_allclose(virtual, w[0] * parts[0] + w[1] * parts[1], rtol=1e-9, atol=1e-15)
    N = load(out)["gyro_x"].processes[0].parameters["N"]
    assert N == pytest.approx(1e-3 / np.sqrt(17.0), rel=0.05)
    assert "metres at outage end" in (tmp_path / "p.html").read_text()


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--take", "best"], "--take"),
        (["--log", "x.txt"], "expected .npz or .csv"),
        (["--plus", "gyro=RC()"], "expected a model with values"),
        (["--scenario", "no_such"], "no_such"),
    ],
)
def test_wrong_options_are_said(tmp_path: Path, extra: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["array", *_logs(tmp_path), "-m", "WN()", *extra])
    assert result.exit_code != 0
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)


def test_weights_are_those_of_their_formulas() -> None:
    rng = np.random.default_rng(6)
    signals = [Series(s * rng.standard_normal(512), 10.0, "rad/s", "gyro_x") for s in (1.0, 0.5, 2.0)]
    assert equal(3) == pytest.approx([1 / 3] * 3)
    precision = np.array([1.0 / np.mean((s.values - s.values.mean()) ** 2) for s in signals])
    assert inverse_variance(signals) == pytest.approx(precision / precision.sum())
    # variances 1, 4 and 9 at one scale and 3, 2, 1 at another, without correlation: one over their means
    matrices = np.array([np.diag([1.0, 4.0, 9.0]), np.diag([3.0, 2.0, 1.0])])
    assert scale_wise(matrices) == pytest.approx(np.array([1 / 2, 1 / 3, 1 / 5]) / (1 / 2 + 1 / 3 + 1 / 5))


def test_units_are_drawn_to_the_mean_by_what_they_may_differ() -> None:
    """The posterior of a normal hierarchy by quadrature over mean and spread, written out for two units and two groups."""
    groups = [(np.array([0.0, 0.6, 0.2]), np.array([0.04, 0.01, 0.09])), (np.array([1.0, 1.3]), np.array([0.02, 0.02]))]
    tau, mu = np.linspace(0.0, np.log(10.0), 1201), np.linspace(-15.0, 15.0, 6001)
    likelihood, moments = np.ones(tau.size), []
    for y, v in groups:
        rows = []
        for t in tau:
            density = np.exp(-0.5 * np.sum((y[:, None] - mu) ** 2 / (v[:, None] + t**2), axis=0)) / np.sqrt(
                np.prod(v + t**2)
            )
            # given mean and spread, a unit is normal around what its estimate and the mean make of it
            centre = (y[:, None] * t**2 + mu * v[:, None]) / (v[:, None] + t**2)
            within = v * t**2 / (v + t**2)
            rows.append(
                [density.sum(), *(centre @ density), *(centre**2 @ density + within * density.sum())]
            )  # spread of mu is common to all
        table = np.array(rows)
        likelihood *= table[:, 0]
        moments.append(table[:, 1:] / table[:, :1])
    weight = likelihood / likelihood.sum()
    for (mean, variance), of, (y, _) in zip(regressed(groups), moments, groups, strict=True):
        first, second = np.split(weight @ of, [y.size])
        assert mean == pytest.approx(first, abs=3e-3)
        assert variance == pytest.approx(second - first**2, rel=0.03)
