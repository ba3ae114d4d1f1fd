"""The ledger of evidence: every figure of README and docs, what prints it, and what it rests on.

A figure is a number with a decimal point, a per cent sign, a unit, ``times`` or ``nats`` in prose and tables; in a block without a language (printed
output) every cell that begins with a number, too. Code, links, headings, the bibliography and pages made from the code are apart.

``docs/claims.yaml`` has entries by page and heading (``"*"``: every other heading of the page), one or several per heading; the first whose ``lines``
(a pattern) is found in the figure's line, and whose ``cells`` name its cell in a printed line, covers it:

``evidence``
    ``external`` (another program or a published table), ``closed form``, ``real data``, ``own simulation``, ``none`` (a claim without evidence), or
    ``setting`` (an input, a limit, a constant, a definition: it claims nothing).
``command``
    One or several that print the figures; what they write goes into ``{folder}``, which is empty before and gone afterwards. A figure
    agrees where a printed number is within half a unit of its last digit, or within the relative tolerance ``within``; in a block all
    numbers of the line must be in one printed line.
``check``
    A command that holds the figures against what they rest on and fails where they do not agree, where that is another than ``command``.
``seed``
    That of the draws; of a scenario that its file states; ``none`` where nothing is drawn.
``inputs``
    Files; a figure that stands in one of them with its unit is a setting.
``apart``
    Figures that follow from the printed ones by arithmetic, or that the command does not print.

``python -m tests.claims`` prints the shares; ``--run cheap`` runs the commands that are quick together (CI), ``--run all`` all of them (every night),
``--run PAGE`` those of a page, ``--run "tests.closed_forms"`` those that hold this text. What was found is written to ``docs/claims_runs.yaml``;
a figure that is not printed any more is named and the exit code is 1.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tests.shared_data import root

ROOT = Path(__file__).resolve().parents[1]
LEDGER, RUNS = ROOT / "docs" / "claims.yaml", ROOT / "docs" / "claims_runs.yaml"
#: Evidence that does not come from this program's own draws.
OUTSIDE = ("external", "closed form", "real data")
CLASSES = (*OUTSIDE, "own simulation", "none")
#: Seconds that the commands of ``--run cheap`` took when they were run last, added up.
CHEAP = 60.0
_APART = ("reference", "bibliography.md")
_UNIT = (
    r"%|nats?\b|times\b|deg(?:/(?:h|s))?\b|rad(?:/s)?\b|ms\b|us\b|ns\b|s\b|min\b|h\b|hours?\b|minutes?\b|seconds?\b|days?\b|km\b|cm\b|mm\b|m(?:/s(?:\^2)?)?\b|"
    r"k?Hz\b|MHz\b|[mu]?g\b|µg\b|K\b|[kMG]i?B\b|degrees?\b|sigma\b|samples\b|draws\b"
)
_NUMBER = re.compile(r"(?<![\w.^/])[-+−±]?(\d{1,3}(?:,\d{3})+|\d+)(\.\d+)?(e[-+]?\d+)?")
_TRAILS = re.compile(rf"%|[\s-](?:{_UNIT})")


@dataclass(frozen=True)
class Figure:
    """A number of a page as it is printed, with its unit and its line."""

    page: str
    head: str
    text: str
    unit: str
    line: str
    cell: (
        int  # number of the cell in a line of printed output, from 0 among those that begin with a number; -1 elsewhere
    )

    @property
    def printed(self) -> bool:
        """Whether it stands in a block of printed output."""
        return self.cell >= 0


def pages() -> list[Path]:
    """README and the pages of docs that are written by hand."""
    docs = ROOT / "docs"
    return [ROOT / "README.md"] + [p for p in sorted(docs.rglob("*.md")) if p.relative_to(docs).parts[0] not in _APART]


def _lines(page: Path) -> Iterator[tuple[str, str, bool]]:
    """Heading, text without code and links, and whether it is printed output, of every line that can hold figures."""
    head, fence = "", None
    for raw in page.read_text(encoding="utf-8").splitlines():
        if mark := re.match(r"\s*```\{?(\w*)", raw):
            fence = mark[1] if fence is None else None
        elif fence is None and re.match(r"#+ ", raw):
            head = raw.strip("# ")
        elif fence is None and not raw.startswith("    "):
            yield head, re.sub(r"`[^`]*`|!?\[[^\]]*\]\([^)]*\)", " _ ", raw), False
        elif fence in ("", "text") and not re.match(r" *(insemu|python|make|pytest) ", raw):
            yield head, raw, True


def _begins(cell: str) -> bool:
    number = _NUMBER.match(cell)
    return bool(number and not re.match(r"[A-Za-z_]", cell[number.end() :]))


def figures() -> list[Figure]:
    """Every figure of the pages."""
    found = []
    for page in pages():
        name = page.relative_to(ROOT / "docs").as_posix() if page.name != "README.md" else page.name
        for head, line, printed in _lines(page):
            cells = [c.span() for c in re.finditer(r"\S+(?: \S+)*", line) if _begins(c[0])] if printed else []
            for number in _NUMBER.finditer(line):
                trail = _TRAILS.match(line, number.end())
                if re.match(r"\w", line[number.end() :]) and not trail:
                    continue  # a name such as 18AV
                cell = next(
                    (k for k, (a, b) in enumerate(cells) if a <= number.start() < b), len(cells) if printed else -1
                )
                if number[2] or trail or -1 < cell < len(cells):
                    unit = trail[0].strip(" -") if trail else ""
                    found.append(Figure(name, head, number[0].replace(",", ""), unit, line.strip(), cell))
    return found


def ledger() -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Entries by page and heading."""
    data = yaml.safe_load(LEDGER.read_text(encoding="utf-8"))
    return {p: {h: e if isinstance(e, list) else [e] for h, e in heads.items()} for p, heads in data.items()}


