"""Measurements of an aid that are far off: a few large errors among normal ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.drive.aid_residuals import Measured
from insemu.gap.policy import rules

Array = NDArray[np.float64]

#: Measurements whose median says what is slow where outliers are looked for.
MEDIAN = 11
#: Rounds in which a share of outliers is separated from the rest, and the largest share.
ROUNDS, MOST_SHARE = 100, 0.3
#: Robust standard deviations at which a residual counts less in the fit next to which outliers are looked for (Huber 1981).
HUBER = 1.345


@dataclass(frozen=True)
class FarOff:
    """Outliers of an aid: the mixture of the row that shows it best, its stated standard deviation (SI), and which measurements (n,) are far off."""

    mixture: Mixture
    std: float
    gone: NDArray[np.bool_]


def far_off(measured: Measured) -> FarOff | None:
    """Which measurements are more likely far off than not, where a share of them is; None where none is.

    Every unit effect has its most likely size meanwhile, robustly (Huber 1981), and so has what is slow.
    """
    _, columns = measured.unit_columns()
    # what shakes an aid is faster than motion and loud at times
    std = np.sqrt(measured.aid.std**2 + measured.shaken)[:, measured.used]
    gone = np.zeros(len(measured.aid), dtype=bool)
    found: list[tuple[Mixture, float]] = []
    for row in range(std.shape[1]):
        y, G = measured.off[:, measured.used][:, row] / std[:, row], (columns[:, :, row] / std[:, row]).T
        left = y - G @ _robust(G, y)
        mixture = Mixture.of(left - scipy.ndimage.median_filter(left, size=min(MEDIAN, left.size), mode="nearest"))
        few = mixture.share <= rules().most_outliers and mixture.size > 3.0 * mixture.level
        if few and mixture.nats > rules().least_nats:
            gone |= mixture.odds > 0.5
            found.append((mixture, float(np.exp(np.log(std[:, row]).mean()))))
    return FarOff(*max(found, key=lambda f: f[0].nats), gone) if found else None


def _robust(G: Array, y: Array) -> Array:
    """Coefficients (k,) by iterated weights; of columns that are nearly alike the smallest."""
    weight, c = np.asarray(np.ones(y.size)), np.asarray(np.zeros(G.shape[1]))
    size = np.sqrt(np.mean(G * G, axis=0)) if G.size else np.ones(G.shape[1])
    G = G / np.where(size > 0.0, size, 1.0)
    for _ in range(20 if G.shape[1] else 0):
        root = np.sqrt(weight)
        c = np.asarray(np.linalg.lstsq(G * root[:, None], y * root, rcond=1e-6)[0], dtype=np.float64)
        left = np.abs(y - G @ c)
        scale = max(1.4826 * float(np.median(left)), 1e-9)
        weight = np.asarray(np.minimum(1.0, HUBER * scale / np.maximum(left, 1e-12)))
    return np.asarray(c / np.where(size > 0.0, size, 1.0))


@dataclass(frozen=True)
class Mixture:
    """A few large among normal numbers: their share, size and level, standard deviations of the logarithms of the first two, and log evidence."""

    share: float
    size: float
    level: float
    spread: tuple[float, float]
    nats: float
    odds: Array

    @classmethod
    def of(cls, x: Array) -> Mixture:
        """Of numbers (n,); ``odds`` are the probabilities of each to be one of the large ones."""
        level = max(1.4826 * float(np.median(np.abs(x))), 1e-9)
        share, size, odds = 0.01, 10.0 * level, np.zeros(x.size)
        for _ in range(ROUNDS):
            few, many = _densities(x, share, size, level)
            odds = 1.0 / (1.0 + np.exp(np.clip(many - few, -700.0, 700.0)))
            share = float(np.clip(odds.mean(), 0.5 / x.size, MOST_SHARE))
            size = math.sqrt(max(float(odds @ x**2) / max(float(odds.sum()), 1e-12), level**2))
            level = math.sqrt(max(float((1.0 - odds) @ x**2) / float((1.0 - odds).sum()), 1e-18))
        alone = math.sqrt(float(np.mean(x * x)))
        gain = float(np.logaddexp(*_densities(x, share, size, level)).sum())
        gain += float(np.sum(0.5 * x**2 / alone**2 + math.log(alone)))
        # two more numbers, by the information criterion of Schwarz (1978); that there are some at all is as likely as not
        nats = gain - math.log(x.size)
        # scores of the logarithms of share, size and level: their products are the information
        by_share = odds - share / (1.0 - share) * (1.0 - odds)
        by_size, by_level = odds * (x**2 / size**2 - 1.0), (1.0 - odds) * (x**2 / level**2 - 1.0)
        S = np.stack([by_share, by_size, by_level])
        covariance = np.linalg.pinv(S @ S.T)
        spread = (math.sqrt(max(covariance[0, 0], 0.0)), math.sqrt(max(covariance[1, 1], 0.0)))
        return cls(share, size, level, spread, nats, odds)


def _densities(x: Array, share: float, size: float, level: float) -> tuple[Array, Array]:
    """Logarithms of the densities of numbers as one of the few large ones and as one of the many, each times its share, (n,)."""
    few = math.log(share) - 0.5 * x**2 / size**2 - math.log(size)
    return few, math.log1p(-share) - 0.5 * x**2 / level**2 - math.log(level)
