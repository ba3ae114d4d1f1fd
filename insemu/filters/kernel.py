"""The compiled loop of the filter: scalar code over plain arrays, without the GIL."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aids import fill_rows
from insemu.filters.buffers import Buffers
from insemu.filters.events import Events, queues
from insemu.filters.expanded import (
    MAP_SIZE,
    Transition,
    advance_transition,
    fill_map,
    gather,
    grid,
    middle,
    predict,
    reset_transition,
    scatter,
    states_ahead,
)
from insemu.filters.families import Carry, Update, absorb, settle
from insemu.filters.following import add_speed, take_times
from insemu.filters.measurements import (
    FIX,
    add_curvature,
    fill_rate,
    fill_trend,
    first_bad_pivot,
    motion_change,
    take_off,
    turn,
)
from insemu.filters.packed import Packed, Plan, Samples, Start
from insemu.filters.rows import Moment, Rows
from insemu.lanes import any_of, number_at, where, zeros
from insemu.strapdown import fill_dynamics, step

Array = NDArray[np.float64]

#: Where the latency is a state, a fix is used at most so many steps after its own time.
LATE_STEPS = 2.5


@njit(cache=True, nogil=True)
def _lay(out: Array, d: Array, phi: Array, mix: Array) -> None:
    """Write d, phi and mix one after the other."""
    at = 0
    for part in (d, phi.ravel(), mix.ravel()):
        for i in range(part.size):
            out[at + i] = part[i]
        at += part.size


@njit(cache=True, nogil=True)
def _failed(status: Array, detail: float, code: int) -> bool:
    """Note a failure (``detail`` is not negative) where there was none before; whether there is no lane left."""
    if any_of(detail >= 0.0):
        first = where(detail >= 0.0, where(status[0] < 1.0, 1.0, 0.0), 0.0)
        status[0] = where(first > 0.0, code, status[0])
        status[1] = where(first > 0.0, detail, status[1])
    return not any_of(status[0] < 1.0)


@njit(cache=True, nogil=True)
def run(
    samples: Samples, start: Start, model: Packed, events: Events, plan: Plan, carry: Carry, out: Buffers, status: Array
) -> int:
    """Fly the filter through a record; see :mod:`insemu.filters.ekf`, which prepares and names everything.

    A fix is used at the first epoch at or after its own time. Where its latency is a state, that is the stamp less the latency as
    estimated by then: no fix is predicted over more than a step or two, however old it is at its stamp. One whose own time has passed already
    (the estimate has jumped by more than the time between fixes) is left out.

    Parameters
    ----------
    samples : Samples
        Of one record, or tuples of those of several in the lanes of a vector.
    start : Start
        ``nav`` (13,) is overwritten.
    model : Packed
    events : Events
    plan : Plan
    carry : Carry
        The family of the filter (:mod:`insemu.filters.families`).
    out : Buffers
        Overwritten.
    status : (2,) array
        Overwritten with code and detail. 0: done. 1: ``P`` not positive semidefinite at state ``detail``. 2: innovation covariance not positive
        definite in component ``detail``. 3: the navigation state is not finite at epoch ``detail``.

    Returns
    -------
    int
        How many nodes were stored.
    """
    t, gyro, accel, power = samples
    nav = start.nav
    place, axis, c0, driver, white, steps, q_law, time_at, time_law, time_of, laws, white_of = model
    lever_at, latency_at, clock_at = plan.lever_at, plan.latency_at, plan.clock_at
    every, window, store = plan.every, plan.window, plan.store
    P = out.last
    n = place.size
    m = n - 9
    ld, first, wide = grid(nav)
    end = first + wide * steps.slots
    E = zeros(nav, (end + 1) * ld)
    T = zeros(nav, 15 * ld)
    work = zeros(nav, (wide * steps.slots + 10) * ld)
    A = zeros(nav, (end + 1) * ld if store else 1)
    w = zeros(nav, MAP_SIZE)
    F = zeros(nav, (9, 9))
    C, mid, C_sum = zeros(nav, (3, 3)), zeros(nav, (3, 3)), zeros(nav, (3, 3))
    x, c = zeros(nav, ld), zeros(nav, ld)
    seen = zeros(nav, 6)
    dth, dv, dth1, dv1 = zeros(nav, 3), zeros(nav, 3), zeros(nav, 3), zeros(nav, 3)
    f_n, f_sum, span, count = zeros(nav, 3), zeros(nav, 3), 0.0, 0
    nav_before = zeros(nav, nav.size)
    rate, rate1 = zeros(nav, 3), zeros(nav, 3)
    first_of, follows = queues(events.kind)
    kinds = first_of.size
    rate_sum, rate_count = zeros(nav, (kinds, 3)), np.zeros(kinds, dtype=np.int64)
    mean_rate = zeros(nav, 3)
    upcoming = first_of
    past = zeros(nav, (window, 6))  # acceleration and rate of the last steps
    trend = zeros(nav, 12)
    white_now, white_step = zeros(nav, 6), zeros(nav, 6)
    lever, clock = zeros(nav, 3), zeros(nav, 2)
    installed = lever_at >= 0 or latency_at >= 0
    c_of = zeros(nav, m)
    dx = zeros(nav, n)
    node_total = zeros(nav, n)
    width = events.z.shape[1]
    nu, H, R = zeros(nav, width), zeros(nav, (width, n)), zeros(nav, (width, width))
    rows = Rows(nu, H, R)
    rows_after = Rows(zeros(nav, width), zeros(nav, (width, n)), zeros(nav, (width, width)))
    P_before, room, scale = zeros(nav, (n, n)), zeros(nav, (width, width)), zeros(nav, (kinds, width))
    scale[:, :] = 1.0
    nav_moved, before_moved = zeros(nav, nav.size), zeros(nav, nav.size)
    moved = zeros(nav, 6)
    used = zeros(nav, width)
    rejected_from = math.inf + 0.0 * nav[0]
    L = zeros(nav, (n, n))
    driven = False
    groups = laws.shape[0]
    power_now, power_sum = zeros(nav, groups), zeros(nav, groups)
    timed = time_at.size > 0
    for i in range(nav.size):
        nav_before[i] = nav[i]
    for i in range(6):
        white_step[i] = white[i]
    for i in range(n):
        for j in range(n):  # an assignment of slices would compile three seconds of messages
            P[i, j] = start.P[i, j]
    scatter(P, place, 1.0, E)
    for s in range(m):
        x[place[9 + s]] = start.x[s]
        if driver[s] >= 0:
            driven = True
        if axis[s] >= 0:
            c[place[9 + s]] = c0[s]
            c_of[s] = c0[s]
    if store:
        reset_transition(A, end)
    cov, node, planned, row = 0, 0, 0, 0

    d_one, phi_one = steps.d[0], steps.phi[0]
    d, phi, mix, q = d_one, phi_one, steps.mix[0], steps.q[0]
    phi_end = ld + phi.size
    mix_end = phi_end + mix.size
    # matrices that follow covariates, one after the other: of one sample and of a step
    of_one, of_step = zeros(nav, mix_end + q_law.size), zeros(nav, mix_end + q_law.size)
    _lay(of_one, d, phi, mix)
    _lay(of_step, d, phi, mix)
    q_now = of_step[mix_end:]
    if timed:
        d_one, phi_one = of_one[:ld], of_one[ld:phi_end].reshape(phi.shape)
        d, phi, mix = of_step[:ld], of_step[ld:phi_end].reshape(phi.shape), of_step[phi_end:mix_end].reshape(mix.shape)
    one = Transition(steps.slots, steps.diagonal, d_one, phi_one, steps.offsets, steps.mix[0], steps.q_at, steps.q[0])
    if _failed(status, first_bad_pivot(P, L), 1):
        return 0
    epochs = t.size
    for k in range(epochs):
        measures = False
        if k > 0:
            dt = t[k] - t[k - 1]
            before = max(k - 1, 1)
            for a in range(1, kinds):
                if upcoming[a] >= 0 and events.since[upcoming[a]] == k - 1:
                    # the rate of the next such aid is averaged from here on, whatever the vehicle did before
                    for i in range(3):
                        rate_sum[a, i] = 0.0
                    rate_count[a] = 0
            if driven:
                for s in range(m):
                    if driver[s] >= 0:
                        raw = number_at(gyro, k, driver[s]) if driver[s] < 3 else number_at(accel, k, driver[s] - 3)
                        c_of[s] = c0[s] * raw / dt
                        c[place[9 + s]] = c_of[s]
            if groups > 0:
                for g in range(groups):
                    power_now[g] = number_at(power, k, g)
                add_speed(power_now, laws, math.sqrt(nav[3] * nav[3] + nav[4] * nav[4] + nav[5] * nav[5]))
                for i in range(6):
                    white_step[i] = white[i]
                    for g in range(groups):
                        white_step[i] += power_now[g] * white_of[g, i]
                for g in range(groups):
                    power_sum[g] += power_now[g]
                if timed:
                    take_times(of_one, time_at, time_law, time_of[0], power_now)
            states_ahead(x, seen, one, c, work)
            for i in range(3):
                dth1[i], dv1[i], rate1[i] = dth[i], dv[i], rate[i]
                dth[i] = number_at(gyro, k, i) - seen[i] * dt
                dv[i] = number_at(accel, k, i) - seen[3 + i] * dt
                rate[i] = dth[i] / dt
                for a in range(1, kinds):
                    rate_sum[a, i] += rate[i]
            for a in range(1, kinds):
                rate_count[a] += 1
            if k == 1:
                for i in range(3):
                    dth1[i], dv1[i], rate1[i] = dth[i], dv[i], rate[i]
            for i in range(10):
                nav_before[i] = nav[i]
            middle(nav[6:10], dth, dv, dt, C, mid, f_n)
            if every > 1:
                # several steps as one: means over them, at the last state
                span += dt
                count += 1
                for i in range(3):
                    f_sum[i] += f_n[i] * dt
                    for j in range(3):
                        C_sum[i, j] += mid[i, j] * dt
            else:
                span, count = dt, 1
            for a in range(kinds):
                if upcoming[a] >= 0:
                    if a == FIX and latency_at >= 0:
                        measures = measures or any_of(
                            events.t[upcoming[a]] - x[place[latency_at]] <= t[k] + plan.tolerance
                        )
                    else:
                        measures = measures or events.epoch[upcoming[a]] == k
            due = (
                measures
                or count == every
                or k == epochs - 1
                or k % every == 0  # so that the rows asked for change no number
                or (cov < plan.cov_epoch.size and plan.cov_epoch[cov] == k)
                or (planned < plan.node_epoch.size and plan.node_epoch[planned] == k)
            )
            if due:
                if every > 1:
                    for i in range(3):
                        f_n[i] = f_sum[i] / span
                        f_sum[i] = 0.0
                        for j in range(3):
                            mid[i, j] = C_sum[i, j] / span
                            C_sum[i, j] = 0.0
                for i in range(6):
                    white_now[i] = white[i] / count
                    for g in range(groups):
                        white_now[i] += power_sum[g] * white_of[g, i] / (count * count)
                fill_dynamics(nav, f_n, plan.gravity, F)
                fill_map(F, mid, span, w)
                half = 0.5 * span
                if every > 1 and timed:
                    _lay(of_step, steps.d[count - 1], steps.phi[count - 1], steps.mix[count - 1])
                elif every > 1:
                    d, phi, mix, q = steps.d[count - 1], steps.phi[count - 1], steps.mix[count - 1], steps.q[count - 1]
                if groups > 0:
                    for i in range(q_law.size):
                        q_now[i] = steps.q[count - 1, i]
                        if q_law[i] >= 0:
                            q_now[i] *= power_sum[q_law[i]] / count
                    for g in range(groups):
                        power_sum[g] /= count
                    if timed:
                        take_times(of_step, time_at, time_law, time_of[count - 1], power_sum)
                    for g in range(groups):
                        power_sum[g] = 0.0
                    q = q_now
                over = Transition(steps.slots, steps.diagonal, d, phi, steps.offsets, mix, steps.q_at, q)
                predict(E, w, half, over, c, white_now, T, work)
                if store:
                    advance_transition(A, w, half, over, c, work)
                span, count = 0.0, 0
            step(nav, dth, dv, dth1, dv1, dt, dt if k == 1 else t[before] - t[before - 1], plan.gravity)
            if installed:
                now = k % window
                for i in range(3):
                    past[now, i], past[now, 3 + i] = (nav[3 + i] - nav_before[3 + i]) / dt, rate[i]

        is_planned = planned < plan.node_epoch.size and plan.node_epoch[planned] == k
        is_node = store and (is_planned or measures)
        if is_node:
            gather(E, place, P)
            for i in range(n):
                for j in range(n):
                    out.before[node, i, j] = P[i, j]
                    out.phi[node, i, j] = A[place[i] * ld + place[j]]
                node_total[i] = 0.0
        while measures:
            event = -1
            for a in range(kinds):
                e = upcoming[a]
                if e >= 0:
                    if a == FIX and latency_at >= 0:
                        here = any_of(events.t[e] - x[place[latency_at]] <= t[k] + plan.tolerance)
                    else:
                        here = events.epoch[e] == k
                    if here and (event < 0 or e < event):
                        event = e
            if event < 0:
                break
            kind = events.kind[event]
            upcoming[kind] = follows[event]
            out.epoch[event] = k
            tau = 0.0 * t[0] + events.tau[event]
            in_time = True
            if kind == FIX and latency_at >= 0:
                tau = t[k] - (events.t[event] - x[place[latency_at]])
                tau = where(tau < plan.tolerance, 0.0, tau)
                in_time = any_of(tau <= LATE_STEPS * (t[k] - t[k - 1]))
                fill_trend(past, k, (t[k] - t[0]) / k, trend)
            if kind == FIX and installed:
                fill_rate(t, gyro, seen, past, k, tau, plan.around, trend[9:])
            if in_time:
                dt = t[k] - t[k - 1]
                for i in range(3):
                    lever[i] = plan.lever[i]
                    if lever_at >= 0:
                        lever[i] += x[place[lever_at + i]]
                    if clock_at >= 0 and i < 2:
                        clock[i] = x[place[clock_at + i]]
                    mean_rate[i] = rate_sum[kind, i] / max(rate_count[kind], 1)
                moment = Moment(
                    nav, nav_before, dt, tau, rate, rate1, mean_rate, rate_count[kind], white_step, c_of, axis, lever, lever_at,
                    latency_at, clock, clock_at, trend,
                )  # fmt: skip
                fill_rows(kind, moment, events.z[event], events.settings[event], rows)
                if kind == FIX and latency_at >= 0:
                    at = place[latency_at]
                    add_curvature(trend, E[at * ld + at], nu, R)
                for i in range(width):
                    used[i] = where(math.isfinite(events.z[event, i] + events.var[event, i]), 1.0, 0.0)
                    if any_of(used[i] > 0.0):
                        R[i, i] += events.var[event, i]
                        out.nu[event, i] = where(used[i] > 0.0, nu[i], out.nu[event, i])
                if store:
                    for i in range(width):
                        for j in range(n):
                            out.H[event, i, j] = H[i, j]
                gather(E, place, P)
                free = -math.inf
                if kind == FIX:
                    free = where(t[k] - rejected_from >= plan.timeout, math.inf, -math.inf)
                changed = Update(
                    P, P_before, dx, out.S[event], out.K[event if store else 0], nav_moved, before_moved, room, scale
                )
                nis, dof, ok, bad = absorb(
                    carry,
                    changed,
                    kind,
                    moment,
                    events.z[event],
                    events.var[event],
                    events.settings[event],
                    rows,
                    used,
                    plan.thresholds,
                    free,
                )
                if _failed(status, bad, 2):
                    return node
                if kind == FIX:
                    rejected = where(ok > 0.0, math.inf, min(rejected_from, t[k]))
                    rejected_from = where(dof > 0.0, rejected, rejected_from)
                out.nis[event], out.dof[event], out.ok[event] = nis, dof, ok
                if any_of(ok > 0.0):
                    settle(carry.coordinates, nav, P, dx)
                    for s in range(m):
                        x[place[9 + s]] -= dx[9 + s]
                    if installed:
                        take_off(nav_before, dx)
                        motion_change(mid, f_n, dx, c_of, axis, moved)
                        for i in range(3):
                            rate[i] += moved[3 + i]
                            rate1[i] += moved[3 + i]
                            seen[i] -= moved[3 + i]
                        for j in range(window):
                            for i in range(6):
                                past[j, i] += moved[i]
                        if kind == FIX:
                            for i in range(3):
                                lever[i] = plan.lever[i]
                                if lever_at >= 0:
                                    lever[i] += x[place[lever_at + i]]
                                trend[i] += moved[i]
                                trend[9 + i] += moved[3 + i]
                            fill_rows(kind, moment, events.z[event], events.settings[event], rows_after)
                            turn(P, H, rows_after.H, used)
                    if _failed(status, first_bad_pivot(P, L), 1):
                        return node
                    scatter(P, place, ok, E)
                    for i in range(n):
                        node_total[i] += dx[i]
        if is_node:
            gather(E, place, P)
            out.node_at[node] = k
            for i in range(n):
                out.node_dx[node, i] = node_total[i]
                for j in range(n):
                    out.after[node, i, j] = P[i, j]
            for i in range(10):
                out.node_nav[node, i] = nav[i]
            for s in range(m):
                out.node_x[node, s] = x[place[9 + s]]
            reset_transition(A, end)
            node += 1
        if is_planned:
            planned += 1
        if cov < plan.cov_epoch.size and plan.cov_epoch[cov] == k:
            gather(E, place, out.P[cov])
            cov += 1
        if k % plan.output_every == 0 or k == epochs - 1:
            for i in range(10):
                out.nav[row, i] = nav[i]
            for i in range(n):
                out.var[row, i] = E[place[i] * ld + place[i]]
            for s in range(m):
                out.x[row, s] = x[place[9 + s]]
            row += 1
    for i in range(10):
        _failed(status, where(math.isfinite(nav[i]), -1.0, epochs - 1.0), 3)
    gather(E, place, P)
    _failed(status, first_bad_pivot(P, L), 1)
    return node
