"""The scoreboard: a fixed set of blind recordings, what is said of them, and the scores; a fresh run is held against the committed file.

    python -m tests.scoreboard                      # run, print what moved, fail where a score left its bound
    python -m tests.scoreboard --update             # run and rewrite the answers and scores of scoreboard.yaml
    python -m tests.scoreboard --limit 24           # a fifth of it, as CI does: fails where the interval of a score lies beyond that of the whole set
    python -m tests.scoreboard --only rest --limit 10
    python -m tests.scoreboard --release 1000 --log results/release.jsonl    # many more recordings; goes on where it stopped

A recording is defined by its seed, what is hidden in it and the sizes found when it was drawn, so no likelihood and no filter takes part in
making it. ``data`` is a fingerprint of the samples: where it moves, the recording changed and not only what is said of it.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.trial.drives import DYNAMIC_EFFECTS, OUTSIDE, TARGETS
from benchmarks.trial.logs import STATIC_EFFECTS, STATIC_OUTSIDE, static_recording
from benchmarks.trial.run import Job, Trial, moving_recording, run_trial
from benchmarks.trial.score import DEFINITIONS, Score, interval, score_trials

FILE = Path(__file__).with_name("scoreboard.yaml")
#: Recordings of each kind with none, one, two and three effects, and with something outside the catalogue: 120 in all.
MIX = {"rest": (10, 18, 8, 4, 6), "drive": (8, 14, 6, 3, 4), "flight": (9, 16, 6, 4, 4)}
WHAT = ("none", "one", "two", "three", "outside")
FLIGHTS = ("aerobatic", "uav", "helicopter", "aeroplane")
#: Length of a log at rest (h), of a drive or flight (min): the shortest in which most effects can be told apart.
HOURS, MINUTES = 0.25, 3.0
SEED, RELEASE_SEED = 12, 13
#: Several effects, and what is outside the catalogue, are worth at least this, nats.
LEAST_TOGETHER = 60.0
#: A gain has moved where it differs by more than this, nats, and this share.
GAIN_NATS, GAIN_SHARE = 0.2, 0.01
#: A fingerprint has moved where it differs by more.
SAME_DATA = 1e-5


@dataclass(frozen=True)
class Entry:
    """A recording of the set: its name, how to make it, and what each hidden effect is worth (alone, beside the others), nats."""

    name: str
    job: Job
    worth: tuple[tuple[float, float], ...] = ()
    data: float = math.nan
    said: tuple[str, ...] = ()
    gains: tuple[float, ...] = ()

    @property
    def kind(self) -> str:
        """Of ``rest``, ``drive`` and ``flight``."""
        return self.name.split("-")[0]

    def scored(self, trial: Trial) -> Trial:
        """A trial whose hidden effects are worth what was found when the recording was drawn."""
        if not self.worth:
            return trial
        pairs = zip(trial.hidden, self.worth, strict=True)
        return replace(trial, hidden=tuple(replace(h, nats=n, beside=b) for h, (n, b) in pairs))

    def answered(self, trial: Trial) -> Entry:
        """The same recording with the answer of a run."""
        return replace(
            self, said=sentences(trial), gains=tuple(round(float(s.gain_nats), 1) for s in trial.steps), data=fingerprint(self.job)
        )  # fmt: skip

    def to_plain(self) -> dict[str, Any]:
        """One line of the file."""
        job = self.job
        out: dict[str, Any] = {"id": self.name, "seed": job.seed}
        if job.track:
            out["track"] = job.track
        if job.outside:
            out["outside"] = job.outside
        if job.effects:
            out["hidden"] = list(job.effects)
        out["strength"] = job.strength
        if job.sizes:
            out["sizes"] = [float(f"{x:.9g}") for x in job.sizes]
        if self.worth:
            out["worth"] = [_plain(n) for n, _ in self.worth]
            if len(self.worth) > 1:
                out["beside"] = [_plain(b) for _, b in self.worth]
        return {**out, "data": float(f"{self.data:.6f}"), "said": list(self.said), "gains": list(self.gains)}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Entry:
        """Inverse of :meth:`to_plain`."""
        rest = plain["id"].startswith("rest")
        job = Job(
            "static" if rest else "dynamic", tuple(plain.get("hidden", ())), float(plain["strength"]), plain["seed"], plain.get("outside", ""),
            HOURS, MINUTES, True, track=plain.get("track", ""), sizes=tuple(plain.get("sizes", ())),
        )  # fmt: skip
        alone = plain.get("worth", [])
        beside = plain.get("beside", [None] * len(alone))
        worth = tuple((_number(a), _number(b)) for a, b in zip(alone, beside, strict=True))
        return cls(plain["id"], job, worth, float(plain["data"]), tuple(plain["said"]), tuple(plain["gains"]))


def _plain(x: float) -> float | None:
    return None if math.isnan(x) else float(f"{x:.4g}")


def _number(x: float | None) -> float:
    return math.nan if x is None else float(x)


def sentences(trial: Trial) -> tuple[str, ...]:
    """The verdict, then every step: effect, sensor and axes, and what else is in its class."""

    def name(effect: str, sensor: str, axes: Sequence[str]) -> str:
        return " ".join((effect, sensor, "".join(axes) if all(len(a) == 1 for a in axes) else "+".join(axes))).strip()

    steps = (" | ".join(name(*m) for m in s.members) or name(s.effect, s.sensor, s.axes) for s in trial.steps)
    return (trial.verdict, *steps)


def fingerprint(job: Job) -> float:
    """A random projection of the samples' differences: of order one, and another where any sample is another."""
    channels: list[NDArray[np.float64]]
    if job.kind == "static":
        log = static_recording(job.effects, job.strength, job.seed, job.hours, outside=job.outside, sizes=job.sizes)
        channels = [s.values for s in log.log]
    else:
        made = moving_recording(job).recording
        fixes = made.gnss
        assert fixes is not None
        channels = [
            made.imu.t,
            *made.imu.gyro.T,
            *made.imu.accel.T,
            fixes.t,
            *fixes.llh.T,
            *np.asarray(fixes.vel_ned).T,
        ]
    total = 0.0
    for k, x in enumerate(channels):
        d = np.diff(x)
        weights = np.random.default_rng([99, k]).standard_normal(d.size)
        total += float(weights @ d) / max(float(np.linalg.norm(d)), 1e-300)
    return total


