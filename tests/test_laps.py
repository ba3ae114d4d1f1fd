"""Flights longer than their motion, and flights in stretches."""

from __future__ import annotations

import numpy as np
import pytest

from insemu import earth
from insemu.emulate import MotionSource, Mounting, built_in, ideal_imu, ideal_stretches, load_flight


def test_laps_go_on_from_each_other() -> None:
    """A lap is the motion turned by what the heading changed and moved by where it ended; nothing jumps between laps."""
    once = built_in("urban_drive_2").path
    path = load_flight(MotionSource(builtin="urban_drive_2", duration_s=2.5 * once.duration)).flight.path
    assert path.end == 3 * once.duration
    turn = once.attitude(once.end)[2] - once.attitude(once.start)[2]
    c, s = np.cos(2 * turn), np.sin(2 * turn)
    t = np.linspace(0.0, once.duration, 500)
    third = path.position(t + 2 * once.duration)
    moved = once.position(t) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # rows: the transpose of a turn by 2 turn
    np.testing.assert_allclose(third - third[0], moved - moved[0], atol=1e-6)
    np.testing.assert_allclose(path.attitude(t + 2 * once.duration)[:, 2], once.attitude(t)[:, 2] + 2 * turn, atol=1e-9)
    # across a join velocity is the derivative of position
    for join in (once.duration, 2 * once.duration):
        near = join + np.linspace(-30.0, 30.0, 6001)
        mean = np.diff(path.position(near), axis=0) / 0.01
        np.testing.assert_allclose(mean, path.position(near[:-1] + 0.005, 1), atol=1e-3)
    # north and east of the map turn with the heading: the vehicle moves where it points
    fast = t[np.linalg.norm(once.position(t, 1)[:, :2], axis=1) > 5.0] + 2 * once.duration
    v, heading = path.vel_ned(fast), path.rpy(fast)[:, 2]
    across = -np.sin(heading) * v[:, 0] + np.cos(heading) * v[:, 1]
    before = once.vel_ned(fast - 2 * once.duration)
    own = once.rpy(fast - 2 * once.duration)[:, 2]
    np.testing.assert_allclose(across, -np.sin(own) * before[:, 0] + np.cos(own) * before[:, 1], atol=0.02)


@pytest.mark.parametrize(
    ("mode", "kind", "mounting"),
    [
        ("exact", "increment", None),
        ("exact", "mean", Mounting((0.3, 0.1, -0.2), (0.1, 0.0, 0.2))),
        ("continuous", "increment", None),
        ("continuous", "sample", Mounting((0.3, 0.1, -0.2), (0.1, 0.0, 0.2))),
    ],
)
@pytest.mark.parametrize("size", [2, 1000])
def test_stretches_are_the_whole(mode, kind, mounting, size) -> None:
    """The same arithmetic in the same order, up to what vector instructions of other lengths round."""
    path = built_in("urban_drive_1").path
    end = path.start + (6.0 if size == 2 else 60.0)
    options = {"mode": mode, "kind": kind, "mounting": mounting}
    whole = ideal_imu(path, 50.0, span=(path.start, end), **options)
    row = 0
    for part in ideal_stretches(path, 50.0, size, end_s=end, **options):
        rows = slice(row, row + len(part.imu))
        np.testing.assert_array_equal(part.imu.t, whole.imu.t[rows])
        np.testing.assert_allclose(part.imu.gyro, whole.imu.gyro[rows], rtol=0, atol=1e-15)
        np.testing.assert_allclose(part.imu.accel, whole.imu.accel[rows], rtol=0, atol=1e-13)
        assert np.abs(earth.position_difference(part.reference.llh, whole.reference.llh[rows])).max() < 1e-8
        np.testing.assert_allclose(part.reference.rpy, whole.reference.rpy[rows], rtol=0, atol=1e-14)
        row += len(part.imu) - 1
    assert row == len(whole.imu) - 1
