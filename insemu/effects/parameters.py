"""The numbers of an effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from insemu.errors import InputError, shown

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


def checked_numbers(effect: str, p: EffectParameter, given: Any) -> tuple[float, ...]:
    """All numbers of a parameter, as many as it has.

    Parameters
    ----------
    effect : str
        Whose it is, for what is said of it.
    p : EffectParameter
    given : number or sequence of numbers, or None
        None: its default.

    Raises
    ------
    InputError
        A number that is missing, not finite, negative where it must not be, or implausible; another count.
    """
    where = f"effect '{effect}', '{p.name}'"
    if given is None:
        if p.default is None:
            raise InputError(f"effect '{effect}' misses its parameter '{p.name}' ({p.meaning})")
        given = (p.default,)
    try:
        numbers = tuple(float(x) for x in ((given,) if isinstance(given, int | float) else given))
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: found {shown(given)}, expected {_count(p.size)} number(s)") from None
    if len(numbers) == 1 and p.size in (3, 9):
        numbers *= 3
    if len(numbers) == 3 and p.size == 9:
        a, b, c = numbers
        numbers = (a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, c)
    if len(numbers) != p.size:
        raise InputError(f"{where}: found {len(numbers)} value(s), expected {_count(p.size)}")
    if not all(math.isfinite(x) for x in numbers):
        raise InputError(f"{where}: found a value that is not finite")
    if p.positive and min(numbers) < 0:
        raise InputError(f"{where}: found {min(numbers):g}, expected zero or more")
    if p.most is not None and max(abs(x) for x in numbers) > p.most:
        raise InputError(f"{where}: found {max(numbers, key=abs):g}, expected at most {p.most:g}")
    return numbers


def _count(size: int) -> str:
    return {1: "one", 3: "one or three", 6: "six (xy, xz, yx, yz, zx, zy)", 9: "nine (or three, the diagonal)"}[size]
