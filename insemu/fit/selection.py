"""Which model the data support: the wavelet information criterion with its scatter, over given candidates or everything nested in one.

All candidates are weighed by one matrix, the inverse covariance of the curve under the richest model, so that their distances are
comparable: the difference between nested models is then a chi-square with as many degrees of freedom as parameters differ. The criterion
adds twice the optimism ``tr(cov(curve, fitted) Omega)`` (Zhang, Guerrier, Molinari 2015; section 4 of Balamuta et al. 2016), which is two per
parameter with these weights. Its minimum alone would take a superfluous process in every sixth comparison; therefore the simplest model
is chosen that its own test of fit accepts and from which no richer one differs by more than chance produces, each comparison made in the
weights of the simpler model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.covariance import covariance_of_curve
from insemu.fit.gmwm import Weights, fit_curve, goodness_of_fit, interval_widths, refit
from insemu.fit.minimum import Problem, Solution, root_of_inverse
from insemu.fit.result import Criterion, FitResult
from insemu.fit.robust import cleaned_curve
from insemu.fit.structure import Structure, natural_jacobian
from insemu.noise import NoiseModel, Process
from insemu.records import Series
from insemu.shown import Shown, few
from insemu.variance import WaveletVariance, wavelet_variance

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

#: A richer model must be nearer by more than chance produces once in so many comparisons. A superfluous part that chance made look good
#: by some distance costs about that distance in the prediction of another record, so the level is strict; at 1 % one record in twenty
#: took a superfluous part, and one in a hundred predicted visibly worse for it.
CHANCE = 1e-4
#: The same where no candidate follows the curve: distances then hold more of what the candidates miss than of chance, and a real log's slow
#: part must not be given up for it.
CHANCE_OF_MISFITS = 1e-2
#: Scales with fewer degrees of freedom under the reference are left out: their scatter is far from normal.
RANK_DOF = 10.0


@dataclass(frozen=True)
class Candidate:
    """One model of a ranking.

    Parameters
    ----------
    structure : NoiseModel
    parameters : int
        Free parameters that left a trace.
    objective : float
        Squared distance to the curve in the common weights.
    criterion : Criterion
        Wavelet information criterion.
    p_value : float
        Of the test of fit; NaN where no scale is left over.
    vanished : bool
        A part has no variance: the model is one of the smaller ones.
    model : NoiseModel
        Fitted in the common weights.
    """

    structure: NoiseModel
    parameters: int
    objective: float
    criterion: Criterion
    p_value: float
    vanished: bool
    model: NoiseModel


@dataclass(frozen=True, repr=False)
class Ranking(Shown):
    """Candidates of one axis, best criterion first.

    Parameters
    ----------
    name : str
        Axis.
    candidates : tuple of Candidate
    chosen : Candidate
        The simplest that no richer one beats by more than chance.
    fit : FitResult
        The chosen structure, fitted and with its criterion.
    discrepancy : float
        Relative error of the wavelet variance per scale that the best candidate leaves beyond chance; 0 where it fits.
    verdict : str
        In plain words.
    """

    name: str
    candidates: tuple[Candidate, ...]
    chosen: Candidate
    fit: FitResult
    discrepancy: float
    verdict: str

    def __str__(self) -> str:
        head = f"{self.name}: {self.chosen.structure} of {len(self.candidates)} candidates: {self.fit.verdict}"
        listed = (f"  {c.criterion.value:10.1f}  {c.structure}" for c in self.candidates if not c.vanished)
        return few([head, f"  {self.fit.words}", *listed])

    def to_dataframe(self) -> pd.DataFrame:
        """One row per candidate, best criterion first."""
        import pandas as pd

        rows = [
            (c.parameters, c.criterion.value, c.criterion.standard_error, c.objective, c.p_value, c is self.chosen)
            for c in self.candidates
        ]
        columns = ["parameters", "criterion", "standard_error", "distance", "p_value", "chosen"]
        return pd.DataFrame(rows, index=[str(c.structure) for c in self.candidates], columns=columns)


def nested(general: NoiseModel) -> list[NoiseModel]:
    """Every non-empty sum of parts of a model, simplest first; repeated processes count once per number."""
    kinds: list[Process] = []
    counts: list[int] = []
    for p in general:
        if p in kinds:
            counts[kinds.index(p)] += 1
        else:
            kinds.append(p)
            counts.append(1)
    out = []
    for numbers in product(*(range(c + 1) for c in counts)):
        if any(numbers):
            out.append(NoiseModel(tuple(p for p, k in zip(kinds, numbers, strict=True) for _ in range(k))))
    return sorted(out, key=lambda model: (sum(len(p.parameters_meta()) for p in model), len(model)))


def select(
    curve: WaveletVariance,
    general: NoiseModel,
    *,
    name: str = "signal",
    unit: str = "",
    efficiency: float = 1.0,
    executor: Executor | None = None,
) -> Ranking:
    """Choose among everything nested in a general model.

    Parameters
    ----------
    curve : WaveletVariance
        Haar MODWT curve of the signal.
    general : NoiseModel
        For example ``4*GM() + WN() + RW() + QN()``.
    name, unit : str
        Of the axis.
    efficiency : float
        Of a robust curve.
    executor : Executor, optional
        Candidates are independent work items.

    Raises
    ------
    InputError
        A model that cannot be fitted, a curve too short for any candidate.
    """
    return rank_models(
        curve, nested(general), name=name, unit=unit, reference=general, efficiency=efficiency, executor=executor
    )


def rank_models(
    curve: WaveletVariance,
    candidates: Sequence[NoiseModel],
    *,
    name: str = "signal",
    unit: str = "",
    reference: NoiseModel | None = None,
    efficiency: float = 1.0,
    executor: Executor | None = None,
) -> Ranking:
    """Rank candidates by the wavelet information criterion and choose one.

    Parameters
    ----------
    curve : WaveletVariance
    candidates : sequence of NoiseModel
    name, unit : str
    reference : NoiseModel, optional
        Whose covariance weighs; by default the candidate nearest to the curve.
    efficiency : float
        Of a robust curve.
    executor : Executor, optional
        Where candidates are fitted.

    Raises
    ------
    InputError
        No candidate, none that the curve has enough scales for.
    """
    if not candidates:
        raise InputError("no candidate model given; expected at least one")
    structures = [Structure.of(c, curve.rate_hz) for c in candidates]
    unrated = {id(s): c for s, c in zip(structures, candidates, strict=True)}
    if not (curve.value > 0).all():
        raise InputError(f"{name}: the wavelet variance is zero at some scale; a constant signal has no noise to model")
    n = curve.n_samples
    V = _reference_covariance(curve, candidates if reference is None else [reference], efficiency)
    freedom = V[1]
    use = freedom >= RANK_DOF
    while use.sum() < 2:  # a very short record: take what there is
        use[int(np.flatnonzero(~use)[0])] = True
    problems = [Problem(s, curve.scale_samples[use], curve.value[use], n) for s in structures]
    covariance = V[0][np.ix_(use, use)]
    possible = [p for p in problems if p.structure.free_parameters <= p.scale.size]
    if not possible:
        raise InputError(f"{name}: no candidate has as few parameters as the {use.sum()} usable scales of this record")

    def solve(covariance: Array) -> list[tuple[Problem, Solution]]:
        W = root_of_inverse(covariance)

        def one(problem: Problem) -> Solution:
            return problem.search(W, problem.structure.starts(n, 400), refined=4)

        found = executor.map(one, possible) if executor is not None else map(one, possible)
        return list(zip(possible, found, strict=True))

    solved = solve(covariance)
    discrepancy = _discrepancy(solved, covariance)
    if discrepancy > 0:
        covariance = (V[0] + np.diag((discrepancy * V[2]) ** 2))[np.ix_(use, use)]
        solved = solve(covariance)
    W = root_of_inverse(covariance)
    ranked = [_candidate(problem, best, W, covariance, unrated[id(problem.structure)]) for problem, best in solved]
    ranked.sort(key=lambda c: (c.criterion.value, c.parameters))

    under = _Under(curve, use, discrepancy * V[2], efficiency)
    chosen = _choose(ranked, under, CHANCE_OF_MISFITS if discrepancy > 0 else CHANCE)
    result = _fit_of(chosen, curve, discrepancy * V[2], efficiency, unit, name)
    if discrepancy > 0:
        note = (
            f"the record has structure that no candidate has, about {discrepancy:.1%} of the wavelet variance per scale; standard errors "
            "and the test of fit allow for it"
        )
        result = replace(result, warnings=(*result.warnings, note))
    result = replace(result, criterion=chosen.criterion)
    return Ranking(name, tuple(ranked), chosen, result, discrepancy, _verdict(name, ranked, chosen, discrepancy))


def _candidate(problem: Problem, best: Solution, W: Array, covariance: Array, unrated: NoiseModel) -> Candidate:
    """A solution with its criterion and test of fit."""
    structure, parameters = problem.structure, problem.alive(best)
    penalty = 2.0 * _optimism(problem, best, W, covariance)
    spare = problem.scale.size - parameters
    excess = max(best.objective - spare, 0.0)
    error = math.sqrt(2.0 * max(spare, 0) + 4.0 * excess)
    p_value = float(scipy.special.chdtrc(spare, best.objective)) if spare > 0 else math.nan
    return Candidate(
        structure.model if structure.model.specified else unrated,
        parameters,
        best.objective,
        Criterion(best.objective + penalty, error, penalty),
        p_value,
        parameters < structure.free_parameters,
        problem.model(best),
    )


def _fit_of(
    chosen: Candidate, curve: WaveletVariance, missed: Array, efficiency: float, unit: str, name: str
) -> FitResult:
    """The fit of the chosen model, weighed by its own covariance and by what every candidate misses, renewed once."""
    if not missed.any():
        return fit_curve(curve, chosen.structure, weighting="asymptotic", unit=unit, name=name, efficiency=efficiency)
    at = chosen.model
    for _ in range(2):
        own = covariance_of_curve(at, curve) / efficiency
        own = own + np.diag(missed**2)
        result = fit_curve(
            curve, chosen.structure, weighting=Weights(covariance=own), unit=unit, name=name, efficiency=efficiency
        )
        at = result.model
    return result


def _discrepancy(solved: list[tuple[Problem, Solution]], covariance: Array) -> float:
    """Relative error per scale that makes the nearest candidate as distant as its degrees of freedom (method of moments); 0 where it fits.

    A real record has something that no candidate has (rounding, an averaging filter, temperature). Its short scales are so precise that
    this small misfit would outweigh everything at the long ones; taken as one more error per scale, it does not.
    """
    problem, best = min(solved, key=lambda item: item[1].objective)
    spare = max(problem.scale.size - problem.alive(best), 1)
    if scipy.special.chdtrc(spare, best.objective) >= CHANCE:  # a fit blurred by a misfit that is none predicts worse
        return 0.0
    size = np.diag(problem.fitted(best) ** 2)
    starts = np.vstack([best.shapes[None, :], problem.structure.starts(problem.n, 200)])

    def excess(error: float) -> float:
        W = root_of_inverse(covariance + error**2 * size)
        return problem.search(W, starts, refined=3).objective - spare

    low, high = 1e-5, 1.0
    for _ in range(14):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high


def _reference_covariance(
    curve: WaveletVariance, references: Iterable[NoiseModel], efficiency: float
) -> tuple[Array, Array, Array]:
    """Covariance of the curve under the best of the reference models, the degrees of freedom per scale, and that model's curve."""
    n, dt = curve.n_samples, 1.0 / curve.rate_hz
    W = np.diag(1.0 / interval_widths(curve))
    best: tuple[float, NoiseModel] | None = None
    for reference in references:
        problem = Problem(Structure.of(reference, curve.rate_hz), curve.scale_samples, curve.value, n)
        found = problem.search(W, problem.structure.starts(n, 400), refined=4)
        if best is None or found.objective < best[0]:
            best = found.objective, problem.model(found)
    assert best is not None
    V = covariance_of_curve(best[1], curve) / efficiency
    fitted = best[1].wavelet_variance(curve.scale_samples, dt)
    return V, 2.0 * fitted**2 / np.diag(V), fitted


