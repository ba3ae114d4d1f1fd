"""``insemu emulate``: write the recording that a scenario's sensors would make."""

from __future__ import annotations

import typer

from insemu.cli.options import Arguments, argument, option


class EmulateArguments(Arguments):
    """Of ``insemu emulate``."""

    scenario: str = argument("SCENARIO")
    out: str = option("--output", ..., "Recording to write: a .npz file or a folder.")
    realization: int = option("--realization", 0)
    seed: int | None = option("--seed", None)
    variant: str | None = option("--variant", None)
    ideal: bool = option("--ideal", False)
    figure: str = option("--figure", "", "Also draw track, speed, turn rate and residuals (PNG, PDF or SVG).")
    page: str = option("--page", "")
    as_json: bool = option("--json", False)


def command(args: EmulateArguments) -> None:
    """Emulate one realization of a scenario: IMU with its errors, GNSS with its outages, and the reference.

    Every other command reads the recording that it writes; realization 7 is the one that insemu run flies as its
    eighth.
    """
    import json
    import math

    from insemu.evaluate import EmulatedWorld
    from insemu.formats import check_target, write
    from insemu.scenario import load

    check_target(args.out, log=False)
    drawn = [file for file in (args.figure, args.page) if file]
    if drawn:
        from insemu.report.track import check_figure, draw_track

        check_figure(args.figure, args.page)
    given = load(args.scenario, variant=args.variant, overrides={"seed": args.seed})
    world = EmulatedWorld(given, args.scenario)
    for warning in world.warnings:
        typer.echo(f"insemu: warning: {warning}", err=True)
    recording = world.recording(args.realization, ideal=args.ideal)
    path = write(args.out, recording)
    for file in drawn:
        draw_track(
            world.flight,
            file,
            track=world.track,
            source=args.scenario,
            length_s=world.duration_s,
            outages=world.outage_windows,
        )
    gnss = recording.gnss
    start = [math.degrees(x) for x in world.reference.llh[0, :2]]
    place = f"{abs(start[0]):.5f} {'NS'[start[0] < 0]} {abs(start[1]):.5f} {'EW'[start[1] < 0]}"
    summary = {
        "recording": str(path),
        "trajectory": world.flight.name,
        "start_lat_lon_deg": start,
        "duration_s": float(recording.imu.t[-1] - recording.imu.t[0]),
        "imu_samples": len(recording.imu),
        "imu_kind": recording.imu.kind,
        "imu_rate_hz": round(1.0 / recording.imu.dt, 6),
        "gnss_fixes": 0 if gnss is None else len(gnss),
        "path_distance_m": world.path_distance_m,
        "mode": world.source.mode,
        "realization": args.realization,
        "seed": given.seed,
        "warnings": list(world.warnings),
    }
    if args.as_json:
        typer.echo(json.dumps(summary))
        return
    typer.echo(
        f"{path}: {summary['trajectory']} from {place}, {summary['duration_s']:g} s, {summary['imu_samples']} IMU {summary['imu_kind']}s at "
        f"{summary['imu_rate_hz']:g} Hz, {summary['gnss_fixes']} fixes; reference within {1e3 * world.path_distance_m:.3g} mm "
        f"of the path ({world.source.mode})"
    )
