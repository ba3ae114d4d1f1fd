"""How well the scoreboard pins the policy: every constant times 1.5 and divided by 1.5, and what moves.

    python -m tests.policy_perturbation --workers 2 --log results/policy.jsonl           # stops at a constant's first moved answer
    python -m tests.policy_perturbation --full --log results/policy.jsonl                # every recording: scores beyond their bounds, too
    python -m tests.policy_perturbation --constant lead --constant keep_nats --limit 40

A constant concerns a recording only where the workflow reads it there, which is watched; other recordings are not looked at again. What is finished
stands in the log, so the command goes on where it was stopped, and ``--full`` builds on what is there.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from insemu.gap.policy import Policy, under
from insemu.scenario.files import code_version
from insemu.trial.run import Trial
from insemu.work import Lines, processes, run_items
from tests.scoreboard import Entry, beyond, gains_moved, read, sentences, table

FACTORS = (1.5, 1.0 / 1.5)
#: Recordings in which all constants that are not pinned yet are tried, before the next ones are.
AT_A_TIME = 6
#: What the worst of both factors moved, the strongest first.
LEVELS = ("a score beyond its bound", "an answer", "evidence", "nothing", "never read")


@dataclass(frozen=True, eq=False)
class Watched(Policy):
    """The usual policy, which notes what is read; the mark keeps one recording from another's cached thresholds."""

    mark: str = ""
    noted: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> Any:
        if name in _NAMES:
            Watched.noted.add(name)
        return super().__getattribute__(name)

    def __hash__(self) -> int:
        return hash(self.mark)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Watched) and other.mark == self.mark


_NAMES = frozenset(f.name for f in fields(Policy))


@cache
def _code() -> str:
    return code_version()[:12]


@dataclass(frozen=True)
class Look:
    """A recording under a policy with one constant moved; under the usual one where none is named."""

    entry: Entry
    constant: str = ""
    factor: float = 1.0

    @property
    def key(self) -> str:
        """Under which the answer is kept: the code belongs to it."""
        return " ".join((_code(), self.entry.name, self.entry.job.key, self.constant or "usual", f"{self.factor:.3f}"))


@dataclass(frozen=True)
class Seen:
    """An answer, and (of the usual policy) the constants that were read for it."""

    trial: Trial
    read: frozenset[str] = frozenset()

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"trial": self.trial.to_json(), "read": sorted(self.read)}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Seen:
        """Inverse of :meth:`to_json`."""
        return cls(Trial.from_json(plain["trial"]), frozenset(plain["read"]))

    def differs(self, usual: Seen) -> str:
        """Of :data:`LEVELS`: an answer, evidence or nothing."""
        if sentences(self.trial) != sentences(usual.trial):
            return LEVELS[1]
        a, b = ([s.gain_nats for s in x.trial.steps] for x in (usual, self))
        return LEVELS[2] if gains_moved(a, b) else LEVELS[3]


def look(item: Look) -> Seen:
    """Look at a recording; a policy under which the workflow fails has said something else."""
    job = item.entry.job
    usual = not item.constant
    Watched.noted.clear()
    try:
        with under(Watched(mark=item.entry.name) if usual else Policy().moved(item.constant, item.factor)):
            trial = item.entry.scored(job.run())
    except Exception as error:
        trial = Trial(job.kind, job.seed, (), job.outside, job.track, f"fails: {type(error).__name__}: {error}", ())
    return Seen(trial, frozenset(Watched.noted) if usual else frozenset())


def telling(entries: Sequence[Entry]) -> list[Entry]:
    """The recordings in the order in which they are tried: weak effects first, kinds in turns."""

    def weight(e: Entry) -> float:
        return min((g for g in e.gains), default=20.0)

    kinds = [sorted((e for e in entries if e.kind == kind), key=weight) for kind in ("rest", "drive", "flight")]
    places = [(k / max(len(some), 1), e) for some in kinds for k, e in enumerate(some)]
    return [e for _, e in sorted(places, key=lambda p: p[0])]


