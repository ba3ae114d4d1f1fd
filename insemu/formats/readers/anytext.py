"""Any CSV or text table: columns by their names, or by the user's map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from insemu.errors import InputError
from insemu.formats.columns import guess_map, several, words_of
from insemu.formats.table import Probe, Reader, Table, any_table, register

_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".imu", ".ascii", "")


def _sniff(probe: Probe) -> bool:
    return probe.suffix in _SUFFIXES and any(x.strip() and x.lstrip()[0] not in "<{" for x in probe.lines[:1])


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    table = any_table(path)
    units = several(list(table.columns))
    if len(units) < 2:
        return [table]
    given = settings.get("instance", "")
    if not given.isdigit() or int(given) >= len(units):
        ways = " or ".join(f'--map "instance={k}"' for k in range(len(units)))
        raise InputError(
            f"holds {len(units)} IMUs ({', '.join(u[0] for u in units)}): say which, {ways}", where=str(path)
        )
    other = {c for k, u in enumerate(units) if k != int(given) for c in u}
    numbers = {n for c in units[int(given)] for n in words_of(c) if n.isdigit()}
    others = {n for c in other for n in words_of(c) if n.isdigit()} - numbers
    kept = {n: c for n, c in table.columns.items() if not set(words_of(n)) & others}
    return [replace(table, columns=kept, map=guess_map(list(kept), list(kept.values())))]


register(Reader("table of text (.csv, .txt, .tsv, .dat)", _sniff, _read, rank=9))
