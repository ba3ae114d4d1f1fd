"""Open anything: one file, a folder, or several files that make one recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.errors import InputError
from insemu.formats import clocks
from insemu.formats.assemble import Columns, Story, clock_of, columns_of, imu_of, mounting_of, unknown
from insemu.formats.columns import ColumnMap, parse_map, read_preset
from insemu.formats.decoding import decoding
from insemu.formats.places import attitude, gnss_of, has_position, reference_of
from insemu.formats.table import Besides, Reader, Table, reader_of
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Preparation, Reading, Recording, Trajectory
from insemu.stamps import OWN, SECOND, Origin, counted
from insemu.units import parse

Array = NDArray[np.float64]
_Record = TypeVar("_Record", ImuRecord, GnssRecord, Trajectory)

#: Settings of the fixes, which belong to the file of the fixes where that is another one.
OF_FIXES = ("latlon", "pos_unit", "height_unit", "vel_unit", "velocity", "gnss_shift", "gnss_move")


@dataclass(frozen=True)
class Again:
    """The same files, read with further settings.

    Parameters
    ----------
    path, gnss, truth : path
        As of :func:`open_files`.
    maps : three maps
    """

    path: Path
    gnss: Path | None
    truth: Path | None
    maps: tuple[ColumnMap, ColumnMap, ColumnMap]

    def _shared_out(self, settings: Mapping[str, str]) -> tuple[ColumnMap, ColumnMap]:
        apart = {k: v for k, v in settings.items() if k in OF_FIXES and self.gnss is not None}
        return ColumnMap({}, {k: v for k, v in settings.items() if k not in apart}), ColumnMap({}, apart)

    def read(self, settings: Mapping[str, str]) -> Opened:
        """Read the files with these settings over the maps."""
        main, fixes = self._shared_out(settings)
        given = main.over(self.maps[0]), fixes.over(self.maps[1]), self.maps[2]
        return open_files(self.path, gnss=self.gnss, truth=self.truth, maps=given)

    def options(self, settings: Mapping[str, str]) -> str:
        """What is added to the command, the maps that were given included."""
        main, fixes = self._shared_out(settings)
        maps = {"--map": main.over(self.maps[0]), "--gnss-map": fixes.over(self.maps[1])}
        files = [f'--gnss "{self.gnss}"'] if self.gnss is not None else []
        return " ".join([*files, *(f'{name} "{m}"' for name, m in maps.items() if m)])


@dataclass(frozen=True)
class Opened:
    """What was found in one or several files.

    Parameters
    ----------
    source : str
        The files.
    kind : str
        What they were taken for.
    imu, gnss, reference : records, optional
        What they hold.
    taken : tuple of str
        Which columns became what.
    assumed : tuple of str
        What nobody said and was taken for granted.
    notes : tuple of str
        What was done on the way.
    repeated, missing : int
        Rows that were left out: of fixes those that share a stamp with another, and those without a number.
    aids : tuple of AidRecord
        Measurements other than IMU and fixes, as they are in the file.
    initial : InitialState, optional
        Where a filter may start.
    preparation : Preparation, optional
        What was done to it before it was written.
    origin : Origin
        When time 0 was: the second of the first row of the IMU, or of the fixes or the reference where there is none.
    units : mapping of str to str
        Units that were taken, by role.
    again : Again, optional
        Reads the same files with further settings.
    accepted : bool
        Whether a map declares that what contradicts physics is right.
    """

    source: str
    kind: str
    imu: ImuRecord | None = None
    gnss: GnssRecord | None = None
    reference: Trajectory | None = None
    taken: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    repeated: int = 0
    missing: int = 0
    aids: tuple[AidRecord, ...] = ()
    origin: Origin = OWN
    initial: InitialState | None = None
    preparation: Preparation | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    again: Again | None = None
    accepted: bool = False

    def recording(self) -> Recording:
        """The canonical recording; raises :class:`~insemu.errors.InputError` where there is no IMU."""
        if self.imu is None:
            raise InputError(
                "holds no IMU data; name the file that does, and these fixes with --gnss", where=self.source
            )
        return Recording(
            self.imu,
            self.gnss,
            self.reference,
            self.source,
            self.aids,
            self.initial,
            self.origin,
            self.notes,
            self.preparation,
            Reading(
                self.kind,
                self.taken,
                self.assumed,
                self.notes,
                self.units,
                self.repeated,
                self.missing,
                self.accepted,
            ),
        )


@dataclass(frozen=True)
class _File:
    """One file as it was read: columns by table."""

    path: Path
    reader: Reader
    parts: list[Columns]


def open_files(
    path: str | Path,
    *,
    gnss: str | Path | None = None,
    truth: str | Path | None = None,
    maps: tuple[str | ColumnMap, str | ColumnMap, str | ColumnMap] = ("", "", ""),
) -> Opened:
    """Read foreign files into one set of records on one clock.

    Parameters
    ----------
    path : path
        The file or folder with the IMU (and all else that it holds).
    gnss, truth : path, optional
        Files with the fixes and the reference, where they are apart.
    maps : three maps or their lines
        Column maps of the three files, over the preset next to each (``NAME.map.yaml``) and what the format says.

    Returns
    -------
    Opened

    Raises
    ------
    InputError
        A file that no reader takes, or that cannot be read; nothing known in it (the message prints the map that would be guessed).
    FileNotFoundError
        No such file.
    """
    story = Story()
    files = [
        _read(Path(p), m, story) if p is not None else None for p, m in zip((path, gnss, truth), maps, strict=True)
    ]
    main, fixes, reference = files
    assert main is not None
    origin = None
    imu = None
    inertial = [p for p in main.parts if {"gyro", "accel"} & set(p.values)]
    if inertial:
        clock = clock_of(inertial[0])
        with decoding(main.path, main.reader.name):
            imu = imu_of(inertial, story)
        first, t = counted(imu.t)
        origin, imu = Origin(inertial[0].start + first, clock), replace(imu, t=t)
    if (
        main.parts
        and main.parts[0].settings.get("rate")
        and imu is not None
        and "time" not in main.parts[0].table.map.picks
    ):
        story.assumed.append(f"stamps from the rate of {main.parts[0].settings['rate']}")
    gnss_part = _positions(fixes or main, apart=fixes is not None)
    truth_part = _truth(reference or main, gnss_part, apart=reference is not None)
    gnss_record, truth_record = None, None
    if gnss_part is not None and gnss_part is not truth_part:
        with decoding((fixes or main).path, (fixes or main).reader.name):
            gnss_part, origin = _on_clock(gnss_part, origin, story)
            try:
                gnss_record = gnss_of(gnss_part, story)
            except InputError as error:  # a setting of the fixes belongs to their file
                said = error.message if fixes is None else error.message.replace("--map ", "--gnss-map ")
                raise InputError(said, where=error.where) from None
    if truth_part is not None:
        with decoding((reference or main).path, (reference or main).reader.name):
            truth_part, origin = _on_clock(truth_part, origin, story)
            truth_record = reference_of(truth_part, story)
    if imu is None and gnss_record is None and truth_record is None:
        raise unknown(max((p.table for p in main.parts), key=len), path)
    assert origin is not None
    settings = main.parts[0].settings if main.parts else {}
    imu, gnss_record, truth_record = _span(settings, imu, gnss_record, truth_record, str(path))
    given = [f for f in files if f is not None]
    aids, initial, preparation = _besides(main, origin) if imu is not None else ((), None, None)
    return Opened(
        ", ".join(str(f.path) for f in given),
        ", ".join(dict.fromkeys(f.reader.name for f in given)),
        imu,
        gnss_record,
        truth_record,
        tuple(dict.fromkeys(story.taken)),
        tuple(dict.fromkeys(story.assumed)),
        tuple(dict.fromkeys(story.notes)),
        story.repeated,
        story.missing,
        aids,
        origin,
        initial,
        preparation,
        dict(story.units),
        Again(
            Path(path),
            None if gnss is None else Path(gnss),
            None if truth is None else Path(truth),
            (_map_of(maps[0]), _map_of(maps[1]), _map_of(maps[2])),
        ),
        any("contradictions" in p.settings for f in given for p in f.parts),
    )


def _map_of(given: str | ColumnMap) -> ColumnMap:
    return given if isinstance(given, ColumnMap) else parse_map(given)


def _read(path: Path, given: str | ColumnMap, story: Story) -> _File:

    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    user = _map_of(given)
    preset = read_preset(path)
    if preset is not None:
        user = user.over(preset)
        story.notes.append(f"the column map next to {path.name} was used")
    reader = reader_of(path)
    if reader is None:
        raise InputError(
            "no reader knows this file; `insemu open --formats` lists what is read. A table can be given as CSV with a column map (--map)",
            where=str(path),
        )
    with decoding(path, reader.name):
        tables = reader.read(path, user.settings)
        parts = [p for t in tables if (p := columns_of(t, user, story)) is not None]
        for table in tables:
            story.assumed.extend(table.assumed)
            story.notes.extend(table.notes)
    _all_used(user, tables, path)
    if not parts:
        if not tables:
            raise InputError("holds no table", where=str(path))
        raise unknown(max(tables, key=lambda t: (len(t.columns), len(t))), path)
    return _File(path, reader, parts)


def _all_used(user: ColumnMap, tables: list[Table], path: Path) -> None:
    """Every role of the user's map must have found its columns somewhere: otherwise the reason from the likeliest table is raised."""
    from insemu.formats.columns import resolve

    for role, picks in user.picks.items():
        first = None
        for table in sorted(tables, key=lambda t: -len(t.columns)):
            try:
                resolve(role, picks, list(table.columns), table.name)
                break
            except InputError as error:
                first = first or error
        else:
            raise first or InputError(f"holds no table for '{role}'", where=str(path))


