"""Where a drive or flight and a model disagree: innovations, what they go with, and the IMU's band above the motion.

Every p-value is uniform under the model, whose levels may be off inside their tolerance; the caller corrects for how many were looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects import Motion
from insemu.gap.candidates.axis import AxisState, whitened
from insemu.gap.checks.rest import DRAWS, Entry, chi_square_p, correlation_p, followed, residual_variance
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.fixes import LEVEL_GROUPS, level_derivatives, level_scores
from insemu.gap.policy import rules

Array = NDArray[np.float64]

COMPONENTS = tuple((what, axis) for what in ("position", "velocity") for axis in ("north", "east", "down"))
#: Fewest innovations of a component that are tested; length of the pieces in which the IMU's noise is held against the motion, s.
FEWEST, PIECE_S = 30, 2.0


def by_component(scene: Scene, y: Array) -> Array:
    """Rows of the field as a table (f, 6), NaN where missing."""
    full = np.full(scene.loop.use.size, np.nan)
    full[scene.loop.use.ravel()] = y
    return full.reshape(-1, 6)


def innovation_tests(scene: Scene, y: Array) -> list[Entry]:
    """Mean, level, whiteness and tails of each component's whitened innovations."""
    out: list[Entry] = []
    step = float(np.median(np.diff(scene.prepared.result.fixes.t)))
    slopes, spent = trimmed_levels(scene)
    for (what, axis), column, slope in zip(COMPONENTS, by_component(scene, y).T, slopes.T, strict=True):
        z = column[np.isfinite(column)]
        n = z.size
        if n < FEWEST:
            continue
        lags = np.arange(1, 11)
        rho = np.array([float(np.mean(z[k:] * z[:-k])) for k in lags]) / float(np.mean(z * z))
        mean = float(2.0 * scipy.stats.norm.sf(abs(z.mean()) * math.sqrt(n)))
        white = float(scipy.stats.chi2.sf(np.sum(rho**2 * (n - lags)), lags.size))
        out.append((f"{what} innovation mean", "gnss", axis, None, mean))
        left = max(residual_variance(2.0 * n, 1.0, slope, spent), rules().nis_left * 2.0 * n)
        square = float(z @ z)
        shaken = what == "velocity" and scene.prepared.swings
        if shaken:  # how loud the antenna swings north and east is known no better than a level
            square = n * _beyond(square / n)
        out.append((f"{what} innovation NIS", "gnss", axis, None, chi_square_p(square, n, left)))
        if not shaken:  # a swing that fixes sample at their own rate has neither a white spectrum nor normal tails
            out.append((f"{what} innovation whiteness", "gnss", axis, 10.0 * step, white))
            out.append((f"{what} innovation tails", "gnss", axis, None, float(scipy.stats.kurtosistest(z).pvalue)))
    return out


def _beyond(ratio: float) -> float:
    """A ratio of variances less what the tolerance of a level explains; 1 inside it."""
    edge = (1.0 + rules().tolerance) ** 2
    return ratio / edge if ratio > edge else ratio * edge if ratio < 1.0 / edge else 1.0


def trimmed_levels(scene: Scene) -> tuple[Array, Array]:
    """Derivatives (g, 6) of the sums of squares of the components by the logarithms of the trimmed levels, and the levels' covariance (g, g).

    A level follows the fluctuation of its own innovations, as far as its tolerance lets it; where a colour of the fixes is known, none is trimmed.
    """
    s, white = scene.surrogate, scene.loop.white
    groups = [g for g in LEVEL_GROUPS if s.use[:, list(g)].any()]
    if scene.noise is not None or not groups:
        return np.zeros((0, 6)), np.zeros((0, 0))
    _, information = level_scores(s, white, np.zeros((s.t.size, 6)), groups)
    covariance = np.linalg.inv(information + np.eye(len(groups)))
    half = math.log(1.0 + rules().tolerance)
    kept = np.sqrt([followed(float(v), half) for v in np.diag(covariance)])
    slopes = np.stack([np.einsum("kii->i", d) for d in level_derivatives(s.R, white, groups)])
    return slopes, kept[:, None] * covariance * kept[None, :]


