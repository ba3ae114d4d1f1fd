"""What a caller gives: a file, a table, arrays or records, each through the intake that the commands run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.records import Recording, Series


@runtime_checkable
class PandasTable(Protocol):
    """A table of pandas; units stand in the names of its columns (``gx [deg/s]``), one of which is the time."""

    def to_csv(self, path: str, *, index: bool) -> Any:
        """Write the table."""

    def reset_index(self) -> Any:
        """The index as a column."""


@runtime_checkable
class PolarsTable(Protocol):
    """A table of polars; units stand in the names of its columns (``gx [deg/s]``), one of which is the time."""

    def write_csv(self, file: str) -> Any:
        """Write the table."""


#: A file, or what it holds.
Table = PandasTable | PolarsTable
#: What has axes: a log, several signals, a recording at rest.
Axes = str | Path | PandasTable | PolarsTable | Sequence[Series] | Recording
#: The same, or one signal; an array is one whose rate is given, or a column of times (s) and one of the signal.
Signal = Axes | Series | NDArray[np.float64]
Quantity = str | float


def si(value: Quantity, unit: str) -> float:
    """A quantity as text with its unit (``"100 Hz"``), or a number in the SI unit."""
    from insemu.units import parse

    return parse(value, unit) if isinstance(value, str) else float(value)


@contextmanager
def file_of(data: str | Path | Table) -> Iterator[Path]:
    """A file of a table, which the readers of files take as any other; a path as it is.

    Raises
    ------
    InputError
        What the readers say of the table, which is named ``table``.
    """
    import tempfile

    if isinstance(data, str | Path):
        yield Path(data)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        if isinstance(data, PolarsTable):
            data.write_csv(str(path))
        else:
            table = data if getattr(getattr(data, "index", None), "name", None) is None else data.reset_index()
            table.to_csv(str(path), index=False)
        try:
            yield path
        except InputError as error:
            where = None if error.where is None else error.where.replace(str(path), "table")
            raise InputError(error.message.replace(str(path), "table"), where=where) from None


def signals(
    data: Signal,
    *,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    skip: Quantity = 0.0,
    unit: str = "",
    name: str = "signal",
    refuse: bool = True,
) -> list[Series]:
    """The signals of a file, a table, an array, a recording at rest, or those given.

    Parameters
    ----------
    data : path, table, Series, sequence of Series, Recording or array
        An array is one signal (n,), or times in s and one signal (n, 2).
    columns : sequence of str, optional
        Only these.
    rate : str or float, optional
        Sampling rate (``"100 Hz"``, or Hz) of what does not say it.
    skip : str or float
        What is left out at the start (``"40 min"``, or s).
    unit, name : str
        SI unit and name of an array.
    refuse : bool
        Whether what contradicts physics is refused, as by the commands.

    Raises
    ------
    InputError
        Nothing of that kind, no such column, no rate; a file or recording that contradicts physics.
    """
    from insemu import intake

    hertz = None if rate is None else si(rate, "Hz")
    if isinstance(data, str | Path | PandasTable | PolarsTable):
        from insemu.logs import open_log

        with file_of(data) as path:
            if refuse:
                intake.card_of(path, rate_hz=hertz).check()
            out = open_log(path, hertz, None if columns is None else list(columns)).series(gaps=True)
    else:
        if refuse and isinstance(data, Recording):
            intake.examine(data).check()
        out = _in_memory(data, hertz, unit, name)
        if columns is not None:
            from insemu.errors import nearest
            from insemu.formats import AXIS_OF_COLUMN

            there = {s.name: s for s in out}
            wanted = [AXIS_OF_COLUMN.get(c, c) for c in columns]
            if unknown := [c for c in wanted if c not in there]:
                raise InputError(f"no column '{unknown[0]}'" + nearest(unknown[0], there))
            out = [there[c] for c in wanted]
    first = si(skip, "s")
    return [replace(s, values=s.values[round(first * s.rate_hz) :]) for s in out] if first else out


def _in_memory(data: object, rate_hz: float | None, unit: str, name: str) -> list[Series]:
    """The signals of what is no file and no table."""
    if isinstance(data, Series):
        return [data]
    if isinstance(data, Recording):
        from insemu.formats import Log

        return Log.of_imu(data.imu, data.source).series(gaps=True)
    if isinstance(data, list | tuple) and data and all(isinstance(s, Series) for s in data):
        return list(data)
    try:
        x = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"found {type(data).__name__}, expected a file, a table, an array, a Series, several, or a Recording"
        ) from None
    if x.ndim == 2 and x.shape[1] == 2 and len(x) > 1 and (np.diff(x[:, 0]) > 0).all():
        step = float(x[-1, 0] - x[0, 0]) / (len(x) - 1)
        if np.abs(np.diff(x[:, 0]) - step).max() > 0.5 * step:
            raise InputError("the times in the first column have gaps, expected even ones, or a table (pandas, polars)")
        return [Series(x[:, 1], 1.0 / step, unit, name)]
    if x.ndim != 1:
        raise InputError(f"found an array of shape {x.shape}, expected (n,), or (n, 2) with rising times in s first")
    if rate_hz is None:
        raise InputError(f"{name} does not say its sampling rate; expected rate='100 Hz', or times in a first column")
    return [Series(x, rate_hz, unit, name)]
