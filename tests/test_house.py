"""Limits of size and shape that keep the code readable; `docs/architecture.md` states them."""

from __future__ import annotations

import ast
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "insemu"
sys.path.insert(0, str(ROOT / "docs"))
from architecture_drawing import arrows, drawing, floors  # noqa: E402

#: Longest module and longest function, in lines; functions without docstring, compiled kernels left out.
MODULE_LINES, FUNCTION_LINES = 600, 80
#: Most functions of more than twelve arguments and of eight or more, compiled ones included; a function of the door says every option of a command.
ABOVE_TWELVE, EIGHT_OR_MORE = 3, 31
#: From how many arguments on a public function says in a Parameters section what they are.
DOCUMENTED_ARGUMENTS = 3


@dataclass(frozen=True)
class Function:
    """A function of the package: where it stands, how long it is, what it says."""

    place: str
    lines: int
    public: bool
    compiled: bool
    arguments: int
    doc: str


def _functions(tree: ast.AST, place: str, public: bool = True) -> Iterator[Function]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{place}:{node.name}", public and not node.name.startswith("_"))
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            if any(ast.unparse(d) == "overload" for d in node.decorator_list):
                continue  # types of the function that stands behind it
            doc = ast.get_docstring(node) or ""
            body = node.body[1:] if doc else node.body
            lines = node.end_lineno - body[0].lineno + 1 if body and node.end_lineno else 0
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            yield Function(
                f"{place}:{node.name}",
                lines,
                public and not node.name.startswith("_"),
                any("njit" in ast.unparse(d) for d in node.decorator_list),
                len([n for n in names if n not in ("self", "cls")]),
                doc,
            )


@cache
def functions() -> tuple[Function, ...]:
    """Every function and method of the package."""
    return tuple(
        function
        for path in sorted(PACKAGE.rglob("*.py"))
        for function in _functions(ast.parse(path.read_text(encoding="utf-8")), str(path.relative_to(PACKAGE)))
    )


@cache
def graph() -> grimp.ImportGraph:
    """Who imports whom."""
    return grimp.build_graph("insemu", cache_dir=None, exclude_type_checking_imports=True)


def long_modules() -> set[str]:
    """Modules of more lines than allowed."""
    counts = {p: len(p.read_text(encoding="utf-8").splitlines()) for p in PACKAGE.rglob("*.py")}
    return {str(p.relative_to(PACKAGE)) for p, n in counts.items() if n > MODULE_LINES}


def long_functions() -> set[str]:
    """Functions of more lines than allowed, kernels left out."""
    return {f.place for f in functions() if not f.compiled and f.lines > FUNCTION_LINES}


def wide_functions(arguments: int) -> set[str]:
    """Functions of so many arguments or more, those of the door left out: values that travel together are one object."""
    return {f.place for f in functions() if f.arguments >= arguments and not f.place.startswith("api.py")}


def undocumented() -> set[str]:
    """Public functions whose arguments stand nowhere.

    A command's arguments are described by its options, and a method's by the one of the same name that it overrides or fulfils.
    """
    described = {
        f.place.rsplit(":", 1)[1] for f in functions() if f.place.count(":") > 1 and "Parameters\n---" in f.doc
    }
    return {
        f.place
        for f in functions()
        if f.public
        and f.arguments >= DOCUMENTED_ARGUMENTS
        and "Parameters\n---" not in f.doc
        and not f.place.startswith("cli/")
        and not (f.place.count(":") > 1 and f.place.rsplit(":", 1)[1] in described)
    }


def circles() -> set[str]:
    """Modules that import each other, directly or through others."""
    g = graph()
    return {
        m for m in g.modules if any(m in g.find_upstream_modules(d) for d in g.find_modules_directly_imported_by(m))
    }


def offered(module: str) -> bool:
    """Whether the door above a module offers its name: the module itself, or a function of that name."""
    door, _, name = module.rpartition(".")
    return name in getattr(import_module(door), "__all__", ())


def past_doors() -> set[str]:
    """Imports of one room from a module inside another: room -> module. Doors are the packages: a room, or a floor inside it."""
    rooms = {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    doors = {".".join(("insemu", *p.parent.relative_to(PACKAGE).parts)) for p in PACKAGE.rglob("__init__.py")}
    g = graph()
    found = set()
    for importer in g.modules:
        own = importer.split(".")[1:2]
        for imported in g.find_modules_directly_imported_by(importer):
            parts = imported.split(".")
            if imported not in doors and parts[1:2] != own and parts[1] in rooms and not offered(imported):
                found.add(f"{'.'.join(own)} -> {imported}")
    return found


def stale_imports() -> set[str]:
    """Names of the package that benchmarks, which no test runs, import and that do not exist."""
    found = set()
    for path in (ROOT / "benchmarks").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "insemu":
                module = import_module(str(node.module))
                modules = {m.name for m in pkgutil.iter_modules(getattr(module, "__path__", []))}
                names = {a.name for a in node.names if not hasattr(module, a.name)} - modules
                found |= {f"{path.relative_to(ROOT)}:{node.lineno} {node.module}.{name}" for name in names}
    return found


@pytest.mark.parametrize(
    "check",
    [long_modules, long_functions, undocumented, circles, past_doors, stale_imports],
    ids=lambda check: check.__name__,
)
def test_nothing_exceeds_a_limit(check: Callable[[], set[str]]) -> None:
    assert sorted(check()) == [], check.__doc__


def test_few_functions_take_many_arguments() -> None:
    above, many = wide_functions(13), wide_functions(8)
    assert len(above) <= ABOVE_TWELVE, sorted(above)
    assert len(many) <= EIGHT_OR_MORE, sorted(many)


def test_every_room_has_its_paragraph_floor_by_floor() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split("## Rooms")[1].split("\n## ")[0]
    level = {room: k for k, floor in enumerate(floors()) for room in floor}
    named = re.findall(r"\*\*`(\w+)`\*\*", page)
    assert sorted(named) == sorted(level), (
        "docs/architecture.md needs one entry **`room`** for every room of pyproject.toml"
    )
    assert [level[room] for room in named] == sorted(level.values()), "rooms stand in the order of the floors"


def test_the_drawing_has_every_room_and_only_arrows_that_lead_down() -> None:
    level = {room: k for k, floor in enumerate(floors()) for room in floor}
    assert all(f">{room}</text>" in drawing() for room in level)
    assert len(arrows()) > len(level) and all(level[a] < level[b] for a, b in arrows())
