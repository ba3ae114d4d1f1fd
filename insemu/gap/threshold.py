"""What the best of all candidates is worth on logs in which nothing is missing: the threshold of a data set.

Nats bound their own false alarms: on nominal data the expected Bayes factor of a candidate is one, so it exceeds ``exp(t)`` with a
probability of at most ``exp(-t)`` (Markov). Over many candidates and axes that bound is loose by nats, so where a decision hangs on the
difference the nominal model is simulated and the tail of the best candidate measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.axis import AxisState, Weighed, state_of
from insemu.gap.data.log import reduce
from insemu.gap.evidence.model import LEVEL_UNCERTAINTY, Explanation
from insemu.records import Series

Array = NDArray[np.float64]
Search = Callable[[AxisState, Collection[str]], "list[Weighed]"]

#: Share of nominal recordings (all axes together) that may be flagged.
FALSE_ALARMS = 0.02
#: Simulated logs per kind of axis, and the most samples of one; of a longer log one of the same length at a lower rate stands in.
DRAWS, MOST_SAMPLES = 12, 18_000
#: Share of the draws that count as tail; its mean excess on 400 simulated half hours, nats; how many draws that knowledge is worth.
TAIL_SHARE, USUAL_EXCESS, WORTH = 0.25, 0.75, 6.0
#: Where the tail starts as a rule (five kinds of noise, half hours: -0.3 to -0.1), and at the highest, nats (well above what logs between 3
#: minutes and 2 h show).
USUAL_START, HIGHEST_START = 0.0, 0.5
#: Not weighed on simulated logs: worth what a Gauss-Markov process is worth unless levels are plain to see.
COSTLY = ("telegraph",)


@dataclass(frozen=True)
class Tail:
    """Probability that the best candidate of a nominal axis exceeds ``t``: ``share exp(-(t - start) / excess)`` beyond ``start``."""

    start: float
    excess: float
    share: float = TAIL_SHARE

    def exceeds(self, t: float) -> float:
        """Probability of more than ``t`` nats."""
        return self.share * math.exp(-max(t - self.start, 0.0) / self.excess)


#: Tail of an axis on which nothing hangs on it.
USUAL = Tail(USUAL_START, USUAL_EXCESS)


def certain(axes: int, rate: float = FALSE_ALARMS) -> float:
    """Nats that are past any threshold: the highest start of a tail that was met, falling off as slowly as Markov's bound allows."""
    return HIGHEST_START + math.log(max(TAIL_SHARE * axes / rate, 1.0))


def tail_of(gains: Array) -> Tail:
    """Exponential tail of simulated best gains; its mean excess is drawn towards the usual one, because few draws make it."""
    start = float(np.quantile(gains, 1.0 - TAIL_SHARE))
    beyond = gains[gains > start] - start
    excess = (float(np.sum(beyond)) + WORTH * USUAL_EXCESS) / (beyond.size + WORTH)
    return Tail(start, min(excess, 1.0))  # Markov: never slower than exp(-t)


def threshold_of(tails: Sequence[Tail], least: float, rate: float = FALSE_ALARMS) -> float:
    """Nats that the best candidate of any axis exceeds in ``rate`` of nominal recordings, and never less than ``least``."""
    low, high = least, least + 60.0
    if sum(t.exceeds(low) for t in tails) <= rate:
        return least
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sum(t.exceeds(middle) for t in tails) > rate else (low, middle)
    return high


def nominal_tail(state: AxisState, nominal: Explanation, search: Search, without: Collection[str] = ()) -> Tail:
    """Tail of an axis in which nothing is missing; axes of one log that are believed to be alike share their draws.

    Parameters
    ----------
    state : AxisState
        The axis: its length, rate and temperature are simulated.
    nominal : Explanation
        What is believed; every level is drawn anew inside its tolerance.
    search : callable
        Weighs all candidates on an axis.
    without : collection of str
        Effects that are not looked for.
    """
    n, dt, T = state.data.values.size, state.data.dt, state.temperature
    coarser = math.ceil(n / MOST_SAMPLES)
    samples = n // coarser
    seen = b"" if T is None else T[: samples * coarser].reshape(-1, coarser).mean(axis=1).tobytes()
    left_out = tuple(sorted({*without, *COSTLY}))
    return _simulated(replace(nominal, rolloff=None), samples, dt * coarser, seen, search, left_out)


@lru_cache(maxsize=32)
def _simulated(
    nominal: Explanation, samples: int, dt: float, temperature: bytes, search: Search, without: tuple[str, ...]
) -> Tail:
    rng = np.random.default_rng(20)  # the threshold is a property of the data set, not of the run
    T = np.frombuffer(temperature) if temperature else None
    gains = []
    for _ in range(DRAWS):
        x = nominal.start()
        x = x + rng.uniform(-1.0, 1.0, x.size) * math.log1p(LEVEL_UNCERTAINTY)
        values = nominal.at(x).model.simulate(samples, dt, rng)
        data = reduce(Series(values, 1.0 / dt, "", "simulated"))
        ranked = search(state_of(data, nominal, T), without)
        gains.append(max((w.gain for w in ranked), default=0.0))
    return tail_of(np.array(gains))
