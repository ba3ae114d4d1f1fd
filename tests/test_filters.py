"""The compiled filter against the one that is written to be read, against laws, and against chi-square bounds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from insemu import earth, rotation, strapdown
from insemu.errors import InputError
from insemu.filters import (
    Extras,
    FilterOptions,
    InitialSigma,
    LooselyCoupledEKF,
    Standstill,
    expanded,
    measurements,
    run_filter,
)
from insemu.filters.aids import CODES, fill_rows
from insemu.filters.reference import reference_run, step_matrices
from insemu.filters.rows import Moment, Rows
from insemu.noise import GM, RC, WN
from insemu.records import AXES, AidRecord, GnssRecord, ImuRecord
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, MODEL_24, MODEL_27, MODEL_RW, START_SIGMA

LEVER = (1.2, -0.4, -0.9)


@pytest.fixture(scope="module")
def road():
    return cases.drive(40.0)


def flown(road, model, *, seed=1, lever=(0.0, 0.0, 0.0), outages=((15.0, 22.0),)):
    rng = np.random.default_rng(seed)
    imu = cases.corrupt(road.imu, model, rng)
    return imu, cases.fixes(road, rng, outages=outages, lever_arm=lever), cases.start(road, rng)


def agreement(a, b):
    """Largest differences of two results: covariance in units of sqrt(PiiPjj), position, velocity, attitude, IMU states in sigma."""
    sd = np.sqrt(np.einsum("kii->ki", b.covariance))
    nav = np.abs(strapdown.navigation_errors(a.nav, b.nav))
    states = np.abs(a.imu_states - b.imu_states)
    return (
        np.max(np.abs(a.covariance - b.covariance) / (sd[:, :, None] * sd[:, None, :])),
        nav[:, :3].max(),
        nav[:, 3:6].max(),
        nav[:, 6:].max(),
        np.max(states / np.where(b.sigma[:, 9:] > 0, b.sigma[:, 9:], 1.0)),
    )


BOUNDS = (1e-9, 1e-6, 1e-8, 1e-10, 1e-6)


@pytest.mark.parametrize(
    ("model", "extras"),
    [
        (MODEL_15, Extras()),
        (MODEL_24, Extras()),
        (MODEL_27, Extras()),
        (MODEL_RW, Extras(gyro_scale=1e-3, accel_misalignment=2e-3, lever_arm=0.1, latency=0.01)),
        (MODEL_15, Extras(gyro_scale_temperature=1e-3, accel_scale_temperature=1e-3, accel_scale=1e-3)),
    ],
    ids=["15", "24", "27", "extras", "warm"],
)
def test_compiled_and_reference_filter_agree(road, model, extras):
    imu, gnss, start = flown(road, model, lever=LEVER)
    imu = replace(imu, temperature=20.0 + 0.3 * imu.t)
    gnss = replace(gnss, t=gnss.t - 0.0037)  # fixes between the epochs, too
    options = FilterOptions(covariance_at=tuple(np.arange(1.0, 40.0, 3.0)), gate=1e-4, extras=extras, output_every=7)
    ekf = LooselyCoupledEKF(model, DT, lever_arm=LEVER, options=options)
    a, b = ekf.run(imu, gnss, start, START_SIGMA), reference_run(ekf, imu, gnss, start, START_SIGMA)
    assert (np.array(agreement(a, b)) < BOUNDS).all()
    np.testing.assert_array_equal(a.t, b.t)
    np.testing.assert_array_equal(a.fixes.accepted, b.fixes.accepted)
    np.testing.assert_allclose(a.fixes.nis, b.fixes.nis, rtol=1e-9)
    np.testing.assert_allclose(a.fixes.S, b.fixes.S, rtol=1e-9, atol=1e-16)


@pytest.mark.slow(reason="hours of flight or many realizations")
@pytest.mark.parametrize("model", [MODEL_15, MODEL_24, MODEL_27], ids=["15", "24", "27"])
def test_compiled_and_reference_filter_agree_over_twenty_minutes(model):
    road = cases.drive(1200.0)
    imu, gnss, start = flown(road, model, lever=LEVER, outages=((420.0, 480.0), (660.0, 720.0), (900.0, 960.0)))
    options = FilterOptions(covariance_at=tuple(np.arange(1.0, 1201.0, 20.0)), output_every=100)
    ekf = LooselyCoupledEKF(model, DT, lever_arm=LEVER, options=options)
    a, b = ekf.run(imu, gnss, start, START_SIGMA), reference_run(ekf, imu, gnss, start, START_SIGMA)
    assert (np.array(agreement(a, b)) < BOUNDS).all()


def random_state(rng):
    """Thirteen numbers: place, velocity, attitude, and nothing left of rounding."""
    return np.concatenate(
        [
            [rng.uniform(-1.4, 1.4), rng.uniform(-3, 3), rng.uniform(-100, 9000)],
            rng.standard_normal(3) * 60,
            rotation.quaternion_from_rpy(rng.uniform(-1, 1, 3) * [3, 1.4, 3]),
            np.zeros(3),
        ]
    )


def test_the_map_of_a_step_is_the_exponential_of_the_dynamics():
    """Structure of the compiled map and of the readable one, against Van Loan's exponential, to the third order in dt."""
    rng = np.random.default_rng(5)
    F, w = np.empty((9, 9)), np.empty(expanded.MAP_SIZE)
    for _ in range(200):
        nav, f_n = random_state(rng), rng.standard_normal(3) * 10 - [0, 0, 9.8]
        C = rotation.dcm_from_quaternion(nav[6:10])
        strapdown.fill_dynamics(nav, f_n, 0, F)
        Phi, B = step_matrices(F, C, DT)
        big = np.zeros((15, 15))
        big[:9, :9] = F
        big[3:6, 12:], big[6:9, 9:12] = C, C
        exact = linalg.expm(big * DT)[:9]
        off = np.abs(np.hstack([Phi, B]) - exact).reshape(3, 3, 5, 3).max(axis=(1, 3))
        # rows position, velocity, attitude; columns the same and the two triads: |f| dt^3 / 12, products of |f| and rates times dt^2
        assert (
            off < [[1e-11, 1e-8, 1e-8, 1e-5, 1e-9], [1e-12, 1e-8, 1e-6, 1e-8, 1e-7], [1e-16, 1e-13, 1e-8, 1e-7, 1e-10]]
        ).all()
        E = np.zeros((15, expanded.LD))
        E[:, :15] = np.eye(15)
        expanded.fill_map(F, C, DT, w)
        flat = E.ravel()
        expanded.apply_map(w, 0.5 * DT, flat, 16)
        np.testing.assert_allclose(flat.reshape(15, -1)[:9, :15], np.hstack([Phi, B]), atol=1e-15, rtol=1e-12)


