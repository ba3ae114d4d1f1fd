"""Column maps: which columns of a table are what, in which units, written by a reader, by the user, or guessed.

One line says it: ``gyro=omega_*[deg/s], accel=a_*[g], time=stamp[ns], axes=FLU``. On the left stands a role or a setting, on the right the
columns of the file (``*`` stands for any characters; a minus sign turns a column round) with their unit in brackets.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.errors import InputError, found_at, nearest
from insemu.formats.names import english
from insemu.units import parse, parse_unit, scaled_unit
from insemu.whole import put

#: Role -> number of columns and their SI unit (of rates; of increments an integral of it).
ROLES: Mapping[str, tuple[int, str]] = {
    "time": (1, "s"), "nanoseconds": (1, "s"), "week": (1, ""), "gyro": (3, "rad/s"), "accel": (3, "m/s^2"),
    "temperature": (1, "degC"),
    "lat": (1, "rad"), "lon": (1, "rad"), "height": (1, "m"), "ecef": (3, "m"), "ned": (3, "m"), "enu": (3, "m"),
    "vel_ned": (3, "m/s"), "vel_enu": (3, "m/s"), "vel_neu": (3, "m/s"), "vel_body": (3, "m/s"), "speed": (1, "m/s"),
    "course": (1, "rad"),
    "pos_std_ned": (3, "m"), "pos_std_enu": (3, "m"), "pos_std_h": (1, "m"), "pos_std_v": (1, "m"),
    "vel_std_ned": (3, "m/s"), "vel_std_enu": (3, "m/s"), "vel_std_h": (1, "m/s"), "quality": (1, ""),
    "rpy": (3, "rad"), "roll": (1, "rad"), "pitch": (1, "rad"), "heading": (1, "rad"), "quaternion": (4, ""), "quaternion_xyzw": (4, ""),
}  # fmt: skip
#: Settings of a map; the table of ``docs/files.md`` says what each means.
SETTINGS = (
    "axes kind clock rate origin mount shift gyro_shift accel_shift gnss_shift gnss_move from to topic gnss_topic instance imu attitude "
    "gyro_unit accel_unit time_unit pos_unit vel_unit velocity latlon height_unit gyro_axes accel_axes contradictions"
).split()
#: Role -> the setting that says its unit against what the file states.
UNIT_SETTING: Mapping[str, str] = {
    "time": "time_unit", "gyro": "gyro_unit", "accel": "accel_unit", "lat": "pos_unit", "lon": "pos_unit",
    "height": "height_unit", "vel_ned": "vel_unit", "vel_enu": "vel_unit", "vel_neu": "vel_unit", "speed": "vel_unit",
}  # fmt: skip
_CHOICES = {
    "latlon": ("swapped", "west", "south", "as stated"),
    "velocity": ("ned", "enu", "neu"),
    "kind": ("sample", "mean", "increment"),
    "attitude": ("ned", "enu"),
    "contradictions": ("accepted",),
}
_LONGEST = 4000


@dataclass(frozen=True)
class Pick:
    """One column of a role: name or pattern, unit as written (None: not said), sign."""

    column: str
    unit: str | None = None
    sign: int = 1

    def __str__(self) -> str:
        name = f'"{self.column}"' if re.search(r"[\s,=\[\]]", self.column) else self.column
        return ("-" if self.sign < 0 else "") + name


@dataclass(frozen=True)
class ColumnMap:
    """Columns by role, and settings; see :data:`ROLES` and :data:`SETTINGS`."""

    picks: Mapping[str, tuple[Pick, ...]] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.picks) or bool(self.settings)

    def __str__(self) -> str:
        parts = []
        for role, picks in self.picks.items():
            unit = picks[-1].unit
            parts.append(f"{role}={' '.join(map(str, picks))}" + (f"[{unit}]" if unit is not None else ""))
        return ", ".join(parts + [f"{key}={value}" for key, value in self.settings.items()])

    def over(self, other: ColumnMap) -> ColumnMap:
        """Return this map with what it leaves open taken from another."""
        return ColumnMap({**other.picks, **self.picks}, {**other.settings, **self.settings})


def parse_map(text: str, where: str = "--map") -> ColumnMap:
    """Read a map from its line.

    Raises
    ------
    InputError
        An unknown role, setting or unit; a part without ``=``; brackets or quotes that do not close.

    Examples
    --------
    >>> str(parse_map("gyro=omega_*[deg/s], time=stamp[ns], axes=FLU"))
    'gyro=omega_*[deg/s], time=stamp[ns], axes=FLU'
    """
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise InputError("expected text such as 'gyro=omega_*[deg/s], accel=a_*[g], time=stamp[ns]'", where=where)
    picks: dict[str, tuple[Pick, ...]] = {}
    settings: dict[str, str] = {}
    for part in _split(text, ",", where):
        if not part.strip():
            continue
        key, equals, value = part.partition("=")
        key, value = key.strip(), value.strip()
        if not equals or not value:
            raise InputError(f"found '{part.strip()[:60]}', expected ROLE=COLUMNS[UNIT] or SETTING=VALUE", where=where)
        if key in SETTINGS:
            settings[key] = _setting(key, value, where)
        elif key in ROLES:
            picks[key] = _picks(key, value, where)
        else:
            raise InputError(f"unknown role '{key[:40]}'" + nearest(key, [*ROLES, *SETTINGS]), where=where)
    return ColumnMap(picks, settings)


def _setting(key: str, value: str, where: str) -> str:
    """A setting's value, checked as far as it can be without the data."""
    if key in _CHOICES and value not in _CHOICES[key]:
        raise InputError(f"is '{value[:40]}', expected one of: {', '.join(_CHOICES[key])}", where=f"{where}: {key}")
    role = next((r for r, k in UNIT_SETTING.items() if k == key), None)
    if role is not None and not (key == "pos_unit" and value in ("ddmm", "dd.mm")):
        _check_unit(role, value, where)
    if key in ("shift", "gyro_shift", "accel_shift", "gnss_shift", "from", "to", "rate"):
        parse(value, "Hz" if key == "rate" else "s")
    return value


