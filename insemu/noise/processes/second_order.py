"""The second-order Gauss-Markov process: two first-order lags with one time constant, smooth where the first-order process is jagged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy  # whose parts are imported when they are used
from numba import carray
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.noise.block import StateBlock
from insemu.noise.parameters import Parameter
from insemu.noise.process import Process
from insemu.noise.processes.gauss_markov import first_order

Array = NDArray[np.float64]

#: Step of the logarithm of the rate that gives the derivative of the wavelet variance.
STEP = 1e-4


@njit(cache=True, nogil=True)
def _second_order(m: Array, a: float, b: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance of unit variance: (1 + x) exp(-x) is exp(-x) less its derivative by the logarithm of the rate."""
    db = np.empty(m.size)
    first_order(m, a, b, db)
    for i in range(m.size):
        b[i] -= db[i]


def _curve(
    m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any
) -> None:  # pragma: no cover - compiled
    m, b, db = carray(m_, count), carray(b_, count), carray(db_, count)
    other = np.empty(count)
    _second_order(m, math.exp(s_[0]), b)
    _second_order(m, math.exp(s_[0] + STEP), db)
    _second_order(m, math.exp(s_[0] - STEP), other)
    for i in range(count):
        db[i] = (db[i] - other[i]) / (2.0 * STEP)


@dataclass(frozen=True)
class GM2(Process):
    """Second-order Gauss-Markov process: autocovariance ``sigma^2 (1 + beta |t|) exp(-beta |t|)``.

    Critically damped: ``x'' + 2 beta x' + beta^2 x`` is white noise of density 2 sigma beta^(3/2) (Brown and Hwang 2012, section 4.8).
    States are the value and its rate of change over beta, which have the same variance.
    """

    sigma: float | None = None
    beta: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("sigma", "{u}", "positive", "stationary standard deviation"),
        Parameter("beta", "1/s", "rate", "inverse time constant"),
    )
    curve = staticmethod(_curve)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        p = self.parameters
        a, variance = p["beta"] * dt, p["sigma"] ** 2
        Phi = math.exp(-a) * np.array([[1.0 + a, a], [-a, 1.0 - a]])
        # I - Phi Phi', where 1 - (1 + u + u^2 / 2) exp(-u) with u = 2 a is an incomplete gamma function: no digit cancels
        driven, mixed = float(scipy.special.gammainc(3.0, 2.0 * a)), 2.0 * a**2 * math.exp(-2.0 * a)
        Q = variance * np.array([[driven, mixed], [mixed, driven + 4.0 * a * math.exp(-2.0 * a)]])
        return StateBlock(("GM2", "GM2.rate"), Phi, Q, np.array([1.0, 0.0]), variance * np.eye(2), 0.0, dt)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        x = p["beta"] * dt * np.abs(np.asarray(lag, dtype=np.float64))
        return np.asarray(p["sigma"] ** 2 * (1.0 + x) * np.exp(-x))
