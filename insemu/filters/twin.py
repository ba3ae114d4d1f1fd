"""A filter's errors to first order, step by step under given errors of the sensors, or between two fixes in one map (compiled).

With the navigation errors x (estimate minus truth) and the estimates s of the axes' errors e, a step is ``s <- Phi s`` and
``x <- F x + B (e - C s)``, a fix ``z <- M z + N e + K n`` with z = (x, s) and the noise n of the fix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.expanded import LD, apply_map

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def step_matrices(t: Array, maps: Array) -> tuple[Array, Array]:
    """``F`` (n, 9, 9) and ``B`` (n, 9, 6) of all steps.

    Parameters
    ----------
    t : (n,) array
        Epochs, s.
    maps : (n, 46) array
        Of :func:`insemu.filters.joint.error_maps`.
    """
    F, B = np.zeros((t.size, 9, 9)), np.zeros((t.size, 9, 6))
    _matrices(t, maps, F, B)
    return F, B


@dataclass(frozen=True)
class LinearErrors:
    """The linear error system of one design along one reference.

    Parameters
    ----------
    F, B : (n, 9, 9), (n, 9, 6) arrays
        Steps of the navigation errors.
    C : (n, 6, m) array
        What the axes see of the estimates at every row; (1, 6, m) where that is always the same.
    Phi : (m, m) array
        Transition of the estimates.
    epoch : (f,) array of int
        Rows at which there is a fix, increasing.
    M, N, K : (f, 9 + m, 9 + m), (f, 9 + m, 6), (f, 9 + m, 6) arrays
        What a fix does with the errors, with the error of the axes at its epoch, and with its own noise.
    """

    F: Array
    B: Array
    C: Array
    Phi: Array
    epoch: Ints
    M: Array
    N: Array
    K: Array

    @property
    def size(self) -> int:
        """Number of errors and estimates."""
        return 9 + int(self.Phi.shape[0])

    def respond(self, start: Array, axes: Array, noise: Array, rows: Ints) -> Array:
        """Navigation errors under given errors of the sensors.

        Parameters
        ----------
        start : (9,) array
            Initial navigation errors.
        axes : (n, 6) array
            Errors of the axes, rad/s and m/s^2.
        noise : (f, 6) array
            Errors of the fixes, m and m/s.
        rows : (o,) array of int
            Increasing.

        Returns
        -------
        (o, 9) array
            After the fix of that epoch if there is one.
        """
        out = np.empty((rows.size, 9))
        _respond(self.F, self.B, self.C, self.Phi, self.epoch, self.M, self.N, self.K, start, axes, noise, rows, out)
        return out

    def between(self, first: int, last: int) -> tuple[Array, Array]:
        """From after row ``first`` to row ``last`` in one map: the transition and what each row's axis errors add.

        Parameters
        ----------
        first, last : int

        Returns
        -------
        transition : (9 + m, 9 + m) array
        gain : (last - first, 9 + m, 6) array
        """
        transition, gain = np.eye(self.size), np.zeros((last - first, self.size, 6))
        _between(self.F, self.B, self.C, self.Phi, first, last, transition, gain)
        return transition, gain

    def adjoint(self, row: int, L: Array) -> tuple[Array, Array, Array]:
        """What every error of sensors, start and fixes contributes to some linear functionals of the errors at one row.

        Parameters
        ----------
        row : int
            Before a fix of that row.
        L : (k, 9) array
            The functionals of the navigation errors.

        Returns
        -------
        gain : (row + 1, k, 6) array
            Effect of each row's axis errors.
        start : (k, 9) array
            Effect of the initial navigation errors.
        fixes : (f, k, 6) array
            Effect of the noise of every fix.
        """
        left = np.hstack([L, np.zeros((L.shape[0], self.size - 9))])
        gain, fixes = np.zeros((row + 1, L.shape[0], 6)), np.zeros((self.epoch.size, L.shape[0], 6))
        last = row
        for f in np.flatnonzero(self.epoch < row)[::-1]:
            first = int(self.epoch[f])
            transition, effect = self.between(first, last)
            gain[first + 1 : last + 1] += left @ effect
            left = left @ transition
            gain[first] += left @ self.N[f]
            fixes[f] = left @ self.K[f]
            left, last = left @ self.M[f], first
        transition, effect = self.between(0, last)
        gain[1 : last + 1] += left @ effect
        return gain, (left @ transition)[:, :9], fixes


@njit(cache=True, nogil=True)
def _matrices(t: Array, maps: Array, F: Array, B: Array) -> None:
    """Every step applied to unit errors of navigation and axes."""
    E = np.zeros(15 * LD)
    for k in range(1, t.size):
        for i in range(15 * LD):
            E[i] = 0.0
        for i in range(15):
            E[i * LD + i] = 1.0
        apply_map(maps[k], 0.5 * (t[k] - t[k - 1]), E, 15)
        for i in range(9):
            for j in range(9):
                F[k, i, j] = E[i * LD + j]
            for j in range(6):
                B[k, i, j] = E[i * LD + 9 + j]


@njit(cache=True, nogil=True)
def _respond(
    F: Array, B: Array, C: Array, Phi: Array, epoch: Ints, M: Array, N: Array, K: Array, start: Array, axes: Array, noise: Array,
    rows: Ints, out: Array,
) -> None:  # fmt: skip
    """``out`` (o, 9): navigation errors at ``rows``."""
    m = Phi.shape[0]
    z, new, u = np.zeros(9 + m), np.zeros(9 + m), np.zeros(6)
    for i in range(9):
        z[i] = start[i]
    fix = row = 0
    for k in range(F.shape[0]):
        if k > 0:
            for i in range(m):
                total = 0.0
                for j in range(m):
                    if Phi[i, j] != 0.0:
                        total += Phi[i, j] * z[9 + j]
                new[9 + i] = total
            now = C[min(k, C.shape[0] - 1)]
            for a in range(6):
                u[a] = axes[k, a]
                for j in range(m):
                    u[a] -= now[a, j] * new[9 + j]
            for i in range(9):
                total = 0.0
                for j in range(9):
                    total += F[k, i, j] * z[j]
                for a in range(6):
                    total += B[k, i, a] * u[a]
                new[i] = total
            z, new = new, z
        while fix < epoch.size and epoch[fix] == k:
            for i in range(9 + m):
                total = 0.0
                for j in range(9 + m):
                    total += M[fix, i, j] * z[j]
                for a in range(6):
                    total += N[fix, i, a] * axes[k, a] + K[fix, i, a] * noise[fix, a]
                new[i] = total
            z, new = new, z
            fix += 1
        while row < rows.size and rows[row] == k:
            for i in range(9):
                out[row, i] = z[i]
            row += 1


@njit(cache=True, nogil=True)
def _between(F: Array, B: Array, C: Array, Phi: Array, first: int, last: int, R: Array, gain: Array) -> None:
    """``R`` becomes the transition over all rows, ``gain`` (last - first, n, 6) the effect of each row's axis errors at the end."""
    n, m = R.shape[0], Phi.shape[0]
    x, s = np.zeros(9), np.zeros(m)
    for k in range(last, first, -1):
        now = C[min(k, C.shape[0] - 1)]
        for i in range(n):
            for a in range(6):
                total = 0.0
                for j in range(9):
                    total += R[i, j] * B[k, j, a]
                gain[k - first - 1, i, a] = total
            for j in range(9):
                x[j] = 0.0
                for q in range(9):
                    x[j] += R[i, q] * F[k, q, j]
            for j in range(m):
                s[j] = R[i, 9 + j]
                for a in range(6):
                    s[j] -= gain[k - first - 1, i, a] * now[a, j]
            for j in range(9):
                R[i, j] = x[j]
            for j in range(m):
                total = 0.0
                for q in range(m):
                    if Phi[q, j] != 0.0:
                        total += s[q] * Phi[q, j]
                R[i, 9 + j] = total


@njit(cache=True, nogil=True)
def driven(gain: Array, C: Array, Phi: Array, effect: Array) -> None:
    """What the states behind the axis errors do over the rows of one interval.

    Parameters
    ----------
    gain : (k, n, 6) array
        Effect of each row's axis errors (:meth:`LinearErrors.between`).
    C, Phi : (6, m), (m, m) arrays
        What the axes see of the states, and their transition.
    effect : (k + 1, n, m) array
        Overwritten: effect of what drives the states at each row, preceded by that of the states at the start.
    """
    rows, n, m = gain.shape[0], gain.shape[1], Phi.shape[0]
    here = np.zeros(m)
    for k in range(rows, 0, -1):
        for i in range(n):
            for j in range(m):
                here[j] = 0.0 if k == rows else effect[k, i, j]
                for a in range(6):
                    here[j] += gain[k - 1, i, a] * C[a, j]
            for j in range(m):  # effect[k] holds what reaches row k from behind; it becomes what drives row k
                effect[k, i, j] = here[j]
                total = 0.0
                for q in range(m):
                    if Phi[q, j] != 0.0:
                        total += here[q] * Phi[q, j]
                effect[k - 1, i, j] = total
