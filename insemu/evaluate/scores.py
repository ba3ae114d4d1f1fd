"""What is kept of one design in one realization next to its navigation errors: what it says of the sensors, and sums over its fixes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.augment import StateLayout
from insemu.emulate import TrueStates
from insemu.evaluate.consistency import block_nees, lag_products, observability, sensor_errors
from insemu.filters import FilterResult, FixTable, LooselyCoupledEKF, NavigationFilter
from insemu.records import ImuRecord

Array = NDArray[np.float64]


def sensor_scores(
    ekf: NavigationFilter,
    run: FilterResult,
    imu: ImuRecord,
    rows: NDArray[np.intp],
    error: Array,
    true: TrueStates | None,
    unaided: Array,
) -> dict[str, Array]:
    """NEES of every block, errors and stated standard deviations of what the filter says about its axes, observability of its states.

    Parameters
    ----------
    ekf : NavigationFilter
    run : FilterResult
        With the covariance at the epochs.
    imu : ImuRecord
        As the sensors gave it.
    rows : (k,) array of int
        Its rows at the epochs.
    error : (k, 9) array
        Navigation errors; NaN where they are not those of the covariance.
    true : TrueStates, optional
        What the axes err by.
    unaided : (k, m) array
        Standard deviations of the states of the axes without any fix.
    """
    times = imu.t[rows]
    covariance = run.covariance[np.searchsorted(run.covariance_t, times - 1e-9).clip(0, len(run.covariance) - 1)]
    if not isinstance(ekf, LooselyCoupledEKF):  # what its further states mean is not known
        nothing = np.full((len(rows), 6), np.nan)
        unknown = np.full((len(rows), covariance.shape[1] - 9), np.nan)
        return {
            "block_nees": block_nees(error, covariance),
            "axis_error": nothing,
            "axis_sigma": nothing,
            "observability": unknown,
        }
    whole = imu.as_increments()
    step = (whole.t[np.maximum(rows, 1)] - whole.t[np.maximum(rows, 1) - 1])[:, None]
    measured = np.hstack([part[rows] for part in ekf.augmentation.sensed(whole)]) / step
    at = np.searchsorted(run.t, times - 1e-9)
    sensed = sensor_errors(run, ekf.augmentation, at, covariance, measured, true)
    return {
        "block_nees": block_nees(error, covariance, sensed),
        "axis_error": sensed.axes,
        "axis_sigma": np.sqrt(np.maximum(np.einsum("kii->ki", sensed.axes_covariance), 0.0)),
        "observability": observability(np.sqrt(np.maximum(np.einsum("kii->ki", covariance[:, 9:, 9:]), 0.0)), unaided),
    }


def run_scores(layout: StateLayout, fixes: FixTable) -> dict[str, Any]:
    """What is said of a run as a whole."""
    used = fixes.accepted
    lag_sum, lag_count = lag_products(fixes) if used.any() else (np.zeros(5), np.zeros(5))
    return {
        "states": layout.n,
        "state_name": layout.names[9:],
        "nis": fixes.nis[used].sum(),
        "dof": fixes.dof[used].sum(),
        "lag_sum": lag_sum,
        "lag_count": lag_count,
        "rejected": len(fixes.rejected),
        "fixes": np.count_nonzero(fixes.dof),
    }
