"""What a reader makes of a foreign file: tables of named columns, with the map that says what they are; and the registry of readers."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.formats.columns import ColumnMap, guess_map, split_header
from insemu.formats.decoding import decoding, encoding_of, head_of, open_for_pandas, open_text
from insemu.formats.text import pieces
from insemu.records import AidRecord, InitialState, Preparation


@dataclass(frozen=True)
class Table:
    """Columns of one length.

    Parameters
    ----------
    name : str
        File, message or topic; appears in messages and on the card.
    columns : mapping of str to (n,) arrays
        Numbers; NaN where the file has none.
    units : mapping of str to str
        Units that the file states, by column.
    map : ColumnMap
        What the format says about them; empty where it says nothing.
    clock : str
        Key of :data:`insemu.formats.clocks.CLOCKS`.
    assumed : tuple of str
        What the format leaves open and the reader takes for granted, to be printed.
    notes : tuple of str
        What else should be said.
    start : int
        ns on that clock from which the stamps count.
    """

    name: str
    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str] = field(default_factory=dict)
    map: ColumnMap = field(default_factory=ColumnMap)
    clock: str = ""
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    start: int = 0

    def __len__(self) -> int:
        return max((c.shape[0] for c in self.columns.values()), default=0)


@dataclass(frozen=True)
class Probe:
    """What can be seen of a file before it is read: suffix, first bytes (decompressed), first lines, names of a folder's files."""

    path: Path

    @property
    def name(self) -> str:
        """File name in lower case, without the suffix of a compression."""
        name = self.path.name.lower()
        return name.rsplit(".", 1)[0] if name.endswith((".gz", ".bz2", ".xz")) else name

    @property
    def suffix(self) -> str:
        """Suffix in lower case, with its dot; "" of a folder."""
        return "" if self.path.is_dir() else Path(self.name).suffix

    @property
    def head(self) -> bytes:
        """First bytes, decompressed; none of a folder."""
        return b"" if self.path.is_dir() else _head(self.path, self.path.stat().st_mtime_ns)

    @property
    def lines(self) -> list[str]:
        """First lines of text; none of a folder or a binary file. The last line may be cut."""
        encoding = encoding_of(self.head) if self.head else None
        return [] if encoding is None else self.head.decode(encoding, "replace").splitlines()[:200]

    @property
    def entries(self) -> frozenset[str]:
        """Paths of files inside a folder, three levels deep, in lower case with ``/``."""
        if not self.path.is_dir():
            return frozenset()
        found = (p for pattern in ("*", "*/*", "*/*/*") for p in self.path.glob(pattern))
        return frozenset(p.relative_to(self.path).as_posix().lower() for p in found)

    def header(self) -> list[str]:
        """Cells of the first line that is not empty, without ``#`` or ``%``, split at commas, semicolons or tabs; lower case."""
        line = next((x for x in self.lines if x.strip()), "").lstrip("#% \ufeff")
        delimiter = next((d for d in (",", ";", "\t") if d in line), None)
        return (
            [c.strip().strip('"').strip().lower() for c in line.split(delimiter)] if delimiter else line.lower().split()
        )

    def numbers(self, most: int) -> NDArray[np.float64] | None:
        """At most so many of the first rows; None where the lines are no table of numbers without a header."""
        lines = [x for x in self.lines[:-1] or self.lines if x.strip() and x.lstrip()[0] not in "%#"][:most]
        try:
            rows = [[float(c) for c in line.replace(",", " ").split()] for line in lines]
        except ValueError:
            return None
        return np.array(rows) if len({len(r) for r in rows}) == 1 else None


@lru_cache(maxsize=4)
def _head(path: Path, _changed: int) -> bytes:
    return head_of(path)


#: What a recording may hold together with IMU, fixes and reference.
Besides = tuple[tuple[AidRecord, ...], InitialState | None, Preparation | None]


@dataclass(frozen=True)
class Reader:
    """One kind of file: a name, how it is known, how it becomes tables.

    Parameters
    ----------
    name : str
        Shown on the card: "PX4 ULog (.ulg)".
    sniff : callable
        Takes a :class:`Probe`; says whether it is one.
    read : callable
        Takes the path and the settings of the user's map; gives tables.
    rank : int
        Readers of low rank are asked first: 0 content says so for sure, 5 a layout of names, 9 whatever is left.
    besides : callable, optional
        Takes the path; gives aids, initial state and preparation, where a file of this kind can hold any.
    """

    name: str
    sniff: Callable[[Probe], bool]
    read: Callable[[Path, Mapping[str, str]], list[Table]]
    rank: int = 5
    besides: Callable[[Path], Besides] | None = None


