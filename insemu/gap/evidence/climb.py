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
#: Where a posterior is looked at, in standard deviations of the curvature at its top: the tail of a time is upwards.
ALONG = np.arange(-4.0, 8.5, 1.0)


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


def laplace_together(
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


def interval_along(log_likelihoods: Likelihoods, mode: Mode, free: Sequence[Free], k: int) -> tuple[float, float]:
    """95 % interval of one parameter of a mode, in logarithms, by the posterior along the line of its conditional means.

    A correlation time of which a recording holds a dozen has a posterior that is far from normal: the curvature at its top knows nothing of its tail.

    Parameters
    ----------
    log_likelihoods : callable
        As :func:`laplace_together` takes it, of problem 0.
    mode : Mode
    free : sequence of Free
        Its parameters.
    k : int
        Which of them.
    """
    sd = math.sqrt(float(mode.covariance[k, k]))
    points = [mode.x + step * mode.covariance[:, k] / sd for step in ALONG]
    inside = np.array([all(f.admits(v) for f, v in zip(free, p, strict=True)) for p in points])
    prior = np.array([sum(f.log_density(v) for f, v in zip(free, p, strict=True)) for p in points])
    values = np.full(len(points), -np.inf)
    values[inside] = log_likelihoods([(0, p) for p, i in zip(points, inside, strict=True) if i]) + prior[inside]
    there = np.isfinite(values)
    if there.sum() < 4:
        return float(mode.x[k] - 1.96 * sd), float(mode.x[k] + 1.96 * sd)
    at = np.linspace(ALONG[there][0], ALONG[there][-1], 1001)
    log_density = scipy.interpolate.PchipInterpolator(ALONG[there], values[there])(at)
    reached = np.cumsum(np.exp(log_density - log_density.max()))
    low, high = np.interp([0.025, 0.975], reached / reached[-1], at)
    return float(mode.x[k] + min(low, 0.0) * sd), float(mode.x[k] + max(high, 0.0) * sd)
