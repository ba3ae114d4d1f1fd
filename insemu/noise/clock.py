"""The clock of a GNSS receiver: its offset and rate as lengths, driven by white noise and a random walk of the frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise.block import StateBlock

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Clock:
    """Bias and drift of a clock, times the speed of light (Brown & Hwang 2012, section 9.3).

    The levels are those of a small temperature-compensated quartz (``h_0`` = 2e-19 s, ``h_-2`` = 2e-20 /s there): ``white`` is
    ``c sqrt(h_0 / 2)``, ``walk`` is ``c pi sqrt(2 h_-2)``.

    Parameters
    ----------
    bias, drift : float
        Standard deviations at the start, m and m/s.
    white : float
        White noise of the frequency, m/sqrt(s).
    walk : float
        Random walk of the frequency, m/s/sqrt(s).

    Raises
    ------
    InputError
        A level that is negative or no number.
    """

    bias: float = 1e5
    drift: float = 100.0
    white: float = 0.095
    walk: float = 0.19

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"the clock's {name} is {value!r}, expected a number that is not negative")

    def block(self, dt: float) -> StateBlock:
        """Bias and drift over steps of ``dt`` seconds."""
        a, b = self.white**2, self.walk**2
        Q = np.array([[a * dt + b * dt**3 / 3.0, b * dt**2 / 2.0], [b * dt**2 / 2.0, b * dt]])
        P0 = np.diag([self.bias**2, self.drift**2])
        return StateBlock(("bias", "drift"), np.array([[1.0, dt], [0.0, 1.0]]), Q, np.array([1.0, 0.0]), P0, 0.0, dt)

    def simulate(self, t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Bias and drift, m and m/s, at times (n,) in s that increase, the first of them at the start."""
        drawn, start = rng.standard_normal((2, t.size)), np.array([self.bias, self.drift])
        bias, drift = start * drawn[:, 0]
        out = np.empty((t.size, 2))
        out[0] = bias, drift
        for k, dt in enumerate(np.diff(t), start=1):
            b = self.block(float(dt))
            # the square root of Q by hand: a clock without noise has none
            drives = np.sqrt(b.Q[1, 1])
            shared = b.Q[0, 1] / drives if drives > 0.0 else 0.0
            own = np.sqrt(max(b.Q[0, 0] - shared**2, 0.0))
            out[k] = b.Phi @ out[k - 1] + [shared * drawn[1, k] + own * drawn[0, k], drives * drawn[1, k]]
        return out[:, 0], out[:, 1]
