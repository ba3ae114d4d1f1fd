"""What signatures are made of: the motion that a filter estimated, the fixes along it, and a column per unit effect.

Nothing here knows how the emulator makes an effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.denoise import outstanding
from insemu.records import ImuRecord
from insemu.sample_times import beat

if TYPE_CHECKING:
    from insemu.effects.base import Effect

Array = NDArray[np.float64]

#: Longest time over which noise is taken out of what an error of the sensor is held to be proportional to, s.
QUIET_S = 40.0
#: Lowest frequency at which a moving IMU shows vibration and noise rather than its motion, Hz. What errors are held to be proportional to is
#: slower: vibration that is sampled by fixes tells nothing about an offset of milliseconds, and goes with the wrong swing of an antenna as much
#: as with any sensor.
MOTION_HZ = 8.0
#: Order and corner, over that frequency, of the low-pass run both ways: it passes 0.99 at half of it and less than a tenth at all of it
#: (tests/test_effects_pins.py).
ORDER, CORNER = 6, 0.8
#: A temperature that varies less than this shows nothing, K.
STEADY_K = 1e-3


@dataclass(frozen=True)
class Column:
    """One unit effect.

    Parameters
    ----------
    effect, sensor : str
    label : str
        Parameter of the effect, with its axis: ``value_x``.
    axes : tuple of str
        Axes of the sensor that the column is about; empty where it has none.
    scale : float
        Datasheet scale of the coefficient, SI.
    unit : str
        Of the parameter.
    inputs : tuple of (axis 0..5, (n,) array)
        Unit sensor errors.
    fixes : (f, 6) array, optional
        Unit errors of the fixes, measured minus true.
    runs : bool
        Whether the position also runs away by the velocity.
    start : (6,) array, optional
        Unit errors of position and velocity where the filter starts, estimated minus true, m and m/s NED.
    power : float
        The coefficient is the parameter to this power, and so is the scale; the unit is that of the parameter.
    """

    effect: str
    sensor: str
    label: str
    axes: tuple[str, ...]
    scale: float
    unit: str
    inputs: tuple[tuple[int, Array], ...] = ()
    fixes: Array | None = None
    runs: bool = False
    start: Array | None = None
    power: float = 1.0

    @classmethod
    def of(
        cls,
        effect: Effect,
        sensor: str,
        label: str,
        axes: tuple[str, ...],
        inputs: tuple[tuple[int, Array], ...] = (),
        fixes: Array | None = None,
        start: Array | None = None,
    ) -> Column:
        """A column at the datasheet's scale.

        Parameters
        ----------
        effect : Effect
        sensor : str
        label : str
            Begins with the name of the parameter.
        axes, inputs, fixes, start
            See :class:`Column`.
        """
        parameter = label.partition("_")[0]
        scale, unit = effect.scale(parameter, sensor), effect.unit(parameter, sensor)
        return cls(effect.id, sensor, label, axes, scale, unit, inputs, fixes, start=start)

    def raised(self, power: float) -> Column:
        """The same column, whose coefficient is the parameter to a power."""
        return replace(self, scale=self.scale**power, power=power)

    def parameter(self, coefficient: float, sd: float) -> tuple[float, float]:
        """Value and standard deviation of the parameter.

        Parameters
        ----------
        coefficient, sd : float
            Of the column.
        """
        if self.power == 1.0:
            return coefficient, sd
        value = max(coefficient, 0.0) ** (1.0 / self.power)
        # next to nothing the parameter is known to what the coefficient's deviation alone would make
        return value, sd / (self.power * max(value, sd ** (1.0 / self.power)) ** (self.power - 1.0))


@dataclass(frozen=True)
class Motion:
    """The measured trajectory at the IMU's rate, as the nominal filter estimated it.

    Parameters
    ----------
    t : (n,) array
    C : (n, 3, 3) array
        Attitude for each interval.
    rate, force : (n, 3) arrays
        Mean angular rate and specific force over each interval, sensor axes, less what is noise or vibration.
    f_n : (n, 3) array
        Specific force in NED.
    vel : (n, 3), llh : (n, 3) arrays
    temperature : (n,) array, optional
    node : (k,) array of int
        IMU rows of the filter's nodes.
    summed : bool
        Whether the record holds increments, which no stretched time stamp changes.
    recorded_from : float, optional
        First stamp of the recording, s, where the filter starts later.
    """

    t: Array
    C: Array
    rate: Array
    force: Array
    f_n: Array
    vel: Array
    llh: Array
    temperature: Array | None
    node: NDArray[np.int64]
    summed: bool = True
    recorded_from: float | None = None

    @classmethod
    def of(
        cls,
        imu: ImuRecord,
        nav: Array,
        node: NDArray[np.int64],
        noise: Array | None = None,
        recorded_from: float | None = None,
    ) -> Motion:
        """From a filter's run.

        Parameters
        ----------
        imu : ImuRecord
        nav : (n, 10) array
            Latitude, longitude (rad), height (m), velocity (m/s), quaternion at every row.
        node : (k,) array of int
            Rows of the filter's nodes.
        noise : (6,) array, optional
            Standard deviations of the noise of mean rates (rad/s) and specific forces (m/s^2) over an interval, where they are known: a
            vehicle that shakes hides them, and its own motion behind the shaking is no noise.
        recorded_from : float, optional
            First stamp of the recording, s.
        """
        t = imu.t
        step = np.diff(t, prepend=2 * t[0] - t[1])
        increments = imu.as_increments()
        rate, force = increments.gyro / step[:, None], increments.accel / step[:, None]
        C = rotation.dcm_from_quaternion(nav[:, 6:10])
        # attitude in the middle of the interval: back by half of the turn
        middle = C @ rotation.dcm_from_quaternion(rotation.quaternion_from_vector(-0.5 * increments.gyro))
        f_n = np.einsum("nij,nj->ni", middle, force)
        known = (None, None) if noise is None else (noise[:3], noise[3:])
        rate, force = _quiet(rate, imu.dt, known[0]), _quiet(force, imu.dt, known[1])
        summed = imu.kind == "increment"
        return cls(t, middle, rate, force, f_n, nav[:, 3:6], nav[:, :3], imu.temperature, node, summed, recorded_from)

    @property
    def began(self) -> float:
        """First stamp of the recording, s."""
        return float(self.t[0]) if self.recorded_from is None else self.recorded_from

    def signal(self, sensor: str) -> Array:
        """Rate or specific force (n, 3)."""
        return self.rate if sensor == "gyro" else self.force

    @property
    def warmth(self) -> Array | None:
        """The temperature where it says something; None where it is unknown or steady."""
        some = self.temperature is not None and float(np.std(self.temperature)) > STEADY_K
        return self.temperature if some else None

    @property
    def acceleration(self) -> Array:
        """Acceleration with respect to the Earth, (n, 3) in NED."""
        return self.f_n + self.gravity

    @cached_property
    def steady_acceleration(self) -> Array:
        """The same as :func:`acceleration_along` has it."""
        return acceleration_along(self.t, self.acceleration, self.vel)

    @property
    def gravity(self) -> Array:
        """Gravity, (n, 3) in NED."""
        return np.array([0.0, 0.0, 1.0]) * earth.gravity(self.llh[:, 0], self.llh[:, 2])[:, None]


def _quiet(signal: Array, dt: float, noise: Array | None = None) -> Array:
    """Measured motion less what is noise or vibration.

    The noise of an axis that hardly moves is its own error: a column that goes with it would explain the innovations that this noise makes, as
    a scale factor of tens of per cent.
    """
    levels = max(1, math.floor(math.log2(min(QUIET_S / dt, signal.shape[0] / 16))))
    return steady(outstanding(signal, levels, noise=noise), dt)


def steady(signal: Array, dt: float) -> Array:
    """A signal (n, k) without what is faster than motion, not delayed; as it is where samples are too far apart to hold anything faster."""
    corner = CORNER * MOTION_HZ
    if corner > 0.4 / dt:
        return signal
    sections = scipy.signal.butter(ORDER, corner, fs=1.0 / dt, output="sos")
    # the first row may be no whole interval
    x = np.concatenate([signal[1:2], signal[1:]])
    return np.asarray(scipy.signal.sosfiltfilt(sections, x, axis=0, padlen=min(round(1.0 / (corner * dt)), len(x) - 1)))


def acceleration_along(t: Array, acceleration: Array, vel: Array) -> Array:
    """Measured acceleration (n, 3) less vibration and less what makes it drift away from the velocities next to it, NED, m/s^2.

    Parameters
    ----------
    t : (n,) array
        s.
    acceleration : (n, 3) array
        Over the interval up to each time, m/s^2.
    vel : (n, 3) array
        m/s.
    """
    dt = beat(t)
    drift = acceleration - np.diff(vel, axis=0, prepend=vel[:1]) / dt
    drift[0] = 0.0  # of the first row no velocity before it is known
    slow = scipy.ndimage.uniform_filter1d(drift, max(1, min(round(QUIET_S / dt), t.size)), axis=0, mode="reflect")
    return steady(acceleration - slow, dt)


def swing_along(C: Array, rate: Array, lever_arm: ArrayLike) -> Array:
    """Velocity (n, 3) of an antenna about the IMU, NED, m/s.

    Parameters
    ----------
    C : (n, 3, 3) array
        Attitude of the IMU.
    rate : (n, 3) array
        rad/s, sensor axes.
    lever_arm : (3,) array
        From the IMU to the antenna, m, sensor axes.
    """
    return np.asarray(np.einsum("nij,nj->ni", C, np.cross(rate, np.asarray(lever_arm, dtype=float))))


@dataclass(frozen=True)
class AntennaMotion:
    """Motion along which fixes are put right, over the interval up to each time.

    Parameters
    ----------
    t : (n,) array
        s.
    C : (n, 3, 3) array
        Attitude.
    rate : (n, 3) array
        rad/s, body axes.
    acceleration : (n, 3) array
        Of the IMU, m/s^2, NED.
    lever_arm : (3,) array
        From the IMU to the antenna, m, body axes.
    vel : (n, 3) array
        Of the IMU at each time, m/s, NED.
    """

    t: Array
    C: Array
    rate: Array
    acceleration: Array
    lever_arm: Array
    vel: Array

    @cached_property
    def swing(self) -> Array:
        """Velocity (n, 3) of the antenna about the IMU, NED, m/s."""
        return swing_along(self.C, self.rate, self.lever_arm)

    def velocity_at(self, at: Array) -> Array:
        """Velocity (k, 3) of the IMU at times (k,) in s."""
        return np.column_stack([np.interp(at, self.t, v) for v in self.vel.T])

    def row(self, at: Array) -> NDArray[np.int64]:
        """Rows of times ``at`` (k,) in s, the nearest."""
        middles = self.t - 0.5 * beat(self.t)
        return np.asarray(np.clip(np.searchsorted(middles, at), 0, self.t.size - 1))


def behind_low_pass(signal: Array, dt: float, tau: float) -> Array:
    """A signal (n,) behind a low-pass of first order that rested on its first value; straight between samples.

    Parameters
    ----------
    signal : (n,) array
    dt : float
        Sampling interval, s.
    tau : float
        Time constant, s; the signal itself where it is not positive.
    """
    if not tau > 0.0:
        return signal
    kept = math.exp(-dt / tau)
    mean = (1.0 - kept) * tau / dt
    b0 = 1.0 - mean
    out, _ = scipy.signal.lfilter([b0, mean - kept], [1.0, -kept], signal, zi=np.array([(1.0 - b0) * signal[0]]))
    return np.asarray(out)


def first_axis(sensor: str) -> int:
    """Where a sensor's axes begin among six."""
    return 3 if sensor == "accel" else 0


