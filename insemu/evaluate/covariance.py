"""Accuracy without Monte Carlo: the covariance of the true errors of a filter that believes something else, and where it comes from.

A linear filter's gains do not depend on the data. One run of the filter on noise-free data gives them; the true errors, the filter's
estimates and the true sensor states then form one linear system (Gelb 1974, chapter 7). Its covariance, forward in time, is the mean-square
error of any belief under any truth. Its adjoint, backward from one error at one epoch, tells what each noise sample and each initial error
contributes, so the parts of an error budget come from a single pass and add up to the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.augment import Augmentation, Belief, StateLayout, augment, per_axis
from insemu.errors import InputError
from insemu.filters import FilterResult, InitialSigma, LooselyCoupledEKF
from insemu.filters.ekf import pack
from insemu.filters.expanded import FIRST, LD, MAP_SIZE, fill_map, gather, middle, predict, scatter
from insemu.filters.measurements import fill_fix
from insemu.records import AXES, GnssRecord, ImuRecord
from insemu.strapdown import NavState, fill_dynamics, mechanize_array

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def _maps(t: Array, gyro: Array, accel: Array, nav: Array, gravity: int, w: Array) -> None:
    """Maps of all steps along a reference, (n, 46)."""
    F, C, mid, f_n = np.empty((9, 9)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(1, t.size):
        dt = t[k] - t[k - 1]
        middle(nav[k - 1, 6:10], gyro[k], accel[k], dt, C, mid, f_n)
        fill_dynamics(nav[k - 1], f_n, gravity, F)
        fill_map(F, mid, dt, w[k])


@njit(cache=True, nogil=True)
def _forward(
    t: Array,
    maps: Array,
    P0: Array,
    place: Ints,
    slots: int,
    diagonal: bool,
    d: Array,
    phi: Array,
    offsets: Ints,
    mix: Array,
    q_at: Ints,
    q: Array,
    c0: Array,
    driver: Ints,
    gyro: Array,
    accel: Array,
    white: Array,
    fix_epoch: Ints,
    M: Array,
    R: Array,
    out_epoch: Ints,
    out: Array,
) -> None:
    """Joint covariance along the reference; at a fix ``P <- M P M' + R``. ``c0`` and ``driver`` (m,) as in an augmentation."""
    n = place.size
    E, T = np.zeros((FIRST + 8 * slots + 17) * LD), np.zeros(15 * LD)
    work = np.zeros((8 * slots + 10) * LD)
    P, B = P0.copy(), np.empty((n, n))
    scatter(P, place, E)
    c = np.zeros(LD)
    for s in range(n - 9):
        c[place[9 + s]] = c0[s]
    fix, row = 0, 0
    for k in range(t.size):
        if k > 0:
            half = 0.5 * (t[k] - t[k - 1])
            for s in range(n - 9):
                if driver[s] >= 0:
                    raw = gyro[k, driver[s]] if driver[s] < 3 else accel[k, driver[s] - 3]
                    c[place[9 + s]] = c0[s] * raw / (2.0 * half)
            predict(E, maps[k], half, slots, diagonal, d, phi, offsets, mix, q_at, q, c, white, T, work)
        while fix < fix_epoch.size and fix_epoch[fix] == k:
            gather(E, place, P)
            for i in range(n):
                for j in range(n):
                    x = 0.0
                    for a in range(n):
                        x += M[fix, i, a] * P[a, j]
                    B[i, j] = x
            for i in range(n):
                for j in range(i, n):
                    x = R[fix, i, j]
                    for a in range(n):
                        x += B[i, a] * M[fix, j, a]
                    P[i, j] = x
                    P[j, i] = x
            scatter(P, place, E)
            fix += 1
        while row < out_epoch.size and out_epoch[row] == k:
            gather(E, place, out[row])
            row += 1


