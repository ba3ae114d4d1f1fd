"""Phones: phyphox and Sensor Logger exports (folder or zip of CSV files), and Google's GnssLogger text.

Android and iOS axes are x right, y up along the screen, z out of the screen; they stay as they are, and the card guesses the mounting.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_text
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

#: Names of the files, best first. Phones also write an acceleration without gravity, which is no specific force.
_GYRO = ("gyroscope.csv", "gyroscopeuncalibrated.csv")
_ACCEL = ("totalacceleration.csv", "accelerometeruncalibrated.csv", "accelerometer.csv")
_PLACE = ("location.csv", "locationgps.csv")
#: Bytes that the CSV files of an archive may have in all.
_MOST = 4 << 30


def _wanted(names: Mapping[str, Path], choice: tuple[str, ...]) -> Path | None:
    return next((names[c] for c in choice if c in names), None)


def _is_folder(probe: Probe) -> bool:
    return any(g in probe.entries for g in _GYRO) and any(a in probe.entries for a in _ACCEL)


def _is_zip(probe: Probe) -> bool:
    if not probe.head.startswith(b"PK\x03\x04") or probe.suffix != ".zip":
        return False
    try:
        with zipfile.ZipFile(probe.path) as archive:
            names = {Path(n).name.lower() for n in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return True  # what is wrong with it is said by whoever reads it
    return any(g in names for g in _GYRO)


def _read_folder(path: Path, settings: Mapping[str, str]) -> list[Table]:
    files = {p.name.lower(): p for p in path.iterdir()}
    gyro, accel, place = (_wanted(files, c) for c in (_GYRO, _ACCEL, _PLACE))
    if gyro is None or accel is None:
        raise InputError("has no Gyroscope.csv and Accelerometer.csv", where=str(path))
    tables = [_sensor(gyro, "gyro", "rad/s")]
    gravity = files.get("gravity.csv")
    table = _sensor(accel, "accel", "m/s^2")
    if accel.name.lower() == "accelerometer.csv" and gravity is not None and not _phyphox(accel):
        table = _with_gravity(table, _sensor(gravity, "accel", "m/s^2"))
    tables.append(table)
    if place is not None:
        tables.append(_location(place))
    return tables


def _read_zip(path: Path, settings: Mapping[str, str]) -> list[Table]:
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        members = [m for m in archive.infolist() if m.filename.lower().endswith(".csv")]
        if sum(m.file_size for m in members) > _MOST:
            raise InputError(f"would unpack to more than {_MOST >> 30} GiB", where=str(path))
        for member in members:  # names of folders inside are dropped: nothing is written outside the temporary folder
            (Path(folder) / Path(member.filename).name).write_bytes(archive.read(member))
        return _read_folder(Path(folder), settings)


def _phyphox(path: Path) -> bool:
    return any("(s)" in c for c in Probe(path).header())


def _sensor(path: Path, role: str, unit: str) -> Table:
    """Three axes of one sensor; phyphox names them with units, Sensor Logger writes z, y, x and stamps in ns."""
    columns, units, _ = read_delimited(path)
    names = {n.lower(): n for n in columns}
    axes = [next((n for n in columns if n.lower() == a or n.lower().endswith(" " + a)), None) for a in "xyz"]
    time = names.get("time") or names.get("timestamp") or names.get("seconds_elapsed")
    if None in axes or time is None:
        raise InputError(f"has columns {', '.join(list(columns)[:8])}, expected time, x, y and z", where=path.name)
    renamed: dict[str, NDArray[Any]] = {"time": columns[time]}
    renamed |= {f"{role}_{a}": columns[str(n)] for a, n in zip("xyz", axes, strict=True)}
    stated = {
        "time": units.get(time, ""),
        **{f"{role}_{a}": units.get(str(n), unit) for a, n in zip("xyz", axes, strict=True)},
    }
    return Table(
        path.name, renamed, stated, parse_map(f"time=time, {role}={role}_x {role}_y {role}_z"), _clock(renamed["time"])
    )


def _clock(t: NDArray[Any]) -> str:
    """UTC of stamps in ns since 1970; phyphox counts from its start."""
    return "unix" if t.size and float(t[0]) > 1e17 else ""


def _with_gravity(accel: Table, gravity: Table) -> Table:
    total = dict(accel.columns)
    for axis in "xyz":
        name = f"accel_{axis}"
        total[name] = accel.columns[name] + np.interp(
            np.asarray(accel.columns["time"], dtype=np.float64),
            np.asarray(gravity.columns["time"], dtype=np.float64),
            gravity.columns[name],
        )
    return Table(
        accel.name,
        total,
        accel.units,
        accel.map,
        accel.clock,
        (),
        ("gravity was added to the acceleration without it (Gravity.csv)",),
    )


def _location(path: Path) -> Table:
    columns, units, _ = read_delimited(path)
    low = {n.lower().replace("_", "").replace(" ", ""): n for n in columns}
    time = low.get("time") or low.get("timestamp")
    parts = [f'time="{time}"'] if time else []
    for role, words, unit in (
        ("lat", ("latitude",), "deg"), ("lon", ("longitude",), "deg"), ("height", ("height", "altitude"), "m"),
        ("pos_std_h", ("horizontalaccuracy",), "m"), ("pos_std_v", ("verticalaccuracy",), "m"),
        ("speed", ("velocity", "speed"), "m/s"), ("course", ("direction", "bearing"), "deg"),
    ):  # fmt: skip
        name = next((low[w] for w in words if w in low), None)
        if name:
            parts.append(f'{role}="{name}"[{unit}]')
    clock = _clock(columns[time]) if time else ""
    return Table(path.name, columns, {k: v for k, v in units.items() if k == time}, parse_map(", ".join(parts)), clock)


def _is_gnss_logger(probe: Probe) -> bool:
    text = probe.head[:65536]
    return b"UncalAccel," in text or b"UncalGyro," in text or (b"Fix,Provider" in text and b"#" in text[:4])


def _read_gnss_logger(path: Path, settings: Mapping[str, str]) -> list[Table]:
    sensors: dict[str, list[list[float]]] = {"UncalGyro": [], "UncalAccel": []}
    fixes: list[list[float]] = []
    with open_text(path) as file:
        for line in file:
            cells = line.rstrip("\r\n").split(",")
            if cells[0] in sensors and len(cells) >= 6:
                sensors[cells[0]].append([float(cells[1]) * 1e-3, *(float(c) for c in cells[3:6])])
            elif cells[0] == "Fix" and len(cells) >= 9 and cells[1].lower() in ("gps", "fused", "flp"):
                fixes.append(
                    [float(cells[8]) * 1e-3, *(float(c or "nan") for c in cells[2:5]), float(cells[6] or "nan")]
                )
    tables = []
    for name, role, unit in (("UncalGyro", "gyro", "rad/s"), ("UncalAccel", "accel", "m/s^2")):
        if sensors[name]:
            block = np.array(sensors[name])
            columns = {"time": block[:, 0], **{f"{role}_{a}": block[:, k + 1] for k, a in enumerate("xyz")}}
            tables.append(Table(name, columns, {}, parse_map(f"time=time[s], {role}={role}_*[{unit}]"), "unix"))
    if fixes:
        block = np.array(fixes)
        columns = dict(zip(("time", "lat", "lon", "height", "accuracy"), block.T, strict=True))
        line = "time=time[s], lat=lat[deg], lon=lon[deg], height=height[m], pos_std_h=accuracy[m]"
        tables.append(Table("Fix", columns, {}, parse_map(line), "unix"))
    if not tables:
        raise InputError("holds neither UncalGyro, UncalAccel nor Fix lines", where=str(path))
    return tables


register(Reader("phone folder (phyphox, Sensor Logger)", _is_folder, _read_folder, rank=2))
register(Reader("phone archive (phyphox, Sensor Logger; .zip)", _is_zip, _read_zip, rank=2))
register(Reader("Android GnssLogger (.txt)", _is_gnss_logger, _read_gnss_logger, rank=2))
