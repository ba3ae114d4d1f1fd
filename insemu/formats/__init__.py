"""The field's files, in and out: :func:`read`, :func:`write`, and :func:`open_files` for whatever others write.

Static logs (sensor at rest, constant rate) become a list of :class:`~insemu.records.Series`; dynamic recordings become a
:class:`~insemu.records.Recording`. Units are converted to SI here and nowhere else. Pickled content is never loaded. Our own layouts are read
strictly (anything odd is an error); foreign ones by the readers of :mod:`insemu.formats.readers`, which tell what they took and assumed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from insemu import noise, yamlfile
from insemu.errors import InputError
from insemu.formats import recording, static
from insemu.formats.clocks import seconds_of_date, start_said, utc_of
from insemu.formats.columns import guess_map, parse_map, preset_beside, read_preset, split_header, write_preset
from insemu.formats.curves import NamedCurve, read_curves
from insemu.formats.handed import Fitted, hand_on, read_fitted
from insemu.formats.npz import keys_of, load_npz
from insemu.formats.opened import Opened, open_files
from insemu.formats.programs import PROGRAMS
from insemu.formats.readers.imu_binary import LAYOUTS as IMU_BINARIES
from insemu.formats.readers.imu_binary import write_imu_binary
from insemu.formats.static import AXIS_OF_COLUMN, Log, round_rate
from insemu.formats.table import Probe, known_readers, reader_of
from insemu.formats.text import write_table
from insemu.formats.tracks_out import Way, way_of, write_overlay, write_way
from insemu.records import AXES, COLUMNS, ImuRecord, Recording, Series
from insemu.stamps import SECOND

__all__ = [
    "AXIS_OF_COLUMN",
    "IMU_BINARIES",
    "PROGRAMS",
    "Fitted",
    "Log",
    "NamedCurve",
    "Opened",
    "Way",
    "check_target",
    "hand_on",
    "holds_recording",
    "known_readers",
    "load_npz",
    "open_files",
    "opened",
    "parse_map",
    "read",
    "read_curves",
    "read_fitted",
    "read_imu",
    "read_log",
    "read_recording",
    "read_static",
    "round_rate",
    "seconds_of_date",
    "split_header",
    "start_said",
    "utc_of",
    "way_of",
    "write",
    "write_imu_binary",
    "write_overlay",
    "write_preset",
    "write_table",
    "write_way",
]

Data = list[Series] | Recording
Layout = Literal["recording", "log", "foreign"]


def layout_of(path: str | Path) -> Layout:
    """Whether a file is in our own layout of a recording, of a static log, or in anybody else's.

    Raises
    ------
    InputError
        A kind of file that nobody reads, or a broken one.
    FileNotFoundError
        No such file.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    if read_preset(path) is not None:
        return "foreign"
    if path.suffix == ".npz":
        keys = keys_of(path)
        if {"imu_t", "imu"} & keys:
            return "recording"
        own = {"data", "counts"} & keys or {"gyro_counts", "acc_counts"} <= keys
        return "log" if own or reader_of(path) is None or not _has_tables(path) else "foreign"
    if recording.is_folder_recording(path):
        return "recording"
    if path.suffix == ".npy":
        return "log"
    reader = reader_of(path)
    if static.is_text(path) and (reader is None or reader.rank == 9) and not _foreign_table(path):
        return "log"
    if reader is None:
        if path.suffix.lower() in (".yaml", ".yml") and path.is_file():
            kind = noise.kind_of(yamlfile.read(path).data)
            if kind:
                raise InputError(
                    f"holds noise models ({kind}) and no recording, expected a log or recording; commands take it with --models",
                    where=str(path),
                )
        raise InputError(
            f"unknown kind of file '{path.suffix}'; `insemu open --formats` lists what is read",
            where=str(path),
        )
    return "foreign"


