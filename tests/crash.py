"""Crash tests: commands that are killed or meet a fault, and then run again, must leave the same bytes (but times) as an undisturbed run.

``python -m tests.crash --kills 200 --faults 40`` runs kills and faults in turns over five commands and prints a table; a few run in
``tests/test_crash.py``. Half of the kills (signal 9) come at a moment drawn from the length of the command, half at one of its calls that open a
file for writing, rename or remove one. Every process is forked from this one, which has everything loaded.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trial.__main__ import app as trial
from insemu import cli, scenario
from insemu.evaluate.folder import MARKER, TIMING
from insemu.formats import write
from insemu.records import Series
from insemu.work import Lines, run_items
from tests.fuzz.commands import SCENARIO

#: Commands by name: what is run beside ``s.yaml`` and ``log.npz``, and what it leaves.
COMMANDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "run": ("run s.yaml --output out --workers 1", ("out",)),
    "compare --analytic": ("compare s.yaml --analytic --output out", ("out",)),
    "regress record": ("regress record s.yaml --baseline base.json --workers 1", ("base.json",)),
    "trial": ("trial --recordings 3 --kind static --log-length 12min --no-hold-out --output log.jsonl", ("log.jsonl",)),
    "select": ("select log.npz -g GM()+WN() -o models.yaml --page page.html --workers 1", ("models.yaml", "page.html")),
}
#: Text that says when and how long, in files of any kind.
_TIMES = re.compile(
    rb'"(?:timing|elapsed|started|finished|written|seconds|since|date)\w*": ?(?:\{[^}]*\}|"[^"]*"|[-0-9.e+]+|null)'
)


@dataclass(frozen=True)
class Trial:
    """One disturbance: the command, what is done to it, and a number that all its draws come from."""

    command: str
    kind: str
    number: int


def prepare(folder: Path, seed: int = 1) -> None:
    """The inputs of the commands."""
    (folder / "s.yaml").write_text(SCENARIO.replace("seed: 1", f"seed: {seed}"), encoding="utf-8")
    values = np.random.default_rng(seed).standard_normal((4000, 2)) * 1e-3
    write(folder / "log.npz", [Series(values[:, k], 100.0, "rad/s", f"gyro_{'xy'[k]}") for k in range(2)])


def start(folder: Path, line: str, before: Callable[[], None] = lambda: None) -> int:
    """Fork a process that runs a command in a folder, and return its id."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code: Any = 70
    try:
        os.chdir(folder)
        said = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            before()
            try:
                command, *options = line.split()
                cli.main(options, trial) if command == "trial" else cli.main([command, *options])
                code = 0
            except SystemExit as ended:
                code = ended.code or 0
            except BaseException as error:
                said.write(f"Traceback: {type(error).__name__}: {error}")
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        with contextlib.suppress(OSError):  # on a full disk
            (folder / "said.txt").write_text(said.getvalue(), encoding="utf-8")
    finally:
        os._exit(code if isinstance(code, int) else 1)


