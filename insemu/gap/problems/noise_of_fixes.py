"""Level, colour and outliers of the fixes of a drive, which stand for each other where only one of them is known."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.fixes import about, at_level, classified_density, level_ratios, rows_of, without_outliers
from insemu.gap.candidates.shapes import Change, DriveHypothesis, Variant, linear_nats
from insemu.gap.candidates.steps import multipath_step, placed
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.fix_outliers import FIRST
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import LEVEL_GROUPS, LEVEL_ROWS, NED, JointNoise, joint_noise
from insemu.gap.evidence.linear import Block
from insemu.gap.evidence.surrogate import PLAIN, Colour, FixNoise, Surrogate
from insemu.gap.hypothesis import Found
from insemu.gap.policy import rules
from insemu.lost import runs
from insemu.records import GnssRecord

Array = NDArray[np.float64]
#: Times that colour and what is explained are estimated in turns, and the change of the log correlation time at which that ends.
MOST_LOOKS, AS_LONG = 5, 0.1
#: Correlation times at which a colour is weighed too, over that which was named; it diffuses as fast at each of them.
OTHER_TIMES = (1.0 / 9.0, 1.0 / 3.0, 3.0)


#: Fewest outliers that follow one another which are weighed against a step: of a share of a tenth, the most that are classified, so many do by chance
#: once in a million fixes.
SHORTEST_RUN = 6


def _lead_of(s: Surrogate, noise: FixNoise, own: Sequence[Sequence[int]], finer: Sequence[Sequence[int]]) -> float:
    """What levels of finer parts of the components explain beyond those of their own, nats, as if whitened innovations told of theirs alone."""
    white = s.whiten(s.nu[:, :, None], noise.factor, noise.colour)[0][:, :, 0]

    def explained(parts: Sequence[Sequence[int]]) -> float:
        squares = [white[:, rows][s.use[:, rows] == 1] ** 2 for rows in parts]
        return float(sum(y.size * _cost_of(math.sqrt(float(np.mean(y)))) for y in squares if y.size))

    return explained(finer) - explained(own)


def _is_off(level: float) -> bool:
    """Whether a level is beyond the tolerance of what was believed."""
    return abs(math.log(level)) > math.log1p(rules().tolerance)


def _cost_of(level: float) -> float:
    """What a standard deviation taken for one costs where it is ``level``, nats per number."""
    return float(0.5 * (level * level - 1.0) - math.log(level))


def _longest_run(classified: Array, t: Array) -> Array:
    """Times of the most outliers that follow one another, of those at times ``classified`` (k,), among fixes at times (f,)."""
    begin, end = runs(np.isin(t, classified))
    if not begin.size:
        return classified[:0]
    k = int(np.argmax(end - begin))
    return np.asarray(t[begin[k] : end[k]])


class NoiseOfFixes(ABC):
    """What a drive's problem does to the noise of its fixes.

    Attributes
    ----------
    scene, variants, threshold, found, cut : Scene, list of Variant, float, list of Found, float or None
        As :class:`insemu.gap.problems.drive.DriveProblem` has them.
    gone : dict of effect to (k,) array
        Times of the positions and of the velocities that were left out as outliers, s.
    recorded : GnssRecord
        The fixes with all of them.
    """

    scene: Scene
    variants: list[Variant]
    threshold: float
    found: list[Found[Change]]
    cut: float | None
    gone: dict[str, Array]
    recorded: GnssRecord
    _others: list[Scene]

    @abstractmethod
    def _take(self, scene: Scene) -> None:
        """Go on with a scene."""

    @abstractmethod
    def blocks(self, without: Found[Change] | None = None) -> Sequence[Block]:
        """How the findings enter the linear model of the innovations, all or all but one, and what is uncertain in any case."""

    @abstractmethod
    def _skip(self, without: Found[Change] | None = None) -> set[str]:
        """Effects that are not asked for."""

    def noise_came_early(self) -> bool:
        """Whether noise of the fixes was named before something strong that it could have stood for, a step in the fixes included.

        Louder velocities, whenever they were named, stand for how an antenna swings on a longer lever arm as the vehicle shakes.
        """
        chosen = [f.chosen for f in self.found]
        noise = next((k for k, h in enumerate(chosen) if h.change.block is None), len(chosen))
        if any(h.nats > rules().correct_nats and h.change.block is not None for h in chosen[noise + 1 :]):
            return True
        louder = any(h.effect == "gnss_velocity_noise" and h.values[0].value > 1.0 for h in chosen)
        arm = any(h.effect == "lever_arm" for h in chosen)
        return louder and arm and self.scene.original.rectified is not None

    def _turn_colour(self) -> None:
        """Set a colour that was named to another correlation time where it, and what is named next to it, explain more there.

        One that was named first takes the slow part of the next effect, and one that was named next to a process leaves that process its own.
        """
        scene, noise = self.scene, self.scene.noise
        if noise is None or noise.known:
            return
        given, skip = self.blocks(), self._skip()

        def explained(at: Scene) -> float:
            assert at.noise is not None
            best = max(linear_nats(at, self.variants, at.field(self.cut), given, skip), self.threshold)
            return self._fixes(at).log_likelihood(at.noise.factor, at.noise.colour) + best

        if not self._others:
            sigma, tau, follows = noise.colour
            colours = [Colour(sigma * math.sqrt(r), tau * r, follows) for r in OTHER_TIMES]
            self._others = [scene.coloured(replace(noise, colour=c)) for c in colours]
        self._others = [at.with_windows(scene.windows) for at in self._others]
        each = [explained(at) for at in self._others]
        k = int(np.argmax(each))
        if each[k] > explained(scene) + rules().lead:
            self._take(self._others[k])

    def _named(self, effect: str) -> DriveHypothesis | None:
        """What was found of an effect that is there once."""
        return next((f.chosen for f in self.found if f.chosen.effect == effect), None)

    def _outliers_removed(self, new: Found[Change]) -> tuple[Scene, Found[Change]]:
        """The scene without the fixes that are outliers, and these with share and size; a level that stood for them goes, or changes."""
        h, seen, nu = new.chosen, self.scene, self.scene.unexplained(self.blocks(), self.cut)
        first = FIRST[h.effect]
        ours = np.arange(6) // 3 == first // 3
        if first == 3 and seen.noise is not None:
            # no colour and no level of the positions stood for velocities
            classified = without_outliers(seen, h, self.cut, seen, nu)
            return self._less(seen, h.effect, classified.times), replace(new, chosen=classified.outliers)
        if seen.noise is not None:
            # a colour may have stood for them, with a level next to it: what there is of both is found again
            h = replace(h, nats=h.nats + self._take_back("gnss_correlated_noise", "gnss_noise_level"))
        stood = self._named(next(k for k, row in LEVEL_ROWS.items() if row == first))
        # one level stands beside outliers; of other axes it is found again
        self.found = [f for f in self.found if stood is None or f.chosen.effect != stood.effect or f.chosen is stood]
        scene, level = seen, None if stood is None else stood.values[0].value
        if seen.noise is not None or stood is not None:
            nominal = np.where(ours, 1.0, [scene.original.factors, scene.original.levels])
            scene = scene.coloured(None).rebuilt(factors=nominal[0], levels=nominal[1])
        classified = without_outliers(scene, h, self.cut, seen, nu, level)
        sized = classified.outliers
        if stood is not None and level is not None:
            if not _is_off(classified.level):
                sized = replace(sized, nats=h.nats + self._take_back(stood.effect))
            else:
                at, own = scene.original, about(stood)
                factors, levels = (np.where(own, classified.level, x) for x in (at.factors, at.levels))
                scene = scene.rebuilt(factors=factors, levels=levels)
        return self._less(scene, h.effect, classified.times), replace(new, chosen=sized)

    def _outliers_again(self, scene: Scene, effect: str) -> Scene:
        """The scene with outliers that were named estimated again, next to everything that was found since, with a level of theirs."""
        known = self._named(effect)
        stood = self._named(next(k for k, row in LEVEL_ROWS.items() if row == FIRST[effect]))
        if known is None:
            return scene
        others = {k: t for k, t in self.gone.items() if k != effect}
        whole = scene.rebuilt(whole=self.recorded, gone=others)
        # what is explained was estimated without them
        nu = whole.residual_innovations(*scene.explaining(self.blocks(), self.cut))
        classified = without_outliers(whole, known, self.cut, whole, nu, None if stood is None else 1.0)
        self.found = [replace(f, chosen=classified.outliers) if f.chosen is known else f for f in self.found]
        self.gone = others
        if stood is not None:
            at, factor = scene.original, np.where(about(stood), classified.level, 1.0)
            whole = whole.rebuilt(factors=at.factors * factor, levels=at.levels * factor)
            level = at_level(stood, whole.original.factors)
            self.found = [replace(f, chosen=level) if f.chosen is stood else f for f in self.found]
        return self._less(whole, effect, classified.times)

    def _with_edges(self) -> bool:
        """Take positions back that count as outliers where a step may begin or end, by a filter that did not know it; whether there were any."""
        classified = self.gone.get("gnss_outliers", np.zeros(0))
        doubtful = np.zeros(classified.size, dtype=bool)
        for h in (f.chosen for f in self.found if f.chosen.effect == "gnss_multipath_step"):
            start, duration = (next(v for v in h.values if v.name == name) for name in ("start", "duration"))
            for low, high in (
                (start.low, start.high),
                (start.value + duration.low, start.value + duration.high),
            ):
                doubtful |= (classified >= low) & (classified <= high)
        if doubtful.any():
            self.gone["gnss_outliers"] = classified[~doubtful]
            self._take(self.scene.rebuilt(whole=self.recorded, gone=self.gone))
        return bool(doubtful.any())

    def _step_in_a_run(self) -> bool:
        """Name a step where positions that follow one another were classified as outliers, and are more likely with it; whether there was one."""
        known, classified = self._named("gnss_outliers"), self.gone.get("gnss_outliers", np.zeros(0))
        run = _longest_run(classified, self.recorded.t)
        if known is None or run.size < SHORTEST_RUN:
            return False
        rest, blocks = np.setdiff1d(classified, run), self.blocks()
        back = self.scene.rebuilt(whole=self.recorded, gone={**self.gone, "gnss_outliers": rest})
        unexplained = Unexplained(back, back.field(self.cut), back.upto(self.cut), blocks)
        step = next(iter(multipath_step(unexplained)), None)
        window = None if step is None else step.change.window
        if step is None or window is None or np.mean((run > window[1]) & (run <= window[2])) < 0.5:
            return False
        size, back = step.values[0], back.with_windows((*back.windows, window))
        step = placed(step, back.width - 1)
        assert step.change.block is not None
        whole = self.scene.rebuilt(whole=self.recorded, gone={k: t for k, t in self.gone.items() if k != known.effect})
        before, _ = classified_density(whole, known, self.scene.explaining(blocks, self.cut), self.cut, classified)
        beside = back.explaining([*blocks, step.change.block], self.cut)
        after, rest = classified_density(whole.with_windows(back.windows), known, beside, self.cut, rest)
        # what is paid for its size and its times
        sd = (size.high - size.low) / (2.0 * 1.96)
        paid = max(0.5 * (size.value / sd) ** 2 - step.nats, 0.0)
        if after - paid < before + rules().lead:
            return False
        self.gone[known.effect] = rest
        self._take(back)
        step = replace(step, nats=after - paid - before)
        self.found.append(Found(step, (step,)))
        self._take(self._outliers_again(self.scene, known.effect))
        return True

    def _less(self, scene: Scene, effect: str, times: Array) -> Scene:
        """A scene without outliers, those found before included."""
        self.gone[effect] = np.union1d(self.gone.get(effect, np.zeros(0)), times)
        return scene.rebuilt(gone=self.gone)

    def _take_back(self, *effects: str) -> float:
        """What findings of some effects were worth, nats; they are none any more."""
        back = [f for f in self.found if f.chosen.effect in effects]
        self.found = [f for f in self.found if f not in back]
        return sum(f.chosen.nats for f in back)

    def _fixes(self, scene: Scene) -> Surrogate:
        """Innovations less what is explained."""
        s = replace(scene.surrogate, nu=scene.unexplained(self.blocks(), self.cut))
        return s if self.cut is None else s.until(self.cut)

    def _needs_a_level(self, noise: FixNoise) -> bool:
        """Whether a level of the positions that was named still explains something next to a colour."""
        level = self._named("gnss_noise_level")
        if level is None:
            return True
        s, wide = self._fixes(self.scene), [rows_of(level)]
        usual = level_ratios(self.scene, wide)
        beside = joint_noise(s, noise, usual, wide=wide)
        return beside.evidence > joint_noise(s, noise, usual).evidence + rules().keep_nats

    def _under_colour(self, noise: FixNoise) -> tuple[Scene, JointNoise, float]:
        """The scene with a colour of the fixes: flown by a filter that is not led astray by it, which tells outliers again where there are any.

        Also what it explains less than the kind that explains most of the fixes looked at, but predicts worse, nats.
        """
        scene = self.scene

        def likeliest(noise: FixNoise, s: Surrogate | None = None) -> JointNoise:
            wide = self._levels()
            return joint_noise(self._fixes(scene) if s is None else s, noise, level_ratios(scene, wide), wide=wide)

        def predicted(noise: FixNoise) -> float:
            # what the first part of the fixes says of the last
            s = self._fixes(scene)
            early = s.until(float(s.t[0] + rules().naming_share * (s.t[-1] - s.t[0])))
            seen = [likeliest(noise, early).noise]
            return float(s.log_likelihoods(seen)[0] - early.log_likelihoods(seen)[0])

        each = sorted(map(likeliest, self._kinds(noise)), key=lambda joint: -joint.evidence)
        joint, plain = each[0], next((j for j in each if not j.noise.colour.follows), None)
        most = joint.evidence
        if joint.noise.colour.follows and plain is not None and predicted(joint.noise) < predicted(plain.noise):
            joint = plain
        less = most - joint.evidence
        known = self._named("gnss_outliers")
        loud, noise = joint.noise.split(scene.surrogate.sigma())
        kept = {k: t for k, t in self.gone.items() if FIRST[k] > 0}
        scene = whole = scene.rebuilt(factors=scene.original.factors * loud, whole=self.recorded, gone=kept)
        as_long = False
        for _ in range(MOST_LOOKS):
            # what the other findings explain is another under the colour, and outliers show against it that its scatter hides
            before = self.gone.get("gnss_outliers", np.zeros(0))
            now = before
            if known is not None:
                whole = whole.coloured(noise)
                classified = without_outliers(whole, known, self.cut, whole, whole.unexplained(self.blocks(), self.cut))
                self.found = [replace(f, chosen=classified.outliers) if f.chosen is known else f for f in self.found]
                now, known = classified.times, classified.outliers
                self.gone["gnss_outliers"] = now
                if as_long and np.array_equal(before, now):  # the look before was at the same fixes
                    break
                if scene is whole or not np.array_equal(before, now):
                    scene = whole.rebuilt(gone=self.gone)
            scene, tau = scene.coloured(noise), noise.colour.tau
            joint = likeliest(noise)
            noise = joint.noise
            as_long = abs(math.log(noise.colour.tau / tau)) < AS_LONG
            if as_long and np.array_equal(before, now):
                break
        return scene.coloured(noise), joint, less

    def _levels(self) -> list[list[int]]:
        """Components of the fixes of each level that was named: what it is next to a colour, which it may have stood for, is asked again."""
        return [rows for f in self.found if (rows := rows_of(f.chosen))]

    def _parted(self, noise: FixNoise, effect: str) -> bool:
        """Name as many levels as are likely next to a noise of the fixes: one of all axes, one of each part of them, or those that were named.

        A level is named of whatever explains most at the time; what is named behind it, smoothed vertical velocities, say, leaves one axis quieter.
        Whether there are more levels than before.
        """
        parts = [f for f in self.found if f.chosen.effect == effect]
        own, offset = [rows_of(f.chosen) for f in parts], LEVEL_ROWS[effect]
        whole = sorted(r for rows in own for r in rows)
        s, groups = self._fixes(self.scene), [[r for r in g if r in whole] for g in LEVEL_GROUPS]
        ways = [[whole]] if len(own) > 1 else []
        for finer in ([g for g in groups if g], [[r] for r in whole]):
            if len(finer) > len(own) and finer not in ways and _lead_of(s, noise, own, finer) > rules().lead:
                ways.append(finer)
        if not ways:
            return False
        others = [rows for rows in self._levels() if rows not in own]
        usual = level_ratios(self.scene, self._levels())
        likely = [joint_noise(s, noise, usual, wide=[*way, *others]) for way in (own, *ways)]
        gain = [
            joint.evidence - likely[0].evidence - (rules().lead if len(way) > len(own) else 0.0)
            for way, joint in zip((own, *ways), likely, strict=True)
        ]
        k = max(range(len(gain)), key=lambda k: (gain[k], k))
        if k == 0:
            return False
        way, total = ways[k - 1], sum(f.chosen.nats for f in parts) + likely[k].evidence - likely[0].evidence
        first, levels = parts[0], self.scene.original.factors * likely[k].noise.factor
        count = [float(s.use[:, rows].sum()) * _cost_of(levels[rows[0]]) for rows in way]
        new = [
            replace(first.chosen, axes=tuple(NED[r - offset] for r in rows), nats=total * share / sum(count))
            for rows, share in zip(way, count, strict=True)
        ]
        # of parts one may be what was believed
        named = [replace(first, chosen=h) for h in (at_level(h, levels) for h in new) if _is_off(h.values[0].value)]
        self.found = [g for f in self.found for g in (named if f is first else [] if f in parts else [f])]
        return len(way) > len(own)

    def _kinds(self, noise: FixNoise) -> list[FixNoise]:
        """A colour as it is, of all axes and, where what is stated varies, of the other kind: as large throughout, or following that."""
        if noise.known:
            return [noise]
        colours, sigma = [noise.colour], self.scene.surrogate.sigma()[:3]
        own = noise.colour.sigma[:3]
        if not own.all():
            ratio = np.max(own / np.where(sigma > 0.0, sigma, math.inf))
            colours.append(noise.colour._replace(sigma=np.append(np.where(own > 0.0, own, ratio * sigma), np.zeros(3))))
        if self.scene.surrogate.stated_vary(1.0 + rules().tolerance):
            colours += [c._replace(follows=not c.follows) for c in colours]
        return [replace(noise, colour=c) for c in colours]

    def _without_colour(self, scene: Scene, noise: FixNoise) -> Scene | None:
        """The scene without a colour that explains nothing any more beside the levels and the rest, which is no finding then; else None."""
        level = self._named("gnss_noise_level")
        own = about(level) if level is not None else np.zeros(6, dtype=bool)
        wide = [] if level is None else [rows_of(level)]
        s, usual = self._fixes(scene), level_ratios(scene, wide)
        plain = joint_noise(s, replace(noise, colour=PLAIN, known=True), usual, wide=wide)
        if joint_noise(s, noise, usual, wide=wide).evidence > plain.evidence + rules().keep_nats:
            return None
        worth = self._take_back("gnss_correlated_noise")
        if level is not None:
            new = replace(level, nats=level.nats + worth)
            self.found = [replace(f, chosen=new) if f.chosen is level else f for f in self.found]
        factors = scene.original.factors * plain.noise.factor
        return scene.coloured(None).rebuilt(factors=factors, levels=np.where(own, factors, scene.original.levels))
