"""Every effect that the innovations of a drive or flight can show, weighed in one currency next to what is explained already."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, REFERENCE_DEGC, Column, having, lagged
from insemu.gap.drive.scene import Scene, Window
from insemu.gap.drive.sizes import known_size
from insemu.gap.evidence.fixes import NoiseFit
from insemu.gap.evidence.linear import (
    Block,
    Field,
    flicker_root,
    gauss_markov_root,
    log_mean_exp_columns,
    marginal,
    quadratic_evidence,
    random_walk_root,
)
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.sample_times import beat

Array = NDArray[np.float64]

#: Amplitudes of slow processes that are tried.
AMPLITUDES = 40
#: Variant of a thermal bias that follows the temperature late, and the time constants of it that are tried.
LAGGED, LAGS = "lagged", 16
#: Effects of one number that only one description can have.
ONCE = having("once")
_OF_SENSORS = frozenset(e.id for e in EFFECTS.values() if e.family == "deterministic")
_SECOND_ORDER = having("second_order")
#: Effects without a name: rarer by what a name must lead by.
EQUATIONS = having("equation")
#: Effects whose columns have no negative sizes.
POSITIVE = frozenset(e.id for e in EFFECTS.values() if e.size and e.does("columns") and e.parameter(e.size).positive)
#: Slow random processes, and the parameter that is their size.
PROCESSES = {e.id: e.size for e in EFFECTS.values() if "process" in e.traits}
_SENSORS = (("gyro", 0), ("accel", 3))


@dataclass(frozen=True)
class Variant:
    """One way in which an effect may be present: columns, unit roots of its coefficients' prior, and amplitudes of that prior.

    ``process`` says that the amplitude itself is the parameter and not the coefficients; ``odds`` how common it is next to a plain way.
    """

    effect: str
    sensor: str
    axes: tuple[str, ...]
    label: str
    index: NDArray[Any]
    shapes: tuple[tuple[tuple[float, ...], Array], ...]
    amplitudes: Array
    process: bool = False
    odds: float = 1.0

    def evidence(self, logs: Sequence[Array]) -> Array:
        """Evidence (s,) averaged over shapes and amplitudes, times its odds."""
        return log_mean_exp_columns(np.concatenate(logs)) + math.log(self.odds)


@dataclass(frozen=True)
class Change:
    """How an effect changes the model of a drive or flight.

    Parameters
    ----------
    block : Block, optional
        How it enters the linear model of the innovations.
    columns : tuple of int
        Columns of the scene whose coefficients are its parameters.
    noise : NoiseFit, optional
        How it changes the covariance of the fixes.
    window : Window, optional
        Axis, start and end of a step in the position fixes.
    """

    block: Block | None = None
    columns: tuple[int, ...] = ()
    noise: NoiseFit | None = None
    window: Window | None = None


DriveHypothesis = Hypothesis[Change]


def sizes(effect: str = "") -> tuple[float, ...]:
    """Sizes that are tried of an effect of known shape, in the datasheet's."""
    far = () if effect in _OF_SENSORS else rules().far_scales
    return (*rules().prior_scales, *rules().wider_scales, *far)


def bank(scene: Scene) -> list[Variant]:
    """All variants of deterministic, timing, lever-arm, model and slow effects."""
    return _shapes(scene.columns[: scene.catalogue]) + _slow(scene) + _late(scene)


def _shapes(columns: Sequence[Column]) -> list[Variant]:
    out: list[Variant] = []
    for key in dict.fromkeys((c.effect, c.sensor) for c in columns):
        mine = [i for i, c in enumerate(columns) if (c.effect, c.sensor) == key]
        for axes, label, members in EFFECTS[key[0]].subsets([columns[i] for i in mine]):
            if members:
                index = np.array(mine)[members]
                unit = np.diag([columns[i].scale for i in index])
                odds = math.prod(EFFECTS[key[0]].odds(columns[i]) for i in index)
                out.append(Variant(*key, axes, label, index, (((), unit),), np.array(sizes(key[0])), odds=odds))
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
            amplitudes = EFFECTS[effect].scale(PROCESSES[effect], sensor) * np.geomspace(
                *rules().slow_amplitudes, AMPLITUDES
            )
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
                Variant(
                    "ramp",
                    sensor,
                    ("xyz"[axis],),
                    "",
                    scene.slow(first + axis),
                    (((), unit),),
                    np.array((*sizes(), *rules().widest_scales)),
                )
            )
    return out


