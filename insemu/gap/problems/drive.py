"""The gap of a drive or flight: effects named on the whitened innovations of the nominal filter, and on the IMU's band above the motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, EffectUse, having
from insemu.errors import InputError
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates.axis import CANDIDATES, AxisState
from insemu.gap.candidates.fixes import covariance_hypotheses, multipath_step, unexplained_innovations, wild_fixes
from insemu.gap.candidates.outliers import evident_outliers
from insemu.gap.candidates.shapes import (
    ONCE,
    PROCESSES,
    Hypothesis,
    Variant,
    bank,
    best_pair,
    library_gain,
    linear_hypotheses,
    null_threshold,
    shape_values,
)
from insemu.gap.candidates.tones import wandering, without_tones
from insemu.gap.checks.drive import drive_map, innovation_tests
from insemu.gap.checks.rest import corrected
from insemu.gap.confusion import Repetitions
from insemu.gap.data.log import Reduced, unheard
from insemu.gap.data.samples import advanced, coarse, mend, with_counts
from insemu.gap.drive.preparation import LEVEL_GROUPS, Flown, Prepared, fast_parts, fixes_score, prepare
from insemu.gap.drive.scene import Scene, first_rows
from insemu.gap.evidence.fixes import NED, FixNoise, joint_noise, level_derivatives, level_scores
from insemu.gap.evidence.linear import Block, Field
from insemu.gap.evidence.model import Component, Free, Likelihood, fit
from insemu.gap.policy import rules
from insemu.gap.problems import rest as at_rest
from insemu.gap.problems.known import colour_of, of_axis, settled, starting_explanation, without_drawn
from insemu.gap.verdict import Confusable, GapReport, Interval, Member, Step, Value, judged
from insemu.noise import BI, GM, QN, RW, WN, NoiseModel
from insemu.records import AXES, Recording

Array = NDArray[np.float64]

#: Candidates of the fast band; the others need a sensor at rest.
FAST = having("fast") | {"outliers"}
#: What a tone of one axis is called that changes its frequency.
WANDERING = "a tone whose frequency wanders"


# -- the search -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """A step of the search: what was chosen and everything that it was compared with.

    ``instead`` is structure outside the catalogue, in words, that explains more in its place, though not by the lead that takes a name away.
    """

    chosen: Hypothesis
    ranked: tuple[Hypothesis, ...]
    instead: str = ""


@dataclass(frozen=True)
class Named:
    """What the search found.

    Parameters
    ----------
    found : tuple of Found
    scene : Scene
        At the levels, colours and corrections that were found.
    outsider : str
        Structure outside the catalogue, in words, where there is any.
    gone : (k,) array
        Times of the positions that were left out as outliers.
    """

    found: tuple[Found, ...]
    scene: Scene
    outsider: str
    gone: Array

    @property
    def blocks(self) -> list[Block]:
        """How the effects enter the linear model of the innovations, and what is uncertain in any case."""
        return [*self.scene.always, *blocks_of(self.found)]

    @property
    def outliers(self) -> Hypothesis | None:
        """The outliers of the fixes, where they were named."""
        return next((f.chosen for f in self.found if f.chosen.effect == "gnss_outliers"), None)


def something(ranked: Sequence[Hypothesis]) -> float:
    """Probability that any of the effects is there: each of them and nothing at all weigh alike before the data."""
    gains = np.array([h.gain for h in ranked])
    top = max(float(gains.max()), 0.0)
    some = float(np.sum(np.exp(gains - top)))
    return some / (some + gains.size * math.exp(-top))


def blocks_of(found: Sequence[Found]) -> list[Block]:
    """Blocks of the steps that have one."""
    return [f.chosen.block for f in found if f.chosen.block is not None]


@dataclass
class Search:
    """The search of one recording, whole or up to a time.

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

    scene: Scene
    cut: float | None
    threshold: float
    without: Collection[str]
    found: list[Found]
    gone: Array
    outsider: str = ""

    def __post_init__(self) -> None:
        self._take(self.scene)

    def _take(self, scene: Scene) -> None:
        self.scene = scene
        self.variants: list[Variant] = bank(scene)
        self.data: Field = first_rows(scene.data, scene.rows_t, self.cut)
        self.rows: NDArray[np.bool_] = (
            np.ones(scene.rows_t.size, dtype=bool) if self.cut is None else np.asarray(scene.rows_t <= self.cut)
        )

    def blocks(self, found: Sequence[Found]) -> list[Block]:
        """How steps enter the linear model of the innovations, and what is uncertain in any case."""
        return [*self.scene.always, *blocks_of(found)]

    def rank(self, given: Sequence[Block], skip: Collection[str], *, fixes: bool = True) -> list[Hypothesis]:
        """Every effect that the innovations can show beside ``given``, best first."""
        out = linear_hypotheses(self.scene, self.variants, self.data, given, skip)
        if fixes:
            if "gnss_multipath_step" not in skip:
                out += multipath_step(self.scene, self.data, self.rows, given)
            out += covariance_hypotheses(self.scene, given, skip, self.cut)
        return sorted((h for h in out if math.isfinite(h.gain)), key=lambda h: -h.gain)

    def _skip(self, found: Sequence[Found]) -> set[str]:
        once = {
            f.chosen.effect
            for f in found
            if f.chosen.effect in ONCE or f.chosen.noise is not None or f.chosen.effect == "gnss_outliers"
        }
        return set(self.without) | once

    def run(self, progress: Callable[[str], None]) -> Named:
        """Name the best effect, add it, estimate again, until nothing is worth the threshold."""
        first = self.scene
        self._climb(progress)
        if self._early_noise():
            progress("the noise of the fixes again, beside what was found since")
            self.found = [f for f in self.found if f.chosen.block is not None and not _is_step(f)]
            self.gone, self.outsider = np.zeros(0), ""
            self._take(first.rebuilt(corrections=self.scene.corrections))
            self._take(self.scene.trimmed(self.blocks(self.found), self.cut))
            self._climb(progress)
        if self.cut is None:
            self._with_rivals()
            self._with_outsiders()
        return Named(tuple(self.found), self.scene, self.outsider, self.gone)

    def _early_noise(self) -> bool:
        """Whether noise of the fixes was named before something strong that it could have stood for."""
        noise = next((k for k, f in enumerate(self.found) if f.chosen.block is None), None)
        return noise is not None and any(
            f.chosen.gain > rules().correct_nats and f.chosen.block is not None and not _is_step(f)
            for f in self.found[noise + 1 :]
        )

    def _climb(self, progress: Callable[[str], None]) -> None:
        for _ in range(rules().most_effects):
            ranked = self.rank(self.blocks(self.found), self._skip(self.found))
            best = ranked[0]
            beyond, what = library_gain(self.scene, self.data, self.blocks(self.found))
            if beyond > self.threshold and beyond > best.gain + rules().lead:
                self.outsider = what
                break
            pair = self._hidden_pair(best)
            if pair is None and (best.gain < self.threshold or something(ranked) < rules().something):
                break
            best = pair or self._apart(best)
            progress(f"{best.effect} {best.gain:.1f} nats")
            self._add(best, ranked)
            if len(self.found) > 1:
                self._reconsider()

    def _apart(self, best: Hypothesis) -> Hypothesis:
        """The first of two or three simpler effects, where they explain more than the best single one does.

        Of an effect of several axes those of one axis; of a slow process, which follows anything slow, those of known shape of its sensor.
        """
        if best.block is None:
            return best
        single = [v for v in self.variants if len(v.axes) < 2]
        if len(best.axes) > 1:
            first, total, count = self._greedy(single)
            # as many numbers must say more; with fewer it is enough to say as much
            if first is not None and total > best.gain + (1.0 if count >= len(best.axes) else -rules().keep_nats):
                return self._apart(first)
        if best.effect in PROCESSES:
            first, total, _ = self._greedy([v for v in single if not v.process and v.sensor == best.sensor])
            if first is not None and total > best.gain + rules().lead:
                return first
        return best

    def _hidden_pair(self, best: Hypothesis) -> Hypothesis | None:
        """The first of two shapes that hide each other: together they explain more than the best effect and what follows it."""
        skip, given = self._skip(self.found), self.blocks(self.found)
        ones = [v for v in self.variants if not v.process and v.index.size == 1 and v.effect not in skip]
        if len(ones) < 2 or (best.block is None and best.gain > self.threshold):
            return None
        A, b = self.data.conditioned(given)
        together, first, second = best_pair(ones, A, b[:, 0])
        together -= math.log(0.5 * len(ones) ** 2)
        if together < max(best.gain, self.threshold) + rules().lead:
            return None
        beside = [*given, *((best.block,) if best.block is not None and best.gain > self.threshold else ())]
        follows = max(
            (h.gain for h in linear_hypotheses(self.scene, self.variants, self.data, beside, skip)), default=0.0
        )
        if together < max(best.gain, 0.0) + max(follows, 0.0) + rules().lead:
            return None
        own = [v for v in ones if v.index[0] == first[0][0]]
        return next(iter(linear_hypotheses(self.scene, own, self.data, [*given, second], skip)), None)

    def _greedy(self, variants: Sequence[Variant]) -> tuple[Hypothesis | None, float, int]:
        """The best of some variants, what it is worth together with the two that follow it, and how many of them are worth anything."""
        given, total, count = self.blocks(self.found), 0.0, 0
        first: Hypothesis | None = None
        for _ in range(3):
            tried = linear_hypotheses(self.scene, variants, self.data, given, self._skip(self.found))
            top = max(tried, key=lambda h: h.gain, default=None)
            if top is None or top.block is None or top.gain < self.threshold:
                break
            total, count = total + top.gain, count + 1
            first = first or top
            given = [*given, top.block]
        return first, total, count

    def _add(self, best: Hypothesis, ranked: Sequence[Hypothesis]) -> None:
        scene = self.scene
        if best.effect == "gnss_multipath_step":
            given = {v.name: v.value for v in best.values}
            window = (NED.index(best.axes[0]), given["start"], given["start"] + given["duration"])
            width = 3.0 * abs(given["value"])
            scene = scene.with_window(window)
            best = replace(best, block=(np.array([scene.raw.shape[2] - 1]), np.array([[width]])))
            self.found.append(Found(best, tuple(ranked)))
        elif best.effect == "gnss_outliers":
            self.found.append(Found(best, tuple(ranked)))
            times, _ = wild_fixes(scene, best, unexplained_innovations(scene, self.blocks(self.found)))
            self.gone = np.union1d(self.gone, times)
            scene = scene.rebuilt(gone=self.gone)
        elif (level := best.noise) is not None:
            if best.effect == "gnss_correlated_noise":
                assert level.colour is not None
                s = replace(scene.surrogate, nu=unexplained_innovations(scene, self.blocks(self.found)))
                moved = scene.original.factors / scene.original.levels
                noise = joint_noise(
                    s if self.cut is None else s.until(self.cut), level.colour, moved, rules().tolerance
                )
                scene = scene.coloured(noise)
                sigma = dict(zip((f"sigma_{a}" for a in NED), noise.colour[0], strict=False))
                best = replace(best, values=tuple(_moved(v, sigma.get(v.name, noise.colour[1])) for v in best.values))
            else:
                factors = scene.original.factors * level.factor
                levels = np.where(level.factor == 1.0, scene.original.levels, factors)
                scene = scene.rebuilt(factors=factors, levels=levels)
            self.found.append(Found(best, tuple(ranked)))
        else:
            self.found.append(Found(best, tuple(ranked)))
            if best.gain > rules().correct_nats and best.columns:
                self._take(scene)
                scene = scene.rebuilt(corrections=self._corrections())
        self._take(scene)
        self._take(self.scene.trimmed(self.blocks(self.found), self.cut))

    def _corrections(self) -> dict[int, float]:
        """Best values of the strong shapes, to be taken out of the data."""
        blocks = self.blocks(self.found)
        index, mean, _ = self.data.posterior(blocks)
        strong = {
            c
            for f in self.found
            if f.chosen.gain > rules().correct_nats
            for c in f.chosen.columns
            if not self.scene.columns[c].runs
        }
        return {int(i): float(m) for i, m in zip(index, mean, strict=True) if int(i) in strong}

    def _reconsider(self) -> None:
        """Try to drop or to replace each effect of the IMU or of timing beside all the others."""
        changed = False
        for f in list(self.found):
            if f.chosen.block is None or f.chosen.effect == "gnss_multipath_step":
                continue
            others = [g for g in self.found if g is not f]
            ranked = self.rank(self.blocks(others), self._skip(others), fixes=False)
            kept = next((h for h in ranked if (h.effect, h.sensor) == (f.chosen.effect, f.chosen.sensor)), None)
            best = ranked[0]
            if best.gain < min(self.threshold, rules().keep_nats):
                self.found = others
                changed = True
            elif kept is None or best.gain > kept.gain + rules().swap_nats:
                self._swap(f, best, ranked)
                changed = True
            elif changed or f is not self.found[-1]:
                self._swap(f, kept, ranked)

    def _swap(self, old: Found, new: Hypothesis, ranked: Sequence[Hypothesis]) -> None:
        self.found = [Found(new, tuple(ranked)) if g is old else g for g in self.found]

    def _with_rivals(self) -> None:
        """Weigh levels, colour and outliers of the fixes against each effect that was weighed again without them."""
        for f in list(self.found):
            if f.chosen.block is None or any(h.sensor == "gnss" and h.block is None for h in f.ranked):
                continue
            others = [g for g in self.found if g is not f]
            rivals = covariance_hypotheses(self.scene, self.blocks(others), self._skip(others), self.cut)
            self._swap(f, f.chosen, sorted([*f.ranked, *rivals], key=lambda h: -h.gain))

    def _with_outsiders(self) -> None:
        """Hold each effect of known shape against structure outside the catalogue in its place."""
        for k, f in enumerate(self.found):
            h = f.chosen
            if not h.columns:
                continue
            others = self.blocks([g for g in self.found if g is not f])
            own = [v for v in self.variants if (v.effect, v.sensor) == (h.effect, h.sensor)]
            beyond, what = library_gain(self.scene, self.data, others)
            if beyond > max(w.gain for w in linear_hypotheses(self.scene, own, self.data, others, ())):
                self.found[k] = replace(f, instead=what)


