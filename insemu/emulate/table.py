"""Small tables of motion: text files whose header names columns with units, read with file and line in every message; and the limits of size."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import units
from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

#: A name and a unit in brackets.
_HEADER = re.compile(r"^([^\[(]+)[\[(](.*)[\])]$")
#: Longest heading that is read.
_LONGEST_HEADING = 60
_WRITTEN = {"kmh": "km/h", "kph": "km/h", "kts": "kn", "knots": "kn", "feet": "ft", "mps": "m/s", "ms": "m/s"}
#: Most nodes of a path or a record, about 24 h at 1 kHz, and the memory that one takes while it is made, bytes (measured: 0.2 kB per sample of an
#: ideal IMU, 1.5 kB per knot of a path).
MOST_NODES, SAMPLE_BYTES, KNOT_BYTES = 100_000_000, 200, 1500


def memory_there() -> float:
    """Memory of the machine, bytes; a common size where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return 8e9


def check_size(count: float, bytes_each: int, what: str) -> None:
    """Raise ``InputError`` with an estimate where more samples or knots are asked for than this machine can hold.

    Parameters
    ----------
    count : float
    bytes_each : int
        Memory that each takes.
    what : str
        Starts the message: what asks for them.
    """
    most = min(float(MOST_NODES), memory_there() / bytes_each)
    if not count <= most:
        raise InputError(
            f"{what} asks for {count:.3g} samples, about {count * bytes_each / 1e9:.3g} GB; expected at most {most:.3g} on this machine"
        )


def text_of(path: Path, what: str) -> str:
    """Text of a file; ``what`` names it in messages."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"no such {what} file", where=str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", where=str(path)) from None


def rows_of(text: str, source: str) -> list[tuple[int, list[str]]]:
    """Rows of a CSV that are neither empty nor comments, with their line numbers."""
    try:
        rows = [(k + 1, row) for k, row in enumerate(csv.reader(text.splitlines()))]
    except csv.Error as error:
        raise InputError(f"cannot be read as CSV ({error})", where=source) from None
    return [(k, row) for k, row in rows if any(c.strip() for c in row) and not row[0].startswith("#")]


def number(cell: str, name: str, where: str, *, finite: bool = True) -> float:
    """A cell as a number.

    Parameters
    ----------
    cell, name, where : str
        Text, name of its column, file and line.
    finite : bool
        Whether NaN is refused.
    """
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"found '{cell.strip():.40}' for {name}, expected a number", where=where) from None
    if finite and not np.isfinite(value):
        raise InputError(f"found '{cell.strip():.40}' for {name}, expected a finite number", where=where)
    return value


def read_columns(
    text: str,
    source: str,
    names: Mapping[str, str],
    unit: Mapping[str, str],
    assumed: Mapping[str, str],
    required: Collection[str],
    open_columns: Collection[str] = (),
) -> tuple[dict[str, Array], list[int]]:
    """Columns of a CSV with a header, in SI.

    Parameters
    ----------
    text, source : str
        What is read, and its name in messages.
    names : mapping
        Headings to columns.
    unit, assumed : mapping
        Columns to the unit in which they are returned, and to the one that they have where the header says none.
    required : collection of str
        Columns that must be there.
    open_columns : collection of str
        Columns in which NaN says that a value is missing.

    Returns
    -------
    columns : dict of str to (n,) array
    lines : list of int
        Line of every row.

    Raises
    ------
    InputError
        With file and line.
    """
    rows = rows_of(text, source)
    if not rows:
        raise InputError("empty, expected a header and rows of numbers", where=source)
    line, header = rows[0]
    columns: dict[str, tuple[int, float]] = {}
    for k, cell in enumerate(header):
        heading = cell.strip()
        match = _HEADER.match(heading) if len(heading) <= _LONGEST_HEADING else None
        name, given = (match.group(1).strip().lower(), match.group(2)) if match else (heading.lower(), "")
        if name not in names and "_" in name:  # speed_kmh
            name, _, given = name.partition("_")
        if name not in names:
            raise InputError(f"unknown column '{heading:.60}'" + nearest(name, names), where=f"{source}:{line}")
        key = names[name]
        given = given.strip() or assumed[key]
        try:
            columns[key] = (k, units.conversion(_WRITTEN.get(given, given), unit[key]))
        except InputError as error:
            raise InputError(f"column '{heading}': {error.message}", where=f"{source}:{line}") from None
    missing = [key for key in required if key not in columns]
    if missing:
        raise InputError(f"no column for {', '.join(missing)} in the header", where=f"{source}:{line}")
    out = {key: np.empty(len(rows) - 1) for key in columns}
    for n, (line, row) in enumerate(rows[1:]):
        if len(row) != len(header):
            raise InputError(f"{len(row)} cells, expected {len(header)}", where=f"{source}:{line}")
        for key, (k, factor) in columns.items():
            out[key][n] = factor * number(row[k], key, f"{source}:{line}", finite=key not in open_columns)
    return out, [line for line, _ in rows[1:]]
