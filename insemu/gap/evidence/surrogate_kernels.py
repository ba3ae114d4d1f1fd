"""Compiled loops of a filter on the error of the nominal filter: what its innovations are worth under another noise of the fixes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.gap.evidence.error_kernels import carried
from insemu.lanes import any_of, where, zeros

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _coloured(p_g: Array) -> NDArray[np.int64]:  # pragma: no cover - compiled
    """Components that have a part of g, by its initial variances (6,)."""
    return np.flatnonzero(p_g > 0.0)


@njit(cache=True, nogil=True, inline="always")
def _entries(
    row: Array, which: NDArray[np.int64], component: int, at: NDArray[np.int64], a: Array
) -> int:  # pragma: no cover - compiled
    """States that a component of a fix shows: how many; places and by how much go to ``at`` and ``a``: the error's, then its own part of g."""
    seen = 0
    for j in range(row.size):
        if row[j] != 0.0:
            at[seen], a[seen] = j, -row[j]
            seen += 1
    for j in range(which.size):
        if which[j] == component:
            at[seen], a[seen] = row.size + j, 1.0
            seen += 1
    return seen


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
    which = _coloured(p_g)
    extra = which.size
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
    T, row = np.zeros((m, n)), np.zeros(m)
    g = np.zeros(m)
    at = np.zeros(m, dtype=np.int64)
    a = np.zeros(m)
    for k in range(f):
        F = Phi[k]
        # P = F P F' + Q, block by block: transitions and Jacobians are mostly zeros, so both products go by rows of what is not
        for i in range(n):
            row[:] = 0.0
            for q in range(n):
                w = F[i, q]
                if w != 0.0:
                    for j in range(m):
                        row[j] += w * P[q, j]
            for j in range(m):
                T[j, i] = row[j]
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
            seen = _entries(H[k, i], which, i, at, a)
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
    which = _coloured(p_g)
    extra = which.size
    x = np.zeros((m, cols))
    moved = np.zeros((n, cols))
    e = np.zeros(cols)
    for k in range(f):
        carried(Phi[k], x, cols, moved)
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


