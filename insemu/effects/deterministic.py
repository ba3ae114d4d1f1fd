"""Errors of a sensor that are functions of the true signal, of the temperature or of nothing: bias, scale, misalignment, mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.effects import passes
from insemu.effects.base import BOTH, DEG, IMU, RPY, XYZ, Effect, EffectUse, G, Stage, Subset
from insemu.effects.chain import Chain
from insemu.effects.hiding import DriveLot, Hidden, RestLot, at
from insemu.effects.motion import Column, FixGeometry, Motion, first_axis
from insemu.effects.parameters import CELLS, CROSS, EffectParameter
from insemu.errors import InputError
from insemu.sample_times import beat

Array = NDArray[np.float64]
_P = EffectParameter


def _sensor_rows(use: EffectUse) -> slice:
    return slice(0, 3) if use.sensor == "gyro" else slice(3, 6)


class _OfSensor(Effect):
    """An error of the gyroscopes or of the accelerometers."""

    family = "deterministic"
    sensors = BOTH

    def own(self, motion: Motion, shape: Any) -> list[Column]:
        """One column per sensor and axis: a shape of that axis's signal."""
        return [
            Column.of(self, sensor, f"value_{a}", (a,), ((first_axis(sensor) + i, shape(motion.signal(sensor)[:, i])),))
            for sensor in self.sensors
            for i, a in enumerate(XYZ)
        ]


class _CrossAxis(_OfSensor):
    """One of the six pairs of different axes: a trial hides it on one of them."""

    def crossed(self, motion: Motion, by: Array | float = 1.0) -> list[Column]:
        """One column per sensor and pair: the signal of the other axis, times a factor at every row."""
        return [
            Column.of(
                self,
                s,
                f"value_{i}{j}",
                (i,),
                ((first_axis(s) + XYZ.index(i), by * motion.signal(s)[:, XYZ.index(j)]),),
            )
            for s in self.sensors
            for i, j in map(tuple, CROSS)
        ]

    def hidden(self, lot: DriveLot) -> Hidden:
        """One of the six pairs."""
        return Hidden((CROSS[lot.pair][0],), {"value": at(lot.pair, lot.size(self, "value"), 6)})


def _off_diagonal(values: Sequence[float]) -> Array:
    """Matrix (3, 3) of the six pairs of different axes."""
    out = np.zeros((3, 3))
    for (i, j), value in zip(map(tuple, CROSS), values, strict=True):
        out[XYZ.index(i), XYZ.index(j)] = value
    return out


class _OnOneAxis(_OfSensor):
    """One that a trial hides on one axis."""

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis."""
        return Hidden(lot.axis, {self.size: lot.on(lot.size(self, self.size))})


class TurnOnBias(_OnOneAxis):
    """Turn-on bias."""

    id, name, formula = "turn_on_bias", "turn-on bias", "e = b"
    parameters = (_P("value", "{s}", 3, (0.1 * DEG, 2e-3 * G), None, "bias", join="sum"),)
    excitation, in_filter = "fixes, or rest", "random constant per axis"
    traits = frozenset({"evident"})
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the bias."""
        chain.response.offset[chain.axes(use.sensor)] += use["value"]

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """The bias."""
        return np.array(use["value"])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """A constant."""
        return self.own(motion, np.ones_like)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """In units of the Earth rate, which a gyroscope at rest shows too."""
        return {"value": lot.on(lot.sign * strength * 2.0 * earth.RATE)}


