"""What sensors do to the truth: every deterministic, stochastic and timing effect of :mod:`insemu.effects`, in the
order of the signal chain.

1. models left out (Earth rate, transport rate, gravity), mounting;
2. functions of the true signal, all of the same true signal and summed: scale factor, asymmetry, non-linearity,
misalignment,
   g-sensitivity;
3. what is added: bias, temperature, ramp, the stochastic model or the recorded signal, white noise, walks, vibration,
outliers, ...; 4. bandwidth and decimation filter; 5. saturation; 6. quantization; 7. time stamps; 8. dropped samples.

Every effect draws from its own child of the generator, so an effect added at the end leaves the others as they were.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import butter, lfilter_zi

from insemu import rotation
from insemu.effects import CROSS, EffectUse
from insemu.emulate import chain as passes
from insemu.emulate.errors import RecordedErrors, draw_errors
from insemu.errors import InputError
from insemu.noise import BI, DR, GM, RW, WN, NoiseModel, Process, draws
from insemu.records import ImuRecord, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TemperatureProfile:
    """Temperature against time, linear between points and constant outside.

    Parameters
    ----------
    t : (n,) array
        Times in s, increasing.
    degc : (n,) array
        Temperatures in degC.
    """

    t: tuple[float, ...]
    degc: tuple[float, ...]

    def __post_init__(self) -> None:
        t, degc = tuple(float(x) for x in self.t), tuple(float(x) for x in self.degc)
        if len(t) != len(degc) or not t:
            raise InputError(f"a temperature profile has {len(t)} times and {len(degc)} temperatures, expected as many")
        if not np.isfinite([*t, *degc]).all() or any(b <= a for a, b in pairwise(t)):
            raise InputError("a temperature profile needs finite numbers at increasing times")
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "degc", degc)

    def at(self, t: ArrayLike) -> Array:
        """Temperature in degC at times in s."""
        return np.interp(np.asarray(t, dtype=float), self.t, self.degc)


@dataclass(frozen=True)
class Corrupted:
    """A corrupted record and the truth about its errors.

    Parameters
    ----------
    imu : ImuRecord
        What the sensor gives.
    errors : (n, 6) array
        Stochastic part drawn from the noise models or cut from a recorded signal, rad/s and m/s^2, columns in the
        order of :data:`insemu.records.AXES`; row k belongs to row k of the ideal record.
    components : mapping
        Axis to the (processes, n) signals that sum to its column of ``errors``; empty for recorded errors.
    kept : (m,) array of int
        Rows of the ideal record that the corrupted one still has (dropped samples leave gaps).
    """

    imu: ImuRecord
    errors: Array
    components: Mapping[str, Array] = field(default_factory=dict)
    kept: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass
class _Response:
    """What the effects that are functions of the true signal amount to together; see :func:`~insemu.emulate.chain.respond`."""

    mounting: Array = field(default_factory=lambda: np.eye(3))
    matrix: Array = field(default_factory=lambda: np.zeros((6, 6)))
    asymmetry: Array = field(default_factory=lambda: np.zeros(6))
    square: Array = field(default_factory=lambda: np.zeros(6))
    cube: Array = field(default_factory=lambda: np.zeros(6))
    offset: Array = field(default_factory=lambda: np.zeros(6))


@dataclass
class _Chain:
    """The signals on their way through the sensor, (6, n) in rad/s and m/s^2, and rows to work in."""

    t: Array
    dt: float
    signal: Array
    work: Array
    profile: Array
    speed_row: Array
    reference: Trajectory | None
    temperature: Array | None
    response: _Response = field(default_factory=_Response)
    earth_share: float = 0.0
    transport_share: float = 0.0
    gravity_offset: float = 0.0
    _has_speed: bool = False

    @classmethod
    def of(cls, imu: ImuRecord, step: Array, reference: Trajectory | None, temperature: Array | None) -> _Chain:
        rows = np.empty((9, len(imu)))  # one block: large ones come in large pages
        passes.load(imu.gyro, imu.accel, step, rows[:6])
        return cls(imu.t, imu.dt, rows[:6], rows[6], rows[7], rows[8], reference, temperature)

    def axes(self, sensor: str) -> slice:
        return slice(0, 3) if sensor == "gyro" else slice(3, 6)

    def rows(self, sensor: str) -> Array:
        return self.signal[self.axes(sensor)]

    def need_reference(self, use: EffectUse) -> Trajectory:
        if self.reference is None or len(self.reference) != self.t.size:
            raise InputError(f"effect '{use.id}' needs the reference trajectory at the rows of the IMU record")
        return self.reference

    def need_temperature(self, use: EffectUse) -> Array:
        if self.temperature is None:
            raise InputError(f"effect '{use.id}' needs a temperature: give a temperature profile")
        return self.temperature

    def speed(self, use: EffectUse) -> Array:
        reference = self.need_reference(use)
        if not self._has_speed:
            passes.speeds(reference.vel_ned, self.speed_row)
            self._has_speed = True
        return self.speed_row

    def motion_profile(self, use: EffectUse) -> Array | None:
        """From ``rest_factor`` at standstill to 1 above 5 m/s; None where it is 1 everywhere."""
        rest = use.scalar("rest_factor")
        if rest == 1.0:
            return None
        passes.motion_profile(self.speed(use), rest, self.profile)
        return self.profile

    def leave_out(self) -> None:
        """Take the models that are left out away from the signal, some rows at a time."""
        if not (self.earth_share or self.transport_share or self.gravity_offset):
            return
        assert self.reference is not None
        r = self.reference
        half = np.empty((4, _BLOCK))
        for first in range(0, self.t.size, _BLOCK):
            rows = slice(first, first + _BLOCK)
            part = half[:, : len(r.rpy[rows])]
            part[:3], part[3] = r.rpy[rows].T, r.llh[rows, 0]
            part *= 0.5
            np.tan(part, out=part)
            passes.leave_out(
                self.signal[:, rows],
                part,
                r.llh[rows, 2],
                r.vel_ned[rows],
                self.earth_share,
                self.transport_share,
                self.gravity_offset,
            )

    def respond(self) -> None:
        """Apply the functions of the true signal."""
        r = self.response
        passes.respond(self.signal, r.mounting, r.matrix, r.asymmetry, r.square, r.cube, r.offset)


#: Rows whose angles stay in the cache.
_BLOCK = 2048


Apply = Callable[[_Chain, EffectUse, np.random.Generator], None]


# -- 1. models and mounting: noted, and taken away together
# -----------------------------------------------------------------------


def _earth_rate(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.need_reference(use)
    chain.earth_share += use.scalar("fraction")


def _transport_rate(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.need_reference(use)
    chain.transport_share += use.scalar("fraction")


def _gravity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.need_reference(use)
    chain.gravity_offset += use.scalar("offset")


def _mounting(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.response.mounting = rotation.dcm_from_rpy(use["rpy"]).T @ chain.response.mounting


# -- 2. functions of the true signal: noted, and applied together
# -----------------------------------------------------------------


def _scale_factor(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.axes(use.sensor)
    chain.response.matrix[s, s] += np.diag(use["value"])


def _scale_asymmetry(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.response.asymmetry[chain.axes(use.sensor)] += use["value"]


def _scale_nonlinearity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.response.square[chain.axes(use.sensor)] += use["K2"]
    chain.response.cube[chain.axes(use.sensor)] += use["K3"]


def _misalignment(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    m = np.zeros((3, 3))
    for pair, value in zip(CROSS, use["value"], strict=True):
        m["xyz".index(pair[0]), "xyz".index(pair[1])] = value
    s = chain.axes(use.sensor)
    chain.response.matrix[s, s] += m


def _g_sensitivity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.response.matrix[:3, 3:] += np.array(use["value"]).reshape(3, 3)


# -- 3. what is added
# -------------------------------------------------------------------------------------------------------------


def _turn_on_bias(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.response.offset[chain.axes(use.sensor)] += use["value"]


def lagged(temperature: Array, dt: float, lag_s: float, out: Array | None = None) -> Array:
    """First-order lag of a sampled temperature, exact for straight lines between the samples; starts in equilibrium.

    Parameters
    ----------
    temperature : (n,) array
        degC or K.
    dt, lag_s : float
        Sampling interval and time constant, s; without a time constant the temperature itself.
    out : (n,) array, optional
        Where the result goes.

    Returns
    -------
    (n,) array
    """
    out = np.empty(temperature.size) if out is None else out
    if lag_s <= 0:
        out[:] = temperature
        return out
    a = np.exp(-dt / lag_s)
    # exact response to a ramp over one interval
    slope_gain = 1.0 - lag_s / dt * (1.0 - a)
    passes.ramp_response(temperature, a, slope_gain, (1.0 - a) - slope_gain, out)
    return out


def _temperature(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    d = lagged(chain.need_temperature(use), chain.dt, use.scalar("lag"), chain.work)
    d -= use.scalar("T0")
    for row, c1, c2, c3 in zip(chain.rows(use.sensor), use["c1"], use["c2"], use["c3"], strict=True):
        passes.add_cubic(row, d, c1, c2, c3)


def _process(build: Callable[[EffectUse, int], Process]) -> Apply:
    def apply(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
        for axis, (row, child) in enumerate(zip(chain.rows(use.sensor), rng.spawn(3), strict=True)):
            process = build(use, axis)
            if any(v != 0.0 for name, v in process.parameters.items() if name not in ("beta", "Tc")):
                process.fill(chain.work, chain.dt, child)
                row += chain.work

    return apply


def _add_shaped(
    chain: _Chain, use: EffectUse, parameter: str, level: Array | None, draw: Callable[[], None] | None = None
) -> None:
    """Add the row in work, drawn anew for every axis where a way is given, times the parameter and the level."""
    for row, factor in zip(chain.rows(use.sensor), use[parameter], strict=True):
        if draw is not None:
            draw()
        if level is None:
            passes.add_scaled(row, chain.work, factor)
        else:
            passes.add_product(row, chain.work, level, factor)


def _vibration_line(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    wave, profile = chain.work, chain.motion_profile(use)
    passes.half_angle(chain.t, use.scalar("frequency"), use.scalar("phase"), wave)
    np.tan(wave, out=wave)
    passes.sines(wave)
    _add_shaped(chain, use, "amplitude", profile)


def band_coefficients(frequency: float, bandwidth: float, dt: float) -> tuple[float, float, float]:
    """``(a1, a2, gain)`` of the resonance ``y_k = a1 y_(k-1) + a2 y_(k-2) + gain w_k`` that has unit variance for
    unit white noise.
    """
    if not 0 < frequency < 0.5 / dt:
        raise InputError(f"a vibration band at {frequency:g} Hz is not below half of the rate, {0.5 / dt:g} Hz")
    r = np.exp(-np.pi * bandwidth * dt)
    a1, a2 = 2.0 * r * np.cos(2.0 * np.pi * frequency * dt), -r * r
    variance = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1 * a1))
    return float(a1), float(a2), float(1.0 / np.sqrt(variance))


def _vibration_band(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    a1, a2, gain = band_coefficients(use.scalar("frequency"), use.scalar("bandwidth"), chain.dt)
    b, a = np.array([gain, 0.0, 0.0]), np.array([1.0, -a1, -a2])
    # until the start is forgotten to 1e-8
    settle = np.empty(min(int(np.ceil(20.0 / max(1e-9, 1.0 - np.sqrt(-a2)))), 1_000_000))

    def draw() -> None:
        memory = np.zeros(2)
        for part in (settle, chain.work):
            draws.standard_normal(part, rng)
            draws.rational_filter(part, b, a, memory)

    _add_shaped(chain, use, "rms", chain.motion_profile(use), draw)


def _outliers(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    p = use.scalar("probability")
    if p > 1:
        raise InputError(f"effect 'outliers': a probability of {p:g}, expected at most 1")
    for row, sigma, child in zip(chain.rows(use.sensor), use["sigma"], rng.spawn(3), strict=True):
        passes.add_outliers(row, p, sigma, child)


def _telegraph(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    # an odd number of Poisson events between two samples
    switch = 0.5 * (1.0 - np.exp(-2.0 * use.scalar("rate") * chain.dt))
    for row, amplitude, child in zip(chain.rows(use.sensor), use["amplitude"], rng.spawn(3), strict=True):
        passes.add_telegraph(row, switch, amplitude, child)


def _motion_noise(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    np.divide(chain.speed(use), 10.0 * np.sqrt(chain.dt), out=chain.profile)
    _add_shaped(chain, use, "N", chain.profile, lambda: draws.standard_normal(chain.work, rng))


def _temperature_noise(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    np.subtract(chain.need_temperature(use), use.scalar("T0"), out=chain.profile)
    np.maximum(0.0, chain.profile, out=chain.profile)
    chain.profile /= np.sqrt(chain.dt)
    _add_shaped(chain, use, "N", chain.profile, lambda: draws.standard_normal(chain.work, rng))


# -- 4. to 6. filter, saturation, quantization
# ------------------------------------------------------------------------------------


def _decimation_filter(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    cutoff = use.scalar("cutoff")
    if cutoff > 0:
        if cutoff >= 0.5 / chain.dt:
            raise InputError(
                f"effect 'decimation_filter': a cutoff of {cutoff:g} Hz is not below half of the rate, {0.5 / chain.dt:g} Hz"
            )
        b, a = butter(max(1, round(use.scalar("order"))), cutoff * 2.0 * chain.dt)
    else:
        taps = round(use.scalar("taps"))
        if taps < 1:
            raise InputError(f"effect 'decimation_filter': {taps} taps, expected at least one, or a cutoff")
        b = np.full(taps, 1.0 / taps)
        a = np.eye(1, taps)[0]
    if len(b) == 1:
        return
    state = lfilter_zi(b, a)
    for row in chain.rows(use.sensor):  # starts in equilibrium with the first sample
        draws.rational_filter(row, b, a, state * row[0])


def _saturation(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    for row, limit in zip(chain.rows(use.sensor), use["limit"], strict=True):
        np.clip(row, -limit, limit, out=row)


def _quantization(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    for row, lsb in zip(chain.rows(use.sensor), use["lsb"], strict=True):
        if lsb > 0:
            row /= lsb
            np.rint(row, out=row)
            row *= lsb


#: Effects of the IMU's values, in the order in which they act.
_ACTIONS: dict[str, Apply] = {
    "earth_rate": _earth_rate,
    "transport_rate": _transport_rate,
    "gravity": _gravity,
    "mounting": _mounting,
    "scale_factor": _scale_factor,
    "scale_asymmetry": _scale_asymmetry,
    "scale_nonlinearity": _scale_nonlinearity,
    "misalignment": _misalignment,
    "g_sensitivity": _g_sensitivity,
    "turn_on_bias": _turn_on_bias,
    "temperature": _temperature,
    "ramp": _process(lambda use, axis: DR(use["R"][axis])),
    "white_noise": _process(lambda use, axis: WN(use["N"][axis])),
    "random_walk": _process(lambda use, axis: RW(use["K"][axis])),
    "gauss_markov": _process(lambda use, axis: GM(use["sigma"][axis], use["beta"][axis])),
    "flicker": _process(lambda use, axis: BI(use["B"][axis])),
    "vibration_line": _vibration_line,
    "vibration_band": _vibration_band,
    "outliers": _outliers,
    "telegraph": _telegraph,
    "motion_noise": _motion_noise,
    "temperature_noise": _temperature_noise,
    "decimation_filter": _decimation_filter,
    "saturation": _saturation,
    "quantization": _quantization,
}
_ORDER = {name: k for k, name in enumerate(_ACTIONS)}
#: The first that meets the signal after the functions of the truth.
_FIRST_AFTER = _ORDER["temperature"]
_FIRST_FILTER = _ORDER["decimation_filter"]
_TIMING = ("clock_drift", "imu_gnss_time_offset", "time_jitter", "dropped_samples")


def corrupt(
    imu: ImuRecord,
    truth: Mapping[str, NoiseModel | Process] | RecordedErrors | None,
    rng: np.random.Generator,
    *,
    effects: Sequence[EffectUse] = (),
    reference: Trajectory | None = None,
    temperature: TemperatureProfile | Array | None = None,
    errors: Array | None = None,
    realization: int = 0,
) -> Corrupted:
    """Turn an ideal record into what a sensor gives.

    Parameters
    ----------
    imu : ImuRecord
        Ideal record of any kind at a constant rate.
    truth : mapping of axis to NoiseModel, RecordedErrors or None
        What the sensor's noise really is; axes that are not named stay perfect.
    rng : numpy.random.Generator
        Each axis and each effect draws from its own child.
    effects : sequence of EffectUse
        Effects of the sensors ``gyro``, ``accel`` and ``imu``; those of ``gnss`` are passed over
        (:func:`~insemu.emulate.gnss_fixes` takes them). They act in the order of the signal chain, whatever their
        order here.
    reference : Trajectory, optional
        At the rows of the record; needed by effects that depend on motion, attitude or place.
    temperature : TemperatureProfile or (n,) array, optional
        degC at the rows; needed by effects of temperature, and recorded with the IMU.
    errors : (n, 6) array, optional
        Stochastic errors that were drawn elsewhere, instead of ``truth``.
    realization : int
        Which piece of a recorded signal is taken.

    Returns
    -------
    Corrupted

    Raises
    ------
    InputError
        An unknown axis, an effect that lacks what it needs, a recorded signal at another rate or too short.
    """
    n, dt = len(imu), imu.dt
    if errors is not None and truth is not None:
        raise InputError("both a truth and ready errors were given, expected one of them")
    drawn, components = draw_errors(truth, n, dt, rng, realization)
    if errors is not None:
        drawn = np.asarray(errors, dtype=float)
        if drawn.shape != (n, 6):
            raise InputError(f"errors have shape {drawn.shape}, expected ({n}, 6)")
    inertial = [use for use in effects if use.sensor != "gnss"]
    if not inertial and temperature is None:
        return Corrupted(_add(imu, drawn), drawn, components, np.arange(n))

    degc = temperature.at(imu.t) if isinstance(temperature, TemperatureProfile) else temperature
    if degc is not None and np.shape(degc) != (n,):
        raise InputError(f"temperature has shape {np.shape(degc)}, expected ({n},)")
    children = dict(zip(map(id, inertial), rng.spawn(len(inertial)), strict=True))
    step = _intervals(imu)
    chain = _Chain.of(imu, step, reference, degc)
    ordered = sorted((u for u in inertial if u.id not in _TIMING), key=lambda u: _ORDER[u.id])
    stage = 0
    for use in [*ordered, None]:
        place = _ORDER[use.id] if use is not None else len(_ORDER)
        if stage < 1 and place >= _FIRST_AFTER:
            chain.leave_out()
            chain.respond()
            stage = 1
        if stage < 2 and place >= _FIRST_FILTER:
            if truth is not None or errors is not None:
                chain.signal += drawn.T
            stage = 2
        if use is not None:
            _ACTIONS[use.id](chain, use, children[id(use)])
    t, kept = _stamps(imu, inertial, children)
    gyro, accel = np.empty((2, kept.size, 3))
    passes.unload(chain.signal, step, kept, gyro, accel)
    if degc is not None and kept.size < n:
        degc = degc[kept]
    return Corrupted(ImuRecord(t, gyro, accel, imu.kind, degc), drawn, components, kept)


def _intervals(imu: ImuRecord) -> Array:
    """Intervals (n,) in s by which increments are divided and multiplied; empty for the other kinds."""
    return np.diff(imu.t, prepend=2 * imu.t[0] - imu.t[1]) if imu.kind == "increment" else np.empty(0)


def _add(imu: ImuRecord, errors: Array) -> ImuRecord:
    if imu.kind == "increment":
        errors = errors * _intervals(imu)[:, None]
    return replace(imu, gyro=imu.gyro + errors[:, :3], accel=imu.accel + errors[:, 3:])


def _stamps(
    imu: ImuRecord, effects: Sequence[EffectUse], children: Mapping[int, np.random.Generator]
) -> tuple[Array, NDArray[np.int64]]:
    """Time stamps of the samples that are kept, and their rows."""
    t = imu.t
    keep = np.ones(t.size, bool)
    for use in sorted((u for u in effects if u.id in _TIMING), key=lambda u: _TIMING.index(u.id)):
        rng = children[id(use)]
        if use.id == "clock_drift":
            t = t[0] + (t - t[0]) * (1.0 + use.scalar("drift"))
        elif use.id == "imu_gnss_time_offset":
            t = t + use.scalar("offset")
        elif use.id == "time_jitter":
            t = t + use.scalar("sigma") * rng.standard_normal(t.size)
            if (np.diff(t) <= 0).any():
                raise InputError(
                    f"effect 'time_jitter': a sigma of {use.scalar('sigma'):g} s makes stamps go back at intervals of {imu.dt:g} s"
                )
        else:
            keep &= ~_bursts(t.size, use, rng)
    keep[0] = True
    kept = np.nonzero(keep)[0]
    if kept.size < 2:
        raise InputError("effect 'dropped_samples' leaves no data")
    return t[kept], kept


def _bursts(n: int, use: EffectUse, rng: np.random.Generator) -> NDArray[np.bool_]:
    length = max(1, round(use.scalar("burst")))
    start = np.nonzero(rng.random(n) < use.scalar("probability"))[0]
    gone = np.zeros(n + length, bool)
    for k in range(length):
        gone[start + k] = True
    return gone[:n]
