"""A linear system of a filter's estimates beside other states, moved by the filter's own compiled steps: covariance forward, adjoint backward.

What :mod:`insemu.evaluate.covariance` is made of. The system is an :class:`~insemu.augment.Augmentation` whose states all act through the
axes of the IMU, after the nine navigation errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.augment import Augmentation
from insemu.compiled import njit
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.events import Events
from insemu.filters.expanded import FIRST, LD, MAP_SIZE, Transition, fill_map, gather, middle, predict, scatter
from insemu.filters.measurements import fill_fix
from insemu.filters.packed import Packed, Samples, pack
from insemu.filters.rows import Moment, Rows
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import fill_dynamics

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Gains of a record that follows no covariate.
NO_POWER = np.ones((1, 0))


def ideal_fixes(ekf: LooselyCoupledEKF, imu: ImuRecord, nav: Array, gnss: GnssRecord) -> GnssRecord | None:
    """The fixes that the filter would predict at the truth, with the standard deviations that it believes.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    imu : ImuRecord
        Ideal increments.
    nav : (n, 10) array
        The truth at every row of ``imu``: latitude, longitude, height, velocity NED, quaternion.
    gnss : GnssRecord
        Where and when there are fixes; their values are ignored.

    Returns
    -------
    GnssRecord or None
        None where there is no fix.
    """
    events = ekf.events(imu.t, gnss)
    nu, _, _ = seen_at_truth(ekf, imu, nav, events)
    here = nav[events.epoch]
    predicted = np.hstack([earth.move(here[:, :3], -nu[:, :3]), here[:, 3:6] - nu[:, 3:]])
    z = np.where(np.isfinite(events.z), predicted, np.nan)
    sd = np.sqrt(events.var)
    return GnssRecord(events.t, z[:, :3], z[:, 3:], sd[:, :3], sd[:, 3:]) if len(events.t) else None


def seen_at_truth(ekf: LooselyCoupledEKF, imu: ImuRecord, nav: Array, events: Events) -> tuple[Array, Array, Array]:
    """What fixes of the position and the velocity of the IMU itself would differ by from those that a filter predicts at the truth.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    imu : ImuRecord
        Ideal increments.
    nav : (n, 10) array
        The truth at their rows.
    events : Events
        Fixes.

    Returns
    -------
    nu, H, R : (f, 6), (f, 6, n), (f, 6, 6) arrays
        Their innovations, Jacobians (of states of the installation zero) and added noise, of the filter's own white noise.
    """
    aug, f = ekf.augmentation, events.epoch.size
    step = imu.widths(0.0)[events.epoch]
    c_of = np.empty((f, aug.m))
    c_of[:] = aug.coefficients(np.hstack(aug.sensed(imu))[events.epoch] / step)
    nu, H, R = np.zeros((f, 6)), np.zeros((f, 6, 9 + aug.m)), np.zeros((f, 6, 6))
    seen = _Axes(aug.white, c_of, aug.axis, ekf.lever_arm)
    _fixes(imu.t, imu.gyro, nav, events.epoch, events.tau, seen, Rows(nu, H, R))
    return nu, H, R


class _Axes(NamedTuple):
    """White noise of the axes (6,), coefficients of the states at every fix (f, m), the states' axes (m,), and the lever arm (3,)."""

    white: Array
    c_of: Array
    axis: Ints
    lever: Array


@njit(cache=True, nogil=True)
def _fixes(t: Array, gyro: Array, nav: Array, epoch: Ints, tau: Array, seen: _Axes, rows: Rows) -> None:
    """``rows`` (nu, H, R) of :func:`seen_at_truth`."""
    (white, c_of, axis, lever), (nu, H, R) = seen, rows
    now, past, z, trend, clock = np.zeros(13), np.zeros(13), np.empty(6), np.zeros(12), np.zeros(2)
    for i in range(epoch.size):
        k = epoch[i]
        before = max(k - 1, 1)
        for j in range(10):
            now[j], past[j] = nav[k, j], nav[k - 1, j]
        for j in range(6):
            z[j] = nav[k, j]
        dt = t[k] - t[k - 1]
        rate, rate_before = gyro[k] / dt, gyro[before] / (t[before] - t[before - 1])
        moment = Moment(
            now, past, dt, tau[i], rate, rate_before, rate, 1, white, c_of[i], axis, lever, -1, -1, clock, -1, trend
        )
        fill_fix(moment, z, trend, Rows(nu[i], H[i], R[i]))


