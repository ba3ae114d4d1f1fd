"""Random tracks of five vehicles for the blind trial."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from insemu.emulate import VEHICLES, Command, SmoothPath, gusts, moving_share, origin_at, path_of, profile

Array = NDArray[np.float64]
_DEG = math.pi / 180.0
#: Knots of a track, s.
FINE_KNOT_S = 0.0125
TRACKS = ("car", "aerobatic", "uav", "helicopter", "aeroplane")


def random_track(kind: str, seconds: float, rng: np.random.Generator) -> SmoothPath:
    """A random path of a vehicle, a little longer than ``seconds``.

    Parameters
    ----------
    kind : str
        One of :data:`TRACKS`.
    seconds : float
        Duration, s.
    rng : Generator
    """
    origin = origin_at(
        float(rng.uniform(-55.0, 62.0)), float(rng.uniform(-180.0, 180.0)), float(rng.uniform(0.0, 900.0))
    )
    heading = float(rng.uniform(-math.pi, math.pi))
    if kind == "aerobatic":
        return _aerobatic(seconds, heading, origin, rng)
    commands, vehicle, shake_v, shake_a, band = _COMMANDS[kind](seconds, rng)
    while sum(c.duration_s for c in commands) < seconds + 2.0:
        commands.append(Command(20.0))
    p = profile(commands, heading=heading, speed=0.0)
    calm = path_of(p, VEHICLES[vehicle], origin, kind)
    # a spline repeats what is fast about the frequency of its knots: fast motion gets closer knots
    t = np.linspace(calm.start, calm.end, int((calm.end - calm.start) / FINE_KNOT_S) + 1)
    velocity = calm.position(t, 1)
    on = moving_share(np.hypot(velocity[:, 0], velocity[:, 1]))
    seeds = rng.integers(2**31, size=2)
    wind = gusts(t, shake_v, band, on, int(seeds[0]))
    rock = gusts(t, shake_a * _DEG, band, on, int(seeds[1])) * np.array([1.0, 0.9, 0.3])
    if kind == "car":
        wind *= np.array([0.0, 0.0, 1.0])
    return SmoothPath.from_velocity(t, velocity + wind, calm.attitude(t) + rock, origin, kind)


_Commands = tuple[list[Command], str, float, float, tuple[float, float]]


def _car(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(float(rng.uniform(5.0, 30.0)))]
    while sum(c.duration_s for c in out) < seconds:
        cruise = float(rng.uniform(8.0, 25.0))
        out += [
            Command(4.0 + cruise / 1.8, speed=cruise),
            Command(float(rng.uniform(10.0, 40.0)), climb=float(rng.uniform(-6.0, 6.0))),
        ]
        if rng.random() < 0.3:
            out += [Command(9.0, speed=0.0), Command(float(rng.uniform(5.0, 30.0)))]
        else:
            turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(40.0, 120.0)) * _DEG
            out += [Command(7.0, speed=float(rng.uniform(4.0, 7.0))), Command(9.0, turn=turn)]
    return out, "car", 0.03, 0.3, (0.5, 3.0)


def _uav(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(10.0), Command(15.0, speed=18.0), Command(30.0, speed=22.0, climb=80.0)]
    while sum(c.duration_s for c in out) < seconds:
        side = float(rng.choice([-1.0, 1.0]))
        out += [
            Command(
                float(rng.uniform(15.0, 40.0)),
                turn=side * float(rng.uniform(90.0, 360.0)) * _DEG,
                climb=float(rng.uniform(-15.0, 15.0)),
            ),
            Command(float(rng.uniform(10.0, 30.0)), speed=float(rng.uniform(17.0, 25.0))),
        ]
    return out, "fixed_wing", 0.1, 1.0, (0.1, 2.0)


def _helicopter(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(12.0), Command(30.0, speed=22.0, climb=100.0)]
    side = 1.0
    while sum(c.duration_s for c in out) < seconds:
        out += [
            Command(float(rng.uniform(40.0, 90.0)), speed=float(rng.uniform(18.0, 28.0)), speed_in_s=15.0),
            Command(30.0, turn=side * 180.0 * _DEG, climb=float(rng.uniform(-40.0, 40.0))),
        ]
        side = -side
    return out, "helicopter", 0.1, 0.3, (0.1, 1.0)


def _aeroplane(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(15.0), Command(25.0, speed=50.0), Command(60.0, speed=62.0, climb=300.0)]
    side = 1.0
    while sum(c.duration_s for c in out) < seconds:
        out += [
            Command(float(rng.uniform(50.0, 120.0)), speed=float(rng.uniform(55.0, 70.0)), speed_in_s=20.0),
            Command(60.0, turn=side * float(rng.uniform(90.0, 180.0)) * _DEG, climb=float(rng.uniform(-60.0, 60.0))),
        ]
        side = -side if rng.random() < 0.7 else side
    return out, "fixed_wing", 0.3, 0.5, (0.05, 0.8)


_COMMANDS: dict[str, Callable[[float, np.random.Generator], _Commands]] = {
    "car": _car,
    "uav": _uav,
    "helicopter": _helicopter,
    "aeroplane": _aeroplane,
}


def _aerobatic(seconds: float, heading: float, origin: Array, rng: np.random.Generator) -> SmoothPath:
    """Loops in the plane with slow rolls (some all the way round) and pitching: every axis of both sensors is excited."""
    end = seconds + 5.0
    t = np.linspace(0.0, end, int(end / FINE_KNOT_S) + 1)
    up = np.clip((t - 15.0) / 20.0, 0.0, 1.0)
    on = up**3 * (10.0 - 15.0 * up + 6.0 * up**2)

    def wave(periods: tuple[float, float], count: int = 3) -> Array:
        total = np.zeros_like(t)
        for _ in range(count):
            total += np.sin(2.0 * math.pi * (t / rng.uniform(*periods) + rng.random()))
        return np.asarray(total / count)

    course = heading + on * (
        t * rng.choice([-1.0, 1.0]) * 2.0 * math.pi / rng.uniform(25.0, 45.0) * wave((60.0, 200.0), 1)
    )
    speed = on * (22.0 + 4.0 * wave((20.0, 60.0)))
    climb = on * 3.0 * wave((20.0, 50.0))
    vel = np.stack([speed * np.cos(course), speed * np.sin(course), climb], axis=1)
    rolls = np.zeros_like(t)
    for start in np.arange(60.0, seconds - 20.0, float(rng.uniform(50.0, 90.0))):
        u = np.clip((t - start) / 6.0, 0.0, 1.0)
        rolls += 2.0 * math.pi * u**3 * (10.0 - 15.0 * u + 6.0 * u**2) * rng.choice([-1.0, 1.0])
    rpy = np.stack(
        [
            on * 45.0 * _DEG * wave((8.0, 30.0)) + rolls,
            on * 30.0 * _DEG * wave((8.0, 40.0)),
            course + on * 10.0 * _DEG * wave((9.0, 30.0)),
        ],
        axis=1,
    )
    return SmoothPath.from_velocity(t, vel, rpy, origin, "aerobatic")
