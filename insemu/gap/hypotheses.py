"""Every effect that the innovations of a drive or flight can show, weighed in one currency beside what is explained already."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS
from insemu.gap.evidence import LEVEL_UNCERTAINTY, PRIOR_SCALES, log_mean_exp
from insemu.gap.innovations import (
    Block,
    Field,
    flicker_root,
    gauss_markov_root,
    log_mean_exp_columns,
    quadratic_evidence,
    random_walk_root,
)
from insemu.gap.scene import Scene
from insemu.gap.signatures import Column, Loop
from insemu.gap.surrogate import NED, NoiseFit, gnss_noise_fits, pooled
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: Prior amplitudes of slow processes, in units of the datasheet's scale.
AMPLITUDES = np.geomspace(1e-3, 3000.0, 40)
#: Effects of one number that only one description can have.
ONCE = ("imu_gnss_time_offset", "clock_drift", "gravity", "earth_rate", "transport_rate")
#: Fewest fixes that a step in them lasts; a shorter one is an outlier.
SHORTEST_STEP = 2.5
#: What more axes of one effect must be worth over fewer, nats.
PARSIMONY = 2.0
PROCESSES = {"random_walk": "K", "gauss_markov": "sigma", "flicker": "B"}
#: Prior scales of structure outside the catalogue, for which no datasheet says how large it may be.
LIBRARY_SCALES = (*PRIOR_SCALES, 30.0, 100.0, 300.0)
_SENSORS = (("gyro", 0), ("accel", 3))
#: A level is estimated together with a colour, not beside it.
_LEVELS = ("gnss_noise_level", "gnss_velocity_noise")


@dataclass(frozen=True)
class Variant:
    """One way in which an effect may be present: columns, unit roots of its coefficients' prior, and amplitudes of that prior.

    ``process`` says that the amplitude itself is the parameter and not the coefficients.
    """

    effect: str
    sensor: str
    axes: tuple[str, ...]
    label: str
    index: NDArray[Any]
    shapes: tuple[tuple[tuple[float, ...], Array], ...]
    amplitudes: Array
    process: bool = False


@dataclass(frozen=True)
class Hypothesis:
    """An effect, weighed.

    Parameters
    ----------
    gain : float
        Evidence averaged over the ways in which it may be present.
    values : tuple of Value
    block : Block, optional
        How it enters the linear model of the innovations.
    noise : NoiseFit, optional
        How it changes the covariance of the fixes.
    columns : tuple of int
        Columns of the scene whose coefficients are its parameters.
    """

    effect: str
    sensor: str
    axes: tuple[str, ...]
    gain: float
    values: tuple[Value, ...]
    block: Block | None = None
    variant: str = ""
    noise: NoiseFit | None = None
    columns: tuple[int, ...] = ()


#: Sizes of shapes and of slopes that are tried, in the datasheet's. What a fix can see of a slope or a slow process is far above it, and a random
#: walk of any size follows a slope.
SIZES = (*PRIOR_SCALES, 30.0, 100.0)
SLOPES = (*SIZES, 300.0, 1000.0)


def bank(scene: Scene) -> list[Variant]:
    """All variants of deterministic, timing, lever-arm, model and slow effects."""
    return _shapes(scene.columns[: scene.catalogue]) + _slow(scene)


def _shapes(columns: Sequence[Column]) -> list[Variant]:
    out: list[Variant] = []
    amplitudes = np.array(SIZES)
    for key in dict.fromkeys((c.effect, c.sensor) for c in columns):
        mine = [i for i, c in enumerate(columns) if (c.effect, c.sensor) == key]
        sets: list[tuple[tuple[str, ...], str, list[int]]] = []
        if key[0] == "temperature":
            for axis in "xyz":
                own = [i for i in mine if columns[i].axes == (axis,)]
                sets += [((axis,), "linear", own[:1]), ((axis,), "cubic", own)]
            sets.append((("x", "y", "z"), "linear", [i for i in mine if columns[i].label.startswith("c1")]))
        else:
            sets += [(columns[i].axes, "", [i]) for i in mine]
            if len(mine) > 1:
                if key[0] == "g_sensitivity":
                    diagonal = [i for i in mine if columns[i].label[-1] == columns[i].label[-2]]
                    sets.append((("x", "y", "z"), "diagonal", diagonal))
                axes = tuple(dict.fromkeys(a for i in mine for a in columns[i].axes))
                sets.append((axes, "all", mine))
        for axes, label, members in sets:
            if members:
                unit = np.diag([columns[i].scale for i in members])
                out.append(Variant(*key, axes, label, np.array(members), (((), unit),), amplitudes))
    return out


def _slow(scene: Scene) -> list[Variant]:
    t = scene.knots
    span, spacing = float(t[-1] - t[0]), float(t[1] - t[0])
    roots: dict[str, list[tuple[tuple[float, ...], Array]]] = {
        "random_walk": [((), random_walk_root(t))],
        "gauss_markov": [
            ((1.0 / tau,), gauss_markov_root(t, tau)) for tau in np.geomspace(1.5 * spacing, 0.6 * span, 5)
        ],
        "flicker": [((), flicker_root(t))],
    }
    out: list[Variant] = []
    for effect, shapes in roots.items():
        for sensor, first in _SENSORS:
            amplitudes = EFFECTS[effect].scale(PROCESSES[effect], sensor) * AMPLITUDES
            for axis in range(3):
                out.append(
                    Variant(
                        effect, sensor, ("xyz"[axis],), "", scene.slow(first + axis), tuple(shapes), amplitudes, True
                    )
                )
            three = tuple((p, np.asarray(np.kron(np.eye(3), root), dtype=np.float64)) for p, root in shapes[::2])
            out.append(
                Variant(effect, sensor, ("x", "y", "z"), "all", scene.slow(first, 3), three, amplitudes[::2], True)
            )
    for sensor, first in _SENSORS:
        unit = (t - t[0])[:, None] * EFFECTS["ramp"].scale("R", sensor)
        for axis in range(3):
            out.append(
                Variant("ramp", sensor, ("xyz"[axis],), "", scene.slow(first + axis), (((), unit),), np.array(SLOPES))
            )
    return out


def linear_gains(variants: Sequence[Variant], A: Array, b: Array) -> list[list[Array]]:
    """Log Bayes factors of every variant: per variant and shape ``(a, s)``; wide sets of axes only where a single one promises something."""
    out: list[list[Array]] = []
    promising: dict[tuple[str, str], float] = {}
    for v in variants:
        key = (v.effect, v.sensor)
        if (v.process and len(v.axes) == 3 and b.shape[1] > 1) or (
            v.process and len(v.axes) == 3 and promising.get(key, 0.0) < 1.0
        ):
            out.append([])
            continue
        sub, rhs = A[np.ix_(v.index, v.index)], b[v.index]
        logs = [quadratic_evidence(sub, rhs, root, v.amplitudes) for _, root in v.shapes]
        promising[key] = max(promising.get(key, -math.inf), max(float(x[:, 0].max()) for x in logs))
        out.append(logs)
    return out


def pooled_gains(variants: Sequence[Variant], logs: Sequence[Sequence[Array]]) -> dict[tuple[str, str], Array]:
    """Evidence of every effect and sensor, averaged over its variants, shapes and amplitudes: (s,) per effect."""
    own: dict[tuple[str, str], list[Array]] = {}
    passed: dict[tuple[str, str], int] = {}
    for v, x in zip(variants, logs, strict=True):
        key = (v.effect, v.sensor)
        if x:
            own.setdefault(key, []).append(log_mean_exp_columns(np.concatenate(x)))
        else:
            passed[key] = passed.get(key, 0) + 1
    out = {}
    for key, rows in own.items():
        # a variant that was passed over counts as one that explains nothing
        share = len(rows) / (len(rows) + passed.get(key, 0))
        out[key] = log_mean_exp_columns(np.stack(rows)) + math.log(share)
    return out


def linear_hypotheses(
    scene: Scene, variants: Sequence[Variant], data: Field, given: Sequence[Block], skip: Collection[str]
) -> list[Hypothesis]:
    """Weigh every variant and report the best of each effect and sensor."""
    variants = [v for v in variants if v.effect not in skip]
    A, b = data.conditioned(given)
    logs = linear_gains(variants, A, b)
    gains = pooled_gains(variants, logs)
    tried: dict[tuple[str, str], list[tuple[float, Variant, list[Array]]]] = {}
    for v, x in zip(variants, logs, strict=True):
        if x:
            own = float(log_mean_exp_columns(np.concatenate(x))[0])
            tried.setdefault((v.effect, v.sensor), []).append((own, v, x))
    best = {}
    for key, mine in tried.items():
        # an axis is named where the innovations speak for it, not where they hardly see it
        top = max(own for own, _, _ in mine)
        best[key] = min((m for m in mine if m[0] > top - PARSIMONY), key=lambda m: (len(m[1].axes), -m[0]))
    return [
        _described(scene, data, given, v, x, float(gains[key][0]))
        for key, (_, v, x) in best.items()
        if math.isfinite(float(gains[key][0]))
    ]


def _described(
    scene: Scene, data: Field, given: Sequence[Block], v: Variant, logs: Sequence[Array], gain: float
) -> Hypothesis:
    """The best shape and amplitude of a variant with its parameters."""
    table = np.stack([x[:, 0] for x in logs])
    i, j = np.unravel_index(int(np.argmax(table)), table.shape)
    root = v.shapes[int(i)][1] * v.amplitudes[int(j)]
    block: Block = (v.index, root)
    if gain < -1.0:
        return Hypothesis(v.effect, v.sensor, v.axes, gain, (), block, v.label)
    effect = EFFECTS[v.effect]
    if v.process:
        p = np.exp(table - table.max())
        p /= p.sum()
        grid = np.log(np.array([[(a, *shape) for a in v.amplitudes] for shape, _ in v.shapes]))
        mean = np.einsum("ij,ijk->k", p, grid)
        sd = np.sqrt(np.einsum("ij,ijk->k", p, (grid - mean) ** 2))
        floor = 0.5 * math.log(v.amplitudes[1] / v.amplitudes[0])
        values = tuple(
            Value(
                q.name,
                math.exp(m),
                math.exp(m - 1.96 * max(s, floor)),
                math.exp(m + 1.96 * max(s, floor)),
                effect.unit(q.name, v.sensor),
            )
            for q, m, s in zip(effect.parameters, mean, sd, strict=False)
        )
        return Hypothesis(v.effect, v.sensor, v.axes, gain, values, block, v.label)
    _, mean, covariance = data.posterior([block, *given])
    n = v.index.size
    if v.effect == "ramp":
        span = float(scene.knots[-1] - scene.knots[0])
        m, s = float(mean[n - 1]) / span, math.sqrt(float(covariance[n - 1, n - 1])) / span
        values = (Value("R", m, m - 1.96 * s, m + 1.96 * s, effect.unit("R", v.sensor)),)
        return Hypothesis(v.effect, v.sensor, v.axes, gain, values, block, v.label)
    values = shape_values(scene, v.index, mean[:n], covariance[:n, :n])
    return Hypothesis(v.effect, v.sensor, v.axes, gain, values, block, v.label, columns=tuple(int(c) for c in v.index))


def shape_values(scene: Scene, index: NDArray[Any], mean: Array, covariance: Array) -> tuple[Value, ...]:
    """Coefficients of columns as values with intervals."""
    out = []
    for k, i in enumerate(index):
        c, m, s = scene.columns[int(i)], float(mean[k]), math.sqrt(max(float(covariance[k, k]), 0.0))
        out.append(Value(c.label, m, m - 1.96 * s, m + 1.96 * s, c.unit))
    return tuple(out)


def best_pair(variants: Sequence[Variant], A: Array, b: Array) -> tuple[float, Block, Block]:
    """The two single columns that explain most together: log Bayes factor over a grid of prior scales, and their blocks.

    Two shapes that nearly cancel are worth little one by one.

    Parameters
    ----------
    variants : sequence of Variant
        Of one column each.
    A : (c, c) array
        Normal matrix of all columns.
    b : (c,) array
        Right-hand side.
    """
    at = np.array([int(v.index[0]) for v in variants])
    unit = np.array([float(v.shapes[0][1][0, 0]) for v in variants])
    A, b = A[np.ix_(at, at)], b[at]
    i, j = np.triu_indices(at.size, 1)
    logs = []
    grid = [(p, q) for p in PRIOR_SCALES for q in PRIOR_SCALES]
    for p, q in grid:
        d, e = p * unit[i], q * unit[j]
        first, second, cross = 1.0 + d**2 * A[i, i], 1.0 + e**2 * A[j, j], d * e * A[i, j]
        det = first * second - cross**2
        u, v = d * b[i], e * b[j]
        logs.append(0.5 * (u**2 * second - 2.0 * u * v * cross + v**2 * first) / det - 0.5 * np.log(det))
    table = np.stack(logs)
    pooled = log_mean_exp_columns(table)
    k = int(np.argmax(pooled))
    p, q = grid[int(np.argmax(table[:, k]))]
    blocks = [(at[[m]], np.array([[c * unit[m]]])) for m, c in ((i[k], p), (j[k], q))]
    return float(pooled[k]), blocks[0], blocks[1]


def null_threshold(
    variants: Sequence[Variant],
    data: Field,
    rng: np.random.Generator,
    share: float = 0.02,
    draws: int = 300,
    *,
    always: Sequence[Block] = (),
) -> float:
    """Evidence that the best effect exceeds in ``share`` of simulated nominal recordings: the filter's own responses, drawn innovations.

    ``always`` is what is uncertain in a nominal recording too; it is drawn as well and then allowed for.
    """
    z = rng.standard_normal((data.y.size, draws))
    b = data.G.T @ z / math.sqrt(data.variance)
    for index, root in always:
        b += data.A[:, index] @ root @ rng.standard_normal((root.shape[1], draws))
    A, b = data.conditioned(always, b)
    b = b[:, 1:]
    # the first column decides what is worth a closer look, as it does for the measured innovations
    gains = pooled_gains(variants, linear_gains(variants, A, b))
    return float(np.quantile(np.max(np.stack(list(gains.values())), axis=0), 1.0 - share))


# -- steps, levels, colour and outliers of the fixes ----------------------------------------------------------------------------------


def multipath_step(
    scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]
) -> list[Hypothesis]:
    """Scan start and duration of a step in the position fixes, on each axis; refined around the best."""
    s = scene.starts
    if s.size < 4:
        return []
    G = scene.step_columns[rows]
    scale = EFFECTS["gnss_multipath_step"].scale("value", "gnss")
    t_fix = scene.prepared.result.fixes.t
    shortest = SHORTEST_STEP * float(np.median(np.diff(t_fix)))
    logs, best = _scan_steps(data, G, given, s, scale, shortest)
    gain = log_mean_exp(logs)
    fine = None
    top, c, i0, j0, width = best
    if gain > -2.0:
        # the scan is coarse: try every start and end near the best with columns of their own
        spacing = float(s[1] - s[0])
        near = np.concatenate([t_fix[np.abs(t_fix - x) <= spacing] for x in (s[i0], s[j0])]) + 1e-3
        starts = np.unique(near)[:120]
        if starts.size >= 4:
            fine = _scan_steps(
                data, scene.whitened(_axis_steps(scene, starts, c))[rows], given, starts, scale, shortest, axes=1
            )
            if fine[1][0] > top:
                gain += fine[1][0] - top
                _, _, i0, j0, width = fine[1]
                s, G = starts, scene.whitened(_axis_steps(scene, starts, c))[rows]
                column = G[:, i0] - G[:, j0]
                return [_step_hypothesis(data, given, gain, c, column, s, i0, j0, width)]
    column = G[:, 3 * i0 + c] - G[:, 3 * j0 + c]
    return [_step_hypothesis(data, given, gain, c, column, s, i0, j0, width)]


def _axis_steps(scene: Scene, starts: Array, axis: int) -> Array:
    """Responses (f, 6, starts) of steps of one position axis."""
    fixes = scene.loop.result.fixes
    M = np.zeros((len(fixes), 6, starts.size))
    M[:, axis, :] = fixes.t[:, None] > starts[None, :]
    return scene.loop.respond(starts.size, None, M)


_Scan = tuple[Array, tuple[float, int, int, int, float]]


def _scan_steps(
    data: Field, G: Array, given: Sequence[Block], s: Array, scale: float, shortest: float, axes: int = 3
) -> _Scan:
    y = data.y
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
    near = s[j] - s[i] >= shortest
    if axes == 3:
        near &= s[j] - s[i] <= (s[-1] - s[0]) / 2.5
    i, j = i[near], j[near]
    if not i.size:
        return np.full(1, -math.inf), (-math.inf, 0, 0, 0, 1.0)
    logs = []
    best: tuple[float, int, int, int, float] = (-math.inf, 0, 0, 0, 1.0)
    for c in range(axes):
        at = axes * np.arange(s.size) + c
        A = G[:, at].T @ G[:, at] / data.variance
        if cross is not None:
            A = A - cross[0][:, at].T @ cross[0][:, at]
        d = np.diag(A)
        aw = np.maximum(d[i] + d[j] - 2.0 * A[i, j], 1e-12)
        bw = (b_all[at][i] - b_all[at][j]) ** 2
        for factor in PRIOR_SCALES:
            prior = (scale * factor) ** 2
            each = 0.5 * bw / (aw + 1.0 / prior) - 0.5 * np.log1p(prior * aw)
            logs.append(each)
            k = int(np.argmax(each))
            if each[k] > best[0]:
                best = (float(each[k]), c, int(i[k]), int(j[k]), scale * factor)
    return np.concatenate(logs), best


def _step_hypothesis(
    data: Field, given: Sequence[Block], gain: float, c: int, column: Array, s: Array, i0: int, j0: int, width: float
) -> Hypothesis:
    wide = Field(data.y, np.column_stack([data.G, column]), data.variance) if gain > -1.0 else None
    if wide is None:
        return Hypothesis("gnss_multipath_step", "gnss", (NED[c],), gain, ())
    block: Block = (np.array([data.G.shape[1]]), np.array([[width]]))
    _, mean, covariance = wide.posterior([block, *given])
    m, sd = float(mean[0]), math.sqrt(float(covariance[0, 0]))
    half = 0.6 * float(s[1] - s[0])
    start, duration = float(s[i0]), float(s[j0] - s[i0])
    values = (
        Value("value", m, m - 1.96 * sd, m + 1.96 * sd, "m"),
        Value("start", start, start - half, start + half, "s"),
        Value("duration", duration, duration - 2 * half, duration + 2 * half, "s"),
    )
    return Hypothesis("gnss_multipath_step", "gnss", (NED[c],), gain, values, variant="step")


def gaussian(v: Array, S: Array) -> Array:
    """Log densities of rows of ``v`` (k, c) without the constant."""
    L = np.linalg.cholesky(S)
    z = np.linalg.solve(L, v[:, :, None])[:, :, 0]
    return np.asarray(-0.5 * np.einsum("ki,ki->k", z, z) - np.sum(np.log(np.einsum("kii->ki", L)), axis=1))


def position_innovations(scene: Scene, nu: Array, cut: float | None) -> tuple[NDArray[np.int64], Array, Array]:
    """Fixes with a whole position, their innovations (k, 3) and covariances (k, 3, 3)."""
    fixes = scene.prepared.result.fixes
    there = scene.loop.use[:, :3].all(axis=1)
    if cut is not None:
        there = there & (fixes.t <= cut)
    at = np.flatnonzero(there)
    return at, nu[at][:, :3], fixes.S[at][:, :3, :3]


def gnss_outliers(scene: Scene, nu: Array, cut: float | None) -> list[Hypothesis]:
    """A small share of position fixes with a much larger spread."""
    at, v, S = position_innovations(scene, nu, cut)
    if at.size < 30:
        return []
    plain = gaussian(v, S)
    sigma0 = np.sqrt(np.median(np.einsum("kii->ki", S), axis=0))
    logs, grid = [], []
    for ratio in np.geomspace(3.0, 300.0, 10):
        wide = gaussian(v, S + np.diag((ratio * sigma0) ** 2))
        for p in np.geomspace(1.0 / at.size, 0.1, 8):
            logs.append(float(np.sum(np.logaddexp(math.log1p(-p) + plain, math.log(p) + wide) - plain)))
            grid.append((p, ratio))
    p, ratio = grid[int(np.argmax(logs))]
    gain = log_mean_exp(logs)
    count = max(1.0, p * at.size)
    spread = 1.5 / math.sqrt(count)
    values: tuple[Value, ...] = (
        Value("probability", p, p * math.exp(-2.0 / math.sqrt(count)), p * math.exp(2.0 / math.sqrt(count)), "1"),
    )
    values += tuple(
        Value(f"sigma_{a}", float(ratio * s), float(ratio * s) / (1.0 + spread), float(ratio * s) * (1.0 + spread), "m")
        for a, s in zip(NED, sigma0, strict=True)
    )
    return [Hypothesis("gnss_outliers", "gnss", NED, gain, values)]


def wild_fixes(scene: Scene, outliers: Hypothesis, nu: Array) -> tuple[Array, Array]:
    """Times of the fixes that are more likely outliers than not, and the log density that each has as one."""
    given = {v.name: v.value for v in outliers.values}
    at, v, S = position_innovations(scene, nu, None)
    p = given["probability"]
    added = np.diag([given[f"sigma_{a}"] ** 2 for a in NED])
    wide = gaussian(v, S + added)
    odds = math.log(p / (1.0 - p)) + wide - gaussian(v, S)
    return np.asarray(scene.prepared.result.fixes.t[at[odds > 0.0]]), math.log(p) + wide[odds > 0.0]


def unexplained_innovations(scene: Scene, blocks: Sequence[Block]) -> Array:
    """Innovations (f, 6) in m and m/s less what blocks explain."""
    nu = np.where(scene.surrogate.use == 1, scene.surrogate.nu, 0.0)
    if scene.noise is not None:
        return nu
    explained = scene.explained(blocks)
    if explained is None:
        return nu
    return np.asarray(nu - np.einsum("kij,kj->ki", scene.loop.lower, explained))


def covariance_hypotheses(
    scene: Scene, given: Sequence[Block], skip: Collection[str], cut: float | None
) -> list[Hypothesis]:
    """Weigh levels, colour and outliers of the fixes on the innovations less what is already explained."""
    nu = unexplained_innovations(scene, given)
    surrogate = replace(scene.surrogate, nu=nu)
    if cut is not None:
        surrogate = surrogate.until(cut)
    k = surrogate.t.size
    loop: Loop = scene.loop
    y = np.einsum("kij,kj->ki", loop.white[:k], surrogate.nu)
    colour = scene.noise.colour if scene.noise is not None else None
    base = surrogate.log_likelihood(scene.noise.factor if scene.noise is not None else None, colour)
    fits: dict[str, list[NoiseFit]] = {}
    for fit in gnss_noise_fits(
        surrogate,
        base,
        loop.white[:k],
        y,
        trimmed=scene.original.factors / scene.original.levels,
        uncertainty=LEVEL_UNCERTAINTY,
        colour=colour,
        skip=(*skip, *(_LEVELS if colour is not None else ())),
    ):
        fits.setdefault(fit.effect, []).append(fit)
    out = []
    for effect, tried in fits.items():
        top = max(tried, key=lambda f: f.gain)
        values = tuple(Value(*v) for v in top.values)
        out.append(Hypothesis(effect, "gnss", top.axes, pooled(tried), values, noise=top))
    if "gnss_outliers" not in skip and scene.noise is None:
        out += gnss_outliers(scene, nu, cut)
    return out


def library_gain(scene: Scene, data: Field, given: Sequence[Block]) -> tuple[float, str]:
    """The best structure outside the catalogue, those of a sensor counted alike."""
    A, b = data.conditioned(given)
    found: dict[str, list[tuple[float, str]]] = {}
    amplitudes = np.array(LIBRARY_SCALES)
    for i, c in enumerate(scene.columns[scene.outside], start=scene.outside.start):
        logs = quadratic_evidence(A[i : i + 1, i : i + 1], b[i : i + 1], np.array([[c.scale]]), amplitudes)
        found.setdefault(c.sensor, []).append((log_mean_exp(logs[:, 0]), f"{c.sensor} error that goes with {c.label}"))
    best = (-math.inf, "")
    for group in found.values():
        top = max(group)
        best = max(best, (log_mean_exp([g for g, _ in group]), top[1]))
    return best
