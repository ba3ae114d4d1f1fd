"""A vehicle in a file: the YAML that a recording or a preset gives, read safely and written so that people can read it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.emulate.dynamics.levels import Levels
from insemu.emulate.dynamics.presets import preset_spectrum
from insemu.emulate.dynamics.reading import Reader
from insemu.emulate.dynamics.slip import SLIPS, Slip
from insemu.emulate.dynamics.spectrum import Line, MotionSpectrum, Regime
from insemu.emulate.vehicle import VEHICLES
from insemu.errors import InputError, nearest
from insemu.records import AXES
from insemu.yamlfile import Place

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MovingVehicle:
    """A vehicle with what it does next to its path.

    Parameters
    ----------
    name : str
    kind : str
        Key of :data:`insemu.emulate.vehicle.VEHICLES`: limits, and the attitude that the path asks for.
    spectrum : MotionSpectrum
    source : str
        Where the numbers come from.
    jerk : float, optional
        Density with which recorded tracks are smoothed, m/s^3 per sqrt(Hz).
    slip : Slip
        How its nose leaves the course.
    """

    name: str
    kind: str
    spectrum: MotionSpectrum
    source: str = ""
    jerk: float | None = None
    slip: Slip = field(default_factory=Slip)


#: Keys of every part of a file.
_HEAD = ("vehicle", "kind", "source", "jerk", "slip")
_SLIP = ("sigma", "time", "axle", "compliance", "leeway")
_LEARNED, _PRESET = ("frequencies", "regimes", "lines", "levels", "unknown"), ("fastest", "parts", "lines")
_REGIME = ("speed", "turn", "climb", "density", "density_sigma", "coherence", "swing")
_LEVELS = ("edges", "step", "stretches")
_LINE = ("name", "order", "rate", "per_metre", "amplitude", "phase", "wander")


def read_vehicle(path: str | Path, conditions: Mapping[str, Any] | None = None) -> MovingVehicle:
    """Read a vehicle's file.

    Parameters
    ----------
    path : path
        Of a file, for example of a preset (:func:`~insemu.emulate.dynamics.presets.preset_file`).
    conditions : mapping, optional
        What differs from its file: ``roughness``, ``wind``, ``waves`` of a preset's parts, and fields of :class:`Slip`.

    Raises
    ------
    InputError
        With file, line and key.
    """
    document = yamlfile.read(path)
    reader = Reader(document)
    top = reader.mapping(document.data, ())
    short = "parts" in top
    reader.mapping(top, (), (*_HEAD, *(_PRESET if short else _LEARNED)))
    for key in ("vehicle", "kind", *(("parts", "fastest") if short else ("frequencies", "regimes"))):
        if key not in top:
            raise reader.fail((), f"the key '{key}' is missing")
    kind = reader.text(top["kind"], ("kind",))
    if kind not in VEHICLES:
        raise reader.fail(("kind",), f"unknown vehicle '{kind}'" + nearest(kind, VEHICLES))
    jerk = reader.number(top["jerk"], ("jerk",)) if top.get("jerk") is not None else None
    if short:
        parts = _under(conditions or {}, top["parts"], str(path))
        fastest = reader.number(top["fastest"], ("fastest",))
        spectrum = preset_spectrum(reader, parts, top.get("lines", []), fastest)
    else:
        fixed = {"roughness", "waves"} & set(conditions or {})
        if fixed:
            raise InputError(f"its spectra do not follow the condition '{min(fixed)}'", where=str(path))
        spectrum = _spectrum(reader, top)
    return MovingVehicle(
        reader.text(top["vehicle"], ("vehicle",)),
        kind,
        spectrum,
        reader.text(top.get("source", ""), ("source",)),
        jerk,
        _slip(reader, top, kind, conditions or {}),
    )


def _slip(reader: Reader, top: Mapping[str, Any], kind: str, conditions: Mapping[str, Any]) -> Slip:
    """The slip of the kind with what the file says of it; what a preset's parts say of wind and drag."""
    got = reader.mapping(top.get("slip", {}), ("slip",), _SLIP)
    values: dict[str, Any] = {key: reader.number(x, ("slip", key)) for key, x in got.items()}
    for part in top.get("parts", []):
        values |= {key: float(part[key]) for key in ("wind", "drag") if key in part}
    values |= {key: x for key, x in conditions.items() if key in Slip.__dataclass_fields__}
    return reader.made(("slip",), lambda: replace(SLIPS[kind], **values))


