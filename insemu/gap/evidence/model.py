"""One currency: nats of log-evidence of an explanation of a static log, its free parameters paid for.

An :class:`Explanation` is what an axis is thought to consist of: processes with free parameters, an optional roll-off of the output filter,
regressors with Gaussian priors. Its evidence is the posterior's mass by Laplace's approximation at the refined optimum; a parameter that
the data leave undetermined is never worth more than its prior's width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, density, difference_covariance, of_unit_level
from insemu.gap.evidence import kernels
from insemu.gap.evidence.linear import regression_evidence, stationary_score
from insemu.gap.evidence.modes import Free, Mode, Slope, ascend, level
from insemu.gap.evidence.rolloff import Rolloff, gains
from insemu.gap.evidence.shapes import Shaping, pairs, spectrum_of
from insemu.gap.policy import rules
from insemu.noise import NoiseModel, Process

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Component:
    """A process of an explanation: its parameters, which of them are free, and the effect that brought it in."""

    process: Process
    free: tuple[Free, ...]
    effect: str = "nominal"


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

    def score_of(self, gamma: Array, regressors: Sequence[Regressors] = ()) -> tuple[float, Array, Array] | None:
        """:meth:`low_of` with what :func:`stationary_score` says of it; ``None`` where the autocovariance is not positive definite."""
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


class Along:
    """The log posterior of an explanation as a function of the logarithms of its free parameters, inside their bounds.

    Density and covariance are sums over rows: one of what does not depend on the parameters, and for every component with free ones those of its
    :class:`Shape`, times its level. A component's rows are worked out again only where one of its shape parameters moves.
    """

    def __init__(self, likelihood: Likelihood, explanation: Explanation) -> None:
        self.likelihood, self.explanation = likelihood, explanation
        data, count = likelihood.data, likelihood.data.differences.size
        self._seen, self._half = np.ascontiguousarray(explanation.seen(data)), np.ascontiguousarray(0.5 * data.counted)
        self._flat = np.ones((1, data.f.size))
        self._prior = [(math.log(f.low), math.log(f.high), f.edge, math.log(f.width)) for f in explanation.free]
        self._low_pass = len(explanation.rolloff.free) if explanation.rolloff else 0
        still = [Shaping(data, c.process).plain() for c in explanation.components if not c.free]
        self._moving = list(_moving(data, explanation.components))
        self._places = _Places(self._moving)
        self._density = np.zeros((self._places.rows, data.f.size))
        self._covariance = np.zeros((self._places.rows, count))
        self._density[0] = sum((psd for psd, _ in still), np.zeros(data.f.size))
        self._covariance[0] = sum((covariance for _, covariance in still), np.zeros(count))
        self._spectrum = spectrum_of(self._covariance)

    def _gains(self, x: Array) -> Array:
        """Power gain of the roll-off with its derivatives by its parameters, the last of all; one where there is none."""
        rolloff, data = self.explanation.rolloff, self.likelihood.data
        if rolloff is None:
            return self._flat
        return gains(rolloff.kind, [math.exp(v) for v in x[x.size - self._low_pass :]], data.f, data.dt)

    def __call__(self, x: Array) -> float:
        """Log likelihood plus log prior density."""
        psd, covariance = self._density[0], self._covariance[0]
        for part in self._moving:
            size, own = part.split(x)
            unit = part.shaping.plain(own)
            psd, covariance = psd + size * unit[0], covariance + size * unit[1]
        total = 0.0
        for v, (low, high, edge, width) in zip(x, self._prior, strict=True):
            total -= width + 0.5 * (max(low - v, v - high, 0.0) / edge) ** 2
        if psd.size:
            rolloff = self.explanation.rolloff
            S = psd * self._gains(x)[0] + rolloff.floor if rolloff else psd
            total += self.likelihood.high_of(S, self._seen)
        return total + (self.likelihood.low_of(covariance, self.explanation.regressors) if covariance.size else 0.0)

    def _filled(self, x: Array) -> Array:
        """Write the rows at ``x``; what the level of each component multiplies by, one first for what does not move."""
        sizes = [1.0]
        for k, part in enumerate(self._moving):
            size, own = part.split(x)
            sizes.append(size)
            if part.at != own:
                part.at, shape = own, part.shaping.at(own)
                rows = self._places.of[k]
                self._density[rows], self._covariance[rows] = shape.density, shape.covariance
                self._spectrum[rows.start : rows.start + len(shape.spectrum)] = shape.spectrum
        return np.array(sizes)

    @property
    def powers(self) -> Array:
        """Power of each free parameter in the density; none of those that change its shape."""
        out = np.zeros(len(self._prior))
        for part in self._moving:
            if part.level:
                out[part.own[0]] = part.power
        return out

    def slope(self, x: Array) -> Slope | None:
        """The same with its derivatives, expected and observed curvature; ``None`` where it is not finite."""
        value, gradient, expected = 0.0, np.zeros(x.size), np.zeros((x.size, x.size))
        for k, (v, (low, high, edge, width)) in enumerate(zip(x.tolist(), self._prior, strict=True)):
            outside = max(low - v, v - high, 0.0)
            value -= width + 0.5 * (outside / edge) ** 2
            gradient[k] = math.copysign(outside, low - v if v < low else low - high) / edge**2
            expected[k, k] = 1.0 / edge**2 if outside else 0.0
        sizes, observed = self._filled(x), expected.copy()
        if self._density.shape[1]:
            looked = self._spectral(x, sizes, gradient, expected, observed)
            if looked is None:
                return None
            value += looked
        if self._covariance.shape[1]:
            scored = self._scored(sizes @ self._covariance[self._places.values])
            if scored is None:
                return None
            value += scored[0]
            kernels.informed(
                self._places.terms(sizes),
                self._covariance,
                self._spectrum,
                scored[1],
                spectrum_of(scored[2][None, :])[0],
                LEAST_DENSITY,
                kernels.Slopes(gradient, expected, observed),
            )
        if not (math.isfinite(value) and np.isfinite(gradient).all()):
            return None
        return Slope(value, gradient, expected, observed)

    def bend(self, x: Array) -> Array | None:
        """Second derivatives of the negative log likelihood; ``None`` where it is not finite.

        Those of the block differences from the differences of their score along the few directions in which the covariance moves.
        """
        places, H = self._places, np.zeros((x.size, x.size))
        sizes = self._filled(x)
        if self._density.shape[1] and self._spectral(x, sizes, np.zeros(x.size), np.zeros_like(H), H) is None:
            return None
        if self._covariance.shape[1]:
            gamma, by = sizes @ self._covariance[places.values], self._by_parameter(sizes, self._covariance)
            turned, lengths, directions = np.linalg.svd(by, full_matrices=False)
            few = lengths > LEAST_LENGTH * lengths[0]
            steps = lengths[few, None] * directions[few]
            scores = [self._scored(gamma + sign * BEND_STEP * d) for d in steps for sign in (1.0, 0.0, -1.0)]
            if any(scored is None for scored in scores):
                return None
            plus, here, minus = (np.array([scored[1] for scored in scores[k::3] if scored]) for k in range(3))
            bent = by @ ((minus - plus) / (2.0 * BEND_STEP)).T @ turned[:, few].T
            own = places.once[:, 0]
            H[np.ix_(own, own)] += 0.5 * (bent + bent.T)
            kernels.less_bent(sizes, self._covariance, places.twice, here[0], H)
        return H

    def _scored(self, gamma: Array) -> tuple[float, Array, Array] | None:
        return self.likelihood.score_of(gamma, self.explanation.regressors)

    def _by_parameter(self, sizes: Array, rows: Array) -> Array:
        """Derivatives of curves by the parameters, in the order of the places."""
        _, row, power, part = self._places.once.T
        return (power * sizes[part])[:, None] * rows[row]

    def _spectral(self, x: Array, sizes: Array, gradient: Array, expected: Array, observed: Array) -> float | None:
        """Whittle's log likelihood; its derivatives, expected and observed curvature are added to what is given."""
        rolloff = self.explanation.rolloff
        value = kernels.whittle(
            self._places.terms(sizes),
            self._density,
            kernels.PowerGain(self._gains(x), self._low_pass, rolloff.floor if rolloff else 0.0),
            self._half,
            self._seen,
            kernels.Slopes(gradient, expected, observed),
        )
        return None if math.isnan(value) else value


