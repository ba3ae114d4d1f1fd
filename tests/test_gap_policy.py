"""The policy of the gap: every constant said in full, read somewhere, and obeyed below the door."""

from __future__ import annotations

import re
import threading
from dataclasses import FrozenInstanceError, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import insemu.gap as gap
from insemu.gap import Policy, find_static_gap, search, session
from insemu.gap.candidates import axis
from insemu.gap.data import log
from insemu.gap.drive import corrected
from insemu.gap.evidence import modes
from insemu.gap.evidence.modes import Free
from insemu.gap.policy import RUNS, rules, under
from insemu.noise import RW, WN, NoiseModel
from insemu.records import Series
from tests.scoreboard import read, sentences

ROOM = Path(gap.__file__).parent


def test_every_constant_has_unit_reason_and_the_run_that_calibrates_it() -> None:
    for f in fields(Policy):
        assert set(f.metadata) == {"unit", "run", "reason"}, f.name
        assert f.metadata["unit"] and f.metadata["run"] in RUNS, f.name
        assert len(f.metadata["reason"].split()) >= 4 and f.metadata["reason"].endswith("."), f.name


def test_every_run_that_is_a_file_of_tests_is_there() -> None:
    files = [Path(__file__).parents[1] / run for run in RUNS.values() if run.startswith("tests/")]
    assert files and all(p.is_file() for p in files)


@cache
def read_constants() -> set[str]:
    """Names of constants that the room asks for."""
    texts = [p.read_text(encoding="utf-8") for p in ROOM.rglob("*.py") if p.name != "policy.py"]
    return {name for text in texts for name in re.findall(r"rules\(\)\.(\w+)", text)}


@pytest.mark.parametrize("name", [f.name for f in fields(Policy)])
def test_every_constant_is_read(name: str) -> None:
    assert name in read_constants()


@pytest.mark.parametrize("name", [f.name for f in fields(Policy)])
@pytest.mark.parametrize("factor", [1.5, 1.0 / 1.5])
def test_a_constant_is_moved_alone_and_a_share_stays_one(name: str, factor: float) -> None:
    usual, moved = Policy(), Policy().moved(name, factor)
    assert [f.name for f in fields(Policy) if getattr(moved, f.name) != getattr(usual, f.name)] == [name]
    before, after = np.atleast_1d(getattr(usual, name)), np.atleast_1d(getattr(moved, name))
    assert np.all(after > before) == (factor > 1.0)
    if name in (
        "class_share",
        "something",
        "naming_share",
        "mounting_share",
        "most_values",
        "alike",
        "offset_share",
        "nis_left",
    ):
        assert after[0] < 1.0


def test_the_policy_is_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        Policy().lead = 2.0  # type: ignore[misc]


def test_a_policy_holds_for_its_block_and_its_thread_only() -> None:
    seen: list[float] = []
    with under(Policy(lead=7.0)):
        assert rules().lead == 7.0
        with under(None):
            assert rules().lead == 7.0
        other = threading.Thread(target=lambda: seen.append(rules().lead))
        other.start()
        other.join()
    assert seen == [3.0] and rules().lead == 3.0


def test_a_search_obeys_the_policy_that_it_is_given() -> None:
    rng = np.random.default_rng(5)
    truth = NoiseModel((WN(1e-3), RW(1e-4)))
    log = [Series(truth.simulate(20_000, 0.1, rng), 10.0, "rad/s", "gyro_x")]
    belief = {"gyro_x": NoiseModel((WN(1e-3),))}

    def found(policy: Policy | None) -> tuple[str, ...]:
        report = find_static_gap(log, belief, rng=np.random.default_rng(1), hold_out=False, policy=policy)
        return tuple(s.effect for s in report.findings)

    assert found(None)
    assert found(replace(Policy(), least_nats=1e6)) == ()
    assert found(None)


# -- what sets a precision is no decision: refined, it leaves the answer -------------------------------------------------------------

REST, FLIGHT = "rest-one-04", "flight-three-01"


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
@pytest.mark.parametrize(
    ("recording", "module", "refined"),
    [
        (REST, log, {"BLOCK_S": 5.0, "MOST_BLOCKS": 1000, "FEWEST_BLOCKS": 240}),
        (REST, modes, {"EDGE": 0.15, "TOLERANCE_EDGE": 0.01}),
        (REST, axis, {"HOPELESS": 8.0}),
        (REST, search, {"MOST_EFFECTS": 24}),
        (FLIGHT, corrected, {"KNOT_S": 5.0, "KNOTS": 120}),
        (FLIGHT, modes, {"EDGE": 0.15, "TOLERANCE_EDGE": 0.01}),
        (FLIGHT, session, {"MOST_PASSES": 4}),
    ],
    ids=lambda x: x if isinstance(x, str) else "+".join(x) if isinstance(x, dict) else "",
)
def test_a_finer_precision_leaves_the_answer(recording, module, refined, monkeypatch) -> None:
    entry = next(e for e in read()[0] if e.name == recording)
    for name, value in refined.items():
        assert getattr(module, name) != value
        monkeypatch.setattr(module, name, value)
    if module is modes:
        monkeypatch.setattr(Free.__init__, "__defaults__", (refined["EDGE"],))
    assert sentences(entry.job.run()) == entry.said
