"""What the level of a process may follow, from what an IMU and its vehicle show; causal, so that a filter sees what a fit saw.

``temperature`` (degC) is recorded; ``rate`` (rad/s) and ``force`` (m/s^2) are the lengths of the smoothed angular rate and specific force;
``vibration`` (m/s^2) is the root mean square of the specific force above a quarter of the sampling rate; ``speed`` (m/s) is the vehicle's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from insemu.errors import InputError
from insemu.noise import COVARIATES, NoiseModel
from insemu.records import AXES, ImuRecord, Recording

Array = NDArray[np.float64]

#: Time constant of the first-order filter that rate, specific force and power of vibration pass through, s: faster changes are the noise's own.
SMOOTHING_S = 1.0


def needed(models: Iterable[NoiseModel]) -> set[str]:
    """Names of the covariates that levels of some models follow."""
    return {p.follows.covariate for model in models for p in model if p.follows is not None}


def smoothed(x: Array, dt: float) -> Array:
    """First-order causal low-pass of :data:`SMOOTHING_S` along the first axis; it starts from the mean of its first second.

    Parameters
    ----------
    x : (n, k) array
    dt : float
        Sampling interval, s.
    """
    keep = np.exp(-dt / SMOOTHING_S)
    start = x[: max(1, round(SMOOTHING_S / dt))].mean(axis=0, keepdims=True)
    out, _ = lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=keep * start)
    return np.asarray(out)


def of_rates(rates: Array, dt: float) -> dict[str, Array]:
    """Rate, force and vibration of an IMU.

    Parameters
    ----------
    rates : (n, 6) array
        Angular rate (rad/s) and specific force (m/s^2).
    dt : float
        Sampling interval, s.

    Returns
    -------
    dict of str to (n,) array
    """
    rate, force = (np.linalg.norm(smoothed(part, dt), axis=1) for part in (rates[:, :3], rates[:, 3:]))
    step = np.diff(rates[:, 3:], axis=0, prepend=rates[:1, 3:])
    power = smoothed(0.5 * (step * step).mean(axis=1, keepdims=True), dt)[:, 0]
    return {"rate": rate, "force": force, "vibration": np.sqrt(np.maximum(power, 0.0))}


def of_imu(imu: ImuRecord, names: Collection[str] = tuple(COVARIATES)) -> dict[str, Array]:
    """The covariates that an IMU record itself holds, of those that are asked for.

    Parameters
    ----------
    imu : ImuRecord
        Of any kind.
    names : collection of str
        Those that are wanted.
    """
    out = {}
    if {"rate", "force", "vibration"} & set(names):
        out = {k: v for k, v in of_rates(imu.rates(), imu.dt).items() if k in names}
    if "temperature" in names and imu.temperature is not None:
        out["temperature"] = np.asarray(imu.temperature)
    return out


def of_recording(recording: Recording) -> dict[str, Array]:
    """The covariates of a recording at the rows of its IMU; the speed is that of the reference, or of the fixes."""
    out = of_imu(recording.imu)
    for motion in (recording.reference, recording.gnss):
        if motion is None or motion.vel_ned is None:
            continue
        speed = np.linalg.norm(motion.vel_ned, axis=1)
        known = np.isfinite(speed)
        if known.any():
            out["speed"] = np.interp(recording.imu.t, motion.t[known], speed[known])
            break
    return out


def of_columns(columns: dict[str, Array], dt: float) -> dict[str, Array]:
    """The covariates of a log: its columns that are no axis, and what all six axes show.

    Parameters
    ----------
    columns : mapping of str to (n,) array
        By name of axis or column, SI.
    dt : float
        Sampling interval, s.
    """
    out = {name: x for name, x in columns.items() if name not in AXES}
    if all(axis in columns for axis in AXES):
        out = of_rates(np.column_stack([columns[axis] for axis in AXES]), dt) | out
    return out


def checked(names: Collection[str], there: Collection[str], where: str) -> None:
    """Raise ``InputError`` where a covariate is not there.

    Parameters
    ----------
    names : collection of str
        What levels follow.
    there : collection of str
        What is known.
    where : str
        Who does not know it.
    """
    missing = sorted(set(names) - set(there))
    if missing:
        raise InputError(f"no covariate '{missing[0]}', there are: {', '.join(sorted(there)) or 'none'}", where=where)
