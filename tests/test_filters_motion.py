"""Alignment of an IMU mounted anyhow: at rest, in motion, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters import LooselyCoupledEKF
from insemu.filters.alignment import align_at_rest, cut
from insemu.filters.rest import rests
from insemu.filters.motion import align_in_motion
from insemu.noise import RC, WN
from insemu.records import GnssRecord, ImuRecord
from tests import filter_cases as cases
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
    np.testing.assert_allclose(start.gyro_bias, (imu.gyro / DT - w)[1:].mean(axis=0), atol=1e-6)
    compass = align_at_rest(ideal, np.array([0.8, 0.1, 0.0]), (0.0, 30.0))
    assert compass.state.rpy[2] == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(InputError, match="at least 10 at rest"):
        align_at_rest(imu, np.array([0.8, 0.1, 0.0]), (0.0, 0.05), heading=0.0)


def test_what_cannot_be_aligned_is_said():
    road = cases.drive(20.0)
    gnss = cases.fixes(road, np.random.default_rng(0))
    with pytest.raises(InputError, match="no velocity"):
        align_in_motion(road.imu, replace(gnss, vel_ned=None, vel_std_ned=None))
    with pytest.raises(InputError, match="the velocity changes by"):
        align_in_motion(road.imu, replace(gnss, vel_ned=np.tile(gnss.vel_ned[:1], (len(gnss), 1))))
    few = GnssRecord(gnss.t[:3], gnss.llh[:3], gnss.vel_ned[:3])
    with pytest.raises(InputError, match="3 fixes"):
        align_in_motion(road.imu, few)
