"""Mutation testing: small faults put into the code, one at a time, and whether a test sees them.

``python -m tests.mutants --cover`` runs the quick suite once and notes which tests run which line (some minutes; kept in ``.mutants``, or in
the folder that ``INSEMU_MUTANTS`` names). Without that, the test files that name a mutant's module most often are traced when the first needs them.
``python -m tests.mutants --sample 160 --seed 1`` draws mutants at random from all rooms (one change of the syntax tree each: an operator, a
comparison, a condition turned round, a number moved, ``and`` for ``or``, ``min`` for ``max``, a statement left out, a returned number doubled) and
gives each the tests that run its line, the quickest first, until one fails that passes on the code as it is. What no trace sees (compiled code, what
is outside of functions or in their heads, other processes) is given the quick tests of its room (uncompiled, where its file has kernels), then all
tests of the room that are not slow and those of the rooms that use it (neither with ``--quick``). Printed is the share that survived, with its
interval, room by room.
``--room noise`` draws from one room, ``--only FILE:LINE`` takes the mutants of a line, ``--only FILE`` a sample of those of a file. A mutant that was
read and found to change nothing that anyone can see stands with its reason in ``tests/mutants.yaml`` and counts as equivalent.

The usual tools run each mutant in a new interpreter, which here costs more than the tests: the libraries are loaded once, and each mutant is a
fork of that.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from scipy.stats import beta

ROOT = Path(__file__).resolve().parents[1]
READ = ROOT / "tests" / "mutants.yaml"
COVER = Path(os.environ.get("INSEMU_MUTANTS", ROOT / ".mutants")) / "cover.json"
#: Rooms whose tests are chosen by hand (all others: by what they name): the tests that should see what goes wrong in them (first those that see most
#: of it), and tests of the rooms above that would see it, too.
ROOMS = {
    "noise": (
        ["noise"],
        ["tables", "noise_pins", "noise", "noise_derived"],
        ["augment", "fit_methods", "fit_gmwm", "gap_beliefs_any_process"],
    ),
    "variance": (
        ["variance"],
        [
            "tables",
            "variance_kernels",
            "variance_exact",
            "exact_pins",
            "variance_pins",
            "variance_wavelet",
            "variance_allan",
            "variance_reading",
            "variance_filtered",
            "variance_robust",
        ],
        ["fit_gmwm", "fit_readings", "characterise", "online"],
    ),
    "augment": (["augment.py"], ["tables", "augment"], ["designs", "filters", "together", "covariance"]),
    "effects": (
        ["effects"],
        ["tables", "effects_pins", "effects", "effects_passes", "compensation"],
        ["effect_matrix", "gap_dynamic"],
    ),
    "units": (["units.py"], ["tables", "units"], ["sensors", "formats"]),
    "records": (["records.py"], ["tables", "records", "formats"], ["filters", "aids", "emulate_cli", "files"]),
    "scenario": (
        ["scenario"],
        ["tables", "scenario_sections", "scenario", "scenario_fuzz"],
        ["init", "sweep", "designs", "run"],
    ),
    "formats": (
        ["formats"],
        ["tables", "maps", "readers", "arrays", "written", "formats", "files", "export"],
        ["intake", "recorded", "emulate_cli"],
    ),
}
#: Rooms without numbers or verdicts that users read: words, pictures, files, commands, and what carries work.
WORDS = {
    "__init__", "__main__", "api", "blas", "cli", "cluster", "compiled", "errors", "formats", "given", "guards", "lanes", "logs", "progress",
    "report", "scenario", "shown", "whole", "work", "yamlfile",
}  # fmt: skip
#: Test files that are traced for a mutant of a file, and processor seconds of one of them: tests that would begin later are left out.
FILES, TRACED = 3, 60.0
#: Processor seconds of a test that takes part in the first look; of one mutant, or this many times what its tests take of the code as it is.
QUICK, MOST, LONGER = 1.0, 20.0, 5.0
#: Processor seconds of a mutant in the further looks, and of the tests that run its line, as they take of the code as it is.
FURTHER, COVERED = 300.0, 90.0
#: File of the bench that names the test which failed.
FAILED = "failed.txt"
_OTHER = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "sin": "cos", "cos": "sin"}
_SWAPS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Pow: (ast.Mult,), ast.FloorDiv: (ast.Div,),
    ast.Mod: (ast.Mult,), ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.And: (ast.Or,), ast.Or: (ast.And,),
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change of one file."""

    room: str
    file: str
    line: int
    number: int
    change: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line} [{self.number}] {self.change}  in  {self.text}"

    @property
    def text(self) -> str:
        """The line as it stands."""
        return (ROOT / self.file).read_text(encoding="utf-8").splitlines()[self.line - 1].strip()


