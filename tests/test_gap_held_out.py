"""What the gap index on data not used for naming stands on, and its interval."""

from dataclasses import replace

import numpy as np
import pytest

from insemu.gap.holdout import burst
from insemu.gap.verdict import Burst, GapReport, Interval
from insemu.report import burst_said

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
