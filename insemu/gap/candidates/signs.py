"""An axis of the IMU that was recorded with the wrong sign, found by flying the nominal filter with each axis turned round."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from insemu.errors import InputError
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.drive.signatures import Loop
from insemu.records import AXES

#: Mean square of the normalised innovations above which it is asked, and share of it that may be left: with the wrong sign of any axis of a boat and
#: of a walker it was 60 to 5000 and a hundredth was left, and a mounting, a clock or an antenna that is wrong leaves more than half with any sign.
LOUD, LEFT = 20.0, 0.1


def check_signs(flown: Flown, say: Callable[[str], None]) -> None:
    """Raise ``InputError`` where the recording agrees with the nominal model once one axis is turned round.

    Parameters
    ----------
    flown : Flown
        The nominal filter on the recording.
    say : callable
        Told what is being done.

    Raises
    ------
    InputError
        Which axis has the wrong sign.
    """
    prepared = flown.prepared
    square = _square(prepared)
    if square < LOUD:
        return
    left = {}
    for k, axis in enumerate(AXES):
        say(f"{axis} turned round")
        signals = np.hstack([prepared.imu.gyro, prepared.imu.accel])
        signals[:, k] *= -1.0
        try:
            turned = prepared.again(imu=replace(prepared.imu, gyro=signals[:, :3], accel=signals[:, 3:]))
        except InputError:  # no filter runs on it
            continue
        left[axis] = _square(turned)
    best = min(left, key=lambda axis: left[axis], default="")
    if best and left[best] < LEFT * square:
        raise InputError(
            f"{best} has the wrong sign: turned round, the mean square of the filter's normalised innovations falls from {square:.3g} to "
            f"{left[best]:.3g}; expected right-handed axes: name the "
            'columns of the file, the wrong one with a minus, such as --map "gyro=gx gy -gz"',
            where=flown.recording.source,
        )


def _square(prepared: Prepared) -> float:
    """Mean square of the normalised innovations."""
    loop = Loop.of(prepared.result)
    return float(loop.y @ loop.y) / max(1, int(loop.use.sum()))
