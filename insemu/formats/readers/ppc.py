"""PPC dataset (Suzuki): ``imu.csv`` and ``reference.csv`` with GPS TOW and week; axes forward-right-down."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

_IMU = parse_map('time="GPS TOW"[s], week="GPS Week", gyro="Ang Rate *"[deg/s], accel="Acc *"[m/s^2], clock=gps')
_REFERENCE = (
    'time="GPS TOW"[s], week="GPS Week", lat=Latitude[deg], lon=Longitude[deg], height="Ellipsoid Height"[m], '
    "rpy=Roll Pitch Heading[deg], clock=gps"
)


def _is_file(probe: Probe) -> bool:
    header = probe.header()
    return (
        bool(header)
        and header[0].startswith("gps tow")
        and any(c.startswith(("acc x", "roll", "latitude")) for c in header)
    )


def _is_folder(probe: Probe) -> bool:
    return {"imu.csv", "reference.csv"} <= probe.entries and _is_file(Probe(probe.path / "imu.csv"))


def _table(path: Path) -> Table:
    columns, units, _ = read_delimited(path)
    if any(n.startswith("Acc ") for n in columns):
        return Table(path.name, columns, units, _IMU)
    line = _REFERENCE
    if {"East Velocity", "North Velocity", "Up Velocity"} <= set(columns):
        line += ', vel_enu="East Velocity" "North Velocity" "Up Velocity"[m/s]'
    return Table(path.name, columns, units, parse_map(line))


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    files = [path / "imu.csv", path / "reference.csv"] if path.is_dir() else [path]
    return [_table(f) for f in files]


register(Reader("PPC folder (imu.csv, reference.csv)", _is_folder, _read, rank=2))
register(Reader("PPC file", _is_file, _read, rank=2))
