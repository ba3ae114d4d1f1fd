from collections.abc import Callable
from typing import Any, TypeVar

_T = TypeVar("_T")

def intrinsic(function: Callable[..., Any]) -> Callable[..., Any]: ...
def register_model(kind: type) -> Callable[[_T], _T]: ...

class models:
    class PrimitiveModel:
        def __init__(self, manager: Any, kind: Any, vector: Any) -> None: ...
