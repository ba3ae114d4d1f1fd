"""The charts of a gap: wavelet deviation, spectrum, innovations, evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from insemu.report.charts import GREY, INK, Chart, Line, View, band, familiar, positive, strokes
from insemu.report.style import COLOURS

if TYPE_CHECKING:
    from insemu.gap import GapReport

#: Innovations that a chart shows at most.
MOST_FIXES = 2500
_DIRECTIONS = ("north", "east", "down")


def axis_words(name: str) -> str:
    """An axis in words."""
    sensor, _, axis = name.rpartition("_")
    return f"{ {'gyro': 'gyroscope', 'accel': 'accelerometer'}.get(sensor, sensor) } {axis}"


def wavelet_chart(report: GapReport, names: Sequence[str], model: str) -> Chart:
    """Wavelet deviation of the recording and of a model, axis by axis.

    Parameters
    ----------
    report : GapReport
    names : sequence of str
        Axes, keys of ``report.curves``.
    model : {"nominal", "refined"}
    """
    measured, label = (
        ("measured", "measured") if model == "nominal" else ("measured_after", "measured, known effects removed")
    )
    views = []
    for name in names:
        c = report.curves[name]
        lines = [
            Line(label, np.sqrt(positive(c[measured])), INK, points=True, width=4.0),
            Line(model, np.sqrt(positive(c[model])), COLOURS[model == "nominal"], width=2.0),
        ]
        lines, unit = familiar(lines, c["unit"])
        views.append(View(axis_words(name), f"wavelet deviation ({unit})", lines, log_y=True, x=c["tau_s"]))
    caption = f"Wavelet deviation of the recording and of the {model} model."
    return Chart(f"Wavelet deviation, {model}", caption, None, "scale (s)", views, log_x=True, group="scale")


def spectrum_chart(report: GapReport, names: Sequence[str]) -> Chart:
    """PSD measured, nominal and refined, axis by axis."""
    views = []
    for name in names:
        c = report.curves[name]
        keys = (
            ("measured", "power", INK),
            ("nominal", "nominal_psd", COLOURS[1]),
            ("refined", "refined_psd", COLOURS[0]),
        )
        lines = [Line(label, np.sqrt(positive(c[key])), hue, dashed=label == "nominal") for label, key, hue in keys]
        lines, unit = familiar(lines, f"{c['unit']}/sqrt(Hz)")
        views.append(View(axis_words(name), f"root of the two-sided PSD ({unit})", lines, log_y=True, x=c["f"]))
    return Chart(
        "Spectrum", "Spectrum: measured, nominal, refined.", None, "frequency (Hz)", views, log_x=True, group="f"
    )


def innovation_chart(report: GapReport, when: str) -> Chart:
    """Normalised innovations against time, their autocorrelation, and the direction of travel.

    Parameters
    ----------
    report : GapReport
    when : {"before", "after"}
        With the nominal or with the refined model.
    """
    c = report.curves["drive"][when]
    t, y = np.asarray(c["t"]), np.asarray(c["y"])
    some = slice(None, None, -(-t.size // MOST_FIXES) or 1)
    views = []
    for first, what in ((0, "position"), (3, "velocity")):
        lines = [*_between(2.0, t[some].size), *_dots(y[some, first : first + 3])]
        views.append(View(f"{what.capitalize()} innovations", "innovation / its standard deviation", lines, x=t[some]))
    lags = np.arange(1, 31)
    names = [f"{what} {axis}" for what in ("position", "velocity") for axis in _DIRECTIONS]
    lines = _between(2.0 / np.sqrt(t.size), lags.size)
    for k, name in enumerate(names):
        z = y[:, k]
        if np.isfinite(z).sum() >= 60:
            power, products = np.nanmean(z * z), [z[j:] * z[:-j] for j in lags]
            rho = [np.nanmean(p) / power if np.isfinite(p).any() else np.nan for p in products]
            lines.append(Line(name, rho, COLOURS[k % 3], dashed=k >= 3))
    views.append(View("Autocorrelation over the lag", "correlation", lines, x=lags * float(np.median(np.diff(t)))))
    if "across" in c:
        at, u = c["across"]
        angles = np.degrees(np.arctan2(u[:, 1:3], u[:, :1]))
        views.append(
            View("Direction of travel", "angle to the forward axis (deg)", _dots(angles, ("sideways", "down")), x=at)
        )
    return Chart(
        f"Innovations, {'nominal' if when == 'before' else 'refined'}",
        f"Innovations of the filter with the {'nominal' if when == 'before' else 'refined'} model. Grey is what nineteen of twenty keep to where "
        "model and drive agree.",
        None,
        "time (s)",
        views,
    )


def _between(bound: float, n: int) -> list[Line]:
    """A grey band around zero."""
    return band("19 of 20", (np.full(n, -bound), np.full(n, bound)), GREY, 0)


def _dots(values: NDArray[Any], names: Sequence[str] = _DIRECTIONS) -> list[Line]:
    return [Line(name, values[:, k], COLOURS[k], points=True, width=1.0) for k, name in enumerate(names)]


def shrink_chart(report: GapReport) -> Chart:
    """Gap index on data that was not used for naming, from the nominal model to the refined one.

    Parameters
    ----------
    report : GapReport
        With ``shrink``.
    """
    y = np.array([step.index for step in report.shrink])
    x = np.arange(float(y.size))
    spread = 1.96 * np.array([step.spread for step in report.shrink])
    lines = [
        *band("a right model, 19 of 20", (1.0 - spread, 1.0 + spread), GREY, 0),
        Line("gap index", y, COLOURS[0]),
        Line("after each step", y, COLOURS[0], points=True, width=7.0, of="gap index"),
    ]
    return Chart(
        "The gap, step by step",
        "Gap index on data that was not used for naming, as effects are added to the model one after the other: 0 is the nominal model, the table "
        "has the rest. Grey is where the index of a right model lies.",
        x,
        "step",
        [
            View(
                "Gap index",
                "reduced chi-square",
                lines,
                bool(y.max() > 10.0 * y.min()),
                [(k, f"{k:g}") for k in x.tolist()],
            )
        ],
        group="steps",
    )


def evidence_chart(rivals: Sequence[tuple[str, Sequence[tuple[str, float, bool]]]]) -> Chart:
    """Nats of every rival, finding by finding.

    Parameters
    ----------
    rivals : sequence of (finding, rivals)
        A rival is its name, its evidence in nats, and whether it is within the lead of the best.
    """
    views = []
    for subject, members in rivals:
        lines = []
        for inside, hue, label in ((True, COLOURS[0], "within 3 nats of the best"), (False, GREY, "rivals")):
            chosen = [(float(k), name, nats) for k, (name, nats, own) in enumerate(members) if own == inside]
            said = [f"{name}: {nats:.1f} nats" for _, name, nats in chosen]
            x, y, text = strokes([k for k, _, _ in chosen], [(0.0, nats) for _, _, nats in chosen], said)
            lines += [Line(label, y, hue, x=x, text=text, width=30.0)] if chosen else []
        ticks = [(float(k), name.replace(" ", "\n", 1)) for k, (name, _, _) in enumerate(members)]
        views.append(View(subject, "evidence (nats)", lines, ticks=ticks))
    return Chart(
        "Evidence", "Evidence of the named effects and of their rivals.", None, "effect", views, group="evidence"
    )
