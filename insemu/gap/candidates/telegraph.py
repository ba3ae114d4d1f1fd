"""A level that switches between two values."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.axis import (
    HOPELESS,
    AxisHypothesis,
    AxisState,
    added,
    cleaned,
)
from insemu.gap.candidates.noise import gauss_markov
from insemu.gap.evidence import kernels
from insemu.gap.evidence.modes import Free, laplace
from insemu.gap.hypothesis import Hypothesis, Later
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.noise import Process

Array = NDArray[np.float64]

#: Switches per block of the block lengths at which switching is looked for, and the most blocks.
SWITCHES_PER_BLOCK, MOST_SWITCHING_BLOCKS = (0.05, 0.25), 12_000


@dataclass(frozen=True)
class _Switching:
    """Two levels over block means of one length, against the Gaussian process of the same second moments."""

    block: int
    excess: float
    x: Array
    sigma: Array
    path: Array


def telegraph(state: AxisState) -> list[AxisHypothesis]:
    """A level that jumps between two values at random times (telegraph or burst noise).

    Its spectrum is that of a Gauss-Markov process of rate ``beta = 2 rate``, and second moments are all that a spectrum and a Gaussian
    likelihood see. So it is worth what that process is worth, plus what the switching likelihood of block means says beyond the Gaussian
    one of the same moments on the same means, less the odds of being the rarer of the two.
    """
    data = state.data
    if "telegraph" in state.named or state.explanation.regressors:
        return []  # levels and drifts of known shape cannot be distinguished sample by sample
    twin = next(iter(gauss_markov(state)), None)
    if twin is None or twin.nats < -HOPELESS:
        return []
    component = twin.change.explanation.components[-1]
    sigma, rate = component.process.parameters["sigma"], 0.5 * component.process.parameters["beta"]
    shortest = max(data.dt, data.duration_s / MOST_SWITCHING_BLOCKS)
    lengths = {max(1, round(max(share / rate, shortest) / data.dt)) for share in SWITCHES_PER_BLOCK}
    found = [s for s in (_switching(state, block, sigma, rate) for block in sorted(lengths)) if s is not None]
    if not found:
        return []
    best = max(found, key=lambda s: s.excess)
    nats = twin.nats + best.excess - rules().telegraph_rarer
    a, rate = math.exp(best.x[0]), math.exp(best.x[1])
    values = tuple(
        Value.positive(name, v, s, unit)
        for name, v, s, unit in zip(("amplitude", "rate"), (a, rate), best.sigma, (data.unit, "1/s"), strict=True)
    )
    if nats < 0.0 or best.excess < rules().telegraph_resolved:
        # no single level stands out: the second moments are what can be taken into account
        components = (*twin.change.explanation.components[:-1], replace(component, effect="telegraph"))
        fitted = replace(twin.change.fitted, explanation=replace(twin.change.explanation, components=components))
        return [Hypothesis("telegraph", nats, values, added(state, fitted, "telegraph"))]
    levels = np.repeat(a * (2.0 * best.path - 1.0), best.block)
    levels = np.concatenate([levels, np.full(data.values.size - levels.size, levels[-1])])
    return [
        Hypothesis(
            "telegraph", nats, values, Later(lambda: cleaned(state, data.values - levels, "telegraph")), "levels"
        )
    ]


def _switching(state: AxisState, block: int, sigma: float, rate: float) -> _Switching | None:
    """Switching against Gaussian likelihood at one block length, each at its own optimum near what the spectrum says."""
    data = state.data
    count = data.values.size // block
    length = block * data.dt
    if count < 60 or rate * length > 1.0:
        return None
    y = data.values[: count * block].reshape(count, block).mean(axis=1)
    y = y - np.median(y)
    phi, q = _background(state, length)
    # what is fast compared with a block counts as white at the level that it has there
    f = np.array([0.25 / length])
    fast = float(state.explanation.psd(f, data.dt)[0]) - sum(float(p.psd(f, data.dt)[0]) for p in _slow(state, length))
    white = max(fast, 0.1 * state.white**2) / length
    p0 = (10.0 * float(np.std(y))) ** 2
    path = np.empty(count)
    # both are free in one box around the spectrum's answer; a memory near the log's length leaves only sigma^2 beta determined, and the spread
    # of the means then says which sigma is meant
    spread = float(np.std(y))
    starts = ((sigma, rate), (spread, min(rate * max((sigma / spread) ** 2, 1.0), 0.5 / length)))
    box = [(min(column) / 5.0, max(column) * 5.0) for column in zip(*starts, strict=True)]
    free = (Free("amplitude", *box[0]), Free("rate", *box[1]))

    def prior(x: Array) -> float:
        return sum(f.log_density(v) for f, v in zip(free, x, strict=True))

    def switching(x: Array) -> float:
        stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(x[1])))
        return kernels.switching_log_likelihood(y, white, phi, q, p0, math.exp(x[0]), stay, path) + prior(x)

    def gaussian(x: Array) -> float:
        stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(x[1])))
        return kernels.gauss_markov_log_likelihood(y, white, phi, q, p0, math.exp(x[0]), stay) + prior(x)

    grid = [np.log([s * a, r * b]) for s, r in starts for a in (0.6, 0.9, 1.3) for b in (0.2, 0.5, 1.0, 2.0)]
    levels = laplace(switching, max(grid, key=switching), free)
    smooth = laplace(gaussian, max(grid, key=gaussian), free)
    switching(levels.x)
    forward = path.copy()
    stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(levels.x[1])))
    kernels.switching_log_likelihood(y[::-1].copy(), white, phi, q, p0, math.exp(levels.x[0]), stay, path)
    both = _smoothed(y, forward, path[::-1], math.exp(levels.x[0]), white)
    return _Switching(block, levels.evidence - smooth.evidence, levels.x, np.sqrt(np.diag(levels.covariance)), both)


def _smoothed(y: Array, forward: Array, backward: Array, amplitude: float, white: float) -> Array:
    """Probability of the upper level given all data, from the filters run either way; each saw the sample itself, which counts once."""

    def odds(p: Array) -> Array:
        q = np.clip(p, 1e-12, 1.0 - 1e-12)
        return np.asarray(np.log(q / (1.0 - q)))

    middle = float(np.mean(y - amplitude * (2.0 * forward - 1.0)))
    own = 2.0 * amplitude * (y - middle) / white
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds(forward) + odds(backward) - own, -40.0, 40.0))))


def _slow(state: AxisState, length: float) -> list[Process]:
    """Processes of the explanation that remember more than a few blocks."""
    dt = state.data.dt
    processes = [c.process for c in state.explanation.components]
    return [p for p in processes if p.remembers(dt, length / rules().slow_blocks)]


def _background(state: AxisState, length: float) -> tuple[float, float]:
    """Transition and driving variance per block of a first-order background that stands for the explanation's slow processes."""
    count = max(round(length / state.data.dt), 1)
    return 1.0, sum(p.wandering(count, state.data.dt) for p in _slow(state, length))
