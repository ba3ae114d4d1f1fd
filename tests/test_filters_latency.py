"""Latency estimated together with the lever arm: the filter knows its error however old a fix is at its stamp.

``python -m tests.test_filters_latency`` prints the table for the cases below.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from insemu import strapdown
from insemu.filters import Extras, FilterOptions, LooselyCoupledEKF
from insemu.filters.reference import reference_run
from tests import filter_cases as cases
from tests.filter_cases import DT, MODEL_15, START_SIGMA
from tests.test_filters import BOUNDS, agreement

#: 1.64 m from the IMU to the antenna.
LEVER = (1.2, -0.6, -0.94)
AT = tuple(np.arange(10.0, 60.0, 10.0))


def study(latency: float, vibration: float, runs: int, skip: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """NEES of navigation, lever arm and latency (13 errors), (runs, epochs), and of the latency alone."""
    road = cases.later(cases.drive(60.0 + skip, vibration=vibration), skip)
    ekf = LooselyCoupledEKF(
        MODEL_15,
        DT,
        lever_arm=LEVER,
        options=FilterOptions(extras=Extras(lever_arm=0.1, latency=0.1), covariance_at=AT, output_every=1000),
    )
    rows = np.round(np.array(AT) / DT).astype(int)
    at = [*range(9), *range(ekf.layout["lever_arm"].start, ekf.layout.n)]
    whole, alone = np.empty((runs, len(AT))), np.empty((runs, len(AT)))
    for run, child in enumerate(np.random.default_rng(11).spawn(runs)):
        true_arm = np.array(LEVER) + 0.1 * child.standard_normal(3)
        imu = cases.corrupt(road.imu, MODEL_15, child)
        gnss = cases.late_fixes(road, child, latency=latency, lever_arm=tuple(true_arm))
        r = ekf.run(imu, gnss, cases.start(road, child), START_SIGMA)
        pick = np.searchsorted(r.t, np.array(AT) - 1e-9)
        error = np.zeros((len(AT), ekf.layout.n))
        error[:, :9] = strapdown.navigation_errors(r.nav[pick], road.nav[rows])
        error[:, at[9:12]] = r.imu_states[pick][:, -4:-1] + LEVER - true_arm
        error[:, at[12]] = r.imu_states[pick][:, -1] - latency
        P = r.covariance[:, at][:, :, at]
        whole[run] = np.einsum("ki,kij,kj->k", error[:, at], np.linalg.inv(P), error[:, at]) / len(at)
        alone[run] = error[:, at[12]] ** 2 / P[:, 12, 12]
    return whole, alone


def bounds(dof: int, confidence: float) -> tuple[float, float]:
    low, high = stats.chi2.ppf([0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], dof) / dof
    return float(low), float(high)


CASES = [(0.005, 0.0), (0.08, 0.0), (0.2, 0.0), (0.15, 0.5)]


@pytest.mark.parametrize(("latency", "vibration"), CASES)
def test_latency_with_lever_arm_is_consistent(latency, vibration):
    runs = 12
    whole, alone = study(latency, vibration, runs)
    # epochs of a run depend on each other: judged at the last one, at the share of false alarms of four cases and two figures
    low, high = bounds(13 * runs, 1 - 0.01 / 8)
    assert low < whole[:, -1].mean() < high
    low, high = bounds(runs, 1 - 0.01 / 8)
    assert low < alone[:, -1].mean() < high


def test_the_reference_filter_moves_fixes_alike():
    road = cases.drive(12.0)
    rng = np.random.default_rng(4)
    imu = cases.corrupt(road.imu, MODEL_15, rng)
    gnss = cases.late_fixes(road, rng, latency=0.143, lever_arm=LEVER)
    options = FilterOptions(extras=Extras(lever_arm=0.1, latency=0.1), covariance_at=(2.0, 6.0, 12.0))
    ekf = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER, options=options)
    start = cases.start(road, rng)
    a, b = (f(imu, gnss, start, START_SIGMA) for f in (ekf.run, lambda *x: reference_run(ekf, *x)))
    np.testing.assert_array_equal(a.fixes.epoch, b.fixes.epoch)
    assert (np.array(agreement(a, b)) < BOUNDS).all()
    # used at their own time, the latency that was learnt before the stamp
    late = (a.fixes.t - a.t[a.fixes.epoch])[-10:]
    assert np.abs(late - 0.143).max() < 0.02


if __name__ == "__main__":
    print(
        f"{'latency ms':>10} {'shake m/s^2':>11}  NEES / 13 at {', '.join(f'{t:g}' for t in AT)} s; of the latency alone"
    )
    for case in CASES:
        nees, own = study(*case, 40)
        cells = [" ".join(f"{v:.2f}" for v in figures.mean(axis=0)) for figures in (nees, own)]
        print(f"{1e3 * case[0]:>10g} {case[1]:>11g}  {cells[0]}  {cells[1]}")
    cells = [" to ".join(f"{v:.2f}" for v in bounds(dof * 40, 0.99)) for dof in (13, 1)]
    print(f"99 % bounds of one cell, 40 runs: {cells[0]}, {cells[1]}")
