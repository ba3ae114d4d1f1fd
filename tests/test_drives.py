"""Vehicles learned from drives, and drives held against each other: on a vehicle whose spectra are known."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from benchmarks.vehicles import driven
from insemu.cli import app
from insemu.drives import Windows, compare_drives, compared, learn_vehicle, loudness, signals_of, windows, windows_of
from insemu.drives.sideslip import sideslip_of
from insemu.emulate import MotionSpectrum, MovingVehicle, Regime, Slip, read_vehicle
from insemu.emulate.dynamics.levels import between
from insemu.errors import InputError
from insemu.formats import write
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording

Array = NDArray[np.float64]
RATE, END = 50.0, 240.0
#: Noise of the sensor: 0.3 deg/sqrt(h), 150 ug/sqrt(Hz).
SENSOR = {a: NoiseModel([WN(8.7e-5 if a.startswith("gyro") else 1.5e-3)]) for a in AXES}
FREQUENCIES = np.array([0.4, 1.0, 3.0, 6.0, 10.0, 22.0])


def fixes(speed: Array, turn: Array, t: Array) -> GnssRecord:
    """Fixes of centimetres on a level way with speeds m/s and rates of turn rad/s at times."""
    step = np.diff(t, prepend=t[0])
    course = np.cumsum(turn * step)
    velocity = np.stack([speed * np.cos(course), speed * np.sin(course), 0.0 * t], axis=1)
    way = np.cumsum(velocity * step[:, None], axis=0)
    llh = np.array([0.8, 0.2, 100.0]) + way / np.array([6.37e6, 6.38e6 * np.cos(0.8), 1e12])
    return GnssRecord(t, llh, velocity, np.full((t.size, 3), 0.01), np.full((t.size, 3), 0.02))


@pytest.fixture(scope="module")
def way() -> Recording:
    """A drive at 12 m/s between stops of half a minute: fixes, and an IMU of which the clock alone is used."""
    t = np.arange(0.0, END + 0.1, 0.25)
    speed = 12.0 * np.clip((t - 30.0) / 8.0, 0.0, 1.0) * np.clip((END - 30.0 - t) / 8.0, 0.0, 1.0)
    clock = np.arange(0.0, END, 1.0 / RATE)
    return Recording(
        ImuRecord(clock, np.zeros((clock.size, 3)), np.zeros((clock.size, 3))), fixes(speed, 0.0 * t, t), source="way"
    )


@pytest.fixture(scope="module")
def known() -> MovingVehicle:
    """A vehicle that heaves and pitches a quarter of a period apart, and sways by itself."""
    shape = np.array([0.3, 1.0, 2.0, 1.0, 0.5, 0.2])[:, None]
    density = shape * np.array([1e-6, 4e-6, 1e-6, 2e-4, 3e-4, 2e-3])
    coherence = np.tile(np.eye(6, dtype=complex), (FREQUENCIES.size, 1, 1))
    coherence[:, 1, 5], coherence[:, 5, 1] = 0.8j, -0.8j
    moving = Regime("moving", density, coherence, speed=(1.5, np.inf))
    still = Regime("still", 1e-6 * density, coherence, speed=(0.0, 0.2))
    return MovingVehicle("known", "car", MotionSpectrum(FREQUENCIES, (still, moving)))


@pytest.fixture(scope="module")
def recorded(way: Recording, known: MovingVehicle) -> Recording:
    return driven(known, way, SENSOR, 1)


@pytest.fixture(scope="module")
def learned(recorded: Recording) -> MovingVehicle:
    return learn_vehicle(recorded).vehicle


def fast(vehicle: MovingVehicle) -> list[Regime]:
    """The parts of the regime at 12 m/s."""
    straight = [r for r in vehicle.spectrum.regimes if r.speed[0] < 11.0 < 12.0 < r.speed[1] and r.turn[0] == 0.0]
    return straight or [r for r in vehicle.spectrum.regimes if r.speed[1] == np.inf and r.turn[0] == 0.0]


def test_densities_come_back_within_their_standard_deviations(learned: MovingVehicle, known: MovingVehicle) -> None:
    inside = slice(5, -3)  # the ramps of the speed and the path have the lowest cells, the highest end at an edge
    f = learned.spectrum.frequencies[inside]
    truth = np.exp(
        [np.interp(np.log(f), np.log(FREQUENCIES), np.log(y)) for y in known.spectrum.regimes[1].density.T]
    ).T
    mine = fast(learned)
    found = sum(r.density[inside] for r in mine)
    sigma = np.sqrt(
        sum((r.density_sigma[inside] * r.density[inside]) ** 2 for r in mine if r.density_sigma is not None)
    )
    away = (found - truth) / sigma
    assert np.abs(away).max() < 4.5  # of some 100 numbers, whose shape a cell blurs
    assert np.mean(np.abs(away) < 2.0) > 0.8
    assert np.abs(np.log(found / truth)).mean() < 0.25


def test_phases_between_axes_come_back(learned: MovingVehicle) -> None:
    mine = fast(learned)
    cross = sum(r.coherence[:, 1, 5] * np.sqrt(r.density[:, 1] * r.density[:, 5]) for r in mine)
    whole = np.sqrt(sum(r.density[:, 1] for r in mine) * sum(r.density[:, 5] for r in mine))
    pair = (cross / whole)[4:-3]
    assert np.abs(pair - 0.8j).mean() < 0.12
    other = sum(r.coherence[:, 0, 5] * np.sqrt(r.density[:, 0] * r.density[:, 5]) for r in mine)[4:-3]
    assert np.abs(other.mean() / whole.mean()) < 0.1


@pytest.mark.slow(reason="trees on windows of whole drives")
def test_two_drives_of_one_vehicle_are_alike_and_a_glide_is_told(
    way: Recording, known: MovingVehicle, recorded: Recording
) -> None:
    mine = windows_of(recorded)
    again = compare_drives(mine, windows_of(driven(known, way, SENSOR, 2)))
    # sixty windows of each: standard deviation 0.053 (Hanley and McNeil 1982), and the two drives share their path
    assert abs(again.powers.value - 0.5) < 0.16 and abs(again.everything.value - 0.5) < 0.16
    assert again.alike > 0.9 * len(again.bands)
    glide = compare_drives(mine, windows_of(driven("car", way, SENSOR, 3)))
    assert glide.powers.value > 0.9 and glide.powers.low > 0.8
    first = glide.telling[0]
    assert first.area < 0.2 and first.recorded > 2.0 * first.emulated


@pytest.mark.slow(reason="a third drive of four minutes and its trees, 6 s")
def test_a_learned_vehicle_drives_like_the_one_it_was_learned_from(recorded: Recording, learned: MovingVehicle) -> None:
    taught = compare_drives(windows_of(recorded), windows_of(driven(learned, recorded, SENSOR, 4)))
    # trees still tell them by the force along below 1 Hz: path and fixes move there, too
    assert taught.alike > 0.8 * len(taught.bands)
    # a glide has 1.0; seeds give 0.69 to 0.78, and sixty windows of each a standard deviation of 0.05
    assert taught.powers.value < 0.9


def test_levels_are_those_behind_chance_and_blur() -> None:
    rng = np.random.default_rng(8)
    freedom = np.tile([3.0, 30.0], (6, 1))
    true = np.exp(rng.normal(0.0, 0.8, (4000, 6, 2)))
    found = np.log(loudness.steady(true * rng.gamma(freedom, 1.0 / freedom, true.shape), freedom))
    # standard deviations of 48,000 numbers: 0.4 per cent; chance alone would make them 1.02 and 0.82
    assert found.std(axis=(0, 1)) == pytest.approx(0.8, rel=0.02)
    assert np.abs(found.mean(axis=(0, 1))).max() < 0.02
    level = np.ones((60, 6))
    level[20:24] = 20.0
    window = np.hanning(81)[:-1] ** 2
    inside = [between(k + np.linspace(-1.0, 1.0, 81)[:-1], level) for k in range(60)]
    blurred = np.stack([window @ x / window.sum() for x in inside])
    begins = np.arange(60) % 40 == 0
    sharp = loudness.sharpened(blurred[:, :, None], begins)[:, :, 0]
    assert (blurred[19] > 4.0).all() and (blurred[20] < 17.0).all()
    assert (sharp[19] < 0.5 * blurred[19]).all() and (sharp[20] > 18.0).all()  # 1 and 20 in truth
    assert sharp[46:56] == pytest.approx(1.0, rel=0.01)  # where nothing changes nothing does


def test_standstills_tell_the_noise_of_the_sensor_under_an_engine(way: Recording) -> None:
    rng = np.random.default_rng(3)
    n = len(way.imu)
    level = np.array([1e-4, 1e-4, 1e-4, 2e-3, 2e-3, 2e-3])
    engine = rng.standard_normal(n)[:, None] * np.array([1.0, -0.5, 2.0, 1.0, 3.0, -2.0]) * 10.0 * level
    x = (rng.standard_normal((n, 6)) * level + engine) * np.sqrt(RATE)
    imu = ImuRecord(way.imu.t, x[:, :3], x[:, 3:] + np.array([0.0, 0.0, -9.81]))
    noise = windows.sensor_noise(signals_of(replace(way, imu=imu)))
    assert noise is not None
    # five axes tell the engine to 1 / (1 + their signal to noise) of its power, the rest of the sixth is its own; the quietest octave is lower
    loud = (10.0 * np.array([1.0, -0.5, 2.0, 1.0, 3.0, -2.0])) ** 2
    left = 1.0 + loud / (1.0 + loud.sum() - loud)
    assert noise / (2.0 * level**2) == pytest.approx(left, rel=0.25)
    assert (noise / (2.0 * level**2) < 0.2 * (1.0 + loud))[[0, 2, 3, 4, 5]].all()


def test_an_axle_and_side_force_come_back(way: Recording) -> None:
    t = np.arange(0.0, 400.0, 0.25)
    speed = 9.0 + 5.0 * np.sin(2.0 * np.pi * t / 90.0)
    bends = fixes(speed, 0.25 * np.sin(2.0 * np.pi * t / 17.0), t)
    clock = np.arange(0.0, 399.0, 1.0 / RATE)
    nothing = np.zeros((clock.size, 3))
    spectrum = MotionSpectrum(
        FREQUENCIES, (Regime("all", np.full((6, 6), 1e-12), np.tile(np.eye(6, dtype=complex), (6, 1, 1))),)
    )
    vehicle = MovingVehicle("slips", "car", spectrum, slip=Slip(np.deg2rad(0.2), 1.5, axle=1.6, compliance=0.005))
    drive = driven(vehicle, Recording(ImuRecord(clock, nothing, nothing), bends), SENSOR, 5)
    found = sideslip_of(signals_of(drive))
    assert found is not None
    for (value, sigma), true in ((found.axle, 1.6), (found.compliance, 0.005), (found.late, 0.0)):
        assert abs(value - true) < 4.0 * sigma
    assert found.axle[1] < 0.5 and found.compliance[1] < 0.006


def test_the_area_is_the_share_of_pairs_in_the_right_order() -> None:
    rng = np.random.default_rng(4)
    score, label, weight = np.round(rng.normal(size=40), 1), rng.integers(0, 2, 40), rng.uniform(0.5, 2.0, 40)
    right = total = 0.0
    for i in np.flatnonzero(label == 1):
        for j in np.flatnonzero(label == 0):
            w = weight[i] * weight[j]
            right += w * ((score[i] > score[j]) + 0.5 * (score[i] == score[j]))
            total += w
    assert compared.area_under(score, label, weight) == pytest.approx(right / total, rel=1e-12)


def test_drives_of_other_regimes_are_refused_and_other_shares_are_no_difference(
    way: Recording, known: MovingVehicle, recorded: Recording
) -> None:
    mine, other = windows_of(recorded), windows_of(driven(known, way, SENSOR, 6))
    still, moving = mine.rows(mine.speed < 0.5), mine.rows(mine.speed > 11.0)
    with pytest.raises(InputError, match="share no regime"):
        compare_drives(still, moving)

    def without(w: Windows, rows: slice) -> Windows:
        keep = np.ones(len(w.t), dtype=bool)
        keep[rows] = False
        return w.rows(keep)

    fewer = compare_drives(mine, without(other, slice(0, 5)))
    assert fewer.seconds["standing"][0] > 1.3 * fewer.seconds["standing"][1]
    assert abs(fewer.powers.value - 0.5) < 0.16


def test_the_package_for_trees_is_named(recorded: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    mine = windows_of(recorded)
    with pytest.raises(InputError, match=r"insemu\[compare\]"):
        compare_drives(mine, mine)


def test_a_file_is_written_that_a_scenario_drives(recorded: Recording, tmp_path: Path) -> None:
    drive, out = tmp_path / "drive.npz", tmp_path / "my_car.yaml"
    write(drive, recorded)
    assert CliRunner().invoke(app, ["vehicle", str(drive), "-o", str(out), "--vehicle", "boot"]).exit_code != 0
    assert not out.exists()
    done = CliRunner().invoke(app, ["vehicle", str(drive), "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert "cannot tell" in done.output
    vehicle = read_vehicle(out)
    assert vehicle.spectrum.unknown and vehicle.kind == "car"
    scenario = tmp_path / "again.yaml"
    scenario.write_text(
        "title: again\ntrajectory: {track: drive.npz, vehicle: {file: my_car.yaml}, rate: 50 Hz, kind: sample, mode: continuous}\n"
        "truth: {gyro: WN(N=0.3 deg/sqrt(h)), accel: WN(N=150 ug/sqrt(Hz))}\n"
        "designs: {a: {gyro: WN(N=0.3 deg/sqrt(h)), accel: WN(N=150 ug/sqrt(Hz))}}\n"
    )
    emulated = tmp_path / "emulated.npz"
    done = CliRunner().invoke(app, ["emulate", str(scenario), "--output", str(emulated)])
    assert done.exit_code == 0, done.output
    page = tmp_path / "page.html"
    done = CliRunner().invoke(app, ["compare-drives", str(drive), str(emulated), "--page", str(page)])
    assert done.exit_code == 0, done.output
    assert "area under the curve" in done.output and page.exists()
