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

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, density, difference_covariance, of_unit_level
from insemu.gap.evidence import kernels
from insemu.gap.evidence.linear import regression_evidence, stationary_score
from insemu.gap.evidence.modes import Free, Mode, Slope, ascend, level
from insemu.gap.policy import rules
from insemu.noise import NoiseModel, Process

Array = NDArray[np.float64]


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
        return self.log_posteriors([explanation])[0]

    def log_posteriors(self, explanations: Sequence[Explanation]) -> list[float]:
        """The same of several explanations; what a component that they share contributes is worked out once."""
        parts: dict[int, tuple[Array, Array]] = {}
        return [self._log_posterior(e, parts) for e in explanations]

    def _log_posterior(self, explanation: Explanation, parts: dict[int, tuple[Array, Array]]) -> float:
        x, data, count = explanation.start(), self.data, self.data.differences.size
        if any(not f.admits(v) for f, v in zip(explanation.free, x, strict=True)):
            return -math.inf
        total = sum(f.log_density(v) for f, v in zip(explanation.free, x, strict=True))
        psd, covariance = np.zeros_like(data.f), np.zeros(count)
        for c in explanation.components:
            if id(c) not in parts:
                parts[id(c)] = (
                    density(c.process, data.f, data.dt),
                    difference_covariance(c.process, data.block, data.dt, count),
                )
            psd += parts[id(c)][0]
            covariance += parts[id(c)][1]
        if count:
            total += self.low_of(covariance, explanation.regressors)
        if psd.size:
            low_pass = explanation.rolloff
            S = psd * low_pass.gain(data.f, data.dt) + low_pass.floor if low_pass else psd
            total += self.high_of(S, explanation.seen(data))
        return total

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


#: Derivatives of density (k, bins) and covariance (k, lags) by k parameters.
Slopes = tuple[Array, Array]


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
        moved = process.unchecked({n: math.exp(v) for n, v in zip(names, own, strict=True)})
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

    def _sum(self, x: Array, by: Slopes | None = None) -> tuple[Array, Array]:
        """Density before the roll-off and covariance at ``x``; their derivatives by each parameter are written to ``by``."""
        psd, covariance, k = self._psd.copy(), self._covariance.copy(), 0
        for process, names, at, known in self._moving:
            own = x[k : k + len(names)].tolist()
            power = 2 // process.level.power
            size = math.exp(power * own.pop(at)) if at >= 0 else 1.0
            others = [n for i, n in enumerate(names) if i != at]
            unit = self._unit(process, others, own, known)
            here = (size * unit[0], size * unit[1])
            psd += here[0]
            covariance += here[1]
            if by is not None:
                rows = [k + i for i in range(len(names)) if i != at]
                for i, row in enumerate(rows):
                    moved = [v + SHAPE_STEP * (n == i) for n, v in enumerate(own)]
                    more = self._unit(process, others, moved, known)
                    for out, a, b in zip(by, more, unit, strict=True):
                        np.subtract(a, b, out=out[row])
                        out[row] *= size / SHAPE_STEP
                if at >= 0:
                    for out, part in zip(by, here, strict=True):
                        np.multiply(part, float(power), out=out[k + at])
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

    def gradient(self, x: Array) -> Slope | None:
        """As :meth:`slope`, the expected curvature that of the prior's edges alone."""
        return self.slope(x, informed=False)

    def slope(self, x: Array, informed: bool = True) -> Slope | None:
        """The same with its derivatives and, where ``informed``, expected curvature; ``None`` where it is not finite."""
        by = (np.zeros((x.size, self._psd.size)), np.zeros((x.size, self._covariance.size)))
        psd, covariance = self._sum(x, by)
        value, gradient, information = 0.0, np.zeros(x.size), np.zeros((x.size, x.size))
        for k, (v, (low, high, edge, width)) in enumerate(zip(x.tolist(), self._prior, strict=True)):
            outside = max(low - v, v - high, 0.0)
            value -= width + 0.5 * (outside / edge) ** 2
            gradient[k] = math.copysign(outside, low - v if v < low else low - high) / edge**2
            information[k, k] = 1.0 / edge**2 if outside else 0.0
        if psd.size:
            rolloff, gain = self.explanation.rolloff, self._gain(x)
            S = psd * gain + (rolloff.floor if rolloff else 0.0)
            if not (S > 0).all():
                return None
            counted, ratio = self.likelihood.data.counted, self._seen / S
            value += float(-0.5 * (counted @ (np.log(S) + ratio)))
            relative = by[0] * (gain / S)
            for k in range(x.size - len(rolloff.free) if rolloff else x.size, x.size):
                moved = np.asarray(self._gain(x + SHAPE_STEP * (np.arange(x.size) == k)))
                relative[k] = psd * (moved - gain) / (SHAPE_STEP * S)
            gradient += relative @ (0.5 * counted * (ratio - 1.0))
            if informed:
                information += (relative * (0.5 * counted)) @ relative.T
        if covariance.size:
            scored = self.likelihood.score_of(covariance, self.explanation.regressors)
            if scored is None:
                return None
            value += scored[0]
            gradient += by[1] @ scored[1]
            if informed:
                information += _asymptotic_information(covariance, by[1])
        return Slope(value, gradient, information) if math.isfinite(value) and np.isfinite(gradient).all() else None


#: Share of its largest value below which a density of the differences counts as that: sampled covariances do not resolve less.
LEAST_DENSITY = 1e-4


def _asymptotic_information(covariance: Array, by: Array) -> Array:
    """Information of a stationary Gaussian vector on its parameters, as that of its spectrum (Whittle 1953).

    Parameters
    ----------
    covariance : (n,) array
        At lags 0 to n - 1.
    by : (k, n) array
        Its derivatives by each parameter.
    """
    n = covariance.size
    size = 1 << (2 * n - 1).bit_length()
    rows = np.vstack([covariance, by])
    density = 2.0 * np.fft.rfft(rows, size).real - rows[:, :1]
    relative = density[1:] / np.maximum(density[0], LEAST_DENSITY * float(density[0].max()))
    return np.asarray(0.5 * n / relative.shape[1] * (relative @ relative.T))


@dataclass(frozen=True)
class Fitted:
    """An explanation at its refined optimum.

    Parameters
    ----------
    explanation : Explanation
        With the most probable parameters.
    mode : Mode
        The optimum in the logarithms of the free parameters.
    """

    explanation: Explanation
    mode: Mode

    @property
    def evidence(self) -> float:
        """Log evidence, nats."""
        return self.mode.evidence

    @property
    def covariance(self) -> Array:
        """Of the logarithms of the free parameters, (k, k)."""
        return self.mode.covariance

    @property
    def log_posterior(self) -> float:
        """At the optimum."""
        return self.mode.log_posterior

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations of the logarithms of the free parameters."""
        return np.sqrt(np.diag(self.covariance))


def fit(likelihood: Likelihood, explanation: Explanation, known: Sequence[Fitted] = ()) -> Fitted:
    """Refine an explanation from its current parameters and weigh it.

    The evidence is Laplace's, with each parameter's posterior width limited to that of its prior.

    Parameters
    ----------
    likelihood : Likelihood
    explanation : Explanation
    known : sequence of Fitted
        Explanations of the same form at their optimum: one of them is returned where the climb leads there.
    """
    along = likelihood.along(explanation)
    modes = [f.mode for f in known]
    found = ascend(along.slope, explanation.start(), explanation.free, modes, beside=along.gradient)
    same = next((f for f in known if f.mode is found), None)
    return same or Fitted(explanation.at(found.x), found)
