"""Straight parts of a curve read as a model: N to white noise, B and Tc to a Gauss-Markov noise, K to random walk.

The graphical methods that others are compared with. Off the Allan variance every part is read for itself (Quinchia et al. 2013, section 4.4,
equations (27)-(30)), so that one which never dominates is not there. Off the PSD (the same, sections 4.3 and 5.4), the Hadamard and the total
variance (Stebler et al. 2011, section 4.1, figure 2) the laws of all processes of the model are fitted together, each octave weighed by its
scatter: no law needs a stretch of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.result import Estimate, FitResult, unit_of
from insemu.noise import DR, NoiseModel, Process
from insemu.records import Series
from insemu.variance import (
    FLICKER,
    Reading,
    Spectrum,
    allan_variance,
    average_frequencies,
    correlated_octaves,
    psd,
    read_curve,
    wavelet_variance,
)

Array = NDArray[np.float64]
Source = Literal["allan", "psd", "hadamard", "total"]

#: Standard error and interval of the parameters of a process.
Errors = dict[str, tuple[float, float, float]]
#: A process with its values, the errors of its parameters, and what is to be said of it.
Read = tuple[Process, Errors, str]

#: Processes that a curve tells from each other.
READABLE: dict[Source, tuple[str, ...]] = {
    "allan": ("WN", "QN", "RW", "DR", "BI", "GM"),
    "psd": ("WN", "QN", "RW", "BI", "GM"),
    "hadamard": ("WN", "QN", "RW", "DR", "BI", "GM"),
    "total": ("WN", "QN", "RW", "DR", "BI"),
}

#: Growth of chi-square without a law that is to count as visible: 2.5 standard deviations.
_VISIBLE = 6.25

#: Share by which the total variance of a noise is low, in averaging times over record (Riley, NIST SP 1065, 2008, table of total variance).
_TOTAL_BIAS = {"BI": 1.0 / (3.0 * math.log(2.0)), "RW": 0.75}


#: Bands of an averaged PSD per decade of frequency.
_PER_DECADE = 8


def fit_slopes(series: Series, model: NoiseModel, *, source: Source = "allan") -> FitResult:
    """Read the parameters of a model off the slopes.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        At most one each of the processes that :data:`READABLE` names for the source. Off the Allan variance a GM has ``sigma = 0.664 B`` and the
        correlation time of the flat part or hump, off the others its own law.
    source : {"allan", "psd", "hadamard", "total"}
        Where they are read: overlapping Allan variance, PSD averaged over frequencies, overlapping Hadamard variance (a ramp, which it does not see,
        by least squares), total variance.

    Returns
    -------
    FitResult
        A coefficient that is not visible is zero, with a warning.

    Raises
    ------
    InputError
        A process that the source does not show, or one that appears twice.
    """
    if source not in get_args(Source):
        raise InputError(f"source is '{source}', expected one of: {', '.join(get_args(Source))}")
    kinds = [p.symbol for p in model]
    for kind in kinds:
        if kind not in READABLE[source]:
            known = ", ".join(READABLE[source])
            raise InputError(
                f"{kind} cannot be read off the {source} curve; expected a sum of {known}, one each (or use gmwm)"
            )
        if kinds.count(kind) > 1:
            raise InputError(f"slopes cannot separate {kinds.count(kind)} {kind}; expected one of each (or use gmwm)")
    if any(_searched(p) and p.given[p.level.name] is not None for p in model):
        raise InputError("a correlation time alone is not read; expected GM() or GM(Tc=...)")
    if source == "allan":
        read = read_curve(allan_variance(series.values, series.rate_hz), series.unit)
        found = [(p, {}, "") if p.specified else _read_off(p, read, series) for p in model]
        return assembled(series, model, found, "slopes", {"source": source, "readings": read})
    return assembled(series, model, _fit_laws(series, model, source), f"{source}-slopes", {"source": source})


def assembled(
    series: Series, model: NoiseModel, found: list[Read], method: str, details: dict[str, object]
) -> FitResult:
    """The result of a method that gives every process its values, errors and remarks.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        As it was asked for.
    found : list of (process, errors, remark)
        In its order.
    method : str
    details : dict
    """
    fitted = NoiseModel(tuple(p for p, _, _ in found))
    notes = tuple(note for _, _, note in found if note)
    curve = wavelet_variance(series.values, series.rate_hz)
    parameters = []
    for k, (index, p) in enumerate(fitted.indexed()):
        for meta in p.parameters_meta():
            error, low, high = found[k][1].get(meta.name, (math.nan, math.nan, math.nan))
            unit = unit_of(meta, series.unit)
            free = model.processes[k].given[meta.name] is None
            parameters.append(
                Estimate(p.symbol, index, meta.name, p.parameters[meta.name], unit, error, low, high, free)
            )
    values = fitted.wavelet_variance(curve.scale_samples, series.dt)
    return FitResult(
        name=series.name,
        method=method,
        structure=model,
        model=fitted,
        rate_hz=series.rate_hz,
        n_samples=len(series),
        unit=series.unit,
        parameters=tuple(parameters),
        covariance=np.diag(np.array([e.standard_error**2 for e in parameters if e.free])),
        curve=curve,
        fitted=values,
        objective=float(np.sum((np.log(np.maximum(values, 1e-300)) - np.log(curve.value)) ** 2)),
        converged=not any("set to zero" in note for note in notes),
        warnings=notes,
        details=details,
    )


def _read_off(p: Process, read: Mapping[str, Reading], series: Series) -> tuple[Process, Errors, str]:
    """A process with the values that the slopes give, the errors of its parameters, and what is to be said of them."""
    name = p.level.name
    if p.symbol == "GM":
        return _hump(p, name, read, series)
    found = read.get(name)
    if found is None:
        zero = p.with_parameters({name: 0.0})
        return zero, {}, f"{p.symbol}: no part of the curve has its slope; its {name} is set to zero"
    note = f"{p.symbol}: {found.note}" if found.note else ""
    return p.with_parameters({name: found.si_value}), {name: _relative(found, found.si_value)}, note


def _hump(p: Process, name: str, read: Mapping[str, Reading], series: Series) -> Read:
    """A Gauss-Markov noise read off the flat part or hump of the curve; a correlation time that is given stays."""
    B, Tc, time = read.get("B"), read.get("Tc"), _searched(p)
    if B is None or (time and Tc is None):
        said = "GM: no flat part or hump is visible; its variance is set to zero"
        return _at(p, 0.0, 1.0 / series.dt / len(series)), {}, said
    level = FLICKER * B.si_value
    spread = {name: _relative(B, level)}
    if not time or Tc is None:
        return _at(p, level, math.nan), spread, ""
    beta = 1.0 / Tc.si_value
    if Tc.low > 0 and math.isfinite(Tc.high):
        low, high = beta * Tc.value / Tc.high, beta * Tc.value / Tc.low
        spread[time] = ((high - low) / 3.92, low, high)
    return _at(p, level, beta), spread, f"GM: its correlation time was read at the {Tc.note}" if Tc.note else ""


def _relative(reading: Reading, value: float) -> tuple[float, float, float]:
    """Standard error and interval of a reading carried to another unit."""
    low, high = value * reading.low / reading.value, value * reading.high / reading.value
    return (high - low) / 3.92, low, high


# -- laws fitted together ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Seen:
    """A curve: its values, degrees of freedom and correlation, and the expected curve of a process."""

    value: Array
    edof: Array
    correlation: Array
    expected: Callable[[Process], Array]
    #: Correlation times that it can tell, s.
    shortest: float
    longest: float


def _fit_laws(series: Series, model: NoiseModel, source: Source) -> list[Read]:
    """Weighted non-negative fit of the laws of all processes; a correlation time is searched."""
    ramp = math.nan
    if source == "hadamard" and any(p.ramp for p in model):
        t = (np.arange(len(series)) - 0.5 * (len(series) - 1)) * series.dt
        ramp = float(t @ series.values / (t @ t))
        series = replace(series, values=series.values - ramp * t)
    seen = _spectrum(series) if source == "psd" else _variances(series, source)
    laws = [p for p in model if not (p.ramp and source == "hadamard")]
    held = sum((seen.expected(p) for p in laws if p.specified), start=np.zeros_like(seen.value))
    free = [p for p in laws if not p.specified]
    found = _joint(seen, free, held) if free else []
    by_kind = dict(zip([p.symbol for p in free], found, strict=True))
    if math.isfinite(ramp):
        others = [by_kind.get(p.symbol, (p, {}, ""))[0] for p in laws]
        by_kind["DR"] = _ramp(ramp, others, len(series), series.dt)
    return [(p, {}, "") if p.specified else by_kind[p.symbol] for p in model]


def _joint(seen: _Seen, free: list[Process], held: Array) -> list[Read]:
    """The free processes with their values, weighed by the scatter of the fitted curve."""
    level = np.maximum(seen.value, 1e-300)
    where = next((k for k, p in enumerate(free) if _searched(p)), None)

    @cache
    def column(k: int, beta: float) -> Array:
        return seen.expected(_at(free[k], 1.0, beta))

    def basis(beta: float) -> Array:
        return np.column_stack([column(k, beta if k == where else 1.0) for k in range(len(free))])

    def whitened(columns: Array) -> Array:
        spread = level * np.sqrt(2.0 / seen.edof)
        root = np.linalg.cholesky(seen.correlation * np.outer(spread, spread))
        return np.asarray(np.linalg.solve(root, columns))

    def solved(beta: float, keep: list[int] | None = None) -> tuple[Array, float]:
        columns = basis(beta)
        size = columns.max(axis=0)
        white = whitened(np.column_stack([columns / size, seen.value - held]))
        used = white[:, :-1] if keep is None else white[:, keep]
        solution, rest = scipy.optimize.nnls(used, white[:, -1])
        if keep is None:
            return solution / size, float(rest**2)
        return solution / size[keep], float(rest**2)

    beta = 1.0
    coefficients = np.zeros(len(free))
    grid = np.geomspace(1.0 / seen.longest, 1.0 / seen.shortest, 49)
    for last in (*(False,) * 6, True):
        if where is not None and not last:
            beta = float(min(grid, key=lambda b: solved(b)[1]))
        elif where is not None:
            best = int(np.flatnonzero(grid == beta)[0])
            ends = np.log(grid[max(best - 1, 0)]), np.log(grid[min(best + 1, grid.size - 1)])
            beta = math.exp(
                scipy.optimize.minimize_scalar(lambda x: solved(math.exp(x))[1], bounds=ends, method="bounded").x
            )
        coefficients, _ = solved(beta)
        level = np.maximum(basis(beta) @ coefficients + held, 1e-3 * seen.value)
    _, distance = solved(beta)
    visible = [
        k
        for k in range(len(free))
        if coefficients[k] > 0
        and (len(free) == 1 or solved(beta, [i for i in range(len(free)) if i != k])[1] - distance > _VISIBLE)
    ]
    # relative derivatives by the logarithms of the visible coefficients and of the inverse correlation time
    columns = basis(beta) * coefficients
    slopes = [columns[:, k] for k in visible]
    if where in visible and where is not None:
        slopes.append((basis(beta * 1.01)[:, where] - basis(beta / 1.01)[:, where]) * coefficients[where] / 0.02)
    if not slopes:
        return [(_zero(p, seen), {}, f"{p.symbol} is not visible; its variance is set to zero") for p in free]
    white = whitened(np.column_stack(slopes))
    misfit = max(distance / max(seen.value.size - len(slopes), 1), 1.0)
    errors = np.sqrt(np.diag(np.linalg.pinv(white.T @ white)) * misfit)
    out: list[Read] = []
    for k, p in enumerate(free):
        if k not in visible:
            out.append((_zero(p, seen), {}, f"{p.symbol} is not visible; its variance is set to zero"))
            continue
        value = math.sqrt(coefficients[k])
        values, spread = {p.level.name: value}, {p.level.name: around(value, 0.5 * float(errors[visible.index(k)]))}
        if k == where:
            values[_searched(p)], spread[_searched(p)] = beta, around(beta, float(errors[-1]))
        out.append((p.with_parameters(values), spread, ""))
    return out


def around(value: float, relative: float) -> tuple[float, float, float]:
    """Standard error and 95 % interval, symmetric on a logarithmic scale, of a value with this relative standard error."""
    factor = math.exp(min(1.96 * relative, 300.0))
    return value * relative, value / factor, value * factor


def _searched(p: Process) -> str:
    """Name of the inverse correlation time that is to be found; empty where there is none."""
    return next((q.name for q in p.shape_parameters if q.domain == "rate" and p.given[q.name] is None), "")


def _at(p: Process, level: float, beta: float) -> Process:
    """The process at a level, and at an inverse correlation time where that is to be found."""
    return p.with_parameters({p.level.name: level, **({name: beta} if (name := _searched(p)) else {})})


def _zero(p: Process, seen: _Seen) -> Process:
    return _at(p, 0.0, 1.0 / seen.longest)


def _ramp(slope: float, others: list[Process], n: int, dt: float) -> Read:
    """A ramp found by least squares, with the error that white noise, random walk and what is white over the record leave it.

    The slope of white noise of density N^2 has the variance 12 N^2 / T^3, that of a random walk 6 K^2 / (5 T).
    """
    duration = n * dt
    density = sum(float(p.psd(np.array([1e-9 / dt]), dt)[0]) for p in others if p.stationary)
    walk = sum(p.parameters.get("K", 0.0) ** 2 for p in others)
    error = math.sqrt(12.0 * density / duration**3 + 1.2 * walk / duration)
    value = abs(slope)
    return DR(value), {"R": (error, max(value - 1.96 * error, 0.0), value + 1.96 * error)}, ""


def _variances(series: Series, source: Source) -> _Seen:
    """The overlapping Hadamard or the total variance in octaves."""
    curve = allan_variance(
        series.values, series.rate_hz, kind="overlapping-hadamard" if source == "hadamard" else "total"
    )
    use = curve.edof >= 2.0
    m, duration = curve.m[use], len(series) * series.dt

    def expected(p: Process) -> Array:
        if source == "total":
            if p.ramp:
                t = (np.arange(len(series)) - 0.5 * (len(series) - 1)) * series.dt
                return p.parameters["R"] ** 2 * allan_variance(t, series.rate_hz, kind="total", grid=m).value
            return p.allan_variance(m, series.dt) * (1.0 - _TOTAL_BIAS.get(p.symbol, 0.0) * m * series.dt / duration)
        # a third of variance less covariance of differences of successive means
        pairs = np.array([p.difference_covariance(int(k), series.dt, 2) for k in m])
        return np.asarray((pairs[:, 0] - pairs[:, 1]) / 3.0)

    correlation = correlated_octaves(m, curve.value[use], len(series))
    return _Seen(curve.value[use], curve.edof[use], correlation, expected, series.dt, float(m[-1]) * series.dt)


def _spectrum(series: Series) -> _Seen:
    """The density of the whole record under one Hann window, averaged over bands of an eighth of a decade."""
    if len(series) < 64:
        raise InputError(f"{series.name} has {len(series)} samples, too few for a spectrum; expected at least 64")
    whole = psd(series.values, series.rate_hz, segment=len(series))
    # the first frequencies leak, the last fold
    use = (whole.f_hz > 4.0 * whole.f_hz[0]) & (whole.f_hz < 0.35 * series.rate_hz)

    def part(which: NDArray[np.intp]) -> Spectrum:
        arrays = {name: getattr(whole, name)[which] for name in ("f_hz", "psd", "low", "high", "edof")}
        return replace(whole, **arrays)

    averaged = average_frequencies(part(np.flatnonzero(use)), per_decade=_PER_DECADE)
    # a law is smooth: 64 frequencies of a band are enough
    edges = np.searchsorted(_PER_DECADE * np.log10(whole.f_hz[use]), np.arange(-80, 81))
    inside = [np.linspace(a, b - 1, min(b - a, 64)) for a, b in pairwise(edges) if b > a]
    thin = part(np.flatnonzero(use)[np.concatenate(inside).astype(np.intp)])

    def expected(p: Process) -> Array:
        law = replace(thin, psd=p.psd(thin.f_hz, series.dt))
        return average_frequencies(law, per_decade=_PER_DECADE).psd

    size = averaged.psd.size
    longest = len(series) * series.dt / (2.0 * math.pi)
    return _Seen(averaged.psd, averaged.edof, np.eye(size), expected, 1.0 / thin.f_hz[-1], longest)
