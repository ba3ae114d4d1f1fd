"""What a stochastic process is, and sums of independent processes: as code, as text and as plain data for YAML.

The two stand together because each makes the other: ``WN() + GM()`` is a sum, and a sum is asked what a process is asked. A process
registers itself by being defined; the modules of :mod:`insemu.noise.processes` hold those of the package.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest
from insemu.noise import grammar
from insemu.noise.block import StateBlock

Array = NDArray[np.float64]
Domain = Literal["positive", "real", "correlation", "coefficient"]

#: Every process by its registered name.
PROCESSES: dict[str, type[Process]] = {}


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


def counts(m: ArrayLike) -> Array:
    """Samples per average as numbers; raises ``InputError`` where they are not whole or below 1."""
    whole = np.asarray(m, dtype=np.float64)
    if (whole < 1).any() or (whole != np.floor(whole)).any():
        raise InputError("averages must span whole numbers of samples, at least 1")
    return whole


@dataclass(frozen=True)
class Process(ABC):
    """One stochastic process; subclasses give the closed forms.

    Conventions: m counts samples in an average, lags count samples, ``dt`` is in s, PSDs are two-sided in unit^2/Hz.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    stationary: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        PROCESSES[cls.__name__] = cls

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
    def carried_rate_hz(self) -> float | None:
        """The sampling rate that a discrete process carries; None where the process is free of a rate or has none yet."""
        return getattr(self, "rate_hz", None)

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
        return NoiseModel((self,)) + other

    def __rmul__(self, count: int) -> NoiseModel:
        return count * NoiseModel((self,))

    def __str__(self) -> str:
        given = ", ".join(
            f"{f.name}={getattr(self, f.name)!r}" for f in fields(self) if getattr(self, f.name) != f.default
        )
        return f"{self.symbol}({given})"

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
            inside = ", ".join([*map(str, orders), *(f"{k}={v}" for k, v in given.items())])
            raise InputError(
                f"found an unnamed argument in '{cls.__name__}({inside})' of the model '{text}'; expected name=quantity"
            )
        return cls.from_mapping(given, signal_unit)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any], signal_unit: str) -> Self:
        """The process with these named quantities, numbers in SI or text with a unit; raises ``InputError``."""
        known = {p.name: p for p in cls.PARAMETERS}
        unknown = [k for k in given if k not in known]
        if unknown:
            raise InputError(f"unknown key '{unknown[0]}'" + nearest(unknown[0], known), where=cls.__name__)
        return cls(
            **{k: grammar.quantity(v, known[k].unit_for(signal_unit), f"{cls.__name__}.{k}") for k, v in given.items()}
        )

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


def process_of(item: Mapping[str, Any], signal_unit: str) -> Process:
    """The process of one mapping with the key ``process``; raises ``InputError``."""
    given = dict(item)
    name = given.pop("process", None)
    name = grammar.ALIASES.get(name, name)
    if name not in PROCESSES:
        raise InputError(f"unknown process {name!r}" + nearest(str(name), PROCESSES), where="process")
    return PROCESSES[name].from_mapping(given, signal_unit)


