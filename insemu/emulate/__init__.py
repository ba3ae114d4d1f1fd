"""Emulation: from a trajectory to an ideal IMU, to a corrupted one, to GNSS fixes with outages."""

from insemu.emulate.differenced import Differenced, difference
from insemu.emulate.dynamics import (
    Levels,
    MotionSpectrum,
    Mount,
    Moving,
    MovingVehicle,
    Regime,
    Slip,
    preset_file,
    presets,
    read_vehicle,
    vehicle_text,
)
from insemu.emulate.errors import RecordedErrors
from insemu.emulate.flight import Flight, gusts, moving_share, origin_at
from insemu.emulate.gnss import AreaOutage, Outage, antenna, fix_times, fixes_at, gnss_fixes, random_outages, state_at
from insemu.emulate.imu import IdealImu, ideal_imu, ideal_stretches, navigation_error
from insemu.emulate.motion import Command, path_of, profile
from insemu.emulate.path import Mounting, SmoothPath
from insemu.emulate.pieces import ErrorPieces, Following, TrueStates, recorded_pieces, simulated_pieces
from insemu.emulate.receiver import single_point
from insemu.emulate.reckon import DeadReckoning, dead_reckon
from insemu.emulate.satellites import CONSTELLATIONS, Multipath, Receiver, Sky, observed, seen, sky_over
from insemu.emulate.sensor import Corrupted, TemperatureProfile, corrupt, covariates_of
from insemu.emulate.sources import MotionSource, Source, load_flight, read_track
from insemu.emulate.track import SmoothedTrack, Track, bridged_gap, held_out_distance, smooth_track, turn_rate
from insemu.emulate.trajectory import TRAJECTORIES, built_in
from insemu.emulate.vehicle import VEHICLES
from insemu.emulate.waypoints import Waypoints, read_waypoints, route

__all__ = [
    "CONSTELLATIONS",
    "TRAJECTORIES",
    "VEHICLES",
    "AreaOutage",
    "Command",
    "Corrupted",
    "DeadReckoning",
    "Differenced",
    "ErrorPieces",
    "Flight",
    "Following",
    "IdealImu",
    "Levels",
    "MotionSource",
    "MotionSpectrum",
    "Mount",
    "Mounting",
    "Moving",
    "MovingVehicle",
    "Multipath",
    "Outage",
    "Receiver",
    "RecordedErrors",
    "Regime",
    "Sky",
    "Slip",
    "SmoothPath",
    "SmoothedTrack",
    "Source",
    "TemperatureProfile",
    "Track",
    "TrueStates",
    "Waypoints",
    "antenna",
    "bridged_gap",
    "built_in",
    "corrupt",
    "covariates_of",
    "dead_reckon",
    "difference",
    "fix_times",
    "fixes_at",
    "gnss_fixes",
    "gusts",
    "held_out_distance",
    "ideal_imu",
    "ideal_stretches",
    "load_flight",
    "moving_share",
    "navigation_error",
    "observed",
    "origin_at",
    "path_of",
    "preset_file",
    "presets",
    "profile",
    "random_outages",
    "read_track",
    "read_vehicle",
    "read_waypoints",
    "recorded_pieces",
    "route",
    "seen",
    "simulated_pieces",
    "single_point",
    "sky_over",
    "smooth_track",
    "state_at",
    "turn_rate",
    "vehicle_text",
]
