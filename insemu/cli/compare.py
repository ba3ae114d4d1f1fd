"""``insemu compare``: designs side by side, flown or by covariance analysis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import flying, print_json, print_table
from insemu.shown import count_of

if TYPE_CHECKING:
    from insemu.evaluate import ComparisonRow, Experiment


class CompareArguments(Arguments):
    """Of ``insemu compare``."""

    scenario: str = argument("SCENARIO")
    designs: str = option("--designs", "")
    base: str = option("--base", "")
    variant: str | None = option("--variant", None)
    analytic: bool = option("--analytic", False)
    by: str = option("--by", "process")
    realizations: int | None = option("--realizations", None)
    seed: int | None = option("--seed", None)
    workers: int = option("--workers", None)
    cluster: str = option("--cluster", "")
    out: str = option("--output", "", "Folder for the page; with --analytic default results/NAME-compare.")
    as_json: bool = option("--json", False)


def command(args: CompareArguments) -> None:
    """Compare filter designs: paired ratios with intervals, effect sizes and ranks at the end of every outage.

    All designs fly the same data. With --analytic nothing is drawn: rms errors come from the joint covariance of truth and belief, with an error
    budget per outage (how many metres come from each process, initial error and fix) as stacked bars on a page.
    """
    from pathlib import Path

    from insemu.cli.announce import announce_warnings, announce_world
    from insemu.cluster import cluster as dask_cluster
    from insemu.errors import InputError, nearest
    from insemu.evaluate import Experiment, Resources, compare, effort, run_experiment, with_designs
    from insemu.scenario import load

    if args.by not in ("source", "axis", "process"):
        raise InputError(f"unknown part '{args.by}'" + nearest(args.by, ("source", "axis", "process")), where="--by")
    console = Console(stderr=args.as_json)
    given = {"seed": args.seed, "realizations": args.realizations}
    names = [d.strip() for d in args.designs.split(",") if d.strip()]
    asked = with_designs(load(args.scenario, variant=args.variant, overrides=given), names)
    if args.base and args.base not in asked.designs:
        raise InputError(f"no design '{args.base}'" + nearest(args.base, asked.designs), where="--base")
    experiment = Experiment(asked, args.scenario)
    announce_world(experiment.world.card, Console(stderr=True))
    announce_warnings([experiment], Console(stderr=True))
    if args.analytic:
        document = _analytic(
            console,
            experiment,
            args.by,
            Path(args.out) if args.out else Path("results") / f"{Path(args.scenario).stem}-compare",
        )
    else:
        stderr = Console(stderr=True)
        stderr.print(f"Ahead: {effort([experiment], args.workers)}.", soft_wrap=True, highlight=False)
        with (
            dask_cluster(args.cluster, args.workers) as pool,
            flying(stderr, "comparing", experiment.realizations) as progress,
        ):
            results = run_experiment(
                experiment, resources=Resources(workers=args.workers, executor=pool, progress=progress)
            )
        rows = compare(results, args.base or None)
        against = args.base or results.names[0]
        _show(console, rows, results.realizations, against)
        if args.out:
            from insemu.report.comparison import render_comparison

            page = render_comparison(results, rows, against, args.out, source=args.scenario)
            console.print(f"Page: {page}", soft_wrap=True)
        document = {
            "scenario": results.title,
            "digest": results.digest,
            "seed": results.seed,
            "realizations": results.realizations,
            "base": against,
            "rows": [r.to_dict() for r in rows],
        }
    if args.as_json:
        print_json(document)


def _show(console: Console, rows: list[ComparisonRow], realizations: int, base: str) -> None:
    from insemu.report.comparison import COLUMNS, comparison_answer, comparison_rows

    console.print(comparison_answer(rows, base), style="bold", highlight=False, markup=False)
    title = f"Planimetric error at outage end, {count_of(realizations, 'realization')}, against {base}"
    print_table(console, title, *comparison_rows(rows), left=1, fit=True)
    console.print(COLUMNS, style="dim", soft_wrap=True)


def _analytic(console: Console, experiment: Experiment, by: str, folder: Any) -> dict[str, Any]:
    from rich.table import Table

    from insemu.evaluate import analysable, analyse_designs, outage_budgets
    from insemu.report.budget import render_budgets

    analyses = analyse_designs(experiment)
    windows = experiment.world.outage_windows
    budgets = outage_budgets(analyses, windows, by)
    table = Table(
        title="Horizontal error at outage end, rms m, by covariance analysis",
        title_justify="left",
        box=None,
        header_style="underline",
    )
    for heading in ("design", "outage", "rms m", "stated m", "largest parts, m"):
        table.add_column(heading, justify="left" if heading in ("design", "largest parts, m") else "right")
    for name, outages in budgets.items():
        for k, b in enumerate(outages):
            top = ", ".join(f"{key} {value:.3g}" for key, value in list(b["parts_rms_m"].items())[:4])
            lead = name if k == 0 else ""
            table.add_row(lead, str(k + 1), f"{b['rms_m']:.3g}", f"{b['predicted_sigma_m']:.3g}", top)
    console.print(table)
    console.print("Parts add up as squares.")
    reason = analysable(experiment)[1]
    if reason:
        console.print(reason[:1].upper() + reason[1:] + ".", soft_wrap=True)
    page = render_budgets(
        experiment.scenario.title, analyses, windows, folder, by=by, source=str(experiment.file or "")
    )
    console.print(f"Page: {page}", soft_wrap=True)
    return {
        "scenario": experiment.scenario.title,
        "digest": experiment.digest,
        "designs": {
            name: {"states": experiment.ekf(name).layout.n, "outages": outages} for name, outages in budgets.items()
        },
    }