@njit(cache=True, nogil=True)
def _backward(
    t: Array,
    maps: Array,
    last: int,
    L: Array,
    Phi: Array,
    Q: Array,
    axis: Ints,
    c0: Array,
    driver: Ints,
    gyro: Array,
    accel: Array,
    source: Ints,
    white: Array,
    fix_epoch: Ints,
    M: Array,
    R: Array,
    gained: Array,
    parts: Array,
    axes: Array,
) -> None:
    """Adjoint of the joint system from epoch ``last`` to the start.

    ``L`` (n,) holds the functional and is overwritten by what the initial errors contribute linearly. ``parts`` (sources,) collects the
    driving noise of the true states by source, ``axes`` (6,) the white noise of the axes, ``gained`` (f,) the noise of every fix.
    """
    n = L.size
    m = n - 9
    u, old, next_x = np.zeros(6), np.zeros(9), np.zeros(m)
    fix = fix_epoch.size - 1
    while fix >= 0 and fix_epoch[fix] > last:
        fix -= 1
    for k in range(last, -1, -1):
        while fix >= 0 and fix_epoch[fix] == k:
            total = 0.0
            for i in range(n):
                for j in range(n):
                    total += L[i] * R[fix, i, j] * L[j]
            gained[fix] += total
            new = np.zeros(n)
            for i in range(n):
                x = L[i]
                if x != 0.0:
                    for j in range(n):
                        new[j] += x * M[fix, i, j]
            L[:] = new
            fix -= 1
        if k == 0:
            break
        w = maps[k]
        half = 0.5 * (t[k] - t[k - 1])
        # the map of expanded.apply_map, transposed: position, velocity, attitude in reverse
        pn, pe, pd = L[0], L[1], L[2]
        vn, ve, vd = L[3] + half * pn, L[4] + half * pe, L[5] + half * pd
        fz, fy, fx = w[24], w[25], w[26]
        sn, se, sd = -fz * ve - fy * vd, fz * vn - fx * vd, fy * vn + fx * ve
        an, ae, ad = L[6] + sn, L[7] + se, L[8] + sd
        old[0] = w[41] * pn + w[43] * pe + w[35] * vn + w[36] * ve + w[37] * vd + w[6] * an + w[7] * ae + w[8] * ad
        old[1] = w[44] * pe
        old[2] = (
            w[42] * pn + w[45] * pe + pd + w[38] * vn + w[39] * ve + w[40] * vd + w[9] * an + w[10] * ae + w[11] * ad
        )
        old[3] = half * pn + w[27] * vn + w[30] * ve + w[33] * vd + w[12] * ae
        old[4] = half * pe + w[28] * vn + w[31] * ve + w[34] * vd + w[13] * an + w[14] * ad
        old[5] = half * pd + w[29] * vn + w[32] * ve + vd
        old[6] = sn + an + w[2] * ae + w[4] * ad
        old[7] = se + ae + w[0] * an + w[5] * ad
        old[8] = sd + ad + w[1] * an + w[3] * ae
        for j in range(3):
            u[j] = w[15 + j] * an + w[18 + j] * ae + w[21 + j] * ad
            u[3 + j] = w[15 + j] * vn + w[18 + j] * ve + w[21 + j] * vd
        for a in range(6):
            axes[a] += u[a] * u[a] * white[a]
        for i in range(9):
            L[i] = old[i]
        # states behind: what they do through the axes in this step, their driving noise, their transition
        for s in range(m):
            if axis[s] >= 0:
                c = c0[s]
                if driver[s] >= 0:
                    raw = gyro[k, driver[s]] if driver[s] < 3 else accel[k, driver[s] - 3]
                    c *= raw / (2.0 * half)
                L[9 + s] -= c * u[axis[s]]
        for i in range(m):
            for j in range(m):
                if Q[i, j] != 0.0:
                    parts[source[i]] += L[9 + i] * Q[i, j] * L[9 + j]
        for j in range(m):
            next_x[j] = 0.0
        for i in range(m):
            x = L[9 + i]
            for j in range(m):
                if Phi[i, j] != 0.0:
                    next_x[j] += x * Phi[i, j]
        for j in range(m):
            L[9 + j] = next_x[j]


@dataclass(frozen=True)
class Budget:
    """Mean-square error of some states at one epoch, by where it comes from.

    Parameters
    ----------
    t : float
        Epoch, s.
    states : tuple of str
        The states, for example ``pos_n``, ``pos_e``.
    sources : tuple of str
        ``initial position`` ..., ``gyro_x WN``, ``gyro_x GM1``, ..., ``fixes``.
    mean_square : (sources, states) array
    """

    t: float
    states: tuple[str, ...]
    sources: tuple[str, ...]
    mean_square: Array

    @property
    def total(self) -> Array:
        """Mean-square error of each state: the sum of the parts."""
        return np.asarray(self.mean_square.sum(axis=0))

    def rms(self) -> float:
        """Root of the sum over the states, for example of the horizontal error."""
        return float(np.sqrt(self.mean_square.sum()))

    def shares(self, by: str = "source") -> dict[str, float]:
        """Mean square summed over the states, by ``source``, by ``axis`` or by ``process`` (all axes together), largest first."""
        out: dict[str, float] = {}
        for name, row in zip(self.sources, self.mean_square, strict=True):
            first, _, rest = name.partition(" ")
            key = name
            if first in AXES:
                key = {"axis": first, "process": f"{first.split('_')[0]} {rest}"}.get(by, name)
            out[key] = out.get(key, 0.0) + float(row.sum())
        return dict(sorted(out.items(), key=lambda item: -item[1]))


