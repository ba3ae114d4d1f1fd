"""Figures of an experiment: the flight and its outages, error growth per design, errors against their 3-sigma bounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from insemu import earth
from insemu.evaluate import Results, outage_table, within_outage
from insemu.report.style import COLOURS, OUTAGE, style

Array = NDArray[np.float64]


def _plan(results: Results) -> Array:
    """Reference position in metres north and east of the start."""
    return earth.llh_to_ned(results.truth.llh, results.truth.llh[0])


def _shade(axes: Axes, outages: Sequence[tuple[float, float]], scale: float = 60.0) -> None:
    for start, duration in outages:
        axes.axvspan(start / scale, (start + duration) / scale, color=OUTAGE, zorder=0, lw=0)


def flight(results: Results, realization: int = 0) -> Figure:
    """Plan of the flight with its outages, and a close view of the last one with every design's track."""
    plan = _plan(results)
    with style():
        figure, (whole, close) = plt.subplots(1, 2, figsize=(10.5, 4.6), width_ratios=(1.15, 1))
        whole.plot(plan[:, 1] / 1e3, plan[:, 0] / 1e3, color="#6B7683", lw=1.0, label="reference")
        for k, (start, duration) in enumerate(results.outages):
            inside = within_outage(results.t, start, duration)
            whole.plot(
                plan[inside, 1] / 1e3,
                plan[inside, 0] / 1e3,
                color="#D00000",
                lw=3.0,
                label="no GNSS" if k == 0 else None,
            )
            middle = np.flatnonzero(inside)[inside.sum() // 2]
            whole.annotate(
                f"{k + 1}",
                (plan[middle, 1] / 1e3, plan[middle, 0] / 1e3),
                xytext=(5, 5),
                textcoords="offset points",
                fontweight="bold",
                color="#D00000",
            )
        whole.plot(*plan[0, [1, 0]] / 1e3, "o", color="#1c2430", ms=5, label="start")
        whole.set(
            xlabel="east of start (km)",
            ylabel="north of start (km)",
            title="Flight and outages",
            aspect="equal",
            adjustable="datalim",
        )
        whole.legend(loc="best")
        if results.outages:
            start, duration = results.outages[-1]
            inside = within_outage(results.t, start - 10.0, duration + 10.0)
            close.plot(plan[inside, 1], plan[inside, 0], color="#6B7683", lw=3, alpha=0.6, label="reference")
            for d, name in enumerate(results.names):
                e = results.error[d, realization, inside]
                close.plot(
                    plan[inside, 1] + e[:, 1], plan[inside, 0] + e[:, 0], color=COLOURS[d % len(COLOURS)], label=name
                )
            close.set(
                xlabel="east of start (m)",
                ylabel="north of start (m)",
                title=f"Outage {len(results.outages)}, realization {realization}",
                aspect="equal",
                adjustable="datalim",
            )
            close.legend(loc="best")
        return figure


def error_growth(results: Results) -> Figure:
    """Root-mean-square errors over the realizations against time: planimetric, altimetric, north velocity, roll axis."""
    minutes = results.t / 60.0
    panels: tuple[tuple[str, str, Callable[[Array], Array]], ...] = (
        ("Planimetric position", "rms (m)", lambda e: np.hypot(e[..., 0], e[..., 1])),
        ("Altitude", "rms (m)", lambda e: e[..., 2]),
        ("North velocity", "rms (m/s)", lambda e: e[..., 3]),
        ("Attitude about north", "rms (deg)", lambda e: np.rad2deg(e[..., 6])),
    )
    with style():
        figure, grid = plt.subplots(2, 2, figsize=(10.5, 6.4), sharex=True)
        for axes, (title, label, component) in zip(grid.flat, panels, strict=True):
            _shade(axes, results.outages)
            for d, name in enumerate(results.names):
                rms = np.sqrt(np.mean(component(results.error[d]) ** 2, axis=0))
                axes.plot(minutes, np.maximum(rms, 1e-6), color=COLOURS[d % len(COLOURS)], label=name)
                if results.smoothed:
                    rms = np.sqrt(np.mean(component(results["smoothed_error"][d]) ** 2, axis=0))
                    axes.plot(minutes, np.maximum(rms, 1e-6), color=COLOURS[d % len(COLOURS)], ls=":", lw=1.1)
            axes.set(title=title, ylabel=label, yscale="log")
        for axes in grid[1]:
            axes.set_xlabel("time (min); grey: no GNSS" + ("; dotted: smoothed" if results.smoothed else ""))
        grid[0, 0].legend(loc="best")
        return figure


#: Rows of the figure of errors against their bounds: title, unit, factor, components (two: their length).
_BOUNDED: tuple[tuple[str, str, float, tuple[int, ...]], ...] = (
    ("planimetric", "m", 1.0, (0, 1)),
    ("down", "m", 1.0, (2,)),
    ("velocity north", "m/s", 1.0, (3,)),
    ("velocity east", "m/s", 1.0, (4,)),
    ("velocity down", "m/s", 1.0, (5,)),
    ("attitude about north", "deg", 180.0 / np.pi, (6,)),
    ("attitude about east", "deg", 180.0 / np.pi, (7,)),
    ("heading", "deg", 180.0 / np.pi, (8,)),
)


def _row_of(values: Array, components: tuple[int, ...], factor: float) -> Array:
    chosen = values[..., list(components)]
    return factor * (chosen[..., 0] if len(components) == 1 else np.sqrt((chosen**2).sum(axis=-1)))


def against_bounds(results: Results, outage: int = -1, realization: int = 0) -> Figure:
    """Planimetric, down, velocity and attitude errors in one outage against the 3-sigma bounds that the filters state: a column per design.

    Parameters
    ----------
    results : Results
    outage, realization : int
        From 0; -1 is the last outage.
    """
    start, duration = results.outages[outage]
    inside = (results.t >= start - 5.0) & (results.t <= start + duration + 5.0)
    since = results.t[inside] - start
    known = [row for row in _BOUNDED if np.isfinite(results.error[:, :, inside][..., list(row[3])]).any()]
    columns = len(results.names)
    number = outage % len(results.outages) + 1
    with style():
        figure, grid = plt.subplots(
            len(known), columns, figsize=(1.5 + 3.2 * columns, 1.6 * len(known) + 0.7), sharex=True, squeeze=False
        )
        for r, (title, unit, factor, components) in enumerate(known):
            for d, name in enumerate(results.names):
                axes, colour = grid[r, d], COLOURS[d % len(COLOURS)]
                error = _row_of(results.error[d][:, inside], components, factor)
                bound = 3.0 * _row_of(results.sigma[d][:, inside], components, factor)
                low = -bound[realization] if len(components) == 1 else 0.0
                axes.axvspan(0, duration, color=OUTAGE, zorder=0, lw=0)
                axes.fill_between(
                    since, low, bound[realization], color=colour, alpha=0.22, lw=0, label=r"stated $3\sigma$"
                )
                axes.plot(since, error.T, color="#9AA3AD", lw=0.5, alpha=0.7)
                axes.plot(since, error[realization], color=colour, lw=1.8, label=f"realization {realization}")
                outside = f"{np.mean(np.abs(error) > bound):.1%} outside"
                axes.annotate(outside, (0.02, 0.06), xycoords="axes fraction", fontsize=8, color="#1c2430")
                axes.set_title(f"{name}: {title}" if r == 0 else title)
                if d == 0:
                    axes.set_ylabel(unit)
                if (r, d) == (0, 0):
                    axes.legend(loc="upper left")
        for axes in grid[-1]:
            axes.set_xlabel(f"time since outage {number} (s)")
        return figure


def end_errors(results: Results) -> Figure:
    """Planimetric error at outage end: every realization, mean with its 95 % interval, what the filter states, what was published."""
    table = outage_table(results)
    published = results.published.get("planimetric_end_m", {})
    with style():
        figure, axes = plt.subplots(figsize=(10.5, 4.2))
        count = len(results.names)
        for d, name in enumerate(results.names):
            colour = COLOURS[d % len(COLOURS)]
            for k, row in enumerate(table[name]):
                x = k + (d - (count - 1) / 2) * 0.8 / count
                p = row["planimetric_end_m"]
                values = np.array(p["per_realization"])
                spread = (np.arange(values.size) / max(1, values.size - 1) - 0.5) * 0.3 / count
                axes.plot(x + spread, values, ".", color=colour, ms=4, alpha=0.45)
                if p["ci95"][0] is not None:
                    axes.plot([x, x], p["ci95"], color=colour, lw=3)
                axes.plot(x, p["mean"], "o", color=colour, ms=7, label=name if k == 0 else None)
                axes.plot(x, row["predicted_sigma_end_m"], "_", color="#1c2430", ms=13, mew=2)
                printed = published.get(name, ())[k : k + 1]
                axes.plot(
                    [x for p in printed if p is not None],
                    [p for p in printed if p is not None],
                    "x",
                    color="#1c2430",
                    ms=7,
                    mew=1.6,
                )
        axes.plot([], [], "_", color="#1c2430", ms=13, mew=2, ls="none", label="stated sigma")
        if published:
            axes.plot([], [], "x", color="#1c2430", ms=7, mew=1.6, ls="none", label="published")
        axes.set_xticks(
            range(len(results.outages)),
            [f"outage {k + 1}\n{s / 60:g} min, {w:g} s" for k, (s, w) in enumerate(results.outages)],
        )
        axes.set(yscale="log", ylabel="planimetric error at outage end (m)", title="Error at the end of each outage")
        axes.grid(axis="x", visible=False)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        return figure


def smoothing(results: Results, realization: int = 0) -> Figure:
    """North position error of every design in the longest outage, filtered and smoothed, with the 3-sigma bands that they state."""
    k = max(range(len(results.outages)), key=lambda i: results.outages[i][1])
    start, duration = results.outages[k]
    inside = (results.t >= start - 0.1 * duration) & (results.t <= start + 1.1 * duration)
    since = results.t[inside] - start
    rows = len(results.names)
    both = (
        ("filter", results.error, results.sigma),
        ("smoother", results["smoothed_error"], results["smoothed_sigma"]),
    )
    with style():
        figure, grid = plt.subplots(rows, 2, figsize=(10.5, 2.2 * rows + 0.7), sharex=True, squeeze=False)
        for column, (label, error, sigma) in enumerate(both):
            for d, name in enumerate(results.names):
                axes, colour = grid[d, column], COLOURS[d % len(COLOURS)]
                axes.axvspan(0, duration, color=OUTAGE, zorder=0, lw=0)
                band = 3.0 * sigma[d, realization, inside, 0]
                axes.fill_between(since, -band, band, color=colour, alpha=0.22, lw=0, label=r"stated $\pm 3\sigma$")
                axes.plot(since, error[d, :, inside, 0], color="#9AA3AD", lw=0.5, alpha=0.7)
                axes.plot(
                    since, error[d, realization, inside, 0], color=colour, lw=2, label=f"realization {realization}"
                )
                axes.set(title=f"{name}: {label}", ylabel="error north (m)")
                if (d, column) == (0, 0):
                    axes.legend(loc="upper left", ncols=2)
        for axes in grid[-1]:
            axes.set_xlabel(f"time since the start of outage {k + 1} (s); thin grey: all realizations")
        return figure


def consistency(results: Results) -> Figure:
    """Normalised squared error per degree of freedom against time, with the band that a consistent filter keeps to."""
    from scipy.stats import chi2

    with style():
        figure, axes = plt.subplots(figsize=(10.5, 3.6))
        _shade(axes, results.outages)
        dof = 9 * results.realizations
        low, high = (float(chi2.ppf(q, dof)) / dof for q in (0.025, 0.975))
        axes.axhspan(
            low,
            high,
            color="#009E73",
            alpha=0.18,
            lw=0,
            label=f"95 % band of a consistent filter ({low:.2f}-{high:.2f})",
        )
        for d, name in enumerate(results.names):
            axes.plot(
                results.t / 60.0,
                results.nees[d].mean(axis=0) / 9.0,
                color=COLOURS[d % len(COLOURS)],
                lw=1.1,
                label=name,
            )
        axes.set(
            yscale="log",
            xlabel="time (min); grey: no GNSS",
            ylabel="NEES per degree of freedom",
            title="Does the filter know its error?",
        )
        axes.legend(loc="best")
        return figure
