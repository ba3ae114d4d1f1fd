"""The gap of a drive or flight: effects named on the whitened innovations of the nominal filter, and on the IMU's band above the motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from insemu import rotation
from insemu.effects import EFFECTS
from insemu.errors import InputError
from insemu.gap import singular as _registers  # noqa: F401
from insemu.gap import static_log
from insemu.gap.candidates import CANDIDATES, AxisState
from insemu.gap.disagreement import corrected
from insemu.gap.evidence import PRIOR_SCALES, Likelihood, fit, log_mean_exp
from insemu.gap.innovations import (
    Field,
    SlowFit,
    flicker_root,
    gauss_markov_root,
    group_evidence,
    knot_times,
    random_walk_root,
    scaled,
    slow_evidence,
)
from insemu.gap.known import of_axis, settled, starting_explanation, without_drawn
from insemu.gap.nominal import Nominal
from insemu.gap.preparation import Prepared, fast_parts, prepare
from insemu.gap.reduced import Reduced
from insemu.gap.signatures import (
    Column,
    Loop,
    Motion,
    columns_response,
    deterministic_columns,
    fix_columns,
    fix_step_response,
    knot_response,
)
from insemu.gap.surrogate import Surrogate, gnss_noise_fits
from insemu.gap.verdict import GapReport, Interval, Member, Step, Value, VerdictName, Where
from insemu.noise import BI, GM, RW, WN, NoiseModel
from insemu.records import AXES, Recording

Array = NDArray[np.float64]
Given = tuple[NDArray[Any], Array]

LEAD, MOST_STEPS = 3.0, 5
#: Knots of slow processes and starts of steps, s.
KNOT_S, MOST_STARTS = 30.0, 400
#: Candidates of the fast band; the others need a sensor at rest.
FAST = (
    "white_noise",
    "quantization",
    "vibration_band",
    "vibration_line",
    "decimation_filter",
    "outliers",
    "quantization_output",
    "dropped_samples",
)
OMNIBUS = 0.001
#: What manoeuvres leave in the fast band is worth some nats, so effects there must be worth more.
FAST_THRESHOLD = 10.0


@dataclass(frozen=True)
class Hypothesis:
    """One way in which an effect may be present, weighed."""

    effect: str
    sensor: str
    axes: tuple[str, ...]
    gain: float
    values: tuple[Value, ...]
    block: Given | None = None
    variant: str = ""
    fixes: tuple[Array, Array, float] | None = None  # factor, sigma, tau of the fixes' noise


@dataclass
class Scene:
    """A prepared recording with the responses of everything that could be missing."""

    prepared: Prepared
    motion: Motion
    loop: Loop
    columns: list[Column]
    extra_columns: list[Column]
    knots: Array
    starts: Array
    data: Field
    surrogate: Surrogate
    rows_t: Array
    base: float = 0.0
    offsets: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, prepared: Prepared) -> Scene:
        """Respond every column through the filter in the loop."""
        motion = Motion.of(prepared.imu, prepared.result)
        loop = Loop.of(prepared.result)
        t_fix = prepared.result.fixes.t
        columns = deterministic_columns(motion) + fix_columns(motion, t_fix, prepared.lever_arm)
        library = library_columns(motion, t_fix)
        G, ramp = columns_response(loop, motion, columns + library)
        start, end = float(motion.t[0]), float(motion.t[-1])
        knots = knot_times(start, end, max(KNOT_S, (end - start) / 60.0))
        starts = np.arange(start, end, max(float(np.median(np.diff(t_fix))), (end - start) / MOST_STARTS)) + 1e-3
        slow = knot_response(loop, motion, ramp, knots)
        steps = fix_step_response(loop, starts)
        use = loop.use.ravel()
        everything = np.hstack([G, slow, steps])[use]
        y = loop.y[use]
        spread = float(np.clip((np.median(np.abs(y)) / 0.6745) ** 2, 0.9, 1.1))
        offsets = {"slow": G.shape[1], "step": G.shape[1] + slow.shape[1], "library": len(columns)}
        surrogate = Surrogate.of(prepared.result)
        rows_t = np.repeat(t_fix, 6)[use]
        scene = cls(
            prepared,
            motion,
            loop,
            columns,
            library,
            knots,
            starts,
            Field(y, everything, spread),
            surrogate,
            rows_t,
            offsets=offsets,
        )
        scene.base = surrogate.log_likelihood()
        return scene


def library_columns(motion: Motion, t_fix: Array) -> list[Column]:
    """Structure outside the catalogue: products of specific force and rate; GNSS error against heading and speed."""
    out: list[Column] = []
    axes = "xyz"
    for i in range(3):
        out.append(
            Column("library", "accel", f"f_{axes[i]}^2", (axes[i],), 1e-4, "", ((3 + i, motion.force[:, i] ** 2),))
        )
        out.append(Column("library", "gyro", f"w_{axes[i]}^2", (axes[i],), 1e-3, "", ((i, motion.rate[:, i] ** 2),)))
        for j in range(3):
            if j != i:
                out.append(
                    Column(
                        "library",
                        "accel",
                        f"w_{axes[j]} f_{axes[i]}",
                        (axes[i],),
                        1e-3,
                        "",
                        ((3 + i, motion.rate[:, j] * motion.force[:, i]),),
                    )
                )
    rpy = rotation.rpy_from_dcm(motion.C)
    k = np.clip(np.searchsorted(motion.t, t_fix), 0, motion.t.size - 1)
    heading, speed = rpy[k, 2], np.linalg.norm(motion.vel[k], axis=1)
    for name, signal in (("cos", np.cos(heading)), ("sin", np.sin(heading)), ("speed", speed / 10.0)):
        for c, direction in enumerate(("north", "east", "down")):
            M = np.zeros((t_fix.size, 6))
            M[:, c] = signal
            out.append(Column("library", "gnss", f"{name} {direction}", (direction,), 0.05, "m", (), M))
    return out


# -- hypotheses ---------------------------------------------------------------------------------------------------------------------


def _groups(columns: Sequence[Column]) -> dict[tuple[str, str], list[tuple[tuple[str, ...], str, list[int]]]]:
    """Per effect and sensor, the sets of columns that it may consist of: single parameters, one axis, all of them."""
    out: dict[tuple[str, str], list[tuple[tuple[str, ...], str, list[int]]]] = {}
    for key in dict.fromkeys((c.effect, c.sensor) for c in columns):
        mine = [i for i, c in enumerate(columns) if (c.effect, c.sensor) == key]
        sets: list[tuple[tuple[str, ...], str, list[int]]] = []
        if key[0] == "temperature":
            for axis in "xyz":
                own = [i for i in mine if columns[i].axes == (axis,)]
                sets += [((axis,), "linear", own[:1]), ((axis,), "cubic", own)]
            sets.append((("x", "y", "z"), "linear", [i for i in mine if columns[i].label.startswith("c1")]))
        else:
            sets += [(columns[i].axes, columns[i].label, [i]) for i in mine]
            if len(mine) > 1:
                if key[0] == "g_sensitivity":
                    diagonal = [i for i in mine if columns[i].label[-1] == columns[i].label[-2]]
                    sets.append((("x", "y", "z"), "diagonal", diagonal))
                axes = tuple(dict.fromkeys(a for i in mine for a in columns[i].axes))
                sets.append((axes, "all", mine))
        out[key] = [s for s in sets if s[2]]
    return out


def _values(scene: Scene, index: Sequence[int], mean: Array, covariance: Array) -> tuple[Value, ...]:
    out = []
    for place, i in enumerate(index):
        c = scene.columns[i]
        sd = math.sqrt(float(covariance[place, place]))
        m = float(mean[place])
        out.append(Value(c.label, m, m - 1.96 * sd, m + 1.96 * sd, c.unit))
    return tuple(out)


def deterministic(scene: Scene, data: Field, given: Sequence[Given], skip: Collection[str]) -> list[Hypothesis]:
    """Weigh every deterministic, timing, lever-arm and model effect."""
    out = []
    for (effect, sensor), sets in _groups(scene.columns).items():
        if effect in skip:
            continue
        tried = []
        for axes, label, members in sets:
            index = np.array(members)
            scales = np.array([scene.columns[i].scale for i in members])
            gain, factor = group_evidence(data, index, scales, given)
            tried.append((gain, axes, label, index, scaled(scales, factor)))
        # averaged over which of its parameters are there; the best of them is what is reported
        pooled = log_mean_exp([t[0] for t in tried])
        top = max(tried, key=lambda t: t[0])
        block = (top[3], top[4])
        index, mean, covariance = data.posterior([block, *given])
        values = _values(scene, list(top[3]), mean[: top[3].size], covariance[: top[3].size, : top[3].size])
        out.append(
            Hypothesis(effect, sensor, top[1], pooled, values, block, "" if top[2].startswith("value") else top[2])
        )
    return out


def slow(scene: Scene, data: Field, given: Sequence[Given], skip: Collection[str]) -> list[Hypothesis]:
    """Weigh random walk, Gauss-Markov, flicker and ramp on each axis and on each sensor."""
    out: list[Hypothesis] = []
    t, k = scene.knots, scene.knots.size
    span = float(t[-1] - t[0])
    taus = np.geomspace(2.0 * float(t[1] - t[0]), 0.6 * span, 4)
    shapes: dict[str, list[tuple[tuple[float, ...], Array]]] = {
        "random_walk": [((), random_walk_root(t))],
        "gauss_markov": [((1.0 / tau,), gauss_markov_root(t, tau)) for tau in taus],
        "flicker": [((), flicker_root(t))],
    }
    for effect, roots in shapes.items():
        if effect in skip:
            continue
        for sensor, first in (("gyro", 0), ("accel", 3)):
            scale = EFFECTS[effect].scale({"random_walk": "K", "gauss_markov": "sigma", "flicker": "B"}[effect], sensor)
            amplitudes = scale * np.geomspace(1e-3, 10.0, 19)
            tried: list[tuple[SlowFit, tuple[str, ...], NDArray[Any]]] = []
            for axis in range(3):
                index = scene.offsets["slow"] + (first + axis) * k + np.arange(k)
                tried.append((slow_evidence(data, index, roots, amplitudes, given), ("xyz"[axis],), index))
            whole = scene.offsets["slow"] + first * k + np.arange(3 * k)
            spread = [(shape, np.asarray(np.kron(np.eye(3), root), dtype=np.float64)) for shape, root in roots[:2]]
            if max(t[0].gain for t in tried) > 1.0:
                tried.append((slow_evidence(data, whole, spread, amplitudes[::2], given), ("x", "y", "z"), whole))
            pooled = log_mean_exp([f.gain for f, _, _ in tried] + ([-math.inf] if len(tried) == 3 else []))
            best, axes, index = max(tried, key=lambda item: item[0].gain)
            names = [p for p in EFFECTS[effect].parameters][: len(best.values)]
            values = tuple(
                Value(p.name, v, v * math.exp(-1.96 * s), v * math.exp(1.96 * s), EFFECTS[effect].unit(p.name, sensor))
                for p, v, s in zip(names, best.values, best.spread, strict=True)
            )
            out.append(Hypothesis(effect, sensor, axes, pooled, values, (index, best.root)))
    if "ramp" not in skip:
        for sensor, first in (("gyro", 0), ("accel", 3)):
            scale = EFFECTS["ramp"].scale("R", sensor)
            tried_r = []
            for axis in range(3):
                index = scene.offsets["slow"] + (first + axis) * k + np.arange(k)
                root = (t - t[0])[:, None] * scale
                base = data.log_factor(given)
                each = [data.log_factor([*given, (index, root * c)]) - base for c in PRIOR_SCALES]
                tried_r.append((log_mean_exp(each), ("xyz"[axis],), index, root * PRIOR_SCALES[int(np.argmax(each))]))
            pooled = log_mean_exp([r[0] for r in tried_r])
            _, axes, index, root = max(tried_r, key=lambda r: r[0])
            moved = Field(data.y, data.G[:, index] @ (t - t[0])[:, None], data.variance)
            prior = np.array([[float(root[-1, 0] / (t[-1] - t[0]))]])
            _, mean, covariance = moved.posterior([(np.array([0]), prior)])
            m, sd = float(mean[0]), math.sqrt(float(covariance[0, 0]))
            value = Value("R", m, m - 1.96 * sd, m + 1.96 * sd, EFFECTS["ramp"].unit("R", sensor))
            out.append(Hypothesis("ramp", sensor, axes, pooled, (value,), (index, root)))
    return out


def multipath_step(scene: Scene, data: Field, given: Sequence[Given]) -> list[Hypothesis]:
    """Scan start and duration of a step in the position fixes, on each axis."""
    first, s = scene.offsets["step"], scene.starts
    if s.size < 4:
        return []
    residual_b, A = data.b.copy(), data.A
    if given:
        index, mean, _ = data.posterior(given)
        residual_b = data.b - data.A[:, index] @ mean
    scale = EFFECTS["gnss_multipath_step"].scale("value", "gnss")
    best: tuple[float, int, int, int, float] = (-math.inf, 0, 0, 0, 1.0)
    logs = []
    limit = max(2, s.size // 3)
    for c in range(3):
        at = first + 3 * np.arange(s.size) + c
        b, a = residual_b[at] / data.variance, A[np.ix_(at, at)] / data.variance
        i, j = np.triu_indices(s.size, 1)
        near = j - i <= limit
        i, j = i[near], j[near]
        bw = b[i] - b[j]
        aw = np.maximum(a[i, i] + a[j, j] - 2.0 * a[i, j], 1e-12)
        for factor in PRIOR_SCALES:
            prior = (scale * factor) ** 2
            each = 0.5 * bw**2 / (aw + 1.0 / prior) - 0.5 * np.log1p(prior * aw)
            logs.append(each)
            k = int(np.argmax(each))
            if each[k] > best[0]:
                best = (float(each[k]), c, int(i[k]), int(j[k]), scale * factor)
    gain = log_mean_exp(np.concatenate(logs))
    _, c, i0, j0, width = best
    index = np.array([first + 3 * i0 + c, first + 3 * j0 + c])
    root = np.array([[width], [-width]])
    column = data.G[:, index[0]] - data.G[:, index[1]]
    a0 = float(column @ column) / data.variance + width**-2
    m, sd = float(residual_b[index[0]] - residual_b[index[1]]) / data.variance / a0, a0**-0.5
    half = 0.6 * float(s[1] - s[0])
    start, duration = float(s[i0]), float(s[j0] - s[i0])
    values = (
        Value("value", m, m - 1.96 * sd, m + 1.96 * sd, "m"),
        Value("start", start, start - half, start + half, "s"),
        Value("duration", duration, duration - 2 * half, duration + 2 * half, "s"),
    )
    return [Hypothesis("gnss_multipath_step", "gnss", (("north", "east", "down")[c],), gain, values, (index, root))]


def gnss_outliers(scene: Scene, nu: Array) -> list[Hypothesis]:
    """A small share of position fixes with a much larger spread."""
    fixes = scene.prepared.result.fixes
    position = [k for k in range(len(fixes)) if scene.loop.use[k, :3].all()]
    if len(position) < 30:
        return []
    S = np.stack([fixes.S[k][:3, :3] for k in position])
    v = nu[position][:, :3]
    plain = _gaussian(v, S)
    sigma0 = float(np.sqrt(np.median(S[:, 0, 0])))
    logs, grid = [], []
    for ratio in np.geomspace(3.0, 300.0, 10):
        wide = _gaussian(v, S + np.eye(3) * (ratio * sigma0) ** 2)
        for p in np.geomspace(1.0 / len(position), 0.15, 8):
            logs.append(float(np.sum(np.logaddexp(math.log1p(-p) + plain, math.log(p) + wide) - plain)))
            grid.append((p, ratio * sigma0))
    p, sigma = grid[int(np.argmax(logs))]
    count = max(1.0, p * len(position))
    values = (
        Value("probability", p, p * math.exp(-2.0 / math.sqrt(count)), p * math.exp(2.0 / math.sqrt(count)), "1"),
        Value("sigma", sigma, sigma / (1.0 + 1.5 / math.sqrt(count)), sigma * (1.0 + 1.5 / math.sqrt(count)), "m"),
    )
    return [Hypothesis("gnss_outliers", "gnss", ("north", "east", "down"), log_mean_exp(logs), values)]


def _gaussian(v: Array, S: Array) -> Array:
    solved = np.linalg.solve(S, v[:, :, None])[:, :, 0]
    return np.asarray(-0.5 * np.einsum("ki,ki->k", v, solved) - 0.5 * np.linalg.slogdet(S)[1])


def covariance_effects(scene: Scene, data: Field, given: Sequence[Given], skip: Collection[str]) -> list[Hypothesis]:
    """Weigh noise level and colour of the fixes on the innovations less what is already explained."""
    surrogate, base = scene.surrogate, scene.base
    nu = np.where(surrogate.use == 1, surrogate.nu, 0.0)
    if given:
        index, mean, _ = data.posterior(given)
        gone = np.zeros(scene.loop.y.size)
        gone[scene.loop.use.ravel()] = data.G[:, index] @ mean
        whitened = gone.reshape(-1, 6)
        fixes = scene.prepared.result.fixes
        explained = np.zeros_like(nu)
        for k in range(nu.shape[0]):
            rows = np.flatnonzero(scene.loop.use[k])
            if rows.size:
                explained[k, rows] = np.linalg.cholesky(fixes.S[k][np.ix_(rows, rows)]) @ whitened[k, rows]
        # the surrogate's gain feeds the innovations back: what is explained must not be fed back twice
        surrogate = replace(surrogate, nu=nu - explained)
        base = surrogate.log_likelihood()
        nu = nu - explained
    found: dict[str, list[Hypothesis]] = {}
    for n in gnss_noise_fits(surrogate, base):
        trim = 1.0
        if n.effect != "gnss_correlated_noise":
            # the filter's own levels were trimmed: what counts is the ratio to what was believed
            trim = (
                float(np.exp(np.mean(np.log(scene.prepared.factors[n.factor != 1.0]))))
                if (n.factor != 1.0).any()
                else 1.0
            )
        values = tuple(Value(name, v * trim, low * trim, high * trim, unit) for name, v, low, high, unit in n.values)
        found.setdefault(n.effect, []).append(
            Hypothesis(n.effect, "gnss", n.axes, n.gain, values, fixes=(n.factor, n.sigma, n.tau))
        )
    out = []
    for effect, tried in found.items():
        if effect not in skip:
            top = max(tried, key=lambda h: h.gain)
            out.append(replace(top, gain=log_mean_exp([h.gain for h in tried])))
    if "gnss_outliers" not in skip:
        out += gnss_outliers(scene, nu)
    return out


def weigh(scene: Scene, data: Field, given: Sequence[Given], skip: Collection[str]) -> list[Hypothesis]:
    """Every effect that the innovations can show, best first."""
    out = deterministic(scene, data, given, skip) + slow(scene, data, given, skip)
    if "gnss_multipath_step" not in skip:
        out += multipath_step(scene, data, given)
    out += covariance_effects(scene, data, given, skip)
    return sorted(out, key=lambda h: -h.gain)


def library_gain(scene: Scene, data: Field, given: Sequence[Given]) -> tuple[float, str]:
    """The best single structure outside the catalogue."""
    first = scene.offsets["library"]
    best = (-math.inf, "")
    for i, c in enumerate(scene.extra_columns):
        gain, _ = group_evidence(data, np.array([first + i]), np.array([c.scale]), given)
        if gain > best[0]:
            best = (gain, f"{c.sensor} error that goes with {c.label}")
    return best


# -- the search -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Named:
    """What the search found."""

    steps: tuple[tuple[Hypothesis, tuple[Hypothesis, ...]], ...]
    blocks: tuple[Given, ...]
    fixes: tuple[Array, Array, float] | None
    outsider: str
    scene: Scene


#: Effects of one number that only one description can have.
_ONCE = ("imu_gnss_time_offset", "clock_drift", "gravity", "earth_rate", "transport_rate")


def search(
    whole: Scene, cut: float | None, threshold: float, without: Collection[str], progress: Callable[[str], None]
) -> Named:
    """Name the best effect, add it, estimate again, until nothing is worth the threshold.

    Parameters
    ----------
    whole : Scene
    cut : float, optional
        Fixes after this time are not looked at.
    """
    given: list[Given] = []
    steps: list[tuple[Hypothesis, tuple[Hypothesis, ...]]] = []
    skip: set[str] = set(without)
    fixes = None
    outsider = ""
    scene, data = _until(whole, cut)
    for _ in range(MOST_STEPS):
        ranked = [h for h in weigh(scene, data, given, skip) if math.isfinite(h.gain)]
        best = ranked[0]
        beyond, what = library_gain(scene, data, given)
        if beyond > threshold and beyond > best.gain + LEAD:
            outsider = what
            break
        if best.gain < threshold:
            break
        progress(f"{best.effect} {best.gain:.1f} nats")
        steps.append((best, tuple(ranked)))
        if best.block is not None:
            given.append(best.block)
            skip |= {best.effect} & set(_ONCE)
            continue
        skip.add(best.effect)
        if best.effect == "gnss_correlated_noise":
            # coloured fixes need states that the nominal filter has not: the columns cannot be whitened for them
            fixes = best.fixes
            break
        if best.effect == "gnss_outliers":
            whole = Scene.of(whole.prepared.without_positions(_wild(whole, best)))
        elif best.fixes is not None:
            whole = Scene.of(whole.prepared.with_levels(best.fixes[0]))
        scene, data = _until(whole, cut)
    return Named(tuple(steps), tuple(given), fixes, outsider, whole)


def _wild(scene: Scene, outliers: Hypothesis) -> Array:
    """Times of the fixes that are more likely outliers than not."""
    given = {v.name: v.value for v in outliers.values}
    fixes = scene.prepared.result.fixes
    whole = [k for k in range(len(fixes)) if scene.loop.use[k, :3].all()]
    S = np.stack([fixes.S[k][:3, :3] for k in whole])
    nu = fixes.innovation[whole][:, :3]
    p = given["probability"]
    odds = math.log(p / (1.0 - p)) + _gaussian(nu, S + np.eye(3) * given["sigma"] ** 2) - _gaussian(nu, S)
    return np.asarray(fixes.t[np.array(whole)[odds > 0.0]])


def _until(scene: Scene, cut: float | None) -> tuple[Scene, Field]:
    if cut is None:
        return scene, scene.data
    keep = scene.rows_t <= cut
    return replace_data(scene, keep), scene.data.rows(keep)


def _held_out(scene: Scene, named: Named, cut: float) -> tuple[Interval, Interval, Interval]:
    """Gap index before and after and gain per fix after ``cut``, where nothing was named."""
    late = scene.rows_t > cut
    test = scene.data.y[late]
    fixes = len(np.unique(scene.rows_t[late]))
    final = named.scene
    keep = final.rows_t > cut
    data, fit_rows = final.data.rows(keep), final.data.rows(~keep)
    n = data.y.size
    e, logdet = data.y, 0.0
    if named.blocks:
        index, mean, covariance = fit_rows.posterior(named.blocks)
        G = data.G[:, index]
        L = np.linalg.cholesky(np.eye(n) + G @ covariance @ G.T)
        e = np.linalg.solve(L, data.y - G @ mean)
        logdet = float(np.sum(np.log(np.diag(L))))
    # log densities of the same fixes: whitened innovations with the determinants of their covariances
    total = 0.5 * float(test @ test) - 0.5 * float(e @ e) - logdet + _log_volume(scene, cut) - _log_volume(final, cut)
    spread = 1.96 * math.sqrt(0.5 * abs(float(test @ test) - float(e @ e)) + 0.5)
    after = float(e @ e) / n
    if named.fixes is not None:
        early = _first_part(final.surrogate, cut)
        whole = final.surrogate.log_likelihood(*named.fixes) - final.base
        total += whole - (early.log_likelihood(*named.fixes) - early.log_likelihood())

    outliers = next((h for h, _ in named.steps if h.effect == "gnss_outliers"), None)
    if outliers is not None:
        # positions that were left out are scored as the outliers that they are said to be
        given = {v.name: v.value for v in outliers.values}
        gone = int(np.sum(_wild(scene, outliers) > cut))
        total += gone * (math.log(given["probability"]) - 3.0 * math.log(given["sigma"]) - 1.5)

    def around(value: float, count: int) -> Interval:
        half = 1.96 * math.sqrt(2.0 / count) * max(value, 0.2)
        return Interval(value, value - half, value + half)

    before = float(test @ test) / test.size
    return (
        around(before, test.size),
        around(after, n),
        Interval(total / fixes, (total - spread) / fixes, (total + spread) / fixes),
    )


def _log_volume(scene: Scene, cut: float) -> float:
    """Half the log determinants of the innovation covariances after ``cut``, less the units of the whitening."""
    fixes = scene.prepared.result.fixes
    total = 0.0
    for k in np.flatnonzero(fixes.t > cut):
        rows = np.flatnonzero(scene.loop.use[k])
        if rows.size:
            total += 0.5 * float(np.linalg.slogdet(fixes.S[k][np.ix_(rows, rows)])[1])
    return total


def _first_part(s: Surrogate, cut: float) -> Surrogate:
    k = int(np.searchsorted(s.t, cut))
    return replace(s, t=s.t[:k], Phi=s.Phi[:k], Q=s.Q[:k], K=s.K[:k], H=s.H[:k], R=s.R[:k], nu=s.nu[:k], use=s.use[:k])


def fast_effects(
    parts: dict[str, Reduced],
    nominal: Nominal,
    threshold: float,
    without: Collection[str],
    progress: Callable[[str], None],
) -> list[tuple[str, static_log.AxisResult]]:
    """Effects that the IMU shows above its motion, axis by axis."""
    out = []
    excluded = {name for name in CANDIDATES if name not in FAST} | set(without)
    for name in AXES:
        data = parts[name]
        if not data.f.size:
            continue
        given = of_axis(nominal.effects, name)
        state = AxisState(data, fit(Likelihood(data), starting_explanation(nominal.beliefs[name], given, data.dt)))
        state = without_drawn(replace(state, named=tuple(n for n in settled(given) if n == "quantization")), given)
        out.append(
            (
                name,
                static_log.search(
                    state, threshold=threshold, without=tuple(excluded), progress=progress, outsiders=False
                ),
            )
        )
    return out


def find_dynamic_gap(
    recording: Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    threshold: float = 3.0,
    without: Collection[str] = (),
    hold_out: bool = True,
    progress: Callable[[str], None] | None = None,
) -> GapReport:
    """Find what a drive or flight has that the nominal model lacks; see :func:`insemu.gap.find_gap`."""
    say = progress or (lambda _: None)
    say("running the nominal filter")
    missing = [a for a in AXES if a not in nominal.beliefs]
    if missing:
        raise InputError(
            f"no noise model is believed for {', '.join(missing)}; a recording with fixes needs all six axes"
        )
    parts = fast_parts(recording)
    fast = fast_effects(parts, nominal, max(threshold, FAST_THRESHOLD), without, say)
    levels = {
        name: v.value for name, r in fast for f in r.found if f.chosen.effect == "white_noise" for v in f.chosen.values
    }
    prepared = prepare(recording, nominal, parts, levels)
    say("responding every effect through the filter")
    scene = Scene.of(prepared)
    named = search(scene, None, threshold, without, say)
    nothing = Interval(math.nan, math.nan, math.nan)
    before = after = held = nothing
    if hold_out:
        say("scoring on held-out fixes")
        cut = scene.motion.t[0] + static_log.NAMING_SHARE * (scene.motion.t[-1] - scene.motion.t[0])
        cut = float(cut)
        first = search(scene, cut, threshold, without, lambda _: None)
        before, after, held = _held_out(scene, first, cut)
    where = corrected(disagreement_tests(scene, scene.data.y))
    residual = explained_residual(named.scene.data, named.blocks)
    rest = corrected(disagreement_tests(named.scene, residual))
    steps = [_step(h, ranked) for h, ranked in named.steps]
    steps += list(static_log.merged_steps(dict(fast)))
    steps.sort(key=lambda s: -s.gain_nats)
    unexplained = bool(named.outsider) or (named.fixes is None and any(w.p_value < OMNIBUS for w in rest))
    verdict: VerdictName = "nothing missing"
    if unexplained:
        verdict = "unexplained"
        steps = [replace(s, confidence=min(s.confidence, 0.5)) for s in steps]
    elif steps:
        verdict = "class" if steps[0].is_class else "named"
    if named.outsider:
        rest = (Where(named.outsider, "", "", None, 0.0), *rest)
    refined = dict(nominal.beliefs)
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
        dict(nominal.beliefs),
        refined,
        threshold,
        recording.source,
    )


def replace_data(scene: Scene, keep: NDArray[np.bool_]) -> Scene:
    """The scene with the innovations of the first part only, for naming without the held-out part."""
    cut = float(scene.rows_t[keep].max())
    part = _first_part(scene.surrogate, cut + 1e-6)
    k = part.t.size
    loop = Loop(
        scene.loop.result,
        scene.loop.white,
        np.where(np.arange(scene.loop.y.size) < 6 * k, scene.loop.y, 0.0),
        scene.loop.use.copy(),
    )
    loop.use[k:] = False
    out = replace(scene, surrogate=part, loop=loop)
    out.base = part.log_likelihood()
    return out


def explained_residual(data: Field, blocks: Sequence[Given]) -> Array:
    """Innovations less what the blocks explain, whitened again for what their estimation took."""
    if not blocks:
        return data.y
    index, mean, _ = data.posterior(blocks)
    return np.asarray(data.y - data.G[:, index] @ mean)


def disagreement_tests(scene: Scene, y: Array) -> list[tuple[str, str, str, float | None, float]]:
    """Mean, level, whiteness and tails of each component's innovations."""
    use = scene.loop.use
    full = np.full(use.size, np.nan)
    full[use.ravel()] = y / math.sqrt(scene.data.variance)
    table = full.reshape(-1, 6)
    out: list[tuple[str, str, str, float | None, float]] = []
    step = float(np.median(np.diff(scene.prepared.result.fixes.t)))
    for c, (what, axis) in enumerate(
        [("position", a) for a in ("north", "east", "down")] + [("velocity", a) for a in ("north", "east", "down")]
    ):
        z = table[:, c]
        z = z[np.isfinite(z)]
        if z.size < 30:
            continue
        n = z.size
        out.append(
            (f"{what} innovation mean", "gnss", axis, None, float(2.0 * stats.norm.sf(abs(z.mean()) * math.sqrt(n))))
        )
        out.append(
            (
                f"{what} innovation NIS",
                "gnss",
                axis,
                None,
                float(min(1.0, 2.0 * min(stats.chi2.cdf(z @ z, n), stats.chi2.sf(z @ z, n)))),
            )
        )
        lags = np.arange(1, 11)
        rho = np.array([float(np.mean(z[k:] * z[:-k])) for k in lags]) / float(np.mean(z * z))
        out.append(
            (
                f"{what} innovation whiteness",
                "gnss",
                axis,
                10.0 * step,
                float(stats.chi2.sf(n * np.sum(rho**2), lags.size)),
            )
        )
        kurtosis = float(np.mean(z**4) / np.mean(z * z) ** 2 - 3.0)
        out.append(
            (
                f"{what} innovation tails",
                "gnss",
                axis,
                None,
                float(2.0 * stats.norm.sf(abs(kurtosis) / math.sqrt(24.0 / n))),
            )
        )
    return out