def test_the_jacobian_of_a_fix_is_its_derivative():
    """By central differences in all navigation errors, gyroscope errors, lever arm and latency, at 300 random states."""
    rng = np.random.default_rng(8)
    c, axis = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0, 1, 2, -1, -1, -1, -1])
    white = np.zeros(6)
    for _ in range(300):
        nav = random_state(rng)
        nav[2] = rng.uniform(0, 100)
        rate, lever, tau = rng.standard_normal(3), rng.standard_normal(3), rng.uniform(0, 0.01)
        acceleration = rng.standard_normal(3)

        def innovation(error, tau=tau, nav=nav, rate=rate, lever=lever, acceleration=acceleration):
            """Predicted fix at the state with this error: navigation (9), gyro states (3), lever arm (3), latency."""
            moved = nav.copy()
            strapdown.correct(moved, -error[:9])
            before = moved.copy()
            # the specific force is sensed in the body: an attitude error turns the acceleration of the last step with it
            turned = acceleration + np.cross(error[6:9], acceleration - [0.0, 0.0, 9.81])
            before[3:6] = moved[3:6] - turned * DT
            r = rate - error[9:12]
            nu, H, R = np.empty(6), np.empty((6, 16)), np.empty((6, 6))
            z = np.concatenate([nav[:3], nav[3:6]])
            trend = np.concatenate([acceleration, np.zeros(6), r])
            moment = Moment(
                moved, before, DT, tau + error[15], r, r, r, 1, white, c, axis, lever + error[12:15], 12, 15, np.zeros(2), -1, trend
            )  # fmt: skip
            fill_rows(measurements.FIX, moment, z, np.zeros(6), Rows(nu, H, R))
            return -nu, H

        H = innovation(np.zeros(16))[1]
        step = np.array([1e-2] * 3 + [1e-3] * 3 + [1e-6] * 3 + [1e-6] * 3 + [1e-4] * 3 + [1e-6])
        numeric = np.stack(
            [
                (innovation(step[i] * np.eye(16)[i])[0] - innovation(-step[i] * np.eye(16)[i])[0]) / (2 * step[i])
                for i in range(16)
            ],
            axis=1,
        )
        # left out: the age times the attitude error of the swinging arm, and times the rate's derivative
        size = np.full((6, 16), 1e-4)
        size[:, 6:12] += 0.02 * (1 + rate @ rate) * np.linalg.norm(lever)
        size[:, 6:9] += 0.02
        assert (np.abs(numeric - H) < size).all()


