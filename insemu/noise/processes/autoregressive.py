"""Discrete processes, which carry the rate of their samples: AR1, AR, MA, ARMA."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import scipy  # whose parts are imported when they are used
from numba import carray
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError, nearest, shown
from insemu.noise import onward
from insemu.noise.block import StateBlock
from insemu.noise.chain import sections, slower
from insemu.noise.compiled.curves import STEP
from insemu.noise.compiled.doubling import arma, coefficients_of
from insemu.noise.grammar import quantity, whole
from insemu.noise.onward import Source
from insemu.noise.parameters import Parameter
from insemu.noise.process import SAME_RATE, MarkovParts, NotStationary, Process, counts
from insemu.noise.processes.gauss_markov import first_order

Array = NDArray[np.float64]


#: Coefficients of each polynomial that are read.
MOST_ORDERS = 100


def _check_rate(process: AR1 | ARMA) -> None:
    if process.rate_hz is not None and not (math.isfinite(process.rate_hz) and process.rate_hz > 0.0):
        raise InputError(f"{process.symbol}: rate_hz is {process.rate_hz!r}, expected a positive number")


def _carried_rate(process: AR1 | ARMA, dt: float) -> None:
    if process.rate_hz is None:
        raise InputError(f"{process.symbol} is a discrete process and carries its rate; give rate_hz")
    if abs(process.rate_hz * dt - 1.0) > SAME_RATE:
        raise InputError(
            f"{process.symbol} belongs to samples at {process.rate_hz:g} Hz and cannot be used at {1 / dt:g} Hz"
        )


@njit(cache=True, nogil=True)
def _autoregressive_one(m: Array, z: float, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """The same for an AR(1) with coefficient tanh(z), and its derivative by z."""
    phi = math.tanh(z)
    if phi > 0.5:
        a = math.log1p(2.0 / math.expm1(2.0 * z))  # -log tanh z
        first_order(m, a, b, db)
        chain = -(1.0 - phi * phi) / (phi * a)  # d log a / d z
        if z > 8.0:
            chain = -2.0  # a = 2 exp(-2 z)
        for i in range(m.size):
            db[i] *= chain
        return
    for i in range(m.size):
        k = m[i]
        power = phi**k
        top = k * (1.0 - phi * phi) - phi * (3.0 - 4.0 * power + power * power)
        dtop = -2.0 * k * phi - 3.0 + 4.0 * (k + 1.0) * power - (2.0 * k + 1.0) * power * power
        low = 2.0 * (k * (1.0 - phi)) ** 2
        b[i] = top / low
        db[i] = (dtop / low + 2.0 * b[i] / (1.0 - phi)) * (1.0 - phi * phi)


def _curve_of_one(
    m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any
) -> None:  # pragma: no cover - compiled
    _autoregressive_one(carray(m_, count), s_[0], carray(b_, count), carray(db_, count))


def _curve(
    m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any
) -> None:  # pragma: no cover - compiled
    m, s, b, db = carray(m_, count), carray(s_, shapes), carray(b_, count), carray(db_, (count, shapes))
    arma(m, s, order, b)
    other = np.empty(count)
    for k in range(shapes):
        near = s.copy()
        near[k] += STEP
        arma(m, near, order, other)
        for i in range(count):
            db[i, k] = other[i]
        near[k] -= 2.0 * STEP
        arma(m, near, order, other)
        for i in range(count):
            db[i, k] = (db[i, k] - other[i]) / (2.0 * STEP)


def _partial_autocorrelations(coefficients: Array) -> tuple[float, ...]:
    """Inverse hyperbolic tangents of the partial autocorrelations: the inverse of :func:`insemu.noise.compiled.doubling.coefficients_of`."""
    a = np.array(coefficients, dtype=np.float64)
    out = np.zeros(a.size)
    for k in range(a.size - 1, -1, -1):
        r = a[k]
        if not abs(r) < 1.0:
            raise InputError(
                f"coefficients {tuple(coefficients)} are not those of a stationary (or invertible) process"
            )
        out[k] = math.atanh(r)
        a = (a[:k] + r * a[:k][::-1]) / (1.0 - r * r)
    return tuple(float(v) for v in out)


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
    curve = staticmethod(_curve_of_one)
    slows: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_rate(self)

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
        averages = np.ascontiguousarray(np.atleast_1d(counts(m)).ravel())
        b, db = np.empty(averages.size), np.empty(averages.size)
        _autoregressive_one(averages, math.atanh(self.parameters["phi"]), b, db)
        return 2.0 * self.variance * b.reshape(np.shape(m))

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

    def coordinates(self, dt: float) -> tuple[float | None, tuple[float | None, ...]]:
        """The coefficient is the stationary variance, which stays of one size as ``phi`` nears 1."""
        if self.phi is None:
            if self.sigma2 is not None:
                raise InputError("AR1: sigma2 is held but phi is free; hold both or none")
            return None, (None,)
        return (None if self.sigma2 is None else self.sigma2 / (1.0 - self.phi**2)), (math.atanh(self.phi),)

    def of_coordinates(self, coefficient: float, shapes: Sequence[float], dt: float) -> Self:  # noqa: D102
        z = float(shapes[0])
        inverse = 4.0 * math.exp(-2.0 * abs(z)) / (1.0 + math.exp(-2.0 * abs(z))) ** 2  # 1 - tanh^2
        phi = min(math.tanh(z), 1.0 - 1e-15) if self.phi is None else self.phi
        return self.with_parameters(
            {"phi": phi, "sigma2": coefficient * inverse if self.sigma2 is None else self.sigma2}
        )

    def coordinate_slopes(self, dt: float) -> dict[str, tuple[float, Array]]:  # noqa: D102
        phi = self.parameters["phi"]
        inverse = 1.0 / ((1.0 - phi) * (1.0 + phi))
        return {"phi": (2.0 * phi * self.variance * inverse, np.array([inverse])), "sigma2": (inverse, np.zeros(1))}

    def correlation_time(self, dt: float) -> float | None:  # noqa: D102
        phi = self.parameters["phi"]
        return -dt / math.log(phi) if phi > 0.0 else None

    def markov_parts(self, dt: float) -> MarkovParts | None:  # noqa: D102
        time = self.correlation_time(dt)
        return None if time is None else MarkovParts(decay=(dt / time,), variance=(self.variance,))

    def slowed(self, factor: float) -> Self:
        """The innovation variance stays."""
        phi = float(slower([self.parameters["phi"]], factor)[0].real)
        return replace(self, phi=phi, follows=None)

    def timed(self, factor: Array, dt: float) -> tuple[Array, Array, Array]:  # noqa: D102
        _carried_rate(self, dt)
        Phi = slower([self.parameters["phi"]], factor).real[:, :, None]
        return Phi, np.ones(1), np.full(factor.size, math.sqrt(self.parameters["sigma2"]))

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # noqa: D102
        return np.ones((1, 1), dtype=bool), np.ones((1, 1), dtype=bool)

    def of_transition(self, Phi: Array, Q: Array, dt: float) -> Self:  # noqa: D102
        phi = min(max(float(Phi[0, 0]), -1.0 + 1e-12), 1.0 - 1e-12)
        return self.with_parameters({"phi": phi, "sigma2": float(Q[0, 0])})

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        _carried_rate(self, dt)
        p = self.parameters
        return onward.first_order(rng, p["phi"], math.sqrt(self.variance), math.sqrt(p["sigma2"]))


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
        self.check_common()
        _check_rate(self)
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
    curve = staticmethod(_curve)

    @classmethod
    def of_arguments(cls, orders: Sequence[int], given: Mapping[str, Any], signal_unit: str, text: str) -> Self:
        """``AR(2)``, ``ARMA(p=2, q=1)`` are structures; without orders as :meth:`from_mapping`."""
        orders, given = list(orders), dict(given)
        for order in ("p", "q"):
            value = given.pop(order, None)
            if value is not None:
                number = whole(value)
                if number is None:
                    raise InputError(f"order {order} of {cls.__name__} is {shown(value)}, expected a whole number")
                orders.append(number)
        if given:
            return super().of_arguments(orders, given, signal_unit, text)
        wanted = len(cls.POLYNOMIALS)
        if len(orders) != wanted or min(orders) < 1:
            raise InputError(
                f"{cls.__name__} in the model {shown(text)} needs {wanted} order(s), for example {cls.__name__}({', '.join('2' * wanted)})"
            )
        return cls._of_orders(orders)

    @classmethod
    def _of_orders(cls, orders: Sequence[int]) -> Self:
        if max(orders) > MOST_ORDERS:
            raise InputError(f"{cls.__name__}: the order is {max(orders)}, expected at most {MOST_ORDERS}")
        unknown: dict[str, Any] = {n: (None,) * o for n, o in zip(cls.POLYNOMIALS, orders, strict=True)}
        return cls(**unknown)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """Coefficients ``ar`` and ``ma``, ``sigma2`` and ``rate_hz``; or ``order`` alone for a structure."""
        where = cls.__name__
        known = ("ar", "ma", "sigma2", "rate_hz", "order")
        unknown = [k for k in given if k not in known]
        if unknown:
            raise InputError(f"unknown key {shown(unknown[0])}" + nearest(str(unknown[0])[:40], known), where=where)
        if "order" in given:
            order = given["order"] if isinstance(given["order"], list) else [given["order"]]
            whole_ones = [o for o in order if isinstance(o, int) and not isinstance(o, bool) and o >= 1]
            if len(whole_ones) < len(order) or len(order) != len(cls.POLYNOMIALS):
                raise InputError(
                    f"order is {shown(given['order'])}, expected {len(cls.POLYNOMIALS)} whole number(s) of at least 1",
                    where=where,
                )
            return cls._of_orders(whole_ones)

        def coefficients(key: str) -> tuple[float, ...]:
            value = given.get(key, ())
            values = value if isinstance(value, list | tuple) else [value]
            if len(values) > MOST_ORDERS:
                raise InputError(f"found {len(values)} coefficients, expected at most {MOST_ORDERS}", where=where)
            return tuple(quantity(v, "1", f"{where}.{key}") for v in values)

        square = "({u})^2".format(u=signal_unit or "1")
        sigma2 = quantity(given["sigma2"], square, f"{where}.sigma2") if "sigma2" in given else None
        rate = quantity(given["rate_hz"], "Hz", f"{where}.rate_hz") if given.get("rate_hz") is not None else None
        known_ones: dict[str, Any] = {name: coefficients(name) for name in cls.POLYNOMIALS}
        return cls(**known_ones, sigma2=sigma2, rate_hz=rate)

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
    def given(self) -> dict[str, float | None]:  # noqa: D102
        flat: dict[str, float | None] = {f"ar_{i + 1}": v for i, v in enumerate(self.ar)}
        flat |= {f"ma_{i + 1}": v for i, v in enumerate(self.ma)}
        return flat | {"sigma2": self.sigma2}

    def with_parameters(self, values: Mapping[str, float | None]) -> Self:  # noqa: D102
        flat = self.given | dict(values)
        ar = tuple(flat[f"ar_{i + 1}"] for i in range(len(self.ar)))
        ma = tuple(flat[f"ma_{i + 1}"] for i in range(len(self.ma)))
        return replace(self, ar=ar, ma=ma, sigma2=flat["sigma2"])

    def at_rate(self, rate_hz: float) -> Self:  # noqa: D102
        return self if self.rate_hz is not None else replace(self, rate_hz=rate_hz)

    def _polynomials(self) -> tuple[Array, Array]:
        _ = self.parameters  # all known
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
        P0 = scipy.linalg.solve_discrete_lyapunov(Phi, Q)
        names = tuple(f"{self.symbol}.{i + 1}" for i in range(n))
        return StateBlock(names, Phi, Q, np.eye(n)[0], np.asarray(0.5 * (P0 + P0.T), dtype=np.float64), 0.0, dt)

    def carried(self, dt: float) -> StateBlock:
        """Without a moving average a chain of sections of first and second order (:mod:`insemu.noise.chain`)."""
        if len(self.ar) < 2 or self.ma:
            return self.block(dt)
        self.require_stationary()
        Phi, drive, c = sections(self.poles, np.ones(1))
        Q = np.outer(drive, drive) * self.parameters["sigma2"]
        P0 = np.asarray(scipy.linalg.solve_discrete_lyapunov(Phi[0], Q), dtype=np.float64)
        names = tuple(f"{self.symbol}.{i + 1}" for i in range(len(self.ar)))
        return StateBlock(names, Phi[0], Q, c, 0.5 * P0 + 0.5 * P0.T, 0.0, dt)

    def psd(self, f: ArrayLike, dt: float) -> Array:  # noqa: D102
        _carried_rate(self, dt)
        ar, ma = self._polynomials()
        z = np.exp(-2j * np.pi * np.asarray(f, dtype=np.float64) * dt)
        ratio = np.polynomial.polynomial.polyval(z, ma) / np.polynomial.polynomial.polyval(z, ar)
        return np.asarray(self.parameters["sigma2"] * dt * np.abs(ratio) ** 2)

    @property
    def order(self) -> int:  # noqa: D102
        return len(self.ar)

    def coordinates(self, dt: float) -> tuple[float | None, tuple[float | None, ...]]:
        """The coefficient is the innovation variance; shapes are those of the partial autocorrelations of both polynomials."""
        known = [v for v in (*self.ar, *self.ma) if v is not None]
        if len(known) < len(self.ar) + len(self.ma):
            if known:
                raise InputError(f"{self.symbol}: only some coefficients have values; give all (they are held) or none")
            return self.sigma2, (None,) * (len(self.ar) + len(self.ma))
        ar, ma = np.array(self.ar, dtype=np.float64), np.array(self.ma, dtype=np.float64)
        return self.sigma2, (*_partial_autocorrelations(ar), *_partial_autocorrelations(-ma))

    def of_coordinates(self, coefficient: float, shapes: Sequence[float], dt: float) -> Self:  # noqa: D102
        s = np.array(shapes, dtype=np.float64)
        values = [*coefficients_of(s[: self.order]), *(-coefficients_of(s[self.order :])), coefficient]
        found = dict(zip(self.given, map(float, values), strict=True))
        held = {name: v for name, v in self.given.items() if v is not None and name != "sigma2"}
        return self.with_parameters(found | held)

    def coordinate_slopes(self, dt: float) -> dict[str, tuple[float, Array]]:
        """Shapes by central differences: they follow from the coefficients by a recursion."""
        out = {}
        values = self.parameters
        for name, value in values.items():
            if name == "sigma2":
                out[name] = (1.0, np.zeros(len(values) - 1))
                continue
            h = 1e-6 * max(1.0 - abs(value), 1e-3)
            up, down = (self.with_parameters({name: value + d}).coordinates(dt)[1] for d in (h, -h))
            out[name] = (0.0, (np.array(up, dtype=np.float64) - np.array(down, dtype=np.float64)) / (2.0 * h))
        return out

    def shape_bounds(self, n_samples: int) -> list[tuple[float, float]]:  # noqa: D102
        return [(-6.0, 6.0)] * (len(self.ar) + len(self.ma))

    def shape_grid(self, n_samples: int, alike: int, rng: np.random.Generator) -> list[tuple[float, ...]]:  # noqa: D102
        size = len(self.ar) + len(self.ma)
        return [(0.0,) * size] + [tuple(float(v) for v in rng.normal(0.0, 1.0, size)) for _ in range(59)]

    def source(self, n: int, dt: float, rng: np.random.Generator) -> Source:  # noqa: D102
        block = self.block(dt)
        eigenvalues, vectors = np.linalg.eigh(block.P0)
        start = vectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(block.n))
        ar, ma = self._polynomials()
        # Harvey's state is the direct form II transposed: y_0 sees Phi x_(-1)
        memory = (block.Phi @ start)[: max(len(ar), len(ma)) - 1]
        padded = max(len(ar), len(ma))
        b, a = np.pad(ma, (0, padded - len(ma))), np.pad(ar, (0, padded - len(ar)))
        return onward.rational(rng, math.sqrt(self.parameters["sigma2"]), b, a, _transposed_memory(memory, padded - 1))

    def __str__(self) -> str:
        if not self.specified:
            orders = [str(len(v)) for v in (self.ar, self.ma) if len(v)]
            return f"{self.symbol}({', '.join([*orders, *self.common_arguments()])})"
        return super().__str__()


def _transposed_memory(memory: Array, size: int) -> Array:
    out = np.zeros(size)
    out[: memory.size] = memory[:size]
    return out


@dataclass(frozen=True)
class AR(ARMA):
    """Autoregression of order p: ``AR(2)`` is the structure, ``AR((1.5, -0.6), sigma2=..., rate_hz=...)`` the process."""

    POLYNOMIALS: ClassVar[tuple[str, ...]] = ("ar",)
    slows: ClassVar[bool] = True

    def slowed(self, factor: float) -> Self:
        """The innovation variance stays, and the angle of every pole."""
        moved = np.poly(slower(self.poles, factor))
        return replace(self, ar=tuple(float(v) for v in -np.real(moved)[1:]), follows=None)

    def timed(self, factor: Array, dt: float) -> tuple[Array, Array, Array]:  # noqa: D102
        _carried_rate(self, dt)
        Phi, drive, _ = sections(self.poles, factor)
        return Phi, drive, np.full(factor.size, math.sqrt(self.parameters["sigma2"]))

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # noqa: D102
        n = len(self.ar)
        Phi, Q = np.zeros((n, n), dtype=bool), np.zeros((n, n), dtype=bool)
        Phi[:, 0] = Q[0, 0] = True
        return Phi, Q

    def of_transition(self, Phi: Array, Q: Array, dt: float) -> Self:  # noqa: D102
        return replace(self, ar=tuple(float(v) for v in Phi[:, 0]), sigma2=float(Q[0, 0]))

    def __post_init__(self) -> None:
        if isinstance(self.ar, int):
            object.__setattr__(self, "ar", (None,) * self.ar)
        if self.ma:
            raise InputError("AR has no moving-average coefficients; use ARMA")
        super().__post_init__()


@dataclass(frozen=True)
class MA(ARMA):
    """Moving average of order q: ``MA.of_order(0, 2)`` is the structure."""

    POLYNOMIALS: ClassVar[tuple[str, ...]] = ("ma",)

    def __post_init__(self) -> None:
        if self.ar:
            raise InputError("MA has no autoregressive coefficients; use ARMA")
        super().__post_init__()
