"""The blind trial: effects are hidden by the emulator, the workflow looks for them, and the answers are scored.

Only this module and :mod:`insemu.gap.hidden_drives` know both sides. Hidden effects are made by :mod:`insemu.emulate` (or by a process's own
draw); candidates are closed forms and signatures. Nominal levels are wrong by up to 20 %.
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from itertools import pairwise
from multiprocessing import active_children
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.hidden_drives import (
    DYNAMIC_EFFECTS,
    OUTSIDE,
    TARGETS,
    Hidden,
    draw_use,
    drawn_outliers,
    oracle,
    oracle_knows,
    size_effect,
    stage,
    whitened_difference,
    worth_beside,
)
from insemu.gap.hidden_logs import STATIC_EFFECTS, STATIC_OUTSIDE, static_recording
from insemu.gap.problems.rest import NAMING_SHARE, find_static_gap
from insemu.gap.session import find_gap
from insemu.gap.verdict import GapReport

Array = NDArray[np.float64]
Kind = Literal["static", "dynamic"]


@dataclass(frozen=True)
class Said:
    """A step of an answer: effect, sensor and axes, its class (each with its axes), confidence and evidence."""

    effect: str
    sensor: str
    axes: tuple[str, ...]
    confidence: float
    gain_nats: float
    members: tuple[tuple[str, str, tuple[str, ...]], ...]
    runners_up: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """One recording of the trial: what was hidden and what was said.

    Parameters
    ----------
    kind : str
    seed : int
    hidden : tuple of Hidden
        Empty where nothing was hidden.
    outside : str
        What was hidden that no catalogue holds.
    track : str
    verdict : str
    steps : tuple of Said
    gap_after : (3,) tuple
        Gap index with its interval; NaN where nothing was held out.
    held_out, oracle : float
        Gain per fix on held-out data, of the answer and of the truth.
    seconds : float
    """

    kind: Kind
    seed: int
    hidden: tuple[Hidden, ...]
    outside: str
    track: str
    verdict: str
    steps: tuple[Said, ...]
    gap_after: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    held_out: float = math.nan
    oracle: float = math.nan
    seconds: float = math.nan

    def to_json(self) -> dict[str, Any]:
        """As plain data; what is not finite becomes null."""
        return dict(
            json.loads(
                json.dumps(asdict(self)).replace("NaN", "null").replace("-Infinity", "null").replace("Infinity", "null")
            )
        )

    @classmethod
    def from_json(cls, plain: dict[str, Any]) -> Trial:
        """Inverse of :meth:`to_json`."""

        def number(x: Any) -> float:
            return math.nan if x is None else float(x)

        hidden = tuple(
            Hidden(
                h["effect"],
                h["sensor"],
                tuple(h["axes"]),
                number(h["strength"]),
                number(h["nats"]),
                number(h["scales_for_20"]),
                number(h.get("beside")),
            )
            for h in plain["hidden"]
        )
        steps = tuple(
            Said(
                s["effect"], s["sensor"], tuple(s["axes"]), number(s["confidence"]), number(s["gain_nats"]),
                tuple((m[0], m[1], tuple(m[2])) for m in s["members"]), tuple(s["runners_up"]),
            )
            for s in plain["steps"]
        )  # fmt: skip
        gap = tuple(number(x) for x in plain["gap_after"])
        return cls(
            plain["kind"], plain["seed"], hidden, plain["outside"], plain["track"], plain["verdict"], steps, (gap[0], gap[1], gap[2]),
            number(plain["held_out"]), number(plain["oracle"]), number(plain["seconds"]),
        )  # fmt: skip


def said(report: GapReport) -> tuple[Said, ...]:
    """The steps of a report as the trial scores them."""
    return tuple(
        Said(
            s.effect, s.sensor, tuple(s.axes), s.confidence, s.gain_nats, tuple((m.effect, m.sensor, tuple(m.axes)) for m in s.members),
            tuple(m.effect for m in s.runners_up),
        )
        for s in report.steps
    )  # fmt: skip


# -- a log at rest --------------------------------------------------------------------------------------------------------------------


def run_static(
    effects: Sequence[str], target: float, seed: int, hours: float = 1.0, hold_out: bool = False, outside: str = ""
) -> Trial:
    """Hide, look, score: one log at rest.

    Parameters
    ----------
    effects : sequence of str
        To be hidden together on one axis; none of them for a log in which nothing is missing.
    target : float
        Evidence, in nats, that each is sized for.
    outside : str
        Instead of effects: something that no catalogue holds.
    """
    made = static_recording(effects, target, seed, hours, outside=outside)
    started = time.process_time()
    report = find_static_gap(
        made.log, made.beliefs, rng=np.random.default_rng([seed, 1]), temperature=made.temperature, missing=made.missing,
        hold_out=hold_out, without=(outside,) if outside in EFFECTS else (),
    )  # fmt: skip
    g = report.gap_after
    return Trial(
        "static", seed, made.hidden, outside, "rest", report.verdict, said(report), (g.value, g.low, g.high), report.held_out.value,
        math.nan, time.process_time() - started,
    )  # fmt: skip


# -- a drive or flight ----------------------------------------------------------------------------------------------------------------


def run_dynamic(
    effects: Sequence[str],
    target: float,
    seed: int,
    minutes: float = 10.0,
    hold_out: bool = False,
    outside: str = "",
    rate_hz: float = 50.0,
) -> Trial:
    """Hide, look, score: one drive or flight.

    Parameters
    ----------
    effects : sequence of str
        To be hidden together; none of them for a recording in which nothing is missing.
    target : float
        Evidence, in nats, that each shaped effect is sized for.
    outside : str
        Instead of effects: something that no catalogue holds.
    """
    s = stage(seed, minutes, rate_hz, turn_on_bias="turn_on_bias" in effects)
    rng = np.random.default_rng([seed, 3])

    @cache
    def clean() -> Prepared:
        return Flown.of(s.record(), s.nominal).prepared

    uses, hidden, size = [], [], 0.0
    for e in effects:
        use, what = size_effect(s, clean, *draw_use(e, s, rng), target)
        uses.append(use)
        hidden.append(what)
    if outside == "quadratic_accelerometer":
        k2 = [0.0, 0.0, 0.0]
        k2[int(rng.integers(3))] = 1e-4 * float(rng.choice([-1.0, 1.0]))
        use = EffectUse("scale_nonlinearity", "accel", {"K2": tuple(k2), "K3": (0.0,) * 3})
        half = whitened_difference(clean().result, clean().on(s.record((use,))).result)
        factor = min(math.sqrt(target / max(half, 1e-9)), 300.0)
        uses.append(EffectUse(use.id, use.sensor, {"K2": tuple(v * factor for v in k2), "K3": (0.0,) * 3}))
        recording = s.record(uses)
    elif outside:
        size = 1.0
        if outside == "heading_dependent_gnss":
            half = whitened_difference(clean().result, clean().on(s.record((), outside, 0.1)).result)
            size = 0.1 * math.sqrt(target / max(half, 1e-9))
        else:
            size = (
                1.0
                * s.truth["gyro_x"].processes[0].parameters["N"]
                / math.sqrt(s.imu.dt)
                * float(rng.choice([1.0, 2.0]))
            )
        recording = s.record((), outside, size)
    else:
        recording = s.record(uses)
    started = time.process_time()
    flown = Flown.of(recording, s.nominal.parted())
    report = find_gap(
        recording, s.nominal, rng=np.random.default_rng([seed, 4]), hold_out=hold_out, pictures=False, flown=flown
    )
    seconds = time.process_time() - started
    held = math.nan
    if uses and not outside:
        start, end = float(flown.prepared.imu.t[0]), float(flown.prepared.imu.t[-1])
        cut = start + NAMING_SHARE * (end - start)
        whole = math.nan
        if oracle_knows(uses):
            whole, late, fixes = oracle(s, clean(), flown.prepared, uses, cut)
            held = late / max(fixes, 1)
        for k, (u, h) in enumerate(zip(uses, hidden, strict=True)):
            if not math.isfinite(h.nats) and oracle_knows((u,)):
                alone = whole if len(uses) == 1 else oracle(s, clean(), clean().on(s.record((u,))), (u,), cut)[0]
                # an amplitude and a time constant are worth about three nats to pay for
                hidden[k] = replace(h, nats=max(alone - 3.0, 0.0))
            elif u.id == "outliers":
                hidden[k] = replace(h, nats=drawn_outliers(s, uses, k))
        if len(uses) > 1:
            hidden = [replace(h, beside=worth_beside(s, clean, uses, k)) for k, h in enumerate(hidden)]
    g = report.gap_after
    return Trial(
        "dynamic", seed, tuple(hidden), outside, s.track, report.verdict, said(report), (g.value, g.low, g.high), report.held_out.value, held,
        seconds,
    )  # fmt: skip


# -- many of them ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """One recording to be made and looked at; everything about it follows from these."""

    kind: Kind
    effects: tuple[str, ...]
    strength: float
    seed: int
    outside: str = ""
    hours: float = 1.0
    minutes: float = 10.0
    hold_out: bool = False

    def run(self) -> Trial:
        """Do it."""
        if self.kind == "static":
            return run_static(self.effects, self.strength, self.seed, self.hours, self.hold_out, self.outside)
        return run_dynamic(self.effects, self.strength, self.seed, self.minutes, self.hold_out, self.outside)


@dataclass(frozen=True)
class Plan:
    """What a trial consists of.

    Parameters
    ----------
    kinds : tuple of {"static", "dynamic"}
        In turns.
    effects : tuple of str
        To choose from; empty: all of the kind.
    hidden : int
        How many at once: 0 for recordings in which nothing is missing.
    outside : bool
        Hide something that no catalogue holds instead.
    """

    kinds: tuple[Kind, ...] = ("dynamic",)
    effects: tuple[str, ...] = ()
    hidden: int = 1
    outside: bool = False
    recordings: int = 58
    seed: int = 1
    hours: float = 1.0
    minutes: float = 10.0
    hold_out: bool = False

    def jobs(self) -> Iterator[Job]:
        """Recording k is the same alone, in parallel and among more."""
        for k in range(self.recordings):
            rng = np.random.default_rng([self.seed, k])
            kind = self.kinds[k % len(self.kinds)]
            turn = k // len(self.kinds)
            choice = [e for e in catalogue_of(kind) if not self.effects or e in self.effects]
            strength = float(rng.choice(TARGETS))
            chosen: tuple[str, ...] = ()
            outside = ""
            if self.outside:
                options = OUTSIDE if kind == "dynamic" else STATIC_OUTSIDE
                outside, strength = options[turn % len(options)], max(strength, 60.0)
            elif self.hidden == 1:
                chosen = (choice[turn % len(choice)],)
            elif self.hidden > 1:
                chosen = tuple(
                    str(e) for e in rng.choice([e for e in choice if e != "none"], self.hidden, replace=False)
                )
                strength = max(strength, 60.0)
            yield Job(
                kind,
                tuple(e for e in chosen if e != "none"),
                strength,
                int(rng.integers(2**31)),
                outside,
                self.hours,
                self.minutes,
                self.hold_out,
            )


def catalogue_of(kind: str) -> tuple[str, ...]:
    """Effects that the trial can hide in a kind of recording, and none."""
    return STATIC_EFFECTS if kind == "static" else ("none", *DYNAMIC_EFFECTS)


def run_trial(
    plan: Plan, *, workers: int = 1, done: Callable[[Trial], None] | None = None, log: Path | None = None
) -> list[Trial]:
    """Run the trial.

    Parameters
    ----------
    workers : int
        Recordings looked at a time.
    done : callable, optional
        Told of every recording as it is finished.
    log : path, optional
        A file to which every finished recording is added, a line of JSON each; those that it holds already are not done again.

    Raises
    ------
    KeyboardInterrupt
        Interrupted; what was finished has been passed to ``done`` and is in the log.
    InputError
        A log that is no log of a trial.
    """
    out: list[Trial] = []
    known = _read_log(log) if log is not None else {}
    if log is not None and log.exists():
        _without_remnant(log)
    todo: list[tuple[int, Job]] = []

    def keep(trial: Trial) -> None:
        out.append(trial)
        if done:
            done(trial)

    for k, job in enumerate(plan.jobs()):
        if (key := _key(job)) in known:
            keep(known[key])
        else:
            todo.append((k, job))

    def finish(job: Job, trial: Trial) -> None:
        if log is not None:
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"job": _key(job), **trial.to_json()}) + "\n")
        keep(trial)

    if workers <= 1:
        for _, job in todo:
            finish(job, job.run())
        return out
    others = set(active_children())
    with ProcessPoolExecutor(workers, initializer=_without_interrupts) as pool:
        futures = {pool.submit(_run, job): job for _, job in todo}
        try:
            for future in as_completed(futures):
                finish(futures[future], future.result())
        except KeyboardInterrupt:
            # what they are at is lost in any case, and may take ten seconds yet
            for child in set(active_children()) - others:
                child.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return sorted(out, key=lambda t: (t.kind, t.seed))


def _run(job: Job) -> Trial:
    return job.run()


def _without_interrupts() -> None:
    """Ctrl-C reaches every process of a terminal; only the first one answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _key(job: Job) -> str:
    return json.dumps(asdict(job), sort_keys=True)


