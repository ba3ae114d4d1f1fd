"""The first-order Gauss-Markov process."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numba import carray
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError
from insemu.noise import onward
from insemu.noise.block import StateBlock
from insemu.noise.grammar import quantity
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import MarkovParts, Process, counts

Array = NDArray[np.float64]

#: Step in log of the rate for derivatives of an Allan variance by differences: truncation (its square) and rounding (1e-16 over it) are alike.
SLOPE_STEP = 1e-4


@njit(cache=True, nogil=True)
def first_order(m: Array, a: float, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance at averages of ``m`` samples of a unit-variance process with correlation exp(-a), and its derivative by log a.

    With u = m a it is (f(u) + 2 m (sinh a - a)) / (8 m^2 sinh^2(a / 2)), f(u) = 2 u - 3 + 4 exp(-u) - exp(-2 u), f' = 2 (1 - exp(-u))^2.

    Parameters
    ----------
    m : (J,) array
        Samples per average.
    a : float
        Decay per sample, sampling interval over correlation time; taken as 30 at most.
    b, db : (J,), (J,) arrays
        Overwritten: wavelet variances and derivatives.
    """
    if a > 30.0:
        a = 30.0
    sh = math.sinh(0.5 * a)
    excess = a * a * a * (1.0 / 6.0 + a * a * (1.0 / 120.0 + a * a / 5040.0)) if a < 0.02 else math.sinh(a) - a
    slope_excess = 2.0 * sh * sh  # cosh a - 1
    ratio = a * math.cosh(0.5 * a) / sh
    for i in range(m.size):
        u = m[i] * a
        if u < 0.3:
            # sum_k (-u)^k (4 - 2^k) / k! from k = 3
            term = -u * u * u / 6.0
            two = 8.0
            f = term * (4.0 - two)
            for k in range(4, 20):
                term *= -u / k
                two *= 2.0
                f += term * (4.0 - two)
        else:
            f = 2.0 * u + 4.0 * math.expm1(-u) - math.expm1(-2.0 * u)
        e = math.expm1(-u)
        d = 8.0 * m[i] * m[i] * sh * sh
        top = f + 2.0 * m[i] * excess
        b[i] = top / d
        db[i] = (2.0 * u * e * e + 2.0 * m[i] * a * slope_excess) / d - b[i] * ratio


@njit(cache=True, nogil=True, error_model="numpy")
def first_order_slopes(
    a: float, m: int, square: Array, allan: Array, density: Array, covariance: Array
) -> None:  # pragma: no cover - compiled
    """A first-order process of unit variance with its derivatives by the logarithm of its rate.

    Its density over dt is ``sinh(a) / (2 (sinh(a / 2)^2 + sin(w / 2)^2))``; differences of block means go together by ``(1 - exp(-m a))^2``
    times the covariance of neighbouring means, less by exp(-m a) with every further block.

    Parameters
    ----------
    a : float
        Rate times sampling interval.
    m : int
        Samples per block.
    square : (k,) array
        Squared sines of half the frequencies, rad per sample.
    allan : (3,) array
        Allan variance of block means, its derivative, the second one.
    density : (3, k) array
        Written to: density over the sampling interval, its derivative, the second one.
    covariance : (3, n) array
        Written to: covariance of the block differences at lags 0 to n - 1, its derivative, the second one.
    """
    S, C, half = math.sinh(a), math.cosh(a), math.sinh(0.5 * a) ** 2
    for i in range(square.size):
        E = 2.0 * (half + square[i])
        slope = a * (C / S - S / E)
        bend = slope + a * a * (-1.0 / (S * S) - C / E + (S / E) ** 2)
        g = S / E
        density[0, i], density[1, i], density[2, i] = g, g * slope, g * (slope * slope + bend)
    n = covariance.shape[1]
    if n == 0:
        return
    lost, kept = -math.expm1(-m * a), math.exp(-m * a)
    near = math.exp(-a) * (lost / math.expm1(-a) / m) ** 2
    # derivatives of the logarithms of lost (twice) and near
    turn, one = 2.0 * m * a * kept / lost, 2.0 * a * math.exp(-a) / -math.expm1(-a)
    slope, turned = turn - a - one, turn * (1.0 - m * a / lost)
    bend = turned - a - one * (1.0 + a / math.expm1(-a))
    for i in range(3):
        covariance[i, 0] = 2.0 * allan[i]
    if n > 1:
        value, up = near * lost, slope + 0.5 * turn
        covariance[0, 1], covariance[1, 1] = value - allan[0], value * up - allan[1]
        covariance[2, 1] = value * (up * up + bend + 0.5 * turned) - allan[2]
    far = -near * lost * lost
    for k in range(n - 2):
        later = k * m * a
        value, up = far * math.exp(-later), slope + turn - later
        covariance[0, k + 2], covariance[1, k + 2] = value, value * up
        covariance[2, k + 2] = value * (up * up + bend + turned - later)


