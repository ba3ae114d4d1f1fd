"""Noise models in the files of other programs: Kalibr, and imu_utils of HKUST.

Kalibr's numbers are densities (wiki of Kalibr, "IMU noise model"). imu_utils writes what it calls white noise with the unit of the signal, per
sample, and as ``_w`` the smallest value of the Allan deviation (its README, "bias instability is around the minimum"); which of the two
the first is was asked there and not answered (its issue 36), so that a file without ``update_rate`` is refused. Where the unit is that of a
density, no rate is needed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from insemu.errors import InputError, shown
from insemu.noise.process import PROCESSES, NoiseModel

#: Allan deviation of flicker of bias instability 1.
_FLAT = math.sqrt(2.0 * math.log(2.0) / math.pi)
_KALIBR = {"gyro": "gyroscope", "accel": "accelerometer"}
_UTILS = {"gyro": ("Gyr", "gyr"), "accel": ("Acc", "acc")}


def kind_of(document: object) -> str:
    """Kalibr or imu_utils; an empty text for anything else."""
    if not isinstance(document, Mapping):
        return ""
    if any(f"{name}_noise_density" in part for part in _parts(document) for name in _KALIBR.values()):
        return "Kalibr"
    return "imu_utils" if any(isinstance(document.get(group), Mapping) for group, _ in _UTILS.values()) else ""


def read_others(document: Mapping[str, Any], where: str) -> tuple[dict[str, NoiseModel], str]:
    """Models per axis of a file of another program, and what was taken for what, in words.

    Parameters
    ----------
    document : mapping
        What :func:`kind_of` knows.
    where : str
        File, for messages.

    Returns
    -------
    dict of axis to NoiseModel, str
        The three axes of a sensor have one model.

    Raises
    ------
    InputError
        A number that is missing or none; imu_utils without ``update_rate`` (Hz).
    """
    if kind_of(document) == "Kalibr":
        models = {}
        for part in _parts(document):
            for sensor, name in _KALIBR.items():
                if f"{name}_noise_density" in part:
                    white = _number(part, f"{name}_noise_density", where)
                    models[sensor] = _sum(white, "RW", _number(part, f"{name}_random_walk", where))
        return _of_axes(
            models
        ), "Kalibr: noise_density was taken for the density of white noise, random_walk for that of a random walk"
    models, density = {}, False
    for sensor, (group, short) in _UTILS.items():
        section = document.get(group)
        if not isinstance(section, Mapping):
            continue
        axis = section.get("avg-axis", section)
        if not isinstance(axis, Mapping):
            raise InputError(f"found {shown(axis)}, expected {short}_n and {short}_w", where=f"{where}: {group}")
        white, slow = (_number(axis, f"{short}_{letter}", f"{where}: {group}") for letter in "nw")
        density = "Hz" in str(section.get("unit", ""))
        if not density and "update_rate" not in document:
            raise InputError(
                f"says {short}_n in{section.get('unit', ' no unit')}, which imu_utils writes per sample: its density is known with the rate alone; "
                "add the line 'update_rate: 200' with the rate of the log in Hz",
                where=f"{where}: {group}",
            )
        if density:
            models[sensor] = _sum(white, "RW", slow)
        else:
            rate = _number(document, "update_rate", where)
            if rate <= 0.0:
                raise InputError(f"is {rate:g}, expected a positive number of Hz", where=f"{where}: update_rate")
            models[sensor] = _sum(white / math.sqrt(rate), "BI", slow / _FLAT)
    taken = (
        "_n was taken for the density of white noise, _w for that of a random walk, as the unit says"
        if density
        else "_n was taken for the standard deviation of a sample, _w for the smallest Allan deviation (0.664 B of a bias instability B)"
    )
    return _of_axes(models), f"imu_utils: {taken}"


def _of_axes(models: Mapping[str, NoiseModel]) -> dict[str, NoiseModel]:
    return {f"{sensor}_{axis}": model for sensor, model in models.items() for axis in "xyz"}


def _parts(document: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The document and its sections (imu0, imu1)."""
    yield document
    yield from (part for part in document.values() if isinstance(part, Mapping))


def _sum(white: float, slow: str, value: float) -> NoiseModel:
    levels = [("WN", white), *([(slow, value)] if value > 0.0 else [])]
    return NoiseModel(tuple(PROCESSES[n].from_mapping({PROCESSES[n].PARAMETERS[0].name: v}, "") for n, v in levels))


def _number(part: Mapping[str, Any], key: str, where: str) -> float:
    value = part.get(key)
    try:
        number = (
            float(value) if not isinstance(value, bool | Mapping | list | None) else math.nan
        )  # YAML reads 1e-3 as text
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number >= 0.0):
        raise InputError(f"is {shown(value)}, expected a number that is not negative", where=f"{where}: {key}")
    return number
