"""Charts that a reader can hover, zoom and switch, drawn in the browser by uPlot from the numbers in the page."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

#: Significant digits of the numbers in a page: a screen shows less.
DIGITS = 4


@dataclass(frozen=True)
class Line:
    """One line of a chart.

    Parameters
    ----------
    label : str
        What the legend says; lines of one label are switched together in all charts of a group.
    y : (n,) array
        Values, NaN where there is none.
    colour : str
        ``#rrggbb``.
    dashed, points : bool
        Dashed instead of solid; dots instead of a line.
    width : float
        Of the line, pixels.
    fill_to : int, optional
        Index of the line of the view up to which the space is filled.
    of : str
        Label of the line that this one belongs to, and with which it is switched: a bound of an error.
    """

    label: str
    y: ArrayLike
    colour: str
    dashed: bool = False
    points: bool = False
    width: float = 1.6
    fill_to: int | None = None
    of: str = ""

    def to_json(self) -> dict[str, Any]:
        """As the script reads it."""
        return {
            "label": self.label,
            "y": _numbers(self.y),
            "colour": self.colour,
            "dash": self.dashed,
            "points": self.points,
            "width": self.width,
            "fill_to": self.fill_to,
            "of": self.of,
        }


@dataclass(frozen=True)
class View:
    """What a chart shows at a time: lines over the common x.

    Parameters
    ----------
    name : str
        What the switch calls it.
    y_label : str
        Quantity with its unit.
    lines : sequence of Line
    log_y : bool
    """

    name: str
    y_label: str
    lines: Sequence[Line]
    log_y: bool = False


@dataclass(frozen=True)
class Chart:
    """An interactive figure; readers without scripts see the picture.

    Parameters
    ----------
    name : str
        Of the figure.
    caption : str
        Also for readers who cannot see it.
    x : (n,) array
        Increasing.
    x_label : str
        Quantity with its unit.
    views : sequence of View
        One, or several that a switch chooses from.
    spans : sequence of (from, to)
        Shaded behind the lines: outages.
    log_x : bool
    group : str
        Charts of one group share cursor, zoom and switched-off lines.
    png : bytes
        The static picture.
    """

    name: str
    caption: str
    x: ArrayLike
    x_label: str
    views: Sequence[View]
    spans: Sequence[tuple[float, float]] = ()
    log_x: bool = False
    group: str = "time"
    png: bytes = field(default=b"", repr=False)

    def to_json(self) -> str:
        """The chart as JSON that may stand inside a page: it closes no tag and holds no NaN."""
        views = [
            {"name": v.name, "y_label": v.y_label, "log_y": v.log_y, "series": [line.to_json() for line in v.lines]}
            for v in self.views
        ]
        plain = {
            "name": self.name,
            "caption": self.caption,
            "x": _numbers(self.x, 7),
            "x_label": self.x_label,
            "views": views,
            "spans": [[float(a), float(b)] for a, b in self.spans],
            "log_x": self.log_x,
            "group": self.group,
        }
        text = json.dumps(plain, separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _numbers(values: ArrayLike, digits: int = DIGITS) -> list[float | None]:
    """Numbers to so many significant digits; None where one is not finite."""
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in np.asarray(values, dtype=float).tolist()]


@cache
def script() -> str:
    """The scripts of a page with charts."""
    assets = files("insemu.report") / "assets"
    return "".join((assets / name).read_text(encoding="utf-8") + "\n" for name in ("uPlot.iife.min.js", "charts.js"))


@cache
def stylesheet() -> str:
    """The style that uPlot needs."""
    return (files("insemu.report") / "assets" / "uPlot.min.css").read_text(encoding="utf-8")


@cache
def script_hash() -> str:
    """What the content-security policy of a page says of :func:`script`: this and no other script runs."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script().encode("utf-8")).digest()).decode("ascii")
