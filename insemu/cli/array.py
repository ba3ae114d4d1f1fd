"""``insemu array``: several IMUs on one mount made one sensor, weighed for the metres at the ends of outages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu.cli.logs import hertz
from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json
from insemu.errors import InputError, nearest

if TYPE_CHECKING:
    from insemu.array import ArrayFit
    from insemu.noise import NoiseModel
    from insemu.records import Series


class ArrayArguments(Arguments):
    """Of ``insemu array``."""

    files: list[str] = argument(
        "LOG...",
        "Log at rests, one per IMU and sampled together, or one log whose columns name the IMU (gx_1, imu2_gyro_x).",
    )
    model: str = option(
        "--model", ..., 'Structure of every axis, for example "WN() + GM()"; shared=NAME is one in all IMUs.'
    )
    scenario: str = option(
        "--scenario",
        "shared_process",
        "Flight with outages: a scenario file, or one that comes with insemu. Its first design says how the filter runs.",
    )
    plus: str = option(
        "--plus",
        "",
        'What every IMU has in addition to its fit: "gyro=RC(sigma=0.1 deg/s), accel=RC(sigma=5 mg)", a turn-on bias.',
    )
    rate: str = option("--rate", "")
    skip: str = option("--skip", "0 s")
    take: str = option("--take", "metres")
    out: str = option("--output", "", "Write the virtual sensor's models (YAML) for a scenario.")
    log: str = option("--log", "", "Write the virtual sensor's static log (.npz or .csv), for insemu fit.")
    page: str = option("--page", "")
    seed: int = option("--seed", 0, "Seed of the draws behind the intervals.")
    as_json: bool = option("--json", False)


def command(args: ArrayArguments) -> None:
    """Weigh the IMUs of an array: equally, by variance, scale-wise, and for the fewest metres at outage end."""
    import numpy as np

    from insemu.array import EQUAL, INVERSE, METRES, SCALE_WISE, Flight, weigh
    from insemu.cli.fit import write
    from insemu.formats import write as write_log
    from insemu.scenario import load, located

    names = {"metres": METRES, "scale-wise": SCALE_WISE, "inverse": INVERSE, "equal": EQUAL}
    if args.take not in names:
        raise InputError(f"found '{args.take}'" + nearest(args.take, names), where="--take")
    if args.log and Path(args.log).suffix not in (".npz", ".csv"):
        raise InputError(f"found the suffix '{Path(args.log).suffix}', expected .npz or .csv", where="--log")
    beside = _plus(args.plus)
    path = located(args.scenario)
    flight = Flight(load(path), path)
    console = Console(stderr=args.as_json)
    logs = _read(args.files, args.rate, args.skip)
    with Console(stderr=True).status("reading") as status:
        say = status.update if console.is_terminal else lambda text: typer.echo(text, err=True)
        found = weigh(logs, args.model, flight, plus=beside, say=say, rng=np.random.default_rng(args.seed))
    if args.as_json:
        print_json(found.to_json(), allow_nan=False)
    else:
        _tell(found, console)
    if args.log:
        write_log(Path(args.log), found.virtual(names[args.take]))
        console.print(f"log of the virtual sensor: {args.log}")
    if args.out:
        write(found.fitted(args.model, names[args.take]), args.out, console)
    if args.page:
        from insemu.report.array import render_array

        console.print(f"page: {render_array(found, args.page, source=' '.join(args.files))}")


def _read(files: list[str], rate: str, skip: str) -> dict[str, dict[str, Series]]:
    """Log at rests by IMU."""
    from insemu.array import by_unit
    from insemu.cli.announce import announce
    from insemu.cli.logs import read_static

    if len(files) == 1:
        return by_unit(read_static(files[0], rate, None, skip), files[0])
    out: dict[str, dict[str, Series]] = {}
    for file in files:
        announce(file, hertz(rate))
        name = Path(file).stem
        if name in out:
            name = file
        if name in out:
            raise InputError("is named twice, expected one log per IMU", where=file)
        found = by_unit(read_static(file, rate, None, skip), file)
        if len(found) > 1:
            raise InputError(f"holds {len(found)} IMUs, expected one per log, or all in one log", where=file)
        out[name] = next(iter(found.values()))
    return out


def _plus(text: str) -> dict[str, NoiseModel]:
    """What is written together with the fits, by axis."""
    from insemu.covariates import parts_of
    from insemu.noise import NoiseModel, axis_unit
    from insemu.records import AXES

    out: dict[str, NoiseModel] = {}
    for part in parts_of(text):
        name, found, model = part.partition("=")
        axes = [a for a in AXES if name.strip() in (a, a.partition("_")[0])]
        if not found or not axes:
            raise InputError(f"found '{part}', expected gyro=MODEL or an axis", where="--plus")
        for axis in axes:
            out[axis] = NoiseModel.parse(model, axis_unit(axis))
            if not out[axis].specified:
                raise InputError(f"found '{model.strip()}', expected a model with values", where="--plus")
    return out


def _tell(found: ArrayFit, console: Console) -> None:
    """The answer on the terminal: metres of every weighting, weights of the units, pairs that are not independent."""
    from insemu.cli.printing import print_table
    from insemu.report.array import array_answer, weight_rows, weighting_rows

    console.print(array_answer(found), highlight=False, style="bold")
    print_table(console, "Horizontal error at the ends of the outages", *weighting_rows(found), groups=True)
    print_table(console, "Weights for the fewest metres", *weight_rows(found), groups=True)
    for axis, one, two, p in found.dependent:
        console.print(
            f"[yellow]beware[/yellow]: {axis} of {one} and {two} are not independent (p {p:.1g}); write shared=NAME on the process "
            "that they share",
            highlight=False,
        )
