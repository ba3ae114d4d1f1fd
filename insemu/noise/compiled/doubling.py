"""Compiled wavelet variance of an ARMA by exact doubling, and its coefficients from unconstrained numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def coefficients_of(z: Array) -> Array:  # pragma: no cover - compiled
    """Coefficients of a stationary autoregression from unconstrained numbers: partial autocorrelations tanh(z), Durbin-Levinson."""
    n = z.size
    out = np.zeros(n)
    old = np.zeros(n)
    for k in range(n):
        r = math.tanh(z[k])
        for i in range(k):
            out[i] = old[i] - r * old[k - 1 - i]
        out[k] = r
        for i in range(k + 1):
            old[i] = out[i]
    return out


@njit(cache=True, nogil=True)
def multiply(A: Array, B: Array, out: Array) -> None:  # pragma: no cover - compiled
    """``out = A B`` by loops: the matrices are small, and calling a library costs seconds of compilation.

    Parameters
    ----------
    A, B : (n, k), (k, m) arrays
    out : (n, m) array
        Overwritten; neither of the two.
    """
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@njit(cache=True, nogil=True)
def copy(A: Array, out: Array) -> None:  # pragma: no cover - compiled
    """``out = A``."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j]


@njit(cache=True, nogil=True)
def arma(m: Array, z: Array, p: int, b: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance of an ARMA with unit innovations by exact doubling; ``m`` are powers of two, ascending.

    Parameters
    ----------
    m : (J,) array
        Samples per average.
    z : (p + q,) array
        Unconstrained numbers of the autoregression, then of the moving average; see :func:`coefficients_of`.
    p : int
        Order of the autoregression.
    b : (J,) array
        Overwritten.
    """
    q = z.size - p
    ar = coefficients_of(z[:p])
    ma = coefficients_of(z[p:])
    n = max(p, q + 1)
    phi, P, A, T = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    power, one, two = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for i in range(p):
        phi[i, 0] = ar[i]
    for i in range(n - 1):
        phi[i, i + 1] += 1.0
    for i in range(n):
        T[i, i] = 1.0
        for j in range(n):
            left = 1.0 if i == 0 else (-ma[i - 1] if i <= q else 0.0)
            right = 1.0 if j == 0 else (-ma[j - 1] if j <= q else 0.0)
            P[i, j] = left * right
    copy(phi, A)
    for _ in range(60):
        # P + A P A'
        multiply(A, P, one)
        change, largest = 0.0, 0.0
        multiply(one, A.T, two)
        for i in range(n):
            for j in range(n):
                P[i, j] += two[i, j]
                change = max(change, abs(two[i, j]))
                largest = max(largest, abs(P[i, j]))
        multiply(A, A, one)
        copy(one, A)
        if change <= 1e-16 * largest:
            break
    copy(phi, power)
    V = P[0, 0]
    at = 0
    count = 1.0
    while at < m.size:
        # C = (P T')[0] (phi T)[0]'
        C = 0.0
        for j in range(n):
            left, right = 0.0, 0.0
            for k in range(n):
                left += P[0, k] * T[j, k]
                right += phi[0, k] * T[k, j]
            C += left * right
        if m[at] == count:
            b[at] = 0.5 * (V - C) / (count * count)
            at += 1
        V = 2.0 * V + 2.0 * C
        multiply(power, T, one)
        for i in range(n):
            for j in range(n):
                T[i, j] += one[i, j]
        multiply(power, power, one)
        copy(one, power)
        count *= 2.0
