"""Lever arm estimated alone and together with the latency: the filter knows its error however old a fix is at its stamp.

``python -m tests.test_filters_latency`` prints the table for the cases below.
"""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from scipy import stats

from insemu import earth, rotation, strapdown
from insemu.filters import Extras, FilterOptions, InitialSigma, LooselyCoupledEKF, measurements, run_filter
from insemu.filters.reference import reference_run
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, START_SIGMA
from tests.test_filters import BOUNDS, agreement

#: 1.64 m from the IMU to the antenna.
LEVER = (1.2, -0.6, -0.94)
AT = tuple(np.arange(10.0, 60.0, 10.0))


#: Standard deviation of the latency between receivers, s, about what the filter starts with.
BELIEVED = 0.05


def test_an_arm_that_shakes_goes_back_to_the_fix_by_the_rate_since_then() -> None:
    """By the rate at the fix it was 4 mm off just behind a sample, nearly a step before the next one."""
    f, size, arm, every = 31.7, 5e-3, np.array([0.6, 0.0, 0.0]), 10
    t = DT * np.arange(round(20.0 / DT) + 1)

    def angle(t: np.ndarray) -> np.ndarray:
        return size * np.sin(2.0 * np.pi * f * t)

    fine = (np.arange(50) + 0.5) / 50.0
    middle = angle(t[:-1, None] + DT * fine)
    gravity, zero = float(earth.gravity(0.8, 0.0)), np.zeros(t.size)
    force = -gravity * DT * np.stack([-np.sin(middle).mean(axis=1), 0.0 * t[1:], np.cos(middle).mean(axis=1)], axis=1)
    gyro = np.stack([zero, np.diff(angle(t), prepend=0.0), zero], axis=1)
    # the Earth's rotation, which a level body hardly sees the vibration of
    rate = earth.RATE * np.array([np.cos(0.8), 0.0, -np.sin(0.8)])
    imu = ImuRecord(t, gyro + DT * rate, np.vstack([force[:1], force]), "increment")
    for late in (1e-6, 0.5 * DT, DT - 1e-6):
        at = t[every:-2:every] + late
        ned = np.stack([arm[0] * np.cos(angle(at)), 0.0 * at, -arm[0] * np.sin(angle(at))], axis=1)
        llh = earth.move(np.tile([0.8, 0.0, 0.0], (at.size, 1)), ned)
        gnss = GnssRecord(at, llh, None, np.full((at.size, 3), 1e3))
        state = NavState(np.array([0.8, 0.0, 0.0]), np.zeros(3), np.zeros(3))
        options = FilterOptions(store="fixes")
        r = run_filter(imu, gnss, state, InitialSigma(1.0, 0.1, 1e-3), MODEL_15, lever_arm=arm, options=options)
        off = r.fixes.innovation[:, 2]
        slow = np.polynomial.Polynomial.fit(at, off, 3)(at)  # free of fixes the height drifts
        assert np.abs(off - slow).max() < (
            1e-5 if late != 0.5 * DT else 1.5e-3
        )  # between samples only the mean is known


