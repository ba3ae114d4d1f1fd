"""The referee: what it says of right and wrong filters, what it would have found, and that it repeats to the byte."""

import json

import numpy as np
import pytest
from scipy import stats

import insemu as ins
from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import CACHE, Experiment, share_interval, smallest_found
from insemu.evaluate.verdict import MEAN_SQUARE
from insemu.filters import named_filter
from insemu.filters.adapters.files import COLUMNS
from insemu.referee import POWER, Flights, referee, worlds
from tests.budget import statistical

WRONG = "tests/wrong_filters.py"
FEW = ("rest", "turns", "wrong fixes")


@pytest.mark.parametrize("dof", [30, 144, 5000])
def test_the_smallest_error_that_is_found_is_an_exact_quantile(dof):
    low, high = stats.chi2.ppf([1e-4, 1 - 1e-4], dof) / dof
    few, many = smallest_found((low, high), dof, POWER)
    passed = max(high, 1 + MEAN_SQUARE), min(low, 1 - MEAN_SQUARE)
    assert stats.chi2.sf(passed[0] * dof * (1 - few) ** 2, dof) == pytest.approx(POWER, abs=1e-9)
    assert stats.chi2.cdf(passed[1] * dof * (1 + many) ** 2, dof) == pytest.approx(POWER, abs=1e-9)


def test_the_interval_of_a_share_is_that_of_clopper_and_pearson():
    for k, n in ((0, 20), (7, 20), (20, 20)):
        low, high = stats.binomtest(k, n).proportion_ci(0.95, method="exact")
        assert share_interval(k, n) == (pytest.approx(low, abs=1e-12), pytest.approx(high, abs=1e-12))


#: By the sum of innovations over the two worlds, whose power at 20 % is one to nine digits.
@statistical(1e-6, 1, power=1.0)
def test_a_right_filter_is_not_accused_and_a_wrong_one_is_wherever_the_power_says_so():
    given = {"names": FEW, "realizations": 16, "false_alarm": 1e-6}
    right, small, attitude = referee(["ekf", f"{WRONG}:Small", f"{WRONG}:SmallAttitude"], **given)
    assert not right.accused
    assert "found" in right.verdict
    assert all(r.found for r in right.rows if r.world.wrong)
    assert all(r.finds[0] < 0.2 for r in small.right)
    assert {r.world.name for r in small.accused} == {"rest", "turns"}
    for row in attitude.right:
        assert row.power["attitude"][0] < 0.5
        assert {v.subject.split(" at ")[0] for v in row.tests if not v.passed} <= {"attitude", "all nine"}
        assert any("attitude" in v.subject and not v.passed for v in row.tests)
    assert all(r.first is None or r.first.component.startswith("attitude") for r in attitude.right)


