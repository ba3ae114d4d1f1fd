"""Kernels: compiled for one processor, kept, those that came with the package first, none older than what it calls."""

from __future__ import annotations

import gc
import json
import re
import select
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import portalocker
import pytest
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

from insemu import compiled, progress
from insemu.cli import main


def _twice(x: float) -> float:
    return 2.0 * x


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Folders of the kernels that were compiled here and of those that came with the package, both empty."""
    own, shipped = tmp_path / "own", tmp_path / "shipped"
    monkeypatch.setattr(compiled, "own_folder", lambda: own)
    monkeypatch.setattr(compiled, "SHIPPED", shipped)
    return own, shipped


def hits(function: Callable[..., Any] = _twice) -> int:
    """How often a kernel that was decorated anew found its compiled code."""
    kernel: Any = compiled.njit(cache=True)(function)
    assert kernel(1.5) == 3.0
    return sum(kernel.stats.cache_hits.values())


def test_a_kernel_is_kept_until_the_sources_of_any_kernel_change(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert hits() == 0
    assert hits() == 1
    monkeypatch.setattr(compiled, "sources_stamp", lambda: "other")
    assert hits() == 0
    assert hits() == 1


def test_kernels_that_came_with_the_package_are_taken_and_nothing_is_written(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    hits()
    shutil.move(own, shipped)
    assert hits() == 1
    assert not own.exists()


def test_where_nothing_can_be_written_kernels_are_compiled_all_the_same(folders: tuple[Path, Path]) -> None:
    own, _ = folders
    own.write_text("a file, not a folder")
    assert hits() == 0
    assert not compiled.writable()


def test_only_sources_with_kernels_count() -> None:
    kernel, plain = b"from insemu.compiled import njit\n@njit()\ndef f(): return 1\n", b"x = 1\n"
    stamp = compiled.stamp_of([kernel, plain])
    assert compiled.stamp_of([kernel, b"x = 2\n"]) == stamp
    assert compiled.stamp_of([kernel.replace(b"return 1", b"return 2"), plain]) != stamp


def test_all_kernels_are_made_by_this_module() -> None:
    others = {
        str(path.relative_to(compiled.PACKAGE))
        for path in compiled.PACKAGE.rglob("*.py")
        if re.search(
            r"^\s*from numba\b.* import .*\b(njit|jit|cfunc|vectorize)\b", path.read_text("utf-8"), re.MULTILINE
        )
    }
    assert others == set()


def test_numba_compiles_for_the_baseline() -> None:
    assert cpu_target.target_context.codegen().magic_tuple()[1] == compiled.baseline()


@pytest.mark.parametrize(
    ("features", "machine", "name"),
    [
        (dict.fromkeys(compiled.V3, True), "x86_64", "x86-64-v3"),
        (dict.fromkeys(compiled.V3, True) | {"avx2": False}, "AMD64", "generic"),
        (dict.fromkeys(compiled.V3, True), "arm64", "generic"),
    ],
)
def test_the_baseline_is_what_the_processor_has(
    features: dict[str, bool], machine: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: features)
    assert compiled.baseline() == name


def test_the_version_says_where_kernels_come_from(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    processor = compiled.baseline()
    assert compiled.described() == f"compiled here for {processor}, kept in {own}"
    shipped.mkdir()

    def made(**other: object) -> str:
        held = compiled.made_for() | {"processors": [processor]} | other
        (shipped / compiled.MADE).write_text(json.dumps(held), encoding="utf-8")
        return compiled.described()

    assert made() == f"shipped for {processor}"
    assert made(numba="0.1").endswith("(those that came with it are for numba 0.1)")
    assert made(processors=["pdp-11"]).endswith("(those that came with it are for pdp-11)")


def test_compiling_is_said_once(folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(progress, "_said", set())
    monkeypatch.setattr(progress, "listeners", [said.append])
    hits()
    hits()
    (line,) = said
    assert line.startswith(f"Compiling kernels for {compiled.baseline()}")


def test_the_command_line_prints_what_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_said", set())
    with pytest.raises(SystemExit):
        main(["--version"])
    progress.say_once("Something takes long")
    progress.say_once("Something takes long")
    out = capsys.readouterr()
    assert f"kernels: {compiled.described()}" in out.out
    assert out.err == "Something takes long.\n"


#: A process that says when it begins to compile a kernel, and at the end how often it found it compiled.
_PROCESS = """
import sys
from pathlib import Path
from insemu import compiled
compiled.own_folder = lambda: Path(sys.argv[1])

