"""What a stochastic process is, and sums of independent processes: as code, as text and as plain data for YAML.

The two stand together because each makes the other: ``WN() + GM()`` is a sum, and a sum is asked what a process is asked. The modules of
:mod:`insemu.noise.processes` hold the processes of the package.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest, shown
from insemu.noise import follow, grammar, onward
from insemu.noise.block import StateBlock
from insemu.noise.common import Common, common_keys
from insemu.noise.compiled import curves

Array = NDArray[np.float64]

#: Every process that text and YAML know, by its name.
PROCESSES: dict[str, type[Process]] = {}


#: Relative difference up to which two sampling rates are one: stamps and their mean interval round differently.
SAME_RATE = 1e-9


class NotStationary(InputError):
    """Asked for an autocovariance that does not exist, or a polynomial has a root on or outside the unit circle."""


def counts(m: ArrayLike) -> Array:
    """Samples per average as numbers; raises ``InputError`` where they are not whole or below 1."""
    whole = np.asarray(m, dtype=np.float64)
    if (whole < 1).any() or (whole != np.floor(whole)).any():
        raise InputError("averages must span whole numbers of samples, at least 1")
    return whole


def of_structure(structure: Array) -> Array:
    """Autocovariance of successive differences from the mean-square difference of values 1, 2, ... ``count + 1`` apart.

    Parameters
    ----------
    structure : (count,) array
        Mean-square difference of values 1 ... ``count`` apart.

    Returns
    -------
    (count,) array
        At lags 0 ... ``count - 1``; half the second difference of the structure function, which is even and zero at zero.
    """
    padded = np.concatenate([structure[:1], [0.0], structure])
    return np.asarray(0.5 * (padded[2:] + padded[:-2] - 2.0 * padded[1:-1]))


_P = TypeVar("_P")


class _WithTime(ABCMeta):
    """Lets a correlation time ``Tc`` stand for a rate where a process is made, as it does in text."""

    def __call__(cls: type[_P], *arguments: Any, **given: Any) -> _P:
        return super().__call__(*arguments, **(cls.with_rate(given) if "Tc" in given else given))  # type: ignore[attr-defined, misc, no-any-return]


@dataclass(frozen=True)
class Process(Common, metaclass=_WithTime):
    """One stochastic process. Its state block says what it is; everything else follows from that.

    A subclass gives parameters and a block, and closed forms where they are better than what is derived here: exact where the block
    cancels digits, or faster. Conventions: m counts samples in an average, lags count samples, ``dt`` is in s, PSDs are two-sided in
    unit^2/Hz.
    """

    stationary: ClassVar[bool] = True
    #: Without driving noise: a record holds one draw, which is a signal rather than noise.
    single_draw: ClassVar[bool] = False
    #: A straight line in time, which least squares can take off.
    ramp: ClassVar[bool] = False
    #: Whether the block is the process itself; else it stands for the process in a filter.
    own_block: ClassVar[bool] = True
    #: Function of :data:`insemu.noise.compiled.curves.SIGNATURE` for the process with coefficient 1; None derives it.
    curve: ClassVar[Callable[..., None] | None] = None

    @abstractmethod
    def block(self, dt: float) -> StateBlock:
        """State block at sampling interval ``dt`` (s)."""

    def carried(self, dt: float) -> StateBlock:
        """State block at interval ``dt`` (s) as a filter carries it, in coordinates that keep their digits: :meth:`block` where nothing is better."""
        return self.block(dt)

    # -- derived from the block ---------------------------------------------------------------------------------------------------

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
        return self.block(dt).allan_variance(counts(m))

    def wavelet_variance(self, scale: ArrayLike, dt: float) -> Array:
        """Haar wavelet variance at scales of 2^j samples: half the Allan variance at m = scale / 2."""
        return 0.5 * self.allan_variance(np.asarray(scale) // 2, dt)

    def psd(self, f: ArrayLike, dt: float) -> Array:
        """Two-sided PSD of the sampled sequence in unit^2/Hz at frequencies ``f`` (Hz), 0 < f <= 1 / (2 dt)."""
        return self.block(dt).psd(f)

    def autocovariance(self, lag: ArrayLike, dt: float) -> Array:
        """Autocovariance at ``lag`` samples, unit^2.

        Raises
        ------
        NotStationary
            The process has none.
        """
        if not self.stationary:
            raise NotStationary(f"{self.symbol} is not stationary and has no autocovariance")
        return self.block(dt).autocovariance(lag)

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:
        """Autocovariance of the differences of successive means of ``m`` samples; ``m`` = 1 are the increments of the samples.

        Parameters
        ----------
        m : int
            Samples per mean.
        dt : float
            Sampling interval, s.
        count : int
            Lags 0 ... ``count - 1``, in means.

        Returns
        -------
        (count,) array
            unit^2; zero for a process of one draw, which is no noise from mean to mean.
        """
        return np.zeros(count) if self.single_draw else self.block(dt).difference_covariance(m, count)

    def mean_variance(self, m: int, dt: float) -> float:
        """Variance of the mean of ``m`` samples, unit^2; of a wandering process from where it was as long before their middle.

        Parameters
        ----------
        m : int
            Samples.
        dt : float
            Sampling interval, s.

        Returns
        -------
        float
            Zero for a process of one draw.
        """
        if self.single_draw:
            return 0.0
        if not self.stationary:
            raise NotStationary(f"{self.symbol} is not stationary: the mean of a record has no variance")
        return self.block(dt).mean_variance(m)

    def wandering(self, m: int, dt: float) -> float:
        """Mean-square change over ``m`` samples, unit^2: of the process where it is stationary, else of its means over them."""
        if self.stationary and not self.single_draw:
            near, far = self.autocovariance(np.array([0, m]), dt)
            return float(2.0 * (near - far))
        first, second = self.difference_covariance(m, dt, 2)
        return float(max(first, first + 2.0 * second))

    def source(self, n: int, dt: float, rng: np.random.Generator) -> onward.Source:
        """What overwrites an array with the next samples of ``n`` in all, from a stationary start where there is one.

        Parameters
        ----------
        n, dt, rng
            As of :meth:`simulate`.
        """
        return onward.of_block(self.block(dt), n, rng)

    def simulate(self, n: int, dt: float, rng: np.random.Generator) -> Array:
        """``n`` samples at interval ``dt`` (s), from a stationary start where there is one.

        Parameters
        ----------
        n : int
            Samples.
        dt : float
            Sampling interval, s.
        rng : Generator
        """
        out = np.empty(n)
        self.source(n, dt, rng)(out)
        return out

    def correlation_time(self, dt: float) -> float | None:
        """The one time constant in s after which the process has forgotten; None where it has none, or several."""
        rates = [self.parameters[p.name] for p in self.parameters_meta() if p.domain == "rate"]
        return 1.0 / rates[0] if len(rates) == 1 else None

    def remembers(self, dt: float, time: float = 0.0) -> bool:
        """Whether it is noise that lasts longer than ``time`` s, and than a sampling interval ``dt`` in any case."""
        return not self.single_draw and (not self.stationary or self.block(dt).memory > max(time, dt))

    # -- for the estimators -------------------------------------------------------------------------------------------------------

    @property
    def order(self) -> int:
        """A whole number of the structure that :attr:`curve` needs."""
        return 0

    @classmethod
    @cache
    def _compiled_curve(cls) -> Any:
        return None if cls.curve is None else curves.compiled(cls.curve)

    def curve_address(self, dt: float) -> tuple[int, object]:
        """Address of the compiled wavelet variance of this structure with coefficient 1, and what must be kept while it is used."""
        known = self._compiled_curve()
        if known is not None:
            return known.address, known
        structure = self.with_parameters(dict.fromkeys(self.given))

        def derived(m: Array, shapes: Array) -> Array:
            return structure.of_coordinates(1.0, [float(v) for v in shapes], dt).wavelet_variance(2.0 * m, dt)

        return curves.callback_of(derived)

    def unit_wavelet_variance(self, m: ArrayLike, shapes: Sequence[float] = ()) -> Array:
        """Haar wavelet variance with coefficient 1 at averages of ``m`` samples, which need not be whole where there is a closed form."""
        averages, s = np.array(m, dtype=np.float64), np.array(shapes, dtype=np.float64)
        b, db = np.empty(averages.size), np.zeros((averages.size, s.size))
        address, _kept = self.curve_address(1.0)
        curves.evaluate(address, averages.ravel(), s, self.order, b, db)
        return b.reshape(averages.shape)

    def markov_parts(self, dt: float) -> MarkovParts | None:
        """The process as the sum that closed covariances of wavelet variances know; None where it is no such sum."""
        return None

    def moving(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
        """Which entries of the block's ``Phi`` and ``Q`` an expectation-maximization step may set freely; None where it cannot."""
        return None

    def of_transition(self, Phi: Array, Q: Array, dt: float) -> Self:
        """The process whose block has these matrices: the inverse of :meth:`block` where :meth:`moving` is not None.

        Parameters
        ----------
        Phi, Q : (k, k) arrays
            Transition and driving covariance per sample.
        dt : float
            Sampling interval, s.
        """
        raise NotImplementedError

    def per_sample(self, dt: float) -> dict[str, str]:
        """Parameters as the GMWM literature writes them per sample, as text; empty where they are written so already."""
        return {}

    def as_white_and_walk(self, dt: float) -> tuple[float, float]:
        """Squared densities of the white noise and of the random walk that the process is, or resembles over about a second."""
        time = self.correlation_time(dt)
        if time is None:
            return 0.0, 0.0
        if time <= 1.0:
            return float(self.psd(np.array([1e-9]), dt)[0]), 0.0
        block = self.block(dt)
        return 0.0, float(block.c @ block.Q @ block.c) / dt

    # -- sums ---------------------------------------------------------------------------------------------------------------------

    def __add__(self, other: Process | NoiseModel) -> NoiseModel:
        return NoiseModel((self,)) + other

    def __rmul__(self, count: int) -> NoiseModel:
        return count * NoiseModel((self,))


