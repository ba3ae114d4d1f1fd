"""Free parameters, and the mode of a posterior over them: climbed to, and weighed by Laplace's approximation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.policy import rules

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

    def slope(self, x: float) -> float:
        """Derivative of :meth:`log_density`: none inside the bounds."""
        return (max(math.log(self.low) - x, 0.0) - max(x - math.log(self.high), 0.0)) / self.edge**2

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
class Mode:
    """A posterior mode: logarithms of the parameters, their covariance, log posterior there, log evidence."""

    x: Array
    covariance: Array
    log_posterior: float
    evidence: float

    @cached_property
    def precision(self) -> Array:
        """Inverse of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)


def reach(free: Sequence[Free]) -> tuple[Array, Array]:
    """Where a climb may go: the bounds with their edges, so far inside that the curvature is not taken across them."""
    beyond = [6.0 * f.edge - 1.1 * CURVATURE_STEP for f in free]
    low = np.array([math.log(f.low) - b for f, b in zip(free, beyond, strict=True)])
    high = np.array([math.log(f.high) + b for f, b in zip(free, beyond, strict=True)])
    return low, high


def inside(x: Array, free: Sequence[Free]) -> Array:
    """The nearest point that no prior's edge touches."""
    if not x.size:
        return x
    return np.clip(x, [math.log(f.low) for f in free], [math.log(f.high) for f in free])


def weighed(x: Array, log_posterior: float, H: Array, free: Sequence[Free]) -> Mode:
    """Evidence of a mode by Laplace's approximation; no direction counts as wider than its prior.

    Parameters
    ----------
    x : (k,) array
        The mode.
    log_posterior : float
        There.
    H : (k, k) array
        Second derivatives of the negative log posterior.
    free : sequence of Free
    """
    if not x.size:
        return Mode(x, np.zeros((0, 0)), log_posterior, log_posterior)
    scale = np.array([1.0 / f.sigma for f in free])
    eigenvalues, vectors = np.linalg.eigh(H / scale[:, None] / scale[None, :])
    eigenvalues = np.maximum(eigenvalues, 1.0)
    covariance = (vectors / eigenvalues) @ vectors.T / scale[:, None] / scale[None, :]
    logdet = float(np.sum(np.log(eigenvalues)) + 2.0 * np.sum(np.log(scale)))
    evidence = log_posterior + 0.5 * x.size * math.log(2.0 * math.pi) - 0.5 * logdet
    return Mode(x, covariance, log_posterior, evidence)


# -- with derivatives ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slope:
    """A log posterior with its derivatives and its expected curvature.

    Parameters
    ----------
    value : float
    gradient : (k,) array
    information : (k, k) array
        Fisher's, that of the prior's edges included: what the second derivatives of the negative log posterior are on average.
    curvature : (k, k) array, optional
        These themselves, as far as they are known.
    """

    value: float
    gradient: Array
    information: Array
    curvature: Array | None = None


#: Longest step in log, tries of one step, steps of a climb.
LONGEST_STEP, TRIES, MOST_STEPS = 0.5, 12, 60
#: A climb ends where a step promises less, nats; the step by which the curvature at a mode is taken from derivatives, in log.
PROMISED_NATS, SLOPE_STEP = 1e-4, 1e-3
#: Squared distance in standard deviations, and nats, from a known mode within which a climb will end there.
SAME_MODE = 0.1
#: What stands for the log posterior where there is none.
NONE = -1e12


