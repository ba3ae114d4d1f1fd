"""The blind trial and the commands: reproducible recordings, honest scores, files that the next command reads."""

from __future__ import annotations

import json
import math
import multiprocessing
import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import toeplitz

from benchmarks.trial.__main__ import app
from benchmarks.trial.drives import DYNAMIC_EFFECTS, OUTSIDE, draw_use, stage
from benchmarks.trial.expected import Log, sized, trace_of_ratio
from benchmarks.trial.hidden import Hidden
from benchmarks.trial.logs import STATIC_EFFECTS, HiddenLog, shape, static_recording
from benchmarks.trial.run import (
    Job,
    Plan,
    Said,
    Trial,
    known_effects,
    run_trial,
)
from benchmarks.trial.score import confusion, held_out_ratio, interval, mean_class_size, score_trials
from benchmarks.trial.tracks import TRACKS
from benchmarks.trial.worth import size_effect, worth_beside
from insemu import formats
from insemu.cli import main
from insemu.effects import EFFECTS, EffectUse
from insemu.emulate import corrupt
from insemu.errors import InputError
from insemu.gap import load_nominal
from insemu.gap.data.log import reduce
from insemu.gap.drive.preparation import Prepared, fast_parts, prepare
from insemu.noise import BI, WN, NoiseModel
from insemu.records import AXES, ImuRecord, Series
from tests.expected_leads import seen


def said(effect: str, axis: str = "x", members: tuple[str, ...] = (), confidence: float = 0.99) -> Said:
    inside = tuple((m, "gyro", (axis,)) for m in (effect, *members))
    return Said(effect, "gyro", (axis,), confidence, 10.0, inside)


def trial(hidden: tuple[str, ...], *steps: Said, verdict: str, nats: float = 30.0, outside: str = "") -> Trial:
    what = tuple(Hidden(h, "gyro", ("x",), 1.0, nats) for h in hidden)
    return Trial("static", 1, what, outside, "rest", verdict, steps, (1.0, 0.9, 1.1), 0.09, 0.1)


def counted(trials: list[Trial]) -> dict[str, tuple[int, int]]:
    return {name: (s.count, s.of) for name, s in score_trials(trials).items()}


def test_scores_count_names_classes_and_false_alarms() -> None:
    trials = [
        trial((), verdict="nothing missing"),
        trial((), said("ramp"), verdict="named"),
        trial((), verdict="unexplained"),
        trial(("flicker",), said("flicker"), verdict="named"),
        trial(("flicker",), said("flicker", "y"), verdict="named", nats=3.0),
        trial(("flicker",), said("ramp", members=("flicker",)), verdict="class"),
        trial(("telegraph",), verdict="nothing missing"),
        trial(("flicker", "ramp"), said("ramp"), said("flicker"), verdict="named"),
        trial(("flicker", "ramp"), said("ramp"), said("flicker"), said("outliers"), verdict="named"),
        trial((), said("flicker"), verdict="named", outside="sweep"),
        trial((), said("flicker"), verdict="unexplained", outside="sweep"),
    ]
    shares = counted(trials)
    assert shares["false_alarms"] == (2, 3)
    assert shares["falsely_named"] == (1, 3)
    assert shares["named_right"] == (1, 2)
    assert shares["effect_right"] == (2, 2)
    assert shares["in_class"] == (1, 1)
    assert shares["detected"] == (3, 4)
    assert shares["strong_detected"] == (2, 3)
    assert shares["strong_top_two"] == (2, 3)
    assert shares["both_and_only"] == (1, 2)
    assert shares["beside_and_only"] == (1, 2)
    several = trial(("flicker", "ramp"), said("ramp"), verdict="named")
    swallowed = replace(several, hidden=(several.hidden[0], replace(several.hidden[1], beside=2.0)))
    weak = replace(several, hidden=(several.hidden[0], replace(several.hidden[1], nats=2.0)))
    three = counted([several, swallowed, weak])
    assert [three[f"{of}_and_only"] for of in ("every", "both", "beside")] == [(0, 3), (0, 2), (0, 1)]
    assert shares["misnamed_outside"] == (1, 2)
    assert shares["outside_unexplained"] == (1, 2)
    assert confusion(trials)["flicker"] == {"flicker": 2, "ramp": 1}
    assert mean_class_size(trials) == 2.0
    assert held_out_ratio(trials)[0] == pytest.approx(0.9)


