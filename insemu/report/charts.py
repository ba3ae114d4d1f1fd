"""Charts: described once, drawn by uPlot in the page (hover, zoom, switches) and by matplotlib for paper."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.units import datasheet

#: Significant digits of the numbers in a page: a screen shows less. Points in a plane need more: a map is read to the metre.
DIGITS, PLANE_DIGITS = 4, 6
#: Lines whose values are reported to those who cannot see the chart.
MOST_SAID = 6
#: Colours of what belongs to no design, and of what must be seen.
GREY, INK, RED = "#8A94A0", "#5B6675", "#D00000"


@dataclass(frozen=True)
class Line:
    """One line of a chart.

    Parameters
    ----------
    label : str
        What the legend says; lines of one label are switched together in all charts of a group.
    y : (n,) array
        Values, NaN where there is none (a gap in the line).
    colour : str
        ``#rrggbb``.
    dashed, points : bool
        Dashed instead of solid; dots instead of a line.
    width : float
        Of the line or the dots, pixels.
    fill_to : int, optional
        Index of the line of the view up to which the space is filled.
    of : str
        Label of the line that this one belongs to, and with which it is switched: a bound of an error.
    x : (n,) array, optional
        Of a chart in a plane: abscissae of this line's own.
    t : (n,) array, optional
        Of a chart in a plane: the x of the other charts of the group, which share the cursor.
    text : sequence of str, optional
        Of a chart in a plane: what hovering says at each point.
    """

    label: str
    y: ArrayLike
    colour: str
    dashed: bool = False
    points: bool = False
    width: float = 1.6
    fill_to: int | None = None
    of: str = ""
    x: ArrayLike | None = None
    t: ArrayLike | None = None
    text: Sequence[str] | None = None

    def to_json(self) -> dict[str, Any]:
        """As the script reads it."""
        digits = DIGITS if self.x is None else PLANE_DIGITS
        plain = {
            "label": self.label,
            "y": _numbers(self.y, digits),
            "colour": self.colour,
            "dash": self.dashed,
            "points": self.points,
            "width": self.width,
            "fill_to": self.fill_to,
            "of": self.of,
        }
        for key in ("x", "t"):
            if (values := getattr(self, key)) is not None:
                plain[key] = _numbers(values, digits)
        return plain if self.text is None else {**plain, "text": list(self.text)}


def band(name: str, edges: Iterable[ArrayLike], colour: str, at: int, of: str = "") -> list[Line]:
    """The space between two edges, with one name in the legend.

    Parameters
    ----------
    name, colour : str
    edges : two (n,) arrays
        The lower one and the upper one.
    at : int
        Lines of the view that stand in front of it.
    of : str
        Label of the line that it belongs to.
    """
    low, high = edges
    return [
        Line(name, low, colour, width=0.0, of=of),
        Line(f"{name}, high", high, colour, width=0.0, fill_to=at, of=of or name),
    ]


@dataclass(frozen=True)
class View:
    """What a chart shows at a time.

    Parameters
    ----------
    name : str
        What the switch calls it.
    y_label : str
        Quantity with its unit.
    lines : sequence of Line
    log_y : bool
    ticks : sequence of (x, label)
        Names on the x axis instead of numbers.
    labels : sequence of (x, y, text)
        Words in the chart.
    printed : bool
        Whether the static picture has a panel for it.
    x : (n,) array, optional
        Increasing, where views have abscissae of their own; default the chart's.
    """

    name: str
    y_label: str
    lines: Sequence[Line]
    log_y: bool = False
    ticks: Sequence[tuple[float, str]] = ()
    labels: Sequence[tuple[float, float, str]] = ()
    printed: bool = True
    x: ArrayLike | None = None


@dataclass(frozen=True)
class Chart:
    """An interactive figure.

    Parameters
    ----------
    name : str
        Of the figure; the static pictures next to the page are called after it.
    caption : str
        What is seen, with the finding; also for readers who cannot see it.
    x : (n,) array, optional
        Increasing; none where views have their own, and for a chart in a plane, whose lines have theirs.
    x_label : str
        Quantity with its unit.
    views : sequence of View
        One, or several that a switch chooses from.
    spans : sequence of (from, to)
        Shaded behind the lines: outages.
    log_x : bool
    equal : bool
        One metre is as long in both directions: a map.
    group : str
        Charts of one group share cursor, zoom and switched-off lines.
    """

    name: str
    caption: str
    x: ArrayLike | None
    x_label: str
    views: Sequence[View]
    spans: Sequence[tuple[float, float]] = ()
    log_x: bool = False
    equal: bool = False
    group: str = "time"

    @property
    def stem(self) -> str:
        """Name of the static picture's file, without what says its format."""
        return re.sub(r"[^a-z0-9]+", "_", self.name.lower()).strip("_")

    def abscissae(self, view: View, line: Line) -> NDArray[np.float64]:
        """Where the values of a line of a view stand."""
        own = line.x if line.x is not None else view.x
        return np.asarray(self.x if own is None else own, dtype=np.float64)

    @property
    def said(self) -> str:
        """The values of the first view in words, for readers who cannot see it: the range of every line and where it is largest."""
        view = self.views[0]
        told = []
        for line in view.lines:
            x, y = self.abscissae(view, line), np.asarray(line.y, dtype=np.float64)
            if self.equal or line.of or line.width == 0 or not np.isfinite(y).any():
                continue  # a map; bounds of another line
            at = x[int(np.nanargmax(y))]
            where = next((name.replace("\n", " ") for place, name in view.ticks if abs(place - at) < 0.5), f"{at:.3g}")
            low, high = f"{np.nanmin(y):.3g}", f"{np.nanmax(y):.3g}"
            told.append(f"{line.label} {low}" if low == high else f"{line.label} {low} to {high}, largest at {where}")
        more = f"; and {len(told) - MOST_SAID} more" if len(told) > MOST_SAID else ""
        return f"{view.y_label} over {self.x_label}: {'; '.join(told[:MOST_SAID])}{more}." if told else ""

    def to_json(self) -> str:
        """The chart as JSON that may stand inside a page: it closes no tag and holds no NaN."""
        views = [
            {
                "name": v.name,
                "y_label": v.y_label,
                "log_y": v.log_y,
                "x": None if (x := self.x if v.x is None else v.x) is None else _numbers(x, 7),
                "ticks": [[float(x), text] for x, text in v.ticks],
                "labels": [[float(x), float(y), text] for x, y, text in v.labels],
                "series": [line.to_json() for line in v.lines],
            }
            for v in self.views
        ]
        plain = {
            "name": self.name,
            "caption": self.caption,
            "said": self.said,
            "x_label": self.x_label,
            "views": views,
            "spans": [[float(a), float(b)] for a, b in self.spans],
            "log_x": self.log_x,
            "equal": self.equal,
            "group": self.group,
        }
        return embedded(plain)


