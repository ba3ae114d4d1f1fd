"""``insemu fit-runs``: several runs of one sensor; one model, its spread, and what the next switch-on will show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.logs import LogArguments, hertz
from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.cli.printing import print_boxed, print_json

if TYPE_CHECKING:
    from insemu.fit import Choice, RunsFit


class FitRunsArguments(Arguments):
    """Of ``insemu fit-runs``."""

    logs: list[str] = argument("LOG...", "Logs at rest, runs of one sensor.")
    models: list[str] = option(
        "--model", ..., "Structure; may be repeated, the one that predicts runs left out best is taken."
    )
    read: LogArguments
    bootstrap: int = option("--bootstrap", 0, "Draws of the test of near-stationarity; 0: no test.", min=0, max=DRAWS)
    seed: int = option("--seed", 0, "Seed of these draws.")
    out: str = option("--output", "", "Write the models and their spread as YAML that a scenario reads.")
    as_json: bool = option("--json", False)


def command(args: FitRunsArguments) -> None:
    """Fit one noise model to several runs of a sensor: its spread, and what the next switch-on will show (gmwm)."""
    import numpy as np

    from insemu.cli.announce import announce
    from insemu.cli.printing import staged
    from insemu.errors import InputError
    from insemu.fit import choose_model, fit_runs, save
    from insemu.noise import NoiseModel

    for name in args.logs:
        announce(name, hertz(args.read.rate))
    runs = [args.read.read(name) for name in args.logs]
    by_name = [{s.name: s for s in run} for run in runs]
    axes = [s.name for s in runs[0] if all(s.name in run for run in by_name)]
    if not axes:
        raise InputError("the runs have no axis in common")
    console = Console(stderr=args.as_json)
    found: dict[str, RunsFit] = {}
    choices: dict[str, list[Choice]] = {}
    children = np.random.default_rng(args.seed).spawn(len(axes))
    with staged(Console(stderr=True), len(axes) * (args.bootstrap + 1)) as say:
        for axis, child in zip(axes, children, strict=True):
            series = [run[axis] for run in by_name]
            try:
                asked = [NoiseModel.parse(text, series[0].unit) for text in args.models]
                if len(asked) > 1:
                    choices[axis] = choose_model(series, asked)
                    asked = [choices[axis][0].model]
                found[axis] = fit_runs(
                    series,
                    asked[0],
                    bootstrap=args.bootstrap,
                    rng=child,
                    progress=lambda k, n, axis=axis: say(f"{axis}: draw {k} of {n}"),  # type: ignore[misc]
                )
            except InputError as error:
                raise InputError(error.message, where=error.where or axis) from None
    if args.as_json:
        print_json({"axes": {axis: r.to_json() for axis, r in found.items()}}, allow_nan=False)
    for axis, r in found.items() if not args.as_json else ():
        _show(console, axis, r, choices.get(axis, []))
    if args.out:
        from dataclasses import replace

        save(
            {a: replace(r.joint, model=r.model) for a, r in found.items()},
            args.out,
            {a: r.spread for a, r in found.items()},
        )
        console.print(f"models: {args.out}")


def _show(console: Console, axis: str, r: RunsFit, choices: Sequence[Choice]) -> None:
    """One table per axis, then the test."""
    for c in choices:
        word = "best" if c.behind == 0.0 else "equivalent" if c.equivalent else "worse"
        console.print(
            f"{axis}: {c.model}: distance to runs left out {c.loss:.4g}, behind by {c.behind:.3g} ± {c.error:.2g}: {word}",
            highlight=False,
        )
    heads = ("parameter", "median over runs (95 %)", "spread", "next switch-on (95 %)", "its log will show (95 %)")
    rows = [
        (
            s.label,
            f"{s.common:.4g} ({s.low:.4g} … {s.high:.4g})",
            f"{100 * s.size:.2g} % (at most {100 * s.size_high:.2g} %)" if s.runs > 1 else "–",
            f"{s.next_low:.4g} … {s.next_high:.4g}",
            f"{s.log_low:.4g} … {s.log_high:.4g}",
        )
        for s in r.spreads
    ]
    print_boxed(console, f"{axis}: {r.joint.structure} over {len(r.each)} runs", heads, rows)
    if r.p_value == r.p_value:
        verdict = (
            "the runs differ by more than one set of parameters allows"
            if r.p_value <= 0.05
            else "one set of parameters is enough"
        )
        console.print(f"near-stationarity: p = {r.p_value:.3g}: {verdict}", highlight=False)
    for warning in r.joint.warnings:
        console.print(f"[yellow]beware[/yellow]: {warning}", highlight=False)
