"""The smoother against filterpy's, against chi-square bounds and against the filter in an outage."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from insemu import strapdown
from insemu.errors import InputError
from insemu.filters import FilterOptions, LooselyCoupledEKF, smooth
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, MODEL_24, START_SIGMA

OPTIONS = FilterOptions(store="fixes", node_every=1.0, output_every=100)


def flown(road, model, seed, outage):
    rng = np.random.default_rng(seed)
    imu = cases.corrupt(road.imu, model, rng)
    return imu, cases.fixes(road, rng, outages=(outage,)), cases.start(road, rng)


def test_the_backward_pass_is_filterpys():
    road = cases.drive(40.0)
    imu, gnss, start = flown(road, MODEL_24, 4, (15.0, 25.0))
    r = LooselyCoupledEKF(MODEL_24, DT, options=OPTIONS).run(imu, gnss, start, START_SIGMA)
    n = r.nodes
    # filterpy smooths a state that is not fed back: the estimate relative to the nominal path without feedback
    x, means = np.zeros(24), []
    for k in range(len(n)):
        x = (n.Phi[k] @ x if k else x) - n.correction[k]
        means.append(x)
    drive = [n.P_before[k] - n.Phi[k] @ n.P_after[k - 1] @ n.Phi[k].T for k in range(1, len(n))]
    kf = KalmanFilter(dim_x=24, dim_z=1)
    their_x, their_P, _, _ = kf.rts_smoother(np.array(means), n.P_after, Fs=n.Phi, Qs=[np.zeros((24, 24)), *drive])
    s = smooth(r)
    sd = np.sqrt(np.einsum("kii->ki", their_P))
    np.testing.assert_allclose(s.sigma / sd, 1.0, rtol=1e-5)
    ours = np.hstack([strapdown.navigation_errors(s.nav, n.nav), s.imu_states - n.states])
    np.testing.assert_allclose(
        ours / sd, (their_x - np.array(means)) / sd, atol=2e-3
    )  # attitude corrections commute to first order only


@statistical(2e-5, 5, power=chi_square_power(270, 2e-5, 5, 2.0))  # half the error variance stated
def test_smoothed_errors_are_what_the_smoother_says_and_half_of_the_filters():
    """Mean NEES in chi-square bounds, and the error in the middle of an outage at most half of the filter's."""
    road, runs = cases.drive(90.0), 30
    ekf = LooselyCoupledEKF(MODEL_15, DT, options=OPTIONS)
    at = [5, 30, 45, 60, 80]
    nees, filtered, smoothed = np.empty((runs, len(at))), [], []
    for i in range(runs):
        r = ekf.run(*flown(road, MODEL_15, 300 + i, (30.0, 60.0)), START_SIGMA)
        s = smooth(r)
        e = strapdown.navigation_errors(s.nav, road.nav[r.nodes.epoch])
        f = strapdown.navigation_errors(r.nodes.nav, road.nav[r.nodes.epoch])
        nees[i] = [e[k] @ np.linalg.solve(s.covariance[k, :9, :9], e[k]) for k in at]
        smoothed.append(e[45, :2])
        filtered.append(f[45, :2])
    low, high = 9 * np.array(chi_square(9 * runs, 2e-5, len(at)))
    mean = nees.mean(axis=0)
    assert ((low < mean) & (mean < high)).all(), (low, high, mean)
    rms_f, rms_s = (np.sqrt(np.mean(np.square(v))) for v in (filtered, smoothed))
    assert rms_s < 0.5 * rms_f
    # the negative twin: the filter's own covariance does not describe the smoothed error in the outage
    assert rms_s < 0.5 * r.sigma[45, :2].max()


