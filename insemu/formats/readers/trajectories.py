"""Trajectories of TUM (and evo): ``timestamp tx ty tz qx qy qz qw``, blanks between, no header; local axes east-north-up."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

_NAMES = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_MAP = parse_map("time=timestamp[s], enu=tx ty tz[m], quaternion_xyzw=qx qy qz qw")


def _sniff(probe: Probe) -> bool:
    rows = probe.numbers(20)
    if rows is None or rows.shape[1] != 8:
        return False
    return bool((np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1.0) < 0.01).all() and (np.diff(rows[:, 0]) > 0).all())


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    columns, _, _ = read_delimited(path, names=_NAMES)
    if set(columns) != set(_NAMES):
        columns = dict(zip(_NAMES, columns.values(), strict=True))
    clock = "unix" if float(columns["timestamp"][0]) > 8e8 else ""
    said = ("local axes are east-north-up, body axes forward-left-up",) if not settings.get("axes") else ()
    return [Table(path.name, columns, {}, _MAP, clock, said)]


register(Reader("TUM / evo trajectory (.txt, .tum)", _sniff, _read, rank=4))
