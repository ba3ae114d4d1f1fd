"""Likelihood and smoothing of a scalar signal under a linear Gaussian state space with constant matrices.

``x_k = Phi x_(k-1) + u + w_k``, ``y_k = c x_k + v_k``; the state before the first sample has mean ``x0`` and covariance ``P0``. The
compiled loops stop updating covariances once they are steady, so that a long record costs little more than two products per state and
sample. The log-likelihood is the innovations form (equation (19) of Nikolic et al. 2016); the smoother is the fixed-interval one of the appendix of
Stebler et al. 2011.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError
from insemu.noise import StateBlock
from insemu.noise.compiled import copy, multiply

Array = NDArray[np.float64]

#: Covariances count as steady when no entry changes by more than this share of the largest.
STEADY = 1e-12


class Model(NamedTuple):
    """A state space as compiled code takes it, with k kinds of steps.

    A step moves ``n`` states to ``r`` rows, of which the first ``n`` are the states after it; the sample sees the rows.

    Parameters
    ----------
    Phi, Q : (k, r, n), (k, r, r) arrays
        Transition and driving covariance of each kind of step.
    c : (r,) array
        What a sample sees of the rows.
    R : (k,) array
        Variance of the sample's own white noise, unit^2.
    u : (r,) array
        Constant input per step.
    x0, P0 : (n,), (n, n) arrays
        Mean and covariance of the state before the first sample.
    """

    Phi: Array
    Q: Array
    c: Array
    R: Array
    u: Array
    x0: Array
    P0: Array


class Filtered(NamedTuple):
    """Filtered means (N, n); filtered and predicted covariances (N, n, n) up to where they are constant."""

    x: Array
    P: Array
    ahead: Array


class Moments(NamedTuple):
    """Smoothed means and variances (N, n), and the sums of :class:`Smoothed` (n, n)."""

    mean: Array
    variance: Array
    now: Array
    cross: Array
    before: Array
    first: Array


@njit(cache=True, nogil=True)
def kalman(
    model: Model, which: NDArray[np.int64], y: Array, out: Filtered, sums: Array
) -> tuple[float, int]:  # pragma: no cover - compiled
    """Filter forwards; returns minus half the logarithms of the innovations' variances, and the index from which covariances are constant.

    Parameters
    ----------
    model : Model
    which : (N,) array of int
        Kind of each step.
    y : (N, d) array
        The signal and further columns that the same filter takes, for example what a unit constant adds to the signal.
    out : Filtered
        Overwritten, with the first column; left alone where it has no rows.
    sums : (d, d) array
        Products of the columns' innovations over their variance are added.
    """
    Phi, Q, c, R, u, x0, P0 = model
    xf, Pf, Pp = out
    r, n, d = c.size, x0.size, y.shape[1]
    x, ahead, e, seen = np.zeros((d, n)), np.empty(n), np.empty(d), np.empty(n)
    for i in range(n):
        x[0, i] = x0[i]
    P, M, T, K, G = P0.copy(), np.empty((r, r)), np.empty((r, n)), np.empty(r), np.empty(r)
    total, S, logS, inverse, pushed = 0.0, 1.0, 0.0, 1.0, 0.0
    for i in range(r):
        pushed += c[i] * u[i]
    steady = y.shape[0] - 1
    constant = False
    for k in range(y.shape[0]):
        w = which[k]
        if k > 0 and which[k - 1] != w:
            constant = False
        if not constant:
            for j in range(n):  # what the sample sees of the states before the step
                seen[j] = 0.0
                for i in range(r):
                    seen[j] += c[i] * Phi[w, i, j]
            multiply(Phi[w], P, T)
            for i in range(r):
                for j in range(i + 1):
                    s = Q[w, i, j]
                    for h in range(n):
                        s += T[i, h] * Phi[w, j, h]
                    M[i, j] = s
                    M[j, i] = s
            S = R[w]
            for i in range(r):
                s = 0.0
                for j in range(r):
                    s += M[i, j] * c[j]
                G[i] = s
                S += c[i] * s
            if not S > 0.0:
                return -np.inf, 0
            logS, inverse = math.log(2.0 * math.pi * S), 1.0 / S
            change, largest = 0.0, 0.0
            for i in range(r):
                K[i] = G[i] / S
            for i in range(n):
                for j in range(n):
                    new = M[i, j] - K[i] * G[j]
                    change = max(change, abs(new - P[i, j]))
                    largest = max(largest, abs(new))
                    P[i, j] = new
            if xf.size:
                copy(P, Pf[k])
                copy(M, Pp[k])
            constant = k > 2 and which[k - 1] == w and change <= STEADY * largest
            if constant:
                steady = k
        for a in range(d):
            own = 1.0 if a == 0 else 0.0
            s = y[k, a] - own * pushed
            for j in range(n):
                s -= seen[j] * x[a, j]
            for i in range(n):
                ahead[i] = own * u[i] + K[i] * s
                for j in range(n):
                    ahead[i] += Phi[w, i, j] * x[a, j]
            for i in range(n):
                x[a, i] = ahead[i]
            e[a] = s
            for b in range(a + 1):
                sums[a, b] += s * e[b] * inverse
        if xf.size:
            for i in range(n):
                xf[k, i] = x[0, i]
        total -= 0.5 * logS
    return total, steady


@njit(cache=True, nogil=True)
def smooth_sums(model: Model, filtered: Filtered, steady: int, out: Moments) -> None:  # pragma: no cover - compiled
    """Smooth backwards after :func:`kalman`; fills the smoothed means and the sums of second moments of the covariances.

    ``now`` = sum over t = 1..N-1 of P_t, ``cross`` of P_(t,t-1), ``before`` of P_(t-1); ``first`` = P_0; ``variance`` (N, n) the diagonals.

    Parameters
    ----------
    model : Model
    filtered : Filtered
    steady : int
        Index from which the covariances are constant, of :func:`kalman`.
    out : Moments
        Overwritten; its sums are added to.
    """
    Phi, u, (xf, Pf, Pp) = model.Phi[0], model.u, filtered
    xs, Ps, now, cross, before, first = out
    N, n = xf.shape
    P = Pf[min(N - 1, steady)].copy()
    J, T, new = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    ready = -2
    unchanged = False
    for i in range(n):
        xs[N - 1, i] = xf[N - 1, i]
        Ps[N - 1, i] = P[i, i]
    step = np.empty(n)
    C, L, row = np.empty((n, n)), np.zeros((n, n)), np.empty(n)
    D, G = np.empty((n, n)), np.empty((n, n))
    for t in range(N - 1, 0, -1):
        at, nxt = min(t - 1, steady), min(t, steady)
        moved = nxt != ready
        if moved:
            # J = Pf Phi' Pp^-1 of the interval (t-1, t)
            multiply(Pf[at], Phi.T, T)
            # by Cholesky of Pp, with a jitter below its digits for states without noise
            tiny = 1e-300
            for i in range(n):
                tiny += 1e-15 * Pp[nxt, i, i] / n
            for i in range(n):
                for j in range(i + 1):
                    s = Pp[nxt, i, j] + (tiny if i == j else 0.0)
                    for h in range(j):
                        s -= L[i, h] * L[j, h]
                    if i == j:
                        L[i, i] = math.sqrt(max(s, tiny))
                    else:
                        L[i, j] = s / L[j, j]
            for r in range(n):
                for i in range(n):
                    s = T[r, i]
                    for h in range(i):
                        s -= L[i, h] * row[h]
                    row[i] = s / L[i, i]
                for i in range(n - 1, -1, -1):
                    s = row[i]
                    for h in range(i + 1, n):
                        s -= L[h, i] * J[r, h]
                    J[r, i] = s / L[i, i]
            ready = nxt
        if moved or not unchanged:
            multiply(P, J.T, C)  # cov(x_t, x_(t-1))
            for i in range(n):
                for j in range(n):
                    D[i, j] = P[i, j] - Pp[nxt, i, j]
            multiply(D, J.T, G)
            multiply(J, G, new)
            change, largest = 0.0, 0.0
            for i in range(n):
                for j in range(n):
                    new[i, j] += Pf[at, i, j]
                    change = max(change, abs(new[i, j] - P[i, j]))
                    largest = max(largest, abs(new[i, j]))
            unchanged = change <= STEADY * largest
        for i in range(n):
            s = u[i]
            for j in range(n):
                s += Phi[i, j] * xf[t - 1, j]
            step[i] = xs[t, i] - s
        for i in range(n):
            s = xf[t - 1, i]
            for j in range(n):
                s += J[i, j] * step[j]
            xs[t - 1, i] = s
            Ps[t - 1, i] = new[i, i]
        for i in range(n):
            for j in range(n):
                now[i, j] += P[i, j]
                cross[i, j] += C[i, j]
                before[i, j] += new[i, j]
                P[i, j] = new[i, j]
    copy(P, first)


@dataclass(frozen=True)
class Smoothed:
    """Fixed-interval smoothing.

    Parameters
    ----------
    mean : (N, n) array
        E[x_k | all samples].
    variance : (N, n) array
        Diagonals of the covariances.
    sum_now, sum_cross, sum_before, first : (n, n) arrays
        Sums of the covariances P_k and P_(k,k-1) over k = 1..N-1, of P_(k-1) over the same, and P_0.
    log_likelihood : float
    """

    mean: Array
    variance: Array
    sum_now: Array
    sum_cross: Array
    sum_before: Array
    first: Array
    log_likelihood: float


def _prepared(block: StateBlock, y: ArrayLike, u: ArrayLike | None, x0: ArrayLike | None) -> tuple[Array, Model]:
    signal = np.ascontiguousarray(y, dtype=np.float64)
    if signal.ndim != 1 or signal.size == 0:
        raise InputError(f"the signal has shape {signal.shape}, expected (n,) with at least one sample")
    if not np.isfinite(signal).all():
        raise InputError(f"the signal is not finite at sample {int(np.argmin(np.isfinite(signal)))}")
    drift = np.zeros(block.n) if u is None else np.asarray(u, dtype=np.float64)
    start = np.zeros(block.n) if x0 is None else np.asarray(x0, dtype=np.float64)
    if drift.shape != (block.n,) or start.shape != (block.n,):
        raise InputError(f"u and x0 have shapes {drift.shape} and {start.shape}, expected ({block.n},)")
    # the blocks' arrays are read-only, which would compile a second version
    Phi, Q, c, P0 = (np.array(a) for a in (block.Phi[None], block.Q[None], block.c, block.P0))
    return signal, Model(Phi, Q, c, np.array([block.white]), drift, start, P0)


def innovations(model: Model, which: NDArray[np.int64], y: Array) -> tuple[float, Array]:
    """Log-likelihood of a signal but for its squares, and the weighted squares of all columns.

    Parameters
    ----------
    model : Model
    which : (N,) array of int
        Kind of each step.
    y : (N, d) array
        The signal, and columns that the same filter takes.

    Returns
    -------
    float, (d, d) array
        ``-sum(log(2 pi S)) / 2`` (minus infinity where an innovation has no variance) and ``sum(e e' / S)``, lower triangle.
    """
    nothing, sums = np.empty((0, 0, 0)), np.zeros((y.shape[1],) * 2)
    value, _ = kalman(model, which, y, Filtered(np.empty((0, 0)), nothing, nothing), sums)
    return float(value), sums


def log_likelihood(
    block: StateBlock, y: ArrayLike, *, u: ArrayLike | None = None, x0: ArrayLike | None = None
) -> float:
    """Gaussian log-likelihood of a scalar signal.

    Parameters
    ----------
    block : StateBlock
        State space at the signal's interval; ``P0`` is the covariance of the state before the first sample.
    y : (N,) array
        Signal in its unit.
    u : (n,) array, optional
        Constant input per sample.
    x0 : (n,) array, optional
        Mean of the state before the first sample.

    Returns
    -------
    float
        Natural logarithm; minus infinity where an innovation would have no variance.

    Raises
    ------
    InputError
        Wrong shapes, values that are not finite.
    """
    signal, model = _prepared(block, y, u, x0)
    value, sums = innovations(model, np.zeros(signal.size, dtype=np.int64), signal[:, None])
    return value - 0.5 * float(sums[0, 0])


def smooth(block: StateBlock, y: ArrayLike, *, u: ArrayLike | None = None, x0: ArrayLike | None = None) -> Smoothed:
    """Smooth the states of a scalar signal; parameters as for :func:`log_likelihood`.

    Parameters
    ----------
    block : StateBlock
    y : (n,) array
        Signal.
    u : (states,) array, optional
        Known input of the states per sample.
    x0 : (states,) array, optional
        Mean of the initial state.

    Raises
    ------
    InputError
        As :func:`log_likelihood`; a block without states.
    """
    signal, model = _prepared(block, y, u, x0)
    n, N = block.n, signal.size
    if n == 0:
        raise InputError("a block without states has nothing to smooth")
    filtered = Filtered(np.empty((N, n)), np.empty((N, n, n)), np.empty((N, n, n)))
    square = np.zeros((1, 1))
    value, steady = kalman(model, np.zeros(N, dtype=np.int64), signal[:, None], filtered, square)
    out = Moments(np.empty((N, n)), np.empty((N, n)), *(np.zeros((n, n)) for _ in range(4)))
    smooth_sums(model, filtered, steady, out)
    return Smoothed(*out, float(value) - 0.5 * float(square[0, 0]))
