"""What the search of a drive found: how it enters the model of the innovations, the filter that believes in it, and how it scores later fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.fixes import outlying_fixes, position_innovations
from insemu.gap.candidates.shapes import PROCESSES, Change
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.linear import Block
from insemu.gap.holdout import score_drive
from insemu.gap.hypothesis import Found
from insemu.gap.problems.findings import with_process
from insemu.gap.verdict import Interval

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Named:
    """What the search found.

    Parameters
    ----------
    found : tuple of Found
    scene : Scene
        At the levels, colours and corrections that were found.
    outsider : str
        Structure outside the catalogue, in words, where there is any.
    gone : (k,) array
        Times of the positions that were left out as outliers.
    """

    found: tuple[Found[Change], ...]
    scene: Scene
    outsider: str
    gone: Array

    @property
    def blocks(self) -> list[Block]:
        """How the effects enter the linear model of the innovations, and what is uncertain in any case."""
        return [*self.scene.always, *blocks_of(self.found)]


def blocks_of(found: Sequence[Found[Change]]) -> list[Block]:
    """How findings enter the linear model of the innovations, those that do."""
    return [f.chosen.change.block for f in found if f.chosen.change.block is not None]


def believing(named: Named, cut: float | None = None) -> tuple[Scene, list[Block]]:
    """The filter that believes in the slow processes that were found, and the blocks of everything else.

    The search carries a process on knots; what is left of a strong one between them would count against it.
    """
    beliefs = dict(named.scene.original.beliefs)
    blocks = list(named.scene.always)
    for f in named.found:
        h = f.chosen
        if h.effect in PROCESSES:
            for axis in h.axes:
                name = f"{h.sensor}_{axis}"
                beliefs[name] = with_process(beliefs[name], h.effect, {v.name: v.value for v in h.values})
        elif h.change.block is not None:
            blocks.append(h.change.block)
    if len(blocks) == len(named.blocks):
        return named.scene, blocks
    scene = named.scene.rebuilt(beliefs=beliefs)
    return scene.trimmed(blocks, cut), blocks


def held_out(scene: Scene, named: Named, cut: float) -> tuple[Interval, Interval, Interval]:
    """Gap index before and after and log score gained per fix after ``cut``, where nothing was named.

    Parameters
    ----------
    scene, named, cut : Scene, Named, float
        The recording before the search, what was found in its fixes up to ``cut``, and that time in s.
    """
    final, blocks = believing(named, cut)
    outliers = next((f.chosen for f in named.found if f.chosen.effect == "gnss_outliers"), None)
    density = 0.0
    if outliers is not None:
        # positions that were left out are scored as the outliers that they are said to be
        plain = np.where(scene.surrogate.use == 1, scene.surrogate.nu, 0.0)
        at, v, S = position_innovations(scene, plain, None)
        times, logs = outlying_fixes(outliers, scene.prepared.result.fixes.t[at], v, S)
        density = float(np.sum(logs[np.isin(times, named.gone) & (times > cut)]))
    return score_drive(scene, final, blocks, cut, density)