def _step(h: Hypothesis, ranked: Sequence[Hypothesis]) -> Step:
    gains = np.array([r.gain for r in ranked] + [math.log(len(ranked))])
    p = np.exp(gains - gains.max())
    members = tuple(
        Member(r.effect, r.sensor, r.axes, r.gain) for r in ranked if r.gain > h.gain - LEAD and r.gain > 0.0
    )
    others = tuple(
        Member(r.effect, r.sensor, r.axes, r.gain) for r in ranked if r.gain <= h.gain - LEAD and r.gain > 0.0
    )[:5]
    needs = "; ".join(dict.fromkeys(EFFECTS[m.effect].excitation for m in members)) if len(members) > 1 else ""
    text = f"a recording with more of: {needs}" if needs else ""
    return Step(h.effect, h.variant, h.sensor, h.axes, h.values, float(p[0] / p.sum()), h.gain, members, text, others)


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

        if step.effect == "random_walk":
            out[name] = out[name] + RW(value("K"))
        elif step.effect == "gauss_markov":
            out[name] = out[name] + GM(value("sigma"), value("beta"))
        elif step.effect == "flicker":
            out[name] = out[name] + BI(value("B"))
        elif step.effect == "white_noise":
            out[name] = NoiseModel(tuple(WN(value("N")) if isinstance(p, WN) else p for p in out[name]))
    return out
