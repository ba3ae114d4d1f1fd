"""Constrained expectation-maximization: state-space parameters of which some entries are fixed and some are free (Stebler et al. 2011).

``x_(t+1) = Phi x_t + u + w_t``, ``y_t = H x_t + v_t``. A matrix with fixed and free entries is ``vec(M) = f + D m`` (equation (9)); the
maximization has a closed form for each. A ramp is better removed by least squares beforehand: estimated inside, it fights with Phi and Q.

The algorithm climbs slowly and stays on the hill it starts on. So the stopping rule is shown with the trace of the likelihood, and the
likelihood is compared with that of an independent estimate (by wavelet moments): where that one is higher, the result is reported as not
converged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.fit.gmwm import fit_curve
from insemu.fit.result import Estimate, FitResult, estimates
from insemu.noise import PROCESSES, NoiseModel, Process, StateBlock
from insemu.records import Series
from insemu.statespace import log_likelihood, smooth
from insemu.variance import WaveletVariance, wavelet_variance

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ramp = Literal["least_squares", "em", "none"]


@dataclass(frozen=True)
class StateSpace:
    """Matrices with fixed and free entries (free where the mask is True).

    Parameters
    ----------
    Phi, Q : (n, n) arrays
    H, u : (n,) arrays
    R : float
    mean, covariance : (n,), (n, n) arrays
        Of the state before the first sample; the covariance stays fixed, its joint estimation with the mean makes the algorithm fail.
    free_Phi, free_Q : (n, n) bool arrays
        Q's mask is symmetric.
    free_H, free_u, free_mean : (n,) bool arrays
    free_R : bool
    """

    Phi: Array
    Q: Array
    H: Array
    u: Array
    R: float
    mean: Array
    covariance: Array
    free_Phi: Bools
    free_Q: Bools
    free_H: Bools
    free_u: Bools
    free_R: bool
    free_mean: Bools

    def block(self) -> StateBlock:
        """As a state block at unit interval."""
        names = tuple(f"x{i + 1}" for i in range(self.u.size))
        return StateBlock(names, self.Phi, self.Q, self.H, self.covariance, self.R, 1.0)


@dataclass(frozen=True)
class Expectation:
    """Where the algorithm ended: the matrices, the log-likelihood of every iteration, whether the stopping rule was met."""

    space: StateSpace
    trace: Array
    stopped: bool


def maximise(space: StateSpace, y: Array) -> tuple[StateSpace, float]:
    """One iteration: smoothing with the matrices as they are, then the update of every free entry.

    Returns
    -------
    StateSpace, float
        Updated matrices, and the log-likelihood of the matrices given (not of the updated ones).
    """
    got = smooth(space.block(), y, u=space.u, x0=space.mean)
    x = got.mean
    later, earlier = x[1:], x[:-1]
    # sums over t = 2..N of second moments (the tilde quantities of the paper)
    S11 = got.sum_now + later.T @ later
    S10 = got.sum_cross + later.T @ earlier
    S00 = got.sum_before + earlier.T @ earlier
    s1, s0 = later.sum(axis=0), earlier.sum(axis=0)
    count = y.size - 1
    n = space.u.size
    Phi, Q, u, H, R, mean = space.Phi, space.Q, space.u, space.H, space.R, space.mean
    weight = np.linalg.pinv(Q, rcond=1e-14, hermitian=True)
    # a state without noise of its own gives no weight; a fixed small one keeps its free entries solvable
    quiet = np.diag(Q) <= 0
    weight[quiet, quiet] = 1.0 / max(float(np.abs(Q).max()), 1e-300)
    if space.free_Phi.any():
        # vec() stacks columns: entry (i, j) is at j n + i
        free = np.flatnonzero(space.free_Phi.T.ravel())
        fixed = np.where(space.free_Phi, 0.0, Phi)
        A = np.kron(S00, weight)
        rhs = (weight @ (S10 - np.outer(u, s0))).T.ravel() - A @ fixed.T.ravel()
        solution = fixed.T.ravel().copy()
        solution[free] = np.linalg.solve(A[np.ix_(free, free)], rhs[free])
        Phi = solution.reshape(n, n).T
    if space.free_u.any():
        at = np.flatnonzero(space.free_u)
        residual = s1 - Phi @ s0 - count * np.where(space.free_u, 0.0, u)
        W = weight[np.ix_(at, at)]
        u = np.where(space.free_u, 0.0, u)
        u[at] = np.linalg.solve(W, (weight @ residual)[at]) / count
    S = (
        S11
        - S10 @ Phi.T
        - Phi @ S10.T
        + Phi @ S00 @ Phi.T
        - np.outer(s1, u)
        - np.outer(u, s1)
        + np.outer(Phi @ s0, u)
        + np.outer(u, Phi @ s0)
        + count * np.outer(u, u)
    )
    if space.free_Q.any():
        Q = np.where(space.free_Q, 0.5 * (S + S.T) / count, Q)
    if space.free_H.any() or space.free_R:
        after = got.sum_now + got.first + x.T @ x
        yx = x.T @ y
        if space.free_H.any():
            at = np.flatnonzero(space.free_H)
            held = np.where(space.free_H, 0.0, H)
            H = held.copy()
            H[at] = np.linalg.solve(after[np.ix_(at, at)], (yx - after @ held)[at])
        if space.free_R:
            R = float(y @ y - 2.0 * H @ yx + H @ after @ H) / y.size
    if space.free_mean.any():
        # the state before the first sample, seen through the first smoothed one
        before = smooth_start(space, x[0])
        mean = np.where(space.free_mean, before, mean)
    return replace(space, Phi=Phi, Q=Q, u=u, H=H, R=max(R, 0.0), mean=mean), got.log_likelihood


def smooth_start(space: StateSpace, first: Array) -> Array:
    """Smoothed mean of the state before the first sample, given that of the first."""
    P = space.Phi @ space.covariance @ space.Phi.T + space.Q
    gain = space.covariance @ space.Phi.T @ np.linalg.pinv(P, hermitian=True)
    return np.asarray(space.mean + gain @ (first - space.Phi @ space.mean - space.u))


def expectation_maximization(
    space: StateSpace, y: ArrayLike, *, tolerance: float = 1e-7, iterations: int = 2000
) -> Expectation:
    """Iterate until the relative change of the log-likelihood, averaged as in section 3.5 of Stebler et al. 2011, falls below ``tolerance``.

    Parameters
    ----------
    space : StateSpace
        Matrices to start from, with masks of what is free.
    y : (n,) array
        Signal.
    tolerance : float
        Relative rise of the likelihood at which it stops.
    iterations : int
        At most.

    Raises
    ------
    InputError
        A signal of fewer than three samples or not finite; no free entry.
    """
    signal = np.ascontiguousarray(y, dtype=np.float64)
    if signal.size < 3:
        raise InputError(f"the signal has {signal.size} samples, expected at least 3")
    masks = (space.free_Phi, space.free_Q, space.free_H, space.free_u, space.free_mean)
    if not (space.free_R or any(m.any() for m in masks)):
        raise InputError("every entry is fixed; there is nothing to estimate")
    trace: list[float] = []
    for _ in range(iterations):
        new, value = maximise(space, signal)
        if not math.isfinite(value):
            return Expectation(space, np.array(trace), False)
        trace.append(value)
        if len(trace) > 1:
            change = trace[-1] - trace[-2]
            if abs(change) / (0.5 * abs(trace[-1] + trace[-2]) + 1e-3) < tolerance:
                return Expectation(space, np.array(trace), True)
        space = new
    return Expectation(space, np.array(trace), False)


# -- the same for a noise model -------------------------------------------------------------------------------------------------------


def ramp_of(y: Array, dt: float) -> tuple[float, float, float]:
    """Least-squares offset, slope per second, and the slope's standard error were the residuals white."""
    t = (np.arange(y.size) - 0.5 * (y.size - 1)) * dt
    slope = float(t @ y / (t @ t))
    offset = float(y.mean() - slope * t.mean())
    residual = y - offset - slope * t
    return offset, slope, math.sqrt(float(residual @ residual) / max(y.size - 2, 1) / float(t @ t))