@dataclass(frozen=True)
class CovarianceAnalysis:
    """The true covariance of a design's errors, and what the design says about them.

    Parameters
    ----------
    layout : StateLayout
        Of the filter; the analysis speaks of its nine navigation errors.
    t : (o,) array
        Epochs, s.
    actual : (o, 9, 9) array
        Mean-square error matrix of the navigation errors.
    believed : (o, 9, 9) array
        The filter's own covariance at the same epochs.
    budgets : tuple of Budget
        One per epoch asked for.
    """

    layout: StateLayout
    t: Array
    actual: Array
    believed: Array
    budgets: tuple[Budget, ...]

    @property
    def rms(self) -> Array:
        """True rms errors, (o, 9)."""
        return np.sqrt(np.einsum("tii->ti", self.actual))

    @property
    def sigma(self) -> Array:
        """What the filter says, (o, 9)."""
        return np.sqrt(np.einsum("tii->ti", self.believed))


def _joint(belief: Augmentation, truth: Augmentation) -> Augmentation:
    """The filter's estimates (driven by nothing) beside the true states (seen with the other sign).

    Calibration and installation states stand among the estimates only: the truth's are zero, for its sensors have no such errors.
    """
    mb = belief.m

    def both(one: Array, two: Array) -> Array:
        out = np.zeros((mb + truth.m,) * 2)
        out[:mb, :mb], out[mb:, mb:] = one, two
        return out

    return Augmentation(
        layout=truth.layout,
        dt=belief.dt,
        Phi=both(belief.Phi, truth.Phi),
        Q=both(0.0 * belief.Q, truth.Q),
        P0=both(0.0 * belief.P0, truth.P0),
        axis=np.concatenate([belief.axis, truth.axis]),
        c=np.concatenate([belief.c, -truth.c]),
        driver=np.concatenate([belief.driver, truth.driver]),
        white=truth.white,
    )