def pinned(
    entries: Sequence[Entry], constants: Iterable[str], *, workers: int, log: Path | None, full: bool
) -> dict[str, tuple[str, str]]:
    """What moves with each constant: the level, and where it was seen first.

    Parameters
    ----------
    entries : sequence of Entry
    constants : iterable of str
    workers : int
    log : path, optional
        Finished answers are kept there.
    full : bool
        Look at every recording instead of stopping at a constant's first moved answer.
    """
    store = Lines(log, Seen.to_json, Seen.from_json, "perturbed policies") if log is not None else None
    order = telling(entries)

    with processes(workers) as pool:

        def answers(looks: Sequence[Look]) -> dict[str, Seen]:
            return run_items({item.key: item for item in looks}, look, pool=pool, store=store)

        usual = dict(zip([e.name for e in order], answers([Look(e) for e in order]).values(), strict=True))
        seen: dict[tuple[str, float], dict[str, Seen]] = {(c, f): {} for c in constants for f in FACTORS}
        for start in range(0, len(order), AT_A_TIME):
            looks = [
                Look(e, c, f)
                for e in order[start : start + AT_A_TIME]
                for c, f in seen
                if c in usual[e.name].read
                and (full or not any(s.differs(usual[n]) == LEVELS[1] for g in FACTORS for n, s in seen[c, g].items()))
            ]
            for item, found in zip(looks, answers(looks).values(), strict=True):
                seen[item.constant, item.factor][item.entry.name] = found
            print(
                f"{min(start + AT_A_TIME, len(order))} of {len(order)} recordings, {len(looks)} looks", file=sys.stderr
            )
    return {c: _level(c, seen, usual, full) for c in dict.fromkeys(c for c, _ in seen)}


def _level(
    constant: str, seen: Mapping[tuple[str, float], Mapping[str, Seen]], usual: Mapping[str, Seen], full: bool
) -> tuple[str, str]:
    """The strongest of the levels that a constant reaches with either factor, and an example."""
    best, example = 4, ""
    before = {
        g: {n: (s.count, s.of) for n, s in rows.items()}
        for g, rows in table({n: s.trial for n, s in usual.items()}).items()
    }
    for factor in FACTORS:
        moved = seen[constant, factor]
        if full and moved:
            now = table({n: moved.get(n, s).trial for n, s in usual.items()})
            out = [f"{g}: {s.label} {before[g][n][0]} -> {s.count} of {s.of}" for g, rows in now.items() for n, s in rows.items()
                   if n in before[g] and beyond(n, before[g][n], s)]  # fmt: skip
            if out and best > 0:
                best, example = 0, f"x {factor:.2f}: {out[0]}"
        for name, found in moved.items():
            level = LEVELS.index(found.differs(usual[name]))
            if level < best:
                then, now_said = ("; ".join(sentences(x.trial)) for x in (usual[name], found))
                best, example = level, f"x {factor:.2f}: {name}" + (f": {then} -> {now_said}" if level == 1 else "")
    return LEVELS[best], example


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what moves with each constant, and the share of those that are pinned."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.policy_perturbation", description=__doc__.split("\n")[0] if __doc__ else None
    )
    parser.add_argument("--constant", action="append", help="constants to move; may be repeated. Default: all")
    parser.add_argument("--only", default="", metavar="TEXT", help="recordings whose name holds this")
    parser.add_argument("--limit", type=int, default=0, help="at most so many recordings, the most telling first")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--log", type=Path, help="keep answers in this file and go on from there")
    parser.add_argument("--full", action="store_true", help="look at every recording that a constant concerns")
    given = parser.parse_args(arguments)
    unknown = [c for c in given.constant or () if c not in _NAMES]
    if unknown:
        parser.error(f"no constant of the policy: {', '.join(unknown)}")
    entries = [e for e in read()[0] if given.only in e.name]
    if given.limit:
        entries = telling(entries)[: given.limit]
    found = pinned(
        entries,
        given.constant or [f.name for f in fields(Policy)],
        workers=given.workers,
        log=given.log,
        full=given.full,
    )
    for constant, (level, example) in sorted(found.items(), key=lambda item: LEVELS.index(item[1][0])):
        print(f"{constant:20s} {level:25s} {example}")
    counts = Counter(level for level, _ in found.values())
    moved = sum(counts[level] for level in LEVELS[:2])
    print(
        f"\n{len(found)} constants, {len(entries)} recordings: "
        + ", ".join(f"{level} {counts[level]}" for level in LEVELS if counts[level])
    )
    print(f"pinned by a score or an answer: {moved} of {len(found)} ({moved / max(len(found), 1):.0%})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
