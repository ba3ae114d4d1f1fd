"""Effects on the innovations of a drive, weighed by how much the scores of their coefficients vary: real recordings hold more than any model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.shapes import DriveHypothesis
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.linear import Block, Field, marginal
from insemu.gap.evidence.sandwich import excess
from insemu.gap.hypothesis import Later, best_first

Array = NDArray[np.float64]


def is_linear(h: DriveHypothesis) -> bool:
    """Whether an effect enters the model of the innovations as columns, and is no other noise of the fixes."""
    return not isinstance(h.what, Later) and (h.change.window is not None or h.change.block is not None)


class Left:
    """Innovations less what some blocks explain, and what else could explain more.

    Parameters
    ----------
    scene : Scene
    data : Field
        The innovations of the rows that are looked at.
    rows : (r,) array of bool, or slice
        Which rows of the scene's field these are.
    given : sequence of Block
    """

    def __init__(self, scene: Scene, data: Field, rows: NDArray[np.bool_] | slice, given: Sequence[Block]) -> None:
        self.scene, self.data, self.rows, self.given, self.t = scene, data, rows, given, scene.rows_t[rows]
        self._blocks: tuple[Array, Array, Array] | None = None
        if given:
            index, root, L, _ = data.solved(given)
            self._blocks = data.G[:, index], root, np.asarray(np.linalg.inv(L.T), dtype=np.float64)
        self.y = self._beside(data.y)

    def _beside(self, column: Array) -> Array:
        """A column (r,) less what the blocks can explain of it."""
        if self._blocks is None:
            return column
        G, root, half = self._blocks
        return np.asarray(column - G @ (root @ (half @ (half.T @ (root.T @ (G.T @ column / self.data.variance))))))

    @cached_property
    def _normal(self) -> tuple[Array, Array]:
        """Normal matrix (c, c) and right-hand side (c, 1) of what the blocks leave unexplained."""
        return self.data.conditioned(self.given)

    def shape(self, h: DriveHypothesis) -> Array:
        """What an effect, one of :func:`is_linear`, explains at its most likely size that the blocks cannot, (r,).

        Parameters
        ----------
        h : DriveHypothesis
        """
        if h.change.window is not None:
            column = self.scene.whitened(self.scene.window_answers([h.change.window]))[self.rows][:, 0]
            return self._beside(column * h.values[0].value)
        assert h.change.block is not None
        return self._beside(self.data.G[:, h.change.block[0]] @ marginal(*self._normal, h.change.block)[0])

    def excess(self, h: DriveHypothesis) -> float:
        """Factor by which the variance of the size of an effect is larger than its model says, 1 or more.

        Parameters
        ----------
        h : DriveHypothesis
            One of :func:`is_linear`.
        """
        shape = self.shape(h)
        return excess(shape, self.y - shape, self.t, self.data.variance)

    def too_much(self, h: DriveHypothesis) -> float:
        """What the evidence of an effect claims more than sizes of that variance are worth, nats.

        Parameters
        ----------
        h : DriveHypothesis
            One of :func:`is_linear`.
        """
        shape = self.shape(h)
        factor = excess(shape, self.y - shape, self.t, self.data.variance)
        return 0.5 * float(shape @ shape) / self.data.variance * (1.0 - 1.0 / factor)


def beyond_doubt(left: Left, h: DriveHypothesis, least: float) -> DriveHypothesis:
    """An effect as it is where it is worth some nats even if its size varies as its score does, else at what it is worth then.

    Parameters
    ----------
    left : Left
    h : DriveHypothesis
    least : float
        Nats.
    """
    sure = h.nats - left.too_much(h) if h.nats > least and is_linear(h) else h.nats
    return h if sure > least else replace(h, nats=sure)


def held(left: Left, hypotheses: Sequence[DriveHypothesis], least: float) -> list[DriveHypothesis]:
    """Effects best first, none that :func:`beyond_doubt` doubts before one that it does not.

    Parameters
    ----------
    left, least
        As there.
    hypotheses : sequence of DriveHypothesis
    """
    waiting, doubted = best_first(hypotheses), list[DriveHypothesis]()
    while waiting and waiting[0].nats > least:
        first = beyond_doubt(left, waiting[0], least)
        if first is waiting[0]:
            break
        doubted.append(first)
        waiting = waiting[1:]
    return best_first([*waiting, *doubted])