def test_states_without_variance_and_fully_correlated_states_smooth_as_the_dense_inverse():
    """A known state gets no gain; two that are one share theirs, where a factorisation of the covariance fails."""
    road = cases.drive(12.0)
    r = LooselyCoupledEKF(MODEL_15, DT, options=OPTIONS).run(*flown(road, MODEL_15, 2, (4.0, 8.0)), START_SIGMA)
    nodes, n = r.nodes, r.layout.n

    def widened(P, known):  # one state nothing is unknown of, and the last state once more
        out = np.zeros((len(P), n + 2, n + 2))
        out[:, :n, :n] = P
        out[:, n + 1, n + 1] = P[:, -1, -1] if known else 1.0 * (P[:, -1, -1] != 0)
        if known:
            out[:, n + 1, :n], out[:, :n, n + 1] = P[:, -1], P[:, :, -1]
        return out

    Phi = widened(nodes.Phi, False)
    Phi[:, n, n] = 1.0
    Phi[:, n + 1, n + 1] = nodes.Phi[:, -1, -1]
    extra = {
        "P_before": widened(nodes.P_before, True),
        "P_after": widened(nodes.P_after, True),
        "Phi": Phi,
        "states": np.hstack([nodes.states, np.zeros((len(nodes), 1)), nodes.states[:, -1:]]),
        "correction": np.hstack([nodes.correction, np.zeros((len(nodes), 1)), nodes.correction[:, -1:]]),
    }
    plain, wide = smooth(r), smooth(replace(r, nodes=replace(nodes, **extra)))
    sd = np.maximum(plain.sigma, 1e-300)
    np.testing.assert_allclose(wide.sigma[:, :n] / sd, 1.0, rtol=1e-6)
    np.testing.assert_array_equal(wide.sigma[:, n], 0.0)
    np.testing.assert_allclose(wide.sigma[:, n + 1], wide.sigma[:, n - 1], rtol=1e-6)
    np.testing.assert_allclose(wide.nav, plain.nav, rtol=0, atol=1e-9)
    np.testing.assert_allclose(wide.imu_states[:, -1], plain.imu_states[:, -1], atol=1e-9 * np.abs(sd[:, -1]).max())


def test_rows_that_are_asked_for_change_no_number():
    """A fix between two epochs of a slow covariance, and rows of every epoch, of every propagation or of few: the same bits."""
    road = cases.drive(6.0)
    imu, gnss, start = flown(road, MODEL_15, 3, (0.0, 0.0))
    gnss = replace(gnss, t=gnss.t + 3 * DT)
    few, many, each = (
        LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(covariance_every=10, output_every=k)).run(
            imu, gnss, start, START_SIGMA
        )
        for k in (100, 10, 1)
    )
    for more in (many, each):
        at = np.isin(more.t, few.t)
        np.testing.assert_allclose(few.nav, more.nav[at], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(few.sigma, more.sigma[at], rtol=1e-12)
    # between two propagations the variances stay
    np.testing.assert_allclose(each.sigma[21:29], np.broadcast_to(each.sigma[20], each.sigma[21:29].shape), rtol=1e-15)


def test_the_last_node_is_the_filters_and_nodes_are_needed():
    road = cases.drive(10.0)
    data = flown(road, MODEL_15, 1, (0.0, 0.0))
    r = LooselyCoupledEKF(MODEL_15, DT, options=OPTIONS).run(*data, START_SIGMA)
    s = smooth(r)
    np.testing.assert_allclose(s.nav[-1], r.nav[-1], rtol=1e-15, atol=1e-15)
    assert (s.sigma[3, :9] <= r.sigma[3, :9] * (1 + 1e-9)).all()
    assert s.trajectory.t[0] == 0.0
    with pytest.raises(InputError, match="kept no nodes"):
        smooth(LooselyCoupledEKF(MODEL_15, DT).run(*data, START_SIGMA))


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_half_the_error_in_the_middle_of_a_long_outage():
    """130 s without fixes, 24 realizations: horizontal rms in the middle at most half of the filter's at the same epoch."""
    road, errors = cases.drive(400.0), []
    ekf = LooselyCoupledEKF(MODEL_24, DT, options=OPTIONS)
    for i in range(24):
        r = ekf.run(*flown(road, MODEL_24, 800 + i, (200.0, 330.0)), START_SIGMA)
        s = smooth(r)
        k = int(np.searchsorted(s.t, 265.0))
        truth = road.nav[r.nodes.epoch[k]][None]
        errors.append([strapdown.navigation_errors(x[k : k + 1], truth)[0, :2] for x in (r.nodes.nav, s.nav)])
    rms = np.sqrt((np.array(errors) ** 2).sum(axis=-1).mean(axis=0))
    print(f"\nmiddle of 130 s: filter {rms[0]:.1f} m, smoother {rms[1]:.1f} m, ratio {rms[1] / rms[0]:.2f}")
    assert rms[1] <= 0.5 * rms[0]
