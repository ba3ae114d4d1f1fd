"""The page of a fit whose levels or correlation times follow a covariate: each against it, segment by segment, with the law that was fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.fit import LEAST_P, Followed, FollowingFit, followed
from insemu.noise import Follows, process_label
from insemu.report import page
from insemu.report.charts import INK, RED, Chart, Line, View, familiar, positive
from insemu.report.fit import parameters_table, residuals, verdict_cards
from insemu.shown import p_words
from insemu.units import datasheet

#: Points of a law's curve.
POINTS = 200
#: Levels that the answer tells one by one.
TOLD = 2


def _followers(fitted: FollowingFit) -> list[tuple[str, Followed, Follows]]:
    """Label of every process that follows, what of it does, and its law."""
    result = fitted.result
    return [
        (process_label(p.symbol, index), followed(p, result.unit, 1.0 / result.rate_hz), p.follows)
        for index, p in result.model.indexed()
        if p.follows is not None
    ]


def following_answer(fitted: FollowingFit) -> list[str]:
    """What every level or correlation time does with its covariate, one sentence each."""
    out = []
    for label, p, law in _followers(fitted):
        estimate = fitted.result[f"{label}.slope"]
        low = min(s.lowest[law.covariate] for s in fitted.segments)
        high = max(s.highest[law.covariate] for s in fitted.segments)
        first, last = (float(g) ** p.power for g in law.gain(np.array([low, high])))
        p_value = fitted.p_values.get(label, math.nan)
        unit = f" {law.unit}" if law.unit else ""
        span = f"from {low:.4g} to {high:.4g}{unit}"
        told = (
            f"{label}.{p.name} changes by a factor of {last / first:.3g} {span}"
            if first > 0
            else f"{label} follows {span}"
        )
        interval = (
            f"slope {estimate.value:.3g} ({estimate.low:.3g} … {estimate.high:.3g}) {law.slope_unit}".removesuffix(" 1")
        )
        if not math.isfinite(p_value):
            verdict = "held"
        elif p_value < LEAST_P:
            verdict = f"it follows {law.covariate} ({p_words(p_value)})"
        else:
            verdict = f"no sign that it follows {law.covariate} ({p_words(p_value)})"
        out.append(f"{fitted.result.name}: {told}; {interval}: {verdict}")
    return out


def segment_rows(fitted: FollowingFit) -> tuple[list[str], list[tuple[str, ...]]]:
    """Heading and rows of a table of segments: their span, covariates and levels with intervals."""
    followers = _followers(fitted)
    names = list(dict.fromkeys(law.covariate for *_, law in followers))
    units_of = {law.covariate: law.unit for *_, law in followers}
    heading = ["from, s", "to, s", *(f"{n}, {units_of[n]}".removesuffix(", ") for n in names)]
    scales = {label: datasheet(1.0, p.unit) for label, p, _ in followers}
    heading += [f"{label}.{p.name}, {scales[label][1]} (95 %)" for label, p, _ in followers]
    rows = []
    for s in fitted.segments:
        row = [f"{s.start_s:.5g}", f"{s.end_s:.5g}", *(f"{s.covariate[n]:.4g}" for n in names)]
        for k, (factor, _) in scales.items():
            row.append(f"{factor * s.level[k]:.3g} ({factor * s.low[k]:.3g} … {factor * s.high[k]:.3g})")
        rows.append(tuple(row))
    return heading, rows


def level_chart(results: Mapping[str, FollowingFit]) -> Chart:
    """Levels against the covariate: the segments with intervals, the fitted law."""
    views = []
    label_x = "covariate"
    for axis, fitted in results.items():
        for label, p, law in _followers(fitted):
            segments = sorted(fitted.segments, key=lambda s: s.covariate[law.covariate])
            at = np.array([s.covariate[law.covariate] for s in segments])
            level, low, high = (
                np.array([getattr(s, key)[label] for s in segments]) for key in ("level", "low", "high")
            )
            grid = np.linspace(at[0], at[-1], POINTS)
            x = np.unique(np.concatenate([at, grid]))
            there = np.searchsorted(x, at)

            def placed(values: np.ndarray, x: np.ndarray = x, there: np.ndarray = there) -> np.ndarray:
                out = np.full(x.size, np.nan)
                out[there] = values
                return out

            curve = p.value * law.gain(x) ** p.power
            lines = [
                Line("segments", positive(placed(level)), INK, points=True, width=6.0),
                Line("95 % interval of a segment, low", positive(placed(low)), INK, points=True, width=2.5, of="segments"),
                Line("95 % interval of a segment, high", positive(placed(high)), INK, points=True, width=2.5, of="segments"),
                Line("fitted to all segments", positive(curve), RED, width=2.2),
            ]  # fmt: skip
            lines, unit = familiar(lines, p.unit)
            views.append(View(f"{axis}: {label}", f"{label}.{p.name} ({unit})", lines, log_y=True, x=x))
            label_x = f"{law.covariate} ({law.unit})" if law.unit else law.covariate
    caption = (
        "Level, or longest correlation time, of each process in every segment by itself, with its 95 % interval, and the law that was fitted to all "
        "of them together."
    )
    return Chart("Level against covariate", caption, None, label_x, views, group="covariate")


def render_following(results: Mapping[str, FollowingFit], path: str | Path, *, source: str = "") -> Path:
    """Write one self-contained page: what every level follows, the picture, segments and parameters.

    Parameters
    ----------
    results : mapping
        Axis to fit.
    path : path
        HTML file.
    source : str
        The log that was fitted.
    """
    sentences = [line for fitted in results.values() for line in following_answer(fitted)]
    fits = {axis: f.result for axis, f in results.items()}
    detail = []
    for axis, fitted in results.items():
        heading, rows = segment_rows(fitted)
        blocks: list[page.Block] = [parameters_table(fitted.result), page.Table(heading, rows)]
        detail.append(page.Folded(f"{axis}: parameters and segments", blocks))
    sections = [
        page.Section("Levels", [page.Items(sentences), level_chart(results)]),
        page.Section("The whole record", [residuals(fits)]),
        page.Section("Detail", detail),
    ]
    moving = sum(p < LEAST_P for f in results.values() for p in f.p_values.values())
    total = sum(len(f.p_values) for f in results.values())
    answer = (
        f"{moving} of {total} levels and correlation times follow their covariate."
        if len(sentences) > TOLD
        else f"{'. '.join(sentences)}."
    )
    return page.Page(
        "Noise that follows a covariate" + (f": {Path(source).name}" if source else ""),
        sections,
        kind="fit",
        source=source,
        answer=answer,
        cards=verdict_cards(fits),
    ).write(path)
