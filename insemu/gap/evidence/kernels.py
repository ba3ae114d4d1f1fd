"""Compiled loops of the room: Toeplitz whitening and the two-level switching likelihood, as scalar code over plain arrays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def toeplitz_whiten(gamma: Array, columns: Array, out: Array) -> float:  # pragma: no cover - compiled
    """Whiten the columns of a stationary Gaussian vector by the Durbin-Levinson recursion.

    Row k of ``out`` is the one-step prediction error over its standard deviation, so that ``out' out`` is ``columns' C^-1 columns``.

    Parameters
    ----------
    gamma : (n,) array
        Autocovariance at lags 0 to n - 1.
    columns : (n, k) array
        Data and regressors.
    out : (n, k) array
        Written to.

    Returns
    -------
    float
        ``log det C``, or NaN where the autocovariance is not positive definite.
    """
    n, k = columns.shape
    phi = np.zeros(n)
    other = np.zeros(n)
    # reversed and contiguous, so that both inner products run forwards over memory
    back = gamma[::-1].copy()
    past = np.zeros((k, n))
    v = gamma[0]
    logdet = 0.0
    for t in range(n):
        if t > 0:
            r = gamma[t]
            first = n - t
            for j in range(t - 1):
                r -= phi[j] * back[first + j]
            kappa = r / v
            for j in range(t - 1):
                other[j] = phi[j] - kappa * phi[t - 2 - j]
            for j in range(t - 1):
                phi[j] = other[j]
            phi[t - 1] = kappa
            v *= (1.0 - kappa) * (1.0 + kappa)
        if not v > 0.0:
            return math.nan
        logdet += math.log(v)
        s = 1.0 / math.sqrt(v)
        for c in range(k):
            e = columns[t, c]
            for j in range(t):
                e -= phi[j] * past[c, n - t + j]
            out[t, c] = e * s
            past[c, n - 1 - t] = columns[t, c]
    return logdet


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def toeplitz_solve(
    gamma: Array, columns: Array, solved: Array, diagonals: Array
) -> float:  # pragma: no cover - compiled
    """Solve a stationary covariance for some columns, and sum the diagonals of its inverse.

    The Durbin-Levinson recursion builds ``C^-1 columns`` and the first column ``x`` of the inverse, whose diagonals sum to
    ``s_k = sum_i (n - k - 2 i) x_i x_(i+k) / x_0`` (Gohberg and Semencul 1972).

    Parameters
    ----------
    gamma : (n,) array
        Autocovariance at lags 0 to n - 1.
    columns, solved : (k, n) arrays
        Data and regressors, one a row; what is written.
    diagonals : (n,) array
        Written to: sum of the k-th diagonal of the inverse.

    Returns
    -------
    float
        ``log det C``, or NaN where the autocovariance is not positive definite.
    """
    m, n = columns.shape
    phi, other = np.zeros(n), np.zeros(n)
    back, past = gamma[::-1].copy(), columns[:, ::-1].copy()
    solved[:] = 0.0
    v, logdet = gamma[0], 0.0
    for t in range(n):
        if t > 0:
            r = gamma[t]
            first = n - t
            for j in range(t - 1):
                r -= phi[j] * back[first + j]
            kappa = r / v
            for j in range(t - 1):
                other[j] = phi[j] - kappa * phi[t - 2 - j]
            for j in range(t - 1):
                phi[j] = other[j]
            phi[t - 1] = kappa
            v *= (1.0 - kappa) * (1.0 + kappa)
        if not v > 0.0:
            return math.nan
        logdet += math.log(v)
        before = n - t
        for c in range(m):
            e = columns[c, t]
            for j in range(t):
                e -= phi[j] * past[c, before + j]
            w = e / v
            solved[c, t] += w
            for j in range(t):
                solved[c, t - 1 - j] -= phi[j] * w
    x = np.empty(n)
    x[0] = 1.0 / v
    for j in range(n - 1):
        x[1 + j] = -phi[j] / v
    for k in range(n):
        total = 0.0
        for i in range(n - k):
            total += (n - k - 2.0 * i) * x[i] * x[i + k]
        diagonals[k] = total * v
    return logdet


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def lagged_products(rows: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Sums of products at every lag, over all rows.

    Parameters
    ----------
    rows : (k, n) array
    out : (n,) array
        Written to.
    """
    m, n = rows.shape
    for k in range(n):
        total = 0.0
        for c in range(m):
            for i in range(n - k):
                total += rows[c, i] * rows[c, i + k]
        out[k] = total


