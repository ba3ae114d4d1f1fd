"""The linear twin agrees with the full filter realization by realization, and its draws with the covariance analysis."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.evaluate import Experiment, LinearTwin, analyse_designs, planimetric, previewed, segments
from insemu.evaluate import coarse as coarse_twin
from insemu.evaluate.coarse import CoarseTwin
from insemu.evaluate.control import controlled
from insemu.filters import Extras, Gains, Intervals, carried, gains_along, on_ideal_data
from insemu.filters import twin as linear_errors
from insemu.scenario import load
from insemu.strapdown import NavState, mechanize_array
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
    preview = previewed(linear, 400)
    assert list(preview.beyond) == ["white"]  # and not "full", which knows its errors
    figures = {name: preview.figures_of(name) for name in linear.designs}
    assert {name: (one.by, one.runs) for name, one in figures.items()} == {
        "white": ("coarse", 33),
        "full": ("linear", 400),
    }
    apart = coarse.draw(400, ["white"], first=33)["white"]  # runs that the preview has not seen
    spread = planimetric(apart).std(axis=0)
    for k in range(len(linear.ends)):
        one = preview.figures_of("white", k)
        error = np.hypot(spread[k] / 20.0, one.mean.width / 3.92)
        assert abs(one.mean.value - planimetric(apart[:, k]).mean()) < 4.4 * error
        assert one.rms == pytest.approx(
            np.sqrt((planimetric(apart[:, k]) ** 2).mean()), rel=4.4 * np.sqrt(0.5 / 33 + 0.5 / 400)
        )
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
    drawn = CoarseTwin(linear, list(linear.designs)).draw(n, list(linear.designs))
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
    assert run(str(path), "--linear", "500", "--output", str(out), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["linear"] is True and [r["design"] for r in printed["rows"]] == ["white", "full"]
    assert json.loads((out / "summary.json").read_text()) == printed and printed["not_linear"] == {}
    assert "Every design is linear" in (out / "index.html").read_text()
    (out / "complete.json").write_text("{}")
    assert run(str(path), "--linear", "500", "--output", str(out)) == 2
    assert "holds the results of flights" in capsys.readouterr().err
    out = tmp_path / "flown"
    assert run(str(path), "--linear", "500", "--shard", "1/2") == 2
    assert "--shard and --linear exclude each other" in capsys.readouterr().err
    assert run(str(path), "--control", "500", "--output", str(out)) == 0
    assert "linear realizations" in capsys.readouterr().out
    cell = json.loads((out / "control.json").read_text())["designs"]["full"][0]
    assert cell["correlation"] > 0.9 and cell["used"]


def test_what_has_no_twin_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="deterministic effects"):
        effects = [{"effect": "scale_factor", "sensor": "accel", "value": "2000 ppm"}]
        LinearTwin(made(tmp_path, truth=SCENARIO["truth"] | {"effects": effects}))


def along(experiment: Experiment, rows: np.ndarray) -> tuple:
    """Record, reference and intervals of an experiment's flight."""
    record, start = experiment.world.imu.as_increments(), NavState.of(experiment.world.reference)
    nav = mechanize_array(record, start, gravity=experiment.world.gravity)
    return record, nav, start, Intervals.of(record, nav, experiment.world.gravity, rows)


@pytest.mark.parametrize("extras", [Extras(), Extras(gyro_scale=1e-3, accel_misalignment=2e-3)])
def test_gains_and_stated_covariances_are_those_of_the_filters_own_steps(tmp_path: Path, extras: Extras) -> None:
    # white noise, a slow and a fast process, a random walk
    own = {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=0.05 s) + RW(K=1 deg/h/sqrt(s))",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=1 mg, Tc=200 s)",
    }
    experiment = made(tmp_path, designs={"own": own})
    fixes = experiment.world.recording(0, ideal=True).gnss
    plain = type(fixes)(fixes.t, fixes.llh, fixes.vel_ned)
    ekf = experiment.ekf("own").with_options(extras=extras)
    ends = np.array([s + d for s, d in experiment.world.outage_windows])
    rows = np.searchsorted(experiment.world.imu.t, ends - 1e-9)
    events = ekf.events(experiment.world.imu.t, plain)
    record, nav, start, intervals = along(experiment, np.concatenate([events.epoch, rows]))
    sigma = experiment.scenario.initial.sigma
    _, run = on_ideal_data(ekf, record, nav, plain, start, sigma, record.t[rows])
    rates = intervals.projected(np.hstack([record.gyro, record.accel]) / record.widths(0.0))
    found, stated = gains_along(
        ekf, record, nav, plain, (start, sigma), rows, (intervals, carried(intervals, ekf.augmentation, rates))
    )
    expected = Gains.of(run)
    scale = np.sqrt(np.einsum("oii->oi", run.covariance))
    assert (
        np.abs((stated - run.covariance) / (scale[:, :, None] * scale[:, None])).max() < 1e-5
    )  # LEFT, squared, and rounding
    size = np.abs(expected.K).max(axis=0)
    assert np.abs((found.K - expected.K)[:, size > 0] / size[size > 0]).max() < 1e-4
    np.testing.assert_array_equal(found.used, expected.used)


