"""Drives with the outage windows of Quinchia et al. (Sensors 2013): tables 9 and 10 (two urban drives) and table 6.

The paper prints the length of the two drives (17.3 and 15.05 minutes in Turin) and, per outage, duration, mean speed and
whether there is a turn; streets, stops and the times of the windows are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.flight import Flight, gusts, moving_share, origin_at
from insemu.emulate.motion import Command, legs_of, path_of, profile
from insemu.emulate.vehicle import VEHICLES

Array = NDArray[np.float64]

_DEG = np.pi / 180.0


@dataclass(frozen=True)
class Window:
    """A printed outage: number, start (ours), duration, mean speed in km/h, and whether the paper says that it holds
    a turn.
    """

    number: int
    start_s: float
    duration_s: float
    speed_kmh: float
    turn: str


#: Tables 9, 10 and 6; ``turn`` is the paper's remark.
WINDOWS: dict[str, tuple[Window, ...]] = {
    "urban_drive_1": (
        Window(1, 250.0, 30.0, 23.58, "turn of about 90 deg"),
        Window(2, 500.0, 60.0, 42.31, "straight"),
        Window(3, 790.0, 30.0, 47.60, ""),
    ),
    "urban_drive_2": (
        Window(4, 180.0, 30.0, 33.60, ""),
        Window(5, 360.0, 30.0, 52.25, "turn"),
        Window(6, 520.0, 30.0, 20.44, ""),
        Window(7, 740.0, 60.0, 112.42, "straight, slight curve at the end"),
    ),
    "urban_motorway": (
        Window(1, 200.0, 30.0, 25.16, ""),
        Window(2, 320.0, 30.0, 18.86, ""),
        Window(3, 440.0, 30.0, 42.53, ""),
        Window(4, 570.0, 30.0, 23.56, ""),
        Window(5, 700.0, 30.0, 39.32, ""),
        Window(6, 860.0, 60.0, 103.36, ""),
        Window(7, 1010.0, 60.0, 122.73, ""),
    ),
}


class _Route:
    """Commands with a clock."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.now = 0.0

    def add(self, *commands: Command) -> None:
        for c in commands:
            self.commands.append(c)
            self.now += c.duration_s

    def stop(self, wait: float) -> None:
        self.add(Command(9.0, speed=0.0), Command(wait))

    def go(self, speed: float, cruise: float, climb: float = 0.0) -> None:
        self.add(Command(4.0 + speed / 1.6, speed=speed), Command(cruise, climb=climb))

    def corner(self, degrees: float, slow: float = 5.0) -> None:
        self.add(Command(7.0, speed=slow), Command(8.0, turn=degrees * _DEG))

    def until(self, time: float, bend: float = 0.0, speed: float | None = None) -> None:
        rest = time - self.now
        if rest < 6.0:
            raise ValueError(f"the route is {self.now:g} s long where {time - 6.0:g} s were planned")
        self.add(Command(rest, turn=bend * _DEG, speed=speed))


def _drive(
    name: str, route: _Route, heading_deg: float, lat_deg: float, lon_deg: float, height: float, seed: int
) -> Flight:
    p = profile(route.commands, heading=heading_deg * _DEG)
    shake = moving_share(p.speed)
    # the road: 3 cm/s of heave and 0.3 deg of pitch and roll between 0.5 and 3 Hz; hardly any yaw
    heave = gusts(p.t, 0.03, (0.5, 3.0), shake, seed) * np.array([0.0, 0.0, 1.0])
    rock = gusts(p.t, 0.3 * _DEG, (0.5, 3.0), shake, seed + 1) * np.array([1.0, 1.0, 0.1])
    path = path_of(p, VEHICLES["car"], origin_at(lat_deg, lon_deg, height), name, gust_vel=heave, gust_rpy=rock)
    outages = tuple((w.start_s, w.duration_s) for w in WINDOWS[name])
    return Flight(path, "car", legs_of(route.commands), outages)


