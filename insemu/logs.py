"""Static logs for those who ask about them: a log's own file, or a recording whose sensor was at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import covariates, formats
from insemu.errors import InputError, nearest
from insemu.formats import AXIS_OF_COLUMN, Log
from insemu.gap.data import at_rest, recorded_temperature
from insemu.records import AXES, Series
from insemu.variance import AxisReport, characterise, characterise_stream, wavelet_covariance
from insemu.variance import findings as judge

Array = NDArray[np.float64]

#: Fewest samples of a column.
LEAST = 16
#: Longer columns are read in one pass and never held as a whole.
LONG = 1 << 24


def open_log(file: str | Path, rate_hz: float | None = None, columns: Sequence[str] | None = None) -> Log:
    """Read a static log; of a recording at rest the IMU is the log.

    Parameters
    ----------
    file : path
        Path of the log or recording.
    rate_hz : float, optional
        Sampling rate of a log that does not say it, Hz.
    columns : sequence of str, optional
        Names of columns or axes to keep.

    Raises
    ------
    InputError
        See :func:`insemu.formats.read_log`; a recording that moves.
    """
    path = Path(file)
    if not path.exists() or not formats.holds_recording(path):
        return formats.read_log(path, rate_hz=rate_hz, columns=columns)
    recording = formats.read_recording(path)
    if recording.gnss is not None and not at_rest(recording):
        raise InputError("is a recording that moves; expected a static log (sensor at rest)", where=str(file))
    return Log.of_imu(recording.imu, str(path)).select(columns)


#: Names that a column of temperatures may have.
_TEMPERATURE = ("temperature", "temp", "temp_c", "temperature_degc", "t_imu")


def open_with_covariates(
    file: str | Path, rate_hz: float | None = None, skip_s: float = 0.0
) -> tuple[list[Series], dict[str, Array]]:
    """The axes of a log, or of the IMU of a drive, and the covariates next to them.

    Parameters
    ----------
    file : path
        Log or recording.
    rate_hz : float, optional
        Sampling rate of a log that does not say it, Hz.
    skip_s : float
        What is left out at the start, s.

    Raises
    ------
    InputError
        See :func:`insemu.formats.read`; gaps; no row that is left.
    """
    path = Path(file)
    if path.exists() and formats.holds_recording(path):
        recording = formats.read_recording(path)
        log, found = Log.of_imu(recording.imu, str(path)), covariates.of_recording(recording)
        series = log.series()
    else:
        log = formats.read_log(path, rate_hz=rate_hz)
        everything = {AXIS_OF_COLUMN.get(s.name, s.name): s for s in log.series()}
        named = {("temperature" if k.lower() in _TEMPERATURE else k): s.values for k, s in everything.items()}
        beside = recorded_temperature(path)
        if beside is not None and beside.size == len(log):
            named.setdefault("temperature", beside)
        found = covariates.of_columns(named, 1.0 / log.rate_hz)
        series = [s for k, s in everything.items() if k in AXES or len(everything) == 1]
        if not series:  # a log of one's own columns: everything that no level can follow by itself
            series = [s for k, s in everything.items() if k.lower() not in _TEMPERATURE]
    first = round(skip_s * log.rate_hz)
    if not 0 <= first < len(log) - 1:
        raise InputError(f"{skip_s:g} s are left out of {len(log) / log.rate_hz:g} s", where=str(path))
    return [replace(s, values=s.values[first:]) for s in series], {k: x[first:] for k, x in found.items()}


def characterise_log(
    log: Log,
    wanted: Sequence[str] | None = None,
    *,
    from_robust: bool = False,
    wavelet: str = "haar",
    progress: Callable[[str], None] = lambda name: None,
) -> list[AxisReport]:
    """Characterise columns of a log. Samples that are missing (NaN, gaps in time) are left out of the curves, and said.

    Parameters
    ----------
    log : Log
    wanted : sequence of str, optional
        Columns; all by default.
    from_robust : bool
        Read the coefficients off the robust curve.
    wavelet : str
        Filter of the wavelet variance; a log too long for memory has the Haar filter only.
    progress : callable
        Told the name of a column when it is finished.

    Raises
    ------
    InputError
        An unknown column; a log with no usable part.
    """
    keep = list(range(len(log.names)))
    if wanted is not None:
        keep = []
        for name in wanted:
            found = [k for k, n in enumerate(log.names) if name in (n, AXIS_OF_COLUMN.get(n))]
            if not found:
                raise InputError(f"has no column '{name}'" + nearest(name, log.names), where=log.source)
            keep.append(found[0])
    gaps = log.gaps()
    axes: list[AxisReport] = []
    for k in keep:
        name, unit = log.names[k], log.units[k]
        if len(log) > LONG:
            if wavelet != "haar":
                raise InputError(
                    f"has {len(log)} samples, which are read in one pass; the filter '{wavelet}' needs at most {LONG}",
                    where=log.source,
                )
            axes.append(characterise_stream(lambda k=k: log.chunks(k), log.rate_hz, name=name, unit=unit))  # type: ignore[misc]
            progress(name)
            continue
        notes = judge.gap_report(gaps, log.rate_hz) + judge.missing_values(
            np.asarray(log.columns[k], dtype=np.float64), log.rate_hz
        )
        x = log.evenly(k)
        there = np.isfinite(x)
        if np.count_nonzero(there) < LEAST:
            raise InputError(f"{name} has no {LEAST} finite values", where=log.source)
        if notes:
            start, stop = judge.longest_good_part([x], [])
            notes.append(
                f"missing: {np.count_nonzero(~there)} of {x.size} samples ({100.0 * np.mean(~there):.3g} %); curves and readings are of "
                "all that are there, spectrum, stationarity and outliers of the longest part without missing ones, "
                f"{(stop - start) / log.rate_hz:.6g} s from {start / log.rate_hz:.6g} s"
            )
        report = characterise(
            x,
            log.rate_hz,
            name=name,
            unit=unit,
            from_robust=from_robust,
            filter=wavelet,
        )
        axes.append(replace(report, findings=notes + report.findings))
        progress(name)
    judged = _unit_findings(log, axes)
    return [replace(a, findings=judged.get(AXIS_OF_COLUMN.get(a.name, a.name), []) + a.findings) for a in axes]


def related_axes(log: Log, names: Sequence[str]) -> list[dict[str, Any]]:
    """Pairs of axes that have something in common, at 1 % over all pairs (Holm's correction), at the scale that shows it best.

    Nothing is said of a log with NaN or gaps, of one too long for memory, and of an axis that does not vary.
    """
    columns = {
        name: np.asarray(log.columns[log.names.index(name)], dtype=np.float64) for name in names if len(log) <= LONG
    }
    columns = {k: x for k, x in columns.items() if np.isfinite(x).all() and np.ptp(x) > 0 and not log.gaps()}
    out: list[dict[str, Any]] = []
    for a, b in combinations(columns, 2):
        curve = wavelet_covariance(columns[a], columns[b], log.rate_hz)
        known = curve.edof > 8.0
        if not known.any():
            continue
        k = int(np.argmax(np.where(known, np.maximum(curve.correlation_low, -curve.correlation_high), -1.0)))
        numbers = (("correlation", curve.correlation), ("low", curve.correlation_low), ("high", curve.correlation_high))
        found = {name: float(v[k]) for name, v in (*numbers, ("tau_s", curve.tau_s))}
        out.append({"axes": [a, b], "p_value": curve.p_value, **found})
    out.sort(key=lambda pair: pair["p_value"])
    certain = [pair["p_value"] * (len(out) - rank) < 0.01 for rank, pair in enumerate(out)]
    return out[: certain.index(False)] if False in certain else out


def _unit_findings(log: Log, axes: Sequence[AxisReport]) -> dict[str, list[str]]:
    """Judge units from all columns of the file, also those that were not asked for: gravity needs three."""
    means, stated, white = {}, {}, {}
    for name, unit, column in zip(log.names, log.stated_units, log.columns, strict=True):
        axis = AXIS_OF_COLUMN.get(name, name)
        part = np.asarray(column[: 1 << 20], dtype=np.float64)
        if np.isfinite(part).any():
            means[axis], stated[axis] = float(np.nanmean(part)), unit
    for report in axes:
        if "N" in report.readings:
            white[AXIS_OF_COLUMN.get(report.name, report.name)] = report.readings["N"].si_value
    return judge.unit_report(means, white, stated)