def drawn(mix: dict[str, tuple[int, ...]], seed: int) -> Iterator[Entry]:
    """The recordings of a mix, not yet sized."""
    turns: Counter[str] = Counter()
    for kind, counts in mix.items():
        rest = kind == "rest"
        catalogue = STATIC_EFFECTS[1:] if rest else DYNAMIC_EFFECTS
        for what, count in enumerate(counts):
            for k in range(count):
                rng = np.random.default_rng([seed, list(mix).index(kind), what, k])
                strength = float(rng.choice(TARGETS))
                effects: tuple[str, ...] = ()
                outside = track = ""
                if what == 1:
                    turn = "rest" if rest else "motion"
                    effects = (catalogue[turns[turn] % len(catalogue)],)
                    turns[turn] += 1
                elif what in (2, 3):
                    effects = tuple(str(e) for e in rng.choice(catalogue, what, replace=False))
                elif what == 4:
                    options = STATIC_OUTSIDE if rest else OUTSIDE
                    outside = options[k % len(options)]
                if what > 1:
                    strength = max(strength, LEAST_TOGETHER)
                if not rest:
                    track = "car" if kind == "drive" else FLIGHTS[(what + k) % len(FLIGHTS)]
                job = Job(
                    "static" if rest else "dynamic", effects, strength, int(rng.integers(2**31)), outside, HOURS, MINUTES, True, track=track
                )  # fmt: skip
                yield Entry(f"{kind}-{WHAT[what]}-{k + 1:02d}", job)


