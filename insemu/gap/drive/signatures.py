"""What unit effects do to the innovations of the filter, with the filter in the loop.

A unit effect (a :class:`~insemu.effects.Column`, analytic along the flown trajectory) enters as an error of a sensor, integrated through the
error dynamics, or of the fixes; with the stored transition, gain and Jacobian of the nominal filter ``e- = Phi e+ + D``, ``g = -H e- + M``,
``e+ = e- + K g``. Nothing here knows how the emulator makes an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu.effects import Column, Motion
from insemu.filters import FilterResult
from insemu.gap.evidence import error_kernels
from insemu.gap.evidence.merged import merged_states

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Loop:
    """The nominal filter as a linear machine from sensor errors to whitened innovations.

    Parameters
    ----------
    result : FilterResult
    lower, white : (f, 6, 6) arrays
        Cholesky factors of the innovation covariances and their inverses, zero rows for missing components.
    y : (6 f,) array
        Whitened innovations, zero where missing.
    use : (f, 6) array of bool
    """

    result: FilterResult
    lower: Array
    white: Array
    y: Array
    use: NDArray[np.bool_]

    @classmethod
    def of(cls, result: FilterResult) -> Loop:
        """Whiten the innovations of a stored run."""
        fixes = result.fixes
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        nu = np.where(use, np.nan_to_num(fixes.innovation), 0.0)
        lower, white = whitening(np.nan_to_num(fixes.S), use)
        return cls(result, lower, white, np.einsum("kij,kj->ki", white, nu).ravel(), use)

    def until(self, count: int) -> Loop:
        """The first ``count`` fixes, for what looks at innovations only."""
        return Loop(self.result, self.lower[:count], self.white[:count], self.y[: 6 * count], self.use[:count])

    def half_log_det(self, use: NDArray[np.bool_] | None = None) -> float:
        """Half the log determinants of the innovation covariances, of some components (f, 6) or of all that were used."""
        diagonal = np.einsum("kii->ki", self.lower)
        return float(np.sum(np.log(diagonal[self.use if use is None else use])))

    @cached_property
    def machine(self) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """Transitions, gains and Jacobians of what the fixes can tell apart, and the node of each fix."""
        nodes, fixes = self.result.nodes, self.result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        H = np.where(self.use[:, :, None], np.nan_to_num(fixes.H), 0.0)
        K = np.where(self.use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        sums = merged_states(nodes.Phi[1:], H)
        first = sums.argmax(axis=1)
        at = np.searchsorted(nodes.epoch, fixes.epoch)
        return sums @ nodes.Phi[:, :, first], sums @ K, np.ascontiguousarray(H[:, :, first]), at

    def respond(
        self,
        columns: int,
        D: Array | None,
        M: Array | None,
        at: NDArray[np.int64] | None = None,
        begin: NDArray[np.int64] | None = None,
    ) -> Array:
        """Response of the innovations.

        Parameters
        ----------
        columns : int
        D : (nodes, a, 9) array, optional
            Navigation errors built up since the node before.
        M : (f, 6, columns) array, optional
            Errors of the fixes.
        at : (nodes, a) array of int, optional
            Columns that the entries of ``D`` are added to; every entry to its own where it is not given.
        begin : (columns,) array of int, optional
            Node before which a column is zero, not decreasing.

        Returns
        -------
        (f, 6, columns) array
            Zero where a component is missing.
        """
        Phi, K, H, node = self.machine
        out, none = np.zeros((node.size, 6, columns)), np.zeros((0, 0, 0))
        loop = error_kernels.LoopArrays(Phi, K, H, node, self.use)
        own = np.arange(columns)[None] if at is None else at
        first = np.zeros(columns, dtype=np.int64) if begin is None else np.ascontiguousarray(begin)
        error_kernels.respond(loop, none if D is None else D, own, none if M is None else M, first, out)
        return out

    def whiten(self, raw: Array) -> Array:
        """Whitened responses, (6 f, columns)."""
        return np.asarray((self.white @ raw).reshape(6 * raw.shape[0], raw.shape[2]))


def whitening(S: Array, use: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Cholesky factors (f, 6, 6) of innovation covariances and their inverses, zero rows for missing components.

    Parameters
    ----------
    S : (f, 6, 6) array
        Covariances, m^2 and (m/s)^2.
    use : (f, 6) array of bool
        Components that are there.
    """
    # missing components get a unit variance of their own and then no row
    whole = np.where(use[:, :, None] & use[:, None, :], S, 0.0)
    whole[:, np.arange(6), np.arange(6)] += ~use
    lower = np.linalg.cholesky(whole) if len(whole) else np.zeros((0, 6, 6))
    return np.where(use[:, :, None], lower, 0.0), np.where(use[:, :, None], np.linalg.inv(lower), 0.0)


def columns_response(loop: Loop, motion: Motion, columns: Sequence[Column]) -> Array:
    """Responses (f, 6, columns) of unit columns, m and m/s per unit of the column; zero where a component is missing.

    Parameters
    ----------
    loop : Loop
        The nominal filter.
    motion : Motion
        Of the IMU.
    columns : sequence of Column
        Unit errors of the sensors and of the fixes.
    """
    return loop.respond(len(columns), *built_up(loop, motion, columns))


