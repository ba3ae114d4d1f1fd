"""How easily README, the pages of docs and the messages of bad input are read: words, length of sentences, rare words.

``python -m tests.readability`` prints a row for every page and for the messages. ``--words PAGE`` prints the rare words of a page,
``--sentences PAGE`` its longest sentences. Code, targets of links, printed output and the bibliography are not read. A sentence ends with a period,
a colon or a semicolon, or with its paragraph, list item or table cell. Pieces of fewer than five words (names, values) are no sentences.

A rare word is neither of one of the 5,000 most frequent families of English words (a word with its inflections and derivations; from the list of
the package wordfreq, extra ``words``) nor of a term of docs/glossary.md. Names (words with a capital letter inside a sentence, abbreviations), units
and symbols (words of one or two letters) do not count.

The exit code is 1 where a page has more than 2,500 words or a mean sentence of more than 25, where more than 2 % of all words are rare, or where the
glossary has more than 150 terms.
"""

from __future__ import annotations

import argparse
import re
import runpy
import sys
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Words of a page, printed output and code included; words of a sentence on average; share of rare words of all texts together.
MOST_WORDS, MEAN_SENTENCE, RARE_SHARE = 2500, 25.0, 0.02
FREQUENT, MOST_TERMS = 5000, 150
_SHORTEST = 5
_UNITS = frozenset("deg rad rms min max nan xyz".split())
_WORD = re.compile(r"[A-Za-z][A-Za-z'’]*(?![\w(])")
#: Endings of inflections, behind three letters or more, and of derivations, behind four or more.
_INFLECTION = re.compile(r"(?<=\w{3})('s|e?s|i?ed|ing|i?es|e|y|i)$")
_DERIVATION = re.compile(
    r"(?<=\w{4})([eo]r|ly|at(ion|or|e|ive)?|ion|ive|al|ic|i?t(y|ie)|i?ness|[ai]ble|ment|[ae]n(ce|t)|an?c|ant)$"
)


def _plain(text: str) -> str:
    """Text without code and marks; a piece of code counts as one word in a sentence."""
    text = re.sub(r"``.*?``|`[^`]*`", " CODE ", text)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"<[^>]+>|\{[^}]*\}|[*_#>]{1,}|\\", " ", text)


def pieces(page: str) -> list[str]:
    """Paragraphs, list items and table cells of a page, without code blocks."""
    page = re.sub(r"^( *)```.*?^\1```", "", page, flags=re.S | re.M)
    out: list[str] = []
    for block in re.split(r"\n\s*\n|\n(?=\s*[-*] |\s*\d+\. |\||#)", page):
        if re.match(r"\s*\|", block):
            out += [
                c for row in block.splitlines() if not re.match(r"[\s|:-]+$", row) for c in re.split(r"(?<!\\)\|", row)
            ]
        elif block.startswith("    "):
            continue
        else:
            out.append(" ".join(block.split()))
    return [p for p in (_plain(o).strip() for o in out) if p]


def sentences(piece: str) -> list[str]:
    """The sentences of a piece; periods inside of numbers and abbreviations end none."""
    safe = re.sub(r"\b(e\.g|i\.e|al|Fig|fig|no|vs|pp|p|Eq|eq|max|min)\.", r"\1", piece)
    return [s.strip() for s in re.split(r"(?<=[.!?:;])[\")]?\s+", safe) if s.strip()]


def words(sentence: str) -> list[str]:
    """The words of a sentence that are no names, in lower case."""
    out = []
    for k, token in enumerate(re.split(r"[\s/–—-]+", sentence)):
        found = _WORD.match(token.lstrip("\"'([*"))
        if found and (found[0].islower() or (k == 0 and found[0][1:].islower())):
            out.append(found[0].lower().replace("’", "'").rstrip("'"))
    return [w for w in out if len(w) > 2 and w not in _UNITS]


