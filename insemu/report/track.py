"""A figure of a flight or of a smoothed track: the way, speed, turn rate and what is left of the fixes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu import earth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from insemu.emulate.flight import Flight
    from insemu.emulate.track import SmoothedTrack

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

    from insemu.emulate.track import turn_rate

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


def draw_track(flight: Flight, file: str | Path, *, track: SmoothedTrack | None = None) -> Path:
    """Write :func:`track_figure` to a PNG, PDF or SVG file."""
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    track_figure(flight, track).savefig(path, dpi=110)
    return path
