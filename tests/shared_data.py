"""Where the reference data of other programs and sensors is; tests skip with a message where it is absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def root() -> Path:
    """The shared data folder, whether it exists or not."""
    return Path(os.environ.get("INSEMU_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def shared(relative: str) -> Path:
    """Path of a file under the shared data folder (``INSEMU_SHARED``, else ``../shared``), or skip the test."""
    path = root() / relative
    if not path.exists():
        pytest.skip(f"shared data absent: {relative} (set INSEMU_SHARED to the folder that holds it)")
    return path
