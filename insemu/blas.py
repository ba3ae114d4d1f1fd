"""BLAS on one thread: work items run side by side here, and matrices are small.

A second BLAS thread that waits by spinning takes a core from the next item and can make an optimiser's step of microseconds last milliseconds.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")

#: What the libraries read when they are loaded.
_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def one_thread_by_default() -> None:
    """Make the libraries that this process and its children load from now on start with one thread, unless the user has said otherwise."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")


def on_one_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let a function run with one BLAS thread, whatever its caller uses."""

    @wraps(function)
    def limited(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
