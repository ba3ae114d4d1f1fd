"""Error budgets: where the error at the end of every outage comes from, design by design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from insemu.evaluate import CovarianceAnalysis, outage_budgets
from insemu.report import page
from insemu.report.charts import Chart, Line, View, positive, strokes
from insemu.report.style import COLOURS

Windows = Sequence[tuple[float, float]]
#: Outages that have a bar: the last, and so many of those with the largest errors.
BARS_OF = 20
#: Parts below this share of every bar are drawn together.
SMALL = 0.02
BARS = (
    "Height: rms horizontal error at the end of the outage. Parts: shares of the mean square (parts add up as squares)."
)


Budgets = Mapping[str, Sequence[Mapping[str, Any]]]


def budget_chart(budgets: Budgets, by: str = "process") -> Chart:
    """One stacked bar per design, an outage at a time: its height is the rms error, its parts are shares of the mean square.

    Parameters
    ----------
    budgets : mapping
        Of :func:`insemu.evaluate.comparison.outage_budgets`.
    by : str
        What the parts are.
    """
    windows = [(b["start_s"], b["duration_s"]) for b in next(iter(budgets.values()))]
    shares = {n: [{k: v * v for k, v in b["parts_rms_m"].items()} for b in per] for n, per in budgets.items()}
    weight: dict[str, float] = {}
    for s in (s for per in shares.values() for s in per):
        for key, value in s.items():
            weight[key] = max(weight.get(key, 0.0), value / sum(s.values()))
    named = sorted((k for k, v in weight.items() if v >= SMALL), key=lambda k: -weight[k])[: len(COLOURS)]
    views = []
    # of many outages those with the largest errors
    largest = sorted(range(len(windows)), key=lambda k: -max(per[k]["rms_m"] for per in budgets.values()))[:BARS_OF]
    for k, (start, duration) in enumerate(windows):
        if k not in largest and k != len(windows) - 1:
            continue
        base = dict.fromkeys(budgets, 0.0)
        lines = []
        for key, colour in zip((*named, "the rest"), (*COLOURS[: len(named)], "#C4CAD1"), strict=True):
            ends, words = [], []
            for name in budgets:
                s = shares[name][k]
                total = sum(s.values())
                part = s.get(key, 0.0) if key != "the rest" else total - sum(s.get(n, 0.0) for n in named)
                rms = float(np.sqrt(total))
                ends.append((base[name], base[name] + rms * part / total))
                base[name] = ends[-1][1]
                words.append(f"{name}: {np.sqrt(max(part, 0.0)):.3g} m, {100 * part / total:.1f} % of the mean square")
            x, y, said = strokes(range(len(budgets)), ends, words)
            lines.append(Line(key, y, colour, x=x, text=said, width=34.0))
        totals = [(float(x), base[name], f"{base[name]:.3g} m") for x, name in enumerate(budgets)]
        ticks = [(float(x), name) for x, name in enumerate(budgets)]
        title = f"Outage {k + 1}: {duration:g} s from {start / 60:.3g} min"
        views.append(View(title, "rms horizontal error (m)", lines, ticks=ticks, labels=totals))
    # the last outage first: the longest flight, and the one that the words are about
    return Chart("Budget", f"{BARS} Parts by {by}.", None, "design", views[::-1], group="budget")


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


def budget_lines(budgets: Budgets) -> list[str]:
    """The largest parts of every design at the end of the last outage, in words."""
    out = []
    for name, per in budgets.items():
        last = per[-1]
        top = ", ".join(f"{key} {value:.3g}" for key, value in list(last["parts_rms_m"].items())[:3])
        out.append(
            f"{name}: rms {last['rms_m']:.3g} m at the end of outage {len(per)} (stated {last['predicted_sigma_m']:.3g}), of that {top}."
        )
    return out


def growth(analyses: Mapping[str, CovarianceAnalysis], windows: Windows) -> Chart:
    """True rms and stated sigma of the horizontal error over time, through all outages."""
    lines = []
    for (name, a), colour in zip(analyses.items(), COLOURS, strict=False):
        lines += [
            Line(name, positive(np.hypot(a.rms[:, 0], a.rms[:, 1])), colour),
            Line(f"{name}: stated", positive(np.hypot(a.sigma[:, 0], a.sigma[:, 1])), colour, dashed=True, of=name),
        ]
    t = next(iter(analyses.values())).t
    return Chart(
        "Error growth",
        "Solid: true rms of the design under the scenario's truth. Dashed: what the filter states.",
        t / 60.0,
        "time (min)",
        [View("Horizontal error", "horizontal error (m)", lines, log_y=True)],
        [(start / 60, (start + duration) / 60) for start, duration in windows],
    )


def render_budgets(
    title: str,
    analyses: Mapping[str, CovarianceAnalysis],
    windows: Windows,
    folder: str | Path,
    *,
    by: str = "process",
    source: str = "",
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
    source : str
        The scenario's file.
    """
    budgets = outage_budgets(analyses, windows, by)
    last = {name: per[-1] for name, per in budgets.items()}
    best = min(last, key=lambda name: last[name]["rms_m"])
    cards = [
        page.Card(
            name,
            f"{b['rms_m']:.3g} m",
            f"states {b['predicted_sigma_m']:.3g} m",
            notes=[", ".join(f"{key} {value:.3g} m" for key, value in list(b["parts_rms_m"].items())[:3])],
        )
        for name, b in last.items()
    ]
    where = page.Section(
        "Where the error comes from",
        [budget_chart(budgets, by), growth(analyses, windows), page.Folded("Every part", [budget_table(budgets)])],
    )
    return page.Page(
        f"Error budget: {title}",
        [where],
        kind="compare",
        source=source,
        answer=f"{best} has the smallest error at the end of the last outage: {last[best]['rms_m']:.3g} m, of which it states "
        f"{last[best]['predicted_sigma_m']:.3g}.",
        lead="Covariance analysis of truth and belief together; nothing was drawn.",
        cards=cards,
    ).write(Path(folder) / "index.html")
