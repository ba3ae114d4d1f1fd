"""The page of a sweep: which sensor and which model for which outage, as heat maps, and what more states buy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from insemu.evaluate import Row, Sweep, best_of, conditions, front
from insemu.report.charts import INK, Chart, Line, View
from insemu.report.experiment_charts import colour
from insemu.report.page import Block, Card, Folded, Items, Page, Section, Table
from insemu.report.tables import Table as Cells
from insemu.shown import count_of
from insemu.units import conversion

#: What the columns are.
SWEPT = (
    "error: mean planimetric error at outage end over realizations and outages, with its 95 % interval. 95 % below: its quantile. stated: the "
    "filter's own horizontal sigma there. knows: whether the design knows its error."
)
#: Conditions side by side in one heat map, and told one by one in the answer.
WIDEST, TOLD = 10, 3


def sweep_rows(sweep: Sweep, rows: Sequence[Row]) -> Cells:
    """Header and body of the table, for terminal and page.

    Parameters
    ----------
    sweep : Sweep
    rows : sequence of Row
    """
    keys = [f.key for f in sweep.given]
    header = [*keys, "design", "error m", "knows", "stated", "states", "95 %", "95 % below"]
    body, before = [], 0
    for r in rows:
        interval = "" if r.low_m is None else f"{r.low_m:.3g}-{r.high_m:.3g}"
        named = [r.values[k] if r.point != before else "" for k in keys]
        body.append(
            [
                *named,
                r.design,
                f"{r.error_m:.3g}",
                r.knows,
                f"{r.stated_m:.3g}",
                str(r.states),
                interval,
                f"{r.quantile_95_m:.3g}",
            ]
        )
        before = r.point
    return header, body


def _values_text(values: Mapping[str, str], keys: Sequence[str]) -> str:
    return ", ".join(values[k] if k in ("trajectory", "sensor") else f"{k} {values[k]}" for k in keys)


def _choice(sweep: Sweep, row: Row) -> str:
    """Sensor, other choices and design of a row."""
    chosen = [f.key for f in sweep.given if f.key not in conditions(sweep)]
    return " with ".join(x for x in (_values_text(row.values, chosen), row.design) if x)


def _by_condition(sweep: Sweep, rows: Sequence[Row]) -> dict[str, list[Row]]:
    out: dict[str, list[Row]] = {}
    for row in rows:
        out.setdefault(_values_text(row.values, conditions(sweep)), []).append(row)
    return out


def sweep_answer(sweep: Sweep, rows: Sequence[Row]) -> str:
    """What to take, in one or a few sentences.

    Parameters
    ----------
    sweep : Sweep
    rows : sequence of Row
    """
    found = {where: best_of(own) for where, own in _by_condition(sweep, rows).items()}
    if len(found) <= TOLD:
        said = []
        for where, best in found.items():
            warned = "" if best.knows == "yes" else f", but none knows its error (stated {best.stated_m:.3g} m)"
            said.append(f"{where + ': take' if where else 'Take'} {_choice(sweep, best)}: {best.error_m:.3g} m{warned}")
        return "; ".join(said) + "."
    count: dict[str, int] = {}
    for best in found.values():
        count[_choice(sweep, best)] = count.get(_choice(sweep, best), 0) + 1
    first = max(count, key=lambda name: count[name])
    metres = [best.error_m for best in found.values() if _choice(sweep, best) == first]
    return (
        f"Take {first} at {count[first]} of {len(found)} points ({min(metres):.3g} to {max(metres):.3g} m)"
        + ("; " + ", ".join(f"{name} at {n}" for name, n in count.items() if name != first) if len(count) > 1 else "")
        + "."
    )


def _heat_maps(sweep: Sweep, rows: Sequence[Row]) -> list[Block]:
    """Metres by choice and condition, tinted on a logarithmic scale; what does not know its error is marked."""
    grouped = _by_condition(sweep, rows)
    choices = list(dict.fromkeys(_choice(sweep, r) for r in rows))
    sizes = [math.log(r.error_m) for r in rows if r.error_m > 0]
    low, span = min(sizes, default=0.0), max(max(sizes, default=0.0) - min(sizes, default=0.0), 1e-9)
    names, out = list(grouped), []
    for first in range(0, len(names), WIDEST):
        columns = names[first : first + WIDEST]
        best = {c: best_of(grouped[c]) for c in columns}
        body, heat = [], []
        for choice in choices:
            cells: list[str] = [choice]
            tints: list[float | None] = [None]
            for c in columns:
                row = next((r for r in grouped[c] if _choice(sweep, r) == choice), None)
                mark = "" if row is None else "*" * (row.knows == "optimistic") + " <" * (row is best[c])
                cells.append("" if row is None else f"{row.error_m:.3g}{mark}")
                tints.append(None if row is None or row.error_m <= 0 else (math.log(row.error_m) - low) / span)
            body.append(cells)
            heat.append(tints)
        caption = (
            "Planimetric error at outage end, m, tinted on a logarithmic scale. <: the one to take, of those that know their error the smallest "
            "or, where the data cannot tell, the one with fewer states. *: states less than it errs."
        )
        out.append(Table(["", *(c or "error" for c in columns)], body, caption if not first else "", heat=heat))
    return list(out)


def _pareto(sweep: Sweep, rows: Sequence[Row]) -> Chart:
    """Metres against states under every condition, with the front."""
    views: list[View] = []
    for where, own in _by_condition(sweep, rows).items():
        chosen = [f.key for f in sweep.given if f.key not in conditions(sweep)]
        kinds = list(dict.fromkeys(_values_text(r.values, chosen) or r.design for r in own))
        lines = []
        for k, kind in enumerate(kinds):
            mine = [r for r in own if (_values_text(r.values, chosen) or r.design) == kind]
            text = [f"{_choice(sweep, r)}: {r.error_m:.3g} m, {r.states} states, {r.knows}" for r in mine]
            lines.append(
                Line(
                    kind,
                    [r.error_m for r in mine],
                    colour(k),
                    points=True,
                    width=6.0,
                    x=[r.states for r in mine],
                    text=text,
                )
            )
        best = front(own)
        text = [f"{_choice(sweep, r)}: {r.error_m:.3g} m" for r in best]
        lines.append(
            Line("Pareto front", [r.error_m for r in best], INK, dashed=True, x=[r.states for r in best], text=text)
        )
        views.append(View(where or "All", "planimetric error (m)", lines, log_y=True, printed=not views))
    return Chart(
        "Metres against states",
        "Error of every choice against the number of states of its filter; no choice on the front is beaten by one with as few states.",
        None,
        "states of the filter",
        views,
        group="pareto",
    )


def _number(text: str) -> tuple[float, str]:
    value, _, unit = text.partition(" ")
    return float(value), unit.strip()


def _numeric(sweep: Sweep, rows: Sequence[Row]) -> dict[str, tuple[dict[str, float], str]]:
    """Keys that take different numbers of one dimension: each text's value, and the unit, which is that of the first."""
    out = {}
    for f in sweep.given:
        texts = list(dict.fromkeys(r.values[f.key] for r in rows))
        try:
            parsed = {text: _number(text) for text in texts}
            unit = parsed[texts[0]][1]
            values = {t: v * (conversion(u, unit) if u != unit else 1.0) for t, (v, u) in parsed.items()}
        except ValueError:
            continue
        if len(texts) > 1:
            out[f.key] = (values, unit)
    return out


