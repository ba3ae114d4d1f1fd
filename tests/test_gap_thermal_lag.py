"""A bias in a drive that follows the recorded temperature late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.foreign import judge, sensors
from benchmarks.foreign.judge import drawn, taken
from insemu.effects import Column, effect_of, lagged
from insemu.gap import find_gap
from insemu.gap.beliefs.refined import refined_nominal, uses_of
from insemu.gap.candidates.shapes import LAGGED, Change, bank, compatible
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import columns_response
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.problems import drive_without
from insemu.gap.problems.joint_estimate import gauss_newton_step
from insemu.gap.verdict import Finding, Value


@pytest.fixture(scope="module")
def flight():
    """A flight of another simulator in which a gyroscope follows the temperature late."""
    world, (hidden,), _ = drawn(judge.Job("rarer", 15, 360.0, True))
    assert hidden.effect == "temperature" and hidden.values["lag"] > 0.0
    return *taken(world, (hidden,)), hidden


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of(Flown.of(*taken(sensors.draw_world(660001, 240.0, True), ())).prepared)


def test_knots_hold_a_temperature_that_lags(scene) -> None:
    motion, effect = scene.motion, effect_of("temperature")
    late = [v for v in bank(scene) if v.label == LAGGED]
    assert {(v.sensor, v.axes) for v in late} == {(s, (a,)) for s in ("gyro", "accel") for a in "xyz"}
    v = next(v for v in late if (v.sensor, v.axes) == ("gyro", ("y",)))
    for (lag,), unit in v.shapes[::5]:
        d = lagged(motion.temperature, float(np.median(np.diff(motion.t))), lag) - 25.0
        column = Column.of(effect, "gyro", "c1_y", ("y",), ((1, d),))
        whole = scene.whitened(columns_response(scene.loop, motion, [column]))[:, 0]
        shape = scene.data.G[:, v.index] @ unit[:, 0] / effect.scale("c1", "gyro")
        np.testing.assert_allclose(shape, whole, atol=0.02 * np.abs(whole).max())


def test_an_axis_has_one_thermal_bias_where_it_lags(scene) -> None:
    variants = bank(scene)

    def thermal(*chosen: Hypothesis) -> set[tuple[str, str, str]]:
        return {(v.sensor, "".join(v.axes), v.label) for v in compatible(variants, chosen) if v.effect == "temperature"}

    plain, late = (Hypothesis("temperature", 30.0, (), Change(), label, "gyro", ("x",)) for label in ("linear", LAGGED))
    assert thermal() - thermal(plain) == {("gyro", "x", LAGGED)}
    assert thermal() - thermal(late) == {
        ("gyro", "x", LAGGED),
        ("gyro", "x", "linear"),
        ("gyro", "x", "cubic"),
        ("gyro", "xyz", "linear"),
    }


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_coefficient_and_lag_are_named_and_close_the_gap(flight) -> None:
    measured, nominal, hidden = flight
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    (found,) = report.findings
    assert (found.effect, found.variant, found.sensor, found.axes) == (
        "temperature",
        LAGGED,
        "gyro",
        tuple(hidden.axis),
    )
    c1, lag = found.parameters
    assert c1.low < hidden.values["value"] < c1.high and lag.low < hidden.values["lag"] < lag.high
    assert found.metres > 1.0
    (use,) = uses_of(found)
    assert use["lag"] == (lag.value,) and use["c1"]["xyz".index(hidden.axis)] == c1.value
    refined = refined_nominal(nominal, report, measured.imu.dt).parted()
    again = find_gap(measured, refined, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_its_coefficient_is_estimated_with_all_other_numbers(flight) -> None:
    """A column without the lag would move it elsewhere."""
    measured, nominal, hidden = flight
    size, late = hidden.values["value"], hidden.values["lag"]
    own = (Value(f"c1_{hidden.axis}", 0.5 * size, 0.0, size, ""), Value("lag", late, 0.0, 2.0 * late, "s"))
    half = Finding("temperature", LAGGED, "gyro", tuple(hidden.axis), own, 1.0, 50.0, ())
    known = replace(nominal, effects=(*nominal.effects, *uses_of(half))).parted()
    step = gauss_newton_step(*drive_without(measured, known), (half,))
    moved, same = step.findings[0].parameters
    assert step.gain > 5.0 and moved.low < hidden.values["value"] < moved.high
    assert same.value == hidden.values["lag"]