def _late(scene: Scene) -> list[Variant]:
    """A bias of each axis that follows the temperature late: as slow as the time constant, so that knots hold it."""
    motion, t, effect = scene.motion, scene.knots, EFFECTS["temperature"]
    shortest, longest = float(t[1] - t[0]), rules().longest_lag * float(t[-1] - t[0])
    if motion.warmth is None or not longest > shortest:
        return []
    dt = beat(motion.t)
    linear, _, late_ones, _ = rules().thermal_odds
    odds = late_ones / linear
    shapes: list[tuple[tuple[float, ...], Array]] = []
    for lag in np.geomspace(shortest, longest, LAGS):
        seen = np.interp(t, motion.t, lagged(motion.warmth, dt, float(lag))) - REFERENCE_DEGC
        shapes.append(((float(lag),), seen[:, None]))
    return [
        Variant(
            effect.id, sensor, ("xyz"[axis],), LAGGED, scene.slow(first + axis),
            tuple((p, effect.scale("c1", sensor) * unit) for p, unit in shapes), np.array(sizes(effect.id)), odds=odds,
        )
        for sensor, first in _SENSORS
        for axis in range(3)
    ]  # fmt: skip


def compatible(variants: Sequence[Variant], chosen: Sequence[DriveHypothesis]) -> list[Variant]:
    """Variants that may stand next to what was chosen: an axis has one thermal bias where it has a lag.

    Parameters
    ----------
    variants : sequence of Variant
    chosen : sequence of DriveHypothesis
    """
    thermal = [h for h in chosen if h.effect == "temperature"]
    taken = {(h.sensor, a) for h in thermal for a in h.axes}
    late = {(h.sensor, a) for h in thermal if h.variant == LAGGED for a in h.axes}

    def bars(v: Variant) -> bool:
        own = {(v.sensor, a) for a in v.axes}
        return v.effect == "temperature" and bool(own & (taken if v.label == LAGGED else late))

    return [v for v in variants if not bars(v)]


def linear_evidence(variants: Sequence[Variant], A: Array, b: Array) -> list[list[Array]]:
    """Log Bayes factors of every variant: per variant and shape ``(a, s)``; wide sets of axes only where a single one promises something.

    Parameters
    ----------
    variants : sequence of Variant
        The ways in which effects may be present.
    A : (c, c) array
        Normal matrix of all columns.
    b : (c, s) array
        Right-hand sides: of the measured innovations first, then of simulated ones.

    Returns
    -------
    list of list of (a, s) array
        In the order of the variants, ``a`` amplitudes of the prior; empty for a variant that was not weighed.
    """
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


def pooled_evidence(variants: Sequence[Variant], logs: Sequence[Sequence[Array]]) -> dict[tuple[str, str], Array]:
    """Evidence of every effect and sensor, averaged over its variants, shapes and amplitudes: (s,) per effect."""
    own: dict[tuple[str, str], list[Array]] = {}
    total: dict[tuple[str, str], float] = {}
    for v, x in zip(variants, logs, strict=True):
        key = (v.effect, v.sensor)
        # a variant that was passed over counts as one that explains nothing
        total[key] = total.get(key, 0.0) + v.odds
        if x:
            own.setdefault(key, []).append(v.evidence(x))
    out = {}
    for key, rows in own.items():
        rarer = rules().lead if key[0] in EQUATIONS else rules().second_order if key[0] in _SECOND_ORDER else 0.0
        out[key] = log_mean_exp_columns(np.stack(rows)) + math.log(len(rows) / total[key]) - rarer
    return out


