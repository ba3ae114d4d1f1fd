"""Variance curves made elsewhere, to be drawn next to ours: our own JSON, or a file of sensors with ``wvar`` by axis."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.decoding import decoding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NamedCurve:
    """A wavelet variance curve from a file.

    Parameters
    ----------
    label : str
        Sensor and axis.
    is_gyro : bool or None
        Which sensor; None where the file does not say.
    tau_s, value : (J,) arrays
        Scale ``2^j / rate`` in s and wavelet variance in the file's unit.
    """

    label: str
    is_gyro: bool | None
    tau_s: Array
    value: Array


def read_curves(path: str | Path) -> list[NamedCurve]:
    """Read wavelet variance curves from JSON.

    Two layouts: ``{"axes": {NAME: {"wavelet_variance": {"tau_s", "value"}}}}`` as ``insemu characterise --json`` prints it, and
    ``{SENSOR: {"freq": [Hz], "wvar": {AXIS: {"variance": [...], "scales": [...]}}}}`` where octaves start at 2 samples.

    Raises
    ------
    InputError
        No JSON, or no curve in it.
    """
    path = Path(path)
    with decoding(path, "variance curves"):
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise InputError(f"is not JSON ({error})", where=str(path)) from None
        out: list[NamedCurve] = []
        if isinstance(content, dict) and isinstance(content.get("axes"), dict):
            for name, axis in content["axes"].items():
                curve = axis.get("wavelet_variance", {}) if isinstance(axis, dict) else {}
                out.extend(_curve(path.stem + " " + name, _is_gyro(name), curve.get("tau_s"), curve.get("value")))
        elif isinstance(content, dict):
            for sensor, entry in content.items():
                if not isinstance(entry, dict) or not isinstance(entry.get("wvar"), dict):
                    continue
                rate = float(np.atleast_1d(entry.get("freq", [1.0]))[0])
                for name, axis in entry["wvar"].items():
                    values = axis.get("variance") if isinstance(axis, dict) else None
                    tau = None if values is None else (2.0 ** np.arange(1, len(values) + 1) / rate).tolist()
                    out.extend(_curve(f"{sensor} {name}", _is_gyro(name), tau, values))
        if not out:
            raise InputError("holds no wavelet variance curve", where=str(path))
        return out


def _curve(label: str, is_gyro: bool | None, tau: Any, value: Any) -> list[NamedCurve]:
    if tau is None or value is None or len(tau) != len(value):
        return []
    return [NamedCurve(label, is_gyro, np.asarray(tau, dtype=float), np.asarray(value, dtype=float))]


def _is_gyro(name: str) -> bool | None:
    low = name.lower()
    if low.startswith(("gyr", "gx", "gy", "gz")):
        return True
    return False if low.startswith(("acc", "ax", "ay", "az")) else None
