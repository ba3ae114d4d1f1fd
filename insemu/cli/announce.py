"""The intake card in front of every command that reads data: what was taken, what is assumed, what is odd; what is wrong ends the command."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.printing import print_text

if TYPE_CHECKING:
    from insemu.evaluate import Experiment
    from insemu.intake import Card


def announce(file: str | Path, rate_hz: float | None = None, *, refuse: bool = True) -> Card:
    """Make the card of a file, print on standard error what is worth knowing, and end where physics contradicts it.

    Parameters
    ----------
    file : path
    rate_hz : float, optional
        Sampling rate of a log that does not say it, Hz.
    refuse : bool
        Whether a contradiction ends the command (it does not where saying so is the command's own work).

    Returns
    -------
    Card

    Raises
    ------
    InputError
        The file cannot be read; or it contradicts physics, with the command that mends it.
    """
    from insemu.intake import card_of

    card = card_of(file, rate_hz=rate_hz)
    show_brief(card, Console(stderr=True))
    return card.check() if refuse else card


def announce_world(card: Card | None, console: Console) -> None:
    """Print the card of a recorded world (none of an emulated one) and end where physics contradicts it."""
    if card is not None:
        show_brief(card, console)
        card.check()


def announce_warnings(experiments: Iterable[Experiment], console: Console) -> None:
    """Print what looks odd or implausible in experiments, once each."""
    for warning in dict.fromkeys(w for e in experiments for w in e.warnings):
        print_text(console, f"Warning: {warning}.")


def show_brief(card: Card, console: Console) -> None:
    """One line of what was found right, and every finding that is assumed, odd or wrong."""
    right = list(dict.fromkeys(x.topic for x in card.of("ok") if x.topic not in ("taken", "done")))
    said = f"{card.source}: {card.kind}" + (f"; right: {', '.join(right)}" if right else "")
    print_text(console, said, style="dim")
    for line in card.lines:
        if line.level != "ok":
            style = "dim" if line.level == "assumed" else "yellow"
            print_text(console, f"  {line}", style=style)
