"""A bias that jumps once and stays: in a drive or flight, by the innovations, and in a log at rest, by its block means."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS
from insemu.gap.candidates.axis import AxisHypothesis, AxisState
from insemu.gap.candidates.shapes import Change, DriveHypothesis
from insemu.gap.candidates.steps import Beside
from insemu.gap.candidates.thermal import less, regression
from insemu.gap.data.log import Reduced
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence import kernels
from insemu.gap.evidence.linear import Block, Field, log_mean_exp_columns
from insemu.gap.evidence.model import Explanation
from insemu.gap.evidence.starts import Starts
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: A step of a drive that explains less than this at its best start, nats, is not looked at closely.
PROMISING = -2.0
#: Starts that are tried first in a log at rest.
COARSE = 50
#: Fewest differences of block means in which a step is looked for.
FEWEST_BLOCKS = 8
_SENSORS = (("gyro", 0), ("accel", 3))


def of_drive(
    scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]
) -> list[DriveHypothesis]:
    """Steps of the bias of each axis of the sensors, at every start.

    From knot to knot a step is the sum of the slow errors of the knots behind it.

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
        One per sensor; none where there are fewer than four times at which a step may start.
    """
    seen = scene.rows_t[rows]
    middles = 0.5 * (scene.knots[1:] + scene.knots[:-1])
    # a step from the first knots on is a turn-on bias, one behind the last fix is none
    times = middles[1 : int(np.searchsorted(middles, seen[-1] if seen.size else -math.inf)) - 1]
    if times.size < 4:
        return []
    beside, out = Beside.of(data, given), []
    for sensor, first in _SENSORS:
        scans = []
        for axis in range(first, first + 3):
            behind = np.cumsum(data.G[:, scene.slow(axis)][:, ::-1], axis=1)[:, ::-1]
            scans.append(Starts.even(times, _evidence(beside, behind[:, 2 : 2 + times.size], sensor)[0]))
        k = int(np.argmax([scan.logs.max() for scan in scans]))
        axis, best = first + k, scans[k]
        steps = _Steps(scene, rows, beside, axis, sensor)
        if best.logs.max() > PROMISING:
            scans[k] = best = best.closer(steps.evidence)
        nats = float(np.logaddexp.reduce([scan.nats for scan in scans])) - math.log(3.0) - rules().step_rarer
        if not nats > -1.0:
            out.append(Hypothesis("bias_step", nats, (), Change(), "", sensor, ("xyz"[k],)))
            continue
        start = best.told()
        _, mean, sd = steps.at(np.array([start.value]))
        value = Value.normal("value", float(mean[0]), float(sd[0]), EFFECTS["bias_step"].unit("value", sensor))
        change = Change(window=(3 + axis, start.value, math.inf))
        out.append(Hypothesis("bias_step", nats, (value, start), change, "", sensor, ("xyz"[k],)))
    return out


@dataclass(frozen=True)
class _Steps:
    """Steps of the bias of an axis (0..5) beside what is explained of the rows that are looked at."""

    scene: Scene
    rows: NDArray[np.bool_] | slice
    beside: Beside
    axis: int
    sensor: str

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Evidence, size and its standard deviation (k,) each of steps at times (k,), s."""
        return _evidence(self.beside, self.scene.bias_step_columns(self.axis, times)[self.rows], self.sensor)

    def evidence(self, times: Array) -> Array:
        """Their evidence alone."""
        return self.at(times)[0]


def _evidence(beside: Beside, G: Array, sensor: str) -> tuple[Array, Array, Array]:
    """Of steps with columns (r, k): log Bayes factor averaged over the widths of the prior, and size with its standard deviation at the best."""
    half, b = beside.of_columns(G)
    a = np.einsum("rk,rk->k", G, G) / beside.data.variance - np.einsum("ck,ck->k", half, half)
    return _sized(np.maximum(a, 1e-12), b, EFFECTS["bias_step"].scale("value", sensor))


