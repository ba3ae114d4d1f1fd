"""Maximum likelihood of the integrated signal (Nikolic et al. 2016): angles and velocities instead of rates and accelerations.

Weak slow parts are buried in white noise sample by sample, but rule the integral. So the parameters are found from the increments of the
integrated signal over intervals much longer than a sample, whose likelihood is that of a small Kalman filter (equations (12)-(19)).

The paper discretises a continuous model over every interval by a balanced matrix exponential. Here the state block of the samples is taken
to the power of the samples summed, by repeated squaring: exact for sums of samples, for every process that has a state block, with nothing
to balance (the continuous limit is what :func:`continuous_transition` gives, and a test holds the two together).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.fit.coordinates import Coordinates
from insemu.fit.gmwm import fit_curve
from insemu.fit.result import FitResult, estimates
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.statespace import Model, innovations
from insemu.variance import WaveletVariance, stream_wavelet_variance, wavelet_variance

Array = NDArray[np.float64]
Pattern = Literal["uniform", "log"]

#: Intervals of the uniform pattern: the standard deviation of a white-noise density is 1 / sqrt(2 n), here 0.2 %.
UNIFORM = 131072
#: Records longer than this many samples are gone through in pieces.
LARGE = 1 << 25
PIECE = 1 << 20
#: Points of the logarithmic pattern, as in Nikolic et al. 2016.
LOGARITHMIC = 1000


def sampling_pattern(n_samples: int, pattern: Pattern = "uniform", points: int | None = None) -> NDArray[np.int64]:
    """Sample counts at which the integral is looked at, ascending, the last at or near the record's end.

    Parameters
    ----------
    n_samples : int
    pattern : {"uniform", "log"}
    points : int, optional
        How many; 131072 or 1000 by default, never more than samples.

    Raises
    ------
    InputError
        An unknown pattern, fewer than three points.
    """
    if pattern not in get_args(Pattern):
        raise InputError(f"pattern is '{pattern}', expected one of: {', '.join(get_args(Pattern))}")
    wanted = points if points is not None else (UNIFORM if pattern == "uniform" else LOGARITHMIC)
    if wanted < 3:
        raise InputError(f"points is {wanted}, expected at least 3")
    if pattern == "uniform":
        step = max(1, math.ceil(n_samples / wanted))
        return np.arange(step, n_samples + 1, step, dtype=np.int64)
    return np.unique(np.round(np.geomspace(1.0, n_samples, min(wanted, n_samples))).astype(np.int64))


def integrate(values: Array, at: NDArray[np.int64], dt: float) -> Array:
    """Increments of the integral (equation (20)) between the pattern's points, the first from the record's start.

    Parameters
    ----------
    values : (n,) array
        Samples.
    at : (k,) array of int
        Sample counts of the pattern, ascending.
    dt : float
        Sampling interval, s.
    """
    starts = np.concatenate([[0], at[:-1]])
    origin = float(values[0])  # keeps digits where an offset such as gravity dominates; put back below
    out = np.empty(at.size)
    # a piece of the record at a time: no second copy of it
    piece = max(1, (1 << 22) // max(int(np.max(at - starts)), 1))
    for lo in range(0, at.size, piece):
        hi = min(lo + piece, at.size)
        x = values[starts[lo] : at[hi - 1]] - origin
        out[lo:hi] = np.add.reduceat(x, starts[lo:hi] - starts[lo])
    return np.asarray((out + origin * (at - starts)) * dt)


class _Problem:
    """What is seen at the points of a pattern, and the likelihood of a model for it: increments of the integral, or the samples themselves."""

    def __init__(self, seen: Array, at: NDArray[np.int64], dt: float, bias: bool, *, integrated: bool = True) -> None:
        self.y, self.dt, self.bias, self.integrated = seen, dt, bias, integrated
        spans = np.diff(np.concatenate([[0], at]))
        self.counts, which = np.unique(spans, return_inverse=True)
        self.which = np.ascontiguousarray(which.ravel(), dtype=np.int64)
        self.columns = np.column_stack([seen, spans * dt if integrated else np.ones(at.size)])

    def likelihood(self, model: NoiseModel) -> tuple[float, float]:
        """Log-likelihood, that with a flat prior where a constant is estimated along, and the constant (zero without one)."""
        block = model.block(self.dt)
        n, counts = block.n, self.counts
        if self.integrated:
            F, V = replace(block, c=self.dt * block.c).accumulated(counts.tolist())
            white = block.white * self.dt**2 * counts
        else:
            F, V = block.accumulated(counts.tolist())
            to = np.vstack([np.eye(n), block.c[None, :]])
            F, V, white = to @ F[:, :n, :n], to @ V[:, :n, :n] @ to.T, np.full(counts.size, block.white)
        seen, start = np.append(np.zeros(n), 1.0), np.array(block.P0)
        space = Model(np.ascontiguousarray(F[:, :, :n]), V, seen, white, np.zeros(n + 1), np.zeros(n), start)
        value, products = innovations(space, self.which, self.columns)
        if not self.bias:
            return value - 0.5 * products[0, 0], 0.0
        (yy, _), (yz, zz) = products
        return value - 0.5 * (yy - yz * yz / zz) - 0.5 * math.log(zz), yz / zz


def fit_mli(
    series: Series,
    model: NoiseModel,
    *,
    pattern: Pattern = "uniform",
    points: int | None = None,
    integrated: bool = True,
    bias: bool = True,
    start: NoiseModel | None = None,
    confidence: float = 0.95,
) -> FitResult:
    """Maximise the likelihood of the integrated signal.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        Any sum of processes with a state block; parameters with a value are held.
    pattern : {"uniform", "log"}
        Where the integral is looked at. Uniform intervals lose nothing that is slower than they are; the logarithmic pattern is the
        paper's, cheap, and several times less precise.
    points : int, optional
        Of the pattern.
    integrated : bool
        False takes single samples at the pattern's points, the classical likelihood, for comparison.
    bias : bool
        Estimate a constant along (turn-on bias).
    start : NoiseModel, optional
        Where to begin; by default the estimate by wavelet moments.
    confidence : float
        Of the intervals.

    Raises
    ------
    InputError
        A process without a state block; a signal that is too short.
    """
    model = _accepted(model).at_rate(series.rate_hz)
    n = len(series)
    if n < 16:
        raise InputError(f"{series.name} has {n} samples, expected at least 16")
    about = _About(series.name, series.unit, series.rate_hz, n, pattern, integrated)
    if n > LARGE and integrated and pattern == "uniform":
        # the same in one pass over pieces: neither the integral nor the curve's delay lines are as long as the record
        step = int(sampling_pattern(n, pattern, points)[0])
        pieces = (series.values[k : k + PIECE] for k in range(0, n, PIECE))
        increments, curve = _in_pieces(pieces, step, series.rate_hz)
        at = step * np.arange(1, increments.size + 1, dtype=np.int64)
        return _maximise(_Problem(increments, at, series.dt, bias), model, start, curve, about, bias, confidence)
    at = sampling_pattern(n, pattern, points)
    seen = integrate(series.values, at, series.dt) if integrated else series.values[at - 1]
    problem = _Problem(seen, at, series.dt, bias, integrated=integrated)
    return _maximise(problem, model, start, wavelet_variance(series.values, series.rate_hz), about, bias, confidence)


@dataclass(frozen=True)
class Stream:
    """A record that arrives in pieces and need not fit in memory.

    Parameters
    ----------
    pieces : iterable of (k,) arrays
        Successive parts of the signal, of any lengths.
    n_samples : int
        How many samples there are about; fixes the interval of the pattern.
    rate_hz : float
    unit, name : str
        Of the signal.
    """

    pieces: Iterable[ArrayLike]
    n_samples: int
    rate_hz: float
    unit: str = ""
    name: str = "signal"


def fit_mli_pieces(
    stream: Stream,
    model: NoiseModel,
    *,
    points: int = UNIFORM,
    bias: bool = True,
    start: NoiseModel | None = None,
    confidence: float = 0.95,
) -> FitResult:
    """The same for a record in pieces (uniform pattern).

    Parameters
    ----------
    stream : Stream
    model, points, bias, start, confidence
        As for :func:`fit_mli`.

    Raises
    ------
    InputError
        As :func:`fit_mli`; a value that is not finite.
    """
    rate = stream.rate_hz
    model = _accepted(model).at_rate(rate)
    if stream.n_samples < 16:
        raise InputError(f"{stream.name} has {stream.n_samples} samples, expected at least 16")
    step = int(sampling_pattern(stream.n_samples, "uniform", points)[0])
    increments, curve = _in_pieces(stream.pieces, step, rate)
    at = step * np.arange(1, increments.size + 1, dtype=np.int64)
    about = _About(stream.name, stream.unit, rate, curve.n_samples, "uniform", True)
    return _maximise(_Problem(increments, at, 1.0 / rate, bias), model, start, curve, about, bias, confidence)


@dataclass(frozen=True)
class _About:
    name: str
    unit: str
    rate_hz: float
    n_samples: int
    pattern: str
    integrated: bool


def _accepted(model: NoiseModel) -> NoiseModel:
    for p in model:
        p.refuse("mli")
    return model


def _in_pieces(pieces: Iterable[ArrayLike], step: int, rate_hz: float) -> tuple[Array, WaveletVariance]:
    """Increments over ``step`` samples, and the wavelet variance, in one pass."""
    sums: list[Array] = []
    rest = np.empty(0)
    origin: float | None = None

    def watched() -> Iterator[Array]:
        nonlocal rest, origin
        for piece in pieces:
            values = np.asarray(piece, dtype=np.float64)
            yield values
            if origin is None and values.size:
                origin = float(values[0])
            joined = np.concatenate([rest, values]) if rest.size else values
            whole = joined.size // step
            sums.append((joined[: whole * step] - (origin or 0.0)).reshape(whole, step).sum(axis=1))
            rest = joined[whole * step :].copy()

    curve = stream_wavelet_variance(watched(), rate_hz)
    increments = np.concatenate(sums) + (origin or 0.0) * step
    return increments / rate_hz, curve


def _maximise(
    problem: _Problem,
    model: NoiseModel,
    start: NoiseModel | None,
    curve: WaveletVariance,
    about: _About,
    bias: bool,
    confidence: float,
) -> FitResult:
    n, dt = about.n_samples, 1.0 / about.rate_hz
    if start is not None:
        begin = start.at_rate(about.rate_hz)
    else:
        begin = fit_curve(curve, model, weighting="asymptotic", name=about.name).model
    coordinates = Coordinates.of(model, begin, math.sqrt(curve.value[0]), dt)
    free = coordinates.free
    cost = _cost(problem, coordinates)
    move, converged = _lowest(cost, coordinates.start)
    fitted = coordinates.model(move)
    final, constant = problem.likelihood(fitted)
    covariance = _covariance(cost, move, coordinates)
    notes = _notes(fitted, free, covariance, n * dt, dt, converged)
    return FitResult(
        name=about.name,
        method="mli",
        structure=model,
        model=fitted,
        rate_hz=about.rate_hz,
        n_samples=n,
        unit=about.unit,
        parameters=estimates(fitted, free, covariance, about.unit, confidence),
        covariance=covariance,
        curve=curve,
        fitted=fitted.wavelet_variance(curve.scale_samples, dt),
        objective=-final,
        converged=converged,
        warnings=tuple(notes),
        details={
            "pattern": about.pattern,
            "points": problem.y.size,
            "integrated": about.integrated,
            "bias": constant if bias else 0.0,
            "start": begin,
            "free": free,
        },
    )


def _cost(problem: _Problem, coordinates: Coordinates) -> Callable[[Array], float]:
    """Minus the log-likelihood; where there is none, above everything seen so far, so that a search turns back."""
    worst = [math.inf]

    def cost(move: Array) -> float:
        try:
            value = -problem.likelihood(coordinates.model(move))[0]
        except InputError:
            value = math.inf
        if not math.isfinite(value):
            return worst[0] + 1e3 if math.isfinite(worst[0]) else 1e300
        worst[0] = value if not math.isfinite(worst[0]) else max(worst[0], value)
        return value

    return cost


def _lowest(cost: Callable[[Array], float], values: Array) -> tuple[Array, bool]:
    """Where the cost is lowest near a start, and whether the search ended by itself: quasi-Newton, polished without derivatives."""
    if not values.size:
        return values, True
    found = scipy.optimize.minimize(
        cost,
        values,
        method="L-BFGS-B",
        bounds=list(zip(values - 12.0, values + 12.0, strict=True)),
        options={"maxiter": 200, "ftol": 1e-11, "eps": 1e-5},
    )
    polished = scipy.optimize.minimize(
        cost, found.x, method="Nelder-Mead",
        options={"maxiter": 80 * values.size, "xatol": 1e-4, "fatol": 1e-5, "initial_simplex": _simplex(found.x)},
    )  # fmt: skip
    return (polished.x if polished.fun <= found.fun else found.x), bool(polished.success)


def _notes(
    fitted: NoiseModel, free: list[tuple[int, str]], covariance: Array, record: float, dt: float, converged: bool
) -> list[str]:
    notes = [] if converged else ["the search did not converge; treat the values as a start"]
    for k, (index, p) in enumerate(fitted.indexed()):
        time = p.correlation_time(dt)
        if time is not None and time > record / 2.0 and any((k, meta.name) in free for meta in p.shape_parameters):
            notes.append(
                f"{p.symbol}{index}: correlation time {time:.3g} s is longer than half of the record ({record:.3g} s) and "
                "cannot be distinguished from a random walk; use RW() instead"
            )
    for i, (k, name) in enumerate(free):
        if not math.isfinite(covariance[i, i]) or covariance[i, i] < 0:
            notes.append(f"{fitted.processes[k].symbol}.{name}: the likelihood does not determine it")
    return notes


def _simplex(x: Array) -> Array:
    return np.vstack([x, x + 0.05 * np.eye(x.size)])


def _covariance(cost: Callable[[Array], float], at: Array, coordinates: Coordinates) -> Array:
    """From the observed information, by differences in the search coordinates, carried to the parameters as written."""
    p = at.size
    out = np.full((p, p), np.nan)
    if p == 0:
        return out
    h = 0.03
    hessian = np.zeros((p, p))
    centre = cost(at)
    for i in range(p):
        e = np.zeros(p)
        e[i] = h
        hessian[i, i] = (cost(at + e) - 2.0 * centre + cost(at - e)) / h**2
        for j in range(i):
            f = np.zeros(p)
            f[j] = h
            mixed = (cost(at + e + f) - cost(at + e - f) - cost(at - e + f) + cost(at - e - f)) / (4.0 * h * h)
            hessian[i, j] = hessian[j, i] = mixed
    alive = np.flatnonzero(np.diag(hessian) > 1e-3)
    if alive.size == 0:
        return out
    sub = hessian[np.ix_(alive, alive)]
    values, vectors = np.linalg.eigh(sub)
    if values[0] <= 1e-9 * values[-1]:
        return out
    inverse = vectors / values @ vectors.T
    slope = coordinates.slopes(at)
    out[np.ix_(alive, alive)] = inverse * np.outer(slope[alive], slope[alive])
    return out