def urban_drive_1() -> Flight:
    """17.3 minutes of city: stops, corners, bends; outages 1 (30 s, turn of 90 deg), 2 (60 s, straight) and 3 (30
    s).
    """
    r = _Route()
    r.add(Command(30.0, name="rest at the start"))
    r.go(11.0, 25.0, 4.0)
    r.corner(90.0)
    r.go(13.0, 30.0, -3.0)
    r.stop(18.0)
    r.go(10.0, 20.0)
    r.corner(-85.0)
    r.go(9.0, 15.0)
    r.until(250.0, 15.0, 9.0)
    r.add(
        Command(10.0, speed=5.325),
        Command(10.0, turn=90.0 * _DEG, name="outage 1: the corner"),
        Command(10.0, speed=9.0),
    )
    r.go(12.0, 30.0, 6.0)
    r.stop(25.0)
    r.go(12.0, 35.0)
    r.corner(-90.0)
    r.go(11.0, 20.0, 2.0)
    r.until(500.0, -20.0, 11.0)
    r.add(
        Command(20.0, speed=12.5, name="outage 2"),
        Command(20.0, speed=11.0, climb=1.5, name="outage 2"),
        Command(20.0, speed=12.51, name="outage 2"),
    )
    r.go(13.0, 20.0)
    r.corner(80.0)
    r.go(12.0, 40.0, -5.0)
    r.stop(30.0)
    r.go(13.0, 30.0)
    r.until(790.0, 25.0, 13.2)
    r.add(
        Command(15.0, speed=13.9, turn=20.0 * _DEG, name="outage 3"),
        Command(15.0, speed=11.89, name="outage 3"),
    )
    r.go(12.0, 30.0, 3.0)
    r.corner(95.0)
    r.go(11.0, 35.0)
    r.stop(12.0)
    r.go(10.0, 20.0)
    r.until(990.0, -30.0)
    r.add(Command(18.0, speed=0.0), Command(30.0, name="rest at the end"))
    return _drive("urban_drive_1", r, 20.0, 45.07, 7.66, 240.0, 8101)


def urban_drive_2() -> Flight:
    """15.05 minutes of city and motorway: outages 4 (30 s), 5 (30 s, turn), 6 (30 s, slow) and 7 (60 s at 112 km/h)."""
    r = _Route()
    r.add(Command(30.0, name="rest at the start"))
    r.go(10.0, 20.0, 2.0)
    r.corner(-90.0)
    r.go(13.0, 25.0)
    r.corner(70.0)
    r.go(12.0, 15.0, -2.0)
    r.until(180.0, 10.0, 12.0)
    r.add(Command(15.0, speed=6.667, name="outage 4"), Command(15.0, speed=12.0, turn=-15.0 * _DEG, name="outage 4"))
    r.go(14.0, 30.0)
    r.stop(20.0)
    r.go(15.0, 25.0, 4.0)
    r.until(360.0, -15.0, 16.0)
    r.add(
        Command(10.0, speed=13.8),
        Command(10.0, turn=60.0 * _DEG, name="outage 5: the bend"),
        Command(10.0, speed=15.88),
    )
    r.go(12.0, 15.0)
    r.corner(-90.0)
    r.go(8.0, 20.0, -3.0)
    r.until(520.0, 10.0, 8.0)
    r.add(Command(15.0, speed=3.356, name="outage 6"), Command(15.0, speed=8.0, turn=25.0 * _DEG, name="outage 6"))
    r.go(13.0, 20.0)
    r.add(Command(20.0, turn=70.0 * _DEG, speed=16.0), Command(25.0, speed=28.0, climb=6.0))
    r.until(740.0, -25.0, 30.5)
    r.add(
        Command(40.0, speed=32.0, climb=-5.0, name="outage 7"),
        Command(20.0, speed=30.37, turn=12.0 * _DEG, name="outage 7: the curve"),
    )
    r.add(Command(25.0, speed=17.0), Command(15.0, turn=-80.0 * _DEG, speed=10.0))
    r.until(860.0, 15.0)
    r.add(Command(13.0, speed=0.0), Command(30.0, name="rest at the end"))
    return _drive("urban_drive_2", r, -60.0, 45.04, 7.63, 235.0, 8201)