def ascend(
    look: Callable[[Array], Slope | None],
    x0: Array,
    free: Sequence[Free],
    known: Sequence[Mode] = (),
    *,
    powers: Array | None = None,
    bend: Callable[[Array], Array | None] | None = None,
) -> Mode:
    """Climb to a mode and weigh it: steps of Fisher's scoring, near the top of Newton's, shortened as Levenberg and Marquardt do.

    Parameters
    ----------
    look : callable
        The slope at the logarithms of the parameters; ``None`` where it has none.
    x0 : (k,) array
        Where to start.
    free : sequence of Free
    known : sequence of Mode
        Modes of the same posterior: a climb that comes near one ends there.
    powers : (k,) array, optional
        As :class:`Steps` has them.
    bend : callable, optional
        Second derivatives (k, k) of the negative log likelihood; by differences where there is none or it has none.
    """
    x = inside(x0, free)
    here = look(x)
    if here is None:
        return weighed(x, NONE, np.zeros((x.size, x.size)), free)
    steps, damping = Steps(free, powers), FIRST_DAMPING
    floor = np.diag([1.0 / f.sigma**2 for f in free])
    for _ in range(MOST_STEPS if x.size else 0):
        curve = here.information + floor
        promised = steps.promised(x, here.gradient, curve)
        if here.curvature is not None and promised < NEAR_NATS:
            observed = here.curvature + floor + np.diag(steps.powers * here.gradient)
            if _is_positive(observed, curve):
                curve, promised = observed, steps.promised(x, here.gradient, observed)
        if promised < PROMISED_NATS:
            break
        damping, taken = _damped(look, x, here, curve, damping, steps)
        if taken is None:
            break
        x, here = taken
        for mode in known:
            off = x - mode.x
            if abs(here.value - mode.log_posterior) < SAME_MODE and float(off @ mode.precision @ off) < SAME_MODE:
                return mode
    if not x.size:
        return weighed(x, here.value, np.zeros((0, 0)), free)
    known_bend = bend(x) if bend is not None else None
    H = (_bend_at(look, x, here, free) if known_bend is None else known_bend) + np.diag(_edges(x, free))
    values, vectors = np.linalg.eigh(H)
    last = (vectors / np.maximum(values, float(floor.diagonal().min()))) @ (vectors.T @ here.gradient)
    gain = 0.5 * float(here.gradient @ last)
    if not 0.0 <= gain < CLOSE * PROMISED_NATS:  # a climb that was given up
        return weighed(x, here.value, H, free)
    return weighed(np.clip(x + last, *steps.limits), here.value + gain, H, free)


#: A last step, to the top of the parabola, is taken where it promises no more than this over what a climb ends for.
CLOSE = 10.0
#: Damping of a first step, and by how much one that fails, that gains less than a quarter, or more than three quarters of its promise, changes it.
FIRST_DAMPING, FAILED, POOR, GOOD = 1e-3, 8.0, 2.0, 0.2
#: Promise, nats, from which on the observed curvature says where the top is, if it is more than this share of the expected one in every direction.
NEAR_NATS, LEAST_SHARE = 100.0, 0.02
#: Times that a step is worked out again because it ends on another side of a prior's bounds than was assumed.
SIDES = 4


def _is_positive(observed: Array, expected: Array) -> bool:
    """Whether an observed curvature is positive in every direction, as the expected one is."""
    try:
        np.linalg.cholesky(observed - LEAST_SHARE * expected)
    except np.linalg.LinAlgError:
        return False
    return True