def test_an_unexplained_verdict_is_never_a_right_name() -> None:
    shares = counted([trial(("flicker",), said("flicker"), verdict="unexplained")])
    assert shares["named_right"] == (0, 0)
    assert shares["unexplained"] == (1, 1)
    assert shares["detected"] == (1, 1)


def test_an_interval_covers_where_the_right_effect_holds_the_true_value_of_its_axis() -> None:
    levels = (("value", (1.0, 2.0, 3.0)), ("T0", (25.0,)))
    hidden = Hidden("temperature", "gyro", ("y",), values=levels)

    def answer(effect: str, *values: tuple[str, float, float, float]) -> Trial:
        step = replace(said(effect, "y"), values=values)
        return replace(trial(("temperature",), step, verdict="named"), hidden=(hidden,))

    inside, below = ("value_y", 2.1, 1.9, 2.3), ("value", 2.1, 2.05, 2.3)
    trials = [
        answer("temperature", inside, ("T0", 24.0, 24.0, 24.0), ("mystery", 1.0, 0.0, 2.0)),
        answer("temperature", below),
        answer("ramp", inside),
        replace(answer("temperature", inside), verdict="unexplained"),
    ]
    assert [counted([t])["covered"] for t in trials] == [(1, 1), (0, 1), (0, 0), (0, 0)]
    assert (
        Hidden("misalignment", "gyro", ("x",), values=(("value", tuple(map(float, range(6)))),)).true("value_zx", "x")
        == 4.0
    )
    noise = Hidden("gnss_noise_level", "gnss", ("down",), values=(("factor", (1.0, 1.0, 2.5)),))
    assert noise.true("factor", ("down",)) == 2.5
    assert noise.true("factor", ("north", "east")) is None


def test_intervals_of_shares_are_clopper_and_pearson() -> None:
    assert interval(0, 10) == pytest.approx((0.0, 1.0 - 0.025**0.1))
    low, high = interval(7, 20)
    assert (low, high) == pytest.approx((0.15391, 0.59219), abs=1e-5)


@cache
def untouched() -> HiddenLog:
    return static_recording((), 30.0, 5, hours=0.1)


@pytest.mark.parametrize("effect", STATIC_EFFECTS)
def test_every_effect_can_be_hidden_and_changes_one_axis_or_the_sensor(effect: str) -> None:
    made = static_recording([effect], 30.0, 5, hours=0.1)
    again = static_recording([effect], 30.0, 5, hours=0.1, sizes=made.sizes)
    assert all(np.array_equal(a.values, b.values) for a, b in zip(made.log, again.log, strict=True))
    assert set(made.beliefs) == {"gyro_x", "gyro_y", "gyro_z"}
    assert made.temperature.shape == made.log[0].values.shape
    assert made.axis in (0, 1, 2)
    assert [h.effect for h in made.hidden] == [e for e in (effect,) if e != "none"]
    changed = {
        k
        for k, (a, b) in enumerate(zip(made.log, untouched().log, strict=True))
        if not np.array_equal(a.values, b.values)
    }
    whole = effect in ("decimation_filter", "dropped_samples")
    assert changed == (set() if effect == "none" else set(range(3)) if whole else {made.axis})


def test_what_an_effect_is_expected_to_be_worth_is_what_it_is_worth_on_average() -> None:
    rng = np.random.default_rng(4)
    white, n, dt = WN(1e-3), 18_000, 0.1
    log = Log(NoiseModel((white,)), NoiseModel((WN(1.1e-3),)), n, dt, 0, 25.0 + np.linspace(0.0, 5.0, n))
    for effect in ("random_walk", "ramp", "vibration_band"):
        make = shape(effect, n, dt, 1e-3, 0, rng)
        strength, nats = sized(make, log.worth, 30.0)
        assert nats == pytest.approx(30.0, rel=0.05)
        use = make(strength)
        still = ImuRecord(dt * np.arange(n), np.zeros((n, 3)), np.zeros((n, 3)), "mean")
        gains = []
        for _ in range(25):
            y = corrupt(still, dict.fromkeys(AXES[:3], log.truth), rng, effects=(use,)).imu.gyro[:, 0]
            gains.append(seen(log, use, reduce(Series(y, 1.0 / dt, "rad/s", "gyro_x"))))
        assert abs(np.mean(gains) - nats) < 4.0 * np.std(gains) / 5.0 + 1.5, effect