class _Course(NamedTuple):
    """Maps of the steps and fixes of a :class:`JointSystem`."""

    maps: Array
    epoch: Ints
    M: Array
    R: Array


class _Entries(NamedTuple):
    """Transition and driving covariance of augmented states by what is not zero, places (k, 2) and values (k,), and the source of each state."""

    phi_at: Ints
    phi: Array
    q_at: Ints
    q: Array
    source: Ints


class _Shares(NamedTuple):
    """Variance by the noise of every fix (f,), by the driving noise of the states by source (sources,), by the white noise of the axes (6,)."""

    fixes: Array
    states: Array
    axes: Array


@dataclass(frozen=True)
class JointSystem:
    """A linear error system along a reference, with fixes ``z <- M z + noise``.

    Parameters
    ----------
    states : Augmentation
        The augmented states after the nine navigation errors.
    imu : ImuRecord
        Increments along the reference.
    maps : (n, 46) array
        Maps of all steps (:func:`error_maps`).
    epoch : (f,) array of int
        Rows of ``imu`` at which there is a fix, increasing.
    M, R : (f, 9 + m, 9 + m) arrays
        Update matrix and covariance of the noise of every fix.
    """

    states: Augmentation
    imu: ImuRecord
    maps: Array
    epoch: Ints
    M: Array
    R: Array

    @property
    def _course(self) -> _Course:
        return _Course(self.maps, self.epoch, self.M, self.R)

    def covariance(self, P0: Array, rows: Ints) -> Array:
        """Covariance at some rows of the IMU.

        Parameters
        ----------
        P0 : (9 + m, 9 + m) array
            At the first row.
        rows : (o,) array of int

        Returns
        -------
        (o, 9 + m, 9 + m) array
            After the fix of that epoch if there is one.
        """
        s, p, imu = self.states, pack(self.states, 1), self.imu
        gyro, accel = s.sensed(imu)
        out = np.empty((rows.size, *P0.shape))
        order = np.argsort(rows, kind="stable")
        samples = Samples(imu.t, gyro, accel, NO_POWER)
        _forward(samples, self._course, P0, p, rows[order], out)
        out[order] = out.copy()
        return out

    def adjoint(self, row: int, L: Array, source: Ints, sources: int) -> tuple[Array, Array, Array, float]:
        """What every noise and every initial error contributes to one linear functional of the errors at one epoch.

        Parameters
        ----------
        row : int
            Of the IMU.
        L : (9 + m,) array
            The functional.
        source : (m,) array of int
            Number of the source that each state belongs to.
        sources : int
            How many there are.

        Returns
        -------
        initial : (9 + m,) array
            The functional of the initial errors.
        parts : (sources,) array
            Variance from the driving noise of the states, by source.
        axes : (6,) array
            Variance from the white noise of the axes.
        fixes : float
            Variance from the noise of the fixes.
        """
        s, imu, initial = self.states, self.imu, L.copy()
        parts, axes, gained = np.zeros(sources), np.zeros(6), np.zeros(self.epoch.size)
        samples = Samples(imu.t, *s.sensed(imu), NO_POWER)
        entries = _Entries(*_sparse(s.Phi), *_sparse(s.Q), source)
        _backward(samples, self._course, row, initial, pack(s, 1), entries, _Shares(gained, parts, axes))
        return initial, parts, axes, float(gained.sum())


