"""The covariance of the filter, expanded for speed and propagated with its structure (compiled).

The expanded covariance
-----------------------
``E`` is a flat array with rows of constant length :data:`LD` (constant, so that the compiler sees that rows do not overlap and turns the
column loops into vector instructions). Rows and columns are

* 0..8    the navigation errors,
* 9..14   the errors u of the six measured axes during this step (gyroscope, accelerometer), a function of the augmented states,
* 16..    the augmented states, in slots of eight: slot s holds the s-th state of every axis in lanes 0..5 (lanes 6, 7 stay zero).

A step is then three things: the augmented states move (lane by lane), u follows from them (``u = -(C e_x) + v``, estimate minus truth), and
one linear map takes (navigation errors, u) to the new navigation errors. The map is applied to the columns and, after transposing the
nine rows, to the rows. It is the trapezoid of the mechanization: attitude first, velocity with the mean attitude error, position
with the mean velocity error, so that the second-order terms in dt that matter come without products of matrices.

Only columns 16.. of the navigation rows are kept, not their transposes; the matrix is symmetric by construction.

Loops over columns run from 0 over views: only then does the compiler know that no index is negative, and vectorises them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.lanes import any_of, lanes, where
from insemu.rotation import scalar_dcm

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Row length of the expanded covariance; bounds the number of slots.
LD = 136
#: First row of the axis errors and of the augmented states.
U = 9
FIRST = 16
MAX_SLOTS = 14
#: Length of the coefficients that :func:`fill_map` writes.
MAP_SIZE = 46

#: Row length, first row of the augmented states and width of a slot: of numbers, and of lanes, whose rows need not be whole vectors.
GRID, LANES_GRID = (LD, FIRST, 8), (U + 6 + 6 * MAX_SLOTS, U + 6, 6)


class Transition(NamedTuple):
    """How the augmented states move in a step; with one more axis in front of d, phi, mix and q: over 1, 2, ... steps.

    Parameters
    ----------
    slots : int
        Slots of augmented states.
    diagonal : bool
        Whether every augmented state moves by itself (``d``), or lanes mix (``phi``).
    d, phi : (LD,), (slots, slots, 8) arrays
        Transition.
    offsets, mix : (k,), (k, LD) arrays
        The same by the distance of slots; distance zero first.
    q_at, q : (l,) arrays
        Places in the expanded covariance and values of the driving covariance.
    """

    slots: int
    diagonal: bool
    d: Array
    phi: Array
    offsets: Ints
    mix: Array
    q_at: Ints
    q: Array


_FAST = {"contract"}  # fused multiply-add only: nothing that changes how NaN behaves


def grid(E: Array) -> tuple[int, int, int]:
    """Row length, first row of the augmented states and width of a slot of an expanded covariance; in compiled code."""
    raise NotImplementedError


@overload(grid, strict=False, inline="always")
def _grid(E: Any) -> Any:
    if E.dtype == lanes:
        return lambda E: LANES_GRID
    return lambda E: GRID


@njit(cache=True, nogil=True, inline="always")
def middle(q: Array, dth: Array, dv: Array, dt: float, C: Array, mid: Array, f_n: Array) -> None:
    """Attitude and specific force at the middle of a step.

    Parameters
    ----------
    q : (4,) array
        Attitude at the start of the step.
    dth, dv : (3,) arrays
        Increments of angle and velocity.
    dt : float
        s.
    C, mid, f_n : (3, 3), (3, 3), (3,) arrays
        Overwritten: ``C_nb`` at the start and at the middle, specific force in the local frame.
    """
    scalar_dcm(q, C)
    hx, hy, hz = 0.5 * dth[0], 0.5 * dth[1], 0.5 * dth[2]
    for i in range(3):
        mid[i, 0] = C[i, 0] + C[i, 1] * hz - C[i, 2] * hy
        mid[i, 1] = C[i, 1] + C[i, 2] * hx - C[i, 0] * hz
        mid[i, 2] = C[i, 2] + C[i, 0] * hy - C[i, 1] * hx
        f_n[i] = (mid[i, 0] * dv[0] + mid[i, 1] * dv[1] + mid[i, 2] * dv[2]) / dt


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
    """Apply the map to the first fifteen rows of ``E`` (flat, rows of LD), in place, for the first ``columns`` columns.

    Parameters
    ----------
    w : (46,) array
        Map of the step, of :func:`fill_map`.
    half : float
        Half the duration of the step, s.
    E : (rows * LD,) array
        At least fifteen rows; the first nine are overwritten.
    columns : int
        How many columns.
    """
    ld, _, _ = grid(E)
    a01, a02, a10, a12, a20, a21 = w[0], w[1], w[2], w[3], w[4], w[5]
    b00, b10, b20, b02, b12, b22 = w[6], w[7], w[8], w[9], w[10], w[11]
    d10, d01, d21 = w[12], w[13], w[14]
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = w[15], w[16], w[17], w[18], w[19], w[20], w[21], w[22], w[23]
    fz, fy, fx = w[24], w[25], w[26]
    e00, e01, e02, e10, e11, e12, e20, e21 = w[27], w[28], w[29], w[30], w[31], w[32], w[33], w[34]
    g00, g10, g20, g02, g12, g22 = w[35], w[36], w[37], w[38], w[39], w[40]
    p00, p02, p10, p11, p12 = w[41], w[42], w[43], w[44], w[45]
    for j in range(columns):
        pn, pe, pd = E[j], E[ld + j], E[2 * ld + j]
        vn, ve, vd = E[3 * ld + j], E[4 * ld + j], E[5 * ld + j]
        an, ae, ad = E[6 * ld + j], E[7 * ld + j], E[8 * ld + j]
        gx, gy, gz = E[9 * ld + j], E[10 * ld + j], E[11 * ld + j]
        ax, ay, az = E[12 * ld + j], E[13 * ld + j], E[14 * ld + j]
        an1 = an + a01 * ae + a02 * ad + b00 * pn + b02 * pd + d01 * ve + c00 * gx + c01 * gy + c02 * gz
        ae1 = ae + a10 * an + a12 * ad + b10 * pn + b12 * pd + d10 * vn + c10 * gx + c11 * gy + c12 * gz
        ad1 = ad + a20 * an + a21 * ae + b20 * pn + b22 * pd + d21 * ve + c20 * gx + c21 * gy + c22 * gz
        sn, se, sd = an + an1, ae + ae1, ad + ad1
        vn1 = e00 * vn + e01 * ve + e02 * vd + g00 * pn + g02 * pd + fz * se + fy * sd + c00 * ax + c01 * ay + c02 * az
        ve1 = e10 * vn + e11 * ve + e12 * vd + g10 * pn + g12 * pd - fz * sn + fx * sd + c10 * ax + c11 * ay + c12 * az
        vd1 = vd + e20 * vn + e21 * ve + g20 * pn + g22 * pd - fy * sn - fx * se + c20 * ax + c21 * ay + c22 * az
        E[j] = p00 * pn + p02 * pd + half * (vn + vn1)
        E[ld + j] = p10 * pn + p11 * pe + p12 * pd + half * (ve + ve1)
        E[2 * ld + j] = pd + half * (vd + vd1)
        E[3 * ld + j], E[4 * ld + j], E[5 * ld + j] = vn1, ve1, vd1
        E[6 * ld + j], E[7 * ld + j], E[8 * ld + j] = an1, ae1, ad1


@njit(cache=True, nogil=True, fastmath=_FAST)
def columns_of(E: Array, slots: int) -> int:
    """Columns of the augmented states; of numbers filled up with zeros to whole vector iterations: a shorter rest would run one by one."""
    wide = grid(E)[2]
    return 16 * ((slots + 1) // 2) if wide == 8 else wide * slots


@njit(cache=True, nogil=True, fastmath=_FAST)
def _scale_rows(E: Array, d: Array, slots: int) -> None:
    """Augmented states, each with a transition of its own: rows and columns scaled."""
    ld, first, wide = grid(E)
    width = columns_of(E, slots)
    D, N = d[first:], E[first:]
    for j in range(width):
        x = D[j]
        N[j] *= x
        N[ld + j] *= x
        N[2 * ld + j] *= x
        N[3 * ld + j] *= x
        N[4 * ld + j] *= x
        N[5 * ld + j] *= x
        N[6 * ld + j] *= x
        N[7 * ld + j] *= x
        N[8 * ld + j] *= x
    for s in range(slots):
        r = first + wide * s
        R = E[r * ld + first :]
        d0, d1, d2, d3, d4, d5 = d[r], d[r + 1], d[r + 2], d[r + 3], d[r + 4], d[r + 5]
        for j in range(width):
            x = D[j]
            R[j] *= d0 * x
            R[ld + j] *= d1 * x
            R[2 * ld + j] *= d2 * x
            R[3 * ld + j] *= d3 * x
            R[4 * ld + j] *= d4 * x
            R[5 * ld + j] *= d5 * x


@njit(cache=True, nogil=True, fastmath=_FAST)
def _mix_rows(E: Array, phi: Array, slots: int, work: Array) -> None:
    """Augmented states that mix within an axis: ``rows <- Phi rows`` for their own columns; ``phi`` is (slots, slots, 8)."""
    ld, first, wide = grid(E)
    width = columns_of(E, slots)
    for i in range(wide * slots):
        W, R = work[i * ld + first :], E[(first + i) * ld + first :]
        for j in range(width):
            W[j] = R[j]
    for s in range(slots):
        R = E[(first + wide * s) * ld + first :]
        p = phi[s, s]
        d0, d1, d2, d3, d4, d5 = p[0], p[1], p[2], p[3], p[4], p[5]
        for j in range(width):
            R[j] *= d0
            R[ld + j] *= d1
            R[2 * ld + j] *= d2
            R[3 * ld + j] *= d3
            R[4 * ld + j] *= d4
            R[5 * ld + j] *= d5
        for k in range(slots):
            p = phi[s, k]
            d0, d1, d2, d3, d4, d5 = p[0], p[1], p[2], p[3], p[4], p[5]
            if k != s and any_of(abs(d0) + abs(d1) + abs(d2) + abs(d3) + abs(d4) + abs(d5) > 0.0):
                W = work[wide * k * ld + first :]
                for j in range(width):
                    R[j] += d0 * W[j]
                    R[ld + j] += d1 * W[ld + j]
                    R[2 * ld + j] += d2 * W[2 * ld + j]
                    R[3 * ld + j] += d3 * W[3 * ld + j]
                    R[4 * ld + j] += d4 * W[4 * ld + j]
                    R[5 * ld + j] += d5 * W[5 * ld + j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _mix_columns(E: Array, offsets: Ints, mix: Array, slots: int, work: Array) -> None:
    """``columns <- columns Phi'`` for the navigation rows and the rows of the augmented states.

    Column j takes ``mix[i, j]`` times the old column 8 ``offsets[i]`` before it.
    """
    ld, first, wide = grid(E)
    width = columns_of(E, slots)
    R, W = E[first:], work
    for j in range(width):
        W[j] = R[j]
        W[ld + j] = R[ld + j]
        W[2 * ld + j] = R[2 * ld + j]
        W[3 * ld + j] = R[3 * ld + j]
        W[4 * ld + j] = R[4 * ld + j]
        W[5 * ld + j] = R[5 * ld + j]
        W[6 * ld + j] = R[6 * ld + j]
        W[7 * ld + j] = R[7 * ld + j]
        W[8 * ld + j] = R[8 * ld + j]
    for i in range(offsets.size):
        o = wide * offsets[i]
        R, W, M = E[first + max(o, 0) :], work[max(-o, 0) :], mix[i, first + max(o, 0) :]
        if i == 0:  # offset zero comes first and replaces
            for j in range(width):
                x = M[j]
                R[j] *= x
                R[ld + j] *= x
                R[2 * ld + j] *= x
                R[3 * ld + j] *= x
                R[4 * ld + j] *= x
                R[5 * ld + j] *= x
                R[6 * ld + j] *= x
                R[7 * ld + j] *= x
                R[8 * ld + j] *= x
        else:
            for j in range(width - abs(o)):
                x = M[j]
                R[j] += x * W[j]
                R[ld + j] += x * W[ld + j]
                R[2 * ld + j] += x * W[2 * ld + j]
                R[3 * ld + j] += x * W[3 * ld + j]
                R[4 * ld + j] += x * W[4 * ld + j]
                R[5 * ld + j] += x * W[5 * ld + j]
                R[6 * ld + j] += x * W[6 * ld + j]
                R[7 * ld + j] += x * W[7 * ld + j]
                R[8 * ld + j] += x * W[8 * ld + j]
    for s in range(slots):
        b = (first + wide * s) * ld + first
        R, W = E[b:], work
        for j in range(width):
            W[j] = R[j]
            W[ld + j] = R[ld + j]
            W[2 * ld + j] = R[2 * ld + j]
            W[3 * ld + j] = R[3 * ld + j]
            W[4 * ld + j] = R[4 * ld + j]
            W[5 * ld + j] = R[5 * ld + j]
        for i in range(offsets.size):
            o = wide * offsets[i]
            R, W, M = E[b + max(o, 0) :], work[max(-o, 0) :], mix[i, first + max(o, 0) :]
            if i == 0:
                for j in range(width):
                    x = M[j]
                    R[j] *= x
                    R[ld + j] *= x
                    R[2 * ld + j] *= x
                    R[3 * ld + j] *= x
                    R[4 * ld + j] *= x
                    R[5 * ld + j] *= x
            else:
                for j in range(width - abs(o)):
                    x = M[j]
                    R[j] += x * W[j]
                    R[ld + j] += x * W[ld + j]
                    R[2 * ld + j] += x * W[2 * ld + j]
                    R[3 * ld + j] += x * W[3 * ld + j]
                    R[4 * ld + j] += x * W[4 * ld + j]
                    R[5 * ld + j] += x * W[5 * ld + j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _axis_rows(E: Array, c: Array, slots: int, work: Array) -> None:
    """Rows of the axis errors from the rows of the augmented states, for the columns of the augmented states."""
    ld, first, wide = grid(E)
    width = columns_of(E, slots)
    V = work  # apart from E, so that the loops vectorise
    for j in range(width):
        V[j] = 0.0
        V[ld + j] = 0.0
        V[2 * ld + j] = 0.0
        V[3 * ld + j] = 0.0
        V[4 * ld + j] = 0.0
        V[5 * ld + j] = 0.0
    for s in range(slots):
        r = first + wide * s
        R = E[r * ld + first :]
        c0, c1, c2, c3, c4, c5 = c[r], c[r + 1], c[r + 2], c[r + 3], c[r + 4], c[r + 5]
        for j in range(width):
            V[j] -= c0 * R[j]
            V[ld + j] -= c1 * R[ld + j]
            V[2 * ld + j] -= c2 * R[2 * ld + j]
            V[3 * ld + j] -= c3 * R[3 * ld + j]
            V[4 * ld + j] -= c4 * R[4 * ld + j]
            V[5 * ld + j] -= c5 * R[5 * ld + j]
    R = E[U * ld + first :]
    for j in range(width):
        R[j] = V[j]
        R[ld + j] = V[ld + j]
        R[2 * ld + j] = V[2 * ld + j]
        R[3 * ld + j] = V[3 * ld + j]
        R[4 * ld + j] = V[4 * ld + j]
        R[5 * ld + j] = V[5 * ld + j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _axis_columns(E: Array, c: Array, slots: int) -> None:
    """Covariance of the navigation errors and of the axis errors with the axis errors, both halves, from columns of the augmented states."""
    ld, first, wide = grid(E)
    for a in range(6):
        n0 = n1 = n2 = n3 = n4 = n5 = n6 = n7 = n8 = 0.0
        u0 = u1 = u2 = u3 = u4 = u5 = 0.0
        for s in range(slots):
            C = E[first + wide * s + a :]
            x = c[first + wide * s + a]
            n0 -= x * C[0]
            n1 -= x * C[ld]
            n2 -= x * C[2 * ld]
            n3 -= x * C[3 * ld]
            n4 -= x * C[4 * ld]
            n5 -= x * C[5 * ld]
            n6 -= x * C[6 * ld]
            n7 -= x * C[7 * ld]
            n8 -= x * C[8 * ld]
            u0 -= x * C[9 * ld]
            u1 -= x * C[10 * ld]
            u2 -= x * C[11 * ld]
            u3 -= x * C[12 * ld]
            u4 -= x * C[13 * ld]
            u5 -= x * C[14 * ld]
        C = E[U + a :]
        C[0], C[ld], C[2 * ld], C[3 * ld], C[4 * ld] = n0, n1, n2, n3, n4
        C[5 * ld], C[6 * ld], C[7 * ld], C[8 * ld] = n5, n6, n7, n8
        C[9 * ld], C[10 * ld], C[11 * ld], C[12 * ld], C[13 * ld], C[14 * ld] = u0, u1, u2, u3, u4, u5
        R = E[(U + a) * ld :]
        R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8] = n0, n1, n2, n3, n4, n5, n6, n7, n8


@njit(cache=True, nogil=True, fastmath=_FAST)
def _transpose(E: Array, T: Array) -> None:
    """The nine navigation rows and their first fifteen columns, transposed."""
    ld, _, _ = grid(E)
    for j in range(15):
        C, R = E[j:], T[j * ld :]
        R[0], R[1], R[2], R[3], R[4] = C[0], C[ld], C[2 * ld], C[3 * ld], C[4 * ld]
        R[5], R[6], R[7], R[8] = C[5 * ld], C[6 * ld], C[7 * ld], C[8 * ld]


@njit(cache=True, nogil=True, fastmath=_FAST)
def predict(E: Array, w: Array, half: float, step: Transition, c: Array, white: Array, T: Array, work: Array) -> None:
    """One step of the covariance, in place.

    Parameters
    ----------
    E : (rows * LD,) array
        Expanded covariance.
    w, half : (46,) array, float
        Map of the step and half its duration, s.
    step : Transition
        Of the augmented states.
    c : (LD,) array
        What each axis sees of its states, at the states' places.
    white : (6,) array
        Variance of the axes' own white noise over the step.
    T, work : (15 * LD,), (LD * LD,) arrays
        Working space.
    """
    ld, first, _ = grid(E)
    slots = step.slots
    end = first + columns_of(E, slots)
    if slots > 0:
        if step.diagonal:
            _scale_rows(E, step.d, slots)
        else:
            _mix_rows(E, step.phi, slots, work)
            _mix_columns(E, step.offsets, step.mix, slots, work)
        for i in range(step.q.size):
            E[step.q_at[i]] += step.q[i]
        _axis_rows(E, c, slots, work)
    _axis_columns(E, c, slots)
    for a in range(6):
        E[(U + a) * ld + U + a] += white[a]
    apply_map(w, half, E, end)
    _transpose(E, T)
    apply_map(w, half, T, first)
    for i in range(9):
        for j in range(9):
            # of two sums that differ in rounding one is kept
            E[i * ld + j] = T[i * ld + j] if i < j else T[j * ld + i]


@njit(cache=True, nogil=True)
def states_ahead(x: Array, axis_x: Array, step: Transition, c: Array, work: Array) -> None:
    """Predict the estimates of the augmented states, and what the axes see of them.

    Parameters
    ----------
    x : (LD,) array
        Estimates at the states' places, overwritten.
    axis_x : (6,) array
        Overwritten.
    step, c, work
        As in :func:`predict`.
    """
    _, first, wide = grid(x)
    slots, d, phi = step.slots, step.d, step.phi
    if step.diagonal:
        for j in range(first, first + wide * slots):
            x[j] *= d[j]
    else:
        for s in range(slots):
            for lane in range(6):
                total = 0.0
                for k in range(slots):
                    total += phi[s, k, lane] * x[first + wide * k + lane]
                work[wide * s + lane] = total
        for s in range(slots):
            for lane in range(6):
                x[first + wide * s + lane] = work[wide * s + lane]
    for a in range(6):
        total = 0.0
        for s in range(slots):
            k = first + wide * s + a
            total += c[k] * x[k]
        axis_x[a] = total


@njit(cache=True, nogil=True, fastmath=_FAST)
def advance_transition(A: Array, w: Array, half: float, step: Transition, c: Array, work: Array) -> None:
    """Multiply the transition since the last node (same layout as ``E``) by that of one step, in place.

    Parameters
    ----------
    A : (rows * LD,) array
        Transition, overwritten.
    w, half : (46,) array, float
        Map of the step and half its duration, s.
    step : Transition
        Of the augmented states.
    c : (LD,) array
        What each axis sees of its states, at the states' places.
    work : ((8 * slots + 10) * LD,) array
        Working space.
    """
    ld, first, wide = grid(A)
    slots = step.slots
    end = first + columns_of(A, slots)
    if slots > 0:
        if step.diagonal:
            for s in range(slots):
                for lane in range(6):
                    r = first + wide * s + lane
                    x = step.d[r]
                    if any_of(x != 1.0):
                        for j in range(first, end):
                            A[r * ld + j] *= x
        else:
            _mix_rows(A, step.phi, slots, work)
        _axis_rows(A, c, slots, work)
    apply_map(w, half, A, end)


@njit(cache=True, nogil=True)
def reset_transition(A: Array, rows: int) -> None:
    """Make the transition the identity."""
    ld, first, _ = grid(A)
    A[: rows * ld] = 0.0
    for i in range(rows):
        if i < 9 or i >= first:
            A[i * ld + i] = 1.0


@njit(cache=True, nogil=True)
def gather(E: Array, place: Ints, P: Array) -> None:
    """Copy the filter's covariance out of the expanded one: ``P`` (n, n) in the layout's order.

    Parameters
    ----------
    E : (rows * LD,) array
        Expanded covariance.
    place : (n,) array of int
        Row of ``E`` of each state of the layout.
    P : (n, n) array
        Overwritten, symmetric.
    """
    ld, _, _ = grid(E)
    n = place.size
    for i in range(n):
        for j in range(i, n):
            x = E[place[i] * ld + place[j]]
            P[i, j] = x
            P[j, i] = x


@njit(cache=True, nogil=True)
def scatter(P: Array, place: Ints, changed: float, E: Array) -> None:
    """Inverse of :func:`gather`.

    Parameters
    ----------
    P : (n, n) array
        Covariance in the layout's order.
    place : (n,) array of int
        Row of ``E`` of each state of the layout.
    changed : float
        1 where ``P`` has changed since it was gathered, else 0.
    E : (rows * LD,) array
        Overwritten there at these places, without the transposes of the navigation rows.
    """
    ld, _, _ = grid(E)
    n = place.size
    for i in range(n):
        for j in range(n):
            if i < 9 or j >= 9:
                at = place[i] * ld + place[j]
                E[at] = where(changed > 0.0, P[i, j], E[at])