@dataclass(frozen=True)
class Ledger:
    """A long table: its numbers stand in the page once, and the page's script draws the rows and charts that are asked for.

    Parameters
    ----------
    header : sequence of str
    rows : sequence of sequence of str
    caption : str
    left : int
        Columns that are aligned left, from the first.
    charts : sequence of Chart
        Each of one view and with an x of its own; what a row draws.
    chart_of : sequence of int
        Which of them belongs to each row.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    left: int = 1
    charts: Sequence[Chart] = ()
    chart_of: Sequence[int] = ()

    def to_json(self) -> str:
        """As the script reads it: what the charts have in common, then the numbers of each."""
        plain: dict[str, Any] = {"header": list(self.header), "left": self.left, "rows": [list(r) for r in self.rows]}
        if self.charts:
            first = json.loads(self.charts[0].to_json())
            first["views"][0] |= {"x": None, "series": [s | {"y": []} for s in first["views"][0]["series"]]}
            each = [
                [
                    c.name,
                    c.spans,
                    _numbers(np.asarray(c.x, dtype=float), 4),
                    *(_numbers(line.y, 3) for line in c.views[0].lines),
                ]
                for c in self.charts
            ]
            plain |= {"chart": first, "charts": each, "of": list(self.chart_of)}
        return embedded(plain)


def familiar(lines: Sequence[Line], unit: str) -> tuple[list[Line], str]:
    """Lines in the unit that datasheets use for an SI unit, and that unit; the file's own where nobody knows it.

    Parameters
    ----------
    lines : sequence of Line
    unit : str
    """
    factor, shown = datasheet(1.0, unit)
    scaled = lines if shown == unit else [replace(line, y=factor * np.asarray(line.y, dtype=float)) for line in lines]
    return list(scaled), shown or "unit of the file"


def embedded(plain: Any) -> str:
    """JSON that may stand inside a page."""
    text = json.dumps(plain, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def positive(values: ArrayLike) -> NDArray[np.float64]:
    """For a logarithmic axis: what is not positive is not shown."""
    array = np.asarray(values, dtype=np.float64)
    return np.where(array > 0.0, array, np.nan)


def strokes(
    at: Sequence[float], ends: Sequence[Sequence[float]], words: Sequence[str]
) -> tuple[list[float], list[float], list[str]]:
    """Upright strokes for a chart in a plane (bars, intervals): x, y and what hovering says.

    Parameters
    ----------
    at : sequence of float
    ends : sequence of (low, high)
    words : sequence of str
    """
    x = [v for p in at for v in (p, p, math.nan)]
    y = [v for low, high in ends for v in (low, high, math.nan)]
    return x, y, [w for word in words for w in (word, word, "")]


def _numbers(values: ArrayLike, digits: int = DIGITS) -> list[float | None]:
    """Numbers to so many significant digits; None where one is not finite."""
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in np.asarray(values, dtype=float).tolist()]


@cache
def asset(*names: str) -> str:
    """Text of files that come with the package."""
    folder = files("insemu.report") / "assets"
    return "".join((folder / name).read_text(encoding="utf-8") + "\n" for name in names)


@cache
def script() -> str:
    """The scripts of a page."""
    return asset("uPlot.iife.min.js", "charts.js")


@cache
def script_hash() -> str:
    """What the content-security policy of a page says of :func:`script`: this and no other script runs."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script().encode("utf-8")).digest()).decode("ascii")
