"""Bars of progress, which without a terminal become lines at a steady rate."""

from __future__ import annotations

import time
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class Bars(Progress):
    """Bars with the time that has passed and the time left; where the console is no terminal a line every ``every_s`` seconds.

    Parameters
    ----------
    console : Console
    every_s : float
    """

    def __init__(self, console: Console, every_s: float) -> None:
        super().__init__(
            TextColumn("{task.description:<34}", markup=False),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("elapsed"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
        )
        self._every_s, self._told = every_s, time.monotonic()

    def update(self, task_id: TaskID, **what: Any) -> None:
        """Update a bar, or say how far it is."""
        super().update(task_id, **what)
        now = time.monotonic()
        if self.console.is_terminal or now - self._told < self._every_s:
            return
        self._told = now
        task = self.tasks[self.task_ids.index(task_id)]
        times = {"elapsed": task.elapsed, "left": task.time_remaining}
        said = [f"{timedelta(seconds=round(t))} {word}" for word, t in times.items() if t is not None]
        line = f"{task.description}: {task.completed:.0f} of {task.total or 0:.0f}, {', '.join(said)}"
        self.console.print(line, soft_wrap=True, highlight=False, markup=False)
