"""A bias that jumps once and stays in a log at rest, found by its block means."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.axis import AxisHypothesis, AxisState
from insemu.gap.candidates.jumps import sized
from insemu.gap.candidates.thermal import less, regression
from insemu.gap.data.log import Reduced
from insemu.gap.evidence import kernels
from insemu.gap.evidence.model import Explanation
from insemu.gap.evidence.starts import Starts
from insemu.gap.policy import rules

Array = NDArray[np.float64]

#: Starts that are tried first in a log at rest.
COARSE = 50
#: Fewest differences of block means in which a step is looked for.
FEWEST_BLOCKS = 8


def at_rest(state: AxisState) -> list[AxisHypothesis]:
    """A step of the bias of an axis of a log at rest, at every start."""
    data, n = state.data, state.data.differences.size
    if "bias_step" in state.named or n < FEWEST_BLOCKS:
        return []
    scale = 3.0 * max(state.block_sigma(), 0.1 * float(np.std(np.cumsum(data.differences))))
    starts = starts_at_rest(data, state.explanation, scale)
    if not math.isfinite(starts.nats):
        return []  # noise whose covariance has no factor
    start = starts.estimate()

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
    """Evidence of steps in a log at rest next to an explanation, at the present parameters of its noise.

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
        return sized(np.einsum("nk,nk->k", G, own), G.T @ y, scale, rules().prior_scales)[0]

    times = np.linspace(data.block_s, (n - 1) * data.block_s, min(COARSE, n - 1))
    return Starts.even(times, evidence(times)).refined(evidence)


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
