"""From a file to what the gap workflow reads: the axes of a static log with their temperature, or a recording with fixes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import fftconvolve

from insemu import formats
from insemu.errors import InputError
from insemu.filters import never_moves
from insemu.formats import load_npz
from insemu.gap.policy import rules
from insemu.records import AXES, Recording, Series

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
    temperature = _temperature(path)
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
        values, missing = filled(np.column_stack(log.columns), log.t, 1.0 / log.rate_hz, str(path))
        if temperature is not None and temperature.size == len(log):
            temperature = np.interp(np.arange(missing.size), np.flatnonzero(~missing), temperature)
        log = replace(log, columns=tuple(values.T), t=None)
    series = log.series()
    axes = tuple(s for s in series if s.name.lower() not in (t.lower() for t in _TEMPERATURE))
    column = next((s for s in series if s.name.lower() in (t.lower() for t in _TEMPERATURE)), None)
    if column is not None:
        temperature = np.asarray(column.values)
    return StaticLog(axes, temperature, str(path), missing)


def from_its_start(data: StaticLog | Recording) -> StaticLog | Recording:
    """A recording under a clock that began long before it (GPS seconds, an epoch), with times from its first sample; any other as it is."""
    if not isinstance(data, Recording) or not data.imu.t[0] > data.imu.t[-1] - data.imu.t[0]:
        return data
    first = float(data.imu.t[0])
    gnss, reference = data.gnss, data.reference
    return replace(
        data,
        imu=replace(data.imu, t=data.imu.t - first),
        gnss=None if gnss is None else replace(gnss, t=gnss.t - first),
        reference=None if reference is None else replace(reference, t=reference.t - first),
    )


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
    dt = float(np.median(np.diff(imu.t)))
    values = imu.rates()
    temperature = imu.temperature
    filled_in, missing = filled(values, imu.t, dt, recording.source)
    if missing.any():
        values = filled_in
        if temperature is not None:
            temperature = np.interp(np.arange(missing.size), np.flatnonzero(~missing), temperature)
    axes = tuple(Series(values[:, k], 1.0 / dt, "rad/s" if k < 3 else "m/s^2", name) for k, name in enumerate(AXES))
    return StaticLog(axes, temperature, recording.source, missing if missing.any() else None)


def filled(values: Array, t: Array, dt: float, source: str) -> tuple[Array, NDArray[np.bool_]]:
    """Samples (n, k) on every multiple of ``dt``, and which of them the stamps skip.

    Parameters
    ----------
    values : (m, k) array
        Samples of k signals.
    t : (m,) array
        Time stamps, s.
    dt : float
        Sampling interval, s.
    source : str
        Name of the log, for messages.

    Raises
    ------
    InputError
        More than a fifth of the samples are missing.
    """
    slots = np.concatenate([[0], np.cumsum(np.maximum(1, np.round(np.diff(t) / dt).astype(np.int64)))])
    missing = np.ones(int(slots[-1]) + 1, dtype=np.bool_)
    missing[slots] = False
    lost = missing.size - slots.size
    if not lost:
        return values, missing
    if lost > rules().most_lost * slots.size:
        raise InputError(
            f"the stamps skip {lost} of {missing.size} samples, expected at most {rules().most_lost:.0%} for a static log",
            where=source,
        )
    rng = np.random.default_rng(missing.size)
    out = np.zeros((missing.size, values.shape[1]))
    out[slots] = values
    for column in out.T:
        _draw_missing(column, missing, rng)
    return out, missing


#: Samples to either side that a lost sample is drawn from, and those that its slow part is the mean of.
NEAR, SLOW = 12, 200


def _draw_missing(x: Array, missing: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Fill lost samples in place with what the ones around them leave open: the log's own autocovariance decides how much that is.

    Interpolated samples would be too smooth, and a log that lost many of them would look coloured.
    """
    present = (~missing).astype(np.float64)
    kernel = np.ones(2 * SLOW + 1)
    slow = fftconvolve(x * present, kernel, "same") / fftconvolve(present, kernel, "same")
    fast = np.where(missing, 0.0, x - slow)
    pairs = np.array([float(present[k:] @ present[: x.size - k]) for k in range(2 * NEAR + 1)])
    r = np.array([float(fast[k:] @ fast[: x.size - k]) for k in range(2 * NEAR + 1)]) / pairs
    if not r[0] > 0.0:
        x[missing] = slow[missing]
        return
    # estimated lag by lag it need not be one of anything: made so by a little white noise
    lowest = float(np.linalg.eigvalsh(toeplitz(r))[0])
    r[0] += 1e-3 * r[0] + max(-2.0 * lowest, 0.0)
    known: dict[bytes, tuple[Array, float]] = {}
    filled_in = present > 0.0
    for k in map(int, np.flatnonzero(missing)):
        near = np.arange(max(0, k - NEAR), min(x.size, k + NEAR + 1))
        near = near[filled_in[near]]
        key = (near - k).tobytes()
        if key not in known:
            weights = np.linalg.solve(r[np.abs(near[:, None] - near[None, :])], r[np.abs(near - k)])
            known[key] = weights, float(np.sqrt(max(r[0] - weights @ r[np.abs(near - k)], 0.0)))
        weights, spread = known[key]
        fast[k] = weights @ fast[near] + spread * rng.standard_normal()
        x[k] = slow[k] + fast[k]
        filled_in[k] = True


def _temperature(path: Path) -> Array | None:
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
    step = float(np.median(np.diff(stamps.astype(np.int64)))) * 1e-9
    return 1.0 / step if step > 0 else None
