"""``insemu gap``: where a recording and a nominal model disagree, the missing effect's name, the refined model, the gap shrinking."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu.cli.logs import hertz
from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import STAGES, print_table, staged

if TYPE_CHECKING:
    from insemu.gap import GapReport, Nominal, StaticLog
    from insemu.records import Recording


class GapArguments(Arguments):
    """Of ``insemu gap``."""

    model: str = argument("MODEL")
    recording: str = argument("RECORDING", "What was measured: a log at rest, or a drive or flight with fixes.")
    out: str = option("--output", "", "Folder for the page, gap.json and refined.yaml; default results/gap_NAME.")
    figure: str = option(
        "--figure", "", "Also draw the page's pictures: PNG and SVG files that begin so, such as results/gap_drive."
    )
    as_json: bool = option("--json", False)
    rate: str = option("--rate", "")
    without: list[str] | None = option("--without", None)
    seed: int = option("--seed", 1, "Seed of the simulated nominal data.")
    apply: str = option(
        "--apply", "", "Findings that go into refined.yaml, by number, for example '1,3'; default: all of them."
    )
    following: str = option(
        "--next",
        "",
        "Design the manoeuvre that would tell the members of the most costly class apart; writes a scenario and its waypoints.",
    )
    vehicle: str = option(
        "--vehicle", "car", "What there is to drive or fly it with: car, multirotor, helicopter, fixed_wing."
    )
    hold_out: bool = option("--hold-out", True)
    workers: int = option(
        "--workers",
        None,
        "Processes; a second one scores a drive or flight on held-out fixes. Default the number of cores.",
    )


def command(args: GapArguments) -> None:
    """Find where a recording and a model disagree, name the missing effect, add it and show the gap shrink."""
    import json

    import numpy as np

    from insemu.cli.announce import announce
    from insemu.effects import EFFECTS
    from insemu.emulate import VEHICLES
    from insemu.errors import InputError, nearest
    from insemu.gap import applied, find_gap, from_its_start, is_judged, load_measured, load_nominal, write_refined
    from insemu.intake import found_in
    from insemu.whole import put
    from insemu.work import processes

    if args.vehicle not in VEHICLES:
        raise InputError(f"unknown vehicle '{args.vehicle}'" + nearest(args.vehicle, VEHICLES), where="--vehicle")
    if args.following and not args.following.endswith((".yaml", ".yml")):
        raise InputError(
            f"found '{args.following}', expected a file .yaml; the waypoints go next to it", where="--next"
        )
    for effect in args.without or ():
        if effect not in EFFECTS:
            raise InputError(f"unknown effect '{effect}'" + nearest(effect, EFFECTS), where="--without")
    try:
        numbers = [int(n) for n in args.apply.split(",") if n.strip()]
    except ValueError:
        raise InputError(f"'{args.apply}' is no list of numbers, expected for example '1,3'", where="--apply") from None
    console = Console(stderr=args.as_json)
    card = announce(args.recording, hertz(args.rate))
    nominal = load_nominal(args.model)
    data = found_in(load_measured(args.recording, rate_hz=hertz(args.rate)), card)
    if "recording" not in nominal.raw:  # a scenario of a recording tells times by the recording's clock
        data = from_its_start(data)
    other = sorted({aid.kind for aid in getattr(data, "aids", ()) if not is_judged(aid.kind)})
    if other:
        Console(stderr=True).print(
            f"{args.recording}: {', '.join(other)} not looked at: only IMU, fixes, odometer, barometer and heading are",
            highlight=False,
            markup=False,
        )
    with processes(min(args.workers, 2)) as pool, staged(Console(stderr=True), STAGES) as say:
        report = find_gap(
            data,
            nominal,
            rng=np.random.default_rng(args.seed),
            without=tuple(args.without or ()),
            hold_out=args.hold_out,
            progress=say,
            pool=pool,
        )
    folder = Path(args.out) if args.out else Path("results") / f"gap_{Path(args.recording).stem}"
    chosen = applied(report, numbers) if numbers else report
    refined = write_refined(nominal, chosen, folder / "refined.yaml", data)
    text = json.dumps(report.to_json(), indent=1, allow_nan=False)
    put(folder / "gap.json", text + "\n")
    from insemu.report.gap import draw_gap, render_gap

    page = render_gap(report, folder, refined.read_text(encoding="utf-8"))
    if args.figure:
        draw_gap(report, Path(args.figure).parent, Path(args.figure).name)
    if args.as_json:
        typer.echo(text)
    else:
        _tell(report, console)
        console.print(f"Page: [bold]{page}[/bold]   (gap.json, refined.yaml next to it)")
    if args.following:
        _design(report, data, nominal, Path(args.following), args.vehicle, args.seed, console)


def _design(
    report: GapReport,
    data: StaticLog | Recording,
    nominal: Nominal,
    out: Path,
    vehicle: str,
    seed: int,
    console: Console,
) -> None:
    """Design the next experiment, say what it promises, and write it."""
    import numpy as np

    from insemu.gap import design, promise_text, write_experiment

    with console.status("designing the next experiment") as status:
        x = design(data, nominal, report, rng=np.random.default_rng(seed), vehicle=vehicle, progress=status.update)
    if x is None:
        console.print("Next experiment: no class that a drive or flight could settle")
        return
    scenario, waypoints = write_experiment(x, out)
    console.print("[bold]The next experiment[/bold]")
    for line in promise_text(x):
        console.print(line, highlight=False, markup=False)
    console.print(f"Scenario: [bold]{scenario}[/bold], waypoints {waypoints}")


def _tell(report: GapReport, console: Console) -> None:
    """The answer on the terminal: the verdict, at most six findings, what is left, the gap before and after."""
    import math

    from insemu.report.gap import (
        FIRST_SCREEN,
        burst_said,
        effect_name,
        filtered_said,
        finding_action,
        finding_metres,
        finding_nees,
        folded_said,
        gap_headline,
        is_better,
        sensor_axes,
        shaking_said,
        shown_value,
    )
    from insemu.shown import with_interval

    console.print(f"[bold]{report.verdict}[/bold]: {gap_headline(report)}")
    for said in report.assumed:
        console.print(said, highlight=False, markup=False)
    word, figures, _ = is_better(report)
    console.print(f"Is the refined model better? {word}: {figures}", highlight=False, markup=False)
    if report.findings:
        heads = ("", "effect", "m after 60 s", "NEES", "nats", "sure", "where")
        body, most = [], report.numbered()[:FIRST_SCREEN]
        for n, s in most:
            where = sensor_axes(s.sensor, s.axes)
            body.append(
                [
                    str(n),
                    effect_name(s.effect),
                    finding_metres(s),
                    finding_nees(report, s),
                    f"{s.nats:.1f}",
                    f"{s.confidence:.3f}",
                    where,
                ]
            )
        print_table(console, "What is missing, in the order of metres times confidence", heads, body, left=2, fit=True)
        for n, s in most:
            console.print(f"{n}. {finding_action(s, report.assumed)}", highlight=False, markup=False)
            for v in map(shown_value, s.parameters[:6]):
                said = with_interval(v.value, v.low, v.high)
                console.print(f"   {v.name} {said} {v.unit}", highlight=False, markup=False)
        if folded := folded_said(report):
            console.print(f"on the page: {folded}", highlight=False, markup=False)
    if report.remainder:
        console.print(f"Left unexplained: {report.remainder}", highlight=False, markup=False)
    for said in (filtered_said(report), shaking_said(report)):
        if said:
            console.print(said, highlight=False, markup=False)
    for label, value in (("before", report.gap_before), ("after", report.gap_after)):
        if math.isfinite(value.value):
            console.print(f"gap index {label}: {value.value:.3f} [{value.low:.3f}, {value.high:.3f}]")
    if said := burst_said(report):
        console.print(said, highlight=False, markup=False)
