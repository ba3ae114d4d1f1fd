"""When something began that did not last throughout: evidence of every start, coarsely everywhere and closely about the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.gap.verdict import Value

Array = NDArray[np.float64]

#: Starts in each cell about the best one, and cells to either side of it that are tried as closely.
PER_CELL, CLOSE_CELLS = 20, 1


@dataclass(frozen=True)
class Starts:
    """Evidence of a start at some times, each of which stands for a cell of time around it.

    Parameters
    ----------
    times, cells : (k,) arrays
        Middle and width of each cell, s.
    logs : (k,) array
        Log Bayes factor of a start in the middle of each.
    """

    times: Array
    cells: Array
    logs: Array

    @classmethod
    def even(cls, times: Array, logs: Array) -> Starts:
        """At evenly spaced times.

        Parameters
        ----------
        times, logs : (k,) arrays
        """
        return cls(times, np.full(times.size, times[1] - times[0]), logs)

    @property
    def best(self) -> float:
        """The best start, s."""
        return float(self.times[int(np.argmax(self.logs))])

    @property
    def nats(self) -> float:
        """Log Bayes factor of a start that is as likely at any time."""
        return float(np.logaddexp.reduce(self.logs + np.log(self.cells / self.cells.sum())))

    def with_more(self, times: Array, cells: Array, logs: Array) -> Starts:
        """The same with more starts, in the place of those in their cells.

        Parameters
        ----------
        times, cells, logs : (m,) arrays
            Apart from one another.
        """
        kept = (np.abs(self.times[:, None] - times) > 0.5 * cells).all(axis=1)
        return Starts(
            np.concatenate([self.times[kept], times]),
            np.concatenate([self.cells[kept], cells]),
            np.concatenate([self.logs[kept], logs]),
        )

    def refined(self, logs_of: Callable[[Array], Array], cells: int = CLOSE_CELLS) -> Starts:
        """The same with more starts in the cells about the best one; of starts as :meth:`even` makes them.

        Parameters
        ----------
        logs_of : callable
            Evidence (k,) of starts (k,), s.
        cells : int
            To either side of the best one.
        """
        cell = float(self.cells[0]) / PER_CELL
        near = np.abs(self.times - self.best) < (cells + 0.5) * self.cells[0]
        begin = float(self.times[near][0]) - 0.5 * float(self.cells[0])
        times = np.asarray(begin + cell * (np.arange(int(near.sum()) * PER_CELL) + 0.5), dtype=np.float64)
        return Starts(
            np.concatenate([times, self.times[~near]]),
            np.concatenate([np.full(times.size, cell), self.cells[~near]]),
            np.concatenate([logs_of(times), self.logs[~near]]),
        )

    def estimate(self) -> Value:
        """The best start with its 95 % interval, s."""
        order = np.argsort(self.times)
        share = (np.exp(self.logs - self.logs.max()) * self.cells)[order]
        reached = np.cumsum(share) / share.sum()
        low, high = (order[int(np.searchsorted(reached, q))] for q in (0.025, 0.975))
        early, late = self.times - 0.5 * self.cells, self.times + 0.5 * self.cells
        return Value("start", self.best, float(min(early[low], self.best)), float(max(late[high], self.best)), "s")
