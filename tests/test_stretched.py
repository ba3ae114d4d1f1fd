"""Flights in stretches: what a flight as a whole gives."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.errors import InputError
from insemu.evaluate import Experiment, emulated, run_experiment, stretched
from insemu.scenario import load

FLIGHT: dict[str, Any] = {
    "title": "a long flight",
    "seed": 11,
    "realizations": 3,
    "trajectory": {"builtin": "urban_drive_2", "rate": "50 Hz", "duration": "1000 s"},
    "truth": {
        "gyro": "WN(N=0.1 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=40 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + RW(K=1 ug*sqrt(Hz)) + GM(sigma=1 mg, Tc=100 s, shared=warm)",
        "record": "2100 s",
    },
    "gnss": {"position_sigma": "1 m", "velocity_sigma": "5 cm/s", "rate": "1 Hz", "lever_arm": ["1 m", 0, "-1 m"],
        "outages": [{"start": "300 s", "duration": "30.5 s"}]},
    "designs": {
        "right": {"gyro": {"truth": True}, "accel": {"truth": True}},
        "slow": {"gyro": "WN(N=0.3 deg/s/sqrt(Hz))", "accel": {"truth": True}, "options": {"covariance_every": 5, "gate": 1e-4}},
    },
}  # fmt: skip


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "flight.yaml"
    path.write_text(yaml.safe_dump(FLIGHT | changes, sort_keys=False), encoding="utf-8")
    return path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stretches of a minute and a half, for flights from twenty seconds on."""
    for module in (emulated, stretched):
        monkeypatch.setattr(module, "MAX_SAMPLES", 1000)
    monkeypatch.setattr(stretched, "STRETCH", 4500)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    path = written(tmp_path_factory.mktemp("whole"))
    return Experiment(load(path), path)


def test_signals_are_those_of_the_whole(whole: Experiment, small: None, tmp_path: Path) -> None:
    """IMU, fixes and what the axes really err by, of the second piece of a record and of the first of the next."""
    path = written(tmp_path)
    world = stretched.emulated_world(load(path), path)
    assert isinstance(world, stretched.StretchedWorld)
    np.testing.assert_array_equal(world.output_times, whole.world.output_times)
    for index in (1, 2):
        recording, true = whole.world.realized(index)
        assert recording.gnss is not None and true is not None
        fixes = world.fixes(stretched.stream(11, "gnss", index))
        np.testing.assert_allclose(fixes.t, recording.gnss.t, rtol=0, atol=0)
        np.testing.assert_allclose(fixes.llh, recording.gnss.llh, rtol=0, atol=1e-15)  # 6 nm
        assert fixes.vel_ned is not None and recording.gnss.vel_ned is not None
        np.testing.assert_allclose(fixes.vel_ned, recording.gnss.vel_ned, rtol=0, atol=1e-12)
        first, axes = 0, []
        for part in world.stretches(index):
            own = slice(first, first + len(part.imu))
            assert len(part.imu) <= 4501
            np.testing.assert_array_equal(part.imu.t, recording.imu.t[own])
            np.testing.assert_allclose(part.imu.gyro[1:], recording.imu.gyro[own][1:], rtol=0, atol=1e-14)
            np.testing.assert_allclose(part.imu.accel[1:], recording.imu.accel[own][1:], rtol=0, atol=1e-13)
            axes.append(part.true.axes)
            first += len(part.imu) - 1
        assert first == len(recording.imu) - 1
        np.testing.assert_allclose(np.concatenate(axes), true.axes, rtol=0, atol=1e-12)


def test_results_are_those_of_the_whole(whole: Experiment, small: None, tmp_path: Path) -> None:
    """All but the correction of the first interval of a stretch by the one before (coning, sculling).

    That is a sixth of the turn of one sample (0.1 deg/s/sqrt(Hz) at 50 Hz: 2.5e-4 rad) times its change of velocity (g dt = 0.2 m/s): 8e-6 m/s,
    where the filters state some cm/s.
    """
    path = written(tmp_path)
    experiment = pickle.loads(pickle.dumps(Experiment(load(path), path)))
    one, two = whole.realization(1), experiment.realization(1)
    assert set(one.data_vars) == set(two.data_vars)
    np.testing.assert_allclose(two["sigma"], one["sigma"], rtol=1e-5)
    assert float((np.abs(two["error"] - one["error"]) / one["sigma"]).max()) < 1e-3
    for name in ("states", "fixes", "dof", "epochs", "rejected", "lag_count"):
        np.testing.assert_array_equal(two[name], one[name])
    for name in ("nis", "nees", "lag_sum", "axis_error", "axis_sigma", "observability"):
        np.testing.assert_allclose(two[name], one[name], rtol=1e-3, atol=1e-3 * float(np.nanstd(one[name])))
    np.testing.assert_allclose(two["block_nees"][:, :5], one["block_nees"][:, :5], rtol=1e-3)


def test_the_length_of_stretches_does_not_matter(small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path)
    found = []
    for size in (4500, 20_000):
        monkeypatch.setattr(stretched, "STRETCH", size)
        found.append(run_experiment(Experiment(load(path), path), realizations=1).data)
    assert float((np.abs(found[0]["error"] - found[1]["error"]) / found[0]["sigma"]).max()) < 1e-3


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"smoother": True}, "smoother"),
        (
            {
                "truth": FLIGHT["truth"]
                | {"effects": [{"effect": "quantization", "sensor": "gyro", "lsb": "0.01 deg/s"}]}
            },
            "truth.effects",
        ),
        ({"designs": {"a": FLIGHT["designs"]["right"] | {"filter": "reference"}}}, r"designs\.a\.filter"),
    ],
)
def test_what_needs_a_whole_flight_is_refused(small: None, tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    path = written(tmp_path, **changes)
    with pytest.raises(
        InputError, match=f"flown in stretches, which is not possible with {told}; expected at most 1000"
    ):
        Experiment(load(path), path)


def test_who_asks_for_all_signals_is_refused(small: None, tmp_path: Path) -> None:
    path = written(tmp_path)
    world = stretched.emulated_world(load(path), path)
    with pytest.raises(InputError, match="needs it as a whole"):
        world.recording(0)
