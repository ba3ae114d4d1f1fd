"""Sensor cards: one YAML file per sensor, every figure with its source."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from insemu import yamlfile
from insemu.errors import InputError, nearest
from insemu.records import AXES
from insemu.sensors.figures import KINDS, SIGNAL_UNITS, Figure, Figures, quantity, read_figures

_FOLDER = Path(__file__).parent / "cards"
_KEYS = ("name", "maker", "about", "also", "sources", "gyro", "accel", *AXES)
_SOURCE_KEYS = ("title", "revision", "url", "kind")


@dataclass(frozen=True)
class Card:
    """A sensor with its figures.

    Parameters
    ----------
    name, maker, about : str
        Of the sensor.
    figures : mapping
        Section (``gyro``, ``accel`` or an axis such as ``accel_z``, which wins) to kind to :class:`Figure`.
    sources : mapping
        Short name to ``title``, ``revision``, ``url`` and ``kind`` (datasheet, quoted datasheet, published model).
    also : tuple of str
        Other names of the sensor.
    """

    name: str
    figures: Figures
    maker: str = ""
    about: str = ""
    sources: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    also: tuple[str, ...] = ()

    def of_axis(self, axis: str) -> dict[str, Figure]:
        """Figures of an axis by kind."""
        return self.figures.get(axis.split("_")[0], {}) | self.figures.get(axis, {})


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


@cache
def _files() -> dict[str, Path]:
    """Name to file of every card that comes with insemu."""
    return {str(yamlfile.read(path).data["name"]): path for path in sorted(_FOLDER.glob("*.yaml"))}


def names() -> list[str]:
    """Names of the sensors that come with insemu, in order."""
    return list(_files())


@cache
def _shipped() -> dict[str, Card]:
    return {name: _read(yamlfile.read(path)) for name, path in _files().items()}


def card(name: str) -> Card:
    """The card of a sensor that comes with insemu, or of a file.

    Parameters
    ----------
    name : str
        Name of a sensor (``ADIS16470``; dashes and case do not matter), or a file: a card (``.yaml``), or a text with figures.

    Raises
    ------
    InputError
        No such sensor or file, or a file that is no card and holds no figure.
    """
    for found in _shipped().values():
        if _plain(name) in {_plain(n) for n in (found.name, *found.also)}:
            return found
    path = Path(name)
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return _read(yamlfile.read(path))
    if path.is_file():
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read as text ({error})", where=name) from None
        return Card(path.stem, read_figures(text, name), about=f"figures of the text {path.name}")
    raise InputError(f"no sensor '{name}' comes with insemu and no such file exists" + nearest(name, names()))


def of_text(text: str) -> Card:
    """A card from a text with figures, as :func:`insemu.sensors.read_figures` reads it."""
    return Card("text", read_figures(text), about="figures given as text")


def _read(document: yamlfile.Document) -> Card:
    """A card file, checked."""
    data = document.data
    if not isinstance(data, dict) or not isinstance(data.get("name"), str):
        raise InputError("expected a sensor card with the key 'name'", where=document.name)
    for key in data:
        if key not in _KEYS:
            raise InputError(f"unknown key '{key}'" + nearest(key, _KEYS), where=document.where((key,)))
    sources = _mapping(document, "sources")
    for label, source in sources.items():
        known = isinstance(source, dict) and "title" in source and not set(source) - set(_SOURCE_KEYS)
        if not known or not all(isinstance(text, str | int | float) for text in source.values()):
            expected = f"expected a source with the key 'title' (and {', '.join(_SOURCE_KEYS[1:])})"
            raise InputError(f"found {source!r}, {expected}", where=document.where(("sources", label)))
        sources[label] = {key: str(text) for key, text in source.items()}
    figures: Figures = {}
    for section in ("gyro", "accel", *AXES):
        for kind, given in _mapping(document, section).items():
            where = (section, kind)
            if kind not in KINDS:
                raise InputError(f"unknown figure '{kind}'" + nearest(kind, KINDS), where=document.where(where))
            for place, one in _by_axis(document, where, given):
                figures.setdefault(place, {})[kind] = _figure(document, where, one, sources)
    if not figures:
        raise InputError("holds no figure under 'gyro' or 'accel'", where=document.name)
    about, maker, also = data.get("about", ""), data.get("maker", ""), data.get("also") or []
    if not isinstance(also, list):
        raise InputError(f"found {also!r}, expected a list of names", where=document.where(("also",)))
    return Card(data["name"], figures, str(maker), " ".join(str(about).split()), sources, tuple(map(str, also)))


def _mapping(document: yamlfile.Document, key: str) -> dict[str, Any]:
    value = document.data.get(key)
    if value is not None and not isinstance(value, dict):
        raise InputError(f"found {value!r}, expected a mapping", where=document.where((key,)))
    return value or {}


def _by_axis(document: yamlfile.Document, at: tuple[str, str], given: Any) -> list[tuple[str, Any]]:
    """What a section gives for a kind: as it stands, or by axis where a quantity is a list (x, y, z)."""
    held = given if isinstance(given, dict) else {"typical": given}
    lists = [value for key, value in held.items() if key in ("typical", "max") and isinstance(value, list)]
    axes = [axis for axis in AXES if axis.startswith(f"{at[0]}_")]
    if not lists:
        return [(at[0], given)]
    if any(len(value) != len(axes) for value in lists):
        expected = "expected one quantity or, under 'gyro' and 'accel', three (x, y, z)"
        raise InputError(f"found {given!r}, {expected}", where=document.where(at))
    return [(a, {k: v[i] if isinstance(v, list) else v for k, v in held.items()}) for i, a in enumerate(axes)]


def _figure(document: yamlfile.Document, at: tuple[str, str], given: Any, sources: Mapping[str, Any]) -> Figure:
    """A figure: a quantity, or a mapping with ``typical`` or ``max``, and where it stands (``source``, ``place``)."""
    section, kind = at
    sensor = section.split("_")[0] if section.split("_")[0] in SIGNAL_UNITS else "gyro"
    held = given if isinstance(given, dict) else {"typical": given}
    unknown = set(held) - {"typical", "max", "source", "place"}
    if unknown or not ({"typical", "max"} & set(held)):
        raise InputError(
            f"found {given!r}, expected a quantity or the keys typical, max, source, place", where=document.where(at)
        )
    source = str(held.get("source", next(iter(sources), "")))
    if source and source not in sources:
        raise InputError(f"unknown source '{source}'" + nearest(source, sources), where=document.where(at))
    values = {
        key: quantity(held[key], kind, sensor, document.where((*at, key))) for key in ("typical", "max") if key in held
    }
    place = ", ".join(part for part in (source, str(held.get("place", ""))) if part)
    text = str(held["typical"]) if "typical" in held else f"at most {held['max']}"
    return Figure(values.get("typical", values.get("max", 0.0)), text, values.get("max"), place)
