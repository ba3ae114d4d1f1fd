"""The one form of every measurement: at one moment, rows of measured minus predicted values, their Jacobian and their noise.

A fix and every aid is a compiled function ``fill(moment, z, settings, rows)``. A filter family (:mod:`insemu.filters.families`) is a way to carry
state and covariance that asks for these rows wherever it needs them: once at its estimate, again after an iteration, or at each of its sigma
points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Moment(NamedTuple):
    """What a filter knows at the epoch at which a measurement is used.

    Parameters
    ----------
    nav, nav_before : (13,) arrays
        State at this epoch and at the one before, ``dt`` seconds earlier (:func:`insemu.strapdown.step`).
    dt, tau : float
        s; the measurement was valid ``tau`` seconds before this epoch. An aid is less than ``dt`` old.
    rate, rate_before : (3,) arrays
        Corrected mean angular rates over the last two steps, body axes, rad/s.
    mean_rate, samples : (3,) array, int
        Corrected angular rate averaged since ``AidRecord.since``, rad/s, and over how many samples.
    white : (6,) array
        Variances of the axes' white noise per sample, (rad/s)^2 and (m/s^2)^2.
    c_of, axis : (m,) arrays
        How strongly each augmented state is seen, and by what axis.
    lever : (3,) array
        From IMU to antenna, m, body axes.
    lever_at, latency_at : int
        First lever-arm state and latency state among all states, -1 where they are not carried.
    clock : (2,) array
        Bias and drift of the receiver's clock, m and m/s; zero where they are not carried.
    clock_at : int
        Place of the bias among all states, -1 where it is not carried; the drift stands behind it.
    trend : (12,) array
        See :func:`insemu.filters.measurements.fill_trend` (where the latency is a state) and :func:`insemu.filters.measurements.fill_rate`.
    """

    nav: Array
    nav_before: Array
    dt: float
    tau: float
    rate: Array
    rate_before: Array
    mean_rate: Array
    samples: int
    white: Array
    c_of: Array
    axis: Ints
    lever: Array
    lever_at: int
    latency_at: int
    clock: Array
    clock_at: int
    trend: Array


class Rows(NamedTuple):
    """Rows of a measurement, overwritten by what fills them; w may be more than a kind of measurement has.

    Parameters
    ----------
    nu : (w,) array
        Measured minus predicted.
    H : (w, n) array
        Derivative of the predicted values by the errors of the states (estimate minus truth).
    R : (w, w) array
        What noise of the samples adds; variances of the measured values are added afterwards.
    """

    nu: Array
    H: Array
    R: Array
