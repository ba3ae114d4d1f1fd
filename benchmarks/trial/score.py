"""Scores of a blind trial: one list of named shares with exact intervals, and tables of confusion, calibration and power."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import scipy  # whose parts are imported when they are used

from benchmarks.trial.hidden import Hidden
from benchmarks.trial.run import Said, Trial

#: Edges of the bins of confidence and of expected evidence.
CONFIDENCE = (0.0, 0.5, 0.8, 0.95, 0.99, 1.01)
NATS = (0.0, 5.0, 10.0, 20.0, 40.0, 100.0, math.inf)
#: An effect that is worth this many nats is plain.
PLAIN_NATS = 20.0
#: Least gain per fix of the oracle that an answer's gain is held against, nats.
LEAST_ORACLE = 0.02


def same(hidden: Hidden, effect: str, sensor: str, axes: Sequence[str], *, axis: bool = True) -> bool:
    """Whether an answer names a hidden effect: effect, sensor and (where it has any) the axes.

    Parameters
    ----------
    hidden : Hidden
        What was hidden.
    effect, sensor : str
        What the answer names.
    axes : sequence of str
        Axes that the answer names.
    axis : bool
        Whether the axes count.
    """
    if hidden.effect != effect or hidden.sensor != sensor:
        return False
    return not axis or not hidden.axes or set(axes) == set(hidden.axes)


def interval(k: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson)."""
    low = float(scipy.stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(scipy.stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


@dataclass(frozen=True)
class Score:
    """A share that a trial counted.

    Parameters
    ----------
    name, label : str
        For files and for people.
    count, of : int
    better : {"more", "fewer", ""}
        Which way is better; empty where neither is.
    """

    name: str
    label: str
    count: int
    of: int
    better: str

    @property
    def interval(self) -> tuple[float, float]:
        """Exact 95 % interval of the share."""
        return interval(self.count, self.of) if self.of else (0.0, 1.0)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        low, high = self.interval
        return {"count": self.count, "of": self.of, "low": low, "high": high}


def _clean(t: Trial) -> bool:
    return not t.hidden and not t.outside


def _single(t: Trial) -> bool:
    return len(t.hidden) == 1 and not t.outside


def _several(t: Trial) -> bool:
    return len(t.hidden) > 1


def _strong(t: Trial) -> bool:
    return _single(t) and t.hidden[0].nats >= PLAIN_NATS


def _each(t: Trial) -> bool:
    return _several(t) and not any(h.nats < PLAIN_NATS for h in t.hidden)


def _beside(t: Trial) -> bool:
    return _each(t) and not any(h.beside < PLAIN_NATS for h in t.hidden)


def _named(t: Trial) -> bool:
    return _single(t) and t.verdict == "named"


def _classed(t: Trial) -> bool:
    return _single(t) and t.verdict == "class"


def _outside(t: Trial) -> bool:
    return bool(t.outside)


def _spoke(t: Trial) -> bool:
    return bool(t.steps) or t.verdict == "unexplained"


def _unexplained(t: Trial) -> bool:
    return t.verdict == "unexplained"


def _as_equation(t: Trial) -> bool:
    """Whether an equation leads, which names nothing of the catalogue."""
    return bool(t.steps) and t.steps[0].effect == "expression"


def _strange(t: Trial) -> bool:
    return _unexplained(t) or _as_equation(t)


def _misnamed(t: Trial) -> bool:
    return t.verdict == "named" and not _as_equation(t)


def _first_right(t: Trial) -> bool:
    s = t.steps[0]
    return same(t.hidden[0], s.effect, s.sensor, s.axes)


def _first_effect(t: Trial) -> bool:
    s = t.steps[0]
    return same(t.hidden[0], s.effect, s.sensor, s.axes, axis=False)


def _inside(h: Hidden, s: Said) -> bool:
    return any(same(h, *m) for m in s.members)


def _top_two(t: Trial) -> bool:
    """Whether the hidden effect is the first or second of the first step's candidates."""
    if not t.steps:
        return False
    s = t.steps[0]
    order = [s.effect, *(m[0] for m in s.members[1:]), *s.runners_up]
    return t.hidden[0].effect in order[:2]


def _all_and_only(t: Trial) -> bool:
    """Whether as many effects are said as are hidden, and each of those is named."""
    return len(t.steps) == len(t.hidden) and all(
        any(same(h, s.effect, s.sensor, s.axes) for s in t.steps) for h in t.hidden
    )


def _all_in_classes(t: Trial) -> bool:
    return len(t.steps) == len(t.hidden) and all(any(_inside(h, s) for s in t.steps) for h in t.hidden)


def _right_and_held_out(t: Trial) -> bool:
    return _named(t) and _first_right(t) and math.isfinite(t.gap_after[0])


Tally = Callable[[Trial], tuple[int, int]]


def _share(of: Callable[[Trial], bool], right: Callable[[Trial], bool]) -> Tally:
    return lambda t: (int(right(t)), 1) if of(t) else (0, 0)


def _covered(t: Trial) -> tuple[int, int]:
    """Parameters of rightly named effects whose interval holds the truth, and how many have one and a truth."""
    hits = [
        low <= true <= high
        for h in t.hidden
        for s in t.steps
        if not t.outside and t.verdict != "unexplained" and same(h, s.effect, s.sensor, s.axes)
        for name, _, low, high in s.values
        if low < high and (true := h.true(name, s.axes)) is not None
    ]
    return sum(hits), len(hits)


@dataclass(frozen=True)
class Definition:
    """How a score is counted: of a recording, how many of how many."""

    name: str
    label: str
    tally: Tally
    better: Literal["more", "fewer", ""] = "more"


#: Every score. Several hidden effects are scored in every recording, where each alone is worth 20 nats or more, and where each is worth that
#: beside the others; an effect of which the trial has no measure counts as worth it. A recording is detected where anything was said at all (a
#: step, or "unexplained"); "unexplained" names nothing, so it never counts as right.
DEFINITIONS = (
    Definition("false_alarms", "nothing hidden: flagged", _share(_clean, _spoke), "fewer"),
    Definition("falsely_named", "nothing hidden: named", _share(_clean, lambda t: t.verdict == "named" and not _as_equation(t)), "fewer"),
    Definition("detected", "one hidden: detected", _share(_single, _spoke)),
    Definition("named_right", "named alone: right (effect and axis)", _share(_named, _first_right)),
    Definition("effect_right", "named alone: right effect", _share(_named, _first_effect)),
    Definition("in_class", "given a class: truth inside", _share(_classed, lambda t: _inside(t.hidden[0], t.steps[0]))),
    Definition("unexplained", "one hidden: said to be unexplained", _share(_single, _unexplained), ""),
    Definition("strong_detected", "20 expected nats or more: detected", _share(_strong, _spoke)),
    Definition("strong_named", "20 expected nats or more: named right", _share(_strong, lambda t: _named(t) and _first_right(t))),
    Definition("strong_top_two", "20 expected nats or more: in the top two", _share(_strong, _top_two)),
    Definition("every_and_only", "several hidden, any strength: all and only these named", _share(_several, _all_and_only)),
    Definition("every_in_class", "several hidden, any strength: the same, classes counted", _share(_several, _all_in_classes)),
    Definition("both_and_only", "several hidden, each worth 20 nats: all and only these named", _share(_each, _all_and_only)),
    Definition("both_in_class", "several hidden, each worth 20 nats: the same, classes counted", _share(_each, _all_in_classes)),
    Definition(
        "beside_and_only", "several hidden, each worth 20 nats beside the others: all and only these named", _share(_beside, _all_and_only)
    ),
    Definition(
        "beside_in_class", "several hidden, each worth 20 nats beside the others: the same, classes counted", _share(_beside, _all_in_classes)
    ),
    Definition("misnamed_outside", "outside the catalogue: misnamed", _share(_outside, _misnamed), "fewer"),
    Definition("outside_unexplained", "outside the catalogue: an equation, or unexplained", _share(_outside, _strange)),
    Definition(
        "gap_contains_one", "named right: gap index after contains 1",
        _share(_right_and_held_out, lambda t: t.gap_after[1] <= 1.0 <= t.gap_after[2]),
    ),
    Definition("covered", "parameters of named effects: 95 % interval holds the truth", _covered),
)  # fmt: skip


def score_trials(trials: Sequence[Trial]) -> dict[str, Score]:
    """Every score of :data:`DEFINITIONS`, by name."""
    out = {}
    for d in DEFINITIONS:
        counts = [d.tally(t) for t in trials]
        out[d.name] = Score(d.name, d.label, sum(k for k, _ in counts), sum(n for _, n in counts), d.better)
    return out


def mean_class_size(trials: Sequence[Trial]) -> float:
    """How many effects a class holds, on average; NaN without any."""
    sizes = [len(t.steps[0].members) for t in trials if _classed(t)]
    return float(np.mean(sizes)) if sizes else math.nan


def held_out_ratio(trials: Sequence[Trial]) -> tuple[float, int]:
    """Median of the held-out gain over the oracle's, and of how many."""
    ratios = [
        t.held_out / t.oracle for t in trials if t.steps and math.isfinite(t.held_out) and t.oracle > LEAST_ORACLE
    ]
    return (float(np.median(ratios)) if ratios else math.nan), len(ratios)


def confusion(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    """What was said first where none or one was hidden: hidden to said to count."""
    out: dict[str, dict[str, int]] = {}
    for t in trials:
        if _several(t):
            continue
        answer = "unexplained" if _unexplained(t) else (t.steps[0].effect if t.steps else "nothing")
        row = out.setdefault(t.outside or (t.hidden[0].effect if t.hidden else "none"), {})
        row[answer] = row.get(answer, 0) + 1
    return out


def calibration(trials: Sequence[Trial]) -> list[tuple[float, float, int]]:
    """Mean stated confidence, share of right first names and their number, by bins of confidence."""
    answered = [t for t in trials if _single(t) and t.steps and not _unexplained(t)]
    out = []
    for low, high in pairwise(CONFIDENCE):
        if inside := [t for t in answered if low <= t.steps[0].confidence < high]:
            stated = float(np.mean([t.steps[0].confidence for t in inside]))
            out.append((stated, float(np.mean([_first_right(t) for t in inside])), len(inside)))
    return out


def power(trials: Sequence[Trial]) -> list[tuple[float, float, int, int, int]]:
    """Low and high edge in expected nats, detected, in the top two, and how many."""
    out = []
    for low, high in pairwise(NATS):
        if inside := [t for t in trials if _single(t) and low <= t.hidden[0].nats < high]:
            out.append((low, high, sum(map(_spoke, inside)), sum(map(_top_two, inside)), len(inside)))
    return out


def for_20_nats(trials: Sequence[Trial]) -> dict[str, tuple[float, int]]:
    """Median strength, in datasheet scales, that is worth 20 nats, by effect and sensor."""
    needed: dict[str, list[float]] = {}
    for h in (h for t in trials for h in t.hidden if math.isfinite(h.scales_for_20)):
        needed.setdefault(f"{h.effect} ({h.sensor})", []).append(h.scales_for_20)
    return {name: (float(np.median(v)), len(v)) for name, v in sorted(needed.items())}
