"""What effects are injected into: the signals of an IMU on their way through the sensor, and the errors of the fixes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from insemu.effects import passes
from insemu.effects.base import EffectUse
from insemu.effects.terms import Signals
from insemu.errors import InputError
from insemu.records import ImuRecord, Trajectory

Array = NDArray[np.float64]

#: Rows whose angles stay in the cache.
_BLOCK = 2048


@dataclass
class Response:
    """What the effects that are functions of the true signal amount to together; see :func:`insemu.effects.passes.respond`."""

    mounting: Array = field(default_factory=lambda: np.eye(3))
    matrix: Array = field(default_factory=lambda: np.zeros((6, 6)))
    asymmetry: Array = field(default_factory=lambda: np.zeros(6))
    square: Array = field(default_factory=lambda: np.zeros(6))
    cube: Array = field(default_factory=lambda: np.zeros(6))
    offset: Array = field(default_factory=lambda: np.zeros(6))
    #: Axis that errs, the two axes whose product it errs by, the factor.
    products: list[tuple[int, int, int, float]] = field(default_factory=list)
    #: Matrices (6, 6), each with its row (n,).
    changing: list[tuple[Array, Array]] = field(default_factory=list)

    def apply(self, signal: Array) -> None:
        """Apply to the rows (6, n) in place."""
        places = np.array([p[:3] for p in self.products], dtype=np.int64).reshape(-1, 3)
        factors = np.array([p[3] for p in self.products], dtype=np.float64)
        warm = [(i, j, q, m[i, j]) for q, (m, _) in enumerate(self.changing) for i, j in np.argwhere(m)]
        warm_places = np.array([w[:3] for w in warm], dtype=np.int64).reshape(-1, 3)
        warm_factors = np.array([w[3] for w in warm], dtype=np.float64)
        levels = np.array([row for _, row in self.changing]).reshape(-1, signal.shape[1])
        sums = self.mounting, self.matrix, self.asymmetry, self.square, self.cube, self.offset
        passes.respond(signal, passes.ResponseArrays(*sums, places, factors, warm_places, warm_factors, levels))


@dataclass
class Chain:
    """The signals of an IMU on their way through the sensor.

    Parameters
    ----------
    t : (n,) array
        True times, s.
    dt : float
        Sampling interval, s.
    signal : (6, n) array
        rad/s and m/s^2.
    work, profile : (n,) arrays
        Rows to work in.
    reference : Trajectory or None
        At the rows.
    temperature : (n,) array or None
        degC.
    stamps : (n,) array
        Time stamps, s.
    keep : (n,) array of bool
        Samples that are not lost.
    """

    t: Array
    dt: float
    signal: Array
    work: Array
    profile: Array
    reference: Trajectory | None
    temperature: Array | None
    stamps: Array
    keep: NDArray[np.bool_]
    _speed: Array
    response: Response = field(default_factory=Response)
    earth_share: float = 0.0
    transport_share: float = 0.0
    gravity_offset: float = 0.0
    _has_speed: bool = False

    @classmethod
    def of(cls, imu: ImuRecord, step: Array, reference: Trajectory | None, temperature: Array | None) -> Chain:
        """A record's rates and forces.

        Parameters
        ----------
        imu : ImuRecord
        step : (n,) array
            Intervals of increments, s; empty for the other kinds.
        reference : Trajectory or None
            At the rows.
        temperature : (n,) array or None
            degC.
        """
        rows = np.empty((9, len(imu)))  # one block: large ones come in large pages
        passes.load(imu.gyro, imu.accel, step, rows[:6])
        keep = np.ones(len(imu), np.bool_)
        return cls(imu.t, imu.dt, rows[:6], rows[6], rows[7], reference, temperature, imu.t, keep, rows[8])

    def axes(self, sensor: str) -> slice:
        """Rows of a sensor."""
        return slice(0, 3) if sensor == "gyro" else slice(3, 6)

    def rows(self, sensor: str) -> Array:
        """Signals (3, n) of a sensor."""
        return self.signal[self.axes(sensor)]

    def need_reference(self, use: EffectUse) -> Trajectory:
        """The reference, which an effect cannot do without."""
        if self.reference is None or len(self.reference) != self.t.size:
            raise InputError(f"effect '{use.id}' needs the reference trajectory at the rows of the IMU record")
        return self.reference

    def need_temperature(self, use: EffectUse) -> Array:
        """The temperature, which an effect cannot do without."""
        if self.temperature is None:
            raise InputError(f"effect '{use.id}' needs a temperature: give a temperature profile")
        return self.temperature

    def speed(self, use: EffectUse) -> Array:
        """Speed (n,), m/s."""
        reference = self.need_reference(use)
        if not self._has_speed:
            passes.speeds(reference.vel_ned, self._speed)
            self._has_speed = True
        return self._speed

    def motion_profile(self, use: EffectUse) -> Array | None:
        """From ``rest_factor`` at standstill to 1 above 5 m/s; None where it is 1 everywhere."""
        rest = use.scalar("rest_factor")
        if rest == 1.0:
            return None
        passes.motion_profile(self.speed(use), rest, self.profile)
        return self.profile

    def add_shaped(
        self, use: EffectUse, parameter: str, level: Array | None, draw: Callable[[], None] | None = None
    ) -> None:
        """Add the row in work to every axis of a sensor.

        Parameters
        ----------
        use : EffectUse
        parameter : str
            Whose numbers are the factors of the axes.
        level : (n,) array or None
            Another factor.
        draw : callable, optional
            Fills the row anew for every axis.
        """
        for row, factor in zip(self.rows(use.sensor), use[parameter], strict=True):
            if draw is not None:
                draw()
            if level is None:
                passes.add_scaled(row, self.work, factor)
            else:
                passes.add_product(row, self.work, level, factor)

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
                self.signal[:, rows], part, r.llh[rows, 2], r.vel_ned[rows],
                self.earth_share, self.transport_share, self.gravity_offset,
            )  # fmt: skip

    def respond(self) -> None:
        """Apply the functions of the true signal."""
        self.response.apply(self.signal)


class FixErrors:
    """Errors of all fixes, (n, 3) in m and m/s; effects change the levels, add to the sums, move the antenna and the time.

    Parameters
    ----------
    t : (n,) array
        Stamps, s.
    sigma, sigma_v : (3,) arrays or None
        Standard deviations of the white noise, m and m/s.
    of_position, of_velocity : Generator
    signals : callable
        The true motion at the stamps.
    """

    def __init__(
        self,
        t: Array,
        sigma: Array,
        sigma_v: Array | None,
        of_position: np.random.Generator,
        of_velocity: np.random.Generator,
        signals: Callable[[], Signals],
    ) -> None:
        n = t.size
        self.signals = signals
        self.t, self.sigma, self.sigma_v = t, sigma, sigma_v
        self.white = of_position.standard_normal((n, 3))
        self.white_v = of_velocity.standard_normal((n, 3))
        self.level, self.level_v = np.ones((n, 3)), np.ones((n, 3))
        self.said = np.ones((n, 1))
        self.added, self.added_v = np.zeros((n, 3)), np.zeros((n, 3))
        self.arm = np.zeros(3)
        self.arm_steps: list[tuple[float, Array]] = []
        self.position_tau = np.zeros(3)
        self.latency = 0.0
        self.velocity_lag, self.velocity_window, self.velocity_tau = 0.0, 0.0, np.zeros(3)

    def arm_at(self, t: Array) -> Array:
        """What the lever arm lacks, m: (3,), or (n, 3) at times (n,) where it changes."""
        out = self.arm
        for start, value in self.arm_steps:
            out = out + (t > start)[:, None] * value
        return out

    def position(self) -> Array:
        """Errors of the positions, m."""
        return np.asarray(self.level * self.sigma * self.white + self.added)

    def velocity(self) -> Array:
        """Errors of the velocities, m/s."""
        assert self.sigma_v is not None
        return np.asarray(self.level_v * self.sigma_v * self.white_v + self.added_v)

    def stated(self) -> Array:
        """Standard deviations of the positions as the receiver states them, m."""
        return np.asarray(self.said * self.sigma)

    def stated_velocity(self) -> Array:
        """Standard deviations of the velocities as the receiver states them, m/s."""
        assert self.sigma_v is not None
        return np.asarray(self.said * self.sigma_v)