def _is_step(f: Found) -> bool:
    return f.chosen.effect == "gnss_multipath_step"


def _moved(v: Value, value: float) -> Value:
    """A positive value re-estimated, its interval as wide in proportion as it was."""
    return replace(v, value=float(value), low=float(v.low / v.value * value), high=float(v.high / v.value * value))


def find_effects(
    scene: Scene, cut: float | None, threshold: float, without: Collection[str], progress: Callable[[str], None]
) -> Named:
    """Search a recording, whole or up to a time."""
    return Search(scene, cut, threshold, without, [], np.zeros(0)).run(progress)


def with_process(model: NoiseModel, effect: str, given: Mapping[str, float]) -> NoiseModel:
    """A model with a slow process of a named effect."""
    if effect == "random_walk":
        return model + RW(given["K"])
    return model + (GM(given["sigma"], given["beta"]) if effect == "gauss_markov" else BI(given["B"]))


def believing(named: Named, cut: float | None = None) -> tuple[Scene, list[Block]]:
    """The filter that believes in the slow processes that were found, and the blocks of everything else.

    The search carries a process on knots; what is left of a strong one between them would count against it.
    """
    beliefs = dict(named.scene.original.beliefs)
    blocks = list(named.scene.always)
    for f in named.found:
        h = f.chosen
        if h.effect in PROCESSES:
            for axis in h.axes:
                name = f"{h.sensor}_{axis}"
                beliefs[name] = with_process(beliefs[name], h.effect, {v.name: v.value for v in h.values})
        elif h.block is not None:
            blocks.append(h.block)
    if len(blocks) == len(named.blocks):
        return named.scene, blocks
    scene = named.scene.rebuilt(beliefs=beliefs)
    return scene.trimmed(blocks, cut), blocks


