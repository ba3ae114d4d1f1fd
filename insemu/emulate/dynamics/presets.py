"""Vehicles that come with the package: at most twenty numbers in one file each, made into spectra by :mod:`insemu.emulate.dynamics.physics`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.dynamics.physics import PARTS, RAILS, ROADS
from insemu.emulate.dynamics.reading import Reader
from insemu.emulate.dynamics.spectrum import Line, MotionSpectrum, Regime
from insemu.errors import InputError, shown
from insemu.yamlfile import Place

Array = NDArray[np.float64]

#: Folder of the presets.
FOLDER = Path(__file__).resolve().parent.parent / "vehicles"
#: Speeds in m/s at which spectra are made, up to a preset's fastest; the first stands.
SPEEDS = (0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0, 70.0, 90.0)
#: A vehicle stands below this speed, m/s.
STANDS = 0.3
#: Lowest, highest and number of frequencies of spectra, Hz: of all but the sea, whose waves are longer.
BAND, SEA, COUNT = (0.2, 50.0), (0.05, 25.0), 36
#: Standard deviation and time of the swings of the level: roads, gusts and seas come in patches (Rouillard 2010: the moving rms of road vehicles).
SWING = (0.25, 6.0)
#: Share by which rates of machines and gaits are off, and the time in s within which that changes.
WANDER = (0.005, 4.0)
#: Arm in m by which a machine that shakes a vehicle turns it, where nothing is said: rate = acceleration / (2 pi f arm).
ARM = 1.0
_LINE = ("name", "rate", "per_metre", "accel", "gyro", "when")


def presets() -> tuple[str, ...]:
    """Names of the vehicles that come with the package."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def preset_spectrum(reader: Reader, parts: Any, lines: Any, fastest: float) -> MotionSpectrum:
    """The spectrum of the parts and lines of a preset.

    Parameters
    ----------
    reader : Reader
    parts : list
        Mappings with the key ``part`` and the numbers that it takes.
    lines : list
        Mappings with ``name``, ``rate`` (Hz) or ``per_metre`` (periods in a metre of way), amplitudes ``accel`` (m/s^2, at the fastest) and ``gyro``
        (rad/s; from an arm of :data:`ARM` where absent) and ``when``: always, standing or moving.
    fastest : float
        m/s.
    """
    given = [_part(reader, x, ("parts", k)) for k, x in enumerate(reader.items(parts, ("parts",)))]
    low, high = SEA if any(name == "hull" for name, _ in given) else BAND
    f = np.geomspace(low, high, COUNT)
    speeds = [v for v in SPEEDS if v <= fastest]
    edges = [0.0, STANDS, *(np.sqrt(a * b) for a, b in pairwise(speeds[1:])), np.inf]
    regimes = []
    for k, v in enumerate(speeds):
        total = np.full((f.size, 6, 6), 0j)
        for place, (name, numbers) in enumerate(given):
            terms = reader.made(("parts", place), lambda name=name, numbers=numbers, v=v: PARTS[name][0](f, v, numbers))  # type: ignore[misc]
            for density, response in terms:
                total += density[:, None, None] * response[:, :, None] * np.conj(response[:, None, :])
        power = np.einsum("nii->ni", total).real
        root = np.sqrt(np.maximum(power, 1e-30))
        coherence = total / (root[:, :, None] * root[:, None, :])
        coherence = 0.5 * (coherence + np.conj(np.swapaxes(coherence, 1, 2)))
        coherence[:, range(6), range(6)] = 1.0
        swing = (0.0, SWING[1]) if v == 0.0 else SWING
        regimes.append(
            Regime(_name(v), power, coherence, (edges[k], edges[k + 1]), swing_sigma=swing[0], swing_time=swing[1])
        )
    made = tuple(_line(reader, x, ("lines", k), speeds) for k, x in enumerate(reader.items(lines, ("lines",))))
    return MotionSpectrum(f, tuple(regimes), made)


def _name(v: float) -> str:
    return "standing" if v == 0.0 else f"{v:g} m/s"


def _part(reader: Reader, value: Any, place: Place) -> tuple[str, Mapping[str, Any]]:
    """Name and numbers of one part, checked."""
    got = dict(reader.mapping(value, place))
    name = reader.text(got.pop("part", None), (*place, "part"))
    if name not in PARTS:
        raise reader.fail((*place, "part"), f"found '{name}', expected one of {', '.join(PARTS)}")
    wanted = PARTS[name][1]
    reader.mapping(got, place, tuple(wanted))
    numbers: dict[str, Any] = {}
    for key, count in wanted.items():
        if key not in got:
            if key == "standing":
                continue
            raise reader.fail(place, f"the key '{key}' is missing")
        at = (*place, key)
        if count == 3:
            numbers[key] = _three(reader, got[key], at)
        elif count > 1:
            numbers[key] = reader.numbers(got[key], at, count)
        elif count == 0 and got[key] in (*ROADS, *RAILS):
            numbers[key] = got[key]
        else:
            numbers[key] = reader.number(got[key], at)
        if (np.asarray(numbers[key]) < 0 if not isinstance(numbers[key], str) else np.zeros(1)).any():
            raise reader.fail(at, f"found {numbers[key]}, expected nothing negative")
    return name, numbers


def _three(reader: Reader, value: Any, place: Place) -> tuple[float, ...]:
    """Three numbers, or one for all three axes."""
    return reader.numbers(value, place, 3) if isinstance(value, list) else (reader.number(value, place),) * 3


def _line(reader: Reader, value: Any, place: Place, speeds: Sequence[float]) -> Line:
    got = reader.mapping(value, place, _LINE)
    for key in ("name", "accel"):
        if key not in got:
            raise reader.fail(place, f"the key '{key}' is missing")
    either = {key: reader.number(got[key], (*place, key)) for key in ("rate", "per_metre") if key in got}
    accel = np.array(_three(reader, got["accel"], (*place, "accel")))
    if "gyro" in got:
        gyro = np.array(_three(reader, got["gyro"], (*place, "gyro")))
    else:
        hertz = either.get("rate", either.get("per_metre", 1.0) * speeds[-1])
        gyro = accel / (2.0 * np.pi * max(hertz, 1e-9) * ARM)
    when = got.get("when", "always")
    if when not in ("always", "standing", "moving"):
        raise reader.fail((*place, "when"), f"found {shown(when)}, expected always, standing or moving")
    there = [v for v in speeds if (when != "moving" if v == 0.0 else when != "standing")]
    # what follows the way grows with the speed, as steps and unbalance do
    amplitude = {
        _name(v): tuple(map(float, np.concatenate([gyro, accel]) * (1.0 if "rate" in either else v / speeds[-1])))
        for v in there
    }
    # quarter turns between axes: no two of a machine's parts shake in one plane
    phase = tuple(0.5 * np.pi * k for k in (0, 1, 2, 1, 0, 2))
    name = reader.text(got["name"], (*place, "name"))
    return reader.made(
        place, lambda: Line(name, 1.0, amplitude, phase, either.get("rate"), either.get("per_metre"), *WANDER)
    )


@lru_cache(maxsize=16)
def preset_file(name: str) -> Path:
    """File of a preset.

    Raises
    ------
    InputError
        An unknown name; the message lists what there is.
    """
    if name not in presets():
        raise InputError(f"found '{name}', expected one of {', '.join(presets())}")
    return FOLDER / f"{name}.yaml"