def fit_em(
    series: Series,
    model: NoiseModel,
    *,
    start: NoiseModel | None = None,
    ramp: Ramp = "least_squares",
    tolerance: float = 1e-7,
    iterations: int = 2000,
    confidence: float = 0.95,
) -> FitResult:
    """Fit a sum of WN, RW, GM, AR1, AR(p) and DR by constrained expectation-maximization.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        Parameters with a value are held where the process has all of them.
    start : NoiseModel, optional
        Specified model to start from; by default the estimate by wavelet moments.
    ramp : {"least_squares", "em", "none"}
        What is done about DR (and an offset): removed by least squares first, estimated inside as the input of a state, or left alone.
    tolerance, iterations
        Stopping rule.
    confidence : float
        Of the intervals.

    Raises
    ------
    InputError
        A process that is not in the list, a start of another structure.
    """
    if ramp not in get_args(Ramp):
        raise InputError(f"ramp is '{ramp}', expected one of: {', '.join(get_args(Ramp))}")
    bad = [p.symbol for p in model if p.moving() is None and not p.ramp]
    if bad:
        raise InputError(
            f"{bad[0]} cannot be fitted by em: it has no closed update; expected a sum of WN, RW, GM, AR1, AR and DR (or use gmwm)"
        )
    model = model.at_rate(series.rate_hz)
    dt = series.dt
    y = np.array(series.values)
    offset, slope, slope_error = ramp_of(y, dt)
    t = (np.arange(y.size) - 0.5 * (y.size - 1)) * dt
    has_ramp = any(p.ramp for p in model)
    inside = has_ramp and ramp == "em"
    level = y - offset - (slope * t if has_ramp and ramp != "none" else 0.0)
    y = y - offset - (slope * t if has_ramp and ramp == "least_squares" else 0.0)
    noise = NoiseModel(tuple(p for p in model if not p.ramp))
    curve = wavelet_variance(level, series.rate_hz)
    begin, moments = _begin(noise, curve, start)
    spread = max(float(np.var(y)), 1e-300)
    begin = NoiseModel(tuple(_positive(p, spread, dt, y.size) for p in begin))
    space, places = _space(noise, begin, dt, spread, inside, start_slope=_slope_of(start))
    found = expectation_maximization(space, y, tolerance=tolerance, iterations=iterations)
    fitted = _model(noise, begin, found.space, places, dt)
    notes: list[str] = []
    if not found.stopped:
        notes.append(
            f"the likelihood still rose after {found.trace.size} iterations; raise `iterations` or start nearer"
        )
    lower = 0.0
    if moments is not None:
        # both without the ramp, so that they are likelihoods of the same data
        given = NoiseModel(tuple(_positive(p, spread, dt, y.size) for p in moments))
        reached = found.trace[-1] if found.trace.size else -math.inf
        final = _likelihood(fitted, noise, level, dt, spread) if inside else reached
        lower = _likelihood(given, noise, level, dt, spread) - final
        # EM may stop a little short of the top it is on; a whole unit below another estimate is another matter
        if lower > 2.0:
            notes.append(
                f"the estimate by wavelet moments has a higher likelihood (by {lower:.1f}): the start led to a stop short of "
                "the maximum, or to another hill"
            )
    covariance, free = _information(fitted, noise, y, dt, spread)
    whole = _with_ramp(fitted, model, found, places, slope if ramp == "least_squares" else 0.0, dt, inside)
    free_of_model = [(_place(model, noise, k), name) for k, name in free]
    parameters = estimates(whole, free_of_model, covariance, series.unit, confidence)
    if has_ramp:
        least_squares = ramp == "least_squares"
        parameters = _with_ramp_error(parameters, slope_error if least_squares else math.nan)
        if least_squares:
            notes.append(
                "the ramp was removed by least squares; its standard error takes the residuals for white and is too small"
            )
    return FitResult(
        name=series.name,
        method="em",
        structure=model,
        model=whole,
        rate_hz=series.rate_hz,
        n_samples=y.size,
        unit=series.unit,
        parameters=parameters,
        covariance=covariance,
        curve=curve if not has_ramp else wavelet_variance(series.values, series.rate_hz),
        fitted=whole.wavelet_variance(curve.scale_samples, dt),
        objective=-float(found.trace[-1]) if found.trace.size else math.inf,
        converged=bool(found.stopped and lower <= 2.0),
        warnings=tuple(notes),
        details={"trace": found.trace, "offset": offset, "space": found.space, "start": begin, "free": free_of_model},
    )


