"""Scenario files: what is said wrongly is named with file, line, key and the nearest valid key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from insemu.emulate import Outage
from insemu.errors import InputError
from insemu.noise import NoiseModel
from insemu.scenario import GyroSource, digest, load, resolve_path, schema

GOOD = """\
title: t
trajectory: {builtin: helicopter_mapping, rate: 100 Hz}
truth:
  gyro: WN(N=0.032 deg/s/sqrt(Hz)) + GM(sigma=1 deg/h, Tc=40 s)
  accel: [{process: WN, N: 85 ug/sqrt(Hz)}]
gnss:
  position_sigma: [2 cm, 2 cm, 3 cm]
  outages: [{start: 7 min, duration: 60 s}]
fits: {simulate: 4 h}
designs:
  one: {gyro: {fit: WN()}, accel: {truth: true}}
  two: {gyro: "WN(N=1)", accel_x: [{process: WN, N: 1}], accel_y: "WN(N=2)", accel_z: "WN(N=3)"}
variants:
  coarse: {gnss: {position_sigma: 1 m}}
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_good_file_is_read(tmp_path: Path) -> None:
    s = load(write(tmp_path, GOOD))
    assert s.gnss.position_sigma == (0.02, 0.02, 0.03)
    assert s.gnss.outages[0] == Outage(420.0, 60.0)
    assert s.truth.models()["gyro_y"].processes[0].N == pytest.approx(np.deg2rad(0.032))
    assert s.designs["one"].sources()["gyro_z"] == GyroSource(fit="WN()")
    assert s.designs["two"].sources()["accel_z"] == NoiseModel.parse("WN(N=3)")


def test_variants_and_the_command_line_override(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD)
    s = load(path, variant="coarse", overrides={"seed": 9, "realizations": None})
    assert s.gnss.position_sigma == (1.0, 1.0, 1.0)
    assert s.gnss.outages == load(path).gnss.outages
    assert (s.seed, s.realizations) == (9, 24)
    with pytest.raises(InputError, match="no variant 'corse'"):
        load(path, variant="corse")


def test_digest_is_of_what_matters(tmp_path: Path) -> None:
    one = load(write(tmp_path, GOOD))
    same = load(write(tmp_path, GOOD.replace("title: t", "title: other\nrealizations: 3")))
    other = load(write(tmp_path, GOOD.replace("60 s}", "61 s}")))
    assert digest(one) == digest(same) != digest(other)
    data = tmp_path / "x.bin"
    data.write_bytes(b"1")
    first = digest(one, {"x": data})
    data.write_bytes(b"2")
    assert digest(one, {"x": data}) != first


@pytest.mark.parametrize(
    ("found", "put", "message"),
    [
        (
            "position_sigma",
            "positon_sigma",
            r"s\.yaml:7: gnss\.positon_sigma: unknown key .*did you mean 'position_sigma'",
        ),
        ("title: t", "titel: t", r"s\.yaml:1: titel: unknown key 'titel' \(did you mean 'title'\?\)"),
        ("fit: WN()", "fti: WN()", r"s\.yaml:11: designs\.one\.gyro\.fti: .*did you mean 'fit'"),
        (
            "2 cm, 2 cm",
            "2 deg, 2 cm",
            r"s\.yaml:7: gnss\.position_sigma: the unit 'deg' has another dimension than 'm'",
        ),
        ("N: 85 ug", "N: -85 ug", r"s\.yaml:5: truth\.accel: WN: N \(white-noise density\) is -0\.0008.*not negative"),
        ("N=0.032 deg", "N=0.032 m", r"s\.yaml:4: truth\.gyro: WN\.N: the unit 'm/s/sqrt\(Hz\)'"),
        ("duration: 60 s", "duration: -60 s", r"s\.yaml:8: gnss\.outages\.0\.duration: found -60\.0"),
        (
            "duration: 60 s",
            "duration: 0 s",
            r"s\.yaml:8: gnss\.outages\.0\.duration: found 0\.0, input should be greater than 0",
        ),
        ("fit: WN()", "fit: WNN()", r"s\.yaml:11: designs\.one\.gyro\.fit: unknown process 'WNN'"),
        ("fits: {simulate: 4 h}\n", "", r"the design 'one' is fitted, but there is no section 'fits'"),
        ("builtin: helicopter_mapping, ", "", r"s\.yaml:2: trajectory: one source of motion is needed"),
        ("title: t", "title: t\ntitle: u", r"s\.yaml:2: the key 'title' stands twice, first at line 1"),
        ("title: t", "title: [t", r"s\.yaml:2: not YAML"),
        ("accel: {truth: true}}", "accel: {truth: true, fit: WN()}}", "exactly one of the keys"),
        (', accel_z: "WN(N=3)"', "", r"no belief for accel_z"),
        ('gyro: "WN(N=1)"', 'gyro: "WN()"', r"to fit it write \{fit: 'WN\(\)'\}"),
        ("  accel: [{process: WN, N: 85 ug/sqrt(Hz)}]\n", "", "no error model for accel_x, accel_y, accel_z"),
        (
            "fits: {simulate: 4 h}",
            "fits: {simulate: 4 h}\nrealizations: many",
            r"s\.yaml:10: realizations: found 'many'",
        ),
        ("fits: {simulate: 4 h}", "fits: {}", "exactly one of the keys 'simulate' and 'recorded'"),
        ("[2 cm, 2 cm, 3 cm]", "[2 cm, 0 cm, 3 cm]", "positive standard deviations"),
        ("[2 cm, 2 cm, 3 cm]", "[2 cm, 2 cm]", "one or three"),
        ("title: t", "- t", "not YAML|expected a mapping"),
        ("title: t", '"[": t', r"s\.yaml:1: \[: unknown key '\['"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, found: str, put: str, message: str) -> None:
    assert found in GOOD
    path = write(tmp_path, GOOD.replace(found, put, 1))
    with pytest.raises(InputError, match=message):
        load(path)


def test_a_file_that_is_no_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "absent.yaml")
    with pytest.raises(InputError, match="expected a mapping"):
        load(write(tmp_path, "[1, 2]"))
    with pytest.raises(InputError, match="not YAML"):
        load(write(tmp_path, "title: !!python/object/apply:os.system ['true']"))
    (tmp_path / "s.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read as text"):
        load(tmp_path / "s.yaml")


def test_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data.csv").write_text("1")
    assert resolve_path("data.csv", tmp_path / "s.yaml") == tmp_path / "data.csv"
    monkeypatch.setenv("INSEMU_SHARED", str(tmp_path))
    assert resolve_path("shared:data.csv") == tmp_path / "data.csv"
    with pytest.raises(InputError, match="no such file"):
        resolve_path("other.csv", tmp_path / "s.yaml")
    with pytest.raises(InputError, match="name too long: xxx"):
        resolve_path("x" * 5000, tmp_path / "s.yaml")
    with pytest.raises(InputError, match="name too long: xxx"):
        resolve_path("shared:" + "x" * 5000)
    with pytest.raises(InputError, match="shared data absent: other"):
        resolve_path("shared:other.csv")


def test_the_projects_own_scenarios_are_valid_with_every_variant() -> None:
    folder = Path(__file__).resolve().parents[1] / "scenarios"
    files = sorted(folder.glob("*.yaml"))
    assert files
    for path in files:
        for name in [None, *load(path).variants]:
            load(path, variant=name)


def test_schema_is_json_and_knows_the_sections() -> None:
    text = json.loads(json.dumps(schema()))
    assert {"trajectory", "truth", "gnss", "designs"} <= set(text["properties"])
    assert text["additionalProperties"] is False
