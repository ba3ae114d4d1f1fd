"""The gap of a static log: find the missing effects axis by axis, add them, and show the gap shrink on the part that was not used.

Policy: the best candidate below the threshold means "nothing missing"; a lead of 3 nats over every other effect names it, otherwise all
effects within 3 nats form a class; then it is added, everything is estimated again, earlier effects are reconsidered, and the search goes on.
"Unexplained" is said where a test of the final model fails or where a structured alternative outside the catalogue beats it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.blas import on_one_thread
from insemu.effects import EffectUse, having
from insemu.errors import InputError
from insemu.gap.candidates.axis import CANDIDATES, AxisState, Weighed, state_of
from insemu.gap.candidates.noise import turn_on_bias
from insemu.gap.checks import rest as checks
from insemu.gap.data.log import Reduced, reduce
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.model import Component, Explanation, Likelihood, fit
from insemu.gap.policy import Policy, rules, under
from insemu.gap.problems.known import settled, starting_explanation
from insemu.gap.threshold import certain, nominal_tail, threshold_of, usual_tail
from insemu.gap.verdict import GapReport, Interval, Member, Step, Value, Where, judged
from insemu.noise import DR, SIN, NoiseModel, Process
from insemu.records import Series

Array = NDArray[np.float64]

VARYING = "vibration that changes with time"

#: Effects whose shape in time is known.
KNOWN_SHAPES = having("shape")
#: Candidates that describe the same effect of the catalogue.
_EFFECT_OF = {"quantization_output": "quantization"}
_SENSORS = {"gyro": "gyro", "accel": "accel"}


@dataclass(frozen=True)
class Found:
    """One named effect of one axis, with everything it was compared with."""

    chosen: Weighed
    ranked: tuple[Weighed, ...]
    confidence: float


@dataclass(frozen=True)
class AxisResult:
    """One axis: start, end, and the effects between."""

    start: AxisState
    end: AxisState
    found: tuple[Found, ...]
    outsider: str = ""


def weigh_all(state: AxisState, without: Collection[str] = ()) -> list[Weighed]:
    """The best shape of every effect of the catalogue, best first."""
    best: dict[str, Weighed] = {}
    for name, candidate in CANDIDATES.items():
        if _EFFECT_OF.get(name, name) in without:
            continue
        for w in candidate(state):
            if math.isfinite(w.gain) and (w.effect not in best or w.gain > best[w.effect].gain):
                best[w.effect] = w
    return sorted(best.values(), key=lambda w: -w.gain)


def _confidence(ranked: Sequence[Weighed]) -> float:
    """Probability of the first effect among the others and nothing, each alike before the data."""
    gains = np.array([w.gain for w in ranked] + [math.log(max(len(ranked), 1))])
    p = np.exp(gains - gains.max())
    return float(p[0] / p.sum())


def search(
    state: AxisState,
    *,
    threshold: float | None = None,
    without: Collection[str] = (),
    progress: Callable[[str], None] | None = None,
    outsiders: bool = True,
) -> AxisResult:
    """Name, add and reconsider effects of one axis until nothing more is worth the threshold."""
    threshold = rules().least_nats if threshold is None else threshold
    start, found = state, []
    outsider = ""
    excluded = bool(without) and outsiders
    for _ in range(rules().most_effects):
        ranked = weigh_all(state, without)
        best = ranked[0] if ranked else None
        beyond = [w for name in (without if excluded else ()) if name in CANDIDATES for w in CANDIDATES[name](state)]
        if beyond and max(w.gain for w in beyond) > max(best.gain if best else 0.0, 0.0) + rules().lead:
            # something of known structure that the catalogue does not hold fits better than anything it does
            outsider = max(beyond, key=lambda w: w.gain).effect
            break
        if best is None or best.gain < threshold:
            break
        new = _of_known_shape(state, ranked, threshold, without) or Found(best, tuple(ranked), _confidence(ranked))
        if progress:
            progress(f"{state.data.name}: {new.chosen.effect} {new.chosen.gain:.1f} nats")
        found.append(new)
        state = new.chosen.state
        untidy = any(w.effect in _UNTIDY and w.gain > threshold for w in ranked)
        fast = new.chosen.effect in _FAST and new.chosen.variant != "output counts"
        if fast and not untidy and checks.drifting_spectrum(state) < rules().drifting_p:
            # no stationary process explains it, and more of them would only chase it; what is slow can still be told
            outsider = VARYING
            without = (*without, *_FAST, *_UNTIDY)
            excluded = False
            state = tempered(state)
        elif state.data.weight is not None:
            state = tempered(state)  # what was missing there is explained now
        if len(found) > 1 and not _taken_out(new.chosen):
            state, found = _reconsider(state, found, without)
    if "turn_on_bias" not in without:
        carried = _carried_mean(state, found, without)
        if carried and carried[0].gain >= threshold:
            found.append(Found(carried[0], tuple(carried), _confidence(carried)))
            state = carried[0].state
    return AxisResult(start, state, tuple(found), outsider)


def _carried_mean(state: AxisState, found: Sequence[Found], without: Collection[str]) -> list[Weighed]:
    """What a mean that no rotation of the Earth explains is worth as a turn-on bias and as a random walk, best first.

    How far a slow process may carry the mean depends on which one it is, so the bias must hold against each that could stand for one that was
    found, as far behind as that is.
    """
    weighed = [w for w in turn_on_bias(state) if w.effect not in without]
    bias = next((w for w in weighed if w.effect == "turn_on_bias"), None)
    if bias is None or bias.gain <= 0.0:
        return sorted(weighed, key=lambda w: -w.gain)
    gain = bias.gain
    for f in found:
        if f.chosen.effect not in _SLOW:
            continue
        for w in f.ranked:
            if w.effect in _SLOW and w.effect != f.chosen.effect:
                own = next((v.gain for v in turn_on_bias(w.state) if v.effect == "turn_on_bias"), gain)
                gain = min(gain, own + max(f.chosen.gain - w.gain, 0.0))
    return sorted((replace(w, gain=gain) if w is bias else w for w in weighed), key=lambda w: -w.gain)


def _of_known_shape(
    state: AxisState, ranked: Sequence[Weighed], threshold: float, without: Collection[str]
) -> Found | None:
    """An effect of known shape (temperature, ramp) that is worth adding although a slow process alone would explain more.

    A random walk follows any slow signal, so where both are there it comes first by evidence. The shape is real where it is worth its
    parameters even beside the process, which is asked here; its gain is then what it explains alone, and its rivals keep their distance beside
    the process.
    """
    best = ranked[0]
    if best.effect not in _SLOW or best.effect in KNOWN_SHAPES:
        return None
    for w in ranked:
        if w.effect not in KNOWN_SHAPES or w.gain < threshold:
            continue
        beside = weigh_all(best.state, without)
        own = next((v for v in beside if v.effect == w.effect), None)
        if own is not None and own.gain > threshold:
            shift = w.gain - own.gain
            # the shape that holds beside the process, fitted without it: the process follows as a step of its own
            alone = [v for v in CANDIDATES[w.effect](state) if v.variant == own.variant]
            chosen = alone[0] if alone else w
            moved = tuple(replace(v, gain=v.gain + shift) for v in beside if v.effect != w.effect)
            ordered = sorted((replace(chosen, gain=w.gain), *moved), key=lambda v: -v.gain)
            return Found(replace(chosen, gain=w.gain), tuple(ordered), _confidence(ordered))
    return None


def tempered(state: AxisState) -> AxisState:
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
    weight = 1.0 / np.maximum(misfit, 1.0)
    tempered = replace(data, weight=weight)
    return replace(state, data=tempered, fitted=fit(Likelihood(tempered), state.explanation), memory={})


def _reconsider(state: AxisState, found: list[Found], without: Collection[str]) -> tuple[AxisState, list[Found]]:
    """Try to drop or to replace each earlier effect now that later ones are known; none loses of the gain with which it entered."""
    seen: dict[str, int] = {}
    for f in list(found[:-1]):
        effect = f.chosen.effect
        occurrence = seen.get(effect, 0)
        seen[effect] = occurrence + 1
        slow = is_slow(f.chosen, state.data)
        if _taken_out(f.chosen) or effect in without or slow != is_slow(found[-1].chosen, state.data):
            continue  # no more looked for, or of another band than what was added
        rest = _without(state.explanation, effect, occurrence)
        if rest is None:
            continue  # it was taken out of the samples: nothing to reconsider
        names = list(state.named)
        names.remove(effect)
        base = replace(state, fitted=fit(Likelihood(state.data), rest), named=tuple(names), memory={})
        others = _FAST | _UNTIDY - {"telegraph"} if slow else (_SLOW | KNOWN_SHAPES) - {"gauss_markov"}
        rivals = weigh_all(base, (*without, *others - {effect}))
        ranked = [w for w in rivals if w.gain > -rules().lead and is_slow(w, state.data) == slow]
        kept = next((w for w in ranked if w.effect == effect), None)
        own = max(state.fitted.evidence - base.fitted.evidence, kept.gain if kept else -math.inf)
        # worth what it was at entry, or more where only the others let it be seen
        shift = max(f.chosen.gain - own, 0.0)
        moved = tuple(replace(w, gain=w.gain + shift) for w in ranked if w.effect != effect)
        if own < 0.0 and (not ranked or ranked[0].gain < rules().lead):
            found = [g for g in found if g is not f]
            state = base
            seen[effect] -= 1
        elif (
            ranked
            and ranked[0].effect != effect
            and ranked[0].gain > own + rules().swap_nats
            and not _taken_out(ranked[0])
        ):
            swapped = replace(ranked[0], gain=ranked[0].gain + shift)
            order = tuple(sorted((replace(f.chosen, gain=own + shift), *moved), key=lambda w: -w.gain))
            found = [Found(swapped, order, _confidence(order)) if g is f else g for g in found]
            state = ranked[0].state
            seen[effect] -= 1
        else:
            # same name, but ranked against its rivals with the other effects in place
            fresh = replace(kept, gain=own + shift) if kept is not None else f.chosen
            order = tuple(sorted((fresh, *moved), key=lambda w: -w.gain))
            found = [Found(fresh, order, _confidence(order)) if g is f else g for g in found]
    return state, found


def is_slow(w: Weighed, data: Reduced) -> bool:
    """Whether an effect lives in the block means rather than in the spectrum above them."""
    if w.effect == "gauss_markov":
        beta = next((v.value for v in w.values if v.name == "beta"), 0.0)
        return bool(beta * data.block_s < rules().slow_blocks)
    return w.effect in _SLOW or w.effect in KNOWN_SHAPES


def _taken_out(w: Weighed) -> bool:
    if w.effect == "telegraph":
        return w.variant == "levels"
    return w.effect in having("drawn", "samples") or w.variant == "output counts"


def _without(explanation: Explanation, effect: str, occurrence: int = 0) -> Explanation | None:
    """The explanation less one effect (of several processes that one brought in, the given one), or ``None`` where it is no part of it."""
    if effect == "white_noise":
        return None  # a level is not dropped; it would leave no noise at all
    mine = [c for c in explanation.components if c.effect == effect]
    dropped = mine[min(occurrence, len(mine) - 1)] if mine else None
    components = tuple(c for c in explanation.components if c is not dropped)
    regressors = tuple(r for r in explanation.regressors if r.effect != effect)
    rolloff = None if explanation.rolloff is not None and explanation.rolloff.effect == effect else explanation.rolloff
    smaller = Explanation(components, rolloff, regressors)
    return None if smaller == explanation or (len(components), len(regressors), rolloff) == (
        len(explanation.components), len(explanation.regressors), explanation.rolloff
    ) else smaller  # fmt: skip


# -- held out -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Log score of a model on data, with what its uncertainty and the reduced chi-square need."""

    log_score: float
    chi_square: Array
    dof: Array