class BiasStep(_OnOneAxis):
    """A bias that jumps and stays where it is."""

    id, name, formula = "bias_step", "bias step", "e = b for t > start"
    parameters = (
        _P("value", "{s}", 3, (0.1 * DEG, 2e-3 * G), None, "what the bias jumps by", join="sum"),
        _P("start", "s", 1, (300.0,), None, "when it jumps"),
    )
    excitation, in_filter = "fixes, or rest, before and after it", "a bias state that is made uncertain again"
    traits = frozenset({"slow"})
    stage, size = Stage.LAW, "value"
    absent = {"signature": "one column for every start: the search scans them (steps of a bias)"}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it to the samples behind the start."""
        chain.rows(use.sensor)[:] += self.added(use, chain.t, None).T

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """The bias, of the sample in which it jumps its share."""
        behind = np.clip((t - use.scalar("start")) / (t[1] - t[0]), 0.0, 1.0)
        return np.asarray(behind[:, None] * np.array(use["value"]))

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis, in the middle of the drive."""
        start = float(lot.rng.uniform(0.2, 0.8) * lot.span)
        return Hidden(lot.axis, {"value": lot.on(lot.size(self, "value")), "start": start})

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis, a third of the log after its start."""
        return {"value": lot.on(8.0 * strength * lot.sign * lot.slow), "start": lot.span / 3.0}


class ScaleFactor(_OnOneAxis):
    """Scale factor."""

    id, name, formula = "scale_factor", "scale factor", "e_i = S_i s_i"
    parameters = (_P("value", "", 3, (1e-3,), None, "relative error", join="sum"),)
    excitation, in_filter = "turns (gyro), accelerations (accelerometer)", "random constant per axis times s_i"
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note it on the diagonal."""
        s = chain.axes(use.sensor)
        chain.response.matrix[s, s] += np.diag(use["value"])

    def matrix(self, use: EffectUse) -> Array:
        """The diagonal of the sensor's block."""
        out = np.zeros((6, 6))
        out[_sensor_rows(use), _sensor_rows(use)] = np.diag(use["value"])
        return out

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The signal itself."""
        return self.own(motion, np.ascontiguousarray)


class ScaleAsymmetry(_OnOneAxis):
    """Scale factors of either sign differ."""

    id, name, formula = "scale_asymmetry", "scale-factor asymmetry", "e_i = A_i |s_i|"
    parameters = (
        _P("value", "", 3, (1e-3,), None, "half of the difference of the scale factors of either sign", join="sum"),
    )
    excitation, in_filter = "both signs of s_i", "random constant per axis times |s_i|"
    traits = frozenset({"second_order"})
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note it."""
        chain.response.asymmetry[chain.axes(use.sensor)] += use["value"]

    def bent(self, use: EffectUse, signal: Array, temperature: Array | None, t: Array) -> Array:
        """The magnitude of every axis times its number."""
        out = np.zeros_like(signal)
        rows = _sensor_rows(use)
        out[:, rows] = np.array(use["value"]) * np.abs(signal[:, rows])
        return out

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The magnitude of the signal."""
        return self.own(motion, np.abs)


class ScaleNonlinearity(_OfSensor):
    """Quadratic and cubic scale errors."""

    id, name, formula = "scale_nonlinearity", "scale-factor non-linearity", "e_i = K2_i s_i^2 + K3_i s_i^3"
    parameters = (
        _P("K2", "1/({s})", 3, (1e-3, 1e-4), 0.0, "quadratic coefficient", join="sum"),
        _P("K3", "1/({s})^2", 3, (1e-3, 1e-5), 0.0, "cubic coefficient", join="sum"),
    )
    excitation, in_filter = "a wide range of s_i", "random constants times s_i^2, s_i^3"
    stage = Stage.RESPONSE
    absent = {
        "signature": "squares are the structure outside the catalogue by which a report says 'unexplained'",
        "candidate": "squares are the structure outside the catalogue by which a report says 'unexplained'",
        "refine": "no candidate looks for it",
        "trial": "the trial hides it as what no catalogue holds (quadratic_accelerometer)",
    }  # fmt: skip

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note it."""
        chain.response.square[chain.axes(use.sensor)] += use["K2"]
        chain.response.cube[chain.axes(use.sensor)] += use["K3"]

    def bent(self, use: EffectUse, signal: Array, temperature: Array | None, t: Array) -> Array:
        """Square and cube of every axis."""
        out = np.zeros_like(signal)
        rows = _sensor_rows(use)
        s = signal[:, rows]
        out[:, rows] = (np.array(use["K2"]) + np.array(use["K3"]) * s) * s * s
        return out


