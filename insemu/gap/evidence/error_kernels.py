"""Compiled loops over the error of the nominal filter: how it builds up, how the filter answers it, what its innovations are worth."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from insemu.gap.evidence.lanes import LANES, add, div, load, mul, spread, store, sub

Array = NDArray[np.float64]


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
    ramp : (k, 12, 9) or (k, 0, 9) array
        Written to: the same for a constant (0..5) and for a ramp from 0 to 1 across the interval (6..11) on each axis; nothing without rows.
    """
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
def _moved(Phi: Array, e: Array, cols: int, out: Array) -> None:  # pragma: no cover - compiled
    """``out = Phi e`` of the first ``cols`` columns: transitions are mostly zeros, which are passed over."""
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
    Phi: Array,
    K: Array,
    H: Array,
    node: NDArray[np.int64],
    use: NDArray[np.bool_],
    D: Array,
    at: NDArray[np.int64],
    M: Array,
    begin: NDArray[np.int64],
    out: Array,
) -> None:  # pragma: no cover - compiled
    """Innovations that navigation errors and errors of the fixes cause in a filter in the loop.

    ``e- = Phi e+ + D``, ``g = M - H e-``, ``e+ = e- + K g``; the first ``D`` is the error of the start. Transitions and Jacobians are mostly
    zeros, which are passed over, and so are columns that have not begun.

    Parameters
    ----------
    Phi : (nodes, n, n) array
        Transition to each node from the one before.
    K, H : (f, n, 6), (f, 6, n) arrays
        Zero where a component was not used.
    node : (f,) array of int
        Node of each fix, not decreasing.
    use : (f, 6) array of bool
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
    n, every = Phi.shape[1], out.shape[2]
    e = np.zeros((n, every))
    ahead = np.zeros((n, every))
    k, cols = 0, 0
    for i in range(Phi.shape[0]):
        while cols < every and begin[cols] <= i:
            cols += 1
        if i > 0:
            _moved(Phi[i], e, cols, ahead)
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


@njit(cache=True, nogil=True, fastmath={"contract"})
def surrogate_gains(
    Phi: Array,
    Q: Array,
    H: Array,
    R: Array,
    P0: Array,
    first: Array,
    use: NDArray[np.int64],
    factor: Array,
    phi_g: Array,
    q_g: Array,
    p_g: Array,
    gain: Array,
    root: Array,
    S: Array,
) -> int:  # pragma: no cover - compiled
    """What a Kalman filter on the error of the nominal filter does with its innovations when the true noise is other than that filter believed.

    The error obeys ``e- = Phi e+ + w``, ``nu = -H e- + g + v``, ``e+ = e- + K nu`` with the known input ``K nu``; a Kalman filter on e (and on a
    Gauss-Markov part g of the fixes) sees the innovations as its measurements, one component after the other. Its covariances and gains are
    the same whatever the innovations are; :func:`surrogate_whitened` takes innovations through it.

    Parameters
    ----------
    Phi, Q : (f, n, n) arrays
        Transition and driving covariance to each fix.
    H, R : (f, 6, n), (f, 6) arrays
        Jacobian, believed variances.
    P0 : (n, n) array
    first : (6,) array
        Variances of the fix that the filter started on, as it believed them: its error is that of the start, g included; zero of another start.
    use : (f, 6) array of int
        1 where a component was measured.
    factor : (6,) array
        Ratio of the true to the believed standard deviation of each component.
    phi_g, q_g, p_g : (f, 6), (f, 6), (6,) arrays
        Transition and driving variance of g to each fix, its initial variance; a zero in ``p_g``: no such part.
    gain, root : (f, 6, n + parts of g), (f, 6) arrays of zeros
        Written to: what one standard deviation of a component moves the error and g by, and that standard deviation.
    S : (f, 6, 6) array
        Written to: covariance of the components of a fix given the fixes before; nothing where it is empty.

    Returns
    -------
    int
        Number of fixes up to the first whose variance is not positive: all where none is.
    """
    n, f = P0.shape[0], len(Phi)
    which = np.zeros(6, dtype=np.int64)
    extra = 0
    for i in range(6):
        if p_g[i] > 0.0:
            which[extra] = i
            extra += 1
    m = n + extra
    P = np.zeros((m, m))
    P[:n, :n] = P0
    for i in range(6):
        P[i, i] += first[i] * (factor[i] ** 2 - 1.0)
    for j in range(extra):
        i = which[j]
        P[n + j, n + j] = p_g[i]
        if first[i] > 0.0:
            P[i, i] += p_g[i]
            P[i, n + j] = P[n + j, i] = p_g[i]
    T = np.zeros((m, n))
    g = np.zeros(m)
    at = np.zeros(m, dtype=np.int64)
    a = np.zeros(m)
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
        for i in range(6 if S.size else 0):
            for j in range(6):
                S[k, i, j] = 0.0
                for q in range(n):
                    if H[k, i, q] != 0.0:
                        for r in range(n):
                            S[k, i, j] += H[k, i, q] * P[q, r] * H[k, j, r]
            S[k, i, i] += R[k, i] * factor[i] ** 2
        for i in range(extra if S.size else 0):
            for j in range(extra):
                S[k, which[i], which[j]] += P[n + i, n + j]
            for j in range(6):
                for q in range(n):
                    w = H[k, j, q] * P[q, n + i]
                    S[k, which[i], j] -= w
                    S[k, j, which[i]] -= w
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
                return k
            root[k, i] = math.sqrt(s)
            for j in range(m):
                gain[k, i, j] = g[j] / root[k, i]
                w = g[j] / s
                for q in range(m):
                    P[j, q] -= w * g[q]
    return f


@njit(cache=True, nogil=True, fastmath={"contract"})
def surrogate_whitened(
    Phi: Array,
    K: Array,
    H: Array,
    nu: Array,
    use: NDArray[np.int64],
    phi_g: Array,
    p_g: Array,
    gain: Array,
    root: Array,
    white: Array,
    ahead: Array,
) -> None:  # pragma: no cover - compiled
    """Innovations, and any number of responses beside them, through the filter of :func:`surrogate_gains`: it is linear in them.

    Parameters
    ----------
    Phi, H, use, phi_g, p_g, gain, root : arrays
        As there.
    K : (f, n, 6) array
        Gain of the nominal filter, zero where a fix was not used.
    nu : (fixes, 6, c) array
        Of the first fixes.
    white : (fixes, 6, c) array
        Written to: whitened columns, zero where missing.
    ahead : (fixes, 6) array
        Written to: the first column less what the fixes before say of it; nothing where it is empty.
    """
    n, m = Phi.shape[1], gain.shape[2]
    f, _, cols = nu.shape
    which = np.zeros(6, dtype=np.int64)
    extra = 0
    for i in range(6):
        if p_g[i] > 0.0:
            which[extra] = i
            extra += 1
    x = np.zeros((m, cols))
    moved = np.zeros((n, cols))
    e = np.zeros(cols)
    for k in range(f):
        _moved(Phi[k], x, cols, moved)
        x[:n] = moved
        for j in range(extra):
            for c in range(cols):
                x[n + j, c] *= phi_g[k, which[j]]
        for i in range(6 if ahead.size else 0):
            ahead[k, i] = nu[k, i, 0]
            for j in range(n):
                ahead[k, i] += H[k, i, j] * x[j, 0]
        for i in range(extra if ahead.size else 0):
            ahead[k, which[i]] -= x[n + i, 0]
        for i in range(6):
            if use[k, i] == 0:
                continue
            for c in range(cols):
                e[c] = nu[k, i, c]
            for j in range(n):
                w = H[k, i, j]
                if w != 0.0:
                    for c in range(cols):
                        e[c] += w * x[j, c]
            for j in range(extra):
                if which[j] == i:
                    for c in range(cols):
                        e[c] -= x[n + j, c]
            for c in range(cols):
                e[c] /= root[k, i]
                white[k, i, c] = e[c]
            for j in range(m):
                w = gain[k, i, j]
                for c in range(cols):
                    x[j, c] += w * e[c]
        for i in range(6):
            if use[k, i] == 1:
                for j in range(n):
                    w = K[k, j, i]
                    if w != 0.0:
                        for c in range(cols):
                            x[j, c] += w * nu[k, i, c]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def surrogate_likelihoods(
    Phi: Array,
    Q: Array,
    K: Array,
    H: Array,
    R: Array,
    P0: Array,
    first: Array,
    nu: Array,
    use: NDArray[np.int64],
    gap: Array,
    ratio: Array,
    sigma: Array,
    rate: Array,
    out: Array,
) -> None:  # pragma: no cover - compiled
    """Log-likelihoods of innovations by the filter of :func:`surrogate_gains` under many noises of the fixes, eight side by side.

    The components of a fix are taken one after the other, as there, and their updates of the covariance together in one sweep.

    Parameters
    ----------
    Phi, Q, K, H, R, P0, first, use : arrays
        As there.
    nu : (f, 6) array
        Innovations.
    gap : (f,) array
        Time since the fix before, s.
    ratio, sigma : (b, 6, LANES) arrays
        Squared ratios of the true to the believed standard deviation; variances of the Gauss-Markov part, zero for none.
    rate : (b, LANES) array
        Its inverse correlation times, 1/s.
    out : (b, LANES) array
        Written to; NaN where a variance is not positive.
    """
    n = P0.shape[0]
    which = np.zeros(6, dtype=np.int64)
    # entries of each row of a transition, and those of a row of a Jacobian, that are not zero
    count, place, entry = np.zeros(n, dtype=np.int64), np.zeros((n, n), dtype=np.int64), np.zeros((n, n))
    at, a = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1)
    for block in range(ratio.shape[0]):
        extra = 0
        for i in range(6):
            if sigma[block, i].max() > 0.0:
                which[extra] = i
                extra += 1
        m = n + extra
        row = m * LANES
        P = np.zeros((m, m, LANES))
        T = np.zeros((n, m, LANES))
        x = np.zeros((m, LANES))
        ahead = np.zeros((n, LANES))
        g = np.zeros((6, m, LANES))
        gain = np.zeros((6, m, LANES))
        s, e, phi, total = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
        for i in range(n):
            for j in range(n):
                for c in range(LANES):
                    P[i, j, c] = P0[i, j]
        for i in range(6):
            for c in range(LANES):
                P[i, i, c] += first[i] * (ratio[block, i, c] - 1.0)
        for j in range(extra):
            for c in range(LANES):
                i, v = which[j], sigma[block, which[j], c]
                P[n + j, n + j, c] = v
                if first[i] > 0.0:
                    P[i, i, c] += v
                    P[i, n + j, c] = P[n + j, i, c] = v
        for k in range(nu.shape[0]):
            for c in range(LANES):
                phi[c] = math.exp(-gap[k] * rate[block, c])
            turned = load(phi, 0)
            for i in range(n):
                count[i] = 0
                for q in range(n):
                    if Phi[k, i, q] != 0.0:
                        place[i, count[i]], entry[i, count[i]] = q, Phi[k, i, q]
                        count[i] += 1
                total_of = spread(0.0)
                for r in range(count[i]):
                    total_of = add(total_of, mul(spread(entry[i, r]), load(x, place[i, r] * LANES)))
                store(ahead, i * LANES, total_of)
                for j in range(m):
                    total_of = spread(0.0)
                    for r in range(count[i]):
                        total_of = add(total_of, mul(spread(entry[i, r]), load(P, place[i, r] * row + j * LANES)))
                    store(T, i * row + j * LANES, total_of)
            for i in range(n):
                for j in range(i + 1):
                    total_of = spread(Q[k, i, j])
                    for r in range(count[j]):
                        total_of = add(total_of, mul(spread(entry[j, r]), load(T, i * row + place[j, r] * LANES)))
                    store(P, i * row + j * LANES, total_of)
                    store(P, j * row + i * LANES, total_of)
                for j in range(n, m):
                    moved = mul(load(T, i * row + j * LANES), turned)
                    store(P, i * row + j * LANES, moved)
                    store(P, j * row + i * LANES, moved)
            for i in range(n, m):
                for j in range(n, m):
                    own = i * row + j * LANES
                    store(P, own, mul(load(P, own), mul(turned, turned)))
                for c in range(LANES):
                    P[i, i, c] += (1.0 - phi[c] * phi[c]) * sigma[block, which[i - n], c]
                    x[i, c] *= phi[c]
            x[:n] = ahead
            used = 0
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
                own = used * row
                for j in range(m):
                    total_of = spread(0.0)
                    for r in range(seen):
                        total_of = add(total_of, mul(spread(a[r]), load(P, at[r] * row + j * LANES)))
                    store(g, own + j * LANES, total_of)
                for b in range(used):
                    seen_of = spread(0.0)
                    for r in range(seen):
                        seen_of = add(seen_of, mul(spread(a[r]), load(gain, b * row + at[r] * LANES)))
                    for j in range(m):
                        p = own + j * LANES
                        store(g, p, sub(load(g, p), mul(seen_of, load(g, b * row + j * LANES))))
                variance, error = spread(R[k, i]), spread(nu[k, i])
                variance = mul(variance, load(ratio, (block * 6 + i) * LANES))
                for r in range(seen):
                    variance = add(variance, mul(spread(a[r]), load(g, own + at[r] * LANES)))
                    error = sub(error, mul(spread(a[r]), load(x, at[r] * LANES)))
                store(s, 0, variance)
                store(e, 0, error)
                for c in range(LANES):
                    total[c] -= 0.5 * (math.log(s[c]) + e[c] * e[c] / s[c]) if s[c] > 0.0 else math.nan
                inverse = div(spread(1.0), variance)
                error = mul(error, inverse)
                for j in range(m):
                    v = load(g, own + j * LANES)
                    store(gain, own + j * LANES, mul(v, inverse))
                    store(x, j * LANES, add(load(x, j * LANES), mul(v, error)))
                used += 1
            for j in range(m):
                b = 0
                while b + 3 <= used:
                    own = b * row
                    one, two = load(gain, own + j * LANES), load(gain, own + row + j * LANES)
                    three = load(gain, own + 2 * row + j * LANES)
                    for q in range(j + 1):
                        p, r = j * row + q * LANES, own + q * LANES
                        left = sub(sub(load(P, p), mul(one, load(g, r))), mul(two, load(g, r + row)))
                        store(P, p, sub(left, mul(three, load(g, r + 2 * row))))
                    b += 3
                while b < used:
                    for q in range(j + 1):
                        p = j * row + q * LANES
                        store(P, p, sub(load(P, p), mul(load(gain, b * row + j * LANES), load(g, b * row + q * LANES))))
                    b += 1
                for q in range(j):
                    store(P, q * row + j * LANES, load(P, j * row + q * LANES))
            for i in range(6):
                if use[k, i] == 1:
                    for j in range(n):
                        w = K[k, j, i] * nu[k, i]
                        if w != 0.0:
                            store(x, j * LANES, add(load(x, j * LANES), spread(w)))
        out[block] = total
