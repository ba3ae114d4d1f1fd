"""EuRoC MAV and TUM-VI (ASL layout): ``mav0/imu0/data.csv`` with stamps in ns, and the reference next to it.

Burri et al. 2016, "The EuRoC micro aerial vehicle datasets", section 4: gyroscope in rad/s, accelerometer in m/s^2, in sensor axes; the
reference is the sensor's pose in a frame with z up.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

_IMU = parse_map("time=timestamp[ns], gyro=w_RS_S_*[rad/s], accel=a_RS_S_*[m/s^2]")
_POSE = "time=timestamp[ns], enu=p_RS_R_*[m], quaternion=q_RS_w q_RS_x q_RS_y q_RS_z, axes=FRD"
_TRUTH = ("state_groundtruth_estimate0", "mocap0", "gt0", "vicon0")


def _is_file(probe: Probe) -> bool:
    return any(c.startswith("w_rs_s_x") for c in probe.header()) or any(
        c.startswith("p_rs_r_x") for c in probe.header()
    )


def _is_folder(probe: Probe) -> bool:
    return any(e.endswith("imu0/data.csv") for e in probe.entries)


def _table(path: Path) -> Table:
    columns, units, _ = read_delimited(path)
    named = {("timestamp" if n.lower().startswith("timestamp") else n): v for n, v in columns.items()}
    if any(n.startswith("w_RS_S") for n in named):
        return Table(path.name, named, units, _IMU, "unix")
    velocity = ", vel_enu=v_RS_R_*[m/s]" if any(n.startswith("v_RS_R") for n in named) else ""
    return Table(path.parent.name or path.name, named, units, parse_map(_POSE + velocity), "unix")


def _read_file(path: Path, settings: Mapping[str, str]) -> list[Table]:
    return [_table(path)]


def _read_folder(path: Path, settings: Mapping[str, str]) -> list[Table]:
    found = sorted(path.glob("**/imu0/data.csv"))
    if len(found) != 1:
        raise InputError(f"holds {len(found)} files imu0/data.csv, expected one", where=str(path))
    root = found[0].parents[1]
    truth = [root / name / "data.csv" for name in _TRUTH if (root / name / "data.csv").exists()]
    return [_table(found[0]), *(_table(p) for p in truth[:1])]


register(Reader("EuRoC or TUM-VI folder (imu0/data.csv)", _is_folder, _read_folder, rank=2))
register(Reader("EuRoC or TUM-VI file (data.csv)", _is_file, _read_file, rank=2))