def study(
    latency: float | None, vibration: float, every: int, runs: int, *, skip: float = 5.0, matched: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """NEES of navigation, lever arm and latency, (runs, epochs), of the latency alone, and the errors of the latency.

    ``latency``: None where fixes are stamped when they are valid and the lever arm alone is estimated; then NEES of the arm alone and its error
    along itself (negative: pulled towards zero).
    ``matched``: latencies are drawn as the filter believes them, about ``latency``. Otherwise all are ``latency`` and the filter starts at zero with
    0.1 s: what it has not learnt of a latency that is large for its belief is an error that it does not know.
    """
    sigma = BELIEVED if matched else 0.1
    road = cases.later(cases.drive(60.0 + skip, vibration=vibration), skip)
    extras = Extras(lever_arm=0.1) if latency is None else Extras(lever_arm=0.1, latency=sigma)
    options = FilterOptions(extras=extras, covariance_at=AT, output_every=1000)
    ekf = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER, options=options)
    rows = np.round(np.array(AT) / DT).astype(int)
    at = [*range(9), *range(ekf.layout["lever_arm"].start, ekf.layout.n)]
    whole, alone, missed = (np.empty((runs, len(AT))) for _ in range(3))
    first = np.zeros(ekf.layout.n - 9)
    if latency is not None and matched:
        first[-1] = latency
    for run, child in enumerate(np.random.default_rng(11).spawn(runs)):
        true_arm = np.array(LEVER) + 0.1 * child.standard_normal(3)
        imu = cases.corrupt(road.imu, MODEL_15, child)
        late = latency or 0.0
        if latency is not None and matched:
            late += BELIEVED * child.standard_normal()
        gnss = cases.late_fixes(road, child, latency=late, lever_arm=tuple(true_arm), every=every)
        r = ekf.run(imu, gnss, cases.start(road, child), START_SIGMA, initial_states=first)
        pick = np.searchsorted(r.t, np.array(AT) - 1e-9)
        error = np.zeros((len(AT), ekf.layout.n))
        error[:, :9] = strapdown.navigation_errors(r.nav[pick], road.nav[rows])
        arm = at[9] - 9
        error[:, at[9:12]] = r.imu_states[pick][:, arm : arm + 3] + LEVER - true_arm
        if latency is not None:
            error[:, at[12]] = r.imu_states[pick][:, -1] - late
        P = r.covariance[:, at][:, :, at]
        whole[run] = _nees(error[:, at], P)
        alone[run] = (
            _nees(error[:, at[9:12]], P[:, 9:12, 9:12]) if latency is None else _nees(error[:, at[12:]], P[:, 12:, 12:])
        )
        missed[run] = error[:, at[9:12]] @ true_arm / np.linalg.norm(true_arm) if latency is None else error[:, at[12]]
    return whole, alone, missed


