"""``insemu run``: a scenario from emulation to the table and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Mapping
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
    as_json: bool = typer.Option(False, "--json", help="Print summary.json on standard output instead of report."),
    variants: bool = typer.Option(True, "--variants/--no-variants", help="Also run the scenario's variants."),
    overwrite: bool = typer.Option(
        False, "--overwrite", help="Replace results of the same scenario with more realizations."
    ),
) -> None:
    """Run a scenario: emulate, inject errors, cut GNSS, filter with every design, and compare.

    Writes summary.json, outages.csv, errors.nc, manifest.json, resolved.yaml, figures, index.html and, last, complete.json. An interrupted
    run continues where it stopped.
    """
    import json
    import os
    from pathlib import Path

    from rich.console import Console

    from insemu.evaluate import summary

    # progress and warnings go to standard error: a closed pipe behind the tables costs no files
    told = Console(stderr=True)
    folder = Path(out) if out else Path("results") / Path(scenario).stem
    experiments = prepared(scenario, {"seed": seed, "realizations": realizations}, with_variants=variants, console=told)
    results, failed = run_all(experiments, folder, workers or os.cpu_count() or 1, told, overwrite=overwrite)
    main = results.pop("")
    if as_json:
        typer.echo(json.dumps(summary(main), indent=1))
    else:
        console = Console()
        show(console, main, results)
        console.print(
            f"\nPage: {folder / 'index.html'} (summary.json, outages.csv, errors.nc beside it)", soft_wrap=True
        )
    if failed:
        raise typer.Exit(1)


def prepared(
    scenario: str, overrides: Mapping[str, Any], *, with_variants: bool, console: Console
) -> dict[str, Experiment]:
    """The experiments by the name of the variant, "" first: everything is checked before anything is flown or written."""
    from insemu.cli.announce import announce_world
    from insemu.evaluate import Experiment
    from insemu.scenario import load

    base = load(scenario, overrides=overrides)
    experiments = {"": Experiment(base, scenario)}
    for name in base.variants if with_variants else ():
        experiments[name] = Experiment(load(scenario, variant=name, overrides=overrides), scenario)
    announce_world(experiments[""].world.card, console)
    for warning in dict.fromkeys(w for e in experiments.values() for w in e.warnings):
        console.print(f"Warning: {warning}.", soft_wrap=True, highlight=False, markup=False)
    return experiments


def run_all(
    experiments: Mapping[str, Experiment], folder: Path, workers: int, console: Console, *, overwrite: bool = False
) -> tuple[dict[str, Results], list[str]]:
    """Fly, and write every result as soon as it is there; then the error budget and the page, whose failures lose nothing.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    folder : path
    workers : int
    console : Console
        For progress, warnings and what failed.
    overwrite : bool
        Whether results of more realizations may be replaced.

    Returns
    -------
    results : dict of variant to Results
    failed : list of str
        What could not be made, in words.
    """
    from insemu.evaluate import CACHE, check_not_fewer, finish, only_writer, put, resolved, write
    from insemu.report import render_experiment

    main = experiments[""].scenario
    if not overwrite:
        check_not_fewer(folder, main)
    failed: list[str] = []

    def attempt(what: str, make: Any, otherwise: Any = None) -> Any:
        try:
            return make()
        except Exception as error:
            failed.append(f"{what}: {error}")
            console.print(f"Failed: {what}: {error}", soft_wrap=True, highlight=False, markup=False, style="red")
            return otherwise

    with only_writer(folder):
        forget_others(folder / CACHE, {e.digest for e in experiments.values()})
        done: dict[str, Results] = {}
        for name, experiment, results in flown(experiments, folder / CACHE, workers, console):
            target = folder / "variants" / name if name else folder
            write(results, target)
            put(target / "resolved.yaml", resolved(experiment.scenario))
            done[name] = results
        first = done[""]
        done[""] = attempt("the error budget", lambda: with_budgets(experiments[""], first), first)
        if done[""].budgets:
            write(done[""], folder)
        others = {name: results for name, results in done.items() if name}
        source = main.published.source if main.published else ""
        text = {"question": main.question, "notes": main.notes, "source": source}
        attempt("the page", lambda: render_experiment(done[""], others, folder, text=text))
        finish(folder, main, done[""])
    return done, failed


def flown(experiments: Mapping[str, Experiment], cache: Path, workers: int, console: Console) -> Any:
    """Yield (variant, experiment, results), with a bar of progress each."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from insemu.evaluate import run_experiment

    parts = (BarColumn(bar_width=24), MofNCompleteColumn(), TextColumn("elapsed"), TimeElapsedColumn())
    with Progress(
        TextColumn("{task.description:<34}", markup=False),
        *parts,
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
    ) as bars:

        def say(text: str) -> None:
            console.print(f"Warning: {text}.", soft_wrap=True, highlight=False, markup=False)

        for name, experiment in experiments.items():
            label = name or experiment.scenario.title.split(":")[0][:24]
            task = bars.add_task(label, total=experiment.scenario.realizations)

            def step(finished: int, total: int, what: str, task: Any = task, label: str = label) -> None:
                bars.update(task, completed=finished, total=total, description=f"{label} ({what})")

            try:
                results = run_experiment(experiment, workers=workers, cache=cache, progress=step, say=say)
            except KeyboardInterrupt:
                bars.stop()
                console.print("Interrupted. Finished realizations are kept; the same command goes on from there.")
                raise
            bars.update(task, description=label)
            yield name, experiment, results


