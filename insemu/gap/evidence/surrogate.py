"""The nominal filter seen from outside: a filter on its error weighs what noise the fixes have beyond what it believed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EffectUse, filter_memory
from insemu.filters import FilterResult
from insemu.gap.evidence import surrogate_kernels
from insemu.gap.evidence.merged import between_fixes, merged_states
from insemu.lanes import LANES, lanes_of

Array = NDArray[np.float64]


class Colour(NamedTuple):
    """A Gauss-Markov part of the fixes.

    Parameters
    ----------
    sigma : (6,) array
        Standard deviations, m and m/s; where it follows the stated ones, at the median of these.
    tau : float
        Correlation time, s.
    follows : bool
        Whether its variances go with those that the receiver states, as the error of the receiver's own filter does.
    """

    sigma: Array
    tau: float
    follows: bool = False

    @classmethod
    def of(cls, use: EffectUse) -> Colour:
        """Of the positions, from ``gnss_correlated_noise``."""
        return cls(np.concatenate([use["sigma"], np.zeros(3)]), use.scalar("tau"), use.scalar("follows") > 0.5)


#: No Gauss-Markov part.
PLAIN = Colour(np.zeros(6), 1.0)


@dataclass(frozen=True)
class FixNoise:
    """Noise of the fixes beyond what the filter believed: levels (6,) as ratios to it, and a Gauss-Markov part, which stays where it is known."""

    factor: Array
    colour: Colour
    known: bool = False

    def loudness(self, sigma: Array) -> Array:
        """Standard deviations (6,) of the fixes, colour included, over those that the filter believed, ``sigma`` (m, m/s; 0 where unknown)."""
        known = sigma > 0.0
        return np.where(known, np.hypot(self.factor, self.colour.sigma / np.where(known, sigma, 1.0)), 1.0)

    def split(self, sigma: Array) -> tuple[Array, FixNoise]:
        """Ratios (6,) of standard deviations for a filter that does not follow the colour, and what this noise is to that filter.

        Parameters
        ----------
        sigma : (6,) array
            As in :meth:`loudness`.
        """
        loud = self.loudness(sigma)
        return loud, replace(self, factor=self.factor / loud)


#: Noise of the fixes as the filter believed it, known to have no Gauss-Markov part.
WHITE = FixNoise(np.ones(6), PLAIN, known=True)


@dataclass(frozen=True)
class Gains:
    """What a filter on the error of another one does with its innovations, whatever these are.

    Parameters
    ----------
    phi, variance : (f, 6), (6,) arrays
        Transition to each fix and variance of a Gauss-Markov part of the fixes.
    gain, root : (f, 6, m), (f, 6) arrays
        What a standard deviation of a component moves the states by, and that standard deviation.
    done : int
        Fixes up to the first whose variance is not positive.
    volume : float
        Log density of innovations of zero, without the constant; minus infinity where not all fixes are done.
    """

    phi: Array
    variance: Array
    gain: Array
    root: Array
    done: int
    volume: float


@dataclass(frozen=True)
class Surrogate:
    """The nominal filter seen from outside: transitions, gains and noises per fix, ready for :func:`surrogate_kernels.surrogate_gains`.

    The noise of a fix counts as independent between its components; what the gyros' noise on the lever arm correlates is left out. ``settled`` (6,)
    is the level of each component that is known, over the stated one; ``first`` (6,) are variances of the fix that the filter started on, whose
    error is that of the start, as it believed them; ``stated`` (f, 6) are the variances of the fixes over the medians of the whole recording,
    those of the fix before where a component is missing.
    """

    t: Array
    Phi: Array
    Q: Array
    K: Array
    H: Array
    R: Array
    P0: Array
    nu: Array
    use: NDArray[np.int64]
    settled: Array = field(default_factory=lambda: np.ones(6))
    first: Array = field(default_factory=lambda: np.zeros(6))
    stated: Array = field(default_factory=lambda: np.ones((0, 6)))

    def __post_init__(self) -> None:
        if self.stated.size == 0:
            object.__setattr__(self, "stated", _over_medians(self.R, self.use))

    @classmethod
    def of(cls, result: FilterResult) -> Surrogate:
        """From a stored run; nodes without a fix are joined to the next one with a fix."""
        nodes, fixes = result.nodes, result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        H = np.where(use[:, :, None], np.nan_to_num(fixes.H), 0.0)
        K = np.where(use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        sums = merged_states(nodes.Phi[1:], H)
        first = sums.argmax(axis=1)
        at = np.searchsorted(nodes.epoch, fixes.epoch)
        since = np.diff(at, prepend=0)
        Phi, Q = between_fixes(nodes.Phi, nodes.P_before, nodes.P_after, at, sums.argmax(axis=0), first)
        S, before = np.nan_to_num(fixes.S), nodes.P_before[at]
        for k in np.flatnonzero(since == 0):
            if k > 0:  # the second fix of an epoch: the filter had the first one by then
                before[k] = before[k - 1] - K[k - 1] @ S[k - 1] @ K[k - 1].T
        believed = np.einsum("kii->ki", S) - np.sum((H @ before) * H, axis=2)
        return cls(
            fixes.t, Phi, Q, np.ascontiguousarray(sums @ K), np.ascontiguousarray(H[:, :, first]), np.where(use, believed, 0.0),
            sums @ nodes.P_after[0] @ sums.T, np.where(use, np.nan_to_num(fixes.innovation), 0.0), use.astype(np.int64),
        )  # fmt: skip

    def until(self, cut: float) -> Surrogate:
        """The fixes up to a time."""
        k = int(np.searchsorted(self.t, cut, side="right"))
        arrays = {name: getattr(self, name)[:k] for name in ("t", "Phi", "Q", "K", "H", "R", "nu", "use", "stated")}
        return replace(self, **arrays)

    def sigma(self) -> Array:
        """Median believed standard deviation of each component, (6,); zero where there is none."""
        out = np.zeros(6)
        for i in range(6):
            if self.use[:, i].any():
                out[i] = math.sqrt(float(np.median(self.R[self.use[:, i] == 1, i])))
        return out

    def stated_vary(self, ratio: float) -> bool:
        """Whether the stated standard deviations of a position differ by more than a ratio."""
        return bool((self.stated[:, :3].max(axis=0) > ratio**2 * self.stated[:, :3].min(axis=0)).any())

    def whiten(self, columns: Array, factor: Array | None = None, colour: Colour | None = None) -> tuple[Array, float]:
        """Columns (f, 6, c) whitened under other levels and a Gauss-Markov part of the fixes, and the first one's log-likelihood.

        Parameters
        ----------
        columns : (f, 6, c) array
            Innovations or responses of them, m and m/s.
        factor : (6,) array, optional
            Ratios of the standard deviations of the fixes to those that the filter used.
        colour : Colour, optional

        Returns
        -------
        white : (f, 6, c) array
            Zero where a component is missing.
        log_likelihood : float
            Of the first column; minus infinity where it is not finite.
        """
        noise = FixNoise(np.ones(6) if factor is None else factor, PLAIN if colour is None else colour)
        gains = self.gains(noise)
        white = self.whitened(columns, gains)
        value = gains.volume - 0.5 * float(np.sum(white[:, :, 0] ** 2))
        return white, value if math.isfinite(value) else -math.inf

    def gains(self, noise: FixNoise, S: Array | None = None) -> Gains:
        """What a filter on the error of this one does with any innovations under a noise of the fixes.

        Parameters
        ----------
        noise : FixNoise
        S : (f, 6, 6) array, optional
            Overwritten with the covariances of the fixes given those before.
        """
        sigma = noise.colour.sigma
        phi, drive, variance = self.memory(noise.colour)
        m = self.P0.shape[0] + np.count_nonzero(sigma)
        gain, root = np.zeros((self.t.size, 6, m)), np.zeros((self.t.size, 6))
        done = surrogate_kernels.surrogate_gains(
            self.Phi, self.Q, self.H, self.R, self.P0, self.first, self.use, noise.factor,
            phi, drive, variance, gain, root, np.empty((0, 6, 6)) if S is None else S,
        )  # fmt: skip
        volume = -float(np.sum(np.log(root[root > 0.0]))) if done == self.t.size else -math.inf
        return Gains(phi, variance, gain, root, done, volume)

    def memory(self, colour: Colour) -> tuple[Array, Array, Array]:
        """Transitions (f, 6) and driving variances (f, 6) of a Gauss-Markov part to each fix, and its variances (6,) at the first, m^2 and (m/s)^2.

        Where it follows the stated variances P it has the memory of a Kalman filter's error: see :func:`insemu.effects.filter_memory`.

        Parameters
        ----------
        colour : Colour
        """
        P = self.stated if colour.follows else np.ones_like(self.stated)
        phi = np.concatenate([np.ones((1, 6)), filter_memory(np.diff(self.t), P, colour.tau)])
        drive = P - phi**2 * np.concatenate([P[:1], P[:-1]])
        return phi, drive * colour.sigma**2, P[0] * colour.sigma**2

    def whitened(self, columns: Array, gains: Gains, ahead: Array | None = None) -> Array:
        """Columns (f, 6, c), innovations or responses of them (m, m/s), whitened by a filter on the error of this one; zero where missing.

        Parameters
        ----------
        columns : (f, 6, c) array
        gains : Gains
            From :meth:`gains`.
        ahead : (f, 6) array, optional
            Overwritten with the first column less what the fixes before say of it.
        """
        white, own = np.zeros_like(columns), np.empty((0, 6)) if ahead is None else ahead
        surrogate_kernels.surrogate_whitened(
            self.Phi, self.K, self.H, np.ascontiguousarray(columns[: gains.done]), self.use,
            gains.phi, gains.variance, gains.gain, gains.root, white, own,
        )  # fmt: skip
        return white

    def ahead(self, nu: Array, noise: FixNoise, more: Array) -> tuple[Array, Array]:
        """Innovations less what the fixes before say of them under a noise of the fixes, (f, 6), and their covariances, (f, 6, 6).

        Parameters
        ----------
        nu : (f, 6) array
            Innovations, m and m/s.
        noise : FixNoise
        more : (f, 6) array
            Added to the variances of fixes that say little of those behind them, m^2; their own covariances are those without it.
        """
        out, S = np.zeros((len(nu), 6)), np.zeros((len(nu), 6, 6))
        gains = replace(self, R=self.R + more / noise.factor**2).gains(noise, S)
        self.whitened(nu[:, :, None], gains, out)
        S -= more[:, :, None] * np.eye(6)
        return out, S

    def leave_one_out(self, nu: Array, noise: FixNoise, more: Array) -> tuple[Array, Array]:
        """Positions and velocities less what all other components of all fixes say of them under a noise of the fixes, and their covariances.

        Parameters
        ----------
        nu : (f, 6) array
            Innovations, m and m/s.
        noise : FixNoise
        more : (f, 6) array
            Added to the variances of fixes that say little of the others, m^2; their own covariances are those without it.

        Returns
        -------
        out : (f, 6) array
            Zero where a component is missing.
        S : (f, 6, 6) array
            Of positions and of velocities, which a block holds each; an infinite variance where a component is missing.
        """
        gains = replace(self, R=self.R + more / noise.factor**2).gains(noise)
        if gains.done < self.t.size:
            raise np.linalg.LinAlgError("a fix has no positive variance")
        white = self.whitened(nu[:, :, None], gains)[:, :, 0]
        u, D, S = np.zeros(nu.shape), np.zeros((len(nu), 6, 6)), np.zeros((len(nu), 6, 6))
        surrogate_kernels.surrogate_left_out(
            self.Phi, self.H, self.use, gains.phi, gains.variance, gains.gain, gains.root, white, u, D
        )
        there = self.use == 1
        for own in (slice(0, 3), slice(3, 6)):
            D[:, own, own] += ~there[:, own, None] * np.eye(3)
            S[:, own, own] = np.linalg.inv(D[:, own, own])
        out = np.einsum("kij,kj->ki", S, u)
        S[:, np.arange(6), np.arange(6)] = np.where(there, np.einsum("kii->ki", S) - more, math.inf)
        return out, S

    def log_likelihood(self, factor: Array | None = None, colour: Colour | None = None) -> float:
        """Log-likelihood with other levels and a Gauss-Markov part of the fixes."""
        return self.whiten(self.nu[:, :, None], factor, colour)[1]

    def log_likelihoods(self, noises: Sequence[FixNoise]) -> Array:
        """Log-likelihoods of several noises of the fixes, eight in one pass; minus infinity where one is not finite."""
        sigma, rate = np.stack([n.colour.sigma for n in noises]), np.array([1.0 / n.colour.tau for n in noises])
        follows = np.array([float(n.colour.follows) for n in noises])
        factor = np.stack([n.factor for n in noises])
        # a pass carries a state for every component that one of its eight colours: like goes with like
        order = np.argsort(np.count_nonzero(sigma, axis=1), kind="stable")
        order = np.concatenate([order, np.repeat(order[-1:], -order.size % LANES)])
        blocks = (order.size // LANES, LANES)
        out = np.empty(blocks)
        ratio, variance = (
            lanes_of(np.ascontiguousarray(np.moveaxis(v[order].reshape(*blocks, 6) ** 2, 1, 2)))
            for v in (factor, sigma)
        )
        surrogate_kernels.surrogate_likelihoods(
            self.Phi, self.Q, self.K, self.H, self.R, self.P0, self.first, self.nu, self.use, np.diff(self.t, prepend=self.t[0]),
            self.stated, ratio, variance, lanes_of(rate[order].reshape(blocks)), lanes_of(follows[order].reshape(blocks)), lanes_of(out),
        )  # fmt: skip
        values = np.empty(len(noises))
        values[order] = out.ravel()
        return np.where(np.isfinite(values), values, -math.inf)


def _over_medians(R: Array, use: NDArray[np.int64]) -> Array:
    """Variances (f, 6) over the medians of those that are used; that of the fix before where one is not, ones where none is."""
    out = np.ones(R.shape)
    for i in np.flatnonzero(use.any(axis=0)):
        there = use[:, i] == 1
        first = int(np.argmax(there))
        last = np.maximum(np.maximum.accumulate(np.where(there, np.arange(there.size), 0)), first)
        out[:, i] = R[last, i] / np.median(R[there, i])
    return out
