"""What a scenario may say: one frozen section per part of the experiment, every number with the unit it is converted to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from insemu.effects import AID_KINDS
from insemu.emulate import (
    CONSTELLATIONS,
    TRAJECTORIES,
    AreaOutage,
    Mount,
    Mounting,
    Multipath,
    Outage,
    Receiver,
    TemperatureProfile,
    preset_file,
)
from insemu.errors import InputError, nearest, shown
from insemu.filters import InitialSigma
from insemu.noise import Clock, NoiseModel
from insemu.records import AXES, Sampling
from insemu.scenario.design import AxisSource, ClockKeys, Design, OrName
from insemu.scenario.fields import (
    AccelModel,
    AidUses,
    Angles,
    EffectList,
    GyroModel,
    Hertz,
    Length,
    Made,
    Metres,
    MetresPerSecond,
    MetresPerSecondOrLevel,
    Name,
    Radians,
    Seconds,
    Section,
    Speed,
    Vector3,
    key,
    per_axis,
)
from insemu.scenario.sensor_keys import with_sensors

#: Largest rate of an IMU, Hz, and most realizations: what would exceed memory and patience is refused before it is begun.
MAX_RATE = 20_000.0
MAX_REALIZATIONS = 100_000
#: Longest emulated or simulated record, s: thirty days.
MAX_DURATION = 30 * 86400.0


# -- sections that become objects of other rooms: the fields have the names of the arguments -----------------------------------------


class MountingKeys(Section):
    """Where and how the IMU sits in the vehicle."""

    lever_arm: Metres = key((0.0, 0.0, 0.0), "vehicle reference point to IMU, forward, right, down")
    rpy: Angles = key((0.0, 0.0, 0.0), "roll, pitch, yaw of the IMU with respect to the vehicle")


class SamplingKeys(Section):
    """How the sensor really samples, whatever ``kind`` takes its values for."""

    average: Literal["interval", "instant"] = key("interval", "mean over the sampling interval, or value at the stamp")
    bandwidth: Hertz | None = key(None, "-3 dB of the sensor's second-order low-pass; none", gt=0)
    stamp: Literal["start", "middle", "end"] = key("end", "where in its interval the stamp of an average lies")


#: Vehicles without a motion of their own (:data:`insemu.emulate.VEHICLES`).
VehicleName = Literal[
    "car", "multirotor", "helicopter", "fixed_wing", "truck", "tractor", "train", "boat", "walker", "hand"
]


class MountKeys(Section):
    """A mount that lets the IMU move in the vehicle."""

    frequency: Hertz = Field(gt=0, description="of its resonance")
    damping: float = key(0.1, "share of the critical damping", gt=0, le=2)


class VehicleKeys(Section):
    """A vehicle that shakes, pitches and slips about its path, as its file says (docs/vehicles.md)."""

    preset: str | None = key(None, "a vehicle that comes with the package, for example car")
    file: str | None = key(None, "a vehicle's file, learned from a recording or written by hand")
    roughness: Literal["A", "B", "C", "D", "E", "F", "G", "H", "low", "high"] | None = key(
        None, "of a preset's road (ISO 8608) or rail (ERRI B176)"
    )
    wind: Speed | None = key(None, "mean wind 6 m above the ground, where it flies or floats", ge=0, le=40)
    wind_from: Radians | None = key(None, "where the wind comes from, from north; north")
    current: tuple[Speed, Radians] | None = key(None, "of the water: speed, and where it goes to")
    nose: Literal["course", "target", "wandering", "turning"] | None = key(
        None, "where a multirotor or helicopter looks; course"
    )
    target: tuple[Radians, Radians] | None = key(None, "latitude and longitude for nose: target")
    waves: tuple[Length, Seconds] | None = key(None, "of a preset that floats: significant height and peak period")
    seed: int = key(0, "the same seed is the same motion, in every realization", ge=0)
    mount: Annotated[Mount, Made(MountKeys)] | None = key(None, "resonance of the IMU's mount")

    @model_validator(mode="after")
    def _one(self) -> VehicleKeys:
        if (self.preset is None) == (self.file is None):
            raise InputError("expected one of the keys 'preset' and 'file'")
        if self.preset is not None:
            preset_file(self.preset)
        if (self.nose == "target") != (self.target is not None):
            raise InputError("expected the key 'target' together with 'nose: target', and nowhere else")
        return self

    @property
    def conditions(self) -> dict[str, Any]:
        """What a preset meets, where it is not what its file says."""
        keys = ("roughness", "wind", "waves", "wind_from", "current", "nose", "target")
        return {k: v for k in keys if (v := getattr(self, k)) is not None}


class TemperatureKeys(Section):
    """Temperature of the IMU against time, linear between points."""

    t: tuple[Seconds, ...] = Field(min_length=1, description="times")
    degc: tuple[float, ...] = Field(min_length=1, description="temperatures, degC")


class AreaKeys(Section):
    """A circle on the ground without GNSS."""

    latitude: Radians = Field(ge=-np.pi / 2, le=np.pi / 2, description="centre, for example '46.52 deg'")
    longitude: Radians = Field(description="centre, for example '6.57 deg'")
    radius: Length = Field(ge=0, description="inside this distance from the centre there is no fix")


class OutageKeys(Section):
    """A span without GNSS."""

    start_s: Seconds = Field(alias="start", ge=0, description="time from the start, or a date of a recording")
    duration_s: Seconds = Field(
        alias="duration", gt=0, description="how long, more than 0; the fix at its end is withheld, too"
    )
    satellites: int | None = key(None, "of gnss.raw so many are left at most, the highest", ge=0, examples=[3])
    elevation: Radians | None = key(None, "of gnss.raw those above this elevation are left", examples=["40 deg"])
    sectors: tuple[tuple[Radians, Radians, Radians], ...] = key(
        (),
        "of gnss.raw between two azimuths, clockwise, those above an elevation are left: [[20 deg, 160 deg, 50 deg], ...]",
        examples=[[["20 deg", "160 deg", "50 deg"]]],
    )


class MultipathKeys(Section):
    """Reflections: a Gauss-Markov process on the range of each satellite."""

    sigma: Length = Field(ge=0, description="standard deviation at the zenith")
    Tc: Seconds = Field(gt=0, description="correlation time")


class ReceiverKeys(Section):
    """Raw observations: pseudoranges and range rates, of which the receiver makes its fix by least squares."""

    constellation: str = key("gps", "gps (24 nominal slots), or a RINEX navigation file")
    start: Seconds = key(0.0, "start of the trajectory after the first ephemeris")
    mask: Radians = key(0.1745329, "lowest elevation", examples=["10 deg"])
    range_sigma: Length = key(
        1.0, "standard deviation at the zenith; elsewhere by one over the sine of the elevation", gt=0
    )
    rate_sigma: Speed = key(0.05, "likewise, of the range rate (Doppler)", gt=0)
    clock: Annotated[Clock, Made(ClockKeys)] = key(Clock(), "the receiver's clock")
    multipath: Annotated[Multipath, Made(MultipathKeys)] | None = key(None, "reflections; none")

    @field_validator("constellation")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in CONSTELLATIONS and "." not in value:
            raise InputError(f"no constellation '{value}'" + nearest(value, CONSTELLATIONS) + "; or a navigation file")
        return value


# -- the parts of a scenario ------------------------------------------------------------------------------------------------------


class TrajectorySource(Section):
    """Where the motion comes from."""

    builtin: str | None = key(None, "name of a built-in trajectory, for example helicopter_mapping")
    waypoints: str | None = key(None, "waypoint file (CSV or GeoJSON)")
    track: str | None = key(None, "recorded track: any file that insemu open reads, or a CSV")
    motion: str | None = key(None, "motion command file (CSV)")
    vehicle: VehicleName | VehicleKeys = key(
        "car", "limits and attitude for waypoints and tracks; with a file also how the body moves"
    )
    speed: Speed | None = key(None, "speed of waypoint legs whose file gives none", gt=0)
    max_gap: Seconds = key(10.0, "longest gap of a track that is bridged", gt=0)
    kind: Literal["increment", "mean", "sample"] = key("increment", "what an IMU sample is")
    gravity: Literal["normal", "free_air_first_order"] = key("normal", "gravity model of emulator and filters")
    mounting: Annotated[Mounting, Made(MountingKeys)] | None = key(None, "where and how the IMU sits in the vehicle")
    rate: Hertz = key(100.0, "IMU rate", gt=0, le=MAX_RATE)
    imu: Annotated[Sampling, Made(SamplingKeys)] | None = key(
        None, "how the sensor itself samples (with mode: continuous)"
    )
    begin: Seconds = key(
        0.0,
        "filters and records begin so long after the start of the trajectory, whose clock the outages keep",
        ge=0,
        le=MAX_DURATION,
    )
    duration: Seconds | None = key(
        None,
        "length of the flight: a longer trajectory is cut, a shorter built-in motion is repeated, a table at rest (static) lasts as long",
        gt=0,
        le=MAX_DURATION,
    )
    mode: Literal["exact", "continuous"] = key("exact", "how the ideal IMU is made (docs/emulation.md)")

    @field_validator("builtin")
    @classmethod
    def _exists(cls, value: str | None) -> str | None:
        if value is not None and value not in TRAJECTORIES:
            raise InputError(f"unknown trajectory '{value}'" + nearest(value, TRAJECTORIES))
        return value

    @property
    def moving(self) -> VehicleKeys | None:
        """The vehicle, where it moves about its path."""
        return self.vehicle if isinstance(self.vehicle, VehicleKeys) else None

    @model_validator(mode="after")
    def _one_source(self) -> TrajectorySource:
        given = [k for k in ("builtin", "waypoints", "track", "motion") if getattr(self, k) is not None]
        if len(given) != 1:
            found = " and ".join(f"'{k}'" for k in given) or "none"
            raise InputError(
                f"one source of motion is needed: the key 'builtin', 'waypoints', 'track' or 'motion'; found {found}"
            )
        if self.imu is not None and self.mode == "exact":
            raise InputError(
                "a sensor's own sampling needs a continuous path; expected 'mode: continuous' together with 'imu'"
            )
        if self.kind == "sample" and self.mode == "exact":
            raise InputError(
                "samples exist only on a continuous path; expected 'mode: continuous' together with 'kind: sample'"
            )
        return self


class RecordedSignal(Section):
    """Error signals cut from static records."""

    files: tuple[str, ...] = Field(
        min_length=1, description="static logs; a path, or shared:PATH under the shared data folder"
    )
    skip: Seconds = key(0.0, "warm-up to leave out at the start of every record", ge=0)
    spans: tuple[tuple[Seconds, Seconds], ...] = key(
        (), "of a dynamic recording: stretches [from, to] at rest, on its own clock"
    )
    order: tuple[int, ...] | None = key(
        None, "which piece each realization takes, counted from 0 over all files; the natural order where absent"
    )
    remove_mean: Literal["record", "piece", "none"] | tuple[Seconds, Seconds] = key(
        "record",
        "what the mean is taken over and removed; [from, to]: a span of every record, counted after the warm-up",
    )

    @field_validator("remove_mean", mode="before")
    @classmethod
    def _known_span(cls, value: Any) -> Any:
        known = ("record", "piece", "none")
        if value in known or (isinstance(value, list | tuple) and len(value) == 2):
            return value
        raise InputError(f"found {shown(value)}, expected one of: {', '.join(known)}; or a span [from, to]")


class SensorModels(Section):
    """A noise model per axis; ``gyro`` and ``accel`` stand for their three axes, a named axis wins."""

    gyro: GyroModel = key(None, "the three gyroscopes")
    accel: AccelModel = key(None, "the three accelerometers")
    gyro_x: GyroModel = key(None, "gyroscope x, instead of what stands at gyro")
    gyro_y: GyroModel = key(None, "gyroscope y, instead of what stands at gyro")
    gyro_z: GyroModel = key(None, "gyroscope z, instead of what stands at gyro")
    accel_x: AccelModel = key(None, "accelerometer x, instead of what stands at accel")
    accel_y: AccelModel = key(None, "accelerometer y, instead of what stands at accel")
    accel_z: AccelModel = key(None, "accelerometer z, instead of what stands at accel")

    def models(self) -> dict[str, NoiseModel]:
        """Models of the axes that have one."""
        return dict(per_axis(self))


class Truth(SensorModels):
    """What the sensors really do: a model per axis (of a file or a sensor card, too), or pieces of recorded error signals."""

    sensor: str | None = key(None, "a sensor that comes with insemu (insemu sensor), or the file of its card")
    case: Literal["typical", "worst"] | None = key(None, "which of the sensor's figures; typical")
    file: str | None = key(
        None, "noise-model file written by insemu fit; axes that are given next to it win", examples=["models.yaml"]
    )
    spread: bool = key(
        False,
        "draw each realization's sensor from the spread between runs that the file holds (insemu fit RUN1 RUN2 ...)",
        examples=[True],
    )
    recorded: RecordedSignal | None = key(None, "pieces of recorded static signals instead of models")
    record: Seconds | None = key(
        None,
        "length of the simulated records that are cut into pieces, their mean removed (absent: no removal)",
        gt=0,
        le=MAX_DURATION,
    )
    effects: EffectList = key(
        (), "deterministic, timing and GNSS effects: {effect: id, sensor: gyro, parameter: value}"
    )
    temperature: Annotated[TemperatureProfile, Made(TemperatureKeys)] | None = key(None, "temperature of the IMU")

    @classmethod
    def spelled_out(cls, value: Any) -> Any:
        """A name alone is a noise-model file; a sensor's models are put in."""
        return {"file": value} if isinstance(value, str) else with_sensors(value)

    @model_validator(mode="after")
    def _one_kind(self) -> Truth:
        models = self.models()
        if self.spread and self.file is None:
            raise InputError("found spread without the key 'file'; expected a noise-model file fitted to several runs")
        if self.recorded is not None and (models or self.file is not None):
            raise InputError("found both models and recorded signals, expected one of them")
        if self.recorded is None and self.file is None and len(models) < 6:
            missing = ", ".join(axis for axis in AXES if axis not in models)
            raise InputError(
                f"no error model for {missing}; expected gyro and accel (or each axis), a file, or recorded"
            )
        return self