@dataclass
class _Moving:
    """A component with free parameters: which of all they are (the level first where it is free), its power in the density, its shapes."""

    own: list[int]
    level: bool
    power: int
    shaping: Shaping
    at: list[float] | None = None

    def split(self, x: Array) -> tuple[float, list[float]]:
        """What the level multiplies by, and the logarithms of the shape parameters."""
        own = x[self.own].tolist()
        return (math.exp(self.power * own.pop(0)) if self.level else 1.0), own


def _moving(data: Reduced, components: Sequence[Component]) -> Iterator[_Moving]:
    k = 0
    for c in components:
        level = c.process.level
        order = sorted(range(len(c.free)), key=lambda i: c.free[i].name != level.name)
        free = any(f.name == level.name for f in c.free)
        if c.free:
            names = [c.free[i].name for i in order[free:]]
            shaping = Shaping(data, of_unit_level(c.process) if free else c.process, names)
            yield _Moving([k + i for i in order], free, 2 // level.power, shaping)
        k += len(c.free)


class _Places:
    """Where in the rows of :class:`Along` the components and parameters are, as :func:`insemu.gap.evidence.kernels.whittle` has it.

    Parameters
    ----------
    moving : sequence of _Moving
    """

    def terms(self, sizes: Array) -> kernels.Terms:
        """As compiled code takes them, at some sizes of the components."""
        return kernels.Terms(sizes, self.values, self.once, self.twice)

    def __init__(self, moving: Sequence[_Moving]) -> None:
        shapes = [len(c.shaping.names) for c in moving]
        starts = np.cumsum([1, *(1 + m + len(pairs(m)) for m in shapes)]).tolist()
        self.rows, self.values = starts[-1], np.array([0, *starts[:-1]])
        self.of = [slice(a, b) for a, b in pairwise(starts)]
        once: list[tuple[int, int, int, int]] = []
        twice: list[tuple[int, int, int, int, int]] = []
        for part, (c, m, at) in enumerate(zip(moving, shapes, starts, strict=False), start=1):
            own = c.own[c.level :]
            if c.level:
                once.append((c.own[0], at, c.power, part))
                twice.append((c.own[0], c.own[0], at, c.power**2, part))
                twice += [(c.own[0], i, at + 1 + n, c.power, part) for n, i in enumerate(own)]
            once += [(i, at + 1 + n, 1, part) for n, i in enumerate(own)]
            twice += [(own[i], own[j], at + 1 + m + n, 1, part) for n, (i, j) in enumerate(pairs(m))]
        self.once = np.array(once, dtype=np.int64).reshape(-1, 4)
        self.twice = np.array(twice, dtype=np.int64).reshape(-1, 5)


#: Share of its largest value below which a density of the differences counts as that: sampled covariances do not resolve less.
LEAST_DENSITY = 1e-4
#: Step along a direction of the covariance for its curvature, in logs of parameters; share of the longest direction below which there is none.
BEND_STEP, LEAST_LENGTH = 1e-3, 1e-9


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
    found = ascend(along.slope, explanation.start(), explanation.free, modes, powers=along.powers, bend=along.bend)
    same = next((f for f in known if f.mode is found), None)
    return same or Fitted(explanation.at(found.x), found)
