"""Navigation errors: estimate minus truth, by component, and what they come to during an outage."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.records import Trajectory

Array = NDArray[np.float64]

#: The nine components of a navigation error, in state order, with their SI units.
COMPONENTS = tuple(
    f"{what}_{axis}" for what in ("position", "velocity", "attitude") for axis in ("north", "east", "down")
)
COMPONENT_UNITS = ("m",) * 3 + ("m/s",) * 3 + ("rad",) * 3
#: The groups whose coverage is reported.
GROUPS = {"position": slice(0, 3), "velocity": slice(3, 6), "attitude": slice(6, 9)}


def navigation_error(estimate: Trajectory, truth: Trajectory) -> Array:
    """Errors of an estimated trajectory at epochs that both have.

    Parameters
    ----------
    estimate, truth : Trajectory
        On the same epochs.

    Returns
    -------
    (n, 9) array
        Position (m north, east, down), velocity (m/s), attitude phi (rad) with ``C_est = exp([phi x]) C_true``.

    Raises
    ------
    InputError
        The epochs differ.
    """
    if estimate.t.shape != truth.t.shape or not np.allclose(estimate.t, truth.t, rtol=0, atol=1e-9):
        raise InputError("estimate and truth are on different epochs; sample the truth at the epochs of the estimate")
    return np.concatenate(
        [
            earth.position_difference(estimate.llh, truth.llh),
            estimate.vel_ned - truth.vel_ned,
            rotation.attitude_difference(estimate.rpy, truth.rpy),
        ],
        axis=1,
    )


def within_outage(t: ArrayLike, start_s: float, duration_s: float) -> NDArray[np.bool_]:
    """Epochs that belong to an outage: after its start, up to and including its end (whose fix is withheld).

    Parameters
    ----------
    t : (n,) array_like
        Epochs, s.
    start_s, duration_s : float
    """
    t = np.asarray(t, dtype=np.float64)
    return (t > start_s + 1e-9) & (t <= start_s + duration_s + 1e-9)


def share_interval(count: int, of: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson 1934).

    Parameters
    ----------
    count, of : int
        Successes, and independent draws.
    """
    tail = 0.025
    low = float(scipy.special.betaincinv(count, of - count + 1, tail)) if count else 0.0
    high = float(scipy.special.betaincinv(count + 1, of - count, 1.0 - tail)) if count < of else 1.0
    return low, high


@dataclass(frozen=True)
class MeanInterval:
    """A mean over realizations with its 95 % bootstrap interval (None for fewer than two realizations)."""

    mean: float
    low: float | None
    high: float | None


#: Resamples of a bootstrap, its seed, and indices that are held at a time.
DRAWS, SEED, HELD = 10_000, 20140701, 1_000_000
#: Ratios of mean errors nearer to 1 than this do not decide between designs, however sure they are.
NEGLIGIBLE = 0.02
#: Realizations above which an interval is the normal one: the bootstrap's tends to it, and there is no telling them apart.
RESAMPLED = 1000


def resampled_means(values: Array) -> Array:
    """Means (DRAWS, k) of resampled rows of values (n, k); the seed is fixed, so that a report says the same each time."""
    n = len(values)
    rng, out, rows = np.random.default_rng(SEED), [], max(1, HELD // n)
    for first in range(0, DRAWS, rows):
        index = rng.integers(0, n, size=(min(rows, DRAWS - first), n))
        out.append(np.stack([column[index].mean(axis=1) for column in values.T], axis=1))
    return np.concatenate(out)


def bootstrap_mean(values: ArrayLike) -> MeanInterval:
    """Mean of one value per realization with its percentile bootstrap interval; of more than :data:`RESAMPLED` with the normal one."""
    values = np.asarray(values, dtype=np.float64)
    mean = float(values.mean())
    if values.size < 2:
        return MeanInterval(mean, None, None)
    if values.size > RESAMPLED:
        half = -scipy.special.ndtri(0.025) * float(values.std(ddof=1)) / np.sqrt(values.size)
        return MeanInterval(mean, float(mean - half), float(mean + half))
    low, high = np.quantile(resampled_means(values[:, None])[:, 0], [0.025, 0.975])
    return MeanInterval(mean, float(low), float(high))


@dataclass(frozen=True)
class PairedComparison:
    """Ratio of two designs' mean errors under common random numbers."""

    ratio: float
    low: float | None
    high: float | None
    p_value: float | None

    @property
    def different(self) -> bool:
        """Whether the 95 % interval of the ratio excludes 1 and the difference could matter (:data:`NEGLIGIBLE` or more)."""
        return self._excludes_one and abs(self.ratio - 1.0) >= NEGLIGIBLE

    @property
    def same(self) -> bool:
        """Whether a difference that could matter is ruled out: by the whole interval, or by a ratio that is surely no 1 but too near to it."""
        return not self.different and (self.within < NEGLIGIBLE or self._excludes_one)

    @property
    def within(self) -> float:
        """Largest distance from 1 that the 95 % interval of the ratio holds; infinite for a single realization."""
        return math.inf if self.low is None or self.high is None else max(abs(self.low - 1.0), abs(self.high - 1.0))

    @property
    def _excludes_one(self) -> bool:
        return self.low is not None and self.high is not None and not self.low <= 1.0 <= self.high

    @property
    def interval(self) -> str:
        """The ratio with its 95 % interval in words, with as many digits as the interval's width has."""
        if self.low is None or self.high is None:
            return f"ratio {self.ratio:.2f}"
        width = self.high - self.low
        digits = min(max(2, 1 + math.floor(-math.log10(width))), 5) if width > 0 else 5
        return f"ratio {self.ratio:.{digits}f}, 95 % {self.low:.{digits}f} to {self.high:.{digits}f}"


def paired_ratio(one: ArrayLike, other: ArrayLike) -> PairedComparison:
    """Compare ``one`` with ``other`` realization by realization.

    Parameters
    ----------
    one, other : (realizations,) arrays
        An error of each design in the same realizations.

    Returns
    -------
    PairedComparison
        mean(one) / mean(other), its percentile bootstrap interval over realizations, and the two-sided bootstrap p-value of
        "the means are equal" (at least 1 / draws). Of more than :data:`RESAMPLED` realizations both are those of the normal distribution.
    """
    a, b = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    ratio = float(a.mean() / b.mean())
    if a.size < 2:
        return PairedComparison(ratio, None, None, None)
    if a.size > RESAMPLED:
        error = float((a - ratio * b).std(ddof=1)) / np.sqrt(a.size) / float(b.mean())
        half = float(-scipy.special.ndtri(0.025)) * error
        tail = float(scipy.special.ndtr(-abs(ratio - 1.0) / error)) if error > 0 else 0.5 * (ratio == 1.0)
    else:
        ratios = np.divide(*resampled_means(np.stack([a, b], axis=1)).T)
        low, high = np.quantile(ratios, [0.025, 0.975])
        tail = min((ratios >= 1.0).mean(), (ratios <= 1.0).mean())
        return PairedComparison(ratio, float(low), float(high), _p_value(tail))
    return PairedComparison(ratio, ratio - half, ratio + half, _p_value(tail))


def _p_value(tail: float) -> float:
    return float(min(1.0, max(2.0 * tail, 1.0 / DRAWS)))
