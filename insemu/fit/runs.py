"""Several runs of one sensor: what they have in common, how much it changes from switch-on to switch-on, and which model predicts them.

The common model minimises the distance of the wavelet moments of all runs together, each at its own scales and weights (Radi et al. 2018,
Bakalli et al. 2017). Where the runs differ by more than they scatter, the logarithms of their parameters are taken as normal around the common
ones, and intervals for the next run are Student's (Hartung and Knapp 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.covariance import covariance_of_curve
from insemu.fit.gmwm import drawn_values, fit_curve, parameter_covariance
from insemu.fit.minimum import Problem, Solution, root_of_inverse
from insemu.fit.result import FitResult, estimates
from insemu.fit.structure import Structure, natural_jacobian
from insemu.noise import NoiseModel, Spread, with_factors
from insemu.records import Series
from insemu.variance import WaveletVariance, wavelet_variance

Array = NDArray[np.float64]

#: Standard normal deviate of 95 % intervals.
NORMAL = 1.959963984540054
#: Cells of the quadrature over a chi-square: coverage to 0.1 %.
CELLS = 1000
#: Spread over the scatter of a log beyond which the scatter no longer matters.
WIDEST = 20.0
#: How many times the weights of the common model are renewed.
STEPS = 2
#: A logarithm of a parameter with a larger standard error says nothing of the spread.
UNKNOWN = 1.0


@dataclass(frozen=True)
class Between:
    """How one parameter changes between runs.

    Parameters
    ----------
    label : str
        ``GM1.sigma``.
    common, low, high : float
        Median over runs with its 95 % interval, SI.
    size, size_high : float
        Standard deviation of the logarithm between runs, estimate and upper 95 % bound.
    next_low, next_high : float
        95 % prediction interval of the parameter at the next switch-on.
    log_low, log_high : float
        The same of what a fit to a log of the mean length will then show.
    runs : int
        Runs that determine it.
    """

    label: str
    common: float
    low: float
    high: float
    size: float
    size_high: float
    next_low: float
    next_high: float
    log_low: float
    log_high: float
    runs: int


@dataclass(frozen=True)
class RunsFit:
    """A model fitted to several runs.

    Parameters
    ----------
    joint : FitResult
        All runs as one: parameters and intervals hold where the sensor is the same in every run.
    each : tuple of FitResult
        Run by run.
    spreads : tuple of Spread
        One per free parameter.
    curve : tuple of Between
        The same of the wavelet variance, one per scale that all runs have.
    covariance : (p, p) array
        Of the logarithms of the parameters from run to run.
    uncertainty : (p, p) array
        Of the logarithms of the common parameters.
    statistic : float
        Weighted squared distance of the joint fit less those of the runs.
    p_value : float
        Of all runs having one set of parameters, by parametric bootstrap; NaN where none was asked for.
    """

    joint: FitResult
    each: tuple[FitResult, ...]
    spreads: tuple[Between, ...]
    curve: tuple[Between, ...]
    covariance: Array
    uncertainty: Array
    statistic: float
    p_value: float

    @property
    def model(self) -> NoiseModel:
        """The model of a run in the middle: every parameter at its median over the runs."""
        return with_factors(
            self.joint.model,
            {s.label: s.common / self.joint[s.label].value for s in self.spreads if self.joint[s.label].value},
        )

    @property
    def spread(self) -> Spread:
        """What a scenario draws the next run from; parameters whose spread is not known stay."""
        known = [i for i, s in enumerate(self.spreads) if math.isfinite(s.size)]
        total = (self.covariance + self.uncertainty)[np.ix_(known, known)]
        return Spread(tuple(self.spreads[i].label for i in known), total)

    def to_json(self) -> dict[str, object]:
        """The stable machine-readable form."""
        joint = self.joint.to_json()
        rows = [{k: (v if v == v else None) for k, v in vars(s).items()} for s in self.spreads]
        p = self.p_value if math.isfinite(self.p_value) else None
        curve = [vars(s) for s in self.curve]
        return {
            "joint": joint,
            "runs": [r.to_json() for r in self.each],
            "spreads": rows,
            "curve": curve,
            "near_stationarity_p": p,
        }


@dataclass(frozen=True)
class _Runs:
    """Curves of several runs with one structure."""

    structure: Structure
    curves: tuple[WaveletVariance, ...]

    @property
    def scale(self) -> NDArray[np.int64]:
        return np.concatenate([c.scale_samples for c in self.curves])

    @property
    def value(self) -> Array:
        return np.concatenate([c.value for c in self.curves])

    @property
    def longest(self) -> int:
        return max(c.n_samples for c in self.curves)

    def covariance(self, model: NoiseModel) -> list[Array]:
        """Covariance of each run's curve under a model."""
        found: dict[int, Array] = {}
        out = []
        for c in self.curves:
            # runs without gaps of one length have one covariance
            if c.inflation is not None:
                out.append(covariance_of_curve(model, c))
                continue
            if c.n_samples not in found:
                found[c.n_samples] = covariance_of_curve(model, c)
            out.append(found[c.n_samples])
        return out

    def minimum(self, roots: Sequence[Array], starts: Array) -> Solution:
        """The nearest common model from the best of some starts."""
        W = np.ascontiguousarray(scipy.linalg.block_diag(*roots))
        return Problem(self.structure, self.scale, self.value, self.longest).search(W, starts)

    def each(self, roots: Sequence[Array], start: Array) -> list[Solution]:
        """The nearest model of every run from a common start."""
        return [
            Problem(self.structure, c.scale_samples, c.value, c.n_samples).search(W, start[None, :])
            for c, W in zip(self.curves, roots, strict=True)
        ]

    def with_values(self, values: Sequence[Array]) -> _Runs:
        return replace(self, curves=tuple(replace(c, value=v) for c, v in zip(self.curves, values, strict=True)))


