"""Evidence on the whitened innovations of a dynamic recording: one currency for deterministic, slow, timing and GNSS effects.

Under the nominal model the whitened innovations y are standard normal. An effect adds ``G theta``; with a Gaussian prior on theta its log Bayes
factor is closed. Slow stochastic processes are the same thing with knots for theta and the process's covariance for the prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.gap.evidence import kernels
from insemu.gap.policy import rules

Array = NDArray[np.float64]
#: Rows that recursive least squares takes at once; the matrices of fewer cost more to call than to multiply.
ROWS_AT_ONCE = 48
#: Column indices and prior root: the coefficients are ``root @ z`` with z standard normal.
Block = tuple[NDArray[Any], Array]


@dataclass
class Field:
    """Everything that the evidence needs of one recording.

    Parameters
    ----------
    y : (r,) array
        Whitened innovations of the used components, in order of time.
    G : (r, c) array
        Unit responses of all columns.
    variance : float
        Common factor of the innovations' variance, which stands for noise levels that are a little off.
    """

    y: Array
    G: Array
    variance: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.y).all():
            raise InputError("the nominal filter diverges on this recording")

    @cached_property
    def A(self) -> Array:
        """Normal matrix (c, c)."""
        return np.asarray(self.G.T @ self.G / self.variance)

    @cached_property
    def b(self) -> Array:
        """Right-hand side (c,)."""
        return np.asarray(self.G.T @ self.y / self.variance)

    def _joined(self, blocks: Sequence[Block]) -> tuple[NDArray[Any], Array]:
        index = np.concatenate([i for i, _ in blocks])
        root = np.zeros((index.size, sum(r.shape[1] for _, r in blocks)))
        row = col = 0
        for i, r in blocks:
            root[row : row + i.size, col : col + r.shape[1]] = r
            row, col = row + i.size, col + r.shape[1]
        return index, root

    def solved(self, blocks: Sequence[Block]) -> tuple[NDArray[Any], Array, Array, Array]:
        """Columns (n,) of blocks and their prior root (n, k), which standard normal numbers z are multiplied with.

        Also the Cholesky factor (k, k) of the precision of z and its right-hand side (k,).
        """
        index, root = self._joined(blocks)
        if "A" in self.__dict__:
            A, b = self.A[np.ix_(index, index)], self.b[index]
        else:  # the normal matrix of everything costs more than these few columns
            G = self.G[:, index]
            A, b = G.T @ G / self.variance, G.T @ self.y / self.variance
        M = root.T @ A @ root
        M[np.diag_indices_from(M)] += 1.0
        return index, root, np.linalg.cholesky(M), root.T @ b

    def log_factor(self, blocks: Sequence[Block]) -> float:
        """Log Bayes factor of blocks together against nothing."""
        if not blocks:
            return 0.0
        _, _, L, rb = self.solved(blocks)
        z = np.linalg.solve(L, rb)
        return 0.5 * float(z @ z) - float(np.sum(np.log(np.diag(L))))

    def posterior(self, blocks: Sequence[Block]) -> tuple[NDArray[Any], Array, Array]:
        """Indices, mean and covariance of the coefficients of all blocks together."""
        index, root, L, rb = self.solved(blocks)
        half = np.linalg.solve(L, root.T)
        return index, half.T @ np.linalg.solve(L, rb), half.T @ half

    def conditioned(self, blocks: Sequence[Block], draws: Array | None = None) -> tuple[Array, Array]:
        """Normal matrix (c, c) and right-hand sides (c, 1 + draws) of what the blocks leave unexplained.

        Parameters
        ----------
        draws : (c, s) array, optional
            Right-hand sides of simulated innovations, appended to the measured one.
        """
        b = self.b[:, None] if draws is None else np.hstack([self.b[:, None], draws])
        if not blocks:
            return self.A, b
        index, root, L, _ = self.solved(blocks)
        half = np.linalg.solve(L, (self.A[:, index] @ root).T)
        return self.A - half.T @ half, b - half.T @ np.linalg.solve(L, root.T @ b[index])

    def residual(self, blocks: Sequence[Block]) -> tuple[Array, float]:
        """Innovations whitened again in order of time under the blocks' prior, and half the log determinant that this adds.

        Each is predicted from those before it only, so the residuals of a later part are its predictive errors.
        """
        if not blocks:
            return self.y, 0.0
        out, logs = recursive_residuals(self.y, self.spanned(blocks), self.variance)
        return out, float(np.sum(logs))

    def predictive(self, blocks: Sequence[Block], rows: NDArray[np.bool_]) -> tuple[Array, float]:
        """The same at a variance of one, of some rows only: residuals and half the log determinant."""
        if not blocks:
            return self.y[rows], 0.0
        out, logs = recursive_residuals(self.y, self.spanned(blocks), 1.0)
        return out[rows], float(np.sum(logs[rows]))

    def spanned(self, blocks: Sequence[Block]) -> Array:
        """What the blocks can explain: responses (r, k) to standard normal numbers."""
        index, root = self._joined(blocks)
        return np.asarray(self.G[:, index] @ root)

    def wider(self, more: Array) -> Field:
        """The same with more columns (r, k) behind the others, a known normal matrix continued."""
        out = Field(self.y, np.hstack([self.G, more]), self.variance)
        if "A" in self.__dict__:
            cross = self.G.T @ more / self.variance
            out.__dict__["A"] = np.block([[self.A, cross], [cross.T, more.T @ more / self.variance]])
        return out

    def rows(self, keep: slice) -> Field:
        """The same on some of the rows."""
        return Field(self.y[keep], self.G[keep], self.variance)


def marginal(A: Array, b: Array, block: Block) -> tuple[Array, Array]:
    """Posterior mean (k,) and covariance (k, k) of a block's coefficients.

    Parameters
    ----------
    A, b : (c, c), (c, 1 or more) arrays
        Of :meth:`Field.conditioned`: what is explained besides is integrated out; the first right-hand side counts.
    block : Block
        Column indices and prior root.
    """
    index, root = block
    M = root.T @ A[np.ix_(index, index)] @ root
    M[np.diag_indices_from(M)] += 1.0
    half = np.linalg.solve(np.linalg.cholesky(M), root.T)
    covariance = half.T @ half
    return covariance @ b[index, 0], covariance


def recursive_residuals(y: Array, U: Array, variance: float) -> tuple[Array, Array]:
    """One-step predictive residuals of ``y = U z + noise``, z standard normal: recursive least squares, some rows at a time.

    Parameters
    ----------
    y : (r,) array
    U : (r, k) array
    variance : float
        Of the noise.

    Returns
    -------
    residuals : (r,) array
        Over their standard deviations, which are one where nothing is uncertain and ``variance`` is one.
    logs : (r,) array
        Logarithm of each standard deviation.
    """
    out, logs = np.empty_like(y), np.empty_like(y)
    P, z = np.eye(U.shape[1]), np.zeros(U.shape[1])
    for first in range(0, y.size, ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        V = U[rows] @ P
        S = V @ U[rows].T
        S[np.diag_indices_from(S)] += variance
        L = np.linalg.cholesky(S)
        gain = scipy.linalg.solve_triangular(L, V, lower=True, check_finite=False)
        out[rows] = scipy.linalg.solve_triangular(L, y[rows] - U[rows] @ z, lower=True, check_finite=False)
        logs[rows] = np.log(np.diag(L))
        z += gain.T @ out[rows]
        P -= gain.T @ gain
    return out, logs


def quadratic_evidence(A: Array, b: Array, root: Array, amplitudes: Array) -> Array:
    """Log Bayes factors of coefficients ``amplitude root z``, z standard normal.

    Parameters
    ----------
    A : (k, k) array
        Normal matrix of the columns.
    b : (k, s) array
        Right-hand sides.
    root : (k, j) array
    amplitudes : (a,) array

    Returns
    -------
    (a, s) array
        ``1/2 b' R (I + R' A R)^-1 R' b - 1/2 log|I + R' A R|`` with ``R = amplitude root``.
    """
    if root.shape == (1, 1):
        values, turned = np.array([A[0, 0] * root[0, 0] ** 2]), root[0, 0] * b
    else:
        values, vectors = np.linalg.eigh(root.T @ A @ root)
        turned = vectors.T @ (root.T @ b)
    values = np.maximum(values, 0.0)
    square = amplitudes[:, None] ** 2
    grown = 1.0 + square * values[None, :]
    return np.asarray(0.5 * (square / grown) @ turned**2 - 0.5 * np.sum(np.log(grown), axis=1)[:, None])


def log_mean_exp(values: Sequence[float] | Array) -> float:
    """Logarithm of the mean of exponentials."""
    v = np.asarray(values, dtype=np.float64)
    top = float(v.max())
    if not math.isfinite(top):
        return top
    return top + math.log(float(np.mean(np.exp(v - top))))


def log_mean_exp_columns(logs: Array) -> Array:
    """Logarithm of the mean of exponentials of each column."""
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.mean(np.exp(logs - top), axis=0)))


def regression_evidence(A: Array, b: Array, scales: Array) -> float:
    """Log Bayes factor of a linear effect against none, averaged over prior scales.

    ``1/2 b' (A + L^-1)^-1 b - 1/2 log|I + L A|`` with ``L = diag((c scales)^2)`` for c in the policy's ``prior_scales``.

    Parameters
    ----------
    A, b : (k, k), (k,) arrays
        Normal matrix and right-hand side of the whitened regressors.
    scales : (k,) array
        Datasheet scale of each coefficient.
    """
    logs = quadratic_evidence(A, b[:, None], np.diag(scales), np.array(rules().prior_scales))
    return log_mean_exp(logs[:, 0])


def stationary_score(gamma: Array, rows: Array, scales: Array) -> tuple[float, Array, Array] | None:
    """Log-likelihood of a stationary Gaussian vector next to a linear effect, with its derivatives by the autocovariance.

    With ``X = C^-1 [y G]``, m and M posterior mean and covariance of the coefficients at one prior scale, the derivative along dC is
    ``1/2 (x_y - X_G m)' dC (x_y - X_G m) + 1/2 tr(M X_G' dC X_G) - 1/2 tr(C^-1 dC)``; prior scales count by their evidence.

    Parameters
    ----------
    gamma : (n,) array
        Autocovariance at lags 0 to n - 1.
    rows : (1 + k, n) array
        Data and regressors.
    scales : (k,) array
        Datasheet scale of each coefficient; none where there are no regressors.

    Returns
    -------
    (float, (n,) array, (n,) array), optional
        Log-likelihood, derivatives, and sums of products at every lag of what ``C^-1`` makes of the data. Nothing where the autocovariance is not
        positive definite.
    """
    solved, by_lag = np.empty_like(rows), np.empty(gamma.size)
    logdet = kernels.toeplitz_solve(gamma, rows, solved, by_lag)
    if not math.isfinite(logdet):
        return None
    normal = rows @ solved.T
    value, mixed = -0.5 * (logdet + float(normal[0, 0])), solved[:1]
    if scales.size:
        A, b = normal[1:, 1:], normal[1:, 0]
        amplitudes = np.array(rules().prior_scales)
        logs = quadratic_evidence(A, b[:, None], np.diag(scales), amplitudes)[:, 0]
        weights = np.exp(logs - logs.max())
        value += log_mean_exp(logs)
        W = np.zeros_like(normal)
        for c, weight in zip(amplitudes, weights / weights.sum(), strict=True):
            root = np.diag(c * scales)
            M = root @ np.linalg.solve(np.eye(scales.size) + root @ A @ root, root)
            residual = np.concatenate([[1.0], -M @ b])
            W += weight * np.outer(residual, residual)
            W[1:, 1:] += weight * M
        values, vectors = np.linalg.eigh(0.5 * (W + W.T))
        mixed = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ solved
    products = np.empty(gamma.size)
    kernels.lagged_products(np.ascontiguousarray(mixed), products)
    by_lag = products - by_lag
    by_lag[0] *= 0.5  # a lag counts once on the diagonal and twice next to it
    return value, by_lag, products


# -- slow processes on knots ----------------------------------------------------------------------------------------------------------


def knot_times(start: float, end: float, spacing: float) -> Array:
    """Knots from start to end, at most ``spacing`` apart.

    Parameters
    ----------
    start, end : float
        s.
    spacing : float
        s.

    Returns
    -------
    (k,) array
        Evenly spaced, k at least 4.
    """
    return np.linspace(start, end, max(4, math.ceil((end - start) / spacing - 1e-9) + 1))


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
