"""The page of an array: metres under each weighting, weights of the units, curves of the virtual sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insemu.array import EQUAL, METRES, ArrayFit, Weighting
from insemu.report import page
from insemu.report.charts import GREY, INK, RED, Chart, Line, View, familiar, positive
from insemu.report.style import COLOURS
from insemu.report.tables import short
from insemu.variance import wavelet_variance


def array_answer(found: ArrayFit) -> str:
    """The one sentence: what the weights are worth."""
    ours, equal = found[METRES], found[EQUAL]
    gain = 1.0 - np.sqrt(ours.ratio)
    said = f"{short(ours.rms_m)} m at outage end (rms) with these weights, {short(equal.rms_m)} m with equal ones"
    if ours.high >= 1.0:
        return f"{said}: no gain for certain, take equal weights."
    low, high = 1.0 - np.sqrt(ours.high), 1.0 - np.sqrt(ours.low)
    return f"{said}: {gain:.0%} less (95 % interval {low:.0%} to {high:.0%})."


def weighting_rows(found: ArrayFit) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of weightings."""
    header = ["weights", "rms m", "mean square / equal", "95 %"]
    rows = [
        [w.name, short(w.rms_m), f"{w.ratio:.3f}", "" if w.name == EQUAL else f"{w.low:.3f} to {w.high:.3f}"]
        for w in found.weightings
    ]
    return header, rows


def weight_rows(found: ArrayFit) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the weights for the fewest metres: an axis per row, with the share of the mean square that the axis makes up."""
    header = ["axis", *found.units, "share with equal weights"]
    rows = [
        [axis, *(f"{v:.3f}" for v in w), f"{found.shares[axis].sum():.1%}"] for axis, w in found[METRES].weights.items()
    ]
    return header, rows


def _colour(name: str, place: int) -> str:
    return {METRES: RED, EQUAL: INK}.get(name, COLOURS[place % len(COLOURS)])


def _card(w: Weighting) -> page.Card:
    if w.name == EQUAL:
        return page.Card(w.name, f"{short(w.rms_m)} m", "what the others are measured by")
    tone = "good" if w.high < 1.0 else "bad" if w.low > 1.0 else "plain"
    return page.Card(w.name, f"{short(w.rms_m)} m", f"{w.ratio:.2f} times the mean square of equal weights", tone)


def _curves(found: ArrayFit) -> Chart:
    """Wavelet deviation of the units and of the virtual sensors, axis by axis."""
    views = []
    for axis, fits in found.fits.items():
        curves = [f.curve for f in fits]
        assert curves[0] is not None
        lines = [
            Line("units" if k == 0 else f"unit {u}", np.sqrt(positive(c.value)), GREY, of="" if k == 0 else "units")
            for k, (u, c) in enumerate(zip(found.units, curves, strict=True))
            if c is not None
        ]
        signals = found.signals[axis]
        for k, w in enumerate(found.weightings):
            values = sum(a * s.values for a, s in zip(w.weights[axis], signals, strict=True))
            curve = wavelet_variance(np.asarray(values), signals[0].rate_hz, intervals="eta3")
            lines.append(Line(w.name, np.sqrt(positive(curve.value)), _colour(w.name, k), width=2.0))
        lines, unit = familiar(lines, signals[0].unit)
        views.append(View(axis, f"wavelet deviation ({unit})", lines, log_y=True, x=curves[0].tau_s))
    caption = "Wavelet deviation of every unit, and of the virtual sensor under each weighting."
    return Chart("Units and virtual sensors", caption, None, "scale (s)", views, log_x=True, group="scale")


def _weights(found: ArrayFit) -> Chart:
    """Weights of the units, axis by axis."""
    x = np.arange(1, len(found.units) + 1, dtype=np.float64)
    ticks = list(zip(x.tolist(), found.units, strict=True))
    views = []
    for axis in found.fits:
        lines = []
        for k, w in enumerate(found.weightings):
            is_equal = w.name == EQUAL
            lines.append(
                Line(w.name, w.weights[axis], _colour(w.name, k), points=not is_equal, width=1.6 if is_equal else 6.0)
            )
        views.append(View(axis, "weight", lines, ticks=ticks))
    caption = "Weight of every unit, axis by axis, under each weighting."
    return Chart("Weights", caption, x, "unit", views)


def render_array(found: ArrayFit, path: str | Path, *, source: str = "") -> Path:
    """Write one self-contained page: what the weights are worth, the weights, the curves.

    Parameters
    ----------
    found : ArrayFit
    path : path
        HTML file.
    source : str
        The logs.
    """
    heading, rows = weighting_rows(found)
    sections = [
        page.Section("Metres", [page.Table(heading, rows), page.Table(*weight_rows(found)), _weights(found)]),
        page.Section("Curves", [_curves(found)]),
    ]
    if found.dependent:
        said = [f"{a} of {one} and {two} are not independent (p {p:.1g})" for a, one, two, p in found.dependent]
        sections.append(page.Section("Not independent", [page.Items(said)]))
    cards = [_card(w) for w in found.weightings]
    return page.Page(
        f"Array of {len(found.units)} IMUs",
        sections,
        kind="array",
        source=source,
        answer=array_answer(found),
        cards=cards,
    ).write(path)
