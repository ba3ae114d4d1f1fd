"""Aids in the gap workflow: predicted by the smoothed run, what they are off by named with its numbers, written down, and not found again."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.foreign.judge import Job, drawn, taken, write
from insemu.cli import main
from insemu.effects import AID_KINDS, EffectUse
from insemu.errors import InputError
from insemu.evaluate.emulated import EmulatedWorld
from insemu.filters import AIDS, aid_jacobian, smoothed_at
from insemu.gap import find_gap, load_nominal
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.candidates.aid_outliers import Mixture
from insemu.gap.drive.aid_residuals import Measured, Smoothed
from insemu.gap.drive.preparation import Flown
from insemu.gap.evidence.aid_model import AidModel, AidResiduals
from insemu.gap.problems import drive_without
from insemu.gap.problems.aids import check_aids, find_aid_effects
from insemu.gap.verdict import Finding, Interval, Value
from insemu.records import AidRecord, Recording
from insemu.report.gap import gap_headline, is_better
from insemu.scenario import load

WORLD: dict[str, Any] = {
    "title": "aids",
    "seed": 1,
    "realizations": 1,
    "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "300 s"},
    "truth": {
        "gyro": "WN(N=0.02 deg/s/sqrt(Hz)) + RC(sigma=0.05 deg/s)",
        "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=2 mg)",
    },
    "gnss": {"position_sigma": ["1 m", "1 m", "2 m"], "velocity_sigma": "5 cm/s"},
    "aids": {
        "odometer": {"rate": "5 Hz", "sigma": [0.05, 0.1, 0.1], "lever_arm": [-1.0, 0.0, 0.5]},
        "barometer": {"rate": "5 Hz", "sigma": 0.3},
        "heading": {"rate": "1 Hz", "sigma": "0.5 deg"},
    },
    "designs": {"full": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("aids")


def nominal(folder):
    path = folder / "nominal.yaml"
    path.write_text(yaml.safe_dump(WORLD), encoding="utf-8")
    return load_nominal(path)


def recorded(folder, *effects: dict[str, Any]) -> Recording:
    path = folder / "world.yaml"
    document = {**WORLD, "truth": {**WORLD["truth"], "effects": list(effects)}}
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return EmulatedWorld(load(path), path).recording(0)


@pytest.fixture(scope="module")
def plain(folder):
    """A drive with perfect aids, and the run without them, smoothed."""
    recording = recorded(folder)
    path = folder / "world.yaml"
    perfect = EmulatedWorld(load(path), path).recording(0, ideal=True).aids
    flown = Flown.of(recording, nominal(folder))
    return recording, perfect, flown, Smoothed.of(flown.prepared)


# -- what an aid should measure -------------------------------------------------------------------------------------------------------------


def test_errors_of_the_smoothed_run_are_as_large_as_it_says(plain) -> None:
    recording, _, _, smoothed = plain
    t, motion, true = smoothed.t, smoothed.motion, recording.reference
    rows = np.searchsorted(true.t, t - 1e-9)
    off = motion.velocity - true.vel_ned[rows]
    states = smoothed.nodes.sigma[:, 3:6]
    ratio = np.mean(off**2, axis=0) / np.mean(states**2, axis=0)
    assert np.all((ratio > 0.2) & (ratio < 4.0))


def test_between_two_nodes_what_is_taken_off_is_that_of_both(plain) -> None:
    smoothed = plain[3]
    result, nodes = smoothed.result, smoothed.result.nodes
    at = smoothed_at(result, smoothed.nodes, nodes.epoch[1:-1])
    np.testing.assert_allclose(at, smoothed.nodes.nav[1:-1], atol=1e-9)
    # from epoch to epoch the smoothed velocity moves as the filter's prediction does, not by its corrections
    rows = np.arange(nodes.epoch[20] - 5, nodes.epoch[20] + 6)
    near = smoothed_at(result, smoothed.nodes, rows)
    own, jump = np.diff(near[:, 3:6], axis=0), np.abs(nodes.correction[20, 3:6]).max()
    force = np.diff(smoothed.motion.velocity[rows - smoothed.rows[0]], axis=0)
    np.testing.assert_allclose(own, force, atol=1e-12)
    assert np.abs(own[5] - own[4]).max() < max(0.5 * jump, 0.02)


@pytest.mark.parametrize("kind", AID_KINDS)
def test_a_perfect_aid_is_off_by_what_the_navigation_is(plain, kind: str) -> None:
    _, perfect, _, smoothed = plain
    aid = next(a for a in perfect if a.kind == kind)
    shown = smoothed.shown_to(aid)
    measured = Measured.of(aid, shown)
    block = measured.blocks(smoothed)
    # beside the covariance that navigation alone has, a chi-square per degree of freedom
    z = np.linalg.solve(np.linalg.cholesky(block.navigation + 1e-6 * np.eye(block.mean.size)), block.mean.ravel())
    assert 0.1 < np.mean(z**2) < 2.5
    assert np.abs(measured.off[:, measured.used]).max() < {"odometer": 0.4, "barometer": 3.0, "heading": 0.05}[kind]


def test_covariances_of_two_nodes_are_those_of_a_filter_with_both_in_its_state(plain) -> None:
    """The gains between two nodes against the variance that both have on their own diagonal."""
    smoothed = plain[3]
    aid = next(a for a in plain[1] if a.kind == "barometer")
    block = Measured.of(aid, smoothed.shown_to(aid)).blocks(smoothed)
    P = block.navigation
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    assert np.linalg.eigvalsh(P).min() > -1e-9
    correlation = P / np.sqrt(np.outer(np.diag(P), np.diag(P)))
    near, far = correlation[100, 101], correlation[100, 250]
    assert 0.8 < near < 1.0
    assert abs(far) < 0.3


def test_the_jacobian_of_an_aid_comes_from_the_filter() -> None:
    aid = AidRecord("barometer", [0.0, 1.0], np.zeros((2, 1)), np.ones((2, 1)))
    nav = np.array([0.8, 0.2, 100.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(aid_jacobian(aid, nav), [[0, 0, -1, 0, 0, 0, 0, 0, 0]])


# -- what is named --------------------------------------------------------------------------------------------------------------------------

HIDDEN = {
    "scale": ({"effect": "odometer_scale_factor", "value": 0.01}, "value", 0.01),
    "turned": ({"effect": "odometer_misalignment", "yaw": "2 deg"}, "yaw", math.radians(2.0)),
    "offset": ({"effect": "barometer_offset", "value": 3.0}, "value", 3.0),
    "compass": ({"effect": "heading_deviation", "B": "3 deg"}, "B", math.radians(3.0)),
    "lag": ({"effect": "aid_lag", "sensor": "odometer", "lag": 0.3}, "lag", 0.3),
    "level": ({"effect": "barometer_noise_level", "factor": 2.0}, "factor", 2.0),
    "lasting": ({"effect": "odometer_correlated_noise", "sigma": [0.2, 0, 0], "tau": 10}, "sigma_forward", 0.2),
    "far": ({"effect": "aid_outliers", "sensor": "odometer", "probability": 0.02, "sigma": 1.0}, "probability", 0.02),
}


def looked(recording: Recording, believed, without=()):
    flown = Flown.of(*drive_without(recording, believed))
    return find_aid_effects(flown.prepared, flown.recording.aids, without, lambda _: None)


def test_good_aids_have_no_findings(plain, folder) -> None:
    found = looked(plain[0], nominal(folder))
    assert not found.findings
    assert {w.sensor for w in found.where} == set(AID_KINDS)
    assert min(w.p_value for w in found.after) > 1e-4


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
@pytest.mark.parametrize("name", HIDDEN)
def test_what_an_aid_is_off_by_is_named_with_its_size(folder, name: str) -> None:
    use, label, value = HIDDEN[name]
    found = looked(recorded(folder, use), nominal(folder))
    first = found.findings[0]
    assert [s.effect for s in found.findings] == [use["effect"]]
    v = next(v for v in first.parameters if v.name == label)
    assert abs(v.value - value) < 0.5 * value
    assert v.value - 2.0 * (v.value - v.low) < value < v.value + 2.0 * (v.high - v.value)
    assert first.nats > 10.0
    assert first.confidence > 0.9


@pytest.mark.slow(reason="a whole search with an odometer")
def test_an_odometer_that_is_wrong_costs_metres_in_outages_and_its_noise_does_not_hide_the_rest(folder) -> None:
    scale, lag, off = HIDDEN["scale"][0], HIDDEN["lag"][0], HIDDEN["offset"][0]
    found = {s.effect: s for s in looked(recorded(folder, scale, lag, off), nominal(folder)).findings}
    assert set(found) == {"odometer_scale_factor", "aid_lag", "barometer_offset"}
    # an urban drive goes 400 to 700 m in a minute
    assert 1.0 < found["odometer_scale_factor"].metres < 12.0
    assert found["odometer_scale_factor"].aided_nees > 2.0
    assert found["barometer_offset"].metres < 0.1


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_the_last_part_of_an_aid_judges_what_its_first_part_names(folder) -> None:
    recording, believed = recorded(folder, HIDDEN["scale"][0], HIDDEN["offset"][0]), nominal(folder)
    flown = Flown.of(*drive_without(recording, believed))
    aids = flown.recording.aids
    found = find_aid_effects(flown.prepared, aids, (), lambda _: None, hold_out=True)
    assert set(found.held_out) == {"odometer", "barometer"}
    assert min(g.low for g in found.held_out.values()) > 0.0
    # an offset that ends with the first part predicts the last part worse
    barometer = next(a for a in aids if a.kind == "barometer")
    late = barometer.t > 200.0
    ends = replace(barometer, values=barometer.values - 3.0 * late[:, None])
    changed = find_aid_effects(flown.prepared, (ends,), (), lambda _: None, hold_out=True)
    gain = changed.held_out["barometer"]
    assert gain.high < found.held_out["barometer"].low


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_an_effect_that_is_left_out_is_not_named(plain) -> None:
    odometer = next(a for a in plain[0].aids if a.kind == "odometer")
    long = replace(odometer.rows(odometer.t < 150.0), values=1.01 * odometer.values[odometer.t < 150.0])
    (named,) = (find_aid_effects(plain[2].prepared, (long,), (), lambda _: None)).findings
    assert named.effect == "odometer_scale_factor"
    found = find_aid_effects(plain[2].prepared, (long,), ("odometer_scale_factor",), lambda _: None)
    assert "odometer_scale_factor" not in {s.effect for s in found.findings}


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_second_look_at_the_refined_model_finds_nothing(folder) -> None:
    uses = [HIDDEN[k][0] for k in ("turned", "far")]
    uses += [{"effect": "barometer_correlated_noise", "sigma": 1.0, "tau": 60}, HIDDEN["compass"][0]]
    recording, believed = recorded(folder, *uses), nominal(folder)
    report = find_gap(recording, believed, rng=np.random.default_rng(1), hold_out=False)
    assert {s.effect for s in report.findings} == {u["effect"] for u in uses}
    again = find_gap(recording, refined_nominal(believed, report), rng=np.random.default_rng(1), hold_out=False)
    assert again.verdict == "nothing missing"
    assert not again.findings


def test_aids_are_on_the_clock_of_the_imu(folder) -> None:
    late = {"effect": "imu_gnss_time_offset", "offset": 0.2}
    recording, believed = recorded(folder, late), nominal(folder)
    known = replace(believed, effects=(EffectUse.from_mapping(late),))
    back, _ = drive_without(recording, known)
    first = recorded(folder)
    for a, b in zip(back.aids, first.aids, strict=True):
        np.testing.assert_allclose(a.t, b.t, atol=1e-9)
    assert not looked(recording, known).findings


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_wheel_that_comes_late_has_no_outliers_in_hard_manoeuvres() -> None:
    """A fighter turns and speeds up at times only: 0.17 s late, its speed is far off there and nowhere else."""
    job = Job("aid", 780088, 360.0, True, vehicles=("c172p", "DHC6", "T38", "A4", "f16", "A320"))
    world, hidden, _ = drawn(job)
    found = {s.effect: s for s in looked(*taken(world, hidden)).findings}
    assert set(found) == {"aid_lag"}
    (lag,) = found["aid_lag"].parameters
    assert lag.low < hidden[0].values["lag"] < lag.high


WRONG = {
    "kilometres an hour": (lambda a: replace(a, values=3.6 * a.values), "odometer", "km/h"),
    "the other sign": (lambda a: replace(a, values=-a.values), "odometer", "sign reversed"),
    "nothing": (lambda a: replace(a, values=0.0 * a.values), "odometer", "0 times what IMU and fixes say"),
    "degrees": (lambda a: replace(a, values=np.rad2deg(a.values)), "heading", "are these degrees"),
}


@pytest.mark.parametrize("name", WRONG)
def test_an_aid_that_is_something_else_is_refused_by_name(plain, name: str) -> None:
    change, kind, words = WRONG[name]
    aid = change(next(a for a in plain[0].aids if a.kind == kind))
    with pytest.raises(InputError, match=words) as caught:
        check_aids(plain[2].prepared, (aid,), "drive.npz")
    assert str(caught.value).startswith("drive.npz: aid_")


def test_it_is_refused_before_the_search(folder) -> None:
    recording, said = recorded(folder), list[str]()
    aids = tuple(replace(a, values=3.6 * a.values) if a.kind == "odometer" else a for a in recording.aids)
    made = replace(recording, aids=aids)
    with pytest.raises(InputError, match="km/h"):
        find_gap(made, nominal(folder), rng=np.random.default_rng(1), progress=said.append)
    assert not any("effect" in words for words in said)


@pytest.mark.slow(reason="a whole search with an odometer")
def test_a_wheel_across_whose_way_nothing_moves_may_be_turned_by_much(plain) -> None:
    """Its other rows are often held at zero: they say nothing of a unit, and 12 degrees is a misalignment."""
    recording, _, flown, _ = plain
    odometer = next(a for a in recording.aids if a.kind == "odometer")
    odometer = odometer.rows(odometer.t < 150.0)
    forward = odometer.values[:, 0]
    turned = np.column_stack([math.cos(0.2) * forward, -math.sin(0.2) * forward, 0.0 * forward])
    made = (replace(odometer, values=turned),)
    found = {s.effect: s for s in find_aid_effects(flown.prepared, made, (), lambda _: None).findings}
    yaw = next(v for v in found["odometer_misalignment"].parameters if v.name == "yaw")
    assert yaw.value == pytest.approx(0.2, abs=0.02)
    # and the same wheel the other way about: what should be across is 2 m/s, and zero is said
    across = replace(
        odometer,
        settings=(0.0, 0.0, 0.0, 0.0, 0.0, 0.2),
        values=np.column_stack([forward, 0.0 * forward, 0.0 * forward]),
    )
    check_aids(flown.prepared, (across,), "drive.npz")


ODD = {
    "forward alone": lambda a: replace(a, values=a.values * [1.0, math.nan, math.nan]),
    "two rows without a limit": lambda a: replace(a, std=a.std * [1.0, math.inf, math.inf]),
    "a third missing": lambda a: replace(a, values=np.where(np.arange(len(a))[:, None] % 3 == 0, math.nan, a.values)),
    "a gap": lambda a: replace(a, t=np.delete(a.t, slice(500, 900)), values=np.delete(a.values, slice(500, 900), 0), std=a.std[:-400]),
    "hardly any": lambda a: replace(a, t=a.t[:20], values=a.values[:20], std=a.std[:20]),
    "no noise stated": lambda a: replace(a, std=0.0 * a.std),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_an_aid_that_is_there_in_part_is_looked_at_as_far_as_it_goes(plain, name: str) -> None:
    aid = ODD[name](next(a for a in plain[0].aids if a.kind == "odometer"))
    found = find_aid_effects(plain[2].prepared, (aid,), (), lambda _: None)
    assert not found.findings
    assert bool(found.where) == (name not in ("hardly any", "no noise stated"))


# -- the likelihood -------------------------------------------------------------------------------------------------------------------------


def block(span: float, width: float, each: int, sigma: float, tau: float, seed: int) -> AidResiduals:
    """Blocks of an aid with white noise as stated and an error that lasts, and of perfect navigation."""
    rng = np.random.default_rng(seed)
    n, step = int(span / width) * each, width / each
    a, x = math.exp(-step / tau), rng.standard_normal(int(span / width) * each)
    g = np.empty(n)
    g[0] = x[0]
    for k in range(1, n):
        g[k] = a * g[k - 1] + math.sqrt(1.0 - a * a) * x[k]
    y = (rng.standard_normal(n) + sigma * g).reshape(-1, each)
    mean = y.mean(axis=1)
    within = np.array([((y - mean[:, None]) ** 2).sum()])
    t = (np.arange(n) * step).reshape(-1, each).mean(axis=1)
    m = mean.size
    return AidResiduals(
        "barometer", ("height",), t, mean[:, None], np.zeros((0, m, 1)), np.full(m, float(each)), within, np.zeros((1, 0)),
        np.zeros((1, 0, 0)), np.zeros((m, m)), (), np.ones(1), {}, np.zeros(1),
    )  # fmt: skip


def test_means_of_an_error_that_lasts_have_the_covariance_of_an_average() -> None:
    data = block(60.0, 3.0, 300, 1.0, 5.0, 1)
    fine = np.arange(0.0, 9.0, 0.01)
    whole = np.exp(-np.abs(fine[:, None] - fine) / 5.0)
    parts = whole.reshape(3, 300, 3, 300).mean(axis=(1, 3))
    np.testing.assert_allclose(data.lasting(5.0)[:3, :3], parts, rtol=2e-3)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_intervals_of_an_error_that_lasts_hold_the_truth() -> None:
    """40 recordings of 360 s each with 8 and 40 s: 95 of a hundred; a normal interval of the logarithm held 88 at 40 s."""
    for tau in (8.0, 40.0):
        hits = np.zeros(2, dtype=int)
        for seed in range(40):
            start = AidModel.nominal(block(360.0, 1.2, 5, 3.0, tau, seed), np.zeros(0), {})
            model = start.with_lasting(0)
            assert model is not None
            spread = model.spread(inside=True)
            for k, true in enumerate((3.0, tau)):
                low, high = model.interval(1 + k, spread)
                hits[k] += low < math.log(true) < high
        assert hits.min() >= 36


def test_white_noise_as_stated_is_no_error_that_lasts() -> None:
    start = AidModel.nominal(block(360.0, 1.0, 5, 0.0, 10.0, 3), np.zeros(0), {})
    assert start.with_lasting(0) is None
    assert not start.at_edge(0)
    assert start.noise.level == pytest.approx(1.0, abs=0.05)


def test_a_few_large_numbers_are_told_from_the_rest() -> None:
    rng = np.random.default_rng(2)
    x = rng.standard_normal(3000)
    assert Mixture.of(x).nats < 0.0
    hit = rng.random(3000) < 0.02
    mixture = Mixture.of(x + hit * 15.0 * rng.standard_normal(3000))
    assert mixture.nats > 100.0
    assert abs(math.log(mixture.share / 0.02)) < 3.0 * mixture.spread[0]
    assert abs(math.log(mixture.size / 15.0)) < 3.0 * mixture.spread[1]


# -- at the terminal ------------------------------------------------------------------------------------------------------------------------


def test_gap_looks_at_the_aids_of_a_file_and_says_which_it_does_not_know(tmp_path, capsys) -> None:
    world, hidden, worth = drawn(Job("none", 480003, 90.0, True))
    write(tmp_path / "drive", world, hidden, worth)
    with np.load(tmp_path / "drive.npz") as file:
        arrays = dict(file)
    n = arrays["gnss_t"].size
    height = {"aid_barometer_t": arrays["gnss_t"], "aid_barometer": arrays["gnss_llh"][:, 2:] + 25.0}
    rest = {
        "aid_standstill_t": arrays["gnss_t"][:1],
        "aid_standstill": np.zeros((1, 6)),
        "aid_standstill_std": np.ones((1, 6)),
    }
    std = {"aid_barometer_std": np.full((n, 1), 0.5)}
    np.savez(tmp_path / "drive.npz", **arrays, **height, **std, **rest)
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as stop:
        main(["gap", str(tmp_path / "drive.yaml"), str(tmp_path / "drive.npz"), "--output", str(out)])
    assert not stop.value.code
    said = capsys.readouterr()
    assert "standstill not looked at: only IMU, fixes, odometer, barometer and heading are" in " ".join(
        said.err.split()
    )
    assert "off the barometric height" in " ".join(said.out.split())
    named = [s for s in json.loads((out / "gap.json").read_text())["steps"] if s["sensor"] == "barometer"]
    assert "barometer_offset" in {s["effect"] for s in named}
    assert "barometer_offset" in (out / "refined.yaml").read_text()
    assert "barometer" in (out / "index.html").read_text(encoding="utf-8")


def test_names_say_once_of_which_aid_and_the_fixes_judge_none(plain, folder) -> None:
    report = find_gap(plain[0], nominal(folder), rng=np.random.default_rng(1), hold_out=False)
    v = (Value("value", 0.01, 0.009, 0.011, ""),)
    own = Finding("odometer_scale_factor", "", "odometer", (), v, 1.0, 50.0, (), metres=3.0, aided_nees=2.0)
    lag = replace(own, effect="aid_lag", parameters=(Value("lag", 0.1, 0.09, 0.11, "s"),))
    row = replace(own, effect="odometer_correlated_noise", axes=("sideways",))
    said = gap_headline(replace(report, verdict="named", findings=(own, lag, row)))
    assert "odometer scale factor; lag of the measurements of the odometer; correlated odometer noise, sideways" in said
    assert is_better(replace(report, findings=(own,)))[0] == "not scored"
    for low, high, word in ((0.1, 0.3, "yes"), (-0.1, 0.3, "not shown"), (-0.3, -0.1, "no")):
        held = {"odometer": Interval(0.5 * (low + high), low, high)}
        assert is_better(replace(report, findings=(own,), aids_held_out=held))[0] == word
    assert replace(report, findings=(own,), stated_60s=1.0).nees(own) == 2.0


def test_every_aid_that_can_be_emulated_can_be_looked_at() -> None:
    assert {name for name, aid in AIDS.items() if aid.truth is not None} >= set(AID_KINDS)
