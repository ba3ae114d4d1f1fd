"""Static pictures of charts, for papers: one panel for each view."""

from __future__ import annotations

import io
import math
import os
import textwrap
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu.report.charts import Chart, Line, View
from insemu.report.style import OUTAGE, pyplot, style
from insemu.whole import put
from insemu.work import processes, run_items

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.legend import Legend

#: Panels side by side.
ACROSS = 3
#: Resolution of the PNG files, dots per inch.
DPI = 110
#: Line of a legend at most, points: bars are drawn as wide lines.
WIDEST = 6.0
#: Names that a panel has room for; a longer legend stands below all panels.
MOST_INSIDE = 5
#: What fits below a panel.
CHARACTERS = 50
#: What fits into a row of a panel's title, and above bars whose slanted names make the panel narrower.
ROW, SHORT_ROW = 38, 26
#: Part of an axis of bars that is left free for a legend above them.
LEGEND_ROOM = 0.4
#: Part of an axis that is left free for the labels of bars.
ROOM = 0.12
#: Digits and sign of an exponent.
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: Charts from which on processes draw them: one takes a second, a process starts in two where it is not forked.
MANY = 4


def draw(*charts: Chart) -> MplFigure:
    """Charts as one matplotlib figure: one panel for every view that is printed."""
    views = [(chart, v) for chart in charts for v in chart.views if v.printed]
    across = min(ACROSS if len(views) != 4 else 2, len(views))
    down = math.ceil(len(views) / across)
    size = (10.5, 0.6 + 4.2 * down) if across == 1 else (0.8 + 3.9 * across, 0.6 + 2.7 * down)
    with style():
        figure: MplFigure
        figure, panels = pyplot().subplots(down, across, figsize=size, squeeze=False)
        for panel in list(panels.flat)[len(views) :]:
            panel.set_visible(False)
        said: set[tuple[str, str]] = set()
        below: dict[str, Any] = {}
        for panel, (chart, view) in zip(panels.flat, views, strict=False):
            draw_view(panel, chart, view)
            shown = {(line.label, line.colour) for line in view.lines if line.width > 0}
            if not shown <= said and len(shown) > 1:  # a legend wherever something new is shown
                if len(shown) > MOST_INSIDE:
                    handles, labels = panel.get_legend_handles_labels()
                    below |= dict(zip(labels, handles, strict=True))
                else:
                    _thin(panel.legend(loc="upper right" if view.ticks else "best"))
                    if view.ticks and not view.log_y:
                        low, high = panel.get_ylim()
                        panel.set_ylim(low, high + LEGEND_ROOM * (high - low))
            said |= shown
        if below:
            _thin(figure.legend(below.values(), below.keys(), loc="outside lower center", ncols=across + 1))
    return figure


def _thin(legend: Legend) -> None:
    """No line of a legend as wide as a bar."""
    for handle in legend.get_lines():
        handle.set_linewidth(min(handle.get_linewidth(), WIDEST))


def draw_view(axes: Axes, chart: Chart, view: View) -> None:
    """One view on given axes.

    Parameters
    ----------
    axes : matplotlib Axes
    chart : Chart
    view : View
        Of that chart.
    """
    for start, end in chart.spans:
        axes.axvspan(start, end, color=OUTAGE, zorder=0, lw=0)
    for line in view.lines:
        x, y = chart.abscissae(view, line), np.asarray(line.y, dtype=np.float64)
        if line.width > 0:
            axes.plot(
                x, y, label=None if line.of and line.x is not None else line.label, color=line.colour, **_stroke(line)
            )
        if line.fill_to is not None:
            axes.fill_between(x, y, np.asarray(view.lines[line.fill_to].y), color=line.colour, alpha=0.18, lw=0)
    for x0, y0, text in view.labels:
        # above its bar, next to its point
        at = {"xytext": (0, 3), "ha": "center"} if view.ticks else {"xytext": (4, 4)}
        axes.annotate(text, (x0, y0), textcoords="offset points", fontsize=8, **at)
    drawable = any(np.any(np.asarray(line.y, dtype=np.float64) > 0) for line in view.lines)
    if drawable:
        axes.set(xscale="log" if chart.log_x else "linear", yscale="log" if view.log_y else "linear")
        _few_ticks(axes)
    slanted = False
    if view.ticks:  # after the scale, which sets the ticks anew
        slanted = _named_ticks(axes, view.ticks)
        if view.labels and not view.log_y:
            axes.margins(y=ROOM)
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=chart.x_label, ylabel=view.y_label)
    axes.get_yticklabels()  # which finds their common factor
    title = textwrap.fill(view.name, SHORT_ROW if slanted else ROW, break_on_hyphens=False)
    # to look for a free place above the axes takes a quarter of a drawing, and only the factor of the labels stands there
    axes.set_title(title, y=None if axes.yaxis.get_major_formatter().get_offset() else 1.0, va="bottom")


