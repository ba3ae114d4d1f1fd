"""What was found, written down: every effect of the catalogue as a scenario that runs, the truth recovered, the loop closed."""

from __future__ import annotations

import functools
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import butter, lfilter

from benchmarks.trial.drives import stage
from insemu import rotation
from insemu.effects import EFFECTS, EffectUse, joined
from insemu.errors import InputError
from insemu.evaluate import Experiment, run_experiment
from insemu.evaluate.emulated import EmulatedWorld
from insemu.gap import (
    Finding,
    GapReport,
    StaticLog,
    find_gap,
    from_its_start,
    load_measured,
    load_nominal,
    write_refined,
)
from insemu.gap.beliefs.refined import refined_nominal, uses_of
from insemu.gap.candidates.axis import CANDIDATES
from insemu.gap.session import _confirmed, _further_passes, _merged_pass
from insemu.gap.verdict import Interval, Member, Value, with_held_out
from insemu.noise import AR, BI, DR, GM, QN, RW, SIN, WN, NoiseModel
from insemu.records import AidRecord, GnssRecord, ImuRecord, Recording, Series
from insemu.report.gap import (
    FIRST_SCREEN,
    effect_name,
    filtered_said,
    finding_action,
    folded_said,
    gap_headline,
    render_gap,
)
from insemu.scenario import load

NOMINAL = """
title: nominal
seed: 3
realizations: 1
trajectory: {builtin: lemniscate, rate: 20 Hz, duration: 40 s}
truth: {gyro: WN(N=1e-4 rad/s/sqrt(Hz)), accel: WN(N=1e-3 m/s^2/sqrt(Hz))}
gnss: {rate: 1 Hz, lever_arm: [1 m, 0 m, 0 m], outages: [{start: 20 s, duration: 5 s}]}
designs:
  nominal: {gyro: {truth: true}, accel: {truth: true}}
"""

