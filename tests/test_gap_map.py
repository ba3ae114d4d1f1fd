"""The map of disagreement of a drive: tests against textbook formulas, silence where nothing is wrong, and what each statistic notices."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy import stats

from benchmarks.trial.drives import stage
from insemu.gap.candidates import AxisState
from insemu.gap.checks.drive import drive_map, innovation_tests, largest_p, regression_p
from insemu.gap.checks.rest import Entry, corrected
from insemu.gap.drive.preparation import fast_parts, prepare
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.model import Likelihood, fit
from insemu.gap.problems.known_effects import starting_explanation
from insemu.gap.verdict import Finding, Member, judged
from insemu.records import Recording


@functools.cache
def scene() -> tuple[Scene, dict[str, AxisState]]:
    s = stage(61, 3.0, 50.0)
    recording = s.record()
    assert isinstance(recording, Recording)
    parts = fast_parts(recording, s.nominal)
    states = {
        name: AxisState(d, fit(Likelihood(d), starting_explanation(s.nominal.beliefs[name], (), d.dt)))
        for name, d in parts.items()
    }
    return Scene.of(prepare(recording, s.nominal, parts, {})), states


def mapped(y: np.ndarray) -> list[Entry]:
    at, states = scene()
    return [*innovation_tests(at, y), *drive_map(at, y, states, np.random.default_rng(5))]


def test_the_regression_is_the_f_test_of_one_regressor() -> None:
    rng = np.random.default_rng(3)
    x, z = rng.standard_normal((2, 60))
    assert regression_p(z + 0.3 * x, x[:, None]) == pytest.approx(stats.linregress(x, z + 0.3 * x).pvalue, rel=1e-9)
    # a regressor given twice spends one degree of freedom
    assert regression_p(z, np.stack([x, 2.0 * x], axis=1)) == pytest.approx(stats.linregress(x, z).pvalue, rel=1e-9)
    assert regression_p(z, np.ones((60, 1))) == 1.0


def test_the_largest_of_normal_values_is_uniform() -> None:
    rng = np.random.default_rng(4)
    p = [largest_p(rng.standard_normal(200)) for _ in range(2000)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.02)
    spoiled = rng.standard_normal(200)
    spoiled[7] = 9.0
    assert largest_p(spoiled) < 1e-10


def test_a_nominal_drive_has_no_disagreement_and_every_kind_is_looked_at() -> None:
    entries = mapped(scene()[0].data.y)
    assert min(w.p_value for w in corrected(entries)) > 0.01
    kinds = {e[0] for e in entries}
    for regressor in ("specific force", "rate", "temperature", "velocity", "heading", "time"):
        assert f"position innovation with {regressor}" in kinds
    assert {"wavelet_variance", "tails", "position innovation, largest", "noise level with velocity"} <= kinds
    assert all(0.0 <= e[4] <= 1.0 for e in entries)


def test_what_goes_with_the_heading_is_seen_there() -> None:
    at, _ = scene()
    heading = np.interp(at.rows_t, at.motion.t, np.arctan2(at.motion.vel[:, 1], at.motion.vel[:, 0]))
    y = at.data.y + np.cos(heading)
    worst = {w.statistic for w in corrected(mapped(y)) if w.p_value < 1e-6}
    assert any(name.endswith("with heading") for name in worst)


def test_names_stand_where_the_strongest_is_not_shaken() -> None:
    sure = Finding("mounting", "", "imu", (), (), 0.99, 100.0, (Member("mounting", "imu", (), 100.0),))
    weak = Finding(
        "outliers", "", "gyro", ("x",), (), 0.99, 10.0, (Member("outliers", "gyro", ("x",), 10.0),)
    ).doubted()
    assert weak.confidence == 0.5
    assert judged([sure, weak], "vibration that changes with time on gyro x") == "named"
    assert judged([weak, sure], "something") == "unexplained"
    assert judged([weak, sure], "something", [sure.effect]) == "named"
    assert judged([], "something") == "unexplained"
    assert judged([], "") == "nothing missing"