def commands(entry: dict[str, Any], key: str = "command") -> list[str]:
    """The commands of an entry."""
    given = entry.get(key, [])
    return [given] if isinstance(given, str) else list(given)


@dataclass(frozen=True)
class Claim:
    """A figure with the entry that covers it and its class of evidence."""

    figure: Figure
    entry: dict[str, Any]
    evidence: str


def claims() -> tuple[list[Claim], list[Figure]]:
    """Figures with their entries, and figures that none covers."""
    held, covered, bare = ledger(), [], []
    texts: dict[str, str] = {}
    for figure in figures():
        heads = held.get(figure.page, {})
        for entry in heads.get(figure.head, heads.get("*", [])):
            if re.search(entry.get("lines", ""), figure.line) and figure.cell in entry.get("cells", [figure.cell]):
                covered.append(Claim(figure, entry, _evidence(figure, entry, texts)))
                break
        else:
            bare.append(figure)
    return covered, bare


def _evidence(figure: Figure, entry: dict[str, Any], texts: dict[str, str]) -> str:
    """The class of the entry, or a setting where the figure stands with its unit in one of the inputs."""
    for file in entry.get("inputs", []) if figure.unit and not figure.printed else []:
        text = texts.setdefault(file, (ROOT / file).read_text(encoding="utf-8"))
        if re.search(rf"(?<![\w.]){re.escape(figure.text)}\s*{re.escape(figure.unit)}(?!\w)", text):
            return "setting"
    kind: str = entry["evidence"]
    return kind


def seed(entry: dict[str, Any]) -> str:
    """The seed of an entry's draws in words; empty where none is stated."""
    if "seed" in entry:
        return str(entry["seed"])
    for word in " ".join(commands(entry)).split():
        if word.startswith("scenarios/") and (stated := re.search(r"^seed: *(\d+)", (ROOT / word).read_text(), re.M)):
            return stated[1]
    return ""


