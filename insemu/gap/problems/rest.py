"""A log at rest as a problem: each axis searched on its own, and the report of all axes together.

The best candidate below the threshold means "nothing missing"; a lead over every other effect names it, otherwise all effects within the lead
form a class; then it is added, everything is estimated again, earlier effects are reconsidered, and the search goes on. "Unexplained" is said
where a test of the final model fails or where a structured alternative outside the catalogue beats it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.blas import on_one_thread
from insemu.effects import EffectUse
from insemu.errors import InputError
from insemu.gap.candidates import shared
from insemu.gap.candidates.axis import CANDIDATES, AxisHypothesis, AxisState, state_of
from insemu.gap.candidates.noise import turn_on_bias
from insemu.gap.checks import rest as checks
from insemu.gap.data.log import Reduced, reduce
from insemu.gap.evidence.model import Explanation, Likelihood, fit
from insemu.gap.holdout import HeldOut, gap_index, piece, score_axis
from insemu.gap.hypothesis import Found
from insemu.gap.policy import Policy, rules, under
from insemu.gap.problems.findings import (
    FAST,
    KNOWN_SHAPES,
    SLOW,
    UNTIDY,
    VARYING,
    AxisResult,
    gaps_of,
    is_doubtful,
    merged,
    refined_model,
    rejected,
    remainder,
    split_axis,
    taken_out,
)
from insemu.gap.problems.known_effects import known_on_axis, starting_explanation
from insemu.gap.search import Again, search
from insemu.gap.threshold import certain, nominal_tail, threshold_of, usual_tail
from insemu.gap.verdict import GapReport, Interval, Where, judged
from insemu.gap.worth import white_levels, worth_in_noise
from insemu.noise import NoiseModel, require_constant
from insemu.records import Series

Array = NDArray[np.float64]
#: Candidates that describe the same effect of the catalogue.
_EFFECT_OF = {"quantization_output": "quantization"}


def weigh_all(state: AxisState, without: Collection[str] = ()) -> list[AxisHypothesis]:
    """The best shape of every effect of the catalogue, best first."""
    best: dict[str, AxisHypothesis] = {}
    for name, candidate in CANDIDATES.items():
        if _EFFECT_OF.get(name, name) in without:
            continue
        for w in candidate(state):
            if math.isfinite(w.nats) and (w.effect not in best or w.nats > best[w.effect].nats):
                best[w.effect] = w
    return sorted(best.values(), key=lambda w: -w.nats)


class AxisProblem:
    """One axis of a log at rest, or of the band above the motion of a drive.

    Parameters
    ----------
    start : AxisState
    threshold : float, optional
        Evidence that an effect must exceed; the least of the policy where it is not given.
    without : collection of str
        Effects taken out of the catalogue.
    outsiders : bool
        Whether what was taken out is held against the catalogue as structure outside of it.
    """

    def __init__(
        self, start: AxisState, threshold: float | None = None, without: Collection[str] = (), outsiders: bool = True
    ) -> None:
        self.start = self.state = start
        self.threshold = rules().least_nats if threshold is None else threshold
        self.without = tuple(without)
        self.found: list[Found[AxisState]] = []
        self.outsider = ""
        self._beyond = tuple(name for name in without if name in CANDIDATES) if outsiders else ()

    def rank(self) -> list[AxisHypothesis]:
        """Every effect of the catalogue next to what was found."""
        return weigh_all(self.state, self.without)

    def choose(self, ranked: Sequence[AxisHypothesis]) -> Found[AxisState] | None:
        """The best effect, or one of known shape that holds next to it."""
        best = ranked[0] if ranked else None
        beyond = [w for name in self._beyond for w in CANDIDATES[name](self.state)]
        if beyond and max(w.nats for w in beyond) > max(best.nats if best else 0.0, 0.0) + rules().lead:
            # something of known structure that the catalogue does not hold fits better than anything it does
            self.outsider = max(beyond, key=lambda w: w.nats).effect
            return None
        if best is None or best.nats < self.threshold:
            return None
        return self._of_known_shape(ranked) or Found(best, tuple(ranked))

    def apply(self, new: Found[AxisState]) -> bool:
        """The axis as it is with the effect; where its spectrum then changes with time, a fast band that counts less."""
        self.found.append(new)
        self.state = new.chosen.change
        untidy = any(w.effect in UNTIDY and w.nats > self.threshold for w in new.ranked)
        fast = new.chosen.effect in FAST and new.chosen.variant != "output counts"
        if fast and not untidy and checks.drifting_spectrum(self.state) < rules().drifting_p:
            # no stationary process explains it, and more of them would only chase it; what is slow can still be found
            self.outsider, self._beyond = VARYING, ()
            self.without = (*self.without, *FAST, *UNTIDY)
            self.state = reweighted(self.state)
        elif self.state.data.weight is not None:
            self.state = reweighted(self.state)  # what was missing there is explained now
        return False

    def _of_known_shape(self, ranked: Sequence[AxisHypothesis]) -> Found[AxisState] | None:
        """An effect of known shape (temperature, ramp) that is worth adding although a slow process alone would explain more.

        A random walk follows any slow signal, so where both are there it comes first by evidence. The shape is real where it is worth its
        parameters even beside the process, which is asked here; its evidence is then what it explains alone, and its rivals keep their distance
        beside the process.
        """
        best = ranked[0]
        if best.effect not in SLOW or best.effect in KNOWN_SHAPES:
            return None
        for w in ranked:
            if w.effect not in KNOWN_SHAPES or w.nats < self.threshold:
                continue
            beside = weigh_all(best.change, self.without)
            own = next((v for v in beside if v.effect == w.effect), None)
            if own is not None and own.nats > self.threshold:
                # the shape that holds beside the process, fitted without it: the process follows as a finding of its own
                alone = [v for v in CANDIDATES[w.effect](self.state) if v.variant == own.variant]
                chosen = replace(alone[0] if alone else w, nats=w.nats)
                moved = [replace(v, nats=v.nats + w.nats - own.nats) for v in beside if v.effect != w.effect]
                return Found(chosen, tuple(sorted((chosen, *moved), key=lambda v: -v.nats)))
        return None

    def again(self, old: Found[AxisState]) -> Again[AxisState] | None:
        """An earlier effect beside the later ones; it loses nothing of the evidence with which it entered."""
        last, h, state = self.found[-1].chosen, old.chosen, self.state
        slow = is_slow(h, state.data)
        if old is self.found[-1] or taken_out(last) or taken_out(h):
            return None
        if h.effect in self.without or slow != is_slow(last, state.data):
            return None  # no more looked for, or of another band than what was added
        occurrence = sum(f.chosen.effect == h.effect for f in self.found[: self.found.index(old)])
        rest = _without(state.explanation, h.effect, occurrence)
        if rest is None:
            return None  # it was taken out of the samples: nothing to reconsider
        names = list(state.named)
        names.remove(h.effect)
        base = replace(state, fitted=fit(Likelihood(state.data), rest), named=tuple(names), memory={})
        others = FAST | UNTIDY - {"telegraph"} if slow else (SLOW | KNOWN_SHAPES) - {"gauss_markov"}
        rivals = weigh_all(base, (*self.without, *others - {h.effect}))
        ranked = [w for w in rivals if w.nats > -rules().lead and is_slow(w, state.data) == slow]
        kept = next((w for w in ranked if w.effect == h.effect), h)
        own = state.fitted.evidence - base.fitted.evidence
        own = max(own, kept.nats) if kept is not h else own
        shift = max(h.nats - own, 0.0)  # worth what it was at entry, or more where only the others let it be seen
        kept = replace(kept, nats=own + shift)
        moved = [replace(w, nats=w.nats + shift) for w in ranked if w.effect != h.effect]
        rival = moved[0] if moved and ranked[0].effect != h.effect and not taken_out(moved[0]) else None
        idle = own < 0.0 and (not ranked or ranked[0].nats < rules().lead)
        return Again(kept, tuple(sorted((kept, *moved), key=lambda w: -w.nats)), rival, idle, base)

    def put(self, old: Found[AxisState], new: AxisHypothesis, again: Again[AxisState]) -> None:
        """Let a hypothesis stand in the place of a finding; the axis changes where it is another effect."""
        self.found = [Found(new, again.ranked) if g is old else g for g in self.found]
        if new.effect != old.chosen.effect:
            self.state = new.change

    def drop(self, old: Found[AxisState], again: Again[AxisState]) -> None:
        """The axis without a finding."""
        assert again.rest is not None
        self.found = [g for g in self.found if g is not old]
        self.state = again.rest

    def carried_mean(self) -> None:
        """Add a turn-on bias, or the random walk that is its rival, where no rotation of the Earth explains the mean.

        How far a slow process may carry the mean depends on which one it is, so the bias must hold against each that could stand for one that
        was found, as far behind as that is.
        """
        if "turn_on_bias" in self.without:
            return
        weighed = [w for w in turn_on_bias(self.state) if w.effect not in self.without]
        bias = next((w for w in weighed if w.effect == "turn_on_bias"), None)
        if bias is not None and bias.nats > 0.0:
            nats = bias.nats
            for f in self.found:
                for w in f.ranked if f.chosen.effect in SLOW else ():
                    if w.effect in SLOW and w.effect != f.chosen.effect:
                        own = next((v.nats for v in turn_on_bias(w.change) if v.effect == "turn_on_bias"), nats)
                        nats = min(nats, own + max(f.chosen.nats - w.nats, 0.0))
            weighed = [replace(w, nats=nats) if w is bias else w for w in weighed]
        weighed.sort(key=lambda w: -w.nats)
        if weighed and weighed[0].nats >= self.threshold:
            self.found.append(Found(weighed[0], tuple(weighed)))
            self.state = weighed[0].change


def search_axis(
    start: AxisState,
    *,
    threshold: float | None = None,
    without: Collection[str] = (),
    progress: Callable[[str], None] = lambda _: None,
    outsiders: bool = True,
) -> AxisResult:
    """Find the effects of one axis; see :class:`AxisProblem`.

    Parameters
    ----------
    start : AxisState
        The axis with the nominal explanation.
    threshold : float, optional
        Evidence that an effect must exceed, nats.
    without : collection of str
        Effects taken out of the catalogue.
    progress : callable
        Told what is being done.
    outsiders : bool
        As :class:`AxisProblem` says.
    """
    problem = AxisProblem(start, threshold, without, outsiders)
    search(problem, lambda text: progress(f"{start.data.name}: {text}"))
    problem.carried_mean()
    return AxisResult(start, problem.state, tuple(problem.found), problem.outsider)


def reweighted(state: AxisState) -> AxisState:
    """Bins count only as far as the explanation describes the spectrum there: a fast band that no model fits must not bend the slow one.

    The weight is the inverse of the squared misfit in standard deviations, averaged over half an octave either way. Parameters change the
    weights and the weights the parameters, so it is done again after every effect that is added.
    """
    data = state.data
    if not data.f.size:
        return state
    z2 = data.dof / 2.0 * (state.explanation.seen(data) / state.explanation.psd(data.f, data.dt) - 1.0) ** 2
    octave = np.log2(data.f)
    misfit = np.array([float(np.mean(z2[np.abs(octave - o) <= 0.5])) for o in octave])
    weighted = data.weighed(1.0 / np.maximum(misfit, 1.0))
    return replace(state, data=weighted, fitted=fit(Likelihood(weighted), state.explanation), memory={})


def is_slow(w: AxisHypothesis, data: Reduced) -> bool:
    """Whether an effect lives in the block means rather than in the spectrum above them."""
    if w.effect == "gauss_markov":
        beta = next((v.value for v in w.values if v.name == "beta"), 0.0)
        return bool(beta * data.block_s < rules().slow_blocks)
    return w.effect in SLOW or w.effect in KNOWN_SHAPES


def _without(explanation: Explanation, effect: str, occurrence: int) -> Explanation | None:
    """The explanation less one effect (of several processes that one brought in, the given one), or ``None`` where it is no part of it."""
    if effect == "white_noise":
        return None  # a level is not dropped; it would leave no noise at all
    mine = [c for c in explanation.components if c.effect == effect]
    dropped = mine[min(occurrence, len(mine) - 1)] if mine else None
    components = tuple(c for c in explanation.components if c is not dropped)
    regressors = tuple(r for r in explanation.regressors if r.effect != effect)
    rolloff = None if explanation.rolloff is not None and explanation.rolloff.effect == effect else explanation.rolloff
    before = (len(explanation.components), len(explanation.regressors), explanation.rolloff)
    same = (len(components), len(regressors), rolloff) == before
    return None if same else Explanation(components, rolloff, regressors)


# -- the whole log ------------------------------------------------------------------------------------------------------------------


@on_one_thread
def find_static_gap(
    log: Sequence[Series],
    beliefs: Mapping[str, NoiseModel],
    *,
    rng: np.random.Generator,
    temperature: Array | None = None,
    missing: NDArray[np.bool_] | None = None,
    without: Collection[str] = (),
    hold_out: bool = True,
    source: str = "recording",
    progress: Callable[[str], None] | None = None,
    known: Mapping[str, Sequence[EffectUse]] | None = None,
    calibrate: bool = True,
    policy: Policy | None = None,
) -> GapReport:
    """Find what a static log has that the believed noise models lack.

    Parameters
    ----------
    log : sequence of Series
        Axes of one log, all of the same length and rate.
    beliefs : mapping of axis to NoiseModel
        What is believed; every level may be 20 % off before that counts as an effect.
    rng : Generator
        For the simulated logs of the map of checks.
    temperature : (n,) array, optional
        degC at the samples.
    missing : (n,) array of bool, optional
        Samples that the time stamps skip and that were filled in.
    without : collection of str
        Effects taken out of the catalogue.
    hold_out : bool
        Whether to name effects a second time on the first two thirds alone and score them on the last.
    known : mapping of axis to sequence of EffectUse, optional
        Low-pass and rounding that are known and not asked for.
    calibrate : bool
        Whether a weak effect must also be worth more than the best candidate is in 2 % of simulated nominal logs.
    policy : Policy, optional
        The constants of the search; those in force where it is not given.

    Raises
    ------
    InputError
        No axis, an axis without a belief, too few samples, a temperature of another length.
    """
    _check(log, beliefs, temperature)
    with under(policy):
        at = _Log(log, beliefs, temperature, without, known or {}, progress or (lambda _: None))
        results, threshold = at.searched(calibrate)
        held = at.held_out(results, threshold) if hold_out else []
        return at.report(results, threshold, held, missing, rng, source)


@dataclass(frozen=True)
class _Log:
    """A static log with what is believed of it."""

    log: Sequence[Series]
    beliefs: Mapping[str, NoiseModel]
    temperature: Array | None
    without: Collection[str]
    known: Mapping[str, Sequence[EffectUse]]
    say: Callable[[str], None]

    def nominal(self, s: Series) -> Explanation:
        """What is believed of an axis."""
        return starting_explanation(self.beliefs[s.name], self.known.get(s.name, ()), s.dt)

    def searched(self, calibrate: bool) -> tuple[dict[str, AxisResult], float]:
        """The effects of every axis and the threshold that they had to exceed."""
        results, threshold = {}, rules().least_nats
        for s in self.log:
            self.say(f"{s.name}: weighing candidates")
            named = known_on_axis(self.known.get(s.name, ()))
            start = state_of(reduce(s), self.nominal(s), self.temperature, named)
            results[s.name] = search_axis(start, threshold=threshold, without=self.without, progress=self.say)
        past_doubt = certain(len(self.log))
        weak = [k for k, r in results.items() if any(threshold <= f.chosen.nats < past_doubt for f in r.found)]
        if not (calibrate and weak):
            return results, threshold
        self.say("simulating the nominal model for the threshold")
        tails = [
            nominal_tail(results[s.name].start, self.nominal(s), weigh_all, self.without)
            if s.name in weak
            else usual_tail()
            for s in self.log
        ]
        higher = threshold_of(tails, threshold)
        for k in weak:
            if higher > threshold and any(f.chosen.nats < higher for f in results[k].found):
                results[k] = search_axis(results[k].start, threshold=higher, without=self.without, progress=self.say)
        return results, higher

    def held_out(self, results: Mapping[str, AxisResult], threshold: float) -> list[HeldOut]:
        """Effects named a second time on the first part of every axis, scored on the last."""
        out = []
        for s in self.log:
            self.say(f"{s.name}: scoring on held-out data")
            data, nominal = results[s.name].start.data, self.nominal(s)
            cut = int(len(s) * rules().naming_share) // data.block * data.block
            T = self.temperature
            T1, T2 = (None, None) if T is None else (T[:cut], T[cut:])
            start = state_of(piece(data, 0, cut), nominal, T1, known_on_axis(self.known.get(s.name, ())))
            named = search_axis(start, threshold=threshold, without=self.without)
            out.append(score_axis(named.end, named.taken_out(), nominal, piece(data, cut, len(s)), T2))
        return out

    def report(
        self,
        results: Mapping[str, AxisResult],
        threshold: float,
        held: Sequence[HeldOut],
        missing: NDArray[np.bool_] | None,
        rng: np.random.Generator,
        source: str,
    ) -> GapReport:
        """All axes together: the map before and after, findings, verdict, figures."""
        ends = {name: r.end for name, r in results.items()}
        white = {name: shared.whitened_blocks(s, checks.innovations_of(s)) for name, s in ends.items()}
        known = shared.believed_coherence(ends, white)
        slow = [] if shared.EFFECT in self.without else shared.common(ends, white, known)
        groups = shared.groups_of(together := [c for c in slow if c.nats > threshold])
        before = _map(results, rng, slow, refined=False)
        settled_pairs = [replace(c, p_value=1.0) if c in together else c for c in slow]
        after = _map(results, rng, settled_pairs, refined=True)
        findings = (*merged(results), *(shared.finding_of(names, together) for names, _ in groups))
        findings = tuple(sorted(findings, key=lambda s: -s.nats))
        refined = {name: refined_model(r) for name, r in results.items()}
        for k, (_, shares) in enumerate(groups):
            data = ends[next(iter(shares))].data
            refined = shared.with_common(refined, shares, f"common{k + 1}", data.block_s, data.dt)
        if missing is not None and "dropped_samples" not in self.without:
            findings = tuple(sorted((*findings, *gaps_of(missing)), key=lambda s: -s.nats))
        failed = rejected(after)
        outsiders = {split_axis(name): r.outsider for name, r in results.items() if r.outsider}
        levels = white_levels(self.beliefs)
        findings = tuple(replace(s, metres=worth_in_noise(s, levels)) for s in findings)
        findings = tuple(s.doubted() if is_doubtful(s, failed, outsiders) else s for s in findings)
        left = remainder(failed, outsiders)
        nothing = Interval(math.nan, math.nan, math.nan)
        blocks = sum(h.blocks for h in held) / max(len(held), 1)
        spread = math.sqrt(sum(h.uncertainty**2 for h in held)) / max(len(held), 1)
        return GapReport(
            judged(findings, left),
            findings,
            before,
            after,
            gap_index([h.before for h in held]) if held else nothing,
            gap_index([h.after for h in held], spread) if held else nothing,
            Interval.normal(sum(h.nats for h in held) / blocks, math.sqrt(sum(h.variance for h in held)) / blocks)
            if held
            else nothing,
            dict(self.beliefs),
            refined,
            threshold,
            source,
            {name: _curves(r, rng) for name, r in results.items()},
            left,
        )


def _check(log: Sequence[Series], beliefs: Mapping[str, NoiseModel], temperature: Array | None) -> None:
    if not log:
        raise InputError("the log has no axis")
    require_constant(beliefs.values(), "insemu gap of a log at rest")
    for s in log:
        if s.name not in beliefs:
            raise InputError(
                f"no noise model is believed for the axis '{s.name}', expected one (beliefs are for {', '.join(beliefs) or 'no axis'})"
            )
        if len(s) < 480:
            raise InputError(
                f"{s.name} has {len(s)} samples, expected at least 480 to tell one noise process from another"
            )
        if float(np.ptp(s.values)) == 0.0:
            raise InputError(f"{s.name} is constant ({s.values[0]!r}); expected a signal with noise")
        if temperature is not None and temperature.shape != (len(s),):
            raise InputError(f"the temperature has shape {temperature.shape}, expected ({len(s)},) as {s.name} has")


def _map(
    results: Mapping[str, AxisResult], rng: np.random.Generator, slow: Sequence[shared.Common], *, refined: bool
) -> tuple[Where, ...]:
    entries: list[tuple[str, str, str, float | None, float]] = []
    states = {}
    for name, r in results.items():
        sensor, axis = split_axis(name)
        state = r.end if refined else r.start
        states[name] = state
        spent = checks.spent_on(state)
        if not refined:
            for scale, _, _, p in checks.wavelet_p_values(state.data, state.explanation, rng, spent):
                entries.append(("wavelet_variance", sensor, axis, scale, p))
        entries += [(statistic, sensor, axis, scale, p) for statistic, scale, p in checks.axis_tests(state, spent)]
    for a, b, p in checks.cross_axis_tests(states):
        entries.append(("cross_axis " + b, *split_axis(a), None, p))
    for c in slow:
        block_s = states[c.axes[0]].data.block_s
        entries.append(("cross_axis slow " + c.axes[1], *split_axis(c.axes[0]), block_s, c.p_value))
    return checks.corrected(entries)


def _curves(result: AxisResult, rng: np.random.Generator) -> dict[str, object]:
    """Wavelet variance measured, believed and refined, and the spectrum: what the page draws."""
    start, end = result.start, result.end
    rows = checks.wavelet_p_values(start.data, start.explanation, rng)
    left = end.data
    if end.explanation.regressors:
        mean, _ = end.likelihood.coefficients(end.explanation)
        known = np.hstack([r.columns for r in end.explanation.regressors]) @ mean
        left = replace(left, differences=np.asarray(left.differences - known))
    refined = checks.wavelet_p_values(left, replace(end.explanation, regressors=()), rng)
    return {
        "unit": start.data.unit,
        "tau_s": [r[0] for r in rows],
        "measured": [r[1] for r in rows],
        "nominal": [r[2] for r in rows],
        "refined": [r[2] for r in refined],
        "measured_after": [r[1] for r in refined],
        "f": start.data.f.tolist(),
        "power": start.data.power.tolist(),
        "nominal_psd": start.explanation.psd(start.data.f, start.data.dt).tolist() if start.data.f.size else [],
        "refined_psd": end.explanation.psd(start.data.f, start.data.dt).tolist() if start.data.f.size else [],
    }