def linear_hypotheses(
    scene: Scene, variants: Sequence[Variant], data: Field, given: Sequence[Block], skip: Collection[str]
) -> list[DriveHypothesis]:
    """Weigh every variant and report the best of each effect and sensor.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    variants : sequence of Variant
        The ways in which effects may be present.
    data : Field
        The innovations.
    given : sequence of Block
        What is explained already.
    skip : collection of str
        Effects that are not weighed.
    """
    variants, A, b, logs = _weighed(scene, variants, data, given, skip)
    evidence = pooled_evidence(variants, logs)
    tried: dict[tuple[str, str], list[tuple[float, Variant, list[Array]]]] = {}
    for v, x in zip(variants, logs, strict=True):
        if x:
            own = float(v.evidence(x)[0])
            tried.setdefault((v.effect, v.sensor), []).append((own, v, x))
    best = {}
    for key, mine in tried.items():
        # an axis is named where the innovations speak for it, not where they hardly see it
        top = max(own for own, _, _ in mine)
        best[key] = min((m for m in mine if m[0] > top - rules().keep_nats), key=lambda m: (len(m[1].axes), -m[0]))
    return [
        replace(_described(scene, A, b, v, x, float(evidence[key][0])), places=_places(own, v, tried[key]))
        for key, (own, v, x) in best.items()
        if math.isfinite(float(evidence[key][0]))
    ]


