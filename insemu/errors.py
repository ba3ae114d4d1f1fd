"""The one exception that means "your input is wrong", with the place where it is wrong."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

#: How NumPy shows its scalars, which means nothing to a reader.
_NUMPY = re.compile(r"np\.(?:float|int|uint|str|bool)\w*\(([^()]*)\)")


class InputError(ValueError):
    """Input that cannot be used: the message names where, what was found and what was expected.

    Commands turn it into one readable line and exit code 2; nothing is written.

    Parameters
    ----------
    message : str
        What was found and what was expected.
    where : str, optional
        File, line or key; put in front of the message.
    """

    def __init__(self, message: str, *, where: str | None = None) -> None:
        self.where = where
        self.message = message = _NUMPY.sub(r"\1", message)
        super().__init__(f"{where}: {message}" if where else message)


@contextmanager
def found_at(where: str) -> Iterator[None]:
    """Errors of the input inside say this place: a file, line or key."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, where=where) from None


#: Characters of a value in a message, and members of a list or mapping that are spelt.
LONGEST, MEMBERS = 80, 20


def shown(value: object) -> str:
    """A value that was found as a message shows it: printable, and never longer than a line.

    >>> shown("rate"), shown(list(range(50)))
    ("'rate'", 'list of 50')
    """
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 128:
        return f"an integer of {value.bit_length()} bits"  # Python refuses to print very long ones
    if isinstance(value, list | tuple | dict) and len(value) >= MEMBERS:
        return f"{type(value).__name__} of {len(value)}"
    try:
        text = repr(value)
    except ValueError:  # a very long integer inside
        text = f"{type(value).__name__}"
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Return a hint such as ``" (did you mean 'rate'?)"``, or the list of what exists.

    >>> nearest("raet", ["rate", "model"])
    " (did you mean 'rate'?)"
    """
    known = sorted(map(str, candidates))
    close = difflib.get_close_matches(str(name)[:100], known, n=1, cutoff=0.5)
    if close:
        return f" (did you mean '{close[0]}'?)"
    return f" (expected one of: {', '.join(known)})"
