"""A filter's errors to first order from fix to fix: the steps of an interval in one product, the same for all beliefs and truths of a reference.

With the navigation errors x (estimate minus truth) and the estimates s of the axes' errors e, a step is ``s <- Phi s`` and
``x <- F x + B (e - C s)``, a fix ``z <- M z + N e + K n`` with z = (x, s) and the noise n of the fix. Over the rows of an interval
``x <- F x + sum_k g_k (e_k - C s_k)``. The gains g_k change slowly from row to row: they are kept as coefficients of a few orthonormal
polynomials, so that what a process does over an interval is a small product of matrices whatever the rate (:func:`carried`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.augment import Augmentation
from insemu.compiled import njit
from insemu.filters.expanded import MAP_SIZE, fill_map, middle
from insemu.filters.joint import NO_POWER, apply_transposed
from insemu.filters.packed import Samples
from insemu.records import ImuRecord
from insemu.strapdown import fill_dynamics

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Polynomials of a gain over an interval, at most; longest interval at first, s. What they leave of a gain is orthogonal to them, so that a
#: variance is off by the square of the share of the norm that may be left.
TERMS, LONGEST, LEFT = 8, 1.0, 1e-3


@dataclass(frozen=True)
class Intervals:
    """A reference cut at some rows, with the steps in between in one map each.

    Parameters
    ----------
    nodes : (k + 1,) array of int
        Rows, from the first to the last.
    F : (k, 9, 9) array
        Transition of the navigation errors from node to node.
    gain : (k, 9, 6, TERMS) array
        Coefficients of the effect of each row's axis errors at the end of its interval, on the columns of :meth:`basis`.
    """

    nodes: Ints
    F: Array
    gain: Array

    @classmethod
    def of(cls, imu: ImuRecord, nav: Array, gravity: str, nodes: Ints) -> Intervals:
        """Cut a reference at some rows, and further until polynomials describe the gains.

        Parameters
        ----------
        imu : ImuRecord
            Increments along the reference.
        nav : (n, 10) array
            The reference at their rows.
        gravity : str
        nodes : (k,) array of int
            Rows of fixes and evaluations; the first and the last row are added.
        """
        asked = np.unique(np.concatenate([[0], nodes, [len(imu) - 1]])).astype(np.int64)
        longest = max(1, round(LONGEST / imu.dt))
        while True:
            parts = -(-np.diff(asked) // longest)
            cut = np.concatenate(
                [a + d * np.arange(p) // p for a, d, p in zip(asked, np.diff(asked), parts, strict=False)]
            )
            found = np.append(cut, asked[-1]).astype(np.int64)
            lengths, kind = np.unique(np.diff(found), return_inverse=True)
            bases = np.zeros((lengths.size, int(lengths.max()), TERMS))
            for k, length in enumerate(lengths):
                bases[k, :length] = basis(int(length))
            samples = Samples(imu.t, imu.gyro, imu.accel, NO_POWER)
            F, gain, square = _collapse(samples, nav, earth.gravity_code(gravity), found, kind.astype(np.int64), bases)
            left = square - (gain**2).sum(axis=3)
            if longest <= TERMS or (left <= LEFT**2 * square.max(axis=0)).all():
                return cls(found, F, gain)
            longest = -(-longest // 2)

    def at(self, rows: Ints) -> Ints:
        """Numbers of the nodes at some rows, which are nodes."""
        return np.searchsorted(self.nodes, rows).astype(np.int64)

    @cached_property
    def by_length(self) -> list[tuple[int, Ints]]:
        """Numbers of rows, and the intervals (k,) that have so many."""
        lengths = np.diff(self.nodes)
        return [(int(n), np.flatnonzero(lengths == n)) for n in np.unique(lengths)]

    def projected(self, values: Array) -> Array:
        """Values (n, 6) at every row on the polynomials of their intervals: (k, 6, TERMS)."""
        out = np.empty((self.nodes.size - 1, 6, TERMS))
        for length, which in self.by_length:
            rows = self.nodes[which][:, None] + np.arange(1, length + 1)
            out[which] = (basis(length).T @ values[rows]).transpose(0, 2, 1)
        return out

    def drive(self, values: Array) -> Array:
        """What errors of the axes (n, 6) at every row do to the navigation errors within the intervals: (k, 9)."""
        return np.asarray(np.einsum("krap,kap->kr", self.gain, self.projected(values)))


def basis(length: int) -> Array:
    """Orthonormal polynomials over so many rows, (length, TERMS); a row has at most as many as there are rows, the others are zero."""
    terms = min(TERMS, length)
    out = np.zeros((length, TERMS))
    x = np.linspace(-1.0, 1.0, length) if length > 1 else np.zeros(1)
    out[:, :terms] = np.linalg.qr(np.polynomial.legendre.legvander(x, terms - 1))[0]
    return out


@dataclass(frozen=True)
class Carried:
    """What the states behind the axis errors do over the intervals of a reference.

    Parameters
    ----------
    transition : (k, m, m) array
    effect : (k, r, m) array
        Of the states at the start on the errors at the end: nine of navigation and, where they are asked for, six sums of the axes' errors.
    noise : (k, r + m, r + m) array
        Covariance that white and driving noise add, of the errors and the states.
    """

    transition: Array
    effect: Array
    noise: Array


def carried(intervals: Intervals, states: Augmentation, rates: Array | None = None, *, sums: bool = False) -> Carried:
    """What states and white noise of the axes do over the intervals of a reference.

    Parameters
    ----------
    intervals : Intervals
    states : Augmentation
        Of constant levels.
    rates : (k, 6, TERMS) array, optional
        What the triads measure (:meth:`Intervals.projected`, rad/s and m/s^2), for calibration states.
    sums : bool
        Whether the sums of each axis's errors over the rows are carried, too.
    """
    k, m, r, wide = intervals.nodes.size - 1, states.m, 15 if sums else 9, 6 * TERMS
    out = Carried(np.empty((k, m, m)), np.empty((k, r, m)), np.empty((k, r + m, r + m)))
    fixed = np.flatnonzero((states.axis >= 0) & (states.driver < 0))
    driving = root_of(states.Q)
    for length, which in intervals.by_length:
        U = basis(length)
        by_axis = np.zeros((which.size, r, 6, TERMS))
        by_axis[:, :9] = intervals.gain[which]
        for a in range(6 if sums else 0):
            by_axis[:, 9 + a, a] = U.sum(axis=0)
        gain = by_axis.reshape(which.size, r, wide)
        reach, power = np.zeros((6, TERMS, m)), np.eye(m)
        columns = np.empty((length, wide + m, driving.shape[1]))
        for j in range(length - 1, -1, -1):  # what reaches row j from behind, then what drives it
            reach = reach @ states.Phi
            reach[states.axis[fixed], :, fixed] += states.c[fixed, None] * U[j]
            columns[j, :wide] = reach.reshape(wide, m) @ driving
            columns[j, wide:] = power @ driving
            power = power @ states.Phi
        stacked = columns.transpose(1, 0, 2).reshape(wide + m, -1)
        total = stacked @ stacked.T
        total[:wide, :wide] += np.diag(np.repeat(states.white, TERMS))
        cross = gain @ total[:wide, wide:]
        out.noise[which, :r, :r] = (gain @ total[:wide, :wide]) @ gain.transpose(0, 2, 1)
        out.noise[which, :r, r:], out.noise[which, r:, :r] = cross, cross.transpose(0, 2, 1)
        out.noise[which, r:, r:] = total[wide:, wide:]
        out.effect[which] = gain @ (reach @ states.Phi).reshape(wide, m)
        out.transition[which] = power
    for s in np.flatnonzero(states.driver >= 0):
        if rates is None:
            raise ValueError("calibration states need the measured rates")
        seen = intervals.gain[:, :, states.axis[s]]
        out.effect[:, :9, s] = states.c[s] * np.einsum("krp,kp->kr", seen, rates[:, states.driver[s]])
    return out


def root_of(covariance: Array) -> Array:
    """A matrix whose product with its transpose is the covariance, (n, rank)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    some = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(some, some))
    kept = values > 1e-14 * max(values[-1], 1e-300) if values.size else values > 0
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def transitions(intervals: Intervals, belief: Carried) -> Array:
    """Transition of navigation errors and estimates over every interval, (k, 9 + m, 9 + m).

    Parameters
    ----------
    intervals : Intervals
    belief : Carried
        Of the filter's own states.
    """
    m = belief.transition.shape[1]
    out = np.zeros((len(intervals.F), 9 + m, 9 + m))
    out[:, :9, :9], out[:, 9:, 9:] = intervals.F, belief.transition
    out[:, :9, 9:] = -belief.effect[:, :9]
    return out


