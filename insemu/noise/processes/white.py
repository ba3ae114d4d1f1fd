"""White noise, and white noise of the integrated output: no memory beyond a sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import MarkovParts, Process, counts

Array = NDArray[np.float64]


def _white(m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any) -> None:  # pragma: no cover - compiled
    for i in range(count):
        b[i] = 0.5 / m[i]


def _quantized(
    m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any
) -> None:  # pragma: no cover - compiled
    for i in range(count):
        b[i] = 1.5 / (m[i] * m[i])


@dataclass(frozen=True)
class WN(Process):
    """White noise of density ``N``: two-sided PSD N^2, per-sample variance N^2 / dt, Allan variance N^2 / tau."""

    N: float | None = None
    PARAMETERS: ClassVar = (Parameter("N", "{u}/sqrt(Hz)", "positive", "white-noise density"),)
    curve = staticmethod(_white)

    @classmethod
    def of_variance(cls, variance: float, dt: float) -> WN:
        """The white noise whose samples at interval ``dt`` have this variance."""
        return cls(math.sqrt(variance * dt))

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return self.parameters["N"] ** 2 / (dt * counts(m))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.full(np.shape(f), self.parameters["N"] ** 2)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.where(np.asarray(lag) == 0, self.parameters["N"] ** 2 / dt, 0.0)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        return StateBlock.empty(dt, self.parameters["N"] ** 2 / dt)

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(white=self.parameters["N"] ** 2 / dt)

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # noqa: D102
        return np.zeros((0, 0), dtype=bool), np.zeros((0, 0), dtype=bool)

    def per_sample(self, dt: float) -> dict[str, str]:  # noqa: D102
        return {"N": f"σ² = {self.parameters['N'] ** 2 / dt:.4g}"}

    def as_white_and_walk(self, dt: float) -> tuple[float, float]:  # noqa: D102
        return self.parameters["N"] ** 2, 0.0

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        out = np.zeros(count)
        out[:2] = np.array([2.0, -1.0])[:count] * self.parameters["N"] ** 2 / (m * dt)
        return out

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        def following(out: Array) -> None:
            draws.standard_normal(out, rng)
            out *= self.parameters["N"] / math.sqrt(dt)

        return following


@dataclass(frozen=True)
class QN(Process):
    """Quantization noise ``Q`` of the integrated output: y_k = (q_k - q_(k-1)) / dt, var q = Q^2, Allan variance 3 Q^2 / tau^2."""

    Q: float | None = None
    PARAMETERS: ClassVar = (Parameter("Q", "({u})*s", "positive", "quantization of the integrated output"),)
    curve = staticmethod(_quantized)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return 3.0 * self.parameters["Q"] ** 2 / (dt * counts(m)) ** 2

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.asarray(4.0 * self.parameters["Q"] ** 2 / dt * np.sin(np.pi * np.asarray(f) * dt) ** 2)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        q = (self.parameters["Q"] / dt) ** 2
        lag = np.abs(np.asarray(lag))
        return np.where(lag == 0, 2.0 * q, np.where(lag == 1, -q, 0.0))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        q = self.parameters["Q"] ** 2
        # states are q_k and q_(k-1): an integrated quantity and its predecessor
        return StateBlock(
            ("QN", "QN.previous"),
            np.array([[0.0, 0.0], [1.0, 0.0]]),
            np.diag([q, 0.0]),
            np.array([1.0, -1.0]) / dt,
            np.eye(2) * q,
            0.0,
            dt,
        )

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(quantized=(self.parameters["Q"] / dt) ** 2)

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        out = np.zeros(count)
        out[:3] = np.array([6.0, -4.0, 1.0])[:count] * (self.parameters["Q"] / (m * dt)) ** 2
        return out

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        before = rng.standard_normal(1)

        def following(out: Array) -> None:
            nonlocal before
            drawn = np.concatenate([before, rng.standard_normal(out.size)])
            np.multiply(np.diff(drawn), self.parameters["Q"] / dt, out=out)
            before = drawn[-1:]

        return following
