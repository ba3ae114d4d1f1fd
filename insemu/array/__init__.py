"""An array of IMUs as one virtual sensor, weighed for the metres at the ends of outages."""

from insemu.array.logs import by_unit
from insemu.array.metres import Flight, Quadratic, Response, quadratic
from insemu.array.session import EQUAL, INVERSE, METRES, SCALE_WISE, ArrayFit, Weighting, gathered, weigh

__all__ = [
    "EQUAL",
    "INVERSE",
    "METRES",
    "SCALE_WISE",
    "ArrayFit",
    "Flight",
    "Quadratic",
    "Response",
    "Weighting",
    "by_unit",
    "gathered",
    "quadratic",
    "weigh",
]
