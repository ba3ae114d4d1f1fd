"""The drawing of the rooms: floors from the import contract in pyproject.toml, arrows from the import graph of the code."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
#: Height of a floor and of a box, width of a letter and of the gap between boxes, in pixels.
FLOOR, BOX, LETTER, GAP = 62, 26, 7.4, 14


def floors() -> list[list[str]]:
    """Rooms floor by floor, from the top."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = next(c["layers"] for c in contracts if c["type"] == "layers" and c["containers"] == ["insemu"])
    return [[name.strip() for name in layer.split("|")] for layer in layers]


@cache
def arrows() -> set[tuple[str, str]]:
    """Which room imports which, without arrows that follow from others."""
    graph = grimp.build_graph("insemu", cache_dir=None, exclude_type_checking_imports=True)
    uses: dict[str, set[str]] = {}
    for module in graph.modules:
        own = module.split(".")[1:2]
        for other in graph.find_modules_directly_imported_by(module):
            if own and other.split(".")[1:2] not in (own, []):
                uses.setdefault(own[0], set()).add(other.split(".")[1])

    @cache
    def below(room: str) -> set[str]:
        direct = uses.get(room, set())
        return direct.union(*(below(r) for r in direct)) if direct else set()

    return {(a, b) for a, direct in uses.items() for b in direct if not any(b in below(c) for c in direct)}


@cache
def drawing() -> str:
    """The rooms as SVG."""
    rows = floors()
    widths = {room: LETTER * len(room) + 18 for row in rows for room in row}
    total = max(sum(widths[r] + GAP for r in row) for row in rows) + GAP
    at: dict[str, tuple[float, float]] = {}
    for level, row in enumerate(rows):
        left = (total - sum(widths[r] for r in row) - GAP * (len(row) - 1)) / 2
        for room in row:
            at[room] = (left + widths[room] / 2, level * FLOOR + GAP + BOX / 2)
            left += widths[room] + GAP
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {len(rows) * FLOOR}" font-family="sans-serif" font-size="13">',
        "<title>Rooms of insemu, floor by floor; a line leads down to what a room imports</title>",
    ]
    for above, under in sorted(arrows()):
        (x, y), (u, v) = at[above], at[under]
        middle = (y + v) / 2
        curve = f"M{x:.0f} {y:.0f} C{x:.0f} {middle:.0f} {u:.0f} {middle:.0f} {u:.0f} {v:.0f}"
        lines.append(f'<path d="{curve}" fill="none" stroke="#8899aa"><title>{above} imports {under}</title></path>')
    for room, (x, y) in at.items():
        w = widths[room]
        lines.append(
            f'<rect x="{x - w / 2:.0f}" y="{y - BOX / 2:.0f}" width="{w:.0f}" height="{BOX}" rx="4" fill="#eef3f8" stroke="#335577"/>'
            f'<text x="{x:.0f}" y="{y + 4.5:.0f}" text-anchor="middle" fill="#112233">{room}</text>'
        )
    return "\n".join([*lines, "</svg>"]) + "\n"


def write_drawing(folder: Path) -> None:
    """Write ``architecture.svg`` into a folder; the same text is left as it is."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "architecture.svg"
    if not file.exists() or file.read_text(encoding="utf-8") != drawing():
        file.write_text(drawing(), encoding="utf-8")
