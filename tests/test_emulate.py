import errno
import io
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.signal import get_window

from insemu import earth, rotation, strapdown
from insemu.emulate import (
    TRAJECTORIES,
    Mounting,
    Outage,
    RecordedErrors,
    SmoothPath,
    built_in,
    corrupt,
    gnss_fixes,
    ideal_imu,
    navigation_error,
    simulated_pieces,
)
from insemu.emulate.gnss import antenna, state_at
from insemu.emulate.path import sensor_motion
from insemu.errors import InputError
from insemu.noise import GM, WN, NoiseModel
from insemu.records import AXES, Trajectory


@pytest.fixture(scope="module")
def helicopter():
    return built_in("helicopter_mapping")


@pytest.fixture(scope="module")
def ideal(helicopter):
    return ideal_imu(helicopter)


@pytest.mark.parametrize("mounting", [None, Mounting((1.0, -0.5, 0.3), (np.pi, -0.1, 3.0))], ids=["plain", "mounted"])
@pytest.mark.parametrize("name", sorted(TRAJECTORIES))
def test_exact_mode_returns_its_reference(name, mounting):
    flight = built_in(name)
    # errors grow with the span: the whole of one without a mounting, which only turns and moves what is sampled
    span = 1200.0 if mounting is None else 300.0
    ideal = ideal_imu(flight, mounting=mounting, span=(flight.path.start, min(flight.path.end, span)))
    nav = strapdown.mechanize(ideal.imu, ideal.reference)
    assert np.linalg.norm(earth.position_difference(nav.llh, ideal.reference.llh), axis=1).max() <= 1e-6
    assert np.abs(rotation.attitude_difference(nav.rpy, ideal.reference.rpy)).max() <= 1e-9
    assert ideal.path_distance_m < 0.01
    # and the nodes asked for are the nodes that came out
    if mounting is None:
        nodes = flight.path.sample(ideal.imu.t)
        assert np.abs(nav.vel_ned - nodes.vel_ned).max() < 1e-9
        assert np.abs(rotation.attitude_difference(nav.rpy, nodes.rpy)).max() < 1e-9


def test_helicopter_outages_lie_on_straight_legs(helicopter):
    assert helicopter.path.duration == 1200.0
    assert [start for start, _ in helicopter.outages] == [420.0, 660.0, 900.0]
    for start, duration in helicopter.outages:
        (leg,) = [each for each in helicopter.legs if each.start_s <= start and start + duration <= each.end_s]
        assert leg.straight and duration == 60.0
        v = helicopter.path.vel_ned(np.arange(start, start + duration))
        course = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
        assert np.ptp(course) < np.deg2rad(3)


def test_kinematics_are_the_derivatives_of_the_path(helicopter):
    path, d = helicopter.path, 1e-3
    t = np.linspace(30.0, 1150.0, 400)
    k, before, after = path.kinematics(t), path.kinematics(t - d), path.kinematics(t + d)
    np.testing.assert_allclose(earth.position_difference(after.llh, before.llh) / (2 * d), k.vel_ned, atol=2e-6)
    np.testing.assert_allclose((after.vel_ned - before.vel_ned) / (2 * d), k.acc_ned, atol=1e-5)
    turn = np.swapaxes(rotation.dcm_from_rpy(before.rpy), 1, 2) @ rotation.dcm_from_rpy(after.rpy)
    np.testing.assert_allclose(rotation.vector_from_dcm(turn) / (2 * d), k.w_nb_b, atol=1e-6)
    np.testing.assert_allclose((after.w_nb_b - before.w_nb_b) / (2 * d), k.alpha_nb_b, atol=2e-4)


def largest_line(x, rate_hz, above_hz):
    """Largest amplitude of a sine above a frequency: Blackman-Harris windows of a minute, root mean square over the record."""
    n = int(60.0 * rate_hz)
    parts = x[: len(x) // n * n].reshape(-1, n, x.shape[1])
    window = get_window("blackmanharris", n)
    amplitude = 2.0 * np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window[:, None], axis=1))
    amplitude = np.sqrt(np.mean((amplitude / window.sum()) ** 2, axis=0))
    return amplitude[np.fft.rfftfreq(n, 1.0 / rate_hz) > above_hz].max()


