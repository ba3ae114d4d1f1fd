"""Processes that several axes see: one draw, seen by every axis at a level of its own.

Every axis's model is complete by itself: it holds the process at the level at which the axis sees it, so its variances and spectrum are
those of the axis alone. A common name, ``GM(sigma=0.1 mg, Tc=100 s, shared=warmth)``, says that the draws of the axes are one; the levels of
the axes, with the sign of ``shared=-warmth``, are the mixing vector. Several names on an axis are a mixing matrix, with which any correlation of
axes can be written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise.process import NoiseModel, Process

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """A shared process as one axis sees it.

    Parameters
    ----------
    axis : str
    place : int
        Place in the axis's model.
    process : Process
    sign : float
        1, or -1 where the axis sees it with the other sign.
    """

    axis: str
    place: int
    process: Process
    sign: float

    @property
    def weight(self) -> float:
        """Entry of the mixing vector: the level with its sign, unit of the axis (of a variance its root)."""
        level = self.process.level
        value = self.process.parameters[level.name]
        return self.sign * (value if level.power == 1 else value**0.5)


def shared_processes(models: Mapping[str, NoiseModel]) -> dict[str, tuple[Seen, ...]]:
    """Which processes the axes share, by name; a name that one axis alone has is listed, too.

    Parameters
    ----------
    models : mapping
        Axis to model.

    Raises
    ------
    InputError
        A name twice on an axis, or of processes that differ in more than their level.
    """
    out: dict[str, list[Seen]] = {}
    for axis, model in models.items():
        for place, process in enumerate(model):
            if not process.shared:
                continue
            name = process.shared.lstrip("-")
            seen = Seen(axis, place, process, -1.0 if process.shared.startswith("-") else 1.0)
            for other in out.setdefault(name, []):
                if other.axis == axis:
                    raise InputError(f"the shared process '{name}' stands twice in the model {model} of {axis}")
                if _shape(other.process) != _shape(process):
                    raise InputError(
                        f"the shared process '{name}' is {other.process} on {other.axis} and {process} on {axis}, expected one process "
                        f"at different levels ({process.level.name})"
                    )
            out[name].append(seen)
    return {name: tuple(members) for name, members in out.items()}


def _shape(process: Process) -> tuple[object, ...]:
    """What all axes must have in common."""
    given = {name: value for name, value in process.given.items() if name != process.level.name}
    return (process.symbol, process.order, process.follows, *given.items())


class CommonDraws:
    """Makes the draws of shared processes one, axis by axis as they come.

    The first axis's draw is kept; a later axis gets it at the ratio of their levels.

    Parameters
    ----------
    models : mapping
        Axis to model, with values.
    """

    def __init__(self, models: Mapping[str, NoiseModel]) -> None:
        self._of: dict[str, list[tuple[str, Seen]]] = {}
        for name, members in shared_processes(models).items():
            for seen in members if len(members) > 1 else ():
                if seen.weight != 0.0:
                    self._of.setdefault(seen.axis, []).append((name, seen))
        self._unit: dict[str, Array] = {}

    def share(self, axis: str, parts: Array, first: int = 0) -> None:
        """Replace the draws of an axis's shared processes, in place.

        Parameters
        ----------
        axis : str
        parts : (processes, n) array
            Of :meth:`~insemu.noise.NoiseModel.simulate_components`, or some of its rows.
        first : int
            Process of the axis's model that row 0 belongs to.
        """
        for name, seen in self._of.get(axis, ()):
            if not first <= seen.place < first + len(parts):
                continue
            drawn = parts[seen.place - first]
            if name in self._unit:
                np.multiply(self._unit[name], seen.weight, out=drawn)
            else:
                self._unit[name] = drawn / seen.weight
