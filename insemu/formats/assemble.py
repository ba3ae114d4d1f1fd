"""From mapped tables to records: units to SI, axes to forward-right-down, clocks to one, and a note of everything that was taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.errors import InputError, found_at
from insemu.formats import clocks
from insemu.formats.angles import DIGITS, digits, place_unit
from insemu.formats.axes import axes_matrix, axis_order
from insemu.formats.columns import ROLES, UNIT_SETTING, ColumnMap, guessed_line, resolve
from insemu.formats.table import Table
from insemu.records import ImuKind, ImuRecord
from insemu.sample_times import continuous, in_order, sample_times
from insemu.stamps import SECOND, counted
from insemu.units import parse, parse_unit, scaled_unit

Array = NDArray[np.float64]

#: Unit that a column without one is taken to have where it is not SI.
_USUAL = {"lat": "deg", "lon": "deg", "course": "deg", "rpy": "deg", "roll": "deg", "pitch": "deg", "heading": "deg"}

#: Most columns without a role that are listed by name.
NAMED = 12


@dataclass
class Story:
    """What was taken, assumed and done on the way; the card prints it."""

    taken: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    repeated: int = 0
    missing: int = 0
    units: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Columns:
    """Values of a table's roles in SI, rows without a time left out.

    Parameters
    ----------
    table : Table
    start : int
        ns on the table's clock from which ``t`` counts.
    t : (n,) array
        s.
    values : mapping of str to (n,) or (n, k) arrays
        By role, SI.
    kind : str
        Of the IMU's rows.
    settings : mapping of str to str
    """

    table: Table
    start: int
    t: Array
    values: Mapping[str, Array]
    kind: ImuKind
    settings: Mapping[str, str]

    @property
    def first(self) -> float:
        """The first time on the table's clock, s; 0 where there is none."""
        return self.start / SECOND + float(self.t[0]) if self.t.size else 0.0

    def since(self, start: int) -> Columns:
        """The same rows with times from elsewhere, ns on the table's clock."""
        moved = self.start - start
        return replace(self, start=start, t=self.t + moved / SECOND) if moved else self


def columns_of(table: Table, user: ColumnMap, story: Story) -> Columns | None:
    """Take the roles of a table; None where it has none.

    Parameters
    ----------
    table : Table
    user : ColumnMap
        What the user says; goes before the table's own map.
    story : Story
        Gets what was taken, assumed and left out.

    Raises
    ------
    InputError
        A column or unit that does not fit; no stamps and no rate.
    """
    used = _given(table, user).over(table.map)
    names = list(table.columns)
    where = table.name
    roles = [r for r in used.picks if r not in ("time", "nanoseconds", "week")]
    if not roles:
        return None
    values: dict[str, Array] = {}
    integrals = []
    places = place_unit(used, table, names)
    if places and "pos_unit" not in used.settings:
        story.assumed.append(f"latitude and longitude in {places}: as degrees they would be beyond 90 and 180")
    for role in roles:
        units, found = [], []
        picked = resolve(role, used.picks[role], names, where)
        block = np.empty((len(table), len(picked)))
        for column, (k, pick) in zip(block.T, picked, strict=True):
            unit = pick.unit if pick.unit is not None else table.units.get(names[k], "")
            unit = used.settings.get(UNIT_SETTING.get(role, ""), unit)
            if role in ("lat", "lon"):
                unit = places or unit
                if unit in DIGITS:
                    column[:], unit = digits(table.columns[names[k]], unit), "deg"
                    np.multiply(column, np.pi / 180.0 * pick.sign, out=column)
                    units.append(unit)
                    found.append(("-" if pick.sign < 0 else "") + names[k])
                    continue
            factor, integral = _factor(role, unit, f"{where}: {names[k]}")
            integrals.append((role, integral))
            np.multiply(table.columns[names[k]], factor * pick.sign, out=column)
            units.append(unit)
            found.append(("-" if pick.sign < 0 else "") + names[k])
        values[role] = block[:, 0] if len(picked) == 1 else block
        story.units[role] = units[0]
        if f"{role}_axes" in used.settings:
            values[role] = values[role] @ axis_order(used.settings[f"{role}_axes"], where).T
        _say(role, found, units, story, table)
    named = {names[k] for role, picks in used.picks.items() for k, _ in resolve(role, picks, names, where)}
    if unused := [name for name in names if name not in named]:
        more = f" and {len(unused) - NAMED} more" if len(unused) > NAMED else ""
        story.taken.append(f"nothing from {', '.join(unused[:NAMED])}{more} of {where}")
    kind = _kind(used.settings, integrals, where)
    rows = next(iter(values.values())).shape[0]
    start, t, unit_s = _times(table, used, names, rows, "gyro" in values or "accel" in values, story)
    start += table.start
    good = np.isfinite(t)
    if not good.all():
        story.missing += int((~good).sum())
        t, values = t[good], {r: v[good] for r, v in values.items()}
    t, said = continuous(t, unit_s)
    story.notes += [f"{where}: {text}" for text in said]
    return Columns(table, start, t, values, kind, used.settings)