def with_budgets(experiment: Experiment, results: Results) -> Results:
    """The results with an error budget of every design that allows a covariance analysis."""
    from dataclasses import replace

    from insemu.evaluate import analysable, analyse_designs, outage_budgets

    if not results.outages or not analysable(experiment)[0]:
        return results
    return replace(results, budgets=outage_budgets(analyse_designs(experiment), results.outages))


def forget_others(cache: Path, digests: set[str]) -> None:
    """Delete finished parts of earlier versions of the scenario, its data or the code."""
    import shutil

    if cache.is_dir():
        for folder in cache.iterdir():
            if folder.name not in digests:
                shutil.rmtree(folder) if folder.is_dir() else folder.unlink()


def show(console: Console, main: Results, variants: dict[str, Results]) -> None:
    """The tables at the end."""
    from insemu import report
    from insemu.cli.printing import print_items, print_table
    from insemu.evaluate import answer, verdicts

    console.print(f"\n{main.title}", soft_wrap=True, markup=False)
    said = answer(main)
    if said:
        console.print(f"{said.sentence}\n", markup=False, highlight=False, style="bold")
    title = f"{report.variant_caption(main)}: means over {main.realizations} realizations (seed {main.seed})"
    print_table(console, title, *report.short_headline(main), fit=True)
    console.print(
        "(states). verdict: of the NEES at outage end. error: planimetric. stated: the filter's own horizontal sigma at outage end, m. in 3 s: "
        "position errors inside 3 sigma during the outage. NEES: per degree of freedom, 1 is a filter that knows its error. alt.: altitude at "
        "outage end.\n",
        style="dim",
    )
    print_items(console, [*verdicts(main), *report.consistency_lines(main)])
    if main.smoothed and main.outages:
        print_table(console, report.SMOOTHED, *report.smoother_rows(main))
    if main.budgets:
        console.print("\nWhere the metres come from, by covariance analysis (parts add up as squares):")
        print_items(console, report.budget_lines(main.budgets))
    if variants:
        header, body = report.variant_rows(main, variants)
        shown = [
            k for k, heading in enumerate(header) if heading not in ("95 %", "inside %")
        ]  # the page has room for them
        kept = [[row[k] for k in shown] for row in body]
        print_table(console, f"Variants. {report.variant_caption(main)}", [header[k] for k in shown], kept)
    for label, results in report.shown_beside(main, variants):
        for figure in results.published:
            print_table(console, f"{label}: {report.FIGURES[figure]}, m", *report.beside(results, figure))
        print_items(console, report.rank_lines(results))
    print_items(console, report.pooled_rank_line(main, variants))