#: Effect, sensor, axes, variant, parameters as the search names them, and what the file must say.
FOUND: dict[str, tuple[str, tuple[str, ...], str, dict[str, float], dict[str, Any]]] = {
    "turn_on_bias": ("gyro", ("x",), "", {"value_x": 1e-3}, {"value": [1e-3, 0, 0]}),
    "scale_factor": ("gyro", ("x", "y", "z"), "all", {"value_x": 1e-3, "value_y": 2e-3, "value_z": -3e-3}, {"value": [1e-3, 2e-3, -3e-3]}),
    "scale_asymmetry": ("accel", ("y",), "", {"value_y": 1e-3}, {"value": [0, 1e-3, 0]}),
    "misalignment": ("accel", ("y",), "", {"value_yx": 2e-3}, {"value": [0, 0, 2e-3, 0, 0, 0]}),
    "g_sensitivity": ("gyro", ("z",), "", {"value_zx": 1e-5}, {"value": [0, 0, 0, 0, 0, 0, 1e-5, 0, 0]}),
    "g2_sensitivity": ("gyro", ("y",), "", {"value_y": 1e-7}, {"value": [0, 1e-7, 0]}),
    "mounting": ("imu", ("roll", "pitch", "yaw"), "", {"rpy_roll": 0.0, "rpy_pitch": 0.01, "rpy_yaw": 0.02}, {"rpy": [0, 0.01, 0.02]}),
    "temperature": ("gyro", ("y",), "cubic", {"c1": 1e-4, "c2": 0.0, "c3": 1e-7, "T0": 28.0}, {"c1": [0, 1e-4, 0], "T0": 28.0}),
    "temperature_scale_factor": ("gyro", ("z",), "", {"value_z": 5e-4}, {"value": [0, 0, 5e-4], "T0": 25.0}),
    "temperature_misalignment": ("accel", ("x",), "", {"value_xz": 1e-5}, {"value": [0, 1e-5, 0, 0, 0, 0]}),
    "saturation": ("gyro", ("z",), "", {"limit": 0.3}, {"limit": [1e6, 1e6, 0.3]}),
    "dropped_samples": ("accel", ("x",), "held", {"probability": 0.01}, {"probability": 0.01}),
    "imu_gnss_time_offset": ("imu", (), "", {"offset": 0.02}, {"offset": 0.02}),
    "clock_drift": ("imu", (), "", {"drift": 1e-4}, {"drift": 1e-4}),
    "gnss_noise_level": ("gnss", ("north", "east"), "", {"factor": 2.0}, {"factor": [2.0, 2.0, 1.0]}),
    "gnss_velocity_noise": ("gnss", ("down",), "", {"factor": 3.0}, {"factor": [1.0, 1.0, 3.0]}),
    "gnss_correlated_noise": ("gnss", ("north",), "", {"sigma": 0.3, "tau": 20.0}, {"sigma": [0.3, 0, 0], "tau": 20.0}),
    "lever_arm": ("gnss", ("x",), "", {"value_x": 0.2}, {"value": [0.2, 0, 0]}),
    "gnss_velocity_lag": ("gnss", (), "", {"lag": 0.05}, {"lag": 0.05}),
    "gnss_velocity_filter": ("gnss", ("down",), "", {"tau_down": 0.3}, {"tau": [0, 0, 0.3]}),
    "gnss_position_filter": ("gnss", ("north", "east"), "", {"tau": 0.5}, {"tau": [0.5, 0.5, 0]}),
    "lever_arm_step": ("gnss", ("y",), "", {"value": 0.4, "start": 20.0}, {"value": [0, 0.4, 0], "start": 20.0}),
    "gnss_multipath_step": ("gnss", ("east",), "", {"value": 2.0, "start": 10.0, "duration": 8.0}, {"value": [0, 2.0, 0], "start": 10.0}),
    "gnss_velocity_outliers": ("gnss", ("north", "east", "down"), "", {"probability": 0.05, "sigma": 0.4}, {"sigma": [0.4, 0.4, 0.4]}),
    "gnss_outliers": ("gnss", ("north", "east", "down"), "", {"probability": 0.05, "sigma": 4.0}, {"sigma": [4.0, 4.0, 4.0]}),
    "odometer_scale_factor": ("odometer", (), "", {"value": 0.01}, {"value": 0.01}),
    "odometer_misalignment": ("odometer", (), "", {"yaw": 0.02}, {"pitch": 0.0, "yaw": 0.02}),
    "barometer_offset": ("barometer", (), "", {"value": 3.0}, {"value": 3.0}),
    "barometer_scale_factor": ("barometer", (), "", {"value": 0.02, "h0": 240.0}, {"value": 0.02, "h0": 240.0}),
    "heading_offset": ("heading", (), "", {"value": 0.02}, {"value": 0.02}),
    "heading_deviation": ("heading", (), "", {"B": 0.02, "E": 0.01}, {"B": 0.02, "C": 0.0, "E": 0.01}),
    "aid_lag": ("odometer", (), "", {"lag": 0.1}, {"lag": 0.1}),
    "odometer_noise_level": ("odometer", ("down",), "", {"factor_down": 2.0}, {"factor": [1.0, 1.0, 2.0]}),
    "barometer_noise_level": ("barometer", (), "", {"factor": 2.0}, {"factor": 2.0}),
    "heading_noise_level": ("heading", (), "", {"factor": 2.0}, {"factor": 2.0}),
    "odometer_correlated_noise": ("odometer", ("forward",), "", {"sigma_forward": 0.1, "tau": 20.0}, {"sigma": [0.1, 0, 0], "tau": 20.0}),
    "barometer_correlated_noise": ("barometer", (), "", {"sigma": 1.0, "tau": 60.0}, {"sigma": 1.0, "tau": 60.0}),
    "heading_correlated_noise": ("heading", (), "", {"sigma": 0.02, "tau": 30.0}, {"sigma": 0.02, "tau": 30.0}),
    "aid_outliers": ("barometer", (), "", {"probability": 0.02, "sigma": 5.0}, {"probability": 0.02, "sigma": 5.0}),
    "earth_rate": ("imu", (), "", {"fraction": 0.9}, {"fraction": 0.9}),
    "gravity": ("imu", (), "", {"offset": 0.01}, {"offset": 0.01}),
    "transport_rate": ("imu", (), "", {"fraction": 1.1}, {"fraction": 1.1}),
    "expression": ("gnss", ("east = speed",), "", {"value": -0.05}, {"equation": "east = speed", "value": -0.05}),
    "expression_step": (
        "accel", ("x = force_y",), "", {"value": 0.01, "start": 20.0}, {"equation": "x = force_y", "value": 0.01, "start": 20.0},
    ),
    "ramp": ("gyro", ("y",), "", {"R": -1e-6}, {"R": [0, -1e-6, 0]}),
    "outliers": (
        "accel", ("x", "z"), "", {"probability_x": 0.01, "sigma_x": 1.0, "probability_z": 0.02, "sigma_z": 2.0},
        {"probability": 0.01, "sigma": [1.0, 0, 0]},
    ),
    "bias_step": ("accel", ("y",), "step", {"value": 0.02, "start": 20.0}, {"value": [0, 0.02, 0], "start": 20.0}),
    "telegraph": ("gyro", ("x",), "", {"amplitude": 1e-3, "rate": 0.05}, {"amplitude": [1e-3, 0, 0], "rate": 0.05}),
    "quantization": ("accel", ("x",), "output counts", {"lsb": 0.03}, {"lsb": [0.03, 0, 0]}),
    "decimation_filter": ("gyro", ("z",), "butterworth", {"cutoff": 6.0, "order": 2.2}, {"cutoff": 6.0, "order": 2.0}),
    "vibration_band": ("accel", ("x",), "", {"rms": 0.1, "frequency": 5.0, "bandwidth": 1.0}, {"rms": [0.1, 0, 0], "frequency": 5.0}),
    "vibration_line": ("accel", ("x",), "", {"amplitude": 0.1, "frequency": 5.0}, {"amplitude": [0.1, 0, 0], "frequency": 5.0}),
}  # fmt: skip

#: Noise that joins the model of an axis.
NOISE = {"white_noise": WN(3e-4), "random_walk": RW(1e-5), "gauss_markov": GM(1e-3, 0.1), "flicker": BI(1e-4)}


def step(effect: str) -> Finding:
    sensor, axes, variant, values, _ = FOUND[effect]
    parameters = tuple(Value(k, v, 0.9 * v, 1.1 * v, "") for k, v in values.items())
    return Finding(effect, variant, sensor, axes, parameters, 1.0, 50.0, (Member(effect, sensor, axes, 50.0),))