def _given(table: Table, user: ColumnMap) -> ColumnMap:
    """Roles of the user's map whose columns this table has (of several tables each takes its own); settings always."""
    names = list(table.columns)
    kept = {}
    for role, picks in user.picks.items():
        try:
            resolve(role, picks, names, table.name)
        except InputError:
            continue
        kept[role] = picks
    return ColumnMap(kept, user.settings)


def _factor(role: str, unit: str, where: str) -> tuple[float, bool]:
    """Factor to SI, and whether the unit is that of an increment."""
    si = ROLES[role][1]
    if role in ("week", "quality", "quaternion", "quaternion_xyzw"):
        return 1.0, False
    if role == "temperature":
        return 1.0, False
    if not unit.strip() or unit.lower() in ("counts", "raw", "-"):
        return parse_unit(_USUAL.get(role, si)).factor, False
    with found_at(where):
        found = scaled_unit(unit)
    if si == "m/s" and found.dimension == parse_unit("m").dimension:  # speeds called after their length
        return found.factor, False
    if found.dimension == parse_unit(si).dimension:
        return found.factor, False
    if role in ("gyro", "accel") and found.dimension == parse_unit({"gyro": "rad", "accel": "m/s"}[role]).dimension:
        return found.factor, True
    raise InputError(f"has the unit '{unit}', expected one of the dimension of {si} for {role}", where=where)


def _say(role: str, found: Sequence[str], units: Sequence[str], story: Story, table: Table) -> None:
    picks = " ".join(found)
    shown = picks if len(picks) < 60 else picks[:57] + "..."
    unit = units[0]
    if unit.strip() or ROLES[role][1] == "" or role == "temperature":
        story.taken.append(f"{role} from {shown} ({unit or 'plain'}) of {table.name}")
        return
    usual = _USUAL.get(role, ROLES[role][1])
    story.taken.append(f"{role} from {shown} of {table.name}")
    if role in ("gyro", "accel", "lat") or "vel" in role:
        story.assumed.append(f"{role} in {usual}: {table.name} states no unit")


def _kind(settings: Mapping[str, str], integrals: Sequence[tuple[str, bool]], where: str) -> ImuKind:
    imu = {integral for role, integral in integrals if role in ("gyro", "accel")}
    if len(imu) == 2:
        raise InputError("some axes have units of rates and others of increments", where=where)
    stated = settings.get("kind", "")
    if stated and stated not in get_args(ImuKind):
        raise InputError(f"is '{stated}', expected one of: {', '.join(get_args(ImuKind))}", where=f"{where}: kind")
    return stated or ("increment" if imu == {True} else "sample")  # type: ignore[return-value]


def _times(
    table: Table, used: ColumnMap, names: list[str], rows: int, imu: bool, story: Story
) -> tuple[int, Array, float]:
    """The first stamp in ns, the times from it in s, and the unit of the stamps in s."""
    settings = used.settings
    if "time" not in used.picks:
        if "rate" not in settings:
            raise InputError(
                f"has no column of times; say which (--map 'time=...') or the rate (--map 'rate=100 Hz'). Columns: {', '.join(names[:12])}",
                where=table.name,
            )
        rate = parse(settings["rate"], "Hz")
        if not rate > 0:
            raise InputError(f"rate is {settings['rate']}, expected a positive one", where=table.name)
        return 0, np.asarray(np.arange(rows) / rate), 1.0
    ((at, pick),) = resolve("time", used.picks["time"], names, table.name)
    stamps = np.asarray(table.columns[names[at]])
    unit = pick.unit if pick.unit is not None else table.units.get(names[at], "")
    unit = settings.get("time_unit", unit)
    where, fastest = f"{table.name}: {names[at]}", 5.0 if imu else np.inf
    start, t, scale, assumed = clocks.read_stamps(stamps, names[at], unit, where, fastest)
    story.assumed += [assumed] * bool(assumed)
    for role, size in (("nanoseconds", 1e-9), ("week", clocks.WEEK)):
        if role in used.picks:
            ((part, _),) = resolve(role, used.picks[role], names, table.name)
            more, since = counted(np.asarray(table.columns[names[part]]), size)
            start, t = start + more, t + since
    return start, t, scale


