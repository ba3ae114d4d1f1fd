"""Measurements of the filter, compiled: predicted fixes with their Jacobians, and the Joseph update of a plain covariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.earth import RATE, scalar_radii
from insemu.filters.rows import Moment, Rows
from insemu.lanes import any_of, number_at, where, zeros
from insemu.rotation import scalar_dcm, scalar_wrapped
from insemu.strapdown import correct

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Code of a fix among the kinds of events; aids have codes from 1 on.
FIX = 0


@njit(cache=True, nogil=True)
def first_bad_pivot(P: Array, L: Array) -> float:
    """Index of the first state that makes ``P`` not positive semidefinite (to 1e-9 of its variance), or -1; ``L`` is working space."""
    n = P.shape[0]
    bad = -1.0
    for j in range(n):
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        right = min(P[j, j], pivot + 1e-9 * P[j, j]) >= 0.0
        bad = where(right, bad, where(bad < 0.0, float(j), bad))
        vanishes = pivot <= 1e-13 * P[j, j]
        root = where(vanishes, 1.0, math.sqrt(max(pivot, 0.0)))
        L[j, j] = where(vanishes, 0.0, root)
        for i in range(j + 1, n):
            x = P[i, j]
            for k in range(j):
                x -= L[i, k] * L[j, k]
            L[i, j] = where(vanishes, 0.0, x / root)
    return bad


@njit(cache=True, nogil=True)
def against_earth(nav: Array, C: Array, rate: Array, out: Array) -> None:
    """Rate of the body against the Earth from its rate against inertial space, rad/s in body axes.

    Parameters
    ----------
    nav : (13,) array
        State, of which the latitude counts.
    C : (3, 3) array
        Body to NED.
    rate, out : (3,) arrays
        ``out`` is overwritten, and may be ``rate``.
    """
    we_n, we_d = RATE * math.cos(nav[0]), -RATE * math.sin(nav[0])
    for i in range(3):
        out[i] = rate[i] - C[0, i] * we_n - C[2, i] * we_d


@njit(cache=True, nogil=True)
def fill_fix(moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Rows of a GNSS fix (:mod:`insemu.filters.rows`): position and velocity of the antenna.

    Both are taken back by the mean acceleration of the last step and by the rate: the age is meant to be shorter than a step or two. Innovations are
    in metres and m/s north, east, down. The noise is what the gyroscope's white noise adds through the lever arm.

    Parameters
    ----------
    moment : Moment
    z : (6,) array
        Latitude, longitude, height, velocity NED.
    settings : array
        None of a fix.
    rows : Rows
        Overwritten.
    """
    nav, nav_before, dt, tau, rate, rate_before = (
        moment.nav,
        moment.nav_before,
        moment.dt,
        moment.tau,
        moment.rate,
        moment.rate_before,
    )
    lever, lever_at, latency_at, trend = moment.lever, moment.lever_at, moment.latency_at, moment.trend
    white, c_of, axis = moment.white, moment.c_of, moment.axis
    nu, H, R = rows.nu, rows.H, rows.R
    C = zeros(nav, (3, 3))
    scalar_dcm(nav[6:10], C)
    rm, rn = scalar_radii(math.sin(nav[0]))
    h = nav[2]
    acc = zeros(nav, 3)
    for i in range(3):
        acc[i] = (nav[3 + i] - nav_before[3 + i]) / dt
    # rate with respect to the Earth at the time of the fix: the last mean carried from the middle of its step
    shift = (0.5 * dt - min(tau, dt)) / dt
    omega = zeros(nav, 3)
    for i in range(3):
        omega[i] = rate[i] + shift * (rate[i] - rate_before[i])
    against_earth(nav, C, omega, omega)
    turn = zeros(nav, 3)
    turn[0] = omega[1] * lever[2] - omega[2] * lever[1]
    turn[1] = omega[2] * lever[0] - omega[0] * lever[2]
    turn[2] = omega[0] * lever[1] - omega[1] * lever[0]
    arm, swing, omega_n = zeros(nav, 3), zeros(nav, 3), zeros(nav, 3)
    for i in range(3):
        for j in range(3):
            arm[i] += C[i, j] * lever[j]
            swing[i] += C[i, j] * turn[j]
            omega_n[i] += C[i, j] * omega[j]
    # the arm as it stood at the time of the fix: back by the mean rate since then, which over a whole step is the measured one
    for i in range(3):
        turn[i] = 0.5 * min(tau, dt) / dt * (rate[i] - rate_before[i])
    b0 = turn[1] * lever[2] - turn[2] * lever[1]
    b1 = turn[2] * lever[0] - turn[0] * lever[2]
    b2 = turn[0] * lever[1] - turn[1] * lever[0]
    a0 = arm[0] - tau * (swing[0] + C[0, 0] * b0 + C[0, 1] * b1 + C[0, 2] * b2)
    a1 = arm[1] - tau * (swing[1] + C[1, 0] * b0 + C[1, 1] * b1 + C[1, 2] * b2)
    a2 = arm[2] - tau * (swing[2] + C[2, 0] * b0 + C[2, 1] * b1 + C[2, 2] * b2)
    s0 = swing[0] - tau * (omega_n[1] * swing[2] - omega_n[2] * swing[1])
    s1 = swing[1] - tau * (omega_n[2] * swing[0] - omega_n[0] * swing[2])
    s2 = swing[2] - tau * (omega_n[0] * swing[1] - omega_n[1] * swing[0])
    half = 0.5 * tau * tau
    dlon = scalar_wrapped(z[1] - nav[1] - nav[11])
    nu[0] = (z[0] - nav[0] - nav[10]) * (rm + h) - (a0 - tau * nav[3] + half * acc[0])
    nu[1] = dlon * (rn + h) * math.cos(nav[0]) - (a1 - tau * nav[4] + half * acc[1])
    nu[2] = h - z[2] + nav[12] - (a2 - tau * nav[5] + half * acc[2])
    nu[3] = z[3] - (nav[3] - tau * acc[0] + s0)
    nu[4] = z[4] - (nav[4] - tau * acc[1] + s1)
    nu[5] = z[5] - (nav[5] - tau * acc[2] + s2)

    for i in range(3):
        H[i, i] = 1.0
        H[i, 3 + i] = -tau
        H[3 + i, 3 + i] = 1.0
    H[0, 7], H[0, 8] = a2, -a1
    H[1, 6], H[1, 8] = -a2, a0
    H[2, 6], H[2, 7] = a1, -a0
    # -[swing x] and, by the velocity's change since the fix, + tau [f_n x]; f_n is the acceleration less gravity to the order that matters
    f0, f1, f2 = tau * acc[0], tau * acc[1], tau * (acc[2] - 9.81)
    H[3, 7], H[3, 8] = s2 - f2, f1 - s1
    H[4, 6], H[4, 8] = f2 - s2, s0 - f0
    H[5, 6], H[5, 7] = s1 - f1, f0 - s0
    if any_of(abs(lever[0]) + abs(lever[1]) + abs(lever[2]) > 0.0):
        # velocity error of the arm: -C [l x] dw, dw = -(c e_x) + white
        X = zeros(nav, (3, 3))
        for i in range(3):
            X[i, 0] = -(C[i, 1] * lever[2] - C[i, 2] * lever[1])
            X[i, 1] = -(C[i, 2] * lever[0] - C[i, 0] * lever[2])
            X[i, 2] = -(C[i, 0] * lever[1] - C[i, 1] * lever[0])
        for s in range(axis.size):
            if 0 <= axis[s] < 3:
                for i in range(3):
                    H[3 + i, 9 + s] = -X[i, axis[s]] * c_of[s]
                    H[i, 9 + s] = tau * X[i, axis[s]] * c_of[s]
        spread = (1.0 + shift) * (1.0 + shift) + shift * shift
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    R[3 + i, 3 + j] += spread * white[k] * X[i, k] * X[j, k]
    if lever_at >= 0 or latency_at >= 0:
        # from here on derivatives: by a rate whose noise is not in the innovation
        against_earth(nav, C, trend[9:12], omega)
        turn[0] = omega[1] * lever[2] - omega[2] * lever[1]
        turn[1] = omega[2] * lever[0] - omega[0] * lever[2]
        turn[2] = omega[0] * lever[1] - omega[1] * lever[0]
        for i in range(3):
            swing[i], omega_n[i] = 0.0, 0.0
            for j in range(3):
                swing[i] += C[i, j] * turn[j]
                omega_n[i] += C[i, j] * omega[j]
    if lever_at >= 0:
        # C [w x], and its change with the age of the fix
        M = zeros(nav, (3, 3))
        for i in range(3):
            M[i, 0] = C[i, 1] * omega[2] - C[i, 2] * omega[1]
            M[i, 1] = C[i, 2] * omega[0] - C[i, 0] * omega[2]
            M[i, 2] = C[i, 0] * omega[1] - C[i, 1] * omega[0]
        for j in range(3):
            for i in range(3):
                H[i, lever_at + j] = C[i, j] - tau * M[i, j]
            H[3, lever_at + j] = M[0, j] - tau * (omega_n[1] * M[2, j] - omega_n[2] * M[1, j])
            H[4, lever_at + j] = M[1, j] - tau * (omega_n[2] * M[0, j] - omega_n[0] * M[2, j])
            H[5, lever_at + j] = M[2, j] - tau * (omega_n[0] * M[1, j] - omega_n[1] * M[0, j])
    if latency_at >= 0:
        for i in range(3):
            H[i, latency_at] = -(nav[3 + i] + swing[i]) + tau * acc[i]
        b0 = trend[4] * lever[2] - trend[5] * lever[1]
        b1 = trend[5] * lever[0] - trend[3] * lever[2]
        b2 = trend[3] * lever[1] - trend[4] * lever[0]
        H[3, latency_at] = -trend[0] - (omega_n[1] * swing[2] - omega_n[2] * swing[1])
        H[4, latency_at] = -trend[1] - (omega_n[2] * swing[0] - omega_n[0] * swing[2])
        H[5, latency_at] = -trend[2] - (omega_n[0] * swing[1] - omega_n[1] * swing[0])
        for i in range(3):
            H[3 + i, latency_at] -= C[i, 0] * b0 + C[i, 1] * b1 + C[i, 2] * b2


