from collections.abc import Callable
from typing import Any

Dispatcher: Any

class _FunctionCompiler:
    py_func: Callable[..., Any]
    targetdescr: Any
    targetoptions: Any
    locals: Any
    pipeline_class: Any
    def __init__(
        self, py_func: Callable[..., Any], targetdescr: Any, targetoptions: Any, locals: Any, pipeline_class: Any
    ) -> None: ...
    def compile(self, args: Any, return_type: Any) -> Any: ...
    def fold_argument_types(self, args: Any, kws: Any) -> Any: ...
