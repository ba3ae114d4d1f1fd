"""Scenarios with values, keys and names that do not belong there; the same generator serves hypothesis, which makes a failure small."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from insemu import yamlfile
from insemu.scenario import load, state_names

FOLDER = Path(__file__).resolve().parents[2] / "scenarios"
FILES = sorted(FOLDER.glob("*.yaml"))

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
    if isinstance(value, float):
        return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(repr(value), repr(value))
    return json.dumps(value)


SCALE = ("0", "-1", "1e-9", "1e-3", "0.1", "3", "1e3", "1e9", "1e308", "7.3")


def scaled(value: Any, rng: random.Random) -> Any:
    """A number, or the number in front of a unit, times another."""
    factor = float(rng.choice(SCALE))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return type(value)(max(-1e15, min(1e15, value * factor)))
    number, _, unit = str(value).partition(" ")
    try:
        return f"{float(number) * factor:g} {unit}"
    except ValueError:
        return value


@cache
def documents() -> tuple[Any, ...]:
    """The shipped scenarios as plain data, whole and without what takes long to read."""
    whole = [yamlfile.read(path).data for path in FILES]
    small = []
    for document in whole:
        kept = {k: v for k, v in document.items() if k not in ("variants", "published", "notes", "question", "smoke")}
        kept["designs"] = dict(list(document["designs"].items())[-2:])
        small.append(kept)
    return (*whole, *small * 4)


def anything(rng: random.Random, depth: int = 0) -> Any:
    """Plain data of any kind."""
    kind = rng.randrange(8 if depth < 3 else 6)
    if kind < 2:
        return rng.choice((None, True, False, 0, -1, 3, 10**9, 2**53, 0.5, -1e-300, 1e308, float("nan"), float("inf")))
    if kind < 4:
        return "".join(rng.choice("ab:{}[]#&*!|>'\"%@ \t\n-?,\u00e9\u202e0.e") for _ in range(rng.randrange(12)))
    if kind < 6:
        return Raw(rng.choice(ODD))
    if kind == 6:
        return [anything(rng, depth + 1) for _ in range(rng.randrange(4))]
    names = ("gyro", "accel", "fit", "process", "effect", "start", "axes", "x", "file", "", "sensor", "truth", "1")
    return {rng.choice(names): anything(rng, depth + 1) for _ in range(rng.randrange(4))}


def mutated(rng: random.Random) -> str:
    """A shipped scenario with one to three changes, as text."""
    document = copy.deepcopy(rng.choice(documents()))
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.choice(places(document))
        if not at:
            continue
        parent = document
        for part in at[:-1]:
            parent = parent[part]
        kind = rng.choice(("odd", "odd", "odd", "drop", "rename", "swap", "any", "scale", "scale", "scale", "scale"))
        if kind == "drop":
            del parent[at[-1]]
        elif kind == "rename" and isinstance(parent, dict):
            parent[rng.choice((*NAMES, "outages", "gyro", "models", "x", "0"))] = parent.pop(at[-1])
        elif kind == "swap":
            other = document
            for part in rng.choice(places(document)):
                other = other[part]
            parent[at[-1]] = copy.deepcopy(other)
        elif kind == "scale":
            parent[at[-1]] = scaled(parent[at[-1]], rng)
        elif kind == "any":
            parent[at[-1]] = anything(rng)
        else:
            parent[at[-1]] = Raw(rng.choice(ODD))
    text = text_of(document)
    if rng.randrange(10) == 0:  # the text itself
        k = rng.randint(0, len(text))
        text = (
            text[:k]
            + rng.choice(("", "{", "]", ": ", "\t", "\x00", "&a ", "*a", "\ud800"))
            + text[k + rng.randrange(4) :]
        )
    return text


def check(text: str, variant: str | None, path: Path) -> None:
    """Load a scenario and use what belongs to the file alone."""
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    scenario = load(path, variant=variant)
    json.dumps(scenario.model_dump(mode="json"))
    for design in scenario.designs.values():
        state_names(design, scenario)


def prepare(what: str, folder: Path) -> Callable[[random.Random], None]:
    """A function that tries one scenario."""
    path = folder / "mutated.yaml"
    documents()
    for file in FILES:
        load(file)
    return lambda rng: check(mutated(rng), rng.choice((None, None, "drive_2", "reading_a")), path)
