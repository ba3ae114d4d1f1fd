"""What really happens in a scenario: motion, ideal signals, true errors, fixes. No filter and no belief in here."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from insemu.emulate import (
    AreaOutage,
    Corrupted,
    Flight,
    Mounting,
    Outage,
    RecordedErrors,
    SmoothPath,
    TemperatureProfile,
    built_in,
    corrupt,
    gnss_fixes,
    ideal_imu,
    random_outages,
)
from insemu.emulate.pieces import ErrorPieces, recorded_pieces, simulated_pieces
from insemu.errors import InputError
from insemu.formats import read_static
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Series, Trajectory
from insemu.scenario import AxisSource, OutageArea, OutageWindow, RecordedSignal, Scenario, TrajectorySource, resolve_path

Array = NDArray[np.float64]

#: Streams of randomness; each gets children of the scenario's seed by (stream, realization or record, axis).
_STREAMS = {"truth": 0, "gnss": 1, "initial": 2, "fits": 3, "effects": 4, "outages": 5}


def stream(seed: int, name: str, *index: int) -> np.random.Generator:
    """The generator of one stream, for example ``stream(seed, "truth", record, axis)``: the same alone or among 1000."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAMS[name], *index)))


def input_files(scenario: Scenario, file: str | Path | None) -> dict[str, Path]:
    """Every file that the scenario names, by the name it uses.

    Raises
    ------
    InputError
        One of them does not exist.
    """
    names: list[str] = []
    for recorded in (scenario.truth.recorded, scenario.fits.recorded if scenario.fits else None):
        names += list(recorded.files) if recorded else []
    for design in scenario.designs.values():
        names += [s.file for s in design.sources().values() if isinstance(s, AxisSource) and s.file]
    return {name: resolve_path(name, file) for name in dict.fromkeys(names)}


def static_logs(recorded: RecordedSignal, files: Mapping[str, Path]) -> list[dict[str, Series]]:
    """The six axes of every static log, warm-up left out."""
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
                raise InputError(f"the warm-up of {recorded.skip:g} s is longer than the record of {len(s) / s.rate_hz:g} s", where=name)
            cut[axis] = Series(s.values[start:], s.rate_hz, s.unit, axis)
        out.append(cut)
    return out


def motion(source: TrajectorySource) -> Flight | SmoothPath:
    """The path that a scenario asks for."""
    return built_in(source.builtin or "")


