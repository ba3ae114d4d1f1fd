"""Static logs: columns at a constant rate, from NPZ, NPY and CSV, in SI.

:func:`read_log` keeps what a log really holds (NaN, gaps), for reports that must say so; :meth:`Log.series` is the strict door.
"""

from __future__ import annotations

import logging
import mmap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, found_at, nearest
from insemu.formats.clocks import read_stamps
from insemu.formats.columns import guess_map, split_header
from insemu.formats.npz import load_npy, load_npz, numbers, scalar, texts
from insemu.formats.text import is_text, read_table, write_table
from insemu.records import AXES, COLUMNS, ImuRecord, Series
from insemu.sample_times import FEW, beat, continuous, sample_times
from insemu.stamps import counted
from insemu.units import parse_unit
from insemu.whole import replacing

__all__ = ["AXIS_OF_COLUMN", "Log", "is_text", "read_log", "write_log"]

Array = NDArray[np.float64]
_T = TypeVar("_T")
_LOGGER = logging.getLogger(__name__)

#: Short column name of files -> axis name everywhere else.
AXIS_OF_COLUMN: dict[str, str] = dict(zip(COLUMNS, AXES, strict=True))
_TIME_NAMES = ("t", "time", "timestamp", "time_s", "t_s", "imu_t", "tow", "sow")
_SI = ("rad/s", "m/s^2", "rad", "m/s", "m", "s")
#: A step of more than this many nominal intervals is a gap.
GAP_FACTOR = 1.5
#: More missing samples than this many times those that are there are no gaps of one log.
MOST_MISSING = 4.0