_READERS: list[Reader] = []


def register(reader: Reader) -> Reader:
    """Add a reader; a file in ``formats/readers`` calls this, and nothing else has to know of it."""
    _READERS.append(reader)
    return reader


@lru_cache(maxsize=1)
def known_readers() -> tuple[Reader, ...]:
    """All readers, in the order in which they are asked."""
    package = importlib.import_module("insemu.formats.readers")
    for module in sorted(m.name for m in pkgutil.iter_modules(package.__path__)):
        importlib.import_module(f"insemu.formats.readers.{module}")
    return tuple(sorted(_READERS, key=lambda r: r.rank))


def reader_of(path: Path) -> Reader | None:
    """The reader of a foreign file or folder; None where there is none."""
    probe = Probe(path)
    return next((r for r in known_readers() if r.sniff(probe)), None)


# ------------------------------------------------------------------------------------------------------------ delimited text


def read_delimited(
    path: Path, *, names: Sequence[str] | None = None, text: bool = False, comments: str = "#%"
) -> tuple[dict[str, NDArray[Any]], dict[str, str], bool]:
    """Read delimited text of any kind into columns.

    The header may be a comment (``#timestamp [ns],...``), units stand in brackets; comma, semicolon, tab or blanks separate; decimal
    commas are read where semicolons separate; dates are columns of ``datetime64[ns]`` in UTC.

    Parameters
    ----------
    path : path
        Possibly compressed.
    names : sequence of str, optional
        Names of the columns of a file without a header.
    text : bool
        Keep columns of text (as text) instead of leaving them out.
    comments : str
        Characters that begin a line of comment.

    Returns
    -------
    columns, units, headed
        Columns by name, stated units by name, and whether there was a header.

    Raises
    ------
    InputError
        No text, no rows, or rows of differing lengths.
    """
    with decoding(path, "delimited text"):
        header, delimiter, skip, decimal = _layout(path, comments)
        parts: list[list[NDArray[Any] | None]] = []
        rows: list[int] = []
        with open_for_pandas(path) as file:
            for frame in pieces(
                file,
                sep=delimiter or r"\s+",
                skiprows=skip,
                skipinitialspace=True,
                decimal=decimal,
                index_col=False,
                **({"chunksize": None} if text else {}),  # what is text is seen of the whole
            ):
                parts = parts or [[] for _ in range(frame.shape[1])]
                rows.append(len(frame))
                for k, part in enumerate(parts):
                    part.append(_values(frame.iloc[:, k], text))
        if not sum(rows):
            raise ValueError("no rows")
        found = [_joined(part, rows) for part in parts]
        if delimiter == "," and header and len(found) == len(header) + 1:  # a comma at the end of every line
            found = [c for c in found if c is None or c.dtype.kind != "f" or np.isfinite(c).any()]
        cells = header if header and len(header) == len(found) else None
        given = list(names) if names is not None and cells is None else None
        if header and cells is None and given is None:
            raise ValueError(f"{len(header)} names in the header and {len(found)} cells in the rows")
        named = [split_header(c) for c in cells] if cells else [(n, "") for n in given or _numbered(len(found))]
        columns: dict[str, NDArray[Any]] = {}
        units: dict[str, str] = {}
        for k, ((name, unit), values) in enumerate(zip(named, found, strict=False)):
            if values is None:
                continue
            label = name or f"column_{k + 1}"
            label = label if label not in columns else f"{label}_{k + 1}"
            columns[label] = values
            if unit:
                units[label] = unit
    return columns, units, cells is not None


def _joined(part: list[NDArray[Any] | None], rows: Sequence[int]) -> NDArray[Any] | None:
    """A column from its pieces; where some are text, their rows are NaN, or the column is text (None) where most are."""
    numbers = sum(n for p, n in zip(part, rows, strict=True) if p is not None)
    if numbers <= 0.5 * sum(rows):
        return None
    kind = np.result_type(*(p for p in part if p is not None))
    empty = np.datetime64("NaT") if kind.kind == "M" else np.nan
    column, end = np.empty(sum(rows), dtype=kind), 0
    for k, n in enumerate(rows):
        piece, part[k] = part[k], None
        column[end : end + n] = empty if piece is None else piece
        end += n
    return column


