"""What a scenario may say: one frozen section per part of the experiment, every number with the unit it is converted to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, field_validator, model_validator

from insemu import units
from insemu.errors import InputError
from insemu.noise import NoiseModel, axis_unit
from insemu.records import AXES

Vector3 = tuple[float, float, float]


def _quantity(unit: str) -> Callable[[Any], float]:
    return lambda value: units.parse(value, unit)


def _vector(unit: str) -> Callable[[Any], Vector3]:
    def read(value: Any) -> Vector3:
        items = list(value) if isinstance(value, list | tuple) else [value] * 3
        if len(items) != 3:
            raise InputError(f"found {len(items)} values, expected one or three")
        a, b, c = (units.parse(item, unit) for item in items)
        return a, b, c

    return read


def _schema(unit: str, *, vector: bool = False) -> WithJsonSchema:
    one = {
        "type": ["string", "number"],
        "description": f"a quantity with its unit, for example '1 {unit}'; a bare number is in {unit}",
    }
    return WithJsonSchema(
        {"anyOf": [one, {"type": "array", "items": one, "minItems": 3, "maxItems": 3}]} if vector else one
    )


Seconds = Annotated[float, BeforeValidator(_quantity("s")), _schema("s")]
Hertz = Annotated[float, BeforeValidator(_quantity("Hz")), _schema("Hz")]
Radians = Annotated[float, BeforeValidator(_quantity("rad")), _schema("rad")]
Metres = Annotated[Vector3, BeforeValidator(_vector("m")), _schema("m", vector=True)]
MetresPerSecond = Annotated[Vector3, BeforeValidator(_vector("m/s")), _schema("m/s", vector=True)]
Signal = Annotated[
    list[dict[str, Any]] | str,
    WithJsonSchema(
        {
            "description": "a noise model: text such as 'WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=10 deg/h, Tc=40 s)' or a list of processes",
            "anyOf": [
                {"type": "string"},
                {
                    "type": "array",
                    "items": {"type": "object", "properties": {"process": {"type": "string"}}, "required": ["process"]},
                },
            ],
        }
    ),
]


class Section(BaseModel):
    """A part of a scenario: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, allow_inf_nan=False)


class TrajectorySource(Section):
    """Where the motion comes from."""

    builtin: str | None = Field(
        default=None, description="name of a built-in trajectory, for example helicopter_mapping"
    )
    rate: Hertz = Field(default=100.0, gt=0, description="IMU rate")
    duration: Seconds | None = Field(default=None, gt=0, description="cut the trajectory after this time")
    mode: Literal["exact", "continuous"] = Field(
        default="exact", description="how the ideal IMU is made (docs/emulation.md)"
    )

    @model_validator(mode="after")
    def _one_source(self) -> TrajectorySource:
        if self.builtin is None:
            raise InputError("no source of motion; expected the key 'builtin'")
        return self


class RecordedSignal(Section):
    """Error signals cut from static records."""

    files: tuple[str, ...] = Field(
        min_length=1, description="static logs; a path, or shared:PATH under the shared data folder"
    )
    skip: Seconds = Field(default=0.0, ge=0, description="warm-up to leave out at the start of every record")
    remove_mean: Literal["record", "piece", "none"] = Field(
        default="record", description="what the mean is taken over and removed"
    )


def _models(value: Mapping[str, Any], kind: type[Section]) -> dict[str, Any]:
    """Spread the short forms ``gyro`` and ``accel`` over their three axes; a named axis wins."""
    spread: dict[str, Any] = {}
    for sensor in ("gyro", "accel"):
        if sensor in value:
            spread |= {axis: value[sensor] for axis in AXES if axis.startswith(sensor)}
    return spread | {axis: value[axis] for axis in AXES if axis in value}