class FitSource(Section):
    """The signals that design models are fitted to."""

    simulate: Seconds | None = key(None, "length of a static log simulated from the truth", gt=0, le=MAX_DURATION)
    recorded: RecordedSignal | None = key(None, "recorded static logs")

    @model_validator(mode="after")
    def _one_source(self) -> FitSource:
        if (self.simulate is None) == (self.recorded is None):
            raise InputError("expected exactly one of the keys 'simulate' and 'recorded'")
        return self


class RandomOutages(Section):
    """Outages drawn from the scenario's seed: the same for every design and realization."""

    per_hour: float = Field(ge=0, description="mean number per hour")
    mean: Seconds = Field(gt=0, description="mean duration")
    clear: Seconds = key(60.0, "time without outages at the start", ge=0)


class Gnss(Section):
    """The fixes that the filter gets, and what it believes of them."""

    rate: Hertz = key(1.0, "of the fixes", gt=0)
    position_sigma: Metres = key((0.02, 0.02, 0.02), "standard deviation north, east, down")
    velocity_sigma: MetresPerSecondOrLevel | None = key(
        (0.02, 0.02, 0.02), "standard deviation north, east, down; null: no velocity, null down alone: speed and course"
    )
    lever_arm: Metres = key((0.0, 0.0, 0.0), "IMU to antenna, forward, right, down")
    outages: tuple[Annotated[Outage, Made(OutageKeys)], ...] = key(
        (), "spans without GNSS, from the start of the trajectory"
    )
    areas: tuple[Annotated[AreaOutage, Made(AreaKeys)], ...] = key((), "places without GNSS")
    random_outages: RandomOutages | None = key(None, "outages drawn anew in every realization")
    raw: Annotated[Receiver, Made(ReceiverKeys)] | None = key(
        None, "raw observations of an emulated flight; fixes are then their least squares, with its standard deviations"
    )

    @field_validator("position_sigma", "velocity_sigma")
    @classmethod
    def _positive(cls, value: Vector3 | None) -> Vector3 | None:
        if value is not None and min(value) <= 0:  # the third may be NaN
            raise InputError(f"found {min(value)!r}, expected positive standard deviations")
        return value

    @model_validator(mode="after")
    def _raw(self) -> Gnss:
        partial = next((k for k, o in enumerate(self.outages) if o.satellites is not None or not o.total), None)
        if partial is not None and self.raw is None:
            raise InputError(f"outage {partial + 1} says which satellites are left, expected the key 'raw', too")
        return self


