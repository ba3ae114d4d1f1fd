"""Alignment of an IMU mounted anyhow: at rest, in motion, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters import LooselyCoupledEKF
from insemu.filters.alignment import Track, align, align_at_rest, cut, on_track
from insemu.filters.motion import _moves_from, align_in_motion
from insemu.filters.rest import BIAS_SIGMA, quiet_stretches, rests
from insemu.filters.start import at_state
from insemu.noise import RC, WN
from insemu.records import GnssRecord, ImuRecord, InitialState
from tests import filter_cases as cases
from tests import start_cases
from tests.filter_cases import DT

NOISE = {"gyro": WN(N=1e-4) + RC(sigma=2e-3), "accel": WN(N=1e-3) + RC(sigma=0.02)}
MOUNT = rotation.dcm_from_rpy(np.array([2.9, -0.3, 1.7]))  # IMU axes to body axes


def mounted(imu):
    return ImuRecord(imu.t, imu.gyro @ MOUNT, imu.accel @ MOUNT, kind="increment")


def test_a_drive_aligns_from_nothing_in_any_mounting():
    road = cases.drive(120.0)
    rng = np.random.default_rng(2)
    gnss = cases.fixes(road, rng)
    imu = mounted(cases.corrupt(road.imu, {"gyro": WN(N=1e-4), "accel": NOISE["accel"]}, rng))
    start = align_in_motion(imu, gnss)
    truth = rotation.dcm_from_quaternion(road.nav[start.row, 6:10]) @ MOUNT
    error = rotation.vector_from_dcm(rotation.dcm_from_rpy(start.state.rpy) @ truth.T)
    assert (np.abs(error) < 4 * np.asarray(start.sigma.attitude)).all()
    assert np.abs(error).max() < np.deg2rad(5)
    r = LooselyCoupledEKF({"gyro": WN(N=1e-4) + RC(sigma=1e-4), "accel": NOISE["accel"]}, DT).run(
        cut(imu, start), gnss, start.state, start.sigma
    )
    assert r.fixes.nis[10:].mean() / 6 < 1.5


def test_a_rest_gives_level_and_bias():
    n = 3001
    rpy = np.array([0.1, -0.2, 1.0])
    C = rotation.dcm_from_rpy(rpy)
    w, f = C.T @ earth.earth_rate(0.8), C.T @ [0.0, 0.0, -9.81]
    ideal = ImuRecord(np.arange(n) * DT, np.tile(w * DT, (n, 1)), np.tile(f * DT, (n, 1)), kind="increment")
    imu = cases.corrupt(ideal, {"gyro": NOISE["gyro"], "accel": WN(N=1e-3)}, np.random.default_rng(1))
    still = rests(imu)
    assert still and still[0][1] - still[0][0] > 25
    start = align_at_rest(imu, np.array([0.8, 0.1, 0.0]), (0.0, 30.0), heading=1.0, heading_sigma=0.1)
    np.testing.assert_allclose(start.state.rpy, rpy, atol=1e-3)
    np.testing.assert_allclose(start.bias[:3], (imu.gyro / DT - w)[1:].mean(axis=0), atol=1e-6)
    compass = align_at_rest(ideal, np.array([0.8, 0.1, 0.0]), (0.0, 30.0))
    assert compass.state.rpy[2] == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(InputError, match="at least 10 at rest"):
        align_at_rest(imu, np.array([0.8, 0.1, 0.0]), (0.0, 0.05), heading=0.0)


def test_what_cannot_be_aligned_is_said():
    road = cases.later(cases.drive(60.0), 5.0)
    gnss = cases.fixes(road, np.random.default_rng(0))
    few = GnssRecord(gnss.t[:3], gnss.llh[:3], gnss.vel_ned[:3])
    with pytest.raises(InputError, match="3 fixes"):
        align_in_motion(road.imu, few)
    parked = at_rest_for(60.0, 0.0)
    t = np.arange(1.0, 60.0)
    place = np.tile([0.8, 0.1, 0.0], (t.size, 1))
    noisy = earth.move(place, np.random.default_rng(1).standard_normal((t.size, 3)))
    # the noise of the velocities sums up to far more than a real drive's changes
    wild = np.random.default_rng(2).standard_normal((t.size, 3)) * 0.3
    assert np.linalg.norm(np.diff(wild[:, :2], axis=0), axis=1).sum() > 12.0
    with pytest.raises(InputError, match="does not move enough to tell the heading"):
        align_in_motion(parked, GnssRecord(t, noisy, wild, np.full((t.size, 3), 1.0), np.full((t.size, 3), 0.3)))
    with pytest.raises(InputError, match="needs a fix faster than 3 m/s"):
        align(parked, GnssRecord(t, noisy, wild))


def at_rest_for(seconds, degrees_per_second, *, bias=0.0, axis=(0.0, 0.0, 1.0), noise=1e-4, seed=0):
    """An IMU on a turntable (its axis in the body's), with a bias about the same axis."""
    n = round(seconds * 100) + 1
    rate = np.deg2rad(degrees_per_second)
    axis = np.asarray(axis) / np.linalg.norm(axis)
    up = np.array([0.0, 0.0, -9.81])
    turned = rotation.dcm_from_quaternion(rotation.quaternion_from_vector(-axis * rate * np.arange(n)[:, None] * DT))
    gyro = np.tile(axis * (rate + np.deg2rad(bias)) * DT, (n, 1))
    ideal = ImuRecord(np.arange(n) * DT, gyro, turned @ up * DT, kind="increment")
    return cases.corrupt(ideal, {"gyro": WN(N=noise), "accel": WN(N=1e-3)}, np.random.default_rng(seed))


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.2, 0.1), (0.5, 0.5, 0.7)])
def test_a_turntable_is_never_at_rest(axis):
    for rate in (0.5, 1.0, 3.0, 8.0, 14.0, 30.0):
        for noise in (1e-5, 3e-4):
            assert rests(at_rest_for(20.0, rate, axis=axis, noise=noise)) == [], (rate, noise)


