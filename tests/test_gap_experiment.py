"""The next experiment: a hill parts a bias from a scale factor, nothing on a road parts scale factor and asymmetry, and the emulator agrees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from benchmarks.trial.drives import stage
from insemu.cli import main
from insemu.effects import EffectUse
from insemu.emulate import VEHICLES, read_waypoints, route
from insemu.errors import InputError
from insemu.gap import GapReport, Interval, design, promise_text, write_experiment
from insemu.gap.confusion import DRAWS
from insemu.gap.experiment import joined_up, primitives
from insemu.gap.verdict import Finding, Member, Value
from insemu.scenario import load

HOME = np.array([0.8, 0.1, 300.0])
NONE = Interval(float("nan"), float("nan"), float("nan"))


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_every_vehicle_can_do_most_primitives_and_two_of_them(vehicle: str) -> None:
    done = []
    for m in primitives(HOME, vehicle):
        try:
            path = route(m.waypoints, vehicle).flight.path
        except InputError:  # what a vehicle cannot do is left out
            continue
        done.append((m, path.end - path.start))
    assert len(done) >= 4
    straight, alone = next((m, seconds) for m, seconds in done if m.name == "straight at speed")
    twice = route(joined_up(straight, straight).waypoints, vehicle).flight.path
    assert twice.end - twice.start > 1.6 * alone


def report(*findings: Finding) -> GapReport:
    return GapReport("class", findings, (), (), NONE, NONE, NONE)


def test_without_a_class_there_is_nothing_to_design() -> None:
    s = stage(11, 1.5, 50.0, track="car")
    assert design(s.record(), s.nominal, report(), rng=np.random.default_rng(1)) is None
    with pytest.raises(InputError, match="unknown vehicle 'ship'"):
        design(s.record(), s.nominal, report(), rng=np.random.default_rng(1), vehicle="ship")


def test_a_vehicle_that_nobody_has_and_a_wrong_ending_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cases = {"unknown vehicle 'ship'": ["--vehicle", "ship"], "expected a file .yaml": ["--next", "next.csv"]}
    for message, words in cases.items():
        with pytest.raises(SystemExit) as stopped:
            main(["gap", "nowhere.yaml", "nothing.npz", *words])
        assert stopped.value.code == 2
        assert message in capsys.readouterr().err


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_members_of_a_class_that_are_one_effect_on_two_axes_are_told_apart() -> None:
    s = stage(11, 2.0, 50.0, track="car")
    use = EffectUse.from_mapping({"effect": "scale_factor", "sensor": "accel", "value": [0.0, 0.0, 0.02]})
    members = tuple(Member("scale_factor", "accel", (a,), 50.0) for a in "zx")
    found = Finding("scale_factor", "", "accel", ("z",), (Value("value_z", 0.02, 0.01, 0.03, "1"),), 0.5, 50.0, members)
    x = design(s.record([use]), s.nominal, report(found), rng=np.random.default_rng(1), recordings=0)
    assert x is not None
    assert {k: f.axes for k, f in x.truths.items()} == {("scale_factor", "accel", a): (a,) for a in "zx"}
    pair = (("scale_factor", "accel", "z"), ("scale_factor", "accel", "x"))
    assert x.best.distinguished[pair] > 0.9
    assert any(line.startswith("scale factor accel z from scale factor accel x: ") for line in promise_text(x))


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_hill_parts_a_bias_from_a_scale_factor_and_the_emulator_keeps_the_promise(tmp_path: Path) -> None:
    s = stage(11, 4.0, 50.0, track="car")
    use = EffectUse.from_mapping({"effect": "scale_factor", "sensor": "accel", "value": [0.0, 0.0, 0.02]})
    bias, scale, bent = (Member(e, "accel", ("z",), 50.0) for e in ("turn_on_bias", "scale_factor", "scale_asymmetry"))
    found = Finding(
        "turn_on_bias", "", "accel", ("z",), (Value("value_z", -0.2, -0.21, -0.19, "m/s^2"),), 0.4, 50.0, (bias, scale, bent),
    )  # fmt: skip
    x = design(s.record([use]), s.nominal, report(found), rng=np.random.default_rng(1), recordings=10)
    assert x is not None
    keys = {m.effect: (m.effect, m.sensor) for m in found.members}
    parted = (keys["scale_factor"], keys["turn_on_bias"])
    alike = (keys["scale_factor"], keys["scale_asymmetry"])
    assert x.now.distinguished[parted] < 0.2 and x.best.distinguished[parted] > 0.9
    assert "hill" in x.best.manoeuvre.name
    assert x.best.distinguished[alike] < 0.05
    # promise and emulation are counts of one share (Fisher's exact test): 6 pairs fail together once in 500,000
    for pair, (seen, count) in x.kept.items():
        promised = round(x.best.distinguished[pair] * DRAWS)
        assert 5 <= count <= 10  # one whose filter starts at another fix is not compared
        p = scipy.stats.fisher_exact([[promised, DRAWS - promised], [seen, count - seen]]).pvalue
        assert p > 2e-6 / len(x.kept)
    scenario, waypoints = write_experiment(x, tmp_path / "next.yaml")
    assert load(scenario).trajectory is not None
    again = read_waypoints(waypoints)
    np.testing.assert_allclose(again.llh, x.best.manoeuvre.waypoints.llh, atol=1e-10, rtol=1e-6)
    assert len(promise_text(x)) >= 7
    assert promise_text(replace(x, kept={})) != promise_text(x)
