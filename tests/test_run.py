"""``insemu run`` as a user types it: results, resume, reproducibility, and every way of getting the input wrong."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import portalocker
import pytest
import yaml

from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import Experiment, Resources, run_experiment
from insemu.evaluate.folder import only_writer
from insemu.scenario import load

pytestmark = pytest.mark.usefixtures("without_pictures")

SCENARIO: dict[str, Any] = {
    "title": "small <b>flight</b>",
    "seed": 3,
    "realizations": 2,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "120 s"},
    "truth": {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=40 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + RW(K=30 ug*sqrt(Hz))",
    },
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "2 cm/s", "outages": [{"start": "80 s", "duration": "20 s"}]},
    "fits": {"simulate": "300 s"},
    "designs": {
        "white": {"gyro": {"fit": "WN()"}, "accel": {"fit": "WN()"}},
        "full": {"gyro": {"truth": True}, "accel": {"truth": True}},
    },
    "variants": {"coarse": {"gnss": {"position_sigma": "1 m"}}},
}


def write(tmp_path: Path, **changes: Any) -> Path:
    return write_named(tmp_path, "s.yaml", **changes)


def write_named(tmp_path: Path, name: str, **changes: Any) -> Path:
    path = tmp_path / name
    path.write_text(yaml.safe_dump(SCENARIO | changes, sort_keys=False), encoding="utf-8")
    return path


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["run", *arguments])
    return int(stop.value.code or 0)


@pytest.mark.pictures
def test_a_run_leaves_table_page_and_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(str(write(tmp_path)), "--workers", "2", "--variants", "--output", str(out), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "summary.json").read_text())
    assert list(printed) == ["scenario", "digest", "seed", "realizations", "designs", "comparisons", "filter_epochs"]
    assert printed["designs"]["white"]["states"] == 9
    assert printed["designs"]["full"]["states"] == 15
    outage = printed["designs"]["full"]["outages"][0]
    assert (outage["start_s"], outage["duration_s"]) == (80.0, 20.0)
    assert len(outage["planimetric_end_m"]["per_realization"]) == 2
    assert {"position", "velocity", "attitude"} == set(outage["coverage_3sigma"])
    assert printed["filter_epochs"] == 2 * 2 * 6000
    for name in (
        "index.html",
        "outages.csv",
        "errors.nc",
        "manifest.json",
        "resolved.yaml",
        "figures/flight.png",
        "figures/error_growth.svg",
        "variants/coarse/summary.json",
    ):
        assert (out / name).stat().st_size > 0
    page = (out / "index.html").read_text()
    assert "small &lt;b&gt;flight&lt;/b&gt;" in page
    assert "<b>flight" not in page
    assert load(out / "resolved.yaml").truth.models() == load(tmp_path / "s.yaml").truth.models()
    listed = json.loads((out / "complete.json").read_text())["files"]
    assert any("flight.png" in name for name in listed)
    # the same again without pictures: those that are there would belong to no run
    assert run(str(tmp_path / "s.yaml"), "--workers", "1", "--no-pictures", "--output", str(out)) == 0
    left = set(json.loads((out / "complete.json").read_text())["files"])
    assert left == {name for name in listed if not name.startswith("figures")}
    assert not list((out / "figures").iterdir())


def test_warnings_come_before_the_flight_and_leave_json_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    area = {"latitude": "10 deg", "longitude": "10 deg", "radius": "100 m"}
    gnss = SCENARIO["gnss"] | {"areas": [area]}
    path = str(write(tmp_path, gnss=gnss, realizations=1, variants={}))
    assert run(path, "--workers", "1", "--output", str(tmp_path / "out"), "--json") == 0
    out, err = capsys.readouterr()
    json.loads(out)
    assert " ".join(err.split()).count("gnss.areas.0 is never entered") == 1
    assert err.index("Warning: ") < err.index("elapsed")


def test_what_can_hardly_be_meant_is_said(tmp_path: Path) -> None:
    assert Experiment(load(path := write(tmp_path)), path).warnings == ()
    odd = {"gnss": SCENARIO["gnss"] | {"lever_arm": "100 km"}, "initial": {"heading_sigma": "400 deg"}}
    said = Experiment(load(path := write(tmp_path, **odd)), path).warnings
    assert len(said) == 2 and "gnss.lever_arm is 100000 m, expected at most 100 m" in said[0]
    assert "initial.heading_sigma is 400 deg" in said[1]


def test_realizations_are_the_same_alone_in_parallel_and_among_more(tmp_path: Path) -> None:
    path = write(tmp_path)
    few = run_experiment(Experiment(load(path), path), realizations=2, resources=Resources(workers=1))
    more = run_experiment(Experiment(load(path), path), realizations=4, resources=Resources(workers=2))
    np.testing.assert_array_equal(few.error, more.error[:, :2])
    other = run_experiment(Experiment(load(path, overrides={"seed": 4}), path), realizations=2)
    assert not np.array_equal(few.error, other.error)


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
@pytest.mark.pictures
def test_smoother_budget_and_published_figures_come_with_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    published = {
        "source": "a paper",
        "planimetric_mean_m": {"white": [1.5], "full": [1.0]},
        "down_max_m": {"white": [None], "full": [0.5]},
    }
    out = tmp_path / "out"
    path = write(tmp_path, smoother=True, published=published)
    assert run(str(path), "--workers", "1", "--output", str(out)) == 0
    told = " ".join(capsys.readouterr().out.split())
    for words in ("Smoothed backwards", "NEES of the smoother", "Where the metres come from", "largest error down"):
        assert words in told
    full = json.loads((out / "summary.json").read_text())["designs"]["full"]
    row, budget = full["outages"][0], full["error_budget"][0]
    assert row["smoothed"]["middle_rms_m"] < row["smoothed"]["filter_middle_rms_m"]
    assert sum(v**2 for v in budget["parts_rms_m"].values()) == pytest.approx(budget["rms_m"] ** 2, rel=1e-9)
    # matched: what the analysis says is what the filter says
    assert budget["rms_m"] == pytest.approx(row["predicted_sigma_end_m"], rel=0.02)
    page = (out / "index.html").read_text()
    assert "Smoothed" in page and "Where the metres come from" in page
    for name in ("smoothing.png", "budget.svg"):
        assert (out / "figures" / name).stat().st_size > 0
    wrong = write(tmp_path, published={"source": "a paper", "planimetric_mean_m": {"wite": [1.0]}})
    assert run(str(wrong), "--output", str(tmp_path / "no")) == 2
    assert "'wite', which is no design here" in " ".join(capsys.readouterr().err.split())
    none = write(tmp_path, published={"source": "a paper"})
    assert run(str(none), "--output", str(tmp_path / "no")) == 2
    assert "at least one of the keys planimetric_end_m" in " ".join(capsys.readouterr().err.split())


def test_a_smoother_changes_nothing_of_the_filter(tmp_path: Path) -> None:
    path = write(tmp_path, variants={})
    plain = run_experiment(Experiment(load(path), path))
    smoothed = write_named(tmp_path, "smoothed.yaml", variants={}, smoother=True)
    both = run_experiment(Experiment(load(smoothed), smoothed))
    np.testing.assert_allclose(plain.error, both.error, rtol=1e-9, atol=1e-12)
    assert not plain.smoothed and both.smoothed
    # at the last epoch nothing is later: the smoother says what the filter says
    np.testing.assert_allclose(both["smoothed_error"][:, :, -1], both.error[:, :, -1], rtol=1e-6, atol=1e-9)
    assert (both["smoothed_sigma"][1] <= both.sigma[1] * (1 + 1e-6)).all()


def test_an_interrupted_run_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, cache = write(tmp_path), tmp_path / "cache"

    def interrupt(done: int, total: int, label: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_experiment(
            Experiment(load(path), path), realizations=4, resources=Resources(cache=cache, progress=interrupt)
        )
    experiment = Experiment(load(path), path)
    kept = sorted((cache / experiment.digest).iterdir())
    assert len(kept) >= 2
    one, other = kept[0].read_bytes(), kept[1].read_bytes()
    flown: list[int] = []
    fly = experiment.side_by_side
    monkeypatch.setattr(experiment, "side_by_side", lambda indices: (flown.extend(indices), fly(indices))[1])
    for damaged in (b"half-written", one[:-7], other, one.replace(experiment.digest.encode(), b"0" * 16)):
        kept[0].write_bytes(damaged)
        said: list[str] = []
        flown.clear()
        resumed = run_experiment(experiment, realizations=len(kept), resources=Resources(cache=cache, say=said.append))
        assert flown == [int(kept[0].name)]
        assert len(said) == 1 and "is damaged" in said[0]
    resumed = run_experiment(experiment, realizations=4, resources=Resources(cache=cache))
    whole = run_experiment(Experiment(load(path), path), realizations=4)
    # the same to rounding: vector lanes of the platform's mathematics depend on how memory happens to be aligned
    np.testing.assert_allclose(resumed.error, whole.error, rtol=1e-9, atol=1e-12)


def test_a_second_run_with_fewer_realizations_replaces_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = (
        str(write(tmp_path, variants={}, fits=None, designs={"full": SCENARIO["designs"]["full"]})),
        "--output",
        str(out),
    )
    assert run(*arguments) == 0
    marker = json.loads((out / "complete.json").read_text())
    assert marker["realizations"] == 2 and {"summary.json", "errors.nc", "index.html"} <= set(marker["files"])
    before = (out / "summary.json").read_bytes()
    capsys.readouterr()
    assert run(*arguments, "--realizations", "1") == 2
    assert "holds 2 realizations of this scenario" in " ".join(capsys.readouterr().err.split())
    assert (out / "summary.json").read_bytes() == before
    assert run(*arguments, "--realizations", "1", "--overwrite") == 0
    assert json.loads((out / "complete.json").read_text())["realizations"] == 1


def test_one_folder_has_one_writer(tmp_path: Path) -> None:
    code = "import sys, pathlib; from insemu.evaluate.folder import only_writer\nwith only_writer(pathlib.Path(sys.argv[1])): input()"
    other = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, text=True)
    try:
        while not (tmp_path / ".writer").exists():
            assert other.poll() is None
        with pytest.raises(InputError, match=f"being written by process {other.pid}"), only_writer(tmp_path):
            pass
        other.kill()  # whatever ends a process gives its folder back
        other.wait()
        with only_writer(tmp_path):
            assert f"process {os.getpid()} " in (tmp_path / ".writer").read_text()
            assert (tmp_path / ".lock").read_bytes() == b""  # nobody can read a locked file on Windows
        assert list(tmp_path.iterdir()) == []
    finally:
        other.kill()
        other.communicate()


def test_refused_input_leaves_no_folder_that_was_made_for_it(tmp_path: Path) -> None:
    for kept in (False, True):
        folder = tmp_path / "results" / "a"
        with pytest.raises(InputError), only_writer(folder):
            if kept:
                (folder / "part").write_bytes(b"finished")
            raise InputError("refused")
        assert (folder.exists(), (tmp_path / "results").exists()) == (kept, kept)
        assert not kept or [f.name for f in folder.iterdir()] == ["part"]


def test_what_a_killed_writer_left_half_written_is_removed(tmp_path: Path) -> None:
    (tmp_path / "variants" / "late" / "figures").mkdir(parents=True)
    deep = "variants/late/figures/.end.png.17.partial.png"
    for name in (".errors.nc.17.partial.nc", deep, ".partial", "my.partial.nc"):
        (tmp_path / name).write_bytes(b"half")
    with only_writer(tmp_path, shared=True):
        assert (tmp_path / ".errors.nc.17.partial.nc").exists()  # of somebody else, perhaps
    with only_writer(tmp_path):
        pass
    assert {p.name for p in tmp_path.rglob("*") if p.is_file()} - {".lock", ".writer"} == {".partial", "my.partial.nc"}


@pytest.mark.skipif(os.name == "nt", reason="a process of Windows leaves no lock to those that it started")
def test_what_a_killed_writer_left_behind_is_waited_for(tmp_path: Path) -> None:
    code = """