def _numbered(width: int) -> list[str]:
    return [f"column_{k + 1}" for k in range(width)]


def _layout(path: Path, comments: str) -> tuple[list[str] | None, str | None, int, str]:
    """Header cells, delimiter (None: blanks), lines to skip, decimal sign."""
    from itertools import islice

    with open_text(path) as file:
        lines = [line.rstrip("\r\n")[:100_000] for line in islice(file, 400)]
    at = next((k for k, x in enumerate(lines) if x.strip() and x.lstrip()[0] not in comments), None)
    if at is None:
        raise ValueError("no rows")
    first = lines[at]
    delimiter = next((d for d in (";", "\t", ",") if d in first), None)
    decimal = "."
    if delimiter in (";", "\t"):
        row = lines[min(at + 1, len(lines) - 1)]
        decimal = "," if "," in row and "." not in row else "."
    cells = _cells(first, delimiter)
    if any(_numeric(c, decimal) for c in cells):
        above = lines[at - 1].strip().lstrip(comments).strip() if at else ""
        header = _cells(above, delimiter) if above else None
        if header and delimiter and len(header) != len(cells):
            header = _cells(above, None)
        fits = header is not None and len(header) == len(cells) and not all(_numeric(c, ".") for c in header)
        return header if fits else None, delimiter, at, decimal
    row = next((x for x in lines[at + 1 :] if x.strip()), "")
    if delimiter is None and len(_cells(row, None)) == 1:
        return [first.strip()], delimiter, at + 1, decimal  # one column: its name may hold blanks
    return cells, delimiter, at + 1, decimal


def _cells(line: str, delimiter: str | None) -> list[str]:
    import csv

    if delimiter is None:
        return line.split()
    return [c.strip() for c in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]


def _numeric(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _values(series: Any, text: bool) -> NDArray[Any] | None:
    """A column as numbers, or as dates in UTC; None of text."""
    import pandas as pd

    if series.dtype.kind in "iuf":
        return np.asarray(series.to_numpy())
    if series.dtype.kind == "b":
        return np.asarray(series.to_numpy(), dtype=np.float64)
    numbers = pd.to_numeric(series, errors="coerce")
    if numbers.notna().mean() > 0.5:
        return np.asarray(numbers.to_numpy(dtype=np.float64))
    sample = str(series.iloc[0])
    if sum(sample.count(c) for c in "-/:T") >= 2 and any(c.isdigit() for c in sample):
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            dates = pd.to_datetime(series, errors="coerce", utc=True)
        if dates.notna().mean() > 0.5:
            return np.asarray(dates.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]"))
    return np.asarray(series.astype(str).to_numpy()) if text else None


#: Units as names of columns end in them.
_TAILS = {
    "dps": "deg/s", "deg": "deg", "rad": "rad", "mg": "mg", "ms2": "m/s^2", "mps2": "m/s^2", "mps": "m/s", "rads": "rad/s", "ns": "ns", "us": "us",
    "ms": "ms", "mm": "mm", "cm": "cm", "km": "km", "ft": "ft", "kmh": "km/h", "kph": "km/h", "kn": "kn", "knots": "kn", "mph": "mph",
}  # fmt: skip


def any_table(path: Path, *, name: str = "") -> Table:
    """Any delimited text as a table with the map that its names suggest."""
    columns, units, _ = read_delimited(path)
    known = dict(units)
    bare: dict[str, str] = {}
    for column in columns:  # gyro_x_dps says its unit in its name
        stem, _, tail = column.rpartition("_")
        if column not in known and stem and tail in _TAILS:
            known[column] = _TAILS[tail]
            stem = stem if stem not in bare.values() and stem not in columns else column
            bare[column] = stem
    guess = guess_map([bare.get(c, c) for c in columns], list(columns.values()))
    back = {stem: column for column, stem in bare.items()}
    picks = {r: tuple(replace(p, column=back.get(p.column, p.column)) for p in ps) for r, ps in guess.picks.items()}
    return Table(name or path.name, columns, known, replace(guess, picks=picks))
