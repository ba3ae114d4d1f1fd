"""CSV files of ROS topics (``rostopic echo -p``, ``ros2 topic echo --csv``, exporters): ``angular_velocity`` and ``linear_acceleration``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

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


register(Reader("CSV of a ROS topic (sensor_msgs/Imu)", _sniff, _read, rank=4))
