"""Arrays and tables of numbers: how names, shapes, delimiters, dates and rates become columns."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from insemu.errors import InputError
from insemu.formats import open_files, read, read_imu, read_log, read_recording, round_rate
from insemu.formats.assemble import Columns, clock_of
from insemu.formats.clocks import GPS_EPOCH, WEEK, converted, leap_seconds, stamp_unit
from insemu.formats.npz import keys_of, load_npy, load_npz, numbers, scalar, texts
from insemu.formats.readers.arrays import tables_of
from insemu.formats.static import Log
from insemu.formats.table import Table, _values, any_table, read_delimited
from insemu.formats.text import is_text, read_table, write_table
from insemu.records import AXES, COLUMNS
from insemu.stamps import counted

DEG = np.pi / 180.0


# --------------------------------------------------------------------------------------------------------------------- arrays


def test_arrays_of_one_length_make_a_table() -> None:
    t, three = np.arange(5) * 0.5, np.arange(15.0).reshape(5, 3)
    found = tables_of(
        {"imu.t": t, "imu.gyro": three, "imu.acc": three.T, "two": np.ones((5, 2)), "wide": np.ones((70, 65)), "one": np.array([[7.0]]),
         "column": t[:, None], "short": np.arange(4.0), "deep": np.ones((2, 2, 2))},
        "f",
    )  # fmt: skip
    assert [list(x.columns) for x in found] == [
        ["imu.t", "imu.gyro_x", "imu.gyro_y", "imu.gyro_z", "imu.acc_x", "imu.acc_y", "imu.acc_z", "two_1", "two_2", "column"],
        ["short"],
    ]  # fmt: skip
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(found[0].columns[f"imu.gyro_{axis}"], three[:, k])
        np.testing.assert_array_equal(found[0].columns[f"imu.acc_{axis}"], three[:, k])
    assert str(found[0].map) == "time=imu.t, gyro=imu.gyro_x imu.gyro_y imu.gyro_z, accel=imu.acc_x imu.acc_y imu.acc_z"
    # as many as 16 rows that are shorter than wide are columns; more are not
    assert list(tables_of({"a": np.ones((16, 17))}, "f")[0].columns)[-1] == "a_16"
    assert list(tables_of({"a": np.ones((17, 18))}, "f")[0].columns)[-1] == "a_18"
    assert list(tables_of({"a": np.ones((3, 3))}, "f")[0].columns) == ["a_x", "a_y", "a_z"]
    assert list(tables_of({"a": np.ones((70, 64))}, "f")[0].columns)[-1] == "a_64"
    assert len(tables_of({"a": np.ones((3, 1, 1))}, "f")[0].columns["a"]) == 3


@pytest.mark.parametrize(
    ("scalars", "rate"),
    [
        ({"fs": 50.0}, "50.0 Hz"), ({"x.SampleRate": 50}, "50.0 Hz"), ({"dt": 0.25}, "4.0 Hz"),
        ({"Ts": 0.5}, "2.0 Hz"), ({"fs": 50, "dt": 1}, "50.0 Hz"),
        ({"fs": 1e5}, "100000.0 Hz"), ({"fs": 1.01e5}, None), ({"fs": 0.01}, "0.01 Hz"), ({"fs": 0.009}, None),
        ({"dt": 0.0}, None), ({"q": 50.0}, None),
    ],
)  # fmt: skip
def test_a_scalar_tells_the_rate(scalars: dict[str, float], rate: str | None) -> None:
    arrays = {"gyro": np.ones((5, 3)), "accel": np.ones((5, 3)), **{k: np.array(v) for k, v in scalars.items()}}
    (found,) = tables_of(arrays, "f")
    assert found.map.settings.get("rate") == rate
    timed = tables_of(arrays | {"t": np.arange(5.0)}, "f")[0]
    assert "rate" not in timed.map.settings


def test_places_are_told_by_the_name_of_an_array() -> None:
    for name in ("gnss_llh", "x.LLA", "pos_lla", "geodetic"):
        (found,) = tables_of({name: np.ones((5, 3)), "t": np.arange(5.0)}, "f")
        assert str(found.map) == f"time=t, lat={name}_x, lon={name}_y, height={name}_z"
    (found,) = tables_of({"other": np.ones((5, 3)), "t": np.arange(5.0)}, "f")
    assert str(found.map) == "time=t"


def test_matlab_structures_become_dotted_names(tmp_path: Path) -> None:
    t = np.arange(6) * 0.01
    inner = {"gyro": np.arange(18.0).reshape(6, 3), "accel": np.ones((6, 3)), "name": "x"}
    savemat(tmp_path / "a.mat", {"t": t, "imu": inner | {"deep": {"temperature": 20 + t}}})
    found = open_files(tmp_path / "a.mat").imu
    assert found is not None and found.temperature is not None
    np.testing.assert_array_equal(found.gyro, inner["gyro"])
    np.testing.assert_allclose(found.t, t)
    np.testing.assert_allclose(found.temperature, 20 + t)
    savemat(tmp_path / "b.mat", {"x": "text"})
    with pytest.raises(InputError, match="holds no arrays of numbers over time; it has nothing"):
        open_files(tmp_path / "b.mat")


def test_hdf5(tmp_path: Path) -> None:
    import h5py

    block = np.arange(18.0).reshape(6, 3)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["imu/t"] = np.arange(6) * 0.5
        file["imu/gyro"], file["imu/accel"] = block, 2 * block
        file["note"], file["cube"] = "x", np.ones((6, 2, 2))
    found = open_files(tmp_path / "a.h5").imu
    assert found is not None
    np.testing.assert_array_equal(np.hstack([found.gyro, found.accel]), np.hstack([block, 2 * block]))
    np.testing.assert_array_equal(found.t, np.arange(6) * 0.5)


def test_parquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    import pandas as pd

    block = np.arange(18.0).reshape(6, 3)
    frame = pd.DataFrame(
        {"t": np.arange(6) * 0.5, **dict(zip(COLUMNS, np.hstack([block, 2 * block]).T, strict=True)), "s": ["x"] * 6}
    )
    frame.to_parquet(tmp_path / "a.parquet")
    found = open_files(tmp_path / "a.parquet").imu
    assert found is not None
    np.testing.assert_array_equal(np.hstack([found.gyro, found.accel]), np.hstack([block, 2 * block]))


# ------------------------------------------------------------------------------------------------------------------ own layouts


def test_counts_of_two_triads(tmp_path: Path) -> None:
    gyro, acc = np.arange(15).reshape(5, 3), 100 + np.arange(15).reshape(5, 3)
    np.savez(tmp_path / "a.npz", gyro_counts=gyro, acc_counts=acc, fs=50.0)
    log = read_log(tmp_path / "a.npz")
    assert (log.names, log.stated_units, log.units, log.rate_hz, log.t) == (
        COLUMNS,
        ("counts",) * 6,
        ("",) * 6,
        50.0,
        None,
    )
    np.testing.assert_array_equal(np.column_stack(log.columns), np.hstack([gyro, acc]))
    found = open_files(tmp_path / "a.npz").imu
    assert found is not None
    np.testing.assert_array_equal(found.accel, acc)
    np.testing.assert_allclose(found.t, np.arange(5) / 50)
    for change, said in (
        ({"acc_counts": acc[:4]}, "gyro_counts, acc_counts and t have different lengths"),
        ({"t": np.arange(4.0)}, "gyro_counts, acc_counts and t have different lengths"),
        ({"acc_counts": acc[:, :2]}, "acc_counts: has shape (5, 2), expected (n, 3)"),
        ({"gyro_counts": acc[:, 0]}, "gyro_counts: has shape (5,), expected (n, 3)"),
    ):
        np.savez(tmp_path / "b.npz", **({"gyro_counts": gyro, "acc_counts": acc, "fs": 50.0} | change))
        with pytest.raises(InputError) as caught:
            read_log(tmp_path / "b.npz")
        assert str(caught.value).endswith(said)


def test_a_static_archive_of_any_columns(tmp_path: Path) -> None:
    block = np.arange(8.0).reshape(4, 2)
    np.savez(tmp_path / "a.npz", data=block, t=np.arange(4) * 0.02, columns=["gx", "mag"], units=["deg/s", "km"])
    log = read_log(tmp_path / "a.npz")
    assert (log.names, log.units, log.stated_units, log.rate_hz) == (
        ("gx", "mag"),
        ("rad/s", "m"),
        ("deg/s", "km"),
        50.0,
    )
    np.testing.assert_allclose(log.columns[1], 1000 * block[:, 1])
    np.savez(tmp_path / "b.npz", data=np.arange(4.0), fs=10)
    assert read_log(tmp_path / "b.npz").names == ("b",)
    np.savez(tmp_path / "c.npz", data=np.sin(np.arange(8.0)).reshape(4, 2), fs=10)
    assert read_log(tmp_path / "c.npz").names == ("column_1", "column_2")
    np.savez(tmp_path / "d.npz", counts=np.ones((4, 2)), scale=2.0, fs=10)
    np.testing.assert_array_equal(read_log(tmp_path / "d.npz").columns[1], 2.0)
    np.savez(tmp_path / "d.npz", counts=np.ones((4, 2)), scale=[2.0, 3.0, 4.0], fs=10)
    with pytest.raises(InputError, match=r"scale: has shape \(3,\), expected \(2,\)"):
        read_log(tmp_path / "d.npz")
    np.savez(tmp_path / "e.npz", data=np.ones((2, 2)), fs=10)
    with pytest.raises(InputError, match=r"has 2 row\(s\) of data, expected at least 3"):
        read_log(tmp_path / "e.npz")
    np.savez(tmp_path / "e.npz", data=np.ones((3, 2)), fs=[10, 11])
    with pytest.raises(InputError, match=r"fs: has shape \(2,\), expected one number"):
        read_log(tmp_path / "e.npz")


def test_gaps_of_a_log_are_put_where_they_are() -> None:
    t = np.array([0, 1, 2, 5, 6, 7.4, 8.89, 9.9]) * 0.1
    log = Log("x", ("gx",), ("rad/s",), ("",), (np.arange(8.0),), 10.0, t)
    assert [(k, round(d, 9)) for k, d in log.gaps()] == [(3, 0.3)]
    even = log.evenly(0)
    np.testing.assert_array_equal(even, [0, 1, 2, np.nan, np.nan, 3, 4, 5, 6, 7])
    (series,) = log.series(gaps=True)
    assert (series.missing, series.name, series.rate_hz, series.unit) == (2, "gyro_x", 10.0, "rad/s")
    with pytest.raises(
        InputError, match=r"x: has 1 gap\(s\), the first of 0\.3 s before data row 3 where samples are 0\.1 s apart"
    ):
        log.series()
    long = Log("x", ("gx",), ("",), ("",), (np.arange(3.0),), 10.0, np.array([0.0, 0.1, 1.4]))
    assert len(long.evenly(0)) == 15  # 12 are missing beside 3, four times as many
    longer = Log("x", ("gx",), ("",), ("",), (np.arange(3.0),), 10.0, np.array([0.0, 0.1, 1.5]))
    with pytest.raises(
        InputError,
        match=r"13 samples are missing in addition to the 3 that are there, the longest gap 1\.4 s before data row 2",
    ):
        longer.evenly(0)
    assert [c.tolist() for c in log.chunks(0, 3, first=1)] == [[1, 2, 3], [4, 5, 6], [7]]
    whole = Log("x", ("a", "gy"), ("", ""), ("", ""), (np.arange(3.0), np.ones(3)), 10.0)
    assert whole.gaps() == [] and whole.select(["gyro_y"]).names == ("gy",) and len(whole) == 3
    with pytest.raises(
        InputError, match=r"has no column 'gyro_x' \(expected one of: a, gy\)|has no column 'gyro_x' \(did you mean"
    ):
        whole.select(["gyro_x"])


def test_rates_are_rounded_where_stamps_are() -> None:
    assert [round_rate(r) for r in (100.009, 99.991, 100.011, 0.4, 1.00009)] == [100.0, 100.0, 100.011, 0.4, 1.0]


def test_an_imu_of_a_static_log_has_means(tmp_path: Path) -> None:
    block = np.arange(24.0).reshape(4, 6)
    np.savez(tmp_path / "a.npz", data=block, fs=50.0, columns=[*COLUMNS[3:], *COLUMNS[:3]])
    found = read_imu(tmp_path / "a.npz")
    np.testing.assert_array_equal(np.hstack([found.accel, found.gyro]), block)
    assert found.kind == "mean" and found.t.tolist() == [0, 0.02, 0.04, 0.06]
    np.savez(tmp_path / "b.npz", data=block[:, :5], fs=50.0, columns=list(COLUMNS[:5]))
    with pytest.raises(InputError, match="has no column 'accel_z'"):
        read_imu(tmp_path / "b.npz")


def test_npy_with_and_without_times(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.column_stack([np.arange(6) * 0.02, np.sin(np.arange(6.0))]))
    log = read_log(tmp_path / "a.npy")
    assert (log.names, log.rate_hz) == (("a",), 50.0)
    np.save(tmp_path / "b.npy", np.ones((4, 2, 2)))
    for name in ("b.npy",):
        with pytest.raises(
            InputError, match=r"has type float64 and shape \(4, 2, 2\), expected \(n,\) or \(n, k\) real numbers"
        ):
            read_log(tmp_path / name, rate_hz=1.0)
    np.save(tmp_path / "c.npy", np.array(["a", "b", "c"]))
    with pytest.raises(InputError, match="expected"):
        read_log(tmp_path / "c.npy", rate_hz=1.0)
    for rate in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="Hz, expected a positive number"):
            read_log(tmp_path / "a.npy", rate_hz=rate)


def test_pieces_of_archives(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.arange(3), b=np.array(["x", "y"]))
    assert keys_of(tmp_path / "a.npz") == {"a", "b"}
    arrays = load_npz(tmp_path / "a.npz")
    assert texts(arrays["b"], "w") == ["x", "y"] and texts(np.array(b"x"), "w") == ["x"]
    assert numbers(arrays["a"], "w").dtype == np.float64 and scalar(np.array([[3]]), "w") == 3.0
    np.save(tmp_path / "a.npy", np.arange(3))
    assert not isinstance(load_npy(tmp_path / "a.npy"), np.memmap) and isinstance(
        load_npy(tmp_path / "a.npy", map_file=True), np.memmap
    )
    for call, said in (
        (lambda: texts(arrays["a"], "w"), r"w: has type int64 and shape \(3,\), expected a list of text"),
        (lambda: texts(np.array([["x"]]), "w"), r"expected a list of text"),
        (lambda: numbers(arrays["b"], "w"), "w: has type <U1, expected real numbers"),
        (lambda: numbers(np.array([1j]), "w"), "expected real numbers"),
        (lambda: scalar(arrays["a"], "w"), r"w: has shape \(3,\), expected one number"),
        (lambda: load_npz(tmp_path / "a.npy"), "is one NumPy array, expected an archive of several"),
    ):
        with pytest.raises(InputError, match=said):
            call()


def _recording(folder: Path, **change: Any) -> Path:
    n = 4
    arrays: dict[str, Any] = {
        "imu_t": np.arange(n) * 0.5, "imu": np.tile([0.1, 0.2, 0.3, 0.4, 0.5, -9.8], (n, 1)), "imu_kind": "mean",
        "temperature": 20 + np.arange(n),
        "gnss_t": [0.0, 1.0], "gnss_llh": [[46.5, 7.25, 400], [46.6, 7.35, 401]], "gnss_vel_neu": [[1, 2, 3]] * 2,
        "gnss_pos_std_ned": [[1, 2, 3]] * 2,
        "gnss_vel_std_neu": [[4, 5, 6]] * 2,
        "ref_t": [0.0, 1.0, 2.0], "ref_llh": [[46.5, 7.25, 400]] * 3, "ref_vel_ned": [[1, 2, 3]] * 3,
        "ref_rpy_deg": [[1, 2, 350], [1, 2, 10], [1, 2, 30]],
        "ref_att_t": [0.5, 1.5, 2.5],
        "initial_t": 0.5, "initial_llh": [46.5, 7.25, 400], "initial_vel_ned": [1, 2, 3],
        "initial_rpy_deg": [1, 2, 3], "initial_sigma": np.arange(1, 10),
        "aid_odometer_t": [0.0, 1.0], "aid_odometer": [[1.0], [2.0]], "aid_odometer_std": [[0.1], [0.2]], "aid_odometer_settings": [3.0, 4.0],
        "aid_odometer_since": [-0.5, 0.5],
    }  # fmt: skip
    np.savez(folder / "r.npz", **{k: v for k, v in (arrays | change).items() if v is not None})
    return folder / "r.npz"


def test_all_parts_of_a_recording(tmp_path: Path) -> None:
    found = read_recording(_recording(tmp_path))
    assert found.gnss is not None and found.reference is not None and found.initial is not None
    assert (found.imu.kind, found.imu.temperature is not None, found.source) == ("mean", True, str(tmp_path / "r.npz"))
    np.testing.assert_array_equal(found.imu.temperature, [20, 21, 22, 23])
    np.testing.assert_array_equal(found.gnss.vel_ned, [[1, 2, -3]] * 2)
    np.testing.assert_array_equal(found.gnss.vel_std_ned, [[4, 5, 6]] * 2)
    np.testing.assert_array_equal(found.gnss.pos_std_ned, [[1, 2, 3]] * 2)
    # attitudes have their own times: only what lies between them is kept, over north the short way
    np.testing.assert_array_equal(found.reference.t, [1, 2])
    np.testing.assert_allclose(np.rad2deg(found.reference.rpy), [[1, 2, 360], [1, 2, 380]])
    first = found.initial
    assert first.t == 0.5
    np.testing.assert_allclose(first.llh, [46.5 * DEG, 7.25 * DEG, 400])
    np.testing.assert_allclose(first.rpy, np.array([1, 2, 3]) * DEG)
    np.testing.assert_allclose(first.sigma, [1, 2, 3, 4, 5, 6, 7 * DEG, 8 * DEG, 9 * DEG])
    (aid,) = found.aids
    assert (aid.kind, aid.settings, aid.since is not None) == ("odometer", (3.0, 4.0), True)
    np.testing.assert_array_equal(np.hstack([aid.values, aid.std]), [[1, 0.1], [2, 0.2]])
    np.testing.assert_array_equal(aid.since, [-0.5, 0.5])
    plain = read_recording(
        _recording(tmp_path, imu_kind=None, ref_att_t=None, gnss_t=None, gnss_llh=None, aid_odometer_since=None)
    )
    assert plain.imu.kind == "sample" and plain.gnss is None and plain.aids[0].since is None
    assert plain.reference is not None and np.allclose(np.rad2deg(plain.reference.rpy[:, 2]), [350, 10, 30])
    assert read_recording(_recording(tmp_path, ref_vel_ned=None)).reference is None
    # the same by the door of foreign files, which takes fixes and reference as they are
    other = open_files(_recording(tmp_path, ref_att_t=None, imu_units=["deg/s"] * 3 + ["g"] * 3))
    assert other.imu is not None and other.gnss is not None and other.reference is not None
    np.testing.assert_allclose(other.imu.gyro[0], np.array([0.1, 0.2, 0.3]) * DEG)
    np.testing.assert_allclose(other.imu.accel[0], np.array([0.4, 0.5, -9.8]) * 9.80665)
    np.testing.assert_array_equal(other.gnss.vel_ned, [[1, 2, -3]] * 2)
    np.testing.assert_array_equal(other.gnss.vel_std_ned, [[4, 5, 6]] * 2)
    np.testing.assert_allclose(other.reference.rpy[0], np.array([1, 2, 350]) * DEG)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"imu_t": np.ones((4, 1))}, "imu_t: has shape (4, 1), expected (n,)"),
        ({"temperature": [1.0]}, "temperature: has shape (1,), expected (4,)"),
        ({"initial_llh": [1, 2]}, "initial_llh: has 2 numbers, expected 3"),
        ({"initial_sigma": None}, "has no 'initial_sigma'; holds "),
        ({"initial_sigma": -np.ones(9)}, "r.npz: initial sigma is ["),
        ({"aid_odometer_std": None}, "has no 'aid_odometer_std'; holds "),
        ({"imu_units": ["deg/s"] * 6},
         "imu_units: ax has the unit 'deg/s', expected one of the dimension of m/s^2 (imu_kind is 'mean'; are columns swapped?)"),
        ({"imu": np.tile([0, 0, 9.1, 0, 0, 4.9], (4, 1))}, "columns are swapped"),
        ({"imu": np.tile([0, 0, 0, 0, 0, 1.09], (4, 1))}, "in g? (say so in imu_units)"),
        ({"imu": np.tile([0, 0, 0, 0, 0, -0.91], (4, 1))}, "in g? (say so in imu_units)"),
    ],
)  # fmt: skip
def test_a_wrong_part_of_a_recording_is_named(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_recording(_recording(tmp_path, **change))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "imu",
    [
        [0, 0, 10.61, 0, 0, 4.9],
        [0, 0, 9.8, 0, 0, 5.1],
        [0, 0, 8.9, 0, 0, 1.2],
        [0, 0, 0, 0, 0, 1.11],
        [0, 0, 0, 0, 0, 0.89],
    ],
)
def test_odd_but_possible_magnitudes_are_taken(tmp_path: Path, imu: list[float]) -> None:
    assert read_recording(_recording(tmp_path, imu=np.tile(imu, (4, 1)))).imu.accel[0, 2] == imu[5]


def test_a_folder_of_csv(tmp_path: Path) -> None:
    texts_ = {
        "imu.csv": "time [ms],imu_gx [deg/s],gy,gz,ax [g],ay,az,temp_c\n"
        + "".join(f"{10 * k},1,2,3,4,5,6,{20 + k}\n" for k in range(3)),
        "gnss.csv": "t,lat [rad],lon,alt [km],vn [km/h],ve,vu,vel_std_n,vel_std_e,vel_std_d\n0,0.5,7,0.4,3.6,2,3,1,2,3\n1,0.5,7,0.4,3.6,2,3,1,2,3\n",
        "ref.csv": "t,latitude,longitude,h,vn,ve,vd,roll,pitch,yaw [rad]\n0,46,7,400,1,2,3,10,20,0.5\n1,46,7,400,1,2,3,10,20,0.5\n",
        "imu_kind.txt": "mean\n",
    }
    for name, text in texts_.items():
        (tmp_path / name).write_text(text)
    found = read_recording(tmp_path)
    assert found.gnss is not None and found.reference is not None and found.gnss.vel_ned is not None
    np.testing.assert_allclose(found.imu.t, [0, 0.01, 0.02])
    np.testing.assert_allclose(found.imu.gyro[0], [1 * DEG, 2, 3])
    np.testing.assert_allclose(found.imu.accel[0], [4 * 9.80665, 5, 6])
    assert (
        found.imu.kind == "mean"
        and found.imu.temperature is not None
        and found.imu.temperature.tolist() == [20, 21, 22]
    )
    np.testing.assert_allclose(found.gnss.llh[0], [0.5, 7 * DEG, 400])
    np.testing.assert_allclose(found.gnss.vel_ned[0], [1, 2, -3])
    assert found.gnss.vel_std_ned is not None and found.gnss.vel_std_ned[0].tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.reference.rpy[0], [10 * DEG, 20 * DEG, 0.5])
    for name, text, said in (
        ("imu.csv", "t,gx,gy,gz,ax,ay\n0,1,2,3,4,5\n1,1,2,3,4,5\n", "has no column 'az' next to gx, gy, gz, ax, ay"),
        ("imu.csv", "t,gx,gx\n0,1,2\n1,1,2\n", "column 'gx' appears more than once"),
        ("gnss.csv", "t,lat,lon [m],h\n0,1,2,3\n", "lon: has the unit 'm', expected one like 'deg'"),
        (
            "gnss.csv",
            "t,lat,lon,h,pos_std_n [deg]\n0,1,2,3,4\n",
            "pos_std_n: has the unit 'deg', expected one like 'm'",
        ),
        ("gnss.csv", "0,1,2,3\n1,1,2,3\n", "has no header; expected names of columns, with units in brackets"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError) as caught:
            read_recording(tmp_path)
        assert str(caught.value).endswith(said)
        (tmp_path / name).write_text(texts_[name])


# ------------------------------------------------------------------------------------------------------------------------ text


@pytest.mark.parametrize(
    ("text", "header", "rows"),
    [
        ("a,b\n1,2\n3,4\n", ["a", "b"], [[1, 2], [3, 4]]),
        ("# c\n\n% d\na;b\n1;2\n", ["a", "b"], [[1, 2]]),
        ("1\t2\n3\t4\n", None, [[1, 2], [3, 4]]),
        ("1 2\n3 4\n", None, [[1, 2], [3, 4]]),
        ('"a" ,b\n1,\n,nan\n# x\n\n5,NA\n', ["a", "b"], [[1, np.nan], [np.nan, np.nan], [5, np.nan]]),
        ("nan,1\n2,3\n", None, [[np.nan, 1], [2, 3]]),
        ("one column [m]\n1\n2\n", ["one column [m]"], [[1], [2]]),
        ("one column\n1\n2\n", ["one column"], [[1], [2]]),
        ("a b\n1 2\n", ["a", "b"], [[1, 2]]),
    ],
)
def test_tables_of_text(tmp_path: Path, text: str, header: list[str] | None, rows: Any) -> None:
    for name, data in (
        ("a.csv", text.encode()),
        ("a.csv.gz", gzip.compress(text.encode())),
        ("b.csv", text.encode("utf-16")),
    ):
        (tmp_path / name).write_bytes(data)
        found, columns = read_table(tmp_path / name)
        assert found == header
        np.testing.assert_array_equal(np.column_stack(columns), rows)


def test_a_written_table_is_read_as_it_was(tmp_path: Path) -> None:
    block = np.array([[0.1, np.nan], [1e300, -3.0]])
    for name in ("a.csv", "a.csv.gz"):
        write_table(tmp_path / name, ["x [m]", "y"], block)
        header, back = read_table(tmp_path / name)
        assert header == ["x [m]", "y"]
        np.testing.assert_array_equal(np.column_stack(back), block)
    assert (tmp_path / "a.csv").read_text() == "x [m],y\n0.1,nan\n1e+300,-3.0\n"
    assert [is_text(Path(n)) for n in ("a.csv", "a.TXT", "a.tsv.gz", "a.dat", "a.bin", "a.npz", "a.gz")] == [
        True
    ] * 4 + [False] * 3


@pytest.mark.parametrize(
    ("text", "columns", "units", "headed"),
    [
        ("a [m],b\n1,2\n3,4\n", {"a": [1, 3], "b": [2, 4]}, {"a": "m"}, True),
        ("#a [m],b\n1,2\n3,4\n", {"a": [1, 3], "b": [2, 4]}, {"a": "m"}, True),
        ("# a b\n1 2\n3 4\n", {"a": [1, 3], "b": [2, 4]}, {}, True),
        ("# no header at all\n1 2\n3 4\n", {"column_1": [1, 3], "column_2": [2, 4]}, {}, False),
        ("a;b\n1,5;2\n3,5;4\n", {"a": [1.5, 3.5], "b": [2, 4]}, {}, True),
        ("a;b\n1.5;2\n3.5;4\n", {"a": [1.5, 3.5], "b": [2, 4]}, {}, True),
        ("a,a,,b\n1,2,3,x\n3,4,5,y\n", {"a": [1, 3], "a_2": [2, 4], "column_3": [3, 5]}, {}, True),
        ("a,b\n1,true\n2,false\n", {"a": [1, 2], "b": [1, 0]}, {}, True),
        ("a,b\n1,2,\n3,4,\n", {"a": [1, 3], "b": [2, 4]}, {}, True),
        ("a,b\n1970-01-01 00:00:10,1\n1970-01-02 00:00:00,2\n", {"a": [10e9, 86400e9], "b": [1, 2]}, {}, True),
        ("a,b\n1,x\n2,3\n4,5\n", {"a": [1, 2, 4], "b": [np.nan, 3, 5]}, {}, True),
        ("speed over ground\n1\n2\n", {"speed over ground": [1, 2]}, {}, True),
    ],
)
def test_delimited_text_of_any_kind(
    tmp_path: Path, text: str, columns: dict[str, Any], units: dict[str, str], headed: bool
) -> None:
    (tmp_path / "a.txt").write_text(text)
    found, stated, had = read_delimited(tmp_path / "a.txt")
    assert list(found) == list(columns)
    for name, values in columns.items():
        np.testing.assert_allclose(np.asarray(found[name], dtype=float), values)
    assert (stated, had) == (units, headed)


def test_names_for_files_without_a_header_and_columns_of_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1,x\n2,y\n")
    assert list(read_delimited(tmp_path / "a.txt", names=["p", "q"])[0]) == ["p"]
    found = read_delimited(tmp_path / "a.txt", names=["p", "q"], text=True)[0]
    assert found["q"].tolist() == ["x", "y"]
    for text, said in (
        ("", "no rows"),
        ("a,b,c\n1,2\n3,4\n", "3 names in the header and 2 cells in the rows"),
        ("a,b\n", "No columns to parse"),
    ):
        (tmp_path / "b.txt").write_text(text)
        with pytest.raises(InputError, match=said):
            read_delimited(tmp_path / "b.txt")


def test_units_at_the_end_of_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_ms,gyro_x_dps,acc_x_ms2,v_mps,w_rads,h_x,q_mg\n" + "1,2,3,4,5,6,7\n" * 3)
    found = any_table(tmp_path / "a.csv")
    assert found.units == {
        "t_ms": "ms",
        "gyro_x_dps": "deg/s",
        "acc_x_ms2": "m/s^2",
        "v_mps": "m/s",
        "w_rads": "rad/s",
        "q_mg": "mg",
    }
    assert found.name == "a.csv" and any_table(tmp_path / "a.csv", name="n").name == "n" and len(found) == 3


# ---------------------------------------------------------------------------------------------------------------------- clocks


@pytest.mark.parametrize(
    ("given", "wanted", "t", "near", "out", "said"),
    [
        ("unix", "unix", [5.0], 0.0, [5.0], ""),
        ("", "gps", [5.0], 0.0, [5.0], ""),
        ("gps", "", [5.0], 0.0, [5.0], ""),
        ("sow", "sow", [10.0], WEEK + 20.0, [WEEK + 10.0], "1 GPS week(s) added: the week ended in between"),
        ("sow", "sow", [10.0], 20.0, [10.0], ""),
        ("gps", "sow", [2299 * WEEK + 7.0], 9.0, [7.0], "GPS week 2299 removed"),
        ("sow", "gps", [7.0], 2299 * WEEK + 9.0, [2299 * WEEK + 7.0], "GPS week 2299 added"),
        ("unix", "gps", [1.7e9], 0.0, [1.7e9 - GPS_EPOCH + 18], "UTC turned into GPS time with 18 leap seconds"),
        ("gps", "unix", [1.3e9], 0.0, [1.3e9 + GPS_EPOCH - 18], "GPS time turned into UTC with 18 leap seconds"),
        ("sow", "unix", [7.0], 2299 * WEEK + GPS_EPOCH, [2299 * WEEK + GPS_EPOCH + 7.0 - 18], "GPS time turned into UTC with 18 leap seconds"),
        ("unix", "sow", [2299 * WEEK + GPS_EPOCH], 9.0, [18.0], "UTC turned into GPS time with 18 leap seconds; GPS week 2299 removed"),
    ],
)  # fmt: skip
def test_clocks(given: str, wanted: str, t: list[float], near: float, out: list[float], said: str) -> None:
    found, text = converted(np.array(t), given, wanted, near)
    np.testing.assert_allclose(found, out, rtol=1e-15)
    assert text == said
    assert converted(np.array([]), given, wanted, near)[1] == ""
    with pytest.raises(InputError, match="unknown clock 'tai', expected one of: gps, sow, unix"):
        converted(np.array(t), "tai", wanted, near)


def test_leap_seconds_begin_where_the_bulletins_say() -> None:
    """IERS Bulletin C: one more from the first day of a month on."""
    from datetime import UTC, datetime

    days = {
        (1981, 7): 1,
        (1988, 1): 5,
        (1999, 1): 13,
        (2006, 1): 14,
        (2009, 1): 15,
        (2012, 7): 16,
        (2015, 7): 17,
        (2017, 1): 18,
    }
    for (year, month), seconds in days.items():
        first = datetime(year, month, 1, tzinfo=UTC).timestamp()
        assert (leap_seconds(first - 1.0), leap_seconds(first)) == (seconds - 1, seconds)


@pytest.mark.parametrize(
    ("stamps", "name", "fastest", "unit", "why"),
    [
        ([0.0, 0.01], "t", 5.0, "s", "a step of 0.01 s is 100 Hz"),
        ([0.0, 10.0, 20.0], "t", 5.0, "ms", "a step of 10 is 100 Hz in ms"),
        ([0.0, 10.0, 20.0], "t", np.inf, "s", "a step of 10 s"),
        ([0.0, 1.0, 2.0], "t", 5.0, "s", "a step of 1 s"),
        ([0.0, 2.0, 4.0], "t", 5.0, "ms", "a step of 2 is 500 Hz in ms"),
        ([0.0, 5000.0], "t", 5.0, "us", "a step of 5000 is 200 Hz in us"),
        ([0.0, 5000.0], "t", np.inf, "ms", "a step of 5000 is 0.2 Hz in ms"),
        ([0.0, 19.0], "t", np.inf, "s", "a step of 19 s"),
        ([0.0, 25.0], "t", np.inf, "ms", "a step of 25 is 40 Hz in ms"),
        ([0.0, 1e7], "t", 5.0, "ns", "a step of 1e+07 is 100 Hz in ns"),
        ([1.7e9, 1.7e9 + 1], "t", 5.0, "s", "the first stamp, 1.7e+09, is a date in s"),
        ([1.7e12, 1.7e12 + 10], "t", 5.0, "ms", "the first stamp, 1.7e+12, is a date in ms"),
        ([1.7e15, 1.7e15 + 10], "t", 5.0, "us", "the first stamp, 1.7e+15, is a date in us"),
        ([5.0, 5.0, 5.0], "t", 5.0, "s", "nothing tells"),
        ([5.0], "t", 5.0, "s", "nothing tells"),
        ([], "t", 5.0, "s", "nothing tells"),
        ([0.0, 1.0], "time_us", 5.0, "us", "the column is called 'time_us'"),
        ([0.0, 1.0], "time [ms]", 5.0, "ms", "the column is called 'time [ms]'"),
        ([0.0, 1.0], "ns", 5.0, "ns", "the column is called 'ns'"),
        ([0.0, 1.0], "TimeNanos", 5.0, "ns", "the column is called 'TimeNanos'"),
        ([0.0, 1.0], "microsec", 5.0, "us", "the column is called 'microsec'"),
        ([0.0, 1.0], "t_msec", 5.0, "ms", "the column is called 't_msec'"),
    ],
)  # fmt: skip
def test_the_unit_of_stamps_and_why(stamps: list[float], name: str, fastest: float, unit: str, why: str) -> None:
    assert stamp_unit(np.array(stamps), name, fastest) == (unit, why)


def test_logs_of_text(tmp_path: Path) -> None:
    block = np.sin(np.arange(24.0)).reshape(4, 6)
    rows = "".join(f"{0.02 * k}," + ",".join(map(repr, row)) + "\n" for k, row in enumerate(block.tolist()))
    (tmp_path / "a.csv").write_text("t," + ",".join(COLUMNS) + "\n" + rows)
    log = read_log(tmp_path / "a.csv")
    assert (log.names, log.units, log.stated_units, log.rate_hz) == (
        COLUMNS,
        ("rad/s",) * 3 + ("m/s^2",) * 3,
        ("",) * 6,
        50.0,
    )
    series = read(tmp_path / "a.csv")
    assert isinstance(series, list) and [s.name for s in series] == list(AXES)
    np.testing.assert_array_equal(np.column_stack([s.values for s in series]), block)
    with pytest.raises(InputError, match=r"the rate is said to be 51\.1 Hz, but the time column steps by 0\.02 s"):
        read_log(tmp_path / "a.csv", rate_hz=51.1)
    assert read_log(tmp_path / "a.csv", rate_hz=50.9).rate_hz == 50.9


@pytest.mark.parametrize(
    ("column", "first", "clock"),
    [
        ("tow", 3e5, "sow"),
        ("gps_sow", 3e5, "sow"),
        ("time", 3e5, ""),
        ("tow", 2.0 * WEEK, ""),
        ("tow", -1.0, ""),
        ("gps time", 1.4e9, "gps"),
        ("gps time", 1.7e9, "unix"),
        ("gps time utc", 1.4e9, "unix"),
        ("time", 1.4e9, "unix"),
        ("time", 8.0e8, ""),
    ],
)
def test_the_clock_of_a_table_from_its_names_and_its_first_stamp(column: str, first: float, clock: str) -> None:
    t = first + np.arange(3.0)
    assert clock_of(Columns(Table("a.csv", {column: t}), *counted(t), {}, "sample", {})) == clock


def test_a_column_of_one_row_is_a_number_a_date_or_text() -> None:
    def of(text: str) -> object:
        found = _values(pd.Series([text]), True)
        assert found is not None
        return found.tolist()[0]

    assert [of("2.5"), of("1970-01-02T00:00:10Z"), of("abc")] == [2.5, 86_410_000_000_000, "abc"]
