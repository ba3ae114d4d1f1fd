from collections.abc import Callable, Mapping
from typing import Any

class CFunc:
    address: int
    _cache: Any
    def __init__(
        self, function: Callable[..., None], signature: Any, *, locals: Mapping[str, Any], options: Mapping[str, Any]
    ) -> None: ...
    def compile(self) -> None: ...
