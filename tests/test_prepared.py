"""One prepared drive: what is stated, assumed, mended and left out, in the same words for all, written and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.formats import read_recording, write
from insemu.gap import Nominal, find_gap
from insemu.noise import RC, WN, NoiseModel
from insemu.prepared import Stated, left_out, prepared
from insemu.records import AXES, InitialState, Recording
from insemu.rotation import dcm_from_rpy
from insemu.solve import candidates
from insemu.solve.beliefs import _scaled

MOUNT = np.deg2rad([100.0, 20.0, -40.0])


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A drive in the axes of its vehicle whose fixes state nothing."""
    ideal = ideal_imu(built_in("urban_drive_1"), 50.0, kind="mean", span=(0.0, 150.0))
    rng = np.random.default_rng(3)
    fixes = gnss_fixes(ideal.reference, 1.0, (0.5,) * 3, (0.05,) * 3, (0.0,) * 3, rng=rng)
    return Recording(ideal.imu, replace(fixes, pos_std_ned=None, vel_std_ned=None), source="drive")


def test_a_prepared_drive_is_written_and_read_back_with_its_remarks(recording: Recording, tmp_path: Path) -> None:
    drive = prepared(recording).shifted(0.05).started()
    write(tmp_path / "drive.npz", drive.recording())
    held = read_recording(tmp_path / "drive.npz")
    again = prepared(held).started()
    assert sum("state no standard deviations" in said for said in drive.remarks) == 2
    assert again.remarks == drive.remarks
    np.testing.assert_allclose(again.aligned.state.to_array(), drive.aligned.state.to_array(), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(again.imu.t, drive.imu.t)
    measured = held.as_measured()
    assert measured.gnss is not None and measured.gnss.pos_std_ned is None
    np.testing.assert_allclose(measured.imu.t, recording.imu.t, atol=1e-9)


def test_mounting_and_clock_are_put_on_the_imu_and_on_the_state_that_a_file_carries(recording: Recording) -> None:
    C = dcm_from_rpy(MOUNT)
    state = InitialState(20.0, np.array([0.8, 0.1, 300.0]), np.zeros(3), np.zeros(3), np.ones(9))
    imu = recording.imu
    turned = replace(recording, imu=replace(imu, gyro=imu.gyro @ C, accel=imu.accel @ C), initial=state).imu_later(0.2)
    drive = prepared(turned, Stated(mounting=MOUNT, imu_late=0.2, begin=10.0, end=100.0, corrected=False))
    inside = (imu.t >= 10.0 - 1e-9) & (imu.t <= 100.0 + 1e-9)
    np.testing.assert_allclose(drive.imu.t, imu.t[inside], atol=1e-9)
    np.testing.assert_allclose(drive.imu.gyro, imu.gyro[inside], atol=1e-12)
    assert drive.known is not None and drive.known.t == pytest.approx(20.0)
    np.testing.assert_allclose(dcm_from_rpy(drive.known.rpy), C.T, atol=1e-12)
    assert drive.clock == 0.2 and drive.measured.imu.t[0] == pytest.approx(drive.imu.t[0] + 0.2)
    with pytest.raises(InputError, match="here: the span from start to end holds no IMU data"):
        prepared(turned, Stated(begin=900.0, where="here"))


def test_what_is_left_out_is_said_with_its_reason(recording: Recording) -> None:
    imu, gnss = recording.imu, recording.gnss
    assert gnss is not None
    torn = replace(recording, imu=imu.rows((imu.t < 40.0) | (imu.t > 43.0)))
    drive = prepared(torn).started()
    (said,) = drive.left_out
    assert said.startswith("29 % of the recording are not solved") and "longest stretch without one" in said
    assert said not in drive.said and drive.remarks[-1] == said
    assert left_out(imu, gnss, 5.0) == ()
    assert left_out(imu, gnss, 30.0) == (
        "20 % of the recording are not solved: the first 30 s, in which nothing tells the heading",
    )
    assert "in which there is no fix" in left_out(imu, gnss.rows(gnss.t > 29.5), 30.0)[0]


def test_lost_samples_stay_for_those_who_look_for_them(recording: Recording) -> None:
    imu = recording.imu
    gone = np.zeros(len(imu), dtype=bool)
    gone[100:-50:50] = True
    lossy = replace(recording, imu=imu.rows(~gone))
    filled, bare = prepared(lossy), prepared(lossy, Stated(corrected=False))
    assert len(filled.imu) == len(imu) and len(bare.imu) == len(imu) - gone.sum()
    assert "filled in" in filled.said[0] and "they stay so" in bare.said[0]
    assert filled.said[1:] == bare.said[1:]


def test_gap_says_what_all_others_say_and_searches_the_longest_stretch(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    imu, seen = recording.imu, []
    torn = replace(recording, imu=imu.rows((imu.t < 40.0) | (imu.t > 43.0)))

    def find(measured: Recording, *_: object) -> None:
        seen.append(measured)
        raise InputError("enough")

    monkeypatch.setattr("insemu.gap.session._find", find)
    nominal = Nominal({a: WN(N=1e-4) + RC(sigma=0.01) for a in AXES})
    with pytest.raises(InputError, match="enough"):
        find_gap(torn, nominal, rng=np.random.default_rng(1))
    assert seen[0].imu.t[0] > 42.9 and seen[0].gnss is torn.gnss
    believed, drive = nominal.on(torn)
    assert drive.said == prepared(torn).said
    assert prepared(torn).gnss.pos_std_ned is not None
    np.testing.assert_allclose(believed.gnss.position_sigma, prepared(torn).gnss.pos_std_ned[0])


def test_factors_on_a_belief_leave_its_turn_on_bias() -> None:
    """Every adapted design took the biases for known at the start."""
    grade = tuple(candidates()[0].belief["gyro_x"])
    white, walk = _scaled(NoiseModel(grade), 2.0, 3.0)
    assert white.parameters["N"] == pytest.approx(2.0 * grade[0].parameters["N"])
    assert walk.parameters["K"] == pytest.approx(3.0 * grade[1].parameters["K"])
    assert walk.sigma0 == grade[1].sigma0 > 0.0  # type: ignore[attr-defined]