def on_axes(signal: Array, first: int = 0) -> tuple[tuple[int, Array], ...]:
    """Three columns (n, 3) as inputs of the axes from ``first`` on."""
    return tuple((first + i, np.ascontiguousarray(signal[:, i])) for i in range(3))


@dataclass(frozen=True)
class FixGeometry:
    """The fixes along a motion.

    Parameters
    ----------
    t : (f,) array
        s.
    lever_arm : (3,) array
        From the IMU to the antenna, m, in the axes of the IMU.
    body_axes : (3, 3) array
        Rows: the axes of the body, in those of the IMU.
    velocity, acceleration, rate, turning : (f, 3) arrays
        Of the IMU with respect to the Earth: NED, NED, sensor axes; and the derivative of the last, rad/s^2.
    C : (f, 3, 3) array
        Attitude of the IMU.
    start : (6,) array
        What a second between IMU and fixes makes of position and velocity of the IMU where the filter starts, NED.
    slopes : (f, 3) array, optional
        Of velocities that the receiver smooths, m/s^2, NED; NaN where it does not.
    """

    t: Array
    lever_arm: Array
    body_axes: Array
    velocity: Array
    acceleration: Array
    rate: Array
    turning: Array
    C: Array
    start: Array
    slopes: Array | None = None

    @classmethod
    def of(cls, motion: Motion, t: Array, lever_arm: ArrayLike, mounting: ArrayLike = (0.0, 0.0, 0.0)) -> FixGeometry:
        """Motion at the times of the fixes, from the nearest rows.

        Parameters
        ----------
        motion : Motion
        t : (f,) array
            s.
        lever_arm : (3,) array
            m.
        mounting : (3,) array
            Roll, pitch, yaw of the IMU in the body, rad.
        """
        k, dt = np.clip(np.searchsorted(motion.t, t), 1, motion.t.size - 2), float(motion.t[1] - motion.t[0])
        a = motion.acceleration
        smooth, turning = steady(a, dt), np.gradient(motion.rate, dt, axis=0)
        v = motion.vel[k] - 0.5 * (a[k] + a[k + 1]) * (motion.t[k] - t)[:, None]
        w_ie = earth.earth_rate(motion.llh[k, 0])
        omega = 0.5 * (motion.rate[k] + motion.rate[k + 1]) - np.einsum("nji,nj->ni", motion.C[k], w_ie)
        body = rotation.dcm_from_rpy(np.asarray(mounting, dtype=float))
        accel, turning = (0.5 * (x[k] + x[k + 1]) for x in (smooth, turning))
        start = np.concatenate([motion.vel[0], smooth[0]])
        return cls(t, np.asarray(lever_arm, dtype=float), body, v, accel, omega, turning, motion.C[k], start)

    def smoothed(self, motion: Motion, tau: Array) -> FixGeometry:
        """The fixes with velocities that the receiver smooths, and that are put right along the motion.

        Parameters
        ----------
        motion : Motion
        tau : (3,) array
            Time constants, NED, s; 0: not smoothed.
        """
        swing = swing_along(motion.C, motion.rate, self.lever_arm)
        slopes = np.full((self.t.size, 3), np.nan)
        for k in np.flatnonzero(tau):
            slopes[:, k] = smoothed_slope(
                self.t, motion.t, motion.steady_acceleration[:, k], swing[:, k], float(tau[k])
            )
        return replace(self, slopes=slopes)

    @property
    def change_per_second(self) -> Array:
        """What a second between IMU and fixes makes of position and velocity of the antenna, (f, 6).

        Of a smoothed velocity only the receiver's part moves with the stamps: what it is behind is put right along the IMU.
        """
        arm = self.lever_arm
        around = np.cross(self.rate, arm)
        swing = np.einsum("nij,nj->ni", self.C, around)
        # from one fix to the next an antenna on a shaking vehicle swings to and fro, which a difference of the fixes would not show
        swing_rate = np.einsum("nij,nj->ni", self.C, np.cross(self.turning, arm) + np.cross(self.rate, around))
        along = self.acceleration + swing_rate
        if self.slopes is not None:
            along = np.where(np.isfinite(self.slopes), self.slopes, along)
        return np.hstack([self.velocity + swing, along])


def smoothed_slope(at: Array, t: Array, acceleration: Array, swing: Array, tau: float) -> Array:
    """Slope at times of a velocity of the antenna smoothed by a time constant in s.

    Parameters
    ----------
    at : (f,) array
        s.
    t : (n,) array
        s.
    acceleration, swing : (n,) arrays
        Of the IMU, m/s^2, and velocity of the antenna about it, m/s, over the interval up to each time.
    tau : float
        s.
    """
    dt = beat(t)
    about = (swing - behind_low_pass(swing, dt, tau)) / tau if tau > 0.0 else np.gradient(swing, dt)
    return np.asarray(np.interp(at, t - 0.5 * dt, behind_low_pass(acceleration, dt, tau) + about))
