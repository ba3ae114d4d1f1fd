"""Exports read back: the target's documented formula is simulated with what was written, and refitting gives the model again."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.signal import lfilter

from insemu import earth, noise, units
from insemu.cli import main
from insemu.errors import InputError
from insemu.fit import fit
from insemu.formats import IMU_BINARIES, Fitted, hand_on, open_files, utc_of, write, write_imu_binary
from insemu.formats.programs import PROGRAMS, reduce_models
from insemu.formats.readers import imu_binary
from insemu.formats.tracks_out import way_of, write_way
from insemu.noise import GM, RC, RW, WN, NoiseModel
from insemu.records import ImuRecord, Recording, Series
from tests.file_samples import UNIX, drive, spell

RATE, SECONDS = 20.0, 6000.0
DT = 1.0 / RATE
SLOW = WN(N=2e-4) + GM(sigma=3e-4, beta=1 / 40.0)
WALK = WN(N=2e-4) + RW(K=4e-5)
COUNT = int(SECONDS * RATE)


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def _number(text: str, key: str) -> float:
    found = re.search(rf"{key}\"?[^0-9.+-]*([0-9.]+(?:e[+-]?[0-9]+)?)", text)
    assert found is not None, (key, text)
    return float(found[1])


def _walk(step: float, rng: np.random.Generator) -> np.ndarray:
    return np.cumsum(step * rng.standard_normal(COUNT))


def _bias(phi: float, sigma: float, rng: np.random.Generator) -> np.ndarray:
    start = sigma / np.sqrt(1 - phi**2) * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -phi], sigma * rng.standard_normal(COUNT), zi=[phi * start])[0])


def _kalibr(text: str, rng: np.random.Generator) -> np.ndarray:
    white = _number(text, "gyroscope_noise_density") / np.sqrt(DT) * rng.standard_normal(COUNT)
    return white + _walk(_number(text, "gyroscope_random_walk") * np.sqrt(DT), rng)


def _vins(text: str, rng: np.random.Generator) -> np.ndarray:
    return _number(text, "gyr_n") * rng.standard_normal(COUNT) + _walk(_number(text, "gyr_w") * DT, rng)


def _gtsam(text: str, rng: np.random.Generator) -> np.ndarray:
    white = np.sqrt(_number(text, "setGyroscopeCovariance") / DT) * rng.standard_normal(COUNT)
    return white + _walk(np.sqrt(_number(text, "setBiasOmegaCovariance") * DT), rng)


def _matlab(text: str, rng: np.random.Generator) -> np.ndarray:
    line = next(line for line in text.splitlines() if "gyroparams" in line)
    white = _number(line, "NoiseDensity") * np.sqrt(RATE) * rng.standard_normal(COUNT)
    return white + _walk(_number(line, "RandomWalk") / np.sqrt(RATE), rng)


def _dynamic(walk: float, time: float, rng: np.random.Generator) -> np.ndarray:
    """The dynamic bias of gz-sensors and of RotorS."""
    return _bias(float(np.exp(-DT / time)), float(np.sqrt(-(walk**2) * time / 2 * np.expm1(-2 * DT / time))), rng)


def _gazebo(text: str, rng: np.random.Generator) -> np.ndarray:
    part = text.split("<angular_velocity>")[1]
    white = _number(part, "<stddev>") * rng.standard_normal(COUNT)
    return white + _dynamic(
        _number(part, "<dynamic_bias_stddev>"), _number(part, "<dynamic_bias_correlation_time>"), rng
    )


def _rotors(text: str, rng: np.random.Generator) -> np.ndarray:
    white = _number(text, "gyroscopeNoiseDensity") / np.sqrt(DT) * rng.standard_normal(COUNT)
    return white + _dynamic(_number(text, "gyroscopeRandomWalk"), _number(text, "gyroscopeBiasCorrelationTime"), rng)


def _kfgins(text: str, rng: np.random.Generator) -> np.ndarray:
    white = (
        units.parse(f"{_number(text, 'arw')} deg/sqrt(h)", "rad/s/sqrt(Hz)") / np.sqrt(DT) * rng.standard_normal(COUNT)
    )
    std, time = units.parse(f"{_number(text, 'gbstd')} deg/h", "rad/s"), 3600.0 * _number(text, "corrtime:")
    return white + _dynamic(std * np.sqrt(2 / time), time, rng)


def _gnss_ins_sim(text: str, rng: np.random.Generator) -> np.ndarray:
    white = (
        units.parse(f"{_number(text, 'gyro_arw.: np.full.3,')} deg/sqrt(h)", "rad/s/sqrt(Hz)")
        / np.sqrt(DT)
        * rng.standard_normal(COUNT)
    )
    std = units.parse(f"{_number(text, 'gyro_b_stability.: np.full.3,')} deg/h", "rad/s")
    time = _number(text, "gyro_b_corr.: np.full.3,")
    return white + _bias(1 - DT / time, std * float(np.sqrt(1 - np.exp(-2 * DT / time))), rng)


SIMULATED: dict[str, tuple[NoiseModel, str, Callable[[str, np.random.Generator], np.ndarray]]] = {
    "kalibr": (WALK, "WN()+RW()", _kalibr),
    "vins-fusion": (WALK, "WN()+RW()", _vins),
    "gtsam": (WALK, "WN()+RW()", _gtsam),
    "matlab": (WALK, "WN()+RW()", _matlab),
    "gazebo": (SLOW, "WN()+GM()", _gazebo),
    "rotors": (SLOW, "WN()+GM()", _rotors),
    "kf-gins": (SLOW, "WN()+GM()", _kfgins),
    "gnss-ins-sim": (SLOW, "WN()+GM()", _gnss_ins_sim),
}


@pytest.mark.parametrize("program", SIMULATED)
def test_what_is_exported_simulates_the_model(program: str) -> None:
    model, structure, simulate = SIMULATED[program]
    text, notes = spell({"gyro_x": model, "accel_x": model}, program, rate_hz=RATE, record_s=SECONDS)
    assert not notes
    signal = simulate(text, np.random.default_rng(8))
    found = fit(Series(signal, RATE, "rad/s", "gyro_x"), structure, "gmwm")
    wanted = {f"{p.symbol}.{k}": v for p in model for k, v in p.parameters.items()}
    for e in found.parameters:
        true = wanted[f"{e.process}.{e.name}"]
        # three parameters of eight programs: 4 standard errors are passed by chance once in 600 such tests
        assert abs(e.value - true) < 4 * e.standard_error, (e.label, e.value, true, e.standard_error)


def test_programs_that_share_a_format_share_it() -> None:
    models = {"gyro": SLOW}
    assert set(SIMULATED) | {"openvins", "px4"} == set(PROGRAMS)
    for one, other in (("kalibr", "openvins"), ("rotors", "px4")):
        assert spell(models, one, rate_hz=1.0) == spell(models, other, rate_hz=1.0)


def test_a_walk_that_was_not_found_is_no_zero() -> None:
    text, notes = spell({"accel": WN(N=1e-3) + RC(sigma=0.1)}, "kalibr", rate_hz=100.0, record_s=3600.0)
    assert _number(text, "accelerometer_random_walk") == pytest.approx(np.sqrt(3) * 1e-3 / 3600, rel=1e-6)
    assert "no slow process" in notes[0]
    assert reduce_models({"accel": WN(N=1e-3) + RC(sigma=0.1)}, 100.0, 1.0)[0]["accel"].turn_on == 0.1


@pytest.mark.parametrize(
    ("models", "program", "said"),
    [
        ({"gyro": SLOW}, "kalib", "did you mean 'kalibr'"),
        ({"temperature": SLOW}, "kalibr", "no axis"),
        ({"gyro": NoiseModel.parse("GM(sigma=1, beta=1, follows=speed, slope=1)")}, "kalibr", "follows speed"),
    ],
)
def test_bad_exports_are_refused(models: dict[str, NoiseModel], program: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        hand_on({axis: Fitted(m) for axis, m in models.items()}, program, rate_hz=100.0)


def test_models_are_exported_by_the_command(tmp_path: Path) -> None:
    noise.save({"gyro_x": SLOW}, tmp_path / "m.yaml")
    assert run("export", tmp_path / "m.yaml", "--to", "gazebo", "--rate", "200 Hz", "-o", tmp_path / "imu.sdf") == 0
    assert "<dynamic_bias_stddev>" in (tmp_path / "imu.sdf").read_text()
    assert run("export", tmp_path / "m.yaml", "-o", tmp_path / "x") == 2


# --------------------------------------------------------------------------------------------------------------------- tracks


@pytest.mark.parametrize("suffix", [".kml", ".gpx", ".pos", ".csv"])
def test_tracks_of_fixes_are_read_back(suffix: str, tmp_path: Path) -> None:
    data = drive(60.0, UNIX)
    assert data.gnss is not None
    path = write_way(way_of(data.gnss, "a & b", [(UNIX + 10, UNIX + 20)]), tmp_path / f"a{suffix}")
    opened = open_files(path)
    found, zero = opened.gnss, utc_of(opened.origin)
    assert found is not None and zero is not None  # an RTKLIB solution is in GPS time
    np.testing.assert_allclose(zero - UNIX + found.t, data.gnss.t - UNIX, atol=1e-6)
    assert np.abs(earth.position_difference(found.llh, data.gnss.llh)).max() < 1e-3
    if suffix in (".pos", ".csv"):
        np.testing.assert_allclose(found.vel_ned, data.gnss.vel_ned, atol=1e-4)  # type: ignore[arg-type]
        np.testing.assert_allclose(found.pos_std_ned, data.gnss.pos_std_ned, atol=1e-4)  # type: ignore[arg-type]
    if suffix == ".kml":
        assert path.read_text().count("#outage") == 1 and "a &amp; b" in path.read_text()


def test_a_tum_trajectory_is_read_back_by_its_origin(tmp_path: Path) -> None:
    data = drive(60.0, UNIX)
    assert data.reference is not None
    path = write_way(way_of(data.reference, "a"), tmp_path / "a.tum")
    origin = path.read_text().split("origin=")[1].splitlines()[0]
    found = open_files(path, maps=(f"origin={origin}", "", "")).reference
    assert found is not None
    assert np.abs(earth.position_difference(found.llh, data.reference.llh)).max() < 1e-3
    assert np.abs((found.rpy - data.reference.rpy + np.pi) % (2 * np.pi) - np.pi).max() < 1e-6


def test_tracks_are_exported_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = drive()
    write(tmp_path / "rec.npz", Recording(data.imu, data.gnss, data.reference))
    begin = ("--origin", "2024-05-01T12:00:00Z", "--outage", "20:30")
    assert run("export", tmp_path / "rec.npz", "-o", tmp_path / "a.kml", *begin) == 0
    assert "2024-05-01T12:00:00.5" in (tmp_path / "a.kml").read_text()
    assert run("export", tmp_path / "rec.npz", "--reference", "-o", tmp_path / "a.tum") == 0
    for wrong in (("-o", tmp_path / "a.kml"), ("-o", tmp_path / "a.xyz"), ("-o", tmp_path / "b.kml", "--outage", "3")):
        assert run("export", tmp_path / "rec.npz", *wrong) == 2
    assert "expected seconds since 1970" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["IMAR", "LN200", "LN200IG", "IXSEA", "NAVCHIP_INT", "NAVCHIP_FLT"])
def test_a_binary_imu_comes_back(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whole numbers are rounded cumulatively: angles and velocities are right to one count over any span."""
    source = write(tmp_path / "drive.npz", drive())
    assert run("export", source, "--to", kind.lower(), "-o", tmp_path / "drive.imu") == 0
    back, want = open_files(tmp_path / "drive.imu", maps=(f"imu={kind}", "", "")).imu, drive().imu.as_increments()
    assert back is not None and back.kind == "increment"
    layout = IMU_BINARIES[kind]
    for found, given, count in ((back.gyro, want.gyro, layout.gyro), (back.accel, want.accel, layout.accel)):
        worst = np.abs(np.cumsum(found - given, axis=0)).max() / count
        assert worst < 0.51 if layout.values == "<i4" else worst < 1e-6
    np.testing.assert_array_equal(back.t, want.t)
    guessed = open_files(tmp_path / "drive.imu")
    assert guessed.assumed[0].startswith("type ") and kind in guessed.assumed[0]
    assert guessed.imu is not None
    np.testing.assert_array_equal(guessed.imu.accel, back.accel)


