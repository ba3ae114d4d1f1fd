"""The covariance of matched filters of several sensors side by side, from node to node of a track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Sensors that are carried side by side, and rows that a fix has (position and velocity).
LANES, FIX_ROWS = 8, 6


@njit(cache=True, nogil=True)
def _moved(
    P: Array, X: Array, Y: Array, F: Array, E: Array, D: Array, N: Array, C: Array, R: Array, q: Array, white: Array
) -> None:
    """Take ``P`` (n, n, LANES) over one interval; ``X`` (9, n, LANES) and ``Y`` (n, 9, LANES) are overwritten."""
    n, m = P.shape[0], P.shape[0] - 9
    rows, half, other = P.reshape(n, n * LANES), X.reshape(9, n * LANES), Y.reshape(n, 9 * LANES)
    for i in range(9):
        x = half[i]
        x[:] = 0.0
        for k in range(n):
            f = F[i, k] if k < 9 else E[i, k - 9]
            if f != 0.0:
                p = rows[k]
                for b in range(n * LANES):
                    x[b] += f * p[b]
        for j in range(n):
            Y[j, i] = X[i, j]
    for i in range(9):
        x = rows[i, : 9 * LANES]
        x[:] = 0.0
        for k in range(n):
            f = F[i, k] if k < 9 else E[i, k - 9]
            if f != 0.0:
                p = other[k]
                for b in range(9 * LANES):
                    x[b] += f * p[b]
    for k in range(m):
        for i in range(9):
            for j in range(9):
                for b in range(LANES):
                    P[i, j, b] += N[k, i, j] * q[k, b]
            for b in range(LANES):
                P[i, 9 + k, b] = X[i, 9 + k, b] * D[k] + C[k, i] * q[k, b]
            P[9 + k, i] = P[i, 9 + k]
    for a in range(6):
        for i in range(9):
            for j in range(9):
                for b in range(LANES):
                    P[i, j, b] += N[m + a, i, j] * white[a, b]
    for i in range(m):
        for j in range(m):
            d = D[i] * D[j]
            for b in range(LANES):
                P[9 + i, 9 + j, b] *= d
        for b in range(LANES):
            P[9 + i, 9 + i, b] += R[i] * q[i, b]


@njit(cache=True, nogil=True)
def _measured(P: Array, G: Array, K: Array, H: Array, var: Array, first: int, last: int) -> None:
    """Update ``P`` by rows of measurements, one after the other; ``G`` (n + 1, LANES) and ``K`` (n, LANES) are overwritten."""
    n = P.shape[0]
    for w in range(first, last):
        if not np.isfinite(var[w]):
            continue
        G[:] = 0.0
        for j in range(9):
            h = H[w, j]
            if h != 0.0:
                for i in range(n):
                    for b in range(LANES):
                        G[i, b] += P[j, i, b] * h
        G[n] = var[w]
        for j in range(9):
            for b in range(LANES):
                G[n, b] += H[w, j] * G[j, b]
        for i in range(n):
            for b in range(LANES):
                K[i, b] = G[i, b] / G[n, b]
        for i in range(n):
            for j in range(n):
                for b in range(LANES):
                    P[i, j, b] -= G[i, b] * K[j, b]


@njit(cache=True, nogil=True)
def outages(
    F: Array, E: Array, D: Array, N: Array, C: Array, R: Array, H: Array, var: Array, q: Array, white: Array, P: Array, starts: Ints,
    ends: Ints, out: Array,
) -> None:  # fmt: skip
    """Covariances of the navigation errors at the ends of outages of LANES sensors, each with the filter that knows its own sensor.

    Parameters
    ----------
    F, E, D : (k, 9, 9), (k, 9, m), (k, m) arrays
        Transition of the navigation errors, of the states into them, of the states, over every interval.
    N, C, R : (k, m + 6, 9, 9), (k, m, 9), (k, m) arrays
        What unit driving noise of each state (and unit white noise of each axis) adds.
    H, var : (k + 1, w, 9), (k + 1, w) arrays
        Measurements at the nodes, those of fixes first; a variance that is not finite is none.
    q, white : (m, LANES), (6, LANES) arrays
        Variances of the driving and the white noise of each sensor.
    P : (9 + m, 9 + m, LANES) array
        At the first node; overwritten.
    starts, ends : (s,), (s, h) arrays of int
        Nodes at which outages begin (their fixes are used) and at which errors are asked for, both increasing.
    out : (s, h, 9, 9, LANES) array
        Overwritten.
    """
    n, rows = P.shape[0], var.shape[1]
    X, Y, free = np.empty((9, n, LANES)), np.empty((n, 9, LANES)), np.empty_like(P)
    G, K = np.empty((n + 1, LANES)), np.empty((n, LANES))
    for s in range(starts.size):
        for k in range(starts[s - 1] if s else 0, starts[s]):
            _moved(P, X, Y, F[k], E[k], D[k], N[k], C[k], R[k], q, white)
            _measured(P, G, K, H[k + 1], var[k + 1], 0, rows)
        free[:] = P
        at = starts[s]
        for h in range(ends.shape[1]):
            for k in range(at, ends[s, h]):
                _moved(free, X, Y, F[k], E[k], D[k], N[k], C[k], R[k], q, white)
                _measured(free, G, K, H[k + 1], var[k + 1], FIX_ROWS, rows)
            at = ends[s, h]
            out[s, h] = free[:9, :9]
