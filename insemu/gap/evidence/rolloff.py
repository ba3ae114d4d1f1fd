"""The low-pass of a sensor's output: its power gain, with derivatives in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.gap.evidence.modes import Free

Array = NDArray[np.float64]

#: Depth below the white noise to which a filtered spectrum is compared. Deeper, a bin is not even, and tapers and rounding are seen.
DEPTH = 1e-5
#: Frequency at which a window halves the power, times its length (two of them for the triangular one).
HALF_POWER = {"moving average": 0.44295, "triangular window": 0.31894}
#: Corner and frequencies times the sampling interval are held below these: at half the sampling rate a bilinear filter has no gain.
HIGHEST_CORNER, HIGHEST_F = 0.499, 0.4999
#: The least of them: its logarithm is a number.
LOWEST_F = 1e-300
#: Largest exponent of a Butterworth filter's loss: e to it is still a number.
LARGEST = 300.0


@njit(cache=True, nogil=True, error_model="numpy")
def _butterworth(corner: float, order: float, f: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Gain of a digital Butterworth filter (bilinear: the corner is where the power is halved); see :func:`gains`."""
    held = corner > HIGHEST_CORNER
    u = 2.0 * math.pi * min(corner, HIGHEST_CORNER)
    edge = math.log(math.tan(0.5 * u))
    # logarithm of the edge by that of the corner
    first = 0.0 if held else u / math.sin(u)
    second = 0.0 if held else u * (math.sin(u) - u * math.cos(u)) / math.sin(u) ** 2
    for i in range(f.size):
        e = 2.0 * order * (math.log(math.tan(math.pi * min(max(f[i], LOWEST_F), HIGHEST_F))) - edge)
        far = e > LARGEST
        g = 1.0 / (1.0 + math.exp(min(e, LARGEST)))
        lost = 0.0 if far else g * (1.0 - g)
        bent = (1.0 - 2.0 * g) * lost
        c, o = -2.0 * order * first, e
        out[0, i] = g
        out[1, i] = -lost * c
        out[2, i] = -lost * o
        out[3, i] = bent * c * c + lost * 2.0 * order * second
        out[4, i] = bent * c * o - lost * c
        out[5, i] = bent * o * o - lost * o


@njit(cache=True, nogil=True, error_model="numpy")
def _window(corner: float, power: int, f: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Gain of a mean over ``1 / corner`` (power 2), or of two of them (power 4); see :func:`gains`."""
    for i in range(f.size):
        z = math.pi * f[i] / corner
        s = math.sin(z) / z if z > 0.0 else 1.0
        s1 = s - math.cos(z)
        s2 = s1 - z * math.sin(z)
        rest = s ** (power - 2)
        out[0, i] = rest * s * s
        out[1, i] = power * rest * s * s1
        out[2, i] = power * rest * ((power - 1) * s1 * s1 + s * s2)


@njit(cache=True, nogil=True, error_model="numpy")
def _exponential(corner: float, f: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Gain of exponential smoothing; see :func:`gains`."""
    a = 2.0 * math.pi * corner
    A = 4.0 * math.sinh(0.5 * a) ** 2
    first = 2.0 * a * math.sinh(a)
    second = first + 2.0 * a * a * math.cosh(a)
    for i in range(f.size):
        q = 4.0 * math.sin(math.pi * f[i]) ** 2
        whole = A + q
        out[0, i] = A / whole
        out[1, i] = q * first / whole**2
        out[2, i] = q * (second - 2.0 * first * first / whole) / whole**2


def gains(kind: str, values: Sequence[float], f: Array, dt: float) -> Array:
    """Power gain of a low-pass, and its derivatives by the logarithms of its parameters.

    Parameters
    ----------
    kind : str
        As :class:`Rolloff` has it.
    values : sequence of float
        Corner (Hz), and the order of a Butterworth filter.
    f : (n,) array
        Hz.
    dt : float
        Sampling interval, s.

    Returns
    -------
    (3, n) or (6, n) array
        The gain; its derivatives by corner (and order); the second ones: both corners (corner and order, both orders).
    """
    corner, at = values[0] * dt, np.asarray(f * dt)
    out = np.empty((6 if kind == "butterworth" else 3, at.size))
    if kind == "butterworth":
        _butterworth(corner, values[1], at, out)
    elif kind == "exponential":
        _exponential(corner, at, out)
    else:
        _window(corner, 2 if kind == "moving average" else 4, at, out)
    return out


@dataclass(frozen=True)
class Rolloff:
    """A low-pass of the output: ``butterworth`` (corner and order), ``moving average`` (of length ``1 / corner``), ``triangular window``
    (two of them), ``exponential``.

    ``floor`` (a two-sided PSD) is added to measured and modelled spectrum alike, so that neither is compared where next to nothing is left.
    """

    kind: str
    values: tuple[float, ...]
    free: tuple[Free, ...]
    effect: str = "decimation_filter"
    floor: float = 0.0

    def gain(self, f: Array, dt: float) -> Array:
        """Power gain at frequencies ``f`` of samples at interval ``dt``."""
        return np.asarray(gains(self.kind, self.values, f, dt)[0])

    def delay(self, dt: float) -> float:
        """By how much a causal filter of this gain is late for slow signals, s."""
        corner = self.values[0]
        if self.kind == "moving average":
            return max(0.5 * (1.0 / corner - dt), 0.0)
        if self.kind == "triangular window":
            return max(1.0 / corner - dt, 0.0)
        if self.kind == "exponential":
            phi = math.exp(-2.0 * math.pi * corner * dt)
            return dt * phi / (1.0 - phi)
        edge = 2.0 / dt * math.tan(math.pi * min(corner * dt, HIGHEST_CORNER))
        return 1.0 / (edge * math.sin(0.5 * math.pi / max(self.values[1], 1.0)))
