"""Effects run backwards: what a filter that knows them does to its data before it uses them.

Each effect says how it is removed; this module does so in the order of the signal chain, backwards. Noise has nothing that could be taken
off and is passed over (it belongs in the noise model). A test holds the emulator against it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.effects.aids import aid_corrected
from insemu.effects.base import EffectUse, Stage
from insemu.effects.motion import AntennaMotion, acceleration_along, steady
from insemu.effects.terms import Signals
from insemu.errors import InputError
from insemu.records import ImuRecord, Recording, Trajectory

Array = NDArray[np.float64]

#: The signal is found from what was measured by repeated substitution; the error falls by the effects' size each time.
SUBSTITUTIONS = 6


def lever_arm_of(effects: Sequence[EffectUse], assumed: ArrayLike) -> Array:
    """The assumed lever arm with what the effects say that it lacks, (3,) m in body axes."""
    out = np.array(assumed, dtype=float)
    for use in effects:
        if use.effect.does("arm"):
            out = out + use.effect.arm(use)
    return out


def compensated(
    recording: Recording,
    effects: Sequence[EffectUse],
    *,
    trajectory: Trajectory | Callable[[Recording], Trajectory] | None = None,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
) -> Recording:
    """Take effects off a recording.

    Parameters
    ----------
    recording : Recording
    effects : sequence of EffectUse
        In any order; those of noise and the lever arm (:func:`lever_arm_of`) change nothing here. Lost samples are filled in first: they are
        seen in the rows as they were recorded.
    trajectory : Trajectory or callable, optional
        Estimated motion, for Earth rate, transport rate and gravity; the attitude to a degree is enough. Or how to estimate it: a function of
        the recording less everything else, which is called where an effect needs it.
    lever_arm : (3,) array
        From the IMU to the antenna in body axes, m, for effects along the way of the antenna.

    Raises
    ------
    InputError
        A temperature effect without a recorded temperature, or an effect of attitude without a trajectory.
    """
    if callable(trajectory):
        rest = [use for use in effects if not use.effect.needs_trajectory]
        trajectory = trajectory(compensated(recording, rest)) if len(rest) < len(effects) else None
    imu, gnss = recording.imu, recording.gnss
    for use in effects:
        if use.effect.does("restored"):
            imu = use.effect.restored(use, imu)
    inertial = [use for use in effects if use.inertial and use.effect.compensable and not use.effect.does("restored")]
    if inertial:
        imu = _imu(imu, inertial, trajectory)
    for use in sorted((use for use in effects if use.sensor == "gnss"), key=_place):
        if gnss is not None and use.effect.does("corrected_fixes"):
            gnss = use.effect.corrected_fixes(use, gnss)
    along = [use for use in effects if use.effect.does("corrected_along")]
    if along and gnss is not None:
        way = _way(imu, _given(trajectory, along[0]), lever_arm)
        for use in along:
            gnss = use.effect.corrected_along(use, gnss, way)
    aids = tuple(aid_corrected(aid, effects, float(recording.imu.t[0])) for aid in recording.aids)
    return replace(recording, imu=imu, gnss=gnss, aids=aids)


def _given(trajectory: Trajectory | None, use: EffectUse) -> Trajectory:
    if trajectory is None:
        raise InputError(f"the effect '{use.id}' is removed along a trajectory, and none is given")
    return trajectory


def _way(imu: ImuRecord, trajectory: Trajectory, lever_arm: ArrayLike) -> AntennaMotion:
    """The motion of the antenna, from what was measured and a trajectory's attitude."""
    inside = (imu.t >= trajectory.t[0]) & (imu.t <= trajectory.t[-1])
    t, width = imu.t[inside], imu.widths(0.0)[inside]
    rows = np.clip(np.searchsorted(trajectory.t, t - 0.5 * imu.dt), 0, len(trajectory) - 1)
    C, llh = rotation.dcm_from_rpy(trajectory.rpy[rows]), trajectory.llh[rows]
    a = np.einsum("nij,nj->ni", C, imu.accel[inside] / width)
    a[:, 2] += earth.gravity(llh[:, 0], llh[:, 2])
    vel = np.column_stack([np.interp(t, trajectory.t, v) for v in trajectory.vel_ned.T])
    rate = steady(imu.gyro[inside] / width, imu.dt)
    return AntennaMotion(t, C, rate, acceleration_along(t, a, vel), np.asarray(lever_arm, dtype=float), vel)


def _place(use: EffectUse) -> Stage:
    assert use.effect.stage is not None
    return use.effect.stage


def columns_without(values: Array, t: Array, effects: Sequence[EffectUse], temperature: Array | None) -> Array:
    """Take effects off six columns of rates and forces, which needs no knowledge of the motion.

    Parameters
    ----------
    values : (n, 6) array
        rad/s and m/s^2.
    t : (n,) array
        s.
    effects : sequence of EffectUse
    temperature : (n,) array, optional
        degC.
    """
    out = np.array(values, dtype=float)
    for sensor, at in (("gyro", slice(0, 3)), ("accel", slice(3, 6))):
        out[:, at] -= added_signal([use for use in effects if use.sensor == sensor], t, temperature)
    return _solved(out, effects, temperature, t)


def _imu(imu: ImuRecord, effects: Sequence[EffectUse], trajectory: Trajectory | None) -> ImuRecord:
    t = imu.t
    step = imu.widths(0.0)
    out = columns_without(np.hstack([imu.gyro, imu.accel]) / step, t, effects, imu.temperature)
    rate, force = out[:, :3], out[:, 3:]
    for use in effects:
        if use.effect.does("turn"):
            C = use.effect.turn(use)
            rate, force = rate @ C.T, force @ C.T
    for use in sorted((use for use in effects if use.effect.does("true_time")), key=_place, reverse=True):
        t = use.effect.true_time(use, t)
    models = [use for use in effects if use.effect.does("omitted")]
    if models:
        trajectory = _given(trajectory, models[0])
        rows = np.clip(np.searchsorted(trajectory.t, t), 0, len(trajectory) - 1)
        signals = Signals(t, rate=rate, force=force, temperature=imu.temperature)
        for use in models:
            of_rate, of_force = use.effect.omitted(use, trajectory, rows, signals)
            rate = rate if of_rate is None else rate + of_rate
            force = force if of_force is None else force + of_force
    return replace(imu, t=t, gyro=rate * step, accel=force * step)


def added_signal(effects: Sequence[EffectUse], t: Array, temperature: Array | None) -> Array:
    """What the effects add whatever the signal, (n, 3).

    Parameters
    ----------
    effects : sequence of EffectUse
        Of one sensor.
    t : (n,) array
        s.
    temperature : (n,) array, optional
        degC.
    """
    out = np.zeros((t.size, 3))
    for use in effects:
        if use.effect.does("added"):
            out += use.effect.added(use, t, temperature)
    return out


def _solved(measured: Array, effects: Sequence[EffectUse], temperature: Array | None, t: Array) -> Array:
    """The rates and forces (n, 6) of which the effects that depend on them make what was measured."""
    linear = [use.effect.matrix(use) for use in effects if use.effect.does("matrix")]
    bent = [use for use in effects if use.effect.does("bent")]
    if not linear and not bent:
        return measured
    back = np.linalg.inv(np.eye(6) + sum(linear, np.zeros((6, 6)))).T
    s = measured @ back
    for _ in range(SUBSTITUTIONS if bent else 0):
        error = np.zeros_like(s)
        for use in bent:
            error += use.effect.bent(use, s, temperature, t)
        s = (measured - error) @ back
    return np.asarray(s)
