"""One language of commands: every option is of the table, and every command that is written somewhere exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from benchmarks.trial.__main__ import app as trial
from insemu import units
from insemu.cli import app
from insemu.cli.options import ARGUMENTS, OPTIONS, SHORT, Arguments, argument, option, spread

ROOT = Path(__file__).resolve().parent.parent
COMMANDS: dict[str, Any] = dict(get_command(app).commands)  # type: ignore[attr-defined]
#: The blind trial is a program of the checkout, with options of the same table.
TRIAL = get_command(trial)
PARAMETERS = [
    (name, p)
    for name, command in {**COMMANDS, "trial": TRIAL}.items()
    for p in command.params
    if p.name not in {"help", "install_completion", "show_completion"}
]
#: What follows an option of the kind ``'100 Hz'``.
QUANTITY = re.compile(r"'([\d.]+ \w+)'")


def test_every_option_is_of_the_table_and_every_entry_is_used() -> None:
    spelled = {p.opts[0]: p for _, p in PARAMETERS}
    arguments = {p.metavar for _, p in PARAMETERS if p.param_type_name == "argument"}
    options = {p.opts[0] for _, p in PARAMETERS if p.param_type_name == "option"}
    assert arguments == set(ARGUMENTS) and options == set(OPTIONS), spelled.keys()
    for command, p in PARAMETERS:
        if p.param_type_name == "argument":
            continue
        long = p.opts[0]
        follows, _ = OPTIONS[long]
        assert p.opts == [long, *([SHORT[long]] if long in SHORT else [])], command
        assert p.secondary_opts == ([f"--no-{long[2:]}"] if p.default is True else []), (command, long)
        assert (p.metavar or "") == follows and p.is_flag == (not follows), (command, long)


def test_quantities_are_text_with_the_unit_that_the_table_shows() -> None:
    quantities = {name: QUANTITY.findall(follows) for name, (follows, _) in OPTIONS.items() if QUANTITY.search(follows)}
    assert len(quantities) >= 7
    for command, p in PARAMETERS:
        for example in quantities.get(p.opts[0], []):
            assert units.parse(example, example.split()[1]) > 0
            given = p.default if isinstance(p.default, tuple) else (p.default,)
            assert all(isinstance(text, str | None) for text in given), (command, p.opts[0])


class Inner(Arguments):
    """Options that commands share."""

    rate: str = option("--rate", "")
    skip: str = option("--skip", "0 s")


class Whole(Arguments):
    """Of a command."""

    log: str = argument("LOG")
    read: Inner
    seed: int = option("--seed", 3)


def test_fields_of_one_object_are_options_in_their_order() -> None:
    """Those of an object inside stand in its place, and a command gets all of them as they were given."""
    got: list[Whole] = []

    def command(args: Whole) -> None:
        """Take them."""
        got.append(args)

    made = typer.Typer()
    made.command()(spread(command))
    assert [p.name for p in get_command(made).params if p.name in spread(command).__signature__.parameters] == [  # type: ignore[attr-defined]
        "log",
        "rate",
        "skip",
        "seed",
    ]
    assert CliRunner().invoke(made, ["a.npz", "--skip", "2 s", "--seed", "5"]).exit_code == 0
    assert got == [Whole(log="a.npz", read=Inner(rate="", skip="2 s"), seed=5)]


def written() -> list[tuple[str, str]]:
    """Commands as text, with the file: in messages and docstrings of the package, in documents and scenarios."""
    out = []
    for path in sorted((ROOT / "insemu").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                out.append((path.name, node.value))
    for path in [
        *ROOT.glob("*.md"),
        ROOT / "insemu" / "cli" / "options.txt",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "docs").rglob("*.yaml"),
        *(ROOT / "scenarios").rglob("*.yaml"),
    ]:
        if path.name != "CHANGELOG.md":
            out += [(path.name, line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [
        (where, line)
        for where, text in out
        for line in re.findall(r"(?<![\w./-])insemu ([a-z][a-z-]*[^`'|;,)}\n]*)", text)
    ]


def wrong(line: str) -> str:
    """What is wrong with a command that a text writes; nothing where it is none or right."""
    name = line.split()[0]
    offered = re.findall(r"(?<!\S)\[?(--?[a-z][a-z-]*)", line)
    if name not in COMMANDS:
        return f"no command '{name}'" if offered else ""
    own = {o for p in COMMANDS[name].params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    return next((f"{name} has no {o}" for o in offered if o not in own), "")


def test_commands_that_are_written_somewhere_exist() -> None:
    lines = written()
    assert len(lines) > 200
    assert not [(where, line, wrong(line)) for where, line in lines if wrong(line)]


@pytest.mark.parametrize("line", ["gap a.yaml --measured b.npz", "init x.yaml --map 'rate=1 Hz'", "sovle x --json"])
def test_a_command_that_does_not_exist_is_seen(line: str) -> None:
    assert wrong(line)
