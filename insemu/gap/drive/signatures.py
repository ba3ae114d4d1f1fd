"""Signatures: what each effect does to the innovations of the filter, analytic along the flown trajectory and with the filter in the loop.

A unit effect enters as an error of a sensor (integrated through the error dynamics) or of the fixes; with the stored transition, gain and
Jacobian of the nominal filter ``e- = Phi e+ + D``, ``g = -H e- + M``, ``e+ = e- + K g``. Nothing here knows how the emulator makes an effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.denoise import outstanding
from insemu.effects import CROSS, EFFECTS
from insemu.filters import FilterResult
from insemu.gap.evidence import kernels
from insemu.records import ImuRecord

Array = NDArray[np.float64]

_AXES = "xyz"


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
        Datasheet scale of the parameter, SI.
    unit : str
    inputs : tuple of (axis 0..5, (n,) array)
        Unit sensor errors.
    fixes : (f, 6) array, optional
        Unit errors of the fixes, measured minus true.
    runs : bool
        Whether the position also runs away by the velocity.
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


@dataclass(frozen=True)
class Motion:
    """The measured trajectory at the IMU's rate, as the nominal filter estimated it.

    Parameters
    ----------
    t : (n,) array
    C : (n, 3, 3) array
        Attitude for each interval.
    rate, force : (n, 3) arrays
        Mean angular rate and specific force over each interval, sensor axes, less what is noise.
    f_n : (n, 3) array
        Specific force in NED.
    vel : (n, 3), llh : (n, 3) arrays
    temperature : (n,) array, optional
    node : (k,) array of int
        IMU rows of the filter's nodes.
    summed : bool
        Whether the record holds increments, which no stretched time stamp changes.
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

    @classmethod
    def of(cls, imu: ImuRecord, result: FilterResult) -> Motion:
        """From a filter run with ``output_every=1`` and ``store="fixes"``."""
        assert result.nodes is not None
        t = imu.t
        step = np.diff(t, prepend=2 * t[0] - t[1])
        increments = imu.as_increments()
        rate, force = increments.gyro / step[:, None], increments.accel / step[:, None]
        C = rotation.dcm_from_quaternion(result.nav[:, 6:10])
        # attitude in the middle of the interval: back by half of the turn
        middle = C @ rotation.dcm_from_quaternion(rotation.quaternion_from_vector(-0.5 * increments.gyro))
        f_n = np.einsum("nij,nj->ni", middle, force)
        return cls(
            t,
            middle,
            _quiet(rate, imu.dt),
            _quiet(force, imu.dt),
            f_n,
            result.nav[:, 3:6],
            result.nav[:, :3],
            imu.temperature,
            result.nodes.epoch,
            imu.kind == "increment",
        )


#: Longest time over which noise is taken out of what an error of the sensor is held to be proportional to, s.
QUIET_S = 40.0


def _quiet(signal: Array, dt: float) -> Array:
    """Measured motion less what is noise.

    The noise of an axis that hardly moves is its own error: a column that goes with it would explain the innovations that this noise makes, as
    a scale factor of tens of per cent.
    """
    levels = max(1, math.floor(math.log2(min(QUIET_S / dt, signal.shape[0] / 16))))
    return outstanding(signal, levels)


def deterministic_columns(motion: Motion, lags: Sequence[float] = (0.0, 60.0)) -> list[Column]:
    """Unit columns of every deterministic effect of the sensors, and of what a model may omit."""
    out: list[Column] = []
    n = motion.t.size
    one = np.ones(n)
    for sensor, first, signal in (("gyro", 0, motion.rate), ("accel", 3, motion.force)):
        for i, a in enumerate(_AXES):
            s = signal[:, i]
            out.append(_column("turn_on_bias", sensor, f"value_{a}", (a,), "value", ((first + i, one),)))
            out.append(_column("scale_factor", sensor, f"value_{a}", (a,), "value", ((first + i, s),)))
            out.append(_column("scale_asymmetry", sensor, f"value_{a}", (a,), "value", ((first + i, np.abs(s)),)))
            if motion.temperature is not None and float(np.std(motion.temperature)) > 1e-3:
                d = motion.temperature - 25.0
                for power in (1, 2, 3):
                    out.append(
                        _column("temperature", sensor, f"c{power}_{a}", (a,), f"c{power}", ((first + i, d**power),))
                    )
        for pair in CROSS:
            i, j = _AXES.index(pair[0]), _AXES.index(pair[1])
            out.append(
                _column("misalignment", sensor, f"value_{pair}", (pair[0],), "value", ((first + i, signal[:, j]),))
            )
    for i, a in enumerate(_AXES):
        for j, b in enumerate(_AXES):
            out.append(_column("g_sensitivity", "gyro", f"value_{a}{b}", (a,), "value", ((i, motion.force[:, j]),)))
    for k, name in enumerate(("roll", "pitch", "yaw")):
        axis = np.eye(3)[k]
        turned = [-np.cross(axis, signal) for signal in (motion.rate, motion.force)]
        inputs = tuple((3 * q + i, np.ascontiguousarray(turned[q][:, i])) for q in (0, 1) for i in range(3) if i != k)
        out.append(_column("mounting", "imu", f"rpy_{name}", (name,), "rpy", inputs))
    down = -np.ascontiguousarray(motion.C[:, 2, :])  # -C_bn (0, 0, 1)
    out.append(_column("gravity", "imu", "offset", (), "offset", tuple((3 + i, down[:, i].copy()) for i in range(3))))
    lat, h = motion.llh[:, 0], motion.llh[:, 2]
    ie_n = np.stack([earth.RATE * np.cos(lat), np.zeros(n), -earth.RATE * np.sin(lat)], axis=1)
    en_n = earth.transport_rate(motion.llh, motion.vel)
    del h
    for effect, w_n in (("earth_rate", ie_n), ("transport_rate", en_n)):
        w_b = -np.einsum("nji,nj->ni", motion.C, w_n)
        out.append(
            _column(
                effect, "imu", "fraction", (), "fraction", tuple((i, np.ascontiguousarray(w_b[:, i])) for i in range(3))
            )
        )
    return out


