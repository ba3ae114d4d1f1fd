"""Noise whose level or correlation times follow a covariate: segments of a log fitted together, each with its own covariate.

Segments are runs with a covariate: at short scales every segment has a wavelet variance of its own, at the scales that a segment cannot show the
whole record has one. A process's part in a moment is its variance times the mean over the segment of the squared gain
(:class:`insemu.noise.Follows`), so that a covariate may change within a segment; where its correlation times follow, its part is the mean of its
variance over the covariates of the segment, which holds where they change slowly against the correlation time. Levels, shapes and slopes minimise one
weighted distance, weighed by the covariance of the moments under the model, as in :mod:`insemu.fit.runs`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.fit.coordinates import Coordinates
from insemu.fit.covariance import model_covariance
from insemu.fit.gmwm import HOLDS, TEST_DOF, parameter_covariance
from insemu.fit.minimum import root_of_inverse
from insemu.fit.nonlinear import Moments, bias, minimised, slopes
from insemu.fit.result import Estimate, FitResult, GoodnessOfFit, estimates
from insemu.fit.segments import Segments
from insemu.noise import LARGEST_LOG_GAIN, LARGEST_LOG_TIME, NoiseModel, Process, process_label
from insemu.records import Series
from insemu.shown import finite
from insemu.variance import WaveletVariance

Array = NDArray[np.float64]

#: How many times the covariance of the moments is renewed.
RENEWALS = 2
#: Steps towards the correlation time of one segment by itself, and the step of its logarithm that slopes are taken over.
ROUNDS = 4
STEP_TIME = 0.05


@dataclass(frozen=True)
class Segment:
    """One segment of a log.

    Parameters
    ----------
    start_s, end_s : float
        Of the log.
    covariate, lowest, highest : mapping of str to float
        Mean, least and largest value of every covariate in it.
    level, low, high : mapping of str to float
        By label of a process that follows (``WN1``): its level (or longest correlation time in s, where that follows) in the segment alone, the
        rest as fitted to all, with its interval.
    """

    start_s: float
    end_s: float
    covariate: Mapping[str, float]
    lowest: Mapping[str, float]
    highest: Mapping[str, float]
    level: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]


@dataclass(frozen=True)
class FollowingFit:
    """A model whose levels or correlation times follow covariates, fitted to one axis.

    Parameters
    ----------
    result : FitResult
        The model with its slopes; ``WN1.slope`` is among the parameters. Curve and fit are those of the whole record.
    average : NoiseModel
        The constant model that has the same wavelet variance over the whole record; correlation times that follow are those at the mean of the
        logarithm of their gain.
    segments : tuple of Segment
    p_values : mapping of str to float
        By label of a process that follows: probability of a slope as large by chance where it does not follow (two-sided, Wald's test).
    """

    result: FitResult
    average: NoiseModel
    segments: tuple[Segment, ...]
    p_values: Mapping[str, float]

    def to_json(self) -> dict[str, object]:
        """The stable machine-readable form."""
        return self.result.to_json() | {
            "slope_p_values": finite(dict(self.p_values)),
            "segments": finite([vars(s) for s in self.segments]),
        }


def fit_following(
    series: Series,
    covariates: Mapping[str, ArrayLike],
    model: NoiseModel,
    *,
    segments: int = 12,
    tau_from: float = 0.0,
    tau_to: float = math.inf,
    confidence: float = 0.95,
) -> FollowingFit:
    """Fit a model some of whose levels or correlation times follow covariates.

    Parameters
    ----------
    series : Series
        One axis of a log.
    covariates : mapping of str to (n,) array
        At the samples of the log, SI.
    model : NoiseModel
        Structure, for example ``WN(follows=temperature) + GM(follows=temperature, what=time)``; parameters that have a value are held, slopes too.
    segments : int
        Segments of one length that the log is cut into.
    tau_from, tau_to : float
        Scales (s) to use.
    confidence : float
        Level of the intervals.

    Returns
    -------
    FollowingFit

    Raises
    ------
    InputError
        No level that follows a covariate, a covariate that is missing, not finite, of another length or constant, segments that are too short,
        a process without randomness; what a fit to one curve refuses.
    """
    problem = Segments.of(series, covariates, model, segments, tau_from, tau_to)
    tied, starts = problem.started(series)
    limits = problem.bounds(tied)

    def expected(at: Array) -> Array:
        return problem.expected(problem.model(tied, at))

    V = problem.covariance(problem.model(tied, starts[0]))
    tried = [minimised(expected, problem.value, root_of_inverse(V), start, limits) for start in starts]
    x, _ = min(tried, key=lambda found: found[1])
    for _ in range(RENEWALS):
        V = problem.covariance(problem.model(tied, x))
        x, objective = minimised(expected, problem.value, root_of_inverse(V), x, limits)
    V = problem.covariance(problem.model(tied, x))
    W, D = root_of_inverse(V), slopes(expected, x)
    C, lost = parameter_covariance(D, W, V)
    test = _test(problem, expected, x, limits, V)
    x = x - bias(expected, x, D, W, C)
    return _answer(problem, series, _Solved(tied, x, C, objective, test, bool(lost)), confidence)


def _test(
    problem: Segments, expected: Moments, x: Array, limits: tuple[Array, Array], V: Array
) -> GoodnessOfFit | None:
    """Test of over-identifying restrictions over the moments with enough degrees of freedom."""
    moments = expected(x)
    rows = np.flatnonzero(2.0 * moments**2 / np.diag(V) >= TEST_DOF)
    dof = rows.size - x.size
    if dof < 1:
        return None
    W = root_of_inverse(V[np.ix_(rows, rows)])
    _, statistic = minimised(lambda at: expected(at)[rows], problem.value[rows], W, x, limits)
    short = np.tile(problem.curves[0].tau_s[problem.keep], len(problem.curves))
    tau = np.append(short, problem.whole.tau_s[problem.rest])
    return GoodnessOfFit(statistic, dof, float(scipy.special.chdtrc(dof, statistic)), np.unique(tau[rows]))


@dataclass(frozen=True)
class _Solved:
    """Coordinates of the model, their values and covariance at the minimum, its test, and whether the moments leave some undetermined."""

    tied: Coordinates
    x: Array
    covariance: Array
    objective: float
    test: GoodnessOfFit | None
    lost: bool


def _answer(problem: Segments, series: Series, solved: _Solved, confidence: float) -> FollowingFit:
    """Everything in the user's quantities."""
    tied, x, test = solved.tied, solved.x, solved.test
    count, model = len(tied.free), problem.model(tied, x)
    slope = np.append(tied.slopes(x[:count]), 1.0 / problem.widths())
    covariance = slope[:, None] * solved.covariance * slope[None, :]
    own = estimates(model, tied.free, covariance[:count, :count], series.unit, confidence)
    z = float(scipy.special.ndtri(0.5 + 0.5 * confidence))
    found: list[Estimate] = []
    p_values: dict[str, float] = {}
    for k, (index, p) in enumerate(model.indexed()):
        found += [e for e in own if (e.process, e.index) == (p.symbol, index)]
        if p.follows is None or p.follows.slope is None:
            continue
        b, error = p.follows.slope, math.nan
        if k in problem.following:
            at = count + problem.following.index(k)
            error = math.sqrt(covariance[at, at]) if covariance[at, at] > 0 else math.nan
            p_values[process_label(p.symbol, index)] = (
                float(2.0 * scipy.special.ndtr(-abs(b) / error)) if error > 0 else math.nan
            )
        found.append(
            Estimate(
                p.symbol, index, "slope", b, p.follows.slope_unit, error, b - z * error, b + z * error,
                free=k in problem.following,
            )
        )  # fmt: skip
    average = problem.constant(model, -1)
    notes = ["the segments do not determine all parameters"] if solved.lost else []
    if test is not None and test.p_value < HOLDS:
        notes.append(
            "segments differ by more than this law explains: intervals and p-values of the slopes are too narrow"
        )
    result = FitResult(
        name=series.name,
        method="gmwm",
        structure=problem.asked,
        model=model,
        rate_hz=series.rate_hz,
        n_samples=len(series),
        unit=series.unit,
        parameters=tuple(found),
        covariance=covariance,
        curve=problem.whole,
        fitted=problem.curve(model),
        objective=solved.objective,
        converged=True,
        warnings=tuple(notes),
        test=test,
        details={"weighting": "asymptotic", "free": tied.free},
    )
    return FollowingFit(result, average, _segments(problem, model, z), p_values)


@dataclass(frozen=True)
class Followed:
    """What of a process follows a covariate, as a reader knows it.

    Parameters
    ----------
    name, unit : str
        Of the level, or ``Tc`` in s: the longest correlation time.
    value : float
        At gain 1, SI.
    power : float
        It goes with the gain to this power.
    """

    name: str
    unit: str
    value: float
    power: float


def followed(process: Process, unit: str, dt: float) -> Followed:
    """What follows of a process with a law.

    Parameters
    ----------
    process : Process
        With values.
    unit : str
        SI unit of the signal, or nothing.
    dt : float
        Sampling interval, s.
    """
    if process.follows is not None and process.follows.what == "time":
        return Followed("Tc", "s", replace(process, follows=None).block(dt).memory, 1.0)
    level = process.level
    return Followed(level.name, level.unit_for(unit) if unit else "", process.parameters[level.name], level.power)


def _alone(
    problem: Segments, here: NoiseModel, moving: list[int], timed: list[bool], curve: WaveletVariance
) -> tuple[Array, Array]:
    """Squared factors of levels and logarithms of factors of correlation times that one segment by itself asks for, with standard errors."""
    scale = problem.curves[0].scale_samples[problem.keep]
    W = root_of_inverse(model_covariance(here, curve.n_samples, scale, problem.dt))

    def part(k: int, u: float = 0.0) -> Array:
        process = here.processes[k]
        return (process.slowed(math.exp(u)) if u else process).wavelet_variance(scale, problem.dt)

    fixed = sum((part(k) for k in range(len(here)) if k not in moving), start=np.zeros(scale.size))
    solved, spread = np.zeros(len(moving)), np.zeros(len(moving))
    for _ in range(ROUNDS if any(timed) else 1):
        target, columns = curve.value[problem.keep] - fixed, []
        for k, of_time, u in zip(moving, timed, solved, strict=True):
            if of_time:
                columns.append((part(k, u + STEP_TIME) - part(k, u - STEP_TIME)) / (2.0 * STEP_TIME))
                target = target - part(k, u) + columns[-1] * u
            else:
                columns.append(part(k))
        A = W @ np.array(columns).T
        found, *_ = np.linalg.lstsq(A, W @ target, rcond=None)
        spread = np.sqrt(np.diag(np.linalg.pinv(A.T @ A)))
        near = np.clip(found, solved - 1.0, solved + 1.0).clip(-0.5 * LARGEST_LOG_TIME, 0.5 * LARGEST_LOG_TIME)
        solved = np.where(timed, near, found)
    return solved, spread


def _segments(problem: Segments, model: NoiseModel, z: float) -> tuple[Segment, ...]:
    """Every segment's own levels and correlation times of the processes that follow, the others and all shapes as fitted to all."""
    moving = [k for k, p in enumerate(model) if p.follows is not None]
    timed = [(law := model.processes[k].follows) is not None and law.what == "time" for k in moving]
    labels = [process_label(p.symbol, index) for index, p in model.indexed()]
    out = []
    for s, curve in enumerate(problem.curves):
        here = problem.constant(model, s)
        solved, spread = _alone(problem, here, moving, timed, curve)
        level: dict[str, float] = {}
        low: dict[str, float] = {}
        high: dict[str, float] = {}
        for k, of_time, factor, error in zip(moving, timed, solved, spread, strict=True):
            p = here.processes[k]
            size, power = p.parameters[p.level.name], 0.5 * p.level.power
            for into, value in ((level, factor), (low, factor - z * error), (high, factor + z * error)):
                if of_time:
                    into[labels[k]] = p.block(problem.dt).memory * math.exp(min(float(value), LARGEST_LOG_GAIN))
                else:
                    into[labels[k]] = size * max(float(value), 0.0) ** power
        x = {name: values[s] for name, values in problem.points.items()}
        a, b = problem.edges[s : s + 2] * problem.dt
        mean, lowest, highest = ({n: float(f(v)) for n, v in x.items()} for f in (np.mean, np.min, np.max))
        out.append(Segment(float(a), float(b), mean, lowest, highest, level, low, high))
    return tuple(out)