def _nees(error: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Over the number of errors."""
    return np.asarray(np.einsum("ki,kij,kj->k", error, np.linalg.inv(P), error)) / error.shape[1]


#: Latency in s, vibration in m/s^2, steps from fix to fix (5 Hz and 1 Hz).
CASES = [(0.005, 0.0, 20), (0.08, 0.0, 20), (0.2, 0.0, 20), (0.15, 0.5, 20), (0.08, 0.0, 100), (0.2, 0.0, 100)]


#: Share of false alarms of one case, its bounds (all errors, the latency alone, its mean), and its runs.
SHARE, CELLS, RUNS = 2e-5, 3, 12


@pytest.mark.parametrize(("latency", "vibration", "every"), CASES)
@statistical(
    SHARE,
    CELLS,
    power=min(
        chi_square_power(13 * RUNS, SHARE, CELLS, 2.0),  # half the error variance believed
        chi_square_power(RUNS, SHARE, CELLS, 9.0),  # a third of the latency's error believed
        float(stats.norm.sf(stats.norm.isf(0.5 * SHARE / CELLS) - 2.0 * np.sqrt(RUNS))),  # all off by two sigmas
    ),
)
def test_latency_with_lever_arm_is_consistent(latency, vibration, every):
    whole, alone, missed = study(latency, vibration, every, RUNS)
    # epochs of a run depend on each other: judged at the last one
    low, high = chi_square(13 * RUNS, SHARE, CELLS)
    assert low < whole[:, -1].mean() < high
    low, high = chi_square(RUNS, SHARE, CELLS)
    assert low < alone[:, -1].mean() < high
    stated = np.sqrt(np.mean(missed[:, -1] ** 2 / alone[:, -1]) / RUNS)
    assert abs(missed[:, -1].mean()) < stats.norm.isf(0.5 * SHARE / CELLS) * stated


#: Runs of the test of the lever arm alone, at 10 Hz, where what is asked is hardest.
ARM_RUNS = 20


@statistical(
    SHARE,
    2,
    power=min(
        chi_square_power(12 * ARM_RUNS, SHARE, 2, 1.8),  # what it was with the gyroscopes' noise in the derivative
        chi_square_power(3 * ARM_RUNS, SHARE, 2, 4.0),
    ),
)
def test_the_lever_arm_alone_is_consistent():
    whole, alone, _ = study(None, 0.0, 10, ARM_RUNS)
    low, high = chi_square(12 * ARM_RUNS, SHARE, 2)
    assert low < whole[:, -1].mean() < high
    low, high = chi_square(3 * ARM_RUNS, SHARE, 2)
    assert low < alone[:, -1].mean() < high


def test_a_latency_beyond_belief_is_found_short():
    """Two standard deviations from where the filter starts, at 1 Hz: short by more than its standard error, less and less."""
    missed = study(0.2, 0.0, 100, 12, matched=False)[2].mean(axis=0)
    assert missed[0] < -0.02 and missed[0] < missed[-1] < 0.0


@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_the_reference_filter_moves_fixes_alike(sigma):
    """With the latency as a state and without it, where only the lever arm is one."""
    late = 0.143 if sigma else 0.0
    road = cases.drive(12.0)
    rng = np.random.default_rng(4)
    imu = cases.corrupt(road.imu, MODEL_15, rng)
    gnss = cases.late_fixes(road, rng, latency=late, lever_arm=LEVER)
    options = FilterOptions(extras=Extras(lever_arm=0.1, latency=sigma), covariance_at=(2.0, 6.0, 12.0))
    ekf = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER, options=options)
    start = cases.start(road, rng)
    a, b = (f(imu, gnss, start, START_SIGMA) for f in (ekf.run, lambda *x: reference_run(ekf, *x)))
    np.testing.assert_array_equal(a.fixes.epoch, b.fixes.epoch)
    assert (np.array(agreement(a, b)) < BOUNDS).all()
    # used at their own time, the latency that was learnt before the stamp
    used = (a.fixes.t - a.t[a.fixes.epoch])[-10:]
    assert np.abs(used - late).max() < 0.02


def test_the_rate_for_the_derivative_is_neither_late_nor_of_the_innovation():
    """Exact for a rate that changes linearly, at any age of the fix, whatever the two steps measured whose rates the innovation uses."""
    t = np.arange(60) * DT
    rise, seen = np.array([0.7, -0.2, 1.1]), np.array([0.01, 0.02, -0.03, 0.0, 0.0, 0.0])
    true = 0.1 + np.outer(t - 0.5 * DT, rise)  # means over the steps to the epochs
    window, around, rate = 32, 3, np.empty(3)
    for k, tau in ((30, 0.0), (30, 0.4 * DT), (40, 2.4 * DT), (4, 0.3 * DT), (57, 0.9 * DT), (58, 0.0)):
        gyro, past = (true + seen[:3]) * DT, np.zeros((window, 6))
        for j in range(max(1, k - window + 1), k + 1):
            past[j % window, 3:] = true[j]
        for j in (k, k - 1):
            gyro[j], past[j % window] = 9.0, 9.0
        measurements.fill_rate(t, gyro, seen, past, k, tau, around, rate)
        np.testing.assert_allclose(rate, 0.1 + rise * (t[k] - tau), rtol=1e-12)
    # the end of a record: the mean of the steps before
    measurements.fill_rate(t, gyro, seen, past, 59, 0.0, around, rate)
    np.testing.assert_allclose(rate, past[[(59 - 2 - j) % window for j in range(3)], 3:].mean(axis=0))


def _row(every: int, nees: np.ndarray, own: np.ndarray, missed: np.ndarray) -> str:
    """One line of the table, from the fixes' rate on."""
    cells = [" ".join(f"{v:.2f}" for v in figures.mean(axis=0)) for figures in (nees, own)]
    cells.append(" ".join(f"{1e3 * v:.1f}" for v in missed.mean(axis=0)))
    return f"{round(1 / (DT * every)):>3}  {'  '.join(cells)}"


def test_curvature_is_what_a_normal_latency_makes_of_a_bent_path():
    """Position bent by an acceleration, velocity by a jerk: mean and covariance over latencies around the believed one, by quadrature."""
    acceleration, jerk, sigma = np.array([1.5, -0.4, 0.2]), np.array([-3.0, 0.7, 2.0]), 0.05
    late, weight = np.polynomial.hermite_e.hermegauss(6)
    weight /= weight.sum()
    # a fix that is later than believed lies behind: the linear part is the column of H, the rest is along the second derivative
    beyond = 0.5 * np.outer((sigma * late) ** 2, np.concatenate([acceleration, jerk]))
    mean = weight @ beyond
    nu, R = mean + 1.0, np.eye(6)
    trend = np.concatenate([acceleration, np.full(3, 7.0), jerk, np.zeros(3)])
    measurements.add_curvature(trend, sigma**2, nu, R)
    np.testing.assert_allclose(nu, 1.0, rtol=1e-12)
    np.testing.assert_allclose(R - np.eye(6), np.cov(beyond.T, aweights=weight, ddof=0), rtol=1e-9, atol=1e-15)


def test_what_a_fix_sees_keeps_its_covariance_when_the_estimates_move():
    rng = np.random.default_rng(5)
    n, lever, latency = 19, 15, 18
    root = rng.standard_normal((n, n))
    P, (H, H_after) = root @ root.T, np.zeros((2, 6, n))
    C, v = rotation.dcm_from_rpy(rng.standard_normal((2, 3)) * 0.2), rng.standard_normal((2, 6))
    for i, jacobian in enumerate((H, H_after)):
        jacobian[:, :6], jacobian[:, latency] = np.eye(6), -v[i]
        jacobian[:3, lever : lever + 3] = C[i]
        jacobian[3:, 6:9] = rng.standard_normal((3, 3))
    for rows in (np.ones(6, dtype=bool), np.arange(6) < 3):
        turned = P.copy()
        measurements.turn(turned, H, H_after, rows)
        expected = (H @ P @ H.T)[np.ix_(rows, rows)]
        np.testing.assert_allclose((H_after @ turned @ H_after.T)[np.ix_(rows, rows)], expected, rtol=1e-10)
        assert np.abs((H_after @ P @ H_after.T)[np.ix_(rows, rows)] - expected).max() > 0.1
        np.testing.assert_allclose(turned[6:, 6:], P[6:, 6:], rtol=1e-14)
        np.testing.assert_allclose(turned, turned.T, atol=1e-12)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=40)
    asked = parser.parse_args()
    print(
        f"{'latency ms':>10} {'shake m/s^2':>11} {'Hz':>3}  NEES / 13 at {', '.join(f'{t:g}' for t in AT)} s; of the latency alone; mean error, ms"
    )
    for case in [*((*c, True) for c in CASES), (0.2, 0.0, 100, False)]:
        nees, own, missed = study(*case[:3], asked.runs, matched=case[3])
        said = "" if case[3] else "  started at zero with 0.1 s"
        print(f"{1e3 * case[0]:>10g} {case[1]:>11g} {_row(case[2], nees, own, missed)}{said}")
    print(
        "the lever arm alone: NEES / 12; of the arm / 3; mean error along the arm, mm (negative: pulled towards zero)"
    )
    for every in (10, 20, 100):
        print(f"{'known':>10} {0:>11} {_row(every, *study(None, 0.0, every, 4 * asked.runs))}", flush=True)
    for runs, errors in ((asked.runs, (13, 1)), (4 * asked.runs, (12, 3))):
        cells = [f"{dof} errors " + " to ".join(f"{v:.2f}" for v in chi_square(dof * runs, 0.01)) for dof in errors]
        print(f"99 % bounds of one cell, {runs} runs: {'; '.join(cells)}")
