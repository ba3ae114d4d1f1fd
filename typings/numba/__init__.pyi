"""What insemu uses of numba, which ships no types: a compiled function keeps the signature that it was written with."""

from collections.abc import Callable
from typing import Any, TypeVar

_F = TypeVar("_F", bound=Callable[..., Any])

class _Compiled:
    address: int

def cfunc(signature: Any, *, cache: bool = ...) -> Callable[[Callable[..., None]], _Compiled]: ...
def carray(pointer: Any, shape: int | tuple[int, ...]) -> Any: ...

class types:
    class Type:
        def __init__(self, name: str) -> None: ...
        def __call__(self, *arguments: Any) -> Any: ...

    float64: Any
    int64: Any
    @staticmethod
    def CPointer(kind: Any) -> Any: ...
    @staticmethod
    def void(*arguments: Any) -> Any: ...

def njit(
    *, cache: bool = ..., nogil: bool = ..., fastmath: bool | set[str] = ..., inline: str = ...
) -> Callable[[_F], _F]: ...