@cache
def glossary() -> tuple[str, ...]:
    """The terms of docs/glossary.md; what stands in brackets is another name of the same term."""
    rows = re.findall(r"^\| (.*?) \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.M)
    return tuple(t for row in rows if row not in ("term", "---") for t in re.split(r", (?![^(]*\))", _plain(row)))


def family(word: str) -> str:
    """What a word has in common with its inflections and derivations: emulates, emulated, emulator, emulation."""
    while ending := _INFLECTION.search(word) or _DERIVATION.search(word):
        word = word[: ending.start()]
    return word[:-1] if len(word) > 3 and word[-1] == word[-2] else word


@cache
def _frequent() -> list[str]:
    """English words in the order of their frequency."""
    from wordfreq import top_n_list

    return [word for word in top_n_list("en", 10 * FREQUENT) if word.isalpha()]


@cache
def known() -> frozenset[str]:
    """Families of frequent words and of the words of the glossary."""
    families: dict[str, None] = {}
    for word in _frequent():
        if len(families) < FREQUENT:
            families[family(word)] = None
    return frozenset({*families, *(family(w) for term in glossary() for w in re.findall(r"[a-z]+", term.lower()))})


@cache
def rare(word: str) -> bool:
    """Whether a word is neither of a frequent family nor of the glossary."""
    return not {family(word), *(family(word.removeprefix(p)) for p in ("un", "re", "non", "mis"))} & known()


@dataclass(frozen=True)
class Measure:
    """What was counted in a text."""

    total: int
    sentences: tuple[str, ...]
    words: tuple[str, ...]

    @property
    def mean(self) -> float:
        """Words of a sentence on average."""
        return sum(len(s.split()) for s in self.sentences) / max(1, len(self.sentences))

    @property
    def rare(self) -> list[str]:
        """Rare words, as often as they stand there."""
        return [w for w in self.words if rare(w)]


def measure(page: str) -> Measure:
    """Count a text in Markdown."""
    found = [s for piece in pieces(page) for s in sentences(piece)]
    return Measure(
        len(page.split()),
        tuple(s for s in found if len(s.split()) >= _SHORTEST),
        tuple(w for s in found for w in words(s)),
    )


@cache
def pages() -> dict[str, str]:
    """README and the pages of docs."""
    docs = ROOT / "docs"
    found = [
        p for p in sorted(docs.rglob("*.md")) if p.name != "bibliography.md" and docs / "reference" not in p.parents
    ]
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in [ROOT / "README.md", *found]}


@cache
def texts() -> dict[str, str]:
    """The pages and, as one text, the messages of bad input."""
    out, docs = dict(pages()), ROOT / "docs"
    sys.path.insert(0, str(docs))
    made = runpy.run_path(str(docs / "reference_pages.py"))["messages"]()
    said = [re.sub(r"\.\.\.", " CODE ", line[2:].strip("` ")) for line in made if line.startswith("- ")]
    out["messages"] = "\n\n".join(said)
    return out


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.readability", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--words", metavar="PAGE", help="rare words of a page ('all' of all)")
    parser.add_argument("--sentences", metavar="PAGE", help="the ten longest sentences of a page")
    given = parser.parse_args()
    found = {name: measure(text) for name, text in texts().items()}
    if given.words:
        chosen = found.values() if given.words == "all" else [found[given.words]]
        print(", ".join(f"{w} {n}" for w, n in Counter(w for m in chosen for w in m.rare).most_common()))
        return 0
    if given.sentences:
        for s in sorted(found[given.sentences].sentences, key=lambda s: -len(s.split()))[:10]:
            print(len(s.split()), s, sep="  ")
        return 0
    bad = 0
    print(f"{'page':40} {'words':>6} {'sentence':>9} {'rare':>7}")
    for name, m in found.items():
        wrong = m.mean > MEAN_SENTENCE or (m.total > MOST_WORDS and name != "messages")
        bad += wrong
        print(f"{name:40} {m.total:6d} {m.mean:9.1f} {len(m.rare) / max(1, len(m.words)):7.1%}{'  !' if wrong else ''}")
    every = [w for m in found.values() for w in m.words]
    share = sum(map(rare, every)) / len(every)
    listed = {*_frequent()[:FREQUENT], *(w for term in glossary() for w in re.findall(r"[a-z]+", term.lower()))}
    forms = sum(word not in listed for word in every) / len(every)
    print(f"{len(every)} words, {share:.2%} rare (at most {RARE_SHARE:.0%}); glossary: {len(glossary())} terms")
    print(f"with every inflection and derivation as a word of its own: {forms:.1%} rare")
    return int(bad > 0 or share > RARE_SHARE or len(glossary()) > MOST_TERMS)


if __name__ == "__main__":
    raise SystemExit(main())
