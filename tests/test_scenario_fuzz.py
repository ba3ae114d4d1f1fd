"""Mutated scenarios: whatever a file holds, ``load`` gives a scenario or one readable message, never a traceback.

``INSEMU_FUZZ=20000`` (environment) sets how many mutations of every shipped scenario are tried; a handful otherwise.
"""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from insemu import yamlfile
from insemu.errors import InputError
from insemu.scenario import load, state_names

FOLDER = Path(__file__).resolve().parents[1] / "scenarios"
FILES = sorted(FOLDER.glob("*.yaml"))
EXAMPLES = int(os.environ.get("INSEMU_FUZZ", "20"))

#: What stands where something else is expected, as YAML text.
ODD = (
    "null", "true", "''", "0", "-1", "1e400", ".nan", ".inf", "-.inf", "1e-320", "9" * 400, "[]", "{}", "[[]]", "[1, two, {a: b}]",
    "{process: WN}", "[{process: WN, N: [1]}]", "[{process: GM, sigma: {a: 1}}]", "[{process: AR, ar: [2, 3], sigma2: 1}]",
    "[{process: [WN]}]", "1 m^(1/0)", "1 m^(1e9)", "1 deg/0", "1 " + "(" * 300 + "m", "1e9*GM()", "GM(beta=0)", "GM(Tc=1e-320 s)",
    "999999999*WN(N=1)", "GM(sigma=1e300, Tc=1e300)", "AR(99999999)", "ARMA(1, 1e9)", "WN(" * 200, "{effect: scale_factor}",
    "[{effect: [1], sensor: {}}]", "[{effect: scale_factor, sensor: gyro, value: [[1]]}]",
    "[{effect: scale_factor, sensor: gyro, value: 1e308, axes: {x: 1}}]", "[{effect: scale_factor, sensor: gyro, value: 1, axes: [[x]]}]",
    "!!int abc", "!!float x", "!!bool ''", "!!timestamp x", "2013-13-45", "2013-01-01", "0x", "0b2", "1:99:99", "!!binary '###'",
    "!!set {a}", "!!python/name:os.system", "!foo bar", "&a [*a]", "*nowhere", '"\\ud800"', '"\\U00110000"', '"\\x1b[2J"', "../../up",
    "/etc/passwd", "[" * 200 + "]" * 200, "{a: " * 200 + "}" * 200, "? [a]\n: b", "{<<: 1}", "{<<: [{seed: 1}, 2]}", "{1: 2, null: 3}",
    "{design: [15AV]}", "{design: 15AV, options: []}", "{fit: {a: 1}}", "{fit: WN(), options: {a: [1]}}", "{truth: true, stabilise: 2}",
    "{simulate: 1e30 s}", "1e30 Hz", "10000000 h", "WN(N=1 deg/s/sqrt(Hz)) + " * 200 + "WN(N=1)", "{file: nowhere.yaml}", "{file: ..}",
)  # fmt: skip
NAMES = ("..", "../up", "/tmp/up", "a/b", "a\\b", "", " ", "x" * 300, "\u202e", "name\n", "CON:", "ok name 1")


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place of plain data."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(p for k, v in children for p in places(v, (*at, k)))]


class Raw(str):
    """YAML text that stands in a document as it is."""


def text_of(value: Any) -> str:
    """Flow YAML of plain data in which :class:`Raw` stands as written."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{text_of(k)}: {text_of(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(text_of, value)) + "]"
    return (
        yaml.safe_dump(value, default_style='"' if isinstance(value, str) else None, width=1e9)
        .strip()
        .removesuffix("\n...")
    )


DATA = {path.name: yamlfile.read(path).data for path in FILES}


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12)
PLAIN = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=5,
)


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A shipped scenario with one to three changes, as text."""
    document = copy.deepcopy(DATA[draw(st.sampled_from(sorted(DATA)))])
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.sampled_from(places(document)))
        if not at:
            continue
        parent = document
        for part in at[:-1]:
            parent = parent[part]
        kind = draw(st.sampled_from(("odd", "odd", "odd", "drop", "rename", "swap", "any")))
        if kind == "drop":
            del parent[at[-1]]
        elif kind == "rename" and isinstance(parent, dict):
            parent[draw(st.sampled_from(NAMES) | st.text(max_size=8))] = parent.pop(at[-1])
        elif kind == "swap":
            other = document
            for part in draw(st.sampled_from(places(document))):
                other = other[part]
            parent[at[-1]] = copy.deepcopy(other)
        elif kind == "any":
            parent[at[-1]] = draw(PLAIN)
        else:
            parent[at[-1]] = Raw(draw(st.sampled_from(ODD)))
    text = text_of(document)
    if draw(st.integers(0, 9)) == 0:  # the text itself
        k = draw(st.integers(0, len(text)))
        text = text[:k] + draw(st.text(max_size=3)) + text[k + draw(st.integers(0, 3)) :]
    return text


@settings(
    max_examples=EXAMPLES * len(FILES),
    deadline=None,
    suppress_health_check=list(HealthCheck),
    derandomize=EXAMPLES < 1000,
)
@given(mutated(), st.sampled_from([None, None, "drive_2", "reading_a"]))
def test_a_mutated_scenario_is_read_or_refused_in_words(
    tmp_path_factory: pytest.TempPathFactory, text: str, variant: str | None
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        scenario = load(path, variant=variant)
        json.dumps(scenario.model_dump(mode="json"))
        for design in scenario.designs.values():
            state_names(design, scenario)
    except InputError as error:
        str(error).encode()  # can be printed


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize(
    "place",
    ["seed: {}", "title: {}", "truth: {}", "truth: {{gyro: {}}}", "gnss: {{lever_arm: {}}}", "designs: {{a: {}}}"],
)
def test_odd_values_are_refused_in_words(tmp_path: Path, place: str, odd: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(place.format(odd), encoding="utf-8")
    with pytest.raises(InputError):
        load(path)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "ok name 1"])
@pytest.mark.parametrize("key", ["designs", "variants"])
def test_names_stay_inside_the_folder_of_results(tmp_path: Path, key: str, name: str) -> None:
    document = copy.deepcopy(DATA["table3_synthetic.yaml"])
    document[key][name] = document[key].pop(next(iter(document[key])))
    document["published"] = None
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError, match=r"found the name|half characters|control characters"):
        load(path)