def _optimism(problem: Problem, best: Solution, W: Array, V: Array) -> float:
    """``tr(cov(curve, fitted) Omega)``: what the fit owes to having seen the curve."""
    D, _ = natural_jacobian(problem.model(best), problem.structure, problem.scale / 2.0)
    A = W @ D
    norm = np.linalg.norm(A, axis=0)
    A = A[:, norm > 0] / norm[norm > 0]
    if A.shape[1] == 0:
        return 0.0
    # B D with B = pinv(A) W: the trace of W D B V W'
    H = A @ np.linalg.pinv(A, rcond=1e-9)
    return float(np.trace(H @ W @ V @ W.T))


class _Under:
    """Candidates in the weights of one of them: the covariance of the curve if that candidate is true, and what every candidate misses."""

    def __init__(self, curve: WaveletVariance, use: NDArray[np.bool_], missed: Array, efficiency: float) -> None:
        self.curve, self.use, self.missed, self.efficiency = curve, use, missed, efficiency
        self._found: dict[int, tuple[Array, Array]] = {}

    def _weights(self, c: Candidate) -> tuple[Array, Array]:
        """Covariance of the whole curve, and the root of the weights of the scales in use."""
        if id(c) not in self._found:
            own = covariance_of_curve(c.model, self.curve) / self.efficiency + np.diag(self.missed**2)
            self._found[id(c)] = own, root_of_inverse(own[np.ix_(self.use, self.use)])
        return self._found[id(c)]

    def _nearest(self, c: Candidate, W: Array) -> tuple[Problem, Solution]:
        structure, n = Structure.of(c.structure, self.curve.rate_hz), self.curve.n_samples
        whole = Problem(structure, self.curve.scale_samples, self.curve.value, n)
        at, used = structure.internal(c.model)[1], whole.rows(self.use)
        starts = np.vstack([at[None, :], structure.starts(n, 200)])
        near, wide = used.search(W, at[None, :]), used.search(W, starts, refined=3)
        return whole, min((near, wide), key=lambda solution: solution.objective)

    def gain(self, simple: Candidate, rich: Candidate) -> float:
        """How much nearer the richer model is than the simpler one if the simpler one is true.

        The variance of a scale is close to a multiple of a chi-square, whose cube root is nearly normal (Wilson and Hilferty 1931). Distances
        of cube roots therefore keep their nominal distribution where a scale has ten degrees of freedom, too.
        """
        W = self._weights(simple)[1]
        m, f = (problem.fitted(at)[self.use] for problem, at in (self._nearest(simple, W), self._nearest(rich, W)))
        root = np.cbrt(self.curve.value[self.use] / m)
        far, near = W @ (3.0 * m * (root - 1.0)), W @ (3.0 * m * (root - np.cbrt(f / m)))
        return float(far @ far - near @ near)

    def accepted(self, c: Candidate) -> bool:
        """Whether the candidate's own test of fit holds at the level of chance."""
        own, W = self._weights(c)
        test = goodness_of_fit(*self._nearest(c, W), own)
        return test is None or test.p_value >= CHANCE


