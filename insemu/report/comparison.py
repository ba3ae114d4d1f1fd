"""The pages of designs side by side, and of designs together with their baseline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from insemu.report import page
from insemu.report.charts import GREY, Chart, Line, View, strokes
from insemu.report.experiment_charts import colour, end_chart, error_chart
from insemu.report.tables import Table
from insemu.shown import count_of

if TYPE_CHECKING:
    from insemu.evaluate import Change, ComparisonRow, Results

#: What the columns of a comparison are.
COLUMNS = (
    "ratio: mean over the base's mean, with its 95 % interval over paired realizations. effect: mean of the paired differences over their "
    "spread. one run: that spread over the base's mean, how far a single run scatters."
)


def comparison_rows(rows: Sequence[ComparisonRow]) -> Table:
    """Header and body of a comparison, for terminal and page."""
    header = ["design", "outage", "rank", "mean m", "ratio", "95 %", "p", "effect", "one run"]
    body = [
        [
            r.design,
            "all" if r.outage is None else str(r.outage),
            str(r.rank),
            f"{r.mean_m:.3g}",
            "" if r.ratio is None else f"{r.ratio:.3f}",
            "" if r.low is None else f"{r.low:.3f}-{r.high:.3f}",
            "" if r.p_value is None else f"{r.p_value:.4f}",
            "" if r.effect_size is None else f"{r.effect_size:+.2f}",
            "" if r.one_run is None else f"±{r.one_run:.3f}",
        ]
        for r in rows
    ]
    return header, body


def _difference(row: ComparisonRow) -> tuple[str, str]:
    """A design together with the base in words, and the tone of that."""
    found = row.pair
    if found is None:
        return "the base", "plain"
    if not found.different:
        return f"the same within {100 * found.within:.2g} %" if found.same else "no difference shown", "plain"
    if found.ratio < 1:
        return f"{100 * (1 - found.ratio):.2g} % smaller", "good"
    return f"{found.ratio:.2f} times as large", "bad"


def _against(row: ComparisonRow, base: str) -> str:
    """The difference with the base's name."""
    word = _difference(row)[0]
    return f"{word} than {base}'s" if word.endswith("smaller") else f"{word} against {base}"


def comparison_answer(rows: Sequence[ComparisonRow], base: str) -> str:
    """Which design has the smallest error over all outages, in one sentence."""
    pooled = [r for r in rows if r.outage is None] or list(rows)
    best = min(pooled, key=lambda r: r.rank)
    said = f"{best.design} has the smallest planimetric error at outage end: {best.mean_m:.3g} m"
    others = [f"{r.design} {r.mean_m:.3g} m ({_difference(r)[0]})" for r in pooled if r.design != best.design]
    word = "" if best.design == base else f" ({_against(best, base)})"
    return f"{said}{word}" + (f"; {', '.join(others)}." if others else ".")


def render_comparison(
    results: Results, rows: Sequence[ComparisonRow], base: str, folder: str | Path, *, source: str = ""
) -> Path:
    """Write the page of a flown comparison into ``folder``/index.html.

    Parameters
    ----------
    results : Results
    rows : sequence of ComparisonRow
    base : str
        Design that the others are measured against.
    folder : path
    source : str
        The scenario's file.
    """
    pooled = [r for r in rows if r.outage is None] or [r for r in rows if r.outage == 1]
    cards = []
    for r in pooled:
        word, tone = _difference(r)
        notes = [f"rank {r.rank}" + ("" if r.low is None else f"; ratio {r.ratio:.3f} ({r.low:.3f} to {r.high:.3f})")]
        cards.append(page.Card(r.design, f"{r.mean_m:.3g} m", word[:1].upper() + word[1:], tone, notes))
    return page.Page(
        f"Designs side by side: {results.title}",
        [
            page.Section(
                "Ratios", [_ratio_chart(rows, results.names, base), page.Table(*comparison_rows(rows), COLUMNS)]
            ),
            page.Section("Errors", [end_chart(results), error_chart(results)]),
        ],
        kind="compare",
        source=source,
        answer=comparison_answer(rows, base),
        lead=f"Planimetric error at outage end, {count_of(results.realizations, 'realization')} in which every design flies the same data, "
        f"against {base}.",
        cards=cards,
    ).write(Path(folder) / "index.html")