def _begin(noise: NoiseModel, curve: WaveletVariance, start: NoiseModel | None) -> tuple[NoiseModel, NoiseModel | None]:
    """Where to begin, and the estimate by wavelet moments where there is one."""
    moments: NoiseModel | None = None
    try:
        moments = fit_curve(curve, noise).model
    except InputError:
        if start is None:
            raise
    if start is None:
        assert moments is not None
        return moments, moments
    begin = NoiseModel(tuple(p for p in start.at_rate(curve.rate_hz) if not p.ramp))
    if [p.symbol for p in begin] != [p.symbol for p in noise] or not begin.specified:
        raise InputError(
            f"the starting model {start} has another structure than {noise} (or parameters without a value)"
        )
    return begin, moments


def _with_ramp_error(parameters: tuple[Estimate, ...], error: float) -> tuple[Estimate, ...]:
    z = 1.959963984540054
    return tuple(
        replace(e, standard_error=error, low=e.value - z * error, high=e.value + z * error, free=True)
        if PROCESSES[e.process].ramp
        else e
        for e in parameters
    )


def _place(model: NoiseModel, noise: NoiseModel, k: int) -> int:
    return [i for i, p in enumerate(model) if not p.ramp][k]


def _slope_of(start: NoiseModel | None) -> float:
    return sum((p.parameters[p.level.name] for p in start if p.ramp), start=0.0) if start is not None else 0.0