def _sized(a: Array, b: Array, scale: float) -> tuple[Array, Array, Array]:
    """Of single columns with normal factor and right-hand side (k,) each: evidence, mean and standard deviation of the coefficient."""
    prior = (scale * np.array(rules().prior_scales)[:, None]) ** 2
    precision = a + 1.0 / prior
    logs = 0.5 * b**2 / precision - 0.5 * np.log1p(prior * a)
    best = precision[np.argmax(logs, axis=0), np.arange(a.size)]
    return log_mean_exp_columns(logs), b / best, best**-0.5


def at_rest(state: AxisState) -> list[AxisHypothesis]:
    """A step of the bias of an axis of a log at rest, at every start."""
    data, n = state.data, state.data.differences.size
    if "bias_step" in state.named or n < FEWEST_BLOCKS:
        return []
    scale = 3.0 * max(state.block_sigma(), 0.1 * float(np.std(np.cumsum(data.differences))))
    starts = starts_at_rest(data, state.explanation, scale)
    if not math.isfinite(starts.nats):
        return []  # noise whose covariance has no factor
    start = starts.told()

    def column(where: Reduced, _: Array | None) -> Array:
        # a later piece of the log lies behind the step
        return (
            step_of_blocks(where, start.value) if where.differences.size == n else np.zeros((where.differences.size, 1))
        )

    (w,) = regression(state, "bias_step", "", ("value",), column, np.array([scale]), (data.unit,))
    behind = (np.arange(data.values.size) + 0.5) * data.dt > start.value
    w = less(w, state, np.where(behind, w.values[0].value, 0.0))
    return [replace(w, nats=w.nats - paid_for_start(starts), values=(*w.values, start))]


def paid_for_start(starts: Starts) -> float:
    """What a step is worth less than one of known start, nats: it may start at any time, and is rare."""
    return float(starts.logs.max()) - starts.nats + rules().step_rarer


def starts_at_rest(data: Reduced, explanation: Explanation, scale: float) -> Starts:
    """Evidence of steps in a log at rest beside an explanation, at the present parameters of its noise.

    Parameters
    ----------
    data : Reduced
    explanation : Explanation
    scale : float
        Width of the prior of the size, unit of the axis.
    """
    n = data.differences.size
    gamma = explanation.covariance(data.block, data.dt, n)
    known = [r.columns for r in explanation.regressors]
    widths = np.concatenate([np.empty(0), *(r.scales for r in explanation.regressors)]) * max(rules().prior_scales)

    def evidence(times: Array) -> Array:
        stacked = np.hstack([data.differences[:, None], *known, *(step_of_blocks(data, float(t)) for t in times)])
        white = np.empty_like(stacked)
        if not math.isfinite(kernels.toeplitz_whiten(gamma, stacked, white)):
            return np.full(times.size, -math.inf)
        y, beside, G = white[:, 0], white[:, 1 : 1 + widths.size], white[:, 1 + widths.size :]
        own = G
        if widths.size:
            M = np.linalg.solve(beside.T @ beside + np.diag(1.0 / widths**2), beside.T)
            y, own = y - beside @ (M @ y), G - beside @ (M @ G)
        return _sized(np.einsum("nk,nk->k", G, own), G.T @ y, scale)[0]

    times = np.linspace(data.block_s, (n - 1) * data.block_s, min(COARSE, n - 1))
    return Starts.even(times, evidence(times)).closer(evidence)


def step_of_blocks(data: Reduced, start: float) -> Array:
    """Differences (n, 1) of the block means of a unit step.

    Parameters
    ----------
    data : Reduced
        With n differences.
    start : float
        s.
    """
    n = data.differences.size
    at = min(max(start / data.block_s, 1.0), n - 1.0)
    out, k = np.zeros((n, 1)), int(at)
    out[k - 1, 0], out[k, 0] = 1.0 - (at - k), at - k
    return out