def test_largest_line_reads_a_sine():
    t = np.arange(12000) / 100.0
    assert largest_line(2e-4 * np.sin(2 * np.pi * 17.1 * t)[:, None], 100.0, 12.0) == pytest.approx(2e-4, rel=1e-3)


@pytest.mark.parametrize("name", ["urban_drive_1", "turbulent_uav"])
def test_nothing_vibrates_that_was_not_asked_for(name):
    # the knots of the path must not repeat the motion of up to 3 Hz around their own rate
    path = built_in(name).path
    motion = sensor_motion(path, path.start + np.arange(24000) / 100.0, Mounting())
    assert largest_line(motion.w_ib_b, 100.0, 12.0) < 1e-7
    assert largest_line(motion.f_ib_b, 100.0, 12.0) < 5e-6


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), (5.0, -2.0, 1.0)])
def test_sensor_motion_by_an_independent_route(helicopter, arm):
    """Inertial axes: second differences of the sensor's inertial position, and of its attitude, know nothing of NED."""
    path, d = helicopter.path, 2e-3
    mounting = Mounting(arm, (0.3, -0.2, 1.0))
    t = np.linspace(60.0, 1150.0, 200)

    def inertial(at):
        motion = sensor_motion(path, at, mounting)
        angle = earth.RATE * at
        spin = np.zeros((at.size, 3, 3))
        spin[:, 0, 0] = spin[:, 1, 1] = np.cos(angle)
        spin[:, 1, 0], spin[:, 0, 1] = np.sin(angle), -np.sin(angle)
        spin[:, 2, 2] = 1.0
        k = path.kinematics(at)
        c_ev = earth.dcm_en(k.llh[:, 0], k.llh[:, 1]) @ rotation.dcm_from_rpy(k.rpy)
        place = earth.llh_to_ecef(k.llh) + c_ev @ np.array(arm)
        return np.einsum("nij,nj->ni", spin, place), spin @ c_ev @ mounting.dcm(), place, motion

    (before, c_before, _, _), (here, c, place, motion), (after, c_after, _, _) = (inertial(t + s) for s in (-d, 0.0, d))
    np.testing.assert_allclose(earth.llh_to_ecef(motion.llh), place, atol=1e-8)
    acceleration = (after - 2 * here + before) / d**2
    # gravitation = gravity + centrifugal part
    llh = earth.ecef_to_llh(place)
    g = np.zeros((t.size, 3))
    g[:, 2] = earth.gravity(llh[:, 0], llh[:, 2])
    gravity_e = np.einsum("nij,nj->ni", earth.dcm_en(llh[:, 0], llh[:, 1]), g)
    gravitation_e = gravity_e - earth.RATE**2 * place * np.array([1.0, 1.0, 0.0])
    c_eb = earth.dcm_en(llh[:, 0], llh[:, 1]) @ rotation.dcm_from_rpy(motion.rpy)
    spin_part = np.einsum("nji,nj->ni", c_eb, gravitation_e)
    expected = np.einsum("nji,nj->ni", c, acceleration) - spin_part
    np.testing.assert_allclose(motion.f_ib_b, expected, atol=2e-3)  # rounding of 6e6 m over d^2
    assert np.abs((motion.f_ib_b - expected).mean(axis=0)).max() < 2e-4
    rate = rotation.vector_from_dcm(np.swapaxes(c_before, 1, 2) @ c_after) / (2 * d)
    np.testing.assert_allclose(motion.w_ib_b, rate, atol=3e-6)


def test_continuous_mode_converges_with_the_step(helicopter):
    error = {}
    for rate in (50.0, 100.0):
        ideal = ideal_imu(helicopter, rate, mode="continuous")
        error[rate] = np.linalg.norm(navigation_error(ideal)[:, :3], axis=1).max()
    assert error[100.0] < 0.01
    assert error[50.0] / error[100.0] >= 3.5


