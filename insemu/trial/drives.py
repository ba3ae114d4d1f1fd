"""Drives and flights with something hidden in them, for the blind trial: random tracks of five vehicles, random sensors, wrong nominal levels.

Everything is made by :mod:`insemu.emulate`; nothing here reads a signature. How much an effect is worth is measured with the whole filter on
a twin of the recording, the same noise without the effect: half the squared whitened difference of the innovations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import CROSS, EFFECTS, EffectUse
from insemu.emulate import SmoothPath, corrupt, gnss_fixes, ideal_imu
from insemu.emulate.flight import gusts, moving, place
from insemu.emulate.motion import Command, path_of, profile
from insemu.emulate.vehicle import VEHICLES
from insemu.filters import FilterResult
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.drive.preparation import Prepared
from insemu.gap.evidence.fixes import Colour, Surrogate
from insemu.noise import BI, GM, RC, RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.scenario import Gnss, Initial

Array = NDArray[np.float64]
_DEG = math.pi / 180.0
NED = ("north", "east", "down")

#: Effects that a drive or flight can show.
DYNAMIC_EFFECTS = (
    "white_noise", "random_walk", "gauss_markov", "flicker", "ramp", "turn_on_bias", "scale_factor", "scale_asymmetry", "misalignment",
    "g_sensitivity", "temperature", "gravity", "earth_rate", "imu_gnss_time_offset", "clock_drift", "lever_arm", "gnss_multipath_step",
    "gnss_noise_level", "gnss_velocity_noise", "gnss_correlated_noise", "gnss_outliers", "vibration_line", "vibration_band", "quantization",
    "decimation_filter", "outliers", "saturation", "dropped_samples",
)  # fmt: skip
#: Structure that no catalogue holds.
OUTSIDE = ("heading_dependent_gnss", "quadratic_accelerometer", "sweep")
#: Knots of a track, s.
FINE_KNOT_S = 0.0125
TRACKS = ("car", "aerobatic", "uav", "helicopter", "aeroplane")
#: Strengths of shaped effects are drawn so that they are worth one of these, nats.
TARGETS = (8.0, 15.0, 30.0, 60.0, 150.0, 600.0)
#: No shaped effect is made larger than this many datasheet scales: what the motion does not show stays hidden.
LARGEST = 30.0


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Parameters
    ----------
    effect, sensor : str
    axes : tuple of str
    strength : float
        In units of the effect's datasheet scale.
    nats : float
        What it is expected to add to the evidence, its one number paid for; NaN where the trial has no measure of it.
    scales_for_20 : float
        Strength, in datasheet scales, at which it would be worth 20 nats; NaN where unknown.
    beside : float
        What it is expected to add where everything else that was hidden is known already except in its size; NaN where the trial has no
        measure of it.
    values : tuple of (str, tuple of float)
        True parameters as a report states them, SI: the whole level of a sensor's or a receiver's noise, where the effect raises that.
    """

    effect: str
    sensor: str
    axes: tuple[str, ...]
    strength: float = 1.0
    nats: float = math.nan
    scales_for_20: float = math.nan
    beside: float = math.nan
    values: tuple[tuple[str, tuple[float, ...]], ...] = ()

    def true(self, name: str, axes: Sequence[str]) -> float | None:
        """True value of a reported parameter (``value_z``, ``sigma_north``, ``factor`` on the axes of its step); None where it has none."""
        values = dict(self.values)
        key, _, label = name.rpartition("_")
        if name in values:
            key, label = name, axes[0] if len(set(axes)) == 1 else ""
        if key not in values:
            return None
        given = values[key]
        if len(given) == 1:
            return given[0]
        labels = {3: (*"xyz", *NED), 6: CROSS, 9: tuple(a + b for a in "xyz" for b in "xyz")}[len(given)]
        return given[labels.index(label) % len(given)] if label in labels else None


def paid(half_square: float) -> float:
    """Expected evidence of a shaped effect whose signal is worth ``half_square`` nats, its one number paid for."""
    return half_square - 0.5 * math.log1p(2.0 * half_square)


# -- tracks ---------------------------------------------------------------------------------------------------------------------------


