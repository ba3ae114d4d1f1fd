"""The page of a fit with regressors: coefficients, the signal and what the regressors make of it, the noise that is left."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.fit import RegressedFit
from insemu.report import page
from insemu.report.charts import INK, RED, Chart, Line, View, familiar
from insemu.report.fit import parameters_table, residuals, verdict_cards
from insemu.units import datasheet

#: Points of a drawn signal: means over blocks.
POINTS = 600
#: Level at which a coefficient counts.
LEAST_P = 0.05


def coefficient_rows(found: RegressedFit) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the coefficients."""
    factor, unit = datasheet(1.0, found.result.unit)
    header = ["regressor", "coefficient per unit \u00b1 error", "95 % interval", "p"]
    rows = [
        [
            c.name,
            f"{factor * c.value:.4g} \u00b1 {factor * c.standard_error:.2g} {unit}".rstrip(),
            f"{factor * c.low:.4g} \u2026 {factor * c.high:.4g}",
            f"{c.p_value:.2g}",
        ]
        for c in found.coefficients
    ]
    return header, rows


def _means(x: np.ndarray, m: int) -> np.ndarray:
    count = x.size // m
    return np.asarray(x[: count * m].reshape(count, m).mean(axis=1))


def _signals(results: Mapping[str, RegressedFit]) -> Chart:
    views = []
    for axis, f in results.items():
        m = max(1, f.residual.size // POINTS)
        t = _means(np.arange(f.residual.size) / f.result.rate_hz, m)
        lines = [
            Line("signal", _means(f.residual + f.part, m), INK),
            Line("regressors", _means(f.part, m), RED, width=2.2),
        ]
        lines, unit = familiar(lines, f.result.unit)
        views.append(View(axis, f"signal ({unit})", lines, x=t))
    caption = "Means of the signal without its mean, and the part that the regressors make up."
    return Chart("Signal and regressors", caption, None, "time (s)", views, group="time")


def regressed_answer(results: Mapping[str, RegressedFit]) -> str:
    """Which regressors the signals depend on, in one sentence."""
    on: dict[str, list[str]] = {}
    for axis, f in results.items():
        for c in f.coefficients:
            on.setdefault(c.name, []).extend([axis] if c.p_value < LEAST_P else [])
    if len(results) > 1:
        return "; ".join(f"{name}: counts on {len(axes)} of {len(results)} axes" for name, axes in on.items()) + "."
    (axis, f), seen, not_seen = (
        next(iter(results.items())),
        [n for n, a in on.items() if a],
        [n for n, a in on.items() if not a],
    )
    told = f"{axis} depends on {', '.join(seen)} ({f.explained:.1%} of its variance)" if seen else axis
    return told + (f"{';' if seen else ':'} no sign of {', '.join(not_seen)}" if not_seen else "") + "."


def render_regressed(results: Mapping[str, RegressedFit], path: str | Path, *, source: str = "") -> Path:
    """Write one self-contained page: coefficients, signal and regressors, the noise that is left.

    Parameters
    ----------
    results : mapping
        Axis to fit.
    path : path
        HTML file.
    source : str
        The log that was fitted.
    """
    fits = {axis: f.result for axis, f in results.items()}
    explained = {axis: f"{f.explained:.1%} of the variance" for axis, f in results.items()}
    blocks: list[page.Block] = []
    for axis, f in results.items():
        heading, rows = coefficient_rows(f)
        blocks.append(page.Table(heading, rows, caption=axis, left=1))
    detail = [page.Folded(f"{axis}: noise", [parameters_table(fit)]) for axis, fit in fits.items()]
    sections = [
        page.Section("Regressors", [*blocks, _signals(results)]),
        page.Section("Noise", [residuals(fits), *detail]),
    ]
    return page.Page(
        "Signal with regressors" + (f": {Path(source).name}" if source else ""),
        sections,
        kind="fit",
        source=source,
        answer=regressed_answer(results),
        cards=verdict_cards(fits, explained),
    ).write(path)
