"""What an effect is: a class with its parameters, its traits and everything that the program does with it; and an effect with numbers.

Each effect is one class in one of the files of this package, and says there how it is injected, removed, recognized in the innovations,
put together with a second find of itself, and hidden in a blind trial. An :class:`EffectUse` is an effect with numbers::

    EffectUse.from_mapping({"effect": "scale_factor", "sensor": "gyro", "value": ["500 ppm", 0, 0]})

Conventions: true quantities are w (angular rate, rad/s) and f (specific force, m/s^2) in sensor axes, s stands for
either; measured = (I + S + M) s + b + ...; a positive time offset means that IMU stamps are late.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from insemu import units
from insemu.effects.parameters import EffectParameter, Join, checked_numbers
from insemu.errors import InputError, nearest, shown
from insemu.noise import Process

if TYPE_CHECKING:
    from insemu.effects.aids import AidErrors
    from insemu.effects.chain import Chain, FixErrors
    from insemu.effects.hiding import DriveLot, Hidden, RestLot
    from insemu.effects.motion import AntennaMotion, Column, FixGeometry, Motion
    from insemu.effects.terms import Signals
    from insemu.records import AidRecord, GnssRecord, ImuRecord, Trajectory

Array = NDArray[np.float64]
Family = Literal["stochastic", "deterministic", "timing", "gnss", "model", "aids"]
AidKind = Literal["odometer", "barometer", "heading"]
Sensor = Literal["gyro", "accel", "imu", "gnss", "odometer", "barometer", "heading"]
#: What the program does with an effect; the columns of the matrix that a test walks.
Aspect = Literal["emulate", "compensate", "signature", "candidate", "refine", "trial"]
ASPECTS: tuple[Aspect, ...] = ("emulate", "compensate", "signature", "candidate", "refine", "trial")

#: Traits that searches and rooms above ask for; see :func:`insemu.effects.having`.
#:
#: slow, fast : seen below or above the block length of a log at rest
#: samples    : seen in single samples
#: shape      : a known function of time or temperature
#: process    : a slow random process whose size is one number per axis
#: once       : one number that only one description can have
#: drawn      : what was drawn is nobody's to know beforehand, and is taken out of the samples where it is found
#: noise      : its place is the noise model of an axis
#: level      : a level of the fixes, which is estimated together with their colour
#: second_order : a refinement of a plainer error, which is more common
#: outlying   : some fixes or measurements are far off, and which ones is nobody's to know beforehand: a filter gates them
#: filled     : takes samples, in whose place others are put from those around them
#: widened    : a filter without states for it widens what it believes; a search carries it in its model
#: equation   : what it is is an equation, its place as well: several of one sensor may stand side by side
#: evident    : read off the samples or together with a recorded signal: nothing unexplained can stand in for it
Trait = Literal[
    "slow",
    "fast",
    "samples",
    "shape",
    "process",
    "once",
    "drawn",
    "noise",
    "level",
    "second_order",
    "outlying",
    "filled",
    "widened",
    "equation",
    "evident",
]
#: Columns that are tried together: axes, label, their places among the effect's columns.
Subset = tuple[tuple[str, ...], str, list[int]]

XYZ, NED, RPY = ("x", "y", "z"), ("north", "east", "down"), ("roll", "pitch", "yaw")
#: Units of the signals of the inertial sensors and of the aids.
SIGNAL_UNITS = {"gyro": "rad/s", "accel": "m/s^2", "odometer": "m/s", "barometer": "m", "heading": "rad"}
DEG = math.pi / 180.0
G = units.STANDARD_GRAVITY
#: Why an effect of single samples has no column.
IN_SAMPLES = "seen in the samples, above the motion"
BOTH: tuple[Sensor, ...] = ("gyro", "accel")
IMU: tuple[Sensor, ...] = ("imu",)
GNSS: tuple[Sensor, ...] = ("gnss",)
#: Measurements other than the fixes that can have effects.
AID_KINDS: tuple[AidKind, ...] = ("odometer", "barometer", "heading")


class Stage(IntEnum):
    """Where in the chain of a sensor an effect acts: the order of injection, and backwards that of compensation."""

    MODEL = 0
    MOUNTING = 1
    RESPONSE = 2
    LAW = 3
    NOISE = 4
    FILTER = 5
    CLIP = 6
    ROUND = 7
    CLOCK = 8
    STAMP = 9
    LOSS = 10


class Effect:
    """What can be wrong. A subclass is an effect; :data:`insemu.effects.EFFECTS` holds one object of each.

    Attributes
    ----------
    id, name, family, sensors : str
        Stable key; the field's words; kind of effect; which sensors can have it.
    formula : str
        What it does to the signal.
    parameters : tuple of EffectParameter
    excitation : str
        What a recording needs to show it.
    in_filter : str
        How a filter carries or compensates it.
    axes : tuple of str
        What the numbers of a parameter with three numbers belong to.
    traits : frozenset of str
        See :data:`Trait`.
    size : str
        The parameter that makes the whole effect larger or smaller; empty where no single one does.
    process : type, optional
        The process of the noise algebra that holds it.
    stage : Stage, optional
        Where in the chain of the IMU it acts; None for effects of the fixes.
    needs_temperature : bool
    absent : mapping of aspect to str
        What the program does not do with it, and why; the test of completeness takes no other excuse.
    """

    id: ClassVar[str]
    name: ClassVar[str]
    family: ClassVar[Family]
    sensors: ClassVar[tuple[Sensor, ...]]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    excitation: ClassVar[str]
    in_filter: ClassVar[str]
    axes: ClassVar[tuple[str, ...]] = XYZ
    traits: ClassVar[frozenset[Trait]] = frozenset()
    size: ClassVar[str] = ""
    process: ClassVar[type[Process] | None] = None
    stage: ClassVar[Stage | None] = None
    needs_temperature: ClassVar[bool] = False
    absent: ClassVar[Mapping[Aspect, str]] = {}

    # -- what it is ----------------------------------------------------------------------------------------------------------------

    def parameter(self, name: str) -> EffectParameter:
        """Parameter by name; ``InputError`` with the nearest name where there is none."""
        for p in self.parameters:
            if p.name == name:
                return p
        raise InputError(
            f"effect '{self.id}' has no parameter '{name}'" + nearest(str(name), [p.name for p in self.parameters])
        )

    def unit(self, parameter: str, sensor: str, equation: str = "") -> str:
        """SI unit of a parameter for a sensor.

        Parameters
        ----------
        parameter, sensor : str
        equation : str
            Of an effect that is one.
        """
        return self.parameter(parameter).unit.replace("{s}", SIGNAL_UNITS.get(sensor, ""))

    def written(self, equation: str, sensor: str) -> str:
        """The equation of an effect that is one as it is written; empty of the others, which have none."""
        if equation:
            raise InputError(
                f"effect '{self.id}' has the key 'equation', expected it of 'expression' and 'expression_step'"
            )
        return ""

    def scale(self, parameter: str, sensor: str) -> float:
        """Datasheet magnitude of a parameter for a sensor, SI."""
        scales = self.parameter(parameter).scale
        return scales[self.sensors.index(sensor)] if len(scales) > 1 and sensor in self.sensors else scales[0]

    @property
    def compensable(self) -> bool:
        """Whether its numbers can be subtracted from the data."""
        return any(self.does(name) for name in INVERSES)

    @property
    def needs_trajectory(self) -> bool:
        """Whether taking it off needs to know where the vehicle is and how it stands."""
        return self.does("omitted") or self.does("corrected_along")

    # -- emulate: what the emulator does ---------------------------------------------------------------------------------------------

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Do to the signals of the IMU what a use says; for effects of the IMU.

        Parameters
        ----------
        chain : Chain
            Signals on their way through the sensor, changed in place.
        use : EffectUse
        rng : Generator
            Of this effect alone.
        """
        raise NotImplementedError(self.id)

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Do to the errors of the fixes what a use says; for effects of the fixes.

        Parameters
        ----------
        fixes : FixErrors
            Changed in place.
        use : EffectUse
        rng : Generator
            Of this effect alone.
        """
        raise NotImplementedError(self.id)

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Do to what an aid measures what a use says; for effects of aids.

        Parameters
        ----------
        errors : AidErrors
            Changed in place.
        use : EffectUse
        rng : Generator
            Of this effect alone.
        """
        raise NotImplementedError(self.id)

    def age(self, use: EffectUse) -> float:
        """By what a measurement of an aid is older than its stamp, s."""
        raise NotImplementedError(self.id)

    # -- compensate: what a filter that knows it does to its data; at most a few of these ---------------------------------------------

    def restored(self, use: EffectUse, imu: ImuRecord) -> ImuRecord:
        """The record as it was recorded with what was lost filled in, before anything else is removed."""
        raise NotImplementedError(self.id)

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """What it adds whatever the signal, (n, 3) or (3,).

        Parameters
        ----------
        use : EffectUse
        t : (n,) array
            s.
        temperature : (n,) array or None
            degC.
        """
        raise NotImplementedError(self.id)

    def matrix(self, use: EffectUse) -> Array:
        """Error (6, 6) per rate and specific force, of rate and specific force."""
        raise NotImplementedError(self.id)

    def bent(self, use: EffectUse, signal: Array, temperature: Array | None, t: Array) -> Array:
        """Error (n, 6) as a function of the true signal, where that is not linear or not constant.

        Parameters
        ----------
        use : EffectUse
        signal : (n, 6) array
            True rate, rad/s, and specific force, m/s^2.
        temperature : (n,) array or None
            degC.
        t : (n,) array
            s.
        """
        raise NotImplementedError(self.id)

    def turn(self, use: EffectUse) -> Array:
        """The turn (3, 3) from the axes of the IMU to those of the body that is assumed."""
        raise NotImplementedError(self.id)

    def true_time(self, use: EffectUse, t: Array) -> Array:
        """True times (n,) of stamps (n,)."""
        raise NotImplementedError(self.id)

    def omitted(
        self, use: EffectUse, trajectory: Trajectory, rows: NDArray[np.int64], signals: Signals
    ) -> tuple[Array | None, Array | None]:
        """What the rate and the specific force lack, (n, 3) in body axes each, or None.

        Parameters
        ----------
        use : EffectUse
        trajectory : Trajectory
        rows : (n,) array of int
            Rows of the trajectory.
        signals : Signals
            Time, rate, specific force and temperature of the IMU, (n,) each.
        """
        raise NotImplementedError(self.id)

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """The fixes put right."""
        raise NotImplementedError(self.id)

    def corrected_along(self, use: EffectUse, gnss: GnssRecord, way: AntennaMotion) -> GnssRecord:
        """The fixes put right along a motion.

        Parameters
        ----------
        use : EffectUse
        gnss : GnssRecord
        way : AntennaMotion
        """
        raise NotImplementedError(self.id)

    def smoothing(self, use: EffectUse) -> Array:
        """Time constants (3,) in s, NED, by which velocities of the fixes were smoothed that a use puts right along a motion."""
        raise NotImplementedError(self.id)

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """An aid put right."""
        raise NotImplementedError(self.id)

    def true_sigma(self, use: EffectUse, what: str, stated: Array) -> Array:
        """Standard deviations of the fixes as they are.

        Parameters
        ----------
        use : EffectUse
        what : {"position", "velocity"}
        stated : (..., 3) array
            As they are stated, m or m/s.
        """
        raise NotImplementedError(self.id)

    def arm(self, use: EffectUse) -> Array:
        """What the assumed lever arm lacks, (3,) m in body axes."""
        raise NotImplementedError(self.id)

    # -- signature: what it does to the innovations, by analysis; nothing here may come from the emulator's functions -------------------

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """Unit columns along an estimated motion, for effects whose shape is known."""
        raise NotImplementedError(self.id)

    def about(self, column: Column, value: float, motion: Motion, fixes: FixGeometry) -> Column:
        """The unit column of the fixes at a size, for effects that are no multiple of one column.

        Parameters
        ----------
        column : Column
            One of :meth:`columns`, which is that of a small effect.
        value : float
            Size, in the unit of the column.
        motion, fixes : Motion, FixGeometry
        """
        raise NotImplementedError(self.id)

    def more(self, column: Column, use: EffectUse, motion: Motion) -> Column:
        """The unit column of one more of what is known with numbers: the same but where these shape it.

        Parameters
        ----------
        column : Column
            One of :meth:`columns`.
        use : EffectUse
            What is known.
        motion : Motion
        """
        return column

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """What a unit of each of its numbers adds to an aid, (n, rows), for effects of aids whose shape is known.

        Parameters
        ----------
        values, slope : (n, rows) arrays
            What a perfect instrument measures, and its rate of change, SI.
        """
        raise NotImplementedError(self.id)

    def settled_with(self, values: Array) -> dict[str, float]:
        """Numbers that an estimate from :meth:`aid_columns` goes with; none of most."""
        return {}

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """Which of its columns on one sensor a search tries together: each alone, and all."""
        out: list[Subset] = [(c.axes, "", [k]) for k, c in enumerate(columns)]
        if len(columns) > 1:
            out.append((tuple(dict.fromkeys(a for c in columns for a in c.axes)), "all", list(range(len(columns)))))
        return out

    def odds(self, column: Column) -> float:
        """How common one of its columns is among them: 1, or less."""
        return 1.0

    # -- refine: how two finds become one -----------------------------------------------------------------------------------------------

    @property
    def adds(self) -> bool:
        """Whether it is an error of one sensor whose values add up."""
        return bool(
            self.stage in (Stage.RESPONSE, Stage.LAW) and all(p.join in ("sum", "equal") for p in self.parameters)
        )

    def merged(self, old: EffectUse, new: EffectUse) -> EffectUse | None:
        """One use for a known one and what was found beyond it; None where they stay two entries."""
        values = {}
        for p in self.parameters:
            a, b = np.array(old[p.name]), np.array(new[p.name])
            if not p.join or (p.join == "equal" and not np.array_equal(a, b)):
                return None
            values[p.name] = tuple(float(x) for x in _JOINED[p.join](a, b))
        return EffectUse(self.id, old.sensor, values, old.equation)

    # -- trial: how it is hidden ---------------------------------------------------------------------------------------------------------

    def hidden(self, lot: DriveLot) -> Hidden:
        """How it is hidden in a drive or flight: axes and numbers from a lot, at its datasheet's scale."""
        raise NotImplementedError(self.id)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """How it is hidden in a log at rest: its numbers at a strength, 1 near what an hour can show."""
        raise NotImplementedError(self.id)

    def does(self, what: str) -> bool:
        """Whether this effect has a function of its own, such as ``columns`` or ``hidden``."""
        return getattr(type(self), what) is not getattr(Effect, what)


