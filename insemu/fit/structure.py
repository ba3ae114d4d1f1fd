"""A noise model as the estimators see it: one non-negative coefficient per process, and unconstrained shapes.

Coefficients are variances of the samples (``N^2 / dt``, ``K^2 dt``, ``sigma^2``, ``Q^2 / dt^2``, ...); shapes are what
:meth:`insemu.noise.Process.coordinates` makes of the other parameters. What a process is, the process says; nothing here knows one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit import _kernel
from insemu.noise import SAME_RATE, NoiseModel
from insemu.variance import curve_address

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Structure:
    """A model at a sampling interval, compiled for the kernel.

    Parameters
    ----------
    model : NoiseModel
        Parameters without a value are free; given values are held.
    dt : float
        Sampling interval, s.
    curves, orders, offsets : int arrays
        Address of the compiled wavelet variance, whole number of its structure and place of the shapes of each process.
    fixed : (processes,) array
        Held coefficients, -1 where free.
    held : (shapes,) array
        Held shapes, NaN where free.
    made : (rate_hz, filter)
        What :meth:`of` was given; another process makes the structure anew, because addresses hold in one process only.
    """

    model: NoiseModel
    dt: float
    curves: Ints
    orders: Ints
    offsets: Ints
    fixed: Array
    held: Array
    kept: tuple[object, ...] = field(default=(), repr=False, compare=False)  # what the addresses belong to
    made: tuple[float, str] = (0.0, "haar")

    def __reduce__(self) -> tuple[Any, ...]:
        return Structure.of, (self.model, *self.made)

    @classmethod
    def of(cls, model: NoiseModel, rate_hz: float, filter: str = "haar") -> Structure:
        """Compile a model.

        Parameters
        ----------
        model : NoiseModel
            Structure.
        rate_hz : float
            Sampling rate.
        filter : str
            Wavelet filter of the curve that is to be fitted.

        Raises
        ------
        InputError
            An empty model, a random constant (it has no wavelet variance), discrete processes of another rate, an ARMA with only some
            coefficients given.
        """
        if len(model) == 0:
            raise InputError("the model has no process; expected something like 'GM() + WN()'")
        model = model.at_rate(rate_hz)
        dt = 1.0 / rate_hz
        found, orders, offsets, fixed, held = [], [], [0], [], []
        for p in model:
            p.refuse("gmwm")
            rate = p.carried_rate_hz
            if rate is not None and abs(rate / rate_hz - 1.0) > SAME_RATE:
                raise InputError(
                    f"{p.symbol} belongs to samples at {rate:g} Hz and cannot be fitted to a signal at {rate_hz:g} Hz"
                )
            found.append(p.curve_address(dt) if filter == "haar" else curve_address(p, filter, dt))
            orders.append(p.order)
            coefficient, shapes = p.coordinates(dt)
            fixed.append(-1.0 if coefficient is None else coefficient)
            held += [np.nan if v is None else v for v in shapes]
            offsets.append(len(held))
        return cls(
            model,
            dt,
            np.array([address for address, _ in found], dtype=np.int64),
            np.array(orders, dtype=np.int64),
            np.array(offsets, dtype=np.int64),
            np.array(fixed, dtype=np.float64),
            np.array(held, dtype=np.float64),
            tuple(kept for _, kept in found),
            (rate_hz, filter),
        )

    @property
    def free_parameters(self) -> int:
        """Number of parameters to estimate."""
        return int((self.fixed < 0).sum() + np.isnan(self.held).sum())

    def bounds(self, n_samples: int) -> tuple[Array, Array]:
        """Search limits of the shapes; equal where a shape is held."""
        limits = [limit for p in self.model for limit in p.shape_bounds(n_samples)]
        low, high = (np.array(side, dtype=np.float64) for side in (zip(*limits, strict=True) if limits else ((), ())))
        kept = ~np.isnan(self.held)
        low[kept] = high[kept] = self.held[kept]
        return low, high

    def starts(self, n_samples: int, most: int = 700) -> Array:
        """Shapes to begin from: every combination on coarse grids, or a reproducible sample of them where there are too many.

        Returns
        -------
        (starts, shapes) array
        """
        rng = np.random.default_rng(20140)  # the sample of starting points is part of the method, the same in every run
        group: list[tuple[list[int], list[tuple[tuple[float, ...], ...]]]] = []
        for members in self._alike():
            grid = self.model.processes[members[0]].shape_grid(n_samples, len(members), rng)
            group.append((members, list(combinations_with_replacement(grid, len(members)))))
        total = math.prod(len(g[1]) for g in group)
        if total <= most:
            combos = list(product(*(g[1] for g in group)))
        else:
            combos = [tuple(g[1][int(rng.integers(len(g[1])))] for g in group) for _ in range(most)]
        out = np.where(np.isnan(self.held), 0.0, self.held)[None, :].repeat(len(combos), axis=0)
        for i, combo in enumerate(combos):
            for (members, _), values in zip(group, combo, strict=True):
                for k, value in zip(members, values, strict=True):
                    out[i, self.offsets[k] : self.offsets[k + 1]] = value
        out = np.where(np.isnan(self.held), out, self.held)
        low, high = self.bounds(n_samples)
        return np.clip(out, low, high)

    def _alike(self) -> list[list[int]]:
        """Processes with free shapes, those of one kind and size together."""
        kinds: dict[tuple[str, int, int], list[int]] = {}
        for k, p in enumerate(self.model):
            shapes = self.held[self.offsets[k] : self.offsets[k + 1]]
            if np.isnan(shapes).any():
                kinds.setdefault((p.symbol, p.order, shapes.size), []).append(k)
        return list(kinds.values())

    def internal(self, model: NoiseModel) -> tuple[Array, Array]:
        """Coefficients and shapes of a specified model of this structure."""
        coefficients, shapes = [], []
        for p in model.at_rate(1.0 / self.dt):
            c, s = p.coordinates(self.dt)
            if c is None or any(v is None for v in s):
                raise InputError(f"the starting model {model} has parameters without a value")
            coefficients.append(c)
            shapes += [float(v) for v in s if v is not None]
        if len(coefficients) != self.curves.size or len(shapes) != self.held.size:
            raise InputError(f"the starting model {model} has another structure than {self.model}")
        return np.array(coefficients), np.array(shapes)

    def specified(self, coefficients: Array, shapes: Array) -> NoiseModel:
        """The model with these coefficients and shapes; repeated processes in the order of falling correlation time, as fitted."""
        out = []
        for k, p in enumerate(self.model):
            c = float(coefficients[k])
            s = shapes[self.offsets[k] : self.offsets[k + 1]]
            out.append(p.of_coordinates(c, [float(v) for v in s], self.dt))
        return NoiseModel(tuple(out))

    def columns(self, m: Array, shapes: Array) -> tuple[Array, Array]:
        """Wavelet variances of the unit processes (scales, processes) and their derivatives by the shapes (scales, shapes)."""
        B, dB = np.empty((m.size, self.curves.size)), np.zeros((m.size, shapes.size))
        _kernel.columns(self.curves, self.orders, self.offsets, m, shapes, B, dB)
        return B, dB

    def sort(self, coefficients: Array, shapes: Array) -> tuple[Array, Array]:
        """Order free processes of one kind among themselves: longest correlation time first."""
        coefficients, shapes = coefficients.copy(), shapes.copy()
        for members in self._alike():
            domain = [p.domain for p in self.model.processes[members[0]].shape_parameters]
            if domain not in (["rate"], ["time"], ["correlation"]):
                continue
            members = [k for k in members if self.fixed[k] < 0]
            sign = 1.0 if domain == ["rate"] else -1.0
            order = sorted(members, key=lambda k: sign * shapes[self.offsets[k]])
            c, s = [coefficients[k] for k in order], [shapes[self.offsets[k]] for k in order]
            for k, ck, sk in zip(members, c, s, strict=True):
                coefficients[k], shapes[self.offsets[k]] = ck, sk
        return coefficients, shapes


def natural_jacobian(model: NoiseModel, structure: Structure, m: Array) -> tuple[Array, list[tuple[int, str]]]:
    """Derivatives of the wavelet variance by the parameters as they are written (SI), equation (24) of Stebler et al. 2014.

    Parameters
    ----------
    model : NoiseModel
        A specified model of the structure.
    structure : Structure
    m : (J,) array
        Averages in samples (half the scales).

    Returns
    -------
    (J, p) array, list of (process number, parameter name)
        Only free parameters.
    """
    dt = structure.dt
    c, s = structure.internal(model)
    B, dB = structure.columns(m, s)
    columns, names = [], []
    for k, (asked, p) in enumerate(zip(structure.model, model, strict=True)):
        at = slice(structure.offsets[k], structure.offsets[k + 1])
        known = asked.given
        for name, (by_coefficient, by_shapes) in p.coordinate_slopes(dt).items():
            if known[name] is None:
                columns.append(by_coefficient * B[:, k] + c[k] * (dB[:, at] @ by_shapes))
                names.append((k, name))
    return (np.column_stack(columns) if columns else np.zeros((m.size, 0))), names
