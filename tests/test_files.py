"""Every kind of file: the same short drive comes back from each; foreign tables, clocks and maps; what is wrong is refused with its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.formats import Opened, holds_recording, layout_of, open_files, read, read_log, read_recording, write
from insemu.formats import clocks as clock
from insemu.formats.columns import guess_map, parse_map, split_header
from insemu.records import COLUMNS, InitialState, Preparation, Recording
from insemu.stamps import Origin
from tests.file_samples import KINDS, RATE, SOW, UNIX, drive, mapped_csv


def _opened(written) -> Opened:  # type: ignore[no-untyped-def]
    options = dict(written.options)
    return open_files(
        written.path, gnss=options.get("gnss"), truth=options.get("truth"), maps=(options.get("map", ""), "", "")
    )


def _as_recording(written) -> Recording:  # type: ignore[no-untyped-def]
    """What comes back of a sample, whichever door it takes."""
    options = dict(written.options)
    if options.keys() & {"map", "gnss", "truth"} or layout_of(written.path) == "foreign":
        found = _opened(written)
        return found.recording() if found.imu is not None else found  # type: ignore[return-value]
    if holds_recording(written.path):
        return read_recording(written.path)
    log = read_log(written.path, rate_hz=options.get("rate_hz"))
    block = np.column_stack(log.columns)
    t = log.t if log.t is not None else np.arange(len(log)) / log.rate_hz
    assert log.names == COLUMNS
    imu = replace(drive().imu, t=t, gyro=block[:, :3], accel=block[:, 3:], temperature=None)
    return Recording(imu, origin=Origin(log.start))


@pytest.mark.parametrize("name", KINDS)
def test_the_same_drive_comes_back_from_every_kind_of_file(name: str, tmp_path: Path) -> None:
    written = KINDS[name](tmp_path)
    found, want = _as_recording(written), drive()
    have = {k for k, v in (("imu", found.imu), ("gnss", found.gnss), ("ref", found.reference)) if v is not None}
    assert have == written.holds
    near, began = 1e-6, found.origin.ns / 1e9 - written.start
    if found.imu is not None:
        np.testing.assert_allclose(found.imu.t + began, want.imu.t, atol=near)
        per = 1.0 / RATE if found.imu.kind == "increment" else 1.0
        np.testing.assert_allclose(found.imu.gyro / per, want.imu.gyro, atol=max(written.tolerance, 1e-6))
        np.testing.assert_allclose(found.imu.accel / per, want.imu.accel, atol=max(written.tolerance, 1e-6))
    if found.gnss is not None:
        assert want.gnss is not None and want.gnss.vel_ned is not None
        np.testing.assert_allclose(found.gnss.t + began, want.gnss.t, atol=near)
        assert np.abs(earth.position_difference(found.gnss.llh, want.gnss.llh)).max() < 0.02
        if found.gnss.vel_ned is not None:
            components = np.isfinite(found.gnss.vel_ned).any(axis=0)  # none down of speed and course
            assert components[:2].all()
            wanted = want.gnss.vel_ned[:, components]
            np.testing.assert_allclose(found.gnss.vel_ned[:, components], wanted, atol=2e-3)
    if found.reference is not None and len(found.reference) == len(want.reference or ()):
        assert want.reference is not None
        np.testing.assert_allclose(found.reference.t + began, want.reference.t, atol=near)
        assert np.abs(earth.position_difference(found.reference.llh, want.reference.llh)).max() < 0.02
        turn = np.abs((found.reference.rpy - want.reference.rpy + np.pi) % (2 * np.pi) - np.pi)
        assert turn.max() < 1e-6
        np.testing.assert_allclose(found.reference.vel_ned, want.reference.vel_ned, atol=max(written.tolerance, 1e-6))
    if found.imu is not None:
        back = read(write(tmp_path / "canonical.npz", Recording(found.imu, found.gnss, found.reference)))
        assert isinstance(back, Recording)
        np.testing.assert_array_equal(back.imu.accel, found.imu.accel)
        assert (back.gnss is None) == (found.gnss is None) and (back.reference is None) == (found.reference is None)


def test_there_are_thirty_kinds() -> None:
    assert len(KINDS) >= 30


def test_other_commands_read_foreign_files_by_the_same_door(tmp_path: Path) -> None:
    data = read_recording(KINDS["MATLAB v5"](tmp_path).path)
    assert data.gnss is not None
    imu = KINDS["any CSV, known names"](tmp_path).path
    assert [s.name for s in read(imu, columns=["gz", "accel_x"])] == ["gyro_z", "accel_x"]
    assert not holds_recording(imu)


def test_several_bags_topics_are_listed_and_chosen(tmp_path: Path) -> None:
    path = KINDS["ROS 1 bag"](tmp_path).path
    with pytest.raises(InputError, match=r"has no topic '/imu/dat' .did you mean '/imu/data'"):
        open_files(path, maps=("topic=/imu/dat", "", ""))
    assert open_files(path, maps=("topic=/imu/data, axes=FRD", "", "")).imu.accel[0, 2] > 9.0  # type: ignore[union-attr]


# ---------------------------------------------------------------------------------------------------------------------- maps


def test_a_map_is_written_as_it_is_read() -> None:
    line = 'gyro=wx wy -wz[deg/s], time="my time"[ns], axes=FLU, rate=100 Hz'
    assert str(parse_map(line)) == line
    assert parse_map(str(parse_map(line))) == parse_map(line)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("gyros=a b c", "unknown role 'gyros' .did you mean 'gyro'"),
        ("gyro", "expected ROLE=COLUMNS"),
        ("gyro=", "expected ROLE=COLUMNS"),
        ("gyro=a b c[deg/s", "do not close"),
        ("gyro=a]b", "do not match"),
        ('gyro="a b c', "do not close"),
        ("gyro=a b c[furlong]", "unknown unit 'furlong'"),
        ("gyro=a b c[m]", "none of rad/s"),
        ("time=t[deg]", "none of s"),
        ("x" * 5000, "expected text such as"),
    ],
)
def test_a_bad_map_is_refused(line: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_map(line)


def test_a_map_that_names_no_column_says_which_there_are(tmp_path: Path) -> None:
    path = mapped_csv(tmp_path).path
    with pytest.raises(InputError, match=r"no column 'omega_\*'"):
        open_files(path, maps=("gyro=omega_*[deg/s], accel=s_*[g], time=stamp", "", ""))
    with pytest.raises(InputError, match="gyro takes 3 column"):
        open_files(path, maps=("gyro=om_1[deg/s], accel=s_*[g], time=stamp", "", ""))


def test_an_unknown_layout_prints_the_map_that_it_would_guess(tmp_path: Path) -> None:
    path = mapped_csv(tmp_path).path
    with pytest.raises(InputError) as caught:
        open_files(path)
    line = str(caught.value).split("--map '")[1].split("'")[0]
    assert "gyro=om_1 om_2 om_3[rad/s]" in line
    found = open_files(
        path,
        maps=(
            line.replace("[rad/s]", "[deg/s]").replace("[m/s^2]", "[g]").replace("time=stamp[s]", "time=stamp[ns]"),
            "",
            "",
        ),
    )
    np.testing.assert_allclose(found.imu.gyro, drive().imu.gyro, atol=1e-6)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("names", "roles"),
    [
        ("t gx gy gz ax ay az", {"time", "gyro", "accel"}),
        ("%time field.angular_velocity.x field.angular_velocity.y field.angular_velocity.z", {"time", "gyro"}),
        ("timestamp AngularRateX AngularRateY AngularRateZ AccX AccY AccZ", {"time", "gyro", "accel"}),
        ("time imu_gyro_0 imu_gyro_1 imu_gyro_2 imu_acc_0 imu_acc_1 imu_acc_2", {"time", "gyro", "accel"}),
        ("time mag_x mag_y mag_z gyro_bias_x gyro_bias_y gyro_bias_z", {"time"}),
        ("utc lat lon alt", {"time", "lat", "lon", "height"}),
        ("secs temperature", {"time", "temperature"}),
    ],
)
def test_names_are_guessed(names: str, roles: set[str]) -> None:
    assert set(guess_map(names.split()).picks) == roles


def test_headers_with_nested_brackets_are_split_in_linear_time() -> None:
    assert split_header("N (deg/s/sqrt(Hz))") == ("N", "deg/s/sqrt(Hz)")
    assert split_header("gyro_rad[0]") == ("gyro_rad[0]", "")
    split_header("a" + "(" * 200_000 + ")")
    split_header("(" * 200_000 + ")" * 200_000)


# --------------------------------------------------------------------------------------------------------------------- clocks


@pytest.mark.parametrize(("gps", "unix"), [(1.0e9, 1_315_964_785.0), (1.2e9, 1_515_964_782.0), (0.5e9, 815_964_790.0)])
def test_gps_time_and_utc_are_those_of_the_almanac(gps: float, unix: float) -> None:
    """GPS seconds 1,000,000,000 were 2011-09-14 01:46:25 UTC; each year has its leap seconds."""
    t = gps + np.array([0.0, 0.5, 60.0])
    out, said = clock.converted(t, "gps", "unix", unix)
    np.testing.assert_array_equal(out, t - gps + unix)
    assert f"with {clock.leap_seconds(unix)} leap seconds" in said
    back, _ = clock.converted(out, "unix", "gps", gps)
    np.testing.assert_array_equal(back, t)
    week = np.floor(gps / clock.WEEK)
    of_week, _ = clock.converted(t, "gps", "sow", gps - week * clock.WEEK)
    np.testing.assert_array_equal(of_week, t - week * clock.WEEK)
    again, _ = clock.converted(of_week, "sow", "gps", gps)
    np.testing.assert_array_equal(again, t)
    there, _ = clock.converted(of_week, "sow", "unix", unix)
    np.testing.assert_array_equal(there, out)
    of_unix, _ = clock.converted(out, "unix", "sow", gps - week * clock.WEEK)
    np.testing.assert_array_equal(of_unix, of_week)


@pytest.mark.parametrize(
    ("unix", "leap"), [(315_964_800.0, 0), (1_483_228_799.0, 17), (1_483_228_800.0, 18), (1_700_000_000.0, 18)]
)
def test_leap_seconds(unix: float, leap: int) -> None:
    assert clock.leap_seconds(unix) == leap


@pytest.mark.parametrize(
    ("given", "wanted"), [("unix", "gps"), ("gps", "sow"), ("unix", "sow"), ("sow", "gps"), ("sow", "unix")]
)
def test_clocks_are_turned_into_each_other_and_back(given: str, wanted: str) -> None:
    t = np.arange(5) * 0.5
    start = {"unix": UNIX, "gps": UNIX - clock.GPS_EPOCH + 18, "sow": SOW}
    there, said = clock.converted(t + start[given], given, wanted, start[wanted] + 3.0)
    np.testing.assert_allclose(there, t + start[wanted], atol=1e-6)
    assert ("leap" in said) == ("unix" in (given, wanted))


def test_the_end_of_a_gps_week_is_crossed(tmp_path: Path) -> None:
    imu, g = drive().imu, drive().gnss
    assert g is not None
    start = 604_800.0 - 30.0
    rows = np.column_stack([(imu.t + start) % 604_800.0, imu.gyro / RATE, imu.accel / RATE])
    np.savetxt(tmp_path / "a.txt", rows, fmt="%.12g")
    places = np.column_stack([(g.t + start) % 604_800.0, np.rad2deg(g.llh[:, :2]), g.llh[:, 2], g.pos_std_ned])[80:]
    np.savetxt(tmp_path / "a.pos", places, fmt="%.12g")  # begins after the week's end
    found = open_files(tmp_path / "a.txt", gnss=tmp_path / "a.pos")
    began = found.origin.ns / 1e9 - start
    np.testing.assert_allclose(found.imu.t + began, imu.t, atol=1e-6)  # type: ignore[union-attr]
    np.testing.assert_allclose(found.gnss.t + began, g.t[80:], atol=1e-6)  # type: ignore[union-attr]
    assert any("week" in n for n in found.notes)


@pytest.mark.parametrize(
    ("stamps", "name", "unit"),
    [
        (np.arange(9) * 10_000_000, "t", "ns"), (np.arange(9) * 5000.0, "t", "us"), (np.arange(9) * 10.0, "t", "ms"),
        (np.arange(9) * 0.01, "t", "s"), (1.7e9 + np.arange(9), "t", "s"), (1.7e12 + np.arange(9) * 10, "t", "ms"),
        (1.7e18 + np.arange(9) * 1e7, "t", "ns"), (np.arange(9) * 1.0, "t", "s"), (np.arange(9) * 1.0, "time_us", "us"),
    ],
)  # fmt: skip
def test_the_unit_of_stamps_is_told_by_their_size(stamps: np.ndarray, name: str, unit: str) -> None:
    assert clock.stamp_unit(stamps, name)[0] == unit


def test_a_first_column_of_times_is_no_sensor(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).standard_normal((64, 3))
    for scale, header in ((0.005, ""), (5e6, ""), (5e6, "stamp_of_it,a,b,c")):
        path = tmp_path / "a.csv"
        np.savetxt(path, np.column_stack([np.arange(64) * scale, noise]), delimiter=",", header=header, comments="")
        log = read_log(path)
        assert log.rate_hz == 200.0 and len(log.columns) == 3
        np.testing.assert_allclose(log.columns[0], noise[:, 0])


# ----------------------------------------------------------------------------------------------------------- broken containers


@pytest.mark.parametrize("name", KINDS)
def test_a_truncated_file_is_read_in_part_or_refused(name: str, tmp_path: Path) -> None:
    written = KINDS[name](tmp_path)
    files = sorted(p for p in written.path.rglob("*") if p.is_file()) if written.path.is_dir() else [written.path]
    victim = max(files, key=lambda p: p.stat().st_size)
    content = victim.read_bytes()
    for share in (0.9, 0.3, 0.0):
        victim.write_bytes(content[: int(share * len(content))])
        try:
            found = _as_recording(written)
        except InputError as error:
            assert str(tmp_path) in str(error) or victim.name in str(error), share
            continue
        for record in (found.imu, found.gnss):
            assert record is None or (np.diff(record.t) > 0).all(), share


def test_what_a_recording_holds_beside_its_signals_goes_through_the_map(tmp_path: Path) -> None:
    """Initial state and preparation, on the clock and in the axes that the map makes of the file's."""
    own = drive()
    assert own.gnss is not None
    first = InitialState(3.0, own.gnss.llh[3], np.array([1.0, 2.0, 0.5]), np.array([0.1, -0.2, 2.0]), np.full(9, 0.1))
    done = Preparation(0.2, own.gnss, ("clock taken off",))
    path = write(tmp_path / "own.npz", replace(own, initial=first, preparation=done))
    plain = open_files(path).recording()
    turned = open_files(path, maps=("mount=180 0 90, shift=0.5 s", "", "")).recording()
    for found in (plain, turned):
        assert found.initial is not None and found.preparation is not None and found.preparation.gnss is not None
        assert (found.preparation.imu_late, found.preparation.said) == (0.2, ("clock taken off",))
        np.testing.assert_allclose(found.preparation.gnss.t, own.gnss.t, atol=1e-9)
    assert plain.initial is not None and turned.initial is not None
    np.testing.assert_allclose(plain.initial.rpy, first.rpy, atol=1e-12)
    assert (plain.initial.t, turned.initial.t) == (pytest.approx(3.0), pytest.approx(3.5))
    force = own.imu.accel[0]  # the same vector in the air from either axes
    np.testing.assert_allclose(
        rotation.dcm_from_rpy(turned.initial.rpy) @ turned.imu.accel[0],
        rotation.dcm_from_rpy(first.rpy) @ force,
        atol=1e-6,
    )