class Initial(Section):
    """Standard deviations of the initial state; the true initial errors are drawn from the same, which the filter believes."""

    position_sigma: Metres = key((0.1, 0.1, 0.1), "position, one or three (north, east, down)")
    velocity_sigma: MetresPerSecond = key((0.05, 0.05, 0.05), "velocity, one or three")
    tilt_sigma: Radians = key(0.0087266, "roll and pitch", ge=0)
    heading_sigma: Radians = key(0.0174533, "heading", ge=0)

    @property
    def sigma(self) -> InitialSigma:
        """What a filter is told."""
        attitude = (self.tilt_sigma, self.tilt_sigma, self.heading_sigma)
        return InitialSigma(self.position_sigma, self.velocity_sigma, attitude)


Cells = dict[str, tuple[float | None, ...]]


class Published(Section):
    """Figures of a paper, printed next to ours: errors per design, one value per outage (null where the paper prints none)."""

    source: str = Field(description="the paper and its table, as it is to be cited")
    planimetric_end_m: Cells | None = key(None, "mean error at outage end")
    planimetric_mean_m: Cells | None = key(None, "mean error during the outage")
    planimetric_max_m: Cells | None = key(None, "largest error during the outage")
    north_max_m: Cells | None = key(None, "largest error north during the outage")
    east_max_m: Cells | None = key(None, "largest error east during the outage")
    down_max_m: Cells | None = key(None, "largest error down during the outage")

    @model_validator(mode="after")
    def _some_figure(self) -> Published:
        if not self.figures:
            known = [name for name in type(self).model_fields if name != "source"]
            raise InputError(f"no figure is given, expected at least one of the keys {', '.join(known)}")
        return self

    @property
    def figures(self) -> dict[str, Cells]:
        """Figure of the outage table to design to one value per outage; the first is the headline."""
        given = ((name, getattr(self, name)) for name in type(self).model_fields if name != "source")
        return {name: cells for name, cells in given if cells is not None}


