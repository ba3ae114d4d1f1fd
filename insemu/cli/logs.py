"""Logs at rest as commands take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from insemu import units

if TYPE_CHECKING:
    from insemu.records import Series

#: Fewest samples of a log.
LEAST = 16


def hertz(rate: str) -> float | None:
    """A rate that an option gives, Hz; None where it gives none."""
    return units.parse(rate, "Hz") if rate else None


def column_names(texts: Sequence[str] | None) -> list[str] | None:
    """Names of ``-c gx,gy -c gz`` one by one; None where no column is asked for."""
    return [name.strip() for text in texts or [] for name in text.split(",") if name.strip()] or None


def read_static(file: str, rate: str, columns: list[str] | None, skip: str = "0 s") -> list[Series]:
    """The columns of a static log without its first part."""
    from dataclasses import replace

    from insemu.errors import InputError
    from insemu.logs import open_log

    series = open_log(file, hertz(rate), column_names(columns)).series(gaps=True)
    seconds = units.parse(skip, "s")
    if seconds < 0:
        raise InputError(f"--skip is {skip}, expected a duration that is not negative")
    out = []
    for s in series:
        first = round(seconds * s.rate_hz)
        if len(s) - s.missing < LEAST:
            raise InputError(f"{s.name} has {len(s) - s.missing} samples, expected at least {LEAST}", where=file)
        rest = replace(s, values=s.values[first:]) if first else s
        if len(rest) - rest.missing < LEAST:
            raise InputError(f"--skip {skip} leaves less than {LEAST} of the {len(s)} samples of {s.name}", where=file)
        out.append(rest)
    return out
