"""The linear twin agrees with the full filter realization by realization, and its draws with the covariance analysis."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.evaluate import Experiment, LinearTwin, analyse_designs, planimetric, previewed
from insemu.evaluate.coarse import CoarseTwin
from insemu.evaluate.control import beyond_linear, controlled
from insemu.scenario import load
from tests.test_run import SCENARIO, run, write

pytestmark = pytest.mark.usefixtures("without_pictures")

TWO = {
    "variants": {},
    "fits": None,
    "designs": {
        "white": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz))", "accel": "WN(N=90 ug/sqrt(Hz))"},
        "full": SCENARIO["designs"]["full"],
    },
    "gnss": SCENARIO["gnss"] | {"lever_arm": ["1 m", "0.5 m", "-0.5 m"]},
}


def made(tmp_path: Path, **changes: object) -> Experiment:
    path = write(tmp_path, **TWO | changes)
    return Experiment(load(path), path)


def test_the_twin_errs_as_the_filter_does(tmp_path: Path) -> None:
    experiment = made(tmp_path)
    twin = LinearTwin(experiment)
    at = np.searchsorted(experiment.world.output_times, experiment.world.imu.t[twin.ends] - 1e-9)
    for r in range(2):
        full, linear = experiment.realization(r)["error"], twin.realization(r)
        for name, found in linear.items():
            expected = full.sel(design=name).to_numpy()[at]
            # metres of drift to a few per cent; the attitude, which fixes hold, to a tenth of its sigma
            np.testing.assert_allclose(
                found[:, :6], expected[:, :6], rtol=0.05, atol=0.05 * planimetric(expected).max()
            )
            assert planimetric(found - expected).max() < 0.05 * planimetric(expected).max()


@pytest.mark.parametrize(
    "record", [None, pytest.param("500 s", marks=pytest.mark.slow(reason="another case of a quick test"))]
)
def test_draws_have_the_covariance_of_the_analysis(tmp_path: Path, record: str | None) -> None:
    experiment = made(tmp_path, truth=SCENARIO["truth"] | {"record": record})
    twin = LinearTwin(experiment)
    n = 2000
    drawn = twin.draw(n, np.random.default_rng(5))
    for name, analysis in analyse_designs(experiment).items():
        at = np.searchsorted(analysis.t, experiment.world.imu.t[twin.ends] - 1e-9)
        ratio = (drawn[name] ** 2).mean(axis=0) / analysis.rms[at] ** 2
        if record is None:  # chi-square, 2000 draws, 1e-4 over 18 figures: 1 +- 4.4 sqrt(2 / n)
            assert np.abs(ratio - 1.0).max() < 4.4 * np.sqrt(2.0 / n)
        else:  # the mean of the record is taken off, which the analysis leaves out
            flown = np.stack([twin.realization(r)[name] for r in range(60)])
            for component in (0, 1):
                seen = (flown[..., component] ** 2).mean() / (drawn[name][..., component] ** 2).mean()
                assert abs(np.log(seen)) < 4.0 * np.sqrt(2.0 / 60)


def test_the_coarse_twin_errs_as_the_filter_does_where_the_linear_one_does_not(tmp_path: Path) -> None:
    # slow errors far beyond what the design "white" believes: angles and gains leave what the first order describes
    truth = {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=300 deg/h, Tc=100 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=40 mg, Tc=4000 s)",
    }
    experiment = made(tmp_path, truth=truth, gnss=SCENARIO["gnss"])
    linear = LinearTwin(experiment)
    coarse = CoarseTwin(linear, ["white"])
    assert coarse.rows == 10  # 0.2 s at 50 Hz
    assert list(beyond_linear(linear)) == ["white"]  # and not "full", which knows its errors
    told = previewed(linear, 400)
    assert {name: len(errors) for name, errors in told.errors.items()} == {"white": 100, "full": 400}
    at = np.searchsorted(experiment.world.output_times, experiment.world.imu.t[linear.ends] - 1e-9)
    off = {"linear": 0.0, "coarse": 0.0}
    for r in range(4):
        full = experiment.realization(r)["error"].sel(design="white").to_numpy()[at]
        for label, twin in (("linear", linear), ("coarse", coarse)):
            off[label] = max(off[label], planimetric(twin.realization(r)["white"] - full).max())
    assert off["coarse"] < 0.1 * off["linear"], off


@pytest.mark.slow(reason="hours of flight or many realizations")
@pytest.mark.parametrize("record", [None, "500 s"])
def test_coarse_draws_are_distributed_as_linear_ones(tmp_path: Path, record: str | None) -> None:
    linear = LinearTwin(made(tmp_path, truth=SCENARIO["truth"] | {"record": record}))
    n = 200
    drawn = CoarseTwin(linear, list(linear.designs)).draw(n, np.random.default_rng(8))
    many = linear.draw(4000, np.random.default_rng(9))
    for name, errors in drawn.items():  # chi-square, 1e-4 over 18 figures of correlated components
        ratio = (errors[..., :6] ** 2).mean(axis=0) / (many[name][..., :6] ** 2).mean(axis=0)
        assert np.abs(np.log(ratio)).max() < 4.4 * np.sqrt(2.0 / n + 2.0 / 4000), ratio


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_a_control_variate_narrows_and_holds_the_mean_and_is_refused_without_correlation() -> None:
    rng = np.random.default_rng(7)
    held = [0, 0]
    widths = []
    for _ in range(40):
        x = np.abs(rng.standard_normal(40)) * 100.0
        y = 1.1 * x + 5.0 * rng.standard_normal(40)
        found = controlled(y, x, np.abs(rng.standard_normal(10_000)) * 100.0)
        truth = 110.0 * np.sqrt(2.0 / np.pi)
        held[0] += found.mean.low <= truth <= found.mean.high
        held[1] += found.plain_mean.low <= truth <= found.plain_mean.high
        widths.append(found.plain_mean.width / found.mean.width)
        assert found.used and found.saved > 30
    assert min(held) >= 32  # binomial of 40 at 0.95: fewer with probability 3e-4
    assert np.median(widths) > 5.0
    x, y = rng.standard_normal((2, 40)) ** 2
    refused = controlled(y, x, x)
    assert not refused.used and refused.mean == refused.plain_mean and refused.saved == 1.0


def test_preview_and_help_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write(tmp_path, **TWO, realizations=4), tmp_path / "out"
    assert run(str(path), "--linear", "500", "--out", str(out), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["linear"] is True and [r["design"] for r in printed["rows"]] == ["white", "full"]
    assert not out.exists()
    assert run(str(path), "--linear", "500", "--shard", "1/2") == 2
    assert "--shard and --linear exclude each other" in capsys.readouterr().err
    assert run(str(path), "--control", "500", "--out", str(out)) == 0
    assert "linear realizations" in capsys.readouterr().out
    cell = json.loads((out / "control.json").read_text())["designs"]["full"][0]
    assert cell["correlation"] > 0.9 and cell["used"]


def test_what_has_no_twin_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="deterministic effects"):
        effects = [{"effect": "scale_factor", "sensor": "accel", "value": "2000 ppm"}]
        LinearTwin(made(tmp_path, truth=SCENARIO["truth"] | {"effects": effects}))
