"""``insemu sweep``: which sensor, which model, for which outage, over a matrix of scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import Bars, print_json, print_table, print_text

if TYPE_CHECKING:
    from insemu.evaluate import Resources, Row, Sweep


class SweepArguments(Arguments):
    """Of ``insemu sweep``."""

    scenario: str = argument("SCENARIO")
    over: str = option("--over", ...)
    latin: int = option(
        "--latin",
        0,
        "So many points of a Latin hypercube instead of all combinations; keys may then have ranges, LOW..HIGH.",
        min=0,
    )
    linear: int = option("--linear", 0, "Fly nothing: so many realizations to first order at each point.")
    realizations: int | None = option("--realizations", None, "At each point; default the scenario's.")
    seed: int | None = option("--seed", None, "The same at every point; default the scenario's.")
    workers: int = option("--workers", None)
    cluster: str = option("--cluster", "")
    out: str = option("--output", "", "Folder for results; default results/NAME-sweep.")
    as_json: bool = option("--json", False)


def command(args: SweepArguments) -> None:
    """Run a scenario with other values at some keys: every combination, or a Latin hypercube, as one experiment with one table.

    KEY is any key of the scenario (insemu schema), its parts parted by dots, or one of: sensor (the truth's card), outage (duration of every outage),
    trajectory. All points have the same seed. Writes sweep.csv, sweep.json and a page; points that are finished are kept, and the same
    command goes on from there.
    """
    import json

    from insemu.cluster import cluster as dask_cluster
    from insemu.compiled import compiled_beside
    from insemu.evaluate import CACHE, Resources, Sweep, only_writer
    from insemu.report.sweep import render_sweep
    from insemu.whole import put

    stderr = Console(stderr=True)
    folder = Path(args.out) if args.out else Path("results") / f"{Path(args.scenario).stem}-sweep"
    sweep = Sweep.of(
        args.scenario,
        args.over,
        latin=args.latin,
        linear=args.linear,
        overrides={"seed": args.seed, "realizations": args.realizations},
    )
    stderr.print(
        f"{len(sweep.points)} points of {', '.join(f.key for f in sweep.given)}.", highlight=False, markup=False
    )
    with (
        compiled_beside("insemu.evaluate.kernels", "insemu.filters.kernel.run"),
        only_writer(folder),
        dask_cluster(args.cluster, args.workers) as pool,
    ):
        rows = _rows(sweep, folder / CACHE, Resources(args.workers, pool))
        document = {
            "scenario": sweep.scenario.title,
            "over": args.over,
            "latin": args.latin,
            "seed": sweep.scenario.seed,
            "realizations": args.linear or sweep.scenario.realizations,
            "linear": bool(args.linear),
            "rows": [row.flat() for row in rows],
        }
        put(folder / "sweep.json", json.dumps(document, indent=1))
        put(folder / "sweep.csv", _csv(rows))
        page = render_sweep(sweep, rows, folder)
    if args.as_json:
        print_json(document)
    else:
        _show(Console(), sweep, rows, page)


def _rows(sweep: Sweep, cache: Path, resources: Resources) -> list[Row]:
    """All rows, with a bar for the points and what each is at."""
    from dataclasses import replace

    from insemu.errors import InputError

    stderr = Console(stderr=True)
    rows: list[Row] = []
    with Bars(stderr) as shown:
        task = shown.add_task("points", total=len(sweep.points))

        def progress(done: int, total: int) -> Any:
            def step(flown: int, of: int, what: str) -> None:
                shown.update(task, completed=done, description=f"points ({what} {flown}/{of})")

            shown.update(task, completed=done)
            return step

        def say(text: str) -> None:
            print_text(stderr, f"Warning: {text}.")

        try:
            for found in sweep.rows(cache, replace(resources, say=say), progress=progress):
                if not found:
                    raise InputError(
                        "the scenario has no outage at whose end errors could be computed", where=str(sweep.file)
                    )
                rows += found
        except KeyboardInterrupt:
            shown.stop()
            stderr.print("Interrupted. Finished points are kept; the same command goes on from there.")
            raise
        shown.update(task, completed=len(sweep.points), description="points")
    return rows


def _csv(rows: Sequence[Row]) -> str:
    import csv
    import io

    stream = io.StringIO(newline="")
    table = csv.DictWriter(stream, list(rows[0].flat()))
    table.writeheader()
    table.writerows(row.flat() for row in rows)
    return stream.getvalue()


def _show(console: Any, sweep: Sweep, rows: Sequence[Row], page: Path) -> None:
    from insemu.report.sweep import SWEPT, sweep_answer, sweep_rows

    print_text(console, f"\n{sweep_answer(sweep, rows)}", style="bold")
    header, body = sweep_rows(sweep, rows)
    print_table(console, sweep.scenario.title, header, body, left=len(sweep.given) + 1, fit=True, groups=True)
    console.print(SWEPT, style="dim", soft_wrap=True, highlight=False)
    for design in dict.fromkeys(r.design for r in rows if r.why):
        found = [r for r in rows if r.design == design and r.why]
        print_text(
            console,
            f"{design} is not linear at {len(found)} of {len(sweep.points)} points, where runs at long steps stand for it. Point {found[0].point}: "
            f"{found[0].why}.",
        )
    console.print(f"\nPage: {page} (sweep.csv, sweep.json next to it)", soft_wrap=True, highlight=False)
