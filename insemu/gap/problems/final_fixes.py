"""Noise and steps of the fixes of a drive as they are with everything that a search found."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace

import numpy as np

from insemu.gap.candidates.fixes import as_joint, at_level, level_ratios, rows_of
from insemu.gap.candidates.jumps import bias_step, changed_term, lever_arm_step
from insemu.gap.candidates.robust import beyond_doubt
from insemu.gap.candidates.shapes import Change, DriveHypothesis, Variant, linear_hypotheses
from insemu.gap.candidates.steps import multipath_step, placed
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.fix_outliers import FIRST
from insemu.gap.drive.scene import Scene, Window
from insemu.gap.evidence.fixes import LEVEL_ROWS, joint_noise
from insemu.gap.evidence.linear import Field
from insemu.gap.evidence.surrogate import WHITE
from insemu.gap.hypothesis import Found, best_first
from insemu.gap.policy import rules
from insemu.gap.problems.noise_of_fixes import NoiseOfFixes
from insemu.gap.search import Again

#: Effects that begin at a time, which no column of the catalogue has, and what looks for each.
STEPS = {
    "gnss_multipath_step": multipath_step,
    "bias_step": bias_step,
    "lever_arm_step": lever_arm_step,
    "expression_step": changed_term,
}


def _is_another(one: Window | None, other: Window | None) -> bool:
    """Whether two steps are of different places or times."""
    if one is None or other is None:
        return False
    return one[0] != other[0] or not max(one[1], other[1]) < min(one[2], other[2])


class FinalFixes(NoiseOfFixes):
    """What a drive's problem settles at the end of a search.

    Attributes
    ----------
    data : Field
        The innovations that are looked at.
    rows : slice
        Which rows of the recording's field these are.
    """

    data: Field
    rows: slice

    @abstractmethod
    def _compatible(self, without: Found[Change] | None = None) -> list[Variant]:
        """What may stand beside the findings, all or all but one."""

    @abstractmethod
    def _unexplained(self, without: Found[Change] | None = None) -> Unexplained:
        """The innovations that are looked at beside the findings, all or all but one."""

    @abstractmethod
    def put(self, old: Found[Change], new: DriveHypothesis, again: Again[Change]) -> None:
        """Let a hypothesis stand in the place of a finding."""

    def estimate_fixes_again(self) -> bool:
        """Noise and steps of the fixes as they are with everything that was found since; whether so much moved that it is looked again."""
        colour, moved = self._named("gnss_correlated_noise"), False
        if colour is None:
            moved = self._step_in_a_run()
            if back := self._with_edges():
                moved |= self._steps_again()
            if back or (self.found and self.found[-1].chosen.effect not in FIRST):
                for effect in (k for k in FIRST if k in self.gone):
                    self._take(self._outliers_again(self.scene, effect))
            moved |= self._steps_again()
            # either effect is asked, whatever the other one answers
            if self.scene.noise is None and any([self._parted(WHITE, effect) for effect in LEVEL_ROWS]):
                self._take(self._at_named_levels(self.scene))
                s, wide = self._fixes(self.scene), self._levels()
                joint = joint_noise(s, WHITE, level_ratios(self.scene, wide), wide=wide)
                self.found = [replace(f, chosen=as_joint(f.chosen, self.scene, joint)) for f in self.found]
                factors = self.scene.original.factors * joint.noise.factor
                self._take(self._at_named_levels(self.scene.rebuilt(factors=factors)))
                moved = True
            levels = self.scene.original.factors * (1.0 if self.scene.noise is None else self.scene.noise.factor)
            self.found = [replace(f, chosen=at_level(f.chosen, levels)) for f in self.found]
        elif self.scene.noise is not None and colour is not self.found[-1].chosen:
            before = self.scene.noise.colour
            parted = any([self._parted(self.scene.noise, effect) for effect in LEVEL_ROWS])
            if parted:
                self._take(self._at_named_levels(self.scene))
            scene, joint, _ = self._under_colour(self.scene.noise)
            self.found = [replace(f, chosen=as_joint(f.chosen, scene, joint)) for f in self.found]
            plain = self._without_colour(scene, joint.noise)
            self._take(self._at_named_levels(plain or scene) if parted else plain or scene)
            now = joint.noise.colour
            longer = abs(math.log(now.tau / before.tau)) > math.log1p(rules().tolerance)
            moved = plain is not None or longer or now.follows != before.follows or parted
            moved |= self._steps_again()
        return moved

    def _at_named_levels(self, scene: Scene) -> Scene:
        """The scene with the levels that are named as those about which others are trimmed."""
        # what is no level any more was believed as it is, or raised for the shaking
        levels = np.where(scene.original.raised > 1.0, scene.original.levels, 1.0)
        for h in (f.chosen for f in self.found if rows_of(f.chosen)):
            levels[rows_of(h)] = h.values[0].value
        return scene.rebuilt(levels=levels)

    def _steps_again(self) -> bool:
        """Look for each step once more, next to everything that was found since; whether another effect now stands in the place of one."""
        given_way = False
        for old in [f for f in self.found if f.chosen.change.window is not None]:
            assert old.chosen.change.block is not None
            unexplained, least = self._unexplained(old), min(self.threshold, rules().keep_nats)
            own = next((h for h in STEPS[old.chosen.effect](unexplained) if h.sensor == old.chosen.sensor), None)
            if own is not None and _is_another(own.change.window, old.chosen.change.window):
                # an outlier that was put back at its edge explains more, say: that is for the search to find
                worth = self.data.log_factor(self.blocks()) - self.data.log_factor(self.blocks(old))
                own = old.chosen if worth >= least else None
            if own is None or beyond_doubt(unexplained, own, least).nats < least:
                self.found = [f for f in self.found if f is not old]
                continue
            rivals = linear_hypotheses(self.scene, self._compatible(old), self.data, self.blocks(old), self._skip(old))
            ranked = tuple(best_first([*rivals, own]))
            if ranked[0].nats > own.nats + rules().swap_nats:  # it lasts throughout, or is something else
                self.put(old, ranked[0], Again(own, ranked, ranked[0], False))
                given_way = True
                continue
            if own.change.window is None:
                continue
            column, windows = int(old.chosen.change.block[0][0]), list(self.scene.windows)
            windows[column - self.scene.width] = own.change.window
            own = placed(own, column)
            new = Found(own, tuple(best_first([*rivals, own])))
            self.found = [new if f is old else f for f in self.found]
            if tuple(windows) != self.scene.windows:
                self._take(self.scene.with_windows(tuple(windows)))
        return given_way
