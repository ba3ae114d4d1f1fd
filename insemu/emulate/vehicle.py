"""Vehicles: what they can do and how they lean while doing it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]

VehicleKind = Literal["car", "multirotor", "helicopter", "fixed_wing"]


@dataclass(frozen=True)
class Vehicle:
    """Limits of a vehicle and the attitude that its motion asks for.

    Parameters
    ----------
    name : str
        ``car``, ``multirotor``, ``helicopter`` or ``fixed_wing``.
    min_speed, max_speed : float
        Horizontal speed, m/s.
    max_acceleration : float
        Along the track, m/s^2.
    max_lateral : float
        Across the track, m/s^2 (grip of a car, bank of an aircraft).
    max_turn_rate : float
        rad/s.
    max_climb : float
        Vertical speed, m/s.
    jerk : float
        Typical jerk density, m/s^3 per sqrt(Hz): how fast the vehicle changes its mind, used when recorded tracks are
        smoothed.
    """

    name: VehicleKind
    min_speed: float
    max_speed: float
    max_acceleration: float
    max_lateral: float
    max_turn_rate: float
    max_climb: float
    jerk: float

    def attitude(
        self, *, speed: Array, acceleration: Array, heading: Array, turn_rate: Array, climb_rate: Array
    ) -> Array:
        """Roll, pitch, heading (n, 3) in rad of a motion given by (n,) arrays in SI.

        A car follows the road and leans out of the curve on its springs by 3 deg per g; a fixed wing banks in
        coordination (``tan(roll) = v w / g``) and carries 3 deg of angle of attack; a rotor craft also tilts to
        accelerate and against its drag.
        """
        g = STANDARD_GRAVITY
        lateral = speed * turn_rate
        slope = np.arctan2(climb_rate, np.hypot(speed, 3.0))  # soft at standstill, where a slope means nothing
        if self.name == "car":
            lean = np.deg2rad(3.0) / g
            roll, pitch = -lean * lateral, slope + lean * acceleration
        elif self.name == "fixed_wing":
            roll, pitch = np.arctan2(lateral, g), slope + np.deg2rad(3.0)
        else:
            drag = 0.012 * speed  # specific drag of a rotor craft, m/s^2 per m/s: 2 deg nose down at 30 m/s
            roll, pitch = np.arctan2(lateral, g), -np.arctan2(acceleration + drag, g)
        return np.stack([roll, pitch, heading], axis=1)


VEHICLES: dict[str, Vehicle] = {
    "car": Vehicle("car", 0.0, 60.0, 5.0, 6.0, 1.2, 8.0, 1.0),
    "multirotor": Vehicle("multirotor", 0.0, 25.0, 6.0, 6.0, 2.0, 6.0, 3.0),
    "helicopter": Vehicle("helicopter", 0.0, 80.0, 4.0, 8.0, 0.8, 12.0, 1.5),
    "fixed_wing": Vehicle("fixed_wing", 10.0, 120.0, 4.0, 12.0, 1.0, 12.0, 3.0),
}


def vehicle(name: str) -> Vehicle:
    """Vehicle by name.

    Raises
    ------
    InputError
        An unknown name.
    """
    if name not in VEHICLES:
        raise InputError(f"unknown vehicle '{name}'" + nearest(name, VEHICLES))
    return VEHICLES[name]
