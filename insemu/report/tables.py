"""Rows of the tables that terminal and page share: one place decides what stands in them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from insemu.evaluate import Results, headline, outage_table, rank_agreement


def log_distance(results: Results) -> float | None:
    """Root mean square of ln(ours / published) over all published cells, or None where nothing is published."""
    table = outage_table(results)
    ratios = [
        math.log(headline(results, table[name][k]) / value)
        for name, values in results.published.items()
        for k, value in enumerate(values)
        if k < len(results.outages)
    ]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def rank_lines(results: Results) -> list[str]:
    """How our ranking of the designs agrees with the paper's, in words."""
    taus = rank_agreement(results)
    if not taus:
        return []
    each = ", ".join(f"{tau:+.2f}" for tau in taus)
    return [
        f"Kendall's rank agreement with the published order of the designs, per outage: {each}; mean {np.mean(taus):+.2f}."
    ]


def short(value: float) -> str:
    """A figure in at most six characters."""
    return f"{value:.2f}" if value < 100 else f"{value:.0f}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def variant_caption(results: Results) -> str:
    """What the error columns of :func:`variant_rows` are."""
    when = "during the outage" if results.published_figure == "planimetric_mean_m" else "at outage end"
    return f"Mean planimetric error {when}, m"


def _published_rows(results: Results, columns: int, width: int) -> list[list[str]]:
    rows = []
    for i, (name, values) in enumerate(results.published.items()):
        cells = [f"{v:g}" for v in values] + [""] * (columns - len(values))
        rows.append(["published" if i == 0 else "", name, *cells, *[""] * (width - 2 - columns)])
    return rows


def variant_rows(main: Results, variants: Mapping[str, Results]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: variant, design, planimetric error per outage, pooled ratio to the first design with interval, mean altitude error,
    NEES per degree of freedom, share of position errors inside 3 sigma during outages, and rms of ln(ours / published) over all cells.
    """
    everything = {"default": main, **variants}
    columns = max(len(r.outages) for r in everything.values())
    same = all(list(r.outages) == list(main.outages) for r in everything.values())
    outages = (
        [f"{start / 60:.3g} min" for start, _ in main.outages] if same else [f"no. {k + 1}" for k in range(columns)]
    )
    header = ["variant", "design", *outages, "ratio", "95 %", "altitude", "NEES", "inside %"]
    if any(r.published for r in everything.values()):
        header.append("ln rms")
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
                *(f"{headline(results, r):.3g}" for r in rows),
                *[""] * (columns - len(rows)),
                *against,
                f"{np.mean([r['altimetric_end_m'] for r in rows]):.3g}" if rows else "",
                short(float(results.nees[i].mean()) / 9.0),
                f"{100 * np.mean([r['coverage_3sigma']['position'] for r in rows]):.1f}" if rows else "",
            ]
            if header[-1] == "ln rms":
                distance = log_distance(results) if i == 0 else None
                cells.append("" if distance is None else f"{distance:.2f}")
            body.append(cells)
    return header, body