def _positions(file: _File, *, apart: bool) -> Columns | None:
    found = [p for p in file.parts if has_position(p)]
    plain = [p for p in found if not ({"rpy", "roll", "quaternion", "quaternion_xyzw"} & set(p.values)) or apart]
    if apart and not found:
        raise unknown(max((p.table for p in file.parts), key=len), file.path)
    # an IMU's own file with attitudes in it: the fixes are in it too
    if plain:
        return plain[0]
    return found[0] if found and "gyro" in found[0].values else None


def _truth(file: _File, fixes: Columns | None, *, apart: bool) -> Columns | None:
    for part in file.parts:
        if has_position(part) and (
            apart or (part is not fixes and {"rpy", "quaternion", "quaternion_xyzw"} & set(part.values))
        ):
            if apart and attitude(part) is None:
                continue
            return part
    if apart:
        raise InputError(
            "has no position and attitude, which a truth needs; fixes are given with --gnss", where=str(file.path)
        )
    return None


def _on_clock(part: Columns, origin: Origin | None, story: Story) -> tuple[Columns, Origin]:
    """A table with times from the origin, on its clock; without one from the second of its own first row, and that as the origin."""
    own = clock_of(part)
    if origin is None:
        first, t = counted(part.t)
        return replace(part, start=part.start + first, t=t), Origin(part.start + first, own)
    moved, done = clocks.converted(np.array([part.first]), own, origin.clock, origin.ns / SECOND)
    if done:
        story.notes.append(f"{part.table.name}: {done}")
    shift = round(float(moved[0]) - part.first) * SECOND  # clocks differ by whole seconds
    return replace(part, start=part.start + shift).since(origin.ns), origin


