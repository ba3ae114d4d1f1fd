"""A value that is held and redrawn after a fixed time: bias instability as Table I of Stebler et al. (2014) defines it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import carray
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.noise.block import StateBlock
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import Process, counts, of_structure

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _allan(m: float, held: float) -> float:  # pragma: no cover - compiled
    """Allan variance of averages of ``m`` samples of a process of unit variance that is held for a whole number of samples.

    From the variance V(m) of a sum of m samples, m^2 - (m^3 - m) / (3 held) up to the holding time and m held - (held^2 - 1) / 3 beyond:
    (4 V(m) - V(2 m)) / (2 m^2).
    """
    if 2.0 * m <= held:
        return (2.0 * m * m + 1.0) / (3.0 * m * held)
    beyond = (held * held - 1.0) / 3.0
    if m >= held:
        return (2.0 * m * held - 3.0 * beyond) / (2.0 * m * m)
    return (4.0 * (m * m - (m * m * m - m) / (3.0 * held)) - 2.0 * m * held + beyond) / (2.0 * m * m)


@njit(cache=True, nogil=True)
def _unit_allan(m: Array, held: float, value: Array, slope: Array) -> None:  # pragma: no cover - compiled
    """Allan variance for any holding time in samples, and its derivative by the logarithm of that time.

    The autocovariance max(0, 1 - lag / held) at whole lags is the mean of those of the two next whole holding times, weighted linearly in
    1 / held; so is all that is linear in it.
    """
    held = max(held, 1.0)
    low = math.floor(held)
    weight = (low + 1.0) * (1.0 - low / held)
    for i in range(m.size):
        first, second = _allan(m[i], low), _allan(m[i], low + 1.0)
        value[i] = first + weight * (second - first)
        slope[i] = low * (low + 1.0) / held * (second - first) if held > 1.0 else 0.0


def _curve(
    m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any
) -> None:  # pragma: no cover - compiled
    m, b, db = carray(m_, count), carray(b_, count), carray(db_, count)
    _unit_allan(m, math.exp(s_[0]), b, db)
    for i in range(count):
        b[i] *= 0.5
        db[i] *= 0.5


@dataclass(frozen=True)
class PWC(Process):
    """Piecewise-constant bias: a value of standard deviation ``sigma`` that is held for ``T`` and then drawn anew, independently.

    Bias instability with T_BI = ``T`` of Table I in Stebler et al. (2014). With the first redraw at a known instant the process is
    cyclo-stationary; here that instant is uniform over one holding time. Every closed form is the expectation over it, the
    autocovariance sigma^2 max(0, 1 - abs(t) / T), and a draw begins at a random instant of a holding time. A time that is no whole
    number of samples makes the numbers of samples per value alternate. It is not Gaussian jointly, so that standard errors of a fit, which take
    it for that, are approximate.

    No finite state block has this autocovariance. The block that stands for it in a filter has sigma^2 exp(-abs(t) / T) cos(t / T): the same
    variance, the same initial slope and curvature and the same integral. Its Allan variance is exact at times well below and well above T and
    17 % below to 21 % above in between; it is within 2 % below 0.18 T and beyond 25 T.
    """

    sigma: float | None = None
    T: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("sigma", "{u}", "positive", "standard deviation of the values"),
        Parameter("T", "s", "time", "time for which a value is held"),
    )
    REFUSED: ClassVar[Mapping[str, str]] = {
        "mli": "it has no state block of its own, only one that stands for it in a filter; use gmwm"
    }
    own_block: ClassVar[bool] = False
    curve = staticmethod(_curve)

    def _samples(self, dt: float) -> float:
        """Samples for which a value is held, at least 1: below, the samples are white."""
        return max(self.parameters["T"] / dt, 1.0)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        averages = np.array(counts(m))
        value, slope = np.empty(averages.size), np.empty(averages.size)
        _unit_allan(averages.ravel(), self._samples(dt), value, slope)
        return np.asarray(self.parameters["sigma"] ** 2 * value.reshape(averages.shape))

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        share = np.maximum(0.0, 1.0 - np.abs(np.asarray(lag, dtype=np.float64)) / self._samples(dt))
        return np.asarray(self.parameters["sigma"] ** 2 * share)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        held = self._samples(dt)
        low = math.floor(held)
        weight = (low + 1.0) * (1.0 - low / held)
        half = np.pi * np.asarray(f, dtype=np.float64) * dt
        first, second = ((np.sin(n * half) / np.sin(half)) ** 2 / n for n in (low, low + 1.0))  # Fejer kernels
        return np.asarray(self.parameters["sigma"] ** 2 * dt * ((1.0 - weight) * first + weight * second))

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        held, apart = self._samples(dt), m * np.arange(1.0, count + 2.0)
        own = self.mean_variance(m, dt) / self.parameters["sigma"] ** 2 if self.parameters["sigma"] else 0.0
        with_first = np.maximum(0.0, 1.0 - apart / held)  # a mean of a straight line, away from its bend
        offsets = np.arange(1.0 - m, m)
        for k in np.flatnonzero(np.abs(apart - held) < m):
            with_first[k] = np.maximum(0.0, 1.0 - (apart[k] + offsets) / held) @ (m - np.abs(offsets)) / m**2
        return self.parameters["sigma"] ** 2 * of_structure(2.0 * (own - with_first))[:count]

    def mean_variance(self, m: int, dt: float) -> float:  # noqa: D102
        held = self._samples(dt)
        low = math.floor(held)
        weight = (low + 1.0) * (1.0 - low / held)
        first, second = (
            m * m - (m**3 - m) / (3.0 * n) if m <= n else m * n - (n * n - 1.0) / 3.0 for n in (low, low + 1.0)
        )
        return float(self.parameters["sigma"] ** 2 * ((1.0 - weight) * first + weight * second) / m**2)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        variance, a = self.parameters["sigma"] ** 2, dt / self.parameters["T"]
        turn = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        driven = -math.expm1(-2.0 * a) * variance * np.eye(2)
        c = np.array([1.0, 0.0])
        return StateBlock(("PWC", "PWC.quadrature"), math.exp(-a) * turn, driven, c, variance * np.eye(2), 0.0, dt)

    def correlation_time(self, dt: float) -> float:  # noqa: D102
        return self.parameters["T"]

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        held, done, first = self._samples(dt), 0, 0
        phase = rng.uniform(0.0, held)
        values = np.empty(0)  # those from number ``first`` on

        def following(out: Array) -> None:
            nonlocal done, first, values
            which = ((np.arange(done, done + out.size) + phase) / held).astype(np.int64)
            if out.size:
                wanted = int(which[-1]) + 1 - first
                values = np.concatenate([values, rng.standard_normal(max(wanted - values.size, 0))])
                np.multiply(values[which - first], self.parameters["sigma"], out=out)
                first, values = int(which[-1]), values[-1:]
                done += out.size

        return following
