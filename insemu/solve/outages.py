"""Automatic outages: from every second of a filter's run the mechanization goes on without fixes, and is held against those that were there.

The filter is not run again: its state and covariance are taken where the outage begins, and the compiled loop carries both on.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters import FIX, FilterResult, LooselyCoupledEKF
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Seconds without fixes after which the error is taken.
HORIZONS = (10.0, 30.0, 60.0)
#: The covariance of an outage is propagated every so many seconds; a fix within this time of the horizon is its reference.
STEP_S, NEAR_S = 0.1, 0.6
#: Outages begin no earlier after the start of the filter, s, and not before its attitude is known to so many times what it is later on.
SETTLED_S, SETTLED_FACTOR = 30.0, 2.0
#: An outage begins where the last fix is no older than so many usual steps of the fixes; a longer step is a gap of the recording itself.
USUAL_STEPS = 1.5
#: Draws of the bootstrap behind an interval.
DRAWS = 1000
#: Gaps of the recording are listed from this length on, s, where they are also five usual steps long.
GAP_S, GAP_STEPS = 2.0, 5.0


@dataclass(frozen=True)
class Outages:
    """Errors after every outage.

    Parameters
    ----------
    start : (k,) array
        When the outages begin, s.
    horizons : (h,) array
        s.
    error : (k, h, 2) array
        North, east of the antenna, estimated minus fix, m; NaN where there is no fix.
    covariance : (k, h, 2, 2) array
        What the filter states of its own error.
    fix_variance : (k, h, 2) array
        Of the fixes' own scatter.
    """

    start: Array
    horizons: Array
    error: Array
    covariance: Array
    fix_variance: Array

    def rms(self, at: int) -> float:
        """Horizontal root mean square error at a horizon, the fixes' own variance subtracted, m; NaN without any outage of that length."""
        squares = self._horizontal(at)[np.isfinite(self.error[:, at, 0])]
        return float(np.sqrt(max(float(squares.mean()), 0.0))) if squares.size else np.nan

    def _horizontal(self, at: int) -> Array:
        """Squared horizontal error of every outage less the fix's own variance, m^2, (k,)."""
        squares: Array = (self.error[:, at] ** 2 - self.fix_variance[:, at]).sum(axis=1)
        return squares

    def stated(self, at: int) -> float:
        """What the filter states of it, m."""
        known = np.isfinite(self.error[:, at, 0])
        return float(np.sqrt(np.einsum("kii->k", self.covariance[known, at]).mean())) if known.any() else np.nan

    def quantiles(self, at: int, shares: Sequence[float] = (0.5, 0.95)) -> list[float]:
        """Quantiles of the horizontal error, m, less the fixes' own scatter in the proportion in which the root mean square is."""
        size = np.hypot(self.error[:, at, 0], self.error[:, at, 1])
        known = size[np.isfinite(size)]
        if not known.size:
            return [np.nan] * len(shares)
        less = self.rms(at) / max(float(np.sqrt(np.mean(known**2))), 1e-300)
        return [less * float(v) for v in np.quantile(known, shares)]

    def _squares(self, at: int) -> tuple[Array, Array]:
        """Normalised squared errors and log determinants of their covariance, to which the fixes' variance is added."""
        known = np.isfinite(self.error[:, at, 0])
        S = self.covariance[known, at] + self.fix_variance[known, at, :, None] * np.eye(2)
        e = self.error[known, at]
        return np.einsum("ki,ki->k", e, np.linalg.solve(S, e[:, :, None])[:, :, 0]), np.linalg.slogdet(S)[1]

    def nees(self, at: int) -> float:
        """Mean normalised squared error per degree of freedom; NaN without any outage of that length."""
        squares, _ = self._squares(at)
        return float(squares.mean() / 2.0) if squares.size else np.nan

    def log_score(self, at: int) -> float:
        """Mean of half of ``e' S^-1 e + log det S``: less is better; NaN without any outage of that length."""
        squares, size = self._squares(at)
        return float(0.5 * (squares + size).mean()) if squares.size else np.nan

    def interval(self, at: int) -> tuple[float, float]:
        """95 % interval of the rms by a circular block bootstrap (Politis and Romano 1992): outages that overlap are not independent."""
        squares = self._horizontal(at)[np.isfinite(self.error[:, at, 0])]
        low, high = np.quantile(np.sqrt(self._drawn(squares[:, None], at)[:, 0]), (0.025, 0.975))
        return float(low), float(high)

    def ratio(self, other: Outages, at: int) -> tuple[float, float, float]:
        """The rms over that of another filter at the same outages, with its 95 % interval: both are drawn with the same blocks.

        Parameters
        ----------
        other : Outages
            That begin at the same seconds.
        at : int
            Which horizon.

        Returns
        -------
        ratio, low, high : float
            NaN where there are too few outages, or where the other filter errs by no more than its fixes.
        """
        known = np.isfinite(self.error[:, at, 0]) & np.isfinite(other.error[:, at, 0])
        pairs = np.column_stack([self._horizontal(at)[known], other._horizontal(at)[known]])
        drawn = self._drawn(pairs, at)
        if pairs[:, 1].sum() <= 0.0 or np.isnan(drawn).any():
            return np.nan, np.nan, np.nan
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = np.nanquantile(np.sqrt(drawn[:, 0] / drawn[:, 1]), (0.025, 0.975))
        one, two = np.maximum(pairs.mean(axis=0), 0.0)
        return float(np.sqrt(one / two)), float(low), float(high)

    def _drawn(self, squares: Array, at: int) -> Array:
        """Means of the columns of (n, k) squares of outages that the bootstrap draws, (:data:`DRAWS`, k), at least 0; NaN of fewer than two blocks.

        Blocks are twice the horizon long, and the last outage is followed by the first, so that all are drawn equally often.
        """
        n, length = len(squares), int(2 * self.horizons[at] / max(self.step, 1e-9)) + 1
        if n < 2 * length:
            return np.full((1, squares.shape[1]), np.nan)
        first = np.random.default_rng(0).integers(0, n, (DRAWS, -(-n // length)))
        rows = (first[:, :, None] + np.arange(length)).reshape(DRAWS, -1)[:, :n] % n
        return np.asarray(np.maximum(squares[rows].mean(axis=1), 0.0))

    def figures(self) -> list[dict[str, Any]]:
        """The score as plain data, one entry per horizon."""
        out: list[dict[str, Any]] = []
        for k, seconds in enumerate(self.horizons):
            middle, high = self.quantiles(k)
            out.append(
                {
                    "seconds": float(seconds),
                    "count": int(np.isfinite(self.error[:, k, 0]).sum()),
                    "median_m": middle,
                    "rms_m": self.rms(k),
                    "rms_ci95_m": list(self.interval(k)),
                    "q95_m": high,
                    "stated_m": self.stated(k),
                    "nees_per_dof": self.nees(k),
                }
            )
        return out

    @property
    def step(self) -> float:
        """Seconds from one outage to the next."""
        return float(np.median(np.diff(self.start))) if self.start.size > 1 else np.inf

    def rows(self, keep: NDArray[np.bool_]) -> Outages:
        """Some of the outages."""
        return Outages(
            self.start[keep], self.horizons, self.error[keep], self.covariance[keep], self.fix_variance[keep]
        )


def cut_everywhere(
    ekf: LooselyCoupledEKF,
    run: FilterResult,
    imu: ImuRecord,
    gnss: GnssRecord,
    *,
    settled: float | None = None,
    every: float = 1.0,
    workers: int = 1,
) -> Outages:
    """Cut an outage at every ``every`` seconds of a run at which a fix was used; its length counts from that fix.

    Parameters
    ----------
    ekf : LooselyCoupledEKF
        The filter of the run.
    run : FilterResult
        With ``FilterOptions(store="fixes", node_every=1.0)``.
    imu : ImuRecord
        What the run was made from, as increments.
    gnss : GnssRecord
        The fixes that outages are held against, with the standard deviations of their own scatter.
    settled : float, optional
        When the first outage may begin, s; :func:`settled_at` of the run where it is left out.
    every : float
        Seconds from one outage to the next.
    workers : int
        Threads.

    Raises
    ------
    InputError
        The run kept no nodes, or is too short for any outage.
    """
    nodes = run.nodes
    if nodes is None or gnss.pos_std_ned is None:
        raise InputError("the run kept no nodes, or the fixes have no standard deviations")
    first = settled_at(run) if settled is None else settled
    begins = np.arange(first, nodes.t[-1] - HORIZONS[0], every)
    rows = np.unique(np.searchsorted(nodes.t, begins - 1e-6).clip(0, len(nodes) - 1))
    since = last_used(run, nodes.t)
    rows = rows[nodes.t[rows] - since[rows] <= USUAL_STEPS * usual_step(run)]
    if not rows.size:
        raise InputError(f"the run is shorter than {SETTLED_S + HORIZONS[0]:g} s, expected room for an outage")
    there = np.flatnonzero(np.isfinite(gnss.llh).all(axis=1))
    step = max(1, round(STEP_S / imu.dt))
    free = ekf.with_options(
        covariance_every=step,
        output_every=10000 * step,
        store="none",
        standstill=None,
        covariance_at=(),
        node_every=None,
    )
    slices = run.layout.slices
    latency = nodes.states[:, slices["latency"].start - 9] if "latency" in slices else np.zeros(len(nodes))
    arm = np.tile(ekf.lever_arm, (len(nodes), 1))
    if "lever_arm" in slices:
        arm = arm + nodes.states[:, slices["lever_arm"].start - 9 : slices["lever_arm"].stop - 9]

    def one(k: int) -> tuple[Array, Array, Array]:
        error, stated, own = (
            np.full((len(HORIZONS), 2), np.nan),
            np.full((len(HORIZONS), 2, 2), np.nan),
            np.full((len(HORIZONS), 2), np.nan),
        )
        at, nav, P, x = int(nodes.epoch[k]), nodes.nav[k], nodes.P_after[k], nodes.states[k]
        for h, horizon in enumerate(HORIZONS):
            j = int(there[np.argmin(np.abs(gnss.t[there] - since[k] - horizon))])
            if abs(gnss.t[j] - since[k] - horizon) > NEAR_S:
                continue
            valid = float(gnss.t[j] - latency[k])
            last = int(np.searchsorted(imu.t, valid - 1e-9))
            if last >= len(imu) or last <= at + 1:
                continue
            state = NavState(nav[:3], nav[3:6], rotation.rpy_from_quaternion(nav[6:10]))
            part = free.run(imu.rows(slice(at, last + 1)), None, state, P, initial_states=x)
            at, nav, P, x = last, part.nav[-1], part.final_covariance, part.imu_states[-1]
            swing = rotation.dcm_from_quaternion(nav[6:10]) @ arm[k]
            antenna = earth.move(nav[:3], nav[3:6] * (valid - imu.t[last]) + swing)
            error[h] = earth.position_difference(antenna, gnss.llh[j])[:2]
            stated[h] = P[:2, :2]
            assert gnss.pos_std_ned is not None
            own[h] = gnss.pos_std_ned[j, :2] ** 2
        return error, stated, own

    with ThreadPoolExecutor(max(1, workers)) as pool:
        found = list(pool.map(one, rows))
    error, stated, own = (np.stack([f[i] for f in found]) for i in range(3))
    return Outages(nodes.t[rows], np.asarray(HORIZONS, dtype=np.float64), error, stated, own)


def settled_at(run: FilterResult) -> float:
    """When a run knows its attitude to :data:`SETTLED_FACTOR` times the median of the second half, s; :data:`SETTLED_S` after the start at least."""
    nodes = run.nodes
    assert nodes is not None
    sigma = np.sqrt(np.maximum(np.einsum("kii->ki", nodes.P_after)[:, 6:9], 0.0))
    good = (sigma <= SETTLED_FACTOR * np.median(sigma[len(sigma) // 2 :], axis=0)).all(axis=1)
    return float(max(nodes.t[0] + SETTLED_S, nodes.t[int(np.argmax(good))]))


def _used(run: FilterResult) -> Array:
    """Times at which the filter took a position, ascending, s."""
    positions = run.fixes.accepted & (run.fixes.kind == FIX) & np.isfinite(run.fixes.innovation[:, 0])
    return np.asarray(run.fixes.t[positions])


def usual_step(run: FilterResult) -> float:
    """Usual time from one position to the next, s; infinite where there are not two."""
    used = _used(run)
    return float(np.median(np.diff(used))) if used.size > 1 else np.inf


def last_used(run: FilterResult, t: Array) -> Array:
    """When the filter took the last position before each of some times.

    Parameters
    ----------
    run : FilterResult
    t : (k,) array
        s.

    Returns
    -------
    (k,) array
        s; -inf where there was none.
    """
    used = np.append(-np.inf, _used(run))
    return used[np.searchsorted(used, t + 1e-6, side="right") - 1]


@dataclass(frozen=True)
class Gap:
    """A time without fixes in the recording itself, and the first fix after it.

    Parameters
    ----------
    start, seconds : float
        Last fix before, and time to the first one after it, s.
    error, stated : float
        Horizontal innovation of that fix and the standard deviation that the filter states of it, m; both hold the fix's own.
    """

    start: float
    seconds: float
    error: float
    stated: float


def gaps_of(run: FilterResult) -> list[Gap]:
    """Gaps between the positions of a run of a filter."""
    f, step = run.fixes, usual_step(run)
    rows = np.flatnonzero(f.accepted & (f.kind == FIX) & np.isfinite(f.innovation[:, :2]).all(axis=1))
    apart = np.diff(f.t[rows])
    found = np.flatnonzero((apart >= GAP_S) & (apart >= GAP_STEPS * step))
    return [
        Gap(
            float(f.t[rows[i]]),
            float(apart[i]),
            float(np.hypot(*f.innovation[rows[i + 1], :2])),
            float(np.sqrt(np.trace(f.S[rows[i + 1], :2, :2]))),
        )
        for i in found
    ]
