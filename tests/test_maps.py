"""Column maps: what each role and each setting makes of a small table, by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insemu.errors import InputError
from insemu.formats import open_files, read_log
from insemu.formats.axes import axes_matrix
from insemu.formats.columns import _triad, guess_map, parse_map, resolve, split_header, words_of
from insemu.formats.opened import Opened

DEG = np.pi / 180.0
G = 9.80665
#: Columns a .. i of three rows: row k has 1 + k, 2 + k, ...
LETTERS = "abcdefghi"


def table(folder: Path, name: str = "x.csv", rows: int = 3, **columns: Any) -> Path:
    """A CSV with the letters, and with columns put in their place or beside."""
    block = {letter: [1.0 + n + k for k in range(rows)] for n, letter in enumerate(LETTERS)} | columns
    lines = [",".join(block), *(",".join(str(v) for v in row) for row in zip(*block.values(), strict=True))]
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def stamps(found: Opened, record: str = "imu") -> np.ndarray:
    """Times of a record on the clock of its file, s."""
    return np.asarray(found.origin.ns * 1e-9 + getattr(found, record).t)


def imu(folder: Path, line: str) -> Opened:
    return open_files(table(folder), maps=(line, "", ""))


def fixes(folder: Path, line: str, **columns: Any) -> Any:
    """Fixes of a table, beside an IMU that has nothing to do with them."""
    found = open_files(
        table(folder, "i.csv"),
        gnss=table(folder, "g.csv", **({"la": [46.5, 46.6, 46.7], "lo": [7.0, 7.1, 7.2]} | columns)),
        maps=("time=a[s], gyro=b c d[rad/s], accel=e f g[m/s^2]", line, ""),
    )
    assert found.gnss is not None
    return found


PLAIN = "time=a[s], gyro=b c d[rad/s], accel=e f g[m/s^2]"
GYRO = np.array([[2.0, 3, 4], [3, 4, 5], [4, 5, 6]])
ACCEL = np.array([[5.0, 6, 7], [6, 7, 8], [7, 8, 9]])


@pytest.mark.parametrize(
    ("line", "t", "gyro", "accel", "kind"),
    [
        (PLAIN, [1, 2, 3], GYRO, ACCEL, "sample"),
        ("time=a[ms], gyro=b c d[deg/s], accel=e f g[g]", [1e-3, 2e-3, 3e-3], GYRO * DEG, ACCEL * G, "sample"),
        ("time=a, time_unit=us, gyro=-b c -d, gyro_unit=deg/h, accel=e -f g, accel_unit=mg",
         [1e-6, 2e-6, 3e-6], GYRO * [-1, 1, -1] * DEG / 3600, ACCEL * [1, -1, 1] * G / 1000, "sample"),
        (PLAIN + ", kind=mean", [1, 2, 3], GYRO, ACCEL, "mean"),
        ("time=a[s], gyro=b c d[deg], accel=e f g[m/s]", [1, 2, 3], GYRO * DEG, ACCEL, "increment"),
        ("gyro=b c d[rad/s], accel=e f g[m/s^2], rate=50 Hz", [0, 0.02, 0.04], GYRO, ACCEL, "sample"),
        (PLAIN + ", shift=-0.5 s", [0.5, 1.5, 2.5], GYRO, ACCEL, "sample"),
        (PLAIN + ", axes=FLU", [1, 2, 3], GYRO * [1, -1, -1], ACCEL * [1, -1, -1], "sample"),
        (PLAIN + ", axes=enu", [1, 2, 3], GYRO[:, [1, 0, 2]] * [1, 1, -1], ACCEL[:, [1, 0, 2]] * [1, 1, -1], "sample"),
        (PLAIN + ", axes=BLD", [1, 2, 3], GYRO * [-1, -1, 1], ACCEL * [-1, -1, 1], "sample"),
        (PLAIN + ", mount=0 0 90", [1, 2, 3], GYRO[:, [1, 0, 2]] * [-1, 1, 1], ACCEL[:, [1, 0, 2]] * [-1, 1, 1], "sample"),
        (PLAIN + ", mount=180 0 90 deg, axes=FLU", [1, 2, 3], GYRO[:, [1, 0, 2]] * [-1, 1, 1], ACCEL[:, [1, 0, 2]] * [-1, 1, 1], "sample"),
        ("time=a[s], nanoseconds=i, gyro=b c d, accel=e f g", np.array([1, 2, 3]) + 1e-9 * np.array([9, 10, 11]), GYRO, ACCEL, "sample"),
        ("time=a[s], week=i, gyro=b c d, accel=e f g", np.array([1, 2, 3]) + 604_800.0 * np.array([9, 10, 11]), GYRO, ACCEL, "sample"),
    ],
)  # fmt: skip
def test_an_imu(tmp_path: Path, line: str, t: Any, gyro: Any, accel: Any, kind: str) -> None:
    opened = imu(tmp_path, line)
    found = opened.imu
    assert found is not None and found.temperature is None and 0.0 <= found.t[0] < 1.0
    np.testing.assert_allclose(stamps(opened), t, rtol=1e-14)
    np.testing.assert_allclose(found.gyro, gyro, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(found.accel, accel, rtol=1e-13, atol=1e-13)
    assert found.kind == kind


def test_what_was_taken_and_assumed_is_said(tmp_path: Path) -> None:
    found = imu(tmp_path, "time=a, gyro=b -c d, accel=e f g[g], temperature=h, axes=FLU, mount=0 0 90")
    assert found.taken == (
        "gyro from b -c d of x.csv", "accel from e f g (g) of x.csv", "temperature from h (plain) of x.csv",
        "nothing from i of x.csv", "axes turned into forward-right-down (axes=FLU, mount=0 0 90)",
    )  # fmt: skip
    assert found.assumed == ("gyro in rad/s: x.csv states no unit",)
    assert found.imu is not None
    np.testing.assert_array_equal(found.imu.temperature, [8, 9, 10])
    rated = imu(tmp_path, "gyro=b c d[rad/s], accel=e f g[g], rate=50 Hz")
    assert rated.assumed == ("stamps from the rate of 50 Hz",)
    assert (rated.source, rated.kind) == (str(tmp_path / "x.csv"), "table of text (.csv, .txt, .tsv, .dat)")
    assert (rated.repeated, rated.missing, rated.notes) == (0, 0, ())
    path = tmp_path / "units.csv"
    path.write_text(
        "t [s],gx [counts],gy [counts],gz [counts],ax [-],ay [-],az [-]\n"
        + "".join(f"{k},1,2,3,4,5,6\n" for k in range(3))
    )
    raw = open_files(path).imu
    assert raw is not None
    np.testing.assert_array_equal(np.hstack([raw.gyro, raw.accel]), [[1, 2, 3, 4, 5, 6]] * 3)


@pytest.mark.parametrize(
    ("line", "gyro", "accel"), [("gyro_shift=-1.5 s", 1.5, 0.0), ("gyro_shift=0.5 s, accel_shift=2 s", -0.5, -2.0)]
)
def test_a_sensor_that_is_late_is_moved(tmp_path: Path, line: str, gyro: float, accel: float) -> None:
    """Columns that grow by 1 a second are larger by what their stamps are earlier; rows that a sensor does not reach go."""
    found = open_files(table(tmp_path, rows=9), maps=(f"{PLAIN}, {line}", "", ""))
    assert found.imu is not None
    t = stamps(found)
    np.testing.assert_array_equal(t, np.arange(1.0, 8.0) if gyro > 0.0 else np.arange(3.0, 10.0))
    np.testing.assert_allclose(found.imu.gyro[:, 0], t + 1.0 + gyro, rtol=1e-13)
    np.testing.assert_allclose(found.imu.accel[:, 0], t + 4.0 + accel, rtol=1e-13)
    with pytest.raises(InputError, match=r"moves a sensor by 7\.5 s, more than the record of 8 s holds"):
        open_files(table(tmp_path, rows=9), maps=(f"{PLAIN}, accel_shift=7.5 s", "", ""))


def test_a_temperature_with_a_hole_is_no_temperature(tmp_path: Path) -> None:
    path = table(tmp_path, h=[20.0, "nan", 21.0])
    found = open_files(path, maps=(PLAIN + ", temperature=h", "", ""))
    assert found.imu is not None and found.imu.temperature is None


def test_a_span_is_kept(tmp_path: Path) -> None:
    path = table(tmp_path, rows=9, la=[46.0] * 9, lo=[7.0 + k for k in range(9)])
    line = (
        PLAIN
        + ", lat=la[deg], lon=lo[deg], height=h[m], temperature=h, pos_std_ned=b c d[m], vel_ned=e f g[m/s], vel_std_ned=e f g[m/s]"
    )
    for more, first, last in ((", from=2 s, to=5000 ms", 3, 6), (", from=2 s", 3, 9), (", to=5 s", 1, 6)):
        found = open_files(path, maps=(line + more, "", ""))
        kept = np.arange(first, last + 1.0)
        assert found.imu is not None and found.gnss is not None
        np.testing.assert_array_equal(found.imu.t, kept - 1)
        np.testing.assert_array_equal(found.imu.gyro[:, 0], kept + 1)
        np.testing.assert_array_equal(found.imu.accel[:, 0], kept + 4)
        np.testing.assert_array_equal(found.imu.temperature, kept + 7)
        np.testing.assert_array_equal(found.gnss.t, kept - 1)
        np.testing.assert_allclose(found.gnss.llh, np.column_stack([46 + 0 * kept, 6 + kept, kept + 7]) * [DEG, DEG, 1])
        assert (
            found.gnss.vel_ned is not None and found.gnss.pos_std_ned is not None and found.gnss.vel_std_ned is not None
        )
        np.testing.assert_array_equal(found.gnss.vel_ned[:, 1], kept + 5)
        np.testing.assert_array_equal(found.gnss.vel_std_ned[:, 2], kept + 6)
        np.testing.assert_array_equal(found.gnss.pos_std_ned[:, 1], kept + 2)
    with pytest.raises(InputError, match="nothing lies between 30 s and the end"):
        open_files(path, maps=(line + ", from=30 s", "", ""))
    with pytest.raises(InputError, match=r"nothing lies between the start and -0\.5 s"):
        open_files(path, maps=(line + ", to=-0.5 s", "", ""))


@pytest.mark.parametrize(
    ("line", "field", "wanted"),
    [
        ("vel_ned=b c d[m/s]", "vel_ned", GYRO),
        ("vel_ned=b c d, vel_unit=km/h", "vel_ned", GYRO / 3.6),
        ("vel_enu=b c d[m/s]", "vel_ned", GYRO[:, [1, 0, 2]] * [1, 1, -1]),
        ("vel_neu=b c d[m/s]", "vel_ned", GYRO * [1, 1, -1]),
        ("vel_ned=b c d[m/s], velocity=enu", "vel_ned", GYRO[:, [1, 0, 2]] * [1, 1, -1]),
        ("vel_enu=b c d[m/s], velocity=neu", "vel_ned", GYRO * [1, 1, -1]),
        ("vel_neu=b c d[m/s], velocity=ned", "vel_ned", GYRO),
        ("pos_std_ned=b -c d[cm]", "pos_std_ned", GYRO / 100),
        ("pos_std_enu=b c -d[m]", "pos_std_ned", GYRO[:, [1, 0, 2]]),
        ("pos_std_h=b[m]", "pos_std_ned", GYRO[:, [0, 0, 0]] * [np.sqrt(0.5), np.sqrt(0.5), 1.5]),
        ("pos_std_h=b[m], pos_std_v=d[m]", "pos_std_ned", GYRO[:, [0, 0, 2]] * [np.sqrt(0.5), np.sqrt(0.5), 1.0]),
        ("quality=b", "pos_std_ned", [[1, 1, 1.5], [5, 5, 7.5], [0.02, 0.02, 0.03]]),
        ("quality=h", "pos_std_ned", [[np.nan] * 3, [1, 1, 1.5], [np.nan] * 3]),
        ("quality=e", "pos_std_ned", [[0.5, 0.5, 0.75], [np.nan] * 3, [np.nan] * 3]),
        ("quality=b, pos_std_h=c[m]", "pos_std_ned", GYRO[:, [1, 1, 1]] * [np.sqrt(0.5), np.sqrt(0.5), 1.5]),
        ("vel_std_ned=b c -d[m/s]", "vel_std_ned", GYRO),
        ("vel_std_enu=b c d[m/s]", "vel_std_ned", GYRO[:, [1, 0, 2]]),
        ("vel_std_h=b[m/s]", "vel_std_ned", GYRO[:, [0, 0, 0]]),
    ],
)
def test_fixes(tmp_path: Path, line: str, field: str, wanted: Any) -> None:
    found = fixes(tmp_path, f"time=a[s], lat=la[deg], lon=lo[deg], height=h[m], {line}").gnss
    for name in ("vel_ned", "pos_std_ned", "vel_std_ned"):
        if name == field:
            np.testing.assert_allclose(getattr(found, name), wanted, rtol=1e-13)
        else:
            assert getattr(found, name) is None
    np.testing.assert_array_equal(found.t, [0, 1, 2])
    np.testing.assert_allclose(found.llh, np.array([[46.5, 7, 8], [46.6, 7.1, 9], [46.7, 7.2, 10]]) * [DEG, DEG, 1])


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("lat=la, lon=lo, height=h", [[46.5, 7, 8], [46.6, 7.1, 9], [46.7, 7.2, 10]]),
        ("lat=la[rad], lon=lo[rad], pos_unit=deg, height=h[km]", [[46.5, 7, 8e3], [46.6, 7.1, 9e3], [46.7, 7.2, 1e4]]),
        ("lat=lo[deg], lon=la[deg], latlon=swapped", [[46.5, 7, 0], [46.6, 7.1, 0], [46.7, 7.2, 0]]),
        ("lat=la[deg], lon=lo[deg], latlon=west", [[46.5, -7, 0], [46.6, -7.1, 0], [46.7, -7.2, 0]]),
        ("lat=la[deg], lon=lo[deg], latlon=south", [[-46.5, 7, 0], [-46.6, 7.1, 0], [-46.7, 7.2, 0]]),
    ],
)
def test_places(tmp_path: Path, line: str, wanted: Any) -> None:
    found = fixes(tmp_path, f"time=a[s], gnss_shift=1500 ms, {line}")
    np.testing.assert_array_equal(stamps(found, "gnss"), [2.5, 3.5, 4.5])
    np.testing.assert_allclose(found.gnss.llh, np.array(wanted) * [DEG, DEG, 1])
    assert ("height 0 m: g.csv has none" in found.assumed) == ("height" not in line)
    assert ("lat in deg: g.csv states no unit" in found.assumed) == ("[" not in line)


@pytest.mark.parametrize(("line", "wanted"), [("ned=b c d[m]", [0, 0, 1]), ("enu=b c d[m]", [0, 0, 1])])
def test_local_coordinates_are_laid_on_the_ellipsoid(tmp_path: Path, line: str, wanted: Any) -> None:
    """On the equator north is z of ECEF, east is y and up is x."""
    found = fixes(tmp_path, f"time=a[s], origin=0 0 100, {line}").gnss
    n, e, u = (GYRO * [1, 1, -1]).T if line.startswith("ned") else GYRO[:, [1, 0, 2]].T
    x, y, z = 6378137.0 + 100.0 + u, e, n
    np.testing.assert_allclose(found.llh[:, 1], np.arctan2(y, x), rtol=1e-12)
    np.testing.assert_allclose(found.llh[:, 0], z / (6356752.314245**2 / 6378137.0 + 100.0 + u), rtol=1e-9)
    np.testing.assert_allclose(found.llh[:, 2], 100.0 + u, atol=1e-5)


@pytest.mark.parametrize(
    ("latitudes", "longitudes", "line", "said"),
    [
        ([100.0] * 3, [7.0] * 3, "lat=la[deg], lon=lo[deg]", '100 deg is beyond 90; latitude and longitude are swapped: --gnss-map "latlon=swapped"'),
        ([46.5] * 3, [7.0] * 3, "lat=la[rad], lon=lo[rad]", '2664.25 deg is beyond 90; the unit is degrees, not rad: --gnss-map "pos_unit=deg"'),
        ([6.25] * 3, [0.7] * 3, "lat=la[rad], lon=lo[rad]", '358.099 deg is beyond 90; latitude and longitude are swapped: --gnss-map "latlon=swapped"'),  # noqa: E501
        ([465000000] * 3, [70000000] * 3, "lat=la[deg], lon=lo[deg]", '4.65e+08 deg is beyond 90; is it in 1e-7 deg? --gnss-map "pos_unit=1e-7 deg"'),
    ],
)  # fmt: skip
def test_latitudes_beyond_the_pole_are_refused_with_a_hint(
    tmp_path: Path, latitudes: Any, longitudes: Any, line: str, said: str
) -> None:
    with pytest.raises(InputError) as caught:
        fixes(tmp_path, f"time=a[s], {line}", la=latitudes, lo=longitudes)
    assert str(caught.value).endswith(f"a latitude of {said}")
    assert fixes(tmp_path, "time=a[s], lat=la[deg], lon=lo[deg]", la=[90.0, -90.0, 0.0]).gnss.llh[0, 0] == np.pi / 2


ANGLES = np.array([[10.0, 20.0, 30.0], [-40.0, 5.0, 200.0], [0.0, -60.0, 359.0]])
_R = Rotation.from_euler("ZYX", ANGLES[:, ::-1], degrees=True)
_SWAP = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


def _quaternions(matrices: np.ndarray, order: str) -> dict[str, Any]:
    """Columns qa .. qd, of twice the unit length."""
    q = 2.0 * Rotation.from_matrix(matrices).as_quat()
    return dict(zip(("qa", "qb", "qc", "qd"), (q if order == "xyzw" else q[:, [3, 0, 1, 2]]).T.tolist(), strict=True))


@pytest.mark.parametrize(
    ("line", "columns"),
    [
        ("rpy=ra rb rc[deg]", dict(zip(("ra", "rb", "rc"), ANGLES.T.tolist(), strict=True))),
        ("rpy=ra rb rc", dict(zip(("ra", "rb", "rc"), ANGLES.T.tolist(), strict=True))),
        ("heading=rc[deg], roll=ra[deg], pitch=rb[rad]", dict(zip(("ra", "rb", "rc"), (ANGLES * [1, DEG, 1]).T.tolist(), strict=True))),
        ("quaternion=qa qb qc qd", _quaternions(_R.as_matrix(), "wxyz")),
        ("quaternion_xyzw=qa qb qc qd, attitude=ned", _quaternions(_R.as_matrix(), "xyzw")),
        ("quaternion=qa qb qc qd, attitude=enu", _quaternions(_SWAP @ _R.as_matrix() @ np.diag([1, -1, -1]), "wxyz")),
        ("quaternion_xyzw=qa qb qc qd, attitude=enu, axes=RFU", _quaternions(_SWAP @ _R.as_matrix() @ _SWAP, "xyzw")),
    ],
)  # fmt: skip
def test_attitudes_of_a_truth(tmp_path: Path, line: str, columns: dict[str, Any]) -> None:
    truth = table(tmp_path, "t.csv", la=[46.5] * 3, lo=[7.0] * 3, **columns)
    found = open_files(
        table(tmp_path, "i.csv"),
        truth=truth,
        maps=(PLAIN, "", f"time=a[s], lat=la[deg], lon=lo[deg], height=h[m], vel_ned=b c d[m/s], {line}"),
    ).reference
    assert found is not None
    turned = Rotation.from_euler("ZYX", found.rpy[:, ::-1]).as_matrix()
    np.testing.assert_allclose(turned, _R.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(found.vel_ned, GYRO)
    np.testing.assert_array_equal(found.t, [0, 1, 2])


def test_a_truth_needs_positions_and_attitudes(tmp_path: Path) -> None:
    path = table(tmp_path, "t.csv", la=[46.5, 46.5, "nan"], lo=[7.0] * 3)
    with pytest.raises(
        InputError, match="has no position and attitude, which a truth needs; fixes are given with --gnss"
    ):
        open_files(table(tmp_path, "i.csv"), truth=path, maps=(PLAIN, "", "time=a[s], lat=la[deg], lon=lo[deg]"))
    whole = "time=a[s], lat=la[deg], lon=lo[deg], height=h[m], rpy=b c d[deg]"
    found = open_files(table(tmp_path, "i.csv"), truth=path, maps=(PLAIN, "", whole)).reference
    assert found is not None and len(found) == 2
    np.testing.assert_allclose(found.vel_ned, [[0, 0, -1]] * 2, atol=1e-8)
    with pytest.raises(InputError, match=r"has 1 usable row\(s\) of truth, expected at least 2"):
        open_files(
            table(tmp_path, "i.csv"),
            truth=table(tmp_path, "t.csv", la=[46.5, "nan", "nan"], lo=[7.0] * 3),
            maps=(PLAIN, "", whole),
        )
    # a quaternion far from length 1 is none
    half = {"qa": [1.0, 0.4, 1.0], "qb": [0.0] * 3, "qc": [0.0] * 3, "qd": [0.0] * 3}
    line = "time=a[s], lat=la[deg], lon=lo[deg], height=h[m], quaternion=qa qb qc qd"
    found = open_files(
        table(tmp_path, "i.csv"),
        truth=table(tmp_path, "t.csv", la=[46.5] * 3, lo=[7.0] * 3, **half),
        maps=(PLAIN, "", line),
    ).reference
    assert found is not None and found.t.tolist() == [0, 2]


def test_rows_out_of_order_are_put_in_order_and_counted(tmp_path: Path) -> None:
    rows = {"a": [1.0, 2.0, 2.0, 1.5, 3.0, "nan", 4.0, 5.0, 6.0], "b": [0.0] * 7 + ["nan", 0.0]}
    found = open_files(table(tmp_path, rows=9, **rows), maps=(PLAIN, "", ""))
    assert found.imu is not None and (found.imu.t + found.origin.ns / 1e9).tolist() == [1, 1.5, 2, 3, 4, 6]
    assert (found.repeated, found.missing) == (0, 1)
    assert any("1 of 7 row(s) share a stamp with another; one of them is used" in text for text in found.notes)
    # exactly half may be left out
    half = open_files(table(tmp_path, rows=6, a=[1, 2, 3, 3, 3, 3]), maps=(PLAIN, "", ""))
    assert half.imu is not None and len(half.imu) == 3
    with pytest.raises(InputError, match=r"only 3 of 7 stamps rise; is another column the time"):
        open_files(table(tmp_path, rows=7, a=[1, 2, 3, 3, 3, 3, 3]), maps=(PLAIN, "", ""))
    with pytest.raises(InputError, match=r"has 2 usable row\(s\) of IMU data, expected at least 3"):
        open_files(table(tmp_path, a=[1, 2, "nan"]), maps=(PLAIN, "", ""))


def test_fixes_of_a_log_at_the_rate_of_the_imu_are_those_that_change(tmp_path: Path) -> None:
    path = table(tmp_path, rows=6, la=[0.0, 46.0, 46.0, 46.0, 46.1, 46.1], lo=[0.0, 7.0, 7.0, 7.1, 7.1, 7.1])
    found = open_files(path, maps=(PLAIN + ", lat=la[deg], lon=lo[deg]", "", ""))
    assert found.gnss is not None and stamps(found, "gnss").tolist() == [2, 4, 5]
    with pytest.raises(InputError, match="holds no position"):
        fixes(tmp_path, "time=a[s], lat=la[deg], lon=lo[deg]", la=[0.0] * 3, lo=[0.0] * 3)
    apart = fixes(tmp_path, "time=a[s], lat=la[deg], lon=lo[deg], speed=b[m/s]", la=[46.0, 46.0, "nan"], lo=[7.0] * 3)
    assert stamps(apart, "gnss").tolist() == [1, 2]
    assert apart.notes == (
        "speed over ground without a course is no velocity: it is not kept",
        "fixes: 1 of 3 rows hold no position; they were left out",
    )


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("time=a[s], gyro=b c d[rad], accel=e f g[m/s^2]", "x.csv: some axes have units of rates and others of increments"),
        ("gyro=b c d, accel=e f g", "x.csv: has no column of times; say which (--map 'time=...') or the rate (--map 'rate=100 Hz'). "
         "Columns: a, b, c, d, e, f, g, h, i"),
        ("gyro=b c d, accel=e f g, rate=-1 Hz", "x.csv: rate is -1 Hz, expected a positive one"),
        ("gyro=b c d, accel=e f g, rate=0 Hz", "x.csv: rate is 0 Hz, expected a positive one"),
        ("time=a[s], gyro=b c d", "x.csv: has columns of gyro and none of accel; say which (--map 'accel=...'). Columns: a, b, c, d, e, f, g, h, i"),
        ("time=a[s], accel=b c d", "x.csv: has columns of accel and none of gyro; say which (--map 'gyro=...'). Columns: a, b, c, d, e, f, g, h, i"),
        (PLAIN + ", axes=FLX", "axes are 'FLX', expected three letters such as FRD, FLU or RFU"),
        (PLAIN + ", axes=FRU", "axes 'FRU' are left-handed; turn an axis round instead (--map 'gyro_axes=x y -z')"),
        (PLAIN + ", axes=FBD", "axes are 'FBD', expected three letters such as FRD, FLU or RFU"),
        (PLAIN + ", axes=FRDD", "axes are 'FRDD', expected three letters such as FRD, FLU or RFU"),
        (PLAIN + ", mount=1 2", "mount: is '1 2', expected 3 numbers"),
        (PLAIN + ", mount=1 2 nan", "mount: is '1 2 nan', expected 3 numbers"),
        (PLAIN + ", mount=1 2 x", "mount: is '1 2 x', expected 3 numbers"),
        (PLAIN + ", clock=tai", "clock: is 'tai', expected gps, sow or unix"),
        ("time=a[s], gyro=b c d[rad/s], accel=e f[m/s^2]", "x.csv: accel takes 3 column(s), 'e f' names 2: e, f"),
        ("time=a[s], gyro=b c d[rad/s], accel=e f z[m/s^2]", "x.csv: has no column 'z' for accel (expected one of: a, b, c, d, e, f, g, h, i)"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        imu(tmp_path, line)
    assert str(caught.value).endswith(said)


def test_axes_of_all_right_handed_triples() -> None:
    """Of the 48 signed permutations half are rotations."""
    directions = {"F": [1, 0, 0], "B": [-1, 0, 0], "R": [0, 1, 0], "L": [0, -1, 0], "D": [0, 0, 1], "U": [0, 0, -1]}
    good = 0
    for x in directions:
        for y in directions:
            for z in directions:
                wanted = np.array([directions[c] for c in (x, y, z)], dtype=float).T
                try:
                    found = axes_matrix(x + y + z)
                except InputError:
                    assert np.linalg.det(wanted) < 0.5
                    continue
                np.testing.assert_array_equal(found, wanted)
                good += 1
    assert good == 24
    for name, letters in (("ENU", "RFU"), ("ned", "FRD"), ("NWU", "FLU")):
        np.testing.assert_array_equal(axes_matrix(name), axes_matrix(letters))


# ------------------------------------------------------------------------------------------------------------------- guesses


@pytest.mark.parametrize(
    ("names", "line"),
    [
        ("t gx gy gz ax ay az temp", "time=t, gyro=gx gy gz, accel=ax ay az, temperature=temp"),
        ("time wx wy wz fx fy fz", "time=time, gyro=wx wy wz, accel=fx fy fz"),
        ("time p q r ax ay az", "time=time, gyro=p q r, accel=ax ay az"),
        ("timestamp Gyro_X Gyro_Y Gyro_Z Acc_X Acc_Y Acc_Z", "time=timestamp, gyro=Gyro_X Gyro_Y Gyro_Z, accel=Acc_X Acc_Y Acc_Z"),
        ("secs nsecs gyro_0 gyro_1 gyro_2", "time=secs, nanoseconds=nsecs[ns], gyro=gyro_0 gyro_1 gyro_2"),
        ("header.stamp.sec header.stamp.nanosec a_x a_y a_z", "time=header.stamp.sec, nanoseconds=header.stamp.nanosec[ns], accel=a_x a_y a_z"),
        ("time ang_rate_x ang_rate_y ang_rate_z specific_force_x specific_force_y specific_force_z",
         "time=time, gyro=ang_rate_x ang_rate_y ang_rate_z, accel=specific_force_x specific_force_y specific_force_z"),
        ("time rotation_rate_x rotation_rate_y rotation_rate_z", "time=time, gyro=rotation_rate_x rotation_rate_y rotation_rate_z"),
        ("time w_x w_y w_z", "time=time, gyro=w_x w_y w_z"),
        ("time imu_b_w_x imu_b_w_y imu_b_w_z", "time=time, gyro=imu_b_w_x imu_b_w_y imu_b_w_z"),
        ("time gyrox gyroy gyroz accx accy accz", "time=time, gyro=gyrox gyroy gyroz, accel=accx accy accz"),
        ("time mag_x mag_y mag_z gyro_bias_x gyro_bias_y gyro_bias_z", "time=time"),
        ("tow latitude longitude ellipsoid_height altitude speed course",
         "time=tow, lat=latitude, lon=longitude, height=ellipsoid_height, speed=speed, course=course"),
        ("time lat lng alt hacc vacc vn ve vd",
         "time=time, vel_ned=vn ve vd, lat=lat, lon=lng, height=alt, pos_std_h=hacc, pos_std_v=vacc"),
        ("time lat lon h ve vn vu sdn sde sdu", "time=time, vel_enu=ve vn vu, pos_std_ned=sdn sde sdu, lat=lat, lon=lon, height=h"),
        ("time roll pitch yaw lat lon", "time=time, rpy=roll pitch yaw, lat=lat, lon=lon"),
        ("time speed course altitude", "time=time"),
        ("time vel_n vel_e vel_d vel_u sdvn sdve sdvu", "time=time, vel_ned=vel_n vel_e vel_d, vel_std_ned=sdvn sdve sdvu"),
        ("time lat lon h vn ve vd std_n std_e std_d std_vn std_ve std_vd",
         "time=time, vel_ned=vn ve vd, pos_std_ned=std_n std_e std_d, vel_std_ned=std_vn std_ve std_vd, lat=lat, lon=lon, height=h"),
        ("time lat lon h sigma_n sigma_e sigma_u sigma_vn sigma_ve sigma_vu",
         "time=time, pos_std_ned=sigma_n sigma_e sigma_u, vel_std_ned=sigma_vn sigma_ve sigma_vu, lat=lat, lon=lon, height=h"),
        ("time vel_ned_x vel_ned_y vel_ned_z vel_std_ned_0 vel_std_ned_1 vel_std_ned_2 truth_vel_ned_x truth_vel_ned_y truth_vel_ned_z",
         "vel_ned=vel_ned_x vel_ned_y vel_ned_z, vel_std_ned=vel_std_ned_0 vel_std_ned_1 vel_std_ned_2, time=time"),
        ("time velocity_enu_x velocity_enu_y velocity_enu_z pos_std_ned_x pos_std_ned_y pos_std_ned_z",
         "vel_enu=velocity_enu_x velocity_enu_y velocity_enu_z, pos_std_ned=pos_std_ned_x pos_std_ned_y pos_std_ned_z, time=time"),
        ("gps_week tow lat lon", "time=tow, lat=lat, lon=lon, week=gps_week"),
        ("time_accuracy date utc", "time=utc"),
    ],
)  # fmt: skip
def test_maps_are_guessed_from_names(names: str, line: str) -> None:
    assert str(guess_map(names.split())) == line


def test_the_time_is_told_by_its_values_where_several_are_called_so() -> None:
    names = ["time", "t", "stamp", "gx"]
    still, coarse, fine = np.zeros(20), np.floor(np.arange(20) / 4), np.arange(20) * 0.01
    assert "time" not in guess_map(["time"], [still]).picks
    assert "time" in guess_map(["time"], [coarse]).picks
    assert "time" not in guess_map(["time"], [np.arange(20.0)[::-1]]).picks
    (pick,) = guess_map(names, [still, coarse, fine, still]).picks["time"]
    assert pick.column == "stamp"
    (pick,) = guess_map(["t", "time"], [coarse, fine]).picks["time"]
    assert pick.column == "time"
    (pick,) = guess_map(["t", "time"], [fine, fine]).picks["time"]
    assert pick.column == "time"
    (pick,) = guess_map(["time", "field.header.stamp"], [fine, fine]).picks["time"]
    assert pick.column == "field.header.stamp"
    # a stamp goes before a time, unless it repeats: three in nineteen are as much as 4.7 words behind
    repeats = np.repeat(np.arange(17.0), [4, *[1] * 16])
    (pick,) = guess_map(["t", "stamp"], [fine, repeats]).picks["time"]
    assert pick.column == "t"
    (pick,) = guess_map(["t", "stamp"], [fine, fine]).picks["time"]
    assert pick.column == "stamp"
    jumps = fine.copy()
    jumps[10:] -= 1.0  # one of nineteen steps goes back
    assert "time" in guess_map(["time"], [jumps]).picks
    jumps[5:] -= 1.0
    assert "time" not in guess_map(["time"], [jumps]).picks


def test_patterns_take_axes_in_their_order() -> None:
    for names in (["a_z", "a_x", "a_y"], ["a_3", "a_1", "a_2"], ["a_2", "a_0", "a_1"], ["a_d", "a_n", "a_e"]):
        found = resolve("accel", parse_map("accel=a_*").picks["accel"], names, "x")
        assert [k for k, _ in found] == [1, 2, 0]
    up = resolve("vel_enu", parse_map("vel_enu=V_*").picks["vel_enu"], ["v_u", "v_n", "v_e"], "x")
    assert [k for k, _ in up] == [2, 1, 0]
    exact = resolve("accel", parse_map("accel=q b a").picks["accel"], ["a", "b", "q", "b"], "x")
    assert [k for k, _ in exact] == [2, 1, 0]


@pytest.mark.parametrize(
    ("cell", "name", "unit"),
    [
        ("gx [deg/s]", "gx", "deg/s"), ("Time (s)", "Time", "s"), ('"a b" ', "a b", ""), ("a[1]", "a[1]", ""),
        ("N (deg/s/sqrt(Hz))", "N", "deg/s/sqrt(Hz)"), ("a ] b)", "a ] b)", ""), ("(s)", "", "s"), ("a b", "a b", ""),
    ],
)  # fmt: skip
def test_header_cells(cell: str, name: str, unit: str) -> None:
    assert split_header(cell) == (name, unit)


def test_words_of_names() -> None:
    assert words_of("field.angular_velocity.x") == ["field", "angular", "velocity", "x"]
    assert words_of("GyroX rotationRateY IMU2 accX") == ["gyro", "x", "rotation", "rate", "y", "imu", "2", "acc", "x"]


def test_a_map_line_has_one_unit_behind_all_and_keeps_quotes() -> None:
    picks = parse_map('gyro="w x" -"w y" wz [deg/s], accel=ax[g] ay[m/s^2] az').picks
    assert [(p.column, p.unit, p.sign) for p in picks["gyro"]] == [
        ("w x", "deg/s", 1),
        ("w y", "deg/s", -1),
        ("wz", "deg/s", 1),
    ]
    assert [(p.column, p.unit, p.sign) for p in picks["accel"]] == [("ax", "g", 1), ("ay", "m/s^2", 1), ("az", None, 1)]
    assert not parse_map("") and parse_map("axes=FLU") and parse_map("time=t")
    assert (
        str(parse_map("axes=FLU, time=t[ms]").over(parse_map("axes=FRD, time=u, kind=mean")))
        == "time=t[ms], axes=FLU, kind=mean"
    )


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("latlon=yes", "--map: latlon: is 'yes', expected one of: swapped, west, south, as stated"),
        ("kind=rate", "--map: kind: is 'rate', expected one of: sample, mean, increment"),
        ("attitude=up", "--map: attitude: is 'up', expected one of: ned, enu"),
        ("velocity=und", "--map: velocity: is 'und', expected one of: ned, enu, neu"),
        ("gyro_unit=m/s", "--map: gyro: the unit 'm/s' is none of rad/s"),
        ("pos_unit=m", "--map: lat: the unit 'm' is none of rad"),
        ("shift=1 Hz", "the unit 'Hz' has another dimension than 's', expected something like 's'"),
        ("rate=1 s", "the unit 's' has another dimension than 'Hz', expected something like 'Hz'"),
        ("gyro=- b c", "--map: 'gyro' names no column"),
        ("gyro=[rad/s]", "--map: 'gyro' names no column"),
        ("gyro=a[[rad/s]]", "--map: brackets do not match in 'gyro=a[[rad/s]]'"),
    ],
)
def test_bad_maps_are_refused(line: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_map(line)
    assert str(caught.value) == said


def test_increments_may_be_maps_units_too() -> None:
    for line in ("gyro=a b c[rad]", "accel=a b c[m/s]", "gyro_unit=deg", "accel_unit=ft/s", "quality=q", "week=w[1]"):
        parse_map(line)


def test_a_preset_beside_the_file_stands_behind_what_is_said(tmp_path: Path) -> None:
    path = table(tmp_path)
    for preset in ("time: a[s]\ngyro: b c d[deg/s]\naccel: e f g\n", '"time=a[s], gyro=b c d[deg/s], accel=e f g"\n'):
        (tmp_path / "x.csv.map.yaml").write_text(preset)
        found = open_files(path, maps=("accel=g f e[g]", "", ""))
        assert found.imu is not None
        np.testing.assert_allclose(found.imu.gyro, GYRO * DEG)
        np.testing.assert_allclose(found.imu.accel, ACCEL[:, ::-1] * G)
        assert found.notes == ("the column map next to x.csv was used",)
        assert read_log(path).names == ("gx", "gy", "gz", "ax", "ay", "az")
    for bad in ("[1, 2]\n", "{}\n", "3\n"):
        (tmp_path / "x.csv.map.yaml").write_text(bad)
        with pytest.raises(
            InputError, match=r"x\.csv\.map\.yaml: expected roles and settings, such as 'gyro: omega_\*\[deg/s\]'"
        ):
            open_files(path)


def test_the_unit_of_stamps_is_told_by_those_that_are_there(tmp_path: Path) -> None:
    path = table(tmp_path, rows=6, a=["nan", 1e12 + 10, 1e12 + 20, "nan", 1e12 + 40, 1e12 + 50])
    found = open_files(path, maps=("time=a, gyro=b c d[rad/s], accel=e f g[m/s^2]", "", ""))
    assert found.imu is not None and found.missing == 2
    assert found.origin.ns == 1_000_000_000_000_000_000
    np.testing.assert_allclose(found.imu.t, [0.01, 0.02, 0.04, 0.05], atol=1e-15)
    assert found.assumed[0] == "stamps in ms: the first stamp, 1e+12, is a date in ms"


def test_a_triple_has_one_word_besides_its_axes() -> None:
    names = ["gyrox filtered", "gyroy raw", "gyroy filtered", "gyrox raw", "gyroz filtered", "gyroz raw"]
    found = _triad("gyro", names)
    assert found is not None
    assert [pick.column for pick in found] == ["gyrox filtered", "gyroy filtered", "gyroz filtered"]
