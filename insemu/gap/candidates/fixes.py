"""What the fixes of a drive or flight may be wrong in: steps, levels, colour and outliers."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.effects import EFFECTS
from insemu.filters import log_density
from insemu.gap.candidates.shapes import Change, DriveHypothesis
from insemu.gap.drive.apart import FIRST, MOST_ROUNDS, Seen, by_filter, log_odds, under_colour
from insemu.gap.drive.preparation import scaled_fixes
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop
from insemu.gap.evidence.fixes import LEVEL_ROWS, NED, JointNoise, NoiseFit, gnss_noise_fits, level_beside, pooled
from insemu.gap.evidence.linear import (
    Block,
    Field,
    log_mean_exp,
)
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: Unit of the errors of positions (0) and velocities (3).
UNITS = {0: "m", 3: "m/s"}
#: Steps in which share and size of outliers are estimated.
MIXTURE_STEPS = 30
#: Median of the absolute value of a standard normal; change of the logarithm of a level at which it is settled.
NORMAL_MEDIAN, SAME_LEVEL = 0.6745, 0.03
#: Parts of a gap between two fixes in which a step may begin.
GAP_PARTS = 20
#: Behind a colour a step shows at its edges only: fixes that surprise most, before which edges are looked for, and fixes to either side of each.
SURPRISES, BESIDE = 16, 2


def multipath_step(
    scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]
) -> list[DriveHypothesis]:
    """Scan start and duration of a step in the position fixes, on each axis; refined around the best.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    data : Field
        The innovations of the rows that are looked at.
    rows : (r,) array of bool, or slice
        Which rows of the recording's field these are.
    given : sequence of Block
        What is explained already.

    Returns
    -------
    list of DriveHypothesis
        One, or none where there are fewer than four times at which a step may start.
    """
    if scene.starts.size < 4:
        return []
    step = _step_anywhere(scene, data, rows, given)
    at_edges = _step_at_edges(scene, data, rows, given) if scene.noise is not None else None
    return [step if at_edges is None or step.nats > at_edges.nats else at_edges]


def _lasting(scene: Scene, rows: NDArray[np.bool_] | slice) -> tuple[float, float]:
    """Durations of the shortest and the longest step among the fixes that are looked at, s."""
    t = scene.prepared.result.fixes.t
    seen = t if isinstance(rows, slice) else t[t <= scene.rows_t[rows][-1]]
    return rules().shortest_step * float(np.median(np.diff(t))), rules().longest_step * float(seen[-1] - seen[0])


def _step_anywhere(
    scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]
) -> DriveHypothesis:
    """The best step of those that start and end at evenly spaced times, refined around it."""
    s, G, t_fix = scene.starts, scene.step_columns[rows], scene.prepared.result.fixes.t
    lasting = _lasting(scene, rows)
    coarse = _scan_steps(data, G, given, s, lasting)
    nats = log_mean_exp(coarse.logs)
    c, i, j, width = coarse.best
    if coarse.top > -2.0:
        # the scan is coarse: try every start and end near the best with columns of their own
        spacing = float(s[1] - s[0])
        starts = np.unique(np.concatenate([t_fix[np.abs(t_fix - x) <= spacing] for x in (s[i], s[j])]) + 1e-3)[:120]
        if starts.size >= 4:
            columns = scene.whitened(_axis_steps(scene, starts, c))[rows]
            fine = _scan_steps(data, columns, given, starts, lasting, axes=1)
            if fine.top > coarse.top:
                _, i, j, width = fine.best
                when = _when(fine, starts, t_fix, _elsewhere(coarse, s, starts))
                gained = nats + fine.top - coarse.top
                return _step_hypothesis(data, given, gained, c, columns[:, i] - columns[:, j], when, width)
    column = G[:, 3 * i + c] - G[:, 3 * j + c]
    half = 0.6 * float(s[1] - s[0])
    start, duration = float(s[i]), float(s[j] - s[i])
    when = (
        Value("start", start, start - half, start + half, "s"),
        Value("duration", duration, duration - 2.0 * half, duration + 2.0 * half, "s"),
    )
    return _step_hypothesis(data, given, nats, c, column, when, width)


def _step_at_edges(
    scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]
) -> DriveHypothesis | None:
    """The best step between fixes that surprise: evenly spaced times miss the edges, where alone it shows behind a colour."""
    t_fix, use = scene.prepared.result.fixes.t, scene.loop.use.ravel()
    residual, _ = data.residual(given)
    fix, component = (np.repeat(np.arange(t_fix.size), 6)[use][rows], np.tile(np.arange(6), t_fix.size)[use][rows])
    surprise = np.bincount(fix, np.where(component < 3, residual**2, 0.0), t_fix.size)
    top = np.argsort(surprise)[-SURPRISES:, None] - 1 + np.arange(-BESIDE, BESIDE + 1)
    last = int(fix[-1]) if fix.size else 0
    before = np.unique(top[(top >= 0) & (top < last)])
    starts = t_fix[before] + 1e-3
    if starts.size < 4:
        return None
    columns = [scene.whitened(_axis_steps(scene, starts, c))[rows] for c in range(3)]
    scans = [_scan_steps(data, own, given, starts, _lasting(scene, rows), axes=1) for own in columns]
    c = int(np.argmax([scan.top for scan in scans]))
    # all pairs of fixes are as likely as these
    widths, pairs = scans[c].logs.size // max(scans[c].i.size, 1), 0.5 * last * (last - 1)
    nats = float(np.logaddexp.reduce(np.concatenate([scan.logs for scan in scans]))) - math.log(3.0 * widths * pairs)
    _, i, j, width = scans[c].best
    when = _when(scans[c], starts, t_fix)
    return _step_hypothesis(data, given, nats, c, columns[c][:, i] - columns[c][:, j], when, width)


def _axis_steps(scene: Scene, starts: Array, axis: int) -> Array:
    """Responses (f, 6, starts) of steps of one position axis."""
    fixes = scene.loop.result.fixes
    M = np.zeros((len(fixes), 6, starts.size))
    M[:, axis, :] = fixes.t[:, None] > starts[None, :]
    return scene.loop.respond(starts.size, None, M)


@dataclass(frozen=True)
class _Scan:
    """Evidence of steps: of every axis, width of the prior and pair of a start and an end that was tried, and the best of them.

    Parameters
    ----------
    logs : (axes * widths * pairs,) array
    i, j : (pairs,) arrays of int
        Starts and ends.
    top : float
    best : (axis, start, end, width of the prior)
    """

    logs: Array
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    top: float
    best: tuple[int, int, int, float]


def _scan_steps(
    data: Field, G: Array, given: Sequence[Block], s: Array, lasting: tuple[float, float], axes: int = 3
) -> _Scan:
    (shortest, longest), y = lasting, data.y
    scale = EFFECTS["gnss_multipath_step"].scale("value", "gnss")
    cross = None
    if given:
        index, root, L, _ = data._solved(given)
        base = data.G[:, index] @ root
        half = np.linalg.solve(L, (base.T @ G) / data.variance)
        rhs = np.linalg.solve(L, base.T @ y / data.variance)
        cross = (half, rhs)
    b_all = G.T @ y / data.variance
    if cross is not None:
        b_all = b_all - cross[0].T @ cross[1]
    i, j = np.triu_indices(s.size, 1)
    near = (s[j] - s[i] >= shortest) & (s[j] - s[i] <= longest)
    i, j = i[near], j[near]
    if not i.size:
        return _Scan(np.full(1, -math.inf), i, j, -math.inf, (0, 0, 0, 1.0))
    logs, top, best = [], -math.inf, (0, 0, 0, 1.0)
    for c in range(axes):
        at = axes * np.arange(s.size) + c
        A = G[:, at].T @ G[:, at] / data.variance
        if cross is not None:
            A = A - cross[0][:, at].T @ cross[0][:, at]
        d = np.diag(A)
        aw = np.maximum(d[i] + d[j] - 2.0 * A[i, j], 1e-12)
        bw = (b_all[at][i] - b_all[at][j]) ** 2
        for factor in rules().prior_scales:
            prior = (scale * factor) ** 2
            each = 0.5 * bw / (aw + 1.0 / prior) - 0.5 * np.log1p(prior * aw)
            logs.append(each)
            k = int(np.argmax(each))
            if each[k] > top:
                top, best = float(each[k]), (c, int(i[k]), int(j[k]), scale * factor)
    return _Scan(np.concatenate(logs), i, j, top, best)


#: Places (k, 2) of start and end of steps, s, and their evidence (k,).
Elsewhere = tuple[Array, Array]
NOWHERE: Elsewhere = (np.zeros((0, 2)), np.zeros(0))


def _elsewhere(coarse: _Scan, s: Array, starts: Array) -> Elsewhere:
    """Steps of the best axis far from the best one.

    Parameters
    ----------
    coarse : _Scan
        Of all axes.
    s : (n,) array
        Times at which it looked, evenly spaced, s.
    starts : (m,) array
        Times that are looked at more closely.
    """
    c, i, j, _ = coarse.best
    spacing = float(s[1] - s[0])
    logs = np.logaddexp.reduce(coarse.logs.reshape(3, -1, coarse.i.size)[c], axis=0)
    far = (np.abs(s[coarse.i] - s[i]) > spacing) | (np.abs(s[coarse.j] - s[j]) > spacing)
    # a place stands for all closer ones around it
    closer = [max(int(np.count_nonzero(np.abs(starts - s[k]) <= 0.5 * spacing)), 1) for k in (i, j)]
    logs = logs[far] + math.log(closer[0]) + math.log(closer[1])
    return np.stack([s[coarse.i[far]], s[coarse.j[far]]], axis=1), logs


def _when(scan: _Scan, starts: Array, t_fix: Array, elsewhere: Elsewhere = NOWHERE) -> tuple[Value, Value]:
    """Start and duration of a step with their intervals: it began, and ended, anywhere between two fixes, and both gaps may be others.

    Parameters
    ----------
    scan : _Scan
        Of one axis.
    starts : (k,) array
        Times just behind fixes, s.
    t_fix : (f,) array
        Of all fixes, s.
    elsewhere : Elsewhere, optional
        Steps that were looked at less closely.
    """
    after = t_fix[np.minimum(np.searchsorted(t_fix, starts), t_fix.size - 1)]
    gap = np.maximum(after - starts, 0.0)
    places, logs = elsewhere
    pairs = np.concatenate([np.logaddexp.reduce(scan.logs.reshape(-1, scan.i.size), axis=0), logs])
    weight = np.exp(pairs - pairs.max())
    close, far = weight[: scan.i.size], weight[scan.i.size :]
    near = close > 1e-4
    i, j = scan.i[near], scan.j[near]
    inside = (np.arange(GAP_PARTS) + 0.5) / GAP_PARTS
    begins = starts[i, None, None] + gap[i, None, None] * inside[:, None]
    lasts = starts[j, None, None] + gap[j, None, None] * inside - begins
    share = np.concatenate([np.broadcast_to(close[near, None, None] / GAP_PARTS**2, lasts.shape).ravel(), far])
    _, k, m, _ = scan.best
    start = float(starts[k] + 0.5 * gap[k])
    values = []
    for name, best, own, other in (
        ("start", start, np.broadcast_to(begins, lasts.shape), places[:, 0]),
        ("duration", float(starts[m] + 0.5 * gap[m]) - start, lasts, places[:, 1] - places[:, 0]),
    ):
        x = np.concatenate([own.ravel(), other])
        order = np.argsort(x)
        reached = np.cumsum(share[order]) / share.sum()
        low, high = (float(x[order][np.searchsorted(reached, q)]) for q in (0.025, 0.975))
        values.append(Value(name, best, min(low, best), max(high, best), "s"))
    return values[0], values[1]


def _step_hypothesis(
    data: Field, given: Sequence[Block], nats: float, c: int, column: Array, when: tuple[Value, Value], width: float
) -> DriveHypothesis:
    wide = Field(data.y, np.column_stack([data.G, column]), data.variance) if nats > -1.0 else None
    if wide is None:
        return Hypothesis("gnss_multipath_step", nats, (), Change(), "step", "gnss", (NED[c],))
    block: Block = (np.array([data.G.shape[1]]), np.array([[width]]))
    _, mean, covariance = wide.posterior([block, *given])
    m, sd = float(mean[0]), math.sqrt(float(covariance[0, 0]))
    change = Change(window=(c, when[0].value, when[0].value + when[1].value))
    return Hypothesis(
        "gnss_multipath_step", nats, (Value.normal("value", m, sd, "m"), *when), change, "step", "gnss", (NED[c],)
    )


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
        One of :data:`insemu.gap.drive.apart.FIRST`, which says whether it is about positions or velocities.

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
        One of :data:`insemu.gap.drive.apart.FIRST`.

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


def _odds(outliers: DriveHypothesis, v: Array, S: Array) -> Array:
    """Log odds (k,) to be outliers; arguments as those of :func:`mixture`."""
    given = {x.name: x.value for x in outliers.values}
    return log_odds(v, S, given["probability"], np.array([given[f"sigma_{a}"] for a in NED]))


def mixture(outliers: DriveHypothesis, v: Array, S: Array) -> Array:
    """Log densities (k,) of positions or velocities of which a share are outliers, without the constant.

    Parameters
    ----------
    outliers : DriveHypothesis
        From :func:`gnss_outliers`.
    v, S : (k, 3), (k, 3, 3) arrays
        Innovations less what is explained, m or m/s, and their covariances where they are none.
    """
    given = {x.name: x.value for x in outliers.values}
    plain = math.log1p(-given["probability"]) + log_density(v, S)
    return np.asarray(plain + np.logaddexp(0.0, _odds(outliers, v, S)))


@dataclass(frozen=True)
class Separated:
    """Outliers told from the other fixes.

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
    scene: Scene, outliers: DriveHypothesis, cut: float | None, seen: Scene, nu: Array, level: float | None = None
) -> Separated:
    """Which positions or velocities are outliers, and how many and how large they are, as a filter sees them that does not follow them.

    The filter that named them was led astray by each, and took fixes after it for outliers too. It runs again without those, and looks at all.
    Under a colour, which it would follow, the filter on its error does that.

    Parameters
    ----------
    scene : Scene
        The recording with its responses, the fixes at the levels that they have but for the outliers.
    outliers : DriveHypothesis
        From :func:`gnss_outliers`.
    cut : float or None
        Share and size are estimated on the fixes up to this time (s); ``None``: on all.
    seen : Scene
        In which the outliers were named.
    nu : (f, 6) array
        Innovations there less what is explained already, m and m/s.
    level : float, optional
        A level of them over that of the scene which was named before the outliers: it may have stood for them, and is estimated with them.
        Outliers told at the nominal level would be every large error, and those left be such as follow the errors before.
    """
    effect = outliers.effect
    at, v, S = whole_innovations(seen, nu, None, effect)
    gone = scene.prepared.result.fixes.t[at][_odds(outliers, v, S) > 0.0]
    now = 1.0 if level is None else level
    for _ in range(MOST_ROUNDS):
        look = _look(scene, effect, now) if scene.noise is None else under_colour(scene.surrogate, scene.noise, nu)
        sigma = np.array([x.value for x in outliers.values if x.name.startswith("sigma_")])
        t, v, S = look({effect: (gone, sigma)})[effect]
        early = slice(None) if cut is None else slice(int(np.searchsorted(t, cut, side="right")))
        outliers = _share_and_size(outliers, v[early], S[early])
        before, gone = gone, t[_odds(outliers, v, S) > 0.0]
        scatter = 1.0
        if level is not None:
            # the median hardly sees the outliers
            y = v[early] / np.sqrt(np.einsum("kii->ki", S[early]))
            scatter = float(np.median(np.abs(y))) / NORMAL_MEDIAN
            now *= scatter
        if np.array_equal(before, gone) and abs(math.log(scatter)) < SAME_LEVEL:
            break
    return Separated(gone, outliers, now)