@pytest.mark.parametrize("record", [None, "500 s"])
def test_mean_squares_without_a_draw(tmp_path: Path, record: str | None) -> None:
    experiment = made(tmp_path, truth=SCENARIO["truth"] | {"record": record})
    twin = LinearTwin(experiment)
    found, drawn = twin.mean_square(), twin.draw(4000, twin.rng)
    for name, errors in drawn.items():
        seen = np.einsum("roi,roj->oij", errors, errors) / len(errors)
        scale = np.sqrt(np.einsum("oii->oi", found[name]))
        off = np.abs(seen - found[name]) / (scale[:, :, None] * scale[:, None])
        assert off.max() < 5.0 * np.sqrt(2.0 / 4000)  # of products of Gaussian errors, 81 of them at every end
    if record is None:  # the covariance analysis moves by the filter's own steps
        for name, analysis in analyse_designs(experiment).items():
            at = np.searchsorted(analysis.t, experiment.world.imu.t[twin.ends] - 1e-9)
            scale = analysis.rms[at]
            off = np.abs(found[name] - analysis.actual[at]) / (scale[:, :, None] * scale[:, None])
            assert off.max() < 1e-5


def test_draws_are_the_same_in_batches_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = LinearTwin(made(tmp_path, truth=SCENARIO["truth"] | {"record": "500 s"}))
    whole = twin.draw(50, twin.rng)
    monkeypatch.setattr(segments, "BATCH", 2000)
    for name, errors in twin.draw(50, twin.rng).items():
        np.testing.assert_allclose(errors, whole[name], rtol=1e-9, atol=1e-9)
    coarse = CoarseTwin(twin, ["full"])
    runs = coarse.draw(5, ["full"])["full"]
    monkeypatch.setattr(coarse_twin, "BATCH", 2)
    np.testing.assert_allclose(coarse.draw(2, ["full"], first=3)["full"], runs[3:], rtol=1e-7, atol=1e-7)


def test_what_errors_do_is_the_same_backward_and_however_the_reference_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = made(tmp_path)
    twin = LinearTwin(experiment)
    rng = np.random.default_rng(3)
    axes = rng.standard_normal((len(experiment.world.imu), 6)).cumsum(axis=0) * 1e-6
    start, noise = rng.standard_normal((1, 9)) * 0.1, rng.standard_normal((1, twin.epoch.size, 6))
    axes[0] = 0.0
    drive, at_fixes = twin.intervals.drive(axes)[None], axes[None, twin.epoch]
    for system in twin.designs.values():
        forward = system.respond(start, drive, at_fixes, noise, twin.ends)[0]
        for row, expected in zip(twin.ends, forward, strict=True):
            gain, of_start, of_fixes = system.adjoint(int(row), np.eye(9))
            backward = np.einsum("kia,ka->i", gain, axes[: row + 1]) + of_start @ start[0]
            backward += np.einsum("fia,fa->i", of_fixes, noise[0])
            np.testing.assert_allclose(backward, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    few = twin.intervals.nodes.size
    monkeypatch.setattr(linear_errors, "LONGEST", 0.1)  # eight polynomials hold at most eight rows exactly
    nodes = np.concatenate([twin.epoch, twin.ends])
    _, _, _, fine = along(experiment, nodes)
    assert fine.nodes.size > 3 * few
    at = fine.at(twin.intervals.nodes)
    for k, (a, b) in enumerate(pairwise(at)):
        F, moved = np.eye(9), np.zeros(9)
        for j in range(a, b):
            F, moved = fine.F[j] @ F, fine.F[j] @ moved + fine.drive(axes)[j] if k < 3 else moved
        if k < 3:
            np.testing.assert_allclose(moved, twin.intervals.drive(axes)[k], rtol=1e-5, atol=1e-5 * np.abs(moved).max())
        np.testing.assert_allclose(F, twin.intervals.F[k], rtol=1e-9, atol=1e-9)
