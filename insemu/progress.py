"""What the parts of insemu have to say while they work: the command line prints it, a script hears nothing unless it listens."""

from __future__ import annotations

from collections.abc import Callable

#: Called with each sentence.
listeners: list[Callable[[str], None]] = []
_said: set[str] = set()


def say_once(text: str) -> None:
    """Tell the listeners a sentence that this process has not told before."""
    if listeners and text not in _said:
        _said.add(text)
        for listener in listeners:
            listener(text)