def shares(covered: Sequence[Claim]) -> Counter[str]:
    """Figures by class of evidence."""
    return Counter(c.evidence for c in covered)


def _step(text: str) -> float:
    """A unit of the last digit of a number as printed."""
    mantissa, _, power = text.partition("e")
    return 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))


def agrees(figure: str, numbers: Sequence[float], within: float = 0.0) -> bool:
    """Whether one of the numbers rounds to the figure, or lies within the relative tolerance."""
    value = float(figure.replace("−", "-").lstrip("±"))
    most = max(0.5000001 * _step(figure.lstrip("−±")), within * abs(value))
    return any(abs(abs(n) - abs(value)) <= most for n in numbers)


def _numbers(text: str) -> list[float]:
    return [float(m[0].replace(",", "").replace("−", "-").lstrip("±")) for m in _NUMBER.finditer(text)]


def missing(found: Sequence[Claim], printed: str) -> list[str]:
    """Figures that are not among the printed numbers, those of a block line by line."""
    whole = _numbers(printed)
    rows = [_numbers(line) for line in printed.splitlines()]
    lacking = []
    for claim in found:
        figure, within = claim.figure, float(claim.entry.get("within", 0.0))
        if claim.evidence == "setting" or figure.text in map(str, claim.entry.get("apart", [])):
            continue
        if figure.printed and not within:
            wanted = [m[0].replace(",", "") for m in _NUMBER.finditer(figure.line)]
            good = any(len(row) >= len(wanted) and all(agrees(w, row) for w in wanted) for row in rows)
        else:
            good = agrees(figure.text, whole, within)
        if not good:
            lacking.append(f"{figure.text} {figure.unit}".strip())
    return lacking


def digest(found: Sequence[Claim]) -> str:
    """Tells whether figures were changed since a command was run."""
    return hashlib.sha256("\n".join(f"{c.figure.text} {c.figure.line}" for c in found).encode()).hexdigest()[:12]


def runs() -> dict[str, dict[str, Any]]:
    """What was found when commands were run last, by key."""
    return (yaml.safe_load(RUNS.read_text(encoding="utf-8")) or {}) if RUNS.exists() else {}


def jobs(covered: Sequence[Claim]) -> dict[str, list[Claim]]:
    """Claims by what is run for them: the commands that print them, and those that check them."""
    found: dict[str, list[Claim]] = {}
    for claim in covered:
        for key in ("command", "check"):
            if lines := commands(claim.entry, key):
                found.setdefault(("check: " if key == "check" else "") + " && ".join(lines), []).append(claim)
    return found


def execute(lines: str, folder: Path) -> tuple[bool, str, float]:
    """Run commands, results into a folder of their own; whether all ended well, what they printed, and the processor's seconds."""
    good, text, begun = True, "", os.times()
    for line in lines.split(" && "):
        words = [word.replace("{folder}", str(folder)) for word in shlex.split(line)]
        if words[0] == "insemu" and words[1] in ("run", "gap"):
            words += ["--output", str(folder / hashlib.sha256(line.encode()).hexdigest()[:8])]
        words = [sys.executable, *(["-m", "insemu"] if words[0] == "insemu" else []), *words[1:]]
        done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, env={**os.environ, "COLUMNS": "200"})
        good, text = good and done.returncode == 0, text + done.stdout + done.stderr
    ended = os.times()
    return good, text, ended.children_user + ended.children_system - begun.children_user - begun.children_system


