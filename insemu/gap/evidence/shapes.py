"""What a process looks like at unit level, as a climb asks for it: density and covariance with their derivatives by its shape parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, density, difference_covariance
from insemu.gap.evidence import kernels
from insemu.gap.evidence.band import Band
from insemu.noise import GM, WN, Process

Array = NDArray[np.float64]

#: Step in log by which a parameter is moved for derivatives where they have no closed form.
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
        data, process = self.data, self.process
        if isinstance(process, Band) and self.names == ("f", "ratio"):
            rows = process.slopes(math.exp(own[0]), math.exp(own[1]), data.f, data.dt)
            # its low end is white noise
            covariance, spectrum = _white(data.block, data.dt, data.differences.size)
            return Shape(rows[:, :-1], rows[:, -1:] * covariance, rows[:3, -1:] * spectrum)
        if (
            isinstance(process, GM)
            and self.names == ("beta",)
            and process.level.name == "sigma"
            and process.sigma == 1.0
        ):
            return _first_order(data, own[0])
        if not self.names:
            density, own_covariance = self.plain()
            rows, covariance = density[None, :], own_covariance[None, :]
        else:
            rows = derivatives(lambda x: self.plain(x)[0], own)
            covariance = derivatives(lambda x: self.plain(x)[1], own)
        return Shape(rows, covariance, spectrum_of(covariance[: 1 + len(own)]))

    def _covariance(self, process: Process, remembered: bool = False) -> Array:
        data, count = self.data, self.data.differences.size
        if not count:
            return np.zeros(0)
        if remembered:
            return difference_covariance(process, data.block, data.dt, count)
        return process.difference_covariance(data.block, data.dt, count)


def _first_order(data: Reduced, log_beta: float) -> Shape:
    """Shape of a Gauss-Markov process of unit variance in closed form; only its Allan variance at a block by differences."""
    dt, count = data.dt, data.differences.size
    square = data.remembered("half turns", lambda: np.asarray(np.sin(math.pi * dt * data.f) ** 2))
    low, here, high = (
        float(GM(1.0, math.exp(log_beta + s)).allan_variance(data.block, dt)) if count else 0.0
        for s in (-STEP, 0.0, STEP)
    )
    density, covariance = np.empty((3, data.f.size)), np.empty((3, count))
    allan = np.array([here, (high - low) / (2.0 * STEP), (high + low - 2.0 * here) / STEP**2])
    kernels.gauss_markov_slopes(math.exp(log_beta) * dt, data.block, square, allan, density, covariance)
    density *= dt
    return Shape(density, covariance, spectrum_of(covariance[:2]))


@lru_cache(maxsize=16)
def _white(block: int, dt: float, count: int) -> tuple[Array, Array]:
    """Covariance and spectrum of the block differences of white noise of unit density."""
    covariance = difference_covariance(WN(1.0), block, dt, count) if count else np.zeros(0)
    return covariance, spectrum_of(covariance[None, :])[0]
