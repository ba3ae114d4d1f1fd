"""The text of a noise model, taken apart: ``2*GM() + WN(N=0.032 deg/s/sqrt(Hz))``."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from insemu import units
from insemu.errors import InputError, nearest, shown

#: What the field calls a process, with its parameter: the name of the process.
ALIASES: Mapping[str, str] = {"ARW": "WN", "VRW": "WN", "RRW": "RW"}

#: Processes of one model, and characters of its text, that are read.
MOST_PROCESSES, LONGEST_TEXT = 100, 4_000

_TERM = re.compile(
    r"^\s*(?:(?P<count>[0-9]{1,9})\s*\*\s*)?(?P<name>[A-Za-z]\w*)\s*(?:\((?P<arguments>.*)\))?\s*$", re.DOTALL
)


#: A whole number of an order.
_WHOLE = re.compile("[0-9]{1,9}")


def _split(text: str, separator: str) -> list[str]:
    """Split at a separator outside brackets (and outside exponents such as 1e+3)."""
    parts, depth, start = [], 0, 0
    for i, ch in enumerate(text):
        depth += ch in "(["
        depth -= ch in ")]"
        if ch == separator and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [*parts, text[start:]]


def terms(text: str, known: Collection[str]) -> Iterator[tuple[int, str, list[int], dict[str, Any]]]:
    """Yield count, name, unnamed whole numbers and named arguments of every term of a sum.

    Parameters
    ----------
    text : str
        The model.
    known : collection of str
        Names of processes.

    Raises
    ------
    InputError
        Anything but ``[count*]NAME(arguments)``, or an unknown name.
    """
    if len(text) > LONGEST_TEXT:
        raise InputError(f"the model {shown(text)} has {len(text)} characters, expected at most {LONGEST_TEXT}")
    total = 0
    for term in _split(text, "+"):
        match = _TERM.match(term)
        if match is None:
            raise InputError(
                f"cannot read {shown(term.strip())} in the model {shown(text)}; expected something like 2*GM() or WN(N=1e-3)"
            )
        name = ALIASES.get(match["name"], match["name"])
        if name not in known:
            raise InputError(f"unknown process {shown(name)} in the model {shown(text)}" + nearest(name, known))
        count = int(match["count"] or 1)
        total += count
        if not 1 <= count <= MOST_PROCESSES:
            raise InputError(
                f"found {count} times {name} in the model {shown(text)}, expected a whole number from 1 to {MOST_PROCESSES}"
            )
        if total > MOST_PROCESSES:
            raise InputError(f"the model {shown(text)} has more than {MOST_PROCESSES} processes")
        yield count, name, *_arguments(name, match["arguments"] or "", text)


def _arguments(name: str, arguments: str, text: str) -> tuple[list[int], dict[str, Any]]:
    orders: list[int] = []
    given: dict[str, Any] = {}
    for argument in _split(arguments, ","):
        argument = argument.strip()
        if not argument:
            continue
        if "=" in argument:
            key, value = (part.strip() for part in argument.split("=", 1))
            if key in given:
                raise InputError(f"found {shown(key)} twice in {name} of the model {shown(text)}")
            given[key] = (
                [v.strip() for v in value.strip("([)] ").split(",") if v.strip()] if value[:1] in "([" else value
            )
        elif _WHOLE.fullmatch(argument):
            orders.append(int(argument))
        else:
            raise InputError(
                f"cannot read {shown(argument)} in {name} of the model {shown(text)}; expected name=quantity"
            )
    return orders, given


def whole(value: object) -> int | None:
    """A whole number of at least 0 that is given as one or as text; None for anything else."""
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 10**9:
        return value
    return int(value) if isinstance(value, str) and _WHOLE.fullmatch(value) else None


def quantity(value: Any, unit: str, where: str) -> float:
    """A number in SI, or text with a unit of the dimension of ``unit``; raises ``InputError`` at ``where``.

    Parameters
    ----------
    value : float or str
        A number in SI, or a number with a unit.
    unit : str
        SI unit that is expected.
    where : str
        Key, for messages.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"found {shown(value)}, expected a quantity in {unit}", where=where)
    try:
        return units.parse(value, unit)
    except InputError as error:
        raise InputError(error.message, where=where) from None