# -- held out -------------------------------------------------------------------------------------------------------------------------


def held_out(scene: Scene, named: Named, cut: float) -> tuple[Interval, Interval, Interval]:
    """Gap index before and after and gain per fix after ``cut``, where nothing was named."""
    late = scene.rows_t > cut
    test = scene.loop.y.reshape(-1, 6)[scene.loop.use]
    test = test[late]
    fixes = max(1, len(np.unique(scene.rows_t[late])))
    final, blocks = believing(named, cut)
    rows = final.rows_t > cut
    data = replace(final.data, variance=1.0)
    e, logdet = data.predictive(blocks, rows)
    total = 0.5 * float(test @ test) - 0.5 * float(e @ e) - logdet + _log_volume(scene, cut) - _log_volume(final, cut)
    spread = 1.96 * math.sqrt(abs(float(test @ test) - float(e @ e)) + 0.5)
    outliers = named.outliers
    if outliers is not None:
        # positions that were left out are scored as the outliers that they are said to be
        times, density = wild_fixes(scene, outliers, np.where(scene.surrogate.use == 1, scene.surrogate.nu, 0.0))
        gone = np.isin(times, named.gone) & (times > cut)
        total += float(np.sum(density[gone]))

    def around(y: Array, at: Scene) -> Interval:
        value = float(np.mean(y * y))
        # the squares of one fix go together where the model is wrong: their own spread there, the chi-square's where it is right; and the
        # levels of the fixes are known from the first part only
        own = max(math.sqrt(2.0 / y.size) * max(value, 0.2), float(np.std(y * y)) / math.sqrt(y.size))
        half = 1.96 * math.hypot(own, value * _level_spread(at, cut))
        return Interval(value, value - half, value + half)

    gain = Interval(total / fixes, (total - spread) / fixes, (total + spread) / fixes)
    return around(test, scene), around(e, final), gain


