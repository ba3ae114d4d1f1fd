"""``insemu sensor``: sensor cards, and noise models from figures of a datasheet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu import units
from insemu.cli.options import argument, option
from insemu.cli.printing import plain_table, print_json, print_text, print_wide

if TYPE_CHECKING:
    from insemu.sensors import Assumptions, AxisModel, Card, Figure


def command(
    name: str = argument(
        "[NAME|FILE|TEXT]",
        'Sensor, file (card or text), or figures such as "ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h".',
        default="",
    ),
    out: str = option("--output", "", "Write the models as YAML that a scenario reads."),
    case: str = option("--case", "typical", "What to write: typical or worst."),
    worst_factor: float = option("--worst-factor", 2.0, min=1.0),
    band: tuple[str, str] = option("--band", ("1 s", "1000 s")),
    as_json: bool = option("--json", False),
) -> None:
    """Show sensor cards, and write noise models for truth and belief from a datasheet's figures.

    Without an argument it lists the sensors that come with insemu. A scenario takes a sensor by name (truth: {sensor: ADIS16470}) or the file
    that --output writes.
    """
    from insemu.noise import axis_unit
    from insemu.sensors import Assumptions, axis_models, save, spelled

    console = Console()
    if not name:
        _list(console, as_json)
        return
    assumed = Assumptions(worst_factor, *(units.parse(text, "s") for text in band))
    card = _card(name)
    chosen = save(card, out, case, assumed) if out else axis_models(card, case, assumed)
    if as_json:
        print_json(_plain(card, chosen))
        return
    _show(console, card, assumed)
    for axes, one in _groups(chosen):
        text = spelled(one.model, axis_unit(axes.split(",")[0]))
        console.print(f"\n[bold]{axes}[/bold]: {text}", soft_wrap=True, highlight=False)
        for line in one.said:
            print_text(console, f"- {line}")
    if out:
        console.print(f"\n{case} models written to {out}", soft_wrap=True, highlight=False)


def _card(name: str) -> Card:
    """The card of a name, a file or a text; a text has a digit and a blank."""
    from pathlib import Path

    from insemu.errors import InputError
    from insemu.sensors import card, of_text

    try:
        return card(name)
    except InputError:
        if " " in name and any(ch.isdigit() for ch in name) and not Path(name).is_file():
            return of_text(name)
        raise


def _list(console: Console, as_json: bool) -> None:

    from insemu.sensors import card, names

    if as_json:
        print_json({name: {"maker": card(name).maker, "about": card(name).about} for name in names()})
        return
    cards = [card(name) for name in names()]
    table = plain_table()
    for heading in ("sensor", "gyro white", "gyro bias", "accel white", "accel bias"):
        table.add_column(heading, no_wrap=True)
    for one in cards:
        cells = [_first(one.of_axis(f"{s}_x"), k) for s in ("gyro", "accel") for k in (_WHITE, _BIAS)]
        table.add_row(one.name, *cells)
    print_wide(console, table, console.measure(table, options=console.options.update(width=500)).maximum)
    for one in cards:
        console.print(f"{one.name}: {one.about} ({one.maker}).", soft_wrap=True, style="dim", highlight=False)
    console.print(f"{len(cards)} cards", highlight=False)


_WHITE, _BIAS = ("random_walk", "noise_density"), ("bias_coefficient", "bias_sigma", "bias_stability")


def _first(figures: dict[str, Figure], kinds: tuple[str, ...]) -> str:
    return next((figures[kind].text for kind in kinds if kind in figures), "-")


def _show(console: Console, card: Card, assumed: Assumptions) -> None:
    """The card: its figures with their sources."""
    from insemu.sensors import KINDS

    console.print(
        f"[bold]{card.name}[/bold]" + "".join(f", {t}" for t in (card.maker, card.about) if t), soft_wrap=True
    )
    table = plain_table()
    for heading in ("", "figure", "printed", "typical", "worst"):
        table.add_column(heading, no_wrap=True)
    for section, figures in card.figures.items():
        for k, (kind, figure) in enumerate(figures.items()):
            unit = KINDS[kind].unit_for("accel" if section.startswith("accel") else "gyro")
            worst = figure.worst if figure.worst is not None else assumed.worst_factor * figure.value
            shown = [f"{v:.3g} {u}" for v, u in (units.datasheet(v, unit) for v in (figure.value, worst))]
            if kind == "correlation_time":
                shown[1] = shown[0]
            mark = "" if figure.worst is not None or kind == "correlation_time" else " assumed"
            table.add_row(section if not k else "", kind.replace("_", " "), figure.text, shown[0], shown[1] + mark)
    print_wide(console, table, console.measure(table, options=console.options.update(width=500)).maximum)
    for label, source in card.sources.items():
        of = [
            f"{section} {kind.replace('_', ' ')}{figure.source.removeprefix(label)}"
            for section, figures in card.figures.items()
            for kind, figure in figures.items()
            if figure.source.split(",")[0] == label
        ]
        parts = [source[key] for key in ("title", "revision", "url") if source.get(key)]
        text = f"{source.get('kind', 'source').capitalize()} of {'; '.join(of)}: {', '.join(parts)}"
        print_text(console, text, style="dim")


def _groups(models: dict[str, AxisModel]) -> list[tuple[str, AxisModel]]:
    """Axes with the same model together."""
    out: dict[AxisModel, list[str]] = {}
    for axis, one in models.items():
        out.setdefault(one, []).append(axis)
    return [(", ".join(axes), one) for one, axes in out.items()]


def _plain(card: Card, models: dict[str, AxisModel]) -> dict[str, object]:
    from insemu.noise import axis_unit

    return {
        "sensor": card.name,
        "sources": {label: dict(source) for label, source in card.sources.items()},
        "axes": {
            axis: {"unit": axis_unit(axis), "model": one.model.to_list(axis_unit(axis)), "from": list(one.said)}
            for axis, one in models.items()
        },
    }