def _look(scene: Scene, effect: str, level: float) -> Seen:
    """The positions or velocities of a scene as its filter sees them at a level over the scene's."""
    prepared = scene.prepared
    stated = scaled_fixes(
        prepared.gnss, prepared.factors * np.where(np.arange(6) // 3 == FIRST[effect] // 3, level, 1.0)
    )
    return by_filter(lambda gnss: prepared.again(gnss=gnss, factors=np.ones(6)).result, stated)


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
        found = [] if "gnss_noise_level" in skip else level_beside(surrogate, scene.noise, moved)
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
        sigma, tau = joint.noise.colour
        told = {**dict(zip((f"sigma_{a}" for a in NED), sigma, strict=False)), "tau": tau}
        return replace(
            h, values=tuple(Value.positive(v.name, told[v.name], joint.sd[v.name], v.unit) for v in h.values)
        )
    return at_level(h, scene.original.factors * joint.noise.factor)


def about(level: DriveHypothesis) -> NDArray[np.bool_]:
    """Components (6,) of the fixes that a level is about; none of anything else."""
    first = LEVEL_ROWS.get(level.effect, 6)
    return np.isin(np.arange(6), [first + NED.index(a) for a in level.axes if a in NED])


def apart_from_named(scene: Scene, level: DriveHypothesis | None) -> Array:
    """By what the filter's levels (6,) were moved, as ratios to the stated one of a level that is in question and to the other named ones."""
    at = scene.original
    return at.factors / np.where(about(level) if level is not None else False, 1.0, at.levels)


def at_level(h: DriveHypothesis, factors: Array) -> DriveHypothesis:
    """A level of the fixes at what the standard deviations of the fixes (6,) were found to be over the stated ones; anything else as it is."""
    if not (own := about(h)).any():
        return h
    (level,) = h.values
    grown = float(np.exp(np.mean(np.log(factors[own])))) / level.value
    value = replace(level, value=grown * level.value, low=grown * level.low, high=grown * level.high)
    return replace(h, values=(value,))


def placed(step: DriveHypothesis, column: int) -> DriveHypothesis:
    """A step in the fixes as a column of the scene."""
    block: Block = (np.array([column]), np.array([[3.0 * abs(step.values[0].value)]]))
    return replace(step, what=replace(step.change, block=block))
