"""``insemu gap-trial``: hide effects, look for them, score the answers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from insemu.trial.run import Trial


def command(
    recordings: int = typer.Option(58, "--recordings", min=1, help="Number of recordings; effects take turns."),
    kind: str = typer.Option(
        "both", "--kind", help="dynamic (drives and flights), static (logs at rest) or both in turns."
    ),
    effects: list[str] | None = typer.Option(  # noqa: B008
        None, "--effect", help="Effect to hide ('none' too); may be repeated. Default: every one."
    ),
    hidden: int = typer.Option(1, "--hidden", min=0, max=3, help="Effects hidden at once; 0: nothing is missing."),
    outside: bool = typer.Option(False, "--outside", help="Hide something that no catalogue holds instead."),
    hours: float = typer.Option(1.0, "--hours", min=0.2, max=8.0, help="Length of each log at rest, h."),
    minutes: float = typer.Option(10.0, "--minutes", min=3.0, max=60.0, help="Length of each drive or flight, min."),
    seed: int = typer.Option(1, "--seed", min=0, help="Seed of the whole trial."),
    workers: int = typer.Option(1, "--workers", min=1, help="Recordings looked at a time."),
    hold_out: bool = typer.Option(
        True, "--hold-out/--no-hold-out", help="Also score on held-out data (half as much time again)."
    ),
    log: str = typer.Option(
        "", "--log", metavar="FILE", help="Add every recording to this file; what it holds is not done again."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print scores and every recording as JSON."),
) -> None:
    """Blind trial: effect, axis, strength, track, sensor and wrong levels are drawn, hidden by the emulator and looked for."""
    from pathlib import Path

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from insemu.errors import InputError, nearest
    from insemu.trial.run import Kind, Plan, catalogue_of, known_effects, run_trial

    choices: dict[str, tuple[Kind, ...]] = {
        "dynamic": ("dynamic",),
        "static": ("static",),
        "both": ("dynamic", "static"),
    }
    if kind not in choices:
        raise InputError(f"found '{kind}', expected dynamic, static or both" + nearest(kind, choices), where="--kind")
    kinds = choices[kind]
    chosen = known_effects(effects or [], kinds)
    kinds = tuple(k for k in kinds if not chosen or any(e in catalogue_of(k) for e in chosen))
    plan = Plan(kinds, chosen, hidden, outside, recordings, seed, hours, minutes, hold_out)
    console = Console(stderr=as_json)
    finished: list[Trial] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("looking", total=recordings)

        def done(trial: Trial) -> None:
            finished.append(trial)
            progress.advance(bar)

        interrupted = False
        try:
            run_trial(plan, workers=workers, done=done, log=Path(log) if log else None)
        except KeyboardInterrupt:
            interrupted = True
    if interrupted:
        kept = f"; the same command goes on from {log}" if log else ""
        Console(stderr=True).print(f"Interrupted after {len(finished)} of {recordings} recordings{kept}.")
    if finished:
        _show(finished, as_json, console)
    if interrupted:
        raise typer.Exit(130)


def _show(finished: list[Trial], as_json: bool, console: Console) -> None:
    """Print the scores, and as JSON every recording."""
    import json

    from insemu.trial.score import score_trials

    scores = score_trials(finished)
    if as_json:
        plain = json.dumps({"scores": scores.to_json()}).replace("NaN", "null").replace("Infinity", "null")
        typer.echo(json.dumps({**json.loads(plain), "recordings": [t.to_json() for t in finished]}, indent=1))
        return
    for table in tables(finished):
        console.print(table)


def tables(finished: list[Trial]) -> list[Table]:
    """What the trial says, as tables for the console."""
    import math

    from rich.table import Table

    from insemu.trial.score import interval, score_trials

    scores = score_trials(finished)
    out = []
    confusion = Table("hidden", "said first, with counts", title="Confusion")
    for hidden, row in scores.confusion.items():
        said = sorted(row.items(), key=lambda item: -item[1])
        confusion.add_row(hidden, ", ".join(f"{name} {count}" for name, count in said))
    out.append(confusion)
    summary = Table("figure", "share", "count", "95 % interval")

    def add(label: str, share: tuple[int, int]) -> None:
        k, n = share
        if n:
            low, high = interval(k, n)
            summary.add_row(label, f"{k / n:.3f}", f"{k} of {n}", f"{low:.3f} to {high:.3f}")

    add("nothing hidden: flagged", scores.false_alarms)
    add("nothing hidden: named", scores.falsely_named)
    add("one hidden: detected", scores.detected)
    add("named alone: right (effect and axis)", scores.named_right)
    add("named alone: right effect", scores.effect_right)
    add("given a class: truth inside", scores.in_class)
    if scores.in_class[1]:
        summary.add_row("mean size of a class", f"{scores.mean_class_size:.2f}", "", "")
    add("one hidden: said to be unexplained", scores.unexplained)
    add("20 expected nats or more: detected", scores.strong_detected)
    add("20 expected nats or more: in the top two", scores.strong_top_two)
    for where, named, classes in (
        ("any strength", scores.every_and_only, scores.every_in_class),
        ("each worth 20 nats", scores.both_and_only, scores.both_in_class),
        ("each worth 20 nats beside the others", scores.beside_and_only, scores.beside_in_class),
    ):
        add(f"several hidden, {where}: all and only these named", named)
        add(f"several hidden, {where}: the same, classes counted", classes)
    add("outside the catalogue: misnamed", scores.misnamed_outside)
    add("outside the catalogue: said to be unexplained", scores.outside_unexplained)
    add("named right: gap index after contains 1", scores.gap_contains_one)
    if scores.held_out_count:
        summary.add_row(
            "held-out gain over the oracle's, median", f"{scores.held_out_ratio:.3f}", f"{scores.held_out_count}", ""
        )
    seconds = [t.seconds for t in finished if math.isfinite(t.seconds)]
    if seconds:
        summary.add_row(
            "seconds of one core per identification, mean", f"{sum(seconds) / len(seconds):.1f}", f"{len(seconds)}", ""
        )
    out.append(summary)
    if scores.calibration:
        calibration = Table("stated confidence", "right", "recordings", title="Calibration of the confidence")
        for stated, share, n in scores.calibration:
            calibration.add_row(f"{stated:.3f}", f"{share:.3f}", str(n))
        out.append(calibration)
    if scores.by_nats:
        power = Table("expected nats", "detected", "in the top two", "recordings", title="Power")
        for low, high, spoke, top, n in scores.by_nats:
            power.add_row(f"{low:g} to {high:g}", f"{spoke / n:.3f}", f"{top / n:.3f}", str(n))
        out.append(power)
    if scores.for_20_nats:
        needed = Table("effect", "datasheet scales", "recordings", title="Strength worth 20 nats, median")
        for name, (strength, n) in scores.for_20_nats.items():
            needed.add_row(name, f"{strength:.3g}", str(n))
        out.append(needed)
    return out
