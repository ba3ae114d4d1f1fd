"""Examples for the classifier among the baselines: recordings of the very generators that it is judged on, which no user could give it."""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from benchmarks.foreign.baselines import Signatures, Trained, features
from benchmarks.foreign.judge import KINDS, Job, drawn, taken
from insemu.gap.drive.preparation import Flown
from insemu.work import Lines, run_items

#: Of the recordings that it learns from, far from those that anything is judged on.
FIRST_SEED = 9_000_000


def example(job: Job) -> dict[str, Any]:
    """Features of a recording and what is hidden in it."""
    world, hidden, _ = drawn(job)
    measured, nominal = taken(world, hidden)
    flown = Flown.of(measured, nominal)
    seen = features(flown, nominal, Signatures.of(flown).ratios())
    return {"features": seen, "hidden": [[h.effect, h.sensor] for h in hidden]}


def learned(count: int, seconds: float, log: Path | None, pool: Executor | None) -> Trained:
    """Draw recordings of all kinds in turns and learn from them.

    Parameters
    ----------
    count : int
        Number of recordings.
    seconds : float
        Their length.
    log : Path, optional
        Keeps their features, and goes on from there.
    pool : Executor, optional
        For the recordings.
    """
    kinds = [kind for kind in KINDS if kind not in ("band", "outside")]
    jobs = [Job(kinds[k % len(kinds)], FIRST_SEED + k, seconds, True) for k in range(count)]
    store: Lines[dict[str, Any]] | None = None
    if log:
        store = Lines(log, lambda a: {"example": a}, lambda line: dict(line["example"]), "examples of a classifier")
    found = run_items({job.key: job for job in jobs}, example, pool=pool, store=store)
    return Trained.on([(x["features"], [(e, s) for e, s in x["hidden"]]) for x in found.values()])