# -- laws -----------------------------------------------------------------------------------------------------------------------------


def same(a, b):
    """Two ways through the loop: what they round differently is a few eps at some of 4,000 epochs, 1e-12 of what is there."""
    for name in ("nav", "sigma", "imu_states"):
        one, two = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-12 * np.abs(two).max())


def test_a_fix_of_nan_is_no_fix(road):
    imu, gnss, start = flown(road, MODEL_15)
    holes = np.zeros(len(gnss), dtype=bool)
    holes[[3, 4, 17]] = True
    llh, vel = gnss.llh.copy(), gnss.vel_ned.copy()
    llh[holes], vel[holes] = np.nan, np.nan
    with_nan = replace(gnss, llh=llh, vel_ned=vel)
    kept = ~holes
    without = GnssRecord(
        gnss.t[kept], gnss.llh[kept], gnss.vel_ned[kept], gnss.pos_std_ned[kept], gnss.vel_std_ned[kept]
    )
    a = run_filter(imu, with_nan, start, START_SIGMA, MODEL_15)
    same(a, run_filter(imu, without, start, START_SIGMA, MODEL_15))
    assert not a.fixes.accepted[holes].any() and (a.fixes.dof[holes] == 0).all()


def test_half_a_fix_is_used(road):
    imu, gnss, start = flown(road, MODEL_15)
    a = run_filter(imu, replace(gnss, vel_ned=None, vel_std_ned=None), start, START_SIGMA, MODEL_15)
    b = run_filter(imu, replace(gnss, vel_ned=np.full((len(gnss), 3), np.nan)), start, START_SIGMA, MODEL_15)
    same(a, b)
    assert (a.fixes.dof == 3).all() and np.isnan(a.fixes.innovation[:, 3:]).all()


def test_an_outage_of_no_length_is_none_and_no_record_is_no_fixes(road):
    imu, gnss, start = flown(road, MODEL_15, outages=())
    _, same_gnss, _ = flown(road, MODEL_15, outages=((20.0, 20.0),))
    same(run_filter(imu, gnss, start, START_SIGMA, MODEL_15), run_filter(imu, same_gnss, start, START_SIGMA, MODEL_15))
    alone = run_filter(imu, None, start, START_SIGMA, {"gyro": WN(N=1e-4), "accel": WN(N=1e-4)})
    np.testing.assert_allclose(alone.nav, strapdown.mechanize_array(imu, start), rtol=0, atol=1e-11)


def test_scaling_every_noise_scales_the_covariance(road):
    imu, gnss, start = flown(road, MODEL_15)
    s = 3.0
    louder = {
        "gyro": WN(N=5e-4 * s) + GM(sigma=3e-4 * s, beta=0.01),
        "accel": WN(N=1e-3 * s) + GM(sigma=5e-3 * s, beta=0.02),
    }
    wider = InitialSigma(
        *(s * np.asarray(v) for v in (START_SIGMA.position, START_SIGMA.velocity, START_SIGMA.attitude))
    )
    coarser = replace(gnss, pos_std_ned=gnss.pos_std_ned * s, vel_std_ned=gnss.vel_std_ned * s)
    a = run_filter(imu, gnss, start, START_SIGMA, MODEL_15, lever_arm=LEVER)
    b = run_filter(imu, coarser, start, wider, louder, lever_arm=LEVER)
    np.testing.assert_allclose(b.sigma, s * a.sigma, rtol=1e-9)
    np.testing.assert_allclose(b.nav[:, 3:6], a.nav[:, 3:6], atol=1e-9)


def test_the_order_of_processes_does_not_matter(road):
    gm1, gm2, gm3, wn = GM(sigma=2e-3, beta=25.8), GM(sigma=3e-3, beta=0.04), GM(sigma=5e-3, beta=1e-3), WN(N=8e-4)
    imu, gnss, start = flown(road, MODEL_24)
    one = {"gyro": MODEL_24["gyro"], "accel": wn + gm1 + gm2 + gm3}
    two = {"gyro": MODEL_24["gyro"], "accel": gm3 + gm1 + wn + gm2}
    options = FilterOptions(covariance_at=(35.0,))
    a, b = (run_filter(imu, gnss, start, START_SIGMA, m, options=options) for m in (one, two))
    order_a = a.layout.names
    # b's GM1 is a's GM3, b's GM2 is a's GM1, b's GM3 is a's GM2
    rename = {"GM1": "GM2", "GM2": "GM3", "GM3": "GM1"}
    index = [b.layout.names.index(n[:-3] + rename[n[-3:]] if n.startswith("accel") else n) for n in order_a]
    permuted = b.covariance[0][np.ix_(index, index)]
    sd = a.sigma[3500]
    assert np.abs(permuted - a.covariance[0]).max() <= 1e-10 * np.max(np.outer(sd, sd))
    np.testing.assert_allclose(permuted / np.outer(sd, sd), a.covariance[0] / np.outer(sd, sd), atol=1e-10)


