"""KF-GINS and awesome-gins text: no header, seconds of the GPS week first.

IMU: SOW, three delta angles (rad), three delta velocities (m/s), forward-right-down. Fixes (``.pos``): SOW, latitude, longitude (deg),
height (m), standard deviations north, east, down (m). Truth (``.nav``): week, SOW, position, velocity NED, roll, pitch, yaw (deg).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.formats.columns import ColumnMap, parse_map
from insemu.formats.table import Probe, Reader, Table, read_delimited, register

_IMU = parse_map("time=sow[s], gyro=dtheta_*[rad], accel=dvel_*[m/s], kind=increment")
_RATES = parse_map("time=sow[s], gyro=dtheta_*, accel=dvel_*[m/s^2], kind=sample")
_POS = parse_map("time=sow[s], lat=lat[deg], lon=lon[deg], height=h[m], pos_std_ned=std_n std_e std_d[m]")
_NAV = parse_map("time=sow[s], lat=lat[deg], lon=lon[deg], height=h[m], vel_ned=vn ve vd[m/s], rpy=roll pitch yaw[deg]")
_NAMES: Mapping[str, tuple[tuple[str, ...], ColumnMap]] = {
    "imu": (("sow", "dtheta_x", "dtheta_y", "dtheta_z", "dvel_x", "dvel_y", "dvel_z"), _IMU),
    "rates": (("sow", "dtheta_x", "dtheta_y", "dtheta_z", "dvel_x", "dvel_y", "dvel_z"), _RATES),
    "pos": (("sow", "lat", "lon", "h", "std_n", "std_e", "std_d"), _POS),
    "nav": (("week", "sow", "lat", "lon", "h", "vn", "ve", "vd", "roll", "pitch", "yaw"), _NAV),
}


def _what(probe: Probe) -> str:
    """Which of the three files it is; "" for none."""
    if probe.suffix not in (".txt", ".pos", ".nav", ".imu", ".imr", ".csv", ""):
        return ""
    rows = probe.numbers(120)
    if rows is None or len(rows) < 3 or not np.isfinite(rows).all():
        return ""
    t = rows[:, 1] if rows.shape[1] == 11 else rows[:, 0]
    step = np.diff(t)
    if not (0.0 <= t.min() and t.max() < 604_800.0 and np.mean(step > 0) > 0.9):
        return ""
    dt = float(np.median(step))
    if (
        rows.shape[1] == 11
        and (np.abs(rows[:, 2]) <= 90).all()
        and rows[0, 0] == round(rows[0, 0])
        and rows[0, 0] < 5000
    ):
        return "nav"
    if rows.shape[1] != 7:
        return ""
    place = (
        (np.abs(rows[:, 1]) <= 90).all()
        and (np.abs(rows[:, 2]) <= 360).all()
        and (rows[:, 1:3].std(axis=0) < 1.0).all()
    )
    if dt > 0.02 and place and (rows[:, 4:] >= 0).all() and (probe.suffix == ".pos" or (rows[:, 1:4] != 0.0).all()):
        return "pos"
    force = float(np.median(np.linalg.norm(rows[:, 4:7], axis=1))) / dt
    angle = float(np.median(np.linalg.norm(rows[:, 1:4], axis=1)))
    if 7.0 < force < 14.0 and dt <= 0.1 and angle < 0.5:
        return "imu"
    return (
        "rates" if 7.0 < force * dt < 14.0 and dt <= 0.1 else ""
    )  # the layout with another content (KF-GINS, issues 12 and 23)


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    names, used = _NAMES[_what(Probe(path))]
    columns, _, _ = read_delimited(path, names=names)
    return [Table(path.name, columns, {}, used, "sow")]


register(Reader("KF-GINS / awesome-gins text (.txt, .pos, .nav)", lambda p: bool(_what(p)), _read, rank=4))
