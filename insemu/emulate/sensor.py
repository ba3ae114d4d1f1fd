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
from scipy.signal import butter, lfilter, lfilter_zi

from insemu import earth, rotation
from insemu.effects import CROSS, EffectUse
from insemu.emulate.errors import RecordedErrors, draw_errors
from insemu.errors import InputError
from insemu.noise import BI, DR, GM, RW, WN, NoiseModel, Process
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
class _Chain:
    """The signals on their way through the sensor; (6, n) in rad/s and m/s^2."""

    t: Array
    dt: float
    signal: Array
    true: Array
    reference: Trajectory | None
    temperature: Array | None
    _speed: Array | None = None
    _dcm: Array | None = None

    def of(self, sensor: str) -> slice:
        return slice(0, 3) if sensor == "gyro" else slice(3, 6)

    def need_reference(self, use: EffectUse) -> Trajectory:
        if self.reference is None or len(self.reference) != self.t.size:
            raise InputError(f"effect '{use.id}' needs the reference trajectory at the rows of the IMU record")
        return self.reference

    def need_temperature(self, use: EffectUse) -> Array:
        if self.temperature is None:
            raise InputError(f"effect '{use.id}' needs a temperature: give a temperature profile")
        return self.temperature

    def speed(self, use: EffectUse) -> Array:
        if self._speed is None:
            v = self.need_reference(use).vel_ned
            self._speed = np.sqrt(np.einsum("ni,ni->n", v, v))
        return self._speed

    def to_body(self, use: EffectUse, vector_ned: Array) -> Array:
        """Turn (n, 3) NED vectors into body axes, (3, n)."""
        if self._dcm is None:
            self._dcm = rotation.dcm_from_rpy(self.need_reference(use).rpy)
        return np.asarray(np.einsum("nji,nj->in", self._dcm, vector_ned))

    def motion_profile(self, use: EffectUse) -> Array | float:
        """From ``rest_factor`` at standstill to 1 above 5 m/s."""
        rest = use.scalar("rest_factor")
        if rest == 1.0:
            return 1.0
        u = np.clip(self.speed(use) / 5.0, 0.0, 1.0)
        return np.asarray(rest + (1.0 - rest) * u * u * (3.0 - 2.0 * u))


def _column(values: Sequence[float]) -> Array:
    return np.array(values)[:, None]


Apply = Callable[[_Chain, EffectUse, np.random.Generator], None]


# -- 1. models and mounting
# -------------------------------------------------------------------------------------------------------