def _choose(ranked: list[Candidate], under: _Under, chance: float) -> Candidate:
    """The simplest candidate that its own test of fit accepts and that no richer one beats by more than chance.

    A defeat is weighed as if the simpler model were true: the difference then has its nominal distribution. In weights of a richer model
    a slow part that fills the last scales alone is lost, for it makes these scales uncertain itself.
    """
    whole = [c for c in ranked if not c.vanished] or ranked
    nearest: dict[int, Candidate] = {}
    for c in whole:
        if c.parameters not in nearest or c.objective < nearest[c.parameters].objective:
            nearest[c.parameters] = c
    first = None
    for size, c in sorted(nearest.items()):
        richer = [(more - size, rich) for more, rich in sorted(nearest.items()) if more > size]
        if any(under.gain(c, rich) > scipy.special.chdtri(more, chance) for more, rich in richer):
            continue
        if under.accepted(c):
            return c
        first = first or c
    return first or min(whole, key=lambda c: c.criterion.value)


def _verdict(name: str, ranked: list[Candidate], chosen: Candidate, discrepancy: float) -> str:
    first = next((c for c in ranked if not c.vanished), ranked[0])
    text = f"{name}: {chosen.structure}"
    if chosen is first:
        text += " has the best criterion and is the simplest that no richer model beats"
    else:
        gap = first.objective - chosen.objective
        text += (
            f" is the simplest that no richer model beats by more than chance; {first.structure} has the best criterion, but its "
            f"{first.parameters - chosen.parameters:+d} parameter(s) gain only {-gap:.1f} in distance"
        )
    if discrepancy > 0:
        text += (
            f". No candidate follows the curve within its scatter; what is missing is about {discrepancy:.1%} per scale and was counted as an "
            "error of every candidate: expect structure that these processes do not have (rounding to an LSB, an averaging filter, "
            "a line in the spectrum, temperature)"
        )
    return text + "."


