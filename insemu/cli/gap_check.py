"""``insemu gap-check``: recordings emulated from a model, the measured one among them, and what is missing still."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.cli.printing import STAGES, print_items, print_table, staged

if TYPE_CHECKING:
    from insemu.gap import Check


class GapCheckArguments(Arguments):
    """Of ``insemu gap-check``."""

    model: str = argument("MODEL", "The model to be checked, for example refined.yaml of 'insemu gap'.")
    recording: str = argument("RECORDING")
    before: str = option("--before", "")
    recordings: int = option("--recordings", 200, "Recordings emulated from each model.", min=20, max=DRAWS)
    search: bool = option("--search", True)
    workers: int = option("--workers", 1, "Processes.")
    seed: int = option("--seed", 1, "Seed of the emulated recordings.")
    out: str = option("--output", "", "Folder for the page and check.json; default results/check_NAME.")
    as_json: bool = option("--json", False)


def command(args: GapCheckArguments) -> None:
    """Emulate recordings from a model along a measured drive, and say where the measured one stands among them.

    Emulated recordings are kept in the folder (recordings.jsonl): the same command goes on where it was interrupted.
    """
    import json
    from pathlib import Path

    import numpy as np

    from insemu.cli.announce import announce
    from insemu.errors import InputError
    from insemu.gap import check, find_gap, from_its_start, kept, load_measured, load_nominal
    from insemu.records import Recording
    from insemu.report.predictive import render_check
    from insemu.whole import put

    console = Console(stderr=args.as_json)
    announce(args.recording)
    models = {"before": load_nominal(args.before)} if args.before else {}
    models["after"] = load_nominal(args.model)
    data = load_measured(args.recording)
    if "recording" not in models["after"].raw:  # a scenario of a recording tells times by the recording's clock
        data = from_its_start(data)
    if not isinstance(data, Recording):
        raise InputError("is a log at rest, expected a drive or flight with fixes", where=args.recording)
    folder = Path(args.out) if args.out else Path("results") / f"check_{Path(args.recording).stem}"
    finished = kept(folder / "recordings.jsonl")
    with staged(Console(stderr=True), (args.recordings + 1) * len(models) + (STAGES if args.search else 0)) as say:
        checks = {
            name: check(
                data, m, recordings=args.recordings, seed=args.seed, workers=args.workers, progress=say, store=finished
            )
            for name, m in models.items()
        }
        left = None
        if args.search:
            left = find_gap(
                data,
                models["after"],
                rng=np.random.default_rng(args.seed),
                hold_out=False,
                pictures=False,
                progress=say,
            )
    result = {name: c.to_json() for name, c in checks.items()}
    if left is not None:
        result["search"] = left.to_json()
    text = json.dumps(result, indent=1)
    put(folder / "check.json", text + "\n")
    page = render_check(checks, left, folder, data.source)
    if args.as_json:
        typer.echo(text)
        return
    _tell(checks, console)
    if left is not None:
        names = ", ".join(s.effect for s in left.findings)
        console.print(f"Searched again: [bold]{left.verdict}[/bold]" + (f" ({names})" if names else ""))
    console.print(f"Page: [bold]{page}[/bold]   (check.json next to it)")


def _tell(checks: dict[str, Check], console: Console) -> None:
    """The answer on the terminal: what stands out of each model's band, and the metres."""
    import numpy as np

    for name, c in checks.items():
        o = c.outages
        console.print(
            f"[bold]{name}[/bold]: {c.outside} of {len(c.statistics)} statistics of the recording are outside the 95 % band of "
            f"{c.recordings} emulated ones; outages of a minute: {o.inside} of {o.starts.size} measured errors inside the 90 % band",
            highlight=False,
        )
    last = checks["after"]
    print_items(console, last.assumed)
    out = sorted((s for s in last.statistics if s.outside), key=lambda s: min(s.percentile, 1.0 - s.percentile))
    heads = ("statistic", "of", "measured", "emulated 95 %", "percentile")
    body = [
        [s.name, s.where, f"{s.measured:.3g}", f"{s.low:.3g} to {s.high:.3g}", f"{100.0 * s.percentile:.1f}"]
        for s in out[:8]
    ]
    if body:
        print_table(console, "Outside their band", heads, body, left=2, fit=True)
    columns = ("outage from, s", "measured, m", *(f"{name}, m" for name in checks))
    rows = []
    for start in sorted({float(x) for c in checks.values() for x in c.outages.starts}):
        # a model that shifts the stamps may have an outage more or less
        at = [(c.outages, np.flatnonzero(c.outages.starts == start)) for c in checks.values()]
        own = ", ".join(f"{o.measured[k[0]]:.1f}" if k.size else "-" for o, k in at)
        rows.append(
            [f"{start:.0f}", own, *(f"{o.low[k[0]]:.1f} to {o.high[k[0]]:.1f}" if k.size else "-" for o, k in at)]
        )
    title = "Horizontal error after 60 s without fixes, each filter with its model: measured, and emulated (90 %)"
    print_table(console, title, columns, rows, left=1, fit=True)
