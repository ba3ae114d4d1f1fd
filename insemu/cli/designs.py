"""``insemu designs``: the filter designs that come with the package, and those of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from insemu.cli.options import argument, option
from insemu.cli.printing import plain_table, print_json

if TYPE_CHECKING:
    from insemu.scenario import Design, Scenario


def command(
    name: str = argument("[NAME]", "Show this design: its states, and what to write in a scenario.", default=""),
    scenario: str = option("--scenario", "", "The designs of this scenario file instead."),
    as_json: bool = option("--json", False),
) -> None:
    """List filter designs with the number and names of their states.

    A scenario takes one of them by name (designs: {18AV: 18AV}, or {design: 18AV, options: {gate: 1e-4}} to change a part), and compare and
    regress by --designs.
    """
    import yaml
    from rich.console import Console

    from insemu.errors import InputError, nearest
    from insemu.scenario import Design, load, shipped_designs, state_names

    about: dict[str, str] = {}
    given = load(scenario) if scenario else None
    if given is not None:
        designs = dict(given.designs)
    else:
        designs = {key: Design.model_validate(key) for key in shipped_designs()}
        about = {key: str(text["about"]) for key, text in shipped_designs().items()}
    if name and name not in designs:
        raise InputError(f"no design '{name}'" + nearest(name, designs))
    chosen = {name: designs[name]} if name else designs
    states = {key: state_names(design, given) for key, design in chosen.items()}
    if as_json:
        rows = {
            key: {
                "states": None if found is None else len(found),
                "state_names": found,
                "filter": chosen[key].filter,
                "about": about.get(key),
            }
            for key, found in states.items()
        }
        print_json(rows)
        return
    console = Console()
    if name:
        found = states[name]
        console.print(about.get(name, ""), soft_wrap=True)
        if found is not None:
            console.print(f"{len(found)} states: {', '.join(found)}", soft_wrap=True, highlight=False)
        written = chosen[name].model_dump(mode="json", exclude_defaults=True, exclude={"design"})
        typer.echo("\n" + yaml.safe_dump({name: written}, sort_keys=False, default_flow_style=None, width=140))
        return
    table = plain_table()
    for heading in ("design", "states", "gyroscopes", "accelerometers", "besides"):
        table.add_column(heading, justify="right" if heading == "states" else "left", overflow="fold")
    for key, design in chosen.items():
        found = states[key]
        table.add_row(key, "-" if found is None else str(len(found)), *_structure(design, given), _options_text(design))
    console.print(table)
    for key, text in about.items():
        console.print(f"{key}: {text}.", soft_wrap=True, style="dim", highlight=False)


def _structure(design: Design, scenario: Scenario | None) -> tuple[str, str]:
    """The processes of gyroscopes and accelerometers without their parameters; axes that differ are distinguished."""
    from insemu.scenario import structures

    models = structures(design, scenario)
    out = []
    for sensor in ("gyro", "accel"):
        texts: dict[str, list[str]] = {}
        for axis, model in models.items():
            if axis.startswith(sensor):
                symbols = "a file's" if model is None else " + ".join(_symbol(p) for p in model)
                texts.setdefault(symbols, []).append(axis[-1])
        out.append(
            next(iter(texts), "-")
            if len(texts) < 2
            else "; ".join(f"{''.join(on)}: {text}" for text, on in texts.items())
        )
    return out[0], out[1]


def _symbol(process: object) -> str:
    from insemu.noise import ARMA

    if isinstance(process, ARMA):
        return f"{process.symbol}({', '.join(str(len(v)) for v in (process.ar, process.ma) if v)})"
    return type(process).__name__


def _options_text(design: Design) -> str:
    options = design.options
    parts = [f"filter {design.filter}"] if design.filter else []
    sources = {getattr(s, "method", None) for s in design.sources().values() if getattr(s, "fit", None)}
    parts += [f"fitted by {method}" for method in sorted(map(str, sources))]
    parts += ["wavelet filter"] if options.prefilter is not None else []
    parts += [f"state {key}" for key, value in vars(options.states).items() if value]
    parts += [f"gate {options.gate:g}"] if options.gate is not None else []
    parts += [f"{key} x {value:g}" for key, value in options.tuning.model_dump().items() if value != 1.0]
    parts += [f"covariance every {options.covariance_every} epochs"] if options.covariance_every > 1 else []
    return ", ".join(parts)
