"""How well the policy is pinned: every constant times 1.5 and divided by 1.5, and the first answer of the scoreboard or test that moves with it.

    python -m tests.policy_perturbation --show                                     # what tests/policy_perturbation.yaml says
    python -m tests.policy_perturbation --log results/policy.jsonl --minutes 60    # go on with the constants that nothing pins yet
    python -m tests.policy_perturbation --again                                    # look again at what pins each constant

First every recording and every quick test of the gap is run once under a policy that notes which constants could decide otherwise there
(``tests/policy_probe.py``); only those are looked at again, weak effects first, until an answer moves. What is found is written to the
file as it is found, and finished answers stand in the log, so the command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import io
import math
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmarks.trial.run import Trial
from benchmarks.trial.score import score_trials
from insemu.gap.policy import Policy, under
from insemu.scenario.files import code_version
from insemu.work import Lines, processes, run_items
from tests.policy_probe import FACTORS, NAMES, Probe, Watched
from tests.scoreboard import Entry, gains_moved, read, sentences

FILE = Path(__file__).with_name("policy_perturbation.yaml")
HEAD = """# What moves with each constant of Policy: the first answer of the scoreboard, or quick test, that another value changes; else why it stays.
# Written by `python -m tests.policy_perturbation`, which prints the share that is pinned; a line with `stays` is written by hand.
"""
#: Files whose quick tests may pin a constant that the scoreboard does not.
TESTS = (
    "test_gap_policy_pins", "test_gap_drive_pins", "test_gap_static", "test_gap_dynamic", "test_gap_refined", "test_gap_map", "test_gap_trial",
    "test_gap_confusion", "test_gap_shaking",
)  # fmt: skip
#: Recordings in which all constants that are not pinned yet are tried, before the next ones are.
AT_A_TIME = 6
#: A recording that takes longer, s of one core, is not looked at again.
SLOW = 15.0


@dataclass(frozen=True)
class Look:
    """A recording or a file of tests under a policy with one constant moved; watched under the usual one where none is named."""

    name: str
    constant: str = ""
    factor: float = 1.0
    nodes: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Under which the answer is kept: the code belongs to it."""
        return " ".join((_code(), self.name, self.constant or "usual", f"{self.factor:.3f}"))


@dataclass(frozen=True)
class Seen:
    """What was said, the scores and the evidence; of the usual policy, which moves could say otherwise (in which tests)."""

    said: tuple[str, ...]
    scores: tuple[str, ...] = ()
    gains: tuple[float, ...] = ()
    seconds: float = 0.0
    could: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Seen:
        """Inverse of ``asdict``."""
        lists = (tuple(plain[k]) for k in ("said", "scores", "gains"))
        return cls(*lists, plain["seconds"], {m: tuple(nodes) for m, nodes in plain["could"].items()})

    @property
    def answer(self) -> tuple[tuple[str, ...], ...]:
        """What the scoreboard prints and scores."""
        return self.said, self.scores


def move(constant: str, factor: float) -> str:
    """A move of a constant as text."""
    return f"{constant} x {factor:.2f}"


@cache
def _code() -> str:
    return code_version()[:12]


@cache
def _entries() -> dict[str, Entry]:
    return {e.name: e for e in read()[0]}


def _scores(trial: Trial) -> tuple[str, ...]:
    return tuple(f"{name} {s.count} of {s.of}" for name, s in score_trials([trial]).items() if s.of and s.better)


def look(item: Look) -> Seen:
    """Look once; a policy under which the workflow fails has said something else."""
    started = time.process_time()
    chosen: Policy = Policy().moved(item.constant, item.factor) if item.constant else Watched(mark=item.name)
    if item.name.endswith(".py"):
        seen = _tested(item, chosen)
        return replace(seen, seconds=time.process_time() - started)
    entry = _entries()[item.name]
    Probe.noted.clear()
    try:
        with under(chosen):
            trial = entry.scored(entry.job.run())
    except Exception as error:
        if not item.constant:
            raise
        return Seen((f"fails: {type(error).__name__}: {error}",))
    could: dict[str, tuple[str, ...]] = {} if item.constant else {move(*m): () for m in Probe.noted}
    gains = tuple(float(s.gain_nats) for s in trial.steps)
    return Seen(sentences(trial), _scores(trial), gains, time.process_time() - started, could)


