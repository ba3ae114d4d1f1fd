"""Likelihood and smoothing of a scalar signal under a linear Gaussian state space with constant matrices.

``x_k = Phi x_(k-1) + u + w_k``, ``y_k = c x_k + v_k``; the state before the first sample has mean ``x0`` and covariance ``P0``. The
compiled loops stop updating covariances once they have settled, so that a long record costs little more than two products per state and
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

Array = NDArray[np.float64]

#: Covariances count as settled when no entry changes by more than this share of the largest.
SETTLED = 1e-12


class Model(NamedTuple):
    """A state space as compiled code takes it.

    Parameters
    ----------
    Phi, Q : (n, n) arrays
        Transition and driving covariance per sample.
    c : (n,) array
        What a sample sees of the state.
    R : float
        Variance of the sample's own white noise, unit^2.
    u : (n,) array
        Constant input per sample.
    x0, P0 : (n,), (n, n) arrays
        Mean and covariance of the state before the first sample.
    """

    Phi: Array
    Q: Array
    c: Array
    R: float
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
def kalman(model: Model, y: Array, out: Filtered, keep: bool) -> tuple[float, int]:  # pragma: no cover - compiled
    """Filter forwards; returns the log-likelihood and the index from which covariances are constant.

    Parameters
    ----------
    model : Model
    y : (N,) array
        Signal.
    out : Filtered
        Overwritten; without ``keep`` left alone, and of any size.
    keep : bool
    """
    Phi, Q, c, R, u, x0, P0 = model
    xf, Pf, Pp = out
    n = c.size
    x, xp = x0.copy(), np.empty(n)
    P, M, T, K = P0.copy(), np.empty((n, n)), np.empty((n, n)), np.empty(n)
    total = 0.0
    settled = y.size - 1
    constant = False
    S = 1.0
    logS = 0.0
    for k in range(y.size):
        for i in range(n):
            s = u[i]
            for j in range(n):
                s += Phi[i, j] * x[j]
            xp[i] = s
        if not constant:
            for i in range(n):
                for j in range(n):
                    s = 0.0
                    for h in range(n):
                        s += Phi[i, h] * P[h, j]
                    T[i, j] = s
            for i in range(n):
                for j in range(n):
                    s = Q[i, j]
                    for h in range(n):
                        s += T[i, h] * Phi[j, h]
                    M[i, j] = s
            S = R
            for i in range(n):
                s = 0.0
                for j in range(n):
                    s += 0.5 * (M[i, j] + M[j, i]) * c[j]
                K[i] = s
                S += c[i] * s
            if not S > 0.0:
                return -np.inf, 0
            logS = math.log(2.0 * math.pi * S)
            change, largest = 0.0, 0.0
            for i in range(n):
                for j in range(n):
                    new = 0.5 * (M[i, j] + M[j, i]) - K[i] * K[j] / S
                    change = max(change, abs(new - P[i, j]))
                    largest = max(largest, abs(new))
                    P[i, j] = new
            if keep:
                for i in range(n):
                    for j in range(n):
                        Pf[k, i, j] = P[i, j]
                        Pp[k, i, j] = 0.5 * (M[i, j] + M[j, i])
            if k > 2 and change <= SETTLED * largest:
                constant = True
                settled = k
        e = y[k]
        for i in range(n):
            e -= c[i] * xp[i]
        for i in range(n):
            x[i] = xp[i] + K[i] * e / S
        if keep:
            for i in range(n):
                xf[k, i] = x[i]
        total -= 0.5 * (logS + e * e / S)
    return total, settled


@njit(cache=True, nogil=True)
def smooth_sums(model: Model, filtered: Filtered, settled: int, out: Moments) -> None:  # pragma: no cover - compiled
    """Smooth backwards after :func:`kalman`; fills the smoothed means and the sums of second moments of the covariances.

    ``now`` = sum over t = 1..N-1 of P_t, ``cross`` of P_(t,t-1), ``before`` of P_(t-1); ``first`` = P_0; ``variance`` (N, n) the diagonals.

    Parameters
    ----------
    model : Model
    filtered : Filtered
    settled : int
        Index from which the covariances are constant, of :func:`kalman`.
    out : Moments
        Overwritten.
    """
    Phi, u, (xf, Pf, Pp) = model.Phi, model.u, filtered
    xs, Ps, now, cross, before, first = out
    N, n = xf.shape
    now[:, :] = 0.0
    cross[:, :] = 0.0
    before[:, :] = 0.0
    P = Pf[min(N - 1, settled)].copy()
    J, T, new = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    ready = -2
    steady = False
    for i in range(n):
        xs[N - 1, i] = xf[N - 1, i]
        Ps[N - 1, i] = P[i, i]
    step = np.empty(n)
    C, L, row = np.empty((n, n)), np.zeros((n, n)), np.empty(n)
    D, G = np.empty((n, n)), np.empty((n, n))
    for t in range(N - 1, 0, -1):
        at, nxt = min(t - 1, settled), min(t, settled)
        moved = nxt != ready
        if moved:
            # J = Pf Phi' Pp^-1 of the interval (t-1, t)
            for i in range(n):
                for j in range(n):
                    s = 0.0
                    for h in range(n):
                        s += Pf[at, i, h] * Phi[j, h]
                    T[i, j] = s
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
        if moved or not steady:
            for i in range(n):
                for j in range(n):
                    s = 0.0
                    for h in range(n):
                        s += P[i, h] * J[j, h]
                    C[i, j] = s  # cov(x_t, x_(t-1))
            for i in range(n):
                for j in range(n):
                    D[i, j] = P[i, j] - Pp[nxt, i, j]
            for i in range(n):
                for j in range(n):
                    s = 0.0
                    for h in range(n):
                        s += D[i, h] * J[j, h]
                    G[i, j] = s
            change, largest = 0.0, 0.0
            for i in range(n):
                for j in range(n):
                    s = Pf[at, i, j]
                    for h in range(n):
                        s += J[i, h] * G[h, j]
                    new[i, j] = s
                    change = max(change, abs(s - P[i, j]))
                    largest = max(largest, abs(s))
            steady = change <= SETTLED * largest
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
    first[:, :] = P


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
    return signal, Model(_c(block.Phi), _c(block.Q), _c(block.c), block.white, drift, start, _c(block.P0))


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
    if block.n == 0:
        if block.white <= 0:
            return -math.inf
        return float(-0.5 * (signal.size * math.log(2.0 * math.pi * block.white) + signal @ signal / block.white))
    nothing = np.empty((1, 1, 1))
    value, _ = kalman(model, signal, Filtered(nothing[0], nothing, nothing), False)
    return float(value)


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
    value, settled = kalman(model, signal, filtered, True)
    out = Moments(np.empty((N, n)), np.empty((N, n)), *(np.zeros((n, n)) for _ in range(4)))
    smooth_sums(model, filtered, settled, out)
    return Smoothed(*out, float(value))


def _c(a: Array) -> Array:
    return np.array(
        a, dtype=np.float64, order="C"
    )  # the blocks' arrays are read-only, which would compile a second version
