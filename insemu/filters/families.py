"""Families of filters: ways to carry an estimate and its covariance over the same rows, propagation and states of the sensors.

A family says in which coordinates the error is held when the estimate moves, how often a measurement is linearized, how a residual is weighted, and
whether the noise of a measurement is learnt. All of this happens where something is measured: between measurements the linear map of the errors
along one trajectory is the same whatever coordinates name them.

**Invariant filters** (Barrau & Bonnabel 2017). Attitude, velocity and position are an element of SE_2(3). With position error dp, velocity error dv
and attitude error phi of :mod:`insemu.strapdown`, to first order the right-invariant error is ``(phi, dv + v x phi, dp + p x phi)`` and the
left-invariant one ``C' (phi, dv, dp)``. An invariant filter holds the covariance of *its* error over an update, and the estimate moves along the
group's exponential. In the coordinates (dp, dv, phi) that is for both: the correction of position and velocity is turned by the left Jacobian of
SO(3) at -phi. The covariance of (dp, dv, phi) is then turned by ``exp(-phi)`` (left), or position and velocity errors take up ``dp x phi`` and ``dv
x phi`` (right): no origin of the positions remains. States of the sensors are added as they are (the imperfect filter of that paper, section V).

**Iterated** (Bell & Cathey 1993): a measurement is linearized again at the estimate that it gave, Gauss-Newton on the posterior.
**Huber, Student t**: weights of the components by their residuals, iterated (Huber 1981; Roth, Ozkan, Gustafsson 2013).
**Adaptive**: variances of the measured values follow the mean of squared innovations less what the filter's covariance explains (Mohamed & Schwarz
1999).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.errors import InputError, nearest
from insemu.filters.aids import fill_rows
from insemu.filters.measurements import take_off, update
from insemu.filters.rows import Moment, Rows
from insemu.lanes import any_of, where, zeros
from insemu.rotation import scalar_half_trig

Array = NDArray[np.float64]
Coordinates = Literal["plain", "left", "right"]
Loss = Literal["squares", "huber", "student-t"]

#: A learnt variance stays within these factors of the stated one.
SCALES = (1e-2, 1e4)


class Carry(NamedTuple):
    """A family as compiled code takes it; fields of :class:`Family`, words as their places."""

    coordinates: int
    iterations: int
    again: bool
    loss: int
    limit: float
    window: float


@dataclass(frozen=True)
class Family:
    """How estimate and covariance are carried over a measurement.

    Parameters
    ----------
    coordinates : {"plain", "left", "right"}
        Error that keeps its covariance when the estimate moves: (dp, dv, phi), left-invariant, right-invariant.
    iterations : int
        Times that an accepted measurement is used, each time from the covariance before it.
    again : bool
        Linearize it anew each time.
    loss : {"squares", "huber", "student-t"}
        Weights of the components of a measurement.
    limit : float
        Of ``huber``: standard deviations from which a residual counts linearly. Of ``student-t``: degrees of freedom.
    window : float
        Measurements of one kind over which variances are learnt; 0: they are as stated.

    Raises
    ------
    InputError
        A value outside of these.
    """

    coordinates: Coordinates = "plain"
    iterations: int = 1
    again: bool = False
    loss: Loss = "squares"
    limit: float = 3.0
    window: float = 0.0

    def __post_init__(self) -> None:
        for name, known in (("coordinates", get_args(Coordinates)), ("loss", get_args(Loss))):
            if getattr(self, name) not in known:
                raise InputError(f"{name} is {getattr(self, name)!r}, expected one of: {', '.join(known)}")
        if isinstance(self.iterations, bool) or not isinstance(self.iterations, int) or not 1 <= self.iterations <= 100:
            raise InputError(f"iterations is {self.iterations!r}, expected a whole number from 1 to 100")
        if not isinstance(self.again, bool):
            raise InputError(f"again is {self.again!r}, expected true or false")
        for name, least in (("limit", 1e-3), ("window", 0.0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
                raise InputError(f"{name} is {value!r}, expected a number of at least {least:g}")
        if 0.0 < self.window < 2.0:
            raise InputError(f"window is {self.window!r}, expected 0 or at least 2 measurements")

    @classmethod
    def named(cls, name: str, settings: Mapping[str, Any]) -> Family:
        """A family of :data:`FAMILIES`, with some of its fields replaced.

        Raises
        ------
        InputError
            A setting that no family has, or a value that is not allowed.
        """
        known = [f.name for f in fields(cls)]
        for key in settings:
            if key not in known:
                raise InputError(f"the filter '{name}' has no setting '{key}'" + nearest(key, known))
        return replace(FAMILIES[name], **settings)

    @property
    def carry(self) -> Carry:
        """As compiled code takes it."""
        return Carry(
            get_args(Coordinates).index(self.coordinates),
            self.iterations,
            self.again,
            get_args(Loss).index(self.loss),
            float(self.limit),
            float(self.window),
        )


#: Families of the compiled filter by the name that a scenario gives (``filter: NAME``); ``settings`` there replace fields.
FAMILIES: dict[str, Family] = {
    "ekf": Family(),
    "iekf-left": Family(coordinates="left"),
    "iekf-right": Family(coordinates="right"),
    "iterated": Family(iterations=5, again=True),
    "huber": Family(iterations=5, loss="huber"),
    "student-t": Family(iterations=5, loss="student-t", limit=20.0),
    "adaptive": Family(window=100.0),
}


class Update(NamedTuple):
    """What an update works on: arrays that it overwrites.

    Parameters
    ----------
    P, before : (n, n) arrays
        Covariance, and room for the one before.
    dx : (n,) array
        Estimated error.
    S, K : (w, w), (n, w) arrays
        Covariance of the innovation at the first linearization; gain of the last.
    nav, nav_before : (13,) arrays
        Room for iterated states.
    again : (w, w) array
        Room.
    scale : (kinds, w) array
        Learnt variances, in stated ones.
    """

    P: Array
    before: Array
    dx: Array
    S: Array
    K: Array
    nav: Array
    nav_before: Array
    again: Array
    scale: Array


@njit(cache=True, nogil=True)
def absorb(
    carry: Carry,
    u: Update,
    kind: int,
    moment: Moment,
    z: Array,
    var: Array,
    settings: Array,
    rows: Rows,
    used: Array,
    thresholds: Array,
    free: float,
) -> tuple[float, float, float, float]:
    """Use one measurement: the update of ``u.P`` and the estimated error ``u.dx``, which is not yet taken off.

    Parameters
    ----------
    carry : Carry
    u : Update
    kind : int
    moment : Moment
    z, var : (w,) arrays
        Measured values and their variances.
    settings : array
        Constants of the aid.
    rows : Rows
        At the estimate, variances of the measured values in ``R``; overwritten where it is linearized again.
    used, thresholds, free
        As in :func:`insemu.filters.measurements.update`.

    Returns
    -------
    (nis, dof, accepted, bad)
        As there, at the first linearization.
    """
    n, w = u.dx.size, used.size
    more = carry.iterations > 1
    if carry.window > 0.0:
        for i in range(w):
            extra = (u.scale[kind, i] - 1.0) * var[i]
            rows.R[i, i] += where(used[i] > 0.0, extra, 0.0)
    first = zeros(u.dx, (w, w) if more else (1, 1))  # noise as it is without weights
    if more:
        for i in range(w):
            for j in range(w):
                first[i, j] = rows.R[i, j]
        for i in range(n):
            for j in range(n):
                u.before[i, j] = u.P[i, j]
    nis, dof, ok, bad = update(u.P, rows.nu, rows.H, rows.R, used, thresholds, free, u.dx, u.S, u.K)
    if carry.window > 0.0:
        for i in range(w):
            counts = used[i] * ok
            if any_of(counts > 0.0):
                share = u.scale[kind, i]
                seen = (rows.nu[i] * rows.nu[i] - u.S[i, i]) / var[i] + share
                certain = share * var[i] / u.S[i, i]  # the better the rest is known, the more an innovation says
                learnt = max(SCALES[0], min(SCALES[1], share + certain * certain * (seen - share) / carry.window))
                u.scale[kind, i] = where(counts > 0.0, learnt, share)
    if more and any_of(ok > 0.0):
        nu, residual, weight, taken = zeros(u.dx, w), zeros(u.dx, w), zeros(u.dx, w), zeros(u.dx, w)
        for i in range(w):
            nu[i] = rows.nu[i]
            taken[i] = where(ok > 0.0, used[i], 0.0)
        for _ in range(1, carry.iterations):
            if carry.again:
                _rows_at(u, kind, moment, z, settings, rows)
            for i in range(w):
                residual[i] = rows.nu[i] if carry.again else nu[i]
                for j in range(n):
                    by = rows.H[i, j] * u.dx[j]
                    if not carry.again or j >= 9:
                        residual[i] += by
                nu[i] = residual[i]
                for j in range(n):
                    nu[i] -= rows.H[i, j] * u.dx[j]
                if carry.again:
                    first[i, i] = rows.R[i, i] + where(taken[i] > 0.0, var[i], 0.0) * u.scale[kind, i]
                    for j in range(i):
                        first[i, j], first[j, i] = rows.R[i, j], rows.R[i, j]
                weight[i] = where(taken[i] > 0.0, _weight(carry, residual[i], first[i, i]), 1.0)
            for i in range(w):
                for j in range(w):
                    rows.R[i, j] = first[i, j] / math.sqrt(weight[i] * weight[j])
            for i in range(n):
                for j in range(n):
                    u.P[i, j] = where(ok > 0.0, u.before[i, j], u.P[i, j])
            update(u.P, nu, rows.H, rows.R, taken, thresholds, math.inf + 0.0 * u.dx[0], u.dx, u.again, u.K)
    return nis, dof, ok, bad


@njit(cache=True, nogil=True)
def _rows_at(u: Update, kind: int, moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Rows at the navigation state less the error estimated so far; the other states act linearly."""
    for i in range(u.nav.size):
        u.nav[i], u.nav_before[i] = moment.nav[i], moment.nav_before[i]
    take_off(u.nav, u.dx)
    take_off(u.nav_before, u.dx)
    here = Moment(
        u.nav, u.nav_before, moment.dt, moment.tau, moment.rate, moment.rate_before, moment.mean_rate, moment.samples, moment.white, moment.c_of,
        moment.axis, moment.lever, moment.lever_at, moment.latency_at, moment.clock, moment.clock_at,
        moment.trend,
    )  # fmt: skip
    fill_rows(kind, here, z, settings, rows)


