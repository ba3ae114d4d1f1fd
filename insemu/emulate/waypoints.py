"""Routes from waypoints with speeds, under the limits of a vehicle.

Legs are straight, corners are rounded by turns whose lateral acceleration and turn rate stay within the vehicle's,
speeds are reached within its acceleration. Read from CSV (``lat, lon[, height][, speed]`` with units in the header)
or GeoJSON (longitude first).
"""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, units
from insemu.emulate.flight import Flight
from insemu.emulate.motion import Command, legs_of, path_of, profile, smoothstep_integral
from insemu.emulate.vehicle import STEEPEST_ROAD, Vehicle, odd_places, vehicle
from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

_FOOT = 0.3048
#: Share of the vehicle's limits that a route uses.
_COMFORT = 0.5


@dataclass(frozen=True)
class Waypoints:
    """Places to pass, in order.

    Parameters
    ----------
    llh : (n, 3) array
        Latitude rad, longitude rad, height m.
    speed : (n,) array
        Speed of the leg that starts at each waypoint, m/s (the last is not used).
    source : str
        Appears in messages.
    """

    llh: Array
    speed: Array
    source: str = "waypoints"

    def __post_init__(self) -> None:
        llh = np.array(self.llh, dtype=float)
        if llh.ndim != 2 or llh.shape[1] != 3:
            raise InputError(f"{self.source}: waypoints have shape {llh.shape}, expected (n, 3)")
        if len(llh) < 2:
            raise InputError(f"{self.source}: {len(llh)} waypoint(s), expected at least two")
        speed = np.broadcast_to(np.asarray(self.speed, dtype=float), (len(llh),)).copy()
        bad = ~np.isfinite(np.column_stack([llh, speed])).all(axis=1)
        if bad.any():
            raise InputError(f"{self.source}: waypoint {int(np.argmax(bad)) + 1} has a value that is not finite")
        wrong = np.abs(llh[:, 0]) > np.pi / 2
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"{self.source}: waypoint {k + 1} has a latitude of {np.rad2deg(llh[k, 0]):.6g} deg; "
                "are latitude and longitude swapped?"
            )
        object.__setattr__(self, "llh", llh)
        object.__setattr__(self, "speed", speed)


_NAMES = {
    "lat": "lat", "latitude": "lat", "lon": "lon", "lng": "lon", "long": "lon", "longitude": "lon",
    "height": "height", "alt": "height", "altitude": "height", "h": "height", "ele": "height", "elevation": "height",
    "speed": "speed", "v": "speed", "velocity": "speed",
}  # fmt: skip
_UNIT = {"lat": "rad", "lon": "rad", "height": "m", "speed": "m/s"}
_ASSUMED = {"lat": "deg", "lon": "deg", "height": "m", "speed": "m/s"}
_HEADER = re.compile(r"^\s*([A-Za-z]+)\s*(?:[\[(_]\s*([^\])]*?)\s*[\])]?)?\s*$")
_WRITTEN = {"kmh": "km/h", "kph": "km/h", "kts": "kn", "knots": "kn", "feet": "ft", "mps": "m/s", "ms": "m/s"}


