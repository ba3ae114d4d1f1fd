"""The interactive charts of an experiment: errors against what the filters state, and NEES, over time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from insemu.evaluate import Results
from insemu.report.charts import Chart, Line, View
from insemu.report.style import COLOURS

Array = NDArray[np.float64]

#: Epochs of a chart at most: about one for each pixel of a wide screen, and a page of moderate size.
MOST_EPOCHS = 1500
#: Colour of bounds and of what belongs to no design.
GREY = "#8A94A0"

_DEG = 180.0 / np.pi


def _horizontal(e: Array) -> Array:
    return np.hypot(e[..., 0], e[..., 1])


def _component(index: int, factor: float = 1.0) -> Callable[[Array], Array]:
    return lambda e: np.abs(e[..., index]) * factor


#: What is shown, with its unit, from errors or standard deviations (..., 9) in state order.
QUANTITIES: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "Planimetric position": ("m", _horizontal),
    "Height": ("m", _component(2)),
    "North velocity": ("m/s", _component(3)),
    "East velocity": ("m/s", _component(4)),
    "Down velocity": ("m/s", _component(5)),
    "Attitude about north": ("deg", _component(6, _DEG)),
    "Attitude about east": ("deg", _component(7, _DEG)),
    "Attitude about down": ("deg", _component(8, _DEG)),
}


def _epochs(results: Results) -> NDArray[np.intp]:
    """Epochs to show: all of them, or every n-th together with the ends of the outages."""
    step = -(-results.t.size // MOST_EPOCHS)
    ends = [results.end_index(k) for k in range(len(results.outages))]
    return np.union1d(np.arange(0, results.t.size, step), np.array(ends, dtype=np.intp))


def _spans(results: Results) -> list[tuple[float, float]]:
    return [(start / 60.0, (start + duration) / 60.0) for start, duration in results.outages]


def error_chart(results: Results, realization: int = 0, png: bytes = b"") -> Chart:
    """Errors of every design and what it states: rms over the realizations, or one realization against its 3-sigma bounds.

    Parameters
    ----------
    results : Results
    realization : int
        Which one is shown on its own.
    png : bytes
        The static picture for readers without scripts.
    """
    at = _epochs(results)
    views = []
    for together in (True, False):
        for name, (unit, of) in QUANTITIES.items():
            lines = []
            for d, design in enumerate(results.names):
                colour = COLOURS[d % len(COLOURS)]
                error, sigma = results.error[d][:, at], results.sigma[d][:, at]
                if together:
                    shown, bound, word = _rms(of(error)), _rms(of(sigma)), "stated sigma"
                else:
                    shown, bound, word = of(error[realization]), 3.0 * of(sigma[realization]), "3 sigma"
                lines += [
                    Line(design, _positive(shown), colour),
                    Line(f"{design}: {word}", _positive(bound), colour, dashed=True, width=1.1, of=design),
                ]
            what = f"{name}, rms error" if together else f"{name}, one realization and its 3-sigma bound"
            views.append(View(what, f"{name} ({unit})", lines, log_y=True))
    return Chart(
        "Errors and what the filters state",
        "Errors of every design (solid) and what it states (dashed). Spans without GNSS are grey. Drag to zoom, double-click to undo; a click on "
        "a name in the legend switches it.",
        results.t[at] / 60.0,
        "time (min)",
        views,
        _spans(results),
        png=png,
    )


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)), dtype=np.float64)


def _positive(values: Array) -> Array:
    """For a logarithmic axis: zero is not shown."""
    return np.where(values > 0.0, values, np.nan)


def nees_chart(results: Results, confidence: float = 0.99, png: bytes = b"") -> Chart:
    """NEES per degree of freedom of the navigation states, mean over realizations, with its chi-square bounds for a single epoch.

    Parameters
    ----------
    results : Results
    confidence : float
        Probability that a consistent filter lies inside the bounds at one epoch.
    png : bytes
        The static picture for readers without scripts.
    """
    at = _epochs(results)
    dof = results.nees_dof * results.realizations
    tail = 0.5 * (1.0 - confidence)
    bounds = (stats.chi2.ppf(tail, dof) / dof, stats.chi2.isf(tail, dof) / dof)
    lines = [
        Line(design, _positive(results.nees[d][:, at].mean(axis=0) / 9.0), COLOURS[d % len(COLOURS)])
        for d, design in enumerate(results.names)
    ]
    lines += [Line(f"{confidence:.0%} bounds", np.full(at.size, b), GREY, dashed=True) for b in bounds]
    return Chart(
        "NEES of the navigation states",
        f"Normalised estimation error squared per degree of freedom, mean over {results.realizations} realizations; 1 is a filter that knows its "
        "error, larger is optimistic.",
        results.t[at] / 60.0,
        "time (min)",
        [View("NEES", "NEES per degree of freedom", lines, log_y=True)],
        _spans(results),
        png=png,
    )