def _under(conditions: Mapping[str, Any], parts: Any, name: str) -> Any:
    """Parts with the values that conditions give."""
    for key in set(conditions) - (set(Slip.__dataclass_fields__) - {"wind"}):
        if not isinstance(parts, list) or not any(isinstance(part, dict) and key in part for part in parts):
            raise InputError(f"no part of the vehicle has the condition '{key}'", where=name)
    return [
        part | {k: v for k, v in conditions.items() if k in part} if isinstance(part, dict) else part for part in parts
    ]


def _spectrum(reader: Reader, top: Mapping[str, Any]) -> MotionSpectrum:
    f = np.array(reader.numbers(top["frequencies"], ("frequencies",)))
    regimes = [
        _regime(reader, str(name), value, ("regimes", str(name)), f.size)
        for name, value in reader.mapping(top["regimes"], ("regimes",)).items()
    ]
    lines = [_line(reader, x, ("lines", k)) for k, x in enumerate(reader.items(top.get("lines", []), ("lines",)))]
    unknown = tuple(
        reader.text(x, ("unknown", k)) for k, x in enumerate(reader.items(top.get("unknown", []), ("unknown",)))
    )
    levels = _levels(reader, top["levels"]) if "levels" in top else None
    return reader.made((), lambda: MotionSpectrum(f, tuple(regimes), tuple(lines), unknown, levels))


def _levels(reader: Reader, value: Any) -> Levels:
    place: Place = ("levels",)
    got = reader.mapping(value, place, _LEVELS)
    for key in _LEVELS:
        if key not in got:
            raise reader.fail(place, f"the key '{key}' is missing")
    edges = np.array(reader.numbers(got["edges"], (*place, "edges")))
    width = 3 + 6 * max(edges.size - 1, 0)
    rows, begins = [], []
    for k, stretch in enumerate(reader.items(got["stretches"], (*place, "stretches"))):
        at = (*place, "stretches", k)
        for j, row in enumerate(reader.items(stretch, at)):
            rows.append(reader.numbers(row, (*at, j), width))
            begins.append(j == 0)
    if not rows:
        raise reader.fail((*place, "stretches"), "found no rows, expected one at least")
    x, step = np.array(rows), reader.number(got["step"], (*place, "step"))
    log = np.log(10.0) * x[:, 3:].reshape(len(x), 6, -1)
    return reader.made(place, lambda: Levels(edges, step, x[:, :3], log, np.array(begins)))


def _regime(reader: Reader, name: str, value: Any, place: Place, m: int) -> Regime:
    got = reader.mapping(value, place, _REGIME)
    if "density" not in got:
        raise reader.fail(place, "the key 'density' is missing")
    density = reader.rows(got["density"], (*place, "density"), (m, 6))
    sigma = reader.rows(got["density_sigma"], (*place, "density_sigma"), (m, 6)) if "density_sigma" in got else None
    coherence = np.tile(np.eye(6, dtype=complex), (m, 1, 1))
    for pair, rows in reader.mapping(got.get("coherence", {}), (*place, "coherence")).items():
        at = (*place, "coherence", pair)
        axes = pair.split()
        if len(axes) != 2 or axes[0] == axes[1] or not set(axes) <= set(AXES):
            raise reader.fail(at, f"found '{pair}', expected two of {', '.join(AXES)}")
        i, j = map(AXES.index, axes)
        c = reader.rows(rows, at, (m, 2)) @ np.array([1.0, 1j])
        coherence[:, i, j], coherence[:, j, i] = c, np.conj(c)
    ranges: dict[str, Any] = {k: reader.pair(got[k], (*place, k)) for k in ("speed", "turn", "climb") if k in got}
    swing = reader.slow(got["swing"], (*place, "swing")) if "swing" in got else (0.0, 5.0)
    return reader.made(
        place,
        lambda: Regime(
            name,
            density,
            coherence,
            **ranges,
            swing_sigma=swing[0],
            swing_time=swing[1],
            density_sigma=sigma,
        ),
    )


def _line(reader: Reader, value: Any, place: Place) -> Line:
    got = reader.mapping(value, place, _LINE)
    for key in ("name", "order", "amplitude"):
        if key not in got:
            raise reader.fail(place, f"the key '{key}' is missing")
    amplitude = {
        str(regime): reader.numbers(x, (*place, "amplitude", regime), 6)
        for regime, x in reader.mapping(got["amplitude"], (*place, "amplitude")).items()
    }
    numbers: dict[str, Any] = {k: reader.number(got[k], (*place, k)) for k in ("rate", "per_metre") if k in got}
    wander = reader.slow(got["wander"], (*place, "wander")) if "wander" in got else (0.0, 10.0)
    phase = reader.numbers(got["phase"], (*place, "phase"), 6) if "phase" in got else (0.0,) * 6
    name, order = reader.text(got["name"], (*place, "name")), reader.number(got["order"], (*place, "order"))
    return reader.made(
        place, lambda: Line(name, order, amplitude, phase, **numbers, wander_sigma=wander[0], wander_time=wander[1])
    )


