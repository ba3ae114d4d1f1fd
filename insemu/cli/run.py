"""``insemu run``: a scenario from emulation to the table and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from insemu.evaluate import Results


def command(
    scenario: str = typer.Argument(..., metavar="SCENARIO", help="Scenario file (YAML)."),
    realizations: int | None = typer.Option(
        None, "--realizations", min=1, help="Number of realizations; default the scenario's."
    ),
    seed: int | None = typer.Option(None, "--seed", min=0, help="Seed of all random draws; default the scenario's."),
    workers: int | None = typer.Option(
        None, "--workers", min=1, help="Realizations flown at a time; default the number of cores."
    ),
    out: str = typer.Option("", "--out", help="Folder for results; default results/NAME beside the current folder."),
    as_json: bool = typer.Option(False, "--json", help="Print summary.json on standard output instead of tables."),
    variants: bool = typer.Option(True, "--variants/--no-variants", help="Also run the scenario's variants."),
) -> None:
    """Run a scenario: emulate, inject errors, cut GNSS, filter with every design, and compare.

    Writes summary.json, outages.csv, errors.nc, manifest.json, resolved.yaml, figures and index.html. An interrupted run continues
    where it stopped.
    """
    import json
    import os
    from pathlib import Path

    from rich.console import Console

    from insemu.evaluate import summary

    console = Console(stderr=as_json)
    folder = Path(out) if out else Path("results") / Path(scenario).stem
    everything = run_with_variants(
        scenario,
        folder,
        overrides={"seed": seed, "realizations": realizations},
        workers=workers or os.cpu_count() or 1,
        with_variants=variants,
        console=console,
    )
    from insemu.report import render_experiment

    page = render_experiment(everything.main, everything.variants, folder, text=everything.text)
    if as_json:
        typer.echo(json.dumps(summary(everything.main), indent=1))
        return
    show(console, everything.main, everything.variants)
    console.print(f"\nPage: [bold]{page}[/bold]   (summary.json, outages.csv, errors.nc beside it)")


class Everything:
    """Results of a scenario and of its variants."""

    def __init__(self, main: Results, variants: dict[str, Results], text: dict[str, str]) -> None:
        self.main, self.variants, self.text = main, variants, text


def run_with_variants(
    scenario: str,
    folder: Path,
    *,
    overrides: dict[str, Any],
    workers: int,
    with_variants: bool,
    console: Console,
) -> Everything:
    """Check everything first, then fly; nothing is written before every variant is known to be runnable."""
    import yaml
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from insemu.evaluate import Experiment, run_experiment, write
    from insemu.scenario import load

    base = load(scenario, overrides=overrides)
    names = list(base.variants) if with_variants else []
    experiments = {"": Experiment(base, scenario)}
    for name in names:
        experiments[name] = Experiment(load(scenario, variant=name, overrides=overrides), scenario)
    done: dict[str, Results] = {}
    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn("elapsed"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=False) as bars:
        for name, experiment in experiments.items():
            label = name or experiment.scenario.title.split(":")[0][:24]
            task = bars.add_task(label, total=experiment.scenario.realizations)

            def step(finished: int, total: int, what: str, task: Any = task, label: str = label) -> None:
                bars.update(task, completed=finished, total=total, description=f"{label} ({what})")

            target = folder / "variants" / name if name else folder
            results = run_experiment(experiment, workers=workers, cache=folder / "cache", progress=step)
            bars.update(task, description=label)
            write(results, target)
            (target / "resolved.yaml").write_text(
                yaml.safe_dump(experiment.scenario.model_dump(mode="json", exclude_none=True), sort_keys=False),
                encoding="utf-8",
            )
            done[name] = results
    main = done.pop("")
    return Everything(
        main,
        done,
        {"question": base.question, "notes": base.notes, "source": base.published.source if base.published else ""},
    )


def show(console: Console, main: Results, variants: dict[str, Results]) -> None:
    """The tables at the end."""
    from rich.table import Table

    from insemu.evaluate import outage_table, verdicts

    rows = outage_table(main)
    table = Table(
        title=f"{main.title}\n{main.realizations} realizations, seed {main.seed}: at the end of each outage",
        title_justify="left",
    )
    for heading in (
        "design",
        "states",
        "outage",
        "planimetric m (95 %)",
        "published",
        "altitude m",
        "velocity m/s",
        "attitude deg",
    ):
        table.add_column(heading, justify="left" if heading == "design" else "right")
    for heading in ("stated sigma m", "3-sigma cover p/v/a %", "NEES/dof"):
        table.add_column(heading, justify="right")
    for name, outages in rows.items():
        for k, row in enumerate(outages):
            p, c = row["planimetric_end_m"], row["coverage_3sigma"]
            spread = "" if p["ci95"][0] is None else f" ({p['ci95'][0]:.3g}-{p['ci95'][1]:.3g})"
            published = main.published.get(name)
            table.add_row(
                name if k == 0 else "",
                str(main.designs[name].states) if k == 0 else "",
                f"{row['start_s'] / 60:g} min, {row['duration_s']:g} s",
                f"{p['mean']:.3g}{spread}",
                f"{published[k]:g}" if published is not None and k < len(published) else "-",
                f"{row['altimetric_end_m']:.3g}",
                f"{row['velocity_end_m_s']:.3g}",
                f"{row['attitude_end_deg']:.3g}",
                f"{row['predicted_sigma_end_m']:.3g}",
                "/".join(f"{100 * c[g]:.1f}" for g in ("position", "velocity", "attitude")),
                f"{row['nees_per_dof']:.2f}",
            )
        table.add_section()
    console.print(table)
    for line in verdicts(main):
        console.print(f"  {line}")
    if variants:
        console.print(variant_table(main, variants))


def variant_table(main: Results, variants: dict[str, Results]) -> Any:
    """Mean planimetric error at the end of each outage, every variant beside the default."""
    from rich.table import Table

    from insemu.report.tables import variant_rows

    header, body = variant_rows(main, variants)
    table = Table(title="Variants: mean planimetric error at outage end, m", title_justify="left")
    for k, heading in enumerate(header):
        table.add_column(heading, justify="left" if k < 2 else "right")
    previous = None
    for row in body:
        if previous is not None and row[0] != "":
            table.add_section()
        table.add_row(*row)
        previous = row
    return table