def report(*steps: Finding, refined: dict[str, NoiseModel] | None = None) -> GapReport:
    none = Interval(float("nan"), float("nan"), float("nan"))
    return GapReport("named", steps, (), (), none, none, none, refined=refined or {})


@functools.cache
def measured() -> Recording:
    r = EmulatedWorld(load(_scenario())).recording(0)
    return Recording(
        type(r.imu)(r.imu.t, r.imu.gyro, r.imu.accel, r.imu.kind, 20.0 + 0.5 * r.imu.t),
        r.gnss,
        r.reference,
        "drive.npz",
        tuple(
            AidRecord(kind, np.arange(1.0, 39.0, 0.5), np.zeros((76, rows)), np.full((76, rows), 0.1))
            for kind, rows in (("odometer", 3), ("barometer", 1), ("heading", 1))
        ),
    )


@functools.cache
def _scenario() -> Path:
    import tempfile

    path = Path(tempfile.mkdtemp()) / "nominal.yaml"
    path.write_text(NOMINAL)
    return path


def test_every_effect_of_the_catalogue_has_a_place_in_the_refined_model() -> None:
    # a process that axes share is written as noise of several axes: tests/test_together.py
    assert {e.id for e in EFFECTS.values() if "refine" not in e.absent} == {*FOUND, *NOISE, "shared_process"}


def test_a_scenario_gets_the_aids_whose_effects_were_found(tmp_path: Path) -> None:
    path = write_refined(load_nominal(_scenario()), report(step("aid_lag")), tmp_path / "refined.yaml", measured())
    (use,) = load(path).aids
    assert (use.aid.name, use.rate, use.sigma) == ("odometer", pytest.approx(2.0), (0.1, 0.1, 0.1))


@pytest.mark.parametrize("effect", FOUND)
def test_what_was_found_becomes_a_scenario_that_runs_with_its_values(effect: str, tmp_path: Path) -> None:
    nominal = load_nominal(_scenario())
    path = write_refined(nominal, report(step(effect)), tmp_path / "refined.yaml", measured())
    refined = load(path)
    assert refined.truth is not None
    uses = [u for u in refined.truth.effects if u.id == effect]
    assert uses
    for name, value in FOUND[effect][4].items():
        if name == "equation":
            assert uses[0].equation == value
        else:
            np.testing.assert_allclose(uses[0][name], value)
    results = run_experiment(Experiment(refined, path), realizations=1)
    assert list(results.designs) == ["nominal", "refined"]
    assert np.isfinite(results.nis).all()
    # the file is itself a nominal model that knows the effect
    again = load_nominal(path)
    assert [u.to_mapping() for u in again.effects] == [u.to_mapping() for u in refined.truth.effects]


@pytest.mark.parametrize("effect", NOISE)
def test_noise_joins_the_models_of_truth_and_filter(effect: str, tmp_path: Path) -> None:
    nominal = load_nominal(_scenario())
    model = NoiseModel((NOISE[effect],)) if effect == "white_noise" else nominal.beliefs["gyro_x"] + NOISE[effect]
    found = Finding(effect, "", "gyro", ("x",), (), 1.0, 50.0, ())
    path = write_refined(nominal, report(found, refined={"gyro_x": model}), tmp_path / "refined.yaml", measured())
    refined = load(path)
    assert refined.truth is not None
    assert refined.truth.models()["gyro_x"] == model
    experiment = Experiment(refined, path)
    carried = experiment.beliefs["refined"].models["gyro_x"]
    assert len(carried.processes) == (5 if effect == "flicker" else len(model.processes))
    assert np.isfinite(run_experiment(experiment, realizations=1).nis).all()


def test_the_filter_that_takes_an_effect_off_is_consistent_and_the_nominal_one_is_not(tmp_path: Path) -> None:
    nominal = load_nominal(_scenario())
    path = write_refined(nominal, report(step("lever_arm"), step("gravity")), tmp_path / "refined.yaml", measured())
    results = run_experiment(Experiment(load(path), path), realizations=2)
    names = list(results.designs)
    nis = dict(zip(names, results.nis.mean(axis=1), strict=True))
    # 210 components: a consistent filter is within 1 +- 0.4 beyond 4 sigma
    assert nis["nominal"] > 2.0
    assert 0.6 < nis["refined"] < 1.4


def test_a_belief_file_stays_one_and_a_noise_file_becomes_one_where_it_must(tmp_path: Path) -> None:
    belief = tmp_path / "belief.yaml"
    belief.write_text(
        "belief: {gyro: WN(N=1e-4), accel: WN(N=1e-3)}\neffects: [{effect: lever_arm, value: [0.1, 0, 0]}]\nvehicle: {sigma: 0.2}\n"
    )
    nominal = load_nominal(belief)
    path = write_refined(nominal, report(step("lever_arm")), tmp_path / "refined.yaml", measured())
    again = load_nominal(path)
    assert again.kind == "belief"
    assert again.effects[0]["value"] == pytest.approx((0.3, 0.0, 0.0))
    assert again.vehicle is not None
    assert again.vehicle.sigma == 0.2
    from insemu.noise import save

    save({"gyro_x": NoiseModel((WN(1e-4),))}, tmp_path / "noise.yaml")
    noise = load_nominal(tmp_path / "noise.yaml")
    assert load_nominal(write_refined(noise, report(), tmp_path / "a.yaml")).kind == "noise"
    assert load_nominal(write_refined(noise, report(step("ramp")), tmp_path / "b.yaml")).effects[0].id == "ramp"