def _besides(file: _File, origin: Origin) -> Besides:
    """Aids, initial state and preparation with times from the origin, the attitude in the axes that the map makes of the file's."""
    if file.reader.besides is None:
        return (), None, None
    settings, since = file.parts[0].settings, (origin.ns - file.parts[0].table.start) / SECOND
    late = parse(settings.get("shift", "0 s"), "s") - since  # aids and initial state are on the clock of the IMU
    aids, initial, done = file.reader.besides(file.path)
    if initial is not None:
        turn, attitude = mounting_of(settings, str(file.path)), rotation.dcm_from_rpy(initial.rpy)
        rpy = initial.rpy if turn is None else rotation.rpy_from_dcm(attitude @ turn.T)
        initial = replace(initial, t=initial.t + late, rpy=rpy)
    if done is not None and done.gnss is not None:
        done = replace(done, gnss=replace(done.gnss, t=done.gnss.t - since))
    return tuple(a.later(late) for a in aids), initial, done


def _span(
    settings: object, imu: ImuRecord | None, gnss: GnssRecord | None, truth: Trajectory | None, where: str
) -> tuple[ImuRecord | None, GnssRecord | None, Trajectory | None]:
    """Only what lies between ``from`` and ``to``, counted from the origin."""
    assert hasattr(settings, "get")
    first, last = settings.get("from"), settings.get("to")
    if first is None and last is None:
        return imu, gnss, truth
    low = parse(first, "s") if first is not None else -np.inf
    high = parse(last, "s") if last is not None else np.inf

    def cut(record: _Record | None) -> _Record | None:
        if record is None:
            return None
        inside = (record.t >= low) & (record.t <= high)
        if not inside.any():
            raise InputError(f"nothing lies between {first or 'the start'} and {last or 'the end'}", where=where)
        return record.rows(inside)

    return cut(imu), cut(gnss), cut(truth)
