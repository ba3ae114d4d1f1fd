"""Where motion comes from: a built-in name, waypoints, a recorded track, or a motion command file; and track files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.commands import read_motion
from insemu.emulate.dynamics import Moving
from insemu.emulate.flight import Flight
from insemu.emulate.laps import repeated
from insemu.emulate.motion import Leg
from insemu.emulate.table import read_columns, text_of
from insemu.emulate.track import SmoothedTrack, Track, smooth_track
from insemu.emulate.trajectory import built_in, static
from insemu.emulate.vehicle import odd_places
from insemu.emulate.vehicle import vehicle as vehicle_of
from insemu.emulate.waypoints import read_waypoints, route
from insemu.errors import InputError
from insemu.formats import layout_of, opened, read_recording, split_header

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Source:
    """A flight with what was said while it was made.

    Parameters
    ----------
    flight : Flight
        The path with its legs.
    warnings : tuple of str
        What looks odd about the input.
    track : SmoothedTrack or None
        Fixes and residuals, where the motion is a recorded track.
    """

    flight: Flight
    warnings: tuple[str, ...] = ()
    track: SmoothedTrack | None = None


@dataclass(frozen=True, kw_only=True)
class MotionSource:
    """Where a motion comes from: exactly one of the first four, and how it is used.

    Parameters
    ----------
    builtin : str
        Name of a built-in trajectory.
    waypoints : path
        CSV or GeoJSON; ``speed`` (m/s) where the file has none.
    track : path
        A recording (its GNSS fixes, else its reference) or a CSV (see :func:`read_track`).
    motion : path
        Motion command file (:mod:`insemu.emulate.commands`).
    vehicle : str or Moving
        For waypoints and tracks; one that moves about its path does so on every motion.
    speed : float
        For waypoints without speeds, m/s.
    max_gap_s : float
        Longest gap of a track that is bridged.
    duration_s : float, optional
        How much of it is wanted, s: a table at rest is made that long, another built-in motion is repeated, a file must last so long.
    """

    builtin: str | None = None
    waypoints: str | Path | None = None
    track: str | Path | None = None
    motion: str | Path | None = None
    vehicle: str | Moving = "car"
    speed: float | None = None
    max_gap_s: float = 10.0
    duration_s: float | None = None

    @property
    def kind(self) -> str:
        """Of the vehicle."""
        return self.vehicle.vehicle.kind if isinstance(self.vehicle, Moving) else self.vehicle


def load_flight(source: MotionSource) -> Source:
    """Load a flight.

    Parameters
    ----------
    source : MotionSource

    Raises
    ------
    InputError
        No source or several; a file that cannot be used; a source that ends before ``duration_s``.
    """
    found, vehicle = _glided(source), source.vehicle
    if isinstance(vehicle, Moving):
        return replace(found, flight=replace(found.flight, path=vehicle.on(found.flight.path)))
    return found


def _glided(asked: MotionSource) -> Source:
    """A flight whose body follows its path, at least as long as asked for."""
    duration_s = asked.duration_s
    if asked.builtin == "static" and duration_s is not None:
        return Source(static(duration_s))
    source = _load(asked)
    length = source.flight.path.end - source.flight.path.start
    if duration_s is not None and duration_s > length + 1e-6:
        if asked.builtin is not None:
            return Source(repeated(source.flight, duration_s))
        name = next(str(p) for p in (asked.waypoints, asked.track, asked.motion) if p is not None)
        raise InputError(
            f"the motion ends after {length:g} s, but a duration of {duration_s:g} s is asked for", where=name
        )
    return source


def _load(asked: MotionSource) -> Source:
    builtin, waypoints, track, motion = asked.builtin, asked.waypoints, asked.track, asked.motion
    vehicle, jerk = asked.kind, asked.vehicle.vehicle.jerk if isinstance(asked.vehicle, Moving) else None
    given = {"builtin": builtin, "waypoints": waypoints, "track": track, "motion": motion}
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        found = " and ".join(f"'{name}'" for name in named) or "none"
        raise InputError(f"one source of motion is needed (builtin, waypoints, track or motion), found {found}")
    if builtin is not None:
        return Source(built_in(builtin))
    if waypoints is not None:
        made = route(read_waypoints(waypoints, asked.speed), vehicle)
        return Source(made.flight, made.warnings)
    if motion is not None:
        flight = read_motion(motion)
        return Source(flight, odd_places(str(motion), flight.path.origin[None], vehicle_of(flight.vehicle)))
    assert track is not None
    recorded = read_track(track)  # its clock may count from 1970; a flight's begins with it
    smoothed = smooth_track(
        replace(recorded, t=recorded.t - recorded.t[0]), vehicle, jerk=jerk, max_gap_s=asked.max_gap_s
    )
    path = smoothed.path
    flight = Flight(path, vehicle, (Leg("track", path.start, path.end, False),))
    return Source(flight, smoothed.warnings, smoothed)


_COLUMNS = {
    "t": ("t", "time"),
    "lat": ("lat", "latitude"),
    "lon": ("lon", "lng", "longitude"),
    "height": ("height", "alt", "altitude", "h", "ele"),
    "vn": ("vn", "vel_n", "v_north"),
    "ve": ("ve", "vel_e", "v_east"),
    "vd": ("vd", "vel_d", "v_down"),
    "roll": ("roll",),
    "pitch": ("pitch",),
    "heading": ("heading", "yaw"),
}
_UNIT = {"t": "s", "lat": "rad", "lon": "rad", "height": "m", "vn": "m/s", "ve": "m/s", "vd": "m/s"} | {
    name: "rad" for name in ("roll", "pitch", "heading")
}
_ASSUMED = {"t": "s", "height": "m", "vn": "m/s", "ve": "m/s", "vd": "m/s"} | {
    name: "deg" for name in ("lat", "lon", "roll", "pitch", "heading")
}


#: How much a heading resembles a name of :data:`_COLUMNS` that is misspelt: 'hight' does, 'utc' and 'sats' do not.
_MISSPELT = 0.75


def _of_others(path: Path, names: Mapping[str, str]) -> bool:
    """Whether a table of positions has headings that are not ours, and none that is ours misspelt."""
    if not path.exists() or layout_of(path) != "foreign":
        return False
    header = next((line for line in text_of(path, "track").splitlines() if line.strip() and line[0] != "#"), "")
    words = [split_header(cell)[0].lower() for cell in re.split("[,;\t]", header)]
    other = [w for w in words if w not in names and w.partition("_")[0] not in names]
    return bool(other) and not any(get_close_matches(w, names, n=1, cutoff=_MISSPELT) for w in other if " " not in w)


def read_track(path: str | Path) -> Track:
    """Read a recorded track.

    Parameters
    ----------
    path : path
        Any file that ``insemu open`` reads (GPX, NMEA, a recording): its GNSS fixes, else its reference as a full pose. Or a ``.csv`` with a
        header that names ``t``, ``lat``, ``lon``, ``height`` and optionally ``vn, ve, vd`` and ``roll, pitch,
        heading``, units in brackets (``height [ft]``). A table with other names is read as ``insemu open`` does.

    Raises
    ------
    InputError
        With file and line.
    """
    path = Path(path)
    names = {alias: key for key, aliases in _COLUMNS.items() for alias in aliases}
    if path.suffix.lower() != ".csv" or _of_others(path, names):
        # fixes need no IMU next to them: GPX, NMEA, a receiver's .pos
        found = opened(path) if path.exists() and layout_of(path) == "foreign" else read_recording(path)
        if found.gnss is not None:
            return Track.of(found.gnss, path.stem)
        if found.reference is not None:
            return Track.of(found.reference, path.stem)
        raise InputError("holds neither GNSS fixes nor a reference, so it has no track", where=str(path))
    required = ("t", "lat", "lon", "height")
    rest = tuple(key for key in _COLUMNS if key not in required)
    data, lines = read_columns(text_of(path, "track"), str(path), names, _UNIT, _ASSUMED, required, rest)
    for n in map(int, np.flatnonzero(np.diff(data["t"]) <= 0)):
        before, after = data["t"][n : n + 2]
        what = "repeats" if after == before else "goes back"
        raise InputError(f"the time {what} ({before:.6g} s then {after:.6g} s)", where=f"{path}:{lines[n + 1]}")

    def block(keys: tuple[str, ...]) -> Array | None:
        return np.column_stack([data[key] for key in keys]) if all(key in data for key in keys) else None

    llh = block(("lat", "lon", "height"))
    assert llh is not None
    return Track(data["t"], llh, block(("vn", "ve", "vd")), block(("roll", "pitch", "heading")), name=f"{path}")
