"""Accuracy without Monte Carlo: the covariance of the true errors of a filter that believes something else, and where it comes from.

A linear filter's gains do not depend on the data. One run of the filter on noise-free data gives them; the true errors, the filter's
estimates and the true sensor states then form one linear system (Gelb 1974, chapter 7). Its covariance, forward in time, is the mean-square
error of any belief under any truth. Its adjoint, backward from one error at one epoch, tells what each noise sample and each initial error
contributes, so the parts of an error budget come from a single pass and add up to the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import rotation
from insemu.augment import Augmentation, Belief, StateLayout, augment, per_axis
from insemu.errors import InputError
from insemu.filters import Gains, InitialSigma, JointSystem, LooselyCoupledEKF, error_maps, on_ideal_data
from insemu.noise import shared_processes
from insemu.records import AXES, GnssRecord, ImuRecord
from insemu.strapdown import NavState, mechanize_array

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


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
        ``initial position`` ..., ``gyro_x WN``, ``gyro_x GM1``, ..., ``shared warmth`` (of all axes that see it), ..., ``fixes``.
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
    believed : (o, 9, 9) array
        The filter's own covariance at these epochs.
    budgets : tuple of Budget
        One per epoch asked for.
    system : JointSystem
        Errors, estimates and true states.
    start : (9 + m, 9 + m) array
        Their covariance at the first row of the IMU.
    """

    layout: StateLayout
    t: Array
    believed: Array
    budgets: tuple[Budget, ...]
    system: JointSystem
    start: Array

    @cached_property
    def actual(self) -> Array:
        """Mean-square error matrix of the navigation errors, (o, 9, 9); a budget needs none of it."""
        rows = np.searchsorted(self.system.imu.t, self.t).astype(np.int64)
        return self.system.covariance(self.start, rows)[:, :9, :9]

    @property
    def rms(self) -> Array:
        """True rms errors, (o, 9)."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.actual)))

    @property
    def sigma(self) -> Array:
        """What the filter says, (o, 9)."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.believed)))


def with_true_states(belief: Augmentation, truth: Augmentation) -> Augmentation:
    """The filter's estimates (driven by nothing) together with the true states (seen with the other sign).

    Calibration and installation states stand among the estimates only: the truth's are zero, for its sensors have no such errors.
    """
    belief.require_constant("the covariance analysis")
    truth.require_constant("the covariance analysis")
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
        reference_temperature=belief.reference_temperature,
    )


