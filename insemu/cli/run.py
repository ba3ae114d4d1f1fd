"""``insemu run``: a scenario from emulation to the table and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from insemu.evaluate import Experiment, Results


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
    console.print(f"\nPage: [bold]{page}[/bold] (summary.json, outages.csv, errors.nc beside it)", soft_wrap=True)


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
    for warning in dict.fromkeys(w for e in experiments.values() for w in e.world.warnings):
        console.print(f"Warning: {warning}.", soft_wrap=True, highlight=False, markup=False)
    forget_others(folder / "cache", {e.digest for e in experiments.values()})
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
            try:
                results = run_experiment(experiment, workers=workers, cache=folder / "cache", progress=step)
            except KeyboardInterrupt:
                bars.stop()
                console.print("Interrupted. Finished realizations are kept; the same command goes on from there.")
                raise
            if not name:
                bars.update(task, description=f"{label} (error budget)")
                results = with_budgets(experiment, results)
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


def with_budgets(experiment: Experiment, results: Results) -> Results:
    """The results with an error budget of every design that allows a covariance analysis."""
    from dataclasses import replace

    from insemu.evaluate.comparison import analysable, analyse_designs, outage_budgets

    if not results.outages or not analysable(experiment)[0]:
        return results
    return replace(results, budgets=outage_budgets(analyse_designs(experiment), results.outages))


def forget_others(cache: Path, digests: set[str]) -> None:
    """Delete finished parts of earlier versions of the scenario, its data or the code."""
    import shutil

    if cache.is_dir():
        for folder in cache.iterdir():
            if folder.name not in digests:
                shutil.rmtree(folder)


def show(console: Console, main: Results, variants: dict[str, Results]) -> None:
    """The tables at the end."""
    from rich.table import Table

    from insemu.evaluate import headline, outage_table, verdicts
    from insemu.report.budget import budget_lines
    from insemu.report.tables import (
        FIGURES,
        SMOOTHED,
        beside,
        consistency_lines,
        pooled_rank_line,
        published_value,
        rank_lines,
        short,
        shown_beside,
        smoother_rows,
        variant_caption,
    )

    console.print(f"\n[bold]{main.title}[/bold]", soft_wrap=True)
    table = Table(
        title=f"{variant_caption(main)}: means over {main.realizations} realizations (seed {main.seed})",
        title_justify="left",
        box=None,
        padding=(0, 1),
        pad_edge=False,
        header_style="underline",
    )
    headings = ["design", "outage", "error m", "95 %", "alt. m", "stated", "in 3 s", "NEES"]
    if main.published:
        headings.insert(4, "paper")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "design" else "right", no_wrap=True)
    for name, outages in outage_table(main).items():
        for k, row in enumerate(outages):
            p = row["planimetric_end_m"]
            low, high = p["ci95"]
            cells = [
                f"{name} ({main.designs[name].states})" if k == 0 else "",
                f"{row['start_s'] / 60:.3g} min",
                f"{headline(main, row):.3g}",
                "" if low is None or main.headline_figure != "planimetric_end_m" else f"{low:.3g}-{high:.3g}",
                f"{row['altimetric_end_m']:.3g}",
                f"{row['predicted_sigma_end_m']:.3g}",
                f"{100 * row['coverage_3sigma']['position']:.1f}%",
                short(row["nees_per_dof"]),
            ]
            if main.published:
                cells.insert(4, published_value(main, name, k) or "-")
            table.add_row(*cells)
        table.add_row()
    console.print(table)
    console.print(
        "(states). error: planimetric. alt.: altitude at outage end. stated: the filter's own horizontal sigma there, m. in 3 s: position errors "
        "inside 3 sigma during the outage. NEES: per degree of freedom, 1 is a filter that knows its error.\n",
        style="dim",
    )
    for line in (*verdicts(main), *consistency_lines(main)):
        console.print(f"- {line}", soft_wrap=True, highlight=False)
    if main.smoothed is not None and main.outages:
        print_table(console, SMOOTHED, *smoother_rows(main))
    if main.budgets:
        console.print("\nWhere the metres come from, by covariance analysis (parts add up as squares):")
        for line in budget_lines(main.budgets):
            console.print(f"- {line}", soft_wrap=True, highlight=False)
    if variants:
        print_variants(console, main, variants)
    for label, results in shown_beside(main, variants):
        for figure in results.published:
            print_table(console, f"{label}: {FIGURES[figure]}, m", *beside(results, figure))
        for line in rank_lines(results):
            console.print(f"- {line}", soft_wrap=True, highlight=False)
    for line in pooled_rank_line(main, variants):
        console.print(f"- {line}", soft_wrap=True, highlight=False)


def print_table(console: Console, title: str, header: list[str], body: list[list[str]]) -> None:
    """A table of the page, on the terminal: the first two columns left, a gap before every new group."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="underline")
    for k, heading in enumerate(header):
        table.add_column(heading, justify="left" if k < 2 else "right", no_wrap=True)
    for i, row in enumerate(body):
        if i and row[0]:
            table.add_row()
        table.add_row(*row)
    console.print(f"\n{title}", soft_wrap=True, highlight=False)
    width = console.width
    # wider than the terminal rather than cut
    console.width = max(width, console.measure(table, options=console.options.update(width=500)).maximum)
    console.print(table)
    console.width = width


def print_variants(console: Console, main: Results, variants: dict[str, Results]) -> None:
    """The headline figure of each outage, every variant beside the default."""
    from insemu.report.tables import variant_caption, variant_rows

    header, body = variant_rows(main, variants)
    # the page has room for the others
    shown = [k for k, heading in enumerate(header) if heading not in ("95 %", "inside %")]
    kept = [[row[k] for k in shown] for row in body]
    print_table(console, f"Variants. {variant_caption(main)}", [header[k] for k in shown], kept)
