"""A first scenario: a commented file that runs, for a sensor and a motion of one's own, or a copy of one that comes with insemu."""

from __future__ import annotations

import math
import os
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from insemu import yamlfile
from insemu.emulate import TRAJECTORIES, MotionSource, bridged_gap, load_flight, read_track
from insemu.errors import InputError
from insemu.noise import WN, NoiseModel
from insemu.noise import load as load_models
from insemu.scenario.files import validated
from insemu.scenario.schema import TrajectorySource
from insemu.scenario.shipped import shipped_scenario
from insemu.sensors import axis_models, card, spelled

#: The sensor where none is named: industrial MEMS, every figure from its datasheet.
SENSOR = "ADIS16470"
#: The motion where no track is named: a drive in town.
BUILTIN = "urban_drive_1"
#: Speed of waypoint legs whose file gives none, m/s: a car in town.
SPEED = 10.0
#: An outage lasts a minute, or a sixth of a flight that is too short for that; the first comes after a third of the flight, so that the
#: filter has learnt the biases, the second after two thirds.
OUTAGE_S, OUTAGE_SHARE = 60.0, 1.0 / 6.0

_TEMPLATE = (Path(__file__).parent / "first_scenario.txt").read_text(encoding="utf-8")

_WHITE = """\
  white noise:                          # nine states: no bias that changes in flight
    gyro: {gyro}
    accel: {accel}"""
_DOUBLE = """\
  double:                               # twice the white noise of the truth
    gyro: {gyro}
    accel: {accel}"""
_WORST = """\
  worst case:                           # the same sensor, its figures at their limits
    gyro: {{sensor: {sensor}, case: worst}}
    accel: {{sensor: {sensor}, case: worst}}"""


@dataclass(frozen=True)
class Spoken:
    """Models of the truth that are written out.

    Parameters
    ----------
    name : str
        Of the sensor.
    models : mapping of str to NoiseModel
        Of ``gyro`` and ``accel``.
    said : sequence of str
        Lines about them.
    """

    name: str
    models: Mapping[str, NoiseModel]
    said: Sequence[str] = ()


@dataclass(frozen=True)
class Wish:
    """What a first scenario is made from.

    Parameters
    ----------
    sensor : str
        Name or file of a sensor card.
    model : str
        File of noise models in place of a card.
    track : str
        File of a track or of waypoints, or the name of a built-in trajectory; empty: a drive in town.
    vehicle : str
        For a track or waypoints.
    realizations : int
    outages : sequence of (start, duration)
        s; empty: two.
    position, velocity : str
        Standard deviations of the fixes, north, east and down.
    aids, options : sequence of str
        Lines of the sections of these names, of the scenario and of the complete design.
    longest : float
        Longest part of a track that is flown, s.
    spoken : Spoken, optional
        Models of the truth in place of a card.
    motion : (str, float), optional
        What :func:`motion_of` says of it, where that is known.
    """

    sensor: str = SENSOR
    model: str = ""
    track: str = ""
    vehicle: str = "car"
    realizations: int = 8
    outages: Sequence[tuple[float, float]] = ()
    position: str = "1 m, 1 m, 2 m"
    velocity: str = "5 cm/s, 5 cm/s, 10 cm/s"
    aids: Sequence[str] = ()
    options: Sequence[str] = ()
    longest: float = math.inf
    spoken: Spoken | None = None
    motion: tuple[str, float] | None = None


def first_scenario(path: str | Path, wish: Wish) -> str:
    """Text of a commented scenario that runs.

    Parameters
    ----------
    path : path
        Where it will stand; files are named relative to its folder.
    wish : Wish

    Raises
    ------
    InputError
        An unknown sensor or vehicle, or a track that cannot be read or flown; models without white noise.
    """
    path = Path(path)
    validated(TrajectorySource, yamlfile.Document("--vehicle", {"builtin": BUILTIN, "vehicle": wish.vehicle}, {}))
    motion, duration = wish.motion or motion_of(path.parent, wish)
    common = {
        "name": path.name,
        "stem": path.stem,
        "realizations": wish.realizations,
        "motion": motion,
        "outages": "\n".join(_outages(duration, wish.outages)),
        "position": wish.position,
        "velocity": wish.velocity,
        "aids": "".join(["\naids:\n", *(f"  {line}\n" for line in wish.aids)]) if wish.aids else "",
        "options": "".join(["\n    options:", *(f"\n      {line}" for line in wish.options)]) if wish.options else "",
    }
    if wish.spoken:
        return _TEMPLATE.format(**common, **_spoken(wish.spoken))
    if wish.model:
        return _TEMPLATE.format(**common, **_of_models(path, wish.model))
    return _TEMPLATE.format(**common, **_of_card(path, wish.sensor))


def _white(models: Mapping[str, NoiseModel], name: str, factor: float = 1.0) -> dict[str, str]:
    """The largest white noise of each triad, times a factor, as text; ``name`` is whose models they are."""
    out = {}
    for kind, unit in (("gyro", "rad/s"), ("accel", "m/s^2")):
        if not any(axis.startswith(kind) for axis in models):
            raise InputError(f"{name} has no figures of the {kind}; a truth needs gyroscopes and accelerometers")
        levels = [p.parameters["N"] for a, m in models.items() if a.startswith(kind) for p in m if isinstance(p, WN)]
        if not levels:
            raise InputError(f"{name} has no white noise of the {kind}, which the second design would have")
        out[kind] = spelled(NoiseModel((WN(factor * max(levels)),)), unit)
    return out