def _positive(p: Process, spread: float, dt: float, n: int) -> Process:
    """A part with no variance cannot grow: give it a trace."""
    coefficient, shapes = p.coordinates(dt)
    if coefficient != 0.0:
        return p
    trace = 1e-4 * spread / (1.0 if p.stationary else n)
    return p.with_parameters({p.level.name: None}).of_coordinates(trace, [s for s in shapes if s is not None], dt)


def _space(
    asked: NoiseModel, begin: NoiseModel, dt: float, spread: float, inside: bool, start_slope: float
) -> tuple[StateSpace, list[tuple[int, slice]]]:
    """Matrices of a model with masks: which entries are free follows from which processes are."""
    blocks = [p.block(dt) for p in begin]
    block = StateBlock.stack(blocks, dt)
    n = block.n
    free_Phi, free_Q, free_u = np.zeros((n, n), dtype=bool), np.zeros((n, n), dtype=bool), np.zeros(n, dtype=bool)
    P0 = np.array(block.P0)
    places: list[tuple[int, slice]] = []
    lo = 0
    for k, p in enumerate(asked):
        size = blocks[k].n
        if size == 0:
            continue
        at = slice(lo, lo + size)
        places.append((k, at))
        moving = p.moving()
        assert moving is not None
        if not p.specified:
            free_Phi[at, at], free_Q[at, at] = moving
        if not p.stationary:
            P0[lo, lo] = spread
        elif size == 1:
            P0[lo, lo] = min(P0[lo, lo], spread)
        lo += size
    white = [k for k, b in enumerate(blocks) if b.n == 0]
    free_R = any(not asked.processes[k].specified for k in white)
    R = block.white if white else 1e-9 * spread  # the filter needs an innovation variance
    u = np.zeros(n)
    if inside:
        # Stebler et al. 2011, section 4.2: the input of the Markov state itself where no state wanders
        free_u[next((at.start for k, at in places if not asked.processes[k].stationary), 0)] = True
        u[free_u] = start_slope * dt
    nothing = np.zeros(n, dtype=bool)
    space = StateSpace(
        np.array(block.Phi), np.array(block.Q), np.array(block.c), u, R, np.zeros(n), P0,
        free_Phi, free_Q, nothing, free_u, free_R, nothing,
    )  # fmt: skip
    return space, places


