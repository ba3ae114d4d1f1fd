"""Gains of a filter along a reference, from fix to fix: its own covariance needs no data, so the steps in between are one product each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.errors import InputError
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.joint import ideal_fixes, seen_at_truth
from insemu.filters.measurements import update
from insemu.filters.options import InitialSigma
from insemu.filters.results import FilterResult
from insemu.filters.twin import Carried, Intervals, transitions
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Gains:
    """What a filter does at its fixes, with n states.

    Parameters
    ----------
    epoch : (f,) array of int
        Rows of the IMU.
    H, K : (f, 6, n), (f, n, 6) arrays
    used : (f, 6) array of bool
        Components that are measured.
    """

    epoch: Ints
    H: Array
    K: Array
    used: NDArray[np.bool_]

    @classmethod
    def of(cls, run: FilterResult) -> Gains:
        """Those of a run that stored its fixes."""
        fixes = run.fixes
        assert fixes.H is not None and fixes.K is not None
        used = np.asarray(np.isfinite(fixes.innovation), dtype=np.bool_)
        return cls(fixes.epoch, fixes.H, np.nan_to_num(fixes.K), used)


def on_ideal_data(
    ekf: LooselyCoupledEKF,
    record: ImuRecord,
    nav: Array,
    gnss: GnssRecord,
    initial: NavState,
    believed_sigma: InitialSigma,
    times: Array,
) -> tuple[LooselyCoupledEKF, FilterResult]:
    """The filter without what depends on the data, and its run on noise-free data: the gains that it will use, linearised about the truth.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    record : ImuRecord
        Ideal increments.
    nav : (n, 10) array
        The truth at its rows.
    gnss : GnssRecord
        Where and when there are fixes.
    initial : NavState
    believed_sigma : InitialSigma
    times : (o,) array
        At which covariances are kept, s.
    """
    ekf = ekf.with_options(
        gate=None, standstill=None, store="fixes", node_every=None, output_every=1_000, covariance_every=1,
        covariance_at=tuple(times),
    )  # fmt: skip
    # in lanes, like the realizations, so that one compiled kernel serves both
    (run,) = ekf.run_many([record], [ideal_fixes(ekf, record, nav, gnss)], [initial], believed_sigma)
    if isinstance(run, InputError):
        raise run
    return ekf, run


def gains_along(
    ekf: LooselyCoupledEKF,
    record: ImuRecord,
    nav: Array,
    gnss: GnssRecord,
    start: tuple[NavState, InitialSigma],
    rows: Ints,
    along: tuple[Intervals, Carried],
) -> tuple[Gains, Array]:
    """The gains of :func:`on_ideal_data` without its steps, and the covariance (o, n, n) that the filter states at some rows.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
    record : ImuRecord
        Ideal increments.
    nav : (n, 10) array
        The truth at its rows.
    gnss : GnssRecord
        Where and when there are fixes.
    start : (NavState, InitialSigma)
        True start, and how well the filter believes to know it.
    rows : (o,) array of int
        Nodes, increasing.
    along : (Intervals, Carried)
        With nodes at all fixes and rows, and what the filter's own states do along them.

    Raises
    ------
    InputError
        An innovation whose covariance is not positive definite.
    """
    intervals, belief = along
    if max(ekf.installation()) >= 0:  # what sees such states depends on the run
        _, run = on_ideal_data(ekf, record, nav, gnss, *start, record.t[rows])
        return Gains.of(run), run.covariance[np.searchsorted(run.covariance_t, record.t[rows])]
    events = ekf.events(record.t, gnss)
    _, H, R = seen_at_truth(ekf, record, nav, events)
    used = np.isfinite(events.z) & np.isfinite(events.var)
    noise = R + np.where(used, events.var, 0.0)[:, :, None] * np.eye(6)
    against = np.where(
        np.arange(ekf.layout.n) < 9, -1.0, 1.0
    )  # errors of the estimates act on navigation with the other sign than states
    K, out = np.zeros((len(H), ekf.layout.n, 6)), np.empty((rows.size, ekf.layout.n, ekf.layout.n))
    starts = np.searchsorted(intervals.at(events.epoch), np.arange(intervals.nodes.size + 1))
    fixes = _Fixes(starts.astype(np.int64), H, noise, used.astype(np.float64))
    Q, P0 = belief.noise * np.outer(against, against), ekf.initial_covariance(start[1])
    bad = _gains(transitions(intervals, belief), Q, fixes, intervals.at(rows), P0, K, out)
    if bad >= 0:
        raise InputError(f"the innovation covariance is not positive definite in component {bad}")
    return Gains(events.epoch, H, K, used), out


class _Fixes(NamedTuple):
    """Fixes by node: those of node k are ``starts[k]`` to ``starts[k + 1]``; ``H`` (f, 6, n), ``R`` (f, 6, 6), components ``used`` (f, 6)."""

    starts: Ints
    H: Array
    R: Array
    used: Array


@njit(cache=True, nogil=True)
def _gains(T: Array, noise: Array, fixes: _Fixes, asked: Ints, P: Array, K: Array, out: Array) -> int:
    """Move ``P`` (n, n) from node to node: ``K`` (f, n, 6) at the fixes, ``out`` (o, n, n) at the nodes ``asked``; -1, or a bad component."""
    starts, H, R, used = fixes
    n = P.shape[0]
    B, nu, dx, S, no_gate = np.empty((n, n)), np.zeros(6), np.empty(n), np.empty((6, 6)), np.full(7, np.inf)
    row = 0
    for node in range(T.shape[0] + 1):
        if node > 0:
            F, Q = T[node - 1], noise[node - 1]
            for i in range(n):
                for j in range(n):
                    B[i, j] = 0.0
                for k in range(n):
                    if F[i, k] != 0.0:
                        for j in range(n):
                            B[i, j] += F[i, k] * P[k, j]
            for i in range(n):
                for j in range(i, n):
                    x = Q[i, j]
                    for k in range(n):
                        x += B[i, k] * F[j, k]
                    P[i, j] = x
                    P[j, i] = x
        for f in range(starts[node], starts[node + 1]):
            _, _, _, bad = update(P, nu, H[f], R[f], used[f], no_gate, math.inf, dx, S, K[f])
            if bad >= 0.0:
                return int(bad)
        while row < asked.size and asked[row] == node:
            out[row] = P
            row += 1
    return -1