class NonHolonomic(Section):
    """The constraint of a vehicle that moves where it points: wheels neither slip sideways nor leave the road."""

    sigma: Speed = key(0.1, "standard deviation of the velocity sideways and up that a slip or a bump makes", gt=0)
    mounting_sigma: Radians = key(0.0872665, "standard deviation of the mounting angles, for example '5 deg'", gt=0)


class RecordingSource(Section):
    """A recorded drive or flight instead of an emulated one."""

    file: str = Field(description="recording; a path, or shared:PATH under the shared data folder")
    mounting: Angles = key((0.0, 0.0, 0.0), "roll, pitch, yaw of the IMU with respect to the vehicle")
    start: Seconds | None = key(
        None, "leave out what is before this time from the recording's origin, or before a date"
    )
    end: Seconds | None = key(None, "leave out what is after this time or date")
    imu_time_offset: Seconds = key(0.0, "how late IMU stamps are against those of GNSS; removed")
    vehicle: NonHolonomic | None = key(
        None, "a vehicle that moves where it points, for the gap workflow; null: no wheels"
    )
    gravity: Literal["normal", "free_air_first_order"] = key("normal", "gravity model of the filters")
    known: EffectList = key(
        (), "effects that it has and that cannot be removed, such as output counts: insemu gap does not name them again"
    )
    zero_velocity_updates: bool = key(
        False, "feed every design zero velocity and rate at rest (zero_updates: one design)"
    )
    alignment: Literal["auto", "rest", "motion"] = key(
        "auto",
        "where the filters start: at the first rest, level from gravity and heading from the first course; in motion, from "
        "specific force and the fixes' velocity; or in motion where that is possible",
    )

    @classmethod
    def spelled_out(cls, value: Any) -> Any:
        """A path alone is its file."""
        return {"file": value} if isinstance(value, str) else value


