"""What is written for other programs, letter by letter, of tracks and models small enough to work out by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.formats import Fitted, Way, hand_on, read_curves, way_of, write_overlay, write_way
from insemu.formats.programs import reduce_models
from insemu.noise import GM, RC, RW, WN, NoiseModel
from insemu.records import GnssRecord, Trajectory
from tests.file_samples import spell

DEG = np.pi / 180.0
#: 2024-01-31 11:59:42 UTC is second 302400 of GPS week 2299.
UNIX = 1_706_702_382.0
LLH = np.array([[46.5, 7.25, 400.5], [46.5, 7.25, 401.5], [46.5, -7.25, 402.5], [46.5, 7.25, 403.5]]) * [DEG, DEG, 1.0]


def _way(**more: Any) -> Way:
    return Way(UNIX + np.array([0.0, 0.5, 1.0, 1.25]), LLH, **more)


def _written(folder: Path, name: str, way: Way) -> list[str]:
    return write_way(way, folder / name).read_text().splitlines()


def test_gpx(tmp_path: Path) -> None:
    lines = _written(tmp_path, "a.gpx", _way(name="a < b"))
    assert lines[:2] == [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="insemu" xmlns="http://www.topografix.com/GPX/1/1"><trk><name>a &lt; b</name><trkseg>',
    ]
    assert lines[2:] == [
        '<trkpt lat="46.5000000000" lon="7.2500000000"><ele>400.5000</ele><time>2024-01-31T11:59:42Z</time></trkpt>',
        '<trkpt lat="46.5000000000" lon="7.2500000000"><ele>401.5000</ele><time>2024-01-31T11:59:42.500000Z</time></trkpt>',
        '<trkpt lat="46.5000000000" lon="-7.2500000000"><ele>402.5000</ele><time>2024-01-31T11:59:43Z</time></trkpt>',
        '<trkpt lat="46.5000000000" lon="7.2500000000"><ele>403.5000</ele><time>2024-01-31T11:59:43.250000Z</time></trkpt>',
        "</trkseg></trk></gpx>",
    ]


def test_kml_draws_outages_from_their_first_to_their_last_epoch(tmp_path: Path) -> None:
    text = "".join(_written(tmp_path, "a.kml", _way(outages=[(UNIX + 0.5, UNIX + 1.0), (UNIX + 1.1, UNIX + 9.0)])))
    places = [
        "7.2500000000,46.5000000000,401.5000 -7.2500000000,46.5000000000,402.5000",
        "7.2500000000,46.5000000000,403.5000",
    ]
    for k, where in enumerate(places, start=1):
        assert (
            f"<name>outage {k}</name><styleUrl>#outage</styleUrl><LineString><altitudeMode>absolute</altitudeMode><coordinates>{where}</coordinates>"
            in text
        )
    assert text.count("<when>") == text.count("<gx:coord>") == 4 and text.count("<Placemark>") == 3
    assert (
        "<when>2024-01-31T11:59:42.500000Z</when>" in text
        and "<gx:coord>-7.2500000000 46.5000000000 402.5000</gx:coord>" in text
    )
    assert '<Style id="way"><LineStyle><color>ffff7f00</color><width>3</width></LineStyle></Style>' in text
    assert '<Style id="outage"><LineStyle><color>ff0000ff</color><width>6</width></LineStyle></Style>' in text


def test_rtklib(tmp_path: Path) -> None:
    velocity, sigma = np.tile([1.0, -2.0, 3.0], (4, 1)), np.tile([0.1, 0.2, 0.3], (4, 1))
    lines = _written(tmp_path, "a.pos", _way(velocity=velocity, sigma=sigma))
    assert lines[0] == "% program   : insemu" and lines[2].endswith("age(s)  ratio    vn(m/s)    ve(m/s)    vu(m/s)")
    tail = "6  0  0.1000  0.2000  0.3000  0.0  0.0  0.0  0.0  0.0  1.00000  -2.00000  -3.00000"
    assert lines[3] == f"2299  302400.000000  46.50000000000  7.25000000000  400.5000  {tail}"
    assert lines[5] == f"2299  302401.000000  46.50000000000  -7.25000000000  402.5000  {tail}"
    plain = _written(tmp_path, "b.pos", _way())
    assert plain[2].endswith("age(s)  ratio") and plain[3].endswith("6  0  nan  nan  nan  0.0  0.0  0.0  0.0  0.0")
    late = Way(UNIX + 302_400.0 + np.array([-0.5, 0.5]), LLH[:2])  # the week ends in between
    assert [line.split()[:2] for line in _written(tmp_path, "c.pos", late)[3:]] == [
        ["2299", "604799.500000"],
        ["2300", "0.500000"],
    ]


def test_csv(tmp_path: Path) -> None:
    block = np.tile([1.0, -2.0, 3.0], (4, 1))
    lines = _written(tmp_path, "a.csv", _way(velocity=block, rpy=block * DEG, sigma=0.5 * block))
    assert lines[0] == (
        "t [s],lat [deg],lon [deg],h [m],vn [m/s],ve [m/s],vd [m/s],roll [deg],pitch [deg],heading [deg],pos_std_n [m],pos_std_e [m],pos_std_d [m]"
    )
    row = [float(v) for v in lines[3].split(",")]
    np.testing.assert_allclose(row, [UNIX + 1, 46.5, -7.25, 402.5, 1, -2, 3, 1, -2, 3, 0.5, -1, 1.5], rtol=1e-15)
    assert _written(tmp_path, "b.csv", _way())[0] == "t [s],lat [deg],lon [deg],h [m]"


def test_tum_is_about_the_first_position(tmp_path: Path) -> None:
    """Level and heading north, the axes forward-left-up are turned by 90 deg about up from east-north-up."""
    t = np.arange(3.0)
    llh = np.array([[46.5, 7.25, 400.0], [46.5, 7.25, 402.0], [46.50001, 7.25002, 400.0]]) * [DEG, DEG, 1]
    rpy = np.array([[0, 0, 0], [0, 0, 90], [10, 0, 0]]) * DEG
    lines = _written(tmp_path, "a.tum", Way(t, llh, rpy=rpy, sigma=np.tile([1.0, 2.0, 3.0], (3, 1))))
    assert lines[0] == "# timestamp tx ty tz qx qy qz qw; origin=46.5 7.25 400"
    rows = np.array([[float(v) for v in line.split()] for line in lines[1:]])
    np.testing.assert_allclose(rows[:, 0], t)
    np.testing.assert_allclose(rows[:2, 1:4], [[0, 0, 0], [0, 0, 2]], atol=1e-8)
    np.testing.assert_allclose(
        rows[2, 1:3], [1.5348, 1.1117], atol=1e-3
    )  # 0.00002 deg east and 0.00001 deg north at 46.5 deg
    root = math.sqrt(0.5)
    turned = rows[:, 4:] * np.sign(rows[:, 7:])
    np.testing.assert_allclose(turned[:2], [[0, 0, root, root], [0, 0, 0, 1]], atol=1e-9)
    half = 5.0 * DEG  # a roll to the right is a positive turn about forward
    np.testing.assert_allclose(
        turned[2], root * np.array([math.sin(half), math.sin(half), math.cos(half), math.cos(half)]), atol=1e-9
    )
    spread = (tmp_path / "a.cov.csv").read_text().splitlines()
    assert spread == ["t [s],cov_ee [m^2],cov_nn [m^2],cov_uu [m^2]", *(f"{k}.0,4.0,1.0,9.0" for k in range(3))]


def test_overlays(tmp_path: Path) -> None:
    sigma = np.tile([1.0, 2.0, 3.0], (4, 1))
    outages = [(UNIX + 0.5, UNIX + 1.25), (UNIX + 1.2, UNIX + 3.0)]
    ways = [_way(name="truth"), _way(name="a & b", sigma=sigma, outages=outages), _way(outages=outages)]
    text = write_overlay(ways, tmp_path / "a.kml").read_text()
    assert text.count("<Folder>") == 3 and "<name>a &amp; b</name>" in text
    for k, bgr in enumerate(("FFFFFF", "B27200", "005ED5")):
        for name, width in (("way", 2), ("outage", 5)):
            style = f'<Style id="{name}{k}"><LineStyle><color>ff{bgr}</color><width>{width}</width></LineStyle>'
            style += f"<PolyStyle><color>40{bgr}</color></PolyStyle></Style>"
            assert style in text
    # the second outage has one epoch: no line and no ellipse
    assert text.count("<name>outage 1</name>") == 2 and "outage 2" not in text
    assert text.count("3 sigma at its end") == 1 and "<styleUrl>#way1</styleUrl><Polygon>" in text
    ring = text.split("<LinearRing><coordinates>")[1].split("<")[0].split()
    assert len(ring) == 49
    corners = np.array([[float(v) for v in place.split(",")] for place in ring])
    np.testing.assert_allclose(corners[0], corners[-1], atol=1e-9)
    north = (corners[:, 1] - 46.5) * DEG * 6_371_500.0
    east = (corners[:, 0] - 7.25) * DEG * 6_389_000.0 * math.cos(46.5 * DEG)
    angle = np.linspace(0, 2 * np.pi, 49)
    np.testing.assert_allclose(north, 3.0 * np.cos(angle), atol=0.02)
    np.testing.assert_allclose(east, 6.0 * np.sin(angle), atol=0.02)
    np.testing.assert_allclose(corners[:, 2], 403.5, atol=1e-3)
    with pytest.raises(InputError, match=r"cannot write '\.txt' overlays, expected \.kml"):
        write_overlay(ways, tmp_path / "a.txt")


def test_ways_of_records() -> None:
    llh = LLH.copy()
    llh[1, 1] = np.nan
    std = np.tile([1.0, 2.0, 3.0], (4, 1))
    way = way_of(GnssRecord(np.arange(4.0), llh, 2 * std, std), "x", [(1.0, 2.0)])
    np.testing.assert_array_equal(way.t, [0, 2, 3])
    assert way.velocity is not None and way.sigma is not None and way.rpy is None
    np.testing.assert_array_equal(way.velocity, 2 * std[:3])
    assert (len(way.sigma), way.name, way.outages) == (3, "x", [(1.0, 2.0)])
    way = way_of(Trajectory(np.arange(4.0), LLH, std, 0.1 * std), "y")
    assert way.rpy is not None and way.velocity is not None and way.sigma is None and way.outages == ()


@pytest.mark.parametrize(
    ("name", "way", "said"),
    [
        ("a.xyz", _way(), "a.xyz: cannot write '.xyz' tracks, expected .tum, .txt, .kml, .gpx, .pos, .csv"),
        ("a.tum", _way(), "a.tum: has no attitude, which a TUM trajectory needs"),
        ("a.gpx", Way(np.array([1e8]), LLH[:1]), "a.gpx: times begin at 1e+08 s, expected seconds since 1970 (UTC)"),
        (
            "a.pos",
            Way(np.array([4.2e9]), LLH[:1]),
            "a.pos: times begin at 4.2e+09 s, expected seconds since 1970 (UTC)",
        ),
    ],
)
def test_what_cannot_be_written_is_said(tmp_path: Path, name: str, way: Way, said: str) -> None:
    with pytest.raises(InputError) as caught:
        write_way(way, tmp_path / name)
    assert str(caught.value).endswith(said)


# ------------------------------------------------------------------------------------------------------------------ programs

#: N 2e-4 and 4e-4; a Markov process is a walk of density sigma sqrt(2 / Tc) over short times.
GYRO = WN(N=2e-4) + GM(sigma=3e-4, beta=1 / 50.0) + RC(sigma=0.01)
ACCEL = WN(N=4e-3) + RW(K=5e-5)
WALK = 3e-4 * math.sqrt(2 / 50.0)


def test_the_models_of_a_triad_are_one_white_noise_and_one_slow_process() -> None:
    triads, notes = reduce_models({"gyro": GYRO, "accel": ACCEL}, 1000.0, 3600.0)
    g, a = triads["gyro"], triads["accel"]
    np.testing.assert_allclose([g.white, g.walk, g.time, g.sigma, g.turn_on], [2e-4, WALK, 50.0, 3e-4, 0.01], rtol=1e-4)
    np.testing.assert_allclose([a.white, a.walk, a.time, a.sigma], [4e-3, 5e-5, 1e6, 5e-5 * math.sqrt(5e5)], rtol=1e-6)
    assert a.turn_on == 0.0 and notes == []
    # axes are combined by their mean squares, times by their geometric mean
    axes = {
        "gyro_x": WN(N=3e-4) + GM(sigma=1e-4, beta=1 / 10.0),
        "gyro_y": WN(N=4e-4) + GM(sigma=1e-4, beta=1 / 40.0),
        "gyro_z": NoiseModel((WN(N=5e-4),)),
    }
    found, _ = reduce_models(axes, 1000.0, 3600.0)
    np.testing.assert_allclose(found["gyro"].white, math.sqrt(50 / 3) * 1e-4, rtol=1e-4)
    np.testing.assert_allclose(found["gyro"].time, 20.0, rtol=1e-6)
    np.testing.assert_allclose(found["gyro"].walk, 1e-4 * math.sqrt((2 / 10 + 2 / 40) / 3), rtol=1e-3)


def test_what_programs_cannot_say_is_said() -> None:
    _, notes = reduce_models({"gyro": WN(N=1e-4) + RC(sigma=1.0)}, 100.0, 3600.0)
    assert notes == ["gyro: no slow process; written is the largest walk that 3600 s of its white noise would hide"]
    _, notes = reduce_models(
        {"accel": NoiseModel.parse("WN(N=1e-4) + GM(sigma=1, Tc=5 s) + RW(K=1) + BI(B=1) + QN(Q=1)", "")}, 100.0, 3600.0
    )
    assert notes == [
        "accel: BI, QN enter by what they resemble over a second",
        "accel: several slow processes become one with the same short-time walk",
    ]
    for rate, record in ((0.0, 1.0), (1.0, 0.0)):
        with pytest.raises(InputError, match="expected positive numbers"):
            reduce_models({"gyro": GYRO}, rate, record)
    with pytest.raises(InputError, match="holds no axis of a gyroscope or an accelerometer"):
        reduce_models({"mag": GYRO}, 1.0, 1.0)
    with pytest.raises(InputError, match=r"unknown program 'kalbr' \(did you mean 'kalibr'\?\)"):
        hand_on({"gyro": Fitted(GYRO)}, "kalbr", rate_hz=1.0)


@pytest.mark.parametrize(
    ("program", "sensor", "lines"),
    [
        ("kalibr", "gyro", ["gyroscope_noise_density: {white}", "gyroscope_random_walk: {walk}", "update_rate: 400", 'rostopic: "/imu0"']),
        ("kalibr", "accel", ["accelerometer_noise_density: {white}", "accelerometer_random_walk: {walk}", "update_rate: 400", 'rostopic: "/imu0"']),
        ("vins-fusion", "gyro", ["gyr_n: {white*20}", "gyr_w: {walk*20}"]),
        ("vins-fusion", "accel", ["acc_n: {white*20}", "acc_w: {walk*20}"]),
        ("rotors", "gyro", ["<gyroscopeNoiseDensity>{white}</gyroscopeNoiseDensity>", "<gyroscopeRandomWalk>{walk}</gyroscopeRandomWalk>",
                            "<gyroscopeBiasCorrelationTime>{time}</gyroscopeBiasCorrelationTime>",
                            "<gyroscopeTurnOnBiasSigma>{turn_on}</gyroscopeTurnOnBiasSigma>"]),
        ("kf-gins", "gyro", ["imunoise:", "  arw: [{w}, {w}, {w}]  # deg/sqrt(h)", "  gbstd: [{s}, {s}, {s}]  # deg/h",
                             "  gsstd: [0.0, 0.0, 0.0]  # ppm, not known from a record at rest",
                             "  asstd: [0.0, 0.0, 0.0]  # ppm, likewise", "  corrtime: {time/3600}  # h"]),
        ("kf-gins", "accel", ["imunoise:", "  vrw: [{w}, {w}, {w}]  # m/s/sqrt(h)", "  abstd: [{s}, {s}, {s}]  # mGal",
                              "  gsstd: [0.0, 0.0, 0.0]  # ppm, not known from a record at rest",
                              "  asstd: [0.0, 0.0, 0.0]  # ppm, likewise", "  corrtime: {time/3600}  # h"]),
        ("gtsam", "gyro", ["import numpy as np", "", "", "def set_noise(params):",
                           "    params.setGyroscopeCovariance({white**2} * np.eye(3))",
                           "    params.setBiasOmegaCovariance({walk**2} * np.eye(3))"]),
        ("matlab", "accel", ['imu = imuSensor("accel-gyro", "SampleRate", 400);',
                             'imu.Accelerometer = accelparams("NoiseType", "double-sided", "NoiseDensity", {white}, "RandomWalk", {walk});']),
        ("gnss-ins-sim", "gyro", ["import numpy as np", "", "imu_err = {{", '    "gyro_b": np.zeros(3),',
                                  '    "gyro_arw": np.full(3, {w}),  # deg/sqrt(h)',
                                  '    "gyro_b_stability": np.full(3, {s}),  # deg/h', '    "gyro_b_corr": np.full(3, {time}),  # s', "}}"]),
    ],
)  # fmt: skip
def test_programs_get_their_own_words(program: str, sensor: str, lines: list[str]) -> None:
    model = GYRO if sensor == "gyro" else ACCEL
    (one,) = reduce_models({sensor: model}, 400.0, 3600.0)[0].values()
    text, _ = spell({sensor: model}, program, rate_hz=400.0)
    # density of white noise per sqrt(Hz) over sqrt(s) is 60 times that per sqrt(h); 1 rad/s is 206265 deg/h and 1 m/s^2 is 1e5 mGal
    values = {
        "white": one.white, "white*20": 20 * one.white, "white**2": one.white**2, "walk": one.walk, "walk*20": 20 * one.walk,
        "walk**2": one.walk**2, "time": one.time, "time/3600": one.time / 3600, "turn_on": one.turn_on,
        "w": one.white * 60 * (180 / math.pi if sensor == "gyro" else 1),
        "s": one.sigma * (3600 * 180 / math.pi if sensor == "gyro" else 1e5),
    }  # fmt: skip
    wanted = []
    for line in lines:
        for key, value in values.items():
            line = line.replace("{" + key + "}", f"{value:.9g}")
        wanted.append(line.replace("{{", "{").replace("}}", "}"))
    assert text.splitlines()[1:] == wanted


def test_both_sensors_stand_in_the_programs_order() -> None:
    models = {"gyro": GYRO, "accel": ACCEL}
    order = {
        "kalibr": ("accelerometer_noise", "gyroscope_noise"),
        "vins-fusion": ("acc_n", "gyr_n"),
        "gtsam": ("setAccelerometer", "setGyroscope"),
    }
    for program, (first, second) in order.items():
        text, _ = spell(models, program, rate_hz=1.0)
        assert 0 < text.index(first) < text.index(second)
    # one correlation time for both sensors: the gyroscope's; the accelerometer keeps its walk
    text, _ = spell(models, "kf-gins", rate_hz=400.0)
    assert text.splitlines()[-1] == f"  corrtime: {50 / 3600:.9g}  # h"
    spread = 5e-5 * math.sqrt(50 / 2.0) * 1e5
    assert f"  abstd: [{spread:.9g}, {spread:.9g}, {spread:.9g}]  # mGal" in text
    gazebo, _ = spell(models, "gazebo", rate_hz=400.0)
    assert gazebo.splitlines()[1:5] == [
        "<update_rate>400</update_rate>",
        "<imu>",
        "  <angular_velocity>",
        gazebo.splitlines()[4],
    ]
    noise = f'<noise type="gaussian"><mean>0</mean><stddev>{4e-3 * 20:.9g}</stddev><bias_mean>0</bias_mean><bias_stddev>0</bias_stddev>'
    noise += "<dynamic_bias_stddev>5e-05</dynamic_bias_stddev><dynamic_bias_correlation_time>1000000</dynamic_bias_correlation_time></noise>"
    assert [f"    <{a}>{noise}</{a}>" for a in "xyz"] == gazebo.splitlines()[9:12] and gazebo.splitlines()[
        -1
    ] == "</imu>"


# -------------------------------------------------------------------------------------------------------------------- curves


def test_curves_of_both_layouts(tmp_path: Path) -> None:
    own = {"axes": {"gyro_x": {"wavelet_variance": {"tau_s": [1, 2], "value": [3, 4]}},
                    "accel_z": {"wavelet_variance": {"tau_s": [1], "value": [5]}},
                    "mag": {"wavelet_variance": {"tau_s": [1], "value": [6]}}, "gz": 3,
                    "gy": {"wavelet_variance": {"tau_s": [1], "value": [1, 2]}}}}  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps(own))
    found = read_curves(tmp_path / "a.json")
    assert [(c.label, c.is_gyro, c.tau_s.tolist(), c.value.tolist()) for c in found] == [
        ("a gyro_x", True, [1, 2], [3, 4]), ("a accel_z", False, [1], [5]), ("a mag", None, [1], [6]),
    ]  # fmt: skip
    other = {
        "IMU": {"freq": [50], "wvar": {"Gyr. X": {"variance": [1, 2, 3]}, "Az": {"variance": [4]}}},
        "none": 3,
        "also none": {"wvar": 3},
    }
    (tmp_path / "b.json").write_text(json.dumps(other))
    found = read_curves(tmp_path / "b.json")
    assert [(c.label, c.is_gyro, c.tau_s.tolist(), c.value.tolist()) for c in found] == [
        ("IMU Gyr. X", True, [0.04, 0.08, 0.16], [1, 2, 3]), ("IMU Az", False, [0.04], [4]),
    ]  # fmt: skip
    for text, said in (
        ("{", "is not JSON"),
        ("{}", "holds no wavelet variance curve"),
        ("[1]", "holds no wavelet variance curve"),
    ):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(InputError, match=said):
            read_curves(tmp_path / "c.json")