@njit(cache=True, nogil=True)
def switching_log_likelihood(
    y: Array, white: float, phi: float, q: float, p0: float, amplitude: float, stay: float, path: Array
) -> float:  # pragma: no cover - compiled
    """Log-likelihood of ``y_k = b_k + a s_k + white noise``, ``b`` a first-order Gaussian background, ``s = +-1`` switching at random.

    Two-mode filter with moment matching (generalised pseudo-Bayes of first order): exact where the background is constant or the
    amplitude is zero.

    Parameters
    ----------
    y : (n,) array
        Block means.
    white, phi, q, p0 : float
        Variance of a block mean's white noise; transition, driving variance and initial variance of the background.
    amplitude, stay : float
        Half the distance of the two levels; probability of staying for one block.
    path : (n,) array
        Written to: probability of the upper level.
    """
    n = y.size
    total = 0.0
    m0, m1, v0, v1, w0 = 0.0, 0.0, p0, p0, 0.5
    for k in range(n):
        # mixing of the two hypotheses over a possible switch
        u0 = stay * w0 + (1.0 - stay) * (1.0 - w0)
        a = stay * w0 / u0
        b = stay * (1.0 - w0) / (1.0 - u0)
        x0 = a * m0 + (1.0 - a) * m1
        x1 = b * m1 + (1.0 - b) * m0
        s0 = a * (v0 + (m0 - x0) ** 2) + (1.0 - a) * (v1 + (m1 - x0) ** 2)
        s1 = b * (v1 + (m1 - x1) ** 2) + (1.0 - b) * (v0 + (m0 - x1) ** 2)
        if k > 0:
            x0 *= phi
            x1 *= phi
            s0 = phi * phi * s0 + q
            s1 = phi * phi * s1 + q
        e0 = y[k] - x0 + amplitude
        e1 = y[k] - x1 - amplitude
        d0 = s0 + white
        d1 = s1 + white
        l0 = -0.5 * (math.log(d0) + e0 * e0 / d0) + math.log(max(u0, 1e-300))
        l1 = -0.5 * (math.log(d1) + e1 * e1 / d1) + math.log(max(1.0 - u0, 1e-300))
        top = max(l0, l1)
        sum_ = math.exp(l0 - top) + math.exp(l1 - top)
        total += top + math.log(sum_) - 0.9189385332046727
        w0 = min(max(math.exp(l0 - top) / sum_, 1e-12), 1.0 - 1e-12)
        m0 = x0 + s0 / d0 * e0
        m1 = x1 + s1 / d1 * e1
        v0 = s0 * white / d0
        v1 = s1 * white / d1
        path[k] = 1.0 - w0
    return total


@njit(cache=True, nogil=True)
def gauss_markov_log_likelihood(
    y: Array, white: float, phi: float, q: float, p0: float, amplitude: float, stay: float
) -> float:  # pragma: no cover - compiled
    """Log-likelihood of the Gaussian process of the second moments that :func:`switching_log_likelihood` assumes (two-state Kalman filter).

    Parameters
    ----------
    y, white, phi, q, p0 : as there
    amplitude, stay : float
        Standard deviation of the Gauss-Markov part; its correlation over one block is ``2 stay - 1``.
    """
    r = 2.0 * stay - 1.0
    g = amplitude * amplitude
    drive = g * (1.0 - r * r)
    b, x = 0.0, 0.0
    pbb, pbx, pxx = p0, 0.0, g
    total = 0.0
    for k in range(y.size):
        if k > 0:
            b *= phi
            x *= r
            pbb = phi * phi * pbb + q
            pbx = phi * r * pbx
            pxx = r * r * pxx + drive
        e = y[k] - b - x
        kb, kx = pbb + pbx, pbx + pxx
        d = kb + kx + white
        total += -0.5 * (math.log(d) + e * e / d) - 0.9189385332046727
        b += kb / d * e
        x += kx / d * e
        pbb -= kb * kb / d
        pbx -= kb * kx / d
        pxx -= kx * kx / d
    return total