def analyse(
    ekf: LooselyCoupledEKF,
    truth: Belief,
    imu: ImuRecord,
    gnss: GnssRecord,
    initial: NavState,
    believed_sigma: InitialSigma,
    *,
    true_sigma: InitialSigma | None = None,
    true_gnss_sigma: tuple[ArrayLike, ArrayLike] | None = None,
    at: Sequence[float] | None = None,
    budget_at: Sequence[float] = (),
    budget_states: Sequence[str] = ("pos_n", "pos_e", "pos_d"),
) -> CovarianceAnalysis:
    """Mean-square errors of a design under a truth, without drawing anything.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
        The design: its belief, estimated calibration and installation, lever arm and gravity model.
    truth : mapping of axis to NoiseModel
        What the sensors really do.
    imu : ImuRecord
        Ideal data along the trajectory.
    gnss : GnssRecord
        Where and when there are fixes (the outages are its gaps), with the standard deviations that the filter believes; values are ignored.
    initial : NavState
        True initial state.
    believed_sigma, true_sigma : InitialSigma
        Of the initial errors: what the filter believes, and what is true (the same unless given).
    true_gnss_sigma : (position, velocity), optional
        True standard deviations of the fixes, m and m/s; as believed unless given.
    at : sequence of float, optional
        Epochs of the result, s; every second unless given.
    budget_at : sequence of float
        Epochs at which an error budget is made, after the fix of that epoch if there is one.
    budget_states : sequence of str
        Navigation errors in the budget.

    Returns
    -------
    CovarianceAnalysis

    Raises
    ------
    InputError
        An unknown state.

    Notes
    -----
    Linear in the errors: where they grow so large that the filter's own linearisation fails, so does this. Options that depend on the data play
    no part: gates and standstill updates are off, and the covariance is propagated at full rate. Calibration and installation states that
    the filter estimates are carried; the truth's sensors have no such errors.
    """
    ekf = ekf.with_options(
        gate=None, standstill=None, store="fixes", node_every=None, output_every=1_000, covariance_every=1
    )
    record = imu.as_increments()
    t = record.t
    nav = mechanize_array(record, initial, gravity=ekf.gravity)
    times = np.arange(t[0], t[-1] + 1e-9, 1.0) if at is None else np.asarray(at, dtype=np.float64)
    out_epoch = np.searchsorted(t, times - 1e-9).clip(0, t.size - 1).astype(np.int64)
    run = _gains(ekf, record, gnss, nav, initial, believed_sigma, times)
    nodes, fixes = run.nodes, run.fixes
    assert nodes is not None and fixes.H is not None and fixes.K is not None

    belief_aug, true_aug = ekf.augmentation, augment(truth, ekf.dt)
    joint = _joint(belief_aug, true_aug)
    n, mb = 9 + joint.m, belief_aug.m
    packed = pack(joint, 1)
    sigma0 = (true_sigma or believed_sigma).to_array()
    P0 = np.zeros((n, n))
    P0[:9, :9] = np.diag(sigma0**2)
    P0[9:, 9:] = joint.P0
    M, R = _updates(ekf, run, record, nav, joint, mb, gnss, true_gnss_sigma)
    maps = np.zeros((t.size, MAP_SIZE))
    _maps(t, record.gyro, record.accel, nav, earth.gravity_code(ekf.gravity), maps)
    used = fixes.epoch
    actual = np.empty((out_epoch.size, n, n))
    order = np.argsort(out_epoch, kind="stable")
    _forward(
        t, maps, P0, packed.place, packed.slots, packed.diagonal, packed.d[0], packed.phi[0], packed.offsets, packed.mix[0], packed.q_at,
        packed.q[0], joint.c, joint.driver, record.gyro, record.accel, joint.white, used, M, R, out_epoch[order], actual,
    )  # fmt: skip
    actual[order] = actual.copy()
    believed = run.covariance[np.searchsorted(run.covariance_t, t[out_epoch])][:, :9, :9]

    source, names = _sources(truth, true_aug, mb)
    budgets = []
    for when in budget_at:
        last = int(np.searchsorted(t, when - 1e-9).clip(0, t.size - 1))
        columns = []
        for state in budget_states:
            L = np.zeros(n)
            L[ekf.layout.index(state)] = 1.0
            if ekf.layout.index(state) >= 9:
                raise InputError(f"'{state}' is not a navigation error; a budget is made of the nine of them")
            parts, axes, gained = np.zeros(len(names)), np.zeros(6), np.zeros(used.size)
            _backward(
                t, maps, last, L, joint.Phi, joint.Q, joint.axis, joint.c, joint.driver, record.gyro, record.accel, source, joint.white, used,
                M, R, gained, parts, axes,
            )  # fmt: skip
            initial_x = L[9:, None] * joint.P0 * L[None, 9:]
            for i in range(joint.m):
                parts[source[i]] += initial_x[i].sum()
            start = (L[:9] * sigma0) ** 2
            columns.append(np.concatenate([start.reshape(3, 3).sum(axis=1), axes, parts, [gained.sum()]]))
        labels = (
            "initial position",
            "initial velocity",
            "initial attitude",
            *(f"{a} WN" for a in AXES),
            *names,
            "fixes",
        )
        table = np.stack(columns, axis=1)
        keep = [i for i, row in enumerate(table) if row.any()]
        budgets.append(Budget(float(t[last]), tuple(budget_states), tuple(labels[i] for i in keep), table[keep]))
    return CovarianceAnalysis(ekf.layout, t[out_epoch], actual[:, :9, :9], believed, tuple(budgets))


