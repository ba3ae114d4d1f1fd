"""The blind trial: effects are hidden by the emulator, the workflow looks for them, and the answers are scored.

Only this module knows both sides. Hidden effects are made by :mod:`insemu.emulate` (or by a process's own draw); candidates are closed
forms and signatures. Nominal levels are wrong by up to 20 %.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, EffectUse
from insemu.emulate import corrupt
from insemu.gap.static_log import find_static_gap
from insemu.noise import NoiseModel
from insemu.records import AXES, ImuRecord, Series

Array = NDArray[np.float64]

#: Effects that a log at rest can show, and none.
STATIC_EFFECTS = (
    "none", "white_noise", "random_walk", "gauss_markov", "flicker", "ramp", "vibration_line", "vibration_band", "telegraph",
    "outliers", "quantization", "decimation_filter", "temperature",
)  # fmt: skip
#: Nominal sensors: text of the model of a gyroscope axis (rad/s).
SENSORS = (
    "WN(N=1e-3 rad/s/sqrt(Hz))",
    "WN(N=2e-4 rad/s/sqrt(Hz)) + RW(K=3e-6 rad/s*sqrt(Hz))",
    "WN(N=5e-4 rad/s/sqrt(Hz)) + GM(sigma=1e-4 rad/s, beta=0.003)",
)


@dataclass(frozen=True)
class Trial:
    """One recording of the trial: what was hidden and what was said.

    ``named`` is the first step's effect where it was named alone, ``members`` its class; effects are given with their axis.
    """

    seed: int
    hidden: str
    axis: str
    strength: float
    verdict: str
    found: tuple[str, ...]
    members: tuple[str, ...]
    confidence: float
    gain_nats: float
    axis_right: bool
    gap_after: tuple[float, float, float]
    held_out: float


def hide(
    effect: str, strength: float, n: int, dt: float, white: float, axis: int, rng: np.random.Generator
) -> EffectUse | None:
    """Draw an effect's numbers; strength 1 is just visible in an hour."""
    if effect == "none":
        return None
    on = [0.0, 0.0, 0.0]
    span, sample = n * dt, white / np.sqrt(dt)

    def axes(value: float) -> list[float]:
        out = list(on)
        out[axis] = value
        return out

    slow = white / np.sqrt(span)  # uncertainty of the mean over the log
    memory = np.exp(rng.uniform(np.log(10.0), np.log(max(span / 15.0, 20.0)))) if effect == "gauss_markov" else 1.0
    makers: dict[str, Callable[[], dict[str, Any]]] = {
        "white_noise": lambda: {"N": axes(white * np.sqrt((1.0 + 0.45 * strength) ** 2 - 1.0))},
        "random_walk": lambda: {"K": axes(6.0 * strength * slow / np.sqrt(span))},
        "gauss_markov": lambda: {"sigma": axes(8.0 * strength * slow), "beta": [1.0 / memory] * 3},
        "flicker": lambda: {"B": axes(6.0 * strength * slow)},
        "ramp": lambda: {"R": axes(12.0 * strength * slow / span * rng.choice([-1.0, 1.0]))},
        "vibration_line": lambda: {"amplitude": axes(7.0 * strength * slow), "frequency": float(rng.uniform(0.1, 0.45) / dt)},
        "vibration_band": lambda: {
            "rms": axes(0.1 * strength * sample), "frequency": float(rng.uniform(0.1, 0.4) / dt), "bandwidth": float(0.01 / dt),
        },
        "telegraph": lambda: {"amplitude": axes(9.0 * strength * slow), "rate": float(1.0 / rng.uniform(15.0, 60.0))},
        "outliers": lambda: {"probability": 5e-4, "sigma": axes(5.0 * strength * sample)},
        "quantization": lambda: {"lsb": axes(0.3 * strength * sample)},
        "decimation_filter": lambda: {"cutoff": float(0.3 / dt / max(strength, 0.5)), "order": 2.0},
        "temperature": lambda: {"c1": axes(3.0 * strength * slow / 5.0)},
    }  # fmt: skip
    values = makers[effect]()
    return EffectUse(effect, "gyro", {k: tuple(v) if isinstance(v, list) else (float(v),) for k, v in values.items()})


def static_recording(
    effect: str, strength: float, seed: int, hours: float = 1.0, rate_hz: float = 20.0
) -> tuple[list[Series], dict[str, NoiseModel], Array, int]:
    """Make a log of three gyroscope axes at rest with one hidden effect; returns log, beliefs, temperature, axis."""
    rng = np.random.default_rng(seed)
    n, dt = int(hours * 3600.0 * rate_hz), 1.0 / rate_hz
    axis = int(rng.integers(3))
    truth = {a: NoiseModel.parse(str(rng.choice(SENSORS)), "rad/s") for a in AXES[:3]}
    white = truth[AXES[axis]].processes[0].parameters["N"]
    use = hide(effect, strength, n, dt, white, axis, rng)
    t = np.asarray(np.arange(n) * dt, dtype=np.float64)
    still = ImuRecord(t, np.zeros((n, 3)), np.zeros((n, 3)), "mean")
    wave = 8.0 * np.sin(2.0 * np.pi * (t / t[-1] * rng.uniform(0.7, 2.0) + rng.random()))
    temperature = 25.0 + wave + 3.0 * (1.0 - np.exp(-t / 900.0))
    made = corrupt(still, truth, rng, effects=() if use is None else (use,), temperature=temperature).imu.gyro
    beliefs = {
        a: NoiseModel(tuple(p.with_parameters(_off(p.parameters, p.parameters_meta()[0].name, rng)) for p in m))
        for a, m in truth.items()
    }
    log = [Series(made[:, k], rate_hz, "rad/s", AXES[k]) for k in range(3)]
    return log, beliefs, temperature, axis