def score(data: Reduced, explanation: Explanation, extra: Array | None = None) -> Score:
    """Log score and, for the block band and each octave above it, the sum of squared whitened innovations with its degrees of freedom."""
    y = data.differences - (extra if extra is not None else 0.0)
    moved = replace(data, differences=np.asarray(y))
    plain = replace(explanation, regressors=())
    likelihood = Likelihood(moved)
    e = checks.block_innovations(moved, plain)
    squares, dof = [float(e @ e)], [float(e.size)]
    if data.f.size:
        ratio = data.dof * plain.seen(data) / plain.psd(data.f, data.dt)
        octave = np.floor(np.log2(data.f / data.f[0])).astype(int)
        for k in np.unique(octave):
            squares.append(float(ratio[octave == k].sum()))
            dof.append(float(data.dof[octave == k].sum()))
    return Score(likelihood.low(plain) + likelihood.high(plain), np.array(squares), np.array(dof))


def gap_index(scores: Sequence[Score], uncertainty: float = 0.0) -> Interval:
    """Reduced chi-square over axes, the block band and each octave counting alike; 1 where model and data agree.

    Parameters
    ----------
    scores : sequence of Score
        One per axis.
    uncertainty : float
        Standard deviation that the estimated parameters add.
    """
    ratio = np.concatenate([s.chi_square / s.dof for s in scores])
    variance = np.concatenate([2.0 / s.dof for s in scores]) * ratio**2
    value = float(ratio.mean())
    sd = math.sqrt(float(variance.sum()) / ratio.size**2 + uncertainty**2)
    return Interval(value, value - 1.96 * sd, value + 1.96 * sd)


