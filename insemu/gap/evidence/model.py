"""One currency: nats of log-evidence of an explanation of a static log, its free parameters paid for.

An :class:`Explanation` is what an axis is thought to consist of: processes with free parameters, an optional roll-off of the output filter,
regressors with Gaussian priors. Its evidence is the posterior's mass by Laplace's approximation at the refined optimum; a parameter that
the data leave undetermined is never worth more than its prior's width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from insemu.gap.data.log import Reduced, density, difference_covariance, of_unit_level
from insemu.gap.evidence import kernels
from insemu.gap.evidence.linear import regression_evidence, stationary_score
from insemu.gap.policy import rules
from insemu.noise import NoiseModel, Process

Array = NDArray[np.float64]

#: Softness, in log, of the bounds of a free parameter and of the border of a nominal level's tolerance: Laplace's approximation needs a slope.
EDGE, TOLERANCE_EDGE = 0.3, 0.02
#: Finding of the differences that give the curvature at a mode, in log.
CURVATURE_STEP = 5e-3


@dataclass(frozen=True)
class Free:
    """A positive free parameter: flat prior in its logarithm between two bounds, with Gaussian edges of width ``edge``.

    Parameters
    ----------
    name : str
        Parameter of the process.
    low, high : float
        Bounds, in the parameter's own unit.
    edge : float
        Softness of the bounds, in log.
    """

    name: str
    low: float
    high: float
    edge: float = EDGE

    @property
    def width(self) -> float:
        """Mass-equivalent width of the prior, in log."""
        return math.log(self.high / self.low) + self.edge * math.sqrt(2.0 * math.pi)

    def log_density(self, x: float) -> float:
        """Log prior density of the logarithm ``x``."""
        outside = max(math.log(self.low) - x, x - math.log(self.high), 0.0)
        return -math.log(self.width) - 0.5 * (outside / self.edge) ** 2

    def admits(self, x: float) -> bool:
        """Whether the logarithm ``x`` is inside the bounds or no more than six edges outside."""
        return math.log(self.low) - 6.0 * self.edge <= x <= math.log(self.high) + 6.0 * self.edge

    @property
    def sigma(self) -> float:
        """Standard deviation of the prior, in log: the most that an estimate can be uncertain."""
        return self.width / math.sqrt(12.0)


def level(name: str, value: float, uncertainty: float | None = None, power: int = 1) -> Free:
    """A nominal level that may be wrong by ``uncertainty`` (relative); as much as the policy says where it is not given.

    Parameters
    ----------
    name : str
        Parameter.
    value : float
        Its nominal value, in its own unit.
    uncertainty : float, optional
        Of the signal.
    power : int
        Power of the signal in the parameter: 2 for a variance.
    """
    uncertainty = rules().tolerance if uncertainty is None else uncertainty
    factor = (1.0 + uncertainty) ** power
    return Free(name, value / factor, value * factor, TOLERANCE_EDGE * power)


@dataclass(frozen=True)
class Component:
    """A process of an explanation: its parameters, which of them are free, and the effect that brought it in."""

    process: Process
    free: tuple[Free, ...]
    effect: str = "nominal"


#: Depth below the white noise to which a filtered spectrum is compared. Deeper, a bin is not even, and tapers and rounding are seen.
DEPTH = 1e-5

#: Frequency at which a window halves the power, times its length (two of them for the triangular one).
HALF_POWER = {"moving average": 0.44295, "triangular window": 0.31894}


@dataclass(frozen=True)
class Rolloff:
    """A low-pass of the output: ``butterworth`` (corner and order), ``moving average`` (of length ``1 / corner``), ``exponential``.

    ``floor`` (a two-sided PSD) is added to measured and modelled spectrum alike, so that neither is compared where next to nothing is left.
    """

    kind: str
    values: tuple[float, ...]
    free: tuple[Free, ...]
    effect: str = "decimation_filter"
    floor: float = 0.0

    def gain(self, f: Array, dt: float) -> Array:
        """Power gain at frequencies ``f`` of samples at interval ``dt``."""
        corner = self.values[0]
        if self.kind == "moving average":
            return np.asarray(np.sinc(f / corner) ** 2)
        if self.kind == "triangular window":
            return np.asarray(np.sinc(f / corner) ** 4)
        if self.kind == "exponential":
            phi = math.exp(-2.0 * math.pi * corner * dt)
            return np.asarray((1.0 - phi) ** 2 / ((1.0 - phi) ** 2 + 4.0 * phi * np.sin(np.pi * f * dt) ** 2))
        # a digital Butterworth (bilinear): the corner is where the power is halved
        edge = math.tan(math.pi * min(corner * dt, 0.499))
        ratio = np.tan(np.pi * np.minimum(f * dt, 0.4999)) / edge
        exponent = np.minimum(2.0 * self.values[1] * np.log(ratio), 300.0)
        return np.asarray(1.0 / (1.0 + np.exp(exponent)))

    def delay(self, dt: float) -> float:
        """By how much a causal filter of this gain is late for slow signals, s."""
        corner = self.values[0]
        if self.kind == "moving average":
            return max(0.5 * (1.0 / corner - dt), 0.0)
        if self.kind == "triangular window":
            return max(1.0 / corner - dt, 0.0)
        if self.kind == "exponential":
            phi = math.exp(-2.0 * math.pi * corner * dt)
            return dt * phi / (1.0 - phi)
        edge = 2.0 / dt * math.tan(math.pi * min(corner * dt, 0.499))
        return 1.0 / (edge * math.sin(0.5 * math.pi / max(self.values[1], 1.0)))


@dataclass(frozen=True)
class Regressors:
    """Signals of known shape in the data: block-mean differences as columns, prior scale of each coefficient."""

    effect: str
    names: tuple[str, ...]
    columns: Array
    scales: Array
    rebuild: Callable[[Reduced, Array | None], Array] | None = (
        None  # the same columns for other data, given its temperature
    )


#: Shapes of one process that a climb remembers; the step in log by which a shape parameter is moved for a derivative.
MOST_SHAPES, SHAPE_STEP = 64, 1e-6
#: Frequencies up to which a spectrum is worked out at each, and the relative distance of those between which it is interpolated beyond.
MOST_EXACT, NEARNESS = 32_768, 2e-4


@dataclass(frozen=True)
class Explanation:
    """What an axis is thought to consist of; immutable, so that adding and dropping effects is cheap and safe."""

    components: tuple[Component, ...]
    rolloff: Rolloff | None = None
    regressors: tuple[Regressors, ...] = ()

    @classmethod
    def nominal(cls, model: NoiseModel) -> Explanation:
        """The belief, with the level of every noise free by 20 %.

        A process of one draw is a signal and no noise; one of level zero, as a fit leaves it that found none, is not there.
        """
        out = []
        for p in model:
            value = abs(p.parameters[p.level.name])
            if value > 0:
                free = () if p.single_draw else (level(p.level.name, value, power=p.level.power),)
                out.append(Component(p, free))
        return cls(tuple(out))

    @property
    def free(self) -> tuple[Free, ...]:
        """All free parameters, component by component, the roll-off last."""
        own = tuple(f for c in self.components for f in c.free)
        return own + (self.rolloff.free if self.rolloff else ())

    def start(self) -> Array:
        """Logarithms of the current parameters, in the order of :attr:`free`."""
        values = [math.log(getattr(c.process, f.name)) for c in self.components for f in c.free]
        return np.array(values + ([math.log(v) for v in self.rolloff.values] if self.rolloff else []))

    def at(self, x: Array) -> Explanation:
        """The explanation with the parameters whose logarithms are ``x``."""
        components, k = [], 0
        for c in self.components:
            values = {f.name: math.exp(x[k + i]) for i, f in enumerate(c.free)}
            k += len(c.free)
            components.append(replace(c, process=c.process.with_parameters(values)) if values else c)
        rolloff = replace(self.rolloff, values=tuple(math.exp(v) for v in x[k:])) if self.rolloff else None
        return replace(self, components=tuple(components), rolloff=rolloff)

    def with_component(self, component: Component) -> Explanation:
        """The explanation with a process added."""
        return replace(self, components=(*self.components, component))

    @property
    def model(self) -> NoiseModel:
        """The processes as a noise model."""
        return NoiseModel(tuple(c.process for c in self.components))

    def psd(self, f: Array, dt: float) -> Array:
        """Two-sided PSD of the samples; of very many frequencies, interpolated between ones so near that no resonance falls between them."""
        if f.size > MOST_EXACT and f[0] > 0.0:
            grid = np.geomspace(f[0], f[-1], math.ceil(math.log(f[-1] / f[0]) / NEARNESS) + 1)
            grid[-1] = f[-1]
            return np.interp(f, grid, self._psd(grid, dt)) if grid.size < f.size else self._psd(f, dt)
        return self._psd(f, dt)

    def _psd(self, f: Array, dt: float) -> Array:
        total = np.zeros_like(f)
        for c in self.components:
            total += density(c.process, f, dt)
        return total * self.rolloff.gain(f, dt) + self.rolloff.floor if self.rolloff else total

    def seen(self, data: Reduced) -> Array:
        """Measured PSD of the bins as it is compared with :meth:`psd`."""
        return data.power + self.rolloff.floor if self.rolloff else data.power

    def covariance(self, block: int, dt: float, count: int) -> Array:
        """Autocovariance of the block-mean differences."""
        total = np.zeros(count)
        for c in self.components:
            total += difference_covariance(c.process, block, dt, count)
        return total


@dataclass
class Likelihood:
    """Log-likelihood of one reduced axis; remembers the low band, which most candidates leave alone."""

    data: Reduced
    _memory: dict[bytes, float] = field(default_factory=dict, repr=False)

    def low(self, explanation: Explanation) -> float:
        """Gaussian log-likelihood of the block differences, regressors integrated out."""
        data = self.data
        if not data.differences.size:
            return 0.0
        return self.low_of(explanation.covariance(data.block, data.dt, data.differences.size), explanation.regressors)

    def low_of(self, gamma: Array, regressors: Sequence[Regressors]) -> float:
        """The same, of an autocovariance."""
        key = gamma.tobytes() + b"".join(r.columns[:8].tobytes() + r.scales.tobytes() for r in regressors)
        known = self._memory.get(key)
        if known is not None:
            return known
        stacked = np.hstack([self.data.differences[:, None], *(r.columns for r in regressors)])
        white = np.empty_like(stacked)
        logdet = kernels.toeplitz_whiten(gamma, stacked, white)
        if not math.isfinite(logdet):
            return -math.inf
        e, G = white[:, 0], white[:, 1:]
        value = -0.5 * (logdet + float(e @ e))
        if G.shape[1]:
            scales = np.concatenate([r.scales for r in regressors])
            value += regression_evidence(G.T @ G, G.T @ e, scales)
        if len(self._memory) > 500:
            self._memory.clear()
        self._memory[key] = value
        return value

    def score_of(self, gamma: Array, regressors: Sequence[Regressors] = ()) -> tuple[float, Array] | None:
        """:meth:`low_of` and its derivatives by the autocovariance; ``None`` where that is not positive definite."""
        rows = np.vstack([self.data.differences, *(r.columns.T for r in regressors)])
        return stationary_score(gamma, rows, np.concatenate([np.empty(0), *(r.scales for r in regressors)]))

    def high(self, explanation: Explanation) -> float:
        """Whittle's log-likelihood of the spectrum."""
        if not self.data.f.size:
            return 0.0
        return self.high_of(explanation.psd(self.data.f, self.data.dt), explanation.seen(self.data))

    def high_of(self, S: Array, seen: Array) -> float:
        """The same, of a density and what is compared with it."""
        if not (S > 0).all():
            return -math.inf
        return float(-0.5 * np.sum(self.data.counted * (np.log(S) + seen / S)))

    def along(self, explanation: Explanation) -> Along:
        """:meth:`log_posterior` as a function of the logarithms of the free parameters."""
        return Along(self, explanation)

    def log_posterior(self, explanation: Explanation) -> float:
        """Log-likelihood plus log prior density of the free parameters."""
        x = explanation.start()
        if any(not f.admits(v) for f, v in zip(explanation.free, x, strict=True)):
            return -math.inf
        prior = sum(f.log_density(v) for f, v in zip(explanation.free, x, strict=True))
        return self.low(explanation) + self.high(explanation) + prior

    def coefficients(self, explanation: Explanation) -> tuple[Array, Array]:
        """Posterior mean and covariance of the regressors' coefficients at the explanation's parameters."""
        y = self.data.differences
        gamma = explanation.covariance(self.data.block, self.data.dt, y.size)
        stacked = np.hstack([y[:, None], *(r.columns for r in explanation.regressors)])
        white = np.empty_like(stacked)
        kernels.toeplitz_whiten(gamma, stacked, white)
        G = white[:, 1:]
        scales = np.concatenate([r.scales for r in explanation.regressors]) * max(rules().prior_scales)
        covariance = np.linalg.inv(G.T @ G + np.diag(1.0 / scales**2))
        return covariance @ (G.T @ white[:, 0]), covariance


