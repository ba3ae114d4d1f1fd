"""Free parameters, and the mode of a posterior over them: climbed to, and weighed by Laplace's approximation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

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
    """

    value: float
    gradient: Array
    information: Array


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
    beside: Callable[[Array], Slope | None] | None = None,
) -> Mode:
    """Climb to a mode and weigh it: steps of Fisher's scoring, shortened as Levenberg and Marquardt do.

    Parameters
    ----------
    look : callable
        The slope at the logarithms of the parameters; ``None`` where it has none.
    x0 : (k,) array
        Where to start.
    free : sequence of Free
    known : sequence of Mode
        Modes of the same posterior: a climb that comes near one ends there.
    beside : callable, optional
        As ``look``, where the information is not needed.
    """
    x = inside(x0, free)
    here = look(x)
    if here is None:
        return weighed(x, NONE, np.zeros((x.size, x.size)), free)
    limits, floor, damping = reach(free), np.diag([1.0 / f.sigma**2 for f in free]), FIRST_DAMPING
    for _ in range(MOST_STEPS if x.size else 0):
        bend = here.information + floor
        if 0.5 * float(here.gradient @ _step(x, here.gradient, bend, limits)) < PROMISED_NATS:
            break
        damping, taken = _damped(look, x, here, bend, damping, limits)
        if taken is None:
            break
        x, here = taken
        for mode in known:
            off = x - mode.x
            if abs(here.value - mode.log_posterior) < SAME_MODE and float(off @ mode.precision @ off) < SAME_MODE:
                return mode
    if not x.size:
        return weighed(x, here.value, np.zeros((0, 0)), free)
    H = _bend_at(beside or look, x, here, free)
    values, vectors = np.linalg.eigh(H)
    last = (vectors / np.maximum(values, float(floor.diagonal().min()))) @ (vectors.T @ here.gradient)
    gain = 0.5 * float(here.gradient @ last)
    if not 0.0 <= gain < CLOSE * PROMISED_NATS:  # a climb that was given up
        return weighed(x, here.value, H, free)
    return weighed(np.clip(x + last, *limits), here.value + gain, H, free)


#: A last step, to the top of the parabola, is taken where it promises no more than this over what a climb ends for.
CLOSE = 10.0
#: Damping of a first step, and by how much one that fails, that gains less than a quarter, or more than three quarters of its promise, changes it.
FIRST_DAMPING, FAILED, POOR, GOOD = 1e-3, 8.0, 2.0, 0.2


def _damped(
    look: Callable[[Array], Slope | None],
    x: Array,
    here: Slope,
    bend: Array,
    damping: float,
    limits: tuple[Array, Array],
) -> tuple[float, tuple[Array, Slope] | None]:
    """The next point uphill and the damping to go on with; no point where none was found."""
    ridge = np.diag(np.diag(bend))
    for _ in range(TRIES):
        step = _step(x, here.gradient, bend + damping * ridge, limits)
        there, rate = look(x + step), float(here.gradient @ step)
        if there is not None and there.value - here.value > 1e-4 * rate:
            kept = (there.value - here.value) / max(rate - 0.5 * float(step @ bend @ step), 1e-300)
            return damping * (GOOD if kept > 0.75 else POOR if kept < 0.25 else 1.0), (x + step, there)
        damping = max(damping * FAILED, FIRST_DAMPING)
    return damping, None


def _step(x: Array, gradient: Array, bend: Array, limits: tuple[Array, Array]) -> Array:
    """The step to the top of the parabola, no longer than the longest and inside the limits; what pushes against one stays there."""
    low, high = limits
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    go = ~held
    step = np.zeros(x.size)
    if go.all():
        step = np.asarray(np.linalg.solve(bend, gradient), dtype=np.float64)
    elif go.any():
        step[go] = np.linalg.solve(bend[np.ix_(go, go)], gradient[go])
    step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    return np.asarray(np.clip(x + step, low, high) - x)


def _bend_at(look: Callable[[Array], Slope | None], x: Array, here: Slope, free: Sequence[Free]) -> Array:
    """Second derivatives of the negative log posterior at a mode.

    Those of the likelihood by differences of its derivatives, to the middle of the prior. The prior's edge has a kink, whose place the mode knows
    to less than what a level there is uncertain by: its curvature is the mean over the step by which every curvature is taken.
    """
    H = np.empty((x.size, x.size))
    for i, f in enumerate(free):
        h = SLOPE_STEP if x[i] < 0.5 * math.log(f.low * f.high) else -SLOPE_STEP
        beside = look(x + h * (np.arange(x.size) == i))
        H[i] = here.information[i] if beside is None else (here.gradient - beside.gradient) / h
        H[i, i] -= (f.slope(x[i]) - f.slope(x[i] + h)) / h if beside is not None else 0.0
        H[i, i] += (f.slope(x[i] - CURVATURE_STEP) - f.slope(x[i] + CURVATURE_STEP)) / (2.0 * CURVATURE_STEP)
    return 0.5 * (H + H.T)


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

    minimize: Any = optimize.minimize
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