@njit(cache=True, nogil=True, fastmath={"contract"})
def surrogate_left_out(
    Phi: Array,
    H: Array,
    use: NDArray[np.int64],
    phi_g: Array,
    p_g: Array,
    gain: Array,
    root: Array,
    white: Array,
    u: Array,
    D: Array,
) -> None:  # pragma: no cover - compiled
    """Rows of the innovations times the inverse of their covariance, and its blocks on the diagonal, by one pass back from the last fix.

    With ``e`` the innovation of a component in turn, ``s`` its variance, ``K = P a / s`` and ``L = I - K a'``, from the last to the first

        u = e / s - K' r,  D = 1 / s + K' N K,  r <- a u + r,  N <- a a' / s + L' N L

    (de Jong 1989, section 4). N is made symmetric once a fix: rounding that is not grows from fix to fix.

    Parameters
    ----------
    Phi, H, use, phi_g, p_g, gain, root : arrays
        As in :func:`surrogate_gains`.
    white : (f, 6) array
        Whitened innovations.
    u : (f, 6) array
        Written to, 1/m and s/m; zero where a component is missing.
    D : (f, 6, 6) array of zeros
        Written to, for each fix.
    """
    f, n, m = white.shape[0], Phi.shape[1], gain.shape[2]
    which = _coloured(p_g)
    r, a, K, NK = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    N, T, later = np.zeros((m, m)), np.zeros((m, m)), np.zeros((6, m))
    at, entry = np.zeros(m, dtype=np.int64), np.zeros(m)
    for back in range(f):
        k = f - 1 - back
        for turn in range(6):
            i = 5 - turn
            if use[k, i] == 0:
                continue
            a[:] = 0.0
            seen = _entries(H[k, i], which, i, at, entry)
            for c in range(seen):
                a[at[c]] = entry[c]
            for p in range(m):
                K[p] = gain[k, i, p] / root[k, i]
            e, own = white[k, i] / root[k, i], 1.0 / root[k, i] ** 2
            NK[:] = 0.0
            for p in range(m):
                e -= K[p] * r[p]
                for q in range(m):
                    NK[q] += N[p, q] * K[p]
            u[k, i], D[k, i, i] = e, own
            for p in range(m):
                D[k, i, i] += K[p] * NK[p]
            for j in range(i + 1, 6):
                if use[k, j] == 1:
                    shared = 0.0
                    for p in range(m):
                        shared += K[p] * later[j, p]
                    D[k, i, j] = D[k, j, i] = -shared
                    for p in range(m):
                        later[j, p] -= a[p] * shared
            for p in range(m):
                later[i, p] = a[p] * D[k, i, i] - NK[p]
                NK[p] -= 0.5 * D[k, i, i] * a[p]
                r[p] += a[p] * e
            for c in range(seen):
                p = at[c]
                for q in range(m):
                    N[p, q] -= entry[c] * NK[q]
                    N[q, p] -= entry[c] * NK[q]
        # r = F' r, N = F' N F
        K[:], T[:] = 0.0, 0.0
        for q in range(n):
            for i in range(n):
                w = Phi[k, q, i]
                if w != 0.0:
                    K[i] += w * r[q]
                    for p in range(m):
                        T[i, p] += w * N[q, p]
        for j in range(n, m):
            w = phi_g[k, which[j - n]]
            K[j] = w * r[j]
            for p in range(m):
                T[j, p] = w * N[j, p]
        r[:], N[:] = K, 0.0
        for p in range(m):
            for q in range(p):
                T[p, q], T[q, p] = T[q, p], T[p, q]
        for q in range(n):
            for i in range(n):
                w = Phi[k, q, i]
                if w != 0.0:
                    for p in range(m):
                        N[i, p] += w * T[q, p]
        for j in range(n, m):
            for p in range(m):
                N[j, p] = phi_g[k, which[j - n]] * T[j, p]
        for p in range(m):
            for q in range(p):
                N[p, q] = N[q, p] = 0.5 * (N[p, q] + N[q, p])


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
    stated: Array,
    ratio: Array,
    sigma: Array,
    rate: Array,
    follows: Array,
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
    stated : (f, 6) array
        Stated variances over their medians.
    ratio, sigma : (b, 6) arrays of lanes
        Squared ratios of the true to the believed standard deviation; variances of the Gauss-Markov part, zero for none.
    rate : (b,) array of lanes
        Its inverse correlation times, 1/s.
    follows : (b,) array of lanes
        1 where its variances go with the stated ones, else 0.
    out : (b,) array of lanes
        Written to; NaN where a variance is not positive.
    """
    n = P0.shape[0]
    which = np.zeros(6, dtype=np.int64)
    # entries of each row of a transition, and those of a row of a Jacobian, that are not zero
    count, place, entry = np.zeros(n, dtype=np.int64), np.zeros((n, n), dtype=np.uint64), np.zeros((n, n))
    at, a = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1)
    turn, drive = zeros(ratio, 6), zeros(ratio, 6)
    for block in range(ratio.shape[0]):
        extra = 0
        for i in range(6):
            if any_of(sigma[block, i] > 0.0):
                which[extra] = i
                extra += 1
        m = n + extra
        P, T = zeros(ratio, (m, m)), zeros(ratio, (n, m))
        x, ahead = zeros(ratio, m), zeros(ratio, n)
        g, gain = zeros(ratio, (6, m)), zeros(ratio, (6, m))
        for i in range(n):
            for j in range(n):
                P[i, j] = P0[i, j]
        for i in range(6):
            P[i, i] += first[i] * (ratio[block, i] - 1.0)
        for j in range(extra):
            i = which[j]
            v = sigma[block, i] * (1.0 + follows[block] * (stated[0, i] - 1.0))
            P[n + j, n + j] = v
            if first[i] > 0.0:
                P[i, i] += v
                P[i, n + j] = P[n + j, i] = v
        total = 0.0
        for k in range(nu.shape[0]):
            grown = math.expm1(gap[k] * rate[block])
            for j in range(extra):
                i = which[j]
                to = 1.0 + follows[block] * (stated[k, i] - 1.0)
                of = 1.0 + follows[block] * (stated[max(k - 1, 0), i] - 1.0)
                turn[j] = min(1.0, to / (of + grown))
                drive[j] = (to - turn[j] * turn[j] * of) * sigma[block, i]
            for i in range(n):
                count[i] = 0
                for q in range(n):
                    if Phi[k, i, q] != 0.0:
                        place[i, count[i]], entry[i, count[i]] = q, Phi[k, i, q]
                        count[i] += 1
                v = 0.0
                for r in range(count[i]):
                    v += entry[i, r] * x[place[i, r]]
                ahead[i] = v
                for j in range(m):
                    v = 0.0
                    for r in range(count[i]):
                        v += entry[i, r] * P[place[i, r], j]
                    T[i, j] = v
            for i in range(n):
                for j in range(i + 1):
                    v = Q[k, i, j]
                    for r in range(count[j]):
                        v += entry[j, r] * T[i, place[j, r]]
                    P[i, j] = P[j, i] = v
                for j in range(n, m):
                    P[i, j] = P[j, i] = T[i, j] * turn[j - n]
            for i in range(n, m):
                for j in range(n, m):
                    P[i, j] *= turn[i - n] * turn[j - n]
                P[i, i] += drive[i - n]
                x[i] *= turn[i - n]
            x[:n] = ahead
            used = 0
            for i in range(6):
                if use[k, i] == 0:
                    continue
                seen = _entries(H[k, i], which[:extra], i, at, a)
                for j in range(m):
                    v = 0.0
                    for r in range(seen):
                        v += a[r] * P[at[r], j]
                    g[used, j] = v
                for b in range(used):
                    v = 0.0
                    for r in range(seen):
                        v += a[r] * gain[b, at[r]]
                    for j in range(m):
                        g[used, j] -= v * g[b, j]
                variance, error = R[k, i] * ratio[block, i], nu[k, i]
                for r in range(seen):
                    variance += a[r] * g[used, at[r]]
                    error -= a[r] * x[at[r]]
                total -= where(variance > 0.0, 0.5 * (math.log(variance) + error * error / variance), math.nan)
                inverse = 1.0 / variance
                for j in range(m):
                    gain[used, j] = g[used, j] * inverse
                    x[j] += gain[used, j] * error
                used += 1
            for j in range(m):
                b = 0
                while b + 3 <= used:
                    one, two, three = gain[b, j], gain[b + 1, j], gain[b + 2, j]
                    for q in range(j + 1):
                        P[j, q] = P[j, q] - one * g[b, q] - two * g[b + 1, q] - three * g[b + 2, q]
                    b += 3
                while b < used:
                    for q in range(j + 1):
                        P[j, q] -= gain[b, j] * g[b, q]
                    b += 1
                for q in range(j):
                    P[q, j] = P[j, q]
            for i in range(6):
                if use[k, i] == 1:
                    for j in range(n):
                        x[j] += K[k, j, i] * nu[k, i]
        out[block] = total
