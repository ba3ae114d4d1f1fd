"""Rauch-Tung-Striebel smoothing over the filter's nodes: forward filter, backward pass, memory bounded by the number of nodes.

Between two nodes the filter has accumulated the transition of its errors, so the backward pass needs nothing at the IMU's rate: twenty
minutes of a 24-state filter with a node per second take 20 MB instead of 2 GB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.augment import StateLayout
from insemu.compiled import njit
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


def _singular_gain(after: Array, Phi: Array, before: Array) -> Array:
    """What :func:`_gain` writes, where states are fully correlated, for example of two sensors that share a constant."""
    from scipy.linalg import pinvh

    sd = np.sqrt(np.diag(before))
    scale = np.where(sd > 0, sd, 1.0)
    solved = pinvh(before / np.outer(scale, scale), rtol=1e-12) @ ((Phi @ after) / scale[:, None])
    return np.asarray(solved / scale[:, None])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _gain(after: Array, Phi: Array, before: Array, scale: Array, U: Array, Dt: Array) -> bool:
    """Write ``before^-1 Phi after``, the gain transposed, into ``Dt`` (n, n); False where ``before`` is singular.

    ``before`` is scaled to correlations and factored (``U`` (n, n), Cholesky); states without any variance get no gain.
    """
    n = before.shape[0]
    for i in range(n):
        sd = math.sqrt(before[i, i]) if before[i, i] > 0.0 else 0.0
        scale[i] = sd if sd > 0.0 else 1.0
    for i in range(n):
        row, D, less = U[i], Dt[i], 1.0 / scale[i]
        for j in range(n):
            row[j] = before[i, j] / (scale[i] * scale[j])
            D[j] = 0.0
        if row[i] == 0.0:
            row[i] = 1.0
        for k in range(n):
            x = Phi[i, k] * less
            if x != 0.0:
                other = after[k]
                for j in range(n):
                    D[j] += x * other[j]
    for k in range(n):
        pivot = U[k, k]
        if not pivot > 0.0:
            return False
        row, D, less = U[k], Dt[k], 1.0 / math.sqrt(pivot)
        for j in range(n):
            row[j] *= less
            D[j] *= less
        for i in range(k + 1, n):
            x = row[i]
            if x != 0.0:
                other, E = U[i], Dt[i]
                for j in range(n):
                    other[j] -= x * row[j]
                    E[j] -= x * D[j]
    for k in range(n - 1, -1, -1):
        D = Dt[k]
        for i in range(k + 1, n):
            x = U[k, i]
            if x != 0.0:
                other = Dt[i]
                for j in range(n):
                    D[j] -= x * other[j]
        less = 1.0 / U[k, k]
        for j in range(n):
            D[j] *= less
    for i in range(n):
        D, less = Dt[i], 1.0 / scale[i]
        for j in range(n):
            D[j] *= less
    return True


def smoother_gain(after: Array, Phi: Array, before: Array) -> Array:
    """The smoother's gain (n, n): what an error of the node after says of that of a node.

    Parameters
    ----------
    after : (n, n) array
        Covariance of the node after its update.
    Phi : (n, n) array
        Transition to the node after it.
    before : (n, n) array
        Covariance of that node before its update.
    """
    n = after.shape[0]
    U, Dt, scale = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    if not _gain(after, Phi, before, scale, U, Dt):
        Dt = _singular_gain(after, Phi, before)
    return Dt.T


class _Backward(NamedTuple):
    """Nodes of a run on their way back.

    Parameters
    ----------
    before, after, Phi : (k, n, n) arrays
        Covariances around the update of every node, transition from the node before.
    correction : (k, n) array
        Error that the update of every node took off.
    P, nav, states : (k, n, n), (k, 10), (k, n - 9) arrays
        Filtered ones, overwritten by the smoothed ones.
    error : (n,) array
        Estimated error of the prediction at the node that was smoothed last, overwritten.
    """

    before: Array
    after: Array
    Phi: Array
    correction: Array
    P: Array
    nav: Array
    states: Array
    error: Array


@njit(cache=True, nogil=True, fastmath={"contract"})
def _back(i: int, Dt: Array, nodes: _Backward, work: Array) -> None:
    """Smooth node ``i`` by the node after it, whose covariance is smoothed already; ``Dt`` is the gain transposed."""
    before, _, _, correction, P, nav, states, error = nodes
    n = Dt.shape[0]
    # what the update took off and the later data would take off, both as errors of the predicted state
    told, W = work[0], work[1]
    for a in range(n):
        told[a] = correction[i + 1, a] + error[a]
        error[a] = 0.0
    for a in range(n):
        x, D = told[a], Dt[a]
        for j in range(n):
            error[j] += x * D[j]
    smoothed, predicted, here = P[i + 1], before[i + 1], P[i]
    for a in range(n):  # row a of (P - before) D', which is all that row a of the gain needs
        for j in range(n):
            W[j] = 0.0
        for b in range(n):
            x, D = smoothed[a, b] - predicted[a, b], Dt[b]
            for j in range(n):
                W[j] += x * D[j]
        for k in range(n):
            x, row = Dt[a, k], here[k]
            if x != 0.0:
                for j in range(n):
                    row[j] += x * W[j]
    for a in range(n):
        for b in range(a):
            mean = 0.5 * (here[a, b] + here[b, a])
            here[a, b] = mean
            here[b, a] = mean
    correct(nav[i], error)
    for s in range(n - 9):
        states[i, s] -= error[9 + s]


@njit(cache=True, nogil=True)
def _pass(last: int, nodes: _Backward) -> int:
    """The backward pass from node ``last`` to the first; returns the node whose gain is not defined, or -1 when it is through.

    Parameters
    ----------
    last : int
        Node to begin with; those after it are smoothed already.
    nodes : _Backward
    """
    before, after, Phi = nodes.before, nodes.after, nodes.Phi
    n = before.shape[1]
    U, Dt, scale, work = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty((2, n))
    for i in range(last, -1, -1):
        if not _gain(after[i], Phi[i + 1], before[i + 1], scale, U, Dt):
            return i
        _back(i, Dt, nodes, work)
    return -1


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
    back = _Backward(nodes.P_before, nodes.P_after, nodes.Phi, nodes.correction, P, nav, states, error)
    i = k - 2
    while i >= 0:
        i = _pass(i, back)
        if i >= 0:
            Dt = _singular_gain(nodes.P_after[i], nodes.Phi[i + 1], nodes.P_before[i + 1])
            _back(i, Dt, back, np.empty((2, error.size)))
            i -= 1
    return SmootherResult(result.layout, nodes.t, nav, states, P)
