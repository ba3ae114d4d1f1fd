"""Recorded tracks: fixes of any receiver or log, smoothed into a twice differentiable path.

The path is the quintic spline that minimises the weighted squared distances from the fixes (and from the velocities)
plus the integral of the squared jerk over the jerk density of the vehicle: the most probable path of a vehicle whose
jerk is white noise (Wahba; an integrated Wiener process seen by a smoother). Outlying fixes lose weight by Huber's
rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.emulate.path import SmoothPath, pieces_of
from insemu.emulate.table import KNOT_BYTES, check_size
from insemu.emulate.vehicle import STEEPEST_ROAD, Vehicle, odd_places, vehicle
from insemu.errors import InputError
from insemu.records import GnssRecord, Trajectory

Array = NDArray[np.float64]

_DEGREE = 5
_FOOT = 0.3048


@dataclass(frozen=True)
class Track:
    """A recorded track.

    Parameters
    ----------
    t : (n,) array
        Times in s, increasing, at any rate, with gaps.
    llh : (n, 3) array
        Latitude rad, longitude rad, height m.
    vel_ned : (n, 3) array, optional
        m/s; rows of NaN are "no velocity".
    rpy : (n, 3) array, optional
        Roll, pitch, heading in rad: a full pose.
    pos_std, vel_std : float or (n, 3) array
        Standard deviations, m and m/s.
    name : str
        Appears in messages.
    """

    t: Array
    llh: Array
    vel_ned: Array | None = None
    rpy: Array | None = None
    pos_std: float | Array = 0.5
    vel_std: float | Array = 0.1
    name: str = "track"

    @classmethod
    def of(cls, source: GnssRecord | Trajectory, name: str = "track") -> Track:
        """The fixes of a receiver, or the nodes of a trajectory (full pose)."""
        if isinstance(source, Trajectory):
            return cls(source.t, source.llh, source.vel_ned, source.rpy, 0.02, 0.01, name)
        good = np.isfinite(source.llh).all(axis=1)
        pos = 0.5 if source.pos_std_ned is None else np.maximum(source.pos_std_ned[good], 1e-3)
        vel = 0.1 if source.vel_std_ned is None else np.maximum(source.vel_std_ned[good], 1e-3)
        velocity = None if source.vel_ned is None else source.vel_ned[good]
        return cls(source.t[good], source.llh[good], velocity, None, pos, vel, name)

    def rows(self, keep: NDArray[np.int64]) -> Track:
        """Some of the points."""
        parts = {n: getattr(self, n) for n in ("t", "llh", "vel_ned", "rpy", "pos_std", "vel_std")}
        return Track(**{n: v[keep] if np.ndim(v) else v for n, v in parts.items()}, name=self.name)


@dataclass(frozen=True)
class SmoothedTrack:
    """A path made from a track, with what is left of the fixes.

    Parameters
    ----------
    path : SmoothPath
        The path.
    track : Track
        The fixes that it was made from.
    residual_ned : (n, 3) array
        Fix minus path, m.
    weight : (n,) array
        Weight of every fix after Huber's rule (1: not an outlier).
    warnings : tuple of str
        What looks odd.
    """

    path: SmoothPath
    track: Track
    residual_ned: Array
    weight: Array
    warnings: tuple[str, ...] = ()


def without_jumps_and_pauses(track: Track, max_gap_s: float, car: Vehicle) -> tuple[Track, tuple[str, ...]]:
    """A track without single points far off and without pauses, and what was left out in words.

    A point is a jump where the vehicle could, at twice its largest speed, reach it neither from the point before nor get from it to the next,
    but from the one to the other; less than that is weighed down (:func:`smooth_track`).
    A gap is a pause where the vehicle comes no further in it than at its usual speed in the longest gap that is bridged; it goes on at that
    speed.

    Parameters
    ----------
    track : Track
    max_gap_s : float
        Longest gap that is bridged, s.
    car : Vehicle
        Gives the largest speed.
    """
    said = []
    t, llh = np.asarray(track.t, dtype=float), np.asarray(track.llh, dtype=float)
    if t.ndim != 1 or llh.shape != (t.size, 3) or t.size < 5 or not np.isfinite(llh).all() or (np.diff(t) <= 0).any():
        return track, ()  # what is wrong with it says check_track
    noise = 4.0 * float(np.mean(track.pos_std))

    def reached(a: slice, b: slice) -> NDArray[np.bool_]:
        way = np.linalg.norm(earth.position_difference(llh[b], llh[a])[:, :2], axis=1)
        return np.asarray(way <= 2.0 * car.max_speed * (t[b] - t[a]) + noise)

    step, over = reached(slice(None, -1), slice(1, None)), reached(slice(None, -2), slice(2, None))
    jumps = 1 + np.flatnonzero(~step[:-1] & ~step[1:] & over)
    if 0 < jumps.size <= 0.02 * t.size:
        off = np.linalg.norm(earth.position_difference(llh[jumps], llh[jumps - 1])[:, :2], axis=1)
        said += [
            f"{track.name}: the point at t = {t[k]:.6g} s is {d:.0f} m off: left out"
            for k, d in zip(jumps, off, strict=True)
        ]
        track = track.rows(np.setdiff1d(np.arange(t.size), jumps))
        t, llh = track.t, track.llh
    steps = np.diff(t)
    way = np.linalg.norm(earth.position_difference(llh[1:], llh[:-1])[:, :2], axis=1)
    usual = float(np.median(way / steps))
    paused = (steps > max_gap_s) & (way <= usual * max_gap_s)
    if usual > 0.0 and paused.any():
        taken = np.maximum(way[paused] / usual, np.median(steps))
        for k, s in zip(np.flatnonzero(paused), taken, strict=True):
            said.append(f"{track.name}: the pause of {steps[k]:.3g} s at t = {t[k]:.6g} s is flown in {s:.2g} s")
        steps[paused] = taken
        track = replace(track, t=t[0] + np.concatenate([[0.0], np.cumsum(steps)]))
    return track, tuple(said)


def bridged_gap(track: Track, vehicle_name: str) -> int:
    """The ``max_gap`` (s, whole) with which a track can be flown: 10 s, or twice its usual step, or what is left of gaps without the pauses."""
    usual = max(10.0, 2.0 * float(np.median(np.diff(track.t))))
    connected, _ = without_jumps_and_pauses(track, usual, vehicle(vehicle_name))
    return int(np.ceil(max(usual, float(np.diff(connected.t).max()))))


def check_track(track: Track, max_gap_s: float, car: Vehicle) -> tuple[str, ...]:
    """Raise ``InputError`` for a track that cannot be used; return warnings about what looks odd.

    Parameters
    ----------
    track : Track
    max_gap_s : float
        Longest gap that is bridged, s.
    car : Vehicle
        Gives the limits of speed and climb.
    """
    name = track.name
    t, llh = np.asarray(track.t, dtype=float), np.asarray(track.llh, dtype=float)
    if t.ndim != 1 or llh.shape != (t.size, 3):
        raise InputError(f"{name}: {t.shape} times and {llh.shape} positions, expected (n,) and (n, 3)")
    if t.size < 5:
        raise InputError(f"{name}: {t.size} point(s), expected at least 5 to make a smooth path")
    bad: NDArray[np.bool_] = np.asarray(~np.isfinite(np.column_stack([t, llh])).all(axis=1))
    if bad.any():
        raise InputError(
            f"{name}: row {int(np.argmax(bad))} has a value that is not finite ({int(bad.sum())} such rows)"
        )
    step = np.diff(t)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        what = "repeats" if step[k - 1] == 0 else "goes back"
        raise InputError(f"{name}: the time {what} at row {k} ({t[k - 1]:.6g} s then {t[k]:.6g} s)")
    if step.max() > max_gap_s:
        k = int(np.argmax(step))
        raise InputError(
            f"{name}: a gap of {step[k]:.3g} s after t = {t[k]:.6g} s, longer than the {max_gap_s:g} s that are allowed"
        )
    if (np.abs(llh[:, 0]) > np.pi / 2).any():
        k = int(np.argmax(np.abs(llh[:, 0])))
        raise InputError(
            f"{name}: row {k} has a latitude of {np.rad2deg(llh[k, 0]):.6g} deg; are latitude and longitude swapped?"
        )
    for label, given in (("velocity", track.vel_ned), ("attitude", track.rpy)):
        if given is not None and np.shape(given) != (t.size, 3):
            raise InputError(f"{name}: {label} has shape {np.shape(given)}, expected {(t.size, 3)}")
    if track.rpy is not None and not np.isfinite(track.rpy).all():
        row = int(np.argmax(~np.isfinite(track.rpy).all(axis=1)))
        raise InputError(f"{name}: row {row} has an attitude that is not finite")
    warnings = list(odd_places(name, llh, car))
    moved = np.diff(earth.position_difference(llh, llh[0]), axis=0)
    speed = np.hypot(moved[:, 0], moved[:, 1]) / step
    noise = 4.0 * float(np.mean(track.pos_std)) / step
    too_fast: NDArray[np.bool_] = np.asarray(speed > 1.2 * car.max_speed + noise)
    if too_fast.mean() > 0.02:
        k = int(np.argmax(speed))
        raise InputError(
            f"{name}: the positions move at up to {speed[k]:.4g} m/s (t = {t[k]:.6g} s), "
            f"beyond the {car.max_speed:g} m/s of a {car.name}; wrong vehicle, or wrong units of time or position?"
        )
    climb = np.abs(moved[:, 2]) / step
    if track.vel_ned is not None:
        velocity = np.asarray(track.vel_ned, dtype=float)
        warnings += _against_velocity(name, t, llh, velocity)
    elif np.percentile(climb - noise, 95) > car.max_climb >= np.percentile(climb, 95) * _FOOT:
        warnings.append(
            f"{name}: climbs at {np.percentile(climb, 95):.3g} m/s, beyond the {car.max_climb:g} m/s of a {car.name}: "
            "heights in feet by the look of it, expected metres"
        )
    elif car.name == "car":
        warnings += _steep(name, t, moved, float(np.mean(track.pos_std)))
    if track.rpy is not None and track.vel_ned is None:
        _against_heading(name, llh, np.asarray(track.rpy, dtype=float), float(np.mean(track.pos_std)))
    return tuple(warnings)


def _steep(name: str, t: Array, moved: Array, sigma: float) -> list[str]:
    """Roads are not as steep as heights in feet make them; over stretches that stand out of the noise."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(moved[:, 0], moved[:, 1]))])
    rise = np.concatenate([[0.0], np.cumsum(moved[:, 2])])
    stretch = max(50.0, 40.0 * sigma)
    marks = np.searchsorted(way, np.arange(0.0, way[-1], stretch))
    if marks.size < 4:
        return []
    slope = np.maximum(0.0, np.abs(np.diff(rise[marks])) - 4.0 * sigma) / np.maximum(np.diff(way[marks]), stretch)
    k = int(np.argmax(slope))
    if slope[k] <= STEEPEST_ROAD or np.sort(slope)[-2] <= 0.75 * STEEPEST_ROAD:
        return []
    feet = ": heights in feet by the look of it, expected metres" if slope[k] * _FOOT <= STEEPEST_ROAD else ""
    return [f"{name}: rises {100 * slope[k]:.0f} % at t = {t[marks[k]]:.6g} s, steeper than any road{feet}"]


