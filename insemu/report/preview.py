"""The page of a preview to first order: what every design errs by at the ends of the outages, and which designs are not linear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from insemu.report.page import Items, Page, Section, Table
from insemu.report.tables import Table as Cells
from insemu.shown import count_of

#: What the columns are.
PREVIEWED = (
    "Planimetric error at outage end. mean and quantile 95 %: of the draws. 95 %: interval of the mean. rms: of a linear design without a draw, "
    "from its covariance. stated: the filter's own horizontal sigma. by: linear, or coarse for a design that is not linear: its runs at long "
    "steps, helped by the linear realizations where these correlate with them to 0.9."
)


def preview_rows(rows: Sequence[Mapping[str, Any]]) -> Cells:
    """Header and body of the table, for terminal and page.

    Parameters
    ----------
    rows : sequence of mapping
        Of the document of ``insemu run --linear``.
    """
    header = ["design", "by", "outage", "mean m", "95 %", "quantile 95 %", "rms m", "stated"]
    body = [
        [
            r["design"] if r["outage"] == 1 else "",
            r["by"] if r["outage"] == 1 else "",
            str(r["outage"]),
            f"{r['mean_m']:.3g}",
            f"{r['ci95_m'][0]:.3g}-{r['ci95_m'][1]:.3g}",
            *(f"{r[key]:.3g}" for key in ("quantile_95_m", "rms_m", "stated_m")),
        ]
        for r in rows
    ]
    return header, body


def preview_notes(document: Mapping[str, Any]) -> list[str]:
    """What the figures leave out, and why a design counts as not linear.

    Parameters
    ----------
    document : mapping
        Of ``insemu run --linear``.
    """
    notes = [
        f"Errors to first order about the flight: {document['left_out'] or 'nothing of the scenario is left out'}."
    ]
    return notes + [f"{name} is not linear: {why}." for name, why in document["not_linear"].items()]


def render_preview(document: Mapping[str, Any], source: str, folder: str | Path) -> Path:
    """Write the page of a preview into ``folder``/index.html.

    Parameters
    ----------
    document : mapping
        Of ``insemu run --linear``.
    source : str
        The scenario's file.
    folder : path
    """
    beyond = list(document["not_linear"])
    answer = f"Not linear: {', '.join(beyond)}." if beyond else "Every design is linear."
    return Page(
        f"To first order: {document['scenario']}",
        [
            Section("Errors at the ends of the outages", [Table(*preview_rows(document["rows"]), PREVIEWED, left=2)]),
            Section("What the figures rest on", [Items(preview_notes(document))]),
        ],
        kind="run",
        source=source,
        answer=answer,
        lead=f"{count_of(document['realizations'], 'realization')} to first order; nothing was flown at the full rate.",
    ).write(Path(folder) / "index.html")
