"""Unscented Kalman filter on the manifold, in square-root form: the states, rows and noise of the compiled filter, carried by sigma points.

The covariance is held as a triangular factor. Its columns, ``alpha sqrt(n)`` standard deviations long and of both signs, are points around the
estimate (Julier & Uhlmann 2004); each goes through the mechanization with its own errors of the sensors. Moments are taken from deviations against
the central point, where the scaled transform (Wan & van der Merwe 2001) is a sum of squares for ``beta >= alpha^2``::

    mu = sum_i w d_i,    P = sum_i w d_i d_i' + (beta - alpha^2) mu mu' + Q,    w = 1 / (2 alpha^2 n)

so that every factor is the R of one orthogonal decomposition and nothing is subtracted. Errors of attitude are rotation vectors, added and taken by
exponential and logarithm. Points of up to eight at a time fly in the lanes of the processor's vectors.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import lanes
from insemu.errors import InputError
from insemu.filters.aids import AIDS, CODES
from insemu.filters.buffers import Buffers
from insemu.filters.ekf import DIVERGED, Flight, LooselyCoupledEKF
from insemu.filters.events import KINDS
from insemu.filters.families import Family
from insemu.filters.packed import Start
from insemu.filters.results import FilterResult
from insemu.filters.sigma_points import Design, Points, fly
from insemu.lanes import LANES

Array = NDArray[np.float64]


def _root(P: Array) -> Array:
    """Lower factor of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(P)
    upper = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1]
    return np.ascontiguousarray((upper * np.where(np.diag(upper) < 0.0, -1.0, 1.0)[:, None]).T)


def _pair(*shape: int) -> tuple[Array, Any]:
    """Zeros as numbers and as lanes."""
    values = lanes.empty((*shape, LANES))
    values[...] = 0.0
    return values, lanes.lanes_of(values)


@dataclass(frozen=True)
class _Scaled:
    """Settings of the transform."""

    alpha: float = 0.5
    beta: float = 2.0

    def __post_init__(self) -> None:
        if not 1e-3 <= self.alpha <= 1.0:
            raise InputError(f"alpha is {self.alpha!r}, expected a number from 0.001 to 1")
        if not self.alpha**2 <= self.beta <= 100.0:
            raise InputError(f"beta is {self.beta!r}, expected a number from alpha squared to 100")


class UnscentedKalmanFilter(LooselyCoupledEKF):
    """The design of a :class:`LooselyCoupledEKF` carried by sigma points: in a scenario ``filter: ukf``.

    Parameters
    ----------
    belief, dt, **parts
        As :class:`LooselyCoupledEKF`.
    alpha : float
        Distance of the points from the estimate, in standard deviations times the root of the number of states; 0.001 to 1.
    beta : float
        What is known of the distribution; 2 is right for a normal one.

    Raises
    ------
    InputError
        A setting outside its limits; nodes, a state of the latency, or levels that follow a covariate, which this filter does not carry.
    """

    def __init__(self, belief: Any, dt: float, *, alpha: float = 0.5, beta: float = 2.0, **parts: Any) -> None:
        super().__init__(belief, dt, **parts)
        self.scaled = _Scaled(alpha, beta)
        self.settings = vars(self.scaled)
        for there, what in (
            (self.options.store != "none", "nodes for a smoother"),
            (self.options.family != Family(), "families of the extended Kalman filter"),
            (self.installation()[1] >= 0, "a state of the latency"),
            (bool(self.augmentation.laws), "levels that follow a covariate"),
        ):
            if there:
                raise InputError(f"the unscented filter has no {what}")

    @property
    def first_order(self) -> bool:
        """It is not linearized."""
        return False

    def _fly(self, flights: Sequence[Flight], *, side_by_side: bool) -> list[FilterResult | InputError]:
        """One after the other: the lanes are the points'."""
        return [self._flown(flight) for flight in flights]

    def _flown(self, f: Flight) -> FilterResult | InputError:
        """One record through the compiled loop of the points."""
        started = time.perf_counter()
        a, opts, n = self.augmentation, self.options, self.layout.n
        samples, start, events = f.samples, f.start, f.events
        plan = self.plan(samples.t, events)
        b = Buffers.of(n, samples.t.size, opts, events, plan.cov_epoch.size, 0)
        groups = -(-(2 * n + 1) // LANES)
        below = -(-max(6 + a.m, events.z.shape[1]) // LANES)
        points = Points(
            *_pair(groups, 13),
            *_pair(groups, a.m),
            *_pair(groups, n),
            _pair(5, 6)[1],
            *_pair(n, groups + below),
            *_pair(1),
        )
        gamma = self.scaled.alpha * np.sqrt(n)
        roots = np.stack([_root(a.power(count + 1)[1]) for count in range(opts.covariance_every)])
        design = Design(
            a.Phi, roots, a.axis, a.c, a.driver, a.white, plan, gamma, self.scaled.beta - self.scaled.alpha**2, _angles(events.z.shape[1])
        )  # fmt: skip
        start = Start(np.concatenate([start.nav, np.zeros(3)]), start.x.copy(), _root(start.P))
        if fly(points, design, samples, events, start, b) or not np.isfinite(start.nav).all():
            return InputError(DIVERGED)
        b.last[:] = start.P @ start.P.T
        return b.result(self.layout, samples.t, opts, events, plan.cov_epoch, 0, time.perf_counter() - started)


def _angles(width: int) -> Array:
    """Which rows of every kind of measurement are angles, (kinds, width)."""
    out = np.zeros((KINDS, width))
    for name, aid in AIDS.items():
        units = list(aid.rows.values())[:width]
        out[CODES[name], : len(units)] = [unit == "rad" for unit in units]
    return out