def test_the_page_repeats_to_the_byte(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    made = []
    for folder in ("a", "b"):
        args = ["referee", "ekf", "--worlds", "outages", "--realizations", "4", "--output", str(tmp_path / folder)]
        with pytest.raises(SystemExit) as end:
            main(args)
        assert end.value.code == 0
        made.append([(tmp_path / folder / name).read_bytes() for name in ("index.html", "referee.json")])
    assert made[0] == made[1]
    found = json.loads(made[0][1])[0]
    assert found["worlds"][0]["drifts"][0]["bound"] > 10.0
    assert not (b"seconds_per_epoch" in made[0][0] or b"seconds_per_epoch" in made[0][1])


def test_a_lie_is_an_exit_code(tmp_path, capsys):
    args = ["referee", f"{WRONG}:Small", "--worlds", "rest", "--realizations", "16", "--output", str(tmp_path)]
    with pytest.raises(SystemExit) as end:
        main(args)
    assert end.value.code == 1
    assert "does not state its errors in 1 of 1 world" in capsys.readouterr().out


def test_another_program_gives_its_estimates_through_files(tmp_path):
    given = {"names": ["turns"], "realizations": 4, "false_alarm": 1e-6}
    with pytest.raises(InputError, match="16 of 16 estimates are missing"):
        referee([str(tmp_path)], **given)
    folders = sorted(p.parent for p in tmp_path.glob("*/start.csv"))
    assert len(folders) == 16
    for folder in folders:  # a program that knows nothing stays where it started, and says so by a kilometre
        start, times = (np.genfromtxt(folder / n, delimiter=",", names=True) for n in ("start.csv", "times.csv"))
        row = [[t, *(start[c] for c in COLUMNS[1:10]), *[1000.0] * 3, *[30.0] * 3, *[180.0] * 3] for t in times["t_s"]]
        np.savetxt(folder / "estimate.csv", row, delimiter=",", header=",".join(COLUMNS), comments="", fmt="%.12g")
    (found,) = referee([str(tmp_path)], **given)
    assert set(found.right[0].power) == {"component"}
    assert found.right[0].first is not None
    assert found.right[0].first.factor < 0.1


def test_what_a_program_writes_is_what_is_judged(tmp_path):
    (world,) = worlds(["turns"])
    ours, theirs = (
        world.experiment(name, given, 1) for name, given in (("ekf", {}), ("files", {"folder": str(tmp_path)}))
    )
    assert Flights.of(theirs, 1).pending == 1
    (folder,) = tmp_path.iterdir()
    recording, start = ours.world.recording(0), ours.world.start(0, ours.world.imu)
    run = ours.filter("filter", output_every=50).run(recording.imu, recording.gnss, *start)
    state = np.column_stack([run.nav[:, :6], run.trajectory.rpy, run.sigma[:, :9]])
    degrees = [k for k, name in enumerate(COLUMNS[1:]) if name.endswith("_deg")]
    state[:, degrees] = np.rad2deg(state[:, degrees])
    table = np.column_stack([run.t, state])
    np.savetxt(folder / "estimate.csv", table, delimiter=",", header=",".join(COLUMNS), comments="", fmt="%.15g")
    own, read = Flights.of(ours, 1), Flights.of(theirs, 1)
    assert np.allclose(read.error, own.error, atol=1e-6)
    assert np.allclose(read.sigma, own.sigma, rtol=1e-9)


def test_an_estimate_file_that_lacks_columns_is_named(tmp_path):
    world = worlds(["rest"])[0]
    experiment = world.experiment("files", {"folder": str(tmp_path)}, 1)
    assert Flights.of(experiment, 2).pending == 2
    for folder in tmp_path.iterdir():
        (folder / "estimate.csv").write_text("t_s,lat_deg\n0,1\n1,2\n")
    flights = Flights.of(experiment, 2)
    assert not flights.runs
    assert "expected the columns t_s, lat_deg" in flights.failed[0]


def test_gtsam_states_its_errors_as_the_filter_does():
    pytest.importorskip("gtsam")
    (world,) = worlds(["turns"])
    ours, theirs = (Flights.of(world.experiment(name, {}, 1), 2) for name in ("ekf", "gtsam"))
    assert np.allclose(theirs.sigma[:, -1], ours.sigma[:, -1], rtol=0.05)
    # GTSAM turns a sample's force by the attitude at its beginning, ours by that in its middle: at 7 deg/s and 50 Hz a third of sigma in tilt
    assert np.abs((theirs.error - ours.error)[:, -1] / ours.sigma[:, -1]).max() < 0.5


def test_what_is_no_filter_or_world_is_named():
    for given in ("tests/none.py:Mine", f"{WRONG}:Absent", "no.module:Mine"):
        with pytest.raises(InputError, match="cannot be imported"):
            named_filter(given)
    with pytest.raises(InputError, match="no filter 'ekv'"):
        referee(["ekv"], names=["rest"])
    with pytest.raises(InputError, match="no world 'rset'"):
        referee(["ekf"], names=["rset"])


def test_python_says_what_the_command_says(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(
            [
                "referee",
                "ekf",
                "--worlds",
                "rest",
                "--realizations",
                "2",
                "--seed",
                "3",
                "--workers",
                "1",
                "--json",
                "--output",
                str(tmp_path),
            ]
        )
    assert end.value.code in (0, None)
    (said,) = json.loads(capsys.readouterr().out)
    (found,) = ins.referee("ekf", worlds=["rest"], realizations=2, seed=3)
    assert said == json.loads(json.dumps(found.to_json()))


def test_an_interrupted_referee_flies_only_the_worlds_that_are_left(tmp_path, monkeypatch, capsys):
    flown, stop, fly, of = [], [], Experiment.side_by_side, Flights.of

    def counted(experiment, indices):
        flown.append(experiment.scenario.title)
        return fly(experiment, indices)

    def interrupted(experiment, *rest):
        if experiment.scenario.title in stop:
            raise KeyboardInterrupt
        return of(experiment, *rest)

    monkeypatch.setattr(Experiment, "side_by_side", counted)
    monkeypatch.setattr(Flights, "of", interrupted)

    def asked(folder):
        flown.clear()
        given = ["--worlds", "rest,turns", "--realizations", "2", "--workers", "1", "--json"]
        with pytest.raises(SystemExit) as end:
            main(["referee", "ekf", *given, "--output", str(tmp_path / folder)])
        return end.value.code, set(flown), capsys.readouterr().out

    code, everything, answer = asked("whole")
    stop.append("turns")
    assert asked("cut")[:2] == (130, {"rest"})
    stop.clear()
    assert asked("cut") == (code, everything - {"rest"}, answer)
    assert not (tmp_path / "cut" / CACHE).exists()
