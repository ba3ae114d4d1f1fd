"""Hide effects, look for them, score the answers.

python -m benchmarks.trial --recordings 200 --workers 2            # one effect each, drives and static logs in turns
python -m benchmarks.trial --hidden 0 --recordings 500             # nothing hidden: false alarms
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from insemu.cli.options import DRAWS, option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

    from benchmarks.trial import Trial


def command(
    recordings: int = option("--recordings", 58, "Number of recordings; effects take turns.", min=1, max=DRAWS),
    kind: str = option("--kind", "both"),
    effects: list[str] | None = option("--effect", None),
    hidden: int = option("--hidden", 1, min=0, max=3),
    outside: bool = option("--outside", False),
    log_length: str = option("--log-length", "1 h", "Length of each log at rest, 12 min to 8 h."),
    drive_length: str = option("--drive-length", "10 min", "Length of each drive or flight, 3 min to 1 h."),
    seed: int = option("--seed", 1, "Seed of the whole trial."),
    workers: int = option("--workers", 1, "Recordings looked at a time."),
    cluster: str = option("--cluster", ""),
    hold_out: bool = option("--hold-out", True, "Also score on held-out data (half as much time again)."),
    out: str = option("--output", "", "Add every recording to this file; what it holds is not done again."),
    as_json: bool = option("--json", False),
) -> None:
    """Blind trial: effect, axis, strength, track, sensor and wrong levels are drawn, hidden by the emulator and looked for."""
    from pathlib import Path

    from rich.console import Console

    from benchmarks.trial import Kind, Plan, catalogue_of, known_effects, run_trial
    from insemu import units
    from insemu.cli.printing import Bars
    from insemu.cluster import cluster as dask_cluster
    from insemu.errors import InputError, nearest

    choices: dict[str, tuple[Kind, ...]] = {
        "dynamic": ("dynamic",),
        "static": ("static",),
        "both": ("dynamic", "static"),
    }
    if kind not in choices:
        raise InputError(f"found '{kind}', expected dynamic, static or both" + nearest(kind, choices), where="--kind")
    kinds = choices[kind]
    hours, minutes = units.parse(log_length, "s") / 3600.0, units.parse(drive_length, "s") / 60.0
    for said, value, low, high, where in (
        (log_length, hours, 0.2, 8.0, "--log-length"),
        (drive_length, minutes, 3.0, 60.0, "--drive-length"),
    ):
        if not low <= value <= high:
            raise InputError(f"is {said}, expected {low:g} to {high:g} {'h' if high < 10 else 'min'}", where=where)
    chosen = known_effects(effects or [], kinds)
    kinds = tuple(k for k in kinds if not chosen or any(e in catalogue_of(k) for e in chosen))
    plan = Plan(kinds, chosen, hidden, outside, recordings, seed, hours, minutes, hold_out)
    console = Console(stderr=as_json)
    finished: list[Trial] = []
    with Bars(Console(stderr=True)) as progress:
        bar = progress.add_task("looking", total=recordings)

        def done(trial: Trial) -> None:
            finished.append(trial)
            progress.update(bar, completed=len(finished))

        interrupted = False
        try:
            with dask_cluster(cluster, workers) as pool:
                whole = run_trial(plan, workers=workers, pool=pool, done=done, log=Path(out) if out else None)
            finished[:] = whole  # in the order of the plan, whoever finished first
        except KeyboardInterrupt:
            interrupted = True
    if interrupted:
        kept = f"; the same command goes on from {out}" if out else ""
        Console(stderr=True).print(f"Interrupted after {len(finished)} of {recordings} recordings{kept}.")
    if finished:
        _show(finished, as_json, console)
    if interrupted:
        raise typer.Exit(130)


def _show(finished: list[Trial], as_json: bool, console: Console) -> None:
    """Print the scores, and as JSON every recording."""
    import json

    from benchmarks import trial

    if not as_json:
        for table in tables(finished):
            console.print(table)
        return
    ratio, count = trial.held_out_ratio(finished)
    scores = {
        "recordings": len(finished),
        "shares": {name: s.to_json() for name, s in trial.score_trials(finished).items()},
        "mean_class_size": trial.mean_class_size(finished),
        "held_out_ratio": ratio,
        "held_out_count": count,
        "confusion": trial.confusion(finished),
        "calibration": trial.calibration(finished),
        "by_nats": trial.power(finished),
        "for_20_nats": trial.for_20_nats(finished),
    }
    plain = json.loads(json.dumps(scores).replace("NaN", "null").replace("Infinity", "null"))
    typer.echo(json.dumps({"scores": plain, "recordings": [t.to_json() for t in finished]}, indent=1))


def tables(finished: list[Trial]) -> list[Table]:
    """What the trial says, as tables for the console."""
    import math

    from rich.table import Table

    from benchmarks import trial

    out = []

    def table(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], title: str = "") -> None:
        made = Table(*columns, title=title or None)
        for row in rows:
            made.add_row(*row)
        if rows:
            out.append(made)

    def counts(row: dict[str, int]) -> str:
        return ", ".join(f"{name} {count}" for name, count in sorted(row.items(), key=lambda item: -item[1]))

    confusion = [(hidden, counts(row)) for hidden, row in trial.confusion(finished).items()]
    table(("hidden", "said first, with counts"), confusion, "Confusion")
    rows: list[tuple[str, ...]] = []
    for s in trial.score_trials(finished).values():
        if s.of:
            low, high = s.interval
            rows.append((s.label, f"{s.count / s.of:.3f}", f"{s.count} of {s.of}", f"{low:.3f} to {high:.3f}"))
    if math.isfinite(size := trial.mean_class_size(finished)):
        rows.append(("mean size of a class", f"{size:.2f}", "", ""))
    ratio, count = trial.held_out_ratio(finished)
    if count:
        rows.append(("held-out gain over the oracle's, median", f"{ratio:.3f}", f"{count}", ""))
    seconds = [t.seconds for t in finished if math.isfinite(t.seconds)]
    if seconds:
        mean = sum(seconds) / len(seconds)
        rows.append(("seconds of one core per identification, mean", f"{mean:.1f}", f"{len(seconds)}", ""))
    table(("figure", "share", "count", "95 % interval"), rows)
    table(
        ("stated confidence", "right", "recordings"),
        [(f"{stated:.3f}", f"{share:.3f}", str(n)) for stated, share, n in trial.calibration(finished)],
        "Calibration of the confidence",
    )
    table(
        ("expected nats", "detected", "in the top two", "recordings"),
        [
            (f"{low:g} to {high:g}", f"{spoke / n:.3f}", f"{top / n:.3f}", str(n))
            for low, high, spoke, top, n in trial.power(finished)
        ],
        "Power",
    )
    table(
        ("effect", "datasheet scales", "recordings"),
        [(name, f"{strength:.3g}", str(n)) for name, (strength, n) in trial.for_20_nats(finished).items()],
        "Strength worth 20 nats, median",
    )
    return out


app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)
app.command()(command)


if __name__ == "__main__":
    from insemu.cli import main

    main(commands=app)
