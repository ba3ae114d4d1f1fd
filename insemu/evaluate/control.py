"""Means and quantiles of few full runs, helped by many cheap ones: the linear twin as control variate, the coarse one where it does not suffice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.evaluate.coarse import CoarseTwin
from insemu.evaluate.results import Results
from insemu.evaluate.twin import LinearTwin

Array = NDArray[np.float64]

#: Smallest correlation of full and linear runs under the same draws at which the linear ones may help.
CORRELATED = 0.9
#: Coarse runs for a full one. With a fiftieth of its cost and a correlation of 0.999 the least variance for all cost lies at about 160 (Giles 2008,
#: section 3: the root of rho^2 / (1 - rho^2) times the ratio of the costs); half of that costs little of it and half the time.
COARSE = 80
#: Smallest correlation at which linear errors stand for the design's own (they differ by less than 14 % of their spread), and realizations that tell.
#: Table III with 12: 0.976 where the filter is far too sure of itself (``benchmarks/scale.py twin``), above 0.999 elsewhere.
LINEAR, CHECKED = 0.99, 12
#: Linear realizations for one at long steps, in a preview: a quarter as many cost about as much again.
PREVIEW = 4
#: Level of the quantile that is reported, and points of the linear distribution and resamples from which it is made.
LEVEL, POINTS, RESAMPLES = 0.95, 400, 400


@dataclass(frozen=True)
class Figure:
    """An estimate with its 95 % interval, m.

    Parameters
    ----------
    value, low, high : float
    """

    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Of the interval."""
        return self.high - self.low


