"""Effects that change covariances of the fixes: levels and colour of GNSS noise, weighed by a filter on the error of the nominal filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from insemu.filters import FilterResult
from insemu.gap.evidence import kernels
from insemu.gap.evidence.model import log_mean_exp
from insemu.gap.policy import rules

Array = NDArray[np.float64]
#: Standard deviations (6,) in m and m/s and correlation time in s of a Gauss-Markov part of the fixes.
Colour = tuple[Array, float]
NED = ("north", "east", "down")
#: Axes that may have a level or a colour of their own.
GROUPS = (NED, ("north", "east"), ("down",), ("north",), ("east",))


@dataclass(frozen=True)
class Surrogate:
    """The nominal filter seen from outside: transitions, gains and noises per fix, ready for :func:`kernels.surrogate_filter`.

    The noise of a fix counts as independent between its components; what the gyros' noise on the lever arm correlates is left out.
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

    @classmethod
    def of(cls, result: FilterResult) -> Surrogate:
        """From a stored run; nodes without a fix are joined to the next one with a fix."""
        nodes, fixes = result.nodes, result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        n, f = result.layout.n, len(fixes)
        Phi, Q = np.zeros((f, n, n)), np.zeros((f, n, n))
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        step = nodes.Phi[1:]
        driven = nodes.P_before[1:] - step @ nodes.P_after[:-1] @ np.transpose(step, (0, 2, 1))
        at = np.searchsorted(nodes.epoch, fixes.epoch)
        before = 0
        for k in range(f):
            gone, noise = np.eye(n), np.zeros((n, n))
            for j in range(before, at[k]):
                noise = step[j] @ noise @ step[j].T + driven[j]
                gone = step[j] @ gone
            Phi[k], Q[k], before = gone, 0.5 * (noise + noise.T), max(before, at[k])
        H = np.where(use[:, :, None], np.nan_to_num(fixes.H), 0.0)
        believed = np.einsum("kii->ki", np.nan_to_num(fixes.S)) - np.einsum("kij,kjl,kil->ki", H, nodes.P_before[at], H)
        K = np.where(use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        return cls(
            fixes.t, Phi, Q, np.ascontiguousarray(K), np.ascontiguousarray(H), np.where(use, believed, 0.0), nodes.P_after[0].copy(),
            np.where(use, np.nan_to_num(fixes.innovation), 0.0), use.astype(np.int64),
        )  # fmt: skip

    def until(self, cut: float) -> Surrogate:
        """The fixes up to a time."""
        k = int(np.searchsorted(self.t, cut, side="right"))
        arrays = {name: getattr(self, name)[:k] for name in ("t", "Phi", "Q", "K", "H", "R", "nu", "use")}
        return replace(self, **arrays)

    def sigma(self) -> Array:
        """Median believed standard deviation of each component, (6,); zero where there is none."""
        out = np.zeros(6)
        for i in range(6):
            if self.use[:, i].any():
                out[i] = math.sqrt(float(np.median(self.R[self.use[:, i] == 1, i])))
        return out

    def whiten(self, columns: Array, factor: Array | None = None, colour: Colour | None = None) -> tuple[Array, float]:
        """Columns (f, 6, c) whitened under other levels and a Gauss-Markov part of the fixes, and the first one's log-likelihood."""
        sigma, tau = colour if colour is not None else (np.zeros(6), 1.0)
        gap = np.diff(self.t, prepend=self.t[0])
        phi = np.exp(-gap / tau)[:, None] * np.ones(6)
        white = np.zeros_like(columns)
        value = kernels.surrogate_filter(
            self.Phi, self.Q, self.K, self.H, self.R, self.P0, np.ascontiguousarray(columns), self.use,
            np.ones(6) if factor is None else factor, phi, (1.0 - phi**2) * sigma**2, sigma**2, white,
        )  # fmt: skip
        return white, float(value) if math.isfinite(value) else -math.inf

    def log_likelihood(self, factor: Array | None = None, colour: Colour | None = None) -> float:
        """Log-likelihood with other levels and a Gauss-Markov part of the fixes."""
        return self.whiten(self.nu[:, :, None], factor, colour)[1]


def level_derivatives(variance: Array, white: Array, groups: Sequence[Sequence[int]]) -> list[Array]:
    """Derivatives (k, 6, 6) of the whitened innovation covariances by the logarithm of the fixes' standard deviations, by groups of components.

    Parameters
    ----------
    variance : (k, 6) array
        Believed variances.
    white : (k, 6, 6) array
        Inverse Cholesky factors of the innovation covariances.
    """
    out = []
    for rows in groups:
        half = white[:, :, list(rows)] * np.sqrt(2.0 * variance[:, None, list(rows)])
        out.append(half @ np.transpose(half, (0, 2, 1)))
    return out


def level_scores(s: Surrogate, white: Array, y: Array, groups: Sequence[Sequence[int]]) -> tuple[Array, Array]:
    """Score and information of the logarithm of the fixes' standard deviations, by groups of components.

    Parameters
    ----------
    white : (f, 6, 6) array
        Inverse Cholesky factors of the innovation covariances.
    y : (f, 6) array
        Whitened innovations; zero where missing.
    groups : sequence of component lists

    Returns
    -------
    score (g,), information (g, g)
        To first order in the levels; fixes that are wild in the position or the velocity are left out.
    """
    wild = (np.sum(y[:, :3] ** 2, axis=1) > 25.0) | (np.sum(y[:, 3:] ** 2, axis=1) > 25.0)
    v = y[~wild]
    parts = level_derivatives(s.R[~wild], white[~wild], groups)
    score = np.array([0.5 * float(np.einsum("ki,kij,kj->", v, d, v) - np.einsum("kii->", d)) for d in parts])
    information = np.array([[0.5 * float(np.einsum("kij,kij->", a, b)) for b in parts] for a in parts])
    return score, information


@dataclass(frozen=True)
class NoiseFit:
    """Evidence of one covariance effect with its best parameters (name, value, low, high, unit) and axes."""

    effect: str
    axes: tuple[str, ...]
    gain: float
    values: tuple[tuple[str, float, float, float, str], ...]
    factor: Array
    colour: Colour | None


def gnss_noise_fits(
    s: Surrogate,
    base: float,
    white: Array,
    y: Array,
    *,
    trimmed: Array,
    uncertainty: float,
    colour: Colour | None = None,
    skip: Sequence[str] = (),
) -> list[NoiseFit]:
    """Weigh other GNSS noise levels, other velocity noise and coloured position noise.

    Parameters
    ----------
    s : Surrogate
        Of the innovations less what is explained already.
    base : float
        Its log-likelihood.
    white, y : arrays
        See :func:`level_scores`: levels that the score makes hopeless are not computed.
    trimmed : (6,) array
        By what the filter's standard deviations were trimmed already: the levels that count are relative to the nominal ones.
    uncertainty : float
        Tolerance of a nominal level.
    colour : optional
        Of the fixes, where it was found already.
    """
    out: list[NoiseFit] = []
    edge = math.log(1.0 + uncertainty)
    for effect, offset in (("gnss_noise_level", 0), ("gnss_velocity_noise", 3)):
        if effect in skip or not s.use[:, offset : offset + 3].any():
            continue
        for axes in GROUPS:
            rows = [offset + NED.index(a) for a in axes]
            score, information = level_scores(s, white, y, [rows])
            promise = 0.5 * float(score[0]) ** 2 / max(float(information[0, 0]), 1e-12)
            if promise < 1.0:
                continue
            moved = float(np.mean(np.log(trimmed[rows])))

            def at(x: float, rows: list[int] = rows) -> float:
                factor = np.ones(6)
                factor[rows] = math.exp(x)
                return s.log_likelihood(factor, colour)

            fitted = _level(at, base, moved, edge)
            if fitted is None:
                continue
            gain, x, sd = fitted
            factor = np.ones(6)
            factor[rows] = math.exp(x)
            level = math.exp(x + moved)
            values = (("factor", level, level * math.exp(-1.96 * sd), level * math.exp(1.96 * sd), "1"),)
            out.append(NoiseFit(effect, axes, gain, values, factor, colour))
    if colour is None and "gnss_correlated_noise" not in skip:
        out += _colours(s, base)
    return out


def _level(at: Callable[[float], float], base: float, moved: float, edge: float) -> tuple[float, float, float] | None:
    """Evidence, log level and its spread of one level outside of its tolerance; None where the best level is inside."""
    low, high = math.log(rules().lowest_level) - moved, math.log(rules().highest_level) - moved
    found = optimize.minimize_scalar(lambda x: -at(x), bounds=(low, high), method="bounded", options={"xatol": 0.01})
    x, top = float(found.x), -float(found.fun)
    if abs(x + moved) < edge:
        return None
    h = 0.05
    bend = -(at(x + h) + at(x - h) - 2.0 * top) / h**2
    sd = 1.0 / math.sqrt(max(bend, 1.0))
    width = high - low - 2.0 * edge
    return top - base + 0.5 * math.log(2.0 * math.pi) + math.log(sd / width), x, sd


def _colours(s: Surrogate, base: float) -> list[NoiseFit]:
    """Gauss-Markov parts of the position fixes, in proportion to their believed standard deviations."""
    sigma0 = s.sigma()
    if not sigma0[:3].all():
        return []
    span = float(s.t[-1] - s.t[0])
    step = float(np.median(np.diff(s.t)))
    taus, ratios = (2.0 * step, 0.5 * span), rules().colour_sizes
    area = math.log(taus[1] / taus[0]) * math.log(ratios[1] / ratios[0])
    out: list[NoiseFit] = []
    best_of_all = -math.inf
    for axes in GROUPS[:3]:
        rows = [NED.index(a) for a in axes]

        def colour(x: Array, rows: list[int] = rows) -> Colour:
            sigma = np.zeros(6)
            sigma[rows] = math.exp(x[0]) * sigma0[rows]
            return sigma, math.exp(x[1])

        def cost(x: Array, colour: Callable[[Array], Colour] = colour) -> float:
            if not (
                math.log(ratios[0]) <= x[0] <= math.log(ratios[1]) and math.log(taus[0]) <= x[1] <= math.log(taus[1])
            ):
                return 1e9
            return -s.log_likelihood(None, colour(x))

        grid = [np.log([r, t]) for r in (0.3, 0.8, 2.5, 8.0) for t in np.geomspace(4.0 * step, 0.25 * span, 4)]
        logs = [-cost(x) - base for x in grid]
        start = grid[int(np.argmax(logs))]
        best_of_all = max(best_of_all, max(logs))
        if max(logs) < -2.0:
            if axes == NED and max(logs) < -30.0:
                break  # neither part of it can be worth anything then
            continue
        found = optimize.minimize(
            cost, start, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.05, "maxfev": 40}
        )
        x = np.asarray(found.x)
        top = -float(found.fun)
        h = 0.15
        hessian = np.zeros((2, 2))
        for i, e in enumerate(np.eye(2) * h):
            hessian[i, i] = (cost(x + e) + cost(x - e) + 2.0 * top) / h**2
        sd = 1.0 / np.sqrt(np.clip(np.diag(hessian), 0.25, 1e6))
        gain = top - base + math.log(2.0 * math.pi * float(np.prod(sd)) / area)
        sigma, tau = colour(x)
        values = tuple(
            (
                f"sigma_{a}",
                float(sigma[r]),
                float(sigma[r] * math.exp(-1.96 * sd[0])),
                float(sigma[r] * math.exp(1.96 * sd[0])),
                "m",
            )
            for a, r in zip(axes, rows, strict=True)
        )
        values += (("tau", tau, tau * math.exp(-1.96 * float(sd[1])), tau * math.exp(1.96 * float(sd[1])), "s"),)
        out.append(NoiseFit("gnss_correlated_noise", axes, gain, values, np.ones(6), (sigma, tau)))
    return out


