"""Sigma points of the unscented filter, compiled: drawn, flown, their moments as triangular factors (:mod:`insemu.filters.unscented`)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.earth import scalar_radii
from insemu.filters.aids import fill_rows
from insemu.filters.buffers import Buffers
from insemu.filters.events import Events, queues
from insemu.filters.measurements import FIX, take_off
from insemu.filters.packed import Plan, Samples, Start
from insemu.filters.rows import Moment, Rows
from insemu.lanes import LANES, any_of, where
from insemu.rotation import scalar_dcm, scalar_wrapped
from insemu.strapdown import correct, step

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Design(NamedTuple):
    """What is believed and how it runs.

    ``phi`` (m, m) moves the augmented states over one sample; ``root`` (every, m, m) holds factors of their driving covariance over 1, 2, ...
    samples; ``axis``, ``c``, ``driver``, ``white`` are those of :class:`insemu.augment.Augmentation`; ``angle`` (kinds, w) says which rows are
    angles; ``extra`` is beta - alpha^2.
    """

    phi: Array
    root: Array
    axis: Ints
    c: Array
    driver: Ints
    white: Array
    plan: Plan
    gamma: float
    extra: float
    angle: Array


class Points(NamedTuple):
    """Sigma points as numbers (groups, components, LANES), the same memory as lanes (groups, components), and room.

    ``nav`` (13 components), ``x`` (m), ``d`` (n, deviations from the centre), ``inc`` (4 x 3, increments of this and the last sample, and what the
    axes see); ``rows`` (n, groups of rows) is what is decomposed; ``total`` holds one sum.
    """

    nav: Array
    nav_l: Any
    x: Array
    x_l: Any
    d: Array
    d_l: Any
    inc_l: Any
    rows: Array
    rows_l: Any
    total: Array
    total_l: Any


@njit(cache=True, nogil=True)
def _draw(p: Points, nav: Array, x: Array, S: Array, gamma: float) -> None:
    """Points around an estimate; ``S`` (n, n) is lower triangular. The centre is the first, its neighbours follow in pairs."""
    n, m = S.shape[0], x.size
    p.d[:, :, :] = 0.0
    for j in range(n):
        a, b = 1 + 2 * j, 2 + 2 * j
        for i in range(j, n):
            p.d[a // LANES, i, a % LANES] = -gamma * S[i, j]
            p.d[b // LANES, i, b % LANES] = gamma * S[i, j]
    for g in range(p.nav.shape[0]):
        for i in range(nav.size):
            p.nav_l[g, i] = nav[i] + 0.0 * p.d_l[g, 0]
        take_off(p.nav_l[g], p.d_l[g])  # an error: estimate less truth
        for s in range(m):
            p.x_l[g, s] = x[s] - p.d_l[g, 9 + s]


@njit(cache=True, nogil=True)
def _deviations(p: Points) -> None:
    """Errors of the centre against every point, to ``d``."""
    nav0 = p.nav[0, :, 0]
    rm, rn = scalar_radii(math.sin(nav0[0]))
    north, east = rm + nav0[2], (rn + nav0[2]) * math.cos(nav0[0])
    w, x, y, z = nav0[6], nav0[7], nav0[8], nav0[9]
    for g in range(p.nav.shape[0]):
        a, d = p.nav_l[g], p.d_l[g]
        d[0] = north * ((nav0[0] - a[0]) + (nav0[10] - a[10]))
        d[1] = east * (scalar_wrapped(nav0[1] - a[1]) + (nav0[11] - a[11]))
        d[2] = (a[2] - nav0[2]) + (a[12] - nav0[12])
        for i in range(3, 6):
            d[i] = nav0[i] - a[i]
        # C_centre = exp([phi x]) C_point: centre times conjugate of point
        u = w * a[6] + x * a[7] + y * a[8] + z * a[9]
        e = -w * a[7] + x * a[6] - y * a[9] + z * a[8]
        f = -w * a[8] + y * a[6] - z * a[7] + x * a[9]
        h = -w * a[9] + z * a[6] - x * a[8] + y * a[7]
        square = e * e + f * f + h * h
        scale = 2.0 + square * (1.0 / 3.0 + square * (3.0 / 20.0 + square * 5.0 / 56.0))
        scale = where(u < 0.0, -scale, scale)
        if any_of(square > 1e-3):
            size = math.sqrt(max(square, 1e-3))
            exact = where(u < 0.0, -2.0, 2.0) * math.atan2(size, abs(u)) / size
            scale = where(square > 1e-3, exact, scale)
        d[6], d[7], d[8] = scale * e, scale * f, scale * h
        for s in range(p.x.shape[1]):
            d[9 + s] = p.x[0, s, 0] - p.x_l[g, s]


@njit(cache=True, nogil=True)
def _factor(p: Points, used: int, S: Array) -> None:
    """Lower factor ``S`` (n, n) of what stands in the first ``used`` groups of rows, by modified Gram-Schmidt; ``rows`` are overwritten."""
    n = S.shape[0]
    a = p.rows_l
    for k in range(n):
        total = 0.0 * a[k, 0]
        for r in range(used):
            total += a[k, r] * a[k, r]
        p.total_l[0] = total
        square = 0.0
        for lane in range(LANES):
            square += p.total[0, lane]
        size = math.sqrt(square)
        S[k, k] = size
        inverse = 1.0 / size if size > 0.0 else 0.0
        for r in range(used):
            a[k, r] = a[k, r] * inverse
        for j in range(k + 1, n):
            total = 0.0 * a[k, 0]
            for r in range(used):
                total += a[k, r] * a[j, r]
            p.total_l[0] = total
            by = 0.0
            for lane in range(LANES):
                by += p.total[0, lane]
            S[j, k] = by
            S[k, j] = 0.0
            for r in range(used):
                a[j, r] = a[j, r] - by * a[k, r]


@njit(cache=True, nogil=True)
def _spread(p: Points, gamma: float, extra: float, mu: Array) -> None:
    """Put the weighted deviations in the first rows, and the mean deviation ``mu`` (n,) in the place of the centre, which has none."""
    n = mu.size
    root = math.sqrt(0.5) / gamma
    for i in range(n):
        total = 0.0 * p.d_l[0, i]
        for g in range(p.d.shape[0]):
            total += p.d_l[g, i]
            p.rows_l[i, g] = root * p.d_l[g, i]
        p.total_l[0] = total
        mu[i] = 0.0
        for lane in range(LANES):
            mu[i] += p.total[0, lane]
        mu[i] *= root * root
        p.rows[i, 0, 0] = math.sqrt(extra) * mu[i]


class _Span(NamedTuple):
    """Seconds and samples that points were flown for; mean attitude (3, 3) and specific force (3,) meanwhile."""

    seconds: float
    samples: int
    C: Array
    f_n: Array


@njit(cache=True, nogil=True)
def _renew(p: Points, o: Design, estimate: Start, flown: _Span, c_of: Array) -> None:
    """Estimate and factor from points that were flown: their moments, and the noise driven meanwhile."""
    (nav, x, S), (span, count, C, f_n) = estimate, flown
    n, m = S.shape[0], x.size
    groups, mu = p.nav.shape[0], np.empty(n)
    _deviations(p)
    _spread(p, o.gamma, o.extra, mu)
    used = groups + -(-(6 + m) // LANES)
    p.rows[:, groups:used, :] = 0.0
    B = np.zeros((9, 6))  # errors of navigation by constant errors of the axes over the span
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            B[6 + i, a] = span * C[i, a]
            B[3 + i, 3 + a] = span * C[i, a]
            B[3 + i, a] = 0.5 * span * span * (f_n[k] * C[j, a] - f_n[j] * C[k, a])
        for a in range(6):
            B[i, a] = 0.5 * span * B[3 + i, a]
    for a in range(6):
        size = math.sqrt(o.white[a] / count)
        for i in range(9):
            p.rows[i, groups + a // LANES, a % LANES] = B[i, a] * size
    root = o.root[count - 1]
    for q in range(m):
        r = 6 + q
        g, lane = groups + r // LANES, r % LANES
        for s in range(q, m):
            value = root[s, q]
            if value != 0.0:
                p.rows[9 + s, g, lane] = value
                if o.axis[s] >= 0:
                    for i in range(9):
                        p.rows[i, g, lane] -= B[i, o.axis[s]] * c_of[s] * value
    _factor(p, used, S)
    for i in range(nav.size):
        nav[i] = p.nav[0, i, 0]
    take_off(nav, mu)  # deviations are errors of the centre
    for s in range(m):
        x[s] = p.x[0, s, 0] - mu[9 + s]


@njit(cache=True, nogil=True)
def _move(p: Points, o: Design, r: Samples, k: int, c_of: Array) -> None:
    """Fly every point over one sample."""
    before = max(k - 1, 1)
    dt, dt_before = r.t[k] - r.t[k - 1], r.t[before] - r.t[before - 1]
    m = c_of.size
    for g in range(p.nav.shape[0]):
        x, inc = p.x_l[g], p.inc_l
        seen = inc[4]
        for a in range(6):
            seen[a] = 0.0 * x[0]
        for s in range(m):
            total = o.phi[s, s] * x[s]
            p.d_l[g, 9 + s] = total
        for s in range(m):
            for q in range(m):
                if q != s and o.phi[s, q] != 0.0:
                    p.d_l[g, 9 + s] += o.phi[s, q] * x[q]
        for s in range(m):
            x[s] = p.d_l[g, 9 + s]
            if o.axis[s] >= 0:
                seen[o.axis[s]] += c_of[s] * x[s]
        for a in range(3):
            inc[0, a] = r.gyro[k, a] - seen[a] * dt
            inc[1, a] = r.accel[k, a] - seen[3 + a] * dt
            inc[2, a] = r.gyro[before, a] - seen[a] * dt_before
            inc[3, a] = r.accel[before, a] - seen[3 + a] * dt_before
        step(p.nav_l[g], inc[0, :3], inc[1, :3], inc[2, :3], inc[3, :3], dt, dt_before, o.plan.gravity)


class _Past(NamedTuple):
    """What led to an event: the last step (s), the state before it (13,), rates and coefficients of the states (m,).

    ``rates`` (3, 3) are the last two rates and the mean rate over ``count`` samples, corrected by the central point's states.
    """

    dt: float
    nav: Array
    rates: Array
    samples: int
    c_of: Array


@njit(cache=True, nogil=True)
def _rows_of(p: Points, o: Design, event: tuple[int, float, Array, Array], before: _Past, nu: Array, R: Array) -> None:
    """Innovations of an event (kind, tau, z, settings) at every point, ``nu`` (points, w), and the noise at the centre, ``R`` (w, w)."""
    dt, nav_before, given, count, c_of = before
    m, w, n = c_of.size, R.shape[0], p.d.shape[1]
    kind, tau, z, settings = event
    here, past, rates, lever, clock = np.empty(13), np.empty(13), np.empty((3, 3)), np.empty(3), np.zeros(2)
    H, noise, none, error = np.zeros((w, n)), np.zeros((w, w)), np.zeros(12), np.empty(9)
    for i in range(nu.shape[0]):
        g, lane = i // LANES, i % LANES
        for j in range(13):
            here[j], past[j] = p.nav[g, j, lane], nav_before[j]
        for j in range(9):
            error[j] = p.d[g, j, lane]
        correct(past, error)
        for a in range(3):
            seen = 0.0
            for s in range(m):
                if o.axis[s] == a:
                    seen += c_of[s] * (p.x[g, s, lane] - p.x[0, s, 0])
            for j in range(3):
                rates[j, a] = given[j, a] - seen
            lever[a] = o.plan.lever[a]
            if o.plan.lever_at >= 0:
                lever[a] += p.x[g, o.plan.lever_at - 9 + a, lane]
        if o.plan.clock_at >= 0:
            for a in range(2):
                clock[a] = p.x[g, o.plan.clock_at - 9 + a, lane]
        moment = Moment(
            here, past, dt, tau, rates[0], rates[1], rates[2], count, o.white, c_of, o.axis, lever, -1, -1, clock, -1, none
        )  # fmt: skip
        fill_rows(kind, moment, z, settings, Rows(nu[i], H, noise))
        if i == 0:
            for a in range(w):
                for b in range(w):
                    R[a, b] = noise[a, b]
        for a in range(w):
            if o.angle[kind, a] > 0.0:
                nu[i, a] = nu[0, a] + scalar_wrapped(nu[i, a] - nu[0, a])


@njit(cache=True, nogil=True)
def _cholesky(A: Array) -> bool:
    """Lower factor of ``A`` (q, q) in place; whether there is one."""
    for j in range(A.shape[0]):
        for i in range(j, A.shape[0]):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                A[j, j] = math.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
        for k in range(j):
            A[k, j] = 0.0
    return True


class _Measured(NamedTuple):
    """``nu`` (points, w) and ``R`` (w, w) of :func:`_rows_of`, stated variances ``var`` (w,), and the components that are used, ``at`` (q,)."""

    nu: Array
    R: Array
    var: Array
    at: Ints


class _Update(NamedTuple):
    """Overwritten by an update: estimated error (n,), innovation (w,) and its covariance (w, w)."""

    dx: Array
    nu: Array
    S: Array


@njit(cache=True, nogil=True)
def _absorb(p: Points, o: Design, S: Array, measured: _Measured, free: float, out: _Update) -> tuple[float, int]:
    """Use components of a measurement; returns the normalised innovation squared and 1 (used), 0 (rejected) or -1 (no factor)."""
    (nu, R, var, at), (dx, seen, S_out) = measured, out
    n, q, points = S.shape[0], at.size, nu.shape[0]
    groups = p.nav.shape[0]
    weight = 0.5 / (o.gamma * o.gamma)
    mean, root = np.zeros(q), np.zeros((q, q))
    for a in range(q):
        for i in range(1, points):
            mean[a] += weight * (nu[i, at[a]] - nu[0, at[a]])
    for a in range(q):
        for b in range(q):
            root[a, b] = R[at[a], at[b]] + (var[at[a]] if a == b else 0.0)
    V, noise = root.copy(), root.copy()
    for a in range(q):
        for b in range(a + 1):
            total = o.extra * mean[a] * mean[b]
            for i in range(1, points):
                total += weight * (nu[i, at[a]] - nu[0, at[a]]) * (nu[i, at[b]] - nu[0, at[b]])
            V[a, b] += total
            V[b, a] = V[a, b]
    for a in range(q):
        seen[at[a]] = nu[0, at[a]] + mean[a]
        for b in range(q):
            S_out[at[a], at[b]] = V[a, b]
    if not (_cholesky(V) and _cholesky(noise)):
        return math.nan, -1
    y = np.empty(q)
    nis = 0.0
    for a in range(q):
        total = seen[at[a]]
        for b in range(a):
            total -= V[a, b] * y[b]
        y[a] = total / V[a, a]
        nis += y[a] * y[a]
    dx[:] = 0.0
    if not nis <= max(o.plan.thresholds[q], free):
        return nis, 0
    K = np.zeros((n, q))  # less the gain: a point that errs more measures less of it
    for i in range(n):
        for a in range(q):
            total = 0.0
            for j in range(1, points):
                total += weight * p.d[j // LANES, i, j % LANES] * (nu[j, at[a]] - nu[0, at[a]])
            for b in range(a):
                total -= V[a, b] * K[i, b]
            K[i, a] = total / V[a, a]
        for a in range(q - 1, -1, -1):
            total = K[i, a]
            for b in range(a + 1, q):
                total -= V[b, a] * K[i, b]
            K[i, a] = total / V[a, a]
        for a in range(q):
            dx[i] -= K[i, a] * seen[at[a]]
    used = groups + -(-q // LANES)
    scale = math.sqrt(weight)
    p.rows[:, :used, :] = 0.0
    for i in range(n):
        for j in range(1, points):
            value = p.d[j // LANES, i, j % LANES]
            for a in range(q):
                value -= K[i, a] * (nu[j, at[a]] - nu[0, at[a]])
            p.rows[i, j // LANES, j % LANES] = scale * value
        for a in range(q):
            p.rows[i, 0, 0] -= math.sqrt(o.extra) * K[i, a] * mean[a]
            for b in range(a + 1):
                p.rows[i, groups + b // LANES, b % LANES] += K[i, a] * noise[a, b]
    _factor(p, used, S)
    return nis, 1


@njit(cache=True, nogil=True)
def fly(p: Points, o: Design, r: Samples, events: Events, start: Start, out: Buffers) -> int:
    """Fly the filter through a record.

    Parameters
    ----------
    p : Points
    o : Design
    r : Samples
    events : Events
    start : Start
        ``nav`` (13,); ``P`` is the lower factor of the covariance. Overwritten by those at the end.
    out : Buffers
        Overwritten.

    Returns
    -------
    int
        0; -1 where an innovation has no positive covariance.
    """
    nav, x, S = start
    cov_epoch = o.plan.cov_epoch
    n, m, width = S.shape[0], x.size, events.z.shape[1]
    upcoming, follows = queues(events.kind)
    points, kinds = 2 * n + 1, upcoming.size
    c_of, C, B, f_n = o.c.copy(), np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    nu, R, dx = np.empty((points, width)), np.empty((width, width)), np.empty(n)
    given, nav_before = np.zeros((3, 3)), nav.copy()
    rate_sum, rate_count = np.zeros((kinds, 3)), np.zeros(kinds, dtype=np.int64)
    at = np.empty(width, dtype=np.int64)
    span, count, cov, row, e, rejected_from = 0.0, 0, 0, 0, 0, math.inf
    driven = (o.driver >= 0).any()
    _draw(p, nav, x, S, o.gamma)
    for k in range(r.t.size):
        if k > 0:
            dt = r.t[k] - r.t[k - 1]
            if driven:
                for s in range(m):
                    a = o.driver[s]
                    if a >= 0:
                        c_of[s] = o.c[s] * (r.gyro[k, a] if a < 3 else r.accel[k, a - 3]) / dt
            measures = e < events.epoch.size and events.epoch[e] == k
            for i in range(13):
                nav_before[i] = p.nav[0, i, 0]
            scalar_dcm(nav_before[6:10], B)
            _move(p, o, r, k, c_of)
            span, count = span + dt, count + 1
            for i in range(3):
                seen, force = 0.0, 0.0
                for s in range(m):
                    if o.axis[s] == i:
                        seen += c_of[s] * p.x[0, s, 0]
                given[1, i] = given[0, i] if k > 1 else r.gyro[k, i] / dt - seen
                given[0, i] = r.gyro[k, i] / dt - seen
                for a in range(3):
                    force += B[i, a] * r.accel[k, a]
                f_n[i] += force
            for a in range(1, kinds):
                if upcoming[a] >= 0 and events.since[upcoming[a]] == k - 1:
                    rate_sum[a, :] = 0.0
                    rate_count[a] = 0
                rate_count[a] += 1
                for i in range(3):
                    rate_sum[a, i] += given[0, i]
            if (
                measures or count == o.plan.every or k == r.t.size - 1 or k % o.plan.every == 0
                or (cov < cov_epoch.size and cov_epoch[cov] == k)
            ):  # fmt: skip
                scalar_dcm(p.nav[0, 6:10, 0], C)
                for i in range(3):
                    f_n[i] /= span
                    for a in range(3):
                        C[i, a] = 0.5 * (C[i, a] + B[i, a])
                _renew(p, o, start, _Span(span, count, C, f_n), c_of)
                _draw(p, nav, x, S, o.gamma)
                f_n[:] = 0.0
                span, count = 0.0, 0
            while e < events.epoch.size and events.epoch[e] == k:
                kind = events.kind[e]
                upcoming[kind] = follows[e]
                for i in range(3):
                    given[2, i] = rate_sum[kind, i] / max(rate_count[kind], 1)
                q = 0
                for i in range(width):
                    if math.isfinite(events.z[e, i] + events.var[e, i]):
                        at[q] = i
                        q += 1
                out.dof[e], out.ok[e] = q, 0.0
                if q > 0:
                    event = (kind, events.tau[e], events.z[e], events.settings[e])
                    before = _Past(r.t[k] - r.t[k - 1], nav_before, given, max(rate_count[kind], 1), c_of)
                    _rows_of(p, o, event, before, nu, R)
                    free = math.inf if kind == FIX and r.t[k] - rejected_from >= o.plan.timeout else -math.inf
                    measured = _Measured(nu, R, events.var[e], at[:q])
                    nis, ok = _absorb(p, o, S, measured, free, _Update(dx, out.nu[e], out.S[e]))
                    if ok < 0:
                        return -1
                    out.nis[e], out.ok[e] = nis, float(ok)
                    if kind == FIX:
                        rejected_from = math.inf if ok > 0 else min(rejected_from, r.t[k])
                    if ok > 0:
                        take_off(nav, dx)
                        for s in range(m):
                            x[s] -= dx[9 + s]
                        _draw(p, nav, x, S, o.gamma)
                e += 1
        if cov < cov_epoch.size and cov_epoch[cov] == k:
            for i in range(n):
                for j in range(n):
                    total = 0.0
                    for a in range(min(i, j) + 1):
                        total += S[i, a] * S[j, a]
                    out.P[cov, i, j] = total
            cov += 1
        if k % o.plan.output_every == 0 or k == r.t.size - 1:
            for i in range(10):
                out.nav[row, i] = p.nav[0, i, 0]
            for i in range(n):
                out.var[row, i] = 0.0
                for j in range(i + 1):
                    out.var[row, i] += S[i, j] * S[i, j]
            for s in range(m):
                out.x[row, s] = p.x[0, s, 0]
            row += 1
    return 0
