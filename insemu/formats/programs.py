"""Noise models as other programs take them: Kalibr and OpenVINS, VINS-Fusion, Gazebo, RotorS (PX4), KF-GINS, GTSAM, MATLAB, gnss-ins-sim.

Each of these knows white noise and one slow process per sensor triad: a random walk, or a Gauss-Markov process. The axes are combined by their
root mean square, and every writer states the formula by which the program uses its numbers, so that a model can be read back by simulating it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from insemu.errors import InputError
from insemu.formats.filled import filled
from insemu.noise import NoiseModel, require_constant
from insemu.units import conversion

#: Correlation time that stands for none in programs that want one, s: longer than any mission.
ENDLESS = 1.0e6


@dataclass(frozen=True)
class Triad:
    """What a sensor triad is for these programs, SI.

    Parameters
    ----------
    white : float
        Density N of the white noise, unit/sqrt(Hz) (two-sided).
    sigma, time : float
        Standard deviation and correlation time (s) of the Gauss-Markov process; a random walk K has ``sigma = K sqrt(time / 2)``.
    walk : float
        Density K of the random walk that the slow part is over times well below ``time``, unit sqrt(Hz).
    turn_on : float
        Standard deviation of the turn-on bias.
    """

    white: float
    sigma: float
    time: float
    walk: float
    turn_on: float


def reduce_models(
    models: Mapping[str, NoiseModel], rate_hz: float, record_s: float
) -> tuple[dict[str, Triad], list[str]]:
    """Reduce the models of axes to one white noise and one slow process per sensor.

    Parameters
    ----------
    models : mapping of axis to NoiseModel
        ``gyro_x`` .. ``accel_z``, or ``gyro`` and ``accel``.
    rate_hz : float
        Sampling rate.
    record_s : float
        Length of the record, s: a walk that was not found is written as the largest that such a record hides below its white noise,
        K = sqrt(3) N / T, because these programs divide by it.

    Returns
    -------
    dict of "gyro" and "accel" to Triad, list of str
        What cannot be said in full.

    Raises
    ------
    InputError
        No axis of either sensor; a rate or length that is not positive; a process that follows a covariate.
    """
    if not (rate_hz > 0 and record_s > 0):
        raise InputError(f"the rate is {rate_hz} Hz and the record {record_s} s long, expected positive numbers")
    require_constant(models.values(), "another program")
    out: dict[str, Triad] = {}
    notes: list[str] = []
    for sensor in ("gyro", "accel"):
        axes = [m for name, m in models.items() if name.startswith(sensor)]
        if not axes:
            continue
        parts = [_reduced(m, 1.0 / rate_hz) for m in axes]
        white, walk2, turn_on = (math.sqrt(float(np.mean([p[k] for p in parts]))) for k in (0, 1, 2))
        times = [p[3] for p in parts if p[3]]
        time = float(np.exp(np.mean(np.log(times)))) if times else ENDLESS
        if walk2 == 0.0:
            walk2 = math.sqrt(3.0) * white / record_s
            notes.append(
                f"{sensor}: no slow process; written is the largest walk that {record_s:g} s of its white noise would hide"
            )
        others = sorted({p.symbol for m in axes for p in m} - {"WN", "RW", "GM", "AR1", "RC"})
        if others:
            notes.append(f"{sensor}: {', '.join(others)} enter by what they resemble over a second")
        if any(sum(p.symbol in ("GM", "AR1", "RW") for p in m) > 1 for m in axes):
            notes.append(f"{sensor}: several slow processes become one with the same short-time walk")
        out[sensor] = Triad(white, walk2 * math.sqrt(time / 2.0), time, walk2, turn_on)
    if not out:
        raise InputError("holds no axis of a gyroscope or an accelerometer")
    return out, notes


def _reduced(model: NoiseModel, dt: float) -> tuple[float, float, float, float]:
    """Squares of white density, short-time walk and turn-on bias; correlation time of the strongest Gauss-Markov process (0: none)."""
    white = walk = turn_on = time = strongest = 0.0
    for process in model:
        if process.symbol == "RC":
            turn_on += process.parameters["sigma"] ** 2
            continue
        n2, k2 = process.as_white_and_walk(dt)
        white, walk = white + n2, walk + k2
        if process.symbol in ("GM", "AR1") and k2 > strongest:
            strongest, time = k2, float(process.correlation_time(dt) or 0.0)
    return white, walk, turn_on, time


#: Program -> file of its text in ``texts``.
PROGRAMS: Mapping[str, str] = {
    "kalibr": "kalibr",
    "openvins": "kalibr",
    "vins-fusion": "vins-fusion",
    "gazebo": "gazebo",
    "rotors": "rotors",
    "px4": "rotors",
    "kf-gins": "kf-gins",
    "gtsam": "gtsam",
    "matlab": "matlab",
    "gnss-ins-sim": "gnss-ins-sim",
}


def spelled(program: str, triads: Mapping[str, Triad], rate_hz: float) -> str:
    """What a program reads of the figures of its sensors.

    Parameters
    ----------
    program : str
        A key of :data:`PROGRAMS`.
    triads : mapping of "gyro" and "accel" to Triad
    rate_hz : float
        Sampling rate there.
    """
    return filled(
        f"{PROGRAMS[program]}.txt",
        triads=triads,
        rate=f"{rate_hz:g}",
        root=math.sqrt(rate_hz),
        sqrt=math.sqrt,
        conversion=conversion,
    )
