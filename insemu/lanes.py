"""Eight realizations side by side in compiled code: numbers that are vectors of the processor, one lane for each realization.

A compiled function that is written for numbers takes these as well: arithmetic, comparison and the functions of :mod:`math` go lane by lane. So
one text serves one realization (float64) and eight (:class:`Lanes`). Where a number decides, the text asks :func:`any_of` or takes one of two
values by :func:`where`; both do the same for one number.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typeconv import Conversion
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_cast,
    models,
    overload,
    register_model,
    type_callable,
    typeof_impl,
)
from numba.np.arrayobj import populate_array
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]

#: Realizations that fly together: eight doubles are the widest vector that processors have; where it is narrower, two or four make one.
LANES = 8

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)
_INT = ir.IntType(32)


class Lanes(types.Type):
    """Eight float64 in compiled code."""

    def unify(self, context: Any, other: Any) -> Any:
        """A variable that holds a number first and lanes later holds lanes."""
        return self if isinstance(other, (types.Float, types.Integer)) else None

    def can_convert_from(self, context: Any, other: Any) -> Any:
        """A number stands for eight equal ones."""
        return Conversion.unsafe if isinstance(other, (types.Float, types.Integer)) else None


class Mask(types.Type):
    """Eight truth values in compiled code."""

    def unify(self, context: Any, other: Any) -> Any:
        """A variable that holds one truth value first and eight later holds eight."""
        return self if isinstance(other, types.Boolean) else None


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _BITS)


lanes, mask = Lanes("lanes"), Mask("mask")


class LaneArray(np.ndarray):
    """What compiled code takes as an array of lanes; made by :func:`lanes_of`."""


@typeof_impl.register(LaneArray)
def _typeof(values: LaneArray, context: Any) -> Any:
    return types.Array(lanes, values.ndim, "C", aligned=False)


def empty(shape: tuple[int, ...]) -> Array:
    """An array (..., LANES) of float64 that begins where a vector of the processor does."""
    size = math.prod(shape)
    room = np.empty(size + LANES)
    first = -(room.ctypes.data // room.itemsize) % LANES
    return room[first : first + size].reshape(shape)


def lanes_of(values: Array) -> LaneArray:
    """The same memory as an array of lanes, which are the last axis of ``values`` (..., LANES)."""
    return values.view(np.dtype(("V", values.itemsize * LANES)))[..., 0].view(LaneArray)


def spread(values: ArrayLike) -> LaneArray:
    """An array (...) of numbers as one whose lanes are equal."""
    numbers = np.asarray(values, dtype=np.float64)
    out = empty((*numbers.shape, LANES))
    out[...] = numbers[..., None]
    return lanes_of(out)


def stacked(values: Sequence[ArrayLike]) -> LaneArray:
    """Arrays of one shape, at most :data:`LANES`, as lanes; those without one repeat the first."""
    arrays = [np.asarray(v, dtype=np.float64) for v in values]
    out = empty((*arrays[0].shape, LANES))
    for lane in range(LANES):
        out[..., lane] = arrays[lane if lane < len(arrays) else 0]
    return lanes_of(out)


def _is_number(kind: Any) -> bool:
    return isinstance(kind, (types.Float, types.Integer))


def _spread(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    vector, single = (_VECTOR, types.float64) if wanted == lanes else (_BITS, types.boolean)
    number = context.cast(builder, value, given, single)
    nothing = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES))


for _given, _wanted in ((types.Float, Lanes), (types.Integer, Lanes), (types.Boolean, Mask)):
    lower_cast(_given, _wanted)(_spread)


def _lane_by_lane(function: Any, count: int, result: Any, build: Callable[..., Any]) -> None:
    """Let a function of one or two arguments take lanes; where one of two is a number, it is spread."""

    def kind_of(*given: Any) -> Any:
        fits = len(given) == count and lanes in given and all(k == lanes or _is_number(k) for k in given)
        return result if fits else None

    def lowered(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        return build(builder, *(context.cast(builder, v, k, lanes) for k, v in zip(signature.args, args, strict=True)))

    one, two = (lambda context: lambda a: kind_of(a)), (lambda context: lambda a, b: kind_of(a, b))
    type_callable(function)(one if count == 1 else two)
    for given in product((Lanes, types.Float, types.Integer), repeat=count):
        if Lanes in given:
            lower_builtin(function, *given)(lowered)


def _arithmetic(name: str) -> Callable[..., Any]:
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=("contract",))


def _compared(sign: str) -> Callable[..., Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


def _smaller(sign: str) -> Callable[..., Any]:
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(sign, b, a), b, a)


def _called(name: str) -> Callable[..., Any]:
    def build(builder: Any, x: Any) -> Any:
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_VECTOR, [_VECTOR]), name)
        return builder.call(function, [x])

    return build


def _one_by_one(name: str) -> Callable[..., Any]:
    def build(builder: Any, *values: Any) -> Any:
        number, out = ir.DoubleType(), ir.Constant(_VECTOR, ir.Undefined)
        kind = ir.FunctionType(number, [number] * len(values))
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        for lane in range(LANES):
            at = ir.Constant(_INT, lane)
            one = builder.call(function, [builder.extract_element(v, at) for v in values])
            out = builder.insert_element(out, one, at)
        return out

    return build


def _finite(builder: Any, x: Any) -> Any:
    return builder.fcmp_ordered("==", builder.fsub(x, x), ir.Constant(_VECTOR, [0.0] * LANES))


for _operators, _name in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    for _operator in _operators:
        _lane_by_lane(_operator, 2, lanes, _arithmetic(_name))
for _operator, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _lane_by_lane(_operator, 2, mask, _compared(_sign))
_lane_by_lane(operator.ne, 2, mask, lambda builder, a, b: builder.fcmp_unordered("!=", a, b))
_lane_by_lane(operator.neg, 1, lanes, lambda builder, x: builder.fneg(x))
_lane_by_lane(min, 2, lanes, _smaller("<"))
_lane_by_lane(max, 2, lanes, _smaller(">"))
_lane_by_lane(abs, 1, lanes, _called(f"llvm.fabs.v{LANES}f64"))
_lane_by_lane(math.sqrt, 1, lanes, _called(f"llvm.sqrt.v{LANES}f64"))
_lane_by_lane(math.isfinite, 1, mask, _finite)
_lane_by_lane(math.atan2, 2, lanes, _one_by_one("atan2"))
_lane_by_lane(math.expm1, 1, lanes, _one_by_one("expm1"))
for _function in ("sin", "cos", "exp", "log"):
    _lane_by_lane(getattr(math, _function), 1, lanes, _called(f"llvm.{_function}.v{LANES}f64"))


@intrinsic
def _select(context: Any, test: Any, a: Any, b: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        values = (target.cast(builder, v, k, lanes) for k, v in zip(signature.args[1:], args[1:], strict=True))
        return builder.select(args[0], *values)

    return lanes(mask, a, b), generate


@intrinsic
def _bits(context: Any, test: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(mask), generate


def where(test: Any, a: Any, b: Any) -> Any:
    """``a`` where a test holds, else ``b``; in compiled code.

    Parameters
    ----------
    test : bool or eight of them
    a, b : float or lanes
    """


@overload(where, strict=False)
def _where(test: Any, a: Any, b: Any) -> Any:
    if test == mask:
        return lambda test, a, b: _select(test, a, b)
    return lambda test, a, b: a if test else b


def any_of(test: Any) -> Any:
    """Whether a test holds in any lane; in compiled code."""


@overload(any_of, strict=False)
def _any_of(test: Any) -> Any:
    if test == mask:
        return lambda test: _bits(test) != 0
    return lambda test: test


@intrinsic
def _as_lanes(context: Any, values: Any) -> Any:
    out = types.Array(lanes, values.ndim - 1, "C", aligned=False)

    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        given = target.make_array(values)(target, builder, args[0])
        made = target.make_array(out)(target, builder)
        populate_array(
            made,
            data=builder.bitcast(given.data, made.data.type),
            shape=cgutils.unpack_tuple(builder, given.shape)[:-1],
            strides=cgutils.unpack_tuple(builder, given.strides)[:-1],
            itemsize=target.get_constant(types.intp, LANES * 8),
            meminfo=given.meminfo,
            parent=given.parent,
        )
        return impl_ret_borrowed(target, builder, out, made._getvalue())

    return out(values), generate


@njit(nogil=True, no_cpython_wrapper=True)  # what it returns is nothing to Python
def _room(size: int) -> Any:
    """Zeros that begin where a vector of the processor does."""
    room = np.zeros(LANES * (size + 1))
    first = -(room.ctypes.data // 8) % LANES
    return _as_lanes(room[first : first + LANES * size].reshape((size, LANES)))


def zeros(like: Any, shape: Any) -> Any:
    """Zeros of the same kind as those of an array; in compiled code.

    Parameters
    ----------
    like : array
        Of numbers or lanes.
    shape : int or tuple of int
    """


@overload(zeros, strict=False, inline="always")  # so that the compiler knows the shapes
def _zeros(like: Any, shape: Any) -> Any:
    if like.dtype != lanes:
        return lambda like, shape: np.zeros(shape)
    if isinstance(shape, types.Integer):
        return lambda like, shape: _room(shape)
    return lambda like, shape: _room(shape[0] * shape[1]).reshape(shape)


@intrinsic
def _gather(context: Any, arrays: Any, row: Any, column: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        out = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            kind = arrays.dtype
            array = target.make_array(kind)(target, builder, builder.extract_value(args[0], lane))
            at = cgutils.get_item_pointer(target, builder, kind, array, [args[1], args[2]])
            out = builder.insert_element(out, builder.load(at), ir.Constant(_INT, lane))
        return out

    return lanes(arrays, types.int64, types.int64), generate


def number_at(values: Any, row: int, column: int) -> Any:
    """Number of an array, or lanes of a tuple of as many; in compiled code.

    Parameters
    ----------
    values : (n, k) array, or tuple of LANES of them
    row, column : int
    """


@overload(number_at, strict=False)
def _number_at(values: Any, row: int, column: int) -> Any:
    if isinstance(values, types.Array):
        return lambda values, row, column: values[row, column]
    return lambda values, row, column: _gather(values, row, column)


@intrinsic
def _lane(context: Any, value: Any, lane: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        return builder.extract_element(args[0], args[1])

    return types.float64(lanes, types.int64), generate


@intrinsic
def _with_lane(context: Any, value: Any, lane: Any, number: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        return builder.insert_element(args[0], args[2], args[1])

    return lanes(lanes, types.int64, types.float64), generate


def between(table: Array, place: Any) -> Any:
    """Value between two entries of a table, linearly; in compiled code.

    Parameters
    ----------
    table : (n,) array
    place : float
        From 0 to n - 1.
    """


@overload(between, strict=False)
def _between(table: Array, place: Any) -> Any:
    if place != lanes:

        def number(table: Array, place: Any) -> Any:
            k = min(int(place), table.size - 2)
            return table[k] + (place - k) * (table[k + 1] - table[k])

        return number

    def each(table: Array, place: Any) -> Any:
        out = place
        for lane in range(LANES):
            out = _with_lane(out, lane, between(table, _lane(place, lane)))
        return out

    return each
