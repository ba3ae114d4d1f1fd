"""ArduPilot DataFlash logs, as text (``.log``) and binary (``.bin``): messages that describe themselves (FMT), IMU and GPS of the first instance.

Message types begin with the bytes A3 95; format characters are those of ArduPilot's LogStructure.h. Axes are forward-right-down. A fix is stamped
with GPS time (GWk, GMS) and with the time at which it was logged; its time on the IMU's clock is GPS time less the smallest difference of the two.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.clocks import WEEK
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary, open_text
from insemu.formats.table import Probe, Reader, Table, register

#: struct's characters of DataFlash's, and what a value is multiplied with.
_TYPES: Mapping[str, tuple[str, float]] = {
    "b": ("b", 1.0), "B": ("B", 1.0), "h": ("h", 1.0), "H": ("H", 1.0), "i": ("i", 1.0), "I": ("I", 1.0), "f": ("f", 1.0), "d": ("d", 1.0),
    "q": ("q", 1.0), "Q": ("Q", 1.0), "n": ("4s", 1.0), "N": ("16s", 1.0), "Z": ("64s", 1.0), "c": ("h", 0.01), "C": ("H", 0.01),
    "e": ("i", 0.01), "E": ("I", 0.01), "L": ("i", 1e-7), "M": ("B", 1.0), "a": ("64s", 1.0), "g": ("e", 1.0),
}  # fmt: skip
_HEAD, _FMT = b"\xa3\x95", 0x80
_WANTED = ("IMU", "GPS")
_IMU = parse_map("time=TimeUS[us], gyro=GyrX GyrY GyrZ[rad/s], accel=AccX AccY AccZ[m/s^2], axes=FRD")
_GPS = parse_map("time=t[s], lat=Lat[deg], lon=Lng[deg], height=Alt[m]")
_VELOCITY = parse_map("vel_ned=vn ve VZ[m/s]")
Rows = dict[str, list[tuple[float, ...]]]


def _is_text(probe: Probe) -> bool:
    return any(x.startswith("FMT,") and "FMT" in x[4:] for x in probe.lines[:5])


def _is_binary(probe: Probe) -> bool:
    return probe.head[:3] == _HEAD + bytes([_FMT]) and b"FMT" in probe.head[:16]


def _text(path: Path) -> tuple[dict[str, list[str]], Rows]:
    names: dict[str, list[str]] = {}
    rows: Rows = {w: [] for w in _WANTED}
    with open_text(path) as file:
        for line in file:
            kind, _, rest = line.partition(",")
            if kind == "FMT":
                cells = [c.strip() for c in rest.split(",")]
                if len(cells) > 4:
                    names[cells[2]] = cells[4:]
            elif kind in rows:
                rows[kind].append(tuple(_value(c) for c in rest.split(",")))
    return names, rows


def _value(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _binary(path: Path) -> tuple[dict[str, list[str]], Rows]:
    names: dict[str, list[str]] = {}
    rows: Rows = {w: [] for w in _WANTED}
    with open_binary(path) as file:
        data = file.read()
    for name, labels, values in _records(data):
        names[name] = labels
        if name in rows:
            rows[name].append(values)
    return names, rows


def _records(data: bytes) -> Iterator[tuple[str, list[str], tuple[float, ...]]]:
    """Name, labels and values of every record that is wanted; what is no record is passed over."""
    known: dict[int, tuple[int, str, struct.Struct | None, list[float], list[str]]] = {_FMT: (89, "FMT", None, [], [])}
    at = data.find(_HEAD)
    while at >= 0 and at + 3 <= len(data):
        kind = known.get(data[at + 2])
        if kind is None or at + kind[0] > len(data):
            at = data.find(_HEAD, at + 1)
            continue
        length, name, layout, factors, labels = kind
        body = data[at + 3 : at + length]
        if name == "FMT":
            number, size = body[0], body[1]
            new, form, text = (
                body[a:b].split(b"\0")[0].decode("ascii", "replace") for a, b in ((2, 6), (6, 22), (22, 86))
            )
            packed = "<" + "".join(_TYPES[c][0] for c in form) if all(c in _TYPES for c in form) else ""
            fits = bool(packed) and struct.calcsize(packed) == size - 3 and len(text.split(",")) == len(form)
            if size >= 3 and number != _FMT:
                known[number] = (
                    size,
                    new,
                    struct.Struct(packed) if fits else None,
                    [_TYPES[c][1] for c in form] if fits else [],
                    text.split(","),
                )
        elif layout is not None and name in _WANTED:
            values = layout.unpack(body)
            yield (
                name,
                labels,
                tuple(
                    v * f if isinstance(v, (int, float)) else float("nan") for v, f in zip(values, factors, strict=True)
                ),
            )
        at = at + length if data[at + length : at + length + 2] == _HEAD else data.find(_HEAD, at + length)


def _columns(names: Mapping[str, list[str]], rows: Rows, kind: str, instance: int) -> dict[str, NDArray[Any]]:
    labels = names.get(kind, [])
    full = [r for r in rows[kind] if len(r) == len(labels)]
    if not full:
        return {}
    block = np.array(full)
    columns = {n: block[:, k] for k, n in enumerate(labels)}
    if "I" in columns:
        keep = columns["I"] == instance
        columns = {n: c[keep] for n, c in columns.items()}
    return columns


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    names, rows = _text(path) if _is_text(Probe(path)) else _binary(path)
    instance = settings.get("instance", "0")
    if not instance.isdigit():
        raise InputError(f"is '{instance}', expected a number from 0", where=f"{path}: instance")
    out = []
    imu = _columns(names, rows, "IMU", int(instance))
    if {"TimeUS", "GyrX", "AccX"} <= set(imu) and imu["TimeUS"].size:
        out.append(Table("IMU", imu, {}, _IMU))
    gps = _columns(names, rows, "GPS", int(instance) if "I" in names.get("IMU", []) and len(out) == 0 else 0)
    if {"TimeUS", "Lat", "Lng", "Alt"} <= set(gps):
        gps = {n: c[gps["Status"] >= 2] for n, c in gps.items()} if "Status" in gps else gps
        if gps["TimeUS"].size:
            out.append(_fixes(gps))
    if not out:
        raise InputError("holds neither IMU nor GPS messages", where=str(path))
    return out


def _fixes(gps: dict[str, NDArray[Any]]) -> Table:
    used, notes = _GPS, []
    gps["t"] = 1e-6 * gps["TimeUS"]
    if {"GMS", "GWk"} <= set(gps):
        valid = gps["GWk"] * WEEK + 1e-3 * gps["GMS"]
        behind = gps["t"] - valid
        gps["t"] = valid + np.nanmin(behind)
        notes.append("fixes stand at their GPS time; by how much the quickest of them was logged late nobody states")
    if {"Spd", "GCrs", "VZ"} <= set(gps):
        course = np.deg2rad(gps["GCrs"])
        gps["vn"], gps["ve"] = gps["Spd"] * np.cos(course), gps["Spd"] * np.sin(course)
        used = used.over(_VELOCITY)
    return Table("GPS", gps, {}, used, "", (), (*notes, "heights are above mean sea level, not above the ellipsoid"))


register(Reader("ArduPilot DataFlash text (.log)", _is_text, _read, rank=1))
register(Reader("ArduPilot DataFlash binary (.bin)", _is_binary, _read, rank=0))
