"""What a scenario may say of a filter design: where its beliefs come from, and how it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, field_validator, model_validator
from pydantic_core import CoreSchema, core_schema

from insemu.augment import Extras
from insemu.denoise import Rule
from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError, nearest
from insemu.filters import FAMILIES, FilterOptions, Standstill
from insemu.noise import Clock, NoiseModel
from insemu.records import AXES
from insemu.scenario.designs import shipped_designs, spell_out
from insemu.scenario.fields import (
    MODEL_JSON,
    EffectList,
    Length,
    LengthNoise,
    Made,
    Parsed,
    PerKelvin,
    Radians,
    RadiansPerSecond,
    Ratio,
    Seconds,
    Section,
    Speed,
    SpeedWalk,
    Structure,
    computed,
    key,
    noise_model,
    per_axis,
)

#: Largest standard deviation of a constant state, SI: its square is a number, and nothing that flies is as wrong.
LARGEST = 1e6


#: A state that is left out where its standard deviation is zero.
constant = partial(key, 0.0, ge=0, le=LARGEST)


class ClockKeys(Section):
    """Clock of a receiver of raw observations, times the speed of light."""

    bias: Length = key(Clock.bias, "standard deviation of the bias at the start", ge=0, le=LARGEST)
    drift: Speed = key(Clock.drift, "standard deviation of the drift at the start", ge=0, le=LARGEST)
    white: LengthNoise = key(Clock.white, "white noise of the frequency", ge=0, le=LARGEST)
    walk: SpeedWalk = key(Clock.walk, "random walk of the frequency", ge=0, le=LARGEST)


class StateKeys(Section):
    """Further states, each a random constant of this standard deviation; 0 leaves it out."""

    gyro_scale: Ratio = constant("scale factors of the gyroscopes, for example 300 ppm")
    accel_scale: Ratio = constant("scale factors of the accelerometers")
    gyro_misalignment: Radians = constant("angles between the gyroscopes' axes")
    accel_misalignment: Radians = constant("angles between the accelerometers' axes")
    gyro_scale_temperature: PerKelvin = constant(
        "change of the gyroscopes' scale factors with the recorded temperature", examples=["50 ppm/K"]
    )
    accel_scale_temperature: PerKelvin = constant(
        "change of the accelerometers' scale factors with the recorded temperature", examples=["20 ppm/K"]
    )
    reference_temperature: float = key(
        25.0, "temperature at which the states per kelvin change nothing, degC", examples=[20.0]
    )
    lever_arm: Length = constant("each component of the way from IMU to antenna")
    latency: Seconds = constant("time by which the fixes come late")
    clock: Annotated[Clock, Made(ClockKeys)] | None = key(
        None,
        "bias and drift of the receiver's clock; a design with them is tightly coupled to the raw observations (gnss.raw)",
    )
    stationary_start: float = key(
        1.0,
        "factor on the standard deviations with which stationary processes of the axes begin; 0: known to be zero, learnt slowly",
        ge=0,
        le=LARGEST,
    )


class AxisSource(Section):
    """A belief about one sensor: fitted to the fit source, written out, read from a file, or the truth itself."""

    #: SI unit of the sensor's signal.
    UNIT: ClassVar[str] = ""

    fit: Structure = key(None, "structure to fit, for example '2*GM() + WN()'")
    model: Structure = key(None, "a noise model, for example to be stabilised")
    plus: Structure = key(
        None, "processes that are added, for example 'RC(sigma=0.5 deg/s)': a turn-on bias, which no static log shows"
    )
    method: str = key("gmwm", "estimator, as of insemu fit --method")
    options: dict[str, int | float | str | bool] = Field(default_factory=dict, description="options of the estimator")
    stabilise: bool | Annotated[float, Field(gt=0, lt=1)] = key(
        False,
        "move poles of a polynomial that is not stationary inside the unit circle; a number is their largest modulus",
    )
    file: str | None = key(None, "noise-model file written by insemu fit")
    truth: bool = key(False, "the model of the truth")
    sensor: str | None = key(None, "a sensor that comes with insemu (insemu sensor), or the file of its card")
    case: Literal["typical", "worst"] | None = key(None, "which of the sensor's figures; typical")

    @field_validator("fit", "model", "plus", mode="before")
    @classmethod
    def _of_the_sensor(cls, value: Any, info: Any) -> Any:
        return None if value is None else noise_model(value, cls.UNIT, specified=info.field_name == "plus")

    @model_validator(mode="after")
    def _one_source(self) -> AxisSource:
        if sum((self.fit is not None, self.model is not None, self.file is not None, self.truth)) != 1:
            raise InputError("expected exactly one of the keys 'fit', 'model', 'file' and 'truth: true'")
        return self


class GyroSource(AxisSource):
    """A belief about a gyroscope."""

    UNIT = "rad/s"


class AccelSource(AxisSource):
    """A belief about an accelerometer."""

    UNIT = "m/s^2"


@dataclass(frozen=True)
class Belief(Parsed):
    """A field of a design: a noise model, or a section that says where one comes from."""

    source: type[AxisSource]

    @classmethod
    def of(cls, source: type[AxisSource]) -> Belief:
        """The belief about one kind of sensor."""

        def read(value: Any) -> NoiseModel:
            return noise_model(value, source.UNIT, specified=True)

        return cls(read, lambda model: model.to_list(source.UNIT), {}, source)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        section = handler.generate_schema(self.source)

        def read(value: Any, inner: Callable[[Any], Any]) -> Any:
            if value is None or isinstance(value, AxisSource):
                return value
            if isinstance(value, Mapping) and "process" not in value:
                return inner(value)
            return computed(self.read, value)

        def show(value: Any, inner: Callable[[Any], Any]) -> Any:
            return inner(value) if isinstance(value, AxisSource) else None if value is None else self.show(value)

        return core_schema.no_info_wrap_validator_function(
            read, section, serialization=core_schema.wrap_serializer_function_ser_schema(show, schema=section)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [MODEL_JSON, handler(schema["schema"]), {"type": "null"}]}


GyroBelief = Annotated[GyroSource | NoiseModel | None, Belief.of(GyroSource)]
AccelBelief = Annotated[AccelSource | NoiseModel | None, Belief.of(AccelSource)]


class Prefilter(Section):
    """Wavelet de-noising of the IMU before the mechanization (Quinchia et al. 2013, sections 5.6 and 6)."""

    levels: int | dict[str, int] = Field(
        description="octaves that are shrunk, one number or one per axis (gyro_x: 7, ...)"
    )
    wavelet: str = key("db4", "name of an orthogonal wavelet of PyWavelets")
    rule: Rule = key(
        "sure",
        "how the threshold of an octave is found; approximation: the octaves are dropped whole; packets: an octave is divided into "
        "narrower bands where that tells motion from noise better",
    )
    mode: Literal["soft", "hard"] = key("soft", "coefficients are shrunk, or kept and dropped")
    delay: Seconds | None = key(
        None,
        "rule approximation in real time: every sample from those up to so much later, 0 s is causal; null: from the whole record",
        ge=0,
        examples=["0 s"],
    )

    @field_validator("levels")
    @classmethod
    def _known_axes(cls, value: int | dict[str, int]) -> int | dict[str, int]:
        for axis, levels in value.items() if isinstance(value, dict) else [("levels", value)]:
            if isinstance(value, dict) and axis not in AXES:
                raise InputError(f"unknown axis '{axis}'" + nearest(axis, AXES))
            if not 0 <= levels <= 20:
                raise InputError(f"found {levels} levels, expected 0 to 20")
        return value

    @model_validator(mode="after")
    def _delay_of_the_linear_rule(self) -> Prefilter:
        if self.delay is not None and self.rule != "approximation":
            raise InputError(f"delay belongs to rule 'approximation', found rule '{self.rule}'")
        return self

    def per_axis(self) -> list[int]:
        """Levels in the order of :data:`insemu.records.AXES`; axes that are not named stay as they are."""
        given = self.levels
        return [given if isinstance(given, int) else given.get(axis, 0) for axis in AXES]


class Tuning(Section):
    """Factors on what is believed: noise amplitudes per sensor, standard deviations of the fixes."""

    gyro: float = key(1.0, "on the noise amplitudes of the gyroscopes", gt=0)
    accel: float = key(1.0, "on the noise amplitudes of the accelerometers", gt=0)
    position: float = key(1.0, "on the standard deviations of the positions", gt=0)
    velocity: float = key(1.0, "on the standard deviations of the velocities", gt=0)


class ZeroUpdates(Section):
    """Zero velocity and zero angular rate as measurements at rest, which is found from the IMU and the fixes (never during an outage)."""

    every: Seconds = key(1.0, "time between updates", gt=0)
    velocity_sigma: Speed | None = key(0.01, "standard deviation; null: no zero velocity", gt=0)
    rate_sigma: RadiansPerSecond | None = key(1e-4, "standard deviation; null: no zero rate", gt=0)

    def at(self, intervals: Iterable[tuple[float, float]]) -> Standstill:
        """The updates in these intervals, (start, end) in s."""
        sigmas = (np.inf if sigma is None else sigma for sigma in (self.velocity_sigma, self.rate_sigma))
        return Standstill(list(intervals), self.every, *sigmas)


class DesignOptions(Section):
    """How a design's filter runs."""

    covariance_every: int = key(1, "covariance propagated every n-th IMU epoch", ge=1)
    gate: float | None = key(None, "probability that a good fix is rejected; null: no gate", gt=0, lt=1)
    gate_timeout: Seconds = key(
        FilterOptions.gate_timeout,
        "fixes (no aids, no satellites) are rejected for so long in a row; then one is taken",
        gt=0,
        le=LARGEST,
        examples=["5 s"],
    )
    prefilter: Prefilter | None = key(None, "wavelet de-noising of the IMU; absent: none")
    states: Annotated[Extras, Made(StateKeys)] = key(
        Extras(), "further states, each a random constant of this standard deviation; 0 leaves it out"
    )
    tuning: Tuning = key(Tuning(), "factors on what is believed")
    zero_updates: ZeroUpdates | None = key(None, "zero-velocity and zero-rate updates; {}: as usual")
    compensate: EffectList = key(
        (), "effects that are removed from the data before the filter: {effect: id, sensor: gyro, parameter: value}"
    )

    @field_validator("compensate")
    @classmethod
    def _can_be_taken_off(cls, value: tuple[EffectUse, ...]) -> tuple[EffectUse, ...]:
        for use in value:
            if not use.effect.compensable:
                known = ", ".join(sorted(e.id for e in EFFECTS.values() if e.compensable))
                raise InputError(
                    f"the effect '{use.id}' cannot be removed ({use.effect.absent['compensate']}); expected one of: {known}"
                )
        return value