def test_means_and_samples_say_what_they_are(helicopter):
    span = (0.0, 300.0)
    increments = ideal_imu(helicopter, mode="continuous", span=span)
    means = ideal_imu(helicopter, mode="continuous", kind="mean", span=span)
    np.testing.assert_allclose(means.imu.as_increments().gyro, increments.imu.gyro, rtol=1e-12, atol=1e-18)
    samples = ideal_imu(helicopter, 200.0, mode="continuous", kind="sample", span=span)
    error = np.linalg.norm(navigation_error(samples)[:, :3], axis=1).max()
    assert 1e-4 < error < 5.0  # the trapezoid of samples is what it is


# -- laws
# ---------------------------------------------------------------------------------------------------------------------


def moved_path(path, origin):
    return SmoothPath(path.position, path.attitude, np.asarray(origin), "moved")


@pytest.mark.parametrize("mode", ["exact", "continuous"])
def test_longitude_does_not_matter(helicopter, mode):
    path, span = helicopter.path, (0.0, 300.0)
    here = ideal_imu(path, mode=mode, span=span)
    there = ideal_imu(moved_path(path, path.origin + np.array([0, 3.0, 0])), mode=mode, span=span)
    # rounding of radians: 4e-16 rad of 3 rad in position, 1e-9 m; the signals do not carry it further
    np.testing.assert_allclose(there.imu.gyro, here.imu.gyro, atol=1e-13)
    np.testing.assert_allclose(there.imu.accel, here.imu.accel, atol=1e-11)


def test_the_other_hemisphere_is_the_mirror_image(helicopter):
    """North becomes south: positions and velocities north, roll, and heading from north change sign; so do w_x, w_z
    and f_y.
    """
    path, t = helicopter.path, np.linspace(30.0, 1100.0, 300)
    flip = np.array([-1.0, 1.0, 1.0])
    from scipy.interpolate import PPoly

    position = PPoly(path.position.c * flip, path.position.x)
    attitude = path.attitude.c * np.array([-1.0, 1.0, -1.0])
    attitude[-1, :, 2] += np.pi  # heading psi to pi - psi: east stays east
    mirror = SmoothPath(position, PPoly(attitude, path.attitude.x), path.origin * np.array([-1, 1, 1]), "mirror")
    one, other = (sensor_motion(p, t, Mounting()) for p in (path, mirror))
    np.testing.assert_allclose(other.w_ib_b, one.w_ib_b * [-1, 1, -1], atol=1e-13)
    np.testing.assert_allclose(other.f_ib_b, one.f_ib_b * [1, -1, 1], atol=1e-11)


def test_a_turned_sensor_feels_the_same_in_its_own_axes(helicopter):
    t = np.linspace(30.0, 1100.0, 300)
    turned = Mounting((0.5, 0.2, -0.3), (1.0, -0.5, 2.0))
    plain, other = (sensor_motion(helicopter.path, t, m) for m in (Mounting(turned.lever_arm), turned))
    np.testing.assert_allclose(other.w_ib_b, plain.w_ib_b @ turned.dcm(), atol=1e-14)
    np.testing.assert_allclose(other.f_ib_b, plain.f_ib_b @ turned.dcm(), atol=1e-12)
    np.testing.assert_array_equal(other.vel_ned, plain.vel_ned)


def test_a_later_start_is_the_same_flight(helicopter):
    whole = ideal_imu(helicopter, mode="continuous", span=(0.0, 200.0))
    part = ideal_imu(helicopter, mode="continuous", span=(100.0, 200.0))
    np.testing.assert_allclose(part.imu.accel[1:], whole.imu.accel[10001:], atol=1e-13)
    np.testing.assert_allclose(part.imu.gyro[1:], whole.imu.gyro[10001:], atol=1e-15)


def test_bad_options_are_named(helicopter, ideal):
    with pytest.raises(InputError, match=r"needs mode 'continuous'|need mode 'continuous'"):
        ideal_imu(helicopter, kind="sample")
    with pytest.raises(InputError, match="did you mean 'exact'"):
        ideal_imu(helicopter, mode="exakt")
    with pytest.raises(InputError, match="smooth path"):
        ideal_imu(ideal.reference, mode="continuous")
    with pytest.raises(InputError, match="outside the path"):
        ideal_imu(helicopter, span=(0.0, 2000.0))
    with pytest.raises(InputError, match=r"unknown trajectory 'helicoptr_mapping'.*helicopter_mapping"):
        built_in("helicoptr_mapping")