def _gains(
    ekf: LooselyCoupledEKF,
    imu: ImuRecord,
    gnss: GnssRecord,
    nav: Array,
    initial: NavState,
    sigma: InitialSigma,
    times: Array,
) -> FilterResult:
    """The filter flown on noise-free data: the gains it will use, linearised about the truth."""
    events = ekf.events(imu.t, gnss)
    z = events.z.copy()
    none, zero = np.zeros(0, dtype=np.int64), np.zeros(3)
    nu, H, R = np.empty(6), np.empty((6, 9)), np.empty((6, 6))
    for i, k in enumerate(events.epoch):
        dt, before = imu.t[k] - imu.t[k - 1], max(k - 1, 1)
        rates = imu.gyro[k] / dt, imu.gyro[before] / (imu.t[before] - imu.t[before - 1])
        here = np.concatenate([nav[k, :3], nav[k, 3:6]])
        fill_fix(
            np.append(nav[k], zero), np.append(nav[k - 1], zero), dt,
            events.tau[i], *rates, ekf.lever_arm, np.zeros(6), np.zeros(0), none, -1, -1, np.zeros(9), here, nu, H, R
        )  # fmt: skip
        # what the filter would predict at the truth
        z[i] = np.where(
            np.isfinite(z[i]), np.concatenate([earth.move(nav[k, :3], -nu[:3]), nav[k, 3:6] - nu[3:]]), np.nan
        )
    sd = np.sqrt(events.var)
    ideal = GnssRecord(events.t, z[:, :3], z[:, 3:], sd[:, :3], sd[:, 3:]) if len(events.t) else None
    return ekf.with_options(covariance_at=tuple(times)).run(imu, ideal, initial, sigma)


def _updates(
    ekf: LooselyCoupledEKF,
    run: FilterResult,
    imu: ImuRecord,
    nav: Array,
    joint: Augmentation,
    mb: int,
    gnss: GnssRecord,
    true_sigma: tuple[ArrayLike, ArrayLike] | None,
) -> tuple[Array, Array]:
    """Joint update matrices and noise of every fix: ``z <- M z + noise`` with covariance R."""
    fixes = run.fixes
    assert fixes.H is not None and fixes.K is not None
    f, n = len(fixes), 9 + joint.m
    installed = np.flatnonzero(joint.axis < 0)
    K = np.zeros((f, n, 6))
    K[:, : 9 + mb] = np.nan_to_num(fixes.K)
    Hz = np.zeros((f, 6, n))
    Hz[:, :, :9] = fixes.H[:, :, :9]
    events = ekf.events(imu.t, gnss)
    var = events.var.copy()
    if true_sigma is not None:
        var[:, :3] = np.broadcast_to(np.asarray(true_sigma[0], dtype=np.float64), (3,)) ** 2
        var[:, 3:] = np.broadcast_to(np.asarray(true_sigma[1], dtype=np.float64), (3,)) ** 2
    used = np.asarray(np.isfinite(fixes.innovation), dtype=np.bool_)
    noise = np.zeros((f, 6, 6))
    l0, l1, l2 = ekf.lever_arm
    cross = np.array([[0.0, -l2, l1], [l2, 0.0, -l0], [-l1, l0, 0.0]])
    for k in range(f):
        noise[k] = np.diag(np.where(used[k], var[k], 0.0))
        X = -rotation.dcm_from_quaternion(nav[fixes.epoch[k], 6:10]) @ cross
        e = int(fixes.epoch[k])
        C = joint.output(np.concatenate([imu.gyro[e], imu.accel[e]]) / (imu.t[e] - imu.t[e - 1]))
        Hz[k][:, 9 + installed] = fixes.H[k][:, 9 + installed]
        # rate errors in the velocity of the arm: true minus estimated sensor error, as u in the loop
        Hz[k, 3:, 9:] += -X @ C[:3]
        Hz[k, :3, 9:] += events.tau[k] * X @ C[:3]
        shift = 0.5 - min(events.tau[k] / ekf.dt, 1.0)
        noise[k, 3:, 3:] += ((1 + shift) ** 2 + shift**2) * (X * joint.white[:3]) @ X.T
    Hz *= used[:, :, None]
    M = np.eye(n) - K @ Hz
    return M, K @ noise @ K.transpose(0, 2, 1)


def _sources(truth: Belief, aug: Augmentation, mb: int) -> tuple[Ints, list[str]]:
    """For each state behind, the number of the true process it belongs to; names of those."""
    names: list[str] = []
    source = np.zeros(mb + aug.m, dtype=np.int64)  # the filter's own estimates are driven by nothing
    for axis in per_axis(truth):
        part = aug.layout[axis]
        for s in range(part.start, part.stop):
            name = f"{axis} {aug.layout.names[s].split('.')[1]}"
            if name not in names:
                names.append(name)
            source[mb + s - 9] = names.index(name)
    return source, names or [""]
