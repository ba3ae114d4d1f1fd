"""How loud a recorded vehicle is in each band of each axis, window by window: what chance adds to a window removed, and the blur of windows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, polygamma

from insemu.drives.windows import WINDOW_S
from insemu.emulate import Levels

Array = NDArray[np.float64]

#: Least share of a density that is taken for the vehicle's; below it the path or the sensor's noise hides it.
HIDDEN = 0.02
#: Fewest windows of a regime that tell how much its levels spread.
SPREAD_FROM = 8
#: Ordinates under a Hann window count two thirds (Harris 1978).
HANN = 1.5
#: Steps of sharpening: most of what a blur by half a window takes comes back, noise is not raised.
SHARPENINGS = 10


def levels_of(
    f: Array,
    z: NDArray[np.complex128],
    hiding: Array,
    edges: Array,
    motion: Sequence[Array],
    regimes: Sequence[NDArray[np.bool_]],
    begins: NDArray[np.bool_],
) -> tuple[Levels, Array]:
    """Levels of windows that overlap by half, and their powers (w, 6, b) as measured.

    Parameters
    ----------
    f : (f,) array
        Hz.
    z : (w, f, 6) complex array
        Transforms whose squares are one-sided densities.
    hiding : (w, f, 6) array
        Densities of the path and the sensor's noise.
    edges : (b + 1,) array
        Of the bands, Hz.
    motion : three (w,) arrays
        Speed, rate of turn, rate of climb.
    regimes : sequence of (w,) arrays of bool
        Windows among which levels spread about a mean.
    begins : (w,) array of bool
        Windows that do not follow on the one before.
    """
    inside = [(f >= low) & (f < high) for low, high in pairwise(edges)]
    density = np.abs(z) ** 2
    power, hidden = (np.stack([x[:, i].mean(axis=1) for i in inside], axis=2) for x in (density, hiding))
    level = power.copy()
    for rows in regimes:
        if rows.sum() >= SPREAD_FROM:
            mean = density[rows].mean(axis=0)
            free = np.stack([mean[i].sum(axis=0) ** 2 / (mean[i] ** 2).sum(axis=0) for i in inside], axis=1) / HANN
            level[rows] = steady(power[rows], free)
    log = np.log(sharpened(np.maximum(level - hidden, HIDDEN * level), begins))
    moved = np.stack([motion[0], np.abs(motion[1]), motion[2]], axis=1)
    return Levels(edges, 0.5 * WINDOW_S, moved, log, begins), power


def steady(power: Array, freedom: Array) -> Array:
    """Densities (w, 6, b) behind powers of windows of one regime: they spread as much as the powers less what chance adds.

    Parameters
    ----------
    power : (w, 6, b) array
        Mean periodograms.
    freedom : (6, b) array
        Ordinates that each mean is worth.

    Notes
    -----
    Logarithms about their mean are scaled to the spread that is left; means of a posterior would spread less than what they stand for (Louis 1984).
    """
    logs = np.log(power)
    mean, chance = logs.mean(axis=0), polygamma(1, freedom)
    share = np.sqrt(np.maximum(1.0 - chance / np.maximum(logs.var(axis=0), chance), 0.0))
    return np.asarray(np.exp(mean + share * (logs - mean) + np.log(freedom) - digamma(freedom)))


def sharpened(density: Array, begins: NDArray[np.bool_]) -> Array:
    """Levels (n, 6, b) whose splines have the given means over windows: a window blurs, and so does a spline.

    Parameters
    ----------
    density : (n, 6, b) array
    begins : (n,) array of bool

    Notes
    -----
    Multiplicative steps, by which levels stay positive (Richardson 1972, Lucy 1974).
    """
    u = np.linspace(-1.0, 1.0, 401)  # of a window: a level's step is half of it
    hann = np.cos(0.5 * np.pi * u) ** 4
    out = density.copy()
    starts = np.flatnonzero(begins)
    for first, last in zip(starts, [*starts[1:], len(begins)], strict=True):
        n = int(last - first)
        at = np.arange(n)
        blur = np.zeros((n, n))
        for shift in range(-2, 3):
            x = np.abs(u - shift)
            spline = np.where(x < 1.0, 2.0 / 3.0 - x**2 + 0.5 * x**3, np.maximum(2.0 - x, 0.0) ** 3 / 6.0)
            np.add.at(blur, (at, np.clip(at + shift, 0, n - 1)), float((hann * spline).sum() / hann.sum()))
        y = density[first:last].reshape(n, -1)
        level = y.copy()
        for _ in range(SHARPENINGS):
            level *= (blur.T @ (y / (blur @ level))) / blur.sum(axis=0)[:, None]
        out[first:last] = level.reshape(density[first:last].shape)
    return out
