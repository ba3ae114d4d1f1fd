"""``insemu emulate`` and ``insemu dead-reckon`` as a user types them."""

import json

import numpy as np
import pytest
import yaml

from insemu.cli import main
from insemu.effects import AID_KINDS, EFFECTS
from insemu.emulate import built_in, dead_reckon, ideal_imu
from insemu.evaluate.emulated import EmulatedWorld
from insemu.formats import read_recording, write
from insemu.records import ImuRecord, Recording, Trajectory
from insemu.scenario import load
from insemu.scenario.schema import Truth
from tests.shared_data import shared

SCENARIO = {
    "title": "a drive",
    "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "120 s"},
    "truth": {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz))",
        "accel": "WN(N=90 ug/sqrt(Hz))",
        "effects": [{"effect": "turn_on_bias", "sensor": "gyro", "value": ["0.1 deg/s", 0, 0]}],
    },
    "gnss": {"position_sigma": "5 cm", "outages": [{"start": "80 s", "duration": "20 s"}]},
    "designs": {"full": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def scenario(tmp_path, **changes):
    file = tmp_path / "s.yaml"
    file.write_text(yaml.safe_dump(SCENARIO | changes, sort_keys=False), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    "out", ["recording.npz", pytest.param("recording", marks=pytest.mark.slow(reason="another case of a quick test"))]
)
def test_what_is_emulated_is_read_by_the_others(tmp_path, capsys, out):
    file, target = scenario(tmp_path), tmp_path / out
    assert run("emulate", file, "--output", target, "--ideal", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["imu_samples"] == 6001 and said["gnss_fixes"] == 100 and said["imu_rate_hz"] == 50.0
    assert run("dead-reckon", target, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["max_position_error_m"] < 1e-6 and result["max_attitude_error_rad"] < 1e-9
    assert {
        "max_position_error_m", "final_position_error_m", "max_velocity_error_m_s", "max_attitude_error_rad",
        "epochs_per_second",
    } <= set(result)  # fmt: skip
    # the same realization with its errors: the bias is there, and it is the same each time
    assert run("emulate", file, "--output", target, "--realization", 3) == 0
    noisy = read_recording(target)
    ideal = ideal_imu(built_in("urban_drive_1"), 50.0, span=(0.0, 120.0)).imu
    bias = (noisy.imu.gyro - ideal.gyro)[1:].mean(axis=0) * 50.0
    assert np.rad2deg(bias[0]) == pytest.approx(0.1, abs=0.015)
    assert run("emulate", file, "--output", tmp_path / "again.npz", "--realization", 3) == 0
    np.testing.assert_allclose(read_recording(tmp_path / "again.npz").imu.gyro, noisy.imu.gyro, rtol=1e-12)
    capsys.readouterr()
    assert run("dead-reckon", target) == 0
    assert "largest position error" in capsys.readouterr().out


def test_a_scenario_without_designs_is_enough(tmp_path, capsys):
    file = scenario(tmp_path)
    file.write_text(yaml.safe_dump({k: v for k, v in SCENARIO.items() if k != "designs"}), encoding="utf-8")
    assert run("emulate", file, "--output", tmp_path / "r.npz") == 0
    assert "urban_drive_1 from 4" in capsys.readouterr().out  # and says where it is
    assert run("run", file) == 2
    assert "the key 'designs' is missing" in capsys.readouterr().err


def test_every_effect_is_reached_from_a_scenario_with_units(tmp_path):
    """Each alone, at its datasheet scale, changes what it is said to change and nothing else."""
    file = scenario(tmp_path, trajectory={"builtin": "urban_drive_1", "rate": "100 Hz", "duration": "60 s"})
    document = yaml.safe_load(file.read_text())
    document["truth"]["temperature"] = {"t": ["0 s", "60 s"], "degc": [20, 60]}
    document["truth"]["effects"] = []
    document["gnss"] = {"rate": "5 Hz"}
    document["aids"] = {kind: {"sigma": 0.01} for kind in AID_KINDS}
    file.write_text(yaml.safe_dump(document))
    world = EmulatedWorld(load(str(file)), file)
    before = signals(world.recording(0))
    values = {"limit": 0.01, "start": 30.0, "cutoff": 20.0, "good": 2.0, "probability": 0.2}
    gnss = {"fix", "velocity", "stated"}
    allowed = {"gyro": {"gyro"}, "accel": {"accel"}, "imu": {"t", "gyro", "accel"}, "gnss": gnss} | {
        kind: {kind} for kind in AID_KINDS
    }
    for effect in EFFECTS.values():
        for sensor in effect.sensors:
            entry = {"effect": effect.id, "sensor": sensor}
            if "equation" in effect.traits:
                entry["equation"] = {"gyro": "x = rate_y", "accel": "y = force_x", "gnss": "east = speed"}[sensor]
            for p in effect.parameters:
                scale = values.get(p.name, effect.scale(p.name, sensor))
                quantity = f"{scale!r} {effect.unit(p.name, sensor)}".strip()
                entry[p.name] = [quantity] * 6 if p.size == 6 else quantity
            world.truth = Truth.model_validate(document["truth"] | {"effects": [entry]})
            after = signals(world.recording(0))
            changed = {k for k, v in after.items() if not np.array_equal(v, before[k], equal_nan=True)}
            assert changed and changed <= allowed[sensor], (effect.id, sensor, changed)


def signals(recording):
    imu, gnss = recording.imu, recording.gnss
    return {
        "t": imu.t, "gyro": imu.gyro, "accel": imu.accel,
        "fix": gnss.llh, "velocity": gnss.vel_ned, "stated": gnss.pos_std_ned,
        **{aid.kind: aid.values for aid in recording.aids},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("recrd", "truth.recorded.remove_mean: found 'recrd', expected one of: record, piece, none; or a span"),
        (["1 s"], "or a span [from, to]"),
        (["10 s", "5 s"], "the span (10.0, 5.0) s for the mean is not inside the record of 30 s"),
        (["0 s", "20 s"], None),
    ],
)
def test_the_mean_of_a_span_is_taken_off(tmp_path, capsys, value, message):
    rng = np.random.default_rng(1)
    log = 1e-3 * rng.standard_normal((3000, 6)) + np.linspace(0, 1, 3000)[:, None]
    columns, units = ["gx", "gy", "gz", "ax", "ay", "az"], ["rad/s"] * 3 + ["m/s^2"] * 3
    np.savez(tmp_path / "log.npz", data=log, fs=100.0, columns=columns, units=units)
    recorded = {"files": ["log.npz"], "remove_mean": value}
    flight = {"builtin": "static", "rate": "100 Hz", "duration": "10 s"}
    file = scenario(tmp_path, trajectory=flight, truth={"recorded": recorded}, designs={}, realizations=1, gnss={})
    target = tmp_path / "r.npz"
    assert run("emulate", file, "--output", target) == (0 if message is None else 2)
    if message is not None:
        assert message in capsys.readouterr().err
        return
    ideal = EmulatedWorld(load(str(file)), file).recording(0, ideal=True).imu
    error = (read_recording(target).imu.gyro - ideal.gyro)[1:] * 100.0
    np.testing.assert_allclose(error, (log[:1000] - log[:2000].mean(axis=0))[:, :3], atol=1e-9)


def test_an_area_that_is_never_entered_is_warned_about(tmp_path, capsys):
    start = np.rad2deg(built_in("urban_drive_1").path.llh([0.0])[0])
    areas = [{"latitude": f"{start[1]} deg", "longitude": f"{start[0]} deg", "radius": "100 m"}]
    assert run("emulate", scenario(tmp_path, gnss={"areas": areas}), "--output", tmp_path / "r.npz") == 0
    said = capsys.readouterr().err
    assert "gnss.areas.0 is never entered" in said and "are latitude and longitude swapped?" in said


def test_a_figure_is_drawn(tmp_path, capsys):
    bad = ("emulate", scenario(tmp_path), "--output", tmp_path / "r.npz", "--figure", tmp_path / "track.xyz")
    assert run(*bad) == 2 and not (tmp_path / "r.npz").exists()
    assert "found the suffix '.xyz', expected .png" in capsys.readouterr().err
    assert run("emulate", scenario(tmp_path), "--output", tmp_path / "r.npz", "--figure", tmp_path / "track.png") == 0
    assert (tmp_path / "track.png").stat().st_size > 20_000


def test_bad_input_ends_with_code_two_and_writes_nothing(tmp_path, capsys):
    cases = [
        (
            {"trajectory": {"builtin": "urban_drive_3"}},
            "s.yaml:3: trajectory.builtin: unknown trajectory 'urban_drive_3'",
        ),
        ({"trajectory": {"track": "absent.npz"}}, "absent.npz"),
        (
            {"truth": SCENARIO["truth"] | {"effects": [{"effect": "turn_on_bais", "sensor": "gyro", "value": 1}]}},
            "turn_on_bias",
        ),
        ({"gnss": {"outages": [{"start": "110 s", "duration": "20 s"}]}}, "ends at 130 s"),
    ]
    for changes, message in cases:
        assert run("emulate", scenario(tmp_path, **changes), "--output", tmp_path / "r.npz") == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "r.npz").exists()
    assert run("dead-reckon", tmp_path / "absent.npz") == 2
    assert "absent.npz" in capsys.readouterr().err


def test_recordings_without_a_usable_reference_are_named(tmp_path, capsys):
    ideal = ideal_imu(built_in("static"), 10.0, span=(0.0, 60.0))
    write(tmp_path / "bare.npz", Recording(ideal.imu))
    assert run("dead-reckon", tmp_path / "bare.npz") == 2
    assert "has no reference" in capsys.readouterr().err
    r = ideal.reference
    later = Trajectory(r.t + 1000.0, r.llh, r.vel_ned, r.rpy)
    write(tmp_path / "apart.npz", Recording(ideal.imu, None, later))
    assert run("dead-reckon", tmp_path / "apart.npz") == 2
    assert "do not overlap" in capsys.readouterr().err
    write(tmp_path / "good.npz", Recording(ideal.imu, None, r))
    assert run("dead-reckon", tmp_path / "good.npz", "--gravity", "none") == 2
    assert "unknown gravity model 'none'" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["increment", "mean", "sample"])
