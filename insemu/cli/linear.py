"""Linear realizations on the command line: a preview of a run, and the help that few full runs get from many linear ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from insemu.cli.printing import print_items, print_json, print_table
from insemu.errors import InputError
from insemu.whole import put

if TYPE_CHECKING:
    from insemu.evaluate import Experiment, Results


def preview(experiment: Experiment, realizations: int, folder: Path, console: Console, *, as_json: bool) -> None:
    """Errors of many linear realizations at the ends of the outages, printed and written: summary.json and a page.

    Parameters
    ----------
    experiment : Experiment
    realizations : int
    folder : path
    console : Console
    as_json : bool
        Print summary.json on standard output instead of a table.
    """
    from insemu.evaluate import MARKER, LinearTwin, only_writer, previewed
    from insemu.report.preview import PREVIEWED, preview_notes, preview_rows, render_preview

    if not experiment.world.outage_windows:
        raise InputError("the scenario has no outage at whose end errors could be computed", where="--linear")
    if (folder / MARKER).exists():
        raise InputError("holds the results of flights; expected another folder (--output)", where=str(folder))
    twin = LinearTwin(experiment)
    found = previewed(twin, realizations)
    rows: list[dict[str, Any]] = []
    for name in twin.designs:
        for k, (start, duration) in enumerate(experiment.world.outage_windows):
            figures = found.figures_of(name, k)
            rows.append(
                {
                    "design": name,
                    "by": figures.by,
                    "realizations": figures.runs,
                    "outage": k + 1,
                    "start_s": start,
                    "duration_s": duration,
                    "mean_m": figures.mean.value,
                    "ci95_m": [figures.mean.low, figures.mean.high],
                    "quantile_95_m": figures.quantile_95,
                    "rms_m": figures.rms,
                    "stated_m": float(twin.stated[name][k]),
                }
            )
    document = {
        "scenario": experiment.scenario.title,
        "digest": experiment.digest,
        "linear": True,
        "left_out": twin.left_out,
        "realizations": realizations,
        "not_linear": {name: beyond.reason for name, beyond in found.beyond.items()},
        "rows": rows,
    }
    with only_writer(folder):
        put(folder / "summary.json", json.dumps(document, indent=1))
        page = render_preview(document, str(experiment.file or ""), folder)
    if as_json:
        print_json(document)
        return
    print_table(
        console, f"{experiment.scenario.title}, {realizations} linear realizations", *preview_rows(rows), groups=True
    )
    console.print(PREVIEWED, style="dim", soft_wrap=True, highlight=False)
    print_items(console, preview_notes(document))
    console.print(f"\nPage: {page} (summary.json next to it)", soft_wrap=True, highlight=False)


def check_control(experiment: Experiment, *, until: bool) -> None:
    """Refuse before anything is flown what no linear realization can help.

    Raises
    ------
    InputError
        Fewer than three realizations (of a run that adds none), no outage, or no design with a linear twin.
    """
    from insemu.evaluate import analysable

    if (experiment.realizations < 3 and not until) or not experiment.world.outage_windows:
        raise InputError("three realizations or more and an outage are needed", where="--control")
    able, reason = analysable(experiment, removes_means=True)
    if not able:
        raise InputError(reason, where="--control")


def control(
    experiment: Experiment, results: Results, realizations: int, folder: Path, stderr: Console, *, as_json: bool
) -> None:
    """Print and write (``control.json``) means and quantiles of a run that linear realizations help.

    Parameters
    ----------
    experiment : Experiment
    results : Results
    realizations : int
        Linear ones.
    folder : path
    stderr : Console
    as_json : bool
        Print no table.
    """
    from insemu.evaluate import LinearTwin
    from insemu.evaluate import control as helped

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
    print_table(
        stderr,
        f"{results.realizations} flights helped by {realizations} linear realizations",
        header,
        body,
        groups=True,
    )
    stderr.print(
        "alone: 95 % of the mean of the flights alone. corr.: of full and cheap errors under the same draws; below 0.9 they are refused. saved: how "
        "many times more flights would do the same. by: linear realizations or, where those were refused, filters flown at long steps (coarse).",
        soft_wrap=True,
        style="dim",
    )
    if twin.left_out:
        stderr.print(f"The linear realizations leave out: {twin.left_out}.", soft_wrap=True)
