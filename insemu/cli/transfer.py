"""``insemu transfer``: by what factors the noise of a drive exceeds the static model, whether that helps in outages, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import STAGES, print_items, print_json, print_table, staged

if TYPE_CHECKING:
    from insemu.transfer import Transfer


class TransferArguments(Arguments):
    """Of ``insemu transfer``."""

    model: str = argument(
        "MODEL", "Static models: a noise-model file of 'insemu fit', a belief file or a scenario (YAML)."
    )
    recording: str = argument("RECORDING")
    known: str = option(
        "--known",
        "",
        "What else is known of the drive: refined.yaml of 'insemu gap', a belief file or a scenario; its effects are removed first.",
    )
    out: str = option("--output", "", "Write the models with the factors on them to this noise-model file.")
    page: str = option("--page", "")
    why: bool = option("--why", True)
    calibrate: bool = option("--calibrate", False)
    seed: int = option("--seed", 1, "Seed of the simulations of the gap workflow.")
    as_json: bool = option("--json", False)


def command(args: TransferArguments) -> None:
    """Carry a static noise model to a drive: factors on its levels, outages as the judge, and the reasons."""
    import numpy as np

    from insemu.cli.announce import announce
    from insemu.errors import InputError
    from insemu.gap import from_its_start, load_measured, load_nominal
    from insemu.noise import save
    from insemu.records import Recording
    from insemu.transfer import transfer

    console = Console(stderr=args.as_json)
    announce(args.recording)
    nominal, besides = load_nominal(args.model), load_nominal(args.known) if args.known else None
    data = load_measured(args.recording)
    if "recording" not in (besides or nominal).raw:  # a scenario of a recording tells times by the recording's clock
        data = from_its_start(data)
    if not isinstance(data, Recording):
        raise InputError("is a log at rest, expected a drive or flight with fixes", where=args.recording)
    with staged(Console(stderr=True), STAGES if args.why else 4) as say:
        found = transfer(
            data,
            nominal,
            rng=np.random.default_rng(args.seed),
            known=besides,
            why=args.why,
            calibrate=args.calibrate,
            say=say,
        )
    if args.out:
        save(found.beliefs, args.out)
    if args.page:
        from insemu.report.transfer import render_transfer

        render_transfer(found, args.page, args.recording)
    if args.as_json:
        print_json(found.to_json())
        return
    _tell(found, console)
    if args.out:
        console.print(f"Models for this drive: [bold]{args.out}[/bold]")
    if args.page:
        console.print(f"Page: [bold]{args.page}[/bold]")


def _tell(found: Transfer, console: Console) -> None:
    """The answer on the terminal: does it help, the factors, the judge, the reasons."""
    from insemu.report import transfer as report

    console.print(report.transfer_answer(found), style="bold", highlight=False, markup=False)
    print_items(console, found.assumed)
    tables = (
        ("Factors on the levels", report.factor_rows(found)),
        ("Constants tuned with them", report.constant_rows(found)),
        ("Outages as the judge", report.judged_rows(found)),
        ("Reasons", report.reason_rows(found)),
    )
    for title, (header, rows) in tables:
        if rows:
            print_table(console, title, header, rows, left=1, fit=True)
