"""What a scenario may say of a filter design: where its beliefs come from, and how it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, field_validator, model_validator
from pydantic_core import CoreSchema, core_schema

from insemu.augment import Extras
from insemu.denoise import Rule
from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError, nearest
from insemu.filters import FilterOptions, Standstill
from insemu.noise import NoiseModel
from insemu.records import AXES
from insemu.scenario.designs import shipped_designs, spell_out
from insemu.scenario.fields import (
    MODEL_JSON,
    EffectList,
    Length,
    Made,
    Parsed,
    PerKelvin,
    Radians,
    RadiansPerSecond,
    Ratio,
    Seconds,
    Section,
    Speed,
    Structure,
    an_axis,
    computed,
    noise_model,
    per_axis,
)

#: Largest standard deviation of a constant state, SI: its square is a number, and nothing that flies is as wrong.
LARGEST = 1e6


class StateKeys(Section):
    """Further states, each a random constant of this standard deviation; 0 leaves it out."""

    gyro_scale: Ratio = Field(
        default=0.0, ge=0, le=LARGEST, description="scale factors of the gyroscopes, for example 300 ppm"
    )
    accel_scale: Ratio = Field(default=0.0, ge=0, le=LARGEST, description="scale factors of the accelerometers")
    gyro_misalignment: Radians = Field(default=0.0, ge=0, le=LARGEST, description="angles between the gyroscopes' axes")
    accel_misalignment: Radians = Field(
        default=0.0, ge=0, le=LARGEST, description="angles between the accelerometers' axes"
    )
    gyro_scale_temperature: PerKelvin = Field(
        default=0.0,
        ge=0,
        le=LARGEST,
        examples=["50 ppm/K"],
        description="change of the gyroscopes' scale factors with the recorded temperature",
    )
    accel_scale_temperature: PerKelvin = Field(
        default=0.0,
        ge=0,
        le=LARGEST,
        examples=["20 ppm/K"],
        description="change of the accelerometers' scale factors with the recorded temperature",
    )
    reference_temperature: float = Field(
        default=25.0,
        examples=[20.0],
        description="temperature at which the states per kelvin change nothing, degC",
    )
    lever_arm: Length = Field(
        default=0.0, ge=0, le=LARGEST, description="each component of the way from IMU to antenna"
    )
    latency: Seconds = Field(default=0.0, ge=0, le=LARGEST, description="time by which the fixes come late")
    stationary_start: float = Field(
        default=1.0,
        ge=0,
        le=LARGEST,
        description="factor on the standard deviations with which stationary processes of the axes begin; 0: known to be zero, learnt slowly",
    )


class AxisSource(Section):
    """A belief about one sensor: fitted to the fit source, written out, read from a file, or the truth itself."""

    #: SI unit of the sensor's signal.
    UNIT: ClassVar[str] = ""

    fit: Structure = Field(default=None, description="structure to fit, for example '2*GM() + WN()'")
    model: Structure = Field(default=None, description="a noise model, for example to be stabilised")
    plus: Structure = Field(
        default=None,
        description="processes that are added, for example 'RC(sigma=0.5 deg/s)': a turn-on bias, which no static log shows",
    )
    method: str = Field(default="gmwm", description="estimator, as of insemu fit --method")
    options: dict[str, int | float | str | bool] = Field(default_factory=dict, description="options of the estimator")
    stabilise: bool | Annotated[float, Field(gt=0, lt=1)] = Field(
        default=False,
        description="move poles of a polynomial that is not stationary inside the unit circle; a number is their largest modulus",
    )
    file: str | None = Field(default=None, description="noise-model file written by insemu fit")
    truth: bool = Field(default=False, description="the model of the truth")
    sensor: str | None = Field(
        default=None, description="a sensor that comes with insemu (insemu sensor), or the file of its card"
    )
    case: Literal["typical", "worst"] | None = Field(default=None, description="which of the sensor's figures; typical")

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
    wavelet: str = Field(default="db4", description="name of an orthogonal wavelet of PyWavelets")
    rule: Rule = Field(
        default="sure",
        description="how the threshold of an octave is found; approximation: the octaves are dropped whole; packets: an octave is divided into "
        "narrower bands where that tells motion from noise better",
    )
    mode: Literal["soft", "hard"] = Field(default="soft", description="coefficients are shrunk, or kept and dropped")
    delay: Seconds | None = Field(
        default=None,
        ge=0,
        examples=["0 s"],
        description="rule approximation in real time: every sample from those up to so much later, 0 s is causal; null: from the whole record",
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

    gyro: float = Field(default=1.0, gt=0, description="on the noise amplitudes of the gyroscopes")
    accel: float = Field(default=1.0, gt=0, description="on the noise amplitudes of the accelerometers")
    position: float = Field(default=1.0, gt=0, description="on the standard deviations of the positions")
    velocity: float = Field(default=1.0, gt=0, description="on the standard deviations of the velocities")


class ZeroUpdates(Section):
    """Zero velocity and zero angular rate as measurements at rest, which is found from the IMU and the fixes (never during an outage)."""

    every: Seconds = Field(default=1.0, gt=0, description="time between updates")
    velocity_sigma: Speed | None = Field(default=0.01, gt=0, description="standard deviation; null: no zero velocity")
    rate_sigma: RadiansPerSecond | None = Field(
        default=1e-4, gt=0, description="standard deviation; null: no zero rate"
    )

    def at(self, intervals: Iterable[tuple[float, float]]) -> Standstill:
        """The updates in these intervals, (start, end) in s."""
        sigmas = (np.inf if sigma is None else sigma for sigma in (self.velocity_sigma, self.rate_sigma))
        return Standstill(list(intervals), self.every, *sigmas)


class DesignOptions(Section):
    """How a design's filter runs."""

    covariance_every: int = Field(default=1, ge=1, description="covariance propagated every n-th IMU epoch")
    gate: float | None = Field(
        default=None, gt=0, lt=1, description="probability that a good fix is rejected; null: no gate"
    )
    gate_timeout: Seconds = Field(
        default=FilterOptions.gate_timeout,
        gt=0,
        le=LARGEST,
        examples=["5 s"],
        description="fixes are rejected for so long in a row; then one is taken",
    )
    prefilter: Prefilter | None = Field(default=None, description="wavelet de-noising of the IMU; absent: none")
    states: Annotated[Extras, Made(StateKeys)] = Field(
        default=Extras(),
        description="further states, each a random constant of this standard deviation; 0 leaves it out",
    )
    tuning: Tuning = Field(default=Tuning(), description="factors on what is believed")
    zero_updates: ZeroUpdates | None = Field(
        default=None, description="zero-velocity and zero-rate updates; {}: as usual"
    )
    compensate: EffectList = Field(
        default=(),
        description="effects that are removed from the data before the filter: {effect: id, sensor: gyro, parameter: value}",
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

    design: str | None = Field(
        default=None, description="a design that comes with insemu (insemu designs); the keys next to it win"
    )
    filter: str | None = Field(
        default=None,
        description="reference: the same filter written to be read (filterpy, slow); or one that an installed package offers (entry point "
        "insemu.filters); else insemu's own compiled one",
    )
    settings: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="keyword arguments of that filter"
    )
    sensor: str | None = Field(
        default=None, description="a sensor that comes with insemu (insemu sensor), or the file of its card"
    )
    case: Literal["typical", "worst"] | None = Field(default=None, description="which of the sensor's figures; typical")
    options: DesignOptions = Field(default=DesignOptions(), description="how the filter runs")

    gyro: GyroBelief = an_axis("the three gyroscopes")
    accel: AccelBelief = an_axis("the three accelerometers")
    gyro_x: GyroBelief = an_axis("gyroscope x, instead of what stands at gyro")
    gyro_y: GyroBelief = an_axis("gyroscope y, instead of what stands at gyro")
    gyro_z: GyroBelief = an_axis("gyroscope z, instead of what stands at gyro")
    accel_x: AccelBelief = an_axis("accelerometer x, instead of what stands at accel")
    accel_y: AccelBelief = an_axis("accelerometer y, instead of what stands at accel")
    accel_z: AccelBelief = an_axis("accelerometer z, instead of what stands at accel")

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
