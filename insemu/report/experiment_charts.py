"""The charts of an experiment: flight, errors against what the filters state, errors at outage end, smoother, NEES."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.evaluate import Results, chi_square_bounds, chosen, gnss_in_outages, outage_table, within_outage
from insemu.report.charts import GREY, INK, RED, Chart, Line, View, band, positive, strokes
from insemu.report.style import COLOURS
from insemu.shown import count_of

Array = NDArray[np.float64]

#: Epochs of a chart outside outages, and in each of them, at most: a page of moderate size.
MOST_EPOCHS, MOST_INSIDE = 400, 120
#: Outages above which a page shows them when they are asked for; points of all of them together in a chart over time; numbers of their own charts.
MANY, ALL_INSIDE, OUTAGE_NUMBERS = 20, 1200, 60_000
#: Realizations that a reader can choose from.
SHOWN_ALONE = 5

_DEG = 180.0 / np.pi


def _horizontal(e: Array) -> Array:
    return np.hypot(e[..., 0], e[..., 1])


def _component(index: int, factor: float = 1.0) -> Callable[[Array], Array]:
    return lambda e: np.abs(e[..., index]) * factor


#: Realizations from which on the 95 % quantile over them is drawn: five lie beyond it.
TOLD = 100
#: Realizations that are drawn one by one at an outage's end; of more as many quantiles.
DOTS = 200

#: What is shown, with its unit, from errors or standard deviations (..., 9) in state order; and whether the static picture shows it.
QUANTITIES: dict[str, tuple[str, Callable[[Array], Array], bool]] = {
    "Planimetric position": ("m", _horizontal, True),
    "Height": ("m", _component(2), True),
    "North velocity": ("m/s", _component(3), True),
    "East velocity": ("m/s", _component(4), False),
    "Down velocity": ("m/s", _component(5), False),
    "Attitude about north": ("deg", _component(6, _DEG), True),
    "Attitude about east": ("deg", _component(7, _DEG), False),
    "Attitude about down": ("deg", _component(8, _DEG), False),
}


def colour(number: int) -> str:
    """Of a design, everywhere the same."""
    return COLOURS[number % len(COLOURS)]


def _epochs(results: Results) -> NDArray[np.intp]:
    """Epochs to show: few outside outages, more in and around them, always their ends."""
    t = results.t
    parts = [np.arange(0, t.size, -(-t.size // MOST_EPOCHS))]
    most = ALL_INSIDE // len(results.outages) // 2 if many(results) else MOST_INSIDE
    for k, (start, duration) in enumerate(results.outages):
        parts.append(np.array([results.end_index(k)]))
        if most:
            near = np.arange(*np.searchsorted(t, [start - 0.1 * duration, start + 1.5 * duration]))
            parts.append(near[:: -(-near.size // most) or 1])
    return np.unique(np.concatenate(parts)).astype(np.intp)


def many(results: Results) -> bool:
    """Whether there are too many outages to show each of them unasked."""
    return len(results.outages) > MANY


def outage_charts(results: Results) -> list[Chart]:
    """Planimetric rms error of every design in each outage, and the sigma that it states: to be drawn when asked for."""
    count = len(results.outages) * (2 * len(results.names) + 1)
    points = int(np.clip(OUTAGE_NUMBERS // max(count, 1), 6, MOST_INSIDE))
    drawn: list[tuple[str, str, Array, Array]] = []
    for d, design in enumerate(results.names):
        rms, stated = (_horizontal(_root(results, f"{what}_square", d)) for what in ("error", "sigma"))
        drawn.append((design, colour(d), rms, stated))
    out: list[Chart] = []
    for k, (start, duration) in enumerate(results.outages):
        end = results.end_index(k)
        first = min(int(np.searchsorted(results.t, start - 0.2 * duration)), end)
        at = np.unique(np.round(np.linspace(first, end, min(points, end - first + 1))).astype(np.intp))
        lines = []
        for design, hue, rms, stated in drawn:
            lines += [
                Line(design, positive(rms[at]), hue),
                Line(f"{design}: stated sigma", positive(stated[at]), hue, dashed=True, width=1.1, of=design),
            ]
        view = View("", "planimetric position (m)", lines, log_y=True)
        name = f"Outage {k + 1}, {duration:.3g} s from {start / 60:.4g} min"
        caption = f"Rms error of every design over {count_of(results.realizations, 'realization')} (solid) and the sigma it states (dashed)."
        t = np.round(results.t[at] - start, 2)
        out.append(
            Chart(
                name,
                caption,
                t,
                "time since the start of the outage (s)",
                [view],
                [(0.0, round(duration, 2))],
                group="outage",
            )
        )
    return out


def _spans(results: Results) -> list[tuple[float, float]]:
    return [(start / 60.0, (start + duration) / 60.0) for start, duration in results.outages]


_over_time = partial(Chart, x_label="time (min)")


def error_chart(results: Results) -> Chart:
    """Rms errors of every design over the realizations, and what it states."""
    at = _epochs(results)
    views = []
    told = results.statistics if results.realizations >= TOLD else {}
    sketched = {"Planimetric position": "planimetric_quantile", "Height": "altimetric_quantile"}
    for name, (unit, of, printed) in QUANTITIES.items():
        if many(results) and not printed:
            continue
        lines = []
        for d, design in enumerate(results.names):
            rms, stated = (of(_root(results, f"{what}_square", d)[at]) for what in ("error", "sigma"))
            lines += [
                Line(design, positive(rms), colour(d)),
                Line(f"{design}: stated sigma", positive(stated), colour(d), dashed=True, width=1.1, of=design),
            ]
            if results.smoothed:
                smoothed = positive(of(_root(results, "smoothed_square", d)[at]))
                lines.append(Line(f"{design}: smoothed", smoothed, colour(d), width=0.7, of=design))
            if sketched.get(name) in told:
                high = told[sketched[name]].sel(design=design, level=0.95).to_numpy()[at]
                lines.append(
                    Line(f"{design}: 95 % of the realizations", positive(high), colour(d), width=0.7, of=design)
                )
        errors = [line.y for line in lines if not line.of]
        if np.isfinite(np.asarray(errors)).any():
            views.append(View(f"{name}, rms error", f"{name} ({unit})", lines, log_y=True, printed=printed))
    return _over_time(
        "Error growth",
        f"Rms error of every design over {count_of(results.realizations, 'realization')} (solid) and the sigma it states (dashed); spans without "
        "GNSS are grey. Drag to zoom, double-click to undo; a click on a name switches it.",
        results.t[at] / 60.0,
        views=views,
        spans=_spans(results),
    )


def _root(results: Results, squares: str, design: int) -> Array:
    """Root of the mean over the realizations of squares, (time, 9)."""
    return np.asarray(np.sqrt(results.total.mean(squares, design)))


def bounds_chart(results: Results) -> Chart:
    """Errors of single realizations against the 3-sigma bounds that the filters state."""
    at, numbers = (
        _epochs(results),
        results.data["realization"].to_numpy() if "realization" in results.data.coords else range(results.realizations),
    )
    kept = chosen(results.total, results.names) if len(numbers) < results.realizations else {}

    def view(realization: int, name: str) -> View:
        unit, of, printed = QUANTITIES[name]
        lines = []
        for d, design in enumerate(results.names):
            error, bound = of(results.error[d][realization, at]), 3.0 * of(results.sigma[d][realization, at])
            lines += [
                Line(design, positive(error), colour(d)),
                Line(f"{design}: 3 sigma", positive(bound), colour(d), dashed=True, width=1.1, of=design),
            ]
        title = f"{name}, realization {numbers[realization] + 1}"
        return View(title, f"{name} ({unit})", lines, log_y=True, printed=printed and realization == 0)

    first, *others = QUANTITIES
    shown = len(numbers) if kept else min(SHOWN_ALONE, len(numbers))
    if many(results):
        shown, others = min(shown, 2), [name for name in others if QUANTITIES[name][2]]
    views = [view(r, first) for r in range(shown)] + [view(0, name) for name in others]
    outside = ", ".join(f"{design} {100 * _outside(results, d):.1f} %" for d, design in enumerate(results.names))
    told = f" In outages this share of all planimetric errors is outside: {outside}." if results.outages else ""
    if kept:
        told += " Realizations: " + "; ".join(f"{r + 1} ({why})" for r, why in sorted(kept.items())) + "."
    return _over_time(
        "Against bounds",
        "Error of one realization (solid) and three times the sigma that its filter states (dashed)." + told,
        results.t[at] / 60.0,
        views=[v for v in views if any(np.isfinite(np.asarray(line.y)).any() for line in v.lines)],
        spans=_spans(results),
    )


def _outside(results: Results, design: int) -> float:
    inside = np.zeros(results.t.size, dtype=bool)
    for start, duration in results.outages:
        inside |= within_outage(results.t, start, duration)
    if not inside.any():
        return 0.0
    return float(np.mean(1.0 - results.total.mean("inside_horizontal", design)[inside]))


#: Probability that a consistent filter lies inside the bounds at one epoch.
CONFIDENCE = 0.99


def nees_chart(results: Results) -> Chart:
    """NEES per degree of freedom of the navigation states, mean over realizations, with its chi-square bounds for a single epoch.

    Parameters
    ----------
    results : Results
    """
    at = _epochs(results)
    dof = results.nees_dof * results.realizations
    tail = 0.5 * (1.0 - CONFIDENCE)
    bounds = [x / dof for x in chi_square_bounds(tail, dof)]
    lines = [
        Line(design, positive(results.total.mean("nees", d)[at] / 9.0), colour(d))
        for d, design in enumerate(results.names)
    ]
    lines += band(f"{CONFIDENCE:.0%} bounds", (np.full(at.size, b) for b in bounds), GREY, len(lines))
    return _over_time(
        "Consistency",
        "NEES (normalised estimation error squared) of the navigation states per degree of freedom, mean over "
        f"{count_of(results.realizations, 'realization')}; 1 is a filter that knows its error, larger is optimistic.",
        results.t[at] / 60.0,
        views=[View("NEES", "NEES per degree of freedom", lines, log_y=True)],
        spans=_spans(results),
    )


def flight_chart(results: Results) -> Chart:
    """Map of the flight with its outages, and a close view of every outage with the designs' tracks."""
    plan = earth.llh_to_ned(results.truth.llh, results.truth.llh[0])[:, [1, 0]]
    at = _epochs(results)

    def track(label: str, points: Array, when: NDArray[np.intp], hue: str, width: float = 1.6) -> Line:
        return Line(label, points[when, 1], hue, x=points[when, 0], t=results.t[when] / 60.0, width=width)

    lines = [track("reference", plan, at, INK, 1.2)]
    labels = [(float(plan[0, 0]), float(plan[0, 1]), "start")]
    views: list[View] = []
    if many(results):
        t, hidden = results.t[at], np.zeros(at.size, dtype=bool)
        for start, duration in results.outages:
            hidden |= (t >= start) & (t <= start + duration + 1e-6)
        every = track("outages", plan, at, RED, 3.5)
        lines.append(replace(every, y=np.where(hidden, np.asarray(every.y), np.nan), points=True))
    for k, (start, duration) in enumerate(() if many(results) else results.outages):
        inside = np.flatnonzero(within_outage(results.t, start, duration))
        if not inside.size:
            inside = np.array([results.end_index(k)])
        lines.append(track(f"outage {k + 1}", plan, inside[:: max(1, inside.size // MOST_INSIDE)], RED, 3.5))
        east, north = plan[inside[inside.size // 2]]
        labels.append((float(east), float(north), str(k + 1)))
        near = np.flatnonzero(within_outage(results.t, start - 10.0, duration + 10.0))
        near = np.union1d(near[:: max(1, near.size // MOST_INSIDE)], [results.end_index(k)])
        close = [track("reference", plan, near, INK, 3.0)]
        close += [
            track(name, plan + results.error[d, 0][:, [1, 0]], near, colour(d)) for d, name in enumerate(results.names)
        ]
        views.append(
            View(
                f"Outage {k + 1}, realization 1", "north of the start (m)", close, printed=k + 1 == len(results.outages)
            )
        )
    whole = View("Whole flight", "north of the start (m)", lines, labels=labels)
    return Chart(
        "Flight",
        f"The reference from above with the spans {gnss_in_outages(results)}; "
        "the other views show every design's track in one outage. The cursor of the "
        "charts over time is shown here, and that of the map there. Drag to zoom, double-click to undo.",
        None,
        "east of the start (m)",
        [whole, *views],
        equal=True,
    )


def end_chart(results: Results) -> Chart:
    """Planimetric error at outage end: every realization, mean with its 95 % interval, what the filter states, what was published."""
    table = outage_table(results)
    if many(results):
        return _ends_over_time(results, table)
    published = results.published.get("planimetric_end_m", {})
    lines, count = [], len(results.names)
    stated: tuple[list[float], list[float], list[str]] = ([], [], [])
    printed: tuple[list[float], list[float], list[str]] = ([], [], [])
    for d, name in enumerate(results.names):
        rows = table[name]
        at = [k + (d - (count - 1) / 2) * 0.8 / count for k in range(len(rows))]
        ends = [row["planimetric_end_m"] for row in rows]
        each = [_dots(np.asarray(p["per_realization"])) for p in ends]
        x = [p + (np.arange(v.size) / max(1, v.size - 1) - 0.5) * 0.5 / count for p, v in zip(at, each, strict=True)]
        said = [
            f"{v:.3g} m, "
            + (f"realization {r + 1}" if results.realizations <= DOTS else f"quantile {100 * (r + 0.5) / DOTS:g} %")
            for values in each
            for r, v in enumerate(values)
        ]
        every = Line(f"{name}: realizations", np.concatenate(each), colour(d), points=True, width=1.0, of=name)
        every = replace(every, x=np.concatenate(x), text=said)
        low_high = [p["ci95"] if p["ci95"][0] is not None else (np.nan, np.nan) for p in ends]
        words = [
            f"mean {p['mean']:.3g} m" + (f" (95 %: {a:.3g} to {b:.3g})" if np.isfinite(a) else "")
            for p, (a, b) in zip(ends, low_high, strict=True)
        ]
        bars = strokes(at, low_high, words)
        interval = Line(f"{name}: 95 % of the mean", bars[1], colour(d), x=bars[0], text=bars[2], width=4.0, of=name)
        lines += [
            every,
            interval,
            Line(name, [p["mean"] for p in ends], colour(d), points=True, x=at, text=words, width=6.0),
        ]
        for held, values, word in (
            (stated, [row["predicted_sigma_end_m"] for row in rows], "states"),
            (printed, published.get(name, ())[: len(rows)], "published"),
        ):
            for p, v in zip(at, values, strict=False):
                if v is not None:
                    held[0].append(p)
                    held[1].append(v)
                    held[2].append(f"{name} {word} {v:.3g} m")
    for label, (x_all, y_all, said), hue in (("stated sigma", stated, INK), ("published", printed, RED)):
        if y_all:
            lines.append(Line(label, y_all, hue, points=True, x=x_all, text=said, width=3.0))
    dots = "realizations" if results.realizations <= DOTS else "quantiles over the realizations"
    ticks = [(float(k), f"{s / 60:.3g} min, {w:g} s") for k, (s, w) in enumerate(results.outages)]
    return Chart(
        "End errors",
        f"Planimetric error at outage end: small dots are {dots}, large ones their mean with its 95 % interval (bar); dark dots are the "
        "sigma that the filter states" + (", red ones what was published." if published else "."),
        None,
        "outage (start, duration)",
        [View("At outage end", "planimetric error (m)", lines, log_y=True, ticks=ticks)],
        group="ends",
    )


def _ends_over_time(results: Results, table: Mapping[str, Sequence[Mapping[str, Any]]]) -> Chart:
    """Mean error at the end of each of many outages, against its start, and what the filters state."""
    lines = []
    for d, (name, rows) in enumerate(table.items()):
        mean = positive([row["planimetric_end_m"]["mean"] for row in rows])
        stated = positive([row["predicted_sigma_end_m"] for row in rows])
        lines += [
            Line(name, mean, colour(d), points=True, width=3.0),
            Line(f"{name}: stated sigma", stated, INK if d == 0 else GREY, points=True, width=1.2, of=name),
        ]
    return _over_time(
        "End errors",
        f"Planimetric error at the end of each of {len(results.outages)} outages, mean over the realizations (large dots), and the sigma that the "
        "filter states (small dots).",
        [start / 60.0 for start, _ in results.outages],
        views=[View("At outage end", "planimetric error (m)", lines, log_y=True)],
        group="ends",
    )


def _dots(values: Array) -> Array:
    """Values to draw one by one: all, or of many as many quantiles."""
    return values if values.size <= DOTS else np.quantile(values, (np.arange(DOTS) + 0.5) / DOTS)


def smoother_chart(results: Results) -> Chart:
    """North position error of every design in the longest outage, filtered and smoothed, with the 3-sigma bands that they state."""
    k = max(range(len(results.outages)), key=lambda i: results.outages[i][1])
    start, duration = results.outages[k]
    inside = (results.t >= start - 0.1 * duration) & (results.t <= start + 1.1 * duration)
    views = []
    for d, name in enumerate(results.names):
        lines: list[Line] = []
        for label, hue, of in (("filter", COLOURS[1], ""), ("smoother", COLOURS[0], "smoothed_")):
            error, wide = results[f"{of}error"][d, 0, inside, 0], 3.0 * results[f"{of}sigma"][d, 0, inside, 0]
            lines.append(Line(label, error, hue))
            lines += band(f"{label}: 3 sigma", (-wide, wide), hue, len(lines), label)
        views.append(View(name, "error north (m)", lines))
    return Chart(
        "Smoothing",
        f"Error north in outage {k + 1}, realization 1, filtered and smoothed; bands are the 3 sigma that each states.",
        results.t[inside] - start,
        "time since the start of the outage (s)",
        views,
        [(0.0, duration)],
        group="outage",
    )
