"""A plugin of pytest: only the statistical tests, and what they state (``python -m tests.budget``)."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[Any]) -> None:
    items[:] = [i for i in items if hasattr(getattr(i, "function", None), "stated")]
    if note := os.environ.get("INSEMU_STATED"):
        stated = {i.nodeid: dataclasses.astuple(i.function.stated) for i in items}
        Path(note).write_text(json.dumps(stated), encoding="utf-8")
