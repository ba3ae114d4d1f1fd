"""Sensor cards: figures of datasheets with their sources, and the noise models that they stand for.

A card (``cards/NAME.yaml``) holds what a source prints; :func:`read_figures` reads the same figures from a text such as
``"ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h"``. :func:`models` says how each figure becomes a process, and what is assumed.
"""

from insemu.sensors.cards import Card, card, names, of_text
from insemu.sensors.conversion import CASES, Assumptions, AxisModel, axis_models, models, save, spelled
from insemu.sensors.figures import KINDS, Figure, read_figures

__all__ = [
    "CASES",
    "KINDS",
    "Assumptions",
    "AxisModel",
    "Card",
    "Figure",
    "axis_models",
    "card",
    "models",
    "names",
    "of_text",
    "read_figures",
    "save",
    "spelled",
]
