"""Filters: the loosely coupled, closed-loop error-state EKF in one compiled loop."""

from insemu.augment import Extras
from insemu.filters.aids import Standstill
from insemu.filters.ekf import LooselyCoupledEKF, run_filter
from insemu.filters.joint import JointSystem, error_maps, ideal_fixes
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.protocol import FilterParts, NavigationFilter, user_filter
from insemu.filters.results import FilterResult, FixTable, Nodes
from insemu.filters.smoother import SmootherResult, smooth

__all__ = [
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
    "error_maps",
    "ideal_fixes",
    "run_filter",
    "smooth",
    "user_filter",
]
