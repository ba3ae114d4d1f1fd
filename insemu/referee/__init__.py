"""Any filter against the truth in a table of worlds: whether it states its own errors, and what would have been found."""

from insemu.referee.flights import Drift, Flights
from insemu.referee.judge import (
    FALSE_ALARM,
    GROUPS,
    POWER,
    Inconsistency,
    Judged,
    Judgement,
    judged,
    looked_at,
    referee,
)
from insemu.referee.worlds import World, starts, worlds

__all__ = [
    "FALSE_ALARM",
    "GROUPS",
    "POWER",
    "Drift",
    "Flights",
    "Inconsistency",
    "Judged",
    "Judgement",
    "World",
    "judged",
    "looked_at",
    "referee",
    "starts",
    "worlds",
]
