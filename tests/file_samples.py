"""A short emulated drive, and writers that put it into every kind of file that is read.

Every writer returns the path to open (and options), so that the same drive must come back from all of them.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from insemu import earth, rotation
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.formats import programs, write
from insemu.formats.clocks import GPS_EPOCH
from insemu.noise import NoiseModel
from insemu.records import GnssRecord, ImuRecord, Recording, Series, Trajectory

#: Start of the drive on the clocks of the field: a Sunday 10:00 GPS time of week 2300.
SOW, WEEK = 36_000.0, 2300
GPS = WEEK * 604_800.0 + SOW
UNIX = GPS + GPS_EPOCH - 18.0
RATE = 50.0
FLU = np.array([1.0, -1.0, -1.0])


@lru_cache(maxsize=2)
def drive(seconds: float = 60.0, start: float = 0.0) -> Recording:
    """A drive of a car: 50 Hz IMU (means), 2 Hz fixes with velocity, 10 Hz reference; times from ``start``."""
    rng = np.random.default_rng(5)
    ideal = ideal_imu(built_in("urban_drive_1"), RATE, kind="mean", span=(0.0, seconds))
    imu, truth = ideal.imu, ideal.reference
    gyro = imu.gyro + 2e-3 * rng.standard_normal(imu.gyro.shape) + [0.001, -0.002, 0.0015]
    accel = imu.accel + 0.02 * rng.standard_normal(imu.accel.shape) + [0.03, -0.02, 0.05]
    gnss = gnss_fixes(truth, 2.0, (0.3, 0.3, 0.5), (0.05, 0.05, 0.08), rng=rng)
    sparse = slice(None, None, 5)
    return Recording(
        ImuRecord(imu.t + start, gyro, accel, "mean", 25.0 + 0.01 * imu.t),
        GnssRecord(gnss.t + start, gnss.llh, gnss.vel_ned, gnss.pos_std_ned, gnss.vel_std_ned),
        Trajectory(truth.t[sparse] + start, truth.llh[sparse], truth.vel_ned[sparse], truth.rpy[sparse]),
    )


@dataclass(frozen=True)
class Written:
    """What to open, and what must come back: "imu", "gnss", "ref" and the time of the drive's start."""

    path: Path
    holds: frozenset[str]
    start: float = 0.0
    options: tuple[tuple[str, Any], ...] = ()
    tolerance: float = 1e-6


Writer = Callable[[Path], Written]
KINDS: dict[str, Writer] = {}


def kind(name: str) -> Callable[[Writer], Writer]:
    def keep(writer: Writer) -> Writer:
        KINDS[name] = writer
        return writer

    return keep


def _csv(path: Path, header: str, *columns: Any, separator: str = ",", fmt: str = "%.12g") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    block = np.column_stack([np.asarray(c, dtype=float) for c in columns])
    lines = [header] if header else []
    lines += [separator.join(fmt % v for v in row) for row in block]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _lines(path: Path, header: str, rows: list[str]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*([header] if header else []), *rows]) + "\n", encoding="utf-8")
    return path


def _ns(t: Any, start: float) -> list[int]:
    return [round(start) * 10**9 + round(v * 1e9) for v in np.asarray(t)]


def _degrees(llh: Any) -> np.ndarray:
    return np.asarray(llh) * [180 / np.pi, 180 / np.pi, 1.0]


IMU, BOTH, ALL = frozenset({"imu"}), frozenset({"imu", "gnss"}), frozenset({"imu", "gnss", "ref"})


# ------------------------------------------------------------------------------------------------------ our own layouts


@kind("recording .npz")
def own_npz(folder: Path) -> Written:
    return Written(write(folder / "rec.npz", drive()), ALL)


@kind("recording folder")
def own_folder(folder: Path) -> Written:
    return Written(write(folder / "rec", drive()), ALL)


def _series() -> list[Series]:
    imu = drive().imu
    block = np.hstack([imu.gyro, imu.accel])
    names = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    return [Series(block[:, k], RATE, "rad/s" if k < 3 else "m/s^2", n) for k, n in enumerate(names)]


@kind("static log .npz")
def own_log(folder: Path) -> Written:
    return Written(write(folder / "log.npz", _series()), IMU)


@kind("static log .csv.gz")
def own_csv(folder: Path) -> Written:
    return Written(write(folder / "log.csv.gz", _series()), IMU)


@kind("static log .npy")
def own_npy(folder: Path) -> Written:
    np.save(folder / "log.npy", np.column_stack([s.values for s in _series()]))
    return Written(folder / "log.npy", IMU, options=(("rate_hz", RATE),))


# ---------------------------------------------------------------------------------------------------------------- robots