def run(entries: Sequence[Entry], workers: int, log: Path | None = None) -> dict[str, Trial]:
    """Look at every recording; by its name."""
    started, finished = time.monotonic(), 0

    def done(_: Trial) -> None:
        nonlocal finished
        finished += 1
        if sys.stderr.isatty() or finished % 30 == 0 or finished == len(entries):
            print(f"{finished} of {len(entries)} recordings, {time.monotonic() - started:.0f} s", file=sys.stderr)

    trials = run_trial([e.job for e in entries], workers=workers, done=done, log=log)
    return {e.name: e.scored(t) for e, t in zip(entries, trials, strict=True)}


def table(trials: dict[str, Trial]) -> dict[str, dict[str, Score]]:
    """Scores of all recordings and of each kind, those that counted nothing left out."""
    groups = {"all": list(trials.values())}
    for kind in MIX:
        groups[kind] = [t for name, t in trials.items() if name.startswith(kind)]
    return {g: {n: s for n, s in score_trials(some).items() if s.of and s.better} for g, some in groups.items() if some}


def text(scores: dict[str, dict[str, Score]]) -> dict[str, dict[str, str]]:
    """The scores as the file holds them: count, of how many, and the 95 % interval."""
    return {
        group: {name: "{} of {} ({:.3f} to {:.3f})".format(s.count, s.of, *s.interval) for name, s in rows.items()}
        for group, rows in scores.items()
    }


