"""Several axes fitted together: wavelet variances of each and cross-covariances of those that share a process (multivariate GMWM).

The distance is that of :mod:`insemu.fit.gmwm` over all curves at once, weighed by their exact covariance under the model. Levels of a shared
process are those of the axes, its other parameters are one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.coordinates import Coordinates
from insemu.fit.covariance import model_covariance
from insemu.fit.gmwm import TEST_DOF, fit_curve, parameter_covariance
from insemu.fit.minimum import root_of_inverse
from insemu.fit.nonlinear import bias, minimised, slopes
from insemu.fit.result import FitResult, GoodnessOfFit, estimates
from insemu.fit.structure import Structure
from insemu.noise import NoiseModel, Process, Seen, shared_processes
from insemu.records import Series
from insemu.variance import WaveletCovariance, WaveletVariance, wavelet_covariance, wavelet_variance

Array = NDArray[np.float64]
Models = Mapping[str, NoiseModel]


def fit_together(
    series: Sequence[Series],
    models: Models,
    *,
    tau_from: float = 0.0,
    tau_to: float = math.inf,
    steps: int = 2,
    confidence: float = 0.95,
) -> dict[str, FitResult]:
    """Fit the axes of one log together.

    Parameters
    ----------
    series : sequence of Series
        Axes of one log, of one length and rate.
    models : mapping of axis to NoiseModel
        Structures; processes with a common name are one (:mod:`insemu.noise.shared`).
    tau_from, tau_to : float
        Scales (s) to use.
    steps : int
        How many times the covariance of the curves is renewed.
    confidence : float
        Level of the intervals.

    Returns
    -------
    dict of axis to FitResult
        Each with its own parameters and curve; ``test`` and ``objective`` are of all axes together, ``details["cross"]`` holds the
        :class:`~insemu.variance.WaveletCovariance` of each pair that shares a process.

    Raises
    ------
    InputError
        Axes of different lengths or rates, a name that one axis alone has, processes without randomness; what a single fit refuses.

    Notes
    -----
    Equations (20), (22)-(27) of Stebler et al. 2014 with the cross-covariances of Whitcher, Guttorp and Percival 2000 among the moments. The sign
    by which an axis sees a shared process follows from the cross-covariances.
    """
    for s in series:
        s.complete("a fit of axes together")
    lengths = {(len(s), s.rate_hz) for s in series}
    if len(lengths) != 1:
        raise InputError("axes that share a process must be sampled together, at one rate and of one length")
    for s in series:
        for p in models[s.name]:
            if p.single_draw:
                raise InputError(
                    f"{p} is a signal, not noise, and cannot be fitted together with other axes", where=s.name
                )
    for name, members in shared_processes(models).items():
        if len(members) < 2:
            raise InputError(
                f"the shared process '{name}' stands in the model of {members[0].axis} alone, expected two axes or more"
            )
    problem = _Moments.of(series, models, tau_from, tau_to)
    found = problem.started(series)
    V = np.eye(problem.value.size)
    for _ in range(max(steps, 1)):
        V = problem.covariance(found.models(found.start))
        found, _ = problem.minimised(found, root_of_inverse(V))
    V = problem.covariance(found.models(found.start))
    return problem.results(series, found, V, confidence)


@dataclass(frozen=True)
class _Tied:
    """Coordinates of all axes, where a shared process has one shape: ``place`` maps each axis's coordinates to the common ones."""

    axes: Mapping[str, Coordinates]
    place: Mapping[str, NDArray[np.intp]]
    start: Array

    @classmethod
    def of(cls, asked: Models, begin: Models, deviation: Mapping[str, float], dt: float) -> _Tied:
        axes = {a: Coordinates.of(asked[a], begin[a], deviation[a], dt) for a in asked}
        place: dict[str, NDArray[np.intp]] = {}
        start: list[float] = []
        ties: dict[tuple[str, str], int] = {}
        for a, c in axes.items():
            at = []
            for (k, name), value in zip(c.free, c.start, strict=True):
                p = asked[a].processes[k]
                key = (p.shared.lstrip("-"), name)
                if p.shared and name != p.level.name and key in ties:
                    at.append(ties[key])
                    continue
                at.append(len(start))
                if p.shared and name != p.level.name:
                    ties[key] = len(start)
                start.append(float(value))
            place[a] = np.array(at, dtype=np.intp)
        return cls(axes, place, np.array(start))

    def models(self, x: Array) -> dict[str, NoiseModel]:
        return {a: c.model(x[self.place[a]]) for a, c in self.axes.items()}

    def bounds(self, n: int, dt: float) -> tuple[Array, Array]:
        """Limits of the coordinates, see :meth:`~insemu.fit.coordinates.Coordinates.bounds`."""
        low, high = np.empty(self.start.size), np.empty(self.start.size)
        for a, c in self.axes.items():
            low[self.place[a]], high[self.place[a]] = replace(c, start=self.start[self.place[a]]).bounds(n, dt)
        return low, high

    def at(self, x: Array) -> _Tied:
        return _Tied(self.axes, self.place, x)


