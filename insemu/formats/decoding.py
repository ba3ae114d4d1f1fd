"""One way to open files: whatever a decoder cannot take becomes an :class:`~insemu.errors.InputError` that names the file."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from insemu.errors import InputError

#: Suffixes of compressed files, and what opens them.
_COMPRESSED: Mapping[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
#: Bytes that are looked at to tell what a file is.
HEAD = 1 << 16
#: What is refused: content that unpacks to more bytes than this, and to more than so many times the bytes of the file.
UNPACKED, RATIO = 1 << 28, 100


@contextmanager
def decoding(path: Path | str, what: str) -> Iterator[None]:
    """Run a decoder; what it raises becomes an input error of this file.

    Parameters
    ----------
    path : path
        Shown in the message.
    what : str
        What the file was taken for, with its article: "a NumPy archive".

    Raises
    ------
    InputError
        Anything that went wrong inside (``zlib.error``, ``EOFError``, ``BadZipFile``, ``TokenError``, ``UnicodeDecodeError``, out of memory
        for a size that a broken header states, ...); an input error without a place gets the file's.
    """
    try:
        yield
    except InputError as error:
        if error.where and str(path) in error.where:
            raise
        raise InputError(error.message, where=f"{path}: {error.where}" if error.where else str(path)) from None
    except FileNotFoundError:
        raise
    except ImportError as error:
        raise InputError(
            f"needs the package '{error.name}' to be read: pip install 'insemu[files]'", where=str(path)
        ) from None
    except (Exception, MemoryError) as error:
        reason = " ".join(str(error).split())[:120].encode("ascii", "backslashreplace").decode()
        said = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        raise InputError(f"cannot be read as {what} ({said})", where=str(path)) from None


def check_unpacked(unpacked: int, packed: int, where: Path | str) -> None:
    """Refuse what unpacks to more than :data:`UNPACKED` bytes and more than :data:`RATIO` times its packed size.

    Parameters
    ----------
    unpacked, packed : int
        Bytes.
    where : path
        Shown in the message.

    Raises
    ------
    InputError
        Such a file.
    """
    if unpacked > max(UNPACKED, RATIO * packed):
        raise InputError(
            f"unpacks to more than {max(UNPACKED, RATIO * packed) >> 20} MiB, more than {RATIO} times its {packed} bytes; "
            "unpack it to read it all the same",
            where=str(where),
        )


class _Unpacked(io.RawIOBase):
    """What a compressed file unpacks to, as far as :func:`check_unpacked` lets it."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file, self._packed = path, file, path.stat().st_size

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        piece = self._file.read(len(buffer))
        buffer[: len(piece)] = piece
        check_unpacked(self._file.tell(), self._packed, self._path)
        return len(piece)

    def seek(self, offset: int, whence: int = 0) -> int:
        at = self._file.seek(offset, whence)
        check_unpacked(at, self._packed, self._path)
        return at

    def close(self) -> None:
        self._file.close()
        super().close()


def open_binary(path: Path) -> IO[bytes]:
    """Open a file, compressed or not, for reading bytes; use it inside :func:`decoding`.

    Reading raises :class:`~insemu.errors.InputError` as soon as a compressed file has unpacked to more than :func:`check_unpacked` allows.
    """
    opener = _COMPRESSED.get(path.suffix.lower())
    return io.BufferedReader(_Unpacked(path, opener(path, "rb")), 1 << 16) if opener else path.open("rb")


def head_of(path: Path) -> bytes:
    """The first bytes of a file (decompressed), as many as :data:`HEAD`; none of a broken one."""
    try:
        with open_binary(path) as file:
            return file.read(HEAD)
    except FileNotFoundError:
        raise
    except Exception:  # whoever reads the whole file says what is wrong with it
        return b""


def encoding_of(head: bytes) -> str | None:
    """Encoding of text that begins like this; None for a binary file."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in head:
        return None
    try:
        head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:  # a character cut in two by the end of the head is none
            return "cp1252" if sum(b < 9 or 13 < b < 32 for b in head) < 0.001 * len(head) + 1 else None
    return "utf-8-sig"


class _Undecoded:
    """A file whose bytes pandas takes as they are: it reads what it knows to be binary through a decoder, and encodes that again."""

    def __init__(self, file: IO[bytes]) -> None:
        self.read, self.readline, self._file = file.read, file.readline, file

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._file)

    def __enter__(self) -> _Undecoded:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def open_for_pandas(path: Path) -> Any:
    """Open text as ``pandas.read_csv`` reads it fastest; use it inside :func:`decoding`."""
    head = head_of(path)
    if encoding_of(head) != "utf-8-sig":
        return open_text(path)
    file = open_binary(path)
    if head.startswith(b"\xef\xbb\xbf"):
        file.read(3)
    return _Undecoded(file)


def open_text(path: Path) -> IO[str]:
    """Open text, compressed or not, in the encoding that it is in; use it inside :func:`decoding`.

    Raises
    ------
    InputError
        A binary file.
    """
    encoding = encoding_of(head_of(path))
    if encoding is None:
        raise InputError("is a binary file, expected text", where=str(path))
    return io.TextIOWrapper(open_binary(path), encoding=encoding, newline=None)
