"""The page of the referee: what each filter states against its errors in every world, and what would have been found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from insemu.evaluate import share_interval
from insemu.referee import POWER, Judged, Judgement
from insemu.report import page
from insemu.report.charts import GREY, Chart, Line, View, band
from insemu.report.style import COLOURS
from insemu.shown import count_of

Cells = tuple[list[str], list[list[str]]]
#: Items that a filter's own list of failed tests has at most.
MOST = 12
WORLDS_SAID = "First component whose errors are not what is stated, when, and by what factor; -: nothing was found."


def referee_answer(found: Sequence[Judgement]) -> str:
    """What a reader looks for first."""
    if len(found) == 1:
        return found[0].verdict
    right = [j for j in found if not j.accused]
    wrong = [f"{j.name} (in {count_of(len(j.accused), 'world')})" for j in found if j.accused]
    worlds = count_of(len(found[0].right), "world")
    words = f"Nothing was found against {len(right)} of {len(found)} filters in {worlds}: {', '.join(j.name for j in right) or 'none'}."
    return words + (f" Errors are not as stated of {', '.join(wrong)}." if wrong else "")


def _cell(row: Judged) -> str:
    if not row.found:
        return "-"
    if row.flights.failed:
        return f"fails in {len(row.flights.failed)}"
    if row.first is not None:
        return f"{row.first.component.replace('_', ' ')}, {row.first.t:g} s: x {row.first.factor:.2f}"
    v = next(v for v in row.tests if not v.passed)
    return f"{v.subject}: x {math.sqrt(v.value):.2f}"


def world_rows(found: Sequence[Judgement]) -> Cells:
    """Header and rows: what was found in each world, filter by filter."""
    rows = [[r.world.name, *(_cell(j.rows[k]) for j in found)] for k, r in enumerate(found[0].rows)]
    return ["world", *(j.name for j in found)], rows


def _percent(few: float, many: float) -> str:
    words = (f"{100 * v:.0f}" if v >= 0.1 else f"{100 * v:.1f}" for v in (few, many))
    return " / +".join(words) if math.isfinite(many) else f"{100 * few:.0f}"


def power_rows(found: Sequence[Judgement]) -> Cells:
    """Header and rows: smallest errors of sigma that are found with :data:`insemu.referee.POWER`; worlds and filters alike in one row."""
    groups = {
        "all nine": "all nine states",
        "position": "position, velocity or attitude",
        "innovations": "innovations",
        "component": "one component, one epoch",
    }
    alike: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for j in found:
        for r in j.rows:
            cells = tuple(f"-{_percent(*r.power[g])} %" if g in r.power else "" for g in groups)
            alike.setdefault(cells, {}).setdefault(j.name, []).append(r.world.name)
    rows = []
    for cells, own in alike.items():
        places = list(own.values())
        if all(p == places[0] for p in places):
            rows.append([", ".join(own) if len(own) < len(found) else "all", ", ".join(places[0]), *cells])
        else:
            rows += [[name, ", ".join(p), *cells] for name, p in own.items()]
    return ["filter", "worlds", *groups.values()], rows


def drift_rows(found: Sequence[Judgement]) -> Cells:
    """Header and rows: horizontal error at the end of every outage, and over the bound."""
    rows = []
    for k, r in enumerate(found[0].rows):
        for n, d in enumerate(r.drifts if not r.world.wrong else ()):
            own = [j.rows[k].drifts[n] if j.rows[k].drifts else None for j in found]
            cells = [f"{o.rms:.3g} m: {o.ratio:.2f} ({o.low:.2f} to {o.high:.2f})" if o else "" for o in own]
            rows.append([f"{r.world.name}, {d.duration:g} s", f"{d.bound:.3g} m", *cells])
    return ["outage", "bound", *(j.name for j in found)], rows


def start_rows(found: Sequence[Judgement]) -> Cells:
    """Header and rows: share of starts with large errors that converge."""
    rows = []
    for sigma in found[0].starts:
        cells = []
        for j in found:
            k, n = j.starts[sigma]
            low, high = share_interval(k, n)
            cells.append(f"{k} of {n} ({100 * low:.0f} to {100 * high:.0f} %)")
        rows.append([sigma, *cells])
    return ["tilt and heading sigma", *(j.name for j in found)], rows


def _nees(found: Sequence[Judgement]) -> Chart | None:
    views = []
    for k, first in enumerate(found[0].rows):
        lines, t = [], first.flights.t - first.flights.t[0]
        for n, j in enumerate(found):
            row = j.rows[k]
            if "all nine" in row.power:
                mean = row.flights.nees[..., 0].mean(axis=0)
                lines.append(
                    Line(
                        j.name,
                        np.interp(t, row.flights.t - row.flights.t[0], mean),
                        COLOURS[n % len(COLOURS)],
                        width=2.0,
                    )
                )
        tests = [v for v in first.tests if v.test == "NEES/dof"]
        if not lines or not tests:
            continue
        lines += band("bounds", (np.full(t.size, v) for v in (tests[0].low, tests[0].high)), GREY, len(lines))
        views.append(View(first.world.name, "NEES of nine states per state", lines, x=t, log_y=True))
    if not views:
        return None
    caption = "Mean NEES over the realizations; 1 is right, above 1 the filter is surer than it should be. Bounds are those of the tests."
    return Chart("NEES", caption, None, "time (s)", views)


def render_referee(found: Sequence[Judgement], path: str | Path, *, source: str = "") -> Path:
    """Write one self-contained page.

    Parameters
    ----------
    found : sequence of Judgement
        Of the same worlds.
    path : path
        HTML file.
    source : str
        Filters that were asked about.
    """
    first, runs = found[0], max(r.flights.runs for j in found for r in j.rows)
    said = [f"{r.world.name}: {r.world.says}" for r in first.rows]
    chart = _nees(found)
    half = f"{100 * first.false_alarm / 2:g} %"
    how = [
        f"Every filter flew {runs} realizations a world. It got the noise models of the sensors and the standard deviations of fixes and start, "
        "never the truth.",
        f"A filter that is right is accused with at most {100 * first.false_alarm:g} % for all its worlds and tests together: {half} for NEES of "
        f"groups of states after a third, two thirds and the whole of a flight and at the ends of outages, and for NIS; {half} for every component "
        "at every second, which finds where an inconsistency begins.",
        "Bounds are exact chi-square quantiles over independent realizations, where errors are normal. Differences of sigma up to 1 % do not count.",
        "What a world would have found is exact for one test alone, so that all tests together find no less.",
        "In the worlds 'wrong ...' filters are given a wrong model on purpose, and should be accused: what is found there is no fault of theirs.",
        "The bound of an outage is the covariance of the filter that knows the noise, linearized along the true motion.",
        f"A start has converged if tilt is within 2 deg, heading within 5 deg and position within 5 m after {_length(first):.0f} s.",
    ]
    sections = [
        page.Section(
            "Worlds",
            [page.Table(*world_rows(found), caption=WORLDS_SAID, left=len(found) + 1), page.Folded("What the worlds are", [page.Items(said)])],
        ),
        page.Section(
            f"What would have been found with {100 * POWER:.0f} %",
            [page.Table(*power_rows(found), caption="By how much sigma has to be too small (-) or too large (+).", left=2, wrap=True)],
        ),
    ]  # fmt: skip
    if chart is not None:
        sections.append(page.Section("NEES", [chart]))
    if (drifts := drift_rows(found))[1]:
        sections.append(
            page.Section(
                "Outages",
                [
                    page.Table(
                        *drifts,
                        caption="Root mean square, and size in units of the bound with its exact 95 % interval.",
                        left=len(found) + 2,
                    )
                ],
            )
        )
    sections.append(page.Section("Starts with large errors", [page.Table(*start_rows(found), left=len(found) + 1)]))
    for j in found:
        failed = [f"{r.world.name}: {what}" for r in j.accused for what in r.what]
        more = [f"and {len(failed) - MOST} more in referee.json"] if len(failed) > MOST else []
        if failed:
            sections.append(
                page.Section(
                    j.name, [page.Text(j.verdict), page.Folded("Tests that fail", [page.Items(failed[:MOST] + more)])]
                )
            )
    sections.append(page.Section("How", [page.Items(how)]))
    cards = [
        page.Card(
            j.name, f"{len(j.accused)} of {len(j.right)} worlds", "errors not as stated" if j.accused else "nothing found",
            "bad" if j.accused else "good",
        )
        for j in found
    ]  # fmt: skip
    return page.Page(
        "Referee", sections, kind="referee", source=source, answer=referee_answer(found), cards=cards
    ).write(path)


def _length(one: Judgement) -> float:
    from insemu.referee import starts

    world = next(iter(starts().values()))
    given = world.keys["trajectory"]
    return float(str(given["duration"]).split()[0]) - float(str(given["begin"]).split()[0])
