"""The covariance of matched filters of several sensors side by side, from node to node of a track."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.lanes import where, zeros

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Rows that a fix has (position and velocity).
FIX_ROWS = 6


class Nodes(NamedTuple):
    """A track from node to node, m states of the sensors and w rows of measurements.

    Parameters
    ----------
    F, E, D : (k, 9, 9), (k, 9, m), (k, m) arrays
        Transition of the navigation errors, of the states into them, of the states, over every interval.
    N, C, R : (k, m + 6, 9, 9), (k, m, 9), (k, m) arrays
        What unit driving noise of each state (and unit white noise of each axis) adds.
    H, var : (k + 1, w, 9), (k + 1, w) arrays
        Measurements at the nodes, those of fixes first; a variance that is not finite is none.
    """

    F: Array
    E: Array
    D: Array
    N: Array
    C: Array
    R: Array
    H: Array
    var: Array


class Driven(NamedTuple):
    """Sensors side by side in lanes, m states each.

    Parameters
    ----------
    q, white : (m,), (6,) arrays of lanes
        Variances of the driving and the white noise of each sensor.
    P : (9 + m, 9 + m) array of lanes
        Covariance at the first node; overwritten.
    """

    q: Array
    white: Array
    P: Array


@njit(cache=True, nogil=True)
def _moved(P: Array, X: Array, track: Nodes, at: int, q: Array, white: Array) -> None:
    """Take ``P`` (n, n) over the interval after node ``at``; ``X`` (n, 9) is overwritten."""
    F, E, D = track.F[at], track.E[at], track.D[at]
    N, C, R = track.N[at], track.C[at], track.R[at]
    n, m = P.shape[0], P.shape[0] - 9
    for i in range(9):
        for j in range(n):
            x = F[i, 0] * P[j, 0]
            for k in range(1, 9):
                x += F[i, k] * P[j, k]
            for k in range(m):
                x += E[i, k] * P[j, 9 + k]
            X[j, i] = x
    for i in range(9):
        for j in range(i, 9):
            x = F[j, 0] * X[0, i]
            for k in range(1, 9):
                x += F[j, k] * X[k, i]
            for k in range(m):
                x += E[j, k] * X[9 + k, i]
            for k in range(m):
                x += N[k, i, j] * q[k]
            for a in range(6):
                x += N[m + a, i, j] * white[a]
            P[i, j] = x
            P[j, i] = x
        for k in range(m):
            x = X[9 + k, i] * D[k] + C[k, i] * q[k]
            P[i, 9 + k] = x
            P[9 + k, i] = x
    for i in range(m):
        for j in range(m):
            P[9 + i, 9 + j] *= D[i] * D[j]
        P[9 + i, 9 + i] += R[i] * q[i]


@njit(cache=True, nogil=True)
def _measured(P: Array, G: Array, H: Array, var: Array, first: int, last: int) -> None:
    """Update ``P`` by rows of measurements, one after the other; ``G`` (n,) is overwritten."""
    n = P.shape[0]
    for w in range(first, last):
        if not np.isfinite(var[w]):
            continue
        for i in range(n):
            x = H[w, 0] * P[i, 0]
            for j in range(1, 9):
                if H[w, j] != 0.0:
                    x += H[w, j] * P[i, j]
            G[i] = x
        s = var[w] + H[w, 0] * G[0]
        for j in range(1, 9):
            s += H[w, j] * G[j]
        for i in range(n):
            g = G[i] / s
            for j in range(i + 1):
                x = P[i, j] - g * G[j]
                P[i, j] = x
                P[j, i] = x


@njit(cache=True, nogil=True)
def outages(track: Nodes, sensors: Driven, starts: Ints, ends: Ints, out: Array, most: Array) -> None:
    """Covariances of the navigation errors at the ends of outages, of sensors side by side (:mod:`insemu.lanes`).

    Each sensor has the filter that knows its own figures, whose covariance is that of its errors.

    Parameters
    ----------
    track : Nodes
    sensors : Driven
    starts, ends : (s,), (s, h) arrays of int
        Nodes at which outages begin (their fixes are used) and at which errors are asked for, both increasing.
    out : (s, h, 9, 9) array of lanes
        Overwritten.
    most : (1,) array of lanes
        Overwritten: the largest variance of a component of the attitude at any node, before its fix.
    """
    q, white, P = sensors
    H, var = track.H, track.var
    n, rows = P.shape[0], var.shape[1]
    X, G, free = zeros(P, (n, 9)), zeros(P, n), zeros(P, (n, n))
    for i in range(6, 9):
        most[0] = where(P[i, i] > most[0], P[i, i], most[0])
    for s in range(starts.size):
        for k in range(starts[s - 1] if s else 0, starts[s]):
            _moved(P, X, track, k, q, white)
            for i in range(6, 9):
                most[0] = where(P[i, i] > most[0], P[i, i], most[0])
            _measured(P, G, H[k + 1], var[k + 1], 0, rows)
        for i in range(n):
            for j in range(n):
                free[i, j] = P[i, j]
        at = starts[s]
        for h in range(ends.shape[1]):
            for k in range(at, ends[s, h]):
                _moved(free, X, track, k, q, white)
                for i in range(6, 9):
                    most[0] = where(free[i, i] > most[0], free[i, i], most[0])
                _measured(free, G, H[k + 1], var[k + 1], FIX_ROWS, rows)
            at = ends[s, h]
            for i in range(9):
                for j in range(9):
                    out[s, h, i, j] = free[i, j]
