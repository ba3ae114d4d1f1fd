"""Error budgets: where the error at the end of every outage comes from, design by design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure as MplFigure

from insemu.evaluate import CovarianceAnalysis, outage_budgets
from insemu.report import page
from insemu.report.style import COLOURS, style

Windows = Sequence[tuple[float, float]]
#: Parts below this share of every bar are drawn together.
SMALL = 0.02
BARS = (
    "Height: rms horizontal error at the end of the outage. Parts: shares of the mean square (parts add up as squares)."
)


Budgets = Mapping[str, Sequence[Mapping[str, Any]]]


def budget_bars(budgets: Budgets, by: str = "process") -> MplFigure:
    """One stacked bar per outage and design: its height is the rms error, its parts are shares of the mean square.

    Parameters
    ----------
    budgets : mapping
        Of :func:`insemu.evaluate.comparison.outage_budgets`.
    by : str
        What the parts are, for the legend.
    """
    windows = [(b["start_s"], b["duration_s"]) for b in next(iter(budgets.values()))]
    shares = {n: [{k: v * v for k, v in b["parts_rms_m"].items()} for b in per] for n, per in budgets.items()}
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
            for x, name in enumerate(budgets):
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
            ax.set_xticks(range(len(budgets)), list(budgets), rotation=20 if len(budgets) > 2 else 0)
            ax.set_title(f"outage {k + 1}: {duration:g} s from {start / 60:g} min")
            ax.grid(axis="x", visible=False)
        axes[0, 0].set_ylabel("rms horizontal error (m)")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right upper", title=f"by {by}")
    return figure


def budget_table(budgets: Budgets) -> page.Table:
    """The largest parts of every bar."""
    header = ["design", "outage", "rms m", "stated m", "part", "rms m of the part", "share %"]
    rows: list[list[str]] = []
    for name, per in budgets.items():
        for k, b in enumerate(per):
            for i, (key, value) in enumerate(list(b["parts_rms_m"].items())[:8]):
                lead = [name, str(k + 1), f"{b['rms_m']:.3g}", f"{b['predicted_sigma_m']:.3g}"] if i == 0 else [""] * 4
                rows.append([*lead, key, f"{value:.3g}", f"{100 * (value / b['rms_m']) ** 2:.1f}"])
    return page.Table(header, rows, left=1)


def budget_lines(budgets: Budgets, parts: int = 3) -> list[str]:
    """The largest parts of every design at the end of the last outage, in words."""
    out = []
    for name, per in budgets.items():
        last = per[-1]
        top = ", ".join(f"{key} {value:.3g}" for key, value in list(last["parts_rms_m"].items())[:parts])
        out.append(
            f"{name}: rms {last['rms_m']:.3g} m at the end of outage {len(per)} (stated {last['predicted_sigma_m']:.3g}), of that {top}."
        )
    return out


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
    """Write the page of a covariance analysis into ``folder``/index.html.

    Parameters
    ----------
    title : str
    analyses : mapping of design to CovarianceAnalysis
    windows : sequence of (start_s, duration_s)
        The outages.
    folder : path
    by : {"process", "axis", "source"}
        What the parts of the budget are.
    """
    budgets = outage_budgets(analyses, windows, by)
    figures = [
        page.Figure.of(
            budget_bars(budgets, by),
            BARS,
        ),
        page.Figure.of(
            growth(analyses, windows),
            "Solid: true rms of the design under the scenario's truth. Dashed: what the filter states.",
        ),
    ]
    return page.render(
        f"Error budget: {title}",
        [page.Section("Where the error comes from", [*figures, budget_table(budgets)])],
        Path(folder) / "index.html",
        lead="Covariance analysis of truth and belief together; nothing was drawn.",
    )
