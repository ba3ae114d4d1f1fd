"""RTKLIB solutions (``.pos``): positions as degrees, ECEF or baseline, with standard deviations, quality and velocity.

The field names of its comment line are read (RTKLIB manual 2.4.2, appendix B.1): the standard deviations are of the axes' names, "sdne" and the
like are signed roots of covariances and are not used.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from insemu.errors import InputError
from insemu.formats.clocks import GPS_EPOCH, WEEK
from insemu.formats.columns import ColumnMap, parse_map
from insemu.formats.decoding import open_text
from insemu.formats.table import Probe, Reader, Table, register

_FIELD = re.compile(r"^([A-Za-z][\w-]*)(?:\(.*)?$")


def _sniff(probe: Probe) -> bool:
    return any(
        x.startswith("%") and ("latitude(" in x or "x-ecef(" in x or "e-baseline(" in x) for x in probe.lines[:100]
    )


def _fields(line: str) -> tuple[str, list[str]]:
    """Time system and names of the fields behind the time."""
    words = line.lstrip("% ").replace(",", " ").split()
    return words[0].upper(), [m.group(1) for w in words[1:] if (m := _FIELD.match(w))]


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    header, rows, times = "", [], []
    with open_text(path) as file:
        for number, line in enumerate(file, start=1):
            if line.startswith(("%", "#")) or not line.strip():
                header = line if "latitude(" in line or "x-ecef(" in line or "e-baseline(" in line else header
                continue
            words = line.replace(",", " ").split()
            try:
                times.append(_time(words[0], words[1]))
                rows.append([float(w) for w in words[2:]])
            except (ValueError, IndexError):
                raise InputError(
                    f"found '{line.strip()[:60]}', expected a solution", where=f"{path}, line {number}"
                ) from None
    system, names = _fields(header)
    if not rows:
        raise InputError("holds no solution", where=str(path))
    sexagesimal = "latitude(d'" in header
    width = len(names) + (4 if sexagesimal else 0)
    short = next((k for k, r in enumerate(rows) if len(r) < min(width, 5)), None)
    if short is not None:
        raise InputError(f"solution {short + 1} has {len(rows[short])} numbers, expected {width}", where=str(path))
    table = np.full((len(rows), width), np.nan)
    for k, row in enumerate(rows):
        table[k, : min(width, len(row))] = row[:width]
    if sexagesimal:
        signs = np.copysign(1.0, table[:, [0, 3]])  # RTKLIB writes -0 west of Greenwich
        angles = signs * (np.abs(table[:, [0, 3]]) + table[:, [1, 4]] / 60 + table[:, [2, 5]] / 3600)
        table = np.column_stack([angles, table[:, 6:]])
    columns = {"time": np.array(times), **{n: table[:, k] for k, n in enumerate(names)}}
    clock = "unix" if system == "UTC" else "gps"
    if clock == "unix":
        columns["time"] = columns["time"] + GPS_EPOCH
    return [Table(path.name, columns, {}, _map(names), clock)]


def _map(names: list[str]) -> ColumnMap:
    have = set(names)
    parts = ["time=time[s]"]
    if "latitude" in have:
        parts += ["lat=latitude[deg]", "lon=longitude[deg]", "height=height[m]"]
    elif "x-ecef" in have:
        parts.append("ecef=x-ecef y-ecef z-ecef[m]")
    else:
        parts.append("enu=e-baseline n-baseline u-baseline[m]")
    if {"sdn", "sde", "sdu"} <= have:
        parts.append("pos_std_ned=sdn sde sdu[m]")
    if {"vn", "ve", "vu"} <= have:
        parts.append("vel_neu=vn ve vu[m/s]")
    if {"sdvn", "sdve", "sdvu"} <= have:
        parts.append("vel_std_ned=sdvn sdve sdvu[m/s]")
    if "Q" in have and "sdn" not in have:
        parts.append("quality=Q")
    return parse_map(", ".join(parts))


def _time(first: str, second: str) -> float:
    """Seconds since the GPS epoch of "2024/01/31 12:00:00.000" or of "2300 345600.000"."""
    if "/" not in first:
        return float(first) * WEEK + float(second)
    year, month, day = (int(w) for w in first.split("/"))
    hours, minutes, seconds = second.split(":")
    whole = datetime(year, month, day, int(hours), int(minutes), tzinfo=UTC).timestamp()
    return whole + float(seconds) - GPS_EPOCH


register(Reader("RTKLIB solution (.pos)", _sniff, _read, rank=1))
