"""A flight that is longer than its motion: the motion again and again, each time from where the one before ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly

from insemu.emulate.flight import Flight
from insemu.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Repeated:
    """A curve (k, 3) of time that is gone through several times: every time turned in the plane of its first two components, and moved.

    Parameters
    ----------
    once : PPoly
    turns : (count,) array
        Angles by which the plane is turned in every lap, rad.
    places : (count, 3) array
        Where every lap begins.
    """

    once: PPoly
    turns: Array
    places: Array

    @property
    def x(self) -> Array:
        """First and last time, s."""
        first, last = float(self.once.x[0]), float(self.once.x[-1])
        return np.array([first, first + self.turns.size * (last - first)])

    def __call__(self, t: ArrayLike, nu: int = 0) -> Array:
        """Values, or derivatives of an order, at times (n,)."""
        t = np.asarray(t, dtype=float)
        first, last = float(self.once.x[0]), float(self.once.x[-1])
        lap = np.clip(((t - first) / (last - first)).astype(np.int64), 0, self.turns.size - 1)
        value = self.once(np.clip(t - lap * (last - first), first, last), nu)
        if nu == 0:
            value = value - self.once(first)
        c, s = np.cos(self.turns[lap]), np.sin(self.turns[lap])
        turned = np.stack(
            [c * value[..., 0] - s * value[..., 1], s * value[..., 0] + c * value[..., 1], value[..., 2]], -1
        )
        return turned + self.places[lap] if nu == 0 else turned


def repeated(flight: Flight, duration_s: float) -> Flight:
    """A flight that lasts at least so long: its motion is flown again from the place and with the heading that it ended with.

    Parameters
    ----------
    flight : Flight
        At rest and upright in the same way at both ends, so that one lap goes on from another.
    duration_s : float

    Raises
    ------
    InputError
        A motion that does not begin and end alike.
    """
    path = flight.path
    ends = np.array([path.start, path.end])
    attitude, moving = path.attitude(ends), np.abs([path.position(ends, 1), path.attitude(ends, 1)]).max()
    if moving > 1e-6 or np.abs(attitude[1, :2] - attitude[0, :2]).max() > 1e-6:
        raise InputError(
            f"the motion '{flight.name}' does not begin and end at rest in one attitude, so it cannot be repeated"
        )
    count = math.ceil(duration_s / path.duration - 1e-9)
    turn, way = attitude[1, 2] - attitude[0, 2], np.diff(path.position(ends), axis=0)[0]
    turns = turn * np.arange(count)
    places, headings = np.zeros((2, count, 3))
    c, s = np.cos(turns), np.sin(turns)
    steps = np.stack([c * way[0] - s * way[1], s * way[0] + c * way[1], np.full(count, way[2])], axis=1)
    places[:] = path.position(path.start) + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)[:-1]])
    headings[:] = attitude[0]
    headings[:, 2] += turns
    whole = replace(
        path,
        position=Repeated(path.position, turns, places),
        attitude=Repeated(path.attitude, np.zeros(count), headings),
    )
    laps = [lap * path.duration for lap in range(count)]
    legs = [replace(g, start_s=g.start_s + by, end_s=g.end_s + by) for by in laps for g in flight.legs]
    outages = [(start + by, length) for by in laps for start, length in flight.outages]
    return Flight(whole, flight.vehicle, tuple(legs), tuple(outages))
