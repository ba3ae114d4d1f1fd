"""Does a filter know its own error? NEES, NIS, whiteness and credibility, each with bounds and a verdict in words.

Every test states its confidence. Where several are made together (epochs, states, components) the bounds are those of the family:
Bonferroni's ``1 - (1 - confidence) / count`` each, so that a consistent filter passes all of them with the stated probability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.augment import Augmentation
from insemu.emulate import TrueStates
from insemu.errors import InputError
from insemu.evaluate.verdict import MEAN_SQUARE, Expected, Verdict, Word, judged
from insemu.filters import FilterResult, FixTable

Array = NDArray[np.float64]


def nees(errors: ArrayLike, covariance: ArrayLike) -> Array:
    """Normalised estimation error squared ``e' P^-1 e``.

    Parameters
    ----------
    errors : (..., k) array_like
        Estimate minus truth.
    covariance : (..., k, k) array_like
        What the filter says about them.

    Returns
    -------
    (...) array
        Chi-square with k degrees of freedom where the filter is right.

    Raises
    ------
    InputError
        Shapes that do not match, or a covariance that cannot be inverted.
    """
    e, P = np.asarray(errors, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    if P.shape[-2:] != (e.shape[-1],) * 2:
        raise InputError(f"errors have shape {e.shape} and covariances {P.shape}, expected (..., k) and (..., k, k)")
    sd = np.sqrt(np.einsum("...ii->...i", P))
    if not (sd > 0).all():
        raise InputError("a variance is not positive; leave states without uncertainty out of the NEES")
    scaled = e / sd
    correlation = P / (sd[..., :, None] * sd[..., None, :])
    try:
        return np.asarray(np.einsum("...i,...i->...", scaled, np.linalg.solve(correlation, scaled[..., None])[..., 0]))
    except np.linalg.LinAlgError:
        raise InputError("a covariance is singular; leave fully correlated states out of the NEES") from None


#: Eigenvalue of a correlation matrix up to which states are one.
SINGULAR = 1e-9
#: Groups of states that are judged together in every experiment: :func:`block_nees`.
BLOCKS = ("position", "velocity", "attitude", "gyro", "accel", "imu_states")


def nees_per_dof(errors: Array, covariance: Array, *, full: bool = False) -> Array:
    """NEES (n,) per degree of freedom of errors (n, k); NaN where an error is not known.

    States without uncertainty are left out, and what fully correlated states (of a shared process) have in common counts once; with ``full``,
    whose caller counts every state, the value is NaN there.

    Parameters
    ----------
    errors : (n, k) array
    covariance : (n, k, k) array
    full : bool
        Whether fully correlated states are refused.
    """
    out = np.full(len(errors), np.nan)
    variance = np.einsum("nii->ni", covariance)
    known = np.isfinite(errors).all(axis=1) & np.isfinite(variance).all(axis=1)
    live = variance > 0.0
    while known.any():
        pattern = live[np.argmax(known)]
        rows = known & (live == pattern).all(axis=1)
        known &= ~rows
        if not pattern.any():
            continue
        whole = rows.all() and pattern.all()  # nothing is left out, and nothing copied
        e, P = (
            (errors, covariance) if whole else (errors[rows][:, pattern], covariance[rows][:, pattern][:, :, pattern])
        )
        sd = np.sqrt(np.einsum("nii->ni", P))
        ends = P[[0, -1]] / (sd[[0, -1], :, None] * sd[[0, -1], None, :])
        alike = np.linalg.eigvalsh(ends)[:, 0] > SINGULAR
        if alike[0] == alike[1]:
            regular = alike[:1].repeat(len(e))
        else:  # what is one at the start and parts later is looked at epoch by epoch
            regular = np.linalg.eigvalsh(P / (sd[:, :, None] * sd[:, None, :]))[:, 0] > SINGULAR
        found = np.full(len(e), np.nan)
        if regular.all():
            found = nees(e, P) / pattern.sum()
        elif regular.any():
            found[regular] = nees(e[regular], P[regular]) / pattern.sum()
        if not full and not regular.all():
            e, P, sd = (x[~regular] for x in (e, P, sd))
            values, vectors = np.linalg.eigh(P / (sd[:, :, None] * sd[:, None, :]))
            free = values > SINGULAR
            seen = np.einsum("nij,ni->nj", vectors, e / sd) ** 2
            found[~regular] = np.where(free, seen / np.where(free, values, 1.0), 0.0).sum(axis=1) / free.sum(axis=1)
        out[rows] = found
    return out


@dataclass(frozen=True)
class SensorErrors:
    """Errors of what a filter says about its sensors.

    Parameters
    ----------
    axes, axes_covariance : (k, 6), (k, 6, 6) arrays
        Estimated minus true error of every axis apart from white noise (calibration states count at the rate and specific force
        measured then), rad/s and m/s^2, and what the filter says about it: ``C P C'``.
    states : (k, m) array
        The augmented states one by one; NaN where truth and belief do not have the same.
    """

    axes: Array
    axes_covariance: Array
    states: Array


def sensor_errors(
    result: FilterResult,
    augmentation: Augmentation,
    rows: NDArray[np.intp],
    covariance: Array,
    measured: Array,
    true: TrueStates | None,
) -> SensorErrors:
    """Compare a filter's augmented states with the true ones.

    The total error of an axis can be compared whatever truth and belief carry; single states only where both have the same.

    Parameters
    ----------
    result : FilterResult
    augmentation : Augmentation
        Of the filter.
    rows : (k,) array of int
        Rows of the result.
    covariance : (k, n, n) array
        At these rows.
    measured : (k, 6) or (k, 12) array
        Rows of what the filter senses there (:meth:`insemu.augment.Augmentation.sensed`), rates.
    true : TrueStates or None
        None: not known.
    """
    estimate = result.imu_states[rows]
    C = augmentation.output(measured)  # of every row where calibration states are carried, one for all elsewhere
    spread = C @ covariance[:, 9:, 9:] @ np.swapaxes(C, -1, -2)
    axes = np.full((len(rows), 6), np.nan)
    if true is not None:
        axes = (C @ estimate[:, :, None])[:, :, 0] - true.axes
    states = np.full(estimate.shape, np.nan)
    if true is not None and true.states is not None and augmentation.layout.names[9:] == true.names:
        states = estimate - true.states
    return SensorErrors(axes, spread, states)


def block_nees(errors: Array, covariance: Array, sensors: SensorErrors | None = None) -> Array:
    """NEES per degree of freedom of every block of :data:`BLOCKS`, (blocks, k).

    Parameters
    ----------
    errors : (k, 9) array
        Navigation errors.
    covariance : (k, n, n) array
        Of the whole filter.
    sensors : SensorErrors, optional
        Without them the last three blocks are NaN. So is that of a triad whose axes are fully correlated.
    """
    out = np.full((len(BLOCKS), len(errors)), np.nan)
    for i in range(3):
        s = slice(3 * i, 3 * i + 3)
        out[i] = nees_per_dof(errors[:, s], covariance[:, s, s])
    if sensors is not None:
        for i in (0, 1):
            s = slice(3 * i, 3 * i + 3)
            out[3 + i] = nees_per_dof(sensors.axes[:, s], sensors.axes_covariance[:, s, s], full=True)
        out[5] = nees_per_dof(sensors.states, covariance[:, 9:, 9:])
    return out


def chi_square_bounds(tail: float, dof: int) -> tuple[float, float]:
    """Values of a chi-square variable with this probability below the first and above the second."""
    return 2.0 * float(scipy.special.gammaincinv(0.5 * dof, tail)), float(scipy.special.chdtri(dof, tail))


def smallest_found(bounds: tuple[float, float], dof: int, power: float) -> tuple[float, float]:
    """Smallest share by which standard deviations are too small, and too large, that a chi-square test finds with a probability.

    Stated variances of ``c`` times the actual ones divide the statistic by ``c``, so both are exact quantiles. A value that differs by less
    than :data:`~insemu.evaluate.verdict.MEAN_SQUARE` is not found.

    Parameters
    ----------
    bounds : (low, high)
        Of the statistic per degree of freedom.
    dof : int
    power : float
    """
    few, many = (x / dof for x in chi_square_bounds(1.0 - power, dof))
    low, high = min(bounds[0], 1.0 - MEAN_SQUARE), max(bounds[1], 1.0 + MEAN_SQUARE)
    return 1.0 - math.sqrt(few / high), (math.sqrt(many / low) - 1.0 if low > 0.0 else math.inf)


def nees_test(
    values: ArrayLike,
    dof: int,
    *,
    subject: str = "navigation",
    at: Sequence[float] | None = None,
    confidence: float = 0.99,
) -> list[Verdict]:
    """Mean NEES over independent runs against its chi-square bounds, epoch by epoch.

    Parameters
    ----------
    values : (runs, epochs) array_like
        From :func:`nees`.
    dof : int
        States behind each value.
    subject : str
    at : sequence of float, optional
        Epochs in s, for the text.
    confidence : float
        Of all epochs together.

    Returns
    -------
    list of Verdict
        One per epoch; values per degree of freedom.
    """
    v = np.atleast_2d(np.asarray(values, dtype=np.float64))
    return nees_verdicts(v.mean(axis=0), len(v), dof, subject=subject, at=at, confidence=confidence)


def nees_verdicts(
    means: ArrayLike,
    runs: int,
    dof: int,
    *,
    subject: str = "navigation",
    at: Sequence[float] | None = None,
    confidence: float = 0.99,
) -> list[Verdict]:
    """As :func:`nees_test`, of means that were taken before.

    Parameters
    ----------
    means : (epochs,) array_like
        Of the NEES over the runs.
    runs : int
    dof, subject, at, confidence
    """
    m = np.asarray(means, dtype=np.float64)
    tail = 0.5 * (1.0 - confidence) / m.size
    low, high = (x / (dof * runs) for x in chi_square_bounds(tail, dof * runs))
    out = []
    for k, mean in enumerate(m / dof):
        name = subject if at is None else f"{subject} at {at[k]:g} s"
        out.append(judged("NEES/dof", name, float(mean), (low, high), confidence, runs))
    return out


def nis_test(fixes: FixTable | Sequence[FixTable], *, confidence: float = 0.99) -> Verdict:
    """Pooled normalised innovation squared of all accepted fixes, per degree of freedom, against its chi-square bounds.

    A gate cuts the tail of the innovations and lowers the mean; a filter with a gate is judged by its :attr:`FixTable.rejected` too.
    """
    tables = [fixes] if isinstance(fixes, FixTable) else list(fixes)
    total = sum(float(t.nis[t.accepted].sum()) for t in tables)
    return nis_verdict(total, sum(int(t.dof[t.accepted].sum()) for t in tables), confidence=confidence)


def nis_verdict(total: float, dof: int, *, confidence: float = 0.99) -> Verdict:
    """A sum of normalised innovations squared with ``dof`` degrees of freedom, judged as in :func:`nis_test`.

    Parameters
    ----------
    total : float
    dof : int
    confidence : float
    """
    if dof == 0:
        raise InputError("no accepted fix: there is no innovation to judge")
    tail = 0.5 * (1.0 - confidence)
    low, high = (x / dof for x in chi_square_bounds(tail, dof))
    return judged("NIS/dof", "innovations", total / dof, (low, high), confidence, dof)


def normalised_innovations(fixes: FixTable) -> Array:
    """Innovations of the fixes with all their usual components, made white by the Cholesky factor of S: (fixes, components).

    Standard normal and independent, over components and over fixes, where the filter is right.
    """
    full = fixes.accepted & (fixes.dof == fixes.dof.max(initial=0))
    if not full.any():
        raise InputError("no accepted fix: there is no innovation to judge")
    used = np.isfinite(fixes.innovation[full]).all(axis=0)
    nu, S = fixes.innovation[full][:, used], fixes.S[full][:, used][:, :, used]
    return np.asarray(np.linalg.solve(np.linalg.cholesky(S), nu[..., None])[..., 0])


def lag_products(fixes: FixTable, lags: int = 5) -> tuple[Array, Array]:
    """Sums of the products of normalised innovations at lags 1 to ``lags``, and how many products each has; sums of many runs add up."""
    y = normalised_innovations(fixes)
    products = [(y[lag:] * y[:-lag]).ravel() for lag in range(1, lags + 1)]
    return np.array([p.sum() for p in products]), np.array([float(p.size) for p in products])


def whiteness_verdicts(sums: ArrayLike, counts: ArrayLike, *, confidence: float = 0.99) -> list[Verdict]:
    """Sums of :func:`lag_products`, against the bounds of white ones.

    Parameters
    ----------
    sums, counts : (lags,) array_like
    confidence : float
        Of all lags together.
    """
    total, number = np.asarray(sums, dtype=np.float64), np.asarray(counts, dtype=np.float64)
    z = -scipy.special.ndtri(0.5 * (1.0 - confidence) / total.size)
    out = []
    coloured: Word = "correlated"
    for lag, (s, n) in enumerate(zip(total, number, strict=True), start=1):
        if n == 0:
            raise InputError(f"too few fixes for a lag of {lag}")
        value, bound = float(s / n), float(z / math.sqrt(n))
        name, white = f"innovations at lag {lag}", Expected(0.0, 0.0, (coloured, coloured))
        out.append(judged("whiteness", name, value, (-bound, bound), confidence, int(n), white))
    return out


def observability(sigma: ArrayLike, prior: ArrayLike) -> Array:
    """Share of each state's own variance that the fixes have removed, over time: 0 unobserved, 1 known.

    Parameters
    ----------
    sigma : (o, n) array_like
        What a filter states.
    prior : (o, n) array_like
        Standard deviations that the states would have without any fix: ``sigma`` of the same filter run with ``gnss=None``, or for the states
        of the sensors :func:`unaided_sigma`.

    Returns
    -------
    (o, n) array
        ``1 - sigma^2 / prior^2``; NaN for states without prior uncertainty.
    """
    s, p = np.asarray(sigma, dtype=np.float64), np.asarray(prior, dtype=np.float64)
    if p.shape != s.shape:
        raise InputError(f"the prior has shape {p.shape}, expected {s.shape} as the standard deviations")
    return np.asarray(1.0 - np.divide(s, p, out=np.full_like(p, np.nan), where=p > 0) ** 2)


def unaided_sigma(augmentation: Augmentation, epochs: NDArray[np.intp]) -> Array:
    """Standard deviations (k, m) that the augmented states would have after so many samples without any fix; ``epochs`` (k,) increase."""
    P, out = augmentation.P0.copy(), np.empty((len(epochs), augmentation.m))
    powers: dict[int, tuple[Array, Array]] = {}
    before = 0
    for k, epoch in enumerate(epochs):
        count, before = int(epoch) - before, int(epoch)
        if count not in powers:
            powers[count] = augmentation.power(count)
        Phi, Q = powers[count]
        P = Phi @ P @ Phi.T + Q
        out[k] = np.sqrt(np.diag(P))
    return out
