"""Routes of an aircraft that hovers: it stops at every waypoint, climbs and yaws on the spot, and flies with any heading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.emulate.motion import Leg, smoothstep, smoothstep_slope
from insemu.emulate.path import KNOT_S, SmoothPath
from insemu.emulate.table import KNOT_BYTES, check_size
from insemu.emulate.vehicle import Vehicle
from insemu.errors import InputError

Array = NDArray[np.float64]

#: Highest point of the slope of the smooth step: a change over T goes at most 1.875 times as fast as on average.
_PEAK = 1.875
#: Shorter than this, m, a leg has no course; shorter than this, s, is no turn on the spot and no change of speed.
_NO_COURSE, _SHORTEST = 1.0, 1.0


@dataclass(frozen=True)
class Stretch:
    """A straight stretch from rest to rest, or a wait.

    Parameters
    ----------
    duration : float
        s.
    way : (3,) array
        North, east, up, m.
    speed : float
        Along the way between its two ramps, m/s.
    yaw, turn : float
        Heading at its start and change of heading, rad.
    name : str
    """

    duration: float
    way: Array
    speed: float
    yaw: float
    turn: float
    name: str

    def rows(self, tau: Array, v: Vehicle) -> tuple[Array, Array]:
        """Velocity north, east, up (n, 3) in m/s and roll, pitch, heading (n, 3) in rad at times since its start."""
        length = float(np.linalg.norm(self.way))
        along, change = np.zeros((2, tau.size))
        if length > 0.0:
            ramp = self.duration - length / self.speed
            up, down = tau / ramp, (tau - self.duration + ramp) / ramp
            along = self.speed * (smoothstep(up) - smoothstep(down))
            change = self.speed / ramp * (smoothstep_slope(up) - smoothstep_slope(down))
        unit = self.way / length if length > 0.0 else np.zeros(3)
        flat = float(np.hypot(unit[0], unit[1]))
        course = float(np.arctan2(unit[1], unit[0]))
        yaw = self.yaw + self.turn * smoothstep(tau / self.duration)
        tilted = v.attitude(
            speed=along * flat,
            acceleration=change * flat,
            heading=yaw,
            turn_rate=np.zeros(tau.size),
            climb_rate=along * unit[2],
        )
        # the rotors tilt towards the course, whatever the nose points at
        tilt = tilted[:, 1]
        rpy = np.stack([-tilt * np.sin(course - yaw), tilt * np.cos(course - yaw), yaw], axis=1)
        return along[:, None] * unit, rpy


def _nearest_turn(start: float, end: float) -> float:
    return float((end - start + np.pi) % (2.0 * np.pi) - np.pi)


def _turn_s(turn: float, rate: float) -> float:
    return max(_PEAK * abs(turn) / rate, _SHORTEST)


def stretches(
    places: Array, speed: Array, heading: Array, hover: Array, v: Vehicle, comfort: float
) -> tuple[list[Stretch], list[str]]:
    """Stretches between waypoints.

    Parameters
    ----------
    places : (n, 3) array
        North, east, up, m.
    speed : (n,) array
        Of the leg that starts at each, m/s.
    heading : (n,) array
        rad; NaN: along the course of the next leg.
    hover : (n,) array
        Wait at each, s.
    v : Vehicle
    comfort : float
        Share of the vehicle's limits that is used.

    Returns
    -------
    list of Stretch, list of str
        In order; and which legs are flown slower than asked for.
    """
    acceleration, rate = comfort * v.max_acceleration, comfort * v.max_turn_rate
    out: list[Stretch] = []
    slower: list[str] = []
    none = np.zeros(3)
    ways = np.diff(places, axis=0)
    first = next((k for k, w in enumerate(ways) if np.hypot(w[0], w[1]) >= _NO_COURSE), None)
    yaw = heading[0] if np.isfinite(heading[0]) else 0.0 if first is None else float(np.arctan2(*ways[first][1::-1]))

    def wait(k: int) -> None:
        if hover[k] > 0.0:
            out.append(Stretch(float(hover[k]), none, 0.0, yaw, 0.0, f"hover {k + 1}"))

    wait(0)
    for k, way in enumerate(ways):
        has_course = np.hypot(way[0], way[1]) >= _NO_COURSE
        if np.isnan(heading[k]) and has_course:
            turn = _nearest_turn(yaw, float(np.arctan2(way[1], way[0])))
            if abs(turn) > 1e-6:
                out.append(Stretch(_turn_s(turn, rate), none, 0.0, yaw, turn, ""))
                yaw += turn
        turn = _nearest_turn(yaw, heading[k + 1]) if np.isfinite(heading[k + 1]) else 0.0
        length = float(np.linalg.norm(way))
        if length > 0.0:
            wanted = float(speed[k])
            steep = abs(way[2]) / length
            pace = min(wanted, v.max_climb / steep) if steep > 0.0 else wanted
            if pace < wanted:
                slower.append(
                    f"the leg from waypoint {k + 1} is flown at {pace:.3g} m/s, a {v.name} climbs at {v.max_climb:g} m/s"
                )
            pace = min(pace, float(np.sqrt(length * acceleration / _PEAK)), length / _SHORTEST)
            duration = length / pace + max(_PEAK * pace / acceleration, _SHORTEST)
            if abs(turn) > 1e-6 and duration < _turn_s(turn, rate):
                duration = _turn_s(turn, rate)
                root = np.sqrt(duration**2 - 4.0 * _PEAK / acceleration * length)
                ramp = max(0.5 * float(duration - root), _SHORTEST)
                pace = length / (duration - ramp)
            out.append(Stretch(duration, way, pace, yaw, turn, f"leg {k + 1}"))
        elif abs(turn) > 1e-6:
            out.append(Stretch(_turn_s(turn, rate), none, 0.0, yaw, turn, ""))
        yaw += turn
        wait(k + 1)
    return out, slower


def hovering_path(
    llh: Array, parts: list[Stretch], v: Vehicle, *, rest_s: float, name: str
) -> tuple[SmoothPath, tuple[Leg, ...]]:
    """The path of stretches with a rest at both ends.

    Parameters
    ----------
    llh : (n, 3) array
        Waypoints, the first of which is the origin: rad, rad, m.
    parts : list of Stretch
    v : Vehicle
    rest_s : float
        s.
    name : str
        Of the path.

    Raises
    ------
    InputError
        No motion at all, or more than the machine can hold.
    """
    if not parts:
        raise InputError(f"{name}: neither a leg nor a hover, expected some motion")
    last = parts[-1]
    rest = np.zeros(3)
    whole = [
        Stretch(rest_s, rest, 0.0, parts[0].yaw, 0.0, "rest at the start"),
        *parts,
        Stretch(rest_s, rest, 0.0, last.yaw + last.turn, 0.0, "rest at the end"),
    ]
    begins = np.concatenate([[0.0], np.cumsum([s.duration for s in whole])])
    check_size(begins[-1] / KNOT_S, KNOT_BYTES, f"a motion of {begins[-1]:.3g} s")
    t = np.linspace(0.0, begins[-1], max(int(np.ceil(begins[-1] / KNOT_S)), 8) + 1)
    velocity, rpy = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    which = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(whole) - 1)
    for k, stretch in enumerate(whole):
        rows = which == k
        if rows.any():
            velocity[rows], rpy[rows] = stretch.rows(t[rows] - begins[k], v)
    path = SmoothPath.from_velocity(t, velocity, rpy, llh[0], name)
    legs = (
        Leg(s.name, float(a), float(a + s.duration), s.turn == 0.0) for s, a in zip(whole, begins[:-1], strict=True)
    )
    return path, tuple(leg for leg in legs if leg.name)


def plane_of(llh: Array) -> Array:
    """Places in metres north, east and up of the first, on its map; (n, 3) rad, rad, m to (n, 3)."""
    rm, rn = earth.radii(llh[0, 0])
    north = (llh[:, 0] - llh[0, 0]) * float(rm + llh[0, 2])
    east = (np.unwrap(llh[:, 1]) - llh[0, 1]) * float((rn + llh[0, 2]) * np.cos(llh[0, 0]))
    return np.column_stack([north, east, llh[:, 2] - llh[0, 2]])