def test_permuting_the_sensor_axes_with_the_mounting_changes_nothing_but_their_names(road):
    """Body axes x, y, z called y, z, x, with the attitude that says so."""
    imu, gnss, start = flown(road, MODEL_15)
    turn = np.eye(3)[[2, 0, 1]]  # new axes in terms of the old: x' = z, y' = x, z' = y
    C = rotation.dcm_from_rpy(start.rpy) @ turn.T
    turned = replace(start, rpy=rotation.rpy_from_dcm(C))
    other = ImuRecord(imu.t, imu.gyro @ turn.T, imu.accel @ turn.T, kind="increment")
    a = run_filter(imu, gnss, start, START_SIGMA, MODEL_15, lever_arm=LEVER)
    b = run_filter(other, gnss, turned, START_SIGMA, MODEL_15, lever_arm=turn @ np.array(LEVER))
    np.testing.assert_allclose(b.nav[:, 3:6], a.nav[:, 3:6], atol=1e-8)
    np.testing.assert_allclose(b.sigma[:, :9], a.sigma[:, :9], rtol=1e-6)
    np.testing.assert_allclose(b.sigma[:, 9:12], a.sigma[:, 9:12] @ np.abs(turn).T, rtol=1e-6)


def test_rotating_the_heading_rotates_the_errors(road):
    """The whole flight turned about the vertical, with everything that is drawn: errors and covariance turn with it.

    The Earth's rotation and curvature do not turn: over 40 s they tilt one flight against the other by 3 mrad, 0.03 m/s^2 of the specific force
    whose horizontal part, about 1 m/s^2, ties the errors together.
    """
    angle = 2.0
    turn = rotation.dcm_from_rpy([0.0, 0.0, angle])
    R = np.kron(np.eye(3), turn)
    rng = np.random.default_rng(4)
    imu = cases.corrupt(road.imu, MODEL_15, rng)
    noise = rng.standard_normal((60, 3)) * 0.05
    draw = rng.standard_normal(9) * np.repeat([0.5, 0.1, 0.02], 3)

    def fly(by):
        start = road.nav[0].copy()
        start[3:6] = by @ start[3:6]
        start[6:10] = rotation.quaternion_from_dcm(by @ rotation.dcm_from_quaternion(start[6:10]))
        state = strapdown.NavState(start[:3], start[3:6], rotation.rpy_from_quaternion(start[6:10]))
        nav = strapdown.mechanize_array(road.imu, state)
        rows = np.array([k for k in range(100, road.t.size, 100) if not 1500 < k <= 2200])
        arm = np.einsum("kij,j->ki", rotation.dcm_from_quaternion(nav[rows, 6:10]), np.array(LEVER))
        llh = earth.move(nav[rows, :3], arm + noise[: rows.size] @ by.T)
        gnss = GnssRecord(road.t[rows], llh, None, np.full((rows.size, 3), 0.05))
        moved = np.append(nav[0], np.zeros(3))
        strapdown.correct(moved, -np.kron(np.eye(3), by) @ draw)
        begin = strapdown.NavState(moved[:3], moved[3:6], rotation.rpy_from_quaternion(moved[6:10]))
        sigma = InitialSigma(position=0.5, velocity=0.1, attitude=0.02)
        options = FilterOptions(covariance_at=(14.0, 22.0, 40.0), output_every=100)
        r = run_filter(imu, gnss, begin, sigma, MODEL_15, lever_arm=LEVER, options=options)
        at = [14, 22, 40]
        return strapdown.navigation_errors(r.nav[at], nav[np.array(at) * 100]), r.covariance

    (error, P), (turned_error, turned_P) = fly(np.eye(3)), fly(turn)
    sd = np.sqrt(np.einsum("kii->ki", turned_P[:, :9, :9]))
    scale = sd[:, :, None] * sd[:, None, :]
    assert (np.abs(turned_P[:, :9, :9] - R @ P[:, :9, :9] @ R.T) / scale).max() < 0.05
    assert (np.abs(turned_P[:, 9:, 9:] - P[:, 9:, 9:]) / P[:, 9:, 9:].max()).max() < 1e-5
    assert (np.abs(turned_error - error @ R.T) / sd).max() < 0.05
    # unturned they differ: the law says something
    assert (np.abs(turned_P[:, :9, :9] - P[:, :9, :9]) / scale).max() > 0.5
    assert (np.abs(turned_error - error) / sd).max() > 1.0


