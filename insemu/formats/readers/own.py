"""Our own layouts as tables, for ``insemu open``: so that they can be mended by the same map as all others, and joined with other files.

Commands that compute read them strictly (:mod:`insemu.formats.recording`, :mod:`insemu.formats.static`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats import recording, static
from insemu.formats.columns import ColumnMap, guess_map, parse_map
from insemu.formats.npz import keys_of, load_npz, texts
from insemu.formats.table import Probe, Reader, Table, register
from insemu.records import COLUMNS

_IMU = "time=t[s], gyro=gx gy gz, accel=ax ay az"
_TRIPLES = {
    "gnss_vel_ned": "vel_ned",
    "gnss_vel_neu": "vel_neu",
    "gnss_pos_std_ned": "pos_std_ned",
    "gnss_vel_std_ned": "vel_std_ned",
}
_TRIPLES |= {"gnss_pos_std_neu": "pos_std_ned", "gnss_vel_std_neu": "vel_std_ned"}


def _is_recording(probe: Probe) -> bool:
    if probe.path.is_dir():
        return recording.is_folder_recording(probe.path)
    return probe.suffix == ".npz" and {"imu_t", "imu"} <= keys_of(probe.path)


def _read_recording(path: Path, settings: Mapping[str, str]) -> list[Table]:
    arrays = recording.folder_arrays(path) if path.is_dir() else load_npz(path)
    kind = texts(arrays["imu_kind"], f"{path}: imu_kind")[0] if "imu_kind" in arrays else "sample"
    names = texts(arrays["imu_columns"], f"{path}: imu_columns") if "imu_columns" in arrays else list(COLUMNS)
    usual = ["rad", "m/s"] if kind == "increment" else ["rad/s", "m/s^2"]
    units = (
        texts(arrays["imu_units"], f"{path}: imu_units")
        if "imu_units" in arrays
        else [usual[n[:1] == "a"] for n in names]
    )
    block = _block(arrays, "imu", len(names), path)
    if len(units) != len(names) or set(names) != set(COLUMNS):
        raise InputError(f"imu_columns and imu_units must name {', '.join(COLUMNS)}", where=str(path))
    columns: dict[str, NDArray[Any]] = {"t": _times(arrays, "imu_t", block.shape[0], path)}
    columns |= {n: block[:, k] for k, n in enumerate(names)}
    line = f"{_IMU}, kind={kind}"
    if "temperature" in arrays and arrays["temperature"].shape == columns["t"].shape:
        columns["temperature"], line = arrays["temperature"], line + ", temperature=temperature"
    origin = recording.origin_of(arrays, str(path))
    stated = dict(zip(names, units, strict=True))
    tables = [Table("imu", columns, stated, parse_map(line), origin.clock, start=origin.ns)]
    for group, place in (("gnss", "gnss_llh"), ("ref", "ref_llh")):
        if place in arrays and f"{group}_t" in arrays:
            table = _positions(arrays, group, path)
            tables += [replace(table, clock=origin.clock, start=origin.ns)] if table is not None else []
    return tables


def _positions(arrays: Mapping[str, NDArray[Any]], group: str, path: Path) -> Table | None:
    llh = _block(arrays, f"{group}_llh", 3, path)
    columns: dict[str, NDArray[Any]] = {"t": _times(arrays, f"{group}_t", llh.shape[0], path)}
    columns |= {"lat": llh[:, 0], "lon": llh[:, 1], "h": llh[:, 2]}
    line = "time=t[s], lat=lat[deg], lon=lon[deg], height=h[m]"
    keys = (
        dict(_TRIPLES)
        if group == "gnss"
        else {"ref_vel_ned": "vel_ned", "ref_vel_neu": "vel_neu", "ref_rpy_deg": "rpy"}
    )
    if group == "ref" and ("ref_rpy_deg" not in arrays or "ref_att_t" in arrays):
        return None
    for key, role in keys.items():
        if key in arrays and f" {role}=" not in line:
            block = _block(arrays, key, 3, path)
            columns |= {f"{key}_{k}": block[:, k] for k in range(3)}
            unit = "deg" if role == "rpy" else "m" if role.startswith("pos") else "m/s"
            line += f", {role}={key}_0 {key}_1 {key}_2[{unit}]"
    return Table(group, columns, {}, parse_map(line))


def _block(arrays: Mapping[str, NDArray[Any]], key: str, width: int, path: Path) -> NDArray[Any]:
    array = arrays[key]
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "fiu":
        raise InputError(
            f"has shape {array.shape} and type {array.dtype}, expected (n, {width}) numbers", where=f"{path}: {key}"
        )
    return array


def _times(arrays: Mapping[str, NDArray[Any]], key: str, rows: int, path: Path) -> NDArray[Any]:
    if arrays[key].shape != (rows,) or arrays[key].dtype.kind not in "fiu":
        raise InputError(f"has shape {arrays[key].shape}, expected ({rows},) numbers", where=f"{path}: {key}")
    return arrays[key]


def _is_log(probe: Probe) -> bool:
    if probe.suffix == ".npy":
        return True
    keys = keys_of(probe.path) if probe.suffix == ".npz" and probe.path.is_file() else frozenset()
    return bool({"data", "counts"} & keys) or {"gyro_counts", "acc_counts"} <= keys


def _read_log(path: Path, settings: Mapping[str, str]) -> list[Table]:
    names, units, data, stamps, rate = static.parts(path)
    start, t = stamps if stamps is not None else (0, None)
    columns: dict[str, NDArray[Any]] = dict(zip(names, data, strict=True))
    used = parse_map("gyro=gx gy gz, accel=ax ay az") if set(COLUMNS) <= set(names) else guess_map(names)
    if t is not None:
        columns["t"] = t
        used = used.over(parse_map("time=t"))
    elif rate is not None:
        used = used.over(ColumnMap({}, {"rate": f"{rate!r} Hz"}))
    stated = {n: u for n, u in zip(names, units, strict=True) if u.lower() not in ("counts", "count", "lsb", "raw")}
    return [Table(path.name, columns, stated, used, start=start)]


register(Reader("recording (.npz or folder)", _is_recording, _read_recording, rank=0, besides=recording.besides_of))
register(Reader("static log (.npz, .npy)", _is_log, _read_log, rank=1))
