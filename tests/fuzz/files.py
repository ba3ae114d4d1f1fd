"""Every reader under mutated samples: bytes, tokens, lines, columns, arrays inside archives, checksums put right again."""

from __future__ import annotations

import gzip
import io
import random
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from insemu.formats import layout_of, open_files, read_log, read_recording
from insemu.intake import examine
from tests import file_samples
from tests.file_samples import KINDS, Written

#: Length of the samples, s: short ones are as broken and faster.
SECONDS = 8.0
_WORDS = (
    "nan", "inf", "-inf", "abc", "1e999", "", "-", "999999999999999999999999", "0", "-1", "\u00b0", '"', "1,2", "1e-320", "#", "%", "0x1", "1e308",
    "-0", "NULL", "2013-13-45", "((((", "\x00", "\ufeff", "1_0", "\u0663", "-9223372036854775808", "1.5.2", "deg", "[ns]",
)  # fmt: skip


def text_mutated(text: str, rng: random.Random) -> str:
    """Text with tokens, lines, columns or characters changed."""
    lines = text.split("\n")
    for _ in range(rng.randint(1, 4)):
        if not lines:
            break
        k = rng.randrange(min(len(lines), 40) if rng.random() < 0.7 else len(lines))
        way = rng.randrange(9)
        separator = next((d for d in (",", ";", "\t", " ") if d in lines[k]), ",")
        if way == 0:
            del lines[k]
        elif way == 1:
            lines.insert(k, rng.choice(lines))
        elif way == 2:
            lines = lines[: k + 1]
        elif way == 3:
            lines[k] = lines[k][: rng.randint(0, len(lines[k]))]
        elif way == 4:
            rng.shuffle(lines) if rng.random() < 0.3 else lines.reverse()
        elif way == 5:  # one column of the whole table
            lines = _column(lines, separator, rng)
        else:
            cells = lines[k].split(separator)
            at = rng.randrange(len(cells))
            if way == 6:
                cells[at] = rng.choice(_WORDS)
            elif way == 7:
                cells.insert(at, rng.choice(_WORDS))
            else:
                del cells[at]
            lines[k] = separator.join(cells)
    return "\n".join(lines)


def _column(lines: list[str], separator: str, rng: random.Random) -> list[str]:
    rows = [line.split(separator) for line in lines]
    at, word, way = rng.randrange(max(map(len, rows))), rng.choice(_WORDS), rng.randrange(4)
    first = rng.randrange(3)
    previous = word
    for row in rows[first:]:
        if at >= len(row):
            continue
        if way == 0:
            row[at] = word
        elif way == 1:
            del row[at]
        elif way == 2:  # a step back, or late by one
            row[at], previous = previous, row[at]
        else:
            row[at] += word
    return [separator.join(row) for row in rows]


