"""Small files written by hand: every number of what comes back is known from the text of the file."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insemu.errors import InputError
from insemu.formats import open_files
from insemu.formats.decoding import encoding_of
from insemu.formats.readers import phones, px4, rosbag
from tests.file_samples import KINDS

G = 9.80665
DEG = np.pi / 180.0
KNOT = 1852.0 / 3600.0
#: 2024-01-31 12:00:00 GPS time is week 2299, second 302400; UTC is 18 s behind.
GPS = 2299 * 604_800.0 + 302_400.0
UNIX = GPS + 315_964_800.0 - 18.0


def files(folder: Path, texts: Mapping[str, str | bytes]) -> Path:
    """Write files into a folder; the first one's path."""
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / next(iter(texts))


def same(record: Any, *, began: int, **wanted: Any) -> None:
    """All fields of a record to the last digits, times on the clock of the file, s; those that are not named are absent."""
    for name in ("vel_ned", "pos_std_ned", "vel_std_ned", "temperature"):
        if hasattr(record, name) and name not in wanted:
            assert getattr(record, name) is None, name
    for name, value in wanted.items():
        found = getattr(record, name)
        found = found + began * 1e-9 if name == "t" else found
        if isinstance(value, str):
            assert found == value, name
        else:
            np.testing.assert_allclose(found, value, rtol=1e-12, atol=1e-15, err_msg=name)


def llh(*degrees: tuple[float, float, float]) -> np.ndarray:
    return np.array(degrees) * [DEG, DEG, 1.0]


# ------------------------------------------------------------------------------------------------------------------- rtklib

_POS = "%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"


def test_rtklib_in_weeks_with_velocities_and_standard_deviations(tmp_path: Path) -> None:
    text = f"""% program : x
{_POS}    vn(m/s)    ve(m/s)    vu(m/s)   sdvn   sdve   sdvu   sdvne   sdveu   sdvun
2299 302400.000   46.5 -7.25  400.5 1 9 0.01 0.02 -0.03 0 0 0 0 0  1.5 -2.5 0.25 0.1 0.2 -0.3 0 0 0
2299 302401.500   46.6 -7.35  401.5 2 9 0.04 0.05 0.06 0 0 0 0 0  2.5 -3.5 -0.5 0.4 0.5 0.6 0 0 0
"""
    found = open_files(files(tmp_path, {"a.pos": text}))
    assert found.imu is None and found.reference is None
    same(
        found.gnss,
        began=found.origin.ns,
        t=[GPS, GPS + 1.5],
        llh=llh((46.5, -7.25, 400.5), (46.6, -7.35, 401.5)),
        vel_ned=[[1.5, -2.5, -0.25], [2.5, -3.5, 0.5]],
        pos_std_ned=[[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]],
        vel_std_ned=[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
    )
    assert found.kind == "RTKLIB solution (.pos)"
    assert found.taken == (
        "lat from latitude (deg) of a.pos", "lon from longitude (deg) of a.pos", "height from height (m) of a.pos",
        "pos_std_ned from sdn sde sdu (m) of a.pos", "vel_neu from vn ve vu (m/s) of a.pos",
        "vel_std_ned from sdvn sdve sdvu (m/s) of a.pos", "nothing from Q, ns, sdne, sdeu, sdun, age, ratio, sdvne, sdveu, sdvun of a.pos",
    )  # fmt: skip
    assert found.assumed == found.notes == ()


def test_rtklib_in_utc_as_ecef_with_qualities(tmp_path: Path) -> None:
    """The equator at longitudes 90 and 180 deg and the north pole are on the axes of ECEF; the centre of the Earth is no position."""
    text = """%  UTC  x-ecef(m)  y-ecef(m)  z-ecef(m)  Q  ns
2024/01/31 11:59:42.000  -6378137.0  0  0  4  7
2024/01/31 11:59:42.500  0  0  0  4  7
2024/01/31 11:59:43.250  0  6378237.0  0  5  7
2024/01/31 11:59:44.250  0 0 6356752.314245179  1  7
2024/01/31 11:59:45.250  0 0 6356752.314245179  8  7
"""
    opened = open_files(files(tmp_path, {"a.pos": text}))
    found = opened.gnss
    assert found is not None and opened.origin.ns == UNIX * 1e9
    np.testing.assert_array_equal(found.t, [0.0, 1.25, 2.25, 3.25])
    np.testing.assert_allclose(found.llh[:2], llh((0, 180, 0), (0, 90, 100)), atol=1e-8)
    np.testing.assert_allclose(found.llh[2:, [0, 2]], [[np.pi / 2, 0.0]] * 2, atol=1e-6)
    half = [0.02, 0.5, 5.0, np.nan]
    np.testing.assert_allclose(found.pos_std_ned, np.column_stack([half, half, np.array(half) * 1.5]))


def test_rtklib_as_a_baseline_needs_an_origin(tmp_path: Path) -> None:
    text = """%  GPST  e-baseline(m) n-baseline(m) u-baseline(m)  Q  ns   sde(m)   sdn(m)   sdu(m)
2024/01/31 12:00:00.000  0 0 0 1 9 1 2 3
2024/01/31 12:00:01.000  0 0 5 1 9 1 2 3
2024/01/31 12:00:02.000  111319.49 0 5 1 9 1 2 3
"""
    path = files(tmp_path, {"a.pos": text})
    found = open_files(path, maps=("origin=46.5 7 400", "", ""))
    assert found.gnss is not None and found.assumed == ()
    np.testing.assert_allclose(found.gnss.llh[:2], llh((46.5, 7, 400), (46.5, 7, 405)), rtol=1e-11)
    np.testing.assert_array_equal(found.gnss.pos_std_ned, [[2, 1, 3]] * 3)
    nowhere = open_files(path)
    assert nowhere.gnss is not None and len(nowhere.gnss) == 1  # 0 deg N, 0 deg E is no position of a receiver
    np.testing.assert_allclose(nowhere.gnss.llh[0, 1], math.atan2(111319.49, 6378142.0), rtol=1e-12)
    assert nowhere.assumed == (
        "the local coordinates of a.pos begin at 0 deg N, 0 deg E, 0 m (--map 'origin=48.1 11.5 500' says where)",
    )


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "a.pos: holds no solution"),
        ("2299 302400 46.5 x 1 1 1\n", "a.pos, line 2: found '2299 302400 46.5 x 1 1 1', expected a solution"),
        ("2299\n", "a.pos, line 2: found '2299', expected a solution"),
        ("2299 302400 46.5 7 1 1 9 1\n2299 302401 46.5 7 1\n", "a.pos: solution 2 has 3 numbers, expected 11"),
    ],
)
def test_what_is_no_rtklib_solution_is_refused(tmp_path: Path, rows: str, said: str) -> None:
    head = "%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  age(s)  ratio  x\n".replace(
        "  x", ""
    )
    with pytest.raises(InputError) as caught:
        open_files(files(tmp_path, {"a.pos": head + rows}))
    assert str(caught.value).endswith(said.replace("expected 11", "expected 10"))


