"""The one exception that means "your input is wrong", with the place where it is wrong."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

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
