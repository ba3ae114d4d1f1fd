"""Stationary noise of a spectrum in blocks with windows whose squares sum to one, as coefficients of a quintic spline of displacement and turn."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
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
STREAMS = {"block": 0, "swing": 1, "wander": 2, "phase": 3, "slip": 4}


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
        self._parts = spectrum.parts
        self._held: OrderedDict[int, tuple[dict[int, Complex], dict[int, Array]]] = OrderedDict()
        self._factors: dict[int, Complex] = {}

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

    def _factor(self, regime: int) -> Complex:
        """From white numbers to coefficients, (bins, 6, 6), of a regime."""
        if regime not in self._factors:
            f = self._frequencies
            factor = self.spectrum.factors(regime, f) * np.sqrt(self.hop * self.rate)  # of one-sided densities
            self._factors[regime] = np.stack([self.moved(factor[:, :, j], f) for j in range(6)], axis=2)
        return self._factors[regime]

    @cached_property
    def _window(self) -> Array:
        return np.asarray(np.sin(np.pi * (np.arange(2 * self.hop) + 0.5) / (2 * self.hop)))

    def half(self, number: int, regime: int, which: int) -> Array:
        """Coefficients (6, hop) in body axes of one regime over the first or second half of a block.

        Regimes share white numbers, so that one passes into another without a blow; parts of one have their own.

        Parameters
        ----------
        number, regime : int
        which : {0, 1}
        """
        if number not in self._held:
            self._held[number] = {}, {}
            while len(self._held) > 3:
                self._held.popitem(last=False)
        whites, held = self._held[number]
        part = self._parts[regime]
        if part not in whites:
            rng = np.random.default_rng((self.seed, STREAMS["block"], number + (1 << 16), *([part] if part else [])))
            whites[part] = rng.standard_normal((self._frequencies.size, 12)).view(np.complex128)
        white = whites[part]
        if regime not in held:
            from scipy.fft import irfft

            bins = np.zeros((6, self.hop + 1), complex)
            _through(self._factor(regime), white, round(self._frequencies[0] * 2 * self.hop / self.rate), bins)
            held[regime] = irfft(bins, 2 * self.hop, axis=1, overwrite_x=True)
            held[regime] *= self._window
        return held[regime][:, which * self.hop : (which + 1) * self.hop]


@njit(cache=True, nogil=True)
def _through(factor: Complex, white: Complex, first: int, bins: Complex) -> None:
    """Bins (6, n) from the ``first`` on: factors times white numbers of unit variance in both parts, over the root of two."""
    for k in range(len(factor)):
        for i in range(6):
            total = 0.0j
            # the factors of rates and forces are lower triangular: turns come from the first three, displacements from what is before them
            for j in range(4 + i if i < 3 else i - 2):
                total += factor[k, i, j] * white[k, j]
            bins[i, first + k] = total * np.sqrt(0.5)
