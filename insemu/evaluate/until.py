"""Realizations until an interval is as narrow as was asked for, with the looks in between paid for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.evaluate.results import Results, runs_of
from insemu.evaluate.tally import DURING
from insemu.scenario import MAX_REALIZATIONS

#: Error probability of all intervals together, and realizations of the first look; each further look has a half more.
ALPHA, FIRST, GROWTH = 0.05, 24, 1.5
FIGURES = tuple(name.removesuffix("_m") for name in ("planimetric_end_m", *DURING))
_GOAL = re.compile(r"(?P<figure>\w+) (?P<what>ratio|mean) (?P<designs>.+) within (?P<share>[\d.]+) ?%")


@dataclass(frozen=True)
class Look:
    """What was seen with so many realizations.

    Parameters
    ----------
    realizations : int
    value, low, high : float
        The figure and its interval, which holds at whichever look one stops.
    reached : bool
    """

    realizations: int
    value: float
    low: float
    high: float
    reached: bool


@dataclass(frozen=True)
class Goal:
    """An interval that is asked for.

    Parameters
    ----------
    figure : str
        Of an outage, averaged over the outages.
    designs : tuple of str
        One: its mean. Two: the ratio of the first one's mean to the second one's.
    within : float
        Largest half width of the interval, as a share of the value.
    """

    figure: str
    designs: tuple[str, ...]
    within: float

    @classmethod
    def parse(cls, text: str, names: list[str]) -> Goal:
        """Read ``planimetric_end ratio model 3/model 1 within 5 %`` or ``planimetric_end mean model 3 within 5 %``.

        Parameters
        ----------
        text : str
        names : list of str
            Designs that there are.

        Raises
        ------
        InputError
            Anything else, an unknown figure or design.
        """
        found = _GOAL.fullmatch(text.strip())
        if found is None or not (share := float(found["share"]) if found["share"].count(".") < 2 else 0.0) > 0:
            raise InputError(
                f"found '{text}', expected for example 'planimetric_end ratio {names[-1]}/{names[0]} within 5 %'",
                where="--until",
            )
        figure = found["figure"].removesuffix("_m")
        if figure not in FIGURES:
            raise InputError(f"unknown figure '{figure}'" + nearest(figure, FIGURES), where="--until")
        asked = found["designs"].split("/") if found["what"] == "ratio" else [found["designs"]]
        designs = tuple(d.strip() for d in asked)
        for name in designs:
            if name not in names:
                raise InputError(f"no design '{name}'" + nearest(name, names), where="--until")
        if len(designs) != (2 if found["what"] == "ratio" else 1):
            raise InputError(f"found '{found['designs']}', expected two designs, FIRST/SECOND", where="--until")
        return cls(f"{figure}_m", designs, share / 100.0)

    def look(self, results: Results, number: int) -> Look:
        """Look at some realizations.

        The interval at look k has an error probability of ``6 / (pi k)^2`` times that of all together, so that by the union bound all of them hold,
        and so does the one at which one stops, however that was chosen.

        Parameters
        ----------
        results : Results
        number : int
            Of the look, from 1.
        """
        values = [self._pooled(results, name) for name in self.designs]
        n, level = results.realizations, ALPHA * 6.0 / (math.pi * number) ** 2
        if len(values) == 1:
            value, left = float(values[0].mean()), values[0]
        else:
            value = float(values[0].mean() / values[1].mean())
            left = (values[0] - value * values[1]) / values[1].mean()
        half = float(scipy.special.stdtrit(n - 1, 1.0 - 0.5 * level) * left.std(ddof=1) / math.sqrt(n))
        return Look(n, value, value - half, value + half, half <= self.within * abs(value))

    def _pooled(self, results: Results, design: str) -> NDArray[np.float64]:
        each = [runs_of(results, design, k, self.figure) for k in range(len(results.outages))]
        return np.asarray(np.mean(each, axis=0))


def looks() -> Iterator[int]:
    """Numbers of realizations at which one looks."""
    n = FIRST
    while n < MAX_REALIZATIONS:
        yield n
        n = math.ceil(GROWTH * n)
    yield MAX_REALIZATIONS