def urban_motorway() -> Flight:
    """19.5 minutes of city, then motorway, with the seven outages of table 6: five of 30 s in town, two of 60 s."""
    r = _Route()
    r.add(Command(30.0, name="rest at the start"))
    r.go(11.0, 20.0, 3.0)
    r.corner(90.0)
    r.go(12.0, 25.0)
    r.stop(15.0)
    r.go(9.0, 15.0)
    r.until(200.0, 20.0, 7.5)
    r.add(
        Command(10.0, speed=6.733),
        Command(10.0, turn=80.0 * _DEG, name="outage 1: the corner"),
        Command(10.0, speed=7.5),
    )
    r.go(12.0, 30.0, 4.0)
    r.corner(-85.0)
    r.until(320.0, 0.0, 5.5)
    r.add(Command(15.0, speed=4.978, name="outage 2"), Command(15.0, speed=5.5, turn=30.0 * _DEG, name="outage 2"))
    r.go(12.0, 25.0)
    r.stop(12.0)
    r.until(440.0, 15.0, 12.0)
    r.add(Command(15.0, speed=11.628, turn=-20.0 * _DEG, name="outage 3"), Command(15.0, speed=12.0, name="outage 3"))
    r.go(13.0, 30.0, -5.0)
    r.corner(85.0)
    r.until(570.0, -15.0, 7.0)
    r.add(Command(15.0, speed=6.089, name="outage 4"), Command(15.0, speed=7.0, turn=-60.0 * _DEG, name="outage 4"))
    r.go(12.0, 30.0)
    r.stop(14.0)
    r.until(700.0, 10.0, 11.5)
    r.add(Command(15.0, speed=10.344, name="outage 5"), Command(15.0, speed=11.5, turn=45.0 * _DEG, name="outage 5"))
    r.go(16.0, 30.0, 3.0)
    r.add(Command(20.0, turn=70.0 * _DEG), Command(35.0, speed=28.0, climb=5.0))
    r.until(860.0, -10.0, 28.5)
    r.add(Command(30.0, speed=28.922, name="outage 6"), Command(30.0, speed=28.5, turn=10.0 * _DEG, name="outage 6"))
    r.add(Command(40.0, speed=31.0, climb=-6.0))
    r.until(1010.0, 12.0, 34.0)
    r.add(Command(30.0, speed=34.183, name="outage 7"), Command(30.0, speed=34.0, turn=-8.0 * _DEG, name="outage 7"))
    r.add(Command(30.0, speed=18.0), Command(15.0, turn=75.0 * _DEG, speed=10.0))
    r.until(1140.0, 0.0)
    r.add(Command(13.0, speed=0.0), Command(20.0, name="rest at the end"))
    return _drive("urban_motorway", r, 35.0, 45.06, 7.65, 238.0, 8301)


def outage_windows(flights: Sequence[Flight]) -> list[dict[str, float | str]]:
    """Duration, mean speed and turn of every outage window of the drives, together with the printed ones.

    Returns
    -------
    list of dict
        ``drive, outage, start_s, duration_s, speed_kmh, turn_deg`` and ``printed_duration_s, printed_speed_kmh,
        printed_turn``; the turn is the largest change of course within the window.
    """
    rows: list[dict[str, float | str]] = []
    for flight in flights:
        for w, (start, duration) in zip(WINDOWS[flight.name], flight.outages, strict=True):
            t = np.linspace(start, start + duration, int(duration * 100) + 1)
            v = flight.path.vel_ned(t)
            course = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
            speed = np.hypot(v[:, 0], v[:, 1])
            rows.append(
                {
                    "drive": flight.name,
                    "outage": float(w.number),
                    "start_s": start,
                    "duration_s": duration,
                    "speed_kmh": float(3.6 * np.trapezoid(speed, t) / duration),
                    "turn_deg": float(np.ptp(course) / _DEG),
                    "printed_duration_s": w.duration_s,
                    "printed_speed_kmh": w.speed_kmh,
                    "printed_turn": w.turn,
                }
            )
    return rows
