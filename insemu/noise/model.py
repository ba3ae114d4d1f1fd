"""Sums of independent processes, as code, as text and as YAML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from insemu import units, yamlfile
from insemu.errors import InputError, nearest
from insemu.noise.block import StateBlock
from insemu.noise.processes import AR, AR1, ARMA, GM, MA, PROCESSES, NotStationary, Process

Array = NDArray[np.float64]


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
        rates = {p.rate_hz for p in self.processes if isinstance(p, AR1 | ARMA) and p.rate_hz is not None}
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
        for term in _split(text, "+"):
            match = _TERM.match(term)
            if match is None:
                raise InputError(
                    f"cannot read '{term.strip()}' in the model '{text}'; expected something like 2*GM() or WN(N=1e-3)"
                )
            name = match["name"]
            if name not in PROCESSES:
                raise InputError(f"unknown process '{name}' in the model '{text}'" + nearest(name, PROCESSES))
            count = int(match["count"] or 1)
            if count < 1:
                raise InputError(f"found {count} times {name} in the model '{text}', expected at least once")
            processes += [_process_of_arguments(name, match["arguments"] or "", signal_unit, text)] * count
        return cls(tuple(processes))

    def to_list(self, signal_unit: str = "") -> list[dict[str, Any]]:
        """The model as plain data for YAML or JSON: one mapping per process, quantities with their SI unit as text."""
        return [_to_mapping(p, signal_unit) for p in self]

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
        return cls(tuple(_of_mapping(item, signal_unit) for item in items if isinstance(item, Mapping)))


_TERM = re.compile(r"^\s*(?:(?P<count>\d+)\s*\*\s*)?(?P<name>[A-Za-z]\w*)\s*(?:\((?P<arguments>.*)\))?\s*$", re.DOTALL)


def _split(text: str, separator: str) -> list[str]:
    """Split at a separator outside brackets (and outside exponents such as 1e+3)."""
    parts, depth, start = [], 0, 0
    for i, ch in enumerate(text):
        depth += ch in "(["
        depth -= ch in ")]"
        if ch == separator and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [*parts, text[start:]]


def _process_of_arguments(name: str, arguments: str, signal_unit: str, text: str) -> Process:
    orders: list[int] = []
    given: dict[str, Any] = {}
    for argument in _split(arguments, ","):
        argument = argument.strip()
        if not argument:
            continue
        if "=" in argument:
            key, value = (part.strip() for part in argument.split("=", 1))
            given[key] = (
                [v.strip() for v in value.strip("([)] ").split(",") if v.strip()] if value[:1] in "([" else value
            )
        elif argument.isdigit():
            orders.append(int(argument))
        else:
            raise InputError(
                f"cannot read '{argument}' in '{name}({arguments})' of the model '{text}'; expected name=quantity"
            )
    for order in ("p", "q") if issubclass(PROCESSES[name], ARMA) else ():
        value = given.pop(order, None)
        if value is not None:
            if not str(value).isdigit():
                raise InputError(f"order {order} of {name} is '{value}', expected a whole number")
            orders.append(int(value))
    cls = PROCESSES[name]
    if issubclass(cls, ARMA) and not given:
        wanted = 2 if cls is ARMA else 1
        if len(orders) != wanted or min(orders) < 1:
            raise InputError(
                f"{name} in the model '{text}' needs {wanted} order(s), for example {name}({', '.join('2' * wanted)})"
            )
        return cls.of_order(0, orders[0]) if cls is MA else cls.of_order(*orders)
    if orders:
        raise InputError(
            f"found an unnamed argument in '{name}({arguments})' of the model '{text}'; expected name=quantity"
        )
    return _of_mapping({"process": name, **given}, signal_unit)


def _number(value: Any, unit: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"found {value!r}, expected a quantity in {unit}", where=where)
    try:
        return units.parse(value, unit)
    except InputError as error:
        raise InputError(error.message, where=where) from None


def _of_mapping(item: Mapping[str, Any], signal_unit: str) -> Process:
    given = dict(item)
    name = given.pop("process", None)
    if name not in PROCESSES:
        raise InputError(f"unknown process {name!r}" + nearest(str(name), PROCESSES), where="process")
    cls = PROCESSES[name]
    if issubclass(cls, ARMA):
        return _arma_of_mapping(cls, given, signal_unit)
    known = {p.name: p for p in cls.PARAMETERS}
    if cls is GM and "Tc" in given:
        if "beta" in given:
            raise InputError("found both beta and Tc, expected one of them", where="GM")
        time = _number(given.pop("Tc"), "s", "GM.Tc")
        if not time > 0:
            raise InputError(f"Tc (correlation time) is {time!r}, expected a positive number", where="GM")
        given["beta"] = 1.0 / time
    driving = given.pop("q", None) if cls is GM else None
    if driving is not None:
        if "sigma" in given or "beta" not in given:
            raise InputError("q (driving density) goes with beta or Tc and without sigma", where="GM")
        beta = _number(given["beta"], "1/s", "GM.beta")
        density = _number(driving, f"{signal_unit or '1'}*sqrt(Hz)", "GM.q")
        if density < 0 or not beta > 0:
            raise InputError(
                f"q (driving density) is {density!r} and beta {beta!r}, expected positive numbers", where="GM"
            )
        given["sigma"] = GM.of_driving_density(density, beta).parameters["sigma"]
    rate = given.pop("rate_hz", None) if cls is AR1 else None
    unknown = [k for k in given if k not in known]
    if unknown:
        raise InputError(f"unknown key '{unknown[0]}'" + nearest(unknown[0], known), where=name)
    values = {k: _number(v, known[k].unit_for(signal_unit), f"{name}.{k}") for k, v in given.items()}
    if rate is not None:
        values["rate_hz"] = _number(rate, "Hz", f"{name}.rate_hz")
    return cls(**values)


def _arma_of_mapping(cls: type[ARMA], given: dict[str, Any], signal_unit: str) -> Process:
    where = cls.__name__
    known = ("ar", "ma", "sigma2", "rate_hz", "order")
    unknown = [k for k in given if k not in known]
    if unknown:
        raise InputError(f"unknown key '{unknown[0]}'" + nearest(unknown[0], known), where=where)
    if "order" in given:
        order = given["order"] if isinstance(given["order"], list) else [given["order"]]
        if not all(isinstance(o, int) and not isinstance(o, bool) and o >= 1 for o in order):
            raise InputError(f"order is {given['order']!r}, expected whole numbers of at least 1", where=where)
        return cls.of_order(0, order[0]) if cls is MA else cls.of_order(*order)

    def coefficients(key: str) -> tuple[float, ...]:
        value = given.get(key, ())
        values = value if isinstance(value, list | tuple) else [value]
        return tuple(_number(v, "1", f"{where}.{key}") for v in values)

    square = "({u})^2".format(u=signal_unit or "1")
    sigma2 = _number(given["sigma2"], square, f"{where}.sigma2") if "sigma2" in given else None
    rate = _number(given["rate_hz"], "Hz", f"{where}.rate_hz") if given.get("rate_hz") is not None else None
    extra = {} if cls is AR else {"ma": coefficients("ma")}
    head = {} if cls is MA else {"ar": coefficients("ar")}
    return cls(**head, **extra, sigma2=sigma2, rate_hz=rate)


def _to_mapping(process: Process, signal_unit: str) -> dict[str, Any]:
    out: dict[str, Any] = {"process": process.symbol}
    if isinstance(process, ARMA):
        if not process.specified:
            orders = [len(v) for v in (process.ar, process.ma) if len(v)]
            return out | {"order": orders if len(orders) > 1 else orders[0]}
        for key in ("ar", "ma"):
            if getattr(process, key):
                out[key] = [float(v) for v in getattr(process, key)]
        out["sigma2"] = process.parameters["sigma2"]
        return out | ({"rate_hz": process.rate_hz} if process.rate_hz is not None else {})
    for p in process.PARAMETERS:
        value = getattr(process, p.name)
        if value is None or (p.optional and value == 0.0):
            continue
        unit = p.unit_for(signal_unit) if signal_unit else ""
        out[p.name] = f"{value!r} {unit}" if unit not in ("", "1") else value
    if isinstance(process, AR1) and process.rate_hz is not None:
        out["rate_hz"] = process.rate_hz
    return out


def save(models: Mapping[str, NoiseModel], path: str | Path, signal_units: Mapping[str, str] | None = None) -> None:
    """Write models per axis as YAML that :func:`load` and a scenario read.

    Parameters
    ----------
    models : mapping
        Axis (``gyro_x`` ... ``accel_z`` or a column's name) to model.
    path : path
        File to write.
    signal_units : mapping, optional
        SI unit per axis; where it is absent, rad/s is taken for ``gyro_*``, m/s^2 for ``accel_*`` and none for others.
    """
    units_of = {axis: (signal_units or {}).get(axis, axis_unit(axis)) for axis in models}
    document = {
        "insemu_noise_models": 1,
        "axes": {a: {"unit": units_of[a], "model": m.to_list(units_of[a])} for a, m in models.items()},
    }
    Path(path).write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True), encoding="utf-8")


def load(path: str | Path) -> dict[str, NoiseModel]:
    """Read what :func:`save` wrote.

    Raises
    ------
    InputError
        Not such a file, or a model that cannot be read; names the file and the axis.
    """
    document = yamlfile.read(path).data
    if not isinstance(document, dict) or not isinstance(document.get("axes"), dict):
        raise InputError("expected a noise-model file with the key 'axes'", where=str(path))
    out = {}
    for axis, entry in document["axes"].items():
        try:
            if not isinstance(entry, dict) or "model" not in entry:
                raise InputError("expected the keys 'unit' and 'model'")
            out[str(axis)] = NoiseModel.from_list(entry["model"], str(entry.get("unit", axis_unit(str(axis)))))
        except InputError as error:
            raise InputError(str(error), where=f"{path}: axes.{axis}") from None
    return out


def axis_unit(axis: str) -> str:
    """SI unit of an axis by its name: rad/s for gyroscopes, m/s^2 for accelerometers, none for others."""
    if axis.startswith("gyro") or axis in ("gx", "gy", "gz"):
        return "rad/s"
    if axis.startswith("accel") or axis in ("ax", "ay", "az"):
        return "m/s^2"
    return ""
