"""The same filter, written to be read: dense matrices and filterpy's Kalman filter.

It shares with the compiled loop the mechanization step, the continuous error dynamics and the predicted fix, each tested on its own; the
transition, the driving covariance, their propagation and the update are built here from the equations. It is the oracle for the
compiled loop, two orders of magnitude slower, and what a reader should look at first.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from insemu import earth, rotation, strapdown
from insemu.errors import InputError
from insemu.filters import following, measurements
from insemu.filters.aids import fill_rows
from insemu.filters.ekf import Flight, LooselyCoupledEKF, steps_around, trend_window
from insemu.filters.events import FIX_ROWS, SAME_TIME, Events
from insemu.filters.kernel import LATE_STEPS
from insemu.filters.results import FilterResult, FixTable
from insemu.filters.rows import Moment, Rows

Array = NDArray[np.float64]


def step_matrices(F: Array, C: Array, dt: float) -> tuple[Array, Array]:
    """Discrete error dynamics of one step, with the trapezoid structure of the mechanization.

    Attitude errors move first; the velocity errors see the mean of old and new attitude errors, the position errors the mean of old and
    new velocity errors.

    Parameters
    ----------
    F : (9, 9) array
        Continuous dynamics of (position, velocity, attitude), :func:`insemu.strapdown.error_dynamics`.
    C : (3, 3) array
        ``C_nb`` at the middle of the step.
    dt : float
        s.

    Returns
    -------
    Phi : (9, 9) array
        Transition of the navigation errors.
    B : (9, 6) array
        Effect of constant errors of rate and specific force during the step.
    """
    p, v, a = slice(0, 3), slice(3, 6), slice(6, 9)
    old = np.hstack([np.eye(9), np.zeros((9, 6))])  # columns: the nine errors before, six errors of the axes
    new = old.copy()
    new[a] = old[a] + dt * (F[a] @ old)
    new[a, 9:12] += dt * C
    new[v] = old[v] + dt * (F[v, p] @ old[p] + F[v, v] @ old[v] + F[v, a] @ (old[a] + new[a]) / 2)
    new[v, 12:15] += dt * C
    new[p] = old[p] + dt * (F[p, p] @ old[p] + (old[v] + new[v]) / 2)
    return new[:, :9], new[:, 9:]


def augmented(Phi: Array, B: Array, Phi_x: Array, Q_x: Array, C_x: Array, white: Array) -> tuple[Array, Array]:
    """Transition and driving covariance of the whole filter.

    The augmented states move first, ``x_k = Phi_x x_(k-1) + w_k``; the axes err by ``-(C_x e_x) + v`` during the step, so w_k reaches the
    navigation errors in the same step.

    Parameters
    ----------
    Phi, B : (9, 9), (9, 6) arrays
        Of :func:`step_matrices`.
    Phi_x, Q_x : (m, m) arrays
        Transition and driving covariance of the augmented states.
    C_x : (6, m) array
        What the six axes see of them.
    white : (6,) array
        Variances of the axes' own white noise, (rad/s)^2 and (m/s^2)^2.

    Returns
    -------
    (n, n), (n, n) arrays
    """
    m = Phi_x.shape[0]
    n = 9 + m
    G = np.vstack([-B @ C_x, np.eye(m)])
    F = np.zeros((n, n))
    F[:9, :9] = Phi
    F[:, 9:] = G @ Phi_x
    Q = G @ Q_x @ G.T
    Q[:9, :9] += B @ np.diag(white) @ B.T
    return F, Q


@dataclass
class _Moving:
    """The filter between two epochs: what moves, and what the last step was."""

    ekf: LooselyCoupledEKF
    kf: KalmanFilter
    nav: Array
    x: Array
    t: Array
    gyro: Array
    nav_before: Array = field(default_factory=lambda: np.zeros(13))
    dt: float = 0.0
    dt_before: float = 0.0
    dtheta: Array = field(default_factory=lambda: np.zeros(3))
    dvel: Array = field(default_factory=lambda: np.zeros(3))
    rate: Array = field(default_factory=lambda: np.zeros(3))
    rate_before: Array = field(default_factory=lambda: np.zeros(3))
    seen: Array = field(default_factory=lambda: np.zeros(0))
    known: Array = field(default_factory=lambda: np.zeros(6))  # what the axes saw of the estimated states
    rates: list[Array] = field(default_factory=list)
    motion: list[Array] = field(default_factory=list)  # acceleration and rate of the last steps, as updates left them
    C: Array = field(default_factory=lambda: np.eye(3))
    f_n: Array = field(default_factory=lambda: np.zeros(3))
    white: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def installed(self) -> bool:
        """Whether lever arm or latency is a state."""
        return max(self.ekf.installation()) >= 0

    def predict(self, measured: Array, dt: float, power: Array) -> None:
        """One IMU step: augmented states first, then the covariance, then the navigation; ``power`` holds squared gains of what follows."""
        a, gravity = self.ekf.augmentation, earth.gravity_code(self.ekf.gravity)
        first = not self.rates
        C_x, self.seen = a.output(measured / dt), a.coefficients(measured / dt)
        Phi, Q = self.moving(power)
        self.x = Phi @ self.x
        self.known = C_x @ self.x
        corrected = measured[:6] - self.known * dt
        dtheta_before, dvel_before, self.rate_before = self.dtheta, self.dvel, self.rate
        self.dtheta, self.dvel = corrected[:3].copy(), corrected[3:].copy()
        self.rate = self.dtheta / dt
        if first:
            dtheta_before, dvel_before, self.rate_before = self.dtheta, self.dvel, self.rate
        self.C = C = rotation.dcm_from_quaternion(self.nav[6:10]) @ (np.eye(3) + rotation.skew(0.5 * self.dtheta))
        self.f_n = C @ self.dvel / dt
        F = np.empty((9, 9))
        strapdown.fill_dynamics(self.nav, self.f_n, gravity, F)
        self.kf.F, self.kf.Q = augmented(*step_matrices(F, C, dt), Phi, Q, C_x, self.white)
        self.kf.predict()
        self.kf.P = 0.5 * (self.kf.P + self.kf.P.T)
        self.nav_before = self.nav.copy()
        strapdown.step(
            self.nav, self.dtheta, self.dvel, dtheta_before, dvel_before, dt, dt if first else self.dt_before, gravity
        )
        self.dt = self.dt_before = dt
        self.rates.append(self.rate)
        acceleration = (self.nav - self.nav_before)[3:6] / dt
        self.motion = [*self.motion[1 - trend_window(self.ekf.dt) :], np.concatenate([acceleration, self.rate])]

    def moving(self, power: Array) -> tuple[Array, Array]:
        """Transition and driving covariance of the augmented states where they follow covariates; the white noise of the step is kept."""
        a, now = self.ekf.augmentation, power.copy()
        self.white = a.white
        if not a.laws:
            return a.Phi, a.Q
        following.add_speed(now, following.of_speed(a), float(np.linalg.norm(self.nav[3:6])))
        self.white = a.white + now @ a.white_of
        Phi, Q = a.moved(np.sqrt(now))
        gain = np.where(a.law_of >= 0, np.sqrt(now)[a.law_of], 1.0)
        return Phi, np.asarray(Q * np.outer(gain, gain))

    def trend(self, k: int, mean_dt: float, tau: float) -> Array:
        """How acceleration and rate go on, and the rate; see ``fill_trend`` and ``fill_rate`` of :mod:`insemu.filters.measurements`."""
        window = trend_window(self.ekf.dt)
        past, out = np.zeros((window, 6)), np.empty(12)
        for j in range(max(1, k - window + 1), k + 1):
            past[j % window] = self.motion[j - 1 - k]
        measurements.fill_trend(past, k, mean_dt, out)
        measurements.fill_rate(self.t, self.gyro, self.known, past, k, tau, steps_around(self.ekf.dt), out[9:])
        return out

    def measurement(self, events: Events, at: int, tau: float, k: int, mean_dt: float) -> tuple[Array, Array, Array]:
        """Innovation, Jacobian and noise of one fix or aid, used at epoch ``k``."""
        a, w = self.ekf.augmentation, events.z.shape[1]
        nu, H, R = np.empty(w), np.empty((w, 9 + a.m)), np.empty((w, w))
        kind, (lever_at, latency_at) = int(events.kind[at]), self.ekf.installation()
        is_fix = kind == measurements.FIX
        trend = self.trend(k, mean_dt, tau) if is_fix and self.installed else np.zeros(12)
        lever = self.ekf.lever_arm + (self.x[lever_at - 9 : lever_at - 6] if lever_at >= 0 else 0.0)
        clock_at = self.ekf.clock_at
        clock = self.x[clock_at - 9 : clock_at - 7] if clock_at >= 0 else np.zeros(2)
        rates = [self.rate] if is_fix else self.rates[events.since[at] : k]
        moment = Moment(
            self.nav, self.nav_before, self.dt, tau, self.rate, self.rate_before, np.mean(rates, axis=0), len(rates), self.white, self.seen,
            a.axis, lever, lever_at, latency_at, clock, clock_at, trend,
        )  # fmt: skip
        fill_rows(kind, moment, events.z[at], events.settings[at], Rows(nu, H, R))
        if is_fix and latency_at >= 0:
            measurements.add_curvature(trend, self.kf.P[latency_at, latency_at], nu, R)
        return nu, H, R + np.diag(np.nan_to_num(events.var[at], posinf=0.0))

    def update(self, nu: Array, H: Array, R: Array) -> None:
        """An accepted measurement; the filter's state is the error, so what is measured of it is predicted minus measured."""
        self.kf.update(-nu, R=R, H=H)
        self.kf.P = 0.5 * (self.kf.P + self.kf.P.T)
        dx = self.kf.x
        measurements.take_off(self.nav, dx)
        self.x = self.x - dx[9:]
        self.kf.x = np.zeros(dx.size)
        if self.installed:
            change, axis = np.empty(6), self.ekf.augmentation.axis
            measurements.take_off(self.nav_before, dx)
            measurements.motion_change(np.ascontiguousarray(self.C), self.f_n, dx, self.seen, axis, change)
            self.motion = [m + change for m in self.motion]
            self.rate, self.rate_before = self.rate + change[3:], self.rate_before + change[3:]
            self.known = self.known - np.append(change[3:], np.zeros(3))


