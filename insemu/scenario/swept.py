"""A scenario with other values at some keys: the points of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from insemu.emulate import TRAJECTORIES
from insemu.errors import InputError, nearest
from insemu.records import AXES

#: Keys that stand for more than one place.
SHORT = ("sensor", "outage", "trajectory")
_MODELS = frozenset({"gyro", "accel", "file", "sensor", "case", *AXES})
_MOTIONS = ("builtin", "waypoints", "track", "motion")


def with_changes(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A scenario as plain data with other values.

    Parameters
    ----------
    data : plain data
    changes : mapping of key to value
        Keys of the schema parted by dots (``gnss.position_sigma``, ``gnss.outages.0.start``), or ``sensor`` (that of the truth), ``outage``
        (the duration of every outage) and ``trajectory`` (a built-in one, or a file of the kind that the scenario has).

    Raises
    ------
    InputError
        A key that leads nowhere.
    """
    out = dict(data)
    for key, value in changes.items():
        if key == "sensor":
            truth = out.get("truth") if isinstance(out.get("truth"), Mapping) else {}
            out["truth"] = {k: v for k, v in dict(truth or {}).items() if k not in _MODELS} | {"sensor": value}
        elif key == "outage":
            out["gnss"] = _outages(out.get("gnss"), value)
        elif key == "trajectory":
            out["trajectory"] = _motion(out.get("trajectory"), value)
        else:
            out = _at(out, key.split("."), value, key)
    return out


def _outages(gnss: Any, duration: Any) -> dict[str, Any]:
    outages = gnss.get("outages") if isinstance(gnss, Mapping) else None
    if not outages or not all(isinstance(o, Mapping) for o in outages):
        raise InputError("the scenario has no list of outages whose duration could be another", where="outage")
    return {**gnss, "outages": [{**o, "duration": duration} for o in outages]}


def _motion(given: Any, value: Any) -> dict[str, Any]:
    given = dict(given) if isinstance(given, Mapping) else {}
    rest = {k: v for k, v in given.items() if k not in _MOTIONS}
    if isinstance(value, Mapping):
        return rest | dict(value)
    files = [k for k in _MOTIONS[1:] if k in given]
    if isinstance(value, str) and Path(value).suffix and files:
        return rest | {files[0]: value}
    if value not in TRAJECTORIES:
        raise InputError(f"unknown trajectory '{value}'" + nearest(str(value), TRAJECTORIES), where="trajectory")
    return rest | {"builtin": value}


def _at(data: Any, parts: list[str], value: Any, key: str) -> Any:
    """Plain data with a value at a place; sections that are not there are made."""
    first, *rest = parts
    if isinstance(data, list):
        if not first.isdecimal() or int(first) >= len(data):
            raise InputError(f"found '{first}', expected a number from 0 to {len(data) - 1}", where=key)
        return [
            _at(v, rest, value, key) if rest and k == int(first) else value if k == int(first) else v
            for k, v in enumerate(data)
        ]
    if data is not None and not isinstance(data, Mapping):
        raise InputError(f"'{first}' leads into {data!r}, which has no keys", where=key)
    section = dict(data or {})
    section[first] = _at(section.get(first), rest, value, key) if rest else value
    return section