def _read_log(path: Path) -> dict[str, Trial]:
    if not path.exists():
        return {}
    out = {}
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            plain = json.loads(line)
            out[plain["job"]] = Trial.from_json(plain)
        except (ValueError, KeyError, TypeError):
            if number == len(lines):
                break  # cut off while it was written
            raise InputError("expected a line of JSON of a blind trial", where=f"{path}:{number}") from None
    return out


def _without_remnant(path: Path) -> None:
    """Cut off a last line that was interrupted while it was written, so that the next one begins a line."""
    text = path.read_bytes()
    if text and not text.endswith(b"\n"):
        path.write_bytes(text[: text.rfind(b"\n") + 1])


# -- scores ---------------------------------------------------------------------------------------------------------------------------

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


def known_effects(names: Sequence[str], kinds: Sequence[str] = ("static", "dynamic")) -> tuple[str, ...]:
    """The effects to hide, checked against what the trial can make.

    Raises
    ------
    InputError
        An effect that no recording of these kinds can show.
    """
    from insemu.errors import nearest

    possible = [e for kind in kinds for e in catalogue_of(kind)]
    for name in names:
        if name not in possible:
            hint = f" in a {' or '.join(kinds)} recording" if name in EFFECTS else nearest(name, possible)
            raise InputError(f"the trial cannot hide '{name}'{hint}")
    return tuple(names)