# ------------------------------------------------------------------------------------------------------------------ kf-gins


def test_kf_gins(tmp_path: Path) -> None:
    imu = "".join(f"{302400 + 0.005 * k:.3f} 1e-4 -2e-4 {k}e-5 0.001 -0.002 -0.049\n" for k in range(5))
    pos = "302400.0 46.5 7.25 400.5 0.1 0.2 0.3\n302401.0 46.6 7.35 401.5 0.4 0.5 0.6\n"
    pos += "".join(f"30240{k}.0 46.7 7.35 401.5 0.4 0.5 0.6\n" for k in (2, 3))
    nav = "".join(f"2299 {302400 + k}.0 46.5 7.25 {400 + k} 1 2 3 {k} -2 3{k}0\n" for k in range(4))
    path = files(tmp_path, {"a.txt": imu, "a.pos": pos, "a.nav": nav})
    found = open_files(path, gnss=tmp_path / "a.pos", truth=tmp_path / "a.nav")
    same(
        found.imu,
        began=found.origin.ns,
        t=302400 + 0.005 * np.arange(5),
        gyro=[[1e-4, -2e-4, k * 1e-5] for k in range(5)],
        accel=[[0.001, -0.002, -0.049]] * 5,
        kind="increment",
    )
    same(
        found.gnss,
        began=found.origin.ns,
        t=[302400, 302401, 302402, 302403],
        llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 401.5), (46.7, 7.35, 401.5), (46.7, 7.35, 401.5)),
        pos_std_ned=[[0.1, 0.2, 0.3], *[[0.4, 0.5, 0.6]] * 3],
    )
    same(
        found.reference,
        began=found.origin.ns,
        t=[302400, 302401, 302402, 302403],
        llh=llh((46.5, 7.25, 400), (46.5, 7.25, 401), (46.5, 7.25, 402), (46.5, 7.25, 403)),
        vel_ned=[[1, 2, 3]] * 4,
        rpy=np.array([[0, -2, 300], [1, -2, 310], [2, -2, 320], [3, -2, 330]]) * DEG,
    )
    assert found.kind == "KF-GINS / awesome-gins text (.txt, .pos, .nav)"


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("a.txt", {"dvel": "0.001 -0.002 -0.030"}),  # 6 m/s^2
        ("a.txt", {"dvel": "0.001 -0.002 -0.075"}),  # 15 m/s^2
        ("a.txt", {"step": 0.12, "dvel": "0 0 -1.2"}),  # 8 Hz
        ("a.txt", {"first": 604_800.0}),
        ("a.txt", {"first": -1.0}),
        ("a.txt", {"dtheta": "0.6 0 0"}),
        ("a.txt", {"count": 2}),
        ("a.txt", {"step": -0.005}),
        ("a.dat", {}),
    ],
)
def test_what_kf_gins_would_not_write_is_not_taken_for_it(tmp_path: Path, name: str, change: dict[str, Any]) -> None:
    used = {
        "first": 302400.0,
        "step": 0.005,
        "dtheta": "1e-4 2e-4 0",
        "dvel": "0.001 -0.002 -0.049",
        "count": 6,
    } | change
    rows = [
        f"{used['first'] + used['step'] * k:.3f} {used['dtheta']} {used['dvel']}\n" for k in range(int(used["count"]))
    ]
    path = files(tmp_path, {name: "".join(rows)})
    from insemu.formats.table import reader_of

    reader = reader_of(path)
    assert reader is None or "KF-GINS" not in reader.name


# -------------------------------------------------------------------------------------------------------------------- euroc


def test_euroc_with_its_reference(tmp_path: Path) -> None:
    """The sensor of the pose lies forward-right-down as it is; local axes are east-north-up."""
    head = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
    imu = head + "".join(f"{1706702382000000000 + 5_000_000 * k},0.{k},0.2,-0.3,9.5,0.4,-0.5\n" for k in range(4))
    quaternion = Rotation.from_euler("ZYX", [30.0, 20.0, 10.0], degrees=True).as_quat()
    pose = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    pose += "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]\n"
    x, y, z, w = (2.0 * quaternion).tolist()  # of any length
    pose += "".join(
        f"{1706702382000000000 + 10_000_000 * k},0,0,{5 * k},{w!r},{x!r},{y!r},{z!r},1.5,-2.5,{k}\n" for k in range(3)
    )
    files(tmp_path, {"mav0/imu0/data.csv": imu, "mav0/state_groundtruth_estimate0/data.csv": pose})
    found = open_files(tmp_path, maps=("origin=46.5 7 400", "", ""))
    assert found.imu is not None and found.reference is not None
    np.testing.assert_allclose(found.imu.t + (found.origin.ns / 1e9 - UNIX), [0, 0.005, 0.01, 0.015], atol=5e-7)
    np.testing.assert_allclose(found.imu.gyro, [[0.1 * k, 0.2, -0.3] for k in range(4)])
    np.testing.assert_allclose(found.imu.accel, [[9.5, 0.4, -0.5]] * 4)
    assert found.imu.kind == "sample" and found.gnss is None
    np.testing.assert_allclose(found.reference.t + (found.origin.ns / 1e9 - UNIX), [0, 0.01, 0.02], atol=5e-7)
    np.testing.assert_allclose(found.reference.llh, llh((46.5, 7, 400), (46.5, 7, 405), (46.5, 7, 410)), rtol=1e-11)
    np.testing.assert_allclose(found.reference.vel_ned, [[-2.5, 1.5, -k] for k in range(3)])
    turn = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ Rotation.from_quat(quaternion).as_matrix()
    yaw, pitch, roll = Rotation.from_matrix(turn).as_euler("ZYX")
    np.testing.assert_allclose(found.reference.rpy, [[roll, pitch, yaw]] * 3, atol=1e-12)


# -------------------------------------------------------------------------------------------------------------- gnss-ins-sim


