"""``insemu characterise``: what the noise of a static log is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console

from insemu.cli.logs import hertz
from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import counting, print_json, print_table, print_text

if TYPE_CHECKING:
    from insemu.variance import AxisReport

#: False alarms of --same-as, per axis.
ALARM = 0.01


class CharacteriseArguments(Arguments):
    """Of ``insemu characterise``."""

    file: str = argument("LOG")
    rate: str = option("--rate", "")
    columns: list[str] | None = option("--columns", None)
    robust: bool = option("--robust", False, "Read the coefficients off the robust curve.")
    wavelet: str = option("--wavelet", "haar")
    overlay: bool = option("--overlay", True)
    beside: str = option("--beside", "")
    same_as: str = option("--same-as", "")
    out: str = option("--output", "", "Folder for page, figures and JSON; default results/characterise_NAME.")
    as_json: bool = option("--json", False, "Print JSON on standard output; files are written only with --output.")


def command(args: CharacteriseArguments) -> None:
    """Characterise a static log: variances, spectrum, what can be read off them, and what is wrong with the log."""
    import json
    from pathlib import Path

    from insemu.cli.announce import announce
    from insemu.cli.logs import column_names
    from insemu.formats import read_curves
    from insemu.logs import characterise_log, open_log, related_axes
    from insemu.whole import put

    console = Console(stderr=args.as_json)
    rate_hz = hertz(args.rate)
    wanted = column_names(args.columns)
    others = read_curves(args.beside) if args.beside else []
    announce(args.file, rate_hz, refuse=False)
    log = open_log(args.file, rate_hz)
    with counting(Console(stderr=True), "characterising", len(wanted or log.names)) as finished:
        axes = characterise_log(log, wanted, from_robust=args.robust, wavelet=args.wavelet, progress=finished)
    together = related_axes(log, [axis.name for axis in axes])
    content: dict[str, Any] = {"axes": {axis.name: axis.to_json() for axis in axes}, "related_axes": together}
    compared = (
        compare(axes, characterise_log(open_log(args.same_as, rate_hz), wanted, wavelet=args.wavelet))
        if args.same_as
        else {}
    )
    if compared:
        content["same_model"] = {"as": args.same_as, "axes": compared}
    folder = Path(args.out) if args.out else Path("results") / f"characterise_{Path(args.file).name.split('.')[0]}"
    page = None
    if args.out or not args.as_json:
        from insemu.report.characterise import render_characterisation

        page = render_characterisation(axes, folder, source=args.file, beside=others, overlay=args.overlay)
        put(folder / "characterise.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    if args.as_json:
        print_json(content, allow_nan=False)
        return
    show(console, axes)
    for pair in together:
        console.print(
            f"Not independent: {' and '.join(pair['axes'])} (p {pair['p_value']:.2g}), correlation {pair['correlation']:.2f} "
            f"({pair['low']:.2f} to {pair['high']:.2f}) at {pair['tau_s']:.3g} s",
            highlight=False,
        )
    for name, found in compared.items():
        verdict = "another noise model" if found["p_value"] < ALARM else "nothing speaks against one noise model"
        print_text(
            console,
            f"Same as {args.same_as}: {name}: {verdict} (p {found['p_value']:.2g}); most apart at {found['tau_s']:.3g} s: variance "
            f"{found['ratio']:.3g} times ({found['low']:.3g} to {found['high']:.3g})",
        )
    console.print(f"\nPage: [bold]{page}[/bold] (characterise.json and figures next to it)", soft_wrap=True)


def compare(axes: Sequence[AxisReport], others: Sequence[AxisReport]) -> dict[str, dict[str, float]]:
    """The test of one noise model for every axis that both logs have, with the scale at which they are most apart."""
    from insemu.errors import InputError
    from insemu.variance import same_model

    by_name = {a.name: a.wavelet for a in others}
    out: dict[str, dict[str, float]] = {}
    for axis in axes:
        if axis.name not in by_name:
            continue
        found = same_model(axis.wavelet, by_name[axis.name])
        outside = [max(low, 1.0 / high) for low, high in zip(found.low, found.high, strict=True)]
        k = outside.index(max(outside))
        numbers = {"tau_s": found.tau_s, "ratio": found.ratio, "low": found.low, "high": found.high}
        out[axis.name] = {"p_value": found.p_value, **{name: float(v[k]) for name, v in numbers.items()}}
    if not out:
        raise InputError("has no column that the first log has", where="--same-as")
    return out


def show(console: Console, axes: Sequence[AxisReport]) -> None:
    """Print the answer, the readings and the findings."""
    from rich.markup import escape

    from insemu.report.characterise import characterise_answer, characterise_rows
    from insemu.variance import duration, grouped_findings

    first = axes[0]
    console.print(characterise_answer(axes), style="bold", highlight=False, markup=False)
    title = f"Readings: {len(axes)} column(s), {first.samples} samples at {first.rate_hz:g} Hz ({duration(first.samples / first.rate_hz)})"
    print_table(console, title, *characterise_rows(axes), left=3, fit=True, groups=True)
    absent: dict[str, list[str]] = {}
    for axis in axes:
        if axis.not_visible:
            absent.setdefault(", ".join(axis.not_visible), []).append(axis.name)
    for names, of in absent.items():
        console.print(f"Not visible in this record: {names} ({escape(', '.join(of))})", soft_wrap=True)
    found = grouped_findings(axes)
    console.print("Findings" if found else "Findings: nothing wrong was found")
    for names, finding in found:
        console.print(f"  [bold]{escape(names)}[/bold]: {escape(finding)}", soft_wrap=True)
