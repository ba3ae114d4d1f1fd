"""Compiled passes of the sensor chain: each reads and writes rows of the (6, n) signal in place and needs no temporary arrays.

At tens of megabytes per temporary, an interpreted chain spends a quarter of its time on fresh pages, and 3 x 3 products of such rows
go to a threaded library whose threads wait longer than they work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def load(gyro: Array, accel: Array, step: Array, signal: Array) -> None:
    """Records to rows, divided by the intervals.

    Parameters
    ----------
    gyro, accel : (n, 3) arrays
    step : (n,) array
        s; empty where nothing is divided.
    signal : (6, n) array
        Overwritten.
    """
    for k in range(gyro.shape[0]):
        for i in range(3):
            signal[i, k], signal[3 + i, k] = gyro[k, i], accel[k, i]
    if step.size:
        for i in range(6):
            for k in range(step.size):
                signal[i, k] /= step[k]


@njit(cache=True, nogil=True)
def unload(signal: Array, step: Array, kept: NDArray[np.int64], gyro: Array, accel: Array) -> None:
    """Samples of the rows back to records, times the intervals.

    Parameters
    ----------
    signal : (6, n) array
    step : (n,) array
        s; empty where nothing is multiplied.
    kept : (m,) array of int
    gyro, accel : (m, 3) arrays
        Overwritten.
    """
    for m in range(kept.size):
        k = kept[m]
        factor = step[k] if step.size else 1.0
        for i in range(3):
            gyro[m, i], accel[m, i] = signal[i, k] * factor, signal[3 + i, k] * factor


@njit(cache=True, nogil=True)
def sine_cosine(t: float) -> tuple[float, float]:
    """Sine and cosine of the angle whose half has the tangent ``t``: numpy takes many tangents at once, and sines one by one."""
    scale = 1.0 / (1.0 + t * t)
    return 2.0 * t * scale, (1.0 - t * t) * scale


@njit(cache=True, nogil=True)
def leave_out(
    signal: Array, half: Array, height: Array, vel_ned: Array, earth_share: float, transport_share: float, offset: float
) -> None:
    """Subtract shares of the Earth rate and the transport rate, and the acceleration (0, 0, offset), turned into body axes.

    Parameters
    ----------
    signal : (6, n) array
        In place, rad/s and m/s^2.
    half : (4, n) array
        Tangents of half of roll, pitch, heading and latitude.
    height, vel_ned : (n,) and (n, 3) arrays
        m and m/s.
    earth_share, transport_share, offset : float
        1 subtracts all of a rate; m/s^2.
    """
    for k in range(signal.shape[1]):
        sr, cr = sine_cosine(half[0, k])
        sp, cp = sine_cosine(half[1, k])
        sh, ch = sine_cosine(half[2, k])
        sl, cl = sine_cosine(half[3, k])
        rm, rn = earth.scalar_radii(sl)
        east = transport_share * vel_ned[k, 1] / (rn + height[k])
        north = earth_share * earth.RATE
        w0 = north * cl + east
        w1 = -transport_share * vel_ned[k, 0] / (rm + height[k])
        w2 = -north * sl - east * sl / cl
        # the rows of C_bn
        signal[0, k] -= ch * cp * w0 + sh * cp * w1 - sp * w2
        signal[1, k] -= (ch * sp * sr - sh * cr) * w0 + (sh * sp * sr + ch * cr) * w1 + cp * sr * w2
        signal[2, k] -= (ch * sp * cr + sh * sr) * w0 + (sh * sp * cr - ch * sr) * w1 + cp * cr * w2
        signal[3, k] += sp * offset
        signal[4, k] -= cp * sr * offset
        signal[5, k] -= cp * cr * offset


class ResponseArrays(NamedTuple):
    """What a sensor makes of the true signal, as arrays.

    Parameters
    ----------
    mounting : (3, 3) array
    matrix : (6, 6) array
        Scale factors, misalignments, g-sensitivities.
    asymmetry, square, cube, offset : (6,) arrays
    places, factors : (m, 3) and (m,) arrays
        Products of two signals.
    warm_places, warm_factors, levels : (m, 3), (m,) and (q, n) arrays
        Factors that change with time.
    """

    mounting: Array
    matrix: Array
    asymmetry: Array
    square: Array
    cube: Array
    offset: Array
    places: NDArray[np.int64]
    factors: Array
    warm_places: NDArray[np.int64]
    warm_factors: Array
    levels: Array


@njit(cache=True, nogil=True)
def respond(signal: Array, of: ResponseArrays) -> None:
    """Functions of the true signal, all of the same true signal.

    ``x = mounting s`` for the gyroscopes and the accelerometers, then ``y = x + matrix x + asymmetry |x| + square x^2 + cube x^3 + offset``,
    plus ``factors[m] x[j] x[k]`` on axis i for every ``(i, j, k)`` in ``places``,
    plus ``warm_factors[m] levels[q] x[j]`` on axis i for every ``(i, j, q)`` in ``warm_places``.

    Parameters
    ----------
    signal : (6, n) array
        In place.
    of : ResponseArrays
    """
    mounting, matrix, asymmetry, square, cube, offset, places, factors, warm_places, warm_factors, levels = of
    x = np.empty(6)
    for k in range(signal.shape[1]):
        for i in range(3):
            x[i] = mounting[i, 0] * signal[0, k] + mounting[i, 1] * signal[1, k] + mounting[i, 2] * signal[2, k]
            x[3 + i] = mounting[i, 0] * signal[3, k] + mounting[i, 1] * signal[4, k] + mounting[i, 2] * signal[5, k]
        for i in range(6):
            v = x[i]
            total = asymmetry[i] * abs(v) + (square[i] + cube[i] * v) * v * v + offset[i]
            for j in range(6):
                total += matrix[i, j] * x[j]
            signal[i, k] = v + total
        for m in range(factors.size):
            signal[places[m, 0], k] += factors[m] * x[places[m, 1]] * x[places[m, 2]]
        for m in range(warm_factors.size):
            signal[warm_places[m, 0], k] += warm_factors[m] * levels[warm_places[m, 2], k] * x[warm_places[m, 1]]


@njit(cache=True, nogil=True)
def add_scaled(row: Array, x: Array, factor: float) -> None:
    """``row += factor x``.

    Parameters
    ----------
    row, x : (n,) arrays
    factor : float
    """
    for k in range(row.size):
        row[k] += factor * x[k]


@njit(cache=True, nogil=True)
def add_product(row: Array, x: Array, level: Array, factor: float) -> None:
    """``row += factor level x``.

    Parameters
    ----------
    row, x, level : (n,) arrays
    factor : float
    """
    for k in range(row.size):
        row[k] += factor * (level[k] * x[k])


@njit(cache=True, nogil=True)
def add_cubic(row: Array, d: Array, c1: float, c2: float, c3: float) -> None:
    """``row += c1 d + c2 d^2 + c3 d^3``.

    Parameters
    ----------
    row, d : (n,) arrays
    c1, c2, c3 : float
    """
    for k in range(row.size):
        row[k] += ((c3 * d[k] + c2) * d[k] + c1) * d[k]


@njit(cache=True, nogil=True)
def speeds(vel_ned: Array, out: Array) -> None:
    """Lengths (n,) of velocities (n, 3)."""
    for k in range(out.size):
        out[k] = math.sqrt(vel_ned[k, 0] ** 2 + vel_ned[k, 1] ** 2 + vel_ned[k, 2] ** 2)


@njit(cache=True, nogil=True)
def motion_profile(speed: Array, rest: float, out: Array) -> None:
    """From ``rest`` at standstill to 1 above 5 m/s, smooth in between.

    Parameters
    ----------
    speed : (n,) array
        m/s.
    rest : float
    out : (n,) array
    """
    for k in range(out.size):
        u = min(speed[k] / 5.0, 1.0)
        out[k] = rest + (1.0 - rest) * u * u * (3.0 - 2.0 * u)


@njit(cache=True, nogil=True)
def half_angle(t: Array, frequency: float, phase: float, out: Array) -> None:
    """Half of ``2 pi f (t - t_0) + phase``.

    Parameters
    ----------
    t : (n,) array
        s.
    frequency, phase : float
        Hz and rad.
    out : (n,) array
        rad.
    """
    for k in range(out.size):
        out[k] = 0.5 * (2.0 * math.pi * frequency * (t[k] - t[0]) + phase)


@njit(cache=True, nogil=True)
def sines(half: Array) -> None:
    """Tangents (n,) of half angles to sines, in place."""
    for k in range(half.size):
        half[k] = sine_cosine(half[k])[0]


@njit(cache=True, nogil=True)
def add_outliers(row: Array, probability: float, sigma: float, rng: np.random.Generator) -> None:
    """Add normal numbers at a share of the samples: first every sample's lot, then the sizes.

    Parameters
    ----------
    row : (n,) array
    probability, sigma : float
    rng : Generator
    """
    hit = np.empty(row.size, np.int64)
    count = 0
    for k in range(row.size):
        if rng.random() < probability:
            hit[count] = k
            count += 1
    for m in range(count):
        row[hit[m]] += sigma * rng.standard_normal()


@njit(cache=True, nogil=True)
def add_telegraph(row: Array, probability: float, amplitude: float, rng: np.random.Generator) -> None:
    """Add +-amplitude that switches with this probability before every sample: first every switch, then the sign at the start.

    Parameters
    ----------
    row : (n,) array
    probability, amplitude : float
    rng : Generator
    """
    switch = np.empty(row.size, np.bool_)
    for k in range(row.size):
        switch[k] = rng.random() < probability
    level = amplitude if rng.random() < 0.5 else -amplitude
    for k in range(row.size):
        if switch[k]:
            level = -level
        row[k] += level