def _piece(data: Reduced, first: int, last: int) -> Reduced:
    return reduce(Series(data.values[first:last], 1.0 / data.dt, data.unit, data.name), data.block)


def _regressor_prediction(state: AxisState, test: Reduced, temperature: Array | None) -> Array | None:
    """Block differences of the named deterministic effects, carried over to other data of the same axis."""
    explanation = state.explanation
    if not explanation.regressors:
        return None
    mean, _ = state.likelihood.coefficients(explanation)
    columns = []
    for r in explanation.regressors:
        if r.rebuild is None:
            return None
        columns.append(r.rebuild(test, temperature))
    return np.asarray(np.hstack(columns) @ mean)


@dataclass(frozen=True)
class HeldOut:
    """Figures of one axis on data that was not used for naming."""

    before: Score
    after: Score
    gain: float
    variance: float
    blocks: int
    uncertainty: float


def held_out(result: AxisResult, nominal: Explanation, test: Reduced, temperature: Array | None) -> HeldOut:
    """Score the nominal and the refined model of an axis on other data of it.

    Effects that are taken out of the samples (lines, outliers, levels, held samples) are taken out of the test data by the same
    candidate; what that is worth there has its own parameters already paid.
    """
    before = score(test, nominal)
    bonus = 0.0
    twins: list[Component] = []
    state = AxisState(test, fit(Likelihood(test), replace(result.end.explanation, regressors=())), temperature)
    for f in result.found:
        if _taken_out(f.chosen) and f.chosen.effect not in ("quantization", "saturation"):
            tried = [w for w in CANDIDATES[f.chosen.effect](state) if w.gain > 0.0]
            if not tried:
                continue
            best = max(tried, key=lambda w: w.gain)
            state = best.state
            if best.effect == "telegraph" and best.variant != "levels":
                twins.append(state.explanation.components[-1])  # scored with the model, not taken out
            else:
                bonus += best.gain
    final = state.data
    explanation = result.end.explanation
    for twin in twins:
        explanation = explanation.with_component(twin)
    after = score(final, explanation, _regressor_prediction(result.end, final, temperature))
    plain = score(final, nominal) if bonus else before
    gain = after.log_score - plain.log_score + bonus
    # sampling variance of the gain, band by band: half the squares times the change of precision
    change = (after.chi_square - plain.chi_square) / after.dof
    variance = float(np.sum(change**2 * after.dof / 2.0) + abs(bonus))
    sigma = result.end.fitted.sigma
    level = (
        float(np.sqrt(np.mean(np.minimum(2.0 * sigma, 0.5) ** 2))) / math.sqrt(after.dof.size) if sigma.size else 0.0
    )
    return HeldOut(before, after, gain, variance, final.differences.size, level)


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
        return _static_gap(
            log,
            beliefs,
            rng,
            temperature,
            missing,
            without,
            hold_out,
            source,
            progress or (lambda _: None),
            known or {},
            calibrate,
        )