def test_paths_of_a_scenario_lead_to_the_same_files_from_another_folder(tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("x\n")
    raw = yaml.safe_load(NOMINAL)
    from insemu.gap.beliefs.refined import _moved

    (tmp_path / "out").mkdir()
    moved = _moved({**raw, "trajectory": {"motion": "way.csv"}}, tmp_path, tmp_path / "out")
    assert (tmp_path / "out" / moved["trajectory"]["motion"]).resolve() == (tmp_path / "way.csv").resolve()
    assert _moved({"file": "shared:real/x.npz"}, tmp_path, tmp_path / "out") == {"file": "shared:real/x.npz"}


def test_corrections_add_up_multiply_or_turn() -> None:
    def use(effect: str, **values: Any) -> EffectUse:
        return EffectUse.from_mapping({"effect": effect, **values})

    both = joined([use("lever_arm", value=[0.1, 0, 0])], [use("lever_arm", value=[0.1, 0.2, 0])])
    assert both[0]["value"] == pytest.approx((0.2, 0.2, 0.0))
    both = joined([use("gnss_noise_level", factor=2.0)], [use("gnss_noise_level", factor=[0.5, 1, 2])])
    assert both[0]["factor"] == pytest.approx((1.0, 2.0, 4.0))
    a, b = use("mounting", rpy=[np.pi, 0, np.pi]), use("mounting", rpy=[0, -0.1, 0.2])
    C = rotation.dcm_from_rpy(np.array(b["rpy"])) @ rotation.dcm_from_rpy(np.array(a["rpy"]))
    np.testing.assert_allclose(rotation.dcm_from_rpy(np.array(joined([a], [b])[0]["rpy"])), C, atol=1e-12)
    assert (
        len(joined([use("temperature", sensor="gyro", c1=1e-3)], [use("temperature", sensor="gyro", c1=1e-3, T0=30.0)]))
        == 2
    )


def passes(first: GapReport, *later: GapReport) -> tuple[GapReport, int]:
    """A report after passes that find this, and how many were asked for."""
    found = list(later)
    nominal = load_nominal(_scenario())
    out, _ = _further_passes(measured(), nominal, first, lambda *_: found.pop(0), [], lambda _: None)
    return out, len(later) - len(found)


def strong(effect: str, nats: float, **values: float) -> Finding:
    """A finding worth so much, some of its values others."""
    s = step(effect)
    given = tuple(replace(v, value=(x := values.get(v.name, v.value)), low=x - 0.5, high=x + 0.5) for v in s.parameters)
    return replace(s, nats=nats, parameters=given)


def test_a_correction_that_leaves_more_than_there_was_is_taken_back() -> None:
    """A flight whose level of the fixes was corrected from 0.05 to 0.2 to 0.5, at 130 and then at 970 nats."""
    first = report(strong("lever_arm", 200.0))
    closer, asked = passes(first, report(strong("lever_arm", 40.0, value_x=1.2)), report())
    (arm,) = closer.findings
    assert asked == 2 and arm.parameters[0].value == pytest.approx(1.4)
    assert passes(
        first, report(strong("lever_arm", 40.0, value_x=1.2)), report(strong("lever_arm", 45.0, value_x=1.2))
    ) == (first, 2)
    assert passes(first, report(strong("lever_arm", 900.0))) == (first, 1)
    # what two looks are worth differs by chance
    assert (
        passes(first, report(strong("lever_arm", 40.0, value_x=1.2)), report(strong("lever_arm", 42.0, value_x=1.2)))[0]
        is not first
    )


def test_a_later_pass_corrects_a_step_at_its_own_times() -> None:
    """Whatever the interval of when it began: half a metre from 75 s on had gone into a step from 760 s on."""

    def shift(value: float, start: tuple[float, ...], duration: tuple[float, ...]) -> Finding:
        parameters = (
            Value("value", value, value - 0.1, value + 0.1, "m"),
            Value("start", *start, "s"),
            Value("duration", *duration, "s"),
        )
        return replace(step("gnss_multipath_step"), axes=("north",), parameters=parameters)

    old = shift(0.4, (760.5, 54.0, 761.0), (632.0, 380.0, 706.0))
    other = shift(-0.5, (75.0, 74.7, 75.2), (630.0, 1.8, 807.0))
    same = shift(0.1, (760.4, 760.2, 760.8), (632.1, 631.0, 633.0))
    assert set(_merged_pass(report(old), report(other), []).findings) == {old, other}
    (corrected,) = _merged_pass(report(old), report(same), []).findings
    assert corrected.parameters[0].value == pytest.approx(0.5)
    assert corrected.parameters[1:] == old.parameters[1:]


def test_a_later_pass_corrects_each_number_where_it_stands() -> None:
    """Two findings of a lever arm, of z and of x: the later pass had made of the first one of z and x, beside the second."""
    arms = [
        replace(strong("lever_arm", 200.0), axes=(a,), parameters=(Value(f"value_{a}", 1.0, 0.5, 1.5, "m"),))
        for a in "zx"
    ]
    more = replace(
        strong("lever_arm", 40.0), axes=("x", "y", "z"),
        parameters=tuple(Value(f"value_{a}", v, v - 0.1, v + 0.1, "m") for a, v in (("x", 0.2), ("y", 2.0), ("z", 0.4))),
    )  # fmt: skip
    closer, _ = passes(report(*arms), report(more), report())
    assert {f.axes: {v.name: pytest.approx(v.value) for v in f.parameters} for f in closer.findings} == {
        ("z", "y"): {"value_z": 1.4, "value_y": 2.0},
        ("x",): {"value_x": 1.2},
    }


def test_a_later_level_multiplies_that_of_its_own_axes() -> None:
    """A factor of 0.57 of the velocities downwards had made 0.22 of 0.39 of north and east; the next look found 1,120 nats."""

    def level(axes: tuple[str, ...], factor: float) -> Finding:
        return replace(strong("gnss_velocity_noise", 200.0, factor=factor), axes=axes)

    def factors(*looks: Finding) -> dict[tuple[str, ...], float]:
        first, *more = looks
        closer, _ = passes(report(first), *(report(s) for s in more), report())
        return {f.axes: pytest.approx(f.parameters[0].value) for f in closer.findings}

    level_axes = ("north", "east")
    assert factors(level(level_axes, 0.4), level(("down",), 0.5)) == {level_axes: 0.4, ("down",): 0.5}
    assert factors(level((*level_axes, "down"), 0.4), level(("down",), 0.5)) == {("down",): 0.2, level_axes: 0.4}
    assert factors(level(level_axes, 0.4), level((*level_axes, "down"), 0.5)) == {level_axes: 0.2, ("down",): 0.5}


def test_what_is_worth_few_metres_stands_behind_what_has_none() -> None:
    """A lever arm of 2 m after a minute, beside 427 m, put a mounting of 7 deg off the first screen."""
    worth = {"clock_drift": 427.0, "mounting": np.nan, "lever_arm": 2.0, "gnss_velocity_lag": 20.0}
    findings = [replace(strong("clock_drift", 100.0), effect=e, metres=m) for e, m in worth.items()]
    shown = [f.effect for _, f in report(*findings).numbered()]
    assert shown == ["clock_drift", "gnss_velocity_lag", "mounting", "lever_arm"]


def test_metres_count_by_how_sure_a_name_is() -> None:
    worth = {"clock_drift": (606.0, 0.0), "lever_arm": (48.0, 0.13), "gnss_velocity_lag": (20.0, 1.0)}
    findings = [replace(strong(e, 100.0), metres=m, confidence=c) for e, (m, c) in worth.items()]
    shown = [f.effect for _, f in report(*findings).numbered()]
    assert shown == ["gnss_velocity_lag", "lever_arm", "clock_drift"]


def test_the_sentence_above_names_three_and_counts_the_others(tmp_path: Path) -> None:
    """Of a real drive it named all of 17 findings, in a larger type than anything else on the page."""
    worth = {"clock_drift": 40.0, "lever_arm": 3.0, "gnss_velocity_lag": 20.0, "mounting": 47.0, "scale_factor": 9.0}
    findings = [
        replace(strong("clock_drift", 100.0), effect=e, metres=m, axes=(), doubtful=e != "mounting")
        for e, m in worth.items()
    ]
    said = gap_headline(report(*findings))
    assert said.startswith("Missing from the model: mounting angles") and "; and 2 more." in said
    assert said.endswith("in the place of 4 of 5.") and "lever" not in said
    many = report(*findings, *(replace(strong("ramp", 5.0), metres=0.5, axes=(a,)) for a in "xyz"))
    page = render_gap(many, tmp_path).read_text(encoding="utf-8")
    assert page.count('class="card ') == 1 + FIRST_SCREEN
    # the table too begins with those; the others are behind a fold
    assert page.index(">6. ") < page.index("<summary>2 more</summary>") < page.index(">8. ")
    # many of one effect are counted apart
    steps = [replace(strong("gnss_multipath_step", 5.0), metres=0.01, axes=(a,)) for a in ("north", "east", "down")]
    assert folded_said(many) == "2 more" and not folded_said(report(*findings))
    named = effect_name("gnss_multipath_step")
    assert folded_said(report(*many.findings, *steps)) == f"5 more, 3 of them: {named}"


def test_positions_from_a_filter_in_the_receiver_are_said_to_be_that(tmp_path: Path) -> None:
    """A receiver that fuses its own sensors states 1 m and scatters by 6 mm: multiplying what it states by 0.006 was all that was said."""
    level, colour = (
        replace(strong("gnss_noise_level", 8870.0, factor=0.006), axes=("north", "east", "down")),
        strong("gnss_correlated_noise", 2876.0, tau=974.0),
    )
    said = filtered_said(report(level, colour))
    assert "from a filter in the receiver" in said and "north, east, down 0.006" in said and "974 s" in said
    page = render_gap(report(level, colour), tmp_path).read_text(encoding="utf-8")
    assert page.index("from a filter in the receiver") < page.rindex("1. GNSS position noise level")
    follows = replace(colour, parameters=(*colour.parameters, Value("follows", 1.0, 1.0, 1.0, "1")))
    assert "974 s, going with what it states." in filtered_said(report(level, follows))
    assert "going with what the receiver states: sigma 0.3, tau 974" in finding_action(follows)
    assert "states" not in finding_action(colour)
    assert not filtered_said(report(colour)) and not filtered_said(report(level))
    assert not filtered_said(report(strong("gnss_noise_level", 700.0, factor=0.38), colour))


def test_members_of_a_class_in_several_places_are_told_with_their_axes(tmp_path: Path) -> None:
    x, z, bias = (
        Member(e, "gyro", (a,), 50.0) for e, a in (("misalignment", "x"), ("misalignment", "z"), ("ramp", "x"))
    )
    found = replace(strong("ramp", 50.0), effect="misalignment", sensor="gyro", axes=("x",), members=(x, z))
    said = gap_headline(replace(report(found), verdict="class"))
    assert "of the gyroscope x or" in said and "of the gyroscope z: this recording cannot distinguish them" in said
    page = render_gap(replace(report(found), verdict="class"), tmp_path).read_text(encoding="utf-8")
    assert page.count("of the gyroscope x / ") == 1
    one_place = gap_headline(replace(report(replace(found, members=(x, bias))), verdict="class"))
    assert one_place.startswith("The gyroscope x has misalignment") and "gyroscope z" not in one_place


def test_a_step_at_another_time_is_another_step() -> None:
    first = report(strong("gnss_multipath_step", 200.0))
    later, _ = passes(first, report(strong("gnss_multipath_step", 40.0, start=20.0)), report())
    assert [v.value for s in later.findings for v in s.parameters if v.name != "duration"] == [2.0, 10.0, 2.0, 20.0]
    same, _ = passes(first, report(strong("gnss_multipath_step", 40.0, start=10.4, value=-0.7)), report())
    ((value, start, _),) = (s.parameters for s in same.findings)
    assert (value.value, start.value) == pytest.approx((1.3, 10.0))


def test_a_static_loop_closes_with_effects_that_no_noise_model_holds() -> None:
    rng = np.random.default_rng(5)
    n, rate = 14_000, 20.0
    t = np.arange(n) / rate
    temperature = 25.0 + 10.0 * np.sin(2 * np.pi * t / 700.0)
    x = WN(1e-3).simulate(n, 1 / rate, rng) + 2e-4 * (temperature - 25.0)
    z = WN(1e-3).simulate(n, 1 / rate, rng) + 1e-3 * np.sin(2 * np.pi * 3.3 * t + 0.3)
    z += np.where(rng.random(n) < 0.002, 0.08 * rng.standard_normal(n), 0.0)
    log = StaticLog(tuple(Series(v, rate, "rad/s", f"gyro_{a}") for v, a in ((x, "x"), (z, "z"))), temperature, "log")
    from insemu.gap import Nominal

    nominal = Nominal({"gyro_x": NoiseModel((WN(1e-3),)), "gyro_z": NoiseModel((WN(1e-3),))})
    first = find_gap(log, nominal, rng=np.random.default_rng(1), hold_out=False)
    assert {s.effect for s in first.findings} == {"temperature", "vibration_line", "outliers"}
    second = find_gap(log, refined_nominal(nominal, first, 1 / rate), rng=np.random.default_rng(1), hold_out=False)
    assert second.verdict == "nothing missing", [(s.effect, s.axes, s.nats) for s in second.findings]


def test_lines_and_ramps_of_a_noise_model_are_known_effects() -> None:
    from insemu.gap import Nominal

    nominal = Nominal({"gyro_x": NoiseModel((WN(1e-3), SIN(2e-3, 3.0), DR(1e-6)))}).parted()
    assert nominal.beliefs["gyro_x"] == NoiseModel((WN(1e-3),))
    assert {u.id: next(iter(u.values.values())) for u in nominal.effects} == {
        "vibration_line": (2e-3, 0.0, 0.0),
        "ramp": (1e-6, 0.0, 0.0),
    }


def test_a_recording_whose_fixes_never_move_is_a_static_log(tmp_path: Path) -> None:
    from insemu.formats import write

    raw = yaml.safe_load(NOMINAL)
    for name, builtin in (("rest", "static"), ("drive", "lemniscate")):
        raw["trajectory"] = {"builtin": builtin, "rate": "20 Hz", "duration": "60 s"}
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(raw))
        write(tmp_path / f"{name}.npz", EmulatedWorld(load(path)).recording(0))
    assert isinstance(load_measured(tmp_path / "rest.npz"), StaticLog)
    assert isinstance(load_measured(tmp_path / "drive.npz"), Recording)


