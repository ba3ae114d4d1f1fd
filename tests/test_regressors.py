"""Regressors beside noise: what they take from the wavelet variance is added back exactly; coefficients come back; wrong input is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg
from typer.testing import CliRunner

from insemu.cli import app
from insemu.covariates import regressors_of
from insemu.errors import InputError
from insemu.fit import fit_regressed
from insemu.fit.regressors import _Blocks, _taken
from insemu.formats import write
from insemu.noise import GM, RW, WN, NoiseModel
from insemu.records import Series
from tests.regressor_experiments import MODELS, TRUE, signal_of


def test_what_the_regressors_take_is_exact() -> None:
    n, model = 128, WN(N=1.0) + RW(K=0.3)
    t = np.linspace(-1.0, 1.0, n)
    X = np.column_stack([t, np.cos(2.0 * t), np.sign(np.sin(9.0 * t))])
    blocks = _Blocks.of(np.zeros(n), X, 1.0)
    assert blocks.m == 1
    _, C = blocks.solved(model)
    taken = _taken(X, C, 1.0, 6)
    V = linalg.toeplitz(model.difference_covariance(1, 1.0, n - 1))
    D = np.diff(X, axis=0)
    np.testing.assert_allclose(C, linalg.inv(D.T @ linalg.solve(V, D)), rtol=1e-8, atol=1e-12)
    left = np.eye(n - 1) - D @ C @ D.T @ linalg.inv(V)
    whole = np.vstack([np.zeros(n - 1), np.tril(np.ones((n - 1, n - 1)))])  # samples from differences
    for j in range(1, 7):
        m = 2 ** (j - 1)
        step = np.concatenate([-np.ones(m), np.ones(m)]) / (2 * m)
        A = np.array([np.pad(step, (k, n - 2 * m - k)) for k in range(n - 2 * m + 1)])
        B = A @ whole @ left
        seen = float(np.mean(np.einsum("ki,ij,kj->k", B, V, B)))
        expected = float(model.wavelet_variance(np.array([2 * m]), 1.0)[0])
        assert seen + taken[j - 1] == pytest.approx(expected, rel=1e-9)
    assert taken[-1] > 0.2 * expected  # without it the longest scale would be far too low


def test_coefficients_and_noise_come_back() -> None:
    series, columns = signal_of(MODELS["walk"], 18_000, np.random.default_rng(11))
    found = fit_regressed(series, columns, NoiseModel.parse("WN() + RW()"))
    for c in found.coefficients:
        assert abs(c.value - TRUE[c.name]) < 4.0 * c.standard_error
        assert c.low < c.value < c.high
        assert c.dof > 5.0
    assert abs(found.result["WN1.N"].value / 2e-4 - 1.0) < 0.03
    assert found.result["RW1.K"].low / 1.5 < 4e-6 < 1.5 * found.result["RW1.K"].high
    whole = series.values - series.values.mean()
    row = found.to_json()["regressors"][0]
    assert row["interval"] == [found.coefficients[0].low, found.coefficients[0].high]
    np.testing.assert_allclose(found.residual + found.part, whole, atol=1e-12)
    # an offset and the unit of a regressor change nothing but the unit of its coefficient
    fahrenheit = {"f": 1.8 * columns["temperature"] + 32.0, "time": columns["time"]}
    again = fit_regressed(series, fahrenheit, NoiseModel.parse("WN() + RW()"))
    assert again["f"].value == pytest.approx(found["temperature"].value / 1.8, rel=1e-6)
    assert again["f"].standard_error == pytest.approx(found["temperature"].standard_error / 1.8, rel=1e-4)


def test_regressors_are_read_as_they_are_written() -> None:
    x = np.concatenate([np.zeros(50), np.ones(450)])
    found = regressors_of("temperature, temperature^2, lag(temperature, 5 s), time", {"temperature": x}, 500, 0.1, "r")
    assert list(found) == ["temperature", "temperature^2", "lag(temperature, 5 s)", "time"]
    np.testing.assert_allclose(found["temperature^2"], (x - x.mean()) ** 2)
    lag = found["lag(temperature, 5 s)"]
    assert lag[49] == 0.0
    assert lag[50 + 49] == pytest.approx(1.0 - np.exp(-50 / 50.0), rel=1e-6)
    assert found["time"][-1] == pytest.approx(49.9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("temprature", "no regressor 'temprature'"),
        ("lag(temperature, 5 m)", "m"),
        ("lag(temperature, 0 s)", "expected a time above zero"),
        ("time, time", "twice"),
        (" , ", "found nothing"),
    ],
)
def test_what_names_no_regressor_is_said(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        regressors_of(text, {"temperature": np.arange(9.0)}, 9, 1.0, "--regressors")


@pytest.mark.parametrize(
    ("columns", "model", "message"),
    [
        ({}, "WN()", "no regressor"),
        ({"a": np.ones(400)}, "WN()", "does not change"),
        ({"a": np.arange(399.0)}, "WN()", r"expected \(400,\)"),
        ({"a": np.where(np.arange(400) == 7, np.nan, 1.0)}, "WN()", "nan at sample 7"),
        ({"a": np.arange(400.0), "b": 3.0 - 2.0 * np.arange(400.0)}, "WN()", "made up of the others"),
        ({"a": np.arange(400.0)}, "WN() + DR()", "write it as a regressor"),
    ],
)
def test_what_cannot_be_fitted_is_said(columns: dict[str, np.ndarray], model: str, message: str) -> None:
    series = Series(np.random.default_rng(1).standard_normal(400), 10.0, "rad/s", "gyro_x")
    with pytest.raises(InputError, match=message):
        fit_regressed(series, columns, NoiseModel.parse(model))


def test_the_command_estimates_both(tmp_path: Path) -> None:
    series, columns = signal_of(MODELS["walk"], 6000, np.random.default_rng(2))
    log, page = tmp_path / "log.csv", tmp_path / "page.html"
    write(log, [series, Series(columns["temperature"], series.rate_hz, "", "temperature")])
    line = ["fit-regressors", str(log), "-m", "WN()", "--regressors", "temperature"]
    result = CliRunner().invoke(app, [*line, "--page", str(page)])
    assert result.exit_code == 0, result.output
    assert "regressors" in result.output
    assert "temperature" in page.read_text()


def test_a_rate_table_gives_scale_factor_and_bias_per_kelvin(tmp_path: Path) -> None:
    """The sizes of Nikolic et al. 2016, section IV-D: 150 ppm/K of scale and 40 deg/h/K of bias while the chamber warms from 25 to 65 degC."""
    rng, rate_hz, n = np.random.default_rng(4), 5.0, 9000
    temperature = 25.0 + 40.0 * np.linspace(0.0, 1.0, n) ** 0.7
    table = np.deg2rad(np.repeat(rng.choice([-180.0, -90.0, 0.0, 90.0, 180.0], n // 100), 100))
    scale, scale_per_kelvin, bias_per_kelvin = 1.012, 150e-6, np.deg2rad(40.0 / 3600.0)
    warm = temperature - temperature.mean()
    noise = (WN(2e-4) + GM(5e-5, 0.02)).simulate(n, 1.0 / rate_hz, rng)
    signal = table * (scale + scale_per_kelvin * warm) + bias_per_kelvin * warm + noise
    log = tmp_path / "table.csv"
    columns = (("gyro_x", "rad/s", signal), ("table", "rad/s", table), ("temperature", "", temperature))
    write(log, [Series(v, rate_hz, unit, name) for name, unit, v in columns])
    terms = "table, temperature, table * temperature"
    line = ["fit-regressors", str(log), "-m", "WN() + GM()", "--regressors", terms, "--json"]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 0, result.output
    (axis,) = json.loads(result.stdout)["axes"].values()
    found = {row["name"]: row for row in axis["regressors"]}
    for name, true, most in (
        ("table", scale, 1e-4),
        ("temperature", bias_per_kelvin, 0.1 * bias_per_kelvin),
        ("table * temperature", scale_per_kelvin, 0.02 * scale_per_kelvin),
    ):
        row = found[name]
        assert abs(row["value"] - true) < 5.0 * row["standard_error"] and row["standard_error"] < most, name
    (white, *_) = axis["parameters"]
    assert white["name"] == "N"
