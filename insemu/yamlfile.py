"""YAML files as plain data: the one safe reader, with line numbers and stated limits, for every file that a user writes.

What comes out holds only ``dict`` with text keys, ``list``, ``str``, ``int``, ``float``, ``bool`` and ``None``, so no parser behind it meets
another type. Tags that would make anything else are refused; dates stay text.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from insemu.errors import InputError

#: Keys and indices that lead to a value.
Place = tuple[str | int, ...]

#: Largest file, bytes: a scenario has a few thousand.
MAX_BYTES = 4_000_000
#: Deepest nesting: a scenario has about ten levels.
MAX_DEPTH = 40
#: Most values, those that aliases repeat counted each time.
MAX_VALUES = 100_000
#: Largest whole number: every one up to it is a double and an int64.
MAX_INTEGER = 2**53

#: The parser in C, ten times as fast, which PyYAML has nearly everywhere.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_PREFIX = "tag:yaml.org,2002:"
_TEXT = frozenset({"str", "timestamp", "value"})


@dataclass(frozen=True)
class Document:
    """What a file holds.

    Parameters
    ----------
    name : str
        Of the file, for messages.
    data : plain data
    lines : mapping of Place to int
        Line of every key and item, from 1.
    """

    name: str
    data: Any
    lines: Mapping[Place, int]

    def where(self, place: Place = ()) -> str:
        """``file:line: key`` of a place; of what is not there the line of what it would stand in. An option has no lines: its name."""
        if not self.lines:
            return ": ".join([self.name, *([".".join(str(part) for part in place)] if place else [])])
        known = place
        while known and known not in self.lines:
            known = known[:-1]
        return f"{self.name}:{self.lines.get(known, 1)}: {'.'.join(str(part) for part in place) or '(top)'}"


def read(path: str | Path) -> Document:
    """Read a YAML file.

    Raises
    ------
    InputError
        No such file, no text, no YAML, a key that stands twice, a tag, or more than the limits of this module; names file and line.
    """
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        text = content.decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file", where=str(path)) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read as text ({error})", where=str(path)) from None
    if len(content) > MAX_BYTES:
        raise InputError(f"has more than {MAX_BYTES} bytes, which no file of this kind needs", where=str(path))
    return parse(text, str(path))


def parse(text: str, name: str) -> Document:
    """Read YAML text; ``name`` stands for the file in messages. Raises as :func:`read`."""
    reader = _Reader(name)
    if text.startswith("%YAML:"):  # OpenCV's own first line, which YAML does not know
        text = "#" + text
    try:
        _check_depth(text)
        node = _Loader(text).get_single_node()
        data = None if node is None else reader.value(node, ())
    except InputError:
        raise
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # escapes beyond Unicode are a ValueError
        mark = getattr(error, "problem_mark", None)
        where = f"{name}:{mark.line + 1}" if mark is not None else name
        raise InputError(f"not YAML: {getattr(error, 'problem', None) or error}", where=where) from None
    return Document(name, data, reader.lines)


def _check_depth(text: str) -> None:
    """Give up before the recursion of what composes nodes does."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {MAX_DEPTH} levels")


class _Reader:
    """Nodes of PyYAML's parser to plain data."""

    def __init__(self, name: str) -> None:
        self.name, self.lines, self.count = name, dict[Place, int](), 0
        self.scalars = yaml.constructor.SafeConstructor()

    def refuse(self, message: str, node: yaml.Node) -> InputError:
        return InputError(message, where=f"{self.name}:{node.start_mark.line + 1}")

    def value(self, node: yaml.Node, at: Place) -> Any:
        self.count += 1
        if len(at) > MAX_DEPTH or self.count > MAX_VALUES:
            raise self.refuse(f"nested deeper than {MAX_DEPTH} levels or more than {MAX_VALUES} values", node)
        self.lines.setdefault(at, node.start_mark.line + 1)
        kind = node.tag.removeprefix(_PREFIX)
        if isinstance(node, yaml.MappingNode) and kind == "map":
            return self.mapping(node, at)
        if isinstance(node, yaml.SequenceNode) and kind == "seq":
            return [self.value(item, (*at, index)) for index, item in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, kind)
        raise self.refuse(f"not YAML: found the tag '{node.tag}', expected plain values without tags", node)

    def scalar(self, node: yaml.ScalarNode, kind: str) -> Any:
        text = str(node.value)
        if kind in _TEXT:
            if any(unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t" for c in text):
                raise self.refuse(f"found control characters or half characters in {text!r}", node)
            return text
        try:
            if kind == "int":
                if len(text) > 40 or abs(number := self.scalars.construct_yaml_int(node)) > MAX_INTEGER:
                    raise self.refuse(f"found the whole number {text[:40]}, expected one up to 2^53", node)
                return int(number)
            if kind == "float":
                return float(self.scalars.construct_yaml_float(node))
            if kind == "bool":
                return bool(self.scalars.construct_yaml_bool(node))
        except (ValueError, OverflowError, KeyError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise self.refuse(f"not YAML: cannot read '{text[:40]}' as {kind}", node) from None
        if kind == "null":
            return None
        raise self.refuse(f"not YAML: found the tag '{node.tag}', expected plain values without tags", node)

    def mapping(self, node: yaml.MappingNode, at: Place) -> dict[str, Any]:
        out: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        seen: dict[str, int] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self.refuse("found a list or a mapping as a key, expected text", key)
            line = key.start_mark.line + 1
            if key.tag == _PREFIX + "merge":
                for part in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                    if not isinstance(part, yaml.MappingNode):
                        raise self.refuse("found '<<' without a mapping to take keys from", key)
                    merged = {**self.value(part, at), **merged}
                continue
            name = str(self.scalar(yaml.ScalarNode(_PREFIX + "str", key.value, key.start_mark), "str"))
            if name in seen:
                raise self.refuse(f"the key '{name}' stands twice, first at line {seen[name]}", key)
            seen[name] = line
            self.lines[(*at, name)] = line
            out[name] = self.value(value, (*at, name))
        return {**merged, **out}


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with changes: sections are merged key by key; lists, texts and processes are replaced as they stand."""
    out = dict(base)
    for key, value in changes.items():
        section = isinstance(value, Mapping) and isinstance(out.get(key), Mapping) and "process" not in value
        out[key] = merged(out[key], value) if section else value
    return out
