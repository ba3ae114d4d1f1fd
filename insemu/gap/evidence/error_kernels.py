"""Compiled loops over the error of the nominal filter: how it builds up, and how the filter answers it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]


class Track(NamedTuple):
    """Where and how the IMU went.

    Parameters
    ----------
    t : (n,) array
        IMU times, s; row k describes the interval that ends there.
    C : (n, 3, 3), f_n : (n, 3) arrays
        Attitude and specific force in NED for each interval.
    node : (k,) array of int
        IMU rows of the nodes, increasing.
    """

    t: Array
    C: Array
    f_n: Array
    node: NDArray[np.int64]


class LoopArrays(NamedTuple):
    """A filter in the loop.

    Parameters
    ----------
    Phi : (nodes, n, n) array
        Transition to each node from the one before.
    K, H : (f, n, 6), (f, 6, n) arrays
        Zero where a component was not used.
    node : (f,) array of int
        Node of each fix, not decreasing.
    use : (f, 6) array of bool
    """

    Phi: Array
    K: Array
    H: Array
    node: NDArray[np.int64]
    use: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def integrate_inputs(
    track: Track, u: Array, axis: NDArray[np.int64], column: NDArray[np.int64], D: Array, ramp: Array
) -> None:  # pragma: no cover - compiled
    """Navigation errors that unit sensor errors build up between nodes.

    Within an interval the errors start at zero and grow by ``v' = C df - [f_n x] phi``, ``phi' = C dw``, ``p' = v``; what the rotation of
    the Earth adds over an interval of seconds is below a part in a thousand and belongs to the transition from node to node.

    Parameters
    ----------
    track : Track
    u : (e, n) array
        Unit sensor errors, rad/s or m/s^2.
    axis, column : (e,) arrays of int
        Axis 0..5 of each entry, and the column of ``D`` that it belongs to.
    D : (k, columns, 9) array
        Written to: what has built up at each node since the one before.
    ramp : (k, 12, 9) or (k, 0, 9) array
        Written to: the same for a constant (0..5) and for a ramp from 0 to 1 across the interval (6..11) on each axis; nothing without rows.
    """
    t, C, f_n, node = track
    entries = axis.size
    columns = D.shape[1]
    ramps = ramp.shape[1] > 0
    total = columns + ramp.shape[1]
    e = np.zeros((9, total))
    add = np.zeros((6, total))
    for i in range(1, node.size):
        a, b = node[i - 1], node[i]
        e[:, :] = 0.0
        span = t[b] - t[a]
        for k in range(a + 1, b + 1):
            dt = t[k] - t[k - 1]
            add[:, :columns] = 0.0
            for m in range(entries):
                x = u[m, k] * dt
                if x != 0.0:
                    c, j = column[m], axis[m]
                    if j < 3:
                        for r in range(3):
                            add[3 + r, c] += C[k, r, j] * x
                    else:
                        for r in range(3):
                            add[r, c] += C[k, r, j - 3] * x
            part = (0.5 * (t[k] + t[k - 1]) - t[a]) / span
            for j in range(3 if ramps else 0):
                for r in range(3):
                    x = C[k, r, j] * dt
                    add[3 + r, columns + j] = x
                    add[r, columns + 3 + j] = x
                    add[3 + r, columns + 6 + j] = x * part
                    add[r, columns + 9 + j] = x * part
            fx, fy, fz = f_n[k, 0], f_n[k, 1], f_n[k, 2]
            for c in range(total):
                px = e[6, c] + 0.5 * add[3, c]
                py = e[7, c] + 0.5 * add[4, c]
                pz = e[8, c] + 0.5 * add[5, c]
                vx = add[0, c] - (fy * pz - fz * py) * dt
                vy = add[1, c] - (fz * px - fx * pz) * dt
                vz = add[2, c] - (fx * py - fy * px) * dt
                e[0, c] += (e[3, c] + 0.5 * vx) * dt
                e[1, c] += (e[4, c] + 0.5 * vy) * dt
                e[2, c] += (e[5, c] + 0.5 * vz) * dt
                e[3, c] += vx
                e[4, c] += vy
                e[5, c] += vz
                e[6, c] += add[3, c]
                e[7, c] += add[4, c]
                e[8, c] += add[5, c]
        for c in range(columns):
            for r in range(9):
                D[i, c, r] = e[r, c]
        for c in range(ramp.shape[1]):
            for r in range(9):
                ramp[i, c, r] = e[r, columns + c]


@njit(cache=True, nogil=True, fastmath={"contract"})
def carried(Phi: Array, e: Array, cols: int, out: Array) -> None:  # pragma: no cover - compiled
    """``out = Phi e`` of the first ``cols`` columns: transitions are mostly zeros, which are passed over.

    Parameters
    ----------
    Phi : (n, n) array
    e : (n, c) array
    cols : int
    out : (n, c) array
        Written to.
    """
    n = Phi.shape[0]
    for r in range(n):
        for c in range(cols):
            out[r, c] = 0.0
        for q in range(n):
            w = Phi[r, q]
            if w != 0.0:
                for c in range(cols):
                    out[r, c] += w * e[q, c]


@njit(cache=True, nogil=True, fastmath={"contract"})
def respond(
    loop: LoopArrays, D: Array, at: NDArray[np.int64], M: Array, begin: NDArray[np.int64], out: Array
) -> None:  # pragma: no cover - compiled
    """Innovations that navigation errors and errors of the fixes cause in a filter in the loop.

    ``e- = Phi e+ + D``, ``g = M - H e-``, ``e+ = e- + K g``; the first ``D`` is the error of the start. Transitions and Jacobians are mostly
    zeros, which are passed over, and so are columns that have not begun.

    Parameters
    ----------
    loop : LoopArrays
    D : (nodes, a, 9) array
        Navigation errors built up since the node before, or there at the first; without rows where there are none.
    at : (nodes, a) or (1, a) array of int
        Column of each entry of ``D``; one row where it is the same at every node.
    M : (f, 6, columns) array
        Errors of the fixes; without rows where there are none.
    begin : (columns,) array of int
        Node before which a column is zero, not decreasing.
    out : (f, 6, columns) array of zeros
        Written to.
    """
    Phi, K, H, node, use = loop
    n, every = Phi.shape[1], out.shape[2]
    e = np.zeros((n, every))
    ahead = np.zeros((n, every))
    k, cols = 0, 0
    for i in range(Phi.shape[0]):
        while cols < every and begin[cols] <= i:
            cols += 1
        if i > 0:
            carried(Phi[i], e, cols, ahead)
            e, ahead = ahead, e
        if D.shape[0] > 0:
            row = min(i, at.shape[0] - 1)
            for c in range(D.shape[1]):
                for r in range(9):
                    e[r, at[row, c]] += D[i, c, r]
        while k < node.size and node[k] == i:
            for m in range(6):
                if not use[k, m]:
                    continue
                if M.shape[0] > 0:
                    for c in range(cols):
                        out[k, m, c] = M[k, m, c]
                for q in range(n):
                    w = H[k, m, q]
                    if w != 0.0:
                        for c in range(cols):
                            out[k, m, c] -= w * e[q, c]
            for m in range(6):
                if not use[k, m]:
                    continue
                for q in range(n):
                    w = K[k, q, m]
                    if w != 0.0:
                        for c in range(cols):
                            e[q, c] += w * out[k, m, c]
            k += 1
