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

from insemu.gap.candidates.axis import AxisHypothesis, AxisState, state_of
from insemu.gap.data.log import reduce
from insemu.gap.evidence.model import Explanation
from insemu.gap.policy import Policy, rules
from insemu.records import Series

Array = NDArray[np.float64]
Search = Callable[[AxisState, Collection[str]], "list[AxisHypothesis]"]

#: Simulated logs per kind of axis, and the most samples of one; of a longer log one of the same length at a lower rate stands in.
DRAWS, MOST_SAMPLES = 12, 18_000
#: Not weighed on simulated logs: worth what a Gauss-Markov process is worth unless levels are plain to see.
COSTLY = ("telegraph",)


@dataclass(frozen=True)
class Tail:
    """Probability that the best candidate of a nominal axis exceeds ``t``: ``share exp(-(t - start) / excess)`` beyond ``start``."""

    start: float
    excess: float
    share: float = Policy.tail_share

    def exceeds(self, t: float) -> float:
        """Probability of more than ``t`` nats."""
        return self.share * math.exp(-max(t - self.start, 0.0) / self.excess)


def usual_tail() -> Tail:
    """Tail of an axis on which nothing hangs on it."""
    return Tail(rules().tail_start, rules().tail_excess, rules().tail_share)


def certain(axes: int) -> float:
    """Nats that are past any threshold: the highest start of a tail that was met, falling off as slowly as Markov's bound allows."""
    return rules().tail_highest + math.log(max(rules().tail_share * axes / rules().false_alarms, 1.0))


def tail_of(gains: Array) -> Tail:
    """Exponential tail of simulated best gains; its mean excess is drawn towards the usual one, because few draws make it."""
    start = float(np.quantile(gains, 1.0 - rules().tail_share))
    beyond = gains[gains > start] - start
    excess = (float(np.sum(beyond)) + rules().tail_worth * rules().tail_excess) / (beyond.size + rules().tail_worth)
    return Tail(start, min(excess, 1.0), rules().tail_share)  # Markov: never slower than exp(-t)


def threshold_of(tails: Sequence[Tail], least: float) -> float:
    """Nats that the best candidate of any axis exceeds in ``false_alarms`` of nominal recordings, and never less than ``least``."""
    rate = rules().false_alarms
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
    return _simulated(replace(nominal, rolloff=None), samples, dt * coarser, seen, search, left_out, rules())


@lru_cache(maxsize=32)
def _simulated(
    nominal: Explanation,
    samples: int,
    dt: float,
    temperature: bytes,
    search: Search,
    without: tuple[str, ...],
    key: Policy,
) -> Tail:
    rng = np.random.default_rng(20)  # the threshold is a property of the data set, not of the run
    T = np.frombuffer(temperature) if temperature else None
    gains = []
    for _ in range(DRAWS):
        x = nominal.start()
        x = x + rng.uniform(-1.0, 1.0, x.size) * math.log1p(rules().tolerance)
        values = nominal.at(x).model.simulate(samples, dt, rng)
        data = reduce(Series(values, 1.0 / dt, "", "simulated"))
        ranked = search(state_of(data, nominal, T), without)
        gains.append(max((w.nats for w in ranked), default=0.0))
    return tail_of(np.array(gains))
