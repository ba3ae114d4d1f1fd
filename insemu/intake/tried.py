"""Commands that a card gives, each applied to the files before it is printed: one whose card is not clean is not given."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from insemu.errors import InputError
from insemu.formats import Opened, parse_map, write
from insemu.formats.opened import open_files
from insemu.intake.card import Card, Line

#: Most settings that are put together, one after the other.
MOST = 5
#: Topics in the order in which they are believed: what the fixes are comes before what they say of the IMU.
ORDER = (
    "rate",
    "reference",
    "fixes",
    "velocity",
    "heights",
    "clock",
    "specific force",
    "motion",
    "angular rate",
    "axes",
    "columns",
    "order of rows",
)
#: Topics of which an odd finding leaves no reading right.
CONTRADICT = ("fixes", "velocity", "heights", "specific force", "motion", "angular rate", "columns", "order of rows")


def settings_of(line: Line) -> dict[str, str]:
    """Settings that a line asks for; none where it asks for something else."""
    text = line.mend.removeprefix('--map "')
    return dict(parse_map(text.rstrip('"')).settings) if text != line.mend else {}


def tried(data: Opened, examined: Callable[[Opened], Card]) -> Card:
    """The card with the commands that make it clean, and no others.

    Parameters
    ----------
    data : Opened
    examined : callable
        Makes the card of what was opened.
    """
    card = examined(data)
    asking = [line for line in card.lines if line.level in ("odd", "wrong") and settings_of(line)]
    if not asking:
        return card
    with tempfile.TemporaryDirectory() as folder:
        again = data.again
        if again is None:
            again = open_files(write(Path(folder) / "recording.npz", data.recording())).again
        assert again is not None
        refused = [line for line in asking if line.level == "wrong"]
        given: dict[int, str] = {}
        if refused:  # all of them together, by what is asked for after each
            settings: dict[str, str] | None = {}
            after: Card | None = card
            for _ in range(MOST):
                wrong = sorted(after.of("wrong"), key=_rank) if after is not None else []
                asked = next((s for line in wrong if (s := settings_of(line))), {})
                if not wrong or not asked or asked.items() <= (settings or {}).items():
                    break
                settings = {**(settings or {}), **asked}
                after = _card(again.read, settings, examined)
            if after is not None and _clean(after):
                first = min(card.of("wrong"), key=_rank)
                given[id(first)] = again.options(settings or {})
        else:
            for line in asking:
                after = _card(again.read, settings_of(line), examined)
                if after is not None and not any(x.topic in ORDER and x.level in ("odd", "wrong") for x in after.lines):
                    given[id(line)] = again.options(settings_of(line))
    return replace(
        card, lines=tuple(replace(x, mend=given.get(id(x), "")) if settings_of(x) else x for x in card.lines)
    )


def _clean(card: Card) -> bool:
    """Whether nothing is left that contradicts another thing; the mounting and what was lost are no contradiction."""
    return not card.of("wrong") and not any(x.topic in CONTRADICT for x in card.of("odd"))


def _rank(line: Line) -> int:
    return ORDER.index(line.topic) if line.topic in ORDER else len(ORDER)


def _card(
    read: Callable[[dict[str, str]], Opened], settings: dict[str, str], examined: Callable[[Opened], Card]
) -> Card | None:
    """The card with settings; None where the files cannot be read so."""
    try:
        return examined(read(settings))
    except InputError:
        return None
