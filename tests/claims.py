"""The ledger of evidence: which section of the pages shows figures, what prints them, and what they rest on.

``python -m tests.claims`` prints the shares; ``--run PAGE`` runs the commands of a page (a scenario's folder of results is not kept) and says of
every section how many of its figures are among the numbers that its command prints.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections import Counter
from pathlib import Path

from insemu import yamlfile

ROOT = Path(__file__).resolve().parents[1]
EVIDENCE = ("external", "closed form", "real data", "own simulation", "none")
#: Figures of a section from which on it needs an entry.
FEWEST = 6
_FIGURE = re.compile(r"\d+\.\d+|\d+ ?%")
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: Pages that define and explain; their figures are the program's settings.
_APART = (
    "reference",
    "explained",
    "howto",
    "tutorials",
    "bibliography",
    "glossary",
    "architecture",
    "scenario_examples",
    "gallery",
    "notebooks",
    "evidence",
)


def sections() -> dict[str, dict[str, str]]:
    """Text of every section with figures, by page and heading."""
    found: dict[str, dict[str, str]] = {}
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        if any(part.startswith(_APART) for part in page.relative_to(ROOT).parts):
            continue
        head = ""
        for line in page.read_text(encoding="utf-8").splitlines():
            if re.match(r"#+ ", line):
                head = line.strip("# ")
            texts = found.setdefault(page.name, {})
            texts[head] = texts.get(head, "") + line + "\n"
    return {
        page: kept
        for page, texts in found.items()
        if (kept := {h: t for h, t in texts.items() if len(_FIGURE.findall(t)) >= FEWEST})
    }


def ledger() -> dict[str, dict[str, dict[str, str]]]:
    """Entries by page and heading."""
    data: dict[str, dict[str, dict[str, str]]] = yamlfile.read(ROOT / "docs" / "claims.yaml").data
    return data


def shares() -> Counter[str]:
    """Sections by class of evidence; settings apart."""
    return Counter(e["evidence"] for entries in ledger().values() for e in entries.values() if e["evidence"] != "none")


def agreement(text: str, printed: str) -> tuple[int, int]:
    """How many figures of a section are among the printed numbers to the digits that it shows, and how many it has."""
    numbers = [float(n) for n in _NUMBER.findall(printed)]
    figures = [n for n in _NUMBER.findall(text) if "." in n]
    found = 0
    for figure in figures:
        digits = len(figure.split("e")[0].partition(".")[2])
        found += any(abs(n - float(figure)) <= 0.5000001 * 10.0**-digits for n in numbers)
    return found, len(figures)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.claims", description=__doc__)
    parser.add_argument(
        "--run", metavar="PAGE", action="append", default=[], help="run the commands of this page, 'all' for every one"
    )
    given = parser.parse_args()
    count = shares()
    for kind in EVIDENCE[:-1]:
        print(f"{kind:16s} {count[kind]:3d} of {count.total()} sections, {100 * count[kind] / count.total():.0f} %")
    text = sections()
    for page, entries in ledger().items():
        if page not in given.run and "all" not in given.run:
            continue
        for head, entry in entries.items():
            if entry["evidence"] == "none" or head not in text.get(page, {}):
                continue
            words = shlex.split(entry["command"])
            words = [sys.executable, *(["-m", "insemu"] if words[0] == "insemu" else []), *words[1:]]
            done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
            found, of = agreement(text[page][head], done.stdout + done.stderr)
            print(f"{page}, {head}: exit code {done.returncode}, {found} of {of} figures printed", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