def ended(child: int) -> int:
    """Wait for a process; its exit code, or minus the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def run(folder: Path, line: str, before: Callable[[], None] = lambda: None) -> int:
    """Run a command to its end."""
    return ended(start(folder, line, before))


def content(folder: Path, outputs: tuple[str, ...]) -> dict[str, str]:
    """Every file of the outputs as a hash of what it holds but times; caches apart."""
    found: dict[str, str] = {}
    for name in outputs:
        root = folder / name
        for path in sorted(root.rglob("*")) if root.is_dir() else [root]:
            relative = path.relative_to(folder)
            if path.is_file() and "cache" not in relative.parts and path.name != TIMING:
                found[str(relative)] = hashlib.sha256(_but_times(path)).hexdigest()
    return found


def _but_times(path: Path) -> bytes:
    return _TIMES.sub(b"", path.read_bytes())


def half_taken_for_whole(folder: Path, outputs: tuple[str, ...]) -> str:
    """What looks finished and is not, after a disturbance; empty where nothing does."""
    for name in outputs:
        path = folder / name
        if path.is_dir() and (path / MARKER).exists():
            for file, digest in json.loads((path / MARKER).read_text())["files"].items():
                if not (path / file).exists() or hashlib.sha256((path / file).read_bytes()).hexdigest() != digest:
                    return f"{MARKER} stands beside another {file}"
        elif path.suffix == ".json" and path.is_file():
            try:
                json.loads(path.read_text())
            except ValueError:
                return f"{name} is cut off"
        elif path.suffix in (".yaml", ".html") and path.is_file():
            end = path.read_bytes()[-300:]
            if not end.endswith(b"\n") and b"</html>" not in end:
                return f"{name} is cut off"
    return ""


# ------------------------------------------------------------------------------------------------------- disturbances


def _killed_at_call(k: int) -> Callable[[], None]:
    """The process kills itself at its k-th call that changes a file."""
    left = k

    def hook(event: str, args: tuple[Any, ...]) -> None:
        nonlocal left
        writes = event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if writes or event in ("os.rename", "os.remove", "os.mkdir", "os.truncate", "os.rmdir"):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    return lambda: sys.addaudithook(hook)


@contextlib.contextmanager
def _mounted(folder: Path, options: str) -> Iterator[None]:
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def kill(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """Kill the command, at a moment or at a call."""
    if rng.random() < 0.5:
        run(folder, line, _killed_at_call(rng.randint(1, 40)))
        return ""
    child = start(folder, line)
    time.sleep(rng.uniform(0.0, seconds))
    os.kill(child, signal.SIGKILL)
    ended(child)
    return ""


def full_disk(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """No file may grow beyond a few kilobytes."""

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        most = rng.choice((1, 300, 3000, 20_000))
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

    code = run(folder, line, limited)
    return _told(folder, code, may_succeed=True)


def small_disk(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """A disk that is full after some kilobytes; what it held is there when there is room again."""
    page = resource.getpagesize()
    inputs = sum(math.ceil(p.stat().st_size / page) * page for p in folder.iterdir() if p.is_file())
    room = inputs + 1024 * rng.choice((4, 16, 64, 200))
    with tempfile.TemporaryDirectory() as name, _mounted(Path(name), f"size={room}"):
        for source in folder.iterdir():
            if source.is_file():
                shutil.copy2(source, name)
        code = run(Path(name), line)
        said = _told(Path(name), code, may_succeed=True)
        for kept in Path(name).iterdir():
            (shutil.copytree if kept.is_dir() else shutil.copy2)(
                kept, folder / kept.name, **({"dirs_exist_ok": True} if kept.is_dir() else {})
            )
    return said


def read_only(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """The place of the results cannot be written."""
    blocked = folder / outputs[0]
    if outputs == ("out",):
        with _mounted(blocked, "ro"):
            return _told(folder, run(folder, line))
    blocked.mkdir()
    said = _told(folder, run(folder, line))
    blocked.rmdir()
    return said


def two_at_once(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """The same command twice, the second a little later."""
    first = start(folder, line)
    time.sleep(rng.uniform(0.0, 0.5 * seconds))
    second = start(folder, line)
    codes = sorted((ended(first), ended(second)))
    return (
        ""
        if codes[0] == 0 and codes[1] in (0, 2)
        else f"exit codes {codes}: {(folder / 'said.txt').read_text()[-200:]}"
    )


def clock(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """The clock jumps back and forth by years while the command runs, and it is killed."""
    usual = time.time

    def jumping() -> None:
        time.time = lambda: usual() + rng.choice((-1e9, 0.0, 1e9))
        _killed_at_call(rng.randint(2, 30))()

    run(folder, line, jumping)
    for path in folder.rglob("*"):
        at = usual() + rng.choice((-1e9, 1e9))
        os.utime(path, (at, at))
    return ""


def damaged(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """Everything that was kept is cut off or has bytes that are flipped."""
    run(folder, line)
    kept = [
        p
        for name in outputs
        for p in ((folder / name).rglob("*") if (folder / name).is_dir() else [folder / name])
        if p.is_file()
    ]
    for path in rng.sample(kept, min(len(kept), rng.randint(1, 6))):
        data = bytearray(path.read_bytes())
        if rng.random() < 0.5:
            del data[rng.randrange(len(data) + 1) :]
        elif data:
            data[rng.randrange(len(data))] ^= 0xFF
        path.write_bytes(data)
    if line.startswith("trial "):  # a log that was changed by hand is refused; what it says is not made up
        code = run(folder, line)
        said = _told(folder, code, may_succeed=True)
        if code == 2:
            (folder / outputs[0]).unlink()
        return said
    return ""


def changed_input(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """The inputs were others when the command ran before."""
    prepare(folder, seed=99)
    run(folder, line, _killed_at_call(rng.randint(10, 60)))
    prepare(folder)
    return _told(folder, run(folder, line), may_succeed=True) if not line.startswith("trial ") else ""


def changed_version(folder: Path, line: str, outputs: tuple[str, ...], rng: random.Random, seconds: float) -> str:
    """Another version of the code ran before."""
    run(folder, line, _other_code)
    return ""


def _other_code() -> None:
    scenario.files.code_version = lambda: "another version"  # type: ignore[assignment]


def _told(folder: Path, code: int, *, may_succeed: bool = False) -> str:
    text = (folder / "said.txt").read_text(encoding="utf-8", errors="replace") if (folder / "said.txt").exists() else ""
    if "Traceback" in text:
        return text[-300:]
    return "" if code in ((0, 1, 2) if may_succeed else (1, 2)) else f"exit code {code}"


FAULTS = (full_disk, small_disk, read_only, two_at_once, clock, damaged, changed_input, changed_version)


def disturb(trial: Trial, whole: Mapping[str, str], seconds: float) -> str:
    """Disturb a command, run it again undisturbed, and say what is wrong; empty where the result is that of an undisturbed run."""
    line, outputs = COMMANDS[trial.command]
    rng = random.Random(f"{trial}")
    fault = kill if trial.kind == "kill" else next(f for f in FAULTS if f.__name__ == trial.kind)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        said = fault(folder, line, outputs, rng, seconds)
        half = (
            half_taken_for_whole(folder, outputs) if trial.kind in ("kill", "full_disk", "small_disk", "clock") else ""
        )
        code = run(folder, line)
        if code != 0:
            return f"the same command again ends with {code}: {(folder / 'said.txt').read_text()[-300:]}"
        left = content(folder, outputs)
        differs = sorted(k for k in whole.keys() | left.keys() if whole.get(k) != left.get(k))
        return said or half or (f"differs in {', '.join(differs[:4])}" if differs else "")


def warm(commands: list[str]) -> None:
    """Run the commands here once, so that the processes forked from this one have everything loaded."""
    for command in commands:
        with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
            prepare(Path(name))
            quiet = io.StringIO()
            with contextlib.suppress(SystemExit), contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
                cli.main(COMMANDS[command][0].split())


def undisturbed(command: str) -> tuple[dict[str, str], float]:
    """What a command leaves, and how long it takes; raises where two runs differ."""
    found = []
    line, outputs = COMMANDS[command]
    for _ in range(2):
        with tempfile.TemporaryDirectory() as name:
            prepare(Path(name))
            began = time.perf_counter()
            code = run(Path(name), line)
            assert code == 0, (Path(name) / "said.txt").read_text()
            found.append((content(Path(name), outputs), time.perf_counter() - began))
    assert found[0][0] == found[1][0], [k for k in found[0][0] if found[0][0][k] != found[1][0].get(k)]
    return found[1]


def trials(kills: int, faults: int, commands: list[str]) -> list[Trial]:
    """Kills and faults, in turns over the commands."""
    made = [Trial(commands[k % len(commands)], "kill", k) for k in range(kills)]
    return made + [
        Trial(commands[k % len(commands)], FAULTS[k // len(commands) % len(FAULTS)].__name__, k) for k in range(faults)
    ]


def main() -> int:
    """Run from the command line; exit code 1 where anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.crash", description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--faults", type=int, default=40)
    parser.add_argument("--command", action="append", choices=list(COMMANDS), help="only this one; may be repeated")
    parser.add_argument(
        "--log", type=Path, default=Path("results/crash.jsonl"), help="trials that are done and not done again"
    )
    given = parser.parse_args()
    commands = given.command or list(COMMANDS)
    whole: dict[str, tuple[dict[str, str], float]] = {}

    warm(commands)

    def work(trial: Trial) -> str:
        if trial.command not in whole:
            whole[trial.command] = undisturbed(trial.command)
        return disturb(trial, *whole[trial.command])

    todo = {f"{t.command}/{t.kind}/{t.number}": t for t in trials(given.kills, given.faults, commands)}
    done = run_items(
        todo, work, store=Lines(given.log, lambda said: {"said": said}, lambda plain: str(plain["said"]), "a trial")
    )
    count = Counter((todo[k].command, todo[k].kind) for k in done)
    wrong = Counter((todo[k].command, todo[k].kind) for k, said in done.items() if said)
    for (command, kind), n in sorted(count.items()):
        print(f"{command:20s} {kind:16s} {n:4d} disturbed {wrong[command, kind]:4d} wrong")
    for k, said in done.items():
        if said:
            print(f"  {k}: {said}")
    print(
        f"{sum(1 for t in todo.values() if t.kind == 'kill')} kills, {given.faults} other faults, {sum(wrong.values())} wrong"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
