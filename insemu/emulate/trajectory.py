"""Built-in flights and drives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.drives import drive, drives
from insemu.emulate.flight import Flight, gusts, moving_share, origin_at
from insemu.emulate.motion import Command, Leg, Profile, legs_of, path_of, profile, smoothstep, smoothstep_integral
from insemu.emulate.path import KNOT_S, SmoothPath
from insemu.emulate.vehicle import VEHICLES
from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

__all__ = ["TRAJECTORIES", "Flight", "built_in"]


def helicopter_mapping() -> Flight:
    """Twenty minutes of helicopter laser mapping: hover, transit, eight parallel lines of 90 s at 25 m/s, return,
    hover.

    The lines run from 165 + 120 k to 255 + 120 k s (k = 0..7) with coordinated half turns of 30 s between them, four
    of which change the height by 30 to 60 m; line 2 climbs and descends. Outages of 60 s at 7, 11 and 15 minutes lie
    on lines 3, 5 and 7. Gusts of 0.1 m/s and 0.3 deg (0.1 to 1 Hz) shake it while it moves.
    """
    deg = np.pi / 180
    commands = [
        Command(20.0, name="hover at the start"),
        Command(35.0, speed=20.0, climb=120.0, name="take-off"),
        Command(70.0, speed=25.0, climb=60.0, name="transit", speed_in_s=20.0),
        Command(20.0, turn=-60.0 * deg),
        Command(20.0, name="run-in"),
    ]
    climbs = [40.0, 0.0, -30.0, 60.0, 0.0, -40.0, 30.0]
    for k in range(8):
        if k == 1:
            commands += [Command(45.0, climb=20.0, name="line 2a"), Command(45.0, climb=-20.0, name="line 2b")]
        else:
            commands.append(Command(90.0, name=f"line {k + 1}"))
        if k < 7:
            commands.append(Command(30.0, turn=(180.0 if k % 2 == 0 else -180.0) * deg, climb=climbs[k]))
    commands += [
        Command(20.0, turn=110.0 * deg),
        Command(25.0, climb=-150.0, name="descent"),
        Command(35.0, speed=0.0, climb=-90.0, name="approach"),
        Command(25.0, name="hover at the end"),
    ]
    p = profile(commands, heading=60.0 * deg)
    shake = moving_share(p.speed)
    path = path_of(
        p,
        VEHICLES["helicopter"],
        origin_at(46.52, 6.57, 450.0),
        "helicopter_mapping",
        gust_vel=gusts(p.t, 0.1, (0.1, 1.0), shake, 7001),
        gust_rpy=gusts(p.t, 0.3 * deg, (0.1, 1.0), shake, 7002),
    )
    return Flight(path, "helicopter", legs_of(commands), ((420.0, 60.0), (660.0, 60.0), (900.0, 60.0)))


def turbulent_uav(strength: float = 1.0) -> Flight:
    """Twenty minutes of a small fixed wing in turbulence: circles and eights with up to 33 deg of bank at 18 to 24 m/s.

    Gusts between 0.1 and 2 Hz of 0.1 m/s and 1.3, 1.0 and 0.5 deg in roll, pitch and heading (rates to 27 deg/s): a
    test of coning and sculling. The roll rate of 6.6 deg/s rms is that of light turbulence: Dryden gusts of 0.77 m/s (15 knots of wind
    at 6 m, MIL-F-8785C) roll a span of 2 m at 100 m by 1.9 sigma_w / sqrt(L_w b), 5.9 deg/s rms. Two is moderate.

    Parameters
    ----------
    strength : float
        Scales the gusts.
    """
    deg = np.pi / 180
    commands = [
        Command(20.0, name="rest on the runway"),
        Command(18.0, speed=18.0, name="take-off run"),
        Command(60.0, speed=22.0, climb=120.0, name="climb"),
    ]
    for k in range(7):
        side = 1.0 if k % 2 == 0 else -1.0
        commands += [
            Command(40.0, turn=side * 360.0 * deg, climb=15.0 * side, speed=20.0 + k % 3),
            Command(35.0, name=f"leg {2 * k + 1}"),
            Command(24.0, turn=-side * 200.0 * deg),
            Command(40.0, climb=-10.0 * side, name=f"leg {2 * k + 2}"),
        ]
    commands += [
        Command(85.0, speed=18.0, climb=-130.0, name="descent and landing"),
        Command(20.0, speed=0.0, name="landing run"),
        Command(24.0, name="rest at the end"),
    ]
    p = profile(commands, heading=-60.0 * deg)
    shake = moving_share(p.speed)
    path = path_of(
        p,
        VEHICLES["fixed_wing"],
        origin_at(46.5, -71.3, 80.0),
        "turbulent_uav",
        gust_vel=gusts(p.t, 0.1 * strength, (0.1, 2.0), shake, 7101),
        gust_rpy=gusts(p.t, 1.3 * strength * deg, (0.1, 2.0), shake, 7102) * np.array([1.0, 0.8, 0.4]),
    )
    return Flight(path, "fixed_wing", legs_of(commands))


def lemniscate() -> Flight:
    """Twenty minutes of a multirotor on an eight of 200 m by 100 m, a round in 80 s, climbing and sinking by 8 m."""
    duration, period, a = 1200.0, 80.0, 100.0
    t = np.linspace(0.0, duration, int(duration / KNOT_S) + 1)
    # rest for 20 s, then up to speed within 20 s, and the reverse at the end
    up, down = (t - 20.0) / 20.0, (t - (duration - 40.0)) / 20.0
    omega = 2 * np.pi / period
    phase = omega * 20.0 * (smoothstep_integral(np.maximum(up, 0.0)) - smoothstep_integral(np.maximum(down, 0.0)))
    rate = omega * (smoothstep(up) - smoothstep(down))
    s, c = np.sin(phase), np.cos(phase)
    dn, de = a * np.cos(2 * phase) * 1.0, a * c  # of north = a sin cos, east = a sin
    ddn, dde = -2 * a * np.sin(2 * phase), -a * s
    vel = np.stack([dn * rate, de * rate, 8.0 * 0.5 * np.sin(0.5 * phase) * rate], axis=1)
    bend = (dn * dde - de * ddn) / (dn**2 + de**2)  # derivative of the course with phase
    speed = np.hypot(vel[:, 0], vel[:, 1])
    p = Profile(
        t=t,
        speed=speed,
        acceleration=np.gradient(speed, t),
        heading=np.unwrap(np.arctan2(de, dn)),
        turn_rate=bend * rate,
        height=np.zeros_like(t),
        climb_rate=vel[:, 2],
        climb_acceleration=np.zeros_like(t),
    )
    rpy = VEHICLES["multirotor"].attitude(
        speed=p.speed, acceleration=p.acceleration, heading=p.heading, turn_rate=p.turn_rate, climb_rate=p.climb_rate
    )
    path = SmoothPath.from_velocity(t, vel, rpy, origin_at(46.52, 6.57, 420.0), "lemniscate")
    return Flight(path, "multirotor", (Leg("rest at the start", 0.0, 20.0, True),))


def survey() -> Flight:
    """Two hours of an aeroplane at 60 m/s: sixteen lines of 300 s, 2.7 km apart, at 1500 m above the start."""
    deg = np.pi / 180
    commands = [
        Command(60.0, name="rest on the runway"),
        Command(30.0, speed=50.0, name="take-off run"),
        Command(300.0, speed=60.0, climb=1500.0, name="climb"),
    ]
    for k in range(16):
        commands.append(Command(300.0, name=f"line {k + 1}"))
        if k < 15:
            commands.append(Command(70.0, turn=(180.0 if k % 2 == 0 else -180.0) * deg, climb=20.0 * (k % 3 - 1)))
    end = sum(c.duration_s for c in commands)
    commands += [
        Command(7200.0 - end - 100.0, speed=45.0, climb=-1480.0, name="descent and landing"),
        Command(40.0, speed=0.0, name="landing run"),
        Command(60.0, name="rest at the end"),
    ]
    # two hours that nothing shakes above 0.8 Hz
    p = profile(commands, heading=10.0 * deg, knot_s=2 * KNOT_S)
    shake = moving_share(p.speed)
    path = path_of(
        p,
        VEHICLES["fixed_wing"],
        origin_at(47.0, 8.0, 420.0),
        "survey",
        gust_vel=gusts(p.t, 0.3, (0.05, 0.8), shake, 7301),
        gust_rpy=gusts(p.t, 0.5 * deg, (0.05, 0.8), shake, 7302),
    )
    return Flight(path, "fixed_wing", legs_of(commands))


def static(duration_s: float = 1200.0) -> Flight:
    """A table at rest, tilted by 1 deg in roll and -2 deg in pitch, heading 40 deg."""
    t = np.linspace(0.0, duration_s, 9)
    rpy = np.tile(np.deg2rad([1.0, -2.0, 40.0]), (t.size, 1))
    path = SmoothPath.from_velocity(t, np.zeros((t.size, 3)), rpy, origin_at(46.52, 6.57, 400.0), "static")
    return Flight(path, "car", (Leg("rest", 0.0, duration_s, True),))


#: Built-in flights and drives by name.
TRAJECTORIES: dict[str, Callable[[], Flight]] = {
    "helicopter_mapping": helicopter_mapping,
    **{name: partial(drive, name) for name in drives()},
    "turbulent_uav": turbulent_uav,
    "lemniscate": lemniscate,
    "static": static,
    "survey": survey,
}


@lru_cache(maxsize=4)
def _made(name: str) -> Flight:
    """The splines of a flight take up to 1.3 s, and variants, fits and tests ask for the same one again; up to 80 MB are held for each."""
    return TRAJECTORIES[name]()


def built_in(name: str) -> Flight:
    """A built-in flight by name.

    Raises
    ------
    InputError
        An unknown name; the message lists what exists.
    """
    if name not in TRAJECTORIES:
        raise InputError(f"unknown trajectory '{name}'" + nearest(name, TRAJECTORIES))
    return _made(name)
