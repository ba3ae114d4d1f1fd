"""Logs at rest as commands take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from insemu import units
from insemu.cli.options import Arguments, option

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


class LogArguments(Arguments):
    """What is read of a log at rest."""

    columns: list[str] | None = option("--columns", None)
    rate: str = option("--rate", "")
    skip: str = option("--skip", "0 s")

    def read(self, file: str) -> list[Series]:
        """The columns of a log without its first part."""
        return read_static(file, self.rate, self.columns, self.skip)


class ScaleArguments(Arguments):
    """Scales that a fit uses."""

    tau_from: str = option("--tau-from", "")
    tau_to: str = option("--tau-to", "")

    @property
    def limits(self) -> dict[str, Any]:
        """Shortest and longest scale, s, as a fit takes them; all where nothing is given."""
        given = {"tau_from": self.tau_from, "tau_to": self.tau_to}
        return {name: units.parse(text, "s") for name, text in given.items() if text}


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