class Steps:
    """Steps of a climb, along which levels change their part of the density, and not its logarithm, in proportion.

    A process that takes over what another explains is a straight way there and a bent one in logarithms. Priors are flat with parabolas beyond
    their bounds, so a step that crosses one is worked out for the side on which it ends.

    Parameters
    ----------
    free : sequence of Free
    powers : (k,) array, optional
        Power of each parameter in the density, none where it changes the shape: then its logarithm moves in proportion.
    """

    def __init__(self, free: Sequence[Free], powers: Array | None = None) -> None:
        self.powers = np.zeros(len(free)) if powers is None else powers
        self.low = np.array([math.log(f.low) for f in free])
        self.high = np.array([math.log(f.high) for f in free])
        self.stiff = np.array([f.edge**-2 for f in free])
        self.limits = reach(free) if free else (np.zeros(0), np.zeros(0))
        self._level = self.powers > 0.0
        self._unit = np.where(self._level, self.powers, 1.0)
        self._longest = (
            self._proportion(np.full(len(free), LONGEST_STEP)),
            -self._proportion(np.full(len(free), -LONGEST_STEP)),
        )

    def _proportion(self, d: Array) -> Array:
        """Changes in proportion of changes in log."""
        return np.where(self._level, np.expm1(self._unit * d) / self._unit, d)

    def _sides(self, x: Array) -> NDArray[np.int64]:
        return (x > self.high).astype(np.int64) - (x < self.low)

    def _edges(self, side: NDArray[np.int64], x: Array) -> tuple[Array, Array]:
        """Slope and curvature at ``x`` of the parabolas of these sides."""
        stiff = np.where(side != 0, self.stiff, 0.0)
        return stiff * (np.where(side < 0, self.low, self.high) - x), stiff

    def _solved(self, x: Array, gradient: Array, bend: Array) -> Array:
        """To the top of the parabola; what pushes against a limit stays there."""
        low, high = self.limits
        go = ~(((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0)))
        if go.all():
            return np.asarray(np.linalg.solve(bend, gradient), dtype=np.float64)
        s = np.zeros(x.size)
        if go.any():
            s[go] = np.linalg.solve(bend[np.ix_(go, go)], gradient[go])
        return s

    def _limited(self, x: Array, s: Array) -> tuple[Array, Array]:
        """Where a change in proportion ends, no longer than the longest and inside the limits, and what is left of it."""
        up, down = self._longest
        s = s * min(1.0, float(np.min(np.where(s > 0.0, up, down) / np.maximum(np.abs(s), 1e-300), initial=1.0)))
        end = np.clip(x + np.where(self._level, np.log1p(self._unit * s) / self._unit, s), *self.limits)
        return end, self._proportion(end - x)

    def promised(self, x: Array, gradient: Array, bend: Array) -> float:
        """What a step would gain by the parabola, nats.

        Parameters
        ----------
        x : (k,) array
            Where it starts, logarithms of the parameters.
        gradient, bend : (k,), (k, k) arrays
            Slope and curvature of the log posterior.
        """
        return 0.5 * float(gradient @ self._solved(x, gradient, bend))

    def step(self, x: Array, gradient: Array, bend: Array, damping: float) -> tuple[Array, float]:
        """Where a damped step ends, and what it promises; priors count as they are there.

        Parameters
        ----------
        x : (k,) array
            Where it starts, logarithms of the parameters.
        gradient, bend : (k,), (k, k) arrays
            Slope and curvature of the log posterior.
        damping : float
            Share of the curvature's diagonal that is added.
        """
        side = start = self._sides(x)
        pull, stiff = self._edges(start, x)
        slope, curve = gradient - pull, bend - np.diag(stiff)
        s = np.zeros(x.size)
        for _ in range(SIDES):
            pull, stiff = self._edges(side, x)
            H = curve + np.diag(stiff)
            s = self._solved(x, slope + pull, H + damping * np.diag(np.diag(H)))
            ends = self._sides(x + s)
            if np.array_equal(ends, side):
                break
            side = ends
        end, s = self._limited(x, s)
        outside = [self.stiff * np.maximum(np.maximum(self.low - at, at - self.high), 0.0) ** 2 for at in (end, x)]
        gain = float(slope @ s) - 0.5 * (float(s @ curve @ s) + float(np.sum(outside[0] - outside[1])))
        return end, gain


def _damped(
    look: Callable[[Array], Slope | None], x: Array, here: Slope, bend: Array, damping: float, steps: Steps
) -> tuple[float, tuple[Array, Slope] | None]:
    """The next point uphill and the damping to go on with; no point where none was found."""
    for _ in range(TRIES):
        end, gain = steps.step(x, here.gradient, bend, damping)
        there = look(end)
        got = there.value - here.value if there is not None else -math.inf
        if there is not None and got > max(1e-4 * gain, 0.0):
            kept = got / max(gain, 1e-300)
            return damping * (GOOD if kept > 0.75 else POOR if kept < 0.25 else 1.0), (end, there)
        damping = max(damping * FAILED, FIRST_DAMPING)
    return damping, None


