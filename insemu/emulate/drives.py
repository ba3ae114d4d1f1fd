"""Drives with the outage windows of Quinchia et al. (Sensors 2013), from the steps in ``drives.yaml``."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from insemu import yamlfile
from insemu.emulate.flight import Flight, gusts, moving_share, origin_at
from insemu.emulate.motion import Command, legs_of, path_of, profile
from insemu.emulate.vehicle import VEHICLES

_DEG = np.pi / 180.0


@cache
def drives() -> dict[str, Any]:
    """What the file says of every drive."""
    found: dict[str, Any] = yamlfile.read(Path(__file__).with_name("drives.yaml")).data
    return found


class _Route:
    """Commands with a clock."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.now = 0.0

    def add(self, *commands: Command) -> None:
        for c in commands:
            self.commands.append(c)
            self.now += c.duration_s

    def command(self, *, turn: float = 0.0, **given: Any) -> None:
        self.add(Command(turn=turn * _DEG, **given))

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


def drive(name: str) -> Flight:
    """A drive by its name in the file."""
    given, route = drives()[name], _Route()
    for step in given["steps"]:
        if isinstance(step, list):
            getattr(route, step[0])(*step[1:])
        else:
            route.command(**step)
    start, seed = given["start"], given["start"]["seed"]
    p = profile(route.commands, heading=start["heading"] * _DEG)
    shake = moving_share(p.speed)
    # the road: 3 cm/s of heave and 0.3 deg of pitch and roll between 0.5 and 3 Hz; hardly any yaw
    heave = gusts(p.t, 0.03, (0.5, 3.0), shake, seed) * np.array([0.0, 0.0, 1.0])
    rock = gusts(p.t, 0.3 * _DEG, (0.5, 3.0), shake, seed + 1) * np.array([1.0, 1.0, 0.1])
    origin = origin_at(start["latitude"], start["longitude"], start["height"])
    path = path_of(p, VEHICLES["car"], origin, name, gust_vel=heave, gust_rpy=rock)
    outages = tuple((o["start_s"], o["duration_s"]) for o in given["outages"])
    return Flight(path, "car", legs_of(route.commands), outages)
