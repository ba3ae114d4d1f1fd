"""What is weighed, what is chosen, and how sure that is: the same for logs at rest and for drives.

A :class:`Hypothesis` carries its change to the model; only the problem that it belongs to knows what a change does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from insemu.gap.policy import rules
from insemu.gap.verdict import Member, Value

Array = NDArray[np.float64]
C = TypeVar("C")


class Later(Generic[C]):
    """A change that costs enough to be worked out only where the effect is added.

    Parameters
    ----------
    make : callable
        Works it out.
    """

    def __init__(self, make: Callable[[], C]) -> None:
        self._make = make

    def __reduce__(self) -> tuple[Callable[[C], Later[C]], tuple[C]]:
        # a function that is local to another cannot be sent to a process; what it makes can
        return _made, (self.value,)

    @cached_property
    def value(self) -> C:
        """What was made, once."""
        return self._make()


def _made(value: C) -> Later[C]:
    later: Later[C] = Later(lambda: value)
    return later


@dataclass(frozen=True)
class Hypothesis(Generic[C]):
    """An effect, weighed.

    Parameters
    ----------
    effect : str
        Catalogue id.
    nats : float
        Log evidence over the current model, averaged over the ways in which the effect may be present.
    values : tuple of Value
        Its parameters.
    what
        What the problem does to its model where the effect is added, or :class:`Later`; read it as ``change``.
    variant : str
        Which of its shapes.
    sensor, axes
        Where; empty where the problem is one axis.
    places : tuple of (axes, probability)
        Axes on which the effect may be, those of the hypothesis first; empty where no others come into question.
    """

    effect: str
    nats: float
    values: tuple[Value, ...]
    what: C | Later[C]
    variant: str = ""
    sensor: str = ""
    axes: tuple[str, ...] = ()
    places: tuple[tuple[tuple[str, ...], float], ...] = ()

    @property
    def change(self) -> C:
        """What the problem does to its model where the effect is added."""
        return self.what.value if isinstance(self.what, Later) else self.what


@dataclass(frozen=True)
class Found(Generic[C]):
    """What was chosen and everything that it was compared with."""

    chosen: Hypothesis[C]
    ranked: tuple[Hypothesis[C], ...]


def best_first(hypotheses: Sequence[Hypothesis[C]]) -> list[Hypothesis[C]]:
    """Those whose evidence is finite, best first."""
    return sorted((h for h in hypotheses if math.isfinite(h.nats)), key=lambda h: -h.nats)


def probabilities(nats: Sequence[float]) -> Array:
    """Probability of each of some effects and, last, of none: all of them together and none weigh alike before the data."""
    logs = np.array([*nats, math.log(max(len(nats), 1))])
    p = np.exp(logs - logs.max())
    return np.asarray(p / p.sum())


def class_of(rivals: Sequence[Member], own: int) -> tuple[tuple[Member, ...], tuple[Member, ...], float]:
    """The class of a finding, the five effects that come next, and the probability that it is no other effect and not nothing.

    Parameters
    ----------
    rivals : sequence of Member
        Everything that was weighed in the same place, best first.
    own : int
        Which of them was named; it comes first in its class.
    """
    p = probabilities([m.nats for m in rivals])
    members, others, held = [], [], 0.0
    for k in (own, *(k for k in range(len(rivals)) if k != own)):
        near = rivals[k].nats > rivals[own].nats - rules().lead and held < rules().class_share * (1.0 - p[-1])
        if k == own or (near and rivals[k].nats > 0.0):
            members.append(rivals[k])
        elif rivals[k].nats > 0.0:
            others.append(rivals[k])
        held += float(p[k])
    return tuple(members), tuple(others[:5]), float(p[own])