def random_track(kind: str, seconds: float, rng: np.random.Generator) -> SmoothPath:
    """A random path of a vehicle, a little longer than ``seconds``."""
    origin = place(float(rng.uniform(-55.0, 62.0)), float(rng.uniform(-180.0, 180.0)), float(rng.uniform(0.0, 900.0)))
    heading = float(rng.uniform(-math.pi, math.pi))
    if kind == "aerobatic":
        return _aerobatic(seconds, heading, origin, rng)
    commands, vehicle, shake_v, shake_a, band = _COMMANDS[kind](seconds, rng)
    while sum(c.duration_s for c in commands) < seconds + 2.0:
        commands.append(Command(20.0))
    p = profile(commands, heading=heading, speed=0.0)
    calm = path_of(p, VEHICLES[vehicle], origin, kind)
    # a spline repeats what is fast about the frequency of its knots: fast motion gets closer knots
    t = np.linspace(calm.start, calm.end, int((calm.end - calm.start) / FINE_KNOT_S) + 1)
    velocity = calm.position.derivative()(t)
    on = moving(np.hypot(velocity[:, 0], velocity[:, 1]))
    seeds = rng.integers(2**31, size=2)
    wind = gusts(t, shake_v, band, on, int(seeds[0]))
    rock = gusts(t, shake_a * _DEG, band, on, int(seeds[1])) * np.array([1.0, 0.9, 0.3])
    if kind == "car":
        wind *= np.array([0.0, 0.0, 1.0])
    return SmoothPath.from_velocity(t, velocity + wind, calm.attitude(t) + rock, origin, kind)


_Commands = tuple[list[Command], str, float, float, tuple[float, float]]


def _car(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(float(rng.uniform(5.0, 30.0)))]
    while sum(c.duration_s for c in out) < seconds:
        cruise = float(rng.uniform(8.0, 25.0))
        out += [
            Command(4.0 + cruise / 1.8, speed=cruise),
            Command(float(rng.uniform(10.0, 40.0)), climb=float(rng.uniform(-6.0, 6.0))),
        ]
        if rng.random() < 0.3:
            out += [Command(9.0, speed=0.0), Command(float(rng.uniform(5.0, 30.0)))]
        else:
            turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(40.0, 120.0)) * _DEG
            out += [Command(7.0, speed=float(rng.uniform(4.0, 7.0))), Command(9.0, turn=turn)]
    return out, "car", 0.03, 0.3, (0.5, 3.0)


def _uav(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(10.0), Command(15.0, speed=18.0), Command(30.0, speed=22.0, climb=80.0)]
    while sum(c.duration_s for c in out) < seconds:
        side = float(rng.choice([-1.0, 1.0]))
        out += [
            Command(
                float(rng.uniform(15.0, 40.0)),
                turn=side * float(rng.uniform(90.0, 360.0)) * _DEG,
                climb=float(rng.uniform(-15.0, 15.0)),
            ),
            Command(float(rng.uniform(10.0, 30.0)), speed=float(rng.uniform(17.0, 25.0))),
        ]
    return out, "fixed_wing", 0.1, 1.0, (0.1, 2.0)


def _helicopter(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(12.0), Command(30.0, speed=22.0, climb=100.0)]
    side = 1.0
    while sum(c.duration_s for c in out) < seconds:
        out += [
            Command(float(rng.uniform(40.0, 90.0)), speed=float(rng.uniform(18.0, 28.0)), speed_in_s=15.0),
            Command(30.0, turn=side * 180.0 * _DEG, climb=float(rng.uniform(-40.0, 40.0))),
        ]
        side = -side
    return out, "helicopter", 0.1, 0.3, (0.1, 1.0)


def _aeroplane(seconds: float, rng: np.random.Generator) -> _Commands:
    out = [Command(15.0), Command(25.0, speed=50.0), Command(60.0, speed=62.0, climb=300.0)]
    side = 1.0
    while sum(c.duration_s for c in out) < seconds:
        out += [
            Command(float(rng.uniform(50.0, 120.0)), speed=float(rng.uniform(55.0, 70.0)), speed_in_s=20.0),
            Command(60.0, turn=side * float(rng.uniform(90.0, 180.0)) * _DEG, climb=float(rng.uniform(-60.0, 60.0))),
        ]
        side = -side if rng.random() < 0.7 else side
    return out, "fixed_wing", 0.3, 0.5, (0.05, 0.8)


_COMMANDS: dict[str, Callable[[float, np.random.Generator], _Commands]] = {
    "car": _car,
    "uav": _uav,
    "helicopter": _helicopter,
    "aeroplane": _aeroplane,
}


