"""What a blind trial draws before it hides an effect: the lot that every effect makes its axes and numbers of."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from insemu.effects.base import XYZ

if TYPE_CHECKING:
    from insemu.effects.base import Effect

Array = NDArray[np.float64]


def at(place: int, value: float, size: int = 3) -> tuple[float, ...]:
    """One number among zeros.

    Parameters
    ----------
    place : int
        Where it stands.
    value : float
    size : int
        How many there are.
    """
    return tuple(value if k == place else 0.0 for k in range(size))


@dataclass(frozen=True)
class Hidden:
    """How an effect is hidden: the axes that show it, every number, and its strength where that was drawn."""

    axes: tuple[str, ...]
    values: dict[str, float | tuple[float, ...]]
    strength: float = 1.0


@dataclass(frozen=True)
class DriveLot:
    """What is drawn for an effect of a drive or flight.

    Parameters
    ----------
    sensor : str
    place : int
        Axis, 0 to 2.
    sign : float
        1 or -1.
    loud : float
        1, 2 or 4.
    group : tuple of str
        North, east and down, or two or one of them.
    pair, cell : int
        One of six cross-axis pairs; one of nine cells.
    white : float
        Density of the axis's white noise.
    dt, span : float
        Interval and duration, s.
    sigma : (3,) array
        Standard deviation of the positions, m.
    rng : Generator
        For what only this effect needs.
    limits : callable
        Full scales such that ``loud`` in a thousand samples of the axis lie beyond them.
    """

    sensor: str
    place: int
    sign: float
    loud: float
    group: tuple[str, ...]
    pair: int
    cell: int
    white: float
    dt: float
    span: float
    sigma: Array
    rng: np.random.Generator
    limits: Callable[[], tuple[float, ...]]

    @property
    def axis(self) -> tuple[str, ...]:
        """The axis's name."""
        return (XYZ[self.place],)

    @property
    def sample(self) -> float:
        """Standard deviation of a sample."""
        return self.white / math.sqrt(self.dt)

    @property
    def nyquist(self) -> float:
        """Half of the rate, Hz."""
        return 0.5 / self.dt

    def size(self, effect: Effect, parameter: str) -> float:
        """The datasheet's scale with the sign that was drawn."""
        return self.sign * effect.scale(parameter, self.sensor)

    def on(self, value: float, names: Sequence[str] = XYZ) -> tuple[float, ...]:
        """A number on the axis."""
        return at(self.place, value, len(names))


@dataclass(frozen=True)
class RestLot:
    """What is drawn for an effect of a log at rest.

    Parameters
    ----------
    n : int
        Samples.
    dt : float
        s.
    white : float
        Density of the axis's white noise.
    place : int
        Axis, 0 to 2.
    memory, switching : float
        Correlation time in s; switches per second.
    sign : float
    frequency, order, bandwidth : float
        Hz, of a low-pass, Hz.
    """

    n: int
    dt: float
    white: float
    place: int
    memory: float
    switching: float
    sign: float
    frequency: float
    order: float
    bandwidth: float
    span: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "span", self.n * self.dt)

    @classmethod
    def drawn(cls, n: int, dt: float, white: float, place: int, rng: np.random.Generator) -> RestLot:
        """Draw what does not scale; the order is part of what makes a recording the same again.

        Parameters
        ----------
        n : int
        dt, white : float
        place : int
        rng : Generator
        """
        span = n * dt
        memory = float(np.exp(rng.uniform(math.log(10.0), math.log(max(span / 15.0, 20.0)))))
        switching, sign = float(1.0 / rng.uniform(15.0, 90.0)), float(rng.choice([-1.0, 1.0]))
        frequency, order = float(rng.uniform(0.1, 0.45) / dt), float(rng.integers(1, 4))
        bandwidth = float(rng.uniform(0.01, 0.15)) * frequency
        return cls(n, dt, white, place, memory, switching, sign, frequency, order, bandwidth)

    @property
    def sample(self) -> float:
        """Standard deviation of a sample."""
        return self.white / math.sqrt(self.dt)

    @property
    def slow(self) -> float:
        """Uncertainty of the mean over the log."""
        return self.white / math.sqrt(self.span)

    def on(self, value: float) -> list[float]:
        """A number on the axis."""
        return list(at(self.place, value))
