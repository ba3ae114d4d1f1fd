"""How the parts of a scenario are read: quantities with units, and sections that become the objects other rooms work with.

Every value is parsed here, once, while the scenario is loaded. What is written is kept next to it, so that the resolved scenario shows the
user's own units; what reaches a parser of another room is of the type that the parser takes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PlainSerializer,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from insemu import units
from insemu.effects import AID_KINDS, EFFECTS, EffectUse
from insemu.errors import InputError, nearest, shown
from insemu.filters import AIDS, AidUse
from insemu.noise import NoiseModel
from insemu.records import AXES

Vector3 = tuple[float, float, float]

#: Longest name of a design or a variant, characters.
MAX_NAME = 80
#: Most effects, and most processes of one model.
MAX_ITEMS = 64


def _plain(value: Any) -> bool:
    """Whether a value is what YAML can hold."""
    if isinstance(value, Mapping):
        return all(isinstance(k, str) and _plain(v) for k, v in value.items())
    if isinstance(value, list | tuple):
        return all(map(_plain, value))
    return value is None or isinstance(value, str | int | float)


class Section(BaseModel):
    """A part of a scenario: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, allow_inf_nan=False)
    #: Fields whose objects are shown as they were written.
    _PARSED: ClassVar[frozenset[str]] = frozenset()
    _written: dict[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        cls._PARSED = frozenset(
            name for name, field in cls.model_fields.items() if any(isinstance(m, Parsed) for m in field.metadata)
        )

    def __eq__(self, other: object) -> bool:
        """Whether both mean the same, however it was written."""
        return type(self) is type(other) and self.__dict__ == other.__dict__

    @classmethod
    def spelled_out(cls, value: Any) -> Any:
        """What a short form of the section stands for."""
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, value: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        value = cls.spelled_out(value)
        made = handler(value)
        if isinstance(value, Mapping):
            made._written = {
                k: value[k]
                for k in cls._PARSED
                if value.get(k) is not None and _plain(value[k]) and not isinstance(getattr(made, k), Section)
            }
        return made

    @model_serializer(mode="wrap")
    def _shown(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        out: dict[str, Any] = handler(self)
        return {k: self._written.get(k, v) for k, v in out.items()}


def computed(read: Callable[[Any], Any], value: Any) -> Any:
    """``read(value)``; numbers that double precision cannot hold on the way are the user's input, not an accident."""
    try:
        return read(value)
    except ArithmeticError as error:
        raise InputError(f"found {shown(value)}, whose value is beyond double precision ({error})") from None


@dataclass(frozen=True)
class Parsed:
    """A field that holds an object made of plain data; None stays None.

    Parameters
    ----------
    read : callable
        Plain data, or the object itself, to the object; raises ``InputError``.
    show : callable
        The object to plain data, where nothing was written.
    json : mapping
        JSON schema, for editors.
    """

    read: Callable[[Any], Any]
    show: Callable[[Any], Any]
    json: Mapping[str, Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            lambda value: None if value is None else computed(self.read, value),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value: None if value is None else self.show(value)
            ),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [dict(self.json), {"type": "null"}]}

    def __hash__(self) -> int:
        return id(self)


@dataclass(frozen=True)
class Made:
    """A section whose values, under the names of its fields, are the arguments of an object of another room."""

    keys: type[Section]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        section = self.keys

        def make(value: Any, inner: Callable[[Any], Any]) -> Any:
            if isinstance(value, source):
                return value
            held = inner(value)
            return source(**{name: getattr(held, name) for name in section.model_fields})

        def show(value: Any, info: Any) -> Any:
            same = section.model_construct(**{name: getattr(value, name) for name in section.model_fields})
            return same.model_dump(
                mode=info.mode, by_alias=True, exclude_none=info.exclude_none, exclude_defaults=info.exclude_defaults
            )

        return core_schema.no_info_wrap_validator_function(
            make,
            handler.generate_schema(section),
            serialization=core_schema.plain_serializer_function_ser_schema(show, info_arg=True),
        )


# -- quantities -------------------------------------------------------------------------------------------------------------------


def number(value: Any, unit: str) -> float:
    """A quantity as written in YAML, in SI; anything but a number or text is refused."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"found {shown(value)}, expected a quantity such as '1 {unit}'")
    return float(computed(lambda given: units.parse(given, unit), value))


def _vector(value: Any, unit: str, without_down: bool = False) -> Vector3:
    items = list(value) if isinstance(value, list | tuple) else [value] * 3
    if len(items) != 3:
        raise InputError(f"found {len(items)} values, expected one or three")
    a, b = (number(item, unit) for item in items[:2])
    return a, b, float("nan") if items[2] is None and without_down else number(items[2], unit)


def key(default: Any, what: str, **limits: Any) -> Any:
    """A key of a section that may be left out: what it is then, what it means, and pydantic's limits of its value."""
    return Field(default=default, description=what, **limits)


def _one(unit: str) -> dict[str, Any]:
    return {
        "type": ["string", "number"],
        "x-unit": unit,
        "description": f"a quantity with its unit, for example '1 {unit}'; a bare number is in {unit}",
    }


def _quantity(unit: str, shown: str = "") -> tuple[BeforeValidator, WithJsonSchema]:
    return BeforeValidator(lambda value: number(value, unit)), WithJsonSchema(_one(shown or unit))


def _vector_of(unit: str, without_down: bool = False) -> tuple[BeforeValidator, WithJsonSchema]:
    item = {"anyOf": [_one(unit), {"type": "null"}]} if without_down else _one(unit)
    many = {"type": "array", "items": item, "minItems": 3, "maxItems": 3}
    return BeforeValidator(lambda value: _vector(value, unit, without_down)), WithJsonSchema(
        {"anyOf": [_one(unit), many]}
    )


Seconds = Annotated[float, *_quantity("s")]
Hertz = Annotated[float, *_quantity("Hz")]
Radians = Annotated[float, *_quantity("rad")]
RadiansPerSecond = Annotated[float, *_quantity("rad/s")]
Ratio = Annotated[float, *_quantity("1", "ppm")]
PerKelvin = Annotated[float, *_quantity("1/K", "ppm/K")]
Speed = Annotated[float, *_quantity("m/s")]
Length = Annotated[float, *_quantity("m")]
LengthNoise = Annotated[float, *_quantity("m/sqrt(s)")]
SpeedWalk = Annotated[float, *_quantity("m/s/sqrt(s)")]
Angles = Annotated[Vector3, *_vector_of("rad")]
Metres = Annotated[Vector3, *_vector_of("m")]
MetresPerSecond = Annotated[Vector3, *_vector_of("m/s")]
#: NaN down, written null, where a velocity has no such component.
MetresPerSecondOrLevel = Annotated[
    tuple[float, float, Annotated[float, AllowInfNan(True), PlainSerializer(lambda v: None if v != v else v)]],
    *_vector_of("m/s", without_down=True),
]


def _name(text: str) -> str:
    wrong = not text.isprintable() or set(text) & set('/\\:*?"<>|') or text != text.strip() or text.startswith(".")
    if not text or wrong or len(text) > MAX_NAME or text.endswith("."):
        raise InputError(
            f'found the name {text[:MAX_NAME]!r}, expected 1 to {MAX_NAME} printable characters without / \\ : * ? " < > | and without a '
            "full stop or a space at either end: it becomes the name of a folder and of a variable in NetCDF"
        )
    return text


#: The name of a design or a variant, which becomes the name of a folder.
Name = Annotated[str, AfterValidator(_name)]


# -- noise models and effects -----------------------------------------------------------------------------------------------------


def _items(value: Any, key: str) -> list[Mapping[str, Any]]:
    """A list of mappings whose values are texts, numbers or lists of them."""
    if not isinstance(value, list | tuple) or not all(isinstance(item, Mapping) for item in value):
        raise InputError(f"found {shown(value)}, expected a list of mappings with the key '{key}'")
    if len(value) > MAX_ITEMS:
        raise InputError(f"found {len(value)} mappings with the key '{key}', expected at most {MAX_ITEMS}")
    for item in value:
        for name, given in item.items():
            some = given if isinstance(given, list | tuple) else [given]
            if not all(isinstance(v, str | int | float) for v in some):
                raise InputError(f"found {shown(given)} under '{name}', expected a text, a number or a list of them")
        if not isinstance(item.get(key), str):
            raise InputError(f"found {shown(dict(item))}, expected a mapping with the key '{key}'")
    return list(value)


def noise_model(value: Any, unit: str, *, specified: bool = False) -> NoiseModel:
    """A noise model as written: text, or a list of processes.

    Parameters
    ----------
    value : str, list of mappings or NoiseModel
    unit : str
        SI unit of the signal.
    specified : bool
        Whether every parameter must have a value.

    Raises
    ------
    InputError
    """
    if isinstance(value, NoiseModel):
        model = value
    elif isinstance(value, str):
        model = NoiseModel.parse(value, unit)
    else:
        model = NoiseModel.from_list(_items(value, "process"), unit)
    if specified and not model.specified:
        raise InputError(f"the model '{model}' has parameters without a value; to fit it write {{fit: '{model}'}}")
    if len(model) > MAX_ITEMS:
        raise InputError(f"the model has {len(model)} processes, expected at most {MAX_ITEMS}")
    return model


MODEL_JSON: dict[str, Any] = {
    "description": "a noise model: text such as 'WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=10 deg/h, Tc=40 s)' or a list of processes",
    "anyOf": [
        {"type": "string"},
        {
            "type": "array",
            "items": {"type": "object", "properties": {"process": {"type": "string"}}, "required": ["process"]},
        },
    ],
}


def _model(unit: str) -> Parsed:
    return Parsed(lambda v: noise_model(v, unit, specified=True), lambda m: m.to_list(unit), MODEL_JSON)


#: Models in numbers of a gyroscope and of an accelerometer; a structure whose parameters may be open.
GyroModel = Annotated[NoiseModel | None, _model("rad/s")]
AccelModel = Annotated[NoiseModel | None, _model("m/s^2")]
Structure = Annotated[NoiseModel | None, Parsed(lambda v: noise_model(v, ""), str, MODEL_JSON)]


def _effects(value: Any) -> tuple[EffectUse, ...]:
    if isinstance(value, list | tuple) and all(isinstance(item, EffectUse) for item in value):
        return tuple(value)
    return tuple(EffectUse.from_mapping(item) for item in _items(value, "effect"))


EffectList = Annotated[
    tuple[EffectUse, ...],
    Parsed(
        _effects,
        lambda uses: [use.to_mapping() for use in uses],
        {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "effect": {"type": "string", "enum": sorted(EFFECTS)},
                    "sensor": {"type": "string", "enum": ["gyro", "accel", "imu", "gnss", *AID_KINDS]},
                    "axes": {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]},
                },
                "required": ["effect"],
            },
        },
    ),
    AfterValidator(lambda uses: uses or ()),
]


