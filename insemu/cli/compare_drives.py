"""``insemu compare-drives``: whether an emulated drive can be distinguished from a recorded one, and by what."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.options import argument, option
from insemu.cli.printing import print_json

if TYPE_CHECKING:
    from insemu.drives import Comparison


def command(
    recording: str = argument("RECORDING"),
    emulated: str = argument("EMULATED"),
    column_map: str = option("--map", ""),
    seed: int = option("--seed", 1, "Of the folds by which windows are held out."),
    page: str = option("--page", ""),
    as_json: bool = option("--json", False),
) -> None:
    """Ask whether an emulated drive moves as a recorded one: area under the curve of a classifier, and which features give it away.

    Windows of 4 s of both, six bands of six axes; regimes count alike in both, sensors are made equally noisy by their standstills. What it names
    goes to `insemu vehicle`.
    """
    from insemu import formats
    from insemu.drives import compare_drives, top_of, windows_of

    console = Console(stderr=as_json, highlight=False)
    both = [
        formats.open_files(file, maps=(text, "", "")).recording()
        for file, text in ((recording, column_map), (emulated, ""))
    ]
    top = top_of(*both)
    found = compare_drives(*(windows_of(r, top_hz=top) for r in both), seed=seed)
    if page:
        from insemu.report.drives import render_drives

        render_drives(found, page, recording, emulated)
    if as_json:
        print_json(found.to_json())
        return
    _show(console, found)
    if page:
        console.print(f"\nPage: [bold]{page}[/bold]", soft_wrap=True)


def _show(console: Console, found: Comparison) -> None:
    from insemu.cli.printing import print_items, print_table
    from insemu.report import drives as report

    console.print(report.drives_answer(found), style="bold", markup=False, soft_wrap=True)
    print_items(console, [t.words for t in found.telling[:3]])
    for title, (header, rows) in (
        ("What gives it away, one feature at a time", report.telling_rows(found)),
        ("Bands by regime, emulated over recorded in dB", report.band_rows(found)),
    ):
        if rows:
            print_table(console, title, header, rows, left=2, fit=True)
    console.print()
    print_items(console, list(found.said))
