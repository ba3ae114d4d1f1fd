"""Effects on the innovations of a drive, weighed by how much the scores of their coefficients vary: real recordings hold more than any model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.shapes import PROCESSES, DriveHypothesis
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.evidence.linear import marginal
from insemu.gap.evidence.sandwich import excess
from insemu.gap.hypothesis import Later, best_first

Array = NDArray[np.float64]


def is_lasting(h: DriveHypothesis) -> bool:
    """Whether an effect has a shape that lasts to the end, so that all of the recording speaks for or against it.

    A step in the fixes says what happened between two times, other noise of the fixes has no shape, and that of a slow process is what it follows.
    """
    if isinstance(h.what, Later) or h.effect == "gnss_multipath_step" or h.effect in PROCESSES:
        return False
    return h.change.window is not None or h.change.block is not None


def shape_of(unexplained: Unexplained, h: DriveHypothesis) -> Array:
    """What an effect, one of :func:`is_lasting`, explains at its most likely size that nothing else can, (r,).

    Parameters
    ----------
    unexplained : Unexplained
    h : DriveHypothesis
    """
    if h.change.window is not None:
        column = unexplained.scene.whitened(unexplained.scene.window_answers([h.change.window]))[unexplained.rows][:, 0]
        return unexplained.residual_of(column * h.values[0].value)
    assert h.change.block is not None
    return unexplained.residual_of(
        unexplained.data.G[:, h.change.block[0]] @ marginal(*unexplained.normal, h.change.block)[0]
    )


def _worth(unexplained: Unexplained, h: DriveHypothesis) -> tuple[float, float]:
    """Half the square of the size of an effect over its standard deviation, nats, and the factor by which the variance of that size is larger."""
    shape = shape_of(unexplained, h)
    factor = excess(
        shape, unexplained.residual - shape, unexplained.scene.rows_t[unexplained.rows], unexplained.data.variance
    )
    return 0.5 * float(shape @ shape) / unexplained.data.variance, factor


def excess_of(unexplained: Unexplained, h: DriveHypothesis) -> float:
    """Factor by which the variance of the size of an effect is larger than its model says, 1 or more.

    Parameters
    ----------
    unexplained : Unexplained
    h : DriveHypothesis
        One of :func:`is_lasting`.
    """
    return _worth(unexplained, h)[1]


def too_much(unexplained: Unexplained, h: DriveHypothesis) -> float:
    """What the evidence of an effect claims more than it is worth where its size varies as its score does, nats.

    Parameters
    ----------
    unexplained : Unexplained
    h : DriveHypothesis
        One of :func:`is_lasting`.
    """
    nats, factor = _worth(unexplained, h)
    return nats * (1.0 - 1.0 / factor)


def beyond_doubt(unexplained: Unexplained, h: DriveHypothesis, least: float) -> DriveHypothesis:
    """An effect as it is where it is worth some nats even if its size varies as its score does, else at what it is worth then.

    Parameters
    ----------
    unexplained : Unexplained
    h : DriveHypothesis
    least : float
        Nats.
    """
    sure = h.nats - too_much(unexplained, h) if h.nats > least and is_lasting(h) else h.nats
    return h if sure > least else replace(h, nats=sure)


def doubted_last(
    unexplained: Unexplained, hypotheses: Sequence[DriveHypothesis], least: float
) -> list[DriveHypothesis]:
    """Effects best first, none that :func:`beyond_doubt` doubts before one that it does not.

    Parameters
    ----------
    unexplained, least
        As there.
    hypotheses : sequence of DriveHypothesis
    """
    waiting, doubted = best_first(hypotheses), list[DriveHypothesis]()
    while waiting and waiting[0].nats > least:
        first = beyond_doubt(unexplained, waiting[0], least)
        if first is waiting[0]:
            break
        doubted.append(first)
        waiting = waiting[1:]
    return best_first([*waiting, *doubted])