class Scenario(Section):
    """One question: a trajectory and a truth (or a recording), GNSS with outages, and the designs that are compared."""

    title: str = Field(description="what the page and the tables are called")
    question: str = key("", "what is asked, in one sentence; the page shows it below the answer")
    notes: str = key("", "what a reader of the page should know; paragraphs are parted by empty lines")
    seed: int = key(
        1, "of all random draws; the same seed gives the same figures, however many workers there are", ge=0
    )
    realizations: int = key(
        24, "flights with draws of their own; every design flies each of them", ge=1, le=MAX_REALIZATIONS
    )
    trajectory: TrajectorySource | None = key(None, "how the vehicle moves; a recording has its own")
    truth: Truth | None = key(None, "what the sensors really do; a recording has it inside")
    recording: RecordingSource | None = key(None, "a recording to run the designs on (one realization)")
    gnss: Gnss = key(Gnss(), "the fixes, their noise and where there are none")
    aids: AidUses = key(
        (),
        "measurements other than the fixes of an emulated flight (docs/filters_aids.md): {odometer: {rate: 10 Hz, sigma: [..]}}",
    )
    initial: Initial = key(Initial(), "how well the filter knows where it starts")
    fits: FitSource | None = key(None, "signals that models under designs are fitted to")
    designs: dict[Name, Annotated[Design, OrName]] = Field(
        default_factory=dict, description="what is compared; only emulation goes without"
    )
    filter: str | None = key(None, "the filter of every design that names none")
    smoother: bool = key(False, "smooth every design's run backwards too (Rauch, Tung, Striebel), through the outages")
    published: Published | None = key(None, "figures of a paper that are printed next to ours")
    variants: dict[Name, dict[str, Any]] = Field(
        default_factory=dict, description="name to the keys that differ; each is run too, under variants/NAME"
    )
    smoke: tuple[str, ...] = key(("run", "--realizations", "2"), "command and options of the project's smoke run")

    @classmethod
    def spelled_out(cls, value: Any) -> Any:
        """With the scenario's filter in every design that names none."""
        if not isinstance(value, Mapping) or value.get("filter") is None:
            return value
        designs = value.get("designs")
        if not isinstance(designs, Mapping):
            return value
        told = {name: {"design": d} if isinstance(d, str) else d for name, d in designs.items()}
        filled = {n: {"filter": value["filter"], **d} if isinstance(d, Mapping) else d for n, d in told.items()}
        return {**value, "designs": filled}

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        if self.recording is None and (self.trajectory is None or self.truth is None):
            missing = " and ".join(f"'{k}'" for k in ("trajectory", "truth") if getattr(self, k) is None)
            raise InputError(f"the key {missing} is missing; expected a trajectory and a truth, or a recording")
        if self.recording is not None and (self.trajectory is not None or self.truth is not None):
            raise InputError("found a recording together with a trajectory or a truth, expected one or the other")
        if self.recording is not None and self.aids:
            raise InputError("found aids together with a recording, which brings its own (keys aid_NAME)")
        if self.gnss.raw is not None and self.recording is not None:
            raise InputError("found gnss.raw together with a recording, expected an emulated flight")
        if self.gnss.raw is not None and self.truth is not None:
            for effect in self.truth.effects:
                if effect.sensor == "gnss":
                    raise InputError(
                        f"the effect '{effect.id}' acts on fixes, which gnss.raw makes of raw observations"
                    )
        there = {use.aid.name for use in self.aids}
        for effect in self.truth.effects if self.truth is not None else ():
            if effect.sensor in AID_KINDS and effect.sensor not in there:
                raise InputError(
                    f"the effect '{effect.id}' acts on the {effect.sensor}, which this flight does not have; expected it under the key 'aids'"
                )
        for name, design in self.designs.items():
            self.check_design(name, design)
        if self._truth_is_recorded and self.fits is not None and self.fits.simulate is not None:
            raise InputError("fits cannot be simulated from a recorded truth; expected the key 'recorded' under 'fits'")
        if self.published is not None:
            unknown = [n for cells in self.published.figures.values() for n in cells if n not in self.designs]
            if unknown:
                raise InputError(f"published figures for '{unknown[0]}', which is no design here")
        return self

    def check_design(self, name: str, design: Design) -> None:
        """Raise ``InputError`` where the scenario lacks what the design is made of."""
        if design.options.states.clock is not None and self.gnss.raw is None:
            raise InputError(
                f"the design '{name}' has states of the receiver's clock, expected the key 'gnss.raw', too"
            )
        sources = [s for s in design.sources().values() if isinstance(s, AxisSource)]
        if self.fits is None and any(s.fit for s in sources):
            raise InputError(
                f"the design '{name}' is fitted, but there is no section 'fits' that says to which signals "
                "(for example fits: {simulate: 4 h})"
            )
        if self._truth_is_recorded and any(s.truth for s in sources):
            raise InputError(f"the design '{name}' asks for the model of the truth, but the truth is a recorded signal")

    @property
    def _truth_is_recorded(self) -> bool:
        return self.truth is None or self.truth.recorded is not None