def write(entries: Sequence[Entry], scores: dict[str, dict[str, Score]], path: Path = FILE) -> None:
    """Write the file: the scores, then a line per recording."""
    lines = [
        "# Scores of a fixed set of blind recordings, with exact binomial 95 % intervals, and what is said of each recording.",
        "# Written by `python -m tests.scoreboard --update`; `make scoreboard` holds a fresh run against it.",
        "scores:",
    ]
    for group, rows in text(scores).items():
        lines += [f"  {group}:", *(f"    {name}: {value}" for name, value in rows.items())]
    lines.append("recordings:")
    for e in entries:
        plain = yaml.safe_dump(e.to_plain(), default_flow_style=True, sort_keys=False, width=10_000).strip()
        lines.append(f"- {plain}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read(path: Path = FILE) -> tuple[list[Entry], dict[str, dict[str, tuple[int, int]]]]:
    """The recordings and the scores of the file."""
    plain = yaml.safe_load(path.read_text(encoding="utf-8"))
    scores = {
        group: {name: (int(value.split()[0]), int(value.split()[2])) for name, value in rows.items()}
        for group, rows in plain["scores"].items()
    }
    return [Entry.of_plain(r) for r in plain["recordings"]], scores


def gains_moved(before: Sequence[float], now: Sequence[float]) -> bool:
    """Whether the evidence of any step moved."""
    return any(abs(a - b) > GAIN_NATS + GAIN_SHARE * abs(a) for a, b in zip(before, now, strict=True))


def moved(old: Entry, new: Entry) -> list[str]:
    """What moved in a recording, as lines of a diff; empty where nothing did."""
    out = []
    if abs(old.data - new.data) > SAME_DATA:
        out.append(f"  the recording itself is another: fingerprint {old.data:.6f} -> {new.data:.6f}")
    if old.said != new.said:
        out += [f"- {'; '.join(old.said)}", f"+ {'; '.join(new.said)}"]
    elif gains_moved(old.gains, new.gains):
        out.append(f"  gains {list(old.gains)} -> {list(new.gains)} nats")
    return [f"{old.name} (hidden: {old.job.outside or ', '.join(old.job.effects) or 'nothing'})", *out] if out else []


def beyond(name: str, before: tuple[int, int], now: Score, part: bool = False) -> bool:
    """Whether a score left the 95 % interval of the committed one on the wrong side; of a part of the set, whether its own interval did."""
    low, high = interval(*before)
    if not now.of:
        return False
    better = next(d.better for d in DEFINITIONS if d.name == name)
    least, most = interval(now.count, now.of) if part else (now.count / now.of,) * 2
    return most < low if better == "more" else least > high


def compare(
    old: Sequence[Entry],
    new: Sequence[Entry],
    before: dict[str, dict[str, tuple[int, int]]],
    now: dict[str, dict[str, Score]],
    part: bool = False,
) -> tuple[list[str], bool]:
    """Lines of what moved, and whether a score left its bound; of a ``part`` of the set only scores that did are shown."""
    lines = [line for a, b in zip(old, new, strict=True) for line in moved(a, b)]
    worse = False
    for group, rows in now.items():
        for name, score in rows.items():
            then = before.get(group, {}).get(name)
            if then is None or then == (score.count, score.of):
                continue
            out = beyond(name, then, score, part)
            worse |= out
            if part and not out:
                continue
            bound = " BEYOND ITS BOUND ({:.3f} to {:.3f})".format(*interval(*then)) if out else ""
            lines.append(f"{group}: {score.label}: {then[0]} of {then[1]} -> {score.count} of {score.of}{bound}")
    return lines, worse


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and compare; 1 where a score left its bound."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.scoreboard", description=__doc__.split("\n")[0] if __doc__ else None
    )
    parser.add_argument("--workers", type=int, default=2, help="recordings looked at at a time")
    parser.add_argument(
        "--only", metavar="TEXT", default="", help="recordings whose name holds this: rest, drive-two, flight-one-03"
    )
    parser.add_argument("--kind", choices=sorted(MIX), help="logs at rest, drives or flights only")
    parser.add_argument("--limit", type=int, default=0, help="at most so many recordings, spread over the set")
    parser.add_argument("--log", type=Path, help="keep finished recordings in this file and go on from there")
    parser.add_argument("--update", action="store_true", help="rewrite the answers and scores")
    parser.add_argument("--draw", action="store_true", help="draw and size the set anew (with --update)")
    parser.add_argument(
        "--release",
        type=int,
        default=0,
        metavar="N",
        help="draw N other recordings of the same mix and print their scores",
    )
    given = parser.parse_args(arguments)
    if given.release:
        factor = given.release / sum(map(sum, MIX.values()))
        many = {kind: tuple(round(factor * n) for n in counts) for kind, counts in MIX.items()}
        found = table(run(list(drawn(many, RELEASE_SEED)), given.workers, given.log))
        before = read()[1]
        print(yaml.safe_dump(text(found), sort_keys=False, width=200))
        lines, worse = compare([], [], before, found)
        print(
            "\n".join(line for line in lines if "BEYOND" in line)
            or "every score lies within the bounds of the small set"
        )
        return int(worse)
    if given.draw:
        old = list(drawn(MIX, SEED))
        before = {}
    else:
        old, before = read()
    part = [e for e in old if given.only in e.name and (given.kind is None or e.kind == given.kind)]
    if given.limit and given.limit < len(part):
        part = [part[k * len(part) // given.limit] for k in range(given.limit)]
    trials = run(part, given.workers, given.log)
    if given.draw:
        part = [
            replace(
                e, job=replace(e.job, sizes=trials[e.name].sizes), worth=tuple((h.nats, h.beside) for h in trials[e.name].hidden)
            )
            for e in part
        ]  # fmt: skip
    new = [e.answered(trials[e.name]) for e in part]
    found = table(trials)
    whole = len(part) == len(old)
    lines, worse = compare(part, new, before, found, not whole)
    print("\n".join(lines) or "nothing moved")
    print(f"{len(part)} recordings; {sum(t.seconds for t in trials.values()):.0f} s of one core in the workflow")
    if given.update:
        if not whole:
            parser.error("--update needs the whole set")
        write(new, found)
        return 0
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
