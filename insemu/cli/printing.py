"""Tables and progress on the terminal: what does not fit is left out at the right and said, rather than cut."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from itertools import count
from typing import Any

import typer
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
from rich.table import Table

#: Columns that a table keeps on the narrowest terminal.
LEAST = 3
#: Characters of a stage's name next to its bar.
STAGE = 34
#: Stages of the gap workflow on a drive with one effect, for the time left.
STAGES = 14
#: Where there is no terminal to draw on: seconds between two lines of progress that differ in numbers alone, and before the first line.
EVERY_S, PATIENCE_S = 20.0, 2.0


class Bars(Progress):
    """Bars with the time that has passed and the time left; where the console is no terminal a line every :data:`EVERY_S`.

    Parameters
    ----------
    console : Console
    """

    def __init__(self, console: Console) -> None:
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
        self._told = time.monotonic()

    def update(self, task_id: TaskID, **what: Any) -> None:
        """Update a bar, or say how far it is."""
        super().update(task_id, **what)
        now = time.monotonic()
        if self.console.is_terminal or now - self._told < EVERY_S:
            return
        self._told = now
        task = self.tasks[self.task_ids.index(task_id)]
        times = {"elapsed": task.elapsed, "left": task.time_remaining}
        said = [f"{timedelta(seconds=round(t))} {word}" for word, t in times.items() if t is not None]
        line = f"{task.description}: {task.completed:.0f} of {task.total or 0:.0f}, {', '.join(said)}"
        self.console.print(line, soft_wrap=True, highlight=False, markup=False)


def _lines() -> Callable[[str], None]:
    """What is reported of the work, as lines on standard error.

    Work that is done within :data:`PATIENCE_S` says nothing, and a text that repeats the last one with other numbers waits for
    :data:`EVERY_S`.
    """
    began = when = time.monotonic()
    last = ""

    def say(text: str) -> None:
        nonlocal last, when
        words, now = re.sub(r"[0-9]+", "", text), time.monotonic()
        if now - began >= PATIENCE_S and (words != last or now - when >= EVERY_S):
            typer.echo(text, err=True)
            last, when = words, now

    return say


@contextmanager
def flying(console: Console, label: str, total: int) -> Iterator[Callable[[int, int, str], None]]:
    """One bar for the realizations of an experiment; what it yields is the experiment's ``progress``."""
    with Bars(console) as shown:
        task = shown.add_task(label, total=total)
        yield lambda done, of, what: shown.update(task, completed=done, total=of, description=f"{label} ({what})")
        shown.update(task, description=label)


def print_text(console: Console, text: str, style: str | None = None) -> None:
    """Print text as it is: wrapped by the terminal, its numbers and brackets like the rest."""
    console.print(text, style=style, soft_wrap=True, highlight=False, markup=False)


def print_json(document: Any, *, allow_nan: bool = True) -> None:
    """Print a document as JSON on standard output."""
    typer.echo(json.dumps(document, indent=1, allow_nan=allow_nan))


def plain_table() -> Table:
    """A table without lines."""
    return Table(box=None, padding=(0, 1), pad_edge=False, header_style="underline")


def print_wide(console: Console, table: Table, least: int) -> None:
    """Print a table in lines of at least so many characters; a terminal that is narrower wraps them."""
    width = console.width
    console.width = max(width, least)
    console.print(table)
    console.width = width


def print_boxed(
    console: Console, title: str, header: Sequence[str], body: Sequence[Sequence[str]], left: int = 99, bold: int = -1
) -> None:
    """Print a table in a box.

    Parameters
    ----------
    console : Console
    title : str
    header : sequence of str
    body : rows
    left : int
        Columns that are aligned left.
    bold : int
        A row that is printed bold.
    """
    table = Table(title=title, title_justify="left")
    for k, heading in enumerate(header):
        table.add_column(heading, justify="left" if k < left else "right")
    for k, row in enumerate(body):
        table.add_row(*row, style="bold" if k == bold else None)
    console.print(table)


def print_table(
    console: Console,
    title: str,
    header: Sequence[str],
    body: Sequence[Sequence[str]],
    *,
    left: int = 2,
    fit: bool = False,
    groups: bool = False,
) -> None:
    """Print a table.

    Parameters
    ----------
    console : Console
    title : str
    header : sequence of str
    body : sequence of rows
    left : int
        Columns that are aligned left.
    fit : bool
        Leave out the last columns where the terminal is too narrow for them; otherwise lines are longer than the terminal.
    groups : bool
        Whether an empty line stands before every row with a first cell.
    """
    widths = [max(len(str(row[k])) for row in (header, *body)) for k in range(len(header))]
    shown = len(header)
    while fit and shown > LEAST and sum(widths[:shown]) + 2 * (shown - 1) > console.width:
        shown -= 1
    table = plain_table()
    for k, heading in enumerate(header[:shown]):
        table.add_column(heading, justify="left" if k < left else "right", no_wrap=True)
    for i, row in enumerate(body):
        if i and groups and row[0]:
            table.add_row()
        table.add_row(*row[:shown])
    print_text(console, f"\n{title}")
    print_wide(console, table, sum(widths[:shown]) + 2 * shown)
    if shown < len(header):
        missing = ", ".join(header[shown:])
        console.print(f"(a wider terminal shows also: {missing})", style="dim", soft_wrap=True, highlight=False)


@contextmanager
def counting(console: Console, label: str, total: int) -> Iterator[Callable[[str], None]]:
    """One bar for work in ``total`` parts; what it yields is reported of each part when it is finished.

    Parameters
    ----------
    console : Console
    label : str
    total : int
    """
    finished = count(1)
    with flying(console, label, total) as step:
        yield lambda what: step(next(finished), total, what)


@contextmanager
def staged(console: Console, usual: int) -> Iterator[Callable[[str], None]]:
    """One bar for work in stages; what it yields is reported of each stage as it begins. The time left supposes the usual number of stages.

    Parameters
    ----------
    console : Console
        Where it is no terminal, stages are lines on standard error, at a steady rate.
    usual : int
        Stages that such work has; more are counted as they come.
    """
    if not console.is_terminal:
        yield _lines()
        return
    with Bars(console) as shown:
        task = shown.add_task("reading", total=usual)
        begun = 0

        def stage(text: str) -> None:
            nonlocal begun
            shown.update(task, completed=begun, total=max(usual, begun + 1), description=f"{text[:STAGE]:<{STAGE}}")
            begun += 1

        yield stage
        shown.update(task, completed=begun, total=max(begun, 1), description="finished")


def print_items(console: Console, lines: Sequence[str]) -> None:
    """Print lines as a list."""
    for line in lines:
        print_text(console, f"- {line}")