def _level_spread(scene: Scene, cut: float) -> float:
    """Standard deviation that the trimming of the levels before ``cut`` gives the mean square after it."""
    s, white = scene.surrogate, scene.loop.white
    groups = [g for g in LEVEL_GROUPS if s.use[:, list(g)].any()]
    late = s.t > cut
    count = int(scene.loop.use[late].sum())
    if not groups or not count:
        return 0.0
    _, information = level_scores(s.until(cut), white[~late], np.zeros((int((~late).sum()), 6)), groups)
    slope = np.array([float(np.einsum("kii->", d)) for d in level_derivatives(s.R[late], white[late], groups)]) / count
    return math.sqrt(float(slope @ np.linalg.solve(information + np.eye(len(groups)), slope)))


def _log_volume(scene: Scene, cut: float) -> float:
    """Half the log determinants of the innovation covariances after ``cut``."""
    use = scene.loop.use & (scene.loop.result.fixes.t > cut)[:, None]
    if scene.noise is None:
        diagonal = np.einsum("kii->ki", scene.loop.lower)
        return float(np.sum(np.log(diagonal[use])))
    volume = 0.0
    for sign, part in ((1.0, scene.surrogate), (-1.0, scene.surrogate.until(cut))):
        white, value = part.whiten(part.nu[:, :, None], scene.noise.factor, scene.noise.colour)
        volume -= sign * (value + 0.5 * float(np.sum(white**2)))
    return volume