def standing(duration: float, rate: float = 50.0) -> Recording:
    """An IMU at rest under a receiver that states no noise and wanders by metres."""
    rng = np.random.default_rng(8)
    n = int(duration * rate)
    imu = ImuRecord(
        np.arange(n) / rate + 3e5,
        2e-3 * rng.standard_normal((n, 3)),
        [0.1, 0.2, -9.8] + 2e-2 * rng.standard_normal((n, 3)),
        "sample",
    )
    t = np.arange(0.4, duration, 1.0)
    wander = np.cumsum(0.3 * rng.standard_normal((t.size, 3)), axis=0) + rng.standard_normal((t.size, 3))
    llh = np.array([0.8, 0.2, 400.0]) + wander * [1.6e-7, 2.3e-7, 1.0]
    return Recording(imu, GnssRecord(t + 3e5, llh), None)


def test_fixes_that_wander_do_not_move_an_imu_that_rests(tmp_path: Path) -> None:
    from insemu.formats import write

    still = standing(120.0)
    write(tmp_path / "still.npz", still)
    assert isinstance(load_measured(tmp_path / "still.npz"), StaticLog)
    turning = replace(still.imu, gyro=still.imu.gyro + 0.3 * np.sin(0.2 * (still.imu.t - 3e5))[:, None])
    write(tmp_path / "turning.npz", replace(still, imu=turning))
    assert isinstance(load_measured(tmp_path / "turning.npz"), Recording)


