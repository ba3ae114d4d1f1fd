"""Compiled passes of the sensor chain against the same sums written with matrices."""

from __future__ import annotations

import numpy as np
import pytest

from insemu import earth
from insemu.effects import passes
from insemu.rotation import dcm_from_rpy
from tests.pins import numbers

N = 11


def _rows(seed: int, count: int = 6, n: int = N) -> np.ndarray:
    return numbers(count * n, seed).reshape(count, n)


def test_records_become_rates_and_rates_become_records() -> None:
    gyro, accel, step = _rows(1).T[:, :3].copy(), _rows(2).T[:, :3].copy(), 0.01 + 0.001 * np.arange(N)
    signal = np.empty((6, N))
    passes.load(gyro, accel, step, signal)
    np.testing.assert_allclose(signal, np.vstack([gyro.T, accel.T]) / step, rtol=1e-14)
    kept = np.array([0, 3, 10])
    back, beside = np.empty((3, 3)), np.empty((3, 3))
    passes.unload(signal, step, kept, back, beside)
    np.testing.assert_allclose(back, gyro[kept], rtol=1e-14)
    np.testing.assert_allclose(beside, accel[kept], rtol=1e-14)
    nothing = np.empty(0)
    passes.load(gyro, accel, nothing, signal)
    passes.unload(signal, nothing, kept, back, beside)
    np.testing.assert_array_equal(signal, np.vstack([gyro.T, accel.T]))
    np.testing.assert_array_equal(back, gyro[kept])
    np.testing.assert_array_equal(beside, accel[kept])


@pytest.mark.parametrize("shares", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.2), (0.3, -0.7, 0.1)])
def test_what_is_left_out_is_the_turned_rate_of_the_frame(shares: tuple[float, float, float]) -> None:
    """Earth rate, transport rate and an acceleration along down, by rotation matrices."""
    rpy = np.stack([0.9 * numbers(N, 3), 0.3 * numbers(N, 4), 0.8 * numbers(N, 5)], axis=1)
    latitude, height, vel = 0.5 * numbers(N, 6), 4e4 * numbers(N, 7) ** 2, 90.0 * _rows(8, 3).T.copy()
    signal = np.zeros((6, N))
    half = np.tan(0.5 * np.vstack([rpy.T, latitude]))
    passes.leave_out(signal, half, height, vel, *shares)
    for k in range(N):
        rm, rn = earth.scalar_radii(np.sin(latitude[k]))
        turn = shares[0] * earth.RATE * np.array([np.cos(latitude[k]), 0.0, -np.sin(latitude[k])])
        east, north = vel[k, 1] / (rn + height[k]), vel[k, 0] / (rm + height[k])
        turn += shares[1] * np.array([east, -north, -east * np.tan(latitude[k])])
        body_of_ned = dcm_from_rpy(rpy[k]).T
        np.testing.assert_allclose(signal[:3, k], -body_of_ned @ turn, rtol=1e-10, atol=1e-18)
        np.testing.assert_allclose(signal[3:, k], -body_of_ned @ [0.0, 0.0, shares[2]], rtol=1e-10, atol=1e-15)


def test_the_response_is_the_stated_polynomial() -> None:
    signal, mounting, matrix = _rows(1), _rows(2, 3, 3), _rows(3, 6, 6)
    asymmetry, square, cube, offset = _rows(4, 4, 6)
    places, factors = np.array([[0, 3, 4], [5, 5, 1]]), np.array([0.7, -1.3])
    warm, warm_factors, levels = np.array([[1, 2, 1], [4, 0, 0]]), np.array([0.4, 2.0]), _rows(5, 2)
    x = np.vstack([mounting @ signal[:3], mounting @ signal[3:]])
    want = x + matrix @ x + (asymmetry * np.abs(x).T + square * x.T**2 + cube * x.T**3 + offset).T
    want[0] += 0.7 * x[3] * x[4]
    want[5] -= 1.3 * x[5] * x[1]
    want[1] += 0.4 * levels[1] * x[2]
    want[4] += 2.0 * levels[0] * x[0]
    sums = mounting, matrix, asymmetry, square, cube, offset
    passes.respond(signal, passes.ResponseArrays(*sums, places, factors, warm, warm_factors, levels))
    np.testing.assert_allclose(signal, want, rtol=1e-11, atol=1e-12)


def test_rows_take_what_is_added() -> None:
    x, level, d = _rows(1, 3)
    for call, want in (
        (lambda row: passes.add_scaled(row, x, 0.3), 0.3 * x),
        (lambda row: passes.add_product(row, x, level, 0.3), 0.3 * level * x),
        (lambda row: passes.add_cubic(row, d, 0.2, -0.7, 1.1), 0.2 * d - 0.7 * d**2 + 1.1 * d**3),
    ):
        row = np.arange(float(N))
        call(row)
        np.testing.assert_allclose(row, np.arange(N) + want, rtol=1e-13)


def test_speed_profile_and_waves() -> None:
    vel, out = _rows(1, N, 3), np.empty(N)
    passes.speeds(vel, out)
    np.testing.assert_allclose(out, np.linalg.norm(vel, axis=1), rtol=1e-14)
    speed, out = np.array([0.0, 1.0, 2.5, 4.0, 5.0, 9.0]), np.empty(6)
    passes.motion_profile(speed, 0.2, out)
    np.testing.assert_allclose(out, 0.2 + 0.8 * np.array([0.0, 0.104, 0.5, 0.896, 1.0, 1.0]), rtol=1e-14)
    t, wave = 5.13 + 0.1 * np.arange(N), np.empty(N)
    passes.half_angle(t, 1.3, 0.4, wave)
    half = np.tan(wave)
    passes.sines(half)
    np.testing.assert_allclose(half, np.sin(2.0 * np.pi * 1.3 * (t - 5.13) + 0.4), atol=1e-13)
    sine, cosine = passes.sine_cosine(np.tan(0.35))
    np.testing.assert_allclose([sine, cosine], [np.sin(0.7), np.cos(0.7)], rtol=1e-14)


def test_outliers_and_the_telegraph_are_drawn_in_their_order() -> None:
    """All uniform numbers of the record first; then one Gaussian per outlier, or the sign of the first level."""
    n = 400
    row, rng = np.ones(n), np.random.default_rng(3)
    passes.add_outliers(row, 0.1, 4.0, np.random.default_rng(3))
    hit = rng.random(n) < 0.1
    want = np.ones(n)
    want[hit] += 4.0 * rng.standard_normal(int(hit.sum()))
    np.testing.assert_allclose(row, want, rtol=1e-14)
    for seed in range(3, 12):
        row, rng = np.ones(n), np.random.default_rng(seed)
        passes.add_telegraph(row, 0.05, 2.5, np.random.default_rng(seed))
        switch = rng.random(n) < 0.05
        first = 2.5 if rng.random() < 0.5 else -2.5
        np.testing.assert_array_equal(row, 1.0 + first * (-1.0) ** np.cumsum(switch))