@njit(cache=True, nogil=True)
def fill_trend(past: Array, k: int, dt: float, trend: Array) -> None:
    """How acceleration and rate go on, from the last steps.

    The straight line through the last steps, at this epoch, weighted by a Hann window: what is left of a vibration would be information about
    the latency that there is none of. The last two steps are left out: their rates are in the predicted velocity of the antenna, and noise
    that a measurement shares with its derivative would be taken for latency (by 3 ms in a minute with 0.03 deg/s/sqrt(Hz) and 1.6 m).

    Parameters
    ----------
    past : (window, 6) array
        Acceleration (north, east, down) and corrected rate (body axes) of the steps to epoch j in row ``j % window``.
    k : int
        This epoch.
    dt : float
        s.
    trend : (12,) array
        Overwritten but for the last three: acceleration (m/s^2), angular acceleration in body axes (rad/s^2), jerk (m/s^3).
    """
    window = past.shape[0]
    trend[:9] = 0.0
    count = min(window, k) - 2
    if count < 3:
        for i in range(3):
            trend[i] = past[k % window, i]
        return
    middle = 0.5 * (count - 1)
    total, spread = 0.0, 0.0
    for j in range(count):
        weight = math.sin(math.pi * (j + 0.5) / count) ** 2
        total += weight
        spread += weight * (middle - j) ** 2
    for j in range(count):
        at = (k - 2 - j) % window
        weight = math.sin(math.pi * (j + 0.5) / count) ** 2
        slope = weight * (middle - j) / (spread * dt)
        for i in range(3):
            trend[i] += weight / total * past[at, i]
            trend[3 + i] += slope * past[at, 3 + i]
            trend[6 + i] += slope * past[at, i]
    for i in range(3):
        trend[i] += trend[6 + i] * (middle + 2.0) * dt


