"""Logs at rest with something hidden in them, for the blind trial: random sensors, wrong nominal levels, effects sized by what they are worth.

Everything is made by :mod:`insemu.emulate`; how much an effect is worth says :mod:`benchmarks.trial.expected`, which knows the truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.trial.drives import wrong
from benchmarks.trial.expected import Log, sized
from benchmarks.trial.hidden import Hidden
from insemu.effects import EFFECTS, EffectUse, RestLot
from insemu.emulate import corrupt
from insemu.gap.data import static_of
from insemu.noise import NoiseModel
from insemu.records import AXES, ImuRecord, Recording, Series

Array = NDArray[np.float64]

#: Effects that a log at rest can show.
STATIC_EFFECTS = ("none", *(e.id for e in EFFECTS.values() if e.does("hidden_at_rest")))
#: Structure that no catalogue holds, in a log at rest: telegraph noise is taken out of the catalogue.
STATIC_OUTSIDE = ("telegraph", "sweep")
#: Nominal sensors: text of the model of a gyroscope axis (rad/s).
SENSORS = (
    "WN(N=1e-3 rad/s/sqrt(Hz))",
    "WN(N=2e-4 rad/s/sqrt(Hz)) + RW(K=3e-6 rad/s*sqrt(Hz))",
    "WN(N=5e-4 rad/s/sqrt(Hz)) + GM(sigma=1e-4 rad/s, beta=0.003)",
)
#: Of several effects on an axis each is worth at least this much beside the others, nats, as far as a larger strength can make it so.
BESIDE_NATS = 20.0
#: How often the strength of one that is worth less is raised, and by how much at the most.
RAISES, MOST_RAISE = 8, 2.0


def shape(
    effect: str, n: int, dt: float, white: float, axis: int, rng: np.random.Generator
) -> Callable[[float], EffectUse]:
    """Draw what does not scale (memory, frequency, order, sign); the effect as a function of its strength, 1 near what an hour can show.

    Parameters
    ----------
    effect : str
        Catalogue id.
    n : int
        Samples of the log.
    dt : float
        Sampling interval, s.
    white : float
        White-noise density of the axis, unit/sqrt(Hz).
    axis : int
        0, 1 or 2.
    rng : Generator
    """
    lot, e = RestLot.drawn(n, dt, white, axis, rng), EFFECTS[effect]
    sensor = e.sensors[0]
    return lambda s: EffectUse.from_mapping({"effect": effect, "sensor": sensor, **e.hidden_at_rest(lot, s)})


@dataclass(frozen=True)
class HiddenLog:
    """A log with what is hidden in it.

    Parameters
    ----------
    log : list of Series
        Gyroscope axes.
    beliefs : dict
        Per axis, every level wrong by up to 20 %.
    temperature : (n,) array
        degC.
    missing : (n,) array of bool or None
        Samples that the stamps skip.
    hidden : tuple of Hidden
        With what each is worth, alone and beside the others.
    uses : tuple of EffectUse
        The same with numbers.
    axis : int
        Where it is hidden.
    known : Log
        What only the maker knows of that axis.
    sizes : tuple of float
        Strengths of ``uses``, from which the same log can be made without sizing anything.
    """

    log: list[Series]
    beliefs: dict[str, NoiseModel]
    temperature: Array
    missing: NDArray[np.bool_] | None
    hidden: tuple[Hidden, ...]
    uses: tuple[EffectUse, ...]
    axis: int
    known: Log
    sizes: tuple[float, ...]


@dataclass(frozen=True)
class Sized:
    """An effect with numbers, and the nats that it is expected to be worth alone and beside the others."""

    use: EffectUse
    strength: float
    alone: float = math.nan
    beside: float = math.nan


def together(makers: Sequence[Callable[[float], EffectUse]], log: Log, target: float) -> list[Sized]:
    """Size effects that share an axis: each for ``target`` nats alone, and raised until each is worth its share beside the others.

    Parameters
    ----------
    makers : sequence of callable
        Each makes an effect of its strength; from :func:`shape`.
    log : Log
        The axis, as its maker knows it.
    target : float
        nats.
    """
    strengths = [sized(make, log.worth, target)[0] for make in makers]
    uses = [make(s) for make, s in zip(makers, strengths, strict=True)]
    beside = [log.worth(u, [v for v in uses if v is not u]) for u in uses]
    for _ in range(RAISES if len(uses) > 1 else 0):
        low = [k for k, w in enumerate(beside) if w < BESIDE_NATS]
        if not low:
            break
        for k in low:
            lacking = math.sqrt((BESIDE_NATS + 5.0) / max(beside[k] + 3.0, 3.0))
            strengths[k] *= min(max(lacking, 1.2), MOST_RAISE)
            uses[k] = makers[k](strengths[k])
        beside = [log.worth(u, [v for v in uses if v is not u]) for u in uses]
    return [Sized(u, s, log.worth(u), w) for u, s, w in zip(uses, strengths, beside, strict=True)]


def static_recording(
    effects: Sequence[str],
    target: float,
    seed: int | Sequence[int],
    hours: float = 1.0,
    rate_hz: float = 20.0,
    *,
    axes: int = 3,
    sensors: Sequence[str] = SENSORS,
    outside: str = "",
    sizes: Sequence[float] = (),
) -> HiddenLog:
    """Make a log of gyroscope axes at rest with hidden effects on one axis.

    Parameters
    ----------
    effects : sequence of str
        Of :data:`STATIC_EFFECTS`; ``none`` counts as none.
    target : float
        Nats that each is expected to be worth.
    seed : int or sequence of int
    hours, rate_hz : float
        Length and rate.
    axes : int
        One to three.
    sensors : sequence of str
        Nominal sensors to draw from.
    outside : str
        One of :data:`STATIC_OUTSIDE`, hidden besides.
    sizes : sequence of float
        Strengths of the effects (and of one that is hidden besides), where they are known; none: sized for ``target``.
    """
    rng = np.random.default_rng(seed)
    n, dt = int(hours * 3600.0 * rate_hz), 1.0 / rate_hz
    axis = int(rng.integers(axes))
    names = AXES[:axes]
    truth = {a: NoiseModel.parse(str(rng.choice(sensors)), "rad/s") for a in names}
    beliefs = {a: wrong(m, rng) for a, m in truth.items()}
    t = np.asarray(np.arange(n) * dt, dtype=np.float64)
    wave = 8.0 * np.sin(2.0 * np.pi * (t / t[-1] * rng.uniform(0.7, 2.0) + rng.random()))
    temperature = np.asarray(25.0 + wave + 3.0 * (1.0 - np.exp(-t / 900.0)))
    log = Log(truth[AXES[axis]], beliefs[AXES[axis]], n, dt, axis, temperature)
    looked = [e for e in effects if e != "none"]
    wanted = looked + ([outside] if outside in EFFECTS else [])
    makers = [shape(e, n, dt, log.white, axis, rng) for e in wanted]
    if sizes:
        made = [Sized(make(s), s) for make, s in zip(makers, sizes, strict=True)]
    else:
        made = together(makers, log, target)
    uses = tuple(s.use for s in made)
    # the emulator makes three axes; those that are not asked for are left out
    full = {a: truth.get(a, truth[names[0]]) for a in AXES[:3]}
    still = ImuRecord(t, np.zeros((n, 3)), np.zeros((n, 3)), "mean")
    imu = corrupt(still, full, rng, effects=uses, temperature=temperature).imu
    if outside == "sweep":
        u = t / t[-1]
        gyro = imu.gyro.copy()
        loud = 0.3 * math.sqrt(target / 30.0) * log.white / math.sqrt(dt)
        gyro[:, axis] += loud * np.sin(2.0 * np.pi * t[-1] * (0.1 / dt * u + 0.1 / dt * u**2))
        imu = replace(imu, gyro=gyro)
    seen = static_of(Recording(imu=replace(imu, temperature=np.interp(imu.t, t, temperature)), source="hidden"))
    assert seen.temperature is not None
    hidden = tuple(
        Hidden(
            e,
            s.use.sensor,
            () if e in ("decimation_filter", "dropped_samples") else ("xyz"[axis],),
            nats=s.alone,
            beside=s.beside if len(made) > 1 else math.nan,
            values=_true_values(s.use, log.white),
        )
        for e, s in zip(looked, made, strict=False)
    )
    strengths = tuple(s.strength for s in made)
    return HiddenLog(
        list(seen.axes[:axes]), beliefs, seen.temperature, seen.missing, hidden, uses, axis, log, strengths
    )


def _true_values(use: EffectUse, white: float) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """Parameters of an effect as a report states them: white noise as the level that it makes."""
    values = dict(use.values)
    if use.id == "white_noise":
        values["N"] = tuple(math.hypot(v, white) for v in values["N"])
    return tuple(values.items())
