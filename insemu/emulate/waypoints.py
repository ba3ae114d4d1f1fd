"""Routes from waypoints with speeds, under the limits of a vehicle.

Legs are straight, corners are rounded by turns whose lateral acceleration and turn rate stay within the vehicle's,
speeds are reached within its acceleration. A negative speed is one in reverse gear. An aircraft that hovers may stop, climb and yaw
on the spot, turn back and fly with any heading. Read from CSV (``lat, lon[, height][, speed][, heading][, hover]`` with units in the
header) or GeoJSON (longitude first).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, units
from insemu.emulate import hover
from insemu.emulate.flight import Flight
from insemu.emulate.motion import Command, legs_of, path_of, profile, steady
from insemu.emulate.table import read_columns, text_of
from insemu.emulate.vehicle import STEEPEST_ROAD, Vehicle, odd_places, vehicle
from insemu.errors import InputError
from insemu.formats import open_files

Array = NDArray[np.float64]

_FOOT = 0.3048
#: Share of the vehicle's limits that a route uses.
_COMFORT = 0.5
#: Longest leg in s and sharpest turn in rad that are taken for meant.
LONGEST_LEG_S, SHARPEST_TURN = 6 * 3600.0, np.deg2rad(150)
#: Bend in rad where a vehicle stops or changes gear that is rounding, not a turn on the spot.
_IN_LINE = np.deg2rad(3.0)


@dataclass(frozen=True)
class Waypoints:
    """Places to pass, in order.

    Parameters
    ----------
    llh : (n, 3) array
        Latitude rad, longitude rad, height m.
    speed : (n,) array
        Speed of the leg that starts at each waypoint, m/s (the last is not used); negative in reverse gear.
    source : str
        Appears in messages.
    heading : (n,) array, optional
        Of an aircraft that hovers, rad; NaN: along the course.
    hover : (n,) array, optional
        Wait at each waypoint, s: of an aircraft that hovers, or of what goes on the ground.
    """

    llh: Array
    speed: Array
    source: str = "waypoints"
    heading: Array | None = None
    hover: Array | None = None

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
        if self.hover is not None and not (np.asarray(self.hover) >= 0.0).all():
            raise InputError(f"{self.source}: a hover is {np.min(self.hover):.4g} s, expected zero or more")


#: Points of a route nearer than this to the one before, m, are left out: a planner draws bends with many, a recorder rests.
ROUTE_LEG = 5.0
#: Heights of a route are means over so many metres to either side: those of a receiver scatter by metres, which no road does.
ROUTE_HEIGHTS = 150.0
_NAMES = {
    "lat": "lat", "latitude": "lat", "lon": "lon", "lng": "lon", "long": "lon", "longitude": "lon",
    "height": "height", "alt": "height", "altitude": "height", "h": "height", "ele": "height", "elevation": "height",
    "speed": "speed", "v": "speed", "velocity": "speed",
    "heading": "heading", "yaw": "heading", "hover": "hover", "hold": "hover", "wait": "hover",
}  # fmt: skip
_UNIT = {"lat": "rad", "lon": "rad", "height": "m", "speed": "m/s", "heading": "rad", "hover": "s"}
_ASSUMED = {"lat": "deg", "lon": "deg", "height": "m", "speed": "m/s", "heading": "deg", "hover": "s"}


def read_waypoints(path: str | Path, speed: float | None = None) -> Waypoints:
    """Read waypoints from CSV or GeoJSON.

    Parameters
    ----------
    path : path
        ``.csv`` with a header such as ``lat, lon, height [m], speed [km/h]``; ``.geojson`` or ``.json`` with a
        LineString or with Points, speed in their property ``speed`` (m/s); or the route of a planner, ``.gpx`` or ``.kml``.
    speed : float, optional
        Speed of all legs in m/s where the file has none.

    Raises
    ------
    InputError
        Anything that cannot be read, with file and line.
    """
    path = Path(path)
    if path.suffix.lower() in (".gpx", ".kml"):
        return _route_of_a_planner(path, speed)
    text = text_of(path, "waypoint")
    if path.suffix.lower() in (".geojson", ".json"):
        return _geojson(text, str(path), speed)
    return _csv(text, str(path), speed)


def _route_of_a_planner(path: Path, speed: float | None) -> Waypoints:
    """Positions whose times, if they have any, do not count."""
    if speed is None:
        raise InputError("a route has no speeds, and no speed is given for all legs", where=str(path))
    found = open_files(path, maps=("rate=1 Hz", "", ""))
    if found.gnss is None:
        raise InputError("holds no positions", where=str(path))
    llh = found.gnss.llh
    kept = [0]
    for k in range(1, len(llh)):
        if np.hypot(*earth.position_difference(llh[k], llh[kept[-1]])[:2]) >= ROUTE_LEG:
            kept.append(k)
    points = llh[kept].copy()
    way = np.cumsum(np.r_[0.0, np.hypot(*earth.position_difference(points[1:], points[:-1])[:, :2].T)])
    points[:, 2] = [points[np.abs(way - s) <= ROUTE_HEIGHTS, 2].mean() for s in way]
    return Waypoints(points, np.full(len(kept), speed), str(path), None, None)


def _csv(text: str, source: str, speed: float | None) -> Waypoints:
    values, _ = read_columns(text, source, _NAMES, _UNIT, _ASSUMED, ("lat", "lon"), ("heading",))
    n = values["lat"].size
    if "speed" not in values and speed is None:
        raise InputError("no column 'speed' and no speed given for all legs", where=source)
    llh = np.column_stack([values["lat"], values["lon"], values.get("height", np.zeros(n))])
    speeds = values["speed"] if "speed" in values else np.full(n, speed)
    return Waypoints(llh, speeds, source, values.get("heading"), values.get("hover"))


def _geojson(text: str, source: str, speed: float | None) -> Waypoints:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"not JSON: {error.msg}", where=f"{source}:{error.lineno}") from None
    except (RecursionError, ValueError):  # deep nesting; integers too long to read
        raise InputError(
            "not JSON that can be read: nested too deeply, or with endless numbers", where=source
        ) from None
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
        numbers = isinstance(place, list) and all(type(x) in (int, float) and abs(x) < 1e12 for x in place)
        if not numbers or len(place) not in (2, 3):
            raise InputError(f"point {k + 1} is {place!r:.60}, expected [longitude, latitude(, height)]", where=source)
        rows.append([np.deg2rad(place[1]), np.deg2rad(place[0]), place[2] if len(place) == 3 else 0.0])
        value = own if own is not None else speed
        if value is None:
            raise InputError(f"point {k + 1} has no property 'speed' and no speed was given for all legs", where=source)
        try:
            if not isinstance(value, str | int | float):
                raise InputError(f"found {value!r:.40}, expected a number or a quantity")
            speeds_out.append(units.parse(value if isinstance(value, str) else float(value), "m/s"))
        except (InputError, OverflowError) as error:
            error = error if isinstance(error, InputError) else InputError("expected a finite number")
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
    heading = size / (duration - ramp) * steady(t, duration, ramp)
    along = speed * np.trapezoid(np.cos(heading), t)
    return duration, float(along / (1.0 + np.cos(size)))


@dataclass
class _Legs:
    """Straight legs between n waypoints and the speeds along them.

    Parameters
    ----------
    length, course, climb : (n - 1,) arrays
        m, rad, m.
    angle : (n - 2,) array
        Change of course at the waypoints between, rad.
    cruise : (n - 1,) array
        Speeds of the legs, m/s.
    corner : (n,) array
        Speeds at the waypoints, m/s.
    duration : (n - 2,) array
        Of the turns, s.
    free, need : (n - 1,) arrays
        Length of a leg between its turns, and what its changes of speed take of it, m.
    back : (n - 1,) array of bool
        Legs in reverse gear; ``course`` is the heading, towards the tail there.
    wait : (n,) array
        At the waypoints, s.
    """

    length: Array
    course: Array
    climb: Array
    angle: Array
    cruise: Array
    corner: Array
    duration: Array
    free: Array
    need: Array
    back: NDArray[np.bool_]
    wait: Array

    @classmethod
    def of(cls, waypoints: Waypoints, v: Vehicle) -> _Legs:
        """Legs of waypoints that a vehicle can follow; ``InputError`` where it cannot."""
        source, llh, cruise = waypoints.source, waypoints.llh, np.abs(waypoints.speed[:-1])
        back = waypoints.speed[:-1] < 0.0
        for k, s in enumerate(waypoints.speed[:-1]):
            _check_speed(source, k, s, v)
        rm, rn = earth.radii(llh[0, 0])
        scale = np.array([float(rm + llh[0, 2]), float((rn + llh[0, 2]) * np.cos(llh[0, 0]))])
        plane = np.column_stack([llh[:, 0] - llh[0, 0], np.unwrap(llh[:, 1]) - llh[0, 1]]) * scale
        leg = np.diff(plane, axis=0)
        length = np.hypot(leg[:, 0], leg[:, 1])
        if (length < 1.0).any():
            k = int(np.argmin(length))
            raise InputError(
                f"{source}: waypoints {k + 1} and {k + 2} are {length[k]:.3g} m apart, expected at least 1 m"
            )
        far = length / cruise
        if far.max() > LONGEST_LEG_S:
            k = int(np.argmax(far))
            raise InputError(
                f"{source}: the leg from waypoint {k + 1} is {length[k] / 1000:.4g} km, {far[k] / 3600:.3g} h at its speed; "
                "are latitude and longitude swapped?"
            )
        course = np.unwrap(np.arctan2(leg[:, 1], leg[:, 0]) + np.where(back, np.pi, 0.0))
        angle = np.diff(course)
        wait = np.zeros(len(llh)) if waypoints.hover is None else np.asarray(waypoints.hover, dtype=float)
        stands = np.concatenate([[True], (back[1:] != back[:-1]) | (wait[1:-1] > 0.0), [True]])
        bent = stands[1:-1] & (np.abs(angle) > _IN_LINE)
        if bent.any():
            k = int(np.argmax(bent))
            raise InputError(
                f"{source}: a {v.name} stops at waypoint {k + 2}, where its heading would change by {np.rad2deg(angle[k]):.0f} deg on the spot; "
                "stop in line with the next leg"
            )
        if (np.abs(angle) > SHARPEST_TURN).any():
            k = int(np.argmax(np.abs(angle)))
            raise InputError(
                f"{source}: waypoint {k + 2} turns by {np.rad2deg(angle[k]):.0f} deg, expected at most 150 deg; add a waypoint next to it"
            )
        ends = cruise[[0, -1]] if v.min_speed > 0 else np.zeros(2)
        corner = np.concatenate([ends[:1], np.where(stands[1:-1], 0.0, np.minimum(cruise[:-1], cruise[1:])), ends[1:]])
        angle = np.where(stands[1:-1], 0.0, angle)
        none = np.zeros(0)
        return cls(length, course, np.diff(llh[:, 2]), angle, cruise, corner, none, none, none, back, wait)

    def lay_out(self, v: Vehicle) -> None:
        """Turns at the present speeds, and what they leave of every leg."""
        turns = [
            _turn(a, s, v) if abs(a) > 1e-3 else (0.0, 0.0) for a, s in zip(self.angle, self.corner[1:-1], strict=True)
        ]
        self.duration = np.array([x for x, _ in turns])
        away = np.concatenate([[0.0], [d for _, d in turns], [0.0]])
        self.free = self.length - away[:-1] - away[1:]
        # two smooth changes of speed per leg
        self.need = np.zeros(self.length.size)
        for end in (self.corner[:-1], self.corner[1:]):
            self.need += 0.5 * (self.cruise + end) * _change_s(self.cruise - end, v)

    def slow_down(self, v: Vehicle, source: str) -> None:
        """Lower the speeds until every leg has room for its turns and changes of speed; ``InputError`` where none has."""
        inner = range(1, self.corner.size - 1)
        for _ in range(60):
            self.lay_out(v)
            short = self.free < self.need
            if not short.any():
                return
            for k in map(int, np.nonzero(short)[0]):
                if self.free[k] > 0.0 and v.min_speed == 0.0:
                    self.cruise[k] = max(0.9 * self.cruise[k], 0.5)
                for j in (k, k + 1):
                    if j in inner and self.corner[j] > 0.0:
                        self.corner[j] = max(0.85 * self.corner[j], v.min_speed, 0.3)
                self.corner[:-1] = np.minimum(self.corner[:-1], self.cruise)
                self.corner[1:] = np.minimum(self.corner[1:], self.cruise)
        k = int(np.argmax(self.need - self.free))
        raise InputError(
            f"{source}: the leg from waypoint {k + 1} to {k + 2} of {self.length[k]:.4g} m is too short for a {v.name} to turn and "
            f"change speed (needs {self.length[k] - self.free[k] + self.need[k]:.4g} m)"
        )

    def commands(self, v: Vehicle) -> list[Command]:
        """Legs and turns as motion commands."""
        out: list[Command] = []
        for k, cruise in enumerate(self.cruise):
            if self.wait[k] > 0.0:
                out.append(Command(float(self.wait[k]), name=f"wait {k + 1}"))
            start, end = self.corner[k], self.corner[k + 1]
            up, down = _change_s(cruise - start, v), _change_s(cruise - end, v)
            at_speed = (self.free[k] - 0.5 * (cruise + start) * up - 0.5 * (cruise + end) * down) / cruise
            total = up + at_speed + down
            for seconds, speed in ((up, cruise), (at_speed, cruise), (down, end)):
                if seconds > 1e-9:  # the climb of a leg is shared by time
                    share = self.climb[k] * seconds / total
                    out.append(Command(seconds, speed=speed, climb=share, name=f"leg {k + 1}", back=bool(self.back[k])))
            if k < self.duration.size and self.duration[k] > 0:
                out.append(Command(float(self.duration[k]), turn=float(self.angle[k])))
        return out


def _change_s(change: Any, v: Vehicle) -> Any:
    """Duration of a change of speed, s; a quintic's peak acceleration is 1.875 times its mean."""
    return 1.875 * abs(change) / (_COMFORT * v.max_acceleration)


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

    Notes
    -----
    A multirotor or helicopter whose waypoints give a heading or a hover, lie above each other, or ask for a turn of more than 150 deg stops at
    every waypoint.

    Raises
    ------
    InputError
        Speeds or climbs beyond the vehicle, legs too short for the turns, turns of more than 150 deg, points that
        repeat.
    """
    v = vehicle(vehicle_name)
    source, llh = waypoints.source, waypoints.llh
    if _stops(waypoints, v):
        return _stop_and_go(waypoints, v, rest_s, name or Path(source).stem)
    legs = _Legs.of(waypoints, v)
    warnings = odd_places(source, llh, v) + _check_climb(
        source, v, legs.climb, legs.length, np.abs(waypoints.speed[:-1])
    )
    legs.slow_down(v, source)
    lost = np.abs(waypoints.speed[:-1]) - legs.cruise
    if (lost > 1e-9).any():
        k = int(np.argmax(lost))
        warnings += (
            f"{source}: the leg from waypoint {k + 1} is driven at {legs.cruise[k]:.3g} m/s instead of {waypoints.speed[k]:.3g} m/s "
            "(too short to reach it)",
        )
    commands = legs.commands(v)
    if v.min_speed == 0.0:
        commands = [Command(rest_s, name="rest at the start"), *commands, Command(rest_s, name="rest at the end")]
    p = profile(commands, heading=float(legs.course[0]), speed=float(legs.corner[0]))
    path = path_of(p, v, llh[0], name or Path(source).stem)
    return Route(Flight(path, v.name, legs_of(commands)), tuple(warnings))


def _check_speed(source: str, k: int, speed: float, v: Vehicle) -> None:
    least = max(v.min_speed, 0.1)
    if not (least <= speed <= v.max_speed or least <= -speed <= v.back):
        reverse = f", in reverse gear -{least:g} to -{v.back:g}" if v.back else ""
        raise InputError(
            f"{source}: waypoint {k + 1} asks for {speed:.4g} m/s, a {v.name} does {least:g} to {v.max_speed:g} m/s{reverse}"
        )


def _stops(waypoints: Waypoints, v: Vehicle) -> bool:
    """Whether an aircraft that hovers must stop at the waypoints."""
    asked = waypoints.heading is not None or waypoints.hover is not None
    if not v.hovers:
        if waypoints.heading is not None or (waypoints.hover is not None and v.lean is None):
            raise InputError(
                f"{waypoints.source}: heading and hover are for a multirotor or helicopter, found a {v.name}"
            )
        return False
    leg = np.diff(hover.plane_of(waypoints.llh)[:, :2], axis=0)
    course = np.arctan2(leg[:, 1], leg[:, 0])
    turns = np.abs((np.diff(course) + np.pi) % (2.0 * np.pi) - np.pi)
    return asked or bool((np.hypot(leg[:, 0], leg[:, 1]) < 1.0).any() or (turns > SHARPEST_TURN).any())


def _stop_and_go(waypoints: Waypoints, v: Vehicle, rest_s: float, name: str) -> Route:
    """The route of an aircraft that stops at every waypoint."""
    source, llh = waypoints.source, waypoints.llh
    for k, s in enumerate(waypoints.speed[:-1]):
        _check_speed(source, k, s, v)
    heading = np.full(len(llh), np.nan) if waypoints.heading is None else np.asarray(waypoints.heading, dtype=float)
    wait = np.zeros(len(llh)) if waypoints.hover is None else np.asarray(waypoints.hover, dtype=float)
    parts, slower = hover.stretches(hover.plane_of(llh), waypoints.speed, heading, wait, v, _COMFORT)
    path, legs = hover.hovering_path(llh, parts, v, rest_s=rest_s, name=name)
    warnings = (*odd_places(source, llh, v), *(f"{source}: {text}" for text in slower))
    return Route(Flight(path, v.name, legs), warnings)


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