# -- fixes at their own times -----------------------------------------------------------------------------------------------------------


def test_a_fix_between_epochs_is_predicted_at_its_own_time():
    """Noise-free data and start: whatever the time stamp within the step, innovations stay at the size of the interpolation."""
    road = cases.drive(20.0, turn=1.0)
    quiet = {"gyro": WN(N=1e-9), "accel": WN(N=1e-9)}
    gnss = cases.fixes(road, np.random.default_rng(0), sigma=(1e-12, 1e-12), lever_arm=LEVER)
    loose = replace(gnss, pos_std_ned=np.full((len(gnss), 3), 1.0), vel_std_ned=np.full((len(gnss), 3), 1.0))
    start = strapdown.NavState(road.nav[0, :3], road.nav[0, 3:6], rotation.rpy_from_quaternion(road.nav[0, 6:]))
    on_grid = run_filter(road.imu, loose, start, InitialSigma(), quiet, lever_arm=LEVER)
    assert np.abs(on_grid.fixes.innovation[:, :3]).max() < 1e-5
    assert np.abs(on_grid.fixes.innovation[:, 3:]).max() < 2e-2  # the rate at the epoch is extrapolated
    # every third epoch only: the fixes in between now fall at a third or two thirds of a step
    third = road.t[::3]
    sums = [
        np.add.reduceat(v[1:], np.arange(0, v.shape[0] - 1, 3))[: third.size - 1]
        for v in (road.imu.gyro, road.imu.accel)
    ]
    thin = ImuRecord(third, *(np.concatenate([v[:1], v]) for v in sums), kind="increment")
    off_grid = run_filter(thin, loose, start, InitialSigma(), quiet, lever_arm=LEVER)
    assert {0, 1, 2} == {round(x) for x in ((third[off_grid.fixes.epoch] - off_grid.fixes.t) / DT)}
    assert np.abs(off_grid.fixes.innovation[:, :3]).max() < 1e-3
    shifted = run_filter(thin, replace(loose, t=loose.t + DT), start, InitialSigma(), quiet, lever_arm=LEVER)
    assert np.abs(shifted.fixes.innovation[:, :3]).max() > 0.05  # the negative twin: stamps wrong by one sample


def test_latency_and_lever_arm_are_learnt(road):
    imu, gnss, start = flown(road, MODEL_15, lever=LEVER, outages=())
    late, wrong = replace(gnss, t=gnss.t + 0.02), np.add(LEVER, (0.3, -0.2, 0.2))
    options = FilterOptions(extras=Extras(lever_arm=0.5, latency=0.1))
    r = run_filter(imu, late, start, START_SIGMA, MODEL_15, lever_arm=wrong, options=options)
    names = r.layout.names
    estimate = dict(zip(names[9:], r.imu_states[-1], strict=True))
    sigma = dict(zip(names, r.sigma[-1], strict=True))
    assert abs(estimate["latency"] - 0.02) < 4 * sigma["latency"]
    assert sigma["latency"] < 0.02  # from 0.1
    for axis, error in zip("xyz", (-0.3, 0.2, -0.2), strict=True):
        assert abs(estimate[f"lever_arm_{axis}"] - error) < 4 * sigma[f"lever_arm_{axis}"]


def test_the_gate_rejects_an_outlier_and_reports_it(road):
    imu, gnss, start = flown(road, MODEL_15, outages=())
    llh = gnss.llh.copy()
    llh[20, 0] += 50.0 / 6.4e6
    wrong = replace(gnss, llh=llh)
    gated = run_filter(imu, wrong, start, START_SIGMA, MODEL_15, options=FilterOptions(gate=1e-6))
    assert list(gated.fixes.rejected) == [20]
    assert gated.fixes.nis[20] > 1000
    holed = replace(gnss, llh=np.where(np.arange(len(gnss))[:, None] == 20, np.nan, gnss.llh))
    vel = gnss.vel_ned.copy()
    vel[20] = np.nan
    same(
        gated,
        run_filter(imu, replace(holed, vel_ned=vel), start, START_SIGMA, MODEL_15, options=FilterOptions(gate=1e-6)),
    )
    assert run_filter(imu, wrong, start, START_SIGMA, MODEL_15).fixes.accepted.all()


