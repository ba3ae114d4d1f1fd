"""Processes that the noise of an axis at rest may lack, each weighed against the current explanation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import EFFECTS
from insemu.gap.candidates.axis import (
    AxisHypothesis,
    AxisState,
    added,
    amplitude,
    amplitudes,
    best_of,
    process_starts,
    spread_of,
)
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.evidence.model import Component, Explanation, fit
from insemu.gap.evidence.modes import Free
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.noise import BI, GM, QN, RC, RW, WN

Array = NDArray[np.float64]


def white_noise(state: AxisState) -> list[AxisHypothesis]:
    """The white noise's level is further off than a nominal level may be."""
    base = state.explanation
    index = next(
        (i for i, c in enumerate(base.components) if isinstance(c.process, WN) and c.effect == "nominal"), None
    )
    if index is None:
        top = 10.0 * state.white
        free = (amplitude("N", top),)
        return best_of(
            state, "white_noise", "level", process_starts(state, "white_noise", WN, free, amplitudes(top)), 1
        )
    c = base.components[index]
    n0 = c.process.parameters["N"]
    starts = []
    for factor in (0.3, 0.6, 1.0, 1.6, 3.0, 6.0):
        wide = Component(WN(n0 * factor), (Free("N", n0 / 30.0, n0 * 30.0),), "white_noise")
        starts.append(replace(base, components=(*base.components[:index], wide, *base.components[index + 1 :])))
    return best_of(state, "white_noise", "level", starts, 1)


def random_walk(state: AxisState) -> list[AxisHypothesis]:
    """A random walk that the explanation lacks, or more of it."""
    top = spread_of(state) / math.sqrt(10.0 * state.data.block_s)
    return best_of(
        state,
        "random_walk",
        "",
        process_starts(state, "random_walk", RW, (amplitude("K", top),), amplitudes(top, 16)),
    )


def flicker(state: AxisState) -> list[AxisHypothesis]:
    """Bias instability."""
    top = spread_of(state)
    return best_of(
        state, "flicker", "", process_starts(state, "flicker", BI, (amplitude("B", top),), amplitudes(top, 16))
    )


def gauss_markov(state: AxisState) -> list[AxisHypothesis]:
    """A first-order Gauss-Markov process of any correlation time between four samples and half the log."""
    if "gauss_markov" not in state.memory:
        state.memory["gauss_markov"] = _gauss_markov(state)
    return list(state.memory["gauss_markov"])


def _gauss_markov(state: AxisState) -> list[AxisHypothesis]:
    data = state.data
    fastest, slowest = 4.0 * data.dt, 0.5 * data.duration_s
    top = max(spread_of(state), 10.0 * state.white / math.sqrt(data.dt * 4.0))
    free = (amplitude("sigma", top), Free("beta", 1.0 / slowest, 1.0 / fastest))
    starts: list[Explanation] = []
    for time in np.geomspace(fastest * 1.5, slowest / 1.5, 10):
        # only amplitudes whose spectrum at the corner is not far from the white noise's can matter or fit
        middle = state.white / math.sqrt(2.0 * time)
        for a in middle * np.geomspace(0.1, 300.0, 9):
            starts.append(state.explanation.with_component(Component(GM(a, 1.0 / time), free, "gauss_markov")))
    return best_of(state, "gauss_markov", "", starts, 3)


def quantization_noise(state: AxisState) -> list[AxisHypothesis]:
    """Quantization of the integrated output: a spectrum that rises with the square of the frequency."""
    top = 10.0 * state.white * math.sqrt(state.data.dt)
    return best_of(
        state,
        "quantization",
        "integrated",
        process_starts(state, "quantization", QN, (amplitude("Q", top),), amplitudes(top, 14)),
        1,
    )