@dataclass(frozen=True)
class FixNoise:
    """Noise of the fixes beyond what the filter believed: levels (6,) as ratios to it, and a Gauss-Markov part."""

    factor: Array
    colour: Colour


def joint_noise(s: Surrogate, colour: Colour, factors: Array, uncertainty: float) -> FixNoise:
    """Most likely colour together with the levels inside their tolerance: a level that was trimmed without the colour took some of it.

    Parameters
    ----------
    s : Surrogate
        Of the innovations less what is explained.
    colour : Colour
        To begin with; its axes stay, horizontal and vertical standard deviation and the correlation time are refined.
    factors : (6,) array
        By what the filter's levels were moved already, as ratios to what was named or believed.
    """
    edge = math.log(1.0 + uncertainty)
    parts = [rows for rows in ([0, 1], [2]) if any(colour[0][r] > 0.0 for r in rows)]
    moved = np.log(factors)

    def unpack(x: Array) -> FixNoise:
        sigma = colour[0].copy()
        for k, rows in enumerate(parts):
            sigma[rows] *= math.exp(x[k])
        tau = colour[1] * math.exp(x[len(parts)])
        factor = np.ones(6)
        for k, rows in enumerate(([0, 1], [2])):
            level = np.clip(moved[rows] + x[len(parts) + 1 + k], -edge, edge)
            factor[rows] = np.exp(level - moved[rows])
        return FixNoise(factor, (sigma, tau))

    def cost(x: Array) -> float:
        noise = unpack(x)
        # what lies outside of the tolerance is pulled back, so that the search has a slope
        outside = float(np.sum(np.maximum(np.abs(moved[[0, 2]] + x[len(parts) + 1 :]) - edge, 0.0) ** 2))
        return -s.log_likelihood(noise.factor, noise.colour) + 1e3 * outside

    start = np.zeros(len(parts) + 3)
    simplex = np.vstack([start, np.diag(np.full(start.size, -0.2)) + start])
    options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.02, "maxfev": 160}
    return unpack(np.asarray(optimize.minimize(cost, start, method="Nelder-Mead", options=options).x))


def pooled(fits: Sequence[NoiseFit]) -> float:
    """Evidence of an effect over the groups of axes that it may act on."""
    return log_mean_exp([f.gain for f in fits] + [-math.inf] * (len(GROUPS) - len(fits)))
