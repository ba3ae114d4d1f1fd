"""What insemu uses of numba, which ships no types: a compiled function keeps the signature that it was written with."""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import types as types

_F = TypeVar("_F", bound=Callable[..., Any])

class _Compiled:
    address: int

def cfunc(signature: Any, *, cache: bool = ...) -> Callable[[Callable[..., None]], _Compiled]: ...
def carray(pointer: Any, shape: int | tuple[int, ...]) -> Any: ...
def njit(
    *,
    cache: bool = ...,
    nogil: bool = ...,
    fastmath: bool | set[str] = ...,
    inline: str = ...,
    error_model: str = ...,
    no_cpython_wrapper: bool = ...,
) -> Callable[[_F], _F]: ...