def wic(result: FitResult, *, bootstrap: int = 0, rng: np.random.Generator | None = None) -> Criterion:
    """Wavelet information criterion of a fit in its own weights.

    Parameters
    ----------
    result : FitResult
        Of method ``gmwm``.
    bootstrap : int
        Replicates of the parametric bootstrap for the optimism; 0 takes its asymptotic form.
    rng : Generator, optional
        Needed with ``bootstrap``.

    Returns
    -------
    Criterion
        ``distance + 2 tr(cov(curve, fitted) Omega)`` and its standard error: scatter of the distance (and, with the bootstrap, of the
        estimated optimism).

    Raises
    ------
    InputError
        Another method, or a bootstrap without rng.
    """
    if result.method != "gmwm":
        raise InputError(f"the wavelet information criterion belongs to gmwm fits, not to '{result.method}'")
    W, V, D = result.details["W"], result.details["curve_covariance"], result.details["jacobian"]
    alive = np.linalg.norm(D, axis=0) > 0
    A = W @ D[:, alive]
    norm = np.linalg.norm(A, axis=0)
    H = (A / norm) @ np.linalg.pinv(A / norm, rcond=1e-9) if A.size else np.zeros((W.shape[0], W.shape[0]))
    S = W @ V @ W.T
    residual = S - H @ S - S @ H.T + H @ S @ H.T
    variance = 2.0 * float(np.trace(residual @ residual)) + 4.0 * max(result.objective - float(np.trace(residual)), 0.0)
    if bootstrap == 0:
        optimism = float(np.trace(H @ S))
        return Criterion(result.objective + 2.0 * optimism, math.sqrt(variance), 2.0 * optimism)
    if rng is None:
        raise InputError("the bootstrap draws random numbers; give rng")
    from insemu.fit.gmwm import bootstrap_curves

    scale = result.details["scales"]
    assert result.curve is not None
    curves = bootstrap_curves(result.model, scale, bootstrap, rng, result.curve)
    fitted = np.array([refit(result, c).model.wavelet_variance(scale, result.dt) for c in curves])
    products = ((curves - curves.mean(axis=0)) @ W.T * ((fitted - fitted.mean(axis=0)) @ W.T)).sum(axis=1)
    optimism = float(products.sum() / (bootstrap - 1))
    variance += 4.0 * float(np.var(products)) / bootstrap
    return Criterion(result.objective + 2.0 * optimism, math.sqrt(variance), 2.0 * optimism)


