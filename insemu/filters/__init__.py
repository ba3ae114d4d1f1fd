"""Filters: the loosely coupled, closed-loop error-state EKF in one compiled loop."""

from insemu.augment import Extras
from insemu.filters.aid import SETTINGS, Aid, AidUse, TrueMotion
from insemu.filters.aids import AIDS, Standstill, aid_jacobian
from insemu.filters.alignment import (
    TRACK_SPEED,
    Alignment,
    align,
    align_at_rest,
    cut,
    on_reference,
    sigma_of_fixes,
    with_standard_deviations,
)
from insemu.filters.ekf import LooselyCoupledEKF, run_filter
from insemu.filters.events import SAME_TIME
from insemu.filters.families import FAMILIES, Family
from insemu.filters.gains import Gains, gains_along, on_ideal_data
from insemu.filters.joint import JointSystem, error_maps
from insemu.filters.likeliest import Innovations, Likeliest, likeliest, uncertainty
from insemu.filters.measurements import FIX
from insemu.filters.motion import align_in_motion
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.protocol import (
    FilterParts,
    NavigationFilter,
    NotYet,
    check_result,
    named_filter,
    register_filter,
    user_filter,
    user_filter_code,
)
from insemu.filters.rest import never_moves, rests
from insemu.filters.results import FilterResult, FixTable, Nodes, log_density
from insemu.filters.smoothed import cross_covariance, sigma_at, smoothed_at
from insemu.filters.smoother import SmootherResult, smooth
from insemu.filters.start import How, start
from insemu.filters.twin import Carried, Intervals, LinearErrors, basis, carried, driven, transitions
from insemu.filters.two_way import BRIDGED_S

__all__ = [
    "AIDS",
    "BRIDGED_S",
    "FAMILIES",
    "FIX",
    "SAME_TIME",
    "SETTINGS",
    "TRACK_SPEED",
    "Aid",
    "AidUse",
    "Alignment",
    "Carried",
    "Extras",
    "Family",
    "FilterOptions",
    "FilterParts",
    "FilterResult",
    "FixTable",
    "Gains",
    "How",
    "InitialSigma",
    "Innovations",
    "Intervals",
    "JointSystem",
    "Likeliest",
    "LinearErrors",
    "LooselyCoupledEKF",
    "NavigationFilter",
    "Nodes",
    "NotYet",
    "SmootherResult",
    "Standstill",
    "TrueMotion",
    "aid_jacobian",
    "align",
    "align_at_rest",
    "align_in_motion",
    "basis",
    "carried",
    "check_result",
    "cross_covariance",
    "cut",
    "driven",
    "error_maps",
    "gains_along",
    "likeliest",
    "log_density",
    "named_filter",
    "never_moves",
    "on_ideal_data",
    "on_reference",
    "register_filter",
    "rests",
    "run_filter",
    "sigma_at",
    "sigma_of_fixes",
    "smooth",
    "smoothed_at",
    "start",
    "transitions",
    "uncertainty",
    "user_filter",
    "user_filter_code",
    "with_standard_deviations",
]
