"""``insemu require``: which IMU keeps an error after an outage, and what would just do."""

from __future__ import annotations

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json, print_text


class RequireArguments(Arguments):
    """Of ``insemu require``."""

    requirements: list[str] = argument("REQUIREMENT...")
    track: str = option(
        "--track", "", "Track or waypoints, or the name of a built-in trajectory; default a drive in town."
    )
    vehicle: str = option("--vehicle", "car")
    fixes: str = option("--fixes", "")
    aids: str = option("--aids", "")
    have: str = option("--have", "")
    transfer: str = option("--transfer", "")
    realizations: int | None = option(
        "--realizations", None, "Flights of the full filter where the linear answer is doubtful; default none."
    )
    out: str = option("--output", "", "Folder for page, require.json and scenario.yaml; default results/TRACK-require.")
    as_json: bool = option("--json", False)


def command(args: RequireArguments) -> None:
    """Say which IMU keeps a required error at the end of an outage, what limits each, and the figures that would just do.

    Every sensor card flies the track with the filter that knows its figures, to first order. Writes a page, require.json and scenario.yaml,
    which flies the answer with the full filter (insemu run).
    """
    import json
    from pathlib import Path

    from rich.console import Console

    from insemu.cli.printing import print_items, print_table
    from insemu.evaluate import only_writer
    from insemu.report.require import aid_rows, frontier_rows, place_rows, render_require, require_notes, require_rows
    from insemu.require import require, wish_of
    from insemu.whole import put

    folder = Path(args.out) if args.out else Path("results") / f"{Path(args.track).stem or 'drive'}-require"
    scenario = folder / "scenario.yaml"
    found = require(
        args.requirements,
        wish_of(args.track, args.vehicle, args.fixes),
        scenario,
        aids=args.aids,
        have=args.have,
        road=args.transfer,
        realizations=args.realizations or 0,
    )
    with only_writer(folder):
        put(scenario, found.scenario)
        put(folder / "require.json", json.dumps(found.to_json(), indent=1, allow_nan=False))
        page = render_require(found, folder / "index.html", source=args.track)
    if args.as_json:
        print_json(found.to_json(), allow_nan=False)
        return
    console = Console()
    print_text(console, found.text, style="bold")
    print_table(console, "Cards", *require_rows(found), left=2)
    print_items(console, require_notes(found))
    print_table(console, "Figures that just keep it", *frontier_rows(found), left=3)
    if len(found.alternatives) > 1:
        print_table(console, "Aids", *aid_rows(found), left=1, fit=True)
    print_table(console, f"Along the track, {found.chosen.sensor.name}", *place_rows(found), left=0)
    console.print(
        f"\nPage: {page} (require.json next to it). Now: insemu run {scenario}", soft_wrap=True, highlight=False
    )
