"""Every printed table and figure of the five papers that can be made without the authors' data, beside ours, on one page.

    python -m benchmarks.papers [--out results/papers] [--only mems2013] [--full] [--seed 1]

``--full`` takes more draws. Finished parts are kept in the folder: an interrupted run goes on, and a part that changed is made again. The
printed numbers are read from the shared data (``INSEMU_SHARED``, else ``../shared``).
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

from benchmarks.papers import em2011, gmwm2014, hidden, mems2013, ml2016, platform2016, runs
from benchmarks.papers import exhibit as exhibits
from benchmarks.papers.exhibit import EXHIBITS, PAPERS, Content, Exhibit, Task
from benchmarks.papers.words import Claim, claims
from insemu.report import page
from insemu.work import Lines, run_items

#: File and key of the printed numbers of a paper.
PRINTED = {
    "gmwm2014": ("stebler2014.yaml", None),
    "em2011": ("others.yaml", "constrained_em_2011"),
    "ml2016": ("others.yaml", "integrated_ml_2016"),
    "platform2016": ("others.yaml", "gmwm_platform_2016"),
    "mems2013": ("quinchia2013.yaml", None),
}
MODULES = {m.__name__.rsplit(".", 1)[1]: m for m in (gmwm2014, em2011, ml2016, platform2016, mems2013)}

#: Not made, and why.
LEFT_OUT = (
    "Photographs, block diagrams and hypothetical curves.",
    "Curves of real signals (IMAR-FSAS, MTi-G, BMX055, NavChip, 3DM-GX3), which are not published: the models fitted to them are simulated instead.",
    "Nikolic et al. 2016, Figures 12 to 15: cameras, a rate table with a temperature chamber.",
)


def printed_numbers(folder: Path, paper: str) -> dict | None:
    """What a paper prints, or None where the shared data is absent."""
    name, key = PRINTED[paper]
    path = folder / "published" / name
    if not path.exists():
        return None
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    return data[key] if key else data


@dataclass(frozen=True)
class Made:
    """A finished exhibit."""

    content: Content
    seconds: float


def make(item: tuple[Exhibit, Task]) -> Made:
    """Compute one exhibit."""
    exhibit, task = item
    print(f"{exhibit.key} ...", file=sys.stderr, flush=True)
    began = time.perf_counter()
    return Made(exhibit.make(task), time.perf_counter() - began)


def state(exhibit: Exhibit, task: Task) -> str:
    """Key of a finished exhibit: what it is, and everything that it was made from."""
    source = "".join(inspect.getsource(module) for module in (MODULES[exhibit.paper], exhibits, hidden, runs))
    text = f"{source}{task.printed}{task.seed}{task.full}"
    return f"{exhibit.key} {hashlib.sha256(text.encode()).hexdigest()[:12]}"


def number(x: float) -> str:
    return f"{x:.4g}"


def lines(exhibit: Exhibit, content: Content) -> list[str]:
    """What the command prints of an exhibit."""
    agree = sum(c.agrees for c in content.cells)
    out = [f"{PAPERS[exhibit.paper]}, {exhibit.label}: {exhibit.title}", f"  {content.verdict}"]
    if content.cells:
        out.append(f"  {agree} of {len(content.cells)} cells agree ({content.interval})")
    for c in content.cells:
        ours = f"ours {number(c.ours)} [{number(c.low)}, {number(c.high)}] {c.unit}".rstrip()
        out.append(f"    {'' if c.agrees else '! '}{c.what}: printed {number(c.printed)}, {ours}")
    out += [f"    {'' if s.holds else '! '}{s.text}: {s.measured}" for s in content.statements]
    for g in content.grids:
        out += [f"  {g.caption}", *(f"    {row[0]}: {', '.join(filter(None, row[1:]))}" for row in g.rows)]
    return out


def section(exhibit: Exhibit, content: Content) -> page.Section:
    """The same on the page."""
    blocks: list[page.Block] = [page.Text(f"{PAPERS[exhibit.paper]}. Verdict: {content.verdict}.")]
    if content.statements:
        rows = [[s.text, s.measured, "holds" if s.holds else "does not hold"] for s in content.statements]
        blocks.append(page.Table(["what the paper finds", "measured", ""], rows, left=3))
    if content.cells:
        rows = [
            [
                c.what,
                number(c.printed),
                number(c.ours),
                f"{number(c.low)} to {number(c.high)}",
                c.unit,
                "agrees" if c.agrees else "differs",
            ]
            for c in content.cells
        ]
        agree = sum(c.agrees for c in content.cells)
        caption = f"{agree} of {len(rows)} cells agree. Interval: {content.interval}."
        blocks.append(page.Table(["", "printed", "ours", "interval", "unit", ""], rows, caption))
    blocks += [page.Table(g.header, g.rows, g.caption) for g in content.grids]
    return page.Section(f"{exhibit.label}: {exhibit.title}", blocks)


def in_words(claimed: dict[str, list[Claim]]) -> tuple[page.Section, list[str]]:
    """What the papers claim in words of their own cells: on the page, and as the command prints it."""
    blocks: list[page.Block] = [
        page.Text(
            "Each claim in words is computed from the printed cells it speaks of. It contradicts them where a figure is outside of what the "
            "words allow: the rounding of a claimed number, more where a word stands."
        )
    ]
    printed = []
    for paper, found in claimed.items():
        wrong = [c for c in found if not c.follows]
        caption = f"{PAPERS[paper]}: {len(found) - len(wrong)} of {len(found)} claims follow from the printed figures"
        rows = [[c.says, c.where, c.measured, c.verdict, c.note] for c in found]
        blocks.append(page.Table(["claim", "where", "from the cells", "", ""], rows, caption, left=5))
        printed += [caption, *(f"    {'' if c.follows else '! '}{c.says}: {c.measured}, {c.verdict}" for c in found)]
    return page.Section("Claims in words", blocks), printed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="results/papers", help="folder for page and finished parts")
    parser.add_argument(
        "--only", default="", help="papers or labels that contain this text, such as mems2013 or 'Table 2'"
    )
    parser.add_argument("--full", action="store_true", help="more draws")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    runs.FOLDER = folder
    shared = Path(os.environ.get("INSEMU_SHARED", "../shared"))
    chosen = [e for e in EXHIBITS if args.only in e.key]
    items = {}
    claimed = {}
    for paper in PAPERS:
        if args.only in f"{paper}/Claims in words" and (numbers := printed_numbers(shared, paper)) is not None:
            claimed[paper] = claims(paper, numbers)
    for e in chosen:
        printed = printed_numbers(shared, e.paper)
        if printed is None:
            print(f"{e.key}: skipped, its printed numbers are not in {shared}/published")
            continue
        task = Task(printed, args.seed, args.full)
        items[state(e, task)] = (e, task)
    store = Lines[Made](
        folder / "parts.jsonl",
        lambda m: {"content": m.content.encode(), "seconds": m.seconds},
        lambda d: Made(Content.decode(d["content"]), float(d["seconds"])),
        "parts of the papers' page",
    )
    done = run_items(items, make, store=store)
    sections, verdicts = [], []
    for key, made in done.items():
        exhibit = items[key][0]
        print("\n".join(lines(exhibit, made.content)), end="\n\n")
        sections.append(section(exhibit, made.content))
        verdicts.append([PAPERS[exhibit.paper], exhibit.label, made.content.verdict, f"{made.seconds:.0f} s"])
    if claimed:
        words, said = in_words(claimed)
        print("\n".join(said), end="\n\n")
        sections.insert(0, words)
    overview = page.Section(
        "Verdicts", [page.Table(["paper", "exhibit", "verdict", "made in"], verdicts, left=3), page.Items(LEFT_OUT)]
    )
    target = folder / "index.html"
    count = sum(m.content.verdict.startswith("reproduced") for m in done.values())
    answer = f"{count} of {len(done)} exhibits reproduced, in kind or to the cell"
    found = [c for some in claimed.values() for c in some]
    if found:
        answer += f"; {sum(not c.follows for c in found)} of {len(found)} claims in words contradict their own figures"
    page.Page(
        "The five papers, cell by cell",
        [overview, *sections],
        kind="python -m benchmarks.papers",
        answer=f"{answer}.",
        lead="Printed tables and figures beside simulations from the printed models.",
    ).write(target)
    print(f"{answer}. Page: {target}")


if __name__ == "__main__":
    main()
