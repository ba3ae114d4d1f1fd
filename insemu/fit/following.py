"""Noise whose level follows a covariate: segments of a log fitted together, each with its own covariate.

Segments are runs with a covariate: at short scales every segment has a wavelet variance of its own, at the scales that a segment cannot show the
whole record has one. A process's part in a moment is its variance times the mean over the segment of the squared gain
(:class:`insemu.noise.Follows`), so that a covariate may change within a segment. Levels, shapes and slopes minimise one weighted distance, weighed by
the covariance of the moments under the model, as in :mod:`insemu.fit.runs`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, special

from insemu.errors import InputError
from insemu.fit.coordinates import Coordinates
from insemu.fit.covariance import model_covariance
from insemu.fit.gmwm import HOLDS, TEST_DOF, fit_curve, parameter_covariance
from insemu.fit.minimum import root_of_inverse
from insemu.fit.nonlinear import Moments, bias, minimised, slopes
from insemu.fit.result import Estimate, FitResult, GoodnessOfFit, estimates
from insemu.noise import Follows, NoiseModel, Process, process_label
from insemu.records import Series
from insemu.shown import finite
from insemu.variance import WaveletVariance, wavelet_variance

Array = NDArray[np.float64]

#: A segment's longest scale is this part of it at most; longer scales are taken from the whole record.
LONGEST = 0.25
#: Points of a segment's covariate, quantiles, that a mean over it is taken from.
POINTS = 200
#: Largest slope that is searched, in logarithms of the level over the range of the covariate.
STEEPEST = 12.0


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
        By label of a process that follows (``WN1``): its level in the segment alone, the rest as fitted to all, with its interval.
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
    """A model whose levels follow covariates, fitted to one axis.

    Parameters
    ----------
    result : FitResult
        The model with its slopes; ``WN1.slope`` is among the parameters. Curve and fit are those of the whole record.
    average : NoiseModel
        The model of constant levels that has the same wavelet variance over the whole record.
    segments : tuple of Segment
    p_values : mapping of str to float
        By label of a process that follows: probability of a slope as large by chance where its level does not follow (two-sided, Wald's test).
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
    steps: int = 2,
    confidence: float = 0.95,
) -> FollowingFit:
    """Fit a model some of whose levels follow covariates.

    Parameters
    ----------
    series : Series
        One axis of a log.
    covariates : mapping of str to (n,) array
        At the samples of the log, SI.
    model : NoiseModel
        Structure, for example ``WN(follows=temperature) + GM()``; parameters that have a value are held, slopes too.
    segments : int
        Segments of one length that the log is cut into.
    tau_from, tau_to : float
        Scales (s) to use.
    steps : int
        How many times the covariance of the moments is renewed.
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
    problem = _Segments.of(series, covariates, model, segments, tau_from, tau_to)
    tied, starts = problem.started(series)
    limits = problem.bounds(tied)

    def expected(at: Array) -> Array:
        return problem.expected(problem.model(tied, at))

    V = problem.covariance(problem.model(tied, starts[0]))
    tried = [minimised(expected, problem.value, root_of_inverse(V), start, limits) for start in starts]
    x, _ = min(tried, key=lambda found: found[1])
    for _ in range(max(steps, 1)):
        V = problem.covariance(problem.model(tied, x))
        x, objective = minimised(expected, problem.value, root_of_inverse(V), x, limits)
    V = problem.covariance(problem.model(tied, x))
    W, D = root_of_inverse(V), slopes(expected, x)
    C, lost = parameter_covariance(D, W, V)
    test = _test(problem, expected, x, limits, V)
    x = x - bias(expected, x, D, W, C)
    return _answer(problem, series, tied, x, C, objective, test, bool(lost), confidence)


@dataclass(frozen=True)
class _Segments:
    """Wavelet moments of the segments of a log, and of the whole at the scales that no segment shows."""

    asked: NoiseModel
    curves: tuple[WaveletVariance, ...]
    whole: WaveletVariance
    keep: NDArray[np.bool_]
    rest: NDArray[np.bool_]
    points: Mapping[str, Array]
    edges: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        series: Series,
        covariates: Mapping[str, ArrayLike],
        model: NoiseModel,
        segments: int,
        tau_from: float,
        tau_to: float,
    ) -> _Segments:
        n = len(series.complete("a fit of segments"))
        named = {p.follows.covariate for p in model if p.follows is not None}
        if not named:
            raise InputError(f"no level of {model} follows a covariate; write for example WN(follows=temperature)")
        for p in model:
            if p.single_draw:
                raise InputError(f"{p} is a signal, not noise, and cannot be fitted to segments", where=series.name)
        given = {name: _checked(name, covariates, n) for name in sorted(named)}
        length = n // segments if segments > 0 else 0
        levels = int(math.log2(length * LONGEST)) if length else 0
        if segments < 2 or levels < 2:
            raise InputError(
                f"found {segments} segments of {n} samples, expected at least 2 of at least {round(4 / LONGEST)} samples each",
                where=series.name,
            )
        edges = np.linspace(0, n, segments + 1).astype(np.int64)
        asked = NoiseModel(
            tuple(p if p.follows is None else replace(p, follows=_centred(p.follows, given)) for p in model)
        ).at_rate(series.rate_hz)
        curves = tuple(
            wavelet_variance(series.values[a:b], series.rate_hz, levels=levels) for a, b in itertools.pairwise(edges)
        )
        whole = wavelet_variance(series.values, series.rate_hz)
        quantiles = (np.arange(POINTS) + 0.5) / POINTS
        points = {
            name: np.array([np.quantile(v[a:b], quantiles) for a, b in itertools.pairwise(edges)])
            for name, v in given.items()
        }

        def used(tau: Array) -> NDArray[np.bool_]:
            return (tau >= tau_from * (1 - 1e-9)) & (tau <= tau_to * (1 + 1e-9))

        keep = used(curves[0].tau_s)
        rest = used(whole.tau_s) & (whole.scale_samples > curves[0].scale_samples[-1])
        return cls(asked, curves, whole, keep, rest, points, edges)

    @property
    def dt(self) -> float:
        return 1.0 / self.whole.rate_hz

    @property
    def value(self) -> Array:
        return np.concatenate([*(c.value[self.keep] for c in self.curves), self.whole.value[self.rest]])

    @property
    def following(self) -> list[int]:
        """Places of the processes whose slope is to be estimated."""
        return [k for k, p in enumerate(self.asked) if p.follows is not None and p.follows.slope is None]

    def power(self, process: Process) -> Array:
        """Mean of the squared gain in every segment, and over all: (segments + 1,)."""
        if process.follows is None:
            return np.ones(len(self.curves) + 1)
        law = process.follows
        own = np.mean(law.gain(self.points[law.covariate]) ** 2, axis=1)
        return np.append(own, own.mean())

    def expected(self, model: NoiseModel) -> Array:
        """All moments under a model, stacked."""
        short, long = self.curves[0].scale_samples[self.keep], self.whole.scale_samples[self.rest]
        own, rest = np.zeros((len(self.curves), short.size)), np.zeros(long.size)
        for p in model:
            power, plain = self.power(p), replace(p, follows=None)
            own += power[:-1, None] * plain.wavelet_variance(short, self.dt)
            rest += power[-1] * plain.wavelet_variance(long, self.dt)
        return np.concatenate([own.ravel(), rest])

    def constant(self, model: NoiseModel, segment: int) -> NoiseModel:
        """The model of constant levels with the same mean power in a segment; -1: in the whole record."""
        parts = ((p, math.sqrt(float(self.power(p)[segment]))) for p in model)
        return NoiseModel(tuple(replace(p, follows=None).scaled(g) for p, g in parts))

    def covariance(self, model: NoiseModel) -> Array:
        """Covariance of all moments of a Gaussian signal whose levels change slowly.

        Segments are independent of each other, but not of the longer scales of the whole record, which are means over the segments: with the
        covariance ``V_s`` of a whole record that is throughout like segment s, the moments of s covary with the longer scales by ``V_s``, and
        those among each other by the mean of ``V_s`` over the segments.
        """
        scale, n = self.curves[0].scale_samples[self.keep], self.whole.n_samples
        here = [self.constant(model, s) for s in range(len(self.curves))]
        out = linalg.block_diag(
            *(model_covariance(m, c.n_samples, scale, self.dt) for m, c in zip(here, self.curves, strict=True))
        )
        if not self.rest.any():
            return np.asarray(out)
        every = np.append(scale, self.whole.scale_samples[self.rest])
        through = np.array([model_covariance(m, n, every, self.dt) for m in here])
        k = scale.size
        across = through[:, :k, k:].reshape(-1, every.size - k)
        return np.block([[out, across], [across.T, through[:, k:, k:].mean(axis=0)]])

    # -- coordinates ----------------------------------------------------------------------------------------------------------------

    def model(self, tied: Coordinates, x: Array) -> NoiseModel:
        """The model at coordinates: those of the processes, then the slopes."""
        count = len(tied.free)
        parts = list(tied.model(x[:count]).processes)
        for k, slope in zip(self.following, x[count:] / self.widths(), strict=True):
            law = self.asked.processes[k].follows
            assert law is not None
            parts[k] = replace(parts[k], follows=replace(law, slope=float(slope)))
        return NoiseModel(tuple(parts))

    def widths(self) -> Array:
        """Range of the stretched covariate of every slope: a coordinate is the change of the logarithm of the level over it."""
        out = []
        for k in self.following:
            law = self.asked.processes[k].follows
            assert law is not None
            u = law.stretched(self.points[law.covariate])
            u = u[np.isfinite(u)]
            out.append(float(np.ptp(u)) if u.size else 0.0)
        return np.array(out)

    def bounds(self, tied: Coordinates) -> tuple[Array, Array]:
        """Limits of the coordinates."""
        low, high = tied.bounds(self.whole.n_samples, self.dt)
        steep = np.full(len(self.following), STEEPEST)
        return np.append(low, -steep), np.append(high, steep)

    def started(self, series: Series) -> tuple[Coordinates, list[Array]]:
        """Coordinates of the constant model nearest to the whole record with slopes to begin from.

        Slopes: as the curves of the segments change scale by scale; and 1 of power laws, 0 of others.
        """
        plain = NoiseModel(tuple(replace(p, follows=None) for p in self.asked))
        tau = self.whole.tau_s[np.concatenate([np.flatnonzero(self.keep), np.flatnonzero(self.rest)])]
        begin = fit_curve(
            self.whole,
            plain,
            weighting="intervals",
            tau_from=tau[0],
            tau_to=tau[-1],
            name=series.name,
            unit=series.unit,
        ).model
        begin = _shared_out(begin, self.asked)
        scale = self.curves[0].scale_samples[self.keep]
        shares = np.array([p.wavelet_variance(scale, self.dt) for p in begin])
        shares /= np.maximum(shares.sum(axis=0), 1e-300)
        logs = 0.5 * np.log(np.maximum([c.value[self.keep] for c in self.curves], 1e-300))
        weight = self.curves[0].edof[self.keep]
        seen, plainly = [], []
        for k, width in zip(self.following, self.widths(), strict=True):
            law = self.asked.processes[k].follows
            assert law is not None
            u = np.mean(np.maximum(law.stretched(self.points[law.covariate]), -STEEPEST), axis=1)
            u = u - u.mean()
            slope = (u @ logs) / max(float(u @ u), 1e-300)
            w = weight * shares[k] ** 2
            seen.append(float(np.clip(w @ slope / max(float(w.sum()), 1e-300) * width, -3.0, 3.0)))
            plainly.append(width if law.law == "power" else 0.0)
        tied = Coordinates.of(plain, begin, float(np.std(np.diff(series.values))), self.dt)
        followed = NoiseModel(tuple(replace(p, follows=q.follows) for p, q in zip(tied.begin, self.asked, strict=True)))
        tied = replace(tied, begin=followed)
        return tied, [self._at_its_covariate(tied, np.append(tied.start, b)) for b in (seen, plainly)]

    def _at_its_covariate(self, tied: Coordinates, x: Array) -> Array:
        """Levels that are averages over the record, as those at the covariate ``at``."""
        x = x.copy()
        for place, (k, name) in enumerate(tied.free):
            p = self.model(tied, x).processes[k]
            if name == p.level.name:
                x[place] -= 0.5 * p.level.power * math.log(max(float(self.power(p)[-1]), 1e-12))
        return x


def _shared_out(begin: NoiseModel, asked: NoiseModel) -> NoiseModel:
    """Processes of one kind of which some follow share their variance: to one curve they are one."""
    parts = list(begin.processes)
    for kind in {p.symbol for p, q in zip(begin, asked, strict=True) if q.follows is not None}:
        alike = [k for k, p in enumerate(begin) if p.symbol == kind and not asked.processes[k].specified]
        sizes = [parts[k].parameters[parts[k].level.name] for k in alike]
        if len(alike) > 1 and min(sizes) < 0.1 * max(sizes):
            largest = parts[alike[int(np.argmax(sizes))]]
            for k in alike:
                parts[k] = largest.scaled(1.0 / math.sqrt(len(alike)))
    return NoiseModel(tuple(parts))


def _checked(name: str, covariates: Mapping[str, ArrayLike], n: int) -> Array:
    if name not in covariates:
        there = ", ".join(covariates)
        raise InputError(f"no covariate '{name}'" + (f", there are: {there}" if there else " is given"))
    x = np.asarray(covariates[name], dtype=np.float64)
    if x.shape != (n,):
        raise InputError(f"the covariate {name} has shape {x.shape}, expected ({n},)")
    if not np.isfinite(x).all():
        raise InputError(f"the covariate {name} has {int((~np.isfinite(x)).sum())} values that are not finite")
    if np.ptp(x) == 0.0:
        raise InputError(f"the covariate {name} is {x[0]:g} throughout: a level cannot be seen to follow it")
    return x


def _centred(law: Follows, given: Mapping[str, Array]) -> Follows:
    """A law whose level is that at the mean of the covariate, where it does not say at what."""
    if law.at is not None or law.slope is not None:
        return law
    mean = float(np.mean(given[law.covariate]))
    rounded = float(f"{mean:.2g}")
    return replace(law, at=rounded if rounded > law.above or law.law == "exp" else mean)


def _test(
    problem: _Segments, expected: Moments, x: Array, limits: tuple[Array, Array], V: Array
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
    return GoodnessOfFit(statistic, dof, float(special.chdtrc(dof, statistic)), np.unique(tau[rows]))


def _answer(
    problem: _Segments,
    series: Series,
    tied: Coordinates,
    x: Array,
    C: Array,
    objective: float,
    test: GoodnessOfFit | None,
    lost: bool,
    confidence: float,
) -> FollowingFit:
    """Everything in the user's quantities."""
    count, model = len(tied.free), problem.model(tied, x)
    slope = np.append(tied.slopes(x[:count]), 1.0 / problem.widths())
    covariance = slope[:, None] * C * slope[None, :]
    own = estimates(model, tied.free, covariance[:count, :count], series.unit, confidence)
    z = float(special.ndtri(0.5 + 0.5 * confidence))
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
                float(2.0 * special.ndtr(-abs(b) / error)) if error > 0 else math.nan
            )
        found.append(
            Estimate(
                p.symbol, index, "slope", b, p.follows.slope_unit, error, b - z * error, b + z * error,
                free=k in problem.following,
            )
        )  # fmt: skip
    average = problem.constant(model, -1)
    notes = ["the segments do not determine all parameters"] if lost else []
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
        fitted=average.wavelet_variance(problem.whole.scale_samples, problem.dt),
        objective=objective,
        converged=True,
        warnings=tuple(notes),
        test=test,
        details={"weighting": "asymptotic", "free": tied.free},
    )
    return FollowingFit(result, average, _segments(problem, model, z), p_values)


