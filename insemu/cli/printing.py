"""Tables and progress on the terminal: what does not fit is left out at the right and said, rather than cut."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


#: Columns that a table keeps on the narrowest terminal.
LEAST = 3
#: Characters of a stage's name next to its bar.
STAGE = 34
#: Stages of the gap workflow on a drive with one effect, for the time left.
STAGES = 14
#: Where there is no terminal to draw on: seconds between two lines of progress that differ in numbers alone, and before the first line.
EVERY_S, PATIENCE_S = 20.0, 2.0


def bars(console: Console) -> Progress:
    """Bars of progress with the time that has passed and the time left; without a terminal a line every :data:`EVERY_S`."""
    from insemu.cli.bars import Bars

    return Bars(console, EVERY_S)


def _lines() -> Callable[[str], None]:
    """What is reported of the work, as lines on standard error.

    Work that is done within :data:`PATIENCE_S` says nothing, and a text that repeats the last one with other numbers waits for
    :data:`EVERY_S`.
    """
    import re
    import time

    import typer

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
    with bars(console) as shown:
        task = shown.add_task(label, total=total)
        yield lambda done, of, what: shown.update(task, completed=done, total=of, description=f"{label} ({what})")
        shown.update(task, description=label)


def print_table(
    console: Console,
    title: str,
    header: Sequence[str],
    body: Sequence[Sequence[str]],
    *,
    left: int = 2,
    fit: bool = False,
    gap: Callable[[Sequence[str]], bool] = lambda row: bool(row[0]),
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
    gap : callable
        Whether an empty line stands before a row.
    """
    from rich.table import Table

    widths = [max(len(str(row[k])) for row in (header, *body)) for k in range(len(header))]
    shown = len(header)
    while fit and shown > LEAST and sum(widths[:shown]) + 2 * (shown - 1) > console.width:
        shown -= 1
    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="underline")
    for k, heading in enumerate(header[:shown]):
        table.add_column(heading, justify="left" if k < left else "right", no_wrap=True)
    for i, row in enumerate(body):
        if i and gap(row):
            table.add_row()
        table.add_row(*row[:shown])
    console.print(f"\n{title}", soft_wrap=True, highlight=False, markup=False)
    width = console.width
    console.width = max(width, sum(widths[:shown]) + 2 * shown)
    console.print(table)
    console.width = width
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
    with bars(console) as shown:
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
        console.print(f"- {line}", soft_wrap=True, highlight=False, markup=False)