def test_a_clock_that_began_long_ago_is_told_from_the_first_sample() -> None:
    r = standing(30.0)
    moved = from_its_start(r)
    assert isinstance(moved, Recording)
    assert moved.gnss is not None
    assert r.gnss is not None
    assert moved.imu.t[0] == r.imu.t[0] % 1.0 and moved.origin.ns == int(r.imu.t[0]) * 10**9
    np.testing.assert_allclose(moved.gnss.t - moved.imu.t[0], r.gnss.t - r.imu.t[0], atol=1e-6)
    assert from_its_start(moved) is moved


def test_samples_that_a_static_log_lost_are_filled_without_colour(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    n, dt = 100_000, 0.01
    smooth = lfilter(*butter(2, 0.5), rng.standard_normal(n))
    data = np.column_stack([rng.standard_normal(n), smooth, np.cumsum(1e-2 * rng.standard_normal(n)) + smooth])
    keep = rng.random(n) > 0.02
    keep[[0, -1]] = True
    np.savez(
        tmp_path / "log.npz",
        data=data[keep],
        t=np.arange(n)[keep] * dt + 5e4,
        columns=["gx", "gy", "gz"],
        units=["rad/s"] * 3,
        temperature=np.arange(n)[keep] * 1e-3,
    )
    log = load_measured(tmp_path / "log.npz")
    assert isinstance(log, StaticLog)
    assert log.missing is not None
    assert log.temperature is not None
    np.testing.assert_array_equal(log.missing, ~keep)
    np.testing.assert_allclose(log.temperature, np.arange(n) * 1e-3, atol=1e-9)
    for k, axis in enumerate(log.axes):
        values = np.asarray(axis.values)
        np.testing.assert_array_equal(values[keep], data[keep, k])
        lag = [np.mean(v[1:] * v[:-1]) for v in (np.diff(values), np.diff(data[:, k]))]
        assert lag[0] == pytest.approx(lag[1], abs=4e-3)  # the mean of two neighbours is off by ten times that
    np.savez(
        tmp_path / "holes.npz", data=data[::3][: n // 4], t=np.sort(rng.choice(n, n // 4, replace=False)) * dt, fs=100.0
    )
    with pytest.raises(InputError, match=r"time column steps by|stamps skip"):
        load_measured(tmp_path / "holes.npz")


def test_a_step_that_the_table_does_not_have_is_left_to_its_owner() -> None:
    assert uses_of(Finding("my_effect", "", "gyro", ("x",), (), 1.0, 9.0, ())) == ()


def test_the_example_of_an_own_candidate_runs() -> None:
    before = dict(CANDIDATES)
    try:
        example = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "own_candidate.py"))["example"]
        assert example().startswith("thermostat: sigma 1.0")
    finally:
        CANDIDATES.clear()
        CANDIDATES.update(before)


