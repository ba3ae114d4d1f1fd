"""Compiled loops of the moment estimators: wavelet variances of unit processes and the separable least-squares problem.

The wavelet variance of a sum is linear in one coefficient per process (a variance) and nonlinear only in shapes (correlation times,
frequencies, polynomial coefficients). So the search runs over the shapes alone, and the coefficients follow by non-negative least squares,
which has no local minima (variable projection; Golub & Pereyra 1973, Kaufman 1975).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.noise.compiled import call, copy, multiply

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def columns(
    curves: Ints, orders: Ints, offsets: Ints, m: Array, s: Array, B: Array, dB: Array
) -> None:  # pragma: no cover - compiled
    """All columns, ``B`` (scales, processes) and ``dB`` (scales, shapes), by the functions at the addresses ``curves``.

    Parameters
    ----------
    curves, orders : (processes,) arrays of int
        Address of the wavelet variance of each process, and the whole number of its structure.
    offsets : (processes + 1,) array of int
        Where the shapes of each process begin and the last ones end.
    m : (J,) array
        Samples per average, half the scales.
    s : (shapes,) array
        Shapes, in the coordinates of the search.
    B : (J, processes) array
        Overwritten: wavelet variances of the processes with coefficient one.
    dB : (J, shapes) array
        Overwritten: derivatives of each process by its shapes.
    """
    b = np.empty(m.size)
    for k in range(curves.size):
        lo, hi = offsets[k], offsets[k + 1]
        db = np.zeros((m.size, hi - lo))
        call(curves[k], m, s[lo:hi], orders[k], b, db)
        for i in range(m.size):
            B[i, k] = b[i]
            for h in range(hi - lo):
                dB[i, lo + h] = db[i, h]


@njit(cache=True, nogil=True)
def _least_squares(A: Array, y: Array, use: Ints, count: int, x: Array, Q: Array) -> int:  # pragma: no cover - compiled
    """Least squares on the first ``count`` columns named in ``use`` by twice-iterated Gram-Schmidt; ``Q`` gets the basis.

    Columns that depend on earlier ones get zero. Returns the rank.
    """
    n = y.size
    R = np.zeros((count, count))
    for j in range(count):
        norm0 = 0.0
        for i in range(n):
            Q[i, j] = A[i, use[j]]
            norm0 += Q[i, j] * Q[i, j]
        for _ in range(2):
            for k in range(j):
                dot = 0.0
                for i in range(n):
                    dot += Q[i, k] * Q[i, j]
                R[k, j] += dot
                for i in range(n):
                    Q[i, j] -= dot * Q[i, k]
        norm = 0.0
        for i in range(n):
            norm += Q[i, j] * Q[i, j]
        if norm <= 1e-24 * norm0 or norm0 == 0.0:
            R[j, j] = 0.0
            for i in range(n):
                Q[i, j] = 0.0
        else:
            R[j, j] = math.sqrt(norm)
            for i in range(n):
                Q[i, j] /= R[j, j]
    rank = 0
    for j in range(count - 1, -1, -1):
        if R[j, j] == 0.0:
            x[j] = 0.0
            continue
        rank += 1
        dot = 0.0
        for i in range(n):
            dot += Q[i, j] * y[i]
        for k in range(j + 1, count):
            dot -= R[j, k] * x[k]
        x[j] = dot / R[j, j]
    return rank


@njit(cache=True, nogil=True)
def nonnegative(A: Array, y: Array, x: Array, r: Array, Q: Array) -> int:  # pragma: no cover - compiled
    """Non-negative least squares (Lawson & Hanson 1974): fills ``x`` and the residual ``r = y - A x``.

    Returns the number of active columns; ``Q[:, :active]`` spans them.

    Parameters
    ----------
    A : (n, p) array
        Columns.
    y : (n,) array
        Target.
    x, r : (p,), (n,) arrays
        Overwritten.
    Q : (n, p) array
        Overwritten: orthonormal basis of the active columns.
    """
    n, p = A.shape
    scale = np.empty(p)
    S = np.empty((n, p))
    for j in range(p):
        norm = 0.0
        for i in range(n):
            norm += A[i, j] * A[i, j]
        scale[j] = math.sqrt(norm) if norm > 0.0 else 1.0
        for i in range(n):
            S[i, j] = A[i, j] / scale[j]
    active = np.zeros(p, dtype=np.bool_)
    use = np.empty(p, dtype=np.int64)
    z = np.zeros(p)
    x[:] = 0.0
    size = 0.0
    for i in range(n):
        r[i] = y[i]
        size += y[i] * y[i]
    tolerance = 1e-13 * math.sqrt(size)
    count = 0
    refused = np.zeros(p, dtype=np.bool_)
    for _ in range(10 * p):
        best, at = tolerance, -1
        for j in range(p):
            if not active[j] and not refused[j]:
                g = 0.0
                for i in range(n):
                    g += S[i, j] * r[i]
                if g > best:
                    best, at = g, j
        if at < 0:
            break
        active[at] = True
        first = True
        while True:
            count = 0
            for j in range(p):
                if active[j]:
                    use[count] = j
                    count += 1
            _least_squares(S, y, use, count, z, Q)
            if first:
                for k in range(count):
                    if use[k] == at and z[k] <= 0.0:
                        refused[at] = True
            first = False
            lowest, alpha = 0.0, 2.0
            for k in range(count):
                if z[k] <= 0.0:
                    j = use[k]
                    step = x[j] / (x[j] - z[k]) if x[j] != z[k] else 0.0
                    if step < alpha:
                        alpha = step
                    lowest = -1.0
            if lowest == 0.0:
                for k in range(count):
                    x[use[k]] = z[k]
                break
            for k in range(count):
                j = use[k]
                x[j] += alpha * (z[k] - x[j])
                if x[j] <= 1e-15:
                    x[j] = 0.0
                    active[j] = False
        if not refused[at]:
            refused[:] = False
        for i in range(n):
            total = 0.0
            for j in range(p):
                total += S[i, j] * x[j]
            r[i] = y[i] - total
    count = 0
    for j in range(p):
        if x[j] > 0.0:
            use[count] = j
            count += 1
    _least_squares(S, y, use, count, z, Q)
    for j in range(p):
        x[j] /= scale[j]
    return count


class Separable(NamedTuple):
    """A weighted curve that is a sum of processes: linear in one coefficient of each, nonlinear in shapes.

    Parameters
    ----------
    curves, orders : (processes,) arrays of int
        Address of the wavelet variance of each process, and the whole number of its structure.
    offsets : (processes + 1,) array of int
        Where the shapes of each process begin and the last ones end.
    fixed : (processes,) array
        Held coefficients, negative where free.
    m : (J,) array
        Samples per average, half the scales.
    W : (rows, J) array
        Root of the weights.
    y : (rows,) array
        Weighted curve, ``W`` times the wavelet variances.
    """

    curves: Ints
    orders: Ints
    offsets: Ints
    fixed: Array
    m: Array
    W: Array
    y: Array


class _Projection(NamedTuple):
    """The best coefficients ``x`` of some shapes, weighted columns ``B`` and derivatives ``dB``, residual ``r``, basis ``Q``."""

    B: Array
    dB: Array
    x: Array
    r: Array
    Q: Array


@njit(cache=True, nogil=True)
def _room(p: Separable, shapes: int) -> _Projection:  # pragma: no cover - compiled
    n, processes = p.y.size, p.curves.size
    columns, slopes = np.empty((n, processes)), np.zeros((n, shapes))
    return _Projection(columns, slopes, np.zeros(processes), np.empty(n), np.empty((n, processes)))


@njit(cache=True, nogil=True)
def _project(p: Separable, s: Array, out: _Projection) -> tuple[float, int]:  # pragma: no cover - compiled
    """Fill ``out`` for shapes ``s``; returns the objective and the number of active columns."""
    curves, orders, offsets, fixed, m, W, y = p
    B, dB, x, r, Q = out
    raw = np.empty((m.size, curves.size))
    draw = np.zeros((m.size, s.size))
    columns(curves, orders, offsets, m, s, raw, draw)
    multiply(W, raw, B)
    multiply(W, draw, dB)
    free = 0
    for k in range(curves.size):
        if fixed[k] < 0.0:
            free += 1
    target = y.copy()
    A = np.empty((y.size, free))
    at = 0
    for k in range(curves.size):
        if fixed[k] < 0.0:
            for i in range(y.size):
                A[i, at] = B[i, k]
            at += 1
        else:
            for i in range(y.size):
                target[i] -= fixed[k] * B[i, k]
    part = np.zeros(free)
    count = nonnegative(A, target, part, r, Q)
    at = 0
    for k in range(curves.size):
        if fixed[k] < 0.0:
            x[k] = part[at]
            at += 1
        else:
            x[k] = fixed[k]
    total = 0.0
    for i in range(r.size):
        total += r[i] * r[i]
    return total, count


@njit(cache=True, nogil=True)
def screen(p: Separable, starts: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Objective of every start (rows of ``starts``) with its best coefficients.

    Parameters
    ----------
    p : Separable
    starts : (starts, shapes) array
        Shapes, one start a row.
    out : (starts,) array
        Overwritten.
    """
    room = _room(p, starts.shape[1])
    for i in range(starts.shape[0]):
        out[i] = _project(p, starts[i], room)[0]


