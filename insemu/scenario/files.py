"""Reading scenario files: safe YAML with line numbers, variants, paths, digests and the JSON schema for editors."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

import insemu
from insemu.errors import InputError, nearest
from insemu.scenario.schema import Scenario

Place = tuple[str | int, ...]


def _places(node: yaml.Node, at: Place = ()) -> Iterator[tuple[Place, int]]:
    """Yield every key path and its line (from 1); duplicate keys raise."""
    yield at, node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            name = str(key.value)
            line = key.start_mark.line + 1
            if name in seen:
                raise InputError(
                    f"the key '{name}' stands twice, first at line {seen[name]}", where=f"{key.start_mark.name}:{line}"
                )
            seen[name] = line
            yield from _places(value, (*at, name))
            yield (*at, name), line
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _places(item, (*at, index))


def _read(path: Path) -> tuple[dict[str, Any], dict[Place, int]]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError("no such scenario file", where=str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", where=str(path)) from None
    try:
        loader = yaml.SafeLoader(text)
        loader.name = str(path)
        node = loader.get_single_node()
        if not isinstance(node, yaml.MappingNode):
            raise InputError("expected a mapping of keys such as title, trajectory, truth, designs", where=str(path))
        places = dict(_places(node))
        document = loader.construct_document(node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark is not None else str(path)
        raise InputError(f"not YAML: {getattr(error, 'problem', error)}", where=where) from None
    return document, places


def load(path: str | Path, *, variant: str | None = None, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read and check a scenario file.

    Parameters
    ----------
    path : path
        YAML file.
    variant : str, optional
        Name under ``variants`` whose keys replace those of the file.
    overrides : mapping, optional
        Top-level keys from the command line, which win over the file (``{"seed": 7}``).

    Raises
    ------
    InputError
        Names file, line and key, what was found and what was expected; for an unknown key the nearest valid one.
    """
    path = Path(path)
    document, places = _read(path)
    if variant is not None:
        variants = document.get("variants") or {}
        if not isinstance(variants, dict) or variant not in variants:
            raise InputError(f"no variant '{variant}'" + nearest(variant, variants), where=str(path))
        changes = variants[variant]
        document = _merge(document, changes if isinstance(changes, dict) else {})
        places |= {
            place[2:]: line for place, line in places.items() if place[:2] == ("variants", variant) and len(place) > 2
        }
    if overrides:
        document = document | {k: v for k, v in overrides.items() if v is not None}
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        raise _named(error, path, places) from None


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(base)
    for key, value in changes.items():
        # whole sections merge; designs and models are replaced as they stand
        merged = isinstance(value, Mapping) and isinstance(out.get(key), Mapping) and "process" not in value
        out[key] = _merge(out[key], value) if merged else value
    return out


def variant_names(scenario: Scenario) -> list[str]:
    """Names of the scenario's variants, in the order of the file."""
    return list(scenario.variants)


def _fields_at(place: Place) -> list[str]:
    """Valid keys of the section at a place, for the hint."""
    model: Any = Scenario
    for part in place:
        if not (isinstance(model, type) and issubclass(model, BaseModel)) or part not in model.model_fields:
            model = _inside(model)
            continue
        annotation = model.model_fields[str(part)].annotation
        model = annotation
    model = _inside(model) if not (isinstance(model, type) and issubclass(model, BaseModel)) else model
    return list(model.model_fields) if isinstance(model, type) and issubclass(model, BaseModel) else []


def _inside(annotation: Any) -> Any:
    """The first section class within an annotation such as ``dict[str, Design]`` or ``Gnss | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _inside(argument)
        if found is not None:
            return found
    return None


def _named(error: ValidationError, path: Path, places: Mapping[Place, int]) -> InputError:
    """The first problem as one message with file, line and key."""
    # a misspelled key also makes a required one missing; the misspelling is the cause
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place: Place = tuple(
        part for part in first["loc"] if not (isinstance(part, str) and ("[" in part or part in _UNION_TAGS))
    )
    known = place
    while known and known not in places:
        known = known[:-1]
    line = places.get(known, 1)
    key = ".".join(str(part) for part in place) or "(top)"
    where = f"{path}:{line}: {key}"
    if first["type"] == "extra_forbidden":
        return InputError(f"unknown key '{place[-1]}'" + nearest(str(place[-1]), _fields_at(place[:-1])), where=where)
    if first["type"] == "missing":
        return InputError(
            f"the key '{place[-1]}' is missing",
            where=f"{path}:{line}: {'.'.join(str(p) for p in place[:-1]) or '(top)'}",
        )
    if first["type"] == "value_error":
        return InputError(str(first["ctx"]["error"]), where=where)
    return InputError(f"found {first['input']!r}, {first['msg'][:1].lower()}{first['msg'][1:]}", where=where)


_UNION_TAGS = frozenset({"AxisSource", "str", "Signal", "list"})


def resolve_path(text: str, scenario_file: str | Path | None = None) -> Path:
    """The file that a scenario names: ``shared:PATH`` under the shared data folder, else relative to the scenario's folder.

    The shared folder is the environment variable ``INSEMU_SHARED``, else ``../shared`` beside the project.

    Raises
    ------
    InputError
        No such file.
    """
    base = Path(scenario_file).resolve().parent if scenario_file is not None else Path.cwd()
    if text.startswith("shared:"):
        relative = text.removeprefix("shared:").lstrip("/")
        root = os.environ.get("INSEMU_SHARED")
        roots = [Path(root)] if root else [parent / "shared" for parent in (Path.cwd().parent, *list(base.parents)[:3])]
        for candidate in roots:
            if (candidate / relative).exists():
                return candidate / relative
        raise InputError(
            f"shared data absent: {relative} (set INSEMU_SHARED to the folder that holds it; looked in {roots[0]})"
        )
    path = base / text
    if not path.exists():
        raise InputError(f"{path}: no such file")
    return path


def code_version() -> str:
    """Hash of the package's own source: results of other code are never taken for results of this one."""
    root = Path(insemu.__file__).parent
    digest_ = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest_.update(str(file.relative_to(root)).encode())
        digest_.update(file.read_bytes())
    return digest_.hexdigest()


def digest(scenario: Scenario, files: Mapping[str, Path] | None = None) -> str:
    """Identity of an experiment: resolved scenario, contents of its input files and code version (sha256, 16 hex digits).

    The number of realizations, the text fields and the variants do not belong to it: realization 7 is the same among 10 or 1000.
    """
    content = scenario.model_dump(
        mode="json", exclude={"realizations", "title", "question", "notes", "variants", "smoke", "published"}
    )
    hashes = {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in sorted((files or {}).items())
        if path.is_file()
    }
    text = json.dumps([content, hashes, code_version()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def schema() -> dict[str, Any]:
    """JSON schema of scenario files, for editors."""
    return Scenario.model_json_schema() | {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "insemu scenario",
    }