@pytest.mark.parametrize(
    ("counts", "fits"), [(2**31 - 1.0, True), (-(2**31) + 1.0, True), (2.0**31, False), (-1.4 * 2.0**31, False)]
)
def test_increments_are_32_bit_numbers(counts: float, fits: bool, tmp_path: Path) -> None:
    gyro = np.zeros((4, 3))
    gyro[1, 2] = counts * 2.0**-21
    imu = ImuRecord(0.01 * np.arange(4), gyro, np.zeros((4, 3)), "increment")
    if fits:
        assert write_imu_binary(tmp_path / "x.imu", imu, "LN200").exists()
        return
    with pytest.raises(InputError, match="beyond the 32-bit numbers of LN200"):
        write_imu_binary(tmp_path / "x.imu", imu, "LN200")
    assert not (tmp_path / "x.imu").exists()


def test_a_binary_imu_that_fits_no_type_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.imu"
    path.write_bytes(np.random.default_rng(1).bytes(4000))
    assert run("open", path) == 2
    assert "fits no type under gravity; say it with --map imu=TYPE" in capsys.readouterr().err
    assert run("open", path, "--map", "imu=LN20") == 2
    assert "unknown type of IMU 'LN20' (did you mean 'LN200'?)" in capsys.readouterr().err
    source = write(tmp_path / "drive.npz", drive())
    assert run("export", source, "-o", tmp_path / "y.imu") == 2
    assert "says no type of IMU; expected one of: IMAR" in capsys.readouterr().err
    assert not (tmp_path / "y.imu").exists()


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
def test_a_run_becomes_an_overlay_of_its_designs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two designs through one outage: a folder each, the way displaced by the error, the ellipse three stated sigmas wide."""
    scenario = tmp_path / "short.yaml"
    scenario.write_text(
        """