# -- what the IMU shows above its motion ----------------------------------------------------------------------------------------------


def fast_effects(
    parts: dict[str, Reduced],
    nominal: Nominal,
    threshold: float,
    without: Collection[str],
    progress: Callable[[str], None],
    beside: Mapping[str, Sequence[Component]] | None = None,
    clipped: Collection[str] = (),
) -> list[tuple[str, at_rest.AxisResult]]:
    """Effects that the IMU shows above its motion, axis by axis, ``beside`` what else is known to be there.

    What is left of a clipped stretch after it was filled in looks like outliers, so axes that were ``clipped`` are not asked for them.
    """
    out = []
    excluded = {name for name in CANDIDATES if name not in FAST} | set(without)
    moving = wandering(parts)
    for name, data in parts.items():
        if not data.f.size:
            continue
        given = of_axis(nominal.effects, name)
        explanation = starting_explanation(nominal.beliefs[name], given, data.dt)
        for component in (beside or {}).get(name, ()):
            explanation = explanation.with_component(component)
        if name in moving:
            # no stationary process explains it, and what the search would name instead only chases it
            state = AxisState(data, fit(Likelihood(data), explanation))
            low, high = moving[name]
            out.append((name, at_rest.AxisResult(state, state, (), f"{WANDERING}, {low:.3g} to {high:.3g} Hz")))
            continue
        start = AxisState(data, fit(Likelihood(data), explanation))
        left_out = (*excluded, *(("outliers",) if name in clipped else ()))
        wild = evident_outliers(start) if "outliers" not in left_out else None
        if wild is not None:
            # first of all: they raise the whole spectrum, and differently from piece to piece
            progress(f"{name}: outliers {wild.gain:.1f} nats")
            data, left_out = wild.state.data, (*left_out, "outliers")
        data = without_tones(data, fit(Likelihood(data), explanation).explanation)
        state = AxisState(data, fit(Likelihood(data), explanation))
        state = without_drawn(replace(state, named=tuple(n for n in settled(given) if n == "quantization")), given)
        result = at_rest.search(state, threshold=threshold, without=left_out, progress=progress, outsiders=False)
        if wild is not None and not any(use.id == "outliers" for use in given):
            first = at_rest.Found(wild, (wild,), 0.999)
            result = replace(result, start=start, found=(first, *result.found))
        out.append((name, result))
    return out


def without_delay(
    recording: Recording,
    nominal: Nominal,
    parts: dict[str, Reduced],
    levels: dict[str, float],
    fast: Mapping[str, at_rest.AxisResult],
    prepared: Prepared | None = None,
) -> tuple[Prepared, Recording, dict[str, float]]:
    """The nominal filter on sensors set forward by the delay of the low-pass that the fast band shows, and that delay, s per sensor.

    ``prepared`` is that filter without any, where it has run. A low-pass may be causal (it delays) or its delay may have been taken off in the
    unit already; the innovations say which.
    """
    best = prepared or prepare(recording, nominal, parts, levels)
    late: dict[str, float] = {}
    for sensor in ("gyro", "accel"):
        roll = [fast[f"{sensor}_{a}"].end.explanation.rolloff for a in "xyz" if f"{sensor}_{a}" in fast]
        delays = [r.delay(recording.imu.dt) for r in roll if r is not None]
        if not delays:
            continue
        delay = float(np.median(delays))
        moved = replace(recording, imu=advanced(recording.imu, sensor, delay))
        tried = prepare(moved, nominal, parts, levels)
        if fixes_score(tried.result.fixes) > fixes_score(best.result.fixes):
            best, recording, late[sensor] = tried, moved, delay
    return best, recording, late


