"""Baselines: a changed design is reported and named, other draws are not; comparisons and the commands around them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import Experiment, run_experiment
from insemu.evaluate.comparison import analyse_designs, compare, with_designs
from insemu.evaluate.regression import (
    Alteration,
    AlteredExperiment,
    Baseline,
    alterations,
    assert_unchanged,
    check,
    smallest_detectable,
)
from insemu.scenario import load

pytestmark = pytest.mark.usefixtures("without_pictures")

SCENARIO = {
    "title": "small flight",
    "seed": 3,
    "realizations": 6,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "120 s"},
    "truth": {
        "gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=40 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=1 mg, Tc=100 s)",
    },
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "2 cm/s", "outages": [{"start": "80 s", "duration": "20 s"}]},
    "designs": {
        "white": {"gyro": "WN(N=0.04 deg/s/sqrt(Hz))", "accel": "WN(N=200 ug/sqrt(Hz))"},
        "full": {"gyro": {"truth": True}, "accel": {"truth": True}},
    },
}


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("regress") / "s.yaml"
    path.write_text(yaml.safe_dump(SCENARIO, sort_keys=False), encoding="utf-8")
    return path


def experiment(file, seed=3):
    return Experiment(load(str(file), overrides={"seed": seed}), file)


@pytest.fixture(scope="module")
def flown(file):
    return run_experiment(experiment(file))


def significant(results, baseline):
    return [c for c in check(results, baseline) if c.significant]


def test_the_same_and_other_draws_are_no_change(file, flown):
    held = Baseline.of(flown)
    assert not significant(flown, held)
    for seed in (4, 5, 6):  # false alarms 1 % each
        assert not significant(run_experiment(experiment(file, seed)), held)


@pytest.mark.parametrize(
    "alteration",
    [
        Alteration("gyro", "WN1.N", 1.2),
        Alteration("gyro", "WN1.N", 0.8),
        Alteration("gnss", "position", 1.2),
        Alteration("gnss", "position", 0.8),
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", [3, 4])
def test_noise_believed_twenty_percent_wrong_is_a_change(file, flown, alteration, seed):
    changed = significant(run_experiment(AlteredExperiment(experiment(file, seed), alteration)), Baseline.of(flown))
    assert changed
    assert "was" in str(changed[0]) and "allowed" in str(changed[0])


def test_a_worse_filter_is_a_change_of_accuracy_too(flown):
    worse = flown.with_data({"error": flown.error * 4.0, "nees": flown.nees * 16.0})
    names = {c.figure for c in significant(worse, Baseline.of(replace(flown, seed=99)))}
    assert "log_nees" in names and not any(n.startswith("stated") for n in names)


def test_alterations_name_every_parameter_and_change_only_it(file):
    e = experiment(file)
    names = [str(a) for a in alterations(e, "full", 1.1)]
    assert names[:3] == ["gyro WN1.N", "gyro GM1.sigma", "gyro GM1.beta"]
    assert names[3:] == ["accel WN1.N", "accel GM1.sigma", "accel GM1.beta", "gnss position", "gnss velocity"]
    models = e.beliefs["full"].models
    altered = Alteration("accel", "GM1.beta", 2.0).belief(models)
    assert altered["gyro_x"] == models["gyro_x"]
    assert altered["accel_y"].processes[1].beta == pytest.approx(2 * models["accel_y"].processes[1].beta)


def test_sensitivity_says_what_a_check_can_see(file, flown):
    seen = smallest_detectable(experiment(file), Baseline.of(flown), "full")
    assert seen["gyro WN1.N"] < 0.2 and seen["gnss position"] < 0.2
    assert all(v > 0 for v in seen.values())


def test_baselines_survive_the_file_and_bad_ones_are_refused(tmp_path, flown):
    path = tmp_path / "b.json"
    Baseline.of(flown).write(path)
    back = Baseline.read(path)
    assert back.seed == 3 and not significant(flown, back)
    path.write_text("{}")
    with pytest.raises(InputError, match="not a baseline"):
        Baseline.read(path)
    held = Baseline.of(flown)
    with pytest.raises(InputError, match="the baseline has the design 'gone'"):
        check(flown, replace(held, figures={"gone": held.figures["full"]}))
    with pytest.raises(InputError, match="probability"):
        check(flown, held, false_alarm=2.0)


def test_from_pytest(tmp_path, file, flown):
    path = tmp_path / "b.json"
    held = Baseline.of(flown)
    held.write(path)
    assert_unchanged(file, path)
    wrong = {k: v * 1.1 for k, v in held.figures["full"].items()}
    replace(held, figures={"full": wrong}).write(path)
    with pytest.raises(AssertionError, match=r"full: stated_sigma_end_m\.1 was"):
        assert_unchanged(file, path)


# -- comparison --------------------------------------------------------------------------------------------------------------------------


def test_designs_are_paired_and_ranked(flown):
    rows = compare(flown)
    assert [(r.outage, r.design) for r in rows] == [(1, "white"), (1, "full"), (None, "white"), (None, "full")]
    assert rows[0].ratio is None and rows[1].ratio == pytest.approx(rows[1].mean_m / rows[0].mean_m)
    assert {r.rank for r in rows[:2]} == {1, 2}
    assert compare(flown, "full")[1].effect_size is None
    with pytest.raises(InputError, match="did you mean 'full'"):
        compare(flown, "ful")


def test_the_analysis_states_what_the_filter_states(file, flown):
    e = experiment(file)
    analyses = analyse_designs(e)
    at = flown.end_index(0)
    for name, a in analyses.items():
        stated = np.hypot(*flown.sigma[flown.names.index(name), :, at, :2].T).mean()
        assert np.hypot(*a.sigma[at, :2]) == pytest.approx(stated, rel=0.01)
        assert a.budgets[0].t == pytest.approx(100.0)
    full = analyses["full"]
    np.testing.assert_allclose(full.rms[1:], full.sigma[1:], rtol=1e-6)
    only = with_designs(e.scenario, ["full"])
    assert list(only.designs) == ["full"]
    with pytest.raises(InputError, match="did you mean 'white'"):
        with_designs(e.scenario, ["wite"])


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def test_the_commands(tmp_path, file, capsys):
    baseline, page = tmp_path / "b.json", tmp_path / "page"
    assert run("regress", "record", file, "--baseline", baseline) == 0
    capsys.readouterr()
    assert run("regress", "check", file, "--baseline", baseline, "--json") == 0
    assert json.loads(capsys.readouterr().out)["changed"] == 0
    document = json.loads(baseline.read_text())
    document["figures"]["full"]["nis_per_dof"] = [v * 1.5 for v in document["figures"]["full"]["nis_per_dof"]]
    baseline.write_text(json.dumps(document))
    assert run("regress", "check", file, "--baseline", baseline) == 1
    assert "nis_per_dof" in capsys.readouterr().out
    assert run("compare", file, "--designs", "full,white", "--realizations", "3", "--json") == 0
    out = json.loads(capsys.readouterr().out)
    assert out["base"] == "full" and len(out["rows"]) == 4
    assert run("compare", file, "--analytic", "--output", page, "--json") == 0
    out = json.loads(capsys.readouterr().out)
    parts = out["designs"]["full"]["outages"][0]["parts_rms_m"]
    assert np.sqrt(sum(v**2 for v in parts.values())) == pytest.approx(out["designs"]["full"]["outages"][0]["rms_m"])
    assert "Error budget" in (page / "index.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("regress", "chek", "SCENARIO", "--baseline", "b.json"), "did you mean 'check'"),
        (("regress", "check", "SCENARIO", "--baseline", "absent.json"), "absent.json"),
        (("regress", "record", "SCENARIO", "--baseline", "nowhere/b.json"), "does not exist"),
        (("compare", "SCENARIO", "--designs", "ful"), "did you mean 'full'"),
        (("compare", "SCENARIO", "--base", "ful"), "did you mean 'full'"),
        (("compare", "SCENARIO", "--analytic", "--by", "proces"), "did you mean 'process'"),
    ],
)
def test_what_the_commands_refuse(file, arguments, message, capsys):
    assert run(*(file if a == "SCENARIO" else a for a in arguments)) == 2
    assert message in " ".join(capsys.readouterr().err.split())
