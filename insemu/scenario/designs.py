"""The filter designs that come with the package, by name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from insemu import yamlfile
from insemu.errors import InputError, nearest, shown
from insemu.records import AXES
from insemu.scenario.sensor_keys import with_sensors


@cache
def shipped_designs() -> dict[str, dict[str, Any]]:
    """Every design of ``designs.yaml``, as a scenario would write it, with the key ``about``."""
    held = yamlfile.read(Path(__file__).parent / "designs.yaml").data
    return {name: dict(design) for name, design in held.items()}


def shipped(name: str) -> dict[str, Any]:
    """One of them, without ``about``.

    Raises
    ------
    InputError
        No such design.
    """
    known = shipped_designs()
    if name not in known:
        raise InputError(f"no design '{name}' comes with insemu" + nearest(str(name), known))
    return {key: value for key, value in known[name].items() if key != "about"}


def spell_out(value: Any) -> Any:
    """A design as written in a scenario, with the keys of the design that it names put in: its own keys win.

    A text is the name of a design, and the models of sensors that it names are put in. A sensor's short form (``gyro``) replaces all three
    axes, and options are merged key by key.
    """
    value = with_sensors({"design": value} if isinstance(value, str) else value)
    if not isinstance(value, Mapping) or value.get("design") is None:
        return value
    if not isinstance(value["design"], str):
        raise InputError(f"found {shown(value['design'])}, expected the name of a design")
    own = {key: given for key, given in value.items() if given is not None}
    base = shipped(own["design"])
    for sensor in ("gyro", "accel"):
        if sensor in own:
            base = {key: given for key, given in base.items() if not (key in AXES and key.startswith(sensor))}
    options = own.get("options", {})
    if isinstance(options, Mapping):
        options = yamlfile.merged(base.get("options", {}), options)
    return base | own | {"options": options}
