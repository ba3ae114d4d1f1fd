"""Eight numbers side by side in compiled code: what one instruction of the processor takes, loaded from and stored to arrays.

A loop over eight numbers of two arrays is not compiled to such instructions: the compiler must allow for arrays that overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

#: Numbers that are taken together.
LANES = 8

__all__ = ["LANES", "add", "div", "load", "mul", "spread", "store", "sub"]

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


class _Lanes(types.Type):
    """The type of such numbers in compiled code."""

    def __init__(self) -> None:
        super().__init__(name=f"lanes{LANES}")


@register_model(_Lanes)
class _Model(models.PrimitiveModel):
    """They are a vector of the processor."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


_LANES = _Lanes()


def _place(
    target: Any, builder: Any, kind: Any, array: Any, at: Any
) -> Any:  # pragma: no cover - runs while numba compiles
    data = target.make_array(kind)(target, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())


def _load(context: Any, array: Any, at: Any) -> Any:  # pragma: no cover - runs while numba compiles
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        return builder.load(_place(target, builder, signature.args[0], args[0], args[1]), align=8)

    return _LANES(array, types.int64), generate


def _store(context: Any, array: Any, at: Any, value: Any) -> Any:  # pragma: no cover - runs while numba compiles
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        builder.store(args[2], _place(target, builder, signature.args[0], args[0], args[1]), align=8)
        return target.get_dummy_value()

    return types.void(array, types.int64, _LANES), generate


def _spread(context: Any, number: Any) -> Any:  # pragma: no cover - runs while numba compiles
    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        nothing, first = ir.Constant(_VECTOR, ir.Undefined), ir.IntType(32)
        one = builder.insert_element(nothing, args[0], ir.Constant(first, 0))
        return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(first, LANES), [0] * LANES))

    return _LANES(types.float64), generate


def _arithmetic(operation: str) -> Callable[..., Any]:
    def typed(context: Any, a: Any, b: Any) -> Any:  # pragma: no cover - runs while numba compiles
        def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
            return getattr(builder, operation)(*args, flags=("contract", "reassoc"))

        return _LANES(_LANES, _LANES), generate

    return intrinsic(typed)


#: ``load(array, at)``: the numbers of a contiguous array from a place in it, counted over all its dimensions; nothing looks whether it is inside.
load: Callable[..., Any] = intrinsic(_load)
#: ``store(array, at, value)``: written there.
store: Callable[..., None] = intrinsic(_store)
#: ``spread(number)``: eight times the same.
spread: Callable[..., Any] = intrinsic(_spread)
#: Number by number.
add, sub, mul, div = (_arithmetic(name) for name in ("fadd", "fsub", "fmul", "fdiv"))
