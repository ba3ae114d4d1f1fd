"""Noise models per axis in YAML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from insemu import yamlfile
from insemu.errors import InputError
from insemu.noise import others
from insemu.noise.process import NoiseModel
from insemu.progress import say_once
from insemu.whole import put


def save(models: Mapping[str, NoiseModel], path: str | Path, signal_units: Mapping[str, str] | None = None) -> None:
    """Write models per axis as YAML that :func:`load` and a scenario read.

    Parameters
    ----------
    models : mapping
        Axis (``gyro_x`` ... ``accel_z`` or a column's name) to model.
    path : path
        File to write.
    signal_units : mapping, optional
        SI unit per axis; where it is absent, rad/s is taken for ``gyro_*``, m/s^2 for ``accel_*`` and none for others.
    """
    units_of = {axis: (signal_units or {}).get(axis, axis_unit(axis)) for axis in models}
    document = {
        "insemu_noise_models": 1,
        "axes": {a: {"unit": units_of[a], "model": m.to_list(units_of[a])} for a, m in models.items()},
    }
    put(path, yaml.safe_dump(document, sort_keys=False, allow_unicode=True))


def load(path: str | Path) -> dict[str, NoiseModel]:
    """Read what :func:`save` wrote, or the noise models of Kalibr or imu_utils (:mod:`insemu.noise.others`), which says what was taken.

    Raises
    ------
    InputError
        Not such a file, or a model that cannot be read; names the file and the axis.
    """
    document = yamlfile.read(path).data
    if isinstance(document, dict) and others.kind_of(document):
        models, said = others.read_others(document, str(path))
        say_once(f"{path}: {said}")
        return models
    if not isinstance(document, dict) or not isinstance(document.get("axes"), dict):
        raise InputError("expected a noise-model file with the key 'axes'", where=str(path))
    out = {}
    for axis, entry in document["axes"].items():
        try:
            if not isinstance(entry, dict) or "model" not in entry:
                raise InputError("expected the keys 'unit' and 'model'")
            out[str(axis)] = NoiseModel.from_list(entry["model"], str(entry.get("unit", axis_unit(str(axis)))))
        except InputError as error:
            raise InputError(str(error), where=f"{path}: axes.{axis}") from None
    return out


def axis_unit(axis: str) -> str:
    """SI unit of an axis by its name: rad/s for gyroscopes, m/s^2 for accelerometers, none for others."""
    if axis.startswith("gyro") or axis in ("gx", "gy", "gz"):
        return "rad/s"
    if axis.startswith("accel") or axis in ("ax", "ay", "az"):
        return "m/s^2"
    return ""
