"""The intake card: wrong declarations are refused or named with the command that mends them, right recordings never refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import earth, formats, rotation
from insemu.cli import main
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.formats import Opened, open_files, write
from insemu.formats.columns import parse_map
from insemu.intake import card_of, examine
from insemu.intake.checks import mounting
from insemu.intake.fixes import OFFSET_NATS, against_fixes, against_reference, offset
from insemu.records import AidRecord, GnssRecord, Recording, Series, Trajectory
from tests.file_samples import KINDS, drive, mapped_csv
from tests.shared_data import shared
from tests.wrong_recordings import (
    WRONG,
    Wrong,
    flown,
    in_radians,
    late,
    mounted,
    named,
    right,
    scaled,
    swapped,
    velocities,
)

#: Settings that a mending command may hold; a position that was named is applied and the card made again.
_MEND = re.compile(r'--map "([^"]+)"')


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def test_fifty_one_recordings_are_spoilt() -> None:
    assert len(WRONG) == 51


@pytest.mark.parametrize("which", ["urban_motorway", "turbulent_uav", "survey", "static"])
@pytest.mark.parametrize("shift", [0.0, 2.0])
def test_fixes_of_the_reference_s_datum_are_not_moved(which: str, shift: float) -> None:
    """Nor those of another clock, which lie as far behind on a motorway as another datum would."""
    made = flown(which, seconds=120.0, ahead=3.0, referenced=True)
    assert made.gnss is not None
    shifted = replace(made, gnss=replace(made.gnss, t=made.gnss.t + shift))
    assert not any(line.topic == "reference" and line.level != "ok" for line in examine(shifted).lines)


def test_on_a_straight_way_a_clock_is_no_datum() -> None:
    t = np.arange(0.0, 100.0, 1.0)
    way = earth.move(np.array([0.8, 0.1, 300.0]), np.outer(t, [30.0, 0.0, 0.0]))
    reference = Trajectory(t, way, np.tile([30.0, 0.0, 0.0], (t.size, 1)), np.zeros((t.size, 3)))
    assert against_reference(GnssRecord(t + 2.0, way), reference) == []
    (line,) = against_reference(GnssRecord(t + 2.0, earth.move(way, np.array([0.0, 50.0, 0.0]))), reference)
    assert line.mend == '--map "gnss_move=0 -50.0 0"'


@pytest.mark.parametrize("wrong", WRONG, ids=lambda w: w.name)
def test_a_wrong_declaration_is_refused_or_named_with_the_command_that_mends_it(wrong: Wrong) -> None:
    found, card = named(replace(wrong, base={"seconds": 160.0} | wrong.base))
    assert found, card


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_forty_right_recordings_are_not_refused() -> None:
    refused, odd = {}, {}
    recordings = right()
    assert len(recordings) == 40
    for name, data in recordings.items():
        card = examine(data)
        if card.of("wrong"):
            refused[name] = card.text(("wrong",))
        if card.of("odd"):
            odd[name] = card.text(("odd",))
    assert not refused
    assert len(odd) <= 2, odd  # odd is no refusal, but a card that cries is not read


@pytest.mark.parametrize(
    "spoil",
    [
        scaled(gyro=180 / np.pi),
        scaled(accel=1 / 9.80665),
        swapped(),
        in_radians(),
        velocities((1, 0, 2), (1, 1, -1), 1.0),
    ],
)
def test_the_mending_command_mends(spoil, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    """What the card says to add to the command makes the recording right again, through the file and the command line."""
    spoilt = spoil(flown())
    path = tmp_path / "rec.npz"
    imu = spoilt.imu
    np.savez(
        path, imu_kind="mean", imu_t=imu.t, imu=np.hstack([imu.gyro, imu.accel]), gnss_t=spoilt.gnss.t,
        gnss_llh=spoilt.gnss.llh * [180 / np.pi, 180 / np.pi, 1.0], gnss_vel_ned=spoilt.gnss.vel_ned,
    )  # fmt: skip
    card = examine(open_files(path))
    mends = [m for line in (*card.of("wrong"), *card.of("odd")) for m in _MEND.findall(line.mend)]
    assert mends
    code = run("open", path, "--map", ", ".join(dict.fromkeys(mends)), "--output", tmp_path / "corrected.npz")
    assert code == 0, capsys.readouterr()
    back = formats.read_recording(tmp_path / "corrected.npz")
    want = flown()
    assert want.imu is not None and want.gnss is not None
    np.testing.assert_allclose(back.imu.gyro, want.imu.gyro, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(back.imu.accel, want.imu.accel, rtol=1e-9)
    np.testing.assert_allclose(back.gnss.llh, want.gnss.llh, rtol=1e-12)  # type: ignore[union-attr]
    np.testing.assert_allclose(back.gnss.vel_ned, want.gnss.vel_ned)  # type: ignore[union-attr, arg-type]


@pytest.mark.parametrize("rpy", [(180, 0, 0), (0, 0, 90), (180, 0, 90), (90, 0, 0), (10, -20, 60)])
def test_the_mounting_that_is_named_is_the_mounting(rpy: tuple[float, float, float]) -> None:
    card = examine(mounted(*rpy)(flown()))
    (line,) = [x for x in card.lines if x.topic == "axes"]
    given = [float(v) for v in re.findall(r"-?[0-9.]+", line.text.split("roll ")[1])[:3]]
    turn = rotation.dcm_from_rpy(np.deg2rad(given)) @ rotation.dcm_from_rpy(np.deg2rad(rpy)).T
    # the mean tilt of a driving car and three minutes of fixes tell the mounting to some degrees
    assert np.rad2deg(np.linalg.norm(rotation.vector_from_dcm(turn))) < 8.0


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 30.0), (180.0, 0.0, -120.0), (40.0, 20.0, 10.0)])
def test_mounting_angles_from_up_and_forward(rpy: tuple[float, float, float]) -> None:
    C = rotation.dcm_from_rpy(np.deg2rad(rpy))
    up = C.T @ [0.0, 0.0, -1.0]
    level = C[:2, 0]
    np.testing.assert_allclose(mounting(up, float(np.arctan2(level[1], level[0]))), rpy, atol=1e-9)


@pytest.mark.parametrize("name", ["rtkexp_drive", "ublox_mixed_nominal", "thor75_uav_flight"])
def test_real_recordings_are_understood(name: str) -> None:
    card = card_of(shared(f"real/{name}.npz")).check()
    axes = next(x for x in card.lines if x.topic == "axes")
    wanted = {
        "rtkexp_drive": "roll -180, pitch 7, yaw -174",
        "ublox_mixed_nominal": "-x points up",
        "thor75_uav_flight": "z down",
    }
    assert wanted[name] in axes.text
    assert next(x for x in card.lines if x.topic == "motion").level == "ok"
    assert any("repeat the six values" in x.text for x in card.of("odd")) == (name == "rtkexp_drive")


# ------------------------------------------------------------------------------------------------------------- logs at rest


def _rest(path: Path, gyro: float, accel: float, header: str) -> Path:
    rng = np.random.default_rng(4)
    n = 4000
    block = np.column_stack(
        [0.02 * rng.standard_normal((n, 3)) + 0.4, 0.01 * rng.standard_normal((n, 3)) + [0, 0, -9.81]]
    )
    block = block * np.repeat([np.deg2rad(gyro), accel], 3)
    np.savetxt(path, np.column_stack([np.arange(n) / 100.0, block]), delimiter=",", header=header, comments="")
    return path


def test_a_log_at_rest_in_deg_per_s_without_a_unit_is_refused_with_its_mend(tmp_path: Path) -> None:
    path = _rest(tmp_path / "a.csv", 180 / np.pi, 1.0, "t,gx,gy,gz,ax,ay,az")
    with pytest.raises(InputError, match=r'insemu open .*a.csv --map "gyro_unit=deg/s"'):
        card_of(path).check()
    assert run("open", path, "--map", "gyro_unit=deg/s", "--output", tmp_path / "b.npz") == 0
    card_of(tmp_path / "b.npz").check()
    np.testing.assert_allclose(np.mean(formats.read_log(tmp_path / "b.npz").columns[0]), np.deg2rad(0.4), rtol=0.01)


def test_a_log_at_rest_with_its_units_is_right(tmp_path: Path) -> None:
    card = card_of(_rest(tmp_path / "a.csv", 1.0, 1.0, "t,gx,gy,gz,ax,ay,az")).check()
    assert any("rad/s is assumed" in x.text for x in card.of("assumed"))
    stated = card_of(
        _rest(tmp_path / "b.csv", 1.0, 1.0, "t,gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]")
    )
    assert not stated.of("assumed") and not stated.of("wrong")


# --------------------------------------------------------------------------------------------------------------- the command


@pytest.mark.parametrize(
    "name", ["PX4 ULog", "ROS 2 bag, MCAP", "phyphox zip", "any CSV, known names", "RTKLIB .pos", "static log .npz"]
)
def test_open_prints_a_card(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("open", KINDS[name](tmp_path).path, "--json") == 0
    card = json.loads(capsys.readouterr().out)
    assert {x["topic"] for x in card["lines"]} >= ({"fixes"} if name.startswith("RTK") else {"rate"})


def test_three_files_become_one_recording_by_the_command(tmp_path: Path) -> None:
    written = KINDS["three files, one recording"](tmp_path)
    options = dict(written.options)
    code = run(
        "open", written.path, "--gnss", options["gnss"], "--truth", options["truth"], "--output", tmp_path / "rec.npz"
    )
    assert code == 0
    back = formats.read_recording(tmp_path / "rec.npz")
    assert back.gnss is not None and back.reference is not None and back.imu.kind == "increment"


def test_a_map_is_kept_beside_the_file_and_used_by_all(tmp_path: Path) -> None:
    path = mapped_csv(tmp_path).path
    assert run("open", path, "--map", "gyro=om_*[deg/s], accel=s_*[g], time=stamp[ns]", "--save-map") == 0
    kept = path.with_name(path.name + ".map.yaml")
    assert kept.is_file()
    log = formats.read_log(path)
    assert log.rate_hz == 50.0
    np.testing.assert_allclose(log.columns[3], drive().imu.accel[:, 0], atol=1e-6)


def test_a_refused_name_of_the_result_leaves_no_map(tmp_path: Path) -> None:
    path = mapped_csv(tmp_path).path
    said = ("--map", "gyro=om_*[deg/s], accel=s_*[g], time=stamp[ns]", "--save-map")
    assert run("open", path, *said, "--output", tmp_path / "a.tum") == 2
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_what_contradicts_physics_is_refused_and_nothing_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = flown()
    assert data.imu is not None
    spoilt = replace(data.imu, accel=data.imu.accel * data.imu.dt, gyro=data.imu.gyro * data.imu.dt)
    path = write(tmp_path / "a.npz", Recording(spoilt, data.gnss))
    assert run("open", path, "--output", tmp_path / "b.npz") == 2
    assert '--map "kind=increment"' in capsys.readouterr().err
    assert not (tmp_path / "b.npz").exists()
    assert run("open", path, "--map", "kind=increment", "--output", tmp_path / "b.npz") == 0


def test_a_single_axis_has_a_card_and_no_recording(tmp_path: Path) -> None:
    path = write(
        tmp_path / "one.csv", [Series(np.random.default_rng(1).standard_normal(64) * 1e-4, 100.0, "rad/s", "gyro_x")]
    )
    assert run("open", path) == 0
    assert run("open", path, "--output", tmp_path / "x.npz") == 2


def test_the_kinds_of_file_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("open", "--formats") == 0
    assert len(capsys.readouterr().out.splitlines()) >= 25
    assert run("open") == 2


def test_rows_with_wrong_stamps_are_used_and_those_left_out_are_counted(tmp_path: Path) -> None:
    imu = drive().imu
    t, gyro = imu.t.copy(), imu.gyro.copy()
    t[100], t[200], gyro[300] = t[99], t[150], np.nan
    np.savetxt(
        tmp_path / "a.csv",
        np.column_stack([t, gyro, imu.accel]),
        delimiter=",",
        header="t,wx,wy,wz,fx,fy,fz",
        comments="",
    )
    found = open_files(tmp_path / "a.csv")
    assert (found.repeated, found.missing) == (0, 1) and found.imu is not None and len(found.imu) == t.size - 1
    np.testing.assert_allclose(
        found.imu.t + found.origin.ns / 1e9, np.delete(imu.t, 300), atol=1e-3
    )  # wrong stamps are put right, their rows are used
    assert any("left out" in x.text for x in examine(found).of("odd"))


def test_settings_are_checked_before_a_file_is_read() -> None:
    for line, said in (
        ("latlon=maybe", "expected one of: swapped"),
        ("gyro_unit=m", "none of rad/s"),
        ("shift=3 m", "dimension"),
        ("kind=rate", "expected one of"),
    ):
        with pytest.raises(InputError, match=said):
            parse_map(line)


def test_nothing_is_said_of_too_little(tmp_path: Path) -> None:
    data = flown(seconds=5.0)
    assert data.imu is not None
    card = examine(
        Opened(
            "a",
            "b",
            replace(data.imu, t=data.imu.t[:60], gyro=data.imu.gyro[:60], accel=data.imu.accel[:60]),
            data.gnss,
        )
    )
    assert not card.of("wrong")


@pytest.mark.parametrize("arguments", [("fit", "--model", "WN()"), ("select",), ("gap",)])
def test_commands_refuse_what_the_card_refuses(
    arguments: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = _rest(tmp_path / "a.csv", 180 / np.pi, 1.0, "t,gx,gy,gz,ax,ay,az")
    model = tmp_path / "m.yaml"
    model.write_text("gyro: WN(N=0.01 deg/s/sqrt(Hz))\naccel: WN(N=100 ug/sqrt(Hz))\n")
    given = (str(model), str(path)) if arguments[0] == "gap" else (str(path), *arguments[1:])
    assert run(arguments[0], *given) == 2
    assert '--map "gyro_unit=deg/s"' in capsys.readouterr().err


def test_the_card_of_a_recorded_scenario_is_in_its_summary(tmp_path: Path) -> None:
    from insemu.evaluate.recorded import RecordedWorld
    from insemu.scenario import load

    data = flown()
    assert data.imu is not None
    write(tmp_path / "drive.npz", Recording(data.imu, data.gnss))
    (tmp_path / "s.yaml").write_text(
        "title: t\nrecording: {file: drive.npz}\ngnss: {position_sigma: 1 m}\n"
        "designs: {a: {gyro: 'WN(N=0.02 deg/s/sqrt(Hz))', accel: 'WN(N=200 ug/sqrt(Hz))'}}\n"
    )
    card = RecordedWorld(load(tmp_path / "s.yaml"), tmp_path / "s.yaml").card
    assert {"rate", "axes", "clock", "motion"} <= {x.topic for x in card.of("ok")}


def test_a_stamp_far_away_does_not_hang_the_card() -> None:
    data = flown(seconds=60.0)
    assert data.gnss is not None
    t = data.gnss.t.copy()
    t[-1] = 1e15
    assert examine(replace(data, gnss=replace(data.gnss, t=t))).lines


@pytest.mark.parametrize(("seconds_late", "says"), [(0.0, "antenna ahead"), (2.0, "gnss_shift=-")])
def test_an_antenna_ahead_of_the_imu_is_not_taken_for_a_late_clock(seconds_late: float, says: str) -> None:
    opened = late(seconds_late)(flown(seconds=480.0, sigma=0.2, ahead=3.0))
    assert opened.imu is not None and opened.gnss is not None
    turn, _ = against_fixes(opened.imu, opened.gnss, None)
    assert turn is not None and turn.gain_nats > OFFSET_NATS  # without the lever arm, both look like an offset
    (line,) = offset(turn)
    assert says in line.text + (line.mend or "")


def test_aids_of_our_own_layout_are_on_the_card_and_go_on(tmp_path) -> None:
    recording = _with_aid(tmp_path / "drive.npz")
    found = open_files(tmp_path / "drive.npz")
    (line,) = [line for line in examine(found).lines if line.topic == "barometer"]
    assert line.text == "120 measurements at 2 Hz, stated standard deviations 0.5 (SI, median)"
    write(tmp_path / "copy.npz", found.recording())
    (aid,) = formats.read(tmp_path / "copy.npz").aids
    np.testing.assert_array_equal(aid.values, recording.aids[0].values)


def _with_aid(path):
    imu = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 70.0))
    t = 1.0 + 0.5 * np.arange(120)
    aid = AidRecord("barometer", t, 240.0 + np.sin(t)[:, None], np.full((120, 1), 0.5))
    recording = Recording(
        imu.imu, gnss_fixes(imu.reference, 1.0, rng=np.random.default_rng(1)), imu.reference, "d", (aid,)
    )
    write(path, recording)
    return recording
