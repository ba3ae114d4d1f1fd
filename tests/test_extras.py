"""What insemu says where a package is missing that only some of its uses need."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from insemu import progress
from insemu.errors import InputError
from insemu.filters import user_filter
from insemu.report import page
from insemu.report.charts import Chart, Line, View
from insemu.report.style import pyplot


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is told from now on."""
    said: list[str] = []
    monkeypatch.setattr(progress, "listeners", [said.append])
    monkeypatch.setattr(progress, "_said", set())
    return said


def test_a_page_is_written_without_matplotlib_and_says_what_is_not_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, heard: list[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    view = View("", "m", [Line("up", [0.0, 2.0], "#0072B2")])
    chart = Chart("over time", "what goes up", [0.0, 1.0], "time, s", [view])
    for name in ("one", "two"):
        page.Page(name, [page.Section("Charts", [chart])], kind="run").write(tmp_path / f"{name}.html", pictures=True)
    assert (tmp_path / "two.html").is_file()
    assert not (tmp_path / "figures").exists()
    (line,) = heard
    assert "insemu[pictures]" in line


def test_what_draws_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"insemu\[pictures\]"):
        pyplot()


def test_the_dense_filter_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [m for m in sys.modules if m.startswith("filterpy") or m == "insemu.filters.reference"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "filterpy", None)
    with pytest.raises(InputError, match=r"insemu\[reference\]"):
        user_filter("reference")