def _model(
    asked: NoiseModel, begin: NoiseModel, space: StateSpace, places: list[tuple[int, slice]], dt: float
) -> NoiseModel:
    out = list(begin.processes)
    where = dict(places)
    for k, p in enumerate(asked):
        if p.specified:
            continue
        if k in where:
            at = where[k]
            out[k] = p.of_transition(space.Phi[at, at], np.maximum(space.Q[at, at], 0.0), dt)
        else:
            out[k] = p.of_coordinates(space.R, (), dt)
    return NoiseModel(tuple(out))


def _likelihood(model: NoiseModel, asked: NoiseModel, y: Array, dt: float, spread: float) -> float:
    space, _ = _space(asked, model, dt, spread, False, 0.0)
    if space.u.size == 0:
        return log_likelihood(StateBlock.empty(dt, space.R), y)
    return log_likelihood(space.block(), y)


def _information(
    model: NoiseModel, asked: NoiseModel, y: Array, dt: float, spread: float
) -> tuple[Array, list[tuple[int, str]]]:
    """Covariance from the observed information (equation (11) of Stebler et al. 2011), by differences in logarithms of the parameters."""
    free: list[tuple[int, str]] = []
    scale: list[float] = []
    for k, p in enumerate(asked):
        if p.specified:
            continue
        for meta in p.parameters_meta():
            value = model.processes[k].parameters[meta.name]
            free.append((k, meta.name))
            if meta.positive:
                scale.append(abs(value))
            else:
                scale.append(max(1.0 - abs(value), 1e-6))
    steps = np.array(scale)

    def value_at(move: Array) -> float:
        parts = list(model.processes)
        for (k, name), d, s in zip(free, move, steps, strict=True):
            old = model.processes[k].parameters[name]
            positive = next(meta for meta in asked.processes[k].parameters_meta() if meta.name == name).positive
            parts[k] = parts[k].with_parameters({name: old * math.exp(d) if positive else old + d * s})
        try:
            return _likelihood(NoiseModel(tuple(parts)), asked, y, dt, spread)
        except (InputError, np.linalg.LinAlgError):
            return math.nan

    count = len(free)
    out = np.full((count, count), np.nan)
    alive = [i for i in range(count) if steps[i] > 0]
    h = 0.02
    hessian = np.zeros((count, count))
    centre = value_at(np.zeros(count))
    for a, i in enumerate(alive):
        e = np.zeros(count)
        e[i] = h
        hessian[i, i] = (value_at(e) - 2.0 * centre + value_at(-e)) / h**2
        for j in alive[:a]:
            f = np.zeros(count)
            f[j] = h
            mixed = (value_at(e + f) - value_at(e - f) - value_at(f - e) + value_at(-e - f)) / (4.0 * h * h)
            hessian[i, j] = hessian[j, i] = mixed
    sub = -hessian[np.ix_(alive, alive)]
    if alive and np.isfinite(sub).all():
        values, vectors = np.linalg.eigh(sub)
        if values[0] > 1e-9 * max(values[-1], 1e-300):
            inverse = vectors / values @ vectors.T
            out[np.ix_(alive, alive)] = inverse * np.outer(steps[alive], steps[alive])
    return out, free


def _with_ramp(
    fitted: NoiseModel,
    model: NoiseModel,
    found: Expectation,
    places: list[tuple[int, slice]],
    slope: float,
    dt: float,
    inside: bool,
) -> NoiseModel:
    parts = list(fitted.processes)
    out: list[Process] = []
    for p in model:
        if p.ramp:
            if inside:
                at = int(np.flatnonzero(found.space.free_u)[0])
                rate = float(found.space.u[at]) / dt
                out.append(p.with_parameters({p.level.name: rate}))
            else:
                out.append(p.with_parameters({p.level.name: slope}))
        else:
            out.append(parts.pop(0))
    return NoiseModel(tuple(out))