def analyse(
    ekf: LooselyCoupledEKF,
    truth: Belief,
    imu: ImuRecord,
    gnss: GnssRecord,
    initial: NavState,
    believed_sigma: InitialSigma,
    *,
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
    believed_sigma : InitialSigma
        Of the initial errors, which are true, too.
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
    record = imu.as_increments()
    t = record.t
    nav = mechanize_array(record, initial, gravity=ekf.gravity)
    times = np.arange(t[0], t[-1] + 1e-9, 1.0) if at is None else np.asarray(at, dtype=np.float64)
    rows = np.searchsorted(t, times - 1e-9).clip(0, t.size - 1).astype(np.int64)
    ekf, run = on_ideal_data(ekf, record, nav, gnss, initial, believed_sigma, times)
    true_aug = augment(truth, ekf.dt)
    joint = with_true_states(ekf.augmentation, true_aug)
    M, K, noise = updates(ekf, Gains.of(run), record, nav, joint, gnss, true_gnss_sigma)
    R = K @ noise @ K.transpose(0, 2, 1)
    system = JointSystem(joint, record, error_maps(record, nav, ekf.gravity), run.fixes.epoch, M, R)
    sigma0 = believed_sigma.to_array()
    P0 = np.zeros((9 + joint.m,) * 2)
    P0[:9, :9], P0[9:, 9:] = np.diag(sigma0**2), joint.P0
    believed = run.covariance[np.searchsorted(run.covariance_t, t[rows])][:, :9, :9]
    sources = _sources(truth, true_aug, ekf.augmentation.m)
    budgets = tuple(_budget(system, when, budget_states, ekf.layout, sigma0, sources) for when in budget_at)
    return CovarianceAnalysis(ekf.layout, t[rows], believed, budgets, system, P0)


def _budget(
    system: JointSystem,
    when: float,
    states: Sequence[str],
    layout: StateLayout,
    sigma0: Array,
    sources: tuple[Ints, list[str]],
) -> Budget:
    """Mean-square error of some navigation states at one epoch, part by part."""
    source, names = sources
    t, P0 = system.imu.t, system.states.P0
    last = int(np.searchsorted(t, when - 1e-9).clip(0, t.size - 1))
    columns = []
    for state in states:
        L = np.zeros(9 + system.states.m)
        L[layout.index(state)] = 1.0
        if layout.index(state) >= 9:
            raise InputError(f"'{state}' is not a navigation error; a budget is made of the nine of them")
        initial, parts, axes, fixes = system.adjoint(last, L, source, len(names))
        np.add.at(parts, source, (initial[9:, None] * P0 * initial[None, 9:]).sum(axis=1))
        start = ((initial[:9] * sigma0) ** 2).reshape(3, 3).sum(axis=1)
        columns.append(np.concatenate([start, axes, parts, [fixes]]))
    labels = [f"initial {what}" for what in ("position", "velocity", "attitude")]
    labels += [*(f"{a} WN" for a in AXES), *names, "fixes"]
    table = np.stack(columns, axis=1)
    keep = [i for i, row in enumerate(table) if row.any()]
    return Budget(float(t[last]), tuple(states), tuple(labels[i] for i in keep), table[keep])


def updates(
    ekf: LooselyCoupledEKF,
    gains: Gains,
    imu: ImuRecord,
    nav: Array,
    joint: Augmentation,
    gnss: GnssRecord,
    true_sigma: tuple[ArrayLike, ArrayLike] | None,
) -> tuple[Array, Array, Array]:
    """Joint updates of every fix: ``z <- M z + K n`` with the covariance of the noise n.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    gains : Gains
        Of the filter along the truth.
    imu : ImuRecord
        Ideal increments.
    nav : (n, 10) array
        The truth at its rows.
    joint : Augmentation
        Of :func:`beside`.
    gnss : GnssRecord
    true_sigma : (position, velocity) or None
        True standard deviations of the fixes, m and m/s; None: as believed.

    Returns
    -------
    M, K, noise : (f, 9 + m, 9 + m), (f, 9 + m, 6), (f, 6, 6) arrays
    """
    epoch, n, nb = gains.epoch, 9 + joint.m, ekf.layout.n
    installed = 9 + np.flatnonzero(joint.axis < 0)
    K = np.zeros((epoch.size, n, 6))
    K[:, :nb] = gains.K
    Hz = np.zeros((epoch.size, 6, n))
    Hz[:, :, :9], Hz[:, :, installed] = gains.H[:, :, :9], gains.H[:, :, installed]
    events = ekf.events(imu.t, gnss)
    var = events.var.copy()
    if true_sigma is not None:
        var[:, :3] = np.broadcast_to(np.asarray(true_sigma[0], dtype=np.float64), (3,)) ** 2
        var[:, 3:] = np.broadcast_to(np.asarray(true_sigma[1], dtype=np.float64), (3,)) ** 2
    noise = np.zeros((epoch.size, 6, 6))
    noise[:, range(6), range(6)] = np.where(gains.used, var, 0.0)
    X = -rotation.dcm_from_quaternion(nav[epoch, 6:10]) @ rotation.skew(ekf.lever_arm)
    # rate errors in the velocity of the arm: true minus estimated sensor error, as u in the loop
    swung = X @ joint.output(np.hstack(joint.sensed(imu))[epoch] / imu.widths(0.0)[epoch])[..., :3, :]
    Hz[:, 3:, 9:] -= swung
    Hz[:, :3, 9:] += events.tau[:, None, None] * swung
    shift = 0.5 - np.minimum(events.tau / ekf.dt, 1.0)
    spread = ((1 + shift) ** 2 + shift**2)[:, None, None]
    noise[:, 3:, 3:] += spread * ((X * joint.white[:3]) @ X.transpose(0, 2, 1))
    Hz *= gains.used[:, :, None]
    M = K @ Hz
    np.negative(M, out=M)
    M[:, range(n), range(n)] += 1.0
    return M, K, noise


def _sources(truth: Belief, aug: Augmentation, mb: int) -> tuple[Ints, list[str]]:
    """For each augmented state, the number of the true process it belongs to; names of those."""
    names: list[str] = []
    source = np.zeros(mb + aug.m, dtype=np.int64)  # the filter's own estimates are driven by nothing
    models = per_axis(truth)
    common = {
        (seen.axis, f"{seen.process.symbol}{index}"): f"shared {label}"
        for label, members in shared_processes(models).items()
        for seen in members
        for place, (index, _) in enumerate(models[seen.axis].indexed())
        if place == seen.place
    }
    for axis in models:
        part = aug.layout[axis]
        for s in range(part.start, part.stop):
            own = aug.layout.names[s].split(".")[1]
            name = common.get((axis, own), f"{axis} {own}")
            if name not in names:
                names.append(name)
            source[mb + s - 9] = names.index(name)
    return source, names or [""]
