"""Indirect inference: the model's curve by simulation where there is no closed form, or where the finite record biases the estimate.

The signal's wavelet variance (plain or robust) is compared with that of signals drawn from the model and treated in the same way, so that
every bias of the treatment cancels (Stebler et al. 2014, section III-C, equation (29)). The draws use common random numbers: the same ones at every
trial of the parameters, which makes the simulated curve a smooth function of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.coordinates import Coordinates
from insemu.fit.gmwm import fit_curve, interval_widths, parameter_covariance, refit
from insemu.fit.result import FitResult, estimates
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.variance import WaveletVariance, robust_wavelet_variance, wavelet_variance

Array = NDArray[np.float64]
Simulate = Callable[[Array, int, float, np.random.Generator], Array]


@dataclass(frozen=True)
class Match:
    """Parameters whose simulated curve is nearest to the signal's.

    Parameters
    ----------
    theta : (p,) array
    covariance : (p, p) array
        Equation (22) with numerical derivatives; the simulation's own scatter is included (factor 1 + 1/replicates).
    curve, fitted : (J,) arrays
        Wavelet variance of the signal, and the simulated one.
    objective : float
    converged : bool
    """

    theta: Array
    covariance: Array
    curve: Array
    fitted: Array
    objective: float
    converged: bool


def match_curve(
    curve: WaveletVariance,
    simulate: Simulate,
    start: Sequence[float] | Array,
    *,
    rng: np.random.Generator,
    replicates: int = 10,
    treat: Callable[[Array, float], WaveletVariance] = wavelet_variance,
    step: float = 1e-3,
) -> Match:
    """Fit any model that can be simulated.

    Parameters
    ----------
    curve : WaveletVariance
        Of the signal, made by ``treat``.
    simulate : callable
        ``simulate(theta, n, dt, rng)`` returns a signal; it must draw the same numbers in the same order for every ``theta``.
    start : (p,) array
        Starting parameters; choose coordinates without bounds (logarithms of positive ones).
    rng : Generator
        Seeds the common random numbers.
    replicates : int
        Signals per trial.
    treat : callable
        From a signal and its rate to a curve.
    step : float
        Of the numerical derivatives, in the coordinates of ``start``.

    Raises
    ------
    InputError
        No replicate, or more parameters than scales.
    """
    theta0 = np.asarray(start, dtype=np.float64)
    if replicates < 1:
        raise InputError(f"replicates is {replicates}, expected at least 1")
    if theta0.size > len(curve):
        raise InputError(f"{theta0.size} parameters for {len(curve)} scales; expected at least as many scales")
    # whole numbers, not seed sequences: those remember how many children they had, and later trials would draw others
    seeds = [int(v) for v in rng.integers(2**63, size=replicates)]
    n, rate = curve.n_samples, curve.rate_hz
    width = interval_widths(curve)

    def curves(theta: Array) -> Array:
        drawn = [
            treat(simulate(theta, n, 1.0 / rate, np.random.default_rng(seed)), rate).value[: len(curve)]
            for seed in seeds
        ]
        return np.array(drawn)

    def residual(theta: Array) -> Array:
        return np.asarray((curve.value - curves(theta).mean(axis=0)) / width)

    def derivative(theta: Array) -> Array:
        ahead = [curves(theta + e).mean(axis=0) - curves(theta - e).mean(axis=0) for e in step * np.eye(theta.size)]
        return np.column_stack(ahead) / (2.0 * step)

    def jacobian(theta: Array) -> Array:
        return np.asarray(-derivative(theta) / width[:, None])

    found = scipy.optimize.least_squares(residual, theta0, jac=jacobian, x_scale="jac", max_nfev=60)
    drawn = curves(found.x)
    D = derivative(found.x)
    # scatter of a curve under the model: from more draws than the match needs
    extra = [int(v) for v in rng.integers(2**63, size=max(60, 3 * len(curve)))]
    scattered = np.array(
        [treat(simulate(found.x, n, 1.0 / rate, np.random.default_rng(s)), rate).value[: len(curve)] for s in extra]
    )
    V = np.cov(scattered, rowvar=False) * (1.0 + 1.0 / replicates)
    covariance, _ = parameter_covariance(D, np.diag(1.0 / width), V)
    return Match(found.x, covariance, curve.value, drawn.mean(axis=0), float(2.0 * found.cost), bool(found.success))


def fit_indirect(
    series: Series,
    model: NoiseModel,
    *,
    rng: np.random.Generator,
    replicates: int = 10,
    robust: bool = False,
    confidence: float = 0.95,
) -> FitResult:
    """Fit a noise model by indirect inference, from the analytic estimate.

    Parameters
    ----------
    series : Series
    model : NoiseModel
    rng : Generator
    replicates : int
        Signals per trial; their scatter adds 1/replicates to the covariance.
    robust : bool
        Compare robust curves.
    confidence : float
        Of the intervals.

    Raises
    ------
    InputError
        As :func:`insemu.fit.gmwm.fit_curve`.
    """
    model = model.at_rate(series.rate_hz)
    curve: WaveletVariance
    if robust:
        curve = robust_wavelet_variance(series.values, series.rate_hz)
    else:
        curve = wavelet_variance(series.values, series.rate_hz)
    begin = fit_curve(curve, model, unit=series.unit, name=series.name)
    coordinates = Coordinates.of(model, begin.model, math.sqrt(curve.value[0]), 1.0 / curve.rate_hz)

    def simulate(theta: Array, n: int, dt: float, child: np.random.Generator) -> Array:
        return coordinates.model(theta).simulate(n, dt, child)

    def plain(x: Array, rate: float) -> WaveletVariance:
        return wavelet_variance(x, rate, intervals="eta3")

    found = match_curve(
        curve,
        simulate,
        coordinates.start,
        rng=rng,
        replicates=replicates,
        treat=robust_wavelet_variance if robust else plain,
    )
    fitted = coordinates.model(found.theta)
    slope = coordinates.slopes(found.theta)
    covariance = found.covariance * np.outer(slope, slope)
    notes = list(begin.warnings)
    if not found.converged:
        notes.append("the search did not converge; treat the values as a start")
    return replace(
        begin,
        method="indirect",
        model=fitted,
        parameters=estimates(fitted, coordinates.free, covariance, series.unit, confidence),
        covariance=covariance,
        fitted=found.fitted,
        objective=found.objective,
        converged=found.converged,
        warnings=tuple(notes),
        test=None,
        details={"replicates": replicates, "start": begin.model, "free": coordinates.free},
    )


def check_bootstrap(method: str, replicates: int) -> None:
    """Raise ``InputError`` where :func:`bootstrap_intervals` cannot follow a fit; to be asked before the fit."""
    if method != "gmwm":
        raise InputError(f"bootstrap intervals belong to gmwm fits, not to '{method}'")
    if replicates < 20:
        raise InputError(f"replicates is {replicates}, expected at least 20")


def bootstrap_intervals(
    result: FitResult, replicates: int, rng: np.random.Generator, confidence: float = 0.95
) -> FitResult:
    """The same GMWM fit with intervals and standard errors by parametric bootstrap.

    Signals are drawn from the fitted model and fitted with the same weights; the intervals are basic ones on a logarithmic scale (the
    distribution of log(refitted / fitted) is turned around the estimate).

    Parameters
    ----------
    result : FitResult
        Of method ``gmwm``.
    replicates : int
    rng : Generator
    confidence : float

    Raises
    ------
    InputError
        Another method, fewer than 20 replicates.
    """
    from insemu.fit.gmwm import bootstrap_curves

    check_bootstrap(result.method, replicates)
    assert result.curve is not None
    scales = result.details["scales"]
    curves = bootstrap_curves(result.model, scales, replicates, rng, result.curve)
    drawn = np.array([_values(refit(result, c).model) for c in curves])
    tail = 0.5 * (1.0 - confidence)
    out = []
    for i, e in enumerate(result.parameters):
        if not e.free:
            out.append(e)
            continue
        column = drawn[:, i]
        error = float(np.std(column, ddof=1))
        if e.value > 0 and (column > 0).all():
            low, high = np.quantile(np.log(column / e.value), [tail, 1.0 - tail])
            out.append(replace(e, standard_error=error, low=e.value * math.exp(-high), high=e.value * math.exp(-low)))
        else:
            low, high = np.quantile(column - e.value, [tail, 1.0 - tail])
            floor = 0.0 if (column >= 0).all() else -math.inf
            out.append(replace(e, standard_error=error, low=max(e.value - high, floor), high=e.value - low))
    return replace(result, parameters=tuple(out), details={**result.details, "bootstrap": drawn})


def _values(model: NoiseModel) -> list[float]:
    return [v for p in model for v in p.parameters.values()]