def test_dead_reckoning_honours_the_kind_and_other_reference_rates(tmp_path, kind):
    flight = built_in("helicopter_mapping")
    ideal = ideal_imu(flight, 200.0, mode="continuous", kind=kind, span=(0.0, 200.0))
    reference = flight.path.sample(np.arange(10.013, 190.0, 0.37))
    result = dead_reckon(Recording(ideal.imu, None, reference))
    # started between two nodes of a 2.7 Hz reference in hover, so by its interpolation; samples go by the trapezoid
    assert result.max_position_error_m < (0.05 if kind != "sample" else 2.0)
    assert result.kind == kind and result.start_s == pytest.approx(10.015)


def test_dead_reckoning_of_another_programs_file(tmp_path, capsys):
    with np.load(shared("fixtures/inertial/car_100hz.npz")) as file:
        data = dict(file)
    file = tmp_path / "car.npz"
    np.savez(
        file,
        imu_kind="increment",
        imu_t=data["time"],
        imu=np.hstack([data["gyro_incr"], data["accel_incr"]]),
        gnss_t=data["time"][::100],
        gnss_llh=data["lla"][::100],
        gnss_vel_ned=data["vel_ned"][::100],
        ref_t=data["time"],
        ref_llh=data["lla"],
        ref_vel_ned=data["vel_ned"],
        ref_rpy_deg=data["rph"],
    )
    assert run("dead-reckon", file, "--gravity", "free_air_first_order", "--json") == 0
    assert json.loads(capsys.readouterr().out)["max_position_error_m"] <= 0.020
    assert run("dead-reckon", file, "--json") == 0
    assert json.loads(capsys.readouterr().out)["max_position_error_m"] > 0.1  # another Earth


def test_a_reckoning_of_two_rows():
    imu = ImuRecord([0.0, 0.1], np.zeros((2, 3)), np.zeros((2, 3)), "mean")
    reference = Trajectory([0.0, 0.1], np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)))
    assert dead_reckon(Recording(imu, None, reference)).epochs == 1
