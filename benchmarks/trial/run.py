"""The blind trial: effects are hidden by the emulator and the workflow looks for them.

Only this room knows both sides. Hidden effects are made by :mod:`insemu.emulate` (or by a process's own
draw); candidates are closed forms and signatures. Nominal levels are wrong by up to 20 %.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from benchmarks.trial.drives import DYNAMIC_EFFECTS, OUTSIDE, TARGETS, Stage, draw_use, scaled, stage
from benchmarks.trial.hidden import Hidden, Number
from benchmarks.trial.logs import STATIC_EFFECTS, STATIC_OUTSIDE, static_recording
from benchmarks.trial.worth import drawn_outliers, oracle, size_effect, whitened_difference, worth_beside
from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError, nearest
from insemu.gap import GapReport, find_gap, find_static_gap, rules
from insemu.gap.drive import Flown, Prepared
from insemu.records import Recording
from insemu.work import Lines, processes, run_items

Array = NDArray[np.float64]
Kind = Literal["static", "dynamic"]


@dataclass(frozen=True)
class Said:
    """A step of an answer: effect, sensor and axes, its class (each with its axes), confidence, evidence, parameters with their 95 % interval."""

    effect: str
    sensor: str
    axes: tuple[str, ...]
    confidence: Number
    gain_nats: Number
    members: tuple[tuple[str, str, tuple[str, ...]], ...]
    runners_up: tuple[str, ...] = ()
    values: tuple[tuple[str, Number, Number, Number], ...] = ()


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
    sizes : tuple of float
        Strengths that make the same recording without sizing anything.
    """

    kind: Kind
    seed: int
    hidden: tuple[Hidden, ...]
    outside: str
    track: str
    verdict: str
    steps: tuple[Said, ...]
    gap_after: tuple[Number, Number, Number] = (math.nan, math.nan, math.nan)
    held_out: Number = math.nan
    oracle: Number = math.nan
    seconds: Number = math.nan
    sizes: tuple[float, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As plain data; what is not finite becomes null."""
        return dict(json.loads(_PLAIN.dump_json(self)))

    @classmethod
    def from_json(cls, plain: dict[str, Any]) -> Trial:
        """Inverse of :meth:`to_json`."""
        return _PLAIN.validate_python(plain)


_PLAIN = TypeAdapter(Trial)


def said(report: GapReport) -> tuple[Said, ...]:
    """The steps of a report as the trial scores them."""
    return tuple(
        Said(
            s.effect, s.sensor, tuple(s.axes), s.confidence, s.nats, tuple((m.effect, m.sensor, tuple(m.axes)) for m in s.members),
            tuple(m.effect for m in s.runners_up), tuple((p.name, float(p.value), float(p.low), float(p.high)) for p in s.parameters),
        )
        for s in report.findings
    )  # fmt: skip


# -- a log at rest --------------------------------------------------------------------------------------------------------------------


def run_static(job: Job) -> Trial:
    """Hide, look, score: one log at rest."""
    made = static_recording(job.effects, job.strength, job.seed, job.hours, outside=job.outside, sizes=job.sizes)
    started = time.process_time()
    report = find_static_gap(
        made.log, made.beliefs, rng=np.random.default_rng([job.seed, 1]), temperature=made.temperature, missing=made.missing,
        hold_out=job.hold_out, without=(job.outside,) if job.outside in EFFECTS else (),
    )  # fmt: skip
    g = report.gap_after
    return Trial(
        "static", job.seed, made.hidden, job.outside, "rest", report.verdict, said(report), (g.value, g.low, g.high), report.held_out.value,
        math.nan, time.process_time() - started, made.sizes,
    )  # fmt: skip


# -- a drive or flight ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HiddenDrive:
    """A drive or flight with what is hidden in it.

    Parameters
    ----------
    stage : Stage
        What only the maker knows.
    recording : Recording
    uses : tuple of EffectUse
    hidden : tuple of Hidden
    sizes : tuple of float
        Factors of ``uses`` and of what is outside the catalogue, from which the same recording can be made without sizing anything.
    clean : callable
        The nominal filter on the twin of the recording in which nothing is hidden.
    """

    stage: Stage
    recording: Recording
    uses: tuple[EffectUse, ...]
    hidden: tuple[Hidden, ...]
    sizes: tuple[float, ...]
    clean: Callable[[], Prepared]


def moving_recording(job: Job) -> HiddenDrive:
    """Make a drive or flight with something hidden in it."""
    s = stage(job.seed, job.minutes, job.rate_hz, track=job.track or None, turn_on_bias="turn_on_bias" in job.effects)
    rng = np.random.default_rng([job.seed, 3])

    @cache
    def clean() -> Prepared:
        return Flown.of(s.record(), s.nominal).prepared

    uses, hidden, sizes = [], [], []
    for k, e in enumerate(job.effects):
        use, what = draw_use(e, s, rng)
        if job.sizes:
            use, what = scaled(use, job.sizes[k]), replace(what, strength=job.sizes[k] * what.strength)
        else:
            use, what = size_effect(s, clean, use, what, job.strength)
        uses.append(use)
        hidden.append(replace(what, values=s.true_values(use)))
        sizes.append(what.strength if use.effect.size else 1.0)
    if not job.outside:
        return HiddenDrive(s, s.record(uses), tuple(uses), tuple(hidden), tuple(sizes), clean)
    known = job.sizes[-1] if job.sizes else None
    if job.outside == "quadratic_accelerometer":
        k2 = [0.0, 0.0, 0.0]
        k2[int(rng.integers(3))] = 1e-4 * float(rng.choice([-1.0, 1.0]))
        size = known
        if size is None:
            half = whitened_difference(clean().result, clean().on(s.record((quadratic(k2),))).result)
            size = min(math.sqrt(job.strength / max(half, 1e-9)), 300.0)
        uses.append(quadratic([v * size for v in k2]))
        recording = s.record(uses)
    else:
        if job.outside == "heading_dependent_gnss":
            size = known
            if size is None:
                half = whitened_difference(clean().result, clean().on(s.record((), job.outside, 0.1)).result)
                size = 0.1 * math.sqrt(job.strength / max(half, 1e-9))
        else:
            sample = s.truth["gyro_x"].processes[0].parameters["N"] / math.sqrt(s.imu.dt)
            size = sample * float(rng.choice([1.0, 2.0]))
        recording = s.record((), job.outside, size)
    return HiddenDrive(s, recording, tuple(uses), (), (*sizes, size), clean)


def quadratic(k2: Sequence[float]) -> EffectUse:
    """An accelerometer whose scale grows with what it measures."""
    return EffectUse("scale_nonlinearity", "accel", {"K2": tuple(k2), "K3": (0.0,) * 3})


def run_dynamic(job: Job) -> Trial:
    """Hide, look, score: one drive or flight."""
    made = moving_recording(job)
    s, uses, clean = made.stage, made.uses, made.clean
    hidden = list(made.hidden)
    started = time.process_time()
    flown = Flown.of(made.recording, s.nominal.parted())
    report = find_gap(
        made.recording, s.nominal, rng=np.random.default_rng([job.seed, 4]), hold_out=job.hold_out, pictures=False, flown=flown,
        without=[u.id for u in uses] if job.outside else (),
    )  # fmt: skip
    seconds = time.process_time() - started
    held = math.nan
    if uses and not job.outside and not job.sizes:
        start, end = float(flown.prepared.imu.t[0]), float(flown.prepared.imu.t[-1])
        held = oracle(s, clean(), flown.prepared, uses, start + rules().naming_share * (end - start))
        for k, (u, h) in enumerate(zip(uses, hidden, strict=True)):
            if u.id == "outliers":
                hidden[k] = replace(h, nats=drawn_outliers(s, uses, k))
            elif not math.isfinite(h.nats):
                hidden[k] = replace(h, nats=worth_beside(s, clean, (u,), 0))
        if len(uses) > 1:
            hidden = [replace(h, beside=worth_beside(s, clean, uses, k)) for k, h in enumerate(hidden)]
    g = report.gap_after
    return Trial(
        "dynamic", job.seed, tuple(hidden), job.outside, s.track, report.verdict, said(report), (g.value, g.low, g.high), report.held_out.value, held,
        seconds, made.sizes,
    )  # fmt: skip


# -- many of them ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """One recording to be made and looked at; everything about it follows from these.

    Parameters
    ----------
    kind : {"static", "dynamic"}
    effects : tuple of str
        To be hidden together (at rest on one axis); none for a recording in which nothing is missing.
    strength : float
        Evidence, in nats, that each shaped effect is sized for.
    seed : int
    outside : str
        Instead of effects: something that no catalogue holds.
    hours, minutes : float
        Length of a log at rest (h), of a drive or flight (min).
    hold_out : bool
    rate_hz : float
        Of a drive or flight.
    track : str
        Which of the tracks; empty: drawn.
    sizes : tuple of float
        Strengths as an earlier run found them (:attr:`Trial.sizes`); none: worked out.
    """

    kind: Kind
    effects: tuple[str, ...]
    strength: float
    seed: int
    outside: str = ""
    hours: float = 1.0
    minutes: float = 10.0
    hold_out: bool = False
    rate_hz: float = 50.0
    track: str = ""
    sizes: tuple[float, ...] = ()

    @property
    def key(self) -> str:
        """Under which a finished recording is kept."""
        return json.dumps(asdict(self), sort_keys=True)

    def run(self) -> Trial:
        """Do it."""
        return run_static(self) if self.kind == "static" else run_dynamic(self)


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
    plan: Plan | Sequence[Job],
    *,
    workers: int = 1,
    pool: Executor | None = None,
    done: Callable[[Trial], None] | None = None,
    log: Path | None = None,
) -> list[Trial]:
    """Run the trial.

    Parameters
    ----------
    workers : int
        Recordings looked at a time.
    pool : Executor, optional
        Instead of processes of this machine.
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
    jobs = {job.key: job for job in (plan.jobs() if isinstance(plan, Plan) else plan)}
    store = Lines(log, Trial.to_json, Trial.from_json, "a blind trial") if log is not None else None
    with nullcontext(pool) if pool is not None else processes(workers) as taken:
        return list(run_items(jobs, _run, pool=taken, store=store, done=done).values())


def _run(job: Job) -> Trial:
    return job.run()
