"""Noise levels of a filter that follow covariates: squared gains, epoch by epoch, before the compiled loop and in it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from insemu import covariates
from insemu.augment import Augmentation
from insemu.noise import LARGEST_LOG_GAIN
from insemu.records import ImuRecord

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Codes of the laws that follow the filter's own speed; every other law is known beforehand.
KNOWN, EXP, POWER = 0, 1, 2


def powers(aug: Augmentation, imu: ImuRecord) -> Array:
    """Squared gains (n, laws) at the rows of an IMU record; 1 in the columns of laws that follow the speed.

    Raises
    ------
    InputError
        A covariate that neither the record nor the filter has.
    """
    if not aug.laws:
        return np.ones((1, 0))
    names = {law.covariate for law in aug.laws}
    known = covariates.of_imu(imu, names)
    covariates.checked(names, {"speed", *known}, "belief")
    columns = [
        np.ones(len(imu)) if law.covariate == "speed" else law.gain(known[law.covariate]) ** 2 for law in aug.laws
    ]
    return np.ascontiguousarray(np.stack(columns, axis=1))


def of_speed(aug: Augmentation) -> Array:
    """For every law (laws, 4): code, slope, covariate of the written level, covariate at which it vanishes."""
    rows = [
        (KNOWN if law.covariate != "speed" else EXP if law.law == "exp" else POWER, law.slope, law.origin, law.above)
        for law in aug.laws
    ]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 4)


def started(aug: Augmentation, P0: Array, imu: ImuRecord, speed: float) -> Array:
    """Initial covariance (m, m) of the augmented states at the first values of the covariates.

    Parameters
    ----------
    aug : Augmentation
    P0 : (m, m) array
        At gain 1.
    imu : ImuRecord
    speed : float
        At the start, m/s.
    """
    if not aug.laws:
        return P0
    first = powers(aug, imu)[0]
    add_speed(first, of_speed(aug), speed)
    gain = np.where(aug.law_of >= 0, np.sqrt(first)[aug.law_of], 1.0)
    return np.asarray(P0 * np.outer(gain, gain))


@njit(cache=True, nogil=True)
def add_speed(power: Array, laws: Array, speed: float) -> None:
    """Multiply squared gains (laws,) by those of the laws that follow the speed; :meth:`insemu.noise.Follows.gain`, squared.

    Parameters
    ----------
    power : (laws,) array
        Changed in place.
    laws : (laws, 4) array
        Of :func:`of_speed`.
    speed : float
        m/s.
    """
    for g in range(power.size):
        code, slope, at, above = laws[g, 0], laws[g, 1], laws[g, 2], laws[g, 3]
        if code == EXP:
            power[g] *= math.exp(2.0 * min(slope * (speed - at), LARGEST_LOG_GAIN))
        elif code == POWER and slope != 0.0:
            if speed > above:
                power[g] *= math.exp(2.0 * min(slope * math.log((speed - above) / (at - above)), LARGEST_LOG_GAIN))
            else:
                power[g] *= 0.0 if slope > 0.0 else math.exp(2.0 * LARGEST_LOG_GAIN)
