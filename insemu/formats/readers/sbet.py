"""Applanix smoothed best estimates of a trajectory (SBET, ``.out``): records of 17 doubles, little-endian.

Time (s of the week), latitude, longitude (rad), height (m), velocity of the wander frame (m/s), roll, pitch, platform heading, wander angle (rad),
acceleration and rate of the body (PDAL, readers.sbet). Only position and attitude are taken; true heading is platform heading less wander angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary
from insemu.formats.table import Probe, Reader, Table, register

_WIDTH = 17
_MAP = parse_map("time=t[s], lat=lat[rad], lon=lon[rad], height=h[m], rpy=roll pitch heading[rad]")


def _plausible(block: np.ndarray) -> bool:
    step = np.diff(block[:, 0])
    return bool(
        np.isfinite(block).all()
        and (np.abs(block[:, 1]) <= np.pi / 2).all()
        and (np.abs(block[:, 2]) <= np.pi).all()
        and (np.abs(block[:, 3]) < 1e5).all()
        and (np.abs(block[:, 7:10]) <= 2.0 * np.pi + 1e-9).all()
        and ((step > 0.0) & (step < 10.0)).mean() > 0.9
    )


def _sniff(probe: Probe) -> bool:
    if probe.path.is_dir() or probe.suffix not in (".out", ".sbet", ".bin", ".dat") or len(probe.head) < 4 * 8 * _WIDTH:
        return False
    rows = len(probe.head) // (8 * _WIDTH)
    return _plausible(np.frombuffer(probe.head, dtype="<f8", count=rows * _WIDTH).reshape(-1, _WIDTH))


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    with open_binary(path) as file:
        data = file.read()
    rows = len(data) // (8 * _WIDTH)
    if rows < 2:
        raise InputError(f"holds {len(data)} bytes, expected records of {8 * _WIDTH}", where=str(path))
    block = np.frombuffer(data, dtype="<f8", count=rows * _WIDTH).reshape(-1, _WIDTH)
    columns = dict(zip(("t", "lat", "lon", "h"), block[:, :4].T, strict=True))
    columns |= {"roll": block[:, 7], "pitch": block[:, 8], "heading": block[:, 9] - block[:, 10]}
    left = len(data) - rows * 8 * _WIDTH
    notes = (f"{left} bytes after the last whole record were left out",) * bool(left)
    return [Table(path.name, columns, {}, _MAP, "sow", (), notes)]


register(Reader("Applanix SBET (.out)", _sniff, _read, rank=4))