def _segments(problem: _Segments, model: NoiseModel, z: float) -> tuple[Segment, ...]:
    """Every segment's own levels of the processes that follow, the others and all shapes as fitted to all."""
    scale = problem.curves[0].scale_samples[problem.keep]
    moving = [k for k, p in enumerate(model) if p.follows is not None]
    labels = [process_label(p.symbol, index) for index, p in model.indexed()]
    out = []
    for s, curve in enumerate(problem.curves):
        here = problem.constant(model, s)
        parts = np.array([p.wavelet_variance(scale, problem.dt) for p in here]).T
        W = root_of_inverse(model_covariance(here, curve.n_samples, scale, problem.dt))
        target = curve.value[problem.keep] - parts.sum(axis=1) + parts[:, moving].sum(axis=1)
        A = W @ parts[:, moving]
        solved, *_ = np.linalg.lstsq(A, W @ target, rcond=None)
        spread = np.sqrt(np.diag(np.linalg.pinv(A.T @ A)))
        level: dict[str, float] = {}
        low: dict[str, float] = {}
        high: dict[str, float] = {}
        for k, factor, error in zip(moving, solved, spread, strict=True):
            p = here.processes[k]
            size, power = p.parameters[p.level.name], 0.5 * p.level.power
            for into, ratio in ((level, factor), (low, factor - z * error), (high, factor + z * error)):
                into[labels[k]] = size * max(float(ratio), 0.0) ** power
        x = {name: values[s] for name, values in problem.points.items()}
        a, b = problem.edges[s : s + 2] * problem.dt
        mean, lowest, highest = ({n: float(f(v)) for n, v in x.items()} for f in (np.mean, np.min, np.max))
        out.append(Segment(float(a), float(b), mean, lowest, highest, level, low, high))
    return tuple(out)