# -- stochastic errors
# --------------------------------------------------------------------------------------------------------


def test_corrupt_adds_the_drawn_errors_times_the_interval(ideal):
    truth = {"gyro_x": 2 * GM(1e-4, 0.01) + WN(1e-4), "accel_z": WN(1e-3)}
    out = corrupt(ideal.imu, truth, np.random.default_rng(3))
    assert out.components["gyro_x"].shape == (3, len(ideal.imu))
    np.testing.assert_allclose(out.components["gyro_x"].sum(0), out.errors[:, 0], atol=1e-18)
    np.testing.assert_allclose(
        (out.imu.gyro - ideal.imu.gyro)[1:, 0] / np.diff(ideal.imu.t), out.errors[1:, 0], atol=1e-12
    )
    assert not out.errors[:, 1:5].any()
    means = ideal_imu(built_in("static"), kind="mean").imu
    np.testing.assert_allclose(
        corrupt(means, truth, np.random.default_rng(3)).imu.accel[:, 2] - means.accel[:, 2],
        out.errors[:, 5],
        atol=1e-12,
    )


def test_an_axis_draws_alone(ideal):
    both = corrupt(ideal.imu, {"gyro_x": WN(1e-4), "accel_z": WN(1e-3)}, np.random.default_rng(9))
    one = corrupt(ideal.imu, {"accel_z": WN(1e-3)}, np.random.default_rng(9))
    np.testing.assert_array_equal(both.errors[:, 5], one.errors[:, 5])


def test_unknown_axis_is_named(ideal):
    with pytest.raises(InputError, match="'gyro_u'"):
        corrupt(ideal.imu, {"gyro_u": WN(1e-4)}, np.random.default_rng(0))


def test_recorded_pieces_do_not_overlap_and_lose_their_mean(ideal):
    n = len(ideal.imu)
    values = np.random.default_rng(1).normal(3.0, 1.0, (3 * n + 500, 6))
    recorded = RecordedErrors(values, 100.0)
    assert recorded.count(n) == 3
    rng = np.random.default_rng(0)
    pieces = [corrupt(ideal.imu, recorded, rng, realization=r).errors for r in range(3)]
    np.testing.assert_allclose(np.concatenate(pieces), (values - values.mean(0))[: 3 * n], atol=1e-12)
    assert np.abs(RecordedErrors(values, 100.0, remove_mean="piece").piece(1, n).mean(0)).max() < 1e-12
    spanned = RecordedErrors(values, 100.0, remove_mean=(10.0, 20.0), offset_s=5.0, order=(1, 0))
    np.testing.assert_allclose(spanned.piece(1, n), (values - values[1000:2000].mean(0))[500 : 500 + n], atol=1e-12)
    with pytest.raises(InputError, match=r"3 piece\(s\).*piece 4 does not exist"):
        recorded.piece(3, n)
    with pytest.raises(InputError, match=r"recorded at 50 Hz.*not resampled"):
        corrupt(ideal.imu, RecordedErrors(values, 50.0), rng)
    with pytest.raises(InputError, match="outside the record"):
        RecordedErrors(values, 100.0, offset_s=1e6)


# -- GNSS
# ---------------------------------------------------------------------------------------------------------------------


