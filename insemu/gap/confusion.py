"""What a recording cannot tell apart: how often a rival would stand next to an effect if the same recording were made again.

The noise is drawn again, the motion, the filter and the effect stay: an effect of coefficients ``theta`` gives the right-hand sides
``A theta + G' z`` of the linear model of the innovations, ``z`` standard normal, and every effect is weighed on them exactly as it is on the
measured ones, so that widths of priors, groups of axes and processes on knots all count. Nothing of the measured innovations enters but the size
of the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.shapes import Variant, linear_evidence, pooled_evidence
from insemu.gap.evidence.linear import Block, Field
from insemu.gap.policy import rules

Array = NDArray[np.float64]

DRAWS = 300


@dataclass(frozen=True)
class Repetitions:
    """Right-hand sides of repeated recordings in which nothing is missing.

    Parameters
    ----------
    data : Field
    noise : (c, s) array
        ``G' z`` of each repetition.
    """

    data: Field
    noise: Array

    @classmethod
    def of(cls, data: Field, rng: np.random.Generator, draws: int = DRAWS) -> Repetitions:
        """Draw the noise."""
        z = rng.standard_normal((data.y.size, draws))
        return cls(data, np.asarray(data.G.T @ z / np.sqrt(data.variance)))

    def shares(
        self, variants: Sequence[Variant], index: NDArray[np.int64], coefficients: Array, given: Sequence[Block] = ()
    ) -> dict[tuple[str, str], float]:
        """Share of the repetitions in which each effect and sensor is found: it comes first, or is worth anything within the lead of the first.

        Where nothing is worth the lead nothing is found.

        Parameters
        ----------
        variants : sequence of Variant
            Everything that competes.
        index : (k,) array of int
            Columns of the effect.
        coefficients : (k,) or (k, s) array
            The same in every repetition, or drawn for each (random processes).
        given : sequence of Block
            What else is known to be there.
        """
        A, b = self.data.conditioned(given, self.noise)
        moved = A[:, index] @ coefficients
        gains = pooled_evidence(
            variants, linear_evidence(variants, A, b[:, 1:] + (moved if moved.ndim == 2 else moved[:, None]))
        )
        table = np.stack(list(gains.values()))
        top = table.max(axis=0)
        near = np.mean((table > top - rules().lead) & (table > 0.0) & (top > rules().lead), axis=1)
        return {key: float(share) for key, share in zip(gains, near, strict=True)}
