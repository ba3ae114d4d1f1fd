"""The state block of a process: the one form that filters, likelihoods and oracles read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StateBlock:
    """Discrete state space of an error signal at one sampling interval.

    ``x_k = Phi x_(k-1) + w_k``, ``cov w = Q``; the sample is ``y_k = c x_k + v_k``, ``var v = white``; ``x_0 ~ (0, P0)``.

    Parameters
    ----------
    names : tuple of str
        One name per state.
    Phi, Q, P0 : (n, n) arrays
        Transition, driving covariance, initial covariance.
    c : (n,) array
        What a sample sees of the state.
    white : float
        Variance of the sample's own white noise, unit^2.
    dt : float
        Sampling interval in s.
    """

    names: tuple[str, ...]
    Phi: Array
    Q: Array
    c: Array
    P0: Array
    white: float
    dt: float

    def __post_init__(self) -> None:
        n = len(self.names)
        for name, shape in (("Phi", (n, n)), ("Q", (n, n)), ("c", (n,)), ("P0", (n, n))):
            value = np.array(getattr(self, name), dtype=np.float64).reshape(shape)
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.names)

    @classmethod
    def empty(cls, dt: float, white: float = 0.0) -> StateBlock:
        """A block without states: white noise only."""
        nothing = np.zeros((0, 0))
        return cls((), nothing, nothing, np.zeros(0), nothing, white, dt)

    @classmethod
    def stack(cls, blocks: list[StateBlock], dt: float) -> StateBlock:
        """The block of a sum of independent processes."""
        if not blocks:
            return cls.empty(dt)
        n = sum(b.n for b in blocks)

        def diagonal(name: str) -> Array:
            whole, k = np.zeros((n, n)), 0
            for b in blocks:
                whole[k : k + b.n, k : k + b.n] = getattr(b, name)
                k += b.n
            return whole

        return cls(
            names=tuple(name for b in blocks for name in b.names),
            Phi=diagonal("Phi"),
            Q=diagonal("Q"),
            c=np.concatenate([b.c for b in blocks]),
            P0=diagonal("P0"),
            white=sum(b.white for b in blocks),
            dt=dt,
        )

    def roots(self) -> tuple[Array, Array]:
        """Matrices whose squares are ``Q`` and ``P0``, which may be singular."""
        out = []
        for covariance in (self.Q, self.P0):
            values, vectors = np.linalg.eigh(covariance)
            out.append(np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0))))
        return out[0], out[1]

    @property
    def memory(self) -> float:
        """Time in s in which the slowest of its states forgets all but 1 / e: zero without states, inf where one never forgets."""
        slowest = float(np.max(np.abs(np.linalg.eigvals(self.Phi)), initial=0.0))
        if slowest >= 1.0:
            return math.inf
        return -self.dt / math.log(slowest) if slowest > 0.0 else 0.0

    def accumulated(self, counts: Sequence[int]) -> tuple[Array, Array]:
        """The state together with the sum of its samples, carried over spans of samples: ``z = (x, S)``, ``z' = F z + e``, ``cov e = V``.

        Parameters
        ----------
        counts : sequence of int
            Samples per span, at least 1.

        Returns
        -------
        F, V : (k, n + 1, n + 1) arrays
            By repeated squaring, without the samples' own white noise.
        """
        n = self.n
        one_F, one_V = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
        one_F[:n, :n], one_F[n, :n], one_F[n, n] = self.Phi, self.c @ self.Phi, 1.0
        to = np.vstack([np.eye(n), self.c[None, :]])
        one_V[:] = to @ self.Q @ to.T
        F = np.broadcast_to(np.eye(n + 1), (len(counts), n + 1, n + 1)).copy()
        V = np.zeros_like(F)
        left = np.asarray(counts, dtype=np.int64)
        while left.any():
            odd = (left & 1).astype(bool)
            V[odd] = one_F @ V[odd] @ one_F.T + one_V
            F[odd] = one_F @ F[odd]
            one_V = one_F @ one_V @ one_F.T + one_V
            one_F = one_F @ one_F
            left >>= 1
        return F, V

    def difference_covariance(self, m: int, count: int) -> Array:
        """Autocovariance of the differences of successive means of ``m`` samples, at lags 0 ... ``count - 1`` means.

        The initial state counts as it is; it cancels where the differences are stationary, as those of a random walk are.

        Returns
        -------
        (count,) array
            unit^2.
        """
        n = self.n
        F, V = (a[0] for a in self.accumulated([m]))
        step, s = F[:n, :n], F[n, :n]
        # D_k = g x_k + u e_k + v e_(k+1): state at the start of a mean, noise within it and within the next
        g = s @ (step - np.eye(n))
        u, v = np.append(s, -1.0), np.append(np.zeros(n), 1.0)
        out = np.zeros(count)
        white = self.white * m
        out[:1] = g @ self.P0 @ g + u @ V @ u + v @ V @ v + 2.0 * white
        if count > 1:
            ahead = step @ self.P0 @ g + V[:n] @ u
            out[1] = g @ ahead + v @ V @ u - white
        if count > 2:
            out[2:] = _powers_of_row(g, step, count - 2) @ (step @ ahead + V[:n] @ v)
        return out / float(m) ** 2

    def allan_variance(self, m: ArrayLike) -> Array:
        """Allan variance of averages of ``m`` samples: half the mean square of the difference of successive means.

        Returns
        -------
        array of the shape of ``m``
            unit^2.
        """
        n, counts = self.n, np.asarray(m, dtype=np.int64)
        flat = counts.ravel()
        F, V = self.accumulated(flat.tolist())
        s = F[:, n, :n]
        g = np.einsum("ki,kij->kj", s, F[:, :n, :n] - np.eye(n))
        u = np.hstack([s, -np.ones((flat.size, 1))])
        square = np.einsum("ki,ij,kj->k", g, self.P0, g) + np.einsum("ki,kij,kj->k", u, V, u) + V[:, n, n]
        return np.asarray(0.5 * (square + 2.0 * flat * self.white) / flat.astype(np.float64) ** 2).reshape(counts.shape)

    def mean_variance(self, m: int) -> float:
        """Variance of the mean of ``m`` samples that start at ``P0``, unit^2."""
        F, V = (a[0] for a in self.accumulated([m]))
        s = F[self.n, : self.n]
        return float(s @ self.P0 @ s + V[self.n, self.n] + m * self.white) / float(m) ** 2

    def autocovariance(self, lag: ArrayLike) -> Array:
        """Autocovariance at ``lag`` samples, unit^2; ``P0`` must be the stationary covariance."""
        lags = np.abs(np.asarray(lag, dtype=np.int64))
        gamma = _powers_of_row(self.c, self.Phi, int(lags.max(initial=0)) + 1) @ (self.P0 @ self.c)
        gamma[0] += self.white
        return np.asarray(gamma[lags])

    def psd(self, f: ArrayLike) -> Array:
        """Two-sided PSD of the samples, unit^2/Hz; states without driving noise have none."""
        turn = np.exp(-2j * np.pi * np.asarray(f, dtype=np.float64) * self.dt)
        driven = np.flatnonzero(np.any(self.Q != 0.0, axis=0))
        if not driven.size:
            return np.full(turn.shape, self.white * self.dt)
        # rows c (I - Phi z^-1)^-1, one per frequency
        system = np.eye(self.n) - turn[..., None, None] * self.Phi.T
        rows = np.linalg.solve(system, np.broadcast_to(self.c[:, None], (*turn.shape, self.n, 1)))[..., 0]
        return np.asarray(self.dt * (np.einsum("...i,ij,...j->...", rows, self.Q, rows.conj()).real + self.white))


def _powers_of_row(row: Array, step: Array, count: int) -> Array:
    """Rows ``row step^k`` for k = 0 ... ``count - 1``, by doubling."""
    out = np.empty((count, row.size))
    out[:1] = row
    done, power = 1, np.array(step)
    while done < count:
        more = min(done, count - done)
        out[done : done + more] = out[:more] @ power
        power = power @ power
        done += more
    return out
