"""``insemu init``: a first scenario that runs."""

from __future__ import annotations

import json

import typer

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json


class InitArguments(Arguments):
    """Of ``insemu init``."""

    file: str = argument("[FILE]", "Scenario to write; default scenario.yaml, or NAME.yaml with --like.", default="")
    sensor: str = option("--sensor", "", "Sensor of the truth: a name (insemu sensor) or the file of a card.")
    models: str = option("--models", "", "Noise models of the truth in place of a card: the file of `insemu fit -o`.")
    track: str = option("--track", "")
    vehicle: str = option("--vehicle", "car", "car, multirotor, helicopter or fixed_wing, for --track.")
    like: str = option("--like", "")
    listed: bool = option("--list", False)
    force: bool = option("--force", False)
    as_json: bool = option("--json", False)


def command(args: InitArguments) -> None:
    """Write a commented scenario that runs, or copy one that comes with insemu."""
    from pathlib import Path

    from insemu.errors import InputError
    from insemu.whole import put

    if args.listed:
        _list(args.as_json)
        return
    target = Path(args.file or (f"{args.like}.yaml" if args.like else "scenario.yaml"))
    if target.suffix not in (".yaml", ".yml"):
        raise InputError("a scenario's name ends with .yaml", where=str(target))
    if not target.parent.is_dir():
        raise InputError("no such folder", where=str(target.parent))
    if args.like:
        from insemu.scenario import copy_shipped

        if args.sensor or args.models or args.track:
            raise InputError("--like copies a scenario as it is; expected it without --sensor, --models and --track")
        written = copy_shipped(args.like, target, overwrite=args.force)
    else:
        from insemu.scenario import SENSOR, Wish, first_scenario

        if target.exists() and not args.force:
            raise InputError("exists already; --force replaces it", where=str(target))
        if args.sensor and args.models:
            raise InputError("names a card and models of the truth, expected one of them", where="--sensor, --models")
        text = first_scenario(target, Wish(args.sensor or SENSOR, args.models, args.track, args.vehicle))
        put(target, text)
        written = [target]
    if args.as_json:
        typer.echo(json.dumps([str(path) for path in written]))
        return
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo(f"now: insemu run {target}")


def _list(as_json: bool) -> None:

    from rich.console import Console

    from insemu.scenario import shipped_scenarios

    known = shipped_scenarios()
    if as_json:
        rows = {
            name: {"question": one.question, "shared_data": one.shared, "files": one.files}
            for name, one in known.items()
        }
        print_json(rows)
        return
    console = Console()
    for name, one in known.items():
        note = " (needs the shared data folder)" if one.shared else ""
        console.print(f"[bold]{name}[/bold]{note}: {one.question}", soft_wrap=True, highlight=False)
    console.print("\ninsemu run NAME flies one; insemu init --like NAME copies it.", style="dim")