def with_delay(step: Step, delay: float) -> Step:
    """A low-pass with the delay in s that was taken off its sensor; as uncertain as the cutoff that it follows from."""
    if step.effect != "decimation_filter":
        return step
    ratios = [
        (v.value / v.high, v.value / v.low) for v in step.parameters if v.name.startswith("cutoff") and v.low > 0.0
    ]
    low, high = (min(r[0] for r in ratios), max(r[1] for r in ratios)) if ratios else (1.0, 1.0)
    return replace(step, parameters=(*step.parameters, Value("delay", delay, delay * low, delay * high, "s")))


def again_with_processes(
    fast: list[tuple[str, at_rest.AxisResult]],
    named: Named,
    parts: dict[str, Reduced],
    nominal: Nominal,
    threshold: float,
    without: Collection[str],
    clipped: Collection[str],
) -> list[tuple[str, at_rest.AxisResult]]:
    """What the band above the motion shows where a slow process that was found since reaches into it."""
    beside: dict[str, list[Component]] = {}
    for f in named.found:
        for axis in f.chosen.axes if f.chosen.effect in PROCESSES else ():
            process = with_process(
                NoiseModel(()), f.chosen.effect, {v.name: v.value for v in f.chosen.values}
            ).processes[0]
            # knots tell the slow part; how much of it reaches above the motion is another matter
            size = PROCESSES[f.chosen.effect]
            value = process.parameters[size]
            free = (Free(size, value / rules().leak, value * rules().leak),)
            beside.setdefault(f"{f.chosen.sensor}_{axis}", []).append(Component(process, free))
    touched = set(beside) & {name for name, r in fast if r.found}
    if not touched:
        return fast
    some = {name: data for name, data in parts.items() if name in touched}
    fresh = dict(fast_effects(some, nominal, threshold, without, lambda _: None, beside, clipped))
    return [(name, fresh.get(name, r)) for name, r in fast]


def white_level(result: at_rest.AxisResult) -> float | None:
    """White noise of an axis beside what its fast band was found to hold; None where the nominal model describes the band, or nothing does.

    A low-pass takes from the band and a vibration adds to it, and neither says anything of the noise at the rate of the motion.
    """
    if not result.found or result.outsider:
        return None
    parts = (c for c in result.end.explanation.components if c.effect in ("nominal", "white_noise"))
    return next((c.process.parameters["N"] for c in parts if isinstance(c.process, WN)), None)


def vibrates(result: at_rest.AxisResult) -> bool:
    """Whether a vibration is among the effects of an axis, and not one that a later effect replaced."""
    return any(f.chosen.effect.startswith("vibration") for f in result.found)