def _spoken(given: Spoken) -> dict[str, str]:
    """What the template says of models that are written out."""
    text = {triad: spelled(m, "rad/s" if triad == "gyro" else "m/s^2") for triad, m in given.models.items()}
    return {
        "title": f"{given.name} through GNSS outages",
        "about": f"The figures of {given.name}:",
        "said": "\n".join(f"#   {line}" for line in given.said),
        "truth": f"gyro: {text['gyro']}\n  accel: {text['accel']}",
        "pad": "  ",
        "hint": "white noise, in-run bias, walk, turn-on bias",
        "second": _WHITE.format(**_white({f"{t}_x": m for t, m in given.models.items()}, given.name)),
    }


def _of_models(path: Path, file: str) -> dict[str, str]:
    """What the template says of a file of noise models."""
    models = load_models(file)
    # models that are white noise alone have nothing to leave out
    alone = all(len(m) == 1 for m in models.values())
    truth = f"file: {os.path.relpath(file, path.parent)}"
    said = [f"#   {axis}: {spelled(m, 'rad/s' if axis.startswith('gyro') else 'm/s^2')}" for axis, m in models.items()]
    return {
        "title": f"{Path(file).stem} through GNSS outages",
        "about": f"The models of {Path(file).name}:",
        "said": "\n".join(said),
        "truth": truth,
        "pad": " " * max(2, 28 - len(truth)),
        "hint": "models that were fitted; `{sensor: NAME}` takes a card of `insemu sensor`",
        "second": (_DOUBLE if alone else _WHITE).format(**_white(models, file, 2.0 if alone else 1.0)),
    }


def _of_card(path: Path, name: str) -> dict[str, str]:
    """What the template says of a sensor card."""
    sensor = card(name)
    found = axis_models(sensor)
    white = _white({axis: one.model for axis, one in found.items()}, sensor.name)
    said = dict.fromkeys(f"{axis.split('_')[0]}: {line}" for axis, one in found.items() for line in one.said)
    wrapped = [textwrap.fill(line, 110, initial_indent="#   ", subsequent_indent="#     ") for line in said]
    # a model that is white noise alone has nothing to leave out
    alone = all(len(one.model) == 1 for one in found.values())
    named = name if Path(name).suffix == "" else os.path.relpath(name, path.parent)
    return {
        "title": f"{sensor.name} through GNSS outages",
        "about": f"{sensor.name}: {', '.join(part for part in (sensor.maker, sensor.about) if part)}.",
        "said": "\n".join(wrapped),
        "truth": f"sensor: {named}",
        "pad": " " * max(2, 20 - len(named)),
        "hint": "`insemu sensor` lists the names; a file of `insemu fit -o` goes by {file: models.yaml}",
        "second": (_WORST if alone else _WHITE).format(sensor=named, **white),
    }


def _outages(duration: float, given: Sequence[tuple[float, float]]) -> list[str]:
    length = max(1, round(min(OUTAGE_S, OUTAGE_SHARE * duration)))
    spans = given or [(round(share * duration), length) for share in (1.0 / 3.0, 2.0 / 3.0)]
    return [f"    - {{start: {start:.12g} s, duration: {seconds:.12g} s}}" for start, seconds in spans]


def motion_of(folder: Path, wish: Wish) -> tuple[str, float]:
    """Lines of the trajectory for a scenario in a folder, and how long it lasts in s."""
    track, vehicle, longest = wish.track, wish.vehicle, wish.longest
    if not track or (track in TRAJECTORIES and not Path(track).exists()):
        minutes = min(540.0, longest) / 60.0
        lines = [
            f"  builtin: {track or BUILTIN}       # or a track, waypoints, or a file of motion commands",
            f"  duration: {minutes:g} min",
        ]
        return "\n".join(lines), 60.0 * minutes
    relative = os.path.relpath(track, folder)
    try:
        recorded = read_track(track)
    except InputError:
        if not _is_waypoints(track):
            raise
        flight = load_flight(MotionSource(waypoints=track, vehicle=vehicle, speed=SPEED)).flight
        lines = [
            f"  waypoints: {relative}",
            f"  vehicle: {vehicle}                  # its limits: speed, acceleration, turns, climbs",
            f"  speed: {SPEED:g} m/s                # of legs whose file gives none",
        ]
    else:
        gap = bridged_gap(recorded, vehicle)
        flight = load_flight(MotionSource(track=track, vehicle=vehicle, max_gap_s=gap)).flight
        lines = [
            f"  track: {relative}",
            f"  vehicle: {vehicle}                  # how much it may jerk, and how it holds its attitude",
            f"  max_gap: {gap} s                # longest gap that is bridged; a longer one in which it hardly moves is a pause and left out",
        ]
    duration = float(flight.path.end - flight.path.start)
    if duration > longest:
        lines.append(f"  duration: {longest:g} s             # the first part of it")
    return "\n".join(lines), min(duration, longest)


def _is_waypoints(file: str) -> bool:
    """Whether a file is GeoJSON, a route, or a table without times."""
    path = Path(file)
    if path.suffix.lower() in (".geojson", ".json", ".gpx", ".kml"):
        return True
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    return not any(cell.strip().lower().split("[")[0].strip() in ("t", "time") for cell in header.split(","))


def copy_shipped(name: str, path: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Copy a scenario that comes with insemu, with the files that it names.

    Parameters
    ----------
    name : str
        Of the scenario.
    path : path
        File to write; what it names goes beside it, in the same folders.
    overwrite : bool
        Whether files that exist may be replaced.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        No such scenario, or a file that exists.
    """
    found = shipped_scenario(name)
    path = Path(path)
    pairs = [(found.path, path), *((found.path.parent / f, path.parent / f) for f in found.files)]
    for _, target in pairs:
        if target.exists() and not overwrite:
            raise InputError("exists already; --force replaces it", where=str(target))
    for source, target in pairs:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    return [target for _, target in pairs]