def _changes(node: ast.AST) -> list[tuple[str, Any]]:
    """Descriptions and changed copies of a node."""
    found: list[tuple[str, Any]] = []

    def swapped(op: ast.AST, put: Any) -> None:
        for other in _SWAPS.get(type(op), ()):
            changed = copy.deepcopy(node)
            put(changed, other())
            found.append((f"{ast.unparse(node)[:70]}  ->  {ast.unparse(changed)[:70]}", changed))  # type: ignore[arg-type]

    if isinstance(node, ast.BinOp | ast.BoolOp):
        if not (
            isinstance(node, ast.BinOp)
            and isinstance(node.left, ast.JoinedStr | ast.Constant)
            and isinstance(getattr(node.left, "value", 0), str)
        ):
            swapped(node.op, lambda n, o: setattr(n, "op", o))
    elif isinstance(node, ast.Compare):
        swapped(node.ops[0], lambda n, o: n.ops.__setitem__(0, o))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        found.append((f"{ast.unparse(node)[:70]}  ->  {ast.unparse(node.operand)[:70]}", node.operand))
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
        other = (
            not node.value
            if isinstance(node.value, bool)
            else node.value + 1
            if isinstance(node.value, int)
            else node.value * 1.5 + (node.value == 0)
        )
        found.append((f"{node.value}  ->  {other}", ast.Constant(other)))
    elif isinstance(node, ast.Call) and (name := getattr(node.func, "attr", getattr(node.func, "id", ""))) in _OTHER:
        changed = copy.deepcopy(node)
        setattr(changed.func, "attr" if isinstance(node.func, ast.Attribute) else "id", _OTHER[name])
        found.append((f"{ast.unparse(node)[:70]}  ->  {_OTHER[name]}", changed))
    elif isinstance(node, ast.AugAssign) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and "raise" not in ast.unparse(node)
    ):
        found.append((f"{ast.unparse(node)[:70]}  ->  left out", ast.Pass()))
    elif isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp | ast.Call) and _number(node.value):
        doubled = ast.BinOp(ast.Constant(2.0), ast.Mult(), node.value)
        found.append((f"{ast.unparse(node)[:70]}  ->  doubled", ast.Return(doubled)))
    elif isinstance(node, ast.IfExp | ast.If):
        changed = copy.copy(node)
        changed.test = ast.UnaryOp(ast.Not(), node.test)
        found.append((f"if {ast.unparse(node.test)[:60]}  ->  if not (...)", changed))
    return found


def _number(node: ast.expr) -> bool:
    """Whether what is returned is a number by its form."""
    if isinstance(node, ast.Call):
        return getattr(node.func, "id", getattr(node.func, "attr", "")) in (
            "float",
            "sqrt",
            "exp",
            "log",
            "hypot",
            "asarray",
            "mean",
            "sum",
        )
    return isinstance(node.op, ast.Mult | ast.Div | ast.Sub | ast.Pow)


def rooms() -> dict[str, tuple[list[str], list[str], list[str]]]:
    """All rooms: those of :data:`ROOMS`, and every other package and module."""
    found = dict(ROOMS)
    for path in sorted((ROOT / "insemu").iterdir()):
        if path.stem not in found and (path.suffix == ".py" or (path / "__init__.py").exists()):
            found[path.stem] = ([path.name], [], [])
    return found


def naming(file: str) -> list[str]:
    """Test files that name a module of the package: those first that name it, its classes and its functions most often."""
    parts = Path(file).with_suffix("").parts
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    kinds = (ast.FunctionDef, ast.ClassDef)
    own = {n.name for n in ast.walk(tree) if isinstance(n, kinds) and not n.name.startswith("__") and len(n.name) > 4}
    score = {}
    for path in sorted((ROOT / "tests").glob("test_*.py")):
        words = Counter(re.findall(r"[A-Za-z_][\w.]*", path.read_text(encoding="utf-8")))
        kin = sum(k for w, k in words.items() if w.startswith(".".join(parts[:2])))
        direct = words[".".join(parts)] * 10 + sum(min(k, 3) for w, k in words.items() if w.split(".")[-1] in own)
        bonus = 3 * sum(part.strip("_") in path.stem.split("_") for part in parts[1:])
        if kin or direct:
            score[f"tests/{path.name}"] = direct + bonus + min(kin, 3)
    return sorted(score, key=lambda name: -score[name])