def _against_heading(name: str, llh: Array, rpy: Array, sigma: float) -> None:
    """A vehicle goes where it points; swapped coordinates send it to the mirrored course."""

    def off_course(llh: Array) -> Array:
        way = np.diff(earth.position_difference(llh, llh[0]), axis=0)
        far = np.hypot(way[:, 0], way[:, 1]) > max(0.2, 4.0 * sigma)
        turn = np.arctan2(way[far, 1], way[far, 0]) - rpy[:-1][far, 2]
        return np.asarray(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi))

    exchanged = llh[:, [1, 0, 2]]
    plain = off_course(llh)
    if plain.size < 5 or np.median(plain) < np.deg2rad(30) or (np.abs(exchanged[:, 0]) >= np.pi / 2).any():
        return
    if np.median(off_course(exchanged)) < np.deg2rad(15):
        raise InputError(f"{name}: the headings fit the way only with latitude and longitude swapped")


def _against_velocity(name: str, t: Array, llh: Array, velocity: Array) -> list[str]:
    """Positions and velocities must tell the same story; the ways in which they usually do not are named."""
    good: NDArray[np.bool_] = np.asarray(np.isfinite(velocity[:, :2]).all(axis=1))
    pairs = np.nonzero(good[1:] & good[:-1])[0]
    if pairs.size < 5:
        return []
    mean = 0.5 * (velocity[pairs] + velocity[pairs + 1]) * np.diff(t)[pairs, None]
    moved = np.diff(earth.position_difference(llh, llh[0]), axis=0)[pairs]
    if np.hypot(mean[:, 0], mean[:, 1]).sum() < 20.0:
        return []

    def misfit(a: Array, b: Array) -> float:
        return float(np.sqrt(((a - b) ** 2).sum() / (b**2).sum()))

    plain = misfit(moved[:, :2], mean[:, :2])
    if plain > 0.5:
        exchanged = np.stack([llh[:, 1], llh[:, 0], llh[:, 2]], axis=1)
        if (np.abs(exchanged[:, 0]) < np.pi / 2).all():
            other = np.diff(earth.position_difference(exchanged, exchanged[0]), axis=0)[pairs]
            if misfit(other[:, :2], mean[:, :2]) < 0.5 * plain:
                raise InputError(f"{name}: positions fit the velocities only with latitude and longitude swapped")
        raise InputError(
            f"{name}: positions and velocities disagree by {100 * plain:.0f} % of the way; "
            "expected velocities north, east, down in m/s at the times of the positions"
        )
    if np.abs(mean[:, 2]).sum() > 10.0:
        slope = float((moved[:, 2] * mean[:, 2]).sum() / (mean[:, 2] ** 2).sum())
        if slope < -0.5:
            return [f"{name}: the vertical velocity has the wrong sign against the heights; expected positive down"]
        if 2.5 < slope < 4.2:
            return [f"{name}: heights change {slope:.2f} times faster than the velocity says: feet by the look of it"]
    return []


