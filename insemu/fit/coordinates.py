"""Coordinates in which parameters are searched without bounds: logarithms of positive ones, Fisher's transform of correlations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise import NoiseModel

Array = NDArray[np.float64]

#: A level that starts at zero could not move; it starts from this share of the signal's short-time deviation, as one of samples, ...
TRACE = 1e-2
#: ... and a process that wanders from this one.
TRACE_OF_WALK = 1e-4


@dataclass(frozen=True)
class Coordinates:
    """Free parameters of a model.

    Parameters
    ----------
    begin : NoiseModel
        Specified model; its held values stay.
    free : list of (process number, parameter name)
    kinds : tuple of str
        ``log``, ``atanh`` or ``plain``.
    start : (p,) array
        Coordinates of ``begin``.
    """

    begin: NoiseModel
    free: list[tuple[int, str]]
    kinds: tuple[str, ...]
    start: Array

    @classmethod
    def of(cls, model: NoiseModel, begin: NoiseModel, deviation: float, dt: float) -> Coordinates:
        """Coordinates of the parameters of ``model`` that have no value, starting at those of ``begin``.

        Parameters
        ----------
        model, begin : NoiseModel
            Structure and specified model.
        deviation : float
            Short-time deviation of the signal, the scale of traces.
        dt : float
            Sampling interval, s.

        Raises
        ------
        InputError
            ``begin`` has another structure or is not specified.
        """
        if [p.symbol for p in begin] != [p.symbol for p in model] or not begin.specified:
            raise InputError(
                f"the starting model {begin} has another structure than {model} (or parameters without a value)"
            )
        free: list[tuple[int, str]] = []
        kinds: list[str] = []
        values: list[float] = []
        for k, (asked, p) in enumerate(zip(model, begin, strict=True)):
            for meta in p.parameters_meta():
                if asked.given[meta.name] is not None:
                    continue
                value = p.parameters[meta.name]
                free.append((k, meta.name))
                if meta.positive:
                    share = TRACE if p.stationary else TRACE_OF_WALK
                    trace = (share * max(deviation, 1e-150)) ** 2 * dt**meta.sample_power
                    values.append(math.log(value if value > 0 else trace ** (0.5 * max(meta.power, 1))))
                    kinds.append("log")
                elif meta.domain == "correlation":
                    values.append(math.atanh(min(max(value, -1 + 1e-12), 1 - 1e-12)))
                    kinds.append("atanh")
                else:
                    values.append(value)
                    kinds.append("plain")
        return cls(begin, free, tuple(kinds), np.array(values, dtype=np.float64))

    def model(self, at: Array) -> NoiseModel:
        """The model at a point."""
        parts = list(self.begin.processes)
        changes: dict[int, dict[str, float]] = {}
        for (k, name), v, kind in zip(self.free, at, self.kinds, strict=True):
            value = math.exp(min(v, 300.0)) if kind == "log" else (math.tanh(v) if kind == "atanh" else float(v))
            changes.setdefault(k, {})[name] = value
        for k, change in changes.items():
            parts[k] = parts[k].with_parameters(change)
        return NoiseModel(tuple(parts))

    def bounds(self, n: int, dt: float) -> tuple[Array, Array]:
        """Least and largest coordinates: rates and times as a search of one axis has them, factors of e^20 for the others.

        Parameters
        ----------
        n : int
            Samples of the record.
        dt : float
            Sampling interval, s.
        """
        low, high = self.start - 20.0, self.start + 20.0
        for at, (k, name) in enumerate(self.free):
            meta = next(p for p in self.begin.processes[k].parameters_meta() if p.name == name)
            if meta.domain in ("rate", "time"):
                to_si = -math.log(dt) if meta.domain == "rate" else math.log(dt)
                low[at], high[at] = (v + to_si for v in meta.bounds(n))
        return low, high

    def slopes(self, at: Array) -> Array:
        """Derivative of each parameter by its coordinate."""
        out = np.ones(at.size)
        for i, (v, kind) in enumerate(zip(at, self.kinds, strict=True)):
            if kind == "log":
                out[i] = math.exp(min(v, 300.0))
            elif kind == "atanh":
                out[i] = 1.0 - math.tanh(v) ** 2
        return out
