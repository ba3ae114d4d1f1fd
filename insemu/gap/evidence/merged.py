"""States of the nominal filter that count as one, and its transitions from fix to fix in those that are left.

States that enter the motion alike and couple to nothing else (a turn-on bias and a random walk of the same axis) are one state here: only their
sum shows, which makes transitions smaller by a third and changes nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]

#: Errors of position, velocity and attitude, which come first and are never merged.
NAVIGATION = 9
#: Relative difference of two columns of a transition that is rounding.
ALIKE = 1e-12


def merged_states(Phi: Array, H: Array) -> Array:
    """The sums of states that count, (m, n) of zeros and ones: ``Phi`` of sums is a function of sums.

    Two states are one where the transition takes them everywhere alike, neither feeds on another state and no fix sees them.

    Parameters
    ----------
    Phi : (k, n, n) array
        Transitions of the errors.
    H : (f, 6, n) array
        Jacobians of the fixes.
    """
    n = Phi.shape[1]
    groups: list[list[int]] = [[i] for i in range(min(NAVIGATION, n))]
    seen = np.any(H.reshape(-1, n) != 0.0, axis=0)
    for i in range(len(groups), n):
        mine = [g for g in groups[NAVIGATION:] if _same_state(Phi, g[0], i)] if not seen[i] else []
        if mine:
            mine[0].append(i)
        else:
            groups.append([i])
    sums = np.zeros((len(groups), n))
    for row, group in enumerate(groups):
        sums[row, group] = 1.0
    return sums


@njit(cache=True, nogil=True)
def _same_state(Phi: Array, i: int, j: int) -> bool:  # pragma: no cover - compiled
    """Whether two states are taken everywhere alike by every transition, each fed by itself only."""
    for k in range(Phi.shape[0]):
        for q in range(Phi.shape[1]):
            if q in (i, j):
                continue
            a, b = Phi[k, q, i], Phi[k, q, j]
            if abs(a - b) > ALIKE * (abs(a) + abs(b)) or Phi[k, i, q] != 0.0 or Phi[k, j, q] != 0.0:
                return False
        own, other = Phi[k, i, i], Phi[k, j, j]
        if Phi[k, i, j] != 0.0 or Phi[k, j, i] != 0.0 or abs(own - other) > ALIKE * abs(own):
            return False
    return bool(Phi.shape[0] > 0)


@njit(cache=True, nogil=True)
def between_fixes(
    Phi: Array, before: Array, after: Array, node: NDArray[np.int64], row: NDArray[np.int64], first: NDArray[np.int64]
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Transitions and noises of the merged states from fix to fix; nodes without a fix are joined to the next one with a fix.

    Parameters
    ----------
    Phi : (k, n, n) array
        Transitions from the node before; the first one is not used.
    before, after : (k, n, n) arrays
        Covariances at the nodes, before and after what is measured there.
    node : (f,) array of int
        Of each fix, not decreasing; a second fix of a node has no way behind it.
    row : (n,) array of int
        Merged state that each state belongs to.
    first : (m,) array of int
        One state of each merged one.

    Returns
    -------
    Phi, Q : (f, m, m) arrays
    """
    n, m, f = row.size, first.size, node.size
    out, Q = np.zeros((f, m, m)), np.zeros((f, m, m))
    moved, half, own, grown = np.zeros((m, n)), np.zeros((m, n)), np.zeros((m, m)), np.zeros((m, m))
    at = 0
    for k in range(f):
        for i in range(m):
            out[k, i, i] = 1.0
        while at < node[k]:
            at += 1
            moved[:] = 0.0
            for i in range(n):
                for j in range(n):
                    moved[row[i], j] += Phi[at, i, j]
            half[:] = 0.0
            for i in range(m):
                for q in range(n):
                    w = moved[i, q]
                    if w != 0.0:
                        for j in range(n):
                            half[i, j] += w * after[at - 1, q, j]
            own[:] = 0.0
            for i in range(n):
                for j in range(n):
                    own[row[i], row[j]] += before[at, i, j]
            for i in range(m):
                for j in range(i + 1):
                    total = 0.0
                    for q in range(n):
                        total += half[i, q] * moved[j, q]
                    own[i, j] = own[j, i] = 0.5 * (own[i, j] + own[j, i]) - total
            # what came before goes through this transition, too
            for source, target in ((out[k], grown), (Q[k], half)):
                for i in range(m):
                    for j in range(m):
                        target[i, j] = 0.0
                    for q in range(m):
                        w = moved[i, first[q]]
                        if w != 0.0:
                            for j in range(m):
                                target[i, j] += w * source[q, j]
            out[k] = grown
            for i in range(m):
                for j in range(i + 1):
                    total = own[i, j]
                    for q in range(m):
                        total += half[i, q] * moved[j, first[q]]
                    Q[k, i, j] = Q[k, j, i] = total
    return out, Q
