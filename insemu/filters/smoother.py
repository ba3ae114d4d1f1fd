"""Rauch-Tung-Striebel smoothing over the filter's nodes: forward filter, backward pass, memory bounded by the number of nodes.

Between two nodes the filter has accumulated the transition of its errors, so the backward pass needs nothing at the IMU's rate: twenty
minutes of a 24-state filter with a node per second take 20 MB instead of 2 GB.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from insemu.augment import StateLayout
from insemu.errors import InputError
from insemu.filters.results import FilterResult
from insemu.records import Trajectory
from insemu.strapdown import correct, trajectory_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SmootherResult:
    """Smoothed states at the filter's nodes.

    Parameters
    ----------
    layout : StateLayout
    t : (k,) array
        s.
    nav : (k, 10) array
        Latitude, longitude, height, velocity, quaternion.
    imu_states : (k, n - 9) array
    covariance : (k, n, n) array
    """

    layout: StateLayout
    t: Array
    nav: Array
    imu_states: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviations of all states, (k, n)."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("kii->ki", self.covariance), 0.0)))

    @cached_property
    def trajectory(self) -> Trajectory:
        """The smoothed trajectory at the nodes."""
        return trajectory_of(self.t, self.nav, "smoother")


def _gain(after: Array, Phi: Array, before: Array) -> Array:
    """``after Phi' before^-1``, with ``before`` scaled to correlations; states without any variance get no gain."""
    sd = np.sqrt(np.diag(before))
    live = sd > 0
    scale = np.where(live, sd, 1.0)
    correlation = before / np.outer(scale, scale)
    right = (Phi @ after) / scale[:, None]
    factor, failed = linalg.lapack.dpotrf(
        correlation, lower=0, clean=0
    )  # without the checks of cho_factor, which take twice its time
    if failed:  # fully correlated states, for example two sensors that share a constant
        solved = linalg.pinvh(correlation, rtol=1e-12) @ right
    else:
        solved, _ = linalg.lapack.dpotrs(factor, right, lower=0)
    return np.asarray((solved / scale[:, None]).T)


def smooth(result: FilterResult) -> SmootherResult:
    """Smooth a filter's run backwards (Rauch, Tung and Striebel 1965), in the errors of the closed loop.

    Parameters
    ----------
    result : FilterResult
        Of a run with ``FilterOptions(store="fixes", node_every=...)``; ``node_every`` sets how densely outages are covered.

    Returns
    -------
    SmootherResult

    Raises
    ------
    InputError
        The run kept no nodes.
    """
    nodes = result.nodes
    if nodes is None:
        raise InputError("the run kept no nodes; filter with FilterOptions(store='fixes', node_every=1.0)")
    k = len(nodes)
    P = nodes.P_after.copy()
    nav, states = nodes.nav.copy(), nodes.states.copy()
    error = np.zeros(P.shape[1])  # of the filtered state, as the data after it tell
    for i in range(k - 2, -1, -1):
        D = _gain(nodes.P_after[i], nodes.Phi[i + 1], nodes.P_before[i + 1])
        # what the update took off and the later data would take off, both as errors of the predicted state
        error = D @ (nodes.correction[i + 1] + error)
        change = D @ (P[i + 1] - nodes.P_before[i + 1]) @ D.T
        P[i] += 0.5 * (change + change.T)
        correct(nav[i], error[:9])
        states[i] -= error[9:]
    return SmootherResult(result.layout, nodes.t, nav, states, P)