def _static_gap(
    log: Sequence[Series],
    beliefs: Mapping[str, NoiseModel],
    rng: np.random.Generator,
    temperature: Array | None,
    missing: NDArray[np.bool_] | None,
    without: Collection[str],
    hold_out: bool,
    source: str,
    progress: Callable[[str], None],
    known: Mapping[str, Sequence[EffectUse]],
    calibrate: bool,
) -> GapReport:
    """What :func:`find_static_gap` does, under the policy in force."""
    threshold = rules().least_nats
    say = progress
    nominal = {s.name: starting_explanation(beliefs[s.name], known.get(s.name, ()), s.dt) for s in log}
    named_before = {s.name: settled(known.get(s.name, ())) for s in log}
    results: dict[str, AxisResult] = {}
    held: dict[str, HeldOut] = {}
    for s in log:
        say(f"{s.name}: weighing candidates")
        results[s.name] = search(
            state_of(reduce(s), nominal[s.name], temperature, named_before[s.name]),
            threshold=threshold,
            without=without,
            progress=progress,
        )
    past_doubt = certain(len(log))
    weak = [k for k, r in results.items() if any(threshold <= f.chosen.gain < past_doubt for f in r.found)]
    if calibrate and weak:
        say("simulating the nominal model for the threshold")
        tails = [
            nominal_tail(r.start, nominal[k], weigh_all, without) if k in weak else usual_tail()
            for k, r in results.items()
        ]
        higher = threshold_of(tails, threshold)
        for k in weak:
            if higher > threshold and any(f.chosen.gain < higher for f in results[k].found):
                results[k] = search(results[k].start, threshold=higher, without=without, progress=progress)
        threshold = higher
    for s in log:
        if hold_out:
            say(f"{s.name}: scoring on held-out data")
            data = results[s.name].start.data
            cut = int(len(s) * rules().naming_share) // data.block * data.block
            part = _piece(data, 0, cut)
            T1, T2 = (None, None) if temperature is None else (temperature[:cut], temperature[cut:])
            named = search(
                state_of(part, nominal[s.name], T1, named_before[s.name]), threshold=threshold, without=without
            )
            held[s.name] = held_out(named, nominal[s.name], _piece(data, cut, len(s)), T2)
    before = _map(results, rng, nominal, refined=False)
    after = _map(results, rng, nominal, refined=True)
    steps = merged_steps(results)
    if missing is not None and "dropped_samples" not in without:
        steps = tuple(sorted((*steps, *gaps_of(missing)), key=lambda s: -s.gain_nats))
    failed = [w for w in after if w.p_value < rules().omnibus_rest]
    outsiders = {split_axis(name): r.outsider for name, r in results.items() if r.outsider}
    steps = tuple(s.doubted() if is_shaken(s, failed, outsiders) else s for s in steps)
    left = remainder(failed, outsiders)
    verdict = judged(steps, left)
    nothing = Interval(math.nan, math.nan, math.nan)
    gains = nothing
    if held:
        blocks = sum(h.blocks for h in held.values()) / len(held)
        total, sd = sum(h.gain for h in held.values()), math.sqrt(sum(h.variance for h in held.values()))
        gains = Interval(total / blocks, (total - 1.96 * sd) / blocks, (total + 1.96 * sd) / blocks)
    spread = math.sqrt(sum(h.uncertainty**2 for h in held.values())) / max(len(held), 1)
    return GapReport(
        verdict,
        steps,
        before,
        after,
        gap_index([h.before for h in held.values()]) if held else nothing,
        gap_index([h.after for h in held.values()], spread) if held else nothing,
        gains,
        dict(beliefs),
        {name: refined_model(r) for name, r in results.items()},
        threshold,
        source,
        {name: _curves(r, nominal[name], rng) for name, r in results.items()},
        left,
    )