import os, pathlib, sys, time
from insemu.evaluate.folder import only_writer
with only_writer(pathlib.Path(sys.argv[1])):
    if os.fork():
        os._exit(9)
    time.sleep(1.5)
    os._exit(0)
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    started = time.monotonic()
    with only_writer(tmp_path):
        assert 0.2 < time.monotonic() - started < 15.0
        assert f"process {os.getpid()} " in (tmp_path / ".writer").read_text()


def test_writers_that_come_and_go_are_never_two_at_a_time(tmp_path: Path) -> None:
    # each takes the folder 200 times, and the lock is removed each time: whoever loses an update was not alone
    values = [0]

    def writer() -> None:
        held = 0
        while held < 200:
            try:
                with only_writer(tmp_path):
                    value = values[-1]
                    time.sleep(1e-4)
                    values.append(value + 1)
                    held += 1
            except InputError:
                time.sleep(0)

    with ThreadPoolExecutor(3) as pool:  # a lock belongs to an open file, so threads exclude each other as processes do
        for done in [pool.submit(writer) for _ in range(3)]:
            done.result()
    assert values == list(range(601))


def test_a_file_system_that_cannot_lock_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise portalocker.LockException("No locks available")

    monkeypatch.setattr("portalocker.lock", refuse)
    with pytest.raises(InputError, match=r"cannot lock files \(No locks available\)"), only_writer(tmp_path):
        pass


