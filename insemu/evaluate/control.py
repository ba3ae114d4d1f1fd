"""Means and quantiles of few full runs, helped by many cheap ones: the linear twin as control variate, the coarse one where it does not suffice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.evaluate.coarse import BATCH, CoarseTwin
from insemu.evaluate.results import Results
from insemu.evaluate.twin import LinearTwin

Array = NDArray[np.float64]

#: Smallest correlation of full and linear runs under the same draws at which the linear ones may help.
CORRELATED = 0.9
#: Coarse runs for a full one. With a fiftieth of its cost and a correlation of 0.999 the least variance for all cost lies at about 160 (Giles 2008,
#: section 3: the root of rho^2 / (1 - rho^2) times the ratio of the costs); half of that costs little of it and half the time.
COARSE = 80
#: Smallest correlation at which linear errors stand for the design's own (they differ by less than 14 % of their spread). Table III: 0.7 where the
#: filter is far too sure of itself (``benchmarks/twin.py``), above 0.999 elsewhere.
LINEAR = 0.99
#: Linear realizations for one run at long steps that tells whether a design is linear, and fewest and most of these runs: what is not linear may
#: show in one run of twenty.
CHECK, FEWEST, CHECKED = 16, 12, 48
#: The same for a design that is not linear: its runs only tell what the linear ones differ by.
PREVIEW, MOST = 12, 128
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
    plain = _plain(full)
    resampled = np.quantile(full[picks], LEVEL, axis=1)
    plain_quantile = _turned(float(np.quantile(full, LEVEL)), resampled)
    mean, spread, correlation = regressed(full, paired, many)
    if correlation < CORRELATED:
        return Controlled(correlation, False, by, plain, plain_quantile, plain, plain_quantile, spread, 1.0)
    points = np.quantile(many, (np.arange(POINTS) + 0.5) / POINTS)
    helped = np.array([_helped_quantile(paired[p], full[p], points) for p in picks])
    error = mean.width / 2.0 / scipy.special.stdtrit(n - 2, 0.975)
    found = _turned(_helped_quantile(paired, full, points), helped)
    return Controlled(correlation, True, by, plain, plain_quantile, mean, found, spread, spread**2 / n / error**2)


def _plain(full: Array) -> Figure:
    """The mean of some runs."""
    half = scipy.special.stdtrit(full.size - 1, 0.975) * full.std(ddof=1) / np.sqrt(full.size)
    return Figure(float(full.mean()), float(full.mean() - half), float(full.mean() + half))


def regressed(full: Array, paired: Array, many: Array) -> tuple[Figure, float, float]:
    """The mean with the help of cheap runs, the spread of a full run, and the correlation; those of the full runs alone below :data:`CORRELATED`.

    Parameters
    ----------
    full, paired, many
        As of :func:`controlled`.
    """
    n = full.size
    correlation = float(np.corrcoef(full, paired)[0, 1]) if n > 2 and paired.std() > 0 and full.std() > 0 else 0.0
    if correlation < CORRELATED:
        return _plain(full), float(full.std(ddof=1)), correlation
    slope, offset = _line(paired, full)
    left = full - offset - slope * paired
    scatter = float(left @ left) / (n - 2)
    off = float(many.mean() - paired.mean())
    variance = scatter * (1.0 / n + off**2 / float(((paired - paired.mean()) ** 2).sum()))
    variance += slope**2 * float(many.var(ddof=1)) / many.size
    centre, half = float(offset + slope * many.mean()), float(scipy.special.stdtrit(n - 2, 0.975) * np.sqrt(variance))
    spread = float(np.sqrt(slope**2 * many.var(ddof=1) + scatter))
    return Figure(centre, centre - half, centre + half), spread, correlation


def _helped_quantile(paired: Array, full: Array, points: Array) -> float:
    """The quantile of the fitted line plus its residuals, over points of the cheap distribution."""
    slope, offset = _line(paired, full)
    return float(np.quantile((offset + slope * points)[:, None] + (full - offset - slope * paired), LEVEL))


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
    drawn = coarse.draw(COARSE * results.realizations, refused)
    for name in refused:
        out[name] = _cells(results, name, paired, drawn[name], "coarse")
    return out


@dataclass(frozen=True)
class Beyond:
    """A design whose linear errors are not its own.

    Parameters
    ----------
    correlation : float
        Of both under the same draws, below :data:`LINEAR`.
    coarse, linear : (runs, outages, 9) arrays
        Errors of the design flown at long steps, and of the linear twin under the same draws.
    """

    correlation: float
    coarse: Array
    linear: Array

    @property
    def reason(self) -> str:
        """Why it counts as not linear, in words."""
        rms = [float(np.sqrt((planimetric(e) ** 2).mean())) for e in (self.coarse, self.linear)]
        return (
            f"under the same draws errors of {len(self.coarse)} runs of the filter at long steps (rms {rms[0]:.3g} m) correlate with the linear "
            f"ones (rms {rms[1]:.3g} m) to {self.correlation:.2f} only, expected {LINEAR:g}"
        )


@dataclass(frozen=True)
class Told:
    """What a preview says of a design at the end of an outage, or of all outages together, m.

    Parameters
    ----------
    mean : Figure
    quantile_95, rms : float
    by : str
        ``linear``; ``coarse``: runs at long steps, helped by linear ones.
    runs : int
        How many of these.
    """

    mean: Figure
    quantile_95: float
    rms: float
    by: str
    runs: int


@dataclass(frozen=True)
class Preview:
    """Errors of many cheap runs.

    Parameters
    ----------
    errors : mapping of design to (N, outages, 9) array
        Navigation errors at the ends of the outages, to first order.
    mean_square : mapping of design to (outages,) array
        Their planimetric mean square, without a draw, m^2.
    beyond : mapping of design to Beyond
        Designs that are not linear.
    """

    errors: Mapping[str, Array]
    mean_square: Mapping[str, Array]
    beyond: Mapping[str, Beyond]

    def figures_of(self, design: str, outage: int | None = None) -> Told:
        """The figures of a design at the end of one outage (from 0), or of all: the mean over outages and the quantile of their errors.

        Parameters
        ----------
        design : str
        outage : int, optional
        """
        outages = slice(None) if outage is None else slice(outage, outage + 1)
        many, mean_square = planimetric(self.errors[design][:, outages]), self.mean_square[design][outages]
        found = self.beyond.get(design)
        if found is None:
            values = many.mean(axis=1)
            half = float(1.96 * values.std(ddof=1) / np.sqrt(values.size))
            mean = Figure(float(values.mean()), float(values.mean()) - half, float(values.mean()) + half)
            return Told(mean, float(np.quantile(many, LEVEL)), float(np.sqrt(mean_square.mean())), "linear", len(many))
        full, paired = planimetric(found.coarse[:, outages]), planimetric(found.linear[:, outages])
        mean, _, _ = regressed(full.mean(axis=1), paired.mean(axis=1), many.mean(axis=1))
        each = [regressed(full[:, k], paired[:, k], many[:, k]) for k in range(full.shape[1])]
        rms = float(np.sqrt(np.mean([m.value**2 + spread**2 for m, spread, _ in each])))
        points = np.quantile(many, (np.arange(POINTS) + 0.5) / POINTS)
        helps = np.corrcoef(full.ravel(), paired.ravel())[0, 1] >= CORRELATED
        quantile = _helped_quantile(paired.ravel(), full.ravel(), points) if helps else float(np.quantile(full, LEVEL))
        return Told(mean, quantile, rms, "coarse", len(full))


def beyond_linear(twin: LinearTwin, realizations: int) -> dict[str, Beyond]:
    """Designs whose linear errors are not those of the design itself.

    The designs fly at long steps (:class:`CoarseTwin`), and the twin takes the same draws; errors at the ends of all outages count together.
    Nothing says so of a design that the coarse twin cannot fly either.

    Parameters
    ----------
    twin : LinearTwin
    realizations : int
        That are drawn: the more, the more runs tell.
    """
    coarse = CoarseTwin(twin, list(twin.designs))
    flown: dict[str, list[Array]] = {name: [] for name in twin.designs}
    linear: dict[str, list[Array]] = {name: [] for name in twin.designs}

    def fly(first: int, last: int, designs: Sequence[str]) -> None:
        for start in range(first, last, BATCH):
            draws = coarse.draws(start, min(start + BATCH, last))
            one, other = coarse.flown(draws, designs), coarse.linear(draws, designs)
            for name in designs:
                flown[name].append(one[name])
                linear[name].append(other[name])

    def correlation(name: str) -> float:
        one, other = (planimetric(np.concatenate(parts[name])).ravel() for parts in (flown, linear))
        return float(np.corrcoef(one, other)[0, 1])

    checked = min(CHECKED, max(FEWEST, realizations // CHECK))
    fly(0, checked, list(twin.designs))
    left = [name for name in twin.designs if not correlation(name) >= LINEAR]
    if left:
        fly(checked, min(MOST, realizations // PREVIEW), left)
    return {n: Beyond(correlation(n), np.concatenate(flown[n]), np.concatenate(linear[n])) for n in left}


def previewed(twin: LinearTwin, realizations: int) -> Preview:
    """Draw linear realizations, and tell of designs that are not linear by how much runs at long steps differ from them.

    Parameters
    ----------
    twin : LinearTwin
    realizations : int
    """
    beyond = beyond_linear(twin, realizations)
    square = {name: e[:, 0, 0] + e[:, 1, 1] for name, e in twin.mean_square().items()}
    return Preview(twin.draw(realizations, twin.rng), square, beyond)


def _cells(
    results: Results, name: str, paired: Sequence[Mapping[str, Array]], many: Array, by: str
) -> list[Controlled]:
    """What cheap runs do for one design at every outage."""
    ours, drawn = planimetric(np.stack([p[name] for p in paired])), planimetric(many)
    full = results.planimetric_ends(name)
    return [controlled(full[:, k], ours[:, k], drawn[:, k], by) for k in range(full.shape[1])]
