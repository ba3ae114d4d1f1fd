"""Results of small inputs as they are, so that none changes unnoticed.

Closed forms, other programs and recordings say elsewhere whether results are right, within the tolerances that such comparisons have. Here stand
the results themselves, to six digits: a change of a constant or of a branch that stays within those tolerances is seen as well.
``python -m tests.pins`` writes ``tests/pins/*.yaml`` anew; a changed line there is a change of somebody's results, and the commit says why.

A module ``tests/test_ROOM_pins.py`` has a mapping ``CASES`` of names to functions without arguments.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.special import ndtri

from insemu.errors import InputError

FOLDER = Path(__file__).with_name("pins")
#: Arrays above this size are kept as their size, the mean of their magnitudes, and two weighted sums over that.
WHOLE = 8
#: Largest relative difference that counts as none, and difference relative to the largest of an array.
RELATIVE, OF_LARGEST = 1e-6, 1e-10


def numbers(n: int, seed: int = 1) -> NDArray[np.float64]:
    """Gaussian numbers that no version of a library changes: quantiles of a linear congruential generator."""
    state, out = seed, np.empty(n)
    for k in range(n):
        state = (1103515245 * state + 12345) % 2**31
        out[k] = (state + 0.5) / 2**31
    return np.asarray(ndtri(out))


def refused(call: Callable[[], Any]) -> str:
    """The message with which a call is refused."""
    with pytest.raises(InputError) as caught:
        call()
    return str(caught.value)


def plain(value: Any) -> Any:
    """A result as plain data: fields of dataclasses, numbers, texts, digests of long arrays."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, list | tuple) and not all(isinstance(v, float | int | np.number) for v in value):
        return [plain(part) for part in value]
    array = np.asarray(value)
    if array.dtype.kind in "biu":
        array = array.astype(np.float64)
    if array.dtype.kind == "c":
        return {"real": plain(array.real), "imaginary": plain(array.imag)}
    if array.dtype.kind != "f":
        return str(value)
    flat = array.ravel()
    if flat.size <= WHOLE:
        return [float(f"{v:.10g}") for v in flat]
    known = np.where(np.isfinite(flat), flat, 0.0)
    size = float(np.abs(known).sum())
    turn = np.cos(1.7 * np.arange(flat.size))
    sums = [float(known.sum()), float(known @ turn)]
    return {
        "shape": list(array.shape),
        "unknown": int(np.count_nonzero(~np.isfinite(flat))),
        "mean magnitude": float(f"{size / flat.size:.10g}"),
        "sums": [round(s / size, 9) if size else 0.0 for s in sums],
    }


def differences(found: Any, held: Any, where: str = "") -> list[str]:
    """What differs between a result and what is kept of it, one line each."""
    if isinstance(found, dict) and isinstance(held, dict):
        return [
            line for key in {**found, **held} for line in differences(found.get(key), held.get(key), f"{where}.{key}")
        ]
    if isinstance(found, list) and isinstance(held, list) and len(found) == len(held):
        if all(isinstance(v, float | int) for v in (*found, *held)):
            largest = max((abs(v) for v in held if math.isfinite(v)), default=0.0)
            near = (
                math.isclose(a, b, rel_tol=RELATIVE, abs_tol=OF_LARGEST * largest) or (math.isnan(a) and math.isnan(b))
                for a, b in zip(found, held, strict=True)
            )
            if where.endswith(".sums"):
                near = (abs(a - b) <= RELATIVE for a, b in zip(found, held, strict=True))
            return [] if all(near) else [f"{where}: {found}, kept is {held}"]
        return [
            line
            for k, (a, b) in enumerate(zip(found, held, strict=True))
            for line in differences(a, b, f"{where}[{k}]")
        ]
    if isinstance(found, float) and isinstance(held, float | int):
        return differences([found], [float(held)], where)
    return [] if found == held else [f"{where}: {found!r}, kept is {held!r}"]


def kept(room: str) -> Any:
    """What is kept of a room's results."""
    return yaml.load((FOLDER / f"{room}.yaml").read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def main() -> int:
    """Write what is kept anew."""
    FOLDER.mkdir(exist_ok=True)
    for module in sorted(Path(__file__).parent.glob("test_*_pins.py")):
        cases = getattr(importlib.import_module(f"tests.{module.stem}"), "CASES", None)
        if cases is None:
            continue
        found = {}
        for name, case in cases.items():
            try:
                found[name] = plain(case())
            except Exception as error:
                raise SystemExit(f"{module.name}: {name}: {type(error).__name__}: {error}") from error
        target = FOLDER / f"{module.stem.removeprefix('test_').removesuffix('_pins')}.yaml"
        target.write_text(
            yaml.safe_dump(found, sort_keys=False, width=150, default_flow_style=None, allow_unicode=True),
            encoding="utf-8",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