@dataclass(frozen=True)
class _Moments:
    """The moments of some axes: their curves and, behind them, the cross-covariances of the pairs that share a process."""

    asked: Models
    curves: Mapping[str, WaveletVariance]
    cross: Mapping[tuple[str, str], WaveletCovariance]
    use: NDArray[np.bool_]

    @classmethod
    def of(cls, series: Sequence[Series], models: Models, tau_from: float, tau_to: float) -> _Moments:
        by_name = {s.name: s for s in series}
        asked = {a: models[a].at_rate(s.rate_hz) for a, s in by_name.items()}
        for a, s in by_name.items():
            Structure.of(asked[a], s.rate_hz)  # refuses what cannot be fitted
        curves = {a: wavelet_variance(s.values, s.rate_hz) for a, s in by_name.items()}
        pairs = {
            (one.axis, two.axis): None
            for members in shared_processes(asked).values()
            for one, two in combinations(members, 2)
        }
        cross = {(a, b): wavelet_covariance(by_name[a].values, by_name[b].values, by_name[a].rate_hz) for a, b in pairs}
        tau = next(iter(curves.values())).tau_s
        use = (tau >= tau_from * (1 - 1e-9)) & (tau <= tau_to * (1 + 1e-9))
        return cls(asked, curves, cross, use)

    @property
    def scale(self) -> NDArray[np.int64]:
        return next(iter(self.curves.values())).scale_samples[self.use]

    @property
    def n(self) -> int:
        return next(iter(self.curves.values())).n_samples

    @property
    def dt(self) -> float:
        return 1.0 / next(iter(self.curves.values())).rate_hz

    @property
    def pairs(self) -> list[tuple[str, str]]:
        return [*((a, a) for a in self.curves), *self.cross]

    @property
    def value(self) -> Array:
        every = [*(c.value for c in self.curves.values()), *(c.value for c in self.cross.values())]
        return np.concatenate([v[self.use] for v in every])

    def expected(self, models: Models) -> Array:
        """All moments under the models, stacked."""
        own = [m.wavelet_variance(self.scale, self.dt) for m in models.values()]
        cross = {pair: np.zeros(self.scale.size) for pair in self.cross}
        for members in shared_processes(models).values():
            for one, two in combinations(members, 2):
                both = one.process.wavelet_variance(self.scale, self.dt) * two.process.wavelet_variance(
                    self.scale, self.dt
                )
                cross[one.axis, two.axis] += one.sign * two.sign * np.sqrt(both)
        return np.concatenate([*own, *cross.values()])

    def covariance(self, models: Models) -> Array:
        """Covariance of all moments of Gaussian signals of these models over the finite record.

        By Isserlis, that of the moments (a, b) and (c, d) is the sum over pairs of coefficients of C_ac C_bd + C_ad C_bc. Each C is a sum over
        processes, and for two processes the sum of products follows from the variances of their sum: :func:`model_covariance` of both less
        those of each.
        """
        units: list[Process] = []
        spectrum: dict[tuple[str, str], dict[int, float]] = {}

        def add(a: str, b: str, unit: int, size: float) -> None:
            for key in {(a, b), (b, a)}:
                spectrum.setdefault(key, {})[unit] = size

        for a, model in models.items():
            for p in model:
                if not p.shared:
                    units.append(p.with_parameters({p.level.name: 1.0}))
                    add(a, a, len(units) - 1, Seen(a, 0, p, 1.0).weight ** 2)
        for members in shared_processes(models).values():
            p = members[0].process
            units.append(p.with_parameters({p.level.name: 1.0}))
            for left in members:
                for right in members:
                    add(left.axis, right.axis, len(units) - 1, left.weight * right.weight)

        def alone(*parts: Process) -> Array:
            return _remembered(parts, self.n, tuple(self.scale.tolist()), self.dt)

        J = self.scale.size
        single = [alone(p) for p in units]
        product = np.empty((len(units), len(units), J, J))
        for k, one in enumerate(units):
            product[k, k] = 0.5 * single[k]
            for j in range(k):
                product[k, j] = product[j, k] = 0.25 * (alone(one, units[j]) - single[k] - single[j])
        S = np.array([[self._vector(spectrum.get((a, b), {}), len(units)) for b in models] for a in models])
        at = {name: i for i, name in enumerate(models)}
        pairs = [(at[first], at[second]) for first, second in self.pairs]
        V = np.empty((len(pairs), J, len(pairs), J))
        for i, (e, f) in enumerate(pairs):
            for j, (g, h) in enumerate(pairs):
                weights = np.outer(S[e, g], S[f, h]) + np.outer(S[e, h], S[f, g])
                V[i, :, j, :] = np.tensordot(weights, product, 2)
        size = len(pairs) * J
        V2 = V.reshape(size, size)
        return np.asarray(0.5 * (V2 + V2.T))

    @staticmethod
    def _vector(entries: Mapping[int, float], size: int) -> Array:
        out = np.zeros(size)
        for k, v in entries.items():
            out[k] = v
        return out

    # -- the search ---------------------------------------------------------------------------------------------------------------

    def started(self, series: Sequence[Series]) -> _Tied:
        """Shared processes from the cross-covariances, then the rest of each axis next to them."""
        begin = dict(self.asked)
        left = {pair: c.value[self.use].copy() for pair, c in self.cross.items()}
        for name, members in shared_processes(self.asked).items():
            shape, products = self._nearest(members, left)
            levels = self._levels(members, products)
            for seen in members:
                p = seen.process.of_coordinates(levels[seen.axis] ** 2, shape, self.dt)
                sign = "-" if levels[seen.axis] < 0 else ""
                parts = list(begin[seen.axis].processes)
                parts[seen.place] = _named(p, sign + name)
                begin[seen.axis] = NoiseModel(tuple(parts))
            unit = Structure.of(NoiseModel((_open(members[0].process),)), 1.0 / self.dt)
            curve = unit.columns(self.scale / 2.0, np.array(shape))[0][:, 0]
            for one, two in combinations(members, 2):
                left[one.axis, two.axis] -= levels[one.axis] * levels[two.axis] * curve
        asked = {}
        for a, model in self.asked.items():
            # the sign that was found belongs to the structure
            asked[a] = NoiseModel(tuple(_named(p, q.shared) for p, q in zip(model, begin[a], strict=True)))
            tau = self.scale[[0, -1]] * self.dt
            held = fit_curve(self.curves[a], begin[a], weighting="intervals", tau_from=tau[0], tau_to=tau[1], name=a)
            begin[a] = held.model
        deviation = {s.name: float(np.std(np.diff(s.values))) for s in series}
        return _Tied.of(asked, begin, deviation, self.dt)

    def _nearest(
        self, members: Sequence[Seen], left: Mapping[tuple[str, str], Array]
    ) -> tuple[tuple[float, ...], list[float]]:
        """Shape of a shared process whose curve is nearest to the cross-covariances, and the product of levels of each pair."""
        p = members[0].process
        structure = Structure.of(NoiseModel((_open(p),)), 1.0 / self.dt)
        pairs = [(one.axis, two.axis) for one, two in combinations(members, 2)]
        width = {
            pair: np.sqrt(self.curves[pair[0]].value * self.curves[pair[1]].value / self.cross[pair].edof)[self.use]
            for pair in pairs
        }
        held = p.coordinates(self.dt)[1]
        grid = [
            tuple(v if h is None else h for v, h in zip(g, held, strict=True))
            for g in p.shape_grid(self.n, 1, np.random.default_rng(0))
        ]
        best: tuple[float, tuple[float, ...], list[float]] | None = None
        for shape in dict.fromkeys(grid):
            curve = structure.columns(self.scale / 2.0, np.array(shape))[0][:, 0]
            products, misfit = [], 0.0
            for pair in pairs:
                b, y = curve / width[pair], left[pair] / width[pair]
                products.append(float(b @ y / (b @ b)))
                misfit += float(np.sum((y - products[-1] * b) ** 2))
            if best is None or misfit < best[0]:
                best = misfit, shape, products
        assert best is not None
        return best[1], best[2]

    def _levels(self, members: Sequence[Seen], products: Sequence[float]) -> dict[str, float]:
        """Levels (roots of coefficients, with signs) whose products these are; two axes share as their slow variances do."""
        names = [seen.axis for seen in members]
        sign = dict.fromkeys(names, 1.0)
        for (a, b), c in zip(combinations(names, 2), products, strict=True):
            if a == names[0] and c < 0:
                sign[b] = -1.0
        size = np.log(np.maximum(np.abs(products), 1e-300))
        rows = [[float(n in pair) for n in names] for pair in combinations(names, 2)]
        slow = np.array([0.5 * math.log(float(self.curves[a].value[self.use][-4:].mean())) for a in names])
        # what the products leave open (of two axes: the ratio) is taken from the slow variances
        solved = slow + np.linalg.pinv(np.array(rows)) @ (size - np.array(rows) @ slow)
        return {a: sign[a] * math.exp(v) for a, v in zip(names, solved, strict=True)}

    def minimised(self, tied: _Tied, W: Array, rows: NDArray[np.intp] | slice = slice(None)) -> tuple[_Tied, float]:
        """The nearest of some moments from a start, and the squared distance; correlation times stay where a record can show them."""
        x, squares = minimised(
            lambda x: self.expected(tied.models(x))[rows], self.value[rows], W, tied.start, tied.bounds(self.n, self.dt)
        )
        return tied.at(x), squares

    def _slopes(self, tied: _Tied, x: Array) -> Array:
        """Derivatives of the moments by the common coordinates."""
        return slopes(lambda at: self.expected(tied.models(at)), x)

    # -- the answer ---------------------------------------------------------------------------------------------------------------

    def results(self, series: Sequence[Series], tied: _Tied, V: Array, confidence: float) -> dict[str, FitResult]:
        """Each axis's own part of the joint estimate."""
        x, W = tied.start, root_of_inverse(V)
        residual = W @ (self.value - self.expected(tied.models(x)))
        D = self._slopes(tied, x)
        C, lost = parameter_covariance(D, W, V)
        test = self._test(tied, V)
        x = x - bias(lambda at: self.expected(tied.models(at)), x, D, W, C)
        models = tied.models(x)
        notes = ["the axes leave parameters of the shared process open; hold one of them"] if lost else []
        out = {}
        for s in series:
            coordinates, at = tied.axes[s.name], tied.place[s.name]
            slope = coordinates.slopes(x[at])
            own = slope[:, None] * C[np.ix_(at, at)] * slope[None, :]
            model, curve = models[s.name], self.curves[s.name]
            out[s.name] = FitResult(
                name=s.name,
                method="gmwm",
                structure=self.asked[s.name],
                model=model,
                rate_hz=s.rate_hz,
                n_samples=self.n,
                unit=s.unit,
                parameters=estimates(model, coordinates.free, own, s.unit, confidence),
                covariance=own,
                curve=curve,
                fitted=model.wavelet_variance(curve.scale_samples, self.dt),
                objective=float(residual @ residual),
                converged=True,
                warnings=tuple(notes),
                test=test,
                details={"weighting": "asymptotic", "free": coordinates.free, "cross": dict(self.cross)},
            )
        return out

    def _test(self, tied: _Tied, V: Array) -> GoodnessOfFit | None:
        """Test of over-identifying restrictions over the scales at which every axis has enough degrees of freedom."""
        J = self.scale.size
        expected = self.expected(tied.models(tied.start))
        sd = np.sqrt(np.diag(V)).reshape(-1, J)[: len(self.curves)]
        enough = (2.0 * (expected.reshape(-1, J)[: len(self.curves)] / sd) ** 2 >= TEST_DOF).all(axis=0)
        rows = np.flatnonzero(np.tile(enough, len(self.pairs)))
        dof = rows.size - tied.start.size
        if dof < 1:
            return None
        _, statistic = self.minimised(tied, root_of_inverse(V[np.ix_(rows, rows)]), rows)
        used = np.asarray(self.scale[enough] * self.dt, dtype=np.float64)
        return GoodnessOfFit(statistic, dof, float(scipy.special.chdtrc(dof, statistic)), used)


@lru_cache(maxsize=512)
def _remembered(parts: tuple[Process, ...], n: int, scale: tuple[int, ...], dt: float) -> Array:
    """:func:`model_covariance` of some unit processes; most of them have no shape and are asked for again and again."""
    return model_covariance(NoiseModel(parts), n, scale, dt)


def _open(process: Process) -> Process:
    """The structure of a process without a value."""
    return process.with_parameters(dict.fromkeys(process.given))


def _named(process: Process, shared: str) -> Process:
    return replace(process, shared=shared)