def _gnss_ins_sim(**change: str) -> dict[str, str]:
    texts = {
        "time.csv": "time (sec)\n0\n0.01\n0.02\n",
        "gyro-0.csv": "gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s)\n1,2,3\n4,5,6\n7,8,9\n",
        "accel-0.csv": "accel_x (m/s^2),accel_y (m/s^2),accel_z (m/s^2)\n0.1,0.2,-9.8\n0.3,0.4,-9.7\n0.5,0.6,-9.6\n",
        "gps_time.csv": "time (sec)\n0\n0.01\n",
        "gps-0.csv": "lat (deg),lon (deg),alt (m),vx (m/s),vy (m/s),vz (m/s)\n46.5,7,400,1,2,3\n46.6,7.1,401,4,5,6\n",
        "ref_pos.csv": "lat (deg),lon (deg),alt (m)\n46.5,7,400\n46.5,7,401\n46.5,7,402\n",
        "ref_vel.csv": "vx (m/s),vy (m/s),vz (m/s)\n1,2,3\n1,2,3\n1,2,3\n",
        "ref_att_euler.csv": "yaw (deg),pitch (deg),roll (deg)\n30,20,10\n30,20,10\n31,21,11\n",
    }
    return {name: text for name, text in (texts | change).items() if text}


def test_gnss_ins_sim(tmp_path: Path) -> None:
    files(tmp_path, _gnss_ins_sim())
    found = open_files(tmp_path)
    same(
        found.imu,
        began=found.origin.ns,
        t=[0, 0.01, 0.02],
        gyro=np.arange(1, 10).reshape(3, 3) * DEG,
        accel=[[0.1, 0.2, -9.8], [0.3, 0.4, -9.7], [0.5, 0.6, -9.6]],
        kind="sample",
    )
    same(
        found.gnss,
        began=found.origin.ns,
        t=[0, 0.01],
        llh=llh((46.5, 7, 400), (46.6, 7.1, 401)),
        vel_ned=[[1, 2, 3], [4, 5, 6]],
    )
    same(
        found.reference,
        began=found.origin.ns,
        t=[0, 0.01, 0.02],
        llh=llh((46.5, 7, 400), (46.5, 7, 401), (46.5, 7, 402)),
        vel_ned=[[1, 2, 3]] * 3,
        rpy=np.array([[10, 20, 30], [10, 20, 30], [11, 21, 31]]) * DEG,
    )


def test_gnss_ins_sim_in_metres_and_without_fixes(tmp_path: Path) -> None:
    metres = "x (m),y (m),z (m)\n0,0,0\n0,0,-1\n0,0,-2\n"
    files(tmp_path, _gnss_ins_sim(**{"ref_pos.csv": metres, "gps-0.csv": "", "gps_time.csv": ""}))
    found = open_files(tmp_path, maps=("origin=46.5 7 400", "", ""))
    assert found.gnss is None and found.reference is not None
    np.testing.assert_allclose(found.reference.llh, llh((46.5, 7, 400), (46.5, 7, 401), (46.5, 7, 402)), rtol=1e-11)


def test_gnss_ins_sim_leaves_out_fixes_of_zero_and_takes_the_run_that_is_asked_for(tmp_path: Path) -> None:
    texts = _gnss_ins_sim(
        **{"gps-0.csv": "lat (rad),lon (rad),alt (m),vx (m/s),vy (m/s),vz (m/s)\n0,0,0,0,0,0\n0.5,0.25,401,4,5,6\n"}
    )
    texts |= {"gyro-1.csv": texts["gyro-0.csv"].replace("9", "90"), "accel-1.csv": texts["accel-0.csv"]}
    files(tmp_path, texts)
    found = open_files(tmp_path)
    same(found.gnss, began=found.origin.ns, t=[0.01], llh=[[0.5, 0.25, 401]], vel_ned=[[4, 5, 6]])
    other = open_files(tmp_path, maps=("instance=1", "", ""))
    assert found.imu is not None and other.imu is not None
    assert (found.imu.gyro[2, 2], other.imu.gyro[2, 2]) == pytest.approx((9 * DEG, 90 * DEG), rel=1e-15)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "gyro-0.csv",
            "x (deg/s),y (deg/s)\n1,2\n1,2\n1,2\n",
            "gyro-0.csv: has 2 columns, expected 3 as long as time.csv",
        ),
        ("accel-0.csv", "x,y,z\n1,2,3\n1,2,3\n", "accel-0.csv: has 3 columns, expected 3 as long as time.csv"),
        (
            "gps-0.csv",
            "a,b,c,d,e\n1,2,3,4,5\n1,2,3,4,5\n",
            "gps-0.csv: expected latitude, longitude, height and velocity at the times of gps_time.csv",
        ),
        (
            "gps_time.csv",
            "t\n1\n2\n3\n",
            "gps-0.csv: expected latitude, longitude, height and velocity at the times of gps_time.csv",
        ),
        ("ref_vel.csv", "a,b\n1,2\n1,2\n1,2\n", "ref_vel.csv: expected 3 columns as long as time.csv"),
        ("ref_vel.csv", "a,b,c\n1,2,3\n1,2,3\n", "ref_vel.csv: expected 3 columns as long as time.csv"),
    ],
)
def test_gnss_ins_sim_with_wrong_shapes_is_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    files(tmp_path, _gnss_ins_sim(**{name: text}))
    with pytest.raises(InputError) as caught:
        open_files(tmp_path)
    assert str(caught.value).endswith(said)


def test_gnss_ins_sim_without_the_run_that_is_asked_for_is_refused(tmp_path: Path) -> None:
    files(tmp_path, _gnss_ins_sim())
    with pytest.raises(InputError, match=r"has no gyro-1\.csv"):
        open_files(tmp_path, maps=("instance=1", "", ""))


# ---------------------------------------------------------------------------------------------------------------------- ppc