def prediction_distance(
    model: NoiseModel,
    held_out: WaveletVariance,
    reference: NoiseModel | None = None,
    *,
    fit_covariance: Array | None = None,
) -> tuple[float, float]:
    """Mean squared deviation of a record not seen from a model's prediction, in standard deviations, and its standard error.

    Parameters
    ----------
    model : NoiseModel
        Predicts.
    held_out : WaveletVariance
        Of the record not seen.
    reference : NoiseModel, optional
        Whose standard deviations count (so that several predictions can be compared); by default the model's own.
    fit_covariance : (J, J) array, optional
        Covariance of the prediction at the held-out curve's scales, where the model was fitted to another record: the standard error then
        includes that scatter.

    Returns
    -------
    float, float
        1 is what a true model has. Only scales with at least :data:`RANK_DOF` degrees of freedom count. The standard error is that of a
        model without error: how much its distance scatters from one held-out record to the next (with ``fit_covariance``, and from one
        fitted record to the next).
    """
    dt = 1.0 / held_out.rate_hz
    measure = model if reference is None else reference
    V = covariance_of_curve(measure, held_out)
    use = 2.0 * measure.wavelet_variance(held_out.scale_samples, dt) ** 2 / np.diag(V) >= RANK_DOF
    sd = np.sqrt(np.diag(V)[use])
    z = (held_out.value[use] - model.wavelet_variance(held_out.scale_samples, dt)[use]) / sd
    C = V if fit_covariance is None else V + fit_covariance
    C = C[np.ix_(use, use)] / np.outer(sd, sd)
    return float(z @ z / z.size), math.sqrt(2.0 * float(np.sum(C * C))) / z.size