def _has_tables(path: Path) -> bool:
    """Whether a foreign archive holds columns that are known by their names."""
    guess = guess_map([f"{k}_{a}" for k in keys_of(path) for a in "xyz"])
    return "gyro" in guess.picks or "lat" in guess.picks or any("lat" in k.lower() for k in keys_of(path))


def _foreign_table(path: Path) -> bool:
    """Whether a table of text has names of a gyroscope, an accelerometer or a position that are not our own."""
    names = [split_header(c)[0] for c in Probe(path).header()]
    picks = guess_map(names).picks
    if {"lat", "lon"} <= set(picks):
        return True
    own = {*COLUMNS, *AXIS_OF_COLUMN.values()}
    axes = {p.column.lower() for role in ("gyro", "accel") for p in picks.get(role, ())}
    return {"gyro", "accel"} <= set(picks) and not axes <= own


def opened(path: str | Path) -> Opened:
    """What a single foreign file or folder holds; kept until another one is read, or it changes."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    inside = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path, preset_beside(path)]
    return _opened(path, tuple((p, p.stat().st_mtime_ns, p.stat().st_size) for p in inside if p.exists()))


@lru_cache(maxsize=1)
def _opened(path: Path, _changed: tuple[tuple[Path, int, int], ...]) -> Opened:
    return open_files(path)


def read(path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None) -> Data:
    """Read a static log or a dynamic recording.

    Parameters
    ----------
    path : path
        Our own ``.npz``, ``.csv`` (``.csv.gz``, ``.txt``, ``.tsv``), ``.npy`` or folder, or any file that a reader takes.
    rate_hz : float, optional
        Sampling rate of a log that does not say it.
    columns : iterable of str, optional
        Columns of a static log to return (file names such as ``gx`` or axis names such as ``gyro_x``); all by default.

    Returns
    -------
    list of Series, or Recording

    Raises
    ------
    InputError
        Anything that cannot be used: an unknown kind of file, unit or column, a shape that does not fit, values that are not finite,
        times that repeat or go back, a gap. The message names the file, the place, what was found and what was expected.
    FileNotFoundError
        The path does not exist.
    """
    if holds_recording(path):
        if rate_hz is not None or columns is not None:
            raise InputError(
                "a recording has its own times and columns; rate and columns apply to static logs", where=str(path)
            )
        return _recording(Path(path))
    return read_log(path, rate_hz=rate_hz, columns=columns).series()


def _recording(path: Path) -> Recording:
    return recording.read_recording(path) if layout_of(path) == "recording" else opened(path).recording()


def read_recording(path: str | Path) -> Recording:
    """Read a dynamic recording; raises :class:`~insemu.errors.InputError` where the file holds a static log of our own layout."""
    if layout_of(path) == "log":
        raise InputError("is a static log, expected a recording with imu_t, imu and gnss_t, gnss_llh", where=str(path))
    return _recording(Path(path))


def read_imu(path: str | Path, *, on_its_clock: bool = False) -> ImuRecord:
    """The IMU of a recording, or of a static log with all six axes, whose values are taken as means over their intervals.

    Parameters
    ----------
    path : path
        As :func:`read`.
    on_its_clock : bool
        Times of the file's clock instead of those from the origin of the recording.

    Raises
    ------
    InputError
        As :func:`read`; a log without one of the six axes.
    FileNotFoundError
        No such file.
    """
    if layout_of(path) != "log":
        found = _recording(Path(path))
        return replace(found.imu, t=found.imu.t + found.origin.ns / SECOND) if on_its_clock else found.imu
    log = static.read_log(path).select(AXES)
    values = np.column_stack(log.columns)
    t = log.t if log.t is not None else np.arange(len(log)) / log.rate_hz
    return ImuRecord(t, values[:, :3], values[:, 3:], "mean")


def read_log(path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None) -> Log:
    """Read a static log without judging its content, from our own layouts or anybody's; see :func:`insemu.formats.static.read_log`.

    Parameters
    ----------
    path : path
        Of our own, or any file or folder that a reader takes.
    rate_hz : float, optional
        Sampling rate, Hz, of a log that does not say it; it must agree with the stamps where there are some.
    columns : iterable of str, optional
        Names in the file (``gx``) or of axes (``gyro_x``); all by default.

    Returns
    -------
    Log
        In SI; may hold NaN and gaps.

    Raises
    ------
    InputError
        A file that no reader takes; shapes, units, columns or times that cannot be used; no rate, or another than that of the stamps.
    FileNotFoundError
        No such file.
    """
    layout = layout_of(path)
    if layout != "foreign":
        return static.read_log(path, rate_hz=rate_hz, columns=columns)
    return _log_of(opened(path), rate_hz, columns)


def _log_of(found: Opened, rate_hz: float | None, columns: Iterable[str] | None) -> Log:
    """The IMU of foreign files as a log: six columns in SI at their median rate."""
    imu = found.recording().imu
    log = Log.of_imu(imu, found.source)
    if rate_hz is not None and abs(rate_hz / log.rate_hz - 1.0) > 0.02:
        raise InputError(
            f"the rate is said to be {rate_hz:g} Hz, but the stamps step by {imu.dt:.6g} s", where=found.source
        )
    assumed = {role for role in ("gyro", "accel") if any(a.startswith(role) for a in found.assumed)}
    stated = tuple("" if n.split("_")[0] in assumed else u for n, u in zip(log.names, log.units, strict=True))
    log = replace(log, names=COLUMNS, stated_units=stated)
    return log if columns is None else log.select(columns)


def read_static(
    path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None
) -> list[Series]:
    """Read a static log as :func:`read`; raises :class:`~insemu.errors.InputError` where the file holds a dynamic recording.

    Parameters
    ----------
    path : path
        As :func:`read`.
    rate_hz : float, optional
        Sampling rate, Hz, of a log that does not say it.
    columns : iterable of str, optional
        Names in the file (``gx``) or of axes (``gyro_x``); all by default.

    Returns
    -------
    list of Series
        In SI, one per column.

    Raises
    ------
    InputError
        A dynamic recording, and as :func:`read`.
    FileNotFoundError
        No such file.
    """
    if holds_recording(path):
        raise InputError(
            "is a dynamic recording, expected a static log (data or counts, fs, columns, units; or CSV)",
            where=str(path),
        )
    return read_log(path, rate_hz=rate_hz, columns=columns).series()


def write(path: str | Path, data: Data) -> Path:
    """Write a static log (``.npz``, ``.csv``) or a recording (``.npz``, or a folder where the path has no suffix).

    Reading the file back gives the same values (angles of positions pass through degrees: to the last digit).

    Raises
    ------
    InputError
        A suffix that is not known for this kind of data; series of different lengths or rates.
    """
    path = Path(path)
    if isinstance(data, Recording):
        check_target(path, log=False)
        recording.write_recording(path, data)
    else:
        check_target(path, recording=False)
        static.write_log(path, data)
    return path


def check_target(path: str | Path, *, log: bool = True, recording: bool = True) -> None:
    """Whether :func:`write` knows the suffix of a path; commands ask before their work.

    Parameters
    ----------
    path : path
    log, recording : bool
        What may be written: a static log, a recording.

    Raises
    ------
    InputError
        A suffix of neither.
    """
    path = Path(path)
    if path.suffix == ".npz" or (recording and not path.suffix) or (log and static.is_text(path)):
        return
    known = [".npz", *([".csv"] if log else []), *(["a folder"] if recording else [])]
    expected = f"{', '.join(known[:-1])} or {known[-1]}"
    raise InputError(f"cannot write '{path.suffix}' files, expected {expected}", where=str(path))


def holds_recording(path: str | Path) -> bool:
    """Whether :func:`read` takes an existing path for a dynamic recording rather than a static log."""
    layout = layout_of(path)
    if layout != "foreign":
        return layout == "recording"
    found = opened(path)
    return found.gnss is not None or found.reference is not None