def test_ppc(tmp_path: Path) -> None:
    imu = "GPS TOW (s),GPS Week,Acc X (m/s^2),Acc Y (m/s^2),Acc Z (m/s^2),Ang Rate X (deg/s),Ang Rate Y (deg/s),Ang Rate Z (deg/s)\n"
    imu += "".join(f"{302400 + 0.01 * k:.2f},2299,0.1,0.2,-9.8,{k},2,3\n" for k in range(3))
    head = (
        "GPS TOW (s),GPS Week,Latitude (deg),Longitude (deg),Ellipsoid Height (m),Roll (deg),Pitch (deg),Heading (deg)"
    )
    velocity = ",East Velocity (m/s),North Velocity (m/s),Up Velocity (m/s)"
    rows = [f"{302400 + k},2299,46.5,7,{400 + k},10,20,{30 + k}" for k in range(3)]
    files(
        tmp_path,
        {"imu.csv": imu, "reference.csv": "\n".join([head + velocity, *(r + ",2,1,-3" for r in rows)]) + "\n"},
    )
    found = open_files(tmp_path)
    assert found.imu is not None
    same(
        found.imu,
        began=found.origin.ns,
        t=GPS + 0.01 * np.arange(3),
        gyro=np.array([[k, 2, 3] for k in range(3)]) * DEG,
        accel=[[0.1, 0.2, -9.8]] * 3,
    )
    same(
        found.reference,
        began=found.origin.ns,
        t=GPS + np.arange(3),
        llh=llh((46.5, 7, 400), (46.5, 7, 401), (46.5, 7, 402)),
        vel_ned=[[1, 2, 3]] * 3,
        rpy=np.array([[10, 20, 30], [10, 20, 31], [10, 20, 32]]) * DEG,
    )
    files(tmp_path, {"reference.csv": "\n".join([head, *rows]) + "\n"})
    found = open_files(tmp_path)
    assert found.reference is not None
    np.testing.assert_allclose(
        found.reference.vel_ned, [[0, 0, -1.0]] * 3, atol=1e-8
    )  # heights rise by a metre a second
    assert found.notes == ("velocities of the truth are differences of its positions",)


# ---------------------------------------------------------------------------------------------------------------------- px4


@pytest.mark.parametrize("new", [True, False])
def test_px4_csv(tmp_path: Path, new: bool) -> None:
    imu = "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]\n"
    imu += "".join(f"{1_000_000 + 4000 * k},0.{k},0.2,0.3,0.4,0.5,-9.8\n" for k in range(4))
    place = "latitude_deg,longitude_deg,altitude_msl_m" if new else "lat,lon,alt"
    values = "46.5,-7.25,400.5" if new else "465000000,-72500000,400500"
    head = f"timestamp,{place},vel_n_m_s,vel_e_m_s,vel_d_m_s,eph,epv,s_variance_m_s,fix_type\n"
    rows = [
        f"{1_000_000 + 200_000 * k},{values},1,2,3,{math.sqrt(2)!r},4,0.5,{fix}\n" for k, fix in enumerate((1, 2, 3))
    ]
    files(tmp_path, {"log_sensor_combined_0.csv": imu, "log_vehicle_gps_position_0.csv": head + "".join(rows)})
    found = open_files(tmp_path)
    same(
        found.imu,
        began=found.origin.ns,
        t=1.0 + 0.004 * np.arange(4),
        gyro=[[0.1 * k, 0.2, 0.3] for k in range(4)],
        accel=[[0.4, 0.5, -9.8]] * 4,
        kind="mean",
    )
    same(
        found.gnss,
        began=found.origin.ns,
        t=[1.2, 1.4],
        llh=llh((46.5, -7.25, 400.5), (46.5, -7.25, 400.5)),
        vel_ned=[[1, 2, 3]] * 2,
        pos_std_ned=[[1, 1, 4]] * 2,
        vel_std_ned=[[0.5] * 3] * 2,
    )
    assert found.notes == (("heights are above mean sea level, not above the ellipsoid",) if new else ())
    with pytest.raises(InputError, match="holds neither the columns of sensor_combined nor of a GNSS topic"):
        open_files(files(tmp_path, {"b_sensor_combined_0.csv": "timestamp,a\n1,2\n3,4\n"}))


def test_a_ulog_that_is_read_in_part_says_so(tmp_path: Path) -> None:
    """Where bytes are zero or lacking, the decoder goes on at the next mark that it knows."""
    whole = KINDS["PX4 ULog"](tmp_path).path
    data = whole.read_bytes()
    note = "parts of the file are corrupt and were left out"
    assert open_files(whole).notes == ()
    for at, put in ((0.3, bytes(40)), (0.5, b""), (0.7, bytes(40))):
        k = int(at * len(data))
        found = open_files(files(tmp_path, {"part.ulg": data[:k] + put + data[k + max(len(put), 7) :]}))
        assert note in found.notes and found.imu is not None and len(found.imu) < 3000


# ------------------------------------------------------------------------------------------------------------------- phones


def test_stamps_of_phones_are_dates_in_nanoseconds_or_of_no_clock() -> None:
    assert [phones._clock(np.array(t)) for t in ([1.7e18, 1.8e18], [0.0, 1.0], [9e16], [])] == ["unix", "", "", ""]


def test_phyphox(tmp_path: Path) -> None:
    axes = ("Gyroscope x (rad/s)", "Gyroscope y (rad/s)", "Gyroscope z (rad/s)")
    gyro = "\n".join([f'"Time (s)","{axes[0]}","{axes[1]}","{axes[2]}"', *(f"{0.01 * k},1,2,{k}" for k in range(5))])
    accel = '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"\n'
    accel += "".join(f"{0.02 * k - 0.01},{k},0.5,9.8\n" for k in range(3))
    place = '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)",'
    place += '"Direction (°)","Horizontal Accuracy (m)","Vertical Accuracy (m)"\n'
    place += f"0.0,46.5,7.25,400.5,3,90,{math.sqrt(2)!r},2\n1.0,46.6,7.35,401.5,4,91,{math.sqrt(8)!r},5\n"
    files(tmp_path, {"Gyroscope.csv": gyro + "\n", "Accelerometer.csv": accel, "Location.csv": place})
    found = open_files(tmp_path)
    # the accelerometer has stamps of its own: from -0.01 to 0.03 s, one more each 0.02 s
    same(
        found.imu,
        began=found.origin.ns,
        t=[0, 0.01, 0.02, 0.03],
        gyro=[[1, 2, k] for k in range(4)],
        accel=[[0.5, 0.5, 9.8], [1.0, 0.5, 9.8], [1.5, 0.5, 9.8], [2.0, 0.5, 9.8]],
        kind="sample",
    )
    same(
        found.gnss,
        began=found.origin.ns,
        t=[0.0, 1.0],
        llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 401.5)),
        pos_std_ned=[[1, 1, 2], [2, 2, 5]],
        vel_ned=[[v * math.cos(DEG * c), v * math.sin(DEG * c), np.nan] for v, c in ((3, 90), (4, 91))],
    )
    assert found.notes == ("the accelerometer has stamps of its own; it was interpolated to the gyroscope's",)