def _due(flight: _Moving, events: Events, waiting: list[int], t: Array, k: int) -> tuple[int, float] | None:
    """The next measurement that is used at epoch ``k``, and how long ago it was valid; None where there is none."""
    latency_at = flight.ekf.installation()[1]
    tolerance = SAME_TIME * flight.ekf.dt
    for at in waiting:
        moving = events.kind[at] == measurements.FIX and latency_at >= 0
        if moving and any(events.kind[e] == measurements.FIX and e < at for e in waiting):
            continue  # fixes wait for each other
        own = events.t[at] - (flight.x[latency_at - 9] if moving else 0.0)
        if own <= t[k] + tolerance if moving else events.epoch[at] == k:
            tau = float(t[k] - own) if moving else float(events.tau[at])
            return at, 0.0 if moving and tau < tolerance else tau
    return None


def _flown(ekf: LooselyCoupledEKF, given: Flight) -> FilterResult:
    """One record through filterpy's filter."""
    o = ekf.options
    if o.covariance_every != 1 or o.store != "none":
        raise InputError("the reference filter runs at full covariance rate and without nodes")
    started = time.perf_counter()
    (t, gyro, accel, power), begun, events = given.samples, given.start, given.events
    n = ekf.layout.n
    kf = KalmanFilter(dim_x=n, dim_z=FIX_ROWS)
    kf.x, kf.P = np.zeros(n), begun.P
    flight = _Moving(ekf, kf, np.concatenate([begun.nav, np.zeros(3)]), begun.x, t, gyro)
    f, w = events.z.shape
    thresholds = ekf.thresholds(w)
    fixes = FixTable(
        events.t, events.epoch.copy(), events.kind, np.full((f, w), np.nan), np.full((f, w, w), np.nan), np.full(f, np.nan),
        np.zeros(f, dtype=np.int64), np.zeros(f, dtype=bool),
    )  # fmt: skip
    waiting, rejected_from = list(range(f)), np.inf
    wanted = ekf.covariance_epochs(t)
    kept: list[Array] = []
    rows: list[tuple[float, Array, Array, Array]] = []
    sensed = np.hstack([gyro, accel])
    for k in range(t.size):
        if k > 0:
            flight.predict(sensed[k], t[k] - t[k - 1], power[min(k, len(power) - 1)])
        while k > 0 and (due := _due(flight, events, waiting, t, k)) is not None:
            at, tau = due
            waiting.remove(at)
            fixes.epoch[at] = k
            used = np.isfinite(events.z[at]) & np.isfinite(events.var[at])
            if not used.any() or tau > LATE_STEPS * flight.dt:
                continue
            nu, H_all, R = flight.measurement(events, at, tau, k, (t[k] - t[0]) / k)
            nu, H, R = nu[used], H_all[used], R[np.ix_(used, used)]
            S = H @ kf.P @ H.T + R
            fixes.innovation[at, used] = nu
            fixes.S[at][np.ix_(used, used)] = S
            fixes.nis[at], fixes.dof[at] = nu @ np.linalg.solve(S, nu), used.sum()
            is_fix = events.kind[at] == measurements.FIX
            waited = is_fix and t[k] - rejected_from >= o.gate_timeout
            fixes.accepted[at] = waited or fixes.nis[at] <= thresholds[fixes.dof[at]]
            if is_fix:
                rejected_from = np.inf if fixes.accepted[at] else min(rejected_from, t[k])
            if fixes.accepted[at]:
                flight.update(nu, H, R)
                if is_fix and flight.installed:
                    after = flight.measurement(events, at, tau, k, (t[k] - t[0]) / k)[1]
                    kf.P = np.ascontiguousarray(kf.P)
                    measurements.turn(kf.P, H_all, after, used)
        if k in wanted:
            kept.append(kf.P.copy())
        if k % o.output_every == 0 or k == t.size - 1:
            rows.append((t[k], flight.nav[:10].copy(), np.sqrt(np.maximum(np.diag(kf.P), 0.0)), flight.x.copy()))
    return FilterResult(
        layout=ekf.layout,
        t=np.array([r[0] for r in rows]),
        nav=np.stack([r[1] for r in rows]),
        sigma=np.stack([r[2] for r in rows]),
        imu_states=np.stack([r[3] for r in rows]),
        fixes=fixes,
        covariance_t=t[wanted],
        covariance=np.stack(kept) if kept else np.zeros((0, n, n)),
        nodes=None,
        final_covariance=kf.P,
        epochs=t.size - 1,
        seconds=time.perf_counter() - started,
    )


class ReferenceEKF(LooselyCoupledEKF):
    """The design of a :class:`LooselyCoupledEKF` flown by filterpy, two orders of magnitude slower: in a scenario ``filter: reference``.

    Every epoch of the covariance is propagated, and no nodes are kept; options that ask for something else raise ``InputError``.
    """

    def _fly(self, flights: Sequence[Flight], *, side_by_side: bool) -> list[FilterResult | InputError]:
        return [_flown(self, flight) for flight in flights]


def reference_run(ekf: LooselyCoupledEKF, *record: Any, **further: Any) -> FilterResult:
    """:meth:`LooselyCoupledEKF.run` of the design ``ekf``, flown by filterpy; the same arguments, result and errors."""
    return ekf.again(ekf.dt, ekf.options, ReferenceEKF).run(*record, **further)
