"""The table of effects run backwards: what a filter that knows an effect does to its data before it uses them.

A deterministic, timing or GNSS effect with numbers is taken off a recording; noise has nothing that could be taken off and is passed over
(it belongs in the noise model). :mod:`insemu.emulate.sensor` is the same table forwards; a test holds the two against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.effects import CROSS, EffectUse
from insemu.errors import InputError
from insemu.records import GnssRecord, ImuRecord, Recording, Trajectory

Array = NDArray[np.float64]

#: Effects that depend on where the vehicle is and how it stands.
NEEDS_TRAJECTORY = frozenset({"earth_rate", "transport_rate", "gravity"})
#: Effects whose numbers can be taken off the data.
COMPENSABLE = NEEDS_TRAJECTORY | {
    "mounting",
    "scale_factor",
    "scale_asymmetry",
    "scale_nonlinearity",
    "misalignment",
    "g_sensitivity",
    "turn_on_bias",
    "temperature",
    "ramp",
    "imu_gnss_time_offset",
    "clock_drift",
    "gnss_latency",
    "gnss_noise_level",
    "gnss_velocity_noise",
    "gnss_multipath_step",
    "lever_arm",
}
#: The signal is found from what was measured by repeated substitution; the error falls by the effects' size each time.
SUBSTITUTIONS = 6


def lever_arm_of(effects: Sequence[EffectUse], assumed: ArrayLike) -> Array:
    """The assumed lever arm with what the effects say that it lacks, (3,) m in body axes."""
    return np.asarray(assumed, dtype=float) + sum(
        (np.array(use["value"]) for use in effects if use.id == "lever_arm"), np.zeros(3)
    )


def compensated(
    recording: Recording, effects: Sequence[EffectUse], *, trajectory: Trajectory | None = None
) -> Recording:
    """Take effects off a recording.

    Parameters
    ----------
    recording : Recording
    effects : sequence of EffectUse
        In any order; those of noise and the lever arm (:func:`lever_arm_of`) change nothing here.
    trajectory : Trajectory, optional
        Estimated motion, for Earth rate, transport rate and gravity; the attitude to a degree is enough.

    Raises
    ------
    InputError
        A temperature effect without a recorded temperature, or an effect of attitude without a trajectory.
    """
    imu, gnss = recording.imu, recording.gnss
    inertial = [use for use in effects if use.sensor != "gnss" and use.id in COMPENSABLE]
    if inertial:
        imu = _imu(imu, inertial, trajectory)
    own = [use for use in effects if use.sensor == "gnss"]
    if gnss is not None and own:
        gnss = _gnss(gnss, own)
    return replace(recording, imu=imu, gnss=gnss)


def columns_without(values: Array, t: Array, effects: Sequence[EffectUse], temperature: Array | None) -> Array:
    """Take effects off six columns of rates and forces (n, 6), which need no knowledge of the motion; see :func:`compensated`."""
    out = np.array(values, dtype=float)
    for sensor, at in (("gyro", slice(0, 3)), ("accel", slice(3, 6))):
        out[:, at] -= added_signal([use for use in effects if use.sensor == sensor], t, temperature)
    force = _solved(out[:, 3:], [use for use in effects if use.sensor == "accel"])
    sensitivity = sum(
        (np.array(use["value"]).reshape(3, 3) for use in effects if use.id == "g_sensitivity"), np.zeros((3, 3))
    )
    rate = _solved(out[:, :3] - force @ sensitivity.T, [use for use in effects if use.sensor == "gyro"])
    return np.hstack([rate, force])


def _imu(imu: ImuRecord, effects: Sequence[EffectUse], trajectory: Trajectory | None) -> ImuRecord:
    t = imu.t
    step = np.diff(t, prepend=2 * t[0] - t[1])[:, None] if imu.kind == "increment" else np.ones((t.size, 1))
    out = columns_without(np.hstack([imu.gyro, imu.accel]) / step, t, effects, imu.temperature)
    rate, force = out[:, :3], out[:, 3:]
    for use in effects:
        if use.id == "mounting":
            C = rotation.dcm_from_rpy(np.array(use["rpy"]))
            rate, force = rate @ C.T, force @ C.T
    drift = sum(use.scalar("drift") for use in effects if use.id == "clock_drift")
    offset = sum(use.scalar("offset") for use in effects if use.id == "imu_gnss_time_offset")
    start = t[0] - offset
    t = start + (t - offset - start) / (1.0 + drift)
    models = [use for use in effects if use.id in NEEDS_TRAJECTORY]
    if models:
        if trajectory is None:
            raise InputError(f"the effect '{models[0].id}' is taken off along a trajectory, and none is given")
        k = np.clip(np.searchsorted(trajectory.t, t), 0, len(trajectory) - 1)
        C = rotation.dcm_from_rpy(trajectory.rpy)[k]
        llh, vel = trajectory.llh[k], trajectory.vel_ned[k]
        for use in models:
            if use.id == "gravity":
                force = force + use.scalar("offset") * C[:, 2, :]
            else:
                w_n = earth.earth_rate(llh[:, 0]) if use.id == "earth_rate" else earth.transport_rate(llh, vel)
                rate = rate + use.scalar("fraction") * np.einsum("nji,nj->ni", C, w_n)
    return replace(imu, t=t, gyro=rate * step, accel=force * step)


def added_signal(effects: Sequence[EffectUse], t: Array, temperature: Array | None) -> Array:
    """What the effects add whatever the signal, (n, 3)."""
    out = np.zeros((t.size, 3))
    for use in effects:
        if use.id == "turn_on_bias":
            out += np.array(use["value"])
        elif use.id == "ramp":
            out += (t - 2 * t[0] + t[1])[:, None] * np.array(use["R"])
        elif use.id == "temperature":
            if temperature is None:
                raise InputError("the effect 'temperature' needs the temperature of the data; none was recorded")
            d = lagged(temperature, float(np.median(np.diff(t))), use.scalar("lag"))[:, None] - use.scalar("T0")
            out += ((np.array(use["c3"]) * d + np.array(use["c2"])) * d + np.array(use["c1"])) * d
    return out


def lagged(temperature: Array, dt: float, lag_s: float) -> Array:
    """First-order lag of a sampled temperature that starts settled."""
    if lag_s <= 0.0:
        return temperature
    from scipy.signal import lfilter

    phi = float(np.exp(-dt / lag_s))
    # straight lines between the samples
    now = 1.0 - lag_s / dt * (1.0 - phi)
    start = temperature[:1] * (1.0 - now)
    return np.asarray(lfilter([now, 1.0 - phi - now], [1.0, -phi], temperature, zi=start)[0])


def _solved(measured: Array, effects: Sequence[EffectUse]) -> Array:
    """The signal of which the effects that depend on it make what was measured, (n, 3)."""
    matrix = np.zeros((3, 3))
    bent: list[EffectUse] = []
    for use in effects:
        if use.id == "scale_factor":
            matrix += np.diag(use["value"])
        elif use.id == "misalignment":
            for pair, value in zip(CROSS, use["value"], strict=True):
                matrix["xyz".index(pair[0]), "xyz".index(pair[1])] += value
        elif use.id in ("scale_asymmetry", "scale_nonlinearity"):
            bent.append(use)
    back = np.linalg.inv(np.eye(3) + matrix).T
    s = measured @ back
    for _ in range(SUBSTITUTIONS if bent else 0):
        error = np.zeros_like(s)
        for use in bent:
            if use.id == "scale_asymmetry":
                error += np.array(use["value"]) * np.abs(s)
            else:
                error += (np.array(use["K2"]) + np.array(use["K3"]) * s) * s * s
        s = (measured - error) @ back
    return s


def _gnss(gnss: GnssRecord, effects: Sequence[EffectUse]) -> GnssRecord:
    out = gnss
    for use in effects:
        if use.id == "gnss_noise_level" and out.pos_std_ned is not None:
            out = replace(out, pos_std_ned=out.pos_std_ned * np.array(use["factor"]))
        elif use.id == "gnss_velocity_noise" and out.vel_std_ned is not None:
            std = np.hypot(out.vel_std_ned * np.array(use["factor"]), np.array(use["sigma"]))
            out = replace(out, vel_std_ned=std)
        elif use.id == "gnss_multipath_step":
            start = use.scalar("start")
            inside = (out.t > start + 1e-6) & (out.t <= start + use.scalar("duration") + 1e-6)
            moved = earth.move(out.llh, inside[:, None] * -np.array(use["value"]))
            out = replace(out, llh=np.where(inside[:, None], moved, out.llh))
        elif use.id == "gnss_latency":
            out = replace(out, t=out.t - use.scalar("latency"))
    return out
