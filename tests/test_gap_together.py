"""What was found of a drive, estimated with all of it at once."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu.gap import Finding, Nominal
from insemu.gap.beliefs.refined import uses_of
from insemu.gap.evidence.fixes import NED
from insemu.gap.problems import drive_without
from insemu.gap.problems.joint_estimate import gauss_newton_step
from insemu.gap.problems.known_effects import all_outliers, struck_out
from insemu.gap.verdict import Value
from insemu.records import Recording

#: What is hidden, with what the first look took it for.
HIDDEN = (
    ("lever_arm", "gnss", ("x",), "value_x", 0.8, 0.6),
    ("imu_gnss_time_offset", "imu", (), "offset", 0.05, 0.042),
    ("gnss_velocity_filter", "gnss", ("down",), "tau_down", 0.4, 0.3),
    ("gnss_velocity_noise", "gnss", NED, "factor", 3.0, 2.2),
)


@functools.cache
def flight() -> tuple[Recording, Nominal]:
    drawn = stage(64, 4.0, 50.0, track="uav")
    effects = tuple(use for hidden in HIDDEN for use in uses_of(finding(*hidden[:4], hidden[4])))
    return drawn.record(effects), drawn.nominal


def finding(effect: str, sensor: str, axes: tuple[str, ...], name: str, value: float) -> Finding:
    return Finding(effect, "", sensor, axes, (Value(name, value, value - 1.0, value + 1.0, ""),), 1.0, 200.0, ())


def less(findings: Sequence[Finding]) -> tuple[Recording, Nominal]:
    measured, nominal = flight()
    effects = tuple(use for f in findings for use in uses_of(f))
    return drive_without(measured, replace(nominal, effects=effects).parted())


def test_numbers_together_are_the_true_ones() -> None:
    findings = tuple(finding(*hidden[:4], hidden[5]) for hidden in HIDDEN)
    gains = []
    for _ in range(3):
        step = gauss_newton_step(*less(findings), findings)
        gains.append(step.gain)
        findings = step.findings
    # each step leaves next to nothing of what the one before left, and the last one is chance: half a nat for each number
    assert gains[0] > 50.0 and gains[1] < 0.1 * gains[0] and abs(gains[2]) < 2.0
    for hidden, f in zip(HIDDEN, findings, strict=True):
        (v,) = f.parameters
        if v.name == "factor":
            assert v.value == pytest.approx(hidden[4], rel=0.1)
        else:
            assert v.low < hidden[4] < v.high, hidden[0]
            assert v.high - v.low < 0.5  # it was 2


def test_steps_in_the_fixes_are_among_the_numbers() -> None:
    """Of a step that was found beside another one only in part, and of one that is none."""

    def shift(value: float, axis: str, start: float) -> Finding:
        known = finding("gnss_multipath_step", "gnss", (axis,), "value", value)
        return replace(
            known,
            parameters=(
                *known.parameters,
                Value("start", start, start, start, "s"),
                Value("duration", 60.0, 60.0, 60.0, "s"),
            ),
        )

    measured, nominal = flight()
    use = tuple(u for hidden in HIDDEN for u in uses_of(finding(*hidden[:4], hidden[4])))
    known = replace(nominal, effects=use).parted()
    assert measured.gnss is not None
    up = measured.gnss.llh.copy()
    inside = (measured.gnss.t > 70.0) & (measured.gnss.t <= 130.0)
    up[inside, 2] -= 6.0
    moved = replace(measured, gnss=replace(measured.gnss, llh=up))
    findings = (shift(4.0, "down", 70.0), shift(2.0, "north", 100.0))
    effects = tuple(u for f in findings for u in uses_of(f))
    step = gauss_newton_step(*drive_without(moved, replace(known, effects=(*use, *effects)).parted()), findings)
    there, none = (f.parameters[0] for f in step.findings)
    assert step.gain > 5.0
    assert there.low < 6.0 < there.high and there.high - there.low < 2.0
    assert none.low < 0.0 < none.high
    assert [f.parameters[1:] for f in step.findings] == [f.parameters[1:] for f in findings]


def test_what_has_no_columns_stays_as_it_is() -> None:
    (outliers,) = (finding("gnss_outliers", "gnss", NED, "probability", 0.1),)
    step = gauss_newton_step(*less(()), (outliers,))
    assert step.findings == (outliers,) and step.gain == 0.0


def test_outliers_that_were_told_are_struck_out_again() -> None:
    whole = flight()[0]
    gnss = whole.gnss
    assert gnss is not None
    less_some = replace(whole, gnss=gnss.without_positions(gnss.t[[3, 40]]).without_velocities(gnss.t[[7]]))
    gone = struck_out(whole, less_some)
    assert gone["gnss_outliers"].tolist() == [3, 40] and gone["gnss_velocity_outliers"].tolist() == [7]
    again, _ = drive_without(whole, flight()[1].parted(), gone)
    assert again.gnss is not None and less_some.gnss is not None
    np.testing.assert_array_equal(again.gnss.llh, less_some.gnss.llh)
    np.testing.assert_array_equal(again.gnss.vel_ned, less_some.gnss.vel_ned)
    # of what is left the second position and the last velocity: they were the third and the last of all
    rest = all_outliers(
        whole,
        {"gnss_outliers": np.array([1, 40])},
        {"gnss_outliers": np.array([1]), "gnss_velocity_outliers": np.array([len(gnss) - 1])},
    )
    assert rest["gnss_outliers"].tolist() == [1, 2, 40] and rest["gnss_velocity_outliers"].tolist() == [len(gnss) - 1]
