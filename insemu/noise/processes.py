"""The processes of inertial sensor errors, each said once.

Every process is a frozen set of parameters. A parameter left out is unknown: ``GM()`` is a structure to be fitted. Closed forms take the
sampling interval ``dt``, because what a filter or an estimator sees is the sampled sequence: averages of m samples, frequencies up to
1 / (2 dt), lags in samples.

===== ============================== ========== =========== ========== ===============
name  Allan variance of the samples  stationary state block states     rate
===== ============================== ========== =========== ========== ===============
WN    closed                         yes        yes         0          free
RW    closed                         no         yes         1          free
GM    closed                         yes        yes         1          free
AR1   closed                         yes        yes         1          carried
AR    by exact doubling              yes        yes         p          carried
MA    by exact doubling              yes        yes         q + 1      carried
ARMA  by exact doubling              yes        yes         max(p,q+1) carried
QN    closed                         yes        yes         2          free
DR    closed                         no         yes         2          free
BI    closed                         no         refused     -          free
SIN   closed                         yes        yes         2          free
RC    0                              no         yes         1          free
===== ============================== ========== =========== ========== ===============
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, signal, special

from insemu.errors import InputError
from insemu.noise import draws
from insemu.noise.block import StateBlock

if TYPE_CHECKING:
    from insemu.noise.model import NoiseModel

Array = NDArray[np.float64]
Domain = Literal["positive", "real", "correlation", "coefficient"]


class NotStationary(InputError):
    """Asked for an autocovariance that does not exist, or a polynomial has a root on or outside the unit circle."""


@dataclass(frozen=True)
class Parameter:
    """What a parameter is: its name, its unit in terms of the signal's unit ``{u}``, and its domain."""

    name: str
    unit: str
    domain: Domain
    meaning: str
    optional: bool = False  # not part of the fitted structure; has a default

    def unit_for(self, signal_unit: str) -> str:
        """The unit for a signal in ``signal_unit``, for example ``rad/s/sqrt(Hz)``."""
        u = signal_unit or "1"
        if self.unit == "({u})*s":
            return {"rad/s": "rad", "m/s^2": "m/s"}.get(u, f"({u})*s")
        if self.unit == "{u}/s":
            return {"rad/s": "rad/s^2", "m/s^2": "m/s^3"}.get(u, f"{u}/s")
        if self.unit == "({u})^2":
            return {"rad/s": "(rad/s)^2", "m/s^2": "(m/s^2)^2"}.get(u, f"({u})^2")
        return self.unit.format(u=u)


def _counts(m: ArrayLike) -> Array:
    counts = np.asarray(m, dtype=np.float64)
    if (counts < 1).any() or (counts != np.floor(counts)).any():
        raise InputError("averages must span whole numbers of samples, at least 1")
    return counts


