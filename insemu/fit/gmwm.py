"""The generalized method of wavelet moments: a model whose wavelet variance is nearest to the signal's (Stebler et al. 2014, Balamuta et al. 2016).

The distance is quadratic. Weights are the inverse squared widths of the curve's intervals (which do not need a model), or the inverse of
the curve's covariance under the model, in closed form or by parametric bootstrap, in further steps. By default the second where the record
is long enough to check the model and the model passes, the first elsewhere.

The minimum is searched for in :mod:`insemu.fit.minimum`; no start needs to be given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.fit.covariance import covariance_of_curve
from insemu.fit.identifiability import warnings_of
from insemu.fit.minimum import Problem, Solution, root_of_inverse
from insemu.fit.result import FitResult, GoodnessOfFit, estimates
from insemu.fit.structure import Structure, natural_jacobian
from insemu.noise import NoiseModel
from insemu.variance import (
    RobustWaveletVariance,
    WaveletVariance,
    chi_square_interval,
    eta3,
    expected_variance,
    modwt_filters,
    wavelet_variance,
)

Array = NDArray[np.float64]
Weighting = Literal["auto", "intervals", "asymptotic", "bootstrap"]

#: A scale enters the test of fit where its wavelet variance has at least this many degrees of freedom under the model.
TEST_DOF = 40.0
#: ``auto`` weighs by the covariance under the model for records of more samples than this: shorter ones hardly test a model, ...
LONG_RECORD = 1 << 16
#: ... and while the test of fit does not reject it at this level.
HOLDS = 1e-3


def interval_widths(curve: WaveletVariance) -> Array:
    """Widths of the 95 % chi-square intervals with the degrees of freedom of an ideal band-pass, the customary weights of the GMWM."""
    length = modwt_filters(curve.filter)[0].size
    freedom = eta3(curve.scale_samples.astype(float), curve.n_samples, length)
    if curve.inflation is not None:
        freedom = np.maximum(freedom / curve.inflation, 1.0)
    low, high = chi_square_interval(curve.value, freedom, 0.95)
    return np.asarray(high - low)


@dataclass(frozen=True)
class Weights:
    """How a fit weighs the scales of a curve.

    Parameters
    ----------
    kind : {"auto", "intervals", "asymptotic", "bootstrap"}
        Squared inverse interval widths; the inverse covariance under the model, in closed form; the same by parametric bootstrap. ``auto``
        is ``asymptotic`` for curves without outliers of more than :data:`LONG_RECORD` samples whose model is not rejected by its test of fit
        (p >= :data:`HOLDS`), and ``intervals`` otherwise. Interval weights follow the scatter of the curve itself, so a scale that came out
        low counts more: parameters that rest on few degrees of freedom are pulled down by up to a third of their standard error.
        ``asymptotic`` estimates are corrected for :func:`finite_record_bias`; the objective stays that of the minimum.
    widths : (J,) array, optional
        Interval widths to weigh by, instead of ``kind``.
    covariance : (J, J) array, optional
        Covariance whose inverse weighs, instead of ``kind``; standard errors and the test of fit follow from it, too.
    steps : int
        How many times the covariance under the model is renewed.
    replicates : int
        Of the bootstrap.
    rng : Generator, optional
        Needed for the bootstrap.
    """

    kind: Weighting = "auto"
    widths: ArrayLike | None = None
    covariance: ArrayLike | None = None
    steps: int = 2
    replicates: int = 200
    rng: np.random.Generator | None = None

    @property
    def given(self) -> bool:
        """Whether they do not depend on the model."""
        return self.widths is not None or self.covariance is not None


def fit_curve(
    curve: WaveletVariance,
    model: NoiseModel,
    *,
    weighting: Weighting | Weights = "auto",
    start: NoiseModel | None = None,
    tau_from: float = 0.0,
    tau_to: float = math.inf,
    efficiency: float = 1.0,
    confidence: float = 0.95,
    unit: str = "",
    name: str = "signal",
) -> FitResult:
    """Fit a model to a wavelet variance.

    Parameters
    ----------
    curve : WaveletVariance
        MODWT curve of any filter; others than Haar are integrals of the spectrum, and some hundred times slower to search.
    model : NoiseModel
        Structure; parameters that have a value are held.
    weighting : str or Weights
        See :class:`Weights`.
    start : NoiseModel, optional
        Where to begin instead of searching.
    tau_from, tau_to : float
        Scales (s) to use.
    efficiency : float
        Asymptotic efficiency of a robust curve: its covariance is larger by the inverse.
    confidence : float
        Level of the intervals.
    unit, name : str
        Of the signal.

    Raises
    ------
    InputError
        A decimated curve, one that has zeros or fewer scales than one per free parameter; bad options.

    Notes
    -----
    Equations (20), (22)-(27) and (34) of Stebler et al. 2014. The covariance of the curve is that of the fitted model over the finite record.
    """
    weights = weighting if isinstance(weighting, Weights) else Weights(weighting)
    kind = weights.kind
    if kind not in get_args(Weighting):
        raise InputError(f"weighting is '{kind}', expected one of: {', '.join(get_args(Weighting))}")
    problem = _problem(curve, model, tau_from, tau_to, efficiency, name)
    structure, scale = problem.structure, problem.scale
    W = _given_weights(problem, weights)
    starts = structure.internal(start)[1][None, :] if start is not None else structure.starts(problem.n)
    best = problem.search(W, starts)
    used: str = "given" if weights.given else "intervals"
    under: _Weighed | None = None
    rejecting = isinstance(curve, RobustWaveletVariance) and curve.contaminated
    if not weights.given and (
        kind in ("asymptotic", "bootstrap") or (kind == "auto" and problem.n > LONG_RECORD and not rejecting)
    ):
        under = _weighed_by_the_model(problem, best, None if start is not None else starts, weights)
        if kind == "auto" and (under.test is None or under.test.p_value < HOLDS):
            under = None
    if under is not None:
        best, W, V, test = under.best, under.W, under.V, under.test
        used = "asymptotic" if kind == "auto" else kind
    else:
        # a given covariance is what the curve is known by, and what the model is tested by
        V = problem.covariance(best) if weights.covariance is None else problem.part(weights.covariance)
        test = goodness_of_fit(problem, best, V)
    fitted_model = problem.model(best)
    D, free = natural_jacobian(fitted_model, structure, scale / 2.0)
    covariance_of, weak = parameter_covariance(D, W, V)
    if used == "asymptotic":
        correction = finite_record_bias(problem, best, free, covariance_of, W, V)
        if correction.any():
            fitted_model = _moved(fitted_model, free, -correction)
            coefficients, shapes = structure.internal(fitted_model)
            best = replace(best, coefficients=coefficients, shapes=shapes)
    return FitResult(
        name=name,
        method="gmwm",
        structure=model,
        model=fitted_model,
        rate_hz=curve.rate_hz,
        n_samples=problem.n,
        unit=unit,
        parameters=estimates(fitted_model, free, covariance_of, unit, confidence),
        covariance=covariance_of,
        curve=curve,
        fitted=expected_variance(fitted_model, curve.filter, curve.scale_samples, structure.dt),
        objective=best.objective,
        converged=best.converged,
        warnings=_notes(problem, best, fitted_model, free, covariance_of),
        test=test,
        details={
            "weighting": used,
            "free": free,
            "W": W,
            "curve_covariance": V,
            "scales": scale,
            "jacobian": D,
            "robust_efficiency": efficiency,
            "weak": weak,
        },
    )


@dataclass(frozen=True)
class _Problem(Problem):
    """The scales of a curve that are used, and the structure that is fitted to them."""

    curve: WaveletVariance
    use: NDArray[np.bool_]
    efficiency: float

    def part(self, covariance: ArrayLike) -> Array:
        """The covariance of the scales that are used."""
        return np.asarray(covariance, dtype=np.float64)[np.ix_(self.use, self.use)]

    def covariance(self, at: Solution, replicates: int = 0, rng: np.random.Generator | None = None) -> Array:
        """Covariance of the curve under a solution: closed form, or of so many draws."""
        model = self.model(at)
        if not replicates:
            return covariance_of_curve(model, self.curve, self.scale) / self.efficiency
        if rng is None:
            raise InputError("weighting by bootstrap draws random numbers; give rng")
        drawn = bootstrap_curves(model, self.scale, replicates, rng, self.curve)
        return np.asarray(np.cov(drawn, rowvar=False)).reshape(self.scale.size, self.scale.size) / self.efficiency


def _problem(
    curve: WaveletVariance, model: NoiseModel, tau_from: float, tau_to: float, efficiency: float, name: str
) -> _Problem:
    """What is fitted to what; raises ``InputError`` where a curve or a structure cannot be."""
    structure = Structure.of(model, curve.rate_hz, curve.filter)
    use = (curve.tau_s >= tau_from * (1 - 1e-9)) & (curve.tau_s <= tau_to * (1 + 1e-9))
    use &= curve.scale_samples <= curve.n_samples
    value, p = curve.value[use], structure.free_parameters
    if not (value > 0).all():
        raise InputError(
            f"{name}: the wavelet variance is zero at {curve.tau_s[use][value <= 0][0]:g} s; a constant signal has no noise to fit"
        )
    if value.size < max(p, 1):
        raise InputError(
            f"{name}: {model} has {p} free parameters and the curve {value.size} scale(s); expected at least as many scales"
        )
    return _Problem(structure, curve.scale_samples[use], value, curve.n_samples, curve, use, efficiency)


def _given_weights(problem: _Problem, weights: Weights) -> Array:
    """Root of the weights of the first search: of a covariance, or of interval widths."""
    if weights.covariance is not None:
        return root_of_inverse(problem.part(weights.covariance))
    width = interval_widths(problem.curve) if weights.widths is None else np.asarray(weights.widths, dtype=np.float64)
    if width.shape != problem.curve.value.shape or not (width[problem.use] > 0).all():
        raise InputError(
            f"widths has shape {width.shape}, expected {problem.curve.value.size} positive numbers, one per scale"
        )
    return np.diag(1.0 / width[problem.use])


@dataclass(frozen=True)
class _Weighed:
    best: Solution
    W: Array
    V: Array
    test: GoodnessOfFit | None


def _weighed_by_the_model(problem: _Problem, first: Solution, starts: Array | None, weights: Weights) -> _Weighed:
    """The minimum under the covariance that the model itself gives, renewed so many times.

    ``starts`` are tried once more, because other weights may have their minimum elsewhere; once they are nearly right, it stays.
    """
    best, rows = first, np.zeros((0, 0))
    replicates = weights.replicates if weights.kind == "bootstrap" else 0
    for step in range(max(weights.steps, 1)):
        rows = root_of_inverse(problem.covariance(best, replicates, weights.rng))
        near = problem.search(rows, best.shapes[None, :])
        if step == 0 and starts is not None:
            other = problem.search(rows, starts, refined=3, flattened=False)
            near = other if other.objective < near.objective else near
        best = near
    V = problem.covariance(best)
    return _Weighed(best, rows, V, goodness_of_fit(problem, best, V))


def _notes(
    problem: _Problem, best: Solution, model: NoiseModel, free: list[tuple[int, str]], covariance: Array
) -> tuple[str, ...]:
    value = problem.value
    notes = warnings_of(problem, best, model, free, covariance)
    if value.size == problem.structure.free_parameters:
        notes.append(f"as many parameters as scales ({value.size}): the fit cannot be tested")
    if not best.converged:
        notes.append("the search did not converge; treat the values as a start")
    return tuple(notes)


def finite_record_bias(
    problem: Problem, at: Solution, free: list[tuple[int, str]], covariance: Array, W: Array, V: Array
) -> Array:
    """Mean error of the estimates that comes from their curvature in the wavelet variances, to second order.

    Half the trace of each estimate's second derivatives by the curve times the curve's covariance, by central differences of one standard
    deviation along the covariance's principal directions, from the fitted curve. A correlation time of a hundredth of the record has a
    quarter of a standard deviation.

    Parameters
    ----------
    problem : Problem
    at : Solution
        The estimate.
    free : list of (process number, parameter name)
    covariance : (p, p) array
        Of the free parameters.
    W, V : arrays
        Root of the weights, covariance of the curve.

    Returns
    -------
    (p,) array
        Zero where the second order cannot be trusted: a part without variance, a standard error of half the value or more, sinusoids and
        moving averages. At most half a standard error.
    """
    nothing = np.zeros(len(free))
    model = problem.model(at)
    centre = _values(model, free)
    error = np.sqrt(np.diag(covariance))
    if (
        len(free) == 0
        or not np.isfinite(error).all()
        or (at.coefficients <= 0).any()
        or (error >= 0.5 * np.abs(centre)).any()
        or any(
            meta.domain not in ("rate", "correlation") for p in model for meta in p.parameters_meta() if not meta.power
        )
    ):
        return nothing
    fitted = problem.fitted(at)
    sd = np.sqrt(np.diag(V))
    size, directions = np.linalg.eigh(V / np.outer(sd, sd))
    steps = (directions * np.sqrt(np.maximum(size, 0.0))).T * sd
    start = at.shapes[None, :]
    mean = nothing.copy()
    for step in steps:
        for moved in (fitted + step, fitted - step):
            near = replace(problem, value=moved).search(W, start)
            mean += 0.5 * (_values(problem.model(near), free) - centre)
    limit = 0.5 * error
    return np.clip(mean, -limit, limit) if np.isfinite(mean).all() else nothing


def _values(model: NoiseModel, free: list[tuple[int, str]]) -> Array:
    return np.array([model.processes[k].parameters[name] for k, name in free])


def _moved(model: NoiseModel, free: list[tuple[int, str]], by: Array) -> NoiseModel:
    parts = list(model.processes)
    for (k, name), d in zip(free, by, strict=True):
        parts[k] = parts[k].with_parameters({name: parts[k].parameters[name] + float(d)})
    return NoiseModel(tuple(parts))


def bootstrap_curves(
    model: NoiseModel,
    scale: NDArray[np.int64],
    replicates: int,
    rng: np.random.Generator,
    like: WaveletVariance,
) -> Array:
    """Wavelet variances of signals drawn from a model.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    scale : (J,) array of int
        Scales 2^j in samples, ascending.
    replicates : int
    rng : Generator
    like : WaveletVariance
        Whose length, filter and missing samples the signals have.

    Returns
    -------
    (replicates, J) array
        unit^2.
    """
    keep = np.round(np.log2(scale)).astype(int) - 1
    out = np.empty((replicates, scale.size))
    for i, child in enumerate(rng.spawn(replicates)):
        out[i] = drawn_values(model, like, child)[keep]
    return out


def drawn_values(model: NoiseModel, like: WaveletVariance, rng: np.random.Generator) -> Array:
    """Wavelet variances of a signal drawn from a model.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    like : WaveletVariance
        Whose length, filter and missing samples the signal has.
    rng : Generator

    Returns
    -------
    (J,) array
        unit^2.
    """
    x = model.simulate(like.n_samples, 1.0 / like.rate_hz, rng)
    if like.lost is not None:
        x[like.lost] = np.nan
    given = {"filter": like.filter, "levels": len(like), "gaps": like.lost is not None}
    return wavelet_variance(x, like.rate_hz, intervals="eta3", **given).value  # type: ignore[arg-type]


def parameter_covariance(D: Array, W: Array, V: Array) -> tuple[Array, list[int]]:
    """Covariance of the free parameters, equations (22)-(26) of Stebler et al. 2014, and the parameters that the weights cannot determine.

    Parameters
    ----------
    D : (J, p) array
        Derivatives of the curve.
    W : (rows, J) array
        Root of the weights.
    V : (J, J) array
        Covariance of the curve.

    Returns
    -------
    (p, p) array, list of int
        Rows and columns of undetermined parameters are NaN.
    """
    p = D.shape[1]
    out = np.full((p, p), np.nan)
    A = W @ D
    norm = np.linalg.norm(A, axis=0)
    moving = np.flatnonzero(norm > 0)
    lost = [int(i) for i in range(p) if norm[i] == 0]
    if moving.size == 0:
        return out, lost
    scaled = A[:, moving] / norm[moving]
    _, values, right = np.linalg.svd(scaled, full_matrices=False)
    if values.size < moving.size or values[-1] < 1e-9 * values[0]:
        # parameters that take part in a direction that leaves the curve where it is
        null = right[values < 1e-9 * values[0]]
        involved = np.abs(null).max(axis=0) > 1e-3 if null.size else np.ones(moving.size, dtype=bool)
        lost += [int(i) for i in moving[involved]]
        moving = moving[~involved]
        if moving.size == 0:
            return out, lost
        scaled = A[:, moving] / norm[moving]
    B = np.linalg.pinv(scaled) @ W / norm[moving][:, None]
    out[np.ix_(moving, moving)] = B @ V @ B.T
    return out, lost


def goodness_of_fit(problem: Problem, at: Solution, V: Array) -> GoodnessOfFit | None:
    """The test of over-identifying restrictions (27) of Stebler et al. 2014, on scales with enough degrees of freedom.

    The covariance is the model's own at the estimate, and the statistic is taken at its minimum over those scales, so that its
    degrees of freedom are scales minus parameters. None where too few scales remain.

    Parameters
    ----------
    problem : Problem
    at : Solution
        The estimate.
    V : (J, J) array
        Covariance of the curve, unit^4.
    """
    enough = 2.0 * problem.fitted(at) ** 2 / np.diag(V) >= TEST_DOF
    dof = int(enough.sum()) - problem.alive(at)
    if dof < 1:
        return None
    W = root_of_inverse(V[np.ix_(enough, enough)])
    used = problem.rows(enough)
    best = used.search(W, at.shapes[None, :])
    tau = np.asarray(used.scale * problem.structure.dt, dtype=np.float64)
    return GoodnessOfFit(best.objective, dof, float(scipy.special.chdtrc(dof, best.objective)), tau)


def refit(result: FitResult, value: Array) -> FitResult:
    """The same problem and weights with another curve, from the found solution: what a bootstrap repeats."""
    assert result.curve is not None
    structure = Structure.of(result.structure, result.rate_hz, result.curve.filter)
    problem = Problem(structure, result.details["scales"], value, result.n_samples)
    best = problem.search(result.details["W"], structure.internal(result.model)[1][None, :])
    return replace(result, model=problem.model(best), objective=best.objective, converged=best.converged)
