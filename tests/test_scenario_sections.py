"""Sections of a scenario by hand: what each default means, each limit and its neighbour, and what is said of what does not go together."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from insemu import yamlfile
from insemu.errors import InputError
from insemu.filters import Standstill
from insemu.noise import NoiseModel
from insemu.records import AXES
from insemu.scenario import Design, Scenario, digest, load, schema, state_names, structures, validated, with_changes
from insemu.scenario.fields import Section, number
from insemu.scenario.files import code_version
from insemu.scenario.sensor_keys import files_from, with_sensors
from insemu.scenario.starting import Wish, first_scenario

DEG = np.pi / 180.0
BASE: dict[str, Any] = {
    "title": "t",
    "trajectory": {"builtin": "helicopter_mapping"},
    "truth": {"gyro": "WN(N=1 deg/h/sqrt(Hz))", "accel": "WN(N=2 ug/sqrt(Hz))"},
    "designs": {"a": {"gyro": {"truth": True}, "accel": "WN(N=3)"}},
}


def put(changes: dict[str, Any]) -> dict[str, Any]:
    """The base with values at dotted keys; an Ellipsis takes a key away."""
    data = copy.deepcopy(BASE)
    for key, value in changes.items():
        *way, last = key.split(".")
        at: Any = data
        for part in way:
            at = at.setdefault(part, {}) if isinstance(at, dict) else at[int(part)]
        if value is ...:
            at.pop(last, None)
        else:
            at[last] = value
    return data


def read(changes: dict[str, Any]) -> Scenario:
    return validated(Scenario, yamlfile.Document("s", put(changes), {}))


def test_what_is_not_said_has_its_default() -> None:
    s = read({})
    t, g, i = s.trajectory, s.gnss, s.initial
    assert t is not None and s.truth is not None
    assert (s.seed, s.realizations, s.smoother, s.smoke, s.filter) == (
        1,
        24,
        False,
        ("run", "--realizations", "2"),
        None,
    )
    assert (s.question, s.notes, s.aids, s.variants, s.published, s.recording, s.fits) == (
        "",
        "",
        (),
        {},
        None,
        None,
        None,
    )
    assert (t.rate, t.kind, t.mode, t.gravity, t.vehicle, t.max_gap, t.duration) == (
        100.0, "increment", "exact", "normal", "car", 10.0, None,
    )  # fmt: skip
    assert (g.rate, g.position_sigma, g.velocity_sigma, g.lever_arm) == (1.0, (0.02,) * 3, (0.02,) * 3, (0.0,) * 3)
    assert (g.outages, g.areas, g.random_outages) == ((), (), None)
    np.testing.assert_allclose(np.array([i.tilt_sigma, i.heading_sigma]), np.array([0.5, 1.0]) * DEG, rtol=1e-5)
    assert (i.position_sigma, i.velocity_sigma) == ((0.1,) * 3, (0.05,) * 3)
    np.testing.assert_allclose(i.sigma.attitude, [i.tilt_sigma, i.tilt_sigma, i.heading_sigma])
    assert (i.sigma.position, i.sigma.velocity) == ((0.1,) * 3, (0.05,) * 3)
    o = s.designs["a"].options
    assert (o.covariance_every, o.gate, o.prefilter, o.zero_updates, o.compensate) == (1, None, None, None, ())
    assert (o.tuning.gyro, o.tuning.accel, o.tuning.position, o.tuning.velocity) == (1.0, 1.0, 1.0, 1.0)
    assert o.states.reference_temperature == 25.0
    assert all(
        getattr(o.states, k) == 0.0
        for k in ("gyro_scale", "accel_scale", "gyro_misalignment", "accel_misalignment", "lever_arm", "latency")
    )
    assert set(s.truth.models()) == set(AXES)


def test_quantities_become_si() -> None:
    s = read(
        {
            "trajectory.rate": "0.2 kHz", "trajectory.duration": "2 min", "trajectory.mounting": {"lever_arm": "10 cm", "rpy": ["90 deg", 0, 1]},
            "gnss.outages": [{"start": "1 min", "duration": 2}],
            "gnss.areas": [{"latitude": "45 deg", "longitude": "7 deg", "radius": "1 km"}],
            "gnss.velocity_sigma": None, "gnss.random_outages": {"per_hour": 3, "mean": "1 min"},
            "truth.temperature": {"t": [0, "1 min"], "degc": [20, 30]}, "truth.record": "1 h",
            "designs.a.options": {
                "states": {"gyro_scale": "300 ppm", "gyro_scale_temperature": "50 ppm/K", "latency": "5 ms", "gyro_misalignment": "1 deg"},
                "zero_updates": {}, "prefilter": {"levels": {"gyro_x": 7, "accel_z": 2}}, "gate": 1e-3,
            },
        }
    )  # fmt: skip
    t, g, truth = s.trajectory, s.gnss, s.truth
    assert t is not None and t.mounting is not None and truth is not None and truth.temperature is not None
    assert (t.rate, t.duration, t.mounting.lever_arm) == (200.0, 120.0, (0.1,) * 3)
    np.testing.assert_allclose(t.mounting.rpy, [np.pi / 2, 0, 1])
    assert (g.outages[0].start_s, g.outages[0].duration_s, g.velocity_sigma) == (60.0, 2.0, None)
    np.testing.assert_allclose(
        [g.areas[0].latitude, g.areas[0].longitude, g.areas[0].radius], [45 * DEG, 7 * DEG, 1000]
    )
    assert g.random_outages is not None
    assert (g.random_outages.per_hour, g.random_outages.mean, g.random_outages.clear) == (3.0, 60.0, 60.0)
    assert (tuple(truth.temperature.t), tuple(truth.temperature.degc), truth.record) == (
        (0.0, 60.0),
        (20.0, 30.0),
        3600.0,
    )
    o = s.designs["a"].options
    np.testing.assert_allclose(
        [o.states.gyro_scale, o.states.gyro_scale_temperature, o.states.latency, o.states.gyro_misalignment],
        [3e-4, 5e-5, 5e-3, DEG],
    )
    assert o.prefilter is not None and o.zero_updates is not None
    assert o.prefilter.per_axis() == [7, 0, 0, 0, 0, 2]
    assert (o.prefilter.wavelet, o.prefilter.rule, o.prefilter.mode, o.prefilter.delay) == ("db4", "sure", "soft", None)
    assert o.zero_updates.at([(1.0, 2.0)]) == Standstill([(1.0, 2.0)], 1.0, 0.01, 1e-4)
    rated = (
        read({"designs.a.options": {"zero_updates": {"velocity_sigma": None}, "prefilter": {"levels": 3}}})
        .designs["a"]
        .options
    )
    assert rated.zero_updates is not None and rated.prefilter is not None
    assert rated.zero_updates.at([]) == Standstill([], 1.0, np.inf, 1e-4)
    assert rated.prefilter.per_axis() == [3] * 6


#: Key, a value that is just inside, one that is just outside, what is said of it.
LIMITS: list[tuple[str, Any, Any, str]] = [
    ("seed", 0, -1, "seed: found -1, input should be greater than or equal to 0"),
    ("realizations", 1, 0, "realizations: found 0, input should be greater than or equal to 1"),
    ("realizations", 100_000, 100_001, "realizations: found 100001, input should be less than or equal to 100000"),
    ("trajectory.rate", "20 kHz", 20_001, "trajectory.rate: found 20001.0, input should be less than or equal to 20000"),
    ("trajectory.rate", 1e-9, 0, "trajectory.rate: found 0.0, input should be greater than 0"),
    ("trajectory.duration", "720 h", "2592001 s", "trajectory.duration: found 2592001.0, input should be less than or equal to 2592000"),
    ("trajectory.duration", 1e-9, "0 s", "trajectory.duration: found 0.0, input should be greater than 0"),
    ("trajectory.speed", 1e-9, 0, "trajectory.speed: found 0.0, input should be greater than 0"),
    ("trajectory.max_gap", 1e-9, 0, "trajectory.max_gap: found 0.0, input should be greater than 0"),
    ("truth.record", "720 h", "2592001 s", "truth.record: found 2592001.0, input should be less than or equal to 2592000"),
    ("truth.record", 1e-9, 0, "truth.record: found 0.0, input should be greater than 0"),
    ("fits.simulate", "720 h", "2592001 s", "fits.simulate: found 2592001.0, input should be less than or equal to 2592000"),
    ("fits.simulate", 1e-9, 0, "fits.simulate: found 0.0, input should be greater than 0"),
    ("gnss.rate", 1e-9, 0, "gnss.rate: found 0.0, input should be greater than 0"),
    ("gnss.position_sigma", [1, 1e-9, 1], [1, 0, 1], "gnss.position_sigma: found 0.0, expected positive standard deviations"),
    ("gnss.velocity_sigma", 1e-9, "-1 m/s", "gnss.velocity_sigma: found -1.0, expected positive standard deviations"),
    ("gnss.random_outages", {"per_hour": 0, "mean": 1, "clear": 0}, {"per_hour": -1, "mean": 1},
     "gnss.random_outages.per_hour: found -1, input should be greater than or equal to 0"),
    ("gnss.random_outages", {"per_hour": 0, "mean": 1e-9}, {"per_hour": 0, "mean": 0},
     "gnss.random_outages.mean: found 0.0, input should be greater than 0"),
    ("gnss.outages", [{"start": 0, "duration": "1 us"}], [{"start": -1, "duration": 1}],
     "gnss.outages.0.start: found -1.0, input should be greater than or equal to 0"),
    ("gnss.areas", [{"latitude": "90 deg", "longitude": 0, "radius": 0}], [{"latitude": "91 deg", "longitude": 0, "radius": 0}],
     f"gnss.areas.0.latitude: found {91 * np.pi / 180!r}, input should be less than or equal to 1.5707963267948966"),
    ("initial.tilt_sigma", 0, -1, "initial.tilt_sigma: found -1.0, input should be greater than or equal to 0"),
    ("initial.heading_sigma", 0, -1, "initial.heading_sigma: found -1.0, input should be greater than or equal to 0"),
    ("designs.a.options.covariance_every", 1, 0, "designs.a.options.covariance_every: found 0, input should be greater than or equal to 1"),
    ("designs.a.options.gate", 0.999, 1, "designs.a.options.gate: found 1, input should be less than 1"),
    ("designs.a.options.gate", 1e-9, 0, "designs.a.options.gate: found 0, input should be greater than 0"),
    ("designs.a.options.tuning.gyro", 1e-9, 0, "designs.a.options.tuning.gyro: found 0, input should be greater than 0"),
    ("designs.a.options.tuning.accel", 1e-9, 0, "designs.a.options.tuning.accel: found 0, input should be greater than 0"),
    ("designs.a.options.tuning.position", 1e-9, 0, "designs.a.options.tuning.position: found 0, input should be greater than 0"),
    ("designs.a.options.tuning.velocity", 1e-9, 0, "designs.a.options.tuning.velocity: found 0, input should be greater than 0"),
    ("designs.a.options.prefilter", {"levels": 20}, {"levels": 21}, "designs.a.options.prefilter.levels: found 21 levels, expected 0 to 20"),
    ("designs.a.options.prefilter", {"levels": 0}, {"levels": -1}, "designs.a.options.prefilter.levels: found -1 levels, expected 0 to 20"),
    ("designs.a.options.prefilter", {"levels": {"gyro_x": 20}}, {"levels": {"gyro_w": 2}},
     "designs.a.options.prefilter.levels: unknown axis 'gyro_w' (did you mean 'gyro_z'?)"),
    ("designs.a.options.prefilter", {"levels": 2, "rule": "approximation", "delay": 0}, {"levels": 2, "delay": 0},
     "designs.a.options.prefilter: delay belongs to rule 'approximation', found rule 'sure'"),
    ("designs.a.options.zero_updates", {"every": 1e-9}, {"every": 0},
     "designs.a.options.zero_updates.every: found 0.0, input should be greater than 0"),
    ("designs.a.options.states.lever_arm", 1e6, "1001 km",
     "designs.a.options.states.lever_arm: found 1001000.0, input should be less than or equal to 1000000"),
    ("designs.a.options.states.latency", 0, -1, "designs.a.options.states.latency: found -1.0, input should be greater than or equal to 0"),
    ("designs.a.accel", {"model": "AR1(phi=0.5, sigma2=1)", "stabilise": 0.99}, {"model": "AR1(phi=0.5, sigma2=1)", "stabilise": 1.5},
     "designs.a.accel.stabilise"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "inside", "outside", "said"), LIMITS)
def test_limits(key: str, inside: Any, outside: Any, said: str) -> None:
    read({key: inside})
    with pytest.raises(InputError) as caught:
        read({key: outside})
    place, _, rest = said.partition(": found ")  # what was found is shown as written where that is optional
    assert str(caught.value).startswith(f"s: {place}")
    assert str(caught.value).endswith(rest.partition(", ")[2])


RECORDED = {"files": ["a.npz"]}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"trajectory": ...}, "s: the key 'trajectory' is missing; expected a trajectory and a truth, or a recording"),
        ({"truth": ...}, "s: the key 'truth' is missing; expected a trajectory and a truth, or a recording"),
        ({"truth": ..., "trajectory": ...}, "s: the key 'trajectory' and 'truth' is missing; expected a trajectory and a truth, or a recording"),
        ({"recording": "a.npz"}, "s: found a recording together with a trajectory or a truth, expected one or the other"),
        ({"recording": "a.npz", "truth": ...}, "s: found a recording together with a trajectory or a truth, expected one or the other"),
        ({"recording": "a.npz", "truth": ..., "trajectory": ..., "designs": {}, "aids": {"odometer": {"rate": "1 Hz", "sigma": [0.1, 0.1, 0.1]}}},
         "s: found aids together with a recording, which brings its own (keys aid_NAME)"),
        ({"recording": "a.npz", "truth": ..., "trajectory": ...},
         "s: the design 'a' asks for the model of the truth, but the truth is a recorded signal"),
        ({"designs.a.gyro": {"fit": "WN()"}},
         "s: the design 'a' is fitted, but there is no section 'fits' that says to which signals (for example fits: {simulate: 4 h})"),
        ({"truth": {"recorded": RECORDED}, "designs.a.gyro": "WN(N=1)", "fits": {"simulate": 60}},
         "s: fits cannot be simulated from a recorded truth; expected the key 'recorded' under 'fits'"),
        ({"truth": {"recorded": RECORDED}}, "s: the design 'a' asks for the model of the truth, but the truth is a recorded signal"),
        ({"truth.recorded": RECORDED}, "s: truth: found both models and recorded signals, expected one of them"),
        ({"truth": {"recorded": RECORDED, "file": "m.yaml"}}, "s: truth: found both models and recorded signals, expected one of them"),
        ({"truth.spread": True}, "s: truth: found spread without the key 'file'; expected a noise-model file fitted to several runs"),
        ({"truth": {"gyro": "WN(N=1)", "accel_y": "WN(N=1)"}},
         "s: truth: no error model for accel_x, accel_z; expected gyro and accel (or each axis), a file, or recorded"),
        ({"truth.case": "worst"}, "s: truth: found 'case' without the key 'sensor' whose case it is"),
        ({"fits": {"simulate": 60, "recorded": RECORDED}}, "s: fits: expected exactly one of the keys 'simulate' and 'recorded'"),
        ({"trajectory.track": "x.csv"},
         "s: trajectory: one source of motion is needed: the key 'builtin', 'waypoints', 'track' or 'motion'; found 'builtin' and 'track'"),
        ({"trajectory.kind": "sample"},
         "s: trajectory: samples exist only on a continuous path; expected 'mode: continuous' together with 'kind: sample'"),
        ({"trajectory.builtin": "helicopter_maping"},
         "s: trajectory.builtin: unknown trajectory 'helicopter_maping' (did you mean 'helicopter_mapping'?)"),
        ({"published": {"source": "x"}},
         "s: published: no figure is given, expected at least one of the keys planimetric_end_m, planimetric_mean_m, planimetric_max_m, north_max_m, "
         "east_max_m, down_max_m"),
        ({"published": {"source": "x", "planimetric_end_m": {"b": [1, None]}}}, "s: published figures for 'b', which is no design here"),
        ({"designs.a.settings": {"x": 1}}, "s: designs.a: found settings without the key 'filter' whose keyword arguments they are"),
        ({"designs.a.accel": ...}, "s: designs.a: no belief for accel_x, accel_y, accel_z; expected gyro and accel, or each axis"),
        ({"designs.a.gyro": {"truth": True, "file": "x"}},
         "s: designs.a.gyro: expected exactly one of the keys 'fit', 'model', 'file' and 'truth: true'"),
        ({"designs.a.gyro": {"method": "em"}}, "s: designs.a.gyro: expected exactly one of the keys 'fit', 'model', 'file' and 'truth: true'"),
        ({"designs.a.gyro": {"fit": "WN()", "plus": "RC()"}},
         "s: designs.a.gyro.plus: the model 'RC()' has parameters without a value; to fit it write {fit: 'RC()'}"),
        ({"designs.a.options.compensate": [{"effect": "white_noise", "sensor": "gyro", "N": 1}]}, "s: designs.a.options.compensate: "),
        ({"designs.a.gyro": 3}, "s: designs.a.gyro: found 3, expected a list of mappings with the key 'process'"),
        ({"designs.a.gyro": [{"process": "WN", "N": 1}] * 65}, "s: designs.a.gyro: found 65 mappings with the key 'process', expected at most 64"),
        ({"designs.a.gyro": [{"process": "WN", "N": {"a": 1}}]}, "s: designs.a.gyro: found "),
        ({"designs.a.gyro": [{"N": 1}]}, "s: designs.a.gyro: found "),
        ({"designs.a.design": 3}, "s: designs.a: found 3, expected the name of a design"),
        ({"designs.a": "nine"}, "s: designs.a: no design 'nine' comes with insemu"),
        ({"designs": {"x" * 81: BASE["designs"]["a"]}}, "s: designs."),
        ({"designs": {"x.": BASE["designs"]["a"]}}, "s: designs."),
        ({"aids": {"odo": {}}}, "s: aids: no aid 'odo' to emulate (did you mean 'odometer'?)"),
        ({"aids": ["odometer"]}, "s: aids: found ['odometer'], expected the name of an aid with its rate and sigma: "),
        ({"truth.effects": 3}, "s: truth.effects: found 3, expected a list of mappings with the key 'effect'"),
        ({"gnss.lever_arm": [1, 2]}, "s: gnss.lever_arm: found 2 values, expected one or three"),
        ({"gnss.lever_arm": True}, "s: gnss.lever_arm: found True, expected a quantity such as '1 m'"),
        ({"gnss.lever_arm": float("inf")}, "s: gnss.lever_arm"),
        ({"gnss.rat": 1}, "s: gnss.rat: unknown key 'rat' (did you mean 'rate'?)"),
        ({"gnss.outages": [{"start": 1, "dur": 2}]}, "s: gnss.outages.0.dur: unknown key 'dur' (did you mean 'duration'?)"),
        ({"gnss.outages": [{"start": 1}]}, "s: gnss.outages.0: the key 'duration' is missing"),
        ({"designs.a.options.states": {"gyro_scal": 1}},
         "s: designs.a.options.states.gyro_scal: unknown key 'gyro_scal' (did you mean 'gyro_scale'?)"),
        ({"title": ...}, "s: the key 'title' is missing"),
        ({"truth": {"recorded": {"files": []}}, "designs": {}}, "s: truth.recorded.files: found [], "),
        ({"truth": {"recorded": RECORDED | {"remove_mean": "all"}}, "designs": {}},
         "s: truth.recorded.remove_mean: found 'all', expected one of: record, piece, none; or a span [from, to]"),
        ({"truth": {"recorded": RECORDED | {"remove_mean": [1, 2, 3]}}, "designs": {}},
         "s: truth.recorded.remove_mean: found [1, 2, 3], expected one of: record, piece, none; or a span [from, to]"),
        ({"truth": {"recorded": RECORDED | {"skip": -1}}, "designs": {}},
         "s: truth.recorded.skip: found -1.0, input should be greater than or equal to 0"),
        ({"truth.temperature": {"t": [], "degc": []}}, "s: truth.temperature.t: found [], "),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_said(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(changes)
    found = str(caught.value)
    assert found.startswith(said) if said.endswith((": ", " ", ".", "insemu", "lever_arm")) else found == said


def test_what_does_go_together_is_read() -> None:
    read({"trajectory.kind": "sample", "trajectory.mode": "continuous"})
    read({"truth": {"recorded": RECORDED}, "designs": {}, "fits": {"recorded": RECORDED}})
    read({"published": {"source": "x", "planimetric_end_m": {"a": [1, None]}, "down_max_m": {"a": [2]}}})
    s = read(
        {"truth": {"recorded": RECORDED | {"remove_mean": ["1 min", "2 min"], "spans": [["1 min", 90]]}}, "designs": {}}
    )
    assert s.truth is not None and s.truth.recorded is not None
    assert (s.truth.recorded.remove_mean, s.truth.recorded.spans) == ((60.0, 120.0), ((60.0, 90.0),))
    p = read({"published": {"source": "x", "down_max_m": {"a": [2]}, "planimetric_end_m": {"a": [1, None]}}}).published
    assert p is not None and p.figures == {"planimetric_end_m": {"a": (1.0, None)}, "down_max_m": {"a": (2.0,)}}
    assert list(p.figures) == ["planimetric_end_m", "down_max_m"]
    r = read({"recording": "a.npz", "truth": ..., "trajectory": ..., "designs": {}}).recording
    assert r is not None and (r.file, r.mounting, r.imu_time_offset, r.alignment) == ("a.npz", (0.0,) * 3, 0.0, "auto")
    assert (r.gravity, r.zero_velocity_updates, r.start, r.end, r.vehicle) == ("normal", False, None, None, None)
    wheels = read(
        {"recording": {"file": "a.npz", "vehicle": {}}, "truth": ..., "trajectory": ..., "designs": {}}
    ).recording
    assert wheels is not None and wheels.vehicle is not None and wheels.vehicle.sigma == 0.1
    np.testing.assert_allclose(wheels.vehicle.mounting_sigma, 5 * DEG, rtol=1e-6)


def test_sections_are_frozen_and_show_what_was_written() -> None:
    s = read(
        {
            "truth.gyro_x": [{"process": "WN", "N": "2 deg/h/sqrt(Hz)"}],
            "gnss.outages": [{"start": "1 min", "duration": 5}],
        }
    )
    with pytest.raises(ValidationError, match="frozen"):
        s.seed = 3  # type: ignore[misc]
    assert s.truth is not None
    with pytest.raises(ValidationError, match="frozen"):
        s.truth.gyro = None  # type: ignore[misc]
    shown = s.model_dump(mode="json")
    assert shown["truth"]["gyro_x"] == [{"process": "WN", "N": "2 deg/h/sqrt(Hz)"}]
    assert shown["truth"]["gyro"] == "WN(N=1 deg/h/sqrt(Hz))"
    assert shown["designs"]["a"]["accel"] == "WN(N=3)" and shown["designs"]["a"]["gyro"]["truth"] is True
    nothing = {"satellites": None, "elevation": None, "sectors": []}
    assert shown["gnss"]["outages"] == [{"start": 60.0, "duration": 5.0, **nothing}]
    assert json.loads(json.dumps(shown)) == shown
    # objects in place of what is written are shown as what they are
    made = Scenario.model_validate(
        put({"truth": {"gyro": NoiseModel.parse("WN(N=1)"), "accel": NoiseModel.parse("WN(N=2)")}})
    )
    assert made.model_dump()["truth"]["gyro"] == [{"process": "WN", "N": made.truth.gyro.to_list("rad/s")[0]["N"]}]  # type: ignore[union-attr]
    assert read({}) == read({}) != read({"seed": 2})
    assert read({"truth.gyro": "WN(N=60 deg/h/sqrt(Hz))"}) == read({"truth.gyro": "WN(N=1 deg/min/sqrt(Hz))"})
    assert read({}).truth != 3


def test_the_filter_of_the_scenario_is_that_of_designs_without_one() -> None:
    s = read(
        {"filter": "reference", "designs": {"a": BASE["designs"]["a"], "b": BASE["designs"]["a"] | {"filter": "own"}}}
    )
    assert {name: d.filter for name, d in s.designs.items()} == {"a": "reference", "b": "own"}
    # a filter of one's own may do without beliefs
    assert read({"designs": {"a": {"filter": "own", "settings": {"x": 1}}}}).designs["a"].sources() == {}


def test_digests_leave_out_what_changes_no_realization(tmp_path: Path) -> None:
    one = digest(read({}))
    assert len(one) == 16 and int(one, 16) >= 0
    same = {
        "realizations": 3,
        "title": "u",
        "question": "q",
        "notes": "n",
        "variants": {"v": {"seed": 3}},
        "smoke": ["run"],
    }
    for key, value in same.items():
        assert digest(read({key: value})) == one, key
    assert digest(read({"published": {"source": "x", "planimetric_end_m": {"a": [1]}}})) == one
    assert (
        len(
            {
                one,
                *(
                    digest(read(c))
                    for c in ({"seed": 2}, {"gnss.rate": 2}, {"smoother": True}, {"trajectory.rate": 50})
                ),
            }
        )
        == 5
    )
    file = tmp_path / "a"
    file.write_text("1")
    assert digest(read({}), {"a": file}) != one
    assert digest(read({}), {"a": tmp_path / "absent"}) == one
    assert len(code_version()) == 64


def test_numbers_and_their_units() -> None:
    assert (number("2 km", "m"), number(3, "m"), number("4", "m")) == (2000.0, 3.0, 4.0)
    for bad in (True, None, [1], {"a": 1}):
        with pytest.raises(InputError, match="expected a quantity such as '1 m'"):
            number(bad, "m")
    with pytest.raises(InputError, match="found an integer of 1329 bits, expected a finite number"):
        number(10**400, "m")


# ------------------------------------------------------------------------------------------------------------ changes and sensors


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"seed": 3}, {"seed": 3}),
        (
            {"gnss.rate": 2},
            {"gnss": {"outages": [{"start": 1, "duration": 2}, {"start": 5, "duration": 3}], "rate": 2}},
        ),
        (
            {"gnss.outages.1.start": 7},
            {"gnss": {"outages": [{"start": 1, "duration": 2}, {"start": 7, "duration": 3}]}},
        ),
        ({"gnss.outages.0": 4}, {"gnss": {"outages": [4, {"start": 5, "duration": 3}]}}),
        ({"outage": 9}, {"gnss": {"outages": [{"start": 1, "duration": 9}, {"start": 5, "duration": 9}]}}),
        ({"sensor": "X"}, {"truth": {"effects": [], "sensor": "X"}}),
        ({"trajectory": "urban_drive_1"}, {"trajectory": {"rate": 5, "builtin": "urban_drive_1"}}),
        ({"trajectory": "b.csv"}, {"trajectory": {"rate": 5, "track": "b.csv"}}),
        ({"trajectory": {"motion": "m.csv"}}, {"trajectory": {"rate": 5, "motion": "m.csv"}}),
        ({"a.b.c": 1}, {"a": {"b": {"c": 1}}}),
    ],
)
def test_keys_lead_to_places(changes: dict[str, Any], wanted: dict[str, Any]) -> None:
    data = {
        "seed": 1, "gnss": {"outages": [{"start": 1, "duration": 2}, {"start": 5, "duration": 3}]},
        "truth": {"gyro": "WN(N=1)", "accel_x": "WN(N=1)", "case": "worst", "file": "m", "effects": []},
        "trajectory": {"track": "a.csv", "rate": 5},
    }  # fmt: skip
    before = copy.deepcopy(data)
    assert with_changes(data, changes) == data | wanted
    assert data == before


@pytest.mark.parametrize(
    ("data", "changes", "said"),
    [
        ({}, {"outage": 3}, "outage: the scenario has no list of outages whose duration could be another"),
        (
            {"gnss": {"outages": [1]}},
            {"outage": 3},
            "outage: the scenario has no list of outages whose duration could be another",
        ),
        ({"a": [1, 2]}, {"a.2": 3}, "a.2: found '2', expected a number from 0 to 1"),
        ({"a": [1, 2]}, {"a.x": 3}, "a.x: found 'x', expected a number from 0 to 1"),
        ({"a": 1}, {"a.b": 3}, "a.b: 'b' leads into 1, which has no keys"),
        ({"trajectory": {"builtin": "x"}}, {"trajectory": "b.csv"}, "trajectory: unknown trajectory 'b.csv' "),
        ({}, {"trajectory": 3}, "trajectory: unknown trajectory '3' "),
    ],
)
def test_keys_that_lead_nowhere_are_refused(data: dict[str, Any], changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        with_changes(data, changes)
    assert str(caught.value).startswith(said)


def test_models_of_sensors_are_put_in() -> None:
    whole = with_sensors({"sensor": "ADIS16470", "gyro_y": "mine"})
    assert set(whole) == {*AXES} and whole["gyro_y"] == "mine"
    assert all(whole[axis][0]["process"] for axis in AXES if axis != "gyro_y")
    triad = with_sensors({"sensor": "ADIS16470", "gyro": "mine"})
    assert set(triad) == {"gyro", "accel_x", "accel_y", "accel_z"}
    one = with_sensors({"gyro": {"sensor": "ADIS16470"}, "accel": "mine"})
    assert set(one) == {"gyro_x", "gyro_y", "gyro_z", "accel"}
    worst = with_sensors({"gyro": {"sensor": "ADIS16470", "case": "worst"}})
    assert worst["gyro_x"] != one["gyro_x"] and one["gyro_x"] == whole["gyro_x"]
    assert with_sensors({"gyro_z": {"sensor": "ADIS16470"}}).keys() == {"gyro_z"}
    assert with_sensors({"gyro": {"fit": "WN()"}}) == {"gyro": {"fit": "WN()"}} and with_sensors("a") == "a"
    for bad, said in (
        ({"case": "worst"}, "found 'case' without the key 'sensor' whose case it is"),
        (
            {"gyro": {"sensor": "ADIS16470", "plus": 1}},
            "gyro: found 'plus' together with 'sensor', expected 'case' or nothing",
        ),
        ({"sensor": 3}, r"found 3, expected the name of a sensor \(insemu sensor lists them\)"),
    ):
        with pytest.raises(InputError, match=said):
            with_sensors(bad)


def test_files_of_cards_are_named_from_the_folder(tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text("x")
    (tmp_path / "plain").write_text("x")
    given = {"truth": {"sensor": "my.yaml"}, "designs": [{"sensor": "other.yaml"}, {"sensor": "plain"}, {"sensor": 3}]}
    assert files_from(given, tmp_path) == {
        "truth": {"sensor": str(tmp_path / "my.yaml")},
        "designs": [{"sensor": "other.yaml"}, {"sensor": "plain"}, {"sensor": 3}],
    }


def test_states_are_told_from_the_structure() -> None:
    s = read(
        {
            "designs.b": {"gyro": {"fit": "GM() + AR(2)", "plus": "RC(sigma=1 deg/h)"}, "accel": {"file": "m.yaml"}},
            "fits": {"simulate": 60},
        }
    )
    found = structures(s.designs["b"], s)
    assert {axis: None if m is None else [p.symbol for p in m] for axis, m in found.items()} == {
        **{axis: ["GM", "AR", "RC"] for axis in AXES[:3]}, **dict.fromkeys(AXES[3:], None),
    }  # fmt: skip
    assert state_names(s.designs["b"], s) is None
    assert structures(s.designs["a"])["gyro_x"] is None and state_names(s.designs["a"]) is None
    names = state_names(s.designs["a"], s)
    assert names is not None and len(names) == 9
    slow = Design.model_validate(
        {
            "gyro": {"fit": "WN() + GM() + AR(2)"},
            "accel": "RW(K=1) + WN(N=1)",
            "options": {"states": {"gyro_scale": 0.1, "latency": 1}},
        }
    )
    more = state_names(slow)
    assert more is not None and len(more) == 9 + 3 * 3 + 3 + 3 + 1
    assert state_names(Design.model_validate({"filter": "own", "gyro": "WN(N=1)", "accel": "WN(N=1)"})) is None


def test_the_schema_says_what_it_is() -> None:
    found = schema()
    assert (found["$schema"], found["title"]) == ("https://json-schema.org/draft/2020-12/schema", "insemu scenario")
    outage = found["$defs"]["OutageKeys"]["properties"]
    assert (
        set(outage) == {"start", "duration", "satellites", "elevation", "sectors"} and outage["start"]["x-unit"] == "s"
    )
    assert found["$defs"]["Gnss"]["properties"]["position_sigma"]["anyOf"][1]["maxItems"] == 3


# ----------------------------------------------------------------------------------------------------------------- first scenarios


def test_a_first_scenario_names_what_it_is_made_of(tmp_path: Path) -> None:
    text = first_scenario(tmp_path / "new.yaml", Wish())
    lines = text.splitlines()
    assert "#   insemu run new.yaml          flies it: tables here, figures and a page in results/new/" in lines
    assert 'title: "ADIS16470 through GNSS outages"' in lines
    assert (
        "realizations: 8                # flights with other noise; more of them narrow the intervals of the means"
        in lines
    )
    assert "  builtin: urban_drive_1       # or a track, waypoints, or a file of motion commands" in lines
    # outages of a minute after a third and two thirds of nine minutes
    assert "    - {start: 180 s, duration: 60 s}" in lines and "    - {start: 360 s, duration: 60 s}" in lines
    (tmp_path / "new.yaml").write_text(text)
    s = load(tmp_path / "new.yaml")
    assert set(s.designs) == {"complete", "white noise"} and s.realizations == 8
    assert s.truth is not None
    models = s.truth.models()
    for sensor in ("gyro", "accel"):
        largest = max(
            p.parameters["N"] for a, m in models.items() if a.startswith(sensor) for p in m if p.symbol == "WN"
        )
        (white,) = s.designs["white noise"].sources()[f"{sensor}_x"]  # type: ignore[misc]
        assert white.parameters["N"] == pytest.approx(largest, rel=1e-3)


def test_a_first_scenario_of_models_doubles_white_noise_where_there_is_nothing_else(tmp_path: Path) -> None:
    from insemu.noise import save

    for text, name, factor in (
        ("WN(N=1e-4)", "double", 2.0),
        ("WN(N=1e-4) + GM(sigma=1e-4, Tc=10 s)", "white noise", 1.0),
    ):
        models = tmp_path / "models.yaml"
        save({axis: NoiseModel.parse(text, "") for axis in AXES}, models)
        path = tmp_path / "new.yaml"
        path.write_text(first_scenario(path, Wish(model=str(models))))
        s = load(path)
        (white,) = s.designs[name].sources()["accel_z"]  # type: ignore[misc]
        assert white.parameters["N"] == pytest.approx(factor * 1e-4, rel=1e-3)
        assert s.truth is not None and s.truth.file == "models.yaml" and s.title == "models through GNSS outages"
    save({axis: NoiseModel.parse("RW(K=1e-4)", "") for axis in AXES}, models)
    with pytest.raises(InputError, match="has no white noise of the gyro, which the second design would have"):
        first_scenario(path, Wish(model=str(models)))
    save({axis: NoiseModel.parse("WN(N=1e-4)", "") for axis in AXES[:3]}, models)
    with pytest.raises(InputError, match="has no figures of the accel; a truth needs gyroscopes and accelerometers"):
        first_scenario(path, Wish(model=str(models)))


def test_short_tracks_have_shorter_outages(tmp_path: Path) -> None:
    rows = "".join(f"{k},{46.5 + 1e-4 * k:.6f},6.6,400\n" for k in range(91))
    (tmp_path / "t.csv").write_text("t [s],lat [deg],lon [deg],height [m]\n" + rows)
    lines = first_scenario(tmp_path / "new.yaml", Wish(track=str(tmp_path / "t.csv"))).splitlines()
    assert "    - {start: 30 s, duration: 15 s}" in lines and "    - {start: 60 s, duration: 15 s}" in lines
    assert "  track: t.csv" in lines and next(line for line in lines if "max_gap" in line).startswith(
        "  max_gap: 10 s  "
    )
    (tmp_path / "w.csv").write_text("lat,lon,height [m]\n46.5,6.6,400\n46.51,6.6,400\n46.52,6.61,400\n")
    lines = first_scenario(tmp_path / "new.yaml", Wish(track=str(tmp_path / "w.csv"))).splitlines()
    assert "  waypoints: w.csv" in lines and "  speed: 10 m/s                # of legs whose file gives none" in lines


def _sections(of: type[Section] = Section) -> Iterator[type[Section]]:
    for section in of.__subclasses__():
        yield section
        yield from _sections(section)


def test_numbers_of_every_section_are_finite() -> None:
    checked = 0
    for section in _sections():
        for name, field in section.model_fields.items():
            for bad in (math.inf, -math.inf, math.nan) if "float" in str(field.annotation) else ():
                with pytest.raises(ValidationError) as caught:
                    section(**{name: bad})
                assert any(e["loc"][:1] == (name,) for e in caught.value.errors()), (section, name, bad)
                checked += 1
    assert checked > 30
