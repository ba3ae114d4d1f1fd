"""Requirements turned round: which sensor keeps an error after an outage, from the covariance of its own matched filter."""

from insemu.require.answer import (
    DOUBTFUL,
    PLANES,
    Alternative,
    Answer,
    Place,
    Question,
    Verdict,
    figures_text,
    flights,
    require,
    scenario_of,
    wish_of,
)
from insemu.require.asked import QUANTITIES, Requirement, asked, quantile
from insemu.require.integrity import REGIONS, Guard, guards, protection_factor, recorded_guard
from insemu.require.sensors import FIGURES, UNITS, Sensor, completed, shown
from insemu.require.track import Track, aids_of, prepared

__all__ = [
    "DOUBTFUL",
    "FIGURES",
    "PLANES",
    "QUANTITIES",
    "REGIONS",
    "UNITS",
    "Alternative",
    "Answer",
    "Guard",
    "Place",
    "Question",
    "Requirement",
    "Sensor",
    "Track",
    "Verdict",
    "aids_of",
    "asked",
    "completed",
    "figures_text",
    "flights",
    "guards",
    "prepared",
    "protection_factor",
    "quantile",
    "recorded_guard",
    "require",
    "scenario_of",
    "shown",
    "wish_of",
]
