"""What is said before something takes long."""

from __future__ import annotations

from collections.abc import Callable

#: Called with a sentence before a process compiles its first kernel; the command line prints it.
on_compiling: list[Callable[[str], None]] = []
_said = False


def compiles(processor: str) -> None:
    """Say, once, that kernels are compiled for a processor."""
    global _said
    if not _said:
        for say in on_compiling:
            _said = True
            say(f"Compiling kernels for {processor}: once, up to a minute (insemu --version says where they are kept)")
