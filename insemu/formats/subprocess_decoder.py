"""Native decoders in a process of their own, which stays for the next file: one that crashes or hangs on a corrupt file costs that file only."""

from __future__ import annotations

import importlib
import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.npz import load_npz

#: Longest wait for a decoder, s, and per byte of the file (a slow one reads 2 MB/s).
_PATIENCE, _PER_BYTE = 60.0, 5e-7
#: Most bytes that arrays may have for every byte of their file, and besides: a broken header states more.
_RATIO, _BESIDES = 256, 1 << 27

_workers: dict[int, subprocess.Popen[bytes]] = {}
_one_at_a_time = Lock()


def check_size(wanted: int, path: str) -> None:
    """Raise ``InputError`` where a header states more than a file of this size holds; for decoders to ask before they make room."""
    size = Path(path).stat().st_size
    if wanted > _RATIO * size + _BESIDES:
        raise InputError(f"states {wanted / 1e9:.3g} GB of numbers in a file of {size} bytes", where=path)


def decoded_arrays(module: str, function: str, path: Path) -> dict[str, NDArray[Any]]:
    """What ``function(path)`` of a module gives in a process of its own.

    Parameters
    ----------
    module, function : str
        Of a function of a path (text) that gives a mapping of names to arrays.
    path : path

    Raises
    ------
    InputError
        What the function raised, or that its process died or took too long.
    """
    with _one_at_a_time, tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "arrays.npz"
        job = json.dumps([module, function, str(path.resolve()), str(target)]).encode() + b"\n"
        worker = _worker()
        assert worker.stdin is not None and worker.stdout is not None
        try:
            worker.stdin.write(job)
            worker.stdin.flush()
            ready = select.select([worker.stdout], [], [], _PATIENCE + _PER_BYTE * path.stat().st_size)[0]
            answer = worker.stdout.readline() if ready else b""
        except OSError:
            ready, answer = [worker.stdout], b""
        if not answer:
            _stop()
            raise InputError("the decoder crashed" if ready else "the decoder does not come to an end", where=str(path))
        said: dict[str, str] = json.loads(answer)
        if "error" in said:
            raise InputError(said["error"], where=str(path))
        return {name.removeprefix("v_"): values for name, values in load_npz(target).items()}


def _worker() -> subprocess.Popen[bytes]:
    """The process of this process (a forked one starts its own)."""
    worker = _workers.get(os.getpid())
    if worker is None or worker.poll() is not None:
        command = [sys.executable, "-c", "from insemu.formats.subprocess_decoder import serve; serve()"]
        worker = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
        )
        _workers.clear()
        _workers[os.getpid()] = worker
    return worker


def _stop() -> None:
    worker = _workers.pop(os.getpid())
    worker.kill()
    worker.wait()


def serve() -> None:
    """Decode what is asked on standard input until it ends; the work of the process that :func:`decoded_arrays` starts."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints is no answer
    for line in sys.stdin:
        module, function, path, target = json.loads(line)
        said: Mapping[str, str] = {}
        try:
            found = getattr(importlib.import_module(module), function)(path)
            np.savez(target, **{f"v_{name}": values for name, values in found.items()})
        except InputError as error:
            said = {"error": error.message}
        except (Exception, MemoryError) as error:
            said = {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"}
        with suppress(BrokenPipeError):
            answers.write(json.dumps(said) + "\n")
            answers.flush()