class Along:
    """The log posterior of an explanation as a function of the logarithms of its free parameters, inside their bounds.

    What does not depend on them is worked out once, and the shape of a process again only where one of its shape parameters moves.
    """

    def __init__(self, likelihood: Likelihood, explanation: Explanation) -> None:
        self.likelihood, self.explanation = likelihood, explanation
        data = likelihood.data
        self._psd, self._covariance = np.zeros_like(data.f), np.zeros(data.differences.size)
        self._moving: list[tuple[Process, list[str], int, dict[tuple[float, ...], tuple[Array, Array]]]] = []
        for c in explanation.components:
            names = [f.name for f in c.free]
            at = names.index(c.process.level.name) if c.process.level.name in names else -1
            if names:
                self._moving.append((of_unit_level(c.process) if at >= 0 else c.process, names, at, {}))
            else:
                psd, covariance = self._shape(c.process)
                self._psd, self._covariance = self._psd + psd, self._covariance + covariance
        self._seen = explanation.seen(data)
        self._prior = [(math.log(f.low), math.log(f.high), f.edge, math.log(f.width)) for f in explanation.free]

    def _shape(self, process: Process) -> tuple[Array, Array]:
        data, count = self.likelihood.data, self._covariance.size
        covariance = difference_covariance(process, data.block, data.dt, count) if count else np.zeros(0)
        return density(process, data.f, data.dt), covariance

    def _moved(self, process: Process, names: Sequence[str], own: Sequence[float]) -> tuple[Array, Array]:
        """As :meth:`_shape` at other shape parameters, which a climb hardly ever comes back to."""
        data, count = self.likelihood.data, self._covariance.size
        moved = process.with_parameters({n: math.exp(v) for n, v in zip(names, own, strict=True)})
        covariance = moved.difference_covariance(data.block, data.dt, count) if count else np.zeros(0)
        return moved.psd(data.f, data.dt), covariance

    def _unit(
        self,
        process: Process,
        names: Sequence[str],
        own: Sequence[float],
        known: dict[tuple[float, ...], tuple[Array, Array]],
    ) -> tuple[Array, Array]:
        """Density and covariance of a process at unit level and these logarithms of its shape parameters."""
        key = tuple(own)
        if key not in known:
            if len(known) > MOST_SHAPES:
                known.clear()
            known[key] = self._moved(process, names, own) if names else self._shape(process)
        return known[key]

    def _sum(self, x: Array, slopes: list[tuple[Array, Array]] | None = None) -> tuple[Array, Array]:
        """Density before the roll-off and covariance at ``x``; their derivatives by each parameter are appended to ``slopes``."""
        psd, covariance, k = self._psd, self._covariance, 0
        for process, names, at, known in self._moving:
            own = x[k : k + len(names)].tolist()
            power = 2 // process.level.power
            size = math.exp(power * own.pop(at)) if at >= 0 else 1.0
            others = [n for i, n in enumerate(names) if i != at]
            unit = self._unit(process, others, own, known)
            psd, covariance = psd + size * unit[0], covariance + size * unit[1]
            if slopes is not None:
                mine = []
                for i in range(len(own)):
                    moved = [v + SHAPE_STEP * (n == i) for n, v in enumerate(own)]
                    more = self._unit(process, others, moved, known)
                    mine.append(tuple(size / SHAPE_STEP * (a - b) for a, b in zip(more, unit, strict=True)))
                if at >= 0:
                    mine.insert(at, (power * size * unit[0], power * size * unit[1]))
                slopes += [(a, b) for a, b in mine]
            k += len(names)
        return psd, covariance

    def _gain(self, x: Array) -> Array | float:
        rolloff, data = self.explanation.rolloff, self.likelihood.data
        if rolloff is None:
            return 1.0
        at = x[x.size - len(rolloff.free) :]
        return replace(rolloff, values=tuple(math.exp(v) for v in at)).gain(data.f, data.dt)

    def __call__(self, x: Array) -> float:
        """Log likelihood plus log prior density."""
        psd, covariance = self._sum(x)
        total = 0.0
        for v, (low, high, edge, width) in zip(x, self._prior, strict=True):
            total -= width + 0.5 * (max(low - v, v - high, 0.0) / edge) ** 2
        if psd.size:
            floor = self.explanation.rolloff.floor if self.explanation.rolloff else 0.0
            total += self.likelihood.high_of(psd * self._gain(x) + floor, self._seen)
        return total + (self.likelihood.low_of(covariance, self.explanation.regressors) if covariance.size else 0.0)

    def slope(self, x: Array) -> tuple[float, Array] | None:
        """The same with its derivatives; ``None`` where it is not finite."""
        slopes: list[tuple[Array, Array]] = []
        psd, covariance = self._sum(x, slopes)
        value, out = 0.0, np.zeros(x.size)
        for k, (v, (low, high, edge, width)) in enumerate(zip(x, self._prior, strict=True)):
            outside = max(low - v, v - high, 0.0)
            value -= width + 0.5 * (outside / edge) ** 2
            out[k] = math.copysign(outside, low - v if v < low else low - high) / edge**2
        if psd.size:
            rolloff, gain = self.explanation.rolloff, self._gain(x)
            S = psd * gain + (rolloff.floor if rolloff else 0.0)
            if not (S > 0).all():
                return None
            value += self.likelihood.high_of(S, self._seen)
            by_density = -0.5 * self.likelihood.data.counted * (1.0 - self._seen / S) / S
            out[: len(slopes)] += [float(by_density @ (gain * d)) for d, _ in slopes]
            for k in range(len(slopes), x.size):
                moved = np.asarray(self._gain(x + SHAPE_STEP * (np.arange(x.size) == k)))
                out[k] += float(by_density @ (psd * (moved - gain))) / SHAPE_STEP
        if covariance.size:
            scored = self.likelihood.score_of(covariance, self.explanation.regressors)
            if scored is None:
                return None
            value += scored[0]
            out[: len(slopes)] += [float(scored[1] @ d) for _, d in slopes]
        return (value, out) if math.isfinite(value) and np.isfinite(out).all() else None


