"""A start at the first fix, from both sides: what it states holds, and what it takes off is told in whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import rotation
from insemu.filters import start
from insemu.formats import read_recording, write
from insemu.gap import Nominal
from insemu.gap.drive import starting_state
from insemu.noise import RC, WN
from insemu.prepared import Stated, prepared
from insemu.records import AXES, Recording
from insemu.scenario import Gnss
from tests import start_cases

LARGE = np.array([*np.deg2rad([5.0, -3.0, 4.0]), 0.3, -0.2, 0.25])


@pytest.mark.parametrize(("kind", "seed"), [("rest", 1), ("boat", 2), ("hand", 2)])
@pytest.mark.parametrize("bias", [np.zeros(6), LARGE], ids=["", "large"])
def test_a_drive_is_started_at_its_first_fix(kind: str, seed: int, bias: np.ndarray) -> None:
    s = start_cases.emulate(kind, seed)
    step = np.diff(s.imu.t, prepend=-s.imu.dt)[:, None]
    imu = replace(s.imu, gyro=s.imu.gyro + bias[:3] * step, accel=s.imu.accel + bias[3:] * step)
    found = start(imu, s.gnss, lever_arm=s.lever_arm)
    assert found.t == pytest.approx(s.gnss.t[0], abs=0.011)
    C = rotation.dcm_from_quaternion(s.nav[found.row, 6:10])
    error = rotation.vector_from_dcm(rotation.dcm_from_rpy(found.state.rpy) @ C.T)
    assert (np.abs(error) < 2.0 * np.asarray(found.sigma.attitude)).all()
    assert (np.abs(found.state.vel_ned - s.nav[found.row, 3:6]) < 3.0 * np.asarray(found.sigma.velocity)).all()
    assert (np.abs(found.bias[:3] - s.bias - bias[:3]) < 4.0 * found.bias_sigma[:3]).all()
    assert found.bias_sigma[:3].max() < np.deg2rad(0.05)


def test_gap_starts_where_every_filter_starts() -> None:
    """On vehicles whose course is not their heading, and that are slower than 3 m/s."""
    s = start_cases.emulate("boat", 2)
    noise = {a: WN(N=1e-4) + RC(sigma=0.02) if a.startswith("gyro") else WN(N=1e-3) + RC(sigma=0.1) for a in AXES}
    believed = Nominal(noise, Gnss(lever_arm=tuple(s.lever_arm)))
    imu, _, state, sigma = starting_state(Recording(s.imu, s.gnss), believed)
    found = start(s.imu, s.gnss, lever_arm=s.lever_arm)
    assert imu.t[0] == found.t
    np.testing.assert_allclose(state.rpy, found.state.rpy, atol=1e-9)
    assert (np.asarray(sigma.attitude) >= np.asarray(found.sigma.attitude)).all()


@pytest.mark.parametrize("since", [345_600.0, 1_764_400_000.0], ids=["week", "1970"])
def test_a_start_is_the_same_whenever_its_clock_began(since: float, tmp_path: Path) -> None:
    s = start_cases.emulate("boat", 2)
    write(tmp_path / "own.npz", Recording(s.imu, s.gnss))
    with np.load(tmp_path / "own.npz") as held:
        arrays = {k: v + since if k in ("imu_t", "gnss_t") else v for k, v in held.items()}
    np.savez(tmp_path / "later.npz", **arrays)
    found = []
    for name in ("own", "later"):
        a = prepared(read_recording(tmp_path / f"{name}.npz"), Stated(s.lever_arm)).started().aligned
        found.append(np.concatenate([[a.t], a.state.llh, a.state.vel_ned, a.state.rpy, a.bias, a.sigma.to_array()]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-9)
