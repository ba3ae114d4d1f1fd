"""All designs and the true states from end to end of the outages: one map and one covariance of what noise adds, whatever the rate.

The errors and estimates of all designs and the true states form one linear system, whose noise is Gaussian. Its covariance moves from fix to
fix; what lies between two ends of outages is then one transition and one draw. Where the mean of a record is subtracted from its pieces,
sums of the axes' errors are carried, and what a constant error does.

Source: Gelb (1974), Applied Optimal Estimation, section 7.1 (the joint covariance); conditioning a Gaussian chain is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu.augment import Augmentation
from insemu.filters import Carried, Intervals

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Numbers that are drawn at a time, at most.
BATCH = 1_000_000


@dataclass(frozen=True)
class Joint:
    """The linear errors of D designs along one reference, filled up with zeros to n states each.

    Parameters
    ----------
    intervals : Intervals
    epoch : (f,) array of int
        Rows of the fixes.
    transition, M, N, K : (k, D, n, n), (f, D, n, n), (f, D, n, 6), (f, D, n, 6) arrays
        As in :class:`insemu.filters.LinearErrors`.
    noise : sequence of (f, 6, 6) arrays
        Covariance of the noise of the fixes, of every design; all have the same errors of the receiver.
    """

    intervals: Intervals
    epoch: Ints
    transition: Array
    M: Array
    N: Array
    K: Array
    noise: Sequence[Array]


@dataclass(frozen=True)
class Segment:
    """From one end to the next.

    Parameters
    ----------
    own : (D, n, n) array
        Transition of the designs' errors and estimates.
    seen : (D, n, q) array
        Effect of the true states, their sums and constant errors at the start.
    states : (q, q) array
        Transition of these.
    noise : (D n + p, D n + p) array
        Covariance that is added to errors and true states (with their sums, without constants).
    """

    own: Array
    seen: Array
    states: Array
    noise: Array


@dataclass(frozen=True)
class Segments:
    """See the module.

    Parameters
    ----------
    parts : sequence of Segment
        One per distinct end and, where a mean is removed, one to the end of the flight.
    outage : (outages,) array of int
        The part at whose end each outage ends.
    first : (p, p) array
        Covariance of the true states and their sums at the start of a record.
    before, after : sequences of (p, p), (p, p) arrays
        Transition and added covariance over what lies before and after each piece of a record; empty without records.
    length : int
        Of a record, in samples.
    """

    parts: Sequence[Segment]
    outage: Ints
    first: Array
    before: Sequence[tuple[Array, Array]]
    after: Sequence[tuple[Array, Array]]
    length: int

    @cached_property
    def roots(self) -> tuple[list[Array], list[Array]]:
        """Roots of the covariances of :attr:`before` and :attr:`after`."""
        before, after = ([even_root(noise) for _, noise in side] for side in (self.before, self.after))
        return before, after

    @classmethod
    def of(
        cls, joint: Joint, truth: tuple[Augmentation, Carried], sigma: Array, ends: Ints, record: tuple[int, int]
    ) -> Segments:
        """Move the joint covariance through a flight.

        Parameters
        ----------
        joint : Joint
        truth : (Augmentation, Carried)
            Of the true sensors; with sums where a mean is removed.
        sigma : (9,) array
            Standard deviations of the initial errors, which all designs share.
        ends : (outages,) array of int
            Rows.
        record : (int, int)
            Samples of a record (0: nothing is removed) and of its pieces.
        """
        length, steps = record
        aug, own = truth
        rows = np.unique(ends)
        parts = _parts_up_to(joint, aug, own, sigma, [*rows, len_of(joint)] if length else rows)
        p = aug.m + 6 * (length > 0)
        first = np.zeros((p, p))
        first[: aug.m, : aug.m] = aug.P0
        pieces = range(length // steps if length else 0)
        before = [summed(aug, k * steps) for k in pieces]
        after = [summed(aug, length - (k + 1) * steps) for k in pieces]
        return cls(parts, np.searchsorted(rows, ends).astype(np.int64), first, before, after, length)

    def draw(self, realizations: int, rng: np.random.Generator) -> Array:
        """Navigation errors (realizations, D, outages, 9) at the ends of the outages.

        The numbers of a realization follow each other in the stream, so that the size of a batch changes none. Realizations take the pieces of a
        record by turns.

        Parameters
        ----------
        realizations : int
        rng : Generator
        """
        roots, first, p = [even_root(part.noise) for part in self.parts], even_root(self.first), len(self.first)
        cut = np.cumsum([0, p, p, p, *(len(r) for r in roots)])
        D, n = self.parts[0].own.shape[:2]
        out = np.empty((realizations, D, self.outage.size, 9))
        most = max(1, BATCH // int(cut[-1]))
        for start in range(0, realizations, most):
            count = min(most, realizations - start)
            xi = rng.standard_normal((count, int(cut[-1])))
            place = np.arange(start, start + count) % max(len(self.before), 1)
            s = xi[:, :p] @ first.T
            if self.length:
                s = through_outside(s, xi[:, cut[1] : cut[2]], place, self.before, self.roots[0])
            z, errors = np.zeros((D, count, n)), np.empty((len(self.parts), D, count, 9))
            for k, (part, root) in enumerate(zip(self.parts, roots, strict=True)):
                w = xi[:, cut[3 + k] : cut[4 + k]] @ root.T
                z = z @ part.own.transpose(0, 2, 1) + s @ part.seen[:, :, :p].transpose(0, 2, 1)
                z += w[:, : D * n].reshape(count, D, n).transpose(1, 0, 2)
                s = s @ part.states[:p, :p].T + w[:, D * n :]
                errors[k] = z[:, :, :9]
            if self.length:  # the mean of the whole record is subtracted from its pieces
                s = through_outside(s, xi[:, cut[2] : cut[3]], place, self.after, self.roots[1])
                for k, response in enumerate(self._constants()):
                    errors[k] -= s[:, p - 6 :] / self.length @ response.transpose(0, 2, 1)
            out[start : start + count] = errors[self.outage].transpose(2, 1, 0, 3)
        return out

    def _constants(self) -> list[Array]:
        """What a constant error of each axis does at the end of every part, (D, 9, 6) each."""
        D, n, q = self.parts[0].seen.shape
        moved, out = np.zeros((D, n, 6)), []
        for part in self.parts:
            moved = part.own @ moved + part.seen[:, :, q - 6 :]
            out.append(moved[:, :9])
        return out

    def mean_square(self) -> Array:
        """Mean-square error matrices (outages, D, 9, 9), without a draw; of all pieces of a record together."""
        D, n = self.parts[0].own.shape[:2]
        wide, p = D * n, len(self.first)
        out = np.zeros((len(self.parts), D, 9, 9))
        of_constant = self._constants() if self.length else []
        pieces = range(max(len(self.before), 1))
        for piece in pieces:
            C = np.zeros((wide + p, wide + p))
            C[wide:, wide:] = self.first
            if self.length:
                transition, noise = self.before[piece]
                C[wide:, wide:] = transition @ self.first @ transition.T + noise
            cross = []
            for k, part in enumerate(self.parts):
                C = _both(C, part.own, part.seen[:, :, :p], part.states[:p, :p]) + part.noise
                own = C[:wide].reshape(D, n, -1)[:, :9]
                for d in range(D):
                    out[k, d] += own[d][:, d * n : d * n + 9] / len(pieces)
                cross.append(own[:, :, wide:].copy())
            if not self.length:
                continue
            transition, noise = self.after[piece]
            last = (transition @ C[wide:, wide:] @ transition.T + noise)[p - 6 :, p - 6 :] / self.length**2
            rest = transition[p - 6 :] / self.length
            for k in range(len(self.parts) - 1, -1, -1):
                response = of_constant[k]
                both = cross[k] @ rest.T @ response.transpose(0, 2, 1)
                out[k] += (response @ last @ response.transpose(0, 2, 1) - both - both.transpose(0, 2, 1)) / len(pieces)
                rest = rest @ self.parts[k].states[:p, :p]
        return out[self.outage]


def len_of(joint: Joint) -> int:
    """Last row of the reference."""
    return int(joint.intervals.nodes[-1])


def _parts_up_to(
    joint: Joint, aug: Augmentation, truth: Carried, sigma: Array, ends: Sequence[int] | Ints
) -> list[Segment]:
    """The parts up to every end."""
    D, n = joint.M.shape[1:3]
    m, r = aug.m, truth.effect.shape[1]
    p, q = m + r - 9, m + 2 * (r - 9)
    wide = D * n
    seen = np.zeros((6, q))
    seen[:, :m] = aug.output()
    if r > 9:
        seen[:, q - 6 :] = np.eye(6)
    # rows of the noise of an interval (navigation errors, sums, states): of every design, then of states and sums
    order = np.concatenate([np.arange(9), np.arange(r, r + m), np.arange(9, r)])
    states, effect = np.tile(np.eye(q), (len(truth.effect), 1, 1)), np.zeros((len(truth.effect), n, q))
    states[:, :m, :m], states[:, m:p, :m] = truth.transition, truth.effect[:, 9:]
    effect[:, :9, :m] = truth.effect[:, :9]
    if r > 9:
        unit = joint.intervals.projected(np.ones((int(joint.intervals.nodes[-1]) + 1, 6)))
        effect[:, :9, q - 6 :] = np.einsum("krap,kap->kra", joint.intervals.gain, unit)
    kicks = [joint.K[:, d] @ even_root(noise) for d, noise in enumerate(joint.noise)]
    kick_of = np.concatenate(kicks, axis=1)
    into = joint.N @ seen
    ordered = np.ix_(order, order)
    starts = np.searchsorted(joint.intervals.at(joint.epoch), np.arange(joint.intervals.nodes.size + 1))
    asked = set(joint.intervals.at(np.asarray(ends)).tolist())
    C = np.zeros((wide + p, wide + p))
    C[:wide, :wide] = np.kron(np.ones((D, D)), np.pad(np.diag(sigma**2), (0, n - 9)))
    start = np.tile(np.eye(n), (D, 1, 1)), np.zeros((D, n, q)), np.eye(q)
    own, by, moved = start
    unmoved, passed = np.zeros((D, n, 9 + p)), np.eye(p, 9 + p, 9)
    unmoved[:, range(9), range(9)] = 1.0
    out = []
    for node in range(joint.intervals.nodes.size):
        Z, B, S = start
        if node:
            Z, B, S = joint.transition[node - 1], np.broadcast_to(effect[node - 1], (D, n, q)), states[node - 1]
        W, kick = unmoved, np.zeros((wide, 0))
        for f in range(starts[node], starts[node + 1]):
            M = joint.M[f]
            Z, B, W = M @ Z, M @ B + into[f] @ S, M @ W
            W[:, :, 9:] += into[f, :, :, :p]
            kick = np.hstack([(M @ kick.reshape(D, n, -1)).reshape(wide, -1), kick_of[f]])
        C = _both(C, Z, B[:, :, :p], S[:p, :p])
        if node:
            both = np.concatenate([W.reshape(wide, -1), passed])
            C += both @ truth.noise[node - 1][ordered] @ both.T
        C[:wide, :wide] += kick @ kick.T
        own, by, moved = Z @ own, Z @ by + B @ moved, S @ moved
        if node in asked:
            out.append(Segment(own, by, moved, 0.5 * (C + C.T)))
            C = np.zeros_like(C)
            own, by, moved = start
    return out


def even_root(covariance: Array) -> Array:
    """Roots (..., n, n) of covariances whose correlations have a symmetric root: they change little where the covariance does, and draws with them.

    So scenarios that differ a little are compared under common draws, which roots made of sorted eigenvectors would not give.
    """
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
    some = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / (some[..., :, None] * some[..., None, :]))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(scale[..., :, None] * root)


def _both(C: Array, own: Array, seen: Array, states: Array) -> Array:
    """Move a covariance of errors (D, n) and true states: ``A C A'`` by blocks."""
    D, n = own.shape[:2]

    def half(values: Array) -> Array:
        top = own @ values[: D * n].reshape(D, n, -1) + seen @ values[D * n :]
        return np.concatenate([top.reshape(D * n, -1), states @ values[D * n :]])

    return half(half(C).T)