def test_a_filter_that_is_wrong_of_itself_comes_back_through_the_gate(road):
    """A bias that is not believed bends the flight through an outage: all fixes behind it are beyond the gate."""
    imu, gnss, start = flown(road, MODEL_15, outages=((10.0, 20.0),))
    biased = replace(imu, accel=imu.accel + np.where(imu.t > 10.0, 2.0, 0.0)[:, None] * [1.0, 0.0, 0.0])
    behind = gnss.t > 20.0

    def ran(timeout):
        ekf = LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(gate=1e-4, gate_timeout=timeout))
        return ekf, ekf.run(biased, gnss, start, START_SIGMA)

    _, shut = ran(1e6)
    assert not shut.fixes.accepted[behind].any()
    for timeout in (3.0, 5.0):
        ekf, opened = ran(timeout)
        t, accepted = opened.fixes.t[behind], opened.fixes.accepted[behind]
        assert t[accepted][0] == pytest.approx(t[0] + timeout, abs=0.01)
        readable = reference_run(ekf, biased, gnss, start, START_SIGMA)
        np.testing.assert_array_equal(opened.fixes.accepted, readable.fixes.accepted)
    with pytest.raises(InputError, match="gate_timeout is 0"):
        FilterOptions(gate_timeout=0)


# -- nodes, decimation, standstill --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [MODEL_24, MODEL_27], ids=["24", "27"])
def test_stored_transitions_carry_the_covariance_between_nodes(road, model):
    imu, gnss, start = flown(road, model)
    options = FilterOptions(store="fixes", node_every=0.25, output_every=50)
    r = run_filter(imu, gnss, start, START_SIGMA, model, options=options)
    nodes = r.nodes
    assert np.diff(nodes.t).max() < 0.26
    for k in range(1, len(nodes)):
        driven = nodes.P_before[k] - nodes.Phi[k] @ nodes.P_after[k - 1] @ nodes.Phi[k].T
        sd = np.sqrt(np.diag(nodes.P_before[k]))
        scaled = driven / np.outer(sd, sd)
        assert np.linalg.eigvalsh(0.5 * (scaled + scaled.T)).min() > -1e-9  # what the noise added is a covariance
    # the update that a node reports is the one that the table reports
    at = np.searchsorted(nodes.epoch, r.fixes.epoch)
    np.testing.assert_allclose(
        nodes.correction[at], -np.einsum("fni,fi->fn", r.fixes.K, r.fixes.innovation), rtol=1e-9, atol=1e-14
    )
    plain = run_filter(imu, gnss, start, START_SIGMA, model, options=FilterOptions(output_every=50))
    same(r, plain)


def test_a_thinned_covariance_stays_close(road):
    imu, gnss, start = flown(road, MODEL_15)
    full = run_filter(imu, gnss, start, START_SIGMA, MODEL_15, options=FilterOptions(output_every=10))
    thin = run_filter(
        imu, gnss, start, START_SIGMA, MODEL_15, options=FilterOptions(output_every=10, covariance_every=10)
    )
    np.testing.assert_allclose(thin.sigma[1:], full.sigma[1:], rtol=0.02)


@statistical(2e-5 + 3 * 5.8e-7, 4, power=chi_square_power(177, 2e-5, 1, 2.0))  # rates 1.4 times as noisy as believed
def test_standstill_updates_find_the_gyro_bias():
    rng = np.random.default_rng(3)
    n = 6001
    t = np.arange(n) * DT
    start = strapdown.NavState(np.array([0.8, 0.1, 200.0]), np.zeros(3), np.array([0.02, -0.03, 1.0]))
    C = rotation.dcm_from_rpy(start.rpy)
    w = C.T @ earth.earth_rate(0.8)
    f = C.T @ [0.0, 0.0, -float(earth.gravity(0.8, 200.0))]
    model = {"gyro": WN(N=1e-4) + RC(sigma=1e-3), "accel": WN(N=1e-3) + RC(sigma=1e-3)}
    imu = cases.corrupt(ImuRecord(t, np.tile(w * DT, (n, 1)), np.tile(f * DT, (n, 1)), kind="increment"), model, rng)
    clean_bias = (imu.gyro / DT - w).mean(axis=0)
    options = FilterOptions(standstill=Standstill([(0.0, 60.0)], every=1.0, velocity_sigma=0.01, rate_sigma=1e-6))
    r = run_filter(imu, None, start, InitialSigma(1.0, 0.1, (0.01, 0.01, 0.01)), model, options=options)
    assert len(r.fixes) == 59 and (r.fixes.kind == CODES["standstill"]).all()
    sigma = r.sigma[-1, 9:12]
    assert (sigma < 3e-5).all()
    assert (np.abs(r.imu_states[-1, :3] - clean_bias) < 5 * sigma).all()
    assert np.abs(r.nav[-1, 3:6]).max() < 0.02
    rate_part = r.fixes.innovation[:, 3:] ** 2 / np.einsum("fii->fi", r.fixes.S)[:, 3:]
    low, high = chi_square(rate_part.size, 2e-5)
    assert low < rate_part.mean() < high


