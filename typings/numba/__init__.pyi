"""What insemu uses of numba, which ships no types: a compiled function keeps the signature that it was written with."""

from collections.abc import Callable
from typing import Any, TypeVar

_F = TypeVar("_F", bound=Callable[..., Any])

def njit(
    *, cache: bool = ..., nogil: bool = ..., fastmath: bool | set[str] = ..., inline: str = ...
) -> Callable[[_F], _F]: ...
