"""What one test of consistency says: a value, its bounds, a word and a sentence.

Of many samples bounds become narrower than anything that a decision turns on. So a difference up to :data:`MEAN_SQUARE` is
said as certain and small, and counts as consistent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

Word = Literal["consistent", "overconfident", "pessimistic", "correlated"]
#: Relative difference of NEES and NIS per degree of freedom from 1 that moves no decision: sigmas that are 1 % too large or too small.
MEAN_SQUARE = 0.02
#: What a word means of the errors of a filter, and of its innovations, which say nothing of errors that no fix sees.
_OF_ERRORS = {
    "consistent": "the filter knows its error",
    "overconfident": "the filter is surer than it should be",
    "pessimistic": "the filter is less sure than it could be",
}
_OF_INNOVATIONS = {
    "consistent": "the filter knows how far it is from the next fix, which says nothing of what no fix sees",
    "overconfident": "innovations are larger than the filter states",
    "pessimistic": "innovations are smaller than the filter states",
}
_OF_COLOUR = {
    "consistent": "innovations are white",
    "correlated": "innovations are not white: the model is incomplete",
}


@dataclass(frozen=True)
class Verdict:
    """One test: what was found, where it had to lie, and what that means.

    Parameters
    ----------
    test, subject : str
        For example ``NEES`` and ``position at 480 s``.
    value, low, high : float
        The statistic and its bounds.
    confidence : float
        Of the family that the test belongs to.
    count : int
        Samples behind the statistic.
    word : str
        ``consistent``; ``overconfident`` (errors larger than the filter says); ``pessimistic`` (smaller); ``correlated`` (innovations not white).
    size : float
        Difference from what is expected that moves no decision: up to it the word is ``consistent`` whatever the bounds are. Zero: none.
    """

    test: str
    subject: str
    value: float
    low: float
    high: float
    confidence: float
    count: int
    word: Word
    size: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the value lies in its bounds, or so near to what is expected that no decision moves."""
        return self.word == "consistent"

    def __str__(self) -> str:
        meant = {"NIS/dof": _OF_INNOVATIONS, "whiteness": _OF_COLOUR}.get(self.test, _OF_ERRORS)[self.word]
        if self.passed and not self.low <= self.value <= self.high:
            meant = f"the difference is certain, but smaller than what moves a decision ({100 * self.size:g} %)"
        return (
            f"{self.test} of {self.subject}: {self.value:.4g}, expected {self.low:.4g} to {self.high:.4g} "
            f"({100 * self.confidence:g} %, {self.count} samples): {self.word}, {meant}"
        )


class Expected(NamedTuple):
    """What a right filter gives: a value, the difference from it that moves no decision, and words below and above the bounds."""

    value: float = 1.0
    size: float = MEAN_SQUARE
    words: tuple[Word, Word] = ("pessimistic", "overconfident")


def judged(
    test: str,
    subject: str,
    value: float,
    bounds: tuple[float, float],
    confidence: float,
    count: int,
    expected: Expected = Expected(),  # noqa: B008 - immutable
) -> Verdict:
    """The verdict on a value.

    Parameters
    ----------
    test, subject, value, confidence, count
        As in :class:`Verdict`.
    bounds : (low, high)
    expected : Expected
    """
    low, high = bounds
    inside = low <= value <= high or abs(value - expected.value) <= expected.size
    word: Word = "consistent" if inside else expected.words[0] if value < low else expected.words[1]
    return Verdict(test, subject, value, low, high, confidence, count, word, expected.size)
