"""Command line of the fuzzing: shares of a count, or as long as asked; finished batches are kept, so the same command goes on."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from insemu.work import Lines, processes, run_items
from tests.fuzz.watch import TARGETS, Batch, Outcome, run_batch

#: Shares of a count, of which the targets of a share get equal parts.
SHARES = {"scenario": 0.3, "readers": 0.4, "models": 0.2, "commands": 0.1}
_BATCH = 500


def _of(plain: dict[str, object]) -> Outcome:
    wrong = plain["wrong"]
    assert isinstance(wrong, list)
    return Outcome(int(str(plain["count"])), int(str(plain["refused"])), tuple((int(k), str(t)) for k, t in wrong))


def batches(names: list[str], count: int, seed: int) -> dict[str, Batch]:
    """Batches of all targets, a round of every target after the other."""
    members = Counter(TARGETS[n].share for n in names)
    whole = sum(SHARES[s] for s in members)
    made = []
    for name in names:
        share = TARGETS[name].share
        wanted = max(1, round(count * SHARES[share] / whole / members[share]))
        for first in range(0, wanted, _BATCH):
            made.append((first / wanted, Batch(name, seed, first, min(_BATCH, wanted - first))))
    return {f"{b.target}/{b.seed}/{b.first}/{b.count}": b for _, b in sorted(made, key=lambda m: m[0])}


def main() -> int:
    """Run from the command line; exit code 1 where anything went wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="inputs in all; with --only, of what is named")
    parser.add_argument("--minutes", type=float, help="end after so long, whatever the count")
    parser.add_argument(
        "--only", action="append", help="targets or shares by the beginning of their name; may be repeated"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--log", type=Path, default=Path("results/fuzz.jsonl"), help="finished batches, which are not run again"
    )
    parser.add_argument(
        "--input", metavar="TARGET:NUMBER", help="run this one input in this process, with its traceback"
    )
    given = parser.parse_args()
    if given.input:
        return _one(given.input, given.seed)
    names = [
        n
        for n, t in TARGETS.items()
        if not given.only or any(n.startswith(o) or t.share.startswith(o) for o in given.only)
    ]
    store = Lines(given.log, lambda o: {"count": o.count, "refused": o.refused, "wrong": o.wrong}, _of, "a batch")
    todo = batches(names, given.count, given.seed)
    end = time.monotonic() + given.minutes * 60 if given.minutes else float("inf")
    done: dict[str, Outcome] = {}
    keys = list(todo)
    with processes(given.workers) as pool:
        while keys and time.monotonic() < end:
            some, keys = keys[: 4 * given.workers], keys[4 * given.workers :]
            done |= run_items({k: todo[k] for k in some}, run_batch, pool=pool, store=store)
    return report(done, todo)


def _one(text: str, seed: int) -> int:
    import importlib
    import random
    import tempfile

    name, _, number = text.rpartition(":")
    target = TARGETS[name]
    with tempfile.TemporaryDirectory() as folder:
        one = importlib.import_module(f"tests.fuzz.{target.module}").prepare(target.what, Path(folder))
        one(random.Random(f"{seed}/{number}"))
    return 0


def report(done: dict[str, Outcome], todo: dict[str, Batch]) -> int:
    """Print what ran by target, and what went wrong; the exit code."""
    ran: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    wrong: dict[str, list[tuple[int, str]]] = {}
    for key, outcome in done.items():
        name = todo[key].target
        ran[name] += outcome.count
        refused[name] += outcome.refused
        wrong.setdefault(name, []).extend(outcome.wrong)
    for name, count in ran.items():
        print(f"{name:34s} {count:8d} inputs {refused[name]:8d} refused {len(wrong[name]):5d} wrong")
        seen: set[str] = set()
        for k, text in wrong[name]:
            if (kind := text[:60]) not in seen:
                seen.add(kind)
                print(f"    input {k}: {text}")
    total = sum(len(w) for w in wrong.values())
    print(f"{sum(ran.values())} inputs, {sum(refused.values())} refused in words, {total} wrong")
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