def built_up(loop: Loop, motion: Motion, columns: Sequence[Column]) -> tuple[Array, Array]:
    """What unit columns do between the nodes of the filter and at its fixes.

    Parameters
    ----------
    loop : Loop
        With the nodes of the filter and the fixes.
    motion : Motion
        Of the IMU, n epochs.
    columns : sequence of Column
        Unit errors of the sensors and of the fixes.

    Returns
    -------
    D : (nodes, columns, 9) array
        Navigation errors built up since the node before; of the first node those of the start.
    M : (f, 6, columns) array
        Errors of the fixes.
    """
    nodes = loop.result.nodes
    assert nodes is not None
    entries = [(j, axis, u) for j, c in enumerate(columns) for axis, u in c.inputs]
    D = (
        _integrated(loop, motion, entries, len(columns))[0]
        if entries
        else np.zeros((nodes.epoch.size, len(columns), 9))
    )
    for j, c in enumerate(columns):
        if c.start is not None:
            D[0, j, :6] = c.start
        if c.runs:
            way = np.cumsum(motion.vel * np.diff(motion.t, prepend=motion.t[0])[:, None], axis=0)[nodes.epoch]
            D[1:, j, :3] += np.diff(way, axis=0)
    M = np.zeros((len(loop.result.fixes), 6, len(columns)))
    for j, c in enumerate(columns):
        if c.fixes is not None:
            M[:, :, j] = c.fixes
    return D, M


def ramps(loop: Loop, motion: Motion) -> Array:
    """Navigation errors (nodes, 12, 9) built up since the node before by a constant (0..5) and by a ramp from 0 to 1 (6..11) on each axis.

    Parameters
    ----------
    loop : Loop
        With the nodes of the filter.
    motion : Motion
        Of the IMU.
    """
    return _integrated(loop, motion, [], 0)[1]


def _integrated(
    loop: Loop, motion: Motion, entries: Sequence[tuple[int, int, Array]], columns: int
) -> tuple[Array, Array]:
    """Errors built up between nodes by entries (column, axis, unit error), and where there are no entries by constants and ramps."""
    nodes = loop.result.nodes
    assert nodes is not None
    D = np.zeros((nodes.epoch.size, columns, 9))
    ramp = np.zeros((nodes.epoch.size, 0 if entries else 12, 9))
    u = np.ascontiguousarray(np.stack([e[2] for e in entries])) if entries else np.zeros((0, motion.t.size))
    axis = np.array([e[1] for e in entries], dtype=np.int64)
    column = np.array([e[0] for e in entries], dtype=np.int64)
    track = error_kernels.Track(motion.t, np.ascontiguousarray(motion.C), motion.f_n, nodes.epoch)
    error_kernels.integrate_inputs(track, u, axis, column, D, ramp)
    return D, ramp


def knot_response(loop: Loop, motion: Motion, ramp: Array, knots: Array, axis: int) -> Array:
    """Responses of slow errors of an axis of the sensors: linear between knots, one column per knot.

    Parameters
    ----------
    loop : Loop
        The nominal filter.
    motion : Motion
        Of the IMU.
    ramp : (nodes, 12, 9) array
        From :func:`ramps`.
    knots : (k,) array
        Times, s.
    axis : int
        0 to 5.

    Returns
    -------
    (f, 6, knots) array
    """
    nodes = loop.result.nodes
    assert nodes is not None
    t, count = motion.t[nodes.epoch], knots.size
    hats = np.stack([np.interp(t, knots, row) for row in np.eye(count)], axis=1)  # (nodes, knots)
    start, rise = np.zeros_like(hats), np.zeros_like(hats)
    start[1:], rise[1:] = hats[:-1], np.diff(hats, axis=0)
    # between two nodes only the knots around them count
    touched = (start != 0.0) | (rise != 0.0)
    first = np.where(touched.any(axis=1), touched.argmax(axis=1), 0)
    last = np.where(touched.any(axis=1), count - 1 - touched[:, ::-1].argmax(axis=1), 0)
    width = int(np.max(last - first)) + 1
    at = np.minimum(first, count - width)[:, None] + np.arange(width)
    start, rise = np.take_along_axis(start, at, axis=1), np.take_along_axis(rise, at, axis=1)
    begin = np.where(touched.any(axis=0), touched.argmax(axis=0), t.size)
    begin = np.minimum.accumulate(begin[::-1])[::-1]
    D = start[:, :, None] * ramp[:, axis, None] + rise[:, :, None] * ramp[:, 6 + axis, None]
    return loop.respond(count, D, None, at, begin)


def fix_step_response(loop: Loop, units: Array, starts: Array) -> Array:
    """Responses of errors of the fixes that are there from a start on.

    Parameters
    ----------
    loop : Loop
        The nominal filter.
    units : (k, f, 6) or (k, 1, 6) array
        Unit errors of the fixes.
    starts : (s,) array
        s, not decreasing.

    Returns
    -------
    (f, 6, k s) array
        All units for each start.
    """
    fixes, node = loop.result.fixes, loop.machine[3]
    count = len(units)
    M = np.zeros((len(fixes), 6, count * starts.size))
    for k, unit in enumerate(units):
        M[:, :, k::count] = unit[:, :, None] * (fixes.t[:, None, None] > starts)
    first = np.minimum(np.searchsorted(fixes.t, starts, side="right"), len(fixes) - 1)
    return loop.respond(M.shape[2], None, M, begin=np.repeat(node[first], count))


def bias_steps(loop: Loop, motion: Motion, starts: Array) -> Array:
    """Share of the time since the node before that lies behind each start.

    Parameters
    ----------
    loop : Loop
        With the nodes of the filter.
    motion : Motion
        Of the IMU.
    starts : (k,) array
        s.

    Returns
    -------
    (nodes, k) array
    """
    nodes = loop.result.nodes
    assert nodes is not None
    t = motion.t[nodes.epoch]
    width = np.diff(t, prepend=t[0] - 1.0)
    return np.asarray(np.clip((t[:, None] - starts) / width[:, None], 0.0, 1.0))