@dataclass(frozen=True)
class _Basis:
    """Quintic B-splines on uniform knots with repeated ends."""

    knots: Array
    count: int

    @classmethod
    def over(cls, start: float, end: float, spacing: float) -> _Basis:
        check_size(
            (end - start) / spacing, KNOT_BYTES, f"a track of {end - start:.3g} s with a fix every {spacing:.3g} s"
        )
        pieces = max(2, int(np.ceil((end - start) / spacing)))
        inner = np.linspace(start, end, pieces + 1)
        knots = np.concatenate([np.repeat(start, _DEGREE), inner, np.repeat(end, _DEGREE)])
        return cls(knots, knots.size - _DEGREE - 1)

    def design(self, t: Array, derivative: int) -> tuple[NDArray[np.int64], Array]:
        """First index and values (n, 6) of the basis functions that are not zero at times (n,)."""
        first = np.clip(np.searchsorted(self.knots, t, side="right") - 1, _DEGREE, self.count - 1) - _DEGREE
        values = np.zeros((t.size, _DEGREE + 1))
        # Cox-de Boor on the knots of every time, then differences of the lower degree for derivatives
        span = first + _DEGREE
        low = np.zeros((t.size, _DEGREE + 1))
        low[:, 0] = 1.0
        top = _DEGREE - derivative
        k = self.knots
        for d in range(1, top + 1):
            new = np.zeros_like(low)
            for j in range(d):
                left, right = k[span + j + 1 - d], k[span + j + 1]
                part = low[:, j] / (right - left)
                new[:, j] += part * (right - t)
                new[:, j + 1] += part * (t - left)
            low = new
        for d in range(top + 1, _DEGREE + 1):
            new = np.zeros_like(low)
            for j in range(d):
                part = d * low[:, j] / (k[span + j + 1] - k[span + j + 1 - d])
                new[:, j] -= part
                new[:, j + 1] += part
            low = new
        values[:] = low
        return first, values

    def ppoly(self, coefficients: Array) -> scipy.interpolate.PPoly:
        """Piecewise polynomial of the coefficients (count, columns)."""
        return pieces_of(scipy.interpolate.BSpline(self.knots, coefficients, _DEGREE))


