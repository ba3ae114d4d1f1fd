from typing import Any

Flags: Any

def compile_extra(*given: Any, **named: Any) -> Any: ...