@njit(cache=True, nogil=True)
def fill_rate(t: Array, gyro: Any, seen: Array, past: Array, k: int, tau: float, around: int, rate: Array) -> None:
    """The rate of the body when a fix was valid, from the steps on both sides of the two whose rates predict its velocity.

    The noise of a rate that both the innovation and its derivative by the lever arm are made of would be taken for information about the
    arm (errors in variables). A straight line between the means of as many steps before and after has no noise in common with the
    innovation and is not late. At the end of a record there are fewer steps after, or none.

    Parameters
    ----------
    t : (epochs,) array
        s.
    gyro : (epochs, 3) array, or tuple of them, one a lane
        Increments over the steps to the epochs, rad.
    seen : (3+,) array
        What the axes see of the estimated states, rad/s.
    past : (window, 6) array
        See :func:`fill_trend`.
    k : int
        This epoch.
    tau : float
        Age of the fix, s.
    around : int
        Steps on each side, at most ``window`` less two.
    rate : (3,) array
        Overwritten: against inertial space, body axes, rad/s.
    """
    window = past.shape[0]
    before, after = max(min(around, k - 2), 0), min(around, t.size - 1 - k)
    dt = t[k] - t[k - 1]
    share = (2.0 + 0.5 * before - tau / dt) / (2.0 + 0.5 * (before + after))  # of the steps after
    if after == 0:
        share = 0.0
    if before == 0:
        share = 1.0
    for i in range(3):
        if before + after == 0:
            rate[i] = past[k % window, 3 + i]
            continue
        rate[i] = 0.0
        for j in range(before):
            rate[i] += (1.0 - share) * past[(k - 2 - j) % window, 3 + i] / before
        if after > 0:
            total = 0.0
            for j in range(after):
                total += number_at(gyro, k + 1 + j, i)
            rate[i] += share * (total / (t[k + after] - t[k]) - seen[i])


