"""Deterministic regressors and the noise model of a signal, estimated together.

The coefficients are those of generalised least squares under the noise model, over differences of block means: differences of every process are
stationary, and slow regressors lose nothing in blocks. The noise model is fitted to the wavelet variance of the residual, from which the
regressors took what they could explain of the noise, too: by the orthogonality of least squares exactly the wavelet variance of ``X (b - E b)``,
whose expectation is added back. Model and coefficients take turns until both stay.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.gmwm import fit_curve
from insemu.fit.result import FitResult
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.variance import wavelet_variance

Array = NDArray[np.float64]

#: Most blocks: more make the exact covariance of their differences slow and tell nothing more of slow regressors.
BLOCKS = 1024
#: Most turns of coefficients and model, and the change of a coefficient in its standard errors at which they stay.
TURNS, STAYS = 6, 0.02
#: A regressor of which this part or less is left by the others cannot be distinguished from them.
LEAST_LEFT = 1e-6
#: Relative step of numerical derivatives by the parameters of the noise model, in their standard errors, and at most of the value.
STEP_ERROR, STEP_VALUE = 0.1, 0.05


@dataclass(frozen=True)
class Coefficient:
    """One regressor's coefficient.

    Parameters
    ----------
    name : str
        Of the regressor.
    value, standard_error : float
        SI of the signal per unit of the regressor.
    low, high : float
        Interval, Student's t with ``dof`` degrees of freedom.
    dof : float
        Of the variance of the coefficient, which is known as well as the noise model is.
    p_value : float
        Of a coefficient of zero.
    """

    name: str
    value: float
    standard_error: float
    low: float
    high: float
    dof: float
    p_value: float


@dataclass(frozen=True)
class RegressedFit:
    """A noise model and the coefficients of regressors next to it.

    Parameters
    ----------
    result : FitResult
        Of the noise; its curve is that of the residual with what the regressors took added back.
    coefficients : tuple of Coefficient
    covariance : (p, p) array
        Of the coefficients.
    residual, part : (n,) arrays
        Signal without its mean and the regressors, and what the regressors make up.
    taken : (J,) array
        Wavelet variance that the regressors take from the noise, expected, per scale of the curve.
    explained : float
        Part of the variance of the signal that the regressors make up.
    turns : int
    """

    result: FitResult
    coefficients: tuple[Coefficient, ...]
    covariance: Array
    residual: Array
    part: Array
    taken: Array
    explained: float
    turns: int

    def __getitem__(self, name: str) -> Coefficient:
        """The coefficient of a regressor."""
        return next(c for c in self.coefficients if c.name == name)

    def to_json(self) -> dict[str, Any]:
        """The stable machine-readable form."""
        rows = [
            {
                "name": c.name,
                "value": c.value,
                "standard_error": c.standard_error,
                "interval": [c.low, c.high],
                "p_value": c.p_value,
            }
            for c in self.coefficients
        ]
        return self.result.to_json() | {"regressors": rows, "explained": self.explained}


def fit_regressed(
    series: Series,
    regressors: Mapping[str, Array],
    model: NoiseModel,
    *,
    tau_from: float = 0.0,
    tau_to: float = math.inf,
    confidence: float = 0.95,
) -> RegressedFit:
    """Fit a noise model and the coefficients of regressors together.

    Parameters
    ----------
    series : Series
        Signal without missing samples.
    regressors : mapping of str to (n,) array
        What the signal follows, in any unit; offsets do not matter, the mean of the signal is left open.
    model : NoiseModel
        Structure.
    tau_from, tau_to : float
        Scales (s) to use for the noise model.
    confidence : float
        Level of the intervals.

    Raises
    ------
    InputError
        A regressor that is not finite, of another length, constant, or made up of the others; a process of one draw, which is itself a
        regressor; what a fit refuses.

    Notes
    -----
    With b by generalised least squares, Cov(b, w) = Cov(b) x for any linear functional w of the noise that is x on the regressors (Aitken 1935), so
    that the wavelet variance of the residual falls short by tr(Cov(b) S), S the mean product of the wavelet coefficients of the regressors.
    Intervals of b have the degrees of freedom of its estimated variance (Satterthwaite 1946).
    """
    series = series.complete("a fit with regressors")
    for p in model:
        if p.single_draw:
            raise InputError(
                f"{p} is a signal, not noise; write it as a regressor (a drift is 'time')", where=series.name
            )
    names = tuple(regressors)
    X, size = _columns(series, regressors)
    y = series.values - series.values.mean()
    blocks = _Blocks.of(y, X, series.rate_hz)
    options = {"tau_from": tau_from, "tau_to": tau_to, "confidence": confidence, "weighting": "asymptotic"}
    b, C = scipy.linalg.lstsq(X, y)[0], np.zeros((len(names),) * 2)
    curve = wavelet_variance(y - X @ b, series.rate_hz)
    found = fit_curve(curve, model, unit=series.unit, name=series.name, **options)  # type: ignore[arg-type]
    taken, turn = np.zeros(curve.value.size), 0
    for turn in range(1, TURNS + 1):
        before = b
        b, C = blocks.solved(found.model)
        curve = wavelet_variance(y - X @ b, series.rate_hz)
        taken = _taken(X, C, series.rate_hz, curve.value.size)
        whole = curve.value + taken
        part = whole / curve.value
        curve = replace(curve, value=whole, low=curve.low * part, high=curve.high * part)
        found = fit_curve(curve, model, unit=series.unit, name=series.name, **options)  # type: ignore[arg-type]
        if turn > 1 and np.all(np.abs(b - before) <= STAYS * np.sqrt(np.diag(C))):
            break
    b, C = blocks.solved(found.model)
    part = X @ b
    residual = y - part
    dof = _freedom(blocks, found, C)
    coefficients = tuple(
        _coefficient(name, float(v / s), float(math.sqrt(c) / s), float(d), confidence)
        for name, v, s, c, d in zip(names, b, size, np.diag(C), dof, strict=True)
    )
    explained = 1.0 - float(np.var(residual)) / max(float(np.var(y)), 1e-300)
    return RegressedFit(found, coefficients, C / np.outer(size, size), residual, part, taken, explained, turn)


def _coefficient(name: str, value: float, error: float, dof: float, confidence: float) -> Coefficient:
    half = float(scipy.special.stdtrit(dof, 0.5 + 0.5 * confidence)) * error
    p = 2.0 * float(scipy.special.stdtr(dof, -abs(value) / error))
    return Coefficient(name, value, error, value - half, value + half, dof, p)


def _columns(series: Series, regressors: Mapping[str, Array]) -> tuple[Array, Array]:
    """Regressors without their means and of unit size, (n, p), and the sizes."""
    if not regressors:
        raise InputError("no regressor, expected one or more", where=series.name)
    columns, sizes = [], []
    for name, x in regressors.items():
        v = np.asarray(x, dtype=np.float64)
        if v.shape != (len(series),):
            raise InputError(
                f"the regressor '{name}' has shape {v.shape}, expected ({len(series)},)", where=series.name
            )
        if not np.isfinite(v).all():
            at = int(np.argmin(np.isfinite(v)))
            raise InputError(
                f"the regressor '{name}' is {v[at]} at sample {at}, expected finite numbers", where=series.name
            )
        v = v - v.mean()
        size = float(np.sqrt(np.mean(v * v)))
        if size <= 1e-12 * max(float(np.abs(x).max()), 1e-300):
            raise InputError(f"the regressor '{name}' does not change, expected one that does", where=series.name)
        columns.append(v / size)
        sizes.append(size)
    X = np.column_stack(columns)
    for k, name in enumerate(regressors):
        others = np.delete(X, k, axis=1)
        left = X[:, k] - (others @ scipy.linalg.lstsq(others, X[:, k])[0] if others.shape[1] else 0.0)
        if float(np.mean(left * left)) < LEAST_LEFT:
            raise InputError(
                f"the regressor '{name}' is made up of the others ({', '.join(n for n in regressors if n != name)}); leave one out",
                where=series.name,
            )
    return X, np.array(sizes)


@dataclass(frozen=True)
class _Blocks:
    """Differences of block means of a signal and its regressors."""

    y: Array
    X: Array
    m: int
    dt: float

    @classmethod
    def of(cls, y: Array, X: Array, rate_hz: float) -> _Blocks:
        m = max(1, -(-y.size // BLOCKS))
        count = y.size // m
        both = np.column_stack([y, X])[y.size - count * m :]
        means = both.reshape(count, m, -1).mean(axis=1)
        step = np.diff(means, axis=0)
        return cls(step[:, 0], step[:, 1:], m, 1.0 / rate_hz)

    def solved(self, model: NoiseModel) -> tuple[Array, Array]:
        """Coefficients of generalised least squares and their covariance under a model."""
        row = model.difference_covariance(self.m, self.dt, self.y.size)
        try:
            L = scipy.linalg.cholesky(scipy.linalg.toeplitz(row), lower=True)
        except scipy.linalg.LinAlgError:
            raise InputError(
                f"the covariance of the model {model} over {self.y.size} differences is singular; add white noise to the model"
            ) from None
        both = scipy.linalg.solve_triangular(L, np.column_stack([self.y, self.X]), lower=True)
        Q, R = scipy.linalg.qr(both[:, 1:], mode="economic")
        root = scipy.linalg.solve_triangular(R, np.eye(R.shape[0]))
        return np.asarray(root @ (Q.T @ both[:, 0])), np.asarray(root @ root.T)


def _taken(X: Array, C: Array, rate_hz: float, scales: int) -> Array:
    """tr(C S) per scale: the wavelet variance of the regressors' part whose coefficients have the covariance C."""
    values, vectors = np.linalg.eigh(C)
    total = np.zeros(scales)
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 0.0:
            total += value * wavelet_variance(X @ vector, rate_hz, intervals="eta3", levels=scales).value
    return total


def _freedom(blocks: _Blocks, found: FitResult, C: Array) -> Array:
    """Satterthwaite's degrees of freedom of the coefficients' variances, from what the fit leaves open of the noise model."""
    free: Sequence[tuple[int, str]] = found.details["free"]
    known = np.nan_to_num(found.covariance, nan=0.0, posinf=0.0)
    slope = np.zeros((len(free), C.shape[0]))
    for i, (place, name) in enumerate(free):
        value = found.model.processes[place].parameters[name]
        step = min(STEP_ERROR * math.sqrt(max(float(known[i, i]), 0.0)), STEP_VALUE * abs(value))
        if step <= 0.0:
            continue
        parts = list(found.model.processes)
        parts[place] = parts[place].with_parameters({name: value - step})
        slope[i] = (np.log(np.diag(C)) - np.log(np.diag(blocks.solved(NoiseModel(tuple(parts)))[1]))) / step
    variance = np.maximum(np.einsum("ik,ij,jk->k", slope, known, slope), 1e-12)
    return np.asarray(np.maximum(2.0 / variance, 1.0))
