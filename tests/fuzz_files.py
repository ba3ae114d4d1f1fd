"""Fuzzing of every reader: mutated samples must give an InputError or records that hold together, quickly.

``python -m tests.fuzz_files --count 20000 --kind "ROS 1 bag"`` runs as many as are wanted; a small number runs in the tests. A failure prints
the kind, the seed and the number of the input, which make it again.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from insemu.errors import InputError
from insemu.formats import layout_of, open_files, read_log, read_recording
from insemu.intake import examine
from insemu.records import Recording
from tests.file_samples import KINDS, Written

#: Longest that one input may take, s of processor time.
SLOWEST = 2.0
_WORDS = (
    "nan",
    "inf",
    "-inf",
    "abc",
    "1e999",
    "",
    "-",
    "999999999999999999999999",
    "0",
    "-1",
    "\u00b0",
    '"',
    "1,2",
    "1e-320",
    "#",
    "%",
)


def mutated_text(text: str, rng: np.random.Generator) -> str:
    """Text with tokens, lines or characters changed."""
    lines = text.split("\n")
    for _ in range(int(rng.integers(1, 5))):
        if not lines:
            break
        k = int(rng.integers(0, min(len(lines), 40))) if rng.random() < 0.7 else int(rng.integers(0, len(lines)))
        way = int(rng.integers(0, 7))
        if way == 0:
            del lines[k]
        elif way == 1:
            lines.insert(k, lines[int(rng.integers(0, len(lines)))])
        elif way == 2:
            lines = lines[: k + 1]
        elif way == 3:
            lines[k] = lines[k][: int(rng.integers(0, len(lines[k]) + 1))]
        else:
            separator = next((d for d in (",", ";", "\t", " ") if d in lines[k]), ",")
            cells = lines[k].split(separator)
            at = int(rng.integers(0, len(cells)))
            if way == 4:
                cells[at] = _WORDS[int(rng.integers(0, len(_WORDS)))]
            elif way == 5:
                cells.insert(at, _WORDS[int(rng.integers(0, len(_WORDS)))])
            else:
                del cells[at]
            lines[k] = separator.join(cells)
    return "\n".join(lines)


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with a few changed, cut, doubled or zeroed; the beginning, where headers are, more often."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        if not out:
            break
        near = min(len(out), 400) if rng.random() < 0.6 else len(out)
        k, n = int(rng.integers(0, near)), int(rng.integers(1, 64))
        way = int(rng.integers(0, 6))
        if way == 0:
            out[k] = int(rng.integers(0, 256))
        elif way == 1:
            out[k] ^= 1 << int(rng.integers(0, 8))
        elif way == 2:
            del out[k : k + n]
        elif way == 3:
            out[k:k] = out[k : k + n]
        elif way == 4:
            out[k : k + n] = bytes(min(n, len(out) - k))
        else:
            del out[max(1, int(rng.integers(0, len(out)))) :]
    return bytes(out)


def mutate(path: Path, rng: np.random.Generator) -> None:
    """Change one file of a sample in place."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    victim = files[int(rng.integers(0, len(files)))]
    data = victim.read_bytes()
    if b"\0" in data[:4096] or rng.random() < 0.3:
        victim.write_bytes(mutated_bytes(data, rng))
    else:
        victim.write_text(mutated_text(data.decode("utf-8", "replace"), rng), encoding="utf-8")


def use(written: Written) -> None:
    """Read a sample by the doors that commands take, and make its card; raises only InputError where all is well."""
    options = dict(written.options)
    if options.keys() & {"map", "gnss", "truth"} or layout_of(written.path) == "foreign":
        found = open_files(
            written.path, gnss=options.get("gnss"), truth=options.get("truth"), maps=(options.get("map", ""), "", "")
        )
        examine(found)
        records = [r for r in (found.imu, found.gnss, found.reference) if r is not None]
    elif layout_of(written.path) == "recording":
        recording = read_recording(written.path)
        examine(recording)
        records = [recording.imu]
        assert isinstance(recording, Recording)
    else:
        log = read_log(written.path, rate_hz=options.get("rate_hz"))
        examine(log)
        records = []
    for record in records:
        assert np.isfinite(record.t).all() and (np.diff(record.t) > 0).all()


def fuzz(kind: str, count: int, seed: int) -> list[str]:
    """Mutate a kind of file so many times; what went wrong, in words."""
    wrong = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "sample"
        folder.mkdir()
        written = KINDS[kind](folder)
        for k in range(count):
            copy = Path(name) / "copy"
            shutil.copytree(folder, copy)
            moved = tuple(
                (key, copy / v.relative_to(folder)) if isinstance(v, Path) else (key, v) for key, v in written.options
            )
            began = time.process_time()
            at = replace(written, path=copy / written.path.relative_to(folder), options=moved)
            try:
                mutate(at.path, np.random.default_rng([seed, k]))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    use(at)
            except InputError:
                pass
            except Exception as error:
                wrong.append(f"{kind}, seed {seed}, input {k}: {type(error).__name__}: {str(error)[:200]}")
            if time.process_time() - began > SLOWEST:
                wrong.append(f"{kind}, seed {seed}, input {k}: {time.process_time() - began:.1f} s")
            shutil.rmtree(copy)
    return wrong


def main() -> int:
    """Run from the command line; exit code 1 where anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="inputs of each kind")
    parser.add_argument("--kind", action="append", help="only this kind; may be repeated")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    failed = 0
    for kind in given.kind or KINDS:
        wrong = fuzz(kind, given.count, given.seed)
        failed += len(wrong)
        print(f"{kind}: {given.count} inputs, {len(wrong)} wrong")
        for line in wrong[:20]:
            print("  " + line)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
