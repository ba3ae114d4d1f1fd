"""Several posterior modes at once: every climb asks for its points together, because a pass of the filter takes eight of them side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.evidence.modes import CURVATURE_STEP, Free, Mode

Array = NDArray[np.float64]
#: Log likelihoods of points, each a parameter vector of one of several problems.
Likelihoods = Callable[[Sequence[tuple[int, Array]]], Array]

#: Longest step, in log; halvings of a step that goes downhill; steps of a climb.
LONGEST_STEP, HALVINGS, MOST_STEPS = 1.0, 6, 40
#: A climb far behind one of the same kind ends: by so many nats, even if its next step gains so many times what it promises.
BEHIND_NATS, SURER = 50.0, 3.0
#: A ridge is followed in steps of a standard deviation of the curvature at its top until this is lost, nats, or so many to a side: a bound.
LEFT_NATS, MOST_ALONG = 6.0, 12
#: Points with slopes that are looked at for each point of a ridge, and points that make a curve of one.
NEWTON, FINE = 3, 401


@dataclass
class _Climb:
    """One climb: where it stands, what it knows there, and where it looks next."""

    free: Sequence[Free]
    trial: Array
    x: Array
    value: float = -math.inf
    step: Array | None = None
    expected: float = 0.0
    eigenvalues: Array | None = None
    vectors: Array | None = None
    halved: int = 0
    whole: bool = False
    done: bool = False

    def stencil(self) -> list[Array]:
        """The trial and the points around it that give slope and curvature."""
        h = np.eye(self.x.size) * CURVATURE_STEP
        crossed = [self.trial + h[i] + h[j] for i in range(self.x.size) for j in range(i)]
        return [self.trial, *(self.trial + s for s in h), *(self.trial - s for s in h), *crossed]

    def look(self, values: Array, close: float) -> None:
        """Take the trial where it is uphill, else half the way there; ``values`` are those of the stencil, prior included."""
        n, h = self.x.size, CURVATURE_STEP
        if not values[0] > self.value:
            self.halved += 1
            assert self.step is not None
            self.trial = self.x + self.step * 0.5**self.halved
            self.done = self.halved > HALVINGS
            return
        self.x, self.value, self.halved = self.trial, float(values[0]), 0
        plus, minus, crossed = values[1 : n + 1], values[n + 1 : 2 * n + 1], values[2 * n + 1 :]
        slope = (plus - minus) / (2.0 * h)
        H = np.diag(-(plus + minus - 2.0 * self.value) / h**2)
        pairs = [(i, j) for i in range(n) for j in range(i)]
        for (i, j), both in zip(pairs, crossed, strict=True):
            H[i, j] = H[j, i] = -(both - plus[i] - plus[j] + self.value) / h**2
        prior = np.array([1.0 / f.sigma for f in self.free])
        eigenvalues, self.vectors = np.linalg.eigh(H / prior[:, None] / prior[None, :])
        # no direction counts as wider than its prior
        self.eigenvalues = np.maximum(eigenvalues, 1.0)
        along = self.vectors.T @ (slope / prior) / np.maximum(np.abs(eigenvalues), 1.0)
        step = (self.vectors @ along) / prior
        length = float(np.abs(step).max())
        self.whole = length <= LONGEST_STEP
        step *= min(1.0, LONGEST_STEP / max(length, 1e-12))
        low, high = self._bounds()
        self.step = np.clip(self.x + step, low, high) - self.x
        self.expected = max(float(slope @ self.step) - 0.5 * float(self.step @ H @ self.step), 0.0)
        self.trial = self.x + self.step
        self.done = 0.5 * float(slope @ self.step) < close

    def is_behind(self, best: float) -> bool:
        """Whether a parabola that the climb sees the top of ends far below a value that another has reached."""
        return self.whole and not self.halved and self.value + SURER * self.expected + BEHIND_NATS < best

    def _bounds(self) -> tuple[Array, Array]:
        """Bounds of the prior with its edges, so far inside that the stencil does not leave them."""
        beyond = [6.0 * f.edge - 1.1 * CURVATURE_STEP for f in self.free]
        low = np.array([math.log(f.low) - b for f, b in zip(self.free, beyond, strict=True)])
        high = np.array([math.log(f.high) + b for f, b in zip(self.free, beyond, strict=True)])
        return low, high

    def mode(self) -> Mode:
        """The top of the parabola through the last stencil."""
        assert self.step is not None and self.eigenvalues is not None and self.vectors is not None
        last = self.step if not self.halved else 0.0 * self.step
        top = self.value + (self.expected if not self.halved else 0.0)
        sigma = np.array([f.sigma for f in self.free])
        covariance = (self.vectors / self.eigenvalues) @ self.vectors.T * sigma[:, None] * sigma[None, :]
        logdet = float(np.sum(np.log(self.eigenvalues)) - 2.0 * np.sum(np.log(sigma)))
        return Mode(self.x + last, covariance, top, top + 0.5 * self.x.size * math.log(2.0 * math.pi) - 0.5 * logdet)


def laplace_many(
    log_likelihoods: Likelihoods,
    starts: Sequence[Array],
    free: Sequence[Sequence[Free]],
    close: float,
    kinds: Sequence[str] | None = None,
) -> list[Mode]:
    """Climb to the posterior mode of several problems by damped Newton steps and weigh each as :func:`insemu.gap.evidence.modes.laplace` does.

    Parameters
    ----------
    log_likelihoods : callable
        Of ``(problem, logarithms of its parameters)`` pairs.
    starts : sequence of (k,) array
        Where to start, one per problem; k may differ.
    free : sequence of sequence of Free
        Its parameters.
    close : float
        A climb ends where a step promises less, nats.
    kinds : sequence of str, optional
        Of the problems; of those of one kind only the best matter, and a climb ends early where it is far behind another.
    """
    climbs = []
    for x0, own in zip(starts, free, strict=True):
        x = np.clip(x0, [math.log(f.low) for f in own], [math.log(f.high) for f in own])
        climbs.append(_Climb(own, x, x))
    for _ in range(MOST_STEPS):
        going = [(k, c, c.stencil()) for k, c in enumerate(climbs) if not c.done]
        if not going:
            break
        points = [(k, p) for k, _, stencil in going for p in stencil]
        values = log_likelihoods(points)
        prior = [sum(f.log_density(v) for f, v in zip(free[k], p, strict=True)) for k, p in points]
        total, at = np.nan_to_num(values + np.array(prior), nan=-1e12, neginf=-1e12), 0
        for _, climb, stencil in going:
            climb.look(total[at : at + len(stencil)], close)
            at += len(stencil)
        for kind in set(kinds or ()):
            alike = [c for c, other in zip(climbs, kinds or (), strict=True) if other == kind]
            best = max(c.value for c in alike)
            for climb in alike:
                climb.done = climb.done or climb.is_behind(best)
    return [c.mode() for c in climbs]


@dataclass(frozen=True)
class Ridge:
    """A posterior along one parameter, the others at their best beside each of its values: what its own curvature at the top knows nothing of.

    Parameters
    ----------
    at : (p, k) array
        Points of the ridge, logarithms of the parameters.
    weight : (p,) array
        Probability of each.
    spread : (k,) array
        Standard deviations of the others next to it; 0 of the parameter itself.

    References
    ----------
    Rue et al. 2009, section 3.2: the posterior of one parameter by Laplace's approximation of the others next to it.
    """

    at: Array
    weight: Array
    spread: Array

    @classmethod
    def along(cls, log_likelihoods: Likelihoods, mode: Mode, free: Sequence[Free], k: int) -> Ridge:
        """Follow the ridge from the mode to both sides, until little is left of the posterior.

        Parameters
        ----------
        log_likelihoods : callable
            As :func:`laplace_many` takes it, of problem 0.
        mode : Mode
        free : sequence of Free
            Its parameters.
        k : int
            Which of them.
        """
        sd, rest = math.sqrt(float(mode.covariance[k, k])), np.arange(mode.x.size) != k
        H = mode.precision[np.ix_(rest, rest)]
        beside = np.asarray(np.linalg.inv(H), dtype=np.float64)
        slope = mode.covariance[:, k] / sd
        points, values = [mode.x], [mode.log_posterior]
        for side in (-1.0, 1.0):
            x, last = mode.x + side * slope, mode.x
            for _ in range(MOST_ALONG):
                found = _best_given(log_likelihoods, x, free, rest, H, beside)
                if found is None:
                    break
                points.append(found[0])
                values.append(found[1])
                if found[1] < max(values) - LEFT_NATS:
                    break
                x, last = 2.0 * found[0] - last, found[0]
                x[k] = last[k] + side * sd
        order = np.argsort([p[k] for p in points])
        knots, fine = np.array(points)[order], np.linspace(min(p[k] for p in points), max(p[k] for p in points), FINE)
        log_weight = _interpolated(knots[:, k], np.array(values)[order], fine)
        weight, spread = np.exp(log_weight - log_weight.max()), np.zeros(mode.x.size)
        spread[rest] = np.sqrt(np.diag(beside))
        return cls(_interpolated(knots[:, k], knots, fine), weight / weight.sum(), spread)

    def interval(self, k: int) -> tuple[float, float]:
        """95 % interval of a parameter, in logarithms."""
        x = self.at[:, k]
        at = np.linspace(float(np.min(x - 4.0 * self.spread[k])), float(np.max(x + 4.0 * self.spread[k])), FINE)
        beyond = (at[:, None] - x) / max(float(self.spread[k]), 1e-9 + 0.5 * (at[1] - at[0]))
        reached = scipy.special.ndtr(beyond) @ self.weight
        low, high = np.interp([0.025, 0.975], reached, at)
        return float(low), float(high)


def _interpolated(x: Array, y: Array, at: Array) -> Array:
    """Values (m, ...) between points (p,) of a smooth curve (p, ...)."""
    if x.size < 2:
        return np.repeat(y, at.size, axis=0)
    return np.asarray(scipy.interpolate.PchipInterpolator(x, y)(at), dtype=np.float64)


def _best_given(
    log_likelihoods: Likelihoods, x: Array, free: Sequence[Free], rest: NDArray[np.bool_], H: Array, beside: Array
) -> tuple[Array, float] | None:
    """The best point near x when the parameters that are not in ``rest`` stay, and its log posterior; ``None`` where there is none.

    Newton steps with the curvature (r, r) of the mode and its inverse.
    """
    own, h = np.flatnonzero(rest), CURVATURE_STEP
    x, best, value = x.copy(), None, -math.inf
    for _ in range(NEWTON):
        stencil = [x, *(x + h * np.eye(x.size)[i] for i in own)]
        if not all(f.admits(v) for p in stencil for f, v in zip(free, p, strict=True)):
            break
        prior = np.array([sum(f.log_density(v) for f, v in zip(free, p, strict=True)) for p in stencil])
        each = log_likelihoods([(0, p) for p in stencil]) + prior
        if not np.all(np.isfinite(each)) or each[0] < value:
            break
        best, value = x.copy(), float(each[0])
        x[own] += np.clip(beside @ ((each[1:] - each[0]) / h + 0.5 * h * np.diag(H)), -LONGEST_STEP, LONGEST_STEP)
    return None if best is None else (best, value)
