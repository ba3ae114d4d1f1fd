"""NumPy files without pickles: arrays by key, and messages that name the file and the key."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.decoding import check_unpacked, decoding

#: Bytes from which an array is mapped rather than read.
MAPPED = 1 << 28


def load_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return all arrays of an ``.npz``; raises :class:`~insemu.errors.InputError` for pickled or broken files."""
    arrays: dict[str, NDArray[Any]] = {}
    with decoding(path, "a NumPy archive"), path.open("rb") as handle:
        file = np.load(handle, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise InputError("is one NumPy array, expected an archive of several", where=str(path))
        with file:
            unpacked = sum(int(i.file_size) for i in file.zip.infolist()) if file.zip is not None else 0
            check_unpacked(unpacked, path.stat().st_size, path)
            for key in file.files:
                try:
                    mapped = _mapped(path, key)
                    arrays[key] = file[key] if mapped is None else mapped
                except ValueError as error:
                    raise InputError(_reason(error), where=f"{path}: {key}") from None
    return arrays


def _mapped(path: Path, key: str) -> NDArray[Any] | None:
    """A large array that is stored without compression, mapped where it lies in the file; None for any other."""
    with zipfile.ZipFile(path) as archive:
        if f"{key}.npy" not in archive.namelist():
            return None
        member = archive.getinfo(f"{key}.npy")
    if member.compress_type != zipfile.ZIP_STORED or member.file_size < MAPPED:
        return None
    with path.open("rb") as handle:
        handle.seek(member.header_offset + 26)
        name, extra = np.frombuffer(handle.read(4), dtype="<u2").tolist()
        handle.seek(name + extra, 1)
        version = np.lib.format.read_magic(handle)
        if version not in ((1, 0), (2, 0)):
            return None
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(handle)
        if dtype.hasobject:
            return None
        return np.memmap(path, dtype, "r", handle.tell(), shape, "F" if fortran else "C")


def keys_of(path: Path) -> frozenset[str]:
    """Return the names of the arrays in an ``.npz`` without reading them; raises :class:`~insemu.errors.InputError` for a broken file."""
    with decoding(path, "a NumPy archive"), path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
        return frozenset(file.files)


def load_npy(path: Path, *, map_file: bool = False) -> NDArray[Any]:
    """Return the array of an ``.npy`` (memory-mapped on request)."""
    with decoding(path, "a NumPy array"):
        try:
            if map_file:
                mapped: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
                return mapped
            return np.asarray(np.load(path, allow_pickle=False))
        except ValueError as error:
            raise InputError(_reason(error), where=str(path)) from None


def _reason(error: ValueError) -> str:
    if "pickle" in str(error) or "Object arrays" in str(error):
        return "holds pickled Python objects, which are never loaded; expected plain arrays of numbers or text"
    return f"cannot be read ({error})"


def numbers(array: NDArray[Any], where: str) -> NDArray[np.float64]:
    """Return an array as float64; raises :class:`~insemu.errors.InputError` where it is not of real numbers."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"has type {array.dtype}, expected real numbers", where=where)
    return np.asarray(array, dtype=np.float64)


def texts(array: NDArray[Any], where: str) -> list[str]:
    """Return a one-dimensional (or scalar) array of text as a list."""
    if array.dtype.kind not in "US" or array.ndim > 1:
        raise InputError(f"has type {array.dtype} and shape {array.shape}, expected a list of text", where=where)
    if not array.size:
        raise InputError("is empty, expected text", where=where)
    return [v.decode() if isinstance(v, bytes) else str(v) for v in np.atleast_1d(array).tolist()]


def scalar(array: NDArray[Any], where: str) -> float:
    """Return a single number."""
    values = numbers(array, where)
    if values.size != 1:
        raise InputError(f"has shape {values.shape}, expected one number", where=where)
    return float(values.reshape(()))
