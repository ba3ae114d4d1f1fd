"""What a moved constant of the policy is found to do, that nothing is looked at twice, and that the file of what pins each is whole."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from benchmarks.trial.run import Job, Said, Trial
from insemu.gap.policy import Policy, rules, under
from tests import policy_perturbation
from tests.policy_perturbation import Look, Seen, kept, look, move, search
from tests.policy_probe import FACTORS, Probe, Watched
from tests.scoreboard import Entry


def test_every_constant_is_pinned_or_says_why_it_stays() -> None:
    found = kept()
    assert set(found) == {f.name for f in fields(Policy)}
    for constant, e in found.items():
        if "moves" in e:
            assert e["was"] != e["now"] and e["commit"] and any(abs(e["factor"] - f) < 0.01 for f in FACTORS), constant
        else:
            assert len(e["stays"].split()) >= 6, constant


def watched(function) -> tuple[object, set[str]]:
    with under(Watched(mark="a")):
        Probe.noted.clear()
        return function(), {move(*m) for m in Probe.noted}


@pytest.mark.parametrize(
    ("function", "noted"),
    [
        (lambda: rules().lead > 1.0, set()),  # 3, 4.5 and 2 are all more
        (lambda: rules().lead > 2.5, {"lead x 0.67"}),
        (lambda: np.array([1.0, 4.0]) < rules().lead, {"lead x 1.50"}),
        (lambda: np.float64(2.5) > rules().lead - rules().keep_nats, {"lead x 1.50"}),
        (lambda: float(min(rules().lead, 1.0)), set()),
        (lambda: float(max(rules().lead, 2.0)), {"lead x 1.50", "lead x 0.67"}),
        (lambda: round(rules().false_alarms * 10), set()),
        (lambda: np.array(rules().prior_scales).sum(), {"prior_scales x 1.50", "prior_scales x 0.67"}),
    ],
)
def test_only_what_comes_out_another_is_noted(function, noted) -> None:
    usual = function()
    seen, moves = watched(function)
    np.testing.assert_array_equal(seen, usual)
    assert moves == noted


def step(effect: str, nats: float) -> Said:
    return Said(effect, "gyro", ("x",), 0.9, nats, ((effect, "gyro", ("x",)),))


ALL = [move(c, f) for c in ("lead", "leak", "tolerance") for f in FACTORS]


def stand_in(item: Look) -> Seen:
    """``lead`` flags a log, ``leak`` moves evidence, ``tolerance`` could decide otherwise only where it does not."""
    looked.append((item.name, item.constant, item.factor))
    could = {m: () for m in ALL if "tolerance" not in m or item.name.endswith("01")}
    said = "named" if item.constant == "lead" and item.name.endswith("01") else "nothing missing"
    return Seen((said,), (), (9.0 if item.constant == "leak" else 5.0,), 1.0, {} if item.constant else could)


looked: list[tuple[str, str, float]] = []


def test_a_constant_is_tried_where_it_could_decide_otherwise_until_an_answer_moves(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(policy_perturbation, "look", stand_in)
    monkeypatch.setattr(policy_perturbation, "FILE", tmp_path / "file.yaml")
    looked.clear()
    names = [f"rest-none-{k:02d}" for k in range(8)]
    found = search(names, ("lead", "leak", "tolerance", "stray"), log=tmp_path / "log.jsonl")
    assert found["lead"]["moves"] == "rest-none-01" and found["lead"]["was"] == "nothing missing"
    assert (
        found["leak"]["open"] == "no answer moved in 16 looks" and found["leak"]["evidence"] == "x 1.50: rest-none-00"
    )
    assert found["tolerance"]["open"] == "no answer moved in 2 looks" and not found["tolerance"]["evidence"]
    assert ("rest-none-02", "lead", 1.5) not in looked and len(set(looked)) == len(looked)
    before = len(looked)
    assert search(names, ("leak", "tolerance"), log=tmp_path / "log.jsonl")["lead"] == found["lead"]
    assert len(looked) == before


def test_pins_are_looked_at_again_of_the_constants_that_are_named(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(policy_perturbation, "look", stand_in)
    monkeypatch.setattr(policy_perturbation, "FILE", tmp_path / "file.yaml")
    pin = {"factor": 1.5, "moves": "rest-none-01", "was": "a", "now": "b", "commit": "c"}
    policy_perturbation.write({"lead": pin, "leak": pin})
    assert policy_perturbation.main(["--again", "--constant", "lead"]) == 0
    assert "every pin holds" in capsys.readouterr().out
    assert policy_perturbation.main(["--again", "--constant", "leak"]) == 1
    assert policy_perturbation.main(["--again"]) == 1
    assert "leak is pinned no more" in capsys.readouterr().out


def test_a_workflow_that_fails_under_a_constant_has_said_something_else(monkeypatch) -> None:
    seen: list[float] = []

    def run(job: Job) -> Trial:
        seen.append(float(rules().lead))
        if rules().lead > Policy().lead:
            raise ValueError("no room")
        return Trial("static", job.seed, (), "", "rest", "nothing missing", ())

    monkeypatch.setattr(Job, "run", run)
    monkeypatch.setattr(
        policy_perturbation, "_entries", lambda: {"a": Entry("rest-none-01", Job("static", (), 30.0, 1))}
    )
    usual, more, less = (look(Look("a", *x)) for x in ((), ("lead", 1.5), ("lead", 0.5)))
    assert seen == [Policy().lead, 1.5 * Policy().lead, 0.5 * Policy().lead]
    assert set(usual.could) == {"lead x 1.50", "lead x 0.67"}
    assert more.said == ("fails: ValueError: no room",) and less.answer == usual.answer


def test_an_unknown_constant_is_refused(capsys) -> None:
    with pytest.raises(SystemExit):
        policy_perturbation.main(["--constant", "leed"])
    assert "no constant of the policy: leed" in capsys.readouterr().err
