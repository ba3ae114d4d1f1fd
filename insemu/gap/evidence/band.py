"""Vibration coloured by a resonance, as a process: the second-order autoregression that a sampled resonance is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.noise import AR, WN, Parameter, Process, StateBlock

Array = NDArray[np.float64]


#: Most frequencies whose sines and cosines are remembered: a search asks for the same bins thousands of times.
MOST_REMEMBERED = 8192


def _turned(f: Array, dt: float) -> tuple[Array, Array]:
    angle = (2.0 * math.pi * dt) * f
    return np.cos(angle), np.sin(angle)


@lru_cache(maxsize=16)
def _turns(f: bytes, dt: float) -> tuple[Array, Array]:
    return _turned(np.frombuffer(f), dt)


@dataclass(frozen=True)
class Band(Process):
    """Noise of standard deviation ``sigma`` around ``f`` (Hz), full width at half power ``ratio`` times ``f``."""

    sigma: float | None = None
    f: float | None = None
    ratio: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("sigma", "{u}", "positive", "standard deviation"),
        Parameter("f", "Hz", "positive", "centre frequency"),
        Parameter("ratio", "1", "positive", "full width at half power over centre frequency"),
    )

    def coefficients(self, dt: float) -> tuple[float, float, float]:
        """Return ``(phi_1, phi_2, innovation variance)`` of the samples at interval ``dt``."""
        p = self.parameters
        r = math.exp(-math.pi * p["ratio"] * p["f"] * dt)
        phi1, phi2 = 2.0 * r * math.cos(2.0 * math.pi * p["f"] * dt), -r * r
        ratio = (1.0 - phi2) / ((1.0 + phi2) * ((1.0 - phi2) ** 2 - phi1**2))  # variance over innovation variance
        return phi1, phi2, p["sigma"] ** 2 / ratio

    def autoregression(self, dt: float) -> AR:
        """The same process in the noise room's form, for scenarios and filters."""
        phi1, phi2, sigma2 = self.coefficients(dt)
        return AR((phi1, phi2), sigma2=sigma2, rate_hz=1.0 / dt)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        phi1, phi2, sigma2 = self.coefficients(dt)
        at = np.asarray(f, dtype=np.float64)
        cosine, sine = _turns(at.tobytes(), dt) if at.size <= MOST_REMEMBERED else _turned(at, dt)
        # |1 - phi1 z - phi2 z^2|^2 with z turned back by its angle: nothing cancels near the resonance
        distance = ((1.0 - phi2) * cosine - phi1) ** 2 + ((1.0 + phi2) * sine) ** 2
        return np.asarray(sigma2 * dt / distance).reshape(at.shape)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:
        """By the low-frequency density: exact for averages much longer than the resonance's memory, where alone it is used."""
        return np.asarray(self.psd(0.0, dt) / (np.asarray(m, dtype=np.float64) * dt))

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:
        """That of white noise of the low-frequency density, for the same reason."""
        return WN(math.sqrt(float(self.psd(0.0, dt)))).difference_covariance(m, dt, count)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        return self.autoregression(dt).block(dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        self.autoregression(dt).fill(out, dt, rng)