def _column(
    effect: str,
    sensor: str,
    label: str,
    axes: tuple[str, ...],
    parameter: str,
    inputs: tuple[tuple[int, Array], ...] = (),
    fixes: Array | None = None,
) -> Column:
    e = EFFECTS[effect]
    return Column(effect, sensor, label, axes, e.scale(parameter, sensor), e.unit(parameter, sensor), inputs, fixes)


def fix_columns(
    motion: Motion, t_fix: Array, lever_arm: Array, mounting: Sequence[float] = (0.0, 0.0, 0.0)
) -> list[Column]:
    """Unit columns of the effects on fixes: time offset, clock drift, lever arm (in body axes, of an IMU that sits in them as ``mounting`` says)."""
    v, a, C, omega = _at(motion, t_fix)
    swing = np.einsum("nij,nj->ni", C, np.cross(omega, lever_arm))
    swing_rate = np.gradient(swing, t_fix, axis=0) if t_fix.size > 2 else np.zeros_like(swing)
    moved = np.hstack([v + swing, a + swing_rate])
    out = [_column("imu_gnss_time_offset", "imu", "offset", (), "offset", fixes=moved)]
    late = (t_fix - motion.t[0])[:, None]
    # stamps that run fast: the fixes are ahead by drift (t - t_0), and what is integrated over stretched intervals is too much: velocity in
    # any case, gravity where increments are summed, the whole acceleration and rate where means or samples are
    gravity = np.array([0.0, 0.0, 1.0]) * earth.gravity(motion.llh[:, 0], motion.llh[:, 2])[:, None]
    a_b = np.einsum("nji,nj->ni", motion.C, gravity if motion.summed else motion.f_n + gravity)
    inputs = tuple((3 + i, np.ascontiguousarray(a_b[:, i])) for i in range(3))
    if not motion.summed:
        inputs += tuple((i, np.ascontiguousarray(motion.rate[:, i])) for i in range(3))
    out.append(replace(_column("clock_drift", "imu", "drift", (), "drift", inputs, moved * late), runs=True))
    for i, name in enumerate(_AXES):
        axis = rotation.dcm_from_rpy(np.array(mounting))[i]
        M = np.hstack([C @ axis, np.einsum("nij,nj->ni", C, np.cross(omega, axis))])
        out.append(_column("lever_arm", "gnss", f"value_{name}", (name,), "value", fixes=M))
    return out


def _at(motion: Motion, t: Array) -> tuple[Array, Array, Array, Array]:
    """Velocity, acceleration, attitude and rate with respect to the Earth at the times of the fixes, from the nearest rows."""
    k = np.clip(np.searchsorted(motion.t, t), 1, motion.t.size - 2)
    a = motion.f_n + np.array([0.0, 0.0, 1.0]) * earth.gravity(motion.llh[:, 0], motion.llh[:, 2])[:, None]
    accel = 0.5 * (a[k] + a[k + 1])
    v = motion.vel[k] - accel * (motion.t[k] - t)[:, None]
    w_ie = np.stack(
        [earth.RATE * np.cos(motion.llh[k, 0]), np.zeros(k.size), -earth.RATE * np.sin(motion.llh[k, 0])], axis=1
    )
    omega = 0.5 * (motion.rate[k] + motion.rate[k + 1]) - np.einsum("nji,nj->ni", motion.C[k], w_ie)
    return v, accel, motion.C[k], omega


