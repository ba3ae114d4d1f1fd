"""Whole files: a reader sees the old one or the new one, never a part; what could not be written leaves the old one."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Levels below a folder of results in which files are written (``variants/NAME/figures``); a user may choose a folder that holds much else.
DEEPEST = 3


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A path next to ``path`` to write to; it takes the place of ``path`` at the end, or is gone where anything went wrong.

    The folder of ``path`` is made where it does not exist, and is gone, too, where nothing was written into it.
    """
    path = Path(path)
    if path.is_dir():  # said before the work whose result could not be put there
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    partial = _beside(path, path.suffix)
    made = [] if path.parent.exists() else [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None  # nobody knows the other name
    finally:
        with suppress(OSError):  # a parent that is a file holds nothing
            partial.unlink(missing_ok=True)
        with suppress(OSError):  # one that is not empty stays
            for folder in made:
                folder.rmdir()


@contextmanager
def replacing_folder(folder: Path | str, mark: str, old: Iterable[str] = ()) -> Iterator[Path]:
    """An empty folder next to ``folder`` to write files to; they come into ``folder`` at the end, or are gone where anything went wrong.

    Parameters
    ----------
    folder : path
        Made where it does not exist; other files in it stay.
    mark : str
        The file without which readers do not take the folder for a whole one: it goes first and comes last.
    old : iterable of str
        Patterns of the names that go: what an earlier writer left would be read together with the new files.

    Raises
    ------
    OSError
        Names the folder.
    """
    folder = Path(folder).resolve()  # the current one has a name, too
    partial = _beside(folder)
    try:
        partial.mkdir(parents=True)
        yield partial
        if folder.exists():
            gone = [folder / mark, *(path for pattern in old for path in folder.glob(pattern))]
            for path in gone:
                path.unlink(missing_ok=True)
            for path in sorted(partial.iterdir(), key=lambda p: p.name == mark):
                path.replace(folder / path.name)
        else:
            partial.replace(folder)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _beside(path: Path, suffix: str = "") -> Path:
    """Where what shall become ``path`` is written."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial{suffix}")


def clear_partials(folder: Path) -> None:
    """Remove what killed processes left half written in a folder, and at most :data:`DEEPEST` below it, into which nobody else writes."""
    for depth in range(DEEPEST + 1):
        for path in folder.glob("*/" * depth + ".*.partial*"):
            if re.fullmatch(r"\..+\.\d+\.partial(\.\w+)?", path.name):
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def put(path: Path | str, content: str | bytes) -> None:
    """Write a file whole; its folder is made where it does not exist.

    Raises
    ------
    OSError
        Names the file.
    """
    with replacing(path) as partial:
        partial.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
