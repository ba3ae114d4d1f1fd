"""Slow Gaussian processes that can be asked at any time: sums of sines whose frequencies are quantiles of a spectrum."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError

Array = NDArray[np.float64]

#: Sines of a process: enough that its kurtosis is 3 - 1.5 / 32.
SINES = 32


@dataclass(frozen=True)
class SlowProcess:
    """A stationary process with the spectrum ``1 / (1 + (2 pi f time)^2)^2`` (a critically damped follower of white noise).

    Its derivative exists, so an angle may follow it. The same numbers come out for the same seed at whatever times it is asked.

    Parameters
    ----------
    sigma : float
        Standard deviation, in the unit of what it describes.
    time : float
        s; the process forgets itself within a few of them.
    seed : tuple of int
        Its own stream of randomness.
    """

    sigma: float
    time: float
    seed: tuple[int, ...] = (0,)
    _sines: tuple[Array, Array] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigma) and self.sigma >= 0.0 and np.isfinite(self.time) and self.time > 0.0):
            raise InputError(
                f"a slow process of sigma {self.sigma} and time {self.time} s, expected zero or more and a positive time"
            )
        rng = np.random.default_rng(self.seed)
        share = (np.arange(SINES) + rng.uniform(0.05, 0.95, SINES)) / SINES
        # distribution of the power over x = 2 pi f time: 2/pi (atan x + x / (1 + x^2))
        x = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 2000)])
        power = 2.0 / np.pi * (np.arctan(x) + x / (1.0 + x * x))
        rate = np.interp(share * power[-1], power, x) / self.time
        object.__setattr__(self, "_sines", (rate, rng.uniform(0.0, 2.0 * np.pi, SINES)))

    def __call__(self, t: ArrayLike) -> Array:
        """Values at times (n,) in s."""
        rate, phase = self._sines
        return self._sum(t, np.ones(SINES), rate, phase)

    def slope(self, t: ArrayLike) -> Array:
        """Derivatives at times (n,), per s."""
        rate, phase = self._sines
        return self._sum(t, rate, rate, phase + 0.5 * np.pi)

    def integral(self, t: ArrayLike) -> Array:
        """An antiderivative at times (n,), times s."""
        rate, phase = self._sines
        return self._sum(t, 1.0 / rate, rate, phase - 0.5 * np.pi)

    def _sum(self, t: ArrayLike, size: Array, rate: Array, phase: Array) -> Array:
        t = np.asarray(t, dtype=float)
        out = np.zeros(t.shape)
        if self.sigma > 0.0:
            _sines(t.ravel(), size * (self.sigma * np.sqrt(2.0 / SINES)), rate, phase, out.reshape(-1))
        return out


@njit(cache=True, nogil=True)
def _sines(t: Array, size: Array, rate: Array, phase: Array, out: Array) -> None:
    """Add sines at times."""
    for k in range(size.size):
        for i in range(t.size):
            out[i] += size[k] * np.sin(rate[k] * t[i] + phase[k])