class World:
    """The emulated side of a scenario.

    Parameters
    ----------
    scenario : Scenario
    file : path, optional
        Where it was read from; paths in it are relative to that file, and messages name it.

    Attributes
    ----------
    reference : Trajectory
        True position, velocity and attitude of the IMU at the rows of ``imu``.
    imu : ImuRecord
        Ideal signals.
    path_distance_m : float
        Largest distance between the reference and the requested path.
    outages : list of Outage or AreaOutage

    Raises
    ------
    InputError
        Missing or unusable input, an outage beyond the end, a signal shorter than the flight.
    """

    def __init__(self, scenario: Scenario, file: str | Path | None = None) -> None:
        self.scenario, self.file = scenario, file
        self.files = input_files(scenario, file)
        source = scenario.trajectory
        path = motion(source)
        path = path.path if isinstance(path, Flight) else path
        span = None if source.duration is None else (path.start, min(path.end, path.start + source.duration))
        ideal = ideal_imu(
            path,
            source.rate,
            mode=source.mode,
            kind=source.kind,
            mounting=Mounting(source.mounting.lever_arm, source.mounting.angles),
            gravity=source.gravity,
            span=span,
        )
        self.reference: Trajectory = ideal.reference
        self.imu: ImuRecord = ideal.imu
        self.path_distance_m: float = ideal.path_distance_m
        self._lock = Lock()
        count = self.pieces.count
        if count is not None and scenario.realizations > count:
            raise InputError(
                f"{scenario.realizations} realizations of {self.duration_s:g} s asked for, but the recorded signals hold "
                f"{count} non-overlapping pieces of that length",
                where=f"{self._name}: truth.recorded",
            )

    @property
    def _name(self) -> str:
        return str(self.file or "scenario")

    @property
    def duration_s(self) -> float:
        """Length of the trajectory, s."""
        return float(self.reference.t[-1] - self.reference.t[0])

    @cached_property
    def outages(self) -> list[Outage | AreaOutage]:
        """When and where there is no GNSS, the same in every realization."""
        out: list[Outage | AreaOutage] = []
        start, end = float(self.reference.t[0]), float(self.reference.t[-1])
        for k, given in enumerate(self.scenario.gnss.outages):
            if isinstance(given, OutageWindow):
                if start + given.start + given.duration > end + 1e-9:
                    raise InputError(
                        f"outage {k + 1} ends at {given.start + given.duration:g} s, but the trajectory ends at {end - start:g} s",
                        where=f"{self._name}: gnss.outages.{k}",
                    )
                out.append(Outage(start + given.start, given.duration))
            elif isinstance(given, OutageArea):
                out.append(AreaOutage(given.latitude, given.longitude, given.radius))
            else:
                rng = stream(self.scenario.seed, "outages", k)
                out += random_outages(start, end, per_hour=given.per_hour, mean_s=given.mean, clear_s=given.clear, rng=rng)
        return out

    @cached_property
    def outage_windows(self) -> list[tuple[float, float]]:
        """Every outage as (start_s, duration_s) on the trajectory's clock; an area gives one for each passage."""
        windows: list[tuple[float, float]] = []
        for outage in self.outages:
            if isinstance(outage, Outage):
                windows.append((outage.start_s, outage.duration_s))
                continue
            inside = np.concatenate([[0], outage.covers(self.reference.llh).astype(np.int8), [0]])
            edges = np.flatnonzero(np.diff(inside)).reshape(-1, 2)
            windows += [(float(self.reference.t[a]), float(self.reference.t[b - 1] - self.reference.t[a])) for a, b in edges]
        return sorted(windows)

    @cached_property
    def pieces(self) -> ErrorPieces:
        """The source of true stochastic errors, one piece a realization."""
        truth, n, rate = self.scenario.truth, len(self.reference), self.scenario.trajectory.rate
        if truth.recorded is not None:
            records = [
                RecordedErrors(
                    np.stack([log[axis].values for axis in AXES], axis=1), log["gyro_x"].rate_hz, truth.recorded.remove_mean, name=name
                )
                for name, log in zip(truth.recorded.files, static_logs(truth.recorded, self.files), strict=True)
            ]
            return recorded_pieces(records, n, rate)
        seed = self.scenario.seed
        return simulated_pieces(
            truth.models(), n, rate, record_s=truth.record, rng=lambda record, axis: stream(seed, "truth", record, axis)
        )

    def corrupted(self, realization: int) -> Corrupted:
        """What the IMU gives in one realization."""
        truth = self.scenario.truth
        with self._lock:  # a simulated record serves many pieces; one thread draws it
            errors = self.pieces.piece(realization)
        temperature = None if truth.temperature is None else TemperatureProfile(truth.temperature.t, truth.temperature.degc)
        return corrupt(
            self.imu,
            None,
            stream(self.scenario.seed, "effects", realization),
            effects=truth.effects,
            reference=self.reference,
            temperature=temperature,
            errors=errors,
        )

    def fixes(self, realization: int) -> GnssRecord:
        """What the receiver gives in one realization."""
        gnss = self.scenario.gnss
        return gnss_fixes(
            self.reference,
            rate_hz=gnss.rate,
            pos_sigma_ned=gnss.position_sigma,
            vel_sigma_ned=gnss.velocity_sigma,
            lever_arm=gnss.lever_arm,
            outages=self.outages,
            rng=stream(self.scenario.seed, "gnss", realization),
            effects=gnss.effects,
        )

    def recording(self, realization: int = 0) -> Recording:
        """One realization as a recording that every other command reads."""
        corrupted = self.corrupted(realization)
        return Recording(corrupted.imu, self.fixes(realization), self.reference, self.scenario.title)
