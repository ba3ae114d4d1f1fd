"""The page of ``insemu characterise``: the answer, a card an axis, findings, readings, charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from insemu.report.characterise_charts import (
    allan_chart,
    correlation_chart,
    groups,
    plain,
    spectrum_chart,
    trend_chart,
    wavelet_chart,
)
from insemu.report.charts import Chart
from insemu.report.page import Block, Card, Items, Page, Section, Table, Text
from insemu.variance import duration, grouped_findings

if TYPE_CHECKING:
    from insemu.formats import NamedCurve
    from insemu.variance import AxisReport

#: Readings that the answer tells: white noise, flat part, random walk.
MAIN = ("N", "B", "K")


def _card(axis: AxisReport) -> Card:
    """What an axis is, in one card."""
    read = [
        f"{name} {r.value:.3g} {plain(r.unit)} ({r.low:.3g} to {r.high:.3g})"
        for name, r in axis.readings.items()
        if name in MAIN
    ]
    value = read[0] if read else "No straight part to read"
    absent = [name for name in axis.not_visible if name in MAIN]
    notes = [*read[1:], *axis.findings[:1], f"Not visible in this record: {', '.join(absent)}" if absent else ""]
    return Card(
        axis.name, value, verdict_of(axis).capitalize(), "warn" if axis.findings else "good", [n for n in notes if n]
    )


def verdict_of(axis: AxisReport) -> str:
    """Whether something is wrong with an axis, in a few words."""
    count = len(axis.findings)
    return f"{count} finding{'s' if count > 1 else ''}" if count else "nothing wrong found"


def characterise_answer(axes: Sequence[AxisReport]) -> str:
    """The main readings of each kind of sensor, the range of its axes, and how much is wrong, in one sentence."""
    told = []
    for title, members in groups(axes):
        parts = []
        for name in MAIN:
            known = [a.readings[name] for a in members if name in a.readings]
            if known:
                low, high = f"{min(r.value for r in known):.3g}", f"{max(r.value for r in known):.3g}"
                parts.append(f"{name} {low if low == high else f'{low} to {high}'} {plain(known[0].unit)}")
        told.append(f"{title}: {', '.join(parts) or 'no straight part to read'}")
    found = len(grouped_findings(axes))
    wrong = f"{found} finding{'s' if found > 1 else ''} to look at" if found else "nothing wrong was found"
    return f"{'. '.join(told)}; {wrong}."


def characterise_rows(axes: Sequence[AxisReport]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table for the terminal: an axis, its verdict, and what was read with intervals."""
    header = ["axis", "verdict", "reading", "value", "95 % interval", "unit", "read from (s)"]
    rows = []
    for axis in axes:
        first = [axis.name, verdict_of(axis)]
        if not axis.readings:
            rows.append([*first, "none", "", "", "", ""])
        for k, (name, r) in enumerate(axis.readings.items()):
            values = [
                f"{r.value:.4g}",
                f"{r.low:.4g} to {r.high:.4g}",
                r.unit,
                f"{r.tau_from_s:.3g} to {r.tau_to_s:.3g}",
            ]
            rows.append([*(first if k == 0 else ("", "")), name, *values])
    return header, rows


def _readings_table(axes: Sequence[AxisReport]) -> list[Block]:
    """What was read, and what was not."""
    rows = [
        [
            axis.name,
            name,
            f"{r.value:.4g}",
            f"{r.low:.4g} to {r.high:.4g}",
            r.unit,
            f"{r.tau_from_s:.3g} to {r.tau_to_s:.3g}",
            r.note,
        ]
        for axis in axes
        for name, r in axis.readings.items()
    ]
    table = Table(["axis", "reading", "value", "95 %", "unit", "read from (s)", "note"], rows, left=2)
    absent: dict[str, list[str]] = {}
    for axis in axes:
        if axis.not_visible:
            absent.setdefault(", ".join(axis.not_visible), []).append(axis.name)
    said = [f"Not visible in this record: {names} ({', '.join(of)})." for names, of in absent.items()]
    return [*([table] if rows else []), *([Items(said)] if said else [])]


def _comparison_table(axes: Sequence[AxisReport]) -> Table:
    rows = []
    for axis in axes:
        if axis.robust is None or axis.contamination is None or not axis.robust.contaminated:
            continue
        for k, tau in enumerate(axis.robust.tau_s):
            rows.append(
                [
                    axis.name,
                    f"{tau:.4g}",
                    f"{axis.contamination.ratio[k] * axis.robust.value[k]:.4g}",
                    f"{axis.robust.value[k]:.4g}",
                    f"{axis.contamination.ratio[k]:.3g}",
                    "yes" if axis.contamination.significant[k] else "",
                    "" if axis.robust.protected[k] else "not protected",
                ]
            )
    return Table(["axis", "scale (s)", "plain (SI²)", "robust (SI²)", "ratio", "significant", "robust curve"], rows)


def render_characterisation(
    axes: Sequence[AxisReport],
    folder: str | Path,
    *,
    source: str,
    beside: Sequence[NamedCurve] = (),
    overlay: bool = True,
) -> Path:
    """Write figures (PNG) and the page ``index.html`` into a folder; returns the page's path.

    Parameters
    ----------
    axes : sequence of AxisReport
        One per column, at least one.
    folder : path
        Made where it does not exist.
    source : str
        File that was characterised.
    beside : sequence of NamedCurve
        Wavelet variances of other sensors to be drawn beside.
    overlay : bool
        Whether the wavelet variances are drawn even without them.
    """
    # a constant column has nothing to draw on logarithmic axes
    varied = groups([axis for axis in axes if (axis.allan.value > 0).any()])
    correlated = groups([axis for axis in axes if axis.correlation])
    first = axes[0]
    length = duration(first.samples / first.rate_hz)
    lead = f"{source}: {len(axes)} column(s), {first.samples} samples at {first.rate_hz:g} Hz ({length})."
    findings = [f"{names}: {finding}" for names, finding in grouped_findings(axes)]
    sections = [
        *_section("Allan deviation", [allan_chart(members, of) for of, members in varied]),
        Section("Findings", [Items(findings) if findings else Text("Nothing wrong was found.")]),
        Section(
            "Readings",
            [
                Text(
                    "Units are those of datasheets. B is the flat part over 0.664; the flat part of a Gauss-Markov noise of standard "
                    "deviation s is at 0.617 s at most, so a model fitted with s = 0.664 B reads back as 0.617 B."
                ),
                *_readings_table(axes),
            ],
        ),
        *(
            _section("Wavelet variance", [wavelet_chart(members, of, beside) for of, members in varied])
            if overlay or beside
            else ()
        ),
    ]
    comparison = _comparison_table(axes)
    if comparison.rows:
        text = "Columns with tails heavier than Gaussian. Where bad steps touch more than half of the coefficients, nothing protects the estimate."
        sections.append(Section("Plain against robust", [Text(text), comparison]))
    sections += [
        *_section("Over time", [trend_chart(members, of) for of, members in groups(axes)]),
        *_section("Spectrum", [spectrum_chart(members, of) for of, members in varied]),
        *_section("Correlation", [correlation_chart(members, of) for of, members in correlated]),
    ]
    return Page(
        f"Characterisation of {Path(source).name}",
        sections,
        kind="characterise",
        source=source,
        answer=characterise_answer(axes),
        lead=lead,
        cards=[_card(axis) for axis in axes],
    ).write(Path(folder) / "index.html", pictures=True)


def _section(title: str, charts: Sequence[Chart]) -> list[Section]:
    """A part of the page; none where there is nothing to draw."""
    return [Section(title, charts)] if charts else []