def test_fixes_at_nodes_are_the_nodes(ideal):
    fixes = gnss_fixes(ideal.reference, 1.0, 0.0, 0.0, rng=np.random.default_rng(0))
    rows = np.arange(100, len(ideal.reference), 100)
    # the weights of an interpolation at a node are 1 and 0 within eps, a step is 1 m
    np.testing.assert_allclose(fixes.llh, ideal.reference.llh[rows], rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(fixes.vel_ned, ideal.reference.vel_ned[rows], rtol=1e-14, atol=1e-13)
    assert fixes.t[0] == 1.0 and len(fixes) == 1200


def test_antenna_between_nodes_follows_the_path(helicopter, ideal):
    t = np.linspace(100.003, 1100.003, 500)
    arm = np.array([1.0, -0.5, -1.5])
    llh, vel = antenna(ideal.reference, t, arm)
    motion = sensor_motion(helicopter.path, t, Mounting(tuple(arm)))
    assert np.abs(earth.position_difference(llh, motion.llh)).max() < 2e-4
    assert np.abs(vel - motion.vel_ned).max() < 2e-3


def test_interpolation_at_the_last_node(ideal):
    llh, vel, q, _ = state_at(ideal.reference, ideal.reference.t[-1:])
    np.testing.assert_allclose(llh[0], ideal.reference.llh[-1], rtol=1e-15)
    np.testing.assert_allclose(vel[0], ideal.reference.vel_ned[-1], rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(rotation.rpy_from_quaternion(q)[0], ideal.reference.rpy[-1], atol=1e-12)


def test_rates_between_scattered_nodes_are_those_of_a_turn_that_grows():
    """A heading of a t^2 / 2 turns at a t, which means of intervals and straight lines between nodes give without error."""
    t = np.arange(0.0, 60.0, 0.05)
    level = np.stack([0 * t, 0 * t, 0.001 * t**2 / 2], axis=1)
    turning = Trajectory(t, np.tile([0.8, 0.1, 0.0], (t.size, 1)), np.zeros((t.size, 3)), level)
    at = np.array([40.0, 0.0525, 7.0, 7.31, 59.88, 12.04])
    _, _, q, w = state_at(turning, at)
    np.testing.assert_allclose(w, np.stack([0 * at, 0 * at, 0.001 * at], axis=1), atol=1e-12)
    heading = rotation.rpy_from_quaternion(q)[:, 2]
    np.testing.assert_allclose(heading, 0.001 * at**2 / 2, atol=0.001 * 0.05**2 / 8 + 1e-12)


def test_outages_leave_the_other_fixes_alone(ideal):
    def fixes(*outages):
        return gnss_fixes(ideal.reference, 1.0, 0.02, 0.01, outages=outages, rng=np.random.default_rng(5))

    full, cut = fixes(), fixes(Outage(420.0, 60.0))
    missing = np.setdiff1d(full.t, cut.t)
    np.testing.assert_array_equal(missing, np.arange(421.0, 481.0))
    np.testing.assert_array_equal(cut.llh, full.llh[np.isin(full.t, cut.t)])
    np.testing.assert_array_equal(fixes(Outage(420.0, 0.0)).llh, full.llh)
    with pytest.raises(InputError, match="not inside the trajectory"):
        fixes(Outage(1190.0, 60.0))


def test_fix_noise_has_the_stated_sigma(ideal):
    sigma, sigma_v = np.array([0.01, 0.02, 0.04]), np.array([0.1, 0.2, 0.3])
    fixes = gnss_fixes(ideal.reference, 10.0, sigma, sigma_v, (1.0, 2.0, 3.0), rng=np.random.default_rng(5))
    llh, vel = antenna(ideal.reference, fixes.t, (1.0, 2.0, 3.0))
    n = len(fixes)
    # chi-square at 1e-6 two-sided is within 5 sigma / sqrt(2 n)
    for draw, stated in ((earth.position_difference(fixes.llh, llh), sigma), (fixes.vel_ned - vel, sigma_v)):
        np.testing.assert_allclose(draw.std(axis=0), stated, rtol=5 / np.sqrt(2 * n))
    np.testing.assert_array_equal(fixes.pos_std_ned[0], sigma)


def test_bad_gnss_input_is_named(ideal):
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="position sigma"):
        gnss_fixes(ideal.reference, 1.0, -0.1, rng=rng)
    with pytest.raises(InputError, match="GNSS rate is 0"):
        gnss_fixes(ideal.reference, 0.0, rng=rng)
    with pytest.raises(InputError, match="no fix at"):
        gnss_fixes(ideal.reference, 1e-5, rng=rng)
    with pytest.raises(InputError, match="negative duration"):
        Outage(3.0, -1.0)


def test_axes_are_complete():
    assert len(AXES) == 6
    assert isinstance(ideal_imu(built_in("static")).reference, Trajectory)


def test_a_sensor_stands_for_its_axes(ideal):
    def drawn(truth):
        return corrupt(ideal.imu, truth, np.random.default_rng(1)).errors

    whole = drawn({"gyro": WN(1e-3), "accel": WN(1e-2), "gyro_y": WN(5e-3)})
    spelled = {a: WN(1e-3 if a.startswith("gyro") else 1e-2) for a in AXES} | {"gyro_y": WN(5e-3)}
    np.testing.assert_array_equal(whole, drawn(spelled))


def test_a_record_without_room_is_said(monkeypatch):
    """Records lie in temporary files; on a full disk the folder and what to do are named."""

    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: Full())
    pieces = simulated_pieces(
        {axis: NoiseModel((WN(N=1e-3),)) for axis in AXES},
        501,
        50.0,
        record_s=40.0,
        rng=lambda *key: np.random.default_rng(key),
    )
    with pytest.raises(InputError, match=r"0\.096 MB cannot be written \(No space left on device\); TMPDIR"):
        pieces.piece(0)


