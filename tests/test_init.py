"""``insemu init``, the scenarios that travel with the package, and sensors by name in a scenario."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import insemu
from insemu import earth, noise, yamlfile
from insemu.cli import app
from insemu.emulate import MotionSource, SmoothPath, built_in, load_flight
from insemu.errors import InputError
from insemu.records import AXES
from insemu.scenario import (
    Scenario,
    Wish,
    copy_shipped,
    first_scenario,
    load,
    located,
    shipped,
    shipped_scenarios,
    validated,
)
from insemu.sensors import models

ROOT = Path(insemu.__file__).parent.parent


def write_track(path: Path, *, times: bool = True) -> Path:
    """Six minutes at 12 m/s: straight, a half circle, straight."""
    t = np.arange(0.0, 361.0)
    heading = np.interp(t, [0, 150, 210, 360], [0.0, 0.0, np.pi, np.pi])
    north, east = 12.0 * np.cumsum(np.cos(heading)), 12.0 * np.cumsum(np.sin(heading))
    lat, lon = 46.5 + north / 111_200.0, 6.6 + east / 76_700.0
    head = "t [s], lat [deg], lon [deg], height [m]" if times else "lat, lon, height [m]"
    rows = [
        f"{ti:.0f}, {a:.8f}, {o:.8f}, 400" if times else f"{a:.8f}, {o:.8f}, 400"
        for ti, a, o in zip(t, lat, lon, strict=True)
    ]
    path.write_text("\n".join([head, *(rows if times else rows[:: len(rows) // 3])]) + "\n", encoding="utf-8")
    return path


# -- the scenarios that come with insemu ------------------------------------------------------------------------------------------


def test_every_scenario_of_the_checkout_is_shipped_with_its_question_and_files() -> None:
    known = shipped_scenarios()
    assert list(known) == sorted(p.stem for p in (ROOT / "scenarios").glob("*.yaml"))
    assert all(one.question for one in known.values())
    assert known["outages_smoothed"].files == ("motion/roundabout_and_road.csv",)
    assert known["real_static"].files == ("models/adis16405.yaml",)
    assert {name for name, one in known.items() if one.shared} == {"real_static", "real_drive_rtk", "real_drive_ublox"}


def test_the_name_of_a_shipped_scenario_stands_for_its_file(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load("table3_synthetic") == load(ROOT / "scenarios" / "table3_synthetic.yaml")
    assert located("own/table3_synthetic") == Path("own/table3_synthetic")
    with pytest.raises(InputError, match=r"table3_synthetc: no such file.*did you mean 'table3_synthetic'"):
        load("table3_synthetc")
    with pytest.raises(InputError, match="no such file"):
        load("table3_synthetic.yaml")
    Path("table3_synthetic").write_text("title: mine")
    assert located("table3_synthetic") == Path("table3_synthetic")  # a file of this name wins


def test_files_of_a_shipped_scenario_are_found_by_its_name(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = CliRunner().invoke(app, ["designs", "--scenario", "outages_smoothed"])
    assert ran.exit_code == 0
    from insemu.evaluate import Experiment

    assert Experiment(load("outages_smoothed"), "outages_smoothed").digest


def test_a_copy_has_what_it_needs_and_replaces_nothing(tmp_path) -> None:
    runner = CliRunner()
    target = tmp_path / "copy.yaml"
    made = runner.invoke(app, ["init", str(target), "--like", "outages_smoothed", "--json"])
    assert json.loads(made.output) == [str(target), str(tmp_path / "motion" / "roundabout_and_road.csv")]
    assert all(Path(name).is_file() for name in json.loads(made.output))
    assert load(target) == load("outages_smoothed")
    (tmp_path / "motion" / "roundabout_and_road.csv").write_text("mine")
    (tmp_path / "copy.yaml").unlink()
    with pytest.raises(InputError, match=r"roundabout_and_road.csv: exists already; --force replaces it"):
        copy_shipped("outages_smoothed", target)
    assert not target.exists()
    assert (tmp_path / "motion" / "roundabout_and_road.csv").read_text() == "mine"
    copy_shipped("outages_smoothed", target, overwrite=True)
    assert target.exists()
    with pytest.raises(InputError, match="no scenario 'table_3' comes with insemu"):
        copy_shipped("table_3", target)


def test_the_list_names_every_scenario_with_its_question() -> None:
    listed = CliRunner().invoke(app, ["init", "--list"]).output
    for name, one in shipped_scenarios().items():
        assert f"{name}{' (needs the shared data folder)' if one.shared else ''}: {one.question[:40]}" in listed


# -- a first scenario -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", ["ADIS16470", "BMI270", "BMI088", "LN-200"])
def test_a_first_scenario_is_valid_and_flies_its_sensor(sensor: str, tmp_path) -> None:
    target = tmp_path / "my.yaml"
    assert CliRunner().invoke(app, ["init", str(target), "--sensor", sensor]).exit_code == 0
    scenario = load(target)
    assert scenario.truth is not None
    assert scenario.truth.models() == models(sensor)
    assert len(scenario.designs) == 2
    assert len(scenario.gnss.outages) == 2
    comments = [line for line in target.read_text(encoding="utf-8").splitlines() if "#" in line]
    assert len(comments) > 20
    assert max(map(len, comments)) <= 150


def test_an_own_track_gives_the_motion_and_places_the_outages_in_it(tmp_path, monkeypatch) -> None:
    (tmp_path / "data").mkdir()
    track = write_track(tmp_path / "data" / "commute.csv")
    target = tmp_path / "my.yaml"
    target.write_text(first_scenario(target, Wish(track=str(track))), encoding="utf-8")
    scenario = load(target)
    assert scenario.trajectory.track == "data/commute.csv"
    starts = [yaml.safe_load(target.read_text())["gnss"]["outages"][k]["start"] for k in range(2)]
    assert starts == ["120 s", "240 s"]
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["init", "--track", "data/commute.csv"]).exit_code == 0
    assert load("scenario.yaml").trajectory == scenario.trajectory


def test_a_gpx_track_of_a_phone_is_an_own_track(tmp_path) -> None:
    lines = write_track(tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()[1:]
    points = [
        f'<trkpt lat="{lat.strip()}" lon="{lon.strip()}"><ele>400</ele><time>2026-05-01T10:{int(t) // 60:02d}:{int(t) % 60:02d}Z</time></trkpt>'
        for t, lat, lon, _ in (line.split(",") for line in lines)
    ]
    gpx = tmp_path / "ride.gpx"
    head = '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
    gpx.write_text(f"{head}{''.join(points)}</trkseg></trk></gpx>", encoding="utf-8")
    target = tmp_path / "my.yaml"
    target.write_text(first_scenario(target, Wish(track=str(gpx))), encoding="utf-8")
    assert load(target).trajectory.track == "ride.gpx"
    assert "start: 120 s" in target.read_text(encoding="utf-8")


def test_a_scenario_runs_of_whatever_a_recorder_or_a_planner_wrote(tmp_path) -> None:
    """Without times, with a pause, with a point every 20 s, with a point 1 km off: flown, and near the truth."""
    truth = built_in("urban_drive_1").path
    t = np.arange(60.0, 360.0)
    llh = truth.llh(t)

    def gpx(name: str, rows: np.ndarray, t: np.ndarray, llh: np.ndarray, *, times: bool = True) -> str:
        begin = datetime(2026, 5, 1, tzinfo=UTC)
        points = "".join(
            f'<trkpt lat="{np.degrees(llh[k, 0]):.8f}" lon="{np.degrees(llh[k, 1]):.8f}"><ele>{llh[k, 2]:.2f}</ele>'
            + (f"<time>{(begin + timedelta(seconds=float(t[k]))).isoformat()}</time>" if times else "")
            + "</trkpt>"
            for k in rows
        )
        (tmp_path / f"{name}.gpx").write_text(f'<gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>')
        target = tmp_path / f"{name}.yaml"
        target.write_text(first_scenario(target, Wish(track=str(tmp_path / f"{name}.gpx"))), encoding="utf-8")
        return name

    def flown(name: str) -> tuple[SmoothPath, tuple[str, ...]]:
        asked = load(tmp_path / f"{name}.yaml").trajectory
        found = load_flight(
            MotionSource(
                track=None if asked.track is None else tmp_path / asked.track,
                waypoints=None if asked.waypoints is None else tmp_path / asked.waypoints,
                speed=asked.speed,
                max_gap_s=asked.max_gap,
            )
        )
        return found.flight.path, found.warnings

    every = np.arange(t.size)
    off = llh.copy()
    off[100, 0] += np.radians(0.01)
    path, said = flown(gpx("jump", every, t, off))
    assert any("t = 100 s is 11" in s and "left out" in s for s in said)
    assert np.linalg.norm(earth.position_difference(path.llh(t - 60.0), llh), axis=1).max() < 1.0
    path, said = flown(gpx("pause", every, t + 180.0 * (t >= 200.0), llh))
    assert any("the pause of 181 s" in s for s in said)
    assert path.end - path.start == pytest.approx(299.0, abs=2.0)
    path, _ = flown(gpx("sparse", every[::20], t, llh))
    assert np.linalg.norm(earth.position_difference(path.llh(t[::20] - 60.0), llh[::20]), axis=1).max() < 5.0
    path, _ = flown(gpx("plan", every[::5], t, llh, times=False))
    way = path.llh(np.arange(path.start, path.end, 0.1))
    nearest = [np.linalg.norm(earth.position_difference(way, p)[:, :2], axis=1).min() for p in llh[::5]]
    assert max(nearest) < 10.0  # corners are rounded


def test_waypoints_are_told_from_a_track(tmp_path) -> None:
    points = write_track(tmp_path / "points.csv", times=False)
    target = tmp_path / "my.yaml"
    target.write_text(first_scenario(target, Wish(track=str(points), vehicle="car")), encoding="utf-8")
    assert load(target).trajectory.waypoints == "points.csv"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.txt"], "a scenario's name ends with .yaml"),
        (["nowhere/a.yaml"], "nowhere: no such folder"),
        (["a.yaml", "--sensor", "ADIS1647O"], "no sensor 'ADIS1647O'.*did you mean 'ADIS16470'"),
        (["a.yaml", "--like", "real_static", "--sensor", "VN-100"], "without --sensor"),
        (["a.yaml", "--track", "none.csv"], "no such track file"),
        (["a.yaml", "--vehicle", "submarine"], "submarine"),
        (["there.yaml"], "exists already"),
    ],
)
def test_what_cannot_be_started_is_refused_and_writes_nothing(words, message, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").write_text("mine")
    ran = CliRunner().invoke(app, ["init", *words])
    assert isinstance(ran.exception, InputError)
    with pytest.raises(InputError, match=message):
        raise ran.exception
    assert [p.name for p in tmp_path.iterdir()] == ["there.yaml"]
    assert Path("there.yaml").read_text() == "mine"


def test_an_own_card_is_found_beside_the_scenario(tmp_path, monkeypatch) -> None:
    (tmp_path / "page.txt").write_text(
        "ARW 0.2 deg/sqrt(h); VRW 0.03 m/s/sqrt(h); in-run bias stability 8 deg/h", encoding="utf-8"
    )
    (tmp_path / "deep").mkdir()
    target = tmp_path / "deep" / "my.yaml"
    monkeypatch.chdir(tmp_path)
    target.write_text(first_scenario(target, Wish("page.txt")), encoding="utf-8")
    assert "sensor: ../page.txt" in target.read_text(encoding="utf-8")
    scenario = load("deep/my.yaml")
    assert scenario.truth is not None
    assert scenario.truth.models() == models("page.txt")
    resolved = scenario.model_dump(mode="json", exclude_none=True)
    assert load_of(resolved, tmp_path / "resolved.yaml").truth == scenario.truth


def load_of(data: object, path: Path) -> Scenario:
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return load(path)


# -- sensors by name --------------------------------------------------------------------------------------------------------------

BASE = {
    "title": "t",
    "trajectory": {"builtin": "urban_drive_1"},
    "gnss": {"position_sigma": "1 m"},
    "designs": {"one": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}


def scenario_of(**changes: object) -> Scenario:
    return validated(Scenario, yamlfile.parse(yaml.safe_dump(BASE | changes), "s.yaml"))


def test_a_truth_and_a_design_take_the_models_of_a_sensor_and_what_stands_beside_wins() -> None:
    white = "WN(N=1 ug/sqrt(Hz))"
    scenario = scenario_of(
        truth={"sensor": "BMI088", "accel_y": white},
        designs={
            "sensor": {"gyro": {"sensor": "ADIS16470"}, "accel": {"sensor": "bmi-088", "case": "worst"}},
            "whole": {"sensor": "STIM300", "accel": white},
            "axis": {"sensor": "STIM300", "gyro_z": {"sensor": "LN-200"}},
        },
    )
    assert scenario.truth is not None
    truth = scenario.truth.models()
    assert truth == models("BMI088") | {"accel_y": noise.NoiseModel.parse(white, "m/s^2")}
    assert truth["accel_z"] != truth["accel_x"]

    def believed(name: str) -> dict[str, noise.NoiseModel]:
        return {
            axis: source if isinstance(source, noise.NoiseModel) else noise.NoiseModel.from_list(source.model)
            for axis, source in scenario.designs[name].sources().items()
        }

    found = believed("sensor")
    assert {a: found[a] for a in AXES[:3]} == {a: models("ADIS16470")[a] for a in AXES[:3]}
    assert {a: found[a] for a in AXES[3:]} == {a: models("BMI088", "worst")[a] for a in AXES[3:]}
    assert believed("whole")["gyro_y"] == models("STIM300")["gyro_y"]
    assert str(believed("whole")["accel_x"]) == str(noise.NoiseModel.parse(white, "m/s^2"))
    assert believed("axis")["gyro_z"] == models("LN-200")["gyro_z"]
    assert believed("axis")["gyro_x"] == models("STIM300")["gyro_x"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"truth": {"sensor": "ADIS1647"}}, "s.yaml:.*truth.*no sensor 'ADIS1647'"),
        ({"truth": {"sensor": "ADIS16470", "case": "best"}}, "unknown case 'best'"),
        ({"truth": {"sensor": 3}}, "found 3, expected the name of a sensor"),
        ({"truth": {"case": "worst", "gyro": "WN(N=1)", "accel": "WN(N=1)"}}, "found 'case' without the key 'sensor'"),
        (
            {"designs": {"a": {"gyro": {"sensor": "VN-100", "fit": "WN()"}, "accel": {"truth": True}}}},
            "gyro: found 'fit' together with 'sensor'",
        ),
    ],
)
def test_a_sensor_that_is_not_there_is_refused_with_its_place(changes, message) -> None:
    with pytest.raises(InputError, match=message):
        scenario_of(**({"truth": {"sensor": "VN-100"}} | changes))


def test_the_package_has_the_scenarios_where_it_looks() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '"scenarios" = "insemu/scenarios"' in text
    assert Path(shipped._PACKAGE, "scenarios") in shipped._FOLDERS


# -- shell completion -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "found"),
    [("insemu in", ["init"]), ("insemu g", ["gap", "gap-check"]), ("insemu init --tr", ["--track"])],
)
def test_the_shell_completes_commands_and_options(words: str, found: list[str]) -> None:
    env = {"_INSEMU_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    assert CliRunner().invoke(app, [], prog_name="insemu", env=env).output.split() == found


def test_fitted_models_are_the_truth(tmp_path: Path) -> None:
    from insemu.noise import GM, WN, NoiseModel, save

    target, models = tmp_path / "my.yaml", tmp_path / "sensor.yaml"
    both = {a: NoiseModel((WN(1e-4), GM(sigma=1e-5, beta=0.01))) for a in AXES}
    save(both, models)
    target.write_text(first_scenario(target, Wish(model=str(models))), encoding="utf-8")
    scenario = load(target)
    assert scenario.truth is not None
    assert scenario.truth.models()["gyro_y"] == both["gyro_y"]
    assert list(scenario.designs) == ["complete", "white noise"]
    save({a: NoiseModel((WN(1e-4),)) for a in AXES}, models)  # nothing to leave out
    target.write_text(first_scenario(target, Wish(model=str(models))), encoding="utf-8")
    assert list(load(target).designs) == ["complete", "double"]
    save({a: NoiseModel((GM(sigma=1e-5, beta=0.01),)) for a in AXES}, models)
    with pytest.raises(InputError, match="no white noise of the gyro"):
        first_scenario(target, Wish(model=str(models)))
