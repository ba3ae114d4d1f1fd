"""A result run again is the same to the last bit; what differs is said; the folder is an RO-Crate."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from insemu.cli import app
from insemu.errors import InputError
from insemu.evaluate import Experiment, changed, differences, effort
from insemu.scenario import load
from tests.fuzz.commands import SCENARIO

pytestmark = pytest.mark.usefixtures("without_pictures")

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    (folder / "s.yaml").write_text(SCENARIO, encoding="utf-8")
    ran = RUNNER.invoke(app, ["run", str(folder / "s.yaml"), "--output", str(folder / "out"), "--workers", "1"])
    assert ran.exit_code == 0, ran.output
    return folder / "out"


def test_a_result_is_reproduced_to_the_last_bit(result: Path) -> None:
    ran = RUNNER.invoke(app, ["reproduce", str(result), "--json"])
    assert ran.exit_code == 0, ran.output
    said = json.loads(ran.stdout)
    assert said["same"] and said["changed"] == []


def test_what_differs_is_said(result: Path, tmp_path: Path) -> None:
    held = tmp_path / "out"
    shutil.copytree(result, held)
    text = (held / "resolved.yaml").read_text().replace("seed: 1", "seed: 2")
    (held / "resolved.yaml").write_text(text)
    manifest = json.loads((held / "manifest.json").read_text())
    manifest["packages"]["numpy"] = "0.9"
    (held / "manifest.json").write_text(json.dumps(manifest))
    ran = RUNNER.invoke(app, ["reproduce", str(held)])
    assert ran.exit_code == 1
    assert "packages numpy: 0.9 then" in ran.stderr
    assert "error: " in ran.stdout and "numbers differ" in ran.stdout
    assert (
        "runs: end_error: " in ran.stdout and "statistics: error_rms: " in ran.stdout
    )  # what a large run keeps of all


@pytest.mark.parametrize("name", ["manifest.json", "resolved.yaml", "errors.nc"])
def test_a_folder_without_its_files_is_refused(result: Path, tmp_path: Path, name: str) -> None:
    held = tmp_path / "out"
    shutil.copytree(result, held)
    (held / name).unlink()
    ran = RUNNER.invoke(app, ["reproduce", str(held)])
    assert isinstance(ran.exception, InputError) and name in str(ran.exception)
    (held / name).write_bytes(b"broken: [")
    ran = RUNNER.invoke(app, ["reproduce", str(held)])
    assert isinstance(ran.exception, InputError)


def test_the_crate_names_every_file_with_its_hash(result: Path) -> None:
    graph = json.loads((result / "ro-crate-metadata.json").read_text())["@graph"]
    entity = {e["@id"]: e for e in graph}
    assert entity["ro-crate-metadata.json"]["about"] == {"@id": "./"}
    parts = {p["@id"] for p in entity["./"]["hasPart"]}
    there = {str(p.relative_to(result)) for p in result.rglob("*") if p.is_file() and "cache" not in p.parts}
    assert parts == there - {"complete.json", "ro-crate-metadata.json", "timing.json"}
    for name in parts:
        assert entity[name]["sha256"] == hashlib.sha256((result / name).read_bytes()).hexdigest()
    assert any(r.startswith("numpy==") for r in entity["#insemu"]["softwareRequirements"])
    assert any(r.startswith("llvmlite==") for r in entity["#insemu"]["softwareRequirements"])  # needed by numba alone


def test_differences_name_what_they_count() -> None:
    one = xr.Dataset({"a": ("t", [1.0, 2.0, np.nan]), "n": ("t", ["x", "y", "z"])})
    assert differences(one, one.assign(a=("t", [1.0, 2.5, np.nan]))) == [
        "a: 1 of 3 numbers differ, by at most 0.5, 0.25 of its largest value"
    ]
    assert differences(one, one.assign(a=("t", [1.0, 2.0, 3.0])))[0].startswith("a: 1 of 3")
    assert differences(one, one.drop_vars("a")) == ["a: only in the held result"]
    assert differences(one, one.isel(t=[0, 1]))[0] == "a: shape (3,) then, (2,) now"
    assert differences(one, one.assign(n=("t", ["x", "y", "q"]))) == ["n: other labels"]


def test_what_a_result_does_not_say_is_not_compared() -> None:
    now = {"python": "3.12", "inputs": {"a.npz": "ff"}, "packages": {"x": "1"}}
    assert changed({"inputs": None}, now) == []
    assert changed({"python": "3.11", "inputs": {"a.npz": "00"}, "packages": {"x": "1", "y": "2"}}, now) == [
        "inputs a.npz: 00 then, ff now",
        "packages y: 2 then, not there now",
        "python: 3.11 then, 3.12 now",
    ]


def test_the_effort_is_said_and_what_does_not_fit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s.yaml").write_text(
        SCENARIO.replace("gnss:", "  effects: [{effect: dropped_samples, probability: 0.05}]\ngnss:", 1)
    )
    experiment = Experiment(load(tmp_path / "s.yaml"), tmp_path / "s.yaml")
    # 60 s at 20 Hz, two designs, two realizations
    assert effort([experiment], 1).startswith("4.8e+03 filter epochs")
    assert any("dropped_samples loses about 5 %" in w for w in experiment.warnings)
    monkeypatch.setattr("insemu.evaluate.ahead.memory_there", lambda: 1e6)
    with pytest.raises(InputError, match="GiB are free"):
        effort([experiment], 1)
    # signals of the world 0.6 MB, of eight side by side 4.6, of all twelve 6.9; results of 61 epochs, 1 MB
    many = Experiment(load(tmp_path / "s.yaml", overrides={"realizations": 12}), tmp_path / "s.yaml")
    monkeypatch.setattr("insemu.evaluate.ahead.memory_there", lambda: 7e6)
    effort([many], 1)
    with pytest.raises(InputError, match="--workers"):
        effort([many], 2)
