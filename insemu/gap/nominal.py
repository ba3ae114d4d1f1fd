"""What the user believes: noise per axis, GNSS noise, initial uncertainties; read from a scenario, a short belief file or a noise-model file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from insemu.errors import InputError
from insemu.gap.verdict import GapReport, Step
from insemu.noise import NoiseModel, load, save
from insemu.records import AXES
from insemu.scenario import Gnss, Initial, SensorModels
from insemu.scenario import load as load_scenario


@dataclass(frozen=True)
class Nominal:
    """The belief that a recording is held against.

    Parameters
    ----------
    beliefs : mapping of axis to NoiseModel
        ``gyro_x`` ... ``accel_z``, or a column's own name.
    gnss, initial
        Sections of a scenario; defaults where the file does not say.
    raw : mapping
        The file as it was read, for writing the refined one.
    kind : str
        ``scenario``, ``belief`` or ``noise`` (a file of :func:`insemu.noise.save`).
    """

    beliefs: dict[str, NoiseModel]
    gnss: Gnss = field(default_factory=Gnss)
    initial: Initial = field(default_factory=Initial)
    raw: Mapping[str, Any] = field(default_factory=dict)
    kind: str = "belief"
    source: str = ""


def load_nominal(path: str | Path) -> Nominal:
    """Read a nominal model.

    Three kinds of file are understood: a scenario (its ``truth`` models are what is believed of the sensor), a short file with the keys
    ``belief`` (noise per axis as in a scenario) and optionally ``gnss`` and ``initial``, and a noise-model file of ``insemu fit``.

    Raises
    ------
    InputError
        None of them, naming file and key.
    FileNotFoundError
        No such file.
    """
    path = Path(path)
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"not YAML ({error})", where=str(path)) from None
    if not isinstance(raw, dict):
        raise InputError("expected a scenario, a belief file or a noise-model file (a YAML mapping)", where=str(path))
    if "axes" in raw:
        return Nominal(load(path), raw=raw, kind="noise", source=str(path))
    if "belief" in raw:
        known = {"belief", "gnss", "initial", "title", "notes", "effects"}
        unknown = [k for k in raw if k not in known]
        if unknown:
            raise InputError(
                f"unknown key '{unknown[0]}' (expected one of: {', '.join(sorted(known))})", where=str(path)
            )
        try:
            beliefs = SensorModels.model_validate(raw["belief"]).models()
            gnss, initial = Gnss.model_validate(raw.get("gnss", {})), Initial.model_validate(raw.get("initial", {}))
        except InputError as error:
            raise InputError(str(error), where=str(path)) from None
        except ValueError as error:  # pydantic: one line is enough
            raise InputError(re.sub(r"\s+", " ", str(error))[:400], where=str(path)) from None
        if not beliefs:
            raise InputError(
                "'belief' names no axis; expected gyro, accel or single axes such as gyro_x", where=str(path)
            )
        return Nominal(beliefs, gnss, initial, raw, "belief", str(path))
    scenario = load_scenario(path)
    models = scenario.truth.models() if scenario.truth is not None else {}
    if not models:
        raise InputError("no noise models as truth; a gap needs models to hold a recording against", where=str(path))
    return Nominal(models, scenario.gnss, scenario.initial, raw, "scenario", str(path))


def effect_mapping(step: Step) -> dict[str, Any]:
    """A step as plain data, with the keys of the table of effects where the parameters are its own."""
    out: dict[str, Any] = {"effect": step.effect, "sensor": step.sensor, "axes": list(step.axes)}
    if step.variant:
        out["shape"] = step.variant
    return out | {
        p.name: f"{float(p.value)!r} {p.unit}".strip() if p.unit not in ("", "1", "degC") else float(p.value)
        for p in step.parameters
    }


def write_refined(nominal: Nominal, report: GapReport, path: str | Path) -> Path:
    """Write the refined model in the form that the nominal one had.

    A scenario gets the refined noise as its truth, so that ``insemu run`` takes it as it is; deterministic effects, which a scenario's noise
    cannot hold, are listed in its notes (and under ``effects`` of a belief file).
    """
    path = Path(path)
    effects = [effect_mapping(s) for s in report.steps]
    if nominal.kind == "noise":
        save({**nominal.beliefs, **report.refined}, path)
        return path
    models = {
        a: m.to_list("rad/s" if a.startswith("gyro") else "m/s^2")
        for a, m in {**nominal.beliefs, **report.refined}.items()
        if a in AXES
    }
    document = {k: v for k, v in nominal.raw.items() if k not in ("belief", "truth", "effects", "variants")}
    if nominal.kind == "belief":
        document["belief"] = models
        if effects:
            document["effects"] = effects
    else:
        old = nominal.raw.get("truth", {})
        kept = {k: v for k, v in old.items() if k not in ("gyro", "accel", *AXES)} if isinstance(old, dict) else {}
        document["truth"] = {**kept, **models}
        lines = [
            f"refined against {report.source}; effects found:",
            *(f"  {yaml.safe_dump(e, default_flow_style=True).strip()}" for e in effects),
        ]
        document["notes"] = "\n".join([str(document.get("notes", "")), *lines]).strip() + "\n"
    path.write_text(yaml.safe_dump(_plain(document), sort_keys=False, allow_unicode=True, width=140), encoding="utf-8")
    return path


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value
