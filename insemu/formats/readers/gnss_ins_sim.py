"""Folders of gnss-ins-sim: ``time.csv``, ``gyro-0.csv``, ``accel-0.csv``, ``gps_time.csv``, ``gps-0.csv``, ``ref_*.csv``; NED, forward-right-down."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, read_delimited, register


def _sniff(probe: Probe) -> bool:
    return {"time.csv", "gyro-0.csv", "accel-0.csv"} <= probe.entries


def _columns(path: Path) -> tuple[list[NDArray[Any]], list[str]]:
    """Columns of a file by their order, and their units."""
    columns, units, _ = read_delimited(path)
    return list(columns.values()), [units.get(n, "") for n in columns]


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    run = settings.get("instance", "0") or "0"
    (t, *_), _ = _columns(path / "time.csv")
    imu: dict[str, NDArray[Any]] = {"time": t}
    units = {"time": "s"}
    for file, role in ((f"gyro-{run}.csv", "gyro"), (f"accel-{run}.csv", "accel")):
        if not (path / file).exists():
            raise InputError(f"has no {file}", where=str(path))
        values, stated = _columns(path / file)
        if len(values) != 3 or values[0].size != t.size:
            raise InputError(f"has {len(values)} columns, expected 3 as long as time.csv", where=str(path / file))
        for axis, v, u in zip("xyz", values, stated, strict=True):
            imu[f"{role}_{axis}"], units[f"{role}_{axis}"] = v, u
    tables = [Table("gyro, accel", imu, units, parse_map("time=time, gyro=gyro_*, accel=accel_*"))]
    fixes = path / f"gps-{run}.csv"
    if fixes.exists():
        (gt, *_), _ = _columns(path / ("gps_time.csv" if (path / "gps_time.csv").exists() else "time.csv"))
        values, stated = _columns(fixes)
        if len(values) < 6 or values[0].size != gt.size:
            raise InputError(
                "expected latitude, longitude, height and velocity at the times of gps_time.csv", where=str(fixes)
            )
        names = ("lat", "lon", "height", "vn", "ve", "vd")
        used = parse_map("time=time[s], lat=lat, lon=lon, height=height, vel_ned=vn ve vd")
        seen = np.array(values[0]) != 0.0
        columns = {"time": gt[seen], **{n: v[seen] for n, v in zip(names, values, strict=False)}}
        tables.append(Table(fixes.name, columns, dict(zip(names, stated, strict=False)), used))
    truth = _truth(path, t)
    return [*tables, truth] if truth is not None else tables


def _truth(path: Path, t: NDArray[Any]) -> Table | None:
    files = [path / f"ref_{what}.csv" for what in ("pos", "vel", "att_euler")]
    if not all(f.exists() for f in files):
        return None
    columns: dict[str, NDArray[Any]] = {"time": t}
    units: dict[str, str] = {}
    for file, names in zip(
        files, (("lat", "lon", "height"), ("vn", "ve", "vd"), ("yaw", "pitch", "roll")), strict=True
    ):
        values, stated = _columns(file)
        if len(values) != 3 or values[0].size != t.size:
            raise InputError("expected 3 columns as long as time.csv", where=str(file))
        columns |= dict(zip(names, values, strict=True))
        units |= dict(zip(names, stated, strict=True))
    local = units["lat"] not in ("deg", "rad")  # reference frame 1: metres
    place = "ned=lat lon height[m]" if local else "lat=lat, lon=lon, height=height"
    return Table("ref_*.csv", columns, units, parse_map(f"time=time[s], {place}, vel_ned=vn ve vd, rpy=roll pitch yaw"))


register(Reader("gnss-ins-sim folder", _sniff, _read, rank=2))
