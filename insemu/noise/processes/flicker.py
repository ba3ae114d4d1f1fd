"""Bias instability: flicker noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws
from insemu.noise.onward import Source, check_held
from insemu.noise.parameters import Parameter
from insemu.noise.process import MarkovParts, NoiseModel, Process, counts
from insemu.noise.processes.gauss_markov import GM, first_order_wavelet

Array = NDArray[np.float64]


def _curve(m: Any, count: int, s: Any, shapes: int, order: int, b: Any, db: Any) -> None:  # pragma: no cover - compiled
    for i in range(count):
        b[i] = math.log(2.0) / math.pi


@lru_cache(maxsize=8)
def unit_difference_covariance(count: int) -> Array:
    """Autocovariance of the differences of successive averages of unit flicker, (count,); the same for every averaging time.

    The fourth difference of t^2 ln|t| / (2 pi), because averages of flicker are second differences of a process whose generalized
    covariance is -t^2 ln|t| / (4 pi).
    """
    if count == 0:
        return np.zeros(0)
    lag = np.arange(-2, count + 2, dtype=np.float64)
    magnitude = np.abs(lag)
    g = magnitude**2 * np.log(np.where(magnitude > 0, magnitude, 1.0))
    gamma = np.convolve(g, [1.0, -4.0, 6.0, -4.0, 1.0], mode="valid")
    far = np.arange(gamma.size) > 1000
    # the fourth difference cancels at long lags; there its leading term is -2 / lag^2
    gamma[far] = -2.0 / np.arange(gamma.size)[far] ** 2
    gamma /= 2.0 * math.pi
    gamma.setflags(write=False)
    return gamma


@dataclass(frozen=True)
class BI(Process):
    """Bias instability (flicker) ``B``: two-sided PSD B^2 / (2 pi f), flat Allan variance (2 ln 2 / pi) B^2 = (0.664 B)^2.

    A sample is the average of the continuous flicker over dt, which makes the Allan variance flat down to one sample. It has no finite
    state block: where one is needed, a sum of Gauss-Markov processes stands for it, one for every factor of 10 of the averaging times from
    ``tau_from`` to ``tau_to`` (s). Over the band of 1 to 1000 s its Allan variance is within 13 % of flicker's; :meth:`approximation` says
    it for any other.
    """

    B: float | None = None
    tau_from: float = 1.0
    tau_to: float = 1000.0
    PARAMETERS: ClassVar = (
        Parameter("B", "{u}", "positive", "bias instability"),
        Parameter("tau_from", "s", "positive", "shortest averaging time of the state block", optional=True),
        Parameter("tau_to", "s", "positive", "longest averaging time of the state block", optional=True),
    )
    REFUSED: ClassVar[Mapping[str, str]] = {
        "mli": "it has no state block of its own, only one that stands for it in a band; use gmwm"
    }
    curve = staticmethod(_curve)
    stationary: ClassVar[bool] = False
    own_block: ClassVar[bool] = False

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.full(np.shape(counts(m)), 2.0 * math.log(2.0) / math.pi * self.parameters["B"] ** 2)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        x = np.asarray(f, dtype=np.float64) * dt
        folded = scipy.special.zeta(3.0, x) + scipy.special.zeta(3.0, 1.0 - x)  # aliases of f^-1 sinc^2
        return np.asarray(self.parameters["B"] ** 2 * dt / (2.0 * np.pi**3) * np.sin(np.pi * x) ** 2 * folded)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.tau_from < self.tau_to:
            raise InputError(
                f"BI: the band from {self.tau_from:g} to {self.tau_to:g} s is empty, expected tau_from above 0 and below tau_to"
            )

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        return self.parameters["B"] ** 2 * unit_difference_covariance(count)

    def mean_variance(self, m: int, dt: float) -> float:
        """Between one sample and the record."""
        return self.parameters["B"] ** 2 * math.log(m) / math.pi

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        return MarkovParts(flicker=self.parameters["B"] ** 2)

    def block(self, dt: float) -> StateBlock:
        """State block of the sum of Gauss-Markov processes that stands for flicker between ``tau_from`` and ``tau_to``."""
        block = _unit_approximation(self.tau_from, self.tau_to).scaled(self.parameters["B"]).block(dt)
        return replace(block, names=tuple(f"BI.{k}" for k in range(1, block.n + 1)))

    def approximation(self, k: int, tau_from: float, tau_to: float) -> tuple[NoiseModel, float]:
        """Return ``(k x GM, error)``: correlation times spread over the band, least relative error of the Allan variance.

        Parameters
        ----------
        k : int
            Number of Gauss-Markov processes, at least 1.
        tau_from, tau_to : float
            Band of averaging times in s over which the flat Allan variance is matched.

        Returns
        -------
        NoiseModel, float
            The model and the largest relative error of its Allan variance over the band.
        """
        taus = np.geomspace(tau_from, tau_to, 40 * k)
        # an Allan variance of GM peaks at 1.89 correlation times; the outer processes sit a little inside the band's ends
        times = (
            np.geomspace(tau_from, tau_to, k + 2)[1:-1] / 1.89 if k == 1 else np.geomspace(tau_from, tau_to, k) / 1.89
        )
        fine = tau_from / 1000.0
        m = np.maximum(np.round(taus / fine), 1.0)
        curves = np.stack([2.0 * first_order_wavelet(fine / t, m) for t in times], axis=1)
        flat = float(self.allan_variance(1, 1.0))
        weights, _ = scipy.optimize.nnls(curves, np.ones(taus.size))
        error = float(np.max(np.abs(curves @ weights - 1.0)))
        parts = tuple(GM(math.sqrt(w * flat), 1.0 / t) for w, t in zip(weights, times, strict=True) if w > 0)
        return NoiseModel(parts), error

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:
        """Flicker is drawn as a whole: the transform of all samples is held."""
        check_held(n, self.symbol)
        gain = _flicker_gain(int(2 ** math.ceil(math.log2(max(2 * n, 8)))))
        size, done = 2 * gain.size - 2, 0
        buffer = np.empty(2 * size + 2)  # one block for both directions of the transform
        white, spectrum = buffer[:size], buffer[size:].view(np.complex128)
        draws.standard_normal(white, rng)
        np.fft.rfft(white, out=spectrum)
        spectrum *= gain
        np.fft.irfft(spectrum, size, out=white)
        total = 0.0

        def following(out: Array) -> None:
            nonlocal done, total
            out[:] = white[done : done + out.size]
            total, done = draws.running_sum(out, 0.0, self.parameters["B"], total), done + out.size

        return following


@lru_cache(maxsize=32)
def _unit_approximation(tau_from: float, tau_to: float) -> NoiseModel:
    """Gauss-Markov processes that stand for flicker with B = 1 in a band, one for every factor of 10."""
    return BI(1.0).approximation(max(1, round(math.log10(tau_to / tau_from))), tau_from, tau_to)[0]


@lru_cache(maxsize=4)
def _flicker_gain(size: int) -> Array:
    """Filter (size / 2 + 1,) that turns the transform of ``size`` white numbers into that of the first differences of unit flicker.

    The differences are stationary; circulant embedding of their autocovariance is exact.
    """
    gamma = unit_difference_covariance.__wrapped__(size // 2 + 1)  # too long to be remembered twice
    eigenvalues = np.maximum(np.fft.rfft(np.concatenate([gamma, gamma[-2:0:-1]])).real, 0.0)
    gain = np.sqrt(eigenvalues)
    gain.setflags(write=False)
    return gain
