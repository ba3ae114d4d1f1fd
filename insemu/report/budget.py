"""Error budgets: where the error at the end of every outage comes from, design by design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure as MplFigure

from insemu.evaluate.covariance import CovarianceAnalysis
from insemu.report import page
from insemu.report.style import COLOURS, style

Windows = Sequence[tuple[float, float]]
#: Parts below this share of every bar are drawn together.
SMALL = 0.02


def budget_bars(analyses: Mapping[str, CovarianceAnalysis], windows: Windows, by: str = "process") -> MplFigure:
    """One stacked bar per outage and design: its height is the rms error, its parts are shares of the mean square."""
    shares = {name: [b.shares(by) for b in a.budgets] for name, a in analyses.items()}
    totals = {name: [sum(s.values()) for s in per] for name, per in shares.items()}
    weight: dict[str, float] = {}
    for name, per in shares.items():
        for s, total in zip(per, totals[name], strict=True):
            for key, value in s.items():
                weight[key] = max(weight.get(key, 0.0), value / total)
    named = sorted((k for k, v in weight.items() if v >= SMALL), key=lambda k: -weight[k])[: 2 * len(COLOURS)]
    with style():
        figure, axes = plt.subplots(
            1, len(windows), figsize=(3.2 + 2.2 * len(windows), 4.2), sharey=True, squeeze=False
        )
        for k, (ax, (start, duration)) in enumerate(zip(axes[0], windows, strict=True)):
            for x, name in enumerate(analyses):
                base, total = 0.0, totals[name][k]
                rms = float(np.sqrt(total))
                parts = [(key, shares[name][k].get(key, 0.0)) for key in named]
                parts.append(("the rest", total - sum(v for _, v in parts)))
                for i, (key, value) in enumerate(parts):
                    height = rms * value / total
                    colour = COLOURS[i % len(COLOURS)] if key != "the rest" else "#C4CAD1"
                    hatch = "//" if i >= len(COLOURS) and key != "the rest" else None
                    label = key if (k, x) == (0, 0) else None
                    ax.bar(
                        x, height, 0.7, bottom=base, color=colour, hatch=hatch, edgecolor="white", lw=0.5, label=label
                    )
                    base += height
                ax.annotate(f"{rms:.3g}", (x, rms), ha="center", va="bottom", fontsize=8.5)
            ax.set_xticks(range(len(analyses)), list(analyses), rotation=20 if len(analyses) > 2 else 0)
            ax.set_title(f"outage {k + 1}: {duration:g} s from {start / 60:g} min")
            ax.grid(axis="x", visible=False)
        axes[0, 0].set_ylabel("rms horizontal error (m)")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right upper", title=f"by {by}")
    return figure


def growth(analyses: Mapping[str, CovarianceAnalysis], windows: Windows) -> MplFigure:
    """True rms and stated sigma of the horizontal error over time, through all outages."""
    with style():
        figure, ax = plt.subplots(figsize=(10.0, 3.6))
        for (name, a), colour in zip(analyses.items(), COLOURS, strict=False):
            ax.semilogy(a.t / 60, np.hypot(a.rms[:, 0], a.rms[:, 1]), color=colour, label=f"{name}: true rms")
            ax.semilogy(
                a.t / 60, np.hypot(a.sigma[:, 0], a.sigma[:, 1]), color=colour, ls="--", label=f"{name}: stated"
            )
        for start, duration in windows:
            ax.axvspan(start / 60, (start + duration) / 60, color="#E9ECEF", zorder=0, lw=0)
        ax.set(xlabel="time (min)", ylabel="horizontal error (m)", title="What the error is, and what the filter says")
        ax.legend(ncols=2)
    return figure


def render_budgets(
    title: str, analyses: Mapping[str, CovarianceAnalysis], windows: Windows, folder: str | Path, *, by: str = "process"
) -> Path:
    """Write the page of a covariance analysis into ``folder``/index.html."""
    header = ["design", "outage", "rms m", "stated m", "part", "rms m of the part", "share %"]
    rows: list[list[str]] = []
    for name, a in analyses.items():
        for k, budget in enumerate(a.budgets):
            at = int(np.argmin(np.abs(a.t - budget.t)))
            total = budget.rms() ** 2
            for i, (key, value) in enumerate(list(budget.shares(by).items())[:8]):
                lead = (
                    [name, str(k + 1), f"{budget.rms():.3g}", f"{np.hypot(*a.sigma[at, :2]):.3g}"]
                    if i == 0
                    else [""] * 4
                )
                rows.append([*lead, key, f"{np.sqrt(value):.3g}", f"{100 * value / total:.1f}"])
    figures = [
        page.Figure.of(
            budget_bars(analyses, windows, by),
            "Height: rms horizontal error at the end of the outage. Parts: shares of the mean square (parts add up as squares).",
        ),
        page.Figure.of(
            growth(analyses, windows),
            "Solid: true rms of the design under the scenario's truth. Dashed: what the filter states.",
        ),
    ]
    return page.render(
        f"Error budget: {title}",
        [page.Section("Where the error comes from", [*figures, page.Table(header, rows, left=1)])],
        Path(folder) / "index.html",
        lead="Covariance analysis of truth and belief together; nothing was drawn.",
    )