#: Tests of the fast band; all others look at block means.
_FAST_TESTS = frozenset({"spectrum", "stationarity", "noise level over time", "tails"})
#: Effects that are read off the samples or go with a signal that was recorded beside them: nothing unexplained can stand in for them.
_PLAIN = having("evident")


def is_shaken(step: Step, failed: Sequence[Where], outsiders: Mapping[tuple[str, str], str]) -> bool:
    """Whether something that no candidate explains sits where a step was named: the same axis, the same band."""
    if step.effect in _PLAIN or step.variant in ("output counts", "levels"):
        return False
    axes = {(step.sensor, a) for a in step.axes or ("",)}
    fast = step.effect in _FAST or step.effect in _UNTIDY - {"telegraph"}
    for place, what in outsiders.items():
        if place in axes and (fast or what != VARYING):
            return True
    for w in failed:
        if (w.sensor, w.axis) not in axes or w.statistic.startswith("cross_axis"):
            continue
        if fast == (w.statistic in _FAST_TESTS):
            return True
    return False


def remainder(failed: Sequence[Where], outsiders: Mapping[tuple[str, str], str]) -> str:
    """What is left unexplained, in words; empty where nothing is."""
    places: dict[str, list[str]] = {}
    for place, what in outsiders.items():
        places.setdefault(what, []).append(" ".join(place).strip())
    parts = [f"{what} on {', '.join(axes)}" for what, axes in places.items()]
    for w in failed:
        scale = f" at {w.scale_s:.3g} s" if w.scale_s is not None else ""
        parts.append(f"{w.statistic}{scale} on {w.sensor} {w.axis} (p {w.p_value:.1g})".replace("  ", " "))
    return "; ".join(parts)


