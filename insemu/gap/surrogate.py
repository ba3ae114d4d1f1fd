"""Effects that change covariances of the fixes: levels and colour of GNSS noise, weighed by a filter on the error of the nominal filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.filters import FilterResult
from insemu.gap import kernel
from insemu.gap.evidence import log_mean_exp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Surrogate:
    """The nominal filter seen from outside: transitions, gains and noises per fix, ready for :func:`kernel.surrogate_log_likelihood`."""

    t: Array
    Phi: Array
    Q: Array
    K: Array
    H: Array
    R: Array
    P0: Array
    nu: Array
    use: NDArray[np.int64]

    @classmethod
    def of(cls, result: FilterResult) -> Surrogate:
        """From a stored run; nodes without a fix are joined to the next one with a fix."""
        nodes, fixes = result.nodes, result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        n, f = result.layout.n, len(fixes)
        Phi, Q = np.zeros((f, n, n)), np.zeros((f, n, n))
        R = np.zeros((f, 6, 6))
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        where = {int(e): i for i, e in enumerate(nodes.epoch)}
        at, gone, noise = 0, np.eye(n), np.zeros((n, n))
        for k in range(f):
            target = where[int(fixes.epoch[k])]
            while at < target:
                at += 1
                step = nodes.Phi[at]
                noise = step @ noise @ step.T + nodes.P_before[at] - step @ nodes.P_after[at - 1] @ step.T
                gone = step @ gone
            Phi[k], Q[k] = gone, 0.5 * (noise + noise.T)
            gone, noise = np.eye(n), np.zeros((n, n))
            rows = np.flatnonzero(use[k])
            if rows.size:
                H = fixes.H[k][rows]
                R[k][np.ix_(rows, rows)] = fixes.S[k][np.ix_(rows, rows)] - H @ nodes.P_before[target] @ H.T
        K = np.where(use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        return cls(
            fixes.t, Phi, Q, np.ascontiguousarray(K), np.nan_to_num(fixes.H), R, nodes.P_after[0].copy(),
            np.where(use, np.nan_to_num(fixes.innovation), 0.0), use.astype(np.int64),
        )  # fmt: skip

    def log_likelihood(self, factor: Array | None = None, sigma: Array | None = None, tau: float = 1.0) -> float:
        """Log-likelihood with other levels and a Gauss-Markov part of the fixes."""
        sigma = np.zeros(6) if sigma is None else sigma
        gap = np.diff(self.t, prepend=self.t[0])
        phi = np.exp(-gap / tau)[:, None] * np.ones(6)
        q = (1.0 - phi**2) * sigma**2
        try:
            return float(
                kernel.surrogate_log_likelihood(
                    self.Phi, self.Q, self.K, self.H, self.R, self.P0, self.nu, self.use,
                    np.ones(6) if factor is None else factor, np.ascontiguousarray(phi), np.ascontiguousarray(q), sigma**2,
                )
            )  # fmt: skip
        except np.linalg.LinAlgError:
            return -math.inf


@dataclass(frozen=True)
class NoiseFit:
    """Evidence of one covariance effect with its best parameters (name, value, low, high, unit) and axes."""

    effect: str
    axes: tuple[str, ...]
    gain: float
    values: tuple[tuple[str, float, float, float, str], ...]
    factor: Array
    sigma: Array
    tau: float


_GROUPS = ((("north", "east", "down"), (0, 1, 2)), (("north", "east"), (0, 1)), (("down",), (2,)))


def gnss_noise_fits(s: Surrogate, base: float, uncertainty: float = 0.22) -> list[NoiseFit]:
    """Weigh other GNSS noise levels, other velocity noise and coloured position noise.

    Parameters
    ----------
    s : Surrogate
    base : float
        Log-likelihood of the nominal model with its levels free by ``uncertainty``.
    """
    out: list[NoiseFit] = []
    levels = np.geomspace(0.25, 6.0, 17)
    levels = levels[np.abs(np.log(levels)) > math.log(1.0 + uncertainty)]
    for effect, offset in (("gnss_noise_level", 0), ("gnss_velocity_noise", 3)):
        if not s.use[:, offset : offset + 3].any():
            continue
        for axes, columns in _GROUPS:
            rows = [offset + c for c in columns]
            logs = []
            for level in levels:
                factor = np.ones(6)
                factor[rows] = level
                logs.append(s.log_likelihood(factor) - base)
            out.append(_peak(effect, axes, levels, np.array(logs), rows))
    sigma0 = float(np.sqrt(np.median(s.R[:, 0, 0][s.use[:, 0] == 1]))) if s.use[:, 0].any() else 0.0
    span = float(s.t[-1] - s.t[0])
    if sigma0 > 0.0:
        for axes, columns in _GROUPS:
            grid = []
            for tau in np.geomspace(4.0, 0.3 * span, 5):
                for ratio in np.geomspace(0.15, 20.0, 9):
                    sigma = np.zeros(6)
                    sigma[list(columns)] = ratio * sigma0
                    grid.append((s.log_likelihood(sigma=sigma, tau=tau) - base, ratio * sigma0, tau))
            weights = np.array([g[0] for g in grid])
            best = grid[int(np.argmax(weights))]
            sigma = np.zeros(6)
            sigma[list(columns)] = best[1]
            values = (
                ("sigma", best[1], best[1] / 1.7, best[1] * 1.7, "m"),
                ("tau", best[2], best[2] / 2.3, best[2] * 2.3, "s"),
            )
            out.append(
                NoiseFit("gnss_correlated_noise", axes, log_mean_exp(weights), values, np.ones(6), sigma, best[2])
            )
    return out


def _peak(effect: str, axes: tuple[str, ...], levels: Array, logs: Array, rows: list[int]) -> NoiseFit:
    p = np.exp(logs - logs.max())
    p /= p.sum()
    mean = float(p @ np.log(levels))
    sd = max(math.sqrt(float(p @ (np.log(levels) - mean) ** 2)), 0.05)
    factor = np.ones(6)
    factor[rows] = math.exp(mean)
    value = math.exp(mean)
    values = (("factor", value, value * math.exp(-1.96 * sd), value * math.exp(1.96 * sd), "1"),)
    return NoiseFit(effect, axes, log_mean_exp(logs), values, factor, np.zeros(6), 1.0)
