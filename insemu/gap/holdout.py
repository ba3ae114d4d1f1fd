"""Figures on data that was not used for naming: log score gained and reduced chi-square, of a log at rest and of a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.candidates.axis import CANDIDATES, AxisState
from insemu.gap.candidates.mounting import Mounted
from insemu.gap.checks.drive import COMPONENTS
from insemu.gap.checks.rest import block_innovations
from insemu.gap.data.log import Reduced, reduce
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import LEVEL_GROUPS, level_derivatives, level_scores
from insemu.gap.evidence.linear import Block
from insemu.gap.evidence.model import Component, Explanation, Likelihood, fit
from insemu.gap.verdict import Burst, Finding, GapReport, Interval, Step
from insemu.records import Series

Array = NDArray[np.float64]
#: Stretches of the held-out fixes whose mean squares are compared: enough that their scatter is known within a fifth.
STRETCHES = 16
#: A burst lasts for so much of the held-out time at the most; has so many times its share of the squares, which chance gives no part once in so
#: many recordings that are throughout as loud as the fixes so many times its length before and behind; its fixes are those so many standard
#: deviations off.
BURST_SHARE, BURST_TIMES, BURST_CHANCE, BURST_AROUND, BURST_OFF = 0.01, 5.0, 1e-3, 10.0, 3.0


# -- a log at rest ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Log score of a model on data, with what its uncertainty and the reduced chi-square need."""

    log_score: float
    chi_square: Array
    dof: Array


@dataclass(frozen=True)
class HeldOut:
    """Figures of one axis on data that was not used for naming."""

    before: Score
    after: Score
    nats: float
    variance: float
    blocks: int
    uncertainty: float


def score(data: Reduced, explanation: Explanation, extra: Array | None = None) -> Score:
    """Log score and, for the block band and each octave above it, the sum of squared whitened innovations with its degrees of freedom.

    Parameters
    ----------
    data : Reduced
        Held-out samples of the axis.
    explanation : Explanation
        The model; its regressors are not used.
    extra : (blocks - 1,) array, optional
        What known signals add to the differences of block means, unit of the axis.
    """
    y = data.differences - (extra if extra is not None else 0.0)
    moved = replace(data, differences=np.asarray(y))
    plain = replace(explanation, regressors=())
    likelihood = Likelihood(moved)
    e = block_innovations(moved, plain)
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
    return Interval.positive(float(ratio.mean()), math.sqrt(float(variance.sum()) / ratio.size**2 + uncertainty**2))


def piece(data: Reduced, first: int, last: int) -> Reduced:
    """Some samples of an axis, reduced as the whole was.

    Parameters
    ----------
    data : Reduced
        The axis.
    first, last : int
        Samples ``first`` to ``last - 1``.
    """
    return reduce(Series(data.values[first:last], 1.0 / data.dt, data.unit, data.name), data.block)


def _regressor_prediction(state: AxisState, test: Reduced, temperature: Array | None) -> Array | None:
    """Block differences of the named deterministic effects, carried over to other data of the same axis."""
    explanation = state.explanation
    if not explanation.regressors or any(r.rebuild is None for r in explanation.regressors):
        return None
    mean, _ = state.likelihood.coefficients(explanation)
    columns = [r.rebuild(test, temperature) for r in explanation.regressors if r.rebuild is not None]
    return np.asarray(np.hstack(columns) @ mean)