def gaps_of(missing: NDArray[np.bool_]) -> tuple[Step, ...]:
    """Samples that the stamps skip, as a step: share of samples that start a gap, mean length of a gap."""
    lost = int(missing.sum())
    if not lost:
        return ()
    bursts = int(np.sum(missing[1:] & ~missing[:-1])) + int(missing[0])
    share, length = bursts / missing.size, lost / bursts
    sd = 1.0 / math.sqrt(bursts)
    values = (
        Value("probability", share, share * math.exp(-1.96 * sd), share * math.exp(1.96 * sd), "1"),
        Value("burst", length, max(1.0, length * (1.0 - 1.96 * sd)), length * (1.0 + 1.96 * sd), "1"),
    )
    # every gap is seen in the stamps; against stamps that skip once in the whole log by accident
    gain = bursts * max(math.log(share * missing.size), 0.0) + 1.0
    if gain < rules().least_nats:
        return ()
    own = Member("dropped_samples", "imu", (), gain)
    return (Step("dropped_samples", "time stamps", "imu", (), values, 1.0, gain, (own,)),)


def _check(log: Sequence[Series], beliefs: Mapping[str, NoiseModel], temperature: Array | None) -> None:
    if not log:
        raise InputError("the log has no axis")
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


def refined_model(result: AxisResult) -> NoiseModel:
    """The noise model of an axis with the stochastic effects that were found; deterministic ones are in the steps."""
    processes: list[Process] = []
    dt = result.end.data.dt
    for c in result.end.explanation.components:
        p = c.process
        processes.append(p.autoregression(dt) if isinstance(p, Band) else p)
    for f in result.found:
        given = {v.name: v.value for v in f.chosen.values}
        if f.chosen.effect == "vibration_line":
            processes.append(SIN(given["amplitude"], given["frequency"]))
        elif f.chosen.effect == "ramp":
            processes.append(DR(given["R"]))
        elif f.chosen.effect == "telegraph" and f.chosen.variant == "levels":
            # the second-order twin: what a linear filter can carry of it
            from insemu.noise import GM

            processes.append(GM(given["amplitude"], 2.0 * given["rate"]))
    return NoiseModel(tuple(processes))


def split_axis(name: str) -> tuple[str, str]:
    """Sensor and axis of a column name: ``gyro_x`` -> ``("gyro", "x")``; other names are their own sensor."""
    sensor, _, axis = name.rpartition("_")
    return (_SENSORS[sensor], axis) if sensor in _SENSORS and axis in "xyz" else (name, "")


