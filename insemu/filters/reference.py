"""The same filter, written to be read: dense matrices and filterpy's Kalman filter.

It shares with the compiled loop the mechanization step, the continuous error dynamics and the predicted fix, each tested on its own; the
transition, the driving covariance, their propagation and the update are built here from the equations. It is the oracle for the
compiled loop, two orders of magnitude slower, and what a reader should look at first.
"""

from __future__ import annotations

import time

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation, strapdown
from insemu.errors import InputError
from insemu.filters import measurements
from insemu.filters.ekf import FilterResult, FixTable, InitialSigma, LooselyCoupledEKF
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

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

    The states behind move first, ``x_k = Phi_x x_(k-1) + w_k``; the axes err by ``-(C_x e_x) + v`` during the step, so w_k reaches the
    navigation errors in the same step.

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


def reference_run(
    ekf: LooselyCoupledEKF,
    imu: ImuRecord,
    gnss: GnssRecord | None,
    initial: NavState | Trajectory,
    initial_sigma: InitialSigma | ArrayLike,
    *,
    initial_states: ArrayLike | None = None,
) -> FilterResult:
    """Fly ``ekf`` through a record with filterpy; same arguments and result as :meth:`LooselyCoupledEKF.run`.

    Options beyond gating, output rate and ``covariance_at`` are not carried.

    Raises
    ------
    InputError
        An option that only the compiled loop has.
    """
    o, a = ekf.options, ekf.augmentation
    if o.covariance_every != 1 or o.store != "none" or o.standstill is not None:
        raise InputError("the reference filter runs at full covariance rate, without nodes or standstill updates")
    started = time.perf_counter()
    record = imu.as_increments()
    t = record.t
    nav = np.concatenate(
        [(NavState.of(initial) if isinstance(initial, Trajectory) else initial).to_array(), np.zeros(3)]
    )
    n, m = ekf.layout.n, a.m
    kf = KalmanFilter(dim_x=n, dim_z=6)
    kf.x = np.zeros(n)
    kf.P = ekf.initial_covariance(initial_sigma)
    x = np.zeros(m) if initial_states is None else np.array(initial_states, dtype=np.float64)
    events = ekf.events(t, gnss)
    thresholds = ekf.thresholds()
    lever_at, latency_at = ekf.installation()
    nu_all, S_all = np.full((len(events.t), 6), np.nan), np.full((len(events.t), 6, 6), np.nan)
    nis, dof = np.full(len(events.t), np.nan), np.zeros(len(events.t), dtype=np.int64)
    accepted = np.zeros(len(events.t), dtype=bool)
    wanted = np.unique(np.searchsorted(t, np.asarray(o.covariance_at, dtype=np.float64) - 1e-9).clip(0, t.size - 1))
    kept: list[Array] = []
    rows: list[tuple[float, Array, Array, Array]] = []
    F = np.empty((9, 9))
    dtheta = dvel = rate = np.zeros(3)
    dt_before = t[1] - t[0]
    event = 0
    for k in range(t.size):
        if k > 0:
            dt = t[k] - t[k - 1]
            measured = np.concatenate([record.gyro[k], record.accel[k]])
            C_x, seen = a.output(measured / dt), a.coefficients(measured / dt)
            x = a.Phi @ x
            corrected = measured - C_x @ x * dt
            dtheta_before, dvel_before, rate_before = dtheta, dvel, rate
            dtheta, dvel = corrected[:3].copy(), corrected[3:].copy()
            rate = dtheta / dt
            if k == 1:
                dtheta_before, dvel_before, rate_before = dtheta, dvel, rate
            C = rotation.dcm_from_quaternion(nav[6:10]) @ (np.eye(3) + rotation.skew(0.5 * dtheta))
            strapdown.fill_dynamics(nav, C @ dvel / dt, earth.gravity_code(ekf.gravity), F)
            kf.F, kf.Q = augmented(*step_matrices(F, C, dt), a.Phi, a.Q, C_x, a.white)
            kf.predict()
            kf.P = 0.5 * (kf.P + kf.P.T)
            nav_before = nav.copy()
            strapdown.step(
                nav, dtheta, dvel, dtheta_before, dvel_before, dt, dt_before, earth.gravity_code(ekf.gravity)
            )
            dt_before = dt
        while event < len(events.t) and events.epoch[event] == k:
            lever = ekf.lever_arm + (x[lever_at - 9 : lever_at - 6] if lever_at >= 0 else 0.0)
            tau = events.tau[event] + (x[latency_at - 9] if latency_at >= 0 else 0.0)
            nu, H, R = np.empty(6), np.empty((6, n)), np.empty((6, 6))
            measurements.fill_fix(
                nav, nav_before, dt, tau, rate, rate_before, lever, a.white, seen, a.axis, lever_at, latency_at, events.z[event], nu, H, R
            )  # fmt: skip
            R += np.diag(events.var[event])
            used = np.isfinite(events.z[event]) & np.isfinite(events.var[event])
            if used.any():
                H, R = H[used], R[np.ix_(used, used)]
                S = H @ kf.P @ H.T + R
                nu_all[event, used] = nu[used]
                S_all[event][np.ix_(used, used)] = S
                nis[event], dof[event] = nu[used] @ np.linalg.solve(S, nu[used]), used.sum()
                accepted[event] = nis[event] <= thresholds[dof[event]]
                if accepted[event]:
                    # the filter's state is the error, so what is measured of it is predicted minus measured
                    kf.update(-nu[used], R=R, H=H)
                    kf.P = 0.5 * (kf.P + kf.P.T)
                    measurements.take_off(nav, kf.x)
                    x = x - kf.x[9:]
                    kf.x = np.zeros(n)
            event += 1
        if k in wanted:
            kept.append(kf.P.copy())
        if k % o.output_every == 0 or k == t.size - 1:
            rows.append((t[k], nav[:10].copy(), np.sqrt(np.maximum(np.diag(kf.P), 0.0)), x.copy()))
    fixes = FixTable(events.t, events.epoch, events.kind, nu_all, S_all, nis, dof, accepted)
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