def test_what_fails_after_flying_loses_no_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise InputError("no budget today")

    monkeypatch.setattr("insemu.evaluate.analyse_designs", fail)
    monkeypatch.setattr("insemu.report.experiment.render_experiment", fail)
    out = tmp_path / "out"
    path = write(tmp_path, variants={}, realizations=1, fits=None, designs={"full": SCENARIO["designs"]["full"]})
    assert run(str(path), "--output", str(out)) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "Failed: the error budget: no budget today" in told and "Failed: the page: no budget today" in told
    assert json.loads((out / "summary.json").read_text())["realizations"] == 1
    assert (out / "outages.csv").read_text().startswith("design,outage,start_s")


def test_eighty_columns_show_what_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, variants={}, realizations=1, fits=None, designs={"full": SCENARIO["designs"]["full"]})
    written = io.BytesIO()
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(written, encoding="ascii"))
    assert run(str(path), "--no-pictures", "--output", str(tmp_path / "out")) == 0
    sys.stdout.flush()
    lines = written.getvalue().decode("ascii").splitlines()
    header = next(line for line in lines if line.startswith("design"))
    assert header.split()[:2] == ["design", "verdict"] and "in 3 s" in header and "NEES" in header
    assert len(header.rstrip()) <= 80


def signals(tmp_path: Path, rows: int = 50 * 130, **changes: Any) -> Path:
    data = np.random.default_rng(1).standard_normal((rows, 6)) * 1e-3
    path = tmp_path / "log.npz"
    arrays = {
        "data": data,
        "fs": np.float64(50.0),
        "columns": np.array(["gx", "gy", "gz", "ax", "ay", "az"]),
        "units": np.array(["rad/s"] * 3 + ["m/s^2"] * 3),
    } | changes
    np.savez(path, **arrays)
    return path


