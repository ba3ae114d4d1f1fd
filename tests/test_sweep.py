"""``insemu sweep``: a matrix of scenarios as one experiment that goes on where it stopped."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import Experiment, Row, Sweep, best_of, front, run_experiment
from insemu.evaluate import sweep as swept
from insemu.evaluate.sweep import factors, points
from insemu.scenario import load, with_changes

pytestmark = pytest.mark.usefixtures("without_pictures")

SCENARIO: dict[str, Any] = {
    "title": "which <b>sensor</b>",
    "seed": 3,
    "realizations": 2,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "110 s"},
    "truth": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz))", "accel": "WN(N=90 ug/sqrt(Hz))"},
    "gnss": {"position_sigma": "5 cm", "outages": [{"start": "80 s", "duration": "10 s"}]},
    "designs": {
        "right": {"gyro": {"truth": True}, "accel": {"truth": True}},
        "wrong": {"gyro": "WN(N=0.3 deg/s/sqrt(Hz))", "accel": {"truth": True}},
    },
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(SCENARIO, sort_keys=False), encoding="utf-8")
    return path


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["sweep", *arguments])
    return int(end.value.code or 0)


def test_what_is_varied_is_read() -> None:
    one, two, three = factors("sensor=[ADIS16470, BMI088], gnss.position_sigma = 2 cm..1 m log,seed=1..3")
    assert (one.key, one.values) == ("sensor", ("ADIS16470", "BMI088"))
    assert (two.key, two.low, two.high, two.unit, two.log) == ("gnss.position_sigma", 2.0, 100.0, "cm", True)
    assert two.at(0.5) == "14.1421 cm" and three.at(0.25) == 1.5
    nested = factors("designs.a.gyro=[{truth: true}, {fit: [WN]}],outage=[30 s]")
    assert nested[0].values == ({"truth": True}, {"fit": ["WN"]}) and nested[1].values == ("30 s",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected KEY="),
        ("sensor", "expected KEY="),
        ("sensor=[]", "found an empty list"),
        ("sensor=[A", "expected a closing bracket"),
        ("outage=[1 s],outage=[2 s]", "stands twice"),
        ("outage=5 s..2 s", "expected a range from low to high"),
        ("outage=0 s..2 s log", "above 0"),
        ("outage=1 s..2 m", "m"),
        ("outage=[1 s] sensor=[A]", "expected KEY="),
    ],
)
def test_what_is_none_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        factors(text)


def test_a_grid_has_all_combinations_and_a_hypercube_meets_every_part() -> None:
    grid = points(factors("a=[1, 2, 3],b=[x, y]"), 0, 1)
    assert len(grid) == 6 and {(p["a"], p["b"]) for p in grid} == {(a, b) for a in (1, 2, 3) for b in "xy"}
    cube = points(factors("a=0..10,b=[x, y]"), 10, 1)
    assert (
        sorted(int(p["a"]) for p in cube) == list(range(10)) and sorted(p["b"] for p in cube) == ["x"] * 5 + ["y"] * 5
    )
    assert cube == points(factors("a=0..10,b=[x, y]"), 10, 1) != points(factors("a=0..10,b=[x, y]"), 10, 2)
    with pytest.raises(InputError, match="or --latin N"):
        points(factors("a=0..10"), 0, 1)
    with pytest.raises(InputError, match="makes 1000000 points"):
        points(factors(",".join(f"{k}=[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]" for k in "abcdef")), 0, 1)


def test_keys_lead_into_the_scenario(file: Path) -> None:
    changed = with_changes(
        SCENARIO, {"outage": "7 s", "gnss.outages.0.start": "60 s", "initial.heading_sigma": "2 deg"}
    )
    assert changed["gnss"]["outages"] == [{"start": "60 s", "duration": "7 s"}]
    assert changed["initial"] == {"heading_sigma": "2 deg"} and SCENARIO["gnss"]["outages"][0]["duration"] == "10 s"
    assert with_changes(SCENARIO, {"sensor": "BMI088"})["truth"] == {"sensor": "BMI088"}
    still = with_changes(SCENARIO, {"trajectory": "static"})["trajectory"]
    assert still == {"rate": "50 Hz", "duration": "110 s", "builtin": "static"}
    assert load(file, changes={"sensor": "BMI088"}).truth != load(file).truth
    for changes, said in (
        ({"gnss.outages.4.start": "1 s"}, "a number from 0 to 0"),
        ({"seed.x": 1}, "leads into 3"),
        ({"trajectory": "moonwalk"}, "unknown trajectory 'moonwalk'"),
        ({"gnss.position_sgima": "1 m"}, "did you mean 'position_sigma'"),
    ):
        with pytest.raises(InputError, match=said):
            load(file, changes=changes)


def row(design: str, states: int, error: float, knows: str = "yes", spread: float = 0.1) -> Row:
    return Row(1, {}, design, states, error, error - spread, error + spread, 2 * error, error, knows, "flights", "")


def test_what_to_take_and_the_front() -> None:
    small, close, liar, large = row("a", 9, 5.0), row("b", 15, 4.9), row("c", 9, 1.0, "optimistic"), row("d", 27, 3.0)
    assert best_of([small, close, liar]) is small  # as good as b with fewer states; c does not know its error
    assert best_of([small, close, large]) is large
    assert best_of([liar]) is liar
    assert front([small, close, large, liar]) == [liar]
    assert front([small, close, large, row("e", 27, 4.0)]) == [small, close, large]


def test_a_sweep_flies_every_point_goes_on_and_says_the_same(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    over = "gnss.position_sigma=[5 cm, 1 m],outage=[5 s, 10 s]"
    assert run(str(file), "--over", over, "--output", str(tmp_path / "one"), "--workers", "1") == 0
    said = capsys.readouterr().out
    assert "Take right at" in said and "wrong at" not in said
    rows = list(csv.DictReader((tmp_path / "one" / "sweep.csv").read_text().splitlines()))
    assert len(rows) == 8 and [r["gnss.position_sigma"] for r in rows[::2]] == ["5 cm", "5 cm", "1 m", "1 m"]
    last = load(file, changes={"gnss.position_sigma": "1 m", "outage": "5 s"})
    expected = run_experiment(Experiment(last, file))
    assert float(rows[4]["error_m"]) == pytest.approx(float(expected.planimetric_ends("right").mean()), rel=1e-12)
    assert not list((tmp_path / "one" / "cache" / "flying").glob("*/*"))  # of finished points only the rows are kept
    page = (tmp_path / "one" / "index.html").read_text()
    assert "<b>sensor</b>" not in page and 'class="heat"' in page and "Pareto front" in page

    flown: list[str] = []

    def stops(*arguments: Any, **means: Any) -> Any:
        if len(flown) == 2:
            raise KeyboardInterrupt
        flown.append("point")
        return run_experiment(*arguments, **means)

    monkeypatch.setattr(swept, "run_experiment", stops)
    assert run(str(file), "--over", over, "--output", str(tmp_path / "two"), "--workers", "1") != 0
    assert not (tmp_path / "two" / "sweep.csv").exists()
    flown.clear()
    assert run(str(file), "--over", over, "--output", str(tmp_path / "two"), "--workers", "2") == 0
    assert len(flown) == 2
    for name in ("sweep.csv", "sweep.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_to_first_order_and_in_a_hypercube(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "cube"
    over = "gnss.position_sigma=2 cm..2 m log"
    assert run(str(file), "--over", over, "--latin", "4", "--linear", "200", "--output", str(out), "--json") == 0
    document = json.loads(capsys.readouterr().out)
    own = [r for r in document["rows"] if r["design"] == "right"]
    assert document["linear"] and len(own) == 4 and all(r["knows"] == "yes" and r["by"] == "linear" for r in own)
    order = np.argsort([float(r["gnss.position_sigma"].split()[0]) for r in own])
    assert list(np.argsort([r["error_m"] for r in own])) == list(order)  # worse fixes, larger errors
    assert "rank correlation" in (out / "index.html").read_text()


def test_a_design_that_is_not_linear_is_flown_at_long_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As in the preview of a single run (tests/test_twin.py)."""
    truth = {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=900 deg/h, Tc=100 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=120 mg, Tc=4000 s)",
    }
    designs = {"right": SCENARIO["designs"]["right"], "white": {axis: m.split(" +")[0] for axis, m in truth.items()}}
    path, out = tmp_path / "bent.yaml", tmp_path / "bent"
    path.write_text(yaml.safe_dump(SCENARIO | {"truth": truth, "designs": designs}, sort_keys=False), encoding="utf-8")
    over = "gnss.position_sigma=[5 cm, 10 cm]"
    assert run(str(path), "--over", over, "--linear", "200", "--output", str(out), "--json") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {r["design"]: r["by"] for r in rows} == {"right": "linear", "white": "coarse"}
    assert all(bool(r["why"]) is (r["by"] == "coarse") for r in rows)
    page = (out / "index.html").read_text()
    assert "white, not linear: runs at long steps" in page and rows[1]["why"] in page
    assert run(str(path), "--over", over, "--linear", "200", "--output", str(out)) == 0
    assert "white is not linear at 2 of 2 points" in capsys.readouterr().out


def test_bad_points_are_refused_before_anything_is_flown(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(str(file), "--over", "sensor=[BMI088, NOSUCH]", "--output", str(out)) == 2
    assert "point 2 (sensor=NOSUCH)" in capsys.readouterr().err and not out.exists()
    assert run(str(file), "--over", "outage=[5 s", "--output", str(out)) == 2 and not out.exists()
    with pytest.raises(InputError, match="point 1"):
        Sweep.of(file, "outage=[soon]")