def _bag(folder: Path, version: int, storage: str = "") -> Path:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    data = drive()
    assert data.gnss is not None

    def header(t: float) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](sec=int(UNIX + t), nanosec=round((UNIX + t) % 1.0 * 1e9) % 10**9)
        extra = {"seq": 0} if version == 1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **extra)

    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    messages: list[tuple[str, str, float, Any]] = []
    for t, w, f in zip(data.imu.t, data.imu.gyro * FLU, data.imu.accel * FLU, strict=True):
        m = types["sensor_msgs/msg/Imu"](
            header=header(t), orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0), orientation_covariance=np.zeros(9),
            angular_velocity=vector(*map(float, w)), angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(*map(float, f)), linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip
        messages.append(("/imu/data", "sensor_msgs/msg/Imu", t, m))
    g = data.gnss
    assert g.vel_ned is not None and g.pos_std_ned is not None
    for t, llh, s, v in zip(g.t, _degrees(g.llh), g.pos_std_ned, g.vel_ned, strict=True):
        status = types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        fix = types["sensor_msgs/msg/NavSatFix"](
            header=header(t), status=status, latitude=float(llh[0]), longitude=float(llh[1]), altitude=float(llh[2]),
            position_covariance=np.diag(np.array([s[1], s[0], s[2]]) ** 2).reshape(-1), position_covariance_type=2,
        )  # fmt: skip
        messages.append(("/gnss/fix", "sensor_msgs/msg/NavSatFix", t, fix))
        twist = types["geometry_msgs/msg/Twist"](
            linear=vector(float(v[1]), float(v[0]), float(-v[2])), angular=vector(0.0, 0.0, 0.0)
        )
        stamped = types["geometry_msgs/msg/TwistStamped"](header=header(t), twist=twist)
        messages.append(("/gnss/vel", "geometry_msgs/msg/TwistStamped", t, stamped))
    messages.sort(key=lambda m: m[2])
    if version == 1:
        from rosbags.rosbag1 import Writer as Writer1

        path = folder / "drive.bag"
        with Writer1(path) as bag:
            known = {n: bag.add_connection(n, k, typestore=store) for n, k in {(m[0], m[1]) for m in messages}}
            for topic, typ, t, m in messages:
                bag.write(known[topic], int((UNIX + t) * 1e9), store.serialize_ros1(m, typ))
        return path
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    path = folder / f"drive_{storage}"
    with Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as bag2:
        known2 = {n: bag2.add_connection(n, k, typestore=store) for n, k in {(m[0], m[1]) for m in messages}}
        for topic, typ, t, m in messages:
            bag2.write(known2[topic], int((UNIX + t) * 1e9), store.serialize_cdr(m, typ))
    return path


@kind("ROS 1 bag")
def ros1(folder: Path) -> Written:
    return Written(_bag(folder, 1), BOTH, UNIX)


@kind("ROS 2 bag, SQLite")
def ros2(folder: Path) -> Written:
    return Written(_bag(folder, 2, "sqlite3"), BOTH, UNIX)


@kind("ROS 2 bag, MCAP")
def ros2_mcap(folder: Path) -> Written:
    return Written(_bag(folder, 2, "mcap"), BOTH, UNIX)


@kind("MCAP file")
def mcap(folder: Path) -> Written:
    return Written(next(_bag(folder, 2, "mcap").glob("*.mcap")), BOTH, UNIX)


@kind("ROS CSV (rostopic echo -p)")
def ros_csv(folder: Path) -> Written:
    imu = drive().imu
    head = "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.orientation.x,field.orientation.y,field.orientation.z,"
    head += "field.orientation.w," + ",".join(f"field.angular_velocity.{a}" for a in "xyz") + ","
    head += ",".join(f"field.linear_acceleration.{a}" for a in "xyz")
    rows = [
        ",".join(
            [
                str(n + 2_000_000),
                str(k),
                str(n),
                "imu_link",
                "0.0,0.0,0.0,1.0",
                *(f"{v:.12g}" for v in (*(w * FLU), *(f * FLU))),
            ]
        )
        for k, (n, w, f) in enumerate(zip(_ns(imu.t, UNIX), imu.gyro, imu.accel, strict=True))
    ]
    return Written(_lines(folder / "imu.csv", head, rows), IMU, UNIX)


