"""What sensors make of a ride, and what is hidden in it: white noise, biases, fixes, and every hidden effect by code of this folder's own.

Effects carry the names and units of the program that is judged, so that answers can be compared; how they act is written here anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.foreign import aids
from benchmarks.foreign.flights import AIRCRAFT, flight
from benchmarks.foreign.motion import DT, RATE, VEHICLES, Array, Ride, Sensed, geodetic, plane, ride, sense

#: IMU samples are means over ten milliseconds, if nothing else is asked for.
IMU_DT = 10 * DT
#: Length of a stretch without fixes, s, and first rows of the IMU of which none is lost.
TUNNEL_S, SPARED = 30.0, 200
G = 9.80665
DEG = np.pi / 180.0
NEIGHBOURS = {"xy": (0, 1), "xz": (0, 2), "yx": (1, 0), "yz": (1, 2), "zx": (2, 0), "zy": (2, 1)}

#: Effects whose size is one number, with the size at which a data sheet would state them: gyroscope, accelerometer or whatever they act on.
SHAPED: dict[tuple[str, str], float] = {
    ("scale_factor", "gyro"): 2e-3,
    ("scale_factor", "accel"): 1e-3,
    ("misalignment", "gyro"): 2e-3,
    ("misalignment", "accel"): 1e-3,
    ("g_sensitivity", "gyro"): 2e-5,
    ("temperature", "gyro"): 2e-5,
    ("temperature", "accel"): 1e-3,
    ("lever_arm", "gnss"): 0.2,
    ("imu_gnss_time_offset", "imu"): 0.01,
}
#: What a bias jumps by, rad/s and m/s^2, before it is brought to what it is to be worth.
JUMPS = {"gyro": 5e-4, "accel": 0.02}
#: Effects of one size that are not often met, with a usual size: a lag of the temperature, an antenna that moves, positions that a receiver filters.
RARER: dict[tuple[str, str], float] = {
    ("temperature", "gyro"): 2e-5,
    ("temperature", "accel"): 1e-3,
    ("lever_arm_step", "gnss"): 0.5,
    ("gnss_position_filter", "gnss"): 0.5,
}
#: Least and largest time constant of a temperature that lags, s.
LAGS_S = (30.0, 90.0)
#: What no catalogue holds, by name, with a usual size.
OUTSIDE: dict[tuple[str, str], float] = {
    ("accel_square", "accel"): 2e-4,
    ("rate_times_force", "accel"): 2e-3,
    ("position_with_heading", "gnss"): 0.2,
    ("position_with_speed", "gnss"): 0.02,
}
#: Their equations; of an axis the next one is meant by ``{n}``.
EQUATIONS: dict[str, str] = {
    "accel_square": "{a} = force_{a} ** 2",
    "rate_times_force": "{a} = rate_{n} * force_{a}",
    "position_with_heading": "north = cos(heading)",
    "position_with_speed": "east = speed",
    "scale_factor_step": "{a} = {s}_{a}",
    "misalignment_step": "{a} = {s}_{n}",
}
#: What changes in the middle of a ride, with usual sizes.
CHANGED: dict[tuple[str, str], float] = {
    ("scale_factor_step", "gyro"): 5e-3,
    ("scale_factor_step", "accel"): 5e-3,
    ("misalignment_step", "gyro"): 5e-3,
    ("misalignment_step", "accel"): 5e-3,
}
#: Effects of fixes and processes that are drawn at a size of their own.
DRAWN = ("random_walk", "gnss_noise_level", "gnss_correlated_noise", "gnss_outliers", "gnss_multipath_step")
#: Gross errors of a receiver: share of the fixes, and their standard deviation (m), drawn on a log scale.
OUTLIER_SHARE, OUTLIER_M = (0.01, 0.05), (10.0, 1e4)
#: What shows in the samples rather than in the fixes.
BAND = ("white_noise", "vibration_line", "quantization", "decimation_filter", "outliers")


@dataclass(frozen=True)
class Hidden:
    """One effect: what it is called, where it sits, and its parameters in SI units."""

    effect: str
    sensor: str
    axis: str
    values: dict[str, float]

    @property
    def equation(self) -> str:
        """What no catalogue holds, as an equation; empty for the rest."""
        axis = self.axis[:1]
        signal = "rate" if self.sensor == "gyro" else "force"
        return EQUATIONS.get(self.effect, "").format(a=axis, n="xyz"["xyz".find(axis) - 2], s=signal)

    @property
    def size(self) -> float | None:
        """What it is proportional to; None where its size is no amplitude of what the fixes show."""
        return self.values.get("value", self.values.get("K"))

    def scaled(self, factor: float) -> Hidden:
        """With its one size times a factor."""
        # what a tracker is behind goes with the square of its time constant
        factor = np.sqrt(factor) if self.effect == "gnss_position_filter" else factor
        name = "value" if "value" in self.values else "K"
        return replace(self, values={**self.values, name: float(factor * self.values[name])})

    def plain(self) -> dict[str, Any]:
        """As plain data."""
        return {"effect": self.effect, "sensor": self.sensor, "axis": self.axis, "values": self.values}


@dataclass(frozen=True)
class Unit:
    """What is believed of a sensor: noise of its two triads, stated noise of the fixes, where the antenna sits."""

    gyro_white: float
    accel_white: float
    gyro_bias: float
    accel_bias: float
    gyro_walk: float
    accel_walk: float
    position: Array
    velocity: Array
    lever: Array
    fix_rate: float
    tilt: float = 0.3 * DEG
    heading: float = 0.6 * DEG

    def belief(self) -> dict[str, Any]:
        """The belief file of the recording."""
        gyro = f"WN(N={self.gyro_white:.6g}) + RC(sigma={self.gyro_bias:.6g}) + RW(K={self.gyro_walk:.6g})"
        accel = f"WN(N={self.accel_white:.6g}) + RC(sigma={self.accel_bias:.6g}) + RW(K={self.accel_walk:.6g})"
        return {
            "belief": {"gyro": gyro, "accel": accel},
            "gnss": {
                "position_sigma": [f"{v:.6g} m" for v in self.position],
                "velocity_sigma": [f"{v:.6g} m/s" for v in self.velocity],
                "lever_arm": [f"{v:.6g} m" for v in self.lever],
            },
            "initial": {"tilt_sigma": f"{self.tilt:.6g} rad", "heading_sigma": f"{self.heading:.6g} rad"},
        }


@dataclass(frozen=True)
class Logger:
    """How a recording comes about: rates, what the receiver gives, what the recorder loses.

    Parameters
    ----------
    imu_hz : int
        A divisor of the rate of the motion.
    fix_hz : float
        Of all receivers; 0: as drawn.
    velocities : bool
        Whether the receiver gives them.
    tunnels : int
        Stretches of :data:`TUNNEL_S` without fixes.
    lost, repeated : float
        Share of the rows that never came, and of those that repeat the row before.
    jitter : float
        Stamps of the IMU stray by up to this, s.
    """

    imu_hz: int = round(1.0 / IMU_DT)
    fix_hz: float = 0.0
    velocities: bool = True
    tunnels: int = 0
    lost: float = 0.0
    repeated: float = 0.0
    jitter: float = 0.0

    @property
    def every(self) -> int:
        """Steps of the motion in an IMU sample."""
        return round(RATE / self.imu_hz)

    @property
    def loses(self) -> bool:
        """Whether samples are lost."""
        return self.lost > 0.0 or self.repeated > 0.0

    def logged(self, out: dict[str, NDArray[Any]], rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """What the recorder makes of a recording."""
        out, t = dict(out), out["gnss_t"]
        if not self.velocities:
            out = {k: v for k, v in out.items() if k not in ("gnss_vel_ned", "gnss_vel_std_ned")}
        begin = t[-1] * (np.arange(self.tunnels) + 0.7) / (self.tunnels + 0.4)
        keep = ~np.any((t[:, None] > begin) & (t[:, None] < begin + TUNNEL_S), axis=1)
        out |= {k: v[keep] for k, v in out.items() if k.startswith("gnss_")}
        n = out["imu_t"].size
        stray, chance = rng.uniform(-self.jitter, self.jitter, n), rng.random((2, n))
        chance[:, :SPARED] = 1.0
        out["imu_t"] = out["imu_t"] + stray
        last = np.maximum.accumulate(np.where(chance[0] < self.repeated, 0, np.arange(n)))
        there = chance[1] >= self.lost
        return out | {"imu": out["imu"][last][there]} | {k: out[k][there] for k in ("imu_t", "temperature")}


@dataclass(frozen=True)
class World:
    """A drawn recording: the ride as ideal sensors see it, the unit, and the seed of its noise.

    Parameters
    ----------
    seed : int
    vehicle : str
    ride : Ride
    sensed : Sensed
    unit : Unit
    reference : bool
        Whether the recording says where it started.
    logger : Logger
    aids : bool
        Whether an odometer, a barometer and a heading are recorded.
    """

    seed: int
    vehicle: str
    ride: Ride
    sensed: Sensed
    unit: Unit
    reference: bool
    logger: Logger = field(default_factory=Logger)
    aids: bool = False

    def belief(self) -> dict[str, Any]:
        """The belief file of the recording."""
        out = self.unit.belief()
        if not self.logger.velocities:
            del out["gnss"]["velocity_sigma"]
        return out


def draw_unit(rng: np.random.Generator) -> Unit:
    """Draw the noise of an IMU and of a receiver, and where its antenna sits."""
    gyro, accel = 10.0 ** rng.uniform(-0.7, 0.7, 2)
    position = 10.0 ** rng.uniform(-1.7, 0.0) * np.array([1.0, 1.0, rng.uniform(1.2, 2.0)])
    velocity = 10.0 ** rng.uniform(-1.7, -1.0) * np.array([1.0, 1.0, rng.uniform(1.0, 1.6)])
    return Unit(
        gyro * 5e-5, accel * 1e-3, gyro * 5e-4, accel * 0.02, gyro * 2e-6, accel * 5e-5, position, velocity,
        rng.normal(0.0, (0.6, 0.3, 0.6)), float(rng.choice([1.0, 1.0, 4.0])),
    )  # fmt: skip


def draw_world(
    seed: int,
    seconds: float,
    vibration: bool,
    vehicles: Sequence[str] = VEHICLES,
    calm: float = 1.0,
    logger: Logger | None = None,
) -> World:
    """Draw vehicle, way, vibration (0.02 to 0.3 g and 0.2 to 5 deg/s, root mean square) and sensors.

    Parameters
    ----------
    seed : int
    seconds : float
    vibration : bool
        Whether a machine and the road shake the vehicle besides its own way of moving.
    vehicles : sequence of str
        Of :data:`motion.VEHICLES` and :data:`flights.AIRCRAFT`; one is drawn.
    calm : float
        Factor on the vibration that was drawn; everything else stays as it is.
    logger : Logger, optional
        How it is recorded.
    """
    rng = np.random.default_rng([seed, 1])
    vehicle = vehicles[0] if len(vehicles) == 1 else str(rng.choice(vehicles))
    shake = (
        float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))) * G * calm,
        float(np.exp(rng.uniform(np.log(0.2), np.log(5.0)))) * DEG * calm,
    )
    made = (flight if vehicle in AIRCRAFT else ride)(rng, vehicle, seconds, shake if vibration else None)
    unit, logger = draw_unit(rng), logger or Logger()
    unit = replace(unit, fix_rate=logger.fix_hz or unit.fix_rate)
    reference = vehicle not in ("car", "train") or bool(rng.integers(2))
    return World(seed, vehicle, made, sense(made), unit, reference, logger)


def draw_hidden(rng: np.random.Generator, world: World, what: str) -> Hidden:
    """Draw an effect: ``shaped``, ``drawn`` at its own size, ``jump``, ``rarer``, in the samples (``band``), ``outside``, ``outlier``, ``aid``."""
    unit, axis = world.unit, "xyz"[rng.integers(3)]
    sign = float(rng.choice([-1.0, 1.0]))
    if what in ("shaped", "outside"):
        table = SHAPED if what == "shaped" else OUTSIDE
        effect, sensor = list(table)[rng.integers(len(table))]
        if effect == "misalignment":
            axis = str(rng.choice(list(NEIGHBOURS)))
        elif effect == "g_sensitivity":
            axis += "xyz"[rng.integers(3)]
        elif sensor == "imu":
            axis = ""
        return Hidden(effect, sensor, axis, {"value": sign * table[effect, sensor]})
    if what == "rarer":
        effect, sensor = list(RARER)[rng.integers(len(RARER))]
        values = {"value": sign * RARER[effect, sensor]}
        if effect == "gnss_position_filter":
            return Hidden(effect, sensor, "", {"value": abs(values["value"])})
        if effect == "lever_arm_step":
            return Hidden(effect, sensor, axis, {**values, "start": float(rng.uniform(0.2, 0.7) * world.sensed.t[-1])})
        return Hidden(effect, sensor, axis, {**values, "lag": float(rng.uniform(*LAGS_S))})
    if what == "changed":
        effect, sensor = list(CHANGED)[rng.integers(len(CHANGED))]
        values = {"value": sign * CHANGED[effect, sensor], "start": float(rng.uniform(0.2, 0.7) * world.sensed.t[-1])}
        return Hidden(effect, sensor, axis, values)
    if what == "aid":
        return Hidden(*aids.draw_aid(rng, world))
    if what == "outlier":
        values = {
            "probability": float(rng.uniform(*OUTLIER_SHARE)),
            "sigma": float(np.exp(rng.uniform(*np.log(OUTLIER_M))) / unit.position[0]),
        }
        return Hidden("gnss_outliers", "gnss", "", values)
    if what == "jump":
        sensor = str(rng.choice(["gyro", "accel"]))
        values = {"value": sign * JUMPS[sensor], "start": float(rng.uniform(0.2, 0.8) * world.sensed.t[-1])}
        return Hidden("bias_step", sensor, axis, values)
    if what == "drawn":
        effect = str(rng.choice(DRAWN))
        if effect == "random_walk":
            sensor = str(rng.choice(["gyro", "accel"]))
            own = unit.gyro_walk if sensor == "gyro" else unit.accel_walk
            return Hidden(effect, sensor, axis, {"K": own * float(rng.uniform(10.0, 40.0))})
        if effect == "gnss_noise_level":
            return Hidden(effect, "gnss", "", {"factor": float(rng.uniform(1.7, 4.0))})
        if effect == "gnss_correlated_noise":
            return Hidden(
                effect, "gnss", "", {"sigma": float(rng.uniform(2.0, 5.0)), "tau": float(rng.uniform(8.0, 40.0))}
            )
        if effect == "gnss_outliers":
            return Hidden(
                effect,
                "gnss",
                "",
                {"probability": float(rng.uniform(0.02, 0.06)), "sigma": float(rng.uniform(8.0, 30.0))},
            )
        span = float(world.sensed.t[-1])
        values = {
            "value": sign * float(rng.uniform(5.0, 15.0)) * float(unit.position[0]),
            "start": float(rng.uniform(0.2, 0.5)) * span,
            "duration": float(rng.uniform(0.1, 0.25)) * span,
        }
        return Hidden(effect, "gnss", str(rng.choice(["north", "east", "down"])), values)
    effect, sensor = str(rng.choice(BAND)), str(rng.choice(["gyro", "accel"]))
    white = (unit.gyro_white if sensor == "gyro" else unit.accel_white) / np.sqrt(1.0 / world.logger.imu_hz)
    values = {
        "white_noise": {"factor": float(rng.uniform(2.0, 4.0))},
        "vibration_line": {
            "amplitude": white * float(rng.uniform(0.3, 1.0)),
            "frequency": float(rng.uniform(12.0, 45.0)),
        },
        "quantization": {"lsb": white * float(rng.uniform(3.0, 8.0))},
        "decimation_filter": {"cutoff": float(rng.uniform(12.0, 25.0)), "order": 2.0},
        "outliers": {"probability": 0.003, "sigma": white * float(rng.uniform(15.0, 40.0))},
    }[effect]
    return Hidden(effect, sensor, axis, values)


def draw_receiver(rng: np.random.Generator, world: World) -> list[Hidden]:
    """Draw a receiver that gives what its Kalman filter makes of measurements, and states how good that is: slow errors, little noise on them.

    Relative to what the unit states: ``begin`` and ``rest`` of its standard deviations, ``noise`` of a measurement; ``shade_K`` and ``until_K`` are
    times without satellites, in s, and ``lost_K`` is its standard deviation at the end of one that begins from nothing.
    """
    values = {
        "begin": float(rng.uniform(3.0, 8.0)),
        "rest": float(rng.uniform(0.4, 1.0)),
        "noise": float(rng.uniform(2.0, 6.0)),
    }
    for k in range(int(rng.integers(1, 4))):
        at = float(rng.uniform(0.1, 0.9) * world.sensed.t[-1])
        values |= {
            f"shade_{k}": at,
            f"until_{k}": at + float(rng.uniform(5.0, 20.0)),
            f"lost_{k}": float(rng.uniform(2.0, 6.0)),
        }
    white = Hidden("gnss_noise_level", "gnss", "", {"factor": float(rng.uniform(0.05, 0.3))})
    return [Hidden("gnss_correlated_noise", "gnss", "", values), white]


def record(world: World, hidden: Sequence[Hidden] = (), stated: float = 1.0) -> dict[str, NDArray[Any]]:
    """Arrays of a recording; with the same world every draw of noise is the same, whatever is hidden.

    Parameters
    ----------
    world : World
    hidden : sequence of Hidden
    stated : float
        Stated standard deviations of the fixes over the true ones.
    """
    unit, sensed = world.unit, world.sensed
    noise, other = np.random.default_rng([world.seed, 2]), np.random.default_rng([world.seed, 3])
    signals = {"gyro": sensed.rate.copy(), "accel": sensed.force.copy()}
    warm = 25.0 + 12.0 * (1.0 - np.exp(-sensed.t / 150.0)) + 4.0 * np.sin(sensed.t / 37.0)
    for h in hidden:
        _on_signals(h, sensed, signals, warm)
    for sensor, white, bias, walk in (
        ("gyro", unit.gyro_white, unit.gyro_bias, unit.gyro_walk),
        ("accel", unit.accel_white, unit.accel_bias, unit.accel_walk),
    ):
        level = white * noise.uniform(0.9, 1.1, 3) / np.sqrt(DT)
        drift = np.cumsum(noise.standard_normal((*sensed.t.shape, 3)), axis=0) * walk * np.sqrt(DT)
        drawn = noise.standard_normal((*sensed.t.shape, 3)) * level
        more = np.cumsum(noise.standard_normal(sensed.t.shape), axis=0) * np.sqrt(DT)
        for h in hidden:
            if (h.effect, h.sensor) == ("white_noise", sensor):
                drawn[:, "xyz".index(h.axis)] *= h.values["factor"]
            elif (h.effect, h.sensor) == ("random_walk", sensor):
                drift[:, "xyz".index(h.axis)] += h.values["K"] * more
        signals[sensor] += drawn + drift + bias * noise.standard_normal(3)
        for h in hidden:
            if (h.effect, h.sensor) == ("decimation_filter", sensor):
                signals[sensor] = _butterworth(signals[sensor], h.values["cutoff"])
    every = world.logger.every
    count = sensed.t.size // every
    means = {s: x[: count * every].reshape(count, every, 3).mean(axis=1) for s, x in signals.items()}
    t = sensed.t[every - 1 : count * every : every].copy()
    for h in hidden:
        _on_samples(h, t, means, other)
    for h in hidden:
        if h.effect == "imu_gnss_time_offset":
            t = t + h.values["value"]
    out: dict[str, NDArray[Any]] = {
        "imu_t": t,
        "imu": np.hstack([means["gyro"], means["accel"]]) * (every * DT),
        "imu_kind": np.array("increment"),
        "temperature": warm[every - 1 : count * every : every],
    }
    out = world.logger.logged({**out, **_fixes(world, hidden, stated)}, np.random.default_rng([world.seed, 7]))
    out |= aids.arrays(world, hidden) if world.aids else {}
    return {**out, **(_start(world) if world.reference else {})}


def _on_signals(h: Hidden, sensed: Sensed, signals: dict[str, Array], warm: Array) -> None:
    """Errors that are functions of what is sensed, added in place."""
    own = {"gyro": sensed.rate, "accel": sensed.force}.get(h.sensor)
    if own is None or "value" not in h.values:
        return
    first = "xyz".index(h.axis[0])
    value, true = h.values["value"], own[:, first]
    added = {
        "scale_factor": lambda: true,
        "misalignment": lambda: own[:, NEIGHBOURS[h.axis][1]],
        "g_sensitivity": lambda: sensed.force[:, "xyz".index(h.axis[1])],
        "temperature": lambda: _late(warm, h.values.get("lag", 0.0)) - 25.0,
        "bias_step": lambda: (sensed.t > h.values["start"]).astype(np.float64),
        "scale_factor_step": lambda: (sensed.t > h.values["start"]) * true,
        "misalignment_step": lambda: (sensed.t > h.values["start"]) * own[:, (first + 1) % 3],
        "accel_square": lambda: true**2 * np.sign(G),
        "rate_times_force": lambda: sensed.rate[:, (first + 1) % 3] * true,
    }.get(h.effect)
    if added is not None:
        signals[h.sensor][:, first] += value * added()


def _late(warm: Array, lag: float) -> Array:
    """A temperature seen by an element that takes a time constant (s) to follow it, in balance at first; sample by sample."""
    if lag == 0.0:
        return warm
    out, kept = np.empty_like(warm), 1.0 - DT / lag
    out[0] = warm[0]
    for k in range(1, warm.size):
        out[k] = kept * out[k - 1] + (1.0 - kept) * warm[k - 1]
    return out


def _tracked(place: Array, velocity: float, tau: float) -> Array:
    """Positions (n,) of a receiver that tracks with a velocity of its own: both are corrected at every step of the simulation."""
    state, speed = float(place[0]), velocity
    gain, rate = 2.0 * DT / tau, DT / tau**2
    out = np.empty_like(place)
    for k, true in enumerate(place.tolist()):
        state += speed * DT
        error = true - state
        state += gain * error
        speed += rate * error
        out[k] = state
    return out


def _butterworth(x: Array, cutoff: float) -> Array:
    """The analogue second-order low-pass, causal, by its frequency response."""
    n = x.shape[0]
    m = 1 << (n + 4 * RATE).bit_length()
    s = 1j * np.fft.rfftfreq(m, DT) / cutoff
    padded = np.concatenate([np.repeat(x[:1], 2 * RATE, axis=0), x, np.repeat(x[-1:], m - n - 2 * RATE, axis=0)])
    return np.fft.irfft(np.fft.rfft(padded, axis=0) / (1.0 + np.sqrt(2.0) * s + s**2)[:, None], m, axis=0)[
        2 * RATE : 2 * RATE + n
    ]


def _on_samples(h: Hidden, t: Array, means: dict[str, Array], rng: np.random.Generator) -> None:
    """Errors of the samples that leave the unit, in place."""
    if h.effect not in ("vibration_line", "outliers", "quantization"):
        return
    axis, v = "xyz".index(h.axis), h.values
    x = means[h.sensor][:, axis]
    if h.effect == "vibration_line":
        x += v["amplitude"] * np.sin(2.0 * np.pi * v["frequency"] * t + 1.0)
    elif h.effect == "outliers":
        x += (rng.random(t.size) < v["probability"]) * rng.standard_normal(t.size) * v["sigma"]
    else:
        x[:] = v["lsb"] * np.round(x / v["lsb"])


def _fixes(world: World, hidden: Sequence[Hidden], stated: float) -> dict[str, NDArray[Any]]:
    """Position and velocity of the antenna with their noise."""
    unit, sensed, rng = world.unit, world.sensed, np.random.default_rng([world.seed, 4])
    every = round(RATE / unit.fix_rate)
    at = np.arange(every - 1, sensed.t.size - 1, every)
    lever = np.tile(unit.lever, (sensed.t.size, 1))
    for h in hidden:
        if h.effect in ("lever_arm", "lever_arm_step"):
            lever[:, "xyz".index(h.axis)] += h.values["value"] * (sensed.t > h.values.get("start", -1.0))
    arm = np.einsum("nij,nj->ni", sensed.attitude, lever)
    way = sensed.place + arm
    axes = plane(*world.ride.origin[:2])
    for h in hidden:
        if h.effect == "gnss_position_filter":
            north, east, down = (way @ axes).T
            begun = (sensed.velocity[0] + (arm[99] - arm[0]) / (99.0 * DT)) @ axes
            north, east = (
                _tracked(x, float(v), h.values["value"]) for x, v in zip((north, east), begun[:2], strict=True)
            )
            way = np.stack([north, east, down], axis=1) @ axes.T
    place = way[at]
    turned = (sensed.attitude[at + 1] - sensed.attitude[at - 1]) / (2.0 * DT)
    speed = sensed.velocity[at] + np.einsum("nij,nj->ni", turned, lever[at])
    t, n = sensed.t[at], at.size
    first, second, third, fourth = (rng.standard_normal((n, 3)) for _ in range(4))
    chance = rng.random(n)
    sigma, slow = unit.position * np.ones((n, 3)), np.zeros((n, 3))
    for h in hidden:
        if "begin" in h.values:
            sigma, slow = (x * unit.position for x in _received(t, h.values, third, fourth))
    white, velocity = first * sigma, second * unit.velocity
    position = white + slow
    for h in hidden:
        v = h.values
        if h.effect == "gnss_noise_level":
            # of the noise alone: neither a step nor a colour that is hidden beside it grows
            position += (v["factor"] - 1.0) * white
        elif h.effect == "gnss_correlated_noise" and "tau" in v:
            a = np.exp(-1.0 / (unit.fix_rate * v["tau"]))
            state = np.zeros((n, 3))
            state[0] = third[0]
            for k in range(1, n):
                state[k] = a * state[k - 1] + np.sqrt(1.0 - a * a) * third[k]
            position += v["sigma"] * sigma * state
        elif h.effect == "gnss_outliers":
            position += (chance < v["probability"])[:, None] * fourth * v["sigma"] * sigma
        elif h.effect == "gnss_multipath_step":
            inside = (t > v["start"]) & (t <= v["start"] + v["duration"])
            position[:, ("north", "east", "down").index(h.axis)] += v["value"] * inside
        elif h.effect == "position_with_heading":
            position[:, 0] += v["value"] * np.cos(world.ride.rpy[at, 2])
        elif h.effect == "position_with_speed":
            position[:, 1] += v["value"] * np.linalg.norm(sensed.velocity[at], axis=1)
    # the tangent plane of the start turns little over a ride, noise does not mind
    llh = geodetic(sensed.start + place + position @ axes.T)
    local = [plane(lat, lon) for lat, lon, _ in llh]
    vel = np.stack([axes_k.T @ w for axes_k, w in zip(local, speed, strict=True)]) + velocity
    ones = np.ones((n, 3))
    return {
        "gnss_t": t,
        "gnss_llh": llh * np.array([1.0 / DEG, 1.0 / DEG, 1.0]),
        "gnss_vel_ned": vel,
        "gnss_pos_std_ned": stated * sigma,
        "gnss_vel_std_ned": unit.velocity * ones,
    }


def _received(t: Array, v: dict[str, float], walk: Array, noise: Array) -> tuple[Array, Array]:
    """What a receiver's scalar Kalman filters state at times (n,), and what they are off by, (n, 3) each; both for steps and measurements of one."""
    variance, error, quiet = v["begin"] ** 2, v["begin"] * walk[0], v["rest"] ** 4 / v["noise"] ** 2
    shades = [(v[f"shade_{k}"], v[f"until_{k}"], v[f"lost_{k}"]) for k in range(3) if f"shade_{k}" in v]
    sigma, off = np.empty_like(walk), np.empty_like(walk)
    for k, now in enumerate(t):
        lost = next(
            (size**2 * (t[1] - t[0]) / (end - begin) for begin, end, size in shades if begin <= now < end), None
        )
        variance += quiet if lost is None else lost
        error = error + np.sqrt(quiet if lost is None else lost) * (walk[k] if k else 0.0)
        if lost is None:
            gain = variance / (variance + v["noise"] ** 2)
            error, variance = error + gain * (v["noise"] * noise[k] - error), (1.0 - gain) * variance
        sigma[k], off[k] = np.sqrt(variance), error
    return sigma, off


