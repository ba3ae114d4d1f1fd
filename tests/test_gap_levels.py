"""How many levels the fixes have, once everything beside them is known."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.effects import EffectUse
from insemu.gap import Nominal
from insemu.gap.candidates.shapes import Change
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import LEVEL_ROWS, NED, NoiseFit
from insemu.gap.hypothesis import Found, Hypothesis
from insemu.gap.problems.drive import DriveProblem
from insemu.gap.verdict import Value
from insemu.scenario import Gnss
from tests.test_gap_dynamic import BELIEF, LEVER, recording, use
from tests.test_gap_fixes import SIGMA

COLOUR = use(effect="gnss_correlated_noise", sigma=[0.1, 0.1, 0.2], tau=40.0)
HORIZONTAL, VERTICAL = ("north", "east"), ("down",)


def naming(effect: str, levels: dict[tuple[str, ...], float], *hidden: EffectUse) -> DriveProblem:
    """A search that has named levels of some axes, and behind them the colour of the fixes where there is one."""
    gnss = Gnss(position_sigma=SIGMA, velocity_sigma=(0.05, 0.05, 0.05), lever_arm=LEVER)
    made = recording(*hidden, seed=4)
    problem = DriveProblem(Scene.of(Flown.of(made, Nominal(dict(BELIEF), gnss)).prepared), None, 3.0, ())
    for axes, level in levels.items():
        factor = np.ones(6)
        factor[[LEVEL_ROWS[effect] + NED.index(a) for a in axes]] = level
        values = (Value.positive("factor", level, 0.1, "1"),)
        change = Change(noise=NoiseFit(effect, axes, 200.0, values, factor, None))
        found = Hypothesis(effect, 200.0, values, change, "", "gnss", axes)
        problem.apply(Found(found, (found,)))
    if COLOUR in hidden:
        colour = next(h for h in problem.rank() if h.effect == "gnss_correlated_noise")
        problem.apply(Found(colour, (colour,)))
        # what was found last is not asked again
        problem.found.append(problem.found.pop(0))
    return problem


def told(problem: DriveProblem, effect: str) -> dict[tuple[str, ...], tuple[float, float, float]]:
    values = {f.chosen.axes: f.chosen.values[0] for f in problem.found if f.chosen.effect == effect}
    return {axes: (v.low, v.value, v.high) for axes, v in values.items()}


@pytest.mark.parametrize("effect", list(LEVEL_ROWS))
@pytest.mark.parametrize(
    "hidden", [(), pytest.param((COLOUR,), marks=pytest.mark.slow(reason="another case of a quick test"))]
)
def test_a_level_of_all_axes_becomes_two_where_they_differ(effect: str, hidden: tuple[EffectUse, ...]) -> None:
    """On ublox_mixed_nominal one level of 0.11 stood for all velocities, whose vertical ones scattered by 0.4 of that."""
    problem = naming(effect, {NED: 0.4}, use(effect=effect, factor=[0.6, 0.6, 0.2]), *hidden)
    nats = sum(f.chosen.nats for f in problem.found if f.chosen.effect == effect)
    assert problem.estimate_fixes_again()
    levels = told(problem, effect)
    assert set(levels) == {HORIZONTAL, VERTICAL}
    assert levels[HORIZONTAL][0] < 0.6 < levels[HORIZONTAL][2] and levels[VERTICAL][0] < 0.2 < levels[VERTICAL][2]
    assert sum(f.chosen.nats for f in problem.found if f.chosen.effect == effect) > nats + 20.0
    # and stay: what trims levels within their tolerance starts from these
    at, rows = problem.scene.original, slice(LEVEL_ROWS[effect], LEVEL_ROWS[effect] + 3)
    factors = at.factors * (1.0 if problem.scene.noise is None else problem.scene.noise.factor)
    np.testing.assert_allclose(at.levels[rows], factors[rows], rtol=0.25)
    assert not problem.estimate_fixes_again() and set(told(problem, effect)) == {HORIZONTAL, VERTICAL}


@pytest.mark.parametrize(
    "hidden", [(), pytest.param((COLOUR,), marks=pytest.mark.slow(reason="another case of a quick test"))]
)
def test_levels_of_parts_become_one_where_they_are_alike(hidden: tuple[EffectUse, ...]) -> None:
    effect = "gnss_velocity_noise"
    problem = naming(effect, {HORIZONTAL: 1.7, VERTICAL: 2.4}, use(effect=effect, factor=2.0), *hidden)
    problem.estimate_fixes_again()
    levels = told(problem, effect)
    assert set(levels) == {NED} and levels[NED][0] < 2.0 < levels[NED][2]


def test_a_level_that_is_one_stays_one() -> None:
    problem = naming("gnss_noise_level", {NED: 2.5}, use(effect="gnss_noise_level", factor=2.5))
    problem.estimate_fixes_again()
    assert set(told(problem, "gnss_noise_level")) == {NED}


def test_of_parts_of_a_level_one_may_be_as_believed() -> None:
    effect = "gnss_velocity_noise"
    problem = naming(effect, {NED: 0.6}, use(effect=effect, factor=[0.5, 0.5, 1.0]))
    assert problem.estimate_fixes_again()
    levels = told(problem, effect)
    assert set(levels) == {HORIZONTAL} and levels[HORIZONTAL][0] < 0.5 < levels[HORIZONTAL][2]
    assert problem.scene.original.factors[5] == pytest.approx(1.0, abs=0.15)
    assert problem.scene.original.levels[5] == 1.0
