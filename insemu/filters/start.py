"""One place to start a filter on recorded data: which way, and what the record has to have for it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from insemu import earth
from insemu.blas import on_one_thread
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, align
from insemu.filters.motion import align_in_motion
from insemu.filters.options import InitialSigma
from insemu.filters.two_way import from_both_sides
from insemu.records import GnssRecord, ImuRecord, InitialState
from insemu.strapdown import NavState

How = Literal["auto", "rest", "motion"]
#: Longest usual step of an IMU that navigates, s: within a longer one a vehicle turns and comes back, which no increment tells.
LONGEST_STEP = 1.0


def at_state(imu: ImuRecord, known: InitialState) -> Alignment:
    """A start at a state that is known, at the first epoch of ``imu`` at or after it.

    Raises
    ------
    InputError
        A time outside the record.
    """
    row = int(np.searchsorted(imu.t, known.t - 1e-6))
    if row >= len(imu) - 1 or imu.t[row] - known.t > 1.0:
        raise InputError(
            f"the initial state is of {known.t:g} s, expected a time of the IMU record ({imu.t[0]:g} to {imu.t[-1]:g} s)"
        )
    llh = earth.move(known.llh, known.vel_ned * (imu.t[row] - known.t))
    sigma = InitialSigma(known.sigma[:3], known.sigma[3:6], known.sigma[6:])
    nothing = np.full(6, np.nan)
    state = NavState(llh, np.array(known.vel_ned), np.array(known.rpy))
    return Alignment(float(imu.t[row]), row, state, sigma, nothing, nothing, ())


@on_one_thread
def start(
    imu: ImuRecord,
    gnss: GnssRecord,
    *,
    how: How = "auto",
    known: InitialState | None = None,
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
        anyhow. ``auto``: in motion where that tells the heading, and from there back to the first fix (:mod:`~insemu.filters.two_way`);
        else by the course.
    known : InitialState, optional
        Of the IMU record's axes; ``auto`` starts there.
    lever_arm : (3,)
        IMU to antenna in the axes of the record, m.
    gravity : str
        See :mod:`insemu.earth`.

    Raises
    ------
    InputError
        No way to start; an IMU with steps above :data:`LONGEST_STEP`.
    """
    if imu.dt > LONGEST_STEP * (1.0 + 1e-6):
        raise InputError(f"the IMU has a sample every {imu.dt:.4g} s, expected one every {LONGEST_STEP:g} s at least")
    if known is not None and how == "auto":
        return at_state(imu, known)
    if how == "rest":
        found = align(imu, gnss, lever_arm=lever_arm)
        if np.isnan(found.bias[:3]).any():
            raise InputError("found no rest before the first motion, expected one to align at; 'motion' does without")
        return found
    try:
        found = align_in_motion(imu, gnss, lever_arm=lever_arm, gravity=gravity)
    except InputError as error:
        if how == "motion":
            raise
        try:
            return align(imu, gnss, lever_arm=lever_arm)  # too little motion for the fixes; the course may do
        except InputError as other:
            raise InputError(f"{error.message}; by its course: {other.message}") from None
    if how == "motion":
        return found
    return from_both_sides(imu, gnss, found, lever_arm=np.asarray(lever_arm, dtype=np.float64), gravity=gravity)