def test_sensor_logger_adds_gravity(tmp_path: Path) -> None:
    start = 1_706_702_382_000_000_000
    head = "time,seconds_elapsed,z,y,x\n"
    rows = {
        "Gyroscope.csv": [(k, 3, 2, 1) for k in range(4)],
        "Accelerometer.csv": [(k, 0.3, 0.2, 0.1) for k in range(4)],
        "Gravity.csv": [(3 * k, -9 - k, 0.5, 0.25) for k in range(2)],
    }
    texts = {
        name: head + "".join(f"{start + 10_000_000 * k},{0.01 * k},{z},{y},{x}\n" for k, z, y, x in lines)
        for name, lines in rows.items()
    }
    files(tmp_path, texts)
    found = open_files(tmp_path)
    assert found.imu is not None
    np.testing.assert_allclose(found.imu.t + (found.origin.ns / 1e9 - UNIX), [0, 0.01, 0.02, 0.03], atol=5e-7)
    np.testing.assert_allclose(found.imu.gyro, [[1, 2, 3]] * 4)
    np.testing.assert_allclose(found.imu.accel, [[0.35, 0.7, -8.7 - k / 3] for k in range(4)], rtol=2e-6)
    assert found.notes == ("gravity was added to the acceleration without it (Gravity.csv)",)
    (tmp_path / "TotalAcceleration.csv").write_text(texts["Accelerometer.csv"])
    total = open_files(tmp_path)
    assert total.imu is not None and total.notes == ()
    np.testing.assert_allclose(total.imu.accel, [[0.1, 0.2, 0.3]] * 4)


def test_gnss_logger(tmp_path: Path) -> None:
    start = 1_706_702_382_000
    lines = ["# Header", "#"]
    for k in range(4):
        lines.append(f"UncalGyro,{start + 10 * k},0,1,2,{k},0,0,0")
        lines.append(f"UncalAccel,{start + 10 * k},0,0.1,0.2,9.{k},0,0,0")
    lines += [
        f"Fix,GPS,46.5,7.25,400.5,1.5,{math.sqrt(2)!r},90,{start},x",
        f"Fix,FLP,46.6,7.35,,1.5,,90,{start + 1000},x",
        f"Fix,NLP,46.6,7.35,1,1.5,,90,{start + 2000},x",
        f"UncalGyro,{start},0",
    ]
    found = open_files(files(tmp_path, {"gnss_log.txt": "\n".join(lines) + "\n"}))
    assert found.imu is not None and found.gnss is not None and found.gnss.pos_std_ned is not None
    np.testing.assert_allclose(found.imu.t + (found.origin.ns / 1e9 - UNIX), [0, 0.01, 0.02, 0.03], atol=5e-7)
    np.testing.assert_allclose(found.imu.gyro, [[1, 2, k] for k in range(4)])
    np.testing.assert_allclose(found.imu.accel, [[0.1, 0.2, 9 + k / 10] for k in range(4)])
    np.testing.assert_allclose(found.gnss.t + (found.origin.ns / 1e9 - UNIX), [0], atol=5e-7)
    np.testing.assert_allclose(found.gnss.llh, llh((46.5, 7.25, 400.5)))
    np.testing.assert_allclose(found.gnss.pos_std_ned, [[1, 1, 1.5 * np.sqrt(2)]])
    assert found.notes == ("fixes: 1 of 2 rows hold no position; they were left out",)
    with pytest.raises(InputError, match="holds neither UncalGyro, UncalAccel nor Fix lines"):
        open_files(files(tmp_path, {"empty.txt": "# x\nFix,Provider\n"}))


# --------------------------------------------------------------------------------------------------------------------- nmea


def _nmea(*bodies: str) -> str:
    out = []
    for body in bodies:
        check = 0
        for letter in body:
            check ^= ord(letter)
        out.append(f"${body}*{check:02X}\r\n")
    return "".join(out)


def test_nmea_with_dates_and_standard_deviations(tmp_path: Path) -> None:
    text = _nmea(
        "GPRMC,115942.00,A,4630.00000,N,00715.00000,W,10.0,30.0,310124,,,A",
        "GPGGA,115942.00,4630.00000,N,00715.00000,W,4,12,0.8,350.5,M,50.0,M,,",
        "GPGST,115942.00,1.0,0.1,0.1,0.0,0.1,0.2,0.3",
        "GPGGA,115943.50,4636.00000,S,00721.00000,E,5,12,0.8,351.5,M,50.0,M,,",
        "GPGGA,115944.50,,,,,0,0,,,M,,M,,",
    )
    found = open_files(files(tmp_path, {"a.nmea": text + "$GPGGA,115945.50,broken*00\r\n"}))
    same(
        found.gnss,
        began=found.origin.ns,
        t=[UNIX, UNIX + 1.5],
        llh=llh((46.5, -7.25, 400.5), (-46.6, 7.35, 401.5)),
        pos_std_ned=[[0.1, 0.2, 0.3], [np.nan] * 3],
        vel_ned=[[KNOT * 10 * math.cos(30 * DEG), KNOT * 10 * math.sin(30 * DEG), np.nan], [np.nan] * 3],
    )
    assert found.notes == ("1 line(s) are no NMEA sentence or fail their checksum",)
    plain = open_files(files(tmp_path, {"b.nmea": text.replace(text.split("\r\n")[2] + "\r\n", "")}))
    assert plain.gnss is not None and plain.notes == ()
    np.testing.assert_allclose(plain.gnss.pos_std_ned, [[0.02, 0.02, 0.03], [0.5, 0.5, 0.75]])
    assert plain.assumed == ("standard deviations from the quality of each fix: single 5 m, float 0.5 m, fixed 0.02 m",)


def test_nmea_without_rmc_has_its_speed_from_vtg(tmp_path: Path) -> None:
    clocks = ("115942.00", "115943.00")
    text = _nmea(
        *(
            body
            for k, clock in enumerate(clocks)
            for body in (
                f"GPGGA,{clock},4630.0000{k},N,00715.00000,E,4,12,0.8,350.5,M,50.0,M,,",
                f"GPVTG,{90 * k}.0,T,,M,1{k}.0,N,,K,A",
            )
        )
    )
    found = open_files(files(tmp_path, {"a.nmea": text}))
    assert found.gnss is not None and found.gnss.vel_ned is not None
    np.testing.assert_allclose(found.gnss.vel_ned[:, :2], [[10 * KNOT, 0], [0, 11 * KNOT]], atol=1e-12)
    assert "VTG sentences state no time: speed and course are of the GGA before them" in found.assumed


