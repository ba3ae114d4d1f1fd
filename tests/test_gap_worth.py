"""What a finding is worth in metres: closed forms of the field, and the whole filter through an outage."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu import earth
from insemu.errors import InputError
from insemu.gap import Finding, GapReport, Member, Value, applied
from insemu.gap.drive.corrected import corrected_data
from insemu.gap.drive.preparation import fast_parts, prepare
from insemu.gap.drive.scene import Scene
from insemu.gap.verdict import Interval
from insemu.gap.worth import (
    GRAVITY,
    at_rest,
    outages_along,
    worth_in_motion,
    worth_in_noise,
    worth_of_mounting,
    worth_of_white,
)
from insemu.noise import RW, WN, NoiseModel
from insemu.records import GnssRecord, Recording
from insemu.report.gap import finding_action, finding_metres

T = 60.0


def finding(effect: str, sensor: str, **values: float) -> Finding:
    member = Member(effect, sensor, ("x",), 50.0)
    parameters = tuple(Value(k, v, 0.9 * v, 1.1 * v, "1") for k, v in values.items())
    return Finding(effect, "", sensor, ("x",), parameters, 0.99, 50.0, (member,))


def outage(gnss: GnssRecord, start: float) -> GnssRecord:
    """Fixes without those of a minute from a time on, s."""
    inside = gnss.t[(gnss.t > start) & (gnss.t <= start + T)]
    return gnss.without_positions(inside).without_velocities(inside)


@pytest.mark.parametrize(
    ("effect", "name", "accel", "gyro"),
    [
        ("white_noise", "N", math.sqrt(T**3 / 3.0), GRAVITY * math.sqrt(T**5 / 20.0)),
        ("random_walk", "K", math.sqrt(T**5 / 20.0), GRAVITY * math.sqrt(T**7 / 252.0)),
        ("turn_on_bias", "value", T**2 / 2.0, GRAVITY * T**3 / 6.0),
        ("ramp", "R", T**3 / 6.0, GRAVITY * T**4 / 24.0),
    ],
)
def test_noise_grows_as_the_textbook_says(effect: str, name: str, accel: float, gyro: float) -> None:
    assert worth_in_noise(finding(effect, "accel", **{name: 1e-3})) == pytest.approx(1e-3 * accel, rel=5e-3)
    assert worth_in_noise(finding(effect, "gyro", **{name: 1e-5})) == pytest.approx(1e-5 * gyro, rel=5e-3)


def test_of_white_noise_only_what_was_not_believed_counts() -> None:
    found = finding("white_noise", "accel", N=5e-3)
    assert worth_in_noise(found, {"accel_x": 3e-3}) == pytest.approx(4e-3 * math.sqrt(T**3 / 3.0), rel=5e-3)


def test_white_noise_of_all_axes_adds_up() -> None:
    one, other = finding("white_noise", "gyro", N=1e-4), finding("white_noise", "accel", N=2e-3)
    both = worth_of_white(np.array([1e-8, 0.0, 0.0, 4e-6, 0.0, 0.0]), at_rest())
    assert both == pytest.approx(math.hypot(worth_in_noise(one), worth_in_noise(other)), rel=1e-9)
    assert math.isnan(worth_of_white(np.zeros(6), at_rest())) and math.isnan(worth_of_white(np.ones(6), []))


def test_a_slow_process_is_worth_a_bias_and_what_has_no_form_is_left_open() -> None:
    slow = worth_in_noise(finding("gauss_markov", "accel", sigma=1e-3, beta=1e-6))
    assert slow == pytest.approx(1e-3 * T**2 / 2.0, rel=1e-3)
    assert math.isnan(worth_in_noise(finding("vibration_line", "accel", amplitude=1.0, frequency=17.0)))
    assert math.isnan(worth_in_noise(finding("gnss_noise_level", "gnss", factor=2.0)))
    assert finding_metres(finding("saturation", "gyro", limit=1.0)) == "-"


def test_a_mounting_is_worth_the_way_times_its_yaw() -> None:
    t = np.arange(0.0, 300.0, 0.1)
    vel = np.column_stack([8.0 * np.cos(0.01 * t), 8.0 * np.sin(0.01 * t), np.ones(t.size)])
    prepared = SimpleNamespace(motion=SimpleNamespace(t=t, vel=vel))
    turned = finding("mounting", "imu", rpy_roll=0.3, rpy_pitch=0.2, rpy_yaw=-0.1)
    assert worth_of_mounting(prepared, turned) == pytest.approx(math.sin(0.1) * 8.0 * T, rel=1e-3)
    short = SimpleNamespace(motion=SimpleNamespace(t=t[:900], vel=vel[:900]))
    assert math.isnan(worth_of_mounting(short, turned))


def test_an_effect_in_a_drive_is_worth_what_the_filter_shows_through_an_outage() -> None:
    s = stage(61, 3.0, 50.0)
    recording = s.record()
    assert isinstance(recording, Recording)
    prepared = prepare(recording, s.nominal, fast_parts(recording, s.nominal), {})
    at = Scene.of(prepared)
    j = next(k for k, c in enumerate(at.columns) if (c.effect, c.sensor) == ("scale_factor", "accel"))
    value = 0.2 * at.columns[j].scale
    changed = corrected_data(prepared, at.columns, {j: value}, prepared.result.fixes.t)[0]
    for fix in (40, 70, 200):
        start = float(prepared.gnss.t[fix]) + 0.01  # just after a fix that is used; the next one is not
        ends = []
        for imu in (prepared.imu, changed):
            result = prepared.again(imu=imu, gnss=outage(prepared.gnss, start)).result
            ends.append(result.nav[np.searchsorted(result.t, start + T) - 1, :3])
        away = earth.position_difference(ends[0][None], ends[1])[0]
        # both are a hundredth of a second from a minute, and the scale is small enough to be linear
        assert worth_in_motion(at.loop, at.motion, [at.columns[j]], [value], [start]) == pytest.approx(
            math.hypot(away[0], away[1]), rel=0.01
        )
    # linear, and all along the drive of the same order
    assert worth_in_motion(at.loop, at.motion, [at.columns[j]], [2.0 * value], [start]) == pytest.approx(
        2.0 * worth_in_motion(at.loop, at.motion, [at.columns[j]], [value], [start]), rel=1e-9
    )
    assert 0.0 < worth_in_motion(at.loop, at.motion, [at.columns[j]], [value]) < math.inf


def test_an_outage_on_the_way_knows_the_attitude_and_the_motion() -> None:
    """What a signal of each axis leaves at the end is what a filter without fixes does with it; the heading matters less than a tilt."""
    s = stage(61, 4.0, 50.0)
    recording = s.record()
    assert isinstance(recording, Recording)
    prepared = prepare(recording, s.nominal, fast_parts(recording, s.nominal), {})
    at = Scene.of(prepared)
    outages = outages_along(at.loop, at.motion)
    nodes, result = prepared.result.nodes, prepared.result
    assert nodes is not None
    starts = at.motion.t[nodes.epoch]
    start = float(starts[np.searchsorted(starts, starts[0] + T)])
    without = outage(prepared.gnss, start)

    def end(axis: int, size: float) -> np.ndarray:
        imu = prepared.imu
        more = np.zeros((len(imu), 6))
        more[imu.t > start, axis] = size
        more *= imu.widths(0.0)
        imu = replace(imu, gyro=imu.gyro + more[:, :3], accel=imu.accel + more[:, 3:])
        return prepared.again(imu=imu, gnss=without).result.nav[np.searchsorted(result.t, start + T), :3]

    clean = end(0, 0.0)
    for axis, size in ((0, 1e-4), (1, 1e-4), (2, 1e-4), (3, 1e-2), (5, 1e-2)):
        away = earth.position_difference(end(axis, size)[None], clean)[0, :2]
        told = size * outages[0].weight[:, axis].sum(axis=0)
        np.testing.assert_allclose(told, away, atol=0.05 * np.abs(away).max() + 0.01)
    turned = Value("sigma", 1e-4, 0.0, 1.0, "rad/s"), Value("beta", 0.1, 0.0, 1.0, "1/s")
    tilt, heading = (
        worth_in_noise(replace(finding("gauss_markov", "gyro"), axes=(a,), parameters=turned), None, outages)
        for a in "xz"
    )
    blind = worth_in_noise(finding("gauss_markov", "gyro", sigma=1e-4, beta=0.1))
    assert heading < tilt < blind  # what a turning vehicle tilts, it tilts to all sides
    assert math.isnan(worth_in_noise(finding("gauss_markov", "gyro", sigma=1e-4, beta=0.1), None, ()))


def test_some_findings_are_applied_by_number() -> None:
    nothing = Interval(math.nan, math.nan, math.nan)
    found = (finding("random_walk", "gyro", K=1e-5), finding("turn_on_bias", "gyro", value=1e-3))
    belief = {"gyro_x": NoiseModel((WN(1e-3),))}
    both = {"gyro_x": NoiseModel((WN(1e-3), RW(1e-5)))}
    report = GapReport("named", found, (), (), nothing, nothing, nothing, belief, both)
    second = applied(report, [2])
    assert [f.effect for f in second.findings] == ["turn_on_bias"] and second.refined == belief
    assert applied(report, [1]).refined["gyro_x"] == both["gyro_x"]
    with pytest.raises(InputError, match="no finding 3, expected 1 to 2"):
        applied(report, [1, 3])
    # numbers are those of the table, whose first row is worth most metres
    shown = replace(report, findings=(replace(found[0], metres=1.0), replace(found[1], metres=9.0)))
    assert [(n, f.effect) for n, f in shown.numbered()] == [(1, "turn_on_bias"), (2, "random_walk")]
    assert [f.effect for f in applied(shown, [1]).findings] == ["turn_on_bias"]
    assert [s["number"] for s in shown.to_json()["steps"]] == [2, 1]


def test_every_finding_says_what_to_do() -> None:
    assert finding_action(finding("lever_arm", "gnss", value_x=0.48)) == "correct the lever arm by x 0.48"
    assert finding_action(finding("somebody's own", "gyro", size=2.0)) == "model or calibrate it: size 2"