def _earth_rate(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    reference = chain.need_reference(use)
    chain.signal[:3] -= use.scalar("fraction") * chain.to_body(use, earth.earth_rate(reference.llh[:, 0]))


def _transport_rate(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    reference = chain.need_reference(use)
    rate = earth.transport_rate(reference.llh, reference.vel_ned)
    chain.signal[:3] -= use.scalar("fraction") * chain.to_body(use, rate)


def _gravity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    down = np.zeros((chain.t.size, 3))
    down[:, 2] = use.scalar("offset")
    chain.signal[3:] -= chain.to_body(use, down)


def _mounting(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    c = rotation.dcm_from_rpy(use["rpy"])
    chain.signal[:3] = c.T @ chain.signal[:3]
    chain.signal[3:] = c.T @ chain.signal[3:]


# -- 2. functions of the true signal
# ----------------------------------------------------------------------------------------------


def _scale_factor(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    chain.signal[s] += _column(use["value"]) * chain.true[s]


def _scale_asymmetry(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    chain.signal[s] += _column(use["value"]) * np.abs(chain.true[s])


def _scale_nonlinearity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    x = chain.true[s]
    chain.signal[s] += (_column(use["K2"]) + _column(use["K3"]) * x) * x * x


def _misalignment(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    m = np.zeros((3, 3))
    for pair, value in zip(CROSS, use["value"], strict=True):
        m["xyz".index(pair[0]), "xyz".index(pair[1])] = value
    chain.signal[s] += m @ chain.true[s]


def _g_sensitivity(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.signal[:3] += np.array(use["value"]).reshape(3, 3) @ chain.true[3:]


# -- 3. what is added
# -------------------------------------------------------------------------------------------------------------


def _turn_on_bias(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    chain.signal[chain.of(use.sensor)] += _column(use["value"])


def lagged(temperature: Array, dt: float, lag_s: float) -> Array:
    """First-order lag of a sampled temperature, exact for straight lines between the samples; starts in equilibrium."""
    if lag_s <= 0:
        return temperature
    a = np.exp(-dt / lag_s)
    # exact response to a ramp over one interval
    slope_gain = 1.0 - lag_s / dt * (1.0 - a)
    b0, b1 = slope_gain, (1.0 - a) - slope_gain
    start = temperature[:1] * (1.0 - b0)
    return np.asarray(lfilter([b0, b1], [1.0, -a], temperature, zi=start)[0])


def _temperature(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    d = lagged(chain.need_temperature(use), chain.dt, use.scalar("lag")) - use.scalar("T0")
    c1, c2, c3 = _column(use["c1"]), _column(use["c2"]), _column(use["c3"])
    chain.signal[chain.of(use.sensor)] += ((c3 * d + c2) * d + c1) * d


def _process(build: Callable[[EffectUse, int], Process]) -> Apply:
    def apply(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
        first = 0 if use.sensor == "gyro" else 3
        for axis, child in enumerate(rng.spawn(3)):
            process = build(use, axis)
            if any(v != 0.0 for name, v in process.parameters.items() if name not in ("beta", "Tc")):
                chain.signal[first + axis] += process.simulate(chain.t.size, chain.dt, child)

    return apply


def _vibration_line(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    wave = np.sin(2.0 * np.pi * use.scalar("frequency") * (chain.t - chain.t[0]) + use.scalar("phase"))
    chain.signal[chain.of(use.sensor)] += _column(use["amplitude"]) * (chain.motion_profile(use) * wave)


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
    r = np.sqrt(-a2)
    settle = int(np.ceil(20.0 / max(1e-9, 1.0 - r)))  # until the start is forgotten to 1e-8
    white = rng.standard_normal((3, chain.t.size + min(settle, 1_000_000)))
    coloured = lfilter([gain], [1.0, -a1, -a2], white, axis=1)[:, -chain.t.size :]
    coloured *= chain.motion_profile(use)
    coloured *= _column(use["rms"])
    chain.signal[chain.of(use.sensor)] += coloured


def _outliers(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    p = use.scalar("probability")
    if p > 1:
        raise InputError(f"effect 'outliers': a probability of {p:g}, expected at most 1")
    n = chain.t.size
    first = 0 if use.sensor == "gyro" else 3
    for axis, child in enumerate(rng.spawn(3)):
        hit = np.nonzero(child.random(n) < p)[0]
        chain.signal[first + axis, hit] += use["sigma"][axis] * child.standard_normal(hit.size)


def telegraph(n: int, dt: float, rate: float, rng: np.random.Generator) -> Array:
    """A random telegraph signal of +-1 with Poisson switches, sampled: (n,)."""
    switch = rng.random(n) < 0.5 * (1.0 - np.exp(-2.0 * rate * dt))  # an odd number of Poisson events in dt
    start = 1.0 if rng.random() < 0.5 else -1.0
    return np.asarray(start * np.where(np.cumsum(switch) % 2 == 0, 1.0, -1.0))


def _telegraph(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    first = 0 if use.sensor == "gyro" else 3
    for axis, child in enumerate(rng.spawn(3)):
        chain.signal[first + axis] += use["amplitude"][axis] * telegraph(
            chain.t.size, chain.dt, use.scalar("rate"), child
        )


def _scaled_white(density: Sequence[float], level: Array, rng: np.random.Generator) -> Array:
    white = rng.standard_normal((3, level.size))
    white *= level
    white *= _column(density)
    return white


def _motion_noise(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    level = chain.speed(use) / (10.0 * np.sqrt(chain.dt))
    chain.signal[chain.of(use.sensor)] += _scaled_white(use["N"], level, rng)


def _temperature_noise(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    excess = np.maximum(0.0, chain.need_temperature(use) - use.scalar("T0")) / np.sqrt(chain.dt)
    chain.signal[chain.of(use.sensor)] += _scaled_white(use["N"], excess, rng)


# -- 4. to 6. filter, saturation, quantization
# ------------------------------------------------------------------------------------


def _decimation_filter(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    x = chain.signal[s]
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
        b, a = np.full(taps, 1.0 / taps), np.ones(1)
    if max(len(a), len(b)) == 1:
        return
    state = lfilter_zi(b, a)
    for row in x:  # starts in equilibrium with the first sample
        row[:] = lfilter(b, a, row, zi=state * row[0])[0]


def _saturation(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    s = chain.of(use.sensor)
    limit = _column(use["limit"])
    np.clip(chain.signal[s], -limit, limit, out=chain.signal[s])


def _quantization(chain: _Chain, use: EffectUse, rng: np.random.Generator) -> None:
    first = 0 if use.sensor == "gyro" else 3
    for axis, lsb in enumerate(use["lsb"]):
        if lsb > 0:
            row = chain.signal[first + axis]
            np.multiply(np.round(row / lsb), lsb, out=row)


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
#: What sees the signal after mounting and before anything is added.
_FIRST_OF_TRUE = _ORDER["scale_factor"]
_FIRST_ADDED = _ORDER["turn_on_bias"]
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
    step = np.diff(imu.t, prepend=2 * imu.t[0] - imu.t[1])
    signal = np.empty((6, n))
    signal[:3], signal[3:] = imu.gyro.T, imu.accel.T
    if imu.kind == "increment":
        signal /= step
    chain = _Chain(imu.t, dt, signal, signal, reference, degc)
    ordered = sorted((u for u in inertial if u.id not in _TIMING), key=lambda u: _ORDER[u.id])
    stage = 0
    for use in [*ordered, None]:
        place = _ORDER[use.id] if use is not None else len(_ORDER)
        if stage < 1 and place >= _FIRST_OF_TRUE:
            # functions of the true signal are of the same true signal
            chain.true = (
                chain.signal.copy() if any(_FIRST_OF_TRUE <= _ORDER[u.id] < _FIRST_ADDED for u in ordered) else signal
            )
            stage = 1
        if stage < 2 and place >= _FIRST_FILTER:
            if truth is not None or errors is not None:
                chain.signal += drawn.T
            stage = 2
        if use is not None:
            _ACTIONS[use.id](chain, use, children[id(use)])
    if imu.kind == "increment":
        chain.signal *= step
    out = replace(imu, gyro=chain.signal[:3].T.copy(), accel=chain.signal[3:].T.copy(), temperature=degc)
    out, kept = _stamps(out, inertial, children)
    return Corrupted(out, drawn, components, kept)


def _add(imu: ImuRecord, errors: Array) -> ImuRecord:
    if imu.kind == "increment":
        errors = errors * np.diff(imu.t, prepend=2 * imu.t[0] - imu.t[1])[:, None]
    return replace(imu, gyro=imu.gyro + errors[:, :3], accel=imu.accel + errors[:, 3:])


def _stamps(
    imu: ImuRecord, effects: Sequence[EffectUse], children: Mapping[int, np.random.Generator]
) -> tuple[ImuRecord, NDArray[np.int64]]:
    """Time stamps and dropped samples."""
    t = imu.t.copy()
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
    if keep.all():
        return (imu if t is imu.t else replace(imu, t=t)), np.arange(t.size)
    if keep.sum() < 2:
        raise InputError("effect 'dropped_samples' leaves no data")
    temperature = None if imu.temperature is None else imu.temperature[keep]
    record = ImuRecord(t[keep], imu.gyro[keep], imu.accel[keep], imu.kind, temperature)
    return record, np.nonzero(keep)[0]


def _bursts(n: int, use: EffectUse, rng: np.random.Generator) -> NDArray[np.bool_]:
    length = max(1, round(use.scalar("burst")))
    start = np.nonzero(rng.random(n) < use.scalar("probability"))[0]
    gone = np.zeros(n + length, bool)
    for k in range(length):
        gone[start + k] = True
    return gone[:n]
