"""What jumps once in a drive or flight and stays: a bias of a sensor, or where the antenna stands on the vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, first_axis
from insemu.gap.candidates.shapes import Change, DriveHypothesis, sizes
from insemu.gap.candidates.steps import surprising
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.changes import scanned
from insemu.gap.drive.scene import ARMS, TERMS
from insemu.gap.evidence.linear import log_mean_exp_columns
from insemu.gap.evidence.starts import CLOSE_CELLS, Starts
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: A jump that explains less than this at its best start, nats, is not looked at closely.
PROMISING = -2.0
#: Fewest times at which a jump may start for it to be looked for.
FEWEST_STARTS = 4
#: A change of the lever arm shows at its own fix alone where a filter follows it: so many fixes that surprise most, and so many on either side,
#: before which it is looked for. Without, one of 183 nats is found a minute off (tests/test_gap_lever_arm_step.py).
SURPRISES, BESIDE = 8, 1
#: Cells on either side of the best one in which its start is looked for more closely: two fixes are no more alike than two minutes.
ARM_CELLS = 3
#: Effects that jump and stay.
JUMPS = ("bias_step", "lever_arm_step", "expression_step")


@dataclass(frozen=True)
class _Jump:
    """An effect on one axis at any start, next to what is explained of the rows that are looked at.

    Parameters
    ----------
    effect, sensor : str
    axis : str
    place : int
        Where it stands among the windows of a scene.
    unexplained : Unexplained
    columns : callable
        Unit jumps at times (k,), s, as columns (r, k).
    times : (n,) array
        That are tried first, s.
    first : (r, n) array
        Their columns.
    fixes : (f,) array, optional
        Times of the fixes, s, of what only fixes tell: it began anywhere between two of them.
    """

    effect: str
    sensor: str
    axis: str
    place: int
    unexplained: Unexplained
    columns: Callable[[Array], Array]
    times: Array
    first: Array
    fixes: Array | None = None

    def best_start(self, scan: Starts) -> Value:
        """The best start with its 95 % interval, s."""
        start = scan.estimate()
        if self.fixes is None:
            return start
        before = max(int(np.searchsorted(self.fixes, start.low, side="right")) - 1, 0)
        after = min(int(np.searchsorted(self.fixes, start.high)), self.fixes.size - 1)
        return replace(start, low=min(start.low, self.fixes[before]), high=max(start.high, self.fixes[after]))

    def scan(self) -> Starts:
        """Evidence of starts at the times that are tried first."""
        return Starts.even(self.times, self._of(self.first)[0])

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Evidence, size and its standard deviation (k,) each of jumps at times (k,), s."""
        return self._of(self.columns(times))

    def evidence(self, times: Array) -> Array:
        """Their evidence alone."""
        return self.at(times)[0]

    def _of(self, G: Array) -> tuple[Array, Array, Array]:
        half, b = self.unexplained.of_columns(G)
        a = np.einsum("rk,rk->k", G, G) / self.unexplained.data.variance - np.einsum("ck,ck->k", half, half)
        widths = rules().prior_scales if self.effect == "bias_step" else sizes(self.effect)
        return sized(np.maximum(a, 1e-12), b, EFFECTS[self.effect].scale("value", self.sensor), widths)


def bias_step(unexplained: Unexplained) -> list[DriveHypothesis]:
    """Steps of the bias of each axis of the sensors, at every start.

    From knot to knot a step is the sum of the slow errors of the knots behind it.

    Parameters
    ----------
    unexplained : Unexplained

    Returns
    -------
    list of DriveHypothesis
        One per sensor; none where there are fewer than four times at which a step may start.
    """
    scene, data, rows = unexplained.scene, unexplained.data, unexplained.rows
    seen = scene.rows_t[rows]
    middles = 0.5 * (scene.knots[1:] + scene.knots[:-1])
    # a step from the first knots on is a turn-on bias, one behind the last fix is none
    times = middles[1 : int(np.searchsorted(middles, seen[-1] if seen.size else -math.inf)) - 1]
    if times.size < FEWEST_STARTS:
        return []
    out = []
    for sensor in EFFECTS["bias_step"].sensors:
        jumps, first = [], first_axis(sensor)
        for k, axis in enumerate("xyz"):
            behind = np.cumsum(data.G[:, scene.slow(first + k)][:, ::-1], axis=1)[:, ::-1]

            def columns(at: Array, k: int = first + k) -> Array:
                return scene.bias_step_columns(k, at)[rows]

            jumps.append(
                _Jump(
                    "bias_step", sensor, axis, 3 + first + k, unexplained, columns, times, behind[:, 2 : 2 + times.size]
                )
            )
        out.append(_best(jumps))
    return out


def lever_arm_step(unexplained: Unexplained) -> list[DriveHypothesis]:
    """Changes of the lever arm along each axis of the body, at every start.

    Parameters
    ----------
    unexplained : Unexplained

    Returns
    -------
    list of DriveHypothesis
        One; none where there are fewer than four times at which a change may start.
    """
    scene, rows = unexplained.scene, unexplained.rows
    seen = scene.rows_t[rows]
    count = int(np.searchsorted(scene.arm_starts, seen[-1] if seen.size else -math.inf))
    if count < FEWEST_STARTS:
        return []
    first, t_fix = scene.arm_columns[rows], scene.prepared.result.fixes.t
    jumps = []
    for k, axis in enumerate("xyz"):

        def columns(at: Array, k: int = k) -> Array:
            return scene.arm_steps(k, at)[rows]

        own = first[:, k::3][:, :count]
        jumps.append(
            _Jump("lever_arm_step", "gnss", axis, ARMS + k, unexplained, columns, scene.arm_starts[:count], own, t_fix)
        )
    return [_best(jumps, _edges(unexplained))]


