"""Delimited text: a header (or none) and a block of numbers, with the line named where something is wrong."""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.decoding import decoding, open_for_pandas, open_text
from insemu.whole import put

Array = NDArray[np.float64]

#: Rows of text that are read at once.
PIECE = 1 << 17
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


def pieces(file: Any, **options: Any) -> Iterator[Any]:
    """Yield delimited text as pandas frames of at most :data:`PIECE` rows, so that only the columns are ever held as a whole.

    Numbers are the nearest floats; columns of whole numbers stay integers.

    Parameters
    ----------
    file : file
        Of :func:`insemu.formats.decoding.open_for_pandas`, at the first row; there is no header.
    **options
        For ``pandas.read_csv``: ``sep``, ``names``, ``comment``, ``decimal``, ...
    """
    import pandas as pd

    exact = {} if pd.__version__ >= "3.1" else {"float_precision": "round_trip"}  # from 3.1 on it always is
    options = {"chunksize": PIECE, "header": None, "low_memory": False, **exact, **options}
    frames = pd.read_csv(file, **options)
    yield from frames if options["chunksize"] else [frames]


class Growing:
    """Columns that grow in place by pieces, so that no value is held twice.

    Parameters
    ----------
    width : int
        How many.
    """

    def __init__(self, width: int) -> None:
        self.rows = 0
        self._columns: list[NDArray[Any]] = [np.empty(0, dtype=np.int64) for _ in range(width)]

    def add(self, piece: Sequence[NDArray[Any]]) -> None:
        """Put a piece of every column, (n,) each, behind what is there; whole numbers become floats where floats follow."""
        end = self.rows + piece[0].size
        for k, values in enumerate(piece):
            kind = np.result_type(self._columns[k], values) if self.rows else values.dtype
            if kind != self._columns[k].dtype:
                self._columns[k] = self._columns[k].astype(kind)
            if end > self._columns[k].size:
                self._columns[k].resize(max(end, self._columns[k].size * 3 // 2), refcheck=False)
            self._columns[k][self.rows : end] = values
        self.rows = end

    def whole(self) -> list[NDArray[Any]]:
        """The columns; nothing can be added any more."""
        for column in self._columns:
            column.resize(self.rows, refcheck=False)
        return self._columns


def read_table(path: Path) -> tuple[list[str] | None, list[NDArray[Any]]]:
    """Return the header cells (None where the first line is numbers) and the k columns (n,); empty cells are NaN.

    Columns of whole numbers are integers, so that stamps in ns keep all their digits.
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
            row = next((x for x in file if x.strip() and x.lstrip()[0] not in "#%"), "")
        if header is not None and delimiter is None and len(row.split()) == 1:
            header = cells = [line.strip().strip('"')]  # one column: its header may hold blanks
        first = skipped + (header is not None)
        columns = _fast(path, delimiter, first, len(cells))
        if columns is None:
            columns = list(np.ascontiguousarray(_slow(path, delimiter, first, len(cells)).T))
    return header, columns


def _fast(path: Path, delimiter: str | None, first: int, width: int) -> list[NDArray[Any]] | None:
    """Columns of well-formed numbers; None where anything else is in them, or a line is short."""
    columns = Growing(width)
    with open_for_pandas(path) as file:
        for _ in range(first):
            file.readline()
        missing = [v for m in _MISSING for v in {m, m.upper(), m.capitalize(), m.replace("nan", "NaN")}]
        names = list(range(width))
        try:
            for frame in pieces(
                file, sep=delimiter or r"\s+", names=names, comment="#", keep_default_na=False, na_values=missing
            ):
                found = [frame[k].to_numpy() for k in names]
                if frame.index.start != columns.rows or any(c.dtype.kind not in "iuf" for c in found):
                    return None
                columns.add(found)
        except InputError:
            raise
        except (ValueError, OverflowError, AttributeError):  # an index that is no range: the first line is too long
            return None
    whole = columns.whole()
    return None if np.isnan(whole[-1].max()) and _short(path, delimiter, first, width) else whole


def _short(path: Path, delimiter: str | None, first: int, width: int) -> bool:
    """Whether a line has another number of cells; where the last column has all its numbers, none can be short."""
    with open_text(path) as file:
        lines = (x for x in islice(file, first, None) if x.strip() and x.lstrip()[0] not in "#%")
        return any(len(x.rstrip("\r\n").split(delimiter)) != width for x in lines)


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
