"""A noise model as the estimators see it: one non-negative coefficient per process, and unconstrained shapes.

Coefficients are variances of the samples (``N^2 / dt``, ``K^2 dt``, ``sigma^2``, ``Q^2 / dt^2``, ...); shapes are log(dt / Tc) of a GM, the
inverse hyperbolic tangent of an AR1's coefficient, those of the partial autocorrelations of an ARMA, the logit of 2 f dt of a sinusoid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit import _kernel
from insemu.noise import AR1, ARMA, BI, DR, GM, QN, RC, RW, SIN, WN, NoiseModel, Process

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_KINDS: dict[type[Process], int] = {
    WN: _kernel.WN,
    QN: _kernel.QN,
    RW: _kernel.RW,
    DR: _kernel.DR,
    BI: _kernel.BI,
    GM: _kernel.GM,
    AR1: _kernel.AR1,
    SIN: _kernel.SIN,
}
_AMPLITUDE = {WN: "N", QN: "Q", RW: "K", DR: "R", BI: "B", GM: "sigma", SIN: "alpha"}

#: Correlation times are searched up to this many record lengths: beyond, a GM cannot be told from a random walk.
LONGEST_RECORDS = 20.0


def _partial_autocorrelations(coefficients: Array) -> Array:
    """Inverse of the kernel's Durbin-Levinson recursion."""
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
    return out


