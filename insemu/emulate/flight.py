"""What a flight is: a smooth path with its legs and the GNSS outages that belong to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.motion import Leg
from insemu.emulate.path import SmoothPath

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


def origin_at(lat_deg: float, lon_deg: float, height: float) -> Array:
    """Latitude rad, longitude rad, height m.

    Parameters
    ----------
    lat_deg, lon_deg : float
    height : float
        m.
    """
    return np.array([np.deg2rad(lat_deg), np.deg2rad(lon_deg), height])


def gusts(t: Array, rms: float, band_hz: tuple[float, float], envelope: Array, seed: int, columns: int = 3) -> Array:
    """Smooth random disturbances (n, columns): 24 sines per column with frequencies over a band, times an envelope.

    Parameters
    ----------
    t : (n,) array
        s.
    rms : float
        Root mean square under an envelope of 1.
    band_hz : (low, high)
    envelope : (n,) array
    seed : int
    columns : int

    Notes
    -----
    The logarithm of the band is cut into strata that the columns take in turns, so no two columns share a frequency and
    the axes stay uncorrelated over minutes, as in turbulence. The seed belongs to the trajectory, not to a run: a
    built-in flight is the same flight in every realization.
    """
    rng = np.random.default_rng(seed)
    lines = 24
    strata = (
        np.arange(lines)[None, :] * columns + np.arange(columns)[:, None] + rng.uniform(0.2, 0.8, (columns, lines))
    ) / (lines * columns)
    f = band_hz[0] * (band_hz[1] / band_hz[0]) ** strata
    phase = rng.uniform(0, 2 * np.pi, (columns, lines))
    out = np.zeros((t.size, columns))
    for j in range(columns):
        for k in range(lines):
            out[:, j] += np.sin(2 * np.pi * f[j, k] * t + phase[j, k])
    return np.asarray(out * (rms * np.sqrt(2.0 / lines)) * envelope[:, None])


def moving_share(speed: Array) -> Array:
    """From 0 at rest to 1 above about 5 m/s, smooth, so that a vehicle at rest is at rest."""
    v2 = speed**2
    return np.asarray(v2 * v2 / (v2 * v2 + 4.0**4))