def _split(text: str, separator: str, where: str) -> list[str]:
    """Split outside quotes and brackets."""
    parts, start, depth, quoted = [], 0, 0, False
    for k, letter in enumerate(text):
        if letter == '"':
            quoted = not quoted
        elif not quoted:
            depth += (letter == "[") - (letter == "]")
            if depth < 0 or depth > 1:
                raise InputError(f"brackets do not match in '{text[:80]}'", where=where)
            if depth == 0 and (letter == separator or (separator == " " and letter.isspace())):
                parts.append(text[start:k])
                start = k + 1
    if depth or quoted:
        raise InputError(f"brackets or quotes do not close in '{text[:80]}'", where=where)
    return [*parts, text[start:]]


def _picks(role: str, value: str, where: str) -> tuple[Pick, ...]:
    out: list[Pick] = []
    for word in (w for w in _split(value, " ", where) if w):
        name, bracket, rest = word.partition("[") if not word.startswith(('"', '-"')) else _quoted(word)
        unit = rest.rstrip()[:-1].strip() if bracket else None
        sign = -1 if name.startswith("-") else 1
        name = name.removeprefix("-").strip('"')
        if not name and unit is not None and out:  # a blank before the bracket
            out[-1] = replace(out[-1], unit=unit)
            continue
        if not name:
            raise InputError(f"'{role}' names no column", where=where)
        if unit:
            _check_unit(role, unit, where)
        out.append(Pick(name, unit, sign))
    units = [p.unit for p in out]
    if len(out) > 1 and units[-1] is not None and all(u is None for u in units[:-1]):
        out = [replace(p, unit=units[-1]) for p in out]  # one unit behind all
    return tuple(out)


def _quoted(word: str) -> tuple[str, str, str]:
    end = word.rindex('"')
    tail = word[end + 1 :]
    return word[: end + 1], "[" if tail.startswith("[") else "", tail[1:]


