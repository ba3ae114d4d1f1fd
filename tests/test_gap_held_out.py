"""What the gap index on data not used for naming stands on, and its interval."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from insemu import rotation
from insemu.gap import session
from insemu.gap.candidates.mounting import Mounted
from insemu.gap.holdout import DriveScore, burst, scored
from insemu.gap.verdict import Burst, Finding, GapReport, Interval, Step, Value, Where
from insemu.report.gap import burst_said, is_better, render_gap
from insemu.report.gap_charts import shrink_chart
from tests.test_gap_worth import finding

REPORT = GapReport(
    "named", (), (), (), Interval.positive(4.0, 0.2), Interval.positive(1.07, 0.08), Interval.normal(6.0, 0.1)
)


def innovations(seed: int, fixes: int) -> tuple[np.ndarray, np.ndarray]:
    """White innovations of six components at 1 Hz, and their times."""
    return np.random.default_rng(seed).normal(size=6 * fixes), np.repeat(100.0 + np.arange(fixes), 6)


def test_of_independent_innovations_no_part_of_the_index_is_a_burst() -> None:
    # chance gives one in a thousand recordings, so that three in 600 have a probability of two in a hundred
    assert sum(burst(*innovations(seed, 20 + seed)) is not None for seed in range(600)) < 3


@pytest.mark.parametrize("scale", [0.2, 1.0, 3.0])
def test_a_burst_is_the_fixes_that_are_off_whatever_the_level_of_the_rest(scale: float) -> None:
    e, t = innovations(7, 300)
    e *= scale
    off = np.flatnonzero(np.isin(t, [250.0, 252.0]))
    e[off] = 12.0 * scale
    gone = burst(e, t)
    assert gone is not None
    assert set(t[gone]) == {250.0, 251.0, 252.0}
    assert float(np.mean(e[~gone] ** 2)) == pytest.approx(scale**2, rel=0.15)  # 1782 squares: 10 % at three sigma


def test_innovations_that_are_larger_over_a_tenth_of_the_time_are_no_burst() -> None:
    e, t = innovations(8, 300)
    e[:180] *= 2.5
    assert burst(e, t) is None


def test_the_interval_of_an_index_stays_positive() -> None:
    wide = Interval.positive(0.64, 0.40)
    assert 0.0 < wide.low < 0.64 < 1.0 < wide.high
    assert wide.log_sd == pytest.approx(0.40 / 0.64)
    narrow, normal = Interval.positive(1.0, 0.01), Interval.normal(1.0, 0.01)
    assert (narrow.low, narrow.high) == pytest.approx((normal.low, normal.high), abs=2e-4)  # half of (1.96 sd)^2


def test_the_sentence_says_how_much_of_the_index_which_fixes_are() -> None:
    b = Burst(525.38, 526.63, "velocity north", 15.4, Interval.positive(0.95, 0.05))
    report = replace(REPORT, burst=b)
    assert burst_said(report) == (
        "Of the gap index after, 0.120 comes from the fixes from 525.4 to 526.6 s (velocity north up to 15.4 standard deviations off); "
        "without them it is 0.950 [0.857, 1.053]."
    )
    assert "the fix at 525.4 s" in burst_said(replace(report, burst=replace(b, end=b.start)))
    assert burst_said(REPORT) == ""
    assert REPORT.to_json()["burst"] is None
    assert report.to_json()["burst"]["without"]["value"] == 0.95


def test_intervals_hold_what_normal_errors_do_in_95_of_100() -> None:
    z = stats.norm.isf(0.025)
    for made in (Interval.normal(5.0, 2.0), Value.normal("drift", 5.0, 2.0, "s")):
        assert ((made.high - 5.0) / 2.0, (5.0 - made.low) / 2.0) == pytest.approx((z, z), rel=1e-4)
    # of a positive value the logarithm is normal, with 2 / 5 as its deviation
    for made in (Interval.positive(5.0, 2.0), Value.positive("level", 5.0, 0.4, "s")):
        assert np.log([made.high / 5.0, 5.0 / made.low]) == pytest.approx(0.4 * z, rel=1e-4)


def test_the_score_counts_the_motion_across_the_vehicle_with_its_own_spread() -> None:
    """Two hundred fixes gain 6 nats each, within 0.1; 40 pairs across the vehicle gain 80 nats within 16: variances add."""
    nothing = Mounted(None, np.zeros(3), (), ())
    mounted = replace(nothing, chi_square=(160.0, 80.0), dof=80, gain=(80.0, 16.0))
    score = DriveScore(REPORT.gap_before, REPORT.gap_after, Interval.normal(6.0, 0.1), None)
    found = scored(REPORT, score, mounted, ())
    z = stats.norm.isf(0.025)
    assert found.held_out.value == pytest.approx(6.0 + 2.0)
    spread = z * np.hypot(0.1, 16.0 / 40)
    assert (found.held_out.low, found.held_out.high) == pytest.approx((8.0 - spread, 8.0 + spread), rel=1e-4)
    assert (found.gap_before.value, found.gap_after.value) == pytest.approx((0.5 * (4.0 + 2.0), 0.5 * (1.07 + 1.0)))
    assert found.gap_after.log_sd * found.gap_after.value == pytest.approx(0.5 * np.hypot(0.08, np.sqrt(2.0 / 80)))
    assert scored(REPORT, score, nothing, ()).held_out == score.gain


def test_the_steps_of_the_gap_begin_and_end_where_its_indices_do(tmp_path: Path) -> None:
    """The wrong mounting is taken off before the search, with the second step."""
    arm = ("lever_arm", "gnss", ("x",))
    steps = (Step((), 4.0, 0.1), Step((), 2.0, 0.1), Step((arm,), 1.07, 0.1))
    mounted = Mounted(None, np.zeros(3), (), (), chi_square=(160.0, 80.0), dof=80, gain=(80.0, 16.0))
    score = DriveScore(REPORT.gap_before, REPORT.gap_after, Interval.normal(6.0, 0.1), None, steps)
    found = scored(REPORT, score, mounted, [finding("mounting", "imu", rpy_yaw=0.1)])
    assert [s.added for s in found.shrink] == [(), (("mounting", "imu", ("x",)),), (arm,)]
    assert [s.index for s in found.shrink] == pytest.approx([found.gap_before.value, 1.5, found.gap_after.value])
    assert [s.spread for s in found.shrink] == pytest.approx([0.5 * np.hypot(0.1, np.sqrt(2.0 / 80))] * 3)
    (view,) = shrink_chart(found).views
    low, high, line, _ = view.lines
    assert list(line.y) == [s.index for s in found.shrink]
    page = render_gap(replace(found, verdict="nothing missing"), tmp_path).read_text(encoding="utf-8")
    assert "How the gap shrinks" in page and "mounting angles" in page
    assert (high.y - low.y) / 2.0 == pytest.approx(stats.norm.isf(0.025) * found.shrink[0].spread, rel=1e-3)


@pytest.mark.parametrize(("gain", "word"), [(0.19, "not shown"), (0.21, "yes"), (-0.19, "not shown"), (-0.21, "no")])
def test_better_is_what_zero_is_no_part_of(gain: float, word: str) -> None:
    """With a standard deviation of 0.1 the limit is at 0.196."""
    finding = Finding("random_constant", "", "accel", ("x",), (), 0.99, 9.0, ())
    report = replace(REPORT, findings=(finding,), held_out=Interval.normal(gain, 0.1))
    assert is_better(report)[0] == word


@pytest.mark.parametrize("before", [None, (0.3, -0.2, 2.0)])
def test_a_mounting_is_corrected_by_what_the_refined_filter_shows(
    before: tuple[float, float, float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The correction turns the axes after the first turn, which is no sum of angles."""
    values = {"rpy_roll": 0.01, "rpy_pitch": 0.05, "rpy_yaw": -0.04}
    more = replace(finding("mounting", "imu", **values), nats=4.0)
    asked: list[bool] = []

    def found(recording: None, nominal: None, say: None, *, known: bool) -> Mounted:
        asked.append(known)
        return Mounted(more, np.array([*values.values()]), (), (Where("new", "imu", "y", None, 0.5),))

    monkeypatch.setattr(session, "find_mounting", found)
    monkeypatch.setattr(session, "worth_of_mounting", lambda *_: 7.0)
    old, other = Where("old", "imu", "y", None, 0.1), Where("whiteness", "gnss", "north", 1.0, 0.2)
    first = replace(finding("mounting", "imu", **dict(zip(values, before or (), strict=False))), nats=90.0)
    found_before = (finding("clock_drift", "imu", drift=1e-4), *((first,) if before else ()))
    report = replace(REPORT, findings=found_before, after=(old, other))
    out = session._mounted_again(report, (None, None), Mounted(None, np.zeros(3), (), (old,)), None, None)
    (now,) = [f for f in out.findings if f.effect == "mounting"]
    assert asked == [before is not None] and now.metres == 7.0 and now.nats == (90.0 if before else 4.0)
    total = rotation.dcm_from_rpy([*values.values()]) @ rotation.dcm_from_rpy(before or (0.0, 0.0, 0.0))
    np.testing.assert_allclose(rotation.dcm_from_rpy([v.value for v in now.parameters]), total, atol=1e-14)
    assert [v.high - v.value for v in now.parameters] == pytest.approx([v.high - v.value for v in more.parameters])
    assert [w.statistic for w in out.after] == ["whiteness", "new"]
