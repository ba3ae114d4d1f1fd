"""Figures that datasheets print: what each is, and reading them from a text.

Definitions follow IEEE Std 952-1997, Annex C (coefficients N, B and K of the Allan variance): angular and velocity random walk are N; the
in-run bias stability is the lowest point of the Allan deviation, which is sqrt(2 ln 2 / pi) B = 0.664 B.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from insemu import units
from insemu.errors import InputError, found_at

#: SI unit of a sensor's signal.
SIGNAL_UNITS: Mapping[str, str] = {"gyro": "rad/s", "accel": "m/s^2"}
#: What messages call them.
SENSORS: Mapping[str, str] = {"gyro": "gyroscopes", "accel": "accelerometers"}


@dataclass(frozen=True)
class Kind:
    """A kind of figure: its unit in terms of the signal's unit ``{u}``, its meaning, and how texts call it."""

    unit: str
    meaning: str
    called: str  # regular expression
    example: str

    def unit_for(self, sensor: str) -> str:
        """The SI unit for ``gyro`` or ``accel``."""
        return self.unit.format(u=SIGNAL_UNITS[sensor])


#: Every kind that a card or a text may give; the first whose name is found in a clause of a text wins.
KINDS: Mapping[str, Kind] = {
    "bias_coefficient": Kind(
        "{u}", "coefficient B of the bias instability (Allan deviation 0.664 B)",
        r"bias[ -]instability coefficient|coefficient of bias[ -]instability|\bBI?\b(?=\s*[=:])", "B = 12 deg/h",
    ),
    "rate_random_walk": Kind(
        "{u}*sqrt(Hz)", "random walk of the bias, K",
        r"\bRRW\b|rate random walk|acceleration random walk|bias random walk", "RRW 3 deg/h/sqrt(h)",
    ),
    "random_walk": Kind(
        "{u}/sqrt(Hz)", "angular or velocity random walk, N",
        r"\b[AV]RW\b|angular random walk|angle random walk|velocity random walk", "ARW 0.34 deg/sqrt(h)",
    ),
    "noise_density": Kind(
        "{u}/sqrt(Hz)", "noise density in the pass band",
        r"noise (?:spectral )?density|spectral noise density|\bNSD\b", "noise density 0.008 deg/s/sqrt(Hz)",
    ),
    "bias_sigma": Kind(
        "{u}", "standard deviation of the in-run bias, with its correlation time",
        r"in[ -]?run bias sigma|Gauss[ -]Markov (?:bias )?sigma|bias sigma", "in-run bias sigma 0.35 deg/h",
    ),
    "bias_stability": Kind(
        "{u}", "lowest point of the Allan deviation",
        r"in[ -]?run (?:bias )?(?:in)?stability|bias (?:in)?stability(?! over)|\bIRBS\b", "in-run bias stability 8 deg/h",
    ),
    "turn_on_bias": Kind(
        "{u}", "bias at the start: it differs from one start, or from one unit, to the next (1 sigma)",
        r"turn[ -]on bias|bias repeatability|(?:on/off|switch[ -]on) bias|bias on/off|initial bias error"
        r"|zero[ -](?:rate|g) (?:offset|output|level)(?! (?:change|variation|drift))", "turn-on bias 0.2 deg/s",
    ),
    "scale_factor": Kind(
        "", "scale-factor error that is left after calibration (1 sigma)", r"scale[ -]factor", "scale factor error 300 ppm",
    ),
    "correlation_time": Kind(
        "s", "correlation time of the in-run bias", r"correlation time|\bT_?c\b", "Tc 500 s",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Figure:
    """A printed figure in SI.

    Parameters
    ----------
    value : float
        Typical value.
    text : str
        As printed.
    worst : float, optional
        Upper limit where the source prints one.
    source : str
        Where it is printed: short name of the source and the place in it, or the clause of a text.
    """

    value: float
    text: str
    worst: float | None = None
    source: str = ""


#: Figures by section (``gyro``, ``accel`` or an axis) and kind.
Figures = dict[str, dict[str, Figure]]

_NUMBER = re.compile(
    r"(?<![\w.])(?<!(?<!\d)[-−])[±+]?\s*(?P<limit>[<≤]|max\.?\s|maximum\s)?\s*(?P<value>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)(?![\d-])"
)
_CLAUSES = re.compile(r"[;\n\r|]|,(?!\d)|\.\s|\s(?:and|with)\s")
#: Most words of a unit, characters between a name and its number, and characters of a text.
_WORDS, _NEAR, LONGEST = 4, 200, 200_000


def quantity(text: str, kind: str, sensor: str, where: str) -> float:
    """A figure of a card in SI.

    Parameters
    ----------
    text : str
        Number and unit.
    kind : str
        Key of :data:`KINDS`.
    sensor : {"gyro", "accel"}
    where : str
        File, line and key, for messages.

    Raises
    ------
    InputError
        A unit of another dimension, or no positive number.
    """
    with found_at(where):
        value = units.parse(text, KINDS[kind].unit_for(sensor))
    if not value > 0.0:
        raise InputError(f"found {text!r}, expected a positive quantity", where=where)
    return value


def _measure(words: list[str], kind: str) -> tuple[str, str, float] | None:
    """Sensor, unit and factor to SI of the longest run of words that is a unit of the kind."""
    for count in range(min(len(words), _WORDS), 0, -1):
        unit = " ".join(words[:count]).rstrip(".:")
        while unit.endswith(")") and unit.count(")") > unit.count("("):
            unit = unit[:-1]
        if not unit:
            continue
        for sensor in SIGNAL_UNITS:
            try:
                return sensor, unit, units.conversion(unit, KINDS[kind].unit_for(sensor))
            except InputError:
                continue
    return None


def _clause(clause: str) -> tuple[str, str, Figure] | str | None:
    """Kind, sensor and figure of a clause; what is wrong with it; or None where it names no figure."""
    for kind, meaning in KINDS.items():
        named = re.search(meaning.called, clause, re.IGNORECASE if kind != "bias_coefficient" else 0)
        if named is None:
            continue
        # the number usually stands after the name; the features of a datasheet put it in front
        sides = (clause[named.end() :][:_NEAR], clause[: named.start()][-_NEAR:])
        numbers = [(m, side) for side in sides for m in _NUMBER.finditer(side)]
        for match, side in numbers:
            found = _measure(side[match.end() :].split(), kind)
            if found is not None:
                sensor, unit, factor = found
                value = float(match["value"]) * factor
                limit = match["limit"] is not None or re.search(r"\bmax", side) is not None
                if 0.0 < value < math.inf:
                    worst = value if limit else None
                    return kind, sensor, Figure(value, f"{match['value']} {unit}", worst, clause.strip()[:100])
        if numbers:
            return (
                f"'{clause.strip()[:60]}' has no unit of {meaning.meaning}; expected something like '{meaning.example}'"
            )
        return None
    return None


def read_figures(text: str, where: str | None = None) -> Figures:
    """Read the figures that a text names.

    Parameters
    ----------
    text : str
        Clauses separated by commas, semicolons or line ends, each with a name and a quantity in any order:
        ``"ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h, VRW 0.037 m/s/sqrt(h)"``. The unit tells gyroscope from accelerometer; a
        correlation time and a scale factor belong to the figures before them. Clauses that name no figure are passed over.
    where : str, optional
        File, for messages.

    Returns
    -------
    dict
        Section (``gyro``, ``accel``) to kind to :class:`Figure`. Of two figures of one kind the first counts.

    Raises
    ------
    InputError
        No figure at all, or a figure with a unit of another kind.

    Examples
    --------
    >>> figures = read_figures("ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h")
    >>> {kind: figure.text for kind, figure in figures["gyro"].items()}
    {'random_walk': '0.34 deg/sqrt(h)', 'bias_stability': '8 deg/h'}
    """
    if len(text) > LONGEST:
        raise InputError(f"has {len(text)} characters, at most {LONGEST} are read as figures", where=where)
    out: Figures = {}
    wrong: list[str] = []
    last: str | None = None
    for clause in _CLAUSES.split(text):
        found = _clause(clause)
        if isinstance(found, str):
            wrong.append(found)
        if found is None or isinstance(found, str):
            continue
        kind, sensor, figure = found
        if kind in ("correlation_time", "scale_factor"):
            sensor = last or sensor
        out.setdefault(sensor, {}).setdefault(kind, figure)
        last = sensor
    if not out or (wrong and where is None):
        known = ", ".join(kind.example for kind in KINDS.values())
        raise InputError(
            wrong[0] if wrong else f"found no figure in {text.strip()[:60]!r}; expected figures such as {known}",
            where=where,
        )
    return out