title: an overlay
seed: 3
realizations: 2
trajectory: {builtin: urban_drive_1, rate: 50 Hz, duration: 90 s}
truth: {gyro: WN(N=0.1 deg/s/sqrt(Hz)), accel: WN(N=1 mg/sqrt(Hz))}
gnss: {rate: 1 Hz, position_sigma: 1 m, velocity_sigma: 0.1 m/s, outages: [{start: 50 s, duration: 20 s}]}
designs:
  one: {gyro: WN(N=0.1 deg/s/sqrt(Hz)), accel: WN(N=1 mg/sqrt(Hz))}
  a & b: {gyro: WN(N=0.3 deg/s/sqrt(Hz)), accel: WN(N=2 mg/sqrt(Hz))}
"""
    )
    assert run("run", scenario, "--workers", "1", "--output", tmp_path / "out") == 0
    kml = tmp_path / "overlay.kml"
    assert run("export", tmp_path / "out", "-o", kml, "--realization", "1") == 0
    space = {"k": "http://www.opengis.net/kml/2.2"}
    folders = ElementTree.parse(kml).getroot().findall(".//k:Folder", space)
    assert [f.findtext("k:name", "", space) for f in folders] == ["reference", "one", "a & b"]

    def places(node: ElementTree.Element) -> np.ndarray:
        text = node.findtext(".//k:coordinates", "", space)
        lon, lat, h = np.array([[float(v) for v in p.split(",")] for p in text.split()]).T
        return np.column_stack([np.radians(lat), np.radians(lon), h])

    with xr.open_dataset(tmp_path / "out" / "errors.nc", engine="h5netcdf") as data:
        error, sigma = (data[v].values[:, 1, :, :3] for v in ("error", "sigma"))
        t = data["time"].values
    truth = places(folders[0].findall("k:Placemark", space)[0])
    last = int(np.flatnonzero(t <= 70.0)[-1])
    for k, folder in enumerate(folders[1:]):
        way, outage, ellipse = folder.findall("k:Placemark", space)
        np.testing.assert_allclose(earth.position_difference(places(way), truth), error[k], atol=2e-3)
        assert len(places(outage)) == int(((t >= 50.0) & (t <= 70.0)).sum())
        ring = earth.llh_to_ned(places(ellipse), places(way)[last])
        np.testing.assert_allclose(ring[:, :2].max(axis=0), 3.0 * sigma[k, last, :2], rtol=1e-2)
    assert run("export", tmp_path / "out", "-o", kml, "--realization", "2") == 2
    assert "--realization: found 2, expected 0 to 1" in capsys.readouterr().err
    drawn = kml.read_bytes()
    with xr.open_dataset(tmp_path / "out" / "errors.nc", engine="h5netcdf") as data:
        some = data.load().assign_coords(realization=[0, 316])  # as of a run of many, of which a few stay
    some.to_netcdf(tmp_path / "out" / "errors.nc", engine="h5netcdf")
    assert run("export", tmp_path / "out", "-o", kml, "--realization", "316") == 0
    assert kml.read_bytes() == drawn
    assert run("export", tmp_path / "out", "-o", kml, "--realization", "2") == 2
    assert "--realization: found 2, expected one of 0, 316" in capsys.readouterr().err
    assert run("export", tmp_path / "out", "-o", tmp_path / "x.gpx") == 2
    assert "cannot write '.gpx' overlays, expected .kml" in capsys.readouterr().err


def test_an_imu_file_with_broken_times_is_none() -> None:
    layout = IMU_BINARIES["LN200"]
    epochs = np.zeros(50, dtype=layout.record)
    epochs["values"][:, 5] = round(-0.0981 / layout.accel)
    for dt, shuffled, fits in ((0.01, False, True), (0.01, True, False), (2.0, False, False), (4e-5, False, False)):
        scale = dt / 0.01
        epochs["time"] = dt * np.arange(50)
        epochs["values"][:, 5] = round(-0.0981 * scale / layout.accel)
        if shuffled:
            epochs["time"][::4] += 10.0
        assert imu_binary._fits(epochs, layout) == fits