class _Under:
    """Runs tests under a policy, and notes what fails and what each test could decide otherwise."""

    def __init__(self, policy: Policy) -> None:
        self.policy, self.failed = policy, ""
        self.could: dict[str, tuple[str, ...]] = {}

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        Probe.noted.clear()
        with under(self.policy):
            yield
        for m in Probe.noted:
            self.could[move(*m)] = (*self.could.get(move(*m), ()), item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid


def _tested(item: Look, chosen: Policy) -> Seen:
    plugin = _Under(chosen)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        nodes = item.nodes or [str(FILE.with_name(item.name))]
        pytest.main([*nodes, "-q", "-p", "no:cacheprovider", *(["-x"] if item.constant else [])], plugins=[plugin])
    return Seen((f"{plugin.failed} fails" if plugin.failed else "passes",), could={} if item.constant else plugin.could)


def telling(entries: Mapping[str, Entry]) -> list[str]:
    """The recordings in the order in which they are tried: weak effects first, kinds in turns."""
    kinds: dict[str, list[Entry]] = {}
    for e in sorted(entries.values(), key=lambda e: min((g for g in e.gains), default=20.0)):
        kinds.setdefault(e.kind, []).append(e)
    places = [(k / len(some), e.name) for some in kinds.values() for k, e in enumerate(some)]
    return [name for _, name in sorted(places)]


def looks_at(constant: str, usual: Mapping[str, Seen]) -> list[Look]:
    """Where a constant could move something, the quick ones first."""
    return [
        Look(name, constant, f, usual[name].could[move(constant, f)])
        for name in sorted(usual, key=lambda n: usual[n].seconds)
        for f in FACTORS
        if move(constant, f) in usual[name].could and (name.endswith(".py") or usual[name].seconds < SLOW)
    ]


def kept() -> dict[str, dict[str, Any]]:
    """What the file says of each constant."""
    plain = yaml.safe_load(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    return {f.name: plain[f.name] for f in fields(Policy) if f.name in plain}


def write(found: Mapping[str, Mapping[str, Any]]) -> None:
    """Write the file, constants in the order of the policy."""
    lines = [yaml.safe_dump({f.name: dict(found[f.name])}, default_flow_style=None, sort_keys=False, width=10_000)
             for f in fields(Policy) if f.name in found]  # fmt: skip
    FILE.write_text(HEAD + "".join(lines), encoding="utf-8")


def _commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, cwd=FILE.parent, check=False
    )
    return done.stdout.strip()


def entry_of(item: Look, was: Seen, now: Seen) -> dict[str, Any]:
    """What the file says of a constant that moves an answer."""
    said = [("; ".join(x.said), "; ".join(x.scores)) for x in (was, now)]
    before, after = (s[0] if said[0][0] != said[1][0] else s[1] for s in said)
    return {"factor": round(item.factor, 3), "moves": item.name, "was": before, "now": after, "commit": _commit()}


@contextmanager
def _answers(workers: int, log: Path | None) -> Iterator[Any]:
    store = Lines(log, asdict, Seen.from_json, "perturbed policies") if log is not None else None
    with processes(workers) as pool:
        yield lambda looks: run_items({item.key: item for item in looks}, look, pool=pool, store=store)


def search(
    names: Sequence[str],
    constants: Sequence[str],
    *,
    workers: int = 1,
    log: Path | None = None,
    minutes: float = math.inf,
) -> dict[str, dict[str, Any]]:
    """Try constants until each moved an answer; the file is written after every round.

    Parameters
    ----------
    names : sequence of str
        Recordings of the scoreboard and files of tests.
    constants : sequence of str
    workers : int
    log : path, optional
        Finished answers are kept there.
    minutes : float
        No look starts after so long.

    Returns
    -------
    dict
        The file's entries.
    """
    until, found = time.monotonic() + 60.0 * minutes, kept()
    looks, evidence, left = Counter[str](), dict[str, str](), set(constants)
    with _answers(workers, log) as answers:
        for start in range(0, len(names), AT_A_TIME):
            some = names[start : start + AT_A_TIME]
            usual = dict(zip(some, answers([Look(n) for n in some]).values(), strict=True))
            ahead = {c: looks_at(c, usual) for c in constants if c in left}
            while any(ahead.values()) and time.monotonic() < until:
                batch = [items.pop(0) for items in ahead.values() if items]
                for item, now in zip(batch, answers(batch).values(), strict=True):
                    c, was = item.constant, usual[item.name]
                    looks[c] += 1
                    if now.answer != was.answer:
                        found[c] = entry_of(item, was, now)
                        left.discard(c)
                        del ahead[c]
                    elif gains_moved(was.gains, now.gains):
                        evidence.setdefault(c, f"x {item.factor:.2f}: {item.name}")
                for c in left - {c for c, e in found.items() if "stays" in e}:
                    found[c] = {
                        "open": f"no answer moved in {looks[c]} looks",
                        "evidence": evidence.get(c, ""),
                        "commit": _commit(),
                    }
                write(found)
            print(
                f"{start + len(some)} of {len(names)} looked at, {len(left)} constants left",
                file=sys.stderr,
                flush=True,
            )
            if time.monotonic() > until or not left:
                break
    return found


def again(constants: Sequence[str], workers: int, log: Path | None) -> list[str]:
    """Constants among some, or all, whose pin of the file moves nothing any more."""
    pins = {
        c: Look(e["moves"], c, next(f for f in FACTORS if abs(f - e["factor"]) < 0.01))
        for c, e in kept().items()
        if "moves" in e and (c in constants or not constants)
    }
    with _answers(workers, log) as answers:
        names = sorted({p.name for p in pins.values()})
        usual = dict(zip(names, answers([Look(n) for n in names]).values(), strict=True))
        items = [replace(p, nodes=usual[p.name].could.get(move(p.constant, p.factor), ())) for p in pins.values()]
        return [
            c
            for c, item, now in zip(pins, items, answers(items).values(), strict=True)
            if now.answer == usual[item.name].answer
        ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what moves with each constant, and the share of those that are pinned."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.policy_perturbation", description=__doc__.split("\n")[0] if __doc__ else None
    )
    parser.add_argument(
        "--constant",
        action="append",
        help="constants to move; may be repeated. Default: those that nothing moved yet, with --again all",
    )
    parser.add_argument("--only", default="", metavar="TEXT", help="recordings and tests whose name holds this")
    parser.add_argument("--minutes", type=float, default=math.inf, help="start no further round after so long")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--log", type=Path, help="keep answers in this file and go on from there")
    parser.add_argument("--show", action="store_true", help="only print what the file says")
    parser.add_argument(
        "--again",
        action="store_true",
        help="look again at what pins each constant, or those that are named; 1 where one moves nothing",
    )
    given = parser.parse_args(arguments)
    unknown = [c for c in given.constant or () if c not in NAMES]
    if unknown:
        parser.error(f"no constant of the policy: {', '.join(unknown)}")
    loose: list[str] = []
    if given.again:
        loose = again(given.constant or (), given.workers, given.log)
        print("\n".join(f"{c} is pinned no more" for c in loose) or "every pin holds")
    elif not given.show:
        tests = [f"{name}.py" for name in TESTS if FILE.with_name(f"{name}.py").exists()]
        names = [n for n in (*telling(_entries()), *tests) if given.only in n]
        done = {c for c, e in kept().items() if "moves" in e}
        constants = given.constant or [f.name for f in fields(Policy) if f.name not in done]
        search(names, constants, workers=given.workers, log=given.log, minutes=given.minutes)
    found = kept()
    for constant, e in found.items():
        what = (
            f"x {e['factor']}: {e['moves']}: {e['was']} -> {e['now']}" if "moves" in e else e.get("stays") or e["open"]
        )
        print(f"{constant:20s} {what}")
    by = Counter(
        ("a test" if e["moves"].endswith(".py") else "an answer")
        if "moves" in e
        else "stays"
        if "stays" in e
        else "open"
        for e in found.values()
    )
    pinned = by["an answer"] + by["a test"]
    print(f"\n{len(NAMES)} constants: " + ", ".join(f"{k} {n}" for k, n in by.items()))
    print(
        f"pinned: {pinned} of {len(NAMES)} ({pinned / len(NAMES):.0%}), {by['an answer']} by an answer of the scoreboard"
    )
    return int(bool(loose))


if __name__ == "__main__":
    sys.exit(main())
