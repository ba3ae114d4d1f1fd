"""``insemu solve``: the best filter and smoother on a real recording, without a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer
from rich.console import Console

from insemu import units
from insemu.cli.logs import hertz
from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_items, print_json, print_table, staged

if TYPE_CHECKING:
    from insemu.solve import Comparison, Solution


class SolveArguments(Arguments):
    """Of ``insemu solve``."""

    file: str = argument("RECORDING", "Any recording; the file with the IMU where there are several.")
    gnss: str = option("--gnss", "")
    column_map: str = option("--map", "")
    gnss_map: str = option("--gnss-map", "")
    sensor: str = option("--sensor", "", "Try this sensor card too (insemu sensor), or a card's file.")
    models: str = option("--models", "", "Try these models too (YAML of insemu fit -o or insemu sensor -o).")
    designs: str = option("--designs", "", "Try these designs too, separated by commas (insemu designs).")
    lever_arm: str = option("--lever-arm", "")
    against: str = option("--against", "")
    trajectory_rate: str = option("--trajectory-rate", "")
    out: str = option("--output", "", "Folder for the results; default results/solve_NAME.")
    requirements: list[str] = option("--require", [])
    workers: int = option("--workers", None)
    as_json: bool = option("--json", False)


def command(args: SolveArguments) -> None:
    """Solve a recording: trajectory with standard deviations, calibration, and what 10, 30 and 60 s without GNSS cost.

    Generic designs, one whose noise the innovations ask for, and those that are named are tried; outages are cut at every second and held
    against the fixes that were there. Nothing but the recording is needed.
    """
    import json
    from pathlib import Path

    import numpy as np

    from insemu.cli.announce import show_brief
    from insemu.evaluate import only_writer
    from insemu.intake import recording_of, take
    from insemu.report.integrity import integrity_sections
    from insemu.report.solve import render_solution
    from insemu.require import asked, recorded_guard
    from insemu.solve import candidates, compare_with, solve, summary, write
    from insemu.whole import put

    console, stderr = Console(stderr=args.as_json, highlight=False), Console(stderr=True)
    arm, required = _lever_arm(args.lever_arm), asked(args.requirements) if args.requirements else ()
    beliefs = candidates(
        [d.strip() for d in args.designs.split(",") if d.strip()],
        args.sensor,
        args.models,
        lever_arm_known=arm is not None,
    )
    found, card = take(args.file, gnss=args.gnss, maps=(args.column_map, args.gnss_map, ""))
    show_brief(card, console)
    card.check()
    # start, clock and noise, the design that the innovations ask for, two with calibration states, outages
    with staged(stderr, len(beliefs) + 6) as say:
        solution = solve(
            recording_of(found),
            card,
            beliefs,
            lever_arm=arm,
            rate=hertz(args.trajectory_rate),
            workers=args.workers,
            say=say,
        )
        compared = compare_with(solution, args.against, workers=args.workers) if args.against else None
    o = solution.taken.outages
    stated = o.covariance + o.fix_variance[..., None] * np.eye(2)  # errors are against fixes
    watched = [recorded_guard(r, o.start, o.horizons, o.error, stated) for r in required]
    folder = Path(args.out) if args.out else Path("results") / f"solve_{Path(args.file).name.split('.')[0]}"
    plain = summary(solution, compared) | ({"required": [g.to_json() for g in watched]} if watched else {})
    with only_writer(folder):
        write(solution, folder)
        page = render_solution(solution, folder, compared, Path(args.against).name, integrity_sections(watched))
        put(folder / "summary.json", json.dumps(plain, indent=1))
    if args.as_json:
        print_json(plain)
    else:
        _show(console, solution, compared, Path(args.against).name)
        for g in watched:
            console.print(str(g), soft_wrap=True, markup=False, style=None if g.kept else "red")
        console.print(
            f"\nPage: [bold]{page}[/bold] (summary.json, solution.nc, solved.npz, trajectory and models next to it)",
            soft_wrap=True,
        )
    if not all(g.kept for g in watched):
        raise typer.Exit(1)


def _lever_arm(text: str) -> tuple[float, float, float] | None:
    from insemu.errors import InputError

    if not text:
        return None
    words = text.replace(",", " ").split()
    unit = words.pop() if words and not any(c.isdigit() for c in words[-1]) else "m"
    try:
        x, y, z = (units.parse(f"{w} {unit}", "m") for w in words)
    except ValueError:
        raise InputError(
            f"is '{text[:40]}', expected three lengths such as '0.3 0 -1.2 m'", where="--lever-arm"
        ) from None
    return x, y, z


def _show(console: Console, s: Solution, compared: Comparison | None, scenario: str) -> None:
    """The answer, the score, the designs, what was found."""
    from insemu.report import solve as report

    console.print(f"\n{report.solve_answer(s)}", markup=False, style="bold")
    print_table(
        console,
        "Outages at every second, against the fixes that were withheld",
        *report.outage_rows_of(s.taken.outages),
        left=1,
        fit=True,
    )
    print_table(
        console, "Designs, the best first (outages five seconds apart)", *report.solve_rows(s.tried), left=1, fit=True
    )
    if s.taken.candidate.about:
        console.print(f"{s.taken.candidate.name}: {s.taken.candidate.about}", soft_wrap=True, markup=False, style="dim")
    if compared is not None:
        count = compared.solved.start.size
        print_table(
            console, f"Against {scenario}, the same {count} outages", *report.compared_rows(compared), left=1, fit=True
        )
    console.print()
    print_items(console, [*s.drive.said, *report.calibration_lines(s), *report.consistency_words_of(s)])