def through_outside(
    s: Array, xi: Array, place: NDArray[np.intp], maps: Sequence[tuple[Array, Array]], roots: Sequence[Array]
) -> Array:
    """Take true states and sums (realizations, p) through what lies outside their piece of the record.

    Parameters
    ----------
    s : (realizations, p) array
    xi : (realizations, p) array
        Standard normal numbers.
    place : (realizations,) array of int
        Piece of each realization.
    maps : sequence of (p, p), (p, p) arrays
        Transition and added covariance of every piece.
    roots : sequence of (p, p) arrays
        Of these covariances.
    """
    out = np.empty_like(s)
    for k, ((transition, _), root) in enumerate(zip(maps, roots, strict=True)):
        mine = place == k
        out[mine] = s[mine] @ transition.T + xi[mine] @ root.T
    return out


def summed(truth: Augmentation, count: int) -> tuple[Array, Array]:
    """Map (m + 6, m + 6) of the true states and of the sums of the axis errors over so many samples, and the covariance that it adds."""
    C, m = truth.output(), truth.m
    step = np.block([[truth.Phi, np.zeros((m, 6))], [C @ truth.Phi, np.eye(6)]])
    cross = C @ truth.Q
    Q = np.block([[truth.Q, cross.T], [cross, cross @ C.T + np.diag(truth.white)]])
    transition, noise = np.eye(m + 6), np.zeros((m + 6, m + 6))
    while count:
        if count & 1:
            transition, noise = step @ transition, step @ noise @ step.T + Q
        step, Q = step @ step, step @ Q @ step.T + Q
        count >>= 1
    return transition, noise
