"""A sinusoid of unknown phase."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.noise.block import StateBlock
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import MarkovParts, Process, counts

Array = NDArray[np.float64]


def _curve(m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any) -> None:  # pragma: no cover - compiled
    # the shape is the logit of 2 f dt
    x = 0.5 * math.pi / (1.0 + math.exp(-s[0]))
    dx = x * (1.0 - 2.0 * x / math.pi)
    sine = math.sin(x)
    for i in range(count):
        top = math.sin(m[i] * x)
        amplitude = top * top / (m[i] * sine)
        b[i] = 0.5 * amplitude * amplitude
        db[i] = amplitude * dx * (2.0 * top * math.cos(m[i] * x) - amplitude * math.cos(x)) / sine


@dataclass(frozen=True)
class SIN(Process):
    """Sinusoid of amplitude ``alpha`` and frequency ``f`` (Hz) with a phase drawn uniformly."""

    alpha: float | None = None
    f: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("alpha", "{u}", "positive", "amplitude"),
        Parameter("f", "Hz", "frequency", "frequency"),
    )
    REFUSED: ClassVar[Mapping[str, str]] = {
        "mli": "its phase has one draw; use gmwm",
    }
    single_draw: ClassVar[bool] = True
    curve = staticmethod(_curve)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        p, m = self.parameters, counts(m)
        x = np.pi * p["f"] * dt
        return np.asarray((p["alpha"] * np.sin(m * x) ** 2 / (m * np.sin(x))) ** 2)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))  # a line: no density away from its frequency

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        return np.asarray(0.5 * p["alpha"] ** 2 * np.cos(2.0 * np.pi * p["f"] * dt * np.asarray(lag)))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        p = self.parameters
        angle = 2.0 * math.pi * p["f"] * dt
        Phi = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        P0 = np.eye(2) * 0.5 * p["alpha"] ** 2
        return StateBlock(("SIN", "SIN.quadrature"), Phi, np.zeros((2, 2)), np.array([1.0, 0.0]), P0, 0.0, dt)

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(line=(self.parameters["f"], self.parameters["alpha"]))

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        p, done = self.parameters, 0
        phase = rng.uniform(0.0, 2.0 * math.pi)

        def following(out: Array) -> None:
            nonlocal done
            np.sin(2.0 * math.pi * p["f"] * dt * np.arange(done, done + out.size) + phase, out=out)
            out *= p["alpha"]
            done += out.size

        return following
