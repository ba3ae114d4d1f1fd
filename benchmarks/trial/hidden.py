"""An effect that was hidden, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import BeforeValidator

from insemu.effects import CROSS, NED, XYZ

#: A number that is null in a file where it is not finite.
Number = Annotated[float, BeforeValidator(lambda x: math.nan if x is None else x)]


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Parameters
    ----------
    effect, sensor : str
    axes : tuple of str
    strength : float
        In units of the effect's datasheet scale.
    nats : float
        What it is expected to add to the evidence, its one number paid for; NaN where the trial has no measure of it.
    scales_for_20 : float
        Strength, in datasheet scales, at which it would be worth 20 nats; NaN where unknown.
    beside : float
        What it is expected to add where everything else that was hidden is known already except in its size; NaN where the trial has no
        measure of it.
    values : tuple of (str, tuple of float)
        True parameters as a report states them, SI: the whole level of a sensor's or a receiver's noise, where the effect raises that.
    """

    effect: str
    sensor: str
    axes: tuple[str, ...]
    strength: Number = 1.0
    nats: Number = math.nan
    scales_for_20: Number = math.nan
    beside: Number = math.nan
    values: tuple[tuple[str, tuple[float, ...]], ...] = ()

    def true(self, name: str, axes: Sequence[str]) -> float | None:
        """True value of a reported parameter (``value_z``, ``sigma_north``, ``factor`` on the axes of its step); None where it has none."""
        values = dict(self.values)
        key, _, label = name.rpartition("_")
        if name in values:
            key, label = name, axes[0] if len(set(axes)) == 1 else ""
        if key not in values:
            return None
        given = values[key]
        if len(given) == 1:
            return given[0]
        labels = {3: (*XYZ, *NED), 6: CROSS, 9: tuple(a + b for a in XYZ for b in XYZ)}[len(given)]
        return given[labels.index(label) % len(given)] if label in labels else None
