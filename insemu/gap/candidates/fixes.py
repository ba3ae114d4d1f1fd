"""What the fixes of a drive or flight may be wrong in: levels, colour and outliers."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.filters import log_density
from insemu.gap.candidates.shapes import Change, DriveHypothesis
from insemu.gap.drive.fix_outliers import (
    FIRST,
    Look,
    always,
    by_filter,
    classified,
    less,
    log_joint,
    log_mixture,
    under_colour,
)
from insemu.gap.drive.preparation import scaled_fixes
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop
from insemu.gap.evidence.fixes import (
    LEVEL_ROWS,
    NED,
    JointNoise,
    NoiseFit,
    colour_values,
    gnss_noise_fits,
    level_name,
    levels_with_colour,
    pooled,
)
from insemu.gap.evidence.linear import (
    Block,
    log_mean_exp,
)
from insemu.gap.evidence.surrogate import PLAIN, FixNoise
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: Unit of the errors of positions (0) and velocities (3).
UNITS = {0: "m", 3: "m/s"}
#: Steps in which share and size of outliers are estimated.
MIXTURE_STEPS = 30
#: Median of the absolute value of a standard normal; change of the logarithm of a level, share or size at which it is settled.
NORMAL_MEDIAN, SAME = 0.6745, 0.03
#: Most times that outliers, and how many and how large they are, are estimated in turns.
MOST_TURNS = 10


def whole_innovations(
    scene: Scene, nu: Array, cut: float | None, effect: str
) -> tuple[NDArray[np.int64], Array, Array]:
    """Fixes with a whole position or velocity, their innovations (k, 3) and covariances (k, 3, 3): under a colour, less what those before say of it.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    nu : (f, 6) array
        Innovations, m and m/s.
    cut : float or None
        Fixes after this time (s) are left out; ``None``: none is.
    effect : str
        One of :data:`insemu.gap.drive.fix_outliers.FIRST`, which says whether it is about positions or velocities.

    Returns
    -------
    at : (k,) array of int
        Rows of the fixes.
    innovations : (k, 3) array
        NED, m or m/s.
    S : (k, 3, 3) array
        Their covariances under the filter.
    """
    fixes, rows = scene.prepared.result.fixes, slice(FIRST[effect], FIRST[effect] + 3)
    there = scene.loop.use[:, rows].all(axis=1)
    if cut is not None:
        there = there & (fixes.t <= cut)
    at = np.flatnonzero(there)
    if scene.noise is not None:
        _, v, S = under_colour(scene.surrogate, scene.noise, nu)({effect: (np.zeros(0), np.zeros(3))})[effect]
        return at, v[: at.size], S[: at.size]
    return at, nu[at][:, rows], fixes.S[at][:, rows, rows]


def gnss_outliers(scene: Scene, nu: Array, cut: float | None, effect: str = "gnss_outliers") -> list[DriveHypothesis]:
    """A small share of positions or velocities with a much larger spread.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    nu : (f, 6) array
        Innovations less what is explained already, m and m/s.
    cut : float or None
        Fixes after this time (s) are not looked at; ``None``: all are.
    effect : str
        One of :data:`insemu.gap.drive.fix_outliers.FIRST`.

    Returns
    -------
    list of DriveHypothesis
        One, or none where fewer than 30 of them are there.
    """
    first = FIRST[effect]
    at, v, S = whole_innovations(scene, nu, cut, effect)
    # velocities of an antenna that swings faster than the fixes come have no normal tails
    if at.size < 30 or (first == 3 and scene.prepared.swings):
        return []
    plain = log_density(v, S)
    sigma0 = np.sqrt(np.median(np.einsum("kii->ki", S), axis=0))
    logs, grid = [], []
    for ratio in np.geomspace(3.0, 300.0, 10):
        wide = log_density(v, S + np.diag((ratio * sigma0) ** 2))
        for p in np.geomspace(1.0 / at.size, 0.1, 8):
            logs.append(float(np.sum(np.logaddexp(math.log1p(-p) + plain, math.log(p) + wide) - plain)))
            grid.append((p, ratio))
    p, ratio = grid[int(np.argmax(logs))]
    nats = log_mean_exp(logs)
    count = max(1.0, p * at.size)
    spread = 1.5 / math.sqrt(count)
    values: tuple[Value, ...] = (
        Value("probability", p, p * math.exp(-2.0 / math.sqrt(count)), p * math.exp(2.0 / math.sqrt(count)), "1"),
    )
    values += tuple(
        Value(
            f"sigma_{a}",
            float(ratio * s),
            float(ratio * s) / (1.0 + spread),
            float(ratio * s) * (1.0 + spread),
            UNITS[first],
        )
        for a, s in zip(NED, sigma0, strict=True)
    )
    return [Hypothesis(effect, nats, values, Change(), "", "gnss", NED)]


def _share_and_sigma(outliers: DriveHypothesis) -> tuple[float, Array]:
    """Share of outliers and their standard deviations (3,), NED."""
    given = {x.name: x.value for x in outliers.values}
    return given["probability"], np.array([given[f"sigma_{a}"] for a in NED])


def mixture(outliers: DriveHypothesis, v: Array, S: Array) -> Array:
    """Log densities (k,) of positions or velocities of which a share are outliers, without the constant.

    Parameters
    ----------
    outliers : DriveHypothesis
        From :func:`gnss_outliers`.
    v, S : (k, 3), (k, 3, 3) arrays
        Innovations less what is explained, m or m/s, and their covariances where they are none.
    """
    return log_mixture(v, S, *_share_and_sigma(outliers))


def classified_density(
    scene: Scene, outliers: DriveHypothesis, explained: tuple[NDArray[np.int64], Array], cut: float | None, gone: Array
) -> tuple[float, Array]:
    """Log density of all positions, or velocities, each an outlier or not as is more likely, without the constant; and times (k,) of the outliers, s.

    Parameters
    ----------
    scene : Scene
        With all fixes.
    outliers : DriveHypothesis
        Their share and size.
    explained : (index, coefficients)
        Columns and their coefficients, from where no outliers are.
    cut : float or None
        Fixes after this time (s) do not count.
    gone : (k,) array
        Times of those that are taken for outliers at first, s.
    """
    known = {outliers.effect: _share_and_sigma(outliers)}
    of = np.where(scene.surrogate.use == 1, scene.surrogate.nu - scene.residual_innovations(*explained), 0.0)
    seen = _look(scene, outliers.effect, 1.0, scene, of)({outliers.effect: (gone, known[outliers.effect][1])})
    until = math.inf if cut is None else cut
    out = classified(seen, known, {outliers.effect: gone}, until)
    value = log_joint(seen, known, out, until)
    return value, (out if cut is None else classified(seen, known, out, since=cut))[outliers.effect]


@dataclass(frozen=True)
class Separated:
    """Outliers and the other fixes.

    Parameters
    ----------
    times : (k,) array
        Of the outliers, s.
    outliers : DriveHypothesis
        With share and size as they are estimated beside each other.
    level : float
        Of those that are none, over the nominal one.
    """

    times: Array
    outliers: DriveHypothesis
    level: float


def without_outliers(
    scene: Scene,
    outliers: DriveHypothesis,
    cut: float | None,
    seen: Scene,
    nu: Array,
    level: float | None = None,
) -> Separated:
    """Which positions or velocities are outliers, and how many and how large they are, as a filter sees them that does not follow them.

    The filter that named them was led astray by each, and took fixes after it for outliers too. It runs again without those, and looks at all,
    less what is explained already as it sees that. Under a colour, which it would follow, the filter on its error does that.

    Parameters
    ----------
    scene : Scene
        The recording with its responses, the fixes at the levels that they have but for the outliers.
    outliers : DriveHypothesis
        From :func:`gnss_outliers`.
    cut : float or None
        Those up to this time (s), their share and size are estimated from the fixes up to it; ``None``: from all.
    seen : Scene
        In which the outliers were named.
    nu : (f, 6) array
        Innovations there less what is explained already, m and m/s.
    level : float, optional
        A level of them over that of the scene which was named before the outliers: it may have stood for them, and is estimated with them.
        Outliers found at the nominal level would be every large error, and those left be such as follow the errors before.
    """
    effect, until = outliers.effect, math.inf if cut is None else cut
    gone, now = np.zeros(0), 1.0 if level is None else level
    explained = np.where(seen.surrogate.use == 1, seen.surrogate.nu - nu, 0.0)
    share, sigma = _share_and_sigma(outliers)
    of, flown = _look(scene, effect, now, seen, explained)({effect: (gone, sigma)}), now
    for _ in range(MOST_TURNS):
        before = gone
        gone = classified(of, {effect: (share, sigma)}, {effect: gone}, until)[effect]
        _, v, S = of({effect: (gone, sigma)}, until)[effect]
        outliers = _share_and_size(outliers, v, S)
        was, (share, sigma) = np.array([share, sigma[0]]), _share_and_sigma(outliers)
        if level is not None:
            # the median hardly sees the outliers
            y = v / np.sqrt(np.einsum("kii->ki", S))
            scatter = float(np.median(np.abs(y))) / NORMAL_MEDIAN
            now *= scatter if abs(math.log(scatter)) >= SAME else 1.0
        same = np.array_equal(before, gone) and now == flown
        if same and np.abs(np.log(np.array([share, sigma[0]]) / was)).max() < SAME:
            break
        if not same:
            of, flown = _look(scene, effect, now, seen, explained)({effect: (gone, sigma)}), now
    if cut is not None:
        gone = classified(of, {effect: (share, sigma)}, {effect: gone}, since=cut)[effect]
    return Separated(gone, outliers, now)


def _look(scene: Scene, effect: str, level: float, seen: Scene, explained: Array) -> Look:
    """The positions or velocities of a scene as its filter sees them at a level over the scene's.

    What is explained (f, 6) of the innovations of ``seen`` is less where an outlier is hardly followed, or more: the filter on its error says so.
    """
    if scene.noise is not None:
        return always(under_colour(scene.surrogate, scene.noise, scene.surrogate.nu - explained))
    prepared = scene.prepared
    factors = prepared.factors * np.where(np.arange(6) // 3 == FIRST[effect] // 3, level, 1.0)
    look = by_filter(
        lambda gnss: prepared.again(gnss=gnss, factors=np.ones(6)).result, scaled_fixes(prepared.gnss, factors)
    )
    if not explained.any():
        return look
    ratio = factors / seen.prepared.factors
    return less(look, under_colour(seen.surrogate, FixNoise(ratio, PLAIN), explained))


def _share_and_size(outliers: DriveHypothesis, v: Array, S: Array) -> DriveHypothesis:
    """Outliers with share and size from innovations that they did not disturb: expectation and maximization on a mixture of two normals."""
    given = {x.name: x.value for x in outliers.values}
    p, sigma = given["probability"], np.array([given[f"sigma_{a}"] for a in NED])
    sigma0 = np.sqrt(np.median(np.einsum("kii->ki", S), axis=0))
    ratio, plain = float(np.mean(sigma / sigma0)), log_density(v, S)
    for _ in range(MIXTURE_STEPS):
        wide = log_density(v, S + np.diag((ratio * sigma0) ** 2))
        share = 1.0 / (1.0 + np.exp(np.clip(math.log((1.0 - p) / p) + plain - wide, -50.0, 50.0)))
        count = max(float(share.sum()), 0.5)
        p = min(count / v.shape[0], rules().most_outliers)
        own = np.sum(v**2 / sigma0**2, axis=1) / 3.0 - 1.0
        ratio = math.sqrt(max(float(share @ own) / count, 1.0))
    count = p * v.shape[0]
    # the share of a count that is binomial (Jeffreys' interval), and the scatter of a variance of three components
    low, high = scipy.stats.beta.ppf((0.025, 0.975), count + 0.5, v.shape[0] - count + 0.5)
    sd = 1.0 / math.sqrt(6.0 * count)
    values: tuple[Value, ...] = (Value("probability", p, float(low), float(high), "1"),)
    unit = UNITS[FIRST[outliers.effect]]
    values += tuple(Value.positive(f"sigma_{a}", float(ratio * s), sd, unit) for a, s in zip(NED, sigma0, strict=True))
    return replace(outliers, values=values)


def covariance_hypotheses(
    scene: Scene,
    given: Sequence[Block],
    skip: Collection[str],
    cut: float | None,
    named: NDArray[np.bool_] | None = None,
) -> list[DriveHypothesis]:
    """Weigh levels, colour and outliers of the fixes on the innovations less what is already explained.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    given : sequence of Block
        What is explained already.
    skip : collection of str
        Effects that are not weighed.
    cut : float or None
        Fixes after this time (s) are not looked at; ``None``: all are.
    named : (6,) array of bool, optional
        Components of the fixes whose level was named already.
    """
    nu = scene.unexplained(given, cut)
    surrogate = replace(scene.surrogate, nu=nu)
    if cut is not None:
        surrogate = surrogate.until(cut)
    k = surrogate.t.size
    loop: Loop = scene.loop
    y = np.einsum("kij,kj->ki", loop.white[:k], surrogate.nu)
    moved = scene.original.factors / scene.original.levels
    if scene.noise is None:
        found = gnss_noise_fits(
            surrogate, surrogate.log_likelihood(), loop.white[:k], y, trimmed=moved, skip=tuple(skip), named=named
        )
    else:
        found = [] if "gnss_noise_level" in skip else levels_with_colour(surrogate, scene.noise, moved, named)
    fits: dict[str, list[NoiseFit]] = {}
    for fit in found:
        fits.setdefault(fit.effect, []).append(fit)
    out = []
    for effect, tried in fits.items():
        top = max(tried, key=lambda f: f.nats)
        out.append(Hypothesis(effect, pooled(tried), top.values, Change(noise=top), "", "gnss", top.axes))
    for effect in FIRST:
        if effect not in skip:
            out += gnss_outliers(scene, nu, cut, effect)
    return out


def as_joint(h: DriveHypothesis, scene: Scene, joint: JointNoise) -> DriveHypothesis:
    """A colour or a level of the fixes as they were estimated together; anything else as it is.

    Parameters
    ----------
    h : DriveHypothesis
        What was named.
    scene : Scene
        In which they were estimated.
    joint : JointNoise
        The estimate, levels relative to those of the scene's filter.
    """
    if h.effect == "gnss_correlated_noise":
        # an axis none of whose fixes is used is estimated no more
        axes = tuple(a for a in NED if f"sigma_{a}" in joint.sd)
        return replace(h, axes=axes, values=colour_values(joint.noise.colour, axes, joint.sd)) if axes else h
    h = at_level(h, scene.original.factors * joint.noise.factor)
    if not (rows := rows_of(h)) or level_name(rows) not in joint.sd:
        return h
    return replace(h, values=(Value.positive("factor", h.values[0].value, joint.sd[level_name(rows)], "1"),))


def within(h: DriveHypothesis, intervals: Mapping[str, tuple[float, float]]) -> DriveHypothesis:
    """A colour or a level of the fixes with intervals, as ratios to its values; anything else as it is.

    Parameters
    ----------
    h : DriveHypothesis
        What was named.
    intervals : mapping of str to (low, high)
        By parameter.
    """
    rows = rows_of(h)
    if h.effect != "gnss_correlated_noise" and not (rows and level_name(rows) in intervals):
        return h
    ends = ((v, *intervals.get(level_name(rows) if rows else v.name, (1.0, 1.0))) for v in h.values)
    return replace(h, values=tuple(replace(v, low=v.value * low, high=v.value * high) for v, low, high in ends))


def about(level: DriveHypothesis) -> NDArray[np.bool_]:
    """Components (6,) of the fixes that a level is about; none of anything else."""
    first = LEVEL_ROWS.get(level.effect, 6)
    return np.isin(np.arange(6), [first + NED.index(a) for a in level.axes if a in NED])


def rows_of(level: DriveHypothesis) -> list[int]:
    """Components of the fixes that a level is about; none of anything else."""
    return [int(r) for r in np.flatnonzero(about(level))]


def level_ratios(scene: Scene, rows: Sequence[Sequence[int]]) -> Array:
    """By what the filter's levels (6,) were moved, as ratios to what is stated of levels that are in question and to the other named ones.

    Parameters
    ----------
    scene : Scene
    rows : sequence of sequences of int
        Components of the fixes whose levels are in question.
    """
    at, asked = scene.original, [r for level in rows for r in level]
    return at.factors / np.where(np.isin(np.arange(6), asked), 1.0, at.levels)


def at_level(h: DriveHypothesis, factors: Array) -> DriveHypothesis:
    """A level of the fixes at what the standard deviations of the fixes (6,) were found to be over the stated ones; anything else as it is."""
    if not (own := about(h)).any():
        return h
    (level,) = h.values
    grown = float(np.exp(np.mean(np.log(factors[own])))) / level.value
    value = replace(level, value=grown * level.value, low=grown * level.low, high=grown * level.high)
    return replace(h, values=(value,))
