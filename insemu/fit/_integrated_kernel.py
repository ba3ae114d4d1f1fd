"""Compiled recursions of the integrated likelihood: transitions over many samples by repeated squaring, and the filter over increments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Covariances count as settled when no entry changes by more than this share of the largest.
SETTLED = 1e-12


@njit(cache=True, nogil=True)
def _product(A: Array, B: Array, out: Array, transposed: bool) -> None:  # pragma: no cover - compiled
    """``out = A B`` or ``A B'``."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for h in range(n):
                s += A[i, h] * (B[j, h] if transposed else B[h, j])
            out[i, j] = s


@njit(cache=True, nogil=True)
def powers(F: Array, V: Array, counts: Ints, A: Array, W: Array) -> None:  # pragma: no cover - compiled
    """Transition ``A[k] = F^counts[k]`` and accumulated noise ``W[k]`` of as many steps of ``x -> F x + noise(V)``.

    Parameters
    ----------
    F, V : (n, n) arrays
        Transition and driving covariance of one step.
    counts : (k,) array of int
        Numbers of steps.
    A, W : (k, n, n) arrays
        Overwritten.
    """
    n = F.shape[0]
    base, noise = np.empty((n, n)), np.empty((n, n))
    T, U = np.empty((n, n)), np.empty((n, n))
    for k in range(counts.size):
        base[:, :] = F
        noise[:, :] = V
        A[k, :, :] = np.eye(n)
        W[k, :, :] = 0.0
        left = counts[k]
        while left > 0:
            if left & 1:
                # first what is there, then `base` steps more
                _product(base, W[k], T, False)
                _product(T, base, U, True)
                W[k, :, :] = U + noise
                _product(base, A[k], T, False)
                A[k, :, :] = T
            left >>= 1
            if left > 0:
                _product(base, noise, T, False)
                _product(T, base, U, True)
                noise[:, :] = noise + U
                _product(base, base, T, False)
                base[:, :] = T


@njit(cache=True, nogil=True)
def increments_likelihood(
    A: Array, W: Array, which: Ints, P0: Array, extra: Array, y: Array, spans: Array, bias: bool
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Log-likelihood of increments, and the estimated constant.

    The last state is the integral; it starts from zero in every interval, and its value at the end is what is observed. ``which`` names the
    transition of every interval, ``extra`` the variance that is added to the increment (white noise), ``spans`` what a unit constant adds.
    With ``bias`` a constant of unknown value is estimated along (the likelihood is the one with a flat prior).

    Parameters
    ----------
    A, W : (k, n, n) arrays
        Transition and accumulated driving covariance of each kind of interval.
    which : (N,) array of int
        Kind of each interval.
    P0 : (n, n) array
        Covariance of the states before the first interval.
    extra : (k,) array
        Variance that white noise adds to what is observed, in the unit of ``y`` squared.
    y : (N,) array
        What is observed at the end of each interval.
    spans : (N,) array
        What a unit constant adds to it.
    bias : bool
        Whether a constant is estimated.

    Returns
    -------
    float, float
        Log-likelihood, minus infinity where an innovation has no variance, and the constant (zero without ``bias``).
    """
    n = P0.shape[0]
    last = n - 1
    x, z = np.zeros(n), np.zeros(n)
    xp, zp = np.empty(n), np.empty(n)
    P, M, T = P0.copy(), np.empty((n, n)), np.empty((n, n))
    K = np.empty(n)
    total, yy, yz, zz = 0.0, 0.0, 0.0, 0.0
    S, logS = 1.0, 0.0
    constant = False
    for k in range(y.size):
        w = which[k]
        if k > 0 and which[k - 1] != w:
            constant = False
        for i in range(n):
            a, b = 0.0, 0.0
            for j in range(last):
                a += A[w, i, j] * x[j]
                b += A[w, i, j] * z[j]
            xp[i] = a
            zp[i] = b
        if not constant:
            for i in range(n):
                for j in range(last):
                    s = 0.0
                    for h in range(last):
                        s += A[w, i, h] * P[h, j]
                    T[i, j] = s
            for i in range(n):
                for j in range(i + 1):
                    s = W[w, i, j]
                    for h in range(last):
                        s += T[i, h] * A[w, j, h]
                    M[i, j] = s
                    M[j, i] = s
            S = M[last, last] + extra[w]
            if not S > 0.0:
                return -np.inf, 0.0
            logS = math.log(2.0 * math.pi * S)
            for i in range(n):
                K[i] = M[i, last] / S
            change, largest = 0.0, 0.0
            for i in range(last):
                for j in range(last):
                    new = M[i, j] - K[i] * M[j, last]
                    change = max(change, abs(new - P[i, j]))
                    largest = max(largest, abs(new))
                    P[i, j] = new
            constant = k > 2 and which[k - 1] == w and change <= SETTLED * largest
        e = y[k] - xp[last]
        f = spans[k] - zp[last]
        for i in range(last):
            x[i] = xp[i] + K[i] * e
            z[i] = zp[i] + K[i] * f
        total -= 0.5 * logS
        yy += e * e / S
        yz += e * f / S
        zz += f * f / S
    if not bias:
        return total - 0.5 * yy, 0.0
    return total - 0.5 * (yy - yz * yz / zz) - 0.5 * math.log(zz), yz / zz