@njit(cache=True, nogil=True)
def integrate_inputs(
    t: Array,
    C: Array,
    f_n: Array,
    node: NDArray[np.int64],
    u: Array,
    axis: NDArray[np.int64],
    column: NDArray[np.int64],
    D: Array,
    ramp: Array,
) -> None:  # pragma: no cover - compiled
    """Navigation errors that unit sensor errors build up between nodes.

    Within an interval the errors start at zero and grow by ``v' = C df - [f_n x] phi``, ``phi' = C dw``, ``p' = v``; what the rotation of
    the Earth adds over an interval of seconds is below a part in a thousand and belongs to the transition from node to node.

    Parameters
    ----------
    t : (n,) array
        IMU times; row k describes the interval that ends there.
    C : (n, 3, 3), f_n : (n, 3) arrays
        Attitude and specific force in NED for each interval.
    node : (k,) array of int
        IMU rows of the nodes, increasing.
    u : (e, n) array
        Unit sensor errors, rad/s or m/s^2.
    axis, column : (e,) arrays of int
        Axis 0..5 of each entry, and the column of ``D`` that it belongs to.
    D : (k, columns, 9) array
        Written to: what has built up at each node since the one before.
    ramp : (k, 12, 9) array
        Written to: the same for a constant (0..5) and for a ramp from 0 to 1 across the interval (6..11) on each axis.
    """
    entries = axis.size
    columns = D.shape[1]
    total = columns + 12
    e = np.zeros((total, 9))
    add = np.zeros((total, 6))
    for i in range(1, node.size):
        a, b = node[i - 1], node[i]
        e[:, :] = 0.0
        span = t[b] - t[a]
        for k in range(a + 1, b + 1):
            dt = t[k] - t[k - 1]
            add[:, :] = 0.0
            for m in range(entries):
                x = u[m, k] * dt
                if x != 0.0:
                    c, j = column[m], axis[m]
                    if j < 3:
                        for r in range(3):
                            add[c, 3 + r] += C[k, r, j] * x
                    else:
                        for r in range(3):
                            add[c, r] += C[k, r, j - 3] * x
            part = (0.5 * (t[k] + t[k - 1]) - t[a]) / span
            for j in range(3):
                for r in range(3):
                    x = C[k, r, j] * dt
                    add[columns + j, 3 + r] = x
                    add[columns + 3 + j, r] = x
                    add[columns + 6 + j, 3 + r] = x * part
                    add[columns + 9 + j, r] = x * part
            fx, fy, fz = f_n[k, 0], f_n[k, 1], f_n[k, 2]
            for c in range(total):
                px = e[c, 6] + 0.5 * add[c, 3]
                py = e[c, 7] + 0.5 * add[c, 4]
                pz = e[c, 8] + 0.5 * add[c, 5]
                vx = add[c, 0] - (fy * pz - fz * py) * dt
                vy = add[c, 1] - (fz * px - fx * pz) * dt
                vz = add[c, 2] - (fx * py - fy * px) * dt
                e[c, 0] += (e[c, 3] + 0.5 * vx) * dt
                e[c, 1] += (e[c, 4] + 0.5 * vy) * dt
                e[c, 2] += (e[c, 5] + 0.5 * vz) * dt
                e[c, 3] += vx
                e[c, 4] += vy
                e[c, 5] += vz
                e[c, 6] += add[c, 3]
                e[c, 7] += add[c, 4]
                e[c, 8] += add[c, 5]
        for c in range(columns):
            for r in range(9):
                D[i, c, r] = e[c, r]
        for c in range(12):
            for r in range(9):
                ramp[i, c, r] = e[columns + c, r]


