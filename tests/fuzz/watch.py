"""Runs batches of inputs in a forked process: the kernel ends an input that takes too long, and a crash costs that input only."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import logging
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numba.core import event

from insemu.errors import InputError

#: Most processor time of one input, s; most time on the clock (for children that it waits for), s.
SLOWEST, LONGEST = 2.0, 120
#: Most memory beyond that of the warm process, bytes.
LARGEST = 1 << 30
#: Address space beyond that of the warm process, bytes: a size in a broken header ends in a MemoryError.
_SPACE = 4 << 30
#: Longest message that a person reads.
_LONGEST_MESSAGE = 6000


@dataclass(frozen=True)
class Target:
    """One thing to fuzz.

    Parameters
    ----------
    name : str
    module : str
        Module of this package with ``prepare(what, folder)``, which gives a function of a ``random.Random`` that tries one input; what it
        raises is wrong unless it is an ``InputError``, and an ``AssertionError`` says in words what does not hold.
    what : str
        Passed to ``prepare``.
    share : str
        Group of the count: "scenario", "readers", "models" or "commands".
    """

    name: str
    module: str
    what: str
    share: str


def _targets() -> dict[str, Target]:
    from tests.file_samples import KINDS

    found = [Target("scenario", "scenarios", "", "scenario")]
    found += [Target(f"reader: {kind}", "files", kind, "readers") for kind in KINDS]
    found += [Target(what, "models", what, "models") for what in ("models", "units", "effects", "maps", "cards")]
    found += [Target("command line", "commands", "", "commands")]
    return {target.name: target for target in found}


#: Everything that is fuzzed, by name.
TARGETS: dict[str, Target] = _targets()


@dataclass(frozen=True)
class Batch:
    """Inputs ``first`` to ``first + count`` of a target under a seed."""

    target: str
    seed: int
    first: int
    count: int


@dataclass(frozen=True)
class Outcome:
    """What a batch gave: how many inputs ran, how many were refused in words, and what went wrong (number of the input, in words)."""

    count: int
    refused: int
    wrong: tuple[tuple[int, str], ...]


def run_batch(batch: Batch) -> Outcome:
    """Run a batch in processes of its own; the calling process should have the modules loaded already."""
    target = TARGETS[batch.target]
    prepare = importlib.import_module(f"tests.fuzz.{target.module}").prepare
    wrong: list[tuple[int, str]] = []
    base = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with mmap.mmap(-1, 16) as shared, tempfile.TemporaryDirectory(dir=base) as name:
        at, refused, end = batch.first, 0, batch.first + batch.count
        while at < end:
            folder = Path(name) / str(at)
            folder.mkdir()
            shared[:] = struct.pack("qq", at, 0)
            said = folder / "wrong.jsonl"
            child = os.fork()
            if child == 0:
                _child(prepare, target.what, batch.seed, (at, end), folder, shared)
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            now, more = struct.unpack("qq", shared[:])
            refused += more
            if said.exists():
                wrong += [(int(k), str(text)) for k, text in map(json.loads, said.read_text().splitlines())]
            if status != 0:
                wrong.append((now, _ended(status)))
                now += 1
            at = now
            shutil.rmtree(folder, ignore_errors=True)
    return Outcome(batch.count, refused, tuple(wrong))


def _ended(status: int) -> str:
    if status == -signal.SIGPROF:
        return f"takes more than {SLOWEST:g} s"
    if status == -signal.SIGALRM:
        return f"is not done after {LONGEST} s"
    return f"ends the process (signal {-status})" if status < 0 else f"ends the process (exit code {status})"


class _Compiling(event.Listener):
    """Compiling a kernel, which the first input of an empty cache asks for, is no part of an input's time."""

    depth = 0

    def on_start(self, event: Any) -> None:
        self.depth += 1
        signal.setitimer(signal.ITIMER_PROF, 0)

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            signal.setitimer(signal.ITIMER_PROF, SLOWEST)


def _child(
    prepare: Callable[[str, Path], Callable[[random.Random], None]],
    what: str,
    seed: int,
    span: tuple[int, int],
    folder: Path,
    shared: mmap.mmap,
) -> None:
    """Try inputs until the last one; never returns."""
    code = 1
    try:
        os.chdir(folder)
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(quiet, stream)
        logging.disable(logging.CRITICAL)
        warnings.simplefilter("ignore")
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        space, held = (int(n) * resource.getpagesize() for n in Path("/proc/self/statm").read_text().split()[:2])
        resource.setrlimit(resource.RLIMIT_AS, (space + _SPACE, space + _SPACE))
        one = prepare(what, folder)
        event.register("numba:compile", _Compiling())
        refused = 0
        with (folder / "wrong.jsonl").open("a", encoding="utf-8") as said:
            for k in range(*span):
                shared[:] = struct.pack("qq", k, refused)
                signal.setitimer(signal.ITIMER_PROF, SLOWEST)
                signal.alarm(LONGEST)
                trouble = attempt(one, random.Random(f"{seed}/{k}"))
                signal.setitimer(signal.ITIMER_PROF, 0)
                refused += trouble == ""
                if trouble:
                    said.write(json.dumps([k, trouble]) + "\n")
                    said.flush()
                if (k & 15) == 15 and _most_memory() - held > LARGEST:
                    said.write(
                        json.dumps([k, f"memory above {LARGEST >> 20} MB (this input or one of the 15 before it)"])
                        + "\n"
                    )
                    shared[:] = struct.pack("qq", k + 1, refused)
                    break
            else:
                shared[:] = struct.pack("qq", span[1], refused)
        code = 0
    except BaseException as error:
        (folder / "wrong.jsonl").open("a").write(
            json.dumps([span[0], f"harness: {type(error).__name__}: {error}"]) + "\n"
        )
    finally:
        os._exit(code)


def _most_memory() -> int:
    """Most memory that this process has held since it was forked, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def attempt(one: Callable[[random.Random], None], rng: random.Random) -> str | None:
    """Try one input; what is wrong in words, "" where it was refused as it should be, None where it was taken."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            one(rng)
        except InputError as error:
            try:
                text = str(error).encode().decode()
            except UnicodeError:
                return "a message that cannot be printed"
            if len(text) > _LONGEST_MESSAGE:
                return f"a message of {len(text)} characters: {text[:100]}"
            return ""
        except FileNotFoundError as error:
            return "" if error.filename else f"FileNotFoundError without a name: {error}"
        except Exception as error:
            place = error.__traceback__
            while place is not None and place.tb_next is not None:
                place = place.tb_next
            where = f" at {Path(place.tb_frame.f_code.co_filename).name}:{place.tb_lineno}" if place else ""
            return f"{type(error).__name__}{where}: {str(error)[:200]}"
    return None
