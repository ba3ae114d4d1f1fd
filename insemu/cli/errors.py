"""``insemu errors``: error signals of an IMU under dynamics, from a better one on the same mount."""

from __future__ import annotations

import typer

from insemu.cli.options import argument, option


def command(
    unit: str = argument("UNIT"),
    reference: str = argument("REFERENCE"),
    out: str = option("--output", ..., "Log at rest of the errors to write (.npz or .csv)."),
    max_offset: str = option("--max-offset", "10 s"),
) -> None:
    """Write what an IMU recorded less what a reference recorded, time offset, mounting and lever arm removed.

    The file is a source of errors for a scenario (truth: {recorded: {files: [FILE]}}) and a log for `insemu characterise` and `insemu fit`. It
    holds the errors of the reference, too, and the biases.
    """
    from dataclasses import replace
    from pathlib import Path

    import numpy as np

    from insemu import formats, units
    from insemu.emulate import difference
    from insemu.errors import InputError
    from insemu.noise import axis_unit
    from insemu.records import AXES, Series

    target = Path(out)
    if target.suffix not in (".npz", ".csv"):
        raise InputError(f"found the suffix '{target.suffix}', expected .npz or .csv", where="--output")
    own, better = (formats.read_imu(file, on_its_clock=True) for file in (unit, reference))
    one_clock = own.t[0] < better.t[-1] and better.t[0] < own.t[-1]
    starts = [np.floor((own if one_clock else imu).t[0]) for imu in (own, better)]
    own, better = (replace(imu, t=imu.t - start) for imu, start in zip((own, better), starts, strict=True))
    found = difference(own, better, search_s=units.parse(max_offset, "s"))
    if not one_clock:
        typer.echo("the clocks of the two files have no time in common: the time offset is between their starts")
    series = [Series(found.values[:, k], found.rate_hz, axis_unit(a), a) for k, a in enumerate(AXES)]
    formats.write(target, series)
    turn, arm, sigma = np.degrees(found.rpy), found.lever_arm, found.sigma
    typer.echo(
        f"time offset {1e3 * found.offset_s:.2f} ms (1 sigma {1e3 * sigma[0]:.2g}), the turn rates correlate by {found.correlation:.3f}"
    )
    typer.echo(
        f"mounting {turn[0]:.3f} {turn[1]:.3f} {turn[2]:.3f} deg (1 sigma of a turn about x, y, z {_three(np.degrees(sigma[1:4]))})"
    )
    typer.echo(f"lever arm {arm[0]:.3f} {arm[1]:.3f} {arm[2]:.3f} m (1 sigma {_three(sigma[4:])})")
    for said in found.said:
        typer.echo(said)
    for axis, one in zip(AXES, series, strict=True):
        mean, rms = float(one.values.mean()), float(one.values.std())
        typer.echo(f"  {axis:<8} mean {mean:>10.3g}  standard deviation {rms:>10.3g} {one.unit}")
    typer.echo(f"wrote: {target} ({len(found.t)} samples at {found.rate_hz:g} Hz)", err=True)


def _three(values: object) -> str:
    import numpy as np

    return " ".join(f"{v:.2g}" for v in np.asarray(values))