def fit_runs(
    runs: Sequence[Series],
    model: NoiseModel,
    *,
    bootstrap: int = 500,
    rng: np.random.Generator | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunsFit:
    """Fit one model to one axis of several runs.

    Parameters
    ----------
    runs : sequence of Series
        The axis in every run, of any lengths at one rate.
    model : NoiseModel
        Structure; parameters that have a value are held.
    bootstrap : int
        Draws of the test of near-stationarity: all runs simulated from the joint estimate at their own lengths and refitted. 0: no test.
    rng : Generator, optional
        Of the draws.
    progress : callable, optional
        Told how many draws of how many are done.

    Returns
    -------
    RunsFit

    Raises
    ------
    InputError
        Fewer than two runs, different rates, too few scales for the parameters.
    """
    if len(runs) < 2:
        raise InputError(f"found {len(runs)} run, expected at least two")
    if len({round(s.rate_hz, 9) for s in runs}) > 1:
        raise InputError(f"the runs are sampled at {', '.join(f'{s.rate_hz:g}' for s in runs)} Hz, expected one rate")
    rng = rng or np.random.default_rng(0)
    problem = _Runs(
        Structure.of(model, runs[0].rate_hz), tuple(wavelet_variance(s.values, s.rate_hz, gaps=s.gaps) for s in runs)
    )
    each = tuple(
        fit_curve(c, model, unit=s.unit, name=s.name, weighting="asymptotic")
        for c, s in zip(problem.curves, runs, strict=True)
    )
    found = _settled(problem, problem.structure.starts(problem.longest))
    joint = _joint(problem, runs[0], found)
    statistic = _statistic(problem, found)
    p = math.nan
    if bootstrap:
        above = 0
        for k, child in enumerate(rng.spawn(bootstrap)):
            drawn = _drawn(problem, joint.model, child)
            above += _statistic(drawn, _settled(drawn, found.best.shapes[None, :])) >= statistic
            if progress is not None:
                progress(k + 1, bootstrap)
        p = (above + 1) / (bootstrap + 1)
    spreads, covariance, uncertainty = _spreads(each, joint)
    return RunsFit(joint, each, spreads, _curve(problem, found.V), covariance, uncertainty, statistic, p)


@dataclass(frozen=True)
class _Settled:
    """The common model, the weights of its last step, and the covariance of every run under it."""

    best: Solution
    roots: list[Array]
    V: list[Array]


def _settled(problem: _Runs, starts: Array) -> _Settled:
    """The common model, weighed by the covariance of every run under it, which is renewed :data:`STEPS` times.

    The first weights are the widths of the runs' curves around their common mean: widths around each run's own curve count a scale for more where it
    came out low, and their minimum may be without the slow process. The starts are tried again under the first covariance.
    """
    structure = problem.structure
    roots = [np.diag(np.sqrt(0.5 * c.edof) / m) for c, m in zip(problem.curves, _means(problem.curves), strict=True)]
    best = problem.minimum(roots, starts)
    V = problem.covariance(structure.specified(best.coefficients, best.shapes))
    for step in range(STEPS):
        roots = [root_of_inverse(v) for v in V]
        best = problem.minimum(roots, best.shapes[None, :] if step else np.vstack([best.shapes, starts]))
        V = problem.covariance(structure.specified(best.coefficients, best.shapes))
    return _Settled(best, roots, V)


def _means(curves: Sequence[WaveletVariance]) -> list[Array]:
    """For every run the mean curve of the runs that have the scale, by degrees of freedom."""
    longest = max(len(c) for c in curves)
    total, freedom = np.zeros(longest), np.zeros(longest)
    for c in curves:
        total[: len(c)] += c.edof * c.value
        freedom[: len(c)] += c.edof
    return [(total / freedom)[: len(c)] for c in curves]


def _joint(problem: _Runs, first: Series, found: _Settled) -> FitResult:
    """All runs as one."""
    structure, best, V = problem.structure, found.best, found.V
    model = structure.specified(best.coefficients, best.shapes)
    W, whole = scipy.linalg.block_diag(*(root_of_inverse(v) for v in V)), scipy.linalg.block_diag(*V)
    D, free = natural_jacobian(model, structure, problem.scale / 2.0)
    C, lost = parameter_covariance(D, W, whole)
    curve = max(problem.curves, key=lambda c: c.n_samples)
    return FitResult(
        name=first.name,
        method="gmwm",
        structure=structure.model,
        model=model,
        rate_hz=first.rate_hz,
        n_samples=sum(c.n_samples for c in problem.curves),
        unit=first.unit,
        parameters=estimates(model, free, C, first.unit),
        covariance=C,
        curve=curve,
        fitted=model.wavelet_variance(curve.scale_samples, structure.dt),
        objective=best.objective,
        converged=best.converged,
        warnings=("the runs do not determine all parameters",) if lost else (),
        details={"free": free, "weighting": "asymptotic"},
    )


def _statistic(problem: _Runs, found: _Settled) -> float:
    """How much nearer every run's own model, sought from the common one, is than the common one, in one metric.

    Measured and drawn runs go the same way, weights included: a better search of the measured ones alone would make every sensor look unsteady, and
    so would weights that scatter with the measured curves against weights that are known of the drawn ones.
    """
    return found.best.objective - sum(own.objective for own in problem.each(found.roots, found.best.shapes))


def _drawn(problem: _Runs, model: NoiseModel, rng: np.random.Generator) -> _Runs:
    """Runs of the same lengths from one model."""
    children = rng.spawn(len(problem.curves))
    return problem.with_values(
        [drawn_values(model, c, child) for c, child in zip(problem.curves, children, strict=True)]
    )


# -- the spread between runs -----------------------------------------------------------------------------------------------------------------


def _spreads(each: Sequence[FitResult], joint: FitResult) -> tuple[tuple[Between, ...], Array, Array]:
    """Every parameter's spread, and the covariance of their logarithms from run to run and of the common ones."""
    labels = [e.label for e in joint.parameters if e.free]
    p, R = len(labels), len(each)
    y, C = np.full((R, p), np.nan), np.full((R, p, p), np.nan)
    for k, r in enumerate(each):
        value = np.array([r[name].value for name in labels])
        with np.errstate(divide="ignore", invalid="ignore"):
            C[k] = r.covariance / np.outer(value, value)
            y[k] = np.log(np.abs(value))
        weak = ~(np.sqrt(np.diag(C[k])) < UNKNOWN)
        y[k, weak] = np.nan
    rows = [_spread(labels[i], y[:, i], C[:, i, i], joint[labels[i]].value) for i in range(p)]
    known = np.isfinite(y)
    counts = known.T.astype(float) @ known
    own = np.where(known[:, :, None] & known[:, None, :], C, 0.0).sum(axis=0) / np.maximum(counts, 1.0)
    mean = np.where(known, y, 0.0).sum(axis=0) / np.maximum(np.diag(counts), 1.0)
    centred = np.where(known, y - mean, 0.0)
    excess = centred.T @ centred / np.maximum(counts - 1.0, 1.0) - own
    size = np.nan_to_num([row.size for row in rows])
    with np.errstate(divide="ignore", invalid="ignore"):
        together = np.nan_to_num(excess / np.sqrt(np.outer(np.diag(excess), np.diag(excess))))
    together[np.diag_indices(p)] = 1.0
    positive = _positive(together)
    root = np.sqrt(np.maximum(np.diag(positive), 1e-12))
    covariance = positive / np.outer(root, root) * np.outer(size, size)
    uncertainty = (covariance + own) / np.maximum(counts, 1.0)
    return tuple(rows), np.asarray(covariance), _positive(uncertainty)


def _positive(matrix: Array) -> Array:
    """The nearest covariance: entries that were estimated apart need not make one."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _curve(problem: _Runs, V: Sequence[Array]) -> tuple[Between, ...]:
    """The wavelet variance from run to run, scale by scale."""
    out = []
    for j in range(min(len(c) for c in problem.curves)):
        y = np.log([c.value[j] for c in problem.curves])
        expected = float(np.exp(y.mean()))
        variance = np.array([v[j, j] for v in V]) / expected**2
        out.append(_spread(f"{problem.curves[0].tau_s[j]:.4g} s", y, variance, expected))
    return tuple(out)


def _spread(label: str, y: Array, variance: Array, joint: float) -> Between:
    """One parameter over the runs: random effects, with intervals that hold as often as they say whatever the spread.

    The mean has Student's interval with the scatter as it is (Hartung and Knapp 2001), and so has what the next log will show: neither needs to
    know what part of the scatter is spread, which few runs do not tell. The next run itself scatters less than its log by what logs scatter; see
    :func:`scatter_taken_off`.
    """
    known = np.isfinite(y)
    y, v = y[known], variance[known]
    if y.size < 2:
        nothing = math.nan
        return Between(label, joint, *(nothing,) * 8, int(y.size))
    dof = y.size - 1

    def scatter(t2: float) -> float:
        w = 1.0 / (v + t2)
        return float(np.sum(w * (y - w @ y / w.sum()) ** 2))

    most = float(np.var(y)) * 1e4 + 1e-12

    def inverse(q: float) -> float:
        """The variance between runs at which the scatter, which falls with it, is q."""
        return 0.0 if q >= scatter(0.0) else float(scipy.optimize.brentq(lambda t2: scatter(t2) - q, 0.0, most))

    size2 = inverse(float(dof))  # where the scatter is what it should be (Paule and Mandel 1982)
    w = 1.0 / (v + size2)
    middle, of_mean = float(w @ y / w.sum()), 1.0 / float(w.sum())
    excess = scatter(size2) / dof  # one, or less where the runs scatter less than they should
    student, own = float(scipy.special.stdtrit(dof, 0.975)) ** 2, float(v.mean())
    of_middle = student * excess * of_mean
    of_log = student * excess * (of_mean + size2 + own)
    of_next = max(of_log - scatter_taken_off(y.size) * NORMAL**2 * own, of_middle)

    def ends(square: float) -> tuple[float, float]:
        low, high = sorted(math.copysign(math.exp(middle + side * math.sqrt(square)), joint) for side in (-1.0, 1.0))
        return low, high

    common = math.copysign(math.exp(middle), joint)
    bound = inverse(float(scipy.special.chdtri(dof, 0.95)))
    return Between(
        label, common, *ends(of_middle), math.sqrt(size2), math.sqrt(bound), *ends(of_next), *ends(of_log), int(y.size)
    )


@cache
def scatter_taken_off(runs: int) -> float:
    """What part of the scatter of a log is subtracted from the squared interval of the next log to get that of the next run.

    All of it (1) is right for many runs. With few the scatter is hardly known, and less must go (as in the expansion of Welch 1947). It is the part
    with which the coverage strays least from 95 % over all spreads from none to :data:`WIDEST` times the scatter of a log, where all logs scatter
    alike: quadrature over the chi-square of the sum of squares.

    Parameters
    ----------
    runs : int
        At least two.
    """
    dof = runs - 1
    cells = (np.arange(CELLS) + 0.5) / CELLS
    own = (
        scipy.special.chdtri(dof, 1.0 - cells) / dof
    )  # sum of squares per degree of freedom, of logs that scatter by 1
    student = float(scipy.special.stdtrit(dof, 0.975)) ** 2
    total = np.concatenate([[0.0], np.geomspace(0.1, WIDEST, 30)])[:, None] ** 2 + 1.0
    sd = np.sqrt(total * (1.0 + 1.0 / runs) - 1.0)

    def strays(part: float) -> float:
        """How much further coverage strays upwards than downwards."""
        square = np.maximum(student * own * total * (1.0 + 1.0 / runs) - part * NORMAL**2, student * own * total / runs)
        held = np.mean(2.0 * scipy.special.ndtr(np.sqrt(square) / sd) - 1.0, axis=1)
        return float(held.max() - 0.95 - (0.95 - held.min()))

    if strays(1.0) >= 0.0:
        return 1.0
    return float(scipy.optimize.brentq(strays, 0.0, 1.0, xtol=1e-4)) if strays(0.0) > 0.0 else 0.0


# -- which model ---------------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """A model weighed by how well one part of the runs predicts the other.

    Parameters
    ----------
    model : NoiseModel
    loss : float
        Mean weighted squared distance to the runs left out, per run.
    behind, error : float
        How much larger that is than the best model's, and its standard error over the splits.
    equivalent : bool
        Whether the best is not better by more than that error.
    """

    model: NoiseModel
    loss: float
    behind: float
    error: float
    equivalent: bool


def choose_model(runs: Sequence[Series], models: Sequence[NoiseModel]) -> list[Choice]:
    """Rank models by cross-validation over all splits of the runs into halves, best first.

    Parameters
    ----------
    runs : sequence of Series
        One axis.
    models : sequence of NoiseModel

    Notes
    -----
    The splits of Radi et al. 2018, fitted jointly to one part. The distance of the other part's curves is the deviance of scaled chi-squares and not
    the squared distance over their widths: those of a scale that came out low are small, and would let it decide.
    """
    curves = tuple(wavelet_variance(s.values, s.rate_hz, gaps=s.gaps) for s in runs)
    R = len(curves)
    splits = [set(c) for size in {max(R // 2, 1), R - max(R // 2, 1)} for c in combinations(range(R), size)]
    losses = np.empty((len(models), len(splits)))
    for i, model in enumerate(models):
        structure = Structure.of(model, runs[0].rate_hz)
        starts = structure.starts(max(c.n_samples for c in curves))
        for j, inside in enumerate(splits):
            train = _Runs(structure, tuple(curves[k] for k in sorted(inside)))
            widths = [np.diag(np.sqrt(0.5 * c.edof) / c.value) for c in train.curves]
            best = train.minimum(widths, starts)
            found = structure.specified(best.coefficients, best.shapes)
            left = [curves[k] for k in range(R) if k not in inside]
            ratios = [c.value / found.wavelet_variance(c.scale_samples, structure.dt) for c in left]
            misfit = [0.5 * c.edof * (x - 1.0 - np.log(x)) for c, x in zip(left, ratios, strict=True)]
            losses[i, j] = np.mean([m.sum() for m in misfit])
    first = int(np.argmin(losses.mean(axis=1)))
    out = []
    for model, loss in zip(models, losses, strict=True):
        difference = loss - losses[first]
        # splits share runs: as many are independent as there are runs
        error = float(np.std(difference, ddof=1) / math.sqrt(R)) if len(splits) > 1 else math.inf
        behind = float(difference.mean())
        out.append(Choice(model, float(loss.mean()), behind, error, behind <= error))
    return sorted(out, key=lambda c: c.loss)
