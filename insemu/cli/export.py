"""``insemu export``: noise models and tracks in the words of other programs."""

from __future__ import annotations

from pathlib import Path

import typer

from insemu.cli.logs import hertz
from insemu.cli.options import Arguments, argument, option
from insemu.errors import InputError


class ExportArguments(Arguments):
    """Of ``insemu export``."""

    file: str = argument(
        "FILE", "Models (YAML of `insemu fit -o`), a recording or track, or a folder of `insemu solve` or `insemu run`."
    )
    out: str = option("--output", ..., "File to write; tracks: .tum, .kml, .gpx, .pos or .csv; an IMU: .imu.")
    to: str = option(
        "--to",
        "",
        "Of models: kalibr, openvins, vins-fusion, gazebo, rotors, px4, kf-gins, gtsam, matlab or gnss-ins-sim. Of .imu: IMAR, LN200, "
        "LN200IG, IXSEA, NAVCHIP_INT or NAVCHIP_FLT.",
    )
    rate: str = option("--rate", "", "Of models: sampling rate of the sensor there; that of their log if not given.")
    record: str = option(
        "--log-length",
        "",
        "Of models: length of the record that they were fitted to; a third of it is the longest time that is checked.",
    )
    reference: bool = option("--reference", False)
    origin: str = option(
        "--origin", "", "Of recordings: date of time 0 (2024-05-01T12:00:00Z), where stamps are no dates."
    )
    outage: list[str] | None = option(
        "--outage", None, "Of recordings: START:END in s, coloured in KML; may be repeated."
    )
    realization: int = option("--realization", 0, "Of runs: which one is drawn in KML, from 0.")


def command(args: ExportArguments) -> None:
    """Write what other programs read.

    Noise models in their words; the track of a recording or a solution as TUM, KML, GPX, RTKLIB .pos or CSV; the ways of a run's designs as
    KML; an IMU as binary .imu.
    """
    target = Path(args.out)
    if Path(args.file).suffix.lower() in (".yaml", ".yml"):
        _models(args.file, target, args.to, args.rate, args.record)
    elif target.suffix.lower() == ".imu":
        _imu(args.file, target, args.to)
    elif (Path(args.file) / "errors.nc").is_file():
        from insemu.evaluate import ways_of_run
        from insemu.formats import write_overlay

        write_overlay(ways_of_run(Path(args.file), args.realization), target)
    else:
        _track(args.file, target, reference=args.reference, origin=args.origin, outage=args.outage or [])
    typer.echo(f"wrote: {target}", err=True)


def _models(file: str, target: Path, to: str, rate: str, record: str) -> None:
    from insemu import units
    from insemu.formats import PROGRAMS, hand_on, read_fitted
    from insemu.whole import put

    if not to:
        raise InputError(f"says no program; expected one of: {', '.join(PROGRAMS)}", where="--to")
    seconds = units.parse(record, "s") if record else None
    text, notes = hand_on(read_fitted(file), to, rate_hz=hertz(rate), record_s=seconds)
    put(target, text)
    for note in notes:
        typer.echo(f"beware: {note}", err=True)


def _imu(file: str, target: Path, to: str) -> None:
    from insemu.formats import IMU_BINARIES, read_imu, write_imu_binary

    if not to:
        raise InputError(f"says no type of IMU; expected one of: {', '.join(IMU_BINARIES)}", where="--to")
    write_imu_binary(target, read_imu(file, on_its_clock=True), to)


def _track(file: str, target: Path, *, reference: bool, origin: str, outage: list[str]) -> None:
    from dataclasses import replace

    from insemu.formats import open_files, seconds_of_date, way_of, write_way
    from insemu.solve import way_of_solution
    from insemu.stamps import OWN

    spans = []
    for text in outage:
        try:
            first, last = (float(w) for w in text.split(":"))
        except ValueError:
            raise InputError(f"is '{text[:40]}', expected START:END in s", where="--outage") from None
        spans.append((first, last))
    if (Path(file) / "solution.nc").is_file():
        way = way_of_solution(Path(file))
        way = replace(way, outages=spans or way.outages)
    else:
        found = open_files(file)
        data = found.reference if reference or found.gnss is None else found.gnss
        if data is None:
            raise InputError("has neither fixes nor a reference", where=file)
        way = way_of(data, Path(file).stem, spans, found.origin)
    if origin:
        zero = seconds_of_date(origin, "--origin")
        way = replace(way, t=way.t + zero, outages=[(a + zero, b + zero) for a, b in way.outages], origin=OWN)
    write_way(way, target)
