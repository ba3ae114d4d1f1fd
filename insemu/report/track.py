"""A figure of a flight or of a smoothed track: the way, speed, turn rate and what is left of the fixes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu import earth
from insemu.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from insemu.emulate import Flight, SmoothedTrack

_BLUE, _RED, _GREY = "#1f5fa8", "#c0392b", "#7f8c8d"


def track_figure(flight: Flight, track: SmoothedTrack | None = None) -> Figure:
    """Way seen from above with the outages, speed, height, turn rate with bank, and residuals of the fixes where
    there are any.

    Parameters
    ----------
    flight : Flight
        The path with its outages.
    track : SmoothedTrack, optional
        The recorded track that the path was made from.
    """
    from matplotlib.figure import Figure

    from insemu.emulate import turn_rate

    path = flight.path
    t = np.linspace(path.start, path.end, int(min(6000, max(400, path.duration * 10))))
    k = path.kinematics(t)
    ned = earth.llh_to_ned(k.llh, k.llh[0])
    rows = 4 if track is not None else 3
    figure = Figure(figsize=(11, 2.1 * rows + 0.8), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.1, 1.0))
    way = figure.add_subplot(grid[:, 0])
    if track is not None:
        fixes = earth.llh_to_ned(track.track.llh, k.llh[0])
        way.plot(fixes[:, 1], fixes[:, 0], ".", color=_GREY, ms=3, label="fixes")
        far = track.weight < 1.0
        if far.any():
            way.plot(fixes[far, 1], fixes[far, 0], "x", color=_RED, ms=6, label="fixes with less weight")
    way.plot(ned[:, 1], ned[:, 0], color=_BLUE, lw=1.2, label="path")
    for n, (start, duration) in enumerate(flight.outages):
        inside = (t >= start) & (t <= start + duration)
        way.plot(ned[inside, 1], ned[inside, 0], color=_RED, lw=3, label="GNSS outage" if n == 0 else None)
    way.plot(ned[0, 1], ned[0, 0], "o", color="black", ms=5, label="start")
    way.set_aspect("equal", adjustable="datalim")
    way.set_xlabel("east of the start, m")
    way.set_ylabel("north of the start, m")
    way.set_title(f"{Path(flight.name).name}: {path.duration:.0f} s, {_length(k.vel_ned, t):.1f} km")
    way.legend(loc="best", frameon=False)
    way.grid(alpha=0.3)

    speed = np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])
    panels = [
        ("speed, m/s", [(speed, _BLUE, None)]),
        ("height, m", [(k.llh[:, 2], _BLUE, None)]),
        (
            "turn rate, deg/s",
            [(np.rad2deg(turn_rate(path, t)), _BLUE, None)],
        ),
    ]
    axes: list[Any] = []
    for row, (label, lines) in enumerate(panels):
        ax = figure.add_subplot(grid[row, 1], sharex=axes[0] if axes else None)
        for values, color, name in lines:
            ax.plot(t, values, color=color, lw=1.0, label=name)
        for start, duration in flight.outages:
            ax.axvspan(start, start + duration, color=_RED, alpha=0.15, lw=0)
        low, high = ax.get_ylim()
        if high - low < 1.0:  # nothing happens: do not blow up rounding
            ax.set_ylim(0.5 * (low + high) - 0.5, 0.5 * (low + high) + 0.5)
        ax.ticklabel_format(axis="y", useOffset=False)
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
        axes.append(ax)
    if track is not None:
        ax = figure.add_subplot(grid[3, 1], sharex=axes[0])
        for axis, (name, color) in enumerate((("north", _BLUE), ("east", _RED), ("down", _GREY))):
            ax.plot(track.track.t, 100 * track.residual_ned[:, axis], ".", ms=2, color=color, label=name)
        ax.set_ylabel("fix - path, cm")
        ax.legend(loc="upper right", ncols=3, frameon=False, markerscale=3)
        ax.grid(alpha=0.3)
        axes.append(ax)
    axes[-1].set_xlabel("time, s")
    return figure


def _length(vel: np.ndarray, t: np.ndarray) -> float:
    return float(np.trapezoid(np.linalg.norm(vel, axis=1), t)) / 1000.0


_FORMATS = (".png", ".pdf", ".svg", ".html", ".htm")


def check_figure(file: str | Path) -> None:
    """Raise ``InputError`` for a file that :func:`draw_track` cannot write, before anything is computed."""
    suffix = Path(file).suffix.lower()
    if suffix not in _FORMATS:
        raise InputError(f"cannot draw '{suffix}' files, expected {', '.join(_FORMATS)}", where=str(file))


def draw_track(flight: Flight, file: str | Path, *, track: SmoothedTrack | None = None) -> Path:
    """Write :func:`track_figure` to a PNG, PDF or SVG file, or a page with it to an HTML file.

    Parameters
    ----------
    flight : Flight
    file : path
    track : SmoothedTrack, optional
        The recorded track that the path was made from.
    """
    check_figure(file)
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() in (".html", ".htm"):
        return _page(flight, path, track)
    track_figure(flight, track).savefig(path, dpi=110)
    return path


def _page(flight: Flight, path: Path, track: SmoothedTrack | None) -> Path:
    from insemu.emulate import held_out_distance, turn_rate
    from insemu.report.page import Block, Figure, Items, Section, Table, Text, render

    motion = flight.path
    t = np.arange(motion.start, motion.end, 0.1)
    k = motion.kinematics(t)
    speed = np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])
    rows = [
        ["duration", f"{motion.duration:.1f}", "s"],
        ["length", f"{_length(k.vel_ned, t):.2f}", "km"],
        ["largest speed", f"{speed.max():.1f}", "m/s"],
        ["largest turn rate", f"{np.rad2deg(np.abs(turn_rate(motion, t)).max()):.1f}", "deg/s"],
        ["largest acceleration", f"{np.linalg.norm(k.acc_ned, axis=1).max():.2f}", "m/s^2"],
        ["heights", f"{k.llh[:, 2].min():.0f} to {k.llh[:, 2].max():.0f}", "m"],
    ]
    blocks: list[Block] = []
    lead = f"{Path(flight.name).name}, a {flight.vehicle.replace('_', ' ')}."
    if track is not None:
        residual = 100 * track.residual_ned
        distance = 100 * held_out_distance(track.track, flight.vehicle)
        rows += [
            ["fixes", f"{len(residual)}", ""],
            ["fixes with less weight", f"{int((track.weight < 1).sum())}", ""],
            [
                "residual, rms north, east, down",
                ", ".join(f"{x:.2f}" for x in np.sqrt((residual**2).mean(axis=0))),
                "cm",
            ],
            ["a third left out: median distance from the path of the rest", f"{np.median(distance):.2f}", "cm"],
            ["a third left out: 95 % are within", f"{np.percentile(distance, 95):.2f}", "cm"],
        ]
        lead += " The path is the smooth curve through its fixes that a vehicle of this kind most probably took."
        if track.warnings:
            blocks += [Text("What looks odd:"), Items(track.warnings)]
    caption = "Way seen from above, speed, height and turn rate" + (", and the fixes minus the path" if track else "")
    blocks += [Figure.of(track_figure(flight, track), caption), Table(["", "value", "unit"], rows)]
    return render(f"Track {Path(flight.name).name}", [Section("Motion", blocks)], path, lead=lead)
