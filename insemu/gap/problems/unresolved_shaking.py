"""What shaking leaves between the samples of an IMU: coning and sculling that no algorithm sees, as white noise of its axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.samples import louder
from insemu.gap.drive.preparation import Prepared
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.linear import Block
from insemu.gap.policy import rules
from insemu.gap.worth import white_levels
from insemu.records import AXES

Array = NDArray[np.float64]
#: Shares of the most that shaking may leave; quadrotors of the foreign generator at 50 Hz leave 0.01 to 0.1 of it. The first one is tried first, and
#: the others only where it explains such a part of what the best effect does, which saves runs of the filter elsewhere. Judged by
#: ``python -m benchmarks.foreign --kinds none --recordings 100 --seed 530000 --imu-hz 50`` and ``--kinds one two --recordings 60 --seed 550000``.
SHARES, PART = (0.03, 0.01, 0.1, 0.3), 0.25
#: Correlation time of a vibration, s: its band is about 10 Hz wide, and below that the product of two vibrations is white. The shares scale with it.
BEAT_S = 0.1


def largest(prepared: Prepared) -> Array:
    """White noise that shaking leaves at the most, (6,) squared densities: what it may leave in the mean comes and goes with its loudness."""
    assert prepared.rectified is not None
    return np.repeat(np.mean(prepared.rectified**2, axis=0), 3) * BEAT_S


def with_unresolved(scene: Scene, blocks: Sequence[Block], cut: float | None, worth: float) -> Scene | None:
    """The scene whose filter believes what shaking leaves between the samples, where that explains as much as anything else; ``None`` elsewhere.

    Parameters
    ----------
    scene : Scene
    blocks : sequence of Block
        What is explained.
    cut : float, optional
        Fixes after this time (s) are not looked at.
    worth : float
        What the best effect explains, nats.
    """
    original = scene.original
    if original.rectified is None or original.unresolved.any() or scene.noise is not None:
        return None
    white = white_levels(original.beliefs)
    most, believed = largest(original), np.array([white[name] ** 2 for name in AXES])
    if not (max(SHARES) ** 2 * most > rules().tolerance * believed).any():
        return None
    start, scores = scene.log_likelihood(blocks, cut), dict[tuple[float, float], float]()

    def gain(gyro: float, accel: float) -> float:
        if (gyro, accel) not in scores:
            tried = _louder(scene, np.repeat([gyro**2, accel**2], 3) * most)
            scores[gyro, accel] = tried.log_likelihood(blocks, cut) - start
        return scores[gyro, accel]

    if gain(SHARES[0], SHARES[0]) < PART * worth:
        return None
    best = max(((share, share) for share in SHARES), key=lambda shares: gain(*shares))
    for k in (0, 1, 0):
        tried = [(s, best[1]) if k == 0 else (best[0], s) for s in (0.0, *SHARES)]
        best = max(tried, key=lambda shares: gain(*shares))
    out = _louder(scene, np.repeat(np.square(best), 3) * most).trimmed(blocks, cut)
    # what shakes is the vehicle until shown otherwise
    enough = max(worth - rules().lead, rules().swing_nats)
    return out if out.log_likelihood(blocks, cut) - start > enough else None


def _louder(scene: Scene, more: Array) -> Scene:
    """The scene with so much more white noise (6,) believed of the IMU."""
    own = scene.original
    beliefs = {name: louder(own.beliefs[name], float(m)) for name, m in zip(AXES, more, strict=True)}
    return replace(scene, original=replace(own, beliefs=beliefs, unresolved=more)).rebuilt()