def _few_ticks(axes: Axes) -> None:
    """Decades alone on a logarithmic axis of two or more, which say enough, as plain text: other ticks and formulas are most of a drawing's time."""
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log" and high >= 100.0 * low > 0.0:
            from matplotlib.ticker import FuncFormatter, NullLocator

            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(FuncFormatter(_power_of_ten))


def _power_of_ten(value: float, place: int | None = None) -> str:
    """A decade as text; nothing for other numbers."""
    decade = math.log10(value)
    return "10" + f"{decade:.0f}".translate(RAISED) if abs(decade - round(decade)) < 1e-6 else ""


def _named_ticks(axes: Axes, ticks: Sequence[tuple[float, str]]) -> bool:
    """Names below the x axis, slanted where they would not stand side by side; whether they are."""
    names = [text for _, text in ticks]
    slanted = len(names) * max(len(row) for text in names for row in text.split("\n")) > CHARACTERS
    axes.set_xticks([x for x, _ in ticks], [n.replace("\n", " ") for n in names] if slanted else names)
    if slanted:
        pyplot().setp(axes.get_xticklabels(), rotation=25, ha="right", rotation_mode="anchor")
    axes.margins(x=0.5 / len(ticks))  # half a bar
    axes.grid(axis="x", visible=False)
    return slanted


def _stroke(line: Line) -> dict[str, Any]:
    if line.points:
        return {"ls": "none", "marker": "o", "ms": 2.0 + 0.6 * line.width, "mew": 0}
    return {"ls": "--" if line.dashed else "-", "lw": 0.9 * line.width, "solid_capstyle": "butt"}


def save(charts: Iterable[Chart], folder: Path, *, prefix: str = "") -> list[Path]:
    """Write every chart as PNG and as SVG, called after its name; many are drawn by processes side by side.

    Parameters
    ----------
    charts : iterable of Chart
    folder : path
        Made where it does not exist.
    prefix : str
        What the names of the files begin with.

    Returns
    -------
    list of Path
    """
    folder.mkdir(parents=True, exist_ok=True)
    items = {f"{prefix}{chart.stem}": chart for chart in charts}
    # a process that is made while threads run may wait for ever for what they hold
    alone = threading.active_count() == 1
    with processes(min(os.cpu_count() or 1, len(items)) if alone and len(items) >= MANY else 1) as pool:
        drawn = run_items(items, pictures, pool=pool)
    out = []
    for name, contents in drawn.items():
        for kind, content in contents.items():
            out.append(folder / f"{name}.{kind}")
            put(out[-1], content)
    return out


def pictures(chart: Chart) -> dict[str, bytes]:
    """A chart as the contents of its PNG and of its SVG file."""
    figure = draw(chart)
    out = {}
    with style():
        figure.set_dpi(DPI)
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
        with pyplot().rc_context({"figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)  # else every picture would be drawn twice, to be laid out again
        for kind in ("png", "svg"):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
            out[kind] = buffer.getvalue()
    pyplot().close(figure)
    return out
