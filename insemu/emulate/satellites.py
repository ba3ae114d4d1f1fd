"""Satellites over a flight: where they are, which of them an antenna sees, and what a receiver observes of them.

Orbits are those of the package sidereon, an optional extra (``pip install 'insemu[gnss]'``); here stand signal travel time, masks, and errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.emulate.gnss import AreaOutage, Outage
from insemu.errors import InputError
from insemu.noise import GM, Clock, NoiseModel
from insemu.records import RawRecord

Array = NDArray[np.float64]

#: Speed of light, m/s.
LIGHT = 299_792_458.0
#: Ephemerides of constellations that come with insemu, by name.
CONSTELLATIONS = {file.stem: file for file in sorted((Path(__file__).parent / "constellations").glob("*.rnx"))}
#: Seconds from the start of GPS time to J2000.
_J2000 = 630_763_200.0
#: Half the time over which positions are differenced to velocities, s: the third derivative of an orbit makes 2e-5 m/s of it.
_AROUND = 0.5
#: Noise goes with one over the sine of the elevation, which is at least this.
_LOWEST = np.sin(np.deg2rad(5.0))


@dataclass(frozen=True)
class Multipath:
    """What reflections add to a pseudorange: a Gauss-Markov process of its own for each satellite.

    Parameters
    ----------
    sigma : float
        Standard deviation at the zenith, m.
    Tc : float
        Correlation time, s.
    """

    sigma: float
    Tc: float


@dataclass(frozen=True)
class Receiver:
    """A receiver of raw observations.

    Parameters
    ----------
    constellation : str
        Name among :data:`CONSTELLATIONS`, or a RINEX navigation file.
    start : float
        Time of the start of the trajectory after the first ephemeris, s.
    mask : float
        Lowest elevation, rad.
    range_sigma, rate_sigma : float
        Standard deviations of white noise at the zenith, m and m/s; elsewhere by one over the sine of the elevation.
    clock : Clock
    multipath : Multipath, optional
        The stated standard deviation holds it as if it were white.
    """

    constellation: str = "gps"
    start: float = 0.0
    mask: float = np.deg2rad(10.0)
    range_sigma: float = 1.0
    rate_sigma: float = 0.05
    clock: Clock = field(default_factory=Clock)
    multipath: Multipath | None = None


@dataclass(frozen=True)
class Sky:
    """Satellites as an antenna sees them, s of them at times (n,).

    Parameters
    ----------
    t : (n,) array
        s.
    names : tuple of str
    place, velocity : (n, s, 3) arrays
        As in :class:`~insemu.records.RawRecord`.
    range, rate : (n, s) arrays
        Distance at reception from where the signal left, m, and its derivative, m/s.
    elevation, azimuth : (n, s) arrays
        rad; azimuth from north to east.
    """

    t: Array
    names: tuple[str, ...]
    place: Array
    velocity: Array
    range: Array
    rate: Array
    elevation: Array
    azimuth: Array


def sky_over(file: Path, t: Array, llh: Array, vel_ned: Array, start: float) -> Sky:
    """Satellites over an antenna.

    Parameters
    ----------
    file : path
        RINEX navigation file.
    t : (n,) array
        s.
    llh, vel_ned : (n, 3) arrays
        Motion of the antenna.
    start : float
        Seconds after the first ephemeris at which ``t`` is zero.

    Raises
    ------
    InputError
        The package is missing, the file cannot be read, or its ephemerides do not cover the flight.
    """
    try:
        import sidereon
    except ImportError:
        raise InputError("raw GNSS observations need the package sidereon: pip install 'insemu[gnss]'") from None
    try:
        orbits = sidereon.parse_rinex_nav(file.read_text(encoding="utf-8"))
    except (sidereon.ParseError, UnicodeDecodeError) as error:
        raise InputError(f"no RINEX navigation file: {error}", where=str(file)) from None
    if not orbits.records:
        raise InputError("found no ephemeris, expected those of a navigation file", where=str(file))
    names = tuple(sorted({record.satellite for record in orbits.records}))
    first = min(record.toe_week * 604_800.0 + record.toe_tow_s for record in orbits.records) - _J2000
    at = first + start + t
    place, speed = earth.llh_to_ecef(llh), np.einsum("nij,nj->ni", earth.dcm_en(llh[:, 0], llh[:, 1]), vel_ned)
    before, here, after = (
        _places(sidereon, orbits, names, at + s, place + s * speed, str(file)) for s in (-_AROUND, 0.0, _AROUND)
    )
    velocity = (after - before) / (2.0 * _AROUND)
    away = here - place[:, None]
    distance = np.linalg.norm(away, axis=2)
    sight = away / distance[:, :, None]
    north, east, down = np.moveaxis(np.einsum("nji,nsj->nsi", earth.dcm_en(llh[:, 0], llh[:, 1]), sight), 2, 0)
    rate = np.einsum("nsi,nsi->ns", sight, velocity - speed[:, None])
    return Sky(t, names, here, velocity, distance, rate, np.arcsin(-down), np.arctan2(east, north))


def _places(sidereon: Any, orbits: Any, names: Sequence[str], at: Array, place: Array, file: str) -> Array:
    """Satellites (n, s, 3) at transmission of what a place (n, 3) receives, in the Earth axes of reception."""
    n, s = at.size, len(names)
    delay = np.full((n, s), 0.075)
    for _ in range(3):  # a satellite moves by 3e-6 of what the delay is wrong by
        moments = (at[:, None] - delay).ravel()
        states = sidereon.observable_states_at_j2000_s(orbits, list(names) * n, moments)
        found = np.asarray(states.positions_ecef_m).reshape(n, s, 3)
        if not np.isfinite(found).all():
            row, k = np.argwhere(~np.isfinite(found).all(axis=2))[0]
            raise InputError(
                f"found no valid ephemeris of {names[k]} {at[row] - at[0]:g} s after the first observation: {states.element_result(row * s + k)}; "
                "expected a flight within two hours of an ephemeris of every satellite",
                where=file,
            )
        turned = earth.RATE * delay
        x, y = found[:, :, 0], found[:, :, 1]
        out = np.stack(
            [np.cos(turned) * x + np.sin(turned) * y, np.cos(turned) * y - np.sin(turned) * x, found[:, :, 2]], axis=2
        )
        delay = np.linalg.norm(out - place[:, None], axis=2) / LIGHT
    return out


def seen(sky: Sky, llh: Array, mask: float, outages: Sequence[Outage | AreaOutage]) -> NDArray[np.bool_]:
    """Which satellites are observed, (n, s).

    Parameters
    ----------
    sky : Sky
    llh : (n, 3) array
        Where the antenna is.
    mask : float
        Lowest elevation, rad.
    outages : sequence of Outage or AreaOutage
        Of an outage that leaves so many satellites these are the highest of those seen at its first epoch.
    """
    out = sky.elevation >= mask
    for outage in outages:
        if isinstance(outage, AreaOutage) or outage.total:
            out &= ~(outage.covers(llh) if isinstance(outage, AreaOutage) else outage.covers(sky.t))[:, None]
            continue
        rows = np.flatnonzero(outage.covers(sky.t))
        out[rows] &= sky.elevation[rows] >= outage.horizon(sky.azimuth[rows])
        if rows.size and outage.satellites is not None:
            height = np.where(out[rows[0]], sky.elevation[rows[0]], -np.inf)
            out[np.ix_(rows, np.argsort(-height, kind="stable")[outage.satellites :])] = False
    return out


def observed(
    sky: Sky, visible: NDArray[np.bool_], receiver: Receiver, rng: np.random.Generator, *, ideal: bool = False
) -> RawRecord:
    """What a receiver observes, with a clock and errors of its own.

    Parameters
    ----------
    sky : Sky
        At times of one spacing.
    visible : (n, s) array of bool
    receiver : Receiver
    rng : Generator
        Clock, ranges, rates and multipath draw from their own children, for all satellites and epochs: a mask changes no other observation.
    ideal : bool
        Without errors.
    """
    of_clock, of_range, of_rate, of_path = rng.spawn(4)
    shape, low = sky.range.shape, 1.0 / np.maximum(np.sin(sky.elevation), _LOWEST)
    path = receiver.multipath
    range_std = np.hypot(receiver.range_sigma, 0.0 if path is None else path.sigma) * low
    rate_std = receiver.rate_sigma * low
    ranges, rates = sky.range.copy(), sky.rate.copy()
    if not ideal:
        bias, drift = receiver.clock.simulate(sky.t, of_clock)
        ranges += bias[:, None] + receiver.range_sigma * low * of_range.standard_normal(shape)
        rates += drift[:, None] + rate_std * of_rate.standard_normal(shape)
        if path is not None:
            process, dt = NoiseModel((GM(sigma=path.sigma, beta=1.0 / path.Tc),)), float(np.diff(sky.t).mean())
            reflected = [process.simulate(len(sky.t), dt, child) for child in of_path.spawn(shape[1])]
            ranges += low * np.stack(reflected, axis=1)
    ranges[~visible], rates[~visible] = np.nan, np.nan
    return RawRecord(sky.t, sky.names, ranges, rates, range_std, rate_std, sky.place, sky.velocity)
