"""Rows of the tables that terminal and page share: one place decides what stands in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from insemu.evaluate import (
    Results,
    consistency_words,
    figure_of,
    kendall,
    outage_rows,
    outage_table,
    published_cells,
    rank_agreement,
    single_run_agreement,
)

#: What the published figures are, in words.
FIGURES = {
    "planimetric_end_m": "planimetric error at outage end",
    "planimetric_mean_m": "mean planimetric error during the outage",
    "planimetric_max_m": "largest planimetric error during the outage",
    "north_max_m": "largest error north during the outage",
    "east_max_m": "largest error east during the outage",
    "down_max_m": "largest error down during the outage",
}
Table = tuple[list[str], list[list[str]]]


def log_distance(results: Results) -> float | None:
    """Root mean square of ln(ours / published) over all cells of the first published figure, or None where nothing is published."""
    cells = published_cells(results, results.headline_figure)
    return float(np.sqrt(np.mean([math.log(ours / theirs) ** 2 for _, _, ours, theirs in cells]))) if cells else None


Cell = Callable[[Mapping[str, Any]], str]
#: Cells that hold no value.
NONE = ("", "-", "nan", "nan%")


def _figure(key: str) -> Cell:
    return lambda row: f"{row[key]:.3g}"


def _percent(group: str, sign: str = "") -> Cell:
    return lambda row: f"{100 * row[f'coverage_3sigma_{group}']:.1f}{sign}"


def _interval(between: str) -> Cell:
    def cell(row: Mapping[str, Any]) -> str:
        low, high = row["planimetric_end_m_low"], row["planimetric_end_m_high"]
        return "" if low is None else f"{low:.3g}{between}{high:.3g}"

    return cell


def _first(text: Cell) -> Cell:
    return lambda row: text(row) if row["outage"] == 1 else ""


def _published(row: Mapping[str, Any]) -> str:
    return "" if row["published"] is None else f"{row['published']:g}"


def _nees(row: Mapping[str, Any]) -> str:
    return short(row["nees_per_dof"])


def _filled(columns: Sequence[tuple[str, Cell]], rows: Sequence[Mapping[str, Any]]) -> Table:
    """A table without the columns that have no value in any row, such as errors of the attitude where no reference has one."""
    cells = [[cell(row) for row in rows] for _, cell in columns]
    kept = [k for k, column in enumerate(cells) if not rows or any(text not in NONE for text in column)]
    return [columns[k][0] for k in kept], [[cells[k][row] for k in kept] for row in range(len(rows))]


def short_headline(results: Results) -> Table:
    """The headline table for a terminal: what decides stands first, so that 80 columns show it."""
    main = results.headline_figure
    columns: list[tuple[str, Cell]] = [
        ("design", _first(lambda row: f"{row['design']} ({row['states']})")),
        ("verdict", lambda row: row["verdict"]),
        ("outage", lambda row: f"{row['start_s'] / 60:.3g} min"),
        ("error m", _figure(main)),
        ("stated", _figure("predicted_sigma_end_m")),
        ("in 3 s", _percent("position", "%")),
        ("NEES", _nees),
        ("alt. m", _figure("altimetric_end_m")),
    ]
    if results.published:
        columns.insert(4, ("paper", lambda row: _published(row) or "-"))
    if main == "planimetric_end_m":
        columns.append(("95 %", _interval("-")))
    return _filled(columns, outage_rows(results))


def page_headline(results: Results) -> Table:
    """The headline table for a page: what decides, as wide as a page is."""
    main = results.headline_figure
    columns: list[tuple[str, Cell]] = [
        ("design", _first(lambda row: row["design"])),
        ("outage", lambda row: f"{row['start_s'] / 60:.3g} min, {row['duration_s']:g} s"),
        ("verdict", lambda row: row["verdict"]),
        ("error m", _figure(main)),
        ("stated m", _figure("predicted_sigma_end_m")),
        ("NEES/dof", _nees),
        ("cover %", _percent("position")),
        ("altitude m", _figure("altimetric_end_m")),
    ]
    if main == "planimetric_end_m":
        columns.insert(4, ("95 %", _interval(" to ")))
    if results.published:
        columns.insert(4, ("published", _published))
    return _filled(columns, outage_rows(results))


def full_headline(results: Results) -> Table:
    """Every figure of every outage."""
    columns: list[tuple[str, Cell]] = [
        ("design", _first(lambda row: row["design"])),
        ("states", _first(lambda row: str(row["states"]))),
        ("outage", lambda row: f"{row['start_s'] / 60:.3g} min, {row['duration_s']:g} s"),
        ("verdict", lambda row: row["verdict"]),
        ("at end m", _figure("planimetric_end_m")),
        ("95 %", _interval(" to ")),
        ("mean m", _figure("planimetric_mean_m")),
        ("max m", _figure("planimetric_max_m")),
        ("altitude m", _figure("altimetric_end_m")),
        ("velocity m/s", _figure("velocity_end_m_s")),
        ("attitude deg", _figure("attitude_end_deg")),
        ("stated sigma m", _figure("predicted_sigma_end_m")),
        ("cover position %", _percent("position")),
        ("velocity %", _percent("velocity")),
        ("attitude %", _percent("attitude")),
        ("NEES/dof", _nees),
    ]
    if results.published:
        after = {"planimetric_mean_m": "mean m", "planimetric_max_m": "max m"}.get(results.headline_figure, "95 %")
        at = [heading for heading, _ in columns].index(after) + 1
        columns.insert(at, ("published", _published))
    return _filled(columns, outage_rows(results))


def published_table(results: Results, figure: str) -> Table:
    """A published figure next to ours, design by design: a row of ours and a row of the paper's, one column per outage."""
    cells = {(name, k): theirs for name, k, _, theirs in published_cells(results, figure)}
    table = outage_table(results)
    numbers = range(len(results.outages))
    body = []
    for name in results.names:
        body.append([name, "ours", *(f"{figure_of(table[name][k], figure):.3g}" for k in numbers)])
        if name in results.published[figure]:
            body.append(["", "paper", *(f"{cells[name, k]:g}" if (name, k) in cells else "-" for k in numbers)])
    return ["design", "", *(f"no. {k + 1}" for k in numbers)], body