def run(which: str, covered: Sequence[Claim]) -> int:
    """Run the commands of ``cheap``, ``all`` or a page, keep what they found, and say what moved; the number of commands that did not agree."""
    kept, wrong, left = runs(), 0, CHEAP
    with tempfile.TemporaryDirectory() as folder:
        for lines, found in sorted(jobs(covered).items(), key=lambda job: kept.get(job[0], {}).get("seconds", 1e9)):
            last = kept.get(lines, {}).get("seconds")
            if which == "cheap":
                if last is None or last > left:
                    continue
                left -= last
            elif which != "all" and which not in lines and which not in {c.figure.page for c in found}:
                continue
            if "../shared/" in lines and not root().exists():
                print(f"skipped, the shared data are absent: {lines}", flush=True)
                continue
            begun = time.monotonic()
            good, printed, seconds = execute(lines.removeprefix("check: "), Path(folder))
            if "shared data" in printed and not good:
                print(f"skipped, the shared data are absent: {lines}", flush=True)
                continue
            lacking = [] if lines.startswith("check: ") else missing(found, printed)
            agreed = good and not lacking
            wrong += not agreed
            print(
                f"{'agrees' if agreed else 'MOVED'}: {lines}: {len(found) - len(lacking)} of {len(found)} figures, "
                f"{time.monotonic() - begun:.0f} s" + (f"; not printed: {', '.join(lacking)}" if lacking else ""),
                flush=True,
            )
            if not good:
                print("\n".join(printed.splitlines()[-8:]))
            kept[lines] = {
                "date": datetime.date.today().isoformat(),
                "seconds": round(seconds, 1),
                "figures": len(found),
                "agreed": bool(agreed),
                "digest": digest(found),
            }
            if which != "cheap":
                RUNS.write_text(
                    "# Written by python -m tests.claims --run all (or PAGE): when the commands of docs/claims.yaml were run last.\n"
                    + yaml.safe_dump(kept, sort_keys=True, allow_unicode=True, width=1000),
                    encoding="utf-8",
                )
    return wrong


def notes(page: str, covered: Sequence[Claim], most: int = 10) -> dict[str, str]:
    """By heading of a page, what the figures of its section rest on; up to ``most`` figures of a class one by one."""
    found: dict[str, dict[str, list[str]]] = {}
    for claim in covered:
        if claim.figure.page == page and claim.evidence != "setting":
            text = f"{claim.figure.text} {claim.figure.unit}".strip()
            found.setdefault(claim.figure.head, {}).setdefault(claim.evidence, []).append(text)
    out = {}
    for head, classes in found.items():
        parts = []
        for kind, texts in sorted(classes.items(), key=lambda item: -len(item[1])):
            shown = (
                "all figures"
                if len(classes) == 1
                else ", ".join(texts)
                if len(texts) <= most
                else f"{len(texts)} figures"
            )
            parts.append(f"{kind} ({shown})")
        out[head] = "; ".join(parts)
    return out


def said(covered: Sequence[Claim]) -> list[str]:
    """The shares in words, one class a line."""
    count = shares(covered)
    claimed = sum(count[kind] for kind in CLASSES)
    lines = [f"{kind}: {count[kind]} of {claimed} figures ({100 * count[kind] / claimed:.0f} %)" for kind in CLASSES]
    outside = sum(count[kind] for kind in OUTSIDE)
    lines += [f"external, closed form or real data together: {100 * outside / claimed:.1f} %"]
    return [*lines, f"settings, which claim nothing: {count['setting']}"]


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.claims", description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--run", metavar="cheap|all|PAGE|TEXT", action="append", default=[], help="run commands and compare"
    )
    parser.add_argument("--list", metavar="PAGE", help="every figure of a page with its class")
    given = parser.parse_args()
    covered, bare = claims()
    for figure in bare:
        print(f"no entry: {figure.page}, {figure.head}: {figure.text} {figure.unit}: {figure.line[:100]}")
    print("\n".join(said(covered)))
    for claim in covered:
        if claim.figure.page == given.list:
            print(
                f"{claim.evidence:15s} {claim.figure.head[:25]:25s} {claim.figure.text:>9s} {claim.figure.unit:7s} {claim.figure.line[:90]}"
            )
    return min(1, len(bare) + sum(run(which, covered) for which in given.run))


if __name__ == "__main__":
    sys.exit(main())
