"""The page and the picture of a flight or of a smoothed track, and of its dead reckoning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.errors import InputError
from insemu.report.charts import GREY, INK, RED, Chart, Line, View
from insemu.report.page import Block, Card, Folded, Items, Page, Section, Table, Text
from insemu.report.style import COLOURS

if TYPE_CHECKING:
    from insemu.emulate import DeadReckoning, Flight, SmoothedTrack

Array = NDArray[np.float64]

#: Epochs of a path, and fixes, that a chart shows at most.
MOST_EPOCHS = 1500
#: Share of the largest error below which one is not shown on the logarithmic axis.
SEEN = 1e-5


def _thin(n: int) -> slice:
    return slice(None, None, -(-n // MOST_EPOCHS) or 1)


def track_charts(flight: Flight, track: SmoothedTrack | None = None, length_s: float = np.inf) -> list[Chart]:
    """Way seen from above with the outages; speed, height and turn rate; residuals of the fixes where there are any.

    Parameters
    ----------
    flight : Flight
        The path with its outages.
    track : SmoothedTrack, optional
        The recorded track that the path was made from.
    length_s : float
        How much of it is flown.
    """
    from insemu.emulate import turn_rate

    path = flight.path
    end = min(path.end, path.start + length_s)
    t = np.linspace(path.start, end, int(min(MOST_EPOCHS, max(400, (end - path.start) * 10))))
    k = path.kinematics(t)
    ned = earth.llh_to_ned(k.llh, k.llh[0])

    def way(label: str, at: Array, when: Array, colour: str, width: float, points: bool = False) -> Line:
        return Line(label, at[:, 0], colour, points=points, width=width, x=at[:, 1], t=when)

    lines = [way("path", ned, t, COLOURS[0], 1.4)]
    for n, (start, duration) in enumerate(flight.outages):
        inside = (t >= start) & (t <= start + duration)
        lines.append(way(f"GNSS outage {n + 1}", ned[inside], t[inside], RED, 3.5))
    if track is not None:
        fixes, far = earth.llh_to_ned(track.track.llh, k.llh[0]), track.weight < 1.0
        some = _thin(len(fixes))
        lines.insert(0, way("fixes", fixes[some], track.track.t[some], GREY, 1.0, points=True))
        if far.any():
            lines.append(way("fixes with less weight", fixes[far], track.track.t[far], RED, 4.0, points=True))
    view = View("Way", "north of the start (m)", lines, labels=[(0.0, 0.0, "start")])
    spans = [(start, start + duration) for start, duration in flight.outages]
    motion = {
        "Speed": ("speed (m/s)", np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])),
        "Height": ("height (m)", k.llh[:, 2]),
        "Turn rate": ("turn rate (deg/s)", np.rad2deg(turn_rate(path, t))),
    }
    views = [View(name, label, [Line(name.lower(), y, COLOURS[0])]) for name, (label, y) in motion.items()]
    out = [
        Chart(
            "Way",
            "The path seen from above; spans without GNSS in red.",
            None,
            "east of the start (m)",
            [view],
            equal=True,
        ),
        Chart(
            "Motion", "Speed, height and turn rate over time; spans without GNSS are grey.", t, "time (s)", views, spans
        ),
    ]
    if track is not None:
        some = _thin(len(track.track.t))
        left = 100 * track.residual_ned[some]
        dots = [
            Line(n, left[:, a], COLOURS[a], points=True, width=1.0) for a, n in enumerate(("north", "east", "down"))
        ]
        caption = "Fixes minus the path."
        out.append(
            Chart(
                "Residuals", caption, track.track.t[some], "time (s)", [View("Fixes", "fix - path (cm)", dots)], spans
            )
        )
    return out


_PAGES = (".html", ".htm")
_PICTURES = (".png", ".pdf", ".svg")


def check_figure(figure: str, page: str) -> None:
    """Raise ``InputError`` for files that :func:`draw_track` cannot write, before anything is computed; nothing is checked of an empty name."""
    for file, expected in ((figure, _PICTURES), (page, _PAGES)):
        suffix = Path(file).suffix.lower()
        if file and suffix not in expected:
            raise InputError(f"found the suffix '{suffix}', expected {', '.join(expected)}", where=file)


def draw_track(
    flight: Flight,
    file: str | Path,
    *,
    track: SmoothedTrack | None = None,
    source: str = "",
    length_s: float = np.inf,
    outages: Sequence[tuple[float, float]] | None = None,
) -> Path:
    """Write :func:`track_charts` to a PNG, PDF or SVG file, or a page with them to an HTML file.

    Parameters
    ----------
    flight : Flight
    file : path
    track : SmoothedTrack, optional
        The recorded track that the path was made from.
    source : str
        The scenario's file.
    length_s : float
        How much of the flight is flown.
    outages : sequence of (start_s, duration_s), optional
        In place of those that belong to the flight.
    """
    flight = flight if outages is None else replace(flight, outages=tuple(outages))
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() in _PAGES:
        return _page(flight, path, track, source, length_s)
    from insemu.report.static import DPI, draw

    draw(*track_charts(flight, track, length_s)).savefig(path, dpi=DPI)
    return path


def _page(flight: Flight, path: Path, track: SmoothedTrack | None, source: str, length_s: float) -> Path:
    from insemu.emulate import held_out_distance, turn_rate

    motion = flight.path
    seconds = min(motion.duration, length_s)
    t = np.arange(motion.start, motion.start + seconds, 0.1)
    k = motion.kinematics(t)
    speed = np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])
    length = float(np.trapezoid(np.linalg.norm(k.vel_ned, axis=1), t)) / 1000.0
    rows = [
        ["duration", f"{seconds:.1f}", "s"],
        ["length", f"{length:.2f}", "km"],
        ["largest speed", f"{speed.max():.1f}", "m/s"],
        ["largest turn rate", f"{np.rad2deg(np.abs(turn_rate(motion, t)).max()):.1f}", "deg/s"],
        ["largest acceleration", f"{np.linalg.norm(k.acc_ned, axis=1).max():.2f}", "m/s^2"],
        ["heights", f"{k.llh[:, 2].min():.0f} to {k.llh[:, 2].max():.0f}", "m"],
    ]
    blocks: list[Block] = [*track_charts(flight, track, length_s)]
    vehicle = flight.vehicle.replace("_", " ")
    outages = f"{len(flight.outages)} GNSS outage{'s' * (len(flight.outages) != 1)}"
    fastest = f"at most {speed.max():.1f} m/s"
    answer = f"A {vehicle} moves {length:.2f} km in {seconds:.0f} s, {fastest}, with {outages}."
    cards = []
    if track is not None:
        residual = 100 * track.residual_ned
        distance = 100 * held_out_distance(track.track, flight.vehicle)
        each = ", ".join(f"{x:.2f}" for x in np.sqrt((residual**2).mean(axis=0)))
        rows += [
            ["fixes", f"{len(residual)}", ""],
            ["fixes with less weight", f"{int((track.weight < 1).sum())}", ""],
            ["residual, rms north, east, down", each, "cm"],
            ["a third left out: median distance from the path of the rest", f"{np.median(distance):.2f}", "cm"],
            ["a third left out: 95 % are within", f"{np.percentile(distance, 95):.2f}", "cm"],
        ]
        notes = ["The path is the smooth curve through its fixes that a vehicle of this kind most probably took."]
        odd = f"{len(track.warnings)} oddities" if track.warnings else "Nothing odd"
        worth = f"{np.median(distance):.2f} cm"
        cards = [Card("Fixes left out, median distance", worth, odd, "warn" if track.warnings else "good", notes)]
        if track.warnings:
            blocks += [Text("What looks odd:"), Items(track.warnings)]
    sections = [Section("Motion", [*blocks, Folded("Figures", [Table(["", "value", "unit"], rows)])])]
    name = Path(flight.name).name
    return Page(
        f"Track {name}", sections, kind="emulate", source=source or flight.name, answer=answer, cards=cards
    ).write(path)


def render_reckoning(result: DeadReckoning, path: str | Path) -> Path:
    """Write the page of a dead reckoning.

    Parameters
    ----------
    result : DeadReckoning
    path : path
        HTML file.
    """
    some = _thin(len(result.t))
    labels = (("Position", "position error (m)", 1.0), ("Velocity", "velocity error (m/s)", 1.0))
    views = []
    for k, (name, label, factor) in enumerate((*labels, ("Attitude", "attitude error (deg)", 180.0 / np.pi))):
        values = factor * result.errors[some, k]
        if not np.isfinite(values).any():
            continue
        values[values < SEEN * np.nanmax(values, initial=0.0)] = np.nan  # the start is exact
        views.append(View(name, label, [Line(name.lower(), values, INK)], log_y=True))
    caption = f"Errors of the IMU navigated alone, against the {result.against} (norms of the three components)."
    chart = Chart("Dead reckoning", caption, result.t[some], "time (s)", views)
    seconds = result.end_s - result.start_s
    rows = [
        [key.replace("_m_s", "_m/s").replace("_", " "), f"{v:.6g}" if isinstance(v, float) else str(v)]
        for key, v in result.to_dict().items()
        if key != "said"
    ]
    done = [Section("What was assumed and done", [Items(list(result.said))])] if result.said else []
    cards = [
        Card(
            "Largest position error",
            f"{result.max_position_error_m:.3g} m",
            f"{result.final_position_error_m:.3g} m at the end",
        ),
        Card("Largest velocity error", f"{result.max_velocity_error_m_s:.3g} m/s", f"{result.epochs} epochs"),
        Card(
            "Largest attitude error",
            f"{np.rad2deg(result.max_attitude_error_rad):.3g} deg",
            f"gravity {result.gravity}",
        ),
    ]
    return Page(
        f"Dead reckoning of {Path(result.source).name}",
        [Section("Error growth", [chart, Folded("Figures", [Table(("figure", "value"), rows)])]), *done],
        kind="dead-reckon",
        source=result.source,
        answer=f"Without any fix the position is {result.final_position_error_m:.3g} m off after {seconds:.4g} s.",
        cards=[card for card in cards if not card.value.startswith("nan")],
    ).write(path)
