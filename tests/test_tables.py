"""Numbers that users rely on without writing them: defaults and limits of the scenario, typical sizes of the effects, constants and
defaults of the rooms below.

``python -m tests.test_tables`` writes ``tests/tables.yaml`` anew; a changed line there changes somebody's results and belongs into the changelog.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import insemu
from insemu.effects import EFFECTS
from insemu.scenario.schema import Scenario

TABLES = Path(__file__).with_name("tables.yaml")
#: What the schema says of a key that changes what a scenario means.
_SAID = (
    "default",
    "exclusiveMinimum",
    "exclusiveMaximum",
    "minimum",
    "maximum",
    "minItems",
    "maxItems",
    "maxLength",
    "enum",
    "const",
)


#: Rooms whose constants are kept.
ROOMS = ("augment.py", "units.py", "records.py", "noise", "variance", "effects", "scenario", "formats")


def _numbers(value: Any) -> Any:
    """A constant as plain data, of ten digits; ``None`` where it has no numbers."""
    if isinstance(value, np.ndarray):
        return _numbers(value.tolist())
    if isinstance(value, Mapping):
        found = {str(key): _numbers(part) for key, part in value.items()}
        return found if found and all(part is not None for part in found.values()) else None
    if isinstance(value, tuple | list):
        found = [part if isinstance(part, str) else _numbers(part) for part in value]
        return found if any(not isinstance(part, str | None) for part in found) and None not in found else None
    if isinstance(value, bool | int):
        return value
    return float(f"{value:.10g}") if isinstance(value, float) else None


def _assigned(tree: ast.Module) -> Iterator[str]:
    """Names in capitals that a module gives a value at its head."""
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id.strip("_").isupper():
                    yield name.id


def _modules() -> Iterator[tuple[str, Path]]:
    """Modules of :data:`ROOMS` with their files."""
    package = Path(insemu.__file__).parent
    for room in ROOMS:
        for path in sorted([package / room] if room.endswith(".py") else (package / room).rglob("*.py")):
            yield ".".join(("insemu", *path.relative_to(package).with_suffix("").parts)).removesuffix(".__init__"), path


def constants() -> dict[str, dict[str, Any]]:
    """Named numbers of the modules of :data:`ROOMS`."""
    found = {}
    for name, path in _modules():
        module = importlib.import_module(name)
        own = {n: _numbers(getattr(module, n, None)) for n in _assigned(ast.parse(path.read_text(encoding="utf-8")))}
        if own := {n: value for n, value in own.items() if value is not None}:
            found[name] = own
    return found


def _defaults(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """What functions take and fields of classes are where nothing is said; ``None`` where that is no literal."""
    for part in ast.iter_child_nodes(node):
        given: list[tuple[str, ast.expr | None]] = []
        if isinstance(part, ast.FunctionDef):
            a = part.args
            late = (a.posonlyargs + a.args)[len(a.posonlyargs + a.args) - len(a.defaults) :]
            pairs = [*zip(late, a.defaults, strict=True), *zip(a.kwonlyargs, a.kw_defaults, strict=True)]
            given = [(f"{part.name}({arg.arg})", value) for arg, value in pairs]
        elif isinstance(part, ast.ClassDef):
            yield from _defaults(part, f"{prefix}{part.name}.")
        elif prefix and isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            given = [(part.target.id, part.value)]
        for name, value in given:
            try:
                yield prefix + name, _numbers(ast.literal_eval(value)) if value is not None else None
            except ValueError:
                yield prefix + name, None


def defaults() -> dict[str, dict[str, str]]:
    """Defaults of the functions and classes of :data:`ROOMS` that are numbers or switches."""
    found = {}
    for name, path in _modules():
        said = _defaults(ast.parse(path.read_text(encoding="utf-8")))
        if own := {place: value for place, value in said if value is not None}:
            found[name] = own
    return found


def _limits(found: Any) -> Any:
    """The words of :data:`_SAID` of a piece of the schema, and of what it is made of."""
    if isinstance(found, list):
        return [part for part in map(_limits, found) if part]
    if not isinstance(found, dict):
        return None
    out = {word: found[word] for word in _SAID if word in found}
    out |= {
        word: _limits(found[word]) for word in ("anyOf", "items", "additionalProperties") if _limits(found.get(word))
    }
    return out


def tables() -> dict[str, Any]:
    """Everything, as plain data."""
    schema = Scenario.model_json_schema()
    sections = {"Scenario": schema, **schema["$defs"]}
    return {
        "scenario": {
            section: {key: _limits(value) for key, value in sections[section].get("properties", {}).items()}
            for section in sorted(sections)
        },
        "effects": {
            effect.id: {
                "stage": int(effect.stage),
                "sensors": list(effect.sensors),
                **{
                    p.name: {
                        "unit": p.unit, "size": p.size, "scale": [float(f"{v:.12g}") for v in p.scale], "default": p.default,
                        "positive": p.positive, "join": p.join, "nothing": p.nothing, "most": p.most,
                    }
                    for p in effect.parameters
                },
            }
            for effect in EFFECTS.values()
        },
        "constants": constants(),
        "defaults": defaults(),
    }  # fmt: skip


def _compared(found: Any, held: Any, where: str) -> list[str]:
    if isinstance(found, dict) and isinstance(held, dict):
        return [
            line
            for key in sorted({*found, *held})
            for line in _compared(found.get(key), held.get(key), f"{where}.{key}")
        ]
    return [] if found == held else [f"{where[1:]}: {found}, {TABLES.name} has {held}"]


def test_no_default_limit_or_typical_size_changes_unnoticed() -> None:
    assert not _compared(tables(), yaml.safe_load(TABLES.read_text(encoding="utf-8")), "")


if __name__ == "__main__":
    TABLES.write_text(yaml.safe_dump(tables(), sort_keys=False, width=150, default_flow_style=None), encoding="utf-8")
