"""PX4: ULog by ``pyulog``, and the CSV files that ``ulog2csv`` makes of it (one per topic). Axes are forward-right-down."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import ColumnMap, parse_map
from insemu.formats.decoding import open_binary
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

_IMU_TOPICS = ("sensor_combined", "vehicle_imu")
_GNSS_TOPICS = ("vehicle_gps_position", "sensor_gps")
_MAGIC = b"ULog\x01\x12\x35"


def _imu_map(names: Iterable[str]) -> ColumnMap | None:
    have = set(names)
    if "gyro_rad[0]" in have and "accelerometer_m_s2[0]" in have:
        picks = "gyro=gyro_rad?0? gyro_rad?1? gyro_rad?2?[rad/s], accel=accelerometer_m_s2?0? accelerometer_m_s2?1? accelerometer_m_s2?2?[m/s^2]"
        return parse_map("time=timestamp[us], kind=mean, " + picks)
    return None


def _gnss_map(names: Iterable[str]) -> ColumnMap | None:
    have = set(names)
    if {"latitude_deg", "longitude_deg"} <= have:
        height = "altitude_ellipsoid_m" if "altitude_ellipsoid_m" in have else "altitude_msl_m"
        parts = ["time=timestamp[us]", "lat=latitude_deg[deg]", "lon=longitude_deg[deg]", f"height={height}[m]"]
    elif {"lat", "lon"} <= have and {"alt", "alt_ellipsoid"} & have:
        height = "alt_ellipsoid" if "alt_ellipsoid" in have else "alt"
        parts = ["time=timestamp[us]", "lat=lat[1e-7 deg]", "lon=lon[1e-7 deg]", f"height={height}[mm]"]
    else:
        return None
    if {"vel_n_m_s", "vel_e_m_s", "vel_d_m_s"} <= have:
        parts.append("vel_ned=vel_n_m_s vel_e_m_s vel_d_m_s[m/s]")
    if {"eph", "epv"} <= have:
        parts += ["pos_std_h=eph[m]", "pos_std_v=epv[m]"]
    if "s_variance_m_s" in have:
        parts.append("vel_std_h=s_variance_m_s[m/s]")
    return parse_map(", ".join(parts))


def _topic(name: str, columns: Mapping[str, NDArray[Any]]) -> Table | None:
    used = _imu_map(columns) or _gnss_map(columns)
    if used is None:
        return None
    kept = dict(columns)
    if "lat" in used.picks and "fix_type" in kept:  # rows without a fix hold no position
        good = np.asarray(kept["fix_type"]) >= 2
        kept = {n: v[good] for n, v in kept.items()}
    notes = ("heights are above mean sea level, not above the ellipsoid",) if "altitude_msl_m" in str(used) else ()
    return Table(name, kept, {}, used, "", (), notes)


class _Bounded:
    """A file that ends a decoder which reads the same bytes again and again: pyulog does on some corrupt definitions."""

    def __init__(self, path: Path) -> None:
        self._file = open_binary(path)
        size = self._file.seek(0, 2)
        self._file.seek(0)
        self._left = size + 10_000  # a message is at least four bytes and two reads

    def __enter__(self) -> _Bounded:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, count: int = -1) -> bytes:
        self._left -= 1
        if self._left < 0:
            raise InputError("is corrupt beyond repair")
        return self._file.read(count)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _read_ulog(path: Path, settings: Mapping[str, str]) -> list[Table]:
    from pyulog import ULog

    # pyulog prints what it finds corrupt, and leaves a file open that it opened itself
    with _Bounded(path) as file, contextlib.redirect_stdout(io.StringIO()):
        log = ULog(file, [*_IMU_TOPICS, *_GNSS_TOPICS])
    wanted = int(settings.get("instance", "0") or 0)
    tables: dict[str, Table] = {}
    for data in log.data_list:
        if data.multi_id != wanted and any(d.name == data.name and d.multi_id == wanted for d in log.data_list):
            continue
        table = _topic(data.name, {k: np.asarray(v) for k, v in data.data.items()})
        if table is not None:
            tables.setdefault("imu" if "gyro" in table.map.picks else "gnss", table)
    if not tables:
        raise InputError("holds neither sensor_combined nor a GNSS topic", where=str(path))
    if log.file_corruption:
        first = next(iter(tables))
        note = "parts of the file are corrupt and were left out"
        tables[first] = replace(tables[first], notes=(*tables[first].notes, note))
    return list(tables.values())


def _is_csv(name: str) -> bool:
    return name.endswith(".csv") and any(t in name for t in (*_IMU_TOPICS, *_GNSS_TOPICS))


def _is_topic_file(probe: Probe) -> bool:
    return "gyro_rad[0]" in probe.header() or (_is_csv(probe.name) and "timestamp" in probe.header())


def _read_csv(path: Path, settings: Mapping[str, str]) -> list[Table]:
    files = sorted(p for p in path.iterdir() if _is_csv(p.name.lower())) if path.is_dir() else [path]
    tables: dict[str, Table] = {}
    for file in files:
        columns, _, _ = read_delimited(file)
        table = _topic(file.name, columns)
        if table is not None:
            tables.setdefault("imu" if "gyro" in table.map.picks else "gnss", table)
    if not tables:
        raise InputError("holds neither the columns of sensor_combined nor of a GNSS topic", where=str(path))
    return list(tables.values())


register(Reader("PX4 ULog (.ulg)", lambda p: p.head.startswith(_MAGIC), _read_ulog, rank=0))
register(Reader("PX4 CSV (ulog2csv)", _is_topic_file, _read_csv, rank=3))
register(Reader("PX4 CSV folder (ulog2csv)", lambda p: any(_is_csv(e) for e in p.entries), _read_csv, rank=3))
