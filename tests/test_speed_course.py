"""Speed and course as a velocity without a component down: read, started with, flown and emulated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import earth, rotation
from insemu.emulate import built_in, gnss_fixes, ideal_imu, smooth_track
from insemu.evaluate import Experiment, run_experiment
from insemu.evaluate.twin import LinearTwin
from insemu.filters import start
from insemu.filters.alignment import with_standard_deviations
from insemu.formats import open_files, read_recording, write
from insemu.records import GnssRecord, Recording
from insemu.scenario import Scenario
from tests import start_cases
from tests.test_designs import SCENARIO

HEAD = "t [s],lat [deg],lon [deg],height [m],speed [km/h],course [deg]\n"


def level(gnss: GnssRecord) -> GnssRecord:
    """Fixes without the velocity down."""
    velocity = [
        None if v is None else np.where([True, True, False], v, np.nan) for v in (gnss.vel_ned, gnss.vel_std_ned)
    ]
    return replace(gnss, vel_ned=velocity[0], vel_std_ned=velocity[1])


def test_a_course_without_meaning_is_none(tmp_path: Path) -> None:
    """Held or left out below a speed: zero at rest, unknown in motion."""
    rows = ["36,90", "3.0,91", "3.0,91", "0.5,91", "0.5,", "36,", "36,90", "36,90"]
    text = HEAD + "".join(f"{k},46.{5 + k},7,400,{row}\n" for k, row in enumerate(rows))
    imu = "t [s],gx,gy,gz,ax,ay,az\n" + "".join(f"{0.01 * k},0,0,{1e-3 * k},0,0,-9.8\n" for k in range(700))
    (tmp_path / "g.csv").write_text(text)
    (tmp_path / "i.csv").write_text(imu)
    found = open_files(tmp_path / "i.csv", gnss=tmp_path / "g.csv").gnss
    assert found is not None and found.vel_ned is not None
    slow = 3.0 / 3.6 * np.array([np.cos(np.radians(91)), np.sin(np.radians(91))])
    nothing = [np.nan, np.nan]
    wanted = [[0, 10], slow, nothing, [0.5 / 3.6, 0], [0.5 / 3.6, 0], nothing, [0, 10], [0, 10]]
    np.testing.assert_allclose(found.vel_ned[:, :2], wanted, atol=1e-12)
    assert np.isnan(found.vel_ned[:, 2]).all()


@pytest.mark.parametrize(("kind", "seed"), [("rest", 1), ("boat", 1)])
def test_a_drive_starts_with_speed_and_course(kind: str, seed: int) -> None:
    s = start_cases.emulate(kind, seed)
    assert s.gnss.vel_ned is not None
    found = start(s.imu, level(s.gnss), lever_arm=s.lever_arm)
    C = rotation.dcm_from_quaternion(s.nav[found.row, 6:10])
    error = rotation.vector_from_dcm(rotation.dcm_from_rpy(found.state.rpy) @ C.T)
    assert (np.abs(error) < 2.0 * np.asarray(found.sigma.attitude)).all()
    assert (np.abs(found.state.vel_ned - s.nav[found.row, 3:6]) < 3.0 * np.asarray(found.sigma.velocity)).all()


def test_what_is_not_stated_is_assumed_of_the_components_that_are_there(tmp_path: Path) -> None:
    s = start_cases.emulate("rest", 1)
    known, said = with_standard_deviations(replace(level(s.gnss), vel_std_ned=None))
    assert known.vel_std_ned is not None
    assert np.isnan(known.vel_std_ned[:, 2]).all()
    full, _ = with_standard_deviations(replace(s.gnss, vel_std_ned=None))
    assert full.vel_std_ned is not None
    np.testing.assert_array_equal(known.vel_std_ned[:, :2], full.vel_std_ned[:, :2])
    assert "m/s north, east are assumed" in said["velocities"]
    write(tmp_path / "a.npz", Recording(s.imu, known))
    again = read_recording(tmp_path / "a.npz").gnss
    assert again is not None
    np.testing.assert_array_equal(again.vel_ned, known.vel_ned)


def test_a_receiver_of_speed_and_course_is_emulated_and_flown() -> None:
    changed = SCENARIO | {"gnss": SCENARIO["gnss"] | {"velocity_sigma": ["2 cm/s", "2 cm/s", None]}, "realizations": 2}
    scenario = Scenario.model_validate(changed)
    experiment = Experiment(scenario)
    gnss = experiment.world.recording(0).gnss
    assert gnss is not None and gnss.vel_ned is not None
    assert np.isfinite(gnss.vel_ned[:, :2]).all() and np.isnan(gnss.vel_ned[:, 2]).all()
    shown = Scenario.model_validate(scenario.model_dump(mode="json", exclude_none=True)).gnss.velocity_sigma
    assert shown is not None and np.isnan(shown[2])
    results = run_experiment(experiment)
    assert np.isfinite(results.data["error"]).all() and np.isfinite(results.data["nees"]).all()
    twin = LinearTwin(experiment)
    assert np.isfinite(twin.draw(2, np.random.default_rng(1))["full"]).all()
    assert np.isfinite(twin.realization(0)["full"]).all()
    with pytest.raises(ValueError, match="expected a quantity"):
        Scenario.model_validate(changed | {"gnss": {"position_sigma": ["1 m", "1 m", None]}})


def test_a_track_of_speed_and_course_is_flown() -> None:
    flight = ideal_imu(built_in("helicopter_mapping"), 20.0, span=(0.0, 60.0)).reference
    fixes = gnss_fixes(flight, 1.0, 0.5, (0.05, 0.05, np.nan), rng=np.random.default_rng(1))
    inside = (flight.t > 5.0) & (flight.t < 55.0)
    t, own = flight.t[inside], flight.llh[inside]

    def off(gnss: GnssRecord) -> float:
        away = earth.position_difference(smooth_track(gnss, "helicopter").path.llh(t), own)
        return float(np.sqrt(np.mean(away[:, :2] ** 2)))

    assert off(fixes) < 0.7 * off(fixes.without_velocity())
