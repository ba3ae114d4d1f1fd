"""The page of a fit with regressors: coefficients, the signal and what the regressors make of it, the noise that is left."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insemu.fit import RegressedFit
from insemu.report import page
from insemu.report.charts import INK, RED, Chart, Line, View
from insemu.report.fit import residuals

#: Points of a drawn signal: means over blocks.
POINTS = 600


def coefficient_rows(found: RegressedFit) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the coefficients."""
    header = ["regressor", "coefficient \u00b1 standard error", "95 % interval", "p"]
    unit = found.result.unit
    rows = [
        [
            c.name,
            f"{c.value:.4g} \u00b1 {c.standard_error:.2g} {unit}".rstrip(),
            f"{c.low:.4g} \u2026 {c.high:.4g}",
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
        views.append(View(axis, f"signal ({f.result.unit or 'unit'})", lines, x=t))
    caption = "Means of the signal without its mean, and the part that the regressors make up."
    return Chart("Signal and regressors", caption, None, "time (s)", views, group="time")


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
    cards = [
        page.Card(axis, f"{f.explained:.1%} of the variance", f.result.verdict.capitalize(), "good" if f.result.bears else "bad", [f.result.words])
        for axis, f in results.items()
    ]  # fmt: skip
    blocks: list[page.Block] = []
    for axis, f in results.items():
        heading, rows = coefficient_rows(f)
        blocks.append(page.Table(heading, rows, caption=axis, left=1))
    header = ("parameter", "estimate \u00b1 standard error", "95 % interval", "datasheet and discrete")
    detail = [page.Folded(f"{a}: noise", [page.Table(header, f.result.rows(), left=4)]) for a, f in results.items()]
    sections = [
        page.Section("Regressors", [*blocks, _signals(results)]),
        page.Section("Noise", [residuals({axis: f.result for axis, f in results.items()}), *detail]),
    ]
    certain = sum(c.p_value < 0.05 for f in results.values() for c in f.coefficients)
    total = sum(len(f.coefficients) for f in results.values())
    return page.render(
        "Signal with regressors" + (f": {Path(source).name}" if source else ""),
        sections,
        path,
        kind="fit",
        source=source,
        answer=f"{certain} of {total} coefficients differ from zero (5 %).",
        cards=cards,
    )
