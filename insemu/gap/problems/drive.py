"""A drive or flight as a problem: effects named on the whitened innovations of the nominal filter, next to what the band above the motion shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.blas import on_one_thread
from insemu.effects import EFFECTS
from insemu.errors import InputError
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates.fixes import about, as_joint, covariance_hypotheses
from insemu.gap.candidates.jumps import JUMPS
from insemu.gap.candidates.robust import beyond_doubt, doubted_last, is_lasting, too_much
from insemu.gap.candidates.shapes import (
    EQUATIONS,
    ONCE,
    POSITIVE,
    PROCESSES,
    Change,
    DriveHypothesis,
    Variant,
    bank,
    best_pair,
    compatible,
    linear_hypotheses,
    linear_nats,
    null_threshold,
)
from insemu.gap.candidates.steps import placed
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.checks.drive import drive_map, innovation_tests
from insemu.gap.checks.rest import corrected
from insemu.gap.drive.fix_outliers import FIRST
from insemu.gap.drive.preparation import Flown, prepare
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import LEVEL_ROWS
from insemu.gap.evidence.linear import Block, Field
from insemu.gap.evidence.surrogate import FixNoise
from insemu.gap.holdout import DriveScore
from insemu.gap.hypothesis import Found, best_first, probabilities
from insemu.gap.policy import Policy, rules, under
from insemu.gap.problems.band import (
    WANDERING,
    again_with_processes,
    vibrates,
    with_delay,
)
from insemu.gap.problems.final_fixes import STEPS, FinalFixes
from insemu.gap.problems.findings import (
    AxisResult,
    is_doubtful,
    joined,
    merged,
    rejected,
    remainder,
    split_axis,
    with_effect,
)
from insemu.gap.problems.joint_estimate import scene_under_colour
from insemu.gap.problems.known_effects import which
from insemu.gap.problems.repaired_drive import RepairedDrive
from insemu.gap.problems.search_result import Named, believing, blocks_of, held_out, reported, with_confusable
from insemu.gap.problems.unresolved_shaking import with_unresolved
from insemu.gap.search import Again, reconsider, search
from insemu.gap.verdict import Finding, GapReport, Interval, Where, judged
from insemu.gap.worth import Outage, outages_along, stated_in_outages, white_levels, with_white, worth_in_noise
from insemu.records import AXES, Recording
from insemu.work import meanwhile

Array = NDArray[np.float64]
#: Effects of time, beside which no filter of the positions is looked for: what a wrong time leaves in second order goes with the acceleration as
#: well. On rtkexp_drive filters of 1.3 s stood for it (195 nats), and numbers together ran away (``python -m tests.real_gaps``).
TIMED = {e.id for e in EFFECTS.values() if e.family == "timing"} | {"gnss_velocity_lag", "gnss_velocity_filter"}


class DriveProblem(FinalFixes):
    """The innovations of one recording, whole or up to a time.

    Parameters
    ----------
    scene : Scene
    cut : float, optional
        Fixes after this time are not looked at.
    threshold : float
        Evidence that an effect must exceed.
    without : collection of str
        Effects taken out of the catalogue.
    """

    def __init__(self, scene: Scene, cut: float | None, threshold: float, without: Collection[str]) -> None:
        self.cut, self.threshold, self.without = cut, threshold, without
        self.found: list[Found[Change]] = []
        self.gone, self._changed = {}, False
        self.recorded = scene.original.gnss
        self.scene, self.variants, self._others = scene, bank(scene), list[Scene]()
        self._take(scene)

    def _take(self, scene: Scene) -> None:
        if scene.columns is not self.scene.columns:
            self.variants = bank(scene)
        if scene.loop is not self.scene.loop or scene.noise is not self.scene.noise:
            self._others = []
        self.scene = scene
        self.data: Field = scene.field(self.cut)
        self.rows = scene.upto(self.cut)

    def named(self) -> Named:
        """What was found so far."""
        return Named(tuple(self.found), self.scene, dict(self.gone))

    def blocks(self, without: Found[Change] | None = None) -> list[Block]:
        """How the findings enter the linear model of the innovations, all or all but one, and what is uncertain in any case."""
        return [*self.scene.always, *blocks_of([f for f in self.found if f is not without])]

    def _skip(self, without: Found[Change] | None = None) -> set[str]:
        """Effects that are not asked for: those taken out, and those found that are there once."""
        chosen = [f.chosen for f in self.found if f is not without]
        once = {h.effect for h in chosen if h.effect in (*ONCE, *FIRST) or h.change.noise is not None}
        once -= {h.effect for h in chosen if about(h).any()}  # of the fixes' other axes a level may be named as well
        known = {u.id for u in self.scene.original.nominal.effects}  # which fixes known outliers are was settled before
        timed = (known | {f.chosen.effect for f in self.found}) & TIMED
        out = set(self.without) | once | (known & {*FIRST, "lever_arm_step"})
        return out | {"gnss_position_filter"} if timed else out

    def _compatible(self, without: Found[Change] | None = None) -> list[Variant]:
        """What may stand beside the findings, all or all but one."""
        return compatible(self.variants, [f.chosen for f in self.found if f is not without])

    def rank(self) -> list[DriveHypothesis]:
        """Every effect that the innovations can show next to what was found."""
        self._turn_colour()
        given, skip, unexplained = self.blocks(), self._skip(), self._unexplained()
        out = linear_hypotheses(self.scene, self._compatible(), self.data, given, skip)
        for effect, look in STEPS.items():
            if effect not in skip:
                least = -math.inf if effect in ("bias_step", "expression_step") else self._step_nats()
                out += [h for h in look(unexplained) if h.nats > least]
        out += covariance_hypotheses(self.scene, given, skip, self.cut, self._levelled())
        out = doubted_last(unexplained, out, self.threshold)
        shaken = with_unresolved(self.scene, given, self.cut, out[0].nats) if out[0].nats > self.threshold else None
        if shaken is None:
            return out
        self._take(shaken)
        return self.rank()

    def _unexplained(self, without: Found[Change] | None = None) -> Unexplained:
        return Unexplained(self.scene, self.data, self.rows, self.blocks(without))

    def _levelled(self, without: Found[Change] | None = None) -> NDArray[np.bool_]:
        """Components (6,) of the fixes whose level was named."""
        each = [about(f.chosen) for f in self.found if f is not without]
        return np.asarray(np.any([np.zeros(6, dtype=bool), *each], axis=0))

    def _step_nats(self) -> float:
        """What a step in the fixes, or of the antenna, must be worth to be weighed: next to one in the fixes it must be plain."""
        known = {u.id for u in self.scene.original.nominal.effects} | {f.chosen.effect for f in self.found}
        return rules().further_step if "gnss_multipath_step" in known else -math.inf

    def choose(self, ranked: Sequence[DriveHypothesis]) -> Found[Change] | None:
        """The best effect, or the first of several that explain more together."""
        best = ranked[0]
        pair = self._hidden_pair(best)
        unsure = probabilities([h.nats for h in ranked])[-1] > 1.0 - rules().something
        if pair is None and (best.nats < self.threshold or unsure):
            return None
        return Found(pair or self._simpler(best), tuple(ranked))

    def split(self) -> bool:
        """Put the first of two or three simpler effects in the place of a finding where they now explain more than it does; whether that was so."""
        for old in self.found:
            first = self._simpler(old.chosen, old)
            if first is not old.chosen:
                self.found = [Found(first, old.ranked) if f is old else f for f in self.found]
                return True
        return False

    def _simpler(self, best: DriveHypothesis, excluded: Found[Change] | None = None) -> DriveHypothesis:
        """The first of two or three simpler effects, where they explain more than the best single one does.

        Of an effect of several axes those of one axis; of a slow process, which follows anything slow, those of known shape.
        ``excluded`` is the finding that it is, where it was found already.
        """
        if best.change.block is None or best.change.window is not None:
            return best
        single = [v for v in self.variants if len(v.axes) < 2]
        if len(best.axes) > 1:
            first, total, count = self._greedy(single, excluded)
            # as many numbers must say more; with fewer it is enough to say as much
            if first is not None and total > best.nats + (1.0 if count >= len(best.axes) else -rules().keep_nats):
                return self._simpler(first, excluded)
        if best.effect in PROCESSES:
            first, total, count = self._greedy([v for v in single if not v.process], excluded)
            # each further one must be worth what any effect must
            if first is not None and total - (count - 1) * self.threshold > best.nats + rules().lead:
                return first
        return best

    def _hidden_pair(self, best: DriveHypothesis) -> DriveHypothesis | None:
        """The first of two shapes that hide each other: together they explain more than the best effect and what follows it."""
        skip, given, lead = self._skip(), self.blocks(), rules().lead
        # of what has no negative sizes, half of the pairs would be none
        none = {*skip, *POSITIVE, *EQUATIONS}
        ones = [v for v in self.variants if not v.process and v.index.size == 1 and v.effect not in none]
        linear, strong = best.change.block, best.nats > self.threshold
        if len(ones) < 2 or (linear is None and strong):
            return None
        A, b = self.data.conditioned(given)
        together, first, second = best_pair(ones, A, b[:, 0])
        together -= math.log(0.5 * len(ones) ** 2)
        if together < max(best.nats, self.threshold) + lead:
            return None
        explained = [*given, *((linear,) if linear is not None and strong else ())]
        follows = linear_nats(self.scene, self.variants, self.data, explained, skip)
        if together < max(best.nats, 0.0) + follows + lead:
            return None
        own = [v for v in ones if v.index[0] == first[0][0]]
        return next(iter(linear_hypotheses(self.scene, own, self.data, [*given, second], skip)), None)

    def _greedy(
        self, variants: Sequence[Variant], excluded: Found[Change] | None
    ) -> tuple[DriveHypothesis | None, float, int]:
        """The best of some variants, what it is worth together with the two that follow it, and how many of them are worth anything."""
        given, total, count = self.blocks(excluded), 0.0, 0
        first: DriveHypothesis | None = None
        for _ in range(3):
            tried = linear_hypotheses(self.scene, variants, self.data, given, self._skip(excluded))
            top = max(tried, key=lambda h: h.nats, default=None)
            if top is None or top.change.block is None or top.nats < self.threshold:
                break
            total, count = total + top.nats, count + 1
            first = first or top
            given = [*given, top.change.block]
        return first, total, count

    def apply(self, new: Found[Change]) -> bool:
        """The scene as it is with the effect: a column more, positions left out, other noise of the fixes, or the data corrected."""
        h, scene = new.chosen, self.scene
        if (window := h.change.window) is not None:
            scene = scene.with_windows((*scene.windows, window))
            new = replace(new, chosen=placed(h, scene.width - 1))
        elif h.effect in FIRST:
            scene, new = self._outliers_removed(new)
            h = new.chosen
        elif (level := h.change.noise) is not None and level.colour is not None:
            noise = replace(
                scene.noise or FixNoise(level.factor, level.colour), factor=level.factor, colour=level.colour
            )
            if h.effect == "gnss_noise_level":
                self.scene = scene.rebuilt(levels=np.where(about(h), h.values[0].value, scene.original.levels))
            elif not self._needs_a_level(noise):
                h = replace(h, nats=h.nats + self._take_back("gnss_noise_level"))
                self.scene = scene.rebuilt(levels=np.where(np.arange(6) < 3, 1.0, scene.original.levels))
            scene, joint, less = self._under_colour(noise)
            h = replace(h, nats=h.nats - less)
            self.found = [replace(f, chosen=as_joint(f.chosen, scene, joint)) for f in self.found]
            new = replace(new, chosen=as_joint(h, scene, joint))
        elif level is not None:
            # a colour that was named before stood for the level
            new = replace(new, chosen=replace(h, nats=h.nats + self._take_back("gnss_correlated_noise")))
            scene = scene.coloured(None)
            factors = scene.original.factors * level.factor
            scene = scene.rebuilt(factors=factors, levels=np.where(about(h), factors, scene.original.levels))
        self.found.append(new)
        if about(h).any() and scene.noise is None:
            # at a level that was too low every large error was one
            scene = self._outliers_again(scene, next(k for k, row in FIRST.items() if row == LEVEL_ROWS[h.effect]))
        sized = scene.at_size(self.blocks(), self.cut) if EFFECTS[h.effect].does("about") else scene
        corrected = sized.linear_about(self.blocks(), self._strong(), self.cut)
        self._changed = corrected is not scene
        self._take(corrected.trimmed(self.blocks(), self.cut))
        return self._changed

    def _strong(self) -> set[int]:
        """Columns and knots of the strong findings, which are taken out of the data."""
        columns = self.scene.columns
        return {
            int(c)
            for h in (f.chosen for f in self.found)
            if h.nats > rules().correct_nats and h.change.block is not None and h.change.window is None
            for c in h.change.block[0]
            if c >= len(columns) or not columns[c].runs
        }

    def again(self, old: Found[Change]) -> Again[Change] | None:
        """An effect of the IMU or of timing next to all the others."""
        h = old.chosen
        if h.change.block is None or h.change.window is not None:
            return None
        ranked = best_first(
            linear_hypotheses(self.scene, self._compatible(old), self.data, self.blocks(old), self._skip(old))
        )
        least = min(self.threshold, rules().keep_nats)
        unexplained = self._unexplained(old)
        own = next((r for r in ranked if (r.effect, r.sensor) == (h.effect, h.sensor)), replace(h, nats=-math.inf))
        kept = beyond_doubt(unexplained, own, least)
        ranked = doubted_last(unexplained, [kept if r is own else r for r in ranked], least)
        rival, idle = ranked[0], ranked[0].nats < least
        # what jumps was weighed where this was found, and stays as far from it
        jumps = [replace(r, nats=r.nats + kept.nats - h.nats) for r in old.ranked if r.effect in JUMPS]
        return Again(kept, tuple(best_first([*ranked, *jumps])), rival, idle)

    def put(self, old: Found[Change], new: DriveHypothesis, again: Again[Change]) -> None:
        """Let a hypothesis stand in the place of a finding; the last one was weighed just now where nothing has changed since."""
        if new is again.kept and old is self.found[-1] and not self._changed:
            return
        self.found = [Found(new, again.ranked) if g is old else g for g in self.found]
        if new is not again.kept:
            self._changed = True
            if EFFECTS[new.effect].does("about"):
                self._take(self.scene.at_size(self.blocks(), self.cut))

    def drop(self, old: Found[Change], again: Again[Change]) -> None:
        """Take a finding back."""
        self.found, self._changed = [g for g in self.found if g is not old], True

    def keep_sure(self) -> None:
        """Take back, the weakest first, each finding that is not sure to be worth anything next to the others."""
        least = min(self.threshold, rules().keep_nats)
        while True:
            whole, sure = self.data.log_factor(self.blocks()), list[tuple[float, Found[Change]]]()
            for f in (f for f in self.found if is_lasting(f.chosen)):
                worth = whole - self.data.log_factor(self.blocks(f))
                sure.append((worth - too_much(self._unexplained(f), f.chosen), f))
            worth, weakest = min(sure, key=lambda s: s[0], default=(math.inf, None))
            if worth >= least:
                return
            self.found = [f for f in self.found if f is not weakest]

    def noise_again(self, first: Scene) -> None:
        """Take back the noise of the fixes and what was found with it, from the ``first`` scene on."""
        self.found = [f for f in self.found if f.chosen.change.block is not None]
        self.gone = {}
        first = first.with_windows(self.scene.windows)
        scene = first.rebuilt(corrections=self.scene.corrections).corrected_again(self.blocks(), self.cut)
        self.recorded = scene.original.gnss
        self._take(scene.trimmed(self.blocks(), self.cut))

    def hold_against_the_rest(self) -> None:
        """Weigh noise of the fixes against each effect that was weighed again without it."""
        for k, f in enumerate(self.found):
            h, others, unexplained = f.chosen, self.blocks(f), self._unexplained(f)
            if h.change.block is not None and not any(r.change.noise is not None for r in f.ranked):
                rivals = covariance_hypotheses(self.scene, others, self._skip(f), self.cut, self._levelled(f))
                # an effect of thousands of nats was weighed at the variance of the field, these at one
                rivals = [replace(r, nats=r.nats / self.data.variance) for r in rivals]
                f = replace(f, ranked=(*f.ranked, *rivals))
            weighed = {r.effect for r in f.ranked} if h.effect not in STEPS else set[str]()
            for effect in (e for e in JUMPS if e in weighed):  # what came since tells how far from it they are
                jumps = STEPS[effect](unexplained)
                f = replace(f, ranked=(*(r for r in f.ranked if r.effect != effect), *jumps))
            ranked = best_first(f.ranked)
            if h.change.block is not None:
                ranked = doubted_last(unexplained, ranked, min(self.threshold, rules().keep_nats))
            self.found[k] = replace(f, ranked=tuple(ranked))


def find_effects(
    scene: Scene, cut: float | None, threshold: float, without: Collection[str], progress: Callable[[str], None]
) -> Named:
    """Search a recording, whole or up to a time.

    Parameters
    ----------
    scene, cut, threshold, without, progress
        As :class:`DriveProblem` and :func:`insemu.gap.find_gap` say.
    """
    problem = DriveProblem(scene, cut, threshold, without)
    search(problem, progress)
    if problem.noise_came_early():
        progress("the noise of the fixes again, next to what was found since")
        problem.noise_again(scene)
        search(problem, progress)
    if problem.split():
        progress("once more, with simpler effects in the place of a wide one")
        search(problem, progress)
    if problem.estimate_fixes_again():
        progress("once more, with noise and steps of the fixes as they are with the rest")
        search(problem, progress)
        problem.estimate_fixes_again()
    problem.keep_sure()
    if cut is None:
        # a name is that of the best explanation
        reconsider(problem, 0.0)
        problem.hold_against_the_rest()
    return problem.named()


# -- the whole recording --------------------------------------------------------------------------------------------------------------


@on_one_thread
def _held_out(
    at: RepairedDrive, scene: Scene, came: Flown | None, threshold: float, without: Collection[str], policy: Policy
) -> DriveScore:
    """Figures on the last part of the recording with effects named on the first; before them it is as it came."""
    with under(policy):
        start, end = float(scene.motion.t[0]), float(scene.motion.t[-1])
        cut = start + rules().naming_share * (end - start)
        first = find_effects(scene, cut, threshold, without, lambda _: None)
        plain = scene
        if came is not None:
            plain = Scene.of(came.prepared)
        elif at.noticed or at.late:
            plain = Scene.of(prepare(at.whole, at.believed, at.parts, at.levels))
        return held_out(plain, first, cut, scene, at.noticed)


def find_dynamic_gap(
    recording: Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    without: Collection[str] = (),
    progress: Callable[[str], None] | None = None,
    flown: Flown | None = None,
    came: Flown | None = None,
    pool: Executor | None = None,
) -> tuple[GapReport, Callable[[], DriveScore]]:
    """Find what a drive or flight has that the nominal model lacks.

    Parameters
    ----------
    recording, nominal, rng, without, progress, flown, pool
        As :func:`insemu.gap.find_gap` says; the recording has fixes.
    came : Flown, optional
        The nominal filter on the recording as it came, where something was taken off before.

    Returns
    -------
    report : GapReport
        Without figures on held-out fixes.
    held_out : callable
        These figures, worked out by the pool from now on, or when they are asked for.

    Raises
    ------
    InputError
        A missing belief, or a recording on which the nominal filter cannot run.
    """
    say = progress or (lambda _: None)
    say("running the nominal filter")
    missing = [a for a in AXES if a not in nominal.beliefs]
    if missing:
        raise InputError(
            f"no noise model is believed for {', '.join(missing)}; a recording with fixes needs all six axes"
        )
    at = RepairedDrive.of(recording, nominal, without, flown, say)
    say("responding every effect through the filter")
    scene = scene_under_colour(at.prepared)
    if scene.noise is not None:
        without = (*without, "gnss_correlated_noise")
    competing = [v for v in bank(scene) if v.effect not in without]
    threshold = max(rules().least_nats, null_threshold(competing, scene.data, rng, always=scene.always))
    scored = meanwhile(pool, _held_out, at, scene, came, threshold, without, rules())
    named = find_effects(scene, None, threshold, without, say)
    # a generator of its own: the search of a later pass draws what it always drew
    drawn, repeated = rng.spawn(2)
    starts = {name: r.start for name, r in at.fast}
    where = corrected([*innovation_tests(scene, scene.data.y), *drive_map(scene, scene.data.y, starts, drawn)])
    outliers = which(named.gone, recording)
    named, final, blocks = believing(named)
    residual, _ = final.data.residual(blocks)
    tests = innovation_tests(final, residual)
    failed = rejected(corrected(tests))
    fast = again_with_processes(
        at.fast, named.found, at.parts, at.nominal, max(threshold, rules().fast_nats), without, at.clipped
    )
    rest = corrected([*tests, *drive_map(final, residual, {name: r.end for name, r in fast}, drawn)])
    outages = outages_along(named.scene.loop, named.scene.motion)
    each = with_confusable([reported(f, named, outages) for f in named.found], named, without, repeated)
    findings, left = _doubted(each, named, fast, at, failed, outages)
    refined = dict(nominal.beliefs)
    for s in findings:
        refined = with_effect(refined, s)
    unknown = Interval(math.nan, math.nan, math.nan)
    report = GapReport(
        judged(findings, left), tuple(findings), where, rest, unknown, unknown, unknown, dict(nominal.beliefs), refined, threshold,
        recording.source, remainder=left, band=tuple(d.shaking for d in at.parts.values() if d.shaking is not None),
        stated_60s=stated_in_outages(at.prepared.result), outliers=outliers, unresolved=tuple(named.scene.original.unresolved.tolist()),
    )  # fmt: skip
    return report, scored


def _doubted(
    each: Sequence[Finding],
    named: Named,
    fast: Sequence[tuple[str, AxisResult]],
    at: RepairedDrive,
    failed: Sequence[Where],
    outages: Sequence[Outage],
) -> tuple[list[Finding], str]:
    """All findings, strongest first, those doubted where something unexplained sits in the same place; and what is left over, in words."""
    # where one axis vibrates so that no stationary process holds it, the same vibration is what changes on the others
    humming = any(r.outsider and vibrates(r) for _, r in fast)
    changing = {
        split_axis(name): r.outsider for name, r in fast if r.outsider and (humming or r.outsider.startswith(WANDERING))
    }
    own = [s.doubted() if failed else s for s in each]
    heard = [s.doubted() if is_doubtful(s, (), changing) else s for s in merged(dict(fast))]
    white = white_levels(at.believed.beliefs)
    heard = [replace(s, metres=worth_in_noise(s, white, outages)) for s in heard]
    heard = [with_delay(s, at.late.get(s.sensor, 0.0)) for s in heard]
    left = remainder(failed, changing)
    wrong = at.prepared.repaired.noise if at.prepared.repaired else {}
    seen = [with_white(s, wrong.get(s.effect, np.zeros(6)), outages) for s in at.noticed]
    return sorted([*joined(own), *heard, *seen], key=lambda s: -s.nats), left
