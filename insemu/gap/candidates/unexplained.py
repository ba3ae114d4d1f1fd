"""What some effects leave of the innovations of a drive, and how others look beside them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.linear import Block, Field, recursive_residuals

Array = NDArray[np.float64]


class Unexplained:
    """Innovations with what is explained of them already.

    Parameters
    ----------
    scene : Scene
        The recording with its responses.
    data : Field
        The innovations of the rows that are looked at.
    rows : slice
        Which rows of the recording's field these are.
    given : sequence of Block
        What is explained.
    """

    def __init__(self, scene: Scene, data: Field, rows: slice, given: Sequence[Block]) -> None:
        self.scene, self.data, self.rows, self.given = scene, data, rows, given

    @cached_property
    def _solved(self) -> tuple[Array, Array, Array]:
        """Columns (r, n) of the explained, their prior root (n, k), and the inverse Cholesky factor (k, k) of the precision of what it multiplies."""
        if not self.given:
            return np.zeros((self.data.y.size, 0)), np.eye(0), np.eye(0)
        index, root, L, _ = self.data.solved(self.given)
        return self.data.G[:, index], root, np.asarray(scipy.linalg.solve_triangular(L, np.eye(len(L)), lower=True))

    @cached_property
    def span(self) -> Array:
        """What the explained can be: responses (r, k) to standard normal numbers."""
        G, root, _ = self._solved
        return G @ root

    @property
    def inverse(self) -> Array:
        """Inverse Cholesky factor (k, k) of the precision of these numbers."""
        return self._solved[2]

    @cached_property
    def ahead(self) -> Array:
        """Each innovation (r,) less what those before it say, over its standard deviation."""
        return recursive_residuals(self.data.y, self.span, self.data.variance)[0]

    def by_fix(self) -> tuple[Array, int]:
        """The same as (f, 6), zero where a component is missing or not looked at, and the last fix that is."""
        use = self.scene.loop.use
        fix, component = np.nonzero(use)
        out = np.zeros(use.shape)
        out[fix[self.rows], component[self.rows]] = self.ahead
        return out, int(fix[self.rows][-1]) if fix[self.rows].size else 0

    def of_columns(self, G: Array) -> tuple[Array, Array]:
        """What columns (r, c) have in common with the explained, (k, c), and their right-hand sides (c,) next to it."""
        half = self._solved[2] @ (self.span.T @ G) / self.data.variance
        return half, G.T @ self.residual / self.data.variance

    def residual_of(self, column: Array) -> Array:
        """A column (r,) less what the explained can be of it."""
        G, root, inverse = self._solved
        explained = inverse.T @ (inverse @ (root.T @ (G.T @ column))) / self.data.variance
        return np.asarray(column - G @ (root @ explained))

    @cached_property
    def residual(self) -> Array:
        """The innovations (r,) less what is explained of them."""
        return self.residual_of(self.data.y)

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """Normal matrix (c, c) and right-hand side (c, 1) of all columns beside the explained."""
        return self.data.conditioned(self.given)
