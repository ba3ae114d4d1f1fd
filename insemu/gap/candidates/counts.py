"""What the values of the samples show by themselves: a lattice of output counts, held samples, a full scale."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.axis import (
    AxisHypothesis,
    AxisState,
    added,
    cleaned,
)
from insemu.gap.data.counts import lattice, pile_evidence
from insemu.gap.evidence.model import Component, fit
from insemu.gap.evidence.modes import Free
from insemu.gap.hypothesis import Hypothesis, Later
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.lost import ABOVE_CHANCE, FEWEST_REPEATS
from insemu.noise import QN, WN

Array = NDArray[np.float64]


def output_counts(state: AxisState) -> list[AxisHypothesis]:
    """Samples that lie on a lattice: rounding to an output LSB. A continuous signal would never do so, so the evidence is the odds of that."""
    if "quantization" in state.named or not state.data.f.size:
        return []
    step = lattice(state.data.values)
    if step < rules().material_lsb * state.white / math.sqrt(state.data.dt):
        return []  # none, or no more than the digits of a file
    if any(isinstance(c.process, QN) and c.effect == "nominal" for c in state.explanation.components):
        return []
    # each sample of a lattice of step LSB is worth log(LSB / resolution of the storage); single precision is the least there is
    resolution = max(float(np.max(np.abs(state.data.values))), step) * 2.0**-24
    nats = state.data.values.size * max(math.log(step / resolution), 0.0)
    values = (Value("lsb", step, step, step, state.data.unit),)
    # the rounding itself is white noise of variance LSB^2 / 12, less where the noise is too small to spread it evenly
    density = step * math.sqrt(state.data.dt / 12.0)
    rounding = Component(WN(density), (Free("N", density / 3.0, density * 1.2, 0.05),), "quantization")
    fitted = fit(state.likelihood, state.explanation.with_component(rounding))
    return [Hypothesis("quantization", nats, values, added(state, fitted, "quantization"), "output counts")]


def held_samples(state: AxisState) -> list[AxisHypothesis]:
    """Samples that repeat their predecessor exactly: dropped and filled by holding the last one."""
    if {"dropped_samples", "quantization"} & set(state.named):
        return []
    y = state.data.values
    step = lattice(y)
    if step >= rules().material_lsb * state.white / math.sqrt(state.data.dt):
        return []  # counts repeat by themselves
    held = np.flatnonzero(np.diff(y) == 0.0) + 1
    held = held[(y[held] < y.max()) & (y[held] > y.min())]  # a full scale repeats by itself
    share = held.size / y.size
    resolution = max(2.0**-24 * float(np.max(np.abs(y))), step)
    chance = min(1.0, resolution / (state.white / math.sqrt(state.data.dt)))
    if held.size < FEWEST_REPEATS or share < ABOVE_CHANCE * chance:
        return []
    nats = held.size * math.log(share / chance)
    sd = 1.0 / math.sqrt(held.size)
    values = (Value.positive("probability", share, sd, "1"),)
    mended = np.interp(np.arange(y.size), np.delete(np.arange(y.size), held), np.delete(y, held))
    return [
        Hypothesis("dropped_samples", nats, values, Later(lambda: cleaned(state, mended, "dropped_samples")), "held")
    ]


def saturation(state: AxisState) -> list[AxisHypothesis]:
    """Samples pile up at the largest or smallest value: clipped at the full scale.

    A continuous signal never takes its extreme value twice. On a lattice of output counts the logarithm of the frequencies is concave, which
    bounds the outermost from the next two inside; the evidence of a pile is its Poisson ratio to that bound.
    """
    if "saturation" in state.named or not state.data.differences.size:
        return []
    y = state.data.values
    step = lattice(y)
    if step > 0.0 and float(np.ptp(y)) < 5.5 * step:
        return []  # too few levels to tell a pile from a peak
    resolution = 2.0**-24 * float(np.max(np.abs(y)))
    chance = min(1.0, resolution / (state.white / math.sqrt(state.data.dt)))
    nats, limits = 0.0, []
    for sign in (1.0, -1.0):
        x = sign * y
        top = float(np.max(x))
        # wider than rounding, narrower than a count
        width = 0.5 * step if step > 0.0 else 4.0 * resolution
        piled = int(np.sum(x > top - width))
        if step > 0.0:
            one, two = (int(np.sum(np.abs(x - top + k * step) < width)) for k in (1, 2))
            here = pile_evidence(piled, one, two)
        else:
            here = piled * math.log(piled / y.size / chance) if piled >= 3 and piled / y.size > 10.0 * chance else 0.0
        if here > 0.0:
            nats += here
            limits.append(top)
    if not limits:
        return []
    limit = float(np.mean(np.abs(limits)))
    nats -= math.log(y.size)  # any value could have been the limit
    values = (Value("limit", limit, limit - resolution, limit + resolution, state.data.unit),)
    return [Hypothesis("saturation", nats, values, replace(state, named=(*state.named, "saturation"), memory={}))]