def _sites(tree: ast.Module) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Parents, fields and places of all nodes that run; annotations, decorators, messages of errors and ``if TYPE_CHECKING`` apart."""
    stack: list[ast.AST] = [tree]
    while stack:
        parent = stack.pop()
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns", "decorator_list", "type_params") or isinstance(
                parent, ast.Raise | ast.JoinedStr
            ):
                continue
            for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST):
                    if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                        continue
                    if isinstance(child, ast.expr | ast.If | ast.AugAssign | ast.Expr | ast.Return):
                        yield parent, field, place
                    stack.append(child)


def mutants(room: str, kernels: bool = True) -> list[Mutant]:
    """All mutants of a room, in the order of its files; without those of files with kernels if that is asked for."""
    found = []
    for part in rooms()[room][0]:
        path = ROOT / "insemu" / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            text = file.read_text(encoding="utf-8")
            if not kernels and "njit" in text:
                continue
            tree = ast.parse(text)
            number = 0
            for parent, field, place in _sites(tree):
                child = getattr(parent, field) if place is None else getattr(parent, field)[place]
                for change, _ in _changes(child):
                    found.append(Mutant(room, file.relative_to(ROOT).as_posix(), child.lineno, number, change))
                    number += 1
    return found


def mutated(mutant: Mutant) -> str:
    """The source of the file with the change."""
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    number = 0
    for parent, field, place in _sites(tree):
        child = getattr(parent, field) if place is None else getattr(parent, field)[place]
        for _, changed in _changes(child):
            if number == mutant.number:
                if place is None:
                    setattr(parent, field, changed)
                else:
                    getattr(parent, field)[place] = changed
                return ast.unparse(ast.fix_missing_locations(tree))
            number += 1
    raise ValueError(str(mutant))


class _Quick:
    """A plugin of pytest: notes which test failed; with a note, stops tests that take too long and notes which did not."""

    def __init__(self, note: Path | None, failed: Path) -> None:
        self.note, self.failed = note, failed

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.failed.write_text(report.nodeid, encoding="utf-8")
        if self.note is not None and report.when == "call" and report.passed:
            with self.note.open("a", encoding="utf-8") as file:
                file.write(report.nodeid + "\n")

    def pytest_runtest_setup(self, item: Any) -> None:
        if self.note is not None:
            signal.signal(signal.SIGVTALRM, _stop)
            signal.setitimer(signal.ITIMER_VIRTUAL, QUICK)

    def pytest_runtest_teardown(self, item: Any) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


def _stop(*_: Any) -> None:
    raise TimeoutError


def _forked(
    folder: Path, arguments: Sequence[str], note: Path | None, seconds: float, interpreted: bool
) -> tuple[int, float]:
    """Run pytest in a fork that sees the folder's insemu; exit code (-1: too long) and processor seconds."""
    pid = os.fork()
    if pid == 0:
        try:
            os.environ["NUMBA_DISABLE_JIT"] = str(int(interpreted))
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
            resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            os.chdir(folder)
            sys.path[:] = [str(folder), *(p for p in sys.path if Path(p or ".").resolve() != ROOT)]
            for name in [n for n in sys.modules if n.split(".")[0] in ("insemu", "tests")]:
                del sys.modules[name]
            if interpreted:
                import numba

                numba.config.DISABLE_JIT = 1
            import pytest

            options = [
                "-q",
                "-p",
                "no:cacheprovider",
                "-p",
                "no:xdist",
                "-m",
                "not slow",
                "-W",
                "default",
                "--no-header",
                "--tb=no",
                *arguments,
            ]
            os._exit(int(pytest.main(options, plugins=[_Quick(note, folder / FAILED)])))
        except BaseException:
            os._exit(70)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    deadline = time.monotonic() + 4.0 * seconds + 30.0  # the machine may be busy; what waits for ever is seen, too
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return (os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1), took


class _Watch:
    """A plugin of pytest: tells the trace which test function runs, and notes how long each took."""

    def __init__(self, trace: Any, most: float) -> None:
        self.trace, self.most, self.seconds = trace, most, dict[str, float]()
        self.began = time.process_time()

    def pytest_runtest_setup(self, item: Any) -> None:
        import pytest

        if time.process_time() - self.began > self.most:
            pytest.skip("traced long enough")
        self.trace.switch_context(item.nodeid.split("[")[0])

    def pytest_runtest_logreport(self, report: Any) -> None:
        name = report.nodeid.split("[")[0]
        self.seconds[name] = self.seconds.get(name, 0.0) + report.duration


