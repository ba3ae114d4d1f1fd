"""What is taken out of the data of a drive: as far as it leaves less there, and only for findings that are there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu.effects import EffectUse
from insemu.gap import Nominal
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import SHARES, Scene
from insemu.gap.evidence.linear import Block
from insemu.scenario import Gnss
from tests.test_gap_dynamic import BELIEF, LEVER, recording, use
from tests.test_gap_fixes import SIGMA, looked, with_outliers


def scene_of(*effects: EffectUse) -> Scene:
    gnss = Gnss(position_sigma=SIGMA, velocity_sigma=(0.05, 0.05, 0.05), lever_arm=LEVER)
    return Scene.of(Flown.of(recording(*effects), Nominal(dict(BELIEF), gnss)).prepared)


def block_of(scene: Scene, effect: str, sensor: str, label: str) -> Block:
    """The prior of one column, ten times as wide as its usual size."""
    (j,) = (
        i
        for i, c in enumerate(scene.columns[: scene.catalogue])
        if (c.effect, c.sensor, c.label) == (effect, sensor, label)
    )
    return np.array([j]), np.array([[10.0 * scene.columns[j].scale]])


def away(monkeypatch: pytest.MonkeyPatch, grown: float) -> list[dict[int, float]]:
    """Let each further correction enlarge the innovations by a share, as where the linear answer is wrong; the list is of those tried."""
    tried: list[dict[int, float]] = []
    rebuilt = Scene.rebuilt

    def astray(self: Scene, **changes: Any) -> Scene:
        out = rebuilt(self, **changes)
        tried.append(dict(out.corrections))
        out.full_y *= 1.0 + grown
        return out

    monkeypatch.setattr(Scene, "rebuilt", astray)
    return tried


def test_a_correction_that_leaves_more_than_there_was_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """On ublox_mixed_nominal each of six corrections left more, 260 times as much at the end, and every later look went on from there."""
    scene = scene_of(use(effect="lever_arm", value=[1.0, 0.0, 0.0]))
    block = block_of(scene, "lever_arm", "gnss", "value_x")
    (j,) = block[0]
    right = scene.linear_about([block], {int(j)})
    assert right.corrections[j] == pytest.approx(1.0, abs=0.1)
    tried = away(monkeypatch, 1.0)
    assert scene.linear_about([block], {int(j)}) is scene
    # the whole of it and a part
    assert len(tried) == len(SHARES)
    assert tried[1][j] == pytest.approx(SHARES[1] * tried[0][j])


def test_a_correction_that_bends_a_little_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(use(effect="lever_arm", value=[1.0, 0.0, 0.0]))
    block = block_of(scene, "lever_arm", "gnss", "value_x")
    away(monkeypatch, 0.02)
    assert scene.linear_about([block], {int(block[0][0])}) is not scene


def test_what_was_taken_out_for_a_finding_that_is_none_any_more_is_put_back() -> None:
    scene = scene_of(use(effect="lever_arm", value=[1.0, 0.0, 0.0]))
    arm, other = block_of(scene, "lever_arm", "gnss", "value_x"), block_of(scene, "scale_factor", "accel", "value_z")
    corrected = scene.linear_about([arm, other], {int(arm[0][0])})
    assert set(corrected.corrections) == {int(arm[0][0])}
    back = corrected.linear_about([other], set())
    assert not back.corrections
    np.testing.assert_allclose(back.full_y, scene.full_y, atol=1e-6)


@pytest.mark.parametrize("tau", [0.3, 1.2])
def test_an_effect_of_two_shapes_is_taken_off_once(tau: float) -> None:
    """Smoothing that was taken off by its long shape stayed when the short one was named instead, and both were put right."""
    drive = stage(61, 4.0, 50.0, track="uav")
    smoothed = EffectUse.from_mapping({"effect": "gnss_velocity_filter", "tau": [0.0, 0.0, tau]})
    scene = Scene.of(Flown.of(drive.record((smoothed,)), drive.nominal).prepared)
    short, long = (i for i, c in enumerate(scene.columns[: scene.catalogue]) if c.effect == "gnss_velocity_filter")
    blocks = [(np.array([j]), np.array([[10.0 * scene.columns[j].scale]])) for j in (short, long)]
    first = scene.at_size([blocks[1]])
    assert first.corrections == {long: pytest.approx(tau, rel=0.1)}
    second = first.at_size([blocks[0]])
    assert second.corrections == {short: pytest.approx(tau, rel=0.1)}
    np.testing.assert_allclose(second.full_y, first.full_y, atol=0.1)


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_an_outlier_at_the_edge_of_a_step_does_not_take_its_place() -> None:
    """Positions told outliers where a step may end are put back; one of 17 m was then the best step of all (foreign two, seed 801045)."""
    step = use(effect="gnss_multipath_step", value=[0.5, 0.0, 0.0], start=121.4, duration=60.0)
    made, _ = with_outliers(recording(step), 0.04, 6.0, seed=8)
    fixes = made.gnss
    assert fixes is not None
    llh = fixes.llh.copy()
    llh[np.flatnonzero(fixes.t > 121.4)[0]] += np.array([0.0, 3.0, 0.0]) / 6.37e6
    llh[np.flatnonzero(fixes.t > 181.4)[0]] += np.array([0.0, 3.0, 0.0]) / 6.37e6
    report = looked(replace(made, gnss=replace(fixes, llh=llh)))
    found = {f.effect: f for f in report.findings}
    assert set(found) == {"gnss_multipath_step", "gnss_outliers"} and len(report.findings) == 2
    assert found["gnss_multipath_step"].axes == ("north",)