def _ratio_chart(rows: Sequence[ComparisonRow], names: Sequence[str], base: str) -> Chart:
    """Ratios to the base with their intervals, outage by outage."""
    outages = list(dict.fromkeys(r.outage for r in rows))
    lines = []
    for d, name in enumerate(n for n in names if n != base):
        own = [
            (k, r)
            for k, o in enumerate(outages)
            for r in rows
            if r.design == name and r.outage == o and r.ratio is not None
        ]
        at = [k + 0.12 * d for k, _ in own]
        ratios = [r.ratio if r.ratio is not None else math.nan for _, r in own]
        ends = [(r.low, r.high) if r.low is not None and r.high is not None else (math.nan, math.nan) for _, r in own]
        words = [f"{v:.3f} ({low:.3f} to {high:.3f})" for v, (low, high) in zip(ratios, ends, strict=True)]
        x, y, said = strokes(at, ends, words)
        hue = colour(list(names).index(name))
        lines.append(Line(f"{name}: 95 %", y, hue, x=x, text=said, width=4.0, of=name))
        lines.append(Line(name, ratios, hue, points=True, width=5.0, x=at, text=words))
    lines.append(Line(f"{base} (base)", [1.0, 1.0], GREY, dashed=True, x=[-0.5, len(outages) - 0.5], text=["1", "1"]))
    ticks = [(float(k), "all" if o is None else f"outage {o}") for k, o in enumerate(outages)]
    view = View("Ratio", f"mean error / {base}'s", lines, ticks=ticks)
    return Chart(
        "Ratios",
        "Mean error over the base's with its 95 % interval; below 1 is better.",
        None,
        "",
        [view],
        group="ratios",
    )


def regression_answer(changes: Sequence[Change], false_alarm: float) -> str:
    """Whether the designs changed, in one sentence."""
    changed = [c for c in changes if c.significant]
    chance = f"an unchanged set is reported with probability {false_alarm:g}"
    if not changed:
        return f"No change in {len(changes)} figures ({chance})."
    designs = ", ".join(dict.fromkeys(c.design for c in changed))
    return f"{len(changed)} of {len(changes)} figures changed, of {designs} ({chance})."


def render_regression(
    changes: Sequence[Change],
    false_alarm: float,
    path: str | Path,
    *,
    source: str = "",
    about: Mapping[str, str] | None = None,
    more: Sequence[page.Section] = (),
) -> Path:
    """Write the page of a check against a baseline: what changed, as a difference, then every figure.

    Parameters
    ----------
    changes : sequence of Change
    false_alarm : float
        Probability that an unchanged set of designs is reported at all.
    path : path
        HTML file.
    source : str
        The scenario's file.
    about : mapping, optional
        What was compared: name to value.
    more : sequence of Section
        Of the same results.
    """
    changed = [c for c in changes if c.significant]
    cards = []
    for design in dict.fromkeys(c.design for c in changes):
        own = sorted((c for c in changed if c.design == design), key=lambda c: -abs(c.t))
        verdict = f"{len(own)} figures changed" if own else "Unchanged"
        first = f"{own[0].figure}: {own[0].before:.4g} to {own[0].now:.4g}" if own else "as recorded"
        cards.append(page.Card(design, first, verdict, "bad" if own else "good"))
    header = ["design", "figure", "was", "is", "change %", "t", "allowed", "smallest change seen %"]

    def row(c: Change) -> list[str]:
        part, least = (100 * v / abs(c.before) if c.before else math.nan for v in (c.now - c.before, c.detectable))
        return [
            c.design,
            c.figure,
            f"{c.before:.4g}",
            f"{c.now:.4g}",
            f"{part:+.2g}",
            f"{c.t:.1f}",
            f"{c.threshold:.1f}",
            f"{least:.2g}",
        ]

    at = np.arange(len(changes), dtype=float)
    said = [f"{c.design}, {c.figure}: {c.before:.4g} to {c.now:.4g}" for c in changes]
    lines = []
    for label, hue, kept in (("unchanged", GREY, False), ("changed", "#D00000", True)):
        which = [k for k, c in enumerate(changes) if c.significant == kept]
        if which:
            values = [changes[k].t / changes[k].threshold for k in which]
            lines.append(Line(label, values, hue, points=True, width=5.0, x=at[which], text=[said[k] for k in which]))
    for bound, of in ((-1.0, ""), (1.0, "allowed")):
        lines.append(
            Line("allowed", [bound] * 2, GREY, dashed=True, of=of, x=[-1.0, float(len(changes))], text=["allowed"] * 2)
        )
    chart = Chart(
        "Changes",
        "Every figure's change over what chance is allowed; hover says which.",
        None,
        "figure",
        [View("Changes", "change / allowed", lines, ticks=[(float(at[0]), ""), (float(at[-1]), "")])],
        group="changes",
    )
    tables = [page.Table(header, [row(c) for c in changed], "What changed", left=2)] if changed else []
    every = page.Folded("Every figure", [page.Table(header, [row(c) for c in changes], left=2)])
    return page.Page(
        "Designs against their baseline",
        [page.Section("What changed", [*tables, chart, every]), *more],
        kind="regress",
        source=source,
        answer=regression_answer(changes, false_alarm),
        lead="; ".join(f"{key} {value}" for key, value in (about or {}).items()),
        cards=cards,
    ).write(path)