def _off(parameters: dict[str, float], name: str, rng: np.random.Generator) -> dict[str, float]:
    return {**parameters, name: parameters[name] * float(rng.uniform(1.0 / 1.2, 1.2))}


def run_one(effect: str, strength: float, seed: int, hours: float = 1.0, hold_out: bool = False) -> Trial:
    """Hide, look, score: one recording."""
    log, beliefs, temperature, axis = static_recording(effect, strength, seed, hours)
    report = find_static_gap(
        log, beliefs, rng=np.random.default_rng([seed, 1]), temperature=temperature, hold_out=hold_out
    )
    steps = report.steps
    first = steps[0] if steps else None
    whole = effect == "decimation_filter"  # it acts on the sensor, not on an axis
    right = first is not None and (whole or first.axes == ("xyz"[axis],))
    g = report.gap_after
    return Trial(
        seed, effect, "xyz"[axis], strength, report.verdict,
        tuple(f"{s.effect} {','.join(s.axes)}" for s in steps),
        tuple(m.effect for m in first.members) if first else (),
        first.confidence if first else 0.0,
        first.gain_nats if first else 0.0,
        right, (g.value, g.low, g.high), report.held_out.value,
    )  # fmt: skip


def run_trial(
    effects: Sequence[str] = STATIC_EFFECTS,
    *,
    recordings: int,
    seed: int,
    hours: float = 1.0,
    workers: int = 1,
    hold_out: bool = False,
    strengths: Sequence[float] = (1.0, 2.0, 4.0),
    done: Callable[[Trial], None] | None = None,
) -> list[Trial]:
    """Run the trial; recording k is the same alone, in parallel and among more.

    Raises
    ------
    KeyboardInterrupt
        Interrupted; what was finished has been passed to ``done``.
    """
    jobs = list(_jobs(effects, recordings, seed, strengths))
    out: list[Trial] = []

    def keep(trial: Trial) -> None:
        out.append(trial)
        if done:
            done(trial)

    if workers <= 1:
        for effect, strength, s in jobs:
            keep(run_one(effect, strength, s, hours, hold_out))
        return out
    with ProcessPoolExecutor(workers) as pool:
        futures = [pool.submit(run_one, effect, strength, s, hours, hold_out) for effect, strength, s in jobs]
        try:
            for future in as_completed(futures):
                keep(future.result())
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return sorted(out, key=lambda t: t.seed)


def _jobs(
    effects: Sequence[str], recordings: int, seed: int, strengths: Sequence[float]
) -> Iterator[tuple[str, float, int]]:
    for k in range(recordings):
        rng = np.random.default_rng([seed, k])
        yield effects[k % len(effects)], float(rng.choice(strengths)), int(rng.integers(2**31))


@dataclass(frozen=True)
class Scores:
    """What the trial says, as shares with their counts."""

    recordings: int
    false_alarms: tuple[int, int]
    falsely_named: tuple[int, int]
    detected: tuple[int, int]
    named_right: tuple[int, int]
    in_class: tuple[int, int]
    mean_class_size: float
    confusion: dict[str, dict[str, int]]
    calibration: list[tuple[float, float, int]]
    gap_contains_one: tuple[int, int]

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def score_trials(trials: Sequence[Trial]) -> Scores:
    """Score a trial: of those named, how many right; truth in the class; false alarms; calibration of the confidence."""
    clean = [t for t in trials if t.hidden == "none"]
    hidden = [t for t in trials if t.hidden != "none"]
    found = [t for t in hidden if t.found]
    single = [t for t in found if len(t.members) == 1 and t.verdict != "unexplained"]
    several = [t for t in found if len(t.members) > 1 and t.verdict != "unexplained"]

    def right(t: Trial) -> bool:
        return t.found[0].split()[0] == t.hidden and t.axis_right

    confusion: dict[str, dict[str, int]] = {}
    for t in trials:
        said = t.found[0].split()[0] if t.found else "nothing"
        row = confusion.setdefault(t.hidden, {})
        row[said] = row.get(said, 0) + 1
    calibration = []
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 0.99), (0.99, 1.01)):
        inside = [t for t in found if low <= t.confidence < high and t.verdict != "unexplained"]
        if inside:
            calibration.append(
                (
                    float(np.mean([t.confidence for t in inside])),
                    float(np.mean([right(t) for t in inside])),
                    len(inside),
                )
            )
    scored = [t for t in single if right(t) and np.isfinite(t.gap_after[0])]
    return Scores(
        len(trials),
        (sum(bool(t.found) or t.verdict == "unexplained" for t in clean), len(clean)),
        (sum(t.verdict == "named" for t in clean), len(clean)),
        (len(found), len(hidden)),
        (sum(right(t) for t in single), len(single)),
        (sum(t.hidden in t.members and t.axis_right for t in several), len(several)),
        float(np.mean([len(t.members) for t in several])) if several else float("nan"),
        confusion,
        calibration,
        (sum(t.gap_after[1] <= 1.0 <= t.gap_after[2] for t in scored), len(scored)),
    )


def known_effects(names: Sequence[str]) -> list[str]:
    """The effects to hide, checked against what the trial can make."""
    from insemu.errors import InputError, nearest

    for name in names:
        if name not in STATIC_EFFECTS:
            hint = " (a log at rest cannot show it)" if name in EFFECTS else nearest(name, STATIC_EFFECTS)
            raise InputError(f"the trial cannot hide '{name}'{hint}")
    return list(names) or list(STATIC_EFFECTS)
