"""ROS 1 and ROS 2 bags and MCAP by ``rosbags``, without ROS: ``sensor_msgs/Imu``, ``sensor_msgs/NavSatFix``, twists.

Messages of one length are read piece by piece through one structured view; others message by message. Axes are forward-left-up (REP 103), the
local frame is east-north-up, unless the map says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.formats.bags import indexless, pieces
from insemu.formats.columns import parse_map
from insemu.formats.table import Probe, Reader, Table, register

_IMU, _FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
_VELOCITY = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped")
_IMU_NAMES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
_IMU_LINE = "time=stamp[ns], gyro=gyro_*[rad/s], accel=accel_*[m/s^2]"
_FIX_LINE = "time=stamp[ns], lat=lat[deg], lon=lon[deg], height=height[m]"


def _sniff(probe: Probe) -> bool:
    if probe.head.startswith((b"#ROSBAG V2.0", b"\x89MCAP0\r\n")):
        return True
    if probe.suffix == ".db3" and probe.head.startswith(b"SQLite format 3"):
        return True
    return "metadata.yaml" in probe.entries and any(
        e.endswith((".db3", ".mcap", ".db3.zstd", ".mcap.zstd")) for e in probe.entries
    )


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    root = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").exists() else path
    reader = AnyReader([root], default_typestore=get_typestore(Stores.LATEST))
    if not reader.is2:
        reader.readers = [indexless(root)]
    with reader as bag:
        topics = {name: info.msgtype or "" for name, info in bag.topics.items() if info.msgcount}
        imu = _choose(topics, (_IMU,), settings.get("topic", ""), "topic", path)
        fix = _choose(topics, (_FIX,), settings.get("gnss_topic", ""), "gnss_topic", path)
        if not imu and not fix:
            listed = ", ".join(f"{n} ({t})" for n, t in sorted(topics.items())[:12])
            raise InputError(f"has no topic of {_IMU} or {_FIX}; it has {listed or 'none'}", where=str(path))
        tables = []
        if imu:
            t, block = _block(bag, imu, _imu_row, _imu_layout)
            used = parse_map(_IMU_LINE + ("" if settings.get("axes") else ", axes=FLU"))
            said = (
                ()
                if settings.get("axes")
                else (f"axes of {imu} are forward-left-up (REP 103): --map 'axes=FRD' says otherwise",)
            )
            tables.append(Table(imu, _named(t, _IMU_NAMES, block), {}, used, "unix", said))
        if fix:
            tables.append(_fixes(bag, fix, topics))
    return tables


def _choose(topics: Mapping[str, str], types: tuple[str, ...], wanted: str, key: str, path: Path) -> str:
    """The topic of a type: the one that was asked for, or the only one; several are listed."""
    found = sorted(n for n, t in topics.items() if t in types)
    if wanted:
        if wanted not in found:
            raise InputError(f"has no topic '{wanted}'" + nearest(wanted, found), where=str(path))
        return wanted
    if len(found) > 1:
        raise InputError(
            f"has {len(found)} topics of {types[0]}: {', '.join(found)}; say which (--map '{key}={found[0]}')",
            where=str(path),
        )
    return found[0] if found else ""


def _named(t: NDArray[np.int64], names: tuple[str, ...], block: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    return {"stamp": t, **{n: block[:, k] for k, n in enumerate(names)}}


def _imu_row(m: Any) -> list[float]:
    w, f = m.angular_velocity, m.linear_acceleration
    return [w.x, w.y, w.z, f.x, f.y, f.z]


def _imu_layout(raw: bytes, ros2: bool) -> tuple[int, int, list[int]] | None:
    """Byte offsets of the stamp (s, ns) and of the six numbers in a serialized message."""
    if ros2:  # CDR: 4 bytes of header, stamp, length of the frame's name; doubles aligned to 8 behind the header
        name = int.from_bytes(raw[12:16], "little")
        start = 4 + -(-(12 + name) // 8) * 8
        stamp = 4
    else:
        name = int.from_bytes(raw[12:16], "little")
        start, stamp = 16 + name, 4
    offsets = [start + 8 * k for k in (13, 14, 15, 25, 26, 27)]
    return None if offsets[-1] + 8 > len(raw) or (ros2 and raw[1] != 1) else (stamp, stamp + 4, offsets)


def _block(bag: Any, topic: str, row: Any, layout: Any = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Stamps (ns) and numbers of all messages of a topic, in the order in which they were logged."""
    kind = next(c.msgtype for c in bag.connections if c.topic == topic)
    logged, stamps, blocks = [], [], []
    for times, raws in pieces(bag, topic):
        t, block = _viewed(bag, kind, raws, row, layout) or _spelt(bag, kind, raws, row)
        logged.append(np.array(times, dtype=np.int64))
        stamps.append(t)
        blocks.append(block)
    if not stamps:
        raise InputError("holds no message", where=topic)
    log, t, block = np.concatenate(logged), np.concatenate(stamps), np.concatenate(blocks)
    if (np.diff(log) >= 0).all():
        return t, block
    order = np.argsort(log, kind="stable")
    return t[order], block[order]