#: The functions by which an effect is removed.
INVERSES = (
    "restored",
    "added",
    "matrix",
    "bent",
    "turn",
    "true_time",
    "omitted",
    "corrected_fixes",
    "corrected_along",
    "corrected_aid",
    "arm",
)
_JOINED: Mapping[Join, Any] = {
    "sum": np.add,
    "product": np.multiply,
    "root_sum_square": np.hypot,
    "larger": np.maximum,
    "smaller": np.minimum,
    "later": lambda old, new: new,
    "equal": lambda old, new: old,
}


#: Effect by id; the files of this package fill it when the package is imported.
EFFECTS: dict[str, Effect] = {}


@dataclass(frozen=True)
class EffectUse:
    """An effect with numbers: what the emulator injects and what a scenario writes down.

    Parameters
    ----------
    id : str
        Key of :data:`EFFECTS`.
    sensor : str
        ``gyro``, ``accel``, ``imu``, ``gnss``, or an aid: ``odometer``, ``barometer``, ``heading``.
    values : mapping of str to tuple of float
        Every parameter in SI, with as many numbers as the table says.
    equation : str
        Of an effect that is one: what its error is proportional to (:func:`insemu.effects.terms.equation`); empty for the others.

    Raises
    ------
    InputError
        An unknown effect, sensor or parameter, a missing, negative or implausible value, a wrong count.
    """

    id: str
    sensor: str
    values: Mapping[str, tuple[float, ...]]
    equation: str = ""

    def __post_init__(self) -> None:
        effect = effect_of(self.id)
        _check_sensor(effect, self.sensor)
        object.__setattr__(self, "equation", effect.written(self.equation, self.sensor))
        for name in self.values:
            effect.parameter(name)
        object.__setattr__(
            self, "values", {p.name: checked_numbers(effect.id, p, self.values.get(p.name)) for p in effect.parameters}
        )

    @property
    def effect(self) -> Effect:
        """What the table says."""
        return EFFECTS[self.id]

    def __getitem__(self, name: str) -> tuple[float, ...]:
        return self.values[name]

    @property
    def inertial(self) -> bool:
        """Whether it is an effect of the IMU."""
        return self.sensor in ("gyro", "accel", "imu")

    def scalar(self, name: str) -> float:
        """A parameter of one number."""
        return self.values[name][0]

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> EffectUse:
        """Read ``{"effect": id, "sensor": ..., parameter: quantity, ...}``; quantities are SI numbers or texts with
        units.

        ``sensor`` may be left out where the effect has only one; ``axes`` (``x``, ``[x, z]``) puts single numbers on
        those axes and zero on the others.
        """
        if not isinstance(mapping, Mapping):
            raise InputError(
                f"found {shown(mapping)}, expected an effect as a mapping such as {{effect: scale_factor, ...}}"
            )
        given = dict(mapping)
        if "effect" not in given:
            raise InputError("an effect needs the key 'effect'" + nearest("effect", [str(k) for k in given]))
        effect = effect_of(given.pop("effect"))
        sensor = given.pop("sensor", None)
        if sensor is None:
            if len(effect.sensors) > 1:
                raise InputError(f"effect '{effect.id}' needs the key 'sensor': {' or '.join(effect.sensors)}")
            sensor = effect.sensors[0]
        _check_sensor(effect, sensor)
        axes = given.pop("axes", None)
        equation = effect.written(given.pop("equation", ""), sensor)
        values: dict[str, tuple[float, ...]] = {}
        for name, quantity in given.items():
            p = effect.parameter(name)
            own = effect.unit(p.name, sensor, equation)
            numbers = _parsed(effect, p, quantity, own)
            if axes is not None and p.size == 3 and len(numbers) == 1:
                chosen = list(axes) if isinstance(axes, list | tuple) else [axes]
                for axis in chosen:
                    if axis not in XYZ:
                        raise InputError(f"effect '{effect.id}': unknown axis {shown(axis)} (expected x, y or z)")
                numbers = tuple(numbers[0] if axis in chosen else 0.0 for axis in XYZ)
            values[name] = numbers
        return cls(effect.id, sensor, values, equation)

    def to_mapping(self) -> dict[str, Any]:
        """Inverse of :meth:`from_mapping`, SI numbers."""
        out: dict[str, Any] = {"effect": self.id, "sensor": self.sensor}
        if self.equation:
            out["equation"] = self.equation
        for name, numbers in self.values.items():
            out[name] = numbers[0] if len(numbers) == 1 else list(numbers)
        return out