@dataclass(frozen=True)
class Log:
    """Columns of a static log in SI, as they are in the file: values may be NaN, times may have gaps.

    Parameters
    ----------
    source : str
        File.
    names : tuple of str
        Column names as in the file.
    units : tuple of str
        SI unit of each column, ``""`` where the file does not say and the name does not tell.
    stated_units : tuple of str
        Units as written in the file.
    columns : tuple of (n,) arrays
        Values in SI. A lazy column (memory map) is kept as it is.
    rate_hz : float
        Sampling rate.
    t : (n,) array, optional
        Times in s from ``start``, strictly increasing.
    start : int
        Time 0 on the clock of the file, ns.
    remarks : tuple of str
        What its stamps are.
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    stated_units: tuple[str, ...]
    columns: tuple[NDArray[Any], ...]
    rate_hz: float
    t: Array | None = None
    start: int = 0
    remarks: tuple[str, ...] = ()

    @classmethod
    def of_imu(cls, imu: ImuRecord, source: str) -> Log:
        """The signals of an IMU as a log; increments become rates."""
        step = beat(imu.t)
        values = imu.rates()
        units = ("rad/s",) * 3 + ("m/s^2",) * 3
        return cls(source, AXES, units, units, tuple(np.ascontiguousarray(values.T)), round_rate(1.0 / step), imu.t)

    def select(self, columns: Iterable[str] | None) -> Log:
        """Only these columns, by their names or by the names of their axes; ``InputError`` with the nearest name for an unknown one."""
        keep = _select(list(self.names), columns, self.source)

        def kept(parts: tuple[_T, ...]) -> tuple[_T, ...]:
            return tuple(parts[k] for k in keep)

        return replace(
            self,
            names=kept(self.names),
            units=kept(self.units),
            stated_units=kept(self.stated_units),
            columns=kept(self.columns),
        )

    def __len__(self) -> int:
        return int(self.columns[0].shape[0])

    def gaps(self) -> list[tuple[int, float]]:
        """Return ``(row, duration in s)`` of steps longer than 1.5 nominal intervals; the row is the first one after the gap."""
        if self.t is None or self.t.size < 2:
            return []
        step = np.diff(self.t)
        rows = np.flatnonzero(step > GAP_FACTOR / self.rate_hz)
        return [(int(k) + 1, float(step[k])) for k in rows]

    def _rows(self) -> NDArray[np.int64] | None:
        """Places of the rows where no sample is missing in time, None where none is; steps count as whole samples."""
        gaps = self.gaps()
        if not gaps or self.t is None:
            return None
        lost = np.zeros(len(self), dtype=np.int64)
        for row, duration in gaps:
            lost[row] = max(round(duration * self.rate_hz) - 1, 1)
        rows = np.arange(len(self)) + np.cumsum(lost)
        if rows[-1] + 1 - len(self) > MOST_MISSING * len(self):
            row, duration = max(gaps, key=lambda gap: gap[1])
            raise InputError(
                f"{rows[-1] + 1 - len(self)} samples are missing in addition to the {len(self)} that are there, the longest gap {duration:.6g} s "
                f"before data row {row}; expected one log (cut the file there)",
                where=self.source,
            )
        return rows

    def series(self, *, gaps: bool = False) -> list[Series]:
        """Return the columns as :class:`~insemu.records.Series`.

        Parameters
        ----------
        gaps : bool
            Samples that are missing, by value or by time, become NaN of the series.

        Raises
        ------
        InputError
            Missing samples without ``gaps``; far more missing than there are.
        """
        found = self.gaps()
        rows = self._rows() if gaps else None
        if found and not gaps:
            row, duration = found[0]
            raise InputError(
                f"has {len(found)} gap(s), the first of {duration:.6g} s before data row {row} where samples are "
                f"{1.0 / self.rate_hz:.6g} s apart; expected a constant rate (cut the file there)",
                where=self.source,
            )
        out = []
        for name, unit, values in zip(self.names, self.units, self.columns, strict=True):
            try:
                x = _placed(values, rows)
                missing = gaps and not np.isfinite(x).all()
                out.append(Series(x, self.rate_hz, unit, AXIS_OF_COLUMN.get(name, name), missing))
            except InputError as error:
                raise InputError(str(error), where=self.source) from None
        return out

    def evenly(self, column: int) -> Array:
        """A column at a constant rate: samples that are missing, by value or by time, are NaN."""
        return _placed(self.columns[column], self._rows())

    def chunks(self, column: int, size: int = 1 << 20, *, first: int = 0) -> Iterator[Array]:
        """Yield successive pieces of a column from a row on, so that a memory-mapped one is never held as a whole.

        Parameters
        ----------
        column : int
            Place of the column.
        size : int
            Rows per piece.
        first : int
            First row.
        """
        values = self.columns[column]
        mapped = mapping_of(values)
        for start in range(first, len(self), size):
            yield np.asarray(values[start : start + size], dtype=np.float64)
            if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
                mapped.madvise(mmap.MADV_DONTNEED)  # pages that were read count as this process's memory until let go


def mapping_of(values: NDArray[Any]) -> mmap.mmap | None:
    """The map of the file that an array is a view of; None of one in memory."""
    base: Any = values
    while isinstance(base, np.ndarray):
        if isinstance(base, np.memmap):
            found: mmap.mmap | None = getattr(base, "_mmap", None)
            return found
        base = base.base
    return None


def _placed(values: NDArray[Any], rows: NDArray[np.int64] | None) -> Array:
    """Values at their places, NaN elsewhere."""
    x = np.asarray(values, dtype=np.float64)
    if rows is None:
        return x
    out = np.full(int(rows[-1]) + 1, np.nan)
    out[rows] = x
    return out


def read_log(path: str | Path, *, rate_hz: float | None = None, columns: Iterable[str] | None = None) -> Log:
    """Read a static log without judging its content.

    NPZ: ``data`` (n, k), or ``counts`` (n, k) times ``scale`` (k,); ``fs``; ``columns`` and ``units`` (k,); optionally ``t``. Raw counts of
    an accelerometer and gyroscope triad (``acc_counts``, ``gyro_counts``) are read without units. NPY: (n,) or (n, k), rate given.
    CSV: a header of names with units in brackets (``gx [deg/s]``), optionally a time column; one column may have any header or none.

    Parameters
    ----------
    path : path
        ``.npz``, ``.npy``, ``.csv`` (``.csv.gz``, ``.txt``, ``.tsv``).
    rate_hz : float, optional
        Sampling rate, Hz; needed where the file does not say it.
    columns : iterable of str, optional
        Names in the file (``gx``) or of axes (``gyro_x``); all by default.

    Raises
    ------
    InputError
        Shapes, units, columns or times that cannot be used; no rate.
    FileNotFoundError
        No such file.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"rate is {rate_hz} Hz, expected a positive number", where=str(path))
    names, units, data, stamps, rate = parts(path)
    start, t = stamps if stamps is not None else (0, None)
    remarks: tuple[str, ...] = ()
    if len(set(names)) != len(names):
        twice = sorted({n for n in names if names.count(n) > 1})
        raise InputError(f"column '{twice[0]}' appears more than once", where=str(path))
    if t is not None:
        t, data, remarks = _sampled(t, data, str(path))
        step = beat(t)
        if rate is None and np.isfinite(step):
            rate = round_rate(1.0 / step)
        stated = rate_hz if rate_hz is not None else rate
        if stated is not None and np.isfinite(step) and abs(stated * step - 1.0) > 0.02:
            raise InputError(
                f"the rate is said to be {stated:g} Hz, but the time column steps by {step:.6g} s", where=str(path)
            )
    rate = rate_hz if rate_hz is not None else rate
    if rate is None:
        raise InputError("says no sampling rate; give one (--rate '100 Hz'), or a time column", where=str(path))
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"has a sampling rate of {rate} Hz, expected a positive number", where=str(path))
    keep = _select(names, columns, str(path))
    converted = [_to_si(names[k], units[k], data[k], f"{path}: {names[k]}") for k in keep]
    if not converted:
        raise InputError("has no data column", where=str(path))
    if converted[0][1].shape[0] < 3:
        raise InputError(f"has {converted[0][1].shape[0]} row(s) of data, expected at least 3", where=str(path))
    return Log(
        str(path),
        tuple(names[k] for k in keep),
        tuple(c[0] for c in converted),
        tuple(units[k] for k in keep),
        tuple(c[1] for c in converted),
        float(rate),
        t,
        start,
        remarks,
    )