def _ulog(path: Path, sensor: dict[str, np.ndarray], gps: dict[str, np.ndarray]) -> Path:
    """A minimal ULog file (header, two formats, their subscriptions and data), by the published format."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    out = io.BytesIO()
    out.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
    out.write(message(b"B", bytes(40)))
    formats = (
        "sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
        "vehicle_gps_position:uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt_ellipsoid;float vel_n_m_s;float vel_e_m_s;"
        "float vel_d_m_s;float eph;float epv;float s_variance_m_s;uint8_t fix_type;",
    )
    for text in formats:
        out.write(message(b"F", text.encode()))
    for k, name in enumerate(("sensor_combined", "vehicle_gps_position")):
        out.write(message(b"A", struct.pack("<BH", 0, k) + name.encode()))
    for t, w, f in zip(sensor["t"], sensor["gyro"], sensor["accel"], strict=True):
        out.write(message(b"D", struct.pack("<HQ6f", 0, int(t), *w, *f)))
    for t, llh, v, s, sv in zip(gps["t"], gps["llh"], gps["vel"], gps["std"], gps["vstd"], strict=True):
        place = (round(llh[0] * 1e7), round(llh[1] * 1e7), round(llh[2] * 1e3))
        out.write(message(b"D", struct.pack("<HQ3i6fB", 1, int(t), *place, *v, s[0], s[1], sv, 3)))
    path.write_bytes(out.getvalue())
    return path


def _px4() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    data = drive()
    g = data.gnss
    assert g is not None and g.vel_ned is not None
    sensor = {"t": np.round((data.imu.t + 100.0) * 1e6), "gyro": data.imu.gyro, "accel": data.imu.accel}
    n = len(g)
    gps = {
        "t": np.round((g.t + 100.0) * 1e6), "llh": _degrees(g.llh), "vel": g.vel_ned,
        "std": np.tile([0.42, 0.5], (n, 1)), "vstd": np.full(n, 0.05),
    }  # fmt: skip
    return sensor, gps


@kind("PX4 ULog")
def ulog(folder: Path) -> Written:
    return Written(_ulog(folder / "log.ulg", *_px4()), BOTH, 100.0, tolerance=1e-5)


@kind("PX4 CSV folder")
def px4_csv(folder: Path) -> Written:
    sensor, gps = _px4()
    _csv(
        folder / "px4" / "log_sensor_combined_0.csv",
        "timestamp," + ",".join(f"gyro_rad[{k}]" for k in range(3)) + ",gyro_integral_dt,accelerometer_timestamp_relative,"
        + ",".join(f"accelerometer_m_s2[{k}]" for k in range(3)),
        sensor["t"], sensor["gyro"], np.full(sensor["t"].size, 20000), np.zeros(sensor["t"].size), sensor["accel"],
    )  # fmt: skip
    _csv(
        folder / "px4" / "log_vehicle_gps_position_0.csv",
        "timestamp,lat,lon,alt,alt_ellipsoid,vel_n_m_s,vel_e_m_s,vel_d_m_s,eph,epv,s_variance_m_s,fix_type",
        gps["t"], np.round(gps["llh"][:, 0] * 1e7), np.round(gps["llh"][:, 1] * 1e7), np.zeros(gps["t"].size),
        np.round(gps["llh"][:, 2] * 1e3), gps["vel"], gps["std"], gps["vstd"], np.full(gps["t"].size, 3),
    )  # fmt: skip
    return Written(folder / "px4", BOTH, 100.0, tolerance=1e-5)


@kind("PX4 CSV file")
def px4_file(folder: Path) -> Written:
    px4_csv(folder)
    return Written(folder / "px4" / "log_sensor_combined_0.csv", IMU, 100.0)


def _euroc(root: Path, truth: str) -> Path:
    data = drive()
    ref = data.reference
    assert ref is not None
    stamps = _ns(data.imu.t, UNIX)
    head = (
        "#timestamp [ns],"
        + ",".join(f"w_RS_S_{a} [rad s^-1]" for a in "xyz")
        + ","
        + ",".join(f"a_RS_S_{a} [m s^-2]" for a in "xyz")
    )
    rows = [
        f"{n}," + ",".join(f"{v:.12g}" for v in (*w, *f))
        for n, w, f in zip(stamps, data.imu.gyro, data.imu.accel, strict=True)
    ]
    _lines(root / "mav0" / "imu0" / "data.csv", head, rows)
    ned = _local(ref.llh)
    enu = ned[:, [1, 0, 2]] * [1, 1, -1]
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    q = np.array([rotation.quaternion_from_dcm(swap @ rotation.dcm_from_rpy(r)) for r in ref.rpy])
    velocity = ref.vel_ned[:, [1, 0, 2]] * [1, 1, -1]
    if truth == "state_groundtruth_estimate0":
        head = (
            "#timestamp,"
            + ",".join(f" p_RS_R_{a} [m]" for a in "xyz")
            + ","
            + ",".join(f" q_RS_{a} []" for a in "wxyz")
        )
        head += (
            ","
            + ",".join(f" v_RS_R_{a} [m s^-1]" for a in "xyz")
            + ","
            + ",".join(f" b_w_RS_S_{a} [rad s^-1]" for a in "xyz")
        )
        values = np.column_stack([enu, q, velocity, np.zeros((len(ref), 3))])
    else:
        head = (
            "#timestamp [ns],"
            + ",".join(f" p_RS_R_{a} [m]" for a in "xyz")
            + ","
            + ",".join(f" q_RS_{a} []" for a in "wxyz")
        )
        values = np.column_stack([enu, q])
    rows = [f"{n}," + ",".join(f"{v:.12g}" for v in row) for n, row in zip(_ns(ref.t, UNIX), values, strict=True)]
    _lines(root / "mav0" / truth / "data.csv", head, rows)
    return root


def _local(llh: Any) -> np.ndarray:
    """Positions about their first one, north east down, m."""
    return np.asarray(earth.llh_to_ned(llh, np.asarray(llh)[0]))


def origin() -> str:
    """Setting ``origin`` of the local coordinates above."""
    ref = drive().reference
    assert ref is not None
    return "{:.12g} {:.12g} {:.12g}".format(*_degrees(ref.llh[:1])[0])


@kind("EuRoC folder")
def euroc(folder: Path) -> Written:
    root = _euroc(folder / "MH_01", "state_groundtruth_estimate0")
    return Written(root, frozenset({"imu", "ref"}), UNIX, (("map", f"origin={origin()}"),))


@kind("TUM-VI folder")
def tum_vi(folder: Path) -> Written:
    root = _euroc(folder / "room1", "mocap0")
    return Written(root, frozenset({"imu", "ref"}), UNIX, (("map", f"origin={origin()}"),), tolerance=0.3)


@kind("EuRoC data.csv")
def euroc_file(folder: Path) -> Written:
    return Written(_euroc(folder / "MH_02", "mocap0") / "mav0" / "imu0" / "data.csv", IMU, UNIX)


# ------------------------------------------------------------------------------------------------------- INS/GNSS programs


def _kfgins_imu(path: Path) -> Path:
    imu = drive().imu
    return _csv(path, "", imu.t + SOW, imu.gyro / RATE, imu.accel / RATE, separator=" ", fmt="%.14g")


def _kfgins_pos(path: Path) -> Path:
    g = drive().gnss
    assert g is not None
    return _csv(path, "", g.t + SOW, _degrees(g.llh), g.pos_std_ned, separator=" ", fmt="%.13g")


def _kfgins_nav(path: Path) -> Path:
    ref = drive().reference
    assert ref is not None
    columns = (np.full(len(ref), WEEK), ref.t + SOW, _degrees(ref.llh), ref.vel_ned, np.rad2deg(ref.rpy))
    return _csv(path, "", *columns, separator=" ", fmt="%.13g")


@kind("KF-GINS IMU text")
def kfgins_imu(folder: Path) -> Written:
    return Written(_kfgins_imu(folder / "ADIS16465.txt"), IMU, SOW)


@kind("KF-GINS .pos")
def kfgins_pos(folder: Path) -> Written:
    return Written(_kfgins_pos(folder / "GNSS.pos"), frozenset({"gnss"}), SOW)


@kind("KF-GINS .nav")
def kfgins_nav(folder: Path) -> Written:
    return Written(_kfgins_nav(folder / "truth.nav"), frozenset({"ref"}), SOW)


def _imu_binary(path: Path, form: str, gyro: float, accel: float) -> Path:
    imu = drive().imu
    rows = zip(imu.t + SOW, imu.gyro / (RATE * gyro), imu.accel / (RATE * accel), strict=True)
    number = round if form == "i" else float
    path.write_bytes(b"".join(struct.pack(f"<d6{form}", t, *(number(v) for v in (*g, *a))) for t, g, a in rows))
    return path


@kind("binary .imu, whole numbers")
def imu_binary_int(folder: Path) -> Written:
    path = _imu_binary(folder / "navchip.imu", "i", 6.25e-6, 39.0625e-6)  # half a count: 1.6e-4 rad/s and 1e-3 m/s^2
    return Written(path, IMU, SOW, tolerance=1e-3)


@kind("binary .imu, floats")
def imu_binary_float(folder: Path) -> Written:
    return Written(_imu_binary(folder / "ixsea.imu", "d", np.pi / 180 / 3600, 1e-3), IMU, SOW)


@kind("binary .imu, type said")
def imu_binary_said(folder: Path) -> Written:
    path = _imu_binary(folder / "ln200ig.imu", "i", 1 / 524288, 1 / 16384)
    return Written(path, IMU, SOW, (("map", "imu=LN200IG"),), tolerance=1.6e-3)


@kind("awesome-gins folder")
def awesome_gins(folder: Path) -> Written:
    root = folder / "dataset"
    root.mkdir()
    _kfgins_imu(root / "ADIS16465.txt")
    _kfgins_pos(root / "GNSS_RTK.pos")
    _kfgins_nav(root / "truth.nav")
    (root / "README.txt").write_text("about this data\nnothing more\n")
    return Written(root, ALL, SOW)


@kind("three files, one recording")
def three_files(folder: Path) -> Written:
    options = (
        ("gnss", _rtklib(folder / "fixes.pos", "llh", velocity=True)),
        ("truth", _kfgins_nav(folder / "truth.nav")),
    )
    return Written(_kfgins_imu(folder / "imu.txt"), ALL, SOW, options)


def _rtklib(path: Path, form: str, *, velocity: bool = False, system: str = "GPST") -> Path:
    import pymap3d

    g = drive().gnss
    assert g is not None and g.pos_std_ned is not None and g.vel_ned is not None and g.vel_std_ned is not None
    place, names = (
        _degrees(g.llh),
        "latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m)",
    )
    if form == "ecef":
        place = np.column_stack(pymap3d.geodetic2ecef(*place.T))
        names = "x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   sdy(m)   sdz(m)  sdxy(m)  sdyz(m)  sdzx(m)"
    head = f"% program   : RTKPOST\n% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float)\n%  {system}  {names} age(s)  ratio"
    head += "    vn(m/s)    ve(m/s)    vu(m/s)   sdvn     sdve     sdvu    sdvne    sdveu    sdvun" if velocity else ""
    rows = []
    for k, t in enumerate(g.t):
        seconds = UNIX + 18.0 + t if system == "GPST" else UNIX + t
        when = datetime.fromtimestamp(round(seconds, 3), UTC).strftime("%Y/%m/%d %H:%M:%S.%f")[:-3]
        cells = [f"{v:.9f}" if form == "llh" else f"{v:.4f}" for v in place[k]] + [
            "1",
            "12",
            *(f"{s:.4f}" for s in g.pos_std_ned[k]),
        ]
        cells += ["0.0000"] * 3 + ["1.00", "99.9"]
        if velocity:
            cells += (
                [f"{v:.6f}" for v in g.vel_ned[k] * [1, 1, -1]] + [f"{s:.5f}" for s in g.vel_std_ned[k]] + ["0.0"] * 3
            )
        rows.append(f"{when}  " + "  ".join(cells))
    return _lines(path, head, rows)


@kind("RTKLIB .pos")
def rtklib(folder: Path) -> Written:
    return Written(_rtklib(folder / "a.pos", "llh"), frozenset({"gnss"}), GPS, tolerance=1e-3)


@kind("RTKLIB .pos with velocity, UTC")
def rtklib_velocity(folder: Path) -> Written:
    return Written(
        _rtklib(folder / "a.pos", "llh", velocity=True, system="UTC"), frozenset({"gnss"}), UNIX, tolerance=1e-3
    )


@kind("RTKLIB .pos in ECEF")
def rtklib_ecef(folder: Path) -> Written:
    return Written(_rtklib(folder / "a.pos", "ecef"), frozenset({"gnss"}), GPS, tolerance=1e-3)


@kind("PPC folder")
def ppc(folder: Path) -> Written:
    data = drive()
    ref = data.reference
    assert ref is not None
    head = "GPS TOW (s), GPS Week, Acc X (m/s^2), Acc Y (m/s^2), Acc Z (m/s^2), Ang Rate X (deg/s), Ang Rate Y (deg/s), Ang Rate Z (deg/s)"
    n = len(data.imu)
    _csv(
        folder / "run1" / "imu.csv",
        head,
        data.imu.t + SOW,
        np.full(n, WEEK),
        data.imu.accel,
        np.rad2deg(data.imu.gyro),
        fmt="%.13g",
    )
    head = "GPS TOW (s), GPS Week, Latitude (deg), Longitude (deg), Ellipsoid Height (m), Roll (deg), Pitch (deg), Heading (deg),"
    head += "East Velocity (m/s), North Velocity (m/s), Up Velocity (m/s)"
    columns = (
        ref.t + SOW,
        np.full(len(ref), WEEK),
        _degrees(ref.llh),
        np.rad2deg(ref.rpy),
        ref.vel_ned[:, [1, 0, 2]] * [1, 1, -1],
    )
    _csv(folder / "run1" / "reference.csv", head, *columns, fmt="%.13g")
    return Written(folder / "run1", frozenset({"imu", "ref"}), GPS, tolerance=1e-5)


@kind("gnss-ins-sim folder")
def gnss_ins_sim(folder: Path) -> Written:
    data = drive()
    root, imu, g, ref = folder / "sim", data.imu, data.gnss, data.reference
    assert g is not None and ref is not None
    _csv(root / "time.csv", "time (sec)", imu.t)
    _csv(root / "gyro-0.csv", "gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s)", np.rad2deg(imu.gyro))
    _csv(root / "accel-0.csv", "accel_x (m/s^2),accel_y (m/s^2),accel_z (m/s^2)", imu.accel)
    _csv(root / "gps_time.csv", "gps_time (sec)", g.t)
    head = "gps_lat (deg),gps_lon (deg),gps_alt (m),gps_vN (m/s),gps_vE (m/s),gps_vD (m/s)"
    _csv(root / "gps-0.csv", head, _degrees(g.llh), g.vel_ned)
    rpy = np.column_stack([np.interp(imu.t, ref.t, np.unwrap(ref.rpy[:, k])) for k in range(3)])
    llh = np.column_stack([np.interp(imu.t, ref.t, ref.llh[:, k]) for k in range(3)])
    vel = np.column_stack([np.interp(imu.t, ref.t, ref.vel_ned[:, k]) for k in range(3)])
    _csv(root / "ref_pos.csv", "ref_pos_lat (deg),ref_pos_lon (deg),ref_pos_alt (m)", _degrees(llh))
    _csv(root / "ref_vel.csv", "ref_vel_x (m/s),ref_vel_y (m/s),ref_vel_z (m/s)", vel)
    _csv(root / "ref_att_euler.csv", "ref_Yaw (deg),ref_Pitch (deg),ref_Roll (deg)", np.rad2deg(rpy[:, ::-1]))
    return Written(root, ALL, 0.0)


# ---------------------------------------------------------------------------------------------------------------- receivers


def _over_ground() -> np.ndarray:
    """Speed and course of the drive's fixes, m/s and deg."""
    g = drive().gnss
    assert g is not None and g.vel_ned is not None
    north, east, _ = g.vel_ned.T
    return np.column_stack([np.hypot(north, east), np.rad2deg(np.arctan2(east, north)) % 360.0])