@dataclass(frozen=True)
class MarkovParts:
    """White, quantized, walking and flicker parts, and first-order processes, of the samples at one interval.

    Parameters
    ----------
    white, quantized, walk, flicker : float
        Variances per sample of the four, unit^2.
    decay, variance : tuple of float
        Decay per sample and variance of each first-order process.
    drift : float
        Slope per sample.
    line : tuple of float
        Frequency in Hz and amplitude of a sinusoid, or empty.
    """

    white: float = 0.0
    quantized: float = 0.0
    walk: float = 0.0
    flicker: float = 0.0
    decay: tuple[float, ...] = ()
    variance: tuple[float, ...] = ()
    drift: float = 0.0
    line: tuple[float, ...] = ()


def process_of(item: Mapping[str, Any], signal_unit: str) -> Process:
    """The process of one mapping with the key ``process``; raises ``InputError``."""
    given = dict(item)
    name = given.pop("process", None)
    name = grammar.ALIASES.get(name, name) if isinstance(name, str) else None
    common = common_keys(given)
    if name not in PROCESSES:
        found = shown(item.get("process"))
        raise InputError(f"unknown process {found}" + nearest(name or "", PROCESSES), where="process")
    return replace(PROCESSES[name].from_mapping(given, signal_unit), **common)


