"""Steps in the positions of a drive or flight, as an antenna next to a building sees them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS
from insemu.gap.candidates.shapes import Change, DriveHypothesis
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import fix_step_response
from insemu.gap.evidence.fixes import NED
from insemu.gap.evidence.linear import Block, log_mean_exp
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: Parts of a gap between two fixes in which a step may begin.
GAP_PARTS = 20
#: A step shows at its edges only where a colour or a filter that trusts its fixes follows it: stretches of so many fixes whose mean surprises most,
#: before which edges are looked for, and fixes to either side of each.
STRETCHES, SURPRISES, BESIDE = (1, 2, 4, 8), 16, 2
#: Evenly spaced times more fixes apart than this stand for other fixes than their own, and may miss an edge: three fixes apart they missed one of
#: 76 nats, which a filter followed within two; judged by ``python -m benchmarks.foreign --kinds one --recordings 200 --seed 700000``,
#: ``--kinds two --recordings 100 --seed 500000`` and ``--kinds none --recordings 120 --seed 480000``.
APART = 1.5


def multipath_step(unexplained: Unexplained) -> list[DriveHypothesis]:
    """Scan start and duration of a step in the position fixes, on each axis; refined around the best.

    Parameters
    ----------
    unexplained : Unexplained

    Returns
    -------
    list of DriveHypothesis
        One, or none where there are fewer than four times at which a step may start.
    """
    scene = unexplained.scene
    if scene.starts.size < 4:
        return []
    step = _step_anywhere(unexplained)
    apart = (scene.starts[1] - scene.starts[0]) / float(np.median(np.diff(scene.prepared.result.fixes.t)))
    missed = scene.noise is not None or apart > APART
    at_edges = _step_at_edges(unexplained) if missed else None
    return [(step if at_edges is None or step.nats > at_edges.nats else at_edges).hypothesis()]


def _lasting(scene: Scene, rows: slice) -> tuple[float, float]:
    """Durations of the shortest and the longest step among the fixes that are looked at, s."""
    t = scene.prepared.result.fixes.t
    seen = t[t <= scene.rows_t[rows][-1]]
    return rules().shortest_step * float(np.median(np.diff(t))), rules().longest_step * float(seen[-1] - seen[0])


def _step_anywhere(unexplained: Unexplained) -> _Step:
    """The best step of those that start and end at evenly spaced times, refined around it."""
    scene, rows = unexplained.scene, unexplained.rows
    s, G, t_fix = scene.starts, scene.step_columns[rows], scene.prepared.result.fixes.t
    lasting = _lasting(scene, rows)
    coarse = _scan_steps(unexplained, G, s, lasting)
    nats = log_mean_exp(coarse.logs)
    c, i, j = coarse.best
    if coarse.top > -2.0:
        # the scan is coarse: try every start and end near the best with columns of their own
        spacing = float(s[1] - s[0])
        starts = np.unique(np.concatenate([t_fix[np.abs(t_fix - x) <= spacing] for x in (s[i], s[j])]) + 1e-3)[:120]
        if starts.size >= 4:
            columns = scene.whitened(_axis_steps(scene, starts, c))[rows]
            fine = _scan_steps(unexplained, columns, starts, lasting, axes=1)
            if fine.top > coarse.top:
                return _Step(
                    nats + fine.top - coarse.top, c, fine.value,
                    lambda: _when(fine, starts, t_fix, _elsewhere(coarse, s, starts)),
                )  # fmt: skip
    half = 0.6 * float(s[1] - s[0])
    start, duration = float(s[i]), float(s[j] - s[i])
    when = (
        Value("start", start, start - half, start + half, "s"),
        Value("duration", duration, max(duration - 2.0 * half, 0.0), duration + 2.0 * half, "s"),
    )
    return _Step(nats, c, coarse.value, lambda: when)


def _step_at_edges(unexplained: Unexplained) -> _Step | None:
    """The best step between fixes that surprise: evenly spaced times miss the edges, where alone it shows."""
    scene, rows = unexplained.scene, unexplained.rows
    t_fix = scene.prepared.result.fixes.t
    residuals, last = unexplained.by_fix()
    top = surprising(residuals[:, :3])[:, None] - 1 + np.arange(-BESIDE, BESIDE + 1)
    before = np.unique(top[(top >= 0) & (top < last)])
    starts = t_fix[before] + 1e-3
    if starts.size < 4:
        return None
    columns = [scene.whitened(_axis_steps(scene, starts, c))[rows] for c in range(3)]
    scans = [_scan_steps(unexplained, own, starts, _lasting(scene, rows), axes=1) for own in columns]
    c = int(np.argmax([scan.top for scan in scans]))
    # all pairs of fixes are as likely as these
    widths, pairs = scans[c].logs.size // max(scans[c].i.size, 1), 0.5 * last * (last - 1)
    nats = float(np.logaddexp.reduce(np.concatenate([scan.logs for scan in scans]))) - math.log(3.0 * widths * pairs)
    return _Step(nats, c, scans[c].value, lambda: _when(scans[c], starts, t_fix))


def surprising(e: Array, count: int = SURPRISES) -> NDArray[np.int64]:
    """The fixes behind which the means of residuals surprise most, those apart from one another.

    Parameters
    ----------
    e : (f, k) array
        Residuals of unit variance.
    count : int
        How many.
    """
    total, score = np.cumsum(np.vstack([np.zeros(e.shape[1]), e]), axis=0), np.zeros(len(e))
    for length in STRETCHES:
        mean_square = np.max((total[length:] - total[:-length]) ** 2, axis=1) / length
        score[: mean_square.size] = np.maximum(score[: mean_square.size], mean_square)
    chosen: list[int] = []
    for k in np.argsort(-score, kind="stable"):
        if len(chosen) == count:
            break
        if all(abs(int(k) - other) > BESIDE for other in chosen):
            chosen.append(int(k))
    return np.array(chosen, dtype=np.int64)


def _axis_steps(scene: Scene, starts: Array, axis: int) -> Array:
    """Responses (f, 6, starts) of steps of one position axis."""
    return fix_step_response(scene.loop, np.eye(3, 6)[[axis], None], starts)


@dataclass(frozen=True)
class _Scan:
    """Evidence of steps: of every axis, width of the prior and pair of a start and an end that was tried, and the best of them.

    Parameters
    ----------
    logs : (axes * widths * pairs,) array
    i, j : (pairs,) arrays of int
        Starts and ends.
    top : float
    best : (axis, start, end)
    value : (mean, standard deviation)
        Of the best, m.
    """

    logs: Array
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    top: float
    best: tuple[int, int, int]
    value: tuple[float, float]


@dataclass(frozen=True)
class _Step:
    """The best step of a scan.

    Parameters
    ----------
    nats : float
    axis : int
        0 to 2.
    value : (mean, standard deviation)
        m.
    when : callable
        Gives its start and duration: their intervals take longer than the scan, and few steps are worth anything.
    """

    nats: float
    axis: int
    value: tuple[float, float]
    when: Callable[[], tuple[Value, Value]]

    def hypothesis(self) -> DriveHypothesis:
        """The step as an effect, without values where it is worth nothing."""
        effect, axes = "gnss_multipath_step", (NED[self.axis],)
        if not self.nats > -1.0:
            return Hypothesis(effect, self.nats, (), Change(), "step", "gnss", axes)
        start, duration = self.when()
        change = Change(window=(self.axis, start.value, start.value + duration.value))
        return Hypothesis(
            effect, self.nats, (Value.normal("value", *self.value, "m"), start, duration), change, "step", "gnss", axes
        )


def _scan_steps(unexplained: Unexplained, G: Array, s: Array, lasting: tuple[float, float], axes: int = 3) -> _Scan:
    (shortest, longest), variance = lasting, unexplained.data.variance
    scale = EFFECTS["gnss_multipath_step"].scale("value", "gnss")
    half, b_all = unexplained.of_columns(G)
    i, j = np.triu_indices(s.size, 1)
    near = (s[j] - s[i] >= shortest) & (s[j] - s[i] <= longest)
    i, j = i[near], j[near]
    if not i.size:
        return _Scan(np.full(1, -math.inf), i, j, -math.inf, (0, 0, 0), (0.0, 1.0))
    logs, top, best, value = [], -math.inf, (0, 0, 0), (0.0, 1.0)
    for c in range(axes):
        own, common, b = np.ascontiguousarray(G[:, c::axes]), half[:, c::axes], b_all[c::axes]
        A = own.T @ own / variance - common.T @ common
        d = np.diag(A)
        aw = np.maximum(d[i] + d[j] - 2.0 * A[i, j], 1e-12)
        bw = b[i] - b[j]
        for factor in rules().prior_scales:
            prior = (scale * factor) ** 2
            each = 0.5 * bw**2 / (aw + 1.0 / prior) - 0.5 * np.log1p(prior * aw)
            logs.append(each)
            k = int(np.argmax(each))
            if each[k] > top:
                precision = float(aw[k]) + 1.0 / prior
                top, best, value = (
                    float(each[k]),
                    (c, int(i[k]), int(j[k])),
                    (float(bw[k]) / precision, precision**-0.5),
                )
    return _Scan(np.concatenate(logs), i, j, top, best, value)


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
    c, i, j = coarse.best
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
    _, k, m = scan.best
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


def placed(step: DriveHypothesis, column: int) -> DriveHypothesis:
    """A step in the fixes as a column of the scene."""
    block: Block = (np.array([column]), np.array([[3.0 * abs(step.values[0].value)]]))
    return replace(step, what=replace(step.change, block=block))
