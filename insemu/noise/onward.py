"""Draws that go on: a process gives its samples piece by piece, the same numbers whatever the lengths of the pieces."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws

if TYPE_CHECKING:
    from insemu.noise.process import NoiseModel

Array = NDArray[np.float64]
#: Overwrites an array with the next samples.
Source = Callable[[Array], None]

#: Longest signal of a process that cannot be drawn in pieces, samples.
MOST_HELD = 20_000_000
#: Numbers that are drawn and thrown away at a time.
_PIECE = 1 << 16


def check_held(n: int, symbol: str) -> None:
    """Raise ``InputError`` where a signal that is drawn as a whole is too long for that."""
    if n > MOST_HELD:
        raise InputError(
            f"{symbol} is drawn as a whole, {n} samples of it, expected at most {MOST_HELD}; a sum of GM stands for it in a longer signal"
        )


def first_order(rng: np.random.Generator, phi: float, first: float, rest: float) -> Source:
    """``y_k = phi y_(k-1) + rest w_k``.

    Parameters
    ----------
    rng : Generator
    phi : float
    first, rest : float
        Standard deviation of the first sample, and of the innovations after it.
    """
    scale, before = first, 0.0

    def following(out: Array) -> None:
        nonlocal scale, before
        if out.size:
            draws.standard_normal(out, rng)
            draws.first_order(out, phi, scale, rest, before)
            scale, before = rest, float(out[-1])

    return following


def rational(rng: np.random.Generator, sigma: float, b: Array, a: Array, memory: Array) -> Source:
    """White numbers of a standard deviation through a filter.

    Parameters
    ----------
    rng : Generator
    sigma : float
    b, a : (m,) arrays
        Numerator and denominator, see :func:`insemu.noise.compiled.draws.rational_filter`.
    memory : (m - 1,) array
        State of the filter, changed.
    """

    def following(out: Array) -> None:
        draws.standard_normal(out, rng)
        out *= sigma
        draws.rational_filter(out, b, a, memory)

    return following


def of_block(block: StateBlock, n: int, rng: np.random.Generator) -> Source:
    """What a state block sees, ``n`` samples in all: their white noise is drawn first, then what drives the states.

    Parameters
    ----------
    block : StateBlock
    n : int
    rng : Generator
    """
    root_Q, root_P = block.roots()
    state = root_P @ rng.standard_normal(block.n)
    white, thrown, begun = copy.deepcopy(rng), np.empty(_PIECE), 0
    for first in range(0, n, _PIECE):
        draws.standard_normal(thrown[: n - first], rng)
    Phi, c, gain = np.array(block.Phi), np.array(block.c), np.ones(1)

    def following(out: Array) -> None:
        nonlocal begun
        if out.size:
            draws.standard_normal(out, white)
            out *= math.sqrt(block.white)
            seen = np.concatenate([np.zeros(begun), out])  # the sample before is the one whose state is known
            draws.driven(seen, Phi, root_Q, c, state, gain, rng)
            out[:], begun = seen[begun:], 1

    return following


def sources(model: NoiseModel, n: int, dt: float, rng: np.random.Generator) -> Sequence[Source]:
    """Sources of the processes of a model, which draw what :meth:`insemu.noise.NoiseModel.simulate` draws.

    Parameters
    ----------
    model : NoiseModel
    n : int
        Samples in all.
    dt : float
        Sampling interval, s.
    rng : Generator

    Raises
    ------
    InputError
        A process that follows a covariate, or one that is drawn as a whole and too long for that.
    """
    follow = next((p for p in model if p.follows is not None), None)
    if follow is not None:
        raise InputError(f"{follow} follows a covariate, which is not drawn in pieces")
    return [p.source(n, dt, child) for p, child in zip(model, rng.spawn(len(model)), strict=True)]
