"""A policy that notes which of its constants could decide otherwise: every constant is carried together with its moved values.

What is worked out from a constant is worked out for its moved values, too; where a comparison, a count or a number handed to compiled code
comes out another, that constant and factor are noted. A recording in which nothing is noted need not be looked at under the moved constant:
the workflow would take the same branches with the same numbers.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from insemu.gap.policy import Policy

FACTORS = (1.5, 1.0 / 1.5)
NAMES = frozenset(f.name for f in fields(Policy))
Move = tuple[str, float]


class Probe:
    """A number that depends on constants: as it is, and as each moved constant would make it."""

    __slots__ = ("moved", "usual")
    noted: ClassVar[set[Move]] = set()

    def __init__(self, usual: Any, moved: dict[Move, Any]) -> None:
        self.usual, self.moved = usual, moved

    @classmethod
    def of(cls, function: Callable[..., Any], *arguments: Any) -> Probe:
        """A function of numbers, worked out for every move of any of them."""
        moves = {m for a in arguments if isinstance(a, Probe) for m in a.moved}
        under = {
            m: function(*(a.moved.get(m, a.usual) if isinstance(a, Probe) else a for a in arguments)) for m in moves
        }
        return cls(function(*(a.usual if isinstance(a, Probe) else a for a in arguments)), under)

    def settled(self) -> Any:
        """The usual value; the moves that change it are noted."""
        Probe.noted |= {m for m, v in self.moved.items() if not np.array_equal(v, self.usual)}
        return self.usual

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return np.asarray(self.settled(), dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **how: Any) -> Any:
        out = Probe.of(lambda *values: getattr(ufunc, method)(*values, **how), *inputs)
        kept = np.ndim(out.usual) == 0 and not isinstance(out.usual, (bool, np.bool_))
        return out if kept else out.settled()


def _operator(function: Callable[..., Any], *, turned: bool = False, settles: bool = False) -> Any:
    def method(*arguments: Any) -> Any:
        if any(isinstance(a, np.ndarray) for a in arguments):
            return NotImplemented
        out = Probe.of(function, *(arguments[::-1] if turned else arguments))
        return out.settled() if settles else out

    return method


for _name in ("add", "sub", "mul", "truediv", "floordiv", "pow", "mod"):
    setattr(Probe, f"__{_name}__", _operator(getattr(operator, _name)))
    setattr(Probe, f"__r{_name}__", _operator(getattr(operator, _name), turned=True))
for _name in ("neg", "abs"):
    setattr(Probe, f"__{_name}__", _operator(getattr(operator, _name)))
for _name in ("lt", "le", "gt", "ge", "eq", "ne", "index"):
    setattr(Probe, f"__{_name}__", _operator(getattr(operator, _name), settles=True))
for _kind in (float, int, bool, round, hash, format):
    setattr(Probe, f"__{_kind.__name__}__", _operator(_kind, settles=True))


@dataclass(frozen=True, eq=False)
class Watched(Policy):
    """The usual policy, watched; the mark keeps one recording from another's cached thresholds."""

    mark: str = ""
    read: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if name not in NAMES:
            return value
        Watched.read.add(name)
        moved = {(name, f): getattr(Policy().moved(name, f), name) for f in FACTORS}
        if isinstance(value, tuple):
            return tuple(Probe(v, {m: other[k] for m, other in moved.items()}) for k, v in enumerate(value))
        return Probe(value, moved)

    def __hash__(self) -> int:
        return hash(self.mark)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Watched) and other.mark == self.mark
