"""Samples that lie on a lattice of output counts, and piles at its ends."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.gap.policy import rules

Array = NDArray[np.float64]


def lattice(values: Array) -> float:
    """Finding of the lattice that all values lie on, or 0 where there is none (floating-point resolution does not count)."""
    sample = np.sort(values[: min(values.size, 200_000)])
    steps = np.diff(sample)
    steps = steps[steps > 1e-7 * max(float(np.ptp(sample)), float(np.max(np.abs(sample))))]
    if not steps.size or steps.size > rules().most_values * sample.size:
        return 0.0
    step = float(np.min(steps))
    gaps = steps / step
    # where values hardly repeat, only a gap that is a whole number of steps to the end tells a lattice from a crowd
    tolerance = 0.02 * np.maximum(1.0, gaps) if steps.size <= 0.2 * sample.size else 0.05
    near = np.abs(gaps - np.round(gaps)) < tolerance
    return float(np.median(steps[gaps < 1.5])) if np.all(near) and np.mean(gaps < 1.5) > 0.1 else 0.0


def pile_evidence(piled: int, one: int, two: int) -> float:
    """Evidence in nats that the outermost count of a lattice holds a pile, from how often it and the two inside of it occur.

    The logarithm of the frequencies is concave without one: a tail falls off faster and faster; two standard deviations of what is
    extrapolated are granted.

    Parameters
    ----------
    piled : int
        Samples at the outermost count.
    one, two : int
        Samples at the next count inside of it, and at the one after that.
    """
    most = one * min(1.0, one / max(two, 1)) if one else 1.0
    most *= 1.0 + 2.0 * math.sqrt(4.0 / max(one, 1) + 1.0 / max(two, 1))
    return piled * math.log(piled / most) - (piled - most) if piled > most else 0.0
