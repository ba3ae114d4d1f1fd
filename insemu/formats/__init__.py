"""The field's files, in and out: one registry behind :func:`read` and :func:`write`.

Static logs (sensor at rest, constant rate) become a list of :class:`~insemu.records.Series`; dynamic recordings become a
:class:`~insemu.records.Recording`. Units are converted to SI here and nowhere else. Pickled content is never loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from insemu.errors import InputError
from insemu.formats import recording, static
from insemu.formats.static import AXIS_OF_COLUMN, Log, read_log
from insemu.records import Recording, Series

__all__ = ["AXIS_OF_COLUMN", "FORMATS", "Format", "Log", "read", "read_log", "read_recording", "read_static", "write"]

Data = list[Series] | Recording


@dataclass(frozen=True)
class Format:
    """One kind of file: what it is called, whether a path is one, and how it is written.

    Parameters
    ----------
    name : str
        Shown in messages.
    holds : type
        ``Series`` (static logs) or ``Recording`` (dynamic).
    recognises : callable
        Takes an existing path and says whether it is of this kind.
    writes : callable
        Says whether a path that is to be written would be of this kind.
    write : callable
        Takes the path and the data.
    """

    name: str
    holds: type
    recognises: Callable[[Path], bool]
    writes: Callable[[Path], bool]
    write: Callable[[Path, Data], None]


def _write_static(path: Path, data: Data) -> None:
    assert isinstance(data, list)
    static.write_log(path, data)


def _write_recording(path: Path, data: Data) -> None:
    assert isinstance(data, Recording)
    recording.write_recording(path, data)


#: In the order in which they are tried.
FORMATS: tuple[Format, ...] = (
    Format("recording (.npz)", Recording, recording.is_npz_recording, lambda p: p.suffix == ".npz", _write_recording),
    Format("recording (folder)", Recording, Path.is_dir, lambda p: p.suffix == "", _write_recording),
    Format("static log (.npz)", Series, lambda p: p.suffix == ".npz", lambda p: p.suffix == ".npz", _write_static),
    Format("static log (.csv)", Series, static.is_text, static.is_text, _write_static),
    Format("static log (.npy)", Series, lambda p: p.suffix == ".npy", lambda p: False, _write_static),
)


def read(path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None) -> Data:
    """Read a static log or a dynamic recording.

    Parameters
    ----------
    path : path
        ``.npz``, ``.csv`` (``.csv.gz``, ``.txt``, ``.tsv``), ``.npy`` or the folder of a recording.
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
    path = Path(path)
    kind = _recognise(path)
    if kind.holds is Recording:
        if rate_hz is not None or columns is not None:
            raise InputError(
                "a recording has its own times and columns; rate and columns apply to static logs", where=str(path)
            )
        return recording.read_recording(path)
    return read_log(path, rate_hz=rate_hz, columns=columns).series()


def read_recording(path: str | Path) -> Recording:
    """Read a dynamic recording; raises :class:`~insemu.errors.InputError` where the file holds a static log."""
    data = read(path)
    if not isinstance(data, Recording):
        raise InputError("is a static log, expected a recording with imu_t, imu and gnss_t, gnss_llh", where=str(path))
    return data


def read_static(
    path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None
) -> list[Series]:
    """Read a static log as :func:`read`; raises :class:`~insemu.errors.InputError` where the file holds a dynamic recording."""
    if _recognise(Path(path)).holds is Recording:
        raise InputError(
            "is a dynamic recording, expected a static log (data or counts, fs, columns, units; or CSV)",
            where=str(path),
        )
    data = read(path, rate_hz=rate_hz, columns=columns)
    assert isinstance(data, list)
    return data


def write(path: str | Path, data: Data) -> Path:
    """Write a static log (``.npz``, ``.csv``) or a recording (``.npz``, or a folder where the path has no suffix).

    Reading the file back gives the same values (angles of positions pass through degrees: to the last digit).

    Raises
    ------
    InputError
        A suffix that is not known for this kind of data; series of different lengths or rates.
    """
    path = Path(path)
    holds = Recording if isinstance(data, Recording) else Series
    for kind in FORMATS:
        if kind.holds is holds and kind.writes(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            kind.write(path, data)
            return path
    expected = ".npz or a folder" if holds is Recording else ".npz or .csv"
    raise InputError(f"cannot write '{path.suffix}' files, expected {expected}", where=str(path))


def holds_recording(path: str | Path) -> bool:
    """Whether :func:`read` takes an existing path for a dynamic recording rather than a static log."""
    return _recognise(Path(path)).holds is Recording


def _recognise(path: Path) -> Format:
    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    for kind in FORMATS:
        if kind.recognises(path):
            return kind
    raise InputError(f"unknown kind of file '{path.suffix}', expected .npz, .csv, .npy or a folder", where=str(path))
