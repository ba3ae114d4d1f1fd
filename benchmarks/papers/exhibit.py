"""One table or figure of a paper: printed and computed cells, statements that were checked, and the verdict that follows from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

#: Short name of a paper -> how it is cited.
PAPERS = {
    "gmwm2014": "Stebler, Guerrier, Skaloud, Victoria-Feser, IEEE TAES 2014",
    "em2011": "Stebler, Guerrier, Skaloud, Victoria-Feser, Meas. Sci. Technol. 2011",
    "ml2016": "Nikolic, Furgale, Melzer, Siegwart, IEEE Sensors J. 2016",
    "platform2016": "Balamuta, Guerrier, Molinari, Yang 2016",
    "mems2013": "Quinchia, Falco, Falletti, Dovis, Ferrer, Sensors 2013",
}


@dataclass(frozen=True)
class Cell:
    """A printed number beside ours with an interval; it agrees inside the interval, or within ``tolerance`` of the printed number."""

    what: str
    printed: float
    ours: float
    low: float
    high: float
    unit: str = ""
    tolerance: float = 0.0

    @property
    def agrees(self) -> bool:
        return self.low <= self.printed <= self.high or abs(self.ours - self.printed) <= self.tolerance * abs(
            self.printed
        )

    @classmethod
    def of_draws(
        cls, what: str, printed: float, draws: Any, unit: str = "", tolerance: float = 0.0, k: float = 3.0
    ) -> Cell:
        """From draws of ours: their mean, and ``k`` standard deviations of one draw about it (a paper has one record).

        Draws of one sign are taken as logarithms, so that an interval keeps the sign.
        """
        values = np.asarray(draws, dtype=float)
        sign = np.sign(values[0])
        alike = bool((values * sign > 0).all())
        plain = np.log(values * sign) if alike else values
        spread = k * float(plain.std(ddof=1)) if values.size > 1 else 0.0
        ends = [float(plain.mean()) + d for d in (0.0, -spread, spread)]
        mean, low, high = (float(sign) * math.exp(x) for x in ends) if alike else ends
        return cls(what, printed, mean, min(low, high), max(low, high), unit, tolerance)


@dataclass(frozen=True)
class Statement:
    """A finding that the paper states in words or shows in a picture, what we measured, and whether it holds."""

    text: str
    measured: str
    holds: bool


@dataclass(frozen=True)
class Grid:
    """A table beside: what it is about, its header and its rows."""

    caption: str
    header: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Content:
    """What an exhibit shows; ``because`` says why cells do not agree, where they do not."""

    cells: list[Cell] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    because: str = ""
    interval: str = ""
    grids: list[Grid] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """Follows from cells and statements alone."""
        cells = all(c.agrees for c in self.cells)
        said = all(s.holds for s in self.statements)
        if self.cells and cells and said:
            return "reproduced"
        if self.statements and said:
            return "reproduced in kind"
        return f"not, because {self.because or 'the figures disagree'}"

    def encode(self) -> dict[str, Any]:
        plain = asdict(self)
        for said in plain["statements"]:
            said["holds"] = bool(said["holds"])  # NumPy's are no JSON
        return plain

    @classmethod
    def decode(cls, data: dict[str, Any]) -> Content:
        cells, said = [Cell(**c) for c in data["cells"]], [Statement(**s) for s in data["statements"]]
        return cls(cells, said, data["because"], data["interval"], [Grid(**g) for g in data["grids"]])


@dataclass(frozen=True)
class Task:
    """What an exhibit is computed from."""

    printed: dict[str, Any]
    seed: int
    full: bool

    def draws(self, quick: int, full: int) -> list[np.random.Generator]:
        """As many generators as the size of the run asks for."""
        return np.random.default_rng(self.seed).spawn(full if self.full else quick)


@dataclass(frozen=True)
class Exhibit:
    """A table or figure."""

    paper: str
    label: str
    title: str
    make: Callable[[Task], Content]

    @property
    def key(self) -> str:
        return f"{self.paper}/{self.label}"


EXHIBITS: list[Exhibit] = []


def exhibit(paper: str, label: str, title: str) -> Callable[[Callable[[Task], Content]], Callable[[Task], Content]]:
    """Enter a function among the exhibits."""

    def enter(make: Callable[[Task], Content]) -> Callable[[Task], Content]:
        EXHIBITS.append(Exhibit(paper, label, title, make))
        return make

    return enter