def _against(sweep: Sweep, rows: Sequence[Row]) -> list[Block]:
    """Error against every key that is a number, and how much it depends on each."""
    from scipy.stats import spearmanr

    keys, designs = _numeric(sweep, rows), list(dict.fromkeys(r.design for r in rows))
    views: list[View] = []
    body = []
    for key, (values, unit) in keys.items():
        lines = []
        for d, design in enumerate(designs):
            placed = sorted(((values[r.values[key]], r) for r in rows if r.design == design), key=itemgetter(0))
            x, own = [at for at, _ in placed], [r for _, r in placed]
            text = [f"point {r.point}: {r.error_m:.3g} m, " + _values_text(r.values, list(r.values)) for r in own]
            lines.append(Line(design, [r.error_m for r in own], colour(d), points=True, width=5.0, x=x, text=text))
            found = spearmanr(x, [r.error_m for r in own]).statistic if len(own) > 2 else math.nan
            body.append([key, design, f"{found:+.2f}" if np.isfinite(found) else ""])
        views.append(
            View(f"{key} ({unit})" if unit else key, "planimetric error (m)", lines, log_y=True, printed=not views)
        )
    if not views:
        return []
    chart = Chart(
        "Error against each key",
        "Mean planimetric error at outage end at every point.",
        None,
        views[0].name if len(views) == 1 else "value of the key",
        views,
        group="keys",
    )
    table = Table(
        ["key", "design", "rank correlation"],
        body,
        "Spearman's rank correlation of the error with the key, over all points.",
        left=2,
    )
    return [chart, table]


def render_sweep(sweep: Sweep, rows: Sequence[Row], folder: str | Path) -> Path:
    """Write the page of a sweep into ``folder``/index.html.

    Parameters
    ----------
    sweep : Sweep
    rows : sequence of Row
    folder : path
    """
    keys = [f.key for f in sweep.given]
    grid = all(f.values for f in sweep.given)
    cards = []
    for where, own in list(_by_condition(sweep, rows).items())[:6] if grid else ():
        best = best_of(own)
        tone, verdict = ("good", "Knows its error") if best.knows == "yes" else ("bad", f"States {best.stated_m:.3g} m")
        cards.append(
            Card(
                where or "All", f"{best.error_m:.3g} m", verdict, tone, [_choice(sweep, best), f"{best.states} states"]
            )
        )
    way = (
        f"{count_of(sweep.linear, 'realization')} to first order"
        if sweep.linear
        else f"{count_of(sweep.scenario.realizations, 'realization')}"
    )
    if beyond := sorted({r.design for r in rows if r.by == "coarse"}):
        way += f" ({', '.join(beyond)}, not linear: runs at long steps, helped by the linear ones)"
    sections = []
    if grid:
        sections.append(Section("Which choice for which condition", _heat_maps(sweep, rows)))
        sections.append(Section("What more states buy", [_pareto(sweep, rows)]))
    if blocks := _against(sweep, rows):
        sections.append(Section("What the error depends on", blocks))
    table = Table(*sweep_rows(sweep, rows), SWEPT, left=len(keys) + 1)
    sections.append(Section("Every point", [Folded(f"{len(rows)} rows", [table])]))
    if why := [f"{r.design} at point {r.point}: {r.why}." for r in rows if r.why]:
        sections.append(Section("Designs that are not linear", [Folded(f"{len(why)} rows", [Items(why)])]))
    return Page(
        f"Sweep: {sweep.scenario.title}",
        sections,
        kind="sweep",
        source=str(sweep.file),
        answer=sweep_answer(sweep, rows),
        lead=f"{len(sweep.points)} points of {', '.join(keys)}, {way} each, the same draws at every point.",
        cards=cards,
    ).write(Path(folder) / "index.html", pictures=True)