def with_published(main: Results, variants: Mapping[str, Results]) -> list[tuple[str, Results]]:
    """The results with published figures of their own: the scenario's where it has several, and those of variants with others."""
    out: list[tuple[str, Results]] = []
    for label, results in {"default": main, **variants}.items():
        if results.published and results.published not in [r.published for _, r in out]:
            out.append((label, results))
    return out


def rank_lines(results: Results) -> list[str]:
    """How our ranking of the designs agrees with the paper's, in words."""
    lines = []
    for figure in results.published:
        taus = rank_agreement(results, figure)
        if taus:
            each = ", ".join(f"{tau:+.2f}" for tau in taus)
            lines.append(
                f"Kendall's rank agreement with the published order of the designs by {FIGURES[figure]}, per outage: {each}; "
                f"mean {np.mean(taus):+.2f}."
            )
            own = single_run_agreement(results, figure)
            if own.size:
                low, high = np.quantile(own, [0.05, 0.95])
                lines.append(
                    f"What a single drive can tell: one run of ours agrees with the means of the others by {own.mean():+.2f} on average "
                    f"(5 to 95 %: {low:+.2f} to {high:+.2f})."
                )
    return lines


def pooled_rank_line(main: Results, variants: Mapping[str, Results]) -> list[str]:
    """The agreement over all outages of a scenario whose variants bring published outages of their own."""
    distinct = [results for _, results in with_published(main, variants)]
    if len(distinct) < 2:
        return []
    figure = main.headline_figure
    taus = [tau for r in distinct for tau in rank_agreement(r, figure)]
    cells = [c for r in distinct for c in published_cells(r, figure)]
    names = list(dict.fromkeys(c[0] for c in cells))
    if not taus:
        return []
    ours, theirs = ([float(np.mean([c[i] for c in cells if c[0] == n])) for n in names] for i in (2, 3))
    return [
        f"Over all {len(taus)} published outages: mean of Kendall's rank agreements {np.mean(taus):+.2f}; of the designs' means over the outages "
        f"{kendall(ours, theirs):+.2f}."
    ]


def consistency_lines(results: Results) -> list[str]:
    """Per design, whether the filter knows its error, in words."""
    return [f"{name}: {'; '.join(consistency_words(results, name))}." for name in results.names]


