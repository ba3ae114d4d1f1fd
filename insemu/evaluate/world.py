"""What an experiment asks of a world, emulated or recorded; streams of randomness, input files, static logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu.emulate import CONSTELLATIONS
from insemu.errors import InputError
from insemu.filters import FilterResult, SmootherResult
from insemu.formats import read_recording, read_static
from insemu.noise import axis_unit
from insemu.records import AXES, Recording, Series
from insemu.scenario import AxisSource, RecordedSignal, Scenario, resolve_path

Array = NDArray[np.float64]

#: Streams of randomness; each gets children of the scenario's seed by (stream, realization or record, axis).
_STREAMS = ("truth", "gnss", "initial", "fits", "effects", "outages", "aids", "sensor", "linear", "coarse")


#: Interval of the epochs at which errors are evaluated, s.
OUTPUT_INTERVAL = 1.0


def stream(seed: int, name: str, *index: int) -> np.random.Generator:
    """The generator of one stream, for example ``stream(seed, "truth", record, axis)``: the same alone or among 1000."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAMS.index(name), *index)))


def input_files(scenario: Scenario, file: str | Path | None) -> dict[str, Path]:
    """Every file that the scenario names, by the name it uses.

    Raises
    ------
    InputError
        One of them does not exist.
    """
    names: list[str] = []
    for recorded in (
        scenario.truth.recorded if scenario.truth else None,
        scenario.fits.recorded if scenario.fits else None,
    ):
        names += list(recorded.files) if recorded else []
    if scenario.recording is not None:
        names.append(scenario.recording.file)
    if scenario.trajectory is not None:
        source = scenario.trajectory
        own = source.moving.file if source.moving else None
        names += [name for name in (source.waypoints, source.track, source.motion, own) if name is not None]
    if (raw := scenario.gnss.raw) is not None and raw.constellation not in CONSTELLATIONS:
        names.append(raw.constellation)
    if scenario.truth is not None and scenario.truth.file is not None:
        names.append(scenario.truth.file)
    for design in scenario.designs.values():
        names += [s.file for s in design.sources().values() if isinstance(s, AxisSource) and s.file]
    return {name: resolve_path(name, file) for name in dict.fromkeys(names)}


#: Largest plausible values, by key: (value, unit, SI to unit). No vehicle carries its antenna farther off, no receiver or start is worse.
PLAUSIBLE: Mapping[str, tuple[float, str, float]] = {
    "gnss.lever_arm": (100.0, "m", 1.0),
    "gnss.position_sigma": (1000.0, "m", 1.0),
    "gnss.velocity_sigma": (100.0, "m/s", 1.0),
    "initial.position_sigma": (10_000.0, "m", 1.0),
    "initial.velocity_sigma": (100.0, "m/s", 1.0),
    "initial.tilt_sigma": (np.deg2rad(30.0), "deg", 180.0 / np.pi),
    "initial.heading_sigma": (np.deg2rad(180.0), "deg", 180.0 / np.pi),
}


#: Share of lost samples above which the bridging by time stamps makes filters overconfident.
MOST_LOST = 0.01


def implausible(scenario: Scenario, where: str) -> tuple[str, ...]:
    """What runs but can hardly be meant, in words; ``where`` names the file."""
    out = []
    for key, (limit, unit, factor) in PLAUSIBLE.items():
        section, _, name = key.partition(".")
        value = getattr(getattr(scenario, section), name)
        largest = 0.0 if value is None else float(np.abs(value).max())
        if largest > limit:
            out.append(f"{where}: {key} is {factor * largest:g} {unit}, expected at most {factor * limit:g} {unit}")
    for use in scenario.truth.effects if scenario.truth is not None else ():
        if use.id == "dropped_samples" and (lost := use.scalar("probability") * use.scalar("burst")) > MOST_LOST:
            out.append(
                f"{where}: truth.effects: dropped_samples loses about {100 * min(lost, 1.0):.2g} % of the samples, expected at most "
                f"{100 * MOST_LOST:g} %: no filter knows what the vehicle does in the gaps, so no filter states its error"
            )
    return tuple(out)


