"""Processes without a stationary state: random walk, ramp, random constant."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import MarkovParts, Process, counts

Array = NDArray[np.float64]


def _walk(m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any) -> None:  # pragma: no cover - compiled
    for i in range(count):
        b[i] = (2.0 * m[i] * m[i] + 1.0) / (12.0 * m[i])


def _ramp(m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any) -> None:  # pragma: no cover - compiled
    for i in range(count):
        b[i] = 0.25 * m[i] * m[i]


@dataclass(frozen=True)
class RW(Process):
    """Random walk of driving density ``K`` (increments K sqrt(dt)): Allan variance of its samples K^2 dt (2 m^2 + 1) / (6 m).

    ``sigma0`` is the standard deviation of the value before the first sample.
    """

    K: float | None = None
    sigma0: float = 0.0
    PARAMETERS: ClassVar = (
        Parameter("K", "{u}*sqrt(Hz)", "positive", "random-walk density"),
        Parameter("sigma0", "{u}", "positive", "initial standard deviation", optional=True),
    )
    stationary: ClassVar[bool] = False
    curve = staticmethod(_walk)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        m = counts(m)
        return self.parameters["K"] ** 2 * dt * (2.0 * m**2 + 1.0) / (6.0 * m)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return (self.parameters["K"] * dt / (2.0 * np.sin(np.pi * np.asarray(f) * dt))) ** 2

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        q = self.parameters["K"] ** 2 * dt
        return StateBlock(("RW",), np.eye(1), np.array([[q]]), np.ones(1), np.array([[self.sigma0**2]]), 0.0, dt)

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        step = self.parameters["K"] ** 2 * dt * m
        out = np.zeros(count)
        out[:2] = np.array([2.0 / 3.0 + 1.0 / (3.0 * m**2), 1.0 / 6.0 - 1.0 / (6.0 * m**2)])[:count] * step
        return out

    def mean_variance(self, m: int, dt: float) -> float:  # noqa: D102
        return self.parameters["K"] ** 2 * m * dt

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(walk=self.parameters["K"] ** 2 * dt)

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # noqa: D102
        return np.zeros((1, 1), dtype=bool), np.ones((1, 1), dtype=bool)

    def of_transition(self, Phi: Array, Q: Array, dt: float) -> Self:  # noqa: D102
        return self.with_parameters({"K": math.sqrt(float(Q[0, 0]) / dt)})

    def per_sample(self, dt: float) -> dict[str, str]:  # noqa: D102
        return {"K": f"γ² = {self.parameters['K'] ** 2 * dt:.4g}"}

    def as_white_and_walk(self, dt: float) -> tuple[float, float]:  # noqa: D102
        return 0.0, self.parameters["K"] ** 2

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        start, total = rng.standard_normal() * self.sigma0, 0.0

        def following(out: Array) -> None:
            nonlocal total
            draws.standard_normal(out, rng)
            total = draws.running_sum(out, start, self.parameters["K"] * math.sqrt(dt), total)

        return following


@dataclass(frozen=True)
class DR(Process):
    """Drift (rate ramp) of slope ``R``: sample k is R k dt, Allan variance R^2 tau^2 / 2.

    A filter that carries it knows the size of the slope and not its sign: value and slope start at zero with standard deviations 0 and R.
    """

    R: float | None = None
    PARAMETERS: ClassVar = (Parameter("R", "{u}/s", "real", "ramp slope"),)
    REFUSED: ClassVar[Mapping[str, str]] = {"mli": "its slope has one draw; remove the ramp"}
    stationary: ClassVar[bool] = False
    single_draw: ClassVar[bool] = True
    ramp: ClassVar[bool] = True
    curve = staticmethod(_ramp)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return 0.5 * (self.parameters["R"] * dt * counts(m)) ** 2

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))  # a deterministic ramp has no spectrum away from zero frequency

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        r = self.parameters["R"] ** 2
        Phi = np.array([[1.0, dt], [0.0, 1.0]])
        return StateBlock(("DR", "DR.slope"), Phi, np.zeros((2, 2)), np.array([1.0, 0.0]), np.diag([0.0, r]), 0.0, dt)

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(drift=self.parameters["R"] * dt)

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        done = 0

        def following(out: Array) -> None:
            nonlocal done
            np.multiply(self.parameters["R"] * dt, np.arange(done + 1.0, done + out.size + 1.0), out=out)
            done += out.size

        return following


@dataclass(frozen=True)
class RC(Process):
    """Random constant of standard deviation ``sigma``: the turn-on bias."""

    sigma: float | None = None
    PARAMETERS: ClassVar = (Parameter("sigma", "{u}", "positive", "standard deviation"),)
    REFUSED: ClassVar[Mapping[str, str]] = {
        "gmwm": "a random constant leaves no trace in one record's wavelet variance; leave it out",
        "mli": "a turn-on bias is estimated along with bias=True",
    }
    stationary: ClassVar[bool] = False  # one draw says nothing about the ensemble
    single_draw: ClassVar[bool] = True

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(counts(m)))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        variance = self.parameters["sigma"] ** 2
        return StateBlock(("RC",), np.eye(1), np.zeros((1, 1)), np.ones(1), np.array([[variance]]), 0.0, dt)

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        value = rng.standard_normal() * self.parameters["sigma"]

        def following(out: Array) -> None:
            out[:] = value

        return following
