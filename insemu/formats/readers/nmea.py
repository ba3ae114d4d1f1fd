"""NMEA 0183 by ``pynmeagps``: GGA (position, quality), RMC (date, speed and course), VTG (speed and course), GST (standard deviations)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary
from insemu.formats.table import Probe, Reader, Table, register

#: What is assumed of sentences VTG, which state no time.
UNTIMED = "VTG sentences state no time: speed and course are of the GGA before them"


def _sniff(probe: Probe) -> bool:
    first = [x for x in probe.head.split(b"\n", 12)[:12] if x.strip()]
    return sum(x.lstrip()[:2] in (b"$G", b"$B") and x.count(b",") > 3 for x in first) > 0.5 * max(len(first), 1)


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    from pynmeagps import ERR_LOG, VALCKSUM, NMEAReader

    rows: list[list[float]] = []
    sigmas: dict[float, tuple[float, float, float]] = {}
    recommended: dict[float, tuple[float, float]] = {}
    timeless: dict[float, tuple[float, float]] = {}
    day: date | None = None
    broken: list[Exception] = []
    with open_binary(path) as file:
        for _, message in NMEAReader(
            file, quitonerror=ERR_LOG, errorhandler=broken.append, validate=VALCKSUM, nmeaonly=False
        ):
            if not hasattr(message, "msgID"):
                continue
            if message.msgID in ("RMC", "ZDA"):
                day = _date(message) or day
            if message.msgID == "RMC" and message.time != "" and message.status == "A":
                recommended[_stamp(message.time, day)] = _number(message.spd), _number(message.cog)
            elif message.msgID == "VTG" and rows:
                timeless[rows[-1][0]] = _number(message.sogn), _number(message.cogt)
            elif message.msgID == "GGA" and message.quality and message.lat != "" and message.time != "":
                height = _number(message.alt) + np.nan_to_num(_number(message.sep))
                rows.append([_stamp(message.time, day), message.lat, message.lon, height, float(message.quality)])
            elif message.msgID == "GST" and message.time != "":
                sigmas[_stamp(message.time, day)] = tuple(  # type: ignore[assignment]
                    _number(getattr(message, k, "")) for k in ("stdLat", "stdLong", "stdAlt")
                )
    if not rows:
        raise InputError("holds no GGA sentence with a position", where=str(path))
    block = np.array(rows, dtype=np.float64)
    dated = day is not None
    if not dated:  # midnight
        block[:, 0] += 86_400.0 * np.concatenate([[0], np.cumsum(np.diff(block[:, 0]) < -43_200.0)])
    columns = {n: block[:, k] for k, n in enumerate(("time", "lat", "lon", "height", "quality"))}
    line = "time=time[s], lat=lat[deg], lon=lon[deg], height=height[m], quality=quality"
    if sigmas:
        spread = np.array([sigmas.get(row[0], (np.nan,) * 3) for row in rows])
        columns |= {n: spread[:, k] for k, n in enumerate(("std_n", "std_e", "std_d"))}
        line += ", pos_std_ned=std_n std_e std_d[m]"
    motion, assumed = recommended or timeless, () if recommended or not timeless else (UNTIMED,)
    if motion:
        over_ground = np.array([motion.get(row[0], (np.nan,) * 2) for row in rows])
        columns |= {n: over_ground[:, k] for k, n in enumerate(("speed", "course"))}
        line += ", speed=speed[knots], course=course[deg]"
    notes = [] if dated else ["no sentence has a date: times are seconds of the day (UTC)"]
    notes += [f"{len(broken)} line(s) are no NMEA sentence or fail their checksum"] if broken else []
    return [Table(path.name, columns, {}, parse_map(line), "unix" if dated else "", assumed, tuple(notes))]


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return float("nan")


def _date(message: Any) -> date | None:
    if message.msgID == "RMC":
        return message.date if isinstance(message.date, date) else None
    try:
        return date(int(message.year), int(message.month), int(message.day))
    except (TypeError, ValueError):
        return None


def _stamp(time: Any, day: date | None) -> float:
    seconds: float = time.hour * 3600.0 + time.minute * 60.0 + time.second + 1e-6 * time.microsecond
    return seconds if day is None else seconds + datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()


register(Reader("NMEA 0183 (.nmea, .txt)", _sniff, _read, rank=1))