_Stamps = tuple[int, Array]
_Parts = tuple[list[str], list[str], list[NDArray[Any]], _Stamps | None, float | None]


def parts(path: Path) -> _Parts:
    """Return names, stated units, columns, times (ns of time 0, s from it) and rate as a log holds them, unconverted."""
    if path.suffix == ".npz":
        return _npz(path)
    if path.suffix == ".npy":
        return _npy(path)
    if is_text(path):
        return _csv_once(path)
    raise InputError(f"unknown kind of file '{path.suffix}', expected .npz, .csv or .npy", where=str(path))


def _npz(path: Path) -> _Parts:
    arrays = load_npz(path)
    where = str(path)
    t = counted(numbers(arrays["t"], f"{where}: t")) if "t" in arrays else None
    rate = scalar(arrays["fs"], f"{where}: fs") if "fs" in arrays else None
    if "gyro_counts" in arrays and "acc_counts" in arrays and "columns" not in arrays:
        blocks = [numbers(arrays[k], f"{where}: {k}") for k in ("gyro_counts", "acc_counts")]
        for key, block in zip(("gyro_counts", "acc_counts"), blocks, strict=True):
            if block.ndim != 2 or block.shape[1] != 3:
                raise InputError(f"has shape {block.shape}, expected (n, 3)", where=f"{where}: {key}")
        if blocks[0].shape != blocks[1].shape or (t is not None and t[1].shape != blocks[0].shape[:1]):
            raise InputError("gyro_counts, acc_counts and t have different lengths", where=where)
        data = np.hstack(blocks)
        return list(COLUMNS), ["counts"] * 6, list(data.T), t, rate
    key = "data" if "data" in arrays else "counts"
    if key not in arrays:
        have = ", ".join(sorted(arrays)) or "nothing"
        raise InputError(f"is no static log: holds {have}; expected 'data', or 'counts' and 'scale'", where=where)
    block = numbers(arrays[key], f"{where}: {key}")
    if block.ndim == 1:
        block = block[:, None]
    if block.ndim != 2:
        raise InputError(f"has shape {block.shape}, expected (n, k)", where=f"{where}: {key}")
    if "columns" not in arrays and key == "data" and t is None and (at := _unnamed_time(list(block.T))) is not None:
        t, block = _times(block[:, at], "", "", path), np.delete(block, at, axis=1)
    width = block.shape[1]
    names = texts(arrays["columns"], f"{where}: columns") if "columns" in arrays else _default_names(width, path)
    units = texts(arrays["units"], f"{where}: units") if "units" in arrays else [""] * width
    for label, given in (("columns", names), ("units", units)):
        if len(given) != width:
            raise InputError(f"has {len(given)} entries for {width} columns of '{key}'", where=f"{where}: {label}")
    if key == "counts":
        if "scale" not in arrays:
            raise InputError("holds 'counts' without 'scale'; expected the unit of one count per column", where=where)
        scale = numbers(arrays["scale"], f"{where}: scale")
        if scale.shape not in ((), (1,), (width,)):
            raise InputError(f"has shape {scale.shape}, expected ({width},)", where=f"{where}: scale")
        block = block * scale
    if t is not None and t[1].shape != (block.shape[0],):
        raise InputError(f"has shape {t[1].shape}, expected ({block.shape[0]},)", where=f"{where}: t")
    # of a mapped file the columns stay where they lie
    columns = block.T if mapping_of(block) is not None else np.ascontiguousarray(block.T)
    return names, units, list(columns), t, rate