class Design(Section):
    """A filter design: what the filter believes about every axis, and how it runs; a name alone is a design that comes with insemu."""

    design: str | None = key(None, "a design that comes with insemu (insemu designs); the keys next to it win")
    filter: str | None = key(
        None,
        f"how estimate and covariance are carried: {', '.join(FAMILIES)} (compiled), ukf (compiled, square root), reference (the ekf "
        "written to be read, filterpy, slow); or one that an installed package offers (entry point insemu.filters); absent: ekf",
    )
    settings: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="its settings, for example {limit: 1.345} for huber"
    )
    sensor: str | None = key(None, "a sensor that comes with insemu (insemu sensor), or the file of its card")
    case: Literal["typical", "worst"] | None = key(None, "which of the sensor's figures; typical")
    options: DesignOptions = key(DesignOptions(), "how the filter runs")

    gyro: GyroBelief = key(None, "the three gyroscopes")
    accel: AccelBelief = key(None, "the three accelerometers")
    gyro_x: GyroBelief = key(None, "gyroscope x, instead of what stands at gyro")
    gyro_y: GyroBelief = key(None, "gyroscope y, instead of what stands at gyro")
    gyro_z: GyroBelief = key(None, "gyroscope z, instead of what stands at gyro")
    accel_x: AccelBelief = key(None, "accelerometer x, instead of what stands at accel")
    accel_y: AccelBelief = key(None, "accelerometer y, instead of what stands at accel")
    accel_z: AccelBelief = key(None, "accelerometer z, instead of what stands at accel")

    @classmethod
    def spelled_out(cls, value: Any) -> Any:
        """With the keys of the design that it names."""
        return spell_out(value)

    @model_validator(mode="after")
    def _complete(self) -> Design:
        if self.settings and self.filter is None:
            raise InputError("found settings without the key 'filter' whose keyword arguments they are")
        missing = [axis for axis in AXES if axis not in self.sources()]
        if missing and self.filter is None:
            raise InputError(f"no belief for {', '.join(missing)}; expected gyro and accel, or each axis")
        return self

    def sources(self) -> dict[str, AxisSource | NoiseModel]:
        """What every axis's belief comes from."""
        return per_axis(self)


class OrName:
    """For editors: a section, or the name of a design."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [{"type": "string", "enum": sorted(shipped_designs())}, handler(core)]}
