"""Types of numba that insemu names."""

from typing import Any

class Type:
    def __init__(self, name: str) -> None: ...
    def __call__(self, *arguments: Any) -> Any: ...

float64: Any
int64: Any
intp: Any
boolean: Any
Array: Any
BaseFunction: Any
Boolean: Any
Float: Any
Integer: Any

def CPointer(kind: Any) -> Any: ...
def void(*arguments: Any) -> Any: ...