@njit(cache=True, nogil=True)
def add_curvature(trend: Array, variance: float, nu: Array, R: Array) -> None:
    """What a latency of this variance (s^2) does beyond the linear: the mean and the covariance of the second-order terms.

    Parameters
    ----------
    trend : (9,) array
        See :func:`fill_trend`.
    variance : float
    nu, R : (w,), (w, w) arrays
        Innovation and noise of a fix, changed in place (Jazwinski 1970, section 9.3: the second-order filter).
    """
    for i in range(6):
        a = trend[i] if i < 3 else trend[3 + i]
        nu[i] -= 0.5 * a * variance
        for j in range(6):
            b = trend[j] if j < 3 else trend[3 + j]
            R[i, j] += 0.5 * a * b * variance * variance


@njit(cache=True, nogil=True)
def motion_change(C: Array, f_n: Array, dx: Array, c_of: Array, axis: Ints, change: Array) -> None:
    """By how much an update moves the estimates of acceleration and rate.

    Parameters
    ----------
    C : (3, 3) array
        Body to NED.
    f_n : (3,) array
        Specific force, NED, m/s^2.
    dx : (n,) array
        Estimated error that is taken off.
    c_of, axis : (m,) arrays
        What axis each augmented state is seen by, and how strongly.
    change : (6,) array
        Overwritten: acceleration, NED, m/s^2, and rate, body axes, rad/s.
    """
    sensed = zeros(dx, 6)
    for s in range(axis.size):
        if axis[s] >= 0:
            sensed[axis[s]] += c_of[s] * dx[9 + s]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        change[i] = f_n[j] * dx[6 + k] - f_n[k] * dx[6 + j]
        for q in range(3):
            change[i] += C[i, q] * sensed[3 + q]
        change[3 + i] = sensed[i]


