"""Stationary noise of a spectrum in blocks with windows whose squares sum to one, as coefficients of a quintic spline of displacement and turn."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.emulate.dynamics.spectrum import MotionSpectrum
from insemu.errors import InputError
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Children of a seed.
STREAMS = {"block": 0, "swing": 1, "wander": 2, "phase": 3, "slip": 4, "level": 5}
#: What makes up displacement and turn where axes have levels of their own: the axis whose level each has, and the column to which it adds. Forces
#: displace, pitch and roll displace against the gravity that they show, and rates turn.
OWN, ADDS = np.array([3, 4, 5, 1, 0, 0, 1, 2]), np.array([0, 1, 2, 0, 1, 3, 4, 5])


@dataclass(frozen=True)
class Mount:
    """A mount that is not rigid: the IMU follows the body as a mass on a spring.

    Parameters
    ----------
    frequency : float
        Of its resonance, Hz.
    damping : float
        Share of the critical one.
    """

    frequency: float
    damping: float = 0.1

    def __post_init__(self) -> None:
        if not (self.frequency > 0 and 0 < self.damping <= 2 and np.isfinite(self.frequency)):
            raise InputError(
                f"a mount of {self.frequency} Hz and damping {self.damping}, expected a positive frequency and a damping up to 2"
            )

    def response(self, f: Array) -> Complex:
        """Motion of the IMU over that of the body (transmissibility) at frequencies (n,)."""
        r = f / self.frequency
        damped = 2j * self.damping * r
        return np.asarray((1.0 + damped) / (1.0 - r * r + damped))


class Blocks:
    """White numbers of blocks through the factors of every regime.

    Parameters
    ----------
    spectrum : MotionSpectrum
    hop : int
        Knots from block to block; a block has twice as many.
    rate : float
        Knots per s.
    seed : int
    mount : Mount, optional
    """

    def __init__(self, spectrum: MotionSpectrum, hop: int, rate: float, seed: int, mount: Mount | None) -> None:
        self.spectrum, self.hop, self.rate, self.seed, self.mount = spectrum, hop, rate, seed, mount
        levels = spectrum.levels
        bands = 1 if levels is None else levels.edges.size - 1
        self.own: NDArray[np.int64]
        self.adds: NDArray[np.int64]
        self.own, self.adds = (
            (np.arange(6), np.arange(6)) if levels is None else (np.tile(OWN, bands), np.tile(ADDS, bands))
        )
        if levels is not None:  # levels are sorted by axes, then by bands
            self.own = self.own * bands + np.repeat(np.arange(bands), OWN.size)
        self._held: OrderedDict[int, tuple[Complex, dict[int, Array]]] = OrderedDict()
        self._factors: dict[int, tuple[Complex, NDArray[np.int64]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """For another process: what was drawn is drawn there again."""
        return self.__dict__ | {"_held": OrderedDict(), "_factors": {}}

    def moved(self, felt: Complex, f: Array) -> Complex:
        """Coefficients (k, 6) of displacement and turn in body axes of rates and specific forces (k, 6) at frequencies (k,)."""
        w = 2.0 * np.pi * np.maximum(f, 1e-9)
        spline = np.sinc(f / self.rate) ** 6
        mount = np.ones(f.shape) if self.mount is None else self.mount.response(f)
        angle = felt[:, :3] / (1j * w)[:, None]
        force = felt[:, 3:].copy()
        force[:, 0] -= STANDARD_GRAVITY * angle[:, 1]  # a tilt shows gravity
        force[:, 1] += STANDARD_GRAVITY * angle[:, 0]
        return np.concatenate([force * (-mount / (w * w * spline))[:, None], angle / spline[:, None]], axis=1)

    @cached_property
    def _frequencies(self) -> Array:
        f = np.asarray(np.fft.rfftfreq(2 * self.hop, 1.0 / self.rate), dtype=float)
        low, high = np.searchsorted(f, self.spectrum.frequencies[[0, -1]])
        return f[max(int(low), 1) : int(high) + 1]

    def _factor(self, regime: int) -> tuple[Complex, NDArray[np.int64]]:
        """From white numbers to coefficients, (channels, bins, 6), of a regime; and where they are not zero (channels, 3)."""
        if regime not in self._factors:
            f = self._frequencies
            factor = self.spectrum.factors(regime, f)
            made = self._columns(factor, f) if self.spectrum.levels is None else self._banded(factor, f)
            made = np.ascontiguousarray(np.swapaxes(made, 0, 1) * np.sqrt(0.5 * self.hop * self.rate))  # one-sided
            bins, columns = (made != 0.0).any(axis=2), (made != 0.0).any(axis=1)
            first, last, end = (np.argmax(x, axis=1) for x in (bins, bins[:, ::-1], columns[:, ::-1]))
            self._factors[regime] = made, np.stack([first, bins.shape[1] - last, 6 - end], axis=1)
        return self._factors[regime]

    def _columns(self, factor: Complex, f: Array) -> Complex:
        """:meth:`moved` of every column of factors (bins, 6, 6)."""
        return np.stack([self.moved(factor[:, :, j], f) for j in range(6)], axis=2)

    def _banded(self, factor: Complex, f: Array) -> Complex:
        """Factors (bins, channels, 6) of bands whose axes have a mean density of one each, before levels."""
        assert self.spectrum.levels is not None
        out = []
        for low, high in pairwise(self.spectrum.levels.edges):
            inside = ((f >= low) & (f < high))[:, None, None]
            mean = np.sum(np.abs(factor * inside) ** 2, axis=(0, 2)) / max(int(inside.sum()), 1)
            alike = factor * inside / np.sqrt(np.maximum(mean, 1e-300))[:, None]
            turned, forced = alike.copy(), alike.copy()
            turned[:, 3:], forced[:, :3] = 0.0, 0.0
            by_turn, by_force = self._columns(turned, f), self._columns(forced, f)
            out.append(np.concatenate([by_force[:, :3], by_turn[:, :2], by_turn[:, 3:]], axis=1))
        return np.concatenate(out, axis=1)

    @cached_property
    def window(self) -> Array:
        """Of a block (2 hop,), not yet laid over its coefficients."""
        return np.asarray(np.sin(np.pi * (np.arange(2 * self.hop) + 0.5) / (2 * self.hop)))

    def half(self, number: int, regime: int, which: int) -> Array:
        """Coefficients (channels, hop) in body axes of one regime over the first or second half of a block.

        Regimes share white numbers, so that one passes into another without a blow.

        Parameters
        ----------
        number, regime : int
        which : {0, 1}
        """
        if number not in self._held:
            rng = np.random.default_rng((self.seed, STREAMS["block"], number + (1 << 16)))
            self._held[number] = rng.standard_normal((self._frequencies.size, 12)).view(np.complex128), {}
            while len(self._held) > 3:
                self._held.popitem(last=False)
        white, held = self._held[number]
        if regime not in held:
            from scipy.fft import irfft

            bins = np.zeros((self.adds.size, self.hop + 1), complex)
            factor, extent = self._factor(regime)
            _through(factor, extent, white, round(self._frequencies[0] * 2 * self.hop / self.rate), bins)
            held[regime] = irfft(bins, 2 * self.hop, axis=1, overwrite_x=True)
        return held[regime][:, which * self.hop : (which + 1) * self.hop]


@njit(cache=True, nogil=True)
def _through(factor: Complex, extent: NDArray[np.int64], white: Complex, first: int, bins: Complex) -> None:
    """Bins (channels, n) from the ``first`` on: factors times white numbers of unit variance in both parts."""
    for i in range(len(bins)):
        for k in range(extent[i, 0], extent[i, 1]):
            total = 0.0j
            for j in range(extent[i, 2]):
                total += factor[i, k, j] * white[k, j]
            bins[i, first + k] = total
