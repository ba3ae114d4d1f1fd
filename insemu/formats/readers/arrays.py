"""Named arrays: MATLAB ``.mat`` (v5 and v7.3), HDF5, foreign ``.npz``, Parquet. Structures become dotted names, (n, 3) arrays three columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import ColumnMap, guess_map
from insemu.formats.npz import load_npz
from insemu.formats.subprocess_decoder import check_size, decoded_arrays
from insemu.formats.table import Reader, Table, register

_HDF5 = b"\x89HDF\r\n\x1a\n"
#: Structures inside structures that are followed, and columns that a matrix may have.
_DEEPEST, _WIDEST = 6, 64
_RATES = ("fs", "rate", "samplerate", "sample_rate", "freq", "frequency")
_STEPS = ("dt", "ts", "deltat", "period")


def _flat(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, NDArray[Any]]]:
    """Numbers inside nested structures, by dotted name."""
    if depth > _DEEPEST:
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not str(key).startswith("__"):
                yield from _flat(f"{name}.{key}" if name else str(key), inner, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        for key in value.dtype.names:
            inner = value[key]
            inner = inner.item() if inner.dtype == object and inner.size == 1 else inner
            yield from _flat(f"{name}.{key}" if name else key, inner, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        yield name, value
    elif isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        yield from _flat(name, value.item(), depth + 1)
    elif isinstance(value, int | float | np.number):
        yield name, np.asarray(value)


def tables_of(arrays: Mapping[str, NDArray[Any]], source: str) -> list[Table]:
    """Arrays of one length make a table; a scalar rate or step makes the stamps where there are none."""
    scalars = {n.rpartition(".")[2].lower(): float(a.reshape(-1)[0]) for n, a in arrays.items() if a.size == 1}
    groups: dict[int, dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        block = np.squeeze(array)
        if block.ndim not in (1, 2) or block.size < 2:
            continue
        if block.ndim == 2 and block.shape[0] < block.shape[1] and block.shape[0] <= 16:
            block = block.T  # written row by row
        if block.ndim == 2 and block.shape[1] > _WIDEST:
            continue
        group = groups.setdefault(block.shape[0], {})
        if block.ndim == 1:
            group[name] = block
            continue
        ends = "xyz" if block.shape[1] == 3 else [str(k + 1) for k in range(block.shape[1])]
        for k, end in enumerate(ends):
            group[f"{name}_{end}"] = block[:, k]
    tables = []
    for columns in sorted(groups.values(), key=len, reverse=True):
        guess = _by_place(columns, guess_map(list(columns), list(columns.values())))
        if "time" not in guess.picks and "rate" not in guess.settings:
            guess = _with_rate(guess, scalars)
        tables.append(Table(source, columns, {}, guess))
    return tables


def _by_place(columns: Mapping[str, NDArray[Any]], guess: ColumnMap) -> ColumnMap:
    """Latitude, longitude and height of an (n, 3) array that is called so."""
    from insemu.formats.columns import Pick

    if "lat" in guess.picks:
        return guess
    for name in columns:
        stem, _, axis = name.rpartition("_")
        if axis == "x" and stem.rpartition(".")[2].lower() in (
            "llh",
            "lla",
            "gnss_llh",
            "pos_lla",
            "position_llh",
            "geodetic",
        ):
            places = {r: (Pick(f"{stem}_{a}"),) for r, a in (("lat", "x"), ("lon", "y"), ("height", "z"))}
            return ColumnMap({**guess.picks, **places}, guess.settings)
    return guess


def _with_rate(guess: ColumnMap, scalars: Mapping[str, float]) -> ColumnMap:
    rate = next((scalars[k] for k in _RATES if k in scalars), None)
    step = next((scalars[k] for k in _STEPS if k in scalars), None)
    rate = rate if rate is not None else (1.0 / step if step else None)
    if rate is None or not 0.01 <= rate <= 1e5:
        return guess
    return ColumnMap(guess.picks, {**guess.settings, "rate": f"{rate!r} Hz"})


def _checked(arrays: Mapping[str, NDArray[Any]], path: Path) -> list[Table]:
    tables = tables_of(arrays, path.name)
    if not tables:
        have = ", ".join(sorted(arrays)[:12])
        raise InputError(f"holds no arrays of numbers over time; it has {have or 'nothing'}", where=str(path))
    return tables


def mat_arrays(path: str) -> dict[str, NDArray[Any]]:
    """The numbers of a MATLAB v5 file."""
    from scipy.io import loadmat, whosmat

    widest = 16  # bytes of a complex number
    check_size(sum(widest * int(np.prod(shape, dtype=float)) for _, shape, _ in whosmat(path)), path)
    content = loadmat(path, squeeze_me=True, struct_as_record=True)
    return dict(_flat("", {k: v for k, v in content.items() if not k.startswith("__")}))


def hdf5_arrays(path: str) -> dict[str, NDArray[Any]]:
    """The numbers of an HDF5 file, and of MATLAB v7.3."""
    import h5py

    arrays: dict[str, NDArray[Any]] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, node: Any) -> None:
            if (
                isinstance(node, h5py.Dataset)
                and node.dtype.kind in "fiub"
                and node.ndim <= 2
                and not name.startswith("#")
            ):
                check_size(node.nbytes + sum(a.nbytes for a in arrays.values()), path)
                arrays[name.replace("/", ".")] = np.asarray(node[()])

        file.visititems(visit)
    return arrays


def parquet_arrays(path: str) -> dict[str, NDArray[Any]]:
    """The numbers of a Parquet file, column by column."""
    import pandas as pd

    frame = pd.read_parquet(path)
    return {str(n): frame[n].to_numpy() for n in frame.columns if frame[n].dtype.kind in "fiub"}


def _apart(function: str) -> Callable[[Path, Mapping[str, str]], list[Table]]:
    """A reader whose decoder is native code: SciPy's of MATLAB v5 crashes the interpreter on some corrupt files."""
    return lambda path, settings: _checked(decoded_arrays(__name__, function, path), path)


def _read_npz(path: Path, settings: Mapping[str, str]) -> list[Table]:
    return _checked({k: v for k, v in load_npz(path).items() if v.dtype.kind in "fiub"}, path)


register(
    Reader(
        "MATLAB v7.3 (.mat) or HDF5 (.h5)",
        lambda p: _HDF5 in (p.head[:8], p.head[512:520]),
        _apart("hdf5_arrays"),
        rank=1,
    )
)
register(Reader("MATLAB v5 (.mat)", lambda p: p.suffix == ".mat", _apart("mat_arrays"), rank=2))
register(Reader("NumPy archive (.npz)", lambda p: p.suffix == ".npz", _read_npz, rank=6))
register(Reader("Parquet (.parquet)", lambda p: p.head.startswith(b"PAR1"), _apart("parquet_arrays"), rank=1))