def read_waypoints(path: str | Path, speed: float | None = None) -> Waypoints:
    """Read waypoints from CSV or GeoJSON.

    Parameters
    ----------
    path : path
        ``.csv`` with a header such as ``lat, lon, height [m], speed [km/h]``; ``.geojson`` or ``.json`` with a
        LineString or with Points, speed in their property ``speed`` (m/s).
    speed : float, optional
        Speed of all legs in m/s where the file has none.

    Raises
    ------
    InputError
        Anything that cannot be read, with file and line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such waypoint file", where=str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", where=str(path)) from None
    if path.suffix.lower() in (".geojson", ".json"):
        return _geojson(text, str(path), speed)
    return _csv(text, str(path), speed)


def _csv(text: str, source: str, speed: float | None) -> Waypoints:
    rows = [(k + 1, row) for k, row in enumerate(csv.reader(text.splitlines())) if row and not row[0].startswith("#")]
    if not rows:
        raise InputError("empty, expected a header and waypoints", where=source)
    line, header = rows[0]
    columns: dict[str, tuple[int, float]] = {}
    for k, cell in enumerate(header):
        match = _HEADER.match(cell)
        name = match.group(1).lower() if match else cell.strip().lower()
        if name not in _NAMES:
            raise InputError(f"unknown column '{cell.strip()}'" + nearest(name, _NAMES), where=f"{source}:{line}")
        key = _NAMES[name]
        unit = (match.group(2) if match else None) or _ASSUMED[key]
        unit = _WRITTEN.get(unit, unit)
        try:
            columns[key] = (k, units.conversion(unit, _UNIT[key]))
        except InputError as error:
            raise InputError(f"column '{cell.strip()}': {error.message}", where=f"{source}:{line}") from None
    for key in ("lat", "lon"):
        if key not in columns:
            raise InputError(f"no column '{key}' in the header", where=f"{source}:{line}")
    values: dict[str, list[float]] = {key: [] for key in columns}
    for line, row in rows[1:]:
        for key, (k, factor) in columns.items():
            try:
                values[key].append(float(row[k]) * factor)
            except IndexError:
                raise InputError(f"{len(row)} cells, expected {len(header)}", where=f"{source}:{line}") from None
            except ValueError:
                raise InputError(
                    f"found '{row[k].strip()}' for {key}, expected a number", where=f"{source}:{line}"
                ) from None
            if not np.isfinite(values[key][-1]):
                raise InputError(
                    f"found '{row[k].strip()}' for {key}, expected a finite number", where=f"{source}:{line}"
                )
    n = len(values["lat"])
    heights = values.get("height", [0.0] * n)
    given = values.get("speed")
    if given is None and speed is None:
        raise InputError("no column 'speed' and no speed given for all legs", where=source)
    llh = np.column_stack([values["lat"], values["lon"], heights]) if n else np.zeros((0, 3))
    return Waypoints(llh, np.array(given if given is not None else [speed] * n), source)


def _geojson(text: str, source: str, speed: float | None) -> Waypoints:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"not JSON: {error.msg}", where=f"{source}:{error.lineno}") from None
    if not isinstance(document, dict):
        raise InputError("not GeoJSON, expected an object with the key 'type'", where=source)
    features = document.get("features", [document])
    points: list[tuple[Any, Any]] = []
    for feature in features if isinstance(features, list) else [features]:
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        if not isinstance(geometry, dict):
            raise InputError(f"found {feature!r:.60}, expected a feature with a geometry", where=source)
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        properties = feature.get("properties")
        own = properties.get("speed") if isinstance(properties, dict) else None
        if kind not in ("LineString", "Point"):
            raise InputError(f"geometry of type '{kind}', expected LineString or Point", where=source)
        if not isinstance(coordinates, list):
            raise InputError(f"a {kind} without 'coordinates'", where=source)
        if kind == "LineString":
            speeds = own if isinstance(own, list) else [own] * len(coordinates)
            if len(speeds) != len(coordinates):
                raise InputError(f"{len(speeds)} speeds for {len(coordinates)} points", where=source)
            points += list(zip(coordinates, speeds, strict=True))
        else:
            points.append((coordinates, own))
    rows, speeds_out = [], []
    for k, (place, own) in enumerate(points):
        numbers = isinstance(place, list) and all(type(x) in (int, float) for x in place)
        if not numbers or len(place) not in (2, 3):
            raise InputError(f"point {k + 1} is {place!r:.60}, expected [longitude, latitude(, height)]", where=source)
        rows.append([np.deg2rad(place[1]), np.deg2rad(place[0]), place[2] if len(place) == 3 else 0.0])
        value = own if own is not None else speed
        if value is None:
            raise InputError(f"point {k + 1} has no property 'speed' and no speed was given for all legs", where=source)
        try:
            speeds_out.append(units.parse(value, "m/s"))
        except InputError as error:
            raise InputError(f"speed of point {k + 1}: {error.message}", where=source) from None
    llh = np.array(rows, dtype=float).reshape(-1, 3)
    _check_box(document.get("bbox"), llh, source)
    return Waypoints(llh, np.array(speeds_out), source)


def _check_box(box: Any, llh: Array, source: str) -> None:
    """Hold points against the ``bbox`` of a GeoJSON file: west, south, (lowest,) east, north, (highest)."""
    if box is None or not len(llh):
        return
    if not isinstance(box, list) or len(box) not in (4, 6) or not all(type(x) in (int, float) for x in box):
        raise InputError(f"bbox is {box!r:.60}, expected [west, south, east, north]", where=source)
    west, south, east, north = box[0], box[1], box[len(box) // 2], box[len(box) // 2 + 1]
    lat, lon = np.rad2deg(llh[:, 0]), np.rad2deg(llh[:, 1])

    def inside(lat: Array, lon: Array) -> NDArray[np.bool_]:
        across = (lon >= west) & (lon <= east) if west <= east else (lon >= west) | (lon <= east)
        return np.asarray(across & (lat >= south) & (lat <= north))

    out = ~inside(lat, lon)
    if out.any():
        k = int(np.argmax(out))
        swapped = "; with latitude and longitude swapped all points fit" if inside(lon, lat).all() else ""
        raise InputError(
            f"point {k + 1} [{lon[k]:.6g}, {lat[k]:.6g}] is outside of the file's bbox {box}{swapped}", where=source
        )


@dataclass(frozen=True)
class Route:
    """A flight along waypoints, and what looked odd about them."""

    flight: Flight
    warnings: tuple[str, ...] = ()


def _turn(angle: float, speed: float, v: Vehicle) -> tuple[float, float]:
    """Duration in s of a turn and the distance in m from its start to the corner that it rounds."""
    rate = _COMFORT * min(v.max_lateral / max(speed, 0.1), v.max_turn_rate)
    size = abs(angle)
    duration = 1.5 * size / rate
    if duration > 12.0:
        duration = size / rate + 4.0
    ramp = min(4.0, duration / 3.0)
    t = np.linspace(0.0, duration, 201)
    heading = (
        size
        / (duration - ramp)
        * ramp
        * (smoothstep_integral(t / ramp) - smoothstep_integral((t - duration + ramp) / ramp))
    )
    along = speed * np.trapezoid(np.cos(heading), t)
    return duration, float(along / (1.0 + np.cos(size)))


def route(
    waypoints: Waypoints,
    vehicle_name: str = "car",
    *,
    rest_s: float = 20.0,
    name: str | None = None,
) -> Route:
    """Drive or fly along waypoints.

    Parameters
    ----------
    waypoints : Waypoints
        Places and speeds.
    vehicle_name : str
        Key of :data:`insemu.emulate.vehicle.VEHICLES`.
    rest_s : float
        Rest at both ends (not for a fixed wing, which starts and ends in flight).
    name : str, optional
        Name of the path.

    Raises
    ------
    InputError
        Speeds or climbs beyond the vehicle, legs too short for the turns, turns of more than 150 deg, points that
        repeat.
    """
    v = vehicle(vehicle_name)
    source, llh = waypoints.source, waypoints.llh
    n = len(llh)
    leg_speed = waypoints.speed[:-1]
    for k, s in enumerate(leg_speed):
        if s > v.max_speed or s < max(v.min_speed, 0.1):
            raise InputError(
                f"{source}: waypoint {k + 1} asks for {s:.4g} m/s, a {v.name} does {max(v.min_speed, 0.1):g} to {v.max_speed:g} m/s"
            )
    rm, rn = earth.radii(llh[0, 0])
    scale = np.array([float(rm + llh[0, 2]), float((rn + llh[0, 2]) * np.cos(llh[0, 0]))])
    plane = np.column_stack([llh[:, 0] - llh[0, 0], np.unwrap(llh[:, 1]) - llh[0, 1]]) * scale
    leg = np.diff(plane, axis=0)
    length = np.hypot(leg[:, 0], leg[:, 1])
    if (length < 1.0).any():
        k = int(np.argmin(length))
        raise InputError(f"{source}: waypoints {k + 1} and {k + 2} are {length[k]:.3g} m apart, expected at least 1 m")
    far = length / leg_speed
    if far.max() > 6 * 3600.0:
        k = int(np.argmax(far))
        raise InputError(
            f"{source}: the leg from waypoint {k + 1} is {length[k] / 1000:.4g} km, {far[k] / 3600:.3g} h at its speed; "
            "are latitude and longitude swapped?"
        )
    course = np.unwrap(np.arctan2(leg[:, 1], leg[:, 0]))
    angle = np.diff(course)
    if (np.abs(angle) > np.deg2rad(150)).any():
        k = int(np.argmax(np.abs(angle)))
        raise InputError(
            f"{source}: waypoint {k + 2} turns by {np.rad2deg(angle[k]):.0f} deg, expected at most 150 deg; add a waypoint beside it"
        )
    climb = np.diff(llh[:, 2])
    warnings = odd_places(source, llh, v) + _check_climb(source, v, climb, length, leg_speed)

    moving_ends = v.min_speed > 0
    corner = np.empty(n)  # speed at the waypoints
    corner[0] = leg_speed[0] if moving_ends else 0.0
    corner[-1] = leg_speed[-1] if moving_ends else 0.0
    corner[1:-1] = np.minimum(leg_speed[:-1], leg_speed[1:])
    accel = _COMFORT * v.max_acceleration

    def layout() -> tuple[Array, Array, Array]:
        turns = [_turn(a, s, v) if abs(a) > 1e-3 else (0.0, 0.0) for a, s in zip(angle, corner[1:-1], strict=True)]
        duration = np.array([x for x, _ in turns])
        away = np.concatenate([[0.0], [d for _, d in turns], [0.0]])
        free = length - away[:-1] - away[1:]
        # two smooth changes of speed per leg; a quintic's peak acceleration is 1.875 times its mean
        need = np.zeros(n - 1)
        for k in range(n - 1):
            for end in (corner[k], corner[k + 1]):
                need[k] += 0.5 * (leg_speed[k] + end) * max(1.875 * abs(leg_speed[k] - end) / accel, 0.0)
        return duration, free, need

    cruise = leg_speed.copy()
    for _ in range(60):
        leg_speed = cruise
        duration, free, need = layout()
        short = free < need
        if not short.any():
            break
        for k in map(int, np.nonzero(short)[0]):
            if free[k] > 0.0 and not moving_ends:
                cruise[k] = max(0.9 * cruise[k], 0.5)
            for j in (k, k + 1):
                if 0 < j < n - 1:
                    corner[j] = max(0.85 * corner[j], v.min_speed, 0.3)
            corner = np.minimum(corner, np.concatenate([cruise, [np.inf]]))
            corner = np.minimum(corner, np.concatenate([[np.inf], cruise]))
    else:
        k = int(np.argmax(need - free))
        raise InputError(
            f"{source}: the leg from waypoint {k + 1} to {k + 2} of {length[k]:.4g} m is too short for a {v.name} to turn and "
            f"change speed (needs {length[k] - free[k] + need[k]:.4g} m)"
        )
    if (cruise < waypoints.speed[:-1] - 1e-9).any():
        k = int(np.argmax(waypoints.speed[:-1] - cruise))
        warnings += (
            f"{source}: the leg from waypoint {k + 1} is driven at {cruise[k]:.3g} m/s instead of {waypoints.speed[k]:.3g} m/s "
            "(too short to reach it)",
        )

    commands: list[Command] = [] if moving_ends else [Command(rest_s, name="rest at the start")]
    for k in range(n - 1):
        up = 1.875 * abs(cruise[k] - corner[k]) / accel
        down = 1.875 * abs(cruise[k] - corner[k + 1]) / accel
        steady = (free[k] - 0.5 * (cruise[k] + corner[k]) * up - 0.5 * (cruise[k] + corner[k + 1]) * down) / cruise[k]
        total = up + steady + down
        pieces = [(up, cruise[k]), (steady, cruise[k]), (down, corner[k + 1])]
        done = 0.0
        for seconds, speed in pieces:
            if seconds > 1e-9:
                # height follows one quintic over the whole leg, in pieces of equal climb rate per command
                share = climb[k] * seconds / total
                commands.append(Command(seconds, speed=speed, climb=share, name=f"leg {k + 1}"))
                done += seconds
        if k < n - 2 and duration[k] > 0:
            commands.append(Command(float(duration[k]), turn=float(angle[k])))
    if not moving_ends:
        commands.append(Command(rest_s, name="rest at the end"))
    p = profile(commands, heading=float(course[0]), speed=float(corner[0]))
    title = name or Path(source).stem
    path = path_of(p, v, llh[0], title)
    return Route(Flight(path, v.name, legs_of(commands)), tuple(warnings))


def _check_climb(source: str, v: Vehicle, climb: Array, length: Array, speed: ArrayLike) -> tuple[str, ...]:
    rate = np.abs(climb) / (length / np.asarray(speed))
    if rate.max() <= v.max_climb:
        slope = np.abs(climb) / length
        k = int(np.argmax(slope))
        if v.name != "car" or slope[k] <= STEEPEST_ROAD:
            return ()
        feet = ": heights in feet by the look of it (name the column 'height [ft]')"
        return (
            f"{source}: the leg from waypoint {k + 1} rises {100 * slope[k]:.0f} %, steeper than any road"
            f"{feet if slope[k] * _FOOT <= STEEPEST_ROAD else ''}",
        )
    k = int(np.argmax(rate))
    if rate.max() * _FOOT <= v.max_climb:
        raise InputError(
            f"{source}: the leg from waypoint {k + 1} climbs {climb[k]:.4g} m at {rate[k]:.3g} m/s, a {v.name} does {v.max_climb:g} m/s: "
            "heights in feet by the look of it (name the column 'height [ft]')"
        )
    raise InputError(
        f"{source}: the leg from waypoint {k + 1} climbs {climb[k]:.4g} m at {rate[k]:.3g} m/s, a {v.name} does {v.max_climb:g} m/s"
    )