@dataclass(frozen=True)
class Fitted:
    """An explanation at its refined optimum.

    Parameters
    ----------
    explanation : Explanation
        With the most probable parameters.
    evidence : float
        Log evidence, nats.
    covariance : (k, k) array
        Of the logarithms of the free parameters.
    log_posterior : float
        At the optimum.
    """

    explanation: Explanation
    evidence: float
    covariance: Array
    log_posterior: float

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations of the logarithms of the free parameters."""
        return np.sqrt(np.diag(self.covariance))


def fit(likelihood: Likelihood, explanation: Explanation) -> Fitted:
    """Refine an explanation from its current parameters and weigh it.

    The evidence is Laplace's, with each parameter's posterior width limited to that of its prior.
    """
    along = likelihood.along(explanation)
    found = laplace(along, explanation.start(), explanation.free, along.slope)
    return Fitted(explanation.at(found.x), found.evidence, found.covariance, found.log_posterior)


@dataclass(frozen=True)
class Mode:
    """A posterior mode: logarithms of the parameters, their covariance, log posterior there, log evidence."""

    x: Array
    covariance: Array
    log_posterior: float
    evidence: float


def laplace(
    log_posterior: Callable[[Array], float],
    x0: Array,
    free: Sequence[Free],
    slope: Callable[[Array], tuple[float, Array] | None] | None = None,
    close: float = 0.0,
) -> Mode:
    """Climb to a mode and weigh it; no direction counts as wider than its prior.

    Parameters
    ----------
    log_posterior : callable
        Of the logarithms of the parameters.
    x0 : (k,) array
        Where to start.
    free : sequence of Free
    slope : callable, optional
        The log posterior with its derivatives, or ``None`` where it has none; by differences where it is not given.
    close : float
        The climb ends where a step gains less, nats: a likelihood that is a run of a filter is worth stopping early.
    """
    admitted = [(math.log(f.low) - 6.0 * f.edge, math.log(f.high) + 6.0 * f.edge) for f in free]

    def cost(x: Array) -> float:
        if any(not low <= v <= high for v, (low, high) in zip(x, admitted, strict=True)):
            return 1e12 + float(np.sum((x - x0) ** 2))  # however strong the evidence
        value = -log_posterior(x)
        return value if math.isfinite(value) else 1e12

    if not x0.size:
        top = log_posterior(x0)
        return Mode(x0, np.zeros((0, 0)), top, top)
    x0 = np.clip(x0, [math.log(f.low) for f in free], [math.log(f.high) for f in free])
    # curvatures differ by orders of magnitude (a million samples against a handful of blocks): climb in standardised coordinates
    prior = np.array([1.0 / f.sigma**2 for f in free])
    centre, step = cost(x0), 3e-3
    bend = np.array([(cost(x0 + e) + cost(x0 - e) - 2.0 * centre) / step**2 for e in np.eye(x0.size) * step])
    unit = 1.0 / np.sqrt(np.maximum(np.where(np.isfinite(bend), bend, 0.0), prior))
    # so far inside the bounds that the curvature is not taken across them
    beyond = [6.0 * f.edge - 1.1 * CURVATURE_STEP for f in free]
    reach = [
        ((math.log(f.low) - b - c) / u, (math.log(f.high) + b - c) / u)
        for f, b, c, u in zip(free, beyond, x0, unit, strict=True)
    ]

    def sloped(z: Array) -> tuple[float, Array]:
        """Cost and its derivatives; by differences, they are forward ones, backward at the edge."""
        known = slope(x0 + unit * z) if slope is not None else None
        if known is not None:
            return -known[0], -unit * known[1]
        here, out = cost(x0 + unit * z), np.empty(z.size)
        for i in range(z.size):
            moved = z.copy()
            moved[i] += 1e-3 if z[i] + 1e-3 <= reach[i][1] else -1e-3
            out[i] = (cost(x0 + unit * moved) - here) / (moved[i] - z[i])
        return here, out

    minimize: Any = optimize.minimize
    result = minimize(
        sloped,
        np.zeros(x0.size),
        jac=True,
        method="L-BFGS-B",
        bounds=reach,
        options={"maxiter": 60, "ftol": max(1e-9, close / max(abs(centre), 1.0))},
    )
    x, best = x0 + unit * np.asarray(result.x, dtype=np.float64), float(result.fun)
    H = _hessian(cost, x, best, slope)
    scale = np.array([1.0 / f.sigma for f in free])
    eigenvalues, vectors = np.linalg.eigh(H / scale[:, None] / scale[None, :])
    eigenvalues = np.maximum(eigenvalues, 1.0)
    covariance = (vectors / eigenvalues) @ vectors.T / scale[:, None] / scale[None, :]
    logdet = float(np.sum(np.log(eigenvalues)) + 2.0 * np.sum(np.log(scale)))
    return Mode(x, covariance, -best, -best + 0.5 * x.size * math.log(2.0 * math.pi) - 0.5 * logdet)


def _hessian(
    cost: Callable[[Array], float],
    x: Array,
    centre: float,
    slope: Callable[[Array], tuple[float, Array] | None] | None,
) -> Array:
    """Second derivatives of a cost: differences of the derivatives where there are any, else of the cost itself."""
    n, h = x.size, CURVATURE_STEP
    H = np.empty((n, n))
    steps = np.eye(n) * h
    if slope is not None:
        sides = [(slope(x - s), slope(x + s)) for s in steps]
        if all(a is not None and b is not None for a, b in sides):
            H = np.stack([(a[1] - b[1]) / (2.0 * h) for a, b in sides if a is not None and b is not None])
            return 0.5 * (H + H.T)
    plus = np.array([cost(x + s) for s in steps])
    minus = np.array([cost(x - s) for s in steps])
    for i in range(n):
        H[i, i] = (plus[i] + minus[i] - 2.0 * centre) / h**2
        for j in range(i):
            both = cost(x + steps[i] + steps[j])
            H[i, j] = H[j, i] = (both - plus[i] - plus[j] + centre) / h**2
    return H