class Misalignment(_CrossAxis):
    """Misalignment and non-orthogonality."""

    id, name = "misalignment", "misalignment and non-orthogonality"
    formula = "e_i = sum over j != i of M_ij s_j"
    parameters = (_P("value", "rad", 6, (1e-3,), None, "M_xy, M_xz, M_yx, M_yz, M_zx, M_zy", join="sum"),)
    excitation, in_filter = "rates or accelerations about the other axes", "random constants times s_j"
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note it off the diagonal."""
        s = chain.axes(use.sensor)
        chain.response.matrix[s, s] += _off_diagonal(use["value"])

    def matrix(self, use: EffectUse) -> Array:
        """The sensor's block without its diagonal."""
        out, rows = np.zeros((6, 6)), _sensor_rows(use)
        out[rows, rows] = _off_diagonal(use["value"])
        return out

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The signal of another axis."""
        return self.crossed(motion)


class Mounting(Effect):
    """The IMU is turned in the body."""

    id, name, family, sensors = "mounting", "mounting angles", "deterministic", IMU
    formula = "s_imu = C(rpy)^T s_body, both sensors"
    parameters = (
        _P(
            "rpy",
            "rad",
            3,
            (0.5 * DEG,),
            None,
            "roll, pitch, yaw of the IMU in the body axes that are assumed",
            join="sum",
        ),
    )
    excitation = "motion, and a filter that ties velocity to the body axes"
    in_filter = "two or three attitude constants"
    axes = RPY
    stage, size = Stage.MOUNTING, "rpy"
    absent = {
        "signature": "by the innovations alone it hides in the attitude; the motion across a vehicle that cannot slip shows it",
        "trial": "only a vehicle that cannot slip shows it; the trial's nominal models believe in none",
    }

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Turn the signals."""
        chain.response.mounting = rotation.dcm_from_rpy(use["rpy"]).T @ chain.response.mounting

    def turn(self, use: EffectUse) -> Array:
        """The turn back."""
        return rotation.dcm_from_rpy(np.array(use["rpy"]))

    def merged(self, old: EffectUse, new: EffectUse) -> EffectUse | None:
        """One turn after the other."""
        turned = rotation.dcm_from_rpy(np.array(new["rpy"])) @ rotation.dcm_from_rpy(np.array(old["rpy"]))
        roll, pitch, yaw = (float(x) for x in rotation.rpy_from_dcm(turned))
        return EffectUse(self.id, old.sensor, {"rpy": (roll, pitch, yaw)})


class GSensitivity(_OfSensor):
    """Gyroscopes that feel specific force."""

    id, name, sensors, formula = "g_sensitivity", "g-sensitivity of gyros", ("gyro",), "e = G f"
    parameters = (
        _P("value", "rad/s/(m/s^2)", 9, (0.02 * DEG / G,), None, "matrix row by row, or its diagonal", join="sum"),
    )
    excitation, in_filter = "changing specific force (turns, tilts)", "random constants times f"
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note it between gyroscopes and accelerometers."""
        chain.response.matrix[:3, 3:] += np.array(use["value"]).reshape(3, 3)

    def matrix(self, use: EffectUse) -> Array:
        """The block of the rates' errors by the specific force."""
        out = np.zeros((6, 6))
        out[:3, 3:] = np.array(use["value"]).reshape(3, 3)
        return out

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """A specific force on a gyroscope axis."""
        return [
            Column.of(self, "gyro", f"value_{a}{b}", (a,), ((XYZ.index(a), motion.force[:, XYZ.index(b)]),))
            for a, b in map(tuple, CELLS)
        ]

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """The diagonal besides."""
        single, whole = super().subsets(columns)[:-1], super().subsets(columns)[-1]
        diagonal = [k for k, c in enumerate(columns) if c.label[-1] == c.label[-2]]
        return [*single, (XYZ, "diagonal", diagonal), whole]

    def hidden(self, lot: DriveLot) -> Hidden:
        """One of the nine cells."""
        return Hidden((CELLS[lot.cell][0],), {"value": at(lot.cell, lot.size(self, "value"), 9)})