def _curve(
    m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any
) -> None:  # pragma: no cover - compiled
    first_order(carray(m_, count), math.exp(s_[0]), carray(b_, count), carray(db_, count))


def first_order_wavelet(a: float, m: Array) -> Array:
    """Haar wavelet variance at averages of ``m`` samples of a unit-variance process with correlation exp(-a) between samples, a > 0."""
    averages = np.ascontiguousarray(np.atleast_1d(m).ravel(), dtype=np.float64)
    b, db = np.empty(averages.size), np.empty(averages.size)
    first_order(averages, a, b, db)
    return b.reshape(np.shape(m))


@dataclass(frozen=True)
class GM(Process):
    """First-order Gauss-Markov process: stationary standard deviation ``sigma``, inverse correlation time ``beta`` = 1/Tc.

    Sampled at dt it is an AR(1) with phi = exp(-beta dt) and innovation variance sigma^2 (1 - phi^2); the density of its continuous
    driving noise is sigma sqrt(2 beta).
    """

    sigma: float | None = None
    beta: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("sigma", "{u}", "positive", "stationary standard deviation"),
        Parameter("beta", "1/s", "rate", "inverse correlation time"),
    )
    curve = staticmethod(_curve)
    slows: ClassVar[bool] = True

    @classmethod
    def of_driving_density(cls, q: float, beta: float) -> GM:
        """The GM process with continuous driving noise of density ``q`` (unit sqrt(Hz)): sigma = q / sqrt(2 beta)."""
        return cls(q / math.sqrt(2.0 * beta), beta)

    @classmethod
    def of_discrete(cls, phi: float, sigma2: float, dt: float) -> GM:
        """The GM process whose samples at ``dt`` are the AR(1) with coefficient ``phi`` in (0, 1) and innovation variance ``sigma2``.

        Parameters
        ----------
        phi : float
            Coefficient, between 0 and 1.
        sigma2 : float
            Innovation variance, unit^2.
        dt : float
            Sampling interval, s.
        """
        if not 0.0 < phi < 1.0:
            raise InputError(
                f"phi is {phi}, expected a number between 0 and 1; an AR1 with phi <= 0 has no continuous counterpart"
            )
        return cls(math.sqrt(sigma2 / ((1.0 - phi) * (1.0 + phi))), -math.log(phi) / dt)

    def discrete(self, dt: float) -> tuple[float, float]:
        """Return ``(phi, innovation variance)`` of the samples at interval ``dt``, the parametrisation of the GMWM literature."""
        p = self.parameters
        return math.exp(-p["beta"] * dt), -math.expm1(-2.0 * p["beta"] * dt) * p["sigma"] ** 2

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        return 2.0 * p["sigma"] ** 2 * first_order_wavelet(p["beta"] * dt, counts(m))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        a = p["beta"] * dt
        # |1 - phi e^-iw|^2 = (1 - phi)^2 + 4 phi sin^2(w/2)
        distance = math.expm1(-a) ** 2 + 4.0 * math.exp(-a) * np.sin(np.pi * np.asarray(f) * dt) ** 2
        return np.asarray(-math.expm1(-2.0 * a) * p["sigma"] ** 2 * dt / distance)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        return np.asarray(p["sigma"] ** 2 * np.exp(-p["beta"] * dt * np.abs(np.asarray(lag, dtype=np.float64))))

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:  # noqa: D102
        a, variance = self.parameters["beta"] * dt, self.parameters["sigma"] ** 2
        # covariance of neighbouring means; every further mean multiplies by exp(-m a)
        near, lost = variance * math.exp(-a) * (math.expm1(-m * a) / math.expm1(-a) / m) ** 2, -math.expm1(-m * a)
        allan = (
            2.0 * variance * float(first_order_wavelet(a, np.array([float(m)]))[0])
        )  # half the variance of a difference
        far = -near * lost**2 * np.exp(np.arange(max(count - 2, 0)) * (-m * a))
        return np.concatenate([[2.0 * allan, near * lost - allan][:count], far])

    def log_slopes(  # noqa: D102
        self, names: Sequence[str], f: Array, dt: float, m: int, count: int
    ) -> tuple[Array, Array] | None:
        if tuple(names) != ("beta",):
            return None
        a, variance = self.parameters["beta"] * dt, self.parameters["sigma"] ** 2
        low, here, high = (
            2.0 * float(first_order_wavelet(a * math.exp(step), np.array([float(m)]))[0])
            for step in (-SLOPE_STEP, 0.0, SLOPE_STEP)
        )
        allan = np.array([here, (high - low) / (2.0 * SLOPE_STEP), (high + low - 2.0 * here) / SLOPE_STEP**2])
        density, covariance = np.empty((3, f.size)), np.empty((3, count))
        first_order_slopes(a, m, np.sin(np.pi * dt * f) ** 2, allan, density, covariance)
        return variance * dt * density, variance * covariance

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        phi, q = self.discrete(dt)
        p0 = self.parameters["sigma"] ** 2
        return StateBlock(("GM",), np.array([[phi]]), np.array([[q]]), np.ones(1), np.array([[p0]]), 0.0, dt)

    def slowed(self, factor: float) -> Self:
        """The standard deviation stays."""
        return replace(self, beta=self.parameters["beta"] / factor, follows=None)

    def timed(self, factor: Array, dt: float) -> tuple[Array, Array, Array]:  # noqa: D102
        p = self.parameters
        a = p["beta"] * dt / factor
        return np.exp(-a)[:, None, None], np.ones(1), p["sigma"] * np.sqrt(-np.expm1(-2.0 * a))

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        phi, q = self.discrete(dt)
        return onward.first_order(rng, phi, self.parameters["sigma"], math.sqrt(q))

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """As every process with a rate; the density ``q`` of the driving noise may stand for ``sigma``."""
        given = dict(given)
        driving = given.pop("q", None)
        if driving is not None:
            if "Tc" in given:
                given = cls.with_rate(given)
            if "sigma" in given or "beta" not in given:
                raise InputError("q (driving density) goes with beta or Tc and without sigma", where="GM")
            beta = quantity(given["beta"], "1/s", "GM.beta")
            density = quantity(driving, f"{signal_unit or '1'}*sqrt(Hz)", "GM.q")
            if density < 0 or not beta > 0:
                raise InputError(
                    f"q (driving density) is {density!r} and beta {beta!r}, expected positive numbers", where="GM"
                )
            given["sigma"] = GM.of_driving_density(density, beta).parameters["sigma"]
        return super().from_mapping(given, signal_unit)

    def markov_parts(self, dt: float) -> MarkovParts:  # noqa: D102
        p = self.parameters
        return MarkovParts(decay=(p["beta"] * dt,), variance=(p["sigma"] ** 2,))

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # noqa: D102
        return np.ones((1, 1), dtype=bool), np.ones((1, 1), dtype=bool)

    def of_transition(self, Phi: Array, Q: Array, dt: float) -> Self:  # noqa: D102
        phi = min(max(float(Phi[0, 0]), 1e-12), 1.0 - 1e-12)
        return self.with_parameters(GM.of_discrete(phi, float(Q[0, 0]), dt).parameters)

    def per_sample(self, dt: float) -> dict[str, str]:  # noqa: D102
        phi, sigma2 = self.discrete(dt)
        return {"sigma": f"σ² = {sigma2:.4g}", "beta": f"φ = {phi:.6g}"}

    def as_white_and_walk(self, dt: float) -> tuple[float, float]:
        """A slow one walks with the density of its continuous driving noise."""
        p = self.parameters
        return (0.0, 2.0 * p["beta"] * p["sigma"] ** 2) if p["beta"] < 1.0 else super().as_white_and_walk(dt)
