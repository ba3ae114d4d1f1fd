"""Whole files: a reader sees the old one or the new one, never a part; what could not be written leaves the old one."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Levels below a folder of results in which files are written (``variants/NAME/figures``); a user may choose a folder that holds much else.
DEEPEST = 3


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes the place of ``path`` at the end, or is gone where anything went wrong."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None  # nobody knows the other name
    finally:
        partial.unlink(missing_ok=True)


def clear_partials(folder: Path) -> None:
    """Remove what killed processes left half written in a folder, and at most :data:`DEEPEST` below it, into which nobody else writes."""
    for depth in range(DEEPEST + 1):
        for path in folder.glob("*/" * depth + ".*.partial*"):
            if re.fullmatch(r"\..+\.\d+\.partial(\.\w+)?", path.name):
                path.unlink(missing_ok=True)


def put(path: Path | str, content: str | bytes) -> None:
    """Write a file whole; its folder is made where it does not exist.

    Raises
    ------
    OSError
        Names the file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        partial.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
