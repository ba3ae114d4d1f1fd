"""A recording as the world of an experiment: alignment from nothing, outages cut in, errors against the reference or the withheld fixes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu import earth, rotation
from insemu.emulate import dead_reckon
from insemu.errors import InputError
from insemu.evaluate import Experiment, run_experiment, summary
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.recorded import RecordedWorld
from insemu.evaluate.world import _stretches
from insemu.formats import read_recording, write
from insemu.gap import Nominal, check, load_nominal
from insemu.noise import RC, WN
from insemu.prepared import prepared
from insemu.records import AXES, ImuRecord, InitialState, Recording
from insemu.scenario import load
from insemu.stamps import SECOND, Origin
from insemu.transfer import transfer

WORLD: dict[str, Any] = {
    "title": "drive",
    "seed": 5,
    "realizations": 1,
    "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "200 s"},
    "truth": {
        "gyro": "WN(N=0.02 deg/s/sqrt(Hz)) + RC(sigma=0.05 deg/s)",
        "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=2 mg)",
    },
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "5 cm/s"},
    "designs": {"full": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}
MOUNTING = ["170 deg", "-6 deg", "20 deg"]


@pytest.fixture(scope="module")
def recording() -> Recording:
    folder = Path(__file__).parent
    return _emulated(folder)


def _emulated(folder: Path) -> Recording:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "world.yaml"
        path.write_text(yaml.safe_dump(WORLD))
        return EmulatedWorld(load(path), path).recording(0)


def _mounted(recording: Recording) -> Recording:
    """What an IMU that is not mounted straight would have recorded."""
    C_vb = rotation.dcm_from_rpy(np.deg2rad([float(m.split()[0]) for m in MOUNTING]))
    imu = recording.imu
    return replace(recording, imu=replace(imu, gyro=imu.gyro @ C_vb, accel=imu.accel @ C_vb))


def _scenario(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "recorded.yaml"
    document = {
        "title": "recorded",
        "recording": {"file": "drive.npz", "mounting": MOUNTING},
        "gnss": {
            "position_sigma": "5 cm",
            "velocity_sigma": "5 cm/s",
            "outages": [{"start": "120 s", "duration": "20 s"}],
        },
        "designs": {
            "full": {
                "gyro": "WN(N=0.02 deg/s/sqrt(Hz)) + RC(sigma=0.05 deg/s)",
                "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=2 mg)",
            }
        },
    }
    path.write_text(yaml.safe_dump(document | changes))
    return path


@pytest.mark.parametrize("with_reference", [True, False])
def test_a_recorded_drive_is_aligned_flown_and_scored(
    tmp_path: Path, recording: Recording, with_reference: bool
) -> None:
    mounted = _mounted(recording)
    write(tmp_path / "drive.npz", mounted if with_reference else replace(mounted, reference=None))
    path = _scenario(tmp_path)
    r = run_experiment(Experiment(load(path), path), realizations=9)
    assert r.realizations == 1
    outage = summary(r)["designs"]["full"]["outages"][0]
    assert 0.05 < outage["planimetric_end_m"]["mean"] < 6 * outage["predicted_sigma_end_m"]
    settled = r.t > 60
    # chi-square bounds at 1e-6 for one drive whose errors are correlated over tens of seconds: about ten independent epochs
    assert 0.15 < r.nees[0, 0, settled].mean() / 9 < 4
    if not with_reference:
        assert np.isnan(r.error[..., 6:]).all()
        assert outage["attitude_end_deg"] is None


def test_fixes_between_rows_are_compared_with_one_side(tmp_path: Path, recording: Recording) -> None:
    """Fixes 4 ms after the rows of a 50 Hz IMU: the epoch after an outage is scored before or after its fix, never in between."""
    g = recording.gnss
    assert g is not None and g.vel_ned is not None
    later = replace(g, t=g.t + 0.004, llh=earth.move(g.llh, 0.004 * g.vel_ned))
    write(tmp_path / "drive.npz", replace(_mounted(recording), gnss=later, reference=None))
    path = _scenario(tmp_path)
    r = run_experiment(Experiment(load(path), path))
    # an error of metres held against a sigma of centimetres gives tens of thousands
    assert r.nees[0, 0, r.t > 60].max() < 200


def test_a_recorded_drive_is_smoothed_and_repeated_rows_are_told(tmp_path: Path, recording: Recording) -> None:
    mounted = _mounted(recording)
    rows = np.arange(len(mounted.imu))
    rows[5::100] -= 1  # a row in a hundred is read twice
    imu = mounted.imu
    twice = replace(imu, gyro=imu.gyro[rows], accel=imu.accel[rows])
    write(tmp_path / "drive.npz", replace(mounted, imu=twice))
    path = _scenario(tmp_path, smoother=True)
    r = run_experiment(Experiment(load(path), path))
    assert r.smoothed
    row = summary(r)["designs"]["full"]["outages"][0]
    assert row["smoothed"]["planimetric_max_m"] < row["planimetric_max_m"]
    assert "samples of the IMU are lost, where rows repeat the row before: they stay so" in r.manifest["warnings"][0]
    write(tmp_path / "drive.npz", mounted)
    assert Experiment(load(path), path).world.warnings == ()


@pytest.mark.parametrize(
    "how",
    [
        "rows that repeat",
        pytest.param("stamps that skip", marks=pytest.mark.slow(reason="another case of a quick test")),
    ],
)
def test_a_design_that_compensates_lost_samples_flies_them_filled_in(
    tmp_path: Path, recording: Recording, how: str
) -> None:
    imu = _mounted(recording).imu
    # the mount shakes at 12 Hz with 8 deg/s, of which every lost sample takes a piece
    shaking = np.deg2rad(8.0) * imu.dt * np.sin(2.0 * np.pi * 12.0 * imu.t)[:, None]
    gone = np.zeros(len(imu), dtype=bool)
    gone[np.random.default_rng(3).choice(np.arange(20, len(imu) - 20, 9), 300, replace=False)] = True
    if how == "rows that repeat":
        last = np.maximum.accumulate(np.where(gone, 0, np.arange(len(imu))))
        lossy = replace(imu, gyro=(imu.gyro + shaking)[last], accel=imu.accel[last])
    else:
        lossy = replace(imu, gyro=imu.gyro + shaking).rows(~gone)
    write(tmp_path / "drive.npz", replace(_mounted(recording), imu=lossy))
    plain = {
        "gyro": "WN(N=0.1 deg/s/sqrt(Hz)) + RC(sigma=0.05 deg/s)",
        "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=2 mg)",
    }
    filled = plain | {"options": {"compensate": [{"effect": "dropped_samples", "probability": 0.03}]}}
    starts = [{"start": f"{s} s", "duration": "20 s"} for s in (80, 110, 140, 170)]
    gnss = {"position_sigma": "5 cm", "velocity_sigma": "5 cm/s", "outages": starts}
    path = _scenario(tmp_path, gnss=gnss, designs={"recorded": plain, "filled": filled})
    designs = summary(run_experiment(Experiment(load(path), path)))["designs"]
    recorded, better = (
        np.sqrt(np.mean([o["planimetric_end_m"]["mean"] ** 2 for o in designs[d]["outages"]]))
        for d in ("recorded", "filled")
    )
    assert better < 0.7 * recorded
    assert load_nominal(path).filled == ("dropped_samples",)  # of the first design
    assert not load_nominal(_scenario(tmp_path, gnss=gnss, designs={"recorded": plain})).filled


def test_a_wrong_mounting_shows(tmp_path: Path, recording: Recording) -> None:
    write(tmp_path / "drive.npz", _mounted(recording))
    right = _scenario(tmp_path)
    good = run_experiment(Experiment(load(right), right))
    wrong = _scenario(tmp_path, recording={"file": "drive.npz", "mounting": ["170 deg", "-6 deg", "35 deg"]})
    bad = run_experiment(Experiment(load(wrong), wrong))
    assert bad.nees.mean() > 5 * good.nees.mean()


def test_a_path_alone_is_a_recording(tmp_path: Path, recording: Recording) -> None:
    write(tmp_path / "drive.npz", recording)
    assert load(_scenario(tmp_path, recording="drive.npz")).recording.file == "drive.npz"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gnss": {"outages": [{"start": "190 s", "duration": "20 s"}]}}, "is not inside the fixes"),
        ({"recording": {"file": "absent.npz"}}, "no such file"),
        ({"recording": {"file": "drive.npz", "mountings": []}}, "did you mean 'mounting'"),
        ({"recording": {"file": "drive.npz", "start": "900 s"}}, "holds no IMU data"),
        ({"truth": WORLD["truth"]}, "expected one or the other"),
        ({"designs": {"d": {"gyro": {"truth": True}, "accel": {"truth": True}}}}, "asks for the model of the truth"),
    ],
)
def test_bad_recordings_are_named(tmp_path: Path, recording: Recording, changes: dict[str, Any], message: str) -> None:
    write(tmp_path / "drive.npz", recording)
    path = _scenario(tmp_path, **changes)
    with pytest.raises(InputError, match=message):
        Experiment(load(path), path)


def test_what_a_recording_does_not_state_is_assumed_and_said(tmp_path: Path, recording: Recording) -> None:
    assert recording.gnss is not None
    silent = replace(recording, gnss=replace(recording.gnss, pos_std_ned=None, vel_std_ned=None))
    write(tmp_path / "drive.npz", _mounted(silent))
    path = _scenario(tmp_path, gnss={"outages": [{"start": "120 s", "duration": "20 s"}]})
    world = RecordedWorld(load(path), path)
    said = [w for w in world.warnings if "assumed from their scatter" in w]
    assert len(said) == 2
    assert world.gnss.pos_std_ned is not None and 0.05 < float(np.median(world.gnss.pos_std_ned)) < 1.0
    path = _scenario(tmp_path)
    assert not any("assumed" in w for w in RecordedWorld(load(path), path).warnings)


def test_gaps_in_the_imu_are_bridged_within_a_second_and_the_longest_stretch_is_flown_beyond(
    tmp_path: Path, recording: Recording
) -> None:
    imu = _mounted(recording).imu
    for seconds, message in ((0.4, "1 gap(s) in the IMU data, up to 0.4"), (17.0, "the longest stretch without one")):
        keep = (imu.t <= 60.0) | (imu.t >= 60.0 + seconds - 0.01)
        write(tmp_path / "drive.npz", replace(_mounted(recording), imu=imu.rows(keep)))
        path = _scenario(tmp_path)
        world = RecordedWorld(load(path), path)
        assert any(message in w for w in world.warnings)
        assert (world.vehicle_imu.t[0] > 60.0) == (seconds > 1.0)


@pytest.mark.parametrize("name", ["drive.npz", "folder"])
def test_a_recording_starts_at_the_state_that_it_carries(tmp_path: Path, recording: Recording, name: str) -> None:
    assert recording.reference is not None
    ref, k = recording.reference, 40
    C_vb = rotation.dcm_from_rpy(np.deg2rad([float(m.split()[0]) for m in MOUNTING]))
    attitude = rotation.rpy_from_dcm(rotation.dcm_from_rpy(ref.rpy[k]) @ C_vb)
    known = InitialState(float(ref.t[k]), ref.llh[k], ref.vel_ned[k], attitude, np.repeat([0.1, 0.05, 0.01], 3))
    write(tmp_path / name, replace(_mounted(recording), initial=known))
    path = _scenario(tmp_path, recording={"file": name, "mounting": MOUNTING})
    start = RecordedWorld(load(path), path).alignment
    assert abs(start.t - ref.t[k]) < 0.03
    np.testing.assert_allclose(start.state.rpy, ref.rpy[k], atol=1e-6)
    np.testing.assert_allclose(np.asarray(start.sigma.attitude), 0.01)


def test_a_stretch_of_increments_is_the_stretch_of_its_means() -> None:
    t = np.arange(400) * 0.01
    rates = np.random.default_rng(1).standard_normal((400, 6))
    means = ImuRecord(t, rates[:, :3], rates[:, 3:], "mean")
    both = [_stretches(Recording(imu, None, None), [(1.0, 3.0)], "a file")[0] for imu in (means, means.as_increments())]
    for axis, one in both[0].items():
        np.testing.assert_allclose(both[1][axis].values, one.values, rtol=1e-9)


def test_an_outage_may_begin_at_a_date(tmp_path: Path, recording: Recording) -> None:
    """The same seconds from the start, whatever the clock that tells the date; the message where none does."""
    zero, day = 1_764_400_000, "2025-11-29T"
    clocks = {"unix": zero, "gps": zero - 315_964_800 + 18}
    spans = {"start": f"{day}07:06:50Z", "end": f"{day}08:10:00.5+01:00"}
    outages = {"outages": [{"start": f"{day}07:08:40Z", "duration": "20 s"}, {"start": "150 s", "duration": "5 s"}]}
    for clock, seconds in clocks.items():
        write(tmp_path / "drive.npz", replace(recording, origin=Origin(seconds * SECOND, clock)))
        found = load(_scenario(tmp_path, gnss=outages, recording={"file": "drive.npz", **spans}))
        assert [o.start_s for o in found.gnss.outages] == [120.0, 150.0]
        assert found.recording is not None
        assert (found.recording.start, found.recording.end) == (10.0, 200.5)
    write(tmp_path / "drive.npz", recording)
    with pytest.raises(
        InputError, match=r"recorded.yaml:\d+: gnss.outages.0.start: is a date, .*its clock tells no date"
    ):
        load(_scenario(tmp_path, gnss=outages))
    (tmp_path / "world.yaml").write_text(yaml.safe_dump(WORLD | {"gnss": outages}))
    with pytest.raises(InputError, match="an emulated flight has none"):
        load(tmp_path / "world.yaml")
    with pytest.raises(InputError, match="expected a date such as"):
        write(tmp_path / "drive.npz", replace(recording, origin=Origin(zero * SECOND, "unix")))
        load(_scenario(tmp_path, gnss={"outages": [{"start": "2025-13-40", "duration": "1 s"}]}))


def test_all_assume_the_same_of_what_the_fixes_do_not_state(tmp_path: Path, recording: Recording) -> None:
    """A fix before the IMU data begin counts as well, whoever asks."""
    assert recording.gnss is not None
    bare = replace(recording, gnss=replace(recording.gnss, pos_std_ned=None, vel_std_ned=None), reference=None)
    bare = replace(bare, imu=bare.imu.rows(bare.imu.t > 20.0))
    write(tmp_path / "drive.npz", bare)
    bare = read_recording(tmp_path / "drive.npz")
    path = _scenario(tmp_path, gnss={}, recording={"file": "drive.npz"})
    noise = {a: WN(N=1e-4) + RC(sigma=0.01) if a.startswith("gyro") else WN(N=1e-3) + RC(sigma=0.1) for a in AXES}
    drive = prepared(bare).started()
    said = [text for text in drive.said if "state no standard deviations" in text]
    assert len(said) == 2
    warned = RecordedWorld(load(path), path).warnings
    assert all(any(text in warning for warning in warned) for text in said)
    nominal = Nominal(noise)
    assert list(check(bare, nominal, recordings=20).assumed) == said
    found = transfer(bare, nominal, rng=np.random.default_rng(1), why=False)
    assert list(found.assumed) == said
    data, start, done = drive.alone()
    assert list(done[:2]) == said
    reckoned = dead_reckon(data, start=start)
    assert reckoned.against == "fixes" and np.isnan(reckoned.max_attitude_error_rad)
    assert reckoned.errors[0, 0] < 1.0 and "max_attitude_error_rad" not in reckoned.to_dict()
