"""The compiled loop of the filter: scalar code over plain arrays, without the GIL.

The expanded covariance
-----------------------
``E`` is a flat array with rows of constant length :data:`LD` (constant, so that the compiler sees that rows do not overlap and turns the
column loops into vector instructions). Rows and columns are

* 0..8    the navigation errors,
* 9..14   the errors u of the six measured axes during this step (gyroscope, accelerometer), a function of the states behind,
* 16..    the states behind, in slots of eight: slot s holds the s-th state of every axis in lanes 0..5 (lanes 6, 7 stay zero).

A step is then three things: the states behind move (lane by lane), u follows from them (``u = -(C e_x) + v``, estimate minus truth), and
one linear map takes (navigation errors, u) to the new navigation errors. The map is applied to the columns and, after transposing the
nine rows, to the rows. It is the trapezoid of the mechanization: attitude first, velocity with the mean attitude error, position
with the mean velocity error, so that the second-order terms in dt that matter come without products of matrices.

Only columns 16.. of the navigation rows are kept, not their transposes; the matrix is symmetric by construction.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from insemu.filters.measurements import FIX, fill_fix, fill_standstill, first_bad_pivot, update
from insemu.rotation import scalar_dcm
from insemu.strapdown import correct, fill_dynamics, step

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Row length of the expanded covariance; bounds the number of slots.
LD = 120
#: First row of the axis errors and of the states behind.
U = 9
FIRST = 16
MAX_SLOTS = (LD - FIRST) // 8
#: Length of the coefficients that :func:`fill_map` writes.
MAP_SIZE = 46

_FAST = {"contract"}  # fused multiply-add only: nothing that changes how NaN behaves


@njit(cache=True, nogil=True, fastmath=_FAST)
def fill_map(f: Array, cdt: Array, dt: float, w: Array) -> None:
    """Write the coefficients of the map of one step.

    Parameters
    ----------
    f : (9, 9) array
        Continuous dynamics (:func:`insemu.strapdown.fill_dynamics`).
    cdt : (3, 3) array
        ``C_nb`` at the middle of the step.
    dt : float
        s.
    w : (46,) array
        Overwritten.
    """
    h = 0.5 * dt
    w[0], w[1], w[2] = dt * f[6, 7], dt * f[6, 8], dt * f[7, 6]
    w[3], w[4], w[5] = dt * f[7, 8], dt * f[8, 6], dt * f[8, 7]
    w[6], w[7], w[8] = dt * f[6, 0], dt * f[7, 0], dt * f[8, 0]
    w[9], w[10], w[11] = dt * f[6, 2], dt * f[7, 2], dt * f[8, 2]
    w[12], w[13], w[14] = dt * f[7, 3], dt * f[6, 4], dt * f[8, 4]
    for i in range(3):
        for j in range(3):
            w[15 + 3 * i + j] = dt * cdt[i, j]
    w[24], w[25], w[26] = h * f[3, 7], h * f[3, 8], h * f[4, 8]  # f_n[2], -f_n[1], f_n[0], halved
    w[27], w[28], w[29] = 1.0 + dt * f[3, 3], dt * f[3, 4], dt * f[3, 5]
    w[30], w[31], w[32] = dt * f[4, 3], 1.0 + dt * f[4, 4], dt * f[4, 5]
    w[33], w[34] = dt * f[5, 3], dt * f[5, 4]
    w[35], w[36], w[37] = dt * f[3, 0], dt * f[4, 0], dt * f[5, 0]
    w[38], w[39], w[40] = dt * f[3, 2], dt * f[4, 2], dt * f[5, 2]
    w[41], w[42] = 1.0 + dt * f[0, 0], dt * f[0, 2]
    w[43], w[44] = dt * f[1, 0], 1.0 + dt * f[1, 1]
    w[45] = dt * f[1, 2]


@njit(cache=True, nogil=True, fastmath=_FAST)
def apply_map(w: Array, half: float, E: Array, columns: int) -> None:
    """Apply the map to the first fifteen rows of ``E`` (flat, rows of LD), in place, for the first ``columns`` columns."""
    a01, a02, a10, a12, a20, a21 = w[0], w[1], w[2], w[3], w[4], w[5]
    b00, b10, b20, b02, b12, b22 = w[6], w[7], w[8], w[9], w[10], w[11]
    d10, d01, d21 = w[12], w[13], w[14]
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = w[15], w[16], w[17], w[18], w[19], w[20], w[21], w[22], w[23]
    fz, fy, fx = w[24], w[25], w[26]
    e00, e01, e02, e10, e11, e12, e20, e21 = w[27], w[28], w[29], w[30], w[31], w[32], w[33], w[34]
    g00, g10, g20, g02, g12, g22 = w[35], w[36], w[37], w[38], w[39], w[40]
    p00, p02, p10, p11, p12 = w[41], w[42], w[43], w[44], w[45]
    for j in range(columns):
        pn, pe, pd = E[j], E[LD + j], E[2 * LD + j]
        vn, ve, vd = E[3 * LD + j], E[4 * LD + j], E[5 * LD + j]
        an, ae, ad = E[6 * LD + j], E[7 * LD + j], E[8 * LD + j]
        gx, gy, gz = E[9 * LD + j], E[10 * LD + j], E[11 * LD + j]
        ax, ay, az = E[12 * LD + j], E[13 * LD + j], E[14 * LD + j]
        an1 = an + a01 * ae + a02 * ad + b00 * pn + b02 * pd + d01 * ve + c00 * gx + c01 * gy + c02 * gz
        ae1 = ae + a10 * an + a12 * ad + b10 * pn + b12 * pd + d10 * vn + c10 * gx + c11 * gy + c12 * gz
        ad1 = ad + a20 * an + a21 * ae + b20 * pn + b22 * pd + d21 * ve + c20 * gx + c21 * gy + c22 * gz
        sn, se, sd = an + an1, ae + ae1, ad + ad1
        vn1 = e00 * vn + e01 * ve + e02 * vd + g00 * pn + g02 * pd + fz * se + fy * sd + c00 * ax + c01 * ay + c02 * az
        ve1 = e10 * vn + e11 * ve + e12 * vd + g10 * pn + g12 * pd - fz * sn + fx * sd + c10 * ax + c11 * ay + c12 * az
        vd1 = vd + e20 * vn + e21 * ve + g20 * pn + g22 * pd - fy * sn - fx * se + c20 * ax + c21 * ay + c22 * az
        E[j] = p00 * pn + p02 * pd + half * (vn + vn1)
        E[LD + j] = p10 * pn + p11 * pe + p12 * pd + half * (ve + ve1)
        E[2 * LD + j] = pd + half * (vd + vd1)
        E[3 * LD + j], E[4 * LD + j], E[5 * LD + j] = vn1, ve1, vd1
        E[6 * LD + j], E[7 * LD + j], E[8 * LD + j] = an1, ae1, ad1


@njit(cache=True, nogil=True, fastmath=_FAST)
def _scale_rows(E: Array, d: Array, slots: int) -> None:
    """States behind, each with a transition of its own: rows and columns scaled."""
    end = FIRST + 8 * slots
    for j in range(FIRST, end):
        x = d[j]
        E[j] *= x
        E[LD + j] *= x
        E[2 * LD + j] *= x
        E[3 * LD + j] *= x
        E[4 * LD + j] *= x
        E[5 * LD + j] *= x
        E[6 * LD + j] *= x
        E[7 * LD + j] *= x
        E[8 * LD + j] *= x
    for s in range(slots):
        r = FIRST + 8 * s
        b = r * LD
        d0, d1, d2, d3, d4, d5 = d[r], d[r + 1], d[r + 2], d[r + 3], d[r + 4], d[r + 5]
        for j in range(FIRST, end):
            x = d[j]
            E[b + j] *= d0 * x
            E[b + LD + j] *= d1 * x
            E[b + 2 * LD + j] *= d2 * x
            E[b + 3 * LD + j] *= d3 * x
            E[b + 4 * LD + j] *= d4 * x
            E[b + 5 * LD + j] *= d5 * x


@njit(cache=True, nogil=True, fastmath=_FAST)
def _mix_rows(E: Array, phi: Array, slots: int, work: Array) -> None:
    """States behind that mix within an axis: ``rows <- Phi rows`` for their own columns; ``phi`` is (slots, slots, 8)."""
    end = FIRST + 8 * slots
    for lane in range(6):
        for s in range(slots):
            o = s * LD
            for j in range(FIRST, end):
                work[o + j] = 0.0
            for k in range(slots):
                x = phi[s, k, lane]
                if x != 0.0:
                    b = (FIRST + 8 * k + lane) * LD
                    for j in range(FIRST, end):
                        work[o + j] += x * E[b + j]
        for s in range(slots):
            o = s * LD
            b = (FIRST + 8 * s + lane) * LD
            for j in range(FIRST, end):
                E[b + j] = work[o + j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _mix_columns(E: Array, phi: Array, slots: int, work: Array) -> None:
    """``columns <- columns Phi'`` for the navigation rows and the rows of the states behind."""
    for r in range(FIRST + 8 * slots):
        if 9 <= r < FIRST:
            continue
        b = r * LD + FIRST
        for j in range(8 * slots):
            work[j] = 0.0
        for s in range(slots):
            for k in range(slots):
                for lane in range(8):
                    work[8 * s + lane] += phi[s, k, lane] * E[b + 8 * k + lane]
        for j in range(8 * slots):
            E[b + j] = work[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _axis_rows(E: Array, c: Array, slots: int, start: int) -> None:
    """Rows of the axis errors from the rows of the states behind, for columns ``start`` to the end of the slots."""
    end = FIRST + 8 * slots
    for j in range(start, end):
        E[9 * LD + j] = 0.0
        E[10 * LD + j] = 0.0
        E[11 * LD + j] = 0.0
        E[12 * LD + j] = 0.0
        E[13 * LD + j] = 0.0
        E[14 * LD + j] = 0.0
    for s in range(slots):
        r = FIRST + 8 * s
        b = r * LD
        c0, c1, c2, c3, c4, c5 = c[r], c[r + 1], c[r + 2], c[r + 3], c[r + 4], c[r + 5]
        for j in range(start, end):
            E[9 * LD + j] -= c0 * E[b + j]
            E[10 * LD + j] -= c1 * E[b + LD + j]
            E[11 * LD + j] -= c2 * E[b + 2 * LD + j]
            E[12 * LD + j] -= c3 * E[b + 3 * LD + j]
            E[13 * LD + j] -= c4 * E[b + 4 * LD + j]
            E[14 * LD + j] -= c5 * E[b + 5 * LD + j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def predict(
    E: Array,
    w: Array,
    half: float,
    slots: int,
    diagonal: bool,
    d: Array,
    phi: Array,
    q_at: Ints,
    q: Array,
    c: Array,
    white: Array,
    T: Array,
    work: Array,
) -> None:
    """One step of the covariance, in place.

    Parameters
    ----------
    E : (rows * LD,) array
        Expanded covariance.
    w, half : (46,) array, float
        Map of the step and half its duration.
    slots : int
        Slots of states behind.
    diagonal : bool
        Whether every state behind moves by itself (``d``), or lanes mix (``phi``).
    d, phi : (LD,), (slots, slots, 8) arrays
        Transition of the states behind.
    q_at, q : (k,) arrays
        Places in ``E`` and values of the driving covariance.
    c : (LD,) array
        What each axis sees of its states, at the states' places.
    white : (6,) array
        Variance of the axes' own white noise over the step.
    T, work : (15 * LD,), (LD * LD,) arrays
        Working space.
    """
    end = FIRST + 8 * slots
    if slots > 0:
        if diagonal:
            _scale_rows(E, d, slots)
        else:
            _mix_rows(E, phi, slots, work)
            _mix_columns(E, phi, slots, work)
        for i in range(q.size):
            E[q_at[i]] += q[i]
        _axis_rows(E, c, slots, FIRST)
    for i in range(9):
        b = i * LD
        for a in range(6):
            total = 0.0
            for s in range(slots):
                k = FIRST + 8 * s + a
                total -= c[k] * E[b + k]
            E[b + U + a] = total
            E[(U + a) * LD + i] = total
    for a in range(6):
        b = (U + a) * LD
        for e in range(6):
            total = 0.0
            for s in range(slots):
                k = FIRST + 8 * s + e
                total -= c[k] * E[b + k]
            E[b + U + e] = total
        E[b + U + a] += white[a]

    apply_map(w, half, E, end)
    for i in range(9):
        b = i * LD
        for j in range(15):
            T[j * LD + i] = E[b + j]
    apply_map(w, half, T, FIRST)
    for i in range(9):
        for j in range(i, 9):
            x = T[i * LD + j]
            E[i * LD + j] = x
            E[j * LD + i] = x


@njit(cache=True, nogil=True, fastmath=_FAST)
def advance_transition(
    A: Array,
    w: Array,
    half: float,
    slots: int,
    diagonal: bool,
    d: Array,
    phi: Array,
    c: Array,
    work: Array,
) -> None:
    """Multiply the transition since the last node (same layout as ``E``) by that of one step, in place."""
    end = FIRST + 8 * slots
    if slots > 0:
        if diagonal:
            for s in range(slots):
                for lane in range(6):
                    r = FIRST + 8 * s + lane
                    x = d[r]
                    if x != 1.0:
                        for j in range(FIRST, end):
                            A[r * LD + j] *= x
        else:
            _mix_rows(A, phi, slots, work)
        _axis_rows(A, c, slots, FIRST)
    apply_map(w, half, A, end)


@njit(cache=True, nogil=True)
def reset_transition(A: Array, rows: int) -> None:
    """Make the transition the identity."""
    A[: rows * LD] = 0.0
    for i in range(rows):
        if i < 9 or i >= FIRST:
            A[i * LD + i] = 1.0


@njit(cache=True, nogil=True)
def gather(E: Array, place: Ints, P: Array) -> None:
    """Copy the filter's covariance out of the expanded one: ``P`` (n, n) in the layout's order."""
    n = place.size
    for i in range(n):
        for j in range(i, n):
            x = E[place[i] * LD + place[j]]
            P[i, j] = x
            P[j, i] = x


@njit(cache=True, nogil=True)
def scatter(P: Array, place: Ints, E: Array) -> None:
    """Inverse of :func:`gather`."""
    n = place.size
    for i in range(n):
        for j in range(n):
            if i < 9 or j >= 9:
                E[place[i] * LD + place[j]] = P[i, j]


@njit(cache=True, nogil=True)
def _states_ahead(
    x: Array, axis_x: Array, slots: int, diagonal: bool, d: Array, phi: Array, c: Array, work: Array
) -> None:
    """Predict the estimates of the states behind, and what the axes see of them."""
    if diagonal:
        for j in range(FIRST, FIRST + 8 * slots):
            x[j] *= d[j]
    else:
        for s in range(slots):
            for lane in range(8):
                total = 0.0
                for k in range(slots):
                    total += phi[s, k, lane] * x[FIRST + 8 * k + lane]
                work[8 * s + lane] = total
        for j in range(8 * slots):
            x[FIRST + j] = work[j]
    for a in range(6):
        total = 0.0
        for s in range(slots):
            k = FIRST + 8 * s + a
            total += c[k] * x[k]
        axis_x[a] = total


@njit(cache=True, nogil=True)
def run(
    t: Array,
    gyro: Array,
    accel: Array,
    nav: Array,
    x0: Array,
    P0: Array,
    place: Ints,
    axis: Ints,
    c0: Array,
    driver: Ints,
    slots: int,
    diagonal: bool,
    d_of: Array,
    phi_of: Array,
    q_at: Ints,
    q_of: Array,
    white: Array,
    gravity: int,
    lever0: Array,
    lever_at: int,
    latency_at: int,
    thresholds: Array,
    every: int,
    output_every: int,
    event_epoch: Ints,
    event_kind: Ints,
    event_tau: Array,
    event_z: Array,
    event_var: Array,
    cov_epoch: Ints,
    node_epoch: Ints,
    store: bool,
    out_nav: Array,
    out_var: Array,
    out_x: Array,
    fix_nu: Array,
    fix_S: Array,
    fix_nis: Array,
    fix_dof: Ints,
    fix_ok: Ints,
    fix_K: Array,
    fix_H: Array,
    out_P: Array,
    node_nav: Array,
    node_x: Array,
    node_before: Array,
    node_after: Array,
    node_phi: Array,
    node_dx: Array,
    P: Array,
) -> tuple[int, int]:
    """Fly the filter through a record; see :mod:`insemu.filters.ekf`, which prepares and names everything.

    Returns
    -------
    (code, detail)
        0: done. 1: ``P`` not positive semidefinite at state ``detail``. 2: innovation covariance not positive definite in component
        ``detail``. 3: the navigation state is not finite at epoch ``detail``.
    """
    n = place.size
    m = n - 9
    end = FIRST + 8 * slots
    E = np.zeros(max(end, FIRST) * LD)
    T = np.zeros(15 * LD)
    work = np.zeros(max(slots, 1) * LD)
    A = np.zeros(max(end, FIRST) * LD if store else 1)
    w = np.zeros(MAP_SIZE)
    F = np.zeros((9, 9))
    C = np.empty((3, 3))
    mid = np.empty((3, 3))
    x = np.zeros(LD)
    c = np.zeros(LD)
    seen = np.zeros(6)
    dth, dv, dth1, dv1 = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    f_n = np.zeros(3)
    f_sum, span, count = np.zeros(3), 0.0, 0
    C_sum = np.zeros((3, 3))
    nav_before = nav.copy()
    rate, rate1 = np.zeros(3), np.zeros(3)
    rate_sum, rate_count = np.zeros(3), 0
    white_now = np.empty(6)
    lever = lever0.copy()
    c_of = np.zeros(m)
    dx = np.zeros(n)
    node_total = np.zeros(n)
    nu, H, R = np.zeros(6), np.zeros((6, n)), np.zeros((6, 6))
    used = np.zeros(6, dtype=np.bool_)
    L = np.zeros((n, n))
    driven = False
    P[:, :] = P0
    scatter(P, place, E)
    for s in range(m):
        x[place[9 + s]] = x0[s]
        if driver[s] >= 0:
            driven = True
        if axis[s] >= 0:
            c[place[9 + s]] = c0[s]
            c_of[s] = c0[s]
    if store:
        reset_transition(A, end)
    event, cov, node, row = 0, 0, 0, 0

    d_one, phi_one = d_of[0], phi_of[0]
    d, phi, q = d_one, phi_one, q_of[0]
    bad = first_bad_pivot(P, L)
    if bad >= 0:
        return 1, bad
    epochs = t.size
    for k in range(epochs):
        if k > 0:
            dt = t[k] - t[k - 1]
            before = max(k - 1, 1)
            if driven:
                for s in range(m):
                    if driver[s] >= 0:
                        raw = gyro[k, driver[s]] if driver[s] < 3 else accel[k, driver[s] - 3]
                        c_of[s] = c0[s] * raw / dt
                        c[place[9 + s]] = c_of[s]
            _states_ahead(x, seen, slots, diagonal, d_one, phi_one, c, work)
            for i in range(3):
                dth1[i], dv1[i], rate1[i] = dth[i], dv[i], rate[i]
                dth[i] = gyro[k, i] - seen[i] * dt
                dv[i] = accel[k, i] - seen[3 + i] * dt
                rate[i] = dth[i] / dt
                rate_sum[i] += rate[i]
            rate_count += 1
            if k == 1:
                for i in range(3):
                    dth1[i], dv1[i], rate1[i] = dth[i], dv[i], rate[i]
            for i in range(10):
                nav_before[i] = nav[i]
            scalar_dcm(nav[6:10], C)
            # attitude and specific force at the middle of the step
            hx, hy, hz = 0.5 * dth[0], 0.5 * dth[1], 0.5 * dth[2]
            for i in range(3):
                mid[i, 0] = C[i, 0] + C[i, 1] * hz - C[i, 2] * hy
                mid[i, 1] = C[i, 1] + C[i, 2] * hx - C[i, 0] * hz
                mid[i, 2] = C[i, 2] + C[i, 0] * hy - C[i, 1] * hx
                f_n[i] = (mid[i, 0] * dv[0] + mid[i, 1] * dv[1] + mid[i, 2] * dv[2]) / dt
            if every > 1:
                # several steps as one: means over them, at the last state
                span += dt
                count += 1
                for i in range(3):
                    f_sum[i] += f_n[i] * dt
                    for j in range(3):
                        C_sum[i, j] += mid[i, j] * dt
            else:
                span, count = dt, 1
            due = (
                count == every
                or k == epochs - 1
                or k % output_every == 0
                or (event < event_epoch.size and event_epoch[event] == k)
                or (cov < cov_epoch.size and cov_epoch[cov] == k)
                or (node < node_epoch.size and node_epoch[node] == k)
            )
            if due:
                if every > 1:
                    for i in range(3):
                        f_n[i] = f_sum[i] / span
                        f_sum[i] = 0.0
                        for j in range(3):
                            mid[i, j] = C_sum[i, j] / span
                            C_sum[i, j] = 0.0
                for i in range(6):
                    white_now[i] = white[i] / count
                fill_dynamics(nav, f_n, gravity, F)
                fill_map(F, mid, span, w)
                half = 0.5 * span
                if every > 1:
                    d, phi, q = d_of[count - 1], phi_of[count - 1], q_of[count - 1]
                predict(E, w, half, slots, diagonal, d, phi, q_at, q, c, white_now, T, work)
                if store:
                    advance_transition(A, w, half, slots, diagonal, d, phi, c, work)
                span, count = 0.0, 0
            step(nav, dth, dv, dth1, dv1, dt, dt if k == 1 else t[before] - t[before - 1], gravity)

        is_node = store and node < node_epoch.size and node_epoch[node] == k
        if is_node:
            gather(E, place, P)
            for i in range(n):
                for j in range(n):
                    node_before[node, i, j] = P[i, j]
                    node_phi[node, i, j] = A[place[i] * LD + place[j]]
                node_total[i] = 0.0
        while event < event_epoch.size and event_epoch[event] == k:
            if k > 0:
                for i in range(3):
                    lever[i] = lever0[i]
                    if lever_at >= 0:
                        lever[i] += x[place[lever_at + i]]
                tau = event_tau[event]
                if latency_at >= 0:
                    tau += x[place[latency_at]]
                dt = t[k] - t[k - 1]
                if event_kind[event] == FIX:
                    fill_fix(
                        nav,
                        nav_before,
                        dt,
                        tau,
                        rate,
                        rate1,
                        lever,
                        white,
                        c_of,
                        axis,
                        lever_at,
                        latency_at,
                        event_z[event],
                        nu,
                        H,
                        R,
                    )
                else:
                    for i in range(3):
                        rate_sum[i] /= rate_count
                    fill_standstill(nav, rate_sum, rate_count, white, c_of, axis, nu, H, R)
                    for i in range(3):
                        rate_sum[i] = 0.0
                    rate_count = 0
                for i in range(6):
                    used[i] = math.isfinite(event_z[event, i]) and math.isfinite(event_var[event, i])
                    if used[i]:
                        R[i, i] += event_var[event, i]
                        fix_nu[event, i] = nu[i]
                gather(E, place, P)
                nis, dof, ok = update(P, nu, H, R, used, thresholds, dx, fix_S[event], fix_K[event if store else 0])
                if dof < 0:
                    return 2, -1 - dof
                fix_nis[event], fix_dof[event], fix_ok[event] = nis, dof, 1 if ok else 0
                if store:
                    for i in range(6):
                        for j in range(n):
                            fix_H[event, i, j] = H[i, j]
                if ok:
                    bad = first_bad_pivot(P, L)
                    if bad >= 0:
                        return 1, bad
                    scatter(P, place, E)
                    correct(nav, dx)
                    for s in range(m):
                        x[place[9 + s]] -= dx[9 + s]
                    for i in range(n):
                        node_total[i] += dx[i]
            event += 1
        if is_node:
            gather(E, place, P)
            for i in range(n):
                node_dx[node, i] = node_total[i]
                for j in range(n):
                    node_after[node, i, j] = P[i, j]
            for i in range(10):
                node_nav[node, i] = nav[i]
            for s in range(m):
                node_x[node, s] = x[place[9 + s]]
            reset_transition(A, end)
            node += 1
        if cov < cov_epoch.size and cov_epoch[cov] == k:
            gather(E, place, out_P[cov])
            cov += 1
        if k % output_every == 0 or k == epochs - 1:
            for i in range(10):
                out_nav[row, i] = nav[i]
            for i in range(n):
                out_var[row, i] = E[place[i] * LD + place[i]]
            for s in range(m):
                out_x[row, s] = x[place[9 + s]]
            row += 1
    for i in range(10):
        if not math.isfinite(nav[i]):
            return 3, epochs - 1
    gather(E, place, P)
    bad = first_bad_pivot(P, L)
    if bad >= 0:
        return 1, bad
    return 0, 0