def error_maps(imu: ImuRecord, nav: Array, gravity: str) -> Array:
    """Maps of the errors over all steps along a reference.

    Parameters
    ----------
    imu : ImuRecord
        Increments.
    nav : (n, 10) array
        Reference at every row.
    gravity : str
        Gravity model.

    Returns
    -------
    (n, 46) array
    """
    maps = np.zeros((imu.t.size, MAP_SIZE))
    _maps(imu.t, imu.gyro, imu.accel, nav, earth.gravity_code(gravity), maps)
    return maps


@njit(cache=True, nogil=True)
def _maps(t: Array, gyro: Array, accel: Array, nav: Array, gravity: int, w: Array) -> None:
    """Maps of all steps along a reference, (n, 46)."""
    F, C, mid, f_n = np.empty((9, 9)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(1, t.size):
        dt = t[k] - t[k - 1]
        middle(nav[k - 1, 6:10], gyro[k], accel[k], dt, C, mid, f_n)
        fill_dynamics(nav[k - 1], f_n, gravity, F)
        fill_map(F, mid, dt, w[k])


@njit(cache=True, nogil=True)
def _forward(samples: Samples, course: _Course, P0: Array, p: Packed, out_epoch: Ints, out: Array) -> None:
    """Joint covariance along the reference; at a fix ``P <- M P M' + R``."""
    t, gyro, accel, _ = samples
    place, c0, driver, slots, (maps, fix_epoch, M, R) = p.place, p.c, p.driver, p.steps.slots, course
    steps = p.steps
    one = Transition(
        slots, steps.diagonal, steps.d[0], steps.phi[0], steps.offsets, steps.mix[0], steps.q_at, steps.q[0]
    )
    n = place.size
    E, T = np.zeros((FIRST + 8 * slots + 17) * LD), np.zeros(15 * LD)
    work = np.zeros((8 * slots + 10) * LD)
    P, B = P0.copy(), np.empty((n, n))
    scatter(P, place, 1.0, E)
    c = np.zeros(LD)
    for s in range(n - 9):
        c[place[9 + s]] = c0[s]
    fix, row = 0, 0
    for k in range(t.size):
        if k > 0:
            half = 0.5 * (t[k] - t[k - 1])
            for s in range(n - 9):
                if driver[s] >= 0:
                    raw = gyro[k, driver[s]] if driver[s] < 3 else accel[k, driver[s] - 3]
                    c[place[9 + s]] = c0[s] * raw / (2.0 * half)
            predict(E, maps[k], half, one, c, p.white, T, work)
        while fix < fix_epoch.size and fix_epoch[fix] == k:
            gather(E, place, P)
            for i in range(n):
                for j in range(n):
                    x = 0.0
                    for a in range(n):
                        x += M[fix, i, a] * P[a, j]
                    B[i, j] = x
            for i in range(n):
                for j in range(i, n):
                    x = R[fix, i, j]
                    for a in range(n):
                        x += B[i, a] * M[fix, j, a]
                    P[i, j] = x
                    P[j, i] = x
            scatter(P, place, 1.0, E)
            fix += 1
        while row < out_epoch.size and out_epoch[row] == k:
            gather(E, place, out[row])
            row += 1


@njit(cache=True, nogil=True)
def apply_transposed(w: Array, half: float, L: Array, old: Array, u: Array) -> None:
    """The map of :func:`insemu.filters.expanded.apply_map`, transposed: a functional of the errors after a step as one of those before it.

    Parameters
    ----------
    w : (46,) array
        Map of the step.
    half : float
        Half the duration of the step, s.
    L : (9+,) array
        The functional; its first nine entries are overwritten.
    old : (9,) array
        Working space.
    u : (6,) array
        Overwritten: what the errors of the axes in this step contribute.
    """
    # position, velocity, attitude in reverse
    pn, pe, pd = L[0], L[1], L[2]
    vn, ve, vd = L[3] + half * pn, L[4] + half * pe, L[5] + half * pd
    fz, fy, fx = w[24], w[25], w[26]
    sn, se, sd = -fz * ve - fy * vd, fz * vn - fx * vd, fy * vn + fx * ve
    an, ae, ad = L[6] + sn, L[7] + se, L[8] + sd
    old[0] = w[41] * pn + w[43] * pe + w[35] * vn + w[36] * ve + w[37] * vd + w[6] * an + w[7] * ae + w[8] * ad
    old[1] = w[44] * pe
    old[2] = w[42] * pn + w[45] * pe + pd + w[38] * vn + w[39] * ve + w[40] * vd + w[9] * an + w[10] * ae + w[11] * ad
    old[3] = half * pn + w[27] * vn + w[30] * ve + w[33] * vd + w[12] * ae
    old[4] = half * pe + w[28] * vn + w[31] * ve + w[34] * vd + w[13] * an + w[14] * ad
    old[5] = half * pd + w[29] * vn + w[32] * ve + vd
    old[6] = sn + an + w[2] * ae + w[4] * ad
    old[7] = se + ae + w[0] * an + w[5] * ad
    old[8] = sd + ad + w[1] * an + w[3] * ae
    for j in range(3):
        u[j] = w[15 + j] * an + w[18 + j] * ae + w[21 + j] * ad
        u[3 + j] = w[15 + j] * vn + w[18 + j] * ve + w[21 + j] * vd
    for i in range(9):
        L[i] = old[i]


def _sparse(matrix: Array) -> tuple[Ints, Array]:
    """Places (k, 2) and values (k,) of what is not zero, row by row."""
    at = np.ascontiguousarray(np.argwhere(matrix))  # transposed otherwise, for which the loop is compiled once more
    return at, matrix[at[:, 0], at[:, 1]]


@njit(cache=True, nogil=True)
def _backward(
    samples: Samples, course: _Course, last: int, L: Array, p: Packed, entries: _Entries, out: _Shares
) -> None:
    """Adjoint of the joint system from epoch ``last`` to the start.

    ``L`` (n,) holds the functional and is overwritten by what the initial errors contribute linearly.
    """
    t, gyro, accel, _ = samples
    axis, c0, driver, white = p.axis, p.c, p.driver, p.white
    phi_at, phi, q_at, q, source = entries
    maps, fix_epoch, M, R = course
    gained, parts, axes = out
    n = L.size
    m = n - 9
    u, old, next_x = np.zeros(6), np.zeros(9), np.zeros(m)
    fix = fix_epoch.size - 1
    while fix >= 0 and fix_epoch[fix] > last:
        fix -= 1
    for k in range(last, -1, -1):
        while fix >= 0 and fix_epoch[fix] == k:
            total = 0.0
            for i in range(n):
                for j in range(n):
                    total += L[i] * R[fix, i, j] * L[j]
            gained[fix] += total
            new = np.zeros(n)
            for i in range(n):
                x = L[i]
                if x != 0.0:
                    for j in range(n):
                        new[j] += x * M[fix, i, j]
            for i in range(n):
                L[i] = new[i]
            fix -= 1
        if k == 0:
            break
        w = maps[k]
        half = 0.5 * (t[k] - t[k - 1])
        apply_transposed(w, half, L, old, u)
        for a in range(6):
            axes[a] += u[a] * u[a] * white[a]
        # augmented states: what they do through the axes in this step, their driving noise, their transition
        for s in range(m):
            if axis[s] >= 0:
                c = c0[s]
                if driver[s] >= 0:
                    raw = gyro[k, driver[s]] if driver[s] < 3 else accel[k, driver[s] - 3]
                    c *= raw / (2.0 * half)
                L[9 + s] -= c * u[axis[s]]
        for e in range(q.size):
            i, j = q_at[e, 0], q_at[e, 1]
            parts[source[i]] += L[9 + i] * q[e] * L[9 + j]
        for j in range(m):
            next_x[j] = 0.0
        for e in range(phi.size):
            next_x[phi_at[e, 1]] += L[9 + phi_at[e, 0]] * phi[e]
        for j in range(m):
            L[9 + j] = next_x[j]
