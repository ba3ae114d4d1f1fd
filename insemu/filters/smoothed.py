"""A smoothed run between its nodes, and how the errors of its nodes go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.compiled import njit
from insemu.earth import position_difference
from insemu.errors import InputError
from insemu.filters.results import FilterResult, Nodes
from insemu.filters.smoother import SmootherResult, smoother_gain
from insemu.strapdown import correct

Array = NDArray[np.float64]


def smoothed_at(result: FilterResult, smoothed: SmootherResult, rows: NDArray[np.int64]) -> Array:
    """Smoothed navigation states (m, 10) at epochs that a run stored.

    Between two nodes the filter predicts; what the smoother would take off at the first and at the second is removed in proportion to time.

    Parameters
    ----------
    result : FilterResult
        Of a run with ``store="fixes"``.
    smoothed : SmootherResult
        Of that run.
    rows : (m,) array of int
        Rows of the result between the first and the last node.

    Raises
    ------
    InputError
        The run kept no nodes.
    """
    nodes = _nodes(result)
    error = np.hstack(
        [
            position_difference(nodes.nav[:, :3], smoothed.nav[:, :3]),
            nodes.nav[:, 3:6] - smoothed.nav[:, 3:6],
            rotation.vector_from_quaternion(
                rotation.quaternion_product(nodes.nav[:, 6:10], rotation.quaternion_conjugate(smoothed.nav[:, 6:10]))
            ),
        ]
    )
    before = error + nodes.correction[:, :9]
    t = result.t[rows]
    after, share = _between(nodes.t, t)
    left = (1.0 - share) * error[after - 1] + share * before[after]
    updated = t == nodes.t[after]
    left[updated] = error[after[updated]]
    nav = result.nav[rows].copy()
    _corrected(nav, left)
    return nav


def _between(nodes: Array, t: Array) -> tuple[NDArray[np.intp], Array]:
    """The node after each time (m,), at the earliest the second, and which share (m, 1) of the time from the one before has gone."""
    after = np.clip(np.searchsorted(nodes, t, side="left"), 1, nodes.size - 1)
    first, last = nodes[after - 1], nodes[after]
    return after, np.clip((t - first) / (last - first), 0.0, 1.0)[:, None]


def sigma_at(smoothed: SmootherResult, t: Array) -> Array:
    """Standard deviations (m, n) of all states at times between the nodes, whose variances are taken in proportion to time.

    Parameters
    ----------
    smoothed : SmootherResult
    t : (m,) array
        s.
    """
    after, share = _between(smoothed.t, t)
    variance = smoothed.sigma**2
    return np.asarray(np.sqrt((1.0 - share) * variance[after - 1] + share * variance[after]))


@njit(cache=True, nogil=True)
def _corrected(nav: Array, error: Array) -> None:
    """Take errors (m, 9) off states (m, 10), in place."""
    for k in range(nav.shape[0]):
        correct(nav[k], error[k])


def cross_covariance(result: FilterResult, smoothed: SmootherResult, at: NDArray[np.int64], jacobians: Array) -> Array:
    """Covariance (m w, m w) of what is seen of the smoothed errors at some nodes.

    The errors of two nodes go together by the smoother's gains between them (Rauch, Tung and Striebel 1965).

    Parameters
    ----------
    result, smoothed : FilterResult, SmootherResult
        A run that kept nodes, smoothed.
    at : (m,) array of int
        Nodes, not decreasing.
    jacobians : (m, w, n) array
        What is seen at each of them.

    Raises
    ------
    InputError
        The run kept no nodes.
    """
    nodes = _nodes(result)
    m, w, n = jacobians.shape
    out = np.zeros((m, w, m, w))
    seen = np.zeros((n, m * w))  # errors at the present node against what is seen later
    node = int(at[-1])
    for k in range(m - 1, -1, -1):
        while node > at[k]:
            node -= 1
            D = smoother_gain(nodes.P_after[node], nodes.Phi[node + 1], nodes.P_before[node + 1])
            seen[:, (k + 1) * w :] = D @ seen[:, (k + 1) * w :]
        own = smoothed.covariance[node] @ jacobians[k].T
        seen[:, k * w : (k + 1) * w] = own
        out[k, :, k:] = (jacobians[k] @ seen[:, k * w :]).reshape(w, m - k, w)
        out[k:, :, k] = out[k, :, k:].transpose(1, 2, 0)
    return out.reshape(m * w, m * w)


def _nodes(result: FilterResult) -> Nodes:
    if result.nodes is None:
        raise InputError("the run kept no nodes; filter with FilterOptions(store='fixes', node_every=1.0)")
    return result.nodes