def drive_map(scene: Scene, y: Array, fast: Mapping[str, AxisState], rng: np.random.Generator) -> list[Entry]:
    """Everything that is looked at beside :func:`innovation_tests`.

    Parameters
    ----------
    y : (r,) array
        Whitened innovations, less what is explained.
    fast : mapping of axis to AxisState
        The band above the motion with the explanation that it is held against.
    rng : Generator
        For 1,000 simulated spectra per axis.

    Returns
    -------
    list of (statistic, sensor, axis, scale s, p-value)
        The largest innovation; the regression of the innovations on specific force, rate, temperature, velocity, heading, time and the gap
        between fixes; correlation between components; wavelet variance, tails and cross-correlation of the IMU above its motion, and its
        noise there against motion, temperature and time.
    """
    table = by_component(scene, y)
    regressors = fix_regressors(scene)
    out: list[Entry] = []
    for (what, axis), z in zip(COMPONENTS, table.T, strict=True):
        there = np.isfinite(z)
        if there.sum() < FEWEST:
            continue
        out.append((f"{what} innovation, largest", "gnss", axis, None, largest_p(z[there])))
        for name, X in regressors.items():
            out.append((f"{what} innovation with {name}", "gnss", axis, None, regression_p(z[there], X[there])))
    for i in range(6):
        for j in range(i + 1, 6):
            both = np.isfinite(table[:, i]) & np.isfinite(table[:, j])
            if both.sum() >= FEWEST:
                (a, b), (c, d) = COMPONENTS[i], COMPONENTS[j]
                p = correlation_p(table[both, i], table[both, j])
                out.append((f"cross_axis {a} with {c} {d}", "gnss", b, None, p))
    return out + _imu_entries(scene.motion, fast, rng)


def fix_regressors(scene: Scene) -> dict[str, Array]:
    """Regressors at the fixes, (f, k) each: means over the time since the fix before, or values at the fix."""
    motion, t = scene.motion, scene.prepared.result.fixes.t
    edges = np.concatenate([[motion.t[0]], t])
    k = np.clip(np.searchsorted(motion.t, t), 0, motion.t.size - 1)
    heading = rotation.rpy_from_dcm(motion.C[k] @ rotation.dcm_from_rpy(np.array(scene.prepared.nominal.mounting)).T)[
        :, 2
    ]
    gap = np.diff(edges)
    out = {
        "specific force": _means(motion.t, motion.force, edges),
        "rate": _means(motion.t, motion.rate, edges),
        "velocity": motion.vel[k],
        "heading": np.stack([np.cos(heading), np.sin(heading)], axis=1),
        "time": t[:, None],
    }
    if motion.temperature is not None and float(np.std(motion.temperature)) > 1e-3:
        out["temperature"] = motion.temperature[k, None]
    usual = float(np.median(gap))
    if int(np.sum(np.abs(gap / usual - 1.0) > 0.5)) >= 5:
        out["gap"] = gap[:, None]
    return out


def _means(t: Array, x: Array, edges: Array) -> Array:
    """Means (m - 1, k) of columns between consecutive times; the value there where two coincide."""
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t)[:, None], axis=0)])
    at = np.stack([np.interp(edges, t, column) for column in total.T], axis=1)
    width = np.diff(edges)[:, None]
    here = np.stack([np.interp(edges[1:], t, column) for column in x.T], axis=1)
    return np.where(width > 1e-6, np.diff(at, axis=0) / np.maximum(width, 1e-6), here)


def regression_p(z: Array, X: Array) -> float:
    """p-value of the F test of ``z`` (n,) on the columns of ``X`` (n, k) next to a constant; 1 where they do not vary."""
    X = X - X.mean(axis=0)
    u, s, _ = np.linalg.svd(X / np.maximum(np.std(X, axis=0), 1e-300), full_matrices=False)
    basis = u[:, s > 1e-6 * max(float(s[0]), 1.0)]
    k, dof = basis.shape[1], z.size - basis.shape[1] - 1
    if not k or dof < 10:
        return 1.0
    z = z - z.mean()
    explained = float(np.sum((basis.T @ z) ** 2))
    return float(scipy.stats.f.sf(explained / k / ((float(z @ z) - explained) / dof), k, dof))