@dataclass(frozen=True)
class Loop:
    """The nominal filter as a linear machine from sensor errors to whitened innovations.

    Parameters
    ----------
    result : FilterResult
    lower, white : (f, 6, 6) arrays
        Cholesky factors of the innovation covariances and their inverses, zero rows for missing components.
    y : (6 f,) array
        Whitened innovations, zero where missing.
    use : (f, 6) array of bool
    """

    result: FilterResult
    lower: Array
    white: Array
    y: Array
    use: NDArray[np.bool_]

    @classmethod
    def of(cls, result: FilterResult) -> Loop:
        """Whiten the innovations of a stored run."""
        fixes = result.fixes
        f = len(fixes)
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        nu = np.where(use, np.nan_to_num(fixes.innovation), 0.0)
        # missing components get a unit variance of their own and then no row
        S = np.where(use[:, :, None] & use[:, None, :], np.nan_to_num(fixes.S), 0.0)
        S[:, np.arange(6), np.arange(6)] += ~use
        lower = np.linalg.cholesky(S) if f else np.zeros((0, 6, 6))
        white = np.where(use[:, :, None], np.linalg.inv(lower), 0.0)
        return cls(
            result, np.where(use[:, :, None], lower, 0.0), white, np.einsum("kij,kj->ki", white, nu).ravel(), use
        )

    def until(self, count: int) -> Loop:
        """The first ``count`` fixes, for what looks at innovations only."""
        return Loop(self.result, self.lower[:count], self.white[:count], self.y[: 6 * count], self.use[:count])

    def respond(self, columns: int, D: Array | None, M: Array | None) -> Array:
        """Response of the innovations.

        Parameters
        ----------
        columns : int
        D : (nodes, columns, 9) array, optional
            Navigation errors built up since the node before.
        M : (f, 6, columns) array, optional
            Errors of the fixes.

        Returns
        -------
        (f, 6, columns) array
            Zero where a component is missing.
        """
        nodes, fixes = self.result.nodes, self.result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        out, none = np.zeros((len(fixes), 6, columns)), np.zeros((0, 0, 0))
        H = np.where(self.use[:, :, None], np.nan_to_num(fixes.H), 0.0)
        K = np.where(self.use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        kernels.respond(
            nodes.Phi, K, H, np.searchsorted(nodes.epoch, fixes.epoch), self.use, none if D is None else D,
            none if M is None else M, out,
        )  # fmt: skip
        return out

    def whiten(self, raw: Array) -> Array:
        """Whitened responses, (6 f, columns)."""
        return np.asarray((self.white @ raw).reshape(-1, raw.shape[2]))


def columns_response(loop: Loop, motion: Motion, columns: Sequence[Column]) -> tuple[Array, Array]:
    """Responses (f, 6, columns) of unit columns, and the built-up errors of constants and ramps on each axis (for slow processes)."""
    entries = [(j, axis, u) for j, c in enumerate(columns) for axis, u in c.inputs]
    nodes = loop.result.nodes
    assert nodes is not None
    D = np.zeros((nodes.epoch.size, len(columns), 9))
    ramp = np.zeros((nodes.epoch.size, 12, 9))
    u = np.ascontiguousarray(np.stack([e[2] for e in entries])) if entries else np.zeros((0, motion.t.size))
    axis = np.array([e[1] for e in entries], dtype=np.int64)
    column = np.array([e[0] for e in entries], dtype=np.int64)
    kernels.integrate_inputs(
        motion.t, np.ascontiguousarray(motion.C), motion.f_n, nodes.epoch, u, axis, column, D, ramp
    )
    for j, c in enumerate(columns):
        if c.runs:
            way = np.cumsum(motion.vel * np.diff(motion.t, prepend=motion.t[0])[:, None], axis=0)[nodes.epoch]
            D[1:, j, :3] += np.diff(way, axis=0)
    f = len(loop.result.fixes)
    M = np.zeros((f, 6, len(columns)))
    for j, c in enumerate(columns):
        if c.fixes is not None:
            M[:, :, j] = c.fixes
    return loop.respond(len(columns), D, M), ramp


def knot_response(loop: Loop, motion: Motion, ramp: Array, knots: Array) -> Array:
    """Responses of slow sensor errors: linear between knots (s), one column per axis and knot, axis by axis.

    Returns
    -------
    (f, 6, 6 knots) array
    """
    nodes = loop.result.nodes
    assert nodes is not None
    t = motion.t[nodes.epoch]
    hats = np.stack([np.interp(t, knots, row) for row in np.eye(knots.size)], axis=1)  # (nodes, knots)
    D = np.zeros((t.size, 6 * knots.size, 9))
    for axis in range(6):
        block = slice(axis * knots.size, (axis + 1) * knots.size)
        start, rise = hats[:-1], np.diff(hats, axis=0)
        D[1:, block] = start[:, :, None] * ramp[1:, axis, None, :] + rise[:, :, None] * ramp[1:, 6 + axis, None, :]
    return loop.respond(D.shape[1], D, None)


def fix_step_response(loop: Loop, starts: Array) -> Array:
    """Responses (f, 6, 3 starts) of unit steps in the position fixes from each start time on; north, east, down for each start."""
    fixes = loop.result.fixes
    M = np.zeros((len(fixes), 6, 3 * starts.size))
    for i, s in enumerate(starts):
        for c in range(3):
            M[fixes.t > s, c, 3 * i + c] = 1.0
    return loop.respond(3 * starts.size, None, M)
