"""The one search: name the best effect, add it, weigh the earlier ones again next to it, until nothing is worth the threshold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol

from insemu.gap.hypothesis import C, Found, Hypothesis
from insemu.gap.policy import rules


@dataclass(frozen=True)
class Again(Generic[C]):
    """An effect that was found, weighed again next to all the others.

    Parameters
    ----------
    kept : Hypothesis
        The effect as it is worth now.
    ranked : tuple of Hypothesis
        Everything that could stand in its place, best first.
    rival : Hypothesis, optional
        The best of these that may take its place.
    idle : bool
        Whether nothing is needed there any more.
    rest : optional
        The model without it, where the problem has one at hand.
    """

    kept: Hypothesis[C]
    ranked: tuple[Hypothesis[C], ...]
    rival: Hypothesis[C] | None
    idle: bool
    rest: C | None = None


class Problem(Protocol[C]):
    """What the search needs of a log at rest or of a drive."""

    found: list[Found[C]]

    def rank(self) -> list[Hypothesis[C]]:
        """Every effect next to what was found, best first."""

    def choose(self, ranked: Sequence[Hypothesis[C]]) -> Found[C] | None:
        """What to add, or ``None`` where the search ends."""

    def apply(self, new: Found[C]) -> bool:
        """Change the model as a hypothesis says, and keep it among what was found; whether even it is to be weighed again at once."""

    def again(self, old: Found[C]) -> Again[C] | None:
        """An earlier finding next to all the others; ``None`` where it is not asked for again."""

    def put(self, old: Found[C], new: Hypothesis[C], again: Again[C]) -> None:
        """Let a hypothesis stand in the place of a finding.

        Parameters
        ----------
        old : Found
            The finding.
        new : Hypothesis
            What stands in its place: one of ``again.ranked``.
        again : Again
            The finding as it was weighed again.
        """

    def drop(self, old: Found[C], again: Again[C]) -> None:
        """Take a finding back."""


#: A search ends here: fast effects of a real log can be many.
MOST_EFFECTS = 12


def search(problem: Problem[C], say: Callable[[str], None]) -> None:
    """Find the effects of a problem; what is found and dropped in turns ends it too."""
    seen = {_names(problem)}
    for _ in range(MOST_EFFECTS):
        new = problem.choose(problem.rank())
        if new is None:
            break
        say(f"{new.chosen.effect} {new.chosen.nats:.1f} nats")
        if problem.apply(new) or len(problem.found) > 1:
            reconsider(problem)
        names = _names(problem)
        if names in seen:
            break
        seen.add(names)


def _names(problem: Problem[C]) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Effects, sensors and axes of what was found."""
    return tuple(sorted((f.chosen.effect, f.chosen.sensor, f.chosen.axes) for f in problem.found))


def reconsider(problem: Problem[C], lead: float | None = None) -> None:
    """Drop or replace each finding now that the others are known.

    Parameters
    ----------
    problem : Problem
    lead : float, optional
        By how much a rival must be better, nats; the policy's where it is not given, so that a search ends.
    """
    lead = rules().swap_nats if lead is None else lead
    for old in list(problem.found):
        again = problem.again(old)
        if again is None:
            continue
        if again.idle:
            problem.drop(old, again)
        elif again.rival is not None and again.rival.nats > again.kept.nats + lead:
            problem.put(old, again.rival, again)
        else:
            problem.put(old, again.kept, again)
