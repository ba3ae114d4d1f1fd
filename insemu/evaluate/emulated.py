"""The emulated side of a scenario: motion, ideal signals, true errors, fixes; and how far a filter's run is from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.effects import EFFECTS, aid_age
from insemu.emulate import (
    CONSTELLATIONS,
    AreaOutage,
    ErrorPieces,
    IdealImu,
    MotionSource,
    Moving,
    Outage,
    RecordedErrors,
    Sky,
    Source,
    TrueStates,
    antenna,
    corrupt,
    covariates_of,
    fix_times,
    gnss_fixes,
    ideal_imu,
    load_flight,
    observed,
    preset_file,
    random_outages,
    read_vehicle,
    recorded_pieces,
    seen,
    simulated_pieces,
    single_point,
    sky_over,
    state_at,
)
from insemu.errors import InputError
from insemu.evaluate.consistency import nees
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.held import HELD, key_of
from insemu.evaluate.world import (
    OUTPUT_INTERVAL,
    Estimate,
    Scored,
    input_files,
    major_axis,
    static_logs,
    stream,
)
from insemu.filters import AidUse, InitialSigma, NavigationFilter, Standstill, TrueMotion
from insemu.lost import restored
from insemu.noise import NoiseModel, Spread, load_spread
from insemu.records import AXES, AidRecord, GnssRecord, ImuRecord, RawRecord, Recording, Trajectory
from insemu.scenario import Scenario, VehicleKeys
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Longest flight that is held as a whole, samples (28 h at 100 Hz), and memory of a sample: reference, ideal and corrupted signals, filter.
MAX_SAMPLES = 10_000_000
BYTES_PER_SAMPLE = 8 * 60


@dataclass(frozen=True)
class Flown:
    """A motion and its ideal signals, which do not depend on sensors, fixes and designs."""

    source: Source
    ideal: IdealImu


class EmulatedWorld:
    """The emulated side of a scenario.

    Parameters
    ----------
    scenario : Scenario
    file : path, optional
        Where it was read from; paths in it are relative to that file, and messages name it.

    Attributes
    ----------
    flight : Flight
        The requested path with its legs; ``track`` where it is a recorded one, ``warnings`` about it.
    reference : Trajectory
        True position, velocity and attitude of the IMU at the rows of ``imu``.
    imu : ImuRecord
        Ideal signals.
    path_distance_m : float
        Largest distance between the reference and the requested path.

    Raises
    ------
    InputError
        Missing or unusable input, an outage beyond the end, a signal shorter than the flight.
    """

    def __init__(self, scenario: Scenario, file: str | Path | None = None) -> None:
        self.scenario, self.file = scenario, file
        self.files = input_files(scenario, file)
        if scenario.trajectory is None or scenario.truth is None:
            raise InputError("there is nothing to emulate: the scenario has a recording", where=str(file or "scenario"))
        self.source, self.truth = scenario.trajectory, scenario.truth
        source = self.source
        inputs = [self.files[name] for name in (source.waypoints, source.track, source.motion) if name]
        inputs += [self._vehicle_file(source.moving)] if source.moving else []
        #: Says everything that the reference and the ideal signals depend on.
        self.key = key_of(source.model_dump(mode="json"), inputs)
        self._fly()
        self.warnings += self._missed_areas()

    def _fly(self) -> None:
        """Take the motion, its ideal signals and the reference."""
        about = self.source.rate * (self.source.duration or 0.0)
        flown = HELD.get(self.key, self._flown, round(about))
        self.flight, self.track, self.warnings = flown.source.flight, flown.source.track, flown.source.warnings
        self.reference: Trajectory = flown.ideal.reference
        self.imu: ImuRecord = flown.ideal.imu
        self.path_distance_m: float = flown.ideal.path_distance_m
        count = self.pieces.count
        if count is not None and self.scenario.realizations > count:
            raise InputError(
                f"{self.scenario.realizations} realizations of {self.duration_s:g} s asked for, but the recorded signals hold "
                f"{count} non-overlapping pieces of that length",
                where=f"{self._name}: truth.recorded",
            )

    def _loaded(self) -> Source:
        """The motion."""
        source, own = self.source, self.source.vehicle
        vehicle = own if isinstance(own, str) else self._moving(own)
        return load_flight(
            MotionSource(
                builtin=source.builtin,
                waypoints=self.files[source.waypoints] if source.waypoints else None,
                track=self.files[source.track] if source.track else None,
                motion=self.files[source.motion] if source.motion else None,
                vehicle=vehicle,
                speed=source.speed,
                max_gap_s=source.max_gap,
                duration_s=source.duration,
            )
        )

    def _vehicle_file(self, keys: VehicleKeys) -> Path:
        return self.files[keys.file] if keys.file else preset_file(keys.preset or "")

    def _moving(self, keys: VehicleKeys) -> Moving:
        """The vehicle that moves about its path."""
        return Moving(read_vehicle(self._vehicle_file(keys), keys.conditions), keys.seed, keys.mount)

    def _flown(self) -> Flown:
        """The motion and its ideal signals."""
        source, loaded = self.source, self._loaded()
        path = loaded.flight.path
        begin = path.start + source.begin
        end = path.end if source.duration is None else min(path.end, path.start + source.duration)
        if end <= begin:
            raise InputError(
                f"filters begin at {source.begin:g} s, but the trajectory ends at {end - path.start:g} s",
                where=f"{self._name}: trajectory.begin",
            )
        length = end - begin
        if length * source.rate > MAX_SAMPLES:
            raise InputError(
                f"{length:g} s at {source.rate:g} Hz are {length * source.rate:.3g} samples, expected at most {MAX_SAMPLES:g}: they would take "
                f"about {length * source.rate * BYTES_PER_SAMPLE / 2**30:.0f} GiB of memory",
                where=f"{self._name}: trajectory",
            )
        ideal = ideal_imu(
            path,
            source.rate,
            mode=source.mode,
            kind=source.kind,
            gravity=source.gravity,
            mounting=source.mounting,
            span=None if source.duration is None and not source.begin else (begin, end),
            sampling=source.imu,
        )
        return Flown(loaded, ideal)

    def __getstate__(self) -> dict[str, Any]:
        """For another process: simulated records are drawn there again, what was read from files travels."""
        kept = self.__dict__.copy()
        if self.truth.recorded is None and not self.truth.spread:
            kept.pop("pieces", None)
        return kept

    @property
    def _name(self) -> str:
        return str(self.file or "scenario")

    @property
    def duration_s(self) -> float:
        """Length of the trajectory, s."""
        return float(self.reference.t[-1] - self.reference.t[0])

    @property
    def _span(self) -> tuple[float, float]:
        """First and last time of the IMU, s."""
        return float(self.reference.t[0]), float(self.reference.t[-1])

    @cached_property
    def outages(self) -> list[Outage | AreaOutage]:
        """When and where there is no GNSS, the same in every realization."""
        gnss = self.scenario.gnss
        start, end = self._span
        zero = self.flight.path.start
        for k, given in enumerate(gnss.outages):
            where = f"{self._name}: gnss.outages.{k}"
            if given.end_s > end - zero + 1e-9:
                raise InputError(
                    f"outage {k + 1} ends at {given.end_s:g} s, but the trajectory ends at {end - zero:g} s",
                    where=where,
                )
            if given.start_s < start - zero - 1e-9:
                raise InputError(
                    f"outage {k + 1} begins at {given.start_s:g} s, but filters begin at {start - zero:g} s",
                    where=where,
                )
        out: list[Outage | AreaOutage] = [replace(o, start_s=zero + o.start_s) for o in gnss.outages]
        out += gnss.areas
        if gnss.random_outages is not None:
            drawn = gnss.random_outages
            rng = stream(self.scenario.seed, "outages")
            out += random_outages(start, end, per_hour=drawn.per_hour, mean_s=drawn.mean, clear_s=drawn.clear, rng=rng)
        return out

    def _missed_areas(self) -> tuple[str, ...]:
        """Outage areas that the trajectory never enters."""
        out, way = [], self.reference.llh[:: max(1, len(self.reference) // 5000)]
        for k, area in enumerate(self.scenario.gnss.areas):
            if area.covers(self.reference.llh).any():
                continue

            def distance(lat: float, lon: float) -> float:
                off = earth.position_difference(way, np.array([lat, lon, 0.0]))
                return float(np.hypot(off[:, 0], off[:, 1]).min())

            far, exchanged = distance(area.latitude, area.longitude), distance(area.longitude, area.latitude)
            swapped = far > 1e5 and exchanged < 0.1 * far
            out.append(
                f"{self._name}: gnss.areas.{k} is never entered, its centre is {far / 1000:.4g} km away"
                + ("; are latitude and longitude swapped?" if swapped else "")
            )
        return tuple(out)

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
            windows += [
                (float(self.reference.t[a]), float(self.reference.t[b - 1] - self.reference.t[a]))
                for a, b in edges
                if b - 1 > a  # of one sample there is nothing to judge
            ]
        return sorted(windows)

    @cached_property
    def pieces(self) -> ErrorPieces:
        """The source of true stochastic errors, one piece a realization."""
        truth, n, rate = self.truth, len(self.reference), self.source.rate
        if truth.recorded is not None:
            records = [
                RecordedErrors(
                    np.stack([log[axis].values for axis in AXES], axis=1),
                    log["gyro_x"].rate_hz,
                    truth.recorded.remove_mean,
                    name=name,
                )
                for name, log in zip(truth.recorded.files, static_logs(truth.recorded, self.files), strict=True)
            ]
            return recorded_pieces(records, n, rate, truth.recorded.order)
        seed, models = self.scenario.seed, truth.models()
        return simulated_pieces(
            self.sensor if truth.spread else models,
            n,
            rate,
            record_s=truth.record,
            rng=lambda record, axis: stream(seed, "truth", record, axis),
            states_at=np.searchsorted(self.reference.t, self.output_times),
            covariates=covariates_of(self.imu, self.reference, truth.temperature, models.values()),
        )

    def sensor(self, record: int) -> dict[str, NoiseModel]:
        """True models of the axes in one record: one switch-on."""
        models = self.truth.models()
        return {
            axis: self._spreads[axis].drawn(model, stream(self.scenario.seed, "sensor", record, k))
            if axis in self._spreads
            else model
            for k, (axis, model) in enumerate(models.items())
        }

    @cached_property
    def _spreads(self) -> Mapping[str, Spread]:
        """How the true models differ from one switch-on to another, by axis."""
        return load_spread(self.files[self.truth.file]) if self.truth.spread and self.truth.file is not None else {}

    def recording(self, realization: int, *, ideal: bool = False) -> Recording:
        """What the sensors give in one realization, with the reference.

        Parameters
        ----------
        realization : int
            The same alone or among 1000.
        ideal : bool
            Perfect sensors instead: no errors on the IMU or the fixes, the outages kept.
        """
        return self._given(realization, self.imu) if ideal else self.realized(realization)[0]

    def realized(self, realization: int) -> tuple[Recording, TrueStates | None]:
        """What the sensors give in one realization, and what their axes err by at the output epochs apart from white noise, where that is known.

        Deterministic effects count. It is not known for recorded errors, for effects that are noise themselves or move the samples.
        """
        errors, known = self.pieces.piece(realization)
        made = corrupt(
            self.imu,
            None,
            stream(self.scenario.seed, "effects", realization),
            effects=self.truth.effects,
            reference=self.reference,
            temperature=self.truth.temperature,
            errors=errors,
        )
        imu: ImuRecord = made.imu
        uses = [use for use in self.truth.effects if use.inertial]
        if known is not None and uses:
            if any(EFFECTS[use.id].family == "stochastic" for use in uses) or not np.array_equal(imu.t, self.imu.t):
                known = None
            else:
                rows = np.searchsorted(self.reference.t, self.output_times)
                added = np.hstack([imu.gyro - self.imu.gyro, imu.accel - self.imu.accel]) / imu.widths(0.0)
                known = TrueStates(known.axes + added[rows] - errors[rows], None, known.names)
        return self._given(realization, imu, made.kept), known

    def _given(self, realization: int, imu: ImuRecord, kept: NDArray[np.intp] | None = None) -> Recording:
        """A recording with this IMU, of which some rows were kept; without these everything is perfect."""
        s, ideal = self.scenario, kept is None
        fixes = self.fixes(stream(s.seed, "gnss", realization), ideal=ideal)
        aids = tuple(self._aid(use, None if ideal else realization) for use in s.aids)
        if kept is not None and any(use.effect.does("true_time") for use in self.truth.effects):
            # aids are on the IMU's clock
            aids = tuple(replace(a, t=np.interp(a.t, self.imu.t[kept], imu.t)) for a in aids)
        return Recording(imu, fixes, self.reference, f"{self.flight.name}, realization {realization}", aids)

    def fixes(self, rng: np.random.Generator, *, ideal: bool = False) -> GnssRecord:
        """Fixes with errors of their own.

        Parameters
        ----------
        rng : Generator
        ideal : bool
            Without errors, the outages kept.
        """
        gnss = self.scenario.gnss
        if gnss.raw is not None:
            return single_point(self._raw(rng, ideal=ideal))[0]
        return gnss_fixes(
            self.reference,
            rate_hz=gnss.rate,
            pos_sigma_ned=(0.0, 0.0, 0.0) if ideal else gnss.position_sigma,
            vel_sigma_ned=None
            if gnss.velocity_sigma is None
            else np.multiply(gnss.velocity_sigma, 0.0 if ideal else 1.0),
            lever_arm=gnss.lever_arm,
            outages=self.outages,
            rng=rng,
            effects=() if ideal else self.truth.effects,
        )

    @cached_property
    def _sky(self) -> tuple[Sky, NDArray[np.bool_]]:
        """Satellites over the flight and which are observed, the same in every realization."""
        gnss, receiver = self.scenario.gnss, self.scenario.gnss.raw
        assert receiver is not None
        t = fix_times(self.reference, gnss.rate)
        llh, velocity = antenna(self.reference, t, gnss.lever_arm)
        named = receiver.constellation
        file = CONSTELLATIONS[named] if named in CONSTELLATIONS else self.files[named]
        sky = sky_over(file, t, llh, velocity, receiver.start - self.flight.path.start)
        return sky, seen(sky, llh, receiver.mask, self.outages)

    def _raw(self, rng: np.random.Generator, *, ideal: bool = False) -> RawRecord:
        """Raw observations; arguments as of :meth:`fixes`, which are made of them."""
        assert self.scenario.gnss.raw is not None
        return observed(*self._sky, self.scenario.gnss.raw, rng, ideal=ideal)

    def raw(self, realization: int) -> RawRecord | None:
        """Raw observations of one realization, where the scenario has any."""
        return None if self.scenario.gnss.raw is None else self._raw(stream(self.scenario.seed, "gnss", realization))

    def _aid(self, use: AidUse, realization: int | None) -> AidRecord:
        """What an aid says in one realization, by its own stream whatever other aids there are; perfect where there is none."""
        t, name = use.times(self.reference.t), use.aid.name
        effects = () if realization is None else self.truth.effects
        late = np.clip(t - aid_age(name, effects), self.reference.t[0], self.reference.t[-1])
        llh, velocity, q, rate = state_at(self.reference, late)
        motion = TrueMotion(llh, velocity, rotation.dcm_from_quaternion(q), rate)
        index = crc32(name.encode())
        rng = None if realization is None else stream(self.scenario.seed, "aids", realization, index)
        return use.record(t, motion, rng, effects)

    @property
    def rate_hz(self) -> float:
        """IMU rate."""
        return self.source.rate

    @property
    def standstill(self) -> Standstill | None:
        """Known rests that are fed to the filters: none in an emulated flight."""
        return None

    @property
    def gravity(self) -> str:
        """Gravity model that emulator and filters share."""
        return self.source.gravity

    @cached_property
    def output_times(self) -> Array:
        """Epochs at which errors are evaluated: every second, and the end of every outage."""
        t = self.reference.t
        every = np.arange(t[0], t[-1] + 1e-9, OUTPUT_INTERVAL)
        ends = [start + duration for start, duration in self.outage_windows]
        return t[np.unique(np.clip(np.searchsorted(t, np.concatenate([every, ends]) - 1e-6), 0, t.size - 1))]

    @cached_property
    def truth_at_outputs(self) -> Trajectory:
        """The reference at the output epochs."""
        r = self.reference
        k = np.searchsorted(r.t, self.output_times)
        return r.rows(k)

    def imu_for(self, imu: ImuRecord, ekf: NavigationFilter) -> ImuRecord:
        """The data as they are."""
        return imu

    def restored(self, recording: Recording) -> Recording:
        """A realization with its lost samples filled in."""
        return replace(recording, imu=restored(recording.imu)[0])

    def start(self, realization: int, imu: ImuRecord) -> tuple[NavState, InitialSigma]:
        """The filter's start: the truth moved by a draw from the sigmas that the filter believes."""
        return self.moved_start(stream(self.scenario.seed, "initial", realization))

    def moved_start(self, rng: np.random.Generator) -> tuple[NavState, InitialSigma]:
        """The truth moved by a draw from the sigmas that the filter believes."""
        sigma = self.scenario.initial.sigma
        error = rng.standard_normal(9) * sigma.to_array()
        start = NavState.of(self.reference)
        moved = NavState(earth.move(start.llh, error[:3]), start.vel_ned + error[3:6], start.rpy + error[6:9])
        return moved, sigma

    @property
    def card(self) -> None:
        """Nothing was read."""

    @property
    def compared(self) -> int:
        """Navigation errors that have a reference: all."""
        return 9

    def score(self, run: Estimate, times: Array) -> Scored:
        """Errors of a run at some of its epochs.

        Time offsets, jitter and dropped samples move the stamps; the filter's estimate belongs to the stamp.
        """
        truth = self.truth_at_outputs
        rows = np.searchsorted(truth.t, times).clip(0, len(truth) - 1)
        if np.array_equal(times, truth.t[rows]):
            truth = truth.rows(rows)
        else:
            at = np.clip(times, self.reference.t[0], self.reference.t[-1])
            llh, vel, q, _ = state_at(self.reference, at)
            truth = Trajectory(times, llh, vel, rotation.rpy_from_quaternion(q), self.reference.name)
        nav = run.nav[np.searchsorted(run.t, times - 1e-9)]
        estimate = Trajectory(times, nav[:, 0:3], nav[:, 3:6], rotation.rpy_from_quaternion(nav[:, 6:10]))
        error = navigation_error(estimate, truth)
        return Scored(error, _sigma(run.covariance), nees(error, run.covariance), major_axis(run.covariance))


def _sigma(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("tii->ti", covariance), 0.0)))
