"""Options and arguments of the commands: one spelling, one unit and one meaning each, in one table (``options.txt``).

What a command is about is an argument; ``--output`` (``-o``) is what it makes, ``--page`` its HTML page. Quantities are text with their unit.
A command says ``option("--skip", "0 s")``, with words of its own only where the table's do not tell what it does with it. A command of many
options takes one object, whose fields they are (:class:`Arguments`); options that several commands share are an object inside it.
``tests/test_options.py`` holds every command to the table.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, dataclass_transform, get_type_hints

import typer

#: Largest counts that an option takes: what is above is a slip of the keyboard, and would end in a lack of memory. Threads or processes; the
#: largest machines have some hundreds of cores.
WORKERS = 1024
#: Flights, recordings, simulated signals or trials; as of a scenario.
DRAWS = 100_000
#: Linear realizations, whose cost is about a hundredth of a flight's.
LINEAR = 1_000_000

_ROWS = [
    line.split(" | ")
    for line in (Path(__file__).parent / "options.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]
#: Argument -> what it means unless a command says more.
ARGUMENTS = {row[0]: row[1] for row in _ROWS if len(row) == 2}
#: Option -> (what follows it, what it means unless a command says more). Nothing follows a switch.
OPTIONS = {row[0]: (row[1], row[2]) for row in _ROWS if len(row) == 3}
SHORT = {"--output": "-o", "--model": "-m", "--columns": "-c", "--general": "-g"}


def cores(given: int | None) -> int:
    """Work items at a time: all cores where no number is given."""
    return given or os.cpu_count() or 1


_LIMITS: dict[str, dict[str, Any]] = {
    "--workers": {"min": 1, "max": WORKERS, "callback": cores},
    "--seed": {"min": 0},
    "--realizations": {"min": 2, "max": DRAWS},
    "--realization": {"min": 0, "max": DRAWS},
    "--linear": {"min": 0, "max": LINEAR},
}


def option(name: str, default: Any, words: str = "", **limits: Any) -> Any:
    """An option of the table, for the signature of a command.

    Parameters
    ----------
    name : str
        As in the table.
    default
        ``...`` where it has to be given. A switch that is on has a ``--no-`` form.
    words : str
        What the command does with it, where that is more than the table says.
    **limits
        ``min`` and ``max`` of a number.
    """
    follows, usual = OPTIONS[name]
    spelled = [f"{name}/--no-{name[2:]}" if default is True else name, *([SHORT[name]] if name in SHORT else [])]
    return typer.Option(
        default, *spelled, metavar=follows or None, help=words or usual, **(_LIMITS.get(name, {}) | limits)
    )


def argument(name: str, words: str = "", default: Any = ...) -> Any:
    """An argument of the table, for the signature of a command.

    Parameters
    ----------
    name : str
        As in the table.
    words : str
        What it is here, where that is more than the table says.
    default
        Of one that may be left out.
    """
    return typer.Argument(default, metavar=name, help=words or ARGUMENTS[name])


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Arguments:
    """Arguments and options of a command, one field each in the order of its help; a subclass is a frozen dataclass."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


def spread(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer calls it, with one keyword for each field of its :class:`Arguments`."""
    kinds = [hint for hint in get_type_hints(command).values() if _are_arguments(hint)]
    if not kinds:
        return command

    def called(**given: Any) -> None:
        command(_made(kinds[0], given))

    called.__signature__ = inspect.Signature(_parameters(kinds[0]))  # type: ignore[attr-defined]
    called.__doc__ = command.__doc__
    return called


def _are_arguments(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Arguments)


def _parameters(kind: Any) -> list[inspect.Parameter]:
    """Every field as a keyword, those of an object inside in its place."""
    hints, out = get_type_hints(kind), []
    for f in fields(kind):
        if _are_arguments(hints[f.name]):
            out += _parameters(hints[f.name])
        else:
            out.append(
                inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=hints[f.name])
            )
    return out


def _made(kind: Any, given: dict[str, Any]) -> Any:
    hints = get_type_hints(kind)
    return kind(**{n: _made(h, given) if _are_arguments(h) else given[n] for n, h in hints.items()})
