"""What a moved constant of the policy is found to do, and that nothing is looked at twice."""

from __future__ import annotations

from dataclasses import fields

import pytest

from insemu.gap.policy import Policy, rules, under
from insemu.trial.run import Job, Said, Trial
from tests import policy_perturbation
from tests.policy_perturbation import LEVELS, Look, Seen, Watched, pinned
from tests.scoreboard import Entry


def step(effect: str, nats: float) -> Said:
    return Said(effect, "gyro", ("x",), 0.9, nats, ((effect, "gyro", ("x",)),))


def entries(count: int = 20) -> list[Entry]:
    return [Entry(f"rest-none-{k:02d}", Job("static", (), 30.0, k)) for k in range(count)]


def stand_in(item: Look) -> Seen:
    """Two logs are flagged as a rule; ``lead`` flags every one, ``edge`` one more, ``hopeless`` moves evidence, ``tolerance`` nothing."""
    seed = item.entry.job.seed
    flagged = seed >= 18 or item.constant == "lead" or (item.constant == "edge" and seed == 13)
    steps = (step("ramp", 9.0 if item.constant == "hopeless" and item.factor > 1.0 else 5.0),) if flagged else ()
    looked.append((item.entry.name, item.constant, item.factor))
    trial = Trial("static", seed, (), "", "rest", "named" if flagged else "nothing missing", steps)
    return Seen(trial, frozenset() if item.constant else frozenset({"lead", "edge", "hopeless", "tolerance"}))


looked: list[tuple[str, str, float]] = []
CONSTANTS = ("lead", "edge", "hopeless", "tolerance", "knots")


def test_a_constant_is_told_by_the_strongest_that_it_moves(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(policy_perturbation, "look", stand_in)
    looked.clear()
    log = tmp_path / "log.jsonl"
    quick = pinned(entries(), CONSTANTS, workers=1, log=log, full=False)
    assert {c: level for c, (level, _) in quick.items()} == dict(
        zip(CONSTANTS, (LEVELS[1], LEVELS[1], LEVELS[2], LEVELS[3], LEVELS[4]), strict=True)
    )
    assert "x 1.50: rest-none-00: nothing missing -> named; ramp gyro x" in quick["lead"][1]
    assert not any(constant == "knots" for _, constant, _ in looked)
    # a constant that moved an answer among the first recordings is not tried in the rest
    assert max(name for name, constant, _ in looked if constant == "lead") == "rest-none-05"
    before = len(looked)
    assert pinned(entries(), CONSTANTS, workers=1, log=log, full=False) == quick
    assert len(looked) == before
    full = pinned(entries(), CONSTANTS, workers=1, log=log, full=True)
    assert full["lead"][0] == LEVELS[0]
    assert "2 -> 20" in full["lead"][1]
    assert full["edge"][0] == LEVELS[1]
    assert len(set(looked)) == len(looked)


def test_what_is_read_is_noted_and_a_hash_reads_nothing() -> None:
    with under(Watched(mark="a")):
        Watched.noted.clear()
        hash(rules())
        assert rules() == Watched(mark="a") and rules() != Watched(mark="b")
        assert not Watched.noted
        assert rules().lead == Policy().lead
        assert Watched.noted == {"lead"}


def test_a_workflow_that_fails_under_a_constant_has_said_something_else(monkeypatch) -> None:
    seen: list[float] = []

    def run(job: Job) -> Trial:
        seen.append(rules().lead)
        if rules().lead > Policy().lead:
            raise ValueError("no room")
        return Trial("static", job.seed, (), "", "rest", "nothing missing", ())

    monkeypatch.setattr(Job, "run", run)
    usual, more, less = (policy_perturbation.look(Look(entries(1)[0], *x)) for x in ((), ("lead", 1.5), ("lead", 0.5)))
    assert seen == [Policy().lead, 1.5 * Policy().lead, 0.5 * Policy().lead]
    assert usual.read == {"lead"}
    assert more.trial.verdict == "fails: ValueError: no room"
    assert more.differs(usual) == LEVELS[1]
    assert less.differs(usual) == LEVELS[3]


def test_an_unknown_constant_is_refused(capsys) -> None:
    with pytest.raises(SystemExit):
        policy_perturbation.main(["--constant", "leed"])
    assert "no constant of the policy: leed" in capsys.readouterr().err
    assert len(fields(Policy)) > 80
