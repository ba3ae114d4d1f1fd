"""Compiled loops of the moment estimators: wavelet variances of unit processes and the separable least-squares problem.

The wavelet variance of a sum is linear in one coefficient per process (a variance) and nonlinear only in shapes (correlation times,
frequencies, polynomial coefficients). So the search runs over the shapes alone, and the coefficients follow by non-negative least squares,
which has no local minima (variable projection; Golub & Pereyra 1973, Kaufman 1975).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# kinds of processes, in the kernel's numbering
WN, QN, RW, DR, BI, GM, AR1, SIN, ARMA = range(9)


@njit(cache=True, nogil=True)
def first_order(m: Array, a: float, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance at averages of ``m`` samples of a unit-variance process with correlation exp(-a), and its derivative by log a.

    With u = m a it is (f(u) + 2 m (sinh a - a)) / (8 m^2 sinh^2(a / 2)), f(u) = 2 u - 3 + 4 exp(-u) - exp(-2 u), f' = 2 (1 - exp(-u))^2.
    """
    if a > 30.0:
        a = 30.0
    sh = math.sinh(0.5 * a)
    excess = a * a * a * (1.0 / 6.0 + a * a * (1.0 / 120.0 + a * a / 5040.0)) if a < 0.02 else math.sinh(a) - a
    slope_excess = 2.0 * sh * sh  # cosh a - 1
    ratio = a * math.cosh(0.5 * a) / sh
    for i in range(m.size):
        u = m[i] * a
        if u < 0.3:
            # sum_k (-u)^k (4 - 2^k) / k! from k = 3
            term = -u * u * u / 6.0
            two = 8.0
            f = term * (4.0 - two)
            for k in range(4, 20):
                term *= -u / k
                two *= 2.0
                f += term * (4.0 - two)
        else:
            f = 2.0 * u + 4.0 * math.expm1(-u) - math.expm1(-2.0 * u)
        e = math.expm1(-u)
        d = 8.0 * m[i] * m[i] * sh * sh
        top = f + 2.0 * m[i] * excess
        b[i] = top / d
        db[i] = (2.0 * u * e * e + 2.0 * m[i] * a * slope_excess) / d - b[i] * ratio


