"""From a file to what the gap workflow reads: the axes of a static log with their temperature, or a recording with fixes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import formats
from insemu.errors import InputError
from insemu.filters import never_moves
from insemu.formats import load_npz
from insemu.gap.policy import rules
from insemu.lost import filled, places, width_at_rest
from insemu.records import AXES, Recording, Series
from insemu.sample_times import beat, samples
from insemu.stamps import counted

Array = NDArray[np.float64]

_TEMPERATURE = ("temperature", "temp_c", "temp_C", "temp", "temperature_degC")


@dataclass(frozen=True)
class StaticLog:
    """Axes of a log at rest, with temperature where it was recorded, and which samples the stamps skip (they are filled in)."""

    axes: tuple[Series, ...]
    temperature: Array | None
    source: str
    missing: NDArray[np.bool_] | None = None


def load_measured(path: str | Path, *, rate_hz: float | None = None) -> StaticLog | Recording:
    """Read what was measured; a recording without fixes, or whose fixes never move, is a static log.

    Raises
    ------
    InputError
        See :func:`insemu.formats.read`.
    """
    path = Path(path)
    temperature = recorded_temperature(path)
    if path.suffix == ".npz" and path.is_file() and rate_hz is None:
        rate_hz = _stamped_rate(path)
    if formats.holds_recording(path):
        data = formats.read(path, rate_hz=rate_hz)
        assert isinstance(data, Recording)
        return static_of(data) if data.gnss is None or at_rest(data) else data
    log = formats.read_log(path, rate_hz=rate_hz)
    missing = None
    if log.gaps():
        assert log.t is not None
        whole = temperature is not None and temperature.size == len(log)
        values, own, missing = _even(
            np.column_stack(log.columns), temperature if whole else None, log.t, 1.0 / log.rate_hz, str(path)
        )
        temperature = own if whole else temperature
        log = replace(log, columns=tuple(values.T), t=None)
    series = log.series()
    axes = tuple(s for s in series if s.name.lower() not in (t.lower() for t in _TEMPERATURE))
    column = next((s for s in series if s.name.lower() in (t.lower() for t in _TEMPERATURE)), None)
    if column is not None:
        temperature = np.asarray(column.values)
    return StaticLog(axes, temperature, str(path), missing)


def from_its_start(data: StaticLog | Recording) -> StaticLog | Recording:
    """A recording under a clock that began long before it (GPS seconds, an epoch) with times from its start; any other data as they are."""
    return data.from_start() if isinstance(data, Recording) else data


def at_rest(recording: Recording) -> bool:
    """Whether the fixes say that nothing moved."""
    return never_moves(recording)


def static_of(recording: Recording) -> StaticLog:
    """The IMU of a recording as a static log at a constant rate; samples that the stamps skip are filled in.

    Raises
    ------
    InputError
        More than a fifth of the samples are missing.
    """
    imu = recording.imu
    dt = imu.dt
    values, temperature, missing = _even(imu.rates(), imu.temperature, imu.t, dt, recording.source)
    axes = tuple(Series(values[:, k], 1.0 / dt, "rad/s" if k < 3 else "m/s^2", name) for k, name in enumerate(AXES))
    return StaticLog(axes, temperature, recording.source, missing if missing.any() else None)


def _even(
    values: Array, temperature: Array | None, t: Array, dt: float, source: str
) -> tuple[Array, Array | None, NDArray[np.bool_]]:
    """Samples (m, k) and temperature of a log at rest on every multiple of ``dt``, and which of them the stamps skip."""
    at, missing = places(samples(t, dt).astype(np.int64) - 1)
    lost = missing.size - at.size
    if not lost:
        return values, temperature, missing
    if lost > rules().most_lost * at.size:
        raise InputError(
            f"the stamps skip {lost} of {missing.size} samples, expected at most {rules().most_lost:.0%} for a static log",
            where=source,
        )
    if temperature is not None:
        temperature = np.interp(np.arange(missing.size), at, temperature)
    return filled(values, missing, width_at_rest(dt), np.random.default_rng(missing.size)), temperature, missing


def recorded_temperature(path: Path) -> Array | None:
    """Temperatures that an archive holds beside its data, degC; None where there are none."""
    if path.suffix != ".npz" or not path.is_file():
        return None
    arrays = load_npz(path)
    for name in _TEMPERATURE:
        if name in arrays:
            values = np.asarray(arrays[name], dtype=np.float64)
            if values.ndim != 1 or not np.isfinite(values).all():
                raise InputError(
                    f"'{name}' has shape {values.shape} or values that are not finite, expected one number per sample",
                    where=str(path),
                )
            return values
    return None


def _stamped_rate(path: Path) -> float | None:
    """Rate of an archive that holds time stamps in nanoseconds instead of ``fs``."""
    arrays = load_npz(path)
    if "fs" in arrays or "data" not in arrays:
        return None
    stamps = next((v for k, v in arrays.items() if k.startswith("timestamp_ns")), None)
    if stamps is None or stamps.ndim != 1 or stamps.size < 2:
        return None
    step = beat(counted(stamps, 1e-9)[1])
    return 1.0 / step if step > 0 else None
