"""Stanford diagrams: errors against the protection levels that filters state, and the alert limit of a requirement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from insemu.evaluate import share_interval
from insemu.report import page
from insemu.report.charts import GREY, RED, Chart, Line, View
from insemu.report.style import COLOURS
from insemu.require import QUANTITIES, REGIONS, Guard


def region_rows(found: Sequence[Guard]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: flights in every region, with exact 95 % intervals of their shares."""
    rows = []
    for g in found:
        cells = []
        for count in g.regions.values():
            low, high = share_interval(count, g.error.size)
            cells.append(f"{count} ({100 * low:.1f} to {100 * high:.1f} %)")
        rows.append(
            [g.subject, g.requirement.text, "kept" if g.kept else "broken", f"{g.within} of {g.error.size}", *cells]
        )
    return ["flights", "requirement", "verdict", "within", *REGIONS], rows


def _diagram(found: Sequence[Guard]) -> Chart:
    """Guards of one requirement: errors to the right, protection levels upwards."""
    r = found[0].requirement
    unit = QUANTITIES[r.quantity][1]
    unit, scale = ("deg", 180.0 / np.pi) if unit == "rad" else (unit, 1.0)
    limit = scale * r.limit
    lines = [
        Line(g.subject, scale * g.protection, COLOURS[k % len(COLOURS)], points=True, width=5.0, x=scale * g.error, text=[g.subject] * g.error.size)
        for k, g in enumerate(found)
    ]  # fmt: skip
    both = scale * np.concatenate([np.concatenate([g.error, g.protection]) for g in found])
    ends = np.array([max(both.min(), 1e-3 * limit), max(both.max(), 2.0 * limit)])
    lines += [
        Line("protection level = error", ends, GREY, dashed=True, x=ends),
        Line("alert limit", [limit] * 2, RED, x=ends),
        Line("alert limit of the error", ends, RED, of="alert limit", x=[limit] * 2),
    ]
    return Chart(
        "Stanford diagram", "One point a flight. Right of and below the red lines: hazardous, which the filter does not notice.",
        None, f"error ({unit})", [View(r.text, f"protection level ({unit})", lines, log_y=True)], log_x=True, group="integrity",
    )  # fmt: skip


def integrity_sections(found: Sequence[Guard]) -> list[page.Section]:
    """What a page says of its requirements; nothing without any."""
    if not found:
        return []
    requirements = dict.fromkeys(g.requirement for g in found)
    charts = [_diagram([g for g in found if g.requirement == r]) for r in requirements]
    said = "; ".join(f"{name}: {what}" for name, what in REGIONS.items())
    about = f"E error, P protection level from the stated covariance at the risk that the requirement leaves, A its limit. {said}."
    return [page.Section("Integrity", [page.Table(*region_rows(found), caption=about, left=3, wrap=True), *charts])]