@njit(cache=True, nogil=True, fastmath={"contract"})
def respond(
    Phi: Array,
    K: Array,
    H: Array,
    node: NDArray[np.int64],
    use: NDArray[np.bool_],
    D: Array,
    M: Array,
    out: Array,
) -> None:  # pragma: no cover - compiled
    """Innovations that navigation errors and errors of the fixes cause in a filter in the loop.

    ``e- = Phi e+ + D``, ``g = M - H e-``, ``e+ = e- + K g``. Transitions and Jacobians are mostly zeros, which are passed over.

    Parameters
    ----------
    Phi : (nodes, n, n) array
        Transition to each node from the one before.
    K, H : (f, n, 6), (f, 6, n) arrays
        Zero where a component was not used.
    node : (f,) array of int
        Node of each fix, not decreasing.
    use : (f, 6) array of bool
    D : (nodes, columns, 9) array
        Navigation errors built up since the node before; without rows where there are none.
    M : (f, 6, columns) array
        Errors of the fixes; without rows where there are none.
    out : (f, 6, columns) array of zeros
        Written to.
    """
    n, cols = Phi.shape[1], out.shape[2]
    e = np.zeros((n, cols))
    ahead = np.zeros((n, cols))
    k = 0
    for i in range(Phi.shape[0]):
        if i > 0:
            for r in range(n):
                for c in range(cols):
                    ahead[r, c] = 0.0
                for q in range(n):
                    w = Phi[i, r, q]
                    if w != 0.0:
                        for c in range(cols):
                            ahead[r, c] += w * e[q, c]
            e, ahead = ahead, e
            if D.shape[0] > 0:
                for c in range(cols):
                    for r in range(9):
                        e[r, c] += D[i, c, r]
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


@njit(cache=True, nogil=True)
def recursive_residuals(
    y: Array, U: Array, variance: float, out: Array, logs: Array
) -> None:  # pragma: no cover - compiled
    """One-step predictive residuals of ``y = U z + noise``, z standard normal, by recursive least squares.

    Parameters
    ----------
    y : (r,) array
    U : (r, k) array
    variance : float
        Of the noise.
    out : (r,) array
        Written to: residuals over their standard deviations, which are one where nothing is uncertain and ``variance`` is one.
    logs : (r,) array
        Written to: logarithm of each standard deviation.
    """
    r, k = U.shape
    P = np.eye(k)
    z = np.zeros(k)
    g = np.zeros(k)
    for i in range(r):
        s = variance
        e = y[i]
        for a in range(k):
            total = 0.0
            for b in range(k):
                total += P[a, b] * U[i, b]
            g[a] = total
        for a in range(k):
            s += U[i, a] * g[a]
            e -= U[i, a] * z[a]
        for a in range(k):
            z[a] += g[a] * e / s
            w = g[a] / s
            for b in range(k):
                P[a, b] -= w * g[b]
        out[i] = e / math.sqrt(s)
        logs[i] = 0.5 * math.log(s)