def test_gravity_tells_a_slow_turn_about_a_horizontal_axis_from_a_bias():
    assert quiet_stretches(at_rest_for(2.5, 0.2, axis=(1.0, 0.0, 0.0), noise=1e-5)) == []
    assert quiet_stretches(at_rest_for(2.5, 0.0, bias=0.2, axis=(1.0, 0.0, 0.0), noise=1e-5))


def test_a_cheap_gyroscope_may_rest_where_something_tells_its_bias():
    assert rests(at_rest_for(20.0, 0.0))
    # about a horizontal axis gravity tells: a body that showed 2 deg/s and turned would have moved it
    level = at_rest_for(20.0, 0.0, bias=2.0, axis=(1.0, 0.0, 0.0))
    (quiet,) = quiet_stretches(level)
    assert quiet.still
    value, covariance = quiet.bias()
    assert abs(np.rad2deg(value[0]) - 2.0) < 2.6 * np.rad2deg(np.sqrt(covariance[0, 0])) < 0.2
    # about the vertical nothing does, and the bias keeps a wide standard deviation
    upright = at_rest_for(20.0, 0.0, bias=2.0)
    (quiet,) = quiet_stretches(upright)
    assert not quiet.still and rests(upright) == []
    value, covariance = quiet.bias()
    assert abs(value[2]) < 1e-9 and np.sqrt(covariance[2, 2]) == pytest.approx(BIAS_SIGMA, rel=0.01)
    # unless the bias is known from elsewhere, or another stop shows the same
    known = np.array([0.0, 0.0, np.deg2rad(2.0)]), np.eye(3) * np.deg2rad(0.02) ** 2
    assert rests(upright, bias=known)
    other = np.array([0.0, 0.0, np.deg2rad(1.0)]), known[1]
    assert rests(upright, bias=other) == []


