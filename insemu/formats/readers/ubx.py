"""u-blox UBX by ``pyubx2``: NAV-PVT (fixes with velocity and accuracy) and ESF-RAW or ESF-MEAS (the receiver's IMU)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary
from insemu.formats.table import Probe, Reader, Table, register

#: Data types of ESF measurements (u-blox F9 interface description, ESF-MEAS): column and size of one count.
_TYPES = {
    14: ("gyro_x", 2.0**-12), 13: ("gyro_y", 2.0**-12), 5: ("gyro_z", 2.0**-12), 16: ("accel_x", 2.0**-10),
    17: ("accel_y", 2.0**-10), 18: ("accel_z", 2.0**-10),
}  # fmt: skip
_PVT = parse_map(
    "time=itow[ms], lat=lat[deg], lon=lon[deg], height=height[mm], vel_ned=velN velE velD[mm/s], pos_std_h=hAcc[mm], "
    "pos_std_v=vAcc[mm], vel_std_h=sAcc[mm/s]"
)
_IMU = parse_map("time=tag[s], gyro=gyro_*[deg/s], accel=accel_*[m/s^2]")


def _sniff(probe: Probe) -> bool:
    return probe.suffix in (".ubx", ".ubz", ".bin", ".log", ".raw", "") and b"\xb5\x62" in probe.head[:8192]


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    from pyubx2 import ERR_IGNORE, UBX_PROTOCOL, UBXReader

    pvt: list[list[float]] = []
    raw: dict[float, dict[str, float]] = {}
    arrivals: list[tuple[float, float]] = []
    with open_binary(path) as file:
        for _, message in UBXReader(file, protfilter=UBX_PROTOCOL, quitonerror=ERR_IGNORE):
            if message is None:
                continue
            if (
                message.identity == "NAV-PVT"
                and getattr(message, "fixType", 0) >= 2
                and getattr(message, "gnssFixOk", 1)
            ):
                pvt.append(
                    [
                        getattr(message, k)
                        for k in ("iTOW", "lat", "lon", "height", "velN", "velE", "velD", "hAcc", "vAcc", "sAcc")
                    ]
                )
            elif message.identity in ("ESF-RAW", "ESF-MEAS"):
                for tag, column, value in _measurements(message.identity, message.payload):
                    raw.setdefault(tag, {})[column] = value
                    if pvt and (not arrivals or arrivals[-1][0] != pvt[-1][0]):
                        arrivals.append((pvt[-1][0], tag))
    tables = []
    if pvt:
        block = np.array(pvt, dtype=np.float64)
        names = ("itow", "lat", "lon", "height", "velN", "velE", "velD", "hAcc", "vAcc", "sAcc")
        tables.append(Table("NAV-PVT", {n: block[:, k] for k, n in enumerate(names)}, {}, _PVT, "sow"))
    imu = _imu(raw, arrivals)
    if imu is not None:
        tables.append(imu)
    if not tables:
        raise InputError("holds neither NAV-PVT nor ESF-RAW or ESF-MEAS messages", where=str(path))
    return tables


def _measurements(identity: str, payload: bytes) -> list[tuple[float, str, float]]:
    """(time tag in s, column, value) of one message: words of 24 bits of data and a type (u-blox F9 interface description)."""
    if identity == "ESF-RAW":  # 4 bytes reserved, then pairs of data and time tag
        pairs = np.frombuffer(payload[4 : 4 + (len(payload) - 4) // 8 * 8], dtype="<u4").reshape(-1, 2)
        words = [(int(w), int(tag)) for w, tag in pairs]
    else:  # time tag, flags, id, then data: as many as the flags' upper five bits say
        tag, flags = int.from_bytes(payload[:4], "little"), int.from_bytes(payload[4:6], "little")
        data = payload[8 : 8 + 4 * min(flags >> 11, (len(payload) - 8) // 4)]
        words = [(int(w), tag) for w in np.frombuffer(data, dtype="<u4")]
    out = []
    for word, tag in words:
        kind = (word >> 24) & 0x3F
        if kind in _TYPES:
            column, size = _TYPES[kind]
            count = word & 0xFFFFFF
            count -= 1 << 24 if count >= 1 << 23 else 0
            out.append((1e-3 * float(tag), column, count * size))
    return out


def _imu(raw: Mapping[float, Mapping[str, float]], arrivals: list[tuple[float, float]]) -> Table | None:
    names = [name for name, _ in _TYPES.values()]
    tags = sorted(tag for tag, row in raw.items() if len(row) == len(names))
    if len(tags) < 3:
        return None
    columns = {name: np.array([raw[tag][name] for tag in tags]) for name in names}
    t = np.array(tags)
    if not arrivals:
        return Table("ESF", {"tag": t, **columns}, {}, _IMU, "")
    offset = float(np.median([1e-3 * itow - tag for itow, tag in arrivals]))
    said = f"the IMU's own clock is {offset:.3f} s behind GPS time, from the order in which messages arrived"
    return Table("ESF", {"tag": t + offset, **columns}, {}, _IMU, "sow", (said,))


register(Reader("u-blox UBX (.ubx)", _sniff, _read, rank=1))
