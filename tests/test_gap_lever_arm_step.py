"""An antenna that moves on the vehicle once and stays: emulated, taken off, named with its time."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

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
from insemu.gap.candidates.shapes import Change
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import ARMS, Scene
from insemu.gap.evidence.starts import Starts
from insemu.gap.hypothesis import Found, Hypothesis
from insemu.gap.problems import drive_without
from insemu.gap.problems.drive import DriveProblem
from insemu.gap.problems.joint_estimate import gauss_newton_step
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
    behind = (before.t > 60.1)[:, None]
    for name in ("llh", "vel_ned"):
        own, first, last = (getattr(g, name) for g in (changed, before, after))
        # an arm that is the sum of two differs by its rounding, and the sums over it by theirs: some eps of what is added up
        np.testing.assert_allclose(own, np.where(behind, last, first), rtol=1e-14, atol=1e-14 * np.abs(first).max())
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
        # all starts in one product and two alone: sums of the same terms in another order
        np.testing.assert_allclose(scene.arm_columns[:, axis::3][:, [5, 20]], scene.arm_steps(axis, some), atol=1e-9)


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


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_change_is_named_with_its_time(train) -> None:
    _, _, hidden, report = train
    (found,) = report.findings
    assert (found.effect, found.sensor, found.axes) == ("lever_arm_step", "gnss", tuple(hidden.axis))
    value, start = found.parameters
    assert value.low < hidden.values["value"] < value.high and start.low < hidden.values["start"] < start.high
    assert 0.1 < found.metres < 10.0


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_change_that_was_found_closes_the_gap(train) -> None:
    measured, nominal, _, report = train
    refined = refined_nominal(nominal, applied(report, [1]), measured.imu.dt).parted()
    again = find_gap(measured, refined, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_its_size_is_estimated_with_all_other_numbers(train) -> None:
    measured, nominal, hidden, report = train
    (found,) = report.findings
    half = replace(found, parameters=(found.parameters[0].scaled(0.5), *found.parameters[1:]))
    known = replace(nominal, effects=(*nominal.effects, *uses_of(half))).parted()
    step = gauss_newton_step(*drive_without(measured, known), (half,))
    value, start = step.findings[0].parameters
    assert step.gain > 5.0 and value.low < hidden.values["value"] < value.high
    assert start == found.parameters[1]


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_change_that_the_filter_follows_within_a_fix_is_found_at_that_fix() -> None:
    """At evenly spaced times it was found a minute off: a second beside it, it is worth 97 of its 146 nats."""
    world, (hidden,), _ = drawn(judge.Job("rarer", 6042, 360.0, True))
    measured, nominal = taken(world, (hidden,))
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    value, start = report.findings[0].parameters
    assert report.findings[0].effect == "lever_arm_step"
    assert start.low < hidden.values["start"] < start.high < start.low + 2.0
    assert value.low < hidden.values["value"] < value.high


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_it_gives_way_to_a_lever_arm_that_explains_more_throughout() -> None:
    """A walker's, beside a temperature: named first as a change 9 s behind the start, and 13 nats better as an arm."""
    world, hidden, _ = drawn(judge.Job("two", 790045, 360.0, True))
    recording, believed = taken(world, hidden)
    report = find_gap(recording, believed, rng=np.random.default_rng(790045), hold_out=False, pictures=False)
    assert {s.effect for s in report.findings} == {h.effect for h in hidden} == {"lever_arm", "temperature"}


def test_starts_in_cells_of_their_own_stand_in_the_place_of_those_there() -> None:
    even = Starts.even(np.arange(5.0, 100.0, 10.0), np.zeros(10))
    more = even.with_more(np.array([14.0, 58.0]), np.array([4.0, 1.0]), np.array([0.0, 30.0]))
    assert sorted(more.times) == [5.0, 14.0, 25.0, 35.0, 45.0, 55.0, 58.0, 65.0, 75.0, 85.0, 95.0]
    assert more.best == 58.0 and more.cells[-1] == 1.0
    assert more.nats == pytest.approx(30.0 + math.log(1.0 / more.cells.sum()), abs=1e-6)


def test_it_is_asked_for_once_known_or_found() -> None:
    def skipped(known: tuple[str, ...], *found: str) -> set[str]:
        uses = tuple(SimpleNamespace(id=name) for name in known)
        original = SimpleNamespace(nominal=SimpleNamespace(effects=uses))
        each = [Found(Hypothesis(name, 30.0, (), Change(), "", "gnss", ()), ()) for name in found]
        return DriveProblem._skip(
            SimpleNamespace(found=each, scene=SimpleNamespace(noise=None, original=original), without=())
        )

    assert "lever_arm_step" not in skipped(())
    assert "lever_arm_step" in skipped(("lever_arm_step",)) & skipped((), "lever_arm_step")
    # what a wrong time leaves in second order goes with the acceleration, as what a filter of the positions is behind does
    assert "gnss_position_filter" not in skipped((), "lever_arm")
    assert "gnss_position_filter" in skipped(("imu_gnss_time_offset",)) & skipped((), "clock_drift")