def _traced(files: Sequence[str], target: Path, most: float) -> None:
    """Run test files with a trace of the rooms; write what ran which line."""
    import coverage
    import pytest

    trace = coverage.Coverage(data_file=None, include=[str(ROOT / "insemu" / "*")], config_file=False)
    watch = _Watch(trace, most)
    trace.start()
    pytest.main(
        ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow", "-W", "default", "--no-header", *files],
        plugins=[watch],
    )
    trace.stop()
    data = trace.get_data()
    lines = {
        Path(file).relative_to(ROOT).as_posix(): {
            line: sorted(c for c in names if c) for line, names in data.contexts_by_lineno(file).items()
        }
        for file in data.measured_files()
    }
    target.write_text(json.dumps({"seconds": watch.seconds, "lines": lines}), encoding="utf-8")


def cover(workers: int, only: Sequence[str] = (), most: float = math.inf) -> None:
    """Note for every line of the rooms which tests run it; of some test files, what is known of the others stays."""
    files = list(only) or sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests").glob("test_*.py"))
    with tempfile.TemporaryDirectory() as folder:
        parts = [Path(folder) / str(k) for k in range(workers)]
        children = []
        for k, part in enumerate(parts):
            pid = os.fork()
            if pid == 0:
                try:
                    quiet = os.open(os.devnull, os.O_WRONLY)
                    os.dup2(quiet, 1)
                    _traced(files[k::workers], part, most)
                    os._exit(0)
                except BaseException as error:
                    print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
                    os._exit(1)
            children.append(pid)
        if any(os.waitpid(pid, 0)[1] for pid in children):
            raise SystemExit("a part of the tests could not be traced")
        known = Covering()
        seconds = {name: took for name, took in known.seconds.items() if only and name.split("::")[0] not in only}
        lines = {
            file: {line: [n for n in names if n in seconds] for line, names in by_line.items()}
            for file, by_line in known.lines.items()
        }
        for part in parts:
            found = json.loads(part.read_text(encoding="utf-8"))
            seconds |= found["seconds"]
            for file, by_line in found["lines"].items():
                for line, names in by_line.items():
                    lines.setdefault(file, {}).setdefault(line, []).extend(names)
        noted = sorted(set(known.files) | set(files))
    COVER.parent.mkdir(exist_ok=True)
    COVER.write_text(json.dumps({"files": noted, "seconds": seconds, "lines": lines}), encoding="utf-8")


def files_of(mutant: Mutant) -> list[str]:
    """The test files of a mutant's room, or those that name its module."""
    if mutant.room in ROOMS:
        return [f"tests/test_{name}.py" for name in ROOMS[mutant.room][1]]
    return naming(mutant.file)[: 2 * FILES]


class Covering:
    """Which tests run which line, where that was noted."""

    def __init__(self, traced: int = FILES, most: float = TRACED) -> None:
        self.traced, self.most = traced, most
        self._load()

    def _load(self) -> None:
        known = json.loads(COVER.read_text(encoding="utf-8")) if COVER.exists() else {"seconds": {}, "lines": {}}
        self.files: list[str] = known.get("files", [])
        self.seconds: dict[str, float] = known["seconds"]
        self.lines: dict[str, dict[str, list[str]]] = known["lines"]

    def reach(self, mutant: Mutant) -> None:
        """Trace the test files that name the mutant's module most often, where they were not."""
        if "njit" in (ROOT / mutant.file).read_text(encoding="utf-8"):
            return
        for file in files_of(mutant)[: self.traced]:
            if file not in self.files:
                cover(1, [file], self.most)
                self._load()

    def tests(self, mutant: Mutant) -> list[str] | None:
        """Test functions that run the mutant's line, the room's own and the quickest first; ``None`` where a trace names none."""
        by_line = self.lines.get(mutant.file)
        if by_line is None:
            return None
        source = (ROOT / mutant.file).read_text(encoding="utf-8")
        inside = [
            n
            for n in ast.walk(ast.parse(source))
            if isinstance(n, ast.stmt) and n.lineno <= mutant.line <= (n.end_lineno or n.lineno)
        ]
        functions = [n for n in inside if isinstance(n, ast.FunctionDef)]
        text = source.splitlines()
        heads = [
            "".join(text[min([f.lineno, *(d.lineno for d in f.decorator_list)]) - 1 : f.body[0].lineno - 1])
            for f in functions
        ]
        if not heads or any("compiled" in head or "njit" in head for head in heads):
            return None
        statement = max(inside, key=lambda n: n.lineno)
        names = by_line.get(str(mutant.line)) or by_line.get(str(statement.lineno), [])
        own = set(files_of(mutant))
        # pins hold most results of a room, and the first of them that moved ends the look
        ordered = sorted(
            names, key=lambda n: (n.split("::")[0] not in own, "_pins.py" not in n, self.seconds.get(n, 0.0))
        )
        taken, total = list[str](), 0.0
        for name in ordered:
            total += self.seconds.get(name, 0.0)
            if taken and total > COVERED:
                break
            taken.append(name)
        return taken or None  # the head of a function runs before any test, and other processes are not traced


