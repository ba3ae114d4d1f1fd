"""Every section of the pages with figures has an entry in the ledger of evidence, and every entry leads somewhere."""

from __future__ import annotations

import importlib.util

from insemu.cli import COMMANDS
from tests.claims import EVIDENCE, ROOT, agreement, ledger, sections


def test_every_section_with_figures_has_an_entry_and_none_is_stale() -> None:
    needed = {(page, head) for page, texts in sections().items() for head in texts}
    held = {(page, head) for page, entries in ledger().items() for head in entries}
    assert needed - held == set(), "sections with figures that docs/claims.yaml does not name"
    assert held - needed == set(), "entries of docs/claims.yaml without such a section"


def test_every_entry_leads_to_a_command_and_a_test() -> None:
    for page, entries in ledger().items():
        for head, entry in entries.items():
            assert set(entry) <= {"evidence", "command", "test"} and entry["evidence"] in EVIDENCE, (page, head)
            assert ("command" in entry) == (entry["evidence"] != "none"), (page, head)
            assert "test" not in entry or (ROOT / entry["test"]).is_file(), (page, head)
            if "command" in entry:
                words = entry["command"].split()
                known = (
                    words[1] in COMMANDS
                    if words[0] == "insemu"
                    else importlib.util.find_spec(words[2])
                    if words[1] == "-m"
                    else (ROOT / words[1]).is_file()
                )
                assert known, (page, head, entry["command"])
                for word in words:
                    assert not word.startswith("scenarios/") or (ROOT / word).is_file(), word


def test_figures_are_found_among_printed_numbers() -> None:
    assert agreement("error 1.23 m, 4.5 of it", "1.2298 4.46") == (2, 2)
    assert agreement("error 1.23 m, 4.5 of it", "1.24 4.56") == (0, 2)
