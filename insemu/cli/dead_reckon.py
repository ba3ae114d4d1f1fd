"""``insemu dead-reckon``: navigate a recording's IMU alone and compare with its reference, or its fixes."""

from __future__ import annotations

import typer

from insemu.cli.options import argument, option


def command(
    recording: str = argument("RECORDING", "Recording with a reference, or with fixes."),
    gravity: str = option("--gravity", "normal"),
    out: str = option("--page", "", "Write a page with the errors over time (HTML)."),
    as_json: bool = option("--json", False),
) -> None:
    """Dead-reckon a recording from its own reference at the first IMU epoch.

    Prints the largest and the final position error, the largest velocity and attitude error against the reference
    (ref_*), and how many epochs a second the mechanization does. Without a reference it starts as `insemu solve` does,
    less the biases that the start finds, and is held against the fixes.
    """
    import json
    from dataclasses import replace

    from rich.console import Console

    from insemu.cli.announce import announce
    from insemu.cli.printing import print_items
    from insemu.emulate import dead_reckon
    from insemu.formats import read_recording
    from insemu.prepared import prepared

    console = Console(stderr=True)
    announce(recording)
    data, start, said = read_recording(recording), None, tuple[str, ...]()
    if data.reference is None and data.gnss is not None:
        data, start, said = prepared(data).started().alone()
    result = replace(dead_reckon(data, gravity=gravity, start=start), said=said)
    print_items(console, said)
    if out:
        from insemu.report.track import render_reckoning

        page = render_reckoning(result, out)
    if as_json:
        typer.echo(json.dumps(result.to_dict()))
        return
    typer.echo(
        f"{result.source}: {result.epochs} epochs ({result.kind}s) from {result.start_s:g} to {result.end_s:g} s, gravity {gravity}"
    )
    rows = (
        ("largest position error", result.max_position_error_m, "m"),
        ("final position error", result.final_position_error_m, "m"),
        ("largest velocity error", result.max_velocity_error_m_s, "m/s"),
        ("largest attitude error", result.max_attitude_error_rad, "rad"),
        ("speed", result.epochs_per_second / 1e6, "million epochs/s"),
    )
    for name, value, unit in (row for row in rows if row[1] == row[1]):  # not NaN
        typer.echo(f"  {name:<24}{value:>14.6g} {unit}")
    if out:
        typer.echo(f"Page: {page}")