def _npy(path: Path) -> _Parts:
    block = load_npy(path, map_file=True)
    if block.dtype.kind not in "fiu" or block.ndim not in (1, 2):
        raise InputError(
            f"has type {block.dtype} and shape {block.shape}, expected (n,) or (n, k) real numbers", where=str(path)
        )
    if block.ndim == 1:
        return [path.stem], [""], [block], None, None
    at = _unnamed_time(list(block.T))
    keep = [k for k in range(block.shape[1]) if k != at]
    t = None if at is None else _times(block[:, at], "", "", path)
    return _default_names(len(keep), path), [""] * len(keep), [block[:, k] for k in keep], t, None


def _default_names(width: int, path: Path) -> list[str]:
    if width == 6:
        return list(COLUMNS)
    return [path.stem] if width == 1 else [f"column_{k + 1}" for k in range(width)]


#: The last text log that was read, with what it was read from: commands make its card and then compute from it.
_LAST: dict[tuple[Path, int, int], _Parts] = {}
#: Larger logs than this many values are read again rather than kept.
_KEPT = 1 << 26


def _csv_once(path: Path) -> _Parts:
    state = path.stat()
    key = (path.resolve(), state.st_mtime_ns, state.st_size)
    if key not in _LAST:
        _LAST.clear()
        names, units, data, t, rate = _csv(path)
        for column in data:
            column.setflags(write=False)
        if sum(c.size for c in data) > _KEPT:
            return names, units, data, t, rate
        _LAST[key] = names, units, data, t, rate
    names, units, data, t, rate = _LAST[key]
    return list(names), list(units), list(data), t, rate


def _csv(path: Path) -> _Parts:
    header, columns = read_table(path)
    if header is None:
        at = _unnamed_time(columns)
        names = _default_names(len(columns) - (at is not None), path)
        units = [""] * len(names)
        if at is not None:
            names.insert(at, "")
            units.insert(at, "")
    else:
        cells = [split_header(cell) for cell in header]
        names, units = [n or "column" for n, _ in cells], [u for _, u in cells]
        at = next((k for k, n in enumerate(names) if n.lower() in _TIME_NAMES), None)
        if at is None and (picked := guess_map(names, columns).picks.get("time")) is not None:
            at = names.index(picked[0].column)
    t = None
    if at is not None and len(names) > 1:
        t = _times(columns.pop(at), names[at], units[at], path)
        del names[at], units[at]
    return names, units, [np.asarray(c, dtype=np.float64) for c in columns], t, None


def _unnamed_time(columns: Sequence[NDArray[Any]]) -> int | None:
    """The column without a name that is the time: the first or the last."""
    if len(columns) < 2:
        return None
    return next(
        (k for k in (0, len(columns) - 1) if _is_time(np.asarray(columns[k][:100_000], dtype=np.float64))), None
    )


def _times(stamps: NDArray[Any], name: str, unit: str, path: Path) -> _Stamps:
    """A time column: ns of time 0, and s from it."""
    start, t, scale, assumed = read_stamps(stamps, name, unit, f"{path}: {name}")
    if assumed:
        _LOGGER.warning("%s: %s", path, assumed)
    return start, continuous(t, scale)[0]


