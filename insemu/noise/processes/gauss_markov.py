"""The first-order Gauss-Markov process."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.noise import draws
from insemu.noise.block import StateBlock
from insemu.noise.grammar import quantity
from insemu.noise.process import Parameter, Process, counts

Array = NDArray[np.float64]


def first_order_allan(variance: float, a: float, m: Array) -> Array:
    """Allan variance of a stationary first-order process with correlation exp(-a) between samples, a > 0.

    With u = m a it is variance (f(u) + 2 m (sinh a - a)) / (4 m^2 sinh^2(a/2)), f(u) = 2u - 3 + 4 exp(-u) - exp(-2u): every
    term is positive, so that nothing cancels when the correlation time is millions of samples.
    """
    if a > 1.0:
        return first_order_allan_direct(variance, math.exp(-a), m)
    u = m * a
    direct = 2.0 * u + 4.0 * np.expm1(-u) - np.expm1(-2.0 * u)
    # f(u) = sum_k (-u)^k (4 - 2^k) / k!, which starts at u^3
    terms = [(-1.0) ** k * (4.0 - 2.0**k) / math.factorial(k) for k in range(3, 20)]
    series = u**3 * np.polynomial.polynomial.polyval(np.minimum(u, 0.3), terms)
    f = np.where(u < 0.3, series, direct)
    excess = a**3 * (1 / 6 + a**2 * (1 / 120 + a**2 / 5040)) if a < 0.02 else math.sinh(a) - a
    return np.asarray(variance * (f + 2.0 * m * excess) / (2.0 * m * math.sinh(a / 2.0)) ** 2)


def first_order_allan_direct(variance: float, phi: float, m: Array) -> Array:
    """The same for any coefficient away from 1, where the plain closed form does not cancel."""
    top = m * (1.0 - phi**2) - phi * (3.0 - 4.0 * phi**m + phi ** (2.0 * m))
    return np.asarray(variance * top / (m * (1.0 - phi)) ** 2)


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
        Parameter("beta", "1/s", "positive", "inverse correlation time"),
    )

    @classmethod
    def of_driving_density(cls, q: float, beta: float) -> GM:
        """The GM process with continuous driving noise of density ``q`` (unit sqrt(Hz)): sigma = q / sqrt(2 beta)."""
        return cls(q / math.sqrt(2.0 * beta), beta)

    @classmethod
    def of_discrete(cls, phi: float, sigma2: float, dt: float) -> GM:
        """The GM process whose samples at ``dt`` are the AR(1) with coefficient ``phi`` in (0, 1) and innovation variance ``sigma2``."""
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
        return first_order_allan(p["sigma"] ** 2, p["beta"] * dt, counts(m))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        a = p["beta"] * dt
        # |1 - phi e^-iw|^2 = (1 - phi)^2 + 4 phi sin^2(w/2)
        distance = math.expm1(-a) ** 2 + 4.0 * math.exp(-a) * np.sin(np.pi * np.asarray(f) * dt) ** 2
        return np.asarray(-math.expm1(-2.0 * a) * p["sigma"] ** 2 * dt / distance)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        return np.asarray(p["sigma"] ** 2 * np.exp(-p["beta"] * dt * np.abs(np.asarray(lag, dtype=np.float64))))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        phi, q = self.discrete(dt)
        p0 = self.parameters["sigma"] ** 2
        return StateBlock(("GM",), np.array([[phi]]), np.array([[q]]), np.ones(1), np.array([[p0]]), 0.0, dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        phi, q = self.discrete(dt)
        draws.standard_normal(out, rng)
        draws.first_order(out, phi, self.parameters["sigma"], math.sqrt(q))

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """A correlation time ``Tc`` (s) may stand for ``beta``, and the density ``q`` of the driving noise for ``sigma``."""
        given = dict(given)
        if "Tc" in given:
            if "beta" in given:
                raise InputError("found both beta and Tc, expected one of them", where="GM")
            time = quantity(given.pop("Tc"), "s", "GM.Tc")
            if not time > 0:
                raise InputError(f"Tc (correlation time) is {time!r}, expected a positive number", where="GM")
            given["beta"] = 1.0 / time
        driving = given.pop("q", None)
        if driving is not None:
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