def _nmea(path: Path, *, gst: bool) -> Path:
    g = drive().gnss
    assert g is not None and g.pos_std_ned is not None
    motion = _over_ground() / [1852.0 / 3600.0, 1.0]

    def line(text: str) -> str:
        total = 0
        for c in text:
            total ^= ord(c)
        return f"${text}*{total:02X}"

    def angle(value: float, width: int, letters: str) -> str:
        whole = int(abs(value))
        return f"{whole:0{width}d}{(abs(value) - whole) * 60:010.7f},{letters[int(value < 0)]}"

    rows = []
    for k, t in enumerate(g.t):
        when = datetime.fromtimestamp(round(UNIX + t, 3), UTC)
        clock = when.strftime("%H%M%S.%f")[:-4]
        lat, lon, h = _degrees(g.llh)[k]
        place = f"{angle(lat, 2, 'NS')},{angle(lon, 3, 'EW')}"
        speed, course = motion[k]
        rows.append(line(f"GNRMC,{clock},A,{place},{speed:.4f},{course:.4f},{when:%d%m%y},,,A"))
        rows.append(line(f"GNGGA,{clock},{place},4,12,0.8,{h - 47.3:.4f},M,47.3,M,1.0,0000"))
        if gst:
            n, e, d = g.pos_std_ned[k]
            rows.append(line(f"GNGST,{clock},1.0,,,,{n:.3f},{e:.3f},{d:.3f}"))
    return _lines(path, "", rows)