def _aerobatic(seconds: float, heading: float, origin: Array, rng: np.random.Generator) -> SmoothPath:
    """Loops in the plane with slow rolls (some all the way round) and pitching: every axis of both sensors is excited."""
    end = seconds + 5.0
    t = np.linspace(0.0, end, int(end / FINE_KNOT_S) + 1)
    up = np.clip((t - 15.0) / 20.0, 0.0, 1.0)
    on = up**3 * (10.0 - 15.0 * up + 6.0 * up**2)

    def wave(periods: tuple[float, float], count: int = 3) -> Array:
        total = np.zeros_like(t)
        for _ in range(count):
            total += np.sin(2.0 * math.pi * (t / rng.uniform(*periods) + rng.random()))
        return np.asarray(total / count)

    course = heading + on * (
        t * rng.choice([-1.0, 1.0]) * 2.0 * math.pi / rng.uniform(25.0, 45.0) * wave((60.0, 200.0), 1)
    )
    speed = on * (22.0 + 4.0 * wave((20.0, 60.0)))
    climb = on * 3.0 * wave((20.0, 50.0))
    vel = np.stack([speed * np.cos(course), speed * np.sin(course), climb], axis=1)
    rolls = np.zeros_like(t)
    for start in np.arange(60.0, seconds - 20.0, float(rng.uniform(50.0, 90.0))):
        u = np.clip((t - start) / 6.0, 0.0, 1.0)
        rolls += 2.0 * math.pi * u**3 * (10.0 - 15.0 * u + 6.0 * u**2) * rng.choice([-1.0, 1.0])
    rpy = np.stack(
        [
            on * 45.0 * _DEG * wave((8.0, 30.0)) + rolls,
            on * 30.0 * _DEG * wave((8.0, 40.0)),
            course + on * 10.0 * _DEG * wave((9.0, 30.0)),
        ],
        axis=1,
    )
    return SmoothPath.from_velocity(t, vel, rpy, origin, "aerobatic")


# -- the sensors, the fixes and what is believed of them ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stage:
    """A recording to be made: the ideal motion, the true noise, what is believed. Making it twice gives the same noise."""

    seed: int
    track: str
    imu: ImuRecord
    motion: Trajectory
    truth: dict[str, NoiseModel]
    sigma: Array
    sigma_v: Array
    rate_hz: float
    lever_arm: Array
    temperature: Array
    with_reference: bool
    nominal: Nominal
    stated: tuple[Array, Array]

    def true_values(self, use: EffectUse) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """Parameters of an effect as a report states them: levels as a whole, relative to what is stated of the fixes."""
        values = dict(use.values)
        if use.id == "white_noise":
            own = [self.truth[f"{use.sensor}_{a}"].processes[0].parameters["N"] for a in "xyz"]
            values["N"] = tuple(math.hypot(a, b) for a, b in zip(values["N"], own, strict=True))
        elif use.id in ("gnss_noise_level", "gnss_velocity_noise"):
            true, stated = (
                (self.sigma, self.stated[0]) if use.id == "gnss_noise_level" else (self.sigma_v, self.stated[1])
            )
            values["factor"] = tuple(float(x) for x in np.array(values["factor"]) * true / stated)
        return tuple(values.items())

    def record(self, effects: Sequence[EffectUse] = (), outside: str = "", size: float = 0.0) -> Recording:
        """Emulate the recording, with effects hidden in it or with something that no catalogue holds."""
        imu_rng, gnss_rng, own = np.random.default_rng([self.seed, 7]).spawn(3)
        inertial = [u for u in effects if u.sensor != "gnss"]
        imu = corrupt(
            self.imu, self.truth, imu_rng, effects=inertial, reference=self.motion, temperature=self.temperature
        ).imu
        fixes = gnss_fixes(
            self.motion,
            self.rate_hz,
            self.sigma,
            self.sigma_v,
            self.lever_arm,
            rng=gnss_rng,
            effects=[u for u in effects if u.sensor == "gnss"],
        )
        if outside == "heading_dependent_gnss":
            fixes = self._heading_dependent(fixes, size, own)
        elif outside == "sweep":
            u = (self.imu.t - self.imu.t[0]) / (self.imu.t[-1] - self.imu.t[0])
            span = float(self.imu.t[-1] - self.imu.t[0])
            nyquist = 0.5 / self.imu.dt
            low, high = 0.3 * nyquist, 0.8 * nyquist
            tone = size * np.sin(2.0 * math.pi * span * (low * u + 0.5 * (high - low) * u**2))
            gyro = imu.gyro.copy()
            gyro[:, int(own.integers(3))] += tone * (self.imu.dt if imu.kind == "increment" else 1.0)
            imu = replace(imu, gyro=gyro)
        n = len(fixes)
        fixes = replace(fixes, pos_std_ned=np.tile(self.stated[0], (n, 1)), vel_std_ned=np.tile(self.stated[1], (n, 1)))
        return Recording(imu, fixes, self.motion if self.with_reference else None)

    def _heading_dependent(self, fixes: GnssRecord, size: float, rng: np.random.Generator) -> GnssRecord:
        from insemu import earth

        heading = np.interp(fixes.t, self.motion.t, np.unwrap(self.motion.rpy[:, 2]))
        shift = np.zeros((len(fixes), 3))
        shift[:, int(rng.integers(2))] = size * np.cos(heading + rng.uniform(0.0, 2.0 * math.pi))
        return replace(fixes, llh=earth.move(fixes.llh, shift))