@dataclass(frozen=True)
class Structure:
    """A model at a sampling interval, compiled for the kernel.

    Parameters
    ----------
    model : NoiseModel
        Parameters without a value are free; given values are held.
    dt : float
        Sampling interval, s.
    kinds, orders, offsets : int arrays
        Kernel kind, autoregressive order and place of the shapes of each process.
    fixed : (processes,) array
        Held coefficients, -1 where free.
    held : (shapes,) array
        Held shapes, NaN where free.
    """

    model: NoiseModel
    dt: float
    kinds: Ints
    orders: Ints
    offsets: Ints
    fixed: Array
    held: Array

    @classmethod
    def of(cls, model: NoiseModel, rate_hz: float) -> Structure:
        """Compile a model.

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
        kinds, orders, offsets, fixed, held = [], [], [0], [], []
        for p in model:
            if isinstance(p, RC):
                raise InputError(
                    "RC (random constant) leaves no trace in one record's wavelet variance and cannot be fitted; leave it out"
                )
            rate = p.rate_hz if isinstance(p, AR1 | ARMA) else None
            if rate is not None and abs(rate / rate_hz - 1.0) > 1e-9:
                raise InputError(
                    f"{p.symbol} belongs to samples at {rate:g} Hz and cannot be fitted to a signal at {rate_hz:g} Hz"
                )
            order = len(p.ar) if isinstance(p, ARMA) else 0
            kinds.append(_kernel.ARMA if isinstance(p, ARMA) else _KINDS[type(p)])
            orders.append(order)
            coefficient, shapes = _internal(p, dt)
            fixed.append(-1.0 if coefficient is None else coefficient)
            held += [np.nan if v is None else v for v in shapes]
            offsets.append(len(held))
        return cls(
            model,
            dt,
            np.array(kinds, dtype=np.int64),
            np.array(orders, dtype=np.int64),
            np.array(offsets, dtype=np.int64),
            np.array(fixed, dtype=np.float64),
            np.array(held, dtype=np.float64),
        )

    @property
    def free_parameters(self) -> int:
        """Number of parameters to estimate."""
        return int((self.fixed < 0).sum() + np.isnan(self.held).sum())

    def bounds(self, n_samples: int) -> tuple[Array, Array]:
        """Search limits of the shapes; equal where a shape is held."""
        low, high = np.empty(self.held.size), np.empty(self.held.size)
        longest = LONGEST_RECORDS * n_samples
        for k, kind in enumerate(self.kinds):
            at = slice(self.offsets[k], self.offsets[k + 1])
            if kind == _kernel.GM:
                low[at], high[at] = -math.log(longest), math.log(6.0)
            elif kind == _kernel.AR1:
                low[at], high[at] = -4.0, 0.5 * math.log(2.0 * longest)
            elif kind == _kernel.SIN:
                low[at], high[at] = -math.log(2.0 * n_samples), 9.0
            else:
                low[at], high[at] = -6.0, 6.0
        kept = ~np.isnan(self.held)
        low[kept] = high[kept] = self.held[kept]
        return low, high

    def starts(self, n_samples: int, most: int = 700) -> Array:
        """Shapes to begin from: every combination on coarse grids, or a reproducible sample of them where there are too many.

        Returns
        -------
        (starts, shapes) array
        """
        first_order = [
            k for k, kind in enumerate(self.kinds) if kind == _kernel.GM and np.isnan(self.held[self.offsets[k]])
        ]
        group: list[tuple[list[int], list[tuple[float, ...]]]] = []
        if first_order:
            count = len(first_order)
            size = {1: 30, 2: 18, 3: 14, 4: 11}.get(count, 9)
            # time constants from below a sample to beyond the record; a few random-walk-like ones
            grid = -np.log(np.geomspace(0.6, 3.0 * n_samples, size))
            group.append((first_order, list(combinations_with_replacement([float(g) for g in grid], count))))
        ones = [k for k, kind in enumerate(self.kinds) if kind == _kernel.AR1 and np.isnan(self.held[self.offsets[k]])]
        if ones:
            count = len(ones)
            size = {1: 30, 2: 16, 3: 12}.get(count, 9)
            a = 1.0 / np.geomspace(0.6, 3.0 * n_samples, size)
            positive = np.arctanh(np.minimum(np.exp(-a), 1.0 - 1e-12))
            grid = np.concatenate([[-1.8, -0.8, -0.25], positive])
            group.append((ones, list(combinations_with_replacement([float(g) for g in grid], count))))
        rng = np.random.default_rng(20140)  # the sample of starting points is part of the method, the same in every run
        for k, kind in enumerate(self.kinds):
            if kind == _kernel.SIN and np.isnan(self.held[self.offsets[k]]):
                x = np.geomspace(4.0 / n_samples, 0.98, 60)
                group.append(([k], [(float(v),) for v in np.log(x / (1.0 - x))]))
            elif kind == _kernel.ARMA and np.isnan(self.held[self.offsets[k]]):
                size = int(self.offsets[k + 1] - self.offsets[k])
                draws = [(0.0,) * size] + [tuple(float(v) for v in rng.normal(0.0, 1.0, size)) for _ in range(59)]
                group.append(([k], draws))
        total = math.prod(len(g[1]) for g in group)
        if total <= most:
            combos = list(product(*(g[1] for g in group)))
        else:
            combos = [tuple(g[1][int(rng.integers(len(g[1])))] for g in group) for _ in range(most)]
        out = np.where(np.isnan(self.held), 0.0, self.held)[None, :].repeat(len(combos), axis=0)
        for i, combo in enumerate(combos):
            for (members, _), values in zip(group, combo, strict=True):
                if len(members) == 1:
                    k = members[0]
                    out[i, self.offsets[k] : self.offsets[k + 1]] = values
                else:
                    for k, value in zip(members, values, strict=True):
                        out[i, self.offsets[k]] = value
        low, high = self.bounds(n_samples)
        return np.clip(out, low, high)

    def internal(self, model: NoiseModel) -> tuple[Array, Array]:
        """Coefficients and shapes of a specified model of this structure."""
        coefficients, shapes = [], []
        for p in model.at_rate(1.0 / self.dt):
            c, s = _internal(p, self.dt)
            if c is None or any(v is None for v in s):
                raise InputError(f"the starting model {model} has parameters without a value")
            coefficients.append(c)
            shapes += [float(v) for v in s if v is not None]
        if len(coefficients) != self.kinds.size or len(shapes) != self.held.size:
            raise InputError(f"the starting model {model} has another structure than {self.model}")
        return np.array(coefficients), np.array(shapes)

    def specified(self, coefficients: Array, shapes: Array) -> NoiseModel:
        """The model with these coefficients and shapes; repeated processes in the order of falling correlation time, as fitted."""
        out = []
        for k, p in enumerate(self.model):
            c = float(coefficients[k])
            s = shapes[self.offsets[k] : self.offsets[k + 1]]
            out.append(_external(p, c, s, self.dt))
        return NoiseModel(tuple(out))

    def columns(self, m: Array, shapes: Array) -> tuple[Array, Array]:
        """Wavelet variances of the unit processes (scales, processes) and their derivatives by the shapes (scales, shapes)."""
        B, dB = np.empty((m.size, self.kinds.size)), np.zeros((m.size, shapes.size))
        _kernel.columns(self.kinds, self.orders, self.offsets, m, shapes, B, dB)
        return B, dB

    def sort(self, coefficients: Array, shapes: Array) -> tuple[Array, Array]:
        """Order free processes of one kind among themselves: longest correlation time first."""
        coefficients, shapes = coefficients.copy(), shapes.copy()
        for kind, sign in ((_kernel.GM, 1.0), (_kernel.AR1, -1.0)):
            members = [
                k
                for k in np.flatnonzero(self.kinds == kind)
                if self.fixed[k] < 0 and np.isnan(self.held[self.offsets[k]])
            ]
            order = sorted(members, key=lambda k: sign * shapes[self.offsets[k]])
            c, s = [coefficients[k] for k in order], [shapes[self.offsets[k]] for k in order]
            for k, ck, sk in zip(members, c, s, strict=True):
                coefficients[k], shapes[self.offsets[k]] = ck, sk
        return coefficients, shapes


def _internal(p: Process, dt: float) -> tuple[float | None, tuple[float | None, ...]]:
    """Coefficient and shapes of a process, None where free."""
    if isinstance(p, ARMA):
        given = [v is not None for v in (*p.ar, *p.ma)]
        if any(given) and not all(given):
            raise InputError(f"{p.symbol}: only some coefficients have values; give all (they are held) or none")
        if not all(given):
            return p.sigma2, (None,) * len(given)
        ar = np.array([v for v in p.ar if v is not None])
        ma = np.array([v for v in p.ma if v is not None])
        return p.sigma2, (*map(float, _partial_autocorrelations(ar)), *map(float, _partial_autocorrelations(-ma)))
    if isinstance(p, AR1):
        if p.phi is None:
            if p.sigma2 is not None:
                raise InputError("AR1: sigma2 is held but phi is free; hold both or none")
            return None, (None,)
        shape = math.atanh(p.phi)
        return (None if p.sigma2 is None else p.sigma2 / (1.0 - p.phi**2)), (shape,)
    name = _AMPLITUDE[type(p)]
    value = getattr(p, name)
    factor = {WN: dt**-0.5, QN: 1.0 / dt, RW: dt**0.5, DR: dt}.get(type(p), 1.0)
    coefficient = None if value is None else (value * factor) ** 2
    if isinstance(p, GM):
        return coefficient, (None if p.beta is None else math.log(p.beta * dt),)
    if isinstance(p, SIN):
        if p.f is None:
            return coefficient, (None,)
        x = 2.0 * p.f * dt
        if not 0.0 < x < 1.0:
            raise InputError(f"SIN: f is {p.f} Hz, expected less than half the sampling rate ({0.5 / dt:g} Hz)")
        return coefficient, (math.log(x / (1.0 - x)),)
    return coefficient, ()


def _external(p: Process, c: float, s: Array, dt: float) -> Process:
    if isinstance(p, ARMA):
        order = len(p.ar)
        if all(v is not None for v in (*p.ar, *p.ma)):
            return p.with_parameters({"sigma2": c})
        ar, ma = _kernel.coefficients_of(s[:order]), -_kernel.coefficients_of(s[order:])
        values = {f"ar_{i + 1}": float(v) for i, v in enumerate(ar)} | {
            f"ma_{i + 1}": float(v) for i, v in enumerate(ma)
        }
        return p.with_parameters(values | {"sigma2": c})
    if isinstance(p, AR1):
        z = float(s[0])
        phi = min(math.tanh(z), 1.0 - 1e-15)
        inverse = 4.0 * math.exp(-2.0 * abs(z)) / (1.0 + math.exp(-2.0 * abs(z))) ** 2  # 1 - tanh^2
        values = {"phi": phi if p.phi is None else p.phi, "sigma2": c * inverse if p.sigma2 is None else p.sigma2}
        return p.with_parameters(values)
    name = _AMPLITUDE[type(p)]
    factor = {WN: dt**0.5, QN: dt, RW: dt**-0.5, DR: 1.0 / dt}.get(type(p), 1.0)
    held = getattr(p, name)
    values = {name: math.sqrt(c) * factor if held is None else held}
    if isinstance(p, GM) and p.beta is None:
        values["beta"] = math.exp(float(s[0])) / dt
    if isinstance(p, SIN) and p.f is None:
        values["f"] = 0.5 / (1.0 + math.exp(-float(s[0]))) / dt
    return p.with_parameters(values)


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
        lo = int(structure.offsets[k])
        free = [meta.name for meta in p.parameters_meta() if _is_free(asked, meta.name)]
        values = p.parameters
        if isinstance(p, ARMA):
            for name in free:
                if name == "sigma2":
                    columns.append(B[:, k])
                else:
                    h = 1e-6 * max(1.0 - abs(values[name]), 1e-3)
                    up = p.with_parameters({name: values[name] + h}).wavelet_variance(2 * m, dt)
                    down = p.with_parameters({name: values[name] - h}).wavelet_variance(2 * m, dt)
                    columns.append((up - down) / (2.0 * h))
                names.append((k, name))
            continue
        for name in free:
            if isinstance(p, AR1):
                inverse = 4.0 * math.exp(-2.0 * abs(s[lo])) / (1.0 + math.exp(-2.0 * abs(s[lo]))) ** 2
                if name == "sigma2":
                    columns.append(B[:, k] / inverse)
                else:
                    # by phi at a held innovation variance
                    columns.append((c[k] * dB[:, lo] + 2.0 * values["phi"] * c[k] * B[:, k]) / inverse)
            elif name == "beta":
                columns.append(c[k] * dB[:, lo] / values["beta"])
            elif name == "f":
                columns.append(c[k] * dB[:, lo] / (values["f"] * (1.0 - 2.0 * values["f"] * dt)))
            else:
                amplitude = abs(values[name])
                columns.append(2.0 * c[k] * B[:, k] / amplitude if amplitude > 0 else np.zeros(m.size))
            names.append((k, name))
    return (np.column_stack(columns) if columns else np.zeros((m.size, 0))), names


def _is_free(asked: Process, name: str) -> bool:
    if isinstance(asked, ARMA):
        flat = dict(zip([f"ar_{i + 1}" for i in range(len(asked.ar))], asked.ar, strict=True))
        flat |= dict(zip([f"ma_{i + 1}" for i in range(len(asked.ma))], asked.ma, strict=True))
        flat["sigma2"] = asked.sigma2
        return flat[name] is None
    return getattr(asked, name) is None