def smoother_rows(results: Results) -> Table:
    """Filter and smoother through every outage."""
    header = ["design", "no.", "filter", "smooth", "ratio", "stated", "max f", "max s", "in 3 s", "NEES"]
    body = []
    for name, rows in outage_table(results).items():
        for k, row in enumerate(rows):
            s = row["smoothed"]
            body.append(
                [
                    name if k == 0 else "",
                    str(k + 1),
                    f"{s['filter_middle_rms_m']:.3g}",
                    f"{s['middle_rms_m']:.3g}",
                    f"{s['middle_rms_m'] / s['filter_middle_rms_m']:.2f}",
                    f"{s['predicted_sigma_middle_m']:.3g}",
                    f"{row['planimetric_max_m']:.3g}",
                    f"{s['planimetric_max_m']:.3g}",
                    f"{100 * s['coverage_3sigma']['position']:.1f}%",
                    short(s["nees_per_dof"]),
                ]
            )
    return header, body


SMOOTHED = (
    "Smoothed backwards. filter, smooth: horizontal rms error in the middle of the outage, m. stated: the smoother's sigma there. max f, max s: mean "
    "of the largest error of the outage, filtered and smoothed, m. in 3 s, NEES: of the smoother during it."
)


def short(value: float) -> str:
    """A figure in at most six characters."""
    return f"{value:.2f}" if value < 100 else f"{value:.0f}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def variant_caption(results: Results) -> str:
    """What the error columns of :func:`variant_rows` are."""
    words = FIGURES[results.headline_figure]
    return f"{words[:1].upper()}{words[1:]}, m"


def _published_rows(results: Results, columns: int, width: int) -> list[list[str]]:
    rows = []
    for i, name in enumerate(results.published[results.headline_figure]):
        printed = results.published[results.headline_figure][name]
        cells = ["" if value is None else f"{value:g}" for value in printed[:columns]]
        cells += [""] * (columns - len(cells))
        rows.append(["published" if i == 0 else "", name, *cells, *[""] * (width - 2 - columns)])
    return rows


def variant_rows(main: Results, variants: Mapping[str, Results]) -> Table:
    """Header and rows: variant, design, planimetric error per outage, pooled ratio to the first design with interval, mean altitude error,
    NEES per degree of freedom, share of position errors inside 3 sigma during outages, rms of ln(ours / published) over all cells, and the
    mean over the outages of Kendall's rank agreement with the published order of the designs.
    """
    everything = {"default": main, **variants}
    columns = max(len(r.outages) for r in everything.values())
    same = all(list(r.outages) == list(main.outages) for r in everything.values())
    outages: Sequence[str] = (
        [f"{start / 60:.3g} min" for start, _ in main.outages] if same else [f"no. {k + 1}" for k in range(columns)]
    )
    header = ["variant", "design", *outages, "ratio", "95 %", "altitude", "NEES", "inside %"]
    if any(r.published for r in everything.values()):
        header += ["ln rms", "tau"]
    body: list[list[str]] = []
    shown: Mapping[str, object] = {}
    for label, results in everything.items():
        if results.published and results.published != shown:
            body += _published_rows(results, columns, len(header))
            shown = results.published
        table = outage_table(results)
        for i, name in enumerate(results.names):
            rows = table[name]
            against = ["", ""]
            if i and rows:
                c = results.comparison(name, results.names[0])
                against = [f"{c.ratio:.2f}", "" if c.low is None else f"{c.low:.2f}-{c.high:.2f}"]
            cells = [
                label if i == 0 else "",
                name,
                *(f"{figure_of(r, results.headline_figure):.3g}" for r in rows),
                *[""] * (columns - len(rows)),
                *against,
                f"{np.mean([r['altimetric_end_m'] for r in rows]):.3g}" if rows else "",
                short(float(results.total.mean("nees", i).mean()) / 9.0),
                f"{100 * np.mean([r['coverage_3sigma']['position'] for r in rows]):.1f}" if rows else "",
            ]
            if header[-1] == "tau":
                distance, taus = (log_distance(results), rank_agreement(results)) if i == 0 else (None, [])
                cells.append("" if distance is None else f"{distance:.2f}")
                cells.append(f"{np.mean(taus):+.2f}" if taus else "")
            body.append(cells)
    return header, body
