"""Emulation: from a trajectory to an ideal IMU, to a corrupted one, to GNSS fixes with outages."""

from insemu.emulate.errors import RecordedErrors
from insemu.emulate.gnss import AreaOutage, Outage, gnss_fixes, random_outages
from insemu.emulate.imu import IdealImu, ideal_imu, navigation_error
from insemu.emulate.path import Mounting, SmoothPath
from insemu.emulate.sensor import Corrupted, TemperatureProfile, corrupt
from insemu.emulate.trajectory import TRAJECTORIES, Flight, built_in

__all__ = [
    "TRAJECTORIES",
    "AreaOutage",
    "Corrupted",
    "Flight",
    "IdealImu",
    "Mounting",
    "Outage",
    "RecordedErrors",
    "SmoothPath",
    "TemperatureProfile",
    "built_in",
    "corrupt",
    "gnss_fixes",
    "ideal_imu",
    "navigation_error",
    "random_outages",
]