@njit(cache=True, nogil=True)
def _weight(carry: Carry, residual: float, variance: float) -> float:
    """Weight of a component by its residual: 1 at most for Huber, (limit + 1) / (limit + u^2) for Student's t."""
    square = residual * residual / variance
    if carry.loss == 1:
        return carry.limit / max(math.sqrt(square), carry.limit)
    if carry.loss == 2:
        return (carry.limit + 1.0) / (carry.limit + square)
    return 1.0 + 0.0 * square


@njit(cache=True, nogil=True)
def settle(coordinates: int, nav: Array, P: Array, dx: Array) -> None:
    """Move an estimate by an estimated error, and the covariance into the coordinates of the family there.

    Parameters
    ----------
    coordinates : int
        0: plain, 1: left, 2: right.
    nav : (13,) array
        Corrected in place.
    P : (n, n) array
        Covariance of (dp, dv, phi, ...), in place.
    dx : (n,) array
        Estimated error; position and velocity are turned as they are taken off.
    """
    if coordinates > 0:
        M = zeros(dx, (3, 3))
        _jacobian(dx[6:9], M)
        for first in (0, 3):
            a, b, c = dx[first], dx[first + 1], dx[first + 2]
            for i in range(3):
                dx[first + i] = M[i, 0] * a + M[i, 1] * b + M[i, 2] * c
        if coordinates == 1:
            _turned(dx[6:9], P)
        else:
            for first in (0, 3):
                a, b, c = dx[first], dx[first + 1], dx[first + 2]
                _add_cross(first, a, b, c, P)
    take_off(nav, dx)


