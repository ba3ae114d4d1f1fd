"""How results show themselves: ten lines in a terminal, a table in a notebook, a chart on given axes."""

from __future__ import annotations

import math
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Lines that a result prints at most.
MOST_LINES = 10
#: Smaller probabilities are not told apart.
SMALL_P = 1e-12


def few(lines: list[str], most: int = MOST_LINES) -> str:
    """At most so many lines, with the number of those left out."""
    return "\n".join(
        lines if len(lines) <= most else [*lines[: most - 1], f"... and {len(lines) - most + 1} more lines"]
    )


def count_of(count: int, what: str) -> str:
    """A number of things in words: ``1 realization``, ``24 realizations``."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def finite(document: Any) -> Any:
    """The same document with numbers that are not finite as None, which JSON can say."""
    if isinstance(document, dict):
        return {k: finite(v) for k, v in document.items()}
    if isinstance(document, list | tuple):
        return [finite(v) for v in document]
    return None if isinstance(document, float) and not math.isfinite(document) else document


def with_interval(value: float, low: float, high: float) -> str:
    """A number with its interval, in as many digits, three or more, as tell the ends apart.

    Parameters
    ----------
    value, low, high : float
    """
    digits = next((d for d in range(3, 8) if low == high or f"{low:.{d}g}" != f"{high:.{d}g}"), 8)
    return f"{value:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"


def p_words(p: float) -> str:
    """A p-value as a reader is told it."""
    return f"p {p:.2g}" if p > SMALL_P else f"p below {SMALL_P:g}"


class Shown:
    """A result that prints in ten lines (``__str__``) and has its numbers as a table."""

    def to_dataframe(self) -> pd.DataFrame:
        """The numbers as a table."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        head = escape(str(self).split("\n", 1)[0])
        return f"<p><b>{head}</b></p>{self.to_dataframe().to_html(max_rows=30, float_format=lambda v: f'{v:.4g}')}"

    def plot(self, axes: Axes | None = None, *, view: int | str = 0) -> Axes | Figure:
        """Draw the chart that a page shows of this, see :func:`insemu.report.plotting.plot` (the room that draws, found when it is needed)."""
        drawn: Axes | Figure = import_module("insemu.report.plotting").plot(self, axes, view=view)
        return drawn


R = TypeVar("R", bound=Shown)


class ByAxis(Shown, dict[str, R]):
    """Results of several axes: a mapping that shows itself."""

    def __str__(self) -> str:
        return few([str(result).split("\n", 1)[0] for result in self.values()])

    __repr__ = Shown.__repr__

    def to_dataframe(self) -> pd.DataFrame:
        """The tables of all axes under each other, with the axis in front."""
        import pandas as pd

        return pd.concat({axis: r.to_dataframe() for axis, r in self.items()}, names=["axis", None])
