"""Names of columns in other languages, as the English words by which columns are known."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

#: English word -> words of other languages, without accents, in lower case; longer ones go first.
_WORDS = dict(
    line.split(" | ") for line in (Path(__file__).parent / "names.txt").read_text(encoding="utf-8").splitlines()
)
_ENGLISH = sorted(
    ((word.replace("_", " ").strip(), english) for english, words in _WORDS.items() for word in words.split()),
    key=lambda pair: -len(pair[0]),
)


def english(name: str) -> str:
    """The name with words of other languages turned into English; an English name stays as it is.

    >>> english("Drehrate X"), english("Vitesse angulaire z"), english("gyro_x")
    ('angular velocity X', 'angular velocity z', 'gyro_x')
    """
    plain = unicodedata.normalize("NFKD", name)
    plain = "".join(c for c in plain if not unicodedata.combining(c)).replace("ß", "ss").replace("ł", "l")
    low = plain.lower().replace("_", " ")
    for word, wanted in _ENGLISH:
        if word not in low:
            continue
        edge = r"(?<![a-z])" if word.isascii() else ""
        close = r"(?![a-z])" if word.isascii() else ""
        found = re.search(f"{edge}{re.escape(word)}{close}", low)
        if found is not None:
            return (
                f"{plain[: found.start()]}{wanted}{plain[found.end() :]}"
                if word.isascii()
                else f"{low[: found.start()]}{wanted} {low[found.end() :]}".strip()
            )
    return name
