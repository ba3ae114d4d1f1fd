"""A bias that jumps and stays: emulated, taken off, named in a drive and in a log at rest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.foreign import judge, sensors
from benchmarks.foreign.judge import drawn, taken
from benchmarks.trial.run import Job
from insemu.effects import Column, EffectUse, effect_of
from insemu.gap import applied, find_gap, find_static_gap
from insemu.gap.beliefs.refined import refined_nominal, uses_of
from insemu.gap.candidates import bias_steps
from insemu.gap.candidates.axis import state_of
from insemu.gap.candidates.shapes import Change, linear_hypotheses
from insemu.gap.data.log import reduce
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import columns_response
from insemu.gap.evidence.model import Explanation
from insemu.gap.evidence.starts import Starts
from insemu.gap.hypothesis import Found, Hypothesis, best_first
from insemu.gap.problems import drive_without
from insemu.gap.problems.drive import DriveProblem
from insemu.gap.problems.joint_estimate import gauss_newton_step
from insemu.noise import WN, NoiseModel
from insemu.records import Series

NOISE, RATE = 1e-3, 20.0


def log(size: float, start: float, seconds: float = 3600.0, seed: int = 5) -> Series:
    """White noise with a step of its bias, in standard deviations of the mean of the log."""
    n = round(seconds * RATE)
    t = (np.arange(n) + 0.5) / RATE
    y = np.random.default_rng(seed).standard_normal(n) * NOISE * math.sqrt(RATE)
    return Series(y + size * NOISE / math.sqrt(seconds) * (t > start), RATE, "rad/s", "gyro_x")


def test_it_is_injected_and_taken_off_at_its_time() -> None:
    use = EffectUse.from_mapping({"effect": "bias_step", "sensor": "gyro", "value": [0.0, 2.0, 0.0], "start": 0.95})
    added = use.effect.added(use, np.arange(1, 21) * 0.1, None)
    assert np.all(added[:, [0, 2]] == 0.0) and np.all(added[:9, 1] == 0.0) and np.all(added[10:, 1] == 2.0)
    assert added[9, 1] == pytest.approx(1.0)  # of the sample in which it jumps its share


def test_the_response_to_a_step_is_that_of_its_signal() -> None:
    scene = Scene.of(Flown.of(*taken(sensors.draw_world(660001, 120.0, True), ())).prepared)
    t, start = scene.motion.t, float(scene.motion.t[3000])
    steps, effect = (t > start + 1e-6).astype(float), effect_of("bias_step")
    for axis, sensor in ((1, "gyro"), (5, "accel")):
        column = Column.of(effect, sensor, "value", (), ((axis, steps),))
        whole = scene.whitened(columns_response(scene.loop, scene.motion, [column]))[:, 0]
        window = scene.whitened(scene.window_answers([(3 + axis, start, math.inf)]))[:, 0]
        assert np.linalg.norm(window) > 1.0
        np.testing.assert_allclose(window, whole, atol=0.01 * np.abs(whole).max())
        column = scene.bias_step_columns(axis, np.array([start]))[:, 0]  # the same terms added in another order
        np.testing.assert_allclose(column, window, atol=1e-9 * np.abs(whole).max())


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_step_in_a_drive_is_named_with_its_time_and_closes_the_gap() -> None:
    world, (hidden,), (worth,) = drawn(judge.Job("jump", 660002, 240.0, True))
    assert worth > 20.0
    measured, nominal = taken(world, (hidden,))
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    (found,) = report.findings
    assert (found.effect, found.sensor, found.axes) == ("bias_step", hidden.sensor, tuple(hidden.axis))
    value, start = found.parameters
    assert value.low < hidden.values["value"] < value.high and start.low < hidden.values["start"] < start.high
    assert 0.1 < found.metres < 10.0  # a vertical accelerometer, in a minute without fixes
    refined = refined_nominal(nominal, applied(report, [1]), measured.imu.dt).parted()
    again = find_gap(measured, refined, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_a_process_that_is_weighed_again_keeps_its_rival_that_jumps() -> None:
    """A random walk one nat ahead of a step stood alone with its likes, because only columns were weighed again."""
    problem = DriveProblem(
        Scene.of(Flown.of(*taken(sensors.draw_world(660001, 120.0, True), ())).prepared), None, 3.0, ()
    )
    ranked = best_first(linear_hypotheses(problem.scene, problem.variants, problem.data, (), ()))
    walk = next(r for r in ranked if r.effect == "random_walk")
    jump = Hypothesis(
        "bias_step", walk.nats - 1.0, (), Change(window=(5, 60.0, math.inf)), "step", walk.sensor, walk.axes
    )
    old = Found(walk, tuple(best_first([*ranked, jump])))
    problem.found = [old]
    again = problem.again(old)
    assert again is not None and again.rival is not None and again.rival.change.window is None
    (kept,) = (r for r in again.ranked if r.effect == "bias_step")
    assert kept.nats == pytest.approx(again.kept.nats - 1.0)


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_its_size_is_estimated_with_all_other_numbers() -> None:
    world, (hidden,), _ = drawn(judge.Job("jump", 660002, 240.0, True))
    measured, nominal = taken(world, (hidden,))
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    (found,) = report.findings
    half = replace(found, parameters=(found.parameters[0].scaled(0.5), *found.parameters[1:]))
    known = replace(nominal, effects=(*nominal.effects, *uses_of(half))).parted()
    step = gauss_newton_step(*drive_without(measured, known), (half,))
    (value, start) = step.findings[0].parameters
    assert step.gain > 5.0 and value.low < hidden.values["value"] < value.high
    assert start == found.parameters[1]


@pytest.mark.parametrize(("size", "named"), [(0.0, False), (30.0, True), (300.0, True)])
def test_a_step_at_rest_is_named_where_it_is_one(size: float, named: bool) -> None:
    belief = {"gyro_x": NoiseModel((WN(NOISE),))}
    report = find_static_gap([log(size, 1403.0)], belief, rng=np.random.default_rng(1))
    assert report.verdict == ("named" if named else "nothing missing")
    for found in report.findings:
        value, start = found.parameters
        assert found.effect == "bias_step"
        assert value.low < size * NOISE / 60.0 < value.high
        assert start.low < 1403.0 < start.high
    assert report.gap_after.low < 1.0 < report.gap_after.high


def test_a_later_piece_of_a_log_lies_behind_the_step() -> None:
    state = state_of(reduce(log(60.0, 900.0)), Explanation.nominal(NoiseModel((WN(NOISE),))))
    (found,) = bias_steps.at_rest(state)
    (regressors,) = found.change.explanation.regressors
    assert regressors.rebuild is not None and regressors.columns.any()
    np.testing.assert_array_equal(regressors.rebuild(state.data, None), regressors.columns)
    assert not regressors.rebuild(reduce(log(0.0, 0.0, 1200.0)), None).any()


def test_a_start_is_as_likely_at_any_time() -> None:
    times = np.arange(10.0, 110.0, 10.0)
    assert Starts.even(times, np.zeros(10)).nats == pytest.approx(0.0)
    peak = Starts.even(times, np.where(times == 50.0, 20.0, 0.0))
    assert peak.best == 50.0 and peak.nats == pytest.approx(20.0 - math.log(10.0), abs=1e-6)
    # evidence of a narrow place, tried closely: it is paid for the width of that place
    close = peak.refined(lambda t: np.where(np.abs(t - 53.0) < 1.0, 30.0, 0.0))
    assert close.cells.sum() == pytest.approx(peak.cells.sum())
    assert close.nats == pytest.approx(30.0 + math.log(2.0 / 100.0), abs=1e-3)
    best = close.estimate()
    assert 52.0 <= best.low <= best.value <= best.high <= 54.0


def test_a_trial_hides_one_at_rest_that_is_worth_what_it_asks_for() -> None:
    found = Job("static", ("bias_step",), 60.0, 901, hours=0.3).run()
    (hidden,) = found.hidden
    assert hidden.nats == pytest.approx(60.0, rel=0.05)
    assert found.steps[0].effect == "bias_step"
    assert found.steps[0].gain_nats == pytest.approx(hidden.nats, abs=3.0 * math.sqrt(2.0 * hidden.nats))