def test_trace_of_a_ratio_of_toeplitz_matrices() -> None:
    a, b = np.array([2.0, -0.8, 0.1, 0.02, -0.3]), np.array([1.5, -0.6, 0.3, 0.2, 0.1])
    assert trace_of_ratio(a, b) == pytest.approx(np.trace(np.linalg.solve(toeplitz(a), toeplitz(b))), rel=1e-12)


@pytest.mark.parametrize("track", TRACKS)
def test_a_twin_differs_by_what_was_hidden_and_by_nothing_else(track: str) -> None:
    s = stage(11, 3.0, 50.0, track=track)
    clean, twin = s.record(), s.record()
    np.testing.assert_array_equal(clean.imu.gyro, twin.imu.gyro)
    rng = np.random.default_rng(3)
    for effect in DYNAMIC_EFFECTS:
        use, hidden = draw_use(effect, s, rng)
        assert hidden.sensor in EFFECTS[effect].sensors
        r = s.record((use,))
        assert r.gnss is not None
        assert clean.gnss is not None
        moved = [
            *(not np.array_equal(getattr(r.imu, k), getattr(clean.imu, k)) for k in ("t", "gyro", "accel")),
            not np.array_equal(r.gnss.llh, clean.gnss.llh),
            not np.array_equal(np.asarray(r.gnss.vel_ned), np.asarray(clean.gnss.vel_ned)),
        ]
        assert any(moved), effect
        if hidden.sensor in ("gyro", "accel"):
            other = "accel" if hidden.sensor == "gyro" else "gyro"
            np.testing.assert_array_equal(getattr(r.imu, other), getattr(clean.imu, other), err_msg=effect)
        if hidden.sensor == "gnss":
            np.testing.assert_array_equal(r.imu.accel, clean.imu.accel, err_msg=effect)


@pytest.mark.parametrize(
    "outside", [o for o in OUTSIDE if o != "quadratic_accelerometer"]
)  # that is an effect of the table
def test_what_no_catalogue_holds_is_in_the_recording(outside: str) -> None:
    s = stage(11, 3.0, 50.0, track="car")
    clean, other = s.record(), s.record((), outside, 0.5)
    assert clean.gnss is not None
    assert other.gnss is not None
    assert not (np.array_equal(clean.gnss.llh, other.gnss.llh) and np.array_equal(clean.imu.gyro, other.imu.gyro))


def test_a_strong_line_is_found_and_nothing_in_a_clean_log() -> None:
    found = Job("static", ("vibration_line",), 60.0, 11, hours=0.3).run()
    assert counted([found])["named_right"] == (1, 1)
    assert Job("static", (), 0.0, 12, hours=0.3).run().verdict == "nothing missing"


def test_a_trial_resumes_from_its_log_and_reads_back_what_it_wrote(tmp_path, monkeypatch) -> None:
    ran: list[int] = []

    def look(self: Job) -> Trial:
        ran.append(self.seed)
        return replace(trial(self.effects, verdict="nothing missing"), seed=self.seed, oracle=math.nan)

    monkeypatch.setattr(Job, "run", look)
    plan, log = Plan(("static",), recordings=4), tmp_path / "trial.jsonl"
    first = run_trial(plan, log=log)
    with log.open("a") as file:
        file.write('{"job": "cut o')
    second = run_trial(replace(plan, recordings=6), log=log)
    assert len(ran) == 6
    assert [t.seed for t in second[:4]] == [t.seed for t in first]
    assert [t.hidden[:1] for t in second[:4]] == [t.hidden[:1] for t in first]
    log.write_text("no log\n{}\n")
    with pytest.raises(InputError, match=r"trial\.jsonl:1"):
        run_trial(plan, log=log)


def test_an_interrupted_trial_keeps_what_is_finished_and_leaves_no_worker_behind(tmp_path, monkeypatch) -> None:
    if multiprocessing.get_start_method() != "fork":
        pytest.skip("the stand-in for the work reaches forked workers only")
    log, plan = tmp_path / "trial.jsonl", Plan(("static",), recordings=5, seed=3)
    first = next(iter(plan.jobs())).seed

    def work(job: Job) -> Trial:
        if job.seed != first:
            time.sleep(60.0)
        return Trial("static", job.seed, (), "", "rest", "nothing missing", ())

    def interrupted(_: Trial) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Job, "run", work)
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_trial(plan, workers=2, done=interrupted, log=log)
    assert time.monotonic() - started < 30.0
    assert not multiprocessing.active_children()
    assert [json.loads(line)["seed"] for line in log.read_text().splitlines()] == [first]
    # a line that was cut off while it was written is done again and leaves no trace
    with log.open("a", encoding="utf-8") as file:
        file.write('{"job": "cut')
    monkeypatch.setattr(Job, "run", lambda job: Trial("static", job.seed, (), "", "rest", "nothing missing", ()))
    for _ in range(2):
        assert len(run_trial(plan, log=log)) == 5
        assert len(log.read_text().splitlines()) == 5