def clock_of(columns: Columns) -> str:
    """Clock of a table: stated by the map, the format, the columns' names, or guessed from the size of its times."""
    stated = columns.settings.get("clock") or columns.table.clock
    if stated:
        if stated not in clocks.CLOCKS:
            raise InputError(f"is '{stated}', expected gps, sow or unix", where=f"{columns.table.name}: clock")
        return stated
    if not columns.t.size:
        return ""
    first = columns.first
    if "week" in columns.table.map.picks:
        return "gps"
    names = " ".join(columns.table.columns).lower()
    if 0 <= first < 2 * clocks.WEEK and ("tow" in names or "sow" in names):
        return "sow"
    if 8.0e8 < first < 4.2e9:
        return "gps" if "gps" in names and "utc" not in names and first < 1.6e9 else "unix"
    return ""


# ------------------------------------------------------------------------------------------------------------------- records


#: Share of the rows above which leaving them out is no way to read a file.
MOST_LEFT_OUT = 0.01


def timed(
    t: Array, values: Sequence[Array], story: Story, what: str, *, imu: bool = False
) -> tuple[NDArray[np.intp], Array]:
    """Rows in the order of time, and their times: of an IMU those of its samples, of fixes the stamps, but where many rows share one.

    Parameters
    ----------
    t : (n,) array
        Stamps, s.
    values : sequence of (n, k) arrays
        By which repeated rows are known.
    story : Story
        Gets what was done.
    what : str
        What its notes call the table.
    imu : bool
    """
    same = np.concatenate([[False], values[0][1:, 0] == values[0][:-1, 0]])
    alike = np.flatnonzero(same)  # few rows: only they are compared in all columns
    same[alike] = np.all([(v[alike] == v[alike - 1]).all(axis=1) for v in values], axis=0)
    if not imu:
        rows, said = in_order(t, same)
        fresh = np.concatenate([[True], t[rows[1:]] > np.maximum.accumulate(t[rows])[:-1]])
        left_out = int((~fresh).sum())
        if left_out <= MOST_LEFT_OUT * t.size:
            story.repeated += left_out
            said += (f"{left_out} row(s) share a stamp with another; one of them is used",) * bool(left_out)
            story.notes += [f"{what}: {text}" for text in said]
            return rows[fresh], t[rows[fresh]]
    found = sample_times(t, same)
    story.notes += [f"{what}: {text}" for text in found.said]
    return found.rows, found.t


def mounting_of(settings: Mapping[str, str], where: str) -> Array | None:
    """Matrix from the file's IMU axes to vehicle axes, from ``axes`` and ``mount``."""
    matrix = axes_matrix(settings["axes"]) if settings.get("axes") else None
    if settings.get("mount"):
        turn = rotation.dcm_from_rpy(np.deg2rad(numbers_of(settings["mount"], 3, f"{where}: mount")))
        matrix = turn if matrix is None else turn @ matrix
    return matrix


def numbers_of(text: str, count: int, where: str) -> Array:
    """Several numbers in a setting.

    Parameters
    ----------
    text : str
        Numbers with blanks between them; a ``deg`` at the end is removed.
    count : int
        How many are expected.
    where : str
        Setting, for the message.

    Returns
    -------
    (count,) array
        As written, not converted.

    Raises
    ------
    InputError
        Another count, or what is no finite number.
    """
    try:
        out = np.array([float(w) for w in text.removesuffix("deg").split()])
    except ValueError:
        out = np.array([])
    if out.size != count or not np.isfinite(out).all():
        raise InputError(f"is '{text[:60]}', expected {count} numbers", where=where)
    return out


