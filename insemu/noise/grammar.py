"""The text of a noise model, taken apart: ``2*GM() + WN(N=0.032 deg/s/sqrt(Hz))``."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from insemu import units
from insemu.errors import InputError, nearest

#: What the field calls a process, with its parameter: the name of the process.
ALIASES: Mapping[str, str] = {"ARW": "WN", "VRW": "WN", "RRW": "RW"}

_TERM = re.compile(r"^\s*(?:(?P<count>\d+)\s*\*\s*)?(?P<name>[A-Za-z]\w*)\s*(?:\((?P<arguments>.*)\))?\s*$", re.DOTALL)


#: Longest text of a model, characters, and most processes and coefficients: a sum of ten processes is a large model.
MAX_TEXT = 10_000
MAX_COUNT = 100


def whole(text: str, what: str) -> int:
    """A count or an order as written, within the limits.

    Raises
    ------
    InputError
        Zero, more than :data:`MAX_COUNT`, or no whole number.
    """
    if not (text.isdecimal() and len(text) <= 6 and 1 <= int(text) <= MAX_COUNT):
        raise InputError(f"{what} is '{text[:20]}', expected a whole number from 1 to {MAX_COUNT}")
    return int(text)


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
    if len(text) > MAX_TEXT:
        raise InputError(f"the text of the model has {len(text)} characters, expected at most {MAX_TEXT}")
    for term in _split(text, "+"):
        match = _TERM.match(term)
        if match is None:
            raise InputError(
                f"cannot read '{term.strip()}' in the model '{text}'; expected something like 2*GM() or WN(N=1e-3)"
            )
        name = ALIASES.get(match["name"], match["name"])
        if name not in known:
            raise InputError(f"unknown process '{name}' in the model '{text}'" + nearest(name, known))
        count = whole(match["count"] or "1", f"the count of {name} in the model '{text}'")
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
            given[key] = (
                [v.strip() for v in value.strip("([)] ").split(",") if v.strip()] if value[:1] in "([" else value
            )
        elif argument.isdigit():
            orders.append(whole(argument, f"an order of {name} in the model '{text}'"))
        else:
            raise InputError(
                f"cannot read '{argument}' in '{name}({arguments})' of the model '{text}'; expected name=quantity"
            )
    return orders, given


def quantity(value: Any, unit: str, where: str) -> float:
    """A number in SI, or text with a unit of the dimension of ``unit``; raises ``InputError`` at ``where``."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"found {value!r}, expected a quantity in {unit}", where=where)
    try:
        return units.parse(value, unit)
    except InputError as error:
        raise InputError(error.message, where=where) from None