def _aids(value: Any) -> tuple[AidUse, ...]:
    if isinstance(value, list | tuple) and all(isinstance(item, AidUse) for item in value):
        return tuple(value)
    emulated = {name: aid for name, aid in AIDS.items() if aid.truth is not None}
    if not isinstance(value, Mapping) or not all(isinstance(v, Mapping) and _plain(v) for v in value.values()):
        raise InputError(
            f"found {shown(value)}, expected the name of an aid with its rate and sigma: {', '.join(emulated)}"
        )
    for name in value:
        if name not in emulated:
            raise InputError(f"no aid '{name}' to emulate" + nearest(str(name), emulated))
    return tuple(computed(lambda given: AidUse.from_mapping(*given), (emulated[n], v)) for n, v in value.items())


AidUses = Annotated[
    tuple[AidUse, ...],
    Parsed(
        _aids,
        lambda uses: {use.aid.name: use.to_mapping() for use in uses},
        {
            "type": "object",
            "properties": {name: {"type": "object"} for name, aid in AIDS.items() if aid.truth is not None},
        },
    ),
    AfterValidator(lambda uses: uses or ()),
]


def per_axis(section: Section) -> dict[str, Any]:
    """What a section gives per axis; the short forms ``gyro`` and ``accel`` stand for their three, a named axis wins."""
    out = {}
    for axis in AXES:
        value = getattr(section, axis)
        value = getattr(section, axis.split("_")[0]) if value is None else value
        if value is not None:
            out[axis] = value
    return out
