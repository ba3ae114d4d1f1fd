"""Records and start of a drive with effects taken out, as their columns say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import EFFECTS, Column, EffectUse
from insemu.gap.drive.preparation import Prepared
from insemu.gap.drive.shaking import velocity_missed
from insemu.gap.evidence.linear import knot_times
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]
#: Knots of slow processes: at least so far apart, s, and about so many in a long recording; between them a process is a straight line.
KNOT_S, KNOTS = 10.0, 60


def slow_knots(start: float, end: float) -> Array:
    """Times of the knots of slow errors in a recording from ``start`` to ``end``, s."""
    return knot_times(start, end, max(KNOT_S, (end - start) / KNOTS))


def corrected_data(
    prepared: Prepared, columns: Sequence[Column], values: Mapping[int, float], t_fix: Array
) -> tuple[ImuRecord, GnssRecord, NavState]:
    """The records and the start with effects taken out, each as its column says.

    Parameters
    ----------
    prepared : Prepared
        With the records as they were measured.
    columns : sequence of Column
        Unit errors of the sensors and of the fixes.
    values : mapping of int to float
        Coefficient of each column that is taken out; behind the columns stand the knots of slow errors, axis by axis.
    t_fix : (f,) array
        Times of the fixes that the columns are about, s.
    """
    imu, gnss, state = prepared.imu, prepared.gnss, prepared.start[0]
    if not values:
        return imu, gnss, state
    began = float(imu.t[0]) if prepared.began is None else prepared.began
    stamps, timed = np.concatenate([[began], imu.t]), False
    width = imu.widths(0.0)[:, 0]
    signals = np.hstack([imu.gyro, imu.accel])
    shift = np.zeros((len(gnss), 6))
    at = np.searchsorted(gnss.t, t_fix)
    knots = slow_knots(float(imu.t[0]), float(imu.t[-1]))
    slow = np.zeros((6, knots.size))
    for j, value in values.items():
        if j >= len(columns):
            slow.ravel()[j - len(columns)] = value
            continue
        for axis, u in columns[j].inputs:
            signals[:, axis] -= value * u * width
        moved, effect = columns[j].fixes, EFFECTS.get(columns[j].effect)
        if effect is not None and effect.does("true_time"):
            # of a large one the fixes are not only ahead by velocity and acceleration
            use = EffectUse.from_mapping({"effect": effect.id, "sensor": columns[j].sensor, columns[j].label: value})
            stamps, timed = effect.true_time(use, stamps), True
        elif moved is not None:
            shift[at] -= value * moved
        begun = columns[j].start
        if begun is not None:
            llh, vel = earth.move(state.llh, -value * begun[:3]), state.vel_ned - value * begun[3:]
            state = replace(state, llh=llh, vel_ned=vel)
    stamps = stamps[1:]
    for k in np.flatnonzero(slow.any(axis=1)):
        signals[:, k] -= np.interp(imu.t, knots, slow[k]) * width
    llh = gnss.llh.copy()
    there = np.isfinite(llh).all(axis=1)
    llh[there] = earth.move(llh[there], shift[there, :3])
    if timed and (prepared.swings or prepared.steadied):
        # what a filter with the new stamps misses between two samples is another
        before, after = (
            velocity_missed(i, prepared.result.nav, t_fix, prepared.lever_arm) for i in (imu, replace(imu, t=stamps))
        )
        shift[at, 3:] += before * prepared.steadied - after
    vel_ned = None if gnss.vel_ned is None else gnss.vel_ned + shift[:, 3:]
    corrected = replace(imu, t=stamps, gyro=signals[:, :3], accel=signals[:, 3:])
    return corrected, replace(gnss, llh=llh, vel_ned=vel_ned), state
