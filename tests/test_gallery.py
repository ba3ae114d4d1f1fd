"""Examples of the gallery and notebooks run, are short, and draw something."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from insemu.noise import PROCESSES

DOCS = Path(__file__).resolve().parent.parent / "docs"
sys.path.insert(0, str(DOCS))
from gallery_pages import EXAMPLES, run  # noqa: E402


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.stem)
def test_example(example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = example.read_text(encoding="utf-8").splitlines()
    assert code[0].startswith('"""') and code[0].endswith('."""') and 10 <= len(code) <= 35
    for name in list(PROCESSES):  # an own process is gone afterwards
        monkeypatch.setitem(PROCESSES, name, PROCESSES[name])
    before = set(PROCESSES)
    try:
        run(example, tmp_path / "picture.png")
    finally:
        for name in set(PROCESSES) - before:
            del PROCESSES[name]
    pixels = plt.imread(tmp_path / "picture.png")[..., :3]
    assert np.mean(np.abs(pixels - 1.0) > 0.05) > 0.01  # ink


def test_there_are_twenty() -> None:
    assert len(EXAMPLES) >= 20


@pytest.mark.parametrize("notebook", sorted((DOCS / "notebooks").glob("*.ipynb")), ids=lambda p: p.stem)
def test_notebook(notebook: Path) -> None:
    document = json.loads(notebook.read_text(encoding="utf-8"))
    cells = ["".join(c["source"]) for c in document["cells"] if c["cell_type"] == "code"]
    assert any(c.startswith("assert") for c in cells) and not any(c.get("outputs") for c in document["cells"])
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile(cell, str(notebook), "exec"), names)
    plt.close("all")
