"""Delimited text: a header (or none) and a block of numbers, with the line named where something is wrong."""

from __future__ import annotations

import gzip
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.decoding import decoding, open_text
from insemu.whole import put

Array = NDArray[np.float64]

_SUFFIXES = (".csv", ".txt", ".tsv", ".dat")
_MISSING = ("", "nan", "na", "null", "none", "-nan")


def is_text(path: Path) -> bool:
    """Whether the path names delimited text (possibly gzipped)."""
    name = path.name.lower()
    return name.endswith(_SUFFIXES) or name.endswith(tuple(s + ".gz" for s in _SUFFIXES))


def _delimiter(line: str) -> str | None:
    return next((d for d in (",", ";", "\t") if d in line), None)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_table(path: Path) -> tuple[list[str] | None, Array]:
    """Return the header cells (None where the first line is numbers) and the (n, k) block; empty cells are NaN.

    Lines that start with ``#`` or ``%`` and empty lines before the header are skipped.

    Raises
    ------
    InputError
        A cell that is not a number, a line with another number of cells, no data: with the line's number.
    """
    with decoding(path, "text"):
        with open_text(path) as file:
            skipped = 0
            line = file.readline()
            while line and (not line.strip() or line.lstrip()[0] in "#%"):
                skipped += 1
                line = file.readline()
            if not line:
                raise InputError("is empty, expected a header and rows of numbers", where=str(path))
            delimiter = _delimiter(line)
            cells = [c.strip().strip('"') for c in (line.strip().split(delimiter) if delimiter else _single(line))]
            header = None if all(_is_number(c) or c.lower() in _MISSING for c in cells) else cells
            first = skipped + (header is not None)
            if header is None:
                file.seek(0)
                for _ in range(skipped):
                    file.readline()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # "no data": said below, with the file's name
                    block = np.loadtxt(file, delimiter=delimiter, ndmin=2, dtype=np.float64)
            except ValueError:
                block = None
    if header is not None and delimiter is None and block is not None and block.size and block.shape[1] == 1:
        header = cells = [line.strip().strip('"')]  # one column: its header may hold blanks
    if block is None or block.size == 0 or block.shape[1] != len(cells):
        with decoding(path, "text"):
            block = _slow(path, delimiter, first, len(cells))
    return header, block


def _single(line: str) -> list[str]:
    """Split a line without commas: blanks separate numbers, but a header of one column may hold blanks."""
    parts = line.split()
    return parts if all(_is_number(p) for p in parts) else ([line.strip()] if "[" in line or "(" in line else parts)


def _slow(path: Path, delimiter: str | None, first: int, width: int) -> Array:
    """Cell by cell: accepts empty cells, and finds the line that is wrong."""
    rows: list[list[float]] = []
    with open_text(path) as file:
        for number, line in enumerate(file, start=1):
            if number <= first or not line.strip() or line.lstrip()[0] in "#%":
                continue
            cells = line.rstrip("\r\n").split(delimiter)
            if len(cells) != width:
                raise InputError(
                    f"has {len(cells)} cell(s), expected {width} as in the header", where=f"{path}, line {number}"
                )
            row = []
            for k, cell in enumerate(cells):
                text = cell.strip().strip('"')
                if text.lower() in _MISSING:
                    row.append(np.nan)
                elif _is_number(text):
                    row.append(float(text))
                else:
                    raise InputError(
                        f"found '{text[:40]}' in column {k + 1}, expected a number", where=f"{path}, line {number}"
                    )
            rows.append(row)
    if not rows:
        raise InputError("has no rows of numbers after the header", where=str(path))
    return np.array(rows)


def write_table(path: Path, header: list[str], block: Array) -> None:
    """Write CSV; numbers are printed so that reading gives them back exactly.

    Parameters
    ----------
    path : Path
        Compressed where it ends in ``.gz``.
    header : list of str
        Names of the k columns, with their units.
    block : (n, k) array
        Values in those units.
    """
    text = "\n".join([",".join(header), *(",".join(map(repr, row)) for row in block.tolist())]) + "\n"
    if path.name.endswith(".gz"):
        put(path, gzip.compress(text.encode(), mtime=0))
    else:
        put(path, text)