def bytes_mutated(data: bytes, rng: random.Random) -> bytes:
    """Bytes with a few changed, cut, doubled, zeroed or set to a number at a border; the beginning, where headers are, more often."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 5)):
        if not out:
            break
        k = rng.randrange(min(len(out), 400) if rng.random() < 0.6 else len(out))
        n, way = rng.randint(1, 63), rng.randrange(7)
        if way == 0:
            out[k] = rng.randrange(256)
        elif way == 1:
            out[k] ^= 1 << rng.randrange(8)
        elif way == 2:
            del out[k : k + n]
        elif way == 3:
            out[k:k] = out[k : k + n]
        elif way == 4:
            out[k : k + n] = bytes(min(n, len(out) - k))
        elif way == 5:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice((0, 1, (1 << 8 * size) - 1, 1 << 8 * size - 1, (1 << 8 * size - 1) - 1))
            out[k : k + size] = value.to_bytes(size, rng.choice(("little", "big")))
        else:
            del out[max(1, rng.randrange(len(out))) :]
    return bytes(out)


def _array_mutated(a: Any, rng: random.Random) -> Any:
    """An array of another shape or type, or with other numbers in it."""
    way = rng.randrange(8)
    with np.errstate(all="ignore"):
        if way == 0:
            return a.reshape(-1)
        if way == 1:
            return a[: rng.randint(0, len(a))] if a.ndim else np.zeros(0)
        if way == 2:
            return a.T
        if way == 3:
            return (
                a.astype("S3")
                if a.dtype.kind not in "fiub"
                else a.astype(rng.choice(("i2", "u1", "f4", "U3", "c8", "?", "S2")))
            )
        if way == 4 or not a.size or a.dtype.kind != "f":
            return np.asarray(rng.choice((np.nan, 0, -1, 1e300, "text", [])))
        out = np.array(a)
        flat = out.reshape(-1)
        if way == 5:
            flat[rng.randrange(flat.size)] = rng.choice((np.nan, np.inf, -np.inf, 0.0, 1e308, 5e-324))
        elif way == 6:
            flat[:] = rng.choice((np.nan, 0.0, 1e308, -1.0))
        else:
            flat *= rng.choice((-1.0, 1e9, 1e-9, 57.3, 1e200))
        return out


def _npz_mutated(data: bytes, rng: random.Random) -> bytes:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    key = rng.choice(sorted(arrays))
    if rng.random() < 0.2:
        arrays[rng.choice(["data", "imu", "imu_t", "fs", "x"])] = arrays.pop(key)
    else:
        arrays[key] = _array_mutated(arrays[key], rng)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _hdf5_mutated(data: bytes, rng: random.Random) -> bytes:
    import h5py

    held = io.BytesIO(data)
    with h5py.File(held, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, node: names.append(name) if isinstance(node, h5py.Dataset) else None)
        name = rng.choice(names)
        changed = _array_mutated(file[name][()], rng)
        del file[name]
        if changed.dtype.kind != "U":
            file[name] = changed
    return held.getvalue()


def _zip_mutated(data: bytes, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(parts))
    parts[name] = any_mutated(parts[name], name, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for key, value in parts.items():
            archive.writestr(key, value)
    return out.getvalue()


def _nmea_mutated(data: bytes, rng: random.Random) -> bytes:
    """Sentences whose checksums are right, so that their fields are looked at."""
    lines = text_mutated(data.decode("ascii", "replace"), rng).split("\n")
    for k, line in enumerate(lines):
        body = line.strip().lstrip("$").split("*")[0]
        if "*" in line and body:
            lines[k] = f"${body}*{reduce(lambda a, c: a ^ c, body.encode('utf-8', 'replace')):02X}\r"
    return "\n".join(lines).encode("utf-8", "replace")


def _ubx_mutated(data: bytes, rng: random.Random) -> bytes:
    """One message with other bytes and a checksum that is right."""
    starts = [k for k in range(len(data) - 8) if data[k : k + 2] == b"\xb5\x62"]
    k = rng.choice(starts)
    size = int.from_bytes(data[k + 4 : k + 6], "little")
    body = bytearray(data[k + 2 : k + 6 + size])
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(body))
        body[at] = rng.choice((0, 255, 127, 128, rng.randrange(256)))
    a = b = 0
    for byte in body:
        a = (a + byte) & 255
        b = (b + a) & 255
    return data[: k + 2] + bytes(body) + bytes((a, b)) + data[k + 8 + size :]


_WITHIN = {".npz": _npz_mutated, ".h5": _hdf5_mutated, ".zip": _zip_mutated, ".ubx": _ubx_mutated}


def any_mutated(data: bytes, name: str, rng: random.Random) -> bytes:
    """Content of a file changed, within its own structure where that is known."""
    suffix = Path(name).suffix
    if rng.random() < 0.5:
        if suffix == ".gz":
            return gzip.compress(any_mutated(gzip.decompress(data), name.removesuffix(".gz"), rng), 1)
        if suffix == ".mat" and b"\x89HDF" in data[:520]:
            return _hdf5_mutated(data, rng)
        if data.startswith(b"$G"):
            return _nmea_mutated(data, rng)
        if suffix in _WITHIN:
            return _WITHIN[suffix](data, rng)
    if b"\0" in data[:4096] or rng.random() < 0.3:
        return bytes_mutated(data, rng)
    return text_mutated(data.decode("utf-8", "replace"), rng).encode("utf-8", "surrogatepass")


def mutate(path: Path, rng: random.Random) -> None:
    """Change one file of a sample in place."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    victim = rng.choice(files)
    if rng.random() < 0.02:
        victim.unlink()
        if rng.random() < 0.5:
            victim.mkdir()
        return
    victim.write_bytes(any_mutated(victim.read_bytes(), victim.name, rng))


def use(written: Written) -> None:
    """Read a sample by the doors that commands take, and make its card; raises only InputError where all is well."""
    options = dict(written.options)
    if options.keys() & {"map", "gnss", "truth"} or layout_of(written.path) == "foreign":
        found = open_files(
            written.path, gnss=options.get("gnss"), truth=options.get("truth"), maps=(options.get("map", ""), "", "")
        )
        examine(found)
        records: list[Any] = [r for r in (found.imu, found.gnss, found.reference) if r is not None]
    elif layout_of(written.path) == "recording":
        recording = read_recording(written.path)
        examine(recording)
        records = [recording.imu]
    else:
        examine(read_log(written.path, rate_hz=options.get("rate_hz")))
        records = []
    for record in records:
        assert np.isfinite(record.t).all() and (np.diff(record.t) > 0).all(), "times that do not rise"


def prepare(kind: str, folder: Path) -> Callable[[random.Random], None]:
    """Write the sample once, and read it once to have everything loaded."""
    sample, copy = folder / "sample", folder / "copy"
    sample.mkdir()
    usual = file_samples.drive
    file_samples.drive = lambda seconds=SECONDS, start=0.0: usual(min(seconds, SECONDS), start)  # type: ignore[assignment]
    try:
        written = KINDS[kind](sample)
    finally:
        file_samples.drive = usual
    moved = tuple((k, copy / v.relative_to(sample)) if isinstance(v, Path) else (k, v) for k, v in written.options)
    at = replace(written, path=copy / written.path.relative_to(sample), options=moved)
    use(written)

    def one(rng: random.Random) -> None:
        if copy.exists():
            shutil.rmtree(copy)
        shutil.copytree(sample, copy)
        mutate(at.path, rng)
        use(at)

    return one