def test_nmea_without_dates_over_midnight(tmp_path: Path) -> None:
    text = _nmea(
        *(
            f"GPGGA,{clock},4630.00000,N,00715.0000{k},E,1,12,0.8,350.5,M,50.0,M,,"
            for k, clock in enumerate(("235958.00", "235959.00", "000000.00", "000001.00"))
        )
    )
    found = open_files(files(tmp_path, {"a.nmea": text}))
    assert found.gnss is not None
    np.testing.assert_allclose(found.origin.ns / 1e9 + found.gnss.t, [86398, 86399, 86400, 86401])
    assert found.notes == ("no sentence has a date: times are seconds of the day (UTC)",)
    with pytest.raises(InputError, match="holds no GGA sentence with a position"):
        open_files(files(tmp_path, {"b.nmea": _nmea(*["GPGGA,115944.50,,,,,0,0,,,M,,M,,"] * 2)}))


# ---------------------------------------------------------------------------------------------------------------------- ubx


def _ubx(kind: int, number: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", kind, number, len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) % 256
        b = (b + a) % 256
    return b"\xb5\x62" + body + bytes([a, b])


def _pvt(itow: int, fix: int = 3, flags: int = 1) -> bytes:
    """NAV-PVT, 92 bytes (u-blox F9 interface description)."""
    out = bytearray(92)
    struct.pack_into("<I", out, 0, itow)
    out[20], out[21] = fix, flags
    struct.pack_into("<iiii", out, 24, 72_500_000, 465_000_000, 400_500, 350_000)
    struct.pack_into("<II", out, 40, 1000, 2000)
    struct.pack_into("<iii", out, 48, 1500, -2500, 250)
    struct.pack_into("<I", out, 68, 100)
    return _ubx(0x01, 0x07, bytes(out))


def _counts(k: int) -> list[tuple[int, int]]:
    return [(14, 4096 + k), (13, -2048), (5, 1024), (16, 512), (17, -256), (18, -10240)]


@pytest.mark.parametrize("form", ["ESF-RAW", "ESF-MEAS"])
def test_ubx(tmp_path: Path, form: str) -> None:
    """Counts of 2^-12 deg/s and 2^-10 m/s^2; the IMU's clock is told by the fix that came before."""
    data = b""
    for k in range(4):
        data += _pvt(302_400_000 + 1000 * k, fix=2 + k % 2)  # in two dimensions, in three
        words = [(kind << 24) | (count & 0xFFFFFF) for kind, count in _counts(k)]
        tag = 5000 + 1000 * k
        if form == "ESF-RAW":
            data += _ubx(0x10, 0x03, bytes(4) + b"".join(struct.pack("<II", w, tag) for w in words))
        else:
            flags = len(words) << 11
            data += _ubx(0x10, 0x02, struct.pack("<IHH", tag, flags, 0) + b"".join(struct.pack("<I", w) for w in words))
    data += _pvt(302_405_000, fix=1) + _pvt(302_406_000, flags=0)
    found = open_files(files(tmp_path, {"a.ubx": data}))
    same(
        found.imu,
        began=found.origin.ns,
        t=302_400.0 + np.arange(4),
        gyro=np.array([[1 + k / 4096, -0.5, 0.25] for k in range(4)]) * DEG,
        accel=[[0.5, -0.25, -10.0]] * 4,
    )
    same(
        found.gnss,
        began=found.origin.ns,
        t=302_400.0 + np.arange(4),
        llh=llh(*[(46.5, 7.25, 400.5)] * 4),
        vel_ned=[[1.5, -2.5, 0.25]] * 4,
        pos_std_ned=[[np.sqrt(0.5), np.sqrt(0.5), 2.0]] * 4,
        vel_std_ned=[[0.1] * 3] * 4,
    )
    assert found.assumed == (
        "the IMU's own clock is 302395.000 s behind GPS time, from the order in which messages arrived",
    )
    alone = b"".join(
        _ubx(
            0x10,
            0x03,
            bytes(4) + b"".join(struct.pack("<II", (a << 24) | (c & 0xFFFFFF), 10 * k) for a, c in _counts(k)),
        )
        for k in range(3)
    )
    imu = open_files(files(tmp_path, {"b.ubx": alone})).imu
    assert imu is not None
    np.testing.assert_allclose(imu.t, [0, 0.01, 0.02])
    with pytest.raises(InputError, match="holds neither NAV-PVT nor ESF-RAW or ESF-MEAS messages"):
        open_files(files(tmp_path, {"c.ubx": _pvt(1000, fix=1)}))


# ------------------------------------------------------------------------------------------------------------------- tracks


def test_gpx(tmp_path: Path) -> None:
    points = '<trkpt lat="46.5" lon="7.25"><ele>400.5</ele><time>2024-01-31T11:59:42Z</time></trkpt>'
    points += '<rtept lat="46.6" lon="7.35"><time>2024-01-31T13:59:43.5+02:00</time></rtept>'
    points += '<wpt lat="46.7" lon="7.45"><ele>402</ele><time>2024-01-31T11:59:45</time></wpt><wpt lat="46.7"></wpt>'
    text = f'<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1">{points}</gpx>'
    found = open_files(files(tmp_path, {"a.gpx": text}))
    same(
        found.gnss,
        began=found.origin.ns,
        t=UNIX + np.array([0, 1.5, 3.0]),
        llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 0.0), (46.7, 7.45, 402.0)),
    )
    empty = files(tmp_path, {"b.gpx": "<gpx></gpx>"})
    with pytest.raises(InputError, match="holds no positions"):
        open_files(empty)


def test_kml(tmp_path: Path) -> None:
    whens = "".join(f"<when>2024-01-31T11:59:4{k}Z</when>" for k in (2, 3))
    coords = "<gx:coord>7.25 46.5 400.5</gx:coord><gx:coord>7.35 46.6</gx:coord>"
    text = f'<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><gx:Track>{{}}{coords}</gx:Track></kml>'
    found = open_files(files(tmp_path, {"a.kml": text.format(whens)}))
    same(found.gnss, began=found.origin.ns, t=[UNIX, UNIX + 1], llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 0.0)))
    with pytest.raises(InputError, match=r"has positions without times: a scenario flies them as waypoints"):
        open_files(files(tmp_path, {"b.kml": text.format("")}))
    same(
        open_files(tmp_path / "b.kml", maps=("rate=2 Hz", "", "")).gnss,
        began=0,
        t=[0, 0.5],
        llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 0.0)),
    )
    with pytest.raises(InputError, match="has 3 times for 2 positions"):
        open_files(files(tmp_path, {"c.kml": text.format(whens + whens[:33])}))
    line = "<kml><coordinates>7.25,46.5,400.5 7.35,46.6</coordinates></kml>"
    same(
        open_files(files(tmp_path, {"d.kml": line}), maps=("rate=2 Hz", "", "")).gnss,
        began=0,
        t=[0, 0.5],
        llh=llh((46.5, 7.25, 400.5), (46.6, 7.35, 0.0)),
    )