def _bend_at(look: Callable[[Array], Slope | None], x: Array, here: Slope, free: Sequence[Free]) -> Array:
    """Second derivatives of the negative log likelihood at a mode, by differences of its derivatives, to the middle of the prior."""
    H = np.empty((x.size, x.size))
    for i, f in enumerate(free):
        h = SLOPE_STEP if x[i] < 0.5 * math.log(f.low * f.high) else -SLOPE_STEP
        beside = look(x + h * (np.arange(x.size) == i))
        H[i] = here.information[i] if beside is None else (here.gradient - beside.gradient) / h
        H[i, i] -= (f.slope(x[i]) - f.slope(x[i] + h)) / h if beside is not None else 0.0
    return 0.5 * (H + H.T)


def _edges(x: Array, free: Sequence[Free]) -> Array:
    """Curvatures of the priors' edges at a mode.

    An edge has a kink, whose place the mode knows to less than what a level there is uncertain by: the mean over a step.
    """
    h = CURVATURE_STEP
    return np.array([(f.slope(v - h) - f.slope(v + h)) / (2.0 * h) for f, v in zip(free, x, strict=True)])


# -- without derivatives ------------------------------------------------------------------------------------------------------------


def laplace(log_posterior: Callable[[Array], float], x0: Array, free: Sequence[Free]) -> Mode:
    """Climb to a mode of a posterior that is known by its values alone, and weigh it.

    Parameters
    ----------
    log_posterior : callable
        Of the logarithms of the parameters.
    x0 : (k,) array
        Where to start.
    free : sequence of Free
    """
    admitted = [(math.log(f.low) - 6.0 * f.edge, math.log(f.high) + 6.0 * f.edge) for f in free]

    def cost(x: Array) -> float:
        if any(not low <= v <= high for v, (low, high) in zip(x, admitted, strict=True)):
            return 1e12 + float(np.sum((x - x0) ** 2))  # however strong the evidence
        value = -log_posterior(x)
        return value if math.isfinite(value) else 1e12

    x0 = inside(x0, free)
    # curvatures differ by orders of magnitude (a million samples against a handful of blocks): climb in standardised coordinates
    prior = np.array([1.0 / f.sigma**2 for f in free])
    centre, step = cost(x0), 3e-3
    bend = np.array([(cost(x0 + e) + cost(x0 - e) - 2.0 * centre) / step**2 for e in np.eye(x0.size) * step])
    unit = 1.0 / np.sqrt(np.maximum(np.where(np.isfinite(bend), bend, 0.0), prior))
    low, high = reach(free)
    limits = list(zip((low - x0) / unit, (high - x0) / unit, strict=True))

    def sloped(z: Array) -> tuple[float, Array]:
        """Cost and its derivatives by forward differences, backward at the edge."""
        here, out = cost(x0 + unit * z), np.empty(z.size)
        for i in range(z.size):
            moved = z.copy()
            moved[i] += 1e-3 if z[i] + 1e-3 <= limits[i][1] else -1e-3
            out[i] = (cost(x0 + unit * moved) - here) / (moved[i] - z[i])
        return here, out

    minimize: Any = scipy.optimize.minimize
    options = {"maxiter": 60, "ftol": 1e-9}
    result = minimize(sloped, np.zeros(x0.size), jac=True, method="L-BFGS-B", bounds=limits, options=options)
    x, best = x0 + unit * np.asarray(result.x, dtype=np.float64), float(result.fun)
    return weighed(x, -best, _hessian(cost, x, best), free)


def _hessian(cost: Callable[[Array], float], x: Array, centre: float) -> Array:
    """Second derivatives of a cost by differences."""
    n, h = x.size, CURVATURE_STEP
    H = np.empty((n, n))
    steps = np.eye(n) * h
    plus = np.array([cost(x + s) for s in steps])
    minus = np.array([cost(x - s) for s in steps])
    for i in range(n):
        H[i, i] = (plus[i] + minus[i] - 2.0 * centre) / h**2
        for j in range(i):
            both = cost(x + steps[i] + steps[j])
            H[i, j] = H[j, i] = (both - plus[i] - plus[j] + centre) / h**2
    return H