RECORDED = {
    "truth": {"recorded": {"files": ["log.npz"]}},
    "fits": {"recorded": {"files": ["log.npz"]}},
    "designs": {"white": {"gyro": {"fit": "WN()"}, "accel": {"fit": "WN()"}}},
    "realizations": 1,
    "variants": {},
}


def test_recorded_errors_fly(tmp_path: Path) -> None:
    signals(tmp_path)
    path = write(tmp_path, **RECORDED)
    r = run_experiment(Experiment(load(path), path))
    assert np.isfinite(r.error).all()
    assert r.names == ["white"]


def test_pieces_are_taken_in_the_order_asked_for(tmp_path: Path) -> None:
    signals(tmp_path, rows=50 * 250)
    natural = write(tmp_path, **RECORDED)
    swapped = write_named(
        tmp_path, "swapped.yaml", **RECORDED | {"truth": {"recorded": {"files": ["log.npz"], "order": [1, 0]}}}
    )
    one, two = (Experiment(load(p), p).world.pieces for p in (natural, swapped))
    np.testing.assert_array_equal(one.piece(0)[0], two.piece(1)[0])
    assert not np.array_equal(one.piece(0)[0], one.piece(1)[0])
    wrong = write_named(
        tmp_path, "wrong.yaml", **RECORDED | {"truth": {"recorded": {"files": ["log.npz"], "order": [1, 2]}}}
    )
    with pytest.raises(InputError, match="at most once, from 0 to 1"):
        Experiment(load(wrong), wrong)


def test_effects_of_sensor_time_and_place_fly(tmp_path: Path) -> None:
    """Late, dropped and distorted samples are compared with the truth at their stamps; an area gives an outage per passage."""
    effects = [
        {"effect": "scale_factor", "sensor": "accel", "value": "2000 ppm"},
        {"effect": "dropped_samples", "probability": 0.001},
        {"effect": "imu_gnss_time_offset", "offset": "2 ms"},
    ]
    path = write(tmp_path, truth=SCENARIO["truth"] | {"effects": effects}, variants={})
    plain = write_named(tmp_path, "plain.yaml", variants={})
    r = run_experiment(Experiment(load(path), path), realizations=1)
    p = run_experiment(Experiment(load(plain), plain), realizations=1)
    assert np.isfinite(r.error).all()
    assert r.error.shape == p.error.shape
    assert not np.array_equal(r.error, p.error)
    assert r.digest != p.digest


