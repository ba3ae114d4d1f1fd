"""Reading scenario files: messages with line numbers, variants, paths, digests and the JSON schema for editors."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

import insemu
from insemu import noise, yamlfile
from insemu.errors import InputError, nearest, shown
from insemu.formats import read_recording, seconds_of_date, utc_of
from insemu.records import AXES
from insemu.scenario.fields import Made
from insemu.scenario.schema import Scenario
from insemu.scenario.sensor_keys import files_from
from insemu.scenario.shipped import located
from insemu.scenario.swept import with_changes
from insemu.yamlfile import Place

S = TypeVar("S", bound=BaseModel)


def load(
    path: str | Path,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Scenario:
    """Read and check a scenario file.

    Parameters
    ----------
    path : path
        YAML file, or the name of a scenario that comes with insemu.
    variant : str, optional
        Name under ``variants`` whose keys replace those of the file.
    overrides : mapping, optional
        Top-level keys from the command line, which win over the file (``{"seed": 7}``).
    changes : mapping, optional
        Keys anywhere in the file, as :func:`~insemu.scenario.swept.with_changes` reads them.

    Raises
    ------
    InputError
        Names file, line and key, what was found and what was expected; for an unknown key the nearest valid one.
    """
    document = yamlfile.read(located(path))
    if not isinstance(document.data, dict):
        expected = "expected a mapping of keys such as title, trajectory, truth, designs"
        raise InputError(f"found {type(document.data).__name__}, {expected}", where=str(path))
    data, lines = files_from(with_changes(document.data, changes or {}), located(path).parent), dict(document.lines)
    if variant is not None:
        variants = data.get("variants")
        if not isinstance(variants, dict) or variant not in variants:
            names = variants if isinstance(variants, dict) else ()
            raise InputError(f"no variant '{variant}'" + nearest(variant, names), where=str(path))
        changes = variants[variant]
        data = yamlfile.merged(data, changes if isinstance(changes, dict) else {})
        lines |= {at[2:]: line for at, line in lines.items() if at[:2] == ("variants", variant) and len(at) > 2}
    data = data | {k: v for k, v in (overrides or {}).items() if v is not None}
    document = yamlfile.Document(document.name, data, lines)
    scenario = validated(Scenario, _in_seconds(document, path))
    return _with_file(scenario, path)


#: How a date begins among quantities such as "300 s".
_DATE = re.compile(r"\s*\d{4}-\d\d?-\d\d?([T ]|$)")


def _in_seconds(document: yamlfile.Document, path: str | Path) -> yamlfile.Document:
    """The same with times of a recording that are given as dates in s from its start.

    Raises
    ------
    InputError
        What is no date; a flight that has none: an emulated one, or a recording whose clock tells no date.
    """
    gnss, source = (v if isinstance(v, dict) else {} for v in map(document.data.get, ("gnss", "recording")))
    outages = gnss.get("outages")
    spans = [v if isinstance(v, dict) else {} for v in outages] if isinstance(outages, list) else []
    places: list[tuple[Place, Any]] = [(("gnss", "outages", k, "start"), v.get("start")) for k, v in enumerate(spans)]
    places += [(("recording", key), source.get(key)) for key in ("start", "end")]
    dates = {place: text for place, text in places if isinstance(text, str) and _DATE.match(text)}
    if not dates:
        return document
    first, zero = document.where(next(iter(dates))), None
    if isinstance(source.get("file"), str):
        zero = utc_of(read_recording(resolve_path(source["file"], path)).origin)
    if zero is None:
        reason = "its clock tells no date" if source else "an emulated flight has none"
        raise InputError(f"is a date, expected seconds from the start of the recording: {reason}", where=first)
    data = copy.deepcopy(document.data)
    for place, text in dates.items():
        *inside, key = place
        held: Any = data
        for part in inside:
            held = held[part]
        held[key] = seconds_of_date(text, document.where(place)) - zero
    return yamlfile.Document(document.name, data, document.lines)


def _with_file(scenario: Scenario, path: str | Path) -> Scenario:
    """The scenario with the models of the truth's file read in."""
    truth = scenario.truth
    if truth is None or truth.file is None:
        return scenario
    models = noise.load(resolve_path(truth.file, path)) | truth.models()
    missing = [axis for axis in AXES if axis not in models]
    if missing:
        raise InputError(f"no model for {', '.join(missing)}; it has {', '.join(models)}", where=truth.file)
    return scenario.model_copy(update={"truth": truth.model_copy(update={axis: models[axis] for axis in AXES})})