class Bench:
    """A copy of the tree in which one file at a time is changed.

    Parameters
    ----------
    folder : Path
        Empty.
    covering : Covering
    """

    def __init__(self, folder: Path, covering: Covering) -> None:
        self.folder, self.covering = folder, covering
        for name in ("insemu", "tests", "docs", "scenarios", "results"):
            if (ROOT / name).exists():
                shutil.copytree(
                    ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc", "cache", "*.nc", "*.png")
                )
        for name in ("pyproject.toml", "README.md", "CHANGELOG.md"):
            shutil.copy(ROOT / name, folder / name)
        if "INSEMU_SHARED" not in os.environ:
            os.environ["INSEMU_SHARED"] = str(ROOT.parent / "shared")
        self.quick: dict[tuple[str, bool], tuple[list[str], float]] = {}
        self.sound, self.unsound, self.interpreted = set[str](), set[str](), False

    def tests(self, mutant: Mutant, interpreted: bool) -> tuple[list[str], float]:
        """The quick tests of a mutant's room, with kernels compiled or not, and the processor seconds that they take together."""
        files = files_of(mutant)
        room = mutant.room if mutant.room in ROOMS else mutant.file.replace("/", ".")
        if (room, interpreted) not in self.quick:
            note = self.folder / f"quick_{room}_{interpreted}.txt"
            note.touch()
            _forked(self.folder, files, note, 90.0, interpreted)
            names = note.read_text(encoding="utf-8").splitlines()
            if not names:
                raise SystemExit(f"{room}: no test of {', '.join(files)} passes on the code as it is")
            code, took = _forked(self.folder, ["-x", *names], None, 200.0, interpreted)
            print(
                f"{room}: {len(names)} quick tests, {took:.1f} s{'' if code == 0 else f', exit code {code}'}",
                flush=True,
            )
            self.quick[room, interpreted] = names, took
        return self.quick[room, interpreted]

    def seen(self, mutant: Mutant, whole: bool) -> bool:
        """Whether a test fails that passes on the code as it is.

        Parameters
        ----------
        mutant : Mutant
        whole : bool
            Give what survives the quick tests the others of the room, then those above it, compiled.
        """
        while True:
            failed = self._failing(mutant, whole)
            if failed is None:
                return False
            if failed == "" or failed in self.sound:  # too long, or no longer importable
                return True
            passes = _forked(self.folder, [failed], None, FURTHER, self.interpreted)[0] == 0
            (self.sound if passes else self.unsound).add(failed)
            if not passes:
                print(f"left out, it fails on the code as it is: {failed}", flush=True)

    def _failing(self, mutant: Mutant, whole: bool) -> str | None:
        """The test that fails; empty where the change keeps tests from running or ending, ``None`` where all pass."""
        target = self.folder / mutant.file
        self.covering.reach(mutant)
        covering = self.covering.tests(mutant)
        kernels = "njit" in target.read_text(encoding="utf-8")
        names, usual = self.tests(mutant, kernels) if covering is None else ([], 0.0)
        if covering is not None:
            looks = [(covering, FURTHER, False)]
        else:
            above = [f"tests/test_{name}.py" for name in ROOMS.get(mutant.room, ([], [], []))[2]]
            looks = [(names, max(MOST, LONGER * usual), kernels)]
            looks += [(files, FURTHER, False) for files in (files_of(mutant), above) if files] if whole else []
        try:
            target.write_text(mutated(mutant), encoding="utf-8")
            for tests, seconds, self.interpreted in looks:
                (self.folder / FAILED).unlink(missing_ok=True)
                out = [f"--deselect={name}" for name in self.unsound]
                code, _ = _forked(self.folder, ["-x", *out, *tests], None, seconds, self.interpreted)
                if code not in (0, 5):  # 5: none was left to run
                    named = self.folder / FAILED
                    return named.read_text(encoding="utf-8") if named.exists() else ""
            return None
        finally:
            # with its time, by which its compiled kernels are known
            shutil.copy2(ROOT / mutant.file, target)
            if "njit" in target.read_text(encoding="utf-8"):
                self._compiled_again()

    def _compiled_again(self) -> None:
        """Put the compiled kernels back that went when a file with kernels was changed."""
        for cached in (ROOT / "insemu").rglob("__pycache__"):
            for file in (*cached.glob("*.nb?"), *cached.glob("*.stamp")):
                shutil.copy2(file, self.folder / file.relative_to(ROOT))


