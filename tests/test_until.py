"""Realizations until an interval is narrow enough: the goal in words, and intervals that hold although one looks."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.evaluate import Goal, looks
from tests.test_run import SCENARIO, run, write

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("planimetric_end ratio a/b", "expected for example 'planimetric_end ratio b/a within 5 %'"),
        ("planimetric_end ratio a/b within 0 %", "expected for example"),
        ("planimetric_end ratio a/b within 1.2.3 %", "expected for example"),
        ("planimetric_end ratio a within 5 %", "expected two designs"),
        ("planimetric_and ratio a/b within 5 %", "unknown figure"),
        ("down_max mean c within 5 %", "no design 'c'"),
    ],
)
def test_what_is_no_goal_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Goal.parse(text, ["a", "b"])


def test_goals_are_read() -> None:
    assert Goal.parse("planimetric_end ratio model 3/model 1 within 5 %", ["model 1", "model 3"]) == Goal(
        "planimetric_end_m", ("model 3", "model 1"), 0.05
    )
    assert Goal.parse("down_max_m mean a within 2.5%", ["a"]) == Goal("down_max_m", ("a",), 0.025)


def test_the_interval_at_which_one_stops_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(11)
    missed, plain = 0, 0
    goal = Goal("planimetric_end_m", ("a", "b"), 0.015)
    drawn: dict[str, np.ndarray] = {}
    monkeypatch.setattr("insemu.evaluate.until.runs_of", lambda results, d, k, f: drawn[d][: results.realizations])
    for _ in range(300):
        b = rng.rayleigh(100.0, 5000)
        drawn |= {"a": 0.6 * b + rng.rayleigh(10.0, 5000), "b": b}
        truth = 0.6 + 0.1
        for number, n in enumerate(islice(looks(), 13), start=1):
            seen = goal.look(SimpleNamespace(realizations=n, outages=[(0.0, 1.0)]), number)
            if seen.reached:
                break
        assert seen.reached and n > 24
        missed += not seen.low <= truth <= seen.high
        narrow = (seen.high - seen.low) / 4.0  # half as wide misses
        plain += not seen.value - narrow <= truth <= seen.value + narrow
    assert missed <= 23  # binomial of 300 at 0.05: 24 or more with probability 1e-2; the union bound leaves far fewer
    assert plain > missed


def test_a_run_goes_on_until_the_goal_is_reached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path,
        trajectory=SCENARIO["trajectory"] | {"duration": "60 s"},
        gnss=SCENARIO["gnss"] | {"outages": [{"start": "40 s", "duration": "10 s"}]},
        variants={}, fits=None, designs={"full": SCENARIO["designs"]["full"]},
    )  # fmt: skip
    out = tmp_path / "out"
    assert run(str(path), "--until", "planimetric_end mean full within 25 %", "--output", str(out), "--json") == 0
    said, told = capsys.readouterr()
    found = json.loads(said)
    assert (
        found["realizations"] in (24, 36, 54)
        and f"{found['realizations']} realizations: planimetric_end mean full" in told
    )
