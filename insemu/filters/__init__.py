"""Filters: the loosely coupled, closed-loop error-state EKF in one compiled loop."""

from insemu.augment import Extras
from insemu.filters.aids import Standstill
from insemu.filters.alignment import Alignment, align, cut, rests
from insemu.filters.ekf import LooselyCoupledEKF, run_filter
from insemu.filters.joint import JointSystem, error_maps, ideal_fixes
from insemu.filters.motion import align_in_motion
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.protocol import FilterParts, NavigationFilter, check_result, user_filter, user_filter_code
from insemu.filters.results import FilterResult, FixTable, Nodes
from insemu.filters.smoother import SmootherResult, smooth

__all__ = [
    "Alignment",
    "Extras",
    "FilterOptions",
    "FilterParts",
    "FilterResult",
    "FixTable",
    "InitialSigma",
    "JointSystem",
    "LooselyCoupledEKF",
    "NavigationFilter",
    "Nodes",
    "SmootherResult",
    "Standstill",
    "align",
    "align_in_motion",
    "check_result",
    "cut",
    "error_maps",
    "ideal_fixes",
    "rests",
    "run_filter",
    "smooth",
    "user_filter",
    "user_filter_code",
]
