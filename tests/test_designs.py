"""Designs by name, designs that a filter cannot carry, and a user's own filter in every command."""

from __future__ import annotations

import json
import re
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu import units
from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import Experiment, run_experiment, summary
from insemu.evaluate.comparison import analyse_designs, with_designs
from insemu.evaluate.regression import Alteration, AlteredExperiment, Baseline, assert_unchanged, check
from insemu.filters import LooselyCoupledEKF, protocol
from insemu.noise import AR, NoiseModel, save
from insemu.records import AXES
from insemu.scenario import Design, Scenario, digest, load, shipped_designs, state_names
from tests import filter_cases as cases

SCENARIO: dict[str, Any] = {
    "title": "small flight",
    "seed": 3,
    "realizations": 4,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "90 s"},
    "truth": {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=40 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=1 mg, Tc=100 s)",
    },
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "2 cm/s", "outages": [{"start": "60 s", "duration": "20 s"}]},
    "fits": {"simulate": "20 min"},
    "designs": {"full": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}


def write(path: Path, **changes: Any) -> Path:
    path.write_text(yaml.safe_dump(SCENARIO | changes, sort_keys=False), encoding="utf-8")
    return path


def complaint(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """What a command says on standard error when it refuses."""
    with pytest.raises(SystemExit) as stop:
        main(list(argv))
    assert stop.value.code == 2
    return capsys.readouterr().err


# -- designs by name ----------------------------------------------------------------------------------------------------------------------


def test_every_shipped_design_has_the_states_that_its_name_says():
    counts = {name: len(state_names(Design.model_validate(name)) or ()) for name in shipped_designs()}
    assert {name: counts[name] for name in ("15AV", "18AV", "18AVWD", "15AR", "27AR", "GMWM")} == {
        "15AV": 15, "18AV": 18, "18AVWD": 18, "15AR": 15, "27AR": 27, "GMWM": 18,
    }  # fmt: skip
    assert [counts[f"model {k}"] for k in (1, 2, 3)] == [9, 18, 24]
    assert state_names(Design.model_validate("18AV"))[12:15] == ("accel_x.GM1", "accel_x.RW1", "accel_y.GM1")


def test_states_told_from_the_structure_are_those_of_the_filter(tmp_path):
    scenario = load(write(tmp_path / "s.yaml", designs={"18AV": "18AV", "GMWM": "GMWM", "27AR": "27AR"}))
    results = run_experiment(Experiment(scenario), realizations=1)
    for name, design in scenario.designs.items():
        assert results.designs[name].state_names == state_names(design, scenario)


def test_keys_beside_a_name_win():
    own = Design.model_validate(
        {
            "design": "18AVWD",
            "gyro": "WN(N=1e-3)",
            "accel_y": "WN(N=2e-3)",
            "options": {"gate": 1e-4, "prefilter": {"wavelet": "db6"}},
        }
    )
    sources = own.sources()
    assert str(sources["gyro_x"]) == str(sources["gyro_z"]) == "WN(N=0.001)"
    assert str(sources["accel_y"]) == "WN(N=0.002)" and "RW" in str(sources["accel_x"])
    assert own.options.gate == 1e-4 and own.options.prefilter is not None
    assert own.options.prefilter.wavelet == "db6" and own.options.prefilter.per_axis() == [7, 7, 7, 7, 6, 6]
    # a resolved copy says the same again
    assert Design.model_validate(own.model_dump(mode="json")) == own


def test_a_delay_belongs_to_the_rule_that_is_linear():
    with pytest.raises(ValueError, match="delay belongs to rule 'approximation', found rule 'sure'"):
        Design.model_validate({"design": "18AVWD", "options": {"prefilter": {"delay": "1 s"}}})
    causal = Design.model_validate({"design": "18AVWD causal"}).options.prefilter
    assert causal is not None and causal.delay == 0.0 and causal.rule == "approximation"


def test_printed_autoregressions_agree_with_their_table():
    """Signs and coefficients of Table 2, first partial autocorrelation from the AR(1) row."""
    for axis, printed in (("gyro_x", (2.564, -2.131, 0.567)), ("accel_z", (2.564, -2.136, 0.572))):
        one = Design.model_validate("15AR printed").sources()[axis]
        three = Design.model_validate("27AR printed").sources()[axis]
        assert isinstance(one, NoiseModel) and isinstance(three, NoiseModel)
        first, process = one.processes[0].ar[0], three.processes[0]
        k = cases.partial_correlations(printed)
        assert cases.partial_correlations(process.ar) == pytest.approx([first, *k[1:]], abs=2e-4)
        ratio = process.block(0.01).P0[0, 0] / one.processes[0].block(0.01).P0[0, 0]
        assert 0.5 < ratio < 2.0  # one signal, fitted twice


def test_designs_of_the_command_line_are_the_scenarios_or_shipped(tmp_path, capsys):
    path = write(tmp_path / "s.yaml")
    main_ok(["compare", str(path), "--designs", "full,15AV,15AR", "--realizations", "2", "--workers", "1", "--json"])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [r["design"] for r in rows if r["outage"] is None] == ["full", "15AV", "15AR"]
    assert "did you mean '15AV'" in complaint(capsys, "compare", str(path), "--designs", "15AW")
    bare = {key: value for key, value in SCENARIO.items() if key != "fits"}
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(bare), encoding="utf-8")
    assert "no section 'fits'" in complaint(capsys, "compare", str(tmp_path / "bare.yaml"), "--designs", "GMWM")


