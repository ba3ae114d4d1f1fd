"""The one table of effects that a sensor, a clock or a receiver may have: id, formula, parameters, units, datasheet
scale.

The emulator injects them, the scenario writes them down, the gap workflow names them. An :class:`Effect` says what an
effect is; an :class:`EffectUse` is one with numbers::

    EffectUse.from_mapping({"effect": "scale_factor", "sensor": "gyro", "value": ["500 ppm", 0, 0]})

Conventions: true quantities are w (angular rate, rad/s) and f (specific force, m/s^2) in sensor axes, s stands for
either; measured = (I + S + M) s + b + ...; a positive time offset means that IMU stamps are late.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from insemu import units
from insemu.errors import InputError, nearest

Family = Literal["stochastic", "deterministic", "timing", "gnss", "model"]
Sensor = Literal["gyro", "accel", "imu", "gnss"]

#: Cross-axis parameters (six): axis that errs, then axis that leaks into it.
CROSS = ("xy", "xz", "yx", "yz", "zx", "zy")


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect.

    Parameters
    ----------
    name : str
        Key in mappings and scenarios.
    unit : str
        SI unit; ``{s}`` stands for the unit of the sensor's signal (rad/s or m/s^2) and is empty for GNSS and timing.
    size : int
        1: one number; 3: one per axis (a single number is taken for all three); 6: one per cross-axis pair
        (:data:`CROSS`); 9: a 3 x 3 matrix row by row (three numbers are its diagonal).
    scale : tuple of float
        Typical datasheet magnitude in SI: one for every sensor of the effect (``gyro, accel``) or one in all. The
        priors of the gap workflow are multiples of it.
    default : float or None
        Value where none is given; None: must be given.
    meaning : str
        In words.
    positive : bool
        Whether negative values are refused.
    """

    name: str
    unit: str
    size: int
    scale: tuple[float, ...]
    default: float | None
    meaning: str
    positive: bool = False


@dataclass(frozen=True)
class Effect:
    """What can be wrong.

    Parameters
    ----------
    id : str
        Stable key.
    name : str
        The field's words.
    family : str
        stochastic, deterministic, timing, gnss or model.
    sensors : tuple of str
        Which sensors can have it.
    formula : str
        What it does to the signal.
    parameters : tuple of EffectParameter
    excitation : str
        What a recording needs to show it.
    in_filter : str
        How a filter carries or compensates it.
    """

    id: str
    name: str
    family: Family
    sensors: tuple[Sensor, ...]
    formula: str
    parameters: tuple[EffectParameter, ...]
    excitation: str
    in_filter: str

    def parameter(self, name: str) -> EffectParameter:
        """Parameter by name; ``InputError`` with the nearest name where there is none."""
        for p in self.parameters:
            if p.name == name:
                return p
        raise InputError(
            f"effect '{self.id}' has no parameter '{name}'" + nearest(name, [p.name for p in self.parameters])
        )

    def unit(self, parameter: str, sensor: str) -> str:
        """SI unit of a parameter for a sensor."""
        return self.parameter(parameter).unit.replace("{s}", SIGNAL_UNITS.get(sensor, ""))

    def scale(self, parameter: str, sensor: str) -> float:
        """Datasheet magnitude of a parameter for a sensor, SI."""
        scales = self.parameter(parameter).scale
        return scales[-1] if sensor == "accel" else scales[0]


#: Units of the signals of the inertial sensors.
SIGNAL_UNITS = {"gyro": "rad/s", "accel": "m/s^2"}

_DEG = math.pi / 180.0
_G = units.STANDARD_GRAVITY
_BOTH: tuple[Sensor, ...] = ("gyro", "accel")
_P = EffectParameter
_PROFILE = _P("rest_factor", "", 1, (1.0,), 1.0, "share of the noise that remains at standstill (0 to 1)", True)