def register(process: type[Process]) -> type[Process]:
    """Make a process of one's own known by its name to text, YAML, fits and filters; also as a decorator.

    An installed package offers one by an entry point of the group ``insemu.processes``.

    Raises
    ------
    InputError
        No subclass of :class:`Process`, one that is not whole, or a name that another process has.
    """
    if not (isinstance(process, type) and issubclass(process, Process)):
        raise InputError(f"found {shown(process)}, expected a subclass of insemu.noise.Process")
    missing = sorted(getattr(process, "__abstractmethods__", ()))
    if missing or not process.PARAMETERS:
        raise InputError(f"the process {process.__name__} has no {', '.join(missing) or 'PARAMETERS'}")
    held = PROCESSES.setdefault(process.__name__, process)
    if (held.__module__, held.__qualname__) != (process.__module__, process.__qualname__):
        raise InputError(f"there is a process {process.__name__} already ({held.__module__})")
    PROCESSES[process.__name__] = process  # a notebook cell that is run again
    return process


@dataclass(frozen=True)
class NoiseModel:
    """A sum of independent processes.

    Parameters
    ----------
    processes : tuple of Process
        In the order given; repeated processes are distinguished by their index among their kind, from 1.

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
        if rates and max(rates) > min(rates) * (1.0 + SAME_RATE):
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
            raise InputError(f"found {shown(count)} times a noise model, expected a whole number of at least 1")
        if count * len(self.processes) > grammar.MOST_PROCESSES:
            raise InputError(
                f"found {shown(count)} times a noise model, expected at most {grammar.MOST_PROCESSES} processes"
            )
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

    def difference_covariance(self, m: int, dt: float, count: int) -> Array:
        """Autocovariance of the differences of successive means of ``m`` samples; see :meth:`Process.difference_covariance`.

        Parameters
        ----------
        m : int
            Samples per mean.
        dt : float
            Sampling interval, s.
        count : int
            Lags, in means.
        """
        return np.asarray(sum((p.difference_covariance(m, dt, count) for p in self), start=np.zeros(count)))

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

    def under(self, covariates: Mapping[str, float]) -> NoiseModel:
        """The model at some values of its covariates, which follows nothing."""
        return NoiseModel(tuple(p.under(covariates) for p in self))

    def simulate_components(
        self,
        n: int,
        dt: float,
        rng: np.random.Generator,
        out: Array | None = None,
        covariates: Mapping[str, Array] | None = None,
    ) -> Array:
        """Draw every process, into ``out`` (processes, n) where it is given.

        Each process draws from its own child of ``rng``, so that a process added at the end leaves the others as they were.

        Parameters
        ----------
        n : int
            Samples.
        dt : float
            Sampling interval, s.
        rng : Generator
        out : (processes, n) array, optional
            Overwritten.
        covariates : mapping of str to (n,) array, optional
            What levels follow, SI.

        Returns
        -------
        (processes, n) array
        """
        parts = np.empty((len(self), n)) if out is None else out
        for row, p, child in zip(parts, self, rng.spawn(len(self)), strict=True):
            follow.draw(p, row, dt, child, covariates)
        return parts

    def simulate(
        self,
        n: int,
        dt: float,
        rng: np.random.Generator,
        covariates: Mapping[str, Array] | None = None,
        each: Callable[[int, Array], None] = lambda place, part: None,
    ) -> Array:
        """Draw ``n`` samples of the sum; one process is held at a time.

        Parameters
        ----------
        n, dt, rng, covariates
            As of :meth:`simulate_components`.
        each : callable
            Given the place of every process and what it drew, (n,), before it is added; may change it.
        """
        total, part = np.zeros(n), np.empty(n)
        for place, (p, child) in enumerate(zip(self, rng.spawn(len(self)), strict=True)):
            follow.draw(p, part, dt, child, covariates)
            each(place, part)
            total += part
        return total

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
            A sum of ``[count*]NAME(arguments)``; arguments are ``name=quantity``, for AR, MA and ARMA the orders, ``shared=name`` for a process
            that several axes see (:mod:`insemu.noise.shared`), ``follows=temperature, slope=0.02, at=25`` for a level that follows a covariate,
            with ``what=time`` for correlation times that do (:mod:`insemu.noise.follow`).
        signal_unit : str
            SI unit of the signal (``rad/s``, ``m/s^2``), needed only where arguments carry units.

        Raises
        ------
        InputError
            Anything else, naming what was found.
        """
        processes: list[Process] = []
        for count, name, orders, given in grammar.terms(text, PROCESSES):
            common = common_keys(given)
            process = PROCESSES[name].of_arguments(orders, given, signal_unit, text)
            processes += [replace(process, **common)] * count
        return cls(tuple(processes))

    def to_list(self, signal_unit: str = "") -> list[dict[str, Any]]:
        """The model as plain data for YAML or JSON: one mapping per process, quantities with their SI unit as text."""
        return [p.to_mapping(signal_unit) | p.common_mapping() for p in self]

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
            raise InputError(f"found {shown(items)}, expected a list of processes such as [{{process: WN, N: 1e-3}}]")
        if len(items) > grammar.MOST_PROCESSES:
            raise InputError(f"found {len(items)} processes, expected at most {grammar.MOST_PROCESSES}")
        return cls(tuple(process_of(item, signal_unit) for item in items if isinstance(item, Mapping)))