def test_a_later_begin_keeps_flight_and_clock(tmp_path: Path) -> None:
    whole = Experiment(load(write(tmp_path))).world
    later = Experiment(
        load(write_named(tmp_path, "t.yaml", trajectory=SCENARIO["trajectory"] | {"begin": "30 s"}))
    ).world
    assert later.reference.t[0] == pytest.approx(30.0) and later.reference.t[-1] == pytest.approx(whole.reference.t[-1])
    assert later.outage_windows == whole.outage_windows == [(80.0, 20.0)]
    rows = len(whole.reference) - len(later.reference)
    assert later.reference.llh[-1] == pytest.approx(whole.reference.llh[-1], abs=1e-4, rel=1e-9)
    assert later.imu.gyro[10:] == pytest.approx(whole.imu.gyro[rows + 10 :], abs=1e-9)
    assert later.start(0, later.imu)[0].vel_ned == pytest.approx(later.reference.vel_ned[0], abs=0.5)


@pytest.mark.parametrize(
    ("changes", "log", "message"),
    [
        (
            {"gnss": {"outages": [{"start": "110 s", "duration": "20 s"}]}},
            {},
            "outage 1 ends at 130 s, but the trajectory ends at 120 s",
        ),
        (
            {
                "trajectory": SCENARIO["trajectory"] | {"begin": "61 s"},
                "gnss": {"outages": [{"start": "1 min", "duration": "20 s"}]},
            },
            {},
            "outage 1 begins at 60 s, but filters begin at 61 s",
        ),
        (
            {"trajectory": SCENARIO["trajectory"] | {"begin": "3 min"}},
            {},
            "filters begin at 180 s, but the trajectory ends at 120 s",
        ),
        ({"gnss": {"outages": [{"strat": "110 s", "duration": "20 s"}]}}, {}, "did you mean 'start'"),
        ({"truth": SCENARIO["truth"] | {"gyro": "WN(N=-1 deg/sqrt(h))"}}, {}, "not negative"),
        ({"gnss": {"position_sigma": "1 deg"}}, {}, "another dimension"),
        ({"trajectory": {"builtin": "helicopter_maping"}}, {}, "did you mean 'helicopter_mapping'"),
        (RECORDED | {"truth": {"recorded": {"files": ["absent.npz"]}}}, {}, "absent.npz: no such file"),
        (RECORDED, {"rows": 50 * 100}, "has 100 s, shorter than the flight of 120 s"),
        (RECORDED | {"realizations": 2}, {}, "2 realizations of 120 s asked for, but the recorded signals hold 1"),
        (RECORDED, {"data": np.full((7000, 6), np.nan)}, "not finite"),
        (RECORDED, {"fs": np.float64(100.0)}, "expected the IMU rate of 50 Hz"),
        (RECORDED, {"columns": np.array(["gx", "gy", "gz", "ax", "ay", "temperature"])}, "no column for accel_z"),
        ({"truth": SCENARIO["truth"] | {"record": "60 s"}}, {}, "record of 60 s is shorter than the flight"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_nothing_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], log: dict[str, Any], message: str
) -> None:
    signals(tmp_path, **log)
    out = tmp_path / "out"
    assert run(str(write(tmp_path, **changes)), "--output", str(out)) == 2
    error = capsys.readouterr().err
    assert message in " ".join(error.split())
    assert "Traceback" not in error
    assert not out.exists()


def test_help_is_light() -> None:
    code = (
        "import sys; sys.argv = ['insemu', '--help']\n"
        "import insemu.cli\n"
        "try:\n    insemu.cli.main()\nexcept SystemExit:\n    pass\n"
        "heavy = {'numba', 'scipy', 'matplotlib', 'xarray', 'filterpy', 'pandas', 'pydantic'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "characterise" in done.stdout or "run" in done.stdout


def test_schema_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["schema"])
    assert json.loads(capsys.readouterr().out)["title"] == "insemu scenario"
