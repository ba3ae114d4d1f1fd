"""An antenna that moves on the vehicle once and stays: emulated, taken off, named with its time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.foreign import judge, sensors
from benchmarks.foreign.judge import drawn, taken
from insemu import earth
from insemu.effects import EffectUse, compensated
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.gap import applied, find_gap
from insemu.gap.beliefs.refined import refined_nominal, uses_of
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import ARMS, Scene
from insemu.gap.problems import drive_without
from insemu.gap.problems.together import left
from insemu.records import Recording

ARM = (1.2, -0.3, 0.8)


def use(start: float, *value: float) -> EffectUse:
    return EffectUse.from_mapping({"effect": "lever_arm_step", "value": list(value), "start": start})


def test_the_antenna_moves_at_its_time_and_is_put_back() -> None:
    made = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 120.0), mode="continuous")
    moved = tuple(a + b for a, b in zip(ARM, (0.5, -0.4, 0.3), strict=True))
    it = use(60.1, 0.5, -0.4, 0.3)

    def fixes(arm, *effects: EffectUse):
        return gnss_fixes(made.reference, 4.0, 0.0, 0.0, arm, rng=np.random.default_rng(1), effects=effects)

    before, after, changed = fixes(ARM), fixes(moved), fixes(ARM, it)
    behind = before.t > 60.1
    for name in ("llh", "vel_ned"):
        own, first, last = (getattr(g, name) for g in (changed, before, after))
        np.testing.assert_array_equal(own[~behind], first[~behind])
        np.testing.assert_array_equal(own[behind], last[behind])
    measured = Recording(made.imu, changed)
    back = compensated(measured, [it], trajectory=made.reference, lever_arm=ARM).gnss
    assert np.abs(earth.position_difference(before.llh, back.llh)).max() < 0.02
    assert np.abs(before.vel_ned - back.vel_ned).max() < 0.02
    alone = compensated(replace(measured, gnss=changed.without_velocity()), [it], trajectory=made.reference).gnss
    assert alone.vel_ned is None
    with pytest.raises(InputError, match="lever_arm_step"):
        compensated(measured, [it])


def test_a_change_at_the_start_is_the_lever_arm() -> None:
    scene = Scene.of(Flown.of(*taken(sensors.draw_world(660001, 120.0, True), ())).prepared)
    columns = scene.data.G
    for axis, name in enumerate("xyz"):
        (j,) = (k for k, c in enumerate(scene.columns) if (c.effect, c.label) == ("lever_arm", f"value_{name}"))
        whole = scene.whitened(scene.window_answers([(ARMS + axis, -math.inf, math.inf)]))[:, 0]
        assert np.linalg.norm(whole) > 1.0
        np.testing.assert_allclose(whole, columns[:, j], atol=1e-9 * np.abs(whole).max())
        some = scene.arm_starts[[5, 20]]
        windows = scene.window_answers([(ARMS + axis, float(s), math.inf) for s in some])
        np.testing.assert_allclose(scene.arm_steps(axis, some), scene.whitened(windows), atol=1e-9)
        first = axis * scene.arm_starts.size
        np.testing.assert_array_equal(scene.arm_columns[:, [first + 5, first + 20]], scene.arm_steps(axis, some))


@pytest.fixture(scope="module")
def train():
    """A train of another simulator whose antenna moves by a metre."""
    world, (hidden,), (worth,) = drawn(judge.Job("rarer", 2, 240.0, True))
    assert hidden.effect == "lever_arm_step" and worth > 20.0
    measured, nominal = taken(world, (hidden,))
    return (
        measured,
        nominal,
        hidden,
        find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False),
    )


def test_a_change_is_named_with_its_time_and_closes_the_gap(train) -> None:
    measured, nominal, hidden, report = train
    (found,) = report.findings
    assert (found.effect, found.sensor, found.axes) == ("lever_arm_step", "gnss", tuple(hidden.axis))
    value, start = found.parameters
    assert value.low < hidden.values["value"] < value.high and start.low < hidden.values["start"] < start.high
    assert 0.1 < found.metres < 10.0
    refined = refined_nominal(nominal, applied(report, [1]), measured.imu.dt).parted()
    again = find_gap(measured, refined, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_its_size_is_estimated_with_all_other_numbers(train) -> None:
    measured, nominal, hidden, report = train
    (found,) = report.findings
    half = replace(found, parameters=(found.parameters[0].scaled(0.5), *found.parameters[1:]))
    known = replace(nominal, effects=(*nominal.effects, *uses_of(half))).parted()
    step = left(*drive_without(measured, known), (half,))
    value, start = step.findings[0].parameters
    assert step.gain > 5.0 and value.low < hidden.values["value"] < value.high
    assert start == found.parameters[1]