def _is_time(x: Array) -> bool:
    """Whether a column rises from row to row as times do: by nearly the same step. No sensor's noise does that."""
    step = np.diff(x)
    if step.size < 2 or not (step > 0).all():
        return False
    return bool(np.quantile(np.abs(step - np.median(step)), 0.9) <= 0.5 * np.median(step))


def _sampled(t: Array, data: list[NDArray[Any]], source: str) -> tuple[Array, list[NDArray[Any]], tuple[str, ...]]:
    """Times of the samples, their columns in that order, and what the stamps are."""
    if not np.isfinite(t).all():
        raise InputError(f"the time of data row {int(np.argmin(np.isfinite(t)))} is not finite", where=source)
    step = np.diff(t)
    if t.size < FEW and (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        what = "repeats" if step[k - 1] == 0 else "goes back"
        raise InputError(
            f"the time {what} at data row {k} ({float(t[k - 1])!r} then {float(t[k])!r} s); expected strictly increasing times",
            where=source,
        )
    same = None
    if (step == 0.0).any():
        same = np.concatenate([[False], np.all([x[1:] == x[:-1] for x in data], axis=0)])
    with found_at(source):
        found = sample_times(t, same)
    if not np.array_equal(found.rows, np.arange(t.size)):
        data = [x[found.rows] for x in data]
    return found.t, data, found.said


def round_rate(rate: float) -> float:
    """A rate within 1e-4 of a whole number is that number: stamps are rounded."""
    whole = round(rate)
    return float(whole) if whole > 0 and abs(rate / whole - 1.0) < 1e-4 else rate


def _select(names: list[str], columns: Iterable[str] | None, source: str) -> list[int]:
    if columns is None:
        return list(range(len(names)))
    keep = []
    for wanted in columns:
        found = [k for k, n in enumerate(names) if wanted in (n, AXIS_OF_COLUMN.get(n))]
        if not found:
            raise InputError(f"has no column '{wanted}'" + nearest(wanted, names), where=source)
        keep.append(found[0])
    return keep


def _to_si(name: str, unit: str, values: NDArray[Any], where: str) -> tuple[str, NDArray[Any]]:
    """Return ``(SI unit, values)``; the unit of a known axis must be of its dimension."""
    axis = AXIS_OF_COLUMN.get(name, name if name in AXES else None)
    expected = None if axis is None else ("rad/s" if axis.startswith("gyro") else "m/s^2")
    if unit.lower() in ("", "-", "counts", "count", "lsb", "raw"):
        # a known axis without a unit is taken as SI; the report checks the magnitude and says so
        return (expected or "") if unit in ("", "-") else "", values
    try:
        parsed = parse_unit(unit)
    except InputError as error:
        raise InputError(str(error), where=where) from None
    if expected is not None and parsed.dimension != parse_unit(expected).dimension:
        raise InputError(
            f"has the unit '{unit}', expected one of the dimension of {expected} (are columns swapped?)", where=where
        )
    si = next((s for s in _SI if parse_unit(s).dimension == parsed.dimension), None)
    if si is None:
        return unit, values
    return si, values if parsed.factor == 1.0 else values * parsed.factor


def write_log(path: Path, data: list[Series]) -> None:
    """Write series of one rate and length as ``.npz`` (``data, fs, columns, units``) or CSV (with a time column)."""
    if not data:
        raise InputError("no series to write", where=str(path))
    if len({(len(s), s.rate_hz) for s in data}) > 1:
        raise InputError("series have different lengths or rates; expected one of each", where=str(path))
    short = {axis: column for column, axis in AXIS_OF_COLUMN.items()}
    names = [short.get(s.name, s.name) for s in data]
    block = np.column_stack([s.values for s in data])
    rate = data[0].rate_hz
    if path.suffix == ".npz":
        units = np.array([s.unit for s in data])
        with replacing(path) as partial:
            np.savez(partial, data=block, fs=np.float64(rate), columns=np.array(names), units=units)
        return
    header = ["t [s]"] + [f"{n} [{s.unit}]" if s.unit else n for n, s in zip(names, data, strict=True)]
    write_table(path, header, np.column_stack([np.arange(len(data[0])) / rate, block]))