class _Smoother:
    """Banded normal equations of the penalised least squares."""

    def __init__(self, basis: _Basis, density: float) -> None:
        self.basis = basis
        self.penalty = np.zeros((_DEGREE + 1, basis.count))
        x, w = np.polynomial.legendre.leggauss(_DEGREE)
        edges = basis.knots[_DEGREE : -_DEGREE or None]
        for xi, wi in zip(x, w, strict=True):
            t = 0.5 * (edges[:-1] * (1 - xi) + edges[1:] * (1 + xi))
            first, values = basis.design(t, 3)
            self._accumulate(self.penalty, first, values, 0.5 * wi * np.diff(edges) / density**2)

    @staticmethod
    def _accumulate(band: Array, first: NDArray[np.int64], values: Array, weight: Array) -> None:
        for i in range(_DEGREE + 1):
            for j in range(i, _DEGREE + 1):
                np.add.at(band[j - i], first + i, weight * values[:, i] * values[:, j])

    def solve(self, data: list[tuple[Array, int, Array, Array]]) -> Array:
        """Coefficients (count,) from ``(times, derivative, values, weights)``; weights are inverse variances."""
        band, right = self.penalty.copy(), np.zeros(self.basis.count)
        for t, derivative, values, weight in data:
            first, design = self.basis.design(t, derivative)
            self._accumulate(band, first, design, weight)
            for i in range(_DEGREE + 1):
                np.add.at(right, first + i, weight * design[:, i] * values)
        band[0] += 1e-14 * band[0].max()
        return np.asarray(scipy.linalg.solveh_banded(band, right, lower=True))


