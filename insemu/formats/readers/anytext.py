"""Any CSV or text table: columns by their names, or by the user's map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from insemu.formats.table import Probe, Reader, Table, any_table, register

_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".imu", ".ascii", "")


def _sniff(probe: Probe) -> bool:
    return probe.suffix in _SUFFIXES and any(x.strip() and x.lstrip()[0] not in "<{" for x in probe.lines[:1])


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    return [any_table(path)]


register(Reader("table of text (.csv, .txt, .tsv, .dat)", _sniff, _read, rank=9))
