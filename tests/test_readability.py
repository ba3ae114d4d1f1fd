"""The documents keep the limits of length and vocabulary that ``python -m tests.readability`` measures."""

from __future__ import annotations

import pytest

from tests import readability
from tests.readability import (
    MEAN_SENTENCE,
    MOST_TERMS,
    MOST_WORDS,
    RARE_SHARE,
    family,
    glossary,
    measure,
    pages,
    pieces,
    texts,
    words,
)


@pytest.mark.parametrize("page", [*pages(), "messages"])
def test_a_page_is_short_and_so_are_its_sentences(page: str) -> None:
    found = measure(texts()[page])
    assert found.mean <= MEAN_SENTENCE and (found.total <= MOST_WORDS or page == "messages")


def test_the_glossary_is_short() -> None:
    assert 100 <= len(glossary()) <= MOST_TERMS and len(set(glossary())) == len(glossary())


def test_few_words_are_rare() -> None:
    pytest.importorskip("wordfreq", reason="the list of frequent words is in the extra words")
    every = [w for text in texts().values() for w in measure(text).words]
    assert sum(map(readability.rare, every)) <= RARE_SHARE * len(every)


def test_code_links_and_names_are_no_words() -> None:
    page = "# Head\n\nThe `x y` of [a link](b.md) by Kalman takes 3 m.\n\n```\nprinted\n```\n| a cell | two |\n| --- | --- |\n"
    assert pieces(page) == ["Head", "The  CODE  of a link by Kalman takes 3 m.", "a cell", "two"]
    assert words("The CODE of a link by Kalman takes 3 m.") == ["the", "link", "takes"]
    found = measure("One short sentence has six words here. Two: three four five six seven; a b.")
    assert [len(s.split()) for s in found.sentences] == [7, 5]


def test_a_family_has_inflections_and_derivations() -> None:
    assert len({family(w) for w in ("emulate", "emulates", "emulated", "emulating", "emulation", "emulator")}) == 1
    assert family("fixes") == family("fix") and family("rate") != family("range")