@dataclass(frozen=True)
class NoiseModel:
    """A sum of independent processes.

    Parameters
    ----------
    processes : tuple of Process
        In the order given; repeated processes are told apart by their index among their kind, from 1.

    Examples
    --------
    >>> from insemu.noise import GM, WN
    >>> model = WN(N=1e-3) + GM(sigma=2e-4, beta=0.01)
    >>> print(2 * GM() + WN())
    2*GM() + WN()
    >>> NoiseModel.parse("2*GM() + WN()") == 2 * GM() + WN()
    True
    """

    processes: tuple[Process, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "processes", tuple(self.processes))
        rates = {p.carried_rate_hz for p in self.processes if p.carried_rate_hz is not None}
        if len(rates) > 1:
            raise InputError(
                f"discrete processes at different rates ({', '.join(f'{r:g} Hz' for r in sorted(rates))}) cannot be added"
            )

    def __iter__(self) -> Iterator[Process]:
        return iter(self.processes)

    def __len__(self) -> int:
        return len(self.processes)

    def __add__(self, other: Process | NoiseModel) -> NoiseModel:
        if isinstance(other, Process):
            other = NoiseModel((other,))
        if not isinstance(other, NoiseModel):
            return NotImplemented
        return NoiseModel(self.processes + other.processes)

    def __rmul__(self, count: int) -> NoiseModel:
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise InputError(f"found {count!r} times a noise model, expected a whole number of at least 1")
        return NoiseModel(self.processes * count)

    # -- parameters ---------------------------------------------------------------------------------------------------------------

    @property
    def specified(self) -> bool:
        """Whether every parameter has a value."""
        return all(p.specified for p in self)

    @property
    def stationary(self) -> bool:
        """Whether every process is."""
        return all(p.stationary for p in self)

    def indexed(self) -> Iterator[tuple[int, Process]]:
        """Yield ``(index among its kind, process)``, counting from 1."""
        seen: dict[str, int] = {}
        for p in self:
            seen[p.symbol] = seen.get(p.symbol, 0) + 1
            yield seen[p.symbol], p

    def at_rate(self, rate_hz: float) -> NoiseModel:
        """The model at a sampling rate: discrete processes without a rate take it."""
        return NoiseModel(tuple(p.at_rate(rate_hz) for p in self))

    def scaled(self, factor: float) -> NoiseModel:
        """The model whose signal is ``factor`` times this one's."""
        return NoiseModel(tuple(p.scaled(factor) for p in self))

    # -- closed forms: sums over the processes ------------------------------------------------------------------------------------

    def allan_variance(self, m: ArrayLike, dt: float) -> Array:
        """Allan variance of averages of ``m`` samples at interval ``dt``, unit^2; see :meth:`Process.allan_variance`."""
        return np.asarray(sum((p.allan_variance(m, dt) for p in self), start=np.zeros(np.shape(m))))

    def wavelet_variance(self, scale: ArrayLike, dt: float) -> Array:
        """Haar wavelet variance at scales of 2^j samples, unit^2."""
        return np.asarray(sum((p.wavelet_variance(scale, dt) for p in self), start=np.zeros(np.shape(scale))))

    def psd(self, f: ArrayLike, dt: float) -> Array:
        """Two-sided PSD of the sampled sequence, unit^2/Hz."""
        return np.asarray(sum((p.psd(f, dt) for p in self), start=np.zeros(np.shape(f))))

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:
        """Autocovariance at ``lag`` samples, unit^2; raises ``NotStationary`` where a process has none."""
        wandering = [p.symbol for p in self if not p.stationary]
        if wandering:
            raise NotStationary(f"{self} has no autocovariance: {', '.join(wandering)} not stationary")
        return np.asarray(sum((p.autocovariance(lag, dt) for p in self), start=np.zeros(np.shape(lag))))

    def block(self, dt: float) -> StateBlock:
        """State block of the sum; states are named by process and index, for example ``GM1``, ``GM2``, ``RW1``."""
        named = []
        for index, p in self.indexed():
            b = p.block(dt)
            names = tuple(name.replace(p.symbol, f"{p.symbol}{index}", 1) for name in b.names)
            named.append(StateBlock(names, b.Phi, b.Q, b.c, b.P0, b.white, dt))
        return StateBlock.stack(named, dt)

    # -- draws --------------------------------------------------------------------------------------------------------------------

    def simulate_components(self, n: int, dt: float, rng: np.random.Generator, out: Array | None = None) -> Array:
        """Draw every process, into ``out`` (processes, n) where it is given.

        Each process draws from its own child of ``rng``, so that a process added at the end leaves the others as they were.

        Returns
        -------
        (processes, n) array
        """
        parts = np.empty((len(self), n)) if out is None else out
        for row, p, child in zip(parts, self, rng.spawn(len(self)), strict=True):
            p.fill(row, dt, child)
        return parts

    def simulate(self, n: int, dt: float, rng: np.random.Generator) -> Array:
        """Draw ``n`` samples of the sum at interval ``dt`` (s)."""
        return np.asarray(self.simulate_components(n, dt, rng).sum(axis=0))

    # -- text ---------------------------------------------------------------------------------------------------------------------

    def __str__(self) -> str:
        texts: list[str] = []
        counts: list[int] = []
        for p in self:
            if texts and texts[-1] == str(p):
                counts[-1] += 1
            else:
                texts.append(str(p))
                counts.append(1)
        return " + ".join(t if c == 1 else f"{c}*{t}" for t, c in zip(texts, counts, strict=True)) or "0"

    @classmethod
    def parse(cls, text: str, signal_unit: str = "") -> NoiseModel:
        """Read ``"2*GM() + WN(N=0.032 deg/s/sqrt(Hz))"``.

        Parameters
        ----------
        text : str
            A sum of ``[count*]NAME(arguments)``; arguments are ``name=quantity``, and for AR, MA and ARMA the orders.
        signal_unit : str
            SI unit of the signal (``rad/s``, ``m/s^2``), needed only where arguments carry units.

        Raises
        ------
        InputError
            Anything else, naming what was found.
        """
        processes: list[Process] = []
        for count, name, orders, given in grammar.terms(text, PROCESSES):
            processes += [PROCESSES[name].of_arguments(orders, given, signal_unit, text)] * count
        return cls(tuple(processes))

    def to_list(self, signal_unit: str = "") -> list[dict[str, Any]]:
        """The model as plain data for YAML or JSON: one mapping per process, quantities with their SI unit as text."""
        return [p.to_mapping(signal_unit) for p in self]

    @classmethod
    def from_list(cls, items: Sequence[Mapping[str, Any]] | str, signal_unit: str = "") -> NoiseModel:
        """The inverse of :meth:`to_list`; quantities may be in any unit of the right dimension. A text goes to :meth:`parse`.

        A GM may give ``Tc`` (s) instead of ``beta``, and the density ``q`` of its continuous driving noise instead of ``sigma``.

        Raises
        ------
        InputError
            An unknown process or key, a unit of the wrong dimension, a value out of its domain.
        """
        if isinstance(items, str):
            return cls.parse(items, signal_unit)
        if not isinstance(items, Sequence) or not all(isinstance(item, Mapping) for item in items):
            raise InputError(f"found {items!r}, expected a list of processes such as [{{process: WN, N: 1e-3}}]")
        return cls(tuple(process_of(item, signal_unit) for item in items if isinstance(item, Mapping)))
