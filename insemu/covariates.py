"""What the level of a process may follow, from what an IMU and its vehicle show; causal, so that a filter sees what a fit saw.

``temperature`` (degC) is recorded; ``rate`` (rad/s) and ``force`` (m/s^2) are the lengths of the smoothed angular rate and specific force;
``vibration`` (m/s^2) is the root mean square of the specific force above a quarter of the sampling rate; ``speed`` (m/s) is the vehicle's.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from insemu import units
from insemu.errors import InputError, nearest
from insemu.noise import COVARIATES, NoiseModel
from insemu.records import AXES, ImuRecord, Recording

Array = NDArray[np.float64]

#: Time constant of the first-order filter that rate, specific force and power of vibration pass through, s: faster changes are the noise's own.
SMOOTHING_S = 1.0


def needed(models: Iterable[NoiseModel]) -> set[str]:
    """Names of the covariates that levels of some models follow."""
    return {p.follows.covariate for model in models for p in model if p.follows is not None}


def smoothed(x: Array, dt: float, time: float = SMOOTHING_S) -> Array:
    """First-order causal low-pass along the first axis; it starts from the mean of its first second.

    Parameters
    ----------
    x : (n, k) array
    dt : float
        Sampling interval, s.
    time : float
        Time constant, s.
    """
    from scipy.signal import lfilter

    keep = np.exp(-dt / time)
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


_POWER = re.compile(r"^(.*\S)\s*\^\s*([1-9])$")
_LAG = re.compile(r"^lag\((.*),([^,]*)\)$")


def parts_of(text: str, between: str = ",") -> list[str]:
    """Parts of a text between commas (or another sign) that stand in no brackets; empty ones are left out."""
    depth, parts = 0, [""]
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == between and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return [p.strip() for p in parts if p.strip()]


def regressors_of(text: str, there: Mapping[str, Array], n: int, dt: float, where: str) -> dict[str, Array]:
    """Regressors that are written as ``temperature, temperature^2, lag(temperature, 300 s), time``.

    A lag is a first-order one: what is behind a thermal resistance. Powers are of the deviation from the mean. A product ``table_rate*temperature``
    is the first factor times the deviations of the others: what a scale factor changes by per kelvin on a rate table (Nikolic et al. 2016,
    section IV-D), the coefficient of ``table_rate`` being the scale factor at the mean temperature.

    Parameters
    ----------
    text : str
    there : mapping of str to (n,) array
        What can be named, together with ``time``.
    n : int
        Samples.
    dt : float
        Sampling interval, s.
    where : str
        The option, for messages.

    Returns
    -------
    dict of str to (n,) array

    Raises
    ------
    InputError
        An unknown name, a lag that is no time, one regressor twice, none at all.
    """
    columns = {**there, "time": dt * np.arange(n)}

    def column(term: str) -> Array:
        first, *others = parts_of(term, "*")
        if others:
            return np.asarray(column(first) * np.prod([c - c.mean() for c in map(column, others)], axis=0))
        if found := _LAG.match(term):
            time = units.parse(found[2], "s")
            if time <= 0.0:
                raise InputError(f"found the lag '{found[2].strip()}', expected a time above zero", where=where)
            return smoothed(column(found[1].strip())[:, None], dt, time)[:, 0]
        if found := _POWER.match(term):
            base = column(found[1])
            return np.asarray((base - base.mean()) ** int(found[2]))
        if term not in columns:
            raise InputError(f"no regressor '{term}'" + nearest(term, columns), where=where)
        return np.asarray(columns[term], dtype=np.float64)

    out: dict[str, Array] = {}
    for term in parts_of(text):
        if term in out:
            raise InputError(f"found '{term}' twice", where=where)
        out[term] = column(term)
    if not out:
        raise InputError("found nothing, expected names such as 'temperature, time'", where=where)
    return out