def smooth_track(
    track: Track | GnssRecord | Trajectory,
    vehicle_name: str = "car",
    *,
    jerk: float | None = None,
    max_gap_s: float = 10.0,
    spacing_s: float | None = None,
) -> SmoothedTrack:
    """Smooth a recorded track into a path with an attitude that suits the vehicle.

    Parameters
    ----------
    track : Track, GnssRecord or Trajectory
        Position only, position and velocity, or full pose.
    vehicle_name : str
        Key of :data:`insemu.emulate.vehicle.VEHICLES`; gives jerk density, limits and the attitude where the track
        has none.
    jerk : float, optional
        Jerk density in m/s^3 per sqrt(Hz), instead of the vehicle's.
    max_gap_s : float
        Longest gap that is bridged.
    spacing_s : float, optional
        Spacing of the spline's knots; from the rate of the fixes where not given.

    Raises
    ------
    InputError
        Fewer than five points, times that repeat or go back, values that are not finite, a gap that is too long,
        speeds beyond the vehicle, latitude and longitude swapped.
    """
    if isinstance(track, GnssRecord | Trajectory):
        track = Track.of(track, getattr(track, "name", "track"))
    kind = vehicle(vehicle_name)
    track, said = without_jumps_and_pauses(track, max_gap_s, kind)
    warnings = said + check_track(track, max_gap_s, kind)
    t, llh = np.asarray(track.t, dtype=float), np.asarray(track.llh, dtype=float)
    origin = llh[0].copy()
    rm, rn = earth.radii(origin[0])
    scale_n, scale_e = float(rm + origin[2]), float((rn + origin[2]) * np.cos(origin[0]))
    lon = np.unwrap(llh[:, 1])
    xyz = np.stack([(llh[:, 0] - origin[0]) * scale_n, (lon - lon[0]) * scale_e, llh[:, 2] - origin[2]], axis=1)
    std = np.broadcast_to(np.asarray(track.pos_std, dtype=float), (t.size, 3))
    rates = None
    if track.vel_ned is not None:
        velocity = np.asarray(track.vel_ned, dtype=float)
        rm_k, rn_k = earth.radii(llh[:, 0])
        rates = np.stack(
            [
                velocity[:, 0] * scale_n / (rm_k + llh[:, 2]),
                velocity[:, 1] * scale_e / ((rn_k + llh[:, 2]) * np.cos(llh[:, 0])),
                -velocity[:, 2],
            ],
            axis=1,
        )
        rate_std = np.broadcast_to(np.asarray(track.vel_std, dtype=float), (t.size, 3))
    spacing = float(np.clip(np.median(np.diff(t)), 0.1, 0.5)) if spacing_s is None else spacing_s
    basis = _Basis.over(t[0], t[-1], spacing)
    density = kind.jerk if jerk is None else jerk
    if not density > 0:
        raise InputError(f"a jerk density of {density} m/s^3/sqrt(Hz), expected a positive number")
    smoother = _Smoother(basis, density)
    weight = np.ones(t.size)
    for _ in range(4):
        columns = []
        for axis in range(3):
            data = [(t, 0, xyz[:, axis], weight / std[:, axis] ** 2)]
            if rates is not None:
                good = np.isfinite(rates[:, axis])  # of speed and course no component down
                data.append((t[good], 1, rates[good, axis], weight[good] / rate_std[good, axis] ** 2))
            columns.append(smoother.solve(data))
        position = basis.ppoly(np.stack(columns, axis=1))
        size = np.sqrt((((xyz - position(t)) / std) ** 2).sum(axis=1))
        weight = np.minimum(1.0, 5.0 / np.maximum(size, 1e-12))  # Huber's rule: 5 sigma in three dimensions
        if (weight == 1.0).all():
            break
    attitude = _attitude(track, kind, position, spacing)
    path = SmoothPath(position, attitude, origin, Path(track.name).stem)
    residual = earth.position_difference(llh, path.llh(t))
    return SmoothedTrack(path, track, residual, weight, warnings)


