"""``insemu open``: what a file is, on one card, and the recording or log that the other commands take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json
from insemu.errors import InputError

if TYPE_CHECKING:
    from insemu.formats import Log, Opened
    from insemu.intake import Card


class OpenArguments(Arguments):
    """Of ``insemu open``."""

    file: str = argument(
        "FILE", "Any log, recording, bag, track or folder; the one with the IMU where there are several.", default=""
    )
    gnss: str = option("--gnss", "")
    truth: str = option("--truth", "")
    column_map: str = option(
        "--map", "", "Columns and settings: 'gyro=omega_*[deg/s], accel=a_*[g], time=stamp[ns], axes=FLU'."
    )
    gnss_map: str = option("--gnss-map", "")
    truth_map: str = option("--truth-map", "")
    rate: str = option("--rate", "", "Sampling rate of a file without stamps, such as '100 Hz'.")
    out: str = option("--output", "", "Write what was found: .npz, .csv, or a folder.")
    save_map: bool = option("--save-map", False)
    as_json: bool = option("--json", False)
    formats: bool = option("--formats", False)


def command(args: OpenArguments) -> None:
    """Say what a file is: rate, gaps, units, axes, clocks, each with its evidence; write it as a recording or a log.

    What contradicts physics is refused (exit code 2) with the command that mends it.
    """
    from insemu.formats import check_target, parse_map, write_preset
    from insemu.intake import take

    console = Console(stderr=args.as_json, soft_wrap=True, highlight=False)
    if args.formats:
        from insemu.formats import known_readers

        for name in dict.fromkeys(r.name for r in known_readers()):
            typer.echo(name)
        return
    if not args.file:
        raise InputError("names no file; `insemu open --formats` lists the kinds that are read", where="insemu open")
    if args.out:
        check_target(args.out)
    line = ", ".join(part for part in (args.column_map, f"rate={args.rate}" if args.rate else "") if part)
    found, card = take(args.file, gnss=args.gnss, truth=args.truth, maps=(line, args.gnss_map, args.truth_map))
    if args.as_json:
        print_json(card.to_json())
    else:
        show(console, card)
    card.check()
    if args.out:  # first: what it refuses leaves no map either
        console.print(f"wrote: {write(found, Path(args.out))}", markup=False)
    if args.save_map:
        preset = write_preset(Path(args.file), parse_map(line))
        console.print(f"map: {preset}", markup=False)


def show(console: Console, card: Card) -> None:
    """Print the card; findings that need a look stand out."""
    from rich.markup import escape

    colours = {"ok": "", "assumed": "cyan", "odd": "yellow", "wrong": "bold red"}
    console.print(f"[bold]{escape(card.source)}[/bold]: {escape(card.kind)}")
    for line in card.lines:
        text = escape(str(line))
        console.print(f"  [{colours[line.level]}]{text}[/]" if colours[line.level] else f"  {text}")
    if card.of("odd") or card.of("assumed"):
        console.print("  (~ assumed, ? worth a look, ! contradicts physics)")


def write(found: Opened | Log, target: Path) -> Path:
    """Write a recording, or a log at rest of an IMU alone at an even rate."""
    import numpy as np

    from insemu import formats
    from insemu.formats import Log

    if isinstance(found, Log):
        raise InputError("holds no IMU; there is nothing to convert", where=str(target))
    data = found.recording()
    imu = data.imu
    step = np.diff(imu.t)
    even = float(np.abs(step - imu.dt).max()) < 0.5 * imu.dt
    if data.gnss is not None or data.reference is not None or not even:
        return formats.write(target, data)
    return formats.write(target, Log.of_imu(imu, str(target)).series() if target.suffix else data)
