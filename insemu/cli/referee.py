"""``insemu referee``: whether a filter, of whatever kind, states its own errors."""

from __future__ import annotations

import typer

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_text


class RefereeArguments(Arguments):
    """Of ``insemu referee``."""

    filters: list[str] = argument("[FILTER...]", default=None)
    worlds: str = option("--worlds", "")
    realizations: int | None = option("--realizations", None, "Flights of a filter in each world; default 48.")
    seed: int | None = option("--seed", None, "Seed of all random draws; default 1.")
    false_alarm: float | None = option(
        "--false-alarm", None, "Probability that a right filter is accused of anything; default 0.01."
    )
    workers: int = option("--workers", None)
    out: str = option("--output", "", "Folder for page, referee.json and timing.json; default results/referee.")
    as_json: bool = option("--json", False)


def command(args: RefereeArguments) -> None:
    """Fly filters through worlds of many kinds and say whether they state their own errors, where they do not, and what would have been found.

    Without a name all families that come with insemu. Exits with 1 where a filter does not state its errors. The page and referee.json are the same
    to the byte for the same seed; what an epoch costs is in timing.json. An interrupted call goes on where it stopped.
    """
    import json
    import shutil
    from pathlib import Path

    from rich.console import Console

    from insemu.cli.printing import print_table
    from insemu.evaluate import CACHE, Resources, only_writer
    from insemu.referee import referee
    from insemu.report.referee import referee_answer, render_referee, start_rows, world_rows
    from insemu.whole import put

    folder, console, aside = Path(args.out or "results/referee"), Console(), Console(stderr=True)
    with only_writer(folder), aside.status("") as status:
        found = referee(
            args.filters or (),
            names=[n.strip() for n in args.worlds.split(",") if n.strip()],
            realizations=args.realizations,
            seed=args.seed,
            false_alarm=args.false_alarm,
            resources=Resources(args.workers, cache=folder / CACHE),
            progress=lambda name, world: status.update(f"{name}: {world}"),
        )
        document = json.dumps([j.to_json() for j in found], indent=1, allow_nan=False)
        put(folder / "referee.json", document + "\n")
        seconds = {j.name: j.seconds_per_epoch for j in found}
        put(folder / "timing.json", json.dumps({"cpu_seconds_per_epoch": seconds}, indent=1) + "\n")
        shutil.rmtree(folder / CACHE, ignore_errors=True)  # all of it is in the page
        page = render_referee(found, folder / "index.html", source=", ".join(j.name for j in found))
    if args.as_json:
        typer.echo(document)
    else:
        print_text(console, referee_answer(found), style="bold")
        for j in found if len(found) > 1 else ():
            print_text(console, f"  {j.verdict}")
        print_table(console, "First inconsistency", *world_rows(found), left=len(found) + 1, fit=True)
        print_table(console, "Starts that converge", *start_rows(found), left=len(found) + 1, fit=True)
        for name, value in seconds.items():
            console.print(f"{name}: {1e6 * value:.3g} us of CPU an epoch", soft_wrap=True, highlight=False)
        console.print(f"\nPage: {page} (referee.json next to it)", soft_wrap=True, highlight=False)
    if any(j.accused for j in found):
        raise typer.Exit(1)
