"""Linear realizations on the command line: a preview of a run, and the help that few full runs get from many linear ones."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from insemu.evaluate import Experiment, Results

#: What a linear realization is, in words.
SAID = "Linear: errors to first order about the flight, without what depends on the data"


def preview(experiment: Experiment, realizations: int, console: Console, *, as_json: bool) -> None:
    """Fly nothing: errors of many linear realizations at the ends of the outages.

    Parameters
    ----------
    experiment : Experiment
    realizations : int
    console : Console
    as_json : bool
        Print JSON on standard output instead of a table.
    """
    import numpy as np
    import typer

    from insemu.cli.printing import print_table
    from insemu.errors import InputError
    from insemu.evaluate import LinearTwin, planimetric, previewed

    if not experiment.world.outage_windows:
        raise InputError("the scenario has no outage at whose end errors could be told", where="--linear")
    twin = LinearTwin(experiment)
    told = previewed(twin, realizations)
    rows: list[dict[str, Any]] = []
    for name, errors in told.errors.items():
        for k, (start, duration) in enumerate(experiment.world.outage_windows):
            e = planimetric(errors[:, k])
            half = 1.96 * float(e.std(ddof=1)) / np.sqrt(e.size)
            rows.append(
                {
                    "design": name,
                    "by": "coarse" if name in told.beyond else "linear",
                    "realizations": len(e),
                    "outage": k + 1,
                    "start_s": start,
                    "duration_s": duration,
                    "mean_m": float(e.mean()),
                    "ci95_m": [float(e.mean()) - half, float(e.mean()) + half],
                    "quantile_95_m": float(np.quantile(e, 0.95)),
                    "rms_m": float(np.sqrt((e**2).mean())),
                    "stated_m": float(twin.stated[name][k]),
                }
            )
    if as_json:
        document = {
            "digest": experiment.digest,
            "linear": True,
            "left_out": twin.left_out,
            "realizations": realizations,
            "beyond_linear": told.beyond,
        }
        typer.echo(json.dumps(document | {"rows": rows}, indent=1))
        return
    header = ["design", "by", "outage", "mean m", "95 %", "quantile 95 %", "rms m", "stated"]
    body = [
        [
            r["design"] if r["outage"] == 1 else "",
            r["by"] if r["outage"] == 1 else "",
            str(r["outage"]),
            f"{r['mean_m']:.3g}",
            f"{r['ci95_m'][0]:.3g}-{r['ci95_m'][1]:.3g}",
            *(f"{r[key]:.3g}" for key in ("quantile_95_m", "rms_m", "stated_m")),
        ]
        for r in rows
    ]
    print_table(console, f"Planimetric error at outage end, {realizations} linear realizations", header, body)
    console.print(f"{SAID}{': ' + twin.left_out if twin.left_out else ''}.", soft_wrap=True, style="dim")
    for name, correlation in told.beyond.items():
        console.print(
            f"{name} is not linear: under the same draws its errors correlate with the linear ones to {correlation:.2f} only. Its figures are "
            f"those of {len(told.errors[name])} runs of the filter at long steps (coarse).",
            soft_wrap=True,
            highlight=False,
            markup=False,
        )


def check_control(experiment: Experiment, *, until: bool) -> None:
    """Refuse before anything is flown what no linear realization can help.

    Raises
    ------
    InputError
        Fewer than three realizations (of a run that adds none), no outage, or no design with a linear twin.
    """
    from insemu.errors import InputError
    from insemu.evaluate import analysable

    if (experiment.realizations < 3 and not until) or not experiment.world.outage_windows:
        raise InputError("three realizations or more and an outage are needed", where="--control")
    able, reason = analysable(experiment, removes_means=True)
    if not able:
        raise InputError(reason, where="--control")


def control(
    experiment: Experiment, results: Results, realizations: int, folder: Path, told: Console, *, as_json: bool
) -> None:
    """Print and write (``control.json``) means and quantiles of a run that linear realizations help.

    Parameters
    ----------
    experiment : Experiment
    results : Results
    realizations : int
        Linear ones.
    folder : path
    told : Console
    as_json : bool
        Print no table.
    """
    from insemu.cli.printing import print_table
    from insemu.evaluate import LinearTwin
    from insemu.evaluate import control as helped
    from insemu.whole import put

    twin = LinearTwin(experiment)
    found = helped(results, twin, twin.draw(realizations, twin.rng))
    plain = {name: [c.to_json() for c in cells] for name, cells in found.items()}
    put(
        folder / "control.json",
        json.dumps({"linear_realizations": realizations, "left_out": twin.left_out, "designs": plain}, indent=1),
    )
    if as_json:
        return
    header = ["design", "outage", "mean m", "95 %", "alone", "quantile 95 %", "95 %", "corr.", "saved", "by"]
    body = []
    for name, cells in found.items():
        for k, c in enumerate(cells):
            helped_by = (f"{c.saved:.3g}", c.by) if c.used else ("refused", "")
            body.append([
                name if k == 0 else "", str(k + 1), f"{c.mean.value:.4g}", f"{c.mean.low:.4g}-{c.mean.high:.4g}",
                f"{c.plain_mean.low:.3g}-{c.plain_mean.high:.3g}", f"{c.quantile.value:.3g}",
                f"{c.quantile.low:.3g}-{c.quantile.high:.3g}", f"{c.correlation:.3f}", *helped_by,
            ])  # fmt: skip
    print_table(told, f"{results.realizations} flights helped by {realizations} linear realizations", header, body)
    told.print(
        "alone: 95 % of the mean of the flights alone. corr.: of full and cheap errors under the same draws; below 0.9 they are refused. saved: how "
        "many times more flights would do the same. by: linear realizations or, where those were refused, filters flown at long steps (coarse).",
        soft_wrap=True,
        style="dim",
    )
    if twin.left_out:
        told.print(f"The linear realizations leave out: {twin.left_out}.", soft_wrap=True)