@kind("NMEA")
def nmea(folder: Path) -> Written:
    return Written(_nmea(folder / "a.nmea", gst=True), frozenset({"gnss"}), UNIX, tolerance=1e-3)


@kind("NMEA without GST")
def nmea_plain(folder: Path) -> Written:
    return Written(_nmea(folder / "a.txt", gst=False), frozenset({"gnss"}), UNIX, tolerance=1e-3)


@kind("u-blox UBX")
def ubx(folder: Path) -> Written:
    from pyubx2 import GET, UBXMessage

    data = drive()
    g = data.gnss
    assert g is not None and g.vel_ned is not None
    out: list[tuple[float, bytes]] = []
    for t, llh, v in zip(g.t, _degrees(g.llh), g.vel_ned, strict=True):
        m = UBXMessage(
            "NAV", "NAV-PVT", GET, iTOW=round((SOW + t) * 1e3), fixType=3, gnssFixOk=1, lat=float(llh[0]), lon=float(llh[1]),
            height=round(llh[2] * 1e3), velN=round(v[0] * 1e3), velE=round(v[1] * 1e3), velD=round(v[2] * 1e3), hAcc=424, vAcc=500, sAcc=50,
        )  # fmt: skip
        out.append((t, m.serialize()))
    for t, w, f in zip(data.imu.t, np.rad2deg(data.imu.gyro), data.imu.accel, strict=True):
        counts = [*(round(v * 4096) for v in w), *(round(v * 1024) for v in f)]
        words = [(c & 0xFFFFFF) | typ << 24 for c, typ in zip(counts, (14, 13, 5, 16, 17, 18), strict=True)]
        payload = struct.pack("<IHH6I", round(t * 1e3), 6 << 11, 0, *words)
        out.append((t + 1e-6, UBXMessage("ESF", "ESF-MEAS", GET, payload=payload).serialize()))
    (folder / "a.ubx").write_bytes(b"".join(b for _, b in sorted(out)))
    return Written(folder / "a.ubx", BOTH, SOW, tolerance=2e-2)


