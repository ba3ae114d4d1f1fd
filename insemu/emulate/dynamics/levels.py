"""How loud each band of each axis is from moment to moment: levels that were seen, drawn again where the vehicle moves as it did then.

A nearest-neighbour bootstrap (Lall and Sharma 1996): what was seen goes on as it did then while the motion fits, else it passes to a moment that was
as loud and moved as asked. So all bands and axes keep their joint distribution, rare loud events among it, and how that changes over time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.errors import InputError

Array = NDArray[np.float64]

#: How far from a motion a moment's weight is down to exp(-1/2): m/s and share of the speed, rad/s, m/s. Who stands is far from who rolls.
SOFT_SPEED, SOFT_SPEED_SHARE, SOFT_TURN, SOFT_CLIMB = 0.1, 0.15, 0.1, 1.0
#: The same of two moments' levels, nepers of power in the mean over bands and axes, and the most that a jump between unlike ones costs, nepers.
LIKE, JUMP = 0.25, 4.0
#: A moment that was drawn k times is drawn less by the power -REUSED of 1 + k.
REUSED = 2.0


@dataclass(frozen=True)
class Levels:
    """Levels of bands and axes at even times of stretches that were seen.

    Parameters
    ----------
    edges : (b + 1,) array
        Of the bands, Hz.
    step : float
        From row to row, s.
    motion : (n, 3) array
        Horizontal speed m/s, magnitude of the turn rate rad/s, rate of climb m/s.
    log : (n, 6, b) array
        Logarithms of mean one-sided densities, (rad/s)^2/Hz and (m/s^2)^2/Hz.
    begins : (n,) array of bool
        Rows that do not follow on the one before.
    """

    edges: Array
    step: float
    motion: Array
    log: Array
    begins: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n, b = len(self.motion), self.edges.size - 1
        if not (b >= 1 and (np.diff(self.edges) > 0.0).all() and self.edges[0] > 0.0):
            raise InputError("edges of levels: expected two or more positive numbers that increase")
        if not (np.isfinite(self.step) and self.step > 0.0):
            raise InputError(f"levels every {self.step} s, expected a positive number")
        if n < 1 or self.motion.shape != (n, 3) or self.log.shape != (n, 6, b) or self.begins.shape != (n,):
            raise InputError(
                f"levels of {n} rows and {b} bands: expected 3 numbers of motion and {6 * b} levels in each row"
            )
        if not (np.isfinite(self.motion).all() and np.isfinite(self.log).all()):
            raise InputError("levels: a number is not finite")

    def drawn(self, motion: Array, rng: np.random.Generator) -> Array:
        """Densities (k, 6 b) at motions (k, 3) given every :attr:`step`."""
        flat = self.log.reshape(len(self.log), -1)
        rows = np.empty(len(motion), dtype=np.int64)
        _follow(np.ascontiguousarray(motion), self.motion, flat, self.begins, rng.random(len(motion)), rows)
        return np.asarray(np.exp(flat[rows]))


def between(place: Array, powers: Array) -> Array:
    """Rows at places (n,) counted in rows of ``powers`` (k, m): cubic B-splines, so that amplitudes have curvatures."""
    first = np.floor(place).astype(np.int64)
    u = (place - first)[:, None]
    weights = ((1.0 - u) ** 3, 3.0 * u**3 - 6.0 * u**2 + 4.0, -3.0 * u**3 + 3.0 * u**2 + 3.0 * u + 1.0, u**3)
    rows = (powers[np.clip(first + k - 1, 0, len(powers) - 1)] for k in range(4))
    return np.asarray(sum(w / 6.0 * row for w, row in zip(weights, rows, strict=True)))


@njit(cache=True, nogil=True)
def _follow(
    wanted: Array, motion: Array, logs: Array, begins: NDArray[np.bool_], chance: Array, out: NDArray[np.int64]
) -> None:
    """Rows that follow wanted motions, by uniform numbers."""
    n = len(motion)
    far, used = np.empty(n), np.zeros(n)
    for k in range(len(wanted)):
        soft = SOFT_SPEED + SOFT_SPEED_SHARE * wanted[k, 0]
        nearest = np.inf
        for j in range(n):
            if k > 0 and begins[j]:
                far[j] = np.inf
                continue
            a, b, c = (
                (motion[j, 0] - wanted[k, 0]) / soft,
                (motion[j, 1] - wanted[k, 1]) / SOFT_TURN,
                (motion[j, 2] - wanted[k, 2]) / SOFT_CLIMB,
            )
            far[j] = 0.5 * (a * a + b * b + c * c) + REUSED * np.log1p(used[j])
            if k > 0:
                off = 0.0
                for i in range(logs.shape[1]):
                    off += (logs[j - 1, i] - logs[out[k - 1], i]) ** 2
                off *= 0.5 / (logs.shape[1] * LIKE * LIKE)
                far[j] += off / (1.0 + off / JUMP)
            nearest = min(nearest, far[j])
        whole = 0.0
        for j in range(n):
            far[j] = np.exp(nearest - far[j]) if far[j] < np.inf else 0.0
            whole += far[j]
        rest = chance[k] * whole
        j = 0
        while j < n - 1 and rest >= far[j]:
            rest -= far[j]
            j += 1
        out[k] = j
        used[j] += 1.0
