"""``insemu gap``: where a recording and a nominal model disagree, the missing effect's name, the refined model, the gap shrinking."""

from __future__ import annotations

import typer


def command(
    scenario: str = typer.Argument(
        ..., metavar="SCENARIO", help="What is believed: a scenario, a belief file or a noise-model file (YAML)."
    ),
    measured: str = typer.Option(
        ..., "--measured", metavar="RECORDING", help="What was measured: a static log, or a drive or flight with fixes."
    ),
    out: str = typer.Option(
        "", "--out", help="Folder for the page, gap.json and refined.yaml; default results/gap_NAME."
    ),
    pictures: str = typer.Option(
        "",
        "--pictures",
        help="Also write the page's pictures as PNG files with this beginning, for example results/gallery/gap_drive.",
    ),
    as_json: bool = typer.Option(False, "--json", help="Print the report as JSON on standard output."),
    rate: str = typer.Option("", "--rate", help="Sampling rate of a log that does not say it, for example '100 Hz'."),
    without: list[str] | None = typer.Option(  # noqa: B008
        None, "--without", help="Effect to take out of the catalogue; may be repeated."
    ),
    seed: int = typer.Option(1, "--seed", min=0, help="Seed of the simulated nominal data."),
    hold_out: bool = typer.Option(
        True, "--hold-out/--no-hold-out", help="Score on data that was not used for naming (twice the time)."
    ),
) -> None:
    """Find where a recording and a model disagree, name the missing effect, add it and show the gap shrink."""
    import json
    from pathlib import Path

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from insemu import units
    from insemu.cli.announce import announce
    from insemu.effects import EFFECTS
    from insemu.errors import InputError, nearest
    from insemu.gap import find_gap, from_its_start, load_measured, load_nominal, write_refined

    for effect in without or ():
        if effect not in EFFECTS:
            raise InputError(f"unknown effect '{effect}'" + nearest(effect, EFFECTS), where="--without")
    console = Console(stderr=as_json)
    announce(measured, Console(stderr=True), rate_hz=units.parse(rate, "Hz") if rate else None)
    nominal = load_nominal(scenario)
    data = load_measured(measured, rate_hz=units.parse(rate, "Hz") if rate else None)
    if "recording" not in nominal.raw:  # a scenario of a recording tells times by the recording's clock
        data = from_its_start(data)
    with console.status("reading") as status:
        report = find_gap(
            data,
            nominal,
            rng=np.random.default_rng(seed),
            without=tuple(without or ()),
            hold_out=hold_out,
            progress=lambda text: status.update(text),
        )
    folder = Path(out) if out else Path("results") / f"gap_{Path(measured).stem}"
    folder.mkdir(parents=True, exist_ok=True)
    refined = write_refined(nominal, report, folder / "refined.yaml", data)
    text = json.dumps(report.to_json(), indent=1, allow_nan=False)
    (folder / "gap.json").write_text(text + "\n", encoding="utf-8")
    from insemu.report.gap import draw_gap, effect_name, headline, place, render_gap

    page = render_gap(report, folder, refined.read_text(encoding="utf-8"))
    if pictures:
        draw_gap(report, Path(pictures).parent, Path(pictures).name)
    if as_json:
        typer.echo(text)
        return
    console.print(f"[bold]{report.verdict}[/bold]: {headline(report)}")
    if report.findings:
        table = Table("effect", "where", "evidence, nats", "confidence", "parameters, 95 % interval")
        for s in report.findings:
            values = "\n".join(f"{v.name} {v.value:.3g} [{v.low:.3g}, {v.high:.3g}] {v.unit}" for v in s.parameters[:6])
            values += "\n..." if len(s.parameters) > 6 else ""
            table.add_row(
                effect_name(s.effect),
                place(s.sensor, s.axes),
                f"{s.nats:.1f}",
                f"{s.confidence:.3f}",
                values,
            )
        console.print(table)
    if report.remainder:
        console.print(f"Left unexplained: {report.remainder}", highlight=False, markup=False)
    for label, value in (("before", report.gap_before), ("after", report.gap_after)):
        if np.isfinite(value.value):
            console.print(f"gap index {label}: {value.value:.3f} [{value.low:.3f}, {value.high:.3f}]")
    console.print(f"Page: [bold]{page}[/bold]   (gap.json, refined.yaml beside it)")