def test_tum_trajectories(tmp_path: Path) -> None:
    """Body axes forward-left-up over east-north-up: turned by nothing, the nose points east."""
    x, y, z, w = Rotation.from_euler("ZYX", [90.0, 0.0, 10.0], degrees=True).as_quat().tolist()
    rows = ["# timestamp tx ty tz qx qy qz qw", "100.0 0 0 0 0 0 0 1", f"100.5 0 0 2 {x!r} {y!r} {z!r} {w!r}"]
    path = files(tmp_path, {"a.tum": "\n".join([*rows, "101 0 0 4 0 0 0 1"]) + "\n"})
    imu = files(
        tmp_path, {"i.csv": "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{100 + k / 4},1,2,3,4,5,6\n" for k in range(4))}
    )
    found = open_files(imu, truth=path, maps=("", "", "origin=46.5 7 400")).reference
    assert found is not None
    np.testing.assert_array_equal(found.t, [0, 0.5, 1])
    np.testing.assert_allclose(found.llh, llh((46.5, 7, 400), (46.5, 7, 402), (46.5, 7, 404)), rtol=1e-11)
    np.testing.assert_allclose(found.vel_ned, [[0, 0, -4]] * 3, atol=1e-8)
    np.testing.assert_allclose(found.rpy, np.array([[0, 0, 90], [10, 0, 0], [0, 0, 90]]) * DEG, atol=1e-9)


# ------------------------------------------------------------------------------------------------------------------- binary


@pytest.mark.parametrize(
    ("kind", "gyro", "accel"),
    [  # sizes of one count as Balamuta et al. (2016, appendix B) list them
        ("IMAR", 0.1 / 3600 * DEG, 1.52588e-6), ("LN200", 2.0**-21, 2.0**-14), ("LN200IG", 2.0**-19, 2.0**-14),
        ("IXSEA", DEG / 3600, 1e-3), ("NAVCHIP_INT", 6.25e-6, 3.90625e-5), ("NAVCHIP_FLT", DEG / 3600, 1e-3),
    ],
)  # fmt: skip
def test_binary_records(tmp_path: Path, kind: str, gyro: float, accel: float) -> None:
    letter = "d" if kind in ("IXSEA", "NAVCHIP_FLT") else "i"
    counts = [[3 * k, -2, 5, 10, -20, -round(0.01 * G / accel)] for k in range(6)]
    data = b"".join(struct.pack(f"<d6{letter}", 302400 + 0.01 * k, *row) for k, row in enumerate(counts))
    path = files(tmp_path, {"a.imu": data + b"xyz"})
    found = open_files(path, maps=(f"imu={kind.lower()}", "", ""))
    values = np.array(counts, dtype=float)
    same(
        found.imu,
        began=found.origin.ns,
        t=302400 + 0.01 * np.arange(6),
        gyro=values[:, :3] * gyro,
        accel=values[:, 3:] * accel,
        kind="increment",
    )
    assert found.notes == (f"3 bytes at the end are no whole record of {kind}",)
    assert found.assumed == ()
    (guess,) = [a for a in open_files(path).assumed if a.startswith("type")]
    said = {
        "IMAR": "type IMAR, which", "LN200": "type LN200, which", "LN200IG": "type LN200, which",
        "IXSEA": "type IXSEA or NAVCHIP_FLT, which", "NAVCHIP_INT": "type NAVCHIP_INT, which",
        "NAVCHIP_FLT": "type IXSEA or NAVCHIP_FLT, which",
    }[kind]  # fmt: skip
    assert guess.startswith(said)
    assert guess.endswith("; LN200IG fits, too") == kind.startswith("LN200")


def test_binary_records_that_fit_nothing_are_refused(tmp_path: Path) -> None:
    heavy = b"".join(struct.pack("<d6i", 0.01 * k, 1, 2, 3, 0, 0, 2**30) for k in range(6))
    with pytest.raises(InputError, match="fits no type under gravity; say it with --map imu=TYPE, one of: IMAR, LN200"):
        open_files(files(tmp_path, {"a.imu": heavy}))
    with pytest.raises(InputError, match=r"unknown type of IMU 'LN20' \(did you mean 'LN200'"):
        open_files(tmp_path / "a.imu", maps=("imu=LN20", "", ""))
    with pytest.raises(InputError, match=r"holds 1 records of LN200 \(32 bytes each\), expected at least 2"):
        open_files(files(tmp_path, {"b.imu": heavy[:40]}), maps=("imu=LN200", "", ""))


# -------------------------------------------------------------------------------------------------------------------- bags


