"""Filters: the loosely coupled, closed-loop error-state EKF in one compiled loop."""

from insemu.augment import Extras
from insemu.filters.ekf import (
    FilterOptions,
    FilterResult,
    FixTable,
    InitialSigma,
    LooselyCoupledEKF,
    Nodes,
    Standstill,
    run_filter,
)

__all__ = [
    "Extras",
    "FilterOptions",
    "FilterResult",
    "FixTable",
    "InitialSigma",
    "LooselyCoupledEKF",
    "Nodes",
    "Standstill",
    "run_filter",
]