def score_axis(
    end: AxisState, taken_out: Sequence[str], nominal: Explanation, test: Reduced, temperature: Array | None
) -> HeldOut:
    """Score the nominal and the refined model of an axis on other data of it.

    Parameters
    ----------
    end : AxisState
        The axis with everything that was found on other data.
    taken_out : sequence of str
        Effects that were taken out of its samples (lines, outliers, levels, held samples): the same candidate takes them out of the test data,
        and what that is worth there has its own parameters already paid.
    nominal : Explanation
    test : Reduced
    temperature : (n,) array, optional
        degC at the samples of the test data.
    """
    before = score(test, nominal)
    bonus, twins = 0.0, list[Component]()
    state = AxisState(test, fit(Likelihood(test), replace(end.explanation, regressors=())), temperature)
    for effect in taken_out:
        best = max(CANDIDATES[effect](state), key=lambda w: w.nats, default=None)
        if best is None or best.nats <= 0.0:
            continue
        state = best.change
        if best.effect == "telegraph" and best.variant != "levels":
            twins.append(state.explanation.components[-1])  # scored with the model, not taken out
        else:
            bonus += best.nats
    final, explanation = state.data, end.explanation
    for twin in twins:
        explanation = explanation.with_component(twin)
    after = score(final, explanation, _regressor_prediction(end, final, temperature))
    plain = score(final, nominal) if bonus else before
    # sampling variance of the gain, band by band: half the squares times the change of precision
    change = (after.chi_square - plain.chi_square) / after.dof
    variance = float(np.sum(change**2 * after.dof / 2.0) + abs(bonus))
    sigma = np.minimum(2.0 * end.fitted.sigma, 0.5)
    level = math.sqrt(float(np.mean(sigma**2)) / after.dof.size) if sigma.size else 0.0
    gained = after.log_score - plain.log_score + bonus
    return HeldOut(before, after, gained, variance, final.differences.size, level)


# -- a drive or flight --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DriveScore:
    """Figures of a drive on fixes that were not used for naming.

    Parameters
    ----------
    before, after : Interval
        Gap index of the nominal and of the refined model.
    gain : Interval
        Log score gained, nats per fix.
    burst : Burst, optional
        The fixes on which a large part of ``after`` stands.
    shrink : tuple of Step
        From ``before`` to ``after``, effect by effect.
    """

    before: Interval
    after: Interval
    gain: Interval
    burst: Burst | None = None
    shrink: tuple[Step, ...] = ()


def score_drive(scene: Scene, final: Scene, blocks: Sequence[Block], cut: float, outliers: float = 0.0) -> DriveScore:
    """Gap index before and after and log score gained per fix after ``cut``, where nothing was named.

    Parameters
    ----------
    scene, final : Scene
        With the nominal filter, and with the one that believes in what was found before ``cut``.
    blocks : sequence of Block
        How what was found enters the linear model of the innovations of ``final``.
    cut : float
        s.
    outliers : float
        Log density of the positions after ``cut`` that were left out as outliers.
    """
    late = scene.rows_t > cut
    test = scene.loop.y.reshape(-1, 6)[scene.loop.use][late]
    fixes = max(1, len(np.unique(scene.rows_t[late])))
    data = replace(final.data, variance=1.0)
    e, logdet = data.predictive(blocks, final.rows_t > cut)
    gained = 0.5 * float(test @ test) - 0.5 * float(e @ e) - logdet + _log_volume(scene, cut) - _log_volume(final, cut)
    spread = math.sqrt(abs(float(test @ test) - float(e @ e)) + 0.5)

    def around(y: Array, at: Scene) -> Interval:
        value = float(np.mean(y * y))
        # squares go together where the model is wrong, those of one fix and those of a stretch: their own spread there, the chi-square's where it
        # is right; and the levels of the fixes are known from the first part only
        stretches = np.array([np.mean(part) for part in np.array_split(y * y, min(STRETCHES, y.size))])
        spread_of = (math.sqrt(2.0 / y.size) * max(value, 0.2), float(np.std(y * y)) / math.sqrt(y.size))
        own = max(*spread_of, float(np.std(stretches, ddof=1)) / math.sqrt(stretches.size))
        return Interval.positive(value, math.hypot(own, value * _level_spread(at, cut)))

    t, component = final.rows_t[final.rows_t > cut], np.nonzero(final.loop.use)[1][final.rows_t > cut]
    gone = burst(e, t)
    said = None
    if gone is not None:
        farthest = np.flatnonzero(gone)[np.argmax(np.abs(e[gone]))]
        said = Burst(
            float(t[gone].min()), float(t[gone].max()), " ".join(COMPONENTS[component[farthest]]), float(np.abs(e[farthest])),
            around(e[~gone], final),
        )  # fmt: skip
    gain = Interval.normal((gained + outliers) / fixes, spread / fixes)
    return DriveScore(around(test, scene), around(e, final), gain, said)


