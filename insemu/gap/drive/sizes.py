"""Effects of the fixes that are no multiple of one column: what is known of their size, and what one more of them does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.effects import EFFECTS, Column, FixGeometry, Motion
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.evidence.fixes import NED

Array = NDArray[np.float64]
#: Sizes that are tried first of an effect that is no multiple of one column, and how near to the best it is brought, relative.
SIZES, SIZE_REL = 12, 0.01


def smoothing(nominal: Nominal, columns: Sequence[Column], corrections: Mapping[int, float]) -> Array:
    """Time constants (3,) in s, NED, of velocities that were smoothed and are put right along the motion, known ones and found ones.

    Parameters
    ----------
    nominal : Nominal
        What is known.
    columns : sequence of Column
    corrections : mapping of int to float
        Column and what of it was taken out of the data.
    """
    tau = np.zeros(3)
    for use in nominal.effects:
        if use.effect.does("smoothing"):
            tau += use.effect.smoothing(use)
    for j, value in corrections.items():
        if j < len(columns) and EFFECTS[columns[j].effect].does("smoothing"):
            tau[[NED.index(a) for a in columns[j].axes]] += value
    return tau


def has_size(nominal: Nominal, column: Column) -> bool:
    """Whether the effect of a column is no multiple of it, so that it is brought to its size; one of known size is put right by its slope.

    Parameters
    ----------
    nominal : Nominal
        What is known.
    column : Column
    """
    return EFFECTS[column.effect].does("about") and not known_size(nominal, column)


def known_size(nominal: Nominal, column: Column) -> float:
    """What is known of the coefficient of an effect that is no multiple of its column; 0 of others.

    Parameters
    ----------
    nominal : Nominal
        What is known.
    column : Column
    """
    effect, name = EFFECTS[column.effect], column.label.partition("_")[0]
    if not effect.does("about"):
        return 0.0
    known = (u[name][effect.axes.index(column.axes[0])] for u in nominal.effects if u.id == effect.id)
    return float(sum(known) ** column.power)


def likeliest_size(left: Callable[[float], float], column: Column) -> float:
    """The size of an effect that is no multiple of its column at which least is left.

    Parameters
    ----------
    left : callable
        What is left at a size.
    column : Column
    """
    parameter = EFFECTS[column.effect].parameter(column.label.partition("_")[0])
    assert parameter.most is not None
    grid = np.linspace(math.log(0.1 * column.scale), column.power * math.log(parameter.most), SIZES)
    k = int(np.argmin([left(math.exp(x)) for x in grid]))
    around = (grid[max(k - 1, 0)], grid[min(k + 1, SIZES - 1)])
    best = scipy.optimize.minimize_scalar(
        lambda x: left(math.exp(x)), bounds=around, method="bounded", options={"xatol": SIZE_REL}
    )
    return math.exp(float(best.x))


def slope_about(column: Column, size: float, motion: Motion, fixes: FixGeometry) -> Column:
    """What one more of an effect of the fixes does that has a size already.

    Parameters
    ----------
    column : Column
    size : float
        In the unit of the column.
    motion, fixes : Motion, FixGeometry
    """
    about, h = EFFECTS[column.effect].about, 0.01 * size
    more, less = (about(column, s, motion, fixes).fixes for s in (size + h, size - h))
    assert more is not None and less is not None
    return replace(column, fixes=((size + h) * more - (size - h) * less) / (2.0 * h))
