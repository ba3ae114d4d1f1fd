"""Scores of a blind trial: shares with their exact intervals, confusion, calibration, power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from insemu.trial.drives import Hidden
from insemu.trial.run import Said, Trial

#: Edges of the bins of confidence and of expected evidence.
CONFIDENCE = (0.0, 0.5, 0.8, 0.95, 0.99, 1.01)
NATS = (0.0, 5.0, 10.0, 20.0, 40.0, 100.0, math.inf)
Share = tuple[int, int]


def same(hidden: Hidden, effect: str, sensor: str, axes: Sequence[str], *, axis: bool = True) -> bool:
    """Whether an answer names a hidden effect: effect, sensor and (where it has any) the axes."""
    if hidden.effect != effect or hidden.sensor != sensor:
        return False
    return not axis or not hidden.axes or set(axes) == set(hidden.axes)


@dataclass(frozen=True)
class Scores:
    """What the trial says, as shares ``(count, of)``.

    Several hidden effects are scored in every recording (``every``), where each alone is worth 20 nats or more (``both``), and where each is worth
    that beside the others (``beside``); an effect of which the trial has no measure counts as worth it. A recording is detected where
    anything was said at all (a step, or "unexplained"); "unexplained" names nothing, so it never counts as right.
    """

    recordings: int
    false_alarms: Share
    falsely_named: Share
    detected: Share
    named_right: Share
    effect_right: Share
    in_class: Share
    mean_class_size: float
    unexplained: Share
    strong_detected: Share
    strong_top_two: Share
    both_and_only: Share
    both_in_class: Share
    every_and_only: Share
    every_in_class: Share
    beside_and_only: Share
    beside_in_class: Share
    misnamed_outside: Share
    outside_unexplained: Share
    gap_contains_one: Share
    held_out_ratio: float
    held_out_count: int
    confusion: dict[str, dict[str, int]]
    calibration: list[tuple[float, float, int]]
    by_nats: list[tuple[float, float, int, int, int]]
    for_20_nats: dict[str, tuple[float, int]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def score_trials(trials: Sequence[Trial]) -> Scores:
    """Score a trial."""
    clean = [t for t in trials if not t.hidden and not t.outside]
    single = [t for t in trials if len(t.hidden) == 1 and not t.outside]
    every = [t for t in trials if len(t.hidden) > 1]
    many = [t for t in every if not any(h.nats < 20.0 for h in t.hidden)]
    beside = [t for t in every if not any(h.nats < 20.0 or h.beside < 20.0 for h in t.hidden)]
    outside = [t for t in trials if t.outside]

    def first_right(t: Trial, axis: bool = True) -> bool:
        s = t.steps[0]
        return same(t.hidden[0], s.effect, s.sensor, s.axes, axis=axis)

    def inside(h: Hidden, s: Said) -> bool:
        return any(same(h, *m) for m in s.members)

    named = [t for t in single if t.verdict == "named"]
    classes = [t for t in single if t.verdict == "class"]
    strong = [t for t in single if t.hidden[0].nats >= 20.0]
    confusion: dict[str, dict[str, int]] = {}
    for t in trials:
        word = t.outside or ("+".join(sorted(h.effect for h in t.hidden)) if t.hidden else "none")
        if len(t.hidden) > 1:
            continue
        answer = "unexplained" if t.verdict == "unexplained" else (t.steps[0].effect if t.steps else "nothing")
        row = confusion.setdefault(word, {})
        row[answer] = row.get(answer, 0) + 1
    calibration = []
    answered = [t for t in single if t.steps and t.verdict != "unexplained"]
    for low, high in pairwise(CONFIDENCE):
        bin_ = [t for t in answered if low <= t.steps[0].confidence < high]
        if bin_:
            stated = float(np.mean([t.steps[0].confidence for t in bin_]))
            calibration.append((stated, float(np.mean([first_right(t) for t in bin_])), len(bin_)))
    by_nats = []
    for low, high in pairwise(NATS):
        bin_ = [t for t in single if low <= t.hidden[0].nats < high]
        if bin_:
            by_nats.append((low, high, sum(_spoke(t) for t in bin_), sum(_top_two(t) for t in bin_), len(bin_)))
    right = [t for t in named if first_right(t) and math.isfinite(t.gap_after[0])]
    ratios = [t.held_out / t.oracle for t in trials if t.steps and math.isfinite(t.held_out) and t.oracle > 0.02]
    needed: dict[str, list[float]] = {}
    for t in trials:
        for h in t.hidden:
            if math.isfinite(h.scales_for_20):
                needed.setdefault(f"{h.effect} ({h.sensor})", []).append(h.scales_for_20)

    def exact(t: Trial, by_class: bool) -> bool:
        if len(t.steps) != len(t.hidden):
            return False
        return all(
            any((inside(h, s) if by_class else same(h, s.effect, s.sensor, s.axes)) for s in t.steps) for h in t.hidden
        )

    return Scores(
        len(trials),
        (sum(_spoke(t) for t in clean), len(clean)),
        (sum(t.verdict == "named" for t in clean), len(clean)),
        (sum(_spoke(t) for t in single), len(single)),
        (sum(first_right(t) for t in named), len(named)),
        (sum(first_right(t, False) for t in named), len(named)),
        (sum(inside(t.hidden[0], t.steps[0]) for t in classes), len(classes)),
        float(np.mean([len(t.steps[0].members) for t in classes])) if classes else math.nan,
        (sum(t.verdict == "unexplained" for t in single), len(single)),
        (sum(_spoke(t) for t in strong), len(strong)),
        (sum(_top_two(t) for t in strong), len(strong)),
        (sum(exact(t, False) for t in many), len(many)),
        (sum(exact(t, True) for t in many), len(many)),
        (sum(exact(t, False) for t in every), len(every)),
        (sum(exact(t, True) for t in every), len(every)),
        (sum(exact(t, False) for t in beside), len(beside)),
        (sum(exact(t, True) for t in beside), len(beside)),
        (sum(t.verdict == "named" for t in outside), len(outside)),
        (sum(t.verdict == "unexplained" for t in outside), len(outside)),
        (sum(t.gap_after[1] <= 1.0 <= t.gap_after[2] for t in right), len(right)),
        float(np.median(ratios)) if ratios else math.nan,
        len(ratios),
        confusion,
        calibration,
        by_nats,
        {name: (float(np.median(v)), len(v)) for name, v in sorted(needed.items())},
    )


def _spoke(t: Trial) -> bool:
    return bool(t.steps) or t.verdict == "unexplained"


def _top_two(t: Trial) -> bool:
    """Whether the hidden effect is the first or second of the first step's candidates."""
    if not t.steps:
        return False
    s = t.steps[0]
    order = [s.effect, *(m[0] for m in s.members[1:]), *s.runners_up]
    return t.hidden[0].effect in order[:2]


def interval(k: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson)."""
    from scipy import stats

    low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high