def _check_unit(role: str, unit: str, where: str) -> None:
    with found_at(f"{where}: {role}"):
        found = scaled_unit(unit)
    dimensions = [parse_unit(u).dimension for u in allowed_units(role)]
    if role not in ("week", "quality") and found.dimension not in dimensions:
        raise InputError(f"the unit '{unit}' is none of {ROLES[role][1] or 'a plain number'}", where=f"{where}: {role}")


def allowed_units(role: str) -> tuple[str, ...]:
    """SI units that columns of a role may have: increments of a sensor are integrals."""
    unit = ROLES[role][1]
    return {"rad/s": (unit, "rad"), "m/s^2": (unit, "m/s")}.get(unit, (unit,)) if role in ("gyro", "accel") else (unit,)


def preset_beside(path: Path) -> Path:
    """Where the map of a file stands; a path without a name (``.``) has one, too."""
    return path.parent / (path.name + ".map.yaml")


def read_preset(path: Path) -> ColumnMap | None:
    """The map that stands next to a file as ``NAME.map.yaml`` (or in its folder as ``map.yaml``), if there is one.

    Raises
    ------
    InputError
        No YAML mapping of roles and settings to text.
    """
    for preset in (preset_beside(path), path / "map.yaml"):
        if not preset.is_file():
            continue
        content = yamlfile.read(preset).data
        if isinstance(content, str):
            return parse_map(content, str(preset))
        if not isinstance(content, dict) or not content:
            raise InputError("expected roles and settings, such as 'gyro: omega_*[deg/s]'", where=str(preset))
        return parse_map(", ".join(f"{k}={v}" for k, v in content.items()), str(preset))
    return None


