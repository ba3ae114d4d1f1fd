"""The filter against an independent program's filter on a 20-minute drive with an outage (``car_100hz``, ``pyins_car_pos_outage``)."""

import numpy as np
import pytest

from insemu import earth
from insemu.filters import FilterOptions, InitialSigma, run_filter
from insemu.noise import RW, WN
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState
from tests.shared_data import shared

DEGREES = np.array([np.pi / 180, np.pi / 180, 1.0])


@pytest.fixture(scope="module")
def replay():
    with np.load(shared("fixtures/inertial/pyins_car_pos_outage.npz")) as file:
        peer = dict(file)
    with np.load(shared("fixtures/inertial/car_100hz.npz")) as file:
        car = dict(file)
    p = dict(zip(peer["params_names"], peer["params"], strict=True))
    noise = peer["imu_noise_counts"] * peer["imu_noise_scale"]
    imu = ImuRecord(car["time"], car["gyro_incr"] + noise[:, :3], car["accel_incr"] + noise[:, 3:], kind="increment")
    pva = peer["initial_pva"]
    belief = {
        "gyro": WN(N=p["gyro_noise"]) + RW(K=p["gyro_bias_walk"], sigma0=p["gyro_bias_sd"]),
        "accel": WN(N=p["accel_noise"]) + RW(K=p["accel_bias_walk"], sigma0=p["accel_bias_sd"]),
    }
    result = run_filter(
        imu,
        GnssRecord(peer["meas_time"], peer["meas_lla"] * DEGREES),
        NavState(pva[:3] * DEGREES, pva[3:6], np.deg2rad(pva[6:])),
        InitialSigma(1.0, 0.1, np.deg2rad([0.5, 0.5, 2.0])),
        belief,
        gnss_sigma=(p["pos_sd_m"], None),
        gravity="free_air_first_order",
        options=FilterOptions(covariance_at=tuple(peer["ff_time"])),
    )
    return peer, car, result


def euler_sigma(covariance, rpy):
    """Standard deviations of roll, pitch and heading from the covariance of phi in north, east, down."""
    pitch, heading = rpy[:, 1], rpy[:, 2]
    c, s, z, one = np.cos(heading), np.sin(heading), np.zeros_like(heading), np.ones_like(heading)
    J = np.stack(
        [
            np.stack([c / np.cos(pitch), s / np.cos(pitch), z], axis=1),
            np.stack([-s, c, z], axis=1),
            np.stack([c * np.tan(pitch), s * np.tan(pitch), one], axis=1),
        ],
        axis=1,
    )
    return np.sqrt(np.einsum("kij,kjl,kil->ki", J, covariance, J))


def ratios(replay):
    """Our standard deviations over the peer's, all fifteen states at the peer's epochs."""
    peer, car, r = replay
    rows = np.searchsorted(car["time"], peer["ff_time"] - 1e-6)
    sd = np.sqrt(np.einsum("kii->ki", r.covariance))
    sd[:, 6:9] = euler_sigma(r.covariance[:, 6:9, 6:9], np.deg2rad(car["rph"][rows]))
    theirs = np.hstack([peer["ff_sd"] * np.repeat([1, 1, np.pi / 180], 3), peer["ff_gyro_sd"], peer["ff_accel_sd"]])
    return peer["ff_time"], sd / theirs


def test_predicted_sigma_is_the_peer_filters(replay):
    t, ratio = ratios(replay)
    assert ratio[t >= 200].min() > 0.97 and ratio[t >= 200].max() < 1.03
    assert (np.abs(np.median(ratio[t >= 60], axis=0) - 1) < 0.01).all()


def test_error_in_the_outage_and_innovations_are_the_peer_filters(replay):
    peer, car, r = replay
    error = earth.position_difference(r.nav[:, :3], car["lla"] * DEGREES)
    outage = (r.t > 600) & (r.t <= 660)
    assert np.hypot(*error[outage, :2].T).max() == pytest.approx(14.9, rel=0.1)
    assert 2.8 < r.fixes.nis.mean() < 3.2
    # innovation by innovation: theirs are normalised per component
    normalised = r.fixes.innovation[:, :3] / np.sqrt(np.einsum("fii->fi", r.fixes.S)[:, :3])
    common = np.isin(np.round(r.fixes.t, 3), np.round(peer["innov_pos_time"], 3))
    late = r.fixes.t[common] > 200
    theirs = np.abs(peer["innov_pos_norm"])
    assert np.corrcoef(np.abs(normalised[common])[late].ravel(), theirs[late].ravel())[0, 1] > 0.99