@njit(cache=True, nogil=True, fastmath={"contract"})
def surrogate_filter(
    Phi: Array,
    Q: Array,
    K: Array,
    H: Array,
    R: Array,
    P0: Array,
    nu: Array,
    use: NDArray[np.int64],
    factor: Array,
    phi_g: Array,
    q_g: Array,
    p_g: Array,
    white: Array,
) -> float:  # pragma: no cover - compiled
    """Log-likelihood of stored innovations when the true noise is other than the filter believed, and the innovations whitened for it.

    The error of the nominal filter obeys ``e- = Phi e+ + w``, ``nu = -H e- + g + v``, ``e+ = e- + K nu`` with the known input ``K nu``; a Kalman
    filter on e (and on a Gauss-Markov part g of the fixes) sees the innovations as its measurements. Everything is linear in the stored
    innovations, so responses of effects go through the same filter.

    Parameters
    ----------
    Phi, Q : (f, n, n) arrays
        Transition and driving covariance to each fix.
    K, H, R : (f, n, 6), (f, 6, n), (f, 6) arrays
        Nominal gain (zero where the fix was not used), Jacobian, believed variances.
    P0 : (n, n) array
    nu : (f, 6, c) array
        Innovations, and any number of responses beside them.
    use : (f, 6) array of int
        1 where a component was measured.
    factor : (6,) array
        Ratio of the true to the believed standard deviation of each component.
    phi_g, q_g, p_g : (f, 6), (f, 6), (6,) arrays
        Transition and driving variance of g to each fix, its initial variance; a zero in ``p_g``: no such part.
    white : (f, 6, c) array
        Written to: whitened columns, zero where missing.

    Returns
    -------
    float
        Of the first column, without the constant; NaN where a variance is not positive.
    """
    n = P0.shape[0]
    f, _, cols = nu.shape
    which = np.zeros(6, dtype=np.int64)
    extra = 0
    for i in range(6):
        if p_g[i] > 0.0:
            which[extra] = i
            extra += 1
    m = n + extra
    P = np.zeros((m, m))
    P[:n, :n] = P0
    for j in range(extra):
        P[n + j, n + j] = p_g[which[j]]
    x = np.zeros((m, cols))
    ahead = np.zeros((n, cols))
    T = np.zeros((m, n))
    g = np.zeros(m)
    at = np.zeros(m, dtype=np.int64)
    a = np.zeros(m)
    total = 0.0
    for k in range(f):
        F = Phi[k]
        # P = F P F' + Q, block by block: transitions and Jacobians are mostly zeros, so both products go by rows of what is not
        for j in range(m):
            for i in range(n):
                T[j, i] = 0.0
        for i in range(n):
            for q in range(n):
                w = F[i, q]
                if w != 0.0:
                    for j in range(m):
                        T[j, i] += w * P[q, j]
        for i in range(n):
            for j in range(i + 1):
                P[i, j] = Q[k, i, j]
            for q in range(n):
                w = F[i, q]
                if w != 0.0:
                    for j in range(i + 1):
                        P[i, j] += w * T[q, j]
            for j in range(i):
                P[j, i] = P[i, j]
            for j in range(extra):
                v = T[n + j, i] * phi_g[k, which[j]]
                P[i, n + j] = v
                P[n + j, i] = v
        for i in range(extra):
            for j in range(extra):
                P[n + i, n + j] *= phi_g[k, which[i]] * phi_g[k, which[j]]
            P[n + i, n + i] += q_g[k, which[i]]
        for i in range(n):
            for c in range(cols):
                ahead[i, c] = 0.0
            for q in range(n):
                w = F[i, q]
                if w != 0.0:
                    for c in range(cols):
                        ahead[i, c] += w * x[q, c]
        x[:n] = ahead
        for j in range(extra):
            for c in range(cols):
                x[n + j, c] *= phi_g[k, which[j]]
        for i in range(6):
            if use[k, i] == 0:
                continue
            seen = 0
            for j in range(n):
                if H[k, i, j] != 0.0:
                    at[seen], a[seen] = j, -H[k, i, j]
                    seen += 1
            for j in range(extra):
                if which[j] == i:
                    at[seen], a[seen] = n + j, 1.0
                    seen += 1
            g[:] = 0.0
            for r in range(seen):
                w = a[r]
                for q in range(m):
                    g[q] += w * P[at[r], q]
            s = R[k, i] * factor[i] ** 2
            for r in range(seen):
                s += a[r] * g[at[r]]
            if not s > 0.0:
                return math.nan
            root = math.sqrt(s)
            for c in range(cols):
                e = nu[k, i, c]
                for r in range(seen):
                    e -= a[r] * x[at[r], c]
                white[k, i, c] = e / root
            for j in range(m):
                w = g[j] / root
                for c in range(cols):
                    x[j, c] += w * white[k, i, c]
            total -= math.log(root) + 0.5 * white[k, i, 0] ** 2
            for j in range(m):
                w = g[j] / s
                for q in range(m):
                    P[j, q] -= w * g[q]
        for i in range(6):
            if use[k, i] == 1:
                for j in range(n):
                    w = K[k, j, i]
                    if w != 0.0:
                        for c in range(cols):
                            x[j, c] += w * nu[k, i, c]
    return total
