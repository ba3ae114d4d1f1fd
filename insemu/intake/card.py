"""The intake card: what a file was taken for, each finding with its evidence and, where something is wrong, the command that mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

from insemu.errors import InputError

#: ok: checked and found right; assumed: nobody said and nothing contradicts; odd: worth a look; wrong: contradicts physics.
Level = Literal["ok", "assumed", "odd", "wrong"]
MARKS = {"ok": " ", "assumed": "~", "odd": "?", "wrong": "!"}

#: Behind every refusal: the way past it.
PAST = ". A recording that is right all the same is taken with the setting contradictions=accepted"


@dataclass(frozen=True)
class Line:
    """One finding.

    Parameters
    ----------
    topic : str
        One word or two: "rate", "units", "axes".
    level : Level
    text : str
        The finding with its evidence.
    mend : str
        What to add to the command (``--map "gyro_unit=deg/s"``), or what else to do; "" where nothing is to be mended.
    """

    topic: str
    level: Level
    text: str
    mend: str = ""

    def __str__(self) -> str:
        return f"{MARKS[self.level]} {self.topic}: {self.text}" + (f". Correction: {self.mend}" if self.mend else "")


@dataclass(frozen=True)
class Card:
    """All findings about one source."""

    source: str
    kind: str
    lines: tuple[Line, ...]

    def of(self, level: Level) -> tuple[Line, ...]:
        """Lines of a level."""
        return tuple(line for line in self.lines if line.level == level)

    def check(self) -> Card:
        """Return the card where nothing contradicts physics.

        Raises
        ------
        InputError
            Something does; the message holds every such finding and the command that mends it.
        """
        wrong = self.of("wrong")
        if wrong:
            said = "; ".join(
                f"{w.topic}: {w.text}" + (f". Correction: {self.command(w)}" if w.mend else "") for w in wrong
            )
            raise InputError(f"{said}{PAST}", where=self.source)
        return self

    def command(self, line: Line) -> str:
        """The command that mends a finding."""
        if not line.mend.startswith("--"):
            return line.mend
        return f"insemu open {self.source.split(', ')[0]} {line.mend} -o corrected.npz"

    def accepted(self) -> Card:
        """The card of a recording that was declared right: what contradicts physics is worth a look."""
        lines = (
            replace(x, level="odd", text=f"{x.text} (accepted as declared)", mend="") if x.level == "wrong" else x
            for x in self.lines
        )
        return replace(self, lines=tuple(lines))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader of results has to know: what was assumed, and what is worth a look."""
        return tuple(f"{x.topic}: {x.text}" for x in self.lines if x.level != "ok")

    def text(self, levels: Iterable[Level] = ("ok", "assumed", "odd", "wrong")) -> str:
        """The card as lines of text."""
        wanted = set(levels)
        head = f"{self.source}: {self.kind}"
        return "\n".join([head, *(f"  {line}" for line in self.lines if line.level in wanted)])

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``summary.json`` and ``--json``."""
        lines = [{"topic": x.topic, "level": x.level, "text": x.text, "mend": x.mend} for x in self.lines]
        return {"source": self.source, "kind": self.kind, "lines": lines}
