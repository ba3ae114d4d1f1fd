"""Parameters of a process: what they are, how they are read and written, and how an estimator moves them.

Every process has one parameter that scales its signal, its level. An estimator sees its square in variances of samples (the coefficient of
the process), and every other parameter as an unconstrained number (its shapes).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest, shown
from insemu.noise import grammar

Array = NDArray[np.float64]
Domain = Literal["positive", "rate", "time", "frequency", "real", "correlation", "coefficient"]

#: Seconds in the unit of a level together with the signal's: the power of the sampling interval that makes it one of samples.
_SECONDS = {"{u}/sqrt(Hz)": 0.5, "({u})*s": 1.0, "{u}*sqrt(Hz)": -0.5, "{u}/s": -1.0}
#: Correlation times are searched up to this many record lengths: beyond, a process cannot be distinguished from a random walk.
LONGEST_RECORDS = 20.0
#: Largest value of a parameter, and one over the smallest of a rate, time or frequency: beyond, squares and products are no numbers.
LARGEST = 1e100
#: Points of the grid of correlation times for one, two, ... processes of a kind; fewer for each as their combinations multiply.
_TIMES = {1: 30, 2: 18, 3: 14, 4: 11}
_TIMES_CORRELATION = {1: 30, 2: 16, 3: 12}


@dataclass(frozen=True)
class Parameter:
    """What a parameter is: its name, its unit in terms of the signal's unit ``{u}``, and its domain.

    Domains: ``positive`` (zero allowed), ``rate`` (1/s), ``time`` (s) and ``frequency`` (Hz, below half the sampling rate), all three above
    zero, ``real``, ``correlation`` (between -1 and 1), ``coefficient``.
    """

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

    def of_text(self, text: object) -> float | None:
        """A quantity such as ``0.34 deg/sqrt(h)`` in SI, of a gyroscope or of an accelerometer as its unit says; None where it is none."""
        for signal_unit in ("rad/s", "m/s^2") if isinstance(text, str) else ():
            try:
                return grammar.quantity(text, self.unit_for(signal_unit), self.name)
            except InputError:
                continue
        return None

    @property
    def positive(self) -> bool:
        """Whether the logarithm is the natural scale of the parameter."""
        return self.domain in ("positive", "rate", "time", "frequency")

    @property
    def power(self) -> int:
        """Power of the signal in the parameter: 1 for a deviation or density, 2 for a variance, 0 for a time or coefficient."""
        return 0 if "{u}" not in self.unit else 2 if "^2" in self.unit else 1

    @property
    def sample_power(self) -> float:
        """Power of the sampling interval that a squared level is divided by to be a variance of samples."""
        return 2.0 * _SECONDS.get(self.unit, 0.0)

    def check(self, value: float, symbol: str) -> None:
        """Raise ``InputError`` where a value is outside the domain."""
        bad = (
            not math.isfinite(value)
            or (self.positive and value < 0)
            or (self.domain == "correlation" and not -1 < value < 1)
            or (self.domain in ("rate", "time", "frequency") and value == 0)
        )
        least = 1.0 / LARGEST if self.domain in ("rate", "time", "frequency") else 0.0
        if not bad and least <= abs(value) <= LARGEST:
            return
        if not bad:
            raise InputError(
                f"{symbol}: {self.name} ({self.meaning}) is {value!r}, expected a size from {least:g} to {LARGEST:g}"
            )
        expected = "a finite number"
        if self.domain == "positive":
            expected = "a number that is not negative"
        elif self.positive:
            expected = "a positive number"
        elif self.domain == "correlation":
            expected = "a number between -1 and 1"
            if abs(value) >= 1.0:
                expected += f"; the nearest stable is {math.copysign(1.0 - 1e-6, value):.6f}"
                expected += ", and at 1 it is a random walk (RW)" if value > 0 else ""
        raise InputError(f"{symbol}: {self.name} ({self.meaning}) is {value!r}, expected {expected}")

    # -- the parameter as an unconstrained number, a shape ------------------------------------------------------------------------

    def shape(self, value: float, dt: float, symbol: str) -> float:
        """The unconstrained number of a value; raises ``InputError`` for a frequency beyond half the sampling rate.

        Parameters
        ----------
        value : float
            SI.
        dt : float
            Sampling interval, s.
        symbol : str
            Of the process, for messages.
        """
        if self.domain == "frequency":
            x = 2.0 * value * dt
            if not 0.0 < x < 1.0:
                raise InputError(
                    f"{symbol}: {self.name} is {value} Hz, expected less than half the sampling rate ({0.5 / dt:g} Hz)"
                )
            return math.log(x / (1.0 - x))
        if self.domain == "correlation":
            return math.atanh(value)
        if self.domain == "time":
            return math.log(value / dt)
        return math.log(value * dt) if self.domain == "rate" else math.log(value) if self.positive else value

    def of_shape(self, shape: float, dt: float) -> float:
        """The inverse of :meth:`shape`."""
        if self.domain == "frequency":
            return 0.5 / (1.0 + math.exp(-shape)) / dt
        if self.domain == "correlation":
            return min(math.tanh(shape), 1.0 - 1e-15)
        if self.domain == "time":
            return math.exp(shape) * dt
        return math.exp(shape) / dt if self.domain == "rate" else math.exp(shape) if self.positive else shape

    def slope(self, value: float, dt: float) -> float:
        """Derivative of the shape by the value."""
        if self.domain == "frequency":
            return 1.0 / (value * (1.0 - 2.0 * value * dt))
        if self.domain == "correlation":
            return 1.0 / ((1.0 - value) * (1.0 + value))
        return 1.0 / value if self.positive else 1.0

    def bounds(self, n_samples: int) -> tuple[float, float]:
        """Search limits of the shape for a record of so many samples."""
        longest = LONGEST_RECORDS * n_samples
        if self.domain == "rate":
            return -math.log(longest), math.log(6.0)
        if self.domain == "time":
            return 0.0, math.log(n_samples)
        if self.domain == "correlation":
            return -4.0, 0.5 * math.log(2.0 * longest)
        return (-math.log(2.0 * n_samples), 9.0) if self.domain == "frequency" else (-6.0, 6.0)

    def grid(self, n_samples: int, alike: int) -> list[float]:
        """Shapes to begin a search from, where ``alike`` processes of one kind share the grid."""
        if self.domain == "rate":
            # time constants from below a sample to beyond the record; a few random-walk-like ones
            return [float(v) for v in -np.log(np.geomspace(0.6, 3.0 * n_samples, _TIMES.get(alike, 9)))]
        if self.domain == "time":
            return [float(v) for v in np.log(np.geomspace(1.0, n_samples, _TIMES.get(alike, 9)))]
        if self.domain == "correlation":
            a = 1.0 / np.geomspace(0.6, 3.0 * n_samples, _TIMES_CORRELATION.get(alike, 9))
            return [-1.8, -0.8, -0.25, *(float(v) for v in np.arctanh(np.minimum(np.exp(-a), 1.0 - 1e-12)))]
        if self.domain == "frequency":
            x = np.geomspace(4.0 / n_samples, 0.98, 60)
            return [float(v) for v in np.log(x / (1.0 - x))]
        return [-4.0, -2.0, -1.0, 0.0, 1.0]


@dataclass(frozen=True)
class Parametrised:
    """A frozen set of parameters, some of which may be unknown (None)."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    #: Estimators that cannot fit the process, and why.
    REFUSED: ClassVar[Mapping[str, str]] = {}
    _structure: ClassVar[tuple[Parameter, ...]] = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls._structure = tuple(p for p in cls.PARAMETERS if not p.optional)

    def __post_init__(self) -> None:
        for p in self.PARAMETERS:
            value = getattr(self, p.name)
            if value is not None:
                number: float | None
                try:
                    number = float(value)
                except (TypeError, ValueError, OverflowError):
                    number = p.of_text(value)
                if number is None:
                    found = shown(value)
                    raise InputError(
                        f"{self.symbol}: {p.name} ({p.meaning}) is {found}, expected a finite number, or text with a unit of a rate or of a "
                        "specific force"
                    )
                object.__setattr__(self, p.name, number)
                p.check(number, self.symbol)

    @property
    def symbol(self) -> str:
        """The short registered name."""
        return type(self).__name__

    @property
    def carried_rate_hz(self) -> float | None:
        """The sampling rate that a discrete process carries; None where the process is free of a rate or has none yet."""
        return getattr(self, "rate_hz", None)

    def parameters_meta(self) -> tuple[Parameter, ...]:
        """The parameters that make up the structure, in order."""
        return self._structure

    @property
    def given(self) -> dict[str, float | None]:
        """Names and values of the structural parameters (SI), None where unknown."""
        return {p.name: getattr(self, p.name) for p in self.parameters_meta()}

    @property
    def specified(self) -> bool:
        """Whether every parameter has a value."""
        return None not in self.given.values()

    @property
    def parameters(self) -> dict[str, float]:
        """Names and values of the structural parameters (SI); raises where one is unknown."""
        given = self.given
        if None in given.values():
            missing = ", ".join(name for name, value in given.items() if value is None)
            raise InputError(f"{self.symbol}: no value for {missing}; fit the model or give the parameters")
        return cast("dict[str, float]", given)

    def with_parameters(self, values: Mapping[str, float | None]) -> Self:
        """The same structure with these parameter values."""
        return replace(self, **dict(values))

    def at_rate(self, rate_hz: float) -> Self:
        """The process at a sampling rate: itself, except that a discrete process without a rate takes this one."""
        return self

    @cached_property
    def level(self) -> Parameter:
        """The parameter that scales the signal: the one whose unit has the signal's."""
        return next(p for p in self.parameters_meta() if p.power)

    def scaled(self, factor: float) -> Self:
        """The process whose signal is ``factor`` times this one's; times and coefficients stay."""
        metas = {p.name: p for p in (*self.parameters_meta(), *self.PARAMETERS)}
        known = self.parameters | {f.name: getattr(self, f.name) for f in fields(self)}
        return self.with_parameters({name: known[name] * factor**p.power for name, p in metas.items() if p.power})

    # -- as an estimator sees it --------------------------------------------------------------------------------------------------

    def refuse(self, method: str) -> None:
        """Raise ``InputError`` where an estimator (``gmwm``, ``mli``, ``em``, ...) is not defined for the process, with the reason."""
        if method in self.REFUSED:
            raise InputError(f"{self.symbol} cannot be fitted by {method}: {self.REFUSED[method]}")

    @property
    def shape_parameters(self) -> tuple[Parameter, ...]:
        """The parameters other than the level."""
        return tuple(p for p in self.parameters_meta() if not p.power)

    def coordinates(self, dt: float) -> tuple[float | None, tuple[float | None, ...]]:
        """Coefficient (the squared level as a variance of samples at ``dt``) and shapes, None where unknown."""
        given, level = self.given, self.level
        value = given[level.name]
        coefficient = None if value is None else abs(value) ** (2 // level.power) / dt**level.sample_power
        known = ((p, given[p.name]) for p in self.shape_parameters)
        return coefficient, tuple(None if v is None else p.shape(v, dt, self.symbol) for p, v in known)

    def of_coordinates(self, coefficient: float, shapes: Sequence[float], dt: float) -> Self:
        """The process with this coefficient and these shapes; parameters that have a value keep it.

        Parameters
        ----------
        coefficient : float
            Squared level as a variance of samples, unit^2.
        shapes : sequence of float
            One per parameter other than the level.
        dt : float
            Sampling interval, s.
        """
        level = self.level
        found = {p.name: p.of_shape(float(s), dt) for p, s in zip(self.shape_parameters, shapes, strict=True)}
        found[level.name] = (coefficient * dt**level.sample_power) ** (0.5 * level.power)
        return self.with_parameters(found | {name: v for name, v in self.given.items() if v is not None})

    def coordinate_slopes(self, dt: float) -> dict[str, tuple[float, Array]]:
        """Derivatives of the coefficient and of the shapes by each parameter as it is written."""
        values, level = self.parameters, self.level
        none = np.zeros(len(self.shape_parameters))
        amplitude = abs(values[level.name])
        coefficient = self.coordinates(dt)[0] or 0.0
        out = {level.name: (2.0 / level.power * coefficient / amplitude if amplitude > 0 else 0.0, none)}
        for k, p in enumerate(self.shape_parameters):
            one = none.copy()
            one[k] = p.slope(values[p.name], dt)
            out[p.name] = (0.0, one)
        return {p.name: out[p.name] for p in self.parameters_meta()}

    def shape_bounds(self, n_samples: int) -> list[tuple[float, float]]:
        """Search limits of the shapes for a record of so many samples."""
        return [p.bounds(n_samples) for p in self.shape_parameters]

    def shape_grid(self, n_samples: int, alike: int, rng: np.random.Generator) -> list[tuple[float, ...]]:
        """Shapes to begin a search from.

        Parameters
        ----------
        n_samples : int
            Length of the record.
        alike : int
            Processes of this kind in the model, whose combinations of grid points are tried.
        rng : Generator
            For a sample where a grid would be too large.
        """
        out: list[tuple[float, ...]] = [()]
        for p in self.shape_parameters:
            out = [(*head, value) for head in out for value in p.grid(n_samples, alike)]
        return out

    # -- as text ------------------------------------------------------------------------------------------------------------------

    def __str__(self) -> str:
        given = [
            f"{f.name}={value!r}"
            for f in fields(self)
            if not f.kw_only and (value := getattr(self, f.name)) != f.default
        ]
        return f"{self.symbol}({', '.join([*given, *self.common_arguments()])})"

    def common_arguments(self) -> list[str]:
        """What any process may say of itself, as text of a model has it."""
        return []

    @classmethod
    def of_arguments(cls, orders: Sequence[int], given: Mapping[str, Any], signal_unit: str, text: str) -> Self:
        """The process that a term of a model's text describes.

        Parameters
        ----------
        orders : sequence of int
            Arguments without a name.
        given : mapping
            Arguments with a name, as text or lists of text.
        signal_unit : str
            SI unit of the signal.
        text : str
            The whole model, for messages.

        Raises
        ------
        InputError
            An argument that the process does not have.
        """
        if orders:
            raise InputError(
                f"found an unnamed argument in {cls.__name__} of the model {shown(text)}; expected name=quantity"
            )
        return cls.from_mapping(given, signal_unit)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """The process with these named quantities, numbers in SI or text with a unit; raises ``InputError``.

        A correlation time ``Tc`` (s) may stand for a rate ``beta``.
        """
        known = {p.name: p for p in cls.PARAMETERS}
        given = cls.with_rate(given)
        unknown = [k for k in given if k not in known]
        if unknown:
            raise InputError(
                f"unknown key {shown(unknown[0])}" + nearest(str(unknown[0])[:40], known), where=cls.__name__
            )
        return cls(
            **{k: grammar.quantity(v, known[k].unit_for(signal_unit), f"{cls.__name__}.{k}") for k, v in given.items()}
        )

    @classmethod
    def with_rate(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        """The quantities with the inverse of ``Tc`` for the rate of a process that has one; raises ``InputError``."""
        given = dict(given)
        rate = next((p.name for p in cls.PARAMETERS if p.domain == "rate"), None)
        if rate is None or "Tc" not in given:
            return given
        if rate in given:
            raise InputError(f"found both {rate} and Tc, expected one of them", where=cls.__name__)
        time = grammar.quantity(given.pop("Tc"), "s", f"{cls.__name__}.Tc")
        if not time > 0:
            raise InputError(f"Tc (correlation time) is {time!r}, expected a positive number", where=cls.__name__)
        return given | {rate: 1.0 / time}

    def to_mapping(self, signal_unit: str) -> dict[str, Any]:
        """The inverse of :meth:`from_mapping`, with the key ``process``; quantities as text with their SI unit."""
        out: dict[str, Any] = {"process": self.symbol}
        for p in self.PARAMETERS:
            value = getattr(self, p.name)
            if value is None or (p.optional and value == 0.0):
                continue
            unit = p.unit_for(signal_unit) if signal_unit else ""
            out[p.name] = f"{value!r} {unit}" if unit not in ("", "1") else value
        if self.carried_rate_hz is not None:
            out["rate_hz"] = self.carried_rate_hz
        return out