def imu_of(parts: Sequence[Columns], story: Story) -> ImuRecord:
    """One record of the tables that hold gyroscope and accelerometer, together or apart (phones); its times count from the first table's start.

    Raises
    ------
    InputError
        A sensor is missing; fewer than three rows; rows that are not finite.
    """
    parts = [p.since(parts[0].start) for p in parts]
    both = next((p for p in parts if "gyro" in p.values and "accel" in p.values), None)
    if both is not None and _share_partly(both) <= MOST_LEFT_OUT:
        first, accel = both, both.values["accel"]
    else:
        gyro, other = (next((p for p in parts if r in p.values), None) for r in ("gyro", "accel"))
        if gyro is None or other is None:
            have, lacks = ("accel", "gyro") if gyro is None else ("gyro", "accel")
            names = [n for p in parts for n in p.table.columns]
            raise InputError(
                f"has columns of {have} and none of {lacks}; say which (--map '{lacks}=...'). Columns: {', '.join(names[:16])}",
                where=parts[0].table.name,
            )
        if gyro is other:
            story.notes.append("rows hold gyroscope or accelerometer: each is taken at its own stamps")
        gyro, other = _only(gyro, "gyro", story), _only(other, "accel", story)
        span = (gyro.t >= other.t[0]) & (gyro.t <= other.t[-1])
        if span.sum() < 3:
            raise InputError(f"and {other.table.name} share less than 3 stamps", where=gyro.table.name)
        first = _rows(gyro, np.flatnonzero(span))
        accel = np.column_stack([np.interp(first.t, other.t, other.values["accel"][:, k]) for k in range(3)])
        if first.t.size != other.t.size or not np.array_equal(first.t, other.t):
            story.notes.append("the accelerometer has stamps of its own; it was interpolated to the gyroscope's")
    gyro_values = first.values["gyro"]
    temperature = first.values.get("temperature")
    rows, given = np.arange(first.t.size), (gyro_values, accel)
    if not all(np.isfinite(v).all() for v in given):
        rows = np.flatnonzero(np.isfinite(np.hstack(given)).all(axis=1))
        given = gyro_values[rows], accel[rows]
    story.missing += first.t.size - rows.size
    if first.t.size - rows.size:
        story.notes.append(f"IMU: {first.t.size - rows.size} of {first.t.size} rows hold no number; they were left out")
    if rows.size < 3:
        raise InputError(f"has {rows.size} usable row(s) of IMU data, expected at least 3", where=first.table.name)
    order, t = timed(first.t[rows], given, story, "IMU", imu=True)
    rows = rows[order]
    if not np.array_equal(rows, np.arange(first.t.size)):
        gyro_values, accel = gyro_values[rows], accel[rows]
        temperature = temperature if temperature is None else temperature[rows]
    turn = mounting_of(first.settings, first.table.name)
    if turn is not None:
        gyro_values, accel = gyro_values @ turn.T, accel @ turn.T
        said = ", ".join(f"{k}={first.settings[k]}" for k in ("axes", "mount") if first.settings.get(k))
        story.taken.append(f"axes turned into forward-right-down ({said})")
    if temperature is not None:
        temperature = temperature if np.isfinite(temperature).all() else None
    inside, gyro_values, accel = _delayed(t, gyro_values, accel, first, story)
    t, temperature = t[inside], temperature if temperature is None else temperature[inside]
    if "shift" in first.settings:
        t = t + parse(first.settings["shift"], "s")
    return ImuRecord(t, gyro_values, accel, first.kind, temperature)


def _delayed(t: Array, gyro: Array, accel: Array, part: Columns, story: Story) -> tuple[slice, Array, Array]:
    """Signals of sensors whose stamps are moved (``gyro_shift``, ``accel_shift``), interpolated to the rows; which rows both sensors reach."""
    shifts = [parse(part.settings.get(f"{role}_shift", "0 s"), "s") for role in ("gyro", "accel")]
    if not any(shifts):
        return slice(None), gyro, accel
    low, high = np.searchsorted(t, t[0] + max(*shifts, 0.0)), np.searchsorted(t, t[-1] + min(*shifts, 0.0), "right")
    if high - low < 3:
        raise InputError(
            f"moves a sensor by {max(shifts, key=abs):.6g} s, more than the record of {t[-1] - t[0]:.6g} s holds",
            where=part.table.name,
        )
    inside = slice(int(low), int(high))
    story.taken += [
        f"{name} moved by {shift:+.6g} s and interpolated"
        for name, shift in zip(("gyroscope", "accelerometer"), shifts, strict=True)
        if shift
    ]
    gyro, accel = (
        v[inside] if not shift else np.column_stack([np.interp(t[inside], t + shift, c) for c in v.T])
        for v, shift in zip((gyro, accel), shifts, strict=True)
    )
    return inside, gyro, accel


def _rows(part: Columns, rows: NDArray[np.intp]) -> Columns:
    return replace(part, t=part.t[rows], values={r: v[rows] for r, v in part.values.items()})


def _share_partly(part: Columns) -> float:
    """Share of rows that hold one of the sensors and not the other."""
    if all(np.isfinite(part.values[role]).all() for role in ("gyro", "accel")):
        return 0.0
    gyro, accel = (np.isfinite(part.values[role]).all(axis=1) for role in ("gyro", "accel"))
    return float(np.mean(gyro ^ accel)) if gyro.size else 0.0


def _only(part: Columns, role: str, story: Story) -> Columns:
    good = _rows(part, np.flatnonzero(np.isfinite(part.values[role]).all(axis=1)))
    if not good.t.size:
        raise InputError("holds no row of numbers", where=part.table.name)
    rows, t = timed(good.t, (good.values[role],), story, f"{part.table.name}, {role}", imu=True)
    return replace(_rows(good, rows), t=t)


def unknown(table: Table, path: Path | str) -> InputError:
    """What to say of a table in which nothing was recognised: its columns and the map that would be guessed."""
    names = list(table.columns)
    line = guessed_line(names, list(table.columns.values())) if names else ""
    return InputError(
        f"holds columns {', '.join(names[:16])}{', ...' if len(names) > 16 else ''}, of which none is known as a gyroscope, an "
        f"accelerometer or a position; say what they are, for example --map '{line}'",
        where=str(path),
    )