_TABLE = (
    # -- stochastic
    # -----------------------------------------------------------------------------------------------------------
    Effect(
        "white_noise", "white noise", "stochastic", _BOTH, "e_k ~ N(0, N^2 / dt)",
        (_P("N", "{s}/sqrt(Hz)", 3, (0.01 * _DEG, 1e-4 * _G), None, "root of the two-sided PSD", True),),
        "any recording", "noise level of the mechanization",
    ),
    Effect(
        "random_walk", "random walk", "stochastic", _BOTH, "e' = K w",
        (_P("K", "{s}*sqrt(Hz)", 3, (1e-4 * _DEG, 1e-6 * _G), None, "root of the driving PSD", True),),
        "minutes to hours", "one state per axis",
    ),
    Effect(
        "gauss_markov", "Gauss-Markov process (bias instability)", "stochastic", _BOTH, "e' = -beta e + sigma sqrt(2 beta) w",
        (
            _P("sigma", "{s}", 3, (0.01 * _DEG, 1e-4 * _G), None, "stationary standard deviation", True),
            _P("beta", "1/s", 3, (0.01,), None, "inverse correlation time", True),
        ),
        "several correlation times", "one state per axis",
    ),
    Effect(
        "quantization", "quantization", "stochastic", _BOTH, "y = LSB round(s / LSB); error variance LSB^2 / 12",
        (_P("lsb", "{s}", 3, (0.05 * _DEG, 3e-3 * _G), None, "least significant bit of the output", True),),
        "any recording; steps are visible at rest", "white noise of variance LSB^2 / 12 where the noise exceeds the LSB",
    ),
    Effect(
        "flicker", "flicker noise (1/f)", "stochastic", _BOTH, "two-sided PSD B^2 / (2 pi |f|); Allan floor B sqrt(2 ln 2 / pi)",
        (_P("B", "{s}", 3, (0.005 * _DEG, 5e-5 * _G), None, "bias instability coefficient", True),),
        "minutes to hours", "a few Gauss-Markov states with a stated error",
    ),
    Effect(
        "ramp", "ramp (drift)", "stochastic", _BOTH, "e(t) = R (t - t_0)",
        (_P("R", "{s}/s", 3, (1e-5 * _DEG, 1e-7 * _G), None, "slope"),),
        "tens of minutes", "a constant-slope state pair per axis",
    ),
    Effect(
        "vibration_line", "vibration line", "stochastic", _BOTH, "e(t) = p(v) A sin(2 pi f t + phase), p from rest_factor to 1 with speed",
        (
            _P("amplitude", "{s}", 3, (0.2 * _DEG, 0.02 * _G), None, "amplitude", True),
            _P("frequency", "Hz", 1, (20.0,), None, "frequency", True),
            _P("phase", "rad", 1, (1.0,), 0.0, "phase at the start of the record"),
            _PROFILE,
        ),
        "rate above twice the frequency, else an alias", "white noise of the same power, or a filter in front",
    ),
    Effect(
        "vibration_band", "coloured vibration", "stochastic", _BOTH, "p(v) times white noise through a two-pole resonance",
        (
            _P("rms", "{s}", 3, (0.2 * _DEG, 0.02 * _G), None, "standard deviation in motion", True),
            _P("frequency", "Hz", 1, (20.0,), None, "centre of the band", True),
            _P("bandwidth", "Hz", 1, (5.0,), None, "width of the band (full width at half power)", True),
            _PROFILE,
        ),
        "motion", "white noise of the same low-frequency power",
    ),
    Effect(
        "decimation_filter", "bandwidth and decimation filter", "stochastic", _BOTH,
        "y = h * s: moving average over `taps` samples, or Butterworth low-pass of `order` at `cutoff`; delay (taps - 1) dt / 2",
        (
            _P("cutoff", "Hz", 1, (30.0,), 0.0, "-3 dB frequency; zero: moving average instead", True),
            _P("order", "", 1, (2.0,), 2.0, "order of the low-pass", True),
            _P("taps", "", 1, (4.0,), 1.0, "length of the moving average in samples", True),
        ),
        "any recording (colour of the noise); fast motion (delay)", "coloured noise; the delay as a time offset",
    ),
    Effect(
        "outliers", "outliers (heavy tails)", "stochastic", _BOTH, "with probability p: e_k ~ N(0, sigma^2), else 0",
        (
            _P("probability", "", 1, (0.001,), None, "share of samples", True),
            _P("sigma", "{s}", 3, (1.0 * _DEG, 0.05 * _G), None, "standard deviation of an outlier", True),
        ),
        "any recording", "robust update, or a check on the samples",
    ),
    Effect(
        "telegraph", "telegraph noise (popcorn)", "stochastic", _BOTH, "e = +-amplitude, switching at Poisson times of mean rate `rate`",
        (
            _P("amplitude", "{s}", 3, (0.01 * _DEG, 2e-4 * _G), None, "half of the distance between the levels", True),
            _P("rate", "1/s", 1, (0.02,), None, "switches per second", True),
        ),
        "many switches at rest", "a Gauss-Markov state with beta = 2 rate and the same variance",
    ),
    Effect(
        "motion_noise", "noise that grows with motion", "stochastic", _BOTH, "e_k ~ N(0, (N v / v_0)^2 / dt), v speed, v_0 = 10 m/s",
        (_P("N", "{s}/sqrt(Hz)", 3, (0.05 * _DEG, 5e-4 * _G), None, "density at 10 m/s", True),),
        "changing speed", "noise level scheduled with speed",
    ),
    Effect(
        "temperature_noise", "noise that grows with temperature", "stochastic", _BOTH,
        "e_k ~ N(0, (N max(0, T - T_0))^2 / dt)",
        (
            _P("N", "{s}/sqrt(Hz)", 3, (0.001 * _DEG, 1e-5 * _G), None, "density per kelvin", True),
            _P("T0", "degC", 1, (25.0,), 25.0, "temperature where it starts"),
        ),
        "a temperature sweep", "noise level scheduled with temperature",
    ),
    # -- deterministic
    # --------------------------------------------------------------------------------------------------------
    Effect(
        "turn_on_bias", "turn-on bias", "deterministic", _BOTH, "e = b",
        (_P("value", "{s}", 3, (0.1 * _DEG, 2e-3 * _G), None, "bias"),),
        "fixes, or rest", "random constant per axis",
    ),
    Effect(
        "scale_factor", "scale factor", "deterministic", _BOTH, "e_i = S_i s_i",
        (_P("value", "", 3, (1e-3,), None, "relative error"),),
        "turns (gyro), accelerations (accelerometer)", "random constant per axis times s_i",
    ),
    Effect(
        "scale_asymmetry", "scale-factor asymmetry", "deterministic", _BOTH, "e_i = A_i |s_i|",
        (_P("value", "", 3, (1e-3,), None, "half of the difference of the scale factors of either sign"),),
        "both signs of s_i", "random constant per axis times |s_i|",
    ),
    Effect(
        "scale_nonlinearity", "scale-factor non-linearity", "deterministic", _BOTH, "e_i = K2_i s_i^2 + K3_i s_i^3",
        (
            _P("K2", "1/({s})", 3, (1e-3, 1e-4), 0.0, "quadratic coefficient"),
            _P("K3", "1/({s})^2", 3, (1e-3, 1e-5), 0.0, "cubic coefficient"),
        ),
        "a wide range of s_i", "random constants times s_i^2, s_i^3",
    ),
    Effect(
        "misalignment", "misalignment and non-orthogonality", "deterministic", _BOTH, "e_i = sum over j != i of M_ij s_j",
        (_P("value", "rad", 6, (1e-3,), None, "M_xy, M_xz, M_yx, M_yz, M_zx, M_zy"),),
        "rates or accelerations about the other axes", "random constants times s_j",
    ),
    Effect(
        "mounting", "mounting angles", "deterministic", ("imu",), "s_imu = C(rpy)^T s_body, both sensors",
        (_P("rpy", "rad", 3, (0.5 * _DEG,), None, "roll, pitch, yaw of the IMU in the body axes that are assumed"),),
        "motion, and a filter that ties velocity to the body axes", "two or three attitude constants",
    ),
    Effect(
        "g_sensitivity", "g-sensitivity of gyros", "deterministic", ("gyro",), "e = G f",
        (_P("value", "rad/s/(m/s^2)", 9, (0.02 * _DEG / _G,), None, "matrix row by row, or its diagonal"),),
        "changing specific force (turns, tilts)", "random constants times f",
    ),
    Effect(
        "temperature", "temperature-dependent bias", "deterministic", _BOTH,
        "e = c1 d + c2 d^2 + c3 d^3, d = T_lag - T0, lag_s T_lag' = T - T_lag",
        (
            _P("c1", "{s}/K", 3, (0.005 * _DEG, 1e-4 * _G), 0.0, "linear coefficient"),
            _P("c2", "{s}/K^2", 3, (1e-4 * _DEG, 2e-6 * _G), 0.0, "quadratic coefficient"),
            _P("c3", "{s}/K^3", 3, (2e-6 * _DEG, 4e-8 * _G), 0.0, "cubic coefficient"),
            _P("T0", "degC", 1, (25.0,), 25.0, "reference temperature"),
            _P("lag", "s", 1, (60.0,), 0.0, "time constant of the sensing element behind the temperature that is recorded", True),
        ),
        "a temperature sweep", "compensation by the recorded temperature",
    ),
    Effect(
        "saturation", "saturation", "deterministic", _BOTH, "y = clip(s, -limit, limit)",
        (_P("limit", "{s}", 3, (250.0 * _DEG, 4.0 * _G), None, "full scale", True),),
        "motion beyond the full scale", "epochs flagged",
    ),
    Effect(
        "dropped_samples", "dropped samples", "deterministic", ("imu",), "samples vanish in bursts of `burst` with probability p each",
        (
            _P("probability", "", 1, (0.001,), None, "share of samples that start a burst", True),
            _P("burst", "", 1, (1.0,), 1.0, "samples per burst", True),
        ),
        "motion", "bridging by the time stamps",
    ),
    # -- timing
    # ---------------------------------------------------------------------------------------------------------------
    Effect(
        "imu_gnss_time_offset", "time offset between IMU and GNSS", "timing", ("imu",), "IMU stamp = true time + offset",
        (_P("offset", "s", 1, (0.005,), None, "positive: IMU stamps are late (or GNSS fixes early)"),),
        "accelerations and turns", "one constant; signature v (position), a (velocity)",
    ),
    Effect(
        "clock_drift", "clock drift", "timing", ("imu",), "IMU stamp = t_0 + (1 + drift) (t - t_0)",
        (_P("drift", "", 1, (2e-5,), None, "relative rate error of the IMU's clock"),),
        "a long drive with accelerations", "one constant, growing time offset",
    ),
    Effect(
        "time_jitter", "time-stamp jitter", "timing", ("imu",), "IMU stamp = true time + N(0, sigma^2)",
        (_P("sigma", "s", 1, (2e-4,), None, "standard deviation", True),),
        "fast motion", "constant-rate stamps by regression",
    ),
    # -- GNSS
    # -----------------------------------------------------------------------------------------------------------------
    Effect(
        "gnss_noise_level", "GNSS position noise level", "gnss", ("gnss",), "true sigma = factor x stated sigma",
        (_P("factor", "", 3, (2.0,), None, "north, east, down", True),),
        "fixes", "R",
    ),
    Effect(
        "gnss_correlated_noise", "correlated GNSS noise", "gnss", ("gnss",), "position error has a Gauss-Markov part (sigma, tau)",
        (
            _P("sigma", "m", 3, (0.05,), None, "stationary standard deviation north, east, down", True),
            _P("tau", "s", 1, (30.0,), None, "correlation time", True),
        ),
        "fixes over several correlation times", "three states",
    ),
    Effect(
        "gnss_velocity_noise", "GNSS velocity noise level", "gnss", ("gnss",),
        "true velocity sigma = factor x stated sigma, plus a Gauss-Markov part",
        (
            _P("factor", "", 3, (2.0,), 1.0, "north, east, down", True),
            _P("sigma", "m/s", 3, (0.05,), 0.0, "Gauss-Markov part", True),
            _P("tau", "s", 1, (10.0,), 10.0, "its correlation time", True),
        ),
        "velocity fixes", "R",
    ),
    Effect(
        "lever_arm", "lever-arm error", "gnss", ("gnss",), "p_ant = p + C_nb (l + value)",
        (_P("value", "m", 3, (0.05,), None, "true minus assumed lever arm, body axes"),),
        "turns", "three constants",
    ),
    Effect(
        "gnss_multipath_step", "multipath step", "gnss", ("gnss",), "position error = value for start < t <= start + duration",
        (
            _P("value", "m", 3, (1.0,), None, "north, east, down"),
            _P("start", "s", 1, (300.0,), None, "start"),
            _P("duration", "s", 1, (60.0,), None, "duration", True),
        ),
        "fixes", "gating, or a step state",
    ),
    Effect(
        "gnss_outliers", "GNSS outliers", "gnss", ("gnss",), "with probability p: error ~ N(0, sigma^2) added",
        (
            _P("probability", "", 1, (0.01,), None, "share of fixes", True),
            _P("sigma", "m", 3, (5.0,), None, "standard deviation of an outlier", True),
        ),
        "fixes", "gating",
    ),
    Effect(
        "gnss_quality", "quality-dependent GNSS noise", "gnss", ("gnss",),
        "a two-state Markov chain: in the poor state sigma is `factor` times larger, stated or not",
        (
            _P("factor", "", 1, (10.0,), None, "ratio of the standard deviations", True),
            _P("good", "s", 1, (120.0,), 120.0, "mean duration of the good state", True),
            _P("poor", "s", 1, (20.0,), 20.0, "mean duration of the poor state", True),
            _P("stated", "", 1, (1.0,), 1.0, "1: the receiver states the larger sigma, 0: it does not", True),
        ),
        "fixes", "R from the receiver",
    ),
    Effect(
        "gnss_latency", "GNSS latency", "gnss", ("gnss",), "a fix stamped t is valid at t - latency",
        (_P("latency", "s", 1, (0.02,), None, "age of the fix at its stamp"),),
        "motion", "as imu_gnss_time_offset: without a third clock the two are one effect",
    ),
    # -- models
    # ---------------------------------------------------------------------------------------------------------------
    Effect(
        "earth_rate", "Earth rate omitted", "model", ("imu",), "w misses fraction x C_bn w_ie",
        (_P("fraction", "", 1, (1.0,), 1.0, "1: all of it"),),
        "minutes", "mechanization",
    ),
    Effect(
        "gravity", "gravity model", "model", ("imu",), "f contains -C_bn (0, 0, offset) more",
        (_P("offset", "m/s^2", 1, (1e-3,), None, "true minus modelled gravity"),),
        "fixes", "mechanization",
    ),
    Effect(
        "transport_rate", "transport rate omitted", "model", ("imu",), "w misses fraction x C_bn w_en",
        (_P("fraction", "", 1, (1.0,), 1.0, "1: all of it"),),
        "long or fast travel", "mechanization",
    ),
)  # fmt: skip

