"""Drives and flights for the blind trial: random tracks, random sensors, wrong nominal levels, and something hidden by the emulator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.trial.hidden import Hidden
from benchmarks.trial.tracks import TRACKS, random_track
from insemu import earth
from insemu.effects import CELLS, CROSS, EFFECTS, NED, XYZ, DriveLot, EffectUse
from insemu.emulate import corrupt, gnss_fixes, ideal_imu
from insemu.gap import Nominal
from insemu.noise import GM, RC, RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.scenario import Gnss, Initial

Array = NDArray[np.float64]
_DEG = math.pi / 180.0

#: Effects that a drive or flight can show.
DYNAMIC_EFFECTS = tuple(e.id for e in EFFECTS.values() if e.does("hidden") and "trial" not in e.absent)
#: Structure that no catalogue holds.
OUTSIDE = ("heading_dependent_gnss", "quadratic_accelerometer", "sweep")
#: Strengths of shaped effects are drawn so that they are worth one of these, nats.
TARGETS = (8.0, 15.0, 30.0, 60.0, 150.0, 600.0)
#: Off by so much at the most is what is believed.
OFF = 1.2


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
        """Emulate the recording, with effects hidden in it or with something that no catalogue holds.

        Parameters
        ----------
        effects : sequence of EffectUse
            Hidden effects of the catalogue.
        outside : str
            ``heading_dependent_gnss``, ``sweep`` or empty; any other name adds nothing here.
        size : float
            Amplitude of it: m, or rad/s.
        """
        imu_rng, gnss_rng, own = np.random.default_rng([self.seed, 7]).spawn(3)
        inertial = [u for u in effects if u.inertial]
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
            gyro[:, int(own.integers(3))] += tone * imu.widths()[:, 0]
            imu = replace(imu, gyro=gyro)
        n = len(fixes)
        fixes = replace(fixes, pos_std_ned=np.tile(self.stated[0], (n, 1)), vel_std_ned=np.tile(self.stated[1], (n, 1)))
        return Recording(imu, fixes, self.motion if self.with_reference else None)

    def _heading_dependent(self, fixes: GnssRecord, size: float, rng: np.random.Generator) -> GnssRecord:
        heading = np.interp(fixes.t, self.motion.t, np.unwrap(self.motion.rpy[:, 2]))
        shift = np.zeros((len(fixes), 3))
        shift[:, int(rng.integers(2))] = size * np.cos(heading + rng.uniform(0.0, 2.0 * math.pi))
        return replace(fixes, llh=earth.move(fixes.llh, shift))


def wrong(model: NoiseModel, rng: np.random.Generator) -> NoiseModel:
    """The belief: every level off by up to 20 %."""
    return NoiseModel(tuple(p.scaled(float(rng.uniform(1.0 / OFF, OFF))) for p in model))


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
    off, off_v = rng.uniform(1.0 / OFF, OFF, 2), rng.uniform(1.0 / OFF, OFF, 2)
    stated = (sigma * off[[0, 0, 1]], sigma_v * off_v[[0, 0, 1]])
    nominal = Nominal(
        {a: wrong(m, rng) for a, m in truth.items()},
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


def draw_use(effect: str, s: Stage, rng: np.random.Generator) -> tuple[EffectUse, Hidden]:
    """Draw sensor, axis and numbers; an effect with one size at its datasheet scale, to be sized later.

    Parameters
    ----------
    effect : str
        Catalogue id.
    s : Stage
        The recording that it will be hidden in.
    rng : Generator
    """
    e = EFFECTS[effect]
    inertial: list[str] = [x for x in e.sensors if x in ("gyro", "accel")]
    sensor = str(rng.choice(inertial or [str(e.sensors[0])]))
    k = int(rng.integers(3))
    name = f"{sensor}_{XYZ[k]}"
    white = s.truth[name].processes[0].parameters["N"] if name in s.truth else 1.0
    sign, loud = float(rng.choice([-1.0, 1.0])), float(rng.choice([1.0, 2.0, 4.0]))
    group = (NED, NED[:2], NED[2:])[int(rng.integers(3))]
    pair, cell = int(rng.integers(len(CROSS))), int(rng.integers(len(CELLS)))
    dt = s.imu.dt
    lot = DriveLot(
        sensor, k, sign, loud, group, pair, cell, white, dt, len(s.imu) * dt, s.sigma, rng, lambda: _limits(s, sensor, k, loud)
    )  # fmt: skip
    made = e.hidden(lot)
    values = {key: v if isinstance(v, tuple) else (float(v),) for key, v in made.values.items()}
    return EffectUse(effect, sensor, values), Hidden(effect, sensor, made.axes, made.strength)


def _limits(s: Stage, sensor: str, k: int, loud: float) -> tuple[float, ...]:
    """Full scale of one axis such that ``loud`` in a thousand samples lie beyond it; the other axes have room."""
    imu = s.record().imu  # a sensor's constant shifts what it clips
    values = np.abs((imu.gyro if sensor == "gyro" else imu.accel) / imu.widths())
    out = 10.0 * values.max(axis=0) + 1.0
    out[k] = float(np.quantile(values[:, k], 1.0 - 1e-3 * loud))
    return tuple(float(x) for x in out)


def scaled(use: EffectUse, factor: float) -> EffectUse:
    """An effect that the trial sizes, so many times as large; any other as it is."""
    key = use.effect.size
    if not key:
        return use
    return EffectUse(use.id, use.sensor, {**use.values, key: tuple(v * factor for v in use.values[key])})