def _places(
    nats: float, chosen: Variant, mine: Sequence[tuple[float, Variant, list[Array]]]
) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Axes on which an effect may be, with the probability of each: those of the chosen variant, and of no wider ones that come near it."""
    near = {chosen.axes: nats}
    for own, v, _ in mine:
        # a cell that shares columns with it, or its axes, is no other place
        if v.axes == chosen.axes or v.index.size > chosen.index.size or np.isin(v.index, chosen.index).any():
            continue
        if own > nats - rules().lead:
            near[v.axes] = max(own, near.get(v.axes, -math.inf))
    if len(near) < 2:
        return ()
    p = np.exp(np.array(list(near.values())) - max(near.values()))
    return tuple(zip(near, (p / p.sum()).tolist(), strict=True))


def linear_nats(
    scene: Scene, variants: Sequence[Variant], data: Field, given: Sequence[Block], skip: Collection[str]
) -> float:
    """What the best of :func:`linear_hypotheses` is worth, nats, without a description of each.

    Parameters
    ----------
    scene, variants, data, given, skip
        As there.
    """
    variants, _, _, logs = _weighed(scene, variants, data, given, skip)
    return max((float(x[0]) for x in pooled_evidence(variants, logs).values()), default=-math.inf)


def _weighed(
    scene: Scene, variants: Sequence[Variant], data: Field, given: Sequence[Block], skip: Collection[str]
) -> tuple[list[Variant], Array, Array, list[list[Array]]]:
    """The variants that are weighed, normal matrix and right-hand side of what is unexplained, and the evidence of each."""
    variants = [v for v in variants if v.effect not in skip]
    A, b = data.conditioned(given)
    logs = linear_evidence(variants, A, b)
    # what only a size below zero explains is not explained
    return variants, A, b, [[] if _negative(scene, v, A, b) else x for v, x in zip(variants, logs, strict=True)]


def _negative(scene: Scene, v: Variant, A: Array, b: Array) -> bool:
    """Whether a variant has no negative sizes, and its best size of any of its columns is below zero."""
    if v.effect not in POSITIVE or any(known_size(scene.prepared.nominal, scene.columns[i]) for i in v.index):
        return False
    return bool((marginal(A, b, (v.index, v.shapes[0][1] * v.amplitudes[-1]))[0] < 0.0).any())


def _described(scene: Scene, A: Array, b: Array, v: Variant, logs: Sequence[Array], nats: float) -> DriveHypothesis:
    """The best shape and amplitude of a variant with its parameters."""
    table = np.stack([x[:, 0] for x in logs])
    i, j = np.unravel_index(int(np.argmax(table)), table.shape)
    root = v.shapes[int(i)][1] * v.amplitudes[int(j)]
    block: Block = (v.index, root)
    if nats < -1.0:
        return Hypothesis(v.effect, nats, (), Change(block), v.label, v.sensor, v.axes)
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
        return Hypothesis(v.effect, nats, values, Change(block), v.label, v.sensor, v.axes)
    if v.label == LAGGED:
        return Hypothesis(v.effect, nats, _late_values(A, b, v, table), Change(block), v.label, v.sensor, v.axes)
    mean, covariance = marginal(A, b, block)
    if v.effect == "ramp":
        span = float(scene.knots[-1] - scene.knots[0])
        m, s = float(mean[-1]) / span, math.sqrt(float(covariance[-1, -1])) / span
        values = (Value.normal("R", m, s, effect.unit("R", v.sensor)),)
        return Hypothesis(v.effect, nats, values, Change(block), v.label, v.sensor, v.axes)
    values = shape_values(scene, v.index, mean, covariance)
    return Hypothesis(v.effect, nats, values, Change(block, tuple(int(c) for c in v.index)), v.label, v.sensor, v.axes)


def _late_values(A: Array, b: Array, v: Variant, table: Array) -> tuple[Value, ...]:
    """Coefficient and time constant of a thermal bias, each with what the other leaves open: evidence (l, a) of lags and amplitudes."""
    share = np.exp(table - table.max())
    share /= share.sum()
    c1, variance = np.zeros(len(v.shapes)), np.zeros(len(v.shapes))
    for k, (_, unit) in enumerate(v.shapes):
        size, most = v.amplitudes[int(np.argmax(table[k]))], int(np.argmax(np.abs(unit)))
        mean, covariance = marginal(A, b, (v.index, size * unit))
        kelvin = float(unit[most, 0]) / EFFECTS[v.effect].scale("c1", v.sensor)
        c1[k], variance[k] = mean[most] / kelvin, covariance[most, most] / kelvin**2
    w, logs = share.sum(axis=1), np.log([p[0] for p, _ in v.shapes])
    lag, cell = float(w @ logs), float(logs[1] - logs[0])
    sd = math.sqrt(float(w @ (logs - lag) ** 2) + cell**2 / 12.0)
    value = float(w @ c1)
    spread = math.sqrt(float(w @ (variance + (c1 - value) ** 2)))
    (axis,), effect = v.axes, EFFECTS[v.effect]
    return (
        Value.normal(f"c1_{axis}", value, spread, effect.unit("c1", v.sensor)),
        Value(f"lag_{axis}", math.exp(lag), math.exp(lag - 1.96 * sd), math.exp(lag + 1.96 * sd), "s"),
    )


def shape_values(scene: Scene, index: NDArray[Any], mean: Array, covariance: Array) -> tuple[Value, ...]:
    """Coefficients of columns as values with intervals.

    Parameters
    ----------
    scene : Scene
        Whose columns these are; they say name and unit.
    index : (k,) array of int
        Columns.
    mean : (k,) array
        Coefficients, each in its column's unit.
    covariance : (k, k) array
        Of the coefficients.
    """
    out = []
    for k, i in enumerate(index):
        c, m, s = scene.columns[int(i)], float(mean[k]), math.sqrt(max(float(covariance[k, k]), 0.0))
        out.append(Value.normal(c.label, *c.parameter(m, s), c.unit))
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
    grid = [(p, q) for p in rules().prior_scales for q in rules().prior_scales]
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
    draws: int = 300,
    *,
    always: Sequence[Block] = (),
) -> float:
    """Evidence that the best effect exceeds in ``false_alarms`` of simulated nominal recordings: the filter's own responses, drawn innovations.

    ``always`` is what is uncertain in a nominal recording too; it is drawn as well and then allowed for.

    Parameters
    ----------
    variants : sequence of Variant
        The ways in which effects may be present.
    data : Field
        Responses and variance of the recording.
    rng : Generator
        Of the drawn innovations.
    draws : int
        Simulated recordings.
    always : sequence of Block
        Blocks that are drawn as well.

    Returns
    -------
    float
        nats.
    """
    z = rng.standard_normal((data.y.size, draws))
    b = data.G.T @ z / math.sqrt(data.variance)
    for index, root in always:
        b += data.A[:, index] @ root @ rng.standard_normal((root.shape[1], draws))
    A, b = data.conditioned(always, b)
    b = b[:, 1:]
    # the first column decides what is worth a closer look, as it does for the measured innovations
    evidence = pooled_evidence(variants, linear_evidence(variants, A, b))
    return float(np.quantile(np.max(np.stack(list(evidence.values())), axis=0), 1.0 - rules().false_alarms))
