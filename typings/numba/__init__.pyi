"""What insemu uses of numba, which ships no types: a compiled function keeps the signature that it was written with."""

from collections.abc import Callable
from typing import Any

from numba import types as types

__version__: str

def cfunc(signature: Any, *, cache: bool = ...) -> Callable[[Callable[..., None]], Any]: ...
def carray(pointer: Any, shape: int | tuple[int, ...]) -> Any: ...
def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]: ...