def _check_sensor(effect: Effect, sensor: Any) -> None:
    if sensor not in effect.sensors:
        raise InputError(
            f"effect '{effect.id}' has the sensor {shown(sensor)}, expected {' or '.join(repr(s) for s in effect.sensors)}"
        )


def _parsed(effect: Effect, p: EffectParameter, quantity: Any, unit: str) -> tuple[float, ...]:
    """Quantities as a file has them, in SI."""
    items: Sequence[Any] = quantity if isinstance(quantity, list | tuple) else [quantity]
    numbers = []
    for item in items:
        if isinstance(item, bool) or not isinstance(item, str | int | float | np.number):
            raise InputError(
                f"effect '{effect.id}', '{p.name}': found {shown(item)}, expected a quantity in {unit or 'plain numbers'}"
            )
        try:
            numbers.append(units.parse(item if isinstance(item, str) else float(item), unit))
        except InputError as error:
            raise InputError(f"effect '{effect.id}', '{p.name}': {error.message}") from None
        except OverflowError:
            raise InputError(
                f"effect '{effect.id}', '{p.name}': found {shown(item)}, expected a finite number"
            ) from None
    return tuple(numbers)


def effect_of(effect_id: Any) -> Effect:
    """Effect by id; ``InputError`` with the nearest id where there is none."""
    if not isinstance(effect_id, str) or effect_id not in EFFECTS:
        raise InputError(
            f"unknown effect {shown(effect_id)}" + nearest(effect_id if isinstance(effect_id, str) else "", EFFECTS)
        )
    return EFFECTS[effect_id]
