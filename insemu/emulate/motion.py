"""Motion commands: accelerate, turn, climb and wait, put together into a smooth path.

Every change follows the quintic ``6 u^5 - 15 u^4 + 10 u^3``, whose first and second derivative vanish at both ends,
so the path that the commands make has a continuous acceleration whatever their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.emulate.path import KNOT_S, SmoothPath
from insemu.emulate.table import KNOT_BYTES, check_size
from insemu.emulate.vehicle import Vehicle
from insemu.errors import InputError

Array = NDArray[np.float64]


def smoothstep(u: ArrayLike) -> Array:
    """Quintic from 0 at u <= 0 to 1 at u >= 1 with two vanishing derivatives at both ends."""
    x = np.clip(np.asarray(u, dtype=float), 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (-15.0 + 6.0 * x)))


def smoothstep_slope(u: ArrayLike) -> Array:
    """Derivative of :func:`smoothstep`."""
    x = np.clip(np.asarray(u, dtype=float), 0.0, 1.0)
    return np.asarray(30.0 * x**2 * (1.0 - x) ** 2)


def smoothstep_integral(u: ArrayLike) -> Array:
    """Integral of :func:`smoothstep` from 0; grows as u - 1/2 beyond 1."""
    u = np.asarray(u, dtype=float)
    inside = np.clip(u, 0.0, 1.0)
    return np.asarray(inside**4 * (2.5 + inside * (-3.0 + inside)) + np.maximum(u - 1.0, 0.0))


def steady(tau: ArrayLike, duration: float, ramp: float) -> Array:
    """Time integral of a rate of 1 between two smooth ramps: from 0 to ``duration - ramp``.

    Parameters
    ----------
    tau : (n,) array_like
        Since the start, s.
    duration, ramp : float
        Of the whole and of each ramp, s.
    """
    tau = np.asarray(tau, dtype=float)
    return np.asarray(ramp * (smoothstep_integral(tau / ramp) - smoothstep_integral((tau - duration + ramp) / ramp)))


@dataclass(frozen=True)
class Command:
    """One stretch of motion.

    Parameters
    ----------
    duration_s : float
        How long it takes.
    speed : float, optional
        Horizontal speed in m/s at its end, reached smoothly over ``speed_in_s`` (the whole stretch where not given);
        without it the speed stays.
    turn : float
        Change of heading over the stretch, rad, positive to the right: a steady rate between two ramps.
    climb : float
        Change of height over the stretch, m, positive up.
    name : str
        Label of a leg; stretches without a turn are straight.
    speed_in_s : float, optional
        Duration of the change of speed, from the start of the stretch.
    back : bool
        In reverse gear: the vehicle goes where its tail points.
    """

    duration_s: float
    speed: float | None = None
    turn: float = 0.0
    climb: float = 0.0
    name: str = ""
    speed_in_s: float | None = None
    back: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration_s) and self.duration_s > 0):
            raise InputError(f"a motion command lasts {self.duration_s} s, expected a positive duration")
        if self.speed is not None and not (np.isfinite(self.speed) and self.speed >= 0):
            raise InputError(f"a motion command asks for a speed of {self.speed} m/s, expected zero or more")
        if not (np.isfinite(self.turn) and np.isfinite(self.climb)):
            raise InputError("a motion command has a turn or a climb that is not finite")


@dataclass(frozen=True)
class Leg:
    """A named stretch of a flight: ``start_s`` to ``end_s``, straight or not."""

    name: str
    start_s: float
    end_s: float
    straight: bool


@dataclass(frozen=True)
class Profile:
    """Speed, heading and height against time at the knots, with first derivatives; (n,) arrays."""

    t: Array
    speed: Array
    acceleration: Array
    heading: Array
    turn_rate: Array
    height: Array
    climb_rate: Array
    climb_acceleration: Array


def profile(
    commands: Sequence[Command],
    *,
    heading: float = 0.0,
    speed: float = 0.0,
    start_s: float = 0.0,
    knot_s: float = KNOT_S,
) -> Profile:
    """Evaluate commands on the knots of a path.

    Parameters
    ----------
    commands : sequence of Command
        In order.
    heading, speed : float
        Initial heading in rad and horizontal speed in m/s.
    start_s : float
        Time of the start, s.
    knot_s : float
        Spacing of the knots, s.
    """
    if not commands:
        raise InputError("there are no motion commands, expected at least one")
    total = sum(c.duration_s for c in commands)
    check_size(total / knot_s, KNOT_BYTES, f"a motion of {total:.3g} s")
    n = max(int(np.ceil(total / knot_s - 1e-9)), 8)
    t = start_s + np.linspace(0.0, total, n + 1)
    columns = np.zeros((7, n + 1))
    begin = start_s
    level = 0.0
    for c in commands:
        last = c is commands[-1]
        rows = (t >= begin - 1e-9) & ((t < begin + c.duration_s - 1e-9) | last)
        tau = t[rows] - begin
        u = tau / c.duration_s
        target = speed if c.speed is None else -c.speed if c.back else c.speed
        over = min(c.speed_in_s or c.duration_s, c.duration_s)
        columns[0, rows] = speed + (target - speed) * smoothstep(tau / over)
        columns[1, rows] = (target - speed) / over * smoothstep_slope(tau / over) * (tau <= over)
        # trapezoid with smooth ramps; the steady rate makes the area equal to the turn
        ramp = min(4.0, c.duration_s / 3.0)
        rate = c.turn / (c.duration_s - ramp)
        up, down = tau / ramp, (tau - (c.duration_s - ramp)) / ramp
        columns[2, rows] = heading + rate * steady(tau, c.duration_s, ramp)
        columns[3, rows] = rate * (smoothstep(up) - smoothstep(down))
        columns[4, rows] = level + c.climb * smoothstep(u)
        columns[5, rows] = c.climb / c.duration_s * smoothstep_slope(u)
        columns[6, rows] = c.climb / c.duration_s**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
        speed, heading, level, begin = target, heading + c.turn, level + c.climb, begin + c.duration_s
    return Profile(t, *columns)


def legs_of(commands: Sequence[Command]) -> tuple[Leg, ...]:
    """Start and end of every named command."""
    legs, begin = [], 0.0
    for c in commands:
        if c.name:
            legs.append(Leg(c.name, begin, begin + c.duration_s, c.turn == 0.0))
        begin += c.duration_s
    return tuple(legs)


def path_of(
    p: Profile,
    vehicle: Vehicle,
    origin: ArrayLike,
    name: str,
    *,
    gust_vel: Array | None = None,
    gust_rpy: Array | None = None,
) -> SmoothPath:
    """Turn a profile into a path with the attitude that the vehicle needs for it.

    Parameters
    ----------
    p : Profile
        Speed, heading, height at the knots.
    vehicle : Vehicle
        Gives roll and pitch.
    origin : (3,) array_like
        Latitude rad, longitude rad, height m of the start.
    name : str
        Name of the path.
    gust_vel, gust_rpy : (n, 3) arrays, optional
        Disturbances added to the velocity (north, east, up, m/s) and the Euler angles (rad) at the knots.
    """
    vel = np.stack([p.speed * np.cos(p.heading), p.speed * np.sin(p.heading), p.climb_rate], axis=1)
    rpy = vehicle.attitude(
        speed=p.speed, acceleration=p.acceleration, heading=p.heading, turn_rate=p.turn_rate, climb_rate=p.climb_rate
    )
    if gust_vel is not None:
        vel = vel + gust_vel
    if gust_rpy is not None:
        rpy = rpy + gust_rpy
    return SmoothPath.from_velocity(p.t, vel, rpy, origin, name)
