"""Trajectories as other programs take them: TUM, KML, GPX, RTKLIB ``.pos``, CSV."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.formats.clocks import GPS_EPOCH, WEEK, leap_seconds, utc_of
from insemu.formats.filled import filled
from insemu.formats.text import write_table
from insemu.records import GnssRecord, Trajectory
from insemu.stamps import OWN, Origin
from insemu.whole import put

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Way:
    """A track to be written.

    Parameters
    ----------
    t : (n,) array
        s from the origin; where that tells no date, formats with dates take them as s since 1970 (UTC).
    llh : (n, 3) array
        rad, rad, m.
    velocity, rpy, sigma : (n, 3) arrays, optional
        North, east, down in m/s; rad; standard deviations of the position in m.
    name : str
    outages : sequence of (start, end)
        In the time of ``t``; drawn in another colour where the format has colours.
    origin : Origin
        When time 0 was.
    """

    t: Array
    llh: Array
    velocity: Array | None = None
    rpy: Array | None = None
    sigma: Array | None = None
    name: str = "track"
    outages: Sequence[tuple[float, float]] = ()
    origin: Origin = OWN

    @property
    def utc(self) -> Array:
        """Times in s since 1970 (UTC)."""
        return self.t + (utc_of(self.origin) or 0.0)


def way_of(
    data: GnssRecord | Trajectory, name: str, outages: Sequence[tuple[float, float]] = (), origin: Origin = OWN
) -> Way:
    """The track of fixes or of a reference.

    Parameters
    ----------
    data : GnssRecord or Trajectory
        Fixes without a position are left out.
    name : str
        Of the track.
    outages : sequence of (start, end)
        In the time of ``data``, s.
    origin : Origin
        When time 0 of the data was.
    """
    if isinstance(data, Trajectory):
        return Way(data.t, data.llh, data.vel_ned, data.rpy, None, name, outages, origin)
    good = np.isfinite(data.llh).all(axis=1)

    def cut(values: Array | None) -> Array | None:
        return None if values is None else values[good]

    return Way(data.t[good], data.llh[good], cut(data.vel_ned), None, cut(data.pos_std_ned), name, outages, origin)


def _tum(way: Way, path: Path) -> None:
    """Local east-north-up about the first position, body forward-left-up; standard deviations in ``NAME.cov.csv`` next to it."""
    if way.rpy is None:
        raise InputError("has no attitude, which a TUM trajectory needs", where=str(path))
    ned = earth.llh_to_ned(way.llh, way.llh[0])
    swap, body = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.diag([1.0, -1.0, -1.0])
    q = rotation.quaternion_from_dcm(swap @ rotation.dcm_from_rpy(way.rpy) @ body)
    block = np.column_stack([way.t, ned[:, [1, 0, 2]] * [1.0, 1.0, -1.0], q[:, [1, 2, 3, 0]]])
    lat, lon, h = _degrees(way.llh[0])
    head = f"# timestamp tx ty tz qx qy qz qw; origin={lat:.12g} {lon:.12g} {h:.12g}\n"
    put(path, head + "\n".join(" ".join(f"{v:.12g}" for v in row) for row in block) + "\n")
    if way.sigma is not None:
        cov = way.sigma[:, [1, 0, 2]] ** 2
        write_table(
            path.with_suffix(".cov.csv"),
            ["t [s]", "cov_ee [m^2]", "cov_nn [m^2]", "cov_uu [m^2]"],
            np.column_stack([way.t, cov]),
        )


def _stamps(way: Way, path: Path) -> list[str]:
    if not 1.0e8 < float(way.utc[0]) < 4.2e9:
        raise InputError(f"times begin at {way.utc[0]:g} s, expected seconds since 1970 (UTC)", where=str(path))
    return [datetime.fromtimestamp(round(float(t), 6), UTC).isoformat().replace("+00:00", "Z") for t in way.utc]


def _gpx(way: Way, path: Path) -> None:
    points = [(*p, t) for p, t in zip(_degrees(way.llh), _stamps(way, path), strict=True)]
    put(path, filled("track.gpx", name=escape(way.name), points=points))


def _kml(way: Way, path: Path) -> None:
    """The whole track with times, and every outage as a red line over it."""
    outages = [_places(way.llh[(way.t >= start) & (way.t <= end)]) for start, end in way.outages]
    stamps = _stamps(way, path)
    put(path, filled("track.kml", name=escape(way.name), stamps=stamps, degrees=_degrees(way.llh), outages=outages))


#: Colours of ways in an overlay (red, green, blue): the reference white, designs as in the charts.
_OVERLAY = ("FFFFFF", "0072B2", "D55E00", "009E73", "CC79A7", "56B4E9", "E69F00", "4D4D4D", "8C564B")
#: Corners of an ellipse.
_CORNERS = 48


def write_overlay(ways: Sequence[Way], path: Path) -> Path:
    """Write several ways as one KML overlay: a folder each in its own colour, outages thick, the stated 3-sigma ellipse at the end of each.

    Parameters
    ----------
    ways : sequence of Way
        The reference first. Times need be no dates; ``sigma`` draws the ellipses (axes north and east).
    path : Path
        With the suffix ``.kml``.
    """
    if path.suffix.lower() != ".kml":
        raise InputError(f"cannot write '{path.suffix}' overlays, expected .kml", where=str(path))
    shown = []
    for k, way in enumerate(ways):
        red, green, blue = re.findall("..", _OVERLAY[k % len(_OVERLAY)])
        outages = []
        for n, (start, end) in enumerate(way.outages, start=1):
            inside = np.flatnonzero((way.t >= start) & (way.t <= end))
            if inside.size >= 2:
                outages.append((n, _places(way.llh[inside]), _ellipse(way, inside[-1])))
        about = {"name": escape(way.name), "places": _places(way.llh), "outages": outages}
        shown.append({"bgr": blue + green + red, **about})
    put(path, filled("overlay.kml", ways=shown))
    return path


def _ellipse(way: Way, k: int) -> str:
    """The stated 3-sigma ellipse at an epoch; nothing where nothing is stated."""
    if way.sigma is None:
        return ""
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    ring = 3.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]) * way.sigma[k]
    return _places(np.array([earth.ned_to_llh(corner, way.llh[k]) for corner in ring]))


def _degrees(llh: Array) -> Array:
    return np.asarray(llh * [180 / np.pi, 180 / np.pi, 1.0])


def _places(llh: Array) -> str:
    return " ".join(f"{p[1]:.10f},{p[0]:.10f},{p[2]:.4f}" for p in _degrees(llh))


def _pos(way: Way, path: Path) -> None:
    """An RTKLIB solution in GPS week and seconds."""
    _stamps(way, path)
    gps = way.utc - GPS_EPOCH + leap_seconds(float(way.utc[0]))
    week = np.floor(gps / WEEK)
    sigma = way.sigma if way.sigma is not None else np.full((way.t.size, 3), np.nan)
    degrees = _degrees(way.llh)
    velocity = "" if way.velocity is None else "    vn(m/s)    ve(m/s)    vu(m/s)"
    head = "% program   : insemu\n% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp)\n"
    head += "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
    rows = []
    for k in range(way.t.size):
        cells = [
            f"{int(week[k])}",
            f"{gps[k] - WEEK * week[k]:.6f}",
            f"{degrees[k, 0]:.11f}",
            f"{degrees[k, 1]:.11f}",
            f"{degrees[k, 2]:.4f}",
        ]
        cells += ["6", "0", *(f"{s:.4f}" for s in sigma[k]), "0.0", "0.0", "0.0", "0.0", "0.0"]
        if way.velocity is not None:
            cells += [f"{v:.5f}" for v in way.velocity[k] * [1.0, 1.0, -1.0]]
        rows.append("  ".join(cells))
    put(path, "\n".join([head + velocity, *rows]) + "\n")


def _csv(way: Way, path: Path) -> None:
    header = ["t [s]", "lat [deg]", "lon [deg]", "h [m]"]
    blocks = [way.t[:, None], _degrees(way.llh)]
    for values, names, factor in (
        (way.velocity, ("vn [m/s]", "ve [m/s]", "vd [m/s]"), 1.0),
        (way.rpy, ("roll [deg]", "pitch [deg]", "heading [deg]"), 180 / np.pi),
        (way.sigma, ("pos_std_n [m]", "pos_std_e [m]", "pos_std_d [m]"), 1.0),
    ):
        if values is not None:
            header += names
            blocks.append(values * factor)
    write_table(path, header, np.hstack(blocks))


#: Suffix -> writer.
WRITERS: Mapping[str, Callable[[Way, Path], None]] = {
    ".tum": _tum,
    ".txt": _tum,
    ".kml": _kml,
    ".gpx": _gpx,
    ".pos": _pos,
    ".csv": _csv,
}


def write_way(way: Way, path: Path) -> Path:
    """Write a track in the format of the path's suffix.

    Raises
    ------
    InputError
        An unknown suffix; no attitude for TUM; times that are no UTC for formats with dates.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f"cannot write '{path.suffix}' tracks, expected {', '.join(WRITERS)}", where=str(path))
    writer(way, path)
    return path