def find_dynamic_gap(
    recording: Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    without: Collection[str] = (),
    hold_out: bool = True,
    progress: Callable[[str], None] | None = None,
    flown: Flown | None = None,
) -> GapReport:
    """Find what a drive or flight has that the nominal model lacks; see :func:`insemu.gap.find_gap`.

    ``flown`` is the nominal filter's run on this recording, where there is one already.
    """
    say = progress or (lambda _: None)
    threshold = rules().least_nats
    say("running the nominal filter")
    missing = [a for a in AXES if a not in nominal.beliefs]
    if missing:
        raise InputError(
            f"no noise model is believed for {', '.join(missing)}; a recording with fixes needs all six axes"
        )
    mended = mend(recording.imu, tuple(without))
    # what is known of the samples is mended, but is no finding
    noticed = tuple(s for s in (unknown_part(s, nominal.effects) for s in mended.steps) if s is not None)
    whole, believed = recording, nominal
    nominal = replace(nominal, beliefs=with_counts(nominal.beliefs, mended.steps, recording.imu.dt))
    recording = replace(recording, imu=mended.imu)
    if mended.steps:
        flown = None
    parts = flown.fast if flown else fast_parts(recording)
    clipped = {f"{s.sensor}_{a}" for s in mended.steps if s.effect == "saturation" for a in s.axes}
    # rounded that coarsely, the error follows the motion and is no noise that a spectrum could tell anything from
    rounded = coarse(believed.beliefs, mended.steps, recording.imu.dt)
    parts = {name: unheard(data) if name in rounded else data for name, data in parts.items()}
    fast = fast_effects(parts, nominal, max(threshold, rules().fast_nats), without, say, clipped=clipped)
    levels = {name: level for name, r in fast if (level := white_level(r)) is not None}
    prepared, recording, late = without_delay(
        recording, nominal, parts, levels, dict(fast), flown.prepared if flown and not levels else None
    )
    prepared = replace(prepared, clipped=mended.clipped)
    say("responding every effect through the filter")
    scene = Scene.of(prepared)
    colour = colour_of(nominal.effects)
    if colour is not None:
        scene, without = scene.coloured(FixNoise(np.ones(6), colour)), (*without, "gnss_correlated_noise")
    threshold = max(
        threshold,
        null_threshold([v for v in bank(scene) if v.effect not in without], scene.data, rng, always=scene.always),
    )
    named = find_effects(scene, None, threshold, without, say)
    nothing = Interval(math.nan, math.nan, math.nan)
    before = after = held = nothing
    if hold_out:
        say("scoring on held-out fixes")
        cut = float(scene.motion.t[0] + rules().naming_share * (scene.motion.t[-1] - scene.motion.t[0]))
        first = find_effects(scene, cut, threshold, without, lambda _: None)
        plain = Scene.of(prepare(whole, believed, parts, levels)) if noticed or late else scene
        before, after, held = held_out(plain, first, cut)
    # a generator of its own: the search of a later pass draws what it always drew
    drawn, repeated = rng.spawn(2)
    y = scene.data.y
    starts = {name: r.start for name, r in fast}
    where = corrected([*innovation_tests(scene, y), *drive_map(scene, y, starts, drawn)])
    final, blocks = believing(named)
    residual, _ = final.data.residual(blocks)
    tests = innovation_tests(final, residual)
    failed = [w for w in corrected(tests) if w.p_value < rules().omnibus_drive]
    fast = again_with_processes(fast, named, parts, nominal, max(threshold, rules().fast_nats), without, clipped)
    ends = {name: r.end for name, r in fast}
    rest = corrected([*tests, *drive_map(final, residual, ends, drawn)])
    # where one axis vibrates so that no stationary process holds it, the same vibration is what changes on the others
    humming = any(r.outsider and vibrates(r) for _, r in fast)
    changing = {
        at_rest.split_axis(name): r.outsider
        for name, r in fast
        if r.outsider and (humming or r.outsider.startswith(WANDERING))
    }
    each = with_confusable([_step(f, named) for f in named.found], named, without, repeated)
    # a class leaves open what it is; a single name does not where something else explains more
    instead = {f.instead for s, f in zip(each, named.found, strict=True) if f.instead and not s.is_class}
    own = _joined(
        [
            s.doubted() if named.outsider or failed or (f.instead and not s.is_class) else s
            for s, f in zip(each, named.found, strict=True)
        ]
    )
    heard = [s.doubted() if at_rest.is_shaken(s, (), changing) else s for s in at_rest.merged_steps(dict(fast))]
    heard = [with_delay(s, late.get(s.sensor, 0.0)) for s in heard]
    steps = sorted([*own, *heard, *noticed], key=lambda s: -s.gain_nats)
    beyond = " and ".join(dict.fromkeys(filter(None, (named.outsider, *sorted(instead)))))
    remainder = at_rest.remainder(failed, {**({("the fixes", ""): beyond} if beyond else {}), **changing})
    verdict = judged(steps, remainder)
    refined = dict(believed.beliefs)
    for s in steps:
        refined = _refine(refined, s)
    return GapReport(
        verdict,
        tuple(steps),
        where,
        rest,
        before,
        after,
        held,
        dict(believed.beliefs),
        refined,
        threshold,
        recording.source,
        remainder=remainder,
    )


def _step(f: Found, named: Named) -> Step:
    """A step of the search as it is reported: values from everything together, members of its class, runners-up."""
    h, ranked = f.chosen, f.ranked
    values = h.values
    if h.block is not None and (h.columns or h.effect == "gnss_multipath_step"):
        index, mean, covariance = named.scene.data.posterior(named.blocks)
        # two blocks may share a column: what it explains is their sum
        sums = (index[None, :] == h.block[0][:, None]).astype(np.float64)
        mean, covariance = sums @ mean, sums @ covariance @ sums.T
        if h.columns:
            values = shape_values(named.scene, h.block[0], mean, covariance)
        else:
            m, s = float(mean[0]), math.sqrt(float(covariance[0, 0]))
            values = (Value("value", m, m - 1.96 * s, m + 1.96 * s, "m"), *values[1:])
    gains = np.array([r.gain for r in ranked] + [math.log(len(ranked))])
    p = np.exp(gains - gains.max())
    p /= p.sum()
    own = next((k for k, r in enumerate(ranked) if (r.effect, r.sensor) == (h.effect, h.sensor)), 0)
    order = [own, *(k for k in range(len(ranked)) if k != own)]
    members: list[Member] = []
    others: list[Member] = []
    held = 0.0
    share = float(p[:-1].sum())
    for k in order:
        r = ranked[k]
        member = Member(r.effect, r.sensor, h.axes if k == own else r.axes, r.gain)
        if k == own or (r.gain > h.gain - rules().lead and r.gain > 0.0 and held < rules().class_share * share):
            members.append(member)
        elif r.gain > 0.0:
            others.append(member)
        held += float(p[k])
    needs = "; ".join(dict.fromkeys(EFFECTS[m.effect].excitation for m in members)) if len(members) > 1 else ""
    text = f"a recording with more of: {needs}" if needs else ""
    return Step(
        h.effect, h.variant, h.sensor, h.axes, values, float(p[own]), h.gain, tuple(members), text, tuple(others[:5])
    )