def _viewed(
    bag: Any, kind: str, raws: list[bytes], row: Any, layout: Any
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Stamps and numbers of messages of one length by their places; None where the lengths differ or the first says otherwise."""
    first = raws[0]
    found = layout(first, bag.is2) if layout is not None and {*map(len, raws)} == {len(first)} else None
    if found is None:
        return None
    at_s, at_ns, offsets = found
    dtype = np.dtype(
        {"names": ["s", "ns", "name", *map(str, offsets)], "formats": ["<u4", "<u4", "<u4"] + ["<f8"] * len(offsets),
         "offsets": [at_s, at_ns, 12, *offsets], "itemsize": len(first)}
    )  # fmt: skip
    view = np.frombuffer(b"".join(raws), dtype=dtype)
    check = row(bag.deserialize(first, kind))
    if (view["name"] != view["name"][0]).any() or not np.array_equal([view[str(o)][0] for o in offsets], check, True):
        return None
    t = view["s"].astype(np.int64) * 1_000_000_000 + view["ns"]
    return t, np.column_stack([view[str(o)] for o in offsets])


def _spelt(bag: Any, kind: str, raws: list[bytes], row: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Stamps and numbers message by message."""
    messages = [bag.deserialize(raw, kind) for raw in raws]
    stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in messages]
    return np.array(stamps, dtype=np.int64), np.array([row(m) for m in messages], dtype=np.float64)


def _fix_row(m: Any) -> list[float]:
    good = m.status.status >= 0
    spread = np.sqrt(np.abs(np.asarray(m.position_covariance, dtype=np.float64)[[0, 4, 8]]))
    known = m.position_covariance_type > 0
    return [*([m.latitude, m.longitude, m.altitude] if good else [np.nan] * 3), *(spread if known else [np.nan] * 3)]


def _fixes(bag: Any, topic: str, topics: Mapping[str, str]) -> Table:
    """Fixes, with the velocity of the topic of twists whose name begins like theirs, where there is one."""
    t, block = _block(bag, topic, _fix_row)
    columns = _named(t, ("lat", "lon", "height", "std_e", "std_n", "std_u"), block)
    line = _FIX_LINE
    if np.isfinite(block[:, 3:]).any():
        line += ", pos_std_enu=std_e std_n std_u[m]"
    base = topic.rsplit("/", 1)[0]
    twists = [n for n, kind in topics.items() if kind in _VELOCITY and base and n.startswith(base + "/")]
    if len(twists) == 1:
        tv, v = _block(bag, twists[0], _twist_row)
        order = np.argsort(tv, kind="stable")
        tv, v = tv[order], v[order]
        near = np.searchsorted(
            tv[:-1] + np.diff(tv) // 2, t
        )  # bounds halfway between stamps: the nearest, before a fix or behind it
        matched = np.abs(tv[near] - t) < 20_000_000
        columns |= {n: np.where(matched, v[near, k], np.nan) for k, n in enumerate(("ve", "vn", "vu"))}
        line += ", vel_enu=ve vn vu[m/s]"
    return Table(topic, columns, {}, parse_map(line), "unix")


def _twist_row(m: Any) -> list[float]:
    v = m.twist.twist.linear if hasattr(m.twist, "twist") else m.twist.linear
    return [v.x, v.y, v.z]


register(Reader("ROS bag (.bag, .db3, .mcap or its folder)", _sniff, _read, rank=0))