def slow(x):
    for _ in range(3):
        x = x / 3.0 + x ** 0.5
    return x

kernel = compiled.njit(cache=True)(slow)
plain = kernel._compiler.compile
def counted(*given):
    print("compiles", flush=True)
    sys.stdin.readline()
    return plain(*given)
kernel._compiler.compile = counted
kernel(2.0)
print("found", sum(kernel.stats.cache_hits.values()), flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="select of Windows knows no pipes")
def test_a_kernel_that_one_process_compiles_is_loaded_by_the_other(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(_PROCESS)

    def started() -> subprocess.Popen[str]:
        line = [sys.executable, str(program), str(tmp_path / "own")]
        return subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    with started() as one, started() as other:
        assert one.stdout and one.stdin and other.stdout and other.stdin
        first = select.select([one.stdout, other.stdout], [], [], 60.0)[0][0]
        compiling, waiting = (one, other) if first is one.stdout else (other, one)
        assert first.readline() == "compiles\n"
        assert not select.select([waiting.stdout], [], [], 0.5)[0]  # it waits, however long the other one takes
        for process in (compiling, waiting):
            process.stdin.write("\n")
            process.stdin.flush()
        assert compiling.stdout.readline() == "found 0\n"
        assert waiting.stdout.readline() == "found 1\n"


def test_what_cannot_be_compiled_is_let_go(folders: tuple[Path, Path]) -> None:
    own, _ = folders

    @compiled.njit(cache=True)
    def wrong(x: float) -> float:
        return x.none_of_its_own  # type: ignore[attr-defined,no-any-return]

    with pytest.raises(TypingError):
        wrong(1.0)
    (lock,) = own.glob("*.lock")
    with open(lock, "ab") as file:
        portalocker.lock(file, portalocker.LOCK_EX | portalocker.LOCK_NB)


def _root(x: float) -> float:
    if x < 0.0:
        raise ValueError("negative")
    return float(x**0.5)


def test_a_kernel_that_others_call_is_a_part_of_each_and_compiled_by_itself_for_python() -> None:
    root: Any = compiled.njit(nogil=True)(_root)
    plain = numba.njit(lambda x: 2.0 * root(x))

    def doubled(x: float) -> float:
        return 2.0 * root(x)  # type: ignore[no-any-return]

    first, second = (compiled.njit(nogil=True)(doubled) for _ in range(2))
    assert first(9.0) == 6.0
    with pytest.raises(ValueError, match="negative"):
        first(-1.0)
    assert not root.overloads
    assert root(16.0) == 4.0
    assert second(16.0) == plain(16.0) == 8.0
    with pytest.raises(ValueError, match="negative"):
        second(-1.0)
    assert root(25) == 5.0
    assert second(25) == 10.0
    assert len(root.overloads) == 2


def test_a_part_that_is_refused_is_refused_again() -> None:
    @compiled.njit()
    def wrong(x: float) -> float:
        return x.none_of_its_own  # type: ignore[attr-defined,no-any-return]

    for _ in range(2):
        caller = compiled.njit()(lambda x: wrong(x))
        with pytest.raises(TypingError, match="none_of_its_own"):
            caller(1.0)


def test_types_of_a_call_are_found_once_for_the_same_types() -> None:
    asked: list[Any] = []

    def plain(function: str, context: Any, args: Any, kws: Any) -> str:
        asked.append((function, context, args, kws))
        if args == ("none",):
            raise TypingError("no such call")
        return f"{function}{args}{kws}"

    remembered = compiled._remembered(plain)
    calls = [("f", "cpu", (1,), {}), ("f", "cpu", (2,), {}), ("g", "cpu", (1,), {}), ("f", "cpu", (1,), {"k": 1})]
    for _ in range(2):
        assert [remembered(*call) for call in calls] == [f"{f}{args}{kws}" for f, _, args, kws in calls]
        with pytest.raises(TypingError):
            remembered("f", "cpu", ("none",), {})
    assert [a for a in asked if a[2] != ("none",)] == calls
    assert len(asked) == len(calls) + 2


def test_python_collects_garbage_as_before_once_kernels_are_compiled() -> None:
    before = gc.get_threshold()
    with pytest.raises(ZeroDivisionError), compiled._compiling():
        with compiled._compiling():
            pass
        assert gc.get_threshold() == compiled.RARELY
        raise ZeroDivisionError
    assert gc.get_threshold() == before
