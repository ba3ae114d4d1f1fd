"""The key ``sensor`` of a truth or a design: the noise models of a sensor card, put in where the name stands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from insemu.errors import InputError, shown
from insemu.noise import axis_unit
from insemu.records import AXES
from insemu.sensors import models


def files_from(value: Any, folder: Path) -> Any:
    """Plain data in which every file under the key ``sensor`` is named from a folder; names of sensors and of axes stay."""
    if isinstance(value, list):
        return [files_from(item, folder) for item in value]
    if not isinstance(value, Mapping):
        return value
    out = {key: files_from(item, folder) for key, item in value.items()}
    name = out.get("sensor")
    if (
        isinstance(name, str)
        and Path(name).suffix
        and name.isprintable()
        and len(name) < 200
        and (folder / name).is_file()
    ):
        out["sensor"] = str(folder / name)
    return out


def with_sensors(value: Any) -> Any:
    """A truth or a design with the models of the sensors that it names, one list of processes per axis.

    Parameters
    ----------
    value : plain data
        ``{sensor: ADIS16470}`` names a sensor for all axes (``case: worst`` next to it takes its worst case), ``{gyro: {sensor: ADIS16470}}``
        for those of one triad. Axes that are given next to it win.

    Raises
    ------
    InputError
        No such sensor, an unknown case, or another key together with ``sensor`` in an axis.
    """
    if not isinstance(value, Mapping):
        return value
    out = {key: given for key, given in value.items() if key not in ("sensor", "case")}
    if value.get("sensor") is not None:
        given = {axis for axis in AXES if value.get(axis) is not None or value.get(axis.split("_")[0]) is not None}
        out |= {axis: model for axis, model in _models(value).items() if axis not in given}
    elif value.get("case") is not None:
        raise InputError("found 'case' without the key 'sensor' whose case it is")
    for key in ("gyro", "accel", *AXES):
        source = out.get(key)
        if isinstance(source, Mapping) and "sensor" in source:
            extra = set(source) - {"sensor", "case"}
            if extra:
                raise InputError(f"{key}: found '{min(extra)}' together with 'sensor', expected 'case' or nothing")
            del out[key]
            out = {axis: model for axis, model in _models(source).items() if axis.startswith(key)} | out
    return out


def _models(source: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    name, case = source["sensor"], source.get("case") or "typical"
    if not isinstance(name, str):
        raise InputError(f"found {shown(name)}, expected the name of a sensor (insemu sensor lists them)")
    return {axis: model.to_list(axis_unit(axis)) for axis, model in models(name, case).items()}
