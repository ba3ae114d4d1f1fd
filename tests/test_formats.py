"""Writing and reading back is the identity, and every bad input is refused with its place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.formats import check_target, opened, read, read_log, read_recording, read_static, static, write
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Series, Trajectory
from tests.shared_data import shared


def _series(n: int = 50) -> list[Series]:
    rng = np.random.default_rng(1)
    units = ["rad/s"] * 3 + ["m/s^2"] * 3
    return [Series(rng.standard_normal(n), 100.0, u, a) for a, u in zip(AXES, units, strict=True)]


def _recording(*, reference: bool = True, kind: Any = "mean") -> Recording:
    rng = np.random.default_rng(2)
    t = 5.0 + np.arange(40) * 0.01
    imu = ImuRecord(
        t, rng.standard_normal((40, 3)), rng.standard_normal((40, 3)) - [0, 0, 9.8], kind, 20 + rng.standard_normal(40)
    )
    g = 5.0 + np.arange(4) * 0.1
    llh = np.array([0.8, 0.1, 400.0]) + 1e-6 * rng.standard_normal((4, 3))
    vel = rng.standard_normal((4, 3))
    vel[2] = np.nan
    gnss = GnssRecord(g, llh, vel, np.full((4, 3), 0.02), np.full((4, 3), 0.05))
    ref = Trajectory(g, llh, rng.standard_normal((4, 3)), 0.1 * rng.standard_normal((4, 3))) if reference else None
    return Recording(imu, gnss, ref)


@pytest.mark.parametrize("name", ["log.npz", "log.csv", "log.csv.gz"])
def test_writing_a_static_log_and_reading_it_is_the_identity(tmp_path: Path, name: str) -> None:
    series = _series()
    back = read(write(tmp_path / name, series))
    assert isinstance(back, list)
    assert [s.name for s in back] == list(AXES)
    for a, b in zip(series, back, strict=True):
        assert (a.unit, a.rate_hz) == (b.unit, b.rate_hz)
        np.testing.assert_array_equal(a.values, b.values)


@pytest.mark.parametrize("name", ["flight.npz", "flight"])
@pytest.mark.parametrize("reference", [True, False])
def test_writing_a_recording_and_reading_it_is_the_identity(tmp_path: Path, name: str, reference: bool) -> None:
    data = _recording(reference=reference)
    back = read_recording(write(tmp_path / name, data))
    assert back.imu.kind == "mean"
    assert back.gnss is not None and data.gnss is not None
    for attribute in ("t", "gyro", "accel", "temperature"):
        np.testing.assert_array_equal(getattr(back.imu, attribute), getattr(data.imu, attribute))
    for attribute in ("t", "vel_ned", "pos_std_ned", "vel_std_ned"):
        np.testing.assert_array_equal(getattr(back.gnss, attribute), getattr(data.gnss, attribute))
    np.testing.assert_allclose(back.gnss.llh, data.gnss.llh, rtol=4e-16)  # through degrees: the last digit
    if reference:
        assert back.reference is not None and data.reference is not None
        np.testing.assert_allclose(back.reference.rpy, data.reference.rpy, rtol=4e-16)
    else:
        assert back.reference is None


def test_counts_times_scale_and_datasheet_units_become_si(tmp_path: Path) -> None:
    counts = np.arange(12, dtype=np.int16).reshape(6, 2)
    np.savez(
        tmp_path / "a.npz", counts=counts, scale=[0.05, 0.001], fs=100.0, columns=["gx", "az"], units=["deg/s", "g"]
    )
    gx, az = read_static(tmp_path / "a.npz")
    np.testing.assert_allclose(gx.values, np.deg2rad(counts[:, 0] * 0.05), rtol=1e-15)
    np.testing.assert_allclose(az.values, counts[:, 1] * 0.001 * 9.80665, rtol=1e-15)
    assert (gx.name, gx.unit, az.name, az.unit, az.rate_hz) == ("gyro_x", "rad/s", "accel_z", "m/s^2", 100.0)


@pytest.mark.parametrize("header", ["x\n", "any thing\n", "", '"x"\n', "# made by us\nx\n"])
def test_one_column_is_read_under_any_header(tmp_path: Path, header: str) -> None:
    path = tmp_path / "one.csv"
    path.write_text(header + "1.5\n-2\n3e-3\n")
    (signal,) = read_static(path, rate_hz=10.0)
    np.testing.assert_array_equal(signal.values, [1.5, -2.0, 3e-3])
    assert signal.rate_hz == 10.0


def test_csv_takes_rate_from_the_time_column_and_units_from_the_header(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time [ms];gx (deg/s);temperature [degC]\n0;1;20\n5;2;20\n10;3;20\n")
    gx, temperature = read_static(path)
    assert gx.rate_hz == 200.0
    np.testing.assert_allclose(gx.values, np.deg2rad([1, 2, 3]), rtol=1e-15)
    assert temperature.name == "temperature"


def test_a_column_is_found_by_its_file_name_and_by_its_axis(tmp_path: Path) -> None:
    path = write(tmp_path / "log.npz", _series())
    assert [s.name for s in read_static(path, columns=["az", "gyro_y"])] == ["accel_z", "gyro_y"]


@pytest.mark.parametrize("at", [0, 6])
@pytest.mark.parametrize("suffix", [".npy", ".npz", ".csv"])
def test_a_time_column_without_a_name_is_no_axis(tmp_path: Path, suffix: str, at: int) -> None:
    axes = np.random.default_rng(4).standard_normal((200, 6))
    block = np.insert(axes, at, 300.0 + np.arange(200) * 0.01, axis=1)
    path = tmp_path / f"log{suffix}"
    if suffix == ".npy":
        np.save(path, block)
    elif suffix == ".npz":
        np.savez(path, data=block)
    else:
        np.savetxt(path, block, delimiter=",")
    series = read_static(path)
    assert [s.name for s in series] == list(AXES)
    assert series[0].rate_hz == 100.0
    np.testing.assert_allclose(np.column_stack([s.values for s in series]), axes)


def test_a_npy_column_stays_in_its_memory_map(tmp_path: Path) -> None:
    np.save(tmp_path / "long.npy", np.arange(5000, dtype=np.float32))
    log = read_log(tmp_path / "long.npy", rate_hz=400.0)
    assert isinstance(log.columns[0], np.memmap)
    assert sum(c.size for c in log.chunks(0, 999)) == 5000


def _npz(path: Path, **change: Any) -> Path:
    arrays: dict[str, Any] = {
        "data": np.ones((9, 2)),
        "fs": 100.0,
        "columns": ["gx", "ax"],
        "units": ["rad/s", "m/s^2"],
    }
    arrays = {k: v for k, v in (arrays | change).items() if v is not None}
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"data": np.where(np.eye(9, 2) > 0, np.nan, 1.0)},
            "gyro_x has 1 value(s) that are not finite, the first at row 0",
        ),
        ({"data": np.ones((9, 3))}, "has 2 entries for 3 columns"),
        ({"data": np.ones((3, 3, 3))}, "expected (n, k)"),
        ({"data": np.ones((2, 2))}, "expected at least 3"),
        ({"data": np.array([["a", "b"]] * 4)}, "expected real numbers"),
        ({"data": np.array([[None, 1]] * 4, dtype=object)}, "pickled"),
        ({"units": ["rad/s", "furlong"]}, "unknown unit 'furlong'"),
        ({"units": ["m/s^2", "rad/s"]}, "are columns swapped?"),
        ({"columns": ["gx", "gx"]}, "more than once"),
        ({"fs": None}, "says no sampling rate"),
        ({"fs": -5.0}, "expected a positive number"),
        ({"data": None}, "is no static log"),
        ({"data": None, "counts": np.ones((9, 2), dtype=int)}, "without 'scale'"),
        ({"fs": None, "t": np.r_[0, 1, 1, 3:9]}, "the time repeats at data row 2"),
        ({"fs": None, "t": np.r_[0, 1, 3, 2, 4:9]}, "the time goes back at data row 3"),
        ({"t": np.arange(9.0)}, "said to be 100 Hz, but the time column steps by 1 s"),
        ({"fs": None, "t": np.r_[0:5, 25:29] * 1.0}, "has 1 gap(s), the first of 21 s before data row 5"),
        ({"t": np.arange(5.0)}, "expected (9,)"),
    ],
)
def test_a_bad_static_archive_is_refused_with_its_place(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    path = _npz(tmp_path / "bad.npz", **change)
    with pytest.raises(InputError) as caught:
        read(path)
    assert said in str(caught.value)
    assert "bad.npz" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gx [deg/s]\n1\n2\nthree\n4\n", "line 4: found 'three' in column 1"),
        ("t,gx\n0,1\n1,2\n2\n", "line 4: has 1 cell(s), expected 2"),
        ("t,gx\n0,1\n1,\n2,3\n", "gyro_x has 1 value(s) that are not finite, the first at row 1"),
        ("t,gx [deg/fortnight]\n0,1\n1,2\n2,3\n", "unknown unit 'fortnight'"),
        ("t [deg],gx\n0,1\n1,2\n2,3\n", "the times have the unit 'deg'"),
        ("t,gx\n", "no rows of numbers"),
        ("", "is empty"),
        ("gx,gy\n1,2\n3,4\n5,6\n", "says no sampling rate"),
    ],
)
def test_a_bad_csv_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read(path)
    assert said in str(caught.value)


def test_a_rate_that_contradicts_the_time_column_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", _series())
    assert len(read_static(path, rate_hz=100.0)) == 6
    with pytest.raises(InputError, match=r"200 Hz, but the time column steps by 0\.01 s"):
        read(path, rate_hz=200.0)


def _dynamic(path: Path, **change: Any) -> Path:
    t = np.arange(6) * 0.01
    still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -9.8], (6, 1))
    arrays: dict[str, Any] = {"imu_t": t, "imu": still, "gnss_t": [0.0, 0.05], "gnss_llh": [[45.0, 7.0, 300.0]] * 2}
    arrays = {k: v for k, v in (arrays | change).items() if v is not None}
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"imu": np.ones((6, 5))}, "expected (6, 6)"),
        ({"imu": np.full((6, 6), np.nan)}, "gx is nan at row 0"),
        ({"imu": np.tile([0, 0, -9.8, 0, 0, 0.0], (6, 1))}, "columns are swapped"),
        ({"imu": np.tile([0, 0, 0, 0, 0, -1.0], (6, 1))}, "in g?"),
        ({"imu_units": ["m/s^2"] * 3 + ["rad/s"] * 3}, "are columns swapped?"),
        ({"imu_units": ["rad/s"] * 5}, "expected 6"),
        ({"imu_units": ["rad"] * 3 + ["m/s"] * 3}, "imu_kind is 'sample'"),
        ({"imu_columns": ["gx", "gy", "gz", "ax", "ay", "mag"]}, "in any order"),
        ({"imu_kind": "rate"}, "expected one of: increment, mean, sample"),
        ({"imu_t": None}, "has no 'imu_t'"),
        ({"imu_t": np.r_[0, 1, 2, 2, 3, 4] * 0.01}, "repeats at row 3"),
        ({"gnss_t": [0.05, 0.0]}, "gnss time goes back"),
        ({"gnss_llh": [[145.0, 7.0, 300.0]] * 2}, "(145 deg)"),
        ({"gnss_t": None}, "has no 'gnss_t'"),
        ({"gnss_vel_ned": np.ones((3, 3))}, "gnss_vel_ned: has shape (3, 3), expected (2, 3)"),
        ({"imu": np.array([[{}] * 6] * 6)}, "pickled"),
    ],
)
def test_a_bad_recording_is_refused_with_its_key(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    path = _dynamic(tmp_path / "bad.npz", **change)
    with pytest.raises(InputError) as caught:
        read(path)
    assert said.lower() in str(caught.value).lower()
    assert "bad.npz" in str(caught.value)


def test_columns_in_another_order_and_datasheet_units_are_put_right(tmp_path: Path) -> None:
    imu = np.tile([0.0, 0.0, -1.0, 10.0, 20.0, 30.0], (6, 1))
    path = _dynamic(
        tmp_path / "a.npz",
        imu=imu,
        imu_columns=["ax", "ay", "az", "gx", "gy", "gz"],
        imu_units=["g"] * 3 + ["deg/s"] * 3,
    )
    data = read_recording(path)
    np.testing.assert_allclose(data.imu.accel[0], [0, 0, -9.80665])
    np.testing.assert_allclose(np.rad2deg(data.imu.gyro[0]), [10, 20, 30])


def test_north_east_up_is_turned_down_but_standard_deviations_are_not(tmp_path: Path) -> None:
    path = _dynamic(tmp_path / "a.npz", gnss_vel_neu=[[1, 2, 3.0]] * 2, gnss_pos_std_neu=[[1, 2, 3.0]] * 2)
    gnss = read_recording(path).gnss
    assert gnss is not None and gnss.vel_ned is not None and gnss.pos_std_ned is not None
    assert gnss.vel_ned[0].tolist() == [1, 2, -3]
    assert gnss.pos_std_ned[0].tolist() == [1, 2, 3]


def test_a_folder_of_arrays_is_read(tmp_path: Path) -> None:
    data = _recording(reference=False, kind="increment")
    np.save(tmp_path / "imu_t.npy", data.imu.t)
    np.save(tmp_path / "imu.npy", np.hstack([data.imu.gyro, data.imu.accel]))
    np.save(tmp_path / "imu_kind.npy", np.array("increment"))
    (tmp_path / "gnss.csv").write_text("gnss_t,latitude [deg],longitude [deg],height [m]\n5.0,45,7,300\n5.1,45,7,301\n")
    back = read_recording(tmp_path)
    assert back.imu.kind == "increment"
    np.testing.assert_array_equal(back.imu.accel, data.imu.accel)
    assert back.gnss is not None
    np.testing.assert_allclose(np.rad2deg(back.gnss.llh[1]), [45, 7, 301 * 180 / np.pi])


def test_the_two_doors_refuse_each_others_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a recording"):
        read_recording(write(tmp_path / "log.npz", _series()))
    with pytest.raises(InputError, match="expected a static log"):
        read_static(write(tmp_path / "flight.npz", _recording()))
    with pytest.raises(InputError, match=r"cannot write '\.xlsx' files, expected \.npz or \.csv$"):
        check_target(tmp_path / "log.xlsx", recording=False)
    with pytest.raises(InputError, match=r"expected \.npz or a folder$"):
        check_target(tmp_path / "drive.xlsx", log=False)
    with pytest.raises(InputError, match="cannot write"):
        write(tmp_path / "log.xlsx", _series())
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "absent.npz")
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(InputError, match="cannot be read as a NumPy archive"):
        read(tmp_path / "broken.npz")
    (tmp_path / "a.xyz").write_text("1")
    with pytest.raises(InputError, match="unknown kind of file"):
        read(tmp_path / "a.xyz")


def test_real_layouts_are_read() -> None:
    drive = read_recording(shared("real/rtkexp_drive.npz"))
    assert drive.gnss is not None and len(drive.imu) == 54858
    assert 9.6 < np.median(np.linalg.norm(drive.imu.accel, axis=1)) < 10.0
    static = read_static(shared("real/adis16405_static_run1.npz"))
    assert [s.name for s in static] == list(AXES)
    assert -10.0 < static[5].values.mean() < -9.7
    mixed = read_recording(shared("real/ublox_mixed_nominal.npz"))
    assert mixed.reference is not None
    np.testing.assert_allclose(np.rad2deg(drive.gnss.llh[0, :2]), [40.0966268, -105.1474483])
    np.testing.assert_allclose(
        drive.gnss.vel_ned[0] if drive.gnss.vel_ned is not None else 0, [0.01, -0.002, -0.009], rtol=1e-6
    )


def test_degrees_minutes_and_seconds_keep_their_sign_where_the_degrees_are_zero(tmp_path: Path) -> None:
    """RTKLIB writes -0 for what lies less than one degree south or west."""
    file = tmp_path / "rover.pos"
    rows = [(51, 28, 40.12 + k * 1e-3, "-0", 0, 5.31 - k * 1e-3, 70.0 + k) for k in range(20)]
    text = "".join(
        f"2024/05/01 10:00:{k:02d}.000  {a} {b:02d} {c:08.5f}  {d} {e:02d} {f:08.5f}  {h:.3f} 1 9 0.01 0.02 0.03 0 0 0 0 0\n"
        for k, (a, b, c, d, e, f, h) in enumerate(rows)
    )
    header = """%  GPST  latitude(d'") longitude(d'")  height(m)  Q  ns  sdn(m)  sde(m)  sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"""
    file.write_text(header + text)
    llh = opened(file).gnss.llh
    np.testing.assert_allclose(
        np.rad2deg(llh[:, 0]), [a + b / 60 + c / 3600 for a, b, c, *_ in rows], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(
        np.rad2deg(llh[:, 1]), [-(e / 60 + f / 3600) for *_, e, f, _ in rows], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(llh[:, 2], [h for *_, h in rows])


@pytest.mark.parametrize("height", [True, False])
@pytest.mark.parametrize("shape", ["LineString", "MultiLineString", "Point"])
@pytest.mark.parametrize("scale", [1, 1000])
def test_geojson_tracks(tmp_path: Path, shape: str, height: bool, scale: int) -> None:
    """Each kind of geometry, with and without heights, with stamps in s from zero or in ms of Unix time."""
    first = 1_714_557_600_000 if scale == 1000 else 0
    places = [[7.0 + 1e-4 * k, 46.0 + 2e-4 * k, *([400.0 + k] if height else [])] for k in range(12)]
    times = [first + scale * k for k in range(12)]
    if shape == "Point":
        features = [
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": p}, "properties": {"time": t}}
            for p, t in zip(places, times, strict=True)
        ]
    else:
        many = shape == "MultiLineString"
        geometry = {"type": shape, "coordinates": [places[:5], places[5:]] if many else places}
        given = {"coordTimes": [times[:5], times[5:]] if many else times}
        features = [{"type": "Feature", "geometry": geometry, "properties": given}]
    file = tmp_path / "track.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    gnss = opened(file).gnss
    np.testing.assert_allclose(gnss.t - gnss.t[0], np.arange(12.0), atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(gnss.llh[:, :2]), [[p[1], p[0]] for p in places], rtol=0, atol=1e-11)
    np.testing.assert_allclose(gnss.llh[:, 2], [400.0 + k if height else 0.0 for k in range(12)])


def test_nobody_changes_a_log_that_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("".join(f"{0.01 * k:.2f},{k % 7}\n" for k in range(50)), encoding="utf-8")
    for _ in range(2):
        column = static._csv_once(path)[2][0]
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1.0


def test_columns_without_units_are_increments_where_the_folder_says_so(tmp_path: Path) -> None:
    rows = ["t,gx,gy,gz,ax,ay,az", *(f"{0.01 * k:.2f},0,0,1e-4,0,0,{-0.0981}" for k in range(20))]
    (tmp_path / "imu.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "imu_kind.txt").write_text("increment\n", encoding="utf-8")
    imu = read_recording(tmp_path).imu
    assert imu.kind == "increment"
    np.testing.assert_allclose(imu.accel[:, 2], -0.0981)
