"""Tests of many independent runs of one design together, and the share of errors inside the stated bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.evaluate.consistency import lag_products, nees, nees_test, nis_test, whiteness_verdicts
from insemu.evaluate.verdict import Expected, Verdict, judged
from insemu.filters import FixTable

Array = NDArray[np.float64]
#: Difference of a coverage from what is expected that moves no decision.
COVERAGE = 0.01


def whiteness_test(fixes: FixTable | Sequence[FixTable], *, lags: int = 5, confidence: float = 0.99) -> list[Verdict]:
    """Autocorrelation of the normalised innovations at lags 1 to ``lags`` fixes, pooled over components and runs.

    Products of independent standard normals have mean 0 and variance 1, so the mean of N of them lies within z / sqrt(N).

    Parameters
    ----------
    fixes : FixTable or a sequence of them
        One per run.
    lags : int
    confidence : float
        Of all lags together.
    """
    tables = [fixes] if isinstance(fixes, FixTable) else list(fixes)
    sums, counts = (sum(part) for part in zip(*(lag_products(t, lags) for t in tables), strict=True))
    return whiteness_verdicts(sums, counts, confidence=confidence)


def pooled_coverage(
    errors: ArrayLike, sigma: ArrayLike, *, factor: float = 3.0, confidence: float = 0.95, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Share of all epochs and states inside ``factor`` sigma, with a bootstrap interval over runs: ``(share, low, high)``.

    Parameters
    ----------
    errors, sigma : (runs, epochs, states) array_like
    factor : float
    confidence : float
        Of the interval.
    rng : numpy.random.Generator
    """
    share = (np.abs(np.asarray(errors)) <= factor * np.asarray(sigma)).mean(axis=(1, 2))
    means = share[rng.integers(0, share.size, (4000, share.size))].mean(axis=1)
    low, high = np.quantile(means, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    return float(share.mean()), float(low), float(high)


def coverage_test(
    errors: ArrayLike, sigma: ArrayLike, *, names: Sequence[str], factor: float = 3.0, confidence: float = 0.99
) -> list[Verdict]:
    """Share of errors inside ``factor`` sigma, state by state, against binomial bounds around the Gaussian share.

    Epochs of one run are correlated: as many samples count as would give the spread, over runs, of the share inside the errors' own rms.
    (Rare events at ``factor`` sigma are correlated no more than those.)

    Parameters
    ----------
    errors, sigma : (runs, epochs, states) array_like
    names : sequence of str
        One per state.
    factor : float
    confidence : float
        Of all states together.
    """
    from scipy.stats import binom

    e, s = np.asarray(errors, dtype=np.float64), np.asarray(sigma, dtype=np.float64)
    if e.ndim != 3 or e.shape != s.shape or e.shape[2] != len(names) or e.shape[0] < 2:
        raise InputError(
            f"errors have shape {e.shape} and sigma {s.shape}, expected (runs, epochs, {len(names)}) both, of two runs or more"
        )
    runs, epochs, _ = e.shape
    expected = float(scipy.special.chdtr(1, factor**2))
    tail = 0.5 * (1.0 - confidence) / len(names)
    share = (np.abs(e) <= factor * s).mean(axis=(0, 1))
    inner = np.abs(e) <= np.sqrt(np.mean(e**2, axis=(0, 1)))
    p = inner.mean(axis=(0, 1))
    independent = p * (1.0 - p) / epochs
    design = np.clip(inner.mean(axis=1).var(axis=0, ddof=1) / np.where(independent > 0, independent, 1.0), 1.0, epochs)
    out = []
    for i, name in enumerate(names):
        count = round(runs * epochs / float(design[i]))
        low, high = binom.ppf(tail, count, expected) / count, binom.isf(tail, count, expected) / count
        test, found = f"{factor:g}-sigma coverage", float(share[i])
        right = Expected(expected, COVERAGE, ("overconfident", "pessimistic"))
        out.append(judged(test, name, found, (low, high), confidence, count, right))
    return out


def consistency_report(
    errors: ArrayLike,
    covariance: ArrayLike,
    fixes: Sequence[FixTable],
    *,
    at: Sequence[float],
    groups: dict[str, slice] | None = None,
    confidence: float = 0.99,
) -> list[Verdict]:
    """All tests of many independent runs of one design.

    Parameters
    ----------
    errors : (runs, epochs, k) array_like
    covariance : (runs, epochs, k, k) array_like
    fixes : sequence of FixTable
        One per run.
    at : sequence of float
        The epochs, s.
    groups : mapping of name to slice, optional
        States judged together by NEES; position, velocity and attitude unless given.
    confidence : float
        Of each kind of test.
    """
    e, P = np.asarray(errors, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    groups = groups or {"position": slice(0, 3), "velocity": slice(3, 6), "attitude": slice(6, 9)}
    each = 1.0 - (1.0 - confidence) / len(groups)
    out: list[Verdict] = []
    for name, s in groups.items():
        values = nees(e[..., s], P[..., s, s])
        out += nees_test(values, e[..., s].shape[-1], subject=name, at=at, confidence=each)
    out.append(nis_test(fixes, confidence=confidence))
    out += whiteness_test(fixes, confidence=confidence)
    names = [f"{name} {i + 1}" for name, s in groups.items() for i in range(s.stop - s.start)]
    index = np.concatenate([np.arange(s.start, s.stop) for s in groups.values()])
    sigma = np.sqrt(np.einsum("rtii->rti", P))
    return out + coverage_test(e[..., index], sigma[..., index], names=names, confidence=confidence)
