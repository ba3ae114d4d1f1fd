"""Rows of the tables that terminal and page share: one place decides what stands in them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from insemu.evaluate import Results, outage_table


def log_distance(results: Results) -> float | None:
    """Root mean square of ln(ours / published) over all published cells, or None where nothing is published."""
    table = outage_table(results)
    ratios = [
        math.log(table[name][k]["planimetric_end_m"]["mean"] / value)
        for name, values in results.published.items()
        for k, value in enumerate(values)
        if k < len(results.outages)
    ]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def short(value: float) -> str:
    """A figure in at most six characters."""
    return f"{value:.2f}" if value < 100 else f"{value:.0f}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def variant_rows(main: Results, variants: Mapping[str, Results]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: variant, design, planimetric error per outage, pooled ratio to the first design with interval, mean altitude error, NEES per
    degree of freedom, share of position errors inside 3 sigma during outages, and rms of ln(ours / published) over all cells.
    """
    outages = [f"{start / 60:g} min" for start, _ in main.outages]
    header = ["variant", "design", *outages, "ratio", "95 %", "altitude", "NEES", "inside %"]
    has_published = any(r.published for r in (main, *variants.values()))
    if has_published:
        header.append("ln rms")
    body: list[list[str]] = []
    if main.published:
        for i, (name, values) in enumerate(main.published.items()):
            body.append(
                [
                    "published" if i == 0 else "",
                    name,
                    *(f"{v:g}" for v in values),
                    *[""] * (len(header) - 2 - len(values)),
                ]
            )
    for label, results in {"default": main, **variants}.items():
        table = outage_table(results)
        for i, name in enumerate(results.names):
            rows = table[name]
            if i == 0:
                against = ["", ""]
            else:
                c = results.comparison(name, results.names[0])
                against = [f"{c.ratio:.2f}", "" if c.low is None else f"{c.low:.2f}-{c.high:.2f}"]
            cells = [
                label if i == 0 else "",
                name,
                *(f"{r['planimetric_end_m']['mean']:.3g}" for r in rows),
                *against,
                f"{np.mean([r['altimetric_end_m'] for r in rows]):.3g}",
                short(float(results.nees[results.names.index(name)].mean()) / 9.0),
                f"{100 * np.mean([r['coverage_3sigma']['position'] for r in rows]):.1f}",
            ]
            if has_published:
                distance = log_distance(results) if i == 0 else None
                cells.append("" if distance is None else f"{distance:.2f}")
            body.append(cells)
    return header, body
