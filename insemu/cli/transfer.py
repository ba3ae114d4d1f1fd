"""``insemu transfer``: by what factors the noise of a drive exceeds the static model, whether that helps in outages, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from insemu.transfer import Transfer


def command(
    model: str = typer.Argument(
        ...,
        metavar="MODEL",
        help="Static models: a noise-model file of 'insemu fit', a belief file or a scenario (YAML).",
    ),
    drive: str = typer.Option(..., "--drive", metavar="RECORDING", help="A drive or flight with fixes."),
    out: str = typer.Option(
        "", "--out", "-o", help="Write the models with the factors on them to this noise-model file."
    ),
    why: bool = typer.Option(True, "--why/--no-why", help="Look for the reasons (the gap workflow, a few minutes)."),
    seed: int = typer.Option(1, "--seed", min=0, help="Seed of the simulations of the gap workflow."),
    as_json: bool = typer.Option(False, "--json", help="Print the result as JSON on standard output."),
) -> None:
    """Carry a static noise model to a drive: factors on its levels, outages as the judge, and the reasons."""
    import json

    import numpy as np
    from rich.console import Console

    from insemu.cli.announce import announce
    from insemu.cli.printing import telling
    from insemu.errors import InputError
    from insemu.gap import from_its_start, load_measured, load_nominal
    from insemu.noise import save
    from insemu.records import Recording
    from insemu.transfer import transfer

    console = Console(stderr=as_json)
    announce(drive, Console(stderr=True))
    nominal = load_nominal(model)
    data = load_measured(drive)
    if "recording" not in nominal.raw:  # a scenario of a recording tells times by the recording's clock
        data = from_its_start(data)
    if not isinstance(data, Recording):
        raise InputError("is a log at rest, expected a drive or flight with fixes", where=drive)
    with telling(console, "reading") as say:
        found = transfer(
            data,
            nominal,
            rng=np.random.default_rng(seed),
            why=why,
            say=say,
        )
    if out:
        save(found.beliefs, out)
    if as_json:
        typer.echo(json.dumps(found.to_json(), indent=1))
        return
    _tell(found, console)
    if out:
        console.print(f"Models for this drive: [bold]{out}[/bold]")


def _tell(found: Transfer, console: Console) -> None:
    """The answer on the terminal: does it help, the factors, the judge, the reasons."""
    from rich.table import Table

    by = {j.name: j for j in found.judged}
    own, hand = by["transferred"], by["by hand"]
    gain, sd = own.gain
    word = "better" if gain > 1.96 * sd else "worse" if gain < -1.96 * sd else "no better for certain"
    console.print(
        f"[bold]{word}[/bold] than the static model in {own.outages} outages that the factors were not fitted on: "
        f"{gain:+.2f} nats per outage (standard deviation {sd:.2f}); a factor of 10 by hand {hand.gain[0]:+.2f}",
        highlight=False,
    )
    table = Table("level", "factor", "95 % interval", "")
    for f in found.factors:
        table.add_row(
            f.name, f"{f.value:.3g}", f"{f.low:.3g} to {f.high:.3g}", "" if f.told else "the drive cannot tell"
        )
    console.print(table)
    table = Table("belief", "log density of the end", "horizontal, m rms", "inside 95 %")
    for j in found.judged:
        table.add_row(j.name, f"{j.score:.2f}", f"{j.metres:.1f}", f"{j.inside:.0%}")
    console.print(table)
    for name in found.rest:
        parts = sorted(((s.shares[name], s.finding.effect) for s in found.reasons), reverse=True)
        told = ", ".join(f"{effect} {share:.2g}" for share, effect in parts)
        whole = next(f.value for f in found.factors if f.name == name)
        console.print(
            f"{name} x {whole:.2g}: " + (f"{told}, " if told else "") + f"rest {found.rest[name]:.2g}", highlight=False
        )
