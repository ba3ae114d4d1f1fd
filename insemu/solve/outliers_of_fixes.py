"""Fixes that the others contradict: what the smoother leaves of each, held against its own variance and against the usual scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import norm

from insemu import earth
from insemu.filters import FIX, FilterResult, smooth

Array = NDArray[np.float64]

#: Chance that a recording of normal fixes loses any of them.
FALSE_ALARM = 0.05
#: Neighbours whose scatter counts together with that of the whole recording: quality changes with the surroundings.
NEIGHBOURS = 31
#: From this share on what is far off is no outlier but the noise itself, and all fixes stay.
MOST_SHARE = 0.2
#: A residual has at least this share of the variance of its fix (rounding where a fix is hardly redundant).
LEAST_LEFT = 0.02


@dataclass(frozen=True)
class OutlyingFixes:
    """Outliers among the fixes.

    Parameters
    ----------
    positions, velocities : (k,), (l,) arrays
        Their times, s.
    largest : float
        Horizontal distance of the farthest position from where the others say that it is, m; 0 without any.
    """

    positions: Array
    velocities: Array
    largest: float


def residuals(run: FilterResult) -> tuple[Array, Array]:
    """What is left of the fixes of a run once all of them are known, and its variance.

    For a fix with innovation ``v``, Jacobian ``H`` and noise ``R``: ``v + H e`` with the smoothed error ``e`` of the prediction, and
    ``R - H P H'`` with its smoothed covariance ``P`` (de Jong 1989). Errors of the attitude, which move the antenna on its lever arm,
    are left out of ``e``.

    Parameters
    ----------
    run : FilterResult
        With nodes at its fixes (``FilterOptions(store="fixes")``).

    Returns
    -------
    (f, 6), (f, 6) arrays
        North, east, down, m, and their velocities, m/s; squares of the same. NaN in rows that are no fix or were not used.
    """
    f, nodes, s = run.fixes, run.nodes, smooth(run)
    assert nodes is not None and f.H is not None
    left, variance = np.full((len(f), 6), np.nan), np.full((len(f), 6), np.nan)
    rows = np.flatnonzero(f.accepted & (f.kind == FIX) & (f.dof > 0))
    at = np.searchsorted(nodes.epoch, f.epoch[rows])
    error = nodes.correction[at].copy()
    error[:, :3] += earth.position_difference(nodes.nav[at, :3], s.nav[at, :3])
    error[:, 3:6] += nodes.nav[at, 3:6] - s.nav[at, 3:6]
    error[:, 9:] += nodes.states[at] - s.imu_states[at]
    H = f.H[rows, :6]
    left[rows] = f.innovation[rows, :6] + np.einsum("kin,kn->ki", H, error)
    before, after = (np.einsum("kin,knm,kim->ki", H, P[at], H) for P in (nodes.P_before, s.covariance))
    noise = np.einsum("kii->ki", f.S[rows, :6, :6]) - before
    variance[rows] = np.maximum(noise - after, LEAST_LEFT * noise)
    return left, variance


def outlying(run: FilterResult) -> OutlyingFixes:
    """Fixes that all others contradict.

    A component is an outlier where it is left by more than normal noise reaches in a whole recording, counted in the usual scatter (the median of
    the recording or of the neighbours, whichever is larger): a level of the noise that is wrong or that changes makes no outliers.

    Parameters
    ----------
    run : FilterResult
        As for :func:`residuals`.
    """
    left, variance = residuals(run)
    size = np.abs(left) / np.sqrt(variance)
    there = np.isfinite(size)
    far = np.zeros_like(there)
    for c in range(6):
        if (rows := np.flatnonzero(there[:, c])).size < NEIGHBOURS:
            continue
        values = size[rows, c]
        usual = np.maximum(median_filter(values, NEIGHBOURS, mode="nearest"), np.median(values)) / norm.ppf(0.75)
        far[rows, c] = values > usual * norm.isf(FALSE_ALARM / (2.0 * values.size * 6.0))
    times = []
    for part in (slice(0, 3), slice(3, 6)):
        hit = far[:, part].any(axis=1)
        some = there[:, part].any(axis=1)
        times.append(run.fixes.t[hit] if hit.sum() <= MOST_SHARE * max(some.sum(), 1) else np.zeros(0))
    gone = np.isin(run.fixes.t, times[0])
    largest = float(np.nanmax(np.hypot(left[gone, 0], left[gone, 1]), initial=0.0)) if gone.any() else 0.0
    return OutlyingFixes(times[0], times[1], largest)