def validated(section: type[S], document: yamlfile.Document) -> S:
    """A document as a section of a scenario (or the whole of it).

    Parameters
    ----------
    section : type of Section
    document : yamlfile.Document

    Raises
    ------
    InputError
        Names file, line and key, what was found and what was expected; for an unknown key the nearest valid one.
    """
    try:
        return section.model_validate(document.data)
    except ValidationError as error:
        raise _with_place(error, section, document) from None


def _keys_at(place: Place, section: Any) -> list[str]:
    """Valid keys of the section at a place, for the hint."""
    for part in place:
        fields = {} if section is None else {f.alias or name: f for name, f in section.model_fields.items()}
        if part in fields:
            section = _inside(fields[part].annotation, fields[part].metadata)
    return [] if section is None else [field.alias or name for name, field in section.model_fields.items()]


def _inside(annotation: Any, metadata: Iterable[Any] = ()) -> Any:
    """The first section class within an annotation such as ``dict[str, Design]`` or ``Gnss | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for known in (*metadata, *getattr(annotation, "__metadata__", ())):
        if isinstance(known, Made):
            return known.keys
    inner = (_inside(argument) for argument in getattr(annotation, "__args__", ()))
    return next((section for section in inner if section is not None), None)


def _with_place(error: ValidationError, section: type[BaseModel], document: yamlfile.Document) -> InputError:
    """The first problem as one message with file, line and key."""
    # a misspelled key also makes a required one missing; the misspelling is the cause
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place: Place = ()
    for part in first["loc"]:
        # pydantic names the member of a union, which stands in no file
        tag = isinstance(part, str) and ("[" in part or part in _UNION_TAGS) and (*place, part) not in document.lines
        place = place if tag else (*place, part)
    where = document.where(place)
    if first["type"] == "extra_forbidden":
        name = str(first["loc"][-1])
        return InputError(f"unknown key '{name}'" + nearest(name, _keys_at(place[:-1], section)), where=where)
    if first["type"] == "missing":
        # the line of the section that lacks it
        return InputError(f"the key '{first['loc'][-1]}' is missing", where=document.where(place[:-1]))
    if first["type"] == "value_error":
        return InputError(str(first["ctx"]["error"]), where=where)
    return InputError(f"found {shown(first['input'])}, {first['msg'][:1].lower()}{first['msg'][1:]}", where=where)


_UNION_TAGS = frozenset({"AxisSource", "str", "Signal", "list"})


def resolve_path(text: str, scenario_file: str | Path | None = None) -> Path:
    """The file that a scenario names: ``shared:PATH`` under the shared data folder, else relative to the scenario's folder.

    The shared folder is the environment variable ``INSEMU_SHARED``, else ``../shared`` next to the project.

    Raises
    ------
    InputError
        No such file.
    """
    base = located(scenario_file).resolve().parent if scenario_file is not None else Path.cwd()
    if text.startswith("shared:"):
        relative = text.removeprefix("shared:").lstrip("/")
        root = os.environ.get("INSEMU_SHARED")
        roots = [Path(root)] if root else [parent / "shared" for parent in (Path.cwd().parent, *list(base.parents)[:3])]
        for candidate in roots:
            if _exists(candidate / relative):
                return candidate / relative
        raise InputError(
            f"shared data absent: {relative} (set INSEMU_SHARED to the folder that holds it; looked in {roots[0]})"
        )
    path = base / text
    if not _exists(path):
        raise InputError(f"{path}: no such file")
    return path


def _exists(path: Path) -> bool:
    """Whether there is such a file; raises ``InputError`` for a name that no file can have."""
    try:
        return path.exists()
    except OSError as error:
        raise InputError(f"{error.strerror}: {path.name[:80]}...") from None


@cache
def code_version() -> str:
    """Hash of the package's own source and data: results of other code are never taken for results of this one."""
    root = Path(insemu.__file__).parent
    digest_ = hashlib.sha256()
    for file in sorted(f for kind in ("py", "yaml", "rnx") for f in root.rglob(f"*.{kind}")):
        digest_.update(str(file.relative_to(root)).encode())
        digest_.update(file.read_bytes())
    return digest_.hexdigest()


def digest(scenario: Scenario, files: Mapping[str, Path] | None = None) -> str:
    """Identity of an experiment: resolved scenario, contents of its input files and code version (sha256, 16 hex digits).

    The number of realizations, the text fields and the variants do not belong to it: realization 7 is the same among 10 or 1000.

    Parameters
    ----------
    scenario : Scenario
    files : mapping of str to path, optional
        Input files.
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
