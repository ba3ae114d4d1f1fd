"""The numbers of an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

#: How the numbers of two finds of one effect become one number; "" where the two stay two entries.
Join = Literal["", "sum", "product", "root_sum_square", "larger", "smaller", "later", "equal"]
#: Cross-axis parameters (six): axis that errs, then axis that leaks into it.
CROSS = ("xy", "xz", "yx", "yz", "zx", "zy")
#: Cells of a 3 x 3 matrix row by row.
CELLS = tuple(a + b for a in "xyz" for b in "xyz")


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect.

    Parameters
    ----------
    name : str
        Key in mappings and scenarios.
    unit : str
        SI unit; ``{s}`` stands for the unit of the sensor's signal (rad/s, m/s^2, or that of an aid) and is empty for GNSS and timing.
    size : int
        1: one number; 3: one per axis (a single number is taken for all three); 6: one per cross-axis pair
        (:data:`CROSS`); 9: a 3 x 3 matrix row by row (three numbers are its diagonal).
    scale : tuple of float
        Typical datasheet magnitude in SI: one for every sensor of the effect in their order or one in all. The
        priors of the gap workflow are multiples of it.
    default : float or None
        Value where none is given; None: must be given.
    meaning : str
        In words.
    positive : bool
        Whether negative values are refused.
    join : str
        How two finds add up, see :data:`Join`.
    nothing : float
        The value that does nothing.
    most : float or None
        Largest magnitude that is plausible, SI; a larger one is refused.
    """

    name: str
    unit: str
    size: int
    scale: tuple[float, ...]
    default: float | None
    meaning: str
    positive: bool = False
    join: Join = ""
    nothing: float = 0.0
    most: float | None = None

    def labels(self, axes: Sequence[str]) -> tuple[str, ...]:
        """Names of its numbers, as findings have them: ``value_x``, ``value_xy``, ``tau``; ``axes`` are the effect's."""
        names = {3: tuple(axes), 6: CROSS, 9: CELLS}.get(self.size, ())
        return tuple(f"{self.name}_{a}" for a in names) or (self.name,)
