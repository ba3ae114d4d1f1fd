"""Discrete processes, which carry the rate of their samples: AR1, AR, MA, ARMA."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, signal

from insemu.errors import InputError, nearest
from insemu.noise import draws, grammar
from insemu.noise.block import StateBlock
from insemu.noise.grammar import quantity
from insemu.noise.process import NotStationary, Parameter, Process, counts
from insemu.noise.processes.gauss_markov import first_order_allan, first_order_allan_direct

Array = NDArray[np.float64]


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

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:  # noqa: D102
        rest = {k: v for k, v in given.items() if k != "rate_hz"}
        process = super().from_mapping(rest, signal_unit)
        rate = given.get("rate_hz")
        return process if rate is None else replace(process, rate_hz=quantity(rate, "Hz", "AR1.rate_hz"))

    def at_rate(self, rate_hz: float) -> AR1:  # noqa: D102
        return self if self.rate_hz is not None else replace(self, rate_hz=rate_hz)

    @property
    def variance(self) -> float:
        """Stationary variance, unit^2."""
        p = self.parameters
        return p["sigma2"] / ((1.0 - p["phi"]) * (1.0 + p["phi"]))

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        m = counts(m)
        phi = self.parameters["phi"]
        if phi > 0.5:
            return first_order_allan(self.variance, -math.log(phi), m)
        return first_order_allan_direct(self.variance, phi, m)

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

    #: Which of the two polynomials the class has.
    POLYNOMIALS: ClassVar[tuple[str, ...]] = ("ar", "ma")

    @classmethod
    def of_arguments(cls, orders: Sequence[int], given: Mapping[str, Any], signal_unit: str, text: str) -> Self:
        """``AR(2)``, ``ARMA(p=2, q=1)`` are structures; without orders as :meth:`from_mapping`."""
        orders, given = list(orders), dict(given)
        for order in ("p", "q"):
            value = given.pop(order, None)
            if value is not None:
                orders.append(grammar.whole(str(value), f"order {order} of {cls.__name__}"))
        if given:
            return super().of_arguments(orders, given, signal_unit, text)
        wanted = len(cls.POLYNOMIALS)
        if len(orders) != wanted or min(orders) < 1:
            raise InputError(
                f"{cls.__name__} in the model '{text}' needs {wanted} order(s), for example {cls.__name__}({', '.join('2' * wanted)})"
            )
        unknown: dict[str, Any] = {n: (None,) * o for n, o in zip(cls.POLYNOMIALS, orders, strict=True)}
        return cls(**unknown)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """Coefficients ``ar`` and ``ma``, ``sigma2`` and ``rate_hz``; or ``order`` alone for a structure."""
        where = cls.__name__
        known = ("ar", "ma", "sigma2", "rate_hz", "order")
        unknown = [k for k in given if k not in known]
        if unknown:
            raise InputError(f"unknown key '{unknown[0]}'" + nearest(unknown[0], known), where=where)
        if "order" in given:
            order = given["order"] if isinstance(given["order"], list) else [given["order"]]
            sizes = [grammar.whole(str(o), f"order of {where}") for o in order]
            return cls(**dict[str, Any](zip(cls.POLYNOMIALS, [(None,) * n for n in sizes], strict=False)))

        def coefficients(key: str) -> tuple[float, ...]:
            value = given.get(key, ())
            values = value if isinstance(value, list | tuple) else [value]
            return tuple(quantity(v, "1", f"{where}.{key}") for v in values)

        square = "({u})^2".format(u=signal_unit or "1")
        sigma2 = quantity(given["sigma2"], square, f"{where}.sigma2") if "sigma2" in given else None
        rate = quantity(given["rate_hz"], "Hz", f"{where}.rate_hz") if given.get("rate_hz") is not None else None
        return cls(**{name: coefficients(name) for name in cls.POLYNOMIALS}, sigma2=sigma2, rate_hz=rate)

    def to_mapping(self, signal_unit: str) -> dict[str, Any]:  # noqa: D102
        out: dict[str, Any] = {"process": self.symbol}
        if not self.specified:
            orders = [len(v) for v in (self.ar, self.ma) if len(v)]
            return out | {"order": orders if len(orders) > 1 else orders[0]}
        for key in ("ar", "ma"):
            if getattr(self, key):
                out[key] = [float(v) for v in getattr(self, key)]
        out["sigma2"] = self.parameters["sigma2"]
        return out | ({"rate_hz": self.rate_hz} if self.rate_hz is not None else {})

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
        m = counts(m).astype(np.int64)
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

    POLYNOMIALS: ClassVar[tuple[str, ...]] = ("ar",)

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

    POLYNOMIALS: ClassVar[tuple[str, ...]] = ("ma",)

    def __post_init__(self) -> None:
        if self.ar:
            raise InputError("MA has no autoregressive coefficients; use ARMA")
        super().__post_init__()