def mean_spread(explanation: Explanation, white: float, duration_s: float, dt: float) -> float:
    """Standard deviation of the mean of a log from the noise of an explanation.

    Parameters
    ----------
    explanation : Explanation
        Its white noise is left out.
    white : float
        Density of the white noise, unit/sqrt(Hz).
    duration_s : float
        Length of the log, s.
    dt : float
        Sampling interval, s.
    """
    count = max(round(duration_s / dt), 1)
    rest = (c.process for c in explanation.components if c.process.symbol != "WN")  # ``white`` holds those
    return math.sqrt(white**2 / duration_s + sum(p.mean_variance(count, dt) for p in rest))


def unbiased_log_density(mean: float, spread: Array) -> Array:
    """Log density of a gyroscope's mean at rest that holds noise of this spread and any part of the rotation of the Earth."""
    beyond = max(abs(mean) - earth.RATE, 0.0)
    return np.asarray(-0.5 * (beyond / spread) ** 2 - np.log(math.sqrt(2.0 * math.pi) * spread + 2.0 * earth.RATE))


def bias_nats(mean: float, spread: float) -> float:
    """Nats by which a turn-on bias explains a gyroscope's mean at rest better than noise and the rotation of the Earth do."""
    scale = EFFECTS["turn_on_bias"].scale("value", "gyro")
    wide = [math.hypot(spread, c * scale) for c in rules().prior_scales]
    biased = log_mean_exp([-0.5 * (mean / s) ** 2 - math.log(math.sqrt(2.0 * math.pi) * s) for s in wide])
    return biased - float(unbiased_log_density(mean, np.array([spread]))[0])


def turn_on_bias(state: AxisState) -> list[AxisHypothesis]:
    """A constant error of a gyroscope, its mean at rest more than the rotation of the Earth can be, and the random walk that is its rival.

    An accelerometer at rest shows gravity in an unknown attitude, so its bias is not looked for. Weighed after everything else, because how well
    the mean of the log is known follows from the slow processes that were found.
    """
    data, explanation = state.data, state.explanation
    believed = any(isinstance(c.process, RC) for c in explanation.components)
    if not data.name.startswith("gyro") or believed or explanation.regressors:
        return []
    mean, T = float(np.mean(data.values)), data.duration_s
    sigma = mean_spread(explanation, state.white, T, data.dt)
    off = 1.96 * math.hypot(sigma, earth.RATE / math.sqrt(3.0))
    values = (Value("value", mean, mean - off, mean + off, data.unit),)
    named = replace(state, named=(*state.named, "turn_on_bias"))
    out = [Hypothesis("turn_on_bias", bias_nats(mean, sigma), values, named)]
    if any(isinstance(c.process, RW) for c in explanation.components):
        return out
    # the rival: a walk, which carries the mean away even where the block means are not enough to name it
    walks = amplitudes(spread_of(state) / math.sqrt(10.0 * data.block_s), 40)
    free = (amplitude("K", float(walks[-1])),)
    likelihood = state.likelihood
    starts = [explanation.with_component(Component(RW(float(k)), free, "random_walk")) for k in walks]
    seen = np.array([likelihood.low(e) + likelihood.high(e) for e in starts])
    carried = seen + unbiased_log_density(mean, np.hypot(sigma, walks * math.sqrt(T)))
    null = float(unbiased_log_density(mean, np.array([sigma]))[0])
    rival = log_mean_exp(carried) - likelihood.low(explanation) - likelihood.high(explanation) - null
    p = np.exp(carried - carried.max())
    p /= p.sum()
    centre = float(p @ np.log(walks))
    width = math.sqrt(float(p @ (np.log(walks) - centre) ** 2) + math.log(walks[1] / walks[0]) ** 2 / 12.0)
    meta = RW.PARAMETERS[0]
    values = (Value.positive("K", math.exp(centre), width, meta.unit_for(data.unit)),)
    fitted = fit(likelihood, starts[int(np.argmax(carried))])
    return [*out, Hypothesis("random_walk", rival, values, added(state, fitted, "random_walk"))]