@njit(cache=True, nogil=True)
def turn(P: Array, H: Array, H_after: Array, used: Array) -> None:
    """Keep the covariance of what a fix sees when the estimates that it is linearized at change.

    A fix sees position and velocity of the antenna at its own time. An update moves the estimates of attitude, velocity, lever arm and latency,
    so that fixes after it see another combination of the errors, and what lies between the two would be taken for information that there
    is none of (Huang, Mourikis, Roumeliotis 2010). So the covariance of what the fix sees stays as the update left it, and the errors of
    position and velocity take up the difference.

    Parameters
    ----------
    P : (n, n) array
        Covariance after an update, changed in place.
    H, H_after : (w, n) arrays
        Jacobian of the fix at the estimates before and after the update, w >= 6.
    used : (w,) array
        1 where a component is used, else 0.
    """
    n = P.shape[0]
    for side in range(2):
        for i in range(6):
            for s in range(6, n):
                by = used[i] * (H[i, s] - H_after[i, s])
                if any_of(by != 0.0):
                    for j in range(n):
                        if side == 0:
                            P[i, j] += by * P[s, j]
                        else:
                            P[j, i] += by * P[j, s]


@njit(cache=True, nogil=True)
def take_off(nav: Array, dx: Array) -> None:
    """Take an estimated error off a navigation state and keep what rounding leaves of the position's change.

    The last digit of a latitude is worth 0.7 nm. That is nothing to a user, but an update that rounds the other way changes everything
    after it at that level, so that no two implementations of a filter would agree better than that.

    Parameters
    ----------
    nav : (13,) array
        Corrected in place; see :func:`insemu.strapdown.step` for the last three.
    dx : (n,) array
        Estimated error.
    """
    rm, rn = scalar_radii(math.sin(nav[0]))
    lat, lon, h = nav[0], nav[1], nav[2]
    correct(nav, dx)
    nav[10] += -dx[0] / (rm + h) - (nav[0] - lat)
    nav[11] += -dx[1] / ((rn + h) * math.cos(lat)) - (nav[1] - lon)
    nav[12] += dx[2] - (nav[2] - h)