def _wrong(model: NoiseModel, rng: np.random.Generator) -> NoiseModel:
    def off(p: Any) -> Any:
        name = p.parameters_meta()[0].name
        return p.with_parameters({**p.parameters, name: p.parameters[name] * float(rng.uniform(1.0 / 1.2, 1.2))})

    return NoiseModel(tuple(off(p) for p in model))


def stage(
    seed: int, minutes: float = 10.0, rate_hz: float = 50.0, *, track: str | None = None, turn_on_bias: bool = False
) -> Stage:
    """Draw everything but the hidden effect.

    Parameters
    ----------
    turn_on_bias : bool
        Whether a turn-on bias is to be hidden: then no sensor believes in one.
    """
    rng = np.random.default_rng([seed, 1])
    kind = track or str(rng.choice(TRACKS))
    path = random_track(kind, 60.0 * minutes, np.random.default_rng([seed, 2]))
    ideal = ideal_imu(path, rate_hz, span=(path.start, path.start + 60.0 * minutes))
    grade = float(np.exp(rng.uniform(math.log(0.3), math.log(3.0))))
    gyro_n, accel_n = 1e-4 * grade, 1e-3 * grade
    style = int(rng.integers(2 if turn_on_bias else 3))

    def sensor(n: float) -> NoiseModel:
        if style == 1:
            return NoiseModel((WN(n), GM(n * float(rng.uniform(0.05, 0.3)), 1.0 / float(rng.uniform(100.0, 600.0)))))
        base = (WN(n), RW(n * float(np.exp(rng.uniform(math.log(2e-3), math.log(2e-2))))))
        return NoiseModel(base if style == 0 else (*base, RC(20.0 * n)))

    truth = {a: sensor(gyro_n if a.startswith("gyro") else accel_n) for a in AXES}
    sigma = float(np.exp(rng.uniform(math.log(0.02), math.log(0.6)))) * np.array([1.0, 1.0, 1.8])
    sigma_v = float(np.exp(rng.uniform(math.log(0.03), math.log(0.1)))) * np.array([1.0, 1.0, 1.5])
    lever = rng.uniform(-1.0, 1.0, 3)
    t = ideal.imu.t - ideal.imu.t[0]
    wave = 8.0 * np.sin(2.0 * np.pi * (t / t[-1] * rng.uniform(0.8, 2.5) + rng.random()))
    temperature = 25.0 + wave + 6.0 * (1.0 - np.exp(-t / 300.0))
    with_reference = bool(rng.random() < 0.5)
    off, off_v = rng.uniform(1.0 / 1.2, 1.2, 2), rng.uniform(1.0 / 1.2, 1.2, 2)
    stated = (sigma * off[[0, 0, 1]], sigma_v * off_v[[0, 0, 1]])
    nominal = Nominal(
        {a: _wrong(m, rng) for a, m in truth.items()},
        Gnss(rate=1.0, position_sigma=tuple(stated[0]), velocity_sigma=tuple(stated[1]), lever_arm=tuple(lever)),
        Initial(position_sigma=(0.1,) * 3, velocity_sigma=(0.05,) * 3, tilt_sigma=0.5 * _DEG, heading_sigma=1.0 * _DEG),
    )
    fix_hz = float(rng.choice([1.0, 1.0, 2.0]))
    return Stage(
        seed,
        kind,
        ideal.imu,
        ideal.reference,
        truth,
        sigma,
        sigma_v,
        fix_hz,
        lever,
        temperature,
        with_reference,
        nominal,
        stated,
    )


# -- hiding ---------------------------------------------------------------------------------------------------------------------------