@dataclass(frozen=True)
class Process(ABC):
    """One stochastic process; subclasses give the closed forms.

    Conventions: m counts samples in an average, lags count samples, ``dt`` is in s, PSDs are two-sided in unit^2/Hz.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    stationary: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for p in self.PARAMETERS:
            value = getattr(self, p.name)
            if value is None:
                continue
            number = float(value)
            object.__setattr__(self, p.name, number)
            bad = (
                not math.isfinite(number)
                or (p.domain == "positive" and number < 0)
                or (p.domain == "correlation" and not -1 < number < 1)
                or (p.name in ("beta", "f") and number == 0)
            )
            if bad:
                expected = {"positive": "a number that is not negative", "correlation": "a number between -1 and 1"}
                if p.domain == "correlation" and abs(number) >= 1.0:
                    expected["correlation"] += f"; the nearest stable is {math.copysign(1.0 - 1e-6, number):.6f}"
                    expected["correlation"] += ", and at 1 it is a random walk (RW)" if number > 0 else ""
                if p.name in ("beta", "f"):
                    expected["positive"] = "a positive number"
                raise InputError(
                    f"{self.symbol}: {p.name} ({p.meaning}) is {number!r}, expected {expected.get(p.domain, 'a finite number')}"
                )

    @property
    def symbol(self) -> str:
        """The short registered name."""
        return type(self).__name__

    @property
    def specified(self) -> bool:
        """Whether every parameter has a value."""
        return all(getattr(self, p.name) is not None for p in self.parameters_meta())

    def parameters_meta(self) -> tuple[Parameter, ...]:
        """The parameters that make up the structure, in order."""
        return tuple(p for p in self.PARAMETERS if not p.optional)

    @property
    def parameters(self) -> dict[str, float]:
        """Names and values of the structural parameters (SI); raises where one is unknown."""
        self._require()
        return {p.name: getattr(self, p.name) for p in self.parameters_meta()}

    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """The same structure with these parameter values."""
        return replace(self, **dict(values))

    def at_rate(self, rate_hz: float) -> Self:
        """The process at a sampling rate: itself, except that a discrete process without a rate takes this one."""
        return self

    def scaled(self, factor: float) -> Self:
        """The process whose signal is ``factor`` times this one's; times and coefficients stay."""
        powers = {p.name: 2 if "^2" in p.unit_for("1") else 1 for p in self.parameters_meta() if "{u}" in p.unit}
        if "sigma0" in {f.name for f in fields(self)}:
            powers["sigma0"] = 1
        known = self.parameters | {f.name: getattr(self, f.name) for f in fields(self)}
        return self.with_parameters({name: known[name] * factor**power for name, power in powers.items()})

    def _require(self) -> None:
        missing = [p.name for p in self.parameters_meta() if getattr(self, p.name) is None]
        if missing:
            raise InputError(f"{self.symbol}: no value for {', '.join(missing)}; fit the model or give the parameters")

    # -- what a process is ------------------------------------------------------------------------------------------------------

    @abstractmethod
    def allan_variance(self, m: ArrayLike, dt: float) -> Array:
        """Allan variance of averages of ``m`` samples.

        Parameters
        ----------
        m : (k,) array of int
            Samples per average.
        dt : float
            Sampling interval, s.

        Returns
        -------
        (k,) array
            unit^2.
        """

    def wavelet_variance(self, scale: ArrayLike, dt: float) -> Array:
        """Haar wavelet variance at scales of 2^j samples: half the Allan variance at m = scale / 2."""
        return 0.5 * self.allan_variance(np.asarray(scale) // 2, dt)

    @abstractmethod
    def psd(self, f: ArrayLike, dt: float) -> Array:
        """Two-sided PSD of the sampled sequence in unit^2/Hz at frequencies ``f`` (Hz), 0 < f <= 1 / (2 dt)."""

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:
        """Autocovariance at ``lag`` samples, unit^2.

        Raises
        ------
        NotStationary
            The process has none.
        """
        raise NotStationary(f"{self.symbol} is not stationary and has no autocovariance")

    @abstractmethod
    def block(self, dt: float) -> StateBlock:
        """State block at sampling interval ``dt`` (s)."""

    @abstractmethod
    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:
        """Overwrite ``out`` (n,), contiguous float64, with samples at interval ``dt`` (s), from a stationary start where there is one."""

    def simulate(self, n: int, dt: float, rng: np.random.Generator) -> Array:
        """``n`` samples at interval ``dt`` (s), from a stationary start where there is one."""
        out = np.empty(n)
        self.fill(out, dt, rng)
        return out

    # -- sums and text ------------------------------------------------------------------------------------------------------------

    def __add__(self, other: Process | NoiseModel) -> NoiseModel:
        from insemu.noise.model import NoiseModel

        return NoiseModel((self,)) + other

    def __rmul__(self, count: int) -> NoiseModel:
        from insemu.noise.model import NoiseModel

        return count * NoiseModel((self,))

    def __str__(self) -> str:
        given = ", ".join(
            f"{f.name}={getattr(self, f.name)!r}" for f in fields(self) if getattr(self, f.name) != f.default
        )
        return f"{self.symbol}({given})"


_DENSITY = "{u}/sqrt(Hz)"


@dataclass(frozen=True)
class WN(Process):
    """White noise of density ``N``: two-sided PSD N^2, per-sample variance N^2 / dt, Allan variance N^2 / tau."""

    N: float | None = None
    PARAMETERS: ClassVar = (Parameter("N", _DENSITY, "positive", "white-noise density"),)

    @classmethod
    def of_variance(cls, variance: float, dt: float) -> WN:
        """The white noise whose samples at interval ``dt`` have this variance."""
        return cls(math.sqrt(variance * dt))

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return self.parameters["N"] ** 2 / (dt * _counts(m))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.full(np.shape(f), self.parameters["N"] ** 2)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.where(np.asarray(lag) == 0, self.parameters["N"] ** 2 / dt, 0.0)

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        return StateBlock.empty(dt, self.parameters["N"] ** 2 / dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        draws.standard_normal(out, rng)
        out *= self.parameters["N"] / math.sqrt(dt)


@dataclass(frozen=True)
class RW(Process):
    """Random walk of driving density ``K`` (increments K sqrt(dt)): Allan variance of its samples K^2 dt (2 m^2 + 1) / (6 m).

    ``sigma0`` is the standard deviation of the value before the first sample.
    """

    K: float | None = None
    sigma0: float = 0.0
    PARAMETERS: ClassVar = (
        Parameter("K", "{u}*sqrt(Hz)", "positive", "random-walk density"),
        Parameter("sigma0", "{u}", "positive", "initial standard deviation", optional=True),
    )
    stationary: ClassVar[bool] = False

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        m = _counts(m)
        return self.parameters["K"] ** 2 * dt * (2.0 * m**2 + 1.0) / (6.0 * m)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return (self.parameters["K"] * dt / (2.0 * np.sin(np.pi * np.asarray(f) * dt))) ** 2

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        q = self.parameters["K"] ** 2 * dt
        return StateBlock(("RW",), np.eye(1), np.array([[q]]), np.ones(1), np.array([[self.sigma0**2]]), 0.0, dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        start = rng.standard_normal() * self.sigma0
        draws.standard_normal(out, rng)
        draws.running_sum(out, start, self.parameters["K"] * math.sqrt(dt))


def _first_order_allan(variance: float, a: float, m: Array) -> Array:
    """Allan variance of a stationary first-order process with correlation exp(-a) between samples, a > 0.

    With u = m a it is variance (f(u) + 2 m (sinh a - a)) / (4 m^2 sinh^2(a/2)), f(u) = 2u - 3 + 4 exp(-u) - exp(-2u): every
    term is positive, so that nothing cancels when the correlation time is millions of samples.
    """
    if a > 1.0:
        return _first_order_allan_direct(variance, math.exp(-a), m)
    u = m * a
    direct = 2.0 * u + 4.0 * np.expm1(-u) - np.expm1(-2.0 * u)
    # f(u) = sum_k (-u)^k (4 - 2^k) / k!, which starts at u^3
    terms = [(-1.0) ** k * (4.0 - 2.0**k) / math.factorial(k) for k in range(3, 20)]
    series = u**3 * np.polynomial.polynomial.polyval(np.minimum(u, 0.3), terms)
    f = np.where(u < 0.3, series, direct)
    excess = a**3 * (1 / 6 + a**2 * (1 / 120 + a**2 / 5040)) if a < 0.02 else math.sinh(a) - a
    return np.asarray(variance * (f + 2.0 * m * excess) / (2.0 * m * math.sinh(a / 2.0)) ** 2)


def _first_order_allan_direct(variance: float, phi: float, m: Array) -> Array:
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
        return _first_order_allan(p["sigma"] ** 2, p["beta"] * dt, _counts(m))

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


def _carried_rate(process: AR1 | ARMA, dt: float) -> None:
    if process.rate_hz is None:
        raise InputError(f"{process.symbol} is a discrete process and carries its rate; give rate_hz")
    if abs(process.rate_hz * dt - 1.0) > 1e-9:
        raise InputError(
            f"{process.symbol} belongs to samples at {process.rate_hz:g} Hz and cannot be used at {1 / dt:g} Hz"
        )


@dataclass(frozen=True)
class AR1(Process):
    """First-order autoregression of the samples at ``rate_hz``: coefficient ``phi``, innovation variance ``sigma2``."""

    phi: float | None = None
    sigma2: float | None = None
    rate_hz: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("phi", "1", "correlation", "coefficient"),
        Parameter("sigma2", "({u})^2", "positive", "innovation variance"),
    )

    def at_rate(self, rate_hz: float) -> AR1:  # noqa: D102
        return self if self.rate_hz is not None else replace(self, rate_hz=rate_hz)

    @property
    def variance(self) -> float:
        """Stationary variance, unit^2."""
        p = self.parameters
        return p["sigma2"] / ((1.0 - p["phi"]) * (1.0 + p["phi"]))

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        m = _counts(m)
        phi = self.parameters["phi"]
        if phi > 0.5:
            return _first_order_allan(self.variance, -math.log(phi), m)
        return _first_order_allan_direct(self.variance, phi, m)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        p = self.parameters
        distance = (1.0 - p["phi"]) ** 2 + 4.0 * p["phi"] * np.sin(np.pi * np.asarray(f) * dt) ** 2
        return np.asarray(p["sigma2"] * dt / distance)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        return np.asarray(self.variance * self.parameters["phi"] ** np.abs(np.asarray(lag, dtype=np.float64)))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        _carried_rate(self, dt)
        p = self.parameters
        return StateBlock(
            ("AR1",),
            np.array([[p["phi"]]]),
            np.array([[p["sigma2"]]]),
            np.ones(1),
            np.array([[self.variance]]),
            0.0,
            dt,
        )

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        _carried_rate(self, dt)
        p = self.parameters
        draws.standard_normal(out, rng)
        draws.first_order(out, p["phi"], math.sqrt(self.variance), math.sqrt(p["sigma2"]))


@dataclass(frozen=True)
class ARMA(Process):
    """Autoregressive moving average of the samples at ``rate_hz``.

    ``y_k = sum_i ar[i] y_(k-1-i) + w_k + sum_j ma[j] w_(k-1-j)``, ``var w = sigma2``. Coefficients that are None are unknown:
    ``ARMA.of_order(2, 1)`` is a structure to be fitted.
    """

    ar: tuple[float | None, ...] = ()
    ma: tuple[float | None, ...] = ()
    sigma2: float | None = None
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        for name in ("ar", "ma"):
            values = getattr(self, name)
            if values is None:
                raise InputError(f"{self.symbol}: no order; write for example {self.symbol}(2)")
            given = tuple(None if v is None else float(v) for v in np.atleast_1d(np.asarray(values, dtype=object)))
            if any(v is not None and not math.isfinite(v) for v in given):
                raise InputError(f"{self.symbol}: {name} is {given}, expected finite coefficients")
            object.__setattr__(self, name, given)
        if self.sigma2 is not None and not (math.isfinite(self.sigma2) and self.sigma2 >= 0):
            raise InputError(
                f"{self.symbol}: sigma2 (innovation variance) is {self.sigma2!r}, expected a number that is not negative"
            )

    @classmethod
    def of_order(cls, p: int, q: int = 0) -> Self:
        """The structure with ``p`` autoregressive and ``q`` moving-average coefficients, all unknown."""
        return cls(ar=(None,) * p, ma=(None,) * q)

    def parameters_meta(self) -> tuple[Parameter, ...]:  # noqa: D102
        ar = [Parameter(f"ar_{i + 1}", "1", "coefficient", "autoregressive coefficient") for i in range(len(self.ar))]
        ma = [Parameter(f"ma_{i + 1}", "1", "coefficient", "moving-average coefficient") for i in range(len(self.ma))]
        return (*ar, *ma, Parameter("sigma2", "({u})^2", "positive", "innovation variance"))

    @property
    def _flat(self) -> dict[str, float | None]:
        flat: dict[str, float | None] = {f"ar_{i + 1}": v for i, v in enumerate(self.ar)}
        flat |= {f"ma_{i + 1}": v for i, v in enumerate(self.ma)}
        return flat | {"sigma2": self.sigma2}

    @property
    def specified(self) -> bool:  # noqa: D102
        return all(v is not None for v in self._flat.values())

    @property
    def parameters(self) -> dict[str, float]:  # noqa: D102
        self._require()
        return {k: v for k, v in self._flat.items() if v is not None}

    def _require(self) -> None:
        missing = [k for k, v in self._flat.items() if v is None]
        if missing:
            raise InputError(f"{self.symbol}: no value for {', '.join(missing)}; fit the model or give the parameters")

    def with_parameters(self, values: Mapping[str, float]) -> Self:  # noqa: D102
        flat = self._flat | dict(values)
        ar = tuple(flat[f"ar_{i + 1}"] for i in range(len(self.ar)))
        ma = tuple(flat[f"ma_{i + 1}"] for i in range(len(self.ma)))
        return replace(self, ar=ar, ma=ma, sigma2=flat["sigma2"])

    def at_rate(self, rate_hz: float) -> Self:  # noqa: D102
        return self if self.rate_hz is not None else replace(self, rate_hz=rate_hz)

    def _polynomials(self) -> tuple[Array, Array]:
        self._require()
        ar = np.array(self.ar, dtype=np.float64)
        return np.concatenate([[1.0], -ar]), np.concatenate([[1.0], np.array(self.ma, dtype=np.float64)])

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Roots of the autoregressive polynomial; the process is stationary when all lie inside the unit circle."""
        return np.roots(self._polynomials()[0]).astype(np.complex128)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of the poles."""
        return float(np.max(np.abs(self.poles), initial=0.0))

    def require_stationary(self) -> None:
        """Raise ``NotStationary`` with the reason and the nearest stable polynomial where a pole is on or outside the unit circle."""
        if self.spectral_radius >= 1.0:
            near = self.stabilised()
            offer = ", ".join(f"{v:.6g}" for v in near.ar if v is not None)
            size = ""
            if self.rate_hz is not None and self.sigma2:
                sd = math.sqrt(near.block(1.0 / self.rate_hz).P0[0, 0])
                size = (
                    f" (standard deviation {sd:.3g} in the signal's SI unit: see whether the sensor is as bad as that)"
                )
            raise NotStationary(
                f"{self.symbol} with coefficients {self.ar} is not stationary: a pole has modulus {self.spectral_radius:.6f}, expected "
                f"below 1; the nearest stable polynomial is [{offer}]{size}"
            )

    def stabilised(self, radius: float = 1.0 - 1e-6) -> Self:
        """The process with every pole outside ``radius`` moved straight inwards onto it, the nearest that is stationary."""
        poles = self.poles
        moved = poles * np.minimum(1.0, radius / np.maximum(np.abs(poles), 1e-300))
        return replace(self, ar=tuple(float(v) for v in -np.real(np.poly(moved))[1:]))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        _carried_rate(self, dt)
        self.require_stationary()
        p, q = len(self.ar), len(self.ma)
        n = max(p, q + 1)
        Phi = np.zeros((n, n))
        Phi[:p, 0] = self.ar
        Phi[:-1, 1:] += np.eye(n - 1)
        drive = np.zeros(n)
        drive[: q + 1] = self._polynomials()[1]
        Q = np.outer(drive, drive) * self.parameters["sigma2"]
        P0 = linalg.solve_discrete_lyapunov(Phi, Q)
        names = tuple(f"{self.symbol}.{i + 1}" for i in range(n))
        return StateBlock(names, Phi, Q, np.eye(n)[0], np.asarray(0.5 * (P0 + P0.T), dtype=np.float64), 0.0, dt)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        m = _counts(m).astype(np.int64)
        block = self.block(dt)
        if (m & (m - 1) == 0).all():
            return block.accumulated_variances(int(m.max()))[np.log2(m).astype(np.int64)]
        # any m: weights of the autocovariance under a second difference of block sums
        top = int(m.max())
        gamma = self.autocovariance(np.arange(2 * top), dt)
        once = np.concatenate([[0.0], np.cumsum(gamma)])
        twice = np.concatenate([[0.0], np.cumsum(gamma * np.arange(gamma.size))])

        def within(k: NDArray[np.int64]) -> Array:  # variance of a sum of k samples
            return k * gamma[0] + 2.0 * (k * (once[k] - once[1]) - twice[k])

        return np.asarray((4.0 * within(m) - within(2 * m)) / (2.0 * m.astype(np.float64) ** 2))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        ar, ma = self._polynomials()
        z = np.exp(-2j * np.pi * np.asarray(f, dtype=np.float64) * dt)
        ratio = np.polynomial.polynomial.polyval(z, ma) / np.polynomial.polynomial.polyval(z, ar)
        return np.asarray(self.parameters["sigma2"] * dt * np.abs(ratio) ** 2)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        lags = np.abs(np.asarray(lag, dtype=np.int64))
        block = self.block(dt)
        first = np.empty(block.n + 1)
        power = block.P0
        for k in range(block.n + 1):
            first[k] = power[0, 0]
            power = block.Phi @ power
        top = int(lags.max(initial=0)) + 1
        if top > first.size:
            # beyond the moving-average order the autocovariance obeys the autoregression
            ar = self._polynomials()[0]
            start = signal.lfiltic([1.0], ar, first[::-1][: len(self.ar)]) if len(self.ar) else np.zeros(0)
            rest = (
                signal.lfilter([1.0], ar, np.zeros(top - first.size), zi=start)[0]
                if len(self.ar)
                else np.zeros(top - first.size)
            )
            first = np.concatenate([first, rest])
        return np.asarray(first[lags])

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        block = self.block(dt)
        eigenvalues, vectors = np.linalg.eigh(block.P0)
        start = vectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(block.n))
        ar, ma = self._polynomials()
        draws.standard_normal(out, rng)
        out *= math.sqrt(self.parameters["sigma2"])
        # Harvey's state is the direct form II transposed: y_0 sees Phi x_(-1)
        memory = (block.Phi @ start)[: max(len(ar), len(ma)) - 1]
        padded = max(len(ar), len(ma))
        draws.rational_filter(
            out,
            np.pad(ma, (0, padded - len(ma))),
            np.pad(ar, (0, padded - len(ar))),
            _transposed_memory(memory, padded - 1),
        )

    def __str__(self) -> str:
        if not self.specified:
            orders = [str(len(v)) for v in (self.ar, self.ma) if len(v)]
            return f"{self.symbol}({', '.join(orders)})"
        return super().__str__()


def _transposed_memory(memory: Array, size: int) -> Array:
    out = np.zeros(size)
    out[: memory.size] = memory[:size]
    return out


@dataclass(frozen=True)
class AR(ARMA):
    """Autoregression of order p: ``AR(2)`` is the structure, ``AR((1.5, -0.6), sigma2=..., rate_hz=...)`` the process."""

    def __post_init__(self) -> None:
        if isinstance(self.ar, int):
            object.__setattr__(self, "ar", (None,) * self.ar)
        if self.ma:
            raise InputError("AR has no moving-average coefficients; use ARMA")
        super().__post_init__()

    @classmethod
    def of_partial_correlations(
        cls, correlations: ArrayLike, *, sigma2: float | None = None, rate_hz: float | None = None
    ) -> Self:
        """The autoregression with these partial autocorrelations, stationary where all lie between -1 and 1 (Durbin's recursion).

        The first is the coefficient of the AR(1) of the same signal. An innovation variance is that of the AR(1) times ``1 - k^2`` of each of
        the others, which ties published fits of several orders together.
        """
        ar = np.zeros(0)
        for k in np.atleast_1d(np.asarray(correlations, dtype=np.float64)):
            ar = np.append(ar - k * ar[::-1], k)
        return cls(tuple(float(v) for v in ar), sigma2=sigma2, rate_hz=rate_hz)

    def partial_correlations(self) -> Array:
        """Partial autocorrelations, (p,): the inverse of :meth:`of_partial_correlations`; NaN below a value of exactly 1."""
        ar = -self._polynomials()[0][1:]
        out = np.empty(ar.size)
        for at in range(ar.size - 1, -1, -1):
            k = out[at] = ar[at]
            with np.errstate(divide="ignore", invalid="ignore"):
                ar = (ar[:at] + k * ar[:at][::-1]) / (1.0 - k**2)
        return out


@dataclass(frozen=True)
class MA(ARMA):
    """Moving average of order q: ``MA.of_order(0, 2)`` is the structure."""

    def __post_init__(self) -> None:
        if self.ar:
            raise InputError("MA has no autoregressive coefficients; use ARMA")
        super().__post_init__()


@dataclass(frozen=True)
class QN(Process):
    """Quantization noise ``Q`` of the integrated output: y_k = (q_k - q_(k-1)) / dt, var q = Q^2, Allan variance 3 Q^2 / tau^2."""

    Q: float | None = None
    PARAMETERS: ClassVar = (Parameter("Q", "({u})*s", "positive", "quantization of the integrated output"),)

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return 3.0 * self.parameters["Q"] ** 2 / (dt * _counts(m)) ** 2

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.asarray(4.0 * self.parameters["Q"] ** 2 / dt * np.sin(np.pi * np.asarray(f) * dt) ** 2)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        q = (self.parameters["Q"] / dt) ** 2
        lag = np.abs(np.asarray(lag))
        return np.where(lag == 0, 2.0 * q, np.where(lag == 1, -q, 0.0))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        q = self.parameters["Q"] ** 2
        # states are q_k and q_(k-1): an integrated quantity and its predecessor
        return StateBlock(
            ("QN", "QN.previous"),
            np.array([[0.0, 0.0], [1.0, 0.0]]),
            np.diag([q, 0.0]),
            np.array([1.0, -1.0]) / dt,
            np.eye(2) * q,
            0.0,
            dt,
        )

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        np.multiply(np.diff(rng.standard_normal(out.size + 1)), self.parameters["Q"] / dt, out=out)


@dataclass(frozen=True)
class DR(Process):
    """Drift (rate ramp) of slope ``R``: sample k is R k dt, Allan variance R^2 tau^2 / 2.

    A filter that carries it knows the size of the slope and not its sign: value and slope start at zero with standard deviations 0 and R.
    """

    R: float | None = None
    PARAMETERS: ClassVar = (Parameter("R", "{u}/s", "real", "ramp slope"),)
    stationary: ClassVar[bool] = False

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return 0.5 * (self.parameters["R"] * dt * _counts(m)) ** 2

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))  # a deterministic ramp has no spectrum away from zero frequency

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        r = self.parameters["R"] ** 2
        Phi = np.array([[1.0, dt], [0.0, 1.0]])
        return StateBlock(("DR", "DR.slope"), Phi, np.zeros((2, 2)), np.array([1.0, 0.0]), np.diag([0.0, r]), 0.0, dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        np.multiply(self.parameters["R"] * dt, np.arange(1.0, out.size + 1.0), out=out)


@dataclass(frozen=True)
class BI(Process):
    """Bias instability (flicker) ``B``: two-sided PSD B^2 / (2 pi f), flat Allan variance (2 ln 2 / pi) B^2 = (0.664 B)^2.

    A sample is the average of the continuous flicker over dt, which makes the Allan variance flat down to one sample. It has no finite
    state block; :meth:`approximation` gives a sum of Gauss-Markov processes whose error over a band of averaging times is stated.
    """

    B: float | None = None
    PARAMETERS: ClassVar = (Parameter("B", "{u}", "positive", "bias instability"),)
    stationary: ClassVar[bool] = False

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.full(np.shape(_counts(m)), 2.0 * math.log(2.0) / math.pi * self.parameters["B"] ** 2)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        x = np.asarray(f, dtype=np.float64) * dt
        folded = special.zeta(3.0, x) + special.zeta(3.0, 1.0 - x)  # aliases of f^-1 sinc^2
        return np.asarray(self.parameters["B"] ** 2 * dt / (2.0 * np.pi**3) * np.sin(np.pi * x) ** 2 * folded)

    def block(self, dt: float) -> StateBlock:
        """Refused: flicker has no finite state block.

        Raises
        ------
        InputError
            Always; the message names the alternative.
        """
        raise InputError(
            "BI (flicker) has no finite state block; use BI.approximation(k, tau_from, tau_to), a sum of k GM processes"
        )

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
        from insemu.noise.model import NoiseModel

        taus = np.geomspace(tau_from, tau_to, 40 * k)
        # an Allan variance of GM peaks at 1.89 correlation times; the outer processes sit a little inside the band's ends
        times = (
            np.geomspace(tau_from, tau_to, k + 2)[1:-1] / 1.89 if k == 1 else np.geomspace(tau_from, tau_to, k) / 1.89
        )
        fine = tau_from / 1000.0
        m = np.maximum(np.round(taus / fine), 1.0)
        curves = np.stack([_first_order_allan(1.0, fine / t, m) for t in times], axis=1)
        flat = float(self.allan_variance(1, 1.0))
        weights, _ = optimize.nnls(curves, np.ones(taus.size))
        error = float(np.max(np.abs(curves @ weights - 1.0)))
        parts = tuple(GM(math.sqrt(w * flat), 1.0 / t) for w, t in zip(weights, times, strict=True) if w > 0)
        return NoiseModel(parts), error

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        gain = _flicker_gain(int(2 ** math.ceil(math.log2(max(2 * out.size, 8)))))
        size = 2 * gain.size - 2
        buffer = np.empty(2 * size + 2)  # one block for both directions of the transform
        white, spectrum = buffer[:size], buffer[size:].view(np.complex128)
        draws.standard_normal(white, rng)
        np.fft.rfft(white, out=spectrum)
        spectrum *= gain
        np.fft.irfft(spectrum, size, out=white)
        out[:] = white[: out.size]
        draws.running_sum(out, 0.0, self.parameters["B"])


@lru_cache(maxsize=4)
def _flicker_gain(size: int) -> Array:
    """Filter (size / 2 + 1,) that turns the transform of ``size`` white numbers into that of the first differences of unit flicker.

    The differences are stationary with the fourth difference of t^2 ln|t| as autocovariance; circulant embedding is exact.
    """
    lag = np.arange(-2, size // 2 + 3, dtype=np.float64)
    magnitude = np.abs(lag)
    g = magnitude**2 * np.log(np.where(magnitude > 0, magnitude, 1.0))
    gamma = np.convolve(g, [1.0, -4.0, 6.0, -4.0, 1.0], mode="valid")
    far = np.arange(gamma.size) > 1000
    # the fourth difference cancels at long lags; there its leading term is -2 / lag^2
    gamma[far] = -2.0 / np.arange(gamma.size)[far] ** 2
    gamma /= 2.0 * math.pi
    eigenvalues = np.maximum(np.fft.rfft(np.concatenate([gamma, gamma[-2:0:-1]])).real, 0.0)
    gain = np.sqrt(eigenvalues)
    gain.setflags(write=False)
    return gain


@dataclass(frozen=True)
class SIN(Process):
    """Sinusoid of amplitude ``alpha`` and frequency ``f`` (Hz) with a phase drawn uniformly."""

    alpha: float | None = None
    f: float | None = None
    PARAMETERS: ClassVar = (
        Parameter("alpha", "{u}", "positive", "amplitude"),
        Parameter("f", "Hz", "positive", "frequency"),
    )

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        p, m = self.parameters, _counts(m)
        x = np.pi * p["f"] * dt
        return np.asarray((p["alpha"] * np.sin(m * x) ** 2 / (m * np.sin(x))) ** 2)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))  # a line: no density away from its frequency

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:  # noqa: D102
        p = self.parameters
        return np.asarray(0.5 * p["alpha"] ** 2 * np.cos(2.0 * np.pi * p["f"] * dt * np.asarray(lag)))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        p = self.parameters
        angle = 2.0 * math.pi * p["f"] * dt
        Phi = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        P0 = np.eye(2) * 0.5 * p["alpha"] ** 2
        return StateBlock(("SIN", "SIN.quadrature"), Phi, np.zeros((2, 2)), np.array([1.0, 0.0]), P0, 0.0, dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        p = self.parameters
        phase = rng.uniform(0.0, 2.0 * math.pi)
        np.sin(2.0 * math.pi * p["f"] * dt * np.arange(out.size) + phase, out=out)
        out *= p["alpha"]


@dataclass(frozen=True)
class RC(Process):
    """Random constant of standard deviation ``sigma``: the turn-on bias."""

    sigma: float | None = None
    PARAMETERS: ClassVar = (Parameter("sigma", "{u}", "positive", "standard deviation"),)
    stationary: ClassVar[bool] = (
        False  # one draw says nothing about the ensemble; no estimator may use its autocovariance
    )

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(_counts(m)))

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        return np.zeros(np.shape(f))

    def block(self, dt: float) -> StateBlock:  # noqa: D102
        variance = self.parameters["sigma"] ** 2
        return StateBlock(("RC",), np.eye(1), np.zeros((1, 1)), np.ones(1), np.array([[variance]]), 0.0, dt)

    def fill(self, out: Array, dt: float, rng: np.random.Generator) -> None:  # noqa: D102
        out[:] = rng.standard_normal() * self.parameters["sigma"]


#: Every process by its registered name.
PROCESSES: Mapping[str, type[Process]] = {c.__name__: c for c in (WN, RW, GM, AR1, AR, MA, ARMA, QN, DR, BI, SIN, RC)}