@njit(cache=True, nogil=True)
def update(
    P: Array,
    nu_all: Array,
    H_all: Array,
    R_all: Array,
    used: Array,
    thresholds: Array,
    free: float,
    dx: Array,
    S_out: Array,
    K_out: Array,
) -> tuple[float, float, float, float]:
    """Joseph update of ``P`` (n, n) with the used rows of a measurement.

    A row that is used in some lanes only is overwritten in the others by a measurement of nothing with variance 1, which changes nothing.

    Parameters
    ----------
    P : (n, n) array
        Updated in place where the measurement is accepted.
    nu_all, H_all, R_all : (w,), (w, n), (w, w) arrays
        Innovation, Jacobian, noise.
    used : (w,) array
        1 where a component is used, else 0.
    thresholds : (w + 1,) array
        Largest accepted normalised innovation squared by the number of components (inf: no gate).
    free : float
        Whatever is smaller is accepted (inf: no gate, -inf: the thresholds decide).
    dx : (n,) array
        Overwritten by the estimated error (to be taken off); zero where the measurement is rejected.
    S_out, K_out : (w, w), (n, w) arrays
        Overwritten in the used rows and columns.

    Returns
    -------
    (nis, dof, accepted, bad)
        ``accepted`` is 1 or 0, ``bad`` the component in which the innovation covariance is not positive definite, -1 where there is none.
    """
    n = P.shape[0]
    rows = np.empty(nu_all.size, dtype=np.int64)
    q = 0
    dof, bad = 0.0 * used[0], -1.0
    for i in range(nu_all.size):
        if any_of(used[i] > 0.0):
            rows[q] = i
            q += 1
            dof += used[i]
            if any_of(used[i] < 1.0):
                _blank(used[i], i, nu_all, H_all, R_all)
    dx[:] = 0.0
    if q == 0:
        return math.nan * dof, dof, dof, bad
    G = zeros(P, (n, q))  # P H'
    for a in range(q):
        for j in range(n):
            h = H_all[rows[a], j]
            if any_of(h != 0.0):
                for i in range(n):
                    G[i, a] += P[i, j] * h
    S, L = zeros(P, (q, q)), zeros(P, (q, q))
    for a in range(q):
        for b in range(a, q):
            x = R_all[rows[a], rows[b]]
            for j in range(n):
                x += H_all[rows[a], j] * G[j, b]
            S[a, b] = x
            S[b, a] = x
            x = where(used[rows[a]] * used[rows[b]] > 0.0, x, math.nan)
            S_out[rows[a], rows[b]] = x
            S_out[rows[b], rows[a]] = x
    for j in range(q):
        x = S[j, j]
        for k in range(j):
            x -= L[j, k] * L[j, k]
        bad = where(x > 0.0, bad, where(bad < 0.0, float(rows[j]), bad))
        L[j, j] = math.sqrt(max(x, 0.0))
        for i in range(j + 1, q):
            x = S[i, j]
            for k in range(j):
                x -= L[i, k] * L[j, k]
            L[i, j] = x / L[j, j]
    y = zeros(P, q)
    nis, limit = 0.0 * dof, free + 0.0 * dof
    for a in range(q):
        x = nu_all[rows[a]]
        for k in range(a):
            x -= L[a, k] * y[k]
        y[a] = x / L[a, a]
        nis += y[a] * y[a]
    for a in range(1, q + 1):
        limit = where(dof >= a, max(thresholds[a], free), limit)
    ok = where(dof > 0.0, where(nis > limit, 0.0, 1.0), 0.0)
    nis = where(dof > 0.0, nis, math.nan)
    if not any_of(ok > 0.0):
        return nis, dof, ok, bad
    K = zeros(P, (n, q))  # G S^-1 by two triangular solves
    for i in range(n):
        for a in range(q):
            x = G[i, a]
            for k in range(a):
                x -= L[a, k] * K[i, k]
            K[i, a] = x / L[a, a]
        for a in range(q - 1, -1, -1):
            x = K[i, a]
            for k in range(a + 1, q):
                x -= L[k, a] * K[i, k]
            K[i, a] = x / L[a, a]
        x = 0.0 * dof
        for a in range(q):
            x -= K[i, a] * nu_all[rows[a]]
            K_out[i, rows[a]] = where(used[rows[a]] * ok > 0.0, K[i, a], K_out[i, rows[a]])
        dx[i] = where(ok > 0.0, x, 0.0)
    # (I - K H) P (I - K H)' + K R K'
    B = zeros(P, (n, n))
    for i in range(n):
        for j in range(n):
            x = P[i, j]
            for a in range(q):
                x -= K[i, a] * G[j, a]
            B[i, j] = x
    D = zeros(P, (n, q))
    for a in range(q):
        for j in range(n):
            h = H_all[rows[a], j]
            if any_of(h != 0.0):
                for i in range(n):
                    D[i, a] += B[i, j] * h
        for b in range(q):
            r = R_all[rows[b], rows[a]]
            if any_of(r != 0.0):
                for i in range(n):
                    D[i, a] -= K[i, b] * r
    for i in range(n):
        for j in range(i, n):
            x = 0.5 * (B[i, j] + B[j, i])
            for a in range(q):
                x -= 0.5 * (D[i, a] * K[j, a] + D[j, a] * K[i, a])
            x = where(ok > 0.0, x, P[i, j])
            P[i, j] = x
            P[j, i] = x
    return nis, dof, ok, bad


@njit(cache=True, nogil=True)
def _blank(used: float, row: int, nu: Array, H: Array, R: Array) -> None:
    """Make a row of a measurement one of nothing with variance 1 in the lanes that do not use it.

    Parameters
    ----------
    used : float
        1 or 0.
    row : int
    nu, H, R : (w,), (w, n), (w, w) arrays
    """
    nu[row] = where(used > 0.0, nu[row], 0.0)
    for j in range(H.shape[1]):
        H[row, j] = where(used > 0.0, H[row, j], 0.0)
    for j in range(nu.size):
        R[row, j] = where(used > 0.0, R[row, j], 0.0)
        R[j, row] = where(used > 0.0, R[j, row], 0.0)
    R[row, row] = where(used > 0.0, R[row, row], 1.0)
