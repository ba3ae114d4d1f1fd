"""An odometer, a barometer and a heading of a foreign ride, and what is hidden in them; how an effect acts is written here anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.foreign.motion import DT, Array, geodetic, plane
from insemu.gap import Nominal
from insemu.gap.drive.aid_residuals import Measured, Smoothed
from insemu.gap.drive.preparation import Flown
from insemu.gap.evidence.aid_model import AidModel, AidNoise
from insemu.gap.problems.aids import nominal_model
from insemu.records import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.foreign.sensors import Hidden, World

DEG = np.pi / 180.0
#: Time between measurements, in steps of the motion, and the step of the first.
EVERY: Mapping[str, tuple[int, int]] = {"odometer": (100, 137), "barometer": (200, 171), "heading": (500, 203)}
#: Steps over which a wheel counts.
COUNTED = 50
ROWS = ("forward", "sideways", "down")
#: Effects that are so many numbers times what the ride shows, with usual sizes.
SHAPED: Mapping[tuple[str, str], Mapping[str, float]] = {
    ("odometer_scale_factor", "odometer"): {"value": 0.01},
    ("odometer_misalignment", "odometer"): {"yaw": 0.02},
    ("barometer_offset", "barometer"): {"value": 5.0},
    ("barometer_scale_factor", "barometer"): {"value": 0.03},
    ("heading_offset", "heading"): {"value": 2.0 * DEG},
    ("heading_deviation", "heading"): {"B": 2.0 * DEG, "C": 1.0 * DEG},
    ("aid_lag", "odometer"): {"lag": 0.1},
    ("aid_lag", "heading"): {"lag": 0.1},
}
#: Effects of the noise.
DRAWN = ("noise_level", "correlated_noise", "outliers")


@dataclass(frozen=True)
class Aids:
    """How good they are, in m/s, m and rad, and where they sit, m in body axes."""

    sigma: Mapping[str, Array]
    wheel: Array
    port: Array

    @classmethod
    def of(cls, seed: int) -> Aids:
        """Drawn for a ride."""
        rng = np.random.default_rng([seed, 8])
        forward = 10.0 ** rng.uniform(-1.7, -0.7)
        sigma = {
            "odometer": forward * np.array([1.0, 2.0, 2.0]),
            "barometer": 10.0 ** rng.uniform(-0.7, 0.3, 1),
            "heading": DEG * 10.0 ** rng.uniform(-0.7, 0.3, 1),
        }
        return cls(sigma, rng.normal(0.0, (1.0, 0.5, 0.4)), rng.normal(0.0, (1.0, 0.5, 0.4)))


def draw_aid(rng: np.random.Generator, world: World) -> tuple[str, str, str, dict[str, float]]:
    """Effect, aid, row and numbers of something to be hidden, before it is brought to what it is to be worth."""
    if rng.random() < 0.6:
        effect, kind = list(SHAPED)[rng.integers(len(SHAPED))]
        sign = float(rng.choice([-1.0, 1.0])) if effect != "aid_lag" else 1.0
        return effect, kind, "", {name: sign * value for name, value in SHAPED[effect, kind].items()}
    kind, what = str(rng.choice(list(EVERY))), str(rng.choice(DRAWN))
    row = ROWS[rng.integers(3)] if kind == "odometer" and what != "outliers" else ""
    sigma = float(Aids.of(world.seed).sigma[kind][ROWS.index(row) if row else 0])
    if what == "noise_level":
        return f"{kind}_noise_level", kind, row, {"factor": float(rng.uniform(1.6, 4.0))}
    if what == "correlated_noise":
        size = sigma * float(rng.uniform(2.0, 6.0))
        return f"{kind}_correlated_noise", kind, row, {"sigma": size, "tau": float(rng.uniform(8.0, 40.0))}
    numbers = {"probability": float(rng.uniform(0.01, 0.05)), "sigma": sigma * float(rng.uniform(10.0, 30.0))}
    return "aid_outliers", kind, row, numbers


def arrays(world: World, hidden: Sequence[Hidden]) -> dict[str, NDArray[Any]]:
    """What the aids of a ride record, for a recording file."""
    made, out = Aids.of(world.seed), {}
    for number, (kind, (every, first)) in enumerate(EVERY.items()):
        own = [h for h in hidden if h.sensor == kind]
        at = np.arange(first, world.sensed.t.size - 1, every)
        late = sum(round(h.values["lag"] / DT) for h in own if h.effect == "aid_lag")
        values = _true(world, kind, np.clip(at - late, 1, world.sensed.t.size - 2), made)
        for h in own:
            values = _shaped(h, values)
        values = values + _noise(own, at.size, made.sigma[kind], every * DT, [world.seed, 9, number])
        out |= {
            f"aid_{kind}_t": world.sensed.t[at],
            f"aid_{kind}": values,
            f"aid_{kind}_std": np.tile(made.sigma[kind], (at.size, 1)),
            f"aid_{kind}_settings": {
                "odometer": np.append(made.wheel, np.zeros(3)), "barometer": made.port, "heading": np.zeros(1)
            }[kind],
        }  # fmt: skip
    return out


def _true(world: World, kind: str, at: NDArray[np.int64], made: Aids) -> Array:
    """What perfect instruments measure at steps (k,) of the motion, (k, rows)."""
    sensed = world.sensed
    if kind == "odometer":
        arm = np.gradient(sensed.attitude @ made.wheel, DT, axis=0)
        own = np.einsum("kji,kj->ki", sensed.attitude, sensed.velocity + arm)
        # a wheel counts its turn over a time, and says when the middle of it was
        way = np.concatenate([np.zeros((1, 3)), np.cumsum(own, axis=0)])
        first, last = np.maximum(at - COUNTED // 2, 0), np.minimum(at + COUNTED // 2 + 1, len(own))
        return (way[last] - way[first]) / (last - first)[:, None]
    if kind == "barometer":
        return geodetic(sensed.start + sensed.place[at] + sensed.attitude[at] @ made.port)[:, 2:]
    llh = geodetic(sensed.start + sensed.place[at])
    along = np.stack([plane(lat, lon).T @ C[:, 0] for (lat, lon, _), C in zip(llh, sensed.attitude[at], strict=True)])
    return np.arctan2(along[:, 1:2], along[:, :1])


def _shaped(h: Hidden, true: Array) -> Array:
    v = h.values
    if h.effect == "odometer_scale_factor":
        return true * np.array([1.0 + v["value"], 1.0, 1.0])
    if h.effect == "odometer_misalignment":
        c, s = np.cos(v["yaw"]), np.sin(v["yaw"])
        return np.column_stack([c * true[:, 0] + s * true[:, 1], c * true[:, 1] - s * true[:, 0], true[:, 2]])
    if h.effect in ("barometer_offset", "heading_offset"):
        return true + v["value"]
    if h.effect == "barometer_scale_factor":
        return true + v["value"] * (true - true.mean())
    if h.effect == "heading_deviation":
        return true + v["B"] * np.sin(true) + v["C"] * np.cos(true)
    return true


def _noise(own: Sequence[Hidden], n: int, sigma: Array, step: float, seed: list[int]) -> Array:
    """Errors (n, rows) at random."""
    rng, rows = np.random.default_rng(seed), sigma.size
    white, other, far = (rng.standard_normal((n, rows)) for _ in range(3))
    chance, level, added = rng.random(n), np.ones(rows), np.zeros((n, rows))
    for h in own:
        row = ROWS.index(h.axis) if h.axis else 0
        if h.effect.endswith("noise_level"):
            level[row] = h.values["factor"]
        elif h.effect.endswith("correlated_noise"):
            a, x = np.exp(-step / h.values["tau"]), other[0, row]
            for k in range(n):
                x = a * x + np.sqrt(1.0 - a * a) * other[k, row] if k else x
                added[k, row] += h.values["sigma"] * x
        elif h.effect == "aid_outliers":
            added += (chance < h.values["probability"])[:, None] * far * h.values["sigma"]
    return sigma * level * white + added


@dataclass(frozen=True)
class AidRuler:
    """What an effect of an aid shifts it by, in nats, beside its noise and the errors of the nominal filter."""

    smoothed: Smoothed
    still: Recording
    noise: tuple[Hidden, ...] = ()

    @classmethod
    def of(cls, still: Recording, nominal: Nominal) -> AidRuler:
        """Of a ride with nothing hidden."""
        return cls(Smoothed.of(Flown.of(still, nominal).prepared), still)

    def under(self, hidden: Sequence[Hidden]) -> AidRuler:
        """The ruler under the noise that is hidden too."""
        return replace(self, noise=tuple(h for h in hidden if (h.effect, h.sensor) not in SHAPED))

    def half(self, h: Hidden) -> float:
        """Half of the squared whitened shift, nats; NaN of what is random."""
        if (h.effect, h.sensor) not in SHAPED:
            return float("nan")
        aid = next(a for a in self.still.aids if a.kind == h.sensor)
        shown = self.smoothed.shown_to(aid)
        measured = None if shown is None else Measured.of(aid, shown)
        assert measured is not None
        model = nominal_model(measured, self.smoothed)
        model = replace(model, noise=self._noise(model, h.sensor))
        names = [k for k, (e, _) in enumerate(model.data.labels) if e == h.effect]
        _, A, _ = model.sums(names)
        size = np.array([h.values.get(model.data.labels[k][1], 0.0) for k in names])
        return 0.5 * float(size @ A @ size)

    def _noise(self, model: AidModel, kind: str) -> AidNoise:
        level, lasting = model.noise.level.copy(), {}
        for h in self.noise:
            row = ROWS.index(h.axis) if h.axis else 0
            if h.effect == f"{kind}_noise_level":
                level[row] *= h.values["factor"]
            elif h.effect == f"{kind}_correlated_noise":
                lasting[row] = (h.values["sigma"] / float(model.data.std[row]), h.values["tau"])
        return AidNoise(level, (), lasting)

    def scaled(self, h: Hidden, target: float) -> tuple[Hidden, float, float]:
        """At the size at which it is worth ``target``, what it is worth, and by what it was scaled."""
        factor = float(np.sqrt(target / max(self.half(h), 1e-12)))
        h = replace(h, values={k: factor * v for k, v in h.values.items()})
        return h, self.half(h), factor