@dataclass(frozen=True)
class Controlled:
    """Planimetric error at the end of one outage, of the full runs alone and with the help of cheap ones.

    Parameters
    ----------
    correlation : float
        Of full and cheap errors under the same draws.
    used : bool
        Whether that is enough; otherwise the figures are those of the full runs.
    by : str
        ``linear``, or ``coarse`` where the correlation with the linear runs was too small.
    plain_mean, plain_quantile : Figure
        Of the full runs alone.
    mean, quantile : Figure
    spread : float
        Standard deviation of a full run, as the cheap ones tell it too: few full runs seldom hold the tail.
    saved : float
        Variance of the plain mean by that spread over the variance of the controlled one: how many times more full runs would do the same.
    """

    correlation: float
    used: bool
    by: str
    plain_mean: Figure
    plain_quantile: Figure
    mean: Figure
    quantile: Figure
    spread: float
    saved: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def controlled(full: Array, paired: Array, many: Array, by: str = "linear") -> Controlled:
    """Estimate a mean and a quantile from full and cheap errors.

    The mean is the regression estimator: the full runs' mean less what their own cheap errors differ from the mean of many. The quantile is that of
    the fitted line plus its residuals over the many cheap errors.

    Parameters
    ----------
    full, paired : (n,) arrays
        Errors of full runs, and cheap ones under the same draws.
    many : (N,) array
        Cheap errors of other draws.
    by : str
        What the cheap ones are.

    Source
    ------
    Glasserman (2003), section 4.1 (control variates); Chambers and Dunstan (1986) (the distribution function).
    """
    n = full.size
    rng = np.random.default_rng(20140701)
    picks = rng.integers(0, n, (RESAMPLES, n))
    half = scipy.special.stdtrit(n - 1, 0.975) * full.std(ddof=1) / np.sqrt(n)
    mean = float(full.mean())
    plain = Figure(mean, mean - half, mean + half)
    resampled = np.quantile(full[picks], LEVEL, axis=1)
    plain_quantile = _turned(float(np.quantile(full, LEVEL)), resampled)
    correlation = float(np.corrcoef(full, paired)[0, 1]) if n > 2 and paired.std() > 0 and full.std() > 0 else 0.0
    if correlation < CORRELATED:
        return Controlled(
            correlation, False, by, plain, plain_quantile, plain, plain_quantile, float(full.std(ddof=1)), 1.0
        )
    slope, offset = _line(paired, full)
    left = full - offset - slope * paired
    scatter = float(left @ left) / (n - 2)
    off = float(many.mean() - paired.mean())
    variance = scatter * (1.0 / n + off**2 / float(((paired - paired.mean()) ** 2).sum()))
    variance += slope**2 * float(many.var(ddof=1)) / many.size
    centre, half_ = float(offset + slope * many.mean()), scipy.special.stdtrit(n - 2, 0.975) * np.sqrt(variance)
    points = np.quantile(many, (np.arange(POINTS) + 0.5) / POINTS)

    def quantile(x: Array, y: Array) -> float:
        b, a = _line(x, y)
        return float(np.quantile((a + b * points)[:, None] + (y - a - b * x), LEVEL))

    found = quantile(paired, full)
    helped = np.array([quantile(paired[p], full[p]) for p in picks])
    spread = float(np.sqrt(slope**2 * many.var(ddof=1) + scatter))
    mean_ = Figure(centre, centre - half_, centre + half_)
    saved = spread**2 / n / variance
    return Controlled(correlation, True, by, plain, plain_quantile, mean_, _turned(found, helped), spread, saved)


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and offset of the least-squares line; flat where all x are the same."""
    off = x - x.mean()
    spread = float(off @ off)
    slope = float(off @ y) / spread if spread > 0 else 0.0
    return slope, float(y.mean() - slope * x.mean())


def _turned(value: float, resampled: Array) -> Figure:
    """The basic bootstrap interval: the resampled deviations, turned around the estimate."""
    low, high = np.quantile(resampled, [0.025, 0.975])
    return Figure(value, 2 * value - float(high), 2 * value - float(low))


def planimetric(errors: Array) -> Array:
    """Horizontal position errors of navigation errors (..., 9), m."""
    return np.asarray(np.hypot(errors[..., 0], errors[..., 1]))


def control(results: Results, twin: LinearTwin, many: Mapping[str, Array]) -> dict[str, list[Controlled]]:
    """Help every cell of a run's headline table with linear realizations, and where those do not know enough with coarse ones.

    Parameters
    ----------
    results : Results
        At least three realizations.
    twin : LinearTwin
        Of the same experiment.
    many : mapping of design to (N, outages, 9) array
        Linear realizations of draws of their own (:meth:`LinearTwin.draw`).

    Returns
    -------
    dict of design to list of Controlled
        One per outage; designs without a linear twin are left out.
    """
    paired = [twin.realization(r) for r in range(results.realizations)]
    out = {name: _cells(results, name, paired, many[name], "linear") for name in twin.designs}
    refused = [name for name, cells in out.items() if not all(c.used for c in cells)]
    if not refused:
        return out
    coarse = CoarseTwin(twin, refused)
    paired = [coarse.realization(r) for r in range(results.realizations)]
    drawn = coarse.draw(COARSE * results.realizations, coarse.rng)
    for name in refused:
        out[name] = _cells(results, name, paired, drawn[name], "coarse")
    return out


def beyond_linear(twin: LinearTwin) -> dict[str, float]:
    """Designs whose linear errors are not those of the design itself, with the correlation of both, which is below :data:`LINEAR`.

    The designs fly at long steps (:class:`CoarseTwin`) under the draws of the first :data:`CHECKED` realizations; errors at the ends of all
    outages count together. Nothing says so of a design that the coarse twin cannot fly either.

    Parameters
    ----------
    twin : LinearTwin
    """
    coarse = CoarseTwin(twin, list(twin.designs))
    pairs = [(twin.realization(r), coarse.realization(r)) for r in range(CHECKED)]
    out = {}
    for name in twin.designs:
        one, other = (np.concatenate([planimetric(p[k][name]) for p in pairs]) for k in (0, 1))
        found = float(np.corrcoef(one, other)[0, 1])
        if not found >= LINEAR:
            out[name] = found
    return out


@dataclass(frozen=True)
class Preview:
    """Errors of many cheap runs.

    Parameters
    ----------
    errors : mapping of design to (N, outages, 9) array
        Navigation errors at the ends of the outages.
    beyond : mapping of design to float
        Designs that are not linear, and their correlation (:func:`beyond_linear`): theirs are a quarter as many runs at long steps.
    """

    errors: Mapping[str, Array]
    beyond: Mapping[str, float]


def previewed(twin: LinearTwin, realizations: int) -> Preview:
    """Draw linear realizations, and filters at long steps where a design is not linear.

    Parameters
    ----------
    twin : LinearTwin
    realizations : int
    """
    beyond = beyond_linear(twin)
    errors = twin.draw(realizations, twin.rng)
    if beyond:
        coarse = CoarseTwin(twin, list(beyond))
        errors |= coarse.draw(max(2, realizations // PREVIEW), coarse.rng)
    return Preview(errors, beyond)


def _cells(
    results: Results, name: str, paired: Sequence[Mapping[str, Array]], many: Array, by: str
) -> list[Controlled]:
    """What cheap runs do for one design at every outage."""
    ours, drawn = planimetric(np.stack([p[name] for p in paired])), planimetric(many)
    full = results.planimetric_ends(name)
    return [controlled(full[:, k], ours[:, k], drawn[:, k], by) for k in range(full.shape[1])]