def _start(world: World) -> dict[str, NDArray[Any]]:
    """A reference every tenth of a second, as good as the unit's belief of its start: wrong by what it states."""
    sensed, unit = world.sensed, world.unit
    rng = np.random.default_rng([world.seed, 5])
    at = np.arange(99, sensed.t.size, 100)
    llh = geodetic(sensed.start + sensed.place[at])
    local = np.stack([plane(lat, lon) for lat, lon, _ in llh])
    C = np.einsum("nji,njk->nik", local, sensed.attitude[at])
    off = rng.standard_normal(3) * (unit.tilt, unit.tilt, unit.heading)
    skew = np.array([[0.0, -off[2], off[1]], [off[2], 0.0, -off[0]], [-off[1], off[0], 0.0]])
    C = (np.eye(3) + skew) @ C
    rpy = np.stack(
        [np.arctan2(C[:, 2, 1], C[:, 2, 2]), -np.arcsin(C[:, 2, 0]), np.arctan2(C[:, 1, 0], C[:, 0, 0])], axis=1
    )
    return {
        "ref_t": sensed.t[at],
        "ref_llh": llh * np.array([1.0 / DEG, 1.0 / DEG, 1.0]),
        "ref_vel_ned": np.einsum("nji,nj->ni", local, sensed.velocity[at]),
        "ref_rpy_deg": rpy / DEG,
    }
