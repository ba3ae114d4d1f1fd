"""Noise levels and correlation times of a filter that follow covariates: squared gains, epoch by epoch, before the compiled loop and in it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu import covariates
from insemu.augment import Augmentation
from insemu.compiled import njit
from insemu.lanes import between, where
from insemu.noise import LARGEST_LOG_GAIN, LARGEST_LOG_TIME
from insemu.records import ImuRecord

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Codes of the laws that follow the filter's own speed; every other law is known beforehand.
KNOWN, EXP, POWER = 0, 1, 2
#: Nodes of the logarithm of the gain of correlation times: what lies between two is off by 5e-5 of 1 - phi at most.
NODES, FIRST_NODE, STEP_NODE = 601, -LARGEST_LOG_TIME, LARGEST_LOG_TIME / 300


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


def started(aug: Augmentation, imu: ImuRecord, speed: float) -> Array:
    """Initial covariance (m, m) of the augmented states at the first values of the covariates.

    Parameters
    ----------
    aug : Augmentation
    imu : ImuRecord
    speed : float
        At the start, m/s.
    """
    if not aug.laws:
        return aug.P0
    first = powers(aug, imu)[0]
    add_speed(first, of_speed(aug), speed)
    return aug.started(np.sqrt(first))


def tables(aug: Augmentation, powers: int) -> list[tuple[int, int, Array, Array]]:
    """First state, law, transition and driving covariance of what has correlation times that follow, at the nodes of the gain.

    The two matrices are (powers, nodes, k, k): over 1 to ``powers`` samples at one gain.
    """
    factor = np.exp(FIRST_NODE + STEP_NODE * np.arange(NODES))
    out = []
    for one in aug.timed:
        F, drive, scale = one.process.timed(factor, aug.dt)
        V = (scale**2)[:, None, None] * np.outer(drive, drive)
        Phi, Q = np.empty((2, powers, *F.shape))
        Phi[0], Q[0] = F, V
        for p in range(1, powers):
            Phi[p] = F @ Phi[p - 1]
            Q[p] = F @ Q[p - 1] @ F.transpose(0, 2, 1) + V
        out.append((one.first, one.law, Phi, Q))
    return out


@njit(cache=True, nogil=True)
def take_times(out: Array, at: Ints, law: Ints, table: Array, power: Array) -> None:
    """Write entries of matrices that follow a correlation time, linear between the nodes of the logarithm of its gain.

    Parameters
    ----------
    out : (w,) array
        Matrices one after the other, changed in place.
    at, law : (v,) arrays of int
        Place and law of each entry that follows.
    table : (nodes, v) array
        Their values at the nodes.
    power : (laws,) array
        Squared gains.
    """
    for v in range(at.size):
        x = (0.5 * math.log(max(power[law[v]], 1e-30)) - FIRST_NODE) / STEP_NODE
        out[at[v]] = between(table[:, v], min(max(x, 0.0), NODES - 1.0))


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
            ratio = where(speed > above, (speed - above) / (at - above), 1.0)
            gain = math.exp(2.0 * min(slope * math.log(ratio), LARGEST_LOG_GAIN))
            power[g] *= where(speed > above, gain, 0.0 if slope > 0.0 else math.exp(2.0 * LARGEST_LOG_GAIN))
