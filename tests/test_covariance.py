"""Covariance analysis against Monte Carlo, against the filter itself, and its budget against its whole."""

import time

import numpy as np
import pytest

from insemu import rotation, strapdown
from insemu.errors import InputError
from insemu.evaluate.covariance import analyse
from insemu.filters import Extras, FilterOptions, LooselyCoupledEKF
from insemu.noise import GM, RW, WN
from insemu.strapdown import NavState
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, MODEL_24, MODEL_27, START_SIGMA

WHITE = {"gyro": WN(N=6e-4), "accel": WN(N=1.5e-3)}
OUTAGE = (15.0, 25.0)
LEVER = (1.2, -0.4, -0.9)


def setting(seconds, outages=(OUTAGE,), lever=LEVER):
    road = cases.drive(seconds)
    gnss = cases.fixes(road, np.random.default_rng(0), outages=outages, lever_arm=lever)
    start = NavState(road.nav[0, :3], road.nav[0, 3:6], rotation.rpy_from_quaternion(road.nav[0, 6:]))
    return road, gnss, start


@pytest.mark.parametrize(("lever", "bound"), [((0.0, 0.0, 0.0), 1e-9), (LEVER, 1e-9)], ids=["none", "lever"])
@pytest.mark.parametrize("model", [MODEL_15, MODEL_24, MODEL_27], ids=["15", "24", "27"])
def test_a_matched_belief_has_the_covariance_it_claims(model, lever, bound):
    """But for innovations of a nanometre, which is what places are rounded to."""
    road, gnss, start = setting(30.0, lever=lever)
    a = analyse(LooselyCoupledEKF(model, DT, lever_arm=lever), model, road.imu, gnss, start, START_SIGMA)
    assert len(a.t) == 31
    scale = a.sigma[:, :, None] * a.sigma[:, None, :]
    assert np.abs((a.actual - a.believed) / scale).max() < bound


@pytest.mark.parametrize("belief", [MODEL_24, WHITE], ids=["matched", "white"])
def test_the_parts_of_the_budget_are_the_whole(belief):
    road, gnss, start = setting(30.0)
    at = (12.0, 25.0, 30.0)
    states = ("pos_n", "pos_d", "vel_e", "att_d")
    a = analyse(
        LooselyCoupledEKF(belief, DT, lever_arm=LEVER),
        {**MODEL_24, "gyro_z": WN(N=5e-4) + RW(K=1e-5)},
        road.imu,
        gnss,
        start,
        START_SIGMA,
        at=at,
        budget_at=at,
        budget_states=states,
        true_gnss_sigma=(0.1, 0.02),
    )
    index = [a.layout.index(s) for s in states]
    for budget, whole in zip(a.budgets, a.actual, strict=True):
        np.testing.assert_allclose(budget.total, np.diag(whole)[index], rtol=1e-9)
        for by in ("source", "axis", "process"):
            assert sum(budget.shares(by).values()) == pytest.approx(budget.rms() ** 2, rel=1e-12)
    sources = a.budgets[0].sources
    assert {"initial attitude", "gyro_z RW1", "accel_x GM3", "accel_y WN", "fixes"} <= set(sources)
    assert "gyro_z GM1" not in sources


def monte_carlo(ekf, truth, road, runs, at, outages=(OUTAGE,)):
    rows = np.round(np.array(at) / DT).astype(int)
    errors = np.empty((runs, len(at), 9))
    for i in range(runs):
        rng = np.random.default_rng(7000 + i)
        imu = cases.corrupt(road.imu, truth, rng)
        r = ekf.run(imu, cases.fixes(road, rng, outages=outages, lever_arm=LEVER), cases.start(road, rng), START_SIGMA)
        errors[i] = strapdown.navigation_errors(r.nav[np.searchsorted(r.t, np.array(at) - 1e-9)], road.nav[rows])
    return errors


def inside(errors, analysis, share):
    """Rms of position and velocity within the chi-square interval of the Monte Carlo, family-wise."""
    runs = len(errors)
    ratio = (errors**2).mean(axis=0)[:, :6] / (analysis.rms**2)[:, :6]
    low, high = chi_square(runs, share, ratio.size)
    return (low < ratio) & (ratio < high)


