"""How every figure looks: one colour order that survives colour blindness and print, light grids, units on axes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from insemu.errors import InputError

#: Okabe and Ito's colours without yellow, in the order in which designs or processes take them.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#4D4D4D", "#8C564B")
#: Shade of a span without GNSS.
OUTAGE = "#E9ECEF"
NO_MATPLOTLIB = "pictures need the package 'matplotlib': pip install 'insemu[pictures]'"

_SETTINGS: dict[Any, Any] = {  # matplotlib types each name of its settings on its own
    "figure.constrained_layout.use": True,
    "axes.grid": True,
    "grid.color": "#E3E6EA",
    "grid.linewidth": 0.7,
    "axes.edgecolor": "#8A94A0",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.axisbelow": True,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    # an opaque background: among many points there is no free place
    "legend.facecolor": "white",
    "legend.edgecolor": "none",
    "legend.framealpha": 0.85,
    "legend.markerscale": 1.8,
    "lines.linewidth": 1.5,
    "font.family": "DejaVu Sans",
    "svg.fonttype": "none",
    "svg.hashsalt": "insemu",  # the same picture is the same file
}


def can_draw() -> bool:
    """Whether matplotlib is there."""
    return find_spec("matplotlib") is not None


def pyplot() -> Any:
    """Matplotlib's ``pyplot``, which draws files and no windows.

    Raises
    ------
    InputError
        Matplotlib is not installed; it is an extra, since pages need none.
    """
    if not can_draw():
        raise InputError(NO_MATPLOTLIB)
    import matplotlib

    if "matplotlib.pyplot" not in sys.modules:
        matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


@contextmanager
def style() -> Iterator[None]:
    """Draw in the house style."""
    plt = pyplot()
    from cycler import cycler

    with plt.rc_context(_SETTINGS | {"axes.prop_cycle": cycler(color=COLOURS)}):
        yield