def write_preset(path: Path, used: ColumnMap) -> Path:
    """Write a map next to a file (``NAME.map.yaml``), so that it needs no option any more."""
    import yaml

    target = path / "map.yaml" if path.is_dir() else preset_beside(path)
    content = {part.partition("=")[0].strip(): part.partition("=")[2].strip() for part in _split(str(used), ",", "map")}
    put(target, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
    return target


_AXIS_ENDS = (("x", "y", "z"), ("1", "2", "3"), ("0", "1", "2"), ("n", "e", "d"), ("e", "n", "u"), ("n", "e", "u"))


def resolve(role: str, picks: Sequence[Pick], names: Sequence[str], where: str) -> list[tuple[int, Pick]]:
    """Rows of ``names`` that a role takes.

    Parameters
    ----------
    role : str
    picks : sequence of Pick
        Names or patterns.
    names : sequence of str
        Columns that the table has.
    where : str
        Table, for messages.

    Returns
    -------
    list of (int, Pick)

    Raises
    ------
    InputError
        No such column, or another number of them than the role has.
    """
    out: list[tuple[int, Pick]] = []
    for pick in picks:
        exact = [k for k, n in enumerate(names) if n == pick.column]
        found = exact or [k for k, n in enumerate(names) if fnmatchcase(n.lower(), pick.column.lower())]
        if not found:
            raise InputError(f"has no column '{pick.column}' for {role}" + nearest(pick.column, names), where=where)
        ends = [names[k].lower()[-1:] for k in found]
        order = next((o for o in _AXIS_ENDS if sorted(ends) == sorted(o)), None)
        if order and not exact:
            found.sort(key=lambda k: order.index(names[k].lower()[-1:]))
        out.extend((k, pick) for k in (found[:1] if exact else found))
    wanted = ROLES[role][0]
    if len(out) != wanted:
        raise InputError(
            f"{role} takes {wanted} column(s), '{' '.join(map(str, picks))}' names {len(out)}: "
            f"{', '.join(names[k] for k, _ in out[:8])}",
            where=where,
        )
    return out


# ---------------------------------------------------------------------------------------------------------------- guessing

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def split_header(cell: str) -> tuple[str, str]:
    """Name and unit of a header cell: ``gx [deg/s]``, ``Time (s)``, ``Sqrt (ug/sqrt(Hz))``; linear in its length."""
    text = cell.strip().strip('"').strip()[:400]
    if text.endswith(("]", ")")):
        opening = {"]": "[", ")": "("}[text[-1]]
        depth = 0
        for k in range(len(text) - 1, -1, -1):
            depth += (text[k] == text[-1]) - (text[k] == opening)
            if depth == 0:
                inner = text[k + 1 : -1].strip()
                return (text, "") if inner.isdigit() else (text[:k].strip(), inner)  # gyro_rad[0] is no unit
    return text, ""


def words_of(name: str) -> list[str]:
    """Lower-case words of a column's name: ``field.angular_velocity.x`` -> field, angular, velocity, x."""
    return [w.lower() for w in _WORDS.findall(name[:200])]


_GYRO_WORDS = {"gyro", "gyr", "gyroscope", "omega", "angvel", "gyros", "angrate", "rotationrate", "gyroscopes"}
_ACCEL_WORDS = {"accel", "acc", "acceleration", "accelerometer", "accelerometers", "accelerations"}
_NOT = set("mag magnetometer bias std sigma cov covariance user gravity error quat clipping orientation".split())
_VELOCITIES, _SPREADS = {"vel", "velocity", "v"}, {"std", "sigma"}
_REFERENCES = {"truth", "true", "ref", "reference"}
_SHORT = {
    "gyro": (("gx", "gy", "gz"), ("wx", "wy", "wz"), ("p", "q", "r")),
    "accel": (("ax", "ay", "az"), ("fx", "fy", "fz")),
}


def _triad(role: str, names: Sequence[str]) -> tuple[Pick, ...] | None:
    low = [n.lower() for n in names]
    for triple in _SHORT[role]:
        if all(low.count(t) == 1 for t in triple):
            return tuple(Pick(names[low.index(t)]) for t in triple)
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        words = words_of(name)
        if not words or set(words) & _NOT:
            continue
        for k in range(len(words) - 1, -1, -1):
            axis, stem = words[k], tuple(words[:k] + words[k + 1 :])
            if axis in ("0", "1", "2") and k == len(words) - 1:
                axis = "xyz"[int(axis)]
            if axis in ("x", "y", "z"):
                groups.setdefault(stem, {}).setdefault(axis, name)
                break
            if (
                len(axis) > 1
                and axis[-1] in "xyz"
                and axis[:-1] in _GYRO_WORDS | _ACCEL_WORDS | {"w", "a", "f", "g", "rate"}
            ):
                groups.setdefault((*words[:k], axis[:-1], *words[k + 1 :]), {}).setdefault(axis[-1], name)
                break
    for stem, axes in groups.items():
        if len(axes) == 3 and _is_role(role, stem):
            return tuple(Pick(axes[a]) for a in "xyz")
    return None


def several(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Columns of the gyroscopes of a table whose names differ in a number alone (``gyro1_x``, ``gyro2_x``), one triad each."""
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        words = words_of(english(name))
        digits = tuple(w for w in words if w.isdigit())
        axis = [w for w in words if w in ("x", "y", "z")]
        if (
            len(axis) == 1
            and digits
            and not set(words) & _NOT
            and _is_role("gyro", [w for w in words if w not in digits and w != axis[0]])
        ):
            found.setdefault(digits, {})[axis[0]] = name
    return [tuple(axes[a] for a in "xyz") for axes in found.values() if len(axes) == 3]


def _is_role(role: str, stem: Sequence[str]) -> bool:
    words = set(stem)
    if role == "gyro":
        angular = ("angular" in words and words & {"velocity", "rate", "vel"}) or {"ang", "rate"} <= words
        return bool(words & _GYRO_WORDS or angular or {"rotation", "rate"} <= words or stem[-1:] == ("w",))
    return bool(words & _ACCEL_WORDS or {"specific", "force"} <= words or stem[-1:] == ("a",))


#: Role -> sets of words of which all must be in a name (and nothing of :data:`_NOT`), best first.
_SINGLE: Mapping[str, tuple[frozenset[str], ...]] = {
    "lat": tuple(map(frozenset, ({"latitude"}, {"lat"}))),
    "lon": tuple(map(frozenset, ({"longitude"}, {"lon"}, {"lng"}, {"long"}))),
    "height": tuple(
        map(frozenset, ({"ellipsoid", "height"}, {"height"}, {"altitude"}, {"alt"}, {"hgt"}, {"h"}, {"elevation"}))
    ),
    "temperature": tuple(map(frozenset, ({"temperature"}, {"temp"}))),
    "speed": tuple(map(frozenset, ({"speed"}, {"groundspeed"}))),
    "course": tuple(map(frozenset, ({"course"}, {"cog"}, {"bearing"}, {"direction"}, {"track"}))),
    "pos_std_h": tuple(map(frozenset, ({"horizontal", "accuracy"}, {"h", "acc"}, {"hacc"}, {"eph"}))),
    "pos_std_v": tuple(map(frozenset, ({"vertical", "accuracy"}, {"v", "acc"}, {"vacc"}, {"epv"}))),
    "week": tuple(map(frozenset, ({"week"},))),
}


def _per_axis(*beginnings: str) -> tuple[tuple[str, str, str], ...]:
    """Names of north, east and vertical columns by how they begin; a standard deviation is the same up and down."""
    return tuple((f"{b}n", f"{b}e", f"{b}{vertical}") for b in beginnings for vertical in "du")


_VECTORS: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "vel_ned": (("vn", "ve", "vd"), ("v_n", "v_e", "v_d"), ("vel_n", "vel_e", "vel_d"), ("vnorth", "veast", "vdown"),
                ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), ("veln", "vele", "veld"), ("north velocity", "east velocity", "down velocity")),
    "vel_enu": (("ve", "vn", "vu"), ("east velocity", "north velocity", "up velocity"), ("vel_e", "vel_n", "vel_u"),
                ("v_e", "v_n", "v_u")),
    "pos_std_ned": _per_axis("pos_std_", "sd", "sd_", "std_", "sigma_", "pos_sigma_", "std_pos_", "sigma_pos_"),
    "vel_std_ned": _per_axis("vel_std_", "sdv", "sdv_", "sd_v", "std_v", "std_v_", "sigma_v", "sigma_v_", "vel_sigma_", "std_vel_", "sigma_vel_"),
    "rpy": (("roll", "pitch", "heading"), ("roll", "pitch", "yaw")),
}  # fmt: skip
_TIME_WORDS = ("time", "timestamp", "t", "stamp", "millis", "micros", "tow", "sow", "timestamps", "seconds", "secs", "sec", "datetime", "utc",
               "date")  # fmt: skip


def guess_map(names: Sequence[str], columns: Sequence[NDArray[np.float64]] | None = None) -> ColumnMap:
    """Guess what the columns of a table are from their names (and which one is the time from its values).

    Parameters
    ----------
    names : sequence of str
        Column names without units.
    columns : sequence of (n,) arrays, optional
        Values.

    Returns
    -------
    ColumnMap
        Empty where nothing is known.
    """
    picks: dict[str, tuple[Pick, ...]] = {}
    written, names = list(names), [english(n) for n in names]
    at = _time(names, columns)
    if at is not None:
        picks["time"] = (Pick(names[at]),)
        fraction = _fraction(names, at)
        if fraction is not None:
            picks["nanoseconds"] = (Pick(names[fraction], "ns"),)
    for role in ("gyro", "accel"):
        found = _triad(role, names)
        if found:
            picks[role] = found
    low = [n.lower() for n in names]
    for role, triples in _VECTORS.items():
        for triple in triples:
            if all(t in low for t in triple) and not (role == "vel_enu" and "vel_ned" in picks):
                picks[role] = tuple(Pick(names[low.index(t)]) for t in triple)
                break
    picks = _framed(names) | picks
    taken = {p.column for ps in picks.values() for p in ps}
    for role, options in _SINGLE.items():
        for wanted in options:
            found_name = next(
                (
                    n
                    for n in names
                    if n not in taken and wanted <= set(words_of(n)) and not (_NOT - {"gravity"}) & set(words_of(n))
                ),
                None,
            )
            if found_name and not (role in ("lat", "lon", "height") and "accuracy" in words_of(found_name)):
                picks[role] = (Pick(found_name),)
                break
    if "lat" not in picks or "lon" not in picks:
        for role in ("lat", "lon", "height", "speed", "course", "pos_std_h", "pos_std_v"):
            picks.pop(role, None)
    back = dict(zip(reversed(names), reversed(written), strict=True))
    return ColumnMap({r: tuple(replace(p, column=back[p.column]) for p in ps) for r, ps in picks.items()})


def _framed(names: Sequence[str]) -> dict[str, tuple[Pick, ...]]:
    """Vectors of fixes whose names say what they are and in which frame, with a number or x, y, z for each component: ``vel_ned_0``."""
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        *stem, axis = words_of(name) or [""]
        said, spread = set(stem), bool(set(stem) & _SPREADS)
        what = "vel" if said & _VELOCITIES else "pos" if spread and said & {"pos", "position"} else ""
        for frame in (
            sorted(said & {"ned", "enu", "neu"}) if what and not said & (_NOT - _SPREADS | _REFERENCES) else ()
        ):
            role = f"{what}_std_{frame}" if spread else f"{what}_{frame}"
            groups.setdefault(role, {}).setdefault({"0": "x", "1": "y", "2": "z"}.get(axis, axis), name)
    return {
        role: tuple(Pick(axes[a]) for a in "xyz")
        for role, axes in groups.items()
        if role in ROLES and {*"xyz"} <= set(axes)
    }


def _time(names: Sequence[str], columns: Sequence[NDArray[np.float64]] | None) -> int | None:
    """The column of times: called so, and rising; of several the finest that rises throughout."""
    best: tuple[float, int] | None = None
    for k, name in enumerate(names):
        words = words_of(name)
        called = [_TIME_WORDS.index(w) for w in words if w in _TIME_WORDS]
        if not called or set(words) & {"week", "offset", "since", "nsecs", "nanosec", "nsec", "accuracy"} - {"since"}:
            continue
        score = float(min(called)) + 0.01 * k
        if columns is not None:
            step = np.diff(np.asarray(columns[k], dtype=np.float64))
            step = step[np.isfinite(step)]
            if not step.size or np.mean(step >= 0) < 0.9 or np.ptp(step) == 0.0 == float(step[0]):
                continue
            score += 30.0 * float(np.mean(step == 0))
        if {"header", "stamp"} & set(words):  # when it was measured rather than received
            score -= 5.0
        if best is None or score < best[0]:
            best = (score, k)
    return None if best is None else best[1]


def _fraction(names: Sequence[str], at: int) -> int | None:
    """The column of nanoseconds that belongs to one of whole seconds (``secs`` and ``nsecs``)."""
    pairs = (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec"))
    for whole, part in pairs:
        if names[at].lower().endswith(whole):
            wanted = names[at].lower()[: -len(whole)] + part
            return next((k for k, n in enumerate(names) if n.lower() == wanted), None)
    return None


def guessed_line(names: Iterable[str], columns: Sequence[NDArray[np.float64]] | None = None) -> str:
    """The map that would be guessed, as a line to copy; roles that are open are left to fill in."""
    names = list(names)
    guess = guess_map(names, columns)
    picks = dict(guess.picks)
    open_names = [n for n in names if n not in {p.column for ps in picks.values() for p in ps}]
    if not {"gyro", "accel", "lat"} & set(picks) and len(open_names) >= 6:
        picks["gyro"] = tuple(Pick(n, "rad/s") for n in open_names[:3])
        picks["accel"] = tuple(Pick(n, "m/s^2") for n in open_names[3:6])
    units = {"gyro": "rad/s", "accel": "m/s^2", "time": "s", "lat": "deg", "lon": "deg", "height": "m"}
    return str(
        ColumnMap(
            {r: tuple(replace(p, unit=p.unit or units.get(r)) for p in ps) for r, ps in picks.items()}, guess.settings
        )
    )
