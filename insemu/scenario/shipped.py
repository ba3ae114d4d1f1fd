"""The scenarios that come with the package: found together with a checkout and inside an installed package."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import insemu
from insemu import yamlfile
from insemu.errors import InputError, nearest

_PACKAGE = Path(insemu.__file__).parent
#: Where an installed package has them, and where a checkout has them (pyproject.toml puts the second into the first).
_FOLDERS = (_PACKAGE / "scenarios", _PACKAGE.parent / "scenarios")
_SHARED = "shared:"


@dataclass(frozen=True)
class Shipped:
    """A scenario that comes with insemu.

    Parameters
    ----------
    path : Path
        Its file.
    question : str
        What it answers.
    files : tuple of str
        Files that it names, relative to its folder.
    shared : bool
        Whether it needs the shared data folder.
    """

    path: Path
    question: str
    files: tuple[str, ...]
    shared: bool


@cache
def shipped_scenarios() -> dict[str, Shipped]:
    """Every scenario that comes with insemu, by name."""
    folder = next((f for f in _FOLDERS if f.is_dir()), None)
    if folder is None:
        return {}
    out = {}
    for path in sorted(folder.glob("*.yaml")):
        data = yamlfile.read(path).data
        texts = list(_texts(data))
        named = tuple(dict.fromkeys(t for t in texts if "\n" not in t and t != path.name and (folder / t).is_file()))
        question = " ".join(str(data.get("question", data.get("title", ""))).split())
        out[path.stem] = Shipped(path, question, named, any(t.startswith(_SHARED) for t in texts))
    return out


def _texts(value: Any) -> Iterator[str]:
    """Every text in plain data."""
    if isinstance(value, str):
        yield value[:1000]
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _texts(item)


def shipped_scenario(name: str) -> Shipped:
    """A scenario that comes with insemu; raises ``InputError`` where there is none of that name."""
    known = shipped_scenarios()
    if name not in known:
        raise InputError(f"no scenario '{name}' comes with insemu" + nearest(name, known))
    return known[name]


def located(path: str | Path) -> Path:
    """The scenario file that is meant: the path itself, or, where no such file exists, the shipped scenario of that name."""
    given = Path(path)
    if given.exists() or given.suffix or len(given.parts) != 1:
        return given
    known = shipped_scenarios()
    if str(path) not in known and known:
        hint = nearest(str(path), known)
        raise InputError(f"no such file, and no scenario of this name comes with insemu{hint}", where=str(path))
    return known[str(path)].path if known else given