def test_recordings_of_a_plan_do_not_depend_on_how_many_there_are() -> None:
    few, many = (
        list(Plan(("dynamic", "static"), recordings=5).jobs()),
        list(Plan(("dynamic", "static"), recordings=9).jobs()),
    )
    assert few == many[:5]
    several = list(Plan(("dynamic",), hidden=3, recordings=6).jobs())
    assert all(len(set(j.effects)) == 3 for j in several)
    assert all(not j.effects and j.outside for j in Plan(("static",), outside=True, recordings=4).jobs())


@pytest.mark.slow(reason="filter runs of a whole drive")
def test_what_an_effect_is_worth_beside_another_is_nothing_where_the_other_looks_the_same() -> None:
    s = stage(21, 3.0, 50.0, track="car", turn_on_bias=True)
    plain = s.record()
    prepared = prepare(plain, s.nominal, fast_parts(plain, s.nominal), {})

    def clean() -> Prepared:
        return prepared

    down, other = (0.0, 0.0, 1e-3), (0.0, 1e-4, 0.0)
    shapes = (
        EffectUse("scale_factor", "accel", {"value": down}),
        EffectUse("scale_asymmetry", "accel", {"value": down}),
        EffectUse("turn_on_bias", "gyro", {"value": other}),
    )
    uses = [size_effect(s, clean, u, Hidden(u.id, u.sensor, ("z",)), 60.0)[0] for u in shapes]
    worth = [worth_beside(s, clean, uses, k) for k in range(3)]
    assert worth[0] < 5.0
    assert worth[1] < 5.0
    assert worth[2] > 30.0
    assert worth_beside(s, clean, uses[1:], 0) > 40.0
    # a walk on the same axis follows a constant; a filter that expects it sees less of the constant
    walk = EffectUse("random_walk", "gyro", {"K": (0.0, 1e-4, 0.0)})
    assert worth_beside(s, clean, [uses[2], walk], 0) < 0.5 * worth[2]
    assert math.isnan(
        worth_beside(s, clean, [EffectUse("dropped_samples", "imu", {"probability": (1e-3,), "burst": (1.0,)})], 0)
    )


def test_unknown_effects_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'flicker'"):
        known_effects(["flickr"])
    with pytest.raises(InputError, match="cannot hide 'lever_arm' in a static recording"):
        known_effects(["lever_arm"], ["static"])


def test_the_command_writes_a_report_and_a_refined_belief(tmp_path, capsys) -> None:
    rng = np.random.default_rng(3)
    y = WN(1e-3).simulate(24_000, 0.05, rng) + BI(1e-3).simulate(24_000, 0.05, rng)
    formats.write(tmp_path / "log.npz", [Series(y, 20.0, "rad/s", "gyro_x")])
    (tmp_path / "belief.yaml").write_text("belief:\n  gyro_x: WN(N=1e-3 rad/s/sqrt(Hz))\n")
    arguments = [
        "gap",
        str(tmp_path / "belief.yaml"),
        str(tmp_path / "log.npz"),
        "--output",
        str(tmp_path / "out"),
        "--json",
    ]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    face = json.loads(capsys.readouterr().out)
    assert face["steps"][0]["effect"] == "flicker"
    assert face["steps"][0]["axes"] == ["x"]
    refined = load_nominal(tmp_path / "out" / "refined.yaml")
    assert str(refined.beliefs["gyro_x"]).count("BI(") == 1
    assert 'class="chart' in (tmp_path / "out" / "index.html").read_text()
    with pytest.raises(SystemExit) as stop:
        main([*arguments[:2], str(tmp_path / "absent.npz")])
    assert stop.value.code == 2


def test_the_command_of_the_trial_refuses_what_it_does_not_know(capsys) -> None:
    for words, said in ((["--kind", "flying"], "--kind: found 'flying'"), (["--effect", "ghost"], "ghost")):
        with pytest.raises(SystemExit) as end:
            main(words, app)
        assert end.value.code == 2 and said in capsys.readouterr().err