def changed_term(unexplained: Unexplained) -> list[DriveHypothesis]:
    """Errors of an axis that follow a signal from a time on, from every node of the filter.

    Parameters
    ----------
    unexplained : Unexplained

    Returns
    -------
    list of DriveHypothesis
        One per sensor; none where the fixes are whitened for another noise than the filter believes, which no pass backwards knows.
    """
    scene, data, fixes = unexplained.scene, unexplained.data, unexplained.scene.loop.use
    nodes = scene.loop.result.nodes
    assert nodes is not None
    t = scene.motion.t[nodes.epoch]
    if scene.noise is not None or t.size < FEWEST_STARTS + 2:
        return []
    rows = np.flatnonzero(fixes)[unexplained.rows]
    vectors = np.hstack([unexplained.residual[:, None], unexplained.span])
    v = np.zeros((fixes.size, vectors.shape[1]))
    v[rows] = vectors
    count = int(rows[-1]) // 6 + 1 if rows.size else 0
    squares, products = scanned(scene.loop, scene.changing.built, v.reshape(*fixes.shape, -1), count)
    # inputs up to a node begin at the node before; from the first on they are there throughout
    squares, products, start, width = squares[2:], products[2:], t[1:-1], np.diff(t)[1:]
    half = products[:, :, 1:] @ unexplained.inverse.T / data.variance
    a = np.maximum(squares / data.variance - np.einsum("ncq,ncq->nc", half, half), 1e-12)
    b = products[:, :, 0] / data.variance
    out, columns = [], scene.changing.columns
    for sensor in dict.fromkeys(c.sensor for c in columns):
        own = [j for j, c in enumerate(columns) if c.sensor == sensor]
        weighed = [sized(a[:, j], b[:, j], columns[j].scale, sizes("expression_step")) for j in own]
        scans = [Starts(start, width, logs) for logs, _, _ in weighed]
        k = int(np.argmax([scan.nats for scan in scans]))
        (_, mean, sd), column, best = weighed[k], columns[own[k]], scans[k].estimate()
        nats = float(np.logaddexp.reduce([s.nats for s in scans])) - math.log(len(own)) - rules().step_rarer
        if not nats > -1.0:
            out.append(Hypothesis("expression_step", nats, (), Change(), "", sensor, column.axes))
            continue
        at = int(np.argmax(scans[k].logs))
        value = Value.normal("value", float(mean[at]), float(sd[at]), column.unit)
        change = Change(window=(TERMS + own[k], best.value, math.inf))
        out.append(Hypothesis("expression_step", nats, (value, best), change, "", sensor, column.axes))
    return out


def _edges(unexplained: Unexplained) -> tuple[Array, Array]:
    """Middles and widths, s, of gaps before fixes that surprise most in the directions in which a lever arm moves them."""
    scene = unexplained.scene
    t, (residuals, last), along = scene.prepared.result.fixes.t, unexplained.by_fix(), []
    for axis in range(3):
        g = np.einsum("kij,kj->ki", scene.loop.white, scene.arm_fixes(axis))
        along.append(np.einsum("ki,ki->k", residuals, g) / np.maximum(np.linalg.norm(g, axis=1), np.finfo(float).tiny))
    near = surprising(np.stack(along, axis=1), SURPRISES)[:, None] + np.arange(-BESIDE, BESIDE + 1)
    before = np.unique(near[(near > 1) & (near < last)])
    cells = t[before] - t[before - 1]
    return t[before] - 0.5 * cells, cells


def _best(jumps: Sequence[_Jump], edges: tuple[Array, Array] | None = None) -> DriveHypothesis:
    """Of a jump on one of three axes the likeliest, worth what all of them are on average; edges are middles and widths of cells, s."""
    scans = [jump.scan() for jump in jumps]
    k = int(np.argmax([scan.logs.max() for scan in scans]))
    if scans[k].logs.max() > PROMISING:
        scans[k] = scans[k].refined(jumps[k].evidence, CLOSE_CELLS if edges is None else ARM_CELLS)
    if edges is not None:
        scans = [scan.with_more(*edges, jump.evidence(edges[0])) for scan, jump in zip(scans, jumps, strict=True)]
        k = int(np.argmax([scan.logs.max() for scan in scans]))
    jump, best = jumps[k], scans[k]
    nats = float(np.logaddexp.reduce([scan.nats for scan in scans])) - math.log(len(jumps)) - rules().step_rarer
    if not nats > -1.0:
        return Hypothesis(jump.effect, nats, (), Change(), "", jump.sensor, (jump.axis,))
    start = jump.best_start(best)
    _, mean, sd = jump.at(np.array([start.value]))
    value = Value.normal("value", float(mean[0]), float(sd[0]), EFFECTS[jump.effect].unit("value", jump.sensor))
    change = Change(window=(jump.place, start.value, math.inf))
    return Hypothesis(jump.effect, nats, (value, start), change, "", jump.sensor, (jump.axis,))


def sized(a: Array, b: Array, scale: float, widths: Sequence[float]) -> tuple[Array, Array, Array]:
    """Evidence, mean and standard deviation (k,) each of the coefficients of single columns.

    Parameters
    ----------
    a, b : (k,) arrays
        Normal factor and right-hand side of each.
    scale : float
        Datasheet scale of the coefficient.
    widths : sequence of float
        Standard deviations of its prior over the scale; the evidence is averaged over them.
    """
    prior = (scale * np.array(widths)[:, None]) ** 2
    precision = a + 1.0 / prior
    logs = 0.5 * b**2 / precision - 0.5 * np.log1p(prior * a)
    best = precision[np.argmax(logs, axis=0), np.arange(a.size)]
    return log_mean_exp_columns(logs), b / best, best**-0.5
