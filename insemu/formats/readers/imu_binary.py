"""Binary ``.imu`` records of Applanix (PosProc) and NovAtel/Waypoint (Inertial Explorer), as Balamuta et al. (2016, appendix B) list them.

No header; one record per epoch, little endian: the time as a 64-bit float, then the increments of three gyroscopes and three accelerometers,
as 32-bit whole numbers or as 64-bit floats, in units of the type. The file does not say its type: the setting ``imu=LN200`` of the map does, else
it is the one that gravity fits. IXSEA and NAVCHIP_FLT have the same record; LN200 and LN200IG differ in the gyroscopes alone, which nothing
in a file tells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary
from insemu.formats.table import Probe, Reader, Table, register
from insemu.records import ImuRecord
from insemu.whole import put

Array = NDArray[np.float64]

_NAMES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
_MAP = parse_map("time=time[s], gyro=gyro_*[rad], accel=accel_*[m/s], kind=increment")
#: Specific force at rest or in motion that a median may have, m/s^2.
_GRAVITY = (7.0, 14.0)
#: Most epochs a second, fewest, and turns that a sensor survives, rad/s.
_FASTEST, _SLOWEST, _FASTEST_TURN = 20_000.0, 1.0, 100.0


@dataclass(frozen=True)
class Layout:
    """Record of a type.

    Parameters
    ----------
    values : str
        NumPy type of the six increments.
    gyro, accel : float
        Size of one count, rad and m/s.
    """

    values: str
    gyro: float
    accel: float

    @property
    def record(self) -> np.dtype[np.void]:
        """NumPy type of an epoch."""
        return np.dtype([("time", "<f8"), ("values", self.values, (6,))])


_ARC_SECOND = math.radians(1.0) / 3600.0
#: Type -> its record.
LAYOUTS: Mapping[str, Layout] = {
    "IMAR": Layout("<i4", 0.1 * _ARC_SECOND, 1.52588e-6),
    "LN200": Layout("<i4", 2.0**-21, 2.0**-14),
    "LN200IG": Layout("<i4", 2.0**-19, 2.0**-14),
    "IXSEA": Layout("<f8", _ARC_SECOND, 1e-3),
    "NAVCHIP_INT": Layout("<i4", 6.25e-6, 3.90625e-5),
    "NAVCHIP_FLT": Layout("<f8", _ARC_SECOND, 1e-3),
}


def write_imu_binary(path: Path, imu: ImuRecord, kind: str) -> Path:
    """Write an IMU as increments in the record of a type.

    Parameters
    ----------
    path : Path
        Overwritten.
    imu : ImuRecord
        Of any kind.
    kind : str
        Key of :data:`LAYOUTS`. Whole numbers are rounded cumulatively, so that the sum of all increments is right to half a count.

    Raises
    ------
    InputError
        An unknown type; increments beyond its whole numbers.
    """
    layout = _layout(kind, str(path))
    record = imu.as_increments()
    counts = np.hstack([record.gyro / layout.gyro, record.accel / layout.accel])
    if layout.values == "<i4":
        whole = np.round(np.cumsum(counts, axis=0))
        counts = np.diff(whole, axis=0, prepend=0.0)
        if np.abs(counts).max(initial=0.0) >= 2.0**31:
            raise InputError(f"has increments beyond the 32-bit numbers of {kind}", where=str(path))
    out = np.zeros(len(imu), dtype=layout.record)
    out["time"], out["values"] = record.t, counts
    put(path, out.tobytes())
    return path


def _layout(kind: str, where: str) -> Layout:
    found = LAYOUTS.get(kind.upper())
    if found is None:
        raise InputError(f"unknown type of IMU '{kind[:40]}'" + nearest(kind.upper()[:40], LAYOUTS), where=where)
    return found


def _fits(epochs: NDArray[np.void], layout: Layout) -> bool:
    """Whether epochs look like this record: times that step evenly, finite increments of a body under gravity."""
    t, values = epochs["time"], epochs["values"].astype(np.float64)
    if len(t) < 3 or not (np.isfinite(t).all() and np.isfinite(values).all()):
        return False
    step = np.diff(t)
    dt = float(np.median(step))
    if not (1.0 / _FASTEST < dt < 1.0 / _SLOWEST and np.mean((step > 0.0) & (step < 100.0 * dt)) > 0.9):
        return False
    force = float(np.median(np.linalg.norm(values[:, 3:], axis=1))) * layout.accel / dt
    turn = float(np.median(np.linalg.norm(values[:, :3], axis=1))) * layout.gyro / dt
    return _GRAVITY[0] < force < _GRAVITY[1] and turn < _FASTEST_TURN


def _likely(head: bytes) -> list[str]:
    """Types whose record the first bytes of a file may be."""
    out = []
    for name, layout in LAYOUTS.items():
        size = layout.record.itemsize
        epochs = np.frombuffer(head[: len(head) // size * size], dtype=layout.record)
        with np.errstate(all="ignore"):
            if _fits(epochs, layout):
                out.append(name)
    return out


def _sniff(probe: Probe) -> bool:
    if probe.suffix not in (".imu", ".imr", ".bin", ".dat") or not probe.head or probe.lines:
        return False
    return probe.suffix == ".imu" or bool(_likely(probe.head))


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    with open_binary(path) as file:
        data = file.read()
    assumed: tuple[str, ...] = ()
    if "imu" in settings:
        kind = settings["imu"].upper()
        layout = _layout(kind, "imu")
    else:
        likely = _likely(data[: 1 << 16])
        if not likely:
            raise InputError(f"fits no type under gravity; say it with --map imu=TYPE, one of: {', '.join(LAYOUTS)}")
        kind = likely[0]
        layout = LAYOUTS[kind]
        same = [k for k in likely[1:] if LAYOUTS[k] == layout]
        other = [k for k in likely[1:] if k not in same]
        said = f"type {' or '.join([kind, *same])}, which gravity fits (imu={kind} says it)"
        assumed = (said + (f"; {' or '.join(other)} fits, too" if other else ""),)
    size = layout.record.itemsize
    epochs = np.frombuffer(data[: len(data) // size * size], dtype=layout.record)
    if len(epochs) < 2:
        raise InputError(f"holds {len(epochs)} records of {kind} ({size} bytes each), expected at least 2")
    values = epochs["values"].astype(np.float64) * np.repeat([layout.gyro, layout.accel], 3)
    columns: dict[str, Array] = {"time": epochs["time"].astype(np.float64), **dict(zip(_NAMES, values.T, strict=True))}
    left = len(data) % size
    notes = (f"{left} bytes at the end are no whole record of {kind}",) if left else ()
    return [Table(path.name, columns, {}, _MAP, "", assumed, notes)]


register(Reader("binary .imu of Applanix or NovAtel/Waypoint (IMAR, LN200, IXSEA, NAVCHIP)", _sniff, _read, rank=6))
