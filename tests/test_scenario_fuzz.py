"""Mutated scenarios: whatever a file holds, ``load`` gives a scenario or one readable message, never a traceback.

``INSEMU_FUZZ=20000`` (environment) sets how many mutations of every shipped scenario are tried; a handful otherwise.
"""

from __future__ import annotations

import copy
import os
import random
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from insemu import yamlfile
from insemu.errors import InputError
from insemu.scenario import load
from tests.fuzz.scenarios import FILES, FOLDER, NAMES, ODD, check, mutated

EXAMPLES = int(os.environ.get("INSEMU_FUZZ", "20"))


@settings(
    max_examples=EXAMPLES * len(FILES),
    suppress_health_check=list(HealthCheck),
    derandomize=EXAMPLES < 1000,
)
@given(st.randoms(use_true_random=False), st.sampled_from([None, None, "drive_2", "reading_a"]))
def test_a_mutated_scenario_is_read_or_refused_in_words(
    tmp_path_factory: pytest.TempPathFactory, rng: random.Random, variant: str | None
) -> None:
    try:
        check(mutated(rng), variant, tmp_path_factory.getbasetemp() / "mutated.yaml")
    except InputError as error:
        str(error).encode()  # can be printed


@pytest.mark.parametrize(
    "place",
    ["seed: {}", "title: {}", "truth: {}", "truth: {{gyro: {}}}", "gnss: {{lever_arm: {}}}", "designs: {{a: {}}}"],
)
def test_odd_values_are_refused_in_words(tmp_path: Path, place: str) -> None:
    path = tmp_path / "s.yaml"
    for odd in ODD:
        path.write_text(place.format(odd), encoding="utf-8")
        with pytest.raises(InputError):
            print(f"read without a word: {place.format(odd)}")  # pytest shows it where nothing is raised
            load(path)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "ok name 1"])
@pytest.mark.parametrize("key", ["designs", "variants"])
def test_names_stay_inside_the_folder_of_results(tmp_path: Path, key: str, name: str) -> None:
    document = copy.deepcopy(yamlfile.read(FOLDER / "table3_synthetic.yaml").data)
    document[key][name] = document[key].pop(next(iter(document[key])))
    document["published"] = None
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError, match=r"found the name|half characters|control characters"):
        load(path)
