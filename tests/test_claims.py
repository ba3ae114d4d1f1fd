"""Every figure of the pages has an entry in the ledger of evidence, every entry leads somewhere, and a figure that moves is seen."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from insemu.cli import COMMANDS
from tests.claims import (
    CLASSES,
    OUTSIDE,
    ROOT,
    Claim,
    Figure,
    agrees,
    claims,
    commands,
    digest,
    execute,
    figures,
    jobs,
    ledger,
    missing,
    notes,
    runs,
    seed,
    shares,
)


def test_every_figure_has_an_entry_and_no_entry_is_stale() -> None:
    covered, bare = claims()
    assert [(f.page, f.head, f.text, f.unit) for f in bare] == [], "figures that docs/claims.yaml does not cover"
    used = {id(c.entry) for c in covered}
    held = ledger()
    texts = {(c.figure.page, str(c.entry)) for c in covered}
    stale = [(p, h, e) for p, heads in held.items() for h, es in heads.items() for e in es if (p, str(e)) not in texts]
    assert used and stale == [], "entries of docs/claims.yaml that cover nothing"


def test_most_figures_rest_on_more_than_our_own_draws() -> None:
    count = shares(claims()[0])
    claimed = sum(count[kind] for kind in CLASSES)
    assert claimed > 1500 and sum(count[kind] for kind in OUTSIDE) >= 0.6 * claimed


def test_every_entry_says_what_prints_or_holds_its_figures() -> None:
    keys = {"lines", "cells", "evidence", "command", "check", "seed", "test", "inputs", "apart", "within"}
    for page, heads in ledger().items():
        for head, entries in heads.items():
            for entry in entries:
                place = (page, head, entry)
                assert set(entry) <= keys and entry["evidence"] in (*CLASSES, "setting"), place
                assert all((ROOT / file).is_file() for file in entry.get("inputs", [])), place
                if entry["evidence"] in ("setting", "none"):
                    continue
                assert commands(entry) or "test" in entry, place
                assert "test" not in entry or (ROOT / entry["test"]).is_file(), place
                if entry["evidence"] == "own simulation":
                    assert seed(entry), place
                for line in (*commands(entry), *commands(entry, "check")):
                    words = line.split()
                    known = (
                        words[1] in COMMANDS
                        if words[0] == "insemu"
                        else importlib.util.find_spec(words[2])
                        if words[1] == "-m"
                        else (ROOT / words[1]).is_file()
                    )
                    assert known, place
                    assert all(not w.startswith("scenarios/") or (ROOT / w).is_file() for w in words), place


def _claim(text: str, line: str, cell: int = -1, **entry: object) -> Claim:
    return Claim(Figure("p.md", "h", text, "m", line, cell), entry, "closed form")


def test_a_figure_that_moves_by_its_last_digit_is_seen() -> None:
    found = [_claim("1.23", "error 1.23 m"), _claim("−0.5", "offset −0.5 m"), _claim("2.5e-3", "rate 2.5e-3")]
    assert missing(found, "error 1.2298, offset -0.46, rate 0.00252") == []
    assert missing(found, "error 1.2351, offset -0.56, rate 0.00256") == ["1.23 m", "−0.5 m", "2.5e-3 m"]
    assert missing([_claim("1.23", "error 1.23 m", within=0.02)], "1.25") == []
    row = [_claim("195", "model 1 195 52.6", 0)]
    assert missing(row, "model 1   195   52.6") == []
    assert missing(row, "model 1   195   52.7\nmodel 2   302   52.6") == ["195 m"]  # not in one line
    assert agrees("195", [195.4]) and not agrees("195", [195.6])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("an outage of 60 s and 3 designs", [("60", "s")]),
        ("within 1.5 to 2 %, Table 6", [("1.5", ""), ("2", "%")]),
        ("18AV in `4.2 m` of [3.3](x.md)", []),
        ("100,000 samples", [("100000", "samples")]),
    ],
)
def test_what_is_a_figure(line: str, expected: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    page = ROOT / "README.md"
    monkeypatch.setattr("tests.claims.pages", lambda: [page])
    monkeypatch.setattr(type(page), "read_text", lambda *_, **__: f"# Head\n{line}\n")
    assert [(f.text, f.unit) for f in figures()] == expected


def test_what_commands_write_goes_into_a_folder_of_their_own(tmp_path: Path) -> None:
    write = """python -c "open('{folder}/x', 'w').write('7 m')" """.strip()
    read = """python -c "print(open('{folder}/x').read())" """.strip()
    good, printed, _ = execute(f"{write} && {read}", tmp_path)
    assert good and "7 m" in printed and (tmp_path / "x").exists()
    for line in (line for lines in jobs(claims()[0]) for line in lines.split(" && ")):
        written = re.findall(r"(?:--output|-o) (\S+)", line)
        assert all(path.startswith("{folder}/") for path in written), line


def test_what_was_run_last_is_of_the_figures_that_stand_there() -> None:
    kept = runs()
    found = jobs(claims()[0])
    assert set(kept) <= set(found), "runs of commands that docs/claims.yaml does not name any more"
    moved = [lines for lines, last in kept.items() if last["digest"] == digest(found[lines]) and not last["agreed"]]
    assert moved == [], "figures that their command did not print when it was run last"


def test_a_section_says_what_its_figures_rest_on() -> None:
    covered = [
        Claim(Figure("p.md", "A", "1.5", "m", "", -1), {}, "closed form"),
        Claim(Figure("p.md", "A", "2", "%", "", -1), {}, "real data"),
        Claim(Figure("p.md", "A", "3", "s", "", -1), {}, "setting"),
        Claim(Figure("p.md", "B", "4", "", "", 0), {}, "external"),
        Claim(Figure("q.md", "A", "5", "m", "", -1), {}, "none"),
    ]
    assert notes("p.md", covered) == {"A": "closed form (1.5 m); real data (2 %)", "B": "external (all figures)"}
    assert notes("p.md", covered, most=0)["A"] == "closed form (1 figures); real data (1 figures)"