def vehicle_text(vehicle: MovingVehicle) -> str:
    """The file of a vehicle; :func:`read_vehicle` reads it back to four digits."""
    s = vehicle.spectrum
    out = [f"vehicle: {json.dumps(vehicle.name)}", f"kind: {vehicle.kind}"]
    out += [f"source: {json.dumps(vehicle.source)}"] if vehicle.source else []
    out += [] if vehicle.jerk is None else [f"jerk: {_digits(vehicle.jerk)}  # m/s^3 per sqrt(Hz)"]
    slip = {k: v for k in _SLIP if (v := getattr(vehicle.slip, k)) != getattr(SLIPS[vehicle.kind], k)}
    out += [f"slip: {{{', '.join(f'{k}: {_digits(v)}' for k, v in slip.items())}}}  # rad, s, m"] if slip else []
    out += [f"frequencies: {_row(s.frequencies)}  # Hz", "regimes:"]
    for r in s.regimes:
        out.append(f"  {json.dumps(r.name)}:")
        for key, pair, default, unit in (
            ("speed", r.speed, (0.0, np.inf), "m/s"),
            ("turn", r.turn, (0.0, np.inf), "rad/s"),
            ("climb", r.climb, (-np.inf, np.inf), "m/s"),
        ):
            out += [f"    {key}: {_row(pair)}  # {unit}"] if pair != default else []
        out += [f"    swing: {_slow(r.swing_sigma, r.swing_time)}  # nepers, s"] if r.swing_sigma else []
        out += [f"    density:  # {', '.join(AXES)}; one-sided, (rad/s)^2/Hz and (m/s^2)^2/Hz, one row a frequency"]
        out += [f"      - {_row(row)}" for row in r.density]
        if r.density_sigma is not None:
            out += [
                "    density_sigma:  # standard deviations, as shares of the densities",
                *(f"      - {_row(row)}" for row in r.density_sigma),
            ]
        pairs = [(i, j) for i in range(6) for j in range(i + 1, 6) if r.coherence[:, i, j].any()]
        out += ["    coherence:  # real and imaginary part, one row a frequency"] if pairs else []
        for i, j in pairs:
            rows = ", ".join(_row((x.real, x.imag)) for x in r.coherence[:, i, j])
            out.append(f"      {AXES[i]} {AXES[j]}: [{rows}]")
    out += ["lines:"] if s.lines else []
    for x in s.lines:
        out += [f"  - name: {json.dumps(x.name)}", f"    order: {_digits(x.order)}"]
        out.append(
            f"    rate: {_digits(x.rate)}  # Hz"
            if x.rate is not None
            else f"    per_metre: {_digits(x.per_metre or 0.0)}"
        )
        out += [f"    wander: {_slow(x.wander_sigma, x.wander_time)}"] if x.wander_sigma else []
        out += [
            "    amplitude:",
            *(f"      {json.dumps(name)}: {_row(row)}" for name, row in x.amplitude.items()),
            f"    phase: {_row(x.phase)}",
        ]
    out += [] if s.levels is None else _levels_text(s.levels)
    out += ["unknown:", *(f"  - {json.dumps(x)}" for x in s.unknown)] if s.unknown else []
    return "\n".join(out) + "\n"


def _levels_text(levels: Levels) -> list[str]:
    out = ["levels:", f"  edges: {_row(levels.edges)}  # Hz", f"  step: {_digits(levels.step)}  # s"]
    out.append(
        f"  stretches:  # speed m/s, turn rad/s, climb m/s, then log10 of the densities of the bands of {', '.join(AXES)}"
    )
    rows = np.hstack([levels.motion, (levels.log / np.log(10.0)).reshape(len(levels.motion), -1)])
    for begins, row in zip(levels.begins, rows, strict=True):
        text = ", ".join(f"{x:.3g}" if k < 3 else f"{x:.2f}" for k, x in enumerate(row))
        out.append(f"    {'- ' if begins else '  '}- [{text}]")
    return out


def _digits(x: float) -> str:
    if np.isinf(x):
        return ".inf" if x > 0 else "-.inf"
    text = f"{x:.5g}"
    return text if "e" not in text or "." in text else text.replace("e", ".0e")  # YAML takes 1e-05 for text


def _row(values: Sequence[float] | Array) -> str:
    return "[" + ", ".join(_digits(float(x)) for x in values) + "]"


def _slow(sigma: float, time: float) -> str:
    return f"{{sigma: {_digits(sigma)}, time: {_digits(time)}}}"
