"""Emulation: from a trajectory to an ideal IMU, to a corrupted one, to GNSS fixes with outages."""

from insemu.emulate.errors import RecordedErrors
from insemu.emulate.gnss import AreaOutage, Outage, gnss_fixes, random_outages
from insemu.emulate.imu import IdealImu, ideal_imu, navigation_error
from insemu.emulate.path import Mounting, SmoothPath
from insemu.emulate.reckon import DeadReckoning, dead_reckon
from insemu.emulate.sensor import Corrupted, TemperatureProfile, corrupt
from insemu.emulate.sources import Source, load_flight, read_track
from insemu.emulate.track import SmoothedTrack, Track, smooth_track
from insemu.emulate.trajectory import TRAJECTORIES, Flight, built_in
from insemu.emulate.waypoints import Waypoints, read_waypoints, route

__all__ = [
    "TRAJECTORIES",
    "AreaOutage",
    "Corrupted",
    "DeadReckoning",
    "Flight",
    "IdealImu",
    "Mounting",
    "Outage",
    "RecordedErrors",
    "SmoothPath",
    "SmoothedTrack",
    "Source",
    "TemperatureProfile",
    "Track",
    "Waypoints",
    "built_in",
    "corrupt",
    "dead_reckon",
    "gnss_fixes",
    "ideal_imu",
    "load_flight",
    "navigation_error",
    "random_outages",
    "read_track",
    "read_waypoints",
    "route",
    "smooth_track",
]
