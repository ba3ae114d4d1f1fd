"""CSV files of ROS topics (``rostopic echo -p``, ``ros2 topic echo --csv``, exporters): ``angular_velocity`` and ``linear_acceleration``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, any_table, register


def _sniff(probe: Probe) -> bool:
    header = " ".join(probe.header())
    return "angular_velocity" in header and "linear_acceleration" in header


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    table = any_table(path)
    picks = {
        role: tuple(replace(p, unit=unit) for p in table.map.picks[role])
        for role, unit in (("gyro", "rad/s"), ("accel", "m/s^2"))
        if role in table.map.picks
    }
    used = replace(table.map, picks={**table.map.picks, **picks})
    said: tuple[str, ...] = ()
    if not settings.get("axes"):
        used = used.over(parse_map("axes=FLU"))
        said = ("axes are forward-left-up (REP 103): --map 'axes=FRD' says otherwise",)
    return [replace(table, map=used, clock="unix", assumed=said)]


def _is_fix(probe: Probe) -> bool:
    header = " ".join(probe.header())
    return "latitude" in header and "position_covariance" in header


def _read_fix(path: Path, settings: Mapping[str, str]) -> list[Table]:
    """NavSatFix: rows without a fix (status -1) hold no position; the covariance (east, north, up) gives standard deviations."""
    table = any_table(path)
    columns = dict(table.columns)
    names = {role: picks[0].column for role, picks in table.map.picks.items() if role in ("lat", "lon", "height")}
    status = next(
        (c for n, c in columns.items() if n.lower().endswith("status.status") or n.lower().endswith("status_status")),
        None,
    )
    notes: tuple[str, ...] = ()
    if status is not None and (status < 0).any():
        for name in names.values():
            columns[name] = np.where(status < 0, np.nan, columns[name])
        notes = (f"{int((status < 0).sum())} rows state that there is no fix (status -1)",)
    used = table.map
    for axis, k in (("e", 0), ("n", 4), ("u", 8)):
        found = next((c for n, c in columns.items() if re.search(rf"position_covariance[._\[]?{k}\]?$", n)), None)
        if found is None:
            break
        columns[f"std_{axis}"] = np.sqrt(np.maximum(found, 0.0))
    else:
        used = used.over(parse_map("pos_std_enu=std_e std_n std_u[m]"))
    units = dict.fromkeys((names[r] for r in ("lat", "lon") if r in names), "deg")
    return [replace(table, columns=columns, units=units, map=used, clock="unix", notes=notes)]


register(Reader("CSV of a ROS topic (sensor_msgs/NavSatFix)", _is_fix, _read_fix, rank=4))
register(Reader("CSV of a ROS topic (sensor_msgs/Imu)", _sniff, _read, rank=4))