def test_aids_are_the_same_in_the_reference_filter(road):
    imu, gnss, start = flown(road, MODEL_15)
    still = Standstill([(3.0, 9.0), (30.0, 36.0)], every=0.7, velocity_sigma=20.0, rate_sigma=0.5)
    at = FilterOptions(covariance_at=(5.0, 20.0, 40.0), standstill=still)
    ekf = LooselyCoupledEKF(MODEL_15, DT, options=at)
    extra = AidRecord("standstill", [2.003, 17.5], np.full((2, 6), 0.1), np.full((2, 6), 5.0), since=[1.2, 17.0])
    a = ekf.run(imu, gnss, start, START_SIGMA, aids=(extra,))
    b = reference_run(ekf, imu, gnss, start, START_SIGMA, aids=(extra,))
    assert (np.array(agreement(a, b)) < BOUNDS).all()
    np.testing.assert_allclose(a.fixes.innovation, b.fixes.innovation, atol=1e-6)
    assert (a.fixes.kind == CODES["standstill"]).sum() == 18 and a.fixes.accepted.all()
    without = ekf.run(imu, gnss, start, START_SIGMA)
    assert np.abs(without.nav - a.nav).max() > 1e-9


def test_an_aid_that_is_not_known_or_misshapen_is_named(road):
    imu, gnss, start = flown(road, MODEL_15)
    ekf = LooselyCoupledEKF(MODEL_15, DT)
    for aid, words in (
        (AidRecord("stand still", [1.0], np.zeros((1, 6)), np.ones((1, 6))), "no aid 'stand still'"),
        (AidRecord("standstill", [1.0], np.zeros((1, 2)), np.ones((1, 2))), "2 components, expected vel_n"),
    ):
        with pytest.raises(InputError, match=words):
            ekf.run(imu, gnss, start, START_SIGMA, aids=(aid,))
    with pytest.raises(InputError, match="standstill std has shape"):
        AidRecord("standstill", [1.0], np.zeros((1, 6)), np.ones((1, 5)))


# -- consistency ----------------------------------------------------------------------------------------------------------------------------


def pooled_nees(road, truth, belief, runs, at):
    """NEES of the nine navigation errors at epochs ``at`` (s), (runs, epochs)."""
    ekf = LooselyCoupledEKF(belief, DT, options=FilterOptions(covariance_at=at, output_every=100))
    out = np.empty((runs, len(at)))
    rows = np.round(np.array(at) / DT).astype(int)
    for i in range(runs):
        imu, gnss, start = flown(road, truth, seed=100 + i)
        r = ekf.run(imu, gnss, start, START_SIGMA)
        pick = np.searchsorted(r.t, np.array(at) - 1e-9)
        e = strapdown.navigation_errors(r.nav[pick], road.nav[rows])
        out[i] = np.einsum("ki,kij,kj->k", e, np.linalg.inv(r.covariance[:, :9, :9]), e)
    return out


@statistical(2e-5, 4, power=chi_square_power(360, 2e-5, 4, 2.0))  # half the error variance believed
def test_a_filter_that_believes_the_truth_knows_its_error(road):
    """Mean NEES over runs inside the chi-square bounds; half the noise believed: far outside."""
    runs, at = 40, (1.0, 15.0, 22.0, 40.0)
    bounds = 9 * np.array(chi_square(9 * runs, 2e-5, len(at)))
    matched = pooled_nees(road, MODEL_15, MODEL_15, runs, at).mean(axis=0)
    assert ((bounds[0] < matched) & (matched < bounds[1])).all(), (bounds, matched)
    half = {"gyro": WN(N=2.5e-4) + GM(sigma=1.5e-4, beta=0.01), "accel": WN(N=5e-4) + GM(sigma=2.5e-3, beta=0.02)}
    assert pooled_nees(road, MODEL_15, half, runs, at)[:, 1:].mean(axis=0).max() > 1.3 * bounds[1]


# -- what is refused ----------------------------------------------------------------------------------------------------------------------------


