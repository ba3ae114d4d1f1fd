"""Instruments whose text is described by one declaration each, in ``insemu/formats/layouts``: a header that tells them, columns, scales, clock.

Keys of a declaration: ``name``; ``sniff``, a regular expression that the first lines hold; ``header``, one for the line of names above the rows
(blanks or the first separator in it split it), or ``messages``, a list of lines that begin alike, each with ``line``, ``names``, ``map``; ``map`` and
``optional`` maps, kept where the file has their columns; ``sexagesimal`` names whose cells are degrees, minutes and seconds; ``scales`` by columns,
found in the lines above the header, ``otherwise`` where they are not; ``good``, a column that is 0 where a row holds nothing; ``clock``; ``assumed``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.errors import InputError
from insemu.formats.columns import ColumnMap, parse_map, resolve
from insemu.formats.decoding import open_text
from insemu.formats.table import Probe, Reader, Table, register
from insemu.formats.text import Growing, pieces

Array = NDArray[np.float64]

#: Lines in which a header is looked for.
FIRST = 400


@dataclass(frozen=True)
class Message:
    """Lines that begin alike: which, and the names of their cells."""

    line: str
    names: tuple[str, ...]
    map: str
    good: str = ""
    clock: str = ""


@dataclass(frozen=True)
class Layout:
    """One declaration; see the module."""

    name: str
    sniff: str
    header: str = ""
    map: str = ""
    optional: tuple[str, ...] = ()
    messages: tuple[Message, ...] = ()
    sexagesimal: tuple[str, ...] = ()
    scales: Mapping[str, str] = field(default_factory=dict)
    otherwise: Mapping[str, float] = field(default_factory=dict)
    clock: str = ""
    assumed: str = ""

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Layout:
        """A layout from its declaration."""
        given = dict(content)
        messages = tuple(Message(**{**m, "names": tuple(m["names"])}) for m in given.pop("messages", ()))
        optional, sexagesimal = (tuple(given.pop(k, ())) for k in ("optional", "sexagesimal"))
        return cls(messages=messages, optional=optional, sexagesimal=sexagesimal, **given)

    @cached_property
    def _known(self) -> re.Pattern[str]:
        return re.compile(self.sniff)

    def is_one(self, probe: Probe) -> bool:
        """Whether a file is one."""
        return self._known.search("\n".join(probe.lines)) is not None

    def read(self, path: Path, settings: Mapping[str, str]) -> list[Table]:
        """Tables of a file of this layout."""
        return self._messages(path) if self.messages else [self._table(path)]

    # --------------------------------------------------------------------------------------------------------------- one table

    def _table(self, path: Path) -> Table:
        with open_text(path) as file:
            above = [x.rstrip("\r\n") for x in islice(file, FIRST)]
        at = next((k for k, x in enumerate(above) if re.search(self.header, x)), None)
        if at is None:
            raise InputError(f"has no line of names such as '{self.header}'", where=str(path))
        separator = next((d for d in ("\t", ";", ",") if d in above[at]), None)
        names = [c.strip().strip('"') for c in (above[at].split(separator) if separator else above[at].split())]
        first = next((k for k in range(at + 1, len(above)) if _number(_cells(above[k], separator)[0])), None)
        if first is None:
            raise InputError("has no row of numbers after its names", where=f"{path}, line {at + 1}")
        width = len(_cells(above[first], separator))
        if width == len(names) + 2 * len(self.sexagesimal):
            names = [
                n for name in names for n in ([f"{name}_{p}" for p in "dms"] if name in self.sexagesimal else [name])
            ]
        if width < len(names):
            raise InputError(
                f"has {width} cells, expected {len(names)} as in the names", where=f"{path}, line {first + 1}"
            )
        columns = _rows(path, first, separator, names)
        for name in self.sexagesimal:
            if f"{name}_d" in columns:
                columns[name] = _degrees(*(columns.pop(f"{name}_{p}") for p in "dms"))
        self._scale(columns, above[:at])
        return Table(path.name, columns, {}, self._map_of(columns), self.clock, (self.assumed,) * bool(self.assumed))

    def _scale(self, columns: dict[str, NDArray[Any]], above: Sequence[str]) -> None:
        for names, pattern in self.scales.items():
            found = next((m for x in above if (m := re.search(pattern, x))), None)
            size = self.otherwise.get(names, 1.0)
            if found is not None:
                size = float(found["value"]) if "value" in found.groupdict() else 1.0 / float(found["divisor"])
            for name in names.split():
                if name in columns:
                    columns[name] = columns[name] * size

    def _map_of(self, columns: Mapping[str, NDArray[Any]]) -> ColumnMap:
        """The map, and what is optional and there; roles of the map whose columns are missing are left out."""
        used = ColumnMap()
        for line in (self.map, *self.optional):
            picks = parse_map(line)
            there = {}
            for role, each in picks.picks.items():
                try:
                    resolve(role, each, list(columns), self.name)
                except InputError:
                    continue
                there[role] = each
            used = used.over(ColumnMap(there, picks.settings))
        return used

    # ---------------------------------------------------------------------------------------------------------------- messages

    def _messages(self, path: Path) -> list[Table]:
        patterns = [re.compile(m.line) for m in self.messages]
        rows: list[list[list[float]]] = [[] for _ in self.messages]
        with open_text(path) as file:
            for line in file:
                for k, pattern in enumerate(patterns):
                    found = pattern.match(line)
                    if found is not None:
                        cells = re.split(r"[,;*\s]+", line[found.end() :].strip())
                        rows[k].append([_value(c) for c in cells[: len(self.messages[k].names)]])
                        break
        out = []
        for message, block in zip(self.messages, rows, strict=True):
            full = [r for r in block if len(r) == len(message.names)]
            if not full:
                continue
            table = np.array(full)
            if message.good:
                table = table[table[:, message.names.index(message.good)] > 0.0]
            columns = {n: table[:, k] for k, n in enumerate(message.names)}
            out.append(Table(message.line.strip("^\\,"), columns, {}, parse_map(message.map), message.clock))
        if not out:
            raise InputError("holds no whole message", where=str(path))
        return out


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [c.strip() for c in (line.split(separator) if separator else line.split())]
    return cells or [""]


def _number(cell: str) -> bool:
    return bool(np.isfinite(_value(cell.strip('"'))))


def _value(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _rows(path: Path, first: int, separator: str | None, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of numbers from a line on; text is NaN."""
    import pandas as pd

    columns = Growing(len(names))
    with open_text(path) as file:
        for _ in range(first):
            file.readline()
        width = list(range(len(names)))
        for frame in pieces(
            file,
            sep=separator or r"\s+",
            names=width,
            usecols=width,
            index_col=False,
            skipinitialspace=True,
            comment="#",
            on_bad_lines="skip",
        ):
            columns.add([pd.to_numeric(frame[k], errors="coerce").to_numpy() for k in width])
    return dict(zip(names, columns.whole(), strict=True))


def _degrees(degrees: Array, minutes: Array, seconds: Array) -> Array:
    """Degrees of three columns; the sign stands before the degrees (-0 south of the equator)."""
    return np.asarray(np.copysign(np.abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees))


for _path in sorted((Path(__file__).parents[1] / "layouts").glob("*.yaml")):
    _layout = Layout.of(yamlfile.read(_path).data)
    register(Reader(_layout.name, _layout.is_one, _layout.read, rank=3))
