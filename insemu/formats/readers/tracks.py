"""Tracks of maps: GPX, KML (``gx:Track``), GeoJSON with times. Positions only, UTC."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from insemu.errors import InputError
from insemu.formats.columns import parse_map
from insemu.formats.decoding import open_binary, open_text
from insemu.formats.table import Probe, Reader, Table, register

_LINE = "lat=lat[deg], lon=lon[deg], height=height[m]"


def _table(path: Path, rows: list[tuple[float, float, float, float]], settings: Mapping[str, str]) -> list[Table]:
    if not rows:
        raise InputError("holds no positions", where=str(path))
    block = np.array(rows, dtype=np.float64)
    columns = {n: block[:, k] for k, n in enumerate(("time", "lat", "lon", "height"))}
    timed = np.isfinite(block[:, 0]).any()
    if not timed and "rate" not in settings:
        raise InputError(
            "has positions without times: a scenario flies them as waypoints (trajectory: {waypoints: FILE, speed: 10 m/s}); with the map "
            "'rate=1 Hz' they are one a second",
            where=str(path),
        )
    return [
        Table(path.name, columns, {}, parse_map(("time=time[s], " if timed else "") + _LINE), "unix" if timed else "")
    ]


def _stamp(text: str | None) -> float:
    """Seconds since 1970 of a date; NaN of none."""
    if not text:
        return float("nan")
    when = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _plain(tag: str) -> str:
    return tag.rpartition("}")[2]


def _elements(path: Path) -> ElementTree.Element:
    with open_binary(path) as file:
        return ElementTree.parse(file).getroot()  # expat >= 2.4.1 bounds entity expansion


def _read_gpx(path: Path, settings: Mapping[str, str]) -> list[Table]:
    rows = []
    for point in _elements(path).iter():
        if _plain(point.tag) in ("trkpt", "rtept", "wpt") and "lat" in point.attrib and "lon" in point.attrib:
            inner = {_plain(c.tag): c.text for c in point}
            height = float(inner.get("ele") or "nan")
            rows.append((_stamp(inner.get("time")), float(point.attrib["lat"]), float(point.attrib["lon"]), height))
    return _table(path, _with_heights(rows), settings)


def _with_heights(rows: list[tuple[float, float, float, float]]) -> list[tuple[float, float, float, float]]:
    return [(t, lat, lon, 0.0 if np.isnan(h) else h) for t, lat, lon, h in rows]


def _read_kml(path: Path, settings: Mapping[str, str]) -> list[Table]:
    root = _elements(path)
    whens = [_stamp(e.text) for e in root.iter() if _plain(e.tag) == "when"]
    coords = [(e.text or "").split() for e in root.iter() if _plain(e.tag) == "coord"]
    if not coords:
        coords = [c.split(",") for e in root.iter() if _plain(e.tag) == "coordinates" for c in (e.text or "").split()]
    if whens and len(whens) != len(coords):
        raise InputError(f"has {len(whens)} times for {len(coords)} positions", where=str(path))
    stamps = whens or [float("nan")] * len(coords)
    rows = [
        (t, float(c[1]), float(c[0]), float(c[2]) if len(c) > 2 else 0.0) for t, c in zip(stamps, coords, strict=True)
    ]
    return _table(path, rows, settings)


def _features(content: Any) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Geometry and properties of every feature."""
    features = content.get("features", [content]) if isinstance(content, dict) else []
    for feature in features if isinstance(features, list) else []:
        if isinstance(feature, dict):
            geometry = feature.get("geometry", feature)
            properties = feature.get("properties")
            if isinstance(geometry, dict):
                yield geometry, properties if isinstance(properties, dict) else {}


def _read_geojson(path: Path, settings: Mapping[str, str]) -> list[Table]:
    with open_text(path) as file:
        content = json.load(file)
    rows: list[tuple[float, float, float, float]] = []
    for geometry, properties in _features(content):
        points: Any = geometry.get("coordinates")
        nested = properties.get("coordinateProperties")
        times = properties.get("coordTimes") or properties.get("times") or (nested or {}).get("times") or []
        if geometry.get("type") == "Point":
            time = properties.get("time")
            points, times = [points], [properties.get("timestamp") if time is None else time]
        elif geometry.get("type") == "MultiLineString":
            points = [p for line in points for p in line]
            times = [t for part in times for t in (part if isinstance(part, list) else [part])]
        elif geometry.get("type") != "LineString":
            continue
        if times and len(times) != len(points):
            raise InputError(f"has {len(times)} times for {len(points)} positions", where=str(path))
        for k, point in enumerate(points):
            when = times[k] if times else None
            stamp = (
                _stamp(when)
                if isinstance(when, str)
                else (np.nan if when is None else float(when) * (1e-3 if when > 1e11 else 1.0))
            )
            rows.append((stamp, float(point[1]), float(point[0]), float(point[2]) if len(point) > 2 else 0.0))
    return _table(path, rows, settings)


def _xml(probe: Probe, tag: bytes) -> bool:
    return tag in probe.head[:4096].lower()


register(Reader("GPX track (.gpx)", lambda p: _xml(p, b"<gpx"), _read_gpx, rank=1))
register(Reader("KML track (.kml)", lambda p: _xml(p, b"<kml"), _read_kml, rank=1))
register(
    Reader(
        "GeoJSON track (.geojson)",
        lambda p: p.suffix in (".geojson", ".json") and b'"coordinates"' in p.head,
        _read_geojson,
        rank=1,
    )
)