#: Effect by id.
EFFECTS: Mapping[str, Effect] = {e.id: e for e in _TABLE}


@dataclass(frozen=True)
class EffectUse:
    """An effect with numbers: what the emulator injects and what a scenario writes down.

    Parameters
    ----------
    id : str
        Key of :data:`EFFECTS`.
    sensor : str
        ``gyro``, ``accel``, ``imu`` or ``gnss``.
    values : mapping of str to tuple of float
        Every parameter in SI, with as many numbers as the table says.

    Raises
    ------
    InputError
        An unknown effect, sensor or parameter, a missing or negative value, a wrong count.
    """

    id: str
    sensor: str
    values: Mapping[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        effect = effect_of(self.id)
        if self.sensor not in effect.sensors:
            raise InputError(
                f"effect '{self.id}' has the sensor '{self.sensor}', expected {' or '.join(repr(s) for s in effect.sensors)}"
            )
        full: dict[str, tuple[float, ...]] = {}
        for name in self.values:
            effect.parameter(name)
        for p in effect.parameters:
            given = self.values.get(p.name)
            if given is None:
                if p.default is None:
                    raise InputError(f"effect '{self.id}' misses its parameter '{p.name}' ({p.meaning})")
                given = (p.default,)
            numbers = tuple(float(x) for x in ((given,) if isinstance(given, int | float) else given))
            if len(numbers) == 1 and p.size in (3, 9):
                numbers *= 3
            if len(numbers) == 3 and p.size == 9:
                a, b, c = numbers
                numbers = (a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, c)
            if len(numbers) != p.size:
                raise InputError(
                    f"effect '{self.id}', '{p.name}': found {len(numbers)} value(s), expected {_count(p.size)}"
                )
            if not all(math.isfinite(x) for x in numbers):
                raise InputError(f"effect '{self.id}', '{p.name}': found a value that is not finite")
            if p.positive and min(numbers) < 0:
                raise InputError(f"effect '{self.id}', '{p.name}': found {min(numbers):g}, expected zero or more")
            full[p.name] = numbers
        object.__setattr__(self, "values", full)

    @property
    def effect(self) -> Effect:
        """What the table says."""
        return EFFECTS[self.id]

    def __getitem__(self, name: str) -> tuple[float, ...]:
        return self.values[name]

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
        given = dict(mapping)
        if "effect" not in given:
            raise InputError("an effect needs the key 'effect'" + nearest("effect", given))
        effect = effect_of(str(given.pop("effect")))
        sensor = given.pop("sensor", None)
        if sensor is None:
            if len(effect.sensors) > 1:
                raise InputError(f"effect '{effect.id}' needs the key 'sensor': {' or '.join(effect.sensors)}")
            sensor = effect.sensors[0]
        if sensor not in effect.sensors:
            raise InputError(
                f"effect '{effect.id}' has the sensor '{sensor}', expected {' or '.join(repr(s) for s in effect.sensors)}"
            )
        axes = given.pop("axes", None)
        values: dict[str, tuple[float, ...]] = {}
        for name, quantity in given.items():
            p = effect.parameter(name)
            unit = effect.unit(name, str(sensor))
            items: Sequence[Any] = quantity if isinstance(quantity, list | tuple) else [quantity]
            try:
                numbers = tuple(units.parse(item, unit) for item in items)
            except InputError as error:
                raise InputError(f"effect '{effect.id}', '{name}': {error.message}") from None
            if axes is not None and p.size == 3 and len(numbers) == 1:
                chosen = [axes] if isinstance(axes, str) else list(axes)
                for axis in chosen:
                    if axis not in ("x", "y", "z"):
                        raise InputError(f"effect '{effect.id}': unknown axis '{axis}' (expected x, y or z)")
                numbers = tuple(numbers[0] if axis in chosen else 0.0 for axis in "xyz")
            values[name] = numbers
        return cls(effect.id, str(sensor), values)

    def to_mapping(self) -> dict[str, Any]:
        """Inverse of :meth:`from_mapping`, SI numbers."""
        out: dict[str, Any] = {"effect": self.id, "sensor": self.sensor}
        for name, numbers in self.values.items():
            out[name] = numbers[0] if len(numbers) == 1 else list(numbers)
        return out


def _count(size: int) -> str:
    return {1: "one", 3: "one or three", 6: "six (xy, xz, yx, yz, zx, zy)", 9: "nine (or three, the diagonal)"}[size]


def effect_of(effect_id: str) -> Effect:
    """Effect by id; ``InputError`` with the nearest id where there is none."""
    if effect_id not in EFFECTS:
        raise InputError(f"unknown effect '{effect_id}'" + nearest(effect_id, EFFECTS))
    return EFFECTS[effect_id]


def markdown_table() -> str:
    """The catalogue as the table of the documentation."""
    lines = ["| effect | sensor | formula | parameters [SI unit] = default |", "| --- | --- | --- | --- |"]
    for effect in EFFECTS.values():
        shown = []
        for p in effect.parameters:
            named = list(dict.fromkeys(effect.unit(p.name, sensor) or "1" for sensor in effect.sensors))
            default = "" if p.default is None else f" = {p.default:g}"
            shown.append(f"`{p.name}` [{'; '.join(named)}]{default}")
        formula = effect.formula.replace("|", "\\|")
        lines.append(f"| `{effect.id}` | {', '.join(effect.sensors)} | {formula} | {', '.join(shown)} |")
    return "\n".join(lines)