def select_axes(
    signals: Sequence[Series],
    general: NoiseModel,
    *,
    candidates: Sequence[NoiseModel] | None = None,
    robust: bool = False,
    workers: int = 1,
    pool: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Ranking]:
    """Select for several axes, axes and candidates in parallel.

    Parameters
    ----------
    signals : sequence of Series
    general : NoiseModel
    candidates : sequence of NoiseModel, optional
        Rank these instead of everything nested in ``general``.
    robust : bool
        Use the robust wavelet variance.
    workers : int
        Threads; the compiled search releases the interpreter.
    pool : Executor, optional
        For the candidates, instead of threads.
    progress : callable, optional
        Told the name of an axis that is finished.

    Returns
    -------
    dict
        Axis to ranking, in the order given.
    """

    def one(series: Series, executor: Executor) -> Ranking:
        if robust:
            # the richest candidate predicts the samples; the search knows no order among candidates
            richest = max(candidates or [general], key=lambda m: sum(len(p.parameters) for p in m))
            curve = cleaned_curve(series, richest).curve
        else:
            curve = wavelet_variance(series.values, series.rate_hz, gaps=series.gaps)
        options: dict[str, Any] = {"name": series.name, "unit": series.unit}
        if candidates is None:
            ranking = select(curve, general, executor=executor, **options)
        else:
            ranking = rank_models(curve, candidates, executor=executor, **options)
        if progress is not None:
            progress(series.name)
        return ranking

    # two pools: an axis waits for its candidates, and must not hold the place of one
    count = max(min(workers, len(signals)), 1)
    with ThreadPoolExecutor(max(workers, 1)) as inner, ThreadPoolExecutor(count) as outer:
        found = list(outer.map(lambda series: one(series, pool or inner), signals))
    return {series.name: ranking for series, ranking in zip(signals, found, strict=True)}


__all__ = ["Candidate", "Ranking", "nested", "prediction_distance", "rank_models", "select", "select_axes", "wic"]