@njit(cache=True, nogil=True)
def _solve(A: Array, b: Array) -> None:  # pragma: no cover - compiled
    """Solve a symmetric positive definite system in place by elimination."""
    n = b.size
    for k in range(n):
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]


@njit(cache=True, nogil=True)
def refine(
    p: Separable, s: Array, low: Array, high: Array, x: Array, most: int
) -> tuple[float, int]:  # pragma: no cover - compiled
    """Levenberg-Marquardt over the shapes with projected coefficients, in place from ``s``.

    ``low == high`` holds a shape fixed. Returns the objective and the number of iterations, negative where ``most`` did not suffice.

    Parameters
    ----------
    p : Separable
    s : (shapes,) array
        Start, overwritten by the minimum.
    low, high : (shapes,) arrays
        Bounds of the shapes.
    x : (processes,) array
        Overwritten: coefficients at the minimum, held ones included.
    most : int
        Largest number of iterations.
    """
    n, shapes, offsets = p.y.size, s.size, p.offsets
    here, there = _room(p, shapes), _room(p, shapes)
    dB, r, Q = here.dB, here.r, here.Q
    total, count = _project(p, s, here)
    x[:] = here.x
    if shapes == 0:
        return total, 0
    damping = 1e-2
    J, H, M = np.empty((n, shapes)), np.empty((shapes, shapes)), np.empty((shapes, shapes))
    g, step, trial = np.empty(shapes), np.empty(shapes), np.empty(shapes)
    quiet = 0
    for iteration in range(most):
        for k in range(x.size):
            for h in range(offsets[k], offsets[k + 1]):
                for i in range(n):
                    J[i, h] = x[k] * dB[i, h]
                # the coefficients follow: what they can explain is no reason to move
                for c in range(count):
                    dot = 0.0
                    for i in range(n):
                        dot += Q[i, c] * J[i, h]
                    for i in range(n):
                        J[i, h] -= dot * Q[i, c]
        for h in range(shapes):
            total_g = 0.0
            for i in range(n):
                total_g += J[i, h] * r[i]
            g[h] = total_g
            for k in range(shapes):
                total_h = 0.0
                for i in range(n):
                    total_h += J[i, h] * J[i, k]
                H[h, k] = total_h
        for h in range(shapes):
            if low[h] == high[h]:
                g[h] = 0.0
                for k in range(shapes):
                    H[h, k] = 0.0
                    H[k, h] = 0.0
        largest = 0.0
        for h in range(shapes):
            largest = max(largest, H[h, h])
        if largest == 0.0:
            return total, iteration
        better = False
        for _ in range(12):
            copy(H, M)
            for h in range(shapes):
                M[h, h] += damping * max(H[h, h], 1e-9 * largest) + 1e-300
                step[h] = g[h]
            _solve(M, step)
            for h in range(shapes):
                d = min(max(step[h], -1.5), 1.5)
                trial[h] = min(max(s[h] + d, low[h]), high[h])
            new, new_count = _project(p, trial, there)
            if new < total:
                better = True
                break
            damping = damping * 8.0
            if damping > 1e12:
                break
        if not better:
            return total, iteration
        gain = total - new
        moved = 0.0
        for h in range(shapes):
            moved = max(moved, abs(trial[h] - s[h]))
        for h in range(shapes):
            s[h] = trial[h]
        for k in range(x.size):
            x[k] = there.x[k]
        for i in range(n):
            r[i] = there.r[i]
        copy(there.dB, dB)
        copy(there.Q, Q)
        count = new_count
        total = new
        damping = max(damping * 0.15, 1e-9)
        quiet = quiet + 1 if gain <= 1e-13 * total + 1e-300 or moved < 1e-10 else 0
        if quiet >= 2:
            return total, iteration
    return total, -most