class GSquaredSensitivity(_OnOneAxis):
    """Gyroscopes that feel the square of the specific force along their axis."""

    id, name, sensors = "g2_sensitivity", "g-squared sensitivity of gyros", ("gyro",)
    formula = "e_i = G2_i f_i^2"
    parameters = (
        _P(
            "value",
            "rad/s/(m/s^2)^2",
            3,
            (0.002 * DEG / G**2,),
            None,
            "bias per square of the specific force along the axis",
            join="sum",
        ),
    )
    traits = frozenset({"second_order"})
    excitation, in_filter = (
        "specific force that changes much (tilts, loops, vibration)",
        "random constant per axis times f_i^2",
    )
    stage, size = Stage.RESPONSE, "value"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the products of the specific force with itself."""
        chain.response.products += [(i, 3 + i, 3 + i, value) for i, value in enumerate(use["value"])]

    def bent(self, use: EffectUse, signal: Array, temperature: Array | None, t: Array) -> Array:
        """Squares of the specific force, on the rates."""
        out = np.zeros_like(signal)
        out[:, :3] = np.array(use["value"]) * signal[:, 3:] ** 2
        return out

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The square of the specific force on a gyroscope axis."""
        return [Column.of(self, "gyro", f"value_{a}", (a,), ((i, motion.force[:, i] ** 2),)) for i, a in enumerate(XYZ)]


def lagged(temperature: Array, dt: float, lag_s: float) -> Array:
    """First-order lag of a sampled temperature, exact for straight lines between the samples; starts in equilibrium.

    Parameters
    ----------
    temperature : (n,) array
        degC or K.
    dt, lag_s : float
        Sampling interval and time constant, s; without a time constant the temperature itself.

    Returns
    -------
    (n,) array
    """
    from scipy.signal import lfilter

    if lag_s <= 0.0:
        return temperature
    phi = float(np.exp(-dt / lag_s))
    now = 1.0 - lag_s / dt * (1.0 - phi)  # exact response to a ramp over one interval
    start = temperature[:1] * (1.0 - now)
    return np.asarray(lfilter([now, 1.0 - phi - now], [1.0, -phi], temperature, zi=start)[0])


#: Temperature about which the signature's powers are taken, degC: the default of T0.
REFERENCE_DEGC = 25.0
_T0 = _P("T0", "degC", 1, (25.0,), REFERENCE_DEGC, "reference temperature", join="equal")
_LAG = _P(
    "lag", "s", 1, (60.0,), 0.0, "time constant of the sensing element behind the temperature that is recorded", True, join="equal"
)  # fmt: skip