def largest_p(z: Array) -> float:
    """p-value of the largest of ``n`` normal values of unknown level (Grubbs): each studentised one follows a t distribution."""
    n = z.size
    g2 = float(np.max((z - z.mean()) ** 2)) / float(np.var(z, ddof=1))
    t2 = n * (n - 2) * g2 / max((n - 1) ** 2 - n * g2, 1e-12)
    single = 2.0 * float(scipy.stats.t.sf(math.sqrt(t2), n - 2))
    return float(-math.expm1(n * math.log1p(-min(single, 1.0 - 1e-15))))


# -- the IMU above its motion ---------------------------------------------------------------------------------------------------------


def _imu_entries(motion: Motion, fast: Mapping[str, AxisState], rng: np.random.Generator) -> list[Entry]:
    out: list[Entry] = []
    residuals: dict[str, Array] = {}
    for name, state in fast.items():
        sensor, _, axis = name.rpartition("_")
        for scale, p in band_wavelet_p_values(state, rng):
            out.append(("wavelet_variance", sensor, axis, scale, p))
        # each is a sample against its two neighbours: every third is independent of the one before
        residuals[name] = whitened(state)[1:-1]
        r = residuals[name][::3]
        out.append(("tails", sensor, axis, state.data.dt, float(scipy.stats.kurtosistest(r).pvalue)))
        out += _noise_with_motion(motion, state, sensor, axis)
    names = list(residuals)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            sensor, _, axis = a.rpartition("_")
            p = correlation_p(residuals[a][::3], residuals[b][::3])
            out.append((f"cross_axis {b}", sensor, axis, None, p))
    return out


def band_wavelet_p_values(state: AxisState, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Haar wavelet variance within the band above the motion against 1,000 simulated spectra of the model: ``(scale s, p-value)``.

    The level of the whole band is free inside the tolerance of a nominal one, in the simulated spectra as in the measured one.
    """
    data = state.data
    S = state.explanation.psd(data.f, data.dt)
    ratio = state.explanation.seen(data) / S
    width = np.gradient(data.f)
    edge = 1.0 + rules().tolerance

    def level(r: Array) -> Array:
        return np.asarray(np.clip(r @ data.dof / np.sum(data.dof), 1.0 / edge**2, edge**2))

    own = float(level(ratio[None, :])[0])
    simulated = own * rng.chisquare(data.dof, (DRAWS, data.dof.size)) / data.dof
    out, m = [], 1
    # scales whose passband, about 1 / (4 m dt) to 1 / (2 m dt), lies in the band
    while 0.5 / (m * data.dt) > data.f[0]:
        x = np.pi * data.f * data.dt
        weight = width * S * np.sin(m * x) ** 4 / (m * np.sin(x)) ** 2
        weight /= weight.sum()
        z = np.log(simulated @ weight / level(simulated))
        measured = math.log(float(ratio @ weight) / own)
        out.append((2.0 * m * data.dt, float(2.0 * scipy.stats.norm.sf(abs(measured - z.mean()) / z.std()))))
        m *= 2
    return out


def _noise_with_motion(motion: Motion, state: AxisState, sensor: str, axis: str) -> list[Entry]:
    """F tests of the noise's log power, piece by piece, on what the vehicle did meanwhile."""
    data = state.data
    r = whitened(state)[1:-1][::3]
    length = max(20, round(PIECE_S / (3.0 * data.dt)))
    count = r.size // length
    if count < FEWEST:
        return []
    power = np.log(np.mean(r[: count * length].reshape(count, length) ** 2, axis=1))
    # what filtering left out at either end is alike
    spare = 0.5 * (motion.t[-1] - motion.t[0] - data.values.size * data.dt)
    edges = motion.t[-1] - spare - data.duration_s + 3.0 * length * data.dt * np.arange(count + 1)
    edges = np.clip(edges, motion.t[0], motion.t[-1])
    inside = np.diff(edges) > 0.5 * PIECE_S
    signals = {
        "velocity": np.linalg.norm(motion.vel, axis=1),
        "rate": np.linalg.norm(motion.rate, axis=1),
        "specific force": np.linalg.norm(motion.force, axis=1),
        "time": motion.t,
    }
    if motion.temperature is not None and float(np.std(motion.temperature)) > 1e-3:
        signals["temperature"] = motion.temperature
    out: list[Entry] = []
    if inside.sum() < FEWEST:
        return out
    for name, signal in signals.items():
        X = _means(motion.t, signal[:, None], edges)
        out.append((f"noise level with {name}", sensor, axis, PIECE_S, regression_p(power[inside], X[inside])))
    return out
