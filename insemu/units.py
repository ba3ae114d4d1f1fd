"""Datasheet units at the door: ``0.032 deg/s/sqrt(Hz)`` to SI and back.

A table of the field's units with a parser of products, quotients, powers and ``sqrt(...)`` does the whole job in fewer lines than a
general registry needs to be taught the field's habits: angle is a dimension (so that rad is checked), ``g`` is 9.80665 m/s^2 (``ug`` is
micro-g, ``mg`` milli-g), and ``ppm`` and ``%`` count as pure numbers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from insemu.errors import InputError, nearest

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
    "m": _M,
    "mm": _times(1e-3, _M),
    "cm": _times(1e-2, _M),
    "km": _times(1e3, _M),
    "ft": _times(0.3048, _M),
    "s": _S,
    "sec": _S,
    "ms": _times(1e-3, _S),
    "us": _times(1e-6, _S),
    "min": _times(60.0, _S),
    "h": _times(3600.0, _S),
    "hr": _times(3600.0, _S),
    "Hz": _ONE / _S,
    "kHz": _times(1e3, _ONE / _S),
    "g": Unit(STANDARD_GRAVITY, _ACCELERATION),
    "mg": Unit(STANDARD_GRAVITY * 1e-3, _ACCELERATION),
    "ug": Unit(STANDARD_GRAVITY * 1e-6, _ACCELERATION),
    "mGal": Unit(1e-5, _ACCELERATION),
    "kn": Unit(1852.0 / 3600.0, _dimension(length=1, time=-1)),
    "K": Unit(1.0, _dimension(temperature=1)),
    "degC": Unit(1.0, _dimension(temperature=1)),  # a difference; absolute temperatures are plain numbers in degC
    "ppm": Unit(1e-6, _dimension()),
    "%": Unit(1e-2, _dimension()),
    "1": _ONE,
}

_TOKEN = re.compile(r"\s*(?:(?P<name>[A-Za-zµμ°%]+)|(?P<number>\d+(?:\.\d+)?)|(?P<sign>\*\*|[*/^()·√-]))")
_QUANTITY = re.compile(r"^\s*(?P<value>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>.*?)\s*$")


class _Parser:
    """Recursive descent over ``unit := factor (('*' | '/') factor)*``, ``factor := atom ('^' number)?``."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens: list[str] = []
        position = 0
        stripped = text.rstrip()
        while position < len(stripped):
            match = _TOKEN.match(stripped, position)
            if match is None:
                raise InputError(f"cannot read the unit '{text}' at '{stripped[position:]}'")
            self.tokens.append(match.group().strip())
            position = match.end()
        self.at = 0

    def peek(self) -> str | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def take(self, expected: str | None = None) -> str:
        token = self.peek()
        if token is None or (expected is not None and token != expected):
            found = "the end" if token is None else f"'{token}'"
            raise InputError(f"cannot read the unit '{self.text}': expected {expected or 'a unit'}, found {found}")
        self.at += 1
        return token

    def unit(self) -> Unit:
        value = self.factor()
        while self.peek() in ("*", "/", "·"):
            operator = self.take()
            right = self.factor()
            value = value / right if operator == "/" else value * right
        return value

    def factor(self) -> Unit:
        value = self.atom()
        if self.peek() in ("^", "**"):
            self.take()
            value = value ** self.exponent()
        return value

    def exponent(self) -> Fraction:
        if self.peek() == "(":
            self.take("(")
            value = self.exponent()
            if self.peek() == "/":
                self.take("/")
                value = value / self.exponent()
            self.take(")")
            return value
        if self.peek() == "-":
            self.take("-")
            return -self.exponent()
        token = self.take()
        try:
            return Fraction(token)
        except ValueError:
            raise InputError(f"cannot read the unit '{self.text}': expected an exponent, found '{token}'") from None

    def atom(self) -> Unit:
        token = self.take()
        if token == "(":
            value = self.unit()
            self.take(")")
            return value
        if token in ("sqrt", "√"):
            self.take("(")
            value = self.unit()
            self.take(")")
            return value ** Fraction(1, 2)
        name = token.replace("µ", "u").replace("μ", "u")
        if name not in _UNITS:
            raise InputError(f"unknown unit '{token}' in '{self.text}'" + nearest(name, _UNITS))
        return _UNITS[name]


def parse_unit(text: str) -> Unit:
    """Return the unit that a text such as ``deg/s/sqrt(Hz)`` or ``(m/s^2)^2/Hz`` names.

    Raises
    ------
    InputError
        An unknown unit or malformed text.
    """
    if not text.strip():
        return _ONE
    parser = _Parser(text)
    value = parser.unit()
    if parser.peek() is not None:
        raise InputError(f"cannot read the unit '{text}' at '{parser.peek()}'")
    return value


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
        Malformed text, an unknown unit, or a unit of another dimension (the message says which was expected).

    Examples
    --------
    >>> round(parse("1 deg/sqrt(h)", "rad/s/sqrt(Hz)"), 9)
    0.000290888
    """
    if isinstance(quantity, bool):
        raise InputError(f"found {quantity}, expected a quantity in {unit or 'plain numbers'}")
    if isinstance(quantity, int | float):
        value, given = float(quantity), None
    else:
        match = _QUANTITY.match(quantity)
        if match is None:
            raise InputError(
                f"cannot read '{quantity}' as a quantity; expected a number and a unit such as '1.5 {unit}'"
            )
        value = float(match["value"])
        given = match["unit"] or None
    if not math.isfinite(value):
        raise InputError(f"found {quantity}, expected a finite number")
    if given is None:
        return value
    return value * conversion(given, unit)


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
