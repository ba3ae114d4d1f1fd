"""Vibration coloured by a resonance, as a process: the second-order autoregression that a sampled resonance is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.noise import AR, WN, Parameter, Process, Source, StateBlock

Array = NDArray[np.float64]


#: Most frequencies whose sines and cosines are remembered: a search asks for the same bins thousands of times.
MOST_REMEMBERED = 8192


def _turned(f: Array, dt: float) -> tuple[Array, Array]:
    angle = (2.0 * math.pi * dt) * f
    return np.cos(angle), np.sin(angle)


#: Frequency zero.
_ZERO = np.zeros(1).tobytes()


@lru_cache(maxsize=16)
def _turns(f: bytes, dt: float) -> tuple[Array, Array]:
    return _turned(np.frombuffer(f), dt)


@njit(cache=True, nogil=True, error_model="numpy")
def resonance(a: float, angle: float, cosine: Array, sine: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Density over ``sigma^2 dt`` of a resonance that decays by ``a`` and turns by ``angle`` per sample, with its derivatives.

    It is ``tanh(a) (sinh(a)^2 + sin(angle)^2) / ((cosh(a) c - cos(angle))^2 + (sinh(a) s)^2)``.

    Parameters
    ----------
    a, angle : float
        rad per sample.
    cosine, sine : (n,) arrays
        c and s: of the frequencies, rad per sample.
    out : (6, n) array
        Written to: the density; its derivatives by the logarithms of the frequency (a and angle together) and of the bandwidth (a alone); the
        second ones, by both frequencies, both, and both bandwidths.
    """
    C, S, x, y = math.cosh(a), math.sinh(a), math.cos(angle), math.sin(angle)
    Q, tanh = S * S + y * y, S / C
    # logarithm of what does not depend on c and s
    top_a, top_p = 1.0 / (S * C) + 2.0 * S * C / Q, 2.0 * x * y / Q
    top_aa = -(C * C + S * S) / (S * C) ** 2 + 2.0 * (C * C + S * S) / Q - (2.0 * S * C / Q) ** 2
    top_ap = -4.0 * S * C * x * y / Q**2
    top_pp = 2.0 * (x * x - y * y) / Q - top_p**2
    for i in range(cosine.size):
        c, s = cosine[i], sine[i]
        near = C * c - x
        E = near * near + (S * s) ** 2
        ea, ep = 2.0 * S * (C - c * x) / E, 2.0 * y * near / E
        g = tanh * Q / E
        ha, hp = a * (top_a - ea), angle * (top_p - ep)
        haa = a * a * (top_aa - (2.0 * C * (C - c * x) + 2.0 * S * S) / E + ea * ea)
        hap = a * angle * (top_ap - 2.0 * S * c * y / E + ea * ep)
        hpp = angle * angle * (top_pp - 2.0 * (x * near + y * y) / E + ep * ep)
        hf = ha + hp
        out[0, i] = g
        out[1, i] = g * hf
        out[2, i] = g * ha
        out[3, i] = g * (hf * hf + haa + 2.0 * hap + hpp + hf)
        out[4, i] = g * (hf * ha + haa + hap + ha)
        out[5, i] = g * (ha * ha + haa + ha)


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

    def log_slopes(  # noqa: D102
        self, names: Sequence[str], f: Array, dt: float, m: int, count: int
    ) -> tuple[Array, Array] | None:
        if tuple(names) != ("f", "ratio"):
            return None
        p = self.parameters
        cosine, sine = _turns(f.tobytes() + _ZERO, dt)
        rows = np.empty((6, cosine.size))
        resonance(math.pi * p["ratio"] * p["f"] * dt, 2.0 * math.pi * p["f"] * dt, cosine, sine, rows)
        rows *= p["sigma"] ** 2 * dt
        # the last is that at zero: block differences see white noise of that density
        return rows[:, :-1], rows[:, -1:] * WN(1.0).difference_covariance(m, dt, count)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:
        """By the low-frequency density: exact for averages much longer than the resonance's memory, where alone it is used."""
        return np.asarray(self.psd(0.0, dt) / (np.asarray(m, dtype=np.float64) * dt))

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:
        """That of white noise of the low-frequency density, for the same reason."""
        return WN(math.sqrt(float(self.psd(0.0, dt)))).difference_covariance(m, dt, count)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        return self.autoregression(dt).block(dt)

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        return self.autoregression(dt).source(n, dt, rng)