def test_pieces_of_a_simulated_record_are_the_same_whoever_asks_for_them():
    """By several threads at once, out of order, twice, or in another process; a record that serves many is drawn once."""
    model = {axis: WN(N=1e-3) + GM(sigma=1e-3, Tc=2.0) for axis in AXES}
    drawn = []

    def pieces():
        return simulated_pieces(
            model, 501, 50.0, record_s=40.0, rng=lambda record, axis: drawn.append((record, axis)) or np.random.default_rng([record, axis]),
            states_at=np.array([0, 100, 500]),
        )  # fmt: skip

    one = pieces()
    expected = [one.piece(k) for k in range(12)]
    assert len(drawn) == 3 * 6  # three records of four pieces
    assert len(one.draw._kept) == 2  # the last one that was done, and the one drawn after it
    record = np.concatenate([p[1:] for p, _ in expected[:4]])
    np.testing.assert_allclose(record.mean(axis=0), 0.0, atol=1e-12)
    drawn.clear()
    other = pieces()
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(other.piece, range(12)))
    assert len(drawn) == 3 * 6
    shipped = pieces()
    state = shipped.draw.__getstate__()
    assert "_lock" not in state and "_kept" not in state
    shipped.draw.__setstate__(state)
    for k in (7, 7, 0, 11, 3):
        for found in (together[k], shipped.piece(k)):
            np.testing.assert_array_equal(found[0], expected[k][0])
            np.testing.assert_array_equal(found[1].axes, expected[k][1].axes)
            assert found[1].states is None


def test_an_antenna_moves_against_the_earth_not_against_the_north():
    """Level flight due east at 64 degrees and 250 m/s turns with the local frame by 8e-5 rad/s: 20 m of arm are 1.6 mm/s of velocity."""
    t = np.arange(0.0, 4.0, 0.01)
    speed = np.tile([0.0, 250.0, 0.0], (t.size, 1))
    llh = np.tile([np.deg2rad(64.0), 0.2, 9000.0], (t.size, 1))
    llh[:, 1] += 250.0 * t / ((earth.radii(llh[0, 0])[1] + 9000.0) * np.cos(llh[0, 0]))
    rpy = np.tile([0.0, 0.0, 0.4], (t.size, 1))
    place, vel = antenna(Trajectory(t, llh, speed, rpy), t[10:-10], (20.0, -8.0, -5.0))
    ecef = earth.llh_to_ecef(place)
    moved = (ecef[2:] - ecef[:-2]) / 0.02
    C = earth.dcm_en(llh[11:-11, 0], llh[11:-11, 1])  # axes of the IMU's place
    # positions have 1e-9 m, which the step makes 1e-7 m/s
    np.testing.assert_allclose(np.einsum("nji,nj->ni", C, moved), vel[1:-1], atol=1e-5)
    assert np.abs(vel - speed[0]).max() > 1e-3