@njit(cache=True, nogil=True)
def _jacobian(phi: Array, M: Array) -> None:
    """Left Jacobian of SO(3) at ``-phi`` (3,), written to ``M`` (3, 3): I - a [phi x] + b [phi x]^2."""
    p, q, r = phi[0], phi[1], phi[2]
    square = p * p + q * q + r * r
    size = math.sqrt(max(square, 1e-6))
    a = where(square > 1e-6, (1.0 - math.cos(size)) / (size * size), 0.5 - square / 24.0)
    b = where(square > 1e-6, (size - math.sin(size)) / (size * size * size), 1.0 / 6.0 - square / 120.0)
    M[0, 0], M[0, 1], M[0, 2] = 1.0 - b * (q * q + r * r), a * r + b * p * q, -a * q + b * p * r
    M[1, 0], M[1, 1], M[1, 2] = -a * r + b * p * q, 1.0 - b * (p * p + r * r), a * p + b * q * r
    M[2, 0], M[2, 1], M[2, 2] = a * q + b * p * r, -a * p + b * q * r, 1.0 - b * (p * p + q * q)


@njit(cache=True, nogil=True)
def _turned(phi: Array, P: Array) -> None:
    """Turn the first three triples of ``P`` (n, n) by ``exp(-phi)``."""
    cw, cs = scalar_half_trig(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    x, y, z = -cs * phi[0], -cs * phi[1], -cs * phi[2]
    for side in range(2):
        for first in (0, 3, 6):
            for j in range(P.shape[0]):
                if side == 0:
                    a, b, c = P[first, j], P[first + 1, j], P[first + 2, j]
                else:
                    a, b, c = P[j, first], P[j, first + 1], P[j, first + 2]
                d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
                a, b, c = a + cw * d + (y * f - z * e), b + cw * e + (z * d - x * f), c + cw * f + (x * e - y * d)
                if side == 0:
                    P[first, j], P[first + 1, j], P[first + 2, j] = a, b, c
                else:
                    P[j, first], P[j, first + 1], P[j, first + 2] = a, b, c


@njit(cache=True, nogil=True)
def _add_cross(first: int, a: float, b: float, c: float, P: Array) -> None:
    """Let the errors from ``first`` on take up the cross product of (a, b, c) with the attitude errors, in ``P`` (n, n)."""
    for side in range(2):
        for j in range(P.shape[0]):
            if side == 0:
                x, y, z = P[6, j], P[7, j], P[8, j]
                P[first, j] += b * z - c * y
                P[first + 1, j] += c * x - a * z
                P[first + 2, j] += a * y - b * x
            else:
                x, y, z = P[j, 6], P[j, 7], P[j, 8]
                P[j, first] += b * z - c * y
                P[j, first + 1] += c * x - a * z
                P[j, first + 2] += a * y - b * x
