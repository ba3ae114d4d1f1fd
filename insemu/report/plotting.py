"""The chart of any result on given axes, for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu.errors import InputError, nearest
from insemu.evaluate import Results
from insemu.fit import FitResult, Ranking
from insemu.gap import GapReport
from insemu.report.characterise_charts import allan_chart
from insemu.report.charts import Chart
from insemu.report.experiment_charts import error_chart
from insemu.report.fit import decomposition
from insemu.report.gap import gap_charts
from insemu.report.solve import charts_over_time
from insemu.report.static import draw, draw_view
from insemu.report.style import style
from insemu.solve import Solution
from insemu.variance import AxisReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def chart_of(result: Any) -> Chart:
    """The chart that a page shows first of a result.

    Raises
    ------
    InputError
        Nothing that has a chart.
    """
    if isinstance(result, Results):
        return error_chart(result)
    if isinstance(result, GapReport) and (charts := gap_charts(result)):
        return charts[0]
    if isinstance(result, Solution):
        return charts_over_time(result)[0]
    members = {"": result} if not isinstance(result, Mapping) else dict(result)
    found = {name: r.fit if isinstance(r, Ranking) else r for name, r in members.items()}
    fits = {name or r.name: r for name, r in found.items() if isinstance(r, FitResult)}
    if fits and all(r.curve is not None for r in fits.values()):
        return decomposition(fits, np.random.default_rng(0))
    axes = [a for a in members.values() if isinstance(a, AxisReport)]
    if axes:
        return allan_chart(axes)
    raise InputError(
        f"found {type(result).__name__}, expected a fit with its curve, a report of axes, a run, a gap or a solution"
    )


def plot(result: Any, axes: Axes | None = None, *, view: int | str = 0) -> Axes | Figure:
    """Draw the chart that a page shows of a result.

    Parameters
    ----------
    result : FitResult, Ranking, AxisReport, Results, GapReport, Solution, or a mapping of axis to them
    axes : matplotlib Axes, optional
        None makes a figure with every view of the chart.
    view : int or str
        Which view is drawn on given axes, by number or name.

    Returns
    -------
    matplotlib Axes, or the Figure where none were given

    Raises
    ------
    InputError
        Nothing that has a chart, or no such view.
    """
    chart = chart_of(result)
    if axes is None:
        return draw(chart)
    named = {v.name: v for v in chart.views}
    if isinstance(view, str) and view not in named:
        raise InputError(f"no view '{view}'" + nearest(view, named))
    if isinstance(view, int) and not 0 <= view < len(chart.views):
        raise InputError(f"view is {view}, expected a number below {len(chart.views)}")
    with style():
        draw_view(axes, chart, named[view] if isinstance(view, str) else chart.views[view])
    return axes