def _attitude(
    track: Track, kind: Vehicle, position: scipy.interpolate.PPoly, spacing: float
) -> scipy.interpolate.PPoly:
    """Attitude as a smooth spline: the recorded one, or the one that the motion asks for."""
    start, end = float(position.x[0]), float(position.x[-1])
    if track.rpy is not None:
        t = np.asarray(track.t, dtype=float)
        angles = np.unwrap(np.asarray(track.rpy, dtype=float), axis=0)
        sigma, density = np.deg2rad(0.1), np.deg2rad(60.0)
        fine = spacing
    else:
        fine = 0.1
        t = np.linspace(start, end, int(np.ceil((end - start) / fine)) + 1)
        v, a = position(t, 1), position(t, 2)
        speed = np.hypot(v[:, 0], v[:, 1])
        moving = speed > 1.0
        heading = np.zeros(t.size)
        if moving.any():
            # while it stands the heading waits for the next move: between two moves it goes from one to the other
            course = np.unwrap(np.arctan2(v[moving, 1], v[moving, 0]))
            heading = np.interp(t, t[moving], course)
        safe = np.maximum(speed, 1e-6)
        along = np.where(moving, (v[:, 0] * a[:, 0] + v[:, 1] * a[:, 1]) / safe, 0.0)
        turn = np.where(moving, (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / safe**2, 0.0)
        angles = kind.attitude(speed=speed, acceleration=along, heading=heading, turn_rate=turn, climb_rate=v[:, 2])
        sigma, density = np.deg2rad(0.3), np.deg2rad(30.0)
    basis = _Basis.over(start, end, max(fine, 0.1) if track.rpy is not None else 0.25)
    smoother = _Smoother(basis, density)
    weight = np.full(t.size, 1.0 / sigma**2)
    columns = [smoother.solve([(t, 0, angles[:, k], weight)]) for k in range(3)]
    return basis.ppoly(np.stack(columns, axis=1))


def hold_out(track: Track, every: int = 3, seed: int = 0) -> tuple[Track, NDArray[np.bool_]]:
    """Leave out a random part of the fixes, never the first or the last.

    Parameters
    ----------
    track : Track
    every : int
        One in so many is left out.
    seed : int

    Returns
    -------
    The rest, and the mask (n,) of those left out.
    """
    rng = np.random.default_rng(seed)
    n = len(track.t)
    out = np.zeros(n, bool)
    out[1 + rng.choice(n - 2, (n - 2) // every, replace=False)] = True

    def rest(x: ArrayLike | None) -> Array | None:
        return None if x is None else np.asarray(x, dtype=float)[~out]

    def std(x: float | Array) -> float | Array:
        return x if np.ndim(x) == 0 else np.asarray(x, dtype=float)[~out]

    kept = Track(
        np.asarray(track.t)[~out],
        np.asarray(track.llh)[~out],
        rest(track.vel_ned),
        rest(track.rpy),
        std(track.pos_std),
        std(track.vel_std),
        track.name,
    )
    return kept, out


def held_out_distance(track: Track, vehicle_name: str = "car") -> Array:
    """Distances in m of held-out fixes from the path that is smoothed from the rest; see :func:`hold_out`.

    Parameters
    ----------
    track : Track
    vehicle_name : str
    """
    kept, out = hold_out(track)
    path = smooth_track(kept, vehicle_name).path
    difference = earth.position_difference(np.asarray(track.llh)[out], path.llh(np.asarray(track.t)[out]))
    return np.asarray(np.linalg.norm(difference, axis=1))


def turn_rate(path: SmoothPath, t: ArrayLike) -> Array:
    """Rate of the heading (n,) in rad/s."""
    k = path.kinematics(t)
    down = rotation.dcm_from_rpy(k.rpy)[:, 2]  # NED down in body axes
    return np.asarray(np.einsum("ni,ni->n", down, k.w_nb_b))