def test_stops_with_motion_between_tell_the_bias_together():
    first, second = at_rest_for(15.0, 0.0, bias=1.0), at_rest_for(15.0, 0.0, bias=1.0, seed=1)
    road = cases.later(cases.drive(25.0), 5.0)
    drive = ImuRecord(road.t, road.imu.gyro + np.array([0, 0, np.deg2rad(1.0) * DT]), road.imu.accel, kind="increment")
    parts = (first, drive, second)
    n = sum(map(len, parts))
    imu = ImuRecord(
        np.arange(n) * DT,
        *(np.concatenate([getattr(p, k) for p in parts]) for k in ("gyro", "accel")),
        kind="increment",
    )
    t = np.arange(0.0, n * DT, 0.5)
    speed = np.where((t > 15.0) & (t < 35.0), 8.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    gnss = GnssRecord(t, np.tile([0.8, 0.1, 0.0], (t.size, 1)), speed)
    assert len(rests(imu, gnss)) == 2
    assert rests(imu, replace(gnss, vel_ned=np.zeros_like(speed))) == []  # nothing moved between: both may turn


def test_positions_alone_align_in_motion_and_at_a_stop():
    s = start_cases.emulate("rest", 4)
    assert s.gnss.vel_ned is None
    for how in (start_cases.in_motion, start_cases.on_course):
        verdict = start_cases.judged(s, how)
        assert not verdict.refused and verdict.heading < 2.6 and verdict.bias < 3.0


def starts(kind, runs):
    out = [start_cases.judged(start_cases.emulate(kind, seed), start_cases.in_motion) for seed in range(runs)]
    return [v for v in out if not v.refused]


@pytest.mark.slow(reason="hours of flight or many realizations")
@pytest.mark.parametrize("kind", start_cases.KINDS)
def test_starts_are_honest(kind):
    told = starts(kind, 4)
    assert all(v.heading < 3.3 and v.bias < 3.3 for v in told)  # 0.1 %
    if kind == "rest":
        assert told


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_two_hundred_starts_are_inside_their_bounds():
    told = [v for kind in start_cases.KINDS for v in starts(kind, 40)]
    assert len(told) > 60
    allowed = stats.binom.ppf(0.999, len(told), 0.01)
    assert sum(v.heading > start_cases.K99 for v in told) <= allowed
    assert sum(v.bias > start_cases.K99 for v in told) <= stats.binom.ppf(0.999, 3 * len(told), 0.01)


def test_later_motion_is_tried_where_the_first_tells_nothing():
    """A vehicle that waits, goes, and goes on: the first fix that moves, and one every 40 s from there; one that never moves has a single start."""
    t = np.arange(0.0, 200.0)
    north = np.concatenate([np.zeros(60), 5.0 * np.arange(140.0)])
    way = np.stack([north, np.zeros(t.size), np.zeros(t.size)], axis=1)
    fixes = GnssRecord(
        t, earth.move(np.tile([0.8, 0.1, 200.0], (t.size, 1)), way), pos_std_ned=np.full((t.size, 3), 0.1)
    )
    found = _moves_from(fixes)
    assert found[0] == pytest.approx(51, abs=2) and list(np.diff(found)) == [40] * (len(found) - 1) and len(found) == 4
    still = GnssRecord(t, np.tile([0.8, 0.1, 200.0], (t.size, 1)), pos_std_ned=np.full((t.size, 3), 0.1))
    assert _moves_from(still) == [0]


def test_a_start_is_carried_from_the_time_that_it_is_known_at():
    """An IMU at 10 Hz whose first sample comes 60 ms after fix or known state: 1.2 m further at 20 m/s, 0.18 m/s faster at 3 m/s^2."""
    late, velocity, slope = 0.06, np.array([20.0, -5.0, 1.0]), np.array([3.0, 0.0, 0.0])
    t = 100.0 + late + 0.1 * np.arange(-20, 40)
    imu = ImuRecord(t, np.zeros((t.size, 3)), np.tile([3.0, 0.0, -9.8], (t.size, 1)))
    place, sd = np.array([0.8, 0.1, 200.0]), np.full((1, 3), 0.02)
    known = InitialState(100.0, place, velocity, np.zeros(3), np.full(9, 0.1))
    found = at_state(imu, known)
    assert found.t == pytest.approx(100.0 + late)
    np.testing.assert_allclose(earth.position_difference(found.state.llh, place), velocity * late, atol=1e-5)
    track = Track(0, velocity, slope, np.full(3, 0.1), 0.1)
    gnss = GnssRecord(np.array([100.0]), place[None], velocity[None], sd, sd)
    rest, state, _ = on_track(imu, gnss, track, np.zeros(3))
    assert rest.t[0] == pytest.approx(100.0 + late)
    away = velocity * late + 0.5 * slope * late**2
    np.testing.assert_allclose(earth.position_difference(state.llh, place), away, atol=0.01)
    np.testing.assert_allclose(state.vel_ned, velocity + slope * late, rtol=1e-9)
