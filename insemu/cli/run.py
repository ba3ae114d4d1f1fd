"""``insemu run``: a scenario from emulation to the table and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from insemu.cli.linear import check_control, preview
from insemu.cli.linear import control as controlled
from insemu.cli.options import LINEAR, Arguments, argument, option
from insemu.cli.printing import flying, print_items, print_json, print_table, print_text
from insemu.errors import InputError
from insemu.shown import count_of

if TYPE_CHECKING:
    from insemu.evaluate import Experiment, Resources, Results, Shard


#: Outages of which error budgets are made: each goes back through the flight, so that those of n outages take n times the flight.
MOST_BUDGETS = 100


class RunArguments(Arguments):
    """Of ``insemu run``."""

    scenario: str = argument("SCENARIO")
    realizations: int | None = option("--realizations", None, min=1)
    seed: int | None = option("--seed", None)
    workers: int = option("--workers", None)
    until: str = option("--until", "")
    linear: int = option(
        "--linear", 0, "Fly nothing: a preview from so many realizations to first order, for example 10000."
    )
    control: int = option("--control", 0, min=0, max=LINEAR)
    out: str = option(
        "--output",
        "",
        "Folder for results; default results/NAME next to the current folder, NAME-linear with --linear.",
    )
    cluster: str = option("--cluster", "")
    shard: str = option(
        "--shard", "", "Fly only a part, for example 3/40, and keep it in the folder; insemu merge makes the results."
    )
    as_json: bool = option("--json", False)
    variants: bool = option("--variants", False)
    pictures: bool = option("--pictures", True, "Write the page's charts as PNG and SVG, too (without: older ones go).")
    overwrite: bool = option("--overwrite", False)


def command(args: RunArguments) -> None:
    """Run a scenario: emulate, inject errors, cut GNSS, filter with every design, and compare.

    Writes summary.json, outages.csv, errors.nc, manifest.json, resolved.yaml, figures, index.html and, last, complete.json. An interrupted
    run continues where it stopped.
    """
    from insemu.cluster import cluster as dask_cluster
    from insemu.compiled import compiled_beside
    from insemu.evaluate import Resources, Shard, effort

    # progress and warnings go to standard error: a closed pipe behind the tables costs no files
    stderr = Console(stderr=True)
    folder = Path(args.out) if args.out else Path("results") / Path(args.scenario).stem
    overrides = {"seed": args.seed, "realizations": args.realizations}
    ways = [
        o
        for o, given in (
            ("--shard", args.shard),
            ("--linear", args.linear),
            ("--until or --control", args.until or args.control),
        )
        if given
    ]
    if len(ways) > 1:
        raise InputError(f"{' and '.join(ways)} exclude each other", where="insemu run")
    part = Shard.parse(args.shard) if args.shard else None
    with (
        compiled_beside("insemu.evaluate.kernels", "insemu.filters.kernel.run"),
        dask_cluster(args.cluster, args.workers) as pool,
    ):
        resources = Resources(args.workers, pool)
        experiments = prepared(args.scenario, overrides, with_variants=args.variants, console=stderr)
        if args.control:
            check_control(experiments[""], until=bool(args.until))
        if args.linear:
            target = folder if args.out else folder.with_name(f"{folder.name}-linear")
            preview(experiments[""], args.linear, target, Console(), as_json=args.as_json)
            return
        stderr.print(f"Ahead: {effort(list(experiments.values()), args.workers)}.", soft_wrap=True, highlight=False)
        if part is not None:
            run: dict[str, Any] = {
                "scenario": str(Path(args.scenario).resolve()) if Path(args.scenario).exists() else args.scenario
            }
            run |= {"overrides": overrides, "variants": args.variants, "digest": experiments[""].digest}
            fly_shard(experiments, folder, part, run, resources, stderr)
            return
        if args.until:
            fly_until(experiments, args.until, folder, resources, stderr)

        def help_figures(found: Results) -> None:
            controlled(experiments[""], found, args.control, folder, Console(stderr=args.as_json), as_json=args.as_json)

        results, failed = run_all(
            experiments, folder, resources, stderr, overwrite=args.overwrite, pictures=args.pictures,
            also=help_figures if args.control else None,
        )  # fmt: skip
    say_all(results, failed, folder, as_json=args.as_json)


def say_all(results: dict[str, Results], failed: list[str], folder: Path, *, as_json: bool) -> None:
    """Print tables or JSON; exit code 1 where something failed.

    Parameters
    ----------
    results : dict of variant to Results
    failed : list of str
    folder : path
    as_json : bool
    """
    from insemu.evaluate import summary

    main = results.pop("")
    if as_json:
        print_json(summary(main))
    else:
        console = Console()
        show(console, main, results)
        console.print(
            f"\nPage: {folder / 'index.html'} (summary.json, outages.csv, errors.nc next to it)", soft_wrap=True
        )
    if failed:
        raise typer.Exit(1)


def fly_until(
    experiments: Mapping[str, Experiment],
    text: str,
    folder: Path,
    resources: Resources,
    console: Console,
) -> None:
    """Fly until a goal is reached; the experiments then have as many realizations as that took.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    text : str
        The goal.
    folder : path
    resources : Resources
    console : Console
    """
    from insemu.evaluate import CACHE, Goal, looks, only_writer, run_experiment

    experiment = experiments[""]
    goal = Goal.parse(text, list(experiment.scenario.designs))
    if not experiment.world.outage_windows or experiment.scenario.recording is not None:
        raise InputError("an emulated flight with an outage is needed", where="--until")
    with only_writer(folder):
        for number, count in enumerate(looks(), start=1):
            with bar(console, f"look {number}", count) as (step, say):
                here = replace(resources, cache=folder / CACHE, progress=step, say=say)
                results = run_experiment(experiment, realizations=count, resources=here)
            seen = goal.look(results, number)
            asked = text.partition(" within ")[0]
            print_text(
                console,
                f"{count_of(seen.realizations, 'realization')}: {asked} {seen.value:.4g} ({seen.low:.4g} to {seen.high:.4g})",
            )
            if seen.reached:
                break
        else:
            console.print(f"Not reached with {count_of(count, 'realization')}, the most there can be.", style="red")
    for each in experiments.values():
        each.scenario = each.scenario.model_copy(update={"realizations": count})


def fly_shard(
    experiments: Mapping[str, Experiment],
    folder: Path,
    shard: Shard,
    run: Mapping[str, Any],
    resources: Resources,
    console: Console,
) -> None:
    """Fly a part of every variant and keep it in the folder.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    folder : path
    shard : Shard
    run : mapping
        What the part belongs to.
    resources : Resources
    console : Console
    """
    from insemu.evaluate import CACHE, fly_part, note, only_writer

    with only_writer(folder, shared=True):
        for name, experiment in experiments.items():
            mine = shard.realizations(experiment.realizations)
            with bar(console, f"{name or 'shard'} {shard}", len(mine)) as (step, say):
                fly_part(experiment, mine, replace(resources, cache=folder / CACHE, progress=step, say=say))
        note(folder, shard, run)
    console.print(f"Shard {shard} is in {folder}. With all of them there: insemu merge {folder}", soft_wrap=True)


def prepared(
    scenario: str, overrides: Mapping[str, Any], *, with_variants: bool, console: Console
) -> dict[str, Experiment]:
    """The experiments by the name of the variant, "" first: everything is checked before anything is flown or written."""
    from insemu.cli.announce import announce_warnings, announce_world
    from insemu.evaluate import Experiment
    from insemu.scenario import load

    base = load(scenario, overrides=overrides)
    experiments = {"": Experiment(base, scenario)}
    for name in base.variants if with_variants else ():
        experiments[name] = Experiment(load(scenario, variant=name, overrides=overrides), scenario)
    announce_world(experiments[""].world.card, console)
    announce_warnings(experiments.values(), console)
    return experiments


def run_all(
    experiments: Mapping[str, Experiment],
    folder: Path,
    resources: Resources,
    console: Console,
    *,
    overwrite: bool = False,
    pictures: bool = True,
    also: Callable[[Results], None] | None = None,
) -> tuple[dict[str, Results], list[str]]:
    """Fly, and write every result as soon as it is there; then the error budget and the page, whose failures lose nothing.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    folder : path
    resources : Resources
    console : Console
        For progress, warnings and what failed.
    overwrite : bool
        Whether results of more realizations may be replaced.
    pictures : bool
        Whether the page's charts are written as files, too; those of an earlier run are deleted otherwise.
    also : callable, optional
        Given the scenario's results while the folder is held, before it is marked as complete.

    Returns
    -------
    results : dict of variant to Results
    failed : list of str
        What could not be made, in words.
    """
    from insemu.evaluate import CACHE, check_not_fewer, finish, only_writer, resolved, write, write_summary
    from insemu.report.experiment import render_experiment
    from insemu.whole import put

    main = experiments[""].scenario
    if not overwrite:
        check_not_fewer(folder, main)
    failed: list[str] = []

    def attempt(what: str, make: Any, otherwise: Any = None) -> Any:
        try:
            return make()
        except Exception as error:
            failed.append(f"{what}: {error}")
            print_text(console, f"Failed: {what}: {error}", style="red")
            return otherwise

    with only_writer(folder):
        forget_others(folder / CACHE, {e.digest for e in experiments.values()})
        done: dict[str, Results] = {}
        for name, experiment, results in flown(experiments, folder / CACHE, resources, console):
            target = folder / "variants" / name if name else folder
            write(results, target)
            put(target / "resolved.yaml", resolved(experiment.scenario))
            done[name] = results
        first = done[""]
        done[""] = attempt("the error budget", lambda: with_budgets(experiments[""], first, resources.workers), first)
        if done[""].budgets:
            write_summary(done[""], folder)
        others = {name: results for name, results in done.items() if name}
        source = main.published.source if main.published else ""
        text = {"question": main.question, "notes": main.notes, "source": source}
        for name in () if pictures else ("*.png", "*.svg"):
            for older in (folder / "figures").glob(name):
                older.unlink()
        attempt("the page", lambda: render_experiment(done[""], others, folder, text=text, pictures=pictures))
        if also is not None:
            also(done[""])
        finish(folder, main, done[""])
    return done, failed


@contextmanager
def bar(console: Console, label: str, total: int) -> Iterator[tuple[Any, Any]]:
    """A bar of progress: yields what is reported of every step (done, total, what) and what is reported of warnings.

    Parameters
    ----------
    console : Console
    label : str
    total : int
    """

    def say(text: str) -> None:
        print_text(console, f"Warning: {text}.")

    try:
        with flying(console, label, total) as step:
            yield step, say
    except KeyboardInterrupt:
        console.print("Interrupted. Finished realizations are kept; the same command goes on from there.")
        raise


def flown(
    experiments: Mapping[str, Experiment], cache: Path, resources: Resources, console: Console
) -> Iterator[tuple[str, Experiment, Results]]:
    """Yield (variant, experiment, results), with a bar of progress each.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    cache : path
    resources : Resources
    console : Console
    """
    from insemu.evaluate import answer, run_experiment

    def preview(first: Results) -> None:
        if (said := answer(first)) is not None:
            text = f"After {count_of(first.realizations, 'realization')} and {first.timing['wall_seconds']:.0f} s of flying: {said.sentence}"
            print_text(console, text)

    for name, experiment in experiments.items():
        label = name or experiment.scenario.title.split(":")[0][:24]
        with bar(console, label, experiment.realizations) as (step, say):
            here = replace(resources, cache=cache, progress=step, say=say)
            results = run_experiment(experiment, resources=here, preview=None if name else preview)
        yield name, experiment, results


def with_budgets(experiment: Experiment, results: Results, workers: int = 1) -> Results:
    """The results with an error budget of every design that allows a covariance analysis.

    Parameters
    ----------
    experiment : Experiment
    results : Results
    workers : int
        Threads.
    """
    from insemu.evaluate import analysable, analyse_designs, outage_budgets

    if not 0 < len(results.outages) <= MOST_BUDGETS or not analysable(experiment)[0]:
        return results
    return replace(results, budgets=outage_budgets(analyse_designs(experiment, workers=workers), results.outages))


def forget_others(cache: Path, digests: set[str]) -> None:
    """Delete finished parts of earlier versions of the scenario, its data or the code."""
    import shutil

    if cache.is_dir():
        for folder in cache.iterdir():
            if folder.name not in digests:
                shutil.rmtree(folder) if folder.is_dir() else folder.unlink()


def show(console: Console, main: Results, variants: dict[str, Results]) -> None:
    """The tables at the end."""
    from insemu.evaluate import answer, verdicts
    from insemu.report import tables as report
    from insemu.report.budget import budget_lines

    console.print(f"\n{main.title}", soft_wrap=True, markup=False)
    said = answer(main)
    if said:
        console.print(f"{said.sentence}\n", markup=False, highlight=False, style="bold")
    title = (
        f"{report.variant_caption(main)}: means over {count_of(main.realizations, 'realization')} (seed {main.seed})"
    )
    print_table(console, title, *report.short_headline(main), fit=True, groups=True)
    console.print(
        "(states). verdict: of the NEES at outage end. error: planimetric. stated: the filter's own horizontal sigma at outage end, m. in 3 s: "
        "position errors inside 3 sigma during the outage. NEES: per degree of freedom, 1 is a filter that knows its error. alt.: altitude at "
        "outage end.\n",
        style="dim",
    )
    print_items(console, [*verdicts(main), *report.consistency_lines(main)])
    if main.smoothed and main.outages:
        print_table(console, report.SMOOTHED, *report.smoother_rows(main), groups=True)
    if main.budgets:
        console.print("\nWhere the metres come from, by covariance analysis (parts add up as squares):")
        print_items(console, budget_lines(main.budgets))
    if variants:
        header, body = report.variant_rows(main, variants)
        shown = [
            k for k, heading in enumerate(header) if heading not in ("95 %", "inside %")
        ]  # the page has room for them
        kept = [[row[k] for k in shown] for row in body]
        print_table(console, f"Variants. {report.variant_caption(main)}", [header[k] for k in shown], kept, groups=True)
    for label, results in report.with_published(main, variants):
        for figure in results.published:
            print_table(
                console, f"{label}: {report.FIGURES[figure]}, m", *report.published_table(results, figure), groups=True
            )
        print_items(console, report.rank_lines(results))
    print_items(console, report.pooled_rank_line(main, variants))