def main_ok(argv: list[str]) -> None:
    try:
        main(argv)
    except SystemExit as stop:
        assert not stop.code


def test_the_command_lists_designs_with_their_states(tmp_path, capsys):
    main_ok(["designs", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["27AR"]["states"] == 27 and told["27AR"]["state_names"][9] == "gyro_x.AR1.1"
    main_ok(["designs", "18AV"])
    out = capsys.readouterr().out
    assert "accel_z.RW1" in out
    assert (
        Design.model_validate(yaml.safe_load(out[out.index("18AV:\n") :])["18AV"]).sources()
        == Design.model_validate("18AV").sources()
    )
    main_ok(["designs", "--scenario", str(write(tmp_path / "s.yaml"))])
    assert "15" in capsys.readouterr().out
    assert "did you mean" in complaint(capsys, "designs", "18AX")


# -- what no filter can carry --------------------------------------------------------------------------------------------------------------

UNSTABLE = "AR(ar=(2.564,-2.131,0.567), sigma2=2.739e-13) + WN(N=0.03 deg/s/sqrt(Hz))"


def test_an_unstable_polynomial_is_refused_with_the_nearest_stable_one(tmp_path, capsys):
    bad = {"gyro": UNSTABLE, "accel": "WN(N=90 ug/sqrt(Hz))"}
    path = write(tmp_path / "s.yaml", designs={"bad": bad})
    out = tmp_path / "out"
    said = complaint(capsys, "run", str(path), "--output", str(out))
    assert "designs.bad: belief of gyro_x" in said and "not stationary" in said and "stabilise: true" in said
    assert not out.exists()
    # what was offered is taken
    offer = re.search(r"nearest stable polynomial is \[([^\]]*)\]", said)
    assert offer is not None
    ar = tuple(float(v) for v in offer.group(1).split(","))
    assert AR(ar, sigma2=1.0).spectral_radius < 1.0
    for stabilise in (True, 0.999):
        taken = {"gyro": {"model": UNSTABLE, "stabilise": stabilise}, "accel": "WN(N=90 ug/sqrt(Hz))"}
        made = Experiment(load(write(path, designs={"good": taken}))).ekf("good")
        radius = np.abs(np.linalg.eigvals(made.augmentation.Phi)).max()
        assert radius == pytest.approx(1 - 1e-6 if stabilise is True else 0.999, abs=1e-9)
    said = complaint(
        capsys, "run", str(write(path, designs={"bad": {"gyro": "AR1(phi=1.01, sigma2=1e-9)", "accel": "WN(N=1e-3)"}}))
    )
    assert "nearest stable is 0.999999" in said and "random walk" in said


# -- a user's own filter --------------------------------------------------------------------------------------------------------------------

DOCS = Path(__file__).parents[1] / "docs" / "filters.md"


@pytest.fixture
def offered(monkeypatch):
    """The classes of the documentation's example, offered as an installed package would."""
    section = DOCS.read_text(encoding="utf-8").split("## A filter of your own")[1]
    code = "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))
    module = types.ModuleType("my_package")
    exec(compile(code, "my_package.py", "exec"), module.__dict__)
    entries = [
        types.SimpleNamespace(name="cautious", value="my_package:Cautious", load=lambda: module.Cautious),
        types.SimpleNamespace(name="lazy", value="my_package:Lazy", load=lambda: Lazy),
    ]
    monkeypatch.setattr(protocol, "entry_points", lambda group: entries)
    return module


class Lazy:
    """A filter that leaves out what it was asked for."""

    def __init__(self, belief, dt, **keywords):
        self.inner = LooselyCoupledEKF(belief, dt, **keywords)

    def run(self, imu, gnss, initial, initial_sigma):
        run = self.inner.run(imu, gnss, initial, initial_sigma)
        return replace(run, covariance_t=run.covariance_t[:5], covariance=run.covariance[:5])


def users(**more: Any) -> dict[str, Any]:
    return SCENARIO["designs"] | {
        "mine": {"filter": "cautious", "gyro": {"truth": True}, "accel": {"truth": True}, **more}
    }


def test_a_users_filter_takes_part_in_everything(tmp_path, capsys, offered):
    path = write(tmp_path / "s.yaml", designs=users(settings={"least": 2.0}))
    told = summary(run_experiment(Experiment(load(path), path)))["designs"]
    # told to trust the fixes half as much, the example is less sure than it could be
    assert told["mine"]["states"] == 15 and told["mine"]["state_names"] == told["full"]["state_names"]
    assert told["mine"]["nees_per_dof"] < 0.8 * told["full"]["nees_per_dof"]
    assert told["mine"]["nis_per_dof"] < 0.5 < told["full"]["nis_per_dof"]
    capsys.readouterr()
    main_ok(["compare", str(path), "--workers", "1", "--json"])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {r["design"] for r in rows} == {"full", "mine"}
    baseline = tmp_path / "b.json"
    main_ok(["regress", "record", str(path), "--baseline", str(baseline), "--workers", "1"])
    main_ok(["regress", "check", str(path), "--baseline", str(baseline), "--workers", "1"])
    assert_unchanged(path, baseline)
    with pytest.raises(AssertionError, match="mine: "):  # the filter is changed in the user's repository
        assert_unchanged(write(path, designs=users(settings={"least": 3.0})), baseline)
    experiment = Experiment(load(path), path)
    altered = run_experiment(AlteredExperiment(experiment, Alteration("gnss", "position", 1.5)))
    changed = {c.design for c in check(altered, Baseline.read(baseline)) if c.significant}
    assert "mine" in changed
    with pytest.raises(InputError, match="is the filter 'cautious'"):
        experiment.ekf("mine")
    assert list(analyse_designs(experiment)) == ["full"]


def test_results_of_a_users_filter_belong_to_its_code(tmp_path, offered, monkeypatch):
    path = write(tmp_path / "s.yaml", designs=users())
    module = tmp_path / "my_package.py"
    offered.__file__ = str(module)
    offered.Cautious.__module__ = "my_package"
    monkeypatch.setitem(__import__("sys").modules, "my_package", offered)
    found = []
    for text in ("one", "one", "two"):
        module.write_text(text)
        found.append(Experiment(load(path), path).digest)
    assert found[0] == found[1] != found[2]
    assert found[0] != digest(load(path))


def test_what_a_users_filter_lacks_is_said(tmp_path, capsys, offered):
    path = write(tmp_path / "s.yaml", designs=users(filter="cautios"))
    assert "did you mean 'cautious'" in complaint(capsys, "run", str(path))
    said = complaint(capsys, "run", str(write(path, designs=users(settings={"leest": 1.0}))))
    assert "designs.mine" in said and "unexpected keyword argument 'leest'" in said
    said = complaint(capsys, "compare", str(write(path, designs=users(filter="lazy"))), "--workers", "1")
    assert "the filter 'lazy' returned no covariance at 5 s" in said
    said = complaint(capsys, "run", str(write(path, designs={"x": {"settings": {"a": 1}, "design": "15AV"}})))
    assert "settings without the key 'filter'" in said


def test_a_users_filter_may_do_without_a_noise_model(tmp_path, offered):
    path = write(tmp_path / "s.yaml", designs={"mine": {"filter": "cautious", "gyro": "WN(N=1e-3)"}})
    results = run_experiment(Experiment(load(path), path), realizations=1)
    assert results.designs["mine"].states == 9
    assert list(results.designs["mine"].belief) == ["gyro_x", "gyro_y", "gyro_z"]
    assert summary(with_seed(results))["designs"]["mine"]["states"] == 9
    assert list(with_designs(load(path), ["15AV", "mine"]).designs) == ["15AV", "mine"]


def with_seed(results):
    return replace(results, seed=results.seed + 1)


def test_the_papers_scenario_flies_the_shipped_designs():
    """Its truth is the 18AV noise, so the numbers stand twice and must agree."""
    scenario = load(Path(__file__).parents[1] / "scenarios" / "tables_9_10.yaml")
    assert scenario.truth is not None
    assert scenario.designs["18AV"].sources() == scenario.truth.models()
    assert scenario.designs["18AVWD"].sources() == scenario.truth.models()
    white = {axis: model.processes[:2] for axis, model in scenario.truth.models().items()}
    assert {axis: model.processes for axis, model in scenario.designs["15AV"].sources().items()} == white


#: White noise, walk and turn-on bias of a unit in the middle of each grade.
UNITS = {
    "UAV MEMS": ("0.05 deg/s/sqrt(Hz)", "2e-3 deg/s*sqrt(Hz)", "1 deg/s", "6 mg/sqrt(Hz)", "200 ug*sqrt(Hz)", "50 mg"),
    "phone": ("0.01 deg/s/sqrt(Hz)", "2e-3 deg/s*sqrt(Hz)", "1 deg/s", "200 ug/sqrt(Hz)", "200 ug*sqrt(Hz)", "50 mg"),
    "consumer MEMS": ("0.01 deg/s/sqrt(Hz)", "6e-4 deg/s*sqrt(Hz)", "0.5 deg/s", "200 ug/sqrt(Hz)", "40 ug*sqrt(Hz)", "25 mg"),
    "industrial MEMS": ("4e-3 deg/s/sqrt(Hz)", "1e-4 deg/s*sqrt(Hz)", "0.1 deg/s", "60 ug/sqrt(Hz)", "8 ug*sqrt(Hz)", "5 mg"),
    "tactical grade": ("0.06 deg/sqrt(h)", "1e-5 deg/s*sqrt(Hz)", "5 deg/h", "40 ug/sqrt(Hz)", "2 ug*sqrt(Hz)", "1 mg"),
    "navigation grade": ("0.002 deg/sqrt(h)", "5e-8 deg/s*sqrt(Hz)", "0.01 deg/h", "8 ug/sqrt(Hz)", "0.2 ug*sqrt(Hz)", "50 ug"),
}  # fmt: skip


@pytest.mark.parametrize("times", [1 / 3, 1.0, 3.0])
@pytest.mark.parametrize("grade", UNITS)
def test_a_design_of_a_grade_fits_units_three_times_better_and_worse(grade, times):
    """NIS per degree of freedom between 0.3 and 3 without tuning; one grade off it is not."""
    gyro, accel = UNITS[grade][:3], UNITS[grade][3:]

    def unit(values, unit):
        white, walk, bias = (times * units.parse(v, u) for v, u in zip(values, unit, strict=True))
        return f"WN(N={white!r}) + RW(K={walk!r}, sigma0={bias!r})"

    scenario = Scenario.model_validate(
        {
            "title": grade,
            "realizations": 1,
            "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "200 s"},
            "truth": {
                "gyro": unit(gyro, ("rad/s/sqrt(Hz)", "rad/s*sqrt(Hz)", "rad/s")),
                "accel": unit(accel, ("m/s^2/sqrt(Hz)", "m/s^2*sqrt(Hz)", "m/s^2")),
            },
            "gnss": {"position_sigma": "0.5 m", "velocity_sigma": "5 cm/s"},
            "designs": {grade: grade},
        }
    )
    nis = run_experiment(Experiment(scenario)).nis
    assert 0.3 < float(nis[0, 0]) < 3.0


def test_a_design_that_is_two_grades_too_good_is_seen():
    scenario = Scenario.model_validate(
        {
            "title": "phone taken for tactical",
            "realizations": 1,
            "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "200 s"},
            "truth": {
                "gyro": "WN(N=0.01 deg/s/sqrt(Hz)) + RC(sigma=1 deg/s)",
                "accel": "WN(N=200 ug/sqrt(Hz)) + RC(sigma=50 mg)",
            },
            "gnss": {"position_sigma": "0.5 m", "velocity_sigma": "5 cm/s"},
            "designs": {"tactical grade": "tactical grade"},
        }
    )
    assert float(run_experiment(Experiment(scenario)).nis[0, 0]) > 3.0


def test_the_readable_filter_flies_as_the_compiled_one(tmp_path):
    """Both from the same scenario; the digits that differ are those of another order of operations."""
    short = {
        "title": "short",
        "realizations": 1,
        "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "40 s"},
        "truth": {"gyro": "WN(N=0.01 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=60 s)", "accel": "WN(N=200 ug/sqrt(Hz))"},
        "gnss": {"outages": [{"start": "20 s", "duration": "10 s"}]},
        "designs": {
            "compiled": {"gyro": {"truth": True}, "accel": {"truth": True}},
            "white": {"gyro": "WN(N=1e-3)", "accel": "WN(N=1e-2)"},
        },
    }
    one = run_experiment(Experiment(Scenario.model_validate(short)))
    other = Scenario.model_validate(short | {"filter": "reference"})
    assert {d.filter for d in other.designs.values()} == {"reference"}
    two = run_experiment(Experiment(other))
    np.testing.assert_allclose(two.error, one.error, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(two.sigma, one.sigma, rtol=1e-5, atol=1e-9)
    assert not np.array_equal(two.error, one.error)  # another program


def test_a_truth_and_additions_to_a_fit_come_from_files_and_units(tmp_path):
    """`truth: {file: ...}` reads what `fit -o` wrote; `plus` adds processes to a fitted design, a held value may carry a unit."""
    models = {a: NoiseModel.parse("WN(N=1e-4)" if a.startswith("gyro") else "WN(N=1e-3)") for a in AXES}
    save(models, tmp_path / "models.yaml")
    text = {
        "title": "t",
        "trajectory": {"builtin": "helicopter_mapping"},
        "truth": {"file": "models.yaml", "gyro_x": "WN(N=0.1 deg/sqrt(h))"},
        "fits": {"simulate": "1 h"},
        "designs": {
            "d": {
                "gyro": {"fit": "GM(Tc=40 s, sigma=10 deg/h) + WN()", "plus": "RC(sigma=0.5 deg/s)"},
                "accel": {"truth": True},
            }
        },
    }
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(text))
    scenario = load(path)
    assert scenario.truth.models()["accel_y"] == models["accel_y"]
    assert scenario.truth.models()["gyro_x"].processes[0].N == pytest.approx(np.deg2rad(0.1) / 60)
    assert "gyro_z.RC1" in state_names(scenario.designs["d"], scenario)
    source = scenario.designs["d"].sources()["gyro_x"]
    assert source.fit.processes[0].parameters["sigma"] == pytest.approx(np.deg2rad(10) / 3600)
    assert digest(load(path)) == digest(scenario)
    (tmp_path / "models.yaml").write_text("axes: {gyro_x: {unit: rad/s, model: WN(N=1)}}")
    with pytest.raises(InputError, match="no model for gyro_y"):
        load(path)
