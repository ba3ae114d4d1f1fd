"""Equations such as ``east = speed * cos(heading)``: parsed by a grammar of their own, with units, evaluated on signals. Nothing is executed."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects.base import NED, SIGNAL_UNITS, XYZ
from insemu.effects.motion import behind_low_pass
from insemu.errors import InputError, nearest, shown
from insemu.sample_times import beat
from insemu.units import parse_unit

Array = NDArray[np.float64]
#: Exponents of angle, length, time and temperature, and their SI units.
Dimension = tuple[Fraction, ...]
_BASE = ("rad", "m", "s", "K")
#: Longest equation in characters, largest power, and most signals and functions in one: what a person still reads.
MOST_TEXT, MOST_POWER, MOST_PARTS = 200, 4.0, 24
_NONE: Dimension = parse_unit("").dimension
#: Left sides by sensor.
TARGETS: Mapping[str, tuple[str, ...]] = {"gyro": XYZ, "accel": XYZ, "gnss": NED}
#: Signals of a term with their units; times count as the stamps of the recording do, temperatures in degC.
SIGNALS: Mapping[str, str] = {
    "time": "s",
    "temperature": "K",
    "speed": "m/s",
    **dict.fromkeys((f"velocity_{a}" for a in NED), "m/s"),
    **dict.fromkeys(("course", "heading", "pitch", "roll"), "rad"),
    **dict.fromkeys((f"rate_{a}" for a in XYZ), "rad/s"),
    **dict.fromkeys((f"force_{a}" for a in XYZ), "m/s^2"),
}
#: Functions, with how many numbers follow their argument; those of an angle; those without an argument, which are of time.
_FUNCTIONS = {"abs": 0, "sign": 0, "sqrt": 0, "sin": 0, "cos": 0, "above": 1, "lag": 1}
_ANGLE_NAMES = ("roll", "pitch", "heading")
_ANGLES, _OF_TIME = ("sin", "cos"), {"after": 1, "between": 2}
_UFUNCS: Mapping[str, Callable[[Array], Array]] = {
    "abs": np.abs, "sign": np.sign, "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos,
}  # fmt: skip


@dataclass(frozen=True)
class Signals:
    """What a term may be made of, at times (n,); what is not known is None.

    Parameters
    ----------
    t : (n,) array
        s.
    velocity, rpy : (n, 3) arrays, optional
        NED, m/s; roll, pitch and heading of the vehicle, rad.
    rate, force : (n, 3) arrays, optional
        rad/s and m/s^2, axes of the sensor; of fixes the axes of the body.
    temperature : (n,) array, optional
        degC.
    """

    t: Array
    velocity: Array | None = None
    rpy: Array | None = None
    rate: Array | None = None
    force: Array | None = None
    temperature: Array | None = None

    def __getitem__(self, name: str) -> Array:
        kind, _, part = name.partition("_")
        if name == "time":
            return self.t
        if name == "temperature" and self.temperature is not None:
            return self.temperature
        if kind in ("rate", "force") and (known := getattr(self, kind)) is not None:
            return np.asarray(known[:, XYZ.index(part)])
        if kind in ("speed", "course", "velocity") and self.velocity is not None:
            v = self.velocity
            if part:
                return np.asarray(v[:, NED.index(part)])
            return np.linalg.norm(v, axis=1) if kind == "speed" else np.arctan2(v[:, 1], v[:, 0])
        if name in _ANGLE_NAMES and self.rpy is not None:
            return np.asarray(self.rpy[:, _ANGLE_NAMES.index(name)])
        raise InputError(f"the signal '{name}' of an equation is not known there")


@dataclass(frozen=True)
class Equation:
    """What an error is proportional to.

    Parameters
    ----------
    target : str
        The left side: an axis of the sensor, or a direction of the fixes.
    term : ast.expr
        The right side, checked.
    names : frozenset of str
        Its signals.
    dimension : tuple
        Of the coefficient.
    """

    target: str
    term: ast.expr
    names: frozenset[str]
    dimension: Dimension

    @property
    def text(self) -> str:
        """The equation as it is written."""
        return f"{self.target} = {ast.unparse(self.term)}"

    @property
    def length(self) -> int:
        """How many signals and powers its term has."""
        nodes = list(ast.walk(self.term))
        return sum(isinstance(n, ast.Pow) or (isinstance(n, ast.Name) and n.id in SIGNALS) for n in nodes)

    @property
    def unit(self) -> str:
        """Unit of the coefficient, SI."""
        up = [_power(b, e) for b, e in zip(_BASE, self.dimension, strict=True) if e > 0]
        down = [_power(b, -e) for b, e in zip(_BASE, self.dimension, strict=True) if e < 0]
        return "/".join(["*".join(up) or "1", *down]) if up or down else ""

    def of(self, signals: Signals) -> Array:
        """The term (n,) at a coefficient of one; ``InputError`` where a signal is not known or a value is not finite."""
        with np.errstate(all="ignore"):
            out = np.broadcast_to(np.asarray(_value(self.term, signals), dtype=np.float64), signals.t.shape)
        if not np.isfinite(out).all():
            raise InputError(f"the equation '{self.text}' has no finite value at {signals.t[~np.isfinite(out)][0]:g} s")
        return np.asarray(out)


def _power(base: str, exponent: Fraction) -> str:
    whole = exponent if exponent.denominator == 1 else 2 * exponent
    text = base if whole == 1 else f"{base}^{whole}"
    return text if exponent.denominator == 1 else f"sqrt({text})"


@lru_cache(maxsize=1024)
def equation(text: str, sensor: str) -> Equation:
    """Read an equation.

    Parameters
    ----------
    text : str
        ``target = term``: signals (:data:`SIGNALS`) and numbers, ``+ - * / **``, and ``abs``, ``sign``, ``sqrt``, ``sin``, ``cos``,
        ``lag(x, seconds)``, ``above(x, limit)`` (1 or 0), ``after(second)`` and ``between(second, second)`` (1 or 0).
    sensor : str
        ``gyro``, ``accel`` or ``gnss``.

    Raises
    ------
    InputError
        What is no equation of this grammar.
    """
    left, sign, right = text.partition("=")
    left = left.strip()
    if not sign or left not in TARGETS[sensor] or len(text) > MOST_TEXT:
        known = ", ".join(TARGETS[sensor])
        raise InputError(
            f"found {shown(text)}, expected an equation of at most {MOST_TEXT} characters, its left side one of {known}"
        )
    try:
        term = ast.parse(right.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(f"found {shown(text)}, expected a term such as 'speed * cos(heading)' behind '='") from None
    if sensor == "gnss" and any(isinstance(n, ast.Name) and n.id == "lag" for n in ast.walk(term)):
        raise InputError(f"found {shown(text)}, expected no 'lag' in an error of fixes, which may miss some")
    names = frozenset(n.id for n in ast.walk(term) if isinstance(n, ast.Name) and n.id in SIGNALS)
    if sum(isinstance(n, ast.Name) for n in ast.walk(term)) > MOST_PARTS:
        raise InputError(f"found {shown(text)}, expected at most {MOST_PARTS} signals and functions")
    own = _checked(term, text)
    target = parse_unit(SIGNAL_UNITS.get(sensor, "m")).dimension
    return Equation(left, term, names, tuple(a - b for a, b in zip(target, own or _NONE, strict=True)))


def _number(node: ast.expr, text: str) -> float:
    negative = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)
    inner = node.operand if isinstance(node, ast.UnaryOp) else node
    if (
        not isinstance(inner, ast.Constant)
        or isinstance(inner.value, bool)
        or not isinstance(inner.value, int | float)
        or not math.isfinite(inner.value)
    ):
        raise InputError(f"in {shown(text)}: found '{ast.unparse(node)}', expected a number")
    return -float(inner.value) if negative else float(inner.value)


def _checked(node: ast.expr, text: str) -> Dimension | None:
    """Dimension of a part of a term; None of a number that stands for itself."""
    match node:
        case ast.Constant():
            _number(node, text)
            return None
        case ast.Name(id=name):
            if name not in SIGNALS:
                raise InputError(f"in {shown(text)}: no signal '{name}'" + nearest(name, SIGNALS))
            return parse_unit(SIGNALS[name]).dimension
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _checked(operand, text)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            own, power = _checked(left, text), _number(right, text)
            if abs(power) > MOST_POWER or (2.0 * power) % 1.0:
                raise InputError(
                    f"in {shown(text)}: the power {power:g}, expected a half or whole one up to {MOST_POWER:g}"
                )
            return None if own is None else tuple(x * Fraction(power) for x in own)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div(), right=right):
            a, b = (_checked(side, text) or _NONE for side in (left, right))
            by = 1 if isinstance(node.op, ast.Mult) else -1
            return tuple(x + by * y for x, y in zip(a, b, strict=True))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            sides = [d for d in (_checked(side, text) for side in (left, right)) if d is not None]
            if len(sides) == 2 and sides[0] != sides[1]:
                raise InputError(f"in {shown(text)}: a sum of two different quantities in '{ast.unparse(node)}'")
            return sides[0] if sides else None
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if (
            name in _OF_TIME and len(args) == _OF_TIME[name]
        ):
            for argument in args:
                _number(argument, text)
            return _NONE
        case ast.Call(func=ast.Name(id=name), args=[first, *more], keywords=[]) if len(more) == _FUNCTIONS.get(name):
            own = _checked(first, text)
            numbers = [_number(a, text) for a in more]
            if name == "lag" and not numbers[0] > 0.0:
                raise InputError(f"in {shown(text)}: a lag of {numbers[0]:g} s, expected a positive one")
            if name in _ANGLES and own not in (None, _NONE, parse_unit("rad").dimension):
                raise InputError(f"in {shown(text)}: '{name}' of what is no angle")
            if name == "sqrt" and own is not None:
                return tuple(x / 2 for x in own)
            return _NONE if name in (*_ANGLES, "sign", "above") else own
    raise InputError(f"in {shown(text)}: '{ast.unparse(node)}' is not of the grammar of equations")


def _value(node: Any, signals: Signals) -> Any:
    """A checked part of a term on signals: (n,) or a number."""
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return signals[name]
        case ast.UnaryOp(operand=operand):
            return -_value(operand, signals)
        case ast.BinOp(left=left, op=op, right=right):
            a, b = _value(left, signals), _value(right, signals)
            match op:
                case ast.Pow():
                    return np.power(a, b)
                case ast.Mult():
                    return a * b
                case ast.Div():
                    return np.divide(a, b)
                case ast.Add():
                    return a + b
            return a - b
        case ast.Call(func=ast.Name(id="after"), args=args):
            return (signals.t > _number(args[0], "")).astype(np.float64)
        case ast.Call(func=ast.Name(id="between"), args=args):
            first, last = (_number(a, "") for a in args)
            return ((signals.t > first) & (signals.t <= last)).astype(np.float64)
        case ast.Call(func=ast.Name(id=name), args=[first, *more]):
            own = np.broadcast_to(_value(first, signals), signals.t.shape)
            if name == "above":
                return (own > _number(more[0], "")).astype(np.float64)
            if name == "lag":
                return behind_low_pass(own, beat(signals.t), _number(more[0], ""))
            return _UFUNCS[name](own)
    raise AssertionError(ast.dump(node))
