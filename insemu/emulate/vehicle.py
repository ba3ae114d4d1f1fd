"""Vehicles: what they can do and how they lean while doing it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]

VehicleKind = Literal[
    "car", "multirotor", "helicopter", "fixed_wing", "truck", "tractor", "train", "boat", "walker", "hand"
]

#: Fastest that goes backwards on the ground or on water, m/s.
REVERSE = 8.0


@dataclass(frozen=True)
class Vehicle:
    """Limits of a vehicle and the attitude that its motion asks for.

    Parameters
    ----------
    name : str
        Key of :data:`VEHICLES`.
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
    lean : float or None
        Of what goes on the ground or on water: roll out of the curve and nose up when accelerating, rad per g (negative: into the curve, as cant
        makes a train roll); None for what flies.
    """

    name: VehicleKind
    min_speed: float
    max_speed: float
    max_acceleration: float
    max_lateral: float
    max_turn_rate: float
    max_climb: float
    jerk: float
    lean: float | None = None

    @property
    def back(self) -> float:
        """Fastest in reverse gear, m/s; 0 for what has none."""
        return 0.0 if self.lean is None else min(REVERSE, self.max_speed)

    @property
    def hovers(self) -> bool:
        """Whether it can stand in the air."""
        return self.name in ("multirotor", "helicopter")

    def attitude(
        self, *, speed: Array, acceleration: Array, heading: Array, turn_rate: Array, climb_rate: Array
    ) -> Array:
        """Roll, pitch, heading (n, 3) in rad of a motion.

        Parameters
        ----------
        speed, acceleration, heading, turn_rate, climb_rate : (n,) arrays
            m/s, m/s^2, rad, rad/s, m/s.

        Notes
        -----
        A car follows the road and leans out of the curve on its springs by 3 deg per g (a train's cant takes about half of the lateral
        acceleration: EN 13803, cant 150 mm and deficiency 150 mm on a gauge of 1500 mm); a fixed wing banks in
        coordination (``tan(roll) = v w / g``) and carries 3 deg of angle of attack; a rotor craft also tilts to
        accelerate and against its drag.
        """
        g = STANDARD_GRAVITY
        lateral = speed * turn_rate
        # soft at standstill, where a slope means nothing; uphill in reverse gear the nose points down
        slope = np.arctan2(climb_rate * np.where(speed < 0.0, -1.0, 1.0), np.hypot(speed, 3.0))
        if self.lean is not None:
            lean = self.lean / g
            roll, pitch = -lean * lateral, slope + abs(lean) * acceleration
        elif self.name == "fixed_wing":
            roll, pitch = np.arctan2(lateral, g), slope + np.deg2rad(3.0)
        else:
            drag = 0.012 * speed  # specific drag of a rotor craft, m/s^2 per m/s: 2 deg nose down at 30 m/s
            roll, pitch = np.arctan2(lateral, g), -np.arctan2(acceleration + drag, g)
        return np.stack([roll, pitch, heading], axis=1)


VEHICLES: dict[str, Vehicle] = {
    "car": Vehicle("car", 0.0, 60.0, 5.0, 6.0, 1.2, 8.0, 1.0, np.deg2rad(3.0)),
    "multirotor": Vehicle("multirotor", 0.0, 25.0, 6.0, 6.0, 2.0, 6.0, 3.0),
    "helicopter": Vehicle("helicopter", 0.0, 80.0, 4.0, 8.0, 0.8, 12.0, 1.5),
    "fixed_wing": Vehicle("fixed_wing", 10.0, 120.0, 4.0, 12.0, 1.0, 12.0, 3.0),
    "truck": Vehicle("truck", 0.0, 30.0, 2.5, 3.5, 0.6, 3.0, 0.7, np.deg2rad(5.0)),
    "tractor": Vehicle("tractor", 0.0, 14.0, 2.0, 3.0, 0.8, 2.5, 0.7, np.deg2rad(1.0)),
    "train": Vehicle("train", 0.0, 90.0, 1.2, 1.5, 0.1, 3.0, 0.3, -0.5),
    "boat": Vehicle("boat", 0.0, 25.0, 1.5, 3.0, 0.5, 0.5, 0.5, np.deg2rad(10.0)),
    "walker": Vehicle("walker", 0.0, 4.0, 3.0, 3.0, 2.5, 1.0, 2.0, 0.0),
    "hand": Vehicle("hand", 0.0, 4.0, 3.0, 3.0, 2.5, 1.0, 2.0, 0.0),
}


#: Rise per metre that no road has (the steepest streets have 0.37).
STEEPEST_ROAD = 0.4
_HIGHEST_ROAD = 6000.0


def odd_places(name: str, llh: Array, kind: Vehicle) -> tuple[str, ...]:
    """What looks odd about where a vehicle is asked to be: places in radians, swapped coordinates, heights in feet.

    Parameters
    ----------
    name : str
        Starts every message.
    llh : (n, 3) array
        Latitude rad, longitude rad, height m.
    kind : Vehicle

    Returns
    -------
    tuple of str
        Warnings; empty where nothing is odd. Two coordinates that are both plausible latitudes are not distinguished.
    """
    lat, lon = np.rad2deg(llh[:, 0]), np.rad2deg(llh[:, 1])
    out = []
    if (np.abs(lat) <= np.pi / 2).all() and (np.abs(lon) <= np.pi).all() and np.hypot(lat, lon).max() > 1e-3:
        out.append(
            f"{name}: starts at {lat[0]:.6g} deg, {lon[0]:.6g} deg, in the Gulf of Guinea: radians by the look of it, expected degrees"
        )
    elif lat.max() > 78.5 or lat.min() < -60.0:
        k = int(np.argmax(np.abs(lat)))
        swapped = "; are latitude and longitude swapped?" if np.abs(lon).max() <= 90.0 else ""
        out.append(
            f"{name}: a {kind.name} at a latitude of {lat[k]:.4g} deg, where there are no roads or towns{swapped}"
        )
    if kind.name == "car" and np.median(llh[:, 2]) > _HIGHEST_ROAD:
        out.append(f"{name}: a car at {np.median(llh[:, 2]):.0f} m: heights in feet by the look of it, expected metres")
    return tuple(out)


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
