"""Haar wavelet variances of unit processes as compiled functions, so that a search calls any process without knowing its class.

A process of coefficient 1 has a wavelet variance ``b`` (J,) at averages of ``m`` (J,) samples that depends on its shapes ``s`` alone, with
derivatives ``db`` (J, shapes). A process may give that as one compiled function; where it does not, its state block is asked from Python.
A kernel gets addresses: one compiled kernel serves every process that there will ever be.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from insemu.compiled import cfunc, njit

Array = NDArray[np.float64]

_NUMBERS, _INT = types.CPointer(types.float64), types.int64
#: ``m, J, s, shapes, order, b, db``: order is a whole number of the structure, such as the autoregressive order of an ARMA.
SIGNATURE = types.void(_NUMBERS, _INT, _NUMBERS, _INT, _INT, _NUMBERS, _NUMBERS)
_DOUBLES = ctypes.POINTER(ctypes.c_double)
_CALLBACK = ctypes.CFUNCTYPE(
    None, _DOUBLES, ctypes.c_int64, _DOUBLES, ctypes.c_int64, ctypes.c_int64, _DOUBLES, _DOUBLES
)
#: Step of the differences that give derivatives by shapes where no closed form is given.
STEP = 1e-5

__all__ = ["SIGNATURE", "STEP", "call", "callback_of", "compiled", "evaluate"]


def compiled(function: Callable[..., None]) -> Any:
    """Compile a plain function of :data:`SIGNATURE`; its ``address`` is what kernels take."""
    return cfunc(SIGNATURE)(function)


def callback_of(curve: Callable[[Array, Array], Array]) -> tuple[int, object]:
    """Address of a Python function of averages and shapes, and the object that must be kept while the address is used."""

    def fill(m_: Any, count: int, s_: Any, shapes: int, order: int, b_: Any, db_: Any) -> None:
        m = np.ctypeslib.as_array(m_, (count,))
        s = np.ctypeslib.as_array(s_, (shapes,)) if shapes else np.zeros(0)
        b = np.ctypeslib.as_array(b_, (count,))
        b[:] = np.nan  # an exception cannot pass through compiled code; a search leaves such a point
        b[:] = curve(m, s)
        for k in range(shapes):
            step = np.zeros(shapes)
            step[k] = STEP
            np.ctypeslib.as_array(db_, (count, shapes))[:, k] = (curve(m, s + step) - curve(m, s - step)) / (2.0 * STEP)

    callback = _CALLBACK(fill)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return address, callback


def _call(
    context: Any, address: Any, m: Any, s: Any, order: Any, b: Any, db: Any
) -> Any:  # pragma: no cover - runs while numba compiles

    def generate(target: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        double, integer = ir.DoubleType().as_pointer(), ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [double, integer, double, integer, integer, double, double])

        def array(k: int) -> Any:
            return target.make_array(signature.args[k])(target, builder, args[k])

        def size(a: Any) -> Any:
            return builder.extract_value(a.shape, 0)

        m_, s_, b_, db_ = (array(k) for k in (1, 2, 4, 5))
        builder.call(
            builder.inttoptr(args[0], kind.as_pointer()),
            [m_.data, size(m_), s_.data, size(s_), args[3], b_.data, db_.data],
        )
        return target.get_dummy_value()

    return types.void(address, m, s, order, b, db), generate


#: ``call(address, m, s, order, b, db)`` in compiled code: the function at an address, with contiguous arrays.
call: Callable[..., None] = intrinsic(_call)


@njit(cache=True, nogil=True)
def evaluate(address: int, m: Array, s: Array, order: int, b: Array, db: Array) -> None:  # pragma: no cover - compiled
    """Call one function from Python.

    Parameters
    ----------
    address : int
        Of a function of :data:`SIGNATURE`.
    m : (J,) array
        Samples per average.
    s : (shapes,) array
        Shapes of the process.
    order : int
        Whole number of its structure.
    b, db : (J,), (J, shapes) arrays
        Overwritten: wavelet variances of the unit process, and their derivatives by the shapes.
    """
    call(address, m, s, order, b, db)