@pytest.mark.parametrize("belief", [MODEL_15, WHITE], ids=["matched", "mismatched"])
@statistical(2e-5, 12, power=chi_square_power(60, 2e-5, 12, 4.0))  # the truth twice as loud
def test_rms_of_flown_runs_is_what_the_analysis_says(belief):
    road, gnss, start = setting(26.0)
    at = (10.0, 25.0)
    ekf = LooselyCoupledEKF(belief, DT, lever_arm=LEVER, options=FilterOptions(output_every=100))
    a = analyse(ekf, MODEL_15, road.imu, gnss, start, START_SIGMA, at=at)
    errors = monte_carlo(ekf, MODEL_15, road, 60, at)
    assert inside(errors, a, 2e-5).all()
    loud = {"gyro": WN(N=1e-3) + GM(sigma=6e-4, beta=0.01), "accel": WN(N=2e-3) + GM(sigma=1e-2, beta=0.02)}
    twin = analyse(ekf, loud, road.imu, gnss, start, START_SIGMA, at=at)
    assert not inside(errors, twin, 2e-5)[1].all()


@pytest.mark.slow(reason="hours of flight or many realizations")
@pytest.mark.parametrize("belief", [MODEL_24, WHITE], ids=["matched", "mismatched"])
@statistical(2e-5, 12, power=chi_square_power(400, 2e-5, 12, 1.5))  # an rms 22 % off
def test_four_hundred_runs_agree_and_cost_more(belief):
    outages = ((60.0, 120.0), (180.0, 240.0))
    road, gnss, start = setting(300.0, outages)
    at = (120.0, 240.0)
    ekf = LooselyCoupledEKF(belief, DT, lever_arm=LEVER, options=FilterOptions(output_every=100))
    analyse(ekf, MODEL_24, road.imu, gnss, start, START_SIGMA, at=at, budget_at=at)
    started = time.process_time()
    a = analyse(ekf, MODEL_24, road.imu, gnss, start, START_SIGMA, at=at, budget_at=at)
    analytic = time.process_time() - started
    started = time.process_time()
    errors = monte_carlo(ekf, MODEL_24, road, 400, at, outages)
    drawn = time.process_time() - started
    print(
        f"analysis {analytic:.2f} s, 400 runs {drawn:.1f} s: {drawn / analytic:.0f} times; rms ratio {np.sqrt((errors**2).mean(axis=0)) / a.rms}"
    )
    assert inside(errors, a, 2e-5).all()


EXTRAS = Extras(gyro_scale=3e-2, accel_scale=1e-2, accel_misalignment=1e-2, lever_arm=0.3, latency=0.02)


@statistical(2e-5, 12, power=chi_square_power(60, 2e-5, 12, 4.0))  # half the rms stated
def test_a_filter_that_also_calibrates_errs_as_the_analysis_says():
    """States for errors that the sensors do not have cost accuracy: rms of flown runs, and the parts add up."""
    road, gnss, start = setting(26.0)
    at = (10.0, 25.0)
    options = FilterOptions(output_every=100, extras=EXTRAS)
    ekf = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER, options=options)
    a = analyse(ekf, MODEL_15, road.imu, gnss, start, START_SIGMA, at=at, budget_at=at)
    errors = monte_carlo(ekf, MODEL_15, road, 60, at)
    assert inside(errors, a, 2e-5).all()
    for budget, whole in zip(a.budgets, a.actual, strict=True):
        np.testing.assert_allclose(budget.total, np.diag(whole)[:3], rtol=1e-9)
    plain = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER)
    without = analyse(plain, MODEL_15, road.imu, gnss, start, START_SIGMA, at=at)
    # it says more than it errs, and errs more than a filter without these states: twins that the flown runs tell apart
    assert (a.sigma[0, :3] > 1.1 * a.rms[0, :3]).all()
    assert not inside(errors, without, 2e-5)[:, :2].all()


def test_what_it_does_not_carry_is_said():
    road, gnss, start = setting(5.0)
    plain = LooselyCoupledEKF(MODEL_15, DT)
    with pytest.raises(InputError, match="no state 'pos_x'"):
        analyse(plain, MODEL_15, road.imu, gnss, start, START_SIGMA, budget_at=(3.0,), budget_states=("pos_x",))
    with pytest.raises(InputError, match="not a navigation error"):
        analyse(plain, MODEL_15, road.imu, gnss, start, START_SIGMA, budget_at=(3.0,), budget_states=("gyro_x.GM1",))
