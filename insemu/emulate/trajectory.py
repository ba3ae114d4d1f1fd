"""Built-in flights and drives: a smooth path with its legs and the GNSS outages that belong to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.motion import Command, Leg, Profile, legs_of, path_of, profile
from insemu.emulate.path import SmoothPath
from insemu.emulate.vehicle import VEHICLES
from insemu.errors import InputError, nearest

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Flight:
    """A path with what belongs to it.

    Parameters
    ----------
    path : SmoothPath
        The motion.
    vehicle : str
        Key of :data:`insemu.emulate.vehicle.VEHICLES`.
    legs : tuple of Leg
        Named stretches.
    outages : tuple of (start_s, duration_s)
        GNSS outages that belong to the flight.
    """

    path: SmoothPath
    vehicle: str
    legs: tuple[Leg, ...] = ()
    outages: tuple[tuple[float, float], ...] = ()

    @property
    def name(self) -> str:
        """Name of the path."""
        return self.path.name

    def leg_at(self, start_s: float, end_s: float) -> Leg | None:
        """The leg that contains a whole interval, if there is one."""
        for leg in self.legs:
            if leg.start_s <= start_s and end_s <= leg.end_s:
                return leg
        return None


def _origin(lat_deg: float, lon_deg: float, height: float) -> Array:
    return np.array([np.deg2rad(lat_deg), np.deg2rad(lon_deg), height])


def gusts(t: Array, rms: float, band_hz: tuple[float, float], envelope: Array, seed: int, columns: int = 3) -> Array:
    """Smooth random disturbances (n, columns): 24 sines per column with frequencies spread over a band, times an
    envelope.

    The seed belongs to the trajectory, not to a run: a built-in flight is the same flight in every realization.
    """
    rng = np.random.default_rng(seed)
    lines = 24
    f = np.exp(rng.uniform(np.log(band_hz[0]), np.log(band_hz[1]), (columns, lines)))
    phase = rng.uniform(0, 2 * np.pi, (columns, lines))
    out = np.zeros((t.size, columns))
    for j in range(columns):
        for k in range(lines):
            out[:, j] += np.sin(2 * np.pi * f[j, k] * t + phase[j, k])
    return np.asarray(out * (rms * np.sqrt(2.0 / lines)) * envelope[:, None])


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
    moving = _envelope(p)
    path = path_of(
        p,
        VEHICLES["helicopter"],
        _origin(46.52, 6.57, 450.0),
        "helicopter_mapping",
        gust_vel=gusts(p.t, 0.1, (0.1, 1.0), moving, 7001),
        gust_rpy=gusts(p.t, 0.3 * deg, (0.1, 1.0), moving, 7002),
    )
    return Flight(path, "helicopter", legs_of(commands), ((420.0, 60.0), (660.0, 60.0), (900.0, 60.0)))


def _envelope(p: Profile) -> Array:
    """From 0 at rest to 1 above about 5 m/s, smooth, so that a vehicle at rest is at rest."""
    v2 = p.speed**2
    return np.asarray(v2 * v2 / (v2 * v2 + 4.0**4))


def static(duration_s: float = 1200.0) -> Flight:
    """A table at rest, tilted by 1 deg in roll and -2 deg in pitch, heading 40 deg."""
    t = np.linspace(0.0, duration_s, 9)
    rpy = np.tile(np.deg2rad([1.0, -2.0, 40.0]), (t.size, 1))
    path = SmoothPath.from_velocity(t, np.zeros((t.size, 3)), rpy, _origin(46.52, 6.57, 400.0), "static")
    return Flight(path, "car", (Leg("rest", 0.0, duration_s, True),))


#: Built-in flights and drives by name.
TRAJECTORIES: dict[str, Callable[[], Flight]] = {
    "helicopter_mapping": helicopter_mapping,
    "static": static,
}


def built_in(name: str) -> Flight:
    """A built-in flight by name.

    Raises
    ------
    InputError
        An unknown name; the message lists what exists.
    """
    if name not in TRAJECTORIES:
        raise InputError(f"unknown trajectory '{name}'" + nearest(name, TRAJECTORIES))
    return TRAJECTORIES[name]()