def test_a_band_and_a_line_of_the_noise_model_are_white_noise_to_a_filter() -> None:
    from insemu.gap.beliefs.refined import filter_noise

    nominal = load_nominal(_scenario())
    band = AR((0.5, -0.8), sigma2=1e-4, rate_hz=20.0)
    model = nominal.beliefs["gyro_x"] + band + SIN(1e-3, 3.0)
    out = filter_noise(nominal, report(refined={"gyro_x": model}), 0.05)["gyro_x"]
    expected = np.sqrt(1e-8 + float(band.psd(np.zeros(1), 0.05)[0]))
    assert [p.parameters["N"] for p in out] == [pytest.approx(expected)]
    assert (
        QN(1e-5)
        in filter_noise(nominal, report(refined={"gyro_x": nominal.beliefs["gyro_x"] + QN(1e-5)}), 0.05)[
            "gyro_x"
        ].processes
    )


def test_a_refined_model_that_does_worse_on_held_out_data_is_called_so() -> None:
    step = Finding("ramp", "", "gyro", ("x",), (), 0.9, 30.0, (Member("ramp", "gyro", ("x",), 30.0),))
    index = Interval(1.2, 1.1, 1.3)

    def left(after: Interval, gain: Interval) -> str:
        return with_held_out(GapReport("named", (step,), (), (), index, after, gain, remainder="a line")).remainder

    assert left(Interval(1.05, 0.95, 1.15), Interval(0.5, 0.4, 0.6)) == "a line"
    assert "worse by the refined model (-0.5 nats" in left(Interval(1.05, 0.95, 1.15), Interval(-0.5, -0.6, -0.4))
    assert "moved away from 1 (1.20 to 1.50)" in left(Interval(1.5, 1.4, 1.6), Interval(0.5, 0.4, 0.6))
    assert "moved away from 1 (1.20 to 0.50)" in left(Interval(0.5, 0.4, 0.6), Interval(0.5, 0.4, 0.6))
    assert left(Interval(0.9, 0.85, 0.95), Interval(0.5, 0.4, 0.6)) == "a line"


