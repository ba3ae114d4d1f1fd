"""Datasheet units at the door: ``0.032 deg/s/sqrt(Hz)`` to SI and back.

A table of the field's units with a parser of products, quotients, powers and ``sqrt(...)`` does the whole job in fewer lines than a
general registry needs to be taught the field's habits: angle is a dimension (so that rad is checked), ``g`` is 9.80665 m/s^2 (``ug`` is
micro-g, ``mg`` milli-g), and ``ppm``, ``%`` and ``LSB`` count as pure numbers. Spellings that people use are read too: ``dps``,
``ug/√Hz``, ``ug/rtHz``, ``m/s2``, ``m/s²``, ``rad s^-1``, ``°/h``, ``mph``, ``knots``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from numbers import Real

from insemu.errors import InputError, nearest, shown

#: Standard gravity, the ``g`` of datasheets, m/s^2.
STANDARD_GRAVITY = 9.80665

Dimension = tuple[Fraction, Fraction, Fraction, Fraction]  # exponents of angle, length, time, temperature


def _dimension(angle: int = 0, length: int = 0, time: int = 0, temperature: int = 0) -> Dimension:
    return (Fraction(angle), Fraction(length), Fraction(time), Fraction(temperature))


@dataclass(frozen=True)
class Unit:
    """A unit: ``factor`` times its SI unit, with the exponents of angle, length, time and temperature."""

    factor: float
    dimension: Dimension

    def __mul__(self, other: Unit) -> Unit:
        return Unit(self.factor * other.factor, _combine(self.dimension, other.dimension, 1))

    def __truediv__(self, other: Unit) -> Unit:
        return Unit(self.factor / other.factor, _combine(self.dimension, other.dimension, -1))

    def __pow__(self, exponent: Fraction) -> Unit:
        a, b, c, d = self.dimension
        return Unit(self.factor ** float(exponent), (a * exponent, b * exponent, c * exponent, d * exponent))


def _combine(one: Dimension, two: Dimension, sign: int) -> Dimension:
    return (one[0] + sign * two[0], one[1] + sign * two[1], one[2] + sign * two[2], one[3] + sign * two[3])


_ONE = Unit(1.0, _dimension())
_S = Unit(1.0, _dimension(time=1))
_M = Unit(1.0, _dimension(length=1))
_RAD = Unit(1.0, _dimension(angle=1))
_ACCELERATION = _dimension(length=1, time=-2)


def _times(factor: float, unit: Unit) -> Unit:
    return Unit(factor * unit.factor, unit.dimension)


_UNITS: Mapping[str, Unit] = {
    "rad": _RAD,
    "mrad": _times(1e-3, _RAD),
    "urad": _times(1e-6, _RAD),
    "deg": _times(math.pi / 180, _RAD),
    "°": _times(math.pi / 180, _RAD),
    "arcmin": _times(math.pi / 10800, _RAD),
    "arcsec": _times(math.pi / 648000, _RAD),
    "rev": _times(2.0 * math.pi, _RAD),
    "m": _M,
    "mm": _times(1e-3, _M),
    "cm": _times(1e-2, _M),
    "km": _times(1e3, _M),
    "ft": _times(0.3048, _M),
    "s": _S,
    "sec": _S,
    "ms": _times(1e-3, _S),
    "us": _times(1e-6, _S),
    "ns": _times(1e-9, _S),
    "min": _times(60.0, _S),
    "h": _times(3600.0, _S),
    "day": _times(86_400.0, _S),
    "hr": _times(3600.0, _S),
    "Hz": _ONE / _S,
    "kHz": _times(1e3, _ONE / _S),
    "g": Unit(STANDARD_GRAVITY, _ACCELERATION),
    "mg": Unit(STANDARD_GRAVITY * 1e-3, _ACCELERATION),
    "ug": Unit(STANDARD_GRAVITY * 1e-6, _ACCELERATION),
    "Gal": Unit(1e-2, _ACCELERATION),
    "mGal": Unit(1e-5, _ACCELERATION),
    "kn": Unit(1852.0 / 3600.0, _dimension(length=1, time=-1)),
    "mph": Unit(1609.344 / 3600.0, _dimension(length=1, time=-1)),
    "kph": Unit(1.0 / 3.6, _dimension(length=1, time=-1)),
    "dps": Unit(math.pi / 180, _dimension(angle=1, time=-1)),
    "mdps": Unit(math.pi / 180e3, _dimension(angle=1, time=-1)),
    "dph": Unit(math.pi / 648000, _dimension(angle=1, time=-1)),
    "rpm": Unit(math.pi / 30, _dimension(angle=1, time=-1)),
    "K": Unit(1.0, _dimension(temperature=1)),
    "degC": Unit(1.0, _dimension(temperature=1)),  # a difference; absolute temperatures are plain numbers in degC
    "ppm": Unit(1e-6, _dimension()),
    "%": Unit(1e-2, _dimension()),
    "LSB": _ONE,  # a count; what one is worth is written in front: 0.05 deg/s/LSB
    "1": _ONE,
}

#: Other spellings of the units above.
_SPELLINGS: Mapping[str, str] = {
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rads": "rad",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "second": "s", "seconds": "s", "secs": "s", "minute": "min",
    "minutes": "min", "days": "day", "hour": "h", "hours": "h", "hrs": "h", "hz": "Hz", "HZ": "Hz", "G": "g", "mG": "mg", "gs": "g",
    "knot": "kn", "knots": "kn", "kt": "kn", "kts": "kn", "kmh": "kph", "degC": "degC", "°C": "degC", "C": "degC",
    "Celsius": "degC", "celsius": "degC", "lsb": "LSB", "count": "LSB", "counts": "LSB", "usec": "us", "msec": "ms",
    "nsec": "ns", "DPS": "dps",
}  # fmt: skip

#: Limits of what is read as a unit or a quantity: characters, nested parentheses, largest power. Nobody writes more.
LONGEST, DEEPEST, HIGHEST = 200, 16, 24

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_RAISED = re.compile(r"[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+")
_TOKEN = re.compile(r"\s*(?:(?P<name>[A-Za-zµμ°%]+)|(?P<number>\d+(?:\.\d+)?|\.\d+)|(?P<sign>\*\*|[*/^()·⋅×√-]))")
_QUANTITY = re.compile(r"(?P<value>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>.*)", re.DOTALL)


class _Parser:
    """Recursive descent over ``unit := factor (('*' | '/' | blank) factor)*``, ``factor := atom ('^'? number)?``."""

    def __init__(self, text: str) -> None:
        self.text = shown(text)
        self.tokens: list[str] = []
        position, depth = 0, 0
        stripped = _RAISED.sub(lambda m: f"^({m.group().translate(_SUPERSCRIPTS)})", text.rstrip())
        while position < len(stripped):
            match = _TOKEN.match(stripped, position)
            if match is None:
                raise InputError(f"cannot read the unit {self.text} at {shown(stripped[position:])}")
            token = match.group().strip()
            depth += (token == "(") - (token == ")")
            if depth > DEEPEST:
                raise InputError(f"cannot read the unit {self.text}: more than {DEEPEST} nested parentheses")
            self.tokens.append(token)
            position = match.end()
        self.at = 0

    def peek(self) -> str | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def take(self, expected: str | None = None) -> str:
        token = self.peek()
        if token is None or (expected is not None and token != expected):
            found = "the end" if token is None else f"'{token}'"
            raise InputError(f"cannot read the unit {self.text}: expected {expected or 'a unit'}, found {found}")
        self.at += 1
        return token

    def unit(self) -> Unit:
        value = self.factor()
        while (token := self.peek()) is not None and token != ")":
            if token in ("*", "/", "·", "⋅", "×"):
                self.take()
            elif not (token[0].isalpha() or token in ("(", "√", "°", "%")):
                break
            right = self.factor()
            value = value / right if token == "/" else value * right
        return value

    def factor(self) -> Unit:
        value = self.atom()
        token = self.peek()
        if token in ("^", "**"):
            self.take()
            return value ** self.exponent()
        if token is not None and (token == "-" or token[0].isdigit()):  # m/s2, m s-2
            return value ** self.exponent()
        return value

    def exponent(self) -> Fraction:
        if self.peek() == "(":
            self.take("(")
            value = self.exponent()
            if self.peek() == "/":
                self.take("/")
                value = value / self.exponent()
            self.take(")")
        elif self.peek() == "-":
            self.take("-")
            value = -self.exponent()
        else:
            token = self.take()
            try:
                value = Fraction(token)
            except ValueError:
                raise InputError(f"cannot read the unit {self.text}: expected an exponent, found '{token}'") from None
        if abs(value) > HIGHEST:
            raise InputError(f"cannot read the unit {self.text}: powers above {HIGHEST} are no unit")
        return value

    def atom(self) -> Unit:
        token = self.take()
        if token == "(":
            value = self.unit()
            self.take(")")
            return value
        if token in ("sqrt", "√", "rt", "root"):
            return self.atom() ** Fraction(1, 2)
        found = _named(token)
        if found is None:  # rtHz
            inner = _named(token.removeprefix("sqrt").removeprefix("root").removeprefix("rt"))
            found = None if inner is None else inner ** Fraction(1, 2)
        if found is None:
            raise InputError(f"unknown unit '{token[:40]}' in {self.text}" + nearest(token[:40], _UNITS))
        return found


def _named(token: str) -> Unit | None:
    name = token.replace("µ", "u").replace("μ", "u")
    return _UNITS.get(_SPELLINGS.get(name, name))


@lru_cache(maxsize=1024)
def _parsed(text: str) -> Unit:
    parser = _Parser(text)
    try:
        value = parser.unit()
    except (OverflowError, ZeroDivisionError):
        raise InputError(f"cannot read the unit {shown(text)}: its size is no number") from None
    if parser.peek() is not None:
        raise InputError(f"cannot read the unit {shown(text)} at '{parser.peek()}'")
    if not (math.isfinite(value.factor) and value.factor > 0.0):
        raise InputError(f"cannot read the unit {shown(text)}: its size is no number")
    return value


def parse_unit(text: str) -> Unit:
    """Return the unit that a text such as ``deg/s/sqrt(Hz)`` or ``(m/s^2)^2/Hz`` names.

    Raises
    ------
    InputError
        An unknown unit, malformed text, or no text.
    """
    if not isinstance(text, str):
        raise InputError(f"found {shown(text)}, expected a unit as text")
    if len(text) > LONGEST:
        raise InputError(
            f"cannot read {shown(text)} as a unit: it has {len(text)} characters, at most {LONGEST} are read"
        )
    return _parsed(text.strip()) if text.strip() else _ONE


def scaled_unit(text: str) -> Unit:
    """Return a unit with a number in front of it as one unit: ``0.05 deg/s/LSB`` of a column of counts.

    Raises
    ------
    InputError
        As :func:`parse_unit`; a number that is zero or not finite.
    """
    value, unit = _split(text) if isinstance(text, str) and text.strip()[:1] in "0123456789.+-" else (1.0, text)
    if not (math.isfinite(value) and value != 0.0):
        raise InputError(f"cannot read {shown(text)} as a unit: its size is no number")
    return _times(value, parse_unit(unit))


def _split(quantity: str) -> tuple[float, str]:
    """The number in front, and the rest."""
    if len(quantity) > LONGEST:
        raise InputError(f"cannot read {shown(quantity)} as a quantity: at most {LONGEST} characters are read")
    match = _QUANTITY.fullmatch(quantity.strip())
    if match is None:
        raise InputError(f"cannot read {shown(quantity)} as a quantity; expected a number and a unit")
    return float(match["value"]), match["unit"]


def parse(quantity: str | float | int, unit: str) -> float:
    """Return a quantity in the SI ``unit``, which also fixes its dimension.

    Parameters
    ----------
    quantity : str or number
        ``"0.032 deg/s/sqrt(Hz)"``; a bare number is taken as already in ``unit``.
    unit : str
        The unit of the returned number, for example ``"rad/s/sqrt(Hz)"``.

    Raises
    ------
    InputError
        Neither text nor a number, malformed text, an unknown unit, a number that is not finite, or a unit of another dimension (the
        message says which was expected).

    Examples
    --------
    >>> round(parse("1 deg/sqrt(h)", "rad/s/sqrt(Hz)"), 9)
    0.000290888
    """
    if isinstance(quantity, bool) or not isinstance(quantity, str | Real):
        raise InputError(f"found {shown(quantity)}, expected a quantity in {unit or 'plain numbers'}")
    if isinstance(quantity, str):
        try:
            value, given = _split(quantity)
        except InputError as error:
            raise InputError(f"{error.message} such as '1.5 {unit}'") from None
    else:
        given = ""
        try:
            value = float(quantity)
        except OverflowError:
            value = math.inf
    result = value * conversion(given, unit) if given else value
    if not math.isfinite(result):
        raise InputError(f"found {shown(quantity)}, expected a finite number")
    return result


def conversion(given: str, wanted: str) -> float:
    """Return the factor that takes numbers in ``given`` to numbers in ``wanted``.

    Raises
    ------
    InputError
        The dimensions differ.
    """
    one, two = parse_unit(given), parse_unit(wanted)
    if one.dimension != two.dimension:
        raise InputError(
            f"the unit '{given}' has another dimension than '{wanted or '1'}', expected something like '{wanted or '1'}'"
        )
    return one.factor / two.factor


#: Units in which tables print quantities of a gyroscope (``rad/s``) and an accelerometer (``m/s^2``): SI unit to datasheet unit.
DATASHEET: Mapping[str, str] = {
    "rad/s": "deg/h",
    "rad/s/sqrt(Hz)": "deg/sqrt(h)",
    "rad/s*sqrt(Hz)": "deg/h*sqrt(Hz)",
    "rad/s^2": "deg/h/s",
    "rad": "deg",
    "m/s^2": "mg",
    "m/s^2/sqrt(Hz)": "ug/sqrt(Hz)",
    "m/s^2*sqrt(Hz)": "ug*sqrt(Hz)",
    "m/s^3": "ug/s",
    "m/s": "m/s",
    "rad/s/K": "deg/h/K",
    "m/s^2/K": "mg/K",
    "rad/s/(m/s^2)": "deg/h/g",
}


def datasheet(value: float, unit: str) -> tuple[float, str]:
    """Return ``(value, unit)`` in the unit that datasheets use for the SI ``unit``; unknown units come back unchanged.

    >>> value, unit = datasheet(parse("2.42 deg/sqrt(h)", "rad/s/sqrt(Hz)"), "rad/s/sqrt(Hz)")
    >>> round(value, 12), unit
    (2.42, 'deg/sqrt(h)')
    """
    wanted = DATASHEET.get(unit)
    if wanted is None:
        return value, unit
    return value * conversion(unit, wanted), wanted