@dataclass(frozen=True)
class LinearErrors:
    """The linear error system of one design along one reference.

    Parameters
    ----------
    intervals : Intervals
        With a node at every fix.
    transition : (k, 9 + m, 9 + m) array
        Of navigation errors and estimates (:func:`transitions`).
    epoch : (f,) array of int
        Rows at which there is a fix, increasing.
    M, N, K : (f, 9 + m, 9 + m), (f, 9 + m, 6), (f, 9 + m, 6) arrays
        What a fix does with the errors, with the error of the axes at its epoch, and with its own noise.
    """

    intervals: Intervals
    transition: Array
    epoch: Ints
    M: Array
    N: Array
    K: Array

    @property
    def size(self) -> int:
        """Number of errors and estimates."""
        return int(self.M.shape[1])

    @cached_property
    def fixes_at(self) -> list[Sequence[int]]:
        """Numbers of the fixes at every node."""
        out: list[Sequence[int]] = [()] * self.intervals.nodes.size
        for f, node in enumerate(self.intervals.at(self.epoch)):
            out[node] = (*out[node], f)
        return out

    def respond(self, start: Array, drive: Array, axes: Array, noise: Array, rows: Ints) -> Array:
        """Navigation errors of some realizations under given errors of the sensors.

        Parameters
        ----------
        start : (r, 9) array
            Initial navigation errors.
        drive : (r, k, 9) array
            What the errors of the axes do within each interval (:meth:`Intervals.drive`).
        axes : (r, f, 6) array
            Errors of the axes at the fixes, rad/s and m/s^2.
        noise : (r, f, 6) array
            Errors of the fixes, m and m/s.
        rows : (o,) array of int
            Nodes, increasing.

        Returns
        -------
        (r, o, 9) array
            After the fix of that epoch if there is one.
        """
        z = np.zeros((len(start), self.size))
        z[:, :9] = start
        given = axes.transpose(1, 0, 2) @ self.N.transpose(0, 2, 1) + noise.transpose(1, 0, 2) @ self.K.transpose(
            0, 2, 1
        )
        asked = {int(node): k for k, node in enumerate(self.intervals.at(rows))}
        out = np.empty((len(start), rows.size, 9))
        for node, fixes in enumerate(self.fixes_at):
            if node:
                z = z @ self.transition[node - 1].T
                z[:, :9] += drive[:, node - 1]
            for f in fixes:
                z = z @ self.M[f].T + given[f]
            if node in asked:
                out[:, asked[node]] = z[:, :9]
        return out

    def adjoint(self, row: int, L: Array) -> tuple[Array, Array, Array]:
        """What every error of sensors, start and fixes contributes to some linear functionals of the errors at one row.

        Parameters
        ----------
        row : int
            A node, before a fix of that row.
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
        nodes = self.intervals.nodes
        last = int(self.intervals.at(np.array([row]))[0])
        for node in range(last, -1, -1):
            for f in self.fixes_at[node][::-1] if node < last else ():
                gain[nodes[node]] += left @ self.N[f]
                fixes[f] = left @ self.K[f]
                left = left @ self.M[f]
            if node:
                first, end = int(nodes[node - 1]), int(nodes[node])
                seen = np.tensordot(left[:, :9], self.intervals.gain[node - 1], axes=1)
                gain[first + 1 : end + 1] += np.einsum("kap,lp->lka", seen, basis(end - first))
                left = left @ self.transition[node - 1]
        return gain, left[:, :9], fixes


@njit(cache=True, nogil=True)
def _collapse(
    samples: Samples, nav: Array, gravity: int, nodes: Ints, kind: Ints, bases: Array
) -> tuple[Array, Array, Array]:
    """``F``, ``gain`` and the sums of squares (k, 9, 6) of the gains; ``kind`` (k,) says which of ``bases`` an interval has."""
    t, gyro, accel, _ = samples
    count = nodes.size - 1
    F, gain, square = np.zeros((count, 9, 9)), np.zeros((count, 9, 6, TERMS)), np.zeros((count, 9, 6))
    dynamics, C, mid, f_n = np.empty((9, 9)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    w, u, old = np.zeros(MAP_SIZE), np.zeros(6), np.zeros(9)
    for i in range(nodes.size - 1):
        first, last = nodes[i], nodes[i + 1]
        R = F[i]
        for a in range(9):
            R[a, a] = 1.0
        for k in range(last, first, -1):
            dt = t[k] - t[k - 1]
            middle(nav[k - 1, 6:10], gyro[k], accel[k], dt, C, mid, f_n)
            fill_dynamics(nav[k - 1], f_n, gravity, dynamics)
            fill_map(dynamics, mid, dt, w)
            U = bases[kind[i], k - 1 - first]
            for row in range(9):
                apply_transposed(w, 0.5 * dt, R[row], old, u)
                for a in range(6):
                    square[i, row, a] += u[a] * u[a]
                    for p in range(TERMS):
                        gain[i, row, a, p] += u[a] * U[p]
    return F, gain, square


@njit(cache=True, nogil=True)
def driven(gain: Array, C: Array, Phi: Array, effect: Array) -> None:
    """What the states behind the axis errors do over the rows of one interval.

    Parameters
    ----------
    gain : (k, n, 6) array
        Effect of each row's axis errors (:meth:`LinearErrors.adjoint`).
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