class Temperature(_OnOneAxis):
    """A bias that follows the temperature."""

    id, name = "temperature", "temperature-dependent bias"
    formula = "e = c1 d + c2 d^2 + c3 d^3, d = T_lag - T0, lag_s T_lag' = T - T_lag"
    parameters = (
        _P("c1", "{s}/K", 3, (0.005 * DEG, 1e-4 * G), 0.0, "linear coefficient", join="sum"),
        _P("c2", "{s}/K^2", 3, (1e-4 * DEG, 2e-6 * G), 0.0, "quadratic coefficient", join="sum"),
        _P("c3", "{s}/K^3", 3, (2e-6 * DEG, 4e-8 * G), 0.0, "cubic coefficient", join="sum"),
        _T0,
        _LAG,
    )
    excitation, in_filter = "a temperature sweep", "compensation by the recorded temperature"
    traits = frozenset({"shape", "evident"})
    stage, size, needs_temperature = Stage.LAW, "c1", True

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add the cubic."""
        d = lagged(chain.need_temperature(use), chain.dt, use.scalar("lag")) - use.scalar("T0")
        for row, c1, c2, c3 in zip(chain.rows(use.sensor), use["c1"], use["c2"], use["c3"], strict=True):
            passes.add_cubic(row, d, c1, c2, c3)

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """The cubic of the recorded temperature."""
        d = warmed(use, t, temperature)[:, None]
        return np.asarray(((np.array(use["c3"]) * d + np.array(use["c2"])) * d + np.array(use["c1"])) * d)

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """Powers of the temperature, without lag."""
        if motion.warmth is None:
            return []
        d = motion.warmth - REFERENCE_DEGC
        return [
            Column.of(self, sensor, f"c{power}_{a}", (a,), ((first_axis(sensor) + i, d**power),))
            for sensor in self.sensors
            for i, a in enumerate(XYZ)
            for power in (1, 2, 3)
        ]

    def more(self, column: Column, use: EffectUse, motion: Motion) -> Column:
        """Behind the lag of what is known of the axis."""
        power, (axis,) = int(column.label[1]), column.axes
        if motion.warmth is None or use[f"c{power}"][XYZ.index(axis)] == 0.0:
            return column
        d = warmed(use, motion.t, motion.warmth)
        return replace(column, inputs=((column.inputs[0][0], d**power),))

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """On each axis linear or cubic, and linear on all of them."""
        out: list[Subset] = []
        for a in XYZ:
            own = [k for k, c in enumerate(columns) if c.axes == (a,)]
            out += [((a,), "linear", own[:1]), ((a,), "cubic", own)]
        return [*out, (XYZ, "linear", [k for k, c in enumerate(columns) if c.label.startswith("c1")])]

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """Linear."""
        return {"c1": lot.on(0.6 * strength * lot.slow)}


def warmed(use: EffectUse, t: Array, temperature: Array | None) -> Array:
    """What the sensing element is warmer than the reference, (n,) K.

    Parameters
    ----------
    use : EffectUse
        With the parameters ``lag`` and ``T0``.
    t : (n,) array
        s.
    temperature : (n,) array or None
        As recorded, degC.
    """
    if temperature is None:
        raise InputError(f"the effect '{use.id}' needs the temperature of the data; none was recorded")
    return lagged(temperature, beat(t), use.scalar("lag")) - use.scalar("T0")


class _Warmed(_OnOneAxis):
    """An error that is proportional to a signal and to the temperature: of every kelvin a matrix of the sensor's three axes."""

    excitation = "the signals of the effect without temperature, during a temperature sweep"
    in_filter = "compensation by the recorded temperature"
    traits = frozenset({"second_order"})
    stage, size, needs_temperature = Stage.RESPONSE, "value", True

    def per_kelvin(self, use: EffectUse) -> Array:
        """Matrix (3, 3) of the sensor's axes."""
        raise NotImplementedError

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the matrix with the temperature that it follows."""
        matrix, s = np.zeros((6, 6)), chain.axes(use.sensor)
        matrix[s, s] = self.per_kelvin(use)
        d = lagged(chain.need_temperature(use), chain.dt, use.scalar("lag")) - use.scalar("T0")
        chain.response.changing.append((matrix, d))

    def bent(self, use: EffectUse, signal: Array, temperature: Array | None, t: Array) -> Array:
        """The matrix at the recorded temperature."""
        out, rows = np.zeros_like(signal), _sensor_rows(use)
        out[:, rows] = warmed(use, t, temperature)[:, None] * (signal[:, rows] @ self.per_kelvin(use).T)
        return out


class ThermalScaleFactor(_Warmed):
    """A scale factor that follows the temperature: up to 150 ppm/K of a small gyroscope (Nikolic et al. 2016, section IV-D)."""

    id, name = "temperature_scale_factor", "temperature-dependent scale factor"
    formula = "e_i = S_i d s_i, d as for temperature"
    parameters = (_P("value", "1/K", 3, (1e-4,), None, "relative error per kelvin", join="sum"), _T0, _LAG)

    def per_kelvin(self, use: EffectUse) -> Array:
        """A diagonal."""
        return np.diag(use["value"])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The signal times the temperature, without lag."""
        if motion.warmth is None:
            return []
        d = motion.warmth - REFERENCE_DEGC
        return self.own(motion, lambda s: d * s)


class ThermalMisalignment(_CrossAxis, _Warmed):
    """A misalignment that follows the temperature."""

    id, name = "temperature_misalignment", "temperature-dependent misalignment"
    formula = "e_i = sum over j != i of M_ij d s_j, d as for temperature"
    parameters = (
        _P("value", "rad/K", 6, (2e-5,), None, "M_xy, M_xz, M_yx, M_yz, M_zx, M_zy per kelvin", join="sum"), _T0, _LAG
    )  # fmt: skip

    def per_kelvin(self, use: EffectUse) -> Array:
        """Everything but the diagonal."""
        return _off_diagonal(use["value"])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The signal of another axis times the temperature, without lag."""
        return [] if motion.warmth is None else self.crossed(motion, motion.warmth - REFERENCE_DEGC)


EFFECTS: tuple[Effect, ...] = (
    TurnOnBias(), BiasStep(), ScaleFactor(), ScaleAsymmetry(), ScaleNonlinearity(), Misalignment(), Mounting(), GSensitivity(), GSquaredSensitivity(),
    Temperature(), ThermalScaleFactor(), ThermalMisalignment(),
)  # fmt: skip
