"""``insemu vehicle``: what a recording tells of its vehicle, as a file that an emulation drives."""

from __future__ import annotations

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json


class VehicleArguments(Arguments):
    """Of ``insemu vehicle``."""

    recording: str = argument("RECORDING")
    out: str = option("--output", ..., "Vehicle file to write (YAML); a scenario takes it as vehicle: {file: ...}.")
    kind: str = option("--vehicle", "car")
    models: str = option("--models", "")
    sensor_out: str = option("--sensor-output", "")
    column_map: str = option("--map", "")
    span: tuple[str, str] | None = option("--span", None)
    name: str = option("--name", "")
    as_json: bool = option("--json", False)


def command(args: VehicleArguments) -> None:
    """Learn a vehicle from a recording: spectra and phases of the six axes by regime, sideslip, jerk, with standard deviations.

    The sensor's noise is removed as standstills show it, or as --models says. What the recording cannot tell is printed and stands in the file.
    """
    from pathlib import Path

    from rich.console import Console

    from insemu import formats, units
    from insemu.cli.printing import print_items, print_table
    from insemu.drives import learn_vehicle
    from insemu.emulate import VEHICLES, vehicle_text
    from insemu.errors import InputError, nearest
    from insemu.noise import load, save
    from insemu.report import drives as report
    from insemu.whole import put

    if args.kind not in VEHICLES:
        raise InputError(f"unknown vehicle '{args.kind}'" + nearest(args.kind, VEHICLES), where="--vehicle")
    console = Console(stderr=args.as_json, highlight=False)
    found = learn_vehicle(
        formats.open_files(args.recording, maps=(args.column_map, "", "")).recording(),
        kind=args.kind,
        name=args.name or Path(args.recording).stem,
        models=load(args.models) if args.models else None,
        span=None if args.span is None else (units.parse(args.span[0], "s"), units.parse(args.span[1], "s")),
    )
    put(args.out, vehicle_text(found.vehicle))
    if args.sensor_out:
        save(found.sensor, args.sensor_out)
    if args.as_json:
        print_json({"vehicle": args.out, "seconds": found.seconds, "unknown": list(found.vehicle.spectrum.unknown)})
        return
    print_table(
        console,
        "What the vehicle does next to its path, root mean square",
        *report.vehicle_rows(found),
        left=4,
        fit=True,
    )
    console.print()
    print_items(console, report.vehicle_lines(found))
    console.print(
        f"\nVehicle: [bold]{args.out}[/bold] (trajectory: {{track: ..., vehicle: {{file: {args.out}}}}})",
        soft_wrap=True,
    )
