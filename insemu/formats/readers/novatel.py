"""NovAtel SPAN ASCII logs: RAWIMUSXA and RAWIMUXA (counts of increments), BESTPOSA, BESTVELA, and INSPVAA and INSPVASA as a reference.

Field order, frame (right-forward-up of the IMU; z, -y, x in the log) and scales by IMU follow the SPAN logs of the OEM6 and OEM7 manuals. Where the
IMU that is stated does not measure gravity with its scales, the scales that do are taken, which is said.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_text
from insemu.formats.table import Probe, Reader, Table, register

_FT = 0.3048
#: IMU types of the manuals: counts of the gyroscope in rad, of the accelerometer in m/s.
_SCALES: Mapping[int, tuple[float, float]] = {
    1: (2.0**-33, 2.0**-27 * _FT), 11: (2.0**-33, 2.0**-27 * _FT), 4: (2.0**-33, 2.0**-26 * _FT), 12: (2.0**-33, 2.0**-26 * _FT),
    8: (2.0**-19, 2.0**-14), 13: (np.deg2rad(0.1 / (3600.0 * 256.0)), 0.05 * 2.0**-15), 16: (0.1 / (3600.0 * 256.0), 0.05 * 2.0**-15),
    5: (2.0**-33, 2.0**-27 * _FT), 20: (2.0**-33, 2.0**-27 * _FT), 26: (1e-9, 2e-8),
}  # fmt: skip
#: |f| that is gravity, m/s^2.
_GRAVITY = (8.5, 11.0)
_LINE = re.compile(r"^[#%](RAWIMUSXA|RAWIMUXA|BESTPOSA|BESTVELA|INSPVAA|INSPVASA|INSPVAXA),([^;]*);([^*]*)")
_IMU = parse_map("time=sec[s], week=week, gyro=gx gy gz[rad], accel=ax ay az[m/s], kind=increment, axes=RFU")
_POS = "time=sec[s], week=week, lat=lat[deg], lon=lon[deg], height=h[m]"


def _sniff(probe: Probe) -> bool:
    return any(_LINE.match(x) for x in probe.lines[:100])


def _value(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    rows: dict[str, list[list[float]]] = {}
    with open_text(path) as file:
        for line in file:
            found = _LINE.match(line)
            if found is None:
                continue
            name, head, body = found.groups()
            cells = body.split(",")
            parts = head.split(",")
            stamp = parts[4:6] if len(parts) > 5 else parts[:2]
            good = name not in ("BESTPOSA", "BESTVELA") or cells[0] == "SOL_COMPUTED"
            if good and len(stamp) == 2:
                rows.setdefault(name, []).append([_value(c) for c in (*stamp, *cells)])
    out = [t for t in (_imu(rows), _fixes(rows), _reference(rows)) if t is not None]
    if not out:
        raise InputError("holds neither RAWIMU, BESTPOS nor INSPVA logs", where=str(path))
    return out


def _block(rows: Mapping[str, list[list[float]]], names: tuple[str, ...], width: int) -> NDArray[np.float64] | None:
    full = [r[:width] for name in names for r in rows.get(name, []) if len(r) >= width]
    return np.array(full) if full else None


def _imu(rows: Mapping[str, list[list[float]]]) -> Table | None:
    block = _block(rows, ("RAWIMUSXA", "RAWIMUXA"), 13)
    if block is None or len(block) < 3:
        return None
    kind, week, sec = int(np.nan_to_num(block[0, 3])), block[:, 4], block[:, 5]
    counts = block[:, [9, 8, 7, 12, 11, 10]] * [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]  # x, y, z from z, -y, x
    dt = float(np.median(np.diff(sec)))
    size = float(np.nanmedian(np.linalg.norm(counts[:, :3], axis=1))) / max(dt, 1e-9)
    fits = [k for k, (_, a) in _SCALES.items() if _GRAVITY[0] < size * a < _GRAVITY[1]]
    said: tuple[str, ...] = ()
    if kind not in fits and fits:
        said = (f"IMU type {kind} does not measure gravity with its scales: those of type {fits[-1]} do and are taken",)
        kind = fits[-1]
    if kind not in _SCALES:
        raise InputError(
            f"counts of IMU type {kind}, whose scale is not known; give rates or increments in SI", where="RAWIMUSXA"
        )
    gyro, accel = _SCALES[kind]
    columns: dict[str, NDArray[Any]] = {"week": week, "sec": sec}
    columns |= {n: counts[:, k] * accel for k, n in enumerate(("ax", "ay", "az"))}
    columns |= {n: counts[:, k + 3] * gyro for k, n in enumerate(("gx", "gy", "gz"))}
    return Table("RAWIMUSXA", columns, {}, _IMU, "gps", said)


def _fixes(rows: Mapping[str, list[list[float]]]) -> Table | None:
    block = _block(rows, ("BESTPOSA",), 12)
    if block is None:
        return None
    columns: dict[str, NDArray[Any]] = {"week": block[:, 0], "sec": block[:, 1], "lat": block[:, 4], "lon": block[:, 5]}
    columns |= {"h": block[:, 6] + block[:, 7], "sn": block[:, 9], "se": block[:, 10], "sd": block[:, 11]}
    line = f"{_POS}, pos_std_ned=sn se sd[m]"
    velocity = _block(rows, ("BESTVELA",), 9)
    if velocity is not None:
        at = {(w, s): k for k, (w, s) in enumerate(velocity[:, :2])}
        index = np.array([at.get((w, s), -1) for w, s in block[:, :2]])
        level, course, up = (np.where(index >= 0, velocity[index, k], np.nan) for k in (6, 7, 8))
        columns |= {"vn": level * np.cos(np.deg2rad(course)), "ve": level * np.sin(np.deg2rad(course)), "vd": -up}
        line += ", vel_ned=vn ve vd[m/s]"
    return Table("BESTPOSA", columns, {}, parse_map(line), "gps")


def _reference(rows: Mapping[str, list[list[float]]]) -> Table | None:
    block = _block(rows, ("INSPVAA", "INSPVASA"), 13)
    if block is None:
        return None
    names = ("week", "sec", "lat", "lon", "h", "vn", "ve", "vu", "roll", "pitch", "azimuth")
    columns = {n: block[:, k + 2] for k, n in enumerate(names)}
    return Table("INSPVA", columns, {}, parse_map(f"{_POS}, vel_neu=vn ve vu[m/s], rpy=roll pitch azimuth[deg]"), "gps")


register(Reader("NovAtel SPAN text (RAWIMUSXA, BESTPOSA, INSPVAA)", _sniff, _read, rank=1))
