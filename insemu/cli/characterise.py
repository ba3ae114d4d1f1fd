"""``insemu characterise``: what the noise of a static log is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from insemu.formats import Log
    from insemu.variance import AxisReport

#: Longer columns are read in one pass and never held as a whole.
LONG = 1 << 24


def command(
    file: str = typer.Argument(..., metavar="FILE", help="Static log: .npz, .csv or .npy (columns with units)."),
    rate: str = typer.Option("", "--rate", help="Sampling rate of a log that does not say it, such as '100 Hz'."),
    columns: list[str] | None = typer.Option(  # noqa: B008
        None,
        "--columns",
        "--column",
        "-c",
        help="Only these columns, separated by commas (gx or gyro_x); may be repeated.",
    ),
    robust: bool = typer.Option(False, "--robust", help="Read the coefficients off the robust curve."),
    wavelet: str = typer.Option("haar", "--wavelet", help="Filter of the wavelet variance, such as d8 or la8."),
    overlay: bool = typer.Option(True, "--overlay/--no-overlay", help="Also draw the axes of a sensor in one panel."),
    beside: str = typer.Option("", "--beside", help="JSON of other sensors' wavelet variances, drawn behind ours."),
    out: str = typer.Option(
        "", "--out", "-o", help="Folder for page, figures and JSON; default results/characterise_NAME."
    ),
    as_json: bool = typer.Option(
        False, "--json", help="Print JSON on standard output; files are written only with --out."
    ),
) -> None:
    """Characterise a static log: variances, spectrum, what can be read off them, and what is wrong with the log."""
    import json
    from pathlib import Path

    from rich.console import Console

    from insemu import units
    from insemu.cli.announce import announce
    from insemu.cli.logs import column_names, open_log
    from insemu.formats import read_curves

    console = Console(stderr=as_json)
    if not console.is_terminal:
        console.width = max(console.width, 100)  # a file or a pipe has no width to keep to
    rate_hz = units.parse(_number_or_text(rate), "Hz") if rate else None
    wanted = column_names(columns)
    others = read_curves(beside) if beside else []
    announce(file, Console(stderr=True), rate_hz=rate_hz, refuse=False)
    log = open_log(file, rate_hz)
    axes = characterise_log(log, wanted, from_robust=robust, wavelet=wavelet)
    content = {"axes": {axis.name: axis.to_json() for axis in axes}}
    folder = Path(out) if out else Path("results") / f"characterise_{Path(file).name.split('.')[0]}"
    page = None
    if out or not as_json:
        from insemu.report import render_characterisation

        page = render_characterisation(axes, folder, source=file, beside=others, overlay=overlay)
        (folder / "characterise.json").write_text(
            json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
    if as_json:
        typer.echo(json.dumps(content, indent=1, allow_nan=False))
        return
    show(console, axes)
    console.print(f"\nPage: [bold]{page}[/bold] (characterise.json and figures beside it)", soft_wrap=True)


def _number_or_text(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def characterise_log(
    log: Log, wanted: Sequence[str] | None = None, *, from_robust: bool = False, wavelet: str = "haar"
) -> list[AxisReport]:
    """Characterise columns of a log: the longest part without NaN and gaps, with findings about the whole.

    Parameters
    ----------
    log : Log
    wanted : sequence of str, optional
        Columns; all by default.
    from_robust : bool
        Read the coefficients off the robust curve.
    wavelet : str
        Filter of the wavelet variance; a log too long for memory has the Haar filter only.

    Raises
    ------
    InputError
        An unknown column; a log with no usable part.
    """
    from dataclasses import replace

    import numpy as np

    from insemu.errors import InputError, nearest
    from insemu.formats import AXIS_OF_COLUMN
    from insemu.variance import characterise, characterise_stream
    from insemu.variance import findings as judge

    keep = list(range(len(log.names)))
    if wanted is not None:
        keep = []
        for name in wanted:
            found = [k for k, n in enumerate(log.names) if name in (n, AXIS_OF_COLUMN.get(n))]
            if not found:
                raise InputError(f"has no column '{name}'" + nearest(name, log.names), where=log.source)
            keep.append(found[0])
    gaps = log.gaps()
    axes: list[AxisReport] = []
    for k in keep:
        name, unit = log.names[k], log.units[k]
        if len(log) > LONG:
            if wavelet != "haar":
                raise InputError(
                    f"has {len(log)} samples, which are read in one pass; the filter '{wavelet}' needs at most {LONG}",
                    where=log.source,
                )
            axes.append(characterise_stream(lambda k=k: log.chunks(k), log.rate_hz, name=name, unit=unit))  # type: ignore[misc]
            continue
        x = np.asarray(log.columns[k], dtype=np.float64)
        notes = judge.gap_report(gaps, log.rate_hz) + judge.missing_values(x, log.rate_hz)
        start, stop = judge.longest_good_part([x], [row for row, _ in gaps])
        if stop - start < 16:
            raise InputError(f"{name} has no {16} finite values in a row", where=log.source)
        if notes:
            notes.append(
                f"used: rows {start} to {stop - 1} ({(stop - start) / log.rate_hz:.6g} s), the longest part without NaN and gaps; "
                f"{100.0 * (1.0 - (stop - start) / len(log)):.3g} % of the record was left out"
            )
        report = characterise(
            np.ascontiguousarray(x[start:stop]),
            log.rate_hz,
            name=name,
            unit=unit,
            from_robust=from_robust,
            filter=wavelet,
        )
        axes.append(replace(report, findings=notes + report.findings))
    judged = _unit_findings(log, axes)
    return [replace(a, findings=judged.get(AXIS_OF_COLUMN.get(a.name, a.name), []) + a.findings) for a in axes]


def _unit_findings(log: Log, axes: Sequence[AxisReport]) -> dict[str, list[str]]:
    """Judge units from all columns of the file, also those that were not asked for: gravity needs three."""
    import numpy as np

    from insemu.formats import AXIS_OF_COLUMN
    from insemu.variance import findings as judge

    means, stated, white = {}, {}, {}
    for name, unit, column in zip(log.names, log.stated_units, log.columns, strict=True):
        axis = AXIS_OF_COLUMN.get(name, name)
        part = np.asarray(column[: 1 << 20], dtype=np.float64)
        if np.isfinite(part).any():
            means[axis], stated[axis] = float(np.nanmean(part)), unit
    for report in axes:
        if "N" in report.readings:
            white[AXIS_OF_COLUMN.get(report.name, report.name)] = report.readings["N"].si_value
    return judge.unit_report(means, white, stated)


def show(console: Console, axes: Sequence[AxisReport]) -> None:
    """Print readings and findings."""
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    from insemu.variance import duration, grouped_findings

    first = axes[0]
    console.print(
        f"{len(axes)} column(s), {first.samples} samples at {first.rate_hz:g} Hz ({duration(first.samples / first.rate_hz)})"
    )
    table = Table("axis", "reading", "value", "95 % interval", "unit", "read from (s)", box=SIMPLE_HEAD, padding=(0, 1))
    for column in table.columns:
        column.no_wrap = True
    absent: dict[str, list[str]] = {}
    for axis in axes:
        for name, r in axis.readings.items():
            table.add_row(
                escape(axis.name),
                name,
                f"{r.value:.4g}",
                f"{r.low:.4g} to {r.high:.4g}",
                r.unit,
                f"{r.tau_from_s:.3g} to {r.tau_to_s:.3g}",
            )
        table.add_section()
        if axis.not_visible:
            absent.setdefault(", ".join(axis.not_visible), []).append(axis.name)
    console.print("Readings" if table.rows else "Readings: none")
    if table.rows:
        console.print(table)
    for names, of in absent.items():
        console.print(f"Not visible in this record: {names} ({escape(', '.join(of))})", soft_wrap=True)
    found = grouped_findings(axes)
    console.print("Findings" if found else "Findings: nothing wrong was found")
    for names, finding in found:
        console.print(f"  [bold]{escape(names)}[/bold]  {escape(finding)}", soft_wrap=True)