# ------------------------------------------------------------------------------------------------------------------- phones


def _phyphox(root: Path) -> Path:
    data = drive()
    g = data.gnss
    assert g is not None
    _csv(
        root / "Gyroscope.csv",
        '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
        data.imu.t,
        data.imu.gyro,
    )
    head = '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"'
    _csv(root / "Accelerometer.csv", head, data.imu.t, data.imu.accel)
    head = '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)","Direction (°)","Horizontal Accuracy (m)","Vertical Accuracy (°)"'
    llh = _degrees(g.llh)
    n = len(g)
    _csv(
        root / "Location.csv",
        head,
        g.t,
        llh,
        _over_ground(),
        np.full(n, 4.0),
        np.full(n, 6.0),
        fmt="%.13g",
    )
    _csv(root / "meta" / "time.csv", "experiment time,system time", np.arange(2), np.arange(2))
    return root


@kind("phyphox folder")
def phyphox(folder: Path) -> Written:
    return Written(_phyphox(folder / "phyphox"), BOTH)


@kind("phyphox zip")
def phyphox_zip(folder: Path) -> Written:
    root = _phyphox(folder / "phyphox")
    with zipfile.ZipFile(folder / "phyphox.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for p in sorted(root.glob("*.csv")):
            archive.write(p, p.name)
    return Written(folder / "phyphox.zip", BOTH)


@kind("Sensor Logger folder")
def sensor_logger(folder: Path) -> Written:
    data = drive()
    g = data.gnss
    assert g is not None
    root = folder / "logger"
    for name, values in (("TotalAcceleration.csv", data.imu.accel), ("Gyroscope.csv", data.imu.gyro)):
        rows = [
            f"{n},{t:.6f}," + ",".join(f"{v:.12g}" for v in row[::-1])
            for n, t, row in zip(_ns(data.imu.t, UNIX), data.imu.t, values, strict=True)
        ]
        _lines(root / name, "time,seconds_elapsed,z,y,x", rows)
    head = "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,bearing,altitude,longitude,latitude"
    rows = [
        f"{n},{t:.6f},5,0.5,6,4,{speed:.6f},{course:.6f},{p[2]:.6f},{p[1]:.12f},{p[0]:.12f}"
        for n, t, p, (speed, course) in zip(_ns(g.t, UNIX), g.t, _degrees(g.llh), _over_ground(), strict=True)
    ]
    _lines(root / "Location.csv", head, rows)
    return Written(root, BOTH, UNIX)


@kind("Android GnssLogger")
def gnss_logger(folder: Path) -> Written:
    data = drive()
    g = data.gnss
    assert g is not None
    rows = []
    for name, values in (("UncalAccel", data.imu.accel), ("UncalGyro", data.imu.gyro)):
        for t, row in zip(data.imu.t, values, strict=True):
            stamp = round((UNIX + t) * 1e3)
            rows.append(f"{name},{stamp},{round(t * 1e9)}," + ",".join(f"{v:.12g}" for v in row) + ",0.0,0.0,0.0,3")
    for t, p in zip(g.t, _degrees(g.llh), strict=True):
        rows.append(f"Fix,GPS,{p[0]:.12f},{p[1]:.12f},{p[2]:.4f},9.0,4.0,90.0,{round((UNIX + t) * 1e3)},1.0,10.0")
    head = "# \n# Header Description:\n# \n# Version: v3.0\n# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters\n#"
    return Written(_lines(folder / "gnss_log.txt", head, rows), BOTH, UNIX)


# ------------------------------------------------------------------------------------------------------------------ archives


def _arrays() -> dict[str, Any]:
    data = drive()
    g = data.gnss
    assert g is not None
    return {
        "imu": {"time": data.imu.t, "gyro": data.imu.gyro, "accel": data.imu.accel},
        "gnss": {"time": g.t, "lat": _degrees(g.llh)[:, 0], "lon": _degrees(g.llh)[:, 1], "height": g.llh[:, 2]},
    }


@kind("MATLAB v5")
def mat(folder: Path) -> Written:
    from scipy.io import savemat

    savemat(folder / "drive.mat", _arrays())
    return Written(folder / "drive.mat", BOTH)


@kind("MATLAB v7.3")
def mat73(folder: Path) -> Written:
    import h5py

    with h5py.File(folder / "drive.mat", "w", userblock_size=512) as file:
        for group, content in _arrays().items():
            for name, values in content.items():
                file.create_dataset(f"{group}/{name}", data=np.atleast_2d(values) if values.ndim == 1 else values.T)
    return Written(folder / "drive.mat", BOTH)


@kind("HDF5")
def hdf5(folder: Path) -> Written:
    import h5py

    with h5py.File(folder / "drive.h5", "w") as file:
        for group, content in _arrays().items():
            for name, values in content.items():
                file.create_dataset(f"{group}/{name}", data=values)
    return Written(folder / "drive.h5", BOTH)


@kind("foreign .npz")
def foreign_npz(folder: Path) -> Written:
    imu = drive().imu
    np.savez(folder / "own.npz", timestamps=np.round(imu.t * 1e9).astype(np.int64), gyro=imu.gyro, acc=imu.accel)
    return Written(folder / "own.npz", IMU)


# -------------------------------------------------------------------------------------------------------------------- tracks


def _times() -> list[str]:
    g = drive().gnss
    assert g is not None
    return [datetime.fromtimestamp(round(UNIX + t, 3), UTC).isoformat().replace("+00:00", "Z") for t in g.t]


def _points() -> np.ndarray:
    g = drive().gnss
    assert g is not None
    return _degrees(g.llh)


@kind("GPX")
def gpx(folder: Path) -> Written:
    points = "".join(
        f'<trkpt lat="{p[0]:.12f}" lon="{p[1]:.12f}"><ele>{p[2]:.4f}</ele><time>{t}</time></trkpt>'
        for t, p in zip(_times(), _points(), strict=True)
    )
    text = f'<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'
    (folder / "a.gpx").write_text(text)
    return Written(folder / "a.gpx", frozenset({"gnss"}), UNIX, tolerance=1e-3)


@kind("KML")
def kml(folder: Path) -> Written:
    whens = "".join(f"<when>{t}</when>" for t in _times())
    coords = "".join(f"<gx:coord>{p[1]:.12f} {p[0]:.12f} {p[2]:.4f}</gx:coord>" for p in _points())
    space = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    (folder / "a.kml").write_text(
        f'<?xml version="1.0"?><kml {space}><Placemark><gx:Track>{whens}{coords}</gx:Track></Placemark></kml>'
    )
    return Written(folder / "a.kml", frozenset({"gnss"}), UNIX, tolerance=1e-3)


@kind("GeoJSON")
def geojson(folder: Path) -> Written:
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": [[p[1], p[0], p[2]] for p in _points().tolist()]},
        "properties": {"coordTimes": _times()},
    }
    (folder / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return Written(folder / "a.geojson", frozenset({"gnss"}), UNIX, tolerance=1e-3)


@kind("TUM trajectory")
def tum(folder: Path) -> Written:
    ref = drive().reference
    assert ref is not None
    enu = _local(ref.llh)[:, [1, 0, 2]] * [1, 1, -1]
    swap, body = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag(FLU)
    q = np.array([rotation.quaternion_from_dcm(swap @ rotation.dcm_from_rpy(r) @ body) for r in ref.rpy])
    path = _csv(folder / "a.tum", "", ref.t + UNIX, enu, q[:, [1, 2, 3, 0]], separator=" ", fmt="%.16g")
    return Written(path, frozenset({"ref"}), UNIX, (("map", f"origin={origin()}"),), tolerance=0.3)


# ------------------------------------------------------------------------------------------------------------------- any CSV


@kind("any CSV, known names")
def any_csv(folder: Path) -> Written:
    imu = drive().imu
    head = "timestamp_us;gyro_x [deg/s];gyro_y [deg/s];gyro_z [deg/s];acc_x [g];acc_y [g];acc_z [g];temp [degC]"
    columns = (np.round(imu.t * 1e6), np.rad2deg(imu.gyro), imu.accel / 9.80665, imu.temperature)
    return Written(_csv(folder / "a.csv", head, *columns, separator=";"), IMU)


@kind("any CSV with a map")
def mapped_csv(folder: Path) -> Written:
    imu = drive().imu
    path = _csv(
        folder / "a.csv",
        "stamp,om_1,om_2,om_3,s_1,s_2,s_3",
        np.round(imu.t * 1e9),
        np.rad2deg(imu.gyro),
        imu.accel / 9.80665,
        fmt="%.13g",
    )
    return Written(path, IMU, 0.0, (("map", "gyro=om_*[deg/s], accel=s_*[g], time=stamp[ns]"),))


@kind("any CSV with a preset beside it")
def preset_csv(folder: Path) -> Written:
    written = mapped_csv(folder)
    (folder / "a.csv.map.yaml").write_text("gyro: om_*[deg/s]\naccel: s_*[g]\ntime: stamp[ns]\n")
    return Written(written.path, IMU)


@kind("one CSV with IMU and fixes")
def joint_csv(folder: Path) -> Written:
    data = drive()
    g = data.gnss
    assert g is not None
    rows = np.searchsorted(data.imu.t, g.t - 1e-9)
    place = np.full((len(data.imu), 3), np.nan)
    place[rows] = _degrees(g.llh)
    lines = []
    for t, w, f, p in zip(data.imu.t, data.imu.gyro, data.imu.accel, place, strict=True):
        cells = [f"{v:.14g}" for v in (t, *w, *f)] + ["" if np.isnan(v) else f"{v:.14g}" for v in p]
        lines.append(",".join(cells))
    head = "time,wx [rad/s],wy [rad/s],wz [rad/s],fx [m/s^2],fy [m/s^2],fz [m/s^2],latitude [deg],longitude [deg],altitude [m]"
    return Written(_lines(folder / "a.csv", head, lines), BOTH)


@kind("headerless text with a time column")
def headerless(folder: Path) -> Written:
    imu = drive().imu
    return Written(_csv(folder / "a.txt", "", imu.t * 1e9 + 5e9, imu.gyro, imu.accel, separator=" "), IMU, 5.0)


def spell(
    models: Mapping[str, NoiseModel], program: str, *, rate_hz: float, record_s: float = 3600.0
) -> tuple[str, list[str]]:
    """Noise models in another program's words as they are, without a check of their Allan deviation; what was not exact."""
    triads, notes = programs.reduce_models(models, rate_hz, record_s)
    return programs.spelled(program, triads, rate_hz), notes
