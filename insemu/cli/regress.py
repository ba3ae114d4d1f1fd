"""``insemu regress``: hold filter designs against a recorded baseline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.cli.printing import print_json
from insemu.shown import count_of

if TYPE_CHECKING:
    from insemu.evaluate import Baseline, Experiment, Results
    from insemu.require import Requirement

ACTIONS = ("record", "check", "sensitivity", "trial")


class RegressArguments(Arguments):
    """Of ``insemu regress``."""

    action: str = argument("ACTION")
    scenario: str = argument("SCENARIO")
    baseline: str = option("--baseline", ...)
    designs: str = option("--designs", "")
    realizations: int | None = option("--realizations", None)
    seed: int | None = option("--seed", None)
    workers: int = option("--workers", None)
    cluster: str = option("--cluster", "", "record and check: fly on a Dask cluster: local, or tcp://HOST:PORT.")
    false_alarm: float = option("--false-alarm", 0.01, "Probability of reporting designs that did not change.")
    trials: int = option("--trials", 50, min=1, max=DRAWS)
    requirements: list[str] = option("--require", [])
    out: str = option("--page", "", "Write a page with what changed (check, HTML).")
    as_json: bool = option("--json", False)


def command(args: RegressArguments) -> None:
    """Record the accuracy and consistency of a scenario's designs, or check them against a record.

    record writes the baseline. check flies again and exits with 1 and the differences where a design changed. sensitivity prints the
    smallest change of every believed parameter that a check finds. trial flies with other draws, and with gyro or GNSS noise believed 20 %
    wrong, and prints how often a change was reported.
    """
    from insemu.cli.announce import announce_world
    from insemu.cli.printing import flying
    from insemu.cluster import cluster as dask_cluster
    from insemu.errors import InputError, nearest
    from insemu.evaluate import Baseline, Experiment, Resources, run_experiment, with_designs
    from insemu.require import asked
    from insemu.scenario import load

    if args.action not in ACTIONS:
        raise InputError(f"unknown action '{args.action}'" + nearest(args.action, ACTIONS))
    if args.action == "record" and not Path(args.baseline).resolve().parent.is_dir():
        raise InputError(f"the folder of {args.baseline} does not exist", where="--baseline")
    held = None if args.action == "record" else Baseline.read(args.baseline)
    required = asked(args.requirements) if args.requirements else ()
    if required and args.action != "check":
        raise InputError(f"found with {args.action}, expected with check", where="--require")
    wanted = [d.strip() for d in args.designs.split(",") if d.strip()] or (list(held.figures) if held else [])
    console = Console(stderr=args.as_json)

    def make(other_seed: int | None = None) -> Experiment:
        given = {"seed": args.seed if other_seed is None else other_seed, "realizations": args.realizations}
        experiment = Experiment(with_designs(load(args.scenario, overrides=given), wanted), args.scenario)
        if other_seed is None:
            announce_world(experiment.world.card, Console(stderr=True))
        return experiment

    def fly(label: str) -> Results:
        experiment = make()
        shown = flying(Console(stderr=True), label, experiment.realizations)
        with dask_cluster(args.cluster, args.workers) as pool, shown as progress:
            return run_experiment(
                experiment, resources=Resources(workers=args.workers, executor=pool, progress=progress)
            )

    if args.action == "record":
        results = fly("recording")
        Baseline.of(results).write(args.baseline)
        what = f"{count_of(len(results.names), 'design')}, {count_of(results.realizations, 'realization')}"
        console.print(f"Recorded {what}, seed {results.seed}: {args.baseline}", soft_wrap=True)
        return
    assert held is not None
    if args.action == "check":
        _check(console, fly("checking"), held, required, args)
    elif args.action == "sensitivity":
        _sensitivity(console, make(), held, args)
    else:
        _trial(console, make, held, args)


def _check(
    console: Console,
    results: Results,
    held: Baseline,
    required: Sequence[Requirement],
    args: RegressArguments,
) -> None:
    from insemu.evaluate import check
    from insemu.report.comparison import regression_answer
    from insemu.require import guards

    changes = check(results, held, false_alarm=args.false_alarm)
    changed = [c for c in changes if c.significant]
    watched = guards(results, required)
    if args.out:
        from insemu.report.comparison import render_regression
        from insemu.report.integrity import integrity_sections

        about = {"baseline": Path(args.baseline).name, "recorded with digest": held.digest, "now": results.digest}
        console.print(
            f"Page: {render_regression(changes, args.false_alarm, args.out, source=args.scenario, about=about, more=integrity_sections(watched))}",
            soft_wrap=True,
        )
    if args.as_json:
        rows = [vars(c) | {"significant": c.significant} for c in changes]
        print_json(
            {
                "digest": results.digest,
                "changed": len(changed),
                "figures": rows,
                "required": [g.to_json() for g in watched],
            }
        )
    console.print(regression_answer(changes, args.false_alarm), style="bold", highlight=False)
    for c in changed:
        console.print(str(c), soft_wrap=True, style="red")
    for g in watched:
        console.print(str(g), soft_wrap=True, highlight=False, style=None if g.kept else "red")
    if changed or not all(g.kept for g in watched):
        raise typer.Exit(1)
    console.print("Smallest change that would have been found (80 % power):")
    for c in changes:
        part = 100 * c.detectable / abs(c.before) if c.before else float("nan")
        console.print(f"  {c.design}: {c.figure} {c.before:.4g} ± {c.detectable:.2g} ({part:.2g} %)", soft_wrap=True)


def _sensitivity(console: Console, experiment: Experiment, held: Baseline, args: RegressArguments) -> None:
    from insemu.evaluate import smallest_detectable

    found = {
        d: smallest_detectable(experiment, held, d, false_alarm=args.false_alarm, workers=args.workers)
        for d in held.figures
    }
    if args.as_json:
        print_json(found)
        return
    console.print("Smallest change of what a filter believes that a check with other draws finds (80 % power):")
    for design, parameters in found.items():
        for name, change in parameters.items():
            console.print(
                f"  {design}: {name} {100 * change:.2g} %" if change < 1e3 else f"  {design}: {name} not seen"
            )


def _trial(console: Console, make: object, held: Baseline, args: RegressArguments) -> None:
    from insemu.evaluate import Alteration, trial

    cases = [
        None,
        Alteration("gyro", "WN1.N", 1.2),
        Alteration("gyro", "WN1.N", 0.8),
        Alteration("gnss", "position", 1.2),
        Alteration("gnss", "position", 0.8),
    ]
    found = trial(make, held, cases, args.trials, false_alarm=args.false_alarm, workers=args.workers)
    if args.as_json:
        print_json({"trials": args.trials, "reported": found})
        return
    for name, count in found.items():
        console.print(f"{name}: reported in {count} of {args.trials} trials")
