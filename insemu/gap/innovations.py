"""Evidence on the whitened innovations of a dynamic recording: one currency for deterministic, slow, timing and GNSS effects.

Under the nominal model the whitened innovations y are standard normal. An effect adds ``G theta``; with a Gaussian prior on theta its log Bayes
factor is closed. Slow stochastic processes are the same thing with knots for theta and the process's covariance for the prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.gap.evidence import PRIOR_SCALES, log_mean_exp

Array = NDArray[np.float64]


@dataclass
class Field:
    """Everything that the evidence needs of one recording.

    Parameters
    ----------
    y : (r,) array
        Whitened innovations of the used components.
    G : (r, c) array
        Unit responses of all columns.
    variance : float
        Common factor of the innovations' variance, which stands for noise levels that are a little off.
    """

    y: Array
    G: Array
    variance: float = 1.0
    A: Array = field(init=False, repr=False)
    b: Array = field(init=False, repr=False)
    yy: float = field(init=False)

    def __post_init__(self) -> None:
        self.A = self.G.T @ self.G
        self.b = self.G.T @ self.y
        self.yy = float(self.y @ self.y)

    def log_factor(self, blocks: Sequence[tuple[NDArray[Any], Array]]) -> float:
        """Log Bayes factor of blocks ``(column indices, prior root)`` together against nothing."""
        if not blocks:
            return 0.0
        index = np.concatenate([i for i, _ in blocks])
        sizes = [r.shape[1] for _, r in blocks]
        root = np.zeros((index.size, sum(sizes)))
        row = col = 0
        for i, r in blocks:
            root[row : row + i.size, col : col + r.shape[1]] = r
            row, col = row + i.size, col + r.shape[1]
        A = self.A[np.ix_(index, index)] / self.variance
        b = self.b[index] / self.variance
        M = root.T @ A @ root
        M[np.diag_indices_from(M)] += 1.0
        rb = root.T @ b
        L = np.linalg.cholesky(M)
        z = np.linalg.solve(L, rb)
        return 0.5 * float(z @ z) - float(np.sum(np.log(np.diag(L))))

    def posterior(self, blocks: Sequence[tuple[NDArray[Any], Array]]) -> tuple[NDArray[np.int64], Array, Array]:
        """Indices, mean and covariance of the coefficients of all blocks together."""
        index = np.concatenate([i for i, _ in blocks])
        precision = np.zeros((index.size, index.size))
        row = 0
        for i, r in blocks:
            s = slice(row, row + i.size)
            precision[s, s] = np.linalg.inv(r @ r.T + 1e-12 * np.trace(r @ r.T) / i.size * np.eye(i.size))
            row += i.size
        covariance = np.linalg.inv(self.A[np.ix_(index, index)] / self.variance + precision)
        return index.astype(np.int64), covariance @ (self.b[index] / self.variance), covariance

    def rows(self, keep: NDArray[np.bool_]) -> Field:
        """The same on some of the rows."""
        return Field(self.y[keep], self.G[keep], self.variance)


def scaled(scales: Array, factor: float) -> Array:
    """Prior root of independent coefficients."""
    return np.diag(scales * factor)


def group_evidence(
    data: Field, index: NDArray[Any], scales: Array, given: Sequence[tuple[NDArray[Any], Array]] = ()
) -> tuple[float, float]:
    """Evidence of a group of columns beside blocks that are given, averaged over prior scales.

    Returns
    -------
    (log Bayes factor, best prior scale)
    """
    base = data.log_factor(given)
    each = [data.log_factor([*given, (index, scaled(scales, c))]) - base for c in PRIOR_SCALES]
    return log_mean_exp(each), PRIOR_SCALES[int(np.argmax(each))]


# -- slow processes on knots ----------------------------------------------------------------------------------------------------------


def knot_times(start: float, end: float, spacing: float) -> Array:
    """Knots from start to end, at most ``spacing`` apart."""
    return np.linspace(start, end, max(4, math.ceil((end - start) / spacing) + 1))


def random_walk_root(t: Array) -> Array:
    """Root of the covariance of a unit random walk from zero at the first knot."""
    steps = np.sqrt(np.diff(t))
    return np.concatenate([np.zeros((1, steps.size)), np.tril(np.ones((steps.size, steps.size))) * steps[None, :]])


def gauss_markov_root(t: Array, tau: float) -> Array:
    """Root of the covariance of a unit Gauss-Markov process."""
    C = np.exp(-np.abs(t[:, None] - t[None, :]) / tau)
    return np.asarray(np.linalg.cholesky(C + 1e-9 * np.eye(t.size)), dtype=np.float64)


def flicker_root(t: Array) -> Array:
    """Root of the covariance of unit flicker between the knots' spacing and their span: Gauss-Markov processes per factor of 2 in time."""
    times = np.geomspace(
        np.diff(t).min(), 3.0 * (t[-1] - t[0]), 1 + math.ceil(math.log2(3.0 * (t[-1] - t[0]) / np.diff(t).min()))
    )
    step = math.log(times[1] / times[0])
    C = np.asarray(sum(np.exp(-np.abs(t[:, None] - t[None, :]) / tau) for tau in times)) * step / math.pi
    return np.asarray(np.linalg.cholesky(C + 1e-9 * C[0, 0] * np.eye(t.size)), dtype=np.float64)


@dataclass(frozen=True)
class SlowFit:
    """A slow process on one axis: evidence averaged over its grid, the best parameters and their spread."""

    gain: float
    values: tuple[float, ...]
    spread: tuple[float, ...]
    root: Array


def slow_evidence(
    data: Field,
    index: NDArray[Any],
    roots: Sequence[tuple[tuple[float, ...], Array]],
    amplitudes: Array,
    given: Sequence[tuple[NDArray[Any], Array]],
) -> SlowFit:
    """Average over amplitudes and shapes (each alike before the data); posterior mean and spread in logarithms.

    Parameters
    ----------
    roots : sequence of (shape parameters, unit root)
    amplitudes : (a,) array
        Geometric grid.
    """
    base = data.log_factor(given)
    grid = [
        (a, shape, root, data.log_factor([*given, (index, root * a)]) - base)
        for shape, root in roots
        for a in amplitudes
    ]
    logs = np.array([g[3] for g in grid])
    p = np.exp(logs - logs.max())
    p /= p.sum()
    best = grid[int(np.argmax(logs))]
    table = np.log(np.array([(g[0], *g[1]) for g in grid]))
    mean = p @ table
    sd = np.sqrt(p @ (table - mean) ** 2)
    step = 0.5 * math.log(amplitudes[1] / amplitudes[0])
    return SlowFit(
        log_mean_exp(logs),
        tuple(float(v) for v in np.exp(mean)),
        tuple(float(max(s, step)) for s in sd),
        best[2] * best[0],
    )