def test_bad_input_is_named(road):
    imu, gnss, start = flown(road, MODEL_15)
    with pytest.raises(InputError, match="fix at 1 s has no positive standard deviation for position"):
        run_filter(imu, replace(gnss, pos_std_ned=None), start, START_SIGMA, MODEL_15)
    # made for another rate: discretised again
    other = LooselyCoupledEKF(MODEL_15, 0.02).run(imu, gnss, start, START_SIGMA)
    np.testing.assert_array_equal(other.nav, LooselyCoupledEKF(MODEL_15, imu.dt).run(imu, gnss, start, START_SIGMA).nav)
    P = np.eye(15)
    P[4, 4] = -1.0
    with pytest.raises(InputError, match="not positive semidefinite at the state 'vel_e'"):
        run_filter(imu, gnss, start, P, MODEL_15)
    with pytest.raises(InputError, match=r"expected \(15, 15\)"):
        run_filter(imu, gnss, start, np.eye(9), MODEL_15)
    with pytest.raises(InputError, match="standard deviations that are not negative"):
        run_filter(imu, gnss, start, InitialSigma(position=-1.0), MODEL_15)
    with pytest.raises(InputError, match="whole number of at least 1"):
        FilterOptions(covariance_every=3, output_every=0)
    with pytest.raises(InputError, match="probability"):
        FilterOptions(gate=1.5)
    with pytest.raises(InputError, match="at most"):
        LooselyCoupledEKF({"gyro": (expanded.MAX_SLOTS + 1) * GM(sigma=1.0, beta=1.0)}, DT)
    wild = ImuRecord(imu.t, imu.gyro, imu.accel * 1e99, kind="increment")
    with pytest.raises(InputError, match=r"diverged|not positive"):
        run_filter(wild, None, start, START_SIGMA, MODEL_15)


@statistical(1e-6, 1, power=chi_square_power(300, 1e-6, 1, 2.0))  # half the error variance believed
def test_scale_factors_that_follow_the_temperature_are_estimated_and_their_error_is_known():
    """20 sensors on one drive, up to 30 K warmer: NEES inside its bounds; that of a twin without the states, on sensors twice as bad, beyond."""
    road, runs = cases.drive(91.0, turn=1.0), 20
    size = {"gyro_scale_temperature": 1e-3, "accel_scale_temperature": 3e-4}
    degc = 25.0 + 30.0 * np.sin(np.pi * road.t / 120.0)
    options = FilterOptions(covariance_at=(90.0,), extras=Extras(**size), output_every=100)
    carried = LooselyCoupledEKF(MODEL_15, DT, options=options)
    plain = LooselyCoupledEKF(MODEL_15, DT, options=replace(options, extras=Extras()))
    at = [*range(9), *(carried.layout.index(f"{a}.scale_temperature") for a in AXES)]
    nees = {"carried": np.empty(runs), "plain": np.empty(runs)}
    told = np.zeros(6)
    for run, rng in enumerate(np.random.default_rng(15).spawn(runs)):
        usual = np.repeat(list(size.values()), 3)
        for name, ekf in (("carried", carried), ("plain", plain)):
            per_kelvin = usual * rng.standard_normal(6) if name == "carried" else 2.0 * usual
            scale = (degc - 25.0)[:, None] * per_kelvin
            ideal = replace(
                road.imu, gyro=road.imu.gyro * (1 + scale[:, :3]), accel=road.imu.accel * (1 + scale[:, 3:])
            )
            imu = replace(cases.corrupt(ideal, MODEL_15, rng), temperature=degc)
            r = ekf.run(imu, cases.fixes(road, rng), cases.start(road, rng), START_SIGMA)
            row = int(np.searchsorted(r.t, 90.0 - 1e-9))
            error = np.zeros(ekf.layout.n)
            error[:9] = strapdown.navigation_errors(r.nav[row : row + 1], road.nav[9_000:9_001])[0]
            some = at if name == "carried" else at[:9]
            if name == "carried":
                error[at[9:]] = r.imu_states[row][np.array(at[9:]) - 9] - per_kelvin
                told += np.sqrt(np.diag(r.covariance[0])[at[9:]]) / usual / runs
            P = r.covariance[0][np.ix_(some, some)]
            nees[name][run] = error[some] @ np.linalg.solve(P, error[some])
    low, high = chi_square(15 * runs, 1e-6)
    assert low < nees["carried"].mean() / 15 < high
    assert nees["plain"].mean() / 9 > 2.0 * chi_square(9 * runs, 1e-6)[1]
    assert told[2] < 0.2 and told[5] < 0.1  # of the axes that the motion excites: turns about z, gravity