def _bag(
    folder: Path,
    fixes: list[tuple[float, int]],
    twists: list[tuple[float, float]],
    *,
    names: tuple[str, ...] = ("imu",),
    ros: int = 2,
    more: str = "",
) -> Path:
    """Six IMU rows at 100 Hz, fixes of (time, status) and twists of (time, velocity east)."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE if ros == 2 else Stores.ROS1_NOETIC)
    kinds = store.types

    def header(t: float, name: str) -> Any:
        stamp = kinds["builtin_interfaces/msg/Time"](sec=1000 + int(t), nanosec=round(t % 1 * 1e9))
        return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=name, **({"seq": 0} if ros == 1 else {}))

    vector, turn = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
    held: list[tuple[str, str, Any]] = []
    for k in range(6):
        held.append((
            "/imu", "sensor_msgs/msg/Imu",
            kinds["sensor_msgs/msg/Imu"](
                header=header(0.01 * k, names[k % len(names)]), orientation=turn(x=0.5, y=0.5, z=0.5, w=0.5),
                orientation_covariance=np.arange(9.0), angular_velocity=vector(0.1 * k, 0.2, 0.3),
                angular_velocity_covariance=np.arange(9.0) + 9, linear_acceleration=vector(0.4, 0.5, 9.8),
                linear_acceleration_covariance=np.arange(9.0) + 18,
            ),
        ))  # fmt: skip
    for k, (t, status) in enumerate(fixes):
        held.append((
            "/gnss/fix", "sensor_msgs/msg/NavSatFix",
            kinds["sensor_msgs/msg/NavSatFix"](
                header=header(t, "gnss"), status=kinds["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
                latitude=46.5, longitude=7.25, altitude=400.0 + k,
                position_covariance=np.array([4.0, 0, 0, 0, 9.0, 0, 0, 0, 16.0]), position_covariance_type=k % 2,
            ),
        ))  # fmt: skip
    for t, east in twists:
        twist = kinds["geometry_msgs/msg/Twist"](linear=vector(east, 2.0, 3.0), angular=vector(7.0, 8.0, 9.0))
        stamped = kinds["geometry_msgs/msg/TwistStamped"](header=header(t, "gnss"), twist=twist)
        held.append(("/gnss/vel", "geometry_msgs/msg/TwistStamped", stamped))
        if more:
            held.append((more, "geometry_msgs/msg/TwistStamped", stamped))
    if ros == 2:
        from rosbags.rosbag2 import StoragePlugin, Writer

        path, writer = folder / "bag", Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    else:
        from rosbags.rosbag1 import Writer as Writer1

        path, writer = folder / "a.bag", Writer1(folder / "a.bag")  # type: ignore[assignment]
    with writer as bag:
        known = {n: bag.add_connection(n, kind, typestore=store) for n, kind in {h[:2] for h in held}}
        for k, (topic, kind, message) in enumerate(held):
            raw = store.serialize_cdr(message, kind) if ros == 2 else store.serialize_ros1(message, kind)
            bag.write(known[topic], k + 1, raw)
    return path


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("names", [("imu",), ("a", "much longer name")])
def test_bags(tmp_path: Path, ros: int, names: tuple[str, ...]) -> None:
    """Messages of one length and of several; fixes without status or covariance; the twist nearest to a fix within 20 ms."""
    fixes = [(0.0, 0), (1.0, 2), (2.0, -1), (3.0, 0), (4.0, 0), (5.0, 1)]
    # each fix has one twist before and one behind it: at the fix, before is nearer, behind is nearer, both too far
    twists = [
        (0.0, 10.0),
        (0.99, 20.0),
        (1.015, 21.0),
        (2.0, 30.0),
        (2.985, 40.0),
        (3.004, 41.0),
        (3.95, 50.0),
        (4.021, 51.0),
        (4.992, 60.0),
    ]
    found = open_files(_bag(tmp_path, fixes, twists[::-1], names=names, ros=ros))
    same(
        found.imu,
        began=found.origin.ns,
        t=1000 + 0.01 * np.arange(6),
        gyro=[[0.1 * k, -0.2, -0.3] for k in range(6)],
        accel=[[0.4, -0.5, -9.8]] * 6,
        kind="sample",
    )
    gone = [np.nan] * 3
    same(
        found.gnss,
        began=found.origin.ns,
        t=[1000, 1001, 1003, 1004, 1005],
        llh=llh(*[(46.5, 7.25, h) for h in (400, 401, 403, 404, 405)]),
        vel_ned=[[2, 10, -3], [2, 20, -3], [2, 41, -3], gone, [2, 60, -3]],
        pos_std_ned=[gone, [3, 2, 4], [3, 2, 4], gone, [3, 2, 4]],
    )
    assert found.assumed == ("axes of /imu are forward-left-up (REP 103): --map 'axes=FRD' says otherwise",)


def test_of_several_twists_none_is_taken(tmp_path: Path) -> None:
    found = open_files(_bag(tmp_path, [(0.0, 0), (1.0, 0)], [(0.0, 1.0), (1.0, 1.0)], more="/gnss/filtered"))
    assert found.gnss is not None and found.gnss.vel_ned is None
    (tmp_path / "b").mkdir()
    apart = open_files(_bag(tmp_path / "b", [(0.0, 0), (1.0, 0)], [(0.0, 1.0), (1.0, 1.0)], more="/odometer"))
    assert apart.gnss is not None and apart.gnss.vel_ned is not None


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("topic=/imu/x", "has no topic '/imu/x' (did you mean '/imu'?)"),
        ("gnss_topic=/gnss/fx", "has no topic '/gnss/fx' (did you mean '/gnss/fix'?)"),
    ],
)
def test_topics_that_are_not_there_are_refused(tmp_path: Path, line: str, said: str) -> None:
    path = _bag(tmp_path, [(0.0, 0), (1.0, 0)], [])
    with pytest.raises(InputError) as caught:
        open_files(path, maps=(line, "", ""))
    assert str(caught.value).endswith(said)
    turned = open_files(path, maps=("axes=FRD", "", ""))
    assert turned.imu is not None and turned.imu.accel[0].tolist() == [0.4, 0.5, 9.8] and turned.assumed == ()


def test_a_latitude_alone_is_no_position(tmp_path: Path) -> None:
    rows = [f"{0.01 * k:.2f},0,0,0.1,0,0,-9.8,46.5" for k in range(200)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,gx,gy,gz,ax,ay,az,lat", *rows]) + "\n", encoding="utf-8")
    found = open_files(path)
    assert found.gnss is None and found.imu is not None


def test_a_topic_of_one_message_is_read() -> None:
    stamp = SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=1_764_400_000, nanosec=5_000_001)))
    topic = SimpleNamespace(topic="/imu", msgtype="Imu", id=1)
    storage = SimpleNamespace(connections=[topic], messages=lambda connections: [(c, 0, b"raw") for c in connections])
    bag = SimpleNamespace(is2=True, readers=[storage], connections=[topic], deserialize=lambda raw, kind: stamp)
    t, rows = rosbag._block(bag, "/imu", lambda message: [1.0, 2.0])
    assert t.tolist() == [1_764_400_000_005_000_001] and rows.tolist() == [[1.0, 2.0]]
    topic.topic = "/other"
    storage.messages = lambda connections: []
    with pytest.raises(InputError, match="holds no message"):
        rosbag._block(bag, "/other", lambda message: [])


def test_a_topic_of_px4_has_both_sensors() -> None:
    gyro, accel = [f"gyro_rad[{k}]" for k in range(3)], [f"accelerometer_m_s2[{k}]" for k in range(3)]
    assert px4._imu_map(["timestamp", *gyro]) is None and px4._imu_map(["timestamp", *accel]) is None
    found = px4._imu_map(["timestamp", *gyro, *accel])
    assert found is not None and {"time", "gyro", "accel"} <= set(found.picks)


@pytest.mark.parametrize(
    ("controls", "length", "encoding"), [(1, 60, "cp1252"), (2, 60, None), (3, 2500, "cp1252"), (4, 2500, None)]
)
def test_text_of_another_encoding_has_few_control_characters(controls: int, length: int, encoding: str | None) -> None:
    head = b"\xe9" + b"\x01" * controls
    assert encoding_of(head + b"a" * (length - len(head))) == encoding