class SensorModels(Section):
    """A noise model per axis; ``gyro`` and ``accel`` stand for their three axes, a named axis wins."""

    gyro: Signal | None = None
    accel: Signal | None = None
    gyro_x: Signal | None = None
    gyro_y: Signal | None = None
    gyro_z: Signal | None = None
    accel_x: Signal | None = None
    accel_y: Signal | None = None
    accel_z: Signal | None = None

    @field_validator("gyro", "accel", *AXES)
    @classmethod
    def _readable(cls, value: Any, info: Any) -> Any:
        if value is not None:
            unit = axis_unit(info.field_name)
            model = NoiseModel.from_list(value, unit)
            if not model.specified:
                raise InputError(f"the model '{model}' has parameters without a value")
        return value

    def models(self) -> dict[str, NoiseModel]:
        """Models of the axes that have one."""
        return {
            axis: NoiseModel.from_list(value, axis_unit(axis))
            for axis, value in _models(self.model_dump(exclude_none=True), SensorModels).items()
        }


class Truth(SensorModels):
    """What the sensors really do: a model per axis, or pieces of recorded error signals."""

    recorded: RecordedSignal | None = Field(
        default=None, description="pieces of recorded static signals instead of models"
    )
    record: Seconds | None = Field(
        default=None,
        gt=0,
        description="length of the simulated records that are cut into pieces, their mean removed (absent: no removal)",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Truth:
        models = self.models()
        if self.recorded is not None and models:
            raise InputError("found both models and recorded signals, expected one of them")
        if self.recorded is None and len(models) < 6:
            missing = ", ".join(axis for axis in AXES if axis not in models)
            raise InputError(f"no error model for {missing}; expected gyro and accel (or each axis), or recorded")
        return self


class FitSource(Section):
    """The signals that design models are fitted to."""

    simulate: Seconds | None = Field(default=None, gt=0, description="length of a static log simulated from the truth")
    recorded: RecordedSignal | None = Field(default=None, description="recorded static logs")

    @model_validator(mode="after")
    def _one_source(self) -> FitSource:
        if (self.simulate is None) == (self.recorded is None):
            raise InputError("expected exactly one of the keys 'simulate' and 'recorded'")
        return self


class AxisSource(Section):
    """A belief about one sensor: fitted to the fit source, read from a file, or the truth itself."""

    fit: str | None = Field(default=None, description="structure to fit, for example '2*GM() + WN()'")
    file: str | None = Field(default=None, description="noise-model file written by insemu fit")
    truth: bool = Field(default=False, description="the model of the truth")

    @field_validator("fit")
    @classmethod
    def _readable(cls, value: str | None) -> str | None:
        if value is not None:
            NoiseModel.parse(value)
        return value

    @model_validator(mode="after")
    def _one_source(self) -> AxisSource:
        if sum((self.fit is not None, self.file is not None, self.truth)) != 1:
            raise InputError("expected exactly one of the keys 'fit', 'file' and 'truth: true'")
        return self


def _belief(value: Any, info: Any) -> Any:
    if value is None or isinstance(value, AxisSource):
        return value
    if isinstance(value, Mapping) and "process" not in value:
        return AxisSource.model_validate(value)
    unit = axis_unit(info.field_name)
    model = NoiseModel.from_list(value, unit)
    if not model.specified:
        raise InputError(f"the model '{model}' has parameters without a value; to fit it write {{fit: '{model}'}}")
    return value


class Design(Section):
    """A filter design: what the filter believes about every axis."""

    gyro: AxisSource | Signal | None = None
    accel: AxisSource | Signal | None = None
    gyro_x: AxisSource | Signal | None = None
    gyro_y: AxisSource | Signal | None = None
    gyro_z: AxisSource | Signal | None = None
    accel_x: AxisSource | Signal | None = None
    accel_y: AxisSource | Signal | None = None
    accel_z: AxisSource | Signal | None = None

    _read = field_validator("gyro", "accel", *AXES, mode="before")(_belief)

    @model_validator(mode="after")
    def _complete(self) -> Design:
        missing = [axis for axis in AXES if axis not in self.sources()]
        if missing:
            raise InputError(f"no belief for {', '.join(missing)}; expected gyro and accel, or each axis")
        return self

    def sources(self) -> dict[str, AxisSource | NoiseModel]:
        """What every axis's belief comes from."""
        given = {name: getattr(self, name) for name in ("gyro", "accel", *AXES) if getattr(self, name) is not None}
        return {
            axis: value if isinstance(value, AxisSource) else NoiseModel.from_list(value, axis_unit(axis))
            for axis, value in _models(given, Design).items()
        }


class OutageWindow(Section):
    """A span without GNSS."""

    start: Seconds = Field(ge=0, description="time from the start of the trajectory")
    duration: Seconds = Field(ge=0)


class Gnss(Section):
    """The fixes that the filter gets, and what it believes of them."""

    rate: Hertz = Field(default=1.0, gt=0)
    position_sigma: Metres = Field(default=(0.02, 0.02, 0.02), description="standard deviation north, east, down")
    velocity_sigma: MetresPerSecond | None = Field(
        default=(0.02, 0.02, 0.02), description="standard deviation north, east, down; null: no velocity"
    )
    lever_arm: Metres = Field(default=(0.0, 0.0, 0.0), description="IMU to antenna, forward, right, down")
    outages: tuple[OutageWindow, ...] = ()

    @field_validator("position_sigma", "velocity_sigma")
    @classmethod
    def _positive(cls, value: Vector3 | None) -> Vector3 | None:
        if value is not None and min(value) <= 0:
            raise InputError(f"found {min(value)!r}, expected positive standard deviations")
        return value


class Initial(Section):
    """Standard deviations of the initial state; the true initial errors are drawn from the same, which the filter believes."""

    position_sigma: Metres = (0.1, 0.1, 0.1)
    velocity_sigma: MetresPerSecond = (0.05, 0.05, 0.05)
    tilt_sigma: Radians = Field(default=0.0087266, ge=0, description="roll and pitch")
    heading_sigma: Radians = Field(default=0.0174533, ge=0)


class Published(Section):
    """Figures of a paper, printed beside ours: mean planimetric error at the end of each outage."""

    source: str
    planimetric_end_m: dict[str, tuple[float, ...]] = Field(description="design name to one value per outage")


class Scenario(Section):
    """One question: a trajectory, a truth, GNSS with outages, and the designs that are compared."""

    title: str
    question: str = ""
    notes: str = ""
    seed: int = Field(default=1, ge=0)
    realizations: int = Field(default=24, ge=1)
    trajectory: TrajectorySource
    truth: Truth
    gnss: Gnss = Gnss()
    initial: Initial = Initial()
    fits: FitSource | None = Field(default=None, description="signals that models under designs are fitted to")
    designs: dict[str, Design] = Field(min_length=1)
    published: Published | None = None
    variants: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="name to the keys that differ; each is run too, under variants/NAME"
    )
    smoke: tuple[str, ...] = Field(
        default=("run", "--realizations", "2"), description="command and options of the project's smoke run"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        for name, design in self.designs.items():
            sources = [s for s in design.sources().values() if isinstance(s, AxisSource)]
            if self.fits is None and any(s.fit for s in sources):
                raise InputError(
                    f"the design '{name}' is fitted, but there is no section 'fits' that says to which signals"
                )
            if self.truth.recorded is not None and any(s.truth for s in sources):
                raise InputError(
                    f"the design '{name}' asks for the model of the truth, but the truth is a recorded signal"
                )
        if self.truth.recorded is not None and self.fits is not None and self.fits.simulate is not None:
            raise InputError("fits cannot be simulated from a recorded truth; expected the key 'recorded' under 'fits'")
        if self.published is not None:
            unknown = [name for name in self.published.planimetric_end_m if name not in self.designs]
            if unknown:
                raise InputError(f"published figures for '{unknown[0]}', which is no design here")
        return self