@njit(cache=True, nogil=True)
def _autoregressive_one(m: Array, z: float, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """The same for an AR(1) with coefficient tanh(z), and its derivative by z."""
    phi = math.tanh(z)
    if phi > 0.5:
        a = math.log1p(2.0 / math.expm1(2.0 * z))  # -log tanh z
        first_order(m, a, b, db)
        chain = -(1.0 - phi * phi) / (phi * a)  # d log a / d z
        if z > 8.0:
            chain = -2.0  # a = 2 exp(-2 z)
        for i in range(m.size):
            db[i] *= chain
        return
    for i in range(m.size):
        k = m[i]
        power = phi**k
        top = k * (1.0 - phi * phi) - phi * (3.0 - 4.0 * power + power * power)
        dtop = -2.0 * k * phi - 3.0 + 4.0 * (k + 1.0) * power - (2.0 * k + 1.0) * power * power
        low = 2.0 * (k * (1.0 - phi)) ** 2
        b[i] = top / low
        db[i] = (dtop / low + 2.0 * b[i] / (1.0 - phi)) * (1.0 - phi * phi)


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
def _multiply(A: Array, B: Array, out: Array) -> None:  # pragma: no cover - compiled
    """``out = A B`` by loops: the matrices are small, and calling a library costs seconds of compilation."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@njit(cache=True, nogil=True)
def _copy(A: Array, out: Array) -> None:  # pragma: no cover - compiled
    """``out = A``."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j]


@njit(cache=True, nogil=True)
def _arma(m: Array, z: Array, p: int, b: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance of an ARMA with unit innovations by exact doubling; ``m`` are powers of two, ascending."""
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
    _copy(phi, A)
    for _ in range(60):
        # P + A P A'
        _multiply(A, P, one)
        change, largest = 0.0, 0.0
        for i in range(n):
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += one[i, k] * A[j, k]
                two[i, j] = total
        for i in range(n):
            for j in range(n):
                P[i, j] += two[i, j]
                change = max(change, abs(two[i, j]))
                largest = max(largest, abs(P[i, j]))
        _multiply(A, A, one)
        _copy(one, A)
        if change <= 1e-16 * largest:
            break
    _copy(phi, power)
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
        _multiply(power, T, one)
        for i in range(n):
            for j in range(n):
                T[i, j] += one[i, j]
        _multiply(power, power, one)
        _copy(one, power)
        count *= 2.0


@njit(cache=True, nogil=True)
def column(kind: int, p: int, m: Array, s: Array, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """Wavelet variance ``b`` of a unit process of this kind and shape ``s``; ``db[:, i]`` its derivative by ``s[i]``."""
    if kind == GM or kind == AR1:
        d = np.empty(m.size)
        if kind == GM:
            first_order(m, math.exp(s[0]), b, d)
        else:
            _autoregressive_one(m, s[0], b, d)
        for i in range(m.size):
            db[i, 0] = d[i]
        return
    if kind == ARMA:
        _arma(m, s, p, b)
        other = np.empty(m.size)
        for k in range(s.size):
            near = s.copy()
            h = 1e-5
            near[k] += h
            _arma(m, near, p, other)
            for i in range(m.size):
                db[i, k] = other[i]
            near[k] -= 2.0 * h
            _arma(m, near, p, other)
            for i in range(m.size):
                db[i, k] = (db[i, k] - other[i]) / (2.0 * h)
        return
    for i in range(m.size):
        k = m[i]
        if kind == WN:
            b[i] = 0.5 / k
        elif kind == QN:
            b[i] = 1.5 / (k * k)
        elif kind == RW:
            b[i] = (2.0 * k * k + 1.0) / (12.0 * k)
        elif kind == DR:
            b[i] = 0.25 * k * k
        elif kind == BI:
            b[i] = math.log(2.0) / math.pi
        else:  # SIN: s is the logistic of 2 f dt
            x = 0.5 * math.pi / (1.0 + math.exp(-s[0]))
            dx = x * (1.0 - 2.0 * x / math.pi)
            sine, top = math.sin(x), math.sin(k * x)
            amplitude = top * top / (k * sine)
            b[i] = 0.5 * amplitude * amplitude
            da = 2.0 * top * math.cos(k * x) / sine - amplitude * math.cos(x) / sine
            db[i, 0] = amplitude * da * dx


@njit(cache=True, nogil=True)
def columns(
    kinds: Ints, orders: Ints, offsets: Ints, m: Array, s: Array, B: Array, dB: Array
) -> None:  # pragma: no cover - compiled
    """All columns: ``B`` (scales, processes), ``dB`` (scales, shapes)."""
    b = np.empty(m.size)
    for k in range(kinds.size):
        lo, hi = offsets[k], offsets[k + 1]
        db = np.zeros((m.size, hi - lo))
        column(kinds[k], orders[k], m, s[lo:hi], b, db)
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


@njit(cache=True, nogil=True)
def _project(
    kinds: Ints, orders: Ints, offsets: Ints, m: Array, s: Array, W: Array, y: Array, fixed: Array,
    B: Array, dB: Array, x: Array, r: Array, Q: Array,
) -> tuple[float, int]:  # pragma: no cover - compiled  # fmt: skip
    """Best coefficients for shapes ``s``: weighted columns into ``B``, ``dB``; returns the objective and the number of active columns."""
    raw = np.empty((m.size, kinds.size))
    draw = np.zeros((m.size, s.size))
    columns(kinds, orders, offsets, m, s, raw, draw)
    _multiply(W, raw, B)
    _multiply(W, draw, dB)
    free = 0
    for k in range(kinds.size):
        if fixed[k] < 0.0:
            free += 1
    target = y.copy()
    A = np.empty((y.size, free))
    at = 0
    for k in range(kinds.size):
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
    for k in range(kinds.size):
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
def screen(
    kinds: Ints, orders: Ints, offsets: Ints, m: Array, starts: Array, W: Array, y: Array, fixed: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Objective of every start (rows of ``starts``) with its best coefficients."""
    n = y.size
    B, dB = np.empty((n, kinds.size)), np.zeros((n, starts.shape[1]))
    x, r, Q = np.zeros(kinds.size), np.empty(n), np.empty((n, kinds.size))
    for i in range(starts.shape[0]):
        out[i] = _project(kinds, orders, offsets, m, starts[i], W, y, fixed, B, dB, x, r, Q)[0]


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
    kinds: Ints, orders: Ints, offsets: Ints, m: Array, s: Array, low: Array, high: Array, W: Array, y: Array, fixed: Array,
    x: Array, most: int,
) -> tuple[float, int]:  # pragma: no cover - compiled  # fmt: skip
    """Levenberg-Marquardt over the shapes with projected coefficients, in place from ``s``.

    ``low == high`` holds a shape fixed. Returns the objective and the number of iterations, negative where ``most`` did not suffice.
    """
    n, shapes = y.size, s.size
    B, dB = np.empty((n, kinds.size)), np.zeros((n, shapes))
    r, Q = np.empty(n), np.empty((n, kinds.size))
    total, count = _project(kinds, orders, offsets, m, s, W, y, fixed, B, dB, x, r, Q)
    if shapes == 0:
        return total, 0
    damping = 1e-2
    trial_x, trial_r = np.zeros(kinds.size), np.empty(n)
    trial_B, trial_dB, trial_Q = np.empty((n, kinds.size)), np.zeros((n, shapes)), np.empty((n, kinds.size))
    J, H, M = np.empty((n, shapes)), np.empty((shapes, shapes)), np.empty((shapes, shapes))
    g, step, trial = np.empty(shapes), np.empty(shapes), np.empty(shapes)
    quiet = 0
    for iteration in range(most):
        for k in range(kinds.size):
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
            _copy(H, M)
            for h in range(shapes):
                M[h, h] += damping * max(H[h, h], 1e-9 * largest) + 1e-300
                step[h] = g[h]
            _solve(M, step)
            for h in range(shapes):
                d = min(max(step[h], -1.5), 1.5)
                trial[h] = min(max(s[h] + d, low[h]), high[h])
            new, new_count = _project(
                kinds, orders, offsets, m, trial, W, y, fixed, trial_B, trial_dB, trial_x, trial_r, trial_Q
            )
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
        for k in range(kinds.size):
            x[k] = trial_x[k]
        for i in range(n):
            r[i] = trial_r[i]
        _copy(trial_B, B)
        _copy(trial_dB, dB)
        _copy(trial_Q, Q)
        count = new_count
        total = new
        damping = max(damping * 0.15, 1e-9)
        quiet = quiet + 1 if gain <= 1e-13 * total + 1e-300 or moved < 1e-10 else 0
        if quiet >= 2:
            return total, iteration
    return total, -most