def draw_use(effect: str, s: Stage, rng: np.random.Generator) -> tuple[EffectUse, Hidden]:
    """Draw sensor, axis and numbers; shaped effects at their datasheet scale, to be sized later."""
    n, dt = len(s.imu), s.imu.dt
    span = n * dt
    sensors: list[str] = [x for x in EFFECTS[effect].sensors if x in ("gyro", "accel")]
    sensor = str(rng.choice(sensors or [str(EFFECTS[effect].sensors[0])]))
    k = int(rng.integers(3))
    axis = "xyz"[k]
    name = f"{sensor}_{axis}"
    white = s.truth[name].processes[0].parameters["N"] if name in s.truth else 1.0
    sample = white / math.sqrt(dt)
    sign = float(rng.choice([-1.0, 1.0]))
    loud = float(rng.choice([1.0, 2.0, 4.0]))

    def on(value: float, size: int = 3, at: int | None = None) -> tuple[float, ...]:
        out = [0.0] * size
        out[k if at is None else at] = value
        return tuple(out)

    def scale(parameter: str) -> float:
        return sign * EFFECTS[effect].scale(parameter, sensor)

    def made(axes: tuple[str, ...], strength: float = 1.0, **values: Any) -> tuple[EffectUse, Hidden]:
        full = {key: v if isinstance(v, tuple) else (float(v),) for key, v in values.items()}
        return EffectUse(effect, sensor, full), Hidden(effect, sensor, axes, strength)

    groups = (NED, NED[:2], NED[2:])
    group = groups[int(rng.integers(3))]
    where = np.array([float(a in group) for a in NED])
    pair = int(rng.integers(6))
    cell = int(rng.integers(9))
    high = 0.5 / dt
    makers: dict[str, Callable[[], tuple[EffectUse, Hidden]]] = {
        "white_noise": lambda: made((axis,), loud, N=on(white * math.sqrt((1.0 + 0.45 * loud) ** 2 - 1.0))),
        "random_walk": lambda: made((axis,), K=on(abs(scale("K")))),
        "gauss_markov": lambda: made(
            (axis,), sigma=on(abs(scale("sigma"))), beta=(1.0 / math.exp(rng.uniform(math.log(20.0), math.log(0.3 * span))),) * 3
        ),
        "flicker": lambda: made((axis,), B=on(abs(scale("B")))),
        "ramp": lambda: made((axis,), R=on(scale("R"))),
        "turn_on_bias": lambda: made((axis,), value=on(scale("value"))),
        "scale_factor": lambda: made((axis,), value=on(scale("value"))),
        "scale_asymmetry": lambda: made((axis,), value=on(scale("value"))),
        "misalignment": lambda: made((CROSS[pair][0],), value=on(scale("value"), 6, pair)),
        "g_sensitivity": lambda: made(("xyz"[cell // 3],), value=on(scale("value"), 9, cell)),
        "temperature": lambda: made((axis,), c1=on(scale("c1"))),
        "gravity": lambda: made((), offset=scale("offset")),
        "earth_rate": lambda: made((), fraction=1.0),
        "imu_gnss_time_offset": lambda: made((), offset=scale("offset")),
        "clock_drift": lambda: made((), drift=scale("drift")),
        "lever_arm": lambda: made((axis,), value=on(scale("value"))),
        "gnss_multipath_step": lambda: made(
            (NED[k],), value=on(scale("value")), start=float(rng.uniform(0.15, 0.7) * span), duration=float(rng.uniform(20.0, 90.0))
        ),
        "gnss_noise_level": lambda: made(group, loud, factor=tuple(1.0 + where * (0.4 + 0.4 * loud))),
        "gnss_velocity_noise": lambda: made(group, loud, factor=tuple(1.0 + where * (0.4 + 0.4 * loud))),
        "gnss_correlated_noise": lambda: made(
            NED, loud, sigma=tuple(0.7 * loud * s.sigma), tau=float(math.exp(rng.uniform(math.log(10.0), math.log(100.0))))
        ),
        "gnss_outliers": lambda: made(NED, loud, probability=float(rng.uniform(0.01, 0.05)), sigma=tuple(5.0 * loud * s.sigma)),
        "vibration_line": lambda: made(
            (axis,), loud, amplitude=on(12.0 * loud * white / math.sqrt(span)), frequency=float(rng.uniform(0.4, 0.9) * high)
        ),
        "vibration_band": lambda: made(
            (axis,), loud, rms=on(0.25 * loud * sample), frequency=float(rng.uniform(0.5, 0.8) * high), bandwidth=float(0.04 * high)
        ),
        "quantization": lambda: made((axis,), loud, lsb=on(0.5 * loud * sample)),
        "decimation_filter": lambda: made((), loud, cutoff=float(0.8 * high / (1.0 + 0.2 * loud)), order=2.0),
        "outliers": lambda: made((axis,), loud, probability=1e-3, sigma=on(5.0 * loud * sample)),
        "saturation": lambda: made((axis,), loud, limit=_limits(s, sensor, k, loud)),
        "dropped_samples": lambda: made((), loud, probability=1e-3 * loud, burst=float(rng.integers(1, 4))),
    }  # fmt: skip
    return makers[effect]()


def _limits(s: Stage, sensor: str, k: int, loud: float) -> tuple[float, ...]:
    """Full scale of one axis such that ``loud`` in a thousand samples lie beyond it; the other axes have room."""
    imu = s.record().imu  # a sensor's constant shifts what it clips
    values = np.abs((imu.gyro if sensor == "gyro" else imu.accel) / (imu.dt if imu.kind == "increment" else 1.0))
    out = 10.0 * values.max(axis=0) + 1.0
    out[k] = float(np.quantile(values[:, k], 1.0 - 1e-3 * loud))
    return tuple(float(x) for x in out)


#: Effects with one number that the trial sizes to a wanted evidence.
_SIZED = {
    "ramp": "R", "turn_on_bias": "value", "scale_factor": "value", "scale_asymmetry": "value", "misalignment": "value",
    "g_sensitivity": "value", "temperature": "c1", "gravity": "offset", "imu_gnss_time_offset": "offset", "clock_drift": "drift",
    "lever_arm": "value", "gnss_multipath_step": "value",
}  # fmt: skip
_DRAWN = {"random_walk": "K", "gauss_markov": "sigma", "flicker": "B"}


def whitened_difference(a: FilterResult, b: FilterResult) -> float:
    """Half the squared difference of two runs' innovations, whitened with the first one's covariance: nats."""
    total = 0.0
    _, here, there = np.intersect1d(a.fixes.t, b.fixes.t, return_indices=True)
    for k, j in zip(here, there, strict=True):
        rows = np.isfinite(a.fixes.innovation[k]) & np.isfinite(b.fixes.innovation[j])
        d = (b.fixes.innovation[j] - a.fixes.innovation[k])[rows]
        if d.size:
            total += 0.5 * float(d @ np.linalg.solve(a.fixes.S[k][np.ix_(rows, rows)], d))
    return total


def log_score(result: FilterResult, after: float = -math.inf) -> float:
    """Log score of the innovations of the fixes after a time."""
    total = 0.0
    for k in np.flatnonzero(result.fixes.t > after):
        rows = np.isfinite(result.fixes.innovation[k])
        v, S = result.fixes.innovation[k][rows], result.fixes.S[k][np.ix_(rows, rows)]
        if v.size:
            total -= 0.5 * (float(v @ np.linalg.solve(S, v)) + float(np.linalg.slogdet(S)[1]))
    return total


def size_effect(
    s: Stage, clean: Callable[[], Prepared], use: EffectUse, hidden: Hidden, target: float
) -> tuple[EffectUse, Hidden]:
    """Give an effect the size at which it is worth ``target`` nats in this recording, or as large as it may get.

    A random process is sized by its own draw, which the trial repeats; its evidence is less than its signal's, so the target is raised.
    """
    key = _SIZED.get(use.id) or _DRAWN.get(use.id)
    if key is None:
        return use, replace(hidden, nats=_level_nats(s, use))
    without = clean()
    half = whitened_difference(without.result, without.on(s.record((use,))).result)
    if not half > 0.0:
        return use, replace(hidden, nats=0.0)
    wanted = target if use.id in _SIZED else 3.0 * target + 10.0
    factor = min(math.sqrt(wanted / half), LARGEST)
    sized = scaled(use, factor)
    if use.id in _DRAWN:
        return sized, replace(hidden, strength=factor)
    # half - log(1 + 2 half) / 2 = 20 at half = 21.9
    return sized, replace(hidden, strength=factor, nats=paid(half * factor**2), scales_for_20=math.sqrt(21.9 / half))


def is_scaled(use: EffectUse) -> bool:
    """Whether the trial sizes this effect."""
    return use.id in _SIZED or use.id in _DRAWN


def scaled(use: EffectUse, factor: float) -> EffectUse:
    """An effect that the trial sizes, so many times as large; any other as it is."""
    if not is_scaled(use):
        return use
    key = _SIZED.get(use.id) or _DRAWN[use.id]
    return EffectUse(use.id, use.sensor, {**use.values, key: tuple(v * factor for v in use.values[key])})


def _level_nats(s: Stage, use: EffectUse) -> float:
    """Expected evidence of a level beyond its tolerance, n / 2 (r - 1 - log r), the level itself paid for; of a line, its frequency paid for."""
    if use.id == "vibration_line":
        axis = int(np.argmax(use["amplitude"]))
        n = s.truth[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        span = float(s.imu.t[-1] - s.imu.t[0])
        half = span * (use["amplitude"][axis] / (2.0 * n)) ** 2
        return max(half - math.log(0.5 * len(s.imu)) - math.log1p(half), 0.0)
    count = s.rate_hz * float(s.imu.t[-1] - s.imu.t[0])
    if use.id in ("gnss_noise_level", "gnss_velocity_noise"):
        # innovations hold more than the noise of the fixes, so this is an upper bound that a third of it stands for
        true, stated = (s.sigma, s.stated[0]) if use.id == "gnss_noise_level" else (s.sigma_v, s.stated[1])
        r = (np.maximum(np.array(use["factor"]) * true / stated / 1.22, 1.0)) ** 2
        return float(np.sum(0.5 * count * (r - 1.0 - np.log(r)))) / 3.0
    if use.id == "white_noise":
        axis = int(np.argmax(use["N"]))
        n = s.truth[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        believed = s.nominal.beliefs[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        ratio = max((n**2 + use["N"][axis] ** 2) / (1.22 * believed) ** 2, 1.0)
        return float(0.25 * len(s.imu) * (ratio - 1.0 - math.log(ratio)))
    return math.nan


def drawn_outliers(s: Stage, uses: Sequence[EffectUse], k: int) -> float:
    """What the outliers that were drawn add to the evidence, nats, the noise of their axis and everything else known; three numbers paid for."""
    own = uses[k]
    axis = int(np.argmax(own["sigma"]))
    name, sigma = f"{own.sensor}_{'xyz'[axis]}", own["sigma"][axis]
    # as many draws of everything, so that only the outliers differ
    none = replace(own, values={**own.values, "sigma": tuple(1e-12 * v for v in own["sigma"])})
    some = [
        u
        for u in uses
        if u.sensor != "gnss" and u.id not in ("saturation", "quantization", "dropped_samples", "clock_drift")
    ]
    made, without = (s.record([v if u is own else u for u in some]).imu for v in (own, none))
    width = made.dt if made.kind == "increment" else 1.0
    d = (getattr(made, own.sensor) - getattr(without, own.sensor))[:, axis] / width
    level = s.truth[name].processes[0].parameters["N"] ** 2
    level += sum(u["N"][axis] ** 2 for u in uses if u.id == "white_noise" and u.sensor == own.sensor)
    variance = level / made.dt
    wide, p = 1.0 + sigma**2 / variance, own.scalar("probability")
    x2 = d[np.abs(d) > 1e-6 * sigma] ** 2 / variance + 1.0
    share = math.log(p / (1.0 - p)) - 0.5 * math.log(wide) + 0.5 * x2 * (1.0 - 1.0 / wide)
    # ordinary samples pay for the outliers that they might be; those are four standard deviations wide at most
    paid_for = len(made) * p * (1.0 - math.erf(4.0 / math.sqrt(2.0 * wide)))
    gain = float(np.sum(np.log1p(np.exp(np.minimum(share, 700.0))))) - paid_for
    return max(gain - 3.0, 0.0)


#: Effects that shift the innovations by something of known shape; with those whose covariance is known they can be measured.
_SHAPED = frozenset({*_SIZED, "earth_rate"})
_MEASURED = _SHAPED | {*_DRAWN, "gnss_noise_level", "gnss_velocity_noise", "gnss_correlated_noise"}


def oracle_knows(uses: Sequence[EffectUse]) -> bool:
    """Whether :func:`oracle` covers these effects."""
    return bool(uses) and all(u.id in _MEASURED for u in uses)


def oracle(
    s: Stage, clean: Prepared, seen: Prepared, uses: Sequence[EffectUse], cut: float
) -> tuple[float, float, int]:
    """What knowing the truth is worth: nats over the whole recording, nats after ``cut``, fixes after ``cut``.

    Shaped effects: the twin without them. Random processes of the IMU: the filter that believes in them. Levels of the fixes: the filter with the
    true ones. Coloured fixes: the surrogate with the true process. NaN for effects that this does not cover (the fast ones and outliers).
    """
    fixes = int(np.sum(seen.result.fixes.t > cut))
    if not oracle_knows(uses):
        return math.nan, math.nan, fixes
    twin = s.record([u for u in uses if u.id not in _SHAPED])
    knowing, colour = _knowing(clean, uses)
    knowing = knowing.on(twin)
    whole = log_score(knowing.result) - log_score(seen.result)
    late = log_score(knowing.result, cut) - log_score(seen.result, cut)
    if colour is not None:
        surrogate = Surrogate.of(knowing.result)
        first = surrogate.until(cut)
        gain = surrogate.log_likelihood(None, colour) - surrogate.log_likelihood()
        whole += gain
        late += gain - (first.log_likelihood(None, colour) - first.log_likelihood())
    return whole, late, fixes


def _knowing(clean: Prepared, uses: Sequence[EffectUse]) -> tuple[Prepared, Colour | None]:
    """The filter that knows the processes and the levels of effects, not yet run, and the colour of the fixes."""
    beliefs = dict(clean.beliefs)
    factors = np.ones(6)
    colour = None
    for u in uses:
        if u.id in _DRAWN:
            k = int(np.argmax(u[_DRAWN[u.id]]))
            value = u[_DRAWN[u.id]][k]
            name = f"{u.sensor}_{'xyz'[k]}"
            process = (
                RW(value) if u.id == "random_walk" else BI(value) if u.id == "flicker" else GM(value, u["beta"][k])
            )
            beliefs[name] = beliefs[name] + process
        elif u.id == "gnss_noise_level":
            factors[:3] = u["factor"]
        elif u.id == "gnss_velocity_noise":
            factors[3:] = u["factor"]
        elif u.id == "gnss_correlated_noise":
            colour = (np.concatenate([u["sigma"], np.zeros(3)]), u.scalar("tau"))
    return replace(clean, beliefs=beliefs, factors=clean.factors * factors), colour


def worth_beside(s: Stage, clean: Callable[[], Prepared], uses: Sequence[EffectUse], k: int) -> float:
    """What effect ``k`` is expected to add beside the other hidden ones, nats; NaN where it is none of those that can be measured.

    The filter knows the processes, levels and colours of the others, and how each of their shapes shifts the innovations but not how much:
    what lies in those directions counts for nothing. Effects of the samples alone are left out; they are seen there.
    """
    if uses[k].id not in _MEASURED:
        return math.nan
    own = uses[k]
    some = [u for u in uses if u.id in _MEASURED]
    random = [u for u in some if u.id not in _SHAPED]
    knowing, colour = _knowing(clean(), [u for u in random if u is not own])
    base = knowing.on(s.record(random))
    surrogate = Surrogate.of(base.result)
    nu = base.result.fixes.innovation

    def shift(u: EffectUse) -> Array:
        fixes = knowing.on(s.record([*random, u])).result.fixes
        _, here, there = np.intersect1d(base.result.fixes.t, fixes.t, return_indices=True)
        rows = np.zeros_like(nu)
        rows[here] = np.nan_to_num(fixes.innovation[there] - nu[here])
        return white(rows)

    def white(rows: Array) -> Array:
        return np.asarray(surrogate.whiten(rows[:, :, None], None, colour)[0].ravel())

    directions = [shift(u) for u in some if u.id in _SHAPED and u is not own]
    basis = np.linalg.qr(np.stack(directions, axis=1))[0] if directions else np.zeros((nu.size, 0))
    if own.id in _SHAPED:
        d = shift(own)
        return paid(0.5 * float(d @ d - np.sum((basis.T @ d) ** 2)))
    full, both = _knowing(clean(), random)
    gain = _score(full.on(s.record(random)).result, both) - _score(base.result, colour)
    # shapes of unknown size follow some of what the process did
    return max(gain - 0.5 * float(np.sum((basis.T @ white(np.nan_to_num(nu))) ** 2)) - 3.0, 0.0)


def _score(result: FilterResult, colour: Colour | None) -> float:
    """Log score of a run, the colour of the fixes known."""
    if colour is None:
        return log_score(result)
    surrogate = Surrogate.of(result)
    return log_score(result) + surrogate.log_likelihood(None, colour) - surrogate.log_likelihood()