def with_confusable(
    steps: Sequence[Step], named: Named, without: Collection[str], rng: np.random.Generator
) -> list[Step]:
    """The steps of the search with what each would be confused with if the recording were repeated; those without columns as they are."""
    scene, out = named.scene, []
    repetitions: Repetitions | None = None
    for step, f in zip(steps, named.found, strict=True):
        h = f.chosen
        if h.block is None or h.effect == "gnss_multipath_step":
            out.append(step)
            continue
        repetitions = repetitions or Repetitions.of(scene.data, rng)
        others = [g.chosen for g in named.found if g is not f]
        given = [g.block for g in others if g.block is not None]
        passed = {*without, *(g.effect for g in others if g.effect in ONCE)}
        index, root = h.block
        if h.effect in PROCESSES:
            coefficients = root @ rng.standard_normal((root.shape[1], repetitions.noise.shape[1]))
        else:
            at, mean, _ = scene.data.posterior(named.blocks)
            coefficients = np.array([mean[np.flatnonzero(at == i)[0]] for i in index])
        shares = repetitions.shares([v for v in bank(scene) if v.effect not in passed], index, coefficients, given)
        rivals = [
            Confusable(*key, share)
            for key, share in shares.items()
            if share >= rules().confusable and key != (h.effect, h.sensor)
        ]
        out.append(replace(step, confusable=tuple(sorted(rivals, key=lambda c: -c.share))))
    return out


def unknown_part(step: Step, known: Sequence[EffectUse]) -> Step | None:
    """A step that was read off the samples, less the axes of which it is known; ``None`` where it is known of all."""
    if step.sensor not in ("gyro", "accel"):
        return None if step.effect in {use.id for use in known} else step
    new = [
        k
        for k, a in enumerate(step.axes)
        if step.effect not in {use.id for use in of_axis(known, f"{step.sensor}_{a}")}
    ]
    if not new:
        return None
    if len(new) == len(step.axes):
        return step
    return replace(step, axes=tuple(step.axes[k] for k in new), parameters=tuple(step.parameters[k] for k in new))


def _joined(steps: list[Step]) -> list[Step]:
    """Steps of one effect that share a parameter as one: their values are those of everything together already."""
    out: list[Step] = []
    for s in steps:
        names = {v.name for v in s.parameters}
        k = next(
            (
                k
                for k, o in enumerate(out)
                if (o.effect, o.sensor) == (s.effect, s.sensor)
                and s.effect not in (*PROCESSES, "gnss_multipath_step")
                and names & {v.name for v in o.parameters}
            ),
            None,
        )
        if k is None:
            out.append(s)
            continue
        first = out[k]
        known = {v.name for v in first.parameters}
        out[k] = replace(
            first,
            axes=tuple(dict.fromkeys((*first.axes, *s.axes))),
            parameters=(*first.parameters, *(v for v in s.parameters if v.name not in known)),
            gain_nats=first.gain_nats + s.gain_nats,
        )
    return out


def _refine(models: dict[str, NoiseModel], step: Step) -> dict[str, NoiseModel]:
    """The beliefs with a stochastic effect added to its axes."""
    if step.sensor not in ("gyro", "accel"):
        return models
    out = dict(models)
    given = {v.name: v.value for v in step.parameters}
    for axis in step.axes:
        name = f"{step.sensor}_{axis}"

        def value(key: str, axis: str = axis) -> float:
            return given[key] if key in given else given[f"{key}_{axis}"]

        if step.effect in PROCESSES:
            parameters = {p.name for p in EFFECTS[step.effect].parameters}
            out[name] = with_process(out[name], step.effect, {key: value(key) for key in parameters})
        elif step.effect == "quantization" and step.variant == "integrated":
            out[name] = out[name] + QN(value("Q"))
        elif step.effect == "white_noise":
            out[name] = NoiseModel(tuple(WN(value("N")) if isinstance(p, WN) else p for p in out[name]))
    return out