def equivalent() -> dict[str, str]:
    """Mutants that were read and change nothing anyone can see, with the reason, by file, change and line."""
    return (yaml.safe_load(READ.read_text(encoding="utf-8")) or {}) if READ.exists() else {}


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--sample", type=int, default=160)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", choices=rooms(), action="append")
    parser.add_argument("--no-kernels", action="store_true", help="draw none of files with compiled code")
    parser.add_argument("--files", type=int, default=FILES, help="test files that are traced for a mutant's file")
    parser.add_argument("--trace", type=float, default=TRACED, help="processor seconds of the trace of one test file")
    parser.add_argument("--only", metavar="FILE:LINE", help="all mutants of a line, or a sample of those of a file")
    parser.add_argument("--minutes", type=float, default=1e6, help="begin no mutant after this time")
    parser.add_argument("--quick", action="store_true", help="do not give survivors the tests that are not quick")
    parser.add_argument("--cover", action="store_true", help="note which tests run which line, and end")
    parser.add_argument(
        "--tests", nargs="+", default=[], help="with --cover: note these test files anew, keep the others"
    )
    parser.add_argument("--workers", type=int, default=2, help="with --cover")
    given = parser.parse_args()
    if given.cover:
        cover(given.workers, given.tests)
        return 0
    import hypothesis
    import numba
    import pandas
    import pydantic
    import pytest
    import pywt
    import scipy.optimize
    import scipy.signal
    import xarray

    assert all((hypothesis, numba, pandas, pydantic, pytest, pywt, scipy.optimize, scipy.signal, xarray))
    every = [m for room in given.room or rooms() for m in mutants(room, not given.no_kernels)]
    if given.only:
        file, _, line = given.only.partition(":")
        every = [m for m in every if m.file == file and line in ("", str(m.line))]
    if given.only and ":" in given.only:
        chosen = every
    else:
        chosen = random.Random(given.seed).sample(every, min(given.sample, len(every)))
    end = time.monotonic() + 60.0 * given.minutes
    reasons = equivalent()
    survived, apart = list[Mutant](), list[Mutant]()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), Covering(given.files, given.trace))
        for k, mutant in enumerate(chosen):
            if time.monotonic() > end:
                chosen = chosen[:k]  # the first of a random order are a random sample, too
                break
            if bench.seen(mutant, not given.quick):
                continue
            reason = reasons.get(f"{mutant.file}: {mutant.change}  in  {mutant.text}")
            (survived if reason is None else apart).append(mutant)
            print(
                f"[{k + 1}/{len(chosen)}] survives: {mutant}" + (f"  (equivalent: {reason})" if reason else ""),
                flush=True,
            )
    print(f"{len(every)} mutants, {len(chosen)} drawn (seed {given.seed}), {len(apart)} equivalent")
    counted = [m for m in chosen if m not in apart]
    said = {room: [m for m in counted if m.room == room] for room in sorted({m.room for m in counted})}
    said["numbers and verdicts"] = [m for m in counted if m.room not in WORDS]
    said["all"] = counted
    for name, some in said.items():
        n, s = len(some), sum(m in survived for m in some)
        low, high = (beta.ppf(0.025, s, n - s + 1) if s else 0.0), (beta.ppf(0.975, s + 1, n - s) if s < n else 1.0)
        print(f"{name:22s} {s:3d} of {n:3d} survive: {100 * s / max(1, n):5.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    return 0


if __name__ == "__main__":
    sys.exit(main())
