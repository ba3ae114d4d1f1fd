"""What a process looks like at unit level, as a climb asks for it: density and covariance with their derivatives by its shape parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, density, difference_covariance
from insemu.noise import Process

Array = NDArray[np.float64]

#: Step in log by which a parameter is moved for derivatives without a closed form: truncation (its square) and rounding of second differences
#: (1e-16 over its square) are alike.
STEP = 1e-4


def derivatives(of: Callable[[Sequence[float]], Array], x: Sequence[float]) -> Array:
    """A curve with its first and second derivatives by differences.

    Parameters
    ----------
    of : callable
        Curve (n,) of m numbers.
    x : (m,) sequence
        Where.

    Returns
    -------
    (1 + m + m (m + 1) / 2, n) array
        The curve, its m first and its second derivatives, in the order of :func:`pairs`.
    """
    m = len(x)

    def moved(*steps: int) -> Array:
        return of([v + STEP * s for v, s in zip(x, steps, strict=True)])

    unit = np.eye(m, dtype=int)
    here, plus, minus = of(x), [moved(*e) for e in unit], [moved(*-e) for e in unit]
    out = [here, *((a - b) / (2.0 * STEP) for a, b in zip(plus, minus, strict=True))]
    for i, j in pairs(m):
        if i == j:
            out.append((plus[i] + minus[i] - 2.0 * here) / STEP**2)
        else:
            both = moved(*(unit[i] + unit[j])) + moved(*(-unit[i] - unit[j]))
            out.append((both - plus[i] - minus[i] - plus[j] - minus[j] + 2.0 * here) / (2.0 * STEP**2))
    return np.stack(out)


@lru_cache(maxsize=16)
def pairs(m: int) -> tuple[tuple[int, int], ...]:
    """Pairs of m parameters, in the order of the second derivatives."""
    return tuple(combinations_with_replacement(range(m), 2))


def spectrum_of(covariances: Array) -> Array:
    """Spectra (k, frequencies) of stationary vectors, from their covariances (k, n), longer than the vectors are."""
    if not covariances.shape[1]:
        return covariances
    size = 1 << (2 * covariances.shape[1] - 1).bit_length()
    return np.asarray(2.0 * np.fft.rfft(covariances, size).real - covariances[:, :1])


@runtime_checkable
class Sloped(Protocol):
    """A process that knows its derivatives in closed form, at least by some of its parameters."""

    def log_slopes(self, names: Sequence[str], f: Array, dt: float, m: int, count: int) -> tuple[Array, Array] | None:
        """Density and covariance with first and second derivatives by logarithms of parameters; ``None`` where there is no closed form.

        Parameters
        ----------
        names : sequence of str
            The parameters.
        f : (k,) array
            Hz.
        dt : float
            Sampling interval, s.
        m : int
            Samples per block.
        count : int
            Lags of the covariance of the block differences.

        Returns
        -------
        density, covariance : (1 + n + n (n + 1) / 2, k), (..., count) arrays
            For n parameters, in the order of :func:`derivatives`.
        """


@dataclass(frozen=True)
class Shape:
    """A process at unit level with its derivatives by the logarithms of m shape parameters.

    Parameters
    ----------
    density, covariance : (1 + m + m (m + 1) / 2, bins), (..., lags) arrays
        Of the samples at the bins of the spectrum, of the block differences; first and second derivatives as :func:`derivatives` has them.
    spectrum : (1 + m, frequencies) array
        Of the block differences, with its first derivatives.
    """

    density: Array
    covariance: Array
    spectrum: Array


class Shaping:
    """Shapes of one process at a reduced axis.

    Parameters
    ----------
    data : Reduced
    process : Process
        At unit level.
    names : sequence of str
        Its free shape parameters.
    """

    def __init__(self, data: Reduced, process: Process, names: Sequence[str] = ()) -> None:
        self.data, self.process, self.names = data, process, tuple(names)

    def plain(self, own: Sequence[float] = ()) -> tuple[Array, Array]:
        """Density and covariance alone, at these logarithms of the shape parameters."""
        data, process = self.data, self.process
        if not self.names:
            return density(process, data.f, data.dt), self._covariance(process, remembered=True)
        # a climb hardly ever comes back to where it was: nothing is remembered
        moved = process.unchecked({n: math.exp(v) for n, v in zip(self.names, own, strict=True)})
        return moved.psd(data.f, data.dt), self._covariance(moved)

    def at(self, own: Sequence[float]) -> Shape:
        """The shape at these logarithms of the shape parameters."""
        data, rows = self.data, None
        if self.names and isinstance(self.process, Sloped):
            moved = self.process.unchecked({n: math.exp(v) for n, v in zip(self.names, own, strict=True)})
            rows = moved.log_slopes(self.names, data.f, data.dt, data.block, data.differences.size)
        if rows is None and self.names:
            rows = derivatives(lambda x: self.plain(x)[0], own), derivatives(lambda x: self.plain(x)[1], own)
        density, covariance = rows or (a[None, :] for a in self.plain())
        return Shape(density, covariance, spectrum_of(covariance[: 1 + len(own)]))

    def _covariance(self, process: Process, remembered: bool = False) -> Array:
        data, count = self.data, self.data.differences.size
        if not count:
            return np.zeros(0)
        if remembered:
            return difference_covariance(process, data.block, data.dt, count)
        return process.difference_covariance(data.block, data.dt, count)
