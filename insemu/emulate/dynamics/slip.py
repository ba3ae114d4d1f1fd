"""Course is not heading: what a vehicle's nose does while its path goes on, as processes of their own with a cause each.

Positive is a heading to the right of the course. Causes: bends and side forces of tyres, wind on what flies, current and leeway of what floats, a
nose that is free, and a slow random process for what nobody models.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.dynamics.slow import SlowProcess
from insemu.emulate.motion import smoothstep
from insemu.emulate.vehicle import Vehicle
from insemu.errors import InputError
from insemu.units import STANDARD_GRAVITY as G

Array = NDArray[np.float64]
Nose = Literal["course", "target", "wandering", "turning"]

#: The mean wind and the current swing by this share of themselves within so many s (means over ten minutes against one: Stull 1988, chapter 2).
AIR_SWING, AIR_TIME = 0.15, 30.0
#: Height in m over which what takes off comes into the wind, and share of the least flying speed from which on a wing is carried by air.
_TAKE_OFF, _CARRIED = 2.0, 0.8
#: Nearest that a path may come to what the nose looks at, m.
NEAREST = 3.0
#: A free nose that wanders: standard deviation rad, and s; one that turns: rad/s.
WANDERING, WANDERING_TIME, TURNING = np.deg2rad(70.0), 12.0, np.deg2rad(15.0)


@dataclass(frozen=True)
class Slip:
    """What turns a vehicle's nose out of its course.

    Parameters
    ----------
    sigma, time : float
        Of the slow random part, rad and s; it is there only while the vehicle moves or flies.
    axle : float
        Reference point ahead of the rear axle, m: in a bend of curvature k the nose stays outside of its course by ``axle k``.
    compliance : float
        The tail swings out by this per lateral acceleration, so the nose points inwards, rad per m/s^2 (tyres).
    wind : float
        Mean wind at 6 m, m/s.
    wind_from : float
        Where it comes from, rad from north.
    drag : float
        Of rotors, 1/s: how they lean against the wind.
    leeway : float
        Speed over water that the wind gives, as a share of it.
    current : (speed m/s, towards rad)
    nose : {"course", "target", "wandering", "turning"}
        Where a rotorcraft looks.
    target : (latitude, longitude) rad, optional
        For ``nose: target``.
    """

    sigma: float = 0.0
    time: float = 2.0
    axle: float = 0.0
    compliance: float = 0.0
    wind: float = 0.0
    wind_from: float = 0.0
    drag: float = 0.0
    leeway: float = 0.0
    current: tuple[float, float] = (0.0, 0.0)
    nose: Nose = "course"
    target: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if (self.nose == "target") != (self.target is not None):
            raise InputError("a nose that looks at a target needs 'target', latitude and longitude; another has none")

    @property
    def none(self) -> bool:
        """Whether course is heading."""
        flows = self.wind or self.current[0]
        return not (self.sigma or self.axle or self.compliance or flows) and self.nose == "course"


#: Sideslip of the kinds where a file says nothing. Tyres: Mitschke and Wallentowitz 2014 (0.2 to 0.3 deg per m/s^2 at the rear axle); leeway of power
#: boats: 3 to 5 per cent of the wind (Allen and Plourde 1999); random parts: the drives of docs/vehicles.md, a walker's pelvis, a hand.
SLIPS = {
    "car": Slip(np.deg2rad(0.4), 1.5, axle=1.4, compliance=np.deg2rad(0.25)),
    "truck": Slip(np.deg2rad(0.4), 2.0, axle=2.5, compliance=np.deg2rad(0.25)),
    "tractor": Slip(np.deg2rad(1.0), 2.0, axle=1.0, compliance=np.deg2rad(0.3)),
    "train": Slip(),
    "fixed_wing": Slip(np.deg2rad(1.0), 2.0),
    "multirotor": Slip(np.deg2rad(4.0), 6.0),
    "helicopter": Slip(np.deg2rad(2.5), 6.0),
    "boat": Slip(np.deg2rad(2.0), 6.0, leeway=0.04),
    "walker": Slip(np.deg2rad(6.0), 3.0),
    "hand": Slip(np.deg2rad(20.0), 10.0),
}


class SlipMotion:
    """Changes of roll, pitch and heading (n, 3) in rad that a slip makes of a path's.

    Parameters
    ----------
    slip : Slip
    vehicle : Vehicle
    seed : tuple of int
    place : (2,) array
        North and east of the target on the path's map, m; zeros without one.
    """

    def __init__(self, slip: Slip, vehicle: Vehicle, seed: tuple[int, ...], place: Array) -> None:
        self.slip, self.vehicle, self.place = slip, vehicle, place
        self._random = SlowProcess(slip.sigma, slip.time, (*seed, 0))
        self._flows = [SlowProcess(AIR_SWING, AIR_TIME, (*seed, 1 + k)) for k in range(4)]
        self._wander = SlowProcess(WANDERING, WANDERING_TIME, (*seed, 5))

    def _flow(self, t: Array, speed: float, towards: float, first: int) -> Array:
        """Velocity (n, 2) north, east of wind or current."""
        along, across = 1.0 + self._flows[first](t), self._flows[first + 1](t)
        c, s = np.cos(towards), np.sin(towards)
        return np.asarray(speed * np.stack([c * along - s * across, s * along + c * across], axis=1))

    def turned(self, t: Array, where: Array, velocity: Array, attitude: Array, turn: Array, last: float) -> Array:
        """The changes (n, 3) at times on a uniform grid.

        Parameters
        ----------
        t : (n,) array
        where, velocity, attitude : (n, 3) arrays
            Metres and m/s north, east, up; roll, pitch, heading of the path.
        turn : (n,) array
            Rate of the path's heading, rad/s.
        last : float
            What a free nose did just before, rad.
        """
        s, heading = self.slip, attitude[:, 2]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        ahead = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
        moving = speed**2 / (speed**2 + 1.0)
        if self.vehicle.lean is None:  # it flies
            high = np.clip(where[:, 2] / _TAKE_OFF, 0.0, 1.0)
            fast = np.clip(speed / max(_CARRIED * self.vehicle.min_speed, 3.0) - 0.5, 0.0, 1.0)
            moving = np.maximum(smoothstep(high), smoothstep(fast))
        change = self._random(t) * moving
        change += s.compliance * turn * ahead - s.axle * turn * ahead / (ahead**2 + 1.0)
        tilt = np.zeros((t.size, 2))
        air = self._flow(t, s.wind, s.wind_from + np.pi, 0) if s.wind else np.zeros((t.size, 2))
        if self.vehicle.hovers:
            push = s.drag * air * moving[:, None]
            c, n = np.cos(heading), np.sin(heading)
            tilt = np.stack([-(c * push[:, 1] - n * push[:, 0]), c * push[:, 0] + n * push[:, 1]], axis=1) / G
        else:
            flow = air if self.vehicle.lean is None else s.leeway * air
            if s.current[0]:
                flow = flow + self._flow(t, *s.current, 2)
            if (
                s.wind or s.current[0]
            ):  # else the nose is on its course, and the angle of a way at standstill is anything
                through = velocity[:, :2] - flow
                # the angle from the nose to the way through air or water; none where the vehicle is slower than they are
                c, n = np.cos(heading), np.sin(heading)
                angle = np.arctan2(c * through[:, 1] - n * through[:, 0], c * through[:, 0] + n * through[:, 1])
                ratio = np.hypot(flow[:, 0], flow[:, 1]) / np.maximum(speed, 1e-3)
                change += angle * moving * smoothstep(np.clip((1.2 - ratio) / 0.4, 0.0, 1.0))
        if s.nose != "course":
            change = change + self.free(t, where, heading, last)
        return self._attitude(attitude, change, tilt)

    def free(self, t: Array, where: Array, heading: Array, last: float) -> Array:
        """What a free nose does instead of following the course, rad, counted through whole turns from ``last`` on.

        Parameters
        ----------
        t : (n,) array
        where : (n, 3) array
        heading : (n,) array
            Of the path, rad.
        last : float
        """
        return np.unwrap(np.concatenate([[last], self._free(t, where, heading)]))[1:]

    def _free(self, t: Array, where: Array, heading: Array) -> Array:
        if self.slip.nose == "wandering":
            return self._wander(t)
        if self.slip.nose == "turning":
            return np.asarray(TURNING * (t - t[0]) + (TURNING * t[0]) % (2.0 * np.pi))
        north, east = self.place[0] - where[:, 0], self.place[1] - where[:, 1]
        near = np.hypot(north, east)
        if near.min() < NEAREST:
            raise InputError(
                f"the path passes {near.min():.2g} m from the target of the nose at {t[near.argmin()]:.4g} s, expected {NEAREST:g} m at least"
            )
        return np.asarray(np.arctan2(east, north) - heading)

    def _attitude(self, attitude: Array, change: Array, tilt: Array) -> Array:
        """Changes of the Euler angles; of what hangs under rotors the thrust keeps its direction while the nose turns."""
        if not self.vehicle.hovers:
            return np.stack([0.0 * change, 0.0 * change, change], axis=1)
        roll, pitch = attitude[:, 0] + tilt[:, 0], attitude[:, 1] + tilt[:, 1]
        x, y, z = np.sin(pitch) * np.cos(roll), -np.sin(roll), np.cos(pitch) * np.cos(roll)
        c, s = np.cos(change), np.sin(change)
        x, y = c * x + s * y, c * y - s * x
        return np.stack([-np.arcsin(y) - attitude[:, 0], np.arctan2(x, z) - attitude[:, 1], change], axis=1)