def test_of_a_recorded_drive_the_first_design_in_numbers_is_the_nominal_model(tmp_path: Path) -> None:
    path = tmp_path / "drive.yaml"
    plain = "{gyro: WN(N=1e-4 rad/s/sqrt(Hz)), accel: WN(N=1e-3 m/s^2/sqrt(Hz))}"
    text = (
        "title: drive\nseed: 1\nrecording: {file: drive.npz}\nfits: {recorded: {files: [log.npz]}}\n"
        "designs:\n  fitted: {gyro: {fit: WN()}, accel: {fit: WN()}}\n"
    )
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="expected one in numbers"):
        load_nominal(path)
    path.write_text(text + f"  numbers: {plain}\n", encoding="utf-8")
    assert load_nominal(path).beliefs["accel_z"] == NoiseModel((WN(1e-3),))
    # written by a gap before, it is what is held against the recording again
    louder = plain.replace("1e-3", "2e-3").replace(
        "}", ", options: {compensate: [{effect: lever_arm, value: [0.3 m, 0 m, 0 m]}]}}", 1
    )
    path.write_text(text + f"  numbers: {plain}\n  refined: {louder}\n", encoding="utf-8")
    again = load_nominal(path)
    assert again.beliefs["accel_z"] == NoiseModel((WN(2e-3),)) and [u.id for u in again.effects] == ["lever_arm"]


@pytest.mark.parametrize("effect", [e for e in FOUND if e != "gnss_correlated_noise"])
def test_a_refined_scenario_of_a_recording_knows_what_was_found(effect: str, tmp_path: Path) -> None:
    path, model = tmp_path / "drive.yaml", "{gyro: WN(N=1e-4 rad/s/sqrt(Hz)), accel: WN(N=1e-3 m/s^2/sqrt(Hz))}"
    path.write_text(f"title: drive\nrecording: drive.npz\ndesigns: {{plain: {model}}}\n", encoding="utf-8")
    out = write_refined(load_nominal(path), report(step(effect)), tmp_path / "refined.yaml", measured())
    again = load_nominal(out)
    assert [u.id for u in again.effects if u.id == effect]
    assert again.filled == ((effect,) if effect in ("dropped_samples", "saturation") else ())
    options = load(out).designs["refined"].options
    if effect in ("gnss_outliers", "gnss_velocity_outliers"):
        # of a share of 0.05 three in a row are more likely than 1e-4, four are not: the fourth that follows them is taken
        interval = float(np.median(np.diff(measured().gnss.t)))
        assert options.gate == 1e-4 and options.gate_timeout == pytest.approx(3.5 * interval)
    elif effect == "aid_outliers":  # of a share of 0.02 two in a row are more likely than 1e-4
        assert options.gate == 1e-4
    else:
        assert options.gate is None


def test_a_filter_without_states_for_slow_errors_of_the_fixes_believes_all_of_them(tmp_path: Path) -> None:
    """Beside a level far below what is stated it believed that level, raised by what the slow errors are to what is stated: a tenth of them."""
    path, model = tmp_path / "drive.yaml", "{gyro: WN(N=1e-4 rad/s/sqrt(Hz)), accel: WN(N=1e-3 m/s^2/sqrt(Hz))}"
    path.write_text(f"title: drive\nrecording: drive.npz\ndesigns: {{plain: {model}}}\n", encoding="utf-8")
    level = replace(strong("gnss_noise_level", 900.0, factor=0.01), axes=("north", "east", "down"))
    found = report(level, step("gnss_correlated_noise"))
    out = write_refined(load_nominal(path), found, tmp_path / "refined.yaml", measured())
    (sigma,) = {tuple(row) for row in measured().gnss.pos_std_ned.tolist()}
    factors = [use["factor"] for use in load(out).designs["refined"].options.compensate if use.id == "gnss_noise_level"]
    believed = np.array(sigma) * np.prod(factors, axis=0)
    np.testing.assert_allclose(believed, np.hypot(0.01 * np.array(sigma), [0.3, 0.0, 0.0]), rtol=1e-6)


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_drift_counts_from_the_first_stamp_also_where_the_filter_starts_later() -> None:
    """Fixes from the 60th second on: clocks that agree there instead of at the first stamp leave 12 ms once the drift is taken off."""
    drive = stage(61, 4.0, 50.0, track="car")
    whole = drive.record((EffectUse.from_mapping({"effect": "clock_drift", "drift": 2e-4}),))
    assert whole.gnss is not None
    late = replace(whole, gnss=whole.gnss.rows(whole.gnss.t > 60.0), reference=None)
    first = find_gap(late, drive.nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert [f.effect for f in first.findings] == ["clock_drift"]
    known = refined_nominal(drive.nominal, first, late.imu.dt)
    again = find_gap(late, known, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_a_member_that_a_later_pass_weighs_far_more_leaves_a_name_without_confidence() -> None:
    """800 nats more: the exponential had been beyond the numbers of a computer."""
    own, rival = Member("clock_drift", "imu", (), 100.0), Member("lever_arm", "gnss", ("x",), 900.0)
    named = replace(strong("clock_drift", 100.0), confidence=0.0)
    assert _confirmed(replace(named, members=(own, rival))).confidence == pytest.approx(0.0, abs=1e-12)
    equal = replace(named, members=(own, replace(rival, nats=100.0)))
    assert _confirmed(equal).confidence == pytest.approx(0.5, rel=1e-6)