def burst(e: Array, t: Array) -> NDArray[np.bool_] | None:
    """Rows of the short time on which a large part of the mean square stands; ``None`` where there is none.

    Parameters
    ----------
    e, t : (n,) arrays
        Whitened innovations and their times, which rise, s.
    """
    length = BURST_SHARE * (t[-1] - t[0])
    squares = np.concatenate([[0.0], np.cumsum(e * e)])
    last = np.searchsorted(t, t + length, side="right")
    sums = squares[last] - squares[:-1]
    first = int(np.argmax(sums))
    window = np.zeros(t.size, dtype=bool)
    window[first : last[first]] = True
    large = window & (np.abs(e) > BURST_OFF * math.sqrt(float(np.median(e * e)) / scipy.stats.chi2.median(1)))
    if not large.any() or window.all():
        return None
    gone = (t >= t[large].min()) & (t <= t[large].max())
    near = ~gone & (t > t[large].min() - BURST_AROUND * length) & (t < t[large].max() + BURST_AROUND * length)
    own, rest = float(np.sum(e[gone] ** 2)), max(float(np.mean(e[at] ** 2)) for at in (near, ~gone) if at.any())
    chance = float(scipy.stats.chi2.sf(own / rest, int(gone.sum()))) * t.size
    share = max(BURST_SHARE, float(np.mean(gone)))
    return gone if own > BURST_TIMES * share * squares[-1] and chance < BURST_CHANCE else None


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
        return scene.loop.half_log_det(use)
    volume = 0.0
    for sign, part in ((1.0, scene.surrogate), (-1.0, scene.surrogate.until(cut))):
        white, value = part.whiten(part.nu[:, :, None], scene.noise.factor, scene.noise.colour)
        volume -= sign * (value + 0.5 * float(np.sum(white**2)))
    return volume


def scored(report: GapReport, score: DriveScore, mounted: Mounted | None, early: Sequence[Finding]) -> GapReport:
    """The report with figures on held-out fixes, and on the held-out motion across the vehicle where its mounting was looked at.

    Parameters
    ----------
    report : GapReport
    score : DriveScore
    mounted : Mounted, optional
    early : sequence of Finding
        What was taken off before the search.
    """
    steps = list(score.shrink)
    if early and len(steps) > 1:
        steps[1] = replace(steps[1], added=(*((f.effect, f.sensor, f.axes) for f in early), *steps[1].added))
    if mounted is not None and mounted.dof and math.isfinite(score.before.value):
        fixes = mounted.dof / 2
        gain, sd = mounted.gain
        held = _sum([score.gain, Interval(gain / fixes, (gain - 1.96 * sd) / fixes, (gain + 1.96 * sd) / fixes)])
        # the motion across the vehicle and the innovations count alike
        across = [chi_square / mounted.dof for chi_square in mounted.chi_square]
        burst = score.burst
        if burst is not None:
            burst = replace(burst, without=_mean(burst.without, across[1], mounted.dof))
        before, after = (_mean(i, a, mounted.dof) for i, a in zip((score.before, score.after), across, strict=True))
        score = DriveScore(before, after, held, burst)
        own = math.sqrt(2.0 / mounted.dof)
        steps = [
            replace(s, index=0.5 * (s.index + across[min(k, 1)]), spread=0.5 * math.hypot(s.spread, own))
            for k, s in enumerate(steps)
        ]
    return replace(
        report,
        gap_before=score.before,
        gap_after=score.after,
        held_out=score.gain,
        burst=score.burst,
        shrink=tuple(steps),
    )


def _sum(items: list[Interval]) -> Interval:
    some = [i for i in items if math.isfinite(i.value)]
    if not some:
        return items[0]
    value = sum(i.value for i in some)
    half = math.sqrt(sum((0.5 * (i.high - i.low)) ** 2 for i in some))
    return Interval(value, value - half, value + half)


def _mean(index: Interval, other: float, dof: int) -> Interval:
    sd = 0.5 * math.hypot(index.log_sd * index.value, math.sqrt(2.0 / dof) * other)
    return Interval.positive(0.5 * (index.value + other), sd)
