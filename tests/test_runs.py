"""Several runs of one sensor: common model, spread, what the next switch-on will show, and scenarios that draw it."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from scipy.stats import chi2, norm

from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import EmulatedWorld
from insemu.fit import choose_model, fit_runs
from insemu.fit.runs import _spread, scatter_taken_off
from insemu.noise import GM, RW, WN, load_spread, with_factors
from insemu.records import Series
from insemu.scenario import load
from tests import runs_experiments as experiments

SEED = 18


def runs(spread: float, n: int = 40_000, count: int = 4, seed: int = SEED) -> list[Series]:
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        factors = np.exp(spread * rng.standard_normal(3))
        model = with_factors(experiments.BASE, dict(zip(experiments.labels_of(experiments.BASE), factors, strict=True)))
        out.append(experiments.log_of(model, n - 1000 * k, rng))  # of different lengths
    return out


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_one_sensor_is_near_stationary_and_its_joint_fit_is_sharper() -> None:
    found = fit_runs(runs(0.0), WN() + GM(), bootstrap=39, rng=np.random.default_rng(1))
    assert found.p_value > 0.05
    for e, true in zip(found.joint.parameters, experiments.values_of(experiments.BASE), strict=True):
        assert abs(np.log(e.value / true)) < 4.0 * e.standard_error / e.value
        assert e.standard_error < 0.75 * min(r[e.label].standard_error for r in found.each)
    assert all(s.next_low <= s.low <= s.common <= s.high <= s.next_high for s in found.spreads)
    assert all(s.log_low < s.next_low and s.next_high < s.log_high for s in found.spreads)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_runs_that_differ_are_said_to_and_their_spread_is_found() -> None:
    found = fit_runs(runs(0.4, count=6), WN() + GM(), bootstrap=39, rng=np.random.default_rng(1))
    assert found.p_value == pytest.approx(1 / 40)
    white = found.spreads[0]
    assert 0.15 < white.size < 1.0 < 2.0 * white.size_high
    assert np.allclose(np.sqrt(np.diag(found.covariance)), [s.size for s in found.spreads])
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12
    assert set(found.spread.parameters) == {"WN1.N", "GM1.sigma", "GM1.beta"}


def test_the_model_that_predicts_best_is_chosen_and_equivalent_ones_are_told() -> None:
    best, *rest = choose_model(runs(0.0), [WN() + RW(), WN() + GM(), WN() + 2 * GM()])
    assert str(best.model) in ("WN() + GM()", "WN() + 2*GM()")
    by_name = {str(c.model): c for c in (best, *rest)}
    assert by_name["WN() + GM()"].equivalent and not by_name["WN() + RW()"].equivalent
    assert by_name["WN() + RW()"].behind > 0.0


def test_what_cannot_be_joined_is_refused() -> None:
    a, b = runs(0.0, count=2)
    with pytest.raises(InputError, match="at least two"):
        fit_runs([a], WN() + GM())
    with pytest.raises(InputError, match="100, 50 Hz"):
        fit_runs([a, Series(b.values, 50.0, b.unit, b.name)], WN() + GM())


def test_from_logs_to_a_scenario_whose_sensor_is_another_each_time(tmp_path, capsys) -> None:
    rng = np.random.default_rng(5)
    files = []
    for k in range(3):
        columns = tuple(
            (
                with_factors(experiments.BASE, {"WN1.N": float(np.exp(0.5 * rng.standard_normal()))}).scaled(1e-3)
            ).simulate(4_000, 0.01, rng)
            for _ in range(6)
        )
        names, units = ("gx", "gy", "gz", "ax", "ay", "az"), ("rad/s",) * 3 + ("m/s^2",) * 3
        files.append(str(tmp_path / f"run{k}.npz"))
        np.savez(files[-1], data=np.stack(columns, axis=1), fs=100.0, columns=np.array(names), units=np.array(units))
    models = tmp_path / "models.yaml"
    with pytest.raises(SystemExit) as stop:
        main(["fit-runs", *files, "-m", "WN()", "-m", "WN() + RW()", "-o", str(models), "--bootstrap", "19"])
    assert stop.value.code == 0
    said = capsys.readouterr().out
    assert "switch-on" in said
    assert said.count("near-stationarity: p = 0.05: the runs differ") == 6
    assert load_spread(models)["gyro_x"].covariance[0, 0] > 0.01
    scenario = {
        "title": "t", "seed": 1, "realizations": 2,
        "trajectory": {"builtin": "static", "rate": "10 Hz", "duration": "20 s"},
        "truth": {"file": "models.yaml", "spread": True},
        "designs": {"d": {"gyro": "WN(N=1e-4)", "accel": "WN(N=1e-4)"}},
    }  # fmt: skip
    path = tmp_path / "s.yaml"

    def levels(truth: dict) -> np.ndarray:
        path.write_text(yaml.safe_dump({**scenario, "truth": truth}))
        world = EmulatedWorld(load(path), path)
        return np.array([world.pieces.piece(k)[0].std(axis=0) for k in range(6)])

    drawn, fixed = levels(scenario["truth"]), levels({"file": "models.yaml"})
    assert np.log(drawn).std(axis=0).mean() > 2.0 * np.log(fixed).std(axis=0).mean()
    assert np.array_equal(drawn, levels(scenario["truth"]))
    path.write_text(
        yaml.safe_dump({**scenario, "truth": {"gyro": "WN(N=1e-4)", "accel": "WN(N=1e-4)", "spread": True}})
    )
    with pytest.raises(InputError, match="spread without the key 'file'"):
        load(path)
    models.write_text(models.read_text().replace("spread:", "scatter:"))
    with pytest.raises(InputError, match="has no spread"):
        levels(scenario["truth"])


@pytest.mark.parametrize("count", [2, 3, 6, 12])
@pytest.mark.parametrize("spread", [0.0, 0.5, 1.0, 3.0, 10.0])
def test_intervals_hold_as_often_as_they_say_whatever_the_spread(count: int, spread: float) -> None:
    """Logs that scatter alike by 1: the mean is independent of the sum of squares, over which a quadrature goes (1.5e-3 by halving its cells)."""
    cells = (np.arange(300) + 0.5) / 300
    total, shape = 1.0 + spread**2, np.arange(count) - 0.5 * (count - 1.0)
    shape /= np.linalg.norm(shape)
    half = {"middle": [], "log": [], "next": []}
    for square in chi2.ppf(cells, count - 1) * total:
        row = _spread("", np.sqrt(square) * shape, np.ones(count), 1.0)
        for name, high in (("middle", row.high), ("log", row.log_high), ("next", row.next_high)):
            half[name].append(np.log(high))
    variance = {"middle": total / count, "log": total * (1.0 + 1.0 / count), "next": total * (1.0 + 1.0 / count) - 1.0}
    held = {k: float(np.mean(2.0 * norm.cdf(np.array(v) / np.sqrt(variance[k])) - 1.0)) for k, v in half.items()}
    assert held["middle"] == pytest.approx(0.95, abs=3e-3)
    assert held["log"] == pytest.approx(0.95, abs=3e-3)
    assert 0.92 < held["next"] < 0.975, held


def test_all_scatter_of_a_log_is_taken_off_where_runs_are_many() -> None:
    taken = [scatter_taken_off(r) for r in (2, 3, 6, 12, 100)]
    assert taken == sorted(taken)
    assert 0.3 < taken[0]
    assert taken[-1] < 1.0


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_intervals_for_the_next_run_hold_it() -> None:
    for spread in (0.0, 0.1, 0.4):
        at = experiments.coverage(spread, 60)
        for name in ("median", "seventh run", "its log"):
            assert 0.90 <= at[name] <= 0.99, (spread, name)  # 180 cases: 3 binomial standard deviations


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_near_stationarity_is_rejected_as_often_as_said() -> None:
    assert experiments.stationarity(0.0, 60, 59) <= 0.15  # binomial, 99.9 %
    assert experiments.stationarity(0.4, 12, 59) >= 0.9