def static_logs(recorded: RecordedSignal, files: Mapping[str, Path]) -> list[dict[str, Series]]:
    """The six axes of every static log, warm-up left out."""
    if recorded.spans:
        return [log for name in recorded.files for log in _stretches(read_recording(files[name]), recorded.spans, name)]
    out = []
    for name in recorded.files:
        by_axis = {s.name: s for s in read_static(files[name])}
        missing = [axis for axis in AXES if axis not in by_axis]
        if missing:
            raise InputError(f"no column for {', '.join(missing)}", where=name)
        cut = {}
        for axis in AXES:
            s = by_axis[axis]
            start = round(recorded.skip * s.rate_hz)
            if start >= len(s):
                raise InputError(
                    f"the warm-up of {recorded.skip:g} s is longer than the record of {len(s) / s.rate_hz:g} s",
                    where=name,
                )
            cut[axis] = Series(s.values[start:], s.rate_hz, s.unit, axis)
        out.append(cut)
    return out


def _stretches(recording: Recording, spans: Sequence[tuple[float, float]], name: str) -> list[dict[str, Series]]:
    """Stretches of a recording as static logs; samples are taken as evenly spaced at their mean rate."""
    imu, values, out = recording.imu, recording.imu.rates(), []
    for start, end in spans:
        rows = (imu.t >= start) & (imu.t <= end)
        if rows.sum() < 100:
            raise InputError(
                f"the stretch from {start:g} to {end:g} s has {int(rows.sum())} samples, expected at least 100",
                where=name,
            )
        rate = float(rows.sum() - 1) / float(np.ptp(imu.t[rows]))
        both = values[rows]
        out.append({axis: Series(both[:, k], rate, axis_unit(axis), axis) for k, axis in enumerate(AXES)})
    return out


@dataclass(frozen=True)
class Scored:
    """Errors (n, 9), stated standard deviations (n, 9) and NEES (n,) of a run at the output epochs; the largest horizontal deviation (n,), m."""

    error: Array
    sigma: Array
    nees: Array
    major: Array


def major_axis(covariance: Array) -> Array:
    """Standard deviation (n,) of the horizontal position along the axis in which it is largest, of covariances (n, 9, 9)."""
    mean, half = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]), 0.5 * (covariance[:, 0, 0] - covariance[:, 1, 1])
    return np.asarray(np.sqrt(np.maximum(mean + np.hypot(half, covariance[:, 0, 1]), 0.0)))


def nearest_rows(t: Array, want: Array, every: int) -> NDArray[np.intp]:
    """Rows of ``t``, multiples of ``every``, nearest to some times.

    Parameters
    ----------
    t, want : (n,), (k,) arrays
        Times of the rows and wanted times, s.
    every : int

    Returns
    -------
    (k,) array of int
    """
    right = np.clip(np.searchsorted(t, want), 1, t.size - 1)
    rows = np.where(np.abs(t[right - 1] - want) < np.abs(t[right] - want), right - 1, right)
    return np.minimum(np.round(rows / every).astype(np.intp) * every, (t.size - 1) // every * every)


@dataclass(frozen=True)
class Estimate:
    """What a filter or a smoother says about one record: navigation states (n, 10) at times (n,), covariances (o, 9, 9) at the output epochs."""

    t: Array
    nav: Array
    covariance: Array

    @classmethod
    def of_filter(cls, run: FilterResult, times: Array) -> Estimate:
        """A filter's run, its covariances at ``times``, for which they were kept."""
        kept = np.searchsorted(run.covariance_t, times - 1e-9)
        return cls(run.t, run.nav, run.covariance[np.minimum(kept, len(run.covariance) - 1), :9, :9])

    @classmethod
    def of_smoother(cls, smoothed: SmootherResult, times: Array) -> Estimate:
        """A smoothed run with nodes at ``times``."""
        at = np.minimum(np.searchsorted(smoothed.t, times - 1e-9), smoothed.t.size - 1)
        return cls(smoothed.t, smoothed.nav, smoothed.covariance[at, :9, :9])
