"""The state block of a process: the one form that filters, likelihoods and oracles read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

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
            return (
                np.asarray(block_diag(*(getattr(b, name) for b in blocks if b.n))).reshape(n, n)
                if n
                else np.zeros((0, 0))
            )

        return cls(
            names=tuple(name for b in blocks for name in b.names),
            Phi=diagonal("Phi"),
            Q=diagonal("Q"),
            c=np.concatenate([b.c for b in blocks]),
            P0=diagonal("P0"),
            white=sum(b.white for b in blocks),
            dt=dt,
        )

    def accumulated_variances(self, m: int) -> Array:
        """Allan variances for averages of 1, 2, 4, ... up to ``m`` samples of a stationary block, by doubling.

        Sums over adjacent spans are combined exactly: with ``T_a = I + Phi + ... + Phi^(a-1)``, the sum over a + b samples has
        variance ``V_a + V_b + 2 c P T_a' (Phi T_b)' c'``.

        Returns
        -------
        (log2(m) + 1,) array
            Allan variances in unit^2; ``P0`` must be the stationary covariance.
        """
        levels = m.bit_length()
        out = np.empty(levels)
        T, power = np.eye(self.n), self.Phi.copy()
        V = float(self.c @ self.P0 @ self.c)
        for j in range(levels):
            count = 1 << j
            C = float((self.c @ self.P0 @ T.T) @ (self.Phi @ T).T @ self.c)
            out[j] = (V - C) / count**2 + self.white / count
            V = 2.0 * V + 2.0 * C
            T = T + power @ T
            power = power @ power
        return out
