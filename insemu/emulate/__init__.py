"""Emulation: from a trajectory to an ideal IMU, to a corrupted one, to GNSS fixes with outages."""

from insemu.emulate.errors import Corrupted, RecordedErrors, corrupt
from insemu.emulate.gnss import Outage, gnss_fixes
from insemu.emulate.imu import IdealImu, ideal_imu, navigation_error
from insemu.emulate.path import Mounting, SmoothPath
from insemu.emulate.trajectory import TRAJECTORIES, Flight, built_in

__all__ = [
    "TRAJECTORIES",
    "Corrupted",
    "Flight",
    "IdealImu",
    "Mounting",
    "Outage",
    "RecordedErrors",
    "SmoothPath",
    "built_in",
    "corrupt",
    "gnss_fixes",
    "ideal_imu",
    "navigation_error",
]
