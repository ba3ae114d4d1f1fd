"""One place to start a filter on recorded data: which way, and what the record has to have for it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from insemu.errors import InputError
from insemu.filters.alignment import Alignment, align
from insemu.filters.motion import align_in_motion
from insemu.records import GnssRecord, ImuRecord

How = Literal["auto", "rest", "motion"]


def start(
    imu: ImuRecord,
    gnss: GnssRecord,
    *,
    how: How = "auto",
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    gravity: str = "normal",
) -> Alignment:
    """Where and how a filter starts on a recording.

    Parameters
    ----------
    imu : ImuRecord
        In vehicle axes, unless ``how`` is "motion".
    gnss : GnssRecord
        With velocities, or positions alone.
    how : {"auto", "rest", "motion"}
        ``rest``: level and gyroscope bias at a stop, heading from the first course. ``motion``: from the fixes while the vehicle moves, mounted
        anyhow. ``auto``: in motion where that tells the heading, else by the course.
    lever_arm : (3,)
        IMU to antenna in the axes of the record, m.
    gravity : str
        See :mod:`insemu.earth`.

    Raises
    ------
    InputError
        No way to start.
    """
    if how == "rest":
        found = align(imu, gnss, lever_arm=lever_arm)
        if np.isnan(found.gyro_bias).any():
            raise InputError("found no rest before the first motion, expected one to align at; 'motion' does without")
        return found
    try:
        return align_in_motion(imu, gnss, lever_arm=lever_arm, gravity=gravity)
    except InputError:
        if how == "motion":
            raise
    return align(imu, gnss, lever_arm=lever_arm)  # too little motion for the fixes; the course may do
