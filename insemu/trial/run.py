"""The blind trial: effects are hidden by the emulator and the workflow looks for them.

Only this room knows both sides. Hidden effects are made by :mod:`insemu.emulate` (or by a process's own
draw); candidates are closed forms and signatures. Nominal levels are wrong by up to 20 %.
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cache
from multiprocessing import active_children
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError, nearest
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.policy import rules
from insemu.gap.problems.rest import find_static_gap
from insemu.gap.session import find_gap
from insemu.gap.verdict import GapReport
from insemu.trial.drives import (
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
from insemu.trial.logs import STATIC_EFFECTS, STATIC_OUTSIDE, static_recording

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
        cut = start + rules().naming_share * (end - start)
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


def known_effects(names: Sequence[str], kinds: Sequence[str] = ("static", "dynamic")) -> tuple[str, ...]:
    """The effects to hide, checked against what the trial can make.

    Raises
    ------
    InputError
        An effect that no recording of these kinds can show.
    """
    possible = [e for kind in kinds for e in catalogue_of(kind)]
    for name in names:
        if name not in possible:
            hint = f" in a {' or '.join(kinds)} recording" if name in EFFECTS else nearest(name, possible)
            raise InputError(f"the trial cannot hide '{name}'{hint}")
    return tuple(names)


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
