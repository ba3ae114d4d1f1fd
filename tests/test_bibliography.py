"""Every citation of the form "Author 2013" or "Author et al. (2013)" in the package and the docs stands in docs/bibliography.md."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "bibliography.md"
_NAME = r"[A-Z][A-Za-zéüöä-]+"
#: One to three authors or "et al.", then the year, in parentheses or not.
CITATION = re.compile(
    rf"({_NAME}(?:(?:, (?:and |& )?|\s+and\s+|\s+&\s+){_NAME})*(?:\s+et\s+al\.)?),?\s+\(?((?:19|20)\d\d)\b"
)
#: Words that stand before a year without being an author.
NO_AUTHORS = {"January", "November", "Sensors", "Statistics", "Copyright", "SeedSequence", "Since", "In"}


def citations(text: str) -> set[tuple[str, str]]:
    """First author and year of every citation of a text."""
    found = ((re.split(r"[\s,]", authors)[0], year) for authors, year in CITATION.findall(text))
    return {(author, year) for author, year in found if author not in NO_AUTHORS}


def cited_files() -> list[Path]:
    """What may cite: the package and the pages, without the bibliography itself."""
    return sorted([*(ROOT / "insemu").rglob("*.py"), *(p for p in (ROOT / "docs").glob("*.md") if p != PAGE)])


def test_citations_are_recognised() -> None:
    text = "Rauch, Tung and\nStriebel 1965; Stebler et al. (2014), section III; Percival & Walden 2000; 3 times 2000"
    assert citations(text) == {("Rauch", "1965"), ("Stebler", "2014"), ("Percival", "2000")}


def test_every_citation_stands_in_the_bibliography() -> None:
    known = citations(PAGE.read_text(encoding="utf-8"))
    texts = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in cited_files()}
    lacking = {name: more for name, text in texts.items() if (more := citations(text) - known)}
    numbered = [name for name, text in texts.items() if re.search(r"\bpapers? 00\d", text, re.IGNORECASE)]
    assert (lacking, numbered) == ({}, []), "cite author and year, as in docs/bibliography.md"
