"""Everything that the filter's loop can do, asked for by a scenario: states, gate, updates at rest, alignment, covariance rate, observability."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.errors import InputError
from insemu.evaluate import Experiment, Results, run_experiment, summary
from insemu.evaluate.consistency import unaided_sigma
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.results import consistency_words
from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF
from insemu.formats import write
from insemu.scenario import Scenario, load

MODEL = {"gyro": "WN(N=0.02 deg/s/sqrt(Hz)) + RC(sigma=0.2 deg/s)", "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=5 mg)"}
STATES = {"latency": "0.1 s", "gyro_scale": "20000 ppm"}
SCENARIO: dict[str, Any] = {
    "title": "loop",
    "seed": 5,
    "realizations": 3,
    "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "150 s"},
    "truth": {
        **MODEL,
        "effects": [
            {"effect": "gnss_latency", "latency": "80 ms"},
            {"effect": "gnss_outliers", "probability": 0.05, "sigma": "30 m"},
            {"effect": "scale_factor", "sensor": "gyro", "value": 0.02},
        ],
    },
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "5 cm/s", "lever_arm": ["1 m", "0 m", "-1 m"]},
    "designs": {
        "plain": MODEL,
        "gated": {**MODEL, "options": {"gate": 1e-5, "covariance_every": 5}},
        "all": {
            **MODEL,
            "options": {
                "gate": 1e-5,
                "states": {**STATES, "lever_arm": "0.2 m", "accel_misalignment": "0.2 deg"},
                "zero_updates": {},
            },
        },
        "still": {
            **MODEL,
            "options": {"gate": 1e-5, "states": STATES, "zero_updates": {"every": "2 s", "rate_sigma": None}},
        },
    },
}


@pytest.fixture(scope="module")
def results() -> Results:
    return run_experiment(Experiment(Scenario.model_validate(SCENARIO)))


def test_what_is_asked_for_is_what_flies(results: Results) -> None:
    told = summary(results)["designs"]
    assert [told[name]["states"] for name in results.names] == [15, 15, 28, 19]
    assert {"latency", "lever_arm_x", "gyro_z.scale", "accel_x.from_y"} <= set(told["all"]["state_names"])


def test_the_gate_reports_what_it_keeps_out(results: Results) -> None:
    rejected = results["rejected"]
    assert (rejected[0] == 0).all() and (rejected[1:] >= 4).all()
    assert (rejected[2:] <= 20).all()  # 7.5 outliers of 150 fixes expected, most of them large
    assert summary(results)["designs"]["all"]["rejected_fixes"] == rejected[2].tolist()
    assert any("the gate rejected" in line for line in consistency_words(results, "all"))
    assert not any("the gate" in line for line in consistency_words(results, "plain"))


def test_states_for_what_is_wrong_make_the_filter_know_its_error(results: Results) -> None:
    """Three correlated runs of 150 s: bounds are wide, the twins a hundred times outside."""
    blocks = {name: row["nees_per_dof_by_block"] for name, row in summary(results)["designs"].items()}
    for block in ("velocity", "attitude", "gyro", "accel"):
        assert 0.3 < blocks["all"][block] < 3.0 and 0.3 < blocks["still"][block] < 3.0, block
    assert blocks["gated"]["gyro"] > 30 and blocks["plain"]["position"] > 1000


def test_updates_at_rest_are_counted_and_tell(results: Results) -> None:
    seconds = (results["fixes"][2:] - results["fixes"][1]).mean(axis=1)
    assert 20 < seconds[0] < 60 and seconds[1] == pytest.approx(seconds[0] / 2, abs=5)
    # heading drifts at a stop unless the gyroscopes are told that they do not turn
    still = np.linalg.norm(results.truth.vel_ned, axis=1) < 0.01
    late = still & (results.t > 20.0)
    assert results.sigma[2][:, late, 5].mean() < results.sigma[1][:, late, 5].mean()


def test_observability_of_every_state_over_time(results: Results) -> None:
    d = results.names.index("all")
    share = results["observability"][d].mean(axis=0)
    names = results.designs["all"].state_names[9:]
    assert share.shape == (results.t.size, len(names))
    assert np.abs(share[0]).max() < 1e-9  # nothing is known before the first fix
    end = summary(results)["designs"]["all"]["observability_end"]
    assert end["latency"] > 0.9 and end["gyro_z.scale"] > 0.5 and end["gyro_z.RC1"] > 0.99
    assert end["gyro_x.scale"] < end["gyro_z.scale"]  # a car turns about one axis
    data = results.to_dataset()
    states = list(data["state_name"].sel(design="all").to_numpy())
    last = data["observability"].sel(design="all")[-1, states.index("latency")]
    assert float(last) == pytest.approx(end["latency"])


def test_what_a_state_would_be_without_fixes() -> None:
    from insemu.noise import GM, RW, WN
    from tests import filter_cases as cases

    belief = {"gyro": WN(N=1e-4) + GM(sigma=1e-3, beta=0.2), "accel": WN(N=1e-3) + RW(K=1e-3, sigma0=1e-2)}
    road = cases.drive(10.0)
    ekf = LooselyCoupledEKF(belief, cases.DT, options=FilterOptions(output_every=250))
    run = ekf.run(road.imu, None, cases.start(road, np.random.default_rng(1)), InitialSigma())
    rows = np.round(run.t / cases.DT).astype(int)
    np.testing.assert_allclose(unaided_sigma(ekf.augmentation, rows), run.sigma[:, 9:], rtol=1e-9)


def test_a_recording_starts_at_rest_and_is_aligned_finely_there(tmp_path: Path) -> None:
    """Coarse: level from gravity, heading from the first course. Fine: the filter through the rest, fed zero velocity and rate."""
    world = {**SCENARIO, "truth": dict(MODEL), "realizations": 1, "seed": 8}
    world["designs"] = {"plain": MODEL}
    write(tmp_path / "drive.npz", EmulatedWorld(Scenario.model_validate(world)).recording(0))
    scenario = {
        "title": "recorded",
        "recording": {"file": "drive.npz", "alignment": "rest"},
        "gnss": world["gnss"],
        "designs": {
            "coarse": MODEL,
            "fine": {**MODEL, "options": {"zero_updates": {}}},
        },
    }
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    experiment = Experiment(load(path), path)
    start = experiment.world.alignment  # type: ignore[union-attr]
    assert start.t < 2.0 and np.isfinite(start.bias[:3]).all()
    r = run_experiment(experiment)
    before = r.t < start.standstill[0][1] - 1.0
    # heading is not seen by zero velocity, its drift is
    assert r.sigma[1, 0, before, 8][-1] < r.sigma[0, 0, before, 8][-1]
    # the second rest comes after a drive with turns, of which its mean rate must know nothing
    assert len(start.standstill) > 1
    for d in (0, 1):
        assert 0.3 < r.nees[d, 0].mean() / 9.0 < 3.0
        assert r.nees[d, 0, r.t > start.standstill[1][0] + 3.0].mean() / 9.0 < 5.0
    moving = {**scenario, "recording": {"file": "drive.npz", "alignment": "motion"}}
    path.write_text(yaml.safe_dump(moving), encoding="utf-8")
    later = Experiment(load(path), path)
    assert later.world.alignment.t > start.t + 3.0  # type: ignore[union-attr]
    assert run_experiment(later).nees[0, 0, 0] < 40.0  # the antenna is 1.4 m from the IMU, a fix good to 5 cm
    moving["recording"] = {"file": "drive.npz", "alignment": "rest", "start": "40 s", "end": "60 s"}
    path.write_text(yaml.safe_dump(moving), encoding="utf-8")
    with pytest.raises(InputError, match=r"no rest before|faster than"):
        Experiment(load(path), path)


@pytest.mark.parametrize("record", [None, "3 min"])
def test_the_true_errors_of_the_axes_are_kept_apart_from_white_noise(record: str | None) -> None:
    """Without white noise the kept truth is what was added to the signals; a scale factor counts; noise-like effects say nothing."""
    truth = {
        "gyro": "GM(sigma=0.1 deg/s, Tc=5 s)",
        "accel": "GM(sigma=5 mg, Tc=5 s) + GM(sigma=1 mg, Tc=50 s)",
        "record": record,
    }
    short = {
        **SCENARIO,
        "designs": {"plain": MODEL},
        "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "60 s"},
    }

    def kept(**more: Any) -> tuple[Any, np.ndarray]:
        world = EmulatedWorld(Scenario.model_validate({**short, "truth": {**truth, **more}}))
        recording, known = world.realized(1)
        imu = recording.imu
        rows = np.searchsorted(world.reference.t, world.output_times)
        added = np.hstack([imu.gyro - world.imu.gyro, imu.accel - world.imu.accel])[rows] / imu.dt
        return known, added

    known, added = kept()
    np.testing.assert_allclose(known.axes[1:], added[1:], atol=1e-9)
    assert (known.states is None) == (record is not None)
    if record is None:
        assert known.names == tuple(f"gyro_{a}.GM1" for a in "xyz") + tuple(
            f"accel_{a}.GM{k}" for a in "xyz" for k in (1, 2)
        )
    white = {"gyro": "WN(N=0.1 deg/s/sqrt(Hz)) + GM(sigma=0.1 deg/s, Tc=5 s)"}
    apart, added = kept(**white)
    assert np.std(added[1:, :3] - apart.axes[1:, :3]) == pytest.approx(np.deg2rad(0.1) * np.sqrt(50.0), rel=0.3)
    scaled, added = kept(effects=[{"effect": "scale_factor", "sensor": "gyro", "value": 0.02}])
    np.testing.assert_allclose(scaled.axes[1:], added[1:], atol=1e-9)
    noisy, _ = kept(
        effects=[{"effect": "vibration_band", "sensor": "accel", "rms": 0.05, "frequency": 10, "bandwidth": 5}]
    )
    assert noisy is None
