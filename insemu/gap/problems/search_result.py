"""What the search of a drive found: how it enters the model of the innovations, the filter that believes in it, and how it scores later fixes."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS
from insemu.gap.candidates.fixes import (
    as_joint,
    at_level,
    level_ratios,
    mixture,
    rows_of,
    whole_innovations,
    within,
)
from insemu.gap.candidates.robust import excess_of, is_lasting
from insemu.gap.candidates.shapes import LAGGED, ONCE, PROCESSES, Change, DriveHypothesis, bank, shape_values
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.confusion import Repetitions
from insemu.gap.drive.fix_outliers import FIRST, hardly_followed
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import joint_noise
from insemu.gap.evidence.linear import Block
from insemu.gap.holdout import DriveScore, score_drive
from insemu.gap.hypothesis import Found, class_of
from insemu.gap.policy import rules
from insemu.gap.problems.findings import with_process
from insemu.gap.verdict import Confusable, Finding, Member, Step, Value
from insemu.gap.worth import Outage, worth_in_motion, worth_in_noise, worth_of_added

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Named:
    """What the search found.

    Parameters
    ----------
    found : tuple of Found
    scene : Scene
        At the levels, colours and corrections that were found.
    gone : mapping of effect to (k,) array
        Times of the positions and of the velocities that were left out as outliers, s.
    """

    found: tuple[Found[Change], ...]
    scene: Scene
    gone: Mapping[str, Array]

    @property
    def blocks(self) -> list[Block]:
        """How the effects enter the linear model of the innovations, and what is uncertain in any case."""
        return [*self.scene.always, *blocks_of(self.found)]


def blocks_of(found: Sequence[Found[Change]]) -> list[Block]:
    """How findings enter the linear model of the innovations, those that do."""
    return [f.chosen.change.block for f in found if f.chosen.change.block is not None]


def believing(named: Named, cut: float | None = None) -> tuple[Named, Scene, list[Block]]:
    """The filter that believes in the slow processes that were found, and the blocks of everything else; what was found, with the fixes' noise there.

    The search carries a process on knots; what is left of a strong one between them would count against it, and in the noise of the fixes.
    """
    beliefs = dict(named.scene.original.beliefs)
    blocks = list(named.scene.always)
    for f in named.found:
        h = f.chosen
        if h.effect in PROCESSES:
            for axis in h.axes:
                name = f"{h.sensor}_{axis}"
                beliefs[name] = with_process(beliefs[name], h.effect, {v.name: v.value for v in h.values})
        elif h.change.block is not None:
            blocks.append(h.change.block)
    carried = len(blocks) < len(named.blocks)
    coloured = cut is None and any(f.chosen.effect == "gnss_correlated_noise" for f in named.found)
    if not carried and not coloured:
        return named, named.scene, blocks
    scene = named.scene.rebuilt(beliefs=beliefs) if carried else named.scene
    if scene.noise is None:
        scene = scene.trimmed(blocks, cut)
        found = tuple(replace(f, chosen=at_level(f.chosen, scene.original.factors)) for f in named.found)
    else:
        s = replace(scene.surrogate, nu=scene.unexplained(blocks, cut))
        wide = [rows for f in named.found if (rows := rows_of(f.chosen))]
        joint = joint_noise(s if cut is None else s.until(cut), scene.noise, level_ratios(scene, wide), wide=wide)
        scene = scene.coloured(joint.noise)
        found = tuple(replace(f, chosen=as_joint(f.chosen, scene, joint)) for f in named.found)
        if coloured:
            # the posterior of a colour has a tail that the search does not ask for
            intervals = joint.intervals()
            found = tuple(replace(f, chosen=within(f.chosen, intervals)) for f in found)
    return replace(named, found=found), scene, blocks


def held_out(
    scene: Scene, named: Named, cut: float, begun: Scene | None = None, noticed: Sequence[Finding] = ()
) -> DriveScore:
    """Gap index before and after, step by step as well, and log score gained per fix after ``cut``, where nothing was named.

    Parameters
    ----------
    scene, named, cut : Scene, Named, float
        The recording as it came, what was found in its fixes up to ``cut``, and that time in s.
    begun : Scene, optional
        The recording in which the search began, where something was taken off before.
    noticed : sequence of Finding
        What was taken off of it for the samples' own sake.
    """
    _, final, blocks = believing(named, cut)
    score = score_drive(scene, final, blocks, cut, _of_outliers(scene, named, final, blocks, cut))
    one_by_one = [f for f in named.found if f.chosen.change.block is not None and f.chosen.effect not in PROCESSES]
    others = [f for f in named.found if f not in one_by_one]
    data = replace(final.data, variance=1.0)

    def step(y: Array, *added: Finding | DriveHypothesis) -> Step:
        return Step(tuple((f.effect, f.sensor, f.axes) for f in added), float(np.mean(y * y)), math.sqrt(2.0 / y.size))

    def late(at: Scene) -> Array:
        return at.loop.y.reshape(-1, 6)[at.loop.use][at.rows_t > cut]

    def left(count: int) -> Array:
        known = [*named.scene.always, *blocks_of(one_by_one[:count])]
        return data.predictive(known, final.rows_t > cut)[0]

    steps = [step(late(scene))]
    if begun is not None and begun is not scene:
        steps.append(step(late(begun), *noticed))
    if others:
        steps.append(step(left(0), *(f.chosen for f in others)))
    steps += [step(left(k), f.chosen) for k, f in enumerate(one_by_one, 1)]
    return replace(score, shrink=tuple(steps))


def _of_outliers(scene: Scene, named: Named, final: Scene, blocks: Sequence[Block], cut: float) -> float:
    """What a model with outliers adds to the log density of the fixes after ``cut`` that were not left out: a share is one or the other.

    What was left out is seen by the final filter, which hardly follows it.
    """
    found = {f.chosen.effect: f.chosen for f in named.found if f.chosen.effect in FIRST}
    if not found:
        return 0.0
    whole, factors = scene.original.gnss, final.original.factors
    assert whole.pos_std_ned is not None
    more = np.zeros((len(whole), 6))
    for effect, h in found.items():
        sigma = np.array([x.value for x in h.values if x.name.startswith("sigma_")])
        stated = whole.pos_std_ned if FIRST[effect] == 0 else whole.vel_std_ned
        assert stated is not None
        rows = slice(FIRST[effect], FIRST[effect] + 3)
        out = np.isin(whole.t, named.gone[effect])[:, None]
        more[:, rows] = np.where(out, hardly_followed(sigma, (stated * factors[rows]) ** 2), 0.0)
    raised = replace(whole, pos_std_ned=np.sqrt(whole.pos_std_ned**2 + more[:, :3] / factors[:3] ** 2))
    if raised.vel_std_ned is not None:
        raised = replace(raised, vel_std_ned=np.sqrt(raised.vel_std_ned**2 + more[:, 3:] / factors[3:] ** 2))
    seen, total = final.rebuilt(whole=raised), 0.0
    nu, t = seen.unexplained(blocks, cut), seen.prepared.result.fixes.t
    added = more[np.searchsorted(whole.t, t)] * (1.0 if seen.noise is None else seen.noise.factor**2)
    for effect, h in found.items():
        at, v, S = whole_innovations(seen, nu, None, effect)
        later = t[at] > cut
        gone = later & np.isin(t[at], named.gone[effect])
        own = added[at][gone][:, FIRST[effect] : FIRST[effect] + 3]
        total += float(np.sum(mixture(h, v[gone], S[gone] - own[:, :, None] * np.eye(3))))
        total += float(np.sum(later & ~gone)) * math.log1p(-h.values[0].value)
    return total


def reported(f: Found[Change], named: Named, outages: Sequence[Outage]) -> Finding:
    """A finding as it is reported: values from everything together, members of its class, runners-up.

    Parameters
    ----------
    f, named : Found, Named
        One of what was found, and all of it.
    outages : sequence of Outage
        In which the worth of noise is computed.
    """
    h, scene, values, metres = f.chosen, named.scene, f.chosen.values, math.nan
    factor = 1.0
    if is_lasting(h):
        given = [*scene.always, *blocks_of([g for g in named.found if g is not f])]
        factor = excess_of(Unexplained(scene, scene.data, slice(None), given), h)
    if h.change.block is not None and (h.change.columns or h.change.window is not None):
        index, mean, covariance = scene.data.posterior(named.blocks)
        # two blocks may share a column: what it explains is their sum
        sums = (index[None, :] == h.change.block[0][:, None]).astype(np.float64)
        mean, covariance = sums @ mean, factor * sums @ covariance @ sums.T
        if h.change.columns:
            values = shape_values(scene, h.change.block[0], mean, covariance)
            metres = worth_in_motion(scene.loop, scene.motion, [scene.columns[i] for i in h.change.columns], mean)
        else:
            sd = math.sqrt(float(covariance[0, 0]))
            values = (Value.normal("value", float(mean[0]), sd, values[0].unit), *values[1:])
            if h.effect in ("lever_arm_step", "expression_step") and h.change.window is not None:
                column = scene.window_column(h.change.window)
                metres = worth_in_motion(scene.loop, scene.motion, [column], [values[0].value])
    members, others, confidence = class_of(*rivals_of(f))
    needs = "; ".join(dict.fromkeys(EFFECTS[m.effect].excitation for m in members)) if len(members) > 1 else ""
    text = f"a recording with more of: {needs}" if needs else ""
    found = Finding(h.effect, h.variant, h.sensor, h.axes, values, confidence, h.nats, members, text, others)
    if h.variant == LAGGED:
        return replace(found, metres=worth_of_added(scene.loop, scene.motion, found))
    return replace(found, metres=metres if math.isfinite(metres) else worth_in_noise(found, None, outages))


def rivals_of(f: Found[Change]) -> tuple[list[Member], int]:
    """Everything that a finding was compared with, best first, an effect of uncertain axes once for each; and which of them was named."""
    named, out = (f.chosen.effect, f.chosen.sensor), list[Member]()
    for r in f.ranked:
        mine = (r.effect, r.sensor) == named
        places = r.places if r.places and not (mine and r.axes != f.chosen.axes) else ()
        for axes, share in places or ((f.chosen.axes if mine else r.axes, 1.0),):
            out.append(Member(r.effect, r.sensor, axes, r.nats + math.log(share)))
    out.sort(key=lambda m: -m.nats)
    own = (k for k, m in enumerate(out) if (m.effect, m.sensor, m.axes) == (*named, f.chosen.axes))
    return out, next(own, 0)


def with_confusable(
    findings: Sequence[Finding], named: Named, without: Collection[str], rng: np.random.Generator
) -> list[Finding]:
    """The findings of the search with what each would be confused with if the recording were repeated; those without columns as they are.

    Parameters
    ----------
    findings, named, without, rng : sequence of Finding, Named, collection of str, Generator
        One finding for each entry of ``named.found``; what was found; effects taken out of the catalogue; for the repetitions.
    """
    scene, out = named.scene, []
    repetitions: Repetitions | None = None
    for finding, f in zip(findings, named.found, strict=True):
        h = f.chosen
        if h.change.block is None or h.change.window is not None:
            out.append(finding)
            continue
        repetitions = repetitions or Repetitions.of(scene.data, rng)
        others = [g.chosen for g in named.found if g is not f]
        given = [g.change.block for g in others if g.change.block is not None]
        passed = {*without, *(g.effect for g in others if g.effect in ONCE)}
        index, root = h.change.block
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
        out.append(replace(finding, confusable=tuple(sorted(rivals, key=lambda c: -c.share))))
    return out
