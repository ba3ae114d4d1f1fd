"""The scoreboard's file, its recordings and its bounds."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import pytest

from benchmarks.trial.run import Job, Said, Trial
from benchmarks.trial.score import Score, interval
from tests import scoreboard
from tests.scoreboard import MIX, SAME_DATA, WHAT, Entry, beyond, compare, fingerprint, moved, read, sentences, write


def test_the_file_holds_the_whole_mix_and_reads_back(tmp_path) -> None:
    entries, scores = read()
    kinds = Counter(e.name.rsplit("-", 1)[0] for e in entries)
    assert kinds == {f"{kind}-{what}": n for kind, counts in MIX.items() for what, n in zip(WHAT, counts, strict=True)}
    assert len({e.job.seed for e in entries}) == len(entries) == 120
    assert set(scores) == {"all", *MIX}
    assert scores["all"]["false_alarms"][1] == sum(counts[0] for counts in MIX.values())
    write(entries, {}, tmp_path / "again.yaml")
    again, _ = read_without_scores(tmp_path / "again.yaml")
    assert [e.to_plain() for e in again] == [e.to_plain() for e in entries]


def read_without_scores(path):
    path.write_text(path.read_text().replace("scores:\n", "scores: {}\n"))
    return read(path)


@pytest.mark.parametrize(
    "name", ["rest-none-01", "rest-two-01", "rest-outside-02", "drive-one-01", "flight-outside-02"]
)
def test_a_recording_is_what_it_was_when_it_was_drawn(name: str) -> None:
    entry = next(e for e in read()[0] if e.name == name)
    assert abs(fingerprint(entry.job) - entry.data) < SAME_DATA
    other = replace(entry.job, seed=entry.job.seed + 1)
    assert abs(fingerprint(other) - entry.data) > 0.01


def test_a_smaller_size_is_another_recording() -> None:
    entry = next(e for e in read()[0] if e.name == "rest-one-02")
    other = replace(entry.job, sizes=(0.9 * entry.job.sizes[0],))
    assert abs(fingerprint(other) - entry.data) > SAME_DATA


def answer(name: str, verdict: str, effect: str = "", gain: float = 30.0) -> Entry:
    steps = (
        (Said(effect, "gyro", ("x",), 0.9, gain, ((effect, "gyro", ("x",)), ("gravity", "imu", ()))),) if effect else ()
    )
    trial = Trial("static", 1, (), "", "rest", verdict, steps)
    job = Job("static", ("ramp",), 30.0, 1)
    return Entry(name, job, data=0.5, said=sentences(trial), gains=tuple(s.gain_nats for s in trial.steps))


def test_what_moved_is_told_as_a_diff() -> None:
    old = answer("rest-one-01", "class", "ramp")
    assert old.said == ("class", "ramp gyro x | gravity imu")
    assert moved(old, old) == []
    assert moved(old, replace(old, gains=(30.1,))) == []
    assert moved(old, replace(old, gains=(33.0,)))[1:] == ["  gains [30.0] -> [33.0] nats"]
    new = answer("rest-one-01", "nothing missing")
    assert moved(old, new) == [
        "rest-one-01 (hidden: ramp)", "- class; ramp gyro x | gravity imu", "+ nothing missing",
    ]  # fmt: skip
    assert "another: fingerprint 0.500000 -> 0.600000" in moved(old, replace(old, data=0.6))[1]


def test_a_score_fails_only_beyond_its_bound_and_on_the_wrong_side() -> None:
    low, high = interval(30, 40)
    few, many = math.floor(40 * low), math.ceil(40 * high)

    def score(name: str, count: int) -> Score:
        return Score(name, "label", count, 40, "more")

    for count, fails in ((few, True), (few + 1, False), (many, False)):
        assert beyond("detected", (30, 40), score("detected", count)) is fails
        lines, worse = compare([], [], {"all": {"detected": (30, 40)}}, {"all": {"detected": score("detected", count)}})
        assert worse is fails
        assert ("BEYOND" in lines[0]) is fails
    assert beyond("false_alarms", (30, 40), score("false_alarms", many))
    assert not beyond("false_alarms", (30, 40), score("false_alarms", few))
    # none of 27 may become three, not four: 12.8 % is the bound
    assert not beyond("false_alarms", (0, 27), Score("false_alarms", "", 3, 27, "fewer"))
    assert beyond("false_alarms", (0, 27), Score("false_alarms", "", 4, 27, "fewer"))


def test_a_part_of_the_set_fails_where_its_own_interval_lies_beyond() -> None:
    # 75 % of 40: 59 to 87 %; of 12 recordings 6 are 21 to 79 %, 2 are 2 to 48 %
    for count, fails in ((6, False), (2, True)):
        now = {"all": {"detected": Score("detected", "label", count, 12, "more")}}
        lines, worse = compare([], [], {"all": {"detected": (30, 40)}}, now, part=True)
        assert worse is fails and bool(lines) is fails
    assert beyond("false_alarms", (0, 27), Score("false_alarms", "", 9, 12, "fewer"), part=True)


def test_the_command_runs_a_part_and_says_what_moved(capsys, monkeypatch) -> None:
    calls = []

    def run(entries, workers, log):
        calls.append([e.name for e in entries])
        return {
            e.name: Trial(e.job.kind, e.job.seed, (), e.job.outside, "", "nothing missing", (), seconds=1.0)
            for e in entries
        }

    monkeypatch.setattr(scoreboard, "run", run)
    assert scoreboard.main(["--only", "rest-one", "--limit", "3"]) == 0
    assert calls == [["rest-one-01", "rest-one-07", "rest-one-13"]]
    out = capsys.readouterr().out
    assert "+ nothing missing" in out
    assert "3 recordings; 3 s of one core" in out
    with pytest.raises(SystemExit):
        scoreboard.main(["--only", "rest-none-01", "--update"])
