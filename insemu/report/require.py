"""The page of a requirement: which sensor cards keep it, what limits them, the frontier that would just do, aids, the track."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from insemu.report import page
from insemu.report.charts import GREY, RED, Chart, Line, View
from insemu.report.style import COLOURS
from insemu.require import FIGURES, UNITS, Answer, Requirement, figures_text
from insemu.units import datasheet

Cells = tuple[list[str], list[list[str]]]
_TONES = {"meets": "good", "may meet": "warn", "misses": "bad", "doubtful": "plain"}


def _short(r: Requirement) -> str:
    return f"{r.quantity} {r.seconds:g} s"


def require_rows(found: Answer) -> Cells:
    """Header and rows of all sensors, the largest margin first."""
    header = [
        "card",
        "verdict",
        "units",
        *map(_short, found.requirements),
        "margin",
        "limited by",
        "margin if halved",
    ]
    rows = [
        [
            v.sensor.name + (" *" if v.sensor.assumed else "") + (" ?" if v.doubt else ""), v.word, f"{v.probability:.0%}",
            *(r.shown(e) for r, e in zip(found.requirements, v.errors, strict=True)), f"{v.margin:.3g}", v.limits, f"{v.halved:.3g}",
        ]
        for v in found.verdicts
    ]  # fmt: skip
    return header, rows


def frontier_rows(found: Answer) -> Cells:
    """Header and rows of the figures that keep the requirements alone, and together."""
    alone, just = figures_text(found.alone), figures_text(found.just)
    return ["figure", "alone, at most", "together, at most"], [[name, alone[name], just[name]] for name in FIGURES]


def aid_rows(found: Answer) -> Cells:
    """Header and rows of the aids."""
    rows = [[a.name, str(len(a.meeting)), a.meeting[0] if a.meeting else "none", a.like] for a in found.alternatives]
    return [
        "aids",
        "typical units that meet it",
        "the least of them",
        "the least card with it is worth, without it, a",
    ], rows


def place_rows(found: Answer) -> Cells:
    """Header and rows of the outages along the track."""
    rows = [
        [
            f"{p.start:.0f}", f"{p.speed:.1f}", f"{math.degrees(p.turned):.0f}", f"{p.stands:.0%}",
            *(r.shown(e) for r, e in zip(found.requirements, p.errors, strict=True)),
        ]
        for p in found.places
    ]  # fmt: skip
    return ["outage at s", "speed m/s", "turned deg", "at rest", *map(_short, found.requirements)], rows


def require_notes(found: Answer) -> list[str]:
    """What was assumed, and where the answer is doubtful."""
    notes = ["units: share of the units of a type that keep all requirements, with the spread of the printed figures."]
    if assumed := [v.sensor for v in found.verdicts if v.sensor.assumed]:
        notes.append(
            f"* a figure is not printed and was taken from cards of the same grade: {assumed[0].name}: {'; '.join(assumed[0].assumed)}."
        )
    doubtful = [v for v in found.verdicts if v.doubt]
    if doubtful:
        notes.append(
            f"? the linear answer is doubtful for {', '.join(v.sensor.name for v in doubtful)}: {doubtful[0].doubt}. "
            + (
                f"Their errors are those of {doubtful[0].flown} flights of the full filter."
                if doubtful[0].flown
                else "--realizations N flies them."
            )
        )
    if found.road:
        notes.append(
            "Factors between bench and vehicle: " + ", ".join(f"{k} {v:.3g}" for k, v in found.road.items()) + "."
        )
    notes.append("No source prices the sensors; the order is that of the margin.")
    return notes


def _plane(found: Answer, pair: tuple[str, str]) -> View:
    """A frontier with the cards on it."""
    scale, labels = [], []
    for name in pair:
        factor, unit = datasheet(1.0, UNITS[FIGURES.index(name)])
        scale.append(factor)
        labels.append(f"{name} ({unit})")
    curve = found.planes[pair] * scale
    lines = [Line("just meets", curve[:, 1], RED, x=curve[:, 0], width=2.5)]
    for k, word in enumerate(_TONES):
        at = [v.sensor for v in found.verdicts if v.word == word]
        points = np.array([[s.values[FIGURES.index(name)] for name in pair] for s in at]).reshape(-1, 2) * scale
        colour = (COLOURS[2], COLOURS[1], GREY, GREY)[k]
        lines.append(
            Line(word, points[:, 1], colour, points=True, width=7.0, x=points[:, 0], text=[s.name for s in at])
        )
    return View(f"{labels[0]} and {labels[1]}", labels[1], [line for line in lines if np.size(line.y)], log_y=True)


def render_require(found: Answer, path: str | Path, *, source: str = "") -> Path:
    """Write one self-contained page: verdicts on the cards, frontier, aids, track, and the scenario that flies the answer.

    Parameters
    ----------
    found : Answer
    path : path
        HTML file.
    source : str
        The track.
    """
    chart = Chart(
        "Frontier", "Below the line the requirements are kept, with the other figures as in the table; cards as points.", None,
        "the figure named first", [_plane(found, pair) for pair in found.planes], log_x=True,
    )  # fmt: skip
    sections = [
        page.Section("Cards", [page.Table(*require_rows(found)), page.Items(require_notes(found))]),
        page.Section("Figures that just meet it", [page.Table(*frontier_rows(found)), chart]),
        page.Section("Aids", [page.Table(*aid_rows(found))]),
        page.Section("Track", [page.Table(*place_rows(found), caption=f"Errors of {found.chosen.sensor.name}.")]),
        page.Section("The scenario that flies it", [page.Code(found.scenario)]),
    ]
    cards = [
        page.Card(
            v.sensor.name, f"margin {v.margin:.3g}", f"{v.word}, {v.probability:.0%} of its units", _TONES[v.word]
        )
        for v in dict.fromkeys([found.chosen, found.verdicts[0]])
    ]
    return page.Page("Which IMU", sections, kind="require", source=source, answer=found.text, cards=cards).write(path)