def _map(
    results: Mapping[str, AxisResult], rng: np.random.Generator, nominal: Mapping[str, Explanation], *, refined: bool
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
    return checks.corrected(entries)


def _curves(result: AxisResult, nominal: Explanation, rng: np.random.Generator) -> dict[str, object]:
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


#: What would tell effects of a class apart.
_SLOW, _FAST = having("slow"), having("fast")
#: What disturbs single samples or pieces of a log.
_UNTIDY = having("samples")


def would_separate(effects: Collection[str], duration_s: float) -> str:
    """The recording that would tell a class apart, in words."""
    names = set(effects)
    if len(names) < 2:
        return ""
    if "temperature" in names:
        return "a log in which the temperature goes up and down again, so that it does not run along with time"
    if names <= _SLOW:
        return f"a static log of at least {_hours(10.0 * duration_s)} (ten times as long): the processes part at the longest averaging times"
    if names <= _FAST:
        return (
            "a log at a higher sampling rate, or without the output filter: the processes part above the present band"
        )
    return f"a static log at a higher rate and of at least {_hours(10.0 * duration_s)}"


def _hours(seconds: float) -> str:
    return f"{seconds / 3600.0:.3g} h" if seconds >= 3600.0 else f"{seconds / 60.0:.3g} min"


def _shapes(items: Sequence[tuple[str, Found, AxisResult]]) -> str:
    """Shape of an effect; where axes differ, with the axes of each."""
    by_shape: dict[str, list[str]] = {}
    for axis, f, _ in items:
        by_shape.setdefault(f.chosen.variant, []).append(axis)
    if len(by_shape) == 1:
        return next(iter(by_shape))
    return ", ".join(f"{shape or 'plain'} ({' '.join(axes)})" for shape, axes in by_shape.items())


def merged_steps(results: Mapping[str, AxisResult]) -> tuple[Step, ...]:
    """Steps of all axes; the same effect on several axes of a sensor is one step, with a parameter set per axis.

    A second process of the same kind on an axis is a step of its own.
    """
    groups: dict[tuple[str, str, int], list[tuple[str, Found, AxisResult]]] = {}
    for name, r in results.items():
        sensor, axis = split_axis(name)
        seen: dict[str, int] = {}
        for f in r.found:
            occurrence = seen[f.chosen.effect] = seen.get(f.chosen.effect, 0) + 1
            groups.setdefault((f.chosen.effect, sensor, occurrence), []).append((axis, f, r))
    steps = []
    for (effect, sensor, _), items in groups.items():
        axes = tuple(dict.fromkeys(a for a, _, _ in items if a))
        total = sum(f.chosen.gain for _, f, _ in items)
        values = tuple(
            replace(v, name=v.name if len(items) == 1 or not a else f"{v.name}_{a}")
            for a, f, _ in items
            for v in f.chosen.values
        )
        # evidence of every rival on the same axes; an axis on which it was not weighed counts nothing
        rivals: dict[str, float] = {}
        for _, f, _ in items:
            for w in f.ranked:
                rivals[w.effect] = rivals.get(w.effect, 0.0) + w.gain
        # a rival explains the step only where it stands in for it on every axis
        rivals = {k: v for k, v in rivals.items() if all(any(w.effect == k for w in f.ranked) for _, f, _ in items)}
        rivals[effect] = total
        ordered = sorted(rivals.items(), key=lambda item: -item[1])
        top = ordered[0][1]
        members = tuple(Member(k, sensor, axes, g) for k, g in ordered if g > top - rules().lead and g > 0.0)
        others = tuple(Member(k, sensor, axes, g) for k, g in ordered if g <= top - rules().lead and g > 0.0)[:5]
        p = np.exp(np.array([g for _, g in ordered] + [math.log(len(ordered))]) - top)
        confidence = float(np.exp(total - top) / p.sum())
        duration = items[0][2].start.data.duration_s
        steps.append(
            Step(
                effect, _shapes(items), sensor, axes, values, confidence, total, members,
                would_separate([m.effect for m in members], duration), others,
            )
        )  # fmt: skip
    return tuple(sorted(steps, key=lambda s: -s.gain_nats))
