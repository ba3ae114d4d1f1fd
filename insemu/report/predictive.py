"""The page of a posterior predictive check: the recording among those emulated from a model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from insemu.report.charts import INK, Chart, Line, View
from insemu.report.page import Card, Items, Page, Section, Table, Text
from insemu.report.style import COLOURS

if TYPE_CHECKING:
    from insemu.gap import Check, GapReport


def render_check(checks: Mapping[str, Check], left: GapReport | None, folder: str | Path, source: str) -> Path:
    """Write ``index.html``.

    Parameters
    ----------
    checks : mapping of str to Check
        ``after`` and, where the nominal model was checked too, ``before``.
    left : GapReport, optional
        What a search on the model found.
    folder : path
    source : str
        The recording.
    """
    last = checks["after"]
    o = last.outages
    chance = 0.05 * len(last.statistics)
    answer = (
        f"{last.outside} of {len(last.statistics)} statistics of the recording are outside the 95 % band of {last.recordings} emulated ones "
        f"(by chance {chance:.2g}), and {o.inside} of {o.starts.size} outages end inside their 90 % band."
    )
    cards = [
        Card(
            _model_text(name, checks),
            f"{c.outages.inside} of {c.outages.starts.size} outages inside",
            f"{c.outside} of {len(c.statistics)} statistics outside 95 %",
            "good" if c.outages.inside >= 0.85 * c.outages.starts.size else "warn",
            [f"{c.recordings} emulated recordings"],
        )
        for name, c in checks.items()
    ]
    if left is not None:
        names = ", ".join(s.effect for s in left.findings)
        cards.append(Card("Searched again", left.verdict, names or "no effect", "plain", ["On the refined model."]))
    told = Text(
        "Motion: that of the recording. Noise and effects: drawn from the model. Fixes: at the recorded times with the recorded standard "
        "deviations. A measured value whose percentile is near 0 or 100 is one that the model does not make."
    )
    sections = [
        Section("Metres", [_chart(checks)]),
        Section(
            "Statistics of the innovations",
            [
                told,
                *([Items(list(last.assumed))] if last.assumed else []),
                *(_table(_model_text(name, checks), c) for name, c in checks.items()),
            ],
        ),
    ]
    title = f"A recording among emulated ones: {Path(source).name}"
    return Page(title, sections, kind="gap-check", source=source, answer=answer, cards=cards).write(
        Path(folder) / "index.html"
    )


def _model_text(name: str, checks: Mapping[str, Check]) -> str:
    """A model as the page calls it."""
    return f"The model {name}" if len(checks) > 1 else "The model"


def _chart(checks: Mapping[str, Check]) -> Chart:
    """Errors at the end of outages, measured and the band of the emulated, model by model."""
    views = []
    for name, c in reversed(list(checks.items())):
        o = c.outages
        lines = [
            Line("measured", o.measured, INK, points=True, width=5.0),
            Line("emulated, 5 %", o.low, COLOURS[0]),
            Line("emulated, 95 %", o.high, COLOURS[0], fill_to=1),
            Line("emulated, median", o.middle, COLOURS[0], dashed=True),
        ]
        views.append(View(_model_text(name, checks), "horizontal error (m)", lines, log_y=True, x=o.starts))
    caption = "Horizontal error after 60 s without fixes, outage by outage: measured, and the middle 90 % of what the model makes."
    return Chart("Outages", caption, None, "start of the outage (s)", views)


def _table(name: str, c: Check) -> Table:
    rows = [
        [
            s.name,
            s.where,
            f"{s.measured:.3g}",
            f"{s.low:.3g} to {s.high:.3g}",
            f"{100.0 * s.percentile:.1f}",
        ]
        for s in c.statistics
    ]
    heads = ("statistic", "of", "measured", "emulated, 95 %", "percentile")
    strong = frozenset(k for k, s in enumerate(c.statistics) if s.outside)
    return Table(heads, rows, f"{name}; outside the 95 % band in bold", left=2, strong=strong)
