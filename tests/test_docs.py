"""Tutorials and how-to pages work: the files that they show are written, the commands that they show are run, in the order of the page."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

from insemu.cli import main
from insemu.report import static

DOCS = Path(__file__).resolve().parent.parent / "docs"
#: Pages that fit and fly longer than the quick suite may take.
SLOW = {"start", "choose_sensor_and_model", "solve_a_recording"}
#: Pages whose commands need an optional package.
NEEDS = {"tight_coupling": "sidereon"}
PAGES = [
    pytest.param(
        page,
        id=page.stem,
        marks=[pytest.mark.slow(reason="whole commands, whose parts have quick tests")] if page.stem in SLOW else [],
    )
    for page in sorted(page for folder in ("tutorials", "howto") for page in (DOCS / folder).glob("*.md"))
]
#: A file with its name, or commands behind ``$``.
BLOCK = re.compile(
    r"^```(?:\{code-block\} \w+\n:caption: (?P<name>\S+)\n\n?(?P<file>.*?)|console\n(?P<commands>.*?))^```",
    re.S | re.M,
)


def steps(page: str) -> list[tuple[str, str]]:
    """What a page asks the reader to do: ``(file name, content)`` or ``("$", command)``."""
    out = []
    for block in BLOCK.finditer(page):
        if block["name"]:
            out.append((block["name"], block["file"]))
        else:
            out += [("$", line[2:]) for line in block["commands"].splitlines() if line.startswith("$ ")]
    return out


@pytest.mark.parametrize("page", PAGES)
def test_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    if page.stem in NEEDS:
        pytest.importorskip(NEEDS[page.stem])
    monkeypatch.chdir(tmp_path)
    # pictures beside pages are half the time, and tested with the pages
    monkeypatch.setattr(static, "save", lambda *_, **__: [])
    asked = steps(page.read_text(encoding="utf-8"))
    assert any(name == "$" for name, _ in asked)
    for name, text in asked:
        if name != "$":
            Path(name).write_text(text, encoding="utf-8")
            continue
        program, *arguments = shlex.split(text)
        if program == "python":
            runpy.run_path(arguments[0], run_name="__main__")
            continue
        assert program == "insemu"
        with pytest.raises(SystemExit) as end:
            main(arguments)
        said = capsys.readouterr()
        assert end.value.code in (0, None), f"{text}\n{said.out}\n{said.err}"
        for option in ("--output", "-o", "--page", "--baseline"):
            if option in arguments:
                assert Path(arguments[arguments.index(option) + 1]).exists(), f"{text} wrote nothing"


def test_steps_are_found_in_order() -> None:
    page = "```{code-block} yaml\n:caption: a.yaml\n\nx: 1\n```\ntext\n```console\n$ insemu run a.yaml\noutput\n```\n"
    assert steps(page) == [("a.yaml", "x: 1\n"), ("$", "insemu run a.yaml")]
