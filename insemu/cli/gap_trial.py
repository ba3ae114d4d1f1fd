"""``insemu gap-trial``: hide effects, look for them, score the answers."""

from __future__ import annotations

import typer


def command(
    recordings: int = typer.Option(39, "--recordings", min=1, help="Number of recordings; effects take turns."),
    effects: list[str] | None = typer.Option(  # noqa: B008
        None, "--effect", help="Effect to hide ('none' too); may be repeated. Default: every one."
    ),
    hours: float = typer.Option(1.0, "--hours", min=0.2, max=8.0, help="Length of each log, h."),
    seed: int = typer.Option(1, "--seed", min=0, help="Seed of the whole trial."),
    workers: int = typer.Option(1, "--workers", min=1, help="Recordings looked at a time."),
    hold_out: bool = typer.Option(
        False, "--hold-out/--no-hold-out", help="Also score on held-out data (twice the time)."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print scores and every recording as JSON."),
) -> None:
    """Blind trial on static logs: effect, axis, strength, sensor and wrong levels are drawn, hidden and looked for."""
    import json
    from dataclasses import asdict

    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from insemu.gap.trial import Trial, known_effects, run_trial, score_trials

    console = Console(stderr=as_json)
    chosen = known_effects(effects or [])
    finished: list[Trial] = []
    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task("looking", total=recordings)

        def done(trial: Trial) -> None:
            finished.append(trial)
            progress.advance(bar)

        try:
            run_trial(
                chosen, recordings=recordings, seed=seed, hours=hours, workers=workers, hold_out=hold_out, done=done
            )
        except KeyboardInterrupt:
            console.print(f"interrupted after {len(finished)} of {recordings} recordings")
            if not finished:
                raise
    scores = score_trials(finished)
    if as_json:
        plain = json.loads(
            json.dumps({"scores": scores.to_json(), "recordings": [asdict(t) for t in finished]}).replace("NaN", "null")
        )
        typer.echo(json.dumps(plain, indent=1))
        return
    said = sorted({s for row in scores.confusion.values() for s in row})
    table = Table("hidden", *said, title="Hidden (rows) and said first (columns)")
    for hidden, row in scores.confusion.items():
        table.add_row(hidden, *(str(row.get(s, "")) for s in said))
    console.print(table)
    summary = Table("figure", "share", "count")
    for label, (k, n) in (
        ("flagged although nothing was hidden", scores.false_alarms),
        ("named although nothing was hidden", scores.falsely_named),
        ("hidden effects detected", scores.detected),
        ("of those named alone, right (effect and axis)", scores.named_right),
        ("of those given a class, truth inside", scores.in_class),
        ("of those named right, gap index after contains 1", scores.gap_contains_one),
    ):
        summary.add_row(label, f"{k / n:.3f}" if n else "-", f"{k} of {n}")
    summary.add_row("mean size of a class", f"{scores.mean_class_size:.2f}", "")
    console.print(summary)
    calibration = Table("stated confidence", "right", "recordings", title="Calibration of the confidence")
    for stated, share, n in scores.calibration:
        calibration.add_row(f"{stated:.3f}", f"{share:.3f}", str(n))
    console.print(calibration)
